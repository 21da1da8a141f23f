"""Many calibrations at once: the fits against SciPy's, and their errors against what an audit predicts."""

from __future__ import annotations

from dataclasses import replace

import audit_problems as problems
import numpy as np
import pytest
import telescope_machines as machines
from scipy.optimize import least_squares
from scipy.stats import norm

from bayescal.errors import InputError
from bayescal.identifiability.calibration import (
    Calibrations,
    compare_kept,
    compare_with_prediction,
    simulate_calibrations,
    simulate_measurements,
)
from bayescal.identifiability.fits import Fitter, Measurements
from bayescal.identifiability.information import Information, information_of_rows
from bayescal.identifiability.requirements import DRAWS
from bayescal.identifiability.selection import judge_reduced, select_parameters
from bayescal.identifiability.sensitivity import compute_measured_poses, compute_sensitivity, root_of
from bayescal.machines.frames import N_FRAME_PARAMETERS, frame_slopes, measured_pose_slopes, move_frames
from bayescal.machines.kinematics import solve_forward_kinematics, solve_inverse_kinematics
from bayescal.machines.sensors import PoseSensor
from bayescal.numerics.geometry import compute_pose_error, matrix_from_rotation_vector

FRAMES = ("base_x", "base_ry", "base_rz", "tool_z", "tool_rx", "tool_ry")
REPORT = {"sensors": (PoseSensor(2e-3, 1.7e-5),), "actuator_noise": 1e-3}


def build_report_problem(deformation="linear", share=1.0, **changes):
    """Return the telescope with the report's free parameters, tolerances scaled."""
    knowledge, plan = problems.build_telescope_problem(deformation, **changes)
    knowledge = problems.build_knowledge(knowledge.machine, machines.FREE_SYMBOLS[deformation])
    return problems.scale_tolerances(knowledge, share), plan


def build_redundant_problem(n_legs=8):
    """Return a machine of redundant legs with a plan of actuator positions at which the expected machine closes."""
    machine = machines.build_machine("linear", machines.build_random_mechanism(n_legs, 4))
    knowledge = problems.build_knowledge(machine, ("a_x", "a_y", "b_x", "b_y", "l", "kappa"))
    plan = problems.build_plan(machine, 30, model_error=2e-3)
    theta = machine.layout.nominal
    found = solve_forward_kinematics(machine, theta, plan.actuators)
    held = solve_inverse_kinematics(machine, theta, found.position, found.rotation)
    return knowledge, replace(plan, actuators=held.actuators)


def predict_covariance(knowledge, plan):
    return information_of_rows(compute_sensitivity(knowledge, plan.actuators).rows(plan), knowledge.sd).covariance


def draw_data(fitter, n, seed=1):
    rng = np.random.default_rng(seed)
    moves = rng.standard_normal((n, len(fitter.knowledge.sd)))
    measured, good = simulate_measurements(fitter, moves, rng)
    assert good.all()
    return moves, measured


# --- frames ------------------------------------------------------------------------------------------------------


def test_slopes_of_frames_anywhere_against_differences():
    rng = np.random.default_rng(0)
    frames = rng.normal(size=N_FRAME_PARAMETERS) * np.tile([5.0] * 3 + [0.4] * 3, 2)
    position, rotation = rng.normal(0, 200, (3, 3)), matrix_from_rotation_vector(rng.normal(0, 0.5, (3, 3)))
    by_pose, by_frames = measured_pose_slopes(frames, position, rotation)

    def seen(x):  # machines (K, 18): frames, then a change of the pose
        turned = matrix_from_rotation_vector(x[:, None, 15:]) @ rotation
        moved = move_frames(x[:, :12], position + x[:, None, 12:15], turned)
        here = move_frames(frames, position, rotation)
        return compute_pose_error(*moved, *here)

    start = np.concatenate([frames, np.zeros(6)])
    step = np.tile([1e-2] * 3 + [1e-3] * 3, 3)
    slope = machines.stencil_derivative(seen, start, step)
    expected = np.concatenate([by_frames, by_pose], axis=-1)
    assert np.abs(slope - expected).max() < 1e-8 * np.abs(expected).max()
    none = measured_pose_slopes(np.zeros(N_FRAME_PARAMETERS), position, rotation)
    assert np.array_equal(none[0], np.broadcast_to(np.eye(6), none[0].shape))
    assert np.abs(none[1] - frame_slopes(position, rotation)).max() < 1e-12


# --- fits --------------------------------------------------------------------------------------------------------


def fit_one(fitter, measured, start):
    """Return the moves that SciPy finds for one machine of six legs, by differences of forward kinematics."""
    knowledge, plan = fitter.knowledge, fitter.plan
    expected = compute_sensitivity(knowledge, plan.actuators)
    seen = plan.information(expected.poses)
    root = root_of(np.linalg.solve(np.eye(6) + seen @ expected.pose_noise(plan), seen))

    def residual(moves):
        theta = knowledge.centre.copy()
        theta[knowledge.free] += moves * knowledge.sd
        error = compute_pose_error(
            measured.position[0], measured.rotation[0], *compute_measured_poses(knowledge, theta, plan.actuators)
        )
        return np.concatenate([np.einsum("pij,pj->pi", root, error).ravel(), moves])

    return least_squares(residual, start, method="lm", x_scale="jac", xtol=1e-12, ftol=1e-12)


@pytest.mark.runs
@pytest.mark.parametrize(
    ("model", "symbols", "frames", "axes"),
    [
        ("six_pus", ("a_x", "a_y", "b_x", "b_y", "l", "kappa"), (), "xyz"),
        ("six_ups", ("a_x", "b_y", "l"), FRAMES, "xyz"),
        ("stiffness", ("a_x", "l", "beta"), (), "xz"),
    ],
)
def test_fits_are_those_of_scipy(model, symbols, frames, axes):
    machine = machines.build_machine("linear", model=model)
    knowledge = problems.build_knowledge(machine, symbols, frames)
    plan = problems.build_plan(machine, 8, sensors=(PoseSensor(0.01, 1e-5, axes),), model_error=2e-3)
    fitter = Fitter(knowledge, plan)
    moves, measured = draw_data(fitter, 2)
    fits = fitter.fit(measured)
    assert fits.converged.all()
    for k in range(len(moves)):
        found = fit_one(fitter, measured.take(np.array([k])), moves[k])
        off = fits.moves[k] - found.x
        assert off @ (fits.information[k] + np.eye(len(off))) @ off < 1e-4  # posterior standard deviations, squared
        assert fits.deviance[k] == pytest.approx(2.0 * found.cost, rel=1e-6)


def test_fits_of_redundant_legs_are_those_with_the_poses_as_unknowns():
    """The closure of the poses themselves, each unknown, with the sensors' noise: nothing is eliminated."""
    knowledge, plan = build_redundant_problem(7)
    knowledge = problems.scale_tolerances(
        problems.build_knowledge(knowledge.machine, ("a_x", "l")), 0.05
    )  # C is taken once
    plan = replace(plan, actuators=plan.actuators[:5])
    fitter = Fitter(knowledge, plan)
    moves, measured = draw_data(fitter, 1)
    fits = fitter.fit(measured)
    whiten = np.linalg.inv(np.linalg.cholesky(fitter.expected.closure_noise(plan)))
    sensor = np.sqrt(np.diagonal(plan.information(fitter.expected.poses), axis1=1, axis2=2))

    def residual(x):
        change, n_moves = x[len(knowledge.sd) :].reshape(-1, 6) / sensor, x[: len(knowledge.sd)]
        theta = fitter.theta(n_moves[None])[0, :-N_FRAME_PARAMETERS]
        position = measured.position[0] + change[:, :3]
        rotation = matrix_from_rotation_vector(change[:, 3:]) @ measured.rotation[0]
        closure = knowledge.machine.linearise(theta, position, rotation, measured.actuators[0]).residual
        return np.concatenate([np.einsum("pij,pj->pi", whiten, closure).ravel(), x])

    found = least_squares(residual, np.concatenate([moves[0], np.zeros(5 * 6)]), x_scale="jac", xtol=1e-12, ftol=1e-12)
    off = fits.moves[0] - found.x[: len(knowledge.sd)]
    assert off @ (fits.information[0] + np.eye(len(off))) @ off < 1e-4
    assert fits.deviance[0] == pytest.approx(2.0 * found.cost, rel=1e-5)


def test_what_no_sensor_sees_does_not_matter():
    knowledge, plan = build_report_problem()
    fitter = Fitter(knowledge, replace(plan, sensors=(PoseSensor(2e-3, 1.7e-5, "xz"),)))
    _, measured = draw_data(fitter, 3)
    moved = Measurements(measured.position + np.array([0.0, 0.5, 0.0]), measured.rotation, measured.actuators)
    assert fitter.fit(moved).moves == pytest.approx(fitter.fit(measured).moves, abs=1e-4)


def test_held_parameters_stay():
    knowledge, plan = build_report_problem()
    fitter = Fitter(knowledge, plan)
    moves, measured = draw_data(fitter, 2)
    start, weight = np.zeros_like(moves), np.ones_like(moves)
    start[:, 3], weight[:, 3] = moves[:, 3], 0.0
    fits = fitter.fit(measured, start, weight)
    assert np.array_equal(fits.moves[:, 3], moves[:, 3])
    others = np.delete(fits.moves, 3, axis=1)
    assert fits.deviance == pytest.approx(fits.data_deviance + (others**2).sum(axis=1), rel=1e-12)


def test_batches_are_the_machines_one_by_one():
    knowledge, plan = build_report_problem("none")
    fitter = Fitter(knowledge, plan)
    _, measured = draw_data(fitter, 25)
    together = fitter.fit(measured)
    for k in (0, 11, 24):
        alone = fitter.fit(measured.take(np.array([k])))
        assert alone.moves[0] == pytest.approx(together.moves[k], abs=1e-9)
        assert alone.n_iterations[0] == together.n_iterations[k]


def test_fits_converge_at_folds():
    """The direction of two actuators is found by its square alone where these lean as their legs, within tolerance."""
    knowledge, plan = build_report_problem("none")
    fitter, rng = Fitter(knowledge, plan), np.random.default_rng(1)
    measured, good = simulate_measurements(fitter, rng.standard_normal((200, len(knowledge.sd))), rng)
    fits = fitter.fit(measured.take(np.flatnonzero(good)))
    assert fits.converged.all()
    assert fits.n_iterations.max() > 10  # some are folded


def test_machine_that_is_none_is_not_converged():
    knowledge, plan = build_report_problem("none")
    fitter = Fitter(knowledge, plan)
    _, measured = draw_data(fitter, 2)
    start = np.zeros((2, len(knowledge.sd)))
    start[0, [knowledge.names.index(f"u_x[{leg}]") for leg in range(1, 7)]] = 30.0  # 1.5, longer than a unit vector
    fits = fitter.fit(measured, start)
    assert fits.converged.tolist() == [False, True]
    assert np.isinf(fits.deviance[0])


# --- simulated calibrations --------------------------------------------------------------------------------------


@pytest.mark.parametrize("n_legs", [6, 7])
def test_errors_are_as_predicted_where_all_is_linear(n_legs):
    """A hundredth of the tolerances; four standard errors, and an audit with half the noise is found out."""
    if n_legs == 6:
        knowledge, plan = build_report_problem("linear", 0.01, model_error=2e-3)
    else:
        knowledge, plan = build_redundant_problem(n_legs)
        knowledge = problems.scale_tolerances(knowledge, 0.01)
    simulated = simulate_calibrations(knowledge, plan, 80, np.random.default_rng(2))
    right = compare_with_prediction(simulated, predict_covariance(knowledge, plan))
    assert simulated.converged.all()
    assert abs(right.chi_square - 1.0) < 4 * right.chi_square_error
    assert right.chi_square_error < 0.04
    assert np.abs((right.ratio - 1.0) / right.ratio_error).max() < 4.5
    claimed = np.sqrt(np.diagonal(predict_covariance(knowledge, plan)))
    assert simulated.claimed == pytest.approx(np.tile(claimed, (80, 1)), rel=0.05)
    quiet = replace(plan, noise_factor=0.5, actuator_noise=0.5e-3, model_error=1e-3)
    wrong = compare_with_prediction(simulated, predict_covariance(knowledge, quiet))
    assert wrong.chi_square > 1.0 + 4 * wrong.chi_square_error


def test_draws_that_are_no_machine_are_drawn_anew():
    knowledge, plan = build_report_problem("none")
    wide = replace(knowledge, priors={n: 0.6 if n == "u_x[1]" else sd for n, sd in knowledge.priors.items()})
    simulated = simulate_calibrations(wide, plan, 60, np.random.default_rng(3))
    assert simulated.n_redrawn > 0
    assert wide.layout.inside(simulated.truth).all()


def test_tolerances_without_machines_are_an_error():
    knowledge, plan = build_report_problem("none")
    wild = replace(knowledge, priors={n: 40.0 if n.startswith("u_x") else sd for n, sd in knowledge.priors.items()})
    with pytest.raises(InputError, match="tolerances: found 20 of 20 machines"):
        simulate_calibrations(wild, plan, 20, np.random.default_rng(0))


def test_redundant_legs_need_noise():
    knowledge, plan = build_redundant_problem()
    with pytest.raises(InputError, match="redundant"):
        Fitter(knowledge, replace(plan, actuator_noise=0.0, model_error=0.0))


def test_comparison_of_known_errors():
    """Errors of plus and minus twice the prediction for one parameter and as predicted for the other."""
    signs = np.array([1.0, -1.0, 1.0, -1.0])
    errors, claimed = np.outer(signs, [0.2, 0.1]), np.tile([0.4, 0.05], (4, 1))
    simulated = Calibrations(("a_x[1]", "a_y[1]"), errors, claimed, np.ones(4, dtype=bool), 0)
    found = compare_with_prediction(simulated, np.diag([0.1**2, 0.1**2]))
    assert found.ratio == pytest.approx([2.0, 1.0])
    assert found.ratio_error == pytest.approx([0.0, 0.0], abs=1e-9)
    assert found.coverage[1.96] == pytest.approx([0.0, 1.0])
    assert found.by_symbol() == pytest.approx({"a_x": 2.0, "a_y": 1.0})
    assert found.chi_square == pytest.approx(2.5)
    assert found.claimed == pytest.approx([0.4, 0.05])
    assert found.covered == pytest.approx([1.0, 0.0])
    assert found.z == pytest.approx([0.5, 2.0])
    none = replace(simulated, errors=errors[:0], claimed=claimed[:0])
    with pytest.raises(InputError, match="found 0 that converged"):
        compare_with_prediction(none, np.eye(2))


# --- reduced sets ------------------------------------------------------------------------------------------------


def test_a_reduced_set_errs_as_said_in_closed_form():
    """A hundredth of the tolerances; what is held at nominal is off all the same."""
    knowledge, plan = problems.build_telescope_problem("linear")
    knowledge = problems.scale_tolerances(knowledge, 0.01)
    information = information_of_rows(compute_sensitivity(knowledge, plan.actuators).rows(plan), knowledge.sd)
    free = tuple(k for k, symbol in enumerate(knowledge.symbols) if symbol in ("a_x", "a_y", "b_x", "b_y", "l"))
    reduced = judge_reduced(information, free)
    simulated = simulate_calibrations(knowledge, plan, 60, np.random.default_rng(2), free)
    held = np.delete(simulated.estimate, knowledge.free[list(free)], axis=1)
    assert np.array_equal(held, np.tile(np.delete(knowledge.centre, knowledge.free[list(free)]), (60, 1)))
    found = compare_with_prediction(simulated, information.errors_of_reduced(free)[np.ix_(free, free)])
    assert found.names == tuple(knowledge.names[k] for k in free)
    assert np.abs((found.ratio - 1.0) / found.ratio_error).max() < 4.5
    assert found.claimed == pytest.approx(reduced.claimed, rel=0.05)
    assert np.mean(found.covered) == pytest.approx(reduced.coverage.mean(), abs=0.05)
    assert reduced.rms_z > 1.5  # or the test would say nothing
    assert np.sqrt(np.mean(found.z**2)) == pytest.approx(reduced.rms_z, rel=0.15)


def test_nothing_left_out_is_no_reduced_set():
    knowledge, plan = build_report_problem()
    information = information_of_rows(compute_sensitivity(knowledge, plan.actuators).rows(plan), knowledge.sd)
    assert judge_reduced(information, ()) is None
    assert judge_reduced(information, tuple(range(len(knowledge.names)))) is None


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
    plan = problems.read_shipped(name).bare()
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


def test_requirements_are_kept_as_often_as_claimed():
    claimed, found = count_kept_of("m2_hexapod", 60, (1.9,))
    assert all(0.6 < p < 0.9 for p in claimed)
    assert all(one.agrees for one in found)
    halved = [compare_kept(one.kept, one.n, p / 2.0, DRAWS) for one, p in zip(found, claimed, strict=True)]
    assert not any(one.agrees for one in halved)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["telescope_six_pus_linear", "telescope_six_pus_none", "m2_hexapod"])
def test_three_hundred_machines_keep_requirements_as_often_as_claimed(name):
    """Limits from mostly broken to mostly kept; each count has a chance of one in a hundred to be out of its band."""
    claimed, found = count_kept_of(name, 300, (1.2, 1.8, 2.3, 3.2))
    assert min(claimed) < 0.6 < 0.95 < max(claimed)
    assert sum(not one.agrees for one in found) <= 1


# --- what the issue wants ----------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("deformation", ["linear", "matrix"])
def test_two_hundred_calibrations_are_as_accurate_as_predicted(deformation):
    """Ten per cent for each symbol; chance alone moves a single parameter's ratio by five."""
    knowledge, plan = build_report_problem(deformation)
    simulated = simulate_calibrations(knowledge, plan, 200, np.random.default_rng(1))
    check_accuracy(simulated, predict_covariance(knowledge, plan))


@pytest.mark.slow
@pytest.mark.parametrize("recommended", [False, True])
@pytest.mark.parametrize("name", ["camera_hexapod", "m2_hexapod"])
def test_two_hundred_audited_calibrations_are_as_accurate_as_predicted(name, recommended):
    plan = problems.read_shipped(name).bare()
    if recommended:
        free = [plan.names[k] for k in select_parameters(plan.inform(), plan.symbols, plan.frames).free]
        plan = plan.replan(plan.maker.plan(plan.config.poses), plan.section.model_copy(update={"free": free})).bare()
    simulated, _ = plan.simulate(200, np.random.default_rng(1), list(range(len(plan.names))))
    check_accuracy(simulated, plan.inform().covariance)
    averaged = compare_with_prediction(simulated, plan.average(200, np.random.default_rng(2)))
    assert abs(averaged.chi_square - 1.0) < 4 * averaged.chi_square_error


def check_accuracy(simulated, covariance):
    assert simulated.converged.all()
    audit = compare_with_prediction(simulated, covariance)
    assert max(abs(ratio - 1.0) for ratio in audit.by_symbol().values()) < 0.1
    assert np.abs((audit.ratio - 1.0) / audit.ratio_error).max() < 4.5
    assert abs(np.mean(audit.coverage[1.96]) - 0.95) < 0.01


@pytest.mark.slow
def test_folds_within_tolerances_are_where_the_prediction_fails():
    """Without deformation two actuators lean almost as their legs do: 0.057 against a tolerance of 0.05.

    Where a machine lies on the other side of the fold a calibration that starts at nominal is wrong by twice the
    distance. All other parameters are as predicted, and so are those two in most calibrations.
    """
    knowledge, plan = build_report_problem("none")
    simulated = simulate_calibrations(knowledge, plan, 200, np.random.default_rng(1))
    found = compare_with_prediction(simulated, predict_covariance(knowledge, plan))
    ratio = dict(zip(found.names, found.ratio, strict=True))
    median = np.median(np.abs(simulated.errors), axis=0) / norm.ppf(0.75)  # few errors are far too large
    typical = dict(zip(found.names, median / found.predicted, strict=True))
    assert min(ratio["u_x[3]"], ratio["u_x[6]"]) > 1.3
    assert max(typical["u_x[3]"], typical["u_x[6]"]) < 1.2
    symbols = found.by_symbol()
    assert max(abs(symbols[s] - 1.0) for s in ("a_y", "b_x", "b_y", "l")) < 0.1
