"""Claims on machines where the verdict is known: each one is seen to hold and to fail."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
import studies
import telescope_machines as machines
from papers import claims
from scipy import stats
from scipy.special import logsumexp

from bayescal.config.registry import find_class
from bayescal.density.calibration.terms import NO_ERRORS
from bayescal.errors import InputError, NumericalError
from bayescal.experiments.shared.readings.errors import drop_model_error
from bayescal.experiments.study.claims import Claims
from bayescal.inference.mode import find_modes
from bayescal.machines.deformations import NominalDeformation
from bayescal.machines.kinematics import solve_forward_kinematics
from bayescal.machines.models import MODELS, FixedStiffness, Jacobian, SixPus
from rr8096 import accuracy, geometry, identifiability, identification
from rr8096.evidence import FAILS, HOLDS, UNTESTABLE, ClaimEvidence
from rr8096.identifiability import compute_contraction, tolerance_of
from rr8096.identified import FREE, identify_variants, tabulate_least_squares
from rr8096.least_squares import LeastSquaresFit, identify

judge_claims, tabulate_claims = claims.judge_claims, claims.tabulate_claims
TWIN = "Reconstructed: simulated for the tests, never measured"
COLUMNS = ["claim", "section", "statement", "expected", "found", "value", "unit", "verdict", "reason"]


def build_subject(
    scale: float = 1.0, noise: float = 1.0, deformation: str = "matrix", theta=None, mechanism=None, **changes: object
) -> ClaimEvidence:
    """Return the telescope at the poses of table 3, drawn together by a scale, with its noise times a factor."""
    mechanism = mechanism or machines.build_telescope()
    truth = machines.build_machine(deformation, mechanism)
    theta = machines.telescope_truth(truth) if theta is None else theta
    travel = machines.ACTUATOR_RANGE * scale * machines.TABLE_3[:, np.arange(mechanism.n_legs) % 6]
    actuators = mechanism.initial_actuator_positions + travel
    covariance = noise**2 * machines.measurement_covariance(len(actuators))
    normal = np.random.default_rng(3).standard_normal((len(actuators), 6, 1))
    error = (np.linalg.cholesky(covariance) @ normal)[..., 0]
    poses = replace(machines.place_poses(truth, theta, actuators, error), covariance=covariance)
    matrix = machines.build_deformation("matrix", mechanism.n_legs).matrix
    fields = {
        "mechanism": mechanism,
        "nominal": NominalDeformation(0.011, lambda: matrix),
        "poses": poses,
        "all_poses": poses,
        "target_noise": 3e-3 * noise,
        "actuator_noise": 1e-3 * noise,
        "origin": TWIN,
        "free": {},
        "fits": {},
        "variants": {},
        "published": {},
        "weigh_alone": {}.__getitem__,
    }
    return ClaimEvidence(**(fields | changes))


def with_fits(evidence: ClaimEvidence, *names: str) -> ClaimEvidence:
    """Return the evidence with least squares of some variants, the report's parameters free."""
    fits, free = {}, {}
    for name in names:
        free[name] = tuple(sorted(FREE[name.split("/")[1]]))
        fits[name] = identify(evidence.machine(*name.split("/")), evidence.poses, free[name])
    return replace(evidence, fits=fits, free=free)


def with_offsets(evidence: ClaimEvidence, offsets: dict[str, dict[str, object]]) -> ClaimEvidence:
    """Return the evidence as if least squares had found these offsets."""
    fits, free = {}, {}
    for name, values in offsets.items():
        layout = evidence.machine(*name.split("/")).layout
        theta, free[name] = layout.nominal.copy(), tuple(sorted(FREE[name.split("/")[1]]))
        for symbol, value in values.items():
            theta[layout.index[symbol]] += value
        fits[name] = LeastSquaresFit(theta, np.full(6, 1e-3), 1.0, 36, True)
    return replace(evidence, fits=fits, free=free)


def run(function, evidence: ClaimEvidence) -> dict[str, claims.ClaimRow]:
    return {claim.claim: claim for claim in function(evidence)}


def verdict_of(function, evidence: ClaimEvidence) -> str:
    """Return the verdict of a function with one claim."""
    (claim,) = function(evidence)
    return claim.verdict


@pytest.fixture(scope="module")
def telescope() -> ClaimEvidence:
    return build_subject()


@pytest.fixture(scope="module")
def small() -> ClaimEvidence:
    """Return the telescope with a tenth of the motor range."""
    return build_subject(scale=0.1)


@pytest.fixture(scope="module")
def sharp() -> ClaimEvidence:
    """Return the telescope with five times the motor range and a ten-thousandth of the noise."""
    return build_subject(scale=5.0, noise=1e-4)


# --- the machine -----------------------------------------------------------------------------------------------------


def test_motor_accuracy(telescope, monkeypatch):
    found = run(geometry.motor_accuracy, telescope)
    assert found["motor_accuracy_position"].verdict == HOLDS
    assert found["motor_accuracy_position"].value == pytest.approx(5.9, abs=0.1)
    assert found["motor_accuracy_orientation"].verdict == FAILS
    monkeypatch.setattr(geometry, "MOTOR_ACCURACY", 2e-3)
    assert run(geometry.motor_accuracy, telescope)["motor_accuracy_position"].verdict == FAILS
    monkeypatch.setattr(geometry, "MOTOR_ACCURACY", 1e-7)
    assert run(geometry.motor_accuracy, telescope)["motor_accuracy_orientation"].verdict == HOLDS


@pytest.mark.parametrize(
    ("function", "name"),
    [
        (geometry.flexure_bending, "flexure_bending"),
        (geometry.leg_tilt, "leg_tilt"),
        (geometry.constant_lambda, "constant_lambda"),
        (geometry.fixed_directions, "fixed_directions"),
        (geometry.linearisation, "linearisation"),
        (geometry.parasitic_shift, "parasitic_shift_platform"),
    ],
)
def test_claims_of_a_small_workspace_hold_in_a_smaller_one(telescope, small, function, name):
    large, little = run(function, telescope)[name], run(function, small)[name]
    assert (large.verdict, little.verdict) == (FAILS, HOLDS)
    assert large.value > 5 * little.value > 0


def test_bending_is_the_angle_between_legs_now_and_at_home(telescope):
    mechanism, poses, machine = telescope.mechanism, telescope.poses, telescope.machine("six_pus")
    home = solve_forward_kinematics(machine, machine.layout.nominal, mechanism.initial_actuator_positions)

    def directions(position, rotation, actuators):
        legs = position[..., None, :] + mechanism.platform_points @ np.swapaxes(rotation, -1, -2)
        legs = legs - mechanism.base_points - actuators[..., None] * mechanism.directions
        return legs / np.linalg.norm(legs, axis=-1, keepdims=True)

    now = directions(poses.position, poses.rotation, poses.actuators)
    start = directions(home.position, home.rotation, mechanism.initial_actuator_positions)
    base, platform = geometry.bending_angles(telescope, poses)
    np.testing.assert_allclose(np.cos(base), np.sum(now * start, axis=-1), rtol=0, atol=1e-12)
    seen = now @ poses.rotation @ home.rotation.T  # by the platform, brought back to where it stood
    np.testing.assert_allclose(np.cos(platform), np.sum(seen * start, axis=-1), rtol=0, atol=1e-12)


def test_shift_at_the_base_grows_with_the_flexure(telescope):
    name = "parasitic_shift_base"
    assert run(geometry.parasitic_shift, telescope)[name].verdict == HOLDS
    flexures = replace(machines.build_flexures(6), lengths=np.full(6, 20.0))
    longer = replace(telescope, mechanism=machines.build_telescope(flexures=flexures))
    shift = run(geometry.parasitic_shift, longer)[name]
    assert shift.verdict == FAILS
    assert shift.value == pytest.approx(2.0 * run(geometry.parasitic_shift, telescope)[name].value)


@pytest.mark.parametrize(
    ("function", "constant", "value"),
    [(geometry.circle, "CIRCLE", 0.5), (geometry.least_configurations, "PARAMETERS_PER_LEG", 9)],  # of an ideal pivot
)
def test_what_is_counted_holds_as_printed(telescope, monkeypatch, function, constant, value):
    assert verdict_of(function, telescope) == HOLDS
    monkeypatch.setattr(geometry, constant, value)
    assert verdict_of(function, telescope) == FAILS


def test_derivative_factor(telescope, monkeypatch):
    (claim,) = geometry.derivative_factor(telescope)
    assert claim.verdict == FAILS
    assert claim.value == pytest.approx(1.0, abs=1e-6)

    class Halved(SixPus):
        def linearise(self, *arguments):
            here = super().linearise(*arguments)
            return replace(here, residual=here.residual / 2)

    monkeypatch.setitem(MODELS, "six_pus", Halved)
    assert verdict_of(geometry.derivative_factor, telescope) == HOLDS


def test_jacobian_sign(telescope, monkeypatch):
    (claim,) = geometry.jacobian_sign(telescope)
    assert claim.verdict == FAILS
    travel = telescope.poses.actuators - machines.INITIAL_POSITION
    assert claim.value == pytest.approx(2.0 * np.sqrt(np.mean(travel**2)), rel=0.02)

    class Other(Jacobian):
        def linearise(self, layout, theta, position, rotation, basis):
            here = super().linearise(layout, theta, position, rotation, basis)
            return replace(here, residual=2.0 * basis.displacement - here.residual)

    monkeypatch.setitem(MODELS, "jacobian", Other)
    assert verdict_of(geometry.jacobian_sign, telescope) == HOLDS


def test_fixed_directions_are_another_model(telescope, monkeypatch):
    monkeypatch.setitem(MODELS, "stiffness", FixedStiffness)
    (claim,) = geometry.fixed_directions(telescope)
    assert claim.value == pytest.approx(0.0, abs=1e-6)


def test_deflection_direction(telescope):
    assert verdict_of(geometry.deflection_direction, telescope) == HOLDS
    soft = with_offsets(telescope, {"six_pus/linear": {"kappa": 0.1}})
    assert verdict_of(geometry.deflection_direction, soft) == FAILS


# --- what the poses can tell -----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("function", "names"),
    [
        (identifiability.one_of_lengths, ["one_of_lengths"]),
        (identifiability.null_direction, ["null_direction"]),
        (identifiability.parameters_per_leg, ["parameters_per_leg"]),
        (identifiability.one_of_directions, ["one_of_directions_six_pus"]),
        (identifiability.beam_parameters, ["beam_parameters"]),
        (identifiability.stiffness_parameters, ["stiffness_parameters"]),
        (identifiability.kappa_and_direction, ["kappa_and_direction_linear", "kappa_and_direction_matrix"]),
    ],
)
def test_what_noise_hides_is_seen_without(telescope, sharp, function, names):
    noisy, clear = run(function, telescope), run(function, sharp)
    for name in names:
        assert (noisy[name].verdict, clear[name].verdict) == (HOLDS, FAILS)


def test_jacobian_never_tells_the_second_direction(telescope, sharp):
    for evidence in (telescope, sharp):
        found = run(identifiability.one_of_directions, evidence)["one_of_directions_jacobian"]
        assert found.verdict == HOLDS
        assert found.value < 0.05  # what the tolerance of a says of u by a joint that is known


def test_initial_positions(telescope, small, monkeypatch):
    found = run(identifiability.initial_positions, telescope)
    assert (found["initial_positions_free"].verdict, found["initial_positions_held"].verdict) == (HOLDS, HOLDS)
    assert found["initial_positions_free"].value == 6
    assert run(identifiability.initial_positions, small)["initial_positions_held"].verdict == FAILS
    monkeypatch.setitem(MODELS, "jacobian", SixPus)  # to which a joint moved along its leg is not quite the same
    other = run(identifiability.initial_positions, telescope)["initial_positions_free"]
    assert (other.verdict, other.value) == (FAILS, 0)


def test_contraction_of_a_known_problem(telescope):
    """One parameter in one leg's residual: the posterior variance in closed form."""
    machine = telescope.machine("six_pus")
    slope, covariance = telescope.linearise(machine, machine.layout.nominal)
    column = slope[..., machine.layout.index["l"][2]]
    information = np.einsum("pi,pij,pj->", column, np.linalg.inv(covariance), column)
    all_legs = compute_contraction(telescope, machine, ("l",), ("l",))
    assert all_legs.shape == (6, 1)
    assert all_legs[2, 0] < 1.0 - 1.0 / np.sqrt(1.0 + 4.0 * information)  # the other legs' lengths are unknown as well
    nothing = replace(telescope, poses=replace(telescope.poses, covariance=1e16 * telescope.poses.covariance))
    np.testing.assert_allclose(compute_contraction(nothing, machine, ("l", "u_x"), ("l", "u_x")), 0.0, atol=1e-5)


@pytest.mark.parametrize(("model", "deformation"), [("six_pus", "none"), ("beam", "matrix"), ("jacobian", "linear")])
def test_information_is_that_of_the_density(telescope, model, deformation):
    """Of a study's own density at the same machine, without model error; and off where noise takes another way."""
    machine = telescope.machine(model, deformation)
    layout, theta = machine.layout, machine.layout.nominal.copy()
    theta[layout.index["l"]] += 0.5
    change = np.eye(layout.size)[:, np.concatenate([layout.index[s] for s in ("a_x", "b_y", "l", "u_x", "u_y")])]
    posterior = machines.measure(machine, telescope.hold(machine, theta), {}, noise=telescope.actuator_noise)
    expected = posterior.likelihood.inform(theta, change, NO_ERRORS, np.empty(0))
    scale = np.sqrt(np.diagonal(expected))

    def compare(carrier: np.ndarray | None) -> float:
        slope, covariance = telescope.linearise(machine, theta, carrier)
        rows = slope @ change
        found = np.einsum("pik,pij,pjm->km", rows, np.linalg.inv(covariance), rows)
        return float(np.abs((found - expected) / np.outer(scale, scale)).max())

    assert compare(theta) < 1e-8
    assert 1e-6 < compare(None) < 0.05


def test_poses_are_held_where_actuators_take_them(telescope):
    """Of the machine that they were drawn from they differ by noise alone."""
    machine = telescope.machine("six_pus", "matrix")
    held = telescope.hold(machine, machines.telescope_truth(machine))
    assert held.names == telescope.poses.names
    assert 1e-4 < np.abs(held.position - telescope.poses.position).max() < 0.02


def test_tolerances_have_the_units_of_their_parameters(telescope):
    machine = telescope.machine("stiffness", "linear")
    sd, index = tolerance_of(machine), machine.layout.index
    assert sd[index["l_b"][0]] == 2.0
    assert sd[index["kappa"][0]] == 0.01
    assert sd[index["k2_l"][0]] == pytest.approx(0.3 * machine.layout.nominal[index["k2_l"][0]])


# --- least squares ---------------------------------------------------------------------------------------------------


def test_insensitive_to_start(telescope):
    evidence = with_fits(telescope, "six_pus/linear")
    assert verdict_of(identification.insensitive_to_start, evidence) == HOLDS
    fit = evidence.fits["six_pus/linear"]
    elsewhere = replace(evidence, fits={"six_pus/linear": replace(fit, theta=fit.theta + 0.1)})
    assert verdict_of(identification.insensitive_to_start, elsewhere) == FAILS


def test_choice_of_direction(telescope):
    assert verdict_of(identification.choice_of_direction, telescope) == HOLDS
    # legs 1 and 2 need a gain above one: they lean along x, so that u_x gives it and u_y cannot
    machine = machines.build_machine("linear")
    theta = machine.layout.nominal.copy()
    theta[machine.layout.index["kappa"]] = [-0.02, -0.02, 0.0, 0.0, 0.0, 0.0]
    stretched = build_subject(deformation="linear", theta=theta)
    assert verdict_of(identification.choice_of_direction, stretched) == FAILS


def test_initial_positions_accuracy(telescope, sharp, monkeypatch):
    assert verdict_of(identification.initial_positions_accuracy, telescope) == HOLDS
    monkeypatch.setitem(MODELS, "jacobian", SixPus)  # in which ρ^0 counts once noise does not hide it
    machine = machines.build_machine("none")
    theta = machine.layout.nominal.copy()
    theta[machine.layout.index["rho0"]] += 2.0
    moved = build_subject(scale=5.0, noise=1e-4, deformation="none", theta=theta)
    assert verdict_of(identification.initial_positions_accuracy, moved) == FAILS


@pytest.mark.parametrize(
    ("function", "offsets", "verdict"),
    [
        (identification.directions_far, {"six_pus/none": {"u_x": 0.15}}, HOLDS),
        (identification.directions_far, {"six_pus/none": {"u_x": 0.02}}, FAILS),
        (identification.same_parameters, {"six_pus/none": {"b_x": 2.0}, "six_pus/linear": {"b_x": 2.05}}, HOLDS),
        (identification.same_parameters, {"six_pus/none": {"b_x": 2.0}, "six_pus/linear": {"b_x": 2.5}}, FAILS),
    ],
)
def test_claims_on_offsets(telescope, function, offsets, verdict):
    assert verdict_of(function, with_offsets(telescope, offsets)) == verdict


def test_direction_takes_kappa(telescope):
    """By least squares on the twin, and not where u_x does not answer to κ."""
    evidence = with_fits(telescope, "six_pus/none", "six_pus/linear")
    (claim,) = identification.direction_takes_kappa(evidence)
    assert (claim.verdict, claim.value < 0.06) == (HOLDS, True)
    untouched = with_offsets(telescope, {"six_pus/none": {"u_x": 0.0}, "six_pus/linear": {"kappa": 0.01}})
    assert verdict_of(identification.direction_takes_kappa, untouched) == FAILS


@pytest.mark.parametrize(("rho0", "verdict"), [(10.0, HOLDS), (0.0, FAILS), (12.0, FAILS)])
def test_home_joint(telescope, rho0, verdict):
    u_x = np.array([-0.07, 0.05, 0.10, -0.06, 0.05, -0.15])
    offsets = {"beam/none": {"u_x": u_x, "a_x": -10.0 * u_x}, "beam/linear": {}}
    published = {"beam/none": {"u_x": u_x, "a_x": -rho0 * u_x}, "beam/linear": {"a_x": np.zeros(6)}}
    found = run(identification.home_joint, replace(with_offsets(telescope, offsets), published=published))
    assert list(found) == ["home_joint_beam"]
    assert found["home_joint_beam"].verdict == verdict
    assert found["home_joint_beam"].value == pytest.approx(rho0)


@pytest.mark.parametrize(("stiff", "verdict"), [(1.0, HOLDS), (0.0, FAILS)])
def test_orientation_without_equilibrium(telescope, stiff, verdict):
    truth = dict(machines.TABLE_7A)
    del truth["kappa"]
    tilted = truth | {"l": np.array(truth["l"]) + stiff * np.array([0.1, -0.1, 0.1, -0.1, 0.1, -0.1])}
    evidence = with_offsets(telescope, {"six_pus/none": truth, "stiffness/none": tilted})
    assert verdict_of(identification.orientation_without_equilibrium, evidence) == verdict


def published_move(evidence: ClaimEvidence, share: float, model: str = "stiffness") -> dict[str, dict[str, np.ndarray]]:
    """Return tables in which a and b move from (a) to (d) by a share of what least squares finds."""
    names = ("six_pus/none", f"{model}/none")
    base, own = (evidence.offsets(name) for name in names)
    return {names[0]: base, names[1]: {s: base[s] + share * (own[s] - base[s]) for s in base}}


def test_stiffness_objective(telescope):
    evidence = with_fits(telescope, "six_pus/none", "stiffness/none")
    for share, verdict in ((1.0, HOLDS), (-1.0, FAILS), (50.0, UNTESTABLE)):
        published = published_move(evidence, share)
        (claim,) = identification.stiffness_objective(replace(evidence, published=published))
        assert claim.verdict == verdict
        assert claim.value == pytest.approx(math.copysign(1.0, share))
        assert claim.claim == "stiffness_objective_table5"


@pytest.mark.parametrize(("printed", "verdict"), [(0.1, HOLDS), (1.0, FAILS)])
def test_beam_kappa(telescope, printed, verdict):
    kappa = np.array(machines.TABLE_7A["kappa"])
    evidence = with_offsets(telescope, {f"{model}/matrix": machines.TABLE_7A for model in ("six_pus", "beam")})
    published = {"six_pus/matrix": machines.TABLE_7A, "beam/matrix": machines.TABLE_7A | {"kappa": printed * kappa}}
    arrays = {name: {s: np.array(v) for s, v in table.items()} for name, table in published.items()}
    assert verdict_of(identification.beam_kappa, replace(evidence, published=arrays)) == verdict


def test_claims_on_tables_need_the_reports_parameters(telescope):
    evidence = with_offsets(telescope, {"six_pus/none": {"u_x": 0.15}})
    more = replace(evidence, free={"six_pus/none": (*evidence.free["six_pus/none"], "u_y")})
    assert not list(identification.directions_far(more))


# --- posteriors ------------------------------------------------------------------------------------------------------


def summarise(position: float, orientation: float, evidence: float, distance: float) -> dict[str, object]:
    """Return what a summary says of a variant: mean errors in µm and deg, log-evidence, distance in mm."""
    errors = {
        "position_error_mm": {"mean": 1e-3 * position, "max": 2e-3 * position},
        "orientation_error_deg": {"mean": orientation, "max": 2.0 * orientation},
    }
    return {
        "log_evidence": evidence,
        "calibration": errors,
        "verification": None,
        "distance_from_nominal_mm": distance,
    }


def with_summary(evidence: ClaimEvidence, **changes: dict[str, object]) -> ClaimEvidence:
    """Return the evidence with all twelve variants alike but for changes by ``model_deformation``."""
    usual = {
        "none": {"position": 14.0, "orientation": 0.009, "evidence": 1200.0, "distance": 2.1},
        "linear": {"position": 14.0, "orientation": 0.009, "evidence": 1200.0, "distance": 2.0},
        "matrix": {"position": 14.0, "orientation": 0.001, "evidence": 1201.0, "distance": 1.0},
    }
    variants = {
        f"{model}/{d}": summarise(**(values | changes.get(f"{model}_{d}", {})))
        for model in ("six_pus", "jacobian", "beam", "stiffness")
        for d, values in usual.items()
    }
    alone = {name: one["log_evidence"] - 1.0 for name, one in variants.items()}
    return replace(evidence, variants=variants, weigh_alone=alone.__getitem__)


POSTERIOR_CLAIMS = [
    (accuracy.jacobian_accuracy, "jacobian_accuracy", {"jacobian_linear": {"position": 20.0}}),
    (accuracy.flexures_spherical, "flexures_beam", {"beam_matrix": {"evidence": 1195.0}}),
    (accuracy.flexures_spherical, "flexures_beam", {"beam_none": {"position": 12.0}}),
    (accuracy.flexures_spherical, "flexures_stiffness", {"stiffness_none": {"evidence": 1210.0}}),
    (accuracy.same_none_linear, "same_none_linear_six_pus", {"six_pus_none": {"position": 20.0}}),
    (accuracy.same_none_linear, "same_none_linear_jacobian", {"jacobian_linear": {"position": 20.0}}),
    (accuracy.matrix_gain, "matrix_position", {"six_pus_matrix": {"position": 4.0}}),
    (accuracy.matrix_gain, "matrix_orientation", {"six_pus_matrix": {"orientation": 0.009}}),
    (accuracy.deformation_choice, "deformation_choice", {"six_pus_matrix": {"evidence": 1500.0}}),
    (accuracy.orientation_reached, "orientation_reached", {"beam_linear": {"orientation": 0.03}}),
    (accuracy.matrix_nearest, "matrix_nearest", {"stiffness_matrix": {"distance": 2.05}}),
]


@pytest.mark.parametrize(("function", "name", "change"), POSTERIOR_CLAIMS)
def test_claims_on_posteriors(telescope, function, name, change):
    assert run(function, with_summary(telescope))[name].verdict == HOLDS
    assert run(function, with_summary(telescope, **change))[name].verdict == FAILS


def test_claims_on_posteriors_need_their_variants(telescope):
    for function in accuracy.CLAIMS:
        if function is not accuracy.hardware:
            assert not list(function(telescope))
    only = with_summary(telescope)
    only = replace(only, variants={"six_pus/none": only.variants["six_pus/none"]})
    assert not list(accuracy.same_none_linear(only))


def test_hardware_is_not_testable_on_a_twin(telescope):
    twin = run(accuracy.hardware, telescope)
    assert {c.verdict for c in twin.values()} == {UNTESTABLE}
    assert TWIN in twin["desired_accuracy"].reason
    measured = run(accuracy.hardware, replace(telescope, origin="measured in a clean room"))
    assert set(twin) - set(measured) == {"desired_accuracy", "accuracy_of_the_telescope"}


# --- all together ----------------------------------------------------------------------------------------------------


def test_every_claim_has_its_columns_and_order(telescope):
    evidence = with_summary(with_fits(telescope, "six_pus/none", "six_pus/linear", "six_pus/matrix"))
    published = {name: evidence.offsets(name) for name in evidence.fits}
    table = tabulate_claims(replace(evidence, published=published))
    assert list(table.columns) == COLUMNS
    assert table["claim"].is_unique
    assert set(table["verdict"]) == {HOLDS, FAILS, UNTESTABLE}
    texts = table[["claim", "section", "statement", "expected", "verdict", "reason"]]
    assert (texts.map(len) > 0).all().all()
    tested = table[table["verdict"] != UNTESTABLE]
    assert (tested["found"].map(len) > 0).all()
    assert np.isfinite(tested["value"]).all()
    own = (table["section"] == "own").to_numpy()
    assert own.any()
    assert not np.any(np.diff(own.astype(int)) < 0)  # own findings come last
    sections = [s.split(",")[0] for s in table["section"] if s != "own"]
    numbers = [[int(n) for n in s.split(".")] for s in sections]
    assert numbers == sorted(numbers)


def test_failed_computation_costs_its_claim_alone(telescope, monkeypatch):
    def fail(evidence):
        """Section 4: as if."""
        raise NumericalError("no pose")
        yield

    monkeypatch.setattr(claims, "CLAIMS", (fail, geometry.circle))
    first, second = sorted(judge_claims(telescope), key=lambda c: c.verdict)
    assert (first.claim, first.verdict) == ("circle", HOLDS)
    assert (second.claim, second.verdict) == ("fail", UNTESTABLE)
    assert "no pose" in second.reason


def test_machine_without_flexures_leaves_claims_out(telescope):
    rigid = replace(telescope, mechanism=machines.build_telescope(flexures=None))
    found = {c.claim for c in judge_claims(rigid)}
    assert not found & {"circle", "flexure_bending", "parasitic_shift_base", "beam_parameters", "fixed_directions"}
    assert {"leg_tilt", "one_of_lengths"} <= found


def test_machine_of_eight_legs(monkeypatch):
    monkeypatch.setattr(claims, "CLAIMS", (*geometry.CLAIMS, *identifiability.CLAIMS))
    mechanism = machines.build_random_mechanism(8, 1)
    theta = machines.build_machine("matrix", mechanism).layout.nominal
    found = {c.claim: c for c in judge_claims(build_subject(mechanism=mechanism, theta=theta))}
    assert not set(found) & {"fixed_directions", "stiffness_parameters", "least_configurations"}
    assert not [c.reason for c in found.values() if "failed" in c.reason]
    assert {"beam_parameters", "leg_tilt"} <= set(found)
    assert found["initial_positions_free"].value == 8


@pytest.fixture(scope="module")
def inputs(tmp_path_factory):
    """Return the inputs of a tiny study."""
    return studies.load_study(studies.write_tiny_study(tmp_path_factory.mktemp("tiny")))


def test_study_gives_its_evidence(inputs):
    fits = identify_variants(inputs)
    evidence = ClaimEvidence.from_study(inputs, {"variants": {}}, fits)
    assert evidence.simulated
    assert evidence.poses.n_poses == studies.N_CALIBRATION
    assert evidence.all_poses.n_poses == studies.N_CALIBRATION + studies.N_VERIFICATION
    assert evidence.target_noise == 3e-3
    assert evidence.actuator_noise == 1e-3
    assert evidence.free == {"six_pus/none": ("l",), "six_pus/matrix": ("l", "kappa")}
    np.testing.assert_array_equal(evidence.published["six_pus/matrix"]["l"], [0.37, -0.45, 1.02, 0.25, 0.43, 0.58])
    np.testing.assert_allclose(
        evidence.offsets("six_pus/matrix")["l"], evidence.published["six_pus/matrix"]["l"], atol=0.1
    )
    assert not evidence.repeats("six_pus/matrix")
    assert evidence.best_machine().deformation.name == "matrix"
    table = tabulate_claims(evidence)
    assert table["claim"].is_unique
    named = find_class("CLAIMS", studies.CLAIMS, Claims, "claims", inputs.folder, studies.TELESCOPE)
    tables = named().tabulate(inputs, {"variants": {}})
    assert list(tables) == ["claims", "least_squares"]
    pd.testing.assert_frame_equal(tables["claims"], table)
    pd.testing.assert_frame_equal(tables["least_squares"], tabulate_least_squares(inputs, fits))


def test_evidence_without_model_error_is_that_of_draws(inputs):
    """By importance sampling about the mode, where few parameters leave the density nearly normal."""
    posterior = drop_model_error(inputs.variants["six_pus/matrix"].posterior()).with_pose_guesses()
    assert posterior.n_parameters == 12
    mode = find_modes(posterior)[0]
    about = stats.multivariate_normal(mode.y, 1.2 * mode.covariance)
    draws = about.rvs(2000, random_state=1)
    weights = posterior.log_density(draws) - about.logpdf(draws)
    expected = logsumexp(weights) - np.log(len(draws))
    weigh = ClaimEvidence.from_study(inputs, {"variants": {}}, {}).weigh_alone
    assert weigh("six_pus/matrix") == pytest.approx(expected, abs=0.05)


def test_claims_are_put_to_targets_alone(inputs):
    with pytest.raises(InputError, match="without targets"):
        claims.Rr8096().check(replace(inputs, pads=None))
    claims.Rr8096().check(inputs)
