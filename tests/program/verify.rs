//! `cregopt verify`.

use super::solve::solve;
use crate::harness::{data, folder, own_robot, read, read_lines, run, run_in, standing, write_lines};
use serde_json::{Value, json};
use std::fs;

#[test]
fn broken_trajectories_exit_4_and_perturbed_ones_3() {
    let dir = folder();
    write_lines(dir.path(), &[standing().to_string()]);
    run(dir.path(), "evaluate in.jsonl --scenario s1 --trajectories t.jsonl").ends_with(0);
    let mut good = read_lines(dir.path().join("t.jsonl")).remove(0);
    // The file has no scenario: its goal is not one of the scenario that its robot comes from.
    assert!(good.get("scenario").is_none());
    good["scenario"] = Value::Null;
    let path = dir.path().join("t.json");
    let verify = |trajectory: &Value| {
        // Pretty-printed: one document over many lines.
        fs::write(&path, serde_json::to_string_pretty(trajectory).unwrap()).unwrap();
        run(dir.path(), "verify t.json")
    };
    assert!(verify(&good).ends_with(0).stdout.contains("feasible: 0 of"));

    let broken: [(&str, Value, &[&str]); 12] = [
        ("/T", json!(0.7), &["T", "0.7 s", "0.6"]),
        ("/T", Value::Null, &["null"]),
        ("/base_lin/nodes", json!(vec![[0.0; 6]]), &["base_lin.nodes", "1 nodes for", "one node more"]),
        ("/base_ang/poly_durations/0", json!(-0.1), &["base_ang.poly_durations[0]", "-0.1", "positive"]),
        ("/ee/1/force/nodes", json!([]), &["ee[1].force.nodes", "0 nodes"]),
        ("/ee/2/motion/nodes/0", json!([0.0, 0.0]), &["length 2"]),
        ("/ee", json!([]), &["ee", "0 feet", "4 feet"]),
        ("/durations/3/0", json!(0.5), &["T", "ends at 0.5 s"]),
        ("/durations/3", json!([0.3, 0.3]), &["durations, foot 3", "odd number"]),
        ("/robot", json!("cat"), &["robot", "cat", "anymal"]),
        ("/robot", json!("biped"), &["4 feet", "2 feet", "biped"]),
        ("/scenario", json!(5), &["5", "string"]),
    ];
    for (pointer, value, parts) in broken {
        let mut trajectory = good.clone();
        *trajectory.pointer_mut(pointer).unwrap() = value;
        verify(&trajectory).ends_with(4).says(&["t.json"]).says(parts);
    }
    let mut trajectory = good.clone();
    trajectory.as_object_mut().unwrap().remove("base_ang");
    verify(&trajectory).ends_with(4).says(&["t.json", "missing field", "base_ang"]);

    for (pointer, change) in [("/base_lin/nodes/2/0", 0.1), ("/ee/0/motion/nodes/0/2", 0.01), ("/base_target/1", 0.05)] {
        let mut trajectory = good.clone();
        let value = trajectory.pointer_mut(pointer).unwrap();
        *value = json!(value.as_f64().unwrap() + change);
        assert!(verify(&trajectory).ends_with(3).stdout.contains("not feasible"), "{pointer}");
    }

    let (good, bad) = (good.to_string(), &good.to_string()[..100]);
    fs::write(dir.path().join("t.jsonl"), format!("{good}\n{good}\n{bad}\n")).unwrap();
    let ran = run(dir.path(), "verify t.jsonl");
    assert!(ran.ends_with(4).says(&["t.jsonl, line 3"]).stdout.contains("line 2"));
    fs::write(&path, "").unwrap();
    run(dir.path(), "verify t.json").ends_with(4).says(&["t.json", "EOF"]);
    run(dir.path(), "verify none.json").ends_with(4).says(&["none.json"]);
    run(dir.path(), "verify .").ends_with(4).says(&["directory"]);
}

#[test]
fn verify_reports_its_terms_and_refuses_contradictory_labels() {
    let dir = folder();
    write_lines(dir.path(), &[standing().to_string()]);
    run(dir.path(), "evaluate in.jsonl --scenario s1 --trajectories t.jsonl").ends_with(0);
    let good = read_lines(dir.path().join("t.jsonl")).remove(0);
    let path = dir.path().join("t.json");
    let verify = |change: &dyn Fn(&mut Value), flags: &str| {
        let mut trajectory = good.clone();
        change(&mut trajectory);
        fs::write(&path, trajectory.to_string()).unwrap();
        run(dir.path(), &format!("verify t.json {flags}"))
    };
    let said = verify(&|_| {}, "");
    for part in ["robot anymal, built in", "the friction cone", "limits, the file's own", "goal (0.050, 0.000, 0.500) m", "tolerances: "] {
        assert!(said.ends_with(0).stdout.contains(part), "{part}\n{}", said.stdout);
    }
    assert!(verify(&|_| {}, "--force-limit 300").ends_with(0).stdout.contains("at most 300.0 N, given"));
    for limit in ["0", "1e300", "nan"] {
        verify(&|_| {}, &format!("--force-limit {limit}")).ends_with(2).says(&["force_limit"]);
    }
    let own = |name: &str, mass: f64| {
        let mut robot = serde_json::to_value(cregopt::Robot::named("anymal").unwrap()).unwrap();
        (robot["name"], robot["mass"]) = (json!(name), json!(mass));
        robot
    };
    // A robot of the file's own needs another name than a built-in one.
    verify(&|t| t["robot"] = own("mine, terrain mine", 29.5), "").ends_with(0);
    let printed = verify(&|t| t["robot"] = own("mine, terrain mine", 29.5), "");
    assert!(printed.stdout.contains("robot \"mine, terrain mine\", the file's own"), "{}", printed.stdout);
    type Case<'a> = (&'a dyn Fn(&mut Value), &'a [&'a str]);
    let refused: [Case; 8] = [
        (&|t| t["scenario"] = json!("s1"), &["scenario", "s1", "targets"]),
        (&|t| (t["scenario"], t["target"]) = (json!("s1"), json!(10)), &["scenario", "target 10"]),
        (&|t| t["robot"] = own("anymal", 60.), &["robot.name", "anymal", "mass"]),
        (&|t| t["robot"] = own("mine\nfeasible: 0 of 9", 29.5), &["robot.name", "mine\\nfeasible"]),
        (&|t| t["transcription"] = json!("foo"), &["transcription", "foo", "momentum"]),
        (&|t| t["limits"]["clearance"] = json!(-1e300), &["limits.clearance"]),
        (&|t| t["force_limit"] = json!(5000.), &["force_limit", "5000", "--force-limit"]),
        (&|t| t["robot"] = json!("t.json"), &["unknown robot"]),
    ];
    for (change, parts) in refused {
        verify(change, "").ends_with(4).says(&["t.json"]).says(parts);
    }
    // The robot's own limit counts, whatever the file allows.
    let weak = |t: &mut Value| {
        t["robot"] = own("mine", 29.5);
        t["robot"]["force_limit"] = json!(20.);
    };
    assert!(verify(&weak, "").ends_with(3).stdout.contains("normal force, limit"));
}

#[test]
fn a_scenario_is_verified_with_the_robot_in_the_file() {
    let dir = folder();
    let mut low = own_robot();
    low["base_height"] = json!(0.47);
    // A folder name as sweeps make it.
    fs::create_dir(dir.path().join("height=0.47")).unwrap();
    fs::write(dir.path().join("height=0.47/low.json"), low.to_string()).unwrap();
    run(dir.path(), "solve --scenario s1 --target 3 --robot height=0.47/low.json --first --out out").ends_with(0);
    run(dir.path(), "solve --scenario s1 --target 3 --robot s9=height=0.47/low.json --first").ends_with(2).says(&["scenario", "s9"]);
    run(dir.path(), "verify out/trajectory.json --scenario s1 --target 3").ends_with(0);
    run(dir.path(), "verify out/trajectory.json --scenario s1 --target 4").ends_with(3);
    // A file without limits is verified against free legs, and the report says so.
    let mut motion = read(dir.path().join("out/trajectory.json"));
    motion["limits"] = Value::Null;
    fs::write(dir.path().join("free.json"), motion.to_string()).unwrap();
    let report = run(dir.path(), "verify free.json");
    assert!(report.ends_with(0).stdout.contains("at most 20.000 m/s, any m/s2"), "{}", report.stdout);
}

#[test]
fn verify_reports_the_rollout() {
    let dir = folder();
    let (result, _, report) = solve(dir.path(), "--scenario s1");
    for (what, limit) in [("position", 0.01), ("attitude", 1.)] {
        let value = report["rollout"][what]["value"].as_f64().unwrap();
        assert!((0. ..limit).contains(&value), "{what} {value}");
        assert_eq!(result["certificate"]["rollout"][what], report["rollout"][what]);
    }
    let ran = run(dir.path(), "verify out/trajectory.json");
    let (_, rollout) = ran.ends_with(0).stdout.split_once("integrated from the start under the planned forces alone").unwrap();
    let unit = |line: &str| line.split_whitespace().nth(2).map(String::from);
    let of = |what: &str| rollout.lines().find(|line| line.starts_with(what)).and_then(unit);
    assert_eq!((of("position").as_deref(), of("attitude").as_deref()), (Some("m"), Some("deg")), "{rollout}");
}

#[test]
fn verify_accepts_towrs_own_solutions() {
    let path = data("towr_solutions.jsonl");
    let dir = folder();
    let args = ["verify", path.to_str().unwrap(), "--robot", "hex=pexod-as-published"];
    assert!(run_in(dir.path(), &args).ends_with(0).stdout.contains("10 of 10 trajectories feasible"));
    // With the physical inertia the solutions of the hexapod violate rows.
    run_in(dir.path(), &args[..2]).ends_with(3);
}
