//! Threads of a search. It has a process of its own, because rayon's global pool belongs to the whole process.

use cregopt::refine::RefineSettings;
use cregopt::search::SearchSettings;
use cregopt::search::evaluate::LowerSettings;
use cregopt::{Cpu, Goal, Robot, Search, Task, Terrain};

#[test]
fn a_search_and_a_refinement_start_no_threads_except_those_of_their_backend() {
    let task = Task::new(Robot::named("biped").unwrap(), Terrain::flat(), Goal::at(0.8, 0.1)).unwrap();
    let (search, lower, one) = (SearchSettings::default(), LowerSettings::default(), Cpu::new(1).unwrap());
    let found = Search::new(&task).settings(search.clone()).seed(3).run(&one).unwrap();
    // The second gait was certified on demand.
    assert!(found.best.feasible() && found.improvements.len() > 1);
    let refine = RefineSettings { iterations: 2, ..RefineSettings::default() };
    let (_, refined) = found.best.refined(&task, &search, &lower, &refine, &one, &|| false).unwrap();
    assert_eq!(refined.iterations, 2);
    // The global pool starts when it is first used, and cannot be built after that.
    let global = rayon::ThreadPoolBuilder::new().num_threads(1).build_global();
    assert!(global.is_ok(), "{}", global.unwrap_err());
}
