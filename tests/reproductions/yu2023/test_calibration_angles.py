"""Yu's angles: the printed matrix, and pose selection's rates against differences of them."""

from __future__ import annotations

import hexapod_settings  # noqa: F401  # imports the paper's modules
import numpy as np

from bayescal.numerics.geometry import matrix_from_rotation_vector
from bayescal.pose_selection.observability import angle_rates
from yu2023.least_squares import coordinates_from_pose, pose_from_coordinates


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


def test_rates_match_differences():
    q = np.random.default_rng(1).uniform(-0.5, 0.5, (7, 6))
    position, rotation = pose_from_coordinates(q)
    rates = angle_rates(rotation)
    for k in range(3):
        step = 1e-6 * np.eye(3)[k]
        ahead = coordinates_from_pose(position, matrix_from_rotation_vector(np.tile(step, (7, 1))) @ rotation)
        behind = coordinates_from_pose(position, matrix_from_rotation_vector(np.tile(-step, (7, 1))) @ rotation)
        np.testing.assert_allclose(rates[..., k], (ahead - behind)[:, 3:] / 2e-6, atol=1e-9)
