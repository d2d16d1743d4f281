//! The C interface of Ipopt.

use super::nlp::{Nlp, Options, Pattern, Rows, Statistics};
use crate::backend::locked;
use std::ffi::{CStr, c_char, c_int, c_void};
use std::sync::Mutex;
use std::time::Instant;

type Bool = c_int;
type EvalF = extern "C" fn(c_int, *const f64, Bool, *mut f64, *mut c_void) -> Bool;
type EvalGradF = extern "C" fn(c_int, *const f64, Bool, *mut f64, *mut c_void) -> Bool;
type EvalG = extern "C" fn(c_int, *const f64, Bool, c_int, *mut f64, *mut c_void) -> Bool;
type EvalJacG = extern "C" fn(c_int, *const f64, Bool, c_int, c_int, *mut c_int, *mut c_int, *mut f64, *mut c_void) -> Bool;
type EvalH =
    extern "C" fn(c_int, *const f64, Bool, f64, c_int, *const f64, Bool, c_int, *mut c_int, *mut c_int, *mut f64, *mut c_void) -> Bool;
type Intermediate = extern "C" fn(c_int, c_int, f64, f64, f64, f64, f64, f64, f64, f64, c_int, *mut c_void) -> Bool;

unsafe extern "C" {
    fn CreateIpoptProblem(
        n: c_int,
        x_l: *const f64,
        x_u: *const f64,
        m: c_int,
        g_l: *const f64,
        g_u: *const f64,
        nele_jac: c_int,
        nele_hess: c_int,
        index_style: c_int,
        eval_f: EvalF,
        eval_g: EvalG,
        eval_grad_f: EvalGradF,
        eval_jac_g: EvalJacG,
        eval_h: EvalH,
    ) -> *mut c_void;
    fn FreeIpoptProblem(problem: *mut c_void);
    // The results are ignored: they are `int` before 3.14 and `bool` since then.
    fn AddIpoptStrOption(problem: *mut c_void, keyword: *const c_char, value: *const c_char) -> Bool;
    fn AddIpoptNumOption(problem: *mut c_void, keyword: *const c_char, value: f64) -> Bool;
    fn AddIpoptIntOption(problem: *mut c_void, keyword: *const c_char, value: c_int) -> Bool;
    fn SetIntermediateCallback(problem: *mut c_void, callback: Intermediate) -> Bool;
    fn IpoptSolve(
        problem: *mut c_void,
        x: *mut f64,
        g: *mut f64,
        objective: *mut f64,
        mult_g: *mut f64,
        mult_x_l: *mut f64,
        mult_x_u: *mut f64,
        user: *mut c_void,
    ) -> c_int;
}

/// State that the callbacks work on.
struct Session<'a> {
    nlp: &'a dyn Nlp,
    rows: Rows,
    pattern: Pattern,
    /// Point at which `rows` was evaluated.
    x: Vec<f64>,
    iterations: usize,
    evaluation_seconds: f64,
}

impl Session<'_> {
    /// Evaluates rows and Jacobian at `x` if they are at another point.
    fn evaluate(&mut self, x: &[f64]) {
        if self.x != x {
            let start = Instant::now();
            self.x.clear();
            self.x.extend_from_slice(x);
            self.rows.clear();
            self.nlp.rows(x, &mut self.rows);
            self.evaluation_seconds += start.elapsed().as_secs_f64();
        }
    }

    /// Function to minimise at `x`.
    fn objective(&mut self, x: &[f64], gradient: Option<&mut [f64]>) -> f64 {
        let start = Instant::now();
        let value = self.nlp.objective(x, gradient);
        self.evaluation_seconds += start.elapsed().as_secs_f64();
        value
    }
}

/// Returns the session and the point of a callback.
///
/// # Safety
/// The arguments must be those of an Ipopt callback: `user` is the session given to [`IpoptSolve`] and not in use elsewhere; `x` has `n`
/// values, or is null.
unsafe fn session<'s, 'x>(user: *mut c_void, n: c_int, x: *const f64) -> (&'s mut Session<'static>, &'x [f64]) {
    // SAFETY: see the doc comment.
    unsafe { (&mut *user.cast::<Session>(), if x.is_null() { &[] } else { std::slice::from_raw_parts(x, n as usize) }) }
}

extern "C" fn eval_f(n: c_int, x: *const f64, _: Bool, value: *mut f64, user: *mut c_void) -> Bool {
    // SAFETY: Ipopt's arguments, see `session`; `value` points to one number.
    let ((session, x), value) = unsafe { (session(user, n, x), &mut *value) };
    *value = session.objective(x, None);
    value.is_finite() as Bool
}

extern "C" fn eval_grad_f(n: c_int, x: *const f64, _: Bool, gradient: *mut f64, user: *mut c_void) -> Bool {
    // SAFETY: Ipopt's arguments, see `session`; `gradient` has n numbers.
    let ((session, x), gradient) = unsafe { (session(user, n, x), std::slice::from_raw_parts_mut(gradient, n as usize)) };
    session.objective(x, Some(gradient)).is_finite() as Bool
}

extern "C" fn eval_g(n: c_int, x: *const f64, _: Bool, m: c_int, values: *mut f64, user: *mut c_void) -> Bool {
    // SAFETY: Ipopt's arguments, see `session`; `values` has m numbers.
    let ((session, x), values) = unsafe { (session(user, n, x), std::slice::from_raw_parts_mut(values, m as usize)) };
    session.evaluate(x);
    values.copy_from_slice(&session.rows.values);
    session.rows.values.iter().all(|v| v.is_finite()) as Bool
}

#[allow(clippy::too_many_arguments, reason = "Ipopt's interface")]
extern "C" fn eval_jac_g(
    n: c_int,
    x: *const f64,
    _: Bool,
    _: c_int,
    entries: c_int,
    row: *mut c_int,
    column: *mut c_int,
    values: *mut f64,
    user: *mut c_void,
) -> Bool {
    // SAFETY: Ipopt's arguments, see `session`.
    let (session, x) = unsafe { session(user, n, x) };
    let entries = entries as usize;
    if values.is_null() {
        // SAFETY: without values Ipopt requests the pattern; both arrays have the number of entries given to `CreateIpoptProblem`.
        let (row, column) = unsafe { (std::slice::from_raw_parts_mut(row, entries), std::slice::from_raw_parts_mut(column, entries)) };
        for (i, &(r, c)) in session.pattern.entries.iter().enumerate() {
            (row[i], column[i]) = (r as c_int, c as c_int);
        }
        return 1;
    }
    session.evaluate(x);
    let start = Instant::now();
    // SAFETY: `values` has the number of entries given to `CreateIpoptProblem`.
    let values = unsafe { std::slice::from_raw_parts_mut(values, entries) };
    session.pattern.values(&session.rows, values);
    session.evaluation_seconds += start.elapsed().as_secs_f64();
    values.iter().all(|v| v.is_finite()) as Bool
}

#[allow(clippy::too_many_arguments, reason = "Ipopt's interface")]
extern "C" fn eval_h(
    _: c_int,
    _: *const f64,
    _: Bool,
    _: f64,
    _: c_int,
    _: *const f64,
    _: Bool,
    _: c_int,
    _: *mut c_int,
    _: *mut c_int,
    _: *mut f64,
    _: *mut c_void,
) -> Bool {
    // Never called with a limited-memory Hessian.
    0
}

#[allow(clippy::too_many_arguments, reason = "Ipopt's interface")]
extern "C" fn intermediate(
    _: c_int,
    iteration: c_int,
    _: f64,
    _: f64,
    _: f64,
    _: f64,
    _: f64,
    _: f64,
    _: f64,
    _: f64,
    _: c_int,
    user: *mut c_void,
) -> Bool {
    // SAFETY: Ipopt's argument, see `session`.
    let (session, _) = unsafe { session(user, 0, std::ptr::null()) };
    session.iterations = iteration as usize;
    1
}

/// Implementation of [`super::ipopt::solve`].
pub fn solve(nlp: &dyn Nlp, start: Option<&[f64]>, options: &Options) -> (Vec<f64>, Statistics) {
    static ONE_AT_A_TIME: Mutex<()> = Mutex::new(());
    let _turn = locked(&ONE_AT_A_TIME);
    let began = Instant::now();
    let mut x = start.unwrap_or(&nlp.variables().initial).to_vec();
    let mut rows = Rows::default();
    nlp.rows(&x, &mut rows);
    let pattern = Pattern::new(&rows);
    let (n, m, entries) = (x.len(), rows.values.len(), pattern.entries.len());
    let side = |limits: &[[f64; 2]], side: usize| limits.iter().map(|l| l[side]).collect::<Vec<f64>>();
    let bounds = &nlp.variables().bounds;
    let (x_l, x_u, g_l, g_u) = (side(bounds, 0), side(bounds, 1), side(&rows.limits, 0), side(&rows.limits, 1));
    let mut session = Session { nlp, rows, pattern, x: x.clone(), iterations: 0, evaluation_seconds: 0. };
    let text = |problem, keyword: &CStr, value: &CStr| {
        // SAFETY: a problem created by Ipopt and two C strings, which it copies.
        unsafe { AddIpoptStrOption(problem, keyword.as_ptr(), value.as_ptr()) };
    };
    // SAFETY: Ipopt copies the arrays of n and m numbers; the callbacks follow its interface; `session` outlives the solve and only the
    // callbacks access it during the solve; the problem is freed once.
    let status = unsafe {
        let problem = CreateIpoptProblem(
            n as c_int,
            x_l.as_ptr(),
            x_u.as_ptr(),
            m as c_int,
            g_l.as_ptr(),
            g_u.as_ptr(),
            entries as c_int,
            0,
            0,
            eval_f,
            eval_g,
            eval_grad_f,
            eval_jac_g,
            eval_h,
        );
        if problem.is_null() {
            // `Invalid_Problem_Definition`: a lower bound exceeds its upper bound.
            -11
        } else {
            text(problem, c"hessian_approximation", c"limited-memory");
            text(problem, c"nlp_scaling_method", c"gradient-based");
            text(problem, c"linear_solver", c"mumps");
            text(problem, c"sb", c"yes");
            AddIpoptIntOption(problem, c"print_level".as_ptr(), 0);
            AddIpoptIntOption(problem, c"max_iter".as_ptr(), options.max_iterations as c_int);
            AddIpoptNumOption(problem, c"max_cpu_time".as_ptr(), options.max_seconds);
            AddIpoptNumOption(problem, c"tol".as_ptr(), options.tolerance);
            if let Some(barrier) = options.barrier {
                for keyword in [c"mu_init", c"bound_push", c"bound_frac", c"slack_bound_push", c"slack_bound_frac"] {
                    AddIpoptNumOption(problem, keyword.as_ptr(), barrier);
                }
            }
            SetIntermediateCallback(problem, intermediate);
            let none = std::ptr::null_mut();
            let user = (&raw mut session).cast::<c_void>();
            let status = IpoptSolve(problem, x.as_mut_ptr(), none, none, none, none, none, user);
            FreeIpoptProblem(problem);
            status
        }
    };
    let statistics = Statistics {
        status,
        iterations: session.iterations,
        seconds: began.elapsed().as_secs_f64(),
        evaluation_seconds: session.evaluation_seconds,
        n_variables: n,
        n_constraints: m,
        nnz_jacobian: entries,
    };
    (x, statistics)
}
