//! Scenario files: `cregopt init`, `cregopt solve FILE`, and the errors that they give.

use crate::harness::{folder, own_robot, own_terrain, read, run};
use serde_json::json;
use std::fs;

#[test]
fn a_scenario_file_sets_everything_and_that_of_a_result_repeats_the_run() {
    let dir = folder();
    run(dir.path(), "init walk.toml").ends_with(0);
    run(dir.path(), "init walk.toml").ends_with(4).says(&["walk.toml", "exists"]);
    // The template has every key, in use or commented out.
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

    // Its own robot and terrain, two feet away from their nominal positions, and settings in tables; flags take precedence.
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

    // The run repeats bit for bit without the files that the scenario referred to.
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
