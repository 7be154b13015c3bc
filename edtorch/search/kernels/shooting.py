"""Gauss-Newton through time, from states that need not follow from each other.

Differential dynamic programming with gaps (Mastalli et al., "Crocoddyl", 2020, section III): with
no gap it is single shooting (iLQR, Li & Todorov 2004).
"""


@outer
def wrapped(difference, i, model):
    """A difference of component i; of an angle, the short way round."""
    if not model[COMPONENT][i, ANGLE]:
        return difference
    turn = 2 * math.pi / model[SCALE][i, UNIT]
    return difference - turn * np.rint(difference / turn)


@outer
def follow(model, weight, cost, bounds, largest, plan, feed, gap, step, new):
    """Roll out z = raw + step feed + gain (s - state), within ``largest``; the model's next state
    less (1 - step) of the gap.  plan: tuple (state, raw, gain); new: tuple (state, raw) to write
    to.  Returns the cost."""
    state, raw, gain = plan
    middle, half = bounds
    ticks, m = raw.shape
    n = state.shape[1]
    room, x, none = room_for(n, m, model), np.zeros(n + m), np.zeros(m)
    total, new_state, new_raw = 0.0, new[0], new[1]
    for i in range(n):
        new_state[0, i] = state[0, i]
    for t in range(ticks):
        place(x, new_state[t])
        for j in range(m):
            z = raw[t, j] + step * feed[t, j]
            for i in range(n):
                z += gain[t, j, i] * wrapped(new_state[t, i] - state[t, i], i, model)
            z = min(max(z, -largest), largest)
            new_raw[t, j] = z
            x[n + j] = middle[j] + half[j] * math.tanh(z)
        total += action_cost(new_raw[t], none, cost)
        tick(x, weight, model, room, new_state[t + 1])
        for i in range(n):
            new_state[t + 1, i] -= (1 - step) * gap[t, i]
        place(x, new_state[t + 1])
        total += state_cost(x, t + 1, model, cost, room)
        if not math.isfinite(total):
            return np.inf
    return total


@outer
def cost_along(model, cost, state, raw):
    """Of these states and raw actions, gaps or not."""
    ticks, m = raw.shape
    n = state.shape[1]
    room, x, none, total = room_for(n, m, model), np.zeros(n + m), np.zeros(m), 0.0
    for t in range(ticks):
        place(x, state[t + 1])
        total += action_cost(raw[t], none, cost) + state_cost(x, t + 1, model, cost, room)
    return total


@outer
def sum_of_gaps(gap):
    """Of their lengths."""
    total = 0.0
    for t in range(len(gap)):
        square = 0.0
        for i in range(gap.shape[1]):
            square += gap[t, i] * gap[t, i]
        total += math.sqrt(square)
    return total


@outer
def quadratic(t, expansion, ahead, ahead_hessian, q):
    """q: tuple of gradient and Hessian in (s, z) of the cost from tick t on, and room for Vxx
    times the Jacobians."""
    by_state, by_raw, gradient, hessian, raw_gradient, raw_hessian = expansion
    q_state, q_raw, q_states, q_cross, q_raws, moved = q
    n, m = by_raw.shape[1], by_raw.shape[2]
    for i in range(n):
        for j in range(n):
            value = 0.0
            for k in range(n):
                value += ahead_hessian[i, k] * by_state[t, k, j]
            moved[i, j] = value
        for j in range(m):
            value = 0.0
            for k in range(n):
                value += ahead_hessian[i, k] * by_raw[t, k, j]
            moved[i, n + j] = value
    for i in range(n):
        q_state[i] = gradient[t, i]
        for k in range(n):
            q_state[i] += by_state[t, k, i] * ahead[k]
        for j in range(n):
            q_states[i, j] = hessian[t, i, j]
            for k in range(n):
                q_states[i, j] += by_state[t, k, i] * moved[k, j]
    for i in range(m):
        q_raw[i] = raw_gradient[t, i]
        for k in range(n):
            q_raw[i] += by_raw[t, k, i] * ahead[k]
        for j in range(n):
            q_cross[i, j] = 0.0
            for k in range(n):
                q_cross[i, j] += by_raw[t, k, i] * moved[k, j]
        for j in range(m):
            q_raws[i, j] = raw_hessian[t, i] if i == j else 0.0
            for k in range(n):
                q_raws[i, j] += by_raw[t, k, i] * moved[k, n + j]


@outer
def quadratic_for(n, m):
    """Arrays for ``quadratic``."""
    return (
        np.zeros(n),
        np.zeros(m),
        np.zeros((n, n)),
        np.zeros((m, n)),
        np.zeros((m, m)),
        np.zeros((n, n + m)),
    )


@outer
def valued(q, feed, gain, ahead, ahead_hessian):
    """Gradient and Hessian of the cost to go under z = feed + gain s, whatever the gain."""
    q_state, q_raw, q_states, q_cross, q_raws, moved = q
    n, m = len(q_state), len(q_raw)
    for i in range(n):
        ahead[i] = q_state[i]
        for j in range(m):
            ahead[i] += q_cross[j, i] * feed[j] + gain[j, i] * q_raw[j]
            for k in range(m):
                ahead[i] += gain[j, i] * q_raws[j, k] * feed[k]
    for i in range(n):
        for j in range(i + 1):
            value = 0.5 * (q_states[i, j] + q_states[j, i])
            for k in range(m):
                value += q_cross[k, i] * gain[k, j] + gain[k, i] * q_cross[k, j]
                for p in range(m):
                    value += gain[k, i] * q_raws[k, p] * gain[p, j]
            ahead_hessian[i, j] = value
            ahead_hessian[j, i] = value


@outer
def damp(matrix, damping, out):
    """out = matrix + damping I."""
    copy_table(out, matrix)
    for i in range(len(out)):
        out[i, i] += damping


@outer
def backward(expansion, gap, damping, feed, gain):
    """feed, gain: the best linear change of the raw actions, from the last tick to the first, with
    Levenberg and Marquardt's ``damping``.

    The gradient of the cost to go is moved across the gap: Vx + Vxx gap.  Returns whether all of it
    is finite.
    """
    by_raw, gradient, hessian = expansion[1], expansion[2], expansion[3]
    ticks, n, m = by_raw.shape
    ahead, ahead_hessian = gradient[ticks].copy(), hessian[ticks].copy()
    moved, q, column, pivot = np.zeros(n), quadratic_for(n, m), np.zeros(m), np.zeros(m, np.int64)
    factors = np.zeros((m, m))
    for t in range(ticks - 1, -1, -1):
        for i in range(n):
            moved[i] = ahead[i]
            for j in range(n):
                moved[i] += ahead_hessian[i, j] * gap[t, j]
        quadratic(t, expansion, moved, ahead_hessian, q)
        damp(q[4], damping, factors)
        factorise(factors, pivot, m)
        for j in range(m):
            column[j] = q[1][j]
        solve(factors, pivot, m, column)
        for j in range(m):
            feed[t, j] = -column[j]
            if not math.isfinite(feed[t, j]):
                return False
        for i in range(n):
            for j in range(m):
                column[j] = q[3][j, i]
            solve(factors, pivot, m, column)
            for j in range(m):
                gain[t, j, i] = -column[j]
        valued(q, feed[t], gain[t], ahead, ahead_hessian)
    return True


@outer
def search_step(problem, settings, plan, feed, gap, lowest, open_gaps, best, new):
    """Try steps from the longest on, until one is no better than the one before it.

    problem: tuple (model, weight, cost, bounds); best, new: tuples (state, raw); best is written.
    Returns the merit and the step, which is 0 where none is below ``lowest``.  The first step that
    is better would do, but the search would creep, and end where steps are small.
    """
    model, weight, cost, bounds = problem
    shorter, tries, largest = settings
    step, found = 1.0, 0.0
    for _ in range(tries):
        merit = follow(model, weight, cost, bounds, largest, plan, feed, gap, step, new)
        merit += (1 - step) * open_gaps
        if merit < lowest:
            lowest, found = merit, step
            copy_table(best[0], new[0])
            copy_table(best[1], new[1])
        elif found > 0.0:
            break
        step *= shorter
    return lowest, found


@outer
def descend(model, weight, cost, bounds, settings, state, raw, gain, gap, per_gap):
    """Improve states and raw actions in place until nothing better is found; the merit is the cost
    and ``per_gap`` times the gaps.  Returns the merit and the number of iterations."""
    least, easier, harder, most, shorter, tries, largest, limit, tolerance = settings
    ticks, m = raw.shape
    n = state.shape[1]
    expansion = (
        np.zeros((ticks, n, n)),
        np.zeros((ticks, n, m)),
        np.zeros((ticks + 1, n)),
        np.zeros((ticks + 1, n, n)),
        np.zeros((ticks, m)),
        np.zeros((ticks, m)),
    )
    problem, plan, steps = (
        (model, weight, cost, bounds),
        (state, raw, gain),
        (shorter, tries, largest),
    )
    best, new = (state.copy(), raw.copy()), (state.copy(), raw.copy())
    feed, ignored = np.zeros((ticks, m)), gap.copy()
    total = cost_along(model, cost, state, raw) + per_gap * sum_of_gaps(gap)
    damping, moved, count = least, True, 0
    while count < limit and damping <= most and math.isfinite(total):
        if moved:
            expand(model, weight, cost, bounds, state, raw, expansion, ignored)
        count += 1
        merit, step = total, 0.0
        if backward(expansion, gap, damping, feed, gain):
            open_gaps = per_gap * sum_of_gaps(gap)
            merit, step = search_step(problem, steps, plan, feed, gap, total, open_gaps, best, new)
        moved = step > 0.0
        hardly = total - merit <= tolerance * abs(merit)
        damping = damping * harder if hardly else max(damping * easier, 1e-3 * least)
        if not moved:
            continue
        total = merit
        copy_table(state, best[0])
        copy_table(raw, best[1])
        for t in range(ticks):
            for i in range(n):
                gap[t, i] *= 1 - step
        if hardly and step == 1.0:
            break
    # The gains of the plan are those of its own expansion, lightly damped.
    expand(model, weight, cost, bounds, state, raw, expansion, ignored)
    if not backward(expansion, gap, least, feed, gain):
        total = np.inf
    return total, count


@outer
def rolled(model, weight, cost, bounds, largest, plan, new):
    """The model's own roll-out of a plan, tuple (state, raw, gain), to ``new``.  Returns its
    cost."""
    feed, gap = np.zeros(plan[1].shape), np.zeros((len(plan[1]), plan[0].shape[1]))
    return follow(model, weight, cost, bounds, largest, plan, feed, gap, 1.0, new)
