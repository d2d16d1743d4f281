//! Pages of results, as the program makes them and as a browser shows them.

use crate::harness::run;
use std::fs;
use std::path::Path;
use tempfile::TempDir;

/// Runs the program, which must succeed, and returns what it prints.
fn run_well(folder: &Path, command: &str) -> String {
    let ran = run(folder, command);
    ran.ends_with(0);
    ran.stdout
}

/// A folder with gaits of a quadruped and a biped.
fn gaits() -> TempDir {
    let folder = tempfile::tempdir().unwrap();
    run_well(folder.path(), "solve --robot anymal --goal 0.5,0 --first --out four");
    run_well(folder.path(), "solve --robot biped --goal 0.5,0 --first --out two");
    folder
}

#[test]
fn a_page_is_written_next_to_the_result_or_to_the_given_path() {
    let folder = gaits();
    assert!(run_well(folder.path(), "view four").contains("written to four/view.html"));
    let page = fs::read_to_string(folder.path().join("four/view.html")).unwrap();
    assert!(page.contains(r#""name":"four""#) && page.contains(r#""robot":"anymal""#) && page.contains(r#""feasible":true"#));
    // Gait and cost come from the result next to the trajectory.
    assert!(page.contains(r#""about":[""#) && page.contains("cost "));
    run_well(folder.path(), "view four two/trajectory.json -o both.html");
    let page = fs::read_to_string(folder.path().join("both.html")).unwrap();
    assert!(page.contains(r#""name":"four""#) && page.contains(r#""name":"trajectory""#));
    // Names whose last parts are equal get more parts.
    run_well(folder.path(), "view four/trajectory.json two/trajectory.json -o both.html");
    let page = fs::read_to_string(folder.path().join("both.html")).unwrap();
    assert!(page.contains(r#""name":"four/trajectory""#) && page.contains(r#""name":"two/trajectory""#));
    // The name of a folder has no extension.
    for (name, new) in [("four", "f0.4"), ("two", "f0.8")] {
        fs::rename(folder.path().join(name), folder.path().join(new)).unwrap();
    }
    run_well(folder.path(), "view f0.4 f0.8 -o both.html");
    let page = fs::read_to_string(folder.path().join("both.html")).unwrap();
    assert!(page.contains(r#""name":"f0.4""#) && page.contains(r#""name":"f0.8""#));
    for (name, new) in [("f0.4", "four"), ("f0.8", "two")] {
        fs::rename(folder.path().join(name), folder.path().join(new)).unwrap();
    }
    // A result of another trajectory is ignored.
    fs::copy(folder.path().join("two/result.json"), folder.path().join("four/result.json")).unwrap();
    run_well(folder.path(), "view four");
    assert!(fs::read_to_string(folder.path().join("four/view.html")).unwrap().contains(r#""about":[]"#));
}

#[test]
fn files_that_cannot_be_shown_are_refused_and_nothing_is_written() {
    let folder = tempfile::tempdir().unwrap();
    fs::create_dir(folder.path().join("empty")).unwrap();
    fs::write(folder.path().join("half.json"), r#"{"durations": [[0.5]]"#).unwrap();
    let cases: [(&str, i32, &[&str]); 5] = [
        ("view empty", 4, &["empty", "no trajectory.json in it", "solve --out"]),
        ("view missing", 4, &["cannot read missing"]),
        ("view half.json", 4, &["half.json", "EOF"]),
        ("view", 2, &["OUT"]),
        ("view a b c d e f g h i", 2, &["results: 9", "at most 8"]),
    ];
    for (command, code, parts) in cases {
        run(folder.path(), command).ends_with(code).says(parts);
    }
    let names: Vec<String> = fs::read_dir(folder.path()).unwrap().map(|e| e.unwrap().file_name().into_string().unwrap()).collect();
    assert!(names.iter().all(|name| !name.contains("html")), "{names:?}");
}

/// `BROWSER_TESTS=require`: fails without Chromium and Python instead of reporting that it is skipped.
#[test]
fn a_browser_plays_and_scrubs_the_pages() {
    let folder = gaits();
    run_well(folder.path(), "solve --robot pexod --terrain step --goal 0.3,0 --first --out six");
    run_well(folder.path(), "solve --robot anymal --terrain gap --goal 2.6,0 --first --out gap");
    run_well(folder.path(), "view gap");
    run_well(folder.path(), "solve --robot humanoid --goal 0.4,0.1 --yaw 0.5 --first --out soles");
    run_well(folder.path(), "view four two six soles -o several.html");
    let required = std::env::var("BROWSER_TESTS").is_ok_and(|value| value == "require");
    for page in ["gap/view.html", "several.html"] {
        let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/view_page.py");
        let python = std::process::Command::new("python3").arg(script).arg(folder.path().join(page)).output();
        match python {
            Ok(output) if output.status.success() => {}
            Ok(output) if output.status.code() != Some(77) => {
                panic!("{page}: {}{}", String::from_utf8_lossy(&output.stdout), String::from_utf8_lossy(&output.stderr))
            }
            _ if required => panic!("BROWSER_TESTS=require, but there is no Python or no Chromium"),
            _ => eprintln!("skipped: no Python or no Chromium, {page} was not opened"),
        }
    }
}
