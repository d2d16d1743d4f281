//! `cregopt` finds out which foot steps when.
//!
//! Given a [`Task`] (robot, terrain, goal) it returns a gait, that is phase durations for every foot, with a motion and contact forces that are
//! physically valid. A [`Search`] draws gaits of many families, solves for each a trajectory optimisation problem with single rigid body
//! dynamics, the whole population as one batch on a [`Cpu`] or a [`Gpu`](backend), and fits its distribution to the cheapest by the cross-entropy method:
//!
//! ```
//! use cregopt::{Cpu, Goal, Robot, Search, Task, Terrain};
//!
//! let task = Task::new(Robot::named("anymal")?, Terrain::flat(), Goal::at(2.0, 0.0))?;
//! let found = Search::new(&task).seed(1).population(16).run(&Cpu::new(0)?)?;
//! assert!(found.best.feasible());
//! println!("{}", found.best.certificate());
//! std::fs::write("trajectory.json", serde_json::to_string(found.best.trajectory())?)?;
//! # std::fs::remove_file("trajectory.json")?;
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! A [`Mission`] adds waypoints, checks before a search and a diagnosis after one that found no gait; see [`app`] for an example.
//! [`Evaluate`] solves gaits of the caller's, and [`verify()`] is the check that shares nothing with the solver.
//!
//! # What is solved
//! With a gait given (rows `momentum`, the default; intervals of length `h` between base knots, `I` the momentum of what acts on one):
//!
//! ```text
//! find         base curve p(t), angles(t), footholds, swing heights, contact forces f_i(t)
//! such that    m (v_k+1 - v_k)       = sum J_i + h m g                     J_i: impulse of foot i over the interval
//!              m (p_k+1 - p_k)       = h m v_k + sum P_i + h^2 m g / 2     P_i: its integral
//!              L_k+1 - L_k           = sum (x_i - p_k) x J_i + M_k         L: angular momentum about p_k, M_k: moment of gravity
//!              mean of L over the interval = that of the planned attitude
//!              R' (x_i - p) in nominal_i + reach_i                                         along the motion
//!              0 <= n.f_i <= f_max,  |t.f_i| <= mu n.f_i                                   on the whole curve, by its control points
//!              f_i = 0                                                                     in swing
//!              x_i on the terrain in stance; in swing between least and greatest height, slower and less accelerated than legs can
//!              start at rest, goal pose and rest at the horizon
//! ```
//!
//! so that what is found holds between the instants, too: an independent rollout confirms it. `towr` are the rows of \[3\], dynamics at instants
//! 0.1 s apart, for comparisons.
//!
//! # Conventions
//! Units are SI, angles rad, and forces act on the robot. World frame: z up; base frame: x forward, y left, in the centre of mass.
//! Euler angles are roll, pitch, yaw with rotation `Rz(yaw) Ry(pitch) Rx(roll)` from base to world.
//!
//! # How it is built
//! Data flows one way: [`Task`] and [`Schedule`] → `nlp` (which variables, which rows) → [`Backend`] (a batch of them) → `solver` on `rows` and
//! `linear` → `search::evaluate` (closed in f64, certified by `verify`, priced) → [`Search`]. Modules that are not shown here are the inside
//! of that, and free to change.
//!
//! | step | where |
//! |---|---|
//! | schedules, families of gaits, what a motion costs | `gait/` |
//! | the search: stages, settings, cross-entropy method and its three distributions | `search/` |
//! | variables, elements of rows, index tables | `nlp/layout.rs`, built by `nlp/builder.rs` and `nlp/feet.rs`; elimination order in `nlp/sweep.rs` |
//! | what a transcription decides, `momentum` and `towr` | `nlp/transcription/` |
//! | rows: a family a file, with its table, residual, Jacobian and tolerance; one list of all in `mod.rs` | `rows/` |
//! | linear algebra: frontal Cholesky in time order | `linear/` |
//! | iteration: the order of a round in `round.rs`, each part in its file | `solver/` |
//! | the same as shaders, a file each beside its twin | `shaders/` |
//! | batches on a GPU: slots, submissions, read-back | `backend/gpu/` |
//! | independent check between the instants, rollout | `verify/` |
//! | TOWR's whole program and the contact-implicit one, for Ipopt | `reference/` |
//! | the paper's experiments, tables, plots | `experiment/` |
//! | missions with waypoints, scenario files, terms of verification, explanations of failures | `app/` |
//!
//! Forces are cubics, so their impulses are exact weights on the force nodes. Angular momentum, taken about the base position at the start of an
//! interval instead of the moving base, changes by the moments of impulses about fixed footholds and by the moment of gravity: exact, too,
//! without any quadrature of moments. Only the attitude needs a quadrature, of the angular momentum at six points of an interval. Inside an
//! interval the base deviates from the cubic between its knots by up to a centimetre and a few degrees; reach rows see it where the forces
//! take it. All this is solved by an elastic primal-dual Gauss-Newton method with Mehrotra's corrector in f32, closed in f64, and checked by
//! code that shares nothing with the solver.
//!
//! On a GPU one workgroup works on one candidate, whose tables and buffers stand in a slot. A round makes and judges a trial point for every running slot in 18 dispatches on flat
//! ground, eleven stages and a shader for each of seven kinds of rows: row weights, factorisation and predictor, corrector, step, rows and Jacobian there, verdict. Whether a candidate goes
//! on, closes or ends is decided on the device; the host reads 76 bytes a slot after every few rounds, takes out what has ended and fills the slots
//! again. The front of a factorisation stays in workgroup memory (16 KiB where that is enough, more where the adapter has as much as it takes, storage
//! otherwise). At the start a device counts loops (some software adapters leave them after 65,535 iterations, and get the factorisation in parts)
//! and solves a small problem with a known end; one that computes wrong numbers is refused. Compiled shaders are kept between runs where Vulkan
//! hands them out, in `cregopt` among the user's caches, or where `CREGOPT_CACHE` says (empty: nowhere).
//!
//! # Features
//! `cli` (the program), `gpu`, `experiment` (the paper's experiments), `view` (results as a page for a browser), `pictures` (PNG besides
//! SVG), `import` (height maps), `urdf` (robots from URDF files), `mcap` (motions for robotics viewers) and `schema` (JSON Schemas of files) are on by default; without them this is a
//! library that needs no GPU driver and no argument parser. `ipopt` links Ipopt, to compare with; `python` is the inside of the
//! Python package.
//!
//! # Sources
//! 1. I. Tsikelis, K. Chatzilygeroudis, "Gait Optimization for Legged Systems Through Mixed Distribution Cross-Entropy Optimization",
//!    2024, arXiv 2410.02891: the search and the scenarios ("the paper").
//! 2. A. W. Winkler, C. D. Bellicoso, M. Hutter, J. Buchli, "Gait and Trajectory Optimization for Legged Systems Through Phase-Based
//!    End-Effector Parameterization", IEEE RA-L 3(3), 2018: the phase-based formulation.
//! 3. The program of \[2\], TOWR (ethz-adrl/towr): rows, bounds, constants, robots, terrains.
//! 4. The program of \[1\], CrEGOpt (NOSALRO/cregopt): hexapod, step terrain, search constants.
//! 5. M. Posa, C. Cantu, R. Tedrake, "A Direct Method for Trajectory Optimization of Rigid Bodies Through Contact", IJRR 33(1), 2014: the
//!    contact-implicit baseline.

pub mod app;
#[doc(hidden)]
pub mod backend;
#[cfg(feature = "cli")]
#[doc(hidden)]
pub mod cli;
#[doc(hidden)]
pub mod error;
#[cfg(feature = "experiment")]
#[doc(hidden)]
pub mod experiment;
pub mod export;
#[doc(hidden)]
pub mod files;
pub mod gait;
#[doc(hidden)]
pub mod linear;
#[doc(hidden)]
pub mod nlp;
#[cfg(feature = "python")]
mod python;
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

pub use app::{Mission, ProgressEvent, Request, Stage, Waypoint};
#[cfg(feature = "gpu")]
pub use backend::Gpu;
pub use backend::{Backend, Cpu, DeviceChoice};
pub use error::{Error, Result};
pub use gait::{Schedule, Trajectory};
pub use robot::Robot;
pub use search::evaluate::Evaluate;
pub use search::{Gait, Search, SearchResult};
pub use task::{Goal, Task};
pub use terrain::Terrain;
pub use verify::verify;
