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

from collections.abc import Callable, Mapping
from itertools import combinations
from typing import NamedTuple

import numpy as np

from bayescal.errors import InputError
from bayescal.machines.models.legs import legs_first
from bayescal.machines.parameters import ParameterBlock
from bayescal.machines.readings.base import Channel, Coordinate, Given
from bayescal.machines.readings.function import Parameters, ReadingMachine
from bayescal.machines.schema import SlidingPlatformConfig
from bayescal.numerics.analytic import atan2, sqrt
from bayescal.numerics.geometry import Array

KINDS = {"s": "mm", "phi": "rad", "psi": "rad"}
TOOL = ("x_V", "y_V", "phi_V")
POINTS = ("x_P", "y_P", "beta", "l", "xi_B", "eta_B")
MIN_LEGS = 3


class _Legs(NamedTuple):
    """The legs of machines at poses, arrays of shape (N, ...).

    ``reach`` and ``across`` are w · e and w · n, ``along`` is t, ``angle`` α, continuous for either sign of t: between
    -π/2 and π/2, or between π/2 and 3π/2. ``arm`` is R (ξ_B, η_B), ``guide`` is e, by x and y.
    """

    reach: np.ndarray
    across: np.ndarray
    along: np.ndarray
    angle: np.ndarray
    arm: tuple[np.ndarray, np.ndarray]
    guide: tuple[np.ndarray, np.ndarray]


class SlidingPlatform(ReadingMachine):
    """A planar platform on N sliding legs with its sensors, and its tool's pose as an instrument sees it.

    The platform's frame is moved to B_1 with its ξ axis through B_2.

    Attributes
    ----------
    guide_points, platform_points : ndarray, shape (N, 2)
        P_i, base frame, and (ξ_Bi, η_Bi), platform frame, mm.
    guide_angles, leg_lengths : ndarray, shape (N,)
        β_i in rad, and l_i in mm.
    tool_point : ndarray, shape (2,)
        (ξ_V, η_V), the tool's centre, platform frame, mm.
    home : ndarray, shape (3,)
        (x, y, φ) of the platform frame at home, about which the workspace lies and where angle sensors read zero.
    forward : ndarray of bool, shape (N,)
        Whether a leg points along its guide, from the carriage (t_i > 0), or against it.
    """

    Config = SlidingPlatformConfig
    commanded = ("s",)
    tool_channels = tuple(Channel(name, "mm") for name in TOOL[:2])

    def __init__(self, config: SlidingPlatformConfig) -> None:
        """Lay out the machine; InputError for too few legs, one that does not reach home, or legs that cross there."""
        super().__init__(config)
        self.name = config.name
        points = np.array([leg.platform_point_mm for leg in config.legs])
        if len(points) < 2 or np.allclose(points[0], points[1]):
            raise InputError(f"machine {self.name!r}: found B_1 and B_2 in one place")
        turned = float(np.arctan2(*(points[1] - points[0])[::-1]))
        own = matrix_of_angle(np.array(-turned))
        angle = float(np.radians(config.home.angle_deg)) + turned
        self.guide_points = np.array([leg.guide_point_mm for leg in config.legs])
        self.guide_angles = np.radians([leg.guide_angle_deg for leg in config.legs])
        self.leg_lengths = np.array([leg.length_mm for leg in config.legs])
        self.forward = np.array([leg.direction == "along" for leg in config.legs])
        self.platform_points = (points - points[0]) @ own.T
        self.tool_point = own @ (np.array(config.tool.point_mm) - points[0])
        self.home = np.array([*(config.home.tool_mm - matrix_of_angle(np.array(angle)) @ self.tool_point), angle])
        if self.n_legs < MIN_LEGS:
            raise InputError(f"machine {self.name!r}: found {self.n_legs} legs, expected at least {MIN_LEGS}")
        self.check_poses(self.home[None], lambda _: "home")
        self._lay_out()

    @property
    def n_legs(self) -> int:
        """Number of legs N."""
        return len(self.leg_lengths)

    @property
    def _nominal(self) -> dict[str, Array]:
        points = (*self.guide_points.T, self.guide_angles, self.leg_lengths, *self.platform_points.T)
        return dict(zip(POINTS, points, strict=True))

    def _lay_out(self) -> None:
        """Say parameters, coordinates and channels.

        Per leg x_P, y_P, β, l, ξ_B, η_B and the zeros φ_0 and ψ_0 of its angle sensors; ξ_V, η_V of the tool.
        Carriages, angles to carriages and to the platform; then the tool's pose seen from beside the machine.
        """
        zeros = self._stand(self._nominal, self.home).angle
        unit = {"beta": "rad"}
        self.parameters = [
            *(
                ParameterBlock(name, tuple(one), unit.get(name, "mm"), lower=0.0 if name == "l" else -np.inf)
                for name, one in self._nominal.items()
            ),
            ParameterBlock("phi0", tuple(zeros), "rad"),
            ParameterBlock("psi0", tuple(zeros + self.guide_angles - self.home[2]), "rad"),
            ParameterBlock("xi_V", (float(self.tool_point[0]),), per_leg=False),
            ParameterBlock("eta_V", (float(self.tool_point[1]),), per_leg=False),
        ]
        kinds = zip(("x", "y", "phi"), ("mm", "mm", "rad"), self.home, strict=True)
        self.coordinates = [Coordinate(name, unit, float(home), reach=0.0) for name, unit, home in kinds]
        self.channels = [
            *(Channel(f"{kind}[{k + 1}]", unit) for kind, unit in KINDS.items() for k in range(self.n_legs)),
            *(Channel(name, "rad" if name == "phi_V" else "mm", external=True) for name in TOOL),
        ]

    def frame_parameters(self) -> tuple[str, ...]:
        """Return x_P1, y_P1 and β_1, which place the base frame, and ξ_B1, η_B1, η_B2, which place the platform's."""
        return ("x_P[1]", "y_P[1]", "beta[1]", "xi_B[1]", "eta_B[1]", "eta_B[2]")

    # --- readings ------------------------------------------------------------------------------------------------

    def _stand(self, parameters: Mapping[str, np.ndarray], pose: np.ndarray) -> _Legs:
        # legs first inside, for NumPy is slow where the last axis is short
        x_p, y_p, beta, length, xi, eta = (legs_first(parameters[name], pose.ndim) for name in POINTS)
        cosine, sine = np.cos(pose[..., 2]), np.sin(pose[..., 2])
        arm_x, arm_y = cosine * xi - sine * eta, sine * xi + cosine * eta
        w_x, w_y = pose[..., 0] + arm_x - x_p, pose[..., 1] + arm_y - y_p
        e_x, e_y = np.cos(beta), np.sin(beta)
        across = e_x * w_y - e_y * w_x
        with np.errstate(invalid="ignore"):
            size = sqrt(length * length - across * across)
        acute, forward = atan2(across, size), legs_first(self.forward, size.ndim)
        angle = np.where(forward, acute, np.pi - acute)
        return _Legs(e_x * w_x + e_y * w_y, across, np.where(forward, size, -size), angle, (arm_x, arm_y), (e_x, e_y))

    def read(self, parameters: Parameters, v: np.ndarray, given: Given) -> np.ndarray:
        """Return what carriages and angle sensors read, then the tool's pose."""
        del given
        legs = self._stand(parameters, v)
        phi, psi, beta = (legs_first(parameters[name], v.ndim) for name in ("phi0", "psi0", "beta"))
        own = (legs.reach - legs.along, legs.angle - phi, legs.angle + beta - v[..., 2] - psi)
        seen = np.broadcast_arrays(*self._place(parameters, v), v[..., 2], legs.angle[0])[:3]
        return np.moveaxis(np.concatenate([*own, np.stack(seen)]), 0, -1)

    def _place(self, parameters: Parameters, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the tool's centre V = p + R(φ) (ξ_V, η_V), x and y."""
        cosine, sine = np.cos(v[..., 2]), np.sin(v[..., 2])
        xi, eta = parameters["xi_V"], parameters["eta_V"]
        return v[..., 0] + cosine * xi - sine * eta, v[..., 1] + sine * xi + cosine * eta

    def tool(self, parameters: Parameters, v: np.ndarray) -> np.ndarray:
        """Return the tool's centre."""
        return np.stack(np.broadcast_arrays(*self._place(parameters, v)), axis=-1)

    def rotation(self, v: np.ndarray) -> np.ndarray:
        """Return R(φ)."""
        return matrix_of_angle(v[..., 2])

    # --- checks --------------------------------------------------------------------------------------------------

    def check_poses(self, pose: Array, name: Callable[[int], str] = lambda k: f"pose {k + 1}") -> None:
        """Raise InputError where a leg of the nominal machine does not reach a pose, shape (P, 3), or legs cross."""
        legs = self._stand(self._nominal, pose)
        short = ~np.isfinite(legs.along)
        if short.any():
            k, leg = np.argwhere(short.T)[0]
            raise InputError(
                f"machine {self.name!r}: {name(int(k))}: leg {leg + 1}: found "
                f"{abs(legs.across[leg, k]):.4g} mm from its guide, expected at most "
                f"{self.leg_lengths[leg]:g} mm"
            )
        e_x, e_y = legs.guide
        ends = pose[..., :2] + np.stack(legs.arm, axis=-1)
        foot = ends - legs.along[..., None] * np.stack([e_x, e_y], axis=-1)
        foot -= legs.across[..., None] * np.stack([-e_y, e_x], axis=-1)
        for i, j in combinations(range(self.n_legs), 2):
            crossed = np.flatnonzero(segments_cross(foot[i], ends[i], foot[j], ends[j]))
            if len(crossed):
                raise InputError(f"machine {self.name!r}: {name(int(crossed[0]))}: legs {i + 1} and {j + 1} cross")


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
