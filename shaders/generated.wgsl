// Generated: constants, structs and table readers that precede the shaders, see `generated` of src/backend/gpu/shaders.rs. The
// program does not read this file. To write it:
// WRITE_GENERATED=1 cargo test --test library the_file_of_generated_declarations_is_up_to_date

const NONE: u32 = 4294967295u;
const INNER_POINTS: u32 = 6u;
const MOMENTUM_POINTS: u32 = 7u;
const POSE: u32 = 6u;
const POSE_BLOCKS: u32 = 4u;
const OWN_BLOCKS: u32 = 3u;
const FACTORED_ROWS: u32 = 3u;
const FACTORED_PAIRS: u32 = 3u;
const FORCE_ROWS: u32 = 5u;
const RING_POINTS: u32 = 8u;
const TURN_YAW: u32 = 5u;
const FLAT: u32 = 0u;
const BLOCK: u32 = 1u;
const STAIRS: u32 = 2u;
const GAP: u32 = 3u;
const SLOPE: u32 = 4u;
const CHIMNEY: u32 = 5u;
const CHIMNEY_LR: u32 = 6u;
const GRID: u32 = 7u;
const STEP: u32 = 0u;
const CLOSE: u32 = 1u;
const EXACT: u32 = 2u;
const SHORTER: u32 = 3u;
const ENDED: u32 = 4u;
const SOLVED: u32 = 4u;
const MAX_ITERATIONS: u32 = 5u;
const STALLED: u32 = 6u;
const TERMINATED_EARLY: u32 = 8u;
const STEPS_REFUSED: u32 = 9u;
const NON_FINITE: u32 = 7u;
const SOLVE: u32 = 0u;
const MINIMISE: u32 = 1u;
const RESTORE_NEXT: u32 = 2u;
const RESTORE: u32 = 3u;
const REVERT: u32 = 4u;
const SHORTENINGS: u32 = 2u;
const REACH_DOUBLINGS: u32 = 2u;
const ATTEMPTS: u32 = 8u;
const EARLY_TERMINATION_FROM: u32 = 2u;
const EARLY_TERMINATION_TO: u32 = 15u;
const EARLY_TERMINATION_KNEE: u32 = 4u;
const EARLY_TERMINATION_LATE_KNEE: u32 = 7u;
const FRONT_COLUMN_BITS: u32 = 12u;
const FACTORED: u32 = 3u;
const EQUALITY: u32 = 0u;
const COST: u32 = 1u;
const INEQUALITY: u32 = 2u;
const ACCELERATION_MARGIN: f32 = 0.002f;
const GRAVITY: f32 = 9.80665f;
const STEEP_COSINE: f32 = 0.1f;
const TURN_MARGIN: f32 = 0.001f;
const LEAST_LEG: f32 = 1e-6f;
const FREE_SHARE: f32 = 0.93f;
const LEAST_BEND: f32 = 0.0025f;
const INNER_RING: f32 = 0.6f;
const INNER_LIFT: f32 = 0.2f;
const OUTER_RING: f32 = 0.96f;
const OUTER_LIFT: f32 = 0.72f;
const CLOSING_RATE: f32 = 0.1f;
const CLOSING_AGAIN: f32 = 0.1f;
const NEAR_LINEAR: f32 = 0.3f;
const NEAR_LINEAR_FLOOR: f32 = 0.05f;
const GOOD_RATIO: f32 = 0.7f;
const POOR_RATIO: f32 = 0.25f;
const MINIMISE_POOR_RATIO: f32 = 0.5f;
const MINIMISE_POOR_FACTOR: f32 = 4.0f;
const BARRIER_PER_FALL: f32 = 2.0f;
const LARGEST_BARRIER_FLOOR: f32 = 3e-7f;
const GOOD_DIVISOR: f32 = 4.0f;
const POOR_FACTOR: f32 = 2.0f;
const SHORTENING: f32 = 0.25f;
const STALL_TARGET: f32 = 1e-6f;
const STALL_ABOVE: f32 = 1e-5f;
const TRUSTED_LENGTH: f32 = 0.5f;
const PROXIMAL_GROWTH: f32 = 6.0f;
const CLOSING_GROWTH: f32 = 36.0f;
const BARRIER_FLOOR: f32 = 1e-9f;
const SLACK_FLOOR: f32 = 1e-6f;
const CLOSING_REACH: f32 = 3.0f;
const LARGEST_CLOSING_REACH: f32 = 0.0001f;
const FRACTION_TO_THE_BOUNDARY: f32 = 0.99f;
const MULTIPLIER_FLOOR: f32 = 1e-8f;
const SCALING_FLOOR: f32 = 0.01f;
const BLOCK_START: f32 = 0.7f;
const BLOCK_TOP: f32 = 0.73f;
const BLOCK_END: f32 = 4.2f;
const BLOCK_HEIGHT: f32 = 0.5f;
const BLOCK_SLOPE: f32 = 16.666666f;
const STAIRS_START: f32 = 1.0f;
const STAIRS_TOP: f32 = 1.4f;
const STAIRS_END: f32 = 2.4f;
const STAIRS_FIRST_HEIGHT: f32 = 0.2f;
const STAIRS_HEIGHT: f32 = 0.4f;
const GAP_START: f32 = 1.0f;
const GAP_END: f32 = 1.6f;
const GAP_MIDDLE: f32 = 1.3f;
const GAP_DEPTH: f32 = 1.5f;
const GAP_BEND: f32 = 16.666666f;
const SLOPE_START: f32 = 1.0f;
const SLOPE_TOP: f32 = 2.0f;
const SLOPE_END: f32 = 3.0f;
const SLOPE_RISE: f32 = 0.7f;
const CHIMNEY_START: f32 = 1.0f;
const CHIMNEY_END: f32 = 2.5f;
const CHIMNEY_SLOPE: f32 = 3.0f;
const CHIMNEY_Y: f32 = 0.5f;
const CHIMNEY_LR_START: f32 = 0.5f;
const CHIMNEY_LR_MIDDLE: f32 = 1.5f;
const CHIMNEY_LR_END: f32 = 2.5f;
const CHIMNEY_LR_SLOPE: f32 = 2.0f;
const CHIMNEY_LR_Y: f32 = 0.5f;

struct Batch {
    footholds: u32,
    dynamics_instants: u32,
    stance_forces: u32,
    momentum_intervals: u32,
    impulses: u32,
    reach_instants: u32,
    reach_feet: u32,
    reach_legs: u32,
    force_nodes: u32,
    swing_nodes: u32,
    strides: u32,
    accelerations: u32,
    cones: u32,
    footings: u32,
    sole_points: u32,
    turns: u32,
    periodics: u32,
    cone_curvatures: u32,
    efforts: u32,
    stance_powers: u32,
    swing_powers: u32,
    goals: u32,
    joint_torques: u32,
    joint_speeds: u32,
    base_blocks: u32,
    factored_instants: u32,
    factored_elements: u32,
    factored_own: u32,
    elements: u32,
    runs: u32,
    front_steps: u32,
    rests: u32,
    front_rows: u32,
    front_columns: u32,
    gather_of: u32,
    gathers: u32,
    touches: u32,
    factored_touches: u32,
    first_elements: u32,
    first_runs: u32,
    first_front_steps: u32,
    first_rests: u32,
    first_front_rows: u32,
    first_front_columns: u32,
    first_base_blocks: u32,
    first_factored_instants: u32,
    first_factored_elements: u32,
    first_factored_own: u32,
    first_reach_instants: u32,
    first_reach_feet: u32,
    first_reach_legs: u32,
    first_gather_of: u32,
    first_gathers: u32,
    first_touches: u32,
    first_factored_touches: u32,
    values: u32,
    jacobian: u32,
    factor: u32,
    x: u32,
    x_half: u32,
    initial: u32,
    smoothing: u32,
    direction: u32,
    scaling: u32,
    diagonal: u32,
    gradient: u32,
    right_hand_side: u32,
    ground: u32,
    deviations: u32,
    c: u32,
    c_half: u32,
    c_change: u32,
    g: u32,
    g_half: u32,
    g_change: u32,
    weight: u32,
    value: u32,
    slack: u32,
    multiplier: u32,
    slack_step: u32,
    multiplier_step: u32,
    cost_weights: u32,
    shift_c: u32,
    shift_g: u32,
    solved: u32,
    history: u32,
    carry: u32,
    front: u32,
    tiles: u32,
    flags: u32,
    max_iterations: u32,
    stall_start: u32,
    stall_window: u32,
    stall_budget: f32,
    tolerance: f32,
    proximal_floor: f32,
    smoothing_weight: f32,
    closing: f32,
    minimise_barrier: f32,
    restore_barrier: f32,
    minimise_smoothing: f32,
    cost_weight: f32,
    rounding: f32,
    rounding_floor: f32,
    minimise_tolerance: f32,
    cost_limit: f32,
}

struct Part {
    first: u32,
    last: u32,
}

struct RowCounts {
    equalities: u32,
    costs: u32,
    inequalities: u32,
}

struct FirstRows {
    row: u32,
    inequality: u32,
}

struct Shape {
    kind: u32,
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
    moment_scale: f32,
    balance_scale: f32,
    interval: f32,
    length_scale: f32,
    force_unit: f32,
    force_limit: f32,
    friction: f32,
    length_margin: f32,
    force_margin: f32,
    foot_radius: f32,
    ball_radius: f32,
    foot_acceleration: f32,
    pressure: array<f32, 2>,
    torsion: f32,
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
    rows: RowCounts,
    inequalities: u32,
    first_factored: FirstRows,
    early_termination_rates: array<f32, 3>,
    footholds: u32,
    dynamics_instants: u32,
    stance_forces: u32,
    momentum_intervals: u32,
    impulses: u32,
    reach_instants: u32,
    reach_feet: u32,
    reach_legs: u32,
    force_nodes: u32,
    swing_nodes: u32,
    strides: u32,
    accelerations: u32,
    cones: u32,
    footings: u32,
    sole_points: u32,
    turns: u32,
    periodics: u32,
    cone_curvatures: u32,
    efforts: u32,
    stance_powers: u32,
    swing_powers: u32,
    goals: u32,
    joint_torques: u32,
    joint_speeds: u32,
    base_blocks: u32,
    factored_instants: u32,
    factored_elements: u32,
    factored_own: u32,
    elements: u32,
    runs: u32,
    front_steps: u32,
    rests: u32,
    front_rows: u32,
    front_columns: u32,
    gather_of: u32,
    gathers: u32,
    touches: u32,
    factored_touches: u32,
    shape: Shape,
    constants: Constants,
    points: array<MomentumPoint, 7>,
}

struct Progress {
    state: u32,
    current: u32,
    iterations: u32,
    factorisations: u32,
    attempts: u32,
    recorded: u32,
    stall_from: u32,
    phase: u32,
    minimise_iterations: u32,
    minimise_until: u32,
    infeasibility: f32,
    mu: f32,
    barrier_floor: f32,
    barrier: f32,
    smoothing: f32,
    eps: f32,
    closing_eps: f32,
    closing_below: f32,
    closing_from: f32,
    edge_radius: f32,
    early_termination_limit: f32,
    length: f32,
    dual_length: f32,
    rounding: f32,
    solved_infeasibility: f32,
}

struct Span {
    start: u32,
    end: u32,
}

struct Place {
    row: u32,
    inequality: u32,
    jacobian: u32,
    stride: u32,
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
    moments: Span,
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
    reference: array<f32, 6>,
    deviation_weights: array<f32, 6>,
}

struct ReachFoot {
    xy_weights: array<f32, 2>,
    z_weights: array<f32, 3>,
    leg: u32,
}

struct ReachLeg {
    center: array<f32, 3>,
    half_widths: array<f32, 3>,
    normals: array<array<f32, 3>, 3>,
    foothold: array<u32, 2>,
    offset: array<f32, 3>,
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
    offset: array<f32, 3>,
    low: f32,
    high: f32,
    two_sided: u32,
    upper: u32,
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

struct Acceleration {
    by_step: f32,
    by_height: f32,
    height: u32,
    height_column: u32,
    foothold: array<u32, 2>,
    foothold_column: array<u32, 2>,
    place: Place,
}

struct Footing {
    low: array<f32, 2>,
    high: array<f32, 2>,
    foothold: u32,
    foothold_column: u32,
    place: Place,
}

struct SolePoint {
    slope_weight: f32,
    node: array<u32, 2>,
    node_column: array<u32, 2>,
    yaw: u32,
    yaw_column: u32,
    foothold: u32,
    place: Place,
}

struct Turn {
    weights: array<f32, 4>,
    reference: f32,
    limit: f32,
    base: array<u32, 4>,
    base_column: array<u32, 4>,
    yaw: u32,
    yaw_column: u32,
    place: Place,
}

struct Periodic {
    difference: f32,
    component: u32,
    variable: array<u32, 2>,
    column: array<u32, 2>,
    place: Place,
}

struct Effort {
    factor: array<array<f32, 4>, 2>,
    node: array<u32, 2>,
    column: array<u32, 2>,
    place: Place,
}

struct HipPoint {
    reference: array<f32, 6>,
    value: array<f32, 4>,
    rate: array<f32, 4>,
    deviation: array<f32, 6>,
    deviation_rate: array<f32, 6>,
    interval: u32,
    column: array<u32, 4>,
    hip: array<f32, 2>,
}

struct StancePower {
    base: HipPoint,
    stance: StanceForce,
    place: Place,
}

struct SwingMotion {
    xy_weights: array<array<f32, 2>, 2>,
    z_weights: array<array<f32, 3>, 2>,
    offset: array<array<f32, 3>, 2>,
    height: u32,
    height_column: u32,
    foothold: array<u32, 2>,
    foothold_column: array<u32, 2>,
}

struct SwingPower {
    base: HipPoint,
    foot: SwingMotion,
    place: Place,
}

struct Goal {
    weight: array<f32, 6>,
    desired: array<f32, 6>,
    variable: u32,
    column: u32,
    place: Place,
}

struct JointLeg {
    anchor: array<f32, 3>,
    axis: array<f32, 3>,
    across: array<f32, 3>,
    second: array<f32, 2>,
    offset: f32,
    arm: array<f32, 3>,
    links: array<f32, 2>,
    sides: array<f32, 2>,
    radius: f32,
    per_torque: array<f32, 3>,
    per_speed: array<f32, 3>,
}

struct JointTorque {
    base: HipPoint,
    stance: StanceForce,
    leg: JointLeg,
    weight: f32,
    place: Place,
}

struct JointSpeed {
    base: HipPoint,
    foot: SwingMotion,
    leg: JointLeg,
    weight: f32,
    place: Place,
}

struct BaseBlocks {
    variable: array<u32, 4>,
    front: array<u32, 4>,
    interval: u32,
}

struct FactoredInstant {
    weights: array<f32, 4>,
    blocks: u32,
    elements: Span,
}

struct FactoredElement {
    own: u32,
    jacobian: u32,
    stride: u32,
}

struct Run {
    variable: u32,
    front: u32,
    column: u32,
    len: u32,
}

struct OwnColumns {
    runs: array<Run, 3>,
}

struct Element {
    family: u32,
    rows: u32,
    pairs: u32,
    place: Place,
    runs: Span,
}

struct FrontStep {
    size: u32,
    pivots: u32,
    variable: u32,
    factor: u32,
    stride: u32,
    rows: Span,
    rest: Span,
}

struct Rest {
    variable: u32,
    next: u32,
}

struct FrontRow {
    row: u32,
    jacobian: u32,
    columns: Span,
    instant: u32,
}

struct Gather {
    variable: u32,
    touches: Span,
    factored: Span,
}

struct Touch {
    element: u32,
    column: u32,
}

struct FactoredTouch {
    instants: Span,
    own: u32,
    block: u32,
    column: u32,
}

fn elements_at(slot: u32, i: u32) -> Element {
    let at = batch.first_elements + (slot * batch.elements + i) * 9u;
    return Element(tables[at + 0u], tables[at + 1u], tables[at + 2u], Place(tables[at + 3u], tables[at + 4u], tables[at + 5u], tables[at + 6u]), Span(tables[at + 7u], tables[at + 8u]));
}

fn runs_at(slot: u32, i: u32) -> Run {
    let at = batch.first_runs + (slot * batch.runs + i) * 4u;
    return Run(tables[at + 0u], tables[at + 1u], tables[at + 2u], tables[at + 3u]);
}

fn front_steps_at(slot: u32, i: u32) -> FrontStep {
    let at = batch.first_front_steps + (slot * batch.front_steps + i) * 9u;
    return FrontStep(tables[at + 0u], tables[at + 1u], tables[at + 2u], tables[at + 3u], tables[at + 4u], Span(tables[at + 5u], tables[at + 6u]), Span(tables[at + 7u], tables[at + 8u]));
}

fn rests_at(slot: u32, i: u32) -> Rest {
    let at = batch.first_rests + (slot * batch.rests + i) * 2u;
    return Rest(tables[at + 0u], tables[at + 1u]);
}

fn front_rows_at(slot: u32, i: u32) -> FrontRow {
    let at = batch.first_front_rows + (slot * batch.front_rows + i) * 5u;
    return FrontRow(tables[at + 0u], tables[at + 1u], Span(tables[at + 2u], tables[at + 3u]), tables[at + 4u]);
}

fn front_columns_at(slot: u32, i: u32) -> u32 {
    let at = batch.first_front_columns + (slot * batch.front_columns + i) * 1u;
    return tables[at + 0u];
}

fn base_blocks_at(slot: u32, i: u32) -> BaseBlocks {
    let at = batch.first_base_blocks + (slot * batch.base_blocks + i) * 9u;
    return BaseBlocks(array<u32, 4>(tables[at + 0u], tables[at + 1u], tables[at + 2u], tables[at + 3u]), array<u32, 4>(tables[at + 4u], tables[at + 5u], tables[at + 6u], tables[at + 7u]), tables[at + 8u]);
}

fn base_blocks_variable(slot: u32, i: u32, k: u32) -> u32 {
    let at = batch.first_base_blocks + (slot * batch.base_blocks + i) * 9u + 1u * k;
    return tables[at + 0u];
}

fn base_blocks_front(slot: u32, i: u32, k: u32) -> u32 {
    let at = batch.first_base_blocks + (slot * batch.base_blocks + i) * 9u + 1u * k;
    return tables[at + 4u];
}

fn factored_instants_at(slot: u32, i: u32) -> FactoredInstant {
    let at = batch.first_factored_instants + (slot * batch.factored_instants + i) * 7u;
    return FactoredInstant(array<f32, 4>(bitcast<f32>(tables[at + 0u]), bitcast<f32>(tables[at + 1u]), bitcast<f32>(tables[at + 2u]), bitcast<f32>(tables[at + 3u])), tables[at + 4u], Span(tables[at + 5u], tables[at + 6u]));
}

fn factored_instants_weights(slot: u32, i: u32, k: u32) -> f32 {
    let at = batch.first_factored_instants + (slot * batch.factored_instants + i) * 7u + 1u * k;
    return bitcast<f32>(tables[at + 0u]);
}

fn factored_elements_at(slot: u32, i: u32) -> FactoredElement {
    let at = batch.first_factored_elements + (slot * batch.factored_elements + i) * 3u;
    return FactoredElement(tables[at + 0u], tables[at + 1u], tables[at + 2u]);
}

fn factored_own_at(slot: u32, i: u32) -> OwnColumns {
    let at = batch.first_factored_own + (slot * batch.factored_own + i) * 12u;
    return OwnColumns(array<Run, 3>(Run(tables[at + 0u], tables[at + 1u], tables[at + 2u], tables[at + 3u]), Run(tables[at + 4u], tables[at + 5u], tables[at + 6u], tables[at + 7u]), Run(tables[at + 8u], tables[at + 9u], tables[at + 10u], tables[at + 11u])));
}

fn factored_own_runs(slot: u32, i: u32, k: u32) -> Run {
    let at = batch.first_factored_own + (slot * batch.factored_own + i) * 12u + 4u * k;
    return Run(tables[at + 0u], tables[at + 1u], tables[at + 2u], tables[at + 3u]);
}

fn reach_instants_at(slot: u32, i: u32) -> ReachInstant {
    let at = batch.first_reach_instants + (slot * batch.reach_instants + i) * 12u;
    return ReachInstant(array<f32, 6>(bitcast<f32>(tables[at + 0u]), bitcast<f32>(tables[at + 1u]), bitcast<f32>(tables[at + 2u]), bitcast<f32>(tables[at + 3u]), bitcast<f32>(tables[at + 4u]), bitcast<f32>(tables[at + 5u])), array<f32, 6>(bitcast<f32>(tables[at + 6u]), bitcast<f32>(tables[at + 7u]), bitcast<f32>(tables[at + 8u]), bitcast<f32>(tables[at + 9u]), bitcast<f32>(tables[at + 10u]), bitcast<f32>(tables[at + 11u])));
}

fn reach_instants_reference(slot: u32, i: u32, k: u32) -> f32 {
    let at = batch.first_reach_instants + (slot * batch.reach_instants + i) * 12u + 1u * k;
    return bitcast<f32>(tables[at + 0u]);
}

fn reach_instants_deviation_weights(slot: u32, i: u32, k: u32) -> f32 {
    let at = batch.first_reach_instants + (slot * batch.reach_instants + i) * 12u + 1u * k;
    return bitcast<f32>(tables[at + 6u]);
}

fn reach_feet_at(slot: u32, i: u32) -> ReachFoot {
    let at = batch.first_reach_feet + (slot * batch.reach_feet + i) * 6u;
    return ReachFoot(array<f32, 2>(bitcast<f32>(tables[at + 0u]), bitcast<f32>(tables[at + 1u])), array<f32, 3>(bitcast<f32>(tables[at + 2u]), bitcast<f32>(tables[at + 3u]), bitcast<f32>(tables[at + 4u])), tables[at + 5u]);
}

fn reach_feet_xy_weights(slot: u32, i: u32, k: u32) -> f32 {
    let at = batch.first_reach_feet + (slot * batch.reach_feet + i) * 6u + 1u * k;
    return bitcast<f32>(tables[at + 0u]);
}

fn reach_feet_z_weights(slot: u32, i: u32, k: u32) -> f32 {
    let at = batch.first_reach_feet + (slot * batch.reach_feet + i) * 6u + 1u * k;
    return bitcast<f32>(tables[at + 2u]);
}

fn reach_legs_at(slot: u32, i: u32) -> ReachLeg {
    let at = batch.first_reach_legs + (slot * batch.reach_legs + i) * 20u;
    return ReachLeg(array<f32, 3>(bitcast<f32>(tables[at + 0u]), bitcast<f32>(tables[at + 1u]), bitcast<f32>(tables[at + 2u])), array<f32, 3>(bitcast<f32>(tables[at + 3u]), bitcast<f32>(tables[at + 4u]), bitcast<f32>(tables[at + 5u])), array<array<f32, 3>, 3>(array<f32, 3>(bitcast<f32>(tables[at + 6u]), bitcast<f32>(tables[at + 7u]), bitcast<f32>(tables[at + 8u])), array<f32, 3>(bitcast<f32>(tables[at + 9u]), bitcast<f32>(tables[at + 10u]), bitcast<f32>(tables[at + 11u])), array<f32, 3>(bitcast<f32>(tables[at + 12u]), bitcast<f32>(tables[at + 13u]), bitcast<f32>(tables[at + 14u]))), array<u32, 2>(tables[at + 15u], tables[at + 16u]), array<f32, 3>(bitcast<f32>(tables[at + 17u]), bitcast<f32>(tables[at + 18u]), bitcast<f32>(tables[at + 19u])));
}

fn reach_legs_center(slot: u32, i: u32, k: u32) -> f32 {
    let at = batch.first_reach_legs + (slot * batch.reach_legs + i) * 20u + 1u * k;
    return bitcast<f32>(tables[at + 0u]);
}

fn reach_legs_half_widths(slot: u32, i: u32, k: u32) -> f32 {
    let at = batch.first_reach_legs + (slot * batch.reach_legs + i) * 20u + 1u * k;
    return bitcast<f32>(tables[at + 3u]);
}

fn reach_legs_normals(slot: u32, i: u32, k: u32) -> array<f32, 3> {
    let at = batch.first_reach_legs + (slot * batch.reach_legs + i) * 20u + 3u * k;
    return array<f32, 3>(bitcast<f32>(tables[at + 6u]), bitcast<f32>(tables[at + 7u]), bitcast<f32>(tables[at + 8u]));
}

fn reach_legs_foothold(slot: u32, i: u32, k: u32) -> u32 {
    let at = batch.first_reach_legs + (slot * batch.reach_legs + i) * 20u + 1u * k;
    return tables[at + 15u];
}

fn reach_legs_offset(slot: u32, i: u32, k: u32) -> f32 {
    let at = batch.first_reach_legs + (slot * batch.reach_legs + i) * 20u + 1u * k;
    return bitcast<f32>(tables[at + 17u]);
}

fn gather_of_at(slot: u32, i: u32) -> u32 {
    let at = batch.first_gather_of + (slot * batch.gather_of + i) * 1u;
    return tables[at + 0u];
}

fn gathers_at(slot: u32, i: u32) -> Gather {
    let at = batch.first_gathers + (slot * batch.gathers + i) * 5u;
    return Gather(tables[at + 0u], Span(tables[at + 1u], tables[at + 2u]), Span(tables[at + 3u], tables[at + 4u]));
}

fn touches_at(slot: u32, i: u32) -> Touch {
    let at = batch.first_touches + (slot * batch.touches + i) * 2u;
    return Touch(tables[at + 0u], tables[at + 1u]);
}

fn factored_touches_at(slot: u32, i: u32) -> FactoredTouch {
    let at = batch.first_factored_touches + (slot * batch.factored_touches + i) * 5u;
    return FactoredTouch(Span(tables[at + 0u], tables[at + 1u]), tables[at + 2u], tables[at + 3u], tables[at + 4u]);
}
