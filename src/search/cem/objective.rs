//! What the search maximises.

use super::{Evaluation, stances};
use crate::error::{Error, Result};
use crate::gait::Schedule;
use crate::gait::cost::Cost;
use serde::{Deserialize, Serialize};

/// The term `f` of the objective `J = f - alpha N_vc`, maximised.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "kebab-case")]
pub enum Objective {
    /// `f = 0`: any feasible gait.
    Feasibility,
    /// `f = -(sum of the stance counts)`.
    FewestStances,
    /// `f = -(mean of |normal force| over all force nodes)`, N.
    LeastForce,
    /// `f = -(cost of transport)`, see [`crate::gait::cost`].
    Transport,
    /// `f = -horizon`, s, less the joint cost.
    Time,
    /// `f = -(mean over time of sum |f|^2)`, squared weights, less the joint cost.
    Effort,
}

/// Objectives by name, each with what it seeks.
pub const OBJECTIVES: [(&str, Objective); 6] = [
    ("transport", Objective::Transport),
    ("feasibility", Objective::Feasibility),
    ("fewest-stances", Objective::FewestStances),
    ("least-force", Objective::LeastForce),
    ("time", Objective::Time),
    ("effort", Objective::Effort),
];

/// A horizon hardly above whole intervals is rounded down, by less than this, s.
const ROUNDING: f64 = 1e-6;

impl Objective {
    /// An objective by name.
    ///
    /// # Errors
    /// [`Error::Unknown`] lists [`OBJECTIVES`].
    pub fn named(name: &str) -> Result<Objective> {
        let known = || OBJECTIVES.map(|(name, _)| name).join(", ");
        let found = OBJECTIVES.iter().find(|(n, _)| *n == name);
        found.map(|(_, objective)| *objective).ok_or_else(|| Error::Unknown { what: "objective", name: name.into(), known: known() })
    }

    /// Whether the joint cost is in `f`.
    pub fn counts_joints(self) -> bool {
        matches!(self, Objective::Transport | Objective::Time | Objective::Effort)
    }

    /// `J = f - alpha N_vc`; negative infinity, behind every finite value, when that is no number.
    ///
    /// * `stances` - stance phases of each foot
    /// * `penalty` - `alpha`, in the unit of `f` per violated constraint
    ///
    /// Costs of motions that were not found are no costs: they count as one penalty more.
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

    /// The most that [`Objective::value`] can be, before anything is solved. What is a matter of the schedule alone is known then; no cost is
    /// below zero.
    pub fn most(self, schedule: &Schedule, penalty: f64) -> f64 {
        match self {
            // A horizon is rounded up; not found at all can be better than long.
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
    fn objectives_are_penalised_by_violations() {
        let evaluation = Evaluation { n_violated: 3, feasible: false, certified: true, mean_normal_force: 80., cost: None };
        assert_eq!(Objective::Feasibility.value(&[7, 8], &evaluation, 100.), -300.);
        assert_eq!(Objective::FewestStances.value(&[7, 8], &evaluation, 100.), -315.);
        assert_eq!(Objective::LeastForce.value(&[7, 8], &evaluation, 100.), -380.);
    }

    #[test]
    fn no_schedule_is_worth_more_than_it_can_be() {
        let schedule = Schedule::new(vec![vec![0.3, 0.2, 0.4], vec![0.1, 0.2, 0.3, 0.2, 0.12]]).unwrap();
        let horizon = schedule.aligned(0.1).horizon();
        let cost = Cost { total: 0.4, effort: 0.3, horizon, ..Cost::default() };
        for (_, objective) in OBJECTIVES {
            for penalty in [0., 0.5, 100.] {
                let most = objective.most(&schedule, penalty);
                let value = |n_violated: usize, cost: Option<Cost>| {
                    let evaluation = Evaluation { n_violated, feasible: n_violated == 0, certified: true, mean_normal_force: 80., cost };
                    objective.value(&stances(&schedule), &evaluation, penalty)
                };
                for value in [value(0, Some(cost)), value(0, None), value(3, None)] {
                    assert!(value <= most, "{objective:?}, penalty {penalty}: {value} > {most}");
                }
                // A bound that says something: what is known of a schedule is all there is to its objective.
                let known = matches!(objective, Objective::FewestStances | Objective::Feasibility);
                assert!(!known || value(0, Some(cost)) == most);
            }
        }
        assert!((Objective::Time.most(&schedule, 100.) + 0.92).abs() < 1e-5);
    }

    #[test]
    fn an_objective_that_is_no_number_is_behind_all_others() {
        let evaluation = Evaluation { n_violated: 0, feasible: true, certified: true, mean_normal_force: f64::NAN, cost: None };
        assert_eq!(Objective::LeastForce.value(&[7], &evaluation, 100.), f64::NEG_INFINITY);
        assert_eq!(Objective::Feasibility.value(&[7], &evaluation, 100.), 0.);
    }
}
