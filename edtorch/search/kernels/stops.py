"""Stops: unilateral constraints on positions, with forces and impulses through columns of actions.

    g_k = normal_k . s - level_k >= 0,   f = f_free + sum_k A_k force_k,   A_k = +- df/du_column(k),

where force_k >= 0 is zero unless the stop is shut and its gap would close, a linear
complementarity problem (Brogliato, "Nonsmooth mechanics", 2016).  A stop that is hit shuts without
rebound: rates change by A_k impulse_k, by the same problem for the rates of the gaps.

Stops that are shut are bits of an integer.
"""


@outer
def gap_of(s, k, model):
    """g_k; of an angle, from an eighth of a turn behind the stop on."""
    stop = model[STOP]
    gap, turn = -stop[k, LEVEL], stop[k, TURN]
    for i in range(len(model[COMPONENT])):
        gap += stop[k, NORMAL + i] * s[i]
    if turn > 0.0:
        gap -= turn * math.floor(gap / turn + 0.125)
    return gap


@outer
def gap_rate(s, k, model):
    """dg_k/dt of a state; its rate, of a derivative of the state."""
    component, total = model[COMPONENT], 0.0
    for i in range(len(component)):
        source = component[i, SOURCE]
        if source >= 0:
            total += model[STOP][k, NORMAL + i] * model[SCALE][i, RATIO] * s[source]
    return total


@outer
def complementary(bits, held, count, room):
    """Writes force >= 0 with w + table force >= 0 and one of them 0 for every stop in ``bits``, nan
    where there is no solution; held: w + table force = 0 whatever the sign of the forces."""
    table, factors, pivot = room[TABLE][BY_FORCE], room[TABLE][FACTORS], room[INDEX][STOP_PIVOT]
    w, force = room[VECTOR][CLOSING], room[VECTOR][FORCE]
    for chosen in range(1 << count):
        if chosen & ~bits or (held and chosen != bits):
            continue
        for k in range(count):
            inside = (chosen >> k) & 1 == 1
            force[k] = -w[k] if inside else 0.0
            for j in range(count):
                both = inside and (chosen >> j) & 1 == 1
                factors[k, j] = table[k, j] if both else (1.0 if k == j else 0.0)
        factorise(factors, pivot, count)
        solve(factors, pivot, count, force)
        fits = True
        for k in range(count):
            left = w[k]
            for j in range(count):
                if (chosen >> j) & 1 == 1:
                    left += table[k, j] * force[j]
            inside = (chosen >> k) & 1 == 1
            if not math.isfinite(force[k]):
                fits = False
            elif (bits >> k) & 1 == 1 and not held:
                fits = fits and (force[k] >= 0.0 if inside else left >= 0.0)
        if fits:
            return
    for k in range(count):
        force[k] = np.nan


@outer
def press(rates, bits, held, weight, model, room):
    """Add to ``rates`` [n], after ``slope``, what the stops ``bits`` do: their forces to a
    derivative of the state, their impulses to a state.  Each A_k has the sign that opens its
    stop."""
    stop, learned = model[STOP], model[LEARNED]
    own, table = room[TABLE][COLUMNS], room[TABLE][BY_FORCE]
    w, force = room[VECTOR][CLOSING], room[VECTOR][FORCE]
    n, count = len(model[COMPONENT]), len(stop)
    for k in range(count):
        w[k] = 0.0
        if (bits >> k) & 1 == 1:
            w[k] = gap_rate(rates, k, model)
            by_action(int(stop[k, COLUMN]), weight, model, room, own[k])
            if gap_rate(own[k], k, model) < 0.0:
                for i in range(n):
                    own[k, i] = -own[k, i]
    for k in range(count):
        for j in range(count):
            if (bits >> k) & (bits >> j) & 1 == 1:
                table[k, j] = gap_rate(own[j], k, model)
    complementary(bits, held, count, room)
    for k in range(count):
        if (bits >> k) & 1 == 1:
            for l in range(len(learned)):
                rates[learned[l]] += own[k, learned[l]] * force[k]


@outer
def stopped_slope(x, bits, weight, model, room, ds):
    """``slope`` with the forces of the stops that are shut."""
    slope(x, weight, model, room, ds)
    if bits:
        press(ds, bits, False, weight, model, room)


@outer
def stopped_jacobian(x, bits, weight, model, room, ds, jacobian):
    """``slope_jacobian``; by central differences where a stop is shut."""
    if bits == 0:
        slope_jacobian(x, weight, model, room, ds, jacobian)
        return
    learned, width, step = model[LEARNED], len(model[COMPONENT]) + model[ACTIONS], 1e-6
    point, ahead, behind = room[VECTOR][NEAR], room[VECTOR][AHEAD], room[VECTOR][BEHIND]
    for q in range(width):
        point[q] = x[q]
    # Both sides of every component, then the middle.
    for c in range(2 * width + 1):
        q, first = c // 2, c % 2 == 0
        if q < width:
            point[q] = x[q] + (step if first else -step)
        stopped_slope(point, bits, weight, model, room, ahead if first else behind)
        if q == width:
            for i in range(len(model[COMPONENT])):
                ds[i] = ahead[i]
        elif not first:
            point[q] = x[q]
            for l in range(len(learned)):
                jacobian[l, q] = (ahead[learned[l]] - behind[learned[l]]) / (2 * step)


@outer
def move_onto(s, bits, model):
    """Move positions onto the stops ``bits``."""
    stop, n = model[STOP], len(model[COMPONENT])
    for k in range(len(stop)):
        if (bits >> k) & 1 == 1:
            size, gap = 0.0, gap_of(s, k, model)
            for i in range(n):
                size += stop[k, NORMAL + i] * stop[k, NORMAL + i]
            for i in range(n):
                s[i] -= stop[k, NORMAL + i] * gap / size


@outer
def land(x, bits, held, weight, model, room):
    """Add the impulses of the stops ``bits`` to the rates in x."""
    slope(x, weight, model, room, room[VECTOR][UNREAD])
    press(x, bits, held, weight, model, room)


@outer
def land_jacobian(x, bits, onto, weight, model, room, by):
    """by [n, n + m] of ``land``, held at the stops ``bits``, by central differences; onto: after
    ``move_onto``."""
    point, ahead, step = room[VECTOR][NEAR], room[VECTOR][AHEAD], 1e-6
    n = len(model[COMPONENT])
    width = n + model[ACTIONS]
    for q in range(width):
        for side in range(2):
            for i in range(width):
                point[i] = x[i]
            point[q] += step if side == 0 else -step
            if onto:
                move_onto(point, bits, model)
            land(point, bits, True, weight, model, room)
            for i in range(n):
                if side == 0:
                    ahead[i] = point[i]
                else:
                    by[i, q] = (ahead[i] - point[i]) / (2 * step)


@outer
def pressed(model, room):
    """The stops whose forces or impulses are not zero, as bits."""
    found, force = 0, room[VECTOR][FORCE]
    for k in range(len(model[STOP])):
        if force[k] > 0.0:
            found |= 1 << k
    return found


@outer
def shut_at(s, bits, model):
    """Of the stops ``bits``, those whose gaps do not open."""
    found = 0
    for k in range(len(model[STOP])):
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
