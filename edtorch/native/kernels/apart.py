"""The learner apart from its world: what it does, and what it learns.

w: everything in float64, one after the other: scratch, what the groups of learners keep, numbers,
and the tape.  Arrays of a call are [B, ...]; what is not given, [0, ...], is as it was.
"""


@inner
def fill(s, row, values, count, number, scale, first):
    """Rows from ``values`` [B, count] divided by number[scale], the learners from ``first`` on;
    beyond the last one it again."""
    if len(values) > 0:
        for l in range(LANES):
            own = min(first + l, len(values) - 1)
            for i in range(count):
                s[(row + i) * LANES + l] = values[own, i] / number[scale + i]


@inner
def group(w, g, groups):
    """Numbers, scratch, what group g keeps, and the tape."""
    kept, size = SCRATCH * LANES, KEPT * LANES
    number = w[kept + groups * size :]
    tape = number[WEIGHTS + int(number[STEPS]) :]
    return number, w[:kept], w[kept + g * size : kept + (g + 1) * size], tape


@outer
def acts(w, k, observation, normal, action):
    """action [B, m] for observation [B, n], normal [B, m] being standard normal numbers."""
    groups = len(k) // (COUNTERS * LANES)
    for g in range(groups):
        number, s, z, _ = group(w, g, groups)
        first = g * LANES
        fill(z, OBSERVATION, observation, N, number, STATE_SCALE, first)
        for l in range(LANES):
            for i in range(M):
                s[(NORMAL + i) * LANES + l] = normal[min(first + l, len(normal) - 1), i]
        drawn = s[NORMAL * LANES : (NORMAL + M) * LANES].reshape((M, 1, LANES)).T
        act(z, k[g * COUNTERS * LANES :], s, number, drawn, 0)
        for l in range(min(LANES, len(action) - first)):
            for i in range(M):
                action[first + l, i] = s[(ACTION + i) * LANES + l] * number[ACTION_SCALE + i]


@outer
def learns(w, k, state, action, following, valid, said, improves):
    """From transitions: state [B, n], action [B, m] and following [B, n], where ``valid`` [B].

    said [B, 6]: SOUND, FIT_OK, VALUE_OK, ERROR, VALUE and NORM.  What followed is what is acted
    upon next.
    """
    groups = len(k) // (COUNTERS * LANES)
    for g in range(groups):
        number, s, z, tape = group(w, g, groups)
        counters, first = k[g * COUNTERS * LANES :], g * LANES
        fill(z, OBSERVATION, state, N, number, STATE_SCALE, first)
        fill(s, ACTION, action, M, number, ACTION_SCALE, first)
        fill(s, NEXT, following, N, number, STATE_SCALE, first)
        for l in range(LANES):
            if UNWRAPS:
                count_on(z, s, number, l)
            is_one = first + l < len(valid) and valid[first + l]
            s[VALID * LANES + l] = 1.0 if is_one else 0.0
        learn(z, counters, s, number)
        if improves:
            improve(z, counters, s, number, tape)
        count_sound(counters, s, improves)
        for l in range(LANES):
            for i in range(N):
                z[(OBSERVATION + i) * LANES + l] = s[(NEXT + i) * LANES + l]
        for l in range(min(LANES, len(said) - first)):
            for i in range(6):
                said[first + l, i] = s[(SOUND + i) * LANES + l]
