"""One contract for every fit of a rigid body to its targets; what is the line's alone, and least squares'."""

from __future__ import annotations

import re

import numpy as np
import pytest
import studies
from scipy.spatial.transform import Rotation

from bayescal.data.photogrammetry.line_fit import fit_line
from bayescal.data.photogrammetry.rigid_fit import fit_least_squares, fit_rigid_body
from bayescal.errors import InputError, PoseInputError
from bayescal.numerics.geometry import compute_pose_error

NOISE = 0.005
FITS = {"least squares": fit_least_squares, "line": fit_line, "robust": fit_rigid_body}


@pytest.fixture(params=FITS)
def fit_body(request):
    """Return a fit."""
    return FITS[request.param]


def draw_body(n_targets, rng):
    """Return targets on a long body, which every fit takes."""
    angle = rng.uniform(0, 2 * np.pi, n_targets)
    return np.stack([np.cos(angle), np.sin(angle), rng.uniform(0, 50, n_targets)], axis=-1)


def measure(reference, n_poses, noise, rng):
    """Return positions and rotations of a body, and its targets as measured."""
    rotation = Rotation.random(n_poses, rng=rng).as_matrix()
    position = rng.uniform(-500, 500, (n_poses, 3))
    measured = position[:, None] + reference @ rotation.swapaxes(-1, -2)
    return position, rotation, measured + noise * rng.standard_normal(measured.shape)


def simulate(n_targets, n_poses, noise, rng, shape="cylinder"):
    """Return targets on a long body or in a box, its poses, and the targets as measured."""
    reference = draw_body(n_targets, rng)
    if shape == "box":
        reference = rng.uniform(-100.0, 100.0, (n_targets, 3))
    return reference, *measure(reference, n_poses, noise, rng)


BODIES = [
    *((name, "cylinder", n) for name in FITS for n in (6, 12, 40)),
    *((name, "box", n) for name in ("least squares", "robust") for n in (3, 4, 12)),
]


@pytest.mark.parametrize(("name", "shape", "n_targets"), BODIES)
def test_exact_without_noise(name, shape, n_targets):
    reference, position, rotation, measured = simulate(n_targets, 50, 0.0, np.random.default_rng(1), shape)
    fit = FITS[name](reference, measured, NOISE)
    np.testing.assert_allclose(fit.position, position, atol=1e-8)
    np.testing.assert_allclose(fit.rotation, rotation, atol=1e-9)
    assert fit.converged.all()
    assert np.all(fit.chi2 < 1e-12)


@pytest.mark.parametrize(("name", "shape", "n_targets"), [one for one in BODIES if one[::2] != ("robust", 3)])
def test_errors_have_the_stated_covariance(name, shape, n_targets):
    """Normalised squares of the pose errors have the mean of χ² with six degrees of freedom."""
    n_poses, rng = 1000, np.random.default_rng(100 + n_targets)
    reference, position, rotation, measured = simulate(n_targets, n_poses, NOISE, rng, shape)
    fit = FITS[name](reference, measured, NOISE)
    error = compute_pose_error(position, rotation, fit.position, fit.rotation)
    square = np.einsum("pi,pij,pj->p", error, np.linalg.inv(fit.covariance), error)
    assert abs(square.mean() - 6) < 3.5 * np.sqrt(12 / n_poses)
    off = fit.chi2.mean() - fit.dof[0]
    assert (off if name == "line" else -abs(off)) >= -4 * np.sqrt(2 * fit.dof[0] / n_poses)
    assert fit.converged.mean() > 0.995


def test_unseen_targets_are_as_good_as_absent(fit_body):
    reference, _, _, measured = simulate(10, 3, NOISE, np.random.default_rng(4))
    keep = np.array([0, 1, 3, 4, 6, 7, 8, 9])
    expected = fit_body(reference[keep], measured[:, keep], NOISE)
    measured[:, 2] = np.nan
    measured[:, 5, 1] = np.nan  # one missing coordinate makes the target unseen
    fit = fit_body(reference, measured, NOISE)
    np.testing.assert_allclose(fit.position, expected.position, atol=1e-9)
    np.testing.assert_allclose(fit.rotation, expected.rotation, atol=1e-11)
    np.testing.assert_allclose(fit.covariance, expected.covariance, rtol=1e-6, atol=1e-15)
    np.testing.assert_allclose(fit.chi2, expected.chi2, rtol=1e-6)
    assert np.all(fit.weights[:, [2, 5]] == 0)
    assert np.all(fit.dof == 3 * 8 - 6)


def test_poses_are_fitted_independently_of_their_batch(fit_body):
    rng = np.random.default_rng(10)
    reference, _, _, measured = simulate(15, 6, NOISE, rng)
    measured[rng.random((6, 15)) < 0.2] = np.nan
    batch = fit_body(reference, measured.reshape(2, 3, 15, 3), NOISE)
    assert batch.covariance.shape == (2, 3, 6, 6)
    assert batch.weights.shape == (2, 3, 15)
    assert batch.chi2.shape == batch.dof.shape == (2, 3)
    for k in range(6):
        single = fit_body(reference, measured[k], NOISE)
        assert single.position.shape == (3,)
        assert single.converged.shape == ()
        np.testing.assert_allclose(single.rotation, batch.rotation[k // 3, k % 3], atol=1e-12)


def test_fit_follows_motions_of_both_frames(fit_body):
    rng = np.random.default_rng(5)
    reference, _, _, measured = simulate(10, 3, NOISE, rng)
    turn, shift = Rotation.random(rng=rng).as_matrix(), rng.uniform(-100, 100, 3)
    fit, moved = fit_body(reference, measured, NOISE), fit_body(reference, measured @ turn.T + shift, NOISE)
    np.testing.assert_allclose(moved.rotation, turn @ fit.rotation, atol=1e-9)
    np.testing.assert_allclose(moved.position, fit.position @ turn.T + shift, atol=1e-7)
    both = np.kron(np.eye(2), turn)
    np.testing.assert_allclose(moved.covariance, both @ fit.covariance @ both.T, rtol=1e-5, atol=1e-12)
    other = fit_body(reference @ turn.T + shift, measured, NOISE)  # another body frame
    np.testing.assert_allclose(other.rotation @ turn, fit.rotation, atol=1e-9)
    np.testing.assert_allclose(other.position + other.rotation @ shift, fit.position, atol=1e-7)


def test_what_is_no_fit_is_refused(fit_body):
    reference, _, _, measured = simulate(6, 2, NOISE, np.random.default_rng(12))
    two = measured.copy()
    two[1, 2:] = np.nan
    line = np.outer(np.linspace(0, 100, 6), [1.0, 2.0, 3.0])
    for given, seen, noise, match in (
        (reference, two, NOISE, "fit 1: found 2 seen targets, expected at least 3"),
        (reference, measured[:, :5], NOISE, r"expected \(\.\.\., 6, 3\)"),
        (reference, measured, 0.0, "noise"),
        (line, line, NOISE, "of a line"),
    ):
        with pytest.raises(InputError, match=match):
            fit_body(given, seen, noise)


# --- the line --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("unseen", [[], [2, 5]])
def test_covariance_of_the_line_agrees_with_central_differences(unseen):
    reference, _, _, measured = simulate(8, 1, NOISE, np.random.default_rng(3))
    measured[:, unseen] = np.nan
    fit = fit_line(reference, measured[0], NOISE)
    step = 1e-4 * np.eye(24).reshape(24, 8, 3)
    plus, minus = fit_line(reference, measured + step, NOISE), fit_line(reference, measured - step, NOISE)
    jacobian = compute_pose_error(plus.position, plus.rotation, minus.position, minus.rotation).T / 2e-4
    np.testing.assert_allclose(fit.covariance, NOISE**2 * jacobian @ jacobian.T, rtol=1e-4, atol=1e-11)


def test_a_wrong_target_moves_the_line_but_not_the_robust_fit():
    reference, position, rotation, measured = simulate(12, 1, NOISE, np.random.default_rng(6))
    measured[0, 4] += [0.0, 1000.0, 0.0]
    barycentre = reference.mean(axis=0)
    for fit_pose, moved in ((fit_line, True), (fit_rigid_body, False)):
        fit = fit_pose(reference, measured, NOISE)
        shift = np.linalg.norm(fit.position + fit.rotation @ barycentre - position - rotation @ barycentre)
        assert bool(shift > 1.0) is moved
        assert shift < 0.02 or moved


def test_what_has_no_line_is_refused():
    line = np.outer(np.linspace(0, 50, 6), [0.0, 0.0, 1.0])
    cube = np.array([[x, y, z] for x in (-1.0, 1.0) for y in (-1.0, 1.0) for z in (-1.0, 1.0)])
    with pytest.raises(InputError, match="longer than"):
        fit_line(cube, cube, NOISE)
    with pytest.raises(InputError, match="farther"):
        fit_line(*[line + 0.035 * np.tile([[1, 0, 0], [-1, 0, 0]], (3, 1))] * 2, NOISE)


# --- least squares ---------------------------------------------------------------------------------------------------


def test_least_squares_that_are_refused_name_the_noise_stated_and_seen(rng):
    reference, _, _, measured = simulate(3, 5, NOISE, rng, "box")
    measured[3] += 0.5 * rng.standard_normal((3, 3))
    with pytest.raises(PoseInputError, match=r"5 µm, noise seen \d+ µm") as caught:
        fit_least_squares(reference, measured, NOISE)
    assert caught.value.index == 3
    seen = float(re.search(r"noise seen (\d+)", str(caught.value))[1])
    assert 50.0 < seen < 1500.0


def test_a_study_takes_least_squares_and_names_the_pose_it_refuses(tmp_path):
    config = studies.write_tiny_study(tmp_path)
    studies.edit(config, "target_noise_um = 3.0", 'target_noise_um = 3.0\npose_estimator = "least_squares"')
    robust = studies.write_tiny_study(tmp_path / "robust")
    plain, other = (studies.load_study(one).measured[0].poses for one in (config, robust))
    sd = np.sqrt(np.diagonal(plain.covariance, axis1=1, axis2=2))[:, :3]
    assert (np.abs(plain.position - other.position) < 2.0 * sd).all()
    assert (sd < np.sqrt(np.diagonal(other.covariance, axis1=1, axis2=2))[:, :3]).all()
    studies.edit(config, "target_noise_um = 3.0", "target_noise_um = 0.3")
    with pytest.raises(InputError, match=r"pose 'C\d+': base: .* stated 0\.3 µm.* seen "):
        studies.load_study(config)
