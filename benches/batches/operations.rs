//! Operations of each shader per round and candidate, counted by running its twin with a counting scalar. The twin of the factorisation
//! uses a different algorithm, so that shader's operations are computed from the loops of `front.wgsl`.

use crate::counted::{Counted, Operations, counted};
use cregopt::backend::gpu::shaders::{PANEL_ROWS, Shader, WORKGROUP};
use cregopt::backend::tables::{ShaderTables, TILE};
use cregopt::gait::AlignedSchedule;
use cregopt::linear::NormalEquations;
use cregopt::linear::forward::forward;
use cregopt::linear::front::{Factor, factorise};
use cregopt::linear::product::jacobian_times;
use cregopt::linear::substitute::substitute;
use cregopt::linear::transposed::transposed_times;
use cregopt::nlp::Problem;
use cregopt::rows::{
    self, Shared, acceleration::acceleration, cone::cone, dynamics::dynamics, footing::footing, force::force, ground::ground,
    momentum::momentum, reach::reach, stride::stride, swing::swing,
};
use cregopt::search::evaluate::LowerSettings;
use cregopt::solver::advance::{add, advance};
use cregopt::solver::control::Limits;
use cregopt::solver::correct::correct;
use cregopt::solver::judge::{infeasibility, merit_falls, nonlinearity, smoothing_fall, update_slacks};
use cregopt::solver::slacks::{BarrierTarget, Lengths, Slacks, slack_steps};
use cregopt::solver::start::{column_scaling, start_slacks};
use cregopt::solver::weights::{barrier_rows, variable_terms};
use cregopt::task::Task;

type Values = Vec<Counted>;

/// Operations of the shaders in the first round of a solve, a barrier step, in the order of [`Shader::ALL`]. Substitution and product,
/// which a round dispatches twice, are counted once.
pub fn of_round(task: &Task, schedule: &AlignedSchedule, settings: &LowerSettings) -> Vec<Operations> {
    let problem = Problem::<Counted>::new(task, schedule, &settings.transcription);
    let limits = Limits::<Counted>::new(&settings.solver, settings.transcription.rows);
    let progress = limits.first_progress(&settings.solver, &problem);
    let radius = progress.edge_radius;
    let zeros = |n: usize| -> Values { vec![Counted::default(); n] };
    let (variables, [equalities, inequalities]) = (problem.variables, [problem.rows.one_sided(), problem.inequalities]);
    let mut of = vec![Operations::default(); Shader::ALL.len()];
    let mut shader = |shader: Shader, call: &mut dyn FnMut()| of[shader as usize] += counted(call);

    let x = problem.initial.clone();
    let (mut c, mut g, mut jacobian) = (zeros(equalities), zeros(inequalities), zeros(problem.jacobian_len));
    let mut shared = Shared::default();
    shared.resize(&problem);
    rows::residuals(&problem, &x, radius, &mut shared, &mut c, &mut g, Some(&mut jacobian));
    let Shared { ground: under, deviations, .. } = &mut shared;
    let (mut scaling, mut slacks) = (zeros(variables), Slacks::default());
    slacks.slack = zeros(inequalities);
    slacks.multiplier = zeros(inequalities);
    slacks.slack_step = zeros(inequalities);
    slacks.multiplier_step = zeros(inequalities);
    let (mut counts, mut local) = (zeros(problem.rows.all()), zeros(problem.widest));
    shader(Shader::Start, &mut || column_scaling(&problem, &jacobian, &mut counts, &mut local, &mut scaling));
    shader(Shader::Start, &mut || start_slacks(&g, progress.mu, &mut slacks));

    let (mut weight, mut value) = (zeros(problem.rows.all()), zeros(problem.rows.all()));
    let (mut diagonal, mut gradient) = (zeros(variables), zeros(variables));
    shader(Shader::Weights, &mut || {
        infeasibility(&c, &g);
    });
    shader(Shader::Weights, &mut || barrier_rows(&problem, &c, &g, &slacks, BarrierTarget::predictor(), &mut weight, &mut value));
    shader(Shader::Weights, &mut || {
        let eps = progress.proximal();
        variable_terms(&problem, &scaling, eps, limits.smoothing, &x, &mut diagonal, &mut gradient);
    });

    let mut factor = Factor::default();
    factor.resize(&problem);
    let system = NormalEquations { jacobian: &jacobian, weight: &weight, value: &value, diagonal: &diagonal, gradient: &gradient };
    assert!(factorise(&problem, &system, &mut factor), "the first factorisation of a solve");
    let mut direction = zeros(variables);
    let (mut c_change, mut g_change) = (zeros(equalities), zeros(inequalities));
    shader(Shader::Substitute, &mut || substitute(&problem, &mut factor, &mut direction));
    shader(Shader::Product, &mut || jacobian_times(&problem, &jacobian, &direction, &mut local, &mut c_change, &mut g_change));
    let mut mu = Counted::default();
    shader(Shader::Correct, &mut || {
        mu = correct(&problem, &c, &g, &g_change, &mut slacks, progress.barrier_floor, [&mut weight, &mut value])
    });
    let mut right = zeros(variables);
    shader(Shader::Transposed, &mut || {
        transposed_times(&problem, &jacobian, &value, &mut local, &mut right);
        add(&mut right, &gradient);
    });
    shader(Shader::Forward, &mut || forward(&problem, &mut factor, &mut right));
    let (mut trial, mut c_linear, mut g_linear) = (x.clone(), zeros(equalities), zeros(inequalities));
    let mut lengths = Lengths::whole();
    shader(Shader::Advance, &mut || {
        lengths = slack_steps(&g, &g_change, BarrierTarget::corrector(mu), &mut slacks);
        advance(&x[..variables], lengths.primal, &direction, &mut trial[..variables]);
    });

    let (mut c_to, mut g_to) = (zeros(equalities), zeros(inequalities));
    let (to, mut into) = (&trial, jacobian.clone());
    shader(Shader::Ground, &mut || ground(&problem, to, under));
    shader(Shader::Dynamics, &mut || dynamics(&problem, to, under, &mut c_to, Some(&mut into)));
    shader(Shader::Momentum, &mut || momentum(&problem, to, under, deviations, false, &mut c_to, Some(&mut into)));
    shader(Shader::Reach, &mut || reach(&problem, to, under, deviations, &mut g_to, Some(&mut into)));
    shader(Shader::Force, &mut || force(&problem, to, radius, &mut g_to, Some(&mut into)));
    shader(Shader::Swing, &mut || swing(&problem, to, under, &mut g_to, Some(&mut into)));
    shader(Shader::Stride, &mut || stride(&problem, to, &mut g_to, Some(&mut into)));
    shader(Shader::Acceleration, &mut || acceleration(&problem, to, under, &mut g_to, Some(&mut into)));
    shader(Shader::Cone, &mut || cone(&problem, to, radius, &mut g_to, Some(&mut into)));
    shader(Shader::Footing, &mut || footing(&problem, to, &mut g_to, Some(&mut into)));

    shader(Shader::Judge, &mut || {
        // The shader extrapolates the residuals at this point.
        advance(&c, lengths.primal, &c_change, &mut c_linear);
        advance(&g, lengths.primal, &g_change, &mut g_linear);
        merit_falls(&c, &g, [(&c_to, &g_to), (&c_linear, &g_linear)], mu);
        nonlinearity(&c_to, &c_linear, &g_to, &g_linear);
        smoothing_fall(&problem.smoothing, &x, &trial, &problem.initial);
        update_slacks(&mut slacks, lengths);
    });
    let problem = Problem::<f32>::new(task, schedule, &settings.transcription);
    of[Shader::Front as usize] = front(&ShaderTables::of(&problem));
    of
}

/// Operations of `add_products` in `front.wgsl` on all tiles of a front: sixteen products and sums per row, one addition per value.
fn products(tiles: u64, rows: u64) -> u64 {
    tiles * (tiles + 1) / 2 * (32 * rows + 32)
}

/// Operations of `front.wgsl` if all pivots are positive, no row has weight 0, and rows touch all columns.
fn front(own: &ShaderTables) -> Operations {
    let mut of = Operations::default();
    let tile = TILE as u64;
    for step in &own.front_steps {
        let (size, pivots) = (u64::from(step.size), u64::from(step.pivots));
        let tiles = size / tile + 1;
        let rows = &own.front_rows[step.rows.range()];
        for together in rows.chunks(PANEL_ROWS[0] as usize) {
            of.simple += together.iter().map(|row| 2 * u64::from(row.columns.end - row.columns.start) + 1).sum::<u64>();
            of.special += 2 * together.len() as u64;
            of.simple += products(tiles, together.len() as u64);
        }
        of.simple += 2 * pivots;
        for p in (0..pivots).step_by(TILE) {
            let count = (pivots - p).min(tile);
            // Each invocation factorises the four by four block on the diagonal, then computes one column of the panel.
            of.simple += u64::from(WORKGROUP) * 26 + (size + 1 - p) * 16;
            of.special += u64::from(WORKGROUP) * 2 * count;
            of.simple += products(tiles - (p + count) / tile, tile);
        }
    }
    of
}
