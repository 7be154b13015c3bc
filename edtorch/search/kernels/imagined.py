"""Roll-outs of a policy, each in a model of its own.

start [P, n]; noise [P, H, n]: of the readings; state [P, H + 1, n] and value [P] are written, inf
from where a roll-out is not finite.
"""


@outer
def imagined_tick(t, raw, shift, x, weight, model, cost, bounds, room, state):
    """From state[t] to state[t + 1]; returns what that costs."""
    middle, half = bounds
    n = state.shape[1]
    place(x, state[t])
    for j in range(len(raw)):
        x[n + j] = middle[j] + half[j] * math.tanh(raw[j] + shift[j])
    price = action_cost(raw, shift, cost)
    tick(x, weight, model, room, state[t + 1])
    place(x, state[t + 1])
    return price + state_cost(x, t + 1, model, cost, room)


@outer
def imagine(model, weight, cost, bounds, plan, start, noise, state, value):
    """Of a plan: tuple (state, raw, gain).  weight [P, L, K]."""
    reference, raw, gain = plan
    ticks, m = raw.shape
    n = reference.shape[1]
    room, x, shift = room_for(n, m, model), np.zeros(n + m), np.zeros(m)
    for p in range(len(start)):
        for i in range(n):
            state[p, 0, i] = start[p, i]
        value[p] = 0.0
        for t in range(ticks):
            for j in range(m):
                shift[j] = 0.0
                for i in range(n):
                    seen = state[p, t, i] + noise[p, t, i] - reference[t, i]
                    shift[j] += gain[t, j, i] * wrapped(seen, i, model)
            value[p] += imagined_tick(
                t, raw[t], shift, x, weight[p], model, cost, bounds, room, state[p]
            )
            if not math.isfinite(value[p]):
                value[p] = np.inf
                state[p, t + 1 :] = np.nan
                break


@outer
def imagine_knots(model, weight, cost, bounds, knots, start, noise, state, value):
    """Of local policies: tuple (state [k, n], raw [k, m], gain [k, m, n], factor [k], metric [n],
    width), as ``edtorch.policy.knots`` has them.  weight [P, L, K]."""
    reference, knot_raw, gain, factor, metric, width = knots
    count, m = knot_raw.shape
    n = reference.shape[1]
    room, x = room_for(n, m, model), np.zeros(n + m)
    raw, shift = np.zeros(m), np.zeros(m)
    away, square = np.zeros((count, n)), np.zeros(count)
    for p in range(len(start)):
        for i in range(n):
            state[p, 0, i] = start[p, i]
        value[p] = 0.0
        for t in range(noise.shape[1]):
            nearest = 0
            for k in range(count):
                square[k] = 0.0
                for i in range(n):
                    seen = state[p, t, i] + noise[p, t, i] - reference[k, i]
                    away[k, i] = wrapped(seen, i, model)
                    part = away[k, i] / metric[i] * factor[k]
                    square[k] += part * part
                if square[k] < square[nearest]:
                    nearest = k
            raw[:] = 0.0
            shift[:] = 0.0
            total, least = 0.0, square[nearest]
            for k in range(count):
                phi = 1.0 * (k == nearest)
                if width > 0.0:
                    phi = math.exp((least - square[k]) / (2 * width * width))
                total += phi
                for j in range(m):
                    raw[j] += phi * knot_raw[k, j]
                    for i in range(n):
                        shift[j] += phi * gain[k, j, i] * away[k, i]
            for j in range(m):
                raw[j] /= total
                shift[j] /= total
            value[p] += imagined_tick(
                t, raw, shift, x, weight[p], model, cost, bounds, room, state[p]
            )
            if not math.isfinite(value[p]):
                value[p] = np.inf
                state[p, t + 1 :] = np.nan
                break
