//! Stages of a mission: the search to one waypoint or to the goal, and its result.

use super::explain::{check, explain};
use super::label::{Provenance, label};
use super::request::{Mission, ProgressEvent, Request};
use crate::backend::Backend;
use crate::error::Result;
use crate::files;
use crate::gait::Trajectory;
use crate::gait::joints::{self, JointLimits};
use crate::nlp::transcription;
use crate::report::SolveResult;
use crate::report::motion_plot::MotionPlot;
use crate::report::result::{GaitResult, Refinement, SolvedOn};
use crate::report::verdict::verdict;
use crate::search::diagnosis::Diagnosis;
use crate::search::precheck::Finding;
use crate::search::{Gait, Search, SearchResult};
use crate::task::Task;
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;

/// Search of one stage, after its end.
pub struct MissionStage {
    /// Task of the stage.
    pub task: Task,
    /// Scenario that the task was named by.
    pub provenance: Provenance,
    /// Settings of the search.
    pub request: Request,
    /// Best gait, its alternatives, and the course of the search.
    pub found: SearchResult,
    /// Refinement of the best gait, if one was requested and a gait was found.
    pub refinement: Option<Refinement>,
    /// Use of the joint limits along the best gait; `None` without a gait, and for robots without joints.
    pub joints: Option<JointLimits>,
    /// Reasons why no gait was found; `None` if one was.
    pub diagnosis: Option<Diagnosis>,
    /// Findings before the search that made a gait unlikely.
    pub warnings: Vec<Finding>,
    /// Device, and the work that it left to the CPU.
    pub solved_on: SolvedOn,
}

impl MissionStage {
    /// Checks and searches a mission as one stage; its waypoints are ignored.
    ///
    /// * `folder` - folder for the results; created and tried before the search
    /// * `cancelled` - ends the search with the best gait so far when set
    /// * `on_event` - receives warnings and progress
    ///
    /// # Errors
    /// Errors of [`Search::run`], of a task that no gait can do, and of a folder that cannot be written.
    pub fn search(
        Mission { task, provenance, .. }: Mission,
        request: &Request,
        folder: Option<&Path>,
        backend: &dyn Backend,
        cancelled: &AtomicBool,
        on_event: &mut (dyn FnMut(ProgressEvent) + Send),
    ) -> Result<MissionStage> {
        let Request { seed, search, lower, refines, refine } = request;
        let warnings = check(&task, request)?;
        warnings.iter().for_each(|finding| on_event(ProgressEvent::Warning(finding)));
        folder.map_or(Ok(()), files::make_folder)?;
        let of = Search::new(&task).settings(search.clone()).lower(lower.clone()).seed(*seed).cancelled_by(cancelled);
        on_event(ProgressEvent::Started);
        let found = of.on_progress(|progress| on_event(ProgressEvent::Progress(progress))).run(backend);
        on_event(ProgressEvent::Ended);
        let mut found = found?;
        let is_cancelled = || cancelled.load(Ordering::Relaxed);
        let mut refinement = None;
        if *refines && found.best.feasible() {
            let start = Instant::now();
            let (best, refined) = found.best.refined(&task, search, lower, refine, backend, &is_cancelled)?;
            found.best = best;
            refinement = Some(Refinement { refined, settings: refine.clone(), seconds: start.elapsed().as_secs_f64() });
        }
        let joints = joints::limits(found.best.trajectory(), &task.robot, &task.terrain)?.filter(|_| found.best.feasible());
        let solved_on = SolvedOn::new(backend, lower.precision);
        let diagnosis = explain(&task, request, &found, backend, &is_cancelled)?;
        Ok(MissionStage { task, provenance, request: request.clone(), found, refinement, joints, diagnosis, warnings, solved_on })
    }

    /// Mission that consists of this stage.
    pub fn mission(&self) -> Mission {
        Mission { task: self.task.clone(), waypoints: Vec::new(), provenance: self.provenance }
    }

    /// Result as `result.json` has it.
    pub fn result(&self) -> SolveResult<'_> {
        let Request { seed, search, lower, .. } = &self.request;
        let (task, found, best) = (&self.task, &self.found, &self.found.best);
        SolveResult {
            version: env!("CARGO_PKG_VERSION"),
            scenario: self.provenance.scenario,
            target: self.provenance.target,
            seed: *seed,
            force_limit: self.force_limit(),
            search,
            lower,
            robot: &task.robot.name,
            terrain: &task.terrain.name,
            base_target: task.goal.position,
            yaw_target: task.goal.yaw(),
            transcription: lower.transcription.rows,
            solved_on: self.solved_on.clone(),
            feasible: best.feasible(),
            stop: found.stop,
            n_violated: best.candidate.solution.n_violated,
            max_violation: best.candidate.solution.max_violation,
            first_feasible_seconds: found.first_feasible_after,
            seconds: found.seconds,
            warnings: self.warnings.clone(),
            joints: self.joints.clone(),
            diagnosis: self.diagnosis.clone(),
            gait: GaitResult::new(best),
            refinement: self.refinement.as_ref(),
            certificate: best.certificate(),
            alternatives: found.alternatives.iter().map(GaitResult::new).collect(),
            lower_ground: found.lower_ground,
            improvements: &found.improvements,
            generations: &found.generations,
        }
    }

    /// Largest normal force of a foot, N.
    pub(super) fn force_limit(&self) -> f64 {
        transcription::force_limit(&self.request.lower.transcription, &self.task)
    }

    /// Best gait, then the best ones of other families.
    pub fn gaits(&self) -> impl Iterator<Item = &Gait> {
        std::iter::once(&self.found.best).chain(&self.found.alternatives)
    }

    /// Motion of one of the gaits, with robot, terrain, scenario and seed.
    pub fn trajectory(&self, gait: &Gait) -> Trajectory {
        label(gait.trajectory().clone(), &self.task, self.provenance, Some(self.request.seed))
    }

    /// Picture of one of the gaits.
    pub fn plot<'a>(&'a self, gait: &'a Gait) -> MotionPlot<'a> {
        let family = gait.candidate.family.map(|f| format!("{f}, ")).unwrap_or_default();
        let evaluated = &gait.candidate.solution;
        let cost = evaluated.cost.as_ref().map(|c| format!(", cost {:.3}", c.total)).unwrap_or_default();
        let trajectory = gait.trajectory();
        let title = format!("{family}{:.2} s{cost}, {}", trajectory.horizon, verdict(trajectory, gait.certificate()));
        let (robot, terrain) = (&*self.task.robot, &*self.task.terrain);
        MotionPlot { title, trajectory, robot, terrain, force_limit: self.force_limit() }
    }
}
