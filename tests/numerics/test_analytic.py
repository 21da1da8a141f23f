"""Functions that a complex step can go through."""

from __future__ import annotations

import numpy as np
import pytest

from bayescal.numerics.analytic import absolute, atan2, norm, rotation_matrix, rotation_vector
from bayescal.numerics.geometry import matrix_from_rotation_vector

H = 1e-30


def test_on_the_reals_they_are_numpys(rng):
    x, y = rng.standard_normal((2, 50))
    np.testing.assert_allclose(norm(np.stack([x, y], axis=-1)), np.hypot(x, y), rtol=1e-15)
    np.testing.assert_allclose(norm(np.stack([x, y]), axis=0), np.hypot(x, y), rtol=1e-15)
    np.testing.assert_array_equal(absolute(x), np.abs(x))
    np.testing.assert_array_equal(atan2(y, x), np.arctan2(y, x))
    assert not np.iscomplexobj(atan2(y, x))


@pytest.mark.parametrize(("y", "x"), [(0.0, -1.0), (-0.0, -1.0), (1.0, 0.0), (-1.0, 0.0), (0.0, 0.0)])
def test_angles_on_the_axes_are_numpys(y, x):
    assert atan2(y, x) == np.arctan2(y, x)
    if x or y:
        assert atan2(complex(y, 0.0), complex(x, 0.0)).real == np.arctan2(y, x)


def test_derivatives(rng):
    x, y = rng.standard_normal((2, 50))
    length = np.hypot(x, y)
    np.testing.assert_allclose(norm(np.stack([x + 1j * H, y + 0j], axis=-1)).imag / H, x / length, rtol=1e-13)
    np.testing.assert_allclose(absolute(x + 1j * H).imag / H, np.sign(x))
    np.testing.assert_allclose(atan2(y + 1j * H, x).imag / H, x / length**2, rtol=1e-13)
    np.testing.assert_allclose(atan2(y, x + 1j * H).imag / H, -y / length**2, rtol=1e-13)
    both = atan2(y + 1j * H, x + 2j * H).imag / H
    np.testing.assert_allclose(both, (x - 2.0 * y) / length**2, rtol=1e-9, atol=1e-12)


def test_an_angle_takes_any_leading_axes(rng):
    y, x = rng.standard_normal((4, 1, 3)), rng.standard_normal((5, 3))
    assert atan2(y + 0j, x).shape == (4, 5, 3)


@pytest.mark.parametrize("angle", [1e-12, 1e-3, 1.0, 3.0, np.pi - 1e-6])
def test_rotations_take_complex_steps(angle, rng):
    """Both ways, a series in closed form against each other: from vectors to matrices and back."""
    vector = rng.standard_normal((5, 3))
    vector *= angle / np.linalg.norm(vector, axis=1, keepdims=True)
    moved = vector[:, None] + 1j * H * np.eye(3)
    series, closed = rotation_matrix(moved), matrix_from_rotation_vector(moved)
    np.testing.assert_allclose(closed.real, series.real, rtol=0, atol=1e-14)
    np.testing.assert_allclose(closed.imag / H, series.imag / H, rtol=0, atol=1e-9)
    back = rotation_vector(series)
    np.testing.assert_allclose(back.real, np.broadcast_to(vector[:, None], back.shape), rtol=0, atol=1e-9)
    np.testing.assert_allclose(back.imag / H, np.broadcast_to(np.eye(3), back.shape), rtol=0, atol=1e-9)
    assert np.isnan(rotation_vector(np.full((2, 3, 3), np.nan))).all()
    assert np.isnan(rotation_vector(rotation_matrix(np.array([90.0, 40.0, 1.0])))).all()  # far beyond half a turn
