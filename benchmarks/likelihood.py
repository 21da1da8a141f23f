"""Time of the batched likelihood of every model, one core.

    python benchmarks/likelihood.py [--repeats 200] [--name models]

40 poses of the telescope seen by every model with deformation matrix, in batches of 256 machines: µs per machine
without and with model errors by the fast form about the machine that explains the poses, the same by the density that
leaves nothing out, a gradient in ms, and the forward kinematics of 10,000 poses in s. The best of the repeats counts,
and medians of the ratio to the 6-PUS within each round.
"""

# ruff: noqa: I001 - telescope_problem comes before NumPy and JAX: it sets the number of threads
from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import replace

from telescope_problem import SEED, Problem, simulate, time_interleaved, write_results  # first: threads

import numpy as np

from bayescal.machines.kinematics import Machine, solve_forward_kinematics
from bayescal.machines.models import MODELS

BATCH = 256
SPREAD = 1e-3  # of the machines about the truth, in prior standard deviations
CALLS = 4  # in a row, so that a model finds its own arrays in the cache
N_POSES = 10_000


def build_model_case(problem: Problem, name: str) -> dict[str, Callable[[], object]]:
    """Return what is timed of a model: figure, then function; machines about the one that explains the poses best."""
    mechanism, rng = problem.machine.mechanism, np.random.default_rng(SEED)
    machine = Machine(mechanism, MODELS[name].from_mechanism(mechanism), problem.machine.deformation)
    own = replace(problem, machine=machine)
    plain, erring = own.posterior(), own.posterior(model_error=True)
    whole = replace(erring, likelihood=erring.likelihood.whole)
    best = erring.least_squares_start()
    y = best + SPREAD * rng.standard_normal((BATCH, len(best)))
    short, theta = y[:, : plain.n_parameters], erring.theta(best[None])[0]
    stroke = mechanism.actuator_range * rng.uniform(-1.0, 1.0, (N_POSES, mechanism.n_legs))
    actuators = mechanism.initial_actuator_positions + stroke
    return {
        "µs / machine": lambda: [plain.log_density(short) for _ in range(CALLS)],
        "µs with τ": lambda: [erring.log_density(y) for _ in range(CALLS)],
        "µs, whole": lambda: [whole.log_density(y) for _ in range(CALLS)],
        "gradient, ms": lambda: [erring.gradient(best) for _ in range(CALLS)],
        "poses, s": lambda: solve_forward_kinematics(machine, theta, actuators),
    }


def time_models(repeats: int) -> dict[str, object]:
    """Time every model, print a table; return the figures."""
    problem = simulate()
    drive = problem.machine.mechanism.drive
    cases = {name: build_model_case(problem, name) for name, model in MODELS.items() if model.drive == drive}
    each = 1e6 / BATCH / CALLS
    unit = {"µs / machine": each, "µs with τ": each, "µs, whole": each, "gradient, ms": 1e3 / CALLS}
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
    parser.add_argument("--name", default="models", help="name of the results' file")
    arguments = parser.parse_args()
    print(write_results(arguments.name, time_models(arguments.repeats), ("numpy",)).name)


if __name__ == "__main__":
    main()
