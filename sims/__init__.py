"""Worlds to learn in: the protocol of a simulator (``sims.base``), and one file for each.

Importing this package makes the environments below known to Gymnasium, which has had no discovery
of plug-ins since 1.0.
"""

import gymnasium

for _id, _entry_point in {
    "edtorch/Bicycle-v0": "sims.gymnasium_env:BicycleEnv",
    "edtorch/Cardea-v0": "sims.cardea.env:CardeaEnv",
    "edtorch/CartPoleSwingUp-v0": "sims.tasks.env:CartPoleSwingUpEnv",
    "edtorch/PendulumSwingUp-v0": "sims.tasks.env:PendulumSwingUpEnv",
    "edtorch/Pendubot-v0": "sims.tasks.env:PendubotEnv",
    "edtorch/DoublePendulum-v0": "sims.tasks.env:DoublePendulumEnv",
    "edtorch/CartDoublePendulum-v0": "sims.tasks.env:CartDoublePendulumEnv",
    "edtorch/StopPendulum-v0": "sims.tasks.env:StopPendulumEnv",
    "edtorch/Unicycle-v0": "sims.tasks.env:UnicycleEnv",
    "edtorch/Walker-v0": "sims.tasks.env:WalkerEnv",
}.items():
    if _id not in gymnasium.registry:
        gymnasium.register(_id, entry_point=_entry_point)
