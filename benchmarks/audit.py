"""Time of an audit, and of a thousand designs one after the other; derivatives against differences of readings.

    python benchmarks/audit.py [--points 1000]

The telescope's 6-PUS with all its 60 parameters at 40 poses: the audit without its report (structure, information,
ridges, requirements over 200 poses, what-ifs and sweeps), what the plan tells alone, and designs that differ in the
number of poses, their spread and the noise. The derivatives of the readings are timed against central differences,
batched too, of the same machine and poses. One core.
"""

# ruff: noqa: I001 - telescope_problem comes before NumPy: it sets the number of threads
from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from pathlib import Path

from telescope_problem import write_results

import numpy as np

from bayescal.experiments.audit.audit import analyse, run_audit
from bayescal.experiments.audit.audit import evaluate_change
from bayescal.experiments.audit.design import load_audit, read_plans
from bayescal.experiments.audit.planned import DesignVariant
from bayescal.experiments.audit.schema import ScenarioConfig
from bayescal.experiments.runner.parallel import Run
from bayescal.numerics.geometry import Array

DESIGN = Path(__file__).parent.parent / "experiments" / "audit" / "telescope_six_pus_none.toml"
STEP = 1e-4  # of a tolerance
REPEATS = 5


def differentiate(plan: DesignVariant) -> Array:
    """Return the derivative of the readings by the free parameters from central differences, (P, K, n)."""
    sampling, variant, n = plan.posterior.sampling, plan.variant, len(plan.names)
    ends = [
        variant.model.read(sampling.theta_from_y(sign * STEP * np.eye(n))[:, None], variant.start) for sign in (1, -1)
    ]
    return np.moveaxis(ends[0] - ends[1], 0, -1) / (2 * STEP)


def time_it[T](function: Callable[[], T], repeats: int) -> tuple[float, T]:
    """Return the median time of a call in seconds, and what it returned."""
    times = []
    for _ in range(repeats):
        began = time.perf_counter()
        result = function()
        times.append(time.perf_counter() - began)
    return float(np.median(times)), result


def run(points: int) -> dict[str, object]:
    """Time everything once, print and return the figures."""
    (inputs,) = read_plans(load_audit(DESIGN), DESIGN.parent).values()
    model, theta, moved = (
        inputs.variant.model,
        inputs.posterior.sampling.start,
        inputs.posterior.around(inputs.expected)[1],
    )
    exact_time, exact = time_it(lambda: model.linearise(theta, inputs.variant.start).by_parameters @ moved, REPEATS)
    difference_time, difference = time_it(lambda: differentiate(inputs), REPEATS)
    apart = float(np.abs(exact - difference).max() / np.abs(exact).max())
    analyse_time, _ = time_it(lambda: analyse(inputs), REPEATS)
    audit_time, _ = time_it(lambda: run_audit(inputs, Run()), REPEATS)
    rng = np.random.default_rng(1)
    changes = [
        ScenarioConfig(
            name="",
            poses_factor=float(rng.uniform(0.3, 2.0)),
            workspace_factor=float(rng.uniform(0.3, 2.0)),
            noise_factor=float(10 ** rng.uniform(-1, 1)),
        )
        for _ in range(points)
    ]
    began = time.perf_counter()
    nats = [outcome.information.nats for c in changes if (outcome := evaluate_change(inputs, c, None)).information]
    sweep_time = time.perf_counter() - began
    figures: dict[str, object] = {
        "n_parameters": len(inputs.names),
        "n_poses": inputs.n_poses,
        "audit_seconds": audit_time,
        "analysis_seconds": analyse_time,
        "points": points,
        "points_evaluated": len(nats),
        "sweep_seconds": sweep_time,
        "jacobian_seconds": exact_time,
        "difference_seconds": difference_time,
        "jacobian_ratio": difference_time / exact_time,
        "largest_difference": apart,
    }
    for name, value in figures.items():
        print(f"{name:20s} {value:.3g}" if isinstance(value, float) else f"{name:20s} {value}")
    return figures


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--points", type=int, default=1000)
    print(f"wrote {write_results('audit', run(parser.parse_args().points), ())}")
