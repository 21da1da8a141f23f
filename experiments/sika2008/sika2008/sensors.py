"""Sensors of a machine, the poses and the tool that their readings tell, and residuals when no pose is known.

With whitened readings s, H = ∂h/∂v and A = ∂h/∂d of a pose, rows that an orthonormal basis Z of the left null space of
H takes are free of the pose: Zᵀ(s - h(v̂, d)) depends on the parameters alone, by -ZᵀA to first order. That is what a
machine tells of itself.

C = cond(JᵀJ) (Šika et al. 2008, eq. 6; Valášek, Šika and Hamrle 2007), J these rows: its condition depends on the units
in which lengths and angles are written, and so does C: in metres and radians it is not what it is in millimetres and
degrees. In units of the noise and of the tolerances it has a meaning: C_scaled is the ratio of the best to the least
known direction, in information gained for what was known a priori.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bayescal.errors import InputError, NumericalError
from bayescal.machines.readings import ReadingModel, Readings
from bayescal.numerics.geometry import Array

STEP_TOLERANCE = 1e-10  # mm and rad
SINGULAR_CONDITION = 1e8
DEGREE, MM_PER_METRE = float(np.pi / 180), 1000.0


@dataclass(frozen=True, eq=False)
class SensorSet:
    """Sensors that are used, each with its noise.

    Attributes
    ----------
    model : ReadingModel
        The machine with all sensors it could have.
    chosen : ndarray of int, shape (K,)
        Which of them are there.
    noise : ndarray, shape (K,)
        Their standard deviations, mm and rad.
    """

    model: ReadingModel
    chosen: np.ndarray
    noise: Array

    def __post_init__(self) -> None:
        """Check the noise."""
        for name, value in zip(self.names, self.noise, strict=True):
            if not 0.0 < value < np.inf:
                raise InputError(f"sensor {name}: found a noise of {value:g}, expected one above zero")

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the sensors."""
        return tuple(self.model.names[k] for k in self.chosen)

    @property
    def n_coordinates(self) -> int:
        """Number q of the pose's coordinates."""
        return len(self.model.pose_units)

    @property
    def redundancy(self) -> int:
        """How many more readings there are than the pose has coordinates."""
        return len(self.chosen) - self.n_coordinates

    def select(self, which: np.ndarray) -> SensorSet:
        """Return some of the sensors, by their places in this set."""
        return SensorSet(self.model, self.chosen[which], self.noise[which])

    def read(self, theta: Array, pose: Array) -> Array:
        """Return the readings of these sensors, (..., K), mm and rad."""
        return self.model.read(theta, pose)[..., self.chosen]

    def linearise(self, theta: Array, pose: Array, with_parameters: bool = True) -> Readings:
        """Return readings and derivatives in units of the noise."""
        found, scale = self.model.linearise(theta, pose, with_parameters), self.noise[:, None]
        by_parameters = found.by_parameters[..., self.chosen, :] / scale if with_parameters else found.by_parameters
        return Readings(
            found.values[..., self.chosen] / self.noise, found.by_pose[..., self.chosen, :] / scale, by_parameters
        )

    def check(self, n_poses: int, n_parameters: int) -> None:
        """Raise InputError where the set leaves fewer equations than unknowns."""
        n_equations = n_poses * max(self.redundancy, 0)
        if n_equations < n_parameters:
            raise InputError(
                f"sensors {', '.join(self.names)}: found {n_equations} equations ({n_poses} poses with "
                f"{len(self.chosen)} readings, less {self.n_coordinates} unknowns of each pose) "
                f"for {n_parameters} parameters, expected at least as many"
            )


@dataclass(frozen=True, eq=False)
class FreeParameters:
    """What is calibrated, about the machine as expected.

    Attributes
    ----------
    places : ndarray of int, shape (n,)
        Where they stand in the layout.
    centre : ndarray, shape (D,)
        The machine as expected, from which a calibration starts.
    scale : ndarray, shape (n,)
        Tolerances: standard deviations beforehand, mm and rad.
    """

    places: np.ndarray
    centre: Array
    scale: Array

    def draw(self, rng: np.random.Generator, n: int) -> Array:
        """Return machines within the tolerances, shape (n, D)."""
        theta = np.tile(self.centre, (n, 1))
        theta[:, self.places] += self.scale * rng.standard_normal((n, len(self.places)))
        return theta


@dataclass(frozen=True, eq=False)
class PoseFit:
    """Poses that readings were found to belong to.

    Attributes
    ----------
    pose : ndarray, shape (..., q)
        Least squares, mm and rad.
    error : ndarray, shape (..., K)
        What no pose explains, measured minus read, in units of the noise.
    converged : ndarray of bool, shape (...)
    n_iterations : int
    """

    pose: Array
    error: Array
    converged: np.ndarray
    n_iterations: int


def find_poses(
    sensors: SensorSet,
    theta: Array,
    measured: Array,
    start: Array,
    max_iterations: int = 30,
    check: bool = True,
) -> PoseFit:
    """Return the poses that explain readings best, by Gauss and Newton's method.

    Parameters
    ----------
    sensors : SensorSet
    theta : ndarray, shape (..., D)
        Parameters, broadcast against the leading axes of the readings.
    measured : ndarray, shape (..., K)
        Readings, mm and rad.
    start : ndarray, shape (..., q)
    max_iterations : int
    check : bool
        Raise where no pose is found; otherwise ``converged`` says so.

    Raises
    ------
    NumericalError
        Names the first pose that is not found.
    """
    shape = np.broadcast_shapes(theta.shape[:-1], measured.shape[:-1], start.shape[:-1])
    pose = np.broadcast_to(start, (*shape, start.shape[-1])).copy()
    white, converged, iteration = measured / sensors.noise, np.zeros(shape, dtype=bool), 0
    while True:
        here = sensors.linearise(theta, pose, with_parameters=False)
        error = white - here.values
        if converged.all() or iteration == max_iterations:
            break
        step = solve_least_squares(here.by_pose, error)
        pose = pose + np.where(converged[..., None], 0.0, step)
        converged = np.abs(step).max(axis=-1) < STEP_TOLERANCE
        iteration += 1
    converged &= np.isfinite(error).all(axis=-1)
    if check and not converged.all():
        place = int(np.argmin(converged.ravel()))
        raise NumericalError(
            f"pose {place % shape[-1] + 1}: no pose found for its readings, expected readings of this machine"
        )
    return PoseFit(pose, error, converged, iteration)


def solve_least_squares(jacobian: Array, right: Array) -> Array:
    """Return x, shape (..., q), with least |J x - r| for J (..., K, q) and r (..., K); NaN where J is singular."""
    scale = np.linalg.norm(jacobian, axis=-2)
    scaled = jacobian / np.where(scale > 0.0, scale, 1.0)[..., None, :]
    normal = np.swapaxes(scaled, -1, -2) @ scaled
    good = np.isfinite(normal).all(axis=(-1, -2))
    good &= np.abs(np.linalg.det(np.where(good[..., None, None], normal, 0.0))) > SINGULAR_CONDITION**-2
    side = np.einsum("...kq,...k->...q", scaled, right)
    safe = np.where(good[..., None, None], normal, np.eye(normal.shape[-1]))
    solved = np.linalg.solve(safe, np.nan_to_num(side)[..., None])[..., 0] / np.where(scale > 0.0, scale, 1.0)
    return np.where(good[..., None], solved, np.nan)


def null_basis(by_pose: Array) -> Array:
    """Return Zᵀ, orthonormal rows of the left null space of H (..., K, q), shape (..., K - q, K)."""
    finite = np.nan_to_num(by_pose)
    return np.swapaxes(np.linalg.qr(finite, mode="complete")[0][..., by_pose.shape[-1] :], -1, -2)


def eliminate_poses(here: Readings) -> Array:
    """Return ZᵀA, what readings say of the parameters when no pose is known, shape (..., K - q, D)."""
    return null_basis(here.by_pose) @ here.by_parameters


@dataclass(frozen=True, eq=False)
class ToolPositions:
    """The tool's centre at P poses of C machines.

    Attributes
    ----------
    position : ndarray, shape (C, P, m)
        mm, base frame.
    converged : ndarray of bool, shape (C, P)
    """

    position: Array
    converged: np.ndarray


def locate_tool(sensors: SensorSet, theta: Array, measured: Array, start: Array) -> ToolPositions:
    """Return the tool's centre that machines (C, D) make of readings (P, K) or (C, P, K), mm and rad."""
    found = find_poses(sensors, theta[:, None], measured, start, check=False)
    position, _, _ = sensors.model.tool(theta[:, None], found.pose)
    return ToolPositions(position, found.converged)


@dataclass(frozen=True, eq=False)
class ToolSensitivity:
    """How the tool's centre, as located from readings, errs to first order.

    Attributes
    ----------
    by_parameters : ndarray, shape (P, m, D)
        By an error of the parameters, the readings being right, mm.
    by_noise : ndarray, shape (P, m, K)
        By noise of the readings, in units of their standard deviations, mm.
    """

    by_parameters: Array
    by_noise: Array

    def covariance(self, places: np.ndarray, covariance: Array) -> Array:
        """Return the covariance of the tool's centre for that (n, n) of parameters at ``places``, (P, m, m), mm²."""
        slope = self.by_parameters[..., places]
        return np.asarray(slope @ covariance @ np.swapaxes(slope, -1, -2))

    @property
    def noise_covariance(self) -> Array:
        """Covariance of the tool's centre for the noise of the readings in use, (P, m, m), mm²."""
        return np.asarray(self.by_noise @ np.swapaxes(self.by_noise, -1, -2))


def compute_tool_sensitivity(sensors: SensorSet, theta: Array, pose: Array) -> ToolSensitivity:
    """Return how the tool's centre errs at poses (P, q) of one machine (D,)."""
    here = sensors.linearise(theta, pose)
    gain = np.linalg.pinv(here.by_pose)
    _, by_pose, by_parameters = sensors.model.tool(theta, pose)
    return ToolSensitivity(by_parameters - by_pose @ gain @ here.by_parameters, by_pose @ gain)


# --- calibrability ---------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Calibrability:
    """cond(JᵀJ) of one plan in different units.

    Attributes
    ----------
    metres_radians, millimetres_radians, millimetres_degrees : float
        Of the constraints as they stand, residuals and parameters in these units.
    scaled : float
        Residuals in units of the noise, parameters in units of their tolerances.
    """

    metres_radians: float
    millimetres_radians: float
    millimetres_degrees: float
    scaled: float


def in_units(sensors: SensorSet, length: float, angle: float) -> SensorSet:
    """Return the sensors with a length in mm and an angle in rad for noise, whatever their own."""
    units = [length if sensors.model.channels[k].unit == "mm" else angle for k in sensors.chosen]
    return SensorSet(sensors.model, sensors.chosen, np.array(units))


def compute_calibrability(sensors: SensorSet, free: FreeParameters, pose: Array) -> Calibrability:
    """Return the calibrability of the machine as expected at poses (P, q); infinite where a direction is not seen."""
    units = np.array(sensors.model.layout.units)[free.places]
    in_metres, in_degrees = np.where(units == "mm", MM_PER_METRE, 1.0), np.where(units == "mm", 1.0, DEGREE)
    return Calibrability(
        _condition(in_units(sensors, MM_PER_METRE, 1.0), free, pose, in_metres),
        _condition(in_units(sensors, 1.0, 1.0), free, pose, np.ones(len(units))),
        _condition(in_units(sensors, 1.0, DEGREE), free, pose, in_degrees),
        _condition(sensors, free, pose, free.scale),
    )


def _condition(sensors: SensorSet, free: FreeParameters, pose: Array, moves: Array) -> float:
    rows = eliminate_poses(sensors.linearise(free.centre, pose))[..., free.places] * moves
    count = len(moves)
    values = np.linalg.svd(rows.reshape(-1, count), compute_uv=False)
    return float((values[0] / values[-1]) ** 2) if len(values) == count and values[-1] > 0.0 else float("inf")
