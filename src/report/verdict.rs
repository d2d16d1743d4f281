//! What a certificate says, in a few words for titles.

use crate::gait::Trajectory;
use crate::verify::RowReport;
use crate::verify::labels::of_momentum;

/// The verdict on a motion. TOWR's rows say nothing of what happens between the instants: who keeps them is not called certified.
pub fn verdict(trajectory: &Trajectory, report: &RowReport) -> String {
    match (report.feasible, of_momentum(trajectory)) {
        (true, true) => "certified".into(),
        (true, false) => "keeps the rows it was made for".into(),
        (false, _) => format!("not certified: {} of {} rows violated", report.n_violated, report.n_rows),
    }
}
