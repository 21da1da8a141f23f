"""The shears of `coordinates` for batches: which parameters follow the actuators' directions, and how.

Arrays have the parameters first and the batch last, (D, B): there a symbol's values are rows, long and contiguous.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from bayescal.machines.models.legs import chart_of, local_directions
from bayescal.machines.parameters import ParameterLayout
from bayescal.numerics.geometry import Array

JOINT = ("a_x", "a_y", "a_z")


@dataclass(frozen=True, eq=False)
class Shears:
    """What is added to parameters that are counted from what a direction does to them.

    Attributes
    ----------
    layout : ParameterLayout
        With actuators that have directions.
    mask : ndarray of bool, shape (D,)
        Parameters that may follow.
    legs : ndarray, shape (N, 3)
        The nominal legs' lines; κ follows along those that are not level.
    along_leg : ndarray, shape (N, 3)
        Which parts of its joint the length of a leg follows.
    """

    layout: ParameterLayout
    mask: np.ndarray
    legs: Array
    along_leg: Array

    @cached_property
    def _joints(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Rows of the attachment points that follow, and the axis and leg of each, shapes (K,)."""
        rows = np.stack([self.layout.index[symbol] for symbol in JOINT])
        axis, leg = np.nonzero(self.mask[rows])
        return rows[axis, leg], axis, leg

    def _choose(self, symbol: str, which: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the rows of a symbol that follow, and their legs; none where there is no such symbol."""
        rows = self.layout.index.get(symbol)
        if rows is None:
            return np.empty(0, dtype=int), np.empty(0, dtype=int)
        legs = np.flatnonzero(which & self.mask[rows])
        return rows[legs], legs

    @cached_property
    def _gains(self) -> tuple[np.ndarray, np.ndarray]:
        return self._choose("kappa", self.legs[:, 2] == 1.0)

    @cached_property
    def _lengths(self) -> tuple[np.ndarray, np.ndarray]:
        return self._choose("l", self.along_leg.any(axis=1))

    @cached_property
    def _turns(self) -> np.ndarray:
        """Where the two components of the directions stand, shape (2, N)."""
        return np.stack([self.layout.index[symbol] for symbol in self.layout.direction_symbols])

    def apply(self, parameters: Array, sign: float) -> None:
        """Add the shears to parameters (D, B) in place, times a sign; NaN where there are no directions."""
        (joints, axis, leg), (gains, rising), (lengths, followed) = self._joints, self._gains, self._lengths
        if not (len(joints) or len(gains) or len(lengths)):
            return
        n_legs, n_batch = self._turns.shape[1], parameters.shape[1]
        direction = np.empty((3, n_legs, n_batch))
        direction[:2] = parameters[self._turns]
        chart_of(self.layout).complete(direction)
        if len(gains):
            first, second, third = direction[:, rising]
            along = self.legs[rising, :2]
            parameters[gains] += sign * (-third - (along[:, :1] * first + along[:, 1:] * second))
        if not (len(joints) or len(lengths)):
            return
        shift = parameters[self.layout.index["rho0"]] * direction
        if len(joints):
            parameters[joints] += sign * shift[axis, leg]
        if len(lengths):
            parameters[lengths] += sign * np.einsum("ik,kib->ib", self.along_leg[followed], shift[:, followed])

    def slope(self, theta: Array) -> Array:
        """Return the derivative of θ by what it is counted from, at one vector (D,), shape (D, D)."""
        (joints, axis, leg), (gains, rising), (lengths, followed) = self._joints, self._gains, self._lengths
        change = np.eye(self.layout.size)
        if not (len(joints) or len(gains) or len(lengths)):
            return change
        local, index = local_directions(self.layout, theta), self.layout.index["rho0"]
        direction, rho0 = chart_of(self.layout).to_base(local), theta[index]
        frames = chart_of(self.layout).axes
        slopes = frames[:, :2] - (local[:, :2] / local[:, 2:])[..., None] * frames[:, 2:]
        change[joints, index[leg]] -= direction[leg, axis]
        along = self.along_leg[followed]
        change[lengths, index[followed]] -= np.sum(along * direction[followed], axis=-1)
        for m, turns in enumerate(self._turns):
            change[joints, turns[leg]] -= rho0[leg] * slopes[leg, m, axis]
            change[gains, turns[rising]] += np.sum(self.legs[rising] * slopes[rising, m], axis=-1)
            if len(lengths):
                change[lengths, turns[followed]] -= rho0[followed] * np.sum(along * slopes[followed, m], axis=-1)
        return change
