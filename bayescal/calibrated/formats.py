"""Files of a calibrated machine for the next tool, by the names of their formats, and a directory of them."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from xml.etree import ElementTree as Xml

import numpy as np
from scipy.spatial.transform import Rotation

from bayescal.calibrated import arm_formats, linuxcnc_formats, printer_formats
from bayescal.calibrated.exported import list_function_files, list_mechanism_files, list_posterior_files
from bayescal.calibrated.grid import list_grid_files
from bayescal.calibrated.linuxcnc_formats import check_perfect_legs
from bayescal.calibrated.machine import CalibratedMachine, find_export_obstacle
from bayescal.calibrated.tpoint import list_tpoint_files
from bayescal.config.load import look_up
from bayescal.files.atomic import make_directory, write_atomically
from bayescal.files.csv_tables import format_table
from bayescal.files.manifest import renew_manifest
from bayescal.files.toml import format_toml
from bayescal.machines.kinematics import Machine, check_home_pose
from bayescal.numerics.geometry import Array

UNITS = {"1": "", "mm": "_mm", "rad": "_rad", "N": "_n", "N mm2": "_n_mm2"}
METRE = 1e-3  # m per mm
ORIGIN = np.zeros(3)
AXES = {"x": "1 0 0", "y": "0 1 0", "z": "0 0 1"}
MECHANISM, PARAMETERS = "mechanism", "parameters"


def list_parameter_files(calibrated: CalibratedMachine) -> dict[str, bytes]:
    """Return parameters with covariance as TOML and JSON; of a machine of functions what `read_exported` takes, too."""
    own = {} if calibrated.model.legs else list_function_files(calibrated)
    return own | list_toml_files(calibrated) | list_json_files(calibrated)


def list_csv_files(calibrated: CalibratedMachine) -> dict[str, bytes]:
    """Return ``legs.csv`` of a machine on legs: the parameters that legs have, a row a leg; all others in each row.

    Of another machine nothing: its parameters and their covariance are in tables with every format.
    """
    model = calibrated.model
    if model.legs is None:
        return {}
    layout, theta = model.layout, calibrated.theta
    columns, values = ["leg"], [[leg + 1 for leg in range(model.legs.n_legs)]]
    for block in layout.blocks:
        columns.append(f"{block.symbol}{UNITS.get(block.unit, '')}")
        own = [repr(float(value)) for value in layout.take(theta, block.symbol)]
        values.append(own if block.per_leg else own * model.legs.n_legs)  # type: ignore[arg-type]  # cells of any kind
    text = format_table(calibrated.source.describe(), columns, list(zip(*values, strict=True)))
    return {"legs.csv": text.encode()}


def list_json_files(calibrated: CalibratedMachine) -> dict[str, bytes]:
    """Return ``machine.json``: parameters by symbol in mm and radians, with their covariance."""
    content = json.dumps(_describe(calibrated), indent=1, ensure_ascii=False)
    return {"machine.json": (content + "\n").encode()}


def list_toml_files(calibrated: CalibratedMachine) -> dict[str, bytes]:
    """Return ``parameters.toml``: the same as TOML."""
    return {"parameters.toml": format_toml(calibrated.source.describe(), _describe(calibrated)).encode()}


def _describe(calibrated: CalibratedMachine) -> dict[str, object]:
    model, theta, source = calibrated.model, calibrated.theta, calibrated.source
    of = {block.symbol: model.layout.index[block.symbol] for block in model.layout.blocks}
    return {
        "name": calibrated.name,
        "source": {
            "experiment": source.experiment,
            "variant": source.variant,
            "data": source.data,
            "converged": not source.problems,
            "problems": list(source.problems),
            **({"solution": source.solution} if source.solution else {}),
        },
        **(_describe_legs(model.legs.machine) if model.legs else {}),
        "commanded": list(model.commanded),
        "tool": [f"{one.name} [{one.unit}]" for one in model.tool_channels],
        "parameters": {
            block.symbol: {
                "unit": block.unit,
                "mean": theta[of[block.symbol]].tolist(),
                "sd": None if calibrated.covariance is None else calibrated.sd[of[block.symbol]].tolist(),
            }
            for block in model.layout.blocks
        },
        "uncertain": list(calibrated.names),
        "covariance": None if calibrated.covariance is None else calibrated.covariance.tolist(),
    }


def _describe_legs(machine: Machine) -> dict[str, object]:
    mechanism = machine.mechanism
    return {
        "model": machine.model.name,
        "deformation": machine.deformation.name,
        "drive": mechanism.drive,
        "base_points_mm": mechanism.base_points.tolist(),
        "platform_points_mm": mechanism.platform_points.tolist(),
        "directions": mechanism.directions.tolist() if mechanism.drive == "base" else None,
        "leg_lengths_mm": mechanism.leg_lengths.tolist(),
        "initial_actuator_positions_mm": mechanism.initial_actuator_positions.tolist(),
        "actuator_range_mm": mechanism.actuator_range,
        **({} if mechanism.actuator_gains is None else {"actuator_gains": mechanism.actuator_gains.tolist()}),
    }


def list_urdf_files(calibrated: CalibratedMachine) -> dict[str, bytes]:
    """Return ``machine.urdf``: a tree of links and joints, metres and radians, at home when all are zero.

    A leg is a prismatic joint between two universal joints, each of them two revolute ones, with a turn about its own
    axis: without that six legs would hold the platform still. A tree has no loops: the first leg carries the platform,
    each of the others ends in a link that belongs where the platform's own mark of the leg is. These loops are named in
    elements ``loop_joint``, which readers of plain URDF pass over. InputError where joints and rigid links are not all
    of the machine's kinematics.
    """
    if arm_formats.is_arm(calibrated):
        return arm_formats.list_arm_urdf_files(calibrated)
    check_perfect_legs(calibrated, "urdf", ("strut", "base"))
    mechanism = calibrated.legs.mechanism
    home = check_home_pose(calibrated.legs)
    robot = Xml.Element("robot", name=mechanism.name)
    gains = mechanism.actuator_gains
    said = [*calibrated.source.describe(), "Lengths in m, angles in rad; joints zero at home."]
    if gains is not None:  # joints of the tree have the true travel
        each = ", ".join(f"leg {k} {float(gain)!r}" for k, gain in enumerate(gains, start=1))
        said.append(f"Joint = gain * (reading - initial position): {each}.")
    for comment in said:
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
    gain = 1.0 if mechanism.actuator_gains is None else float(mechanism.actuator_gains[leg])
    reach = gain * mechanism.actuator_range
    along, link, place = _frame_along(upper - lower), "base", (lower, np.eye(3))
    if not strut:
        guide = _frame_along(mechanism.directions[leg])
        link = _add_joint(robot, link, f"{name}_actuator", "z", (lower, guide), reach)
        place = (ORIGIN, guide.T)
    link = _add_joint(robot, link, f"{name}_base_universal_1", "x", (place[0], place[1] @ along))
    link = _add_joint(robot, link, f"{name}_base_universal_2", "y", (ORIGIN, np.eye(3)))
    span = (np.array([0.0, 0.0, np.linalg.norm(upper - lower)]), np.eye(3))
    if strut:
        link = _add_joint(robot, link, f"{name}_actuator", "z", span, reach)
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


FORMATS: dict[str, Callable[[CalibratedMachine], dict[str, bytes]]] = {
    MECHANISM: list_mechanism_files,
    PARAMETERS: list_parameter_files,
    "toml": list_toml_files,
    "json": list_json_files,
    "csv": list_csv_files,
    "urdf": list_urdf_files,
    **linuxcnc_formats.FORMATS,
    arm_formats.UR_KINEMATICS: arm_formats.list_ur_files,
    arm_formats.DH: arm_formats.list_dh_files,
    **printer_formats.FORMATS,
    "tpoint": list_tpoint_files,
    "grid": list_grid_files,
}


def export_machine(calibrated: CalibratedMachine, folder: Path, name: str | None = None) -> list[Path]:
    """Write a calibrated machine in a format, parameters with covariance and draws beside it; return what was written.

    Parameters
    ----------
    calibrated : CalibratedMachine
    folder : Path
        Made where it is not there; files of the same names are replaced.
    name : str, optional
        One of `FORMATS`: mechanism, parameters, toml, json, csv, urdf, genhexkins, linuxcnc, ur_kinematics, dh,
        klipper, marlin, reprapfirmware, tpoint, grid; by default that which `load_calibrated` takes again.

    Raises
    ------
    InputError
        For an unknown format or one that cannot have the machine; nothing is written then.

    Examples
    --------
    >>> from pathlib import Path
    >>> sorted(path.name for path in bc.export_machine(calibrated, Path("machines/delta"), "csv"))
    [...'covariance.csv'...]
    """
    drawn = calibrated.model.legs is not None and not find_export_obstacle(calibrated.legs)
    chosen = look_up(FORMATS, name or (MECHANISM if drawn else PARAMETERS), "--format")
    files = chosen(calibrated) | list_posterior_files(calibrated)
    make_directory(folder)
    for one, content in files.items():
        (folder / one).parent.mkdir(parents=True, exist_ok=True)
        write_atomically(folder / one, content)
    renew_manifest(folder, set(files).__contains__, begin=True)
    return [folder / one for one in files]
