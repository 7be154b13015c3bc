"""URDF files: what is read, and one line for what is wrong."""

from __future__ import annotations

import math
from pathlib import Path

import pytest
import torch

from sims.urdf import Drive, Robot
from tests.sims.plain_urdf import joint, robot

ARM = robot(joint(0), joint(1), joint(2, "continuous"), joint(3, "fixed"))


@pytest.fixture
def file(tmp_path: Path) -> Path:
    return tmp_path / "arm.urdf"


def write(file: Path, text: str, encoding: str = "utf-8") -> Robot:
    file.write_bytes(text.encode(encoding))
    return Robot(file)


@pytest.mark.parametrize(
    ("declared", "encoding"),
    [
        ("utf-8", "utf-8"),
        ("UTF-8", "utf-8-sig"),
        ("utf-16", "utf-16"),
        ("iso-8859-1", "latin-1"),
        ("windows-1252", "cp1252"),
        ("shift_jis", "shift_jis"),
        ("us-ascii", "ascii"),
    ],
)
def test_any_encoding_that_the_file_declares(file: Path, declared: str, encoding: str) -> None:
    name = {"shift_jis": "腕", "ascii": "arm"}.get(encoding, "Brücke")
    text = ARM.replace('"1.0"', f'"1.0" encoding="{declared}"').replace("l3", name)
    assert write(file, text, encoding).links == ("l0", "l1", "l2", name, "l4")


def test_what_kinematics_does_not_need_is_not_read(file: Path) -> None:
    shape = '<visual name="${v}"><geometry><mesh filename="package://x"/><box/></geometry></visual>'
    more = (
        f'<link name="tool">{shape}{shape}<collision/><inertial><mass value="?"/></inertial></link>'
        '<transmission name="t"><joint name="j0"/><actuator name="j0"/></transmission>'
        '<gazebo reference="j0"><sensor:camera/><joint name="j0" type="ball"/></gazebo><what/>'
        # A joint off the path may be of any type.
        '<joint name="f" type="floating"><parent link="l0"/><child link="tool"/></joint>'
    )
    text = "\n  " + ARM.replace("</robot>", more + "</robot>")
    text = text.replace("</joint>", '<dynamics damping="1"/><joint_properties/></joint>', 2)
    path = write(file, text).between("l0", "l4")
    assert [(j.name, j.kind) for j in path] == [
        ("j0", "revolute"),
        ("j1", "revolute"),
        ("j2", "revolute"),
        ("j3", "fixed"),
    ]
    with pytest.raises(ValueError, match="joint 'f': type='floating': expected one of revolute"):
        Robot(file).between("l0", "tool")


def test_defaults_are_those_of_the_format(file: Path) -> None:
    bare = '<joint name="j0" type="prismatic"><parent link="l0"/><child link="l1"/>{}</joint>'
    (only,) = write(file, robot(bare.format('<limit upper="2"/>'))).between("l0", "l1")
    assert torch.equal(only.origin, torch.eye(4).double())
    assert only.axis.tolist() == [1, 0, 0]
    assert Robot(file).drive("j0") == Drive("j0", 1, 0, 0, 2)
    assert write(file, robot(bare.format(""))).drive("j0") == Drive("j0", 1, 0, None, None)
    endless = joint(0, limit='<limit lower="-inf" upper="inf"/>')
    assert write(file, robot(endless)).drive("j0") == Drive("j0", 1, 0, -math.inf, math.inf)


@pytest.mark.parametrize("limit", ["", '<limit effort="1"/>', '<limit lower="0" upper="0"/>'])
def test_a_continuous_joint_has_no_limits(file: Path, limit: str) -> None:
    drive = write(file, robot(joint(0, "continuous", limit=limit))).drive("j0")
    assert drive == Drive("j0", 1, 0, -math.inf, math.inf)


def test_axes_are_directions_whatever_their_length(file: Path) -> None:
    for length in ("1", "3", "1e-200", "1e200"):
        text = robot(joint(0, inside=f'<axis xyz="0 {length} -{length}"/>'))
        (only,) = write(file, text).between("l0", "l1")
        expected = torch.tensor([0, 0.5**0.5, -(0.5**0.5)]).double()
        torch.testing.assert_close(only.axis, expected, rtol=0, atol=1e-7)
        assert abs(float(only.axis.norm()) - 1) < 1e-15


def test_a_joint_follows_what_it_mimics(file: Path) -> None:
    first = joint(1, inside='<mimic joint="j0" multiplier="2" offset="0.5"/>')
    second = joint(2, inside='<mimic joint="j1" multiplier="-1"/>', limit="")
    drives = write(file, robot(joint(0), first, second))
    # |2 x + 0.5| <= 1 holds beside |x| <= 1.
    assert drives.drive("j1") == Drive("j0", 2, 0.5, -0.75, 0.25)
    assert drives.drive("j2") == Drive("j0", -2, -0.5, -0.75, 0.25)


PARENT, CHILD = '<parent link="l0"/>', '<child link="l1"/>'


@pytest.mark.parametrize(
    ("old", "new", "complaint"),
    [
        ("</robot>", "", "expected a well-formed XML file: no element found"),
        ("<robot", "junk<robot", "expected a well-formed XML file"),
        ('"1.0"', '"1.0" encoding="klingon"', "unknown encoding: klingon"),
        ("robot", "sdf", "expected the root element <robot>, not <sdf>"),
        ("<link", '<xacro:arm x="1"/><link', "element <xacro:arm>: expected a file expanded"),
        (
            "</joint>",
            "<xacro:x/></joint>",
            "element <xacro:x> in joint 'j0': expected a file expanded",
        ),
        (
            'xyz="0 0 0.3"',
            'xyz="0 0 ${z}"',
            r"'j0': origin xyz='\${z}' \(an unresolved xacro expression",
        ),
        (
            'xyz="0 0 0.3"',
            'xyz="$(arg at)"',
            r"xyz='\$\(arg at\)' \(an unresolved xacro expression.* three numbers",
        ),
        ('xyz="0 0 0.3"', 'xyz="0 0,3"', "'j0': origin xyz='0 0,3': expected three numbers"),
        ('xyz="0 0 0.3"', 'xyz="0 0 0,3"', "'j0': origin xyz='0,3': expected a number"),
        ('xyz="0 0 0.3"', 'xyz="0 0 1_0"', "'j0': origin xyz='1_0': expected a number"),
        ('rpy="0 0 0"', 'rpy="0 nan 0"', "'j0': origin rpy='nan': expected a number"),
        ('rpy="0 0 0"', 'rpy="0 inf 0"', "'j0': origin rpy='inf': expected a number"),
        ('rpy="0 0 0"', 'quat_xyzw="0 0 0 1"', "unknown attribute 'quat_xyzw' of <origin>"),
        ('xyz="0 1 0"', 'xyz="0 0 0"', "'j0': axis xyz is zero: expected a direction"),
        ('xyz="0 1 0"', 'xyz="0 1"', "'j0': axis xyz='0 1': expected three numbers"),
        ("<axis", "<axes", "'j0': unknown element <axes>; meant <axis>?"),
        ("<axis", '<axis xyz="1 0 0"/><axis', "'j0': 2 elements <axis>: expected one"),
        ('lower="-1"', 'lower="2"', r"'j0': limit lower=2.0, upper=1.0: expected lower <= upper"),
        ('lower="-1"', 'lower=""', "'j0': limit lower='': expected a number"),
        ('lower="-1"', 'lower="nan"', "'j0': limit lower='nan': expected a number"),
        ("revolute", "planar", "'j0': type='planar': expected one of revolute, continuous"),
        ('type="revolute"', "", "'j0': type=None: expected one of"),
        (PARENT, "", "'j0': expected an element <parent>"),
        (CHILD, "<child/>", "'j0': expected an attribute 'link' of <child>"),
        (CHILD, '<child link="x"/>', "'j0': child link='x': expected one of l0, l1"),
        (PARENT, '<parent link="l1"/>', "'j0': the links 'l1' and 'l1' are in a cycle"),
        (PARENT, '<parent link="l4"/>', r"'j.': the links .* are in a cycle"),
        ('name="j1"', 'name="j0"', "joint 'j0': expected unique names"),
        ('name="j0"', "", "a <joint> has no name"),
        ('<link name="l1"', '<link name="l0"', "link 'l0': expected unique names"),
        (
            '<child link="l2"',
            '<child link="l1"',
            "joint 'j1': link 'l1' is the child of joint 'j0'",
        ),
        ("<axis", '<mimic joint="j3"/><axis', "'j0': mimics 'j3': expected a moving joint"),
        ("<axis", '<mimic joint="j0"/><axis', "'j0': mimics itself through 'j0'"),
        ("<axis", "<mimic/><axis", "'j0': expected an attribute 'joint' of <mimic>"),
        (
            "<axis",
            '<mimic joint="j1" offset="7"/><axis',
            "'j0': mimics 'j1': expected limits that both can keep",
        ),
    ],
)
def test_one_line_for_what_is_wrong(file: Path, old: str, new: str, complaint: str) -> None:
    count = -1 if old == "robot" else 1
    text = ARM.replace(old, new, count)
    with pytest.raises(ValueError, match=complaint) as refusal:
        arm = write(file, text)
        for part in arm.between("l0", "l4"):
            if part.kind != "fixed":
                arm.drive(part.name)
    assert "\n" not in str(refusal.value) and str(file) in str(refusal.value)


def test_links_that_are_not_there_or_not_connected(file: Path) -> None:
    arm = write(file, ARM)
    with pytest.raises(ValueError, match=r"end='foot': expected one of the links of .*arm\.urdf"):
        arm.between("l0", "foot")
    with pytest.raises(ValueError, match=r"root='l3', end='l1': .* it descends from 'l0'"):
        arm.between("l3", "l1")
