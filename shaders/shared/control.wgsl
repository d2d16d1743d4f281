// Control of a candidate's solve: barrier steps, closing steps, the proximal weight and termination.
// Twin: src/solver/control.rs

// True if `v` is finite. Tests the bits, because a compiler may assume that comparisons never see a NaN or an infinity.
fn is_finite(v: f32) -> bool {
    return (bitcast<u32>(v) & 0x7f800000u) != 0x7f800000u;
}

// Proximal weight of the current kind of step.
fn proximal(progress: Progress) -> f32 {
    return select(progress.eps, progress.closing_eps, progress.state == CLOSE);
}

// Sets the proximal weight of the current kind of step.
fn with_proximal(before: Progress, eps: f32) -> Progress {
    var progress = before;
    if (progress.state == CLOSE) {
        progress.closing_eps = eps;
    } else {
        progress.eps = eps;
    }
    return progress;
}

// Chooses the kind of step of this round, starts the minimisation, or ends the solve. Not for the phases MINIMISE and REVERT.
//   f        infeasibility at the point
//   earlier  infeasibility `stall_window` records ago; any value if there are fewer records
//   largest  largest multiplier of an inequality
//   feasible true if all rows are satisfied
fn begin(slot: u32, before: Progress, f: f32, earlier: f32, largest: f32, feasible: bool) -> Progress {
    var progress = before;
    progress.infeasibility = f;
    progress.recorded += 1u;
    if (!is_finite(f)) {
        progress.state = NON_FINITE;
    } else if (f < batch.closing && progress.edge_radius > 0.0) {
        // Close to a solution: use the exact rows from now on.
        progress.edge_radius = 0.0;
        progress.recorded -= 1u;
        progress.stall_from = progress.recorded;
        progress.state = EXACT;
    } else if (feasible) {
        progress.state = SOLVED;
    } else if (progress.iterations >= last_iteration(progress)) {
        progress.state = MAX_ITERATIONS;
    } else if (stalled(progress, f, earlier)) {
        progress.state = STALLED;
    } else if (ends_early(progress, f, largest)) {
        progress.state = TERMINATED_EARLY;
    } else {
        var closing = progress.state == CLOSE;
        let slow = f > CLOSING_RATE * progress.closing_from;
        if (closing && slow && progress.phase != RESTORE && is_finite(batch.closing)) {
            // The closing steps act on the wrong rows: return to the barrier until the violated rows are better known.
            closing = false;
            progress.closing_below = min(progress.closing_below, CLOSING_AGAIN * f);
        }
        closing = closing || f < progress.closing_below;
        progress.closing_from = f;
        progress.state = select(STEP, CLOSE, closing);
        let smooths = !closing && progress.phase == SOLVE;
        progress.smoothing = select(0.0, batch.smoothing_weight * progress.mu / progress.barrier, smooths);
        if (!closing) {
            progress.closing_eps = batch.proximal_floor;
        }
    }
    if (may_end_early(progress) && progress.state != EXACT) {
        let rates = slots[slot].early_termination_rates;
        let later = select(rates[1], rates[2], progress.recorded > EARLY_TERMINATION_LATE_KNEE);
        progress.early_termination_limit *= select(rates[0], later, progress.recorded > EARLY_TERMINATION_KNEE);
    }
    if (progress.phase == RESTORE && progress.state > SOLVED) {
        progress.phase = REVERT;
    } else if (progress.phase == SOLVE && progress.state == SOLVED && progress.minimise_iterations > 0u) {
        progress = minimise(progress);
    }
    return progress;
}

// Iteration limit of the phase.
fn last_iteration(progress: Progress) -> u32 {
    return batch.max_iterations + select(0u, progress.minimise_until, progress.phase == RESTORE);
}

// Begins a phase with barrier steps, whose proximal weight is the smallest.
fn enter(before: Progress, phase: u32, barrier: f32) -> Progress {
    var progress = before;
    progress.phase = phase;
    progress.state = STEP;
    progress.stall_from = progress.recorded;
    progress.mu = barrier;
    progress.barrier_floor = BARRIER_FLOOR;
    progress.barrier = barrier;
    progress.smoothing = 0.0;
    progress.eps = batch.proximal_floor;
    progress.closing_eps = batch.proximal_floor;
    progress.closing_below = batch.closing;
    progress.edge_radius = 0.0;
    progress.length = 1.0;
    progress.dual_length = 1.0;
    return progress;
}

// Begins the minimisation at a solved point.
fn minimise(before: Progress) -> Progress {
    var progress = enter(before, MINIMISE, batch.minimise_barrier);
    progress.minimise_until = progress.iterations + progress.minimise_iterations;
    progress.smoothing = batch.minimise_smoothing;
    progress.rounding = batch.rounding;
    progress.solved_infeasibility = progress.infeasibility;
    return progress;
}

// True if the minimisation is over and the rows must be restored.
fn is_minimised(progress: Progress) -> bool {
    return progress.phase == RESTORE_NEXT || (progress.phase == MINIMISE && progress.iterations >= progress.minimise_until);
}

// Begins to solve the rows again.
fn restore(before: Progress) -> Progress {
    return enter(before, RESTORE, batch.restore_barrier);
}

// Ends the solve at the solved point from which the minimisation started.
fn revert(before: Progress) -> Progress {
    var progress = before;
    progress.phase = REVERT;
    progress.state = SOLVED;
    progress.infeasibility = progress.solved_infeasibility;
    return progress;
}

// Updates the minimisation after an accepted step: ends it near the optimum or above the limit of the cost, rounds absolute values less as
// the barrier falls, and keeps the barrier in proportion to the predicted fall.
//   predicted     decrease of merit and cost by the linear model
//   cost          weighted cost at the new point
//   inequalities  number of inequalities
fn minimised(before: Progress, predicted: f32, cost: f32, inequalities: u32) -> Progress {
    var progress = before;
    let sharp = progress.rounding <= batch.rounding_floor;
    // Only a long step says how far the optimum is.
    let trusted = batch.cost_weight > 0.0 && sharp && progress.length > TRUSTED_LENGTH;
    if (cost > batch.cost_limit && progress.minimise_iterations == 0u) {
        progress.state = TERMINATED_EARLY;
    } else if (cost > batch.cost_limit || (trusted && predicted < batch.minimise_tolerance * cost)) {
        progress.phase = RESTORE_NEXT;
    }
    let part = min(sqrt(progress.mu / batch.minimise_barrier), 1.0);
    progress.rounding = max(batch.rounding * part, batch.rounding_floor);
    let least = BARRIER_PER_FALL * predicted / (progress.length * f32(max(inequalities, 1u)));
    progress.barrier_floor = clamp(least, BARRIER_FLOOR, LARGEST_BARRIER_FLOOR);
    return progress;
}

// True if the infeasibility exceeds the early termination limit of this iteration.
fn ends_early(progress: Progress, f: f32, largest: f32) -> bool {
    return may_end_early(progress) && f * largest > progress.early_termination_limit * progress.length;
}

// True if early termination may end the solve in this iteration.
fn may_end_early(progress: Progress) -> bool {
    return progress.phase == SOLVE && progress.recorded > EARLY_TERMINATION_FROM && progress.recorded <= EARLY_TERMINATION_TO + 1u;
}

// True if the stall rule ends the solve. It never acts during closing steps.
fn stalled(progress: Progress, f: f32, earlier: f32) -> bool {
    let done = progress.recorded - 1u;
    if (batch.stall_start == NONE || done < max(batch.stall_start, progress.stall_from + batch.stall_window)) {
        return false;
    }
    // Compares the logarithmic distance to the target with the distance covered in the window; both in windows.
    let window = f32(batch.stall_window);
    return f > STALL_ABOVE && log(f / STALL_TARGET) * window > batch.stall_budget * log(earlier / f);
}

// True if the trial point is accepted: the merit falls, or the residuals are close to their linear model.
//   fall       decrease of the merit
//   predicted  decrease of the merit by the linear model
//   gap        squared distance of the residuals from the linear model
fn acceptable(progress: Progress, fall: f32, predicted: f32, gap: f32) -> bool {
    let near_linear = gap < NEAR_LINEAR * max(predicted, NEAR_LINEAR_FLOOR * progress.infeasibility);
    return is_finite(fall) && is_finite(gap) && (fall > 0.0 || (progress.state != CLOSE && near_linear));
}

// Accepts the trial point.
//   ratio  actual decrease of the merit divided by the predicted one
fn accept(before: Progress, ratio: f32) -> Progress {
    var progress = before;
    let eps = proximal(progress);
    // After a shortened step the weight stays: the direction was good.
    let whole = progress.state != SHORTER;
    let minimises = progress.phase == MINIMISE;
    if (whole && ratio > GOOD_RATIO) {
        progress = with_proximal(progress, max(eps / GOOD_DIVISOR, batch.proximal_floor));
    } else if (whole && ratio < select(POOR_RATIO, MINIMISE_POOR_RATIO, minimises)) {
        progress = with_proximal(progress, eps * select(POOR_FACTOR, MINIMISE_POOR_FACTOR, minimises));
    }
    progress.iterations += 1u;
    return renew(progress);
}

// Makes the trial point the current point. The caller uses it also for the same point with other rows.
fn renew(before: Progress) -> Progress {
    var progress = before;
    progress.attempts = 0u;
    progress.current = 1u - progress.current;
    return progress;
}

// Rejects the trial point: tries a shorter step along the same direction, or a new direction.
fn refuse(before: Progress) -> Progress {
    if (before.state == CLOSE || before.attempts >= SHORTENINGS) {
        return damp(before);
    }
    var progress = before;
    progress.attempts += 1u;
    progress.state = SHORTER;
    progress.length *= SHORTENING;
    progress.dual_length *= SHORTENING;
    return progress;
}

// Rejects the direction: the next one has a larger proximal weight, or is a barrier step; after the last attempt the solve ends. While the
// rows are restored, closing steps are first tried with larger proximal weights. A minimisation that stalls is over; rows that cannot be
// restored revert to the solved point.
// An infinite `batch.closing` allows closing steps only; such solves run on the CPU only, see src/solver/close.rs.
fn damp(before: Progress) -> Progress {
    var progress = before;
    let damps = progress.phase == RESTORE && progress.attempts + 1u < ATTEMPTS;
    if (progress.state == CLOSE && is_finite(progress.closing_below) && !damps) {
        // Return to the barrier until the violated rows are better known.
        progress.state = STEP;
        progress.attempts = 0u;
        progress.closing_below = CLOSING_AGAIN * min(progress.closing_below, progress.infeasibility);
        return progress;
    }
    progress = with_proximal(progress, proximal(progress) * select(PROXIMAL_GROWTH, CLOSING_GROWTH, progress.state == CLOSE));
    progress.attempts = max(progress.attempts, SHORTENINGS) + 1u;
    if (progress.state == SHORTER) {
        progress.state = STEP;
    }
    if (progress.attempts == ATTEMPTS) {
        progress.attempts = 0u;
        if (progress.phase == SOLVE) {
            progress.state = STEPS_REFUSED;
        } else {
            progress.state = STEP;
            progress.phase = select(REVERT, RESTORE_NEXT, progress.phase == MINIMISE);
        }
    }
    return progress;
}
