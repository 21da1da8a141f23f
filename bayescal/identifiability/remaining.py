"""How far a calibrated machine errs over its workspace, by draws of what is known of it.

The calibrated machine predicts its poses by the posterior mean of its parameters; a draw of the posterior stands for
the true one. How far the prediction errs is taken exactly in the parameters; where that is as good as its tangent by
them, the tangent takes its place. Requirements hold where no pose of the workspace exceeds a limit.

The tool of a machine is located by the readings of its own channels, whose noise comes to it.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from bayescal.density.calibration.measurements import Comparison
from bayescal.errors import NumericalError
from bayescal.identifiability.reading_rows import linearise_near, turn_tool
from bayescal.identifiability.requirements import Requirement
from bayescal.machines.readings import Given, ReadingModel, Readings
from bayescal.numerics.geometry import Array

CHUNK = 250  # draws at a time
LOOKS = 100  # draws of which it is seen whether they leave the tangent
BENT = 0.1  # of the errors' spread: off the tangent by more, draws are followed by their closures
ROUNDING = 1e-9  # mm and rad


class Remaining(ABC):
    """Poses at which a calibrated machine is to be accurate; W poses, c components of an error, S draws."""

    theta: Array
    """The calibrated machine, shape (D,)."""

    def find_largest(self, requirements: Sequence[Requirement], theta: Array) -> Array:
        """Return the largest error anywhere in the workspace, in shares of each of R limits.

        Parameters
        ----------
        requirements : sequence of Requirement
        theta : ndarray, shape (S, D)
            True machines.

        Returns
        -------
        ndarray, shape (S, R)
            Infinite for a machine that cannot take the poses.

        Raises
        ------
        NumericalError
            Where the calibrated machine cannot.
        """
        bent = self._leaves_tangent(theta[:LOOKS])
        rows = []
        for k in range(0, len(theta), CHUNK):
            part = slice(k, k + CHUNK)
            error = self.follow(theta[part]) if bent else self._project(theta[part])
            error = error + self.noise[..., part]
            of_draws = error.transpose(2, 0, 1)
            shares = np.stack([(r.take(of_draws) / r.limit).max(axis=1) for r in requirements], axis=1)
            rows.append(np.where(np.isfinite(shares), shares, np.inf))
        return np.concatenate(rows)

    @property
    @abstractmethod
    def slope(self) -> Array:
        """Error by the true machine's parameters, shape (W, c, D)."""

    @property
    @abstractmethod
    def noise(self) -> Array:
        """What errs beside the parameters: a draw each, shape (W, c, S)."""

    @abstractmethod
    def follow(self, theta: Array) -> Array:
        """Return the errors of true machines (s, D) as they are, shape (W, c, s); NaN where there is none."""

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


@dataclass(frozen=True, eq=False)
class ToolRemaining(Remaining):
    """Poses at which the tool of any machine is located by channels of its own.

    Where the true machine d stands at v, its channels read h(d, v) + ε. The calibrated one takes that for its own
    readings at v + G (h(d, v) - h(d̂, v) + ε), with G the weighted inverse of H, and its tool to be there.

    Attributes
    ----------
    model : ReadingModel
    own : ndarray of int, shape (K,)
        Which of its channels these are.
    theta : ndarray, shape (D,)
        The calibrated machine d̂.
    pose : ndarray, shape (W, q)
    given : mapping of str to ndarray, shape (W,)
    sd : ndarray, shape (S, K)
        Noise of the channels, of each draw that stands for the true machine.
    seed : int
        Of the noise: the same at every call, so that differences are not chance.
    """

    model: ReadingModel
    own: np.ndarray
    theta: Array
    pose: Array
    given: Given
    sd: Array
    seed: int

    @cached_property
    def _picked(self) -> ReadingModel:
        return self.model.pick(self.own)

    @cached_property
    def _here(self) -> Readings:
        here = linearise_near(self._picked, self.theta, self.pose, self.given)
        if not np.isfinite(here.by_pose).all():
            raise NumericalError("workspace: found poses that the calibrated machine cannot take, expected none")
        return here

    @cached_property
    def _tool(self) -> tuple[Array, Array, Array]:
        return turn_tool(self.model, self.theta, self.pose)

    @cached_property
    def _located(self) -> Array:
        """What the tool's place moves by with the readings, shape (W, c, K)."""
        white = 1.0 / np.sqrt(np.mean(self.sd**2, axis=0))
        return np.asarray(self._tool[1] @ np.linalg.pinv(white[:, None] * self._here.by_pose) * white)

    @cached_property
    def slope(self) -> Array:
        """Error of the tool's place by parameters, shape (W, c, D)."""
        return np.asarray(self._located @ self._here.by_parameters - self._tool[2])

    @cached_property
    def noise(self) -> Array:
        """What readings err by, shape (W, c, S)."""
        rng = np.random.default_rng(self.seed)
        draws = rng.standard_normal((len(self.pose), *self.sd.T.shape)) * self.sd.T
        return np.asarray(self._located @ draws)

    def follow(self, theta: Array) -> Array:
        """Return the errors of true machines (s, D), the readings as they are, shape (W, c, s)."""
        place, here = self.model.tool_values(theta, self.pose[:, None]), self._tool[0][:, None]
        moved = Comparison(self.model.tool_channels).subtract(place, here)
        return np.asarray(self._located @ self._read(theta) - np.swapaxes(moved, 1, 2))

    def _read(self, theta: Array) -> Array:
        """Return what machines (s, D) read more than the calibrated one, shape (W, K, s)."""
        picked, here = self._picked, self._here.values
        if picked.names == self.model.commanded:  # no readings of each draw where the machine has a shorter way
            return self.model.respond(theta, self.theta, self.pose, here, self.given)
        given = {name: value[:, None] for name, value in self.given.items()}
        read = picked.read(theta, self.pose[:, None], given)
        return np.swapaxes(Comparison(picked.channels).subtract(read, here[:, None]), 1, 2)


@dataclass(frozen=True, eq=False)
class Standing:
    """How R requirements stand.

    Attributes
    ----------
    largest : ndarray, shape (S, R)
        Largest error of each draw, in shares of the limits.
    """

    largest: Array

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
    old, new = np.linalg.cholesky(before), np.linalg.cholesky(after)
    return np.asarray(draws @ np.linalg.solve(old.T, new.T))
