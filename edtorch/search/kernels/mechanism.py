"""The derivative of the state by the mechanism model, and its Jacobian.

x [n + m]: state and action; model, room: ``names.py``.  A factor that terms share is multiplied
once, in the tree of products, and one sweep backwards through it is the gradient.
"""


@outer
def room_for(n, m, model):
    """Arrays to work in."""
    learned, products, stops = len(model[LEARNED]), len(model[PRODUCT]), len(model[STOP])
    size, pieces = model[ACTION_AT] + m, model[SUBSTEPS] + 2 * model[MOST] + 2
    return (
        np.zeros((VECTORS, max(products, size, n + m, pieces, stops))),
        np.zeros((2, learned, max(products, size))),
        np.zeros((TABLES, max(n, stops), max(n + m, stops))),
        np.zeros((INDICES, max(pieces + 1, learned, stops)), np.int64),
    )


@outer
def factorise(matrix, pivot, size):
    """LU factors in place, with partial pivoting."""
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
def solve(matrix, pivot, size, vector):
    """vector = matrix^-1 vector, from the factors."""
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
def copy_table(to, table):
    """to = table, entry by entry: an assignment of whole arrays takes seconds to compile."""
    for i in range(to.shape[0]):
        for j in range(to.shape[1]):
            to[i, j] = table[i, j]


@outer
def place(x, state):
    """x = (state, 0)."""
    x[:] = 0.0
    for i in range(len(state)):
        x[i] = state[i]


@outer
def lift_into(x, model, entry):
    """entry = A(s, u) = [1 | sin, cos of an angle, else s | u]."""
    component, scale = model[COMPONENT], model[SCALE]
    n = len(component)
    entry[0] = 1.0
    for i in range(n):
        at = component[i, AT]
        if component[i, ANGLE]:
            entry[at] = math.sin(x[i] * scale[i, UNIT])
            entry[at + 1] = math.cos(x[i] * scale[i, UNIT])
        else:
            entry[at] = x[i]
    for j in range(model[ACTIONS]):
        entry[model[ACTION_AT] + j] = x[n + j]


@outer
def by_component(by_entry, entry, i, model):
    """Of what depends on the lift as ``by_entry`` says, the derivative in component i."""
    component, unit = model[COMPONENT], model[SCALE][i, UNIT]
    at = component[i, AT]
    if component[i, ANGLE]:
        return unit * (by_entry[at] * entry[at + 1] - by_entry[at + 1] * entry[at])
    return by_entry[at]


@outer
def products_into(tree, entry, product):
    """product [P] of a tree [P, 2]."""
    product[0] = 1.0
    for p in range(1, len(tree)):
        product[p] = product[tree[p, PARENT]] * entry[tree[p, FACTOR]]


@outer
def slope(x, weight, model, room, ds):
    """ds = ds/dt: (I - N) f = h for what is learned, ratio times the source for positions.  Leaves
    lift, products, f and the factors of I - N in ``room``."""
    component, scale, learned, pair = model[COMPONENT], model[SCALE], model[LEARNED], model[PAIR]
    vector, matrix, pivot = room[VECTOR], room[TABLE][MATRIX], room[INDEX][PIVOT]
    product, f, count = vector[PRODUCTS], vector[F], len(learned)
    lift_into(x, model, vector[ENTRY])
    products_into(model[PRODUCT], vector[ENTRY], product)
    for l in range(count):
        f[l] = 0.0
        for j in range(count):
            matrix[l, j] = 1.0 if l == j else 0.0
    for q in range(len(pair)):
        l, j = pair[q, OUTPUT], pair[q, DERIVATIVE]
        value = weight[l, pair[q, TERM]] * product[pair[q, NODE]]
        if j < 0:
            f[l] += value
        else:
            matrix[l, j] -= value
    factorise(matrix, pivot, count)
    solve(matrix, pivot, count, f)
    for i in range(len(component)):
        source = component[i, SOURCE]
        ds[i] = scale[i, RATIO] * x[source] if source >= 0 else 0.0
    for l in range(count):
        ds[learned[l]] = f[l]


@outer
def by_action(a, weight, model, room, column):
    """column [n] = df/du_a after ``slope``, zero for what is not learned: (I - N) df = dh + dN f,
    by one sweep forwards."""
    learned, pair, tree = model[LEARNED], model[PAIR], model[PRODUCT]
    vector, f, one = room[VECTOR], room[VECTOR][F], room[VECTOR][ONE]
    entry, product, along = vector[ENTRY], vector[PRODUCTS], vector[ALONG]
    count, own = len(learned), model[ACTION_AT] + a
    along[0] = 0.0
    for p in range(1, len(tree)):
        parent, factor = tree[p, PARENT], tree[p, FACTOR]
        along[p] = along[parent] * entry[factor]
        if factor == own:
            along[p] += product[parent]
    for l in range(count):
        one[l] = 0.0
    for q in range(len(pair)):
        l, j = pair[q, OUTPUT], pair[q, DERIVATIVE]
        held = f[j] if j >= 0 else 1.0
        one[l] += weight[l, pair[q, TERM]] * along[pair[q, NODE]] * held
    solve(room[TABLE][MATRIX], room[INDEX][PIVOT], count, one)
    for i in range(len(model[COMPONENT])):
        column[i] = 0.0
    for l in range(count):
        column[learned[l]] = one[l]


@outer
def slope_jacobian(x, weight, model, room, ds, jacobian):
    """``slope``, and jacobian = df/dx [L, n + m] from (I - N) df = dh + dN f."""
    slope(x, weight, model, room, ds)
    pair, tree, vector = model[PAIR], model[PRODUCT], room[VECTOR]
    entry, product, f, one = vector[ENTRY], vector[PRODUCTS], vector[F], vector[ONE]
    adjoint, by_entry = room[SWEEP][ADJOINT], room[SWEEP][BY_ENTRY]
    n, count = len(model[COMPONENT]), len(model[LEARNED])
    for l in range(count):
        for p in range(adjoint.shape[1]):
            adjoint[l, p] = 0.0
            by_entry[l, p] = 0.0
    for q in range(len(pair)):
        l, j = pair[q, OUTPUT], pair[q, DERIVATIVE]
        held = f[j] if j >= 0 else 1.0
        adjoint[l, pair[q, NODE]] += weight[l, pair[q, TERM]] * held
    for l in range(count):
        for p in range(len(tree) - 1, 0, -1):
            parent, factor = tree[p, PARENT], tree[p, FACTOR]
            by_entry[l, factor] += adjoint[l, p] * product[parent]
            adjoint[l, parent] += adjoint[l, p] * entry[factor]
    for i in range(n + model[ACTIONS]):
        for l in range(count):
            if i >= n:
                one[l] = by_entry[l, model[ACTION_AT] + i - n]
            else:
                one[l] = by_component(by_entry[l], entry, i, model)
        solve(room[TABLE][MATRIX], room[INDEX][PIVOT], count, one)
        for l in range(count):
            jacobian[l, i] = one[l]
