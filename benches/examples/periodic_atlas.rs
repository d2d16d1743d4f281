//! Periodic atlas: cost of a biped's walk and run at two speeds.

use cregopt::gait::family::GaitFamily;
use cregopt::search::atlas::{AtlasPlan, atlas_settings};
use cregopt::{Cpu, Robot};
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let plan = AtlasPlan::new(Arc::new(Robot::named("biped")?));
    let plan = AtlasPlan { speeds: vec![1.3, 1.6], ..plan };
    let (never, backend) = (AtomicBool::new(false), Cpu::new(0)?);
    let atlas = plan.run(&atlas_settings(), &backend, 64, &never, &mut |_, _| {})?;
    println!("{} of {} strides certified", atlas.certified(), atlas.points.len());
    for point in atlas.best(0.).into_iter().flatten() {
        println!("{:.1} m/s: {}, period {:.2} s, duty factor {:.2}", point.speed, point.family, point.period, point.duty);
    }
    for change in atlas.transitions(0.) {
        let name = |family: Option<GaitFamily>| family.map_or("no gait".into(), |family| family.to_string());
        println!("{} to {} at {:.2} m/s", name(change.from), name(change.to), change.speed);
    }
    assert!(atlas.best(0.).iter().flatten().count() > 1);
    Ok(())
}
