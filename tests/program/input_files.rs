//! Robot and terrain files with errors.

use crate::harness::{assert_holds_only, folder, own_robot, run};
use serde_json::{Value, json};
use std::fs;

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
