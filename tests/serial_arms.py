"""Serial arms: a small one in URDF with all that such files may have, and where links stand, by a reader of its own.

The reader knows nothing of chains: it walks from the root to every link, by products of 4 x 4 matrices in metres.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from xml.etree import ElementTree as Xml

import numpy as np
import studies
from scipy.spatial.transform import Rotation

from bayescal.config.load import FOLDER
from bayescal.files.memory import MemoryPath
from bayescal.machines.readings.arm import Arm, ArmConfig

PANDA = studies.EXPERIMENTS / "panda_socket" / "panda.urdf"
SMALL = """<?xml version="1.0"?>
<robot name="small">
  <link name="floor"/>
  <link name="plinth"><inertial><mass value="40"/></inertial></link>
  <link name="column">
    <visual><geometry><mesh filename="package://small/column.stl" scale="1 1 1"/></geometry></visual>
    <inertial><origin xyz="0.1 -0.05 0.2" rpy="0.3 0 0"/><mass value="3"/><inertia ixx="1" iyy="1" izz="1"/></inertial>
  </link>
  <link name="motor"><inertial><origin xyz="0 0 0.04"/><mass value="1.5"/></inertial></link>
  <link name="slide"><inertial><origin xyz="0.2 0 0"/><mass value="2"/></inertial></link>
  <link name="hand"><inertial><origin xyz="0 0.01 0.06"/><mass value="0.7"/></inertial></link>
  <link name="flange"><inertial><mass value="0.2"/></inertial></link>
  <joint name="foot" type="fixed">
    <parent link="floor"/><child link="plinth"/><origin xyz="0.1 0.2 0.3" rpy="0 0 0.4"/>
  </joint>
  <joint name="turn" type="revolute">
    <origin xyz="0.05 -0.1 0.4" rpy="0.2 -0.3 1.1"/>
    <parent link="plinth"/><child link="column"/>
    <axis xyz="0 2 2"/>
    <limit lower="-1.2" upper="2.0" effort="50" velocity="1"/>
  </joint>
  <joint name="bolts" type="fixed">
    <origin xyz="0.3 0 0.1" rpy="-0.7 0.1 0"/><parent link="column"/><child link="motor"/>
  </joint>
  <joint name="lift" type="prismatic">
    <origin xyz="0 0.02 0.2" rpy="0 0.5 0"/>
    <parent link="motor"/><child link="slide"/>
    <limit lower="-0.1" upper="0.35" effort="50" velocity="1"/>
  </joint>
  <joint name="spin" type="continuous">
    <origin xyz="0.4 0 0" rpy="1.5 0 -0.2"/>
    <parent link="slide"/><child link="hand"/><axis xyz="0 0 -1"/>
  </joint>
  <joint name="screws" type="fixed">
    <parent link="hand"/><child link="flange"/><origin xyz="0.01 0.02 0.11" rpy="0 0.3 0"/>
  </joint>
  <transmission name="drive">
    <joint name="turn"><hardwareInterface>effort</hardwareInterface></joint>
    <actuator name="turn_motor"/>
  </transmission>
</robot>
"""
JOINTS = ("turn", "lift", "spin")


def _numbers(element: Xml.Element | None, key: str, default: str) -> np.ndarray:
    return np.array([float(one) for one in (element.get(key, default) if element is not None else default).split()])


def _pose(origin: Xml.Element | None) -> np.ndarray:
    """Return an origin as a matrix (4, 4): roll, pitch, yaw about fixed axes, one after the other."""
    pose = np.eye(4)
    roll, pitch, yaw = _numbers(origin, "rpy", "0 0 0")
    (sr, sp, sy), (cr, cp, cy) = np.sin([roll, pitch, yaw]), np.cos([roll, pitch, yaw])
    about_z = np.array([[cy, -sy, 0.0], [sy, cy, 0.0], [0.0, 0.0, 1.0]])
    about_y = np.array([[cp, 0.0, sp], [0.0, 1.0, 0.0], [-sp, 0.0, cp]])
    about_x = np.array([[1.0, 0.0, 0.0], [0.0, cr, -sr], [0.0, sr, cr]])
    pose[:3, :3] = about_z @ about_y @ about_x
    pose[:3, 3] = _numbers(origin, "xyz", "0 0 0")
    return pose


def _move(joint: Xml.Element, q: float) -> np.ndarray:
    """Return what a joint's position does, rad or m, (4, 4)."""
    axis, moved = _numbers(joint.find("axis"), "xyz", "1 0 0"), np.eye(4)
    axis = axis / np.linalg.norm(axis)
    if joint.get("type") == "prismatic":
        moved[:3, 3] = q * axis
    elif joint.get("type") != "fixed":
        moved[:3, :3] = Rotation.from_rotvec(q * axis).as_matrix()
    return moved


def place_links(text: str, q: Mapping[str, float]) -> dict[str, np.ndarray]:
    """Return where the links of a file stand, (4, 4), m, with joints at q, rad or m; zero where nothing is said."""
    robot = Xml.fromstring(text)
    joints = {one.find("child").get("link"): one for one in robot.findall("joint")}

    def walk(name: str) -> np.ndarray:
        if name not in joints:
            return np.eye(4)
        one = joints[name]
        return (
            walk(one.find("parent").get("link")) @ _pose(one.find("origin")) @ _move(one, q.get(one.get("name"), 0.0))
        )

    return {one.get("name"): walk(one.get("name")) for one in robot.findall("link")}


def list_masses(text: str) -> dict[str, tuple[float, np.ndarray]]:
    """Return mass, kg, and centre (4,) in homogeneous coordinates, m, of each link that has one."""
    found = {}
    for one in Xml.fromstring(text).findall("link"):
        if (inertial := one.find("inertial")) is not None:
            centre = _numbers(inertial.find("origin"), "xyz", "0 0 0")
            found[one.get("name")] = float(inertial.find("mass").get("value")), np.append(centre, 1.0)
    return found


def write_small(folder: Path, text: str = SMALL) -> Path:
    """Write the small arm's file and return its path."""
    path = folder / "small.urdf"
    path.write_text(text, encoding="utf-8")
    return path


def multiply(d: float, a: float, alpha: float, theta: float, modified: bool) -> np.ndarray:
    """Return the matrix of a row as textbooks print it: Denavit and Hartenberg's, or Craig's."""
    (st, ct), (sa, ca) = ((np.sin(x), np.cos(x)) for x in (theta, alpha))
    if modified:
        return np.array(
            [
                [ct, -st, 0.0, a],
                [st * ca, ct * ca, -sa, -sa * d],
                [st * sa, ct * sa, ca, ca * d],
                [0.0, 0.0, 0.0, 1.0],
            ]
        )
    return np.array(
        [
            [ct, -st * ca, st * sa, a * ct],
            [st, ct * ca, -ct * sa, a * st],
            [0.0, sa, ca, d],
            [0.0, 0.0, 0.0, 1.0],
        ]
    )


def build_arm(text: str = SMALL, **section) -> Arm:
    """Return the small arm, or that of another text, as a machine that carries something."""
    folder = MemoryPath(".", files={"small.urdf": text.encode()})
    return Arm(ArmConfig.model_validate({"urdf": "small.urdf", "payload_kg": 2.0, **section}, context={FOLDER: folder}))
