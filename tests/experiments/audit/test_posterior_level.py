"""Draws of the posterior agree with what the information foretells, and say more where ridges bend."""

from __future__ import annotations

import json
from dataclasses import replace

import audit_problems as problems
import numpy as np
import pytest

from bayescal.experiments.audit.audit import run_audit
from bayescal.experiments.audit.design import load_audit, read_inputs
from bayescal.experiments.audit.draws import LeftOut, PosteriorLevel, audit_posterior, compare_spaces
from bayescal.experiments.audit.schema import SweepConfig
from bayescal.experiments.frame.parallel import Run
from bayescal.identifiability.information import Information, information_of_rows
from bayescal.identifiability.requirements import Requirement
from bayescal.identifiability.sensitivity import compute_sensitivity

pytestmark = pytest.mark.runs

TELESCOPE = problems.DESIGNS / "telescope_six_pus_none.toml"
MEASURED = problems.DESIGNS / "telescope_posterior.toml"
BEND = 3e-5  # of a tolerance squared, that even these ridges bend into what is known a thousand times better
BELOW = 5.0  # degrees: what is asked of the ridges' directions
VARIANTS = [
    f"{model}/{deformation}" for model in ("six_pus", "jacobian") for deformation in ("none", "linear", "matrix")
]


def _inputs(path, draws, variant=(), **changes):
    """Return the inputs of a shipped design with some of its fields replaced, and next to nothing swept."""
    config = load_audit(path)
    posterior = config.posterior.model_copy(update={"draws": draws})
    changes |= {
        "sweep": SweepConfig(noise=[1.0], poses=[40], workspace=[1.0]),
        "posterior": posterior,
        "variants": [config.variants[0].model_copy(update=dict(variant))],
    }
    return read_inputs(config.model_copy(update=changes), path.parent)


def _level(inputs):
    audit = run_audit(inputs, Run())
    return audit, audit_posterior(inputs, audit, Run())


@pytest.fixture(scope="module")
def straight():
    """Return audit and posterior level of the telescope with few parameters free, on no ridge that bends."""
    return _level(_inputs(TELESCOPE, 4000, {"free": ["a_x", "b_x", "l"]}))


@pytest.fixture(scope="module")
def bent():
    """Return audit and posterior level of the telescope with everything free."""
    return _level(_inputs(TELESCOPE, 4000))


def test_contractions_are_those_of_the_information(straight):
    audit, level = straight
    assert not level.draws.problems
    covariance = audit.analysis.information.covariance
    relative = np.diagonal(level.covariance) / np.diagonal(covariance) - 1.0
    chance = np.sqrt(2.0 / level.draws.diagnostics.ess_bulk.min())
    assert np.abs(relative).max() < 5 * chance
    for direction in audit.analysis.directions:
        left = 1.0 - direction.contraction
        assert abs(level.contraction_along(direction.vector) - direction.contraction) < 5 * chance * left + BEND


def test_mean_is_the_expected_machine(straight):
    audit, level = straight
    knowledge = audit.inputs.knowledge
    error = (level.draws.mean - knowledge.centre[knowledge.free]) / level.draws.values.std(axis=0)
    assert np.abs(error).max() < 5 / np.sqrt(level.draws.diagnostics.ess_bulk.min())


def test_ridges_of_the_expected_posterior(bent):
    _, level = bent
    assert level.angle.n_directions == 24
    assert level.angle.gap > 10
    assert level.angle.degrees < BELOW


def test_probability_without_bends_is_the_first_orders(straight):
    audit, _ = straight
    sd = audit.forecast.judge([Requirement("z", 1.0)], audit.analysis.information, _rng(), ())[0][0]
    limit = Requirement("z", 2.6 * sd.predicted_sd)
    inputs = replace(audit.inputs, requirements=[limit])
    expected = audit.forecast.judge([limit], audit.analysis.information, _rng(), ())[0][0].probability
    chance = audit_posterior(inputs, audit, Run()).chances["z"]
    assert 0.2 < expected < 0.8  # where a difference would show
    assert abs(chance.probability - expected) < 0.06
    assert abs(chance.of_mean_machine - expected) < 0.06


def _rng():
    return np.random.default_rng(0)


def test_machine_of_mean_parameters_lies_off_a_bent_ridge(bent):
    """All draws keep the joint a + ρ^0 u; their mean, with u shorter than one, is off by some µm in z."""
    audit, _ = bent
    inputs = replace(audit.inputs, requirements=[Requirement("z", 0.004), Requirement("x", 0.1)])
    chances = audit_posterior(inputs, audit, Run()).chances
    assert chances["z"].probability > 0.99
    assert chances["z"].of_mean_machine < 0.5
    assert chances["x"].of_mean_machine > 0.99


def test_summary_is_in_the_designs_units(straight):
    audit, level = straight
    summary = level.summary()
    json.dumps(summary, allow_nan=False)
    assert summary["n_draws"] == len(level.draws.values)
    assert summary["converged"]
    assert summary["left_out"] is None
    micro = replace(level, inputs=replace(audit.inputs, units=replace(audit.inputs.units, length="um")))
    ours, theirs = summary["parameters"]["l[3]"], micro.summary()["parameters"]["l[3]"]
    assert np.isclose(1e3 * ours["mean"], theirs["mean"], rtol=1e-12)
    assert np.isclose(1e3 * ours["sd"], theirs["sd"], rtol=1e-12)
    assert ours["contraction"] == theirs["contraction"]


@pytest.mark.parametrize(
    ("path", "draws", "sensors", "said"),
    [
        (TELESCOPE, None, None, "wants no draws"),
        (TELESCOPE, 0, None, "wants no draws"),
        (MEASURED, 0, None, "draws is 0"),
        (problems.DESIGNS / "camera_hexapod_frames.toml", 2000, None, "frames are free"),
        (TELESCOPE, 2000, {"position_um": 10.0}, "only a part of pose 1"),
        (TELESCOPE, 2000, {"position_um": 10.0, "orientation_arcsec": 2.0, "axes": "xz"}, "only a part of pose 1"),
    ],
)
def test_what_cannot_be_drawn_is_left_out_with_a_reason(path, draws, sensors, said):
    changes, variant = {}, {}
    if sensors is not None:
        config = load_audit(path)
        tracker = type(config.sensors["laser_tracker"]).model_validate({"kind": "pose", **sensors})
        changes, variant = {"sensors": {"laser_tracker": tracker}}, {"sensors": ["laser_tracker"]}
    _, level = _level(_inputs(path, draws, variant, **changes))
    assert isinstance(level, LeftOut)
    assert said in level.reason
    assert level.contraction_along(np.ones(1)) is None


# --- spaces ------------------------------------------------------------------------------------------------------


def _draw(variances, turned, n, rng):
    """Return information of given variances, and draws of it with the last weak and the first informed axis turned."""
    axes = np.eye(len(variances))
    angle = np.radians(turned)
    k = int(np.sum(variances > 0.25))
    axes[[k - 1, k], k - 1] = np.cos(angle), np.sin(angle)
    axes[[k - 1, k], k] = -np.sin(angle), np.cos(angle)
    draws = (rng.standard_normal((n, len(variances))) * np.sqrt(variances)) @ axes.T
    return Information(np.diag(np.sqrt(1.0 / variances - 1.0))), draws


@pytest.mark.parametrize("turned", [0.0, 4.0, 12.0])
def test_a_planted_turn_is_found(turned, rng):
    information, draws = _draw(np.array([1.0, 0.9, 0.8, 0.02, 0.01]), turned, 100_000, rng)
    angle = compare_spaces(information, draws)
    assert (angle.n_directions, round(angle.gap)) == (3, 40)
    assert abs(angle.degrees - turned) < 0.5
    assert angle.halves < 0.5


def test_directions_that_may_be_exchanged_are_not_torn_apart(rng):
    """Two directions at the threshold: any turn of one into the other leaves the spaces below the gap as they are."""
    information, draws = _draw(np.array([1.0, 0.6, 0.251, 0.249, 0.08]), 45.0, 100_000, rng)
    angle = compare_spaces(information, draws)
    assert angle.n_directions == 4
    assert angle.degrees < 1.0


def test_a_gap_far_from_the_threshold_does_not_stand_in(rng):
    information, draws = _draw(np.array([1.0, 0.9, 0.4, 0.15, 1e-6]), 0.0, 1000, rng)
    assert compare_spaces(information, draws).n_directions == 3


def test_chance_is_seen_from_halves(rng):
    """The halves' angle is about twice what chance does to all of the draws."""
    variances = np.concatenate([np.full(20, 0.5), np.full(20, 0.2)])
    found = [compare_spaces(*_draw(variances, 0.0, 4000, rng)) for _ in range(10)]
    ratio = np.mean([f.halves for f in found]) / np.mean([f.degrees for f in found])
    assert 1.7 < ratio < 2.3


@pytest.mark.parametrize("variances", [np.full(3, 0.9), np.full(3, 0.1)])
def test_nothing_to_compare(variances, rng):
    draws = rng.standard_normal((100, 3))
    assert compare_spaces(Information(np.diag(np.sqrt(1.0 / variances - 1.0))), draws) is None


# --- the telescope -----------------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("variant", VARIANTS)
def test_ridges_of_information_and_draws_with_everything_free(variant):
    model, deformation = variant.split("/")
    inputs = _inputs(MEASURED, None, {"model": model, "deformation": deformation})
    audit, level = _level(inputs)
    assert isinstance(level, PosteriorLevel)
    assert not level.draws.problems
    assert level.angle.n_directions >= 24
    assert level.angle.gap > 1.5
    assert level.angle.degrees < BELOW
    for outlook in audit.outlooks:
        assert abs(level.chances[outlook.requirement.name].probability - outlook.probability) < 0.1


@pytest.mark.slow
def test_tangents_at_the_nominal_machine_miss_the_draws():
    """A ridge that bends has another direction where the machine was expected: why the posterior's mean is taken."""
    inputs = _inputs(MEASURED, None, {"deformation": "none"})
    knowledge = inputs.knowledge
    nominal = compute_sensitivity(knowledge, inputs.plan.actuators, knowledge.layout.nominal)
    information = information_of_rows(nominal.rows(inputs.plan), knowledge.sd)
    assert compare_spaces(information, inputs.measured.draws.values / knowledge.sd).degrees > BELOW
