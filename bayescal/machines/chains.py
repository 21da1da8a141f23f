"""Serial chains of joints: from Denavit-Hartenberg rows, or from a URDF file's joints between two of its links.

Joint i turns about, or slides along, the z axis of its own frame, which stands at O_i in the frame that joint i - 1
moves; the tip stands at O_tip in that of the last joint,

    T(q) = O_1 M_1(q_1) O_2 M_2(q_2) ... O_tip.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from xml.parsers import expat

import numpy as np
from scipy.spatial.transform import Rotation

from bayescal.errors import InputError, say_reversed
from bayescal.limits import LONGEST
from bayescal.numerics.geometry import Array

MM = 1e3  # per metre
MOVING = ("revolute", "continuous", "prismatic")
FURTHEST = LONGEST  # mm from one joint to the next, or along all of them, beyond which a file is in another unit
SHORTEST_AXIS = 1e-9
LONGEST_NAME = 40
LARGEST = 1e100  # whose square is a number still
PARALLEL = 1e-9  # rad between two axes, below which rounding of their common normal's place is the larger error
COAXIAL = 1e-9  # mm between two parallel axes, below which they are one


@dataclass(frozen=True, eq=False)
class Place:
    """A frame in another one: its origin (3,), mm, and its axes in columns (3, 3)."""

    position: Array = field(default_factory=lambda: np.zeros(3))
    axes: Array = field(default_factory=lambda: np.eye(3))

    def then(self, other: Place) -> Place:
        """Return a frame that stands at ``other`` in this one."""
        return Place(self.position + self.axes @ other.position, self.axes @ other.axes)

    @property
    def back(self) -> Place:
        """The other frame in this one."""
        return Place(-self.axes.T @ self.position, self.axes.T)


@dataclass(frozen=True, eq=False)
class Joint:
    """A joint of a chain, and what moves with it.

    Attributes
    ----------
    name : str
    place : Place
        Its frame in that of the joint before; its axis is z.
    slides : bool
        Whether it is prismatic.
    ends : tuple of float
        Its range, rad or mm; infinite where nobody says it.
    mass : float
        Of what it moves up to the next joint, kg.
    centre : ndarray, shape (3,)
        Where the centre of that mass is, its frame after it moved, mm.
    link : Place
        Where the link that it moves has its own frame, seen from the joint's.
    """

    name: str
    place: Place
    slides: bool = False
    ends: tuple[float, float] = (-np.inf, np.inf)
    mass: float = 0.0
    centre: Array = field(default_factory=lambda: np.zeros(3))
    link: Place = field(default_factory=Place)


@dataclass(frozen=True, eq=False)
class Chain:
    """Joints from a base to a tip, whose frame stands at ``tip`` in the last joint's."""

    joints: Sequence[Joint]
    tip: Place

    @property
    def reach(self) -> float:
        """From the base to the tip, mm, the farther of two: all joints at zero, and turned by a radian.

        Links are longer where axes are nearly parallel: rows of these go far along one and back along the other.
        """
        found = []
        for turn in (Rotation.identity(), Rotation.from_rotvec([0.0, 0.0, 1.0])):
            position, axes = np.zeros(3), np.eye(3)
            for joint in self.joints:
                position, axes = position + axes @ joint.place.position, axes @ joint.place.axes
                axes = axes if joint.slides else axes @ turn.as_matrix()
            found.append(np.linalg.norm(position + axes @ self.tip.position))
        return float(max(found))


@dataclass(frozen=True)
class DenavitRow:
    """A row of Denavit-Hartenberg's parameters: mm and rad."""

    d: float = 0.0
    a: float = 0.0
    alpha: float = 0.0
    theta: float = 0.0

    @property
    def across(self) -> Place:
        """Tx(a) Rx(alpha)."""
        return Place(np.array([self.a, 0.0, 0.0]), _turn_about("x", self.alpha))

    @property
    def along(self) -> Place:
        """Rz(theta) Tz(d)."""
        return Place(np.array([0.0, 0.0, self.d]), _turn_about("z", self.theta))


def chain_rows(
    rows: Sequence[DenavitRow], joints: Sequence[Joint], modified: bool, tip: Place, base: Place | None = None
) -> Chain:
    """Return a chain by rows that begin at a base, with names, ranges and masses from ``joints``, but for their places.

    Classical rows are Rz(q + theta) Tz(d) Tx(a) Rx(alpha), modified ones (Craig) Rx(alpha) Tx(a) Rz(q + theta) Tz(d).
    """
    found, before = list[Joint](), base or Place()
    for row, joint in zip(rows, joints, strict=True):
        here = before.then(row.across).then(row.along) if modified else before.then(row.along)
        found.append(replace(joint, place=here))
        before = Place() if modified else row.across
    return Chain(found, before.then(tip))


def find_rows(chain: Chain, modified: bool, last: DenavitRow) -> tuple[Place, list[DenavitRow], Place]:
    """Return base, rows and tip of any chain: `chain_rows` makes one of them that stands wherever it does.

    A joint's frame may turn about, and slide along, its own axis: the joint does not notice. What takes one axis to the
    next is Rz(theta) Tz(d) Rx(alpha) Tx(a) Rz(theta') Tz(d') then, x the common normal of both; theta and d belong to
    the joint before. Classical rows end beyond the last joint, where ``last`` has a and alpha.
    """
    pairs = [_find_normal(one.place) for one in chain.joints]
    before, rows = [one for one, _ in pairs[1:]] + [DenavitRow()], [row for _, row in pairs]
    sums = [(row.d + more.d, row.theta + more.theta) for row, more in zip(rows, before, strict=True)]
    across = rows if modified else [*rows[1:], last]
    found = [DenavitRow(d, row.a, row.alpha, theta) for (d, theta), row in zip(sums, across, strict=True)]
    base = pairs[0][0].along
    return (
        (base, found, chain.tip) if modified else (base.then(rows[0].across), found, last.across.back.then(chain.tip))
    )


def _find_normal(place: Place) -> tuple[DenavitRow, DenavitRow]:
    """Return what turns and slides a frame to the common normal of its z axis and another's, and a modified row on.

    Of both directions of the normal it is that nearer to x; of all common normals of parallel axes that through the
    first frame's origin.
    """
    x, y, z = place.axes[:, 2]
    parallel = np.hypot(x, y) < PARALLEL
    normal = place.position[:2] if parallel else np.array([-y, x])
    if not parallel or np.hypot(*normal) > COAXIAL:
        theta = float(np.arctan2(*(np.copysign(1.0, normal[0]) * normal)[::-1]))
    else:
        theta = 0.0
    seen = Place(axes=_turn_about("z", -theta)).then(place)
    sine, cosine = (0.0, np.sign(z)) if parallel else (-seen.axes[1, 2], z)
    alpha = float(np.arctan2(sine, cosine))
    along = float(cosine * seen.position[2] if parallel else -seen.position[1] / sine)
    turned = _turn_about("x", -alpha) @ seen.axes
    own = DenavitRow(along, float(seen.position[0]), alpha, float(np.arctan2(turned[1, 0], turned[0, 0])))
    return DenavitRow(d=0.0 if parallel else float(seen.position[2] - cosine * along), theta=theta), own


def _turn_about(axis: str, angle: float) -> Array:
    return Rotation.from_euler(axis, angle).as_matrix()


# --- URDF -----------------------------------------------------------------------------------------------------------


@dataclass(eq=False)
class Element:
    """An element of an XML file and the line that it begins in."""

    tag: str
    attributes: Mapping[str, str]
    line: int
    children: list[Element] = field(default_factory=list)

    def find(self, tag: str) -> Element | None:
        """Return the first child of a tag."""
        return next((one for one in self.children if one.tag == tag), None)


def read_xml(path: Path) -> Element:
    """Return the root of an XML file; InputError with the line for what is none, or for declarations of types."""
    parser, stack, roots = expat.ParserCreate(), list[Element](), list[Element]()

    def begin(tag: str, attributes: Mapping[str, str]) -> None:
        one = Element(tag, attributes, parser.CurrentLineNumber)
        (stack[-1].children if stack else roots).append(one)
        stack.append(one)

    def refuse(*_: object) -> None:
        raise InputError(f"{path}, line {parser.CurrentLineNumber}: found a document type, expected none")

    parser.StartElementHandler, parser.EndElementHandler = begin, lambda _: stack.pop()
    parser.StartDoctypeDeclHandler = refuse
    try:
        parser.Parse(path.read_bytes(), True)
    except expat.ExpatError as error:
        raise InputError(f"{path}, line {error.lineno}: {expat.ErrorString(error.code)}, expected XML") from error
    except OSError as error:
        raise InputError(f"{path}: {error.strerror}, expected a URDF file") from error
    except (LookupError, ValueError) as error:  # encodings that Python does not know, or expat
        raise InputError(f"{path}, line 1: {' '.join(str(error).split())}, expected XML in UTF-8") from error
    return roots[0]


def name_arm(path: Path) -> str:
    """Return what the arm of a file is called in configs."""
    return re.sub(r"[^A-Za-z0-9_-]+", "_", path.stem)[:LONGEST_NAME] or "arm"


def read_urdf(path: Path, base: str = "", tip: str = "") -> Chain:
    """Return the chain of a URDF file from one link to another, by default from its root to its only leaf.

    InputError, with the line, for a file that is no URDF, links that are not there or not in one chain, and joints that
    no chain has: floating, planar, or following another one.
    """
    root = read_xml(path)
    if root.tag != "robot":
        raise InputError(f"{path}, line {root.line}: found <{root.tag}>, expected <robot>")
    for one in root.children:
        if one.tag.startswith("xacro:"):
            raise InputError(f"{path}, line {one.line}: found <{one.tag}>, expected URDF: bayescal init expands it")
    links, joints = (_index(path, root, tag) for tag in ("link", "joint"))
    into = dict[str, Element]()
    for one in joints.values():
        parent, child = (_name_link(path, one, tag) for tag in ("parent", "child"))
        for name in (parent, child):
            if name not in links:
                raise InputError(f"{path}, line {one.line}: joint {_name(one)!r}: found no link {name!r}")
        if child in into:
            raise InputError(f"{path}, line {one.line}: link {child!r}: found two joints above it, expected one")
        into[child] = one
    parents = {_name_link(path, one, "parent") for one in into.values()}
    tip = _choose(path, "tip", tip, links, [name for name in links if name not in parents])
    chosen, here = list[Element](), tip
    roots = [name for name in links if name not in into]
    base = base or next((name for name in roots if len(roots) == 1), "")
    base = _choose(path, "base", base, links, roots)
    while here != base:
        if here not in into or len(chosen) > len(into):
            raise InputError(f"{path}: found no chain from link {base!r} to {tip!r}, which is below {here!r}")
        chosen.insert(0, into[here])
        here = _name_link(path, into[here], "parent")
    chain = _make_chain(path, chosen, links)
    if chain.reach > FURTHEST:
        raise InputError(f"{path}: found an arm of {chain.reach / MM:.0f} m, expected lengths in metres")
    return chain


def _index(path: Path, root: Element, tag: str) -> dict[str, Element]:
    """Return a robot's elements of a tag by their names."""
    found = dict[str, Element]()
    for one in (child for child in root.children if child.tag == tag):
        if _name(one) in found:
            raise InputError(f"{path}, line {one.line}: found a second {tag} {_name(one)!r}, expected unique names")
        found[_name(one)] = one
    return found


def _choose(path: Path, what: str, name: str, links: Mapping[str, Element], ends: Sequence[str]) -> str:
    if name and name not in links:
        raise InputError(f"{path}: {what}: found no link {name!r}, expected one of {', '.join(links)}")
    if not name and len(ends) != 1:
        raise InputError(f"{path}: {what}: missing, expected one of {', '.join(ends or links)}")
    return name or ends[0]


def _make_chain(path: Path, chosen: Sequence[Element], links: Mapping[str, Element]) -> Chain:
    joints, before = list[Joint](), Place()  # the frame of the link that comes, seen from the last joint's
    for one in chosen:
        where = f"{path}, line {one.line}: joint {_name(one)!r}"
        kind, place = one.attributes.get("type", ""), _read_place(path, one)
        if kind not in (*MOVING, "fixed"):
            raise InputError(f"{where}: found type {kind!r}, expected one of {', '.join(MOVING)}, fixed")
        if one.find("mimic") is not None:
            raise InputError(f"{where}: found a joint that mimics another, expected independent joints")
        here = before.then(place)
        link = links[_name_link(path, one, "child")]
        mass, centre = _read_mass(path, link)
        if kind == "fixed":
            before = here
            if joints and mass:
                joints[-1] = _add_mass(joints[-1], mass, here.position + here.axes @ centre)
            continue
        aligned = _align(_read_axis(path, one))
        before = Place(axes=aligned.T)
        joint = Joint(
            *(_name(one), here.then(Place(axes=aligned)), kind == "prismatic", _read_ends(path, one, kind)),
            link=before,
        )
        joints.append(_add_mass(joint, mass, before.axes @ centre))
    if not joints:
        raise InputError(f"{path}: found no moving joint from base to tip, expected at least one")
    return Chain(joints, before)


def _name(element: Element) -> str:
    return element.attributes.get("name", "")


def _name_link(path: Path, joint: Element, tag: str) -> str:
    found = joint.find(tag)
    if found is None or "link" not in found.attributes:
        raise InputError(f"{path}, line {joint.line}: joint {_name(joint)!r}: found no {tag}, expected a link")
    return found.attributes["link"]


def _read_numbers(path: Path, element: Element, key: str, default: str, n: int) -> Array:
    text = element.attributes.get(key, default)
    try:
        found = np.array([float(one) for one in text.split()])
    except ValueError:
        found = np.array([np.nan])
    if len(found) != n or not (np.abs(found) < LARGEST).all():
        expected = "a number" if n == 1 else f"{n} numbers"
        raise InputError(f"{path}, line {element.line}: {key}: found {text!r}, expected {expected}")
    return found


def _read_place(path: Path, element: Element) -> Place:
    """Return the ``origin`` of an element; none is that of what it stands in."""
    origin = element.find("origin")
    if origin is None:
        return Place()
    position = MM * _read_numbers(path, origin, "xyz", "0 0 0", 3)
    if np.linalg.norm(position) > FURTHEST:
        away = np.linalg.norm(position) / MM
        raise InputError(f"{path}, line {origin.line}: xyz: found {away:g} m, expected metres")
    angles = _read_numbers(path, origin, "rpy", "0 0 0", 3)
    return Place(position, Rotation.from_euler("xyz", angles).as_matrix())


def _read_axis(path: Path, joint: Element) -> Array:
    found = joint.find("axis")
    axis = np.array([1.0, 0.0, 0.0]) if found is None else _read_numbers(path, found, "xyz", "1 0 0", 3)
    size = np.linalg.norm(axis)
    if size < SHORTEST_AXIS:
        raise InputError(f"{path}, line {joint.line}: joint {_name(joint)!r}: axis: found zero, expected a direction")
    return np.asarray(axis / size)


def _align(axis: Array) -> Array:
    """Return axes (3, 3) whose z is a direction; those of the frame where that is z already."""
    helper = np.eye(3)[int(np.argmin(np.abs(axis)))]
    if axis[2] == 1.0:
        return np.eye(3)
    first = np.cross(helper, axis)
    first /= np.linalg.norm(first)
    return np.stack([first, np.cross(axis, first), axis], axis=1)


def _read_ends(path: Path, joint: Element, kind: str) -> tuple[float, float]:
    limit = joint.find("limit")
    if kind == "prismatic" and limit is None:
        where = f"{path}, line {joint.line}: joint {_name(joint)!r}"
        raise InputError(f"{where}: found no limit, expected one of a joint that slides")
    if limit is None or kind == "continuous" or (kind == "revolute" and not {"lower", "upper"} & set(limit.attributes)):
        return -np.inf, np.inf
    unit = MM if kind == "prismatic" else 1.0
    low, high = (unit * float(_read_numbers(path, limit, key, "0", 1)[0]) for key in ("lower", "upper"))
    if not low < high:
        raise InputError(say_reversed(f"{path}, line {limit.line}: limit", low, high))
    return low, high


def _read_mass(path: Path, link: Element) -> tuple[float, Array]:
    """Return a link's mass, kg, and its centre (3,), mm, link's frame; zero where nothing is said."""
    inertial = link.find("inertial")
    found = None if inertial is None else inertial.find("mass")
    if inertial is None or found is None:
        return 0.0, np.zeros(3)
    mass = float(_read_numbers(path, found, "value", "0", 1)[0])
    if mass < 0.0:
        raise InputError(f"{path}, line {found.line}: mass: found {mass:g} kg, expected none below zero")
    return mass, _read_place(path, inertial).position


def _add_mass(joint: Joint, mass: float, centre: Array) -> Joint:
    """Return a joint that moves a further mass."""
    total = joint.mass + mass
    shared = (joint.mass * joint.centre + mass * centre) / total if total else np.zeros(3)
    return replace(joint, mass=total, centre=shared)
