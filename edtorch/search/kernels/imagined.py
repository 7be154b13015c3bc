"""Roll-outs of a plan, each in a model of its own."""


@outer
def imagine(model, weight, cost, bounds, plan, start, noise, state, value):
    """weight [P, L, K]; plan: tuple (state, raw, gain); noise [P, H, n]: of the readings; state
    [P, H + 1, n] and value [P] are written: inf from where a roll-out is not finite."""
    reference, raw, gain = plan
    middle, half = bounds
    ticks, m = raw.shape
    n = reference.shape[1]
    room, x, shift = room_for(n, m, model), np.zeros(n + m), np.zeros(m)
    for p in range(len(start)):
        for i in range(n):
            state[p, 0, i] = start[p, i]
        value[p] = 0.0
        for t in range(ticks):
            place(x, state[p, t])
            for j in range(m):
                shift[j] = 0.0
                for i in range(n):
                    seen = state[p, t, i] + noise[p, t, i] - reference[t, i]
                    shift[j] += gain[t, j, i] * wrapped(seen, i, model[0])
                x[n + j] = middle[j] + half[j] * math.tanh(raw[t, j] + shift[j])
            value[p] += action_cost(raw[t], shift, cost)
            tick(x, weight[p], model, room, state[p, t + 1])
            place(x, state[p, t + 1])
            value[p] += state_cost(x, t + 1, model, cost, room)
            if not math.isfinite(value[p]):
                value[p] = np.inf
                state[p, t + 1 :] = np.nan
                break
