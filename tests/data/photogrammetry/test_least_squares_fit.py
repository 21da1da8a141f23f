"""Plain least squares of targets: what it refuses names the noise, and studies take it; see `test_fit_contract`."""

import re

import numpy as np
import pytest
import studies

from bayescal.data.photogrammetry.rigid_fit import fit_least_squares
from bayescal.errors import InputError, PoseInputError
from bayescal.numerics.geometry import matrix_from_rotation_vector

NOISE = 3e-3
CORNERS = np.array([[100.0, 0.0, 0.0], [-50.0, 80.0, 10.0], [-60.0, -70.0, -20.0]])


def see(reference, n, rng, noise=NOISE):
    rotation = matrix_from_rotation_vector(rng.uniform(-1.0, 1.0, (n, 3)))
    measured = rng.uniform(-1e3, 1e3, (n, 1, 3)) + reference @ np.swapaxes(rotation, -1, -2)
    return measured + rng.normal(0.0, noise, measured.shape)


def test_what_is_refused_names_the_noise_stated_and_seen(rng):
    measured = see(CORNERS, 5, rng)
    measured[3:4] = see(CORNERS, 1, rng, 0.5)
    with pytest.raises(PoseInputError, match=r"noise stated 3 µm, noise seen \d+ µm") as caught:
        fit_least_squares(CORNERS, measured, NOISE)
    assert caught.value.index == 3
    seen = float(re.search(r"noise seen (\d+)", str(caught.value))[1])
    assert 50.0 < seen < 1500.0


def test_a_study_takes_least_squares_and_names_the_pose_it_refuses(tmp_path):
    config = studies.write_tiny_study(tmp_path)
    studies.edit(config, "target_noise_um = 3.0", 'target_noise_um = 3.0\npose_method = "least_squares"')
    robust = studies.write_tiny_study(tmp_path / "robust")
    plain, other = (studies.load_study(one).seen.measured.poses for one in (config, robust))
    sd = np.sqrt(np.diagonal(plain.covariance, axis1=1, axis2=2))[:, :3]
    assert (np.abs(plain.position - other.position) < 2.0 * sd).all()
    assert (sd < np.sqrt(np.diagonal(other.covariance, axis1=1, axis2=2))[:, :3]).all()
    studies.edit(config, "target_noise_um = 3.0", "target_noise_um = 0.3")
    with pytest.raises(InputError, match=r"pose 'C\d+': base: found residuals .* noise stated 0\.3 µm, noise seen "):
        studies.load_study(config)
