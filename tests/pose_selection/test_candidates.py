"""Candidates: where they lie, and one line for each bad one."""

from __future__ import annotations

import re
from dataclasses import replace

import audit_problems
import numpy as np
import pose_problems
import pytest
import telescope_machines as machines
from refusals import line_of

from bayescal.pose_selection import (
    ActuatorBox,
    SelectionProblem,
    WorkspaceBox,
    candidates_at,
    candidates_at_actuators,
    even_candidates,
    factorial_candidates,
    random_candidates,
)
from bayescal.pose_selection.criteria import O1, AOptimality, DOptimality, IOptimality

BUILDERS = (random_candidates, even_candidates, factorial_candidates)


@pytest.mark.parametrize("build", BUILDERS)
@pytest.mark.parametrize("domain", ["yu", "telescope"])
def test_candidates_lie_in_the_box(build, domain):
    box = pose_problems.yu_domain() if domain == "yu" else pose_problems.telescope_domain()
    candidates = build(box, 200, np.random.default_rng(1))
    assert len(candidates) == 200
    assert candidates.placed.actuators.shape == (200, 6)
    assert np.abs(candidates.shares).max() <= 1.0
    if domain == "yu":
        assert np.all(np.abs(candidates.placed.moves) <= pose_problems.YU_HALF * (1 + 1e-12))
    again = build(box, 200, np.random.default_rng(1))
    np.testing.assert_array_equal(candidates.shares, again.shares)


@pytest.mark.parametrize("levels", [3, 11])
def test_even_candidates_reach_the_boundary(levels):
    shares = even_candidates(pose_problems.yu_domain(), 2000, np.random.default_rng(0), levels).shares
    nodes, counts = np.unique(shares[:, 2], return_counts=True)
    np.testing.assert_allclose(nodes, np.linspace(-1, 1, levels), atol=1e-12)
    expected = 2000 / (levels - 1) * np.where(np.abs(nodes) == 1.0, 0.5, 1.0)  # outer nodes stand for half a step
    np.testing.assert_allclose(counts, expected, rtol=0.05)


def test_factorial_candidates_hold_all_corners():
    candidates = factorial_candidates(pose_problems.yu_domain(), 2000, np.random.default_rng(0))
    corners = np.abs(candidates.shares).min(axis=1) == 1.0
    assert corners.sum() == 64
    assert len(candidates) == 2000
    assert candidates.n_distinct == 2000
    assert [len(np.unique(np.round(column[:1728], 9))) for column in candidates.shares.T] == [4, 4, 4, 3, 3, 3]


def test_axes_without_width_stay():
    half = pose_problems.YU_HALF * [1, 1, 0, 1, 1, 0]
    candidates = random_candidates(WorkspaceBox(pose_problems.yu_design(), half), 50, np.random.default_rng(0))
    assert candidates.shares.shape == (50, 4)
    assert not candidates.placed.moves[:, [2, 5]].any()


def test_range_leaves_candidates_out():
    machine = machines.build_machine("none")
    domain = WorkspaceBox(audit_problems.build_knowledge(machine), np.array([2.0, 2.0, 1.0, 0.01, 0.01, 0.01]))
    candidates = random_candidates(domain, 200, np.random.default_rng(0))
    moved = candidates.placed.actuators - machine.mechanism.initial_actuator_positions
    assert np.abs(moved).max() <= machines.ACTUATOR_RANGE
    assert np.abs(moved).max() > 0.9 * machines.ACTUATOR_RANGE


def flat_struts() -> WorkspaceBox:
    """Return struts whose workspace holds the pose where all joints lie in one plane."""
    machine = machines.build_machine("none", machines.build_hexapod(actuator_range=499.0), "six_ups")
    knowledge = audit_problems.build_knowledge(machine)
    height = WorkspaceBox(knowledge, np.ones(6)).home.position[2] - machine.mechanism.base_points[0, 2]
    return WorkspaceBox(knowledge, np.array([50.0, 50.0, height, 0.1, 0.1, 0.1]))


def bad_shares(place: int, value: float) -> np.ndarray:
    """Return ten candidates, one coordinate of one of them replaced."""
    shares = np.random.default_rng(0).uniform(-1, 1, (10, 6))
    shares[place, 3] = value
    return shares


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_non_finite_candidate(value):
    line = line_of(candidates_at, pose_problems.yu_domain(), bad_shares(6, value))
    assert line.startswith(f"candidate 7: found the coordinate {value:g},")
    line = line_of(candidates_at_actuators, pose_problems.telescope_domain(), bad_shares(2, value))
    assert line.startswith(f"candidate 3: found the coordinate {value:g},")


def test_candidate_outside():
    line = line_of(candidates_at, pose_problems.yu_domain(), bad_shares(4, 1.5))
    assert line.startswith("candidate 5: ")
    domain = pose_problems.telescope_domain(np.full(6, 1e-3))
    line = line_of(candidates_at, domain, np.full((1, 6), 0.5))
    assert line.startswith("candidate 1 (z 0.65")
    assert line.endswith(": outside actuator range or workspace")
    line = line_of(random_candidates, domain, 5, np.random.default_rng(0))
    assert re.fullmatch(r"candidates: found 0 of 500 .* 5", line)


def test_singular_pose_is_named():
    domain = flat_struts()
    shares = np.zeros((8, 6))
    shares[:, 2] = np.linspace(0.9, 0.2, 8)
    shares[5] = [0.0, 0.0, -1.0, 0.0, 0.0, 0.0]
    candidates = candidates_at(domain, shares)
    line = line_of(SelectionProblem, candidates, O1(), 8)
    assert line.startswith(f"candidate 6 (z {-domain.half[2]:.4g} mm")
    assert line.endswith("singular pose Jacobian J_1")


def test_too_few_poses():
    line = line_of(lambda: pose_problems.build_problem("O1", n=6))
    assert re.fullmatch(r"poses: found 6, .* 7 for 42 parameters", line)
    measured = pose_problems.build_problem("O1").candidates.placed.actuators[:2]
    line = line_of(lambda: pose_problems.build_problem("O1", n=4, measured=measured))
    assert re.fullmatch(r"poses: found 4, .* 5 for 42 .* 2 measured", line)


def test_too_few_distinct_candidates():
    shares = np.tile(np.random.default_rng(0).uniform(-1, 1, (8, 6)), (5, 1))
    candidates = candidates_at(pose_problems.yu_domain(), shares)
    line = line_of(SelectionProblem, candidates, O1(), 9)
    assert re.fullmatch(r"candidates: found 8 distinct of 40 .* 9", line)
    selected = SelectionProblem(candidates, O1(), 8)
    assert sorted(selected.draw_set(np.random.default_rng(0)).tolist()) == list(range(8))


def test_parameters_that_no_candidate_tells():
    domain = ActuatorBox(audit_problems.build_knowledge(machines.build_machine("none")))
    problem = SelectionProblem(random_candidates(domain, 50, np.random.default_rng(0)), O1(), 12)
    line = line_of(problem.scorer)
    assert re.match(r"candidates: found 5\d of 60 ", line)
    SelectionProblem(problem.candidates, DOptimality(), 12).scorer()


def test_measured_pose_out_of_reach():
    measured = np.full((2, 6), np.nan)
    measured[0] = 10.0
    domain = pose_problems.telescope_domain()
    line = line_of(lambda: pose_problems.build_problem("D", domain=domain, measured=measured))
    assert line.startswith("measured pose 2: ")


@pytest.mark.parametrize("half", [np.zeros(6), np.full(6, np.nan), np.full(6, -1.0), np.ones(5)])
def test_bad_workspace(half):
    assert line_of(WorkspaceBox, pose_problems.yu_design(), half).startswith("workspace: found half widths")
    assert line_of(pose_problems.telescope_domain, half).startswith("workspace: found half widths")


def test_actuators_of_redundant_legs_do_not_move_freely():
    machine = machines.build_machine("none", machines.build_random_mechanism(7, 0))
    assert "7 legs, expected 6" in line_of(ActuatorBox, audit_problems.build_knowledge(machine))
    design = replace(audit_problems.build_knowledge(machine, ("a_x", "l")), **pose_problems.MEASURED)
    domain = WorkspaceBox(design, np.array([1, 1, 1, 0.01, 0.01, 0.01]))
    problem = SelectionProblem(random_candidates(domain, 30, np.random.default_rng(0)), DOptimality(), 4)
    assert problem.blocks.shape == (30, 7, 14)


@pytest.mark.parametrize(
    ("build", "said"),
    [
        (lambda: candidates_at(pose_problems.yu_domain(), np.zeros((4, 5))), " 6 numbers"),
        (lambda: candidates_at(pose_problems.yu_domain(), np.zeros((0, 6))), " 6 numbers"),
        (lambda: random_candidates(pose_problems.yu_domain(), 0, np.random.default_rng(0)), "least 1"),
        (lambda: even_candidates(pose_problems.yu_domain(), 10, np.random.default_rng(0), 1), "expected 2 or more"),
        (lambda: pose_problems.build_problem("D", n=0), "^poses: found 0, .* 1"),
        (lambda: AOptimality(chosen=(42,)).weight_root(42), r"^criterion A: .*\b42\b.* 0 to 41$"),
        (
            lambda: IOptimality(pose_problems.build_problem("O1").candidates.seen.located.tool, np.zeros(6)),
            "^criterion I: found limits 0, 0, 0, 0, 0, 0, ",
        ),
    ],
)
def test_bad_numbers(build, said):
    assert re.search(said, line_of(build))
