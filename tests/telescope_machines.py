"""Machines and data sets that the tests share: the telescope of RR-8096, random machines, simulated poses.

Figures of the telescope are those of RR-8096: its nominal geometry, table 3 and eq. 4 as they are shipped, table 7 a
here. Whatever is simulated here is a twin, never a measurement.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np

from bayescal.data.measured_poses import MeasuredPoses
from bayescal.density.calibration.likelihood import CalibrationPosterior
from bayescal.density.calibration.measurements import RowPositions
from bayescal.density.calibration.model_error import OwnChannelRows, RandomTerm, build_model_error
from bayescal.density.calibration.terms import NO_ERRORS, ErrorModel, ErrorTerm
from bayescal.density.outliers import NORMAL, Outliers
from bayescal.density.priors import NormalPrior, Prior
from bayescal.experiments.shared.pose_readings import build_pose_readings
from bayescal.files.csv_tables import read_matrix
from bayescal.machines.deformations import DEFORMATIONS, Deformation, NominalDeformation
from bayescal.machines.kinematics import Machine, solve_forward_kinematics
from bayescal.machines.mechanism import Flexures, Mechanism, section_of_rod
from bayescal.machines.models import MODELS, KinematicModel
from bayescal.machines.parameters import ParameterLayout
from bayescal.machines.read import load_mechanism
from bayescal.machines.readings import Legs
from bayescal.numerics.geometry import matrix_from_rotation_vector, rotation_vector_from_matrix

ACTUATOR_NOISE = 1e-3
ACTUATOR_RANGE = 1.3
INITIAL_POSITION = 10.0
HOME_HEIGHT = 497.41

SHIPPED = Path(__file__).parents[1] / "experiments" / "telescope"
TELESCOPE_MATRIX = 1e-3 * read_matrix(SHIPPED / "deformation_matrix.csv", 6)
TABLE_3 = read_matrix(SHIPPED / "calibration_configurations.csv", 6)
"""Displacements in units of the actuator range, legs 1 to 6."""
TABLE_7A = {
    "a_x": [-1.71, 0.41, 0.30, -1.58, -0.18, -0.34],
    "a_y": [-0.33, -0.21, -2.12, 0.37, 0.98, -2.62],
    "b_x": [0.56, 1.91, 0.04, 0.41, -1.82, -0.32],
    "b_y": [-0.19, -0.21, 2.25, 1.46, 0.61, -0.22],
    "l": [0.37, -0.45, 1.02, 0.25, 0.43, 0.58],
    "kappa": [9.58e-3, 1.98e-3, 4.43e-3, 3.33e-3, 0.67e-3, 6.99e-3],
}
FREE_SYMBOLS = {
    "none": ("a_x", "a_y", "b_x", "b_y", "l", "u_x"),
    "linear": ("a_x", "a_y", "b_x", "b_y", "l", "kappa"),
    "matrix": ("a_x", "a_y", "b_x", "b_y", "l", "kappa"),
}
SIX_LEGS_ONLY = ("stiffness", "stiffness_fixed")  # six equations of equilibrium
PERFECT_JOINTS = ("six_pus", "six_ups")  # nothing in these refers to the home pose
PRIOR_SD = {"u_x": 0.05, "u_y": 0.05, "u_z": 0.05, "u_h": 0.05, "u_v": 0.05, "kappa": 0.01}


def _polar(radius: float, azimuths: list[float]) -> np.ndarray:
    angle = np.radians(azimuths)
    return radius * np.stack([np.cos(angle), np.sin(angle), np.zeros_like(angle)], axis=1)


@cache
def _load_telescope() -> Mechanism:
    return replace(load_mechanism(SHIPPED / "mechanism.toml"), name="telescope")


def build_telescope(**changes: object) -> Mechanism:
    """Return the telescope's nominal geometry, with fields replaced by name."""
    return replace(_load_telescope(), **changes)


def build_flexures(n_legs: int, diameter: float = 1.0, leg_diameter: float = 10.0) -> Flexures:
    """Return steel flexures of 10 mm on steel legs, diameters in mm."""
    section, leg = section_of_rod(diameter, 200e3, 77e3), section_of_rod(leg_diameter, 200e3, 77e3)
    return Flexures(np.full(n_legs, 10.0), np.full(n_legs, 0.25), section, leg)


def build_random_mechanism(n_legs: int, seed: int) -> Mechanism:
    """Return a machine of tilted legs and actuators that closes at the pose (3, -2, 400) mm, level."""
    rng = np.random.default_rng(seed)
    azimuth = np.arange(n_legs) * 360.0 / n_legs + rng.uniform(-12, 12, n_legs)
    lower = _polar(160.0, list(azimuth)) + rng.normal(0, 10, (n_legs, 3))
    upper = _polar(110.0, list(azimuth + 40.0 * (-1.0) ** np.arange(n_legs))) + rng.normal(0, 10, (n_legs, 3))
    tilt = rng.normal(0, 0.1, (n_legs, 2))
    directions = np.column_stack([tilt, np.sqrt(1 - np.sum(tilt**2, axis=1))])
    initial = rng.uniform(5, 20, n_legs)
    home = np.array([3.0, -2.0, 400.0])
    return Mechanism(
        name=f"random {n_legs}",
        base_points=lower - initial[:, None] * directions,
        platform_points=upper,
        directions=directions,
        leg_lengths=np.linalg.norm(home + upper - lower, axis=1),
        initial_actuator_positions=initial,
        actuator_range=2.0,
        flexures=build_flexures(n_legs, diameter=1.5, leg_diameter=2.0),
    )


def put_on_struts(mechanism: Mechanism) -> Mechanism:
    """Return a machine with struts instead of a machine's legs at home."""
    still = np.zeros_like(mechanism.directions)
    return replace(mechanism, base_points=mechanism.home_joints, directions=still, drive="strut")


def build_hexapod(**changes: object) -> Mechanism:
    """Return struts between the telescope's joints at home, with fields of the telescope replaced by name."""
    return put_on_struts(build_telescope(**changes))


def spread_of(layout: ParameterLayout) -> np.ndarray:
    """Return how far each parameter is moved about nominal: 1 mm, 0.02, a tenth of a stiffness; shape (D,)."""
    scale = {"mm": 1.0, "1": 0.02}
    return np.array([scale.get(unit, 0.1 * value) for unit, value in zip(layout.units, layout.nominal, strict=True)])


def model_names() -> list[str]:
    """Return the names of all registered models."""
    return list(MODELS)


def model_cases(*n_legs: int) -> list[tuple[str, int]]:
    """Return the names of all registered models with the numbers of legs that they take."""
    return [(name, n) for name in MODELS for n in n_legs if n == 6 or name not in SIX_LEGS_ONLY]


def deformation_names() -> list[str]:
    """Return the names of all registered deformations but the free matrix, which nominally is none."""
    return [name for name in DEFORMATIONS if name != "free_matrix"]


def build_model(name: str, mechanism: Mechanism) -> KinematicModel:
    """Return a registered model of a mechanism."""
    return MODELS[name].from_mechanism(mechanism)


def build_deformation(name: str, n_legs: int = 6) -> Deformation:
    """Return a registered deformation with the telescope's figures, or a random K for other numbers of legs."""
    matrix = TELESCOPE_MATRIX if n_legs == 6 else np.random.default_rng(n_legs).normal(0, 0.012, (n_legs, n_legs))
    return DEFORMATIONS[name].from_nominal(NominalDeformation(0.011, lambda: matrix))


def build_machine(deformation: str = "matrix", mechanism: Mechanism | None = None, model: str = "six_pus") -> Machine:
    """Return a machine, its legs replaced by struts where the model takes these; without a mechanism, the telescope."""
    mechanism = mechanism or build_telescope()
    if MODELS[model].drive == "strut" and mechanism.drive == "base":
        mechanism = put_on_struts(mechanism)
    return Machine(mechanism, build_model(model, mechanism), build_deformation(deformation, mechanism.n_legs))


def telescope_truth(machine: Machine) -> np.ndarray:
    """Return the identified parameters of table 7 (a), shape (D,); kappa only if the machine has it."""
    theta = machine.layout.nominal.copy()
    for symbol, offset in TABLE_7A.items():
        if symbol in machine.layout.index:
            theta[machine.layout.index[symbol]] += offset
    return theta


def table_3_actuators() -> np.ndarray:
    """Return the actuator positions of table 3, shape (40, 6), mm."""
    return INITIAL_POSITION + ACTUATOR_RANGE * TABLE_3


def measurement_covariance(n_poses: int) -> np.ndarray:
    """Return full covariances of photogrammetry kind, 3 µm across and 10 µrad, correlated, shape (P, 6, 6)."""
    sd = np.array([3e-3, 3e-3, 1e-3, 1e-5, 1e-5, 1e-5])
    correlation = np.eye(6)
    correlation[0, 4] = correlation[4, 0] = 0.5
    correlation[1, 3] = correlation[3, 1] = -0.5
    correlation[0, 1] = correlation[1, 0] = 0.2
    return np.tile(correlation * np.outer(sd, sd), (n_poses, 1, 1))


def place_poses(machine: Machine, theta: np.ndarray, actuators: np.ndarray, error: np.ndarray) -> MeasuredPoses:
    """Return the predicted poses moved by pose errors (P, 6), with the usual covariance."""
    exact = solve_forward_kinematics(machine, theta, actuators)
    position = exact.position + error[:, :3]
    rotation = matrix_from_rotation_vector(error[:, 3:]) @ exact.rotation
    names = tuple(str(k + 1) for k in range(len(actuators)))
    return MeasuredPoses(names, position, rotation, measurement_covariance(len(actuators)), actuators)


def list_coordinates(poses: MeasuredPoses) -> np.ndarray:
    """Return measured poses as positions and rotation vectors, shape (P, 6)."""
    return np.concatenate([poses.position, rotation_vector_from_matrix(poses.rotation)], axis=1)


def find_pose_covariance(
    machine: Machine, theta: np.ndarray, poses: MeasuredPoses, tau: np.ndarray, noise: float = ACTUATOR_NOISE
) -> np.ndarray:
    """Return covariances of pose errors, (P, 6, 6): as measured, by actuators that are off, by legs that err.

    A leg's error moves the platform alone: unlike a displacement of its actuator it bends nothing at other legs.
    """
    basis = machine.basis(poses.actuators)
    alone = replace(basis, actuator_gain=basis.actuator_gain * np.eye(machine.mechanism.n_legs))
    here = machine.linearise(theta, poses.position, poses.rotation, poses.actuators)
    own = machine.model.linearise(machine.layout, theta, poses.position, poses.rotation, alone)
    inverse = np.linalg.pinv(here.pose)
    by_actuators, by_legs = inverse @ here.actuators * noise, inverse @ own.actuators * tau
    added = by_actuators @ np.swapaxes(by_actuators, 1, 2) + by_legs @ np.swapaxes(by_legs, 1, 2)
    return np.asarray(poses.covariance + added)


def simulate_poses(
    machine: Machine, theta: np.ndarray, actuators: np.ndarray, tau: np.ndarray, rng: np.random.Generator
) -> MeasuredPoses:
    """Return poses with the noise of the instrument and of the actuators, of legs that err by τ."""
    exact = place_poses(machine, theta, actuators, np.zeros((len(actuators), 6)))
    covariance = find_pose_covariance(machine, theta, exact, tau)
    normal = rng.standard_normal((len(actuators), 6, 1))
    error = (np.linalg.cholesky(covariance) @ normal)[..., 0]
    return place_poses(machine, theta, actuators, error)


def let_err(
    scale: float | None = 0.01, shared: bool = False, outliers: Outliers = NORMAL, n_legs: int = 6
) -> ErrorModel:
    """Return errors of legs of an unknown size, half normal in mm, each leg's or all alike; none without a scale."""
    every, levers = np.arange(n_legs + 6) < n_legs, np.ones(n_legs + 6)
    legs = {"tau": every} if shared else {f"tau[{k + 1}]": np.arange(n_legs + 6) == k for k in range(n_legs)}
    terms = [RandomTerm(name, own, scale, "mm", levers) for name, own in legs.items()] if scale else []
    return ErrorModel(tuple(terms), outliers)


def let_functions_err(
    machine: Machine, poses: MeasuredPoses, sorts: tuple[str, ...], scale: float = 0.02, *, few: bool = False
) -> tuple[ErrorTerm, ...]:
    """Return errors of legs that are functions of the pose; travel is counted in the actuators' whole range."""
    model, n = Legs(machine), machine.mechanism.n_legs
    data = measure(machine, poses, {}).likelihood.data
    home = np.append(machine.mechanism.initial_actuator_positions, np.zeros(6))
    reach = np.append(np.full(n, machine.mechanism.actuator_range), np.zeros(6))
    used = np.ones(poses.n_poses, dtype=bool)
    expected = model.read(model.layout.nominal, list_coordinates(poses))
    positions = RowPositions.find(model.channels, data, expected, home)
    own = OwnChannelRows.find(model, data, list_coordinates(poses), used, positions, reach)
    return build_model_error(own, n + 6, sorts, (0.01, scale), {}, each=False, few=few)


def measure(
    machine: Machine,
    poses: MeasuredPoses,
    priors: Mapping[str, Prior],
    errors: ErrorModel = NO_ERRORS,
    fixed: Mapping[str, float] | None = None,
    noise: float = ACTUATOR_NOISE,
) -> CalibrationPosterior:
    """Return the posterior of a machine on legs by poses measured of it."""
    found = build_pose_readings(Legs(machine), poses, noise, priors, errors, fixed or {}).posterior
    return replace(found, likelihood=replace(found.likelihood, straight=True))


def list_priors(machine: Machine, symbols: tuple[str, ...]) -> dict[str, Prior]:
    """Return normal priors of 2 mm (lengths), 0.01 (kappa) and 0.05 (directions) about nominal."""
    layout = machine.layout
    return {
        name: NormalPrior(value, PRIOR_SD.get(block.symbol, 2.0))
        for block in layout.blocks
        if block.symbol in symbols
        for name, value in zip(block.names, block.nominal, strict=True)
    }


def build_posterior(
    deformation: str,
    poses: MeasuredPoses,
    errors: ErrorModel = NO_ERRORS,
    symbols: tuple[str, ...] | None = None,
    machine: Machine | None = None,
) -> CalibrationPosterior:
    """Return the posterior of the telescope, or of another machine, with the priors of `list_priors`."""
    machine = machine or build_machine(deformation)
    return measure(machine, poses, list_priors(machine, symbols or FREE_SYMBOLS[deformation]), errors)


def central_difference(function, x: np.ndarray, step: np.ndarray) -> np.ndarray:
    """Return df/dx of an array function of a vector (n,), the derivative axis last."""
    columns = []
    for k in range(len(x)):
        change = np.zeros_like(x)
        change[k] = step[k]
        columns.append((function(x + change) - function(x - change)) / (2 * step[k]))
    return np.stack(columns, axis=-1)


def stencil_derivative(function, x: np.ndarray, step: np.ndarray) -> np.ndarray:
    """Return df/dx at a vector (n,) of a function of batches of vectors (K, n), the derivative axis last.

    Six points per entry leave out the sixth power of the step only, so that steps may be long and rounding small.
    """
    nodes, weights = np.array([-3, -2, -1, 1, 2, 3]), np.array([-1, 9, -45, 45, -9, 1]) / 60
    moved = x + np.einsum("k,ij->ikj", nodes, np.diag(step))
    values = function(moved.reshape(-1, len(x)))
    values = values.reshape(len(x), len(nodes), *values.shape[1:])
    return np.moveaxis(np.einsum("k,ik...->i...", weights, values), 0, -1) / step
