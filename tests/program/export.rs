//! Motions that `export` writes for other programs.

use crate::harness;
use serde_json::Value;
use std::collections::BTreeMap;
use std::fs;
use std::path::Path;
use tempfile::TempDir;

/// Runs the program in a folder: exit code and messages.
fn run(folder: &Path, command: &str) -> (i32, String) {
    let ran = harness::run(folder, command);
    (ran.code, ran.stderr)
}

/// A quadruped that turns while it walks up a slope.
fn gait() -> TempDir {
    let folder = tempfile::tempdir().unwrap();
    let heights: Vec<Vec<f64>> = (0..10).map(|i| vec![0.1 * f64::from(i) - 0.5; 2]).collect();
    let terrain = serde_json::json!({"name": "ramp", "friction": 0.8, "shape": {"grid": {"low": [-10.0, -10.0], "high": [10.0, 10.0], "heights": heights}}});
    fs::write(folder.path().join("ramp.json"), terrain.to_string()).unwrap();
    let (code, message) = run(folder.path(), "solve --robot anymal --terrain ramp.json --goal 1,0.1 --yaw 0.4 --first --out out");
    assert_eq!(code, 0, "{message}");
    folder
}

/// Columns by their names.
fn columns(text: &str) -> BTreeMap<String, Vec<f64>> {
    let mut lines = text.lines();
    let names: Vec<&str> = lines.next().unwrap().split(',').collect();
    let rows: Vec<Vec<f64>> = lines.map(|line| line.split(',').map(|v| v.parse().unwrap()).collect()).collect();
    assert!(rows.iter().all(|row| row.len() == names.len()));
    names.iter().enumerate().map(|(i, name)| ((*name).to_owned(), rows.iter().map(|row| row[i]).collect())).collect()
}

#[test]
fn a_csv_motion_is_consistent_with_its_forces() {
    const RATE: f64 = 2000.;
    let folder = gait();
    let (code, message) = run(folder.path(), "export out/trajectory.json --format csv --rate 2000");
    assert_eq!(code, 0, "{message}");
    let of = columns(&fs::read_to_string(folder.path().join("out/trajectory.csv")).unwrap());
    let time = &of["time_s"];
    let trajectory: Value = serde_json::from_str(&fs::read_to_string(folder.path().join("out/trajectory.json")).unwrap()).unwrap();
    assert_eq!(time.last().copied(), trajectory["T"].as_f64());
    assert_eq!(Some(of["base_position_z_m"][0]), trajectory["init_base"][2].as_f64());
    assert!((of["base_yaw_rad"].last().unwrap() - 0.4).abs() < 1e-3);
    let feet = ["LF", "RF", "LH", "RH"];
    // The velocities are the derivatives of the positions.
    for what in ["base", "LF", "RH"] {
        for axis in ["x", "y", "z"] {
            let (p, v) = (&of[&format!("{what}_position_{axis}_m")], &of[&format!("{what}_velocity_{axis}_m/s")]);
            for i in (1..time.len() - 2).step_by(7) {
                let slope = (p[i + 1] - p[i - 1]) / (time[i + 1] - time[i - 1]);
                // The difference is half of the effect of an acceleration in a step, of at most 20 g, where that begins or ends.
                assert!((slope - v[i]).abs() < 196.2 / 2. / RATE + 1e-3, "{what} {axis} at {} s: {slope}, {}", time[i], v[i]);
            }
        }
    }
    // Quaternion, Euler angles and angular velocity belong to one rotation: 2 q' q^-1 = (0, w).
    let q = |i: usize| ["w", "x", "y", "z"].map(|part| of[&format!("base_quaternion_{part}")][i]);
    for i in (1..time.len() - 2).step_by(11) {
        let [w, x, y, z] = q(i);
        assert!((w * w + x * x + y * y + z * z - 1.).abs() < 1e-12);
        let yaw = (2. * (w * z + x * y)).atan2(1. - 2. * (y * y + z * z));
        let pitch = (2. * (w * y - z * x)).asin();
        assert!((yaw - of["base_yaw_rad"][i]).abs() < 1e-9 && (pitch - of["base_pitch_rad"][i]).abs() < 1e-9);
        let rate: [f64; 4] = std::array::from_fn(|d| (q(i + 1)[d] - q(i - 1)[d]) / (time[i + 1] - time[i - 1]));
        let spin = [
            2. * (-rate[0] * x + rate[1] * w - rate[2] * z + rate[3] * y),
            2. * (-rate[0] * y + rate[1] * z + rate[2] * w - rate[3] * x),
            2. * (-rate[0] * z - rate[1] * y + rate[2] * x + rate[3] * w),
        ];
        for (axis, spin) in ["x", "y", "z"].iter().zip(spin) {
            // The difference is the mean over both steps, also where the angular acceleration jumps.
            let w = &of[&format!("base_angular_velocity_{axis}_rad/s")];
            let mean = (w[i - 1] + 2. * w[i] + w[i + 1]) / 4.;
            assert!((spin - mean).abs() < 2e-5, "{axis} at {} s: {spin}, {mean}", time[i]);
        }
    }
    // Forces act from the ground on the feet: with the weight they change the momentum of the base, within the certified tolerance.
    let (mass, gravity) = (29.5, 9.80665);
    for (axis, weight) in [("x", 0.), ("y", 0.), ("z", mass * gravity)] {
        let force = |i: usize| feet.iter().map(|foot| of[&format!("{foot}_force_{axis}_N")][i]).sum::<f64>() - weight;
        let velocity = &of[&format!("base_velocity_{axis}_m/s")];
        let mut impulse = 0.;
        for i in 1..time.len() {
            impulse += (force(i) + force(i - 1)) / 2. * (time[i] - time[i - 1]);
            if (time[i] * 10.).fract() < 1e-6 {
                assert!((mass * (velocity[i] - velocity[0]) - impulse).abs() < 0.05, "{axis} at {} s", time[i]);
            }
        }
    }
    for foot in feet {
        let contact = &of[&format!("{foot}_contact")];
        assert!(contact.contains(&0.) && contact.contains(&1.) && contact.iter().all(|c| *c == 0. || *c == 1.));
        for (i, contact) in contact.iter().enumerate() {
            let force = of[&format!("{foot}_force_z_N")][i];
            assert!(if *contact == 0. { force == 0. } else { force > -0.05 }, "{foot} at {} s: {force} N", time[i]);
        }
    }
}

#[cfg(feature = "mcap")]
#[test]
fn messages_in_mcap_match_their_schemas_and_the_motion() {
    let folder = gait();
    let (code, message) = run(folder.path(), "export out/trajectory.json --format mcap --rate 20 -o motion.mcap");
    assert_eq!(code, 0, "{message}");
    run(folder.path(), "export out/trajectory.json --format csv --rate 20 -o motion.csv");
    let of = columns(&fs::read_to_string(folder.path().join("motion.csv")).unwrap());
    let bytes = fs::read(folder.path().join("motion.mcap")).unwrap();
    let mut validators = BTreeMap::new();
    let mut counts: BTreeMap<String, usize> = BTreeMap::new();
    for message in mcap::MessageStream::new(&bytes).unwrap() {
        let message = message.unwrap();
        let schema = message.channel.schema.clone().unwrap();
        let value: Value = serde_json::from_slice(&message.data).unwrap();
        let validator = validators.entry(schema.name.clone()).or_insert_with(|| {
            assert_eq!((schema.encoding.as_str(), message.channel.message_encoding.as_str()), ("jsonschema", "json"));
            jsonschema::validator_for(&serde_json::from_slice(&schema.data).unwrap()).unwrap()
        });
        if let Err(error) = validator.validate(&value) {
            panic!("{}: {error}", schema.name);
        }
        let count = counts.entry(message.channel.topic.clone()).or_default();
        let (row, seconds) = (*count, message.log_time as f64 / 1e9);
        *count += 1;
        assert!((seconds - of["time_s"][row]).abs() < 1e-8);
        let number = |pointer: &str| value.pointer(pointer).and_then(Value::as_f64).unwrap_or(f64::NAN);
        match message.channel.topic.as_str() {
            "/tf" => {
                assert_eq!(value["transforms"][0]["child_frame_id"], "base");
                assert_eq!(number("/transforms/0/translation/x"), of["base_position_x_m"][row]);
                assert_eq!(number("/transforms/1/translation/y"), of["LF_position_y_m"][row]);
                assert_eq!(number("/transforms/0/rotation/z"), of["base_quaternion_z"][row]);
            }
            "/motion" => {
                assert_eq!(number("/feet/RH/force/z"), of["RH_force_z_N"][row]);
                assert_eq!(value["feet"]["RH"]["contact"], of["RH_contact"][row] == 1.);
            }
            _ => {
                let ids: Vec<&str> = value["entities"].as_array().unwrap().iter().map(|e| e["id"].as_str().unwrap()).collect();
                assert_eq!(ids, if row == 0 { vec!["robot", "ground", "plan"] } else { vec!["robot"] });
                // An arrow points along its force: the x axis of its pose.
                let standing = ["LF", "RF", "LH", "RH"].iter().filter(|foot| of[&format!("{foot}_contact")][row] == 1.).count();
                assert!(value["entities"][0]["arrows"].as_array().unwrap().len() <= standing);
            }
        }
    }
    let rows = of["time_s"].len();
    assert_eq!(counts.into_iter().collect::<Vec<_>>(), [("/motion".into(), rows), ("/scene".into(), rows), ("/tf".into(), rows)]);
}

#[cfg(feature = "mcap")]
#[test]
fn messages_of_ros_2_have_their_definitions_and_one_trajectory() {
    let folder = gait();
    let (code, message) = run(folder.path(), "export out/trajectory.json --format ros2 --rate 20");
    assert_eq!(code, 0, "{message}");
    let bytes = fs::read(folder.path().join("out/trajectory.ros2.mcap")).unwrap();
    let header = mcap::read::LinearReader::new(&bytes).unwrap().next().unwrap().unwrap();
    assert!(matches!(header, mcap::records::Record::Header(header) if header.profile == "ros2"));
    let mut counts: BTreeMap<String, usize> = BTreeMap::new();
    for message in mcap::MessageStream::new(&bytes).unwrap() {
        let message = message.unwrap();
        let schema = message.channel.schema.clone().unwrap();
        assert_eq!((schema.encoding.as_str(), message.channel.message_encoding.as_str()), ("ros2msg", "cdr"));
        assert!(schema.name.contains("/msg/") && message.data.starts_with(&[0, 1, 0, 0]), "{}", schema.name);
        *counts.entry(message.channel.topic.clone()).or_default() += 1;
        if schema.name == "trajectory_msgs/msg/MultiDOFJointTrajectory" {
            let text = String::from_utf8(schema.data.to_vec()).unwrap();
            let types: Vec<&str> = text.lines().filter_map(|line| line.strip_prefix("MSG: ")).collect();
            for kind in ["trajectory_msgs/MultiDOFJointTrajectoryPoint", "geometry_msgs/Twist", "builtin_interfaces/Duration"] {
                assert!(types.contains(&kind), "{types:?}");
            }
        }
    }
    let samples = counts["/tf"];
    assert!(
        samples > 10 && counts["/base_trajectory"] == 1 && counts["/feet/LF/wrench"] == samples && counts["/feet/RH/contact"] == samples
    );
    assert_eq!(counts.len(), 10, "{counts:?}");
}

#[test]
fn files_that_cannot_be_exported_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    fs::write(folder.path().join("half.json"), "{").unwrap();
    for (command, code, part) in [
        ("export half.json --format csv", 4, "half.json"),
        ("export missing.json --format csv", 4, "missing.json"),
        ("export half.json --format xlsx", 2, "xlsx"),
        ("export half.json", 2, "--format"),
    ] {
        let (ended, message) = run(folder.path(), command);
        assert!(ended == code && message.contains(part), "{command}: {ended} {message}");
    }
    let folder = gait();
    for rate in ["0", "1e9", "nan"] {
        let (code, message) = run(folder.path(), &format!("export out/trajectory.json --format csv --rate {rate}"));
        assert!(code == 2 && message.contains("rate") && message.contains("10000"), "{rate}: {code} {message}");
        assert!(!folder.path().join("out/trajectory.csv").exists());
    }
}
