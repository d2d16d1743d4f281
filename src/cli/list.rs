//! `list`: lists robots, terrains, scenarios and presets.

use super::{Failure, Verdict, print, to_json};
use crate::robot::{ROBOTS, Robot};
use crate::scenario::{SCENARIOS, TARGETS};
use crate::search::cem::PRESETS;
use crate::terrain::TERRAINS;
use clap::Args;
use serde_json::json;

#[derive(Debug, Args)]
pub struct List {
    /// Print JSON
    #[arg(long)]
    json: bool,
}

impl List {
    pub fn run(&self) -> Result<Verdict, Failure> {
        if self.json {
            let scenarios = SCENARIOS
                .map(|s| json!({"name": s.name, "about": s.about, "robot": s.robot, "terrain": s.terrain, "yaw_target": s.yaw_target}));
            let presets = PRESETS.map(|(name, about)| json!({"name": name, "about": about}));
            print(&to_json(
                &json!({"robots": ROBOTS, "terrains": TERRAINS, "scenarios": scenarios, "targets": TARGETS, "presets": presets}),
            )?)?;
            return Ok(Verdict::Feasible);
        }
        let mut text = String::from("robots\n");
        for name in ROBOTS {
            let r = Robot::named(name)?;
            text += &format!("  {name:<20} {} feet, {} kg, base {} m high\n", r.feet(), r.mass, r.base_height);
        }
        text += &format!("terrains\n  {}\n", TERRAINS.join(", "));
        text += &format!("scenarios (targets 1 to {TARGETS}, 6 m away from -45 to 45 degrees)\n");
        for s in SCENARIOS {
            text += &format!("  {:<20} {} ({} on {})\n", s.name, s.about, s.robot, s.terrain);
        }
        text += "presets\n";
        for (name, about) in PRESETS {
            text += &format!("  {name:<20} {about}\n");
        }
        print(&text)?;
        Ok(Verdict::Feasible)
    }
}
