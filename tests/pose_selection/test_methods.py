"""Methods against all subsets of small problems, against each other, and against the published indices."""

from __future__ import annotations

import re

import numpy as np
import pose_problems
import pytest
import telescope_machines as machines
from refusals import line_of

from bayescal.pose_selection import (
    SelectionProblem,
    WorkspaceBox,
    candidates_at_actuators,
    compute_observability,
    even_candidates,
    factorial_candidates,
    random_candidates,
    select,
)
from bayescal.pose_selection.criteria import O1
from bayescal.pose_selection.methods import Continuous, Exchange, RandomSets

PUBLISHED_RANDOM = {"mean": 0.01713, "max": 0.02199}  # Yu, Wu and Wang 2023, section 5


@pytest.mark.parametrize("name", pose_problems.CRITERIA)
def test_nothing_exceeds_the_best_of_all_subsets(name):
    pose_problems.check_nothing_exceeds(name, RandomSets(n_sets=20), Exchange())


@pytest.mark.parametrize("name", pose_problems.CRITERIA)
def test_exchange_ends_where_no_exchange_pays(name):
    problem = pose_problems.small_problem(name)
    selection = select(problem, "exchange", np.random.default_rng(1))
    assert selection.converged
    members = selection.index.tolist()
    for dropped in members:
        for added in set(range(12)) - set(members):
            other = [*(k for k in members if k != dropped), added]
            assert problem.value_of(problem.blocks[other]) <= selection.value * (1 + 1e-10 * np.sign(selection.value))


@pytest.mark.parametrize("seed", range(5))
def test_no_method_returns_less_than_it_started_with(seed):
    problem = pose_problems.build_problem("O1", 60, 9, seed)
    good = tuple(select(problem, "exchange", np.random.default_rng(seed)).index.tolist())
    value = problem.value_of(problem.blocks[list(good)])
    for method in (Exchange(start=good), Continuous(start=Exchange(start=good), max_iterations=3)):
        selection = select(problem, method, np.random.default_rng(7))
        assert selection.value >= value * (1 - 1e-12)
        assert selection.trace[0] == pytest.approx(value, rel=1e-10)


@pytest.mark.parametrize("method", ["random", "exchange", Continuous(RandomSets(1), max_iterations=3)])
def test_chance_comes_from_the_generator_alone(method):
    problem = pose_problems.build_problem("O1", 200, 9)
    np.random.seed(0)  # noqa: NPY002 - the global state must not matter, nor be touched
    before = np.random.get_state()[1].tolist()  # noqa: NPY002
    first = select(problem, method, np.random.default_rng(4))
    assert np.random.get_state()[1].tolist() == before  # noqa: NPY002
    np.random.seed(1)  # noqa: NPY002
    again = select(problem, method, np.random.default_rng(4))
    other = select(problem, method, np.random.default_rng(5))
    np.testing.assert_array_equal(first.shares, again.shares)
    np.testing.assert_array_equal(first.trace, again.trace)
    assert not np.array_equal(first.trace, other.trace)


@pytest.mark.parametrize("name", ["O1", "O5", "D", "I"])
def test_measured_poses_stay(name):
    measured = pose_problems.build_problem("O1", seed=3).candidates.placed.actuators[:8]
    alone = pose_problems.build_problem(name, 100, 9)
    problem = pose_problems.build_problem(name, 100, 9, measured=measured)
    assert pose_problems.build_problem(name, 100, 3, measured=measured).least == 1
    beside = select(problem, "exchange", np.random.default_rng(0))
    without = select(alone, "exchange", np.random.default_rng(0))
    assert beside.value > problem.value_of(alone.blocks[without.index])
    domain = problem.candidates.domain
    rows = problem.criterion.rows(domain.design.see(domain.at_actuators(measured)))
    together = np.concatenate([rows, problem.blocks[beside.index]]).reshape(-1, 42)
    stacked = np.concatenate([problem.criterion.prior_rows(42), together])
    assert beside.value == pytest.approx(float(problem.criterion.value(stacked, 17)), rel=1e-10)


def test_random_sets_are_those_published():
    candidates = even_candidates(pose_problems.yu_domain(), 2000)
    sets = select(SelectionProblem(candidates, O1(), 20), RandomSets(1000), np.random.default_rng(0))
    assert sets.trace.mean() == pytest.approx(PUBLISHED_RANDOM["mean"], rel=0.03)
    assert sets.trace.max() == pytest.approx(PUBLISHED_RANDOM["max"], rel=0.03)
    assert len(sets.trace) == 1000
    assert sets.value == pytest.approx(sets.trace.max(), rel=1e-12)


def test_continuous_reaches_the_corners():
    problem = pose_problems.build_problem("O1", 500, 10)
    exchange = select(problem, "exchange", np.random.default_rng(0))
    found = select(problem, Continuous(start=Exchange()), np.random.default_rng(0))
    assert found.converged
    assert found.value > 1.2 * exchange.value
    assert np.mean(np.abs(found.shares) > 0.999) > 0.9
    assert np.abs(found.shares).max() <= 1.0
    placed = problem.candidates.domain.at_actuators(found.actuators)
    np.testing.assert_allclose(placed.moves, found.placed.moves, atol=1e-8)


@pytest.mark.parametrize("kind", ["range", "workspace"])
@pytest.mark.parametrize("method", [Exchange(), Continuous()])
def test_constraints_are_kept(kind, method):
    if kind == "range":  # the corners of this workspace are out of the actuators' range
        domain = WorkspaceBox(pose_problems.telescope_domain().design, np.array([2.0, 2.0, 1.0, 0.01, 0.01, 0.01]))
    else:
        domain = pose_problems.telescope_domain(np.array([1.0, 1.0, 1.0, 5e-3, 5e-3, 5e-3]))
    free = np.random.default_rng(0).uniform(-1, 1, (500, 6))
    assert not domain.allows(domain.place(free)).all()
    problem = SelectionProblem(random_candidates(domain, 300, np.random.default_rng(0)), O1(), 10)
    selection = select(problem, method, np.random.default_rng(1))
    assert np.abs(selection.shares).max() <= 1.0
    margins = domain.margins(selection.placed)
    assert margins.min() > -1e-9
    mechanism = domain.design.machine.mechanism
    moved = np.abs(selection.actuators - mechanism.initial_actuator_positions).max()
    assert moved <= mechanism.actuator_range * (1 + 1e-9)
    if method.name == "continuous":
        start = select(problem, method.start, np.random.default_rng(1))
        assert selection.value > 1.05 * start.value
        assert margins.min() < 1e-6  # it lies on a constraint


def test_telescope_optimum_lies_at_the_boundary():
    domain = pose_problems.telescope_domain()
    problem = SelectionProblem(random_candidates(domain, 500, np.random.default_rng(0)), O1(), 10)
    selection = select(problem, "continuous", np.random.default_rng(0))
    assert np.all(np.any(np.abs(selection.shares) > 0.999, axis=1))  # RR-8096 section 6.3.2


def test_order_of_exchange_and_continuous_depends_on_the_candidates():
    """From random sets continuous optimisation is ahead; with the ends of the range as candidates exchange is."""
    domain = pose_problems.telescope_domain()
    interior = SelectionProblem(random_candidates(domain, 200, np.random.default_rng(0)), O1(form="closure"), 10)
    ends = SelectionProblem(factorial_candidates(domain, 729), O1(form="closure"), 10)
    inside, outside = (select(problem, "exchange", np.random.default_rng(0)).value for problem in (interior, ends))
    method = Continuous(start=RandomSets(1), max_iterations=200)
    continuous = select(interior, method, np.random.default_rng(0)).value
    assert inside < 0.9 * continuous
    assert continuous < outside


def test_table_3_as_a_design():
    domain = pose_problems.telescope_domain()
    table = candidates_at_actuators(domain, machines.table_3_actuators())
    assert table.n_distinct == 38  # two configurations are listed twice
    value = float(compute_observability(table.seen.slope)["O1"])
    uniform = SelectionProblem(random_candidates(domain, 500, np.random.default_rng(0)), O1(), 40)
    sets = select(uniform, RandomSets(100), np.random.default_rng(0))
    ends = SelectionProblem(even_candidates(domain, 500, levels=3), O1(), 40)
    optimum = select(ends, "exchange", np.random.default_rng(0))
    assert sets.trace.max() < value < optimum.value


@pytest.mark.parametrize(
    ("method", "message"),
    [
        ("annealing", "method: found 'annealing', expected one of random, exchange, continuous"),
        (RandomSets(0), "random: found 0 sets, expected at least 1"),
        (Exchange(start=(1, 2, 3)), r"start: found candidates \[1, 2, 3\], expected 9 different ones"),
        (Exchange(start=(1,) * 9), "start: found candidates .* expected 9 different ones"),
        (Exchange(start=(99, *range(8))), "start: found candidates .* expected 9 different ones"),
    ],
)
def test_bad_input(method, message):
    assert re.search(message, line_of(select, pose_problems.build_problem("O1"), method, np.random.default_rng(0)))
