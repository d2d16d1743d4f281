// Index tables of a candidate. Twins: the structs of the same names in src/nlp/layout.rs and src/nlp/sweep.rs.

struct Span {
    start: u32,
    end: u32,
}

struct Run {
    variable: u32,
    slot: u32,
    column: u32,
    len: u32,
}

struct Place {
    row: u32,
    inequality: u32,
    jacobian: u32,
    stride: u32,
}

struct Element {
    family: u32,
    rows: u32,
    pairs: u32,
    place: Place,
    runs: Span,
}

struct BasePoint {
    reference: array<f32, 6>,
    weights: array<f32, 4>,
    variable: array<u32, 4>,
    slot: array<u32, 4>,
    interval: u32,
    deviation_weights: array<f32, 6>,
}

struct DynamicsInstant {
    reference: array<f32, 6>,
    rate: array<f32, 6>,
    weights: array<array<f32, 3>, 3>,
    variable: array<u32, 3>,
    column: array<u32, 3>,
    forces: Span,
    place: Place,
}

struct StanceForce {
    weights: array<array<f32, 2>, 2>,
    node: array<u32, 2>,
    node_column: array<u32, 2>,
    foothold: u32,
    foothold_column: u32,
}

struct MomentumInterval {
    reference: array<array<f32, 6>, 2>,
    rate: array<f32, 6>,
    variable: array<u32, 4>,
    linear_column: array<u32, 4>,
    angular_column: array<u32, 4>,
    impulses: Span,
    linear: Place,
    angular: Place,
}

struct Impulse {
    weights: array<array<array<f32, 2>, 3>, 7>,
    node: u32,
    linear_column: u32,
    angular_column: u32,
    foothold: u32,
    foothold_column: u32,
}

struct ReachInstant {
    base: BasePoint,
    feet: Span,
}

struct ReachFoot {
    nominal: array<f32, 3>,
    xy_weights: array<f32, 2>,
    z_weights: array<f32, 3>,
    foothold: array<u32, 2>,
    height: u32,
    base_column: array<u32, 4>,
    foothold_column: array<u32, 2>,
    height_column: u32,
    slot: array<u32, 3>,
    place: Place,
}

struct ForceNode {
    node: u32,
    node_column: u32,
    slope_weight: f32,
    foothold: u32,
    foothold_column: u32,
    place: Place,
}

struct SwingNode {
    xy_weights: array<f32, 2>,
    z_weights: array<f32, 3>,
    low: f32,
    high: f32,
    height: u32,
    height_column: u32,
    foothold: array<u32, 2>,
    foothold_column: array<u32, 2>,
    place: Place,
}

struct Stride {
    limit: f32,
    foothold: array<u32, 2>,
    foothold_column: array<u32, 2>,
    place: Place,
}

struct FrontStep {
    size: u32,
    pivots: u32,
    variable: u32,
    factor: u32,
    stride: u32,
    elements: Span,
    reach: Span,
    rest: Span,
}

// A variable that stays in the front of a step: its number, and its slot in the next front.
struct Rest {
    variable: u32,
    slot: u32,
}

// The elements that touch one variable, and how far it stands behind the first variable of its block.
struct Gather {
    touches: Span,
    offset: u32,
}

// An element that touches a block, and the column of the block's first variable.
struct Touch {
    element: u32,
    column: u32,
}
