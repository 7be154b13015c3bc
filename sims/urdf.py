"""The moving parts of a robot in a URDF file, and nothing else of it.

Only the links' names and each joint's type, links, origin, axis, limits and mimic element are read,
with the defaults of https://wiki.ros.org/urdf/XML/joint.  Inertias, shapes, transmissions and
simulators' extensions are ignored.  The tree of links and joints is checked for the whole file,
numbers only for the joints asked for.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable
from dataclasses import dataclass
from difflib import get_close_matches
from pathlib import Path
from typing import Literal
from xml.etree.ElementTree import Element, TreeBuilder
from xml.parsers import expat

import torch
from torch import Tensor

_ENCODING = re.compile(rb"<\?xml[^>]*\bencoding\s*=\s*[\"']([\w.:-]+)[\"']")
_KINDS = {
    "revolute": "revolute",
    "continuous": "revolute",
    "prismatic": "prismatic",
    "fixed": "fixed",
}
_ATTRIBUTES = {
    "parent": ("link",),
    "child": ("link",),
    "origin": ("xyz", "rpy"),
    "axis": ("xyz", "rpy"),
    "limit": ("lower", "upper", "effort", "velocity", "acceleration", "jerk"),
    "mimic": ("joint", "multiplier", "offset"),
}


@dataclass(frozen=True, eq=False)
class Joint:
    """A joint that moves the link ``child``: its frame in the parent link's, ``origin`` ``[4, 4]``,
    and the unit vector ``axis`` ``[3]`` that it turns about or slides along.  A continuous joint is
    revolute."""

    name: str
    kind: Literal["revolute", "prismatic", "fixed"]
    child: str
    origin: Tensor
    axis: Tensor


@dataclass(frozen=True)
class Drive:
    """A joint's position, rad or m, is ``gain`` x + ``offset``, where x is that of the joint
    ``source``: the joint itself, unless it mimics another.  low, high: limits of x, None if the
    file gives none."""

    source: str
    gain: float
    offset: float
    low: float | None
    high: float | None


class Robot:
    """The links and joints of the file ``path``; ValueError if they are not a tree."""

    def __init__(self, path: Path | str) -> None:
        """Read the file."""
        self.path = path
        robot = _parse(path)
        if robot.tag != "robot":
            raise ValueError(f"{path}: expected the root element <robot>, not <{robot.tag}>")
        _refuse_macros(path, robot)
        self.links = self._names(robot, "link")
        self._joints = dict(zip(self._names(robot, "joint"), robot.findall("joint"), strict=True))
        self._above: dict[str, tuple[str, str]] = {}
        """Of each link but the root: the joint whose child it is, and that joint's parent."""
        for name in self._joints:
            parent, child = (self._link(name, role) for role in ("parent", "child"))
            if child in self._above:
                other = self._above[child][0]
                raise self._wrong(name, f"link {child!r} is the child of joint {other!r} already")
            self._above[child] = (name, parent)
        self._refuse_cycles()

    def between(self, root: str, end: str) -> list[Joint]:
        """The joints on the path from link ``root`` to its descendant ``end``, fixed ones too."""
        for role, link in (("root", root), ("end", end)):
            if link not in self.links:
                raise ValueError(
                    f"{role}={link!r}: expected one of the links of {self.path},"
                    f" {_some(self.links, link)}"
                )
        names, link = [], end
        while link != root:
            if link not in self._above:
                raise ValueError(
                    f"root={root!r}, end={end!r}: expected an end that descends from root in"
                    f" {self.path}; it descends from {link!r}"
                )
            name, link = self._above[link]
            names.append(name)
        return [self._joint(name) for name in reversed(names)]

    def drive(self, name: str, mimics: tuple[str, ...] = ()) -> Drive:
        """What drives the moving joint ``name``.

        The limits are those of the joint and of all that it mimics together.  mimics: the joints
        whose mimic elements led here.
        """
        if name in mimics:
            raise self._wrong(name, "mimics itself through " + ", ".join(map(repr, mimics)))
        element = self._part(name, "mimic")
        limits = self._limits(name)
        if element is None:
            low, high = limits or (None, None)
            return Drive(name, 1.0, 0.0, low, high)
        other = self._text(name, element, "joint")
        if other not in self._joints or self._kind(other) == "fixed":
            raise self._wrong(name, f"mimics {other!r}: expected a moving joint of the file")
        multiplier = self._number(name, element, "multiplier", 1.0)
        shift = self._number(name, element, "offset", 0.0)
        of = self.drive(other, (*mimics, name))
        gain, offset = multiplier * of.gain, multiplier * of.offset + shift
        low, high = of.low, of.high
        if limits is not None and gain != 0:
            least, most = sorted((bound - offset) / gain for bound in limits)
            low = least if low is None else max(low, least)
            high = most if high is None else min(high, most)
            if low > high:
                raise self._wrong(name, f"mimics {other!r}: expected limits that both can keep")
        return Drive(of.source, gain, offset, low, high)

    def _joint(self, name: str) -> Joint:
        kind = self._kind(name)
        for part in self._joints[name]:
            meant = get_close_matches(part.tag, _ATTRIBUTES, 1, 0.7)
            if part.tag not in _ATTRIBUTES and meant:
                raise self._wrong(name, f"unknown element <{part.tag}>; meant <{meant[0]}>?")
        axis = (1.0, 0.0, 0.0)
        if kind != "fixed" and (element := self._part(name, "axis")) is not None:
            axis = self._numbers(name, element, "xyz", axis)
            if not any(axis):
                raise self._wrong(name, "axis xyz is zero: expected a direction")
        largest = max(map(abs, axis))  # so that the norm neither over- nor underflows
        direction = torch.tensor([number / largest for number in axis], dtype=torch.float64)
        child, origin = self._link(name, "child"), self._origin(name)
        return Joint(name, kind, child, origin, direction / direction.norm())

    def _kind(self, name: str) -> Literal["revolute", "prismatic", "fixed"]:
        given = self._joints[name].get("type")
        if given not in _KINDS:
            raise self._wrong(name, f"type={given!r}: expected one of {', '.join(_KINDS)}")
        return _KINDS[given]  # pyright: ignore[reportReturnType]

    def _origin(self, name: str) -> Tensor:
        """Rotation by rpy about the fixed axes x, y, z, then translation by xyz."""
        origin = torch.eye(4, dtype=torch.float64)
        element = self._part(name, "origin")
        if element is None:
            return origin
        xyz, rpy = (self._numbers(name, element, key, (0.0,) * 3) for key in ("xyz", "rpy"))
        (a, b, c), (d, e, f) = ([turn(angle) for angle in rpy] for turn in (math.cos, math.sin))
        rows = (
            (c * b, c * e * d - f * a, c * e * a + f * d, xyz[0]),
            (f * b, f * e * d + c * a, f * e * a - c * d, xyz[1]),
            (-e, b * d, b * a, xyz[2]),
        )
        origin[:3] = torch.tensor(rows, dtype=torch.float64)
        return origin

    def _limits(self, name: str) -> tuple[float, float] | None:
        """A joint's own limits; None if they are required and missing."""
        mimics = self._part(name, "mimic") is not None
        if self._joints[name].get("type") == "continuous":
            return (-math.inf, math.inf)
        element = self._part(name, "limit")
        if element is None or not {"lower", "upper"} & set(element.keys()):
            return (-math.inf, math.inf) if mimics else None
        low, high = (self._number(name, element, key, 0.0, True) for key in ("lower", "upper"))
        if low > high:
            raise self._wrong(name, f"limit lower={low}, upper={high}: expected lower <= upper")
        return low, high

    def _link(self, name: str, role: str) -> str:
        element = self._part(name, role)
        if element is None:
            raise self._wrong(name, f"expected an element <{role}>")
        link = self._text(name, element, "link")
        if link not in self.links:
            raise self._wrong(name, f"{role} link={link!r}: expected one of {_some(self.links)}")
        return link

    def _part(self, name: str, tag: str) -> Element | None:
        """The element ``tag`` of a joint, if it has one."""
        parts = self._joints[name].findall(tag)
        if len(parts) > 1:
            raise self._wrong(name, f"{len(parts)} elements <{tag}>: expected one")
        for key in parts[0].keys() if parts else ():
            if key not in _ATTRIBUTES[tag]:
                known = ", ".join(_ATTRIBUTES[tag])
                raise self._wrong(name, f"unknown attribute {key!r} of <{tag}>: expected {known}")
        return parts[0] if parts else None

    def _text(self, name: str, element: Element, key: str) -> str:
        text = element.get(key)
        if not text:
            raise self._wrong(name, f"expected an attribute {key!r} of <{element.tag}>")
        return text

    def _number(
        self, name: str, element: Element, key: str, default: float, is_bound: bool = False
    ) -> float:
        text = element.get(key)
        return default if text is None else self._float(name, element, key, text, is_bound)

    def _numbers(
        self, name: str, element: Element, key: str, default: tuple[float, ...]
    ) -> tuple[float, ...]:
        """Three numbers."""
        text = element.get(key)
        if text is None:
            return default
        parts = text.split()
        if len(parts) != 3:
            raise self._no_number(name, element, key, text, "three numbers")
        return tuple(self._float(name, element, key, part) for part in parts)

    def _float(
        self, name: str, element: Element, key: str, text: str, is_bound: bool = False
    ) -> float:
        """A finite number, or infinite if it is a bound."""
        try:
            number = math.nan if "_" in text else float(text)
        except ValueError:
            number = math.nan
        if math.isnan(number) or (math.isinf(number) and not is_bound):
            raise self._no_number(name, element, key, text, "a number")
        return number

    def _no_number(
        self, name: str, element: Element, key: str, text: str, expected: str
    ) -> ValueError:
        macro = " (an unresolved xacro expression)" if "$" in text else ""
        return self._wrong(name, f"{element.tag} {key}={text!r}{macro}: expected {expected}")

    def _names(self, robot: Element, tag: str) -> tuple[str, ...]:
        names: dict[str, None] = {}
        for element in robot.findall(tag):
            name = element.get("name")
            if not name:
                raise ValueError(f"{self.path}: a <{tag}> has no name: expected one")
            if name in names:
                raise ValueError(f"{self.path}: {tag} {name!r}: expected unique names")
            names[name] = None
        return tuple(names)

    def _refuse_cycles(self) -> None:
        rooted: set[str] = set()
        for link in self.links:
            path: list[str] = []
            while link in self._above and link not in rooted:
                name, above = self._above[link]
                if link in path:
                    raise self._wrong(name, f"the links {above!r} and {link!r} are in a cycle")
                path.append(link)
                link = above
            rooted.update(path)

    def _wrong(self, name: str, what: str) -> ValueError:
        return ValueError(f"{self.path}: joint {name!r}: {what}")


def _parse(path: Path | str) -> Element:
    """The root element.  ElementTree's own parser would refuse undeclared prefixes, which
    simulators' elements have, and multi-byte encodings."""
    try:
        data = Path(path).read_bytes().lstrip()
    except OSError as error:
        raise ValueError(f"{path}: expected a URDF file ({error.strerror})") from error
    builder, parser = TreeBuilder(), expat.ParserCreate()
    parser.StartElementHandler = builder.start
    parser.EndElementHandler = builder.end
    try:
        declared = _ENCODING.match(data)
        parser.Parse(data.decode(declared[1].decode()) if declared else data, True)
    except (expat.ExpatError, LookupError, ValueError) as error:
        raise ValueError(f"{path}: expected a well-formed XML file: {error}") from error
    return builder.close()


def _refuse_macros(path: Path | str, robot: Element) -> None:
    for part in robot:
        for element in part.iter():
            if element.tag.startswith("xacro:"):
                within = "" if element is part else f" in {part.tag} {part.get('name')!r}"
                raise ValueError(
                    f"{path}: element <{element.tag}>{within}: expected a file expanded by xacro"
                    " (xacro robot.xacro > robot.urdf)"
                )


def _some(names: Iterable[str], like: str = "") -> str:
    """A few of the names, the closest matches of ``like`` first."""
    names = list(names)
    first = get_close_matches(like, names, 3)
    chosen = [*first, *(name for name in names if name not in first)][:8]
    return ", ".join(chosen) + (", ..." if len(names) > len(chosen) else "")
