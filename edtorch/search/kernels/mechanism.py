"""The derivative of the state by the mechanism model, and its Jacobian.

x [n + m]: state and action.  model: tuples (angle, at, unit, action_at) of the lift, (parent,
factor, node, derivative, pair) of the terms, (learned, source, ratio, seconds, substeps) of the
motion, and one of the stops (``stops.py``).
Products of entries of the lift form a tree, parents first: product p is product parent[p] times
entry factor[p], product 0 is 1; term k is product node[k].  So a factor that terms share is
multiplied once, and one sweep backwards is the gradient.  pair [Q, 2]: the terms and outputs whose
weights are not zero by definition.
"""


@outer
def room_for(n, m, model):
    """Arrays to work in."""
    lift, terms, motion, stops = model
    learned, size, products = len(motion[0]), lift[3] + m, len(terms[0])
    count, pieces = len(stops[1]), motion[4] + 2 * stops[5] + 2
    return (
        np.zeros(size),
        np.zeros(products),
        np.zeros((learned, products)),
        np.zeros((learned, size)),
        np.zeros((learned, learned)),
        np.zeros(learned, np.int64),
        np.zeros(learned),
        np.zeros((learned, n + m)),
        np.zeros(n + m),
        np.zeros((2, n)),
        np.zeros((4, n, n + m)),
        (
            np.zeros(count, np.bool_),
            np.zeros((count, learned)),
            np.zeros((count, count)),
            np.zeros((2, count)),
            np.zeros((count, count)),
            np.zeros(count, np.int64),
            np.zeros((2, n + m)),
            np.zeros((6, n)),
            np.zeros((learned, n + m)),
            np.zeros((2, n, n + m)),
            np.zeros(pieces),
            np.zeros((2, pieces + 1), np.int64),
        ),
    )


@outer
def factorise(matrix, pivot):
    """LU factors in place, with partial pivoting."""
    size = len(pivot)
    for c in range(size):
        best = c
        for r in range(c + 1, size):
            if abs(matrix[r, c]) > abs(matrix[best, c]):
                best = r
        pivot[c] = best
        if best != c:
            for j in range(size):
                matrix[c, j], matrix[best, j] = matrix[best, j], matrix[c, j]
        for r in range(c + 1, size):
            ratio = matrix[r, c] / matrix[c, c]
            matrix[r, c] = ratio
            for j in range(c + 1, size):
                matrix[r, j] -= ratio * matrix[c, j]


@outer
def solve(matrix, pivot, vector):
    """vector = matrix^-1 vector, from the factors."""
    size = len(pivot)
    for c in range(size):
        best = pivot[c]
        vector[c], vector[best] = vector[best], vector[c]
    for r in range(size):
        for j in range(r):
            vector[r] -= matrix[r, j] * vector[j]
    for r in range(size - 1, -1, -1):
        for j in range(r + 1, size):
            vector[r] -= matrix[r, j] * vector[j]
        vector[r] /= matrix[r, r]


@outer
def lift_into(x, lift, entry):
    """entry = A(s, u) = [1 | sin, cos of an angle, else s | u]."""
    angle, at, unit, action_at = lift
    n = len(angle)
    entry[0] = 1.0
    for i in range(n):
        if angle[i]:
            entry[at[i]] = math.sin(x[i] * unit[i])
            entry[at[i] + 1] = math.cos(x[i] * unit[i])
        else:
            entry[at[i]] = x[i]
    for j in range(len(x) - n):
        entry[action_at + j] = x[n + j]


@outer
def slope(x, weight, model, room, ds):
    """ds = ds/dt: (I - N) f = h for what is learned, ratio times the source for positions."""
    lift, terms, motion, _ = model
    parent, factor, node, derivative, pair = terms
    learned, source, ratio = motion[0], motion[1], motion[2]
    entry, product, matrix, pivot, f = room[0], room[1], room[4], room[5], room[6]
    lift_into(x, lift, entry)
    product[0] = 1.0
    for p in range(1, len(parent)):
        product[p] = product[parent[p]] * entry[factor[p]]
    for l in range(len(learned)):
        f[l] = 0.0
        for j in range(len(learned)):
            matrix[l, j] = 1.0 if l == j else 0.0
    for q in range(len(pair)):
        k, l = pair[q, 0], pair[q, 1]
        value, j = weight[l, k] * product[node[k]], derivative[k]
        if j < 0:
            f[l] += value
        else:
            matrix[l, j] -= value
    factorise(matrix, pivot)
    solve(matrix, pivot, f)
    for i in range(len(ds)):
        ds[i] = ratio[i] * x[source[i]] if source[i] >= 0 else 0.0
    for l in range(len(learned)):
        ds[learned[l]] = f[l]


@outer
def slope_jacobian(x, weight, model, room, ds):
    """``slope``, and room[7] = df/dx [L, n + m] from (I - N) df = dh + dN f."""
    slope(x, weight, model, room, ds)
    lift, terms, motion, _ = model
    angle, at, unit, action_at = lift
    parent, factor, node, derivative, pair = terms
    entry, product, adjoint, by_entry, matrix, pivot, f, jacobian = room[:8]
    n, learned = len(angle), len(f)
    for l in range(learned):
        adjoint[l, :] = 0.0
        by_entry[l, :] = 0.0
    for q in range(len(pair)):
        k, l = pair[q, 0], pair[q, 1]
        held = f[derivative[k]] if derivative[k] >= 0 else 1.0
        adjoint[l, node[k]] += weight[l, k] * held
    for l in range(learned):
        for p in range(len(parent) - 1, 0, -1):
            by_entry[l, factor[p]] += adjoint[l, p] * product[parent[p]]
            adjoint[l, parent[p]] += adjoint[l, p] * entry[factor[p]]
    for i in range(len(x)):
        for l in range(learned):
            if i >= n:
                f[l] = by_entry[l, action_at + i - n]
            elif angle[i]:
                along = (
                    by_entry[l, at[i]] * entry[at[i] + 1] - by_entry[l, at[i] + 1] * entry[at[i]]
                )
                f[l] = unit[i] * along
            else:
                f[l] = by_entry[l, at[i]]
        solve(matrix, pivot, f)
        for l in range(learned):
            jacobian[l, i] = f[l]
