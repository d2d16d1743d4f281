//! Certificate of a file: the motion is verified under its own terms, and on slippery ground.

use cregopt::app::label::{Provenance, label};
use cregopt::app::terms::{TermOverrides, VerificationTerms};
use cregopt::app::world::World;
use cregopt::{Cpu, Goal, Robot, Search, Task, Terrain, Trajectory, verify};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let task = Task::new(Robot::named("biped")?, Terrain::flat(), Goal::at(1., 0.))?;
    let found = Search::new(&task).first().run(&Cpu::new(0)?)?;
    let file = std::env::temp_dir().join("certificate.json");
    let motion = label(found.best.trajectory().clone(), &task, Provenance::default(), Some(1));
    std::fs::write(&file, serde_json::to_string(&motion)?)?;

    // From here on only the file is used, which may come from elsewhere.
    let motion = Trajectory::from_json(&std::fs::read_to_string(&file)?)?;
    let terms = VerificationTerms::new(&World::of(None, None, None), &motion, &TermOverrides::default())?;
    for line in &terms.lines {
        println!("{line}");
    }
    assert!(terms.verify()?.feasible);

    // A hundredth of the friction cannot carry the same forces.
    let ice = Terrain { friction: 0.01, name: "ice".into(), ..Terrain::flat() };
    let report = verify(&motion, &terms.robot, &ice, terms.force_limit)?;
    assert!(!report.feasible);
    for family in report.families.iter().filter(|family| family.violated > 0) {
        println!(
            "{}: {} of {} rows violated by up to {:.3} {}",
            family.family, family.violated, family.rows, family.max_violation, family.unit
        );
    }
    Ok(())
}
