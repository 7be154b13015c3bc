"""The compiled loop over ticks."""


@inner
def count_sound(k, s, improved):
    """Ticks up to the first one that was not sound."""
    for l in range(LANES):
        sound = s[UNBROKEN * LANES + l]
        if improved:
            sound *= s[VALUE_OK * LANES + l]
        k[SOUND_TICKS * LANES + l] += int(sound)


@inner
def tally(z, k, s, improved):
    """``edtorch.run.tick.Tally.add``."""
    for l in range(LANES):
        lives = s[LIVES * LANES + l]
        z[TALLY_ERROR * LANES + l] += s[ERROR * LANES + l] * lives
        z[TALLY_TICKS * LANES + l] += lives
        if improved:
            z[TALLY_VALUE * LANES + l] += s[VALUE * LANES + l] * lives
            z[TALLY_GRADIENT * LANES + l] += s[NORM * LANES + l] * lives
            z[TALLY_UPDATES * LANES + l] += lives
        idle = lives == 0
        k[FINITE * LANES + l] &= 1 if idle or s[SOUND * LANES + l] > 0 else 0
        k[(FINITE + 1) * LANES + l] &= 1 if idle or s[FIT_OK * LANES + l] > 0 else 0
        if improved:
            k[(FINITE + 2) * LANES + l] &= 1 if idle or s[VALUE_OK * LANES + l] > 0 else 0


@outer
def ticks(
    z, k, s, tape, number, constants, uniform, normal, row, clock, count, first, events, trail
):
    """Ticks clock + 1 to clock + count of one group, numbers from ``row`` on; fewer when everybody
    is done before, or ``events`` is full.  Returns how many, and how many episodes ended."""
    ended = 0
    living = 0
    for l in range(LANES):
        living += k[ACTIVE * LANES + l]
    stride = int(number[STRIDE])
    often, every, began = int(number[OFTEN]), int(number[EVERY]), int(number[IMPROVE_FIRST])
    passed = 0
    for done in range(count):
        if living == 0 or ended + LANES > len(events):
            return done, ended
        now = clock + done + 1
        act(z, k, s, number, normal, row + done)
        live(z, k, s, number, constants, uniform, now, row + done)
        learn(z, k, s, number)
        improves = now >= began and (now <= often or now % every == 0)
        if improves:
            improve(z, k, s, number, tape)
        advance(z, s)
        count_sound(k, s, improves)
        tally(z, k, s, improves)
        if len(trail) > 0 and now % stride == 0:
            for l in range(LANES):
                for i in range(WIDTH):
                    trail[passed, l, i] = z[(WORLD + i) * LANES + l]
                trail[passed, l, WIDTH] = s[LIVES * LANES + l]
            passed += 1
        before = ended
        ended = turn(z, k, s, number, constants, uniform, now, row + done, first, events, ended)
        if ended > before:
            living = 0
            for l in range(LANES):
                living += k[ACTIVE * LANES + l]
    return count, ended
