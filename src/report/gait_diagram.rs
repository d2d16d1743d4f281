//! The contact schedule as text: one line per foot, time to the right.

use crate::gait::Schedule;

/// Widest diagram, characters.
const WIDTH: f64 = 100.;

/// Draws stance as `#` and swing as `.`. One character is at least 0.05 s.
pub fn gait_diagram(schedule: &Schedule) -> String {
    let horizon = schedule.horizon();
    let cell = (horizon / WIDTH).max(0.05);
    let mut text = String::new();
    for foot in 0..schedule.feet() {
        let phases = schedule.phases(foot);
        let bar = (0..(horizon / cell - 1e-9).ceil() as usize).map(|i| {
            let t = (i as f64 + 0.5) * cell;
            match phases.iter().find(|p| t < p.end) {
                Some(phase) if phase.stance => '#',
                Some(_) => '.',
                None => ' ',
            }
        });
        text += &format!("foot {foot}  {}\n", bar.collect::<String>());
    }
    text + &format!("        one character is {cell:.3} s; # stance, . swing\n")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bars_follow_the_phases() {
        let schedule = Schedule::new(vec![vec![0.2, 0.1, 0.2], vec![0.5]]).unwrap();
        let text = gait_diagram(&schedule);
        assert!(text.starts_with("foot 0  ####..####\nfoot 1  ##########\n"), "{text}");
    }
}
