"""Channels that what is given of the rows moves alone have the default model error, as those that coordinates move."""

from __future__ import annotations

import numpy as np
import pytest
from studies import run_little

import bayescal as bc
from bayescal.experiments.runner.results import read_results
from bayescal.experiments.shared.slips import LARGE
from bayescal.experiments.study.inputs import StudyInputs

TRUTH = {"centre": 1512.0, "gain": 0.00157}


def test_the_channel_moves_by_what_is_given(case):
    folder = case("given_moves_channels")
    inputs = StudyInputs.load(bc.load_experiment(folder / "study.toml"), folder)
    (variant,) = inputs.variants.values()
    terms = {name: term for term in variant.errors.terms for name in term.names}
    assert list(terms) == ["tau", "sigma_positioning", "sigma_smooth", "sigma_drift"]  # the linear one is the gain
    own = terms["sigma_smooth"].own
    np.testing.assert_allclose(own.range, 2.0 * 0.0016 * 500.0)  # twice what lies between the middle and an end
    assert inputs.misstated.fault == LARGE  # not the noise: errors of far more than what is allowed for


@pytest.mark.runs
@pytest.mark.usefixtures("no_pictures")
def test_the_bend_is_found_and_allowed_for(case, call):
    code, complaint, out = run_little(call, case("given_moves_channels") / "study.toml")
    assert code in (0, 3), complaint
    results = read_results(out)
    assert "lost" not in results.summary
    assert "disagree" not in results.summary["headline"]
    found = results.table("parameters").set_index("parameter")
    for name, true in TRUTH.items():
        assert found.loc[name, "q05"] < true < found.loc[name, "q95"]


@pytest.mark.runs
@pytest.mark.usefixtures("no_pictures")
def test_uses_take_a_machine_of_instruments_alone(case, call):
    folder = case("given_moves_channels")
    _, _, out = run_little(call, folder / "study.toml")
    assert call("export", out, "--out", folder / "exported", "--allow-unconverged")[0] == 0
    assert "pulse_us" in (folder / "exported" / "measured.csv").read_text()
    plan = folder / "plan.csv"
    assert call("verify", out, "--out", plan, "--allow-unconverged")[0] == 0
    assert call("verify", out, "--measured", folder / "readings.csv", "--allow-unconverged")[0] == 0
    code, _, complaint = call("compensate", out, plan, "--allow-unconverged")
    assert code == 2
    assert "external channels" in complaint
