"""Steps 1 and 2 of Fig. 1: the model and its noise after one transition."""


@inner
def see(z, s, number):
    """PHI, START and END of the transition from OBSERVATION to NEXT."""
    for l in range(LANES):
        if MODEL_CONSTANT:
            s[PHI * LANES + l] = 1.0
        for i in range(N):
            before = z[(OBSERVATION + i) * LANES + l]
            moved = s[(NEXT + i) * LANES + l] - before
            moved -= number[PERIOD + i] * np.rint(moved * number[TURNS + i])
            start = before
            if LIMITED:
                limit = z[(LIMIT + i) * LANES + l]
                start = smaller(larger(before, -limit), limit)
            s[(PHI + MODEL_CONSTANT + i) * LANES + l] = start
            # Bounded, the transition goes as far as it went; else it ends where it ended, on the
            # other side of the seam of an angle too.
            s[(END + i) * LANES + l] = start + moved if LIMITED else s[(NEXT + i) * LANES + l]
            if INTEGRATES:
                s[(TARGET + i) * LANES + l] = moved / number[TICK]
            else:
                s[(TARGET + i) * LANES + l] = start + moved
        for i in range(M):
            s[(PHI + MODEL_CONSTANT + N + i) * LANES + l] = s[(ACTION + i) * LANES + l]


@inner
def residuals(z, s):
    """y - W phi, row by row."""
    for l in range(LANES):
        for i in range(N):
            x = 0.0
            for j in range(K):
                x += z[(WEIGHT + i * K + j) * LANES + l] * s[(PHI + j) * LANES + l]
            s[(RESIDUAL + i) * LANES + l] = s[(TARGET + i) * LANES + l] - x


@inner
def unit_of(z, s, number, l):
    """What a rate is multiplied with: smaller for a rule that calms down."""
    if DECAYING:
        return number[UNIT] / (1 + z[LEARNED * LANES + l] / number[FIT_DECAY])
    return number[UNIT]


@inner
def sign(x):
    """As torch's: 0 for NaN."""
    return 1.0 if x > 0 else (-1.0 if x < 0 else 0.0)


@inner
def aged(z, s, number):
    """The memory of a rule that calms down."""
    if DECAYING:
        for l in range(LANES):
            s[(NEW + LEARNED - WEIGHT) * LANES + l] = z[LEARNED * LANES + l] + number[UNIT]


@inner
def paced(z, s, number):
    """GAIN = rate phi, of the rules that follow a gradient."""
    aged(z, s, number)
    for l in range(LANES):
        rate = number[FIT_RATE] * unit_of(z, s, number, l)
        for j in range(K):
            s[(GAIN + j) * LANES + l] = rate * s[(PHI + j) * LANES + l]


@inner
def stepped(z, s, row):
    """W + e GAIN', e being the rows from ``row`` on."""
    for l in range(LANES):
        for i in range(N):
            step = s[(row + i) * LANES + l]
            for j in range(K):
                s[(NEW + i * K + j) * LANES + l] = (
                    z[(WEIGHT + i * K + j) * LANES + l] + step * s[(GAIN + j) * LANES + l]
                )


@inner
def absolute(z, s, number):
    """``edtorch.model.fit.AbsoluteError``."""
    paced(z, s, number)
    for l in range(LANES):
        for i in range(N):
            s[(SIGN + i) * LANES + l] = sign(s[(RESIDUAL + i) * LANES + l])
    stepped(z, s, SIGN)


@inner
def squared(z, s, number):
    """``edtorch.model.fit.SquaredError``."""
    paced(z, s, number)
    stepped(z, s, RESIDUAL)


@inner
def normalised(z, s, number):
    """``edtorch.model.fit.NormalisedSquaredError``."""
    paced(z, s, number)
    for l in range(LANES):
        size = number[FIT_FLOOR]
        for j in range(K):
            size += s[(PHI + j) * LANES + l] * s[(PHI + j) * LANES + l]
        for j in range(K):
            s[(GAIN + j) * LANES + l] /= size
    stepped(z, s, RESIDUAL)


@inner
def projected(z, s):
    """P phi in PROJECTED."""
    for l in range(LANES):
        for i in range(K):
            x = 0.0
            for j in range(K):
                x += z[(FIT_P + i * K + j) * LANES + l] * s[(PHI + j) * LANES + l]
            s[(PROJECTED + i) * LANES + l] = x


@inner
def recursive(z, s, number, doubt):
    """Recursive least squares of P, and of P + I where the row ``doubt`` is 1 (-1: nowhere)."""
    for l in range(LANES):
        scale = number[FORGETTING]
        for j in range(K):
            if doubt >= 0:
                s[(PROJECTED + j) * LANES + l] += s[doubt * LANES + l] * s[(PHI + j) * LANES + l]
            scale += s[(PHI + j) * LANES + l] * s[(PROJECTED + j) * LANES + l]
        for j in range(K):
            s[(GAIN + j) * LANES + l] = s[(PROJECTED + j) * LANES + l] / scale
    stepped(z, s, RESIDUAL)
    # Rounding makes P asymmetric, and the asymmetry would grow: both halves are the mean.
    for l in range(LANES):
        for i in range(K):
            for j in range(i + 1):
                upper = z[(FIT_P + i * K + j) * LANES + l]
                lower = z[(FIT_P + j * K + i) * LANES + l]
                if doubt >= 0 and i == j:
                    upper += s[doubt * LANES + l]
                    lower = upper
                upper -= s[(PROJECTED + i) * LANES + l] * s[(GAIN + j) * LANES + l]
                lower -= s[(PROJECTED + j) * LANES + l] * s[(GAIN + i) * LANES + l]
                x = 0.5 * (upper / number[FORGETTING] + lower / number[FORGETTING])
                s[(NEW + FIT_P - WEIGHT + i * K + j) * LANES + l] = x
                s[(NEW + FIT_P - WEIGHT + j * K + i) * LANES + l] = x


@inner
def least_squares(z, s, number):
    """``edtorch.model.fit.RecursiveLeastSquares``."""
    projected(z, s)
    recursive(z, s, number, -1)


@inner
def adaptive(z, s, number):
    """``edtorch.model.fit_adaptive.AdaptiveLeastSquares``."""
    projected(z, s)
    for l in range(LANES):
        explained = 1.0
        for j in range(K):
            explained += s[(PHI + j) * LANES + l] * s[(PROJECTED + j) * LANES + l]
        heard = z[HEARD * LANES + l] + number[UNIT]
        fast = min(number[FAST] * number[UNIT], 1.0)
        slow = min(larger(number[UNIT] / heard, number[SLOW] * number[UNIT]), 1.0)
        alarm = 0.0
        for i in range(N):
            square = s[(RESIDUAL + i) * LANES + l] * s[(RESIDUAL + i) * LANES + l] / explained
            short = z[(SHORT + i) * LANES + l]
            short += fast * (square - short)
            long = z[(LONG + i) * LANES + l]
            long += slow * (square - long)
            alarm = 1.0 if short > number[THRESHOLD] * long else alarm
            s[(NEW + SHORT - WEIGHT + i) * LANES + l] = short
            s[(NEW + LONG - WEIGHT + i) * LANES + l] = long
        alarm = alarm if heard > 10 / number[FAST] else 0.0
        for i in range(N):
            short = s[(NEW + SHORT - WEIGHT + i) * LANES + l]
            long = s[(NEW + LONG - WEIGHT + i) * LANES + l]
            s[(NEW + LONG - WEIGHT + i) * LANES + l] = short if alarm > 0 else long
        s[(NEW + HEARD - WEIGHT) * LANES + l] = 1 / number[FAST] if alarm > 0 else heard
        s[(NEW + ALARMS - WEIGHT) * LANES + l] = z[ALARMS * LANES + l] + alarm
        s[DOUBT * LANES + l] = number[DOUBTED] * alarm
    recursive(z, s, number, DOUBT)


@inner
def residual_noise(z, s, number):
    """``edtorch.model.noise.ResidualNoise``."""
    share = min(number[NOISE_RATE] * number[UNIT], 1.0)
    scale = number[TICK] if INTEGRATES else 1.0
    for l in range(LANES):
        for i in range(N):
            for j in range(N):
                old = z[(NU + i * N + j) * LANES + l]
                square = s[(RESIDUAL + i) * LANES + l] * s[(RESIDUAL + j) * LANES + l] * scale
                s[(NEW + NU - WEIGHT + i * N + j) * LANES + l] = old + share * (square - old)


@inner
def finite(s, row, count, flag):
    """``flag``: 1 where the sum of the rows is finite, else 0."""
    for l in range(LANES):
        s[flag * LANES + l] = 0.0
    for i in range(count):
        for l in range(LANES):
            s[flag * LANES + l] += s[(row + i) * LANES + l]
    for l in range(LANES):
        x = s[flag * LANES + l]
        s[flag * LANES + l] = 1.0 if x - x == 0 else 0.0


@inner
def learn(z, k, s, number):
    """The fit; writes the flags SOUND and FIT_OK, ERROR, and commits where VALID and FIT_OK are."""
    finite(s, NEXT, N, SOUND)
    see(z, s, number)
    residuals(z, s)
    fit(z, s, number)
    if NOISY:
        residual_noise(z, s, number)
    finite(s, NEW, KNOWN, FIT_OK)
    for l in range(LANES):
        s[GO * LANES + l] = s[VALID * LANES + l] * s[FIT_OK * LANES + l]
        error = 0.0
        for i in range(N):
            error += abs(s[(RESIDUAL + i) * LANES + l])
        s[ERROR * LANES + l] = error / N
    for i in range(KNOWN):
        for l in range(LANES):
            old, new = z[(WEIGHT + i) * LANES + l], s[(NEW + i) * LANES + l]
            z[(WEIGHT + i) * LANES + l] = new if s[GO * LANES + l] > 0 else old
    for l in range(LANES):
        valid = s[VALID * LANES + l] > 0
        unbroken = valid and s[FIT_OK * LANES + l] > 0
        unbroken = unbroken and k[SOUND_TICKS * LANES + l] == k[AGE * LANES + l]
        s[UNBROKEN * LANES + l] = 1.0 if unbroken else 0.0
        k[AGE * LANES + l] += 1 if valid else 0
