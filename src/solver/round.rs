//! The order of a round. Both backends read it: the CPU's loop calls what stands behind a stage, a GPU dispatches its shader.

/// One step of the algorithm, a kernel on either side.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Stage {
    /// What the round is for, or the end; then weights and values of the rows in the normal equations.
    Weights,
    /// Factorisation of the normal equations, with forward substitution along the way.
    Factorise,
    /// Back substitution: the direction.
    Substitute,
    /// Products of the Jacobian with the direction.
    Product,
    /// How far the predictor could go, the barrier parameter that follows, and the values of the rows for it.
    Correct,
    /// Product of the transposed Jacobian with those values.
    Transposed,
    /// Forward substitution with the factor that is there.
    Forward,
    /// Length of the step, and the trial point.
    Advance,
    /// Residuals and Jacobian at the trial point.
    Rows,
    /// The verdict on the trial point.
    Judge,
    /// Column scaling, first slacks and multipliers.
    Start,
}

/// In which rounds a stage has something to do.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum When {
    /// In all that make a direction.
    Always,
    /// In barrier steps: a closing step has no corrector. Shaders may repeat what they did, to the same end.
    Barrier,
}

/// What comes before the first round: the initial point is evaluated as a trial point.
pub const START: [Stage; 3] = [Stage::Rows, Stage::Start, Stage::Weights];

/// A round makes a trial point from the weights that are there, judges it, and gives weights to the next one.
pub const ROUND: [(Stage, When); 12] = [
    (Stage::Factorise, When::Always),
    (Stage::Substitute, When::Always),
    (Stage::Product, When::Always),
    (Stage::Correct, When::Barrier),
    (Stage::Transposed, When::Barrier),
    (Stage::Forward, When::Barrier),
    (Stage::Substitute, When::Barrier),
    (Stage::Product, When::Barrier),
    (Stage::Advance, When::Always),
    (Stage::Rows, When::Always),
    (Stage::Judge, When::Always),
    (Stage::Weights, When::Always),
];
