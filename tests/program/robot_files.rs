//! Robot files: imported from a URDF, as JSON and TOML.

use crate::harness::{Ran, data, run_in};
use cregopt::Terrain;
use std::fs;
use std::path::Path;

const STANDING: &str =
    "LF_pitch=0.785,LF_knee=-1.57,RF_pitch=0.785,RF_knee=-1.57,LH_pitch=0.785,LH_knee=-1.57,RH_pitch=0.785,RH_knee=-1.57";

/// Runs the program, checks the exit code and returns stdout and stderr.
fn ran(folder: &Path, args: &[&str], code: i32) -> [String; 2] {
    let ran = run_in(folder, args);
    ran.ends_with(code);
    [ran.stdout, ran.stderr]
}

fn urdf(folder: &Path) {
    fs::copy(data("quadruped.urdf"), folder.join("four.urdf")).unwrap();
}

#[test]
fn an_imported_robot_gives_the_same_gait_from_json_and_toml() {
    let dir = tempfile::tempdir().unwrap();
    urdf(dir.path());
    let import = ["robot", "import", "four.urdf", "--configuration", STANDING];
    let [printed, notes] = ran(dir.path(), &import, 0);
    assert!(notes.contains("13.200 kg") && notes.contains("foot RH_foot") && notes.contains("lowest"), "{notes}");
    let mut costs = Vec::new();
    for name in ["robot.json", "robot.toml"] {
        let [summary, silence] = ran(dir.path(), &[&import[..], &["-o", name]].concat(), 0);
        assert_eq!((summary.trim(), silence.as_str()), (notes.trim(), ""));
        let [result, _] = ran(dir.path(), &["solve", "--robot", name, "--goal", "0.5,0", "--first", "--threads", "1", "--json"], 0);
        let result: serde_json::Value = serde_json::from_str(&result).unwrap();
        costs.push(result["gait"]["objective"].as_f64().unwrap());
    }
    assert_eq!(fs::read_to_string(dir.path().join("robot.json")).unwrap(), printed);
    assert_eq!(ran(dir.path(), &[&import[..], &["-o", "-"]].concat(), 0)[0], printed);
    assert_eq!(costs[0], costs[1]);
}

#[test]
fn gaits_within_the_limits_of_joints_are_preferred() {
    let dir = tempfile::tempdir().unwrap();
    urdf(dir.path());
    ran(dir.path(), &["robot", "import", "four.urdf", "--configuration", STANDING, "-o", "robot.toml"], 0);
    let solve = |more: &[&str]| {
        // The first motions that hold; the cheapest ones stay within the limits anyway.
        let plain = ["--set", "search.optimise_iterations=0", "--set", "search.duration_steps=0"];
        let asked = [&["solve", "--robot", "robot.toml", "--goal", "1,0", "--json"][..], &plain].concat();
        let result: serde_json::Value = serde_json::from_str(&ran(dir.path(), &[&asked[..], more].concat(), 0)[0]).unwrap();
        let number = |value: &serde_json::Value| value.as_f64().unwrap();
        let cost = &result["gait"]["cost"];
        let parts = ["leg_work", "swing_work", "effort_cost", "joint_cost"].map(|part| number(&cost[part]));
        assert!((number(&cost["total"]) - parts.iter().sum::<f64>()).abs() < 1e-9, "{cost}");
        (result["joints"]["kept"].as_bool().unwrap(), parts[3])
    };
    assert_eq!(solve(&[]), (true, 0.));
    assert_eq!(solve(&["--set", "search.cost.joint_excess=0"]), (false, 0.));
    let text = fs::read_to_string(dir.path().join("robot.toml")).unwrap();
    let slower = |limit: &str| fs::write(dir.path().join("robot.toml"), text.replace("velocity = 12.0", limit)).unwrap();
    // Slow legs: the planned generations find no gait within the limits.
    slower("velocity = 7.0");
    assert!(!solve(&["--set", "search.further_generations=0"]).0 && solve(&[]).0);
    // Legs that are too slow for any gait: the result is the nearest one, and its report says so.
    slower("velocity = 2.0");
    let (kept, joint_cost) = solve(&[]);
    assert!(!kept && joint_cost > 1., "{joint_cost}");
    for (more, said) in [(&[][..], "a single family (`--gait`)"), (&["--first"], "without `--first`")] {
        let [text, _] = ran(dir.path(), &[&["solve", "--robot", "robot.toml", "--goal", "1,0"], more].concat(), 0);
        assert!(text.contains("beyond the limits") && text.contains(said), "{text}");
    }
}

#[test]
fn imported_files_with_built_in_names_are_renamed_and_their_gaits_verify() {
    let dir = tempfile::tempdir().unwrap();
    urdf(dir.path());
    let text = fs::read_to_string(dir.path().join("four.urdf")).unwrap();
    fs::write(dir.path().join("four.urdf"), text.replace("<robot name=\"four\">", "<robot name=\"hyq\">")).unwrap();
    fs::write(dir.path().join("stairs.csv"), "0,0,0\n0,0.01,0\n0,0,0\n").unwrap();
    let [said, _] = ran(dir.path(), &["robot", "import", "four.urdf", "--configuration", STANDING, "-o", "robot.toml"], 0);
    assert!(said.contains("hyq-imported: 13.200 kg") && said.contains("`hyq` has another mass"), "{said}");
    let [said, _] = ran(dir.path(), &["terrain", "import", "stairs.csv", "--cell", "1", "--origin=-1.5,-1.5", "-o", "stairs.json"], 0);
    assert!(said.starts_with("stairs-imported: 3 x 3 samples"), "{said}");
    // In TOML and under another name it is the same terrain.
    let named = ["terrain", "import", "stairs.csv", "--cell", "1", "--origin=-1.5,-1.5", "--name", "steps", "-o", "steps.toml"];
    ran(dir.path(), &named, 0);
    let [json, toml] = ["stairs.json", "steps.toml"].map(|file| Terrain::read(&dir.path().join(file)).unwrap());
    assert_eq!((json.shape, toml.name), (toml.shape, "steps".into()));
    let world = ["--robot", "robot.toml", "--terrain", "stairs.json"];
    ran(dir.path(), &[&["solve", "--goal", "0.5,0", "--first", "--out", "out"], &world[..]].concat(), 0);
    ran(dir.path(), &["verify", "out/trajectory.json"], 0);
    // Before the search.
    for (file, place) in [("robot.toml", "robot.name: `hyq`"), ("stairs.json", "terrain.name: `stairs`")] {
        let text = fs::read_to_string(dir.path().join(file)).unwrap();
        fs::write(dir.path().join(file), text.replace("-imported", "")).unwrap();
        let [_, error] = ran(dir.path(), &[&["solve", "--goal", "0.5,0", "--first"], &world[..]].concat(), 4);
        assert!(error.contains(file) && error.contains(place), "{error}");
        fs::write(dir.path().join(file), text).unwrap();
    }
}

#[test]
fn invalid_robot_files_exit_4_and_leave_no_output() {
    let dir = tempfile::tempdir().unwrap();
    urdf(dir.path());
    let good = fs::read_to_string(dir.path().join("four.urdf")).unwrap();
    fs::write(dir.path().join("empty.urdf"), "").unwrap();
    fs::write(dir.path().join("half.urdf"), &good[..700]).unwrap();
    fs::write(dir.path().join("binary.urdf"), [0xff, 0xfe, 0x00]).unwrap();
    let cases: &[(&[&str], &[&str])] = &[
        (&["empty.urdf"], &["empty.urdf", "empty"]),
        (&["half.urdf"], &["half.urdf", "not XML"]),
        (&["binary.urdf"], &["binary.urdf", "UTF-8"]),
        (&["none.urdf"], &["none.urdf"]),
        (&["/dev/zero"], &["/dev/zero", "67108864"]),
        (&["four.urdf", "--feet", "LF_fot"], &["four.urdf", "`LF_fot`", "`LF_foot`"]),
        (&["four.urdf", "--configuration", "LF_knee=0"], &["four.urdf", "`LF_knee`", "-2.5 to -0.5"]),
    ];
    for (args, parts) in cases {
        let [_, error] = ran(dir.path(), &[&["robot", "import", "-o", "robot.toml"], *args].concat(), 4);
        assert!(parts.iter().all(|part| error.contains(part)) && error.lines().count() == 1, "{error}");
    }
    let [_, error] = ran(dir.path(), &["robot", "import", "four.urdf", "--configuration", "LF_knee"], 2);
    assert!(error.contains("JOINT=VALUE"), "{error}");
    let [_, error] = ran(dir.path(), &["robot", "import", "four.urdf", "-o", "nowhere/robot.toml"], 4);
    assert!(error.contains("nowhere"), "{error}");
    assert_eq!(fs::read_dir(dir.path()).unwrap().count(), 4);
}

#[test]
fn joints_follow_the_motion_of_an_imported_robot() {
    let dir = tempfile::tempdir().unwrap();
    urdf(dir.path());
    ran(dir.path(), &["robot", "import", "four.urdf", "--configuration", STANDING, "-o", "robot.toml"], 0);
    ran(dir.path(), &["solve", "--robot", "robot.toml", "--goal", "0.5,0", "--first", "--threads", "1", "--out", "out"], 0);
    let joints = ["robot", "joints", "out/trajectory.json", "--rate", "200", "-o", "joints.csv"];
    let Ran { code, stdout: text, .. } = run_in(dir.path(), &joints);
    assert!(text.starts_with("12 joints at ") && text.contains("torque") && text.contains("limits"), "{text}");
    let within = text.contains("within all limits");
    assert_eq!(code, if within { 0 } else { 3 }, "{text}");
    let [json, _] = ran(dir.path(), &[&joints[..], &["--json"]].concat(), if within { 0 } else { 3 });
    let limits: serde_json::Value = serde_json::from_str(&json).unwrap();
    assert_eq!((&limits["kept"], &limits["miss"]["limit"]), (&within.into(), &5e-3.into()));
    let trajectory: serde_json::Value = serde_json::from_str(&fs::read_to_string(dir.path().join("out/trajectory.json")).unwrap()).unwrap();
    let csv = fs::read_to_string(dir.path().join("joints.csv")).unwrap();
    // With `-` stdout has the file only.
    let [streamed, said] = ran(dir.path(), &[&joints[..6], &["-"]].concat(), if within { 0 } else { 3 });
    assert!(streamed == csv && said.starts_with("12 joints at "), "{said}");
    let rows: Vec<Vec<&str>> = csv.lines().map(|line| line.split(',').collect()).collect();
    assert_eq!((rows[0].len(), rows[0][0], rows[0][3], rows[0][36]), (37, "time_s", "LF_roll_torque_Nm", "RH_knee_torque_Nm"));
    let last: f64 = rows.last().unwrap()[0].parse().unwrap();
    assert_eq!(last, trajectory["T"].as_f64().unwrap());
    assert!(rows.len() > (200. * last) as usize && rows.iter().all(|row| row.len() == 37));
    // At rest at the start, with the nominal joint angles.
    for (column, value) in [(1, 0.), (4, 0.785), (7, -1.57), (5, 0.)] {
        assert!((rows[1][column].parse::<f64>().unwrap() - value).abs() < 1e-4, "{} {}", rows[0][column], rows[1][column]);
    }
    ran(dir.path(), &["solve", "--scenario", "s1", "--first", "--threads", "1", "--out", "other"], 0);
    let [_, error] = ran(dir.path(), &["robot", "joints", "other/trajectory.json"], 4);
    assert!(error.contains("other/trajectory.json") && error.contains("no `joints`"), "{error}");
    let [_, error] = ran(dir.path(), &["robot", "joints", "out/trajectory.json", "--rate", "0"], 2);
    assert!(error.contains("rate: 0"), "{error}");
}

#[test]
fn a_humanoid_is_imported_with_soles_walks_on_them_and_its_joints_follow() {
    let dir = tempfile::tempdir().unwrap();
    fs::copy(data("humanoid.urdf"), dir.path().join("human.urdf")).unwrap();
    let import = |sole: &str, name: &str| ran(dir.path(), &["robot", "import", "human.urdf", "--sole", sole, "-o", name], 0)[0].clone();
    let (found, given, absent) = (import("auto", "robot.json"), import("0.15,0.08", "given.json"), import("none", "points.json"));
    assert!(found.contains("soles 0.200 x 0.100 m, turn 0.20 rad") && given.contains("soles 0.150 x 0.080 m"), "{found}{given}");
    assert!(absent.contains("modelled as points") && !absent.contains("soles"), "{absent}");
    let [_, error] = ran(dir.path(), &["robot", "import", "human.urdf", "--sole", "wide"], 2);
    assert!(error.contains("LENGTH,WIDTH"), "{error}");
    ran(dir.path(), &["solve", "--robot", "robot.json", "--goal", "0.5,0", "--first", "--threads", "1", "--out", "out"], 0);
    let Ran { stdout: text, .. } = run_in(dir.path(), &["robot", "joints", "out/trajectory.json", "-o", "joints.csv"]);
    assert!(text.starts_with("12 joints at ") && !text.contains("out of reach"), "{text}");
    let csv = fs::read_to_string(dir.path().join("joints.csv")).unwrap();
    let rows: Vec<Vec<&str>> = csv.lines().map(|line| line.split(',').collect()).collect();
    assert_eq!((rows[0].len(), rows[0][18]), (37, "L_ankle_roll_torque_Nm"));
    // At rest at the start on level soles: the pitches of a leg add up to 0.
    let pitch: f64 = [7, 10, 13].iter().map(|column| rows[1][*column].parse::<f64>().unwrap()).sum();
    assert!(rows[0][7] == "L_pitch_position_rad" && pitch.abs() < 1e-4, "{pitch}");
}
