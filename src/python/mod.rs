//! Python package: the functions of the program, for notebooks and other programs.
//!
//! Robots, terrains, tasks, motions and gaits are classes of this module; `cregopt/*.py` has the functions with their options. Options are
//! the keys of a scenario file and pass the same checks. Descriptions cross the boundary as JSON, samples as arrays.

mod call;
mod convert;
mod dataset;
mod evaluate;
mod joints;
mod motion;
mod planner;
mod search;
mod workers;
mod world;

use pyo3::prelude::*;

pyo3::create_exception!(
    cregopt,
    Error,
    pyo3::exceptions::PyValueError,
    "Invalid value, or a missing device or file. The text names the place, the value and the limit."
);

/// Compiled part of the package `cregopt`.
#[pymodule]
fn _cregopt(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add("__version__", env!("CARGO_PKG_VERSION"))?;
    module.add("ROBOTS", pyo3::types::PyTuple::new(module.py(), crate::robot::ROBOTS)?)?;
    module.add("TERRAINS", pyo3::types::PyTuple::new(module.py(), crate::terrain::TERRAINS)?)?;
    module.add("SCENARIOS", pyo3::types::PyTuple::new(module.py(), crate::scenario::SCENARIOS.map(|s| s.name))?)?;
    module.add("Error", module.py().get_type::<Error>())?;
    module.add_class::<world::Robot>()?;
    module.add_class::<world::Terrain>()?;
    module.add_class::<world::Task>()?;
    module.add_class::<motion::Trajectory>()?;
    module.add_class::<motion::Samples>()?;
    module.add_class::<joints::Joints>()?;
    module.add_class::<motion::Certificate>()?;
    module.add_class::<search::Gait>()?;
    module.add_class::<evaluate::Evaluation>()?;
    module.add_class::<planner::RobotState>()?;
    module.add_class::<planner::Plan>()?;
    module.add_class::<planner::Update>()?;
    module.add_class::<planner::Planner>()?;
    module.add_function(wrap_pyfunction!(motion::verify, module)?)?;
    module.add_function(wrap_pyfunction!(search::search, module)?)?;
    module.add_function(wrap_pyfunction!(search::solve, module)?)?;
    module.add_function(wrap_pyfunction!(evaluate::evaluate, module)?)?;
    module.add_function(wrap_pyfunction!(workers::solve_chunk, module)?)?;
    module.add_function(wrap_pyfunction!(dataset::dataset_plan, module)?)?;
    module.add_function(wrap_pyfunction!(dataset::dataset_drafts, module)?)?;
    module.add_function(wrap_pyfunction!(dataset::dataset_make, module)?)
}
