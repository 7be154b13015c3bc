"""Gauss-Newton through time, from states that need not follow from each other.

Differential dynamic programming with gaps (Mastalli et al., "Crocoddyl", 2020, section III): with
no gap it is single shooting (iLQR, Li & Todorov 2004).
"""


@outer
def wrapped(difference, i, lift):
    """A difference of component i; of an angle, the short way round."""
    angle, unit = lift[0], lift[2]
    if not angle[i]:
        return difference
    turn = 2 * math.pi / unit[i]
    return difference - turn * np.rint(difference / turn)


@outer
def follow(model, weight, cost, bounds, largest, state, raw, gain, feed, gap, step, room, new):
    """Roll out z = raw + step feed + gain (s - state), within ``largest``; the model's next state
    less (1 - step) of the gap.  new: tuple (states, raw) to write to.  Returns the cost."""
    middle, half = bounds
    ticks, m = raw.shape
    n = state.shape[1]
    x, none, total = np.zeros(n + m), np.zeros(m), 0.0
    new_state, new_raw = new
    new_state[0] = state[0]
    for t in range(ticks):
        x[:n] = new_state[t]
        for j in range(m):
            z = raw[t, j] + step * feed[t, j]
            for i in range(n):
                z += gain[t, j, i] * wrapped(new_state[t, i] - state[t, i], i, model[0])
            z = min(max(z, -largest), largest)
            new_raw[t, j] = z
            x[n + j] = middle[j] + half[j] * math.tanh(z)
        total += action_cost(new_raw[t], none, cost)
        tick(x, weight, model, room, new_state[t + 1])
        for i in range(n):
            new_state[t + 1, i] -= (1 - step) * gap[t, i]
        x[:n] = new_state[t + 1]
        x[n:] = 0.0
        total += state_cost(x, t + 1, model, cost, room)
        if not math.isfinite(total):
            return np.inf
    return total


@outer
def cost_along(model, cost, state, raw, room):
    """Of these states and raw actions, gaps or not."""
    ticks, m = raw.shape
    n = state.shape[1]
    x, none, total = np.zeros(n + m), np.zeros(m), 0.0
    for t in range(ticks):
        x[:n] = state[t + 1]
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
def quadratic(t, expansion, ahead, ahead_hessian, damping, q):
    """q: tuple of gradient and Hessian in (s, z) of the cost from tick t on, Levenberg and
    Marquardt's ``damping`` added in z; room for Vxx' A is its last part."""
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
            q_raws[i, j] = damping + raw_hessian[t, i] if i == j else 0.0
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
def backward(expansion, gap, damping, feed, gain):
    """feed, gain: the best linear change of the raw actions, from the last tick to the first.

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
        quadratic(t, expansion, moved, ahead_hessian, damping, q)
        factors[:] = q[4]
        factorise(factors, pivot)
        column[:] = q[1]
        solve(factors, pivot, column)
        for j in range(m):
            feed[t, j] = -column[j]
            if not math.isfinite(feed[t, j]):
                return False
        for i in range(n):
            for j in range(m):
                column[j] = q[3][j, i]
            solve(factors, pivot, column)
            for j in range(m):
                gain[t, j, i] = -column[j]
        valued(q, feed[t], gain[t], ahead, ahead_hessian)
    return True


@outer
def descend(model, weight, cost, bounds, settings, state, raw, gain, gap, per_gap):
    """Improve states and raw actions in place until nothing better is found; the merit is the cost
    and ``per_gap`` times the gaps.  Returns the merit and the number of iterations."""
    least, easier, harder, most, shorter, tries, largest, limit, tolerance = settings
    ticks, m = raw.shape
    n = state.shape[1]
    room, expansion = room_for(n, m, model), expansion_for(ticks, n, m)
    feed, new, ignored = np.zeros((ticks, m)), (state.copy(), raw.copy()), gap.copy()
    total = cost_along(model, cost, state, raw, room) + per_gap * sum_of_gaps(gap)
    damping, fresh, count = least, True, 0
    while count < limit and damping <= most and math.isfinite(total):
        if fresh:
            expand(model, weight, cost, bounds, state, raw, room, expansion, ignored)
        count += 1
        better, step, fresh = False, 1.0, False
        if backward(expansion, gap, damping, feed, gain):
            open_gaps = per_gap * sum_of_gaps(gap)
            for _ in range(tries):
                found = follow(
                    model,
                    weight,
                    cost,
                    bounds,
                    largest,
                    state,
                    raw,
                    gain,
                    feed,
                    gap,
                    step,
                    room,
                    new,
                )
                found += (1 - step) * open_gaps
                if found < total:
                    better = True
                    break
                step *= shorter
        if not better:
            damping *= harder
            continue
        state[:] = new[0]
        raw[:] = new[1]
        for t in range(ticks):
            for i in range(n):
                gap[t, i] *= 1 - step
        damping, fresh = max(damping * easier, 1e-3 * least), True
        done = total - found <= tolerance * abs(found)
        total = found
        if done:
            break
    # The gains of the plan are those of its own expansion, lightly damped.
    expand(model, weight, cost, bounds, state, raw, room, expansion, ignored)
    if not backward(expansion, gap, least, feed, gain):
        total = np.inf
    return total, count


@outer
def rolled(model, weight, cost, bounds, largest, state, raw, gain):
    """Close the gaps: the model's own roll-out of a plan, in place.  Returns its cost."""
    none, closed = np.zeros(raw.shape), np.zeros((len(raw), state.shape[1]))
    new = (state.copy(), raw.copy())
    room = room_for(state.shape[1], raw.shape[1], model)
    total = follow(
        model, weight, cost, bounds, largest, state, raw, gain, none, closed, 1.0, room, new
    )
    state[:] = new[0]
    raw[:] = new[1]
    return total


@outer
def shoot(model, weight, cost, bounds, settings, state, raw, gain, value, count):
    """Single shooting from R starts; value: inf where one came to nothing."""
    for r in range(len(state)):
        closed = np.zeros((raw.shape[1], state.shape[2]))
        largest = settings[6]
        value[r] = rolled(model, weight, cost, bounds, largest, state[r], raw[r], gain[r])
        if math.isfinite(value[r]):
            value[r], count[r] = descend(
                model, weight, cost, bounds, settings, state[r], raw[r], gain[r], closed, 0.0
            )


@outer
def connect(model, weight, cost, bounds, settings, per_gap, state, raw, gain, value, count):
    """Multiple shooting from R sequences of states, then single shooting from what it found."""
    n, m = state.shape[2], raw.shape[2]
    room = room_for(n, m, model)
    for r in range(len(state)):
        gap = np.zeros((raw.shape[1], n))
        expansion = expansion_for(raw.shape[1], n, m)
        expand(model, weight, cost, bounds, state[r], raw[r], room, expansion, gap)
        value[r], count[r] = descend(
            model, weight, cost, bounds, settings, state[r], raw[r], gain[r], gap, per_gap
        )
        if math.isfinite(value[r]):
            one, more = slice(r, r + 1), np.zeros(1, np.int64)
            shoot(
                model,
                weight,
                cost,
                bounds,
                settings,
                state[one],
                raw[one],
                gain[one],
                value[one],
                more,
            )
            count[r] += more[0]
