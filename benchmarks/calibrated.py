"""Time of a calibrated machine's use: 10,000 poses predicted with covariance, and commanded, in memory and by tables.

    python benchmarks/calibrated.py [--poses 10000]

The telescope with 60 uncertain parameters, by made-up draws about it, through each model with the matrix deformation;
the table's reading and writing beside it. How well the linearised covariance agrees with 2,000 draws is said, too. One
core.
"""

# ruff: noqa: I001 - telescope_problem comes before NumPy: it sets the number of threads
from __future__ import annotations

import argparse
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

from telescope_problem import write_results

import numpy as np

from bayescal.calibrated.machine import CalibratedMachine, Source, build_calibrated_legs, build_leg_errors
from bayescal.calibrated.predict import command_poses, draw_poses, predict_poses
from bayescal.calibrated.tables import format_command, format_prediction, read_commanded
from bayescal.files.csv_tables import read_matrix
from bayescal.machines.deformations import NominalDeformation
from bayescal.machines.read import build_named_machine, load_mechanism
from bayescal.numerics.geometry import compute_pose_error, matrix_from_rotation_vector

TELESCOPE = Path(__file__).parent.parent / "experiments" / "telescope"
MODELS = ("six_pus", "jacobian", "beam", "stiffness")
N_DRAWS = 2000


def build(model: str, rng: np.random.Generator) -> CalibratedMachine:
    """Return the telescope, calibrated to some micrometres, by made-up draws."""
    path = TELESCOPE / "mechanism.toml"
    nominal = NominalDeformation(0.0, lambda: 1e-3 * read_matrix(TELESCOPE / "deformation_matrix.csv", 6))
    machine = build_named_machine(load_mechanism(path), path, model, "matrix", nominal, "model", TELESCOPE)
    layout = machine.layout
    free = np.concatenate([layout.index[s] for s in layout.symbols if s[:2] in ("a_", "b_", "u_", "l", "rh", "ka")])
    scale = np.array([1e-5 if layout.units[k] == "1" else 3e-3 for k in free])
    draws = np.tile(layout.nominal, (N_DRAWS, 1))
    draws[:, free] += scale * rng.standard_normal((N_DRAWS, len(free)))
    errors = build_leg_errors(machine, layout.nominal, 1e-3, np.full(6, 1e-6))
    return build_calibrated_legs(machine, layout.nominal, draws, errors, Source("benchmark", model, "made up"))


def time_it[T](function: Callable[[], T]) -> tuple[float, T]:
    """Return the time of a call in seconds, and what it returned."""
    began = time.perf_counter()
    result = function()
    return time.perf_counter() - began, result


def run(model: str, n_poses: int) -> dict[str, float]:
    """Time one model, print and return the figures."""
    rng = np.random.default_rng(1)
    calibrated = build(model, rng)
    mechanism = load_mechanism(TELESCOPE / "mechanism.toml")
    span = mechanism.actuator_range * rng.uniform(-0.99, 0.99, (n_poses, 6))
    actuators, names = mechanism.initial_actuator_positions + span, [str(k) for k in range(n_poses)]
    seconds, found = time_it(lambda: predict_poses(calibrated, actuators))
    back_seconds, back = time_it(lambda: command_poses(calibrated, found.tool))
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "poses.csv"
        path.write_text(format_prediction(calibrated, names, found, {}))
        table_seconds, commanded = time_it(lambda: read_commanded(path, calibrated))
    table_seconds += time_it(lambda: format_prediction(calibrated, names, found, {}))[0]
    table_seconds += time_it(lambda: format_command(calibrated, commanded.names, back, {}))[0]
    few = actuators[:4]
    drawn = draw_poses(calibrated, few, N_DRAWS, rng)
    assert found.covariance is not None
    turned = matrix_from_rotation_vector(drawn[..., 3:])
    spread = compute_pose_error(drawn[..., :3], turned, found.position[:4], found.rotation[:4]).std(axis=0)
    ratio = spread / np.sqrt(np.diagonal(found.covariance[:4], axis1=1, axis2=2))
    figures = {
        "predict_seconds": seconds,
        "command_seconds": back_seconds,
        "tables_seconds": table_seconds,
        "there_and_back_mm": float(np.abs(back.commands - actuators).max()),
        "sd_of_draws_by_linearised_min": float(ratio.min()),
        "sd_of_draws_by_linearised_max": float(ratio.max()),
    }
    print(f"{model}: " + ", ".join(f"{key} {value:.3g}" for key, value in figures.items()))
    return figures


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--poses", type=int, default=10_000)
    parser.add_argument("--name", default="calibrated")
    arguments = parser.parse_args()
    write_results(arguments.name, {model: run(model, arguments.poses) for model in MODELS}, ("numpy", "scipy"))
