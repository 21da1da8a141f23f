"""Batched calibrations against SciPy, the truth, the linear prediction, and the fits of selections."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hexapod_settings import SCALE, load_setting
from scipy.optimize import least_squares

from bayescal.errors import InputError
from bayescal.machines.sensors import PoseSensor
from bayescal.numerics.geometry import matrix_from_rotation_vector, rotation_vector_from_matrix
from bayescal.pose_selection import candidates_at, even_candidates
from bayescal.pose_selection.calibrations import _LeastSquares
from bayescal.pose_selection.observability import angle_rates
from yu2023.least_squares import (
    PoseErrors,
    Weighting,
    calibrate,
    coordinates_from_pose,
    evaluate,
    find_lengths,
    linearise,
    move,
    pose_from_coordinates,
)
from yu2023.setup import CommandedPoses

SETTING = load_setting()
MACHINE = SETTING.machine
WEIGHTINGS = {
    "unweighted": Weighting(np.ones(6)),
    "weighted": Weighting(SCALE),
    "bayesian": Weighting(SCALE, 0.5),
}


def commanded(n: int = 20, seed: int = 3) -> CommandedPoses:
    placed = even_candidates(SETTING.domain, n, np.random.default_rng(seed)).placed
    return CommandedPoses(coordinates_from_pose(placed.position, placed.rotation), placed.actuators)


def simulated(n_machines: int, poses: CommandedPoses, noise: float = 1.0, seed: int = 4):
    rng = np.random.default_rng(seed)
    truth = SETTING.draw_machines(n_machines, rng)
    stood = SETTING.reach_poses(truth, poses)
    return truth, stood + noise * SCALE * rng.standard_normal(stood.shape)


def predict(theta: np.ndarray, poses: CommandedPoses) -> np.ndarray:
    start = pose_from_coordinates(poses.coordinates[None])
    position, rotation, found = move(MACHINE, theta[None], poses.actuators, *start)
    assert found.all()
    return coordinates_from_pose(position, rotation)[0]


def test_lengths_hold_the_pose_they_are_for():
    poses = commanded()
    theta = SETTING.draw_machines(1, np.random.default_rng(0))
    lengths = find_lengths(MACHINE, theta, *pose_from_coordinates(poses.coordinates))
    away = poses.coordinates[None] + 0.01
    position, rotation, found = move(MACHINE, theta, lengths, *pose_from_coordinates(away))
    assert found.all()
    np.testing.assert_allclose(coordinates_from_pose(position, rotation)[0], poses.coordinates, atol=1e-9)


def test_poses_are_selected_by_the_jacobian_of_the_calibration():
    """Yu, Wu and Wang 2023 eq. 23, in the angles; rotation vectors would be off by a sixth."""
    problem, n = SETTING.problem("O2", 20), 50
    placed = problem.candidates.placed
    position, rotation = placed.position[None, :n], placed.rotation[None, :n]
    nominal, actuators = MACHINE.layout.nominal[None], placed.actuators[:n]
    rows, error = linearise(MACHINE, nominal, actuators, position, rotation, coordinates_from_pose(position, rotation))
    np.testing.assert_allclose(problem.blocks[:n], rows[0], rtol=1e-9, atol=1e-12)
    assert not error.any()


@pytest.mark.runs
@pytest.mark.parametrize("name", WEIGHTINGS)
def test_batch_agrees_with_scipy_on_single_machines(name):
    poses, weighting = commanded(), WEIGHTINGS[name]
    _, measured = simulated(2, poses)
    found = calibrate(MACHINE, poses.actuators, measured, weighting)
    assert found.converged.all()
    for k in range(2):

        def residual(theta, own=measured[k]):
            rows = ((predict(theta, poses) - own) / weighting.scale).ravel()
            if weighting.prior is None:
                return rows
            return np.concatenate([rows, (theta - MACHINE.layout.nominal) / weighting.prior])

        start = MACHINE.layout.nominal
        alone = least_squares(residual, start, jac="3-point", xtol=1e-14, ftol=1e-14, gtol=1e-14, x_scale="jac")
        ours, theirs = (np.sum(residual(theta) ** 2) for theta in (found.theta[k], alone.x))
        assert ours <= theirs * (1 + 1e-7)
        np.testing.assert_allclose(found.theta[k], alone.x, atol=2e-4)  # sd of a parameter: 1e-2


def test_parameters_come_back_without_noise_in_three_iterations():
    poses = commanded()
    truth, measured = simulated(20, poses, noise=0.0)
    found = calibrate(MACHINE, poses.actuators, measured, WEIGHTINGS["unweighted"])
    errors = np.abs(found.trace - truth).max(axis=(1, 2))
    assert errors[3] < 5e-3
    assert errors[0] > 1.0
    np.testing.assert_allclose(found.theta, truth, atol=1e-6)
    assert found.n_iterations.max() <= 6


def test_scatter_matches_the_linear_prediction():
    poses, n = commanded(), 700
    truth, measured = simulated(n, poses)
    rows = SETTING.domain.design.see(SETTING.domain.at_actuators(poses.actuators)).slope
    rows[:, 3:] = angle_rates(pose_from_coordinates(poses.coordinates)[1]) @ rows[:, 3:]
    predicted, scatter = {}, {}
    for name in ("unweighted", "weighted"):
        scale = WEIGHTINGS[name].scale
        weighted = (rows / scale[:, None]).reshape(-1, MACHINE.layout.size)
        gain = np.linalg.pinv(weighted) / np.tile(scale, len(rows))
        predicted[name] = np.sqrt(((gain * np.tile(SCALE, len(rows))) ** 2).sum(axis=1))
        found = calibrate(MACHINE, poses.actuators, measured, WEIGHTINGS[name])
        assert found.converged.all()
        scatter[name] = np.sqrt(np.mean((found.theta - truth) ** 2, axis=0))
    for name, other in (("unweighted", "weighted"), ("weighted", "unweighted")):
        off = np.abs(scatter[name] / predicted[name] - 1.0)
        assert off.max() < 5.0 / np.sqrt(2 * n) + 0.02  # machines differ from nominal by 1e-3
        assert np.abs(scatter[other] / predicted[name] - 1.0).max() > 0.5


def test_most_probable_machines_are_those_of_selections():
    shares = even_candidates(SETTING.domain, 20, np.random.default_rng(3)).shares
    placed = candidates_at(SETTING.domain, shares * [1, 1, 1, 0.05, 0.05, 0.05]).placed  # angles are rotation vectors
    poses = CommandedPoses(coordinates_from_pose(placed.position, placed.rotation), placed.actuators)
    truth, _ = simulated(5, poses)
    position, rotation = pose_from_coordinates(SETTING.reach_poses(truth, poses))
    noise = SCALE * np.random.default_rng(5).standard_normal((*position.shape[:2], 6))
    position, rotation = position + noise[..., :3], matrix_from_rotation_vector(noise[..., 3:]) @ rotation
    ours = calibrate(MACHINE, poses.actuators, coordinates_from_pose(position, rotation), WEIGHTINGS["bayesian"])
    design = replace(SETTING.domain.design, sensors=(PoseSensor(SCALE[0], SCALE[3]),))
    seen, nothing = design.see(placed), np.zeros((20, 6))
    for k, found in enumerate(ours.theta):
        stands = np.concatenate([position[k], rotation_vector_from_matrix(rotation[k])], axis=1)
        theirs = _LeastSquares(seen, stands, poses.actuators, nothing, 1.0).solve()
        assert np.abs(found - design.theta - theirs @ design.moves).max() < 5e-3
    assert np.sqrt(np.mean((ours.theta - truth) ** 2)) > 0.1  # the prior counts here


def test_own_actuators_of_each_machine():
    one, two = commanded(seed=6), commanded(seed=7)
    _, first = simulated(2, one)
    _, second = simulated(2, two)
    both = np.stack([first[0], second[1]])
    found = calibrate(MACHINE, np.stack([one.actuators, two.actuators]), both, WEIGHTINGS["weighted"])
    for k, (poses, measured) in enumerate(((one, first), (two, second))):
        alone = calibrate(MACHINE, poses.actuators, measured[k : k + 1], WEIGHTINGS["weighted"])
        np.testing.assert_allclose(found.theta[k], alone.theta[0], atol=1e-7)


def test_too_few_poses_are_named():
    poses = commanded(6)
    _, measured = simulated(1, poses)
    with pytest.raises(InputError, match=r"poses: found 6,.* 7 .*42 parameters"):
        calibrate(MACHINE, poses.actuators, measured, WEIGHTINGS["unweighted"])
    assert calibrate(MACHINE, poses.actuators, measured, WEIGHTINGS["bayesian"]).converged.all()


def test_integrated_error_by_hand():
    errors = PoseErrors(np.array([[3.0, 4.0]]), np.array([[0.1, 0.2]]))
    np.testing.assert_allclose(errors.integrated("rad"), np.sqrt((3.1**2 + 4.2**2) / 2))
    degrees = np.degrees([0.1, 0.2])
    np.testing.assert_allclose(errors.integrated("deg"), np.sqrt(((3 + degrees[0]) ** 2 + (4 + degrees[1]) ** 2) / 2))
    figures = errors.figures
    assert figures["position_max_mm"] == 4.0
    assert figures["position_mean_mm"] == 3.5
    np.testing.assert_allclose(figures["attitude_mean_deg"], np.degrees(0.15))
    np.testing.assert_allclose(figures["attitude_max_deg"], np.degrees(0.2))


def test_perfect_calibration_has_no_error():
    truth = SETTING.draw_machines(3, np.random.default_rng(0))
    errors = evaluate(MACHINE, truth, truth, SETTING.targets)
    assert errors.position.shape == (3, 150)
    assert errors.position.max() < 1e-9
    assert errors.attitude.max() < 1e-12


def test_shifted_base_moves_the_platform_by_as_much():
    nominal = MACHINE.layout.nominal
    truth = nominal.copy()
    for symbol, shift in (("a_x", 0.3), ("a_y", -0.4)):
        truth[MACHINE.layout.index[symbol]] += shift
    errors = evaluate(MACHINE, truth[None], nominal[None], SETTING.targets)
    np.testing.assert_allclose(errors.position, 0.5, atol=1e-9)
    assert errors.attitude.max() < 1e-10


def test_failed_calibrations_have_no_errors():
    nominal = MACHINE.layout.nominal
    found = np.stack([nominal, np.full_like(nominal, np.nan)])
    errors = evaluate(MACHINE, np.tile(nominal, (2, 1)), found, SETTING.targets)
    assert np.isnan(errors.position[1]).all()
    assert errors.position[0].max() < 1e-9


def test_rotation_is_the_printed_one():
    a, b, g = 0.1, -0.2, 0.3
    _, rotation = pose_from_coordinates(np.array([1.0, 2.0, 3.0, a, b, g]))
    ca, sa, cb, sb, cg, sg = np.cos(a), np.sin(a), np.cos(b), np.sin(b), np.cos(g), np.sin(g)
    printed = [
        [cg * cb, cg * sb * sa - sg * ca, cg * sb * ca + sg * sa],
        [sg * cb, sg * sb * sa + cg * ca, sg * sb * ca - cg * sa],
        [-sb, cb * sa, cb * ca],
    ]
    np.testing.assert_allclose(rotation, printed, atol=1e-15)


def test_coordinates_come_back():
    q = np.random.default_rng(0).uniform(-1.0, 1.0, (4, 5, 6))
    np.testing.assert_allclose(coordinates_from_pose(*pose_from_coordinates(q)), q, atol=1e-14)
