"""The cause of data that a study does not explain is named first, whatever the machine; clean studies are not accused.

Slips are planted by the benchmark's own functions (`benchmarks/slips`), which measures shares over many studies.
"""

from __future__ import annotations

import re
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from shares import run_rest

from bayescal.experiments.selftest.faults import state_cause
from bayescal.experiments.shared import slip_search
from bayescal.experiments.shared.misstated import find_misstated
from bayescal.experiments.shared.readings.priors import widen
from bayescal.experiments.shared.slip_search import search_cause

BENCHMARK = Path(__file__).parents[3] / "benchmarks" / "slips"
sys.path.insert(0, str(BENCHMARK))
from machines import read_subject, write_project  # noqa: E402
from plants import PLANTS  # noqa: E402

sys.path.remove(str(BENCHMARK))

KINDS = ("hexapod by poses", "linear delta", "serial arm", "cable robot")
SLIPS = [name for name in PLANTS if name not in ("clean", "erring")]


@pytest.fixture(scope="module")
def subjects(tmp_path_factory):
    """Return machines by their names, each read once."""
    folder = tmp_path_factory.mktemp("causes")
    return {one: read_subject(write_project(one, folder / one.replace(" ", "_"))) for one in KINDS}


def plant(subject, slip, seed):
    values, fault, words = PLANTS[slip](subject, np.random.default_rng([7, seed]))
    return subject.measured.retake(values), fault, words


PLANTED = [
    *(("linear delta", slip) for slip in SLIPS),
    *(("serial arm", slip) for slip in SLIPS[::2]),
    *(("hexapod by poses", slip) for slip in SLIPS[1::2]),
]
"""Machines and slips; all of both are among the slow tests."""


@pytest.mark.parametrize("planted", run_rest(PLANTED, 2), ids="-".join)
def test_a_planted_slip_is_named_first(subjects, planted):
    machine, slip = planted
    measured, fault, words = plant(subjects[machine], slip, 1)
    found = search_cause(measured.readings).first
    assert found is not None
    assert set(fault.split()) & set(found.faults)
    assert any(word in found.text for word in words)


def test_a_channel_that_is_stated_to_have_no_noise_is_searched(subjects):
    measured, _, _ = plant(subjects["linear delta"], "sensor", 1)
    likelihood = measured.posterior.likelihood
    sd = np.where(np.arange(likelihood.data.sd.shape[1]) == 3, 0.0, likelihood.data.sd)
    exact = replace(likelihood, data=replace(likelihood.data, sd=sd), expansion=None)
    found = search_cause(replace(measured.readings, posterior=replace(measured.posterior, likelihood=exact)))
    assert found.tried > 0


@pytest.mark.slow
@pytest.mark.parametrize("slip", SLIPS)
@pytest.mark.parametrize("machine", KINDS)
def test_most_planted_slips_are_named(subjects, machine, slip):
    """Two of three at least: some tolerances of legs are told apart by no data (see the benchmark's table)."""
    named = 0
    for seed in range(3):
        measured, fault, words = plant(subjects[machine], slip, seed)
        found = search_cause(measured.readings).first
        known = found is not None and set(fault.split()) & set(found.faults)
        named += bool(known) and any(word in found.text for word in words)
    assert named >= 2


def restate(subject, noise=1.0, tolerance=1.0, symbols=(), seed=1):
    """Return readings of a machine of the priors, with some channels' noise and tolerances stated so many times."""
    measured, _, _ = plant(subject, "clean", seed)
    posterior, likelihood = measured.posterior, measured.posterior.likelihood
    data = replace(likelihood.data, sd=likelihood.data.sd * noise)
    priors = {
        name: widen(one, tolerance) if not symbols or name.partition("[")[0] in symbols else one
        for name, one in posterior.priors.items()
    }
    likelihood = replace(likelihood, data=data, expansion=None)
    return replace(measured, posterior=replace(posterior, likelihood=likelihood, priors=priors)).readings


@pytest.mark.runs
@pytest.mark.parametrize(
    ("fault", "changes"),
    [
        ("tolerance", {"tolerance": 0.1}),
        ("wide tolerance", {"tolerance": 10.0}),
        ("scatter", {"noise": 0.1}),
        ("noise", {"noise": 10.0}),
        (None, {}),
    ],
)
def test_noise_and_tolerances_that_are_stated_wrong_are_told_apart(subjects, fault, changes):
    found = find_misstated([restate(subjects["linear delta"], **changes)])
    assert (None if found is None else found.fault) == fault
    if fault is not None:
        stated = changes.get("tolerance", changes.get("noise"))
        assert 0.4 < found.factor * stated < 2.5


@pytest.mark.runs
def test_a_model_error_gives_way_to_tolerances_that_explain_what_it_took_up(subjects):
    """Of two letters a tenth: functions of the pose explain the data, worse than these do."""
    found = search_cause(restate(subjects["hexapod by poses"], tolerance=0.1, symbols=("b_x", "b_y"))).first
    assert found is not None
    assert found.fault == "tolerance"
    assert "b_x" in found.text or "b_y" in found.text


@pytest.mark.runs
@pytest.mark.parametrize("machine", KINDS)
@pytest.mark.parametrize("seed", range(2))
def test_clean_studies_are_not_accused(subjects, machine, seed):
    assert search_cause(plant(subjects[machine], "clean", seed)[0].readings).first is None


@pytest.mark.parametrize(
    "machine", ["linear delta", *(pytest.param(one, marks=pytest.mark.runs) for one in KINDS[::2])]
)
def test_a_machine_that_errs_by_what_no_model_states_is_no_slip(subjects, machine):
    found = search_cause(plant(subjects[machine], "erring", 1)[0].readings)
    assert found.slip is None
    assert found.first is None or found.first.fault == "model error"


def test_missing_readings_and_a_row_out_of_reach_are_survived(subjects):
    measured, _, _ = plant(subjects["linear delta"], "clean", 3)
    values = measured.posterior.likelihood.data.values.copy()
    values[3, 4] = np.nan
    values[6, 0] += 400.0
    found = search_cause(measured.retake(values).readings).first
    assert found is not None
    assert (found.fault, "row 7 " in found.text) == ("rows", True)


def test_a_cause_has_its_gain_and_an_action(subjects):
    measured, _, _ = plant(subjects["linear delta"], "frame", 1)
    search = search_cause(measured.readings)
    (finding,) = state_cause(search)
    assert (finding.fault, finding.level, finding.value) == ("frame", "bad", search.first.gain)
    assert "frames.base" in finding.action


def test_a_hopeless_search_stops_and_says_what_it_tried(subjects, monkeypatch):
    monkeypatch.setattr(slip_search, "PATIENCE", 0.0)
    search = replace(search_cause(plant(subjects["linear delta"], "unit", 1)[0].readings), first=None)
    assert search.stopped
    assert [(one.level, one.value) for one in state_cause(search)] == [("warning", search.tried)]


def test_rows_that_leave_nothing_to_compare_count_for_nothing(subjects):
    """Of some rows the camera saw nothing: the carriages alone say where the platform is."""
    measured, _, _ = plant(subjects["linear delta"], "clean", 3)
    values = measured.posterior.likelihood.data.values.copy()
    values[::4, ~measured.internal] = np.nan
    found = search_cause(measured.retake(values).readings)
    assert found.first is None
    assert found.misfit == pytest.approx(search_cause(measured.readings).misfit, rel=0.3)


def test_a_channel_in_micrometres_is_no_matter_of_scale(subjects):
    measured, _, _ = plant(subjects["linear delta"], "clean", 3)
    values = measured.posterior.likelihood.data.values.copy()
    values[:, 4] *= 1e3
    found = search_cause(measured.retake(values).readings)
    assert (found.first.fault, found.slip.fault) == ("unit", "unit")
    assert re.search(r"\bcam_y\b.* 1000 ", found.first.text)


@pytest.mark.runs
@pytest.mark.parametrize("channel", [1, 11], ids=["a commanded one", "a part of a rotation"])
def test_a_channel_of_legs_that_does_not_move_is_named(subjects, channel):
    measured, _, _ = plant(subjects["hexapod by poses"], "clean", 3)
    values = measured.posterior.likelihood.data.values.copy()
    values[:, channel] = values[0, channel]
    found = search_cause(measured.retake(values).readings).slip
    assert found.fault == "channel"
    assert measured.readings.channels[channel].name in found.text
