"""The robust pose: its efficiency, its transform against SciPy, unmoved by wrong targets; see `test_fit_contract`."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.spatial.transform import Rotation
from test_fit_contract import NOISE, draw_body, measure

from bayescal.data.photogrammetry.rigid_fit import (
    TUNING_CONSTANT,
    compute_efficiency,
    compute_variance_factor,
    fit_rigid_body,
    weighted_rigid_transform,
)
from bayescal.errors import InputError
from bayescal.numerics.geometry import compute_pose_error


def whiten(error, covariance):
    return np.einsum("pi,pij,pj->p", error, np.linalg.inv(covariance), error)


def distance_between(fit, other):
    """Return the difference of two fits in units of the sd of the second."""
    error = compute_pose_error(fit.position, fit.rotation, other.position, other.rotation)
    return np.sqrt(whiten(np.atleast_2d(error), other.covariance.reshape(-1, 6, 6)))


def integrate_efficiency(c):
    """Return (E[w + r w'/3])² / (E[w² r²] / 3) over the Maxwell density of r, by quadrature."""

    def density(r):
        return np.sqrt(2 / np.pi) * r**2 * np.exp(-(r**2) / 2)

    def weight(r):
        return (1 - (r / c) ** 2) ** 2

    def derivative(r):
        return -4 * r / c**2 * (1 - (r / c) ** 2)

    slope = quad(lambda r: (weight(r) + r * derivative(r) / 3) * density(r), 0, c, epsabs=1e-13)[0]
    variance = quad(lambda r: weight(r) ** 2 * r**2 / 3 * density(r), 0, c, epsabs=1e-13)[0]
    return slope**2 / variance


@pytest.mark.parametrize("constant", [2.0, 4.685, TUNING_CONSTANT, 9.0])
def test_efficiency_agrees_with_quadrature(constant):
    assert compute_efficiency(constant) == pytest.approx(integrate_efficiency(constant), rel=1e-9)


def test_tuning_constant_gives_95_percent():
    assert integrate_efficiency(TUNING_CONSTANT) == pytest.approx(0.95, abs=1e-10)


def test_variance_factor_tends_to_the_asymptotic_one():
    assert compute_variance_factor(10**7) == pytest.approx(1 / 0.95, rel=1e-6)
    assert 1.0 < compute_variance_factor(6) < compute_variance_factor(12) < 1 / 0.95


def test_weighted_transform_agrees_with_scipy():
    rng = np.random.default_rng(2)
    reference = rng.uniform(-100, 100, (9, 3))
    _, _, measured = measure(reference, 5, 5.0, rng)
    weights = rng.uniform(0.1, 1, (5, 9))
    position, rotation = weighted_rigid_transform(reference, measured, weights)
    for k in range(5):
        mean_r = np.average(reference, axis=0, weights=weights[k])
        mean_m = np.average(measured[k], axis=0, weights=weights[k])
        expected = Rotation.align_vectors(measured[k] - mean_m, reference - mean_r, weights=weights[k])[0].as_matrix()
        np.testing.assert_allclose(rotation[k], expected, atol=1e-12)
        np.testing.assert_allclose(position[k], mean_m - expected @ mean_r, atol=1e-9)


def test_planar_and_mirrored_targets_give_a_proper_rotation():
    rng = np.random.default_rng(3)
    flat = np.c_[rng.uniform(-100, 100, (8, 2)), np.zeros(8)]
    _, rotation, measured = measure(flat, 50, 0.0, rng)
    np.testing.assert_allclose(fit_rigid_body(flat, measured, NOISE).rotation, rotation, atol=1e-12)
    solid = rng.uniform(-100, 100, (8, 3))
    mirrored = weighted_rigid_transform(solid, solid * [1, 1, -1], np.ones(8))[1]
    assert np.linalg.det(mirrored) == pytest.approx(1.0)


@pytest.mark.parametrize("n_targets", [6, 7, 12, 84])
@pytest.mark.parametrize("size", [0.2, 1000.0])
@pytest.mark.parametrize("together", [False, True])
def test_wrong_targets_do_not_move_the_pose(n_targets, size, together):
    rng = np.random.default_rng(7)
    reference = rng.uniform(-100, 100, (n_targets, 3)) if n_targets == 84 else draw_body(n_targets, rng)
    n_wrong = -(-n_targets // 3) - 1
    _, _, measured = measure(reference, 40, NOISE, rng)
    wrong = np.argsort(rng.random((40, n_targets)), axis=1)[:, :n_wrong]
    shift = rng.standard_normal((40, 1 if together else n_wrong, 3))
    shift *= size / np.linalg.norm(shift, axis=-1, keepdims=True)
    corrupt, without = measured.copy(), measured.copy()
    row = np.arange(40)[:, None]
    corrupt[row, wrong] += shift
    without[row, wrong] = np.nan
    fit, clean = fit_rigid_body(reference, corrupt, NOISE), fit_rigid_body(reference, without, NOISE)
    assert np.max(distance_between(fit, clean)) < 1.0
    assert np.median(distance_between(fit, clean)) < 1e-6
    assert np.mean(fit.weights[row, wrong] == 0) > 0.99


def test_least_squares_does_move_with_a_wrong_target():
    rng = np.random.default_rng(8)
    reference = draw_body(12, rng)
    _, _, measured = measure(reference, 1, NOISE, rng)
    clean = fit_rigid_body(reference, measured, NOISE)
    measured[0, 3, 0] += 1000.0
    position, rotation = weighted_rigid_transform(reference, measured, np.ones((1, 12)))
    error = compute_pose_error(position, rotation, clean.position, clean.rotation)
    assert np.sqrt(whiten(error, clean.covariance))[0] > 1e3


def test_targets_that_contradict_each_other_are_refused(rng):
    with pytest.raises(InputError, match="consistent"):
        fit_rigid_body(*rng.uniform(-100, 100, (2, 6, 3)), NOISE)
