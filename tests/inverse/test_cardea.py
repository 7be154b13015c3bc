"""What of the inverse learners needs the arm itself."""

from __future__ import annotations

import pytest
import torch
from torch import Tensor
from torch.func import jacrev

pytest.importorskip("pybullet", reason="the extra [cardea] is not installed: no PyBullet")
pytest.importorskip(
    "pytorch_kinematics", reason="the extra [cardea] is not installed: no pytorch-kinematics"
)

from edtorch.inverse.features import INVERSE_FEATURES
from edtorch.inverse.hand import HandCoordinates
from edtorch.inverse.layout import Layout
from edtorch.run.evaluation import evaluate_controller
from edtorch.run.scaled_sim import World
from sims.base import Outcome
from sims.cardea import LIMITS, Cardea, Trouble
from sims.cardea.arm import HIGH, LOW

pytestmark = pytest.mark.oracle

CARDEA = Cardea(torque_noise=0.0)
LAYOUT = Layout(CARDEA.spec)


def _states(count: int, speed: float = 1.0) -> Tensor:
    """Full states of the arm anywhere within its ranges, the base near upright, ``[count, 26]``."""
    generator = torch.Generator().manual_seed(2)
    low, high = torch.tensor(LOW).double(), torch.tensor(HIGH).double()
    share = torch.rand(2, count, 5, generator=generator, dtype=torch.float64)
    state = CARDEA.at_rest(low + (high - low) * share[0], low + (high - low) * share[1])
    spread = torch.tensor([0.03, 0.1, *(speed * s for s in (1, 1, 1, 1, 1, 0.05, 0.2))])
    state[:, 5:14] = spread * torch.randn(count, 9, generator=generator, dtype=torch.float64)
    return state


def _unexplained(features: str, speed: float) -> float:
    """Share of the true torques' variation that ridge least squares leaves, on fresh states."""
    phi = INVERSE_FEATURES[features](LAYOUT)
    state = _states(4000, speed)
    generator = torch.Generator().manual_seed(3)
    acceleration = 4 * torch.randn(4000, 5, generator=generator, dtype=torch.float64)
    torque = CARDEA.inverse_dynamics(state, acceleration) / torch.tensor(LIMITS)
    rows = phi(state[:, :14], acceleration)
    known, fresh = slice(0, 3000), slice(3000, 4000)
    A = rows[known].mT @ rows[known] + 1e-6 * torch.eye(phi.outputs, dtype=torch.float64)
    weight = torch.linalg.solve(A, rows[known].mT @ torque[known])
    left = (rows[fresh] @ weight - torque[fresh]).square().mean(0).sqrt()
    return float((left / torque[fresh].std(0)).max())


def test_structured_features_explain_the_inverse_dynamics() -> None:
    """The shares of the joint that is explained worst."""
    assert _unexplained("structured", 1.0) < 0.12
    assert _unexplained("pairwise", 1.0) > 0.3
    assert _unexplained("linear", 1.0) > 0.5


def test_sizes_of_the_feature_sets() -> None:
    assert INVERSE_FEATURES["linear"](LAYOUT).outputs == 26
    assert INVERSE_FEATURES["pairwise"](LAYOUT).outputs == 351
    state, acceleration = torch.rand(2, 3, 14), torch.rand(2, 3, 5)
    for make in INVERSE_FEATURES.values():
        phi = make(LAYOUT)
        assert phi(state, acceleration).shape == (2, 3, phi.outputs)


def test_layout_is_in_order() -> None:
    assert LAYOUT.names == [q.name for q in CARDEA.spec.state[:14]]
    assert (LAYOUT.joints, LAYOUT.others, LAYOUT.angles) == (5, 2, [0, 1, 2, 3, 4, 5])


def _hand() -> HandCoordinates:
    return HandCoordinates(LAYOUT, CARDEA.chain())


def _observed(state: Tensor) -> Tensor:
    return World(CARDEA).observe(state)


def test_the_jacobian_is_that_of_the_place() -> None:
    hand = _hand()
    for q in _states(5)[:, :5]:
        expected = jacrev(hand.place)(q)
        torch.testing.assert_close(hand.jacobian(q), expected, rtol=1e-9, atol=1e-9)


def test_a_wish_of_the_hand_is_granted_by_the_joints() -> None:
    """d^2/dt^2 y(q(t)) is the wish, but for what the damping takes."""
    hand = HandCoordinates(LAYOUT, CARDEA.chain(), damping=1e-6)
    state = _states(50)
    view = hand.view(_observed(state))
    wish = torch.randn(50, 5, generator=torch.Generator().manual_seed(4), dtype=torch.float64)
    ddq = hand.joint_acceleration(view, wish)
    q, dq, t = state[:, :5], state[:, 7:12], 1e-3
    on, back = (hand.place(q + s * t * dq + 0.5 * t * t * ddq) for s in (1, -1))
    here = hand.place(q)
    bent = q[:, 2] < -0.3
    far = ((hand.jacobian(q).det().abs() > 0.5) & bent).unsqueeze(-1)
    granted = (on - 2 * here + back) / t**2
    assert int(far.sum()) > 25
    torch.testing.assert_close(
        torch.where(far, granted, wish), wish, rtol=0, atol=2e-2 * float(wish.abs().max())
    )
    torch.testing.assert_close(view.state[:, 7:12], (on - back) / (2 * t), rtol=0, atol=1e-2)


def test_computed_torque_is_a_baseline() -> None:
    control = CARDEA.baselines()["computed_torque"]
    (episodes,) = evaluate_controller(control, World(CARDEA), [0], 3)
    assert [e.outcome for e in episodes] == [Outcome.SUCCEEDED] * 3
    assert max(e.measures["joint_error_rad"] for e in episodes) < 1e-3


def test_a_step_that_failed_teaches_nothing() -> None:
    state = _states(3)
    state[0, 25], state[1, 25] = int(Trouble.LOST), int(Trouble.CONTACT)
    active = torch.tensor([True, True, False])
    assert World(CARDEA).stepped(state, active).tolist() == [False, True, False]
