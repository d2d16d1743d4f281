//! Bytes and operations of each shader per round, and the bounds on the speed of GPUs that follow from them.

use crate::counted::Operations;
use crate::operations::of_round;
use cregopt::Result;
use cregopt::backend::gpu::shaders::Shader;
use cregopt::backend::tables::{Buffer, ShaderTables, Slot};
use cregopt::gait::Schedule;
use cregopt::nlp::problem::Element;
use cregopt::nlp::{Problem, transcription};
use cregopt::rows::Family;
use cregopt::rows::factored::FactoredElement;
use cregopt::search::evaluate::LowerSettings;
use cregopt::solver::control::Progress;
use cregopt::solver::round::{ROUND, Stage};
use cregopt::solver::{Finish, Solver};
use cregopt::task::Task;

/// GPUs by their data sheets: name, memory bandwidth in bytes/s, f32 operations/s with a fused one counted as two.
///
/// Sources: NVIDIA H200 SXM and GeForce RTX 4090 data sheets; Radeon 780M: AMD's 8.29 TFLOP/s (12 units of 64 lanes with two operations per
/// cycle at 2.7 GHz), and two channels of DDR5-5600, 89.6 GB/s.
const GPUS: [(&str, f64, f64); 3] = [("H200", 4.8e12, 67e12), ("RTX 4090", 1.008e12, 82.6e12), ("Radeon 780M", 0.0896e12, 8.29e12)];

/// Sizes of a candidate's arrays and tables, bytes.
struct Sizes<'a> {
    problem: &'a Problem<f32>,
    own: &'a ShaderTables,
}

impl Sizes<'_> {
    fn table(&self, buffer: Buffer) -> u64 {
        buffer.table(self.problem, self.own).map_or(0, |t| t.bytes.len() as u64)
    }

    /// Bytes of the Jacobian values of some families, without padding.
    fn jacobian(&self, of: impl Fn(Family) -> bool) -> u64 {
        let reach = if of(Family::Reach) { self.by_pose() + self.by_feet() } else { 0 };
        let columns = |e: &Element| self.problem.runs[e.runs.range()].iter().map(|r| r.len).sum::<u32>();
        let others = self.problem.elements.iter().filter(|e| of(e.family)).map(|e| 4 * u64::from(e.rows * columns(e)));
        reach + others.sum::<u64>()
    }

    /// Bytes of the pose columns of the reach rows.
    fn by_pose(&self) -> u64 {
        4 * 18 * self.problem.reach_rows.elements.len() as u64
    }

    /// Bytes of the feet's own columns of the reach rows.
    fn by_feet(&self) -> u64 {
        let rows = &self.problem.reach_rows;
        let columns = |e: &FactoredElement| rows.own[e.own as usize].present().map(|run| u64::from(run.len)).sum::<u64>();
        4 * 3 * rows.elements.iter().map(columns).sum::<u64>()
    }

    /// Bytes of the pivot rows with their right-hand side.
    fn factor(&self) -> u64 {
        let of = |size: u64, pivots: u64| (0..pivots).map(|i| size + 1 - i).sum::<u64>();
        4 * self.own.front_steps.iter().map(|s| of(s.size.into(), s.pivots.into())).sum::<u64>()
    }

    /// Bytes of the parts of fronts that are carried from one step to the next.
    fn carry(&self) -> u64 {
        4 * self.own.front_steps.iter().map(|s| u64::from(s.size - s.pivots)).map(|n| n * (n + 1) / 2 + n).sum::<u64>()
    }

    /// Bytes that a shader reads and writes in a barrier step. Each word of a buffer counts once for reading and once for writing, because
    /// repeated reads come from a cache. Shaders of rows are assumed to read all of `x` and of the ground.
    fn bytes(&self, shader: Shader) -> u64 {
        let problem = self.problem;
        let four = |n: usize| 4 * n as u64;
        let (x, v) = (four(problem.initial.len()), four(problem.variables));
        let (c, g, rows) = (four(problem.rows.one_sided()), four(problem.inequalities), four(problem.rows.all()));
        let t = |buffers: &[Buffer]| -> u64 { buffers.iter().map(|b| self.table(*b)).sum() };
        let under = 3 * four(problem.footholds.len());
        let deviations = 36 * four(problem.momentum_intervals.len());
        let sees = (4 + size_of::<Slot>() + size_of::<Progress<f32>>()) as u64;
        // Rows read their tables, x and the ground, and write Jacobian and residuals.
        let of = |family: Family| problem.all_elements().filter(move |e| e.family == family);
        let equalities = |f: Family| 4 * of(f).map(|e| u64::from(e.rows)).sum::<u64>();
        let inequalities = |f: Family| 4 * of(f).map(|e| u64::from(e.rows + e.pairs)).sum::<u64>();
        let walk = |tables: &[Buffer]| t(tables) + t(&[Buffer::Footholds]) + x + under;
        let family = |f: Family, table: Buffer| walk(&[table]) + self.jacobian(|o| o == f) + inequalities(f);
        let whole = self.jacobian(|_| true);
        let elements = t(&[Buffer::Elements]);
        let sweep = t(&[Buffer::FrontSteps, Buffer::Rests]);
        let reach = t(&[Buffer::FactoredInstants, Buffer::FactoredElements, Buffer::FactoredOwn, Buffer::BaseBlocks]);
        // Gathering goes by variable; an instant contributes one weight and its feet.
        let gathers = t(&[Buffer::GatherOf, Buffer::Gathers, Buffer::Touches, Buffer::FactoredTouches]);
        let gathered = gathers + four(3 * problem.reach_rows.instants.len() + 3 * problem.reach_rows.elements.len());
        if shader.table().is_some_and(|table| self.table(table) == 0) {
            return 0;
        }
        let cost = |f: Family| self.jacobian(|o| o == f) + equalities(f);
        sees + match shader {
            Shader::Ground => t(&[Buffer::Footholds]) + x + under,
            Shader::Dynamics => {
                let f = Family::Dynamics;
                walk(&[Buffer::DynamicsInstants, Buffer::StanceForces]) + self.jacobian(|o| o == f) + equalities(f)
            }
            Shader::Momentum => {
                let [linear, angular] = [Family::LinearMomentum, Family::AngularMomentum];
                let written = self.jacobian(|o| o == linear || o == angular) + equalities(linear) + equalities(angular);
                walk(&[Buffer::MomentumIntervals, Buffer::Impulses]) + written + deviations
            }
            Shader::Reach => family(Family::Reach, Buffer::ReachInstants) + t(&[Buffer::ReachFeet, Buffer::ReachLegs]) + reach + deviations,
            Shader::Force => family(Family::Force, Buffer::ForceNodes),
            Shader::Swing => family(Family::Swing, Buffer::SwingNodes),
            Shader::Stride => family(Family::Stride, Buffer::Strides),
            Shader::Acceleration => family(Family::Acceleration, Buffer::Accelerations),
            Shader::Cone => family(Family::Cone, Buffer::Cones),
            Shader::Footing => family(Family::Footing, Buffer::Footings),
            Shader::Sole => family(Family::Sole, Buffer::SolePoints),
            Shader::Turn => family(Family::Turn, Buffer::Turns),
            Shader::Periodic => {
                let f = Family::Periodic;
                walk(&[Buffer::Periodics]) + self.jacobian(|o| o == f) + equalities(f)
            }
            Shader::ConeCurvature => walk(&[Buffer::ConeCurvatures]) + cost(Family::ConeCurvature),
            Shader::Effort => walk(&[Buffer::Efforts]) + cost(Family::Effort),
            // Each point reads the start of its interval: the rate and the blocks.
            Shader::StancePower => {
                walk(&[Buffer::StancePowers]) + four(10 * problem.stance_powers.len()) + deviations + cost(Family::StancePower)
            }
            Shader::SwingPower => {
                walk(&[Buffer::SwingPowers]) + four(10 * problem.swing_powers.len()) + deviations + cost(Family::SwingPower)
            }
            Shader::JointTorque => {
                walk(&[Buffer::JointTorques]) + four(10 * problem.joint_torques.len()) + deviations + cost(Family::JointTorque)
            }
            Shader::JointSpeed => {
                walk(&[Buffer::JointSpeeds]) + four(10 * problem.joint_speeds.len()) + deviations + cost(Family::JointSpeed)
            }
            Shader::Goal => walk(&[Buffer::Goals]) + cost(Family::Goal),
            // Jacobian and tables, x twice, scaling, slacks and multipliers.
            Shader::Start => whole + elements + gathered + 2 * x + v + 3 * g,
            // Residuals, slacks, multipliers, weight, value, scaling, smoothing, x, initial values, diagonal, gradient.
            Shader::Weights => c + 3 * g + elements + 2 * rows + 6 * v,
            Shader::Front => {
                let tables = t(&[Buffer::FrontRows, Buffer::FrontColumns]);
                whole + 2 * rows + 2 * v + tables + sweep + 2 * self.carry() + self.factor()
            }
            // The direction is read again after the pivots.
            Shader::Substitute => self.factor() + sweep + 2 * v,
            Shader::Product => whole + elements + t(&[Buffer::Runs]) + reach + v + c + g,
            // Residuals, their changes, slacks, multipliers, both steps, weight and value.
            Shader::Correct => c + 6 * g + elements + 2 * rows,
            Shader::Transposed => whole + rows + elements + gathered + 2 * v,
            // The right-hand side is written to the factor and to the carried part.
            Shader::Forward => self.factor() + 4 * v + sweep,
            // Twice: residuals, their changes, slacks, multipliers, both steps. Once: direction, x, trial point.
            Shader::Advance => 8 * g + 3 * v,
            // Both points, the change, slacks and multipliers twice, their steps, x twice, initial values, smoothing.
            Shader::Judge => 3 * c + 9 * g + 4 * v,
        }
    }
}

/// Number of dispatches of a shader per round.
fn dispatches(shader: Shader) -> u64 {
    let has = |stage: &Stage| Shader::of(*stage).contains(&shader);
    ROUND.iter().filter(|(stage, _)| has(stage)).count() as u64
}

/// Prints bytes and operations per round and shader, averaged over candidates, and the resulting bounds of GPUs.
pub fn print(task: &Task, schedules: &[Schedule], settings: &LowerSettings) -> Result<()> {
    let transcription = &settings.transcription;
    let interval = transcription::interval(transcription, &task.robot);
    let count = schedules.len() as f64;
    let mut bytes = vec![0u64; Shader::ALL.len()];
    let mut operations = vec![Operations::default(); Shader::ALL.len()];
    let (mut rounds, mut sent) = (0, 0);
    let mut solver = Solver::<f32>::default();
    for schedule in schedules {
        let schedule = schedule.aligned(interval);
        let problem = Problem::<f32>::new(task, &schedule, transcription);
        let own = ShaderTables::of(&problem);
        let sizes = Sizes { problem: &problem, own: &own };
        let of = of_round(task, &schedule, settings);
        for &shader in Shader::ALL {
            bytes[shader as usize] += dispatches(shader) * sizes.bytes(shader);
            for _ in 0..dispatches(shader) {
                operations[shader as usize] += of[shader as usize];
            }
        }
        sent += Buffer::TABLES.iter().map(|b| sizes.table(*b)).sum::<u64>();
        let finish = Finish::Infeasibility(settings.solver.tolerance);
        rounds += solver.solve(&problem, &settings.solver, finish, None, &|| false).factorisations;
    }
    let all_bytes: u64 = bytes.iter().sum();
    let mut all = Operations::default();
    operations.iter().for_each(|of| all += *of);
    println!(
        "| shader | times | KiB per round | % | thousand operations per round | % | quotients, roots and functions | operations per byte |"
    );
    println!("|{}", "---|".repeat(8));
    let share = |part: u64, all: u64| 100. * part as f64 / all as f64;
    let line = |name: &str, times: u64, moved: u64, of: Operations| {
        let sum = of.simple + of.special;
        println!(
            "| {name} | {times} | {:.1} | {:.1} | {:.1} | {:.1} | {:.1} | {:.2} |",
            moved as f64 / 1024. / count,
            share(moved, all_bytes),
            sum as f64 / 1e3 / count,
            share(sum, all.simple + all.special),
            of.special as f64 / 1e3 / count,
            sum as f64 / moved as f64
        );
    };
    for &shader in Shader::ALL.iter().filter(|s| bytes[**s as usize] > 0) {
        line(shader.path(), dispatches(shader), bytes[shader as usize], operations[shader as usize]);
    }
    line("all", Shader::ALL.iter().map(|s| dispatches(*s)).sum(), all_bytes, all);
    let rounds = rounds as f64 / count;
    let (moved, done) = (rounds * all_bytes as f64 / count, rounds * (all.simple + all.special) as f64 / count);
    println!(
        "\n{rounds:.1} rounds per candidate: {:.1} MB and {:.1} million operations per solve; tables of {:.0} KiB are sent before.\n",
        moved / 1e6,
        done / 1e6,
        sent as f64 / 1024. / count
    );
    println!("| GPU | memory, TB/s | f32, TFLOP/s | bound by memory, candidates/s | bound by arithmetic, candidates/s |");
    println!("|{}", "---|".repeat(5));
    for (name, memory, arithmetic) in GPUS {
        println!("| {name} | {} | {} | {:.0} | {:.0} |", memory / 1e12, arithmetic / 1e12, memory / moved, arithmetic / done);
    }
    Ok(())
}
