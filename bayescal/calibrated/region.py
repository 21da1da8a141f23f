"""Where a calibrated machine is judged: at poses like those that calibrated it, in a box about home, or in all reach.

What lies outside of the measured poses is extrapolated: there uncertainty is larger, and rests on the model alone.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.stats import qmc

from bayescal.calibrated.machine import CalibratedMachine
from bayescal.calibrated.predict import bound_workspace, is_pose
from bayescal.density.calibration.measurements import Comparison
from bayescal.errors import InputError
from bayescal.numerics.geometry import Array

FEWEST = 16
"""Poses that figures over a region need."""
TRIES = 64
"""Poses of a box that are tried for each one wanted: legs reach few of its corners."""

BARELY = 0.05
"""Of the box's extent, by which a pose may lie outside of it and still count as within."""


@dataclass(frozen=True, eq=False)
class Region:
    """A box of poses: coordinates from home, a rotation vector about the base axes.

    Attributes
    ----------
    low, high : ndarray, shape (q,)
        mm, rad, or what else a coordinate is in.
    words : str
        What it is.
    """

    low: Array
    high: Array
    words: str


def enclose_measured(calibrated: CalibratedMachine) -> Region | None:
    """Return the box of the poses that calibrated a machine; None where they are not known."""
    if calibrated.measured is None:
        return None
    model = calibrated.model
    pose, found = model.locate(calibrated.theta, calibrated.measured, calibrated.given, weights=calibrated.weights)
    if not found.any():
        return None
    apart = Comparison(model.pose_channels).subtract(pose[found], model.home_pose)
    words = f"the box of the {len(apart)} poses that calibrated the machine"
    return Region(apart.min(axis=0), apart.max(axis=0), words)


def find_largest_cube(calibrated: CalibratedMachine, region: Region, tool: Array) -> float:
    """Return the edge of the largest cube about home's tool within a region, mm; zero where home is not inside.

    Where the coordinates are not the tool, it is that within the box of tools (P, m) all over the region.
    """
    low, high = region.low, region.high
    if not is_pose(calibrated):
        home = calibrated.model.tool_values(calibrated.theta, calibrated.model.home_pose)
        apart = calibrated.comparison.subtract(tool, home)
        low, high = apart.min(axis=0), apart.max(axis=0)
    lengths = calibrated.lengths
    return max(0.0, 2.0 * float(np.minimum(-low[lengths], high[lengths]).min(initial=np.inf)))


def measure_beyond(calibrated: CalibratedMachine, commands: Array, known: Region | None) -> float:
    """Return the share of commands (P, C) outside of the box of the poses that calibrated a machine; 0 if unknown.

    Poses are judged by their lengths; those of a machine without any by all coordinates.
    """
    if known is None:
        return 0.0
    model = calibrated.model
    lengths = np.array([one.unit == "mm" for one in model.coordinates])
    chosen = lengths if lengths.any() else np.ones_like(lengths)
    given = calibrated.typical(len(commands))
    pose, found = model.locate(calibrated.theta, commands, given, weights=calibrated.weights)
    apart = Comparison(model.pose_channels).subtract(pose[found], model.home_pose)
    slack = BARELY * (known.high - known.low)
    outside = (apart < known.low - slack) | (apart > known.high + slack)
    return float(outside[:, chosen].any(axis=1).mean())


def box_about_home(half: Array) -> Region:
    """Return the box of half extents (q,) about home, in the coordinates' units."""
    return Region(-half, half, "the box about home as stated")


def sample_region(calibrated: CalibratedMachine, region: Region, n: int, seed: int) -> Array:
    """Return commands (n, C) of poses all over a region, as far as they are in reach.

    Raises
    ------
    InputError
        Where fewer than `FEWEST` are.
    """
    model, compared = calibrated.model, Comparison(calibrated.model.pose_channels)
    q = len(model.coordinates)
    sobol, kept, count = qmc.Sobol(q, rng=np.random.default_rng(seed)), list[Array](), 0
    size, (low, high) = int(2 ** np.ceil(np.log2(n))), model.command_range.T
    for _ in range(TRIES):
        apart = qmc.scale(sobol.random(size), region.low, np.maximum(region.high, region.low + 1e-12))
        pose = compared.add(np.broadcast_to(model.home_pose, apart.shape), apart)
        commands = model.read(calibrated.theta, pose, calibrated.typical(size))[:, calibrated.commanded]
        with np.errstate(invalid="ignore"):
            there = ((commands >= low) & (commands <= high)).all(axis=1)
        kept.append(commands[there])
        count += int(there.sum())
        if count >= n:
            break
    if count < FEWEST:
        raise InputError(
            f"workspace: found {count} of {TRIES * size} poses of {region.words} in reach of the actuators, expected "
            f"{FEWEST} at least"
        )
    return np.concatenate(kept)[:n]


def enclose_workspace(calibrated: CalibratedMachine) -> Region | None:
    """Return the workspace of a machine whose commands have no range; None where they have."""
    if np.isfinite(calibrated.model.command_range).all():
        return None
    low, high = bound_workspace(calibrated) - calibrated.model.home_pose
    return Region(low, high, "the workspace")


def sample_range(calibrated: CalibratedMachine, n: int, seed: int) -> Array:
    """Return commands (about n, C) all over their range, that have a pose; all over the workspace where they have none.

    Raises
    ------
    InputError
        Where none has.
    """
    model = calibrated.model
    workspace = enclose_workspace(calibrated)
    if workspace is not None:
        return sample_region(calibrated, workspace, n, seed)
    low, high = model.command_range.T
    share = qmc.Sobol(len(low), rng=np.random.default_rng(seed)).random_base2(int(np.ceil(np.log2(n))))
    commands = 0.5 * (low + high) + 0.5 * (high - low) * (2.0 * share[:n] - 1.0)
    _, found = model.locate(calibrated.theta, commands, calibrated.typical(len(commands)))
    if not found.any():
        raise InputError(f"machine {calibrated.name!r}: found no pose within the range of its commands")
    return np.asarray(commands[found])
