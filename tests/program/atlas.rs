//! `cregopt atlas`.

use crate::harness::run;
use serde_json::Value;
use std::fs;
use std::path::Path;

/// Exit code, stdout, stderr.
fn atlas(folder: &Path, flags: &str) -> (i32, String, String) {
    let ran = run(folder, &format!("atlas {flags}"));
    (ran.code, ran.stdout, ran.stderr)
}

/// A grid of a few problems.
const SMALL: &str = "--robot biped --speeds 0.6,1.2 --periods 0.6 --duties 0.4,0.6 --seconds 1.2 --device cpu";

#[test]
fn a_small_atlas_writes_a_line_per_problem_a_summary_and_a_picture() {
    let folder = tempfile::tempdir().unwrap();
    let (code, stdout, stderr) = atlas(folder.path(), &format!("{SMALL} --out of"));
    assert_eq!(code, 0, "{stdout}{stderr}");
    assert!(stderr.contains("problems solved") && stdout.contains("Froude"));
    let read = |name: &str| fs::read_to_string(folder.path().join("of").join(name)).unwrap();
    let json: Value = serde_json::from_str(&read("atlas.json")).unwrap();
    // A walk needs the long duty and a run the short one; a hop takes both.
    assert_eq!((&json["problems"], &json["solved"], &json["left_out"]), (&8.into(), &8.into(), &4.into()));
    assert_eq!(read("atlas.csv").lines().count(), 9);
    let level = &json["slopes"][0];
    assert_eq!((level["best"].as_array().unwrap().len(), &level["slope"]), (2, &0.0.into()));
    let svg = read("atlas.svg");
    assert!(svg.starts_with("<svg") && svg.trim_end().ends_with("</svg>"));
    for word in ["biped", "walk", "run", "hop", "Froude number", "travel speed, m/s"] {
        assert!(svg.contains(word), "no `{word}`");
    }
}

#[test]
fn an_atlas_does_not_depend_on_threads() {
    let folder = tempfile::tempdir().unwrap();
    for threads in [1, 2] {
        let (code, _, stderr) = atlas(folder.path(), &format!("{SMALL} --gait walk --threads {threads} --out {threads}"));
        assert_eq!(code, 0, "{stderr}");
    }
    let csv = |threads: &str| fs::read(folder.path().join(threads).join("atlas.csv")).unwrap();
    assert_eq!(csv("1"), csv("2"));
}

#[test]
fn every_slope_has_its_picture_and_weights_can_be_set() {
    let folder = tempfile::tempdir().unwrap();
    let flags = "--robot biped --gait walk --speeds 0.6 --periods 0.6 --duties 0.6 --seconds 1.2 --slopes -0.1,0.1 --set cost.effort=0.5";
    let (code, _, stderr) = atlas(folder.path(), &format!("{flags} --device cpu --out of"));
    assert_eq!(code, 0, "{stderr}");
    assert!(folder.path().join("of/atlas_slope_-0.1.svg").exists() && folder.path().join("of/atlas_slope_0.1.svg").exists());
    let json: Value = serde_json::from_str(&fs::read_to_string(folder.path().join("of/atlas.json")).unwrap()).unwrap();
    assert_eq!(json["cost"]["effort"], 0.5);
    // Uphill the legs do at least the work of lifting the weight.
    assert!(json["slopes"][1]["best"][0]["best"]["cost"]["leg_work"].as_f64().unwrap() > 0.099);
}

#[test]
fn a_long_body_is_parallel_to_the_slope_at_both_ends() {
    let folder = tempfile::tempdir().unwrap();
    let flags = "--robot anymal --gait walk --speeds 0.3 --periods 1 --duties 0.7 --seconds 1 --slopes 0.2 --device cpu --out of";
    let (code, _, stderr) = atlas(folder.path(), flags);
    let json: Value = serde_json::from_str(&fs::read_to_string(folder.path().join("of/atlas.json")).unwrap()).unwrap();
    assert!(code == 0 && json["slopes"][0]["best"][0]["best"]["family"] == "walk", "{stderr}{json}");
}

#[test]
fn impossible_plans_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    for (flags, says) in [
        ("--robot cat", "cat"),
        ("--robot biped --gait trot", "walk, run, hop"),
        ("--robot biped --duties 1.2", "duties"),
        ("--robot biped --speeds -1", "speeds"),
        ("--robot biped --set cost.wings=1", "cost.wings"),
        ("--robot biped --set solver.wings=1", "wings"),
    ] {
        let flags = flags.replace("--speeds -1", "--speeds=-1");
        let (code, _, stderr) = atlas(folder.path(), &flags);
        assert!(code == 2 && stderr.contains(says), "{flags}: {code}, {stderr}");
    }
}

#[test]
fn an_atlas_without_gaits_says_so() {
    let folder = tempfile::tempdir().unwrap();
    // No biped walks 2 m/s with so little time per step.
    let flags = "--robot biped --gait walk --speeds 2 --periods 0.9 --duties 0.6 --device cpu --out of";
    let (code, stdout, _) = atlas(folder.path(), flags);
    assert!(code == 3 && stdout.contains("no gait"), "{code}, {stdout}");
}
