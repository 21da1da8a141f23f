"""Time of the batched NumPy likelihood against compiled loops of the same formula, one core.

    python benchmarks/likelihood.py [--repeats 200] [--name likelihood]

128 machines, 60 free parameters, 40 poses; without model error (one covariance for all machines) and with free model
errors per leg (a 6 x 6 Cholesky factor per machine and pose). The loops get what depends only on the data ready-made.
Results are compared before anything is timed; then all sides take turns, and medians count.
"""

# ruff: noqa: I001 - telescope_problem comes before NumPy and JAX: it sets the number of threads
from __future__ import annotations

import argparse
from collections.abc import Callable

from telescope_problem import SEED, Problem, simulate, time_interleaved, write_results  # first: sets one thread

import numpy as np
from numba_loops import STYLES, LoopData

from bayescal.geometry import Array

N_MACHINES = 128
AGREEMENT = 1e-9
SPREAD = 1e-3  # of the machines about the truth, in prior standard deviations
TAU = 5e-3  # mm


def loop_data(problem: Problem) -> LoopData:
    """Return the loops' view of a problem; reads what the likelihood has precomputed."""
    likelihood, poses = problem.likelihood(), problem.poses
    basis = problem.machine.basis(poses.actuators)
    arrays = (poses.position, poses.rotation, basis.displacement, basis.constant, likelihood._gain)
    arrays += (likelihood._known, likelihood.actuator_weight, likelihood._constant)
    return LoopData(*(np.ascontiguousarray(array) for array in arrays))


def draw_machines(problem: Problem) -> tuple[Array, Array]:
    """Return parameter vectors (B, 66) near the truth and model errors (B, 6) in mm."""
    rng = np.random.default_rng(SEED)
    coordinates = problem.posterior().coordinates
    theta = np.tile(problem.theta, (N_MACHINES, 1))
    theta[:, coordinates.free] += SPREAD * coordinates.scale * rng.normal(size=(N_MACHINES, len(coordinates.free)))
    return theta, TAU * np.abs(rng.normal(size=(N_MACHINES, problem.likelihood().n_legs)))


def build_contestants(problem: Problem) -> dict[str, dict[str, Callable[[], Array]]]:
    """Return the functions to time: case, then contestant; each returns the log-likelihoods (B,)."""
    likelihood, data = problem.likelihood(), loop_data(problem)
    theta, tau = draw_machines(problem)
    none = np.zeros(likelihood.n_legs)
    factor = np.linalg.cholesky(data.known)
    whitening = np.linalg.inv(factor)
    constant = data.log_constant - np.log(np.diagonal(factor, axis1=1, axis2=2)).sum(axis=1)
    pose = (data.position, data.rotation, data.displacement, data.constant, data.gain)
    fixed: dict[str, Callable[[], Array]] = {"numpy": lambda: likelihood(theta, none)}
    varying: dict[str, Callable[[], Array]] = {"numpy": lambda: likelihood(theta, tau)}
    for style, build in STYLES.items():
        for fastmath in (False, True):
            loop_fixed, loop_varying = build(fastmath)
            result = np.empty(N_MACHINES)

            def run_fixed(loop=loop_fixed, result=result):
                loop(theta, *pose, whitening, constant, result)
                return result

            def run_varying(loop=loop_varying, result=result):
                loop(theta, tau, *pose, data.known, data.weight, data.log_constant, result)
                return result

            name = f"numba {style}" + (" fastmath" if fastmath else "")
            fixed[name], varying[name] = run_fixed, run_varying
    return {"no model error": fixed, "model error per leg": varying}


def main() -> None:
    """Compare, time, print a table and write the results."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--repeats", type=int, default=200)
    parser.add_argument("--name", default="likelihood", help="name of the results' file")
    arguments = parser.parse_args()
    figures: dict[str, object] = {"n_machines": N_MACHINES, "repeats": arguments.repeats}
    for case, contestants in build_contestants(simulate()).items():
        expected = contestants["numpy"]()
        agreement = max(float(np.max(np.abs(f() / expected - 1.0))) for f in contestants.values())
        if not agreement < AGREEMENT:
            raise SystemExit(f"{case}: log-likelihoods differ by {agreement:.2g} (relative), expected < {AGREEMENT:g}")
        seconds = time_interleaved(contestants, arguments.repeats)
        time_us = {name: 1e6 * float(np.median(s)) / N_MACHINES for name, s in seconds.items()}
        # medians of the ratio within each round: what disturbs the machine disturbs both
        ratio = {name: float(np.median(np.array(seconds["numpy"]) / np.array(s))) for name, s in seconds.items()}
        print(f"{case:32}{'µs / machine':>14}{'NumPy / this':>14}")
        for name in time_us:
            print(f"  {name:30}{time_us[name]:14.2f}{ratio[name]:14.2f}")
        figures[case] = {
            "microseconds_per_machine": time_us,
            "numpy_over_numba": {name: value for name, value in ratio.items() if name != "numpy"},
            "largest_relative_difference": agreement,
        }
    print(write_results(arguments.name, figures, ("numpy", "numba")).name)


if __name__ == "__main__":
    main()
