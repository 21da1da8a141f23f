"""Time of the batched NumPy likelihood: of every model, and against compiled loops of the same formula, one core.

    python benchmarks/likelihood.py [--repeats 200] [--name likelihood]
    python benchmarks/likelihood.py --models [--repeats 200] [--name models]

Loops: 128 machines, 60 free parameters, 40 poses; without model error (one covariance for all machines) and with free
model errors per leg (a 6 x 6 Cholesky factor per machine and pose). The loops get what depends only on the data
ready-made. Results are compared before anything is timed; then all sides take turns, and medians count.

Models (needs no Numba): the same poses seen by every model with deformation matrix, in batches of the likelihood's
own size; µs per machine without and with model errors, the exact derivative of the leg errors of one machine in
ms, and the forward kinematics of 10,000 poses in s. The best of the repeats counts, and medians of the ratio to the
6-PUS within each round.
"""

# ruff: noqa: I001 - telescope_problem comes before NumPy and JAX: it sets the number of threads
from __future__ import annotations

import argparse
from collections.abc import Callable
from typing import TYPE_CHECKING

from telescope_problem import ACTUATOR_NOISE, SEED, Problem, simulate, time_interleaved, write_results  # first: threads

import numpy as np

from bayescal.numerics.geometry import Array
from bayescal.machines.kinematics import Machine, solve_forward_kinematics
from bayescal.density.legs import BATCH
from bayescal.density.pose_likelihood import PoseLikelihood
from bayescal.machines.models import MODELS

if TYPE_CHECKING:
    from numba_loops import LoopData

N_MACHINES = 128
AGREEMENT = 1e-9
SPREAD = 1e-3  # of the machines about the truth, in prior standard deviations
TAU = 5e-3  # mm
CALLS = 4  # in a row, so that a model finds its own arrays in the cache
N_POSES = 10_000


def loop_data(problem: Problem) -> LoopData:
    """Return the loops' view of a problem; reads what the likelihood has precomputed."""
    from numba_loops import LoopData

    likelihood, poses = problem.likelihood(), problem.poses
    basis = problem.machine.basis(poses.actuators)
    arrays = (poses.position, poses.rotation, basis.displacement, basis.constant, likelihood._gain)
    arrays += (likelihood._known, likelihood.actuator_weight, likelihood._constant)
    return LoopData(*(np.ascontiguousarray(array) for array in arrays))


def draw_machines(problem: Problem) -> tuple[Array, Array]:
    """Return parameter vectors (B, 66) near the truth and model errors (B, 6) in mm."""
    rng = np.random.default_rng(SEED)
    coordinates = problem.posterior().sampling.coordinates
    theta = np.tile(problem.theta, (N_MACHINES, 1))
    theta[:, coordinates.free] += SPREAD * coordinates.scale * rng.normal(size=(N_MACHINES, len(coordinates.free)))
    return theta, TAU * np.abs(rng.normal(size=(N_MACHINES, problem.likelihood().n_legs)))


def build_contestants(problem: Problem) -> dict[str, dict[str, Callable[[], Array]]]:
    """Return the functions to time: case, then contestant; each returns the log-likelihoods (B,)."""
    from numba_loops import STYLES

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


def time_loops(repeats: int) -> dict[str, object]:
    """Compare with compiled loops, time, print a table; return the figures."""
    figures: dict[str, object] = {"n_machines": N_MACHINES, "repeats": repeats}
    for case, contestants in build_contestants(simulate()).items():
        expected = contestants["numpy"]()
        agreement = max(float(np.max(np.abs(f() / expected - 1.0))) for f in contestants.values())
        if not agreement < AGREEMENT:
            raise SystemExit(f"{case}: log-likelihoods differ by {agreement:.2g} (relative), expected < {AGREEMENT:g}")
        seconds = time_interleaved(contestants, repeats)
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
    return figures


def build_model_case(problem: Problem, name: str) -> dict[str, Callable[[], object]]:
    """Return what is timed of a model: figure, then function; 6-PUS parameters as drawn, its own near nominal."""
    mechanism, rng = problem.machine.mechanism, np.random.default_rng(SEED)
    machine = Machine(mechanism, MODELS[name].from_mechanism(mechanism), problem.machine.deformation)
    theta = np.tile(machine.layout.nominal, (BATCH, 1))
    for symbol, index in problem.machine.layout.index.items():
        theta[:, machine.layout.index[symbol]] = problem.theta[index]
    theta += SPREAD * np.abs(machine.layout.nominal) * rng.uniform(-1.0, 1.0, theta.shape)
    likelihood = PoseLikelihood(machine, problem.poses, ACTUATOR_NOISE)
    none, tau = np.zeros(mechanism.n_legs), TAU * np.abs(rng.normal(size=(BATCH, mechanism.n_legs)))
    stroke = mechanism.actuator_range * rng.uniform(-1.0, 1.0, (N_POSES, mechanism.n_legs))
    actuators = mechanism.initial_actuator_positions + stroke
    return {
        "µs / machine": lambda: [likelihood(theta, none) for _ in range(CALLS)],
        "µs with τ": lambda: [likelihood(theta, tau) for _ in range(CALLS)],
        "Jacobian, ms": lambda: [likelihood.error_jacobian(theta[0]) for _ in range(CALLS)],
        "poses, s": lambda: solve_forward_kinematics(machine, theta[0], actuators),
    }


def time_models(repeats: int) -> dict[str, object]:
    """Time every model, print a table; return the figures."""
    problem = simulate()
    drive = problem.machine.mechanism.drive
    cases = {name: build_model_case(problem, name) for name, model in MODELS.items() if model.drive == drive}
    unit = {"µs / machine": 1e6 / BATCH / CALLS, "µs with τ": 1e6 / BATCH / CALLS, "Jacobian, ms": 1e3 / CALLS}
    figures: dict[str, object] = {"n_machines": BATCH, "n_poses": N_POSES, "repeats": repeats}
    for what in cases["six_pus"]:
        n_repeats = repeats if what in unit else max(repeats // 20, 3)
        seconds = time_interleaved({name: case[what] for name, case in cases.items()}, n_repeats)
        best = {name: unit.get(what, 1.0) * min(s) for name, s in seconds.items()}
        ratio = {name: float(np.median(np.array(s) / np.array(seconds["six_pus"]))) for name, s in seconds.items()}
        print(f"{'':32}{what:>14}{'this / 6-PUS':>14}")
        for name in cases:
            print(f"  {name:30}{best[name]:14.3g}{ratio[name]:14.2f}")
        figures[what] = {"best": best, "over_six_pus": ratio}
    return figures


def main() -> None:
    """Time, print tables and write the results."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--repeats", type=int, default=200)
    parser.add_argument("--models", action="store_true", help="compare the models instead of the loops")
    parser.add_argument("--name", help="name of the results' file")
    arguments = parser.parse_args()
    if arguments.models:
        path = write_results(arguments.name or "models", time_models(arguments.repeats), ("numpy",))
    else:
        path = write_results(arguments.name or "likelihood", time_loops(arguments.repeats), ("numpy", "numba"))
    print(path.name)


if __name__ == "__main__":
    main()
