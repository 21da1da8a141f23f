"""Draws of the posterior agree with what the information foretells, and say more where ridges bend."""

from __future__ import annotations

import json
from dataclasses import replace

import audit_problems as problems
import numpy as np
import pytest
import studies

from bayescal.experiments.audit.audit import judge, run_audit
from bayescal.experiments.audit.design import draw_plan, load_audit, read_design
from bayescal.experiments.audit.draws import (
    MAX_DRAWS,
    PosteriorLevel,
    audit_posterior,
    compare_spaces,
    plot_ridges,
    tabulate_plots,
)
from bayescal.experiments.audit.schema import AuditSweepConfig
from bayescal.experiments.runner.parallel import Run
from bayescal.identifiability.information import Information, information_of_rows
from bayescal.identifiability.profile import compute_profile
from bayescal.identifiability.reading_rows import see

pytestmark = pytest.mark.runs

MEASURED = problems.DESIGNS / "telescope_posterior.toml"
BEND = 3e-5  # of a tolerance squared, that even these ridges bend into what is known a thousand times better
BELOW = 5.0  # degrees: what is asked of the ridges' directions
TINY = """
kind = "audit"
name = "audit_tiny"
title = "Tiny audit"
seed = 5
data = { study = "tiny/study.toml" }
variants = [{ model = "six_pus", deformation = "matrix" }]
workspace = { position_mm = [0.5, 0.5, 0.05], rotation_deg = [0.2, 0.2, 0.0], poses = 20 }
requirements = { z = 0.02 }
"""
VARIANTS = [
    f"{model}/{deformation}" for model in ("six_pus", "jacobian") for deformation in ("none", "linear", "matrix")
]


def _plan(path, draws, variant=(), **changes):
    """Return the plan of a shipped design with some of its fields replaced, next to nothing swept, and its draws."""
    config = load_audit(path)
    posterior = config.posterior.model_copy(update={"draws": draws})
    changes |= {
        "sweep": AuditSweepConfig(noise=[1.0], poses=[40], workspace=[1.0]),
        "posterior": posterior,
        "variants": [config.variants[0].model_copy(update=dict(variant))],
    }
    return draw_plan(read_design(config.model_copy(update=changes), path.parent), Run())


def _level(plan, draws=None):
    audit = run_audit(plan, Run())
    return audit, audit_posterior(plan, draws, audit)


@pytest.fixture(scope="module")
def straight(tmp_path_factory):
    """Return audit and posterior level of a tiny study with few parameters free, on no ridge that bends."""
    folder = tmp_path_factory.mktemp("straight")
    studies.write_tiny_study(folder / "tiny")
    (folder / "audit.toml").write_text(TINY)
    return _level(*_plan(folder / "audit.toml", 8000))


@pytest.fixture(scope="module")
def bent():
    """Return audit and posterior level of the telescope with everything free."""
    return _level(*_plan(MEASURED, 4000, accuracy_frame="base"))


def test_contractions_are_those_of_the_information(straight):
    audit, level = straight
    assert not level.draws.problems
    covariance = audit.analysis.information.covariance
    relative = np.diagonal(level.covariance) / np.diagonal(covariance) - 1.0
    assert np.abs(relative).max() < 0.25  # τ is unknown to the draws
    for direction in audit.analysis.directions:
        left = 1.0 - direction.contraction
        assert abs(level.contraction_along(direction.vector) - direction.contraction) < 0.25 * left + BEND


def test_ridges_of_the_posterior(bent):
    _, level = bent
    assert level.angle.n_directions == 30
    assert level.angle.gap > 5
    assert level.angle.degrees < BELOW


def test_probability_without_bends_is_the_first_orders(straight):
    audit, level = straight
    wanted = replace(audit.inputs.requirements[0], limit=1.0)
    sd = audit.forecast.judge([wanted], audit.analysis.information, _rng(), ())[0][0]
    limit = replace(wanted, limit=2.6 * sd.predicted_sd)
    expected = audit.forecast.judge([limit], audit.analysis.information, _rng(), ())[0][0].probability
    chance = audit_posterior(replace(audit.inputs, requirements=[limit]), level.draws, audit).chances["z"]
    assert 0.2 < expected < 0.95  # where a difference would show
    assert abs(chance["probability"] - expected) < 0.06
    assert abs(chance["probability_of_mean_machine"] - expected) < 0.06


def _rng():
    return np.random.default_rng(0)


def test_machine_of_mean_parameters_lies_off_a_bent_ridge(bent):
    """All draws keep the joint a + ρ^0 u; their mean, with u shorter than one, is off by some µm in z."""
    audit, level = bent
    z = next(one for one in audit.inputs.requirements if one.name == "z")
    inputs = replace(audit.inputs, requirements=[replace(z, limit=0.018), replace(z, name="x", limit=0.1)])
    chances = audit_posterior(inputs, level.draws, audit).chances
    assert chances["z"]["probability"] > 0.95
    assert chances["z"]["probability_of_mean_machine"] < 0.5
    assert chances["x"]["probability_of_mean_machine"] > 0.95


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


def test_what_is_not_drawn_is_left_out_with_a_reason():
    _, level = _level(*_plan(MEASURED, 0))
    assert "draws is 0" in level
    _, level = _level(problems.read_shipped("m2_hexapod", sweep=problems.SHORT_SWEEP))
    assert "nothing measured" in level


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


# --- ridges in pictures ---------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def measured():
    """Return audit, level, profile and plots of the measured telescope."""
    plan, draws = _plan(MEASURED, 4000)
    audit, level = _level(plan, draws)
    ridge = next(one for one in audit.analysis.directions if one.pivot is not None and _is_bent(plan, one))
    name = plan.names[ridge.pivot]
    profile = compute_profile(plan.posterior, name, plan.expected[len(plan.names) :])
    return audit, name, plot_ridges(plan, audit, level, [profile])


def _is_bent(plan, direction):
    """Return whether a ridge is that of a gain against a direction, which bends."""
    ties = {plan.symbols[k] for k in np.flatnonzero(direction.vector)}
    return plan.symbols[direction.pivot] in ("u_x", "u_y") and "kappa" in ties


def _leave(points, curve):
    """Return the rms distance in y of points (S, 2) from a curve, of those within its reach."""
    order = np.argsort(curve[:, 0])
    x, y = curve[order].T
    inside = (points[:, 0] > x[0]) & (points[:, 0] < x[-1])
    return np.sqrt(np.mean((points[inside, 1] - np.interp(points[inside, 0], x, y)) ** 2))


def test_draws_lie_along_the_straight_direction_and_the_prior_does_not(measured):
    audit, _, plots = measured
    pairs = ({"a_z", "l"}, {"b_z", "l"}, {"rho0", "a_z"})
    ours = [one for one in plots.values() if {name.partition("[")[0] for name in (one.x, one.y)} in pairs]
    assert len(ours) >= 12
    for plot in ours:
        own, prior = (_leave(plot.points[s][:, 2:], plot.curves["tangent"]) for s in ("posterior", "prior"))
        assert own < 0.15 * prior
    assert len(plots) == sum(direction.pivot is not None for direction in audit.analysis.directions)


def test_draws_bend_with_the_profile(measured):
    """Far from the middle the draws of u and κ lie on the path of the profile's side of the tangent."""
    _, name, plots = measured
    plot = next(one for one in plots.values() if one.x == name)
    assert [one.x for one in plots.values() if "profile" in one.curves] == [name]
    (x0, y0), (x1, y1) = plot.curves["tangent"]

    def leave(points):
        far = np.abs(points[:, 0] - 0.5 * (x0 + x1)) > 0.06
        above = points[:, 1] - (y0 + (y1 - y0) / (x1 - x0) * (points[:, 0] - x0))
        return above[far].mean() - above[~far].mean()

    path = plot.curves["profile"]
    assert abs(leave(path)) > 1e-3
    assert np.sign(leave(path)) == np.sign(leave(plot.points["posterior"][:, 2:]))


def test_without_draws_the_forecast_is_drawn():
    plan = problems.read_shipped("telescope_six_pus_none")
    audit = judge(plan)
    plot = plot_ridges(plan, audit, "none")[0]
    assert set(plot.points) == {"prior", "forecast"}
    place = plan.names.index(plot.x)
    sd = np.sqrt(audit.analysis.information.covariance[place, place]) * plan.sd[place]
    chance = 5 / np.sqrt(2 * MAX_DRAWS)
    assert abs(plot.points["forecast"][:, 0].std() / sd - 1) < chance
    assert abs(plot.points["prior"][:, 0].std() / plan.sd[place] - 1) < chance
    assert abs(plot.points["prior"][:, 0].mean() - plan.parameters.nominal[place]) < 5 * plan.sd[place] / MAX_DRAWS**0.5


def test_tables_of_ridges(measured):
    audit, _, plots = measured
    tables = tabulate_plots(plots)
    draws, curves = tables["ridge_draws"], tables["ridge_curves"]
    assert list(draws.columns) == ["direction", "source", "x", "y", "x_held", "y_held"]
    assert list(curves.columns) == ["direction", "source", "x", "y"]
    pivots = [k + 1 for k, d in enumerate(audit.analysis.directions) if d.pivot is not None]
    assert list(draws["direction"].unique()) == pivots
    assert draws.groupby(["direction", "source"]).size().max() <= MAX_DRAWS
    assert set(draws["source"]) == {"prior", "posterior"}
    assert np.isfinite(curves[["x", "y"]]).all(axis=None)
    assert plots[0].x == audit.inputs.names[audit.analysis.directions[0].pivot]


def test_plots_are_in_the_designs_units(measured):
    audit, _, plots = measured
    micro = replace(audit.inputs, units=replace(audit.inputs.units, length="um"))
    other = plot_ridges(micro, audit, "none")
    number = next(n for n, one in plots.items() if {one.x[:3], one.y[:1]} == {"a_z", "l"})
    assert (other[number].x_unit, plots[number].x_unit) == ("um", "mm")
    assert np.allclose(other[number].points["prior"], 1e3 * plots[number].points["prior"])


# --- the telescope -----------------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("variant", VARIANTS)
def test_ridges_of_information_and_draws_with_everything_free(variant):
    model, deformation = variant.split("/")
    audit, level = _level(*_plan(MEASURED, None, {"model": model, "deformation": deformation}))
    assert isinstance(level, PosteriorLevel)
    assert not level.draws.problems
    assert level.angle.n_directions >= 24
    assert level.angle.gap > 1.5
    assert level.angle.degrees < BELOW
    for outlook in audit.outlooks:
        assert abs(level.chances[outlook.requirement.name]["probability"] - outlook.probability) < 0.1


@pytest.mark.slow
def test_tangents_at_the_nominal_machine_miss_the_draws():
    """A ridge that bends has another direction where the machine was expected: why the posterior's mean is taken."""
    plan, draws = _plan(MEASURED, None, {"deformation": "none"})
    sampling, found = plan.posterior.sampling, plan.maker.found.posterior.sampling
    nominal = (found.start - sampling.start)[sampling.free] / plan.sd
    y = np.concatenate([nominal, plan.expected[len(nominal) :]])
    information = information_of_rows(see(plan.posterior, y), np.ones(len(plan.names)))
    assert compare_spaces(information, draws.values / plan.sd).degrees > BELOW
