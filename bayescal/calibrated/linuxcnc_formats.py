"""Lines of LinuxCNC's HAL: a hexapod for genhexkins, a linear delta for lineardeltakins. Machine units are mm.

genhexkins takes all of a hexapod of six struts. lineardeltakins takes one radius R and one arm L; its towers, joints 0
to 2, stand at 90, 210 and 330 degrees, as its source has them, and a joint is the height of its carriage,

    joint = z + sqrt(L² - (x - R cos α)² - (y - R sin α)²),

whose value at the endstop is the joint's HOME_OFFSET. Towers that differ become those whose tool is nearest.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from bayescal.calibrated.carried import take_machine
from bayescal.calibrated.machine import CalibratedMachine
from bayescal.calibrated.printer_formats import fit_delta, write_numbers
from bayescal.errors import InputError, name_faults
from bayescal.machines.models.six_pus import SixPus
from bayescal.machines.models.six_ups import SixUps
from bayescal.machines.readings.delta import DeltaMachine

GENHEXKINS, LINUXCNC = "genhexkins", "linuxcnc"
STRUTS = 6
HELP = (
    "LinuxCNC genhexkins, mm. Load after `loadrt genhexkins`.",
    "Joint N = length N + rho_(N+1)_mm - initial position.",
)
GAINED = "With gains: joint N = length N + gain N * (actuator position - initial position)."
TOWERS_HELP = (
    "LinuxCNC lineardeltakins, mm. Load after `loadrt lineardeltakins`.",
    "Joint: carriage height; HOME_OFFSET, at the endstop, for the ini file.",
)
TOWERS_DEG = np.array([90.0, 210.0, 330.0])
ASIDE_DEG = 20.0
"""From these directions, beyond which a tower is none of them."""


def check_perfect_legs(calibrated: CalibratedMachine, what: str, drives: tuple[str, ...]) -> None:
    """Raise InputError where a format that takes some drives cannot have the kinematics of a machine, saying why."""
    with name_faults(f"format {what}"):
        machine, variant = calibrated.legs, calibrated.source.variant
    if machine.mechanism.drive not in drives:
        raise InputError(f"format {what}: found base actuators in variant {variant!r}, expected struts")
    if not machine.model.has_perfect_joints:
        raise InputError(
            f"format {what}: found model {machine.model.name!r} in variant {variant!r}, expected "
            f"perfect joints, {SixPus.name} or {SixUps.name}"
        )
    if not machine.deformation.is_rigid:
        raise InputError(f"format {what}: found a flexible platform in variant {variant!r}, expected a rigid one")


def list_genhexkins_files(calibrated: CalibratedMachine) -> dict[str, bytes]:
    """Return ``genhexkins.hal``, parameters of LinuxCNC's kinematics of a general hexapod as lines of a HAL file.

    Its conventions, as its manual has them: ``base.N`` and ``platform.N`` are the ends of strut N, counted from zero,
    in base and in platform coordinates; a joint's position is the length of its strut, |p + R platform.N - base.N|; A,
    B and C are roll, pitch and yaw in degrees, R = R_z(C) R_y(B) R_x(A). Machine units are taken to be millimetres.
    InputError where the machine has other than six struts with perfect joints.
    """
    check_perfect_legs(calibrated, GENHEXKINS, ("strut",))
    mechanism = calibrated.legs.mechanism
    if mechanism.n_legs != STRUTS:
        raise InputError(f"format {GENHEXKINS}: found {mechanism.n_legs} struts, expected {STRUTS}")
    gains = mechanism.actuator_gains
    lines = [f"# {one}" for one in (*calibrated.source.describe(), *HELP, *([] if gains is None else [GAINED]))]
    for k in range(STRUTS):
        length, start = mechanism.leg_lengths[k], mechanism.initial_actuator_positions[k]
        gain = "" if gains is None else f", gain {float(gains[k])!r}"
        lines.append(f"# joint {k}: length {float(length)!r} at the initial position {float(start)!r}{gain}")
    for pin, points in (("base", mechanism.base_points), ("platform", mechanism.platform_points)):
        for k, point in enumerate(points):
            lines += [f"setp genhexkins.{pin}.{k}.{axis} {float(x)!r}" for axis, x in zip("xyz", point, strict=True)]
    lines += ["setp genhexkins.spindle-offset 0", "setp genhexkins.screw-lead 0"]
    return {"genhexkins.hal": ("\n".join(lines) + "\n").encode()}


def list_linuxcnc_files(calibrated: CalibratedMachine) -> dict[str, bytes]:
    """Return ``genhexkins.hal`` of a machine on legs, ``lineardeltakins.hal`` of a linear delta."""
    if calibrated.model.bare.legs is not None:
        return list_genhexkins_files(calibrated)
    printer = take_machine(calibrated, LINUXCNC, {"delta": DeltaMachine})
    stated = np.degrees(printer.model.layout.take(printer.model.layout.nominal, "angle"))
    apart = np.abs((stated - TOWERS_DEG[:, None] + 180.0) % 360.0 - 180.0)
    towers = apart.argmin(axis=1)  # of each joint
    if apart.min(axis=1).max() > ASIDE_DEG or len({*towers.tolist()}) < len(towers):
        found = ", ".join(f"{one:g}" for one in stated)
        raise InputError(f"format {LINUXCNC}: found towers at {found} degrees, expected them near 90, 210, 330")
    angles = np.empty(len(towers))
    angles[towers] = np.radians(TOWERS_DEG)

    def unpack(x: np.ndarray) -> np.ndarray:
        return printer.change(r=x[0], l=x[1], e=x[2:], angle=angles)

    start = np.array([printer.take("r").mean(), printer.take("l").mean(), *printer.take("e")])
    held = replace(printer, theta=fit_delta(printer, unpack, start, np.ones(len(start))))
    (radius, *_), (arm, *_) = held.take("r"), held.take("l")
    ends = held.take("e") + np.sqrt(arm**2 - radius**2)
    said = [*calibrated.source.describe(), printer.describe(held.theta), *TOWERS_HELP]
    said += [
        f"joint {joint}: tower {tower + 1}, [JOINT_{joint}] HOME_OFFSET = {write_numbers([ends[tower]])[0]}"
        for joint, tower in enumerate(towers)
    ]
    values = zip("RL", write_numbers([radius, arm]), strict=True)
    lines = [*(f"# {one}" for one in said), *(f"setp lineardeltakins.{pin} {value}" for pin, value in values)]
    return {"lineardeltakins.hal": ("\n".join(lines) + "\n").encode()}


FORMATS: dict[str, Callable[[CalibratedMachine], dict[str, bytes]]] = {
    GENHEXKINS: list_genhexkins_files,
    LINUXCNC: list_linuxcnc_files,
}
