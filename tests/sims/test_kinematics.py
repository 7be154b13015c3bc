"""Forward and inverse kinematics against PyBullet, trigonometry and automatic differentiation."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from torch import Tensor
from torch.func import jacrev

pytest.importorskip("pybullet", reason="the extra [cardea] is not installed: no PyBullet")
pytest.importorskip(
    "pytorch_kinematics", reason="the extra [cardea] is not installed: no pytorch-kinematics"
)

from sims.cardea import Cardea
from sims.cardea.arm import HIGH, LOW, SHOULDER, slant, wrist
from sims.cardea.physics import URDF, pybullet
from sims.kinematics import Chain, Pose

pytestmark = pytest.mark.oracle  # the first use imports for some seconds

ORIGIN = torch.tensor(SHOULDER).double()


@pytest.fixture(scope="module")
def chain() -> Chain:
    return Cardea().chain()


def poses(count: int) -> Tensor:
    """Joint angles ``[count, 5]``."""
    generator = np.random.default_rng(0)
    return torch.from_numpy(generator.uniform(LOW, HIGH, (count, 5)))


def goals(count: int) -> Tensor:
    """Joint angles of goals, ``[count, 5]``."""
    generator = torch.Generator().manual_seed(0)
    seeds = torch.rand(count, 2, generator=generator, dtype=torch.float64)
    return Cardea().initial(seeds)[:, 14:19]


def test_forward_agrees_with_trigonometry(chain: Chain) -> None:
    angles = poses(50)
    pose = chain.forward(angles)
    torch.testing.assert_close(pose.position, wrist(angles) + ORIGIN, rtol=0, atol=1e-6)
    upright = pose.rotation[:, 2, 2].clamp(-1, 1)
    torch.testing.assert_close(upright, slant(angles).cos(), rtol=0, atol=1e-6)
    assert chain.forward(angles.reshape(5, 10, 5)).rotation.shape == (5, 10, 3, 3)
    assert chain.forward(angles[0]).position.shape == (3,)


def test_forward_agrees_with_pybullet(chain: Chain) -> None:
    bullet = pybullet()
    client = bullet.connect(bullet.DIRECT)
    body = bullet.loadURDF(str(URDF), useFixedBase=True, physicsClientId=client)
    joints = range(bullet.getNumJoints(body, physicsClientId=client))
    names = [bullet.getJointInfo(body, j, physicsClientId=client)[1].decode() for j in joints]
    for angles in poses(10):
        for name, angle in zip(chain.joints, angles.tolist(), strict=True):
            bullet.resetJointState(body, names.index(name), angle, physicsClientId=client)
        hand = bullet.getLinkState(
            body, names.index("wrist_roll"), computeForwardKinematics=1, physicsClientId=client
        )
        pose = chain.forward(angles)
        # The body's frame is that of the axle, a wheel's radius above the ground.
        expected = np.array(hand[4]) - [0, 0, 0.24]
        np.testing.assert_allclose(pose.position, expected, rtol=0, atol=1e-6)
        rotation = np.reshape(bullet.getMatrixFromQuaternion(hand[5]), (3, 3))
        np.testing.assert_allclose(pose.rotation, rotation, rtol=0, atol=1e-6)
    bullet.disconnect(physicsClientId=client)


def test_jacobian_is_the_derivative(chain: Chain) -> None:
    def position(angles: Tensor) -> Tensor:
        return chain.forward(angles).position

    angles = poses(6)
    jacobian = chain.jacobian(angles)
    assert jacobian.shape == (6, 6, 5)
    for row, of_row in zip(angles, jacobian, strict=True):
        derivative = jacrev(position)(row)
        assert isinstance(derivative, Tensor)
        torch.testing.assert_close(of_row[:3], derivative, rtol=0, atol=1e-12)
    # The angular rows: R' = [w] R along a random rate.
    rate, step = torch.linspace(-1, 1, 5).double(), 1e-6
    ahead, behind = (chain.forward(angles + sign * step * rate).rotation for sign in (1, -1))
    spin = (ahead - behind) / (2 * step) @ chain.forward(angles).rotation.mT
    omega = torch.stack((spin[:, 2, 1], spin[:, 0, 2], spin[:, 1, 0]), -1)
    torch.testing.assert_close(jacobian[:, 3:] @ rate, omega, rtol=0, atol=1e-6)


def test_the_jacobian_has_derivatives_too(chain: Chain) -> None:
    angles, step = poses(1)[0], 1e-6
    second = jacrev(chain.jacobian)(angles)
    assert isinstance(second, Tensor)
    for k, direction in enumerate(torch.eye(5).double()):
        change = chain.jacobian(angles + step * direction) - chain.jacobian(
            angles - step * direction
        )
        torch.testing.assert_close(second[..., k], change / (2 * step), rtol=0, atol=1e-8)


def test_inverse_agrees_with_trigonometry(chain: Chain) -> None:
    angles = goals(40)
    solution = chain.level((wrist(angles) + ORIGIN).reshape(4, 10, 3))
    assert solution.found.all() and solution.found.shape == (4, 10)
    torch.testing.assert_close(solution.angles.reshape(40, 5), angles, rtol=0, atol=1e-6)


def test_inverse_of_any_pose(chain: Chain) -> None:
    angles = poses(20)
    pose = chain.forward(angles)
    solution = chain.inverse(pose)
    assert solution.found.double().mean() > 0.9
    reached = chain.forward(solution.angles[solution.found])
    found = solution.found
    torch.testing.assert_close(reached.position, pose.position[found], rtol=0, atol=1e-7)
    torch.testing.assert_close(reached.rotation, pose.rotation[found], rtol=0, atol=1e-6)


def test_out_of_reach_is_said(chain: Chain) -> None:
    solution = chain.level(torch.tensor([[0.9, 0.0, 0.9], [0.5, 0.1, 1.0]]).double())
    assert solution.found.tolist() == [False, True]
    assert solution.angles[0].isnan().all() and solution.angles[1].isfinite().all()
    upside_down = Pose(
        torch.tensor([0.5, 0.0, 0.9]).double(), torch.diag(torch.tensor([1, -1, -1.0]))
    )
    assert not bool(chain.inverse(upside_down).found)


def test_refuses_the_impossible() -> None:
    with pytest.raises(ValueError, match="end='foot'"):
        Chain(URDF, "body", "foot")
    with pytest.raises(ValueError, match="expected 5 angles"):
        Chain(URDF, "body", "hand", low=[0.0])
    with pytest.raises(ValueError, match="joint slide: expected revolute"):
        Chain(URDF, "ground", "hand")
    with pytest.raises(ValueError, match=r"angles: shape \(3,\)"):
        Chain(URDF, "body", "hand").forward(torch.zeros(3).double())
