//! Cost weights: the default, and a search in which swings are cheap.

use cregopt::gait::cost::CostWeights;
use cregopt::search::SearchSettings;
use cregopt::{Cpu, Goal, Robot, Search, Task, Terrain};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let task = Task::new(Robot::named("biped")?, Terrain::flat(), Goal::at(1., 0.))?;
    let cpu = Cpu::new(0)?;
    let mut swings = Vec::new();
    for swing_work in [1., 0.1] {
        let cost = CostWeights { swing_work, ..CostWeights::default() };
        let settings = SearchSettings { cost, generations: 1, ..SearchSettings::default() };
        let best = Search::new(&task).settings(settings).run(&cpu)?.best;
        assert!(best.feasible());
        let cost = best.candidate.solution.cost.ok_or("no cost")?;
        println!("weight {swing_work}: leg work {:.3}, swing work {:.3}, effort {:.3}", cost.leg_work, cost.swing_work, cost.effort);
        swings.push(cost.swing_work);
    }
    // The cheaper a swing is, the more the feet may work.
    assert!(swings[1] > swings[0]);
    Ok(())
}
