"""How parameters tell the directions of actuators: two free components of each unit vector, the third follows.

In an orthonormal frame (e1, e2, pole) of each leg u = t1 e1 + t2 e2 + sqrt(1 - t1² - t2²) pole, which covers the half
of the unit sphere about the pole. A direction is told well by components across it, so that the pole has to lie near
the nominal one:

- Where one axis of the base frame lies near every leg's direction, forth or back, it is the pole, and t1 and t2 are
  the other two components of u as they are: u_x and u_y for vertical and steep actuators that point up or down, u_y
  and u_z for guides along ±x, u_x and u_z for guides along ±y.
- Where no axis does, as for guides that point to several sides, the pole is the nominal direction itself, and the
  components are small angles in radians across it, zero nominally: u_h horizontally, to the left if one looks along
  the actuator, and u_v in the vertical plane, upwards. Of a vertical actuator they are those along x and ±y.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from bayescal.numerics.geometry import Array

AXES = "xyz"
STEEP = 0.4  # least component along its pole of a nominal direction that the axes of the base frame tell
VERTICAL = 1e-9  # horizontal part of a direction, below which it has no azimuth

type Rows = tuple[tuple[float, float, float], ...]


@dataclass(frozen=True)
class DirectionChart:
    """Which components of the directions are parameters.

    Attributes
    ----------
    symbols : pair of str
        Of the two components.
    frames : tuple, N x 3 x 3
        e1, e2 and the pole of each leg in rows, base frame.
    """

    symbols: tuple[str, str]
    frames: tuple[Rows, ...]

    @cached_property
    def axes(self) -> Array:
        """The frames as an array, shape (N, 3, 3)."""
        return np.array(self.frames, dtype=np.float64)

    @cached_property
    def upright(self) -> bool:
        """Whether the frames are all that of the base, so that local components are those along x, y and z."""
        return bool((self.axes == np.eye(3)).all())

    def to_local(self, vector: Array) -> Array:
        """Return the components along e1, e2 and pole of vectors in the base frame, shapes (..., N, 3)."""
        return vector if self.upright else np.einsum("nmk,...nk->...nm", self.axes, vector)

    def to_base(self, local: Array) -> Array:
        """Return the vectors in the base frame of local components, shapes (..., N, 3)."""
        return local if self.upright else np.einsum("nmk,...nm->...nk", self.axes, local)

    def complete(self, local: Array) -> None:
        """Turn arrays (3, N, B) that hold t1 and t2 into unit vectors in the base frame, in place; NaN for none."""
        first, second, _ = local
        with np.errstate(invalid="ignore"):
            np.sqrt(1.0 - first * first - second * second, out=local[2])
        if not self.upright:
            local[...] = np.einsum("nmk,mnb->knb", self.axes, local)


def complete_components(first: Array, second: Array) -> Array:
    """Return local components (..., N, 3) of unit vectors from t1 and t2, shapes (..., N); NaN where there is none."""
    with np.errstate(invalid="ignore", over="ignore"):
        third = np.sqrt(1.0 - first * first - second * second)
    return np.stack([first, second, third], axis=-1)


def choose_chart(directions: Array) -> DirectionChart:
    """Return the components that tell unit directions (N, 3) well; z is preferred to x, and x to y."""
    for axis in _order_axes(directions):
        if np.abs(directions[:, axis]).min() >= STEEP:
            return _along_axis(directions, axis)
    return DirectionChart(("u_h", "u_v"), tuple(_across(direction) for direction in directions))


def _order_axes(directions: Array) -> list[int]:
    """Return z, then x and y, the one nearer to all directions first."""
    return [2, *sorted((0, 1), key=lambda axis: -round(float(np.abs(directions[:, axis]).min()), 9))]


def _along_axis(directions: Array, pole: int) -> DirectionChart:
    first, second = (k for k in range(3) if k != pole)
    axes = np.eye(3)
    frames = tuple(_rows(np.stack([axes[first], axes[second], np.sign(u[pole]) * axes[pole]])) for u in directions)
    return DirectionChart((f"u_{AXES[first]}", f"u_{AXES[second]}"), frames)


def _across(direction: Array) -> Rows:
    left = np.cross([0.0, 0.0, 1.0], direction)
    size = float(np.linalg.norm(left))
    left = np.array([1.0, 0.0, 0.0]) if size < VERTICAL else left / size
    upwards = np.cross(direction, left)
    return _rows(np.stack([left, upwards / np.linalg.norm(upwards), direction]))


def _rows(frame: Array) -> Rows:
    return tuple((float(x) + 0.0, float(y) + 0.0, float(z) + 0.0) for x, y, z in frame)
