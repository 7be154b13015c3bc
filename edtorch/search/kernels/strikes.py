"""The mechanism model over a tick through stops and strikes: ``striking_tick``.

A strike is where height(s) = height . A(s) falls to zero: components and actions change places,
rates become v+ = (I - N)^-1 W phi, and the impulses of the stops that are then shut follow
(``edtorch/model/impact.py``).  strike: tuple (height [A], order [n + m] of components and actions,
jump [n], tree of products of phi [P, 2] and their places in it [F], weight [L, F]).
"""


@outer
def height_and_rate(x, model, strike, room):
    """Of the state and action x, the latter per second."""
    component, height, entry = model[COMPONENT], strike[0], room[VECTOR][ENTRY]
    lift_into(x, model, entry)
    value, rate = 0.0, 0.0
    for a in range(len(height)):
        value += height[a] * entry[a]
    for i in range(len(component)):
        source = component[i, SOURCE]
        if source >= 0:
            along = by_component(height, entry, i, model)
            rate += along * model[SCALE][i, RATIO] * x[source]
    return value, rate


@outer
def strike_part(before, after, h, model, strike, room):
    """The fraction of a piece at which the height falls to zero, 2 if it does not."""
    end, end_rate = height_and_rate(after, model, strike, room)
    if end >= 0.0 or end_rate >= 0.0:
        return 2.0
    value, rate = height_and_rate(before, model, strike, room)
    return crossing(value, rate * h, end, end_rate * h)


@outer
def struck(x, weight, model, strike, room):
    """The state and action x after a strike, without impulses of stops; returns the stops that it
    is at, as bits."""
    _, order, jump, tree, node, by_feature = strike
    learned, old = model[LEARNED], x.copy()
    n, count = len(jump), len(learned)
    for i in range(len(order)):
        x[i] = old[order[i]] + (jump[i] if i < n else 0.0)
    # Leaves A and the factors of I - N in the room.
    slope(x, weight, model, room, room[VECTOR][UNREAD])
    product, rates = np.zeros(len(tree)), np.zeros(count)
    products_into(tree, room[VECTOR][ENTRY], product)
    for l in range(count):
        for k in range(len(node)):
            rates[l] += by_feature[l, k] * product[node[k]]
    solve(room[TABLE][MATRIX], room[INDEX][PIVOT], count, rates)
    for l in range(count):
        x[learned[l]] = rates[l]
    bits = 0
    for k in range(len(model[STOP])):
        if gap_of(x, k, model) <= 1e-9:
            bits |= 1 << k
    return bits


@outer
def striking_tick(x, weight, model, strike, room, after):
    """after: the state one tick after x, nan where the tick did not complete; returns the number of
    strikes.

    As ``tick``, without its marks.  Of hits and strikes together, ``most`` are looked for in a
    tick, so that time always advances.  A strike changes the places of the actions for what is left
    of the tick.
    """
    point, before, end = room[VECTOR][POINT], room[VECTOR][BEFORE], room[VECTOR][END]
    n, stops, whole = len(model[COMPONENT]), len(model[STOP]), model[SECONDS] / model[SUBSTEPS]
    width, events, strikes, left = n + model[ACTIONS], 0, 0, model[SECONDS]
    bits, _ = begin(x, weight, model, room, after)
    for _ in range(model[SUBSTEPS] + model[MOST] + 1):
        if left <= 1e-9 * whole:
            return strikes
        h, part, first = min(left, whole), 2.0, -1
        for i in range(n):
            before[i] = after[i]
        step(after, h, bits, weight, model, room)
        if events < model[MOST]:
            part, first = first_hit(before, after, h, bits, model)
            sooner = strike_part(before, after, h, model, strike, room)
            if sooner < part:
                part, first = sooner, stops
        if first >= 0:
            events += 1
            h *= part
            for i in range(n):
                after[i] = before[i]
            step(after, h, bits, weight, model, room)
            if first < stops:
                at_hit(after, first, bits, weight, model, room)
                bits |= 1 << first
            else:
                strikes += 1
                for i in range(width):
                    end[i] = after[i] if i < n else point[i]
                bits = struck(end, weight, model, strike, room)
                land(end, bits, False, weight, model, room)
            for i in range(width):
                if i < n:
                    after[i] = end[i]
                else:
                    point[i] = end[i]
        bits = shut_at(after, bits, model)
        left -= h
    for i in range(n):
        after[i] = np.nan
    return strikes


@outer
def striking_rollouts(start, action, weight, model, strike, state):
    """state [P, R, H + 1, n] from start [P, R, n] under actions [P, R, H, m], nan from where a tick
    did not complete; each P with a weight of its own [P, L, K]."""
    n, m = start.shape[2], action.shape[3]
    room, x = room_for(n, m, model), np.zeros(n + m)
    for p in range(len(start)):
        for r in range(start.shape[1]):
            course = state[p, r]
            place(course[0], start[p, r])
            for t in range(action.shape[2]):
                place(x, course[t])
                for j in range(m):
                    x[n + j] = action[p, r, t, j]
                striking_tick(x, weight[p], model, strike, room, course[t + 1])
                if not math.isfinite(course[t + 1].sum()):
                    course[t + 1 :] = np.nan
                    break


@outer
def held_paths(x, shut, seconds, weight, model, path):
    """path [N, Q, n]: from x [N, n + m] on, for seconds [N], which may be less than zero; the stops
    ``shut`` [N], as bits, hold where they press."""
    n, nodes = path.shape[2], path.shape[1]
    room, state = room_for(n, model[ACTIONS], model), np.zeros(n)
    for r in range(len(x)):
        place(room[VECTOR][POINT], x[r])
        for i in range(n):
            state[i] = x[r, i]
        for q in range(nodes):
            place(path[r, q], state)
            if q + 1 < nodes:
                step(state, seconds[r] / (nodes - 1), shut[r], weight, model, room)
