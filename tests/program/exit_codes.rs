//! Exit codes of the program and the messages that go with them.

use crate::harness::{assert_holds_only, folder, read, run};
use serde_json::{Value, json};
use std::fs;

#[test]
fn a_feasible_gait_exits_0_and_help_says_what_the_codes_mean() {
    let dir = folder();
    let ran = run(dir.path(), "solve --scenario s1 --first");
    ran.ends_with(0);
    for part in ["seed 1", "gait found", "foot 3", "feasible: 0 of"] {
        assert!(ran.stdout.contains(part), "no `{part}` in: {}", ran.stdout);
    }
    assert_eq!(ran.stderr, "", "progress is for terminals only");
    let help = run(dir.path(), "--help");
    assert!(help.ends_with(0).stdout.contains("Exit codes: 0 feasible, 2 usage, 3 nothing feasible"));
}

#[test]
fn an_infeasible_budget_exits_3_and_still_writes_the_best_candidate() {
    let dir = folder();
    let ran = run(dir.path(), "solve --scenario s1 --preset experiment1 --goal 60,0 --generations 1 --out far");
    assert!(ran.ends_with(3).stdout.contains("no feasible gait"));
    let result = read(dir.path().join("far/result.json"));
    assert_eq!((&result["feasible"], &result["stop"]), (&json!(false), &json!("generation-limit")));
    assert!(result["gait"]["durations"].is_array() && result["certificate"]["n_violated"].as_u64().unwrap() > 0);
    assert_eq!(result["n_violated"], result["certificate"]["n_violated"]);
    assert_eq!(result["first_feasible_seconds"], Value::Null);
    run(dir.path(), "verify far/trajectory.json").ends_with(3);

    let few = "solve --scenario s1 --preset experiment1 --generations 1 --out few --set search.free.heuristic=false \
               --set search.free.min_stances=2 --set search.free.max_stances=2";
    run(dir.path(), few).ends_with(3);
    assert!(dir.path().join("few/trajectory.json").exists());

    // The feet may not carry the robot.
    let weak =
        "solve --robot biped --goal 0.3,0 --force-limit 20 --generations 0 --set search.further_generations=0 --alternatives 2 --out weak";
    let ran = run(dir.path(), weak);
    assert!(ran.ends_with(3).stdout.contains("no feasible gait"));
    assert_eq!(read(dir.path().join("weak/result.json"))["alternatives"], json!([]));
    // A warning before the search; afterwards the violated rows and the limits that would not suffice.
    ran.says(&["warning", "40.0 N of the weight of 196.1 N"]);
    assert!(ran.stdout.contains("rows that the nearest candidate violates"));
    let result = read(dir.path().join("weak/result.json"));
    assert_eq!(result["warnings"][0]["certain"], json!(false));
    assert!(result["diagnosis"]["broken"][0]["violated"].as_u64().unwrap() > 0);
    assert_holds_only(&dir.path().join("weak"), &["result.json", "scenario.toml", "trajectory.json"]);
}

#[test]
fn a_goal_out_of_reach_of_the_ground_is_refused_with_a_feasible_height() {
    let dir = folder();
    let ran = run(dir.path(), "solve --robot anymal --terrain step --goal 4,0,0.65 --out astride");
    ran.ends_with(2).says(&["goal, foot 2", "0.051 m outside", "Z from 0.470 to 0.599 m"]);
    assert!(!dir.path().join("astride").exists());
}

#[test]
fn usage_errors_exit_2_and_name_flag_value_and_limit() {
    let dir = folder();
    let cases: [(&str, &[&str]); 42] = [
        ("", &["Usage"]),
        ("swim", &["swim"]),
        ("solve", &["robot"]),
        ("solve --robot anymal", &["base_target"]),
        ("solve --scenario s9", &["scenario", "s9", "s1, s2, s3, biped, hex"]),
        ("solve --scenario s1 --target 21", &["target", "21", "1 to 20"]),
        ("solve --scenario s1 --goal abc", &["--goal", "abc", "X,Y"]),
        ("solve --scenario s1 --goal 1", &["--goal", "X,Y"]),
        ("solve --scenario s1 --goal 1,nan", &["--goal", "1,nan", "X,Y"]),
        ("solve --scenario s1 --goal 1e6,0", &["goal", "1000000", "-1000 to 1000"]),
        ("solve --scenario s3 --goal 20,0", &["goal", "(20, 0)", "step", "-10 to 10"]),
        ("solve --scenario s3 --goal 20,0,1", &["goal", "(20, 0)", "step", "-10 to 10"]),
        ("solve --scenario s3 --goal 6,0,0.1", &["goal.position[2]", "0.1", "above the terrain"]),
        ("solve --scenario s1 --yaw nan", &["yaw", "NaN"]),
        ("solve --scenario s1 --yaw 900", &["yaw", "900", "62.8"]),
        ("solve --scenario s1 --force-limit 0", &["force_limit", "0.001"]),
        ("solve --scenario s1 --seed x", &["--seed", "x"]),
        ("solve --scenario s1 --threads 100000", &["threads", "100000", "4096"]),
        ("solve --scenario s1 --population 0", &["population", "0", "65536"]),
        ("solve --scenario s1 --population 18446744073709551615", &["population", "18446744073709551615", "65536"]),
        ("solve --scenario s1 --preset x", &["preset", "x", "experiment1"]),
        ("solve --scenario s1 --objective speed", &["--objective", "speed", "fewest-stances"]),
        ("solve --scenario s1 --robot cat", &["robot", "cat", "anymal", ".json"]),
        ("solve --scenario s1 --terrain moon", &["terrain", "moon", "flat", ".json"]),
        ("solve --scenario s1 --set solver", &["--set", "solver", "KEY=VALUE"]),
        ("solve --scenario s1 --set solver.speed=1", &["solver.speed", "solver.max_iterations"]),
        ("solve --scenario s1 --set solver.max_iterations=many", &["solver.max_iterations", "many"]),
        ("solve --scenario s1 --set solver.barrier=-1", &["solver.barrier", "-1", "1000"]),
        ("solve --scenario s1 --transcription spline", &["--transcription", "spline", "momentum", "towr"]),
        ("solve --scenario s1 --set transcription.goal_velocity=fast", &["transcription.goal_velocity", "fast", "zero", "free"]),
        ("solve --scenario s1 --set transcription.clearance=-1", &["transcription.clearance", "-1", "0 to 10"]),
        ("solve --scenario s1 --set transcription.swing_height=0.032", &["transcription.swing_height", "0.032", "0.033 to 100"]),
        ("solve --scenario s1 --set transcription.foot_speed=0", &["transcription.foot_speed", "0.1 to 1000"]),
        ("solve --scenario s1 --set search.elites=17", &["elites", "17", "1 to 16"]),
        ("solve --scenario s1 --set transcription.foot_acceleration=0", &["transcription.foot_acceleration", "1 to 1000000"]),
        ("solve --scenario s1 --set transcription.legs=strong", &["transcription.legs", "strong", "limited", "free"]),
        ("solve --scenario s1 --set search.free.floor=2", &["search.free.floor", "0 to 1"]),
        ("solve --scenario s1 --gait nonsense", &["gait", "nonsense", "trot", "rotary-gallop", "tripod"]),
        ("solve --scenario biped --gait walk,trot", &["trot", "this robot", "walk, run, hop"]),
        ("solve --scenario s1 --alternatives 0", &["search.alternatives", "0", "1 to 100"]),
        ("solve --scenario s1 --time=-1", &["search.seconds", "-1", "0 to"]),
        ("verify", &["FILE"]),
    ];
    for (command, parts) in cases {
        let ran = run(dir.path(), &format!("{command} {}", if command.starts_with("solve ") { "--out out" } else { "" }));
        ran.ends_with(2).says(parts);
        assert_eq!(ran.stdout, "", "{command}");
    }
    run(dir.path(), "evaluate missing.jsonl --scenario s9").ends_with(2).says(&["scenario", "s9"]);
    run(dir.path(), "evaluate missing.jsonl --set solver.speed=1").ends_with(2).says(&["solver.speed"]);
    run(dir.path(), "evaluate missing.jsonl --set refine.speed=1").ends_with(2).says(&["refine.speed", "nothing is searched or refined"]);
    // Before the search, not after it.
    for (flags, parts) in
        [("refine.trust=2", ["refine.trust", "0.000001 to 1"]), ("transcription.rows=towr", ["transcription.rows", "momentum"])]
    {
        run(dir.path(), &format!("solve --robot biped --goal 1,0 --refine --set {flags} --out none")).ends_with(2).says(&parts);
    }
    assert!(!dir.path().join("none").exists());
    run(dir.path(), "solve --robot biped --goal 1,0 --device gpu --set precision=f64").ends_with(2).says(&["device", "f64", "CPU"]);
}

#[test]
fn a_population_that_overflows_in_a_product_is_refused() {
    // 12 elites of 16: the share of 2^61 + 1 overflows.
    let dir = folder();
    run(dir.path(), "solve --scenario s1 --population 2305843009213693953").ends_with(2).says(&["population"]);
}

#[test]
fn an_unusable_folder_exits_4_before_any_work() {
    let dir = folder();
    fs::write(dir.path().join("file"), "mine").unwrap();
    for out in ["file", "file/below"] {
        run(dir.path(), &format!("solve --scenario s1 --out {out}")).ends_with(4).says(&[out]);
    }
    assert_eq!(fs::read_to_string(dir.path().join("file")).unwrap(), "mine");
    assert_holds_only(dir.path(), &["file"]);
}
