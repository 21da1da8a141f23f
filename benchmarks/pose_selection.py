"""Time of pose selection by update formulas, against the singular values of every set again.

    python benchmarks/pose_selection.py [--candidates 10000] [--iterations 219] [--sets 200] [--all]

Improved DETMAX on the large geometry of Yu, Wu and Wang (2023): 42 parameters, 20 poses, a tabu list of 100. The other
way forms the set with one candidate more, or with one member less, and takes its singular values, one set after the
other; it is timed on some sets, before and after the run, and scaled to the number that the run judges. Both must agree
on what these sets are worth. With --all the other criteria are timed too, and the other methods with O1. One core.
"""

# ruff: noqa: I001, E402 - telescope_problem comes before NumPy: it sets the number of threads
from __future__ import annotations

import argparse
import time
import sys
from pathlib import Path

from telescope_problem import write_results

import numpy as np

from bayescal.density.priors import NormalPrior
from bayescal.machines.read import load_mechanism
from bayescal.machines.deformations import DEFORMATIONS, NominalDeformation
from bayescal.machines.kinematics import build_machine
from bayescal.machines.models.six_ups import SixUps
from bayescal.pose_selection import Criterion, Design, SelectionProblem, WorkspaceBox, even_candidates, select
from bayescal.pose_selection.criteria import O1, O2, O3, O4, O5, AOptimality, DOptimality, IOptimality
from bayescal.machines.sensors import PoseSensor

EXPERIMENTS = Path(__file__).parent.parent / "experiments"
sys.path.insert(0, str(EXPERIMENTS / "yu2023"))
from detmax import Detmax, DetmaxConfig, TabuDetmax, TabuDetmaxConfig

MECHANISM = EXPERIMENTS / "audit" / "yu2023_mechanism.toml"
HALF = np.concatenate([np.full(3, 100.0), np.radians(np.full(3, 10.0))])
NOISE = (1e-3, float(np.radians(1e-4)))  # mm, rad
TOLERANCE = 0.5  # mm
N_POSES = 20
SEED = 20230412


def build_domain() -> WorkspaceBox:
    """Return Yu's machine with all parameters free and its workspace."""
    rigid = DEFORMATIONS["none"].from_nominal(NominalDeformation(0.0, lambda: np.zeros((6, 6))))
    machine = build_machine(SixUps, load_mechanism(MECHANISM), rigid)
    nominal = zip(machine.layout.names, machine.layout.nominal.tolist(), strict=True)
    priors = {name: NormalPrior(value, TOLERANCE) for name, value in nominal}
    return WorkspaceBox(Design(machine, priors, sensors=(PoseSensor(*NOISE),)), HALF)


def list_criteria(domain: WorkspaceBox) -> list[Criterion]:
    """Return all criteria; I over 150 poses of the workspace, its limits in proportion to the noise."""
    workspace = even_candidates(domain, 150, levels=None).seen.located.tool
    predicted = IOptimality(workspace, np.repeat(NOISE, 3))
    return [O1(), O2(), O3(), O4(), O5(), DOptimality(), AOptimality(), predicted]


def time_naive(problem: SelectionProblem, n_sets: int, rng: np.random.Generator) -> tuple[float, float]:
    """Return seconds per set judged by its singular values, and the largest relative difference from the update."""
    scorer = problem.scorer()
    scorer.start(problem.draw_set(rng).tolist())
    members = scorer.members
    candidates = rng.choice(np.setdiff1d(np.arange(len(problem.candidates)), members), n_sets, replace=False)
    values = np.empty(n_sets)
    began = time.perf_counter()
    for place, candidate in enumerate(candidates):
        rows = problem.blocks[[*members, candidate]].reshape(-1, problem.n_parameters)
        sigma = np.linalg.svd(rows, compute_uv=False)
        values[place] = np.exp(np.mean(np.log(sigma))) / np.sqrt(len(members) + 1)
    seconds = (time.perf_counter() - began) / n_sets
    return seconds, float(np.abs(scorer.values_added()[candidates] / values - 1.0).max())


def run(n_candidates: int, iterations: int, n_sets: int, everything: bool) -> dict[str, object]:
    """Time everything once, print and return the figures."""
    domain = build_domain()
    began = time.perf_counter()
    candidates = even_candidates(domain, n_candidates)
    candidates.seen.slope.sum()
    candidate_time = time.perf_counter() - began
    problem = SelectionProblem(candidates, O1(), N_POSES)
    rng = np.random.default_rng(SEED)
    before, apart_before = time_naive(problem, n_sets, rng)
    began = time.perf_counter()
    selection = select(problem, TabuDetmax(TabuDetmaxConfig(iterations=iterations)), np.random.default_rng(SEED))
    seconds = time.perf_counter() - began
    after, apart_after = time_naive(problem, n_sets, rng)
    naive = 0.5 * (before + after) * selection.n_evaluations
    figures: dict[str, object] = {
        "n_candidates": n_candidates,
        "n_poses": N_POSES,
        "n_parameters": problem.n_parameters,
        "iterations": iterations,
        "sets_judged": selection.n_evaluations,
        "candidates_seconds": candidate_time,
        "o1": selection.value,
        "tabu_seconds": seconds,
        "naive_milliseconds_per_set": 0.5e3 * (before + after),
        "naive_sets_timed": 2 * n_sets,
        "naive_seconds_scaled": naive,
        "ratio": naive / seconds,
        "largest_difference": max(apart_before, apart_after),
    }
    if everything:
        figures |= time_others(domain, problem, iterations)
    for name, value in figures.items():
        print(f"{name:28s} {value:.4g}" if isinstance(value, float) else f"{name:28s} {value}")
    return figures


def time_others(domain: WorkspaceBox, problem: SelectionProblem, iterations: int) -> dict[str, object]:
    """Return seconds and values of the other criteria by improved DETMAX, and of the other methods by O1."""
    figures: dict[str, object] = {}
    for criterion in list_criteria(domain)[1:]:
        other = SelectionProblem(problem.candidates, criterion, N_POSES)
        began = time.perf_counter()
        selection = select(other, TabuDetmax(TabuDetmaxConfig(iterations=iterations)), np.random.default_rng(SEED))
        figures[f"{criterion.name}_tabu_seconds"] = time.perf_counter() - began
        figures[f"{criterion.name}_tabu_value"] = selection.value
        figures[f"{criterion.name}_sets_judged"] = selection.n_evaluations
    for method in ("random", Detmax(DetmaxConfig()), "exchange", "continuous"):
        began = time.perf_counter()
        selection = select(problem, method, np.random.default_rng(SEED))
        figures[f"O1_{selection.method}_seconds"] = time.perf_counter() - began
        figures[f"O1_{selection.method}_value"] = selection.value
    return figures


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--candidates", type=int, default=10_000)
    parser.add_argument("--iterations", type=int, default=219)
    parser.add_argument("--sets", type=int, default=200)
    parser.add_argument("--all", action="store_true")
    options = parser.parse_args()
    found = run(options.candidates, options.iterations, options.sets, options.all)
    print(f"wrote {write_results('pose_selection', found, ())}")
