//! Pictures of motions that `solve` and `verify` draw.

use crate::harness;
use std::fs;
use std::path::Path;

/// Runs the program in a folder: exit code and messages.
fn run(folder: &Path, command: &str) -> (i32, String) {
    let ran = harness::run(folder, command);
    (ran.code, ran.stderr)
}

#[test]
fn solve_and_verify_draw_the_same_motion() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    assert_eq!(run(folder.path(), "solve --robot biped --terrain slope --goal 1.5,0.2 --first --out out --plot solved.svg").0, 0);
    let picture = fs::read_to_string(at("solved.svg")).unwrap();
    for part in ["biped on slope", "certified", "normal force, N", "m of height", "footholds"] {
        assert!(picture.contains(part), "no `{part}`");
    }
    assert_eq!(run(folder.path(), "verify out/trajectory.json --plot verified.svg").0, 0);
    // Everything but the title, which has information from the search.
    let without_title =
        |text: String| text.lines().enumerate().filter(|(i, _)| *i != 3).map(|(_, line)| line.to_owned() + "\n").collect::<String>();
    assert_eq!(without_title(picture), without_title(fs::read_to_string(at("verified.svg")).unwrap()));
    #[cfg(feature = "pictures")]
    {
        assert_eq!(run(folder.path(), "verify out/trajectory.json --plot verified.png").0, 0);
        assert!(fs::read(at("verified.png")).unwrap().starts_with(b"\x89PNG\r\n"));
    }
    fs::write(at("two.jsonl"), fs::read_to_string(at("out/trajectory.json")).unwrap().repeat(2)).unwrap();
    let (code, message) = run(folder.path(), "verify two.jsonl --plot two.svg");
    assert!(code == 2 && message.contains("--plot: 2 trajectories"), "{code} {message}");
    assert!(!at("two.svg").exists());
}

#[test]
fn a_picture_that_cannot_be_written_is_refused_before_any_work() {
    let folder = tempfile::tempdir().unwrap();
    let (code, message) = run(folder.path(), "solve --scenario hex --plot gait.pdf");
    assert!(code == 2 && message.contains("gait.pdf") && message.contains(".svg or .png"), "{code} {message}");
    let (code, message) = run(folder.path(), "solve --scenario hex --plot missing/gait.svg");
    assert!(code == 4 && message.contains("missing/gait.svg"), "{code} {message}");
}
