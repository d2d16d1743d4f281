use cregopt::nlp::Layout;
use cregopt::settings::*;
use cregopt::solver::{Finish, Solver};
use cregopt::{gait::Schedule, scenario::Scenario};
fn main() {
    let args: Vec<String> = std::env::args().collect();
    let file = &args[1];
    let mut t = serde_json::to_value(TranscriptionSettings::default()).unwrap();
    let mut s = serde_json::to_value(SolverSettings::default()).unwrap();
    let mut limit = 3.0;
    let mut verbose = false;
    let mut f64s = false;
    for a in &args[2..] {
        if a == "-v" {
            verbose = true;
            continue;
        }
        if a == "-d" {
            f64s = true;
            continue;
        }
        let (k, v) = a.split_once('=').unwrap();
        let v: serde_json::Value = serde_json::from_str(v).unwrap_or_else(|_| v.into());
        if k == "limit" {
            limit = v.as_f64().unwrap();
            continue;
        }
        let p = format!("/{}", k[2..].replace('.', "/"));
        let tree = if k.starts_with("t.") { &mut t } else { &mut s };
        *tree.pointer_mut(&p).unwrap() = v;
    }
    let t: TranscriptionSettings = serde_json::from_value(t).unwrap();
    let s: SolverSettings = serde_json::from_value(s).unwrap();
    let mut groups: std::collections::BTreeMap<String, Vec<(bool, usize, usize)>> = Default::default();
    let clock = std::time::Instant::now();
    for line in std::fs::read_to_string(file).unwrap().lines() {
        let v: serde_json::Value = serde_json::from_str(line).unwrap();
        let name = v["scenario"].as_str().unwrap().to_string();
        let target = v["target"].as_u64().unwrap() as usize;
        let mut task = Scenario::named(&name).unwrap().task(target).unwrap();
        if t.rows == Transcription::Momentum {
            task.force_limit = limit * task.robot.weight();
        }
        let schedule = Schedule::new(serde_json::from_value(v["durations"].clone()).unwrap()).unwrap().aligned(t.interval_for(&task.robot));
        let (o, h) = if f64s {
            let layout = Layout::<f64>::new(&task, &schedule, &t);
            let mut solver = Solver::<f64>::default();
            let o = solver.solve(&layout, &s, Finish::Infeasibility(s.tolerance), None, &|| false);
            (o, solver.history().to_vec())
        } else {
            let layout = Layout::<f32>::new(&task, &schedule, &t);
            let mut solver = Solver::<f32>::default();
            let o = solver.solve(&layout, &s, Finish::Infeasibility(s.tolerance), None, &|| false);
            (o, solver.history().to_vec())
        };
        if verbose {
            print!(
                "{name} {target} {} T={:.1} {:?} it {} fac {} F",
                v["idx"],
                schedule.horizon(),
                o.status,
                o.iterations,
                o.factorisations
            );
            for i in (0..h.len()).step_by((h.len() / 60).max(1)) {
                print!(" {:.1e}", h[i]);
            }
            println!(" end {:.1e}", o.infeasibility);
        }
        if std::env::var("HIST").is_ok() {
            println!(
                "HIST {} {}",
                (o.status == cregopt::solver::Status::Solved) as u8,
                h.iter().map(|v| format!("{v:.3e}")).collect::<Vec<_>>().join(" ")
            );
        }
        groups.entry(format!("{name} {target:>2}")).or_default().push((
            o.status == cregopt::solver::Status::Solved,
            o.iterations,
            o.factorisations,
        ));
    }
    let mut all = 0;
    for (k, g) in &groups {
        let ok: Vec<usize> = g.iter().filter(|x| x.0).map(|x| x.1).collect();
        let mut m = ok.clone();
        m.sort();
        all += ok.len();
        println!(
            "{k}: {}/{} median it {} total it {} fac {}",
            ok.len(),
            g.len(),
            m.get(m.len() / 2).unwrap_or(&0),
            g.iter().map(|x| x.1).sum::<usize>(),
            g.iter().map(|x| x.2).sum::<usize>()
        );
    }
    println!("solved {all}, {:.2} s", clock.elapsed().as_secs_f64());
}
