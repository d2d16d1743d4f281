//! Short verdict of a certificate, for titles.

use crate::gait::Trajectory;
use crate::verify::RowReport;
use crate::verify::labels::of_momentum;

/// Verdict on a motion. TOWR's rows do not check the time between the instants, so a motion that satisfies them is not called certified.
pub fn verdict(trajectory: &Trajectory, report: &RowReport) -> String {
    match (report.feasible, of_momentum(trajectory)) {
        (true, true) => "certified".into(),
        (true, false) => "satisfies the rows it was solved for".into(),
        (false, _) => format!("not certified: {} of {} rows violated", report.n_violated, report.n_rows),
    }
}
