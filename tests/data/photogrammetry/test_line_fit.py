"""The pose from the line through the targets: exact without noise, calibrated with it, not robust."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from bayescal.data.photogrammetry.line_fit import fit_line
from bayescal.data.photogrammetry.rigid_fit import fit_rigid_body
from bayescal.errors import InputError
from bayescal.numerics.geometry import compute_pose_error

NOISE = 0.005


def simulate(n_targets, n_poses, noise, rng):
    angle = rng.uniform(0, 2 * np.pi, n_targets)
    reference = np.stack([np.cos(angle), np.sin(angle), rng.uniform(0, 50, n_targets)], axis=-1)
    rotation = Rotation.random(n_poses, rng=rng).as_matrix()
    position = rng.uniform(-500, 500, (n_poses, 3))
    measured = position[:, None] + reference @ rotation.swapaxes(-1, -2)
    return reference, position, rotation, measured + noise * rng.standard_normal(measured.shape)


def test_exact_without_noise_for_any_direction():
    reference, position, rotation, measured = simulate(9, 200, 0.0, np.random.default_rng(1))
    fit = fit_line(reference, measured, NOISE)
    np.testing.assert_allclose(fit.position, position, atol=1e-8)
    np.testing.assert_allclose(fit.rotation, rotation, atol=1e-9)
    assert fit.converged.all()


@pytest.mark.parametrize("n_targets", [6, 12, 20])
def test_errors_have_the_stated_covariance(n_targets):
    n_poses = 3000
    reference, position, rotation, measured = simulate(n_targets, n_poses, NOISE, np.random.default_rng(n_targets))
    fit = fit_line(reference, measured, NOISE)
    error = compute_pose_error(position, rotation, fit.position, fit.rotation)
    square = np.einsum("pi,pij,pj->p", error, np.linalg.inv(fit.covariance), error)
    assert abs(square.mean() - 6) < 3.5 * np.sqrt(12 / n_poses)


@pytest.mark.parametrize("unseen", [[], [2, 5]])
def test_covariance_agrees_with_central_differences(unseen):
    reference, _, _, measured = simulate(8, 1, NOISE, np.random.default_rng(3))
    measured[:, unseen] = np.nan
    fit = fit_line(reference, measured[0], NOISE)
    step = 1e-4 * np.eye(24).reshape(24, 8, 3)
    plus, minus = fit_line(reference, measured + step, NOISE), fit_line(reference, measured - step, NOISE)
    jacobian = compute_pose_error(plus.position, plus.rotation, minus.position, minus.rotation).T / 2e-4
    np.testing.assert_allclose(fit.covariance, NOISE**2 * jacobian @ jacobian.T, rtol=1e-4, atol=1e-11)


def test_unseen_targets_are_as_good_as_absent():
    reference, _, _, measured = simulate(10, 3, NOISE, np.random.default_rng(4))
    keep = np.array([0, 1, 3, 4, 6, 7, 8, 9])
    expected = fit_line(reference[keep], measured[:, keep], NOISE)
    measured[:, [2, 5]] = np.nan
    fit = fit_line(reference, measured, NOISE)
    np.testing.assert_allclose(fit.position, expected.position, atol=1e-9)
    np.testing.assert_allclose(fit.rotation, expected.rotation, atol=1e-11)
    np.testing.assert_allclose(fit.weights[:, [2, 5]], 0)
    np.testing.assert_allclose(fit.chi2, expected.chi2, rtol=1e-6)


def test_fit_follows_motions_of_both_frames():
    rng = np.random.default_rng(5)
    reference, _, _, measured = simulate(10, 3, NOISE, rng)
    turn, shift = Rotation.random(rng=rng).as_matrix(), rng.uniform(-100, 100, 3)
    fit, moved = fit_line(reference, measured, NOISE), fit_line(reference, measured @ turn.T + shift, NOISE)
    np.testing.assert_allclose(moved.rotation, turn @ fit.rotation, atol=1e-9)
    np.testing.assert_allclose(moved.position, fit.position @ turn.T + shift, atol=1e-7)
    other = fit_line(reference @ turn.T + shift, measured, NOISE)  # another body frame
    np.testing.assert_allclose(other.rotation @ turn, fit.rotation, atol=1e-9)
    np.testing.assert_allclose(other.position + other.rotation @ shift, fit.position, atol=1e-7)


def test_a_wrong_target_moves_the_line_but_not_the_robust_fit():
    reference, position, rotation, measured = simulate(12, 1, NOISE, np.random.default_rng(6))
    measured[0, 4] += [0.0, 1000.0, 0.0]
    barycentre = reference.mean(axis=0)
    for fit_pose, moved in ((fit_line, True), (fit_rigid_body, False)):
        fit = fit_pose(reference, measured, NOISE)
        shift = np.linalg.norm(fit.position + fit.rotation @ barycentre - position - rotation @ barycentre)
        assert bool(shift > 1.0) is moved
        assert shift < 0.02 or moved


def test_input_errors():
    line = np.outer(np.linspace(0, 50, 6), [0.0, 0.0, 1.0])
    with pytest.raises(InputError, match="of a line"):
        fit_line(line, line, NOISE)
    cube = np.array([[x, y, z] for x in (-1.0, 1.0) for y in (-1.0, 1.0) for z in (-1.0, 1.0)])
    with pytest.raises(InputError, match="elongated"):
        fit_line(cube, cube, NOISE)
    two = line.copy()
    two[2:] = np.nan
    with pytest.raises(InputError, match="found 2 seen targets"):
        fit_line(line + np.eye(6, 3), two, NOISE)
    with pytest.raises(InputError, match="farther"):
        fit_line(*[line + 0.035 * np.tile([[1, 0, 0], [-1, 0, 0]], (3, 1))] * 2, NOISE)
