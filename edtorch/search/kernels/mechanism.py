"""The mechanism model over one tick, and its Jacobians.

x [n + m]: state and action.  model: tuples (angle, at, unit, action_at) of the lift, (parent,
factor, node, derivative) of the terms, (learned, source, ratio, seconds, substeps) of the motion.
Products of entries of the lift form a tree, parents first: product p is product parent[p] times
entry factor[p], product 0 is 1; term k is product node[k].  So a factor that terms share is
multiplied once, and one sweep backwards is the gradient.
"""


@outer
def room_for(n, m, model):
    """Arrays to work in."""
    lift, terms, motion = model
    learned, size, products = len(motion[0]), lift[3] + m, len(terms[0])
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
    lift, terms, motion = model
    parent, factor, node, derivative = terms
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
    for k in range(len(node)):
        value, j = product[node[k]], derivative[k]
        for l in range(len(learned)):
            if j < 0:
                f[l] += weight[l, k] * value
            else:
                matrix[l, j] -= weight[l, k] * value
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
    lift, terms, motion = model
    angle, at, unit, action_at = lift
    parent, factor, node, derivative = terms
    entry, product, adjoint, by_entry, matrix, pivot, f, jacobian = room[:8]
    n, learned = len(angle), len(f)
    for l in range(learned):
        adjoint[l, :] = 0.0
        by_entry[l, :] = 0.0
        for k in range(len(node)):
            held = f[derivative[k]] if derivative[k] >= 0 else 1.0
            adjoint[l, node[k]] += weight[l, k] * held
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


@outer
def tick(x, weight, model, room, after):
    """after: the state one tick after x, by Runge and Kutta's fourth-order method."""
    motion = model[2]
    substeps, point, ds, total = motion[4], room[8], room[9][0], room[9][1]
    n, h = len(after), motion[3] / substeps
    for i in range(len(x)):
        point[i] = x[i]
    for i in range(n):
        after[i] = x[i]
    for _ in range(substeps):
        for stage in range(4):
            part = 0.0 if stage == 0 else (h if stage == 3 else h / 2)
            share = 1.0 if stage in (0, 3) else 2.0
            for i in range(n):
                point[i] = after[i] if stage == 0 else after[i] + part * ds[i]
            slope(point, weight, model, room, ds)
            for i in range(n):
                total[i] = ds[i] if stage == 0 else total[i] + share * ds[i]
        for i in range(n):
            after[i] += h / 6 * total[i]


@outer
def tick_jacobian(x, weight, model, room, after, by):
    """``tick``, and by [n, n + m]: the derivative of ``after`` in x, through every stage."""
    learned, source, ratio, seconds, substeps = model[2]
    jacobian, point, ds, total = room[7], room[8], room[9][0], room[9][1]
    at, change, sums, start = room[10][0], room[10][1], room[10][2], room[10][3]
    n, width, h = len(after), len(x), seconds / substeps
    for i in range(len(x)):
        point[i] = x[i]
    for i in range(n):
        after[i] = x[i]
    for i in range(n):
        for q in range(width):
            by[i, q] = 1.0 if i == q else 0.0
    for _ in range(substeps):
        for i in range(n):
            for q in range(width):
                start[i, q] = by[i, q]
        for stage in range(4):
            part = 0.0 if stage == 0 else (h if stage == 3 else h / 2)
            share = 1.0 if stage in (0, 3) else 2.0
            for i in range(n):
                point[i] = after[i] if stage == 0 else after[i] + part * ds[i]
                for q in range(width):
                    at[i, q] = start[i, q] if stage == 0 else start[i, q] + part * change[i, q]
            slope_jacobian(point, weight, model, room, ds)
            for i in range(n):
                for q in range(width):
                    change[i, q] = ratio[i] * at[source[i], q] if source[i] >= 0 else 0.0
            for l in range(len(learned)):
                i = learned[l]
                for q in range(width):
                    value = jacobian[l, q] if q >= n else 0.0
                    for j in range(n):
                        value += jacobian[l, j] * at[j, q]
                    change[i, q] = value
            for i in range(n):
                total[i] = ds[i] if stage == 0 else total[i] + share * ds[i]
                for q in range(width):
                    old = 0.0 if stage == 0 else sums[i, q]
                    sums[i, q] = old + share * change[i, q]
        for i in range(n):
            after[i] += h / 6 * total[i]
            for q in range(width):
                by[i, q] = start[i, q] + h / 6 * sums[i, q]


@outer
def ticks(x, weight, model, after):
    """``tick`` of rows x [P, R, n + m], each P with a weight of its own [P, L, K]."""
    n = after.shape[2]
    room = room_for(n, x.shape[2] - n, model)
    for p in range(len(x)):
        for r in range(x.shape[1]):
            tick(x[p, r], weight[p], model, room, after[p, r])


@outer
def tick_jacobians(x, weight, model, after, by):
    """``tick_jacobian`` of rows x [R, n + m], all with the same weight."""
    n = after.shape[1]
    room = room_for(n, x.shape[1] - n, model)
    for r in range(len(x)):
        tick_jacobian(x[r], weight, model, room, after[r], by[r])
