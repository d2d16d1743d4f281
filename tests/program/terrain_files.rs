//! Meshes as terrains.

use crate::harness::{folder, read, run};
use std::fs;
use std::path::Path;

/// Writes a ramp of 6 cm per metre, 8 m long and 3 m wide, with a step of 5 cm at x = 1 m, as OBJ.
fn ramp(path: &Path) {
    let height = |x: f64| 0.06 * x + if x > 1. { 0.05 } else { 0. };
    let mut text = String::from("# ramp\n");
    for x in [-3., 1., 1. + 1e-9, 5.] {
        for y in [-1.5, 1.5] {
            text += &format!("v {x} {y} {}\n", height(x));
        }
    }
    text += "f 1 3 4 2\nf 3 5 6 4\nf 5 7 8 6\n";
    fs::write(path, text).unwrap();
}

/// Heights and lower corner of a terrain file.
fn grid(path: &Path) -> (Vec<Vec<f64>>, [f64; 2], [f64; 2]) {
    let grid = &read(path)["shape"]["grid"];
    let corner = |name: &str| serde_json::from_value(grid[name].clone()).unwrap();
    (serde_json::from_value(grid["heights"].clone()).unwrap(), corner("low"), corner("high"))
}

#[test]
fn a_mesh_is_imported_with_the_given_cell_and_a_stated_one() {
    let dir = folder();
    ramp(&dir.path().join("ramp.obj"));
    let ran = run(dir.path(), "terrain import ramp.obj --cell 0.1 --friction 0.6 --name hill -o hill.json");
    ran.ends_with(0);
    assert!(ran.stdout.contains("hill: 81 x 31 samples every 0.1000 m, x from -3.000 to 5.100 m"), "{}", ran.stdout);
    let (heights, low, high) = grid(&dir.path().join("hill.json"));
    assert_eq!((heights.len(), heights[0].len(), low), (81, 31, [-3., -1.5]));
    assert!((high[0] - 5.1).abs() < 1e-9 && (high[1] - 1.6).abs() < 1e-9);
    for (i, row) in heights.iter().enumerate() {
        let x = -3. + 0.1 * i as f64;
        // At the step, at row 40, the upper side counts.
        let expected = 0.06 * x + if i >= 40 { 0.05 } else { 0. };
        assert!(row.iter().all(|height| (height - expected).abs() < 1e-6), "x = {x}: {row:?}, not {expected}");
    }
    let ran = run(dir.path(), "terrain import ramp.obj --origin 0,0 -o moved.json");
    ran.ends_with(0);
    assert!(ran.stdout.contains("cell of 0.02 m chosen for a mesh of 8.000 x 3.000 m"), "{}", ran.stdout);
    assert_eq!(grid(&dir.path().join("moved.json")).1, [0., 0.]);
}

#[test]
fn a_mesh_is_a_terrain_on_the_command_line_and_in_a_scenario_file() {
    let dir = folder();
    ramp(&dir.path().join("ramp.obj"));
    let ran = run(dir.path(), "solve --robot anymal --terrain ramp.obj --goal 0.6,0 --first --out flag");
    ran.ends_with(0).says(&["ramp: 401 x 151 samples every 0.0200 m", "cell of 0.02 m chosen for a mesh of 8.000 x 3.000 m"]);
    let scenario = "robot = \"anymal\"\nterrain = \"../ramp.obj\"\nfirst = true\nout = \"../file\"\n[goal]\nxy = [0.6, 0.0]\n";
    fs::create_dir(dir.path().join("tasks")).unwrap();
    fs::write(dir.path().join("tasks/walk.toml"), scenario).unwrap();
    run(dir.path(), "solve tasks/walk.toml").ends_with(0);
    let motion = |out: &str| read(dir.path().join(out).join("trajectory.json"));
    assert_eq!(motion("flag"), motion("file"));
    // The motion has the grid itself, so that it is verified without the mesh.
    fs::remove_file(dir.path().join("ramp.obj")).unwrap();
    run(dir.path(), "verify flag/trajectory.json").ends_with(0);
    assert!((motion("flag")["base_target"][2].as_f64().unwrap() - 0.536).abs() < 0.02);
}

#[test]
fn errors_in_meshes_name_file_place_value_and_limit() {
    let dir = folder();
    fs::write(dir.path().join("odd.obj"), "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 7\n").unwrap();
    fs::write(dir.path().join("odd.ply"), "ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nend_header\n0\n").unwrap();
    fs::write(dir.path().join("map.csv"), "0,0\n0,0\n").unwrap();
    fs::write(dir.path().join("odd.mcap"), "not MCAP").unwrap();
    for (command, code, parts) in [
        ("terrain import odd.obj -o o.json", 4, &["odd.obj: line 4: vertex 7, but it must be 1 to 3"][..]),
        ("solve --robot anymal --goal 1,0 --terrain odd.obj", 4, &["odd.obj: line 4: vertex 7"]),
        ("terrain import odd.ply -o o.json", 4, &["odd.ply: element vertex: without x, y and z"]),
        ("terrain import map.csv -o o.json", 4, &["map.csv: --cell: missing, but it must be given"]),
        ("solve --robot anymal --goal 1,0 --terrain map.csv", 4, &["map.csv: --cell: missing", "terrain import"]),
        ("terrain import map.csv --cell 0.1 --layer elevation -o o.json", 4, &["--layer", "only grid maps"]),
        ("terrain import map.csv --cell 0 -o o.json", 2, &["--cell: 0, but it must be a number from 0.001 to 100"]),
        ("terrain import odd.mcap -o o.json", 4, &["odd.mcap: MCAP"]),
        ("terrain import map.stl -o o.json", 4, &["map.stl"]),
        ("solve --robot anymal --goal 1,0 --terrain hill", 2, &["hill", ".obj", ".mcap"]),
    ] {
        run(dir.path(), command).ends_with(code).says(parts);
        assert!(!dir.path().join("o.json").exists());
    }
}
