"""Noise-aware gains: they weigh the covariance of the state, propagated, and that of readings."""


@outer
def closed(by_state, by_raw, gain, loop):
    """loop = A + B K."""
    n, m = by_raw.shape
    for i in range(n):
        for j in range(n):
            loop[i, j] = by_state[i, j]
            for k in range(m):
                loop[i, j] += by_raw[i, k] * gain[k, j]


@outer
def conjugated(left, inner_matrix, out, moved):
    """out += left inner_matrix left'."""
    for i in range(left.shape[0]):
        for j in range(left.shape[1]):
            moved[i, j] = 0.0
            for k in range(left.shape[1]):
                moved[i, j] += left[i, k] * inner_matrix[k, j]
    for i in range(left.shape[0]):
        for j in range(left.shape[0]):
            for k in range(left.shape[1]):
                out[i, j] += moved[i, k] * left[j, k]


@outer
def noise_aware(expansion, settings, gain, covariance, noise, process):
    """Replace the gains; expansion: of ``expand``; settings: tuple (damping, sweeps, floor);
    covariance [H + 1, n, n]: of the state, its first given, is written.

    Forward S' = (A + B K) S (A + B K)' + B K R K' B' + Q, backward K = -Quu^-1 Qux S (S + R)^-1
    with the cost to go under these gains, ``sweeps`` times.
    """
    damping, sweeps, floor = settings
    by_state, by_raw, hessian = expansion[0], expansion[1], expansion[3]
    ticks, n, m = by_raw.shape
    loop, moved, push = np.zeros((n, n)), np.zeros((n, n)), np.zeros((n, n))
    q, factors, pivot = quadratic_for(n, m), np.zeros((m, m)), np.zeros(m, np.int64)
    seen, order, row, column = np.zeros((n, n)), np.zeros(n, np.int64), np.zeros(n), np.zeros(m)
    none, ahead, unaware = np.zeros(m), np.zeros(n), np.zeros((m, n))
    for _ in range(sweeps):
        for t in range(ticks):
            closed(by_state[t], by_raw[t], gain[t], loop)
            for i in range(n):
                for j in range(n):
                    push[i, j] = loop[i, j] - by_state[t, i, j]
            copy_table(covariance[t + 1], process)
            conjugated(loop, covariance[t], covariance[t + 1], moved)
            conjugated(push, noise, covariance[t + 1], moved)
        ahead_hessian = hessian[ticks].copy()
        for t in range(ticks - 1, -1, -1):
            ahead[:] = 0.0
            quadratic(t, expansion, ahead, ahead_hessian, q)
            damp(q[4], damping, factors)
            factorise(factors, pivot, m)
            for i in range(n):
                for j in range(n):
                    seen[i, j] = covariance[t, i, j] + noise[i, j]
                # Where nothing is uncertain or misread, the gains are those without noise.
                seen[i, i] += floor
            factorise(seen, order, n)
            for i in range(n):
                for j in range(m):
                    column[j] = q[3][j, i]
                solve(factors, pivot, m, column)
                for j in range(m):
                    unaware[j, i] = -column[j]
            for j in range(m):
                for i in range(n):
                    row[i] = floor * unaware[j, i]
                    for k in range(n):
                        row[i] += covariance[t, i, k] * unaware[j, k]
                solve(seen, order, n, row)
                for i in range(n):
                    gain[t, j, i] = row[i]
            valued(q, none, gain[t], ahead, ahead_hessian)
