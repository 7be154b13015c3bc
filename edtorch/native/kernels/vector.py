"""Actions of a policy of one vector (``edtorch.policy.vector``), for episodes one by one."""


@inner
def act_by_vector(z, k, s, number, normal, t):
    """As ``act``, without exploration."""
    raw = np.empty(M)
    gait_raw(z[OBSERVATION : OBSERVATION + N], z[THETA : THETA + OWN], form_of(number), raw)
    for i in range(M):
        x = number[SQUASH_MIDDLE + i] + number[SQUASH_HALF + i] * math.tanh(raw[i])
        if CLIPS:
            x = smaller(larger(x, number[LOW + i]), number[HIGH + i])
        s[ACTION + i] = x
