"""Runs of policies in a model with stops and strikes, each until it ends.

form: what the policy's ``gait_raw`` is given.  ends: tuple (always [K, A], landed [R, A],
ground [2, 4 J + 1], hinge [J], friction): rows of the lift that must stay above zero, all the time
and after a strike; weights of the ground's forces, forward and up, by ``ground_features`` of the
angles ``hinge``, nothing where there is none; the greatest ratio of the two.
"""


@outer
def ground_features(entry, x, after, hinge, model, feature):
    """sin a, cos a, sin v^2 and cos v^2 of each angle, v its rate at x and a the mean of its
    acceleration over a tick; and 1."""
    component = model[COMPONENT]
    for j in range(len(hinge)):
        i, at = component[hinge[j], SOURCE], component[hinge[j], AT]
        s, c = entry[at], entry[at + 1]
        a, square = (after[i] - x[i]) / model[SECONDS], x[i] * x[i]
        feature[4 * j], feature[4 * j + 1] = s * a, c * a
        feature[4 * j + 2], feature[4 * j + 3] = s * square, c * square
    feature[4 * len(hinge)] = 1.0


@outer
def is_above(rows, entry):
    """Whether all are above zero."""
    for k in range(len(rows)):
        total = 0.0
        for e in range(len(entry)):
            total += rows[k, e] * entry[e]
        if not total > 0.0:
            return False
    return True


@outer
def is_held(ground, friction, feature):
    """Whether the ground pushes, and holds forward."""
    if len(feature) == 1:
        return True
    forward, up = 0.0, 0.0
    for f in range(len(feature)):
        forward += ground[0, f] * feature[f]
        up += ground[1, f] * feature[f]
    return up > 0.0 and abs(forward) <= friction * up


@outer
def phase_runs(
    start, push, error, theta, weight, model, strike, bounds, form, ends, ticks, strikes
):
    """ticks, strikes [C, P]: made before the end, of policies theta [C, p] from start [P, n], each
    with a weight of its own [P, L, K], push [P, H, m] added to the actions and error [P, H, n] to
    what is read; nan in push ends a run there."""
    always, landed, ground, hinge, friction = ends
    middle, half = bounds
    n, m = start.shape[1], push.shape[2]
    room, x, raw, after = room_for(n, m, model), np.zeros(n + m), np.zeros(m), np.zeros(n)
    seen = np.zeros(n)
    entry, feature = np.zeros(model[ACTION_AT] + m), np.zeros(4 * len(hinge) + 1)
    for c in range(len(theta)):
        for p in range(len(start)):
            ticks[c, p], strikes[c, p] = 0, 0
            for i in range(n):
                x[i] = start[p, i]
            for t in range(push.shape[1]):
                if math.isnan(push[p, t, 0]):
                    break
                for i in range(n):
                    seen[i] = x[i] + error[p, t, i]
                gait_raw(seen, theta[c], form, raw)
                for j in range(m):
                    action = middle[j] + half[j] * math.tanh(raw[j]) + push[p, t, j]
                    x[n + j] = min(max(action, middle[j] - half[j]), middle[j] + half[j])
                lift_into(x, model, entry)
                if not is_above(always, entry):
                    break
                struck_now = striking_tick(x, weight[p], model, strike, room, after)
                # Who strikes again at once has not stepped.
                if not math.isfinite(after.sum()) or struck_now > 1:
                    break
                if struck_now == 0:
                    ground_features(entry, x, after, hinge, model, feature)
                    if not is_held(ground, friction, feature):
                        break
                for i in range(n):
                    x[i] = after[i]
                if struck_now > 0:
                    lift_into(x, model, entry)
                    if not is_above(landed, entry):
                        break
                ticks[c, p] += 1
                strikes[c, p] += struck_now
