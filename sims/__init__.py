"""Worlds to learn in: the protocol of a simulator (``sims.base``), and one file for each.

Importing this package makes ``edtorch/Bicycle-v0`` known to Gymnasium, which has had no discovery
of plug-ins since 1.0.
"""

import gymnasium

if "edtorch/Bicycle-v0" not in gymnasium.registry:
    gymnasium.register("edtorch/Bicycle-v0", entry_point="sims.gymnasium_env:BicycleEnv")
