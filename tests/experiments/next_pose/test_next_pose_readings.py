"""The next pose of machines of readings: against posteriors with the pose added, against poses solved for, refusals."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path

import calibration_problems as problems
import calibrations
import numpy as np
import pandas as pd
import pytest
from scipy.optimize import least_squares

from bayescal.density.calibration.measurements import Measurements
from bayescal.experiments.next_pose.compute import State, find_state
from bayescal.experiments.next_pose.inputs import MeasuredVariant, Poses, read_next_pose
from bayescal.experiments.runner.load import load
from bayescal.experiments.shared.measured import MeasuredReadings
from bayescal.identifiability.requirements import Requirement
from bayescal.pose_selection.next_pose import look_ahead

SEED = 3
REQUIRED = [Requirement("x", 0.1, ("x", "y")), Requirement("position", 0.2, ("x", "y"))]


def build_state(aligned=False, **settings) -> State:
    """Return what is known of a point on four lines after six poses, with 25 candidates."""
    rng = np.random.default_rng(1)
    posterior, _, _ = problems.lines_posterior(rng, n_poses=6, **settings)
    half = np.full(2, 150.0)
    measured = MeasuredReadings("lines", "Simulated", posterior, -half, half, np.ones(4, dtype=bool), aligned=aligned)
    poses = rng.uniform(-150.0, 150.0, (65, 2))
    subject = MeasuredVariant(measured, REQUIRED, Poses(poses[:40], {}), Poses(poses[40:], {}))
    return find_state(subject, None, 400, SEED)


@pytest.fixture(scope="module")
def state() -> State:
    return build_state()


def test_correlated_noise_counts_in_what_a_pose_says():
    """Rows' information against the readings' own precision with the pose projected out."""
    found = build_state(correlation=problems.correlation_of(np.random.default_rng(4), 4))
    likelihood, model = found.subject.posterior.likelihood, found.subject.model
    sd = likelihood.data.sd[0]
    precision = np.linalg.inv(likelihood.correlation.mean(axis=0) * np.outer(sd, sd))
    here = model.linearise(found.calibrated, found.subject.candidates.values)
    moved = here.by_parameters @ found.subject.posterior.around(found._y)[1]
    for rows, slope, seen in zip(found.rows, here.by_pose, moved, strict=True):
        weighed = precision @ slope
        left = precision - weighed @ np.linalg.solve(slope.T @ weighed, weighed.T)
        np.testing.assert_allclose(rows.T @ rows, seen.T @ left @ seen, rtol=1e-6, atol=1e-6)


def test_a_step_is_the_posterior_with_the_pose_added(state):
    """The information of all poses, one candidate among them, taken again by the posterior itself."""
    posterior, y = state.subject.posterior, state._y
    likelihood = posterior.likelihood
    now = -posterior.gradient(y)[1]
    steps = look_ahead(state.weight, np.linalg.inv(now), state.rows, np.ones(25, dtype=bool))
    best = next(steps)
    costs = []
    for k, pose in enumerate(state.subject.candidates.values):
        read = likelihood.model.read(state.calibrated, pose[None])
        data = Measurements(
            (*likelihood.data.poses, "N"),
            np.concatenate([likelihood.data.values, read]),
            np.concatenate([likelihood.data.sd, likelihood.data.sd[:1]]),
        )
        start = np.concatenate([likelihood.start, pose[None]])
        more = replace(likelihood, data=data, start=start, expansion=None)
        after = np.linalg.inv(-replace(posterior, likelihood=more).gradient(y)[1])
        costs.append(np.trace(state.weight @ after))
        if k == best.candidate:
            scale = np.sqrt(np.diag(after))
            np.testing.assert_allclose((best.covariance - after) / np.outer(scale, scale), 0.0, atol=1e-5)
    assert best.candidate == int(np.argmin(costs))
    assert best.mean_square == pytest.approx(min(costs), rel=1e-5)


def test_errors_over_the_workspace_are_those_of_solved_poses(state):
    """The true machine reads at a pose; the calibrated one is where its own readings are the same in least squares."""
    model, subject = state.subject.posterior.likelihood.model, state.subject
    theta = state.theta[:5]
    followed = state.remaining.follow(theta)
    for k, pose in enumerate(subject.workspace.values[:6]):
        for s, true in enumerate(theta):
            read = model.read(true, pose[None])[0]
            found = least_squares(lambda v, r=read: model.read(state.calibrated, v[None])[0] - r, pose, xtol=1e-14)
            np.testing.assert_allclose(followed[k, :, s], found.x - pose, atol=2e-3)
    assert np.abs(followed).max() > 0.05


def test_aligned_errors_are_the_residuals_of_a_fitted_frame(state):
    """Against least squares of two translations and a rotation about the origin over the workspace's poses."""
    aligned = build_state(aligned=True)
    x, y = aligned._workspace.T
    motion = np.stack([np.stack([x**0, 0 * x, -y], axis=-1), np.stack([0 * x, x**0, x], axis=-1)], axis=1)
    motion, slope = motion.reshape(-1, 3), state.slope.reshape(-1, state.slope.shape[-1])
    expected = slope - motion @ np.linalg.lstsq(motion, slope)[0]
    np.testing.assert_allclose(aligned.slope.reshape(slope.shape), expected, atol=1e-6 * np.abs(slope).max())
    assert (aligned.standing.bound(0.9) < 0.8 * state.standing.bound(0.9)).all()


def test_requirements_hold_as_often_as_draws_keep_them(state):
    """Against errors drawn here: tangent, the noise of four lines and nothing else."""
    rng = np.random.default_rng(8)
    slope, sd = state.remaining.slope, problems.LINE_SD
    located = state.remaining._located
    error = np.einsum("wcd,sd->swc", slope, state.theta - state.calibrated)
    error += np.einsum("wck,swk->swc", located, sd * rng.standard_normal((len(error), len(located), 4)))
    shares = np.stack([(one.take(error) / one.limit).max(axis=1) for one in REQUIRED], axis=1)
    expected = np.quantile(shares, 0.9, axis=0)
    np.testing.assert_allclose(state.standing.bound(0.9), expected, rtol=0.1)
    exact = np.quantile(state.at_best.largest, 0.9, axis=0)
    assert (exact < 0.8 * state.standing.bound(0.9)).all()


def test_more_known_is_less_error_left(state):
    steps = look_ahead(state.weight, state.covariance, state.rows, state.subject.allowed)
    one = next(steps)
    bounds = [one.bound(0.9) for one in (state.standing, state.after(one.covariance), state.at_best)]
    assert (bounds[0] > bounds[1]).all()
    assert (bounds[1] > bounds[2]).all()
    np.testing.assert_allclose(state.after(state.covariance).largest, state.standing.largest, rtol=1e-6)


def test_variants_predict_apart_where_their_machines_differ(state):
    """Two variants whose machines are alike predict alike; one with a line zeroed elsewhere does not."""
    apart, covariance = state.predict(state)
    np.testing.assert_allclose(apart, 0.0, atol=1e-12)
    assert covariance.shape == (25, 2, 2)
    values = np.linalg.eigvalsh(covariance)
    assert (values > 1.0 - 1e-6).all()  # noise is one, and what is not known of the machine comes to it
    belief = replace(state.belief, draws=state.belief.draws + np.eye(state.belief.draws.shape[1])[0])
    other = replace(state, belief=belief)
    moved, _ = other.predict(state)
    expected = state.rows @ np.eye(state.rows.shape[-1])[0]  # to first order, and of the same length
    np.testing.assert_allclose(np.linalg.norm(moved, axis=1), np.linalg.norm(expected, axis=1), atol=0.05)


# --- the command -------------------------------------------------------------------------------------------------


@pytest.fixture
def question(tmp_path) -> Path:
    path = calibrations.copy_delta(tmp_path) / "next_pose.toml"
    calibrations.change(path, 'variants = ["all"]', 'variants = ["all"]\ndraws = 300\nhorizon = 6')
    return calibrations.change(path, "count = 300", "count = 60")


@pytest.mark.runs
def test_it_says_where_to_go_and_what_to_expect(question, call, no_pictures):
    question.write_text('accuracy_frame = "base"\n' + question.read_text())
    out = question.parent / "out"
    code, said, complaint = call("next-pose", question, "--out", out)
    assert (code, complaint) == (0, "")
    summary = json.loads((out / "summary.json").read_text())
    assert (summary["decision"], summary["n_poses"]) == ("measure", 25)
    first = pd.read_csv(out / "next_poses.csv").iloc[0]
    assert f"Go to x = {first['x_mm']:.3f} mm".replace("-", "−") in said
    assert list(first.index[-3:]) == ["s_1_mm", "s_2_mm", "s_3_mm"]
    requirements = pd.read_csv(out / "requirements.csv")
    assert (requirements["error_after_next"] < requirements["error"]).any()
    assert (requirements["error_parameters_known"] < requirements["error_after_next"]).all()
    page = (out / "report.html").read_text()
    assert f"{first['s_1_mm']:.3f}" in page  # what its own sensors will read there


@pytest.mark.runs
def test_it_stops_or_says_that_nothing_helps(question, call, no_pictures):
    calibrations.change(question, "x = 0.08\ny = 0.08\nz = 0.05", "z = 5.0")
    assert call("next-pose", question, "--out", question.parent / "a")[0] == 0
    assert json.loads((question.parent / "a" / "summary.json").read_text())["decision"] == "stop"
    calibrations.change(question, "z = 5.0", "z = 0.001")
    call("next-pose", question, "--out", question.parent / "b")
    assert json.loads((question.parent / "b" / "summary.json").read_text())["decision"] == "infeasible"
    findings = pd.read_csv(question.parent / "b" / "findings.csv").set_index("subject")
    assert findings.loc["Reachable", "status"] == "bad"


@pytest.mark.runs
def test_candidates_come_from_a_table_and_variants_are_told_apart(question, call, no_pictures):
    poses = ["pose,x_mm,y_mm,z_mm", "A,10,0,20", "B,60,-60,30", "C,0,70,10"]
    (question.parent / "poses.csv").write_text("\n".join(poses) + "\n")
    calibrations.change(question, "count = 60", 'configurations = "poses.csv"')
    text = question.read_text().replace('variants = ["all"]', 'goal = "variants"')
    question.write_text(text.partition("[requirements]")[0] + "[candidates]" + text.partition("[candidates]")[2])
    out = question.parent / "out"
    code, said, complaint = call("next-pose", question, "--out", out)
    assert (code, complaint) == (0, "")
    assert "one_rod" in said
    chosen = pd.read_csv(out / "next_poses.csv")
    assert next(zip(chosen["x_mm"], chosen["y_mm"], strict=True)) in [(10, 0), (60, -60), (0, 70)]


FAULTS = {
    "x = 0.08": ("w = 0.08", "requirements: found 'w', expected one of x, y, z, position"),
    'variants = ["all"]': ('variants = ["any"]', "variant 'any': expected one of all, one_rod"),
    "draws = 300": ("draws = 300\nn_first_poses = 99", "n_first_poses: found 99, expected at most 25"),
    "count = 60": ("range_mm = 3.0", "candidates.range_mm:"),
    "[requirements]": (
        "[workspace]\nposition_mm = [1, 1, 1]\nrotation_deg = [1, 1, 1]\n[requirements]",
        "workspace: found position_mm",
    ),
    "[candidates]": ("[workspace]\nu = [0.0, 1.0]\n\n[candidates]", "workspace: found 'u', expected one of x, y, z"),
}


@pytest.mark.parametrize("old", FAULTS)
def test_faults_are_one_line_and_nothing_is_written(question, refuse, old):
    new, fault = FAULTS[old]
    calibrations.change(question, old, new)
    refuse(re.escape(fault), question.parent / "out", "next-pose", question)


def test_what_no_pose_can_say_is_refused(question):
    """Three readings and three coordinates; sensors beside the machine alone; variants of other readings."""
    study = question.parent / "study.toml"
    own = 'title = "Everything free"\nsensors = [{}]'

    def complain(sensors: str, said: str, old: str = "") -> None:
        text = study.read_text()
        calibrations.change(study, 'title = "Everything free"', own.format(sensors))
        if old:
            calibrations.change(question, 'variants = ["all"]', "")
        with pytest.raises(Exception, match=said):
            read_next_pose(load(question)[1], question.parent)
        study.write_text(text)

    complain('"s"', "found 3 channels for 3 pose coordinates")
    complain('"s[1]", "s[2]", "cam_x", "cam_y", "height"', "own sensors .* do not determine")
    complain('"s", "cam_x", "cam_y"', "found different readings in 'one_rod' and 'all'", "all")
