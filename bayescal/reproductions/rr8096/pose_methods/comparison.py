"""Comparison by simulation of the two ways to find a pose from targets (RR-8096 section 3.1 and figure 5)."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import pandas as pd
from scipy.spatial.transform import Rotation

from bayescal.data.photogrammetry.line_fit import fit_line
from bayescal.data.photogrammetry.rigid_fit import RigidFit, fit_rigid_body
from bayescal.errors import InputError
from bayescal.numerics.geometry import Array, compute_pose_error

METHODS: dict[str, Callable[[Array, Array, float], RigidFit]] = {"line": fit_line, "robust": fit_rigid_body}
LARGEST_TRANSLATION = 100.0
"""Largest coordinate of a random translation, mm."""


def draw_cylinder_targets(n_targets: int, length: float, radius: float, rng: np.random.Generator) -> Array:
    """Return targets (n, 3) in mm, uniform on the side of a cylinder along z from 0 to its length."""
    angle = rng.uniform(0, 2 * np.pi, n_targets)
    return np.stack([radius * np.cos(angle), radius * np.sin(angle), rng.uniform(0, length, n_targets)], axis=-1)


def _simulate_repeat(
    n_targets: int, length: float, radius: float, noise: float, rng: np.random.Generator
) -> list[dict[str, object]]:
    """Return one row per method for one scatter of targets, one displacement and one draw of the noise."""
    reference = draw_cylinder_targets(n_targets, length, radius, rng)
    rotation = Rotation.random(rng=rng).as_matrix()
    position = rng.uniform(-LARGEST_TRANSLATION, LARGEST_TRANSLATION, 3)
    measured = position + reference @ rotation.T + noise * rng.standard_normal(reference.shape)
    barycentre = reference.mean(axis=0)
    rows: list[dict[str, object]] = []
    for method, fit_pose in METHODS.items():
        fit = fit_pose(reference, measured, noise)
        error = compute_pose_error(position, rotation, fit.position, fit.rotation)
        shift = position + rotation @ barycentre - fit.position - fit.rotation @ barycentre
        tilt = np.cross(rotation[:, 2], fit.rotation[:, 2])
        rows.append(
            {
                "method": method,
                "n_targets": n_targets,
                "position_error_mm": np.linalg.norm(shift),
                "orientation_error_deg": np.degrees(np.linalg.norm(error[3:])),
                "axis_error_deg": np.degrees(np.arctan2(np.linalg.norm(tilt), rotation[:, 2] @ fit.rotation[:, 2])),
                "whitened_squared_error": error @ np.linalg.solve(fit.covariance, error),
            }
        )
    return rows


def compare_pose_methods(
    n_targets: Sequence[int], n_repeats: int, length: float, radius: float, noise: float, rng: np.random.Generator
) -> pd.DataFrame:
    """Return the pose errors of both methods on the same simulated cylinders (RR-8096 figure 5).

    Every repeat draws new targets on the cylinder, a displacement with any rotation, and Gaussian noise on the
    displaced targets only.

    Parameters
    ----------
    n_targets : sequence of int
        Numbers of targets; RR-8096 goes from 6 to 20.
    n_repeats : int
        Repeats for each number of targets; 20 in RR-8096.
    length, radius : float
        Of the cylinder, mm; 50 and 1 in RR-8096.
    noise : float
        Standard deviation of each measured coordinate, mm; 0.005 in RR-8096.
    rng : numpy.random.Generator
        Source of all random numbers.

    Returns
    -------
    pandas.DataFrame
        Columns ``method`` (line or robust), ``n_targets``, ``repeat``, ``position_error_mm`` (error of the displaced
        barycentre, the point where both methods determine the position best), ``orientation_error_deg`` (angle of the
        whole rotation), ``axis_error_deg`` (tilt of the cylinder axis alone) and ``whitened_squared_error`` (six
        degrees of freedom, by the method's own covariance).

    Raises
    ------
    InputError
        Where there is no repeat, or the drawn targets do not determine a pose.
    """
    if n_repeats < 1:
        raise InputError(f"pose method comparison: found {n_repeats} repeats, expected at least 1")
    rows = [
        row | {"repeat": repeat}
        for n in n_targets
        for repeat in range(n_repeats)
        for row in _simulate_repeat(n, length, radius, noise, rng)
    ]
    order = ["method", "n_targets", "repeat", "position_error_mm", "orientation_error_deg", "axis_error_deg"]
    return pd.DataFrame(rows)[[*order, "whitened_squared_error"]]


def summarise_comparison(comparison: pd.DataFrame) -> pd.DataFrame:
    """Return mean and standard deviation over the repeats, one row per method and number of targets.

    Columns ``method``, ``n_targets``, and for every error column of `compare_pose_methods` the columns
    ``<error>_mean`` and ``<error>_sd``.
    """
    errors = comparison.drop(columns="repeat").groupby(["method", "n_targets"]).agg(["mean", "std"])
    errors.columns = ["_".join(column).replace("_std", "_sd") for column in errors.columns]
    return errors.reset_index()
