//! Tables of an atlas of gaits: one line per problem, and a summary.

use super::result::SolvedOn;
use crate::error::{Error, Result};
use crate::gait::cost::CostWeights;
use crate::gait::family::{GaitFamily, froude, speed_scale, time_scale};
use crate::search::atlas::{Atlas, AtlasPoint, Transition};
use crate::search::evaluate::LowerSettings;
use serde::Serialize;

/// Names and values of the columns in output order. Numbers keep four to five significant digits so that thousands of lines stay small.
fn columns(point: &AtlasPoint) -> [(&'static str, String); 25] {
    let digits = |value: f64| match value.abs() {
        v if v >= 100. => format!("{value:.1}"),
        v if v >= 1. => format!("{value:.3}"),
        _ => format!("{value:.4}"),
    };
    let of = |value: Option<f64>| value.map(digits).unwrap_or_default();
    let cost = point.cost;
    [
        ("family", point.family.name().into()),
        ("period", digits(point.period)),
        ("duty", digits(point.duty)),
        ("speed", digits(point.speed)),
        ("froude", digits(point.froude)),
        ("slope", digits(point.slope)),
        ("strides", point.strides.to_string()),
        ("certified", point.certified.to_string()),
        ("status", serde_json::to_value(point.status).ok().and_then(|s| s.as_str().map(Into::into)).unwrap_or_default()),
        ("iterations", point.iterations.to_string()),
        ("even_speed", of(point.even_speed)),
        ("cost", of(cost.map(|c| c.total))),
        ("leg_work", of(cost.map(|c| c.leg_work))),
        ("swing_work", of(cost.map(|c| c.swing_work))),
        ("effort_cost", of(cost.map(|c| c.effort_cost))),
        ("joint_cost", of(cost.map(|c| c.joint_cost))),
        ("effort", of(cost.map(|c| c.effort))),
        ("peak_force", of(cost.map(|c| c.peak_force))),
        ("tilt", of(cost.map(|c| c.tilt))),
        ("foot_speed", of(cost.map(|c| c.foot_speed))),
        ("foot_acceleration", of(cost.map(|c| c.foot_acceleration))),
        ("touch_down_speed", of(cost.map(|c| c.touch_down_speed))),
        ("swing_moment", of(cost.map(|c| c.swing_moment))),
        ("even_seconds", of(cost.map(|c| c.horizon))),
        ("even_distance", of(cost.map(|c| c.distance))),
    ]
}

/// Table with one line per problem. Costs are empty where no motion was certified. Units: m, s, degrees; costs per weight and distance,
/// forces in weights.
///
/// # Errors
/// [`Error::Format`] if the CSV library fails to write.
pub fn csv(atlas: &Atlas) -> Result<String> {
    let failed = |e: &dyn std::fmt::Display| Error::Format { message: e.to_string() };
    let mut writer = csv::Writer::from_writer(Vec::new());
    for (i, point) in atlas.points.iter().enumerate() {
        let columns = columns(point);
        if i == 0 {
            writer.write_record(columns.iter().map(|(name, _)| name)).map_err(|e| failed(&e))?;
        }
        writer.write_record(columns.iter().map(|(_, value)| value)).map_err(|e| failed(&e))?;
    }
    String::from_utf8(writer.into_inner().map_err(|e| failed(&e))?).map_err(|e| failed(&e))
}

/// Summary of an atlas.
#[derive(Debug, Clone, Serialize)]
pub struct AtlasResult {
    /// Name of the robot.
    pub robot: String,
    /// Height of the base, m: the length `l` that scales speeds and times.
    pub base_height: f64,
    /// Time scale `sqrt(l / g)`, s.
    pub time_scale: f64,
    /// Speed scale `sqrt(g l)`, m/s.
    pub speed_scale: f64,
    /// Stride periods, s.
    pub periods: Vec<f64>,
    /// Duty factors: the part of a stride that a foot is in stance.
    pub duties: Vec<f64>,
    /// Travel speeds, m/s.
    pub speeds: Vec<f64>,
    /// Shortest duration of the part of a motion at steady speed, s.
    pub even_seconds: f64,
    /// Weights of the cost terms.
    pub cost: CostWeights,
    /// Solver settings.
    pub settings: LowerSettings,
    /// Number of problems in the plan.
    pub problems: usize,
    /// Number of problems solved; smaller than `problems` if the run was stopped.
    pub solved: usize,
    /// Number of problems with a certified motion.
    pub certified: usize,
    /// Number of combinations left out because no leg can follow them: the foot would leave its reach or exceed its speed.
    pub left_out: usize,
    /// Total time, s.
    pub seconds: f64,
    /// Device and precision.
    #[serde(flatten)]
    pub solved_on: SolvedOn,
    /// Results per slope.
    pub slopes: Vec<OnSlope>,
}

/// Results on one slope.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct OnSlope {
    /// Rise over run.
    pub slope: f64,
    /// Transitions between best gaits, from slow to fast.
    pub transitions: Vec<Transition>,
    /// Best gait at each speed.
    pub best: Vec<AtSpeed>,
    /// Results per gait family.
    pub families: Vec<OfFamily>,
}

/// The best gait at one speed.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct AtSpeed {
    /// Travel speed, m/s.
    pub speed: f64,
    /// Froude number.
    pub froude: f64,
    /// Best certified gait; null if no gait was certified.
    pub best: Option<AtlasPoint>,
    /// Next best family and its relative extra cost (0.1: 10 % more).
    pub next: Option<(GaitFamily, f64)>,
}

/// Results of one gait family.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct OfFamily {
    /// Family.
    pub family: GaitFamily,
    /// Number of problems solved.
    pub solved: usize,
    /// Number of problems with a certified motion.
    pub certified: usize,
    /// Smallest cost at each speed; null where no motion was certified.
    pub cost: Vec<Option<f64>>,
}

impl AtlasResult {
    /// Summarises an atlas that was solved with these settings on this device.
    pub fn new(atlas: &Atlas, settings: &LowerSettings, solved_on: SolvedOn) -> AtlasResult {
        let plan = &atlas.plan;
        let robot = &plan.robot;
        AtlasResult {
            robot: robot.name.clone(),
            base_height: robot.base_height,
            time_scale: time_scale(robot),
            speed_scale: speed_scale(robot),
            periods: plan.periods.clone(),
            duties: plan.duties.clone(),
            speeds: plan.speeds.clone(),
            even_seconds: plan.even,
            cost: plan.weights,
            settings: settings.clone(),
            problems: atlas.problems,
            solved: atlas.points.len(),
            certified: atlas.certified(),
            left_out: atlas.left_out,
            seconds: atlas.seconds,
            solved_on,
            slopes: plan.slopes.iter().map(|&slope| OnSlope::new(atlas, slope)).collect(),
        }
    }

    /// Text for the terminal.
    pub fn text(&self) -> String {
        let mut text = format!(
            "{}: {} of {} problems certified in {:.1} s ({}), {} combinations left out\n",
            self.robot, self.certified, self.solved, self.seconds, self.solved_on.device, self.left_out
        );
        for on in &self.slopes {
            text += &format!("slope {}\n", on.slope);
            for at in &on.best {
                let gait = match &at.best {
                    Some(p) => format!(
                        "{:<17} costs {:.3}, period {:.3} s, duty {:.2}",
                        p.family.name(),
                        p.total().unwrap_or(f64::NAN),
                        p.period,
                        p.duty
                    ),
                    None => "no gait".into(),
                };
                let next = at.next.map(|(family, more)| format!(", {} {:.0} % more", family.name(), 100. * more)).unwrap_or_default();
                text += &format!("  {:.3} m/s (Froude {:.3})  {gait}{next}\n", at.speed, at.froude);
            }
            for t in &on.transitions {
                text += &format!("  {} to {} at {:.3} m/s (Froude {:.3})\n", name(t.from), name(t.to), t.speed, t.froude);
            }
        }
        text
    }
}

impl OnSlope {
    fn new(atlas: &Atlas, slope: f64) -> OnSlope {
        let plan = &atlas.plan;
        let families: Vec<OfFamily> = plan
            .families
            .iter()
            .map(|&family| {
                let solved = || atlas.points.iter().filter(|p| p.family == family && p.slope == slope);
                let cost = atlas.curve(family, slope).into_iter().map(|p| p.and_then(AtlasPoint::total)).collect();
                OfFamily { family, solved: solved().count(), certified: solved().filter(|p| p.certified).count(), cost }
            })
            .collect();
        let at = |(i, best): (usize, Option<&AtlasPoint>)| {
            let others = families.iter().filter(|f| best.is_some_and(|b| b.family != f.family));
            let next = others.filter_map(|f| Some((f.family, f.cost[i]?))).min_by(|a, b| a.1.total_cmp(&b.1));
            let more = |cost: f64| best.and_then(AtlasPoint::total).map(|least| cost / least - 1.);
            let next = next.and_then(|(family, cost)| Some((family, more(cost)?)));
            AtSpeed { speed: plan.speeds[i], froude: froude(&plan.robot, plan.speeds[i]), best: best.cloned(), next }
        };
        OnSlope {
            slope,
            transitions: atlas.transitions(slope),
            best: atlas.best(slope).into_iter().enumerate().map(at).collect(),
            families,
        }
    }
}

/// Name of a family, or "no gait".
pub fn name(family: Option<GaitFamily>) -> &'static str {
    family.map_or("no gait", GaitFamily::name)
}
