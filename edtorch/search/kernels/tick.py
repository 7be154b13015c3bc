"""The mechanism model over one tick, through stops, and its Jacobian.

A tick is a row of pieces, steps of Runge and Kutta's fourth-order method: ``substeps`` of them
without a hit.  One that would cross a stop ends there, and what is left follows.  The pieces are
found first, with the stops that are shut in each, and then differentiated: where a stop is hit, by
the saltation matrix

    S = Dg + (F+ - Dg F-) grad h' / (grad h . F-)

of the landing g on the stop h = 0, F the derivatives of the state before and after (Leine &
Nijmeijer, "Dynamics and bifurcations of non-smooth mechanical systems", 2004, section 7.2).
"""


@outer
def step(after, h, bits, weight, model, room):
    """``after`` h seconds later, in place; the action is in the row POINT of the room."""
    point, ds, total = room[VECTOR][POINT], room[VECTOR][DS], room[VECTOR][TOTAL]
    n = len(model[COMPONENT])
    for stage in range(4):
        part = 0.0 if stage == 0 else (h if stage == 3 else h / 2)
        share = 1.0 if stage in (0, 3) else 2.0
        for i in range(n):
            point[i] = after[i] if stage == 0 else after[i] + part * ds[i]
        stopped_slope(point, bits, weight, model, room, ds)
        for i in range(n):
            total[i] = ds[i] if stage == 0 else total[i] + share * ds[i]
    for i in range(n):
        after[i] += h / 6 * total[i]


@outer
def step_jacobian(after, h, bits, weight, model, room, by):
    """``step``, and by [n, n + m] times its derivative, through every stage."""
    component, scale, learned = model[COMPONENT], model[SCALE], model[LEARNED]
    point, ds, total = room[VECTOR][POINT], room[VECTOR][DS], room[VECTOR][TOTAL]
    table = room[TABLE]
    jacobian, at, change = table[JACOBIAN], table[STAGE], table[CHANGE]
    sums, start = table[SUMS], table[START]
    n = len(component)
    width = n + model[ACTIONS]
    copy_table(start[:n, :width], by)
    for stage in range(4):
        part = 0.0 if stage == 0 else (h if stage == 3 else h / 2)
        share = 1.0 if stage in (0, 3) else 2.0
        for i in range(n):
            point[i] = after[i] if stage == 0 else after[i] + part * ds[i]
            for q in range(width):
                at[i, q] = start[i, q] if stage == 0 else start[i, q] + part * change[i, q]
        stopped_jacobian(point, bits, weight, model, room, ds, jacobian)
        for i in range(n):
            source = component[i, SOURCE]
            for q in range(width):
                change[i, q] = scale[i, RATIO] * at[source, q] if source >= 0 else 0.0
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
def begin(x, weight, model, room, after):
    """Writes the state at the start, landed on the stops that it is beyond, and the action into
    POINT; returns the stops that are shut, and those that press."""
    point, start = room[VECTOR][POINT], room[VECTOR][END]
    n, bits, pressing = len(model[COMPONENT]), 0, 0
    for i in range(n + model[ACTIONS]):
        point[i] = x[i]
        start[i] = x[i]
    for k in range(len(model[STOP])):
        if gap_of(start, k, model) <= 1e-9 and gap_rate(start, k, model) <= 1e-9:
            bits |= 1 << k
    if bits:
        move_onto(start, bits, model)
        land(start, bits, False, weight, model, room)
        pressing = pressed(model, room)
        bits = shut_at(start, bits, model)
    if bits:
        stopped_slope(start, bits, weight, model, room, room[VECTOR][UNREAD])
        pressing |= pressed(model, room)
    for i in range(n):
        after[i] = start[i]
    return bits, pressing


@outer
def first_hit(before, after, h, bits, model):
    """The fraction of a piece at which the first open stop is hit, and that stop, -1 if none is."""
    earliest, first = 2.0, -1
    for k in range(len(model[STOP])):
        if (bits >> k) & 1 == 1:
            continue
        end, end_rate = gap_of(after, k, model), gap_rate(after, k, model)
        if end < 0.0 and end_rate < 0.0:
            gap, rate = gap_of(before, k, model), gap_rate(before, k, model)
            part = crossing(gap, rate * h, end, end_rate * h)
            if part < earliest:
                earliest, first = part, k
    return earliest, first


@outer
def at_hit(after, first, bits, weight, model, room):
    """END: the state ``after`` at the hit of stop ``first``, landed, and the action of POINT."""
    end, n = room[VECTOR][END], len(model[COMPONENT])
    for i in range(n + model[ACTIONS]):
        end[i] = after[i] if i < n else room[VECTOR][POINT][i]
    move_onto(end, 1 << first, model)
    land(end, bits | (1 << first), False, weight, model, room)


@outer
def tick(x, weight, model, room, after):
    """after: the state one tick after x.  Writes its pieces to the room: LENGTH, the stops that are
    SHUT in each, and the one that is HIT at the end of each, -1 for none; returns their number.
    After ``most`` hits in a tick no more are looked for, so that time always advances."""
    before, end, length = room[VECTOR][BEFORE], room[VECTOR][END], room[VECTOR][LENGTH]
    shut, hit, n = room[INDEX][SHUT], room[INDEX][HIT], len(model[COMPONENT])
    whole, most = model[SECONDS] / model[SUBSTEPS], model[SUBSTEPS] + 2 * model[MOST] + 2
    bits, _ = begin(x, weight, model, room, after)
    count, hits, left = 0, 0, model[SECONDS]
    while left > 1e-9 * whole:
        h = min(left, whole)
        for i in range(n):
            before[i] = after[i]
        step(after, h, bits, weight, model, room)
        part, first = 2.0, -1
        if hits < model[MOST]:
            part, first = first_hit(before, after, h, bits, model)
        length[count], shut[count], hit[count] = h, bits, first
        if first >= 0:
            hits += 1
            length[count] = h = h * part
            for i in range(n):
                after[i] = before[i]
            step(after, h, bits, weight, model, room)
            at_hit(after, first, bits, weight, model, room)
            bits |= 1 << first
            for i in range(n):
                after[i] = end[i]
        bits = shut_at(after, bits, model)
        left -= h
        count += 1
        if count == most:
            for i in range(n):
                after[i] = np.nan
            return count
    shut[count] = bits
    return count


@outer
def times_table(left, by, spare):
    """by = left [n, n + m] of (state, action) after by, in place."""
    n, width = by.shape
    for i in range(n):
        for q in range(width):
            spare[i, q] = left[i, q] if q >= n else 0.0
            for j in range(n):
                spare[i, q] += left[i, j] * by[j, q]
    copy_table(by, spare)


@outer
def saltation(after, landed, bits, then, first, weight, model, room, by):
    """by [n, n + m]: the derivative of the landing of ``after`` on stop ``first``, in time as well;
    bits, then: the stops that are shut before and after.  The action is in POINT."""
    end, n, share = room[VECTOR][END], len(model[COMPONENT]), model[SHARE]
    ahead, behind = room[VECTOR][SLOPE_BEFORE], room[VECTOR][SLOPE_AFTER]
    hit = pressed(model, room) | (1 << first)
    for i in range(n + model[ACTIONS]):
        end[i] = after[i] if i < n else room[VECTOR][POINT][i]
    rate = gap_rate(end, first, model)
    land_jacobian(end, hit, False, weight, model, room, by)
    stopped_slope(end, bits, weight, model, room, ahead)
    for i in range(n):
        end[i] = landed[i]
    stopped_slope(end, then, weight, model, room, behind)
    for i in range(n):
        lag = behind[i]
        for j in range(n):
            lag -= by[i, j] * ahead[j]
        behind[i] = share * lag / rate if rate < 0.0 else 0.0
    for i in range(n):
        for j in range(n):
            by[i, j] += behind[i] * model[STOP][first, NORMAL + j]


@outer
def tick_jacobian(x, weight, model, room, after, by):
    """``tick``, and by [n, n + m]: the derivative of ``after`` in x."""
    end, landed, length = room[VECTOR][END], room[VECTOR][BEFORE], room[VECTOR][LENGTH]
    landing, spare = room[TABLE][LANDING], room[TABLE][SPARE]
    shut, hit, n = room[INDEX][SHUT], room[INDEX][HIT], len(model[COMPONENT])
    width, count = n + model[ACTIONS], tick(x, weight, model, room, after)
    for i in range(n):
        for q in range(width):
            by[i, q] = 1.0 if i == q else 0.0
    _, pressing = begin(x, weight, model, room, after)
    if pressing:
        for i in range(width):
            end[i] = x[i]
        land_jacobian(end, pressing, True, weight, model, room, landing)
        times_table(landing, by, spare)
    for p in range(count):
        step_jacobian(after, length[p], shut[p], weight, model, room, by)
        first = hit[p]
        if first >= 0:
            at_hit(after, first, shut[p], weight, model, room)
            for i in range(n):
                landed[i] = end[i]
            saltation(after, landed, shut[p], shut[p + 1], first, weight, model, room, landing)
            times_table(landing, by, spare)
            for i in range(n):
                after[i] = landed[i]


@outer
def ticks(x, weight, model, after):
    """``tick`` of rows x [P, R, n + m], each P with a weight of its own [P, L, K]."""
    room = room_for(after.shape[2], model[ACTIONS], model)
    for p in range(len(x)):
        for r in range(x.shape[1]):
            tick(x[p, r], weight[p], model, room, after[p, r])


@outer
def tick_jacobians(x, weight, model, after, by):
    """``tick_jacobian`` of rows x [R, n + m], all with the same weight."""
    room = room_for(after.shape[1], model[ACTIONS], model)
    for r in range(len(x)):
        tick_jacobian(x[r], weight, model, room, after[r], by[r])
