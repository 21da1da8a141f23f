"""How much poses tell of a machine's parameters: information against a tolerance, no sampling."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from bayescal.machines.kinematics import Machine
from bayescal.numerics.geometry import Array
from bayescal.reproductions.rr8096.evidence import ClaimEvidence

IDENTIFIED = 0.5
"""A direction counts as identified where the poses at least halve its tolerance."""
SHARE = 0.3  # tolerance of a stiffness as a share of its nominal value
TOLERANCE = {"u_x": 0.05, "u_y": 0.05, "kappa": 0.01, "beta": 0.1}
LENGTH_TOLERANCE = 2.0  # mm


def tolerance_of(machine: Machine) -> Array:
    """Return the standard deviation (D,) within which each parameter is known beforehand."""
    layout = machine.layout
    sd = np.empty(layout.size)
    for block in layout.blocks:
        size = TOLERANCE.get(block.symbol, LENGTH_TOLERANCE)
        nominal = np.array(block.nominal)
        sd[layout.index[block.symbol]] = size if block.unit in ("mm", "1") else SHARE * np.abs(nominal)
    return sd


def compute_contraction(evidence: ClaimEvidence, machine: Machine, free: Sequence[str], chosen: Sequence[str]) -> Array:
    """Return by how much the calibration poses narrow some parameters of a leg, all free ones unknown.

    Parameters
    ----------
    evidence : ClaimEvidence
    machine : Machine
        Linearised at its identified parameters, with the poses' noise and no model error.
    free : sequence of str
        What is unknown, each within its tolerance.
    chosen : sequence of str
        The parameters to look at, in all directions of their common space.

    Returns
    -------
    ndarray, shape (N, K)
        1 - sd after / sd before along the principal directions of each leg, largest first; for parameters of the
        whole machine one row. Zero says nothing was learnt, one everything.
    """
    layout, sd = machine.layout, tolerance_of(machine)
    likelihood = evidence.likelihood(machine)
    slope = likelihood.leg_error_jacobian(evidence.identified(machine))[1]
    index = np.concatenate([layout.index[symbol] for symbol in free])
    slope = slope[..., index] * sd[index]
    precision = np.linalg.inv(likelihood.leg_covariance(np.zeros(likelihood.n_legs)))
    data = np.einsum("pik,pij,pjm->km", slope, precision, slope, optimize=True)
    covariance = np.linalg.inv(data + np.eye(len(index)))
    place = {position: k for k, position in enumerate(index)}
    groups = np.stack([layout.index[symbol] for symbol in chosen], axis=1)
    rows = []
    for group in groups:
        at = [place[position] for position in group]
        rows.append(1.0 - np.sqrt(np.maximum(np.linalg.eigvalsh(covariance[np.ix_(at, at)]), 0.0)))
    return np.array(rows)
