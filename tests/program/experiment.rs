//! `cregopt experiment`.

use crate::harness::{folder, read, read_lines, run};
use std::fs;

/// True for a complete SVG with any number of panels: a closing tag in the middle makes it unreadable.
fn is_one_picture(svg: &str) -> bool {
    svg.starts_with("<svg") && svg.trim_end().ends_with("</svg>") && svg.matches("</svg>").count() == 1
}

#[test]
fn an_experiment_resumes_where_it_stopped() {
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
    // As if the process had been killed while it wrote.
    let whole = fs::read_to_string(&log).unwrap();
    fs::write(&log, whole.clone() + &whole[..100]).unwrap();
    let ran = run(folder.path(), &command(2));
    ran.ends_with(0);
    let second = read_lines(&log);
    // Two replicates are the first and the last; one is the middle.
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
