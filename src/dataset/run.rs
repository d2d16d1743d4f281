//! Generation of a data set: shard by shard, each solved as one batch.

use super::draw::{Draw, common_interval, draw};
use super::manifest::{FileHash, Manifest, Origin, Shard};
use super::record::{COMPARED, Dropped, Record, SAME_MOTION, frames, motions};
use super::spec::{DatasetPlan, Subject};
use super::table::Table;
use crate::backend::{Backend, DeviceChoice};
use crate::error::{Error, Result, from_json, to_json};
use crate::files;
use crate::gait::Schedule;
use crate::search::evaluate::{Evaluated, LowerSettings, evaluate};
use crate::task::Task;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use std::collections::HashMap;
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;
use tracing::debug;

/// Meaning of the columns of the frames, for the metadata of the files.
pub const FRAMES: &str = "SI units, angles in rad, one row per instant, time_s = frame / rate. World frame: z up. Base frame: x forward, y left, \
z up, origin in the centre of mass. base_quaternion: unit, order w, x, y, z, base to world, sign continuous. base_velocity, \
base_angular_velocity: world frame. FOOT_position, FOOT_velocity: contact point, world frame. FOOT_force: force of the ground on the foot, world \
frame, 0 in swing. FOOT_contact: 1 in stance, 0 in swing; at a phase boundary that of the phase that begins. phase: fraction of the stride, 0 to \
1. command: speeds forward and to the left in the frame of the base at constant travel, and yaw rate. JOINT_torque: of the contact forces alone.";

/// Name of the lock in the folder of a data set.
const LOCK: &str = "dataset.lock";

/// Largest number of shards of a robot that are named in advance.
const MOST_NEXT: usize = 1024;

/// Progress after a shard.
#[derive(Debug, Clone, Copy)]
pub struct Progress<'a> {
    /// Shard that was finished.
    pub shard: &'a Shard,
    /// Motions so far, and motions asked for.
    pub motions: [usize; 2],
}

/// Robot and number of a shard.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ShardId {
    /// Index of the robot, as in [`DatasetPlan::subjects`].
    pub robot: usize,
    /// Number of the shard of this robot.
    pub number: usize,
}

/// Certified motions of the draws of a shard, before those that are nearly earlier ones are dropped.
#[derive(Debug, Clone)]
pub struct Drafts {
    records: Vec<Record>,
    counts: Counts,
}

/// Numbers of draws of a shard without a motion, as in [`Shard`].
#[derive(Debug, Clone, Copy, Serialize, Deserialize)]
struct Counts {
    impossible: usize,
    infeasible: usize,
    beyond_joints: usize,
}

/// [`Drafts`] as text: motions as in the file of gaits.
#[derive(Serialize, Deserialize)]
struct DraftsText {
    counts: Counts,
    lines: Vec<String>,
}

impl Drafts {
    /// JSON for [`Drafts::from_json`].
    ///
    /// # Errors
    /// [`Error::Format`] for numbers that JSON cannot represent.
    pub fn to_json(&self) -> Result<String> {
        to_json(&DraftsText { counts: self.counts, lines: self.records.iter().map(Record::line).collect::<Result<_>>()? })
    }

    /// Drafts from the text of another process. Every motion is certified and sampled again.
    ///
    /// * `rate` - frames per second, Hz
    ///
    /// # Errors
    /// [`Error::Format`] for another text; [`Error::Invalid`] for a motion without a certificate.
    pub fn from_json(text: &str, rate: f64) -> Result<Drafts> {
        let DraftsText { counts, lines } = from_json(text)?;
        let record = |line: &String| Record::read(line).and_then(|(trajectory, drawn)| Record::certified(trajectory, drawn, rate));
        Ok(Drafts { records: lines.par_iter().map(record).collect::<Result<_>>()?, counts })
    }
}

/// Motions of a robot so far, for the search of duplicates.
#[derive(Default)]
pub(super) struct Known {
    /// Fingerprints by ground and cell of the position at the end.
    cells: HashMap<(String, [i64; 2]), Vec<Vec<f32>>>,
}

impl Known {
    fn cell(fingerprint: &[f32]) -> [i64; 2] {
        // The last instant begins with the position of the base.
        let part = fingerprint.len() / COMPARED;
        [0, 1].map(|axis| (fingerprint[fingerprint.len() - part + axis] / SAME_MOTION).floor() as i64)
    }

    /// Adds a motion; false if it is nearly one that is there.
    pub fn add(&mut self, ground: &str, fingerprint: Vec<f32>) -> bool {
        let [x, y] = Known::cell(&fingerprint);
        let near = (-1..=1).flat_map(|i| (-1..=1).map(move |j| [x + i, y + j]));
        let same = |cell: [i64; 2]| {
            let others = self.cells.get(&(ground.to_owned(), cell));
            others.is_some_and(|others| others.iter().any(|other| Record::is_same(&fingerprint, other)))
        };
        if near.into_iter().any(same) {
            return false;
        }
        self.cells.entry((ground.to_owned(), [x, y])).or_default().push(fingerprint);
        true
    }
}

/// State of a robot's shards.
struct Course {
    known: Known,
    /// Number of the next shard, and of motions so far.
    next: usize,
    motions: usize,
}

impl Course {
    /// True if no shard is left: all motions are there, or all draws have been tried.
    fn done(&self, plan: &DatasetPlan, subject: &Subject) -> bool {
        self.motions >= subject.count || self.next * plan.spec.shard >= plan.spec.attempts.saturating_mul(subject.count)
    }
}

impl DatasetPlan {
    /// Largest number of problems that are solved at once.
    pub fn batch(&self) -> usize {
        self.spec.shard
    }

    /// Origin of the data that a device makes, without the number of threads, on which nothing depends.
    pub fn origin(&self, device: &DeviceChoice) -> Origin {
        Origin::new(self, format!("{device}, {}", self.settings.precision.described()))
    }

    /// Makes the data set in a folder, or continues it, on a device of this process; see [`DatasetPlan::make_from`].
    ///
    /// * `progress` - called after each shard
    /// * `cancelled` - ends the run; the same call continues it
    ///
    /// # Errors
    /// Errors of [`DatasetPlan::make_from`].
    pub fn make(
        &self,
        folder: &Path,
        backend: &dyn Backend,
        cancelled: &AtomicBool,
        progress: &mut dyn FnMut(Progress),
    ) -> Result<Manifest> {
        self.make_from(folder, &backend.choice(), &mut |next| self.drafts(next[0], backend, cancelled), progress)
    }

    /// Makes the data set in a folder, or continues it, from drafts of its shards. A finished shard is never changed. Returns the manifest;
    /// it has fewer motions than asked for if too few draws are feasible.
    ///
    /// * `device` - device of the solves, for the manifest
    /// * `drafts` - returns the drafts of the first of the given shards, or `None` if the run was cancelled; the others are needed later
    /// * `progress` - called after each shard
    ///
    /// # Errors
    /// [`Error::Invalid`] if the folder has other data or another run uses it, [`Error::Io`] if the system refuses, [`Error::Ended`] if the
    /// run was cancelled, and those of `drafts`.
    pub fn make_from(
        &self,
        folder: &Path,
        device: &DeviceChoice,
        drafts: &mut dyn FnMut(&[ShardId]) -> Result<Option<Drafts>>,
        progress: &mut dyn FnMut(Progress),
    ) -> Result<Manifest> {
        std::fs::create_dir_all(folder).map_err(|source| Error::Io { action: "make the folder", path: folder.to_owned(), source })?;
        let _lock = files::open_alone(&folder.join(LOCK))?;
        let origin = self.origin(device);
        let mut manifest = match Manifest::read(folder)? {
            Some(manifest) => {
                manifest.check_origin(&origin, folder)?;
                manifest
            }
            None => Manifest { origin, complete: false, shards: Vec::new() },
        };
        manifest.write(folder)?;
        self.sweep(folder);
        let mut courses: Vec<Course> = self.subjects.iter().map(|_| Course { known: Known::default(), next: 0, motions: 0 }).collect();
        for shard in &manifest.shards {
            let index = self.subjects.iter().position(|subject| subject.folder == shard.robot);
            let Some(course) = index.map(|index| &mut courses[index]) else { continue };
            self.recall(shard, folder, &mut course.known)?;
            (course.next, course.motions) = (shard.number + 1, course.motions + shard.motions);
        }
        while !manifest.complete {
            let next = self.next(&courses);
            let Some(first) = next.first() else {
                manifest.complete = true;
                manifest.write(folder)?;
                break;
            };
            let Some(drafts) = drafts(&next)? else {
                let [done, all] = [manifest.motions(), manifest.asked()];
                return Err(Error::Ended { message: format!("stopped: {done} of {all} motions made, and the same command continues") });
            };
            let shard = self.shard(*first, drafts, &mut courses[first.robot], folder, &manifest.origin)?;
            manifest.shards.push(shard);
            manifest.write(folder)?;
            let motions = [manifest.motions(), manifest.asked()];
            manifest.shards.last().into_iter().for_each(|shard| progress(Progress { shard, motions }));
        }
        Ok(manifest)
    }

    /// Removes the temporary files of a run that was killed. A file that cannot be removed does no harm.
    fn sweep(&self, folder: &Path) {
        let parts =
            self.subjects.iter().flat_map(|subject| ["frames", "motions", "gaits"].map(|part| folder.join(&subject.folder).join(part)));
        for entry in parts.chain([folder.to_owned()]).filter_map(|path| std::fs::read_dir(path).ok()).flatten().flatten() {
            let name = entry.file_name();
            if name.to_string_lossy().ends_with(".part") && entry.path().is_file() {
                let _ = std::fs::remove_file(entry.path());
            }
        }
    }

    /// Adds the motions of a finished shard to those that are known.
    fn recall(&self, shard: &Shard, folder: &Path, known: &mut Known) -> Result<()> {
        let path = shard.files[2].path(folder)?;
        let text = files::read(&path)?;
        let lines: Vec<(usize, &str)> = files::lines(&text).collect();
        let prints = lines.par_iter().map(|(number, line)| {
            let (trajectory, _) = Record::read(line).map_err(|e| e.in_file(&path, Some(*number)))?;
            Record::print(&trajectory).map_err(|e| e.in_file(&path, Some(*number)))
        });
        for (ground, print) in prints.collect::<Result<Vec<_>>>()? {
            known.add(&ground, print);
        }
        Ok(())
    }

    /// The next shards in their order, at most [`MOST_NEXT`] per robot: those that are needed even if every draw becomes a motion, and at
    /// least one until all robots are done.
    fn next(&self, courses: &[Course]) -> Vec<ShardId> {
        let mut next = Vec::new();
        for (robot, (course, subject)) in courses.iter().zip(&self.subjects).enumerate() {
            if course.done(self, subject) {
                continue;
            }
            let needed = (subject.count - course.motions).div_ceil(self.spec.shard).min(MOST_NEXT);
            next.extend((course.next..course.next + needed).map(|number| ShardId { robot, number }));
        }
        // All robots advance together.
        next.sort_by_key(|id| (id.number, id.robot));
        next
    }

    /// Draws a shard, and solves, certifies and samples its draws; `None` if that was cancelled.
    ///
    /// # Errors
    /// [`Error::Invalid`] if there is no such robot; those of [`evaluate`] and of the export.
    pub fn drafts(&self, id: ShardId, backend: &dyn Backend, cancelled: &AtomicBool) -> Result<Option<Drafts>> {
        let (spec, robots) = (&self.spec, self.subjects.len());
        let Some(subject) = self.subjects.get(id.robot) else {
            return Err(Error::invalid("robot", id.robot, format!("below {robots}, the number of robots")));
        };
        let interval = common_interval(spec.length, &self.settings, &subject.robot);
        let mut settings = self.settings.clone();
        settings.transcription.interval = Some(interval);
        let numbers = id.number * spec.shard..(id.number + 1) * spec.shard;
        let draws: Vec<Draw> = backend.pool().install(|| {
            let drawn: Vec<Option<Draw>> = numbers.into_par_iter().map(|number| draw(self, id.robot, number, &settings)).collect();
            drawn.into_iter().flatten().collect()
        });
        let Some(records) = self.records(&draws, &settings, interval, backend, cancelled)? else { return Ok(None) };
        let count = |reason: Dropped| records.iter().filter(|record| record.as_ref().is_err_and(|dropped| *dropped == reason)).count();
        let [infeasible, beyond_joints] = [Dropped::Infeasible, Dropped::Joints].map(count);
        let counts = Counts { impossible: spec.shard - draws.len(), infeasible, beyond_joints };
        Ok(Some(Drafts { records: records.into_iter().flatten().collect(), counts }))
    }

    /// Makes a shard from its drafts.
    fn shard(&self, id: ShardId, drafts: Drafts, course: &mut Course, folder: &Path, origin: &Origin) -> Result<Shard> {
        let ShardId { robot, number } = id;
        let subject = &self.subjects[robot];
        let (mut kept, mut duplicates) = (Vec::new(), 0);
        for record in drafts.records {
            if course.motions + kept.len() >= subject.count {
                break;
            }
            if course.known.add(&record.ground, record.fingerprint.clone()) {
                kept.push(record);
            } else {
                duplicates += 1;
            }
        }
        let files = self.write(folder, robot, number, &kept, origin)?;
        (course.next, course.motions) = (number + 1, course.motions + kept.len());
        let Counts { impossible, infeasible, beyond_joints } = drafts.counts;
        let (robot, draws, motions) = (subject.folder.clone(), self.spec.shard, kept.len());
        Ok(Shard { robot, number, draws, impossible, infeasible, beyond_joints, duplicates, motions, files })
    }

    /// Solves, certifies and samples draws; `None` if that was cancelled.
    fn records(
        &self,
        draws: &[Draw],
        settings: &LowerSettings,
        interval: f64,
        backend: &dyn Backend,
        cancelled: &AtomicBool,
    ) -> Result<Option<Vec<std::result::Result<Record, Dropped>>>> {
        let candidates: Vec<(&Task, &Schedule)> = draws.iter().map(|draw| (&draw.task, &draw.schedule)).collect();
        let stop = || cancelled.load(Ordering::Relaxed);
        let start = Instant::now();
        let evaluated = evaluate(&candidates, settings, None, backend, false, &stop)?;
        let solved = start.elapsed().as_secs_f64();
        let record = |(draw, evaluated): (&Draw, Option<Evaluated>)| {
            let Some(evaluated) = evaluated else { return Ok(None) };
            Record::new(draw, &evaluated, settings, [self.spec.rate, interval], self.spec.seed, self.spec.joint_limits).map(Some)
        };
        // `None` if one of them was cancelled.
        let records = backend.pool().install(|| draws.par_iter().zip(evaluated).map(record).collect::<Result<Option<Vec<_>>>>());
        debug!(
            "{} problems solved in {solved:.3} s, certified and sampled in {:.3} s",
            draws.len(),
            start.elapsed().as_secs_f64() - solved
        );
        records
    }

    /// Writes the files of a shard.
    fn write(&self, folder: &Path, index: usize, number: usize, records: &[Record], origin: &Origin) -> Result<[FileHash; 3]> {
        let own = &self.subjects[index].folder;
        let columns = Record::columns_of(&self.subjects[index].robot);
        let lines = records.iter().map(Record::line).collect::<Result<String>>()?;
        let with_metadata = |mut table: Table, meaning: &str| -> Result<Vec<u8>> {
            table.metadata = self.metadata(index, number, origin, meaning)?;
            table.bytes()
        };
        let frames = with_metadata(frames(records, &columns), FRAMES)?;
        let motions = with_metadata(motions(records), "one row per motion; `motion` is that of the frames of the same shard")?;
        Ok([
            FileHash::write(folder, format!("{own}/frames/{number:05}.parquet"), &frames)?,
            FileHash::write(folder, format!("{own}/motions/{number:05}.parquet"), &motions)?,
            FileHash::write(folder, format!("{own}/gaits/{number:05}.jsonl"), lines.as_bytes())?,
        ])
    }

    /// Metadata of a file.
    fn metadata(&self, index: usize, number: usize, origin: &Origin, meaning: &str) -> Result<Vec<(String, String)>> {
        let Origin { version, licence, device, spec, settings, .. } = origin;
        let robot = &self.subjects[index].robot;
        let pairs = [
            ("meaning", meaning.to_owned()),
            ("quaternion", "w, x, y, z; base to world".into()),
            ("velocities", "world".into()),
            ("rate", spec.rate.to_string()),
            ("frames", spec.frames().to_string()),
            ("shard", number.to_string()),
            ("licence", licence.clone()),
            ("version", format!("cregopt {version}")),
            ("seed", spec.seed.to_string()),
            ("device", device.clone()),
            ("spec", to_json(spec)?),
            ("settings", to_json(settings)?),
            ("robot", to_json(&**robot)?),
        ];
        Ok(pairs.into_iter().map(|(key, text)| (format!("cregopt.{key}"), text)).collect())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn motions_that_are_nearly_the_same_are_found_across_cells() {
        let mut known = Known::default();
        let print = |x: f32| vec![x; 9 * COMPARED];
        assert!(known.add("flat", print(0.0199)));
        assert!(!known.add("flat", print(0.0201)));
        assert!(known.add("step", print(0.0201)));
        assert!(known.add("flat", print(0.1)) && !known.add("flat", print(0.1)));
    }
}
