"""Raw actions of a policy linear in the state: ``edtorch.policy.linear_gait``."""


@outer
def gait_raw(seen, vector, form, raw):
    """Of a reading [n], with the gains [m, k] of the components that ``form`` holds, and the
    constants [m], in one vector."""
    (component,) = form
    m, k = len(raw), len(component)
    for j in range(m):
        raw[j] = vector[m * k + j]
        for i in range(k):
            raw[j] += vector[j * k + i] * seen[int(component[i])]
