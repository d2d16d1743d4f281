//! The command line program: parse, call the library, print, choose the exit code.

use std::process::ExitCode;

fn main() -> ExitCode {
    cregopt::cli::main()
}
