"""Machine and poses together by least squares: where searches for modes begin, and what a density is made about."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from bayescal.density.calibration.terms import ErrorModel
from bayescal.density.elimination import Whitening, invert, left_of
from bayescal.density.low_rank import find_coefficients, gather_columns
from bayescal.density.outliers import Outliers
from bayescal.density.posterior import Sampling
from bayescal.errors import NumericalError
from bayescal.numerics.geometry import Array

if TYPE_CHECKING:
    from bayescal.density.calibration.likelihood import CalibrationLikelihood

DAMPING, LARGEST_DAMPING = 1e-3, 1e12
GAIN = 1e-12  # of the squares, below which the search has arrived
MIN_STEP = 1e-8  # of a coordinate, below which a step that leads nowhere is the last: shorter ones lead nowhere, too
MAX_ITERATIONS = 200


@dataclass(frozen=True, eq=False)
class JointFit:
    """Machine and poses that explain readings and priors best, by Levenberg's damped steps.

    Machine, poses and coefficients move together, the latter two eliminated from each step; what is unknown of the
    errors stays as it is.
    """

    likelihood: CalibrationLikelihood
    sampling: Sampling
    errors: ErrorModel
    zeta: Array  # (k,): coordinates of the errors

    @cached_property
    def _tails(self) -> Outliers:
        return self.errors.tails(self.zeta[None])

    @cached_property
    def _signs(self) -> Array | None:
        return self.errors.signs(self.likelihood.data)

    def run(self, y: Array, pose: Array) -> tuple[Array, Array]:
        """Return the geometry's coordinates (m,) and poses (P, q), from others.

        Raises
        ------
        NumericalError
            Where the machine does not stand at the start.
        """
        zeta, damping = self.zeta[None], DAMPING
        white = self.likelihood.whiten(*self.likelihood.noise(self.errors, zeta))
        columns = self.likelihood.white_columns(self.errors, zeta, white)
        columns = gather_columns(columns) if self._signs is None else columns
        pose = np.broadcast_to(pose, (1, *pose.shape[-2:]))
        here = self._rows(y, white, pose)
        residual, cost = self._cost(y, here[0], columns)
        if not np.isfinite(cost):
            raise NumericalError("found no reading at some start")
        for _ in range(MAX_ITERATIONS):
            move, follow = self._propose(y, *here, columns[0], residual, damping)
            other, stood = y + move, pose + follow
            there = self._rows(other, white, stood)
            rest, new = self._cost(other, there[0], columns)
            if not new < cost + GAIN * max(cost, 1.0):  # the straight way of poses ends off what the machine reads
                stood = self._settle(there, rest, stood, damping)
                there = self._rows(other, white, stood)
                rest, new = self._cost(other, there[0], columns)
            done = abs(cost - new) < GAIN * max(cost, 1.0)
            if not new < cost:
                still = (done and damping <= DAMPING) or np.max(np.abs(move), initial=0.0) < MIN_STEP
                damping *= 4.0
                if still or damping > LARGEST_DAMPING:
                    break
                continue
            y, pose, here, residual, cost, damping = other, stood, there, rest, new, damping / 3.0
            if done:
                break
        return y, pose[0]

    def _rows(self, y: Array, white: Whitening, pose: Array) -> tuple[Array, Array, Array]:
        theta = self.sampling.theta_from_y(y[None])[0]
        return self.likelihood.rows(theta, self.sampling.jacobian(theta), white, pose)

    @staticmethod
    def _settle(rows: tuple[Array, Array, Array], residual: Array, pose: Array, damping: float) -> Array:
        """Return poses (1, P, q) a step on from those of some rows, by what these leave, (P, K)."""
        return np.asarray(pose + left_of(invert(rows[1], 1e-9 * damping / DAMPING), residual))

    def _cost(self, y: Array, error: Array, columns: Array) -> tuple[Array, float]:
        """Return white errors (P, K) without what the best coefficients explain, and what all squares sum up to."""
        theta = self.sampling.theta_from_y(y[None])[0]
        prior = self.sampling.prior_residual(y, theta)
        spare, tails, square = self.likelihood.n_spare, self._tails, float(prior @ prior + self.zeta @ self.zeta)
        if self.errors.has_columns:
            found = find_coefficients(error[None], columns, tails, spare, self._signs)
            error, square = found.residual[0], square + float(found.mean[0] @ (found.signs * found.mean[0]))
        total = square + float(tails.penalise(np.einsum("pk,pk->p", error, error)[None], spare).sum())
        return error, total if self.likelihood.layout.inside(theta[None])[0] else np.nan

    def _propose(
        self,
        y: Array,
        error: Array,
        slope: Array,
        by_parameters: Array,
        columns: Array,
        residual: Array,
        damping: float,
    ) -> tuple[Array, Array]:
        """Return a damped step of the coordinates (m,) and the poses' (P, q) that follows."""
        m, square = len(y), np.einsum("pk,pk->p", residual, residual)[None]
        trust = np.sqrt(self._tails.trust(square, self.likelihood.n_spare)[0])
        # a little of the damping keeps poses that readings hardly determine from running away
        stiff = invert(slope, 1e-9 * damping / DAMPING)
        left = np.eye(slope.shape[1]) - slope @ stiff
        rows = trust[:, None, None] * (left @ by_parameters)
        right = trust[:, None] * left_of(left, error)
        theta = self.sampling.theta_from_y(y[None])[0]
        prior = self.sampling.prior_slope(self.sampling.jacobian(theta))
        normal = np.einsum("pki,pkj->ij", rows, rows, optimize=True) + prior.T @ prior
        side = np.einsum("pki,pk->i", rows, right) - prior.T @ self.sampling.prior_residual(y, theta)
        acted = (trust[:, None, None] * (left @ columns)).reshape(right.size, -1)
        inner = np.diag(np.ones(acted.shape[1]) if self._signs is None else self._signs) + acted.T @ acted
        across, shown = acted.T @ rows.reshape(right.size, -1), acted.T @ right.ravel()
        normal -= across.T @ np.linalg.solve(inner, across)
        side -= across.T @ np.linalg.solve(inner, shown)
        # in prior deviations: scaled by the diagonal it would hold back the ridges, which have the smallest eigenvalues
        move = np.linalg.solve(normal + damping * np.eye(m), side)
        common = columns @ np.linalg.solve(inner, shown - across @ move)
        return move, left_of(stiff, error - by_parameters @ move - common)
