"""What a computation is at: stages by name, shares of what they count, seconds left."""

from __future__ import annotations

import numpy as np
import pytest

from bayescal.errors import NumericalError
from bayescal.inference import stages
from bayescal.inference.importance import evaluate_in_batches


@pytest.fixture
def clock(monkeypatch):
    """Return what time it is, in a list."""
    now = [100.0]
    monkeypatch.setattr(stages.time, "monotonic", lambda: now[0])
    return now


def test_a_stage_says_its_share_and_how_long_the_rest_takes(clock):
    said = []
    with stages.follow(said.append):
        clock[0] += 5.0
        stages.expect({"evidence": 1000, "sampling": 3000})
        with stages.stage("mode search"):
            clock[0] += 1.0
        with stages.stage("evidence", 1000):
            clock[0] += 2.0
            stages.count(200)
        clock[0] += 1.0
        with stages.stage("sampling", 3000):
            pass
    first, second, *_, last = said
    assert (first.stage, first.share, first.left) == ("mode search", None, None)
    assert (second.stage, second.share, second.spent) == ("evidence", 0.0, 6.0)
    assert said[2] == stages.Report("evidence", 0.2, 8.0, (800 + 3000) * 2.0 / 200)
    assert (last.stage, last.left) == ("sampling", 3000 * 2.0 / 200)


def test_a_first_answer_is_made_where_somebody_follows():
    said = []

    def fail():
        raise NumericalError("no finite density")

    stages.answer_first(lambda: said.append("made") or "x 1 mm")
    assert not said
    with stages.follow(lambda report: None, said.append):
        stages.answer_first(lambda: "x 1 mm")
        stages.answer_first(lambda: "")
        stages.answer_first(fail)
    assert said == ["x 1 mm"]


def test_stages_within_a_stage_count_for_it(clock):
    said = []
    with stages.follow(said.append), stages.stage("proposal", 10), stages.stage("evidence", 1000):
        clock[0] += 1.0
        stages.count(5)
    assert {one.stage for one in said} == {"proposal"}
    assert said[-1].share == 0.5


def test_reports_are_few(clock):
    said = []
    with stages.follow(said.append), stages.stage("sampling", 1000):
        for _ in range(1000):
            clock[0] += 0.01
            stages.count(1)
    assert 15 <= len(said) <= 21


def test_batches_are_counted_and_change_nothing():
    said, y = [], np.arange(1000.0)[:, None]
    expected = evaluate_in_batches(lambda part: part[:, 0] ** 2, y)
    with stages.follow(said.append), stages.stage("sampling", 1000):
        stages._follower.get().told = -np.inf
        found = evaluate_in_batches(lambda part: part[:, 0] ** 2, y)
        assert stages._follower.get().done == 1000
    np.testing.assert_array_equal(found, expected)
    assert said[-1].stage == "sampling"


def test_without_a_follower_nothing_happens():
    stages.expect({"evidence": 3})
    with stages.stage("evidence", 3):
        stages.count(3)
    assert stages._follower.get() is None
