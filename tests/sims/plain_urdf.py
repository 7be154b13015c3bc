"""A second reading of URDF files, for comparison: the library's XML parser, numpy and no checks."""

from __future__ import annotations

import math
from collections.abc import Mapping
from xml.etree.ElementTree import Element, fromstring

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def robot(*joints: str, links: int = 5) -> str:
    """A file with links l0, l1, ..."""
    names = "".join(f'<link name="l{k}"/>' for k in range(links))
    return f'<?xml version="1.0"?><robot name="r">{names}{"".join(joints)}</robot>'


def joint(k: int, kind: str = "revolute", inside: str = "", limit: str | None = None) -> str:
    """Joint j{k} from link l{k} to the next, by default 0.3 m up, about y, up to 1 rad."""
    if limit is None:
        limit = '<limit lower="-1" upper="1" effort="10" velocity="3"/>'
    if "<axis" not in inside:
        inside += '<axis xyz="0 1 0"/>'
    if "<origin" not in inside:
        inside += '<origin xyz="0 0 0.3" rpy="0 0 0"/>'
    ends = f'<parent link="l{k}"/><child link="l{k + 1}"/>'
    return f'<joint name="j{k}" type="{kind}">{ends}{inside}{limit}</joint>'


def pose(data: str | bytes, root: str, end: str, positions: Mapping[str, float]) -> Array:
    """Where the end is, ``[4, 4]``, with the joints that mimic nothing at ``positions``."""
    joints = {j.get("name", ""): j for j in fromstring(data).findall("joint")}
    moved_by = {_attribute(j, "child", "link"): name for name, j in joints.items()}
    matrix, link = np.eye(4), end
    while link != root:
        name = moved_by[link]
        matrix = _placed(joints[name]) @ _moved(joints, name, positions) @ matrix
        link = _attribute(joints[name], "parent", "link")
    return matrix


def turn(axis: Array, angle: float) -> Array:
    """Rodrigues' formula, ``[4, 4]``."""
    x, y, z = axis / np.linalg.norm(axis)
    K = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    matrix = np.eye(4)
    matrix[:3, :3] += math.sin(angle) * K + (1 - math.cos(angle)) * K @ K
    return matrix


def _placed(of: Element) -> Array:
    x, y, z = np.eye(3)
    roll, pitch, yaw = _three(of, "origin", "rpy", "0 0 0")
    matrix = turn(z, yaw) @ turn(y, pitch) @ turn(x, roll)
    matrix[:3, 3] = _three(of, "origin", "xyz", "0 0 0")
    return matrix


def _moved(joints: Mapping[str, Element], name: str, positions: Mapping[str, float]) -> Array:
    of = joints[name]
    if of.get("type") == "fixed":
        return np.eye(4)
    value, axis = _position(joints, name, positions), _three(of, "axis", "xyz", "1 0 0")
    if of.get("type") != "prismatic":
        return turn(axis, value)
    matrix = np.eye(4)
    matrix[:3, 3] = value * axis / np.linalg.norm(axis)
    return matrix


def _position(joints: Mapping[str, Element], name: str, positions: Mapping[str, float]) -> float:
    mimic = joints[name].find("mimic")
    if mimic is None:
        return positions[name]
    of = _position(joints, mimic.attrib["joint"], positions)
    return float(mimic.get("multiplier", 1)) * of + float(mimic.get("offset", 0))


def _attribute(of: Element, tag: str, key: str, default: str = "") -> str:
    part = of.find(tag)
    return default if part is None else part.get(key, default)


def _three(of: Element, tag: str, key: str, default: str) -> Array:
    return np.array([float(number) for number in _attribute(of, tag, key, default).split()])
