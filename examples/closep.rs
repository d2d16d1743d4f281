use cregopt::nlp::Layout;
use cregopt::settings::*;
use cregopt::solver::{Finish, Solver};
use cregopt::{gait::Schedule, scenario::Scenario};
fn main() {
    let t = TranscriptionSettings::default();
    let s = SolverSettings::default();
    for line in std::fs::read_to_string(std::env::args().nth(1).unwrap()).unwrap().lines() {
        let v: serde_json::Value = serde_json::from_str(line).unwrap();
        let task = Scenario::named(v["scenario"].as_str().unwrap()).unwrap().task(v["target"].as_u64().unwrap() as usize).unwrap();
        let schedule = Schedule::new(serde_json::from_value(v["durations"].clone()).unwrap()).unwrap().aligned(t.interval_for(&task.robot));
        let l = Layout::<f32>::new(&task, &schedule, &t);
        let mut a = Solver::<f32>::default();
        let o = a.solve(&l, &s, Finish::Infeasibility(s.tolerance), None, &|| false);
        if o.status != cregopt::solver::Status::Solved {
            continue;
        }
        let l = Layout::<f64>::new(&task, &schedule, &t);
        let c = SolverSettings {
            max_iterations: s.closing_steps,
            closing: f64::INFINITY,
            edge_radius: 0.,
            proximal: s.proximal_floor,
            stall: StallSettings { enabled: false, ..s.stall.clone() },
            ..s.clone()
        };
        let mut b = Solver::<f64>::default();
        let p = b.solve(&l, &c, Finish::Rows(s.row_tolerance), Some(&a.solution()), &|| false);
        println!(
            "{} f32 {} closing {:?} fac {} {:?}",
            v["scenario"],
            o.iterations,
            p.status,
            p.factorisations,
            b.history().iter().map(|v| format!("{v:.1e}")).collect::<Vec<_>>()
        );
    }
}
