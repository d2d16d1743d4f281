//! Files that the program reads and writes against the JSON Schemas that it prints.

use crate::harness::{self, read};
use serde_json::{Value, json};
use std::fs;
use std::path::Path;

/// Runs the program in a folder: exit code and output.
fn run(folder: &Path, command: &str) -> (i32, String) {
    let ran = harness::run(folder, command);
    (ran.code, ran.stdout)
}

fn schema(folder: &Path, file: &str) -> Value {
    let (code, text) = run(folder, &format!("schema {file}"));
    assert_eq!(code, 0);
    serde_json::from_str(&text).unwrap()
}

/// The first error that a schema finds in a value.
fn wrong(schema: &Value, value: &Value) -> Option<String> {
    let validator = jsonschema::draft202012::new(schema).unwrap();
    validator.validate(value).err().map(|error| format!("{} at {}", error, error.instance_path()))
}

/// Follows references; among alternatives, the one that is an object with properties.
fn resolved<'a>(root: &'a Value, schema: &'a Value) -> &'a Value {
    if let Some(name) = schema["$ref"].as_str() {
        return resolved(root, root.pointer(name.trim_start_matches('#')).unwrap());
    }
    let found = ["anyOf", "oneOf"].iter().filter_map(|key| schema[*key].as_array()).flatten().map(|s| resolved(root, s));
    found.into_iter().find(|s| s["properties"].is_object()).unwrap_or(schema)
}

/// Collects the keys of a value that its schema does not name.
fn unnamed(root: &Value, schema: &Value, value: &Value, path: &str, into: &mut Vec<String>) {
    let schema = resolved(root, schema);
    match value {
        Value::Object(object) => {
            for (key, value) in object {
                match &schema["properties"][key] {
                    Value::Null if schema["properties"].is_object() => into.push(format!("{path}/{key}")),
                    of => unnamed(root, of, value, &format!("{path}/{key}"), into),
                }
            }
        }
        Value::Array(items) => items.iter().for_each(|item| unnamed(root, &schema["items"], item, path, into)),
        _ => {}
    }
}

#[test]
fn every_kind_of_result_matches_its_schema() {
    let folder = tempfile::tempdir().unwrap();
    let (result, trajectory) = (schema(folder.path(), "result"), schema(folder.path(), "trajectory"));
    let runs = [
        ("biped", "solve --robot biped --goal 0.6,0 --alternatives 2 --generations 1 --set search.further_generations=1", 0),
        ("refined", "solve --robot biped --goal 0.6,0 --first --refine --set refine.iterations=2", 0),
        ("paper", "solve --scenario s1 --preset experiment1 --goal 0.5,0 --population 4 --generations 1", -1),
        ("towr", "solve --scenario biped --transcription towr --first --smooth", -1),
        ("weak", "solve --robot biped --goal 0.3,0 --force-limit 20 --generations 0 --set search.further_generations=0", 3),
    ];
    for (name, command, expected) in runs {
        let (code, _) = run(folder.path(), &format!("{command} --out {name}"));
        assert!(code == expected || expected == -1 && (code == 0 || code == 3), "{command}: {code}");
        let value = read(folder.path().join(name).join("result.json"));
        assert_eq!(wrong(&result, &value), None, "{name}");
        let mut keys = Vec::new();
        unnamed(&result, &result, &value, "", &mut keys);
        assert!(keys.is_empty(), "{name}: {keys:?}");
        assert_eq!(wrong(&trajectory, &read(folder.path().join(name).join("trajectory.json"))), None, "{name}");
    }
    // A schema that accepts everything would have passed until here.
    let mut value = read(folder.path().join("biped/result.json"));
    value["gait"]["durations"] = json!("long");
    assert!(wrong(&result, &value).unwrap().contains("durations"));
    value = read(folder.path().join("biped/result.json"));
    value.as_object_mut().unwrap().remove("certificate");
    assert!(wrong(&result, &value).is_some());
    let mut value = read(folder.path().join("biped/trajectory.json"));
    value["base_lin"]["nodes"][0] = json!([0, 0, 0]);
    assert!(wrong(&trajectory, &value).is_some());
}

#[test]
fn robots_and_terrains_match_their_schemas() {
    let folder = tempfile::tempdir().unwrap();
    let (robot, terrain) = (schema(folder.path(), "robot"), schema(folder.path(), "terrain"));
    let feet = [[0.34, 0.19, -0.42], [0.34, -0.19, -0.42], [-0.34, 0.19, -0.42], [-0.34, -0.19, -0.42]];
    let mut own = json!({
        "name": "mine", "mass": 29.5, "inertia": [[0.95, 0, 0], [0, 1.94, 0], [0, 0, 2.02]], "base_height": 0.5,
        "nominal_feet": feet, "reach": [0.15, 0.1, 0.1]
    });
    assert_eq!(wrong(&robot, &own), None);
    let mut ground =
        json!({"name": "mine", "friction": 0.8, "shape": {"grid": {"low": [-1, -1], "high": [5, 1], "heights": [[0, 0], [0, 0]]}}});
    assert_eq!(wrong(&terrain, &ground), None);
    for shape in [json!("flat"), json!({"profile": "chimney-lr"})] {
        assert_eq!(wrong(&terrain, &json!({"name": "mine", "friction": 1, "shape": shape})), None);
    }
    // The schemas refuse files that the program refuses for their form.
    own["wings"] = json!(2);
    ground["shape"] = json!("round");
    assert!(wrong(&robot, &own).is_some() && wrong(&terrain, &ground).is_some());
    fs::write(folder.path().join("robot.json"), own.to_string()).unwrap();
    fs::write(folder.path().join("terrain.json"), ground.to_string()).unwrap();
    assert_eq!(run(folder.path(), "solve --robot robot.json --goal 1,0").0, 4);
    assert_eq!(run(folder.path(), "solve --robot anymal --terrain terrain.json --goal 1,0").0, 4);
    // A robot in a trajectory is a name or a whole robot.
    let trajectory = schema(folder.path(), "trajectory");
    assert!(trajectory.to_string().contains("nominal_feet"));
}
