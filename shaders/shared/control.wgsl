// How the solve of a candidate goes on: barrier steps, closing steps, proximal weight, and when it ends.
// Twin: src/solver/control.rs

// By its bits: comparisons may assume that there are none.
fn is_finite(v: f32) -> bool {
    return (bitcast<u32>(v) & 0x7f800000u) != 0x7f800000u;
}

// Proximal weight in force.
fn proximal(progress: Progress) -> f32 {
    return select(progress.eps, progress.closing_eps, progress.state == CLOSE);
}

// Gives the proximal weight in force another value.
fn with_proximal(before: Progress, eps: f32) -> Progress {
    var progress = before;
    if (progress.state == CLOSE) {
        progress.closing_eps = eps;
    } else {
        progress.eps = eps;
    }
    return progress;
}

// Decides what the round is for, or ends the solve.
//   f        infeasibility at the point
//   earlier  that `stall_window` records ago; any value where there are not as many
//   largest  multiplier of an inequality
fn begin(slot: u32, before: Progress, f: f32, earlier: f32, largest: f32) -> Progress {
    var progress = before;
    progress.infeasibility = f;
    progress.recorded += 1u;
    if (!is_finite(f)) {
        progress.state = NON_FINITE;
    } else if (f < batch.closing && progress.edge_radius > 0.0) {
        // Near enough: from here on the exact rows.
        progress.edge_radius = 0.0;
        progress.recorded -= 1u;
        progress.stall_from = progress.recorded;
        progress.state = EXACT;
    } else if (f < batch.tolerance) {
        progress.state = SOLVED;
    } else if (progress.iterations >= batch.max_iterations) {
        progress.state = MAX_ITERATIONS;
    } else if (stalled(progress, f, earlier) || is_hopeless(progress, f, largest)) {
        progress.state = STALLED;
    } else {
        var closing = progress.state == CLOSE;
        if (closing && f > CLOSING_RATE * progress.closing_from) {
            // It closes on the wrong rows: back to the barrier until they are better known.
            closing = false;
            progress.closing_below = min(progress.closing_below, 0.1 * f);
        }
        closing = closing || f < progress.closing_below;
        progress.closing_from = f;
        progress.state = select(STEP, CLOSE, closing);
        progress.smoothing = select(batch.smoothing_weight * progress.mu / progress.barrier, 0.0, closing);
        if (!closing) {
            progress.closing_eps = batch.proximal_floor;
        }
    }
    if (may_be_given_up(progress) && progress.state != EXACT) {
        let rates = slots[slot].hopeless_rates;
        let later = select(rates[1], rates[2], progress.recorded > HOPELESS_LATE_KNEE);
        progress.hopeless *= select(rates[0], later, progress.recorded > HOPELESS_KNEE);
    }
    return progress;
}

// Whether it lacks more than it may after as many iterations.
fn is_hopeless(progress: Progress, f: f32, largest: f32) -> bool {
    return may_be_given_up(progress) && f * largest > progress.hopeless * progress.length;
}

// Whether what is lacking may end the solve now.
fn may_be_given_up(progress: Progress) -> bool {
    return progress.recorded > HOPELESS_FROM && progress.recorded <= HOPELESS_TO + 1u;
}

// The stall rule. Closing steps are never cut short.
fn stalled(progress: Progress, f: f32, earlier: f32) -> bool {
    let done = progress.recorded - 1u;
    if (batch.stall_start == NONE || done < max(batch.stall_start, progress.stall_from + batch.stall_window)) {
        return false;
    }
    // Logarithmic distance left against that covered in the window, in windows.
    let window = f32(batch.stall_window);
    return f > STALL_ABOVE && log(f / STALL_TARGET) * window > batch.stall_budget * log(earlier / f);
}

// Whether a trial point is taken: the merit falls, or the residuals are close to their linear model.
//   fall       of the merit
//   predicted  fall of the merit by the linear model
//   gap        squared distance of the residuals from that model
fn acceptable(progress: Progress, fall: f32, predicted: f32, gap: f32) -> bool {
    let near_linear = gap < 0.3 * max(predicted, 0.05 * progress.infeasibility);
    return is_finite(fall) && is_finite(gap) && (fall > 0.0 || (progress.state != CLOSE && near_linear));
}

// The trial point becomes the point.
//   ratio  fall of the merit by the predicted one
fn accept(before: Progress, ratio: f32) -> Progress {
    var progress = before;
    let eps = proximal(progress);
    // A shorter step leaves the weight as it is: its direction was good.
    let whole = progress.state != SHORTER;
    if (whole && ratio > 0.7) {
        progress = with_proximal(progress, max(eps / 4.0, batch.proximal_floor));
    } else if (whole && ratio < 0.25) {
        progress = with_proximal(progress, eps * 2.0);
    }
    progress.iterations += 1u;
    return renew(progress);
}

// The trial point, which is the point with other rows, takes its place.
fn renew(before: Progress) -> Progress {
    var progress = before;
    progress.attempts = 0u;
    progress.current = 1u - progress.current;
    return progress;
}

// The trial point is dropped: another one along its direction, nearer, is tried, or another direction.
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

// The direction is dropped: another one is made with a larger proximal weight, or with the barrier, or the solve ends.
fn damp(before: Progress) -> Progress {
    var progress = before;
    if (progress.state == CLOSE) {
        // Back to the barrier until the violated rows are better known.
        progress.state = STEP;
        progress.attempts = 0u;
        progress.closing_below = 0.1 * min(progress.closing_below, progress.infeasibility);
        return progress;
    }
    progress.eps *= PROXIMAL_GROWTH;
    progress.attempts = max(progress.attempts, SHORTENINGS) + 1u;
    progress.state = STEP;
    if (progress.attempts == ATTEMPTS) {
        progress.attempts = 0u;
        progress.state = STALLED;
    }
    return progress;
}
