"""A shift of all measured poses is told where no drawing is that wrong, and nowhere else."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import telescope_machines as machines

from bayescal.experiments.study.doubts import doubt_zero, find_shift, measure_size

SHIFT = np.array([0.0, -3.0, 110.0])


def make_inputs(poses, seen=True):
    """Return inputs as far as doubts read them: legs that an instrument saw in a known frame, or in one of its own."""
    likelihood = machines.build_posterior("none", poses).likelihood
    model = likelihood.model if seen else likelihood.model.pick(np.arange(6))
    data = replace(likelihood.data, values=likelihood.data.values[:, : len(model.names)])
    return SimpleNamespace(variants={"none": SimpleNamespace(whole=model, model=model, data=data)})


def test_a_zero_that_is_another_is_told_with_its_likely_cause(twin):
    poses = replace(twin, position=twin.position + SHIFT)
    (said,) = doubt_zero(make_inputs(poses))
    assert "110 mm" in said
    assert "frame offset" in said
    before, after = (find_shift(machines.build_machine("none"), p.position, p.actuators) for p in (twin, poses))
    np.testing.assert_allclose(after[0] - before[0], SHIFT, atol=1e-9)
    assert after[1] == pytest.approx(before[1])


def test_machines_off_by_what_drawings_are_off_by_are_no_doubt(twin):
    size = measure_size(machines.build_machine("none").mechanism)
    assert 100.0 < size < 200.0
    for shift in (np.zeros(3), np.array([0.0, 0.0, 0.02 * size])):
        assert doubt_zero(make_inputs(replace(twin, position=twin.position + shift))) == []


def test_scattered_poses_and_unknown_frames_are_no_doubt(twin, rng):
    apart = replace(twin, position=twin.position + rng.normal(0.0, 50.0, twin.position.shape))
    assert doubt_zero(make_inputs(apart)) == []
    shifted = replace(twin, position=twin.position + SHIFT)
    assert doubt_zero(make_inputs(shifted, seen=False)) == []
    lost = replace(twin, position=twin.position * np.nan)
    assert doubt_zero(make_inputs(lost)) == []
