//! Cost of a candidate on the host, by part, on one thread without a device: the part that a faster device cannot reduce.

use cregopt::backend::tables::ShaderTables;
use cregopt::gait::cost::{CostWeights, cost};
use cregopt::gait::{AlignedSchedule, Schedule};
use cregopt::nlp::transcription::{force_limit, interval};
use cregopt::nlp::{Problem, trajectory};
use cregopt::search::evaluate::LowerSettings;
use cregopt::settings::TranscriptionSettings;
use cregopt::solver::{Finish, Outcome, Solver, Status, close};
use cregopt::task::Task;
use cregopt::verify::verify_rows;
use std::time::Instant;

/// Times of the parts of one candidate, s.
#[derive(Default)]
struct Parts {
    tables_f32: f64,
    /// Tables that only shaders use.
    of_shaders: f64,
    solve: f64,
    tables_f64: f64,
    closing: f64,
    rows: f64,
    cost: f64,
}

/// Sums of times and results over candidates.
#[derive(Default)]
struct Sum {
    parts: Parts,
    solved: usize,
    closed: usize,
    went_on: usize,
    /// Number of candidates that only further f64 iterations or a second solve solved.
    saved: usize,
    certified: usize,
    iterations: usize,
    closing_iterations: usize,
}

/// Runs a part and adds its time to `seconds`.
fn timed<T>(seconds: &mut f64, part: impl FnOnce() -> T) -> T {
    let start = Instant::now();
    let result = part();
    *seconds += start.elapsed().as_secs_f64();
    result
}

impl Sum {
    fn add(&mut self, task: &Task, schedule: &AlignedSchedule, settings: &LowerSettings, solver: &mut Solver<f32>) {
        let transcription: &TranscriptionSettings = &settings.transcription;
        let p = &mut self.parts;
        let problem = timed(&mut p.tables_f32, || Problem::<f32>::new(task, schedule, transcription));
        let _ = timed(&mut p.of_shaders, || ShaderTables::of(&problem));
        let finish = Finish::Infeasibility(settings.solver.tolerance);
        let first: Outcome = timed(&mut p.solve, || solver.solve(&problem, &settings.solver, finish, None, &|| false));
        let x = solver.solution();
        let problem = timed(&mut p.tables_f64, || Problem::<f64>::new(task, schedule, transcription));
        let (outcome, x) = timed(&mut p.closing, || close(&problem, first, x, &settings.solver, &|| false));
        let rows = timed(&mut p.rows, || {
            let motion = trajectory(task, &problem.curves, &x);
            let limit = force_limit(transcription, task);
            let feasible = verify_rows(&motion, &task.robot, &task.terrain, limit).is_ok_and(|rows| rows.feasible);
            (motion, feasible)
        });
        if rows.1 {
            let _ = timed(&mut p.cost, || cost(&rows.0, &task.robot, task.robot.leg_mass(), &CostWeights::default()));
        }
        let (solved, closing) = (first.status == Status::Solved, outcome.iterations - first.iterations);
        let at_once = solved && closing <= settings.solver.closing_steps && outcome.status == Status::Solved;
        self.solved += usize::from(solved);
        self.closed += usize::from(at_once);
        self.went_on += usize::from(closing > 0 && !at_once);
        self.saved += usize::from(!at_once && outcome.status == Status::Solved);
        self.certified += usize::from(rows.1);
        self.iterations += first.iterations;
        self.closing_iterations += closing;
    }
}

/// Prints the row of the table for a population.
pub fn print(name: &str, task: &Task, schedules: &[Schedule], settings: &LowerSettings) {
    let mut sum = Sum::default();
    let mut solver = Solver::default();
    for schedule in schedules {
        sum.add(task, &schedule.aligned(interval(&settings.transcription, &task.robot)), settings, &mut solver);
    }
    let Parts { tables_f32, of_shaders, solve, tables_f64, closing, rows, cost } = sum.parts;
    let each = |seconds: f64| format!("{:.0}", 1e6 * seconds / schedules.len() as f64);
    let host = tables_f32 + of_shaders + tables_f64 + closing + rows + cost;
    let times = [tables_f32, of_shaders, solve, tables_f64, closing, rows, cost, host].map(each).join(" | ");
    println!(
        "| {name} | {} | {times} | {:.1} + {:.1} | {} | {} | {} ({}) | {} |",
        settings.transcription.rows.name(),
        sum.iterations as f64 / schedules.len() as f64,
        sum.closing_iterations as f64 / schedules.len() as f64,
        sum.solved,
        sum.closed,
        sum.went_on,
        sum.saved,
        sum.certified
    );
}

/// Prints the head of the table.
pub fn print_head(count: usize) {
    println!(
        "One thread, {count} candidates per line, microseconds per candidate; went on: closing that took a second solve or more barrier steps (number solved)\n"
    );
    println!(
        "| candidates | rows | tables f32 | those of shaders | solve f32 | tables f64 | closing | certificate's rows | cost | all but the solve |\
 iterations + closing | solved in f32 | closed at once | went on | certified |"
    );
    println!("|{}", "---|".repeat(15));
}
