//! Order of the stages in a round. Both backends use it: the CPU calls a function per stage, the GPU dispatches a shader per stage.

/// One step of the algorithm, with a kernel on the CPU and on the GPU.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Stage {
    /// Choice of the round's purpose or the end of the solve, then weights and values of the rows in the normal equations.
    Weights,
    /// Factorisation of the normal equations, including forward substitution.
    Factorise,
    /// Back substitution, which gives the direction.
    Substitute,
    /// Product of the Jacobian with the direction.
    Product,
    /// Step lengths of the predictor, the barrier parameter that follows from them, and the row values for it.
    Correct,
    /// Product of the transposed Jacobian with the row values.
    Transposed,
    /// Forward substitution with the existing factor.
    Forward,
    /// Step length and trial point.
    Advance,
    /// Residuals and Jacobian at the trial point.
    Rows,
    /// Acceptance test of the trial point.
    Judge,
    /// Column scaling, initial slacks and multipliers.
    Start,
}

/// Rounds in which a stage runs.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum When {
    /// All rounds that compute a direction.
    Always,
    /// Rounds with a barrier step; a closing step has no corrector. A shader may run in other rounds too if it only reproduces its earlier
    /// result.
    Barrier,
}

/// Stages before the first round: the initial point is evaluated as a trial point.
pub const START: [Stage; 3] = [Stage::Rows, Stage::Start, Stage::Weights];

/// Stages of a round: compute a trial point from the existing weights, accept or refuse it, and compute the weights for the next round.
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
