//! Missions: a task with waypoints, searched in stages.

use super::label::Provenance;
use super::request::{Mission, ProgressEvent, Request, Waypoint};
use super::save::{left_over, stage_folder};
use super::stage::MissionStage;
use crate::backend::Backend;
use crate::error::Result;
use crate::gait::Trajectory;
use crate::task::Task;
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use tracing::warn;

impl Mission {
    /// Searches stage by stage, and ends after the first stage without a gait. Returns the stages that were searched.
    ///
    /// # Errors
    /// Errors of [`MissionStage::search`], and of a waypoint that the base cannot take.
    pub fn search(&self, request: &Request, backend: &dyn Backend) -> Result<Vec<MissionStage>> {
        self.search_with(request, backend, None, &AtomicBool::new(false), &mut |_| (), &mut |_, _| Ok(()))
    }

    /// Searches as [`Mission::search`] does, writes files, reports progress and can be cancelled.
    ///
    /// * `out` - folder for the files of the stages
    /// * `cancelled` - ends the running search with its best gait so far when set; no further stage is searched
    /// * `on_event` - receives events of the searches
    /// * `on_stage` - receives each stage after its files are written, and its folder
    ///
    /// # Errors
    /// Errors of [`Mission::search`], of writing, and of `on_stage`.
    pub fn search_with(
        &self,
        request: &Request,
        backend: &dyn Backend,
        out: Option<&Path>,
        cancelled: &AtomicBool,
        on_event: &mut (dyn FnMut(ProgressEvent) + Send),
        on_stage: &mut dyn FnMut(&MissionStage, Option<&Path>) -> Result<()>,
    ) -> Result<Vec<MissionStage>> {
        let mut request = request.clone();
        request.at_robot(&self.task.robot);
        let mut stages: Vec<MissionStage> = Vec::new();
        while stages.len() < self.stages()
            && stages.last().is_none_or(|before| before.found.best.feasible() && !cancelled.load(Ordering::Relaxed))
        {
            let number = stages.len() + 1;
            let part = Mission {
                task: self.stage_task(number, stages.last().map(|before| before.found.best.trajectory()))?,
                waypoints: Vec::new(),
                provenance: if number == self.stages() { self.provenance } else { Provenance::default() },
            };
            let folder = out.map(|out| stage_folder(out, number, self.stages()));
            let stage = MissionStage::search(part, &request, folder.as_deref(), backend, cancelled, on_event)?;
            folder.as_deref().map_or(Ok(()), |folder| stage.write(folder))?;
            on_stage(&stage, folder.as_deref())?;
            stages.push(stage);
        }
        for folder in out.map(|out| left_over(out, stages.len(), self.stages())).unwrap_or_default() {
            warn!("warning: {} has the motion of an earlier run", folder.display());
        }
        Ok(stages)
    }

    /// Task of a stage: from the start, or from the end of the stage before, to the next waypoint or the goal.
    fn stage_task(&self, number: usize, before: Option<&Trajectory>) -> Result<Task> {
        let task = before.map_or_else(|| Ok(self.task.clone()), |motion| self.task.after(motion))?;
        let Some(&Waypoint { goal, turns_evenly }) = self.waypoints.get(number - 1) else { return Ok(task) };
        let part = 1. / (self.stages() + 1 - number) as f64;
        let goal = if turns_evenly { goal.yaw(task.line(part)[5]) } else { goal };
        task.to(goal).map_err(|e| e.within(format_args!("waypoint {number}")))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::backend::Cpu;
    use crate::robot::Robot;
    use crate::search::SearchSettings;
    use crate::task::Goal;
    use crate::terrain::Terrain;

    #[test]
    fn stages_after_a_cancellation_are_not_searched() {
        let task = Task::new(Robot::named("biped").unwrap(), Terrain::flat(), Goal::at(0.4, 0.)).unwrap();
        let mission = Mission::new(task).by_way_of(Waypoint::at(0.2, 0.));
        let search = SearchSettings { first: true, ..SearchSettings::default() };
        let request = Request { search, ..Request::default() };
        let (folder, cancelled) = (tempfile::tempdir().unwrap(), AtomicBool::new(false));
        let mut on_stage = |_: &MissionStage, _: Option<&Path>| {
            cancelled.store(true, Ordering::Relaxed);
            Ok(())
        };
        let cpu = Cpu::new(1).unwrap();
        let stages = mission.search_with(&request, &cpu, Some(folder.path()), &cancelled, &mut |_| (), &mut on_stage).unwrap();
        assert!(stages.len() == 1 && stages[0].found.best.feasible());
        assert!(folder.path().join("stage-1/trajectory.json").is_file() && !folder.path().join("stage-2").exists());
    }
}
