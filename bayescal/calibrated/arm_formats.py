"""Files of arms for robot software: URDF, the calibration file of a UR's ROS driver, Denavit and Hartenberg's rows.

All hold where each joint's frame stands in that before, so that links, zeros of joints and the tool go in. Gains,
harmonics and compliance of joints do not: frames are then those whose tool is nearest to the calibrated one at the same
commands, and each file says, rms over the workspace, how much of the correction it carries.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import PurePosixPath
from xml.etree import ElementTree as Xml

import numpy as np
from scipy.spatial.transform import Rotation

from bayescal.calibrated.carried import BareMachine, take_machine
from bayescal.calibrated.machine import CalibratedMachine
from bayescal.errors import InputError
from bayescal.files.toml import format_toml
from bayescal.machines.chains import Chain, DenavitRow, Joint, Place, find_rows
from bayescal.machines.readings.arm import PLACES, TURNS, Arm
from bayescal.numerics.geometry import Array, compute_left_inverse_jacobian

METRE = 1e-3  # per mm
URDF, UR_KINEMATICS, DH = "urdf", "ur_kinematics", "dh"
UR_LINKS = ("shoulder", "upper_arm", "forearm", "wrist_1", "wrist_2", "wrist_3")
HELD = (*PLACES, *TURNS, "tool", "tool_r")
LEVER = 100.0  # mm of a tool, at which a turn counts as much as a displacement
STEPS, LEAST = 3, 1e-6  # of Gauss and Newton; of the largest singular value, below which a direction stays
EXACT = 1e-12  # mm and rad that rounding leaves
KEYS = ("d_mm", "a_mm", "alpha_deg", "theta_deg")
DIGITS = 13  # of degrees and mm, behind the point: d may be kilometres
NEARLY_DEG = 2.0  # between axes, below which their rows are said to belong together


def is_arm(calibrated: CalibratedMachine) -> bool:
    """Return whether a calibrated machine is an arm."""
    return isinstance(calibrated.model.bare.of_function, Arm)


def list_arm_urdf_files(calibrated: CalibratedMachine) -> dict[str, bytes]:
    """Return ``machine.urdf``: the arm's own URDF file with corrected origins, or a chain of its rows' joints.

    Links, joints, meshes and limits of an own file stay as they are. A joint's frame moves with its error, E_i before
    the joint turns; the tool's goes into the fixed joint above the tip.
    """
    held = _hold(calibrated, URDF, HELD)
    arm = held.arm
    if arm.config.urdf is None:
        robot = _make_robot(calibrated.name, arm, *_read_errors(held))
    else:
        name = (PurePosixPath(calibrated.machine_file).parent / arm.config.urdf).as_posix()
        parser = Xml.XMLParser(target=Xml.TreeBuilder(insert_comments=True))
        try:
            robot = Xml.fromstring(calibrated.files[name], parser)
        except Xml.ParseError as error:  # prefixes that it does not declare
            raise InputError(f"format {URDF}: {arm.config.urdf}: found {error}, expected XML with its names") from error
        _correct_robot(robot, arm, *_read_errors(held))
    said = [*calibrated.source.describe(), held.description, "Lengths in m, angles in rad."]
    for k, line in enumerate(said):
        robot.insert(k, Xml.Comment(f" {line.replace('--', '- -')} "))
    Xml.indent(robot)
    return {"machine.urdf": Xml.tostring(robot, encoding="utf-8", xml_declaration=True) + b"\n"}


def list_ur_files(calibrated: CalibratedMachine) -> dict[str, bytes]:
    """Return ``kinematics.yaml``, where the frames of a UR's six joints stand, as its ROS description reads them.

    InputError for an arm of other than six joints that turn, and for a tip that is not the flange.
    """
    held = _hold(calibrated, UR_KINEMATICS, (*PLACES, *TURNS))
    arm, places = held.arm, _read_errors(held)[0]
    joints = arm.chain.joints
    if len(joints) != len(UR_LINKS) or arm.slides.any():
        raise InputError(f"format {UR_KINEMATICS}: found {len(joints)} joints, expected six that turn")
    if np.abs(arm.chain.tip.position).max() > EXACT or np.abs(arm.chain.tip.axes - np.eye(3)).max() > EXACT:
        raise InputError(f"format {UR_KINEMATICS}: found a tip beyond the flange, expected tip_mm and tip_deg of zero")
    said = [*calibrated.source.describe(), held.description, "Lengths in m, angles in rad."]
    lines = [*(f"# {one}" for one in said), "kinematics:"]
    for name, joint, error in zip(UR_LINKS, joints, places, strict=True):
        place = joint.place.then(error)
        values = [*(METRE * place.position), *_list_angles(place)]
        lines.append(f"  {name}:")
        keys = ("x", "y", "z", "roll", "pitch", "yaw")
        lines += [f"    {key}: {float(value) + 0.0!r}" for key, value in zip(keys, values, strict=True)]
    return {"kinematics.yaml": ("\n".join(lines) + "\n").encode()}


def list_dh_files(calibrated: CalibratedMachine) -> dict[str, bytes]:
    """Return ``dh.toml``: rows of the joints, classical or modified as the arm is stated, of a URDF file modified.

    It is a machine's file that ``kind = "arm"`` reads. Base and tip have what rows do not: where the first axis is, and
    how the tip is turned. Axes that are nearly parallel have their common normal far away, and d that belong together.
    """
    held = _hold(calibrated, DH, HELD)
    arm, (errors, tool) = held.arm, _read_errors(held)
    config, joints = arm.config, arm.chain.joints
    modified = config.urdf is not None or config.convention == "modified"
    end = None if modified else config.joints[-1]
    last = DenavitRow() if end is None else DenavitRow(a=end.a_mm, alpha=float(np.radians(end.alpha_deg)))
    moved = [joint.place.then(error) for joint, error in zip(joints, errors, strict=True)]
    # of the first frame's error its row has what is along the axis, the base the rest
    along = DenavitRow(d=errors[0].position[2], theta=Rotation.from_matrix(errors[0].axes).as_rotvec()[2]).along
    drawn = _move(np.array(config.base_mm), np.radians(config.base_deg))
    base = moved[0].then(along.back).then(joints[0].place.back).then(drawn)
    moved[0] = base.back.then(moved[0])
    chain = Chain(
        [replace(one, place=place) for one, place in zip(joints, moved, strict=True)], arm.chain.tip.then(tool)
    )
    more, rows, tip = find_rows(chain, modified, last)
    said = [*calibrated.source.describe(), held.description]
    alone = held.change_first(along)
    if np.abs(alone - held.theta).max() > EXACT:
        said.append(held.bare.describe(alone, "To a controller without base_mm and base_deg the file"))
    for one, other, place in zip(joints, joints[1:], moved[1:], strict=False):
        angle = np.degrees(np.arctan2(np.hypot(*place.axes[:2, 2]), np.abs(place.axes[2, 2])))
        if angle < NEARLY_DEG:
            said.append(
                f"Axes of {one.name} and {other.name} are parallel to {angle:.2g} deg: their d belong together."
            )
    machine: dict[str, object] = {"convention": "modified" if modified else "classical"}
    machine |= config.model_dump(exclude_defaults=True, include={"down", "workspace_deg"})
    for name, place in (("base", base.then(more)), ("tip", tip)):
        machine[f"{name}_mm"] = _round(place.position)
        machine[f"{name}_deg"] = _round(np.degrees(Rotation.from_matrix(place.axes).as_rotvec()))
    machine["joints"] = [
        {"name": joint.name}
        | dict(zip(KEYS, _round([row.d, row.a, *np.degrees([row.alpha, row.theta])]), strict=True))
        | _describe_ends(joint)
        for joint, row in zip(joints, rows, strict=True)
    ]
    content = {"kind": "arm", "name": calibrated.name, "title": f"{calibrated.name} as calibrated", "machine": machine}
    return {"dh.toml": format_toml(said, content).encode()}


def _round(values: Sequence[float] | Array) -> list[float]:
    """Return numbers without what rounding has left, mm or degrees."""
    return [round(float(one), DIGITS) + 0.0 for one in values]


def _describe_ends(joint: Joint) -> dict[str, list[float]]:
    """Return a joint's range as the key of a row; nothing where nobody says it."""
    ends = np.array(joint.ends) if joint.slides else np.degrees(joint.ends)
    return {"range_mm" if joint.slides else "range_deg": _round(ends)} if np.isfinite(ends).all() else {}


@dataclass(frozen=True, eq=False)
class _Held:
    """An arm and what a file holds of it: some parameters, all others nominal."""

    bare: BareMachine[Arm]
    theta: Array  # (D,)

    @property
    def arm(self) -> Arm:
        """The arm itself."""
        return self.bare.machine

    @property
    def description(self) -> str:
        """What the file carries."""
        return self.bare.describe(self.theta)

    def change_first(self, error: Place) -> Array:
        """Return the parameters with another error of the first joint's frame, seen from the frame itself."""
        changed, index = self.theta.copy(), self.bare.model.layout.index
        for names, values in ((PLACES, error.position), (TURNS, Rotation.from_matrix(error.axes).as_rotvec())):
            for name, value in zip(names, values, strict=True):
                changed[index[name][0]] = value
        return changed


def _hold(calibrated: CalibratedMachine, what: str, symbols: Sequence[str]) -> _Held:
    """Return an arm by some symbols: as calibrated, moved so that the tool is where it would be with all others.

    By Gauss and Newton's method, least squares of positions, and of rotations at `LEVER`, over the workspace.
    """
    bare = take_machine(calibrated, what, {"arm": Arm})
    model = bare.model
    theta = model.layout.nominal.copy()
    places = np.concatenate([model.layout.index[symbol] for symbol in symbols])
    theta[places] = bare.theta[places]
    pose, commands, _ = bare.sample()
    wanted = model.tool_values(bare.theta, pose)
    scale = np.repeat([1.0, LEVER], 3)
    for _ in range(STEPS if (np.delete(bare.theta - model.layout.nominal, places) != 0.0).any() else 0):
        here, _, slopes = model.tool(theta, commands)
        apart = compute_pose_differences(wanted, here) * scale
        rows = (slopes[..., places] * scale[:, None]).reshape(-1, len(places))
        theta[places] += np.linalg.lstsq(rows, apart.ravel(), rcond=LEAST)[0]
    return _Held(bare, theta)


def compute_pose_differences(wanted: Array, here: Array) -> Array:
    """Return by what poses (P, 6), position and rotation vector, differ from others that are near, to first order."""
    turn = Rotation.from_rotvec(wanted[:, 3:]) * Rotation.from_rotvec(here[:, 3:]).inv()
    vector = compute_left_inverse_jacobian(here[:, 3:]) @ turn.as_rotvec()[..., None]
    return np.concatenate([wanted[:, :3] - here[:, :3], vector[..., 0]], axis=1)


def _read_errors(held: _Held) -> tuple[list[Place], Place]:
    """Return the error of each joint's frame, and of the tool's, each seen from the frame itself."""
    bare = replace(held.bare, theta=held.theta)
    moves, turns = (np.stack([bare.take(one) for one in names], axis=-1) for names in (PLACES, TURNS))
    return [_move(*one) for one in zip(moves, turns, strict=True)], _move(bare.take("tool"), bare.take("tool_r"))


def _move(position: Array, vector: Array) -> Place:
    return Place(position, Rotation.from_rotvec(vector).as_matrix())


# --- URDF ------------------------------------------------------------------------------------------------------------


def _correct_robot(robot: Xml.Element, arm: Arm, places: Sequence[Place], tool: Place) -> None:
    """Put errors into the origins of a robot's joints, in place."""
    # a transmission names joints by elements of the same tag
    named = {one.get("name"): one for one in robot.findall("joint")}
    for joint, error in zip(arm.chain.joints, places, strict=True):
        _shift_origin(named[joint.name], _turn_back(joint, error))
    above = {one.find("child").get("link"): one for one in robot.findall("joint")}  # type: ignore[union-attr]
    tip = arm.config.tip or next(
        name
        for name in above
        if name not in {one.find("parent").get("link") for one in robot.findall("joint")}  # type: ignore[union-attr]
    )
    last = above[tip]
    if last.get("type") == "fixed":
        _shift_origin(last, tool)
    elif np.abs(tool.position).max() > EXACT or np.abs(tool.axes - np.eye(3)).max() > EXACT:
        Xml.SubElement(robot, "link", name=f"{tip}_calibrated")
        more = Xml.SubElement(robot, "joint", name=f"{tip}_calibrated_joint", type="fixed")
        _write_joint(more, str(tip), f"{tip}_calibrated", tool)


def _turn_back(joint: Joint, error: Place) -> Place:
    """Return an error in the axes of the URDF joint, whose own axis may be another than z."""
    axes = joint.link.axes.T
    return Place(axes @ error.position, axes @ error.axes @ axes.T)


def _shift_origin(joint: Xml.Element, error: Place) -> None:
    origin = joint.find("origin")
    if origin is None:
        origin = Xml.SubElement(joint, "origin")
    position, angles = (np.array([float(x) for x in origin.get(key, "0 0 0").split()]) for key in ("xyz", "rpy"))
    place = Place(position / METRE, Rotation.from_euler("xyz", angles).as_matrix()).then(error)
    _write_origin(origin, place)


def _write_origin(origin: Xml.Element, place: Place) -> None:
    origin.set("xyz", " ".join(repr(float(x) + 0.0) for x in METRE * place.position))
    origin.set("rpy", " ".join(repr(float(x) + 0.0) for x in _list_angles(place)))


def _list_angles(place: Place) -> Array:
    """Return roll, pitch and yaw; at a pitch of a right angle yaw is zero."""
    return np.asarray(Rotation.from_matrix(place.axes).as_euler("xyz", suppress_warnings=True))


def _write_joint(joint: Xml.Element, parent: str, child: str, place: Place) -> None:
    Xml.SubElement(joint, "parent", link=parent)
    Xml.SubElement(joint, "child", link=child)
    _write_origin(Xml.SubElement(joint, "origin"), place)


def _make_robot(name: str, arm: Arm, places: Sequence[Place], tool: Place) -> Xml.Element:
    """Return a robot of the arm's joints, each with the link that it moves, and the tip."""
    robot, before = Xml.Element("robot", name=name), "base_link"
    Xml.SubElement(robot, "link", name=before)
    for one, error in zip(arm.chain.joints, places, strict=True):
        child = f"{one.name}_link"
        Xml.SubElement(robot, "link", name=child)
        joint = Xml.SubElement(robot, "joint", name=one.name, type="prismatic" if one.slides else "revolute")
        _write_joint(joint, before, child, one.place.then(error))
        Xml.SubElement(joint, "axis", xyz="0 0 1")
        ends = np.array(one.ends) * (METRE if one.slides else 1.0)
        low, high = (repr(float(x)) for x in ends)
        Xml.SubElement(joint, "limit", lower=low, upper=high, effort="0", velocity="0")
        before = child
    Xml.SubElement(robot, "link", name="tip")
    _write_joint(
        Xml.SubElement(robot, "joint", name="tip_joint", type="fixed"), before, "tip", arm.chain.tip.then(tool)
    )
    return robot
