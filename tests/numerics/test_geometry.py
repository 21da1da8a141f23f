"""Rotations against an independent form over all angles; relative poses against simulation and differences."""

from __future__ import annotations

import numpy as np
import pytest
import telescope_machines as machines

from bayescal.numerics.geometry import (
    compute_left_inverse_jacobian,
    compute_left_jacobian,
    compute_pose_error,
    compute_relative_pose,
    matrix_from_rotation_vector,
    rotation_vector_from_matrix,
    rotation_vector_of_turn,
    skew_matrix,
)

ANGLES = (0.0, 1e-12, 1e-9, 1e-6, 1e-3, 0.1, 1.0, 2.0, 3.0, 3.1415, np.pi - 1e-6, np.pi - 1e-9)


def rodrigues_minus_identity(axis, angle):
    """Return Exp(angle · axis) - 1 with the cosine's difference as sin²(angle/2), so that no digit is lost."""
    cross = np.array([[0, -axis[2], axis[1]], [axis[2], 0, -axis[0]], [-axis[1], axis[0], 0]])
    return np.sin(angle) * cross + 2 * np.sin(0.5 * angle) ** 2 * cross @ cross


@pytest.mark.parametrize("angle", ANGLES)
def test_rotation_matrix_matches_rodrigues(angle, rng):
    for axis in draw_axes(rng):
        expected = rodrigues_minus_identity(axis, angle)
        found = matrix_from_rotation_vector(angle * axis)
        np.testing.assert_allclose(found - np.eye(3), expected, rtol=0, atol=4e-15)


def draw_axes(rng):
    """Return unit vectors (20, 3)."""
    axes = rng.standard_normal((20, 3))
    return axes / np.linalg.norm(axes, axis=1, keepdims=True)


@pytest.mark.parametrize("angle", [1e-12, 1e-9, 1e-6, 1e-3, 0.1, 1.0, 3.0])
def test_small_rotations_keep_their_relative_accuracy(angle, rng):
    axes = draw_axes(rng)
    off_diagonal = matrix_from_rotation_vector(angle * axes)
    axial = np.stack([off_diagonal[:, m, n] - off_diagonal[:, n, m] for m, n in ((2, 1), (0, 2), (1, 0))], axis=1)
    # the axial part of Exp is 2 sin(angle) axis; its rounding is relative to the entries it is the difference of
    entries = np.abs(angle) + 1 - np.cos(angle)
    np.testing.assert_allclose(axial, 2 * np.sin(angle) * axes, rtol=0, atol=8e-16 * entries)


@pytest.mark.parametrize("angle", [*ANGLES, 2.6, 2.7])
@pytest.mark.parametrize(("find", "rounding"), [(rotation_vector_from_matrix, 1e-15), (rotation_vector_of_turn, 2e-15)])
def test_rotation_vectors_invert_the_matrix(find, rounding, angle, rng):
    axes = draw_axes(rng)
    turns = np.stack([np.eye(3) + rodrigues_minus_identity(axis, angle) for axis in axes]).reshape(4, 5, 3, 3)
    # entries of order one are rounded to 1e-16: so is the vector, relative to the angle for those above 1e-3
    expected = angle * axes.reshape(4, 5, 3)
    np.testing.assert_allclose(find(turns), expected, rtol=0, atol=rounding * max(1.0, angle))


def test_a_turn_that_is_no_number_has_no_vector():
    turns = np.stack([np.eye(3), np.full((3, 3), np.nan)])
    np.testing.assert_array_equal(np.isnan(rotation_vector_of_turn(turns)), [[False] * 3, [True] * 3])


@pytest.mark.parametrize("angle", [1e-12, 1e-8, 1e-4, 1e-2])
def test_rotation_vector_of_small_angles_is_relatively_exact(angle, rng):
    axes = draw_axes(rng)
    found = rotation_vector_from_matrix(matrix_from_rotation_vector(angle * axes))
    np.testing.assert_allclose(found, angle * axes, rtol=1e-13 if angle > 1e-3 else 1e-12)


def test_rotation_by_pi_keeps_its_axis(rng):
    for axis in draw_axes(rng):
        found = rotation_vector_from_matrix(np.eye(3) + rodrigues_minus_identity(axis, np.pi))
        assert np.linalg.norm(found) == pytest.approx(np.pi, abs=1e-12)
        assert abs(found @ axis) == pytest.approx(np.pi, abs=1e-7)


def test_leading_axes_are_kept(rng):
    vectors = rng.standard_normal((2, 3, 4, 3))
    matrices = matrix_from_rotation_vector(vectors)
    assert matrices.shape == (2, 3, 4, 3, 3)
    np.testing.assert_array_equal(matrices[1, 2, 3], matrix_from_rotation_vector(vectors[1, 2, 3]))
    assert rotation_vector_from_matrix(matrices).shape == vectors.shape


def test_skew_matrix_is_the_cross_product(rng):
    left, right = rng.standard_normal((2, 5, 3))
    np.testing.assert_allclose(np.einsum("nij,nj->ni", skew_matrix(left), right), np.cross(left, right), atol=1e-15)


def test_pose_error_turns_the_estimate_into_the_truth(rng):
    position, estimate = rng.standard_normal((2, 7, 3))
    true_rotation, rotation = matrix_from_rotation_vector(rng.standard_normal((2, 7, 3)))
    error = compute_pose_error(position, true_rotation, estimate, rotation)
    np.testing.assert_allclose(estimate + error[:, :3], position, atol=1e-15)
    turned = matrix_from_rotation_vector(error[:, 3:]) @ rotation
    np.testing.assert_allclose(turned, true_rotation, atol=1e-14)
    swapped = rotation @ matrix_from_rotation_vector(error[:, 3:])
    assert np.abs(swapped - true_rotation).max() > 0.1  # the body-frame convention is another one


def random_bodies(rng):
    """Return base and platform poses with full covariances of some 0.05 mm and 1e-3 rad, all in a measurement frame."""
    bodies = []
    for position in ([30.0, -20.0, 50.0], [60.0, 10.0, 550.0]):
        root = rng.standard_normal((6, 6)) * np.array([0.02] * 3 + [5e-4] * 3)[:, None]
        rotation = matrix_from_rotation_vector(rng.standard_normal(3))
        bodies.append((np.array(position), rotation, root @ root.T))
    return bodies


def moved(body, error):
    """Return the true pose of a body whose estimate is in error."""
    position, rotation, covariance = body
    return position + error[..., :3], matrix_from_rotation_vector(error[..., 3:]) @ rotation, covariance


def test_relative_pose_composes_back(rng):
    base, platform = random_bodies(rng)
    position, rotation, _ = compute_relative_pose(base, platform)
    np.testing.assert_allclose(base[0] + base[1] @ position, platform[0], atol=1e-12)
    np.testing.assert_allclose(base[1] @ rotation, platform[1], atol=1e-14)


def test_relative_pose_covariance_matches_differences(rng):
    base, platform = random_bodies(rng)
    position, rotation, covariance = compute_relative_pose(base, platform)

    def error(x):
        found = compute_relative_pose(moved(base, x[:6]), moved(platform, x[6:]))
        return compute_pose_error(found[0], found[1], position, rotation)

    jacobian = machines.central_difference(error, np.zeros(12), np.array([*[1e-3] * 3, *[1e-5] * 3] * 2))
    joint = np.zeros((12, 12))
    joint[:6, :6], joint[6:, 6:] = base[2], platform[2]
    expected = jacobian @ joint @ jacobian.T
    scale = np.sqrt(np.outer(np.diag(expected), np.diag(expected)))
    np.testing.assert_allclose(covariance / scale, expected / scale, atol=1e-8)


def test_relative_pose_covariance_matches_simulation(rng):
    base, platform = random_bodies(rng)
    position, rotation, covariance = compute_relative_pose(base, platform)
    n = 40_000
    draws = [rng.multivariate_normal(np.zeros(6), body[2], n) for body in (base, platform)]
    tiled = [(np.broadcast_to(b[0], (n, 3)), np.broadcast_to(b[1], (n, 3, 3)), b[2]) for b in (base, platform)]
    found = compute_relative_pose(moved(tiled[0], draws[0]), moved(tiled[1], draws[1]))
    error = compute_pose_error(found[0], found[1], position, rotation)
    white = np.linalg.solve(np.linalg.cholesky(covariance), error.T)
    # entries of a sample covariance of n draws have standard errors sqrt(1/n), on the diagonal sqrt(2/n)
    deviation = (white @ white.T / n - np.eye(6)) * np.sqrt(n / (1 + np.eye(6)))
    assert np.abs(deviation).max() < 4.5
    without_base = np.linalg.cholesky(compute_relative_pose((*base[:2], np.zeros((6, 6))), platform)[2])
    wrong = np.linalg.solve(without_base, error.T)
    assert np.abs(wrong @ wrong.T / n - np.eye(6)).max() * np.sqrt(n / 2) > 100


@pytest.mark.parametrize("angle", [0.0, 1e-9, 1e-3, 0.029, 0.031, 1.0, 3.0, 6.0])
def test_left_jacobian_is_the_inverse_of_its_inverse(angle, rng):
    vector = angle * draw_axes(rng)
    product = compute_left_jacobian(vector) @ compute_left_inverse_jacobian(vector)
    np.testing.assert_allclose(product, np.broadcast_to(np.eye(3), product.shape), atol=1e-14)
