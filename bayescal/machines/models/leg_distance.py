"""Closures that compare a leg's length with the distance between its two joints: what 6-PUS and 6-UPS have in common.

They differ in what an actuator does: it moves the lower joint, or it changes the length that is wanted.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property, partial
from typing import ClassVar

import numpy as np

from bayescal.machines.deformations import DeformationBasis
from bayescal.machines.mechanism import Mechanism
from bayescal.machines.models.base import BoundClosure, Closure, KinematicModel, Linearisation
from bayescal.machines.models.legs import (
    chart_of,
    compute_leg_vectors,
    legs_first,
    lower_joints_travel,
    scatter,
)
from bayescal.machines.parameters import ParameterBlock, ParameterLayout
from bayescal.numerics.geometry import Array
from bayescal.numerics.scratch import Scratch


def list_point_blocks(mechanism: Mechanism) -> tuple[ParameterBlock, ...]:
    """Return a and b of each leg."""
    points = {"a": mechanism.base_points, "b": mechanism.platform_points}
    return tuple(
        ParameterBlock(f"{symbol}_{axis}", tuple(values[:, k].tolist()))
        for symbol, values in points.items()
        for k, axis in enumerate("xyz")
    )


class PerfectLegs:
    """Where actuators of perfect legs stand at given poses, in closed form.

    A leg runs from a to p + R (b + s e_z), whose joint a deflection s has moved, by d + s e with d = p + R b - a and
    e = R e_z. A strut is that long: Δρ = |d + s e| - l. A leg of length l has its carriage, at a + (ρ^0 + Δρ) u, on one
    side of the joint's foot on the guide: ρ^0 + Δρ = u · (d + s e) ∓ sqrt(l² - |d + s e|² + (u · (d + s e))²).

    Parameters
    ----------
    layout : ParameterLayout
    theta : ndarray, shape (..., D)
    position, rotation : ndarray, shapes (..., 3) and (..., 3, 3)
    sides : ndarray, shape (N,)
        On which side of the foot carriages stand, the sign of u · g; anything for struts.
    """

    def __init__(self, layout: ParameterLayout, theta: Array, position: Array, rotation: Array, sides: Array) -> None:
        ndim = self._ndim = max(theta.ndim, position.ndim)
        self._values, self._index = legs_first(theta, ndim), layout.index
        self._sides, self._length = legs_first(sides, ndim), self._take("l")
        # poses stand last: there every operation is a long contiguous loop
        n = rotation.ndim
        axes = np.ascontiguousarray(rotation.transpose((n - 2, n - 1, *range(n - 2))))
        lower, upper = ([self._take(f"{symbol}_{axis}") for axis in "xyz"] for symbol in "ab")
        self._axis = axes[:, 2]
        self._span = [_multiply(axes[i], upper) + (position[..., i] - lower[i]) for i in range(3)]
        self._square = _multiply(self._span, self._span)
        self._direction: Array | None = None
        if lower_joints_travel(layout):
            chart = chart_of(layout)
            direction = np.stack([*(self._take(symbol) for symbol in chart.symbols), self._length])
            chart.complete(direction.reshape(*direction.shape[:2], -1))
            self._direction, self._home = direction, self._take("rho0")
            self._foot = _multiply(direction, self._span)

    def _take(self, symbol: str) -> Array:
        """Return one symbol's values, shape (N, ...)."""
        return self._values[self._index[symbol]]

    @cached_property
    def _height(self) -> Array:
        """2 e · d, shape (N, ...)."""
        return 2.0 * _multiply(self._span, self._axis)

    @cached_property
    def _lean(self) -> Array:
        """Products e · u, shape (N, ...)."""
        assert self._direction is not None
        return _multiply(self._direction, self._axis)

    def displace(self, deflection: Array | None = None) -> Array:
        """Return Δρ for deflections s (..., N), shape (..., N), mm; NaN where a leg does not reach."""
        square, moved = self._square, None
        if deflection is not None:
            moved = legs_first(deflection, self._ndim)
            square = square + moved * (self._height + moved)
        with np.errstate(invalid="ignore"):
            if self._direction is None:
                return np.moveaxis(np.sqrt(square) - self._length, 0, -1)
            foot = self._foot if moved is None else self._foot + moved * self._lean
            beyond = np.sqrt(self._length**2 - square + foot**2)
        return np.moveaxis(foot - self._sides * beyond - self._home, 0, -1)


def _multiply(one: Sequence[Array] | Array, other: Sequence[Array] | Array) -> Array:
    """Return the scalar products of vectors by their components."""
    return np.asarray(one[0] * other[0] + one[1] * other[1] + one[2] * other[2])


class LegDistance(KinematicModel):
    """Legs with perfect joints: f = l - |g|."""

    has_perfect_joints: ClassVar[bool] = True

    def prepare(self, layout: ParameterLayout, theta: Array) -> Closure:
        """Return the closure; see `KinematicModel.prepare` for shapes."""
        return partial(self._close, layout, theta)

    def _close(
        self,
        layout: ParameterLayout,
        theta: Array,
        position: Array,
        rotation: Array,
        basis: DeformationBasis,
        with_parameters: bool = True,
    ) -> Linearisation:
        """Return l - |g| and its exact derivatives; see `Closure` for shapes and frames."""
        legs = compute_leg_vectors(layout, theta, position, rotation, basis)
        residual = layout.take(theta, "l") - legs.length
        back = legs.pull_back(-legs.axis, with_parameters)
        if not with_parameters:
            return Linearisation(residual, back.pose, back.actuators)
        columns = back.columns | {"l": np.ones_like(legs.length)}
        return Linearisation(residual, back.pose, back.actuators, scatter(layout, columns))


class LegDistanceClosure(BoundClosure):
    """Leg vectors and lever arms of all poses as products of a fixed design and the parameters of a leg.

    The leg vector g = q + R b* - c and its lever arm R b* = R b + (constant + κ φ) R e_z are linear in the features
    (1, b, κ, c) of a leg, c its lower joint: a design (P, F) for each component times the features (F, B), with
    F = 7 + number of deformation parameters; the lever arm needs only the first of them. A joint that travels has
    features of its own after c. The pose derivative of f is (-g, R b* x -g) / |g|, of which the numerator is kept.
    """

    n_travel: ClassVar[int] = 0
    """Number of features after c."""

    def __init__(self, layout: ParameterLayout, position: Array, rotation: Array, basis: DeformationBasis) -> None:
        self._layout, symbols = layout, tuple(basis.coefficients)
        n_poses, n_legs = basis.displacement.shape
        z_axis = rotation[:, :, 2].T[:, None]
        arm = [basis.constant.T * z_axis]
        arm += [np.broadcast_to(rotation[:, :, k].T[:, None], (3, n_legs, n_poses)) for k in range(3)]
        arm += [basis.coefficients[symbol].T * z_axis for symbol in symbols]
        self._arm_design = np.stack(arm, axis=-1)
        lower = np.zeros((3, n_legs, n_poses, 3 + self.n_travel))
        for k in range(3):
            lower[k, :, :, k] = 1.0
        self._design = np.concatenate([-self._arm_design, lower], axis=-1)
        self._design[..., 0] -= position.T[:, None]
        groups = (("a_x", "a_y", "a_z"), ("b_x", "b_y", "b_z", *symbols))
        self._base, self._linear = (np.stack([layout.index[symbol] for symbol in group]) for group in groups)
        self._scratch = Scratch()

    def _fill_lower(self, parameters: Array, lower: Array) -> None:
        """Write the features (3 and more, N, B) of the lower joints, from parameters (D, B)."""
        np.take(parameters, self._base, axis=0, out=lower, mode="clip")

    def evaluate(self, theta: Array) -> Array:
        """Return l - |g|, shape (N, P, B)."""
        self._measure(theta)
        return np.subtract(self._layout.take(theta, "l").T[:, None], self._length, out=self._take("closure"))

    def _take(self, name: str, *leading: int) -> Array:
        """Return a scratch array (..., N, P, B)."""
        return self._scratch.take(name, *leading, *self._length.shape)

    def _measure(self, theta: Array) -> Array:
        """Find leg vectors, moments and lengths; return the lever arms, shape (3, N, P, B), scratch."""
        parameters, take, n_linear = np.ascontiguousarray(theta.T), self._scratch.take, len(self._linear)
        _, n_legs, n_poses, n_arm = self._arm_design.shape
        features = np.empty((self._design.shape[-1], n_legs, len(theta)))
        features[0] = 1.0
        np.take(parameters, self._linear, axis=0, out=features[1 : 1 + n_linear], mode="clip")  # others would buffer
        self._fill_lower(parameters, features[1 + n_linear :])
        shape = (n_legs, n_poses, len(theta))
        self._slope, self._length = take("slope", 6, *shape), take("length", *shape)
        vector, moment, arm, work = self._slope[:3], self._slope[3:], self._take("arm", 3), self._take("work")
        np.matmul(self._design, features.transpose(1, 0, 2), out=vector)
        np.matmul(self._arm_design, features[:n_arm].transpose(1, 0, 2), out=arm)
        for k, (m, n) in enumerate(((1, 2), (2, 0), (0, 1))):
            np.multiply(arm[m], vector[n], out=moment[k])
            moment[k] -= np.multiply(arm[n], vector[m], out=work)
        np.einsum("kipb,kipb->ipb", vector, vector, out=self._length)
        np.sqrt(self._length, out=self._length)
        return arm

    def along(self, pose_error: Array) -> Array:
        """Return the pose derivative times e, shape (N, P, B)."""
        change = self._take("change")
        np.einsum("kipb,kpb->ipb", self._slope, pose_error, out=change)
        change /= self._length
        return change
