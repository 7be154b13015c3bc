"""What acts: an inverse policy, and the inverse model that turns its wish into an action."""

from __future__ import annotations

from dataclasses import dataclass

from torch import Tensor

from edtorch.inverse.coordinates import Coordinates
from edtorch.inverse.features import InverseFeatures
from edtorch.inverse.policy import InversePolicy
from edtorch.linalg import matvec
from edtorch.types import Parameters


@dataclass(frozen=True)
class InverseController:
    """u = W phi(s, a), a = pi(s, g): ``weight`` Theta and ``inverse`` W ``[n, k]``.

    coordinates: those that the policy works in.
    """

    policy: InversePolicy
    features: InverseFeatures
    coordinates: Coordinates

    @property
    def label(self) -> str:
        """What a saved policy of this kind is called."""
        return f"{type(self).__name__}({type(self.features).__name__})"

    def action(self, parameters: Parameters, observation: Tensor) -> Tensor:
        """The action ``[*batch, n]``, scaled, for a scaled observation ``[*batch, N]``."""
        view = self.coordinates.view(observation)
        wish = self.policy.acceleration(parameters["weight"], view.state, view.goal)
        joints = self.coordinates.joint_acceleration(view, wish)
        return matvec(parameters["inverse"], self.features(view.joints, joints))
