"""Deformation of the ring: deflections with their covariance, and posteriors of both models."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import t

from bayescal.data.photogrammetry.joint_deflection import (
    JointDeflection,
    fit_linear_deformation,
    fit_matrix_deformation,
    measure_joint_deflection,
)
from bayescal.data.photogrammetry.rigid_fit import fit_rigid_body
from bayescal.errors import InputError
from bayescal.numerics.geometry import compute_pose_error

NOISE = 0.005
N_LEGS = 6


def make_platform(n_pad=4):
    rng = np.random.default_rng(0)
    rigid = np.c_[rng.uniform(-150, 150, (20, 2)), rng.uniform(0, 100, 20)]
    angle = np.repeat(2 * np.pi * np.arange(N_LEGS) / N_LEGS, n_pad)
    ring = np.c_[200 * np.cos(angle), 200 * np.sin(angle), np.zeros(len(angle))] + rng.uniform(-5, 5, (len(angle), 3))
    return rigid, ring, np.repeat(np.arange(1, N_LEGS + 1), n_pad)


def simulate(deflection, rng, noise=NOISE, n_pad=4):
    """Return rigid and ring targets as measured, for deflections (P, N) in mm."""
    rigid, ring, leg = make_platform(n_pad)
    rotation = Rotation.random(len(deflection), rng=rng).as_matrix()
    position = rng.uniform(-500, 500, (len(deflection), 1, 3))
    moved = np.repeat(ring[None], len(deflection), axis=0)
    moved[..., 2] += deflection[:, leg - 1]
    bodies = np.concatenate([np.repeat(rigid[None], len(deflection), axis=0), moved], axis=1)
    measured = position + bodies @ rotation.swapaxes(-1, -2)
    measured = measured + noise * rng.standard_normal(measured.shape)
    return measured[:, :20], measured[:, 20:]


def measure(deflection, rng, noise=NOISE, n_pad=4):
    rigid, ring, leg = make_platform(n_pad)
    on_body, on_ring = simulate(deflection, rng, noise, n_pad)
    return measure_joint_deflection(fit_rigid_body(rigid, on_body, NOISE), ring, on_ring, leg, NOISE, N_LEGS)


def correlated_ring(matrix, actuator, covariance, rng):
    draws = rng.standard_normal(actuator.shape) @ np.linalg.cholesky(covariance).T
    return JointDeflection(actuator @ matrix.T + draws, np.broadcast_to(covariance, (len(actuator), *covariance.shape)))


def draw_covariance(rng):
    root = rng.standard_normal((N_LEGS, N_LEGS))
    return 1e-5 * (root @ root.T + np.eye(N_LEGS))


def test_exact_without_noise():
    deflection = np.random.default_rng(1).uniform(-0.06, 0.06, (5, N_LEGS))
    ring = measure(deflection, np.random.default_rng(2), noise=0.0)
    np.testing.assert_allclose(ring.displacement, deflection, atol=1e-9)


def test_deflections_have_the_stated_covariance():
    rng = np.random.default_rng(3)
    deflection = rng.uniform(-0.06, 0.06, (1500, N_LEGS))
    ring = measure(deflection, rng)
    error = ring.displacement - deflection
    square = np.einsum("pi,pij,pj->p", error, np.linalg.inv(ring.covariance), error)
    assert abs(square.mean() - N_LEGS) < 3.5 * np.sqrt(2 * N_LEGS / len(square))
    correlation = ring.covariance[0] / np.sqrt(np.outer(*[np.diagonal(ring.covariance[0])] * 2))
    found = np.corrcoef(error.T)
    assert np.abs(found - correlation).max() < 5 / np.sqrt(len(error))
    assert np.abs(found - np.eye(N_LEGS)).max() > 10 / np.sqrt(len(error))  # the pose makes legs correlated


def test_wrong_and_unseen_pad_targets():
    rigid, ring, leg = make_platform()
    on_body, on_ring = simulate(np.full((3, N_LEGS), 0.05), np.random.default_rng(4))
    fit = fit_rigid_body(rigid, on_body, NOISE)
    wrong, without = on_ring.copy(), on_ring.copy()
    wrong[:, [1, 6]] += 1000.0
    without[:, [1, 6]] = np.nan
    results = [measure_joint_deflection(fit, ring, m, leg, NOISE, N_LEGS) for m in (wrong, without, on_ring)]
    np.testing.assert_allclose(results[0].displacement, results[1].displacement, atol=1e-12)
    np.testing.assert_allclose(results[0].covariance, results[1].covariance, rtol=1e-9)
    excess = np.diagonal(results[1].covariance - results[2].covariance, axis1=1, axis2=2)
    assert np.all(excess[:, :2] > 0.5 * NOISE**2 * (1 / 3 - 1 / 4))


def test_two_targets_on_a_pad_are_averaged_without_rejection():
    rigid, ring, leg = make_platform(n_pad=2)
    on_body, on_ring = simulate(np.zeros((1, N_LEGS)), np.random.default_rng(5), n_pad=2)
    fit = fit_rigid_body(rigid, on_body, NOISE)
    on_ring[0, 0] += 3.0 * fit.rotation[0, :, 2]
    ring_result = measure_joint_deflection(fit, ring, on_ring, leg, NOISE, N_LEGS)
    assert ring_result.displacement[0, 0] == pytest.approx(1.5, abs=0.05)


def test_input_errors_of_the_measurement():
    rigid, ring, leg = make_platform()
    on_body, on_ring = simulate(np.zeros((2, N_LEGS)), np.random.default_rng(6))
    fit = fit_rigid_body(rigid, on_body, NOISE)
    empty = on_ring.copy()
    empty[1, leg == 3] = np.nan
    with pytest.raises(InputError, match=r"fit 1: .* leg 3: "):
        measure_joint_deflection(fit, ring, empty, leg, NOISE, N_LEGS)
    with pytest.raises(InputError, match="expected 1 to 6"):
        measure_joint_deflection(fit, ring, on_ring, np.minimum(leg, 5), NOISE, N_LEGS)
    with pytest.raises(InputError, match="expected \\(24, 3\\)"):
        measure_joint_deflection(fit, ring[1:], on_ring, leg, NOISE, N_LEGS)


def test_linear_deformation_is_the_closed_form_and_covers():
    rng = np.random.default_rng(7)
    kappa, n_poses, inside = np.linspace(0.005, 0.02, N_LEGS), 8, []
    actuator = rng.uniform(-3, 3, (n_poses, N_LEGS))
    for _ in range(400):
        displacement = kappa * actuator + 0.01 * rng.standard_normal(actuator.shape)
        fit = fit_linear_deformation(JointDeflection(displacement, np.zeros((n_poses, N_LEGS, N_LEGS))), actuator)
        scale = fit.sd * np.sqrt((fit.dof - 2) / fit.dof)
        inside.append(np.abs(fit.kappa - kappa) < t.ppf(0.84, fit.dof) * scale)
    assert np.mean(inside) == pytest.approx(0.68, abs=4 * np.sqrt(0.68 * 0.32 / 2400))
    for leg in range(N_LEGS):
        solution, residual, *_ = np.linalg.lstsq(actuator[:, [leg]], displacement[:, leg])
        assert fit.kappa[leg] == pytest.approx(solution[0])
        assert fit.residual_sd[leg] == pytest.approx(np.sqrt(residual[0] / (n_poses - 1)))


def test_matrix_deformation_weighs_by_the_covariance_of_each_pose():
    rng = np.random.default_rng(9)
    actuator, displacement = rng.uniform(-3, 3, (2, 12, N_LEGS))
    covariance = np.stack([draw_covariance(rng) for _ in range(12)])
    fit = fit_matrix_deformation(JointDeflection(displacement, covariance), actuator)
    root = np.linalg.inv(np.linalg.cholesky(covariance))
    design = np.concatenate([root[p] @ np.kron(np.eye(6), actuator[p]) for p in range(12)])
    white = np.einsum("pij,pj->pi", root, displacement).ravel()
    expected, inverse = np.linalg.lstsq(design, white)[0], np.linalg.inv(design.T @ design)
    np.testing.assert_allclose(fit.matrix.ravel(), expected, rtol=1e-7, atol=1e-10)
    np.testing.assert_allclose(fit.sd.ravel() ** 2, np.diagonal(inverse), rtol=1e-6)
    np.testing.assert_allclose(fit.covariance, inverse, rtol=0, atol=1e-6 * np.abs(inverse).max())
    assert fit.chi2 == pytest.approx(np.sum((white - design @ expected) ** 2))
    assert fit.dof == 12 * 6 - 36


def test_matrix_is_recovered_from_targets():
    rng = np.random.default_rng(11)
    matrix, actuator = rng.uniform(-0.02, 0.02, (6, 6)), rng.uniform(-3, 3, (40, 6))
    fit = fit_matrix_deformation(measure(actuator @ matrix.T, rng), actuator)
    error = (fit.matrix - matrix).ravel()
    assert abs(error @ np.linalg.solve(fit.covariance, error) - 36) < 4 * np.sqrt(72)
    assert abs(fit.chi2 - fit.dof) < 4 * np.sqrt(2 * fit.dof)
    assert np.abs(error).max() < 2e-3


def test_input_errors_of_the_models():
    rng = np.random.default_rng(12)
    actuator = rng.uniform(-3, 3, (9, 6))
    ring = correlated_ring(np.eye(6), actuator, np.eye(6), rng)
    with pytest.raises(InputError, match="9 poses of rank 2"):
        fit_matrix_deformation(ring, actuator[:, :2] @ rng.uniform(-1, 1, (2, 6)))
    five = JointDeflection(ring.displacement[:5], ring.covariance[:5])
    with pytest.raises(InputError, match="found 5 poses"):
        fit_matrix_deformation(five, actuator[:5])
    with pytest.raises(InputError, match="found 3 poses"):
        fit_linear_deformation(JointDeflection(ring.displacement[:3], ring.covariance[:3]), actuator[:3])
    with pytest.raises(InputError, match="actuator 4"):
        fit_linear_deformation(ring, actuator * (np.arange(6) != 3))
    with pytest.raises(InputError, match="expected \\(9, 6\\)"):
        fit_matrix_deformation(ring, actuator[:8])


@pytest.mark.runs
def test_deflections_depend_on_the_error_of_the_pose():
    """Given the pose's error, what is left of a deflection's is the mean noise of four targets, legs independent."""
    deflection = np.random.default_rng(13).uniform(-0.06, 0.06, (1500, N_LEGS))
    rigid, ring, leg = make_platform()
    (true_body, _), (on_body, on_ring) = (
        simulate(deflection, np.random.default_rng(14), noise) for noise in (0, NOISE)
    )
    true, fit = (fit_rigid_body(rigid, body, NOISE) for body in (true_body, on_body))
    found = measure_joint_deflection(fit, ring, on_ring, leg, NOISE, N_LEGS)
    pose = compute_pose_error(fit.position, fit.rotation, true.position, true.rotation)
    error = found.displacement - deflection
    left = error - np.einsum("pij,pj->pi", found.with_pose @ np.linalg.inv(fit.covariance), pose)
    bound = 5 * np.sqrt(2 / error.size)
    assert left.var() / (NOISE**2 / 4) == pytest.approx(1.0, abs=bound)
    assert error.var() / (NOISE**2 / 4) > 1.0 + 2 * bound
    assert np.abs(np.corrcoef(left.T) - np.eye(N_LEGS)).max() < 5 / np.sqrt(len(error))


def test_matrix_follows_the_errors_of_the_poses():
    """K is linear in the deflections, and these in the error of the pose: one pose's error moves K as is claimed."""
    rng = np.random.default_rng(15)
    actuator = rng.uniform(-1.3, 1.3, (9, N_LEGS))
    rigid, ring, leg = make_platform()
    on_body, on_ring = simulate(actuator @ (0.02 * rng.standard_normal((N_LEGS, N_LEGS))).T, rng)
    fit = fit_rigid_body(rigid, on_body, NOISE)
    found = measure_joint_deflection(fit, ring, on_ring, leg, NOISE, N_LEGS)
    plain, pose = fit_matrix_deformation(found, actuator), 4
    moved = np.linalg.cholesky(fit.covariance[pose])
    by_error = found.with_pose[pose] @ np.linalg.inv(fit.covariance[pose]) @ moved
    changed = found.displacement + np.zeros((6, 1, 1))
    changed[:, pose] += by_error.T
    ends = [fit_matrix_deformation(JointDeflection(one, found.covariance), actuator).matrix for one in changed]
    expected = np.stack([(end - plain.matrix).ravel() for end in ends], axis=1) @ moved.T
    np.testing.assert_allclose(plain.with_pose[pose], expected, atol=1e-6 * np.abs(expected).max())
