//! Application layer: what the program, the Python package and a library user all do with a task. It knows files and texts, but neither a
//! command line nor a terminal.
//!
//! A [`Mission`] is a [`Task`](crate::Task) with waypoints. It is searched in [`MissionStage`]s, one per waypoint and one to the goal,
//! each from
//! where the stage before ends. A [`Request`] has the settings. Each stage is checked before its search: an impossible task is an error,
//! and obstacles that make a gait unlikely are warnings. A stage has the gait, the use of the robot's joint limits, and a diagnosis if no
//! gait was found:
//!
//! ```
//! use cregopt::{Cpu, Goal, Mission, Request, Robot, Task, Terrain, Waypoint};
//!
//! let task = Task::new(Robot::named("biped")?, Terrain::flat(), Goal::at(0.6, 0.0))?;
//! let mission = Mission::new(task).by_way_of(Waypoint::at(0.3, 0.1));
//! let mut request = Request::default();
//! request.search.first = true;
//! let stages = mission.search(&request, &Cpu::new(0)?)?;
//! for stage in &stages {
//!     match &stage.diagnosis {
//!         None => println!("{}", stage.found.best.certificate()),
//!         Some(diagnosis) => println!("{diagnosis}"),
//!     }
//! }
//! assert_eq!(stages.len(), mission.stages());
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! | module | contents |
//! |---|---|
//! | `named` | robots and terrains by name or file |
//! | `scenario_file` | scenario files: everything that a search can be asked, in TOML |
//! | `world` | robots and terrains for one or all scenarios, tasks from them |
//! | `options` | settings of both levels from options, tables of a file and assignments |
//! | `setup` | scenario file with overrides, to mission, request and device |
//! | `mission`, `stage`, `save`, `explain` | searches, their files, and explanations of failures |
//! | `terms` | terms under which a trajectory file is verified |
//! | `label` | origin of a trajectory, as its file states it |
//! | `summary`, `page` | result as text for a terminal, and as a page for a browser |

pub mod explain;
pub mod label;
pub mod mission;
pub mod named;
pub mod options;
#[cfg(feature = "view")]
pub mod page;
pub mod request;
pub mod save;
pub mod scenario_file;
pub mod setup;
pub mod stage;
pub mod summary;
pub mod terms;
pub mod world;

pub use label::Provenance;
pub use request::{Mission, ProgressEvent, Request, Waypoint};
pub use scenario_file::ScenarioFile;
pub use setup::{Overrides, Setup};
pub use stage::MissionStage;
pub use terms::{Ends, TermOverrides, VerificationTerms};
