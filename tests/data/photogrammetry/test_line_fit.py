"""The pose from the line through the targets: its covariance, and that it is not robust."""

from __future__ import annotations

import numpy as np
import pytest
from test_fit_contract import NOISE, simulate

from bayescal.data.photogrammetry.line_fit import fit_line
from bayescal.data.photogrammetry.rigid_fit import fit_rigid_body
from bayescal.errors import InputError
from bayescal.numerics.geometry import compute_pose_error


@pytest.mark.parametrize("unseen", [[], [2, 5]])
def test_covariance_agrees_with_central_differences(unseen):
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


def test_input_errors():
    line = np.outer(np.linspace(0, 50, 6), [0.0, 0.0, 1.0])
    cube = np.array([[x, y, z] for x in (-1.0, 1.0) for y in (-1.0, 1.0) for z in (-1.0, 1.0)])
    with pytest.raises(InputError, match="elongated"):
        fit_line(cube, cube, NOISE)
    with pytest.raises(InputError, match="farther"):
        fit_line(*[line + 0.035 * np.tile([[1, 0, 0], [-1, 0, 0]], (3, 1))] * 2, NOISE)
