"""Stops: unilateral constraints on positions, with forces and impulses through columns of actions.

    g_k = normal_k . s - level_k >= 0,   f = f_free + sum_k A_k force_k,   A_k = +- df/du_column(k),

where force_k >= 0 is zero unless the stop is shut and its gap would close, a linear
complementarity problem (Brogliato, "Nonsmooth mechanics", 2016).  A stop that is hit shuts without
rebound: rates change by A_k impulse_k, by the same problem for the rates of the gaps.

stops: tuple (normal [K, n], level [K], turn [K], column [K], ahead [K, L], most, share).  turn: of
a gap that is an angle, else 0; ahead: of the gaps' rates by what is learned; most: hits in a tick;
share: of the saltation in Jacobians, 1.
"""


@outer
def gap_of(s, k, stops):
    """g_k; of an angle, from an eighth of a turn behind the stop on."""
    normal, level, turn = stops[0], stops[1], stops[2]
    gap = -level[k]
    for i in range(normal.shape[1]):
        gap += normal[k, i] * s[i]
    if turn[k] > 0.0:
        gap -= turn[k] * math.floor(gap / turn[k] + 0.125)
    return gap


@outer
def gap_rate(s, k, model):
    """dg_k/dt."""
    learned, ahead, total = model[2][0], model[3][4], 0.0
    for l in range(len(learned)):
        total += ahead[k, l] * s[learned[l]]
    return total


@outer
def complementary(shut, held, room):
    """Writes force >= 0 with w + table force >= 0 and one of them 0 for every shut stop, nan where
    there is no solution; held: w + table force = 0 whatever the sign of the forces."""
    table, w, force, factors, pivot = room[2], room[3][0], room[3][1], room[4], room[5]
    count = len(shut)
    for chosen in range(1 << count):
        fits = True
        for k in range(count):
            inside = (chosen >> k) & 1 == 1
            fits = fits and (shut[k] or not inside) and (inside or not (held and shut[k]))
            force[k] = -w[k] if inside else 0.0
            for j in range(count):
                both = inside and (chosen >> j) & 1 == 1
                factors[k, j] = table[k, j] if both else (1.0 if k == j else 0.0)
        if not fits:
            continue
        factorise(factors, pivot)
        solve(factors, pivot, force)
        for k in range(count):
            left = w[k]
            for j in range(count):
                left += table[k, j] * force[j]
            inside = (chosen >> k) & 1 == 1
            if not math.isfinite(force[k]):
                fits = False
            elif shut[k] and not held:
                fits = fits and (force[k] >= 0.0 if inside else left >= 0.0)
        if fits:
            return
    for k in range(count):
        force[k] = np.nan


@outer
def columns_of(model, n, room):
    """A_k from the Jacobian in room[7], each with the sign that opens its stop, and the table of
    gap k's change by A_j."""
    jacobian, own, table = room[7], room[11][1], room[11][2]
    column, ahead = model[3][3], model[3][4]
    for k in range(len(column)):
        opening = 0.0
        for l in range(own.shape[1]):
            own[k, l] = jacobian[l, n + column[k]]
            opening += ahead[k, l] * own[k, l]
        if opening < 0.0:
            for l in range(own.shape[1]):
                own[k, l] = -own[k, l]
    for k in range(len(column)):
        for j in range(len(column)):
            table[k, j] = 0.0
            for l in range(own.shape[1]):
                table[k, j] += ahead[k, l] * own[j, l]


@outer
def any_shut(shut):
    """Whether one is."""
    for k in range(len(shut)):
        if shut[k]:
            return True
    return False


@outer
def stopped_slope(x, weight, model, room, ds):
    """``slope`` with the forces of the stops that are shut."""
    shut, own, w, force = room[11][0], room[11][1], room[11][3][0], room[11][3][1]
    if not any_shut(shut):
        slope(x, weight, model, room, ds)
        return
    learned = model[2][0]
    slope_jacobian(x, weight, model, room, ds)
    columns_of(model, len(ds), room)
    for k in range(len(shut)):
        w[k] = gap_rate(ds, k, model)
    complementary(shut, False, room[11])
    for k in range(len(shut)):
        for l in range(len(learned)):
            ds[learned[l]] += own[k, l] * force[k]


@outer
def stopped_jacobian(x, weight, model, room, ds):
    """``slope_jacobian``; by central differences where a stop is shut."""
    shut, point, ends, table = room[11][0], room[11][6][0], room[11][7], room[11][8]
    if not any_shut(shut):
        slope_jacobian(x, weight, model, room, ds)
        return
    learned, step = model[2][0], 1e-6
    for q in range(len(x)):
        point[q] = x[q]
    # Both sides of every component, then the middle.
    for c in range(2 * len(x) + 1):
        q, side = c // 2, c % 2
        end = ds
        if q < len(x):
            point[q] = x[q] + (step if side == 0 else -step)
            end = ends[side]
        stopped_slope(point, weight, model, room, end)
        if q < len(x):
            point[q] = x[q]
            if side == 1:
                for l in range(len(learned)):
                    table[l, q] = (ends[0, learned[l]] - ends[1, learned[l]]) / (2 * step)
    for l in range(len(learned)):
        for q in range(len(x)):
            room[7][l, q] = table[l, q]


@outer
def shut_by(bits, shut):
    """shut = bits."""
    for k in range(len(shut)):
        shut[k] = (bits >> k) & 1 == 1


@outer
def move_onto(s, bits, stops):
    """Move positions onto the stops ``bits``."""
    normal = stops[0]
    for k in range(len(normal)):
        if (bits >> k) & 1 == 1:
            size, gap = 0.0, gap_of(s, k, stops)
            for i in range(normal.shape[1]):
                size += normal[k, i] * normal[k, i]
            for i in range(normal.shape[1]):
                s[i] -= normal[k, i] * gap / size


@outer
def land(x, bits, held, weight, model, room, ds):
    """Add the impulses of the stops ``bits`` to the rates in x."""
    learned, n = model[2][0], len(ds)
    shut, own, w, force = room[11][0], room[11][1], room[11][3][0], room[11][3][1]
    shut_by(bits, shut)
    slope_jacobian(x, weight, model, room, ds)
    columns_of(model, n, room)
    for k in range(len(shut)):
        w[k] = gap_rate(x, k, model)
    complementary(shut, held, room[11])
    for k in range(len(shut)):
        for l in range(len(learned)):
            x[learned[l]] += own[k, l] * force[k]


@outer
def land_jacobian(x, bits, onto, weight, model, room, by):
    """by [n, n + m] of ``land``, held at the stops ``bits``, by central differences; onto: after
    ``move_onto``."""
    point, ends, step = room[11][6][0], room[11][7], 1e-6
    for q in range(len(x)):
        for side in range(2):
            for i in range(len(x)):
                point[i] = x[i]
            point[q] += step if side == 0 else -step
            if onto:
                move_onto(point, bits, model[3])
            land(point, bits, True, weight, model, room, ends[2])
            for i in range(len(by)):
                ends[side, i] = point[i]
        for i in range(len(by)):
            by[i, q] = (ends[0, i] - ends[1, i]) / (2 * step)


@outer
def pressed(room):
    """The stops whose forces or impulses are not zero, as bits."""
    found, force = 0, room[11][3][1]
    for k in range(len(force)):
        if force[k] > 0.0:
            found |= 1 << k
    return found


@outer
def shut_at(s, bits, model):
    """Of the stops ``bits``, those whose gaps do not open."""
    found = 0
    for k in range(len(model[3][1])):
        if (bits >> k) & 1 == 1 and gap_rate(s, k, model) <= 1e-9:
            found |= 1 << k
    return found


@outer
def crossing(gap, change, end, end_change):
    """Where in [0, 1] the cubic with these values and slopes at 0 and 1 becomes negative, 0 if it
    does at once: by bisection, to the last digit of a float."""
    if gap <= 0.0 and change <= 0.0:
        return 0.0
    low, high = 0.0, 1.0
    for _ in range(50):
        t = 0.5 * (low + high)
        value = (1 + 2 * t) * (1 - t) * (1 - t) * gap + t * (1 - t) * (1 - t) * change
        value += t * t * (3 - 2 * t) * end - t * t * (1 - t) * end_change
        if value < 0.0:
            high = t
        else:
            low = t
    return high
