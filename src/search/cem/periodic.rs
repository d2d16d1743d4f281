//! Distribution over periodic gaits of several families.
//!
//! It is fitted to elites as in \[1\], with independent categoricals and Gaussians, with one difference: each family has its own Gaussians,
//! because a good walk and a good gallop have different durations. They are fitted only to the elites of their family. These may be few, so
//! the old Gaussian counts as [`PeriodicSettings::memory`] further elites.

use super::Distribution;
use super::marginals::{Categorical, Gaussian, fit};
use super::random::Draws;
use crate::error::{Error, Result, check_range};
use crate::gait::Schedule;
use crate::gait::family::{
    FOOT_SPEED_SCALED, GaitFamily, MIN_PHASE_SCALED, PeriodicGait, TYPICAL_LEAD_IN, TYPICAL_TAIL, offsets, speed_scale, time_scale,
};
use crate::task::Task;
use serde::{Deserialize, Serialize};

/// Settings of the distribution over periodic gaits. Logarithms of durations (unit [`time_scale`]) and speeds (unit [`speed_scale`]) are
/// drawn.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(default, deny_unknown_fields)]
pub struct PeriodicSettings {
    /// Initial standard deviation of the log durations of swing and stance. Too small: only the typical gait is tried; too large: most
    /// draws fail.
    pub duration_std: f64,
    /// Initial standard deviation of the log travel speed. Too small: only the typical speed is tried; too large: most draws fail.
    pub speed_std: f64,
    /// Initial standard deviation of the log durations of lead-in and tail, the stances before the first and after the last stride.
    pub rest_std: f64,
    /// Initial standard deviation of the phase offsets, strides. Too small: only the offsets of the family are tried; too large: families
    /// overlap.
    pub offset_std: f64,
    /// Largest deviation of a phase offset from that of the family, strides. Too small: no variation; too large: families overlap.
    pub offset_reach: f64,
    /// Smallest standard deviation. Too small: the search freezes; too large: it never converges.
    pub min_std: f64,
    /// Added to the share of each family among the elites before normalising. 0: a family can be lost for good; too large: no learning.
    pub floor: f64,
    /// Number of elites that the old Gaussian of a family counts as. 0: a single elite redefines its family; too large: no learning.
    pub memory: f64,
    /// The distribution counts as converged if the largest standard deviation of the likeliest family is below this. 0: never.
    pub converged_std: f64,
}

impl Default for PeriodicSettings {
    fn default() -> Self {
        PeriodicSettings {
            duration_std: 0.25,
            speed_std: 0.25,
            rest_std: 0.25,
            offset_std: 0.03,
            offset_reach: 0.2,
            min_std: 1e-3,
            floor: 0.02,
            memory: 2.,
            converged_std: 0.02,
        }
    }
}

impl PeriodicSettings {
    /// Checks every field.
    ///
    /// # Errors
    /// [`Error::Invalid`] names the first field that is outside its limits.
    pub fn validate(&self) -> Result<()> {
        let stds =
            [("duration_std", self.duration_std), ("speed_std", self.speed_std), ("rest_std", self.rest_std), ("min_std", self.min_std)];
        for (name, std) in stds {
            check_range(&format!("search.periodic.{name}"), std, 1e-9, 10.)?;
        }
        check_range("search.periodic.offset_std", self.offset_std, 1e-9, 1.)?;
        check_range("search.periodic.offset_reach", self.offset_reach, 0., 0.5)?;
        check_range("search.periodic.floor", self.floor, 0., 1.)?;
        check_range("search.periodic.memory", self.memory, 0., 1e6)?;
        check_range("search.periodic.converged_std", self.converged_std, 0., 10.)
    }
}

// Indices into `PeriodicSample::values`: logarithms of four durations and a speed, then one offset per foot.
const SWING: usize = 0;
const STANCE: usize = 1;
const SPEED: usize = 2;
const LEAD_IN: usize = 3;
const TAIL: usize = 4;
const OFFSETS: usize = 5;

/// Limits of the first [`OFFSETS`] dimensions before the logarithm. The lower limits of the phases are those that a leg can follow.
const LIMITS: [[f64; 2]; OFFSETS] =
    [[MIN_PHASE_SCALED, 4.], [MIN_PHASE_SCALED, 20.], [0.02, FOOT_SPEED_SCALED], [MIN_PHASE_SCALED, 5.], [0.1, 5.]];

/// One draw of [`PeriodicDistribution`].
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct PeriodicSample {
    /// Index of the family among [`PeriodicDistribution::families`].
    pub family: usize,
    /// Logarithms of swing, stance, travel speed, lead-in and tail in the robot's scales, followed by the phase offset of each foot,
    /// strides.
    pub values: Vec<f64>,
}

/// Distribution over periodic gaits of one robot.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct PeriodicDistribution {
    settings: PeriodicSettings,
    /// Families that are drawn from.
    pub families: Vec<GaitFamily>,
    /// Probability of each family.
    pub categorical: Categorical,
    /// Gaussians of each family, in the order of [`PeriodicSample::values`].
    pub gaussians: Vec<Vec<Gaussian>>,
    /// Nominal phase offsets of each family; drawn ones stay within [`PeriodicSettings::offset_reach`] of them.
    offsets: Vec<Vec<f64>>,
    #[serde(skip)]
    task: Task,
}

impl PeriodicDistribution {
    /// Distribution of the first generation: uniform over the families, around their typical values.
    ///
    /// # Errors
    /// [`Error::Unknown`] for a family that the robot cannot have, [`Error::Invalid`] for an empty list or bad settings.
    pub fn initial(task: &Task, families: &[GaitFamily], settings: &PeriodicSettings) -> Result<PeriodicDistribution> {
        settings.validate()?;
        let robot = &task.robot;
        if families.is_empty() {
            return Err(Error::invalid("gait", "no family", "at least one"));
        }
        let offsets = families.iter().map(|&family| offsets(family, robot)).collect::<Result<Vec<_>>>()?;
        let gaussians = families.iter().zip(&offsets).map(|(family, offsets)| {
            let typical = family.typical(robot.feet());
            let stance = typical.swing * typical.duty / (1. - typical.duty);
            let values = [typical.swing, stance, typical.speed, TYPICAL_LEAD_IN, TYPICAL_TAIL];
            let stds = [settings.duration_std, settings.duration_std, settings.speed_std, settings.rest_std, settings.rest_std];
            let scaled = values.into_iter().zip(stds).map(|(value, std)| Gaussian { mean: value.ln(), std });
            scaled.chain(offsets.iter().map(|&mean| Gaussian { mean, std: settings.offset_std })).collect()
        });
        Ok(PeriodicDistribution {
            settings: settings.clone(),
            families: families.to_vec(),
            categorical: Categorical::uniform(families.len()),
            gaussians: gaussians.collect(),
            offsets,
            task: task.clone(),
        })
    }

    /// Mean gait of each family, in the order of `families`. Those of the first generation are the typical gaits, worth trying before any
    /// draw.
    pub fn means(&self) -> Vec<PeriodicSample> {
        let means = self.gaussians.iter().enumerate();
        means.map(|(family, gaussians)| PeriodicSample { family, values: gaussians.iter().map(|g| g.mean).collect() }).collect()
    }

    /// Gait of a sample, with the number of strides that the task takes.
    ///
    /// # Errors
    /// [`Error::Invalid`] for a sample of another distribution or of a robot with another number of feet.
    pub fn gait(&self, sample: &PeriodicSample) -> Result<PeriodicGait> {
        let family = *self.families.get(sample.family).ok_or_else(|| {
            Error::invalid("sample.family", sample.family, format!("below {}, the number of families", self.families.len()))
        })?;
        let task = &self.task;
        if sample.values.len() != OFFSETS + task.robot.feet() {
            let limit = format!("{OFFSETS} and one for each of {} feet", task.robot.feet());
            return Err(Error::invalid("sample.values", sample.values.len(), limit));
        }
        let (time, speed) = (time_scale(&task.robot), speed_scale(&task.robot));
        let offsets = &sample.values[OFFSETS..];
        // The lead-in ends with the first lift-off.
        let first = offsets.iter().copied().fold(f64::INFINITY, f64::min);
        let gait = PeriodicGait {
            family,
            offsets: offsets.iter().map(|offset| offset - first).collect(),
            swing: time * sample.values[SWING].exp(),
            stance: time * sample.values[STANCE].exp(),
            strides: 0,
            lead_in: time * sample.values[LEAD_IN].exp(),
            tail: time * sample.values[TAIL].exp(),
        };
        Ok(gait.for_travel(task, speed * sample.values[SPEED].exp()))
    }

    /// Fits only the probabilities of the families to the elites.
    pub fn update_families(&mut self, elites: &[&PeriodicSample]) {
        self.categorical.update(&elites.iter().map(|e| e.family).collect::<Vec<_>>(), self.settings.floor);
    }

    /// Limits of a dimension of [`PeriodicSample::values`].
    fn limits(&self, family: usize, dimension: usize) -> [f64; 2] {
        match LIMITS.get(dimension) {
            Some(limits) => limits.map(f64::ln),
            None => [-1., 1.].map(|side| self.offsets[family][dimension - OFFSETS] + side * self.settings.offset_reach),
        }
    }
}

impl Distribution for PeriodicDistribution {
    type Sample = PeriodicSample;

    /// Random dimension 0 picks the family; the others belong to the values.
    fn sample(&self, mut draws: Draws) -> PeriodicSample {
        let family = self.categorical.pick(draws.uniform(0));
        let gaussians = self.gaussians[family].iter().enumerate();
        let values = gaussians.map(|(d, g)| g.sample(draws.normal(1 + d), self.limits(family, d))).collect();
        PeriodicSample { family, values }
    }

    fn schedule(&self, sample: &PeriodicSample) -> Result<Schedule> {
        self.gait(sample)?.schedule()
    }

    fn family(&self, sample: &PeriodicSample) -> Option<GaitFamily> {
        self.families.get(sample.family).copied()
    }

    fn update(&mut self, elites: &[&PeriodicSample]) {
        self.update_families(elites);
        for (family, gaussians) in self.gaussians.iter_mut().enumerate() {
            for (d, gaussian) in gaussians.iter_mut().enumerate() {
                let values: Vec<f64> = elites.iter().filter(|e| e.family == family).map(|e| e.values[d]).collect();
                fit(gaussian, &values, self.settings.memory, self.settings.min_std);
            }
        }
    }

    fn entropy(&self) -> f64 {
        self.categorical.entropy()
    }

    fn largest_std(&self) -> f64 {
        self.gaussians[self.categorical.mode()].iter().map(|g| g.std).fold(0., f64::max)
    }

    fn converged(&self) -> bool {
        self.categorical.settled(self.settings.floor) && self.largest_std() < self.settings.converged_std
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gait::family::families;
    use crate::scenario::Scenario;

    fn quadruped() -> (Task, PeriodicDistribution) {
        let task = Scenario::named("s1").unwrap().task_to([2., 0.]).unwrap();
        let distribution = PeriodicDistribution::initial(&task, &families(&task.robot), &PeriodicSettings::default()).unwrap();
        (task, distribution)
    }

    #[test]
    fn the_means_of_the_first_generation_are_the_typical_gaits() {
        let (task, distribution) = quadruped();
        for (sample, family) in distribution.means().iter().zip(families(&task.robot)) {
            let (got, want) = (distribution.gait(sample).unwrap(), PeriodicGait::typical(family, &task).unwrap());
            assert_eq!((got.family, got.strides), (want.family, want.strides));
            let pairs = [(got.swing, want.swing), (got.stance, want.stance), (got.lead_in, want.lead_in), (got.tail, want.tail)];
            assert!(pairs.iter().all(|(g, w)| (g - w).abs() < 1e-12) && got.offsets == want.offsets);
        }
    }

    #[test]
    fn every_draw_is_a_schedule_without_short_phases() {
        let (task, mut distribution) = quadruped();
        // Far wider than in any search, so that the limits take effect.
        distribution.gaussians.iter_mut().flatten().for_each(|g| g.std = 1.);
        let shortest = MIN_PHASE_SCALED * time_scale(&task.robot);
        for candidate in 0..200 {
            let sample = distribution.sample(Draws::new(5, 0, candidate));
            let gait = distribution.gait(&sample).unwrap();
            assert!(gait.strides >= 1 && gait.offsets.iter().all(|&o| o >= 0.) && gait.offsets.contains(&0.));
            let Ok(schedule) = distribution.schedule(&sample) else {
                assert!(gait.horizon() > crate::gait::schedule::MAX_HORIZON - 1e-9);
                continue;
            };
            assert!(schedule.durations().iter().flatten().all(|&d| d >= shortest - 1e-9));
        }
    }

    #[test]
    fn the_random_number_of_a_dimension_does_not_depend_on_the_family() {
        let (_, mut distribution) = quadruped();
        let z = |d: &PeriodicDistribution| {
            let s = d.sample(Draws::new(1, 2, 3));
            (s.family, (s.values[SPEED] - d.gaussians[s.family][SPEED].mean) / d.gaussians[s.family][SPEED].std)
        };
        let before = z(&distribution);
        distribution.categorical.probabilities = vec![0.; 8];
        distribution.categorical.probabilities[(before.0 + 1) % 8] = 1.;
        let after = z(&distribution);
        assert!(before.0 != after.0 && (before.1 - after.1).abs() < 1e-12);
    }

    #[test]
    fn elites_of_a_family_change_only_its_gaussians() {
        let (_, mut distribution) = quadruped();
        let before = distribution.clone();
        let mut elite = before.means()[2].clone();
        elite.values[SWING] += 0.3;
        distribution.update(&[&elite]);
        for family in [0, 1, 3, 7] {
            assert_eq!(distribution.gaussians[family], before.gaussians[family]);
        }
        // One elite that is 0.3 off, and two at the mean with the old spread of 0.25.
        let (old, new) = (before.gaussians[2][SWING], distribution.gaussians[2][SWING]);
        assert!((new.mean - old.mean - 0.1).abs() < 1e-12);
        assert!((new.std - ((0.09 + 2. * 0.0625) / 3f64).sqrt()).abs() < 1e-12);
        // (1 + 0.02) / (1 + 8 * 0.02); the other families get 0.02 / 1.16.
        assert_eq!(distribution.categorical.mode(), 2);
        assert!((distribution.categorical.probabilities[2] - 1.02 / 1.16).abs() < 1e-12);
        let same = distribution.clone();
        distribution.update(&[]);
        assert_eq!(distribution, same);
    }

    #[test]
    fn the_distribution_converges_if_the_elites_agree() {
        let (_, mut distribution) = quadruped();
        assert!((distribution.entropy() - 8f64.ln()).abs() < 1e-12 && (distribution.largest_std() - 0.25).abs() < 1e-12);
        let elite = distribution.means()[1].clone();
        for generation in 0..40 {
            if distribution.converged() {
                assert!(generation > 2);
                return;
            }
            distribution.update(&[&elite; 8]);
        }
        panic!("std {}", distribution.largest_std());
    }

    #[test]
    fn invalid_arguments_are_rejected() {
        let (task, distribution) = quadruped();
        let initial = |families: &[GaitFamily]| PeriodicDistribution::initial(&task, families, &PeriodicSettings::default());
        assert!(initial(&[]).unwrap_err().to_string().contains("no family"));
        assert!(initial(&[GaitFamily::Tripod]).unwrap_err().to_string().contains("trot, walk"));
        let bad = PeriodicSettings { offset_std: 2., ..Default::default() };
        assert!(PeriodicDistribution::initial(&task, &[GaitFamily::Trot], &bad).unwrap_err().to_string().contains("offset_std"));
        assert!(distribution.gait(&PeriodicSample { family: 9, values: vec![0.; 9] }).is_err());
        assert!(distribution.gait(&PeriodicSample { family: 0, values: vec![0.; 8] }).is_err());
    }
}
