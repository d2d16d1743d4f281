//! `cregopt` finds out which foot of a legged robot steps when.
//!
//! Input is a [`Task`]: robot, terrain and goal. Output is a gait, that is the phase durations of every foot, with a physically valid
//! motion and its contact forces. A [`Search`] samples gaits of many families. For each gait it solves a trajectory optimisation problem
//! with single rigid body dynamics. A whole population is one batch on a [`Cpu`] or a [`Gpu`](backend). The cross-entropy method then fits
//! the sampling distribution to the cheapest gaits:
//!
//! ```
//! use cregopt::app::label::{Provenance, label};
//! use cregopt::{Cpu, Goal, Robot, Search, Task, Terrain};
//!
//! let task = Task::new(Robot::named("anymal")?, Terrain::flat(), Goal::at(2.0, 0.0))?;
//! let found = Search::new(&task).seed(1).population(16).run(&Cpu::new(0)?)?;
//! assert!(found.best.feasible());
//! println!("{}", found.best.certificate());
//! // With robot and terrain, for `cregopt view`.
//! let motion = label(found.best.trajectory().clone(), &task, Provenance::default(), Some(1));
//! std::fs::write("trajectory.json", serde_json::to_string(&motion)?)?;
//! # std::fs::remove_file("trajectory.json")?;
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! A [`Mission`] adds waypoints, checks before a search and a diagnosis after one that found no gait; see [`app`] for an example.
//! [`Evaluate`] solves gaits that the caller provides. [`verify()`] checks a motion independently of the solver. The [`guide`] has a page
//! per task: own robots and ground, certificates, remedies, tracking, planning online, data sets, clusters, GPUs.
//!
//! # Optimisation problem
//! For a given gait (rows `momentum`, the default) with intervals of length `h` between base knots:
//!
//! ```text
//! find         base curve p(t), angles(t), footholds, swing heights, contact forces f_i(t)
//! such that    m (v_k+1 - v_k)       = sum J_i + h m g                     J_i: impulse of foot i over the interval
//!              m (p_k+1 - p_k)       = h m v_k + sum P_i + h^2 m g / 2     P_i: integral of that impulse
//!              L_k+1 - L_k           = sum (x_i - p_k) x J_i + M_k         L: angular momentum about p_k, M_k: moment of gravity
//!              mean of L over the interval = mean of the planned motion    planned: R I R' omega
//!              R' (x_i - p) in nominal_i + reach_i                         along the motion
//!              0 <= n.f_i <= f_max,  |t.f_i| <= mu n.f_i                   on the whole curve, by its control points
//!              f_i = 0                                                     in swing
//!              x_i on the terrain in stance; in swing within height, speed and acceleration limits
//!              start at rest, goal pose and rest at the horizon
//! ```
//!
//! Because impulses enter exactly, the motion also holds between the instants; an independent rollout confirms it. The rows `towr` are
//! those of \[3\], with dynamics at instants 0.1 s apart. They are for comparisons.
//!
//! # Conventions
//! All units are SI, angles are in rad, and forces act on the robot. World frame: z up. Base frame: x forward, y left, origin in the centre
//! of mass. Euler angles are roll, pitch, yaw with the rotation `Rz(yaw) Ry(pitch) Rx(roll)` from base to world.
//!
//! # Architecture
//! Data flows in one direction:
//!
//! 1. [`Task`] and [`Schedule`] define a candidate.
//! 2. `nlp` defines its variables and rows.
//! 3. A [`Backend`] solves a batch of candidates with `solver`, `rows` and `linear`.
//! 4. `search::evaluate` closes each solution in f64, certifies it with `verify` and computes its cost.
//! 5. [`Search`] samples the next candidates.
//!
//! Modules that this page does not list are internal and may change.
//!
//! | part | location |
//! |---|---|
//! | schedules, gait families, cost of a motion | `gait/` |
//! | search: stages, settings, cross-entropy method and its distributions | `search/` |
//! | variables, elements of rows, index tables | `nlp/problem.rs`, built by `nlp/builder.rs` and `nlp/foot_blocks.rs` |
//! | elimination order | `nlp/sweep.rs` |
//! | transcriptions `momentum` and `towr` | `nlp/transcription/` |
//! | rows: one file per family with its table, residual, Jacobian and tolerance; list of all families in `mod.rs` | `rows/` |
//! | linear algebra: frontal Cholesky factorisation in time order | `linear/` |
//! | iteration: order of a round in `round.rs`, each stage in its own file | `solver/` |
//! | shaders with the same mathematics, one file per Rust twin | `shaders/` |
//! | batches on a GPU: slots, submissions, read-back | `backend/gpu/` |
//! | independent check between the instants, rollout | `verify/` |
//! | TOWR's complete problem and the contact-implicit one, for Ipopt | `reference/` |
//! | planning online: a gait and its motion from any state, many times a second | `planner/` |
//! | experiments of the paper, tables, plots | `experiment/` |
//! | data sets of certified motions: draws, shards, check | `dataset/` |
//! | missions with waypoints, scenario files, terms of verification, explanations of failures | `app/` |
//!
//! # Method
//! Forces are cubic splines, so their impulses are exact weighted sums of the force nodes. Angular momentum is taken about the base
//! position at the start of an interval, not about the moving base. It then changes by the moments of the impulses about fixed footholds
//! and by the moment of gravity. Both are exact and need no quadrature. Only the attitude needs one: that of the angular momentum, at six
//! points per interval. Inside an interval the base deviates from the cubic between its knots by up to a centimetre and a few degrees. The
//! reach rows use the base pose that the forces lead to.
//!
//! The solver is an elastic primal-dual Gauss-Newton method with Mehrotra's corrector in f32. Solutions are closed in f64, then checked by
//! code that shares nothing with the solver.
//!
//! # GPU
//! One workgroup works on one candidate, whose tables and buffers are in a slot. A round computes and judges a trial point for every
//! running slot. On flat ground it takes 18 dispatches: eleven stages, and one shader for each of seven row families; with a cost, also one
//! for each family of cost rows. The stages compute row weights, factorisation and predictor, corrector, step, rows and Jacobian at the
//! trial point, and the verdict. The device decides whether a candidate continues, closes or ends. After every few rounds the host reads
//! 76 bytes per slot, takes out the candidates that have ended and refills their slots.
//!
//! The front of a factorisation is in workgroup memory: 16 KiB if that is enough, more if the adapter has it, storage otherwise. When a
//! device is opened, it counts loop iterations, because some software adapters leave loops after 65,535 of them; these get the
//! factorisation in parts. It also solves a small problem with a known result, and is refused if the result is wrong. Compiled shaders are
//! cached between runs if the driver supports it (Vulkan), in `cregopt` in the user's cache folder or in the folder that `CREGOPT_CACHE`
//! names (empty: no cache).
//!
//! # Features
//! All but the last three are on by default. Without any, this is a library that needs no GPU driver and no argument parser.
//!
//! | feature | adds |
//! |---|---|
//! | `cli` | the command line program |
//! | `gpu` | the GPU backend |
//! | `dataset` | data sets of certified motions |
//! | `experiment` | the experiments of the paper |
//! | `view` | results as a page for a browser |
//! | `import` | maps and meshes as terrains |
//! | `urdf` | robots from URDF and MJCF files |
//! | `mcap` | motions for robotics viewers and ROS 2; grid maps |
//! | `schema` | JSON Schemas of the files |
//! | `pictures` | PNG in addition to SVG |
//! | `ipopt` | Ipopt, for comparisons |
//! | `python` | the native part of the Python package |
//!
//! # Sources
//! 1. I. Tsikelis, K. Chatzilygeroudis, "Gait Optimization for Legged Systems Through Mixed Distribution Cross-Entropy Optimization", 2024,
//!    arXiv 2410.02891: the search and the scenarios ("the paper").
//! 2. A. W. Winkler, C. D. Bellicoso, M. Hutter, J. Buchli, "Gait and Trajectory Optimization for Legged Systems Through Phase-Based
//!    End-Effector Parameterization", IEEE RA-L 3(3), 2018: the phase-based formulation.
//! 3. Program of \[2\], TOWR (ethz-adrl/towr): rows, bounds, constants, robots, terrains.
//! 4. Program of \[1\], CrEGOpt (NOSALRO/cregopt): hexapod, step terrain, search constants.
//! 5. M. Posa, C. Cantu, R. Tedrake, "A Direct Method for Trajectory Optimization of Rigid Bodies Through Contact", IJRR 33(1), 2014: the
//!    contact-implicit baseline.

pub mod app;
#[doc(hidden)]
pub mod backend;
#[cfg(feature = "mcap")]
mod cdr;
#[cfg(feature = "cli")]
#[doc(hidden)]
pub mod cli;
#[cfg(feature = "dataset")]
pub mod dataset;
#[doc(hidden)]
pub mod error;
#[cfg(feature = "experiment")]
#[doc(hidden)]
pub mod experiment;
pub mod export;
#[doc(hidden)]
pub mod files;
pub mod gait;
pub mod guide;
#[doc(hidden)]
pub mod linear;
#[doc(hidden)]
pub mod nlp;
pub mod planner;
#[cfg(feature = "python")]
mod python;
mod quadrature;
#[doc(hidden)]
pub mod real;
#[doc(hidden)]
pub mod reference;
#[doc(hidden)]
pub mod refine;
#[doc(hidden)]
pub mod report;
pub mod robot;
#[doc(hidden)]
pub mod rows;
pub mod scenario;
pub mod search;
pub mod settings;
#[doc(hidden)]
pub mod solver;
pub mod task;
pub mod terrain;
pub mod verify;
#[cfg(feature = "view")]
#[doc(hidden)]
pub mod view;

pub use app::{Mission, MissionStage, ProgressEvent, Request, Waypoint};
#[cfg(feature = "gpu")]
pub use backend::Gpu;
pub use backend::{Backend, Cpu, DeviceChoice};
pub use error::{Error, Result};
pub use gait::{Schedule, Trajectory};
pub use planner::Planner;
pub use robot::Robot;
pub use search::evaluate::Evaluate;
pub use search::{Gait, Search, SearchResult};
pub use task::{Goal, Task};
pub use terrain::Terrain;
pub use verify::verify;
