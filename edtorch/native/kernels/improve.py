"""Steps 3 to 7 of Fig. 1: the value of an unroll, its gradient, and the step of the policy."""


@inner
def open_loop(z, s, number, dt):
    """INPUT G, GAINS theta and DRIFT of the loop over ``dt``, of A states: (1, s) or s."""
    for l in range(LANES):
        for i in range(M):
            if AFFINE:
                constant = z[(THETA + i * KP) * LANES + l] if POLICY_CONSTANT else 0.0
                s[(GAINS + i * A) * LANES + l] = constant
            for j in range(N):
                x = z[(THETA + i * KP + POLICY_CONSTANT + j) * LANES + l]
                s[(GAINS + i * A + AFFINE + j) * LANES + l] = x
        for i in range(N):
            for j in range(M):
                x = z[(WEIGHT + i * K + MODEL_CONSTANT + N + j) * LANES + l]
                s[(INPUT + (AFFINE + i) * M + j) * LANES + l] = dt * x if INTEGRATES else x
        if AFFINE:
            for j in range(M):
                s[(INPUT + j) * LANES + l] = 0.0
            for j in range(A):
                s[(DRIFT + j) * LANES + l] = 0.0
    for l in range(LANES):
        for i in range(N):
            for j in range(A):
                if AFFINE and j == 0:
                    x = z[(WEIGHT + i * K) * LANES + l] if MODEL_CONSTANT else 0.0
                else:
                    x = z[(WEIGHT + i * K + MODEL_CONSTANT + j - AFFINE) * LANES + l]
                x = dt * x if INTEGRATES else x
                if not INTEGRATES and j == i + AFFINE:
                    x -= 1.0
                s[(DRIFT + (AFFINE + i) * A + j) * LANES + l] = x


@inner
def closed_loop(z, s, number, dt):
    """``open_loop``, and G theta added to DRIFT."""
    open_loop(z, s, number, dt)
    for l in range(LANES):
        for i in range(N):
            for j in range(A):
                x = s[(DRIFT + (AFFINE + i) * A + j) * LANES + l]
                for q in range(M):
                    x += (
                        s[(INPUT + (AFFINE + i) * M + q) * LANES + l]
                        * s[(GAINS + q * A + j) * LANES + l]
                    )
                s[(DRIFT + (AFFINE + i) * A + j) * LANES + l] = x


@inner
def moved(s, out):
    """out = X + DRIFT X, a matrix: half a step of second moments, ``spread`` the other half."""
    for l in range(LANES):
        for i in range(A):
            for j in range(A):
                x = s[(X + i * A + j) * LANES + l]
                for q in range(A):
                    x += s[(DRIFT + i * A + q) * LANES + l] * s[(X + q * A + j) * LANES + l]
                out[(i * A + j) * LANES + l] = x


@inner
def spread(s, half):
    """X = half + half DRIFT' + OVER_STEP, which is symmetric."""
    for l in range(LANES):
        for i in range(A):
            for j in range(i + 1):
                x = half[(i * A + j) * LANES + l] + s[(OVER_STEP + i * A + j) * LANES + l]
                for q in range(A):
                    x += half[(i * A + q) * LANES + l] * s[(DRIFT + j * A + q) * LANES + l]
                s[(X + i * A + j) * LANES + l] = x
                s[(X + j * A + i) * LANES + l] = x


@inner
def pushed_back(s):
    """Y = X + X DRIFT: half a step back of an adjoint, or of a cost to go."""
    for l in range(LANES):
        for i in range(A):
            for j in range(A):
                x = s[(X + i * A + j) * LANES + l]
                for q in range(A):
                    x += s[(X + i * A + q) * LANES + l] * s[(DRIFT + q * A + j) * LANES + l]
                s[(Y + i * A + j) * LANES + l] = x


@inner
def loop_cost(s, number):
    """COST = Q + theta'R theta + N theta + theta'N'; PRICED = R theta + N'."""
    if PRICED_ACTIONS:
        for l in range(LANES):
            for i in range(M):
                for j in range(A):
                    x = number[CROSS_COST + j * M + i]
                    for q in range(M):
                        x += number[ACTION_COST + i * M + q] * s[(GAINS + q * A + j) * LANES + l]
                    s[(PRICED + i * A + j) * LANES + l] = x
    for l in range(LANES):
        for i in range(A):
            for j in range(A):
                x = number[STATE_COST + i * A + j]
                if PRICED_ACTIONS:
                    for q in range(M):
                        x += (
                            s[(GAINS + q * A + i) * LANES + l] * s[(PRICED + q * A + j) * LANES + l]
                        )
                        x += number[CROSS_COST + i * M + q] * s[(GAINS + q * A + j) * LANES + l]
                s[(COST + i * A + j) * LANES + l] = x


@inner
def start_of(s, number, i, l):
    """Component i of the state that the unroll begins with."""
    if AFFINE and i == 0:
        return 1.0
    if FROM_ORIGIN:
        return number[ORIGIN + i - AFFINE]
    return s[(END + i - AFFINE) * LANES + l]


@inner
def project(s):
    """GRADIENT = G' THROUGH, in the policy's own parameters, is left in FULL [M, A]."""
    for l in range(LANES):
        for i in range(M):
            for j in range(A):
                x = 0.0
                for q in range(AFFINE, A):
                    x += s[(INPUT + q * M + i) * LANES + l] * s[(THROUGH + q * A + j) * LANES + l]
                s[(FULL + i * A + j) * LANES + l] = x


@inner
def of_parameters(s):
    """The gradient of the policy's parameters from that of the gain, FULL."""
    first = 0 if POLICY_CONSTANT or not AFFINE else 1
    for l in range(LANES):
        for i in range(M):
            for j in range(KP):
                s[(GRADIENT + i * KP + j) * LANES + l] = s[(FULL + i * A + first + j) * LANES + l]


@inner
def mean_value(z, s, number, tape):
    """``edtorch.value.linear.mean``, step by step, by increments."""
    closed_loop(z, s, number, number[UNROLL_TICK])
    if not DIAGONAL or PRICED_ACTIONS:
        loop_cost(s, number)
    steps = int(number[STEPS])
    for l in range(LANES):
        for i in range(A):
            tape[i * LANES + l] = start_of(s, number, i, l)
            s[(ADJOINT + i) * LANES + l] = 0.0
            for j in range(A):
                s[(THROUGH + i * A + j) * LANES + l] = 0.0
                if PRICED_ACTIONS:
                    s[(MOMENT + i * A + j) * LANES + l] = 0.0
        s[VALUE * LANES + l] = 0.0
    for t in range(steps):
        path = tape[t * A * LANES :]
        for l in range(LANES):
            for i in range(A):
                x = path[i * LANES + l]
                for j in range(A):
                    x += s[(DRIFT + i * A + j) * LANES + l] * path[j * LANES + l]
                path[(A + i) * LANES + l] = x
    for t in range(steps, 0, -1):
        path = tape[(t - 1) * A * LANES :]
        weight = number[WEIGHTS + t - 1]
        for l in range(LANES):
            total = s[VALUE * LANES + l]
            for i in range(A):
                here = path[(A + i) * LANES + l]
                if DIAGONAL and not PRICED_ACTIONS:
                    pull = number[STATE_COST + i * A + i] * here
                else:
                    pull = 0.0
                    for j in range(A):
                        pull += s[(COST + i * A + j) * LANES + l] * path[(A + j) * LANES + l]
                pull *= weight
                total -= pull * here
                x = s[(ADJOINT + i) * LANES + l] - 2 * pull
                for j in range(A):
                    x += s[(DRIFT + j * A + i) * LANES + l] * s[(ADJOINT + j) * LANES + l]
                s[(PULLED + i) * LANES + l] = x
            s[VALUE * LANES + l] = total
        for l in range(LANES):
            for i in range(A):
                x = s[(PULLED + i) * LANES + l]
                s[(ADJOINT + i) * LANES + l] = x
                for j in range(A):
                    s[(THROUGH + i * A + j) * LANES + l] += x * path[j * LANES + l]
        if PRICED_ACTIONS:
            for l in range(LANES):
                for i in range(A):
                    for j in range(A):
                        s[(MOMENT + i * A + j) * LANES + l] += (
                            weight * path[(A + i) * LANES + l] * path[(A + j) * LANES + l]
                        )
    project(s)
    price(s)
    of_parameters(s)


@inner
def price(s):
    """What actions cost of themselves: FULL -= 2 PRICED MOMENT."""
    if PRICED_ACTIONS:
        for l in range(LANES):
            for i in range(M):
                for j in range(A):
                    x = 0.0
                    for q in range(A):
                        x += (
                            s[(PRICED + i * A + q) * LANES + l]
                            * s[(MOMENT + q * A + j) * LANES + l]
                        )
                    s[(FULL + i * A + j) * LANES + l] -= 2 * x


@inner
def moment_value(z, s, number, tape):
    """``edtorch.value.linear.moment``: second moments X and their adjoints, both symmetric."""
    closed_loop(z, s, number, number[UNROLL_TICK])
    loop_cost(s, number)
    steps = int(number[STEPS])
    scale = number[UNROLL_TICK] if INTEGRATES else 1.0
    for l in range(LANES):
        for i in range(A):
            for j in range(A):
                x = 0.0
                noise = 0.0
                if i >= AFFINE and j >= AFFINE:
                    x = number[START_COV + (i - AFFINE) * N + j - AFFINE]
                    noise = scale * z[(NU + (i - AFFINE) * N + j - AFFINE) * LANES + l]
                s[(OVER_STEP + i * A + j) * LANES + l] = noise
                x += start_of(s, number, i, l) * start_of(s, number, j, l)
                s[(X + i * A + j) * LANES + l] = x
                s[(MOMENT + i * A + j) * LANES + l] = 0.0
                s[(THROUGH + i * A + j) * LANES + l] = 0.0
        s[VALUE * LANES + l] = 0.0
    for t in range(steps):
        path = tape[t * A * A * LANES :]
        weight = number[WEIGHTS + t]
        moved(s, path)
        spread(s, path)
        for l in range(LANES):
            for i in range(A):
                for j in range(A):
                    s[(MOMENT + i * A + j) * LANES + l] += weight * s[(X + i * A + j) * LANES + l]
    for l in range(LANES):
        total = 0.0
        for i in range(A):
            for j in range(A):
                total += s[(COST + i * A + j) * LANES + l] * s[(MOMENT + i * A + j) * LANES + l]
                s[(X + i * A + j) * LANES + l] = (
                    number[WEIGHTS + steps - 1] * s[(COST + i * A + j) * LANES + l]
                )
        s[VALUE * LANES + l] = -total
    for t in range(steps - 1, -1, -1):
        path = tape[t * A * A * LANES :]
        for l in range(LANES):
            for i in range(A):
                for j in range(A):
                    x = s[(THROUGH + i * A + j) * LANES + l]
                    for q in range(A):
                        x += s[(X + i * A + q) * LANES + l] * path[(q * A + j) * LANES + l]
                    s[(THROUGH + i * A + j) * LANES + l] = x
        if t == 0:
            break
        weight = number[WEIGHTS + t - 1]
        pushed_back(s)
        for l in range(LANES):
            for i in range(A):
                for j in range(i + 1):
                    x = s[(Y + i * A + j) * LANES + l]
                    x += weight * s[(COST + i * A + j) * LANES + l]
                    for q in range(A):
                        x += s[(DRIFT + q * A + i) * LANES + l] * s[(Y + q * A + j) * LANES + l]
                    s[(X + i * A + j) * LANES + l] = x
                    s[(X + j * A + i) * LANES + l] = x
    for l in range(LANES):
        for i in range(A * A):
            s[(THROUGH + i) * LANES + l] *= -2.0
    project(s)
    price(s)
    of_parameters(s)


@inner
def regulator_value(z, s, number, tape):
    """``edtorch.value.linear.regulator``: the direction to the first gain."""
    open_loop(z, s, number, number[UNROLL_TICK])
    unit, discount = number[COST_UNIT], number[DISCOUNT]
    for l in range(LANES):
        for i in range(A * A):
            s[(X + i) * LANES + l] = unit * number[STATE_COST + i]
    for _ in range(int(number[STEPS])):
        pushed_back(s)
        for l in range(LANES):
            for i in range(A):
                for j in range(M):
                    x = 0.0
                    for q in range(A):
                        x += s[(X + i * A + q) * LANES + l] * s[(INPUT + q * M + j) * LANES + l]
                    s[(PUSHED + i * M + j) * LANES + l] = x
        for l in range(LANES):
            for i in range(M):
                for j in range(M):
                    x = 0.0
                    for q in range(A):
                        x += (
                            s[(INPUT + q * M + i) * LANES + l] * s[(PUSHED + q * M + j) * LANES + l]
                        )
                    x = unit * number[ACTION_COST + i * M + j] + discount * x
                    s[(PIVOTS + i * M + j) * LANES + l] = x
                for j in range(A):
                    x = 0.0
                    for q in range(A):
                        x += s[(INPUT + q * M + i) * LANES + l] * s[(Y + q * A + j) * LANES + l]
                    x = discount * x + unit * number[CROSS_COST + j * M + i]
                    s[(FULL + i * A + j) * LANES + l] = x
        # Gauss and Jordan: a positive definite matrix needs no pivoting.
        for l in range(LANES):
            for p in range(M):
                pivot = s[(PIVOTS + p * M + p) * LANES + l]
                for j in range(M):
                    s[(PIVOTS + p * M + j) * LANES + l] /= pivot
                for j in range(A):
                    s[(FULL + p * A + j) * LANES + l] /= pivot
                for i in range(M):
                    share = s[(PIVOTS + i * M + p) * LANES + l] if i != p else 0.0
                    for j in range(M):
                        s[(PIVOTS + i * M + j) * LANES + l] -= (
                            share * s[(PIVOTS + p * M + j) * LANES + l]
                        )
                    for j in range(A):
                        s[(FULL + i * A + j) * LANES + l] -= (
                            share * s[(FULL + p * A + j) * LANES + l]
                        )
        for l in range(LANES):
            for i in range(A):
                for j in range(A):
                    x = s[(Y + i * A + j) * LANES + l]
                    for q in range(M):
                        x -= s[(PUSHED + i * M + q) * LANES + l] * s[(FULL + q * A + j) * LANES + l]
                    s[(THROUGH + i * A + j) * LANES + l] = x
        for l in range(LANES):
            for i in range(A):
                for j in range(A):
                    x = s[(THROUGH + i * A + j) * LANES + l]
                    for q in range(A):
                        x += (
                            s[(DRIFT + q * A + i) * LANES + l]
                            * s[(THROUGH + q * A + j) * LANES + l]
                        )
                    x = unit * number[STATE_COST + i * A + j] + discount * x
                    for q in range(M):
                        x -= (
                            unit
                            * number[CROSS_COST + i * M + q]
                            * s[(FULL + q * A + j) * LANES + l]
                        )
                    s[(MOMENT + i * A + j) * LANES + l] = x
        for l in range(LANES):
            for i in range(A):
                for j in range(A):
                    x = s[(MOMENT + i * A + j) * LANES + l] + s[(MOMENT + j * A + i) * LANES + l]
                    s[(X + i * A + j) * LANES + l] = 0.5 * x
    for l in range(LANES):
        total = 0.0
        for i in range(A):
            for j in range(A):
                x = start_of(s, number, i, l) * start_of(s, number, j, l)
                if i >= AFFINE and j >= AFFINE:
                    x += number[START_COV + (i - AFFINE) * N + j - AFFINE]
                total += s[(X + i * A + j) * LANES + l] * x
        s[VALUE * LANES + l] = -total
    for l in range(LANES):
        for i in range(M * A):
            x = s[(FULL + i) * LANES + l]
            s[(FULL + i) * LANES + l] = -x - s[(GAINS + i) * LANES + l]
    of_parameters(s)


@inner
def norm(s):
    """NORM of the gradient."""
    for l in range(LANES):
        x = 0.0
        for i in range(M * KP):
            x += s[(GRADIENT + i) * LANES + l] * s[(GRADIENT + i) * LANES + l]
        s[NORM * LANES + l] = math.sqrt(x)


@inner
def saturated(z, s, number):
    """``edtorch.policy.steps.SaturatedStep``; with STEP_DECAYS ``DecayingStep``."""
    for l in range(LANES):
        alpha = number[ALPHA]
        if STEP_DECAYS:
            climbed = z[CLIMBED * LANES + l]
            alpha = alpha / (1 + climbed / number[STEP_DECAY])
            go = s[GO * LANES + l] > 0
            z[CLIMBED * LANES + l] = climbed + number[UNIT] if go else climbed
        rate = alpha * number[UNIT] / (number[BETA] + s[NORM * LANES + l])
        s[RATE * LANES + l] = rate


@inner
def plain(z, s, number):
    """``edtorch.policy.steps.PlainStep``."""
    for l in range(LANES):
        s[RATE * LANES + l] = number[ALPHA] * number[UNIT]


@inner
def full(z, s, number):
    """``edtorch.policy.steps.FullStep``."""
    for l in range(LANES):
        s[RATE * LANES + l] = 1.0


@inner
def annealed(start, final, decay, age):
    """``edtorch.learner.annealing.Annealed``."""
    return final + (start - final) * math.exp(age * (-1 / decay))


@inner
def ramp(z, k, s, number):
    """``edtorch.learner.limit.Ramp``: ALLOWED."""
    for l in range(LANES):
        age = float(k[AGE * LANES + l])
        s[ALLOWED * LANES + l] = annealed(number[RAMP], number[RAMP + 1], number[RAMP + 2], age)


@inner
def safe(z, k, s, number):
    """``edtorch.learner.limit.Safe``: ALLOWED, within the ramp."""
    ramp(z, k, s, number)
    closed_loop(z, s, number, number[SAFE_TICK])
    scale = number[SAFE_TICK] if INTEGRATES else 1.0
    for l in range(LANES):
        age = float(k[AGE * LANES + l])
        s[SHARE * LANES + l] = annealed(number[SHARED], number[SHARED + 1], number[SHARED + 2], age)
        for j in range(N):
            # The command stays what it is, whatever the others do.
            s[(DRIFT + COMMANDED * N + j) * LANES + l] = 0.0
        for i in range(N):
            s[(ADJOINT + i) * LANES + l] = 1.0 if i == COMMANDED else 0.0
            if WATCHED:
                for j in range(N):
                    kept = i != COMMANDED and j != COMMANDED
                    nu = scale * z[(NU + i * N + j) * LANES + l]
                    s[(OVER_STEP + i * N + j) * LANES + l] = nu if kept else 0.0
                    s[(X + i * N + j) * LANES + l] = 0.0
    for _ in range(int(number[SAFE_STEPS])):
        for l in range(LANES):
            allowed = s[ALLOWED * LANES + l]
            for q in range(BOUNDED):
                row = int(number[BOUNDED_ACTIONS + 2 * q])
                action = 0.0
                for j in range(N):
                    action += s[(GAINS + row * N + j) * LANES + l] * s[(ADJOINT + j) * LANES + l]
                room = number[BOUNDED_ACTIONS + 2 * q + 1] / larger(abs(action), 1e-30)
                allowed = smaller(allowed, room)
            s[ALLOWED * LANES + l] = allowed
        for l in range(LANES):
            for i in range(N):
                x = s[(ADJOINT + i) * LANES + l]
                for j in range(N):
                    x += s[(DRIFT + i * N + j) * LANES + l] * s[(ADJOINT + j) * LANES + l]
                s[(PULLED + i) * LANES + l] = x
        for l in range(LANES):
            for i in range(N):
                s[(ADJOINT + i) * LANES + l] = s[(PULLED + i) * LANES + l]
        if WATCHED:
            # A command needs a loop without constants: A is N.
            half = s[Y * LANES :]
            moved(s, half)
            spread(s, half)
        for q in range(CONSTRAINED):
            row = int(number[CONSTRAINTS + 2 * q])
            response = s[(ADJOINT + row) * LANES :]
            variance = s[(X + row * N + row) * LANES :]
            for l in range(LANES):
                room = s[SHARE * LANES + l] * number[CONSTRAINTS + 2 * q + 1]
                if WATCHED:
                    room = larger(room - number[DEVIATIONS] * math.sqrt(variance[l]), 0.0)
                room = room / larger(abs(response[l]), 1e-30)
                s[ALLOWED * LANES + l] = smaller(s[ALLOWED * LANES + l], room)
    for l in range(LANES):
        # A prediction that overflows allows no command.
        allowed = s[ALLOWED * LANES + l]
        s[ALLOWED * LANES + l] = allowed if allowed >= 0 else 0.0


@inner
def improve(z, k, s, number, tape):
    """Steps 3 to 7; sets VALUE_OK, commits where VALID and VALUE_OK are."""
    value(z, s, number, tape)
    norm(s)
    for l in range(LANES):
        x = s[VALUE * LANES + l] + s[NORM * LANES + l]
        s[VALUE_OK * LANES + l] = 1.0 if x - x == 0 else 0.0
        s[GO * LANES + l] = s[VALID * LANES + l] * s[VALUE_OK * LANES + l]
    step(z, s, number)
    for i in range(M * KP):
        for l in range(LANES):
            old = z[(THETA + i) * LANES + l]
            new = old + s[RATE * LANES + l] * s[(GRADIENT + i) * LANES + l]
            z[(THETA + i) * LANES + l] = new if s[GO * LANES + l] > 0 else old
    if LIMITED:
        command(z, k, s, number)
        for l in range(LANES):
            old = z[(LIMIT + COMMANDED) * LANES + l]
            new = s[ALLOWED * LANES + l]
            z[(LIMIT + COMMANDED) * LANES + l] = new if s[VALID * LANES + l] > 0 else old
