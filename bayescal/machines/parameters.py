"""The parameter vector: which numbers describe a machine, what they are called and where they stand.

Every kinematic model and every deformation declares blocks of parameters; a layout lays the blocks one after another in
one flat vector ``theta`` of length D, so that batches of machines are plain arrays of shape (..., D).

Of the directions of actuators two components of each unit vector are parameters, the third follows. In an orthonormal
frame (e1, e2, pole) of each leg u = t1 e1 + t2 e2 + sqrt(1 - t1² - t2²) pole, which covers the half of the unit sphere
about the pole. A direction is well determined by components across it, so that the pole has to lie near the nominal
one:

- Where one axis of the base frame lies near every leg's direction, forth or back, it is the pole, and t1 and t2 are
  the other two components of u as they are: u_x and u_y for vertical and steep actuators that point up or down, u_y
  and u_z for guides along ±x, u_x and u_z for guides along ±y.
- Where no axis does, as for guides that point to several sides, the pole is the nominal direction itself, and the
  components are small angles in radians across it, zero nominally: u_h horizontally, to the left if one looks along
  the actuator, and u_v in the vertical plane, upwards. Of a vertical actuator they are those along x and ±y.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from bayescal.errors import InputError
from bayescal.numerics.geometry import Array

AXES = "xyz"
STEEP = 0.4  # least component along its pole of a nominal direction that the axes of the base frame tell
VERTICAL = 1e-9  # horizontal part of a direction, below which it has no azimuth

type Rows = tuple[tuple[float, float, float], ...]


@dataclass(frozen=True)
class DirectionChart:
    """Which components of the directions are parameters."""

    symbols: tuple[str, str]  # of the two components
    frames: tuple[Rows, ...]  # e1, e2 and the pole of each leg in rows, base frame

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
    least = np.abs(directions).min(axis=0)
    for axis in (
        2,
        *sorted((0, 1), key=lambda k: -round(float(least[k]), 9)),
    ):  # the one nearer to all directions first
        if least[axis] >= STEEP:
            return _along_axis(directions, axis)
    return DirectionChart(("u_h", "u_v"), tuple(_across(direction) for direction in directions))


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


@dataclass(frozen=True)
class ParameterBlock:
    """One symbol's parameters: one value per leg, the components of a vector in space, or one value for the machine.

    Attributes
    ----------
    symbol : str
        For example ``a_x``.
    nominal : tuple of float
        Nominal values, one per leg (or a single one).
    unit : str
        ``mm``, ``N``, ``N mm2`` or ``1``.
    per_leg : bool
        Whether the values belong to legs; then they are named ``a_x[1]``, legs counted from one.
    lower, upper : float
        There is a machine only strictly between them.
    axes : str
        Letters of the axes, where the values are components of a point or of a rotation vector; then they are named
        ``tool[x]``, and belong to no leg.

    Examples
    --------
    >>> bc.ParameterBlock("l", (300.0, 300.0, 300.0)).names
    ('l[1]', 'l[2]', 'l[3]')
    >>> bc.ParameterBlock("tool", (0.0, 0.0, 120.0), axes="xyz").names
    ('tool[x]', 'tool[y]', 'tool[z]')
    """

    symbol: str
    nominal: tuple[float, ...]
    unit: str = "mm"
    per_leg: bool = True
    lower: float = -np.inf
    upper: float = np.inf
    axes: str = ""

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the block's parameters."""
        if not self.per_leg:
            return (self.symbol,)
        if self.axes:
            return tuple(f"{self.symbol}[{axis}]" for axis, _ in zip(self.axes, self.nominal, strict=True))
        return tuple(f"{self.symbol}[{leg}]" for leg in range(1, len(self.nominal) + 1))


@dataclass(frozen=True)
class HomeStart:
    """Where the search for the home pose begins, always with the platform level."""

    # of the platform's origin, base frame, mm; None where it follows from the lengths of the legs
    position: tuple[float, float, float] | None = None
    below: bool = False  # then, whether the platform stands below the legs' lower joints and not above them


@dataclass(frozen=True)
class ParameterLayout:
    """Blocks of parameters laid out in one flat vector."""

    blocks: tuple[ParameterBlock, ...]
    # what the components of the actuators' directions mean; None for machines without any
    directions: DirectionChart | None = None
    home: HomeStart = HomeStart()  # where a search for the home pose of these parameters begins

    def extend(self, blocks: tuple[ParameterBlock, ...]) -> ParameterLayout:
        """Return the same with more blocks after its own."""
        return replace(self, blocks=self.blocks + blocks)

    @property
    def direction_symbols(self) -> tuple[str, ...]:
        """Symbols of the two components of the actuators' directions, none where there are none."""
        return self.directions.symbols if self.directions is not None else ()

    @cached_property
    def index(self) -> dict[str, np.ndarray]:
        """Positions of each symbol's values in the vector."""
        positions, start = {}, 0
        for block in self.blocks:
            positions[block.symbol] = np.arange(start, start + len(block.nominal))
            start += len(block.nominal)
        return positions

    @cached_property
    def size(self) -> int:
        """Length D of the vector."""
        return sum(len(block.nominal) for block in self.blocks)

    @cached_property
    def nominal(self) -> Array:
        """Nominal vector, shape (D,)."""
        return np.array([value for block in self.blocks for value in block.nominal], dtype=np.float64)

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Names of all parameters, in order."""
        return tuple(name for block in self.blocks for name in block.names)

    @cached_property
    def units(self) -> tuple[str, ...]:
        """Unit of each parameter, in order."""
        return tuple(block.unit for block in self.blocks for _ in block.nominal)

    def block(self, symbol: str) -> ParameterBlock:
        """Return the block of a symbol."""
        return self._by_symbol[symbol]

    @cached_property
    def _by_symbol(self) -> dict[str, ParameterBlock]:
        return {block.symbol: block for block in self.blocks}

    @property
    def symbols(self) -> tuple[str, ...]:
        """Symbols of the blocks, in order."""
        return tuple(block.symbol for block in self.blocks)

    @cached_property
    def limits(self) -> tuple[Array, Array]:
        """Open bounds of each parameter, shapes (D,)."""
        pairs = [(block.lower, block.upper) for block in self.blocks for _ in block.nominal]
        lower, upper = np.array(pairs, dtype=np.float64).reshape(-1, 2).T
        return lower, upper

    @cached_property
    def _limited(self) -> tuple[np.ndarray, Array, Array]:
        """Positions of the parameters with bounds, and these."""
        lower, upper = self.limits
        some = np.flatnonzero(np.isfinite(lower) | np.isfinite(upper))
        return some, lower[some], upper[some]

    def inside(self, theta: Array) -> np.ndarray:
        """Return whether every parameter lies between its bounds, shape (..., D) to (...); False for NaN."""
        some, lower, upper = self._limited
        values = theta[..., some]
        result: np.ndarray = ((values > lower) & (values < upper)).all(axis=-1)
        return result

    def check(self, theta: Array) -> None:
        """Raise InputError that names the first parameter of a vector (D,) outside its bounds, with its value."""
        lower, upper = self.limits
        for k in self._limited[0]:
            if not lower[k] < theta[k] < upper[k]:
                unit = "" if self.units[k] == "1" else f" {self.units[k]}"
                below = f" and below {upper[k]:g}" if np.isfinite(upper[k]) else ""
                raise InputError(
                    f"parameter {self.names[k]}: found {theta[k]:g}{unit}, expected above {lower[k]:g}{below}"
                )

    def take(self, theta: Array, symbol: str) -> Array:
        """Return one symbol's values, shape (..., D) to (..., n)."""
        return theta[..., self.index[symbol]]

    def take_vector(self, theta: Array, prefix: str) -> Array:
        """Return the points ``prefix_x, prefix_y, prefix_z`` of the legs, shape (..., D) to (..., N, 3)."""
        return np.stack([self.take(theta, f"{prefix}_{axis}") for axis in "xyz"], axis=-1)
