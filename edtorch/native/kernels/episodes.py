"""Episodes of linear policies that do not learn, LANES at a time; a lane that is free takes the
next one.  Their random numbers are those of ``edtorch.run.hashing``."""


@inner
def begin(z, k, s, number, constants, weight, key, state, e, clock, l):
    """Episode ``e`` in lane l, its first tick being clock + 1."""
    for i in range(WIDTH):
        z[(WORLD + i) * LANES + l] = state[e, i]
    for i in range(M * KP):
        z[(THETA + i) * LANES + l] = weight[e, i]
    for i in range(SUMMED):
        z[(SUMS + i) * LANES + l] = 0.0
    k[KEY * LANES + l], k[(KEY + 1) * LANES + l] = key[e, 0], key[e, 1]
    k[EPISODE * LANES + l], k[BEGUN * LANES + l], k[ACTIVE * LANES + l] = e, clock, 1
    store_seen(z, OBSERVATION, number, observe(state_at(z, WORLD, l), constants), l)


@inner
def draw(k, uniform, normal, clock):
    """The numbers of a tick."""
    for l in range(LANES):
        first, second = k[KEY * LANES + l], k[(KEY + 1) * LANES + l]
        counter = (clock - k[BEGUN * LANES + l]) * (UNIFORMS + 2 * PAIRS)
        for i in range(DISTURBANCES):
            uniform[l, 0, i] = hashed(first, second, counter + i)
        for i in range(PAIRS):
            u = hashed(first, second, counter + UNIFORMS + i)
            angle = 2 * math.pi * hashed(first, second, counter + UNIFORMS + PAIRS + i)
            radius = math.sqrt(-2 * math.log1p(-u))
            normal[l, 0, i] = radius * math.cos(angle)
            if PAIRS + i < M:
                normal[l, 0, PAIRS + i] = radius * math.sin(angle)


@inner
def no_sums(z, k, s, number, normal, clock):
    """Nothing is added up."""


@inner
def return_sums(z, k, s, number, normal, clock):
    """``edtorch.rivals.returns.Return``."""
    for l in range(LANES):
        earned = number[TICK] * reward(z, s, number, l)
        if number[LOG_DISCOUNT] != 0:
            seconds = number[TICK] * (clock - k[BEGUN * LANES + l] - 1)
            earned *= math.exp(number[LOG_DISCOUNT] * seconds)
        z[SUMS * LANES + l] += earned


@inner
def likelihood_sums(z, k, s, number, normal, clock):
    """``edtorch.rivals.reinforce.LikelihoodRatio``: z and sum r z [P]; y and sum r y [Q]; sum of
    score psi' [P, Q] and of psi psi' [Q, Q]."""
    discount, deviation = number[DISCOUNT], number[DEVIATION]
    for l in range(LANES):
        earned = number[TICK] * reward(z, s, number, l)
        row = SUMS + 2 * M * KP
        for i in range(1 + N):
            psi = psi_of(z, i, l)
            y = discount * z[(row + i) * LANES + l] + psi
            z[(row + i) * LANES + l] = y
            z[(row + 1 + N + i) * LANES + l] += earned * y
            at = row + 2 * (1 + N) + M * KP * (1 + N) + i * (1 + N)
            for j in range(1 + N):
                z[(at + j) * LANES + l] += psi * psi_of(z, j, l)
        for i in range(M):
            for j in range(KP):
                phi = 1.0
                if j >= POLICY_CONSTANT:
                    phi = z[(OBSERVATION + j - POLICY_CONSTANT) * LANES + l]
                score = normal[l, 0, i] * phi / deviation
                p = i * KP + j
                trace = discount * z[(SUMS + p) * LANES + l] + score
                z[(SUMS + p) * LANES + l] = trace
                z[(SUMS + M * KP + p) * LANES + l] += earned * trace
                at = row + 2 * (1 + N) + p * (1 + N)
                for q in range(1 + N):
                    z[(at + q) * LANES + l] += score * psi_of(z, q, l)


@inner
def psi_of(z, i, l):
    """Component i of psi: 1, then the squares of the observation."""
    if i == 0:
        return 1.0
    seen = z[(OBSERVATION + i - 1) * LANES + l]
    return seen * seen


@outer
def episodes(
    z, k, s, number, constants, uniform, normal, weight, key, state, ended, sums, order, first,
    done, clock, count
):  # fmt: skip
    """Ticks clock + 1 to clock + count, fewer when all episodes are over.

    weight [E, M KP], key [E, 2], state [E, WIDTH]: of the episodes, of which ``first`` have begun
    and ``done`` are over; those have their outcome and ticks in ``ended`` [E, 2], their last state
    in ``state``, ``sums`` [E, SUMMED], and are listed in ``order``.  Returns how many have begun,
    are over, and the ticks that all of them made.
    """
    made, living = 0, first - done
    for now in range(clock + 1, clock + count + 1):
        if living < LANES:
            for l in range(LANES):
                if k[ACTIVE * LANES + l] == 0 and first < len(key):
                    begin(z, k, s, number, constants, weight, key, state, first, now - 1, l)
                    first += 1
                    living += 1
            if living == 0:
                break
        draw(k, uniform, normal, now)
        act(z, k, s, number, normal, 0)
        live(z, k, s, number, constants, uniform, now, 0)
        add(z, k, s, number, normal, now)
        advance(z, s)
        made += living
        for l in range(LANES):
            outcome = int(s[OUTCOME * LANES + l])
            if outcome == RUNNING:
                continue
            e = k[EPISODE * LANES + l]
            ended[e, 0], ended[e, 1] = outcome, now - k[BEGUN * LANES + l]
            for i in range(WIDTH):
                state[e, i] = z[(WORLD + i) * LANES + l]
            for i in range(SUMMED):
                sums[e, i] = z[(SUMS + i) * LANES + l]
            order[done] = e
            done += 1
            living -= 1
            k[ACTIVE * LANES + l] = 0
    return first, done, made
