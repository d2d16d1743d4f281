//! What a certificate says, in a few words for titles.

use crate::gait::Trajectory;
use crate::settings::Transcription;
use crate::verify::RowReport;

/// Whether a motion is held to the rows of `momentum`, and with them to what happens between the instants.
pub fn of_momentum(trajectory: &Trajectory) -> bool {
    trajectory.transcription.as_deref() == Some(Transcription::Momentum.name())
}

/// The verdict on a motion. TOWR's rows say nothing of what happens between the instants: who keeps them is not called certified.
pub fn verdict(trajectory: &Trajectory, report: &RowReport) -> String {
    match (report.feasible, of_momentum(trajectory)) {
        (true, true) => "certified".into(),
        (true, false) => "keeps the rows it was made for".into(),
        (false, _) => format!("not certified: {} of {} rows violated", report.n_violated, report.n_rows),
    }
}
