"""Sarsa(lambda) on boxes, learner and world: ``edtorch.rivals.sarsa``, one seed at a time."""


@inner
def box_rows(z, parts, edges, first, row):
    """The boxes that the observation is in, one of each table."""
    for t in range(len(row)):
        row[t] = first[t]
    for p in range(len(parts)):
        above = 0
        for e in range(parts[p, 3], parts[p, 4]):
            above += 1 if z[OBSERVATION + parts[p, 1]] >= edges[e] else 0
        row[parts[p, 0]] += parts[p, 2] * above


@inner
def choose(table, row, values, number, counter, first, second):
    """A random action, or the first of the best ones, the values of all being left in
    ``values``."""
    count = len(values)
    best = 0
    for a in range(count):
        values[a] = 0.0
        for t in range(len(row)):
            values[a] += table[row[t] * count + a]
        # The first NaN is the best, as in torch.
        if values[a] > values[best] or (values[a] != values[a] and values[best] == values[best]):
            best = a
    if hashed(first, second, counter + UNIFORMS) < number[EXPLORATION]:
        best = int(hashed(first, second, counter + UNIFORMS + 1) * count)
    return best


@inner
def shaping(s, number):
    """Minus the quadratic cost of what is seen after the tick, and of the action."""
    cost = 0.0
    for i in range(N):
        for j in range(N):
            cost += s[NEXT + i] * number[STATE_COST + i * N + j] * s[NEXT + j]
    for i in range(M):
        for j in range(M):
            cost += s[ACTION + i] * number[ACTION_COST + i * M + j] * s[ACTION + j]
    return -cost


@inner
def update(table, visited, trace, rates, row, choice, count, delta, number, clock, age):
    """The values of the last visits of an episode that is ``age`` ticks old, and their traces."""
    for t in range(len(row)):
        first = row[t] * count
        length = visited.shape[1]
        newest = clock % length
        place = newest
        for _ in range(min(age, length)):
            if place == newest:
                visited[t, place], trace[t, place] = first + choice, 1.0
            elif first <= visited[t, place] and visited[t, place] < first + count:
                trace[t, place] = 0.0
            table[visited[t, place]] += rates[t] * delta * trace[t, place]
            trace[t, place] *= number[DECAY]
            place = place - 1 if place > 0 else length - 1


@outer
def sarsa(
    z, k, s, number, constants, uniform, values, old, key, actions, tables, visits, traces, rows,
    going, rates, parts, edges, firsts, ended, clock, count
):  # fmt: skip
    """Ticks clock + 1 to clock + count of all S seeds.

    z [S, Z], k [S, COUNTERS]; values [A], old [T]: scratch; key [S, 2], actions [A, m], tables
    [S, rows A], visits and traces [S, T, K], rows [S, T], going [S], rates [T]; parts [P, 5]:
    table, component, rows of a step, and range of ``edges``; firsts [T]: first row of each table.
    Outcomes go to ended [count, S].
    """
    for seed in range(len(key)):
        own, counts, row, table = z[seed], k[seed], rows[seed], tables[seed]
        first, second = key[seed, 0], key[seed, 1]
        for place in range(count):
            now = clock + 1 + place
            counter = now * (UNIFORMS + 2)
            for i in range(UNIFORMS):
                uniform[0, 0, i] = hashed(first, second, counter + i)
            choice = counts[CHOICE]
            for i in range(M):
                s[ACTION + i] = actions[choice, i]
            live(own, counts, s, number, constants, uniform, now, 0)
            outcome = int(s[OUTCOME])
            earned = number[STEP] + shaping(s, number)
            if outcome == FAILED:
                earned = number[FAILURE]
            if outcome == SUCCEEDED:
                earned = number[SUCCESS]
            age = now - counts[BEGUN]
            for i in range(N):
                own[OBSERVATION + i] = s[NEXT + i]
            if outcome != 0:
                here = start(state_at(own, WORLD, 0), resets_at(uniform, 0, 0), constants)
                store_state(own, WORLD, here, 0)
                store_seen(own, OBSERVATION, number, observe(here, constants), 0)
                counts[BEGUN] = now
            before = 0.0
            for t in range(len(row)):
                old[t] = row[t]
                before += table[row[t] * len(actions) + choice]
            box_rows(own, parts, edges, firsts, row)
            following = choose(table, row, values, number, counter, first, second)
            counts[CHOICE] = following
            delta = earned - before
            if outcome == RUNNING:
                delta = earned + number[DISCOUNT] * values[following] - before
            if outcome == TIMED_OUT or not going[seed]:
                delta = 0.0
            update(
                table, visits[seed], traces[seed], rates, old, choice, len(actions), delta, number,
                now, age
            )  # fmt: skip
            ended[place, seed] = outcome
