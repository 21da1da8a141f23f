"""Columns that repeat one another are named; plans, commands, rounded values and sensors that agree are not."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from bayescal.density.calibration.measurements import Measurements
from bayescal.errors import InputError
from bayescal.experiments.shared.readings.columns import check_columns, doubt_columns
from bayescal.files.csv_tables import WrittenColumn
from bayescal.machines.readings import Channel

CHANNELS = (Channel("m[1]", "mm", external=True), Channel("m[2]", "mm", external=True), Channel("q", "mm"))
MODEL = SimpleNamespace(channels=CHANNELS, commanded=("q",))
NOISE = 0.01


def measure(second, rng, n=12, commanded=None, digits=5, correlation=None):
    """Return readings of three channels, of which the second follows from the first."""
    first = np.round(rng.uniform(-50.0, 50.0, n), digits)
    values = np.stack([first, np.round(second(first), digits), first], axis=1)
    sd = np.full(values.shape, NOISE)
    poses = tuple(map(str, range(n)))
    return Measurements(poses, values, sd, {}, correlation, commanded)


def copy(first):
    return first


COPIES = {"same": copy, "in inches": lambda first: first / 25.4, "other zero": lambda first: 3.0 - first}


@pytest.mark.parametrize("what", COPIES)
def test_copies_are_named(what, rng):
    with pytest.raises(InputError, match="second_mm") as error:
        check_columns(measure(COPIES[what], rng), MODEL, {"m[2]": WrittenColumn("second_mm")})
    assert "second_mm" in str(error.value)
    assert "m_1_mm" in str(error.value)


def test_sensors_that_agree_within_their_noise_are_two(rng):
    check_columns(measure(lambda first: first + NOISE * rng.standard_normal(len(first)), rng), MODEL, {})


def test_noise_that_is_stated_twenty_times_too_large_makes_no_copy(rng):
    check_columns(measure(lambda first: first + NOISE / 20.0 * rng.standard_normal(len(first)), rng), MODEL, {})


def test_commands_may_be_equal(rng):
    check_columns(measure(copy, rng, commanded=np.tile([True, True, True], (12, 1))), MODEL, {})


def test_values_that_are_rounded_to_their_noise_may_be_equal(rng):
    check_columns(measure(copy, rng, digits=1), MODEL, {})


def test_few_rows_may_be_equal(rng):
    check_columns(measure(copy, rng, n=4), MODEL, {})


@pytest.mark.parametrize(("value", "n_said"), [(1.23456, 1), (1.2, 0), (0.0, 0)])
def test_constant_columns_are_no_copies_but_doubted(value, n_said, rng):
    """Where they have digits that noise would change: others are plans."""
    data = measure(lambda first: value + 0.0 * first, rng)
    check_columns(data, MODEL, {})
    said = doubt_columns(data, MODEL, {})
    assert len(said) == n_said
    assert all("m_2_mm" in one for one in said)


def test_own_channels_that_repeat_others_are_doubted_unless_they_are_commands(rng):
    own = SimpleNamespace(channels=(*CHANNELS[2:], Channel("p", "mm")), commanded=("q", "p"))
    read = measure(copy, rng)
    for commanded, n_said in ((None, 1), (np.full((12, 2), True), 0)):
        data = Measurements(read.poses, read.values[:, :2], read.sd[:, :2], {}, None, commanded)
        check_columns(data, own, {})
        assert len(doubt_columns(data, own, {})) == n_said


def test_noise_that_is_stated_as_common_is_not_missed(rng):
    both = np.array([[1.0, 0.9999, 0.0], [0.9999, 1.0, 0.0], [0.0, 0.0, 1.0]])
    small = NOISE * np.sqrt(2.0 * (1.0 - 0.9999))
    data = measure(
        lambda first: first + small * rng.standard_normal(len(first)), rng, correlation=np.tile(both, (12, 1, 1))
    )
    check_columns(data, MODEL, {})
