"""Simulated calibrations: their errors against what an audit predicts, reduced sets, requirements kept."""

from __future__ import annotations

from dataclasses import replace

import audit_problems as problems
import numpy as np
import pytest

from bayescal.density.schema import NormalConfig
from bayescal.errors import InputError
from bayescal.identifiability.calibration import Calibrations, compare_kept, compare_with_prediction
from bayescal.identifiability.information import Information
from bayescal.identifiability.requirements import DRAWS
from bayescal.identifiability.selection import judge_reduced, select_parameters


def test_comparison_of_known_errors():
    """Errors of plus and minus twice the prediction for one parameter and as predicted for the other."""
    signs = np.array([1.0, -1.0, 1.0, -1.0])
    errors, claimed = np.outer(signs, [0.2, 0.1]), np.tile([0.4, 0.05], (4, 1))
    simulated = Calibrations(("a_x[1]", "a_y[1]"), errors, claimed, np.ones(4, dtype=bool), 0)
    found = compare_with_prediction(simulated, np.diag([0.1**2, 0.1**2]))
    assert found.ratio == pytest.approx([2.0, 1.0])
    assert found.ratio_error == pytest.approx([0.0, 0.0], abs=1e-9)
    assert found.by_symbol() == pytest.approx({"a_x": 2.0, "a_y": 1.0})
    assert found.chi_square == pytest.approx(2.5)
    assert found.claimed == pytest.approx([0.4, 0.05])
    assert found.covered == pytest.approx([1.0, 0.0])
    assert found.z == pytest.approx([0.5, 2.0])
    none = replace(simulated, errors=errors[:0], claimed=claimed[:0])
    with pytest.raises(InputError, match="found 0 converged"):
        compare_with_prediction(none, np.eye(2))


# --- reduced sets ------------------------------------------------------------------------------------------------


def read_small(name):
    """Return a shipped plan whose tolerances are a hundredth."""
    config = problems.load_audit(problems.DESIGNS / f"{name}.toml")
    scaled = {
        symbol: one.model_copy(update={"sd": (0.01 * np.asarray(one.sd)).tolist()})
        for symbol, one in config.parameters.items()
        if isinstance(one, NormalConfig)
    }
    return problems.read_shipped(name, parameters={**config.parameters, **scaled}).without_systematic_errors()


def test_a_reduced_set_errs_as_said_in_closed_form():
    """A hundredth of the tolerances; what is held at nominal is off all the same."""
    plan = read_small("telescope_six_pus_linear")
    information = plan.inform()
    free = tuple(k for k, symbol in enumerate(plan.symbols) if symbol in ("a_x", "a_y", "b_x", "b_y", "l"))
    reduced = judge_reduced(information, free)
    simulated, _ = plan.simulate(60, np.random.default_rng(2), free)
    found = compare_with_prediction(simulated, information.errors_of_reduced(free)[np.ix_(free, free)])
    assert found.names == tuple(plan.names[k] for k in free)
    assert np.abs((found.ratio - 1.0) / found.ratio_error).max() < 4.5
    assert found.claimed == pytest.approx(reduced.claimed, rel=0.05)
    assert np.mean(found.covered) == pytest.approx(reduced.coverage.mean(), abs=0.05)
    assert reduced.rms_z > 1.5  # or the test would say nothing
    assert np.sqrt(np.mean(found.z**2)) == pytest.approx(reduced.rms_z, rel=0.15)


def test_nothing_left_out_is_no_reduced_set():
    plan = problems.read_shipped("telescope_six_pus_linear")
    information = plan.inform()
    assert judge_reduced(information, ()) is None
    assert judge_reduced(information, tuple(range(len(plan.names)))) is None


def test_a_reduced_set_of_what_is_told_apart_is_right():
    """Two parameters without any common information, by hand: leaving one out does not matter."""
    information = Information(np.diag([3.0, 2.0]))
    reduced = judge_reduced(information, (0,))
    assert reduced.claimed == pytest.approx([10**-0.5])
    assert reduced.coverage == pytest.approx([0.9])
    bent = judge_reduced(Information(np.array([[3.0, 3.0]])), (0,))  # the other one is read as this one
    assert bent.error**2 == pytest.approx([0.1 + 0.81])


# --- requirements kept -------------------------------------------------------------------------------------------


def count_kept_of(name, n, shares):
    """Return what machines of a design keep, of limits that are shares of the predicted sd, beside what is claimed."""
    plan = problems.read_shipped(name).without_systematic_errors()
    information, forecast = plan.inform(), plan.forecast()
    arguments = (information, np.random.default_rng(4), ())
    wanted = [
        replace(one.requirement, limit=share * one.predicted_sd)
        for one in forecast.judge(plan.requirements, *arguments)[0]
        for share in shares
    ]
    claimed = [one.probability for one in forecast.judge(wanted, *arguments)[0]]
    every = list(range(len(plan.names)))
    simulated, kept = replace(plan, requirements=wanted).simulate(n, np.random.default_rng(6), every)
    return claimed, [
        compare_kept(int(k), int(simulated.converged.sum()), p, DRAWS) for k, p in zip(kept, claimed, strict=True)
    ]


@pytest.mark.runs
def test_requirements_are_kept_as_often_as_claimed():
    claimed, found = count_kept_of("m2_hexapod", 120, (1.9,))
    assert all(0.4 < p < 0.9 for p in claimed)  # where a difference would show
    assert all(one.agrees for one in found)
    halved = [compare_kept(one.kept, one.n, p / 2.0, DRAWS) for one, p in zip(found, claimed, strict=True)]
    assert not any(one.agrees for one in halved)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["telescope_six_pus_linear", "telescope_six_pus_none", "m2_hexapod"])
def test_three_hundred_machines_keep_requirements_as_often_as_claimed(name):
    """Limits from mostly broken to mostly kept; each count has a chance of one in a hundred to be out of its band."""
    claimed, found = count_kept_of(name, 300, (1.8, 2.3, 3.2, 4.2))
    assert min(claimed) < 0.6 < 0.95 < max(claimed)
    assert sum(not one.agrees for one in found) <= 1


@pytest.mark.slow
@pytest.mark.parametrize("recommended", [False, True])
@pytest.mark.parametrize("name", ["camera_hexapod", "m2_hexapod"])
def test_two_hundred_audited_calibrations_are_as_accurate_as_predicted(name, recommended):
    plan = problems.read_shipped(name).without_systematic_errors()
    if recommended:
        free = [plan.names[k] for k in select_parameters(plan.inform(), plan.symbols, plan.frames).free]
        plan = plan.replan(
            plan.maker.plan(plan.config.poses), plan.section.model_copy(update={"free": free})
        ).without_systematic_errors()
    simulated, _ = plan.simulate(200, np.random.default_rng(1), list(range(len(plan.names))))
    check_accuracy(simulated, plan.inform().covariance)
    averaged = compare_with_prediction(simulated, plan.average(200, np.random.default_rng(2)))
    assert abs(averaged.chi_square - 1.0) < 4 * averaged.chi_square_error


def check_accuracy(simulated, covariance):
    assert simulated.converged.all()
    audit = compare_with_prediction(simulated, covariance)
    assert max(abs(ratio - 1.0) for ratio in audit.by_symbol().values()) < 0.1
    assert np.abs((audit.ratio - 1.0) / audit.ratio_error).max() < 4.5
    assert abs(np.mean(np.abs(simulated.errors) < 1.96 * audit.predicted) - 0.95) < 0.01
