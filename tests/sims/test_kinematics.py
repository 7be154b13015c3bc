"""Forward and inverse kinematics against PyBullet, trigonometry and automatic differentiation."""

from __future__ import annotations

import math
from pathlib import Path

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
from tests.sims.plain_urdf import joint, pose, robot

pytestmark = pytest.mark.oracle  # the first use imports for some seconds

ORIGIN = torch.tensor(SHOULDER, dtype=torch.float64)


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
    torch.testing.assert_close(pose.position, wrist(angles) + ORIGIN, rtol=0, atol=1e-12)
    upright = pose.rotation[:, 2, 2].clamp(-1, 1)
    torch.testing.assert_close(upright, slant(angles).cos(), rtol=0, atol=1e-12)
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
    assert solution.found.all()
    reached = chain.forward(solution.angles)
    torch.testing.assert_close(reached.position, pose.position, rtol=0, atol=1e-9)
    torch.testing.assert_close(reached.rotation, pose.rotation, rtol=0, atol=1e-9)


def test_out_of_reach_is_said(chain: Chain) -> None:
    solution = chain.level(torch.tensor([[0.9, 0.0, 0.9], [0.5, 0.1, 1.0]]).double())
    assert solution.found.tolist() == [False, True]
    assert solution.angles[0].isnan().all() and solution.angles[1].isfinite().all()
    upside_down = Pose(
        torch.tensor([0.5, 0.0, 0.9]).double(), torch.diag(torch.tensor([1, -1, -1.0]))
    )
    assert not bool(chain.inverse(upside_down).found)


def test_refuses_the_impossible(chain: Chain) -> None:
    with pytest.raises(ValueError, match="end='foot'"):
        Chain(URDF, "body", "foot")
    with pytest.raises(ValueError, match="expected 5 numbers"):
        Chain(URDF, "body", "hand", low=[0.0])
    with pytest.raises(ValueError, match=r"joint 'elbow': range from nan to .* low <= high"):
        Chain(URDF, "body", "hand", low=[-1, -1, math.nan, -1, -1])
    with pytest.raises(ValueError, match=r"angles: shape \(3,\)"):
        chain.forward(torch.zeros(3).double())
    with pytest.raises(ValueError, match=r"pose: shapes \(2,\) and \(3, 3\), expected"):
        chain.inverse(Pose(torch.zeros(2), torch.eye(3)))


def test_forward_is_exact_whatever_the_joints(tmp_path: Path) -> None:
    """Against an independent reading of the file, in float64 throughout."""
    oblique = '<origin xyz="0.1 -0.2 0.3" rpy="0.7 -1.1 2.3"/><axis xyz="1 -2 0.5"/>'
    text = robot(
        joint(0, inside=oblique),
        joint(1, "prismatic", inside=oblique),
        joint(2, "fixed", inside=oblique),
        joint(3, "continuous", inside=oblique),
        joint(4, inside=oblique + '<mimic joint="j3" multiplier="-0.3" offset="0.2"/>', limit=""),
        # Off the way to l5; a finger follows it.
        '<joint name="twin" type="prismatic"><parent link="l0"/><child link="l6"/>'
        '<limit lower="0" upper="0.1"/></joint>',
        joint(5, "prismatic", inside='<mimic joint="twin"/>').replace("l6", "l7"),
        links=8,
    )
    (tmp_path / "arm.urdf").write_text(text)
    chain = Chain(tmp_path / "arm.urdf", "l0", "l7")
    assert chain.joints == ("j0", "j1", "j3", "twin")
    assert chain.low.tolist() == [-1, -1, -math.inf, 0]
    angles = 2 * torch.rand(20, 4, generator=torch.Generator().manual_seed(0)).double() - 1
    rows = [dict(zip(chain.joints, q, strict=True)) for q in angles.tolist()]
    expected = [pose(text, "l0", "l7", row) for row in rows]
    reached = chain.forward(angles)
    matrices = torch.from_numpy(np.stack(expected))
    torch.testing.assert_close(reached.position, matrices[:, :3, 3], rtol=0, atol=1e-12)
    torch.testing.assert_close(reached.rotation, matrices[:, :3, :3], rtol=0, atol=1e-12)

    def position(q: Tensor) -> Tensor:
        return chain.forward(q).position

    for q in angles[:3]:
        derivative = jacrev(position)(q)
        assert isinstance(derivative, Tensor)
        torch.testing.assert_close(chain.jacobian(q)[:3], derivative, rtol=0, atol=1e-12)
    here = angles * torch.tensor([1, 1, 3, 0.05]) + torch.tensor([0, 0, 0, 0.05])
    assert chain.inverse(chain.forward(here)).found.all()


@pytest.mark.parametrize(
    ("file", "root", "end", "tip"),
    [
        ("franka_panda/panda.urdf", "panda_link0", "panda_hand", "panda_hand_joint"),
        ("kuka_iiwa/model.urdf", "lbr_iiwa_link_0", "lbr_iiwa_link_7", "lbr_iiwa_joint_7"),
        ("xarm/xarm6_robot.urdf", "link_base", "link6", "joint6"),
        ("r2d2.urdf", "base_link", "head", "head_swivel"),
        ("husky/husky.urdf", "base_footprint", "rear_left_wheel_link", "rear_left_wheel"),
    ],
)
def test_robots_of_pybullet(file: str, root: str, end: str, tip: str) -> None:
    """Forward kinematics agree with PyBullet's, 30 of 30 reachable poses are found."""
    pybullet_data = pytest.importorskip("pybullet_data")
    path = f"{pybullet_data.getDataPath()}/{file}"
    chain = Chain(path, root, end)
    generator = torch.Generator().manual_seed(1)
    share = torch.rand(30, len(chain.joints), generator=generator, dtype=torch.float64)
    low, high = chain.low.clamp(min=-math.pi), chain.high.clamp(max=math.pi)
    angles = low + (high - low) * share
    reached = chain.forward(angles)
    bullet = pybullet()
    client = bullet.connect(bullet.DIRECT)
    body = bullet.loadURDF(path, useFixedBase=True, physicsClientId=client)
    infos = [
        bullet.getJointInfo(body, j, physicsClientId=client)
        for j in range(bullet.getNumJoints(body, physicsClientId=client))
    ]
    names = [info[1].decode() for info in infos]
    for q, position, rotation in zip(angles[:5], reached.position, reached.rotation, strict=False):
        for name, angle in zip(chain.joints, q.tolist(), strict=True):
            bullet.resetJointState(body, names.index(name), angle, physicsClientId=client)
        link = bullet.getLinkState(
            body, names.index(tip), computeForwardKinematics=1, physicsClientId=client
        )
        turned = torch.tensor(bullet.getMatrixFromQuaternion(link[5])).reshape(3, 3)
        torch.testing.assert_close(position, torch.tensor(link[4]).double(), rtol=0, atol=1e-6)
        torch.testing.assert_close(rotation, turned.double(), rtol=0, atol=1e-6)
    bullet.disconnect(physicsClientId=client)
    solution = chain.inverse(reached)
    assert solution.found.all()
    inside = (solution.angles >= chain.low) & (solution.angles <= chain.high)
    assert inside.all()
    alone = chain.inverse(Pose(reached.position[7], reached.rotation[7]))
    torch.testing.assert_close(alone.angles, solution.angles[7], rtol=0, atol=1e-9)
    again = chain.forward(solution.angles)
    torch.testing.assert_close(again.position, reached.position, rtol=0, atol=1e-7)
    torch.testing.assert_close(again.rotation, reached.rotation, rtol=0, atol=1e-7)


@pytest.mark.parametrize("limit", [None, 3.14, math.pi, 7.0, 1e16])
def test_a_planar_arm_that_turns_all_the_way(tmp_path: Path, limit: float | None) -> None:
    """Closed form: elbow angle from the law of cosines, the same turn in all."""
    kind = "continuous" if limit is None else "revolute"
    text = '<limit effort="10"/>' if limit is None else f'<limit lower="-{limit}" upper="{limit}"/>'
    arm = [joint(k, kind, limit=text) for k in range(3)]
    (tmp_path / "arm.urdf").write_text(robot(*arm, joint(3, "fixed")))
    chain = Chain(tmp_path / "arm.urdf", "l0", "l4")
    share = torch.rand(30, 3, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    angles = (2 * share - 1) * min(limit or math.pi, math.pi)
    target = chain.forward(angles)
    heading = angles.cumsum(-1)
    reach = (0.3 * heading.sin()).sum(-1)
    torch.testing.assert_close(target.position[:, 0], reach, rtol=0, atol=1e-12)
    solution = chain.inverse(target)
    assert solution.found.all() and solution.angles.abs().max() <= math.pi
    torch.testing.assert_close(solution.angles[:, 1].cos(), angles[:, 1].cos(), rtol=0, atol=1e-7)
    whole = (solution.angles.sum(-1) - angles.sum(-1)) / (2 * math.pi)
    torch.testing.assert_close(whole, whole.round(), rtol=0, atol=1e-7)


@pytest.mark.parametrize("gear", [-1.0, 3.0, 0.5])
def test_a_joint_that_drives_another_through_a_gear(tmp_path: Path, gear: float) -> None:
    follower = f'<mimic joint="j0" multiplier="{gear}" offset="1"/>'
    arm = [joint(0, "continuous"), joint(1, "continuous", inside=follower), joint(2, "continuous")]
    (tmp_path / "arm.urdf").write_text(robot(*arm))
    chain = Chain(tmp_path / "arm.urdf", "l0", "l3")
    share = torch.rand(30, 2, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    target = chain.forward((2 * share - 1) * math.pi)
    solution = chain.inverse(target)
    assert solution.found.all()
    reached = chain.forward(solution.angles)
    torch.testing.assert_close(reached.position, target.position, rtol=0, atol=1e-7)
    if gear.is_integer():
        assert solution.angles.abs().max() <= math.pi


def test_a_target_that_is_no_pose_leaves_the_others_alone(chain: Chain) -> None:
    home = chain.forward(poses(40))
    for away in (0.5, 1.0, 5.0, 1e300, math.inf, math.nan):
        assert not chain.inverse(Pose(home.position + away, home.rotation)).found.any()
    mixed = Pose(home.position.clone(), home.rotation.clone())
    mixed.position[3, 0] = math.nan
    mixed.rotation[4, 1, 1] = math.inf
    mixed.rotation[5] = -mixed.rotation[5]
    mixed.rotation[6] = 2 * mixed.rotation[6]
    mixed.position[7] += 0.5
    solution = chain.inverse(mixed)
    expected = [k not in range(3, 8) for k in range(40)]
    assert solution.found.tolist() == expected
    alone = chain.inverse(home).angles
    good = torch.tensor(expected)
    torch.testing.assert_close(solution.angles[good], alone[good], rtol=0, atol=1e-9)
    assert solution.angles[~good].isnan().all()
    empty = chain.inverse(Pose(torch.zeros(0, 3), torch.zeros(0, 3, 3)))
    assert empty.angles.shape == (0, 5) and empty.found.shape == (0,)


def test_random_numbers_elsewhere_do_not_matter(chain: Chain) -> None:
    target = chain.forward(poses(10))
    torch.manual_seed(1)
    first = chain.inverse(target)
    state = torch.get_rng_state()
    torch.manual_seed(2)
    assert torch.equal(chain.inverse(target).angles, first.angles)
    torch.manual_seed(1)
    chain.inverse(target)
    assert torch.equal(torch.get_rng_state(), state)


def test_poses_in_float32_are_met_to_their_precision(chain: Chain) -> None:
    target = chain.forward(poses(20))
    assert chain.inverse(Pose(target.position.float(), target.rotation.float())).found.all()


def test_a_base_that_slides() -> None:
    chain = Chain(URDF, "ground", "hand")
    assert chain.joints[:2] == ("slide", "tilt")
    angles = torch.cat((torch.linspace(-900, 900, 20)[:, None], torch.zeros(20, 1), poses(20)), 1)
    solution = chain.inverse(chain.forward(angles))
    assert solution.found.all()
    shift = chain.forward(angles).position - chain.forward(solution.angles).position
    assert shift.abs().max() < 1e-7


def test_what_the_file_leaves_out_can_be_given(tmp_path: Path) -> None:
    path = tmp_path / "arm.urdf"
    path.write_text(robot(joint(0), joint(1, limit='<limit effort="1" velocity="1"/>')))
    with pytest.raises(ValueError, match=r"joint 'j1': expected <limit lower=.*low and high"):
        Chain(path, "l0", "l2")
    assert Chain(path, "l0", "l2", low=[-1, -2], high=[1, 2]).high.tolist() == [1, 2]
    with pytest.raises(ValueError, match="end='l1': expected a moving joint between them"):
        Chain(path, "l1", "l1")
    long = robot(*(joint(k) for k in range(400)), links=401)
    path.write_text(long)
    with pytest.raises(ValueError, match=r"400 joints between them .* expected at most"):
        Chain(path, "l0", "l400")
