"""300 mutated URDF files: the right answer, or one line with the file's name."""

from __future__ import annotations

import random
from collections.abc import Callable
from pathlib import Path
from xml.etree.ElementTree import Comment, Element, SubElement, fromstring, tostring

import pytest
import torch
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from torch import Tensor

pytest.importorskip(
    "pytorch_kinematics", reason="the extra [cardea] is not installed: no pytorch-kinematics"
)

from sims.kinematics import Chain
from tests.sims.plain_urdf import joint, pose, robot

pytestmark = pytest.mark.oracle  # some seconds

ARM = robot(
    joint(0, inside='<origin xyz="0.1 0 0.3" rpy="0.2 0 -0.4"/><axis xyz="0 0 1"/>'),
    joint(1, "prismatic", limit='<limit lower="-0.5" upper="0.4" effort="1" velocity="1"/>'),
    joint(2, "continuous", inside='<axis xyz="1 0 0"/>', limit='<limit effort="1"/>'),
    joint(3, "fixed", limit=""),
    joint(4, inside='<mimic joint="j0" multiplier="-0.5" offset="0.1"/>'),
    links=7,
)
JOINTS = {"j0": 0.3, "j1": -0.2, "j2": 0.8}

Mutation = Callable[[Element, random.Random], None]


def _some(of: Element, chance: random.Random) -> Element:
    return chance.choice(list(of))


def _shuffle(arm: Element, chance: random.Random) -> None:
    for element in (arm, *arm):
        parts = list(element)
        chance.shuffle(parts)
        element[:] = parts


def _shuffle_attributes(arm: Element, chance: random.Random) -> None:
    for element in arm.iter():
        items = list(element.attrib.items())
        chance.shuffle(items)
        element.attrib.clear()
        element.attrib.update(items)


def _comment(arm: Element, chance: random.Random) -> None:
    _some(arm, chance).insert(0, Comment("<joint>"))


def _shapes(arm: Element, chance: random.Random) -> None:
    link = chance.choice(arm.findall("link"))
    for tag in ("visual", "collision", "visual", "inertial"):
        part = SubElement(link, tag)
        SubElement(part, "origin", xyz="a", rpy="${x}")
        SubElement(SubElement(part, "geometry"), "mesh", filename="package://none.dae")


def _unknown(arm: Element, chance: random.Random) -> None:
    SubElement(_some(arm, chance), chance.choice(("what", "hardware", "dynamics")), joint="j0")


def _simulators(arm: Element, chance: random.Random) -> None:
    for tag in ("gazebo", "transmission", "ros2_control", "material"):
        part = SubElement(arm, tag, name="j0", reference=chance.choice(("j0", "none")))
        SubElement(part, "joint", name="j0", type="ball")


def _elsewhere(arm: Element, chance: random.Random) -> None:
    name = f"extra{len(arm)}"
    SubElement(arm, "link", name=name)
    kind = chance.choice(("floating", "planar", "revolute", "strange"))
    more = SubElement(arm, "joint", name=f"to {name}", type=kind)
    SubElement(more, "parent", link="l2")
    SubElement(more, "child", link=name)
    SubElement(more, "axis", xyz="0 0 0")


def _long_axes(arm: Element, chance: random.Random) -> None:
    for axis in arm.iter("axis"):
        length = chance.uniform(0.1, 10)
        axis.set("xyz", " ".join(str(float(x) * length) for x in axis.attrib["xyz"].split()))


def _other_spelling(arm: Element, chance: random.Random) -> None:
    for origin in arm.findall("joint/origin"):
        for key in ("xyz", "rpy"):
            if key in origin.attrib:
                numbers = map(float, origin.attrib[key].split())
                origin.set(key, "\t" + "  ".join(f"{x:+.17e}" for x in numbers) + " ")


def _drop_defaults(arm: Element, chance: random.Random) -> None:
    for part in arm.findall("joint"):
        axis, origin = part.find("axis"), part.find("origin")
        if axis is not None and axis.get("xyz") == "1 0 0":
            part.remove(axis)
        if origin is not None and origin.get("rpy") == "0 0 0":
            del origin.attrib["rpy"]


SAME: list[Mutation] = [
    _shuffle,
    _shuffle_attributes,
    _comment,
    _shapes,
    _unknown,
    _simulators,
    _elsewhere,
    _long_axes,
    _other_spelling,
    _drop_defaults,
]

VALUES = (
    *("", " ", "nan", "inf", "-inf", "1e400", "1e-400", "0", "-1", "2.5", "0,3", "1_0", "0x1"),
    *("${x}", "$(arg x)", "0 0 0", "1 2", "1 2 3 4", "0 1 0", "nan 0 0", "l0", "l3", "j0", "j4"),
    *("revolute", "continuous", "prismatic", "fixed", "floating", "planar", "Revolute", "é"),
)
TAGS = ("joint", "link", "axis", "origin", "limit", "mimic", "parent", "child", "orgin", "xacro:x")


def _value(arm: Element, chance: random.Random) -> None:
    element = chance.choice([part for part in arm.iter() if part.attrib])
    element.set(chance.choice(list(element.attrib)), chance.choice(VALUES))


def _less(arm: Element, chance: random.Random) -> None:
    element = chance.choice([part for part in arm.iter() if part.attrib])
    del element.attrib[chance.choice(list(element.attrib))]


def _rename(arm: Element, chance: random.Random) -> None:
    chance.choice(list(arm.iter())).tag = chance.choice(TAGS)


def _rename_attribute(arm: Element, chance: random.Random) -> None:
    element = chance.choice([part for part in arm.iter() if part.attrib])
    key = chance.choice(list(element.attrib))
    element.set(key[::-1] if chance.random() < 0.5 else key + "s", element.attrib.pop(key))


def _remove(arm: Element, chance: random.Random) -> None:
    element = chance.choice([part for part in arm.iter() if len(part)])
    element.remove(_some(element, chance))


def _repeat(arm: Element, chance: random.Random) -> None:
    element = chance.choice([part for part in arm.iter() if len(part)])
    element.append(_some(element, chance))


def _move(arm: Element, chance: random.Random) -> None:
    """One joint's part becomes another's too."""
    source, to = (chance.choice(arm.findall("joint") or [arm]) for _ in range(2))
    if len(source):
        part = _some(source, chance)
        to[:] = [other for other in to if other.tag != part.tag] + [part]


CHANGED: list[Mutation] = [_value, _less, _rename, _rename_attribute, _remove, _repeat, _move]


def _mutate(mutations: list[Mutation], chance: random.Random) -> bytes:
    arm = fromstring(ARM)
    for _ in range(chance.randint(1, 3)):
        chance.choice(mutations)(arm, chance)
    encoding = chance.choice(("utf-8", "us-ascii", "iso-8859-1", "utf-16", "windows-1252"))
    return tostring(arm, encoding=encoding, xml_declaration=True)


def _numbers(chain: Chain) -> Tensor:
    at = torch.tensor([JOINTS[name] for name in chain.joints], dtype=torch.float64)
    reached = chain.forward(at)
    return torch.cat((reached.rotation, reached.position[:, None]), 1)


every = settings(deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])


@settings(every, max_examples=100)
@given(seed=st.integers(0, 2**32))
def test_what_keeps_the_meaning_keeps_the_answer(tmp_path: Path, seed: int) -> None:
    path = tmp_path / "arm.urdf"
    path.write_bytes(_mutate(SAME, random.Random(seed)))
    chain = Chain(path, "l0", "l5")
    assert chain.joints == ("j0", "j1", "j2")
    assert chain.low.tolist() == [-1, -0.5, -torch.inf]
    assert chain.high.tolist() == [1, 0.4, torch.inf]
    expected = torch.from_numpy(pose(ARM, "l0", "l5", JOINTS)[:3])
    torch.testing.assert_close(_numbers(chain), expected, rtol=0, atol=1e-12)


def _right_or_one_line(path: Path, data: bytes) -> None:
    path.write_bytes(data)
    try:
        chain = Chain(path, "l0", "l5")
    except ValueError as error:
        assert str(path) in str(error) and "\n" not in str(error)
        return
    assert bool((chain.low <= chain.high).all())
    if set(chain.joints) <= set(JOINTS):
        expected = torch.from_numpy(pose(data, "l0", "l5", JOINTS)[:3])
        torch.testing.assert_close(_numbers(chain), expected, rtol=0, atol=1e-9)


@settings(every, max_examples=150)
@given(seed=st.integers(0, 2**32))
def test_what_changes_the_meaning_is_followed_or_refused(tmp_path: Path, seed: int) -> None:
    _right_or_one_line(tmp_path / "arm.urdf", _mutate(CHANGED, random.Random(seed)))


@settings(every, max_examples=50)
@given(seed=st.integers(0, 2**32))
def test_damaged_bytes(tmp_path: Path, seed: int) -> None:
    chance = random.Random(seed)
    data = bytearray(ARM.encode())
    if chance.random() < 0.3:
        del data[chance.randrange(len(data)) :]
    for _ in range(chance.randint(0, 4)):
        data[chance.randrange(len(data) - 1)] = chance.choice(b"\x00\xff<>\"'& 0159-.e&/=\n")
    _right_or_one_line(tmp_path / "arm.urdf", bytes(data))
