"""What a trajectory costs, and its quadratic expansion by Gauss and Newton."""


@outer
def state_cost(x, t, model, cost, room):
    """weight[t] |rows[t] A(s_t)|^2."""
    rows, weight, entry = cost[0], cost[1], room[VECTOR][ENTRY]
    if weight[t] == 0.0:
        return 0.0
    lift_into(x, model, entry)
    total = 0.0
    for r in range(rows.shape[1]):
        distance = 0.0
        for e in range(rows.shape[2]):
            distance += rows[t, r, e] * entry[e]
        total += distance * distance
    return weight[t] * total


@outer
def action_cost(raw, shift, cost):
    """action . tanh(z + shift)^2 + squash |z|^2: ``shift`` is what the gains add to z."""
    action, squash = cost[2], cost[3]
    total = 0.0
    for j in range(len(raw)):
        part = math.tanh(raw[j] + shift[j])
        total += action[j] * part * part + squash * raw[j] * raw[j]
    return total


@outer
def expand_state(x, t, model, cost, room, gradient, hessian):
    """First derivative of ``state_cost``, and the second without that of the distances."""
    rows, weight, n = cost[0], cost[1], len(model[COMPONENT])
    entry, row = room[VECTOR][ENTRY], room[VECTOR][DS]
    gradient[:] = 0.0
    hessian[:] = 0.0
    if weight[t] == 0.0:
        return
    lift_into(x, model, entry)
    for r in range(rows.shape[1]):
        distance = 0.0
        for e in range(rows.shape[2]):
            distance += rows[t, r, e] * entry[e]
        for i in range(n):
            row[i] = by_component(rows[t, r], entry, i, model)
        for i in range(n):
            gradient[i] += 2 * weight[t] * distance * row[i]
            for j in range(n):
                hessian[i, j] += 2 * weight[t] * row[i] * row[j]


@outer
def expand(model, weight, cost, bounds, state, raw, expansion, gap):
    """The expansion along states and raw actions; gap [H, n]: what the model says the next state
    is, less the state that stands there.

    expansion: tuple (ds'/ds, ds'/dz, gradient and Hessian in s, gradient and diagonal Hessian in z)
    of arrays [H, n, n], [H, n, m], [H + 1, n], [H + 1, n, n], [H, m], [H, m], to write to.
    """
    by_state, by_raw, gradient, hessian, raw_gradient, raw_hessian = expansion
    middle, half = bounds
    ticks, m = raw.shape
    n = state.shape[1]
    room, x, after = room_for(n, m, model), np.zeros(n + m), np.zeros(n)
    by = np.zeros((n, n + m))
    for t in range(ticks + 1):
        place(x, state[t])
        # The start is given: it costs nothing.
        if t > 0:
            expand_state(x, t, model, cost, room, gradient[t], hessian[t])
        if t == ticks:
            return
        for j in range(m):
            x[n + j] = middle[j] + half[j] * math.tanh(raw[t, j])
        tick_jacobian(x, weight, model, room, after, by)
        for i in range(n):
            gap[t, i] = after[i] - state[t + 1, i]
            for q in range(n):
                by_state[t, i, q] = by[i, q]
        for j in range(m):
            part = math.tanh(raw[t, j])
            steep = 1.0 - part * part
            for i in range(n):
                by_raw[t, i, j] = by[i, n + j] * half[j] * steep
            raw_gradient[t, j] = 2 * cost[2][j] * part * steep + 2 * cost[3] * raw[t, j]
            raw_hessian[t, j] = 2 * cost[2][j] * steep * steep + 2 * cost[3]
