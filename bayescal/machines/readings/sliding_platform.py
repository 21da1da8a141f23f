"""A planar platform on legs of fixed length whose carriages slide on guides: Sliding Star (Šika et al. 2008, figure 2).

Carriage i stands at c = P_i + s_i e_i on a guide with direction e_i = (cos β_i, sin β_i); a leg of length l_i joins it
to B_i of the platform, at b = p + R(φ) (ξ_Bi, η_Bi). With w = b - P_i, along and across the guide

    h_i = w · n_i,   t_i = ± sqrt(l_i² - h_i²),   s_i = w · e_i - t_i,

the sign that of the nominal machine, for a leg never passes square to its guide. In the guide's frame the leg is
(t_i, h_i), so that the angles of leg to carriage and of leg to platform are

    φ_i = α_i - φ_i0,   ψ_i = α_i + β_i - φ - ψ_i0,   α_i = atan2(h_i, t_i),

counted from where the sensors have their zeros. The pose v is (x, y, φ) of the platform's frame.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations

import numpy as np

from bayescal.errors import InputError
from bayescal.machines.models.legs import legs_first
from bayescal.machines.parameters import ParameterBlock, ParameterLayout
from bayescal.machines.readings.base import NOTHING, Channel, Coordinate, Given, ReadingModel, Readings
from bayescal.numerics.geometry import Array

KINDS = {"s": "mm", "phi": "rad", "psi": "rad"}
TOOL = ("x_V", "y_V", "phi_V")
POINTS = ("x_P", "y_P", "beta", "l", "xi_B", "eta_B")
MIN_LEGS = 3


@dataclass(frozen=True, eq=False)
class SlidingPlatform(ReadingModel):
    """Nominal geometry of a planar platform on N sliding legs, lengths in mm and angles in rad.

    Attributes
    ----------
    name : str
    guide_points : ndarray, shape (N, 2)
        P_i, where the reading of carriage i is zero, base frame.
    guide_angles : ndarray, shape (N,)
        β_i, from the base frame's x axis.
    leg_lengths : ndarray, shape (N,)
        l_i.
    platform_points : ndarray, shape (N, 2)
        (ξ_Bi, η_Bi), platform frame; its origin is B_1 and its ξ axis runs through B_2.
    tool_point : ndarray, shape (2,)
        (ξ_V, η_V), the tool's centre, platform frame.
    home : ndarray, shape (3,)
        (x, y, φ) of the platform frame at home, about which the workspace lies and where angle sensors read zero.
    forward : ndarray of bool, shape (N,)
        Whether a leg points along its guide, from the carriage (t_i > 0), or against it.
    """

    name: str
    guide_points: Array
    guide_angles: Array
    leg_lengths: Array
    platform_points: Array
    tool_point: Array
    home: Array
    forward: np.ndarray

    def __post_init__(self) -> None:
        """Check the number of legs and that the machine stands at home without crossed legs."""
        super().__post_init__()
        if self.n_legs < MIN_LEGS:
            raise InputError(f"machine {self.name!r}: found {self.n_legs} legs, expected at least {MIN_LEGS}")
        self.check_poses(self.home[None], lambda _: "home")

    @property
    def n_legs(self) -> int:
        """Number of legs N."""
        return len(self.leg_lengths)

    @cached_property
    def layout(self) -> ParameterLayout:
        """Per leg x_P, y_P, β, l, ξ_B, η_B and the zeros φ_0 and ψ_0 of its angle sensors; ξ_V, η_V of the tool."""
        points, zeros = self._nominal_points(), self._legs_from(self.home, *self._nominal_points()).angle
        blocks = [
            ParameterBlock(
                symbol, tuple(one), "rad" if symbol == "beta" else "mm", lower=0.0 if symbol == "l" else -np.inf
            )
            for symbol, one in zip(POINTS, points, strict=True)
        ]
        blocks += [
            ParameterBlock("phi0", tuple(zeros), "rad"),
            ParameterBlock("psi0", tuple(zeros + self.guide_angles - self.home[2]), "rad"),
            ParameterBlock("xi_V", (float(self.tool_point[0]),), per_leg=False),
            ParameterBlock("eta_V", (float(self.tool_point[1]),), per_leg=False),
        ]
        return ParameterLayout(tuple(blocks))

    def _nominal_points(self) -> tuple[Array, ...]:
        return (*self.guide_points.T, self.guide_angles, self.leg_lengths, *self.platform_points.T)

    @cached_property
    def sensors(self) -> tuple[Channel, ...]:
        """Carriages, angles to carriages, angles to the platform; then the tool's pose seen from beside the machine."""
        internal = [Channel(f"{kind}[{k + 1}]", unit) for kind, unit in KINDS.items() for k in range(self.n_legs)]
        outside = [Channel(name, "rad" if name == "phi_V" else "mm", external=True) for name in TOOL]
        return (*internal, *outside)

    @property
    def actuated(self) -> tuple[str, ...]:
        """The carriages."""
        return ("s",)

    @property
    def tool_channels(self) -> tuple[Channel, ...]:
        """X and y of the tool's centre."""
        return tuple(Channel(name, "mm") for name in TOOL[:2])

    @property
    def coordinates(self) -> tuple[Coordinate, ...]:
        """x, y and φ of the platform's frame."""
        kinds = zip(("x", "y", "phi"), ("mm", "mm", "rad"), self.home, strict=True)
        return tuple(Coordinate(name, unit, float(home), reach=0.0) for name, unit, home in kinds)

    def frame_parameters(self) -> tuple[str, ...]:
        """Return x_P1, y_P1 and β_1, which place the base frame, and ξ_B1, η_B1, η_B2, which place the platform's."""
        return ("x_P[1]", "y_P[1]", "beta[1]", "xi_B[1]", "eta_B[1]", "eta_B[2]")

    # --- readings ------------------------------------------------------------------------------------------------

    def _points(self, theta: Array) -> tuple[Array, ...]:
        """Return the legs' parameters, each of shape (..., N)."""
        return tuple(self.layout.take(theta, symbol) for symbol in POINTS)

    def _legs_from(
        self, pose: Array, x_p: Array, y_p: Array, beta: Array, length: Array, xi: Array, eta: Array
    ) -> _Legs:
        # legs first inside, for NumPy is slow where the last axis is short
        x_p, y_p, beta, length, xi, eta = (legs_first(one, pose.ndim) for one in (x_p, y_p, beta, length, xi, eta))
        cosine, sine = np.cos(pose[..., 2]), np.sin(pose[..., 2])
        arm_x, arm_y = cosine * xi - sine * eta, sine * xi + cosine * eta
        w_x, w_y = pose[..., 0] + arm_x - x_p, pose[..., 1] + arm_y - y_p
        e_x, e_y = np.broadcast_arrays(np.cos(beta), np.sin(beta), w_x)[:2]
        across = e_x * w_y - e_y * w_x
        with np.errstate(invalid="ignore"):
            along = np.sqrt(length**2 - across**2)
        along = along * legs_first(np.where(self.forward, 1.0, -1.0), along.ndim)
        found = (e_x * w_x + e_y * w_y, across, along, arm_x, arm_y, e_x, e_y)
        return _Legs(*(np.moveaxis(one, 0, -1) for one in found))

    def read(self, theta: Array, pose: Array, given: Given = NOTHING) -> Array:
        """Return the readings; see `ReadingModel.read`."""
        del given
        return self.take(self._values(theta, pose, self._legs_from(pose, *self._points(theta))))

    def _values(self, theta: Array, pose: Array, legs: _Legs) -> Array:
        alpha = legs.angle
        phi = alpha - self.layout.take(theta, "phi0")
        psi = alpha + self.layout.take(theta, "beta") - pose[..., 2:] - self.layout.take(theta, "psi0")
        position = self._tool_position(theta, pose)
        turned = np.broadcast_to(pose[..., 2:], (*position.shape[:-1], 1))
        return np.concatenate([legs.reach - legs.along, phi, psi, position, turned], axis=-1)

    def linearise(self, theta: Array, pose: Array, with_parameters: bool = True, given: Given = NOTHING) -> Readings:
        """Return the readings with their derivatives; see `ReadingModel.linearise`."""
        del given
        legs, n = self._legs_from(pose, *self._points(theta)), self.n_legs
        values = self._values(theta, pose, legs)
        _, tool_by_pose, tool_by_parameters = self.tool(theta, pose)
        # per leg, by (x, y, φ): of h and of w · e
        h = np.stack([-legs.e_y, legs.e_x, legs.e_x * legs.arm_x + legs.e_y * legs.arm_y], axis=-1)
        reach = np.stack([legs.e_x, legs.e_y, legs.e_y * legs.arm_x - legs.e_x * legs.arm_y], axis=-1)
        by_pose = np.zeros((*values.shape, 3))
        by_pose[..., :n, :], alpha = legs.differentiate(h, reach)
        by_pose[..., n : 2 * n, :] = by_pose[..., 2 * n : 3 * n, :] = alpha
        by_pose[..., 2 * n : 3 * n, 2] -= 1.0
        by_pose[..., 3 * n : 3 * n + 2, :] = tool_by_pose
        by_pose[..., 3 * n + 2, 2] = 1.0
        if not with_parameters:
            return Readings(values, by_pose).pick(self.places)
        by_parameters = self._by_parameters(theta, pose, legs)
        by_parameters[..., 3 * n : 3 * n + 2, :] = tool_by_parameters
        return Readings(values, by_pose, by_parameters).pick(self.places)

    def _by_parameters(self, theta: Array, pose: Array, legs: _Legs) -> Array:
        n, index = self.n_legs, self.layout.index
        cosine, sine = np.cos(pose[..., 2:]), np.sin(pose[..., 2:])
        e_x, e_y, zero = legs.e_x, legs.e_y, np.zeros_like(legs.across)
        # per leg, by x_P, y_P, β, l, ξ_B, η_B: of h and of w · e; l itself acts through t alone
        h = [e_y, -e_x, -legs.reach, zero, e_x * sine - e_y * cosine, e_x * cosine + e_y * sine]
        reach = [-e_x, -e_y, legs.across, zero, e_x * cosine + e_y * sine, e_y * cosine - e_x * sine]
        longer = np.array([0.0, 0.0, 0.0, 1.0, 0.0, 0.0]) * self.layout.take(theta, "l")[..., None]
        carriage, alpha = legs.differentiate(np.stack(h, axis=-1), np.stack(reach, axis=-1), longer)
        result = np.zeros((*legs.across.shape[:-1], 3 * n + len(TOOL), self.layout.size))
        leg = np.arange(n)
        for k, symbol in enumerate(POINTS):
            result[..., leg, index[symbol]] = carriage[..., k]
            result[..., n + leg, index[symbol]] = result[..., 2 * n + leg, index[symbol]] = alpha[..., k]
        result[..., 2 * n + leg, index["beta"]] += 1.0
        result[..., n + leg, index["phi0"]] = result[..., 2 * n + leg, index["psi0"]] = -1.0
        return result

    def _tool_position(self, theta: Array, pose: Array) -> Array:
        xi, eta = self.layout.take(theta, "xi_V"), self.layout.take(theta, "eta_V")
        cosine, sine = np.cos(pose[..., 2:]), np.sin(pose[..., 2:])
        return np.asarray(pose[..., :2] + np.concatenate([cosine * xi - sine * eta, sine * xi + cosine * eta], axis=-1))

    def tool(self, theta: Array, pose: Array) -> tuple[Array, Array, Array]:
        """Return the tool's centre V = p + R(φ) (ξ_V, η_V); see `ReadingModel.tool`."""
        position = self._tool_position(theta, pose)
        arm = position - pose[..., :2]
        by_pose = np.zeros((*position.shape, 3))
        by_pose[..., 0, 0] = by_pose[..., 1, 1] = 1.0
        by_pose[..., 0, 2], by_pose[..., 1, 2] = -arm[..., 1], arm[..., 0]
        by_parameters = np.zeros((*position.shape, self.layout.size))
        own = np.concatenate([self.layout.index["xi_V"], self.layout.index["eta_V"]])
        by_parameters[..., own] = matrix_of_angle(pose[..., 2])
        return position, by_pose, by_parameters

    def rotation(self, pose: Array) -> Array:
        """Return R(φ); see `ReadingModel.rotation`."""
        return matrix_of_angle(pose[..., 2])

    # --- checks --------------------------------------------------------------------------------------------------

    def check_poses(self, pose: Array, name: Callable[[int], str] = lambda k: f"pose {k + 1}") -> None:
        """Raise InputError where a leg of the nominal machine does not reach a pose, shape (P, 3), or legs cross."""
        legs = self._legs_from(pose, *self._nominal_points())
        short = ~np.isfinite(legs.along)
        if short.any():
            k, leg = np.argwhere(short)[0]
            raise InputError(
                f"machine {self.name!r}: {name(int(k))}: leg {leg + 1} cannot reach it, found "
                f"{abs(legs.across[k, leg]):.4g} mm from its guide, expected at most {self.leg_lengths[leg]:g} mm"
            )
        ends = pose[..., None, :2] + np.stack([legs.arm_x, legs.arm_y], axis=-1)
        foot = ends - legs.along[..., None] * np.stack([legs.e_x, legs.e_y], axis=-1)
        foot -= legs.across[..., None] * np.stack([-legs.e_y, legs.e_x], axis=-1)
        for i, j in combinations(range(self.n_legs), 2):
            crossed = np.flatnonzero(segments_cross(foot[:, i], ends[:, i], foot[:, j], ends[:, j]))
            if len(crossed):
                raise InputError(
                    f"machine {self.name!r}: {name(int(crossed[0]))}: legs {i + 1} and {j + 1} cross, "
                    "expected legs that do not"
                )


@dataclass(frozen=True, eq=False)
class _Legs:
    """The legs of machines at poses, arrays of shape (..., N).

    ``reach`` and ``across`` are w · e and w · n, ``along`` is t; ``arm`` is R (ξ_B, η_B).
    """

    reach: Array
    across: Array
    along: Array
    arm_x: Array
    arm_y: Array
    e_x: Array
    e_y: Array

    @cached_property
    def angle(self) -> Array:
        """α, continuous for either sign of t: between -π/2 and π/2, or between π/2 and 3π/2."""
        acute = np.arctan2(self.across, np.abs(self.along))
        return np.where(self.along < 0.0, np.pi - acute, acute)

    def differentiate(self, h: Array, reach: Array, length: Array | float = 0.0) -> tuple[Array, Array]:
        """Return the derivatives of s and α from those of h, of w · e and of l²/2, all (..., N, k)."""
        across, along = self.across[..., None], self.along[..., None]
        t = (length - across * h) / along
        return reach - t, (along * h - across * t) / (along**2 + across**2)


def matrix_of_angle(angle: Array) -> Array:
    """Return the rotations of the plane by angles (...) in rad, shape (..., 2, 2)."""
    cosine, sine = np.cos(angle), np.sin(angle)
    return np.stack([np.stack([cosine, -sine], axis=-1), np.stack([sine, cosine], axis=-1)], axis=-2)


def segments_cross(start: Array, end: Array, other_start: Array, other_end: Array) -> np.ndarray:
    """Return whether segments of the plane, (..., 2) each, have a point in common, shape (...)."""

    def side(a: Array, b: Array, c: Array) -> Array:
        u, v = b - a, c - a
        return np.asarray(u[..., 0] * v[..., 1] - u[..., 1] * v[..., 0])

    apart = side(start, end, other_start) * side(start, end, other_end)
    other_apart = side(other_start, other_end, start) * side(other_start, other_end, end)
    return np.asarray((apart <= 0.0) & (other_apart <= 0.0))
