//! Command line: one file per command. It parses arguments, shows progress and prints; the rest is in [`crate::app`].

mod args;
mod atlas;
#[cfg(feature = "dataset")]
mod dataset;
#[cfg(feature = "gpu")]
mod devices;
mod evaluate;
#[cfg(feature = "experiment")]
mod experiment;
mod export;
mod init;
mod ipopt_worker;
mod list;
mod robot;
#[cfg(feature = "schema")]
mod schema;
mod shell;
mod solve;
#[cfg(feature = "import")]
mod terrain;
mod verify;
#[cfg(feature = "view")]
mod view;

use crate::error::{Error, to_json};
use crate::files::{STREAM, stdout};
use clap::{Parser, Subcommand};
use std::path::Path;
use std::process::ExitCode;
use std::sync::atomic::{AtomicBool, Ordering};

/// Flag that Ctrl-C sets: searches then end with the best gait so far.
static CANCELLED: AtomicBool = AtomicBool::new(false);

/// Optimises gaits of legged robots: contact schedules, with physically valid motions and contact forces.
///
/// Exit codes: 0 feasible, 2 usage, 3 nothing feasible within the budget, 4 bad input file or unusable output, 5 no such device.
///
/// `CREGOPT_CACHE`: folder for cached GPU measurements and pipelines (default: `cregopt` in the user cache folder; empty: no cache).
#[derive(Debug, Parser)]
#[command(version)]
struct Cli {
    #[command(subcommand)]
    command: Command,
    /// More log output on stderr; `-vv`: all. `RUST_LOG` selects modules
    #[arg(short, long, global = true, action = clap::ArgAction::Count)]
    verbose: u8,
    /// Only errors on stderr
    #[arg(short, long, global = true, conflicts_with = "verbose")]
    quiet: bool,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// Search for a gait
    Solve(Box<solve::Solve>),
    /// Write a template of a scenario file, with every key explained
    Init(init::Init),
    /// Solve given contact schedules, one JSON object per line
    Evaluate(evaluate::Evaluate),
    /// Solve every regular gait of a robot at every speed: costs, best gaits, transitions
    Atlas(atlas::Atlas),
    #[cfg(feature = "dataset")]
    /// Make a data set of certified motions for trainers of policies, or check one
    Dataset(dataset::Dataset),
    #[cfg(feature = "experiment")]
    /// Repeat the experiments of the paper, with its method, its baselines and this program's method
    Experiment(experiment::Experiment),
    /// Solve problems from stdin, for the other commands
    #[command(hide = true, name = crate::reference::workers::COMMAND)]
    IpoptWorker(ipopt_worker::IpoptWorker),
    #[cfg(feature = "import")]
    /// Convert maps and meshes to terrain files
    Terrain(terrain::TerrainCommand),
    /// Verify a trajectory file of this program or of TOWR
    Verify(verify::Verify),
    #[cfg(feature = "view")]
    /// Write a web page with the moving robot, its forces and its certificate
    View(view::View),
    /// Convert a motion to CSV, MCAP or messages of ROS 2
    Export(export::Export),
    #[cfg(feature = "gpu")]
    /// List GPU adapters, and the device that `--device auto` uses
    Devices(devices::Devices),
    #[cfg(feature = "schema")]
    /// Print the JSON Schema of a file format
    Schema(schema::Schema),
    /// Import robots from URDF files, and compute joints along motions
    #[command(subcommand)]
    Robot(robot::Robot),
    /// List robots, terrains, scenarios and presets
    List(list::List),
    /// Print shell completions
    Completions(shell::Completions),
    /// Print the manual page
    Man(shell::Man),
}

/// Outcome of a command that ran to its end.
#[derive(PartialEq, Eq)]
enum Verdict {
    Feasible,
    Infeasible,
}

/// Reason why a command did not run to its end.
enum Failure {
    /// Invalid value on the command line.
    Usage(Error),
    /// Unusable file or folder.
    Input(Error),
    /// Missing or unfit device.
    Device(Error),
    /// Cancelled before there was a result.
    Ended(Error),
}

impl From<Error> for Failure {
    fn from(error: Error) -> Self {
        match error {
            Error::InFile { .. } | Error::Io { .. } => Failure::Input(error),
            Error::Device { .. } => Failure::Device(error),
            Error::Ended { .. } => Failure::Ended(error),
            _ => Failure::Usage(error),
        }
    }
}

/// Parses the command line, runs the command and returns the exit code.
pub fn main() -> ExitCode {
    // SAFETY: no other thread runs yet. The variable keeps a layer of Mesa from looking for a screen and complaining about a missing one.
    unsafe { std::env::set_var("NODEVICE_SELECT", "1") };
    let cli = Cli::parse();
    log(cli.verbose, cli.quiet);
    // Without a handler, Ctrl-C ends the program.
    let _ = ctrlc::set_handler(|| {
        if CANCELLED.swap(true, Ordering::Relaxed) {
            std::process::exit(130);
        }
    });
    let result = match cli.command {
        Command::Solve(command) => command.run(),
        Command::Init(command) => command.run(),
        Command::Evaluate(command) => command.run(),
        Command::Atlas(command) => command.run(),
        #[cfg(feature = "dataset")]
        Command::Dataset(command) => command.run(),
        #[cfg(feature = "experiment")]
        Command::Experiment(command) => command.run(),
        Command::IpoptWorker(command) => command.run(),
        #[cfg(feature = "import")]
        Command::Terrain(command) => command.run(),
        Command::Verify(command) => command.run(),
        #[cfg(feature = "view")]
        Command::View(command) => command.run(),
        Command::Export(command) => command.run(),
        #[cfg(feature = "gpu")]
        Command::Devices(command) => command.run(),
        #[cfg(feature = "schema")]
        Command::Schema(command) => command.run(),
        Command::Robot(command) => command.run(),
        Command::List(command) => command.run(),
        Command::Completions(command) => command.run(),
        Command::Man(command) => command.run(),
    };
    let (error, code) = match result {
        Ok(Verdict::Feasible) => return ExitCode::SUCCESS,
        Ok(Verdict::Infeasible) => return ExitCode::from(3),
        Err(Failure::Usage(error)) => (error, 2),
        Err(Failure::Input(error)) => (error, 4),
        Err(Failure::Device(error)) => (error, 5),
        Err(Failure::Ended(error)) => (error, 3),
    };
    complain(&format!("error: {error}"));
    ExitCode::from(code)
}

/// Initialises logging to stderr from `RUST_LOG` or the -v/-q flags.
fn log(verbose: u8, quiet: bool) {
    use tracing_subscriber::EnvFilter;
    let level = match (quiet, verbose) {
        (true, _) => "error",
        (_, 0) => "cregopt=info,error",
        (_, 1) => "cregopt=debug,warn",
        _ => "trace",
    };
    let filter = EnvFilter::try_from_default_env().unwrap_or_else(|_| EnvFilter::new(level));
    let log = tracing_subscriber::fmt().with_writer(std::io::stderr).with_env_filter(filter).without_time().with_ansi(false);
    // Module and level are shown only with -v.
    let _ = if verbose == 0 { log.with_target(false).with_level(false).try_init() } else { log.try_init() };
}

/// Prints to stdout.
fn print(text: &str) -> Result<(), Error> {
    stdout(text.as_bytes()).map_err(|source| Error::Io { action: "write", path: "stdout".into(), source })
}

/// Prints a message about a file that was written: to stderr if the file is stdout.
fn print_about(path: &Path, text: &str) -> Result<(), Error> {
    if path != Path::new(STREAM) {
        return print(text);
    }
    complain(&text.trim_end());
    Ok(())
}

/// Prints a line to stderr. A closed stderr is not an error.
fn complain(error: &dyn std::fmt::Display) {
    use std::io::Write;
    let _ = writeln!(std::io::stderr(), "{error}");
}
