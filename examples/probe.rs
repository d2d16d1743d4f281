use cregopt::gait::Schedule;
use cregopt::nlp::{Layout, Real};
use cregopt::scenario::Scenario;
use cregopt::robot::Robot;
use cregopt::settings::*;
use cregopt::solver::*;
use std::io::BufRead;
use std::sync::Arc;
use std::time::Instant;

fn run<T: Real>(filter: &str, target: usize, robot: Option<&str>, verbose: bool) {
    let f = std::fs::File::open("../shared/reference/ipopt_candidates.jsonl").unwrap();
    let (ts, ss) = (TranscriptionSettings::default(), SolverSettings { stall: StallSettings { enabled: std::env::var("STALL").is_ok(), ..Default::default() }, max_iterations: std::env::var("IT").ok().map_or(40, |v| v.parse().unwrap()), closing: std::env::var("CL").ok().map_or(1e-3, |v| v.parse().unwrap()), edge_radius: std::env::var("ER").ok().map_or(0.04, |v| v.parse().unwrap()), ..Default::default() });
    let mut solver = Solver::<T>::default();
    let (mut ok, mut ipopt_ok, mut lost, mut total, mut its, mut facts) = (0, 0, vec![], 0, vec![], 0);
    let t0 = Instant::now();
    let mut build = 0.0;
    for line in std::io::BufReader::new(f).lines() {
        let v: serde_json::Value = serde_json::from_str(&line.unwrap()).unwrap();
        if v["scenario"] != filter || v["target"] != target { continue; }
        let mut task = Scenario::named(filter).unwrap().task(target).unwrap();
        if let Some(r) = robot { task.robot = Arc::new(Robot::named(r).unwrap()); }
        let d: Vec<Vec<f64>> = serde_json::from_value(v["durations"].clone()).unwrap();
        let s = Schedule::new(d).unwrap().aligned(ts.interval);
        let b0 = Instant::now();
        let layout = Layout::<T>::new(&task, &s, &ts);
        build += b0.elapsed().as_secs_f64();
        let finish = if size_of::<T>() == 4 { Finish::Infeasibility(ss.tolerance) } else { Finish::Rows(1e-4) };
        let o = solver.solve(&layout, &ss, finish, None, &|| false);
        let ip = v["ipopt"]["n_violated"] == 0 || v["ipopt_long"]["n_violated"] == 0;
        total += 1; facts += o.factorisations;
        if ip { ipopt_ok += 1; }
        if o.status == Status::Solved { ok += 1; its.push(o.iterations); } else if ip { lost.push(v["idx"].clone()); }
        if verbose {
            println!("{} n {} front {} stride {} it {} fact {} F {:.2e} {:?} ipopt {} long {}", v["idx"], layout.variables, layout.steps.iter().map(|s| s.size).max().unwrap(), layout.front_stride, o.iterations, o.factorisations, o.infeasibility, o.status, v["ipopt"]["n_violated"], v["ipopt_long"]["n_violated"]);
            if std::env::var("HIST").is_ok() { println!("   {}", solver.history().iter().map(|f| format!("{f:.1e}")).collect::<Vec<_>>().join(" ")); }
        }
    }
    its.sort();
    let t = t0.elapsed().as_secs_f64();
    println!("{filter} {target}: solved {ok}/{total} ipopt {ipopt_ok} lost {lost:?} median it {:?} max {:?} facts {facts} time {t:.3} build {build:.4} per cand {:.2} ms, per fact {:.3} ms", its.get(its.len()/2), its.last(), t/total as f64*1e3, t/facts as f64*1e3);
}
fn main() {
    let a: Vec<String> = std::env::args().collect();
    let v = std::env::var("V").is_ok();
    let robot = std::env::var("ROBOT").ok();
    for s in a[2].split(',') { for t in a[3].split(',') {
        if a[1] == "f32" { run::<f32>(s, t.parse().unwrap(), robot.as_deref(), v) } else { run::<f64>(s, t.parse().unwrap(), robot.as_deref(), v) }
    }}
}
