//! Runs the program in temporary folders, and makes files for it.

use assert_cmd::Command;
use serde_json::{Value, json};
use std::fs;
use std::path::{Path, PathBuf};
use std::time::Duration;
use tempfile::TempDir;

pub const PROGRAM: &str = env!("CARGO_BIN_EXE_cregopt");

/// Exit code and output of a run.
pub struct Ran {
    pub code: i32,
    pub stdout: String,
    pub stderr: String,
}

/// Runs a prepared command. The longest run takes a few seconds; the limit is for busy machines.
pub fn finish(command: &mut Command) -> Ran {
    let output = command.timeout(Duration::from_secs(120)).output().unwrap();
    let text = |bytes: Vec<u8>| String::from_utf8(bytes).unwrap();
    // Without an exit code the run was ended by a signal or by the time limit.
    Ran { code: output.status.code().unwrap_or(-1), stdout: text(output.stdout), stderr: text(output.stderr) }
}

/// Runs the program in a folder.
pub fn run_in<S: AsRef<std::ffi::OsStr>>(folder: &Path, args: &[S]) -> Ran {
    finish(Command::new(PROGRAM).args(args).current_dir(folder))
}

/// Runs the program with arguments separated by spaces.
pub fn run(folder: &Path, command: &str) -> Ran {
    run_in(folder, &command.split_whitespace().collect::<Vec<_>>())
}

impl Ran {
    /// Asserts the exit code.
    pub fn ends_with(&self, code: i32) -> &Self {
        assert_eq!(self.code, code, "stdout: {}\nstderr: {}", self.stdout, self.stderr);
        self
    }

    /// Asserts that the error message has every part.
    pub fn says(&self, parts: &[&str]) -> &Self {
        for part in parts {
            assert!(self.stderr.contains(part), "no `{part}` in: {}", self.stderr);
        }
        self
    }
}

/// A new empty folder, deleted when the value is dropped.
pub fn folder() -> TempDir {
    tempfile::tempdir().unwrap()
}

/// Reads a JSON file.
pub fn read(path: impl AsRef<Path>) -> Value {
    serde_json::from_str(&fs::read_to_string(path).unwrap()).unwrap()
}

/// Reads a file of JSON lines.
pub fn read_lines(path: impl AsRef<Path>) -> Vec<Value> {
    fs::read_to_string(path).unwrap().lines().map(|line| serde_json::from_str(line).unwrap()).collect()
}

/// Writes lines to `in.jsonl`.
pub fn write_lines(folder: &Path, lines: &[String]) {
    fs::write(folder.join("in.jsonl"), lines.join("\n") + "\n").unwrap();
}

/// Path of a file in `tests/data`.
pub fn data(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data").join(name)
}

/// Asserts that a folder has nothing but the named files and empty ones.
pub fn assert_holds_only(folder: &Path, names: &[&str]) {
    for entry in fs::read_dir(folder).unwrap() {
        let entry = entry.unwrap();
        let name = entry.file_name().into_string().unwrap();
        let empty = entry.metadata().unwrap().is_file() && entry.metadata().unwrap().len() == 0;
        assert!(names.contains(&name.as_str()) || empty, "{name} was left behind");
    }
}

/// A line for `evaluate`: four feet in stance while the base moves 5 cm. Feasible, and solved in a millisecond.
pub fn standing() -> Value {
    json!({"durations": [[0.6], [0.6], [0.6], [0.6]], "base_target": [0.05, 0.0, 0.5], "yaw_target": 0.0})
}

/// A robot file: a quadruped with ANYmal's dimensions.
pub fn own_robot() -> Value {
    json!({
        "name": "mine", "mass": 30.0, "inertia": [[1.0, 0.0, 0.0], [0.0, 2.0, 0.0], [0.0, 0.0, 2.0]], "base_height": 0.5,
        "nominal_feet": [[0.34, 0.19, -0.42], [0.34, -0.19, -0.42], [-0.34, 0.19, -0.42], [-0.34, -0.19, -0.42]],
        "reach": [0.15, 0.1, 0.1]
    })
}

/// A terrain file: a slope of 5 cm per metre.
pub fn own_terrain() -> Value {
    let heights: Vec<Vec<f64>> = (0..10).map(|i| vec![0.1 * f64::from(i) - 0.5; 2]).collect();
    json!({"name": "ramp", "friction": 0.8, "shape": {"grid": {"low": [-10.0, -10.0], "high": [10.0, 10.0], "heights": heights}}})
}
