"""A calibrated machine as URDF: a tree of links and joints, in metres and radians, standing at home when all are zero.

A leg is a prismatic joint between two universal joints, each of them two revolute ones, with a turn about its own axis:
without that six legs would hold the platform still. A tree has no loops: the first leg carries the platform, each of
the others ends in a link that belongs where the platform's own mark of the leg is. These loops are named in elements
``loop_joint``, which readers of plain URDF pass over.
"""

from __future__ import annotations

from xml.etree import ElementTree as Xml

import numpy as np
from scipy.spatial.transform import Rotation

from bayescal.calibrated.formats.perfect_legs import check_perfect_legs
from bayescal.calibrated.machine import CalibratedMachine
from bayescal.machines.kinematics import check_home_pose
from bayescal.numerics.geometry import Array

METRE = 1e-3  # m per mm
ORIGIN = np.zeros(3)
AXES = {"x": "1 0 0", "y": "0 1 0", "z": "0 0 1"}


def list_urdf_files(calibrated: CalibratedMachine) -> dict[str, bytes]:
    """Return ``machine.urdf``; InputError where joints and rigid links are not all of the machine's kinematics."""
    check_perfect_legs(calibrated, "urdf", ("strut", "base"))
    mechanism = calibrated.legs.mechanism
    home = check_home_pose(calibrated.legs)
    robot = Xml.Element("robot", name=mechanism.name)
    for comment in (*calibrated.source.describe(), "Lengths in m, angles in rad; all joints are zero at home."):
        robot.append(Xml.Comment(f" {comment.replace('--', '- -')} "))
    for name in ("base", "platform"):
        Xml.SubElement(robot, "link", name=name)
    upper = home.position + mechanism.platform_points @ home.rotation.T
    for leg in range(mechanism.n_legs):
        _add_leg(robot, calibrated, leg, upper[leg], home.rotation)
    Xml.indent(robot)
    return {"machine.urdf": Xml.tostring(robot, encoding="utf-8", xml_declaration=True) + b"\n"}


def _add_leg(robot: Xml.Element, calibrated: CalibratedMachine, leg: int, upper: Array, turned: Array) -> None:
    """Add a leg's chain from the base to the platform, or to where it belongs."""
    mechanism, name = calibrated.legs.mechanism, f"leg_{leg + 1}"
    lower, strut = mechanism.home_joints[leg], mechanism.drive == "strut"
    along, link, place = _frame_along(upper - lower), "base", (lower, np.eye(3))
    if not strut:
        guide = _frame_along(mechanism.directions[leg])
        link = _add_joint(robot, link, f"{name}_actuator", "z", (lower, guide), mechanism.actuator_range)
        place = (ORIGIN, guide.T)
    link = _add_joint(robot, link, f"{name}_base_universal_1", "x", (place[0], place[1] @ along))
    link = _add_joint(robot, link, f"{name}_base_universal_2", "y", (ORIGIN, np.eye(3)))
    span = (np.array([0.0, 0.0, np.linalg.norm(upper - lower)]), np.eye(3))
    if strut:
        link = _add_joint(robot, link, f"{name}_actuator", "z", span, mechanism.actuator_range)
        span = (ORIGIN, np.eye(3))
    link = _add_joint(robot, link, f"{name}_turn", "z", span)
    link = _add_joint(robot, link, f"{name}_platform_universal_1", "x", (ORIGIN, np.eye(3)))
    link = _add_joint(robot, link, f"{name}_platform_universal_2", "y", (ORIGIN, np.eye(3)))
    back = along.T @ turned  # the platform as the leg's end sees it
    point = mechanism.platform_points[leg]
    if leg == 0:
        _add_fixed(robot, f"{name}_end", link, "platform", (-back @ point, back))
        return
    _add_fixed(robot, f"{name}_mark", "platform", f"{name}_platform_mark", (point, back.T))
    loop = Xml.SubElement(robot, "loop_joint", name=f"{name}_loop", type="fixed")
    for key, one in (("link1", link), ("link2", f"{name}_platform_mark")):
        Xml.SubElement(loop, key, link=one, xyz="0 0 0", rpy="0 0 0")


def _add_joint(
    robot: Xml.Element, parent: str, name: str, axis: str, place: tuple[Array, Array], reach: float | None = None
) -> str:
    """Add a revolute joint, or with a reach in mm a prismatic one, and its child link; return the child's name."""
    child = f"{name}_link"
    Xml.SubElement(robot, "link", name=child)
    joint = Xml.SubElement(robot, "joint", name=name, type="continuous" if reach is None else "prismatic")
    _place(joint, parent, child, place)
    Xml.SubElement(joint, "axis", xyz=AXES[axis])
    if reach is not None:
        bound = METRE * reach
        Xml.SubElement(joint, "limit", lower=repr(-bound), upper=repr(bound), effort="0", velocity="0")
    return child


def _add_fixed(robot: Xml.Element, name: str, parent: str, child: str, place: tuple[Array, Array]) -> None:
    if child != "platform":
        Xml.SubElement(robot, "link", name=child)
    _place(Xml.SubElement(robot, "joint", name=name, type="fixed"), parent, child, place)


def _place(joint: Xml.Element, parent: str, child: str, place: tuple[Array, Array]) -> None:
    """Add where a joint stands in its parent: mm, and a rotation matrix, which URDF has as fixed-axis angles."""
    position, rotation = place
    Xml.SubElement(joint, "parent", link=parent)
    Xml.SubElement(joint, "child", link=child)
    angles = Rotation.from_matrix(rotation).as_euler("xyz")
    xyz, rpy = (" ".join(repr(float(x) + 0.0) for x in one) for one in (METRE * position, angles))
    Xml.SubElement(joint, "origin", xyz=xyz, rpy=rpy)


def _frame_along(vector: Array) -> Array:
    """Return a rotation matrix whose z axis lies along a vector."""
    axis = vector / np.linalg.norm(vector)
    helper = np.eye(3)[int(np.argmin(np.abs(axis)))]
    first = np.cross(helper, axis)
    first /= np.linalg.norm(first)
    return np.stack([first, np.cross(axis, first), axis], axis=1)
