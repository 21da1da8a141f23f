"""A hexapod on six struts that its own weight bends and temperature stretches, as a telescope's secondary mirror has.

Strut i runs from the base joint A_i to the platform joint B_i = p + R b_i. Its actuator reads q_i, and without load and
at the reference temperature the strut is l_i + q_i long. Under its tension t_i, and warmer by ΔT, it is

    |B_i - A_i| = (l_i + q_i)(1 + ε_s ΔT) + c_i t_i,

with the expansion ε_s of the struts and their compliances c_i. The tensions are those of statics, for six struts do not
ask for stiffnesses: with the struts' directions u_i, the weight W g and its arm R g_c from the platform's origin

    Σ t_i u_i = W g(E),    Σ t_i (R b_i) × u_i = (R g_c) × W g(E),    g(E) = sin E g_zenith + cos E g_horizon,

where E is the elevation to which the telescope points. Base and platform grow by ε_b ΔT and ε_p ΔT about their origins.

What carries the base gives, too: the base is displaced by sag cos E + lift (1 - sin E) + drift ΔT, three lengths and
three small angles each, zero at the zenith and at the reference temperature.

The pose v is position and rotation vector of the platform in the frame of what the base is mounted to, which an
instrument that stands there reads as it is.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from pydantic import Field, field_validator

from bayescal.config.sections import Number, Positive, Section, Vector
from bayescal.errors import InputError
from bayescal.machines.parameters import ParameterBlock
from bayescal.machines.readings.base import POSE, POSE_CHANNELS, Channel, Coordinate, Given
from bayescal.machines.readings.function import Parameters, ReadingMachine
from bayescal.numerics.analytic import norm, rotation_matrix
from bayescal.numerics.geometry import Array, compute_left_jacobian, skew_matrix

GRAVITY = 9.80665
N_STRUTS = 6
PER_MILLION = 1e-6
NM = 1e-6  # in mm
ELEVATION, TEMPERATURE = "elevation_deg", "temperature_c"
EXPANSIONS = ("e_s", "e_b", "e_p")
UPRIGHT = 90.0  # elevation of the zenith, degrees
LONGEST_RADIANS = 1.6  # a right angle and what rounding adds
HOTTEST = 100.0  # °C on no telescope; kelvins are more
LEAST_CHANGE = {ELEVATION: 0.5, TEMPERATURE: 0.05}  # deg and K, less of which is none

type Points = Annotated[list[Vector], Field(min_length=N_STRUTS, max_length=N_STRUTS)]


class StrutMachineConfig(Section):
    """A hexapod on six struts with its weight, stiffness and expansion."""

    base_mm: Points
    """Joints of the base, its frame."""
    platform_mm: Points
    """Joints of the platform, its frame."""
    home_mm: Vector
    """Where the platform's origin is at home, base frame; the platform is parallel to the base there."""
    workspace_half_width_mm: Annotated[list[Positive], Field(min_length=3, max_length=3)]
    """Half widths of the workspace in x, y and z."""
    workspace_half_width_deg: Annotated[list[Positive], Field(min_length=3, max_length=3)]
    """Half widths of the workspace about x, y and z."""
    mass_kg: Positive
    """Mass that the struts carry."""
    centre_of_gravity_mm: Vector
    """Where its centre of gravity is, platform frame."""
    down_at_zenith: Vector = Field(default=[0.0, 0.0, -1.0])
    """Where gravity points when the telescope looks at the zenith, base frame; of any length [1]."""
    down_at_horizon: Vector = Field(default=[0.0, -1.0, 0.0])
    """Where gravity points when the telescope looks at the horizon, base frame; at right angles to the former [1]."""
    stiffness_n_per_um: Positive
    """Axial stiffness of a strut with its joints."""
    strut_expansion_per_million: Number = 11.5
    """Expansion of the struts, in millionths per K."""
    base_expansion_per_million: Number = 11.5
    """Expansion of the base, in millionths per K."""
    platform_expansion_per_million: Number = 11.5
    """Expansion of the platform, in millionths per K."""
    reference_c: Annotated[float, Field(ge=-100.0, le=100.0)]
    """Temperature at which lengths and joints are as stated [°C]."""

    @field_validator("down_at_zenith", "down_at_horizon")
    @classmethod
    def _check_direction(cls, value: list[float]) -> list[float]:
        if not any(value):
            raise ValueError("found a zero vector, expected a direction")
        return value


@dataclass(frozen=True, eq=False)
class _Stand:
    """Struts of a platform that stands.

    Lengths l (..., 6), directions u and arms R b (..., 6, 3); ``centre`` is the arm R g_c, ``force`` the weight
    (..., 3); ``grasp`` (..., 6, 6) has the struts' screws as columns, ``tension`` (..., 6) is in N, ``growth`` is
    1 + ε_s ΔT.
    """

    length: np.ndarray
    directions: np.ndarray
    arms: np.ndarray
    centre: np.ndarray
    force: np.ndarray
    grasp: np.ndarray
    tension: np.ndarray
    growth: np.ndarray


class StrutMachine(ReadingMachine):
    """A hexapod on struts with encoders, seen or not by an instrument, at known elevations and temperatures."""

    Config = StrutMachineConfig
    member = "strut"
    given = (ELEVATION, TEMPERATURE)

    def __init__(self, config: StrutMachineConfig) -> None:
        """Lay out parameters, coordinates and channels."""
        base, platform, home = (np.array(one) for one in (config.base_mm, config.platform_mm, config.home_mm))
        self.down = _check_down(config.down_at_zenith, config.down_at_horizon)
        self.weight, self.reference = config.mass_kg * GRAVITY, config.reference_c
        lengths = np.linalg.norm(home + platform - base, axis=1)
        self.parameters = [
            *(ParameterBlock(f"a_{axis}", tuple(one)) for axis, one in zip("xyz", base.T, strict=True)),
            *(ParameterBlock(f"b_{axis}", tuple(one)) for axis, one in zip("xyz", platform.T, strict=True)),
            ParameterBlock("l", tuple(lengths)),
            ParameterBlock("c", (1e3 / config.stiffness_n_per_um,) * N_STRUTS, "nm/N", lower=0.0),
            *(_single(f"g_{axis}", one, "mm") for axis, one in zip("xyz", config.centre_of_gravity_mm, strict=True)),
            _single("e_s", config.strut_expansion_per_million, "1e-6/K"),
            _single("e_b", config.base_expansion_per_million, "1e-6/K"),
            _single("e_p", config.platform_expansion_per_million, "1e-6/K"),
            *(
                _single(f"{what}_{axis}", 0.0, unit)
                for what in ("sag", "lift")
                for axis, unit in _list_axes("mm", "rad")
            ),
            *(_single(f"drift_{axis}", 0.0, unit) for axis, unit in _list_axes("um/K", "urad/K")),
        ]
        reach = [*config.workspace_half_width_mm, *np.deg2rad(config.workspace_half_width_deg)]
        self.coordinates = [
            Coordinate(axis, unit, float(at), float(half))
            for (axis, unit), at, half in zip(_list_axes("mm", "rad"), [*home, 0.0, 0.0, 0.0], reach, strict=True)
        ]
        self.channels = [
            *(Channel(f"q[{k}]", "mm") for k in range(1, N_STRUTS + 1)),
            *POSE_CHANNELS,
        ]
        self.tool_channels = POSE_CHANNELS

    def read(self, parameters: Parameters, v: np.ndarray, given: Given) -> np.ndarray:
        """Return what the six actuators read, then the pose."""
        at = self._stand(parameters, v, given)
        q = (at.length - NM * parameters["c"] * at.tension) / at.growth - parameters["l"]
        shape = np.broadcast_shapes(q.shape[:-1], v.shape[:-1])
        return np.concatenate([np.broadcast_to(one, (*shape, N_STRUTS)) for one in (q, v)], axis=-1)

    def _stand(self, parameters: Parameters, v: np.ndarray, given: Given) -> _Stand:
        """Return lengths and tensions of the struts where the platform stands."""
        warmer = np.asarray(given[TEMPERATURE]) - self.reference
        elevation = np.deg2rad(np.asarray(given[ELEVATION]))
        rotation = rotation_matrix(v[..., 3:])
        arms = _turn(rotation, _grow(parameters, "b", "e_p", warmer))
        span = v[..., None, :3] + arms - self._carry_base(parameters, elevation, warmer)
        length = norm(span)
        u = span / length[..., None]
        zenith, horizon = self.down
        force = self.weight * (np.sin(elevation)[..., None] * zenith + np.cos(elevation)[..., None] * horizon)
        centre = np.stack([parameters[f"g_{axis}"] for axis in "xyz"], axis=-1)
        centre = _turn(rotation, centre[..., None, :])[..., 0, :]
        moment = _cross(centre, force)
        wrench = np.concatenate([np.broadcast_to(force, moment.shape), moment], axis=-1)
        grasp = np.swapaxes(np.concatenate([u, _cross(arms, u)], axis=-1), -1, -2)
        tension = _solve(grasp, wrench[..., None])[..., 0]
        growth = (1.0 + PER_MILLION * parameters["e_s"] * warmer)[..., None]
        return _Stand(length, u, arms, centre, force, grasp, tension, growth)

    def _carry_base(self, parameters: Parameters, elevation: np.ndarray, warmer: np.ndarray) -> np.ndarray:
        """Return the base's joints where what carries it has them, (..., 6, 3)."""
        points = _grow(parameters, "a", "e_b", warmer)
        across, up = np.cos(elevation)[..., None], (1.0 - np.sin(elevation))[..., None]
        move = across * _six(parameters, "sag") + up * _six(parameters, "lift")
        drift = PER_MILLION * warmer[..., None] * _six(parameters, "drift")
        shift, turn = move[..., :3] + 1e3 * drift[..., :3], move[..., 3:] + drift[..., 3:]
        return points + shift[..., None, :] + _cross(turn[..., None, :], points)

    # --- by the pose ---------------------------------------------------------------------------------------------

    def slopes(self, parameters: Parameters, v: np.ndarray, given: Given) -> Sequence[Sequence[np.ndarray | float]]:
        """Return ∂h/∂v in closed form: G ∂t/∂v = ∂w/∂v - (∂G/∂v) t for the tensions of G t = w."""
        at = self._stand(parameters, v, given)
        tighter = _solve(at.grasp, _change_load(at))
        longer = np.swapaxes(at.grasp, -1, -2)  # ∂l/∂(p, ω), ω turning in the base's frame: the struts' screws
        by_motion = (longer - NM * parameters["c"][..., None] * tighter) / at.growth[..., None]
        by_vector = by_motion[..., 3:] @ compute_left_jacobian(np.nan_to_num(v[..., 3:]))
        every = np.concatenate([by_motion[..., :3], by_vector], axis=-1)
        own = [[every[..., k, i] for i in range(6)] for k in range(N_STRUTS)]
        return [*own, *([float(i == k) for i in range(6)] for k in range(6))]

    # --- what is known of each pose --------------------------------------------------------------------------------

    def check_given(self, poses: Sequence[str], given: Mapping[str, Array], free: Sequence[str]) -> None:
        """Raise InputError for elevations and temperatures that are none, or that do not tell what is free."""
        elevation, temperature = given[ELEVATION], given[TEMPERATURE]
        if 0.0 < elevation.max(initial=0.0) <= LONGEST_RADIANS:
            raise InputError(f"{ELEVATION}: found none above {elevation.max():g}, expected degrees")
        for k in np.flatnonzero(~((elevation >= 0.0) & (elevation <= UPRIGHT)))[:1]:
            raise InputError(f"pose {poses[k]!r}: {ELEVATION}: found {elevation[k]:g}, expected 0 to 90 degrees")
        for k in np.flatnonzero(~(np.abs(temperature) <= HOTTEST))[:1]:
            raise InputError(
                f"pose {poses[k]!r}: {TEMPERATURE}: found {temperature[k]:g}, expected °C; kelvins perhaps"
            )
        _check_told(ELEVATION, elevation, free, ("c[", "sag_", "lift_"))
        _check_told(TEMPERATURE, temperature, free, (*EXPANSIONS, "drift_"))


def _check_down(zenith: Sequence[float], horizon: Sequence[float]) -> tuple[Array, Array]:
    """Return the two directions of gravity as unit vectors; InputError where they are not at right angles."""
    one, other = (np.array(v) / np.linalg.norm(v) for v in (zenith, horizon))
    if abs(one @ other) > 1e-6:
        raise InputError(
            f"down_at_horizon: found {np.degrees(np.arccos(one @ other)):.1f} degrees from down_at_zenith, expected 90"
        )
    return one, other


def _check_told(column: str, values: Array, free: Sequence[str], starts: tuple[str, ...]) -> None:
    """Raise InputError where a column is constant while something is free that only its changes tell."""
    asked = [name for name in free if name.startswith(starts)]
    if asked and np.ptp(values) < LEAST_CHANGE[column]:
        raise InputError(f"{column}: found {values[0]:g} at every pose, expected several values, or {asked[0]} fixed")


def _single(symbol: str, value: float, unit: str) -> ParameterBlock:
    return ParameterBlock(symbol, (value,), unit, per_leg=False)


def _list_axes(length: str, angle: str) -> list[tuple[str, str]]:
    return [(axis, length if k < 3 else angle) for k, axis in enumerate(POSE)]


def _six(parameters: Parameters, what: str) -> np.ndarray:
    return np.stack([parameters[f"{what}_{axis}"] for axis in POSE], axis=-1)


def _change_load(at: _Stand) -> np.ndarray:
    """Return ∂w/∂(p, ω) - Σ ∂g/∂(p, ω) t for the struts' screws g = (u, a × u) with arms a, shape (..., 6, 6).

    ∂u = (1 - u uᵀ) (∂p - a × ∂ω) / l, so that with T = t / l the sum over struts is that of
    T [1, -[a]; [a], -[a]²] - T g gᵀ, and of t [u] [a], for the arms turn; the weight's moment turns by [f] [c].
    """
    pull = at.tension / at.length
    result = (at.grasp * pull[..., None, :]) @ np.swapaxes(at.grasp, -1, -2)
    heavy = pull[..., None] * at.arms
    across = skew_matrix(heavy.sum(axis=-2))
    diagonal = np.arange(3)
    result[..., diagonal, diagonal] -= pull.sum(axis=-1)[..., None]
    result[..., :3, 3:] += across
    result[..., 3:, :3] -= across
    turn = np.swapaxes(heavy, -1, -2) @ at.arms - np.swapaxes(at.tension[..., None] * at.arms, -1, -2) @ at.directions
    turn += at.centre[..., :, None] * at.force[..., None, :]
    # [a] [b] = b aᵀ - (a · b) 1, of every product alike
    turn[..., diagonal, diagonal] -= np.trace(turn, axis1=-2, axis2=-1)[..., None]
    result[..., 3:, 3:] += turn
    return result


def _grow(parameters: Parameters, symbol: str, expansion: str, warmer: np.ndarray) -> np.ndarray:
    """Return the joints of base or platform as temperature has them, (..., 6, 3)."""
    points = np.stack([parameters[f"{symbol}_{axis}"] for axis in "xyz"], axis=-1)
    return points * (1.0 + PER_MILLION * parameters[expansion] * warmer)[..., None, None]


def _turn(rotation: np.ndarray, vectors: np.ndarray) -> np.ndarray:
    """Return vectors (..., n, 3) turned by rotations (..., 3, 3)."""
    return vectors @ np.swapaxes(rotation, -1, -2)


def _cross(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Return the cross product of vectors (..., 3), which `numpy.cross` takes longer for."""
    x, y, z = (one[..., k] for k in range(3))
    u, v, w = (other[..., k] for k in range(3))
    return np.stack([y * w - z * v, z * u - x * w, x * v - y * u], axis=-1)


def _solve(matrix: np.ndarray, columns: np.ndarray) -> np.ndarray:
    """Return X of matrix (..., 6, 6) times X = columns (..., 6, n); NaN where any is singular."""
    try:
        return np.linalg.solve(matrix, columns)
    except np.linalg.LinAlgError:
        return np.full(np.broadcast_shapes(matrix.shape[:-2], columns.shape[:-2]) + columns.shape[-2:], np.nan)
