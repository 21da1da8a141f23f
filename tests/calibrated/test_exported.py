"""A calibrated machine as drawings of its own: the same poses before, as exported, and as read again."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import calibrated_machines as calibrated
import guided_machines
import hexapods
import numpy as np
import pytest
import studies
import telescope_machines as machines

from bayescal.calibrated.exported import check_covariance, format_mechanism, read_exported
from bayescal.calibrated.formats import export_machine
from bayescal.calibrated.machine import LegErrors, build_calibrated, express_parameters, settle_legs
from bayescal.calibrated.predict import compensate_poses, predict_poses
from bayescal.errors import InputError
from bayescal.machines.deformations import NoDeformation
from bayescal.machines.kinematics import Machine, build_machine
from bayescal.machines.mechanism import ExternalLoad
from bayescal.machines.models.six_pus import SixPus
from bayescal.machines.read import load_mechanism
from bayescal.machines.readings import Legs

SAME = {"rtol": 0, "atol": 1e-9}  # mm
SAME_TURN = {"rtol": 0, "atol": 1e-12}
CASES = [
    *((model, 6, "matrix") for model in machines.model_names()),
    *((model, 6, deformation) for model in machines.PERFECT_JOINTS for deformation in ("none", "linear")),
    *((model, 8, "matrix") for model in machines.PERFECT_JOINTS),
]


def build(model: str, n_legs: int, deformation: str) -> Machine:
    return machines.build_machine(deformation, machines.build_random_mechanism(n_legs, seed=n_legs), model)


def assert_same_poses(found, expected) -> None:
    assert found.converged.all()
    assert expected.converged.all()
    np.testing.assert_allclose(found.position, expected.position, **SAME)
    np.testing.assert_allclose(found.rotation, expected.rotation, **SAME_TURN)


@pytest.mark.parametrize("has_gains", [False, True])
@pytest.mark.parametrize(("model", "n_legs", "deformation"), CASES)
def test_settled_machine_has_the_same_poses(model, n_legs, deformation, has_gains, rng):
    legs = Legs(build(model, n_legs, deformation), has_gains=has_gains)
    theta = calibrated.draw_machines(legs, 3, rng, scale=0.1)
    settled = settle_legs(legs, theta[0])
    actuators = calibrated.measurable_actuators(legs.machine, 4, rng)
    expected = legs.solve(theta[:, None], actuators)
    assert_same_poses(settled.solve(express_parameters(legs, settled, theta)[:, None], actuators), expected)
    nominal = settled.solve(settled.layout.nominal, actuators)
    np.testing.assert_allclose(nominal.position, expected.position[0], **SAME)
    before = legs.solve(legs.layout.nominal, actuators)
    assert np.abs(before.position - expected.position[0]).max() > 1e-2  # the calibration matters


@pytest.mark.parametrize("model", machines.model_names())
def test_gains_are_exported(model, rng, tmp_path):
    """Exported and read again the machine predicts the same, with the same uncertainty, and answers commands."""
    legs = Legs(machines.build_machine("matrix", model=model), has_gains=True)
    made_up = calibrated.build_made_up(legs, rng, n_draws=50)
    gains = made_up.model.machine.mechanism.actuator_gains
    assert np.abs(gains - 1.0).max() > 1e-4
    export_machine(made_up, tmp_path)
    again = read_exported(tmp_path)
    np.testing.assert_allclose(again.model.machine.mechanism.actuator_gains, gains, rtol=1e-15)
    assert {f"gain[{leg}]" for leg in range(1, 7)} <= set(again.names)
    actuators = calibrated.measurable_actuators(legs.machine, 5, rng)
    one, other = (predict_poses(m, actuators) for m in (made_up, again))
    np.testing.assert_allclose(other.tool, one.tool, rtol=0, atol=1e-9)
    np.testing.assert_allclose(other.covariance, one.covariance, rtol=1e-6, atol=1e-18)
    np.testing.assert_allclose(compensate_poses(again, one.tool).commands, actuators, rtol=0, atol=1e-7)
    bare = replace(made_up.model.machine.mechanism, actuator_gains=None)
    off = Legs(replace(made_up.model.machine, mechanism=bare)).solve(made_up.theta[:-6], actuators)
    assert np.abs(off.position - one.position).max() > 1e-4  # they count


@pytest.mark.parametrize("model", machines.model_names())
def test_errors_of_travel_show_in_what_is_read(model, rng):
    """The covariance of the actuators' errors is that of a machine without gains, in units of what each reads."""
    machine = machines.build_machine("matrix", model=model)
    gains = 1.0 + 0.1 * rng.uniform(-1.0, 1.0, 6)
    geared, own = Legs(machine, has_gains=True), machine.layout.nominal
    rest = np.tile(np.diag(rng.uniform(0.5, 1.0, 6) * 1e-6), (6, 1, 1))
    tau = np.full(6, 1e-6)
    theta, start = np.append(own, gains), machine.mechanism.initial_actuator_positions
    actuators = calibrated.measurable_actuators(machine, 5, rng)
    pose, found = geared.locate(theta, actuators)
    assert found.all()
    here = LegErrors(1e-6 * np.eye(6), tau, geared, theta, rest).covariance(pose, actuators)
    there = LegErrors(np.zeros((6, 6)), tau * gains**2, Legs(machine), own, rest)
    travel = there.covariance(pose, start + gains * (actuators - start))
    np.testing.assert_allclose(here, 1e-6 * np.eye(6) + travel / np.outer(gains, gains), rtol=1e-9, atol=1e-18)


def test_measured_matrix_keeps_its_uncertainty(rng, tmp_path):
    machine = machines.build_machine("matrix")
    covariance = np.tile(np.diag(rng.uniform(0.5, 1.0, 6) * 1e-6), (6, 1, 1))
    errors = calibrated.build_leg_errors(machine, machine.layout.nominal, 1e-3, np.full(6, 1e-6), covariance)
    made_up = calibrated.build_made_up(machine, rng, errors=errors)
    export_machine(made_up, tmp_path)
    actuators = calibrated.measurable_actuators(machine, 5, rng)
    known = replace(made_up, errors=replace(made_up.errors, matrix_covariance=None))
    one, other, less = (predict_poses(m, actuators).covariance for m in (made_up, read_exported(tmp_path), known))
    np.testing.assert_allclose(other, one, rtol=1e-9, atol=1e-20)
    assert (np.linalg.eigvalsh(one - less).min(axis=1) > -1e-18).all()
    assert np.trace(one[0]) > 1.02 * np.trace(less[0])


SHIPPED = [
    studies.TELESCOPE / "mechanism.toml",
    hexapods.AUDIT / "m2_hexapod_mechanism.toml",
    hexapods.AUDIT / "camera_hexapod_mechanism.toml",
    studies.EXPERIMENTS / "hexaglide" / "mechanism.toml",
]


@pytest.mark.parametrize("path", SHIPPED, ids=lambda path: path.parent.name + "/" + path.stem)
def test_mechanism_is_written_to_the_last_digit(path, tmp_path):
    mechanism = load_mechanism(path)
    mechanism = replace(mechanism, actuator_gains=np.linspace(0.99, 1.01, mechanism.n_legs))
    mechanism = replace(
        mechanism, load=ExternalLoad((1.0, 2.0, 3.0), (0.1, 0.0, 0.2), (0.0, 3.0, -40.0), (1.0, 2.0, 3.0))
    )
    (tmp_path / "m.toml").write_text(format_mechanism(mechanism, ["a comment"]))
    again = load_mechanism(tmp_path / "m.toml")
    arrays = ("base_points", "platform_points", "leg_lengths", "initial_actuator_positions", "actuator_gains")
    for name in arrays:
        np.testing.assert_array_equal(getattr(again, name), getattr(mechanism, name))
    np.testing.assert_allclose(again.directions, mechanism.directions, rtol=0, atol=1e-16)
    np.testing.assert_allclose(again.load.weight, mechanism.load.weight, rtol=1e-15, atol=1e-15)
    plain = {"name", "actuator_range", "drive", "home_position", "platform_below"}
    assert {n: getattr(again, n) for n in plain} == {n: getattr(mechanism, n) for n in plain}
    assert (again.load.force, again.load.moment, again.load.centre_of_mass) == (
        (1.0, 2.0, 3.0),
        (0.1, 0.0, 0.2),
        (1.0, 2.0, 3.0),
    )
    assert (again.flexures is None) == (mechanism.flexures is None)
    if mechanism.flexures is not None:
        assert again.flexures.section == mechanism.flexures.section
        assert again.flexures.leg_section == mechanism.flexures.leg_section


def test_near_leads_the_search_for_home(tmp_path):
    """The same lengths from below: without [home] the platform would stand above."""
    mechanism = replace(guided_machines.build_hanging(), home_position=None, platform_below=True)
    machine = build_machine(SixPus, mechanism, NoDeformation())
    home = machine.nominal_home
    text = format_mechanism(mechanism).replace(
        'platform = "below"', f"initial_guess_mm = {home.position.round().tolist()}"
    )
    (tmp_path / "m.toml").write_text(text)
    again = build_machine(SixPus, load_mechanism(tmp_path / "m.toml"), NoDeformation())
    np.testing.assert_allclose(again.nominal_home.position, home.position, **SAME)
    (tmp_path / "m.toml").write_text(text.replace("initial_guess_mm", 'platform = "above"\ninitial_guess_mm'))
    with pytest.raises(InputError, match=r"home: expected position_mm,.*initial_guess_mm"):
        load_mechanism(tmp_path / "m.toml")


def test_without_draws_there_is_a_machine_but_no_covariance(rng, tmp_path):
    machine = machines.build_machine("none")
    theta = calibrated.draw_machines(machine, 1, rng)[0]
    errors = calibrated.build_leg_errors(machine, theta, 1e-3, np.zeros(6))
    found = build_calibrated(Legs(machine), theta, None, errors, calibrated.SOURCE)
    written = {path.name for path in export_machine(found, tmp_path)}
    assert written == {"calibrated.toml", "mechanism.toml", "parameters.csv"}
    again = read_exported(tmp_path)
    prediction = predict_poses(again, calibrated.measurable_actuators(machine, 4, rng))
    assert prediction.covariance is None
    assert prediction.found.all()


class Own(SixPus):
    """Somebody else's model, with the closure of a built-in one."""

    name = "own"


def test_a_model_of_ones_own_predicts_but_has_no_drawings(rng, tmp_path):
    built_in = machines.build_machine("none")
    own = Machine(built_in.mechanism, Own(), built_in.deformation)
    draws = calibrated.draw_machines(built_in, 50, rng)
    rest = (
        draws.mean(axis=0),
        draws,
        calibrated.build_leg_errors(built_in, draws[0], 1e-3, np.full(6, 1e-6)),
        calibrated.SOURCE,
    )
    one, other = build_calibrated(Legs(built_in), *rest), build_calibrated(Legs(own), *rest)
    assert [np.array_equal(m.theta, m.model.layout.nominal) for m in (one, other)] == [True, False]
    actuators = calibrated.measurable_actuators(built_in, 4, rng)
    first, second = predict_poses(one, actuators), predict_poses(other, actuators)
    np.testing.assert_allclose(second.position, first.position, **SAME)
    np.testing.assert_allclose(second.covariance, first.covariance, rtol=1e-5, atol=1e-11)
    with pytest.raises(InputError, match="user-defined model"):
        export_machine(other, tmp_path / "out", "mechanism")
    assert studies.snapshot(tmp_path) == {}


NAMES, PATH = ["l[1]", "l[2]", "k"], Path("covariance.csv")
SD = np.array([1e-3, 2e-3, 1e5])
CORRELATION = np.array([[1.0, 0.5, -0.3], [0.5, 1.0, 0.1], [-0.3, 0.1, 1.0]])
FAULTS = {
    "not a number": ((0, 1), np.nan, r"l\[1\], l\[2\]: found nan, expected a finite number"),
    "negative": ((2, 2), -1.0, "k, k: found -1, expected a variance"),
    "one side": ((1, 2), 1e6, r"l\[2\], k: found 1e\+06 and 20"),
    "no variance": ((0, 0), 0.0, r"l\[1\], l\[2\]: found 1e-06, expected at most 0"),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_damaged_entries_are_named(fault):
    place, value, said = FAULTS[fault]
    covariance = CORRELATION * np.outer(SD, SD)
    covariance[place] = value
    with pytest.raises(InputError, match=f"^covariance.csv: {said}"):
        check_covariance(PATH, NAMES, covariance)


def test_correlations_that_cannot_be_together_are_refused():
    correlation = np.array([[1.0, 0.9, 0.9], [0.9, 1.0, -0.9], [0.9, -0.9, 1.0]])
    with pytest.raises(InputError, match="indefinite"):
        check_covariance(PATH, NAMES, correlation * np.outer(SD, SD))


def test_covariances_of_few_draws_and_of_constants_are_taken(rng):
    draws = rng.standard_normal((5, 20)) * np.geomspace(1e-6, 1e8, 20)
    covariance = np.cov(draws, rowvar=False)
    covariance[3] = covariance[:, 3] = 0.0
    check_covariance(PATH, [str(k) for k in range(20)], covariance)
