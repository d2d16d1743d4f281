//! Missions: a task with waypoints, searched in stages.

use super::label::Provenance;
use super::request::{Mission, ProgressEvent, Request, Waypoint};
use super::save::{left_over, stage_folder};
use super::stage::MissionStage;
use crate::backend::Backend;
use crate::error::{Error, Result};
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
        self.check_times()?;
        let mut request = request.clone();
        request.at_robot(&self.task.robot);
        let mut stages: Vec<MissionStage> = Vec::new();
        let mut elapsed = 0.;
        while stages.len() < self.stages()
            && stages.last().is_none_or(|before| before.found.best.feasible() && !cancelled.load(Ordering::Relaxed))
        {
            let number = stages.len() + 1;
            let part = Mission {
                task: self.stage_task(number, stages.last().map(|before| before.found.best.trajectory()), elapsed)?,
                waypoints: Vec::new(),
                provenance: if number == self.stages() { self.provenance } else { Provenance::default() },
            };
            let folder = out.map(|out| stage_folder(out, number, self.stages()));
            let stage = MissionStage::search(part, &request, folder.as_deref(), backend, cancelled, on_event)?;
            folder.as_deref().map_or(Ok(()), |folder| stage.write(folder))?;
            on_stage(&stage, folder.as_deref())?;
            elapsed += stage.found.best.trajectory().horizon;
            stages.push(stage);
        }
        for folder in out.map(|out| left_over(out, stages.len(), self.stages())).unwrap_or_default() {
            warn!("warning: {} has the motion of an earlier run", folder.display());
        }
        Ok(stages)
    }

    /// Task of a stage: from the start, or from the end of the stage before, to the next waypoint or the goal.
    ///
    /// * `elapsed` - duration of the stages before, s
    fn stage_task(&self, number: usize, before: Option<&Trajectory>, elapsed: f64) -> Result<Task> {
        let task = before.map_or_else(|| Ok(self.task.clone()), |motion| self.task.after(motion))?;
        let (place, task) = match self.waypoints.get(number - 1) {
            None => ("goal".into(), task),
            Some(&Waypoint { goal, turns_evenly }) => {
                let place = format!("waypoint {number}");
                let part = 1. / (self.stages() + 1 - number) as f64;
                let goal = if turns_evenly { goal.yaw(task.line(part)[5]) } else { goal };
                let task = task.to(goal).map_err(|e| e.within(&place))?;
                (place, task)
            }
        };
        let Some(time) = task.duration else { return Ok(task) };
        if time <= elapsed {
            let limit = format!("later than {elapsed:.3} s, the end of the motion before");
            return Err(Error::invalid(format!("{place}: time"), time, limit));
        }
        let task = Task { duration: Some(time - elapsed), ..task };
        task.validate().map_err(|e| e.within(place))?;
        Ok(task)
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

    /// Two places for a biped, with times of arrival.
    fn timed(waypoint: Goal, goal: Goal) -> Mission {
        Mission::new(Task::new(Robot::named("biped").unwrap(), Terrain::flat(), goal).unwrap()).by_way_of(waypoint)
    }

    fn first() -> Request {
        Request { search: SearchSettings { first: true, ..SearchSettings::default() }, ..Request::default() }
    }

    #[test]
    fn the_base_is_at_waypoints_with_their_poses_at_their_times() {
        let waypoint = Goal { velocity: [0.1, 0., 0.], ..Goal::position([0.25, 0.05, 0.63]) }.yaw(0.2).arriving(1.23);
        let stages = timed(waypoint, Goal::at(0.4, 0.).arriving(2.9)).search(&first(), &Cpu::new(2).unwrap()).unwrap();
        let motions: Vec<&Trajectory> = stages.iter().map(|stage| stage.found.best.trajectory()).collect();
        assert!(stages.iter().all(|stage| stage.found.best.feasible()) && stages.len() == 2);
        assert!((motions[0].horizon - 1.23).abs() < 1e-9 && (motions[0].horizon + motions[1].horizon - 2.9).abs() < 1e-9);
        let (end, next) = (motions[0].end_state(), motions[1].init_base.unwrap());
        for (value, asked) in end.position.iter().zip([0.25, 0.05, 0.63]).chain([(&end.yaw(), 0.2), (&end.velocity[0], 0.1)]) {
            assert!((value - asked).abs() < 1e-3, "{end:?}");
        }
        assert!(next.iter().zip(end.position).all(|(next, end)| (next - end).abs() < 1e-9));
    }

    #[test]
    fn times_that_do_not_increase_or_are_too_early_name_the_place() {
        let cpu = Cpu::new(1).unwrap();
        let refused = |mission: Mission| mission.search(&first(), &cpu).err().map(|e| e.to_string()).unwrap_or_default();
        let error = refused(timed(Goal::at(0.2, 0.).arriving(2.), Goal::at(0.4, 0.).arriving(1.5)));
        assert_eq!(error, "goal: time: 1.5, but it must be later than 2 s, the time before it");
        // The time of the first stage is free, so that its end is known only after its search.
        let error = refused(timed(Goal::at(0.2, 0.), Goal::at(0.4, 0.).arriving(0.06)));
        assert!(
            error.starts_with("goal: time: 0.06, but it must be later than") && error.ends_with("the end of the motion before"),
            "{error}"
        );
        for time in [-1., 0.01, 121., f64::NAN] {
            let error = refused(timed(Goal::at(0.2, 0.).arriving(time), Goal::at(0.4, 0.)));
            assert!(error.contains("waypoint 1") && error.contains("time"), "{error}");
        }
    }

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
