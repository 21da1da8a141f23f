"""What an instrument has to supply: its readings as rows that compare with the poses it should have seen.

A pose is seen from S stations, each with a frame of its own against the base, through a tool on the platform: station s
sees T_s = T_base,s T_platform T_tool. The rows of a pose are residuals, read minus expected, whose noise is normal with
a known covariance. Poses may have fewer rows than others: rows beyond them are zero, with a unit variance that belongs
to nothing.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Any, Self

import numpy as np

from bayescal.data.measured_poses import MeasuredPoses
from bayescal.numerics.geometry import Array


@dataclass(frozen=True, eq=False)
class Rows:
    """Readings of P poses in at most K rows, as the likelihood takes them.

    Attributes
    ----------
    covariance : ndarray, shape (P, K, K)
        Of the rows' noise; unit where a pose has no row.
    log_constant : ndarray, shape (P,)
        What the log-density has besides the rows' square and log-determinant.
    to_pose : ndarray, shape (P, 6, K)
        From rows to the pose error as seen, measured minus expected, mm and rad; zero rows where it is not measured.
    measured : ndarray of bool, shape (P, 6)
        Which coordinates of the pose error the rows determine.
    count : ndarray of int, shape (P,)
        How many rows each pose has.
    """

    covariance: Array
    log_constant: Array
    to_pose: Array
    measured: np.ndarray
    count: np.ndarray

    def select(self, chosen: np.ndarray) -> Rows:
        """Return the rows of some poses."""
        return Rows(**{name: value[chosen] for name, value in vars(self).items()})


class Instrument(ABC):
    """Readings of an instrument at P poses.

    Attributes
    ----------
    names : tuple of str
        Of the P poses.
    actuators : ndarray, shape (P, N)
        Actuator positions, mm.
    rows : Rows
    """

    names: tuple[str, ...]
    actuators: Array
    rows: Rows

    @property
    def n_poses(self) -> int:
        """Number of poses P."""
        return len(self.names)

    @property
    @abstractmethod
    def n_stations(self) -> int:
        """Number of stations S, each with a frame of its own."""

    @property
    @abstractmethod
    def poses(self) -> MeasuredPoses:
        """The poses as read, base frame, all frames as they should be; NaN where a pose is not determined."""

    @abstractmethod
    def residuals(self, position: Array, rotation: Array) -> Array:
        """Return read minus expected rows, shape (..., P, K).

        Parameters
        ----------
        position, rotation : ndarray, shapes (..., S, P, 3) and (..., S, P, 3, 3)
            Poses of the tool as each station should see them, base frame, mm.
        """

    @abstractmethod
    def slopes(self, position: Array, rotation: Array) -> Array:
        """Return the derivative of `residuals` by the poses seen (S, P, 3), (S, P, 3, 3), shape (S, P, K, 6).

        Poses change by a displacement and by the rotation vector of a rotation from the left.
        """

    @abstractmethod
    def select(self, chosen: np.ndarray) -> Self:
        """Return the readings of some poses."""

    @abstractmethod
    def describe(self) -> dict[str, Any]:
        """Return what was read and how well it fits in itself, for the summary."""

    def is_whole(self) -> bool:
        """Whether every pose is determined by its readings."""
        return bool(self.rows.measured.all())
