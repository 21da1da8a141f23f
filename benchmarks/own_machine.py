"""Time of a machine of one function beside the same machine with derivatives by hand.

    python benchmarks/own_machine.py [--machines 64] [--poses 100]

Sliding Star, 15 readings of 3 coordinates and 34 parameters: readings and both Jacobians of a batch of machines at a
batch of poses, the one by complex step of the function that the tests state, the other by the shipped derivatives. Both
are timed one after the other in every round of the same run; it stops where they differ.
"""

# ruff: noqa: I001 - telescope_problem comes before NumPy: it sets the number of threads
from __future__ import annotations

import argparse
import sys
import time
from dataclasses import replace
from pathlib import Path

from telescope_problem import write_results

import numpy as np

from bayescal.machines.readings import ReadingModel
from bayescal.numerics.geometry import Array

sys.path.insert(0, str(Path(__file__).parent.parent / "tests"))
from function_machines import star_function
from sliding_platforms import WORKSPACE, sliding_star

REPEATS = 15
AGREEMENT = 1e-11  # of the largest entry


def linearise(model: ReadingModel, theta: Array, pose: Array, with_parameters: bool) -> tuple[float, list[Array]]:
    """Return the seconds that readings and Jacobians take, and them."""
    began = time.perf_counter()
    here = model.linearise(theta, pose, with_parameters)
    return time.perf_counter() - began, [here.values, here.by_pose, here.by_parameters]


def compare(n_machines: int, n_poses: int) -> dict[str, object]:
    """Time both, print and return the figures."""
    by_hand, rng = sliding_star(), np.random.default_rng(1)
    function = star_function(by_hand)
    pose = replace(WORKSPACE, n_poses=n_poses).draw(by_hand, rng)
    theta = by_hand.layout.nominal + 0.01 * rng.standard_normal((n_machines, 1, by_hand.layout.size))
    figures: dict[str, object] = {"machines": n_machines, "poses": n_poses, "rounds": len(function._all_steps.places)}
    for label, with_parameters in (("both", True), ("by_pose", False)):
        times = []
        for _ in range(REPEATS):
            own, found = linearise(function, theta, pose, with_parameters)
            hand, expected = linearise(by_hand, theta, pose, with_parameters)
            for one, other in zip(found, expected, strict=True):
                if one.size and np.abs(one - other).max() > AGREEMENT * np.abs(other).max():
                    raise SystemExit(f"{label}: the two differ by {np.abs(one - other).max():.3g}")
            times.append((own, hand))
        own, hand = np.median(times, axis=0)
        ratio = float(np.median([a / b for a, b in times]))
        figures |= {f"{label}_function_s": float(own), f"{label}_by_hand_s": float(hand), f"{label}_ratio": ratio}
    for name, value in figures.items():
        print(f"{name:24s} {value:.4g}")
    return figures


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--machines", type=int, default=64)
    parser.add_argument("--poses", type=int, default=100)
    arguments = parser.parse_args()
    write_results("own_machine", compare(arguments.machines, arguments.poses), ("numpy",))
