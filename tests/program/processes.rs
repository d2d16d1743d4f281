//! The program as a process: pipes, signals, standard input and output.

use crate::harness::{PROGRAM, folder, read, run};
use assert_cmd::Command;
use std::fs;
use std::path::Path;
use std::process::Stdio;
use std::time::{Duration, Instant};

#[test]
fn a_dash_means_stdin_or_stdout_and_completions_and_manual_pages_are_printed() {
    let dir = folder();
    let piped = |args: &str, input: &[u8]| {
        let output = Command::new(PROGRAM).current_dir(dir.path()).args(args.split_whitespace()).write_stdin(input).output().unwrap();
        (output.status.code(), String::from_utf8(output.stdout).unwrap(), String::from_utf8(output.stderr).unwrap())
    };
    let (code, _, messages) = piped("solve - --first --out out", b"robot = 'anymal'\ngoal = { xy = [0.3, 0] }\n");
    assert_eq!(code, Some(0), "{messages}");
    let trajectory = fs::read(dir.path().join("out/trajectory.json")).unwrap();
    assert_eq!(piped("verify -", &trajectory).0, Some(0));
    let (code, csv, messages) = piped("export - --format csv --rate 10 -o -", &trajectory);
    assert!(code == Some(0) && csv.starts_with("time_s,") && messages.contains("samples"), "{messages}");
    // Stdout has nothing else.
    assert!(csv.lines().skip(1).all(|line| line.split(',').all(|v| v.parse::<f64>().is_ok())));
    // A reader that stops early does not end the program with an error.
    let mut export = std::process::Command::new(PROGRAM);
    export.current_dir(dir.path()).args("export out/trajectory.json --format csv --rate 1000 -o -".split_whitespace());
    let mut child = export.stdout(Stdio::piped()).stderr(Stdio::null()).spawn().unwrap();
    drop(child.stdout.take());
    assert_eq!(child.wait().unwrap().code(), Some(0));
    assert!(piped("completions bash", b"").1.contains("cregopt"));
    assert!(piped("man", b"").1.contains(".TH") && piped("man solve", b"").1.contains("seed"));
    let (code, _, messages) = piped("man slove", b"");
    assert!(code == Some(2) && messages.contains("did you mean `solve`?"), "{messages}");
}

/// Waits for a child for at most `limit`.
fn wait(child: &mut std::process::Child, limit: Duration) -> std::process::ExitStatus {
    let start = Instant::now();
    loop {
        if let Some(status) = child.try_wait().unwrap() {
            return status;
        }
        if start.elapsed() > limit {
            child.kill().unwrap();
            panic!("still running after {limit:?}");
        }
        std::thread::sleep(Duration::from_millis(20));
    }
}

/// Starts a search with an output folder `out`, and interrupts it some time after the folder appears. The program installs its handler
/// before that.
#[cfg(unix)]
fn interrupted(folder: &Path, args: &str, after: Duration) -> std::process::ExitStatus {
    let mut child = std::process::Command::new(PROGRAM)
        .args(args.split_whitespace())
        .current_dir(folder)
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .spawn()
        .unwrap();
    let start = Instant::now();
    while !folder.join("out").exists() && start.elapsed() < Duration::from_secs(10) {
        std::thread::sleep(Duration::from_millis(2));
    }
    std::thread::sleep(after);
    assert!(std::process::Command::new("kill").args(["-INT", &child.id().to_string()]).status().unwrap().success());
    wait(&mut child, Duration::from_secs(20))
}

#[cfg(unix)]
#[test]
fn ctrl_c_before_the_first_solution_exits_3() {
    // The robot has hundreds of seconds to go: the first solve takes long.
    let dir = folder();
    let args = "solve --scenario s1 --goal 60,0 --preset experiment3 --set search.free.min_stances=90 --set search.free.max_stances=98 \
                --device cpu --threads 1 --out out";
    assert_eq!(interrupted(dir.path(), args, Duration::ZERO).code(), Some(3));
    assert!(!dir.path().join("out/result.json").exists());
}

#[cfg(unix)]
#[test]
fn ctrl_c_ends_a_search_with_the_best_so_far() {
    let dir = folder();
    // The problem is so small that many candidates are solved within a second on any machine.
    let args = "solve --scenario biped --preset experiment3 --objective fewest-stances --population 512 --out out";
    let status = interrupted(dir.path(), args, Duration::from_secs(1));
    assert!(matches!(status.code(), Some(0 | 3)), "{status:?}");
    let result = read(dir.path().join("out/result.json"));
    assert_eq!(result["stop"], "cancelled");
    assert_eq!(result["feasible"] == true, status.code() == Some(0));
    run(dir.path(), "verify out/trajectory.json").ends_with(status.code().unwrap());
}

#[test]
fn a_closed_pipe_does_not_panic() {
    let dir = folder();
    for (args, expected) in [("solve --scenario s1 --first", 0), ("list", 0), ("solve --scenario s9", 2)] {
        let mut child = std::process::Command::new(PROGRAM)
            .args(args.split(' '))
            .current_dir(dir.path())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .unwrap();
        // The reading ends are closed before the program prints.
        drop((child.stdout.take(), child.stderr.take()));
        assert_eq!(wait(&mut child, Duration::from_secs(30)).code(), Some(expected), "{args}");
    }
}
