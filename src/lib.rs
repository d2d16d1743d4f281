//! `cregopt` finds out which foot steps when.
//!
//! Given a [`Task`](task::Task) (robot, terrain, goal) it returns a gait, that is phase durations for every foot, with a motion and
//! contact forces that are physically valid. It searches over gaits with a cross-entropy method over mixed distributions ([`cem`]) and
//! solves, for each sampled gait, a trajectory optimisation problem with single rigid body dynamics:
//!
//! ```text
//! find         base curve p(t), angles(t), footholds, swing heights, contact forces f_i(t)
//! such that    m p'' = sum f_i - m g e_z
//!              I_w omega' + omega x I_w omega = sum (x_i - p) x f_i            every 0.1 s
//!              R' (x_i - p) in nominal_i +- reach                              every 0.08 s
//!              0 <= n.f_i <= f_max,  |t.f_i| <= mu n.f_i                       at force nodes, in stance
//!              f_i = 0                                                         in swing
//!              x_i on the terrain in stance, not under it in swing
//!              start at rest, goal pose at the horizon
//! ```
//!
//! Data flows one way: task → [schedule](gait::schedule) → [layout](nlp::layout) → [batch](backend) → [solver] →
//! [certified trajectory](certify) → [report]. [`search::search`] is the whole job, [`evaluate::evaluate`] the lower level alone,
//! [`mod@refine`] brings a found gait to a local optimum of its cost, [`certify::verify()`] is the check that shares nothing with the solver,
//! [`mod@reference`] the same problems for Ipopt, and [`experiment`] the paper's experiments with both.
//!
//! ```
//! use cregopt::{backend::Cpu, scenario::Scenario, search::{cem::CemSettings, evaluate::LowerSettings, search}};
//! use std::sync::atomic::AtomicBool;
//!
//! let task = Scenario::named("biped")?.task(10)?;
//! let (upper, lower) = (CemSettings::preset("experiment1")?, LowerSettings::default());
//! let found = search(&task, &upper, &lower, 1, &Cpu::new(1)?, &AtomicBool::new(false), &mut |_| {})?;
//! let gait = found.best.expect("at least one candidate was evaluated");
//! assert!(gait.solution.feasible && gait.solution.n_violated == 0);
//! println!("{:?} stance phases, {} s", gait.stances, gait.solution.horizon);
//! # Ok::<(), cregopt::Error>(())
//! ```
//!
//! Units are SI, angles rad, and forces act on the robot. World frame: z up; base frame: x forward, y left, in the centre of mass.
//! Euler angles are roll, pitch, yaw with rotation `Rz(yaw) Ry(pitch) Rx(roll)` from base to world.
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

pub mod backend;
pub mod cli;
pub mod error;
pub mod experiment;
pub mod gait;
pub mod linear;
pub mod nlp;
pub mod real;
pub mod reference;
pub mod refine;
pub mod report;
pub mod robot;
pub mod rows;
pub mod scenario;
pub mod search;
pub mod settings;
pub mod solver;
pub mod task;
pub mod terrain;
pub mod verify;

pub use error::{Error, Result};
