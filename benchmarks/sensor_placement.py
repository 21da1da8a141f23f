"""Time to judge every set of sensors of the shipped experiments, against set by set with a calibration's own functions.

    python benchmarks/sensor_placement.py [--alone 200] [--workers 1 2]

Set by set, each is linearised anew, its poses are eliminated by complete QR decompositions, and the tool's covariance
is written out; a few random sets are timed so and must agree.
"""

# ruff: noqa: I001 - telescope_problem comes before NumPy: it sets the number of threads
from __future__ import annotations

import argparse
import time
from pathlib import Path

from telescope_problem import write_results

import numpy as np

from bayescal.experiments.frame.load import load_experiment
from bayescal.experiments.frame.engine import Processes
from bayescal.experiments.frame.parallel import Run
from bayescal.experiments.shared.sensor_sets import eliminate_poses
from bayescal.experiments.shared.sensor_sets import compute_tool_sensitivity
from bayescal.experiments.sensor_placement.alignment import take_away
from bayescal.experiments.sensor_placement.compute import CHUNK
from bayescal.experiments.sensor_placement.inputs import PlacementInputs, read_placement
from bayescal.experiments.sensor_placement.placement import (
    Accuracy,
    Placement,
    build_placement,
    evaluate_sets,
    is_external,
)

FOLDER = Path(__file__).parent.parent / "experiments" / "sliding_star"


def judge_alone(inputs: PlacementInputs, placement: Placement, chosen: np.ndarray) -> float:
    """Return the rms error of the tool's centre with chosen sensors, mm."""
    sensors, theta = inputs.sensors.select(np.flatnonzero(chosen)), inputs.model.layout.nominal
    rows = eliminate_poses(sensors.linearise(theta, inputs.pose))[..., inputs.free] * inputs.tolerances
    rows = rows.reshape(-1, rows.shape[-1])
    covariance = np.linalg.inv(np.eye(rows.shape[-1]) + rows.T @ rows)
    in_use = sensors.select(np.flatnonzero(~is_external(sensors)))
    found = compute_tool_sensitivity(in_use, theta, inputs.workspace)
    slope = (found.by_parameters[..., inputs.free] * inputs.tolerances).reshape(-1, rows.shape[-1])
    slope = take_away(placement.aligned, slope)
    square = np.einsum("ij,jk,ik->", slope, covariance, slope, optimize=True)
    return float(np.sqrt((square + np.trace(found.noise_covariance, axis1=1, axis2=2).sum()) / len(inputs.workspace)))


def run(name: str, n_alone: int, counts: list[int]) -> dict[str, object]:
    """Time one experiment, print and return the figures."""
    inputs = read_placement(load_experiment(FOLDER / f"{name}.toml"), FOLDER)
    placement, sets = build_placement(inputs), inputs.enumerate_sets() @ inputs.members
    chunks = {str(start): sets[start : start + CHUNK] for start in range(0, len(sets), CHUNK)}
    figures: dict[str, object] = {"sets": len(sets), "poses": len(inputs.pose), "parameters": len(inputs.free)}
    for workers in counts:
        began = time.perf_counter()
        judged = Run(Processes(workers)).map("sets of sensors", evaluate_sets, placement, chunks, (Accuracy,))
        found = [accuracy for chunk in judged.values() for accuracy in chunk]
        figures[f"seconds_{workers}"] = time.perf_counter() - began
    good = [k for k, accuracy in enumerate(found) if accuracy.reason == ""]
    some = np.random.default_rng(1).permutation(good)[:n_alone]
    began = time.process_time()
    alone = [judge_alone(inputs, placement, sets[k]) for k in some]
    figures["alone_seconds"] = (time.process_time() - began) / len(some) * len(sets)
    figures["largest_difference"] = max(abs(a / found[k].rms - 1.0) for a, k in zip(alone, some, strict=True))
    for label, value in figures.items():
        print(f"{name:20s} {label:20s} {value:.4g}")
    return {f"{name}_{label}": value for label, value in figures.items()}


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--alone", type=int, default=200, help="sets that are judged one by one")
    parser.add_argument("--workers", type=int, nargs="+", default=[1], help="numbers of processes to time")
    arguments = parser.parse_args()
    both = [run(name, arguments.alone, arguments.workers) for name in ("sensors", "m2_hexapod_sensors")]
    write_results("sensor_placement", both[0] | both[1], ("numpy",))
