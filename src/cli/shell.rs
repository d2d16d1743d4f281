//! `completions` and `man`: prints shell completions and manual pages.

use super::{Cli, Failure, Verdict, print};
use crate::error::Error;
use clap::{Args, CommandFactory};
use clap_complete::Shell;

#[derive(Debug, Args)]
pub struct Completions {
    /// Shell, e.g. `cregopt completions bash > /etc/bash_completion.d/cregopt`
    #[arg(value_enum)]
    shell: Shell,
}

impl Completions {
    pub fn run(&self) -> std::result::Result<Verdict, Failure> {
        let mut text = Vec::new();
        clap_complete::generate(self.shell, &mut Cli::command(), "cregopt", &mut text);
        print(&String::from_utf8_lossy(&text))?;
        Ok(Verdict::Feasible)
    }
}

#[derive(Debug, Args)]
pub struct Man {
    /// Command [default: the program itself]
    command: Option<String>,
}

impl Man {
    pub fn run(&self) -> std::result::Result<Verdict, Failure> {
        let program = Cli::command();
        let page = match &self.command {
            None => clap_mangen::Man::new(program),
            Some(name) => {
                let known = || program.get_subcommands().filter(|c| !c.is_hide_set()).map(|c| c.get_name()).collect::<Vec<_>>().join(", ");
                let command = program.find_subcommand(name);
                let command = command.ok_or_else(|| Error::Unknown { what: "command", name: name.clone(), known: known() })?;
                clap_mangen::Man::new(command.clone()).title(format!("cregopt-{name}"))
            }
        };
        let mut text = Vec::new();
        page.render(&mut text).map_err(|source| Error::Io { action: "write", path: "the manual page".into(), source })?;
        print(&String::from_utf8_lossy(&text))?;
        Ok(Verdict::Feasible)
    }
}
