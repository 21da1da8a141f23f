"""A hexapod under its weight: statics against virtual work, expansion and displaced bases against symmetry."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from bayescal.errors import InputError
from bayescal.machines.read import read_reading_model
from bayescal.numerics.geometry import matrix_from_rotation_vector

MACHINE = Path(__file__).parents[2] / "experiments" / "m2_hexapod_table" / "machine.toml"
WEIGHT = 1500.0 * 9.80665
REFERENCE, CENTRE = 10.0, np.array([0.0, 0.0, 1000.0])


@pytest.fixture(scope="module")
def model():
    return read_reading_model(MACHINE)


@pytest.fixture
def poses(model):
    rng = np.random.default_rng(3)
    middle, reach = (np.array([getattr(one, key) for one in model.coordinates]) for key in ("home", "reach"))
    return middle + rng.uniform(-1.0, 1.0, (5, 6)) * reach


def change(model, **values):
    theta = model.layout.nominal.copy()
    for symbol, value in values.items():
        theta[model.layout.index[symbol]] = value
    return theta


def give(elevation, temperature):
    return {"elevation_deg": np.array(elevation), "temperature_c": np.array(temperature)}


def read(model, theta, pose, elevation=90.0, temperature=REFERENCE):
    return model.read(theta, pose, give(elevation, temperature))[..., :6]


@pytest.mark.parametrize("elevation", [0.0, 37.0, 90.0])
def test_tensions_do_the_work_of_the_weight(model, poses, elevation):
    """Σ t ∂l/∂v is the weight's work W g·∂(p + R g_c)/∂v: what holds the platform does no work with it."""
    rigid, soft = (change(model, c=value) for value in (1e-12, 10.0))
    tension = -(read(model, soft, poses, elevation) - read(model, rigid, poses, elevation)) / (10.0 * 1e-6)
    rad = np.deg2rad(elevation)
    down = WEIGHT * np.array([0.0, -np.cos(rad), -np.sin(rad)])

    def place(pose):
        return (pose[:, :3] + matrix_from_rotation_vector(pose[:, 3:]) @ CENTRE) @ down

    for k, step in enumerate([1e-2] * 3 + [1e-5] * 3):
        move = step * np.eye(6)[k]
        longer = read(model, rigid, poses + move, elevation) - read(model, rigid, poses - move, elevation)
        work = place(poses + move) - place(poses - move)
        np.testing.assert_allclose((tension * longer).sum(axis=1), work, rtol=1e-5, atol=1e-6 * WEIGHT * step)


def test_a_machine_that_grows_evenly_needs_no_correction(model, poses):
    """All of one expansion, a pose that grows with it: the actuators' scales grow as well."""
    theta = change(model, c=1e-12, e_s=20.0, e_b=20.0, e_p=20.0)
    warmer = poses.copy()
    warmer[:, :3] *= 1.0 + 20e-6 * 30.0
    np.testing.assert_allclose(
        read(model, theta, warmer, temperature=REFERENCE + 30.0), read(model, theta, poses), rtol=0.0, atol=1e-9
    )
    assert np.abs(read(model, theta, poses, temperature=40.0) - read(model, theta, poses)).max() > 0.1


@pytest.mark.parametrize(
    ("symbol", "value", "place"),
    [("sag_y", 0.2, (0.0, 10.0)), ("lift_y", 0.2, (0.0, 10.0)), ("drift_y", 10.0, (90.0, 30.0))],
)
def test_the_platform_goes_where_its_base_goes(model, poses, symbol, value, place):
    moved, plain = change(model, **{symbol: value}), change(model)
    shifted = poses + 0.2 * np.eye(6)[1]
    np.testing.assert_allclose(read(model, moved, shifted, *place), read(model, plain, poses, *place), atol=1e-9)
    np.testing.assert_array_equal(read(model, moved, poses), read(model, plain, poses))


@pytest.mark.parametrize(
    ("elevation", "temperature", "free", "words"),
    [
        ([0.2, 1.5], [0.0, 9.0], (), "found none above 1.5, expected degrees"),
        ([20.0, 91.0], [0.0, 9.0], (), "pose 'two': elevation_deg: found 91"),
        ([-3.0, 80.0], [0.0, 9.0], (), "pose 'one': elevation_deg: found -3"),
        ([20.0, 80.0], [280.0, 290.0], (), "kelvins perhaps"),
        (
            [20.0, 80.0],
            [9.0, 9.0],
            ("l[1]", "e_s"),
            "temperature_c: found 9 at every pose, expected several values, or e_s fixed",
        ),
        ([20.0, 20.0], [0.0, 9.0], ("c[2]",), "elevation_deg: found 20 at every pose"),
    ],
)
def test_data_that_cannot_be_or_do_not_tell_are_refused(model, elevation, temperature, free, words):
    with pytest.raises(InputError) as caught:
        model.check_given(["one", "two"], give(elevation, temperature), free)
    assert words in str(caught.value)
    assert "expected" in str(caught.value)


def test_data_that_tell_are_taken(model):
    model.check_given(["one", "two"], give([20.0, 80.0], [9.0, 9.0]), ["l[1]", "c[1]", "b_x[1]"])
    model.check_given(["one", "two"], give([20.0, 20.0], [9.0, 0.0]), ["e_s", "drift_x", "l[1]"])


def test_gravity_points_two_ways_at_right_angles(tmp_path):
    text = MACHINE.read_text().replace("down_at_horizon = [0.0, -1.0, 0.0]", "down_at_horizon = [0.0, -1.0, 0.2]")
    (tmp_path / "machine.toml").write_text(text)
    with pytest.raises(InputError, match=r"101\.3.*down_at_zenith, expected 90"):
        read_reading_model(tmp_path / "machine.toml")
