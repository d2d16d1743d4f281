//! Families of constraint rows, one file each, and the one list that names them.
//!
//! A family's file holds all of it: its table entries, how many rows it has, in which unit and how far they may be off, which blocks they
//! use, residual and Jacobian. Its shader has the same name under `shaders/rows`. What stands here is the list (`families!`, `row_tables!`
//! and [`residuals`]); sizes, buffers, uploads and declarations in WGSL are made from it.
//!
//! Rows are plain loops over flat buffers and the index tables of a candidate, without allocation. None uses fused multiply-add, and every sum
//! has a fixed order, so results do not depend on the processor's vector width.

pub mod acceleration;
pub mod blocks;
pub mod cone;
pub mod dynamics;
pub mod footing;
pub mod force;
pub mod ground;
pub mod math;
pub mod momentum;
pub mod reach;
pub mod stride;
pub mod swing;
pub mod table;
pub mod write;

use crate::real::Real;
use crate::terrain::{Ground, Terrain};
use blocks::Placed;
use momentum::{Deviation, MOMENTUM_POINTS, MomentumPoint};
use reach::ReachRows;
use std::sync::Arc;
use table::Wgsl;

/// Kind of a row: what the solver does with its residual. Jacobian rows are numbered by kind, in this order.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(u32)]
pub enum RowKind {
    /// The residual is zero at a solution.
    Equality,
    /// The residual is a term of the objective.
    Cost,
    /// The residual is not positive at a solution. A two-sided row has a lower side, too.
    Inequality,
}

crate::table! {
    /// Numbers of Jacobian rows by kind.
    #[derive(Default, PartialEq, Eq)]
    pub struct RowCounts {
        /// Equalities.
        pub equalities: u32,
        /// Terms of the objective.
        pub costs: u32,
        /// Inequalities; a two-sided row counts once.
        pub inequalities: u32,
    }
}

impl RowCounts {
    /// Number of all rows.
    pub fn all(self) -> usize {
        self.of(RowKind::Inequality).end
    }

    /// Rows of a kind.
    #[inline(always)]
    pub fn of(self, kind: RowKind) -> std::ops::Range<usize> {
        let first_cost = self.equalities as usize;
        let first_inequality = first_cost + self.costs as usize;
        match kind {
            RowKind::Equality => 0..first_cost,
            RowKind::Cost => first_cost..first_inequality,
            RowKind::Inequality => first_inequality..first_inequality + self.inequalities as usize,
        }
    }

    /// Kind of a row. Twin: `row_kind` of `shaders/shared/kind.wgsl`.
    #[inline(always)]
    pub fn kind(self, row: u32) -> RowKind {
        if row < self.equalities {
            RowKind::Equality
        } else if row < self.equalities + self.costs {
            RowKind::Cost
        } else {
            RowKind::Inequality
        }
    }

    /// Number of rows whose residual is in `c`, by row: equalities and costs.
    #[inline(always)]
    pub fn one_sided(self) -> usize {
        self.of(RowKind::Cost).end
    }
}

/// What is known of a family before any candidate.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Spec {
    /// Rows of an element.
    pub rows: usize,
    /// How many of them, the first, have a lower side too.
    pub pairs: usize,
    /// Their kind.
    pub kind: RowKind,
    /// Unit of a row before it is scaled.
    pub unit: &'static str,
}

/// Makes [`Family`] of the list below: of each family its specification, how far a row may be off (scaled) when a tolerance in its own unit is
/// asked for, and who writes its columns.
macro_rules! families {
    ($($(#[$about:meta])* $family:ident { $spec:path, $allowed:path, $place:path })*) => {
        /// A family of rows.
        #[derive(Debug, Clone, Copy, PartialEq, Eq)]
        #[repr(u32)]
        pub enum Family {
            $($(#[$about])* $family,)*
        }

        impl Family {
            /// All of them.
            pub const ALL: &[Family] = &[$(Family::$family),*];

            /// Its specification.
            pub fn spec(self) -> Spec {
                match self { $(Family::$family => $spec),* }
            }

            /// Largest residual of row `r` at which a violation of `tolerance` in the row's own unit is not exceeded, margins aside.
            pub fn allowed<T: Real>(self, constants: &Constants<T>, r: usize, tolerance: T) -> T {
                match self { $(Family::$family => $allowed(constants, r, tolerance)),* }
            }

            /// Writes where an element's rows and blocks stand into its entry.
            pub(crate) fn place<T: Real>(self, tables: &mut Tables<T>, entry: usize, at: &Placed) {
                match self { $(Family::$family => $place(tables, entry, at)),* }
            }
        }
    };
}

families! {
    /// `towr`: Newton-Euler equations at an instant: moments, then forces.
    Dynamics { dynamics::SPEC, dynamics::allowed, dynamics::place }
    /// `momentum`: change of linear momentum, then of position, over an interval.
    LinearMomentum { momentum::LINEAR, momentum::linear_allowed, momentum::place_linear }
    /// `momentum`: angular momentum at the end of an interval, then its mean.
    AngularMomentum { momentum::ANGULAR, momentum::angular_allowed, momentum::place_angular }
    /// Reach box of a foot at an instant.
    Reach { reach::SPEC, reach::allowed, reach::place }
    /// Normal force and friction pyramid, at a force node or a control point beside it.
    Force { force::SPEC, force::allowed, force::place }
    /// Height of a swinging foot above the terrain.
    Swing { swing::SPEC, swing::allowed, swing::place }
    /// Length of the step of a swing, which bounds the foot's speed.
    Stride { stride::SPEC, stride::allowed, stride::place }
    /// Acceleration of a foot at the ends of a swing.
    Acceleration { acceleration::SPEC, acceleration::allowed, acceleration::place }
    /// Friction cone at a force node or a control point beside it.
    Cone { cone::SPEC, cone::allowed, cone::place }
    /// Box of a foothold on ground with edges.
    Footing { footing::SPEC, footing::allowed, footing::place }
}

impl Wgsl for Family {
    fn name() -> String {
        u32::name()
    }

    const WORDS: u32 = 1;

    fn read(first: u32) -> String {
        u32::read(first)
    }
}

/// The tables of all families, `name Buffer Entry` each; shaders bind them by their names. Hands the list to a macro.
macro_rules! row_tables {
    ($then:path $(, $more:tt)*) => {
        $then! { $($more)*
            footholds Footholds [u32],
            dynamics_instants DynamicsInstants [$crate::rows::dynamics::DynamicsInstant<T>],
            stance_forces StanceForces [$crate::rows::dynamics::StanceForce<T>],
            momentum_intervals MomentumIntervals [$crate::rows::momentum::MomentumInterval<T>],
            impulses Impulses [$crate::rows::momentum::Impulse<T>],
            base_blocks BaseBlocks [$crate::rows::reach::BaseBlocks],
            reach_instants ReachInstants [$crate::rows::reach::ReachInstant<T>],
            reach_feet ReachFeet [$crate::rows::reach::ReachFoot<T>],
            reach_legs ReachLegs [$crate::rows::reach::ReachLeg<T>],
            force_nodes ForceNodes [$crate::rows::force::ForceNode<T>],
            swing_nodes SwingNodes [$crate::rows::swing::SwingNode<T>],
            strides Strides [$crate::rows::stride::Stride<T>],
            accelerations Accelerations [$crate::rows::acceleration::Acceleration<T>],
            cones Cones [$crate::rows::cone::Cone<T>],
            footings Footings [$crate::rows::footing::Footing<T>],
        }
    };
}
#[cfg(feature = "gpu")]
pub(crate) use row_tables;

/// The shaders that evaluate all rows, in their order, each with the table whose entries it walks. Hands the list to a macro.
#[cfg(feature = "gpu")]
macro_rules! row_shaders {
    ($then:path $(, $more:tt)*) => {
        $then! { $($more)*
            Ground "rows/ground" footholds,
            Dynamics "rows/dynamics" dynamics_instants,
            Momentum "rows/momentum" momentum_intervals,
            Reach "rows/reach" reach_instants,
            Force "rows/force" force_nodes,
            Swing "rows/swing" swing_nodes,
            Stride "rows/stride" strides,
            Acceleration "rows/acceleration" accelerations,
            Cone "rows/cone" cones,
            Footing "rows/footing" footings,
        }
    };
}
#[cfg(feature = "gpu")]
pub(crate) use row_shaders;

macro_rules! tables {
    ($($table:ident $buffer:ident [$entry:ty],)*) => {
        /// What the rows of one candidate are made from: constants, ground, and a table for each kind of entry.
        #[derive(Debug, Clone)]
        pub struct Tables<T> {
            /// Constants.
            pub constants: Constants<T>,
            /// Ground.
            pub terrain: Arc<Terrain>,
            /// Points of every momentum interval.
            pub momentum_points: [MomentumPoint<T>; MOMENTUM_POINTS],
            /// Where reach rows begin.
            pub reach_rows: ReachRows,
            $(
                #[doc = concat!("Table `", stringify!($table), "`.")]
                pub $table: Vec<$entry>,
            )*
        }

        impl<T: Real> Tables<T> {
            /// Empty tables.
            ///
            /// * `interval` - of base knots, s, not rounded yet
            pub fn new(constants: Constants<T>, terrain: Arc<Terrain>, interval: f64) -> Self {
                Tables { constants, terrain, momentum_points: momentum::points(interval), reach_rows: ReachRows::default(), $($table: Vec::new()),* }
            }
        }
    };
}
row_tables!(tables);

crate::table! {
    /// Physical constants and row scales.
    pub struct Constants<T> {
        /// Mass, kg.
        pub mass: T,
        /// Weight, N.
        pub weight: T,
        /// Inertia in the base frame, kg m².
        pub inertia: [[T; 3]; 3],
        /// Its inverse.
        pub inverse_inertia: [[T; 3]; 3],
        /// Scale of moments, 1/(N m).
        pub moment_scale: T,
        /// Scale of forces in balance, 1/N.
        pub balance_scale: T,
        /// Interval of base knots, s.
        pub interval: T,
        /// Scale of reach and swing rows, 1/m.
        pub length_scale: T,
        /// Force unit of the variables, N; force rows are divided by it.
        pub force_unit: T,
        /// Largest normal force in that unit.
        pub force_limit: T,
        /// Friction coefficient.
        pub friction: T,
        /// Tightening of reach and swing rows, m.
        pub length_margin: T,
        /// Tightening of force rows, in force units.
        pub force_margin: T,
        /// Radius of a foot that keeps from edges, m; 0 where none does.
        pub foot_radius: T,
        /// Largest acceleration of a foot, m/s².
        pub foot_acceleration: T,
    }
}

/// What the rows of a candidate share at one `x`.
#[derive(Debug, Clone)]
pub struct Shared<T> {
    /// Ground under the footholds, `[footholds]`.
    pub ground: Vec<Ground<T>>,
    /// How the base deviates from its cubic inside intervals, `[intervals]`.
    pub deviations: Vec<Deviation<T>>,
    /// Whether the deviations stay as they are, as the derivatives of the rows take them.
    pub frozen: bool,
}

impl<T: Real> Default for Shared<T> {
    fn default() -> Self {
        Shared { ground: Vec::new(), deviations: Vec::new(), frozen: false }
    }
}

impl<T: Real> Shared<T> {
    /// Makes room for a candidate.
    pub fn resize(&mut self, tables: &Tables<T>) {
        self.ground.resize(tables.footholds.len(), Ground::level(T::zero()));
        self.deviations.resize(tables.momentum_intervals.len(), Deviation::default());
    }
}

/// Residuals (and, when asked for, Jacobian values) of all elements at `x`.
///
/// * `edge_radius` - over which edges of the terrain are rounded for the force rows, m; 0 for the exact rows
/// * `shared` - what rows share
/// * `equality` - out, `c`, `[equalities]`, dimensionless; zero when it holds
/// * `inequality` - out, `g`, `[inequalities]`, dimensionless; holds when `g <= 0`
/// * `jacobian` - out, values of every element, `[rows][stride]`
#[inline(always)]
pub fn residuals<T: Real>(
    tables: &Tables<T>,
    x: &[T],
    edge_radius: T,
    shared: &mut Shared<T>,
    equality: &mut [T],
    inequality: &mut [T],
    mut jacobian: Option<&mut [T]>,
) {
    let Shared { ground, deviations, frozen } = shared;
    ground::ground(tables, x, ground);
    dynamics::dynamics(tables, x, ground, equality, jacobian.as_deref_mut());
    momentum::momentum(tables, x, ground, deviations, *frozen, equality, jacobian.as_deref_mut());
    reach::reach(tables, x, ground, deviations, inequality, jacobian.as_deref_mut());
    force::force(tables, x, edge_radius, inequality, jacobian.as_deref_mut());
    swing::swing(tables, x, ground, inequality, jacobian.as_deref_mut());
    stride::stride(tables, x, inequality, jacobian.as_deref_mut());
    acceleration::acceleration(tables, x, ground, inequality, jacobian.as_deref_mut());
    cone::cone(tables, x, edge_radius, inequality, jacobian.as_deref_mut());
    footing::footing(tables, x, inequality, jacobian);
}

/// Largest residual of a force row for a tolerance in N.
fn force_allowed<T: Real>(constants: &Constants<T>, _: usize, tolerance: T) -> T {
    tolerance / constants.force_unit + constants.force_margin
}

/// Largest residual of a row in units of length for a tolerance in m.
fn length_allowed<T: Real>(constants: &Constants<T>, _: usize, tolerance: T) -> T {
    (tolerance + constants.length_margin) * constants.length_scale
}
