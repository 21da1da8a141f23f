"""Where a machine's joints stand, pose by pose, as a table that a page draws the machine from."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd

from bayescal.experiments.shared.rows import JointRow
from bayescal.machines.deformations import NoDeformation
from bayescal.machines.kinematics import build_machine, solve_forward_kinematics
from bayescal.machines.mechanism import Mechanism
from bayescal.machines.models import MODELS
from bayescal.numerics.geometry import Array

MOST_POSES = 60  # more make the page heavy and nothing clearer
DECIMALS = 3  # of a millimetre
HOME = "home"


def tabulate_joints(mechanism: Mechanism, actuators: Array, names: Sequence[str]) -> pd.DataFrame:
    """Return the joints of the nominal machine on perfect legs, base frame, mm.

    Parameters
    ----------
    actuators : ndarray, shape (P, N)
        What the actuators read at the poses, mm.
    names : sequence of str
        Of the poses.

    Returns
    -------
    DataFrame
        Of rows `JointRow`. Home comes first, with the ends of the guides ``from`` and ``to``; poses that forward
        kinematics does not find are left out, as are those beyond the first sixty.
    """
    start, names = mechanism.initial_actuator_positions, [HOME, *map(str, names[:MOST_POSES])]
    actuators = mechanism.place_actuators(np.vstack([start, actuators[:MOST_POSES]]))
    model = next(one for one in ("six_pus", "six_ups") if MODELS[one].drive == mechanism.drive)
    machine = build_machine(MODELS[model], mechanism, NoDeformation())  # on perfect joints, whatever is identified
    found = solve_forward_kinematics(machine, machine.layout.nominal, actuators, check=False)
    upper = found.position[:, None] + mechanism.platform_points @ np.swapaxes(found.rotation, -1, -2)
    lower = np.broadcast_to(mechanism.base_points, upper.shape)
    if mechanism.drive == "base":
        lower = lower + actuators[:, :, None] * mechanism.directions
    rows: list[pd.DataFrame] = []
    for k in np.flatnonzero(found.converged):
        rows += [_tabulate(names[k], "base", lower[k]), _tabulate(names[k], "platform", upper[k])]
    if rows and mechanism.drive == "base":
        reach = mechanism.actuator_range * mechanism.directions
        rows += [_tabulate(HOME, "from", lower[0] - reach), _tabulate(HOME, "to", lower[0] + reach)]
    return pd.concat(rows, ignore_index=True).round(DECIMALS) if rows else JointRow.collect([])


def _tabulate(pose: str, joint: str, points: Array) -> pd.DataFrame:
    """Return the rows of N points, shape (N, 3)."""
    x, y, z = points.T
    return JointRow.tabulate(pose=pose, leg=np.arange(1, len(points) + 1), joint=joint, x_mm=x, y_mm=y, z_mm=z)
