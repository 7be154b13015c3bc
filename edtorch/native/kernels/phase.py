"""Actions of a policy by a phase (``edtorch.policy.phase``), for episodes one after the other: its
numbers are those of ``edtorch.native.phase``."""


@inner
def act_by_phase(z, k, s, number, normal, t):
    """As ``act``, without exploration."""
    J, D = PHASE_JOINTS, PHASE_POINTS
    form = (
        number[PHASE_ROWS : PHASE_ROWS + 2 * N].reshape((2, N)),
        number[PHASE_JOINT : PHASE_JOINT + J * N].reshape((J, N)),
        number[PHASE_RATE : PHASE_RATE + J * N].reshape((J, N)),
        number[PHASE_GAIN : PHASE_GAIN + J * 2].reshape((J, 2)),
        number[PHASE_BINOMIAL : PHASE_BINOMIAL + J * D].reshape((J, D)),
        number[PHASE_PLACE : PHASE_PLACE + J * 2].reshape((J, 2)),
        number[PHASE_DRIVE : PHASE_DRIVE + M * J].reshape((M, J)),
    )
    raw = np.empty(M)
    gait_raw(z[OBSERVATION : OBSERVATION + N], z[THETA : THETA + OWN], form, raw)
    for i in range(M):
        x = number[PHASE_MIDDLE + i] + number[PHASE_HALF + i] * math.tanh(raw[i])
        if CLIPS:
            x = smaller(larger(x, number[LOW + i]), number[HIGH + i])
        s[ACTION + i] = x
