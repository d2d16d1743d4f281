//! Cost weights: the default, and a search in which bearing forces is cheap.

use cregopt::gait::cost::CostWeights;
use cregopt::search::SearchSettings;
use cregopt::{Cpu, Goal, Robot, Search, Task, Terrain};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let task = Task::new(Robot::named("biped")?, Terrain::flat(), Goal::at(1., 0.))?;
    let cpu = Cpu::new(0)?;
    let mut efforts = Vec::new();
    for effort in [1., 0.1] {
        let cost = CostWeights { effort, ..CostWeights::default() };
        let settings = SearchSettings { cost, generations: 1, ..SearchSettings::default() };
        let best = Search::new(&task).settings(settings).run(&cpu)?.best;
        assert!(best.feasible());
        let cost = best.candidate.solution.cost.ok_or("no cost")?;
        println!("weight {effort}: leg work {:.3}, swing work {:.3}, effort {:.3}", cost.leg_work, cost.swing_work, cost.effort_cost);
        efforts.push(cost.effort_cost);
    }
    // The cheaper an effort is, the more of it the best gait has, in exchange for less work.
    assert!(efforts[1] > efforts[0]);
    Ok(())
}
