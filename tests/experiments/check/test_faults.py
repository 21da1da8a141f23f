"""Every planted fault is named, and clean studies pass: each check by itself, and all of them together."""

from __future__ import annotations

import re
from dataclasses import replace

import checked
import numpy as np
import pytest
import telescope_machines as machines

from bayescal.density.errors import ModelError
from bayescal.density.pose_likelihood import PoseLikelihood
from bayescal.density.posterior import Posterior
from bayescal.experiments.check import faults
from bayescal.experiments.check.faults import (
    check_derivatives,
    check_modes,
    check_noise,
    check_priors,
    list_starts,
    look_at_data,
    state_slips,
)
from bayescal.experiments.check.inputs import draw_posterior
from bayescal.experiments.shared.reading_slips import audit_slips
from bayescal.experiments.shared.soundness import find_misfit
from bayescal.inference.mode import find_modes
from bayescal.machines.readings import Legs
from bayescal.numerics.geometry import matrix_from_rotation_vector, rotation_vector_from_matrix


def look(subject, seed=1):
    """Return the faults that are named, the gravest first."""
    findings, _, _ = look_at_data((subject, 1000, seed))
    return [one.fault for one in findings if one.fault], {one.check: one for one in findings}


def judge_noise(subject):
    return check_noise(subject.measured)


@pytest.mark.parametrize("seed", range(2))
def test_clean_studies_pass(seed):
    faults, said = look(checked.make_clean(seed))
    assert faults == [], said
    assert list(said) == ["Derivatives", "Units and order", "Modes", "Noise", "Tolerances"]


def test_the_tiny_study_passes_with_the_noise_of_its_targets():
    faults, _ = look(checked.tiny_subject())
    assert faults == []


@pytest.mark.parametrize("seed", [3, 4, 5])
def test_noise_stated_at_half_is_named(seed):
    found = judge_noise(checked.halve_noise(checked.make_clean(seed)))
    assert found.fault == "noise"
    assert found.level in ("warning", "bad")


@pytest.mark.parametrize(("per_dof", "dof", "fault"), [(0.7, 40, ""), (0.7, 400, "noise"), (1.4, 40, "")])
def test_how_far_targets_may_scatter_hangs_on_how_many_they_are(per_dof, dof, fault):
    described = {"pose_extraction": {"chi2_per_dof": per_dof, "dof": dof}}
    subject = checked.make_clean(3)
    legs = replace(subject.measured.legs, described=described)
    assert judge_noise(checked.with_poses(legs, legs.poses)).fault == fault


@pytest.mark.parametrize(
    ("seed", "factor", "fault", "said"),
    [
        (6, 1.3, "", "less than noise of the stated size mostly gives, but not beyond chance"),
        (3, 1.5, "noise", "Perhaps the rows are averages of several measurements."),
        (
            6,
            2.0,
            "noise",
            "about 0.5 times the stated noise, most of it in",
        ),
    ],
)
def test_noise_stated_too_large_is_said_by_chance(seed, factor, fault, said):
    """Of clean data with 66 degrees of freedom."""
    subject = checked.make_clean(seed)
    legs = subject.measured.legs
    poses = replace(legs.poses, covariance=factor**2 * legs.poses.covariance)
    found = judge_noise(checked.with_poses(replace(legs, actuator_noise=factor * legs.actuator_noise), poses))
    assert found.fault == fault
    assert said in found.text


def test_the_error_of_a_measured_matrix_is_no_noise_of_single_poses():
    """It moves all poses alike, so that most of it is fitted away; counted pose by pose, little noise seems left."""
    subject = checked.tiny_subject()
    alone = checked.without_model_error(subject.measured.legs)
    posterior = replace(alone.posterior, likelihood=alone.posterior.likelihood)
    mode = find_modes(posterior)[0]
    by_pose = find_misfit(posterior, mode.y, posterior.likelihood)
    likelihood = PoseLikelihood(alone.machine, alone.poses, alone.actuator_noise)
    shared = find_misfit(posterior, mode.y, likelihood, alone.shared_errors)
    assert by_pose.chi_square.value / by_pose.dof < shared.chi_square.value / shared.dof
    said = judge_noise(subject).text
    value, dof = re.match(r"χ² of the readings is (\S+) per degree of freedom \((\d+),", said).groups()
    assert float(value) == pytest.approx(shared.chi_square.value / shared.dof, abs=0.03)
    assert float(dof) == pytest.approx(shared.dof, abs=1.0)


def test_model_errors_are_no_fault_but_are_said():
    found = judge_noise(checked.make_clean(4, with_model_error=True))
    assert (found.fault, found.level) == ("model error", "warning")


def test_noise_of_targets_stated_at_half_is_named():
    subject = checked.make_clean(3)
    described = {"pose_extraction": {"chi2_per_dof": 4.0, "dof": 30}}
    legs = replace(subject.measured.legs, described=described)
    found = judge_noise(checked.with_poses(legs, legs.poses))
    assert (found.fault, found.level) == ("noise", "bad")
    assert "State target_noise_um 2 times as large" in found.text


@pytest.mark.parametrize("factor", [1 / 25.4, 10.0, -1.0])
def test_a_unit_slip_of_the_actuators_is_named(factor):
    start = checked.tiny_subject().measured.legs.machine.mechanism.initial_actuator_positions
    slipped = checked.change_actuators(checked.make_clean(4), lambda rho: start + factor * (rho - start))
    faults, said = look(slipped)
    assert faults == ["unit"]
    assert "actuator displacements seem to be" in said["Units and order"].text


def test_shifted_rows_are_named():
    found = checked.change_actuators(checked.make_clean(4), lambda rho: np.roll(rho, 1, axis=0))
    found = state_slips(*audit_slips(found.measured))
    assert (found.fault, found.level) == ("rows", "bad")
    assert "rows seem to be shifted by one" in found.text


def test_rotations_in_degrees_are_named():
    subject = checked.make_clean(4)
    poses = subject.measured.legs.poses
    turned = matrix_from_rotation_vector(np.degrees(rotation_vector_from_matrix(poses.rotation)))
    turned = checked.with_poses(subject.measured.legs, replace(poses, rotation=turned))
    found = state_slips(*audit_slips(turned.measured))
    assert (found.fault, "in degrees" in found.text) == ("unit", True)


@pytest.mark.parametrize("legs", [(0, 1), (2, 5)])
def test_two_exchanged_legs_are_named(legs):
    def exchange(rho):
        rho = rho.copy()
        rho[:, list(legs)] = rho[:, list(legs)[::-1]]
        return rho

    faults, said = look(checked.change_actuators(checked.make_clean(5), exchange))
    assert faults == ["legs"]
    assert f"legs {legs[0] + 1} and {legs[1] + 1} seem to be exchanged" in said["Units and order"].text


def test_a_wrong_derivative_is_named(monkeypatch):
    right = Legs.linearise

    def wrong(self, theta, pose, with_parameters=True, given=None):
        found = right(self, theta, pose, with_parameters)
        if with_parameters:
            found.by_parameters[..., self.layout.index["kappa"]] *= 1.01
        return found

    monkeypatch.setattr(Legs, "linearise", wrong)
    found = check_derivatives(checked.make_clean(6), np.random.default_rng(0))
    assert found.fault == "derivative"
    assert "by kappa are wrong" in found.text


@pytest.mark.parametrize("seed", [7, 8])
def test_a_tolerance_three_times_too_tight_is_named(seed):
    subject = checked.make_clean(seed)
    for factor, fault in ((1.0, ""), (3.0, "prior")):
        tight = checked.tighten(subject, "l", factor)
        draws, _, _, _ = draw_posterior(tight.posterior, 1000, np.random.SeedSequence(seed))
        found = check_priors(tight.posterior, draws)
        assert found.fault == fault
    assert " l " in found.text
    assert "kappa" not in found.text


@pytest.fixture(scope="module")
def folded():
    """Return a posterior with one component of u free and κ fixed: every leg's direction has a mirror image."""
    machine, symbols = machines.build_machine("none"), ("a_x", "a_y", "b_x", "b_y", "l", "u_x")
    layout, actuators = machine.layout, machines.table_3_actuators()[:10]
    exact = machines.place_poses(machine, layout.nominal, actuators, np.zeros((10, 6)))
    slope = machines.build_posterior("none", exact, ModelError(None), symbols).sampling.coordinates.legs[:, 0]
    theta = layout.nominal.copy()
    theta[layout.index["u_x"]] = np.sin(np.arctan(slope)) + 0.03 * np.array([1, -1, 1, -1, 1, -1])
    poses = machines.simulate_poses(machine, theta, actuators, np.zeros(6), np.random.default_rng(5))
    return machines.build_posterior("none", poses, ModelError(None), symbols)


def test_a_missed_mode_is_named(folded, monkeypatch):
    """A search that tries no mirror images finds but one of them."""
    monkeypatch.setattr(faults, "PAIRS", 2)
    monkeypatch.setattr(faults, "DRAWN_STARTS", 1)
    every = find_modes(folded)
    starts = list_starts(folded, every[0].y, np.random.default_rng(0))
    assert check_modes(folded, every, starts).fault == ""
    with monkeypatch.context() as patched:
        patched.setattr(Posterior, "jumps", lambda self, y: [])
        alone = find_modes(folded)
    assert len(alone) < len(every)
    starts = list_starts(folded, alone[0].y, np.random.default_rng(0))
    assert check_modes(folded, alone, starts).fault == "mode"


def test_mirrored_starts_are_tried_alone_and_in_pairs(folded):
    starts = list_starts(folded, folded.approach(), np.random.default_rng(0))
    assert len(starts) > 10
    assert np.isfinite(folded.log_density(np.stack(starts))).mean() > 0.5


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(100, 120))
def test_twenty_clean_studies_pass(seed):
    faults, said = look(checked.make_clean(seed))
    assert faults == [], said
