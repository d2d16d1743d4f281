//! Families of constraint rows, one file each, and the list that names them.
//!
//! The file of a family contains everything about it: its table entries, number of rows, unit, tolerance, the blocks that it uses, residual
//! and Jacobian. Its shader has the same name under `shaders/rows`. This file contains the lists (`families!`, `row_tables!` and
//! [`residuals`]) from which sizes, buffers, uploads and WGSL declarations are generated.
//!
//! Rows are plain loops over flat buffers and the index tables of a candidate, without allocation. They use no fused multiply-add, and
//! every sum has a fixed order, so results do not depend on the vector width of the processor.

pub mod acceleration;
pub mod blocks;
pub mod cone;
pub mod cone_curvature;
pub mod dynamics;
pub mod effort;
pub mod factored;
pub mod foot;
pub mod footing;
pub mod force;
pub mod goal;
pub mod ground;
pub mod hip;
pub mod joint_speed;
pub mod joint_torque;
pub mod leg_joints;
pub mod math;
pub mod momentum;
pub mod periodic;
pub mod reach;
pub mod sole;
pub mod stance_power;
pub mod stride;
pub mod swing;
pub mod swing_power;
pub mod table;
pub mod turn;
pub mod write;

use crate::real::Real;
use crate::terrain::{Ground, Terrain};
use blocks::Placed;
use factored::FactoredRows;
use momentum::{Deviation, MOMENTUM_POINTS, MomentumPoint};
use std::sync::Arc;
use table::Wgsl;

/// Role of a row in the optimisation problem. Jacobian rows are numbered by kind, in this order.
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
    /// Numbers of the rows of elements.
    pub fn of_specs(specs: impl Iterator<Item = Spec>) -> RowCounts {
        let mut rows = [0; 3];
        specs.for_each(|spec| rows[spec.kind as usize] += spec.rows as u32);
        let [equalities, costs, inequalities] = rows;
        RowCounts { equalities, costs, inequalities }
    }

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

/// Properties of a family that are the same for all candidates.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Spec {
    /// Number of rows per element.
    pub rows: usize,
    /// Number of two-sided rows, which are the first.
    pub pairs: usize,
    /// Kind of the rows.
    pub kind: RowKind,
    /// Unit of the rows before scaling.
    pub unit: &'static str,
}

/// Generates [`Family`] from the list below. Each family names its specification, the largest scaled residual for a tolerance in its own
/// unit, and the function that writes positions and columns.
macro_rules! families {
    ($($(#[$about:meta])* $family:ident { $spec:path, $allowed:path, $place:path })*) => {
        /// Family of constraint rows.
        #[derive(Debug, Clone, Copy, PartialEq, Eq)]
        #[repr(u32)]
        pub enum Family {
            $($(#[$about])* $family,)*
        }

        impl Family {
            /// All families.
            pub const ALL: &[Family] = &[$(Family::$family),*];

            /// Specification of the family.
            pub fn spec(self) -> Spec {
                match self { $(Family::$family => $spec),* }
            }

            /// Largest scaled residual of row `r` that violates it by at most `tolerance` in the row's own unit, margins excluded.
            pub fn allowed<T: Real>(self, constants: &Constants<T>, r: usize, tolerance: T) -> T {
                match self { $(Family::$family => $allowed(constants, r, tolerance)),* }
            }

            /// Writes the place of an element's rows and the seats of its blocks into its table entry.
            pub(crate) fn place<T: Real>(self, tables: &mut Tables<T>, entry: usize, at: &Placed) {
                match self { $(Family::$family => $place(tables, entry, at)),* }
            }
        }
    };
}

families! {
    /// `towr`: Newton-Euler equations at an instant, moments before forces.
    Dynamics { dynamics::SPEC, dynamics::allowed, dynamics::place }
    /// `momentum`: change of linear momentum, then of position, over an interval.
    LinearMomentum { momentum::LINEAR, momentum::linear_allowed, momentum::place_linear }
    /// `momentum`: angular momentum at the end of an interval, then its mean over the interval.
    AngularMomentum { momentum::ANGULAR, momentum::angular_allowed, momentum::place_angular }
    /// Reach box of a foot at an instant.
    Reach { reach::SPEC, reach::allowed, reach::place }
    /// Normal force and friction pyramid at a force node or at a Bezier point next to it.
    Force { force::SPEC, force::allowed, force::place }
    /// Height of a swinging foot above the terrain.
    Swing { swing::SPEC, swing::allowed, swing::place }
    /// Length of the step of a swing, which bounds the foot's speed.
    Stride { stride::SPEC, stride::allowed, stride::place }
    /// Acceleration of a foot at the ends of a swing.
    Acceleration { acceleration::SPEC, acceleration::allowed, acceleration::place }
    /// Normal force and friction cone at a force node or at a Bezier point next to it.
    Cone { cone::SPEC, cone::allowed, cone::place }
    /// Box of a foothold on ground with edges.
    Footing { footing::SPEC, footing::allowed, footing::place }
    /// Centre of pressure and torsion of a sole at a force node or at a Bezier point next to it.
    Sole { sole::SPEC, sole::allowed, sole::place }
    /// Yaw of a standing sole relative to the base.
    Turn { turn::SPEC, turn::allowed, turn::place }
    /// Repetition of a periodic stride.
    Periodic { periodic::SPEC, periodic::allowed, periodic::place }
    /// Curvature of a friction cone.
    ConeCurvature { cone_curvature::SPEC, cone_curvature::allowed, cone_curvature::place }
    /// Effort of the force at a node.
    Effort { effort::SPEC, effort::allowed, effort::place }
    /// Powers of a standing leg along and across itself.
    StancePower { stance_power::SPEC, stance_power::allowed, stance_power::place }
    /// Power of a swinging leg.
    SwingPower { swing_power::SPEC, swing_power::allowed, swing_power::place }
    /// Distance of the base from the goal.
    Goal { goal::SPEC, goal::allowed, goal::place }
    /// Torques of a standing leg beyond the limits of its joints.
    JointTorque { joint_torque::SPEC, joint_torque::allowed, joint_torque::place }
    /// Speeds of the joints of a swinging leg beyond their limits.
    JointSpeed { joint_speed::SPEC, joint_speed::allowed, joint_speed::place }
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

/// Passes the tables of all families (`name Buffer [Entry]` each) to a macro. Shaders bind the tables by these names.
macro_rules! row_tables {
    ($then:path $(, $more:tt)*) => {
        $then! { $($more)*
            footholds Footholds [u32],
            dynamics_instants DynamicsInstants [$crate::rows::dynamics::DynamicsInstant<T>],
            stance_forces StanceForces [$crate::rows::foot::StanceForce<T>],
            momentum_intervals MomentumIntervals [$crate::rows::momentum::MomentumInterval<T>],
            impulses Impulses [$crate::rows::momentum::Impulse<T>],
            reach_instants ReachInstants [$crate::rows::reach::ReachInstant<T>],
            reach_feet ReachFeet [$crate::rows::reach::ReachFoot<T>],
            reach_legs ReachLegs [$crate::rows::reach::ReachLeg<T>],
            force_nodes ForceNodes [$crate::rows::force::ForceNode<T>],
            swing_nodes SwingNodes [$crate::rows::swing::SwingNode<T>],
            strides Strides [$crate::rows::stride::Stride<T>],
            accelerations Accelerations [$crate::rows::acceleration::Acceleration<T>],
            cones Cones [$crate::rows::cone::Cone<T>],
            footings Footings [$crate::rows::footing::Footing<T>],
            sole_points SolePoints [$crate::rows::sole::SolePoint<T>],
            turns Turns [$crate::rows::turn::Turn<T>],
            periodics Periodics [$crate::rows::periodic::Periodic<T>],
            cone_curvatures ConeCurvatures [$crate::rows::cone_curvature::ConeCurvature<T>],
            efforts Efforts [$crate::rows::effort::Effort<T>],
            stance_powers StancePowers [$crate::rows::stance_power::StancePower<T>],
            swing_powers SwingPowers [$crate::rows::swing_power::SwingPower<T>],
            goals Goals [$crate::rows::goal::Goal<T>],
            joint_torques JointTorques [$crate::rows::joint_torque::JointTorque<T>],
            joint_speeds JointSpeeds [$crate::rows::joint_speed::JointSpeed<T>],
        }
    };
}
#[cfg(feature = "gpu")]
pub(crate) use row_tables;

/// Passes the shaders that evaluate all rows, in order, to a macro. Each is listed with the table over whose entries it runs.
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
            Sole "rows/sole" sole_points,
            Turn "rows/turn" turns,
            Periodic "rows/periodic" periodics,
            ConeCurvature "rows/cone_curvature" cone_curvatures,
            Effort "rows/effort" efforts,
            StancePower "rows/stance_power" stance_powers,
            SwingPower "rows/swing_power" swing_powers,
            Goal "rows/goal" goals,
            JointTorque "rows/joint_torque" joint_torques,
            JointSpeed "rows/joint_speed" joint_speeds,
        }
    };
}
#[cfg(feature = "gpu")]
pub(crate) use row_shaders;

macro_rules! tables {
    ($($table:ident $buffer:ident [$entry:ty],)*) => {
        /// Data of the rows of one candidate: constants, ground, and a table per kind of entry.
        #[derive(Debug, Clone)]
        pub struct Tables<T> {
            /// Physical constants and row scales.
            pub constants: Constants<T>,
            /// Terrain.
            pub terrain: Arc<Terrain>,
            /// Points at which the momentum of every interval is evaluated.
            pub momentum_points: [MomentumPoint<T>; MOMENTUM_POINTS],
            /// Factors of the reach rows.
            pub reach_rows: FactoredRows<T, { reach::ROWS }>,
            $(
                #[doc = concat!("Table `", stringify!($table), "`.")]
                pub $table: Vec<$entry>,
            )*
        }

        impl<T: Real> Tables<T> {
            /// Empty tables.
            ///
            /// * `interval` - between base knots, s, in f64
            pub fn new(constants: Constants<T>, terrain: Arc<Terrain>, interval: f64) -> Self {
                Tables {
                    constants,
                    terrain,
                    momentum_points: momentum::points(interval),
                    reach_rows: FactoredRows::new(Family::Reach),
                    $($table: Vec::new(),)*
                }
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
        /// Inverse of the inertia, base frame, 1/(kg m²).
        pub inverse_inertia: [[T; 3]; 3],
        /// Scale of moment rows, 1/(N m).
        pub moment_scale: T,
        /// Scale of force balance rows, 1/N.
        pub balance_scale: T,
        /// Interval between base knots, s.
        pub interval: T,
        /// Scale of reach and swing rows, 1/m.
        pub length_scale: T,
        /// Unit of the force variables, N; force rows are divided by it.
        pub force_unit: T,
        /// Largest normal force, in force units.
        pub force_limit: T,
        /// Friction coefficient.
        pub friction: T,
        /// Tightening of reach and swing rows, m.
        pub length_margin: T,
        /// Tightening of force rows, in force units.
        pub force_margin: T,
        /// Radius of a foot for clearance from edges, m; 0 if no foot keeps clear of edges.
        pub foot_radius: T,
        /// Radius of the ball of a foot that keeps clear of edges, m; 0 for a sole.
        pub ball_radius: T,
        /// Largest acceleration of a foot, m/s².
        pub foot_acceleration: T,
        /// Largest moment about the y and the x axis of a sole per normal force, in half lengths; 0 without soles.
        pub pressure: [T; 2],
        /// Half length of a sole over its torsion radius; 0 without soles.
        pub torsion: T,
    }
}

/// Quantities at one `x` that the rows of a candidate share.
#[derive(Debug, Clone)]
pub struct Shared<T> {
    /// Ground under the footholds, `[footholds]`.
    pub ground: Vec<Ground<T>>,
    /// Deviations of the base from its cubics inside the intervals, `[intervals]`.
    pub deviations: Vec<Deviation<T>>,
    /// True to keep the deviations constant, consistent with the derivatives of the rows.
    pub frozen: bool,
}

impl<T: Real> Default for Shared<T> {
    fn default() -> Self {
        Shared { ground: Vec::new(), deviations: Vec::new(), frozen: false }
    }
}

impl<T: Real> Shared<T> {
    /// Allocates for a candidate.
    pub fn resize(&mut self, tables: &Tables<T>) {
        self.ground.resize(tables.footholds.len(), Ground::level(T::zero()));
        self.deviations.resize(tables.momentum_intervals.len(), Deviation::default());
    }
}

/// Evaluates the residuals, and optionally the Jacobian, of all elements at `x`.
///
/// * `edge_radius` - radius with which terrain edges are rounded for the force rows, m; 0 for the exact rows
/// * `shared` - quantities that rows share; overwritten, except frozen deviations
/// * `equality` - out, `c`, `[equalities]`, dimensionless; satisfied when zero; then the residuals of the cost rows, `[costs]`
/// * `inequality` - out, `g`, `[inequalities]`, dimensionless; satisfied when `g <= 0`
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
    footing::footing(tables, x, inequality, jacobian.as_deref_mut());
    sole::sole(tables, x, inequality, jacobian.as_deref_mut());
    turn::turn(tables, x, inequality, jacobian.as_deref_mut());
    periodic::periodic(tables, x, equality, jacobian.as_deref_mut());
    cone_curvature::cone_curvature(tables, x, equality, jacobian.as_deref_mut());
    effort::effort(tables, x, equality, jacobian.as_deref_mut());
    stance_power::stance_power(tables, x, ground, deviations, equality, jacobian.as_deref_mut());
    swing_power::swing_power(tables, x, ground, deviations, equality, jacobian.as_deref_mut());
    goal::goal(tables, x, equality, jacobian.as_deref_mut());
    joint_torque::joint_torque(tables, x, ground, deviations, equality, jacobian.as_deref_mut());
    joint_speed::joint_speed(tables, x, ground, deviations, equality, jacobian);
}

/// Largest residual of a force row for a tolerance in N.
fn force_allowed<T: Real>(constants: &Constants<T>, _: usize, tolerance: T) -> T {
    tolerance / constants.force_unit + constants.force_margin
}

/// Cost rows have no tolerance.
fn any_residual<T: Real>(_: &Constants<T>, _: usize, _: T) -> T {
    T::infinity()
}

/// Largest residual of a length row for a tolerance in m.
fn length_allowed<T: Real>(constants: &Constants<T>, _: usize, tolerance: T) -> T {
    (tolerance + constants.length_margin) * constants.length_scale
}
