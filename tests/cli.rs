//! The program as its users meet it: exit codes, messages, files. Everything runs in temporary folders.

use assert_cmd::Command;
use serde_json::{Value, json};
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Stdio;
use std::time::{Duration, Instant};
use tempfile::TempDir;

const PROGRAM: &str = env!("CARGO_BIN_EXE_cregopt");

/// What a run left behind.
struct Ran {
    code: i32,
    stdout: String,
    stderr: String,
}

/// Runs the program in a folder. No test needs a minute.
fn run_in<S: AsRef<std::ffi::OsStr>>(folder: &Path, args: &[S]) -> Ran {
    let output = Command::new(PROGRAM).args(args).current_dir(folder).timeout(Duration::from_secs(60)).output().unwrap();
    let text = |bytes: Vec<u8>| String::from_utf8(bytes).unwrap();
    // No exit code: it was killed, by a signal or for taking too long.
    Ran { code: output.status.code().unwrap_or(-1), stdout: text(output.stdout), stderr: text(output.stderr) }
}

/// Runs words separated by spaces.
fn run(folder: &Path, command: &str) -> Ran {
    run_in(folder, &command.split_whitespace().collect::<Vec<_>>())
}

impl Ran {
    fn ends_with(&self, code: i32) -> &Self {
        assert_eq!(self.code, code, "stdout: {}\nstderr: {}", self.stdout, self.stderr);
        self
    }

    /// The error message has every part.
    fn says(&self, parts: &[&str]) -> &Self {
        for part in parts {
            assert!(self.stderr.contains(part), "no `{part}` in: {}", self.stderr);
        }
        self
    }
}

fn folder() -> TempDir {
    tempfile::tempdir().unwrap()
}

fn read(path: impl AsRef<Path>) -> Value {
    serde_json::from_str(&fs::read_to_string(path).unwrap()).unwrap()
}

fn read_lines(path: impl AsRef<Path>) -> Vec<Value> {
    fs::read_to_string(path).unwrap().lines().map(|line| serde_json::from_str(line).unwrap()).collect()
}

/// A file of reference data.
fn data(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data").join(name)
}

/// Nothing but the named files and empty ones.
fn assert_holds_only(folder: &Path, names: &[&str]) {
    for entry in fs::read_dir(folder).unwrap() {
        let entry = entry.unwrap();
        let name = entry.file_name().into_string().unwrap();
        let empty = entry.metadata().unwrap().is_file() && entry.metadata().unwrap().len() == 0;
        assert!(names.contains(&name.as_str()) || empty, "{name} was left behind");
    }
}

/// Four feet that stand while the base moves 5 cm: feasible, and solved in a millisecond.
fn standing() -> Value {
    json!({"durations": [[0.6], [0.6], [0.6], [0.6]], "base_target": [0.05, 0.0, 0.5], "yaw_target": 0.0})
}

/// The quadruped as a file would have it.
fn own_robot() -> Value {
    json!({
        "name": "mine", "mass": 30.0, "inertia": [[1.0, 0.0, 0.0], [0.0, 2.0, 0.0], [0.0, 0.0, 2.0]], "base_height": 0.5,
        "nominal_feet": [[0.34, 0.19, -0.42], [0.34, -0.19, -0.42], [-0.34, 0.19, -0.42], [-0.34, -0.19, -0.42]],
        "reach": [0.15, 0.1, 0.1]
    })
}

/// A slope of 5 cm a metre.
fn own_terrain() -> Value {
    let heights: Vec<Vec<f64>> = (0..10).map(|i| vec![0.1 * f64::from(i) - 0.5; 2]).collect();
    json!({"name": "ramp", "friction": 0.8, "shape": {"grid": {"low": [-10.0, -10.0], "high": [10.0, 10.0], "heights": heights}}})
}

// ---------------------------------------------------------------- exit codes

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

    // Feet that may not carry the robot.
    let weak =
        "solve --robot biped --goal 0.3,0 --force-limit 20 --generations 0 --set search.further_generations=0 --alternatives 2 --out weak";
    let ran = run(dir.path(), weak);
    assert!(ran.ends_with(3).stdout.contains("no feasible gait"));
    assert_eq!(read(dir.path().join("weak/result.json"))["alternatives"], json!([]));
    // It says so before, and afterwards what is violated and what would not be enough.
    ran.says(&["warning", "40.0 N of a weight of 196.1 N"]);
    assert!(ran.stdout.contains("what stays violated"));
    let result = read(dir.path().join("weak/result.json"));
    assert_eq!(result["warnings"][0]["certain"], json!(false));
    assert!(result["diagnosis"]["broken"][0]["violated"].as_u64().unwrap() > 0);
    assert_holds_only(&dir.path().join("weak"), &["result.json", "scenario.toml", "trajectory.json"]);
}

#[test]
fn a_goal_out_of_reach_of_the_ground_is_refused_at_once_with_the_height_that_would_do() {
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
        ("solve --scenario s1 --threads 100000", &["--threads", "100000", "4096"]),
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
    run(dir.path(), "solve --robot biped --goal 1,0 --device gpu --set precision=f64").ends_with(2).says(&["--device", "f64", "CPU"]);
}

#[test]
fn a_population_that_overflows_in_a_product_is_refused() {
    // 12 elites of 16: the share of 2^61 + 1 does not fit.
    let dir = folder();
    run(dir.path(), "solve --scenario s1 --population 2305843009213693953").ends_with(2).says(&["population"]);
}

// ---------------------------------------------------------------- solve

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
    // Everything but the clock.
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
fn goal_yaw_files_and_settings_are_taken() {
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
    // The base stands along it, on legs of 0.42 m: these are longer along the vertical.
    assert!((goal[2].as_f64().unwrap() - (0.025 + 0.08 + 0.42 / 0.05f64.atan().cos())).abs() < 1e-9);
    assert_eq!((&result["lower"]["solver"]["max_iterations"], &result["lower"]["precision"]), (&json!(150), &json!("f64")));
    assert_eq!((&result["search"]["population"], &result["search"]["elites"]), (&json!(4), &json!(2)));
    // The trajectory carries the robot and the terrain: nothing else is needed to check it.
    fs::remove_file(dir.path().join("robot.json")).unwrap();
    run(dir.path(), "verify out/trajectory.json").ends_with(0);

    run(dir.path(), "solve --robot anymal --goal=-0.5,0.2,0.48 --first --out back").ends_with(0);
    assert_eq!(read(dir.path().join("back/result.json"))["base_target"], json!([-0.5, 0.2, 0.48]));
}

#[test]
fn legs_by_way_of_a_place_begin_where_the_one_before_ends() {
    let dir = folder();
    run(
        dir.path(),
        "solve --robot anymal --start 0.2,0.1 --start-yaw 0.3 --goal 0.8,0.1 --via 0.5,0.3 --yaw 0.5 --first --out out --plot way.svg",
    )
    .ends_with(0);
    let [first, second] = [1, 2].map(|leg| read(dir.path().join(format!("out/leg-{leg}/trajectory.json"))));
    assert_eq!(first["start"]["position"], json!([0.2, 0.1, 0.5]));
    // It turns evenly.
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
    // Goal and start can be asked from outside: the first leg is at the place on the way, not at the goal.
    let verified = run(dir.path(), "verify out/leg-1/trajectory.json --start 0.2,0.1 --goal 0.5,0.3 --yaw 0.4 --default-limits");
    let told = &verified.ends_with(3).stdout;
    assert!(told.contains("yaw 0.4000 rad, given") && told.contains("start angle yaw"), "{told}");
    let asked = "verify out/leg-1/trajectory.json --start 0.2,0.1 --start-yaw 0.3 --goal 0.5,0.3 --yaw 0.4 --default-limits";
    run(dir.path(), asked).ends_with(0);
    run(dir.path(), "verify out/leg-2/trajectory.json").ends_with(0);
    run(dir.path(), "verify out/leg-2/trajectory.json --goal 0.9,0.1").ends_with(3);
    for leg in [1, 2] {
        assert!(dir.path().join(format!("way-leg-{leg}.svg")).is_file());
    }
    // On from a file.
    run(dir.path(), "solve --robot anymal --from out/leg-2/trajectory.json --goal 0.9,0.1 --yaw 0.5 --first --out on").ends_with(0);
    assert_eq!(read(dir.path().join("on/trajectory.json"))["start"]["position"], json!([0.8, 0.1, 0.5]));
    fs::write(
        dir.path().join("on.toml"),
        "robot = 'anymal'\ngoal = { xy = [0.9, 0.1] }\nstart = { after = 'out/leg-2/trajectory.json' }\n",
    )
    .unwrap();
    run(dir.path(), "solve on.toml --start-yaw 0.2").ends_with(2).says(&["yaw at the start", "0.2", "end of a motion"]);
    run(dir.path(), "solve --robot biped --from out/leg-2/trajectory.json --goal 0.9,0.1").ends_with(2).says(&[
        "start_feet",
        "4 feet",
        "2",
    ]);
    run(dir.path(), "solve --robot anymal --goal 3,0 --via 5000,0").ends_with(2).says(&["place 1 on the way", "goal", "1000"]);
    // What another run left in the folder is told. A gait's name is one beside a folder of that name.
    fs::create_dir(dir.path().join("trot")).unwrap();
    let once = run(dir.path(), "solve --robot anymal --goal 0.5,0 --gait trot --first --out out");
    once.ends_with(0).says(&["out/leg-1 has the motion of an earlier run", "out/leg-2 has"]);
    assert_eq!(read(dir.path().join("out/result.json"))["gait"]["family"], "trot");
    let again = run(dir.path(), "solve --robot anymal --goal 0.5,0 --via 0.2,0 --first --out out");
    again.ends_with(0).says(&["out has the motion of an earlier run"]);
    assert!(!again.stderr.contains("leg-"), "{}", again.stderr);
}

#[test]
fn a_scenario_file_asks_for_everything_and_that_of_a_result_for_the_same_again() {
    let dir = folder();
    run(dir.path(), "init walk.toml").ends_with(0);
    run(dir.path(), "init walk.toml").ends_with(4).says(&["walk.toml", "exists"]);
    // Every key is in it, in use or behind a comment.
    let template = fs::read_to_string(dir.path().join("walk.toml")).unwrap();
    let misspelt = run(dir.path(), "init -").ends_with(0).stdout.replacen("population", "populatoin", 1);
    fs::write(dir.path().join("wrong.toml"), misspelt).unwrap();
    let wrong = run(dir.path(), "solve wrong.toml");
    wrong.ends_with(4).says(&["wrong.toml", "populatoin", "did you mean `population`?", "line 2"]);
    let keys = wrong.stderr.split("expected one of ").nth(1).unwrap().split('`').skip(1).step_by(2);
    for key in keys.filter(|&key| key != "version") {
        let named = |line: &str| line.trim_start_matches("# ").starts_with(&format!("{key} =")) || line.contains(&format!("[{key}"));
        assert!(template.lines().any(named), "{key}");
    }

    // Its own robot and ground, two feet off their places, and settings in tables; flags come on top.
    fs::create_dir(dir.path().join("in")).unwrap();
    fs::write(dir.path().join("in/robot.json"), own_robot().to_string()).unwrap();
    fs::write(dir.path().join("in/terrain.json"), own_terrain().to_string()).unwrap();
    let text = "robot = 'robot.json'\nterrain = 'terrain.json'\nfirst = true\nseed = 9\nout = 'out'\n[start]\nyaw = 0.1\n\
                feet = [[0.36, 0.2], [0.34, -0.19], [-0.34, 0.19], [-0.36, -0.2]]\n[goal]\nxy = [0.5, 0.1]\nyaw = 0.2\n\
                [settings.search]\npopulation = 4\nelites = 2\n[settings.solver]\nmax_iterations = 150\n";
    fs::write(dir.path().join("in/own.toml"), text).unwrap();
    run(dir.path(), "solve in/own.toml --seed 3 --set solver.max_iterations=140").ends_with(0);
    let result = read(dir.path().join("in/out/result.json"));
    assert_eq!((&result["seed"], &result["search"]["population"]), (&json!(3), &json!(4)));
    assert_eq!(result["lower"]["solver"]["max_iterations"], 140);
    let trajectory = read(dir.path().join("in/out/trajectory.json"));
    assert_eq!(trajectory["start_feet"][0], json!([0.36, 0.2]));
    run(dir.path(), "verify in/out/trajectory.json").ends_with(0);

    // The same bits again, without the files that it came from.
    for file in ["robot.json", "terrain.json", "own.toml"] {
        fs::remove_file(dir.path().join("in").join(file)).unwrap();
    }
    run(dir.path(), "solve in/out/scenario.toml --out again").ends_with(0);
    for file in ["trajectory.json", "scenario.toml"] {
        let [was, is] = ["in/out", "again"].map(|folder| fs::read(dir.path().join(folder).join(file)).unwrap());
        assert!(was == is, "{file}");
    }
    // A built-in scenario keeps its name.
    run(dir.path(), "solve --scenario biped --target 3 --first --preset experiment1 --out biped").ends_with(0);
    run(dir.path(), "solve biped/scenario.toml --out biped2").ends_with(0);
    let [was, is] = ["biped", "biped2"].map(|folder| read(dir.path().join(folder).join("trajectory.json")));
    assert_eq!((&was, &was["target"]), (&is, &json!(3)));
}

#[test]
fn faults_in_a_scenario_file_are_named() {
    let dir = folder();
    let cases: [(&str, &[&str]); 9] = [
        ("robot = 'anymal'\ngoal = [1", &["line 2 column", "array"]),
        ("robot = 'anymla'\ngoal = { xy = [1, 0] }", &["robot", "anymla", "did you mean `anymal`?"]),
        ("robot = 'anymal'\ngoal = { xy = [1, 0], yow = 1 }", &["goal", "yow", "did you mean `yaw`?"]),
        ("robot = 'anymal'\ngoal = { xy = [1, 'a'] }", &["goal.xy[1]", "string"]),
        ("robot = 'anymal'", &["goal", "none", "scenario file"]),
        ("robot = 'anymal'\ngoal = { xy = [1, 0], tilt = [0, 2] }", &["goal.pitch", "2", "1.4"]),
        ("robot = 'anymal'\ngoal = { xy = [1, 0] }\n[settings.sovler]\nx = 1", &["sovler", "did you mean `solver`?"]),
        (
            "robot = 'anymal'\ngoal = { xy = [1, 0] }\n[settings.solver]\nmax_iteration = 1",
            &["max_iteration", "did you mean `max_iterations`?"],
        ),
        ("robot = 'anymal'\ngoal = { xy = [1, 0] }\n[settings.solver]\nmax_iterations = 'many'", &["solver", "max_iterations", "many"]),
    ];
    for (text, parts) in cases {
        fs::write(dir.path().join("x.toml"), text).unwrap();
        let run = run(dir.path(), "solve x.toml");
        assert!([2, 4].contains(&run.code), "{text}: {}", run.stderr);
        run.says(parts);
    }
}

#[test]
fn a_dash_is_stdin_and_stdout_and_shells_know_the_commands() {
    let dir = folder();
    let piped = |args: &str, input: &[u8]| {
        let output = Command::new(PROGRAM).current_dir(dir.path()).args(args.split_whitespace()).write_stdin(input).output().unwrap();
        (output.status.code(), String::from_utf8(output.stdout).unwrap(), String::from_utf8(output.stderr).unwrap())
    };
    let (code, _, told) = piped("solve - --first --out out", b"robot = 'anymal'\ngoal = { xy = [0.3, 0] }\n");
    assert_eq!(code, Some(0), "{told}");
    let trajectory = fs::read(dir.path().join("out/trajectory.json")).unwrap();
    assert_eq!(piped("verify -", &trajectory).0, Some(0));
    let (code, csv, told) = piped("export - --format csv --rate 10 -o -", &trajectory);
    assert!(code == Some(0) && csv.starts_with("time_s,") && told.contains("samples"), "{told}");
    // Nothing else is in it.
    assert!(csv.lines().skip(1).all(|line| line.split(',').all(|v| v.parse::<f64>().is_ok())));
    // Who reads no further ends nothing.
    let mut export = std::process::Command::new(PROGRAM);
    export.current_dir(dir.path()).args("export out/trajectory.json --format csv --rate 1000 -o -".split_whitespace());
    let mut child = export.stdout(Stdio::piped()).stderr(Stdio::null()).spawn().unwrap();
    drop(child.stdout.take());
    assert_eq!(child.wait().unwrap().code(), Some(0));
    assert!(piped("completions bash", b"").1.contains("cregopt"));
    assert!(piped("man", b"").1.contains(".TH") && piped("man solve", b"").1.contains("seed"));
    let (code, _, told) = piped("man slove", b"");
    assert!(code == Some(2) && told.contains("did you mean `solve`?"), "{told}");
}

/// Solves with some flags: the result, the trajectory and the report of `verify`.
fn solve(folder: &Path, flags: &str) -> (Value, Value, Value) {
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
fn momentum_is_the_default_transcription_and_towr_can_be_asked_for() {
    let dir = folder();
    // 1.2 weights of ANYmal, three where legs are free; what TOWR has for any robot.
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
    // It arrives with speed: not what was asked for when the goal is at rest.
    let mut moving = trajectory.clone();
    moving["limits"]["goal_velocity"] = json!("zero");
    fs::write(dir.path().join("moving.json"), moving.to_string()).unwrap();
    assert!(run(dir.path(), "verify moving.json").ends_with(3).stdout.contains("final"));
}

#[test]
fn a_gait_of_an_earlier_run_is_a_place_to_start_from() {
    let dir = folder();
    let command = |more: &str| format!("solve --robot biped --goal 0.5,0 {more}");
    run(dir.path(), &command("--first --out first")).ends_with(0);
    let first = read(dir.path().join("first/result.json"))["gait"].take();
    // A line of schedules.
    fs::write(dir.path().join("line.json"), json!({"durations": first["durations"], "note": "mine"}).to_string()).unwrap();
    let mut results = Vec::new();
    for (file, out) in [("first/result.json", "a"), ("first/trajectory.json", "b"), ("line.json", "c")] {
        run(dir.path(), &command(&format!("--gait {file} --population 4 --generations 1 --out {out}"))).ends_with(0);
        let result = read(dir.path().join(out).join("result.json"));
        assert_eq!(result["search"]["gaits"]["around"], first["durations"]);
        // It is the first that is evaluated, and nothing dearer is returned.
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
fn alternatives_have_files_of_their_own_and_leave_none_behind() {
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
    // Nothing of it stays, and nothing else goes.
    fs::write(out.join("trajectory-4.json"), "mine").unwrap();
    let ran = run(dir.path(), &command(1));
    assert!(!ran.ends_with(0).stdout.contains("alternative"), "{}", ran.stdout);
    assert_holds_only(&out, &["result.json", "scenario.toml", "trajectory.json", "trajectory-4.json"]);
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

#[test]
fn bad_robot_files_exit_4_and_name_file_field_value_and_limit() {
    let change = |key: &str, value: Value| {
        let mut robot = own_robot();
        robot[key] = value;
        robot.to_string()
    };
    let without = |key: &str| {
        let mut robot = own_robot();
        robot.as_object_mut().unwrap().remove(key);
        robot.to_string()
    };
    let cases: [(String, &[&str]); 19] = [
        (String::new(), &["EOF"]),
        ("{".into(), &["EOF"]),
        ("[1]".into(), &["line 1"]),
        (change("wings", json!(2)), &["unknown field", "wings"]),
        (without("mass"), &["missing field", "mass"]),
        (without("nominal_feet"), &["missing field", "nominal_feet"]),
        (change("mass", json!(-1.0)), &["mass", "-1", "0.001"]),
        (change("mass", Value::Null), &["null", "column"]),
        (change("mass", json!("heavy")), &["heavy", "column"]),
        (own_robot().to_string().replace("30.0", "1e999"), &["number out of range", "column"]),
        (change("base_height", json!(1000.0)), &["base_height", "1000", "100"]),
        (change("nominal_feet", json!(vec![[0.0, 0.0, -0.5]; 9])), &["nominal_feet", "9 feet", "1 to 8"]),
        (change("nominal_feet", json!([])), &["nominal_feet", "0 feet", "1 to 8"]),
        (change("reach", json!([0.1, 0.0, 0.1])), &["reach[1]", "0.001"]),
        (change("reach", json!([[[-0.1, 0.1], [-0.1, 0.1], [-0.1, 0.1]]])), &["reach", "1 boxes", "4 boxes"]),
        (change("reach", json!([[[-0.1, 0.1], [-0.1, "far"], [-0.1, 0.1]]])), &["reach[0][1][1]", "far", "column"]),
        (change("foot_radius", json!(0.3)), &["foot_radius", "0.3", "0.21"]),
        (change("force_limit", json!(0.0)), &["force_limit", "0.001"]),
        (change("inertia", json!([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 9.0]])), &["inertia", "principal moments", "sum"]),
    ];
    let dir = folder();
    for (text, parts) in cases {
        fs::write(dir.path().join("odd.json"), &text).unwrap();
        let ran = run(dir.path(), "solve --robot odd.json --goal 0.1,0 --out out");
        ran.ends_with(4).says(&["odd.json"]).says(parts);
        assert_holds_only(dir.path(), &["odd.json"]);
    }
    run(dir.path(), "solve --robot none.json --goal 0.1,0 --out out").ends_with(4).says(&["none.json"]);
    fs::create_dir(dir.path().join("dir")).unwrap();
    run(dir.path(), "solve --robot dir --goal 0.1,0 --out out").ends_with(4).says(&["dir", "directory"]);
    fs::write(dir.path().join("odd.json"), b"\xff\xfe\x00").unwrap();
    run(dir.path(), "solve --robot odd.json --goal 0.1,0 --out out").ends_with(4).says(&["odd.json", "UTF-8"]);
    assert_holds_only(dir.path(), &["odd.json", "dir"]);
}

#[test]
fn bad_terrain_files_exit_4_and_name_file_field_value_and_limit() {
    let grid = |heights: Value| json!({"name": "g", "friction": 1.0, "shape": {"grid": {"low": [-1.0, -1.0], "high": [1.0, 1.0], "heights": heights}}});
    let cases: [(Value, &[&str]); 9] = [
        (json!({"name": "t", "shape": "flat"}), &["missing field", "friction"]),
        (json!({"name": "t", "friction": 1.0, "shape": "flat", "colour": "red"}), &["unknown field", "colour"]),
        (json!({"name": "t", "friction": -1.0, "shape": "flat"}), &["friction", "-1", "0.001"]),
        (json!({"name": "t", "friction": 1.0, "shape": "round"}), &["round", "flat"]),
        (json!({"name": "t", "friction": 1.0, "shape": {"profile": "hill"}}), &["hill", "stairs"]),
        (grid(json!([[0.0, 0.0], [0.0]])), &["heights[1]", "1 columns", "2 columns"]),
        (grid(json!([[0.0, 0.0]])), &["heights", "1 x 2", "2 x 2"]),
        (grid(json!([[0.0, 0.0], [0.0, 1000.0]])), &["heights[1][1]", "1000", "100"]),
        (grid(json!([[0.0, 0.0], [0.0, null]])), &["null", "column"]),
    ];
    let dir = folder();
    for (terrain, parts) in cases {
        fs::write(dir.path().join("odd.json"), terrain.to_string()).unwrap();
        let ran = run(dir.path(), "solve --scenario s1 --terrain odd.json --goal 0.1,0 --out out");
        ran.ends_with(4).says(&["odd.json"]).says(parts);
        assert_holds_only(dir.path(), &["odd.json"]);
    }
    let mut corners = grid(json!([[0.0, 0.0], [0.0, 0.0]]));
    corners["shape"]["grid"]["high"] = json!([-2.0, 1.0]);
    fs::write(dir.path().join("odd.json"), corners.to_string()).unwrap();
    run(dir.path(), "solve --scenario s1 --terrain odd.json --goal 0.1,0").ends_with(4).says(&["odd.json", "high[0]", "-2"]);
}

// ---------------------------------------------------------------- evaluate

/// Writes lines to `in.jsonl`.
fn write_lines(folder: &Path, lines: &[String]) {
    fs::write(folder.join("in.jsonl"), lines.join("\n") + "\n").unwrap();
}

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
        // Short, but all at once.
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

// ---------------------------------------------------------------- verify

#[test]
fn broken_trajectories_exit_4_and_perturbed_ones_3() {
    let dir = folder();
    write_lines(dir.path(), &[standing().to_string()]);
    run(dir.path(), "evaluate in.jsonl --scenario s1 --trajectories t.jsonl").ends_with(0);
    let mut good = read_lines(dir.path().join("t.jsonl")).remove(0);
    // It is no motion of the scenario that lent it its robot: it has another goal.
    assert!(good.get("scenario").is_none());
    good["scenario"] = Value::Null;
    let path = dir.path().join("t.json");
    let verify = |trajectory: &Value| {
        // Pretty: one document over many lines.
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
fn verify_says_what_a_file_is_held_to_and_refuses_labels_that_do_not_fit() {
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
        verify(&|_| {}, &format!("--force-limit {limit}")).ends_with(2).says(&["--force-limit"]);
    }
    let own = |name: &str, mass: f64| {
        let mut robot = serde_json::to_value(cregopt::Robot::named("anymal").unwrap()).unwrap();
        (robot["name"], robot["mass"]) = (json!(name), json!(mass));
        robot
    };
    // The weight of the robot is another one, and so are its rows.
    verify(&|t| t["robot"] = own("mine, terrain mine", 29.5), "").ends_with(0).says(&[]);
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
fn a_scenario_is_asked_of_a_motion_with_the_robot_that_its_file_has() {
    let dir = folder();
    let mut low = own_robot();
    low["base_height"] = json!(0.47);
    // As folders of sweeps are called.
    fs::create_dir(dir.path().join("height=0.47")).unwrap();
    fs::write(dir.path().join("height=0.47/low.json"), low.to_string()).unwrap();
    run(dir.path(), "solve --scenario s1 --target 3 --robot height=0.47/low.json --first --out out").ends_with(0);
    run(dir.path(), "solve --scenario s1 --target 3 --robot s9=height=0.47/low.json --first").ends_with(2).says(&["scenario", "s9"]);
    run(dir.path(), "verify out/trajectory.json --scenario s1 --target 3").ends_with(0);
    run(dir.path(), "verify out/trajectory.json --scenario s1 --target 4").ends_with(3);
    // Without limits in its file it is held to those of legs that can do anything, and that is said.
    let mut motion = read(dir.path().join("out/trajectory.json"));
    motion["limits"] = Value::Null;
    fs::write(dir.path().join("free.json"), motion.to_string()).unwrap();
    let told = run(dir.path(), "verify free.json");
    assert!(told.ends_with(0).stdout.contains("at most 20.000 m/s, any m/s2"), "{}", told.stdout);
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
    // With the inertia of a possible body the hexapod's do not hold.
    run_in(dir.path(), &args[..2]).ends_with(3);
}

// ---------------------------------------------------------------- the rest

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

/// Waits for a child, at most some seconds.
fn wait(child: &mut std::process::Child, limit: Duration) -> std::process::ExitStatus {
    let start = Instant::now();
    loop {
        if let Some(status) = child.try_wait().unwrap() {
            return status;
        }
        if start.elapsed() > limit {
            child.kill().unwrap();
            panic!("still running after {limit:?}");
        }
        std::thread::sleep(Duration::from_millis(20));
    }
}

/// Starts a search with an output folder `out`, and interrupts it some time after the folder is there, which is made after the handler.
#[cfg(unix)]
fn interrupted(folder: &Path, args: &str, after: Duration) -> std::process::ExitStatus {
    let mut child = std::process::Command::new(PROGRAM)
        .args(args.split_whitespace())
        .current_dir(folder)
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .spawn()
        .unwrap();
    let start = Instant::now();
    while !folder.join("out").exists() && start.elapsed() < Duration::from_secs(10) {
        std::thread::sleep(Duration::from_millis(2));
    }
    std::thread::sleep(after);
    assert!(std::process::Command::new("kill").args(["-INT", &child.id().to_string()]).status().unwrap().success());
    wait(&mut child, Duration::from_secs(20))
}

#[cfg(unix)]
#[test]
fn ctrl_c_before_anything_is_solved_is_no_usage_error() {
    // Hundreds of seconds of ANYmal: none is solved at once.
    let dir = folder();
    let args = "solve --scenario s1 --goal 60,0 --preset experiment3 --set search.free.min_stances=90 --set search.free.max_stances=98 \
                --device cpu --threads 1 --out out";
    assert_eq!(interrupted(dir.path(), args, Duration::ZERO).code(), Some(3));
    assert!(!dir.path().join("out/result.json").exists());
}

#[cfg(unix)]
#[test]
fn ctrl_c_ends_a_search_with_the_best_so_far() {
    let dir = folder();
    // Small enough that many are solved within a second, wherever this runs.
    let args = "solve --scenario biped --preset experiment3 --objective fewest-stances --population 512 --out out";
    let status = interrupted(dir.path(), args, Duration::from_secs(1));
    assert!(matches!(status.code(), Some(0 | 3)), "{status:?}");
    let result = read(dir.path().join("out/result.json"));
    assert_eq!(result["stop"], "cancelled");
    assert_eq!(result["feasible"] == true, status.code() == Some(0));
    run(dir.path(), "verify out/trajectory.json").ends_with(status.code().unwrap());
}

#[test]
fn a_closed_pipe_does_not_panic() {
    let dir = folder();
    for (args, expected) in [("solve --scenario s1 --first", 0), ("list", 0), ("solve --scenario s9", 2)] {
        let mut child = std::process::Command::new(PROGRAM)
            .args(args.split(' '))
            .current_dir(dir.path())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .unwrap();
        // The reading ends close before the program has anything to say.
        drop((child.stdout.take(), child.stderr.take()));
        assert_eq!(wait(&mut child, Duration::from_secs(30)).code(), Some(expected), "{args}");
    }
}

// ---------------------------------------------------------------- devices

/// Runs words separated by spaces where no driver is found.
fn run_without_drivers(folder: &Path, command: &str) -> Ran {
    let output = Command::new(PROGRAM)
        .args(command.split_whitespace())
        .current_dir(folder)
        .envs(["VK_DRIVER_FILES", "VK_ICD_FILENAMES"].map(|name| (name, "/nowhere.json")))
        .timeout(Duration::from_secs(60))
        .output()
        .unwrap();
    let text = |bytes: Vec<u8>| String::from_utf8(bytes).unwrap();
    Ran { code: output.status.code().unwrap_or(-1), stdout: text(output.stdout), stderr: text(output.stderr) }
}

#[test]
fn an_unknown_device_is_a_usage_error_and_a_missing_one_exits_5() {
    let dir = folder();
    run(dir.path(), "solve --scenario s1 --device gpuu").ends_with(2).says(&["--device", "gpuu", "auto, cpu, gpu"]);
    run(dir.path(), "solve --scenario s1 --device gpu --precision f64").ends_with(2).says(&["--device", "f64"]);
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
    // A batch that is large enough to look for one.
    let ran = run_without_drivers(dir.path(), "solve --scenario biped --population 256 --first --json -v");
    ran.ends_with(0).says(&["using the CPU: no hardware GPU found"]);
    let result: Value = serde_json::from_str(&ran.stdout).unwrap();
    assert!(result["device"].as_str().unwrap().starts_with("cpu, "), "{}", result["device"]);
    assert_eq!(result["fallback"], Value::Null);
    // A small one does not look.
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

// ---------------------------------------------------------------- Ipopt and experiments

#[cfg(feature = "ipopt")]
#[test]
fn ipopt_solves_the_same_lines() {
    let folder = folder();
    let mut odd = standing();
    odd["durations"] = json!([[0.6], [0.2, 0.1, 0.25], [0.6], [0.6]]);
    odd["note"] = json!("kept");
    write_lines(folder.path(), &[standing().to_string(), odd.to_string()]);
    let command = "evaluate in.jsonl --robot anymal --solver ipopt --threads 2 --out results.jsonl --trajectories motions.jsonl";
    let ran = run(folder.path(), command);
    ran.ends_with(0);
    assert!(ran.stdout.contains("2 of 2 candidates feasible") && ran.stdout.contains("ipopt"), "{}", ran.stdout);
    let results = read_lines(folder.path().join("results.jsonl"));
    assert_eq!((&results[0]["result"]["status"], &results[0]["result"]["transcription"]), (&json!(0), &json!("towr")));
    assert_eq!((&results[1]["note"], &results[1]["result"]["n_violated"]), (&json!("kept"), &json!(0)));
    run(folder.path(), "verify motions.jsonl").ends_with(0);
}

#[cfg(not(feature = "ipopt"))]
#[test]
fn without_ipopt_asking_for_it_exits_2_and_says_how_to_get_it() {
    let folder = folder();
    write_lines(folder.path(), &[standing().to_string()]);
    for command in ["evaluate in.jsonl --robot anymal --solver ipopt", "experiment 1 --methods towr"] {
        run(folder.path(), command).ends_with(2).says(&["--features ipopt", "coinor-libipopt-dev"]);
    }
}

/// However many panels it has: an end in the middle makes it unreadable.
fn is_one_picture(svg: &str) -> bool {
    svg.starts_with("<svg") && svg.trim_end().ends_with("</svg>") && svg.matches("</svg>").count() == 1
}

#[test]
fn an_experiment_goes_on_where_it_was() {
    let folder = folder();
    let log = folder.path().join("e/experiment2.jsonl");
    let command = |replicates: u32| format!("experiment 2 --methods cregopt-towr --replicates {replicates} --threads 2 --out e");
    let ran = run(folder.path(), &command(1));
    ran.ends_with(0);
    // Three robots, with and without the heuristic.
    let first = read_lines(&log);
    assert_eq!(first.len(), 6);
    assert!(first.iter().all(|run| run["method"] == "cregopt-towr" && run["n_violated"] == 0 && run["success"] == true));
    for key in ["seed", "version", "machine", "budget", "device", "threads", "first_feasible_seconds", "seconds"] {
        assert!(first.iter().all(|run| !run[key].is_null()), "{key}");
    }
    // As if it had been killed while it wrote.
    let whole = fs::read_to_string(&log).unwrap();
    fs::write(&log, whole.clone() + &whole[..100]).unwrap();
    let ran = run(folder.path(), &command(2));
    ran.ends_with(0);
    let second = read_lines(&log);
    // Replicates of two are the first and the last; of one, the middle.
    assert_eq!((second.len(), &second[..6]), (18, &first[..]));
    assert_eq!(ran.stderr.matches("found in").count(), 12, "{}", ran.stderr);
    let again = run(folder.path(), &command(2));
    assert_eq!((again.stderr.matches("found in").count(), read_lines(&log).len()), (0, 18));

    let text = |name: &str| fs::read_to_string(folder.path().join("e").join(name)).unwrap();
    assert_eq!(text("experiment2.csv").lines().count(), 19);
    assert!(text("experiment2.md").contains("| hex |") && text("experiment2.md").contains("3 of 3"));
    assert_eq!(read(folder.path().join("e/experiment2.json"))["lines"].as_array().unwrap().len(), 6);
    for name in ["experiment2_times.svg", "experiment2_gaits.svg"] {
        assert!(is_one_picture(&text(name)) && text(name).contains("biped"), "{name}");
    }
}

#[test]
fn objectives_are_plotted_over_generations() {
    let folder = folder();
    let command = "experiment 3 --methods cregopt --replicates 1 --generations 3 --populations 8 --threads 2 --out e";
    let ran = run(folder.path(), command);
    assert!([0, 3].contains(&ran.code), "{}", ran.stderr);
    let runs = read_lines(folder.path().join("e/experiment3.jsonl"));
    assert!(runs.iter().all(|run| run["best_objectives"].as_array().unwrap().len() == 3));
    assert!(is_one_picture(&fs::read_to_string(folder.path().join("e/experiment3_objectives.svg")).unwrap()));
}

#[test]
fn a_bad_experiment_exits_2_or_4_and_names_what_is_wrong() {
    let folder = folder();
    run(folder.path(), "experiment 4").ends_with(2).says(&["1, 2, 3 or all"]);
    run(folder.path(), "experiment 1 --methods snopt").ends_with(2).says(&["snopt", "contact-implicit"]);
    run(folder.path(), "experiment 3 --methods random").ends_with(2).says(&["--methods: random", "experiment 3"]);
    run(folder.path(), "experiment 1 --replicates 0").ends_with(2).says(&["--replicates", "at least 1"]);
    run(folder.path(), "experiment 3 --populations 70000 --methods cregopt").ends_with(2).says(&["search.free.population", "65536"]);
    fs::create_dir(folder.path().join("e")).unwrap();
    fs::write(folder.path().join("e/experiment1.jsonl"), "{\"experiment\": 1}\n").unwrap();
    run(folder.path(), "experiment 1 --methods cregopt --out e").ends_with(4).says(&["experiment1.jsonl", "line 1", "missing field"]);
}
