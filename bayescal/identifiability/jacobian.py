"""The identification Jacobian as a table, to print and to look at."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd

from bayescal.identifiability.design import Knowledge
from bayescal.identifiability.sensitivity import compute_sensitivity
from bayescal.machines.kinematics import Machine
from bayescal.numerics.geometry import Array

COMPONENTS = ("x", "y", "z", "rx", "ry", "rz")


def tabulate_jacobian(
    machine: Machine, actuators: Array, parameters: Sequence[str] | None = None, theta: Array | None = None
) -> pd.DataFrame:
    """Return how poses change with the parameters, ∂pose/∂θ = -A⁻¹ F (RR-8096 eq. 37), actuators held.

    Parameters
    ----------
    machine : Machine
    actuators : ndarray, shape (P, N)
        Actuator positions, mm.
    parameters : sequence of str, optional
        Names such as ``l[1]``; all of the machine by default.
    theta : ndarray, shape (D,), optional
        The machine's parameters; nominal by default.

    Returns
    -------
    DataFrame
        A row for each pose, counted from one, and component (position in mm, rotation vector in rad, base frame); a
        column for each parameter, in pose units per the parameter's unit.

    Raises
    ------
    InputError
        Where forward kinematics finds no pose.
    """
    layout = machine.layout
    names = list(layout.names if parameters is None else parameters)
    values = layout.nominal if theta is None else theta
    knowledge = Knowledge(machine, dict.fromkeys(names, 1.0), dict(zip(layout.names, values.tolist(), strict=True)))
    slope = compute_sensitivity(knowledge, np.atleast_2d(actuators)).slope
    order = [knowledge.names.index(name) for name in names]
    index = pd.MultiIndex.from_product([range(1, len(slope) + 1), COMPONENTS], names=["pose", "component"])
    return pd.DataFrame(slope[..., order].reshape(-1, len(names)), index=index, columns=names)
