//! `cregopt evaluate`.

use crate::harness::{assert_holds_only, folder, read_lines, run, standing, write_lines};
use serde_json::{Value, json};
use std::fs;

#[test]
fn evaluate_keeps_order_and_foreign_keys_and_adds_the_result() {
    let dir = folder();
    let lines: Vec<String> = (0..5)
        .map(|i| {
            let mut line = standing();
            line["note"] = json!(format!("line {i}"));
            line["nested"] = json!({"b": [1, null, 2.5], "a": i});
            line["base_target"][0] = json!(0.01 * f64::from(i));
            line.to_string()
        })
        .collect();
    write_lines(dir.path(), &lines);
    let ran = run(dir.path(), "evaluate in.jsonl --robot anymal --out out.jsonl --trajectories t.jsonl");
    assert!(ran.ends_with(0).stdout.starts_with("5 of 5 candidates feasible"), "{}", ran.stdout);
    let results = read_lines(dir.path().join("out.jsonl"));
    assert_eq!(results.len(), 5);
    for (line, result) in lines.iter().zip(results) {
        let mut rest = result.clone();
        let result = rest.as_object_mut().unwrap().remove("result").unwrap();
        assert_eq!(rest.to_string(), *line, "the same keys in the same order");
        let keys =
            ["status", "feasible", "iterations", "factorizations", "n_violated", "max_violation", "horizon", "n_variables", "seconds"];
        for key in keys {
            assert!(!result[key].is_null(), "no {key}");
        }
        assert_eq!((&result["status"], &result["feasible"], &result["n_violated"]), (&json!("solved"), &json!(true), &json!(0)));
        assert!((result["horizon"].as_f64().unwrap() - 0.6).abs() < 1e-12);
        assert!(result["device"].as_str().unwrap().contains("cpu"));
    }
    let verified = run(dir.path(), "verify t.jsonl");
    assert!(verified.ends_with(0).stdout.contains("5 of 5 trajectories feasible"));
    assert_holds_only(dir.path(), &["in.jsonl", "out.jsonl", "t.jsonl"]);

    let printed = run(dir.path(), "evaluate in.jsonl --robot anymal --json");
    let printed: Vec<Value> = printed.ends_with(0).stdout.lines().map(|line| serde_json::from_str(line).unwrap()).collect();
    assert!(printed.iter().enumerate().all(|(i, line)| line["nested"]["a"] == i && line["result"]["feasible"] == true));
}

#[test]
fn evaluate_takes_scenarios_from_lines_and_flags() {
    let dir = folder();
    let named = json!({"scenario": "biped", "durations": [[0.5], [0.5]], "base_target": [0.0, 0.0, 0.65]});
    let unnamed = json!({"durations": [[0.5], [0.5], [0.5], [0.5]], "base_target": [0.0, 0.0, 0.5]});
    write_lines(dir.path(), &[named.to_string(), String::new(), unnamed.to_string()]);
    run(dir.path(), "evaluate in.jsonl --scenario s1 --out out.jsonl").ends_with(0);
    assert!(read_lines(dir.path().join("out.jsonl")).iter().all(|line| line["result"]["feasible"] == true));
    run(dir.path(), "evaluate in.jsonl --out none.jsonl").ends_with(4).says(&["in.jsonl", "line 3", "robot"]);
    assert_eq!(read_lines(dir.path().join("none.jsonl")).len(), 1);
}

#[test]
fn evaluate_exits_3_when_nothing_is_feasible() {
    let dir = folder();
    let mut far = standing();
    far["base_target"][0] = json!(50.0);
    write_lines(dir.path(), &[far.to_string()]);
    run(dir.path(), "evaluate in.jsonl --robot anymal --out out.jsonl").ends_with(3);
    let result = &read_lines(dir.path().join("out.jsonl"))[0]["result"];
    assert!(result["feasible"] == false && result["n_violated"].as_u64().unwrap() > 0);
}

#[test]
fn a_truncated_line_exits_4_names_file_and_line_and_keeps_the_results_before_it() {
    let dir = folder();
    let good = standing().to_string();
    let bad = good[..good.len() / 2].to_string();
    write_lines(dir.path(), &[good.clone(), good.clone(), bad, good]);
    let ran = run(dir.path(), "evaluate in.jsonl --robot anymal --out out.jsonl --trajectories t.jsonl");
    ran.ends_with(4).says(&["in.jsonl, line 3", "EOF"]);
    let results = read_lines(dir.path().join("out.jsonl"));
    assert!(results.len() == 2 && results.iter().all(|line| line["result"]["feasible"] == true));
    run(dir.path(), "verify t.jsonl").ends_with(0);
}

#[test]
fn a_goal_of_two_numbers_is_at_its_height_above_the_ground() {
    let line = |goal: Value| json!({"scenario": "s1", "base_target": goal, "durations": vec![[2.0]; 4]}).to_string();
    let dir = folder();
    write_lines(
        dir.path(),
        &[line(json!([0.0, 0.0])), line(json!([0.0, 0.0, cregopt::robot::Robot::named("anymal").unwrap().base_height]))],
    );
    run(dir.path(), "evaluate in.jsonl --out out.jsonl").ends_with(0);
    let text = std::fs::read_to_string(dir.path().join("out.jsonl")).unwrap();
    let results: Vec<Value> = text.lines().map(|l| serde_json::from_str::<Value>(l).unwrap()["result"]["cost"].clone()).collect();
    assert_eq!(results[0], results[1]);
    assert_holds_only(dir.path(), &["in.jsonl", "out.jsonl"]);
}

#[test]
fn bad_schedules_exit_4_and_name_file_line_field_value_and_limit() {
    let durations = |durations: Value| json!({"scenario": "s1", "target": 1, "durations": durations}).to_string();
    let feet = |phases: &[f64]| durations(json!(vec![phases; 4]));
    let text = |durations: &str| format!(r#"{{"scenario": "s1", "target": 1, "durations": {durations}}}"#);
    let with = |key: &str, value: Value| {
        let mut line = standing();
        line["scenario"] = json!("s3");
        line[key] = value;
        line.to_string()
    };
    let cases: [(String, &[&str]); 25] = [
        ("nonsense".into(), &["column"]),
        ("[1, 2]".into(), &["map"]),
        ("{}".into(), &["durations"]),
        (durations(json!([])), &["durations", "0 feet", "1 to 8"]),
        (durations(json!([[0.5], [], [0.5], [0.5]])), &["durations, foot 1", "0 phases", "1 to"]),
        (feet(&[0.5, -0.1, 0.5]), &["durations, foot 0, phase 1", "-0.1 s", "at least 0.001 s"]),
        (feet(&[0.5, 0.0, 0.5]), &["durations, foot 0, phase 1", "0 s", "at least 0.001 s"]),
        (durations(json!([[0.5], [null], [0.5], [0.5]])), &["durations", "null"]),
        (durations(json!([[0.5], ["long"], [0.5], [0.5]])), &["durations", "long"]),
        (text("[[0.5], [NaN], [0.5], [0.5]]"), &["column"]),
        (text("[[0.5], [1e999], [0.5], [0.5]]"), &["number out of range", "column"]),
        (feet(&[0.01; 1003]), &["durations, foot 0", "1003 phases", "1 to 1001"]),
        (feet(&[0.1; 999]), &["durations", "3996 phases", "MiB"]),
        // Short phases, but too many at once.
        (feet(&[0.0011; 901]), &["durations", "3604 phases", "MiB"]),
        (feet(&[0.5, 0.5]), &["durations, foot 0", "2 phases", "odd number"]),
        (feet(&[1e300]), &["durations, foot 0", "at most 120 s"]),
        (feet(&[100.0, 10.0, 100.0]), &["durations, foot 0", "210 s", "at most 120 s"]),
        (durations(json!([[0.5], [0.5], [0.5]])), &["durations", "3 feet", "4 feet", "anymal"]),
        (durations(json!(vec![[0.5]; 9])), &["durations", "9 feet", "1 to 8"]),
        (with("base_target", json!([20.0, 0.0, 1.0])), &["goal", "(20, 0)", "step", "-10 to 10"]),
        (with("base_target", json!([6.0, 0.0, 0.1])), &["goal.position[2]", "0.1", "above the terrain"]),
        (with("base_target", json!([6.0])), &["base_target", "1 numbers", "2 or 3"]),
        (with("yaw_target", json!(900.0)), &["goal.yaw", "900", "62.8"]),
        (with("scenario", json!("s9")), &["scenario", "s9", "s1, s2"]),
        (json!({"scenario": "s1", "target": 21, "durations": [[0.5], [0.5], [0.5], [0.5]]}).to_string(), &["target", "21", "1 to 20"]),
    ];
    let dir = folder();
    for (line, parts) in cases {
        write_lines(dir.path(), &[line]);
        let ran = run(dir.path(), "evaluate in.jsonl --out out.jsonl --trajectories t.jsonl");
        ran.ends_with(4).says(&["in.jsonl, line 1"]).says(parts);
        assert_holds_only(dir.path(), &["in.jsonl"]);
    }
}

#[test]
fn schedule_files_that_cannot_be_read_or_written_exit_4() {
    let dir = folder();
    fs::write(dir.path().join("empty.jsonl"), "\n \n").unwrap();
    run(dir.path(), "evaluate empty.jsonl --scenario s1").ends_with(4).says(&["empty.jsonl", "at least one line"]);
    run(dir.path(), "evaluate none.jsonl").ends_with(4).says(&["none.jsonl"]);
    run(dir.path(), "evaluate .").ends_with(4).says(&["directory"]);
    write_lines(dir.path(), &[standing().to_string()]);
    for flag in ["--out", "--trajectories"] {
        run(dir.path(), &format!("evaluate in.jsonl --scenario s1 {flag} missing/out.jsonl")).ends_with(4).says(&["missing/out.jsonl"]);
    }
    assert_holds_only(dir.path(), &["empty.jsonl", "in.jsonl"]);
}
