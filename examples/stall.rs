use cregopt::gait::Schedule; use cregopt::nlp::Layout; use cregopt::scenario::Scenario; use cregopt::settings::*; use cregopt::solver::*;
fn main() {
    let mut state = std::env::args().nth(1).map_or(7u64, |v| v.parse().unwrap());
    let per: usize = std::env::args().nth(2).map_or(16, |v| v.parse().unwrap());
    let mut u = move || { state = state.wrapping_add(0x9E3779B97F4A7C15); let mut z = state; z = (z ^ (z >> 30)).wrapping_mul(0xBF58476D1CE4E5B9); z = (z ^ (z >> 27)).wrapping_mul(0x94D049BB133111EB); ((z ^ (z >> 31)) >> 11) as f64 / (1u64 << 53) as f64 };
    let ts = TranscriptionSettings::default();
    let ss = SolverSettings { stall: StallSettings { enabled: false, ..Default::default() }, max_iterations: 200, ..Default::default() };
    let mut so = Solver::<f32>::default();
    let mut all: Vec<(bool, Vec<f64>, String)> = vec![];
    for sc in ["s1", "s2", "s3", "biped", "hex"] { for target in [3, 8, 13, 18] { for i in 0..per {
        let task = Scenario::named(sc).unwrap().task(target).unwrap();
        let feet = task.robot.feet();
        let trip = [2, 4, 6][(u() * 3.) as usize];
        let d: Vec<Vec<f64>> = (0..feet).map(|_| { let n = 5 + trip + (u() * 3.) as usize; (0..2 * n - 1).map(|_| { let g = (-2. * (1. - u()).ln()).sqrt() * (6.283185307 * u()).cos(); (-1.75f64 + g).clamp(-2.5, -1.).exp() }).collect() }).collect();
        let s = Schedule::new(d).unwrap().aligned(0.1);
        let l = Layout::<f32>::new(&task, &s, &ts);
        let o = so.solve(&l, &ss, Finish::Infeasibility(1e-7), None, &|| false);
        all.push((o.status == Status::Solved, so.history().to_vec(), format!("{sc} {target} {i}")));
    } } }
    let full: usize = all.iter().map(|a| a.1.len() - 1).sum();
    let solved = all.iter().filter(|a| a.0).count();
    println!("{} candidates, solved {solved}, iterations {full}, of solved {}", all.len(), all.iter().filter(|a| a.0).map(|a| a.1.len() - 1).sum::<usize>());
    for sc in ["s1", "s2", "s3", "biped", "hex"] { println!("{sc}: {}/{}", all.iter().filter(|a| a.0 && a.2.starts_with(&format!("{sc} "))).count(), all.iter().filter(|a| a.2.starts_with(&format!("{sc} "))).count()); }
    for a in all.iter() { println!("H {} {} {}", a.2.replace(' ', "/"), a.0, a.1.iter().map(|f| format!("{f:.6e}")).collect::<Vec<_>>().join(" ")); }
}
