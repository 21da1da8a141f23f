"""Derivatives of readings at poses of one machine, the poses eliminated: what any channels determine, to first order.

The white readings s = h(v, d) of a pose v have the derivatives H by the pose and A by the posterior's coordinates of
the parameters d. Whatever the pose, R = A - H H⁺ A is left of A: what readings there say of the parameters. A tool that
is located by these channels errs by its own derivative less that which the estimate of the pose takes up.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from bayescal.density.calibration.likelihood import CalibrationPosterior
from bayescal.density.calibration.measurements import Comparison
from bayescal.machines.readings import Given, ReadingModel, Readings
from bayescal.numerics.geometry import Array


@dataclass(frozen=True, eq=False)
class View:
    """Poses (W, q) seen by some channels at one machine, to first order; those where it cannot stand are left out.

    ``rows`` (W, K, m): white derivative of the readings by the coordinates of the posterior, poses eliminated; ``tool``
    (W, t, m): what the tool's place, as located with these channels, errs by them; ``noise`` (W, t): its variance, that
    of ``located`` (W, t, K), how white readings move it.
    """

    pose: Array
    rows: Array
    tool: Array
    noise: Array
    located: Array


@dataclass(frozen=True, eq=False)
class Slopes:
    """Derivatives at poses (W, q) of one machine, ``places`` (W,) of those that were asked for.

    ``white`` (K,): one over the noise of each channel; ``by_pose`` (W, K, q) and ``by_parameters`` (W, K, D) of the
    readings, ``tool_by_pose`` (W, t, q) and ``tool_by_parameters`` (W, t, D) of the tool; ``moves`` (m, D): what the
    posterior's coordinates move; ``half`` (q,): half widths of the workspace.
    """

    pose: Array
    white: Array
    by_pose: Array
    by_parameters: Array
    tool_by_pose: Array
    tool_by_parameters: Array
    moves: Array
    half: Array
    places: np.ndarray

    @cached_property
    def seen(self) -> Array:
        """Derivatives of the readings by the posterior's coordinates, (W, K, m)."""
        return self.by_parameters @ self.moves.T

    @cached_property
    def tool_seen(self) -> Array:
        """Derivatives of the tool by the same, (W, t, m)."""
        return self.tool_by_parameters @ self.moves.T

    def seen_by(self, some: np.ndarray) -> View:
        """Return the poses seen by the channels of a mask (K,)."""
        white = np.where(some, self.white, 0.0)[:, None]
        slope, seen = white * self.by_pose, white * self.seen
        gain = np.linalg.pinv(slope)
        told = np.linalg.matrix_rank(slope * self.half) == slope.shape[-1]
        rows = seen - slope @ (gain @ seen)
        located = self.tool_by_pose @ gain
        tool = self.tool_seen - self.tool_by_pose @ (gain @ seen)
        unknown = ~told[:, None]
        noise = np.where(unknown, np.nan, (located**2).sum(axis=-1))
        return View(self.pose, rows, np.where(unknown[..., None], np.nan, tool), noise, located)


def differentiate_poses(posterior: CalibrationPosterior, half: Array, y: Array, pose: Array, given: Given) -> Slopes:
    """Return what moves readings and tool at poses (W, q) of one machine, of which any channels make a `View`.

    Parameters
    ----------
    posterior : CalibrationPosterior
    half : ndarray, shape (q,)
        Half widths of the workspace.
    y : ndarray, shape (n,)
        The machine and its noise, in the posterior's coordinates.
    pose : ndarray, shape (W, q)
    given : mapping of str to ndarray, shape (W,)
    """
    theta, model = posterior.theta(y[None])[0], posterior.likelihood.model
    here = linearise_near(model, theta, pose, given)
    good = np.isfinite(here.by_pose).all(axis=(1, 2)) & np.isfinite(here.by_parameters).all(axis=(1, 2))
    pose = pose[good]
    _, by_pose, direct = model.tool(theta, pose)
    white = typical_white(posterior, y)
    here = Readings(here.values[good], here.by_pose[good], here.by_parameters[good])
    moves, places = posterior.around(y)[1].T, np.flatnonzero(good)
    return Slopes(pose, white, here.by_pose, here.by_parameters, by_pose, direct, moves, half, places)


def linearise_near(model: ReadingModel, theta: Array, pose: Array, given: Given) -> Readings:
    """Return readings (W, K) and their derivatives, those of a rotation as it turns in the base's frame."""
    here, comparison = model.linearise(theta, pose, True, given), Comparison(model.channels)
    if not comparison.rotations:
        return here
    slopes = (comparison.pull_back(0.0 * here.values, here.values, one) for one in (here.by_pose, here.by_parameters))
    return Readings(here.values, *slopes)


def typical_white(posterior: CalibrationPosterior, y: Array) -> Array:
    """Return one over the noise of each channel, the median of its readings, (K,); zero where it has none."""
    sd = typical_noise(posterior, y[None])[0]
    return np.where(np.isfinite(sd), 1.0 / sd, 0.0)


def typical_noise(posterior: CalibrationPosterior, y: Array) -> Array:
    """Return the noise of each channel, the median of its readings, (S, n) to (S, K); NaN where it has none."""
    own, tau = posterior.likelihood.noise(posterior.errors, posterior.zeta(y))
    present = posterior.likelihood.data.present
    result = np.full((len(y), present.shape[1]), np.nan)
    for k in np.flatnonzero(present.any(axis=0)):
        result[:, k] = np.median(np.sqrt(own[..., k] ** 2 + tau[..., k] ** 2)[:, present[:, k]], axis=1)
    return result


def typical_given(given: Given, n: int) -> dict[str, Array]:
    """Return n times the medians of what was known of each pose."""
    return {name: np.full(n, np.median(value)) for name, value in given.items()}


def rms(tool: Array, covariance: Array) -> Array:
    """Return the root mean square over poses of what parameters of a covariance leave unknown of the tool, (t,)."""
    return np.sqrt(np.einsum("wti,ij,wtj->wt", tool, covariance, tool, optimize=True).mean(axis=0))


def name_tool(model: ReadingModel) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return names and units of the tool's numbers, which have to be accurate."""
    return tuple(one.name for one in model.tool_channels), tuple(one.unit for one in model.tool_channels)


def see(posterior: CalibrationPosterior, y: Array) -> Array:
    """Return the white derivative of the readings by the parameters' coordinates, poses eliminated, (P, K, m)."""
    white, stand = posterior.likelihood.explain(*posterior.at(y[None]))
    error, slope, by_parameters = posterior.likelihood.rows(*posterior.around(y), white, stand.pose)
    del error
    return np.asarray(by_parameters - slope @ (np.linalg.pinv(slope) @ by_parameters))
