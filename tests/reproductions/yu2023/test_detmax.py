"""The paper's methods against all subsets of a small problem, each other, and the published indices."""

from __future__ import annotations

import numpy as np
import papers
import pose_problems
import pytest
from refusals import line_of

from bayescal.config.registry import load_class
from bayescal.pose_selection import SelectionProblem, even_candidates, select
from bayescal.pose_selection.criteria import O1

Detmax, TabuDetmax = (load_class("METHODS", f"detmax.py:{name}", papers.YU) for name in ("Detmax", "TabuDetmax"))
PUBLISHED_O1 = {20: 0.0357, 30: 0.0361, 40: 0.0362}  # Yu, Wu and Wang 2023, table 1


def detmax(**options: int):
    return Detmax(Detmax.Config(**options))


def tabu(**options: int):
    return TabuDetmax(TabuDetmax.Config(**options))


@pytest.mark.parametrize("name", pose_problems.CRITERIA)
def test_nothing_exceeds_the_best_of_all_subsets(name):
    pose_problems.check_nothing_exceeds(name, detmax(), tabu(list_length=2, iterations=60))


def test_detmax_ends_where_the_best_exchange_of_one_pose_is_none():
    problem = pose_problems.build_problem("O1", 60, 9)
    found = select(problem, detmax(), np.random.default_rng(1))
    assert found.converged
    assert (np.diff(found.trace) > 0.0).all()
    scorer = problem.scorer()
    scorer.start(found.index.tolist())
    outside = problem.candidates.distinct.copy()
    outside[found.index] = False
    added, _ = scorer.best_added(outside)
    scorer.add(added)
    assert scorer.best_dropped()[0] == added
    ended = select(problem, detmax(max_iterations=1), np.random.default_rng(1))
    assert not ended.converged
    assert len(ended.trace) == 2


def test_tabu_goes_on_from_where_detmax_ends():
    problem = pose_problems.build_problem("O1", 300, 12)
    local = select(problem, detmax(), np.random.default_rng(2))
    selection = select(problem, tabu(list_length=60), np.random.default_rng(2))
    assert selection.trace[0] == local.trace[0]
    assert selection.value > local.value
    assert selection.value == pytest.approx(selection.trace.max(), rel=1e-10)
    assert len(selection.trace) == 220


def test_published_indices_are_reached():
    candidates = even_candidates(pose_problems.yu_domain(), 2000)
    for n, published in PUBLISHED_O1.items():
        problem = SelectionProblem(candidates, O1(), n)
        assert select(problem, tabu(), np.random.default_rng(0)).value >= published


def test_a_list_longer_than_the_candidates_is_refused():
    problem = pose_problems.build_problem("O1")
    message = line_of(select, problem, tabu(list_length=55), np.random.default_rng(0))
    assert "tabu: found a list of 55 with 9 poses" in message
