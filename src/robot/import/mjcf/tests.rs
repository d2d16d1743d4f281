//! MJCF files: the robot of a URDF, and invalid files.

use crate::robot::import::Import;
use crate::robot::import::tests::{mutate, standing};
use std::fs;

const FOUR: &str = include_str!("../../../../tests/data/quadruped.xml");

/// A base that carries a body, and other elements.
fn model(body: &str, others: &str) -> String {
    format!("<mujoco><worldbody><body name=\"base\"><geom size=\"0.1\"/>{body}</body></worldbody>{others}</mujoco>")
}

/// A body below the base, with one hinge.
fn hung(inside: &str) -> String {
    model(&format!("<body name=\"hung\"><joint name=\"turn\"/>{inside}</body>"), "")
}

#[test]
fn an_mjcf_file_gives_the_robot_of_the_urdf_file() {
    let legs = ["LF", "RF", "LH", "RH"];
    // A file in MJCF has no speed limits.
    let urdf = include_str!("../../../../tests/data/quadruped.urdf").replace("velocity=\"12\"", "velocity=\"0\"");
    let expected = Import { configuration: standing(), ..Import::default() }.urdf(&urdf).unwrap();
    let imported = Import::default().mjcf(FOUR).unwrap();
    assert_eq!(imported.feet.iter().map(|foot| foot.link.as_str()).collect::<Vec<_>>(), legs.map(|leg| format!("{leg}_foot")));
    assert!(imported.notes.iter().any(|note| note.contains("keyframe")), "{:?}", imported.notes);
    let [ours, theirs] = [&imported.robot, &expected.robot].map(|robot| serde_json::to_value(robot).unwrap());
    assert_close("robot", &ours, &theirs);
    let given = Import { configuration: vec![("LF_knee".into(), -1.5)], ..Import::default() }.mjcf(FOUR).unwrap();
    let value = |name: &str| given.configuration.iter().find(|(joint, _)| joint == name).unwrap().1;
    assert_eq!((value("LF_knee"), value("RF_knee")), (-1.5, -std::f64::consts::FRAC_PI_2));
}

/// Numbers agree to 1e-9; everything else is equal.
fn assert_close(place: &str, ours: &serde_json::Value, theirs: &serde_json::Value) {
    use serde_json::Value::{Array, Number, Object};
    match (ours, theirs) {
        (Number(a), Number(b)) => assert!((a.as_f64().unwrap() - b.as_f64().unwrap()).abs() < 1e-9, "{place}: {a} {b}"),
        (Array(a), Array(b)) if a.len() == b.len() => {
            a.iter().zip(b).enumerate().for_each(|(i, (a, b))| assert_close(&format!("{place}.{i}"), a, b))
        }
        (Object(a), Object(b)) if a.keys().eq(b.keys()) => {
            a.iter().zip(b).for_each(|((key, a), (_, b))| assert_close(&format!("{place}.{key}"), a, b));
        }
        _ => assert_eq!(ours, theirs, "{place}"),
    }
}

#[test]
fn errors_in_mjcf_files_name_the_place_the_value_and_the_limit() {
    let nested = format!("{}{}", "<body>".repeat(300), "</body>".repeat(300));
    let cases: &[(String, &[&str])] = &[
        (String::new(), &["empty", "an MJCF file"]),
        ("<robot/>".into(), &["<robot>", "<mujoco>"]),
        ("<mujoco/>".into(), &["<worldbody>", "no body with joints"]),
        (model("", ""), &["no body with joints"]),
        (hung("<geom/>"), &["line 1, body `hung`, <geom>, `size`", "positive numbers for a sphere"]),
        (hung("<geom type=\"box\" size=\"1 0.1\"/>"), &["`size`", "1 0.1 0", "3 positive numbers for a box"]),
        (hung("<geom type=\"cone\"/>"), &["`type`", "\"cone\"", "capsule"]),
        (hung("<geom type=\"capsule\" size=\"0.1\" fromto=\"0 0 1 0 0 1\"/>"), &["`fromto`", "two points"]),
        (hung("<geom size=\"0.1\" pos=\"0 0\"/>"), &["`pos`", "3 numbers"]),
        (hung("<geom name=\"shank\" size=\"0.1\" quat=\"0 0 0 0\"/>"), &["geom `shank`, `quat`", "not zero"]),
        (hung("<geom size=\"0.1\" class=\"legs\"/>"), &["`class`", "\"legs\"", "<default>"]),
        (hung("<geom type=\"mesh\" mesh=\"shank\"/>"), &["body `hung`", "a mesh, and no <inertial>", "<inertial>"]),
        (hung("<inertial pos=\"0 0 0\" mass=\"-1\" diaginertia=\"1 1 1\"/>"), &["body `hung`, <inertial>, `mass`", "-1", "not negative"]),
        (hung("<inertial pos=\"0 0 0\" mass=\"1\"/>"), &["`diaginertia`", "missing"]),
        (hung("<joint type=\"ball\"/>"), &["`type`", "\"ball\"", "hinge or slide"]),
        (hung("<joint axis=\"0 0 0\"/>"), &["`axis`", "a direction"]),
        (hung("<joint range=\"1 -1\"/>"), &["`range`", "1 to -1", "the lower end first"]),
        (hung("<joint range=\"a 1\"/>"), &["`range`", "\"a\"", "a number"]),
        (hung(&nested), &["at depth 201", "at most 200"]),
        (model("<body><joint/></body>", "<compiler eulerseq=\"xw\"/>"), &["`eulerseq`", "\"xw\"", "three of the letters"]),
        (model("<body><joint/></body>", "<compiler angle=\"grad\"/>"), &["`angle`", "\"grad\"", "degree, radian"]),
        (model("<body><joint/></body>", "<keyframe><key qpos=\"1 2\"/></keyframe>"), &["`qpos`", "2 numbers", "1 numbers"]),
        (model("<body><joint/></body>", "<include file=\"legs.xml\"/>"), &["line 1, <include>, `file`", "\"legs.xml\"", "absent"]),
        (hung("<geom size=\"0.1\" mass=\"1\"/>"), &["foot `hung`", "with 1 joints"]),
    ];
    for (text, parts) in cases {
        let error = Import::default().mjcf(text).unwrap_err().to_string();
        assert!(parts.iter().all(|part| error.contains(part)) && error.lines().count() == 1 && error.len() < 500, "{parts:?}: {error}");
    }
}

#[test]
fn an_mjcf_file_may_include_others_once() {
    let folder = tempfile::tempdir().unwrap();
    let write = |name: &str, text: &str| fs::write(folder.path().join(name), text).unwrap();
    let read = |name: &str| Import::default().file(&folder.path().join(name));
    let (start, legs) = FOUR.split_once("  <worldbody>").unwrap();
    write("classes.xml", &format!("{}</mujoco>", start.replace("-34.37746770784939 34", "x 34")));
    write("four.xml", &format!("<mujoco model=\"four\"><include file=\"classes.xml\"/><worldbody>{legs}"));
    // The error is in the included file.
    let error = read("four.xml").unwrap_err().to_string();
    assert!(error.contains("four.xml: classes.xml: line 12, <joint>, `range`: \"x\""), "{error}");
    write("classes.xml", &format!("{start}</mujoco>"));
    assert_eq!(read("four.xml").unwrap().robot, Import::default().mjcf(FOUR).unwrap().robot);
    write("twice.xml", &format!("<mujoco><include file=\"classes.xml\"/><include file=\"classes.xml\"/><worldbody>{legs}"));
    let error = read("twice.xml").unwrap_err().to_string();
    assert!(error.contains("twice.xml: line 1, <include>, `file`: \"classes.xml\"") && error.contains("once"), "{error}");
    write("missing.xml", "<mujoco><include file=\"nothing.xml\"/></mujoco>");
    assert!(read("missing.xml").unwrap_err().to_string().contains("nothing.xml"));
}

#[test]
fn mutated_mjcf_files_are_read_or_refused() {
    let parts = ["<", ">", "\"", "0", "-1", "1e308", "NaN", "inf", " ", "", "body", "joint", "class", "leg", "frame", "\u{e9}"];
    let [read, refused] = mutate(FOUR, &parts, 1000, |text| Import::default().mjcf(text));
    assert!(read > 20 && refused > 200, "{read} read, {refused} refused");
}
