//! Data sets of certified motions, for trainers of locomotion policies.
//!
//! A [`Spec`] names robots, grounds, commands, gait families and a number of motions. Draws depend on the seed, the robot and the number of
//! the draw alone. A shard is a fixed number of draws of one robot: they are solved as one batch and certified in f64, and motions that are
//! nearly those of earlier draws are dropped. Files of a shard are written under temporary names and renamed; then the manifest lists them
//! with their hashes. A run that was interrupted repeats at most one shard, and the files do not depend on interruptions or the number of
//! threads. [`check`] reads everything again, certifies every motion and computes its frames.
//!
//! ```
//! use cregopt::Cpu;
//! use cregopt::dataset::{Spec, check};
//! use std::sync::atomic::AtomicBool;
//!
//! # let folder = std::env::temp_dir().join(format!("cregopt-dataset-{}", std::process::id()));
//! # std::fs::create_dir_all(&folder)?;
//! let spec = "count = 2\nshard = 8\nrobots = [\"biped\"]\n[[commands]]\nforward = [0.1, 0.3]\n";
//! std::fs::write(folder.join("spec.toml"), spec)?;
//! let plan = Spec::read(&folder.join("spec.toml"))?.plan()?;
//! let never = AtomicBool::new(false);
//! let made = plan.make(&folder.join("data"), &Cpu::new(0)?, &never, &mut |_| {})?;
//! assert!(made.complete && check(&folder.join("data"), 0, &never)?.rows == 202);
//! # std::fs::remove_dir_all(&folder)?;
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! ```text
//! DIR/dataset.json                 manifest: specification, settings, robots, grounds, licence, device, shards with hashes
//! DIR/ROBOT/frames/00000.parquet   one row per instant: base, feet, forces, contacts, phase, command, joints
//! DIR/ROBOT/motions/00000.parquet  one row per motion: command, family, cost, certificate
//! DIR/ROBOT/gaits/00000.jsonl      the motions as curves in f64, one per line, as `cregopt verify` reads them
//! ```
//!
//! | module | contents |
//! |---|---|
//! | `spec` | specification, and the plan with robots and grounds read |
//! | `draw` | command, task and schedule of a draw |
//! | `record` | certified motion: its line and its rows |
//! | `table` | tables as Parquet |
//! | `manifest` | manifest, and hashes of files |
//! | `run` | shards, one after the other |
//! | `check` | check of a whole data set |

mod check;
mod draw;
mod manifest;
mod record;
mod run;
mod spec;
mod table;

pub use check::{Checked, check};
pub use manifest::{FileHash, MANIFEST, Manifest, Origin, RobotEntry, Shard};
pub use run::{Drafts, FRAMES, Progress, ShardId};
pub use spec::{CommandRanges, DatasetPlan, Ground, GroundPlaces, Kind, Spec, Subject};
pub use table::{Column, Table, Values};
