//! Data sets of certified motions: the same files however they are made, and a check that finds what is wrong.

use crate::harness::{PROGRAM, folder, read, run};
use std::collections::BTreeMap;
use std::fs;
use std::path::Path;
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

const SPEC: &str = r#"
count = 24
rate = 25
length = 1.2
robots = ["biped", "anymal"]
grounds = ["flat", { terrain = "slope", x = [1.2, 1.3] }]
kinds = ["rest", "start", "steady", "periodic"]
shard = 12
licence = "CC0-1.0"

[[commands]]
forward = [0.0, 0.4]
sideways = [-0.05, 0.05]
yaw = [-0.2, 0.2]
"#;

/// Content of every file below a folder, by its path in it.
fn contents(folder: &Path) -> BTreeMap<String, Vec<u8>> {
    let mut all = BTreeMap::new();
    let mut open = vec![folder.to_owned()];
    while let Some(path) = open.pop() {
        if path.is_dir() {
            open.extend(fs::read_dir(path).unwrap().map(|entry| entry.unwrap().path()));
        } else {
            all.insert(path.strip_prefix(folder).unwrap().to_string_lossy().into_owned(), fs::read(&path).unwrap());
        }
    }
    all
}

#[test]
fn a_data_set_does_not_depend_on_threads_or_on_a_kill() {
    let folder = folder();
    fs::write(folder.path().join("spec.toml"), SPEC).unwrap();
    run(folder.path(), "dataset spec.toml --out whole --device cpu --threads 1").ends_with(0);
    let manifest = read(folder.path().join("whole/dataset.json"));
    let shards = manifest["shards"].as_array().unwrap().len();
    assert!(shards > 3 && manifest["complete"] == true, "{shards} shards");

    // Killed after its first shard.
    let mut killed = Command::new(PROGRAM)
        .args(["dataset", "spec.toml", "--out", "killed", "--device", "cpu", "--threads", "2"])
        .current_dir(folder.path())
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .spawn()
        .unwrap();
    let (start, path) = (Instant::now(), folder.path().join("killed/dataset.json"));
    while !fs::read_to_string(&path).is_ok_and(|text| text.contains("\"sha256\"")) && start.elapsed() < Duration::from_secs(60) {
        std::thread::sleep(Duration::from_millis(2));
    }
    killed.kill().unwrap();
    killed.wait().unwrap();
    assert!(read(&path)["shards"].as_array().unwrap().len() < shards, "killed too late");
    run(folder.path(), "dataset check killed").ends_with(3);
    // A kill may leave a file under its temporary name.
    fs::write(folder.path().join("killed/biped/frames/00007.parquet.123.part"), "half").unwrap();
    run(folder.path(), "dataset spec.toml --out killed --device cpu --threads 2").ends_with(0);
    let [whole, killed] = ["whole", "killed"].map(|name| contents(&folder.path().join(name)));
    assert_eq!(whole.keys().collect::<Vec<_>>(), killed.keys().collect::<Vec<_>>());
    assert!(whole == killed);

    let ran = run(folder.path(), "dataset check whole");
    ran.ends_with(0);
    assert!(ran.stdout.contains("24 certificates, 744 frames: correct, complete"), "{}", ran.stdout);
    // A finished data set stays as it is, and its gaits are files of `verify`.
    run(folder.path(), "dataset spec.toml --out whole --device cpu").ends_with(0);
    assert!(contents(&folder.path().join("whole")) == whole);
    run(folder.path(), "verify whole/biped/gaits/00000.jsonl").ends_with(0);

    // Another specification does not continue it.
    fs::write(folder.path().join("other.toml"), SPEC.replace("count = 24", "count = 25")).unwrap();
    run(folder.path(), "dataset other.toml --out whole --device cpu").ends_with(4).says(&["dataset.json: spec: another one"]);
}

#[test]
fn the_check_finds_changed_files() {
    let folder = folder();
    let spec = SPEC.replace("count = 24", "count = 2").replace("\"biped\", \"anymal\"", "\"biped\"");
    fs::write(folder.path().join("spec.toml"), spec).unwrap();
    run(folder.path(), "dataset spec.toml --out data --device cpu").ends_with(0);
    run(folder.path(), "dataset check data").ends_with(0);
    let changes = |name: &str, change: &dyn Fn(&mut Vec<u8>), parts: &[&str]| {
        let path = folder.path().join("data").join(name);
        let good = fs::read(&path).unwrap();
        let mut bad = good.clone();
        change(&mut bad);
        assert!(bad != good);
        fs::write(&path, bad).unwrap();
        run(folder.path(), "dataset check data").ends_with(4).says(parts);
        fs::write(&path, good).unwrap();
    };
    let middle = |bytes: &mut Vec<u8>| {
        let at = bytes.len() / 2;
        bytes[at] ^= 1;
    };
    for name in ["biped/frames/00000.parquet", "biped/motions/00000.parquet", "biped/gaits/00000.jsonl"] {
        changes(name, &middle, &[name.rsplit('/').next().unwrap(), "sha256"]);
    }
    let replace = |from: &'static str, to: &'static str| {
        move |bytes: &mut Vec<u8>| *bytes = String::from_utf8(bytes.clone()).unwrap().replace(from, to).into_bytes()
    };
    changes("dataset.json", &replace("\"motions\": 2", "\"motions\": 1"), &["motions of biped: 1"]);
    changes("dataset.json", &replace("biped/gaits", "../gaits"), &["a file below the folder"]);
    changes("dataset.json", &replace("\"format\"", "\"fromat\""), &["unknown field `fromat`"]);
    fs::remove_file(folder.path().join("data/biped/motions/00000.parquet")).unwrap();
    run(folder.path(), "dataset check data").ends_with(4).says(&["cannot read", "00000.parquet"]);
    run(folder.path(), "dataset check nowhere").ends_with(4).says(&["nowhere/dataset.json: manifest: absent"]);
}

#[test]
fn bad_specifications_are_refused_by_place_value_and_limit() {
    let folder = folder();
    let says = |from: &str, to: &str, parts: &[&str]| {
        fs::write(folder.path().join("spec.toml"), SPEC.replace(from, to)).unwrap();
        run(folder.path(), "dataset spec.toml --out data --device cpu").ends_with(4).says(parts);
        assert!(!folder.path().join("data").exists());
    };
    says("count", "cuont", &["spec.toml: cuont", "did you mean `count`?"]);
    says("rate = 25", "rate = 0", &["rate: 0, but it must be a number from 1 to 10000"]);
    says("\"biped\"", "\"bipde\"", &["unknown robot `bipde`; did you mean `biped`?"]);
    says("forward = [0.0, 0.4]", "forward = [0.4, 0.0]", &["commands[0].forward[1]: 0, but it must be a number from 0.4 to 100"]);
    says("\"periodic\"", "\"peroidic\"", &["kinds", "peroidic"]);
    // Commands that no leg can follow: all draws are tried.
    let spec = SPEC.replace("forward = [0.0, 0.4]", "forward = [50, 60]").replace("count = 24", "count = 2\nattempts = 3");
    fs::write(folder.path().join("spec.toml"), spec).unwrap();
    let ran = run(folder.path(), "dataset spec.toml --out data --device cpu");
    ran.ends_with(3);
    assert!(ran.stdout.contains("0 motions made"), "{}", ran.stdout);
    run(folder.path(), "dataset check data").ends_with(0);
}
