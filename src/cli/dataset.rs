//! `dataset`: makes a data set of certified motions, or checks one.

use super::args::DeviceArgs;
use super::{CANCELLED, Failure, Verdict, print};
use crate::dataset::{Checked, Manifest, Shard, Spec, check};
use crate::error::Error;
use clap::{Args, Subcommand};
use std::path::PathBuf;
use std::time::Instant;
use tracing::info;

/// Makes a data set of certified motions in a folder. The same command continues one that was interrupted, also after `kill -9`, and gives
/// the same files.
#[derive(Debug, Args)]
#[command(args_conflicts_with_subcommands = true, subcommand_negates_reqs = true)]
pub struct Dataset {
    #[command(subcommand)]
    command: Option<Command>,
    /// Specification (.toml): robots, grounds, commands, families and number of motions
    #[arg(required = true)]
    spec: Option<PathBuf>,
    /// Folder of the data set
    #[arg(long, value_name = "DIR", required = true)]
    out: Option<PathBuf>,
    #[command(flatten)]
    place: DeviceArgs,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// Check a data set: hashes, columns, numbers, contacts, and the certificate of every motion
    Check(Check),
}

#[derive(Debug, Args)]
struct Check {
    /// Folder of the data set
    folder: PathBuf,
    /// Threads; 0: one per processor
    #[arg(long, default_value_t = 0)]
    threads: usize,
}

impl Dataset {
    pub fn run(&self) -> std::result::Result<Verdict, Failure> {
        if let Some(Command::Check(command)) = &self.command {
            return command.run();
        }
        let (Some(spec), Some(out)) = (&self.spec, &self.out) else {
            return Err(Error::invalid("arguments", "incomplete", "a specification and --out").into());
        };
        let plan = Spec::read(spec)?.plan().map_err(|e| e.in_file(spec, None))?;
        let backend = self.place.backend(plan.batch(), plan.settings.precision)?;
        let (start, mut made) = (Instant::now(), 0);
        let manifest = plan.make(out, &*backend, &CANCELLED, &mut |progress| {
            made += progress.shard.motions;
            let (Shard { robot, number, motions, draws, .. }, [done, all]) = (progress.shard, progress.motions);
            let rate = 3600. * made as f64 / start.elapsed().as_secs_f64().max(1e-9);
            info!("{robot}, shard {number}: {motions} motions of {draws} draws; {done} of {all}, {rate:.0} motions/h");
        })?;
        let seconds = start.elapsed().as_secs_f64();
        print(&format!("{}{made} motions made in {seconds:.1} s; data set in {}\n", text(&manifest), out.display()))?;
        Ok(if manifest.motions() == manifest.asked() { Verdict::Feasible } else { Verdict::Infeasible })
    }
}

impl Check {
    fn run(&self) -> std::result::Result<Verdict, Failure> {
        let start = Instant::now();
        let Checked { manifest, rows } = check(&self.folder, self.threads, &CANCELLED)?;
        let seconds = start.elapsed().as_secs_f64();
        let all = if manifest.complete { "complete" } else { "not complete yet; the command that made it continues it" };
        let (shards, motions) = (manifest.shards.len(), manifest.motions());
        print(&format!("{}{shards} shards, {motions} certificates, {rows} frames: correct, {all} ({seconds:.1} s)\n", text(&manifest)))?;
        Ok(if manifest.complete { Verdict::Feasible } else { Verdict::Infeasible })
    }
}

/// Table of the numbers of draws and motions per robot.
fn text(manifest: &Manifest) -> String {
    let mut text = format!(
        "{:<24}{:>9}{:>9}{:>9}{:>12}{:>12}{:>9}{:>12}\n",
        "robot", "asked", "motions", "draws", "impossible", "infeasible", "joints", "duplicates"
    );
    for robot in &manifest.origin.robots {
        let sum = |of: &dyn Fn(&Shard) -> usize| manifest.shards.iter().filter(|shard| shard.robot == robot.folder).map(of).sum::<usize>();
        text += &format!(
            "{:<24}{:>9}{:>9}{:>9}{:>12}{:>12}{:>9}{:>12}\n",
            robot.folder,
            robot.count,
            sum(&|s| s.motions),
            sum(&|s| s.draws),
            sum(&|s| s.impossible),
            sum(&|s| s.infeasible),
            sum(&|s| s.beyond_joints),
            sum(&|s| s.duplicates)
        );
    }
    text
}
