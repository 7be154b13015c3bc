"""Shapes of tensors, as annotations; the tests check them at every call (``tests/shapes.py``).

``*batch``: any leading dimensions, a population of learners among them; n states, m actions, k
features.  Names that recur in one signature have one length.
"""

from jaxtyping import Float
from torch import Tensor

Rows = Float[Tensor, "*batch"]
States = Float[Tensor, "*batch n"]
Actions = Float[Tensor, "*batch m"]
Features = Float[Tensor, "*batch k"]
Weights = Float[Tensor, "*batch n k"]
Squares = Float[Tensor, "*batch n n"]
"""Covariances, costs, and maps from states to states."""

Inputs = Float[Tensor, "*batch n m"]
"""Maps from actions to states."""

Gains = Float[Tensor, "*batch m n"]
StateCost = Float[Tensor, "n n"]
ActionCost = Float[Tensor, "m m"]
CrossCost = Float[Tensor, "n m"]
