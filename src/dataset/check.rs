//! Check of a data set: everything in its files again, from the hashes to the certificates.

use super::manifest::{FORMAT, MANIFEST, Manifest, RobotEntry, Shard};
use super::record::{Record, SAME_MOTION, frames, motions};
use super::run::Known;
use super::table::{Column, Table, Values};
use crate::app::terms::{TermOverrides, VerificationTerms};
use crate::app::world::World;
use crate::backend::choose::check_threads;
use crate::error::{Error, Result};
use crate::files;
use crate::gait::Trajectory;
use crate::robot::Robot;
use crate::terrain::Terrain;
use rayon::prelude::*;
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};

/// Largest difference between a stored and a computed number, relative to the larger of 1 and its magnitude.
const SAME_NUMBER: f64 = 1e-4;
/// Largest deviation of the norm of a quaternion from 1.
const UNIT: f64 = 1e-5;

/// Result of a check.
#[derive(Debug, Clone)]
pub struct Checked {
    /// The manifest.
    pub manifest: Manifest,
    /// Number of rows of all frames.
    pub rows: usize,
}

/// Checks a data set: manifest, hashes, columns, counts, finite numbers, times at the rate, unit quaternions, contacts against forces, the
/// certificate of every motion, and every number of both tables against the motion. Different motions of a robot are also checked against
/// each other.
///
/// * `threads` - 0: one per processor
///
/// # Errors
/// The first error names file, row, column, value and limit. [`Error::Ended`] if the check was cancelled.
pub fn check(folder: &Path, threads: usize, cancelled: &AtomicBool) -> Result<Checked> {
    let path = folder.join(MANIFEST);
    let manifest = match Manifest::read(folder)? {
        Some(manifest) => manifest,
        None => return Err(Error::invalid("manifest", "absent", "in the folder of a data set").in_file(&path, None)),
    };
    let broken = |place: String, value: String, limit: String| Err(Error::invalid(place, value, limit).in_file(&path, None));
    if manifest.origin.format != FORMAT {
        return broken("origin.format".into(), manifest.origin.format.to_string(), FORMAT.to_string());
    }
    manifest.origin.spec.validate().map_err(|e| e.in_file(&path, None))?;
    for robot in &manifest.origin.robots {
        let own: Vec<&Shard> = manifest.shards.iter().filter(|shard| shard.robot == robot.folder).collect();
        if let Some(i) = (0..own.len()).find(|&i| own[i].number != i) {
            return broken(format!("shards of {}", robot.folder), format!("number {}", own[i].number), format!("number {i}"));
        }
        let total: usize = own.iter().map(|shard| shard.motions).sum();
        let tried: usize = own.iter().map(|shard| shard.draws).sum();
        let all_tried = tried >= manifest.origin.spec.attempts.saturating_mul(robot.count);
        if total > robot.count || manifest.complete && total < robot.count && !all_tried {
            return broken(format!("motions of {}", robot.folder), total.to_string(), format!("{}, the number asked for", robot.count));
        }
    }
    let pool = rayon::ThreadPoolBuilder::new().num_threads(check_threads(threads)?).build();
    let pool = pool.map_err(|e| Error::invalid("threads", threads, format!("a number for which threads start: {e}")))?;
    let mut known: Vec<Known> = manifest.origin.robots.iter().map(|_| Known::default()).collect();
    let mut rows = 0;
    for shard in &manifest.shards {
        if cancelled.load(Ordering::Relaxed) {
            return Err(Error::Ended { message: "stopped before the end of the check".into() });
        }
        let Some(index) = manifest.origin.robots.iter().position(|robot| robot.folder == shard.robot) else {
            return broken("shards".into(), shard.robot.clone(), "the folder of a robot of the data set".into());
        };
        let records = pool.install(|| check_shard(&manifest, &manifest.origin.robots[index], shard, folder))?;
        rows += records.iter().map(|record| record.frames.len()).sum::<usize>();
        for (line, record) in records.into_iter().enumerate() {
            if !known[index].add(&record.ground, record.fingerprint) {
                let error = Error::invalid("motion", format!("within {SAME_MOTION} of an earlier one"), "another motion");
                return Err(error.in_file(&shard.files[2].path(folder)?, Some(line + 1)));
            }
        }
    }
    Ok(Checked { manifest, rows })
}

/// Checks the files of a shard. Returns its records, computed again.
fn check_shard(manifest: &Manifest, robot: &RobotEntry, shard: &Shard, folder: &Path) -> Result<Vec<Record>> {
    let spec = &manifest.origin.spec;
    for file in &shard.files {
        file.check(folder)?;
    }
    let [frames_path, motions_path, gaits_path] = [0, 1, 2].map(|i| shard.files[i].path(folder));
    let (frames_path, motions_path, gaits_path) = (frames_path?, motions_path?, gaits_path?);
    let text = files::read(&gaits_path)?;
    let lines: Vec<(usize, &str)> = files::lines(&text).collect();
    if lines.len() != shard.motions {
        let limit = format!("{}, as in {MANIFEST}", shard.motions);
        return Err(Error::invalid("motions", lines.len(), limit).in_file(&gaits_path, None));
    }
    let records = lines.par_iter().map(|(line, text)| {
        let record = Record::read(text).and_then(|(trajectory, drawn)| {
            check_content(&trajectory, &robot.robot, &manifest.origin.grounds)?;
            Record::certified(trajectory, drawn, spec.rate)
        });
        let record = record.map_err(|e| e.in_file(&gaits_path, Some(*line)))?;
        if record.frames.len() != spec.frames() {
            return Err(Error::invalid("frames", record.frames.len(), spec.frames().to_string()).in_file(&gaits_path, Some(*line)));
        }
        Ok(record)
    });
    let records = records.collect::<Result<Vec<Record>>>()?;
    let (stored, columns) = (Table::read(&frames_path)?, Record::columns_of(&robot.robot));
    compare(&stored, &frames(&records, &columns))
        .and_then(|()| check_frames(&stored, spec.rate))
        .map_err(|e| e.in_file(&frames_path, None))?;
    compare(&Table::read(&motions_path)?, &motions(&records)).map_err(|e| e.in_file(&motions_path, None))?;
    Ok(records)
}

/// Checks that robot and ground of a motion are those of the data set.
fn check_content(trajectory: &Trajectory, robot: &Robot, grounds: &[Terrain]) -> Result<()> {
    let terms = VerificationTerms::new(&World::of(None, None, None), trajectory, &TermOverrides::default())?;
    if *terms.robot != *robot {
        return Err(Error::invalid(
            "robot",
            terms.robot.name.escape_debug(),
            format!("that of {MANIFEST}, `{}`", robot.name.escape_debug()),
        ));
    }
    if !grounds.contains(&terms.terrain) {
        return Err(Error::invalid("terrain", terms.terrain.name.escape_debug(), format!("one of {MANIFEST}")));
    }
    Ok(())
}

/// Compares a stored table with a computed one: columns, types, number of rows, and every value.
fn compare(stored: &Table, computed: &Table) -> Result<()> {
    if stored.columns.len() != computed.columns.len() {
        return Err(Error::invalid("columns", stored.columns.len(), computed.columns.len().to_string()));
    }
    for (Column { name, values }, expected) in stored.columns.iter().zip(&computed.columns) {
        let (own, other) = (&expected.name, &expected.values);
        if name != own || values.kind() != other.kind() || values.len() != other.len() {
            let about = |name: &str, values: &Values| format!("`{name}` of type {}, {} rows", values.kind(), values.len());
            return Err(Error::invalid("column", about(name, values), about(own, other)));
        }
        if let (Values::Text(values), Values::Text(other)) = (values, other) {
            if let Some(row) = (0..values.len()).find(|&row| values[row] != other[row]) {
                return Err(Error::invalid(format!("row {row}, {name}"), values[row].escape_debug(), format!("`{}`", other[row])));
            }
            continue;
        }
        for row in 0..values.len() {
            let [value, expected] = [values, other].map(|values| values.number(row));
            if !value.is_finite() {
                return Err(Error::invalid(format!("row {row}, {name}"), value, "a finite number"));
            }
            let allowed = SAME_NUMBER * expected.abs().max(1.);
            if (value - expected).abs() > allowed {
                return Err(Error::invalid(format!("row {row}, {name}"), value, format!("{expected}, that of the motion")));
            }
        }
    }
    Ok(())
}

/// Checks the frames by themselves: times at the rate, unit quaternions, and contacts against forces.
fn check_frames(table: &Table, rate: f64) -> Result<()> {
    let column = |name: &str| table.column(name).ok_or_else(|| Error::invalid("column", "absent", format!("`{name}`")));
    let (time, frame) = (column("time_s")?, column("frame")?);
    let quaternion = ["w", "x", "y", "z"].map(|part| column(&format!("base_quaternion_{part}")));
    let [w, x, y, z] = quaternion;
    let quaternion = [w?, x?, y?, z?];
    for row in 0..table.rows() {
        let expected = frame.number(row) / rate;
        if (time.number(row) - expected).abs() > 1e-6 {
            return Err(Error::invalid(format!("row {row}, time_s"), time.number(row), format!("{expected}, at {rate} Hz")));
        }
        let norm = quaternion.iter().map(|part| part.number(row).powi(2)).sum::<f64>().sqrt();
        if (norm - 1.).abs() > UNIT {
            return Err(Error::invalid(format!("row {row}, base_quaternion"), format!("norm {norm}"), "1"));
        }
    }
    let feet = table.columns.iter().filter_map(|column| column.name.strip_suffix("_contact"));
    for foot in feet {
        let contact = column(&format!("{foot}_contact"))?;
        let force = ["x", "y", "z"].map(|axis| column(&format!("{foot}_force_{axis}_N")));
        let [x, y, z] = force;
        let force = [x?, y?, z?];
        for row in 0..table.rows() {
            let size = force.iter().map(|part| part.number(row).powi(2)).sum::<f64>().sqrt();
            let flag = contact.number(row);
            if flag != 0. && flag != 1. {
                return Err(Error::invalid(format!("row {row}, {foot}_contact"), flag, "0 or 1"));
            }
            if flag == 0. && size > 1e-3 {
                return Err(Error::invalid(format!("row {row}, {foot}_force"), format!("{size} N in swing"), "0"));
            }
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn table(force: f32, contact: i32, w: f32) -> Table {
        let mut table = Table::default();
        let float = |value: f32| Values::Float(vec![value]);
        table.add("frame", Values::Int(vec![1]));
        table.add("time_s", Values::Double(vec![0.02]));
        for (part, value) in [("w", w), ("x", 0.), ("y", 0.), ("z", 0.)] {
            table.add(format!("base_quaternion_{part}"), float(value));
        }
        table.add("LF_contact", Values::Int(vec![contact]));
        for (axis, value) in [("x", 0.), ("y", 0.), ("z", force)] {
            table.add(format!("LF_force_{axis}_N"), float(value));
        }
        table
    }

    #[test]
    fn frames_that_contradict_themselves_are_refused() {
        let says = |table: &Table, rate: f64| check_frames(table, rate).map_err(|e| e.to_string());
        assert_eq!(says(&table(10., 1, 1.), 50.), Ok(()));
        assert_eq!(says(&table(0., 0, 1.), 50.), Ok(()));
        assert!(says(&table(10., 0, 1.), 50.).unwrap_err().starts_with("row 0, LF_force: 10 N in swing"));
        assert!(says(&table(10., 2, 1.), 50.).unwrap_err().starts_with("row 0, LF_contact: 2"));
        assert!(says(&table(10., 1, 0.5), 50.).unwrap_err().starts_with("row 0, base_quaternion: norm 0.5"));
        assert!(says(&table(10., 1, 1.), 100.).unwrap_err().starts_with("row 0, time_s: 0.02"));
    }

    #[test]
    fn a_changed_number_is_found_by_row_and_column() {
        let (good, mut bad) = (table(10., 1, 1.), table(10., 1, 1.));
        assert!(compare(&good, &good).is_ok());
        bad.columns[9].values = Values::Float(vec![11.]);
        assert_eq!(compare(&bad, &good).unwrap_err().to_string(), "row 0, LF_force_z_N: 11, but it must be 10, that of the motion");
        bad.columns[9].values = Values::Float(vec![f32::NAN]);
        assert!(compare(&bad, &good).unwrap_err().to_string().contains("a finite number"));
        bad.columns[9].name = "LF_force".into();
        assert!(compare(&bad, &good).unwrap_err().to_string().starts_with("column: `LF_force` of type float"));
    }
}
