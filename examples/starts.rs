use cregopt::nlp::Layout;
use cregopt::settings::*;
use cregopt::solver::{Finish, Solver, Status};
use cregopt::{gait::Schedule, scenario::Scenario};
fn main() {
    let t = TranscriptionSettings::default();
    let s = SolverSettings {
        max_iterations: 300,
        stall: StallSettings { budget: 2000., window: 10, ..StallSettings::default() },
        ..SolverSettings::default()
    };
    let (mut failing, mut rescued) = (0, 0);
    let mut seed = 1u64;
    let mut rnd = move || {
        seed = seed.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
        ((seed >> 33) as f64 / (1u64 << 31) as f64) * 2. - 1.
    };
    for line in std::fs::read_to_string(std::env::args().nth(1).unwrap()).unwrap().lines() {
        let v: serde_json::Value = serde_json::from_str(line).unwrap();
        let task = Scenario::named(v["scenario"].as_str().unwrap()).unwrap().task(v["target"].as_u64().unwrap() as usize).unwrap();
        let schedule = Schedule::new(serde_json::from_value(v["durations"].clone()).unwrap()).unwrap().aligned(t.interval_for(&task.robot));
        let l = Layout::<f32>::new(&task, &schedule, &t);
        let mut a = Solver::<f32>::default();
        let o = a.solve(&l, &s, Finish::Infeasibility(s.tolerance), None, &|| false);
        if o.status == Status::Solved {
            continue;
        }
        failing += 1;
        let mut best = o.infeasibility;
        let mut ok = false;
        let mut worst = 0f64;
        for _ in 0..4 {
            let start: Vec<f64> = l.initial[..l.variables].iter().map(|&x| x as f64 + 0.3 * rnd()).collect();
            let p = a.solve(&l, &s, Finish::Infeasibility(s.tolerance), Some(&start), &|| false);
            if p.status == Status::Solved {
                ok = true
            }
            best = best.min(p.infeasibility);
            worst = worst.max(p.infeasibility);
        }
        rescued += ok as usize;
        println!(
            "{} {} {} F {:.2e} others {:.2e} to {:.2e} {}",
            v["scenario"],
            v["target"],
            v["idx"],
            o.infeasibility,
            best,
            worst,
            if ok { "RESCUED" } else { "" }
        );
    }
    println!("failing {failing} rescued {rescued}");
}
