"""The benchmarks' problem: a telescope's hexapod, 40 simulated poses, 60 free parameters.

Geometry and deformation matrix are those of RR-8096 (section 2.2, eq. 4); the true machine is a draw of the priors and
the poses are simulated, so that both sides of a benchmark work on the same well-posed posterior. Import this module
before NumPy: it keeps linear algebra on one core.
"""

from __future__ import annotations

import json
import os
import platform
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from importlib import metadata
from pathlib import Path

for _variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"):
    os.environ[_variable] = "1"

import numpy as np  # noqa: E402 - after the number of threads is set

from bayescal.data.measured_poses import MeasuredPoses  # noqa: E402
from bayescal.density.calibration.likelihood import CalibrationPosterior  # noqa: E402
from bayescal.density.calibration.model_error import RandomTerm  # noqa: E402
from bayescal.density.calibration.terms import ErrorModel  # noqa: E402
from bayescal.density.priors import NormalPrior  # noqa: E402
from bayescal.experiments.shared.pose_readings import build_pose_readings  # noqa: E402
from bayescal.files.csv_tables import read_matrix  # noqa: E402
from bayescal.machines.deformations import MatrixDeformation  # noqa: E402
from bayescal.machines.kinematics import Machine, solve_forward_kinematics  # noqa: E402
from bayescal.machines.models.six_pus import SixPus  # noqa: E402
from bayescal.machines.read import load_mechanism  # noqa: E402
from bayescal.machines.readings import Legs  # noqa: E402
from bayescal.numerics.geometry import Array, matrix_from_rotation_vector  # noqa: E402

RESULTS = Path(__file__).parent / "results"
SEED = 20240519
N_POSES = 40
ACTUATOR_NOISE = 1e-3  # mm
POSE_NOISE = np.array([3e-3, 3e-3, 1e-3, 1e-5, 1e-5, 1e-5])  # mm, rad
MODEL_ERROR_SCALE = 1e-2  # mm
FREE = ("a_x", "a_y", "a_z", "b_x", "b_y", "b_z", "u_x", "u_y", "l", "kappa")
PRIOR_SD = {"u_x": 0.05, "u_y": 0.05, "kappa": 0.01}  # everything else: 2 mm
LENGTH_SD = 2.0
TELESCOPE = Path(__file__).parents[1] / "experiments" / "telescope"


@dataclass(frozen=True, eq=False)
class Problem:
    """Simulated data and the truth behind them."""

    machine: Machine
    poses: MeasuredPoses
    theta: Array

    def priors(self) -> dict[str, NormalPrior]:
        """Return normal priors about the nominal values for all 60 parameters of `FREE`."""
        layout = self.machine.layout
        priors = {}
        for block in layout.blocks:
            if block.symbol in FREE:
                sd = PRIOR_SD.get(block.symbol, LENGTH_SD)
                priors |= {n: NormalPrior(x, sd) for n, x in zip(block.names, block.nominal, strict=True)}
        return priors

    def posterior(
        self, model_error: bool = False, priors: dict[str, NormalPrior] | None = None
    ) -> CalibrationPosterior:
        """Return the posterior about the machine that explains the poses, without model error or with one per leg."""
        own = np.eye(12, dtype=bool)[: 6 if model_error else 0]
        terms = [RandomTerm(f"tau[{leg}]", one, MODEL_ERROR_SCALE, "mm", np.ones(12)) for leg, one in enumerate(own, 1)]
        chosen = self.priors() if priors is None else priors
        found = build_pose_readings(
            Legs(self.machine), self.poses, ACTUATOR_NOISE, chosen, ErrorModel(tuple(terms)), {}
        ).posterior
        return replace(found, likelihood=replace(found.likelihood, straight=True)).with_pose_guesses()


def simulate(seed: int = SEED) -> Problem:
    """Draw a machine from the priors and measure it in 40 poses, every actuator at an end or in the middle."""
    rng = np.random.default_rng(seed)
    mechanism = load_mechanism(TELESCOPE / "mechanism.toml")
    matrix = 1e-3 * read_matrix(TELESCOPE / "deformation_matrix.csv", mechanism.n_legs)
    machine = Machine(mechanism, SixPus(), MatrixDeformation(matrix))
    layout = machine.layout
    theta = layout.nominal.copy()
    for symbol in FREE:
        theta[layout.index[symbol]] += rng.normal(size=6) * PRIOR_SD.get(symbol, LENGTH_SD)
    levels = rng.integers(-1, 2, size=(N_POSES, 6))
    actuators = mechanism.initial_actuator_positions + mechanism.actuator_range * levels
    reached = solve_forward_kinematics(machine, theta, actuators + rng.normal(size=levels.shape) * ACTUATOR_NOISE)
    noise = rng.normal(size=(N_POSES, 6)) * POSE_NOISE
    poses = MeasuredPoses(
        names=tuple(f"pose {k + 1}" for k in range(N_POSES)),
        position=reached.position + noise[:, :3],
        rotation=matrix_from_rotation_vector(noise[:, 3:]) @ reached.rotation,
        covariance=np.tile(np.diag(POSE_NOISE**2), (N_POSES, 1, 1)),
        actuators=actuators,
    )
    return Problem(machine, poses, theta)


def standardise(posterior: CalibrationPosterior) -> tuple[np.ndarray, Array, Array]:
    """Return where the free parameters stand, their means and their prior standard deviations, shapes (n,)."""
    free = posterior.sampling.free
    return free, posterior.sampling.start[free], np.array([prior.sd for prior in posterior.sampling.priors])


def time_interleaved(functions: dict[str, Callable[[], object]], n_repeats: int) -> dict[str, list[float]]:
    """Return the seconds of each repeat of each function, the functions taking turns."""
    for function in functions.values():
        function()
    seconds: dict[str, list[float]] = {name: [] for name in functions}
    for _ in range(n_repeats):
        for name, function in functions.items():
            start = time.perf_counter()
            function()
            seconds[name].append(time.perf_counter() - start)
    return seconds


def write_results(name: str, figures: dict[str, object], packages: tuple[str, ...]) -> Path:
    """Write figures with the versions they belong to; return the file."""
    versions = {package: metadata.version(package) for package in packages}
    context = {
        "date": datetime.now(UTC).date().isoformat(),
        "machine": f"{platform.machine()}, {os.cpu_count()} cores, one used",
        "versions": {"python": platform.python_version(), **versions},
    }
    RESULTS.mkdir(exist_ok=True)
    path = RESULTS / f"{name}.json"
    path.write_text(json.dumps({**context, **figures}, indent=2) + "\n")
    return path
