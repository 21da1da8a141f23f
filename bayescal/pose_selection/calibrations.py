"""Simulated calibrations with a set of poses: machines drawn from the priors, measured, and identified one by one.

Each machine stands where the actuator positions of the poses take it; those of redundant legs, which then contradict
each other, read what holds it. It is identified by least squares: the poses that sensors see, less those that it would
take for what its actuators read, in units of what sensors, actuators and model err by. Rows that redundant legs leave,
and those of the priors, stand beside. Noise is drawn in these rows, where it is white; their weights are taken once, at
the machine as expected.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares

from bayescal.errors import InputError
from bayescal.identifiability.reading_rows import whiten
from bayescal.numerics.geometry import (
    DEGREES_OF_FREEDOM,
    Array,
    compute_left_inverse_jacobian,
    compute_pose_error,
    matrix_from_rotation_vector,
)
from bayescal.pose_selection.design import Design, SeenPoses

ROUNDS = 20  # of machines that are drawn again
TOLERANCE = 1e-5  # of the sum of squares, by which the last step may lower it
MAX_EVALUATIONS = 60  # where data hardly determine a direction, squares fall ever more slowly along it


@dataclass(frozen=True, eq=False)
class IdentifiedMachines:
    """Machines of n parameters that were drawn, B' of which can be identified from where the machine is expected."""

    # (B', n) each: off the machine as expected, in units of the tolerances
    truth: Array
    estimate: Array

    @property
    def errors(self) -> Array:
        """Estimate minus truth, shape (B', n)."""
        return self.estimate - self.truth


def simulate_calibrations(seen: SeenPoses, n: int, rng: np.random.Generator, weight: float = 1.0) -> IdentifiedMachines:
    """Return calibrations of n machines drawn from the priors; without those that the machine as expected cannot fit.

    The identification has a weight on the precision of the priors. InputError where too few draws of these are machines
    that can take the poses.
    """
    truth = rng.standard_normal((n, len(seen.design.sd)))
    stand = [_place(seen, y, rng) for y in truth]
    n_poses, n_legs = seen.placed.actuators.shape
    noise = rng.standard_normal((n, n_poses, DEGREES_OF_FREEDOM + bool(seen.n_redundant) * n_legs))
    estimate = np.stack([_LeastSquares(seen, *at, own, weight).solve() for at, own in zip(stand, noise, strict=True)])
    good = np.isfinite(estimate).all(axis=1)
    return IdentifiedMachines(truth[good], estimate[good])


def compute_workspace_errors(design: Design, found: IdentifiedMachines, actuators: Array) -> Array:
    """Return true less predicted poses at actuator positions (W, N), shape (B', W, 6), mm and rad.

    They are those that the machines take; NaN where one of both has none.
    """
    poses = []
    for y in (found.truth, found.estimate):
        pose, _ = design.readings.locate((design.theta + y @ design.moves)[:, None], actuators)
        poses += [pose[..., :3], matrix_from_rotation_vector(np.nan_to_num(pose[..., 3:]))]
    return np.asarray(compute_pose_error(*poses))


def _place(seen: SeenPoses, y: Array, rng: np.random.Generator) -> tuple[Array, Array]:
    """Return where a machine (n,) stands, (P, 6), and what it reads there, (P, N); drawn again where it cannot."""
    design, layout = seen.design, seen.design.machine.layout
    for _ in range(ROUNDS):
        theta = design.theta + y @ design.moves
        pose, found = design.readings.locate(theta, seen.placed.actuators)
        commands = design.readings.read(theta, pose)
        if found.all() and np.isfinite(commands).all() and layout.inside(theta):
            return pose, commands
        y[:] = rng.standard_normal(len(y))
    raise InputError("tolerances: planned poses out of reach, expected smaller ones")


class _LeastSquares:
    """The squares of one machine, and their derivatives: sensors, redundant legs, priors."""

    def __init__(self, seen: SeenPoses, pose: Array, commands: Array, noise: Array, weight: float) -> None:
        self.seen, self.commands, self.noise = seen, commands, noise
        self.stands = pose[:, :3], matrix_from_rotation_vector(pose[:, 3:])
        self.prior = np.sqrt(weight) * np.eye(len(seen.design.sd))
        self.white = whiten(seen.slopes.noise, np.ones(commands.shape[-1], dtype=bool))
        self._at: tuple[Array, Array, Array] | None = None

    def solve(self) -> Array:
        """Return where the squares are least, or have fallen to, shape (n,); NaN where there are none at the start."""
        start = np.zeros(len(self.prior))
        if not np.isfinite(self._evaluate(start)[0]).all():
            return np.full_like(start, np.nan)
        found: Array = least_squares(
            lambda y: np.nan_to_num(self._evaluate(y)[0], nan=np.inf),
            start,
            lambda y: self._evaluate(y)[1],
            ftol=TOLERANCE,
            xtol=None,
            gtol=None,
            max_nfev=MAX_EVALUATIONS,
        ).x
        return found

    def _evaluate(self, y: Array) -> tuple[Array, Array]:
        """Return white residuals (R,) of a machine (n,), NaN where it is none, and their derivatives (R, n)."""
        if self._at is None or not np.array_equal(y, self._at[0]):
            self._at = (y.copy(), *self._find(y))
        return self._at[1:]

    def _find(self, y: Array) -> tuple[Array, Array]:
        seen, design, n = self.seen, self.seen.design, len(self.prior)
        theta = design.theta + y @ design.moves
        pose, found = design.readings.locate(theta, self.commands)
        here = design.differentiate(theta, np.where(found[:, None], pose, 0.0), seen.slopes.noise)
        if not (found.all() and len(here.places) == len(pose) and design.machine.layout.inside(theta)):
            return np.full(self.noise.size + n, np.nan), np.zeros((self.noise.size + n, n))
        view = here.select_channels(np.ones(self.commands.shape[1], dtype=bool))
        error = compute_pose_error(pose[:, :3], matrix_from_rotation_vector(pose[:, 3:]), *self.stands)
        slope = view.tool.copy()
        slope[:, 3:] = compute_left_inverse_jacobian(error[:, 3:]) @ slope[:, 3:]
        residual, rows = (seen.root @ error[..., None])[..., 0], seen.root @ slope
        if seen.n_redundant:
            beside = (self.white @ (design.readings.read(theta, pose) - self.commands)[..., None])[..., 0]
            residual, rows = np.concatenate([residual, beside], axis=1), np.concatenate([rows, view.rows], axis=1)
        squares = np.append((residual + self.noise).ravel(), self.prior @ y)
        return squares, np.concatenate([rows.reshape(-1, n), self.prior])
