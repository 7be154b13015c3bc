"""Raw actions of a policy by a phase: ``edtorch.policy.phase``, whose arrays ``form`` holds."""


@outer
def gait_raw(seen, vector, form, raw):
    """Of a reading [n], with the parameters [p] in one vector."""
    phase, joint, rate, gain, binomial, place, drive = form
    n, most = len(seen), binomial.shape[1]
    now, speed = 0.0, 0.0
    for i in range(n):
        now += phase[0, i] * seen[i]
        speed += phase[1, i] * seen[i]
    tau = min(max((now - vector[0]) / vector[1], 0.0), 1.0)
    raw[:] = 0.0
    for j in range(len(joint)):
        first, fed = int(place[j, 0]), int(place[j, 1])
        degree = 0
        for k in range(most):
            if binomial[j, k] > 0:
                degree = k
        away = vector[fed] * speed if fed >= 0 else 0.0
        for k in range(degree + 1):
            away += vector[first + k] * binomial[j, k] * tau**k * (1 - tau) ** (degree - k)
        pace = 0.0
        for i in range(n):
            away -= joint[j, i] * seen[i]
            pace += rate[j, i] * seen[i]
        demand = gain[j, 0] * away - gain[j, 1] * pace
        for i in range(len(raw)):
            raw[i] += drive[i, j] * demand
