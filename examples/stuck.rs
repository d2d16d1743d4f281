use cregopt::gait::Schedule; use cregopt::nlp::Layout; use cregopt::scenario::Scenario; use cregopt::settings::*; use cregopt::solver::*;
use std::io::BufRead; fn main() {
    let a: Vec<String> = std::env::args().collect();
    let f = std::fs::File::open("../shared/reference/ipopt_candidates.jsonl").unwrap();
    for line in std::io::BufReader::new(f).lines() {
        let v: serde_json::Value = serde_json::from_str(&line.unwrap()).unwrap();
        if v["scenario"] != a[1] || v["target"].to_string() != a[2] || v["idx"].to_string() != a[3] { continue; }
        let ts = TranscriptionSettings::default();
        let ss = SolverSettings { stall: StallSettings { enabled: false, ..Default::default() }, max_iterations: std::env::var("IT").map_or(40, |v| v.parse().unwrap()), ..Default::default() };
        let task = Scenario::named(&a[1]).unwrap().task(a[2].parse().unwrap()).unwrap();
        let s = Schedule::new(serde_json::from_value(v["durations"].clone()).unwrap()).unwrap().aligned(0.1);
        let l = Layout::<f64>::new(&task, &s, &ts);
        let mut so = Solver::<f64>::default();
        let o = so.solve(&l, &ss, Finish::Rows(1e-4), None, &|| false);
        println!("{o:?}"); println!("{}", so.history().iter().map(|f| format!("{f:.1e}")).collect::<Vec<_>>().join(" "));
        let x = so.solution();
        let mut gr = vec![cregopt::terrain::Ground::level(0.); l.footholds.len()]; let mut c = vec![0.; l.equalities]; let mut g = vec![0.; l.inequalities];
        cregopt::kernels::evaluate(&l, &x, 0., &mut gr, &mut c, &mut g, None);
        for e in &l.elements { let (r, i) = (e.place.row as usize, e.place.inequality as usize);
            if r < l.equalities { for k in 0..6 { if c[r+k].abs() > 3e-3 { println!("dyn instant {} row {k} {:.4}", r/6, c[r+k]); } } }
            else { for k in 0..(e.rows+e.pairs) as usize { if g[i+k] > 3e-3 { println!("{:?} ineq {} {k}: {:.4}", e.family, i, g[i+k]); } } } }
        for (foot, b) in l.curves.feet.iter().enumerate() { println!("foot {foot}: {}", b.footholds.iter().map(|&h| format!("({:.4} {:.3})", x[h as usize], x[h as usize+1])).collect::<Vec<_>>().join(" ")); }
    }
}
