//! Problems with soles: this solver and Ipopt on the same rows, and this solver with points in place of the soles.

use crate::cpu_time::cpu_seconds;
use crate::optimise::closed;
use cregopt::backend::Cpu;
use cregopt::experiment::summary::Spread;
use cregopt::gait::Schedule;
use cregopt::gait::family::GaitFamily;
use cregopt::nlp::{Problem, transcription};
use cregopt::reference::ipopt::Options;
use cregopt::reference::momentum;
use cregopt::search::cem::random::Draws;
use cregopt::search::cem::{Distribution, PeriodicDistribution, PeriodicSettings};
use cregopt::search::evaluate::{Evaluated, LowerSettings, evaluate};
use cregopt::{Error, Goal, Result, Robot, Task, Terrain};
use std::f64::consts::{FRAC_PI_2, FRAC_PI_4, PI};
use std::path::Path;
use std::sync::Arc;

/// Number of solves over which this solver's time is averaged.
const REPEATS: usize = 20;

/// Options of Ipopt.
const OPTIONS: Options = Options { tolerance: 1e-4, max_iterations: 500, max_seconds: 20., barrier: None };

/// Goals: label, x, y and yaw in leg heights and rad.
const GOALS: [(&str, [f64; 3]); 8] = [
    ("stand", [0.05, 0., 0.]),
    ("walk, 1.2 leg heights", [1.2, 0., 0.]),
    ("walk, 2.5 leg heights", [2.5, 0., 0.]),
    ("backwards", [-1., 0., 0.]),
    ("aside", [0., 0.7, 0.]),
    ("quarter turn", [0., 0., FRAC_PI_2]),
    ("half turn", [0., 0., PI]),
    ("curve", [1., 0.5, FRAC_PI_4]),
];

/// A candidate solved with soles and with points, and by Ipopt with soles.
struct Solved {
    goal: usize,
    own: Own,
    points: Own,
    ipopt_feasible: bool,
    ipopt_seconds: f64,
    ipopt_iterations: usize,
    ipopt_status: i32,
}

/// This solver's solve.
struct Own {
    feasible: bool,
    seconds: f64,
    iterations: usize,
    /// Numbers of variables, equalities and inequalities, a two-sided one counted once.
    size: [usize; 3],
}

fn schedule(task: &Task, standing: bool, draws: Draws) -> Result<Schedule> {
    let distribution = PeriodicDistribution::initial(task, &[GaitFamily::Walk], &PeriodicSettings::default())?;
    let gait = distribution.gait(&distribution.sample(draws))?;
    // A stance as long as the rest before and after the walk.
    if standing { Schedule::new(vec![vec![gait.lead_in + gait.tail]; task.robot.feet()]) } else { gait.schedule() }
}

fn own(task: &Task, schedule: &Schedule, settings: &LowerSettings, cpu: &Cpu) -> Result<(Own, Evaluated)> {
    let start = cpu_seconds();
    let mut solved = None;
    for _ in 0..REPEATS {
        solved = evaluate(&[(task, schedule)], settings, None, cpu, false, &|| false)?.into_iter().next().flatten();
    }
    let seconds = (cpu_seconds() - start) / REPEATS as f64;
    let solved = solved.ok_or_else(|| Error::invalid("candidate", "not solved", "solved"))?;
    let problem = Problem::<f64>::new(task, &solved.schedule, &settings.transcription);
    let size = [problem.variables, problem.rows.equalities as usize, problem.rows.inequalities as usize];
    Ok((Own { feasible: solved.feasible, seconds, iterations: solved.outcome.iterations, size }, solved))
}

fn solve(goal: usize, robot: &Arc<Robot>, draws: Draws, cpu: &Cpu) -> Result<Solved> {
    let (length, [x, y, yaw]) = (robot.leg_height(), GOALS[goal].1);
    let to = Goal::at(x * length, y * length).yaw(yaw);
    let task = Task::new(robot.clone(), Terrain::flat(), to)?;
    let schedule = schedule(&task, goal == 0, draws)?;
    let mut settings = LowerSettings::default();
    settings.solver.optimise.iterations = 0;
    // Swings have the same bound with soles and with points.
    settings.transcription.foot_acceleration = transcription::legs::foot_acceleration(&settings.transcription, robot);
    let (of_soles, solved) = own(&task, &schedule, &settings, cpu)?;
    let pointed = Robot { sole: None, foot_radius: Some(0.), name: format!("{}-points", robot.name), ..(**robot).clone() };
    let (of_points, _) = own(&Task::new(pointed, Terrain::flat(), to)?, &schedule, &settings, cpu)?;
    let start = cpu_seconds();
    let (x, statistics) = momentum::solve(&task, &solved.schedule, &settings.transcription, &OPTIONS)?;
    let ipopt_seconds = cpu_seconds() - start;
    let (_, ipopt_feasible) = closed(&task, &solved.schedule, x, &settings)?;
    let (ipopt_iterations, ipopt_status) = (statistics.iterations, statistics.status);
    Ok(Solved { goal, own: of_soles, points: of_points, ipopt_feasible, ipopt_seconds, ipopt_iterations, ipopt_status })
}

fn median(values: impl Iterator<Item = f64>) -> f64 {
    Spread::of(values).map_or(f64::NAN, |s| s.median)
}

/// Runs the comparison.
///
/// * `arguments` - number of candidates, `--seed N`, `--robot NAME or FILE`, each optional
pub fn run(arguments: &[String]) -> Result<()> {
    let (mut count, mut seed, mut robot) = (40, 101, Robot::named("humanoid")?);
    let mut words = arguments.iter();
    let number = |text: &str| text.parse::<u32>().map_err(|_| Error::invalid("argument", text, "[CANDIDATES] [--seed N] [--robot FILE]"));
    while let Some(word) = words.next() {
        let value = || words.clone().next().map_or("", String::as_str);
        match word.as_str() {
            "--seed" => seed = number(value())?.into(),
            "--robot" => robot = Robot::read(Path::new(value()))?,
            count_given => {
                count = number(count_given)? as usize;
                continue;
            }
        }
        words.next();
    }
    if robot.sole.is_none() {
        return Err(Error::invalid("robot.sole", "absent", "a sole"));
    }
    let (robot, cpu) = (Arc::new(robot), Cpu::new(1)?);
    println!("{count} candidates of {}, seed {seed}; CPU times, one core; Ipopt on the same rows\n", robot.name);
    println!(
        "| goal | candidate | own | Ipopt | iterations, own / Ipopt | status | own, ms | Ipopt, ms | points | iterations | points, ms |"
    );
    println!("|---|---|---|---|---|---|---|---|---|---|---|");
    let mut all = Vec::new();
    for candidate in 0..count {
        let one = solve(candidate % GOALS.len(), &robot, Draws::new(seed, 0, candidate), &cpu)?;
        let verdict = |feasible: bool| if feasible { "yes" } else { "no" };
        println!(
            "| {} | {candidate} | {} | {} | {} / {} | {} | {:.3} | {:.1} | {} | {} | {:.3} |",
            GOALS[one.goal].0,
            verdict(one.own.feasible),
            verdict(one.ipopt_feasible),
            one.own.iterations,
            one.ipopt_iterations,
            one.ipopt_status,
            1e3 * one.own.seconds,
            1e3 * one.ipopt_seconds,
            verdict(one.points.feasible),
            one.points.iterations,
            1e3 * one.points.seconds,
        );
        all.push(one);
    }
    println!("\n| goal | candidates | feasible: both | own only | Ipopt only | neither | median ratio of times | least | largest |");
    println!("|---|---|---|---|---|---|---|---|---|");
    let line = |label: &str, of: &dyn Fn(&&Solved) -> bool| {
        let some: Vec<&Solved> = all.iter().filter(of).collect();
        let verdicts = [(true, true), (true, false), (false, true), (false, false)];
        let counts = verdicts.map(|v| some.iter().filter(|s| (s.own.feasible, s.ipopt_feasible) == v).count());
        let ratios = Spread::of(some.iter().map(|s| s.ipopt_seconds / s.own.seconds)).map_or([f64::NAN; 3], |s| [s.median, s.min, s.max]);
        let [both, only, other, neither] = counts;
        println!(
            "| {label} | {} | {both} | {only} | {other} | {neither} | {:.0} | {:.0} | {:.0} |",
            some.len(),
            ratios[0],
            ratios[1],
            ratios[2]
        );
    };
    for (number, (label, _)) in GOALS.iter().enumerate() {
        line(label, &|s| s.goal == number);
    }
    line("all", &|_| true);
    let ratio = |who: fn(&Solved) -> f64| all.iter().map(who).sum::<f64>();
    println!("\nratio of the summed times: {:.0}", ratio(|s| s.ipopt_seconds) / ratio(|s| s.own.seconds));
    println!("\n| feet | feasible | variables | equalities | inequalities | iterations | ms per solve | ms per iteration |");
    println!("|---|---|---|---|---|---|---|---|");
    for (label, of) in [("soles", (|s| &s.own) as fn(&Solved) -> &Own), ("points", |s| &s.points)] {
        let feasible = all.iter().filter(|s| of(s).feasible).count();
        let size = [0, 1, 2].map(|i| median(all.iter().map(|s| of(s).size[i] as f64)));
        let each = |value: fn(&Own) -> f64| median(all.iter().map(|s| value(of(s))));
        println!(
            "| {label} | {feasible} | {:.0} | {:.0} | {:.0} | {:.0} | {:.3} | {:.3} |",
            size[0],
            size[1],
            size[2],
            each(|o| o.iterations as f64),
            each(|o| 1e3 * o.seconds),
            each(|o| 1e3 * o.seconds / o.iterations.max(1) as f64),
        );
    }
    let paired = |value: fn(&Own) -> f64| median(all.iter().map(|s| value(&s.own) / value(&s.points)));
    println!(
        "| ratio of pairs | | {:.2} | {:.2} | {:.2} | {:.2} | {:.2} | {:.2} |",
        paired(|o| o.size[0] as f64),
        paired(|o| o.size[1] as f64),
        paired(|o| o.size[2] as f64),
        paired(|o| o.iterations as f64),
        paired(|o| o.seconds),
        paired(|o| o.seconds / o.iterations.max(1) as f64)
    );
    Ok(())
}
