"""A stationary policy z = theta phi(A(s)): what its roll-outs cost, and how that depends on theta.

policy: tuple of a tree of products [P, 2], as the terms of a model have it, and the places [F] of
phi in it; theta [m, F].  Weight p = j F + k is theta[j, k]; P = m F.
"""


@outer
def policy_raw(x, model, policy, theta, entry, product, raw):
    """raw = theta phi(A(s)), with x = (s, anything); product: of the tree."""
    tree, node = policy
    lift_into(x, model, entry)
    products_into(tree, entry, product)
    for j in range(len(raw)):
        raw[j] = 0.0
        for k in range(len(node)):
            raw[j] += theta[j, k] * product[node[k]]


@outer
def policy_slope(model, policy, theta, entry, product, adjoint, by_entry, by):
    """by [m, n] = dz/ds, after ``policy_raw``, by one sweep backwards for each action."""
    tree, node = policy
    for j in range(len(by)):
        adjoint[:] = 0.0
        by_entry[:] = 0.0
        for k in range(len(node)):
            adjoint[node[k]] += theta[j, k]
        for p in range(len(tree) - 1, 0, -1):
            parent, factor = tree[p, PARENT], tree[p, FACTOR]
            by_entry[factor] += adjoint[p] * product[parent]
            adjoint[parent] += adjoint[p] * entry[factor]
        for i in range(by.shape[1]):
            by[j, i] = by_component(by_entry, entry, i, model)


@outer
def policy_cost(model, weight, cost, bounds, policy, theta, start):
    """Mean cost from starts [S, n]; inf where one is not finite."""
    middle, half = bounds
    m, n = len(middle), start.shape[1]
    room, x, none = room_for(n, m, model), np.zeros(n + m), np.zeros(m)
    entry, product, raw = np.zeros(model[ACTION_AT] + m), np.zeros(len(policy[0])), np.zeros(m)
    after, total = np.zeros(n), 0.0
    for p in range(len(start)):
        place(x, start[p])
        for t in range(len(cost[1]) - 1):
            policy_raw(x, model, policy, theta, entry, product, raw)
            for j in range(m):
                x[n + j] = middle[j] + half[j] * math.tanh(raw[j])
            total += action_cost(raw, none, cost)
            tick(x, weight, model, room, after)
            place(x, after)
            total += state_cost(x, t + 1, model, cost, room)
            if not math.isfinite(total):
                return np.inf
    return total / len(start)


@outer
def add_square(factor, row, gradient_factor, gradient, hessian):
    """gradient += gradient_factor row, hessian += factor row row' (its lower half)."""
    for p in range(len(row)):
        gradient[p] += gradient_factor * row[p]
        scaled = factor * row[p]
        for q in range(p + 1):
            hessian[p, q] += scaled * row[q]


@outer
def policy_expansion(model, weight, cost, bounds, policy, theta, start, gradient, hessian):
    """``policy_cost``, its gradient [P] in theta and its Hessian [P, P] by Gauss and Newton.

    Forward sensitivities S = ds/dtheta [n, P]: dz = dz/ds S + phi, S' = ds'/ds S + ds'/du du/dz dz.
    """
    middle, half = bounds
    m, n, size = len(middle), start.shape[1], len(gradient)
    features = size // m
    room, x, none = room_for(n, m, model), np.zeros(n + m), np.zeros(m)
    entry, product, raw = np.zeros(model[ACTION_AT] + m), np.zeros(len(policy[0])), np.zeros(m)
    adjoint, by_entry = np.zeros(len(policy[0])), np.zeros(model[ACTION_AT] + m)
    by_state, by = np.zeros((m, n)), np.zeros((n, n + m))
    sensitivity, next_one, moved = np.zeros((n, size)), np.zeros((n, size)), np.zeros((n, size))
    by_theta, state_gradient, state_hessian = np.zeros((m, size)), np.zeros(n), np.zeros((n, n))
    after, total = np.zeros(n), 0.0
    gradient[:] = 0.0
    hessian[:] = 0.0
    for s in range(len(start)):
        place(x, start[s])
        sensitivity[:] = 0.0
        for t in range(len(cost[1]) - 1):
            policy_raw(x, model, policy, theta, entry, product, raw)
            policy_slope(model, policy, theta, entry, product, adjoint, by_entry, by_state)
            total += action_cost(raw, none, cost)
            for j in range(m):
                part = math.tanh(raw[j])
                steep = 1.0 - part * part
                for p in range(size):
                    value = 0.0
                    for i in range(n):
                        value += by_state[j, i] * sensitivity[i, p]
                    by_theta[j, p] = value
                for k in range(features):
                    by_theta[j, j * features + k] += product[policy[1][k]]
                add_square(
                    2 * cost[2][j] * steep * steep + 2 * cost[3],
                    by_theta[j],
                    2 * cost[2][j] * part * steep + 2 * cost[3] * raw[j],
                    gradient,
                    hessian,
                )
                x[n + j] = middle[j] + half[j] * part
            tick_jacobian(x, weight, model, room, after, by)
            for i in range(n):
                for p in range(size):
                    value = 0.0
                    for q in range(n):
                        value += by[i, q] * sensitivity[q, p]
                    next_one[i, p] = value
                for j in range(m):
                    part = math.tanh(raw[j])
                    along = by[i, n + j] * half[j] * (1.0 - part * part)
                    for p in range(size):
                        next_one[i, p] += along * by_theta[j, p]
            copy_table(sensitivity, next_one)
            place(x, after)
            total += state_cost(x, t + 1, model, cost, room)
            expand_state(x, t + 1, model, cost, room, state_gradient, state_hessian)
            for i in range(n):
                for p in range(size):
                    gradient[p] += state_gradient[i] * sensitivity[i, p]
                    value = 0.0
                    for q in range(n):
                        value += state_hessian[i, q] * sensitivity[q, p]
                    moved[i, p] = value
            for i in range(n):
                for p in range(size):
                    for q in range(p + 1):
                        hessian[p, q] += sensitivity[i, p] * moved[i, q]
            if not math.isfinite(total):
                return np.inf
    for p in range(size):
        gradient[p] /= len(start)
        for q in range(p + 1):
            hessian[p, q] /= len(start)
            hessian[q, p] = hessian[p, q]
    return total / len(start)
