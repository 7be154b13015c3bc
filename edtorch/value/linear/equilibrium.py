r"""The linear-quadratic regulator about an equilibrium of the learned model.

The model s' = s + D s + G a + c has a constant: gravity, a constant force, a trim.  Where the
system is held, components with a target have it; the others and the action are such that the model
stays where it is, in the sense of least squares, with the smallest deviation from the data's
centre:

    (r, a_eq) = argmin |S^-1 (D s + G a + c)|^2 + slack^2 (|S_r^-1 (r - centre)|^2
                                                           + |H^-1 (a - middle)|^2),

s = (target, r).  S holds the greatest excursions from the centre in the data, H half the range of
each action.  About the equilibrium the model is linear without a constant.  The policy is
a = a_eq + K (s - s_eq), K the first gain of the regulator over 2^doublings ticks with Bryson's rule
for the weights (Bryson & Ho, "Applied Optimal Control", 1975): Q = S^-2, times ``rest`` for
components without a target, and R = price H^-2.

A model learned from noisy data is known only to a standard error.  K is that of the model
((1 + d) F, (1 + d) G), with d ``margin`` standard errors of a predicted change, relative to the
spread of the data: the closed loop of the learned model then has a spectral radius of at most
1 / (1 + d) (prescribed degree of stability; Anderson & Moore, "Optimal control: linear quadratic
methods", 1990, section 3.5), and that of the system itself most probably stays below 1.  Without
noise d is zero; so it is where no policy has that margin, since a component that no action moves
does not settle (a target that stays where it is).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn.functional import pad

from edtorch.linalg import matvec
from edtorch.model.models import Model, dynamics_of
from edtorch.policy.policies import GainedPolicy, LinearGain
from edtorch.shapes import Actions, Inputs, Squares, States
from edtorch.types import Parameters
from edtorch.value.linear.lqr import doubled_lqr
from edtorch.value.unroll import ValueGradient

_MOST = 0.1
"""The greatest margin per tick: with little data the model says little about stability."""


@dataclass(frozen=True)
class HoldSettings:
    """price: of actions, for half their range squared; rest: weight of components without a
    target, beside 1; gain: share of the cost that a new policy must save to replace the old one;
    slack: weight of usual values beside that of standing still; doublings: the horizon is 2 to
    this power, in ticks; margin: of stability, in standard errors of the model.  Raises ValueError
    for settings out of range."""

    price: float = 1.0
    rest: float = 0.01
    gain: float = 0.001
    slack: float = 0.001
    doublings: int = 9
    margin: float = 2.0

    def __post_init__(self) -> None:
        for name in ("price", "slack"):
            if not getattr(self, name) > 0:
                raise ValueError(f"{name}={getattr(self, name)}: expected a number > 0")
        for name in ("rest", "gain"):
            if not 0 <= getattr(self, name) < 1:
                raise ValueError(f"{name}={getattr(self, name)}: expected a number in [0, 1)")
        if not self.margin >= 0:
            raise ValueError(f"margin={self.margin}: expected a number >= 0")
        if self.doublings < 1:
            raise ValueError(f"doublings={self.doublings}: expected at least one")


def equilibrium(
    drift: Squares,
    G: Inputs,
    constant: States,
    centre: States,
    excursion: States,
    held: Tensor,
    middle: Float[Tensor, " m"],
    half: Float[Tensor, " m"],
    slack: float,
) -> tuple[States, Actions]:
    """s_eq ``[B, n]`` and a_eq ``[B, m]``, see above; a_eq is clamped to its range.

    drift D ``[B, n, n]``, G ``[B, n, m]``, constant c ``[B, n]``; centre ``[B, n]`` with the
    targets in the components where held ``[n]`` (bool) says so; excursion S ``[B, n]`` above zero;
    middle and half H ``[m]``.
    """
    # Unknowns are deviations from (centre, middle), each in its own unit; held ones are zero.
    free = torch.where(held, 0.0, excursion)
    rows = torch.cat([drift * free.unsqueeze(-2), G * half], dim=-1) / excursion.unsqueeze(-1)
    left = (matvec(drift, centre) + (G * middle).sum(-1) + constant) / excursion
    eye = torch.eye(rows.shape[-1], dtype=rows.dtype, device=rows.device)
    normal = rows.mT @ rows + slack**2 * eye
    found = -torch.linalg.solve_ex(normal, rows.mT @ left.unsqueeze(-1)).result.squeeze(-1)
    n = drift.shape[-1]
    return centre + free * found[..., :n], middle + half * found[..., n:].clamp(-1, 1)


def summed(A: Squares, cost: Squares, doublings: int) -> Squares:
    """sum over tau < 2^doublings of A'^tau cost A^tau, ``[B, N, N]``, by doubling."""
    for _ in range(doublings):
        cost = cost + A.mT @ cost @ A
        A = A @ A
    return cost


def converges(A: Tensor, doublings: int) -> Tensor:
    """Whether every entry of A^(2^doublings) lies within [-1, 1], bool ``[B]``; A ``[B, n, n]``."""
    for _ in range(doublings):
        A = A @ A
    # A comparison with NaN is false.
    return (A.abs() <= 1).all(-1).all(-1)


@dataclass(frozen=True)
class EquilibriumRegulator:
    """A ``ValuePath`` whose direction leads to the regulator about the model's equilibrium.

    The direction is zero, so that the policy stays as it is, unless the model promises that the
    change saves more than the share ``gain`` of the cost: learning stops where it no longer pays,
    and a policy is kept where the model cannot be stabilised.  Cost: the sum over 2^doublings ticks
    of (s - s_eq)'Q(s - s_eq) + (a - a_eq)'R(a - a_eq), mean over starts about the equilibrium with
    the data's excursions as standard deviations.  value: minus the cost.

    model: linear with a constant, policy: linear with a constant (ValueError otherwise); dt:
    seconds per tick of the world; target: wanted values by index of the component, scaled units;
    weights: factors of Q by index (1 where there is none); prices ``[m]``: factors of R; middle,
    half ``[m]``: of the range of the actions, scaled.  Model parameters must include what
    ``describe`` of ``edtorch.model.fit_local`` gives.
    """

    model: Model
    policy: GainedPolicy
    dt: float
    target: Mapping[int, float]
    weights: Mapping[int, float]
    prices: Tensor
    middle: Tensor
    half: Tensor
    settings: HoldSettings = HoldSettings()
    needs_autograd: bool = False

    def __post_init__(self) -> None:
        dynamics = dynamics_of(self.model, self.model.initial([0]), self.dt)
        gain = self.policy.linear_gain(self.policy.initial([0]))
        for key, part in (("model", dynamics), ("policy", gain)):
            if part is None or part.constant is None:
                raise ValueError(
                    f"direction=equilibrium: expected a {key} that is linear with a constant;"
                    f" {key}.features=affine"
                )

    def __call__(
        self, model: Parameters, policy: Parameters, noise: Parameters, state: Tensor
    ) -> ValueGradient:
        """See ``ValuePath``; the gradient is the difference to the regulator, state is not used."""
        dynamics, old = dynamics_of(self.model, model, self.dt), self.policy.linear_gain(policy)
        assert dynamics is not None and old is not None  # checked when it was made
        assert dynamics.constant is not None and old.constant is not None
        settings, n = self.settings, dynamics.drift.shape[-1]
        centre, excursion = model["centre"], model["excursion"]
        excursion = torch.where(excursion > 0, excursion, 1.0)
        held = torch.tensor([i in self.target for i in range(n)], device=centre.device)
        where, action = equilibrium(
            dynamics.drift,
            dynamics.action,
            dynamics.constant,
            centre,
            excursion,
            held,
            self.middle,
            self.half,
            settings.slack,
        )
        factors = [
            self.weights.get(i, 1.0) * (1.0 if i in self.target else settings.rest)
            for i in range(n)
        ]
        Q = torch.diag_embed(centre.new_tensor(factors) / excursion.square())
        R = torch.diag(settings.price * self.prices / self.half.square())
        F, G = dynamics.state, dynamics.action
        K = doubled_lqr(F, G, Q, R, doublings=settings.doublings)
        margin = 1 + self._margin(model)[..., None, None]
        careful = doubled_lqr(margin * F, margin * G, Q, R, doublings=settings.doublings)
        stable = converges(margin * (F + G @ careful), settings.doublings)
        K = torch.where(stable[..., None, None], careful, K)
        constant = action - matvec(K, where)
        new = LinearGain(K, constant)
        # What the model does not keep still at the equilibrium, per tick.
        left = matvec(dynamics.drift, where) + matvec(G, action) + dynamics.constant

        def cost(gain: LinearGain) -> Tensor:
            assert gain.constant is not None
            off = gain.constant + matvec(gain.state, where) - action
            return self._cost(gain.state, off, F, G, left, Q, R, excursion)

        new_cost, old_cost = cost(new), cost(old)
        # A comparison with NaN is false, and the policy stays.
        unstable = torch.where(old_cost.isfinite(), old_cost, torch.inf)
        better = (new_cost < (1 - settings.gain) * unstable)[..., None]
        change = LinearGain(
            torch.where(better[..., None], new.state - old.state, 0.0),
            torch.where(better, constant - old.constant, 0.0),
        )
        value = -torch.where(better.squeeze(-1), new_cost, old_cost)
        return ValueGradient(value.nan_to_num(-1e300, 1e300, -1e300), self.policy.of_gain(change))

    def _margin(self, model: Parameters) -> Tensor:
        """d ``[B]``: ``margin`` standard errors of the model, relative to the data's spread."""
        error = model["error"]
        per_tick = self.model.residual_noise(error, error.new_tensor(self.dt))
        variance = self.model.noise_over(per_tick, self.dt).diagonal(dim1=-2, dim2=-1)
        spread = model["spread"].square()
        share = torch.where(spread > 0, variance / spread, 0.0).mean(-1)
        unknowns = 1 + error.shape[-1] + self.half.shape[-1]
        standard = (share * unknowns / model["count"].clamp(min=1)).sqrt()
        return (self.settings.margin * standard).clamp(max=_MOST)

    def _cost(
        self,
        K: Tensor,
        off: Tensor,
        F: Tensor,
        G: Tensor,
        left: Tensor,
        Q: Tensor,
        R: Tensor,
        excursion: Tensor,
    ) -> Tensor:
        """``[B]``, of a = a_eq + off + K (s - s_eq), in the coordinates (1, s - s_eq)."""
        pull = torch.cat([off.unsqueeze(-1), K], dim=-1)
        moved = torch.cat([left.unsqueeze(-1), F], dim=-1) + G @ pull
        A = torch.cat([torch.zeros_like(moved[..., :1, :]), moved], dim=-2)
        A[..., 0, 0] = 1.0
        total = summed(A, pad(Q, (1, 0, 1, 0)) + pull.mT @ R @ pull, self.settings.doublings)
        second = pad(excursion.square(), (1, 0), value=1.0)
        return (total.diagonal(dim1=-2, dim2=-1) * second).sum(-1)
