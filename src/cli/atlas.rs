//! `atlas`: every regular gait of a robot at every speed.

use super::args::{DeviceArgs, PrecisionArg, apply, robot};
use super::{CANCELLED, Failure, Verdict, complain, print};
use crate::error::Result;
use crate::gait::family::GaitFamily;
use crate::report::files;
use crate::search::atlas::Plan;
use crate::search::evaluate::LowerSettings;
use clap::Args;
use std::path::PathBuf;

/// Problems solved at once: enough for a GPU, few enough to say how far it is.
const CHUNK: usize = 2048;

#[derive(Debug, Args)]
pub struct Atlas {
    /// Robot: a name from `list` or a JSON file
    #[arg(long, value_name = "NAME|FILE")]
    robot: String,
    /// Only these gaits; default all that the robot can have
    #[arg(long, value_name = "NAME,...", value_delimiter = ',')]
    gait: Vec<String>,
    /// Travel speeds, m/s; default 0.1 to 1.7 sqrt(g l), with l the height of the base
    #[arg(long, value_name = "M/S,...", value_delimiter = ',')]
    speeds: Vec<f64>,
    /// Periods of a stride, s; default 1 to 5 sqrt(l / g)
    #[arg(long, value_name = "S,...", value_delimiter = ',')]
    periods: Vec<f64>,
    /// Shares of a stride that a foot stands; default 0.25 to 0.85
    #[arg(long, value_name = "SHARE,...", value_delimiter = ',')]
    duties: Vec<f64>,
    /// Slopes of the ground, rise over run; default level
    #[arg(long, value_name = "SLOPE,...", value_delimiter = ',', allow_negative_numbers = true)]
    slopes: Vec<f64>,
    /// Time at even speed that costs are taken from, s; default 8 sqrt(l / g)
    #[arg(long, value_name = "S")]
    seconds: Option<f64>,
    /// Folder for atlas.csv, atlas.json and atlas.svg
    #[arg(long, value_name = "DIR", default_value = "atlas")]
    out: PathBuf,
    #[command(flatten)]
    place: DeviceArgs,
    /// Any setting by its path, e.g. `solver.max_iterations=100` or `cost.effort=0.1`
    #[arg(long, value_name = "KEY=VALUE")]
    set: Vec<String>,
}

impl Atlas {
    pub fn run(&self) -> std::result::Result<Verdict, Failure> {
        let plan = self.plan()?;
        let settings: LowerSettings = apply(LowerSettings::default(), "", self.set.iter().map(String::as_str))?;
        files::make_folder(&self.out)?;
        let backend = self.place.backend(CHUNK, PrecisionArg::F32)?;
        let atlas = plan.run(&settings, &*backend, 256, &CANCELLED, &mut |done, all| complain(&format!("{done} of {all} problems")))?;
        let mut text = String::from("family,period,duty,speed,froude,certified,iter,even,leg,axial,across,swing,effort,effcost,peak,tilt,foot\n");
        let (t, v) = (crate::gait::family::time_scale(&atlas.plan.robot), crate::gait::family::speed_scale(&atlas.plan.robot));
        for p in &atlas.points {
            let c = p.cost.unwrap_or_default();
            text += &format!("{},{:.4},{:.3},{:.4},{:.4},{},{},{:.4},{:.5},{:.5},{:.5},{:.5},{:.5},{:.5},{:.4},{:.4},{:.4}\n", p.family.name(), p.period / t, p.duty, p.speed / v, p.froude, p.certified as u8, p.iterations, p.even_speed.unwrap_or(0.) / v, c.leg_work, c.axial_work, c.across_work, c.swing_work, c.effort, c.effort_cost, c.peak_force, c.tilt, c.foot_speed / v);
        }
        files::write(&self.out.join("atlas.csv"), &text)?;
        print(&format!("{} problems {} left out, {} certified, {:.1} s\n", atlas.problems, atlas.left_out, atlas.points.iter().filter(|p| p.certified).count(), atlas.seconds))?;
        Ok(Verdict::Feasible)
    }

    fn plan(&self) -> Result<Plan> {
        let mut plan = Plan::new(robot(&self.robot)?);
        if !self.gait.is_empty() {
            plan.families = self.gait.iter().map(|name| GaitFamily::named(name)).collect::<Result<_>>()?;
        }
        for (values, given) in
            [(&mut plan.speeds, &self.speeds), (&mut plan.periods, &self.periods), (&mut plan.duties, &self.duties), (&mut plan.slopes, &self.slopes)]
        {
            if !given.is_empty() {
                values.clone_from(given);
            }
        }
        plan.steady = self.seconds.unwrap_or(plan.steady);
        plan.validate()?;
        Ok(plan)
    }
}
