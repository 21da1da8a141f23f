"""The hostile suite in shares: one line, or what whole files give; never a traceback, and nothing half written."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest
from fuzz import disturbed
from fuzz.judged import judge_call
from fuzz.subjects import DISTURBED, QUICK
from fuzz.suite import RESULTS_COMMANDS, SORTS, UNTOUCHED, USES, WORDS, list_call

from bayescal.cli import app
from bayescal.config.registry import list_references
from bayescal.experiments import USES as ASKED

pytestmark = pytest.mark.usefixtures("no_pictures", "wary")

STEP = 25
FIRST = {"inputs": 25, "tables": 25}
RUNS = {"inputs": 150, "tables": 50}
"""How many cases of a sort are quick, and how many with the runs; all others are slow."""
CASES = [(sort, first) for sort, one in SORTS.items() if sort != "disturbed" for first in range(0, one.n, STEP)]
DRAWN = (39, 52)
"""Drawn machines that are calibrated with the runs: one without coordinates, one whose flags are integers."""
FOUND = (283,)
"""Cases of tables whose faults are mended: a covariance that is not symmetric."""


def mark(sort: str, first: int) -> object:
    mark = pytest.mark.runs if first < RUNS.get(sort, 0) else pytest.mark.slow
    return pytest.param(sort, first, marks=[] if first < FIRST.get(sort, 0) else mark)


@pytest.mark.parametrize(("sort", "first"), [mark(*case) for case in CASES])
def test_no_mutation_ends_in_a_traceback(sort, first, ground):
    numbers = range(first, min(first + STEP, SORTS[sort].n))
    assert "\n".join(filter(None, (SORTS[sort].attempt(ground, number).faults for number in numbers))) == ""


@pytest.mark.slow
@pytest.mark.parametrize("kind", sorted(DISTURBED))
def test_a_disturbed_run_ends_as_one_that_is_not(kind, ground):
    n = len(disturbed.DISTURBANCES)
    first = n * sorted(DISTURBED).index(kind)
    faults = [SORTS["disturbed"].attempt(ground, number).faults for number in range(first, first + n)]
    assert "\n".join(filter(None, faults)) == ""


def test_every_kind_and_every_command_is_tried(ground):
    known = {*list_references("KINDS"), *ASKED}
    assert {ground.subjects[name].kind for name in QUICK} >= known
    assert {*DISTURBED} >= known
    tried = {
        "run",
        "simulate",
        "validate",
        *RESULTS_COMMANDS,
        *USES,
        *(word for words in WORDS.values() for word in words),
    }
    named = {one.name or one.callback.__name__ for one in app.registered_commands if one.callback}
    assert named - tried == {*UNTOUCHED}


@pytest.mark.parametrize("use", USES)
def test_whole_tables_are_taken(use, ground, tmp_path):
    folder = Path(shutil.copytree(ground.machine, tmp_path / "whole"))
    outcome = judge_call(list_call(use, folder), folder)
    assert (outcome.code, outcome.faults) == (0, ())


@pytest.mark.runs
@pytest.mark.usefixtures("search_little")
@pytest.mark.parametrize("number", DRAWN)
def test_nothing_of_a_drawn_machine_is_lost(number, ground):
    assert SORTS["drawn"].attempt(ground, number).faults == ""


@pytest.mark.parametrize("number", FOUND)
def test_what_many_mutations_have_found_is_mended(number, ground):
    assert SORTS["tables"].attempt(ground, number).faults == ""
