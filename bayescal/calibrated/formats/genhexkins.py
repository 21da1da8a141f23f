"""Parameters of LinuxCNC's kinematics of a general hexapod, genhexkins, as lines of a HAL file.

Its conventions, as its manual has them: ``base.N`` and ``platform.N`` are the ends of strut N, counted from zero, in
base and in platform coordinates; a joint's position is the length of its strut, |p + R platform.N - base.N|; A, B and
C are roll, pitch and yaw in degrees, R = R_z(C) R_y(B) R_x(A). Machine units are taken to be millimetres.
"""

from __future__ import annotations

from bayescal.calibrated.formats.perfect_legs import check_perfect_legs
from bayescal.calibrated.machine import CalibratedMachine
from bayescal.errors import InputError

STRUTS = 6
HELP = (
    "LinuxCNC genhexkins; units are mm. Load after `loadrt genhexkins`, for example by [HAL] HALFILE of the INI file.",
    "A joint's position is the length of its strut: joint N = length N + actuator position - initial position,",
    "where an actuator position is what bayescal's tables call rho_(N+1)_mm.",
)


def list_genhexkins_files(calibrated: CalibratedMachine) -> dict[str, bytes]:
    """Return ``genhexkins.hal``; InputError where the machine has other than six struts with perfect joints."""
    check_perfect_legs(calibrated, "genhexkins", ("strut",))
    mechanism = calibrated.legs.mechanism
    if mechanism.n_legs != STRUTS:
        raise InputError(f"format genhexkins: found {mechanism.n_legs} struts, expected {STRUTS}")
    lines = [f"# {comment}" for comment in (*calibrated.source.describe(), *HELP)]
    for k in range(STRUTS):
        length, start = mechanism.leg_lengths[k], mechanism.initial_actuator_positions[k]
        lines.append(f"# joint {k}: length {float(length)!r} at the initial position {float(start)!r}")
    for pin, points in (("base", mechanism.base_points), ("platform", mechanism.platform_points)):
        for k, point in enumerate(points):
            lines += [f"setp genhexkins.{pin}.{k}.{axis} {float(x)!r}" for axis, x in zip("xyz", point, strict=True)]
    lines += ["setp genhexkins.spindle-offset 0", "setp genhexkins.screw-lead 0"]
    return {"genhexkins.hal": ("\n".join(lines) + "\n").encode()}
