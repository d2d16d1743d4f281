//! Objective that the search maximises.

use super::{Evaluation, stances};
use crate::error::{Error, Result};
use crate::gait::Schedule;
use crate::gait::cost::Cost;
use serde::{Deserialize, Serialize};

/// Term `f` of the objective `J = f - alpha N_vc`, which the search maximises.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "kebab-case")]
pub enum Objective {
    /// `f = 0`: any feasible gait is equally good.
    Feasibility,
    /// `f = -(sum of the stance counts)`.
    FewestStances,
    /// `f = -(mean of |normal force| over all force nodes)`, N.
    LeastForce,
    /// `f = -(cost of transport)`, see [`crate::gait::cost`].
    Transport,
    /// `f = -(horizon + joint cost)`, horizon in s.
    Time,
    /// `f = -(mean over time of sum |force|^2 + joint cost)`, forces in units of the robot's weight.
    Effort,
}

/// Objectives by name.
pub const OBJECTIVES: [(&str, Objective); 6] = [
    ("transport", Objective::Transport),
    ("feasibility", Objective::Feasibility),
    ("fewest-stances", Objective::FewestStances),
    ("least-force", Objective::LeastForce),
    ("time", Objective::Time),
    ("effort", Objective::Effort),
];

/// Largest amount by which a horizon just above a whole number of intervals is rounded down, s.
const ROUNDING: f64 = 1e-6;

impl Objective {
    /// Returns the objective with this name.
    ///
    /// # Errors
    /// [`Error::Unknown`] lists [`OBJECTIVES`].
    pub fn named(name: &str) -> Result<Objective> {
        let known = || OBJECTIVES.map(|(name, _)| name).join(", ");
        let found = OBJECTIVES.iter().find(|(n, _)| *n == name);
        found.map(|(_, objective)| *objective).ok_or_else(|| Error::Unknown { what: "objective", name: name.into(), known: known() })
    }

    /// True if `f` includes the joint cost.
    pub fn counts_joints(self) -> bool {
        matches!(self, Objective::Transport | Objective::Time | Objective::Effort)
    }

    /// Objective `J = f - alpha N_vc`. A NaN becomes negative infinity, which ranks after every finite value.
    ///
    /// * `stances` - number of stance phases of each foot
    /// * `penalty` - `alpha`, in the unit of `f` per violated constraint
    ///
    /// An infeasible motion has no cost; one further penalty takes its place.
    pub fn value(self, stances: &[usize], evaluation: &Evaluation, penalty: f64) -> f64 {
        let of_cost = |part: fn(&Cost) -> f64| evaluation.cost.as_ref().map_or(-penalty, |cost| -part(cost));
        let f = match self {
            Objective::Transport => of_cost(|cost| cost.total),
            Objective::Time => of_cost(|cost| cost.horizon + cost.joint_cost),
            Objective::Effort => of_cost(|cost| cost.effort + cost.joint_cost),
            Objective::Feasibility => 0.,
            Objective::FewestStances => -(stances.iter().sum::<usize>() as f64),
            Objective::LeastForce => -evaluation.mean_normal_force.abs(),
        };
        let j = f - penalty * evaluation.n_violated as f64;
        if j.is_nan() { f64::NEG_INFINITY } else { j }
    }

    /// Upper bound of [`Objective::value`] before anything is solved. Terms that depend on the schedule alone are exact; no cost is below
    /// zero.
    pub fn upper_bound(self, schedule: &Schedule, penalty: f64) -> f64 {
        match self {
            // Horizons are rounded up. The penalty of an infeasible motion can be smaller than a long horizon.
            Objective::Time => (ROUNDING - schedule.horizon()).max(-penalty),
            Objective::FewestStances => -(stances(schedule).iter().sum::<usize>() as f64),
            Objective::Feasibility | Objective::LeastForce | Objective::Transport | Objective::Effort => 0.,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn violations_reduce_every_objective() {
        let evaluation = Evaluation { n_violated: 3, feasible: false, certified: true, mean_normal_force: 80., cost: None };
        assert_eq!(Objective::Feasibility.value(&[7, 8], &evaluation, 100.), -300.);
        assert_eq!(Objective::FewestStances.value(&[7, 8], &evaluation, 100.), -315.);
        assert_eq!(Objective::LeastForce.value(&[7, 8], &evaluation, 100.), -380.);
    }

    #[test]
    fn no_objective_exceeds_its_upper_bound() {
        let schedule = Schedule::new(vec![vec![0.3, 0.2, 0.4], vec![0.1, 0.2, 0.3, 0.2, 0.12]]).unwrap();
        let horizon = schedule.aligned(0.1).horizon();
        let cost = Cost { total: 0.4, effort: 0.3, horizon, ..Cost::default() };
        for (_, objective) in OBJECTIVES {
            for penalty in [0., 0.5, 100.] {
                let bound = objective.upper_bound(&schedule, penalty);
                let value = |n_violated: usize, cost: Option<Cost>| {
                    let evaluation = Evaluation { n_violated, feasible: n_violated == 0, certified: true, mean_normal_force: 80., cost };
                    objective.value(&stances(&schedule), &evaluation, penalty)
                };
                for value in [value(0, Some(cost)), value(0, None), value(3, None)] {
                    assert!(value <= bound, "{objective:?}, penalty {penalty}: {value} > {bound}");
                }
                // The bound is tight for objectives that depend on the schedule alone.
                let known = matches!(objective, Objective::FewestStances | Objective::Feasibility);
                assert!(!known || value(0, Some(cost)) == bound);
            }
        }
        assert!((Objective::Time.upper_bound(&schedule, 100.) + 0.92).abs() < 1e-5);
    }

    #[test]
    fn a_nan_objective_ranks_after_all_others() {
        let evaluation = Evaluation { n_violated: 0, feasible: true, certified: true, mean_normal_force: f64::NAN, cost: None };
        assert_eq!(Objective::LeastForce.value(&[7], &evaluation, 100.), f64::NEG_INFINITY);
        assert_eq!(Objective::Feasibility.value(&[7], &evaluation, 100.), 0.);
    }
}
