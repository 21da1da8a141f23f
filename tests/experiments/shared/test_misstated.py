"""Readings that need errors far beyond what was allowed for are said to, and no others."""

from __future__ import annotations

import shutil
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from bayescal.experiments.selftest.inputs import read_selftest
from bayescal.experiments.selftest.kind import configure_selftest
from bayescal.experiments.shared.misstated import find_misstated
from bayescal.experiments.shared.readings.errors import drop_model_error
from bayescal.experiments.shared.slip_verdict import Rival
from bayescal.identifiability.requirements import Requirement

BENCHMARK = Path(__file__).parents[3] / "benchmarks" / "slips"
sys.path.insert(0, str(BENCHMARK))
from machines import read_subject, write_project  # noqa: E402
from plants import PLANTS  # noqa: E402

sys.path.remove(str(BENCHMARK))

pytestmark = pytest.mark.runs

SIZE = 0.2  # mm rms: ten times what functions of the pose are allowed by default
POSITION = Requirement("position", 0.05, ("x", "y", "z"), part=slice(0, 3))


@pytest.fixture(scope="module")
def delta(tmp_path_factory):
    return read_subject(write_project("linear delta", tmp_path_factory.mktemp("misstated") / "delta"))


def err(subject, size, seed=1):
    """Return a study whose own channels err by random functions of all their positions, so large rms, mm."""
    rng = np.random.default_rng(seed)
    clean = subject.measured.retake(PLANTS["clean"](subject, rng)[0])
    values, own = clean.posterior.likelihood.data.values.copy(), np.flatnonzero(clean.internal)
    travel = values[:, own] - values[:, own].mean(axis=0)
    errors = travel @ rng.standard_normal((len(own), len(own)))
    values[:, own] += size * errors / np.sqrt(np.mean(errors**2))
    return subject.measured.retake(values)


@pytest.mark.parametrize(("seed", "value"), [(1, 1e6), (2, -1e6)])
def test_errors_far_beyond_what_was_allowed_for_are_said_with_the_best_cause(delta, seed, value):
    rival = Rival("a gremlin sat on leg 1", value)
    found = find_misstated([err(delta, SIZE, seed).readings], rivals=[rival])
    assert found.fault == "large errors"
    assert 5.0 < found.factor < 40.0
    assert found.gain > 10.0
    assert (rival.text in found.text) == (value > 0.0)


@pytest.mark.parametrize("size", [0.0, 0.02])
def test_errors_as_large_as_allowed_for_are_not(delta, size):
    found = find_misstated([err(delta, size).readings])
    assert found is None or found.fault != "large errors"


def test_errors_beyond_a_requirement_are_said(delta):
    readings = err(delta, 0.08).readings
    allowed = find_misstated([readings], [replace(POSITION, limit=5.0)])
    assert allowed is None or allowed.fault != "large errors"
    found = find_misstated([readings], [POSITION])
    assert found.fault == "large errors"
    assert 1.0 < found.factor < 4.0
    assert "position" in found.text


def test_without_a_model_error_what_noise_does_not_explain_is_said(delta):
    """Nothing else is allowed for then: where no noise or tolerance explains it, its size is in that of the noise."""
    measured = err(delta, SIZE)
    found = find_misstated([replace(measured, posterior=drop_model_error(measured.posterior)).readings])
    assert found is not None
    assert found.factor > 1.5


CASES = Path(__file__).parents[2] / "cases"
CELLS = {
    "functions as good": ("own_term_shrinks_gains", "sd = 0.3", "tolerance or model error"),
    "nothing as good": ("cells_under_masses", "sd = 0.05", "tolerance"),
}


@pytest.mark.parametrize("case", CELLS)
def test_gains_with_tolerances_far_too_tight_are_said_to(case, tmp_path):
    """A machine of no lengths, of which errors within what is allowed for could be the gains' as well."""
    name, stated, fault = CELLS[case]
    path = shutil.copytree(CASES / name, tmp_path / name) / "study.toml"
    text, width, found = path.read_text(), float(stated.partition("= ")[2]), {}
    for share in (1.0, 0.003):
        path.write_text(text.replace(stated, f"sd = {share * width:g}"))
        (subject,) = read_selftest(configure_selftest(path, [], None, None), path.parent).subjects.values()
        found[share] = find_misstated([subject.measured.readings])
    assert found[1.0] is None or found[1.0].fault == "wide tolerance"
    assert found[0.003].fault == fault
    assert 8.0 <= found[0.003].factor <= 100.0
    assert found[0.003].gain > 5.0
