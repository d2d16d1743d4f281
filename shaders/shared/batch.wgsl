// Sizes of the batch, what is known of the candidate in each slot, and how far its solve is.
// Twins: `Batch`, `Slot`, `Shape` in src/kernels/batch.rs, `Progress` in src/kernels/control.rs; `Constants` and `MomentumPoint` in
// src/nlp/layout.rs.
//
// One workgroup of WORKGROUP invocations works on one slot. Every table holds the same number of entries a slot, enough for the largest candidate.

const NONE: u32 = 0xffffffffu;
const INNER_POINTS: u32 = 6u;
const GRAVITY: f32 = 9.80665;

struct Batch {
    // Entries a slot in each table.
    footholds: u32,
    dynamics: u32,
    stance_forces: u32,
    momentum: u32,
    impulses: u32,
    reach: u32,
    reach_feet: u32,
    force_nodes: u32,
    swing_nodes: u32,
    strides: u32,
    elements: u32,
    runs: u32,
    steps: u32,
    rests: u32,
    gathers: u32,
    touches: u32,
    // Values a slot; those of the Jacobian in each of its two halves.
    values: u32,
    jacobian: u32,
    factor: u32,
    // Where each array begins in the values of a slot. Those marked 2 have two halves: at the point and at the trial point.
    x: u32,                 // 2 x [all]
    x_half: u32,
    initial: u32,           // [all]
    pull: u32,              // [variables]
    direction: u32,         // [variables]
    scaling: u32,           // [variables]
    diagonal: u32,          // [variables]
    gradient: u32,          // [variables]
    right_hand_side: u32,   // [variables]
    ground: u32,            // [footholds][3]
    deviations: u32,        // [intervals][6][6]
    c: u32,                 // 2 x [equalities]
    c_half: u32,
    c_change: u32,          // [equalities]
    g: u32,                 // 2 x [inequalities]
    g_half: u32,
    g_change: u32,          // [inequalities]
    weight: u32,            // [rows]
    value: u32,             // [rows]
    slack: u32,             // [inequalities]
    multiplier: u32,        // [inequalities]
    slack_step: u32,        // [inequalities]
    multiplier_step: u32,   // [inequalities]
    history: u32,           // [window]
    carry: u32,             // [rest][rest] and [rest]
    front: u32,             // the front where workgroup memory does not hold it
    flags: u32,             // [1]: 1 when the last factorisation failed
    // Settings of the solver.
    max_iterations: u32,
    stall_start: u32,       // NONE: no stall rule
    stall_window: u32,
    stall_budget: f32,
    tolerance: f32,
    barrier: f32,
    proximal_floor: f32,
    pull_weight: f32,
    closing: f32,
}

// Kinds of terrain.
const FLAT: u32 = 0u;
const BLOCK: u32 = 1u;
const STAIRS: u32 = 2u;
const GAP: u32 = 3u;
const SLOPE: u32 = 4u;
const CHIMNEY: u32 = 5u;
const CHIMNEY_LR: u32 = 6u;
const GRID: u32 = 7u;

struct Shape {
    kind: u32,
    // Of a grid: its samples along x and y, and where they begin in `heights`.
    rows: u32,
    columns: u32,
    first: u32,
    low: array<f32, 2>,
    per_metre: array<f32, 2>,
}

struct Constants {
    mass: f32,
    weight: f32,
    inertia: array<array<f32, 3>, 3>,
    inverse_inertia: array<array<f32, 3>, 3>,
    reach: array<f32, 3>,
    moment_scale: f32,
    balance_scale: f32,
    interval: f32,
    length_scale: f32,
    force_unit: f32,
    force_limit: f32,
    friction: f32,
    length_margin: f32,
    force_margin: f32,
}

struct MomentumPoint {
    time: f32,
    mean: f32,
    value: array<f32, 4>,
    rate: array<f32, 4>,
    integral: array<f32, 6>,
}

struct Slot {
    variables: u32,
    equalities: u32,
    rows: u32,
    inequalities: u32,
    footholds: u32,
    dynamics: u32,
    momentum: u32,
    reach: u32,
    force_nodes: u32,
    swing_nodes: u32,
    strides: u32,
    elements: u32,
    steps: u32,
    // 1: height rows of swings are two-sided.
    two_sided: u32,
    shape: Shape,
    constants: Constants,
    points: array<MomentumPoint, 7>,
}

// What the next trial point is for, or how the solve ended.
const STEP: u32 = 0u;
const CLOSE: u32 = 1u;
const EXACT: u32 = 2u;
const ENDED: u32 = 3u;
const SOLVED: u32 = 3u;
const MAX_ITERATIONS: u32 = 4u;
const STALLED: u32 = 5u;
const NON_FINITE: u32 = 6u;

struct Progress {
    state: u32,
    // Half in which the point is; the other one has the trial point.
    current: u32,
    iterations: u32,
    factorisations: u32,
    attempts: u32,
    recorded: u32,
    stall_from: u32,
    infeasibility: f32,
    mu: f32,
    pull: f32,
    eps: f32,
    closing_eps: f32,
    closing_below: f32,
    closing_from: f32,
    edge_radius: f32,
    length: f32,
}
