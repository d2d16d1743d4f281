//! Searches of `solve`, each from where the robot stands to the next place on its way: what was asked, what was found, and its files.

use super::label::{label, world_of};
use super::scenario_file::{ScenarioFile, Start, of_state, table_of};
use super::to_json;
use crate::backend::Backend;
use crate::error::{Error, Result};
use crate::gait::Trajectory;
use crate::nlp::transcription;
use crate::refine::RefineSettings;
use crate::report::joints::{self, JointLimits};
use crate::report::motion_plot::MotionPlot;
use crate::report::result::{Refinement, Run, SolvedOn};
use crate::report::verdict::verdict;
use crate::report::{SolveResult, files};
use crate::robot::Robot;
use crate::scenario::Scenario;
use crate::search::diagnosis::{Diagnosis, diagnose};
use crate::search::evaluate::LowerSettings;
use crate::search::precheck::{Finding, precheck};
use crate::search::{Gait, Search, SearchEvent, SearchResult, SearchSettings};
use crate::task::{Goal, Task};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};
use tracing::warn;

/// What a search is asked besides its task.
#[derive(Debug, Clone)]
pub struct Asking {
    /// Seed of all random numbers.
    pub seed: u64,
    /// The upper level.
    pub search: SearchSettings,
    /// The lower level.
    pub lower: LowerSettings,
    /// Whether the gait is refined.
    pub refines: bool,
    /// How.
    pub refine: RefineSettings,
}

impl Asking {
    /// Settles what depends on the robot, so that the result says which it was.
    pub fn at_robot(&mut self, robot: &Robot) {
        let transcription = &mut self.lower.transcription;
        transcription.interval = Some(transcription::interval(transcription, robot));
    }
}

/// Scenario that a task is of, and its target, where they were named.
pub type Named = (Option<&'static str>, Option<usize>);

/// What is to be done: a task, and where to stop on the way.
#[derive(Debug, Clone)]
pub struct Way {
    /// From the start to the goal.
    pub task: Task,
    /// Places to stop at, in order, and whether the yaw there is on the way to the one at the goal instead of its own.
    pub places: Vec<(Goal, bool)>,
    /// What it was called.
    pub named: Named,
}

impl Way {
    /// Number of its legs.
    pub fn legs(&self) -> usize {
        self.places.len() + 1
    }

    /// Searches leg by leg until one has no gait, or the end is asked for.
    ///
    /// * `out` - folder for their files
    /// * `cancelled` - ends the search that runs with its best so far
    /// * `tell` - is told how it goes
    /// * `each` - gets each leg when its files are written, and their folder
    ///
    /// # Errors
    /// As [`Leg::search`], and for a place that cannot be.
    pub fn search(
        &self,
        asking: &Asking,
        out: Option<&Path>,
        backend: &dyn Backend,
        cancelled: &AtomicBool,
        tell: &mut (dyn FnMut(News) + Send),
        each: &mut dyn FnMut(&Leg, Option<&Path>) -> Result<()>,
    ) -> Result<Vec<Leg>> {
        let mut asking = asking.clone();
        asking.at_robot(&self.task.robot);
        let mut legs: Vec<Leg> = Vec::new();
        while legs.len() < self.legs()
            && legs.last().is_none_or(|before| before.found.best.feasible() && !cancelled.load(Ordering::Relaxed))
        {
            let number = legs.len() + 1;
            let task = self.leg(number, legs.last().map(|before| before.found.best.trajectory()))?;
            let folder = out.map(|out| leg_folder(out, number, self.legs()));
            let named = if number == self.legs() { self.named } else { (None, None) };
            let leg = Leg::search(task, named, &asking, folder.as_deref(), backend, cancelled, tell)?;
            folder.as_deref().map_or(Ok(()), |folder| leg.write(folder))?;
            each(&leg, folder.as_deref())?;
            legs.push(leg);
        }
        for folder in out.map(|out| left_over(out, legs.len(), self.legs())).unwrap_or_default() {
            warn!("warning: {} has the motion of an earlier run", folder.display());
        }
        Ok(legs)
    }

    /// The task of a leg: from the start, or where the leg before ends, to the next place.
    fn leg(&self, number: usize, before: Option<&Trajectory>) -> Result<Task> {
        let task = before.map_or_else(|| Ok(self.task.clone()), |motion| self.task.after(motion))?;
        let Some(&(goal, turns_evenly)) = self.places.get(number - 1) else { return Ok(task) };
        let part = 1. / (self.legs() + 1 - number) as f64;
        let goal = if turns_evenly { goal.yaw(task.line(part)[5]) } else { goal };
        task.to(goal).map_err(|e| e.within(format_args!("place {number} on the way")))
    }
}

/// Folder of a leg of some: its own where there are others.
pub fn leg_folder(out: &Path, number: usize, count: usize) -> PathBuf {
    if count == 1 { out.to_owned() } else { out.join(format!("leg-{number}")) }
}

/// File of a leg of some: with its number where there are others.
pub fn leg_file(path: &Path, number: usize, count: usize) -> PathBuf {
    let (stem, extension) = (path.file_stem().unwrap_or_default(), path.extension().unwrap_or_default());
    let numbered = || path.with_file_name(format!("{}-leg-{number}.{}", stem.to_string_lossy(), extension.to_string_lossy()));
    if count == 1 { path.to_owned() } else { numbered() }
}

/// What is told of a search on the way.
pub enum News<'a> {
    /// What stands in the way of a gait without making it impossible.
    Warning(&'a Finding),
    /// It has begun.
    Begun,
    /// How far it is.
    Progress(&'a SearchEvent<'a>),
    /// It has ended; a refinement or a diagnosis may follow.
    Ended,
}

/// A search that has ended.
pub struct Leg {
    /// The task.
    pub task: Task,
    named: Named,
    /// What was asked.
    pub asking: Asking,
    /// What was found.
    pub found: SearchResult,
    /// How it was refined, if it was.
    pub refinement: Option<Refinement>,
    /// How near the gait comes to the limits of the robot's joints, where it has joints.
    joints: Option<JointLimits>,
    /// Why nothing was found.
    pub diagnosis: Option<Diagnosis>,
    warnings: Vec<Finding>,
    solved_on: SolvedOn,
}

impl Leg {
    /// Searches.
    ///
    /// * `named` - the scenario that the task is of, and its target
    /// * `folder` - made, and tried, before any work is done
    /// * `cancelled` - ends it with the best so far
    ///
    /// # Errors
    /// As [`Search::run`], for a task that no gait can do, and for a folder that cannot be written to.
    pub fn search(
        task: Task,
        named: Named,
        asking: &Asking,
        folder: Option<&Path>,
        backend: &dyn Backend,
        cancelled: &AtomicBool,
        tell: &mut (dyn FnMut(News) + Send),
    ) -> Result<Leg> {
        let Asking { seed, search, lower, refines, refine } = asking;
        let warnings = possible(&task, search, lower)?;
        warnings.iter().for_each(|finding| tell(News::Warning(finding)));
        folder.map_or(Ok(()), files::make_folder)?;
        let of = Search::new(&task).settings(search.clone()).lower(lower.clone()).seed(*seed).cancelled_by(cancelled);
        tell(News::Begun);
        let found = of.on_progress(|progress| tell(News::Progress(progress))).run(backend);
        tell(News::Ended);
        let mut found = found?;
        let called_off = || cancelled.load(Ordering::Relaxed);
        let mut refinement = None;
        if *refines && found.best.feasible() {
            let start = Instant::now();
            let (best, refined) = found.best.refined(&task, search, lower, refine, backend, &called_off)?;
            found.best = best;
            refinement = Some(Refinement { refined, settings: refine.clone(), seconds: start.elapsed().as_secs_f64() });
        }
        let joints = joints::limits(found.best.trajectory(), &task.robot)?.filter(|_| found.best.feasible());
        let solved_on = SolvedOn::new(backend, lower.precision);
        let diagnosis = if found.best.feasible() {
            None
        } else {
            let limit = Duration::from_secs_f64(DIAGNOSIS.0 * found.seconds).max(DIAGNOSIS.1);
            Some(diagnose(&task, &found.best, &search.gaits, lower, backend, limit, &called_off)?)
        };
        Ok(Leg { task, named, asking: asking.clone(), found, refinement, joints, diagnosis, warnings, solved_on })
    }

    /// What was asked, for [`Leg::result`].
    pub fn run(&self) -> Run<'_> {
        let Asking { seed, search, lower, .. } = &self.asking;
        let (scenario, target) = self.named;
        Run { scenario, target, task: &self.task, seed: *seed, force_limit: self.force_limit(), search, lower }
    }

    /// What was to be done.
    #[cfg(feature = "python")]
    pub fn way(&self) -> Way {
        Way { task: self.task.clone(), places: Vec::new(), named: self.named }
    }

    /// What is written of it.
    pub fn result<'a>(&'a self, run: &'a Run<'a>) -> SolveResult<'a> {
        SolveResult {
            warnings: self.warnings.clone(),
            joints: self.joints.clone(),
            diagnosis: self.diagnosis.clone(),
            ..SolveResult::new(run, &self.found, self.refinement.as_ref(), self.solved_on.clone())
        }
    }

    /// Largest normal force of a foot, N.
    fn force_limit(&self) -> f64 {
        transcription::force_limit(&self.asking.lower.transcription, &self.task)
    }

    /// The best gait, and the best of other families.
    pub fn gaits(&self) -> impl Iterator<Item = &Gait> {
        std::iter::once(&self.found.best).chain(&self.found.alternatives)
    }

    /// The motion of one of its gaits, which says where it comes from.
    pub fn trajectory(&self, gait: &Gait) -> Trajectory {
        let (scenario, target) = self.named;
        label(gait.trajectory().clone(), &self.task, scenario, target, Some(self.asking.seed))
    }

    /// Writes results, motions and a scenario file that asks for the same again.
    ///
    /// # Errors
    /// [`Error::Io`] when the system refuses.
    pub fn write(&self, folder: &Path) -> Result<()> {
        let text = |gait: &Gait| serde_json::to_string(&self.trajectory(gait));
        let trajectories: Vec<String> = self.gaits().map(text).collect::<std::result::Result<_, _>>()?;
        write_trajectories(folder, &trajectories)?;
        files::write(&folder.join("result.json"), &to_json(&self.result(&self.run()))?)?;
        files::write(&folder.join("scenario.toml"), &self.scenario_file()?.text()?)
    }

    /// A picture of one of its gaits.
    pub fn plot<'a>(&'a self, gait: &'a Gait) -> MotionPlot<'a> {
        let family = gait.family.map(|f| format!("{f}, ")).unwrap_or_default();
        let evaluated = &gait.candidate.solution;
        let cost = evaluated.cost.as_ref().map(|c| format!(", cost {:.3}", c.total)).unwrap_or_default();
        let trajectory = gait.trajectory();
        let title = format!("{family}{:.2} s{cost}, {}", trajectory.horizon, verdict(trajectory, gait.certificate()));
        let (robot, terrain) = (&*self.task.robot, &*self.task.terrain);
        MotionPlot { title, trajectory, robot, terrain, force_limit: self.force_limit() }
    }

    /// A scenario file that asks for the same again, of a built-in scenario or whole.
    fn scenario_file(&self) -> Result<ScenarioFile> {
        let Leg { task, named: (scenario, target), asking: Asking { seed, search, lower, refines, refine }, .. } = self;
        let (robot, terrain) = world_of(task);
        let of_target = |target| Scenario::named((*scenario)?).ok()?.task(target).ok();
        let is_its = target.and_then(of_target).is_some_and(|own| own.goal == task.goal);
        let settings = [
            ("search", table_of(search)?),
            ("transcription", table_of(&lower.transcription)?),
            ("solver", table_of(&lower.solver)?),
            ("refine", table_of(refine)?),
        ];
        Ok(ScenarioFile {
            version: Some(env!("CARGO_PKG_VERSION").into()),
            scenario: scenario.map(Into::into),
            target: *target,
            seed: Some(*seed),
            refine: refines.then_some(true),
            transcription: Some(lower.transcription.rows),
            precision: Some(lower.precision),
            device: Some(device_of(&self.solved_on.device)),
            force_limit: task.force_limit,
            start: Some(Start::in_state(&task.start, &task.start_feet)),
            goal: (!is_its).then(|| of_state(&task.goal)),
            robot: Some(robot),
            terrain: Some(terrain),
            settings: settings.into_iter().map(|(name, table)| (name.into(), toml::Value::Table(table))).collect(),
            ..ScenarioFile::default()
        })
    }
}

/// Part of the time of a search that looking for the reasons of its failure may take, and how long it may take at least.
const DIAGNOSIS: (f64, Duration) = (0.25, Duration::from_secs(2));

/// What stands in the way of a gait without making it impossible.
///
/// # Errors
/// What makes it impossible.
fn possible(task: &Task, settings: &SearchSettings, lower: &LowerSettings) -> Result<Vec<Finding>> {
    let findings = precheck(task, settings, &lower.transcription);
    match findings.iter().find(|finding| finding.certain) {
        Some(certain) => Err(certain.clone().into()),
        None => Ok(findings),
    }
}

/// What `--device` is for a device that a result names: an adapter's name goes up to the first bracket.
fn device_of(named: &str) -> String {
    match named.strip_prefix("gpu: ").and_then(|text| text.split(" (").next()) {
        Some(adapter) => format!("gpu:{adapter}"),
        None => if named.starts_with("gpu") { "gpu" } else { "cpu" }.into(),
    }
}

/// Folders beside those of this run whose motions would pass for its own.
///
/// * `searched` - legs that have a result
/// * `count` - legs that were asked for
pub fn left_over(out: &Path, searched: usize, count: usize) -> Vec<PathBuf> {
    let has_motion = |folder: &PathBuf| folder.join("trajectory.json").is_file();
    let first = if count == 1 { 1 } else { searched + 1 };
    let legs = (first..).map(|number| out.join(format!("leg-{number}"))).take_while(has_motion);
    let whole = Some(out.to_owned()).filter(|out| count > 1 && has_motion(out));
    whole.into_iter().chain(legs).collect()
}

/// Writes the best and its alternatives, and takes away those of an earlier run, which would pass for this one's.
fn write_trajectories(folder: &Path, trajectories: &[String]) -> Result<()> {
    let path = |number: usize| folder.join(if number == 1 { "trajectory.json".into() } else { format!("trajectory-{number}.json") });
    for (number, trajectory) in (1..).zip(trajectories) {
        files::write(&path(number), &format!("{trajectory}\n"))?;
    }
    for path in (trajectories.len() + 1..).map(path).take_while(|path| path.is_file()) {
        std::fs::remove_file(&path).map_err(|source| Error::Io { action: "remove", path, source })?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::backend::Cpu;
    use crate::terrain::Terrain;

    #[test]
    fn legs_behind_the_end_that_was_asked_for_are_not_begun() {
        let task = Task::new(Robot::named("biped").unwrap(), Terrain::flat(), Goal::at(0.4, 0.)).unwrap();
        let way = Way { task, places: vec![(Goal::at(0.2, 0.), true)], named: (None, None) };
        let search = SearchSettings { first: true, ..SearchSettings::default() };
        let asking = Asking { seed: 1, search, lower: LowerSettings::default(), refines: false, refine: RefineSettings::default() };
        let (folder, ended) = (tempfile::tempdir().unwrap(), AtomicBool::new(false));
        let mut each = |_: &Leg, _: Option<&Path>| {
            ended.store(true, Ordering::Relaxed);
            Ok(())
        };
        let legs = way.search(&asking, Some(folder.path()), &Cpu::new(1).unwrap(), &ended, &mut |_| (), &mut each).unwrap();
        assert!(legs.len() == 1 && legs[0].found.best.feasible());
        assert!(folder.path().join("leg-1/trajectory.json").is_file() && !folder.path().join("leg-2").exists());
    }

    #[test]
    fn the_device_of_a_result_can_be_asked_for() {
        assert_eq!(device_of("cpu, 2 threads, f64"), "cpu");
        assert_eq!(device_of("gpu: llvmpipe (LLVM 15.0.6, 256 bits) (vulkan, llvmpipe), f32 closed in f64"), "gpu:llvmpipe");
        assert_eq!(device_of("gpu, Ray's workers of 2 threads, f32 closed in f64"), "gpu");
    }

    #[test]
    fn a_picture_of_a_leg_has_its_number_before_the_ending() {
        let named = |file: &str, count: usize| leg_file(Path::new(file), 2, count).to_string_lossy().into_owned();
        assert_eq!(named("to/run1.5.svg", 3), "to/run1.5-leg-2.svg");
        assert_eq!(named("to/run1.5.svg", 1), "to/run1.5.svg");
    }
}
