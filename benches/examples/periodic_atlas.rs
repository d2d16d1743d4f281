//! Periodic atlas: cost of a biped's walk and run at four speeds.

use cregopt::search::atlas::{AtlasPlan, atlas_settings};
use cregopt::{Cpu, Robot};
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let plan = AtlasPlan::new(Arc::new(Robot::named("biped")?));
    let plan = AtlasPlan { speeds: vec![0.5, 1., 1.5, 2.], ..plan };
    let (never, backend) = (AtomicBool::new(false), Cpu::new(0)?);
    let atlas = plan.run(&atlas_settings(), &backend, 64, &never, &mut |_, _| {})?;
    println!("{} of {} strides certified", atlas.certified(), atlas.points.len());
    for point in atlas.best(0.).into_iter().flatten() {
        println!("{:.1} m/s: {}, period {:.2} s, duty factor {:.2}", point.speed, point.family, point.period, point.duty);
    }
    for change in atlas.transitions(0.) {
        println!("{:?} to {:?} at {:.2} m/s", change.from, change.to, change.speed);
    }
    assert!(atlas.best(0.).iter().flatten().count() > 1);
    Ok(())
}
