//! Diagnosis of a search that found no gait: rows that the best candidate violates, and single changes that make a gait feasible.

use super::evaluate::{Cancelled, Evaluated, LowerSettings, evaluate};
use super::{Gait, Gaits};
use crate::backend::Backend;
use crate::error::Result;
use crate::gait::Schedule;
use crate::gait::family::{PeriodicGait, default_families};
use crate::nlp::transcription::{force_limit, legs};
use crate::robot::Robot;
use crate::settings::Transcription;
use crate::task::{Goal, Task};
use crate::terrain::Terrain;
use crate::verify::RowReport;
use crate::verify::report::CheckFamily;
use serde::Serialize;
use std::sync::Arc;
use std::time::{Duration, Instant};

/// Number of families whose typical gaits are tried in addition to the best candidate.
const TYPICAL_GAITS: usize = 1;

/// Violated rows of one family.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct ViolatedFamily {
    /// Family of the rows.
    pub family: CheckFamily,
    /// Number of violated rows.
    pub violated: usize,
    /// Total number of rows of the family.
    pub rows: usize,
    /// Name of the worst row.
    pub row: String,
    /// Violation of the worst row, in its unit.
    #[cfg_attr(feature = "schema", schemars(with = "Option<f64>"))]
    pub violation: f64,
    /// Unit of the family.
    pub unit: &'static str,
    /// Foot of the worst row; `None` for the base.
    pub foot: Option<usize>,
    /// Time of the worst row, s.
    pub time: f64,
    /// Advice to satisfy such rows.
    pub remedy: &'static str,
}

/// Change of the task or its limits, with the result of trying it.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Relaxation {
    /// Description of the change, e.g. `10 % more reach`.
    pub change: String,
    /// Setting that makes the change, with its value.
    pub setting: String,
    /// True if a gait was found with this change.
    pub feasible: bool,
    /// Smallest number of violated rows with this change.
    pub n_violated: usize,
}

impl Relaxation {
    /// Ground with a share of the relief on which the search found a gait.
    pub fn relief(share: f64) -> Relaxation {
        let change = format!("{:.1} % of the height differences of the ground", 100. * share);
        Relaxation { change, setting: "another terrain".into(), feasible: true, n_violated: 0 }
    }
}

/// Diagnosis of a search that found no gait.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Diagnosis {
    /// Rows that the best candidate violates, by family.
    pub broken: Vec<ViolatedFamily>,
    /// Changes that were tried, each alone.
    pub relaxations: Vec<Relaxation>,
}

impl std::fmt::Display for Diagnosis {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        writeln!(f, "rows that the nearest candidate violates")?;
        for b in &self.broken {
            let foot = b.foot.map(|foot| format!(", foot {foot}")).unwrap_or_default();
            writeln!(
                f,
                "- {}: {} of {} rows, worst: {} by {:.3e} ({}){foot} at {:.3} s; {}",
                b.family, b.violated, b.rows, b.row, b.violation, b.unit, b.time, b.remedy
            )?;
        }
        let (enough, short): (Vec<&Relaxation>, Vec<&Relaxation>) = self.relaxations.iter().partition(|r| r.feasible);
        for r in &enough {
            writeln!(f, "a gait is found with {} ({})", r.change, r.setting)?;
        }
        if !short.is_empty() {
            let names: Vec<String> = short.iter().map(|r| format!("{} ({} rows violated)", r.change, r.n_violated)).collect();
            writeln!(f, "not sufficient alone: {}", names.join(", "))?;
        }
        Ok(())
    }
}

/// Advice to satisfy the rows of a family.
///
/// * `row` - name of the worst row
fn remedy(family: CheckFamily, row: &str) -> &'static str {
    let has = |part: &str| row.contains(part);
    match family {
        CheckFamily::Dynamics | CheckFamily::Momentum | CheckFamily::BaseAcceleration => {
            "the forces cannot move the base like this: more time, phases with more feet on the ground, a larger force limit or more friction"
        }
        CheckFamily::Reach => "a larger `reach`, more and shorter steps in more time, or a nearer goal",
        CheckFamily::Terrain => "more `transcription.clearance`, or other phases",
        CheckFamily::Force if has("limit") => "a larger force limit, or phases with more feet on the ground",
        CheckFamily::Force if has("friction") => "more `friction` of the terrain, more time, or another path",
        CheckFamily::Force => "more time, or other phases",
        CheckFamily::Swing if has("too low") => "a smaller `transcription.clearance`, or a longer swing",
        CheckFamily::Swing if has("too high") => "a larger `transcription.swing_height`",
        CheckFamily::Swing if has("too fast") => "a larger `transcription.foot_speed`, more time, or a nearer goal",
        CheckFamily::Swing => "a larger `transcription.foot_acceleration`, longer swings, or a smaller `transcription.clearance`",
        CheckFamily::Bounds => "another start or goal",
        CheckFamily::Structure => "other phases",
        CheckFamily::Possible => "more time, longer phases, or a goal above the ground",
        CheckFamily::Motion if has("terrain") => {
            "more `transcription.swing_height` or `transcription.clearance`, so that feet pass over the edge"
        }
        CheckFamily::Motion => "a shorter `transcription.interval`",
        CheckFamily::Sole if has("pressure") => "a longer or wider `sole`, more time, or phases with more feet on the ground",
        CheckFamily::Sole if has("torsion") => "more `friction` of the terrain, or more time",
        CheckFamily::Sole if has("turned") => "a larger `turn` of the `sole`, more and shorter steps, or more time",
        CheckFamily::Sole if has("overlap") => "a `reach` that keeps the feet apart, or another goal",
        CheckFamily::Sole => "more `transcription.clearance`, or flatter ground",
        CheckFamily::Footing => "more `transcription.clearance`, a smaller `foot_radius` of the robot, or other phases",
    }
}

/// Violated rows of a certificate by family, the family with the largest violated share first.
pub fn violated_families(report: &RowReport) -> Vec<ViolatedFamily> {
    let violated = report.families.iter().filter(|f| f.violated > 0);
    let mut all: Vec<ViolatedFamily> = violated
        .filter_map(|f| {
            let worst = f.worst.as_ref()?;
            Some(ViolatedFamily {
                family: f.family,
                violated: f.violated,
                rows: f.rows,
                row: worst.row.clone(),
                violation: worst.violation,
                unit: f.unit,
                foot: worst.foot,
                time: worst.time,
                remedy: remedy(f.family, &worst.row),
            })
        })
        .collect();
    all.sort_by(|a, b| (b.violated * a.rows).cmp(&(a.violated * b.rows)));
    all
}

/// Task and settings with one change that makes a gait easier to find.
struct Relaxed {
    change: &'static str,
    setting: String,
    task: Task,
    lower: LowerSettings,
    /// Factor on all durations.
    longer: f64,
}

/// Changes that are tried.
fn relaxed(task: &Task, lower: &LowerSettings) -> Vec<Relaxed> {
    let limit = force_limit(&lower.transcription, task);
    let same = |change, setting: String| Relaxed { change, setting, task: task.clone(), lower: lower.clone(), longer: 1. };
    let reach = |percent: f64, change| {
        let reach = task.robot.reach.scaled(1. + percent / 100.);
        let mut relaxed = same(change, format!("robot `reach` {reach}"));
        // The limits of the legs stay the same.
        relaxed.task.robot = Arc::new(Robot { reach, ..Robot::clone(&task.robot) });
        relaxed
    };
    let longer = match task.duration {
        None => Relaxed { longer: 1.3, ..same("30 % more time", "longer phases, `--gait` with a file of them".into()) },
        Some(duration) => {
            let mut later = same("30 % more time", format!("`time` of arrival {:.3} s later", 0.3 * duration));
            later.task.duration = Some(1.3 * duration);
            later
        }
    };
    let friction = 1.5 * task.terrain.friction;
    let mut grip = same("50 % more friction", format!("terrain `friction` {friction:.3}"));
    grip.task.terrain = Arc::new(Terrain { friction, ..Terrain::clone(&task.terrain) });
    let mut strong = same("a 50 % larger force limit", format!("`--force-limit {:.1}`", 1.5 * limit));
    strong.task.force_limit = Some(1.5 * limit);
    let mut all = vec![strong, longer, reach(10., "10 % more reach"), reach(30., "30 % more reach"), grip];
    if lower.transcription.rows == Transcription::Momentum {
        let settings = &lower.transcription;
        let speed = 1.5 * legs::foot_speed(settings, &task.robot);
        let acceleration = legs::foot_acceleration(settings, &task.robot).map(|a| 1.5 * a);
        let also = acceleration.map(|a| format!(" --set transcription.foot_acceleration={a:.1}")).unwrap_or_default();
        let mut quick = same("50 % quicker feet", format!("`--set transcription.foot_speed={speed:.2}{also}`"));
        quick.lower.transcription.foot_speed = Some(speed);
        quick.lower.transcription.foot_acceleration = acceleration;
        let height = 2. * settings.swing_height;
        let mut high = same("swings twice as high", format!("`--set transcription.swing_height={height}`"));
        high.lower.transcription.swing_height = height;
        all.extend([quick, high]);
    }
    let [x, y, _, _, _, yaw] = task.line(0.5);
    if task.displacement() != [0.; 2]
        && let Ok(half) = task.to(Goal { time: task.duration, ..Goal::at(x, y).yaw(yaw) })
    {
        let near = same("a goal half as far", format!("`--goal {x:.3},{y:.3} --yaw {yaw:.3}`"));
        all.push(Relaxed { task: half, ..near });
    }
    all
}

/// Schedules that are tried with a change: that of the best candidate and, if the search is over families, typical gaits of
/// [`TYPICAL_GAITS`] families.
fn schedules(gait: &Gait, gaits: &Gaits, relaxed: &Relaxed) -> Vec<Schedule> {
    let longer = |schedule: &Schedule| {
        let durations = schedule.durations().iter().map(|foot| foot.iter().map(|d| d * relaxed.longer).collect()).collect();
        Schedule::new(durations).ok()
    };
    let families = match gaits {
        Gaits::All => default_families(&relaxed.task.robot),
        Gaits::Families(own) => own.clone(),
        Gaits::Free | Gaits::Around(_) => Vec::new(),
    };
    let typical =
        families.into_iter().take(TYPICAL_GAITS).filter_map(|family| PeriodicGait::typical(family, &relaxed.task).ok()?.schedule().ok());
    std::iter::once(Schedule::clone(gait.schedule())).chain(typical).filter_map(|schedule| longer(&schedule)).collect()
}

/// Diagnoses a search that found no gait: the rows that its best candidate violates and the single changes that give a gait.
///
/// * `gait` - best candidate of the search
/// * `gaits`, `lower` - settings of the search
/// * `limit` - time after which no further change is tried
///
/// # Errors
/// Errors of [`evaluate`].
pub fn diagnose(
    task: &Task,
    gait: &Gait,
    gaits: &Gaits,
    lower: &LowerSettings,
    backend: &dyn Backend,
    limit: Duration,
    cancelled: Cancelled,
) -> Result<Diagnosis> {
    let start = Instant::now();
    let over = || cancelled() || start.elapsed() > limit;
    let mut relaxations = Vec::new();
    for relaxed in relaxed(task, lower) {
        if over() {
            break;
        }
        let schedules = schedules(gait, gaits, &relaxed);
        let candidates: Vec<(&Task, &Schedule)> = schedules.iter().map(|schedule| (&relaxed.task, schedule)).collect();
        let results = evaluate(&candidates, &relaxed.lower, None, backend, true, &over)?;
        let solved: Vec<&Evaluated> = results.iter().flatten().collect();
        let Some(n_violated) = solved.iter().map(|s| s.n_violated).min() else { continue };
        let feasible = solved.iter().any(|s| s.feasible);
        relaxations.push(Relaxation { change: relaxed.change.into(), setting: relaxed.setting, feasible, n_violated });
    }
    Ok(Diagnosis { broken: violated_families(gait.certificate()), relaxations })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::backend::Cpu;
    use crate::search::Search;

    #[test]
    fn a_force_limit_that_is_too_small_is_distinguished_from_other_causes() {
        // The force limit of 0.24 weights per foot is too small for standing; 0.36 is enough.
        let robot = Robot::named("anymal").unwrap();
        let limit = 0.24 * robot.weight();
        let task = Task { force_limit: Some(limit), ..Task::new(robot, Terrain::flat(), Goal::position([0., 0., 0.5])).unwrap() };
        let (backend, lower) = (Cpu::new(0).unwrap(), LowerSettings::default());
        let mut search = Search::new(&task).population(4).generations(0);
        search.settings.further_generations = 0;
        let found = search.run(&backend).unwrap();
        assert!(!found.best.feasible());
        let limit = Duration::from_secs(60);
        let diagnosis = diagnose(&task, &found.best, &Gaits::All, &lower, &backend, limit, &|| false).unwrap();
        assert!(!diagnosis.broken.is_empty() && diagnosis.broken.iter().all(|b| b.violated > 0 && !b.remedy.is_empty()));
        let enough: Vec<&str> = diagnosis.relaxations.iter().filter(|r| r.feasible).map(|r| &r.change[..]).collect();
        assert_eq!(enough, ["a 50 % larger force limit"], "{diagnosis}");
        assert!(diagnosis.to_string().contains("a gait is found with a 50 % larger force limit (`--force-limit 104.1`)"), "{diagnosis}");
        // A cancelled diagnosis tries no changes.
        let none = diagnose(&task, &found.best, &Gaits::All, &lower, &backend, limit, &|| true).unwrap();
        assert_eq!(none, Diagnosis { relaxations: Vec::new(), ..diagnosis });
    }
}
