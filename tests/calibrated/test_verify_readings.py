"""Reverifications by readings: statistics against least squares over everything, rates of error, refusals."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import calibrated_machines
import calibrated_readings as made_up
import calibrations
import numpy as np
import pytest
import telescope_machines

from bayescal.calibrated.machine import CalibratedMachine
from bayescal.calibrated.verify.plan import VerificationGoal, expect_readings, list_candidates, plan_reverification
from bayescal.calibrated.verify.statistics import choose_suspects, compute_knowledge, find_poses, judge_reverification
from bayescal.errors import InputError
from bayescal.experiments.runner.load import load
from bayescal.experiments.runner.run import run_experiment
from bayescal.experiments.shared.calibrating import load_calibrated

CASES = {
    "delta": ("l", 0.1, None),
    "hangprinter": ("A_z", 6.0, ["motor"]),
    "lines": ("zero", 1.0, None),
    "star": ("l", 0.1, None),
    "telescope": ("l", 0.02, None),
}
"""By machine: what may shift, by how much, and what is read; the printer and the point by their own channels alone."""
LEGS = np.array([1e-3] * 6 + [15e-3] * 3 + [np.radians(15.0 / 3600.0)] * 3)
"""Noise of the telescope's actuators and of its measured pose, mm and rad."""


@pytest.fixture(scope="module", params=CASES)
def case(request):
    """Return a calibrated machine, what may have shifted and by how much, and the noise of what is read."""
    symbol, shift, channels = CASES[request.param]
    if request.param == "telescope":
        machine = telescope_machines.build_machine("none")
        calibrated = calibrated_machines.build_made_up(machine, np.random.default_rng(4), scale=1e-3)
        return calibrated, choose_suspects(calibrated, [symbol]), shift, LEGS
    planned = made_up.build_planned(request.param)
    calibrated = made_up.calibrate(planned, 40, np.random.default_rng(7))
    sd = planned.sd if channels is None else made_up.only(planned.sd, planned.model, channels)
    return calibrated, choose_suspects(calibrated, [symbol]), shift, sd


@pytest.fixture(scope="module")
def plan(case):
    calibrated, suspects, shift, sd = case
    commands, given = list_candidates(calibrated, 0.8)
    commands, given = commands[::9], {name: value[::9] for name, value in given.items()}
    demand = VerificationGoal(np.full(len(suspects.names), shift), sessions=2)
    return plan_reverification(calibrated, suspects, commands, given, expect_readings(sd), demand)


def try_once(case, plan, rng, shift: float = 0.0, place: int = 0):
    """Return what a reverification says of a machine of the posterior, one of its parameters shifted."""
    calibrated, suspects, _, sd = case
    theta = made_up.draw_truth(calibrated, rng)
    theta[suspects.places[place]] += shift
    arguments = (calibrated, theta, plan.commands, plan.given, sd, rng)
    sessions = [made_up.read_again(*arguments) for _ in range(plan.demand.sessions)]
    return judge_reverification(calibrated, suspects, sessions, plan.demand.false_alarm, plan.demand.sessions)


def test_scores_are_those_of_least_squares_over_poses_parameters_and_shifts(case, rng):
    """All unknowns in one system, poses flat, parameters with their posterior, instead of poses eliminated."""
    calibrated, suspects, _, sd = case
    commands, given = (list_candidates(calibrated, 0.5)[0][5:8], calibrated.typical(3))
    session = made_up.read_again(calibrated, made_up.draw_truth(calibrated, rng), commands, given, sd, rng)
    knowledge = compute_knowledge(calibrated, suspects, session)
    pose = find_poses(calibrated, session)
    read = np.isfinite(sd)
    here = calibrated.model.linearise(calibrated.theta, pose, True, given)
    p, q, n, m = len(pose), pose.shape[1], len(suspects.places), len(calibrated.free)
    own, covariance = calibrated.commanded, np.tile(np.diag(np.nan_to_num(sd) ** 2), (p, 1, 1))
    commands = session.values[:, own]
    covariance[:, own[:, None], own] = calibrated.errors.covariance(pose, commands)
    root = np.linalg.inv(np.linalg.cholesky(covariance[:, read][:, :, read]))
    white = root @ np.concatenate([here.by_pose, here.by_parameters], axis=-1)[:, read]
    rows = np.zeros((p, read.sum(), p * q + m + n))
    for k in range(p):
        rows[k, :, k * q : (k + 1) * q] = white[k, :, :q]
        rows[k, :, p * q : p * q + m] = white[k][:, q + calibrated.free]
        rows[k, :, p * q + m :] = white[k][:, q + suspects.places]
    error = (root @ (session.values - here.values)[:, read, None])[..., 0]
    rows, error = rows.reshape(-1, rows.shape[-1]), error.ravel()
    normal = rows.T @ rows
    normal[p * q : p * q + m, p * q : p * q + m] += np.linalg.inv(calibrated.covariance)
    scale = 1.0 / np.sqrt(np.diag(normal))
    normal, side = normal * np.outer(scale, scale), (rows.T @ error) * scale
    others = slice(0, p * q + m)
    gain = np.linalg.solve(normal[others, others], np.column_stack([normal[others, p * q + m :], side[others]]))
    information = normal[p * q + m :, p * q + m :] - normal[p * q + m :, others] @ gain[:, :n]
    score = side[p * q + m :] - normal[p * q + m :, others] @ gain[:, n]
    size_of = scale[p * q + m :]
    found_score, found = knowledge.score(knowledge.gram.sum(axis=0))
    size = np.sqrt(np.outer(np.diag(found), np.diag(found)))
    np.testing.assert_allclose(found / size, information / np.outer(size_of, size_of) / size, rtol=0.0, atol=1e-5)
    np.testing.assert_allclose(
        found_score / np.sqrt(np.diag(found)), score / size_of / np.sqrt(np.diag(found)), atol=1e-3
    )
    assert knowledge.n_rows == p * (read.sum() - q)


def test_a_plan_finds_every_shift_and_a_large_one_is_named(case, plan):
    assert (plan.power >= plan.demand.power).all()
    assert len(set(plan.chosen)) == len(plan.chosen)
    rng, n = np.random.default_rng(5), len(plan.suspects.names)
    shift = 2.0 * case[2]
    said = [try_once(case, plan, rng, shift, k % n) for k in range(4)]
    assert not any(one.holds for one in said)
    alike = plan.test.information[-1] / np.sqrt(np.outer(*2 * [np.diag(plan.test.information[-1])]))
    for k, one in enumerate(said):  # one spare reading a pose hardly says which anchor of four lines it was
        assert abs(alike[one.worst, k % n]) > 0.9
        assert one.worst == k % n or np.abs(alike - np.eye(n)).max() > 0.9
        assert one.shift[k % n] == pytest.approx(shift, abs=5.0 * one.sd[k % n])
        assert not one.is_odd


@pytest.mark.slow
def test_reverifications_are_as_often_wrong_as_they_say(case, plan):
    """False alarms and shifts found on 400 machines of the posterior, readings as they are."""
    rng, n, n_times = np.random.default_rng(11), len(plan.suspects.names), 400
    alarms = [not try_once(case, plan, rng).holds for _ in range(n_times)]
    found = [not try_once(case, plan, rng, case[2], k % n).holds for k in range(n_times)]
    promised = float(np.mean(plan.power))
    assert np.mean(alarms) < 0.01 + 4.0 * np.sqrt(0.01 * 0.99 / n_times)
    assert abs(np.mean(found) - promised) < 4.0 * np.sqrt(promised * (1.0 - promised) / n_times) + 0.01


# --- what is asked for -------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def delta() -> tuple[CalibratedMachine, np.ndarray]:
    planned = made_up.build_planned("delta")
    return made_up.calibrate(planned, 30, np.random.default_rng(2)), planned.sd


def plan_for(delta, names, sd, size=10.0):
    calibrated = delta[0]
    suspects = choose_suspects(calibrated, names)
    commands, given = list_candidates(calibrated, 0.8)
    demand = VerificationGoal(np.full(len(suspects.names), size), sessions=2, most=6)
    return plan_reverification(calibrated, suspects, commands[::30], given, expect_readings(sd), demand)


def test_without_names_all_free_parameters_are_suspect(delta):
    suspects = choose_suspects(delta[0], ())
    assert suspects.names == delta[0].names
    assert not suspects.stated
    assert choose_suspects(delta[0], ["l[2]", "s0"]).names == ("l[2]", "s0[1]", "s0[2]", "s0[3]")


def test_no_shift_shows_where_the_pose_takes_up_all_that_is_read(delta):
    sd = made_up.only(delta[1], delta[0].model, ["s"])
    with pytest.raises(InputError, match="3 channels for 3"):
        plan_for(delta, ["l"], sd)


def test_a_shift_that_nothing_shows_is_refused_by_name(delta):
    """The zero of a camera that is not read; the same one is left out where nobody asked for it."""
    calibrated, sd = delta
    model = calibrated.model
    unread = made_up.only(sd, model, ["s", "cam_x", "cam_y"])
    name = next(n for n in model.layout.names if not {n} & set(model.seen_parameters(["s", "cam_x", "cam_y"])))
    with pytest.raises(InputError, match="shift of t_x"):
        plan_for(delta, [name], unread)


def test_too_small_a_shift_says_how_often_it_would_be_found(delta):
    with pytest.raises(InputError, match=r"6 poses .* l\[\d\] by 1 µm .* 95 %"):
        plan_for(delta, ["l"], delta[1], size=1e-3)


def test_unknown_names_are_refused(delta):
    with pytest.raises(InputError, match="found 'w',"):
        choose_suspects(delta[0], ["w"])
    with pytest.raises(InputError, match="posterior draws"):
        plan_for((replace(delta[0], covariance=None), delta[1]), ["l"], delta[1])


def test_rows_out_of_reach_are_named(delta, rng):
    calibrated, sd = delta
    commands, given = list_candidates(calibrated, 0.5)
    session = made_up.read_again(calibrated, calibrated.theta, commands[:3], given, sd, rng)
    session.values[1] += 1e4
    with pytest.raises(InputError, match="pose 'R02':"):
        compute_knowledge(calibrated, choose_suspects(calibrated, ["l"]), session)


# --- the command -------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def results(tmp_path_factory) -> Path:
    """Return the results of a small calibration of the delta."""
    path = calibrations.write_delta(tmp_path_factory.mktemp("delta"))
    text = path.read_text()
    path.write_text(text[: text.index('[[variants]]\nname = "one_rod"')] + text[text.index("[sampler]") :])
    run_experiment(load(path)[1], path.parent, path.parent / "results")
    return path.parent / "results"


@pytest.mark.runs
def test_an_operator_takes_the_plan_and_brings_readings_back(results, call, tmp_path):
    plan, always = tmp_path / "plan.csv", ("--trust-code", "--allow-unconverged", "--parameters", "l")
    code, said, complaint = call("verify", results, *always, "--shift-um", "150", "--out", plan)
    assert (code, complaint) == (0, "")
    assert "parameter by 150 µm" in said
    rows = [line.split(",") for line in plan.read_text().splitlines() if not line.startswith("#")]
    assert rows[0] == ["pose", "use", "s_1_mm", "s_2_mm", "s_3_mm"]
    calibrated = load_calibrated(results, allow_unconverged=True, trust=True)
    commands, rng = np.array([row[2:] for row in rows[1:]], dtype=float), np.random.default_rng(3)
    for shift, expected in ((0.0, "the calibration holds"), (1.0, "l[2] shifted by +")):
        theta = calibrated.theta.copy()
        theta[calibrated.model.layout.names.index("l[2]")] += shift
        read = made_up.read_again(calibrated, theta, commands, {}, calibrated.noise, rng).values
        lines = [
            f"{row[0]},{','.join(repr(float(x)) for x in one[3:])}" for row, one in zip(rows[1:], read, strict=True)
        ]
        (tmp_path / "read.csv").write_text("\n".join(["pose,cam_x_mm,cam_y_mm,height_mm", *lines]) + "\n")
        judged = ("--measured", tmp_path / "read.csv", "--actuators", plan)
        code, said, complaint = call("verify", results, *always, *judged)
        assert (code, complaint) == (0, "")
        assert said.startswith(expected), said


FAULTS = {
    "own sensors alone": (("--sensors", "s"), "found 3 channels for 3 pose coordinates"),
    "two sizes": (("--shift-um", "1", "--shift-sd", "3"), "expected one of --shift-um, --shift-arcsec and --shift-sd"),
    "angles in micrometres": (("--parameters", "t_x", "--shift-um", "3"), "found --shift-um for parameters in mm, rad"),
    "an unknown sensor": (("--sensors", "cam"), "sensor 'cam': expected"),
}


@pytest.mark.runs
@pytest.mark.parametrize("fault", FAULTS)
def test_what_is_at_fault_is_one_line(fault, results, refuse, tmp_path):
    options, said = FAULTS[fault]
    always = ("--trust-code", "--allow-unconverged", "--parameters", "l")
    refuse(re.escape(said), tmp_path / "plan.csv", "verify", results, *always, *options)


@pytest.mark.runs
def test_readings_without_a_pose_or_noise_are_refused(results, call, tmp_path):
    path = tmp_path / "read.csv"
    path.write_text("pose,cam_x_mm,cam_y_mm,height_mm\nR01,1.0,2.0,3.0\n")
    judged = ("verify", results, "--trust-code", "--allow-unconverged", "--measured", path)
    assert re.search(r"s\[1\], s\[2\], s\[3\].* --actuators", call(*judged)[2])
    (tmp_path / "plan.csv").write_text("pose,s_1_mm,s_2_mm,s_3_mm\nR02,200.0,200.0,200.0\n")
    assert "pose 'R01':" in call(*judged, "--actuators", tmp_path / "plan.csv")[2]
