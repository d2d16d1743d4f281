//! Verified motions as scenes of a page for a browser.

use super::terms::VerificationTerms;
use crate::gait::Trajectory;
use crate::verify::Report;
use crate::view::Scene;

/// Motion that a page shows.
pub struct Exhibit {
    /// Name on the page.
    pub name: String,
    /// Motion.
    pub trajectory: Trajectory,
    /// Terms under which it was verified.
    pub terms: VerificationTerms,
    /// Certificate.
    pub report: Report,
    /// Gait, cost and joints, as far as they are known.
    pub about: Vec<String>,
}

impl Exhibit {
    /// Scene of the page.
    pub fn scene(&self) -> Scene<'_> {
        Scene {
            name: &self.name,
            trajectory: &self.trajectory,
            robot: &self.terms.robot,
            terrain: &self.terms.terrain,
            force_limit: self.terms.force_limit,
            terms: &self.terms.lines,
            report: &self.report,
            about: &self.about,
        }
    }
}

/// Description of a gait: its family and its cost, as far as they are known.
pub fn description(family: Option<String>, cost: Option<f64>) -> Vec<String> {
    family.into_iter().chain(cost.map(|cost| format!("cost {cost:.3}"))).collect()
}
