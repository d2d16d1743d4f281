//! The command line: one file a command.

pub(crate) mod args;
mod atlas;
#[cfg(feature = "gpu")]
mod devices;
mod evaluate;
#[cfg(feature = "experiment")]
mod experiment;
mod export;
pub(crate) mod held;
mod init;
mod ipopt_worker;
pub(crate) mod label;
pub(crate) mod leg;
mod list;
pub(crate) mod robot;
pub(crate) mod scenario_file;
#[cfg(feature = "schema")]
mod schema;
mod search_args;
mod shell;
pub(crate) mod solve;
#[cfg(feature = "import")]
mod terrain;
mod verify;
#[cfg(feature = "view")]
pub(crate) mod view;

use crate::error::Error;
use crate::report::files::{STREAM, stdout};
use clap::{Parser, Subcommand};
use std::path::Path;
use std::process::ExitCode;
use std::sync::atomic::{AtomicBool, Ordering};

/// Set by Ctrl-C: searches end with the best so far.
static CANCELLED: AtomicBool = AtomicBool::new(false);

/// Finds gaits for legged robots: which foot steps when, with a motion and forces that are physically valid.
///
/// Exit codes: 0 feasible, 2 usage, 3 nothing feasible within the budget, 4 bad input file or unusable output, 5 no such
/// device.
///
/// `CREGOPT_CACHE` names the folder for what is kept of GPUs between runs; where it is empty nothing is kept. Without it that is `cregopt` among
/// the user's caches.
#[derive(Debug, Parser)]
#[command(version)]
struct Cli {
    #[command(subcommand)]
    command: Command,
    /// Say more on stderr; twice: everything. `RUST_LOG` says of what
    #[arg(short, long, global = true, action = clap::ArgAction::Count)]
    verbose: u8,
    /// Say nothing on stderr but errors
    #[arg(short, long, global = true, conflicts_with = "verbose")]
    quiet: bool,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// Search for a gait
    Solve(Box<solve::Solve>),
    /// Write a scenario file with every key explained
    Init(init::Init),
    /// Solve given contact schedules, one JSON object a line
    Evaluate(evaluate::Evaluate),
    /// Solve every regular gait of a robot at every speed: costs, the best ones, transitions
    Atlas(atlas::Atlas),
    #[cfg(feature = "experiment")]
    /// Repeat the paper's experiments, with its method and its baselines beside this program's
    Experiment(experiment::Experiment),
    /// Solve problems that come on stdin, for the other commands
    #[command(hide = true, name = crate::reference::workers::COMMAND)]
    IpoptWorker(ipopt_worker::IpoptWorker),
    #[cfg(feature = "import")]
    /// Make terrain files of height maps
    Terrain(terrain::TerrainCommand),
    /// Check a trajectory file, this program's or TOWR's
    Verify(verify::Verify),
    #[cfg(feature = "view")]
    /// Make a page for a browser: the robot moving, its forces, its certificate
    View(view::View),
    /// Write a motion for other programs: CSV or MCAP
    Export(export::Export),
    #[cfg(feature = "gpu")]
    /// List adapters, and which one `--device auto` takes
    Devices(devices::Devices),
    #[cfg(feature = "schema")]
    /// Print the JSON Schema of a file that is read or written
    Schema(schema::Schema),
    /// Robot files from robots' models, and joints along motions
    #[command(subcommand)]
    Robot(robot::Robot),
    /// List robots, terrains, scenarios and presets
    List(list::List),
    /// Print completions for a shell
    Completions(shell::Completions),
    /// Print the manual page
    Man(shell::Man),
}

/// How a command that ran to its end found things.
#[derive(PartialEq, Eq)]
pub(crate) enum Verdict {
    Feasible,
    Infeasible,
}

/// Why a command did not run to its end.
pub(crate) enum Failure {
    /// The command line asks for something that cannot be.
    Usage(Error),
    /// A file or folder is unusable.
    Input(Error),
    /// A device is not there, or not fit.
    Device(Error),
    /// It was ended before there was anything to show.
    Ended(Error),
}

#[cfg(feature = "python")]
impl From<Failure> for Error {
    fn from(failure: Failure) -> Self {
        match failure {
            Failure::Usage(error) | Failure::Input(error) | Failure::Device(error) | Failure::Ended(error) => error,
        }
    }
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
    // SAFETY: no other thread runs yet. It keeps a layer of Mesa from looking for a screen, and from complaining that there is none.
    unsafe { std::env::set_var("NODEVICE_SELECT", "1") };
    let cli = Cli::parse();
    log(cli.verbose, cli.quiet);
    // Without a handler Ctrl-C just ends the program: nothing to do about it.
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

/// What of the program's doings is told on stderr: `RUST_LOG`, else by how much was asked for.
fn log(verbose: u8, quiet: bool) {
    use tracing_subscriber::EnvFilter;
    let level = match (quiet, verbose) {
        (true, _) => "error",
        (_, 0) => "cregopt=info,error",
        (_, 1) => "cregopt=debug,warn",
        _ => "trace",
    };
    let filter = EnvFilter::try_from_default_env().unwrap_or_else(|_| EnvFilter::new(level));
    let told = tracing_subscriber::fmt().with_writer(std::io::stderr).with_env_filter(filter).without_time().with_ansi(false);
    // Lines for people say what they say; those who ask for more see where it comes from.
    let _ = if verbose == 0 { told.with_target(false).with_level(false).try_init() } else { told.try_init() };
}

/// Prints to stdout.
fn print(text: &str) -> Result<(), Error> {
    stdout(text.as_bytes()).map_err(|source| Error::Io { action: "write", path: "stdout".into(), source })
}

/// Prints what is said of a file that was written: to stderr when that is stdout.
fn print_beside(path: &Path, text: &str) -> Result<(), Error> {
    if path != Path::new(STREAM) {
        return print(text);
    }
    complain(&text.trim_end());
    Ok(())
}

/// Prints a line to stderr. Nobody listening is no error.
fn complain(error: &dyn std::fmt::Display) {
    use std::io::Write;
    let _ = writeln!(std::io::stderr(), "{error}");
}

/// Text of a JSON document for people and programs, ending in a newline.
pub(crate) fn to_json(value: &impl serde::Serialize) -> Result<String, Error> {
    Ok(serde_json::to_string_pretty(value)? + "\n")
}
