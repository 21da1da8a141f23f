"""What accuracy remains: errors of the predicted pose over the workspace, and the probability to keep the limits."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Literal, NamedTuple

import numpy as np

from bayescal.density.calibration.measurements import Comparison
from bayescal.errors import NumericalError
from bayescal.identifiability.alignment import Alignment, find_alignment
from bayescal.identifiability.information import Information, root_of
from bayescal.identifiability.reading_rows import linearise_near, turn_tool
from bayescal.machines.readings import Given, ReadingModel, Readings
from bayescal.numerics.geometry import Array

DRAWS = 2000
CHUNK = 500  # a divisor of these
AT_ONCE = 250  # draws of a posterior
LOOKS = 100  # draws of which it is seen whether they leave the tangent
BENT = 0.1  # of the errors' spread: off the tangent by more, draws are followed by their closures
LEAST_VARIANCE = 1e-12  # of a variance, added where draws are moved: directions in which nothing varies
ROUNDING = 1e-9  # mm and rad
COMPONENTS = ("x", "y", "z", "rotation_x", "rotation_y", "rotation_z")
NORMS = {"position": slice(0, 3), "rotation": slice(3, 6)}


@dataclass(frozen=True)
class Requirement:
    """A limit on a component of an error, or on the length of its position or rotation part."""

    name: str  # one of the components or of `NORMS`
    limit: float  # mm or rad
    # of the errors: those of a platform's pose, or what else has to be accurate, positions first
    components: tuple[str, ...] = COMPONENTS
    # what is limited: the error at ``all_poses`` of the workspace, or its ``rms`` over them
    of: Literal["all_poses", "rms"] = "all_poses"
    part: slice | None = None  # which components a norm is of, where it is not those of `NORMS`

    @property
    def where(self) -> slice:
        """Which components are limited."""
        if self.part is not None:
            return self.part
        return NORMS.get(self.name) or slice(k := self.components.index(self.name), k + 1)

    def take(self, error: Array) -> Array:
        """Return the required quantity of errors (..., c), not negative, shape (...)."""
        part = error[..., self.where]
        return np.abs(part[..., 0]) if part.shape[-1] == 1 else np.asarray(np.linalg.norm(part, axis=-1))

    def sum_up(self, error: Array) -> float:
        """Return the required quantity of errors (W, c) over W poses: the largest, or the root mean square."""
        size = self.take(error)
        return float(size.max() if self.of == "all_poses" else np.sqrt(np.mean(size**2)))

    def variance(self, covariance: Array) -> Array:
        """Return the variance of the quantity from covariances (..., c, c), summed over a norm's parts."""
        return np.asarray(np.diagonal(covariance, axis1=-2, axis2=-1)[..., self.where].sum(axis=-1))

    def size(self, covariance: Array) -> float:
        """Return the standard deviation over W poses, largest or rms, of covariances (W, c, c)."""
        variance = self.variance(covariance)
        return float(np.sqrt(variance.max() if self.of == "all_poses" else variance.mean()))

    def keeps(self, error: Array) -> np.ndarray:
        """Return which machines keep the limit with errors (..., W, c) at W poses, shape (...)."""
        size = self.take(error)
        if self.of == "all_poses":
            return np.asarray((size <= self.limit).all(axis=-1))
        return np.asarray(np.mean(size**2, axis=-1) <= self.limit**2)


@dataclass(frozen=True)
class RequirementForecast:
    """How a requirement stands, NaN and without probability where the machine's own sensors do not determine it."""

    requirement: Requirement
    # standard deviation over the workspace before and after the calibration, mm or rad, the largest or the root
    # mean square as is required; of a length the root mean square
    prior_sd: float
    predicted_sd: float
    # that the limit is kept
    prior_probability: float
    probability: float
    # the part of ``predicted_sd`` that the geometry causes; the rest is the noise of the machine in use
    geometry_sd: float
    # the same where only the recommended parameters are calibrated and the others, though off by their
    # tolerances, are taken for nominal
    reduced_sd: float
    reduced_probability: float
    # root mean square and largest standard deviation over the workspace after the calibration
    rms_sd: float
    worst_sd: float
    worst: int  # at which of its poses that is
    everywhere: float  # probability that no pose of the workspace exceeds the limit


class ErrorsInUse(NamedTuple):
    """What K channels err by at W poses of a machine in use, in their units."""

    variance: Array  # (W, K): independent from pose to pose
    shown: Array | None  # (W, K, q): by coefficients of functions of the pose, of unit prior

    def of(self, some: np.ndarray) -> ErrorsInUse:
        """Return those of some of the channels, by a mask (K,)."""
        return ErrorsInUse(self.variance[:, some], None if self.shown is None else self.shown[:, some])


@dataclass(frozen=True, eq=False)
class WorkspaceErrorModel:
    """What errs at the workspace's poses, and how that moves with the parameters."""

    slope: Array  # (W, c, n): errors by parameters in units of the tolerances
    noise: Array  # (W, c, c): their covariance by what moves a machine in use
    # (W, c, q): errors by coefficients of functions of the pose, of unit prior, which a machine in use has too
    functions: Array | None = None

    @cached_property
    def _whole(self) -> Array:
        return self.slope if self.functions is None else np.concatenate([self.slope, self.functions], axis=-1)

    def covariance(self, geometry: Array) -> Array:
        """Return covariances (W, c, c) of errors of a covariance of the parameters in units of the tolerances.

        Of a covariance of parameters and functions together (`Information.join`) those that functions cause, too.
        """
        slope = self.slope if geometry.shape[-1] == self.slope.shape[-1] else self._whole
        return np.asarray(slope @ geometry @ np.swapaxes(slope, -1, -2))

    def effect(self, vector: Array) -> Array:
        """Return what a move along a direction (n,) does to the poses, shape (W, c)."""
        return np.asarray(self.slope @ vector)

    def judge(
        self,
        requirements: Sequence[Requirement],
        information: Information,
        rng: np.random.Generator,
        free: tuple[int, ...],
    ) -> tuple[list[RequirementForecast], float]:
        """Return how requirements stand before and after the calibration, to first order, and how probable all are.

        ``free`` are the parameters that are recommended to be freed.
        """
        if not (np.isfinite(self.slope).all() and np.isfinite(self.noise).all()):
            nan = float("nan")
            return [
                RequirementForecast(one, nan, nan, 0.0, 0.0, nan, nan, 0.0, nan, nan, 0, 0.0) for one in requirements
            ], 0.0
        identity, noise = np.eye(self._whole.shape[-1]), self.noise
        prior, after = self.covariance(identity), self.covariance(information.joint)
        geometry = self.covariance(information.covariance)
        before, _, _ = self.find_probabilities(requirements, identity, rng)
        later, everywhere, together = self.find_probabilities(requirements, root_of(information.joint).T, rng)
        errors = information.join(information.errors_of_reduced(free), free)
        reduced = self.covariance(errors)
        chances, _, _ = self.find_probabilities(requirements, root_of(errors).T, rng)
        outlooks = []
        for k, one in enumerate(requirements):
            variance = one.variance(after + noise)
            outlooks.append(
                RequirementForecast(
                    one,
                    one.size(prior + noise),
                    one.size(after + noise),
                    float(before[k]),
                    float(later[k]),
                    min(one.size(geometry), one.size(after + noise)),  # errors of a model may take a part of it back
                    one.size(reduced + noise),
                    float(chances[k]),
                    float(np.sqrt(variance.mean())),
                    float(np.sqrt(variance.max())),
                    int(variance.argmax()),
                    float(everywhere[k]),
                )
            )
        return outlooks, together

    def find_probabilities(
        self, requirements: Sequence[Requirement], root: Array, rng: np.random.Generator
    ) -> tuple[Array, Array, float]:
        """Return the shares of draws that keep each limit, of those that keep it at every pose, and that keep all."""
        good, everywhere, together = np.zeros(len(requirements)), np.zeros(len(requirements)), 0
        for error in draw_errors(self._whole @ root, np.swapaxes(root_of(self.noise), -1, -2), rng):
            kept = np.array([one.keeps(error) for one in requirements]).reshape(len(requirements), len(error))
            good += kept.sum(axis=1)
            everywhere += [np.sum((one.take(error) <= one.limit).all(axis=1)) for one in requirements]
            together += int(kept.all(axis=0).sum())
        return good / DRAWS, everywhere / DRAWS, together / DRAWS


def forecast_tool(
    whole: Array, located: Array, errors: ErrorsInUse, alignment: Alignment | None = None
) -> WorkspaceErrorModel:
    """Return how a tool errs that is located by readings, once base and tool are aligned if they are.

    It errs by parameters in units of the tolerances, ``whole`` (W, c, n) without alignment, and readings move the place
    where it is taken to be, ``located`` (W, c, K).
    """
    noise = located * errors.variance[:, None, :] @ np.swapaxes(located, -1, -2)
    moved = None if errors.shown is None else -located @ errors.shown
    if alignment is None:
        return WorkspaceErrorModel(whole, noise, moved)
    return WorkspaceErrorModel(alignment.remove(whole), noise, None if moved is None else alignment.remove(moved))


def draw_errors(slope: Array, noise_root: Array, rng: np.random.Generator) -> Iterator[Array]:
    """Yield the errors of `DRAWS` machines at W poses, with noise, in parts of shape (`CHUNK`, W, t).

    ``slope`` (W, t, n) is what n standard normal numbers of each machine make of the errors at the poses,
    ``noise_root`` (W, t, k) what k of each machine and pose make of the noise.
    """
    flat = slope.reshape(-1, slope.shape[-1])
    for _ in range(DRAWS // CHUNK):
        error = (flat @ rng.standard_normal((slope.shape[-1], CHUNK))).T.reshape(CHUNK, *slope.shape[:2])
        error += np.einsum("wij,bwj->bwi", noise_root, rng.standard_normal((*error.shape[:2], noise_root.shape[-1])))
        yield error


def find_limits(requirements: Sequence[Requirement], slope: Array) -> Array:
    """Return limits of the components of an error, mm and rad, shape (c,); infinite where nothing is required.

    A limit on a length holds for each of its components, where they have no smaller one. Without any requirement they
    are the root mean square errors over the workspace before any measurement, so that all count alike: ``slope`` (W, c,
    L) is what has to be accurate at its poses, by the parameters in units of the tolerances.
    """
    limits = np.full(slope.shape[1], np.inf)
    for requirement in requirements:
        limits[requirement.where] = np.minimum(limits[requirement.where], requirement.limit)
    if np.isfinite(limits).any():
        return limits
    before = np.sqrt(np.mean(np.sum(slope**2, axis=-1), axis=0))
    return np.where(before > 0.0, before, np.inf)


# --- errors by draws of the posterior ---------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class ToolRemaining:
    """W poses at which the tool of any calibrated machine is located by channels of its own; c components of its error.

    It predicts its poses by the posterior mean of its parameters; a draw of the posterior stands for the true machine.
    How far the prediction errs is taken exactly in the parameters; where that is as good as its tangent by them, the
    tangent takes its place. Requirements hold where no pose of the workspace exceeds a limit.

    Where the true machine d stands at v, its channels read h(d, v) + Φ c + ε. The calibrated one takes that for its own
    readings at v + G (h(d, v) - h(d̂, v) + Φ c + ε), with G the weighted inverse of H, and its tool to be there. Of
    these errors those that motions of base and tool explain are none, where these are aligned.
    """

    model: ReadingModel
    own: np.ndarray  # (K,), int: which of its channels these are
    theta: Array  # (D,): the calibrated machine d̂
    pose: Array  # (W, q)
    given: Given  # (W,) each
    # (S, K), or (W, S, K): noise of the channels, of each draw that stands for the true machine
    sd: Array
    seed: int  # of the noise: the same at every call, so that differences are not chance
    shown: Array | None = None  # (W, K, A): Φ, what coefficients of errors that are functions do to the channels
    aligned: bool = False  # whether base and tool are

    def find_largest(
        self, requirements: Sequence[Requirement], theta: Array, coefficients: Array | None = None
    ) -> Array:
        """Return the largest error anywhere in the workspace of true machines (S, D), in shares of R limits, (S, R).

        Infinite for a machine that cannot take the poses; NumericalError where the calibrated one cannot.
        ``coefficients`` (S, A): by how much those of its functions differ from what was found.
        """
        bent = self._leaves_tangent(theta[:LOOKS])
        rows = []
        for k in range(0, len(theta), AT_ONCE):
            part = slice(k, k + AT_ONCE)
            error = self.follow(theta[part]) if bent else self._project(theta[part])
            if coefficients is not None and self.by_functions is not None:
                error = error + self.by_functions @ coefficients[part].T
            error = error + self.noise[..., part]
            of_draws = error.transpose(2, 0, 1)
            shares = np.stack([(r.take(of_draws) / r.limit).max(axis=1) for r in requirements], axis=1)
            rows.append(np.where(np.isfinite(shares), shares, np.inf))
        return np.concatenate(rows)

    @cached_property
    def _picked(self) -> ReadingModel:
        return self.model.pick(self.own)

    @cached_property
    def _here(self) -> Readings:
        here = linearise_near(self._picked, self.theta, self.pose, self.given)
        if not np.isfinite(here.by_pose).all():
            raise NumericalError("workspace: found poses out of the calibrated machine's reach")
        return here

    @cached_property
    def _tool(self) -> tuple[Array, Array, Array]:
        return turn_tool(self.model, self.theta, self.pose)

    @cached_property
    def _located(self) -> Array:
        """What the tool's place moves by with the readings, shape (W, c, K)."""
        white = 1.0 / np.sqrt(np.mean(self.sd**2, axis=tuple(range(self.sd.ndim - 1))))
        return np.asarray(self._tool[1] @ np.linalg.pinv(white[:, None] * self._here.by_pose) * white)

    @cached_property
    def _alignment(self) -> Alignment | None:
        return find_alignment(self.model, self._tool[0], self.pose) if self.aligned else None

    def _align(self, error: Array) -> Array:
        return error if self._alignment is None else self._alignment.remove(error)

    @cached_property
    def slope(self) -> Array:
        """Error of the tool's place by parameters, shape (W, c, D)."""
        return self._align(np.asarray(self._located @ self._here.by_parameters - self._tool[2]))

    @cached_property
    def by_functions(self) -> Array | None:
        """The same by coefficients of functions, shape (W, c, A)."""
        return None if self.shown is None else self._align(np.asarray(self._located @ self.shown))

    @cached_property
    def noise(self) -> Array:
        """What readings err by, a draw each, shape (W, c, S)."""
        rng = np.random.default_rng(self.seed)
        draws = rng.standard_normal((len(self.pose), *self.sd.shape[:-3:-1])) * np.swapaxes(self.sd, -1, -2)
        return np.asarray(self._located @ draws)

    def follow(self, theta: Array) -> Array:
        """Return the errors of true machines (s, D), the readings as they are, shape (W, c, s); NaN where none is."""
        place, here = self.model.tool_values(theta, self.pose[:, None]), self._tool[0][:, None]
        moved = Comparison(self.model.tool_channels).subtract(place, here)
        return self._align(np.asarray(self._located @ self._read(theta) - np.swapaxes(moved, 1, 2)))

    def _project(self, theta: Array) -> Array:
        """Return the errors of machines (s, D) by their tangent, shape (W, c, s)."""
        flat = self.slope.reshape(-1, self.slope.shape[-1])
        return np.asarray((flat @ (theta - self.theta).T).reshape(*self.slope.shape[:2], len(theta)))

    def _leaves_tangent(self, theta: Array) -> bool:
        """Return whether machines (s, D) err otherwise than their tangent says."""
        followed = self.follow(theta)
        off, spread = (
            np.sqrt(np.mean(error**2, axis=-1)).max(axis=0) for error in (followed - self._project(theta), followed)
        )
        return not bool(np.all(off <= BENT * spread + ROUNDING))

    def _read(self, theta: Array) -> Array:
        """Return what machines (s, D) read more than the calibrated one, shape (W, K, s)."""
        picked, here = self._picked, self._here.values
        if picked.names == self.model.commanded:  # no readings of each draw where the machine has a shorter way
            return self.model.respond(theta, self.theta, self.pose, here, self.given)
        given = {name: value[:, None] for name, value in self.given.items()}
        read = picked.read(theta, self.pose[:, None], given)
        return np.swapaxes(Comparison(picked.channels).subtract(read, here[:, None]), 1, 2)


@dataclass(frozen=True, eq=False)
class RequirementSummary:
    """How R requirements stand."""

    largest: Array  # (S, R): largest error of each draw, in shares of the limits

    @property
    def probability(self) -> float:
        """That all of them hold."""
        return float(np.mean((self.largest <= 1.0).all(axis=1)))

    @property
    def standard_error(self) -> float:
        """Of the probability, by the number of draws."""
        p = self.probability
        return float(np.sqrt(p * (1.0 - p) / len(self.largest)))

    @property
    def probabilities(self) -> Array:
        """That each of them holds, shape (R,)."""
        return np.asarray(np.mean(self.largest <= 1.0, axis=0))

    def bound(self, probability: float) -> Array:
        """Return the errors in shares of the limits that are kept everywhere with a probability, shape (R,)."""
        return np.asarray(np.quantile(self.largest, probability, axis=0, method="higher"))


def move_draws(draws: Array, before: Array, after: Array) -> Array:
    """Return draws (S, n) about zero with a covariance (n, n) taken to another one, the same normal numbers in both."""
    size = np.sqrt(np.maximum(np.diagonal(before), np.finfo(float).tiny))
    least = LEAST_VARIANCE * np.eye(len(size))
    old, new = (np.linalg.cholesky(one / np.outer(size, size) + least) for one in (before, after))
    return np.asarray(size * ((draws / size) @ np.linalg.solve(old.T, new.T)))
