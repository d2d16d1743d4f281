//! `cregopt solve`: results, seeds, flags and settings.

use crate::harness::{assert_holds_only, folder, own_robot, own_terrain, read, read_lines, run, standing, write_lines};
use cregopt::settings::SolverSettings;
use serde_json::{Value, json};
use std::fs;
use std::path::Path;

#[test]
fn the_result_has_everything_that_repeats_the_run() {
    let dir = folder();
    run(dir.path(), "solve --scenario s2 --target 3 --seed 5 --threads 2 --first --out out").ends_with(0);
    let result = read(dir.path().join("out/result.json"));
    let keys = [
        "version",
        "scenario",
        "target",
        "robot",
        "terrain",
        "base_target",
        "yaw_target",
        "force_limit",
        "seed",
        "device",
        "transcription",
        "search",
        "lower",
        "feasible",
        "stop",
        "n_violated",
        "max_violation",
        "first_feasible_seconds",
        "seconds",
        "gait",
        "certificate",
        "alternatives",
        "improvements",
        "generations",
    ];
    for key in keys {
        assert!(!result[key].is_null(), "no {key}");
    }
    assert_eq!(result["version"], env!("CARGO_PKG_VERSION"));
    assert_eq!((&result["scenario"], &result["target"], &result["seed"]), (&json!("s2"), &json!(3), &json!(5)));
    assert_eq!((&result["search"]["population"], &result["lower"]["precision"]), (&json!(16), &json!("f32")));
    assert!(result["lower"]["solver"]["max_iterations"].is_u64() && result["lower"]["transcription"]["interval"].is_f64());
    assert!(result["device"].as_str().unwrap().contains("cpu"));
    assert_eq!((&result["feasible"], &result["n_violated"]), (&json!(true), &json!(0)));

    let trajectory = read(dir.path().join("out/trajectory.json"));
    for key in ["scenario", "robot", "terrain", "transcription", "seed", "version", "base_lin", "base_ang", "ee", "T"] {
        assert!(!trajectory[key].is_null(), "no {key}");
    }
    assert_eq!(trajectory["durations"], result["gait"]["durations"]);
    assert_eq!(trajectory["T"], result["gait"]["horizon"]);
    assert_holds_only(&dir.path().join("out"), &["result.json", "scenario.toml", "trajectory.json"]);

    let verified = run(dir.path(), "verify out/trajectory.json --json");
    let reports: Value = serde_json::from_str(&verified.ends_with(0).stdout).unwrap();
    assert_eq!(reports[0]["n_violated"], 0);
    assert_eq!(reports[0]["max_violation"], result["max_violation"]);
}

#[test]
fn json_on_stdout_is_result_json() {
    let dir = folder();
    let ran = run(dir.path(), "solve --robot biped --goal 0.5,0 --out out --json");
    assert_eq!(ran.ends_with(0).stdout, fs::read_to_string(dir.path().join("out/result.json")).unwrap());
}

#[test]
fn the_same_seed_gives_the_same_gait_at_any_number_of_threads() {
    let dir = folder();
    for (seed, threads, out) in [(1, 1, "a"), (1, 2, "b"), (2, 2, "c")] {
        run(dir.path(), &format!("solve --robot biped --goal 0.8,0.1 --seed {seed} --threads {threads} --out {out}")).ends_with(0);
    }
    let trajectory = |out: &str| fs::read_to_string(dir.path().join(out).join("trajectory.json")).unwrap();
    // All fields except times.
    let gait = |out: &str| {
        let mut gait = read(dir.path().join(out).join("result.json"))["gait"].take();
        assert!(gait.as_object_mut().unwrap().remove("seconds").is_some_and(|seconds| seconds.is_f64()));
        gait
    };
    assert_eq!(trajectory("a"), trajectory("b"));
    assert_eq!(gait("a"), gait("b"));
    assert_ne!(gait("a")["durations"], gait("c")["durations"]);
}

#[test]
fn goal_yaw_files_and_settings_are_applied() {
    let dir = folder();
    fs::write(dir.path().join("robot.json"), own_robot().to_string()).unwrap();
    fs::write(dir.path().join("terrain.json"), own_terrain().to_string()).unwrap();
    let flags = "--goal 0.5,-0.1 --yaw -0.2 --force-limit 800 --set solver.max_iterations=150 --set search.population=4 \
                 --set search.elites=2 --set precision=f64";
    run(dir.path(), &format!("solve --robot robot.json --terrain terrain.json {flags} --out out")).ends_with(0);
    let result = read(dir.path().join("out/result.json"));
    assert_eq!((&result["robot"], &result["terrain"]), (&json!("mine"), &json!("ramp")));
    assert_eq!((&result["yaw_target"], &result["force_limit"]), (&json!(-0.2), &json!(800.0)));
    assert_eq!((&result["scenario"], &result["target"]), (&Value::Null, &Value::Null));
    // Samples are 2 m apart and rise 0.1 m: 0.025 m at x = 0.5, where the sample at x = 0 has height 0.
    let goal = result["base_target"].as_array().unwrap();
    assert_eq!((&goal[0], &goal[1]), (&json!(0.5), &json!(-0.1)));
    // The base is parallel to the slope, on legs of 0.42 m, which are longer along the vertical.
    assert!((goal[2].as_f64().unwrap() - (0.025 + 0.08 + 0.42 / 0.05f64.atan().cos())).abs() < 1e-9);
    assert_eq!((&result["lower"]["solver"]["max_iterations"], &result["lower"]["precision"]), (&json!(150), &json!("f64")));
    assert_eq!((&result["search"]["population"], &result["search"]["elites"]), (&json!(4), &json!(2)));
    // The trajectory contains the robot and the terrain: verification needs no other file.
    fs::remove_file(dir.path().join("robot.json")).unwrap();
    run(dir.path(), "verify out/trajectory.json").ends_with(0);

    run(dir.path(), "solve --robot anymal --goal=-0.5,0.2,0.48 --first --out back").ends_with(0);
    assert_eq!(read(dir.path().join("back/result.json"))["base_target"], json!([-0.5, 0.2, 0.48]));
}

#[test]
fn a_motion_takes_the_time_that_is_asked_and_its_scenario_file_repeats_it() {
    let dir = folder();
    run(dir.path(), "solve --robot biped --goal 0.2,0.05,0.64@1.13 --first --out out").ends_with(0);
    let motion = read(dir.path().join("out/trajectory.json"));
    assert!((motion["T"].as_f64().unwrap() - 1.13).abs() < 1e-9, "{}", motion["T"]);
    run(dir.path(), "verify out/trajectory.json").ends_with(0);
    run(dir.path(), "solve out/scenario.toml --out again").ends_with(0);
    assert_eq!(read(dir.path().join("again/trajectory.json")), motion);
}

#[test]
fn each_stage_begins_where_the_previous_one_ends() {
    let dir = folder();
    run(
        dir.path(),
        "solve --robot anymal --start 0.2,0.1 --start-yaw 0.3 --goal 0.8,0.1 --via 0.5,0.3 --yaw 0.5 --first --out out --plot path.svg",
    )
    .ends_with(0);
    let [first, second] = [1, 2].map(|stage| read(dir.path().join(format!("out/stage-{stage}/trajectory.json"))));
    assert_eq!(first["start"]["position"], json!([0.2, 0.1, 0.5]));
    // The yaw changes evenly over the stages.
    assert_eq!((&first["start"]["angles"][2], &first["yaw_target"], &second["yaw_target"]), (&json!(0.3), &json!(0.4), &json!(0.5)));
    let ends = |curve: &Value| curve["nodes"].as_array().unwrap().clone();
    let (last, next) = (ends(&first["base_lin"]), ends(&second["base_lin"]));
    for i in 0..6 {
        assert!((last[last.len() - 1][i].as_f64().unwrap() - next[0][i].as_f64().unwrap()).abs() < 1e-9);
    }
    for foot in 0..4 {
        let (last, next) = (ends(&first["ee"][foot]["motion"]), ends(&second["ee"][foot]["motion"]));
        assert_eq!(last[last.len() - 1], next[0]);
    }
    // Goal and start can be given: the first stage ends at the waypoint, not at the goal.
    let verified = run(dir.path(), "verify out/stage-1/trajectory.json --start 0.2,0.1 --goal 0.5,0.3 --yaw 0.4 --default-limits");
    let report = &verified.ends_with(3).stdout;
    assert!(report.contains("yaw 0.4000 rad, given") && report.contains("start angle yaw"), "{report}");
    let asked = "verify out/stage-1/trajectory.json --start 0.2,0.1 --start-yaw 0.3 --goal 0.5,0.3 --yaw 0.4 --default-limits";
    run(dir.path(), asked).ends_with(0);
    run(dir.path(), "verify out/stage-2/trajectory.json").ends_with(0);
    run(dir.path(), "verify out/stage-2/trajectory.json --goal 0.9,0.1").ends_with(3);
    for stage in [1, 2] {
        assert!(dir.path().join(format!("path-stage-{stage}.svg")).is_file());
    }
    // Continues from a file.
    run(dir.path(), "solve --robot anymal --from out/stage-2/trajectory.json --goal 0.9,0.1 --yaw 0.5 --first --out on").ends_with(0);
    assert_eq!(read(dir.path().join("on/trajectory.json"))["start"]["position"], json!([0.8, 0.1, 0.5]));
    fs::write(
        dir.path().join("on.toml"),
        "robot = 'anymal'\ngoal = { xy = [0.9, 0.1] }\nstart = { after = 'out/stage-2/trajectory.json' }\n",
    )
    .unwrap();
    run(dir.path(), "solve on.toml --start-yaw 0.2").ends_with(2).says(&["yaw at the start", "0.2", "end of a motion"]);
    run(dir.path(), "solve --robot biped --from out/stage-2/trajectory.json --goal 0.9,0.1").ends_with(2).says(&[
        "start_feet",
        "4 feet",
        "2",
    ]);
    run(dir.path(), "solve --robot anymal --goal 3,0@2 --via 1,0@2").ends_with(2).says(&["goal: time: 2, but it must be later than 2 s"]);
    run(dir.path(), "solve --robot anymal --goal 3,0@soon").ends_with(2).says(&["expected a time in seconds after @"]);
    run(dir.path(), "solve --robot anymal --goal 3,0 --start 0,0@1").ends_with(2).says(&["expected X,Y or X,Y,Z in metres"]);
    run(dir.path(), "solve --robot anymal --goal 3,0 --via 5000,0").ends_with(2).says(&["waypoint 1", "goal", "1000"]);
    // Files of another run in the folder are reported. `--gait trot` means the name even if there is a folder of that name.
    fs::create_dir(dir.path().join("trot")).unwrap();
    let once = run(dir.path(), "solve --robot anymal --goal 0.5,0 --gait trot --first --out out");
    once.ends_with(0).says(&["out/stage-1 has the motion of an earlier run", "out/stage-2 has"]);
    assert_eq!(read(dir.path().join("out/result.json"))["gait"]["family"], "trot");
    let again = run(dir.path(), "solve --robot anymal --goal 0.5,0 --via 0.2,0 --first --out out");
    again.ends_with(0).says(&["out has the motion of an earlier run"]);
    assert!(!again.stderr.contains("stage-"), "{}", again.stderr);
}

/// Solves with flags. Returns the result, the trajectory and the report of `verify`.
pub fn solve(folder: &Path, flags: &str) -> (Value, Value, Value) {
    run(folder, &format!("solve {flags} --first --out out")).ends_with(0);
    let verified = run(folder, "verify out/trajectory.json --json");
    let mut reports: Value = serde_json::from_str(&verified.ends_with(0).stdout).unwrap();
    (read(folder.join("out/result.json")), read(folder.join("out/trajectory.json")), reports[0].take())
}

/// Number of rows of a family in a report.
fn rows(report: &Value, family: &str) -> u64 {
    let families = report["families"].as_array().unwrap();
    families.iter().find(|f| f["family"] == family).unwrap()["rows"].as_u64().unwrap()
}

#[test]
fn momentum_is_the_default_transcription_and_towr_is_an_option() {
    let dir = folder();
    // 1.2 weights of ANYmal; three with free legs; TOWR's limit for any robot.
    let weight = 29.5 * 9.80665;
    for (flags, name, limit) in [
        ("", "momentum", 1.2 * weight),
        (" --set transcription.legs=free", "momentum", 3. * weight),
        (" --preset experiment1", "momentum", 3. * weight),
        (" --transcription towr", "towr", 1000.),
    ] {
        let (result, trajectory, report) = solve(dir.path(), &format!("--scenario s1{flags}"));
        assert_eq!((&result["transcription"], &result["lower"]["transcription"]["rows"]), (&json!(name), &json!(name)));
        assert_eq!(trajectory["transcription"], name);
        for file in [&result, &trajectory] {
            assert!((file["force_limit"].as_f64().unwrap() - limit).abs() < 1e-9, "{}", file["force_limit"]);
        }
        let momentum = name == "momentum";
        for family in ["momentum", "motion"] {
            assert_eq!(rows(&report, family) > 0, momentum, "{family}");
        }
        assert_eq!((rows(&report, "dynamics") > 0, trajectory["limits"].is_object()), (!momentum, momentum));
        let free = flags.contains("free") || flags.contains("preset");
        assert_eq!(result["lower"]["transcription"]["legs"], if free { "free" } else { "limited" });
        assert_eq!(trajectory["limits"]["foot_acceleration"].is_f64(), momentum && !free);
        let ran = run(dir.path(), &format!("solve --scenario s1{flags} --first"));
        assert!(ran.ends_with(0).stdout.contains(&format!("{name} rows")), "{}", ran.stdout);

        write_lines(dir.path(), &[standing().to_string()]);
        let flags = flags.replace(" --preset experiment1", " --set transcription.legs=free");
        run(dir.path(), &format!("evaluate in.jsonl --robot anymal{flags} --out out.jsonl")).ends_with(0);
        assert_eq!(read_lines(dir.path().join("out.jsonl"))[0]["result"]["transcription"], name);
    }
}

#[test]
fn a_robot_file_may_limit_the_force_and_the_flag_wins() {
    let dir = folder();
    let mut robot = own_robot();
    robot["force_limit"] = json!(700.0);
    fs::write(dir.path().join("robot.json"), robot.to_string()).unwrap();
    let own = "--robot robot.json --goal 0.3,0";
    for (flags, limit) in [("", 700.), (" --transcription towr", 700.), (" --force-limit 650", 650.)] {
        let (result, trajectory, _) = solve(dir.path(), &format!("{own}{flags}"));
        assert_eq!((&result["force_limit"], &trajectory["force_limit"]), (&json!(limit), &json!(limit)), "{flags}");
    }
}

#[test]
fn the_goal_velocity_is_zero_unless_it_is_free() {
    let dir = folder();
    let (result, trajectory, report) = solve(dir.path(), "--scenario s1");
    assert_eq!(
        (&result["lower"]["transcription"]["goal_velocity"], &trajectory["limits"]["goal_velocity"]),
        (&json!("zero"), &json!("zero"))
    );
    assert!(report["dense"]["final_base_speed"].as_f64().unwrap() < 1e-4);
    let at_rest = rows(&report, "bounds");
    let (result, trajectory, report) = solve(dir.path(), "--scenario s1 --set transcription.goal_velocity=free");
    assert_eq!(
        (&result["lower"]["transcription"]["goal_velocity"], &trajectory["limits"]["goal_velocity"]),
        (&json!("free"), &json!("free"))
    );
    assert!(report["dense"]["final_base_speed"].as_f64().unwrap() > 0.01, "{}", report["dense"]);
    assert_eq!(at_rest - rows(&report, "bounds"), 6);
    // The base arrives with a velocity, which violates a goal at rest.
    let mut moving = trajectory.clone();
    moving["limits"]["goal_velocity"] = json!("zero");
    fs::write(dir.path().join("moving.json"), moving.to_string()).unwrap();
    assert!(run(dir.path(), "verify moving.json").ends_with(3).stdout.contains("final"));
}

#[test]
fn a_search_can_start_from_the_gait_of_an_earlier_run() {
    let dir = folder();
    // As with `--first`, the motions are the first that hold.
    let plain = "--set search.optimise_iterations=0 --set search.duration_steps=0";
    let command = |more: &str| format!("solve --robot biped --goal 0.5,0 {plain} {more}");
    run(dir.path(), &command("--first --out first")).ends_with(0);
    let first = read(dir.path().join("first/result.json"))["gait"].take();
    // A line of schedules.
    fs::write(dir.path().join("line.json"), json!({"durations": first["durations"], "note": "mine"}).to_string()).unwrap();
    let mut results = Vec::new();
    for (file, out) in [("first/result.json", "a"), ("first/trajectory.json", "b"), ("line.json", "c")] {
        run(dir.path(), &command(&format!("--gait {file} --population 4 --generations 1 --out {out}"))).ends_with(0);
        let result = read(dir.path().join(out).join("result.json"));
        assert_eq!(result["search"]["gaits"]["around"], first["durations"]);
        // The given gait is evaluated first, and the result does not cost more.
        let objective = |of: &Value| of["objective"].as_f64().unwrap();
        assert!((objective(&result["improvements"][0]) - objective(&first)).abs() < 1e-6, "{}", result["improvements"]);
        assert!(objective(&result["gait"]) >= objective(&result["improvements"][0]));
        results.push(result["gait"]["durations"].clone());
    }
    assert!(results[0] == results[1] && results[0] == results[2]);

    for (text, parts) in
        [("{}", ["missing field", "durations"]), ("{", ["EOF", ""]), (r#"{"durations": [[0.5, 0.5]]}"#, ["odd number", "foot 0"])]
    {
        fs::write(dir.path().join("odd.json"), text).unwrap();
        run(dir.path(), &command("--gait odd.json")).ends_with(4).says(&["odd.json"]).says(&parts);
    }
    run(dir.path(), &command("--gait none.json")).ends_with(4).says(&["none.json"]);
    fs::write(dir.path().join("odd.json"), r#"{"durations": [[0.5], [0.5], [0.5], [0.5]]}"#).unwrap();
    run(dir.path(), &command("--gait odd.json")).ends_with(2).says(&["durations", "4 feet", "2 feet", "biped"]);
}

#[test]
fn alternatives_have_their_own_files_and_a_later_run_deletes_them() {
    let dir = folder();
    let out = dir.path().join("out");
    let command = |k: usize| format!("solve --robot biped --goal 0.5,0 --generations 0 --alternatives {k} --out out");
    let ran = run(dir.path(), &command(2));
    assert!(ran.ends_with(0).stdout.contains("alternative"), "{}", ran.stdout);
    let result = read(out.join("result.json"));
    let alternatives = result["alternatives"].as_array().unwrap();
    assert!(alternatives.len() == 1 && alternatives[0]["family"] != result["gait"]["family"]);
    assert!(alternatives[0]["objective"].as_f64().unwrap() <= result["gait"]["objective"].as_f64().unwrap());
    assert_eq!(read(out.join("trajectory-2.json"))["durations"], alternatives[0]["durations"]);
    run(dir.path(), "verify out/trajectory-2.json").ends_with(0);
    // Its own extra file is deleted, and no other file.
    fs::write(out.join("trajectory-4.json"), "mine").unwrap();
    let ran = run(dir.path(), &command(1));
    assert!(!ran.ends_with(0).stdout.contains("alternative"), "{}", ran.stdout);
    assert_holds_only(&out, &["result.json", "scenario.toml", "trajectory.json", "trajectory-4.json"]);
}

/// Log of the solver of one thread, one line per event.
fn log_of(arguments: &str) -> Vec<String> {
    let dir = folder();
    let ran = run(dir.path(), &format!("solve {arguments} --device cpu --threads 1 -vv"));
    ran.stderr.lines().filter(|line| line.contains("cregopt::solver: ")).map(Into::into).collect()
}

#[test]
fn the_log_has_a_line_per_iteration_and_the_status_at_the_end() {
    let number = |line: &str, before: &str| -> f64 { line.split(before).nth(1).unwrap().split(',').next().unwrap().parse().unwrap() };
    let solved = log_of("--robot biped --goal 0.5,0 --gait walk --population 2 --generations 0");
    // The first solve: its iterations are counted, and its rows and its cost fall.
    let end = (1..solved.len()).find(|&i| number(&solved[i], "iteration ") == 1.).unwrap_or(solved.len());
    let first = &solved[..end];
    assert!(first.iter().enumerate().all(|(i, line)| number(line, "iteration ") == (i + 1) as f64), "{first:#?}");
    assert!(first.iter().all(|line| line.contains("candidate{index=0}") && line.contains("barrier ")), "{first:#?}");
    let minimised: Vec<f64> = first.iter().filter(|line| line.contains("minimise: ")).map(|line| number(line, "cost ")).collect();
    let solve = first.iter().rfind(|line| line.contains("solve: ") || line.contains("close: ")).unwrap();
    assert!(number(first.last().unwrap(), "infeasibility ") < SolverSettings::default().tolerance, "{first:#?}");
    assert!(minimised.last().unwrap() < &number(solve, "cost "), "{first:#?}");
    let weak = log_of("--robot biped --goal 1,0 --force-limit 120 --gait walk --population 2 --generations 1");
    assert!(weak.iter().any(|line| line.contains("terminated early at infeasibility ")), "{weak:#?}");
}
