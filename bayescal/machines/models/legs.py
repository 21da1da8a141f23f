"""The vectors from the lower to the upper joint of every leg, and how anything that depends on them is differentiated.

Leg i goes from c = a + ρ u to p + R b*, with b* = b + Δb_z e_z (RR-8096 eq. 5): g = p + R b* - c. A strut's lower
joint stays at a; its layout has neither u nor ρ^0.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from bayescal.machines.deformations import DeformationBasis
from bayescal.machines.parameters import DirectionChart, ParameterLayout, complete_components
from bayescal.numerics.geometry import Array


def lower_joints_travel(layout: ParameterLayout) -> bool:
    """Return whether actuators move the lower joints along u; otherwise they change the legs' lengths."""
    return "rho0" in layout.index


def list_dimensions(layout: ParameterLayout) -> tuple[str, ...]:
    """Return the symbols of lengths and directions, without ρ^0: a + ρ u has it as a shift of a along u."""
    own = (block.symbol for block in layout.blocks if block.unit == "mm" or block.symbol in layout.direction_symbols)
    return tuple(symbol for symbol in own if symbol != "rho0")


def chart_of(layout: ParameterLayout) -> DirectionChart:
    """Return which components of the actuators' directions the parameters are, for machines that have directions."""
    assert layout.directions is not None
    return layout.directions


def local_directions(layout: ParameterLayout, theta: Array) -> Array:
    """Return t1, t2 and sqrt(1 - t1² - t2²) of every leg, shape (..., N, 3); NaN where that is not real."""
    first, second = (layout.take(theta, symbol) for symbol in chart_of(layout).symbols)
    return complete_components(first, second)


def actuator_directions(layout: ParameterLayout, theta: Array) -> Array:
    """Return the unit vectors u, shape (..., N, 3), base frame; NaN where the components leave the unit sphere."""
    return chart_of(layout).to_base(local_directions(layout, theta))


def legs_first(values: Array, ndim: int) -> Array:
    """Return values (..., N) of at least so many axes with the legs' in front: operations along long axes are fast."""
    values = values.reshape((1,) * (ndim - values.ndim) + values.shape)
    return values.transpose((values.ndim - 1, *range(values.ndim - 1)))


def dot(first: Array, second: Array) -> Array:
    """Return scalar products over the last axis."""
    return np.asarray(np.einsum("...k,...k->...", first, second))


def cross(first: Array, second: Array) -> Array:
    """Return vector products over the last axis."""
    result = np.empty(np.broadcast_shapes(first.shape, second.shape))
    for k, (m, n) in enumerate(((1, 2), (2, 0), (0, 1))):
        np.multiply(first[..., m], second[..., n], out=result[..., k])
        result[..., k] -= first[..., n] * second[..., m]
    return result


def cross_first_axis(first: Array, second: Array, out: Array | None = None) -> Array:
    """Return vector products over the first axis, for arrays with the batch last."""
    if out is None:
        out = np.empty((3, *np.broadcast_shapes(first.shape[1:], second.shape[1:])))
    for k, (m, n) in enumerate(((1, 2), (2, 0), (0, 1))):
        np.multiply(first[m], second[n], out=out[k])
        out[k] -= first[n] * second[m]
    return out


@dataclass(frozen=True)
class PulledBack:
    """Derivatives of Σ w · dg of one leg each, by everything the leg vector depends on; leading axes those of w."""

    pose: Array  # (..., N, 6)
    actuators: Array  # (..., N, N)
    columns: dict[str, Array]  # (..., N): by the leg's own parameters


@dataclass(frozen=True, eq=False)
class LegVectors:
    """Leg vectors at given poses; leading axes are those of poses and parameter vectors, broadcast."""

    layout: ParameterLayout
    basis: DeformationBasis
    rotation: Array  # (..., 3, 3)
    # (..., N, 3): u, R b* and g in mm, z = g / |g|; base frame. u is zero for struts.
    direction: Array
    arm: Array
    vector: Array
    axis: Array
    # (..., N): ρ, zero for struts, and |g| in mm
    travel: Array
    length: Array

    @property
    def platform_z(self) -> Array:
        """Direction R e_z in which a deflection moves a joint, shape (..., 1, 3)."""
        return self.rotation[..., None, :, 2]

    def pull_back(self, covector: Array, with_parameters: bool = True) -> PulledBack:
        """Return the derivatives of w · g for covectors w, shape (..., N, 3), held fixed; columns where asked for."""
        pose = self.pull_back_pose(covector)
        actuators = dot(covector, self.platform_z)[..., None] * self.basis.actuator_gain
        actuators = actuators - np.eye(covector.shape[-2]) * dot(covector, self.direction)[..., None]
        return PulledBack(pose, actuators, self.columns(covector, covector) if with_parameters else {})

    def pull_back_pose(self, covector: Array) -> Array:
        """Return the derivatives of w · g by the pose for covectors w, shape (..., N, 3) to (..., N, 6)."""
        moment = cross(self.arm, covector)
        return np.concatenate([np.broadcast_to(covector, moment.shape), moment], axis=-1)

    def columns(self, covector: Array, joint_covector: Array) -> dict[str, Array]:
        """Return the derivatives by the legs' parameters, those by b* with covectors of their own, (..., N, 3)."""
        columns = {f"a_{name}": -covector[..., k] for k, name in enumerate("xyz")}
        if lower_joints_travel(self.layout):
            for symbol, by_component in self.pull_back_direction(covector).items():
                columns[symbol] = -self.travel * by_component
            columns["rho0"] = -dot(covector, self.direction)
        local = joint_covector @ self.rotation
        columns |= {f"b_{name}": local[..., k] for k, name in enumerate("xyz")}
        return columns | {symbol: local[..., 2] * c for symbol, c in self.basis.coefficients.items()}

    def pull_back_direction(self, covector: Array) -> dict[str, Array]:
        """Return the derivatives of w · u by the components of u for covectors w, shapes (..., N, 3), held fixed."""
        chart = chart_of(self.layout)
        local, along = chart.to_local(self.direction), chart.to_local(covector)
        slope = local[..., :2] / local[..., 2:]
        return {s: along[..., k] - along[..., 2] * slope[..., k] for k, s in enumerate(chart.symbols)}

    def with_rows(self) -> LegVectors:
        """Return the same with an axis before the legs', for closures whose every row depends on all legs."""
        basis = replace(
            self.basis,
            displacement=self.basis.displacement[..., None, :],
            constant=self.basis.constant[..., None, :],
            coefficients={symbol: c[..., None, :] for symbol, c in self.basis.coefficients.items()},
        )
        vectors = {name: getattr(self, name)[..., None, :, :] for name in ("direction", "arm", "vector", "axis")}
        scalars = {name: getattr(self, name)[..., None, :] for name in ("travel", "length")}
        return LegVectors(self.layout, basis, self.rotation[..., None, :, :], **vectors, **scalars)


def compute_leg_vectors(
    layout: ParameterLayout, theta: Array, position: Array, rotation: Array, basis: DeformationBasis
) -> LegVectors:
    """Return the leg vectors; shapes and frames as in `KinematicModel.linearise`."""
    if lower_joints_travel(layout):
        direction = actuator_directions(layout, theta)
        travel = layout.take(theta, "rho0") + basis.displacement
    else:
        travel = np.zeros(basis.displacement.shape[-1])
        direction = np.zeros((*travel.shape, 3))
    joint = layout.take_vector(theta, "b")
    deflection = basis.deflection(layout, theta)
    if deflection.any():
        joint = np.broadcast_to(joint, np.broadcast_shapes(joint.shape, (*deflection.shape, 3))).copy()
        joint[..., 2] += deflection
    arm = joint @ np.swapaxes(rotation, -1, -2)
    vector = position[..., None, :] + arm - layout.take_vector(theta, "a") - travel[..., None] * direction
    length = np.sqrt(dot(vector, vector))
    return LegVectors(layout, basis, rotation, direction, arm, vector, vector / length[..., None], travel, length)


def scatter_rows(layout: ParameterLayout, *parts: dict[str, Array]) -> Array:
    """Return derivatives of every row by every leg's parameters, shapes (..., M, N), as rows (..., M, D), summed."""
    leading = np.broadcast_shapes(*(c.shape[:-1] for part in parts for c in part.values()))
    blocks = []
    for symbol, where in layout.index.items():  # in the order of the parameters
        block, *more = [part[symbol] for part in parts if symbol in part] or [np.zeros(1)]
        for one in more:
            block = block + one
        blocks.append(np.broadcast_to(block, (*leading, len(where))))
    return np.concatenate(blocks, axis=-1)


def scatter(layout: ParameterLayout, columns: dict[str, Array]) -> Array:
    """Return the derivatives of leg i by leg i's own parameters, shapes (..., N), as rows (..., N, D)."""
    shape = np.broadcast_shapes(*(column.shape for column in columns.values()))
    return add_columns(layout, np.zeros((*shape, layout.size)), columns)


def add_columns(layout: ParameterLayout, rows: Array, columns: dict[str, Array]) -> Array:
    """Return rows (..., N, D) with the derivatives of leg i by its own parameters, (..., N), added in place."""
    for symbol, column in columns.items():
        start = layout.index[symbol][0]  # the values of a symbol stand together
        own = np.einsum("...ii->...i", rows[..., start : start + rows.shape[-2]])
        own += column
    return rows
