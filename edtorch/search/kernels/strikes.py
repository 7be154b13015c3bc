"""The mechanism model over a tick through stops and strikes: ``striking_tick``.

A strike is where height(s) = height . A(s) falls to zero: components and actions change places,
rates become v+ = (I - N)^-1 W phi, and the impulses of the stops that are then shut follow
(``edtorch/model/impact.py``).  strike: tuple (height [A], order [n], action_order [m], jump [n],
(parent, factor, node) of phi, weight [L, F]).
"""


@outer
def height_and_rate(x, model, strike, room):
    """Of the state and action x, the latter per second."""
    height, entry, motion = strike[0], room[0], model[2]
    angle, at, unit, _ = model[0]
    source, ratio = motion[1], motion[2]
    lift_into(x, model[0], entry)
    value, rate = 0.0, 0.0
    for a in range(len(entry)):
        value += height[a] * entry[a]
    for i in range(len(angle)):
        if source[i] < 0:
            continue
        along = height[at[i]]
        if angle[i]:
            along = unit[i] * (along * entry[at[i] + 1] - height[at[i] + 1] * entry[at[i]])
        rate += along * ratio[i] * x[source[i]]
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
    _, order, action_order, jump, tree, by_feature = strike
    parent, factor, node = tree
    n, learned, entry, old = len(order), model[2][0], room[0], x.copy()
    for i in range(n):
        x[i] = old[order[i]] + jump[i]
    for j in range(len(action_order)):
        x[n + j] = old[n + action_order[j]]
    # Leaves A in room[0] and the factors of I - N in room[4] and room[5].
    slope(x, weight, model, room, room[11][7][2])
    product, rates = np.zeros(len(parent)), np.zeros(len(learned))
    product[0] = 1.0
    for p in range(1, len(parent)):
        product[p] = product[parent[p]] * entry[factor[p]]
    for l in range(len(learned)):
        for k in range(len(node)):
            rates[l] += by_feature[l, k] * product[node[k]]
    solve(room[4], room[5], rates)
    for l in range(len(learned)):
        x[learned[l]] = rates[l]
    bits = 0
    for k in range(len(model[3][1])):
        if gap_of(x, k, model[3]) <= 1e-9:
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
    motion, stops, point = model[2], model[3], room[8]
    whole, most, before, end = motion[3] / motion[4], stops[5], room[11][7][3], room[11][6][1]
    n, events, strikes, left = len(after), 0, 0, motion[3]
    bits, _ = begin(x, weight, model, room, after)
    for _ in range(motion[4] + most + 1):
        if left <= 1e-9 * whole:
            return strikes
        h, part, first = min(left, whole), 2.0, -1
        for i in range(n):
            before[i] = after[i]
        step(after, h, weight, model, room)
        if events < most:
            part, first = first_hit(before, after, h, bits, model)
            sooner = strike_part(before, after, h, model, strike, room)
            if sooner < part:
                part, first = sooner, len(stops[1])
        if first >= 0:
            events += 1
            h *= part
            for i in range(n):
                after[i] = before[i]
            step(after, h, weight, model, room)
            for i in range(len(x)):
                end[i] = after[i] if i < n else point[i]
            if first < len(stops[1]):
                bits |= 1 << first
                move_onto(end, 1 << first, stops)
            else:
                strikes += 1
                bits = struck(end, weight, model, strike, room)
            land(end, bits, False, weight, model, room, room[11][7][2])
            for i in range(len(x)):
                if i < n:
                    after[i] = end[i]
                else:
                    point[i] = end[i]
        bits = shut_at(after, bits, model)
        shut_by(bits, room[11][0])
        left -= h
    after[:] = np.nan
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
            course[0] = start[p, r]
            for t in range(action.shape[2]):
                for i in range(n):
                    x[i] = course[t, i]
                for j in range(m):
                    x[n + j] = action[p, r, t, j]
                striking_tick(x, weight[p], model, strike, room, course[t + 1])
                if not math.isfinite(course[t + 1].sum()):
                    course[t + 1 :] = np.nan
                    break


@outer
def held_paths(x, shut, seconds, weight, model, path):
    """path [N, Q, n]: from x [N, n + m] on, for seconds [N], which may be less than zero; the stops
    shut [N, K] hold where they press."""
    n, nodes = path.shape[2], path.shape[1]
    room, state = room_for(n, x.shape[1] - n, model), np.zeros(n)
    for r in range(len(x)):
        for i in range(x.shape[1]):
            room[8][i] = x[r, i]
        for k in range(shut.shape[1]):
            room[11][0][k] = shut[r, k]
        for i in range(n):
            state[i] = x[r, i]
        for q in range(nodes):
            for i in range(n):
                path[r, q, i] = state[i]
            if q + 1 < nodes:
                step(state, seconds[r] / (nodes - 1), weight, model, room)
