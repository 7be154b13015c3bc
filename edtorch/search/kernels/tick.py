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
def step(after, h, weight, model, room):
    """``after`` h seconds later, in place; the action is in room[8]."""
    point, ds, total = room[8], room[9][0], room[9][1]
    n = len(after)
    for stage in range(4):
        part = 0.0 if stage == 0 else (h if stage == 3 else h / 2)
        share = 1.0 if stage in (0, 3) else 2.0
        for i in range(n):
            point[i] = after[i] if stage == 0 else after[i] + part * ds[i]
        stopped_slope(point, weight, model, room, ds)
        for i in range(n):
            total[i] = ds[i] if stage == 0 else total[i] + share * ds[i]
    for i in range(n):
        after[i] += h / 6 * total[i]


@outer
def step_jacobian(after, h, weight, model, room, by):
    """``step``, and by [n, n + m] times its derivative, through every stage."""
    learned, source, ratio = model[2][0], model[2][1], model[2][2]
    jacobian, point, ds, total = room[7], room[8], room[9][0], room[9][1]
    at, change, sums, start = room[10][0], room[10][1], room[10][2], room[10][3]
    n, width = len(after), len(point)
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
        stopped_jacobian(point, weight, model, room, ds)
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
def begin(x, weight, model, room, after):
    """Writes the state at the start, landed on the stops that it is beyond; returns those that are
    shut, and those that press, as bits."""
    point, start, stops = room[8], room[11][6][1], model[3]
    n, bits, pressing = len(after), 0, 0
    for i in range(len(x)):
        point[i] = x[i]
        start[i] = x[i]
    for k in range(len(stops[1])):
        if gap_of(start, k, stops) <= 1e-9 and gap_rate(start, k, model) <= 1e-9:
            bits |= 1 << k
    if bits:
        move_onto(start, bits, stops)
        land(start, bits, False, weight, model, room, room[11][7][2])
        pressing = pressed(room)
        bits = shut_at(start, bits, model)
    shut_by(bits, room[11][0])
    if bits:
        stopped_slope(start, weight, model, room, room[11][7][2])
        pressing |= pressed(room)
    for i in range(n):
        after[i] = start[i]
    return bits, pressing


@outer
def first_hit(before, after, h, bits, model):
    """The fraction of a piece at which the first open stop is hit, and that stop, -1 if none is."""
    stops, earliest, first = model[3], 2.0, -1
    for k in range(len(stops[1])):
        if (bits >> k) & 1 == 1:
            continue
        end, end_rate = gap_of(after, k, stops), gap_rate(after, k, model)
        if end < 0.0 and end_rate < 0.0:
            gap, rate = gap_of(before, k, stops), gap_rate(before, k, model)
            part = crossing(gap, rate * h, end, end_rate * h)
            if part < earliest:
                earliest, first = part, k
    return earliest, first


@outer
def tick(x, weight, model, room, after):
    """after: the state one tick after x.  Writes its pieces to room[11]: their lengths, the stops
    that are shut in each, and the one that is hit at the end of each, -1 for none; returns their
    number.  After ``most`` hits in a tick no more are looked for, so that time always advances."""
    motion, stops = model[2], model[3]
    whole, most, before, end = motion[3] / motion[4], stops[5], room[11][7][3], room[11][6][1]
    length, marks, n = room[11][10], room[11][11], len(after)
    bits, _ = begin(x, weight, model, room, after)
    count, hits, left = 0, 0, motion[3]
    while left > 1e-9 * whole:
        h = min(left, whole)
        for i in range(n):
            before[i] = after[i]
        step(after, h, weight, model, room)
        part, first = 2.0, -1
        if hits < most:
            part, first = first_hit(before, after, h, bits, model)
        length[count], marks[0, count], marks[1, count] = h, bits, first
        if first >= 0:
            hits += 1
            length[count] = h = h * part
            for i in range(n):
                after[i] = before[i]
            step(after, h, weight, model, room)
            for i in range(len(x)):
                end[i] = after[i] if i < n else x[i]
            bits |= 1 << first
            move_onto(end, 1 << first, stops)
            land(end, bits, False, weight, model, room, room[11][7][2])
            for i in range(n):
                after[i] = end[i]
        bits = shut_at(after, bits, model)
        shut_by(bits, room[11][0])
        left -= h
        count += 1
        if count == len(length):
            after[:] = np.nan
            return count
    marks[0, count] = bits
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
def saltation(x, after, landed, bits, then, first, weight, model, room, by):
    """by [n, n + m]: the derivative of the landing of ``after`` on stop ``first``, in time as well;
    bits, then: the stops that are shut before and after."""
    shut, end, normal, slopes = room[11][0], room[11][6][1], model[3][0], room[11][7]
    hit = pressed(room) | (1 << first)
    n, share = len(after), model[3][6]
    for i in range(len(x)):
        end[i] = after[i] if i < n else x[i]
    rate = gap_rate(end, first, model)
    land_jacobian(end, hit, False, weight, model, room, by)
    for k in range(2):
        shut_by(bits if k == 0 else then, shut)
        stopped_slope(end, weight, model, room, slopes[4 + k])
        for i in range(n):
            end[i] = landed[i]
    for i in range(n):
        lag = slopes[5, i]
        for j in range(n):
            lag -= by[i, j] * slopes[4, j]
        slopes[5, i] = share * lag / rate if rate < 0.0 else 0.0
    for i in range(n):
        for j in range(n):
            by[i, j] += slopes[5, i] * normal[first, j]


@outer
def tick_jacobian(x, weight, model, room, after, by):
    """``tick``, and by [n, n + m]: the derivative of ``after`` in x."""
    shut, end, scratch = room[11][0], room[11][6][1], room[11][7][2]
    landing, spare = room[11][9][0], room[11][9][1]
    length, marks = room[11][10], room[11][11]
    n, count = len(after), tick(x, weight, model, room, after)
    for i in range(n):
        for q in range(len(x)):
            by[i, q] = 1.0 if i == q else 0.0
    _, pressing = begin(x, weight, model, room, after)
    if pressing:
        for i in range(len(x)):
            end[i] = x[i]
        land_jacobian(end, pressing, True, weight, model, room, landing)
        times_table(landing, by, spare)
    for p in range(count):
        shut_by(marks[0, p], shut)
        step_jacobian(after, length[p], weight, model, room, by)
        first = marks[1, p]
        if first >= 0:
            bits, then, landed = marks[0, p], marks[0, p + 1], room[11][7][3]
            for i in range(len(x)):
                end[i] = after[i] if i < n else x[i]
            move_onto(end, 1 << first, model[3])
            land(end, bits | (1 << first), False, weight, model, room, scratch)
            for i in range(n):
                landed[i] = end[i]
            saltation(x, after, landed, bits, then, first, weight, model, room, landing)
            times_table(landing, by, spare)
            for i in range(n):
                after[i] = landed[i]


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
