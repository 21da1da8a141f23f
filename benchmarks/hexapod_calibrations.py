"""Time of table 4's 2,000 calibrations, poses given, against a loop of scipy.optimize.least_squares.

    python benchmarks/hexapod_calibrations.py [--alone 3]

Four measurement conditions, five sets of poses each, a hundred machines each; unweighted least squares on all 42
parameters, as in the paper. SciPy gets the same residuals and derivatives, one machine at a time, and is timed on a few
machines of each set; without derivatives it takes differences. One core; times but batch_wall_s are those of the
processor, which other work on the machine does not change.
"""

# ruff: noqa: E402, I001 - telescope_problem comes before NumPy: it sets the number of threads; the paper's from beside
from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path

from telescope_problem import write_results

import numpy as np
from scipy.optimize import least_squares

from bayescal.experiments.runner.load import load_experiment
from bayescal.numerics.geometry import Array

EXPERIMENT = Path(__file__).parent.parent / "experiments" / "yu2023" / "table4.toml"
sys.path.insert(0, str(EXPERIMENT.parent))
from yu2023.least_squares import Weighting, calibrate, coordinates_from_pose, linearise, move, pose_from_coordinates
from yu2023.setup import CommandedPoses, Setup, noise_scale, read_setup

SETS = 5
REPEATS = 3


def fit_alone(setting: Setup, poses: CommandedPoses, measured: Array, with_derivatives: bool) -> Array:
    """Return one machine's parameters by SciPy, from nominal."""
    machine, actuators = setting.machine, poses.actuators[None]
    start = pose_from_coordinates(measured[None])

    def place(theta: Array) -> tuple[Array, Array]:
        position, rotation, _ = move(machine, theta[None], actuators, *start)
        return position, rotation

    def residual(theta: Array) -> Array:
        return (coordinates_from_pose(*place(theta)) - measured).ravel()

    def derivative(theta: Array) -> Array:
        rows, _ = linearise(machine, theta[None], actuators, *place(theta), measured[None])
        return rows.reshape(-1, len(theta))

    jacobian = derivative if with_derivatives else "2-point"
    return least_squares(residual, machine.layout.nominal, jac=jacobian, method="lm", xtol=1e-10).x


def run(n_alone: int) -> dict[str, object]:
    """Time everything, print and return the figures."""
    config = load_experiment(EXPERIMENT)
    setting = read_setup(config, EXPERIMENT.parent)
    rng = np.random.default_rng(1)
    machines = setting.draw_machines(config.study.parameter_sets, rng)
    problems = []
    for condition in config.study.conditions:
        noise = noise_scale(condition) * rng.standard_normal((condition.poses, 6))
        for _ in range(SETS):
            drawn = setting.draw_random(condition.poses, 1, rng)
            poses = CommandedPoses(drawn.coordinates[0], drawn.actuators[0])
            problems.append((poses, setting.reach_poses(machines, poses) + noise))
    times, walls = [], []
    for _ in range(REPEATS):
        began, wall = time.process_time(), time.perf_counter()
        found = [setting_calibrate(setting, poses, measured) for poses, measured in problems]
        times.append(time.process_time() - began)
        walls.append(time.perf_counter() - wall)
    batch = float(np.median(times))
    n = len(problems) * len(machines)
    figures: dict[str, object] = {"calibrations": n, "batch_s": batch, "batch_wall_s": float(np.median(walls))}
    for label, with_derivatives in (("derivatives", True), ("differences", False)):
        began, apart = time.process_time(), 0.0
        for (poses, measured), ours in zip(problems, found, strict=True):
            for k in range(n_alone):
                alone = fit_alone(setting, poses, measured[k], with_derivatives)
                apart = max(apart, float(np.abs(alone - ours[k]).max()))
        loop = (time.process_time() - began) / (n_alone * len(problems)) * n
        figures |= {f"scipy_{label}_s": loop, f"scipy_{label}_ratio": loop / batch, f"scipy_{label}_apart_mm": apart}
    for name, value in figures.items():
        print(f"{name:28s} {value:.4g}")
    return figures


def setting_calibrate(setting: Setup, poses: CommandedPoses, measured: Array) -> Array:
    """Return the parameters of all machines of a set."""
    return calibrate(setting.machine, poses.actuators, measured, Weighting(np.ones(6))).theta


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--alone", type=int, default=3, help="machines of each set that SciPy fits")
    write_results("hexapod_calibrations", run(parser.parse_args().alone), ("numpy", "scipy"))
