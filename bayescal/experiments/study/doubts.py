"""What may be wrong with a study's data beside slips: a zero that wide tolerances would swallow, columns twice."""

from __future__ import annotations

import numpy as np

from bayescal.experiments.shared.readings.columns import doubt_columns
from bayescal.experiments.shared.readings.inputs import ReadingInputs
from bayescal.machines.kinematics import Machine, solve_forward_kinematics
from bayescal.machines.mechanism import Mechanism
from bayescal.numerics.geometry import Array
from bayescal.report.numbers import format_plain, format_significant

MAX_SHIFT_FRACTION = 0.03
"""Shift in units of the machine's size beyond which no drawing is that wrong."""
MIN_SHIFT_RATIO = 3.0
"""Shift in units of what the poses scatter about it, below which it is not one for all."""
FEWEST = 3
MIN_REACHED_FRACTION = 0.5  # share of the poses at which the machine as drawn has to stand somewhere


def doubt_copies(inputs: ReadingInputs) -> list[str]:
    """Return in lines which columns of the machine's own channels repeat others."""
    first = max(inputs.variants.values(), key=lambda one: len(one.model.channels))
    return doubt_columns(first.data, first.model, inputs.columns)


def doubt_zero(inputs: ReadingInputs) -> list[str]:
    """Return in a line that all poses are shifted alike against the machine as drawn; nothing where they are not.

    Only poses measured whole in a known frame are looked at: an unknown one is found by the calibration.
    """
    first = next(iter(inputs.variants.values()))
    legs, names = first.whole.legs, list(first.model.names)
    wanted = () if legs is None else (*legs.commanded, "x", "y", "z")
    if legs is None or not {*wanted} <= {*names}:
        return []
    machine, read = legs.machine, first.data.values[:, [names.index(one) for one in wanted]]
    read = read[np.isfinite(read).all(axis=1)]
    standing = machine.mechanism.place_actuators(read[:, :-3])
    shift = find_shift(machine, read[:, -3:], standing) if len(read) else None
    if shift is None:
        return []
    mean, scatter = shift
    distance, size = float(np.linalg.norm(mean)), measure_size(machine.mechanism)
    if distance < MAX_SHIFT_FRACTION * size or distance < MIN_SHIFT_RATIO * scatter:
        return []
    each = ", ".join(format_plain(one, 3) for one in mean)
    return [
        f"the measured poses lie {format_significant(distance)} mm ({each}) from nominal, common to "
        f"{format_significant(scatter)} mm: perhaps a frame offset of instrument or reflector, or "
        "home_position"
    ]


def find_shift(machine: Machine, position: Array, actuators: Array) -> tuple[Array, float] | None:
    """Return by how much positions (P, 3) are shifted against the nominal machine's, and their rms scatter about it.

    Returns
    -------
    (ndarray of shape (3,), float) or None
        mm, base frame; None with fewer than three poses, or where the nominal machine reaches fewer than half of them.
    """
    found = solve_forward_kinematics(machine, machine.layout.nominal, actuators, check=False)
    off = (position - found.position)[found.converged]
    if len(off) < max(FEWEST, MIN_REACHED_FRACTION * len(position)) or not np.isfinite(off).all():
        return None
    mean = off.mean(axis=0)
    return mean, float(np.sqrt(np.mean(np.sum((off - mean) ** 2, axis=1))))


def measure_size(mechanism: Mechanism) -> float:
    """Return the rms distance of the joints at home from their middle, mm."""
    apart = [one - one.mean(axis=0) for one in (mechanism.home_joints, mechanism.platform_points)]
    return float(np.sqrt(np.mean(np.sum(np.concatenate(apart) ** 2, axis=1))))
