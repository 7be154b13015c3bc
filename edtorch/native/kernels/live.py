"""A tick in the world: act, step, observe, and begin new episodes."""


@inner
def smaller(a, b):
    """As torch.minimum: NaN if either is."""
    return a if a < b or a != a else b


@inner
def larger(a, b):
    """As torch.maximum."""
    return a if a > b or a != a else b


@inner
def act(z, k, s, number, normal, t):
    """ACTION = clip(pi(OBSERVATION) + deviation normal), scaled."""
    for l in range(LANES):
        deviation = number[DEVIATION + 1]
        if ANNEALED:
            age = float(k[AGE * LANES + l])
            deviation = annealed(number[DEVIATION], deviation, number[DEVIATION + 2], age)
        s[DEVIATE * LANES + l] = deviation
    for l in range(LANES):
        for i in range(M):
            x = z[(THETA + i * KP) * LANES + l] if POLICY_CONSTANT else 0.0
            for j in range(N):
                seen = z[(OBSERVATION + j) * LANES + l]
                if LIMITED:
                    limit = z[(LIMIT + j) * LANES + l]
                    seen = smaller(larger(seen, -limit), limit)
                x += z[(THETA + i * KP + POLICY_CONSTANT + j) * LANES + l] * seen
            if EXPLORES:
                x += s[DEVIATE * LANES + l] * normal[l, t, i]
            if CLIPS:
                x = smaller(larger(x, number[LOW + i]), number[HIGH + i])
            s[(ACTION + i) * LANES + l] = x


@inner
def count_on(z, s, number, l):
    """NEXT: ``edtorch.run.scaled_sim.World.counted`` of what was seen, in scaled units."""
    for i in range(N):
        wrapped = s[(NEXT + i) * LANES + l]
        turns = np.rint((z[(OBSERVATION + i) * LANES + l] - wrapped) * number[UNWRAP_TURNS + i])
        unwrapped = wrapped + turns * number[UNWRAP_PERIOD + i]
        if abs(unwrapped) <= number[FARTHEST + i]:
            wrapped = unwrapped
        s[(NEXT + i) * LANES + l] = wrapped


@inner
def move(z, s, number, constants, uniform, t):
    """A step of every world, OUTCOME, NEXT and VALID; WORLD only where LIVES."""
    for l in range(LANES):
        here = state_at(z, WORLD, l)
        there = world_step(here, action_at(s, number, l), uniforms_at(uniform, l, t), constants)
        store_seen(s, NEXT, number, observe(there, constants), l)
        s[VALID * LANES + l] = 1.0 if applies(there, constants) else 0.0
        s[OUTCOME * LANES + l] = float(outcome_of(there, constants))
        store_moved(z, WORLD, here, there, s[LIVES * LANES + l] != 0, l)


@inner
def live(z, k, s, number, constants, uniform, clock, t):
    """The worlds of the active learners, a tick on: WORLD, NEXT, VALID, EARNED, OUTCOME."""
    for l in range(LANES):
        s[LIVES * LANES + l] = 1.0 if k[ACTIVE * LANES + l] != 0 else 0.0
    move(z, s, number, constants, uniform, t)
    for l in range(LANES):
        if s[LIVES * LANES + l] == 0:
            s[OUTCOME * LANES + l] = 0.0
            s[VALID * LANES + l] = 0.0
            for i in range(N):
                s[(NEXT + i) * LANES + l] = z[(OBSERVATION + i) * LANES + l]
            continue
        if UNWRAPS:
            count_on(z, s, number, l)
        if EARNS:
            z[EARNED * LANES + l] += number[TICK] * reward(z, s, number, l)
        outcome = int(s[OUTCOME * LANES + l])
        if outcome == RUNNING and clock - k[BEGUN * LANES + l] >= number[LIMIT_TICKS]:
            outcome = TIMED_OUT
        if RETURN_DECIDES and outcome != RUNNING and z[EARNED * LANES + l] >= number[LEAST_RETURN]:
            outcome = SUCCEEDED
        s[OUTCOME * LANES + l] = float(outcome)


@inner
def reward(z, s, number, l):
    """Minus the quadratic cost of observation and action."""
    cost = number[RETURN_CONSTANT]
    for i in range(N):
        here = z[(OBSERVATION + i) * LANES + l]
        x = 2 * number[RETURN_LINEAR + i]
        for j in range(N):
            x += number[RETURN_STATE + i * N + j] * z[(OBSERVATION + j) * LANES + l]
        for j in range(M):
            x += 2 * number[RETURN_CROSS + i * M + j] * s[(ACTION + j) * LANES + l]
        cost += x * here
    for i in range(M):
        x = 2 * number[RETURN_LINEAR + N + i]
        for j in range(M):
            x += number[RETURN_ACTION + i * M + j] * s[(ACTION + j) * LANES + l]
        cost += x * s[(ACTION + i) * LANES + l]
    return -cost


@inner
def advance(z, s):
    """The observation of the next tick."""
    for i in range(N):
        for l in range(LANES):
            old, new = z[(OBSERVATION + i) * LANES + l], s[(NEXT + i) * LANES + l]
            z[(OBSERVATION + i) * LANES + l] = new if s[LIVES * LANES + l] > 0 else old


@inner
def turn(z, k, s, number, constants, uniform, clock, t, first, events, ended):
    """Record the episodes that have ended, and begin new ones within the budget.

    A row of ``events``: tick, learner, outcome, tick at which the episode began, its number, its
    return, its first and its last state.
    """
    for l in range(LANES):
        outcome = int(s[OUTCOME * LANES + l])
        if outcome == RUNNING:
            continue
        event = events[ended]
        ended += 1
        event[0], event[1], event[2] = float(clock), float(first + l), float(outcome)
        event[3], event[4] = float(k[BEGUN * LANES + l]), float(k[EPISODES * LANES + l])
        event[5] = z[EARNED * LANES + l]
        for i in range(WIDTH):
            event[6 + i] = z[(START + i) * LANES + l]
            event[6 + WIDTH + i] = z[(WORLD + i) * LANES + l]
        k[EPISODES * LANES + l] += 1
        k[FAILURES * LANES + l] += 1 if outcome == FAILED else 0
        late = LATE_SUCCEEDS and outcome == TIMED_OUT
        k[SUCCESSES * LANES + l] += 1 if outcome == SUCCEEDED or late else 0
        within = k[EPISODES * LANES + l] < number[MOST_EPISODES]
        if not (within and k[SUCCESSES * LANES + l] < number[MOST_SUCCESSES]):
            k[ACTIVE * LANES + l] = 0
            continue
        here = start(state_at(z, WORLD, l), resets_at(uniform, l, t), constants)
        store_state(z, WORLD, here, l)
        store_state(z, START, here, l)
        store_seen(z, OBSERVATION, number, observe(here, constants), l)
        k[BEGUN * LANES + l] = clock
        z[EARNED * LANES + l] = 0.0
    return ended
