"""Episodes of policies that learn nothing, one after the other."""


@outer
def rides(z, k, s, ends, number, constants, uniform, rows, row, clock, count):
    """Ticks clock + 1 to clock + count of the episodes ``rows``, numbers from ``row`` on, each up
    to its end; ends [E, 2]: the tick and the outcome of those that have ended."""
    for j in range(len(rows)):
        e = rows[j]
        own, counted, drawn = z[e], k[e], uniform[j : j + 1]
        for done in range(count):
            now = clock + done + 1
            # Nobody explores: the second time, the numbers are not looked at.
            acts(own, counted, s, number, drawn, row + done)
            live(own, counted, s, number, constants, drawn, now, row + done)
            advance(own, s)
            if s[OUTCOME] != RUNNING:
                ends[e, 0], ends[e, 1] = now, int(s[OUTCOME])
                break
