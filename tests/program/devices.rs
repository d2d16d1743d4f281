//! `cregopt list` and `cregopt devices`.

use crate::harness::{PROGRAM, Ran, finish, folder, run};
use assert_cmd::Command;
use serde_json::{Value, json};
use std::path::Path;

#[test]
fn list_names_everything() {
    let dir = folder();
    let text = run(dir.path(), "list");
    for name in ["anymal", "pexod-as-published", "chimney-lr", "s3", "hex", "experiment3"] {
        assert!(text.ends_with(0).stdout.contains(name), "{name}");
    }
    let json: Value = serde_json::from_str(&run(dir.path(), "list --json").ends_with(0).stdout).unwrap();
    assert!(json["robots"].as_array().unwrap().contains(&json!("anymal")));
    assert!(json["terrains"].as_array().unwrap().contains(&json!("step")));
    assert_eq!(json["scenarios"][2]["name"], "s3");
    assert_eq!((&json["targets"], &json["presets"][0]["name"]), (&json!(20), &json!("experiment1")));
}

/// Runs the program where no driver is found.
fn run_without_drivers(folder: &Path, command: &str) -> Ran {
    let drivers = ["VK_DRIVER_FILES", "VK_ICD_FILENAMES"].map(|name| (name, "/nowhere.json"));
    finish(Command::new(PROGRAM).args(command.split_whitespace()).current_dir(folder).envs(drivers))
}

#[test]
fn an_unknown_device_is_a_usage_error_and_a_missing_one_exits_5() {
    let dir = folder();
    run(dir.path(), "solve --scenario s1 --device gpuu").ends_with(2).says(&["--device", "gpuu", "auto, cpu, gpu"]);
    run(dir.path(), "solve --scenario s1 --device gpu --precision f64").ends_with(2).says(&["device", "f64"]);
    run(dir.path(), "solve --scenario s1 --device gpu:NoSuchAdapter").ends_with(5).says(&["NoSuchAdapter", "this machine has"]);
    assert!(run(dir.path(), "--help").ends_with(0).stdout.contains("5 no such"));
}

#[test]
#[cfg(target_os = "linux")]
fn without_an_adapter_everything_else_works() {
    let dir = folder();
    let devices = run_without_drivers(dir.path(), "devices");
    assert!(
        devices.ends_with(0).stdout.contains("no adapter") && devices.stdout.contains("--device auto takes the CPU"),
        "{}",
        devices.stdout
    );
    run_without_drivers(dir.path(), "solve --scenario biped --device gpu").ends_with(5).says(&["a GPU was asked for", "no adapter"]);
    // A batch that is large enough to look for an adapter.
    let ran = run_without_drivers(dir.path(), "solve --scenario biped --population 256 --first --json -v");
    ran.ends_with(0).says(&["using the CPU: no hardware GPU found"]);
    let result: Value = serde_json::from_str(&ran.stdout).unwrap();
    assert!(result["device"].as_str().unwrap().starts_with("cpu, "), "{}", result["device"]);
    assert_eq!(result["fallback"], Value::Null);
    // A small batch does not look for one.
    assert_eq!(run_without_drivers(dir.path(), "solve --scenario biped --first").ends_with(0).stderr, "");
}

#[test]
fn devices_lists_adapters_as_text_and_as_json() {
    let dir = folder();
    let text = run(dir.path(), "devices");
    let ran = run(dir.path(), "devices --json");
    let report: Value = serde_json::from_str(&ran.ends_with(0).stdout).unwrap();
    assert_eq!(report["auto_batch"], 64);
    for adapter in report["adapters"].as_array().unwrap() {
        assert!(text.stdout.contains(adapter["name"].as_str().unwrap()));
        assert!(adapter["workgroup_memory"].as_u64().unwrap() >= 16 << 10);
    }
}
