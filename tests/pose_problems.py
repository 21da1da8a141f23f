"""Machines, domains and problems of pose selection that the tests share."""

from __future__ import annotations

from itertools import combinations

import audit_problems
import numpy as np
import studies
import telescope_machines as machines

from bayescal.density.priors import NormalPrior
from bayescal.machines.read import load_mechanism
from bayescal.machines.sensors import PoseSensor
from bayescal.pose_selection import ActuatorBox, Design, SelectionProblem, WorkspaceBox, random_candidates, select
from bayescal.pose_selection.criteria import O1, O2, O3, O4, O5, AOptimality, DOptimality, IOptimality

YU_HALF = np.concatenate([np.full(3, 100.0), np.radians(np.full(3, 10.0))])
YU_TOLERANCE = 0.5
MEASURED = {"sensors": (PoseSensor(1e-3, np.radians(1e-4)),), "actuator_noise": 1e-4}
LIMITS = np.array([1e-3, 1e-3, 1e-3, 1e-5, 1e-5, np.inf])
IDENTIFIABLE = ("a_x", "a_y", "b_x", "b_y", "u_x", "u_y", "l")  # RR-8096 eq. 37
CRITERIA = ("O1", "O2", "O3", "O4", "O5", "D", "A", "I")
INDICES = CRITERIA[:5]


def yu_design(symbols: tuple[str, ...] | None = None) -> Design:
    """Return Yu's large geometry with all 42 parameters free, or those of some symbols."""
    machine = machines.build_machine(
        "none", load_mechanism(studies.EXPERIMENTS / "audit/yu2023_mechanism.toml"), "six_ups"
    )
    nominal = zip(machine.layout.names, machine.layout.nominal, strict=True)
    priors = {
        name: NormalPrior(value, YU_TOLERANCE)
        for name, value in nominal
        if symbols is None or name.partition("[")[0] in symbols
    }
    return Design(machine, priors, **MEASURED)


def yu_domain(symbols: tuple[str, ...] | None = None) -> WorkspaceBox:
    """Return ±100 mm and ±10 deg about home."""
    return WorkspaceBox(yu_design(symbols), YU_HALF)


def telescope_domain(half: np.ndarray | None = None) -> ActuatorBox:
    """Return the telescope's actuator range, the identifiable parameters of RR-8096 free."""
    machine = machines.build_machine("none")
    return ActuatorBox(Design(machine, audit_problems.build_priors(machine, IDENTIFIABLE), **MEASURED), half)


def build_criterion(name: str, domain=None):
    """Return a criterion; I over 20 poses of the domain."""
    if name in INDICES:
        return {"O1": O1, "O2": O2, "O3": O3, "O4": O4, "O5": O5}[name]()
    if name in "DA":
        return {"D": DOptimality, "A": AOptimality}[name]()
    return IOptimality(random_candidates(domain, 20, np.random.default_rng(99)).seen.located.tool, LIMITS)


def build_problem(
    name: str, n_candidates: int = 60, n: int = 9, seed: int = 0, domain=None, **fields
) -> SelectionProblem:
    """Return a problem on Yu's machine with random candidates."""
    domain = domain or yu_domain()
    candidates = random_candidates(domain, n_candidates, np.random.default_rng(seed))
    return SelectionProblem(candidates, build_criterion(name, domain), n, **fields)


def small_problem(name: str, n_candidates: int = 12, n: int = 5, seed: int = 0) -> SelectionProblem:
    """Return a problem small enough for all subsets to be judged: 18 parameters, for which 3 poses would do."""
    return build_problem(name, n_candidates, n, seed, yu_domain(("a_x", "b_y", "l")))


def check_nothing_exceeds(name: str, *methods: object) -> None:
    """Check that no method finds a better value than the best of all subsets of a small problem."""
    problem = small_problem(name)
    subsets = combinations(range(len(problem.candidates)), problem.n)
    best = max(problem.value_of(problem.blocks[list(one)]) for one in subsets)
    for method in methods:
        selection = select(problem, method, np.random.default_rng(0))
        assert selection.value == problem.value_of(problem.blocks[selection.index])
        assert selection.value <= best + 1e-12 * abs(best)
