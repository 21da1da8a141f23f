"""Derivatives of readings at poses of one machine, the poses eliminated: what any channels determine, to first order.

The white readings s = h(v, d) of a pose v have the derivatives H by the pose and A by the posterior's coordinates of
the parameters d. Whatever the pose, R = A - H H⁺ A is left of A: what readings there say of the parameters. A tool that
is located by these channels errs by its own derivative less that which the estimate of the pose takes up.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from bayescal.density.calibration.likelihood import CalibrationPosterior
from bayescal.density.calibration.measurements import Comparison
from bayescal.identifiability.alignment import Alignment, find_alignment
from bayescal.machines.readings import Given, ReadingModel, Readings
from bayescal.numerics.geometry import Array


@dataclass(frozen=True, eq=False)
class LinearisedPoses:
    """Poses (W, q) seen by some channels at one machine, to first order; those where it cannot stand are left out.

    ``rows`` (W, K, m): white derivative of the readings by the coordinates of the posterior, poses eliminated;
    ``whole`` (W, t, m): what the tool's place, as located with these channels, errs by them, before base and tool are
    aligned; ``noise`` (W, t): its variance, that of ``located`` (W, t, K), how white readings move it; ``alignment`` as
    of `Jacobians`.
    """

    pose: Array
    rows: Array
    whole: Array
    noise: Array
    located: Array
    alignment: Alignment | None

    @cached_property
    def tool(self) -> Array:
        """What the tool's place errs by the coordinates of the posterior after any alignment, (W, t, m)."""
        return self.align(self.whole)

    def align(self, error: Array) -> Array:
        """Return errors (W, t, m) of the tool after any alignment."""
        return error if self.alignment is None else self.alignment.remove(error)

    def unalign(self) -> LinearisedPoses:
        """Return the same without any alignment."""
        return replace(self, alignment=None)


@dataclass(frozen=True, eq=False)
class Jacobians:
    """Derivatives at poses (W, q) of one machine, ``places`` (W,) of those that were asked for.

    ``noise`` (K, K), or (W, K, K) pose by pose: its covariance, zero of channels without any; ``by_pose`` (W, K, q) and
    ``by_parameters`` (W, K, D) of the readings, ``tool_by_pose`` (W, t, q) and ``tool_by_parameters`` (W, t, D) of the
    tool; ``moves`` (m, D): what the posterior's coordinates move; ``half`` (q,): half widths of the workspace;
    ``alignment`` of base and tool, which mends errors of the tool, or None.
    """

    pose: Array
    noise: Array
    by_pose: Array
    by_parameters: Array
    tool_by_pose: Array
    tool_by_parameters: Array
    moves: Array
    half: Array
    places: np.ndarray
    alignment: Alignment | None = None

    @cached_property
    def seen(self) -> Array:
        """Derivatives of the readings by the posterior's coordinates, (W, K, m)."""
        return self.by_parameters @ self.moves.T

    @cached_property
    def _tool_seen(self) -> Array:
        return self.tool_by_parameters @ self.moves.T

    def mislocate(self, located: Array, seen: Array) -> Array:
        """Return what the tool errs by the posterior's coordinates, (W, t, m), before base and tool are aligned.

        It is located by derivatives (W, t, k) from readings with the derivatives (W, k, m) by these coordinates.
        """
        return np.asarray(self._tool_seen - located @ seen)

    @property
    def white(self) -> Array:
        """One over the noise of each channel, (K,); zero where it has none."""
        variance = np.diagonal(self.noise)
        return np.sqrt(np.divide(1.0, variance, out=np.zeros(len(variance)), where=variance > 0.0))

    def select_channels(self, some: np.ndarray) -> LinearisedPoses:
        """Return the poses seen by the channels of a mask (K,)."""
        white = whiten(self.noise, some)
        slope, seen = white @ self.by_pose, white @ self.seen
        gain = np.linalg.pinv(slope)
        told = np.linalg.matrix_rank(slope * self.half) == slope.shape[-1]
        rows = seen - slope @ (gain @ seen)
        located = self.tool_by_pose @ gain
        whole = self.mislocate(located, seen)
        unknown = ~told[:, None]
        noise = np.where(unknown, np.nan, (located**2).sum(axis=-1))
        return LinearisedPoses(
            self.pose, rows, np.where(unknown[..., None], np.nan, whole), noise, located, self.alignment
        )


def differentiate_poses(
    posterior: CalibrationPosterior, half: Array, y: Array, pose: Array, given: Given, aligned: bool = False
) -> Jacobians:
    """Return the Jacobians at poses (W, q) of one machine y (n,), of which any channels make `LinearisedPoses`.

    ``half`` (q,) are half widths of the workspace; with ``aligned`` errors of the tool are those that remain after base
    and tool were aligned over these poses.
    """
    theta, model = posterior.theta(y[None])[0], posterior.likelihood.model
    moves, noise = posterior.around(y)[1].T, typical_covariance(posterior, y)
    return differentiate(model, theta, moves, noise, half, pose, given, aligned)


def differentiate(
    model: ReadingModel,
    theta: Array,
    moves: Array,
    noise: Array,
    half: Array,
    pose: Array,
    given: Given,
    aligned: bool = False,
) -> Jacobians:
    """Return the same of a machine (D,) whose coordinates move it by (m, D), with a covariance of its channels."""
    here = linearise_near(model, theta, pose, given)
    good = np.isfinite(here.by_pose).all(axis=(1, 2)) & np.isfinite(here.by_parameters).all(axis=(1, 2))
    pose = pose[good]
    place, by_pose, direct = turn_tool(model, theta, pose)
    alignment = find_alignment(model, place, pose) if aligned else None
    here = Readings(here.values[good], here.by_pose[good], here.by_parameters[good])
    places = np.flatnonzero(good)
    return Jacobians(pose, noise, here.by_pose, here.by_parameters, by_pose, direct, moves, half, places, alignment)


def linearise_near(model: ReadingModel, theta: Array, pose: Array, given: Given) -> Readings:
    """Return readings (W, K) and their derivatives, those of a rotation as it turns in the base's frame."""
    here, comparison = model.linearise(theta, pose, True, given), Comparison(model.channels)
    if not comparison.rotations:
        return here
    slopes = (comparison.pull_back(0.0 * here.values, here.values, one) for one in (here.by_pose, here.by_parameters))
    return Readings(here.values, *slopes)


def turn_tool(model: ReadingModel, theta: Array, pose: Array) -> tuple[Array, Array, Array]:
    """Return the tool and its derivatives at poses (W, q), those of a rotation as it turns in the base's frame."""
    (place, *slopes), comparison = model.tool(theta, pose), Comparison(model.tool_channels)
    by_pose, by_parameters = (comparison.pull_back(np.zeros_like(place), place, one) for one in slopes)
    return place, by_pose, by_parameters


def whiten(noise: Array, some: np.ndarray) -> Array:
    """Return what makes readings white, of covariances (..., K, K), from the channels of a mask (K,) with noise."""
    variance = np.diagonal(noise, axis1=-2, axis2=-1).reshape(-1, len(some))
    place = np.flatnonzero(some & (variance > 0.0).all(axis=0))
    there = (..., place[:, None], place)
    white = np.zeros_like(noise)
    white[there] = np.linalg.inv(np.linalg.cholesky(noise[there]))
    return white


def typical_covariance(posterior: CalibrationPosterior, y: Array, own: bool = False) -> Array:
    """Return the covariance (K, K) of the channels, medians and mean correlations at y (n,); zero without noise.

    With ``own`` only of the sensors' noise.
    """
    sd, stated = np.nan_to_num(typical_noise(posterior, y[None], own)[0]), posterior.likelihood.data.correlation
    if stated is None:
        return np.diag(sd**2)
    alone = np.nan_to_num(typical_noise(posterior, y[None], own=True)[0])
    covariance = stated.mean(axis=0) * np.outer(*[np.where(sd > 0.0, alone, 0.0)] * 2)
    covariance[np.diag_indices_from(covariance)] = sd**2
    return covariance


def typical_noise(posterior: CalibrationPosterior, y: Array, own: bool = False) -> Array:
    """Return the noise of each channel, the median of its readings, (S, n) to (S, K); NaN where it has none.

    Errors that are functions count as large as they are at the rows, root mean square. With ``own`` only the sensors'.
    """
    stated, tau = posterior.likelihood.noise(posterior.errors, posterior.zeta(y))
    present, tau = posterior.likelihood.data.present, np.sqrt(tau**2 + _spread_common(posterior, y)[:, None])
    result = np.full((len(y), present.shape[1]), np.nan)
    for k in np.flatnonzero(present.any(axis=0)):
        every = np.sqrt(stated[..., k] ** 2 + (0.0 if own else tau[..., k] ** 2))
        result[:, k] = np.median(every[:, present[:, k]], axis=1)
    return result


def _spread_common(posterior: CalibrationPosterior, y: Array) -> Array:
    """Return the mean variance over the rows of errors common to all of them, (S, n) to (S, K)."""
    likelihood, errors = posterior.likelihood, posterior.errors
    if not errors.has_columns:
        return np.zeros((len(y), likelihood.sd.shape[1]))
    acts = errors.list_acts(likelihood.data, likelihood.error_gain)
    if acts:
        square = np.stack([(one**2).sum(axis=-1).mean(axis=0) for one in acts])
        return np.maximum(errors.weights(posterior.zeta(y)) @ square, 0.0)
    columns = (errors.columns(zeta[None], likelihood.data, likelihood.error_gain)[0] for zeta in posterior.zeta(y))
    return np.stack([(one**2).sum(axis=-1).mean(axis=0) for one in columns])


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
    """Return the white derivative of the readings by the parameters, poses eliminated, (P, K, m).

    Each parameter is by itself, in units in which it is standard normal under the prior.
    """
    white, stand = posterior.likelihood.explain(*posterior.at(y[None]))
    theta = posterior.theta(y[None])[0]
    change = replace(posterior, likelihood=posterior.likelihood.plain).sampling.jacobian(theta)
    _, slope, by_parameters = posterior.likelihood.rows(theta, change, white, stand.pose)
    inverse = np.linalg.pinv(np.nan_to_num(slope))  # rows stay NaN where the machine cannot stand
    return np.asarray(by_parameters - slope @ (inverse @ by_parameters))
