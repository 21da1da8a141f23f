"""What every simulated machine is: what it reads at a pose, its tolerances, its workspace, what readings tell of it.

Nothing of this is bayescal's: machines are written down once more, in millimetres and radians. A machine reads
s = h(θ, v): its actuators first, then what an instrument beside it sees. Rotation vectors state platforms'
orientations; bodies' points are p + R b.
"""

from __future__ import annotations

from abc import ABC, abstractmethod

import numpy as np
from numpy.typing import NDArray

type Array = NDArray[np.float64]

ARCSEC = np.pi / 648_000.0
STEP = 1e-4  # of a coordinate's or a tolerance's size, for differences
NEWTON = 12
TOLD = 0.1  # of a direction's prior variance, below which it is well determined


def rotate(vector: Array, points: Array) -> Array:
    """Return points (N, 3) turned by rotation vectors (P, 3), shape (P, N, 3): Rodrigues' formula."""
    angle = np.linalg.norm(vector, axis=-1)[:, None, None]
    axis = np.broadcast_to(vector[:, None, :], (len(vector), *points.shape))
    across, twice = np.cross(axis, points), np.cross(axis, np.cross(axis, points))
    safe = np.where(angle > 1e-12, angle, 1.0)
    return (
        points
        + np.where(angle > 1e-12, np.sin(safe) / safe, 1.0) * across
        + (np.where(angle > 1e-12, (1.0 - np.cos(safe)) / safe**2, 0.5) * twice)
    )


def difference(function, at: Array, steps: Array) -> Array:
    """Return central differences of a function of (D,), its values' shape with D at the end."""
    columns = []
    for k, step in enumerate(steps):
        move = np.zeros_like(at)
        move[k] = step
        columns.append((function(at + move) - function(at - move)) / (2.0 * step))
    return np.stack(columns, axis=-1)


class Simulated(ABC):
    """A machine that reads m channels at poses of q coordinates, N of them actuators.

    Attributes
    ----------
    names : list of str
        Of the D parameters, as results name them.
    nominal, sd : ndarray, shape (D,)
        Drawing and tolerances.
    noise : ndarray, shape (m,)
        Stated standard deviations.
    size : ndarray, shape (q,)
        How far coordinates go to either side of ``home`` (q,).
    lever : ndarray, shape (N,)
        Of each actuator: by how many millimetres one unit of it moves the tool, roughly.
    n_actuators : int
    seen : list of int
        Channels in which the instrument sees lengths.
    true : ndarray, shape (D,), or None
        The twin, once it is drawn.
    commanded : tuple of str
        Kinds of actuators whose readings are commands; none or all of them.
    counts : (int, int)
        Poses for calibration, and held back.
    rows : tuple of str
        Rows of errors that it is judged by where none are named; none for all of them.
    """

    names: list[str]
    nominal: Array
    sd: Array
    noise: Array
    home: Array
    size: Array
    lever: Array
    n_actuators: int
    seen: list[int]
    true: Array | None = None
    commanded: tuple[str, ...] = ()
    counts: tuple[int, int] = 40, 15
    rows: tuple[str, ...] = ()

    @abstractmethod
    def read(self, theta: Array, v: Array) -> Array:
        """Return the channels (P, m) of a machine (D,) at poses (P, q)."""

    @abstractmethod
    def draw_poses(self, theta: Array, n: int, rng: np.random.Generator) -> Array:
        """Return n poses of the workspace of a machine (D,), shape (n, q)."""

    def tool(self, theta: Array, v: Array) -> Array:
        """Return where the tool of a machine (D,) truly is at poses (P, q): its coordinates."""
        return v

    def solve(self, theta: Array, wanted: Array) -> Array:
        """Return poses (P, q) at which as many actuators of a machine (D,) read (P, q): by Newton's steps from home."""
        v, n = np.tile(self.home, (len(wanted), 1)), self.n_actuators
        start = self.read(theta, v)[:, :n]
        for k in range(1, NEWTON + 1):  # the first steps go a part of the way
            slope = difference(lambda move, v=v: self.read(theta, v + move)[:, :n], 0.0 * self.home, STEP * self.size)
            there = start + min(k / 4.0, 1.0) * (wanted - start)
            v = v + np.linalg.solve(slope, (there - self.read(theta, v)[:, :n])[..., None])[..., 0]
        return v

    def travel(self, v: Array) -> Array:
        """Return how far a twin's actuators are from the drawing's home, shape (P, N), about one at the ends."""
        true = self.nominal if self.true is None else self.true
        moved = self.read(true, v) - self.read(self.nominal, self.home[None])
        return moved[:, : self.n_actuators] / self.reach

    @property
    def reach(self) -> Array | float:
        """Travel of the actuators to either side."""
        return 1.0

    def place(self, v: Array) -> Array:
        """Return the pose's coordinates about home, about one at the ends, shape (P, q)."""
        return (v - self.home) / self.size

    def tilt(self, v: Array) -> Array:
        """Return two coordinates whose squares joints feel, about one at the ends, shape (P, 2)."""
        return self.place(v)[:, :2]

    def add_noise(self, exact: Array, rng: np.random.Generator) -> Array:
        """Return channels (P, m) with the stated noise."""
        return exact + self.noise * rng.standard_normal(exact.shape)

    def reduce(self, theta: Array, v: Array) -> tuple[Array, Array]:
        """Return what no pose explains of white readings at poses (P, q): its directions (P, m, r), slopes (P, r, D).

        Poses are unknown with flat priors; slopes are by parameters in units of their tolerances.
        """
        by_theta = difference(lambda one: self.read(one, v), theta, STEP * self.sd) * self.sd / self.noise[:, None]
        flat = np.zeros(v.shape[1])
        by_pose = difference(lambda move: self.read(theta, v + move), flat, STEP * self.size) / self.noise[:, None]
        across = np.linalg.qr(by_pose, mode="complete")[0][:, :, v.shape[1] :]
        return across, np.swapaxes(across, 1, 2) @ by_theta

    def right_posterior(self, theta: Array, v: Array) -> Array:
        """Return the covariance (D, D) of parameters over their tolerances, by the model without errors."""
        rows = self.reduce(theta, v)[1].reshape(-1, theta.size)
        return np.linalg.inv(rows.T @ rows + np.eye(theta.size))


def find_determined(covariance: Array) -> Array:
    """Return the directions (K, D) of which a covariance (D, D), in units of the tolerances, leaves little doubt."""
    value, vector = np.linalg.eigh(covariance)
    return vector.T[value < TOLD]
