//! Command line program: parses, calls the library, prints, and sets the exit code.

use std::process::ExitCode;

fn main() -> ExitCode {
    cregopt::cli::main()
}
