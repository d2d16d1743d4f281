//! Guide: one short page per task, from the first gait to planning online.
//!
//! | page | contents |
//! |---|---|
//! | [`first_gait`] | one search, its output and its files |
//! | [`own_robot`] | URDF, MuJoCo models, soles, joints |
//! | [`own_ground`] | height maps, start and goal on uneven ground |
//! | [`certificate`] | every line of a certificate |
//! | [`remedies`] | symptoms, causes and settings |
//! | [`tracking`] | a plan as the reference of a controller |
//! | [`online`] | gaits that are chosen while the robot moves |
//! | [`datasets`] | thousands of certified motions for trainers of policies |
//! | [`clusters`] | searches on many machines |
//! | [`gpus`] | expectations of a GPU, measured and computed |
//!
//! Complete programs, one idea each, are in `benches/examples`: `cargo run --release --example first_gait`, `python
//! benches/examples/evaluate_many.py`.

#[doc = include_str!("first_gait.md")]
#[doc = "```python"]
#[doc = include_str!("../../benches/examples/search_and_samples.py")]
#[doc = "```"]
pub mod first_gait {}

#[doc = include_str!("own_robot.md")]
pub mod own_robot {}

#[doc = include_str!("own_ground.md")]
pub mod own_ground {}

#[doc = include_str!("certificate.md")]
pub mod certificate {}

#[doc = include_str!("remedies.md")]
pub mod remedies {}

#[doc = include_str!("tracking.md")]
#[doc = "```python"]
#[doc = include_str!("../../benches/examples/play_in_mujoco.py")]
#[doc = "```"]
pub mod tracking {}

#[doc = include_str!("online.md")]
#[doc = "```python"]
#[doc = include_str!("../../benches/examples/plan_online.py")]
#[doc = "```"]
pub mod online {}

#[doc = include_str!("datasets.md")]
#[doc = ""]
#[doc = "# Example of a specification"]
#[doc = "```toml"]
#[doc = include_str!("../../benches/examples/dataset.toml")]
#[doc = "```"]
pub mod datasets {}

#[doc = include_str!("clusters.md")]
#[doc = "```python"]
#[doc = include_str!("../../benches/examples/evaluate_many.py")]
#[doc = "```"]
pub mod clusters {}

#[doc = include_str!("gpus.md")]
pub mod gpus {}
