//! Memory of a search. It has a process of its own, because it counts every allocation.

use cregopt::gait::family::families;
use cregopt::search::evaluate::LowerSettings;
use cregopt::search::{Gaits, SearchEvent, SearchSettings};
use cregopt::{Cpu, Goal, Robot, Search, Task, Terrain};
use std::alloc::{GlobalAlloc, Layout, System};
use std::sync::atomic::{AtomicUsize, Ordering};

/// Number of bytes allocated now.
static HELD: AtomicUsize = AtomicUsize::new(0);

/// The system's allocator with a count.
struct Counted;

// SAFETY: every call is passed on to the system's allocator unchanged.
unsafe impl GlobalAlloc for Counted {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        HELD.fetch_add(layout.size(), Ordering::Relaxed);
        // SAFETY: the caller keeps the contract.
        unsafe { System.alloc(layout) }
    }

    unsafe fn dealloc(&self, memory: *mut u8, layout: Layout) {
        HELD.fetch_sub(layout.size(), Ordering::Relaxed);
        // SAFETY: the caller keeps the contract, and the memory came from this allocator.
        unsafe { System.dealloc(memory, layout) }
    }
}

#[global_allocator]
static COUNTED: Counted = Counted;

/// Largest memory per candidate, bytes: a quarter of the values of its variables alone.
const MOST: usize = 2048;

/// Memory in use after a generation of this size has been ranked, bytes.
fn held(task: &Task, population: usize) -> usize {
    let gaits = Gaits::Families(families(&task.robot));
    let settings = SearchSettings { gaits, generations: 1, further_generations: 0, perturbed_generations: 0, ..SearchSettings::default() };
    // The number of candidates matters, not their results.
    let mut lower = LowerSettings::default();
    lower.solver.max_iterations = 1;
    let (mut most, before) = (0, HELD.load(Ordering::Relaxed));
    let watch = |progress: &SearchEvent| {
        if let SearchEvent::Generation(record) = progress
            && record.evaluated == population
        {
            most = HELD.load(Ordering::Relaxed).saturating_sub(before);
        }
    };
    Search::new(task).settings(settings).population(population).lower(lower).on_progress(watch).run(&Cpu::new(2).unwrap()).unwrap();
    most
}

#[test]
fn the_memory_of_a_candidate_is_small_in_a_large_population() {
    let task = Task::new(Robot::named("biped").unwrap(), Terrain::flat(), Goal::at(2., 0.)).unwrap();
    let (few, many) = (500, 2000);
    let [small, large] = [few, many].map(|population| held(&task, population));
    let each = large.saturating_sub(small) / (many - few);
    println!("{small} bytes for {few}, {large} for {many}: {each} per candidate");
    assert!(small > few * 100, "nothing was counted");
    assert!(each < MOST, "{each} bytes per candidate");
}
