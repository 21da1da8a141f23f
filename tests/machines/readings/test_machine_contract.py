"""One contract for every machine that sensors see, alone and with instruments beside it."""

from __future__ import annotations

from dataclasses import replace

import machine_registry
import numpy as np
import pytest

from bayescal.machines.readings import place

STEP = 1e-4  # of a coordinate's or parameter's size, of central differences of the fourth order
FOURTH = {2: -1.0 / 12.0, 1: 2.0 / 3.0, -1: -2.0 / 3.0, -2: 1.0 / 12.0}


@pytest.fixture(scope="module", params=machine_registry.CASES)
def model(request):
    """Return a machine, or one that is seen by an instrument of each kind."""
    name, _, seen = request.param.partition(", ")
    machine = machine_registry.MACHINES[name]()
    if not seen:
        return machine
    return place(machine, machine_registry.build_instruments(name in machine_registry.TURNING))


def differ(function, point, steps):
    """Return the derivatives by the last axis of a point, by central differences of the fourth order.

    The function takes all moved points at once, (4, K, ...) for K entries.
    """
    moves = np.array(list(FOURTH))[:, None, None] * np.diag(steps)
    values = function(point + moves.reshape(*moves.shape[:2], *[1] * (point.ndim - 1), len(steps)))
    summed = np.einsum("f,fk...->k...", list(FOURTH.values()), values)
    return np.moveaxis(summed, 0, -1) / steps


def assert_alike(found, expected, steps):
    """Compare derivatives with those by differences: to 1e-7 of a channel's largest change by a step, and rounding."""
    change = np.abs(expected) * steps
    bound = 1e-7 * change.max(axis=-1, keepdims=True) + 1e-10
    assert (np.abs(found - expected) * steps <= bound).all()


def test_derivatives_are_those_of_differences(model, rng):
    theta, pose, given = machine_registry.draw(model, rng)
    found = model.linearise(theta, pose, True, given)
    np.testing.assert_allclose(found.values, model.read(theta, pose, given), rtol=1e-13, atol=1e-10)
    assert np.isfinite(found.values).all()
    steps = STEP * np.minimum(model.pose_scale, 100.0)
    assert_alike(found.by_pose, differ(lambda v: model.read(theta, v, given), pose, steps), steps)
    steps = STEP * machine_registry.sizes_of(model)
    assert_alike(found.by_parameters, differ(lambda d: model.read(d, pose, given), theta, steps), steps)
    alone = model.linearise(theta, pose, False, given)
    np.testing.assert_allclose(alone.values, found.values, rtol=1e-13, atol=1e-10)
    np.testing.assert_allclose(alone.by_pose, found.by_pose, rtol=1e-9, atol=1e-12)
    assert alone.by_parameters.size == 0


def test_what_has_to_be_accurate_and_what_moves_it(model, rng):
    theta, pose, _ = machine_registry.draw(model, rng)
    place, by_pose, by_parameters = model.tool(theta, pose)
    assert place.shape[-1] == len(model.tool_channels)
    np.testing.assert_allclose(place, model.tool_values(theta, pose), rtol=1e-14, atol=1e-12)
    steps = STEP * np.minimum(model.pose_scale, 100.0)
    assert_alike(by_pose, differ(lambda v: model.tool_values(theta, v), pose, steps), steps)
    steps = STEP * machine_registry.sizes_of(model)
    assert_alike(by_parameters, differ(lambda d: model.tool_values(d, pose), theta, steps), steps)


def test_machines_and_poses_in_batches(model, rng):
    theta, pose, given = machine_registry.draw(model, rng)
    some = {name: one[None, :3] for name, one in given.items()}
    found = model.linearise(theta[:, None], pose[None, :3], True, some)
    n, q, size = len(model.channels), pose.shape[1], theta.shape[1]
    assert found.values.shape == (len(theta), 3, n)
    assert found.by_pose.shape == (len(theta), 3, n, q)
    assert found.by_parameters.shape == (len(theta), 3, n, size)
    np.testing.assert_array_equal(model.read(theta[:, None], pose[None, :3], some).shape, found.values.shape)
    alone = model.linearise(theta[2], pose[1], True, {name: one[1] for name, one in given.items()})
    for one, other in zip(vars(found).values(), vars(alone).values(), strict=True):
        np.testing.assert_allclose(one[2, 1], other, rtol=1e-9, atol=1e-9)


def test_some_channels_read_what_they_read_among_all(model, rng):
    """Once, and picked again; their parameters stay those of the machine."""
    theta, pose, given = machine_registry.draw(model, rng)
    whole, n = model.linearise(theta, pose, True, given), len(model.channels)
    for some in (list(range(0, n, 2)), sorted({n // 2, n - 1}), list(range(max(2, n // 2)))):
        once = model.pick(np.array(some))
        for few, places in ((once, some), (once.pick(np.array([-1])), some[-1:])):
            assert few.names == tuple(model.names[k] for k in places)
            assert few.layout.names == model.layout.names
            found = few.linearise(theta, pose, True, given)
            for one, other in zip(vars(found).values(), vars(whole.pick(np.array(places))).values(), strict=True):
                np.testing.assert_allclose(one, other, rtol=1e-12, atol=1e-12)
            np.testing.assert_allclose(few.read(theta, pose, given), found.values, rtol=1e-13, atol=1e-10)
            alone = few.linearise(theta, pose, False, given)
            np.testing.assert_allclose(alone.by_pose, found.by_pose, rtol=1e-9, atol=1e-12)
            assert few.seen_parameters(few.names) == model.seen_parameters(few.names)


def test_a_channel_depends_on_no_parameter_that_it_does_not_see(model, rng):
    theta, pose, given = machine_registry.draw(model, rng)
    slopes = np.abs(model.linearise(theta, pose, True, given).by_parameters).max(axis=0)
    for name, row in zip(model.names, slopes, strict=True):
        moved = {model.layout.names[k] for k in np.flatnonzero(row)}
        assert moved <= set(model.seen_parameters([name])), name


def test_commands_lead_to_the_pose_that_they_were_read_at(model, rng):
    theta, pose, given = machine_registry.draw(model, rng, size=0.1)
    theta = theta[:1]
    commands = model.read(theta, pose, given)[..., model.select(model.commanded)]
    if len(model.coordinates) <= len(model.commanded):
        found, there = model.locate(theta, commands, given)
        assert there.all()
        np.testing.assert_allclose(found / model.pose_scale, pose / model.pose_scale, rtol=0, atol=1e-8)
    near = theta + 1e-3 * machine_registry.sizes_of(model) * rng.standard_normal((3, theta.shape[1]))
    several = {name: one[None] for name, one in given.items()}
    other = np.moveaxis(model.read(near[:, None], pose, several)[..., model.select(model.commanded)] - commands, 0, -1)
    found = model.respond(np.concatenate([theta, near]), theta[0], pose, commands, given)
    np.testing.assert_allclose(found[..., 0], 0.0, atol=1e-9)
    np.testing.assert_allclose(found[..., 1:], other, rtol=0, atol=1e-3 * np.abs(other).max())


def test_home_is_reached_and_nothing_far_away_is(model):
    given = {name: np.full(2, 11.0) for name in model.given}
    far = [50.0 * (one.reach or 100.0) if one.unit == "mm" else 0.0 for one in model.coordinates]
    pose = model.home_pose + np.array([[0.0], [1.0]]) * far
    commands = model.read(model.layout.nominal, pose, given)[:, model.select(model.commanded)]
    home, away = model.find_faults(model.layout.nominal, pose, commands, given)
    assert home == ""
    assert away or not np.isfinite(model.command_range).any()


def test_names_and_units_belong_together(model):
    layout = model.layout
    for names in (layout.names, model.names, [one.name for one in model.coordinates]):
        assert len(set(names)) == len(names) > 0 or not model.coordinates
    assert len(layout.units) == layout.size == len(layout.nominal)
    assert layout.inside(layout.nominal)
    assert set(model.commanded) <= set(model.names)
    assert model.command_range.shape == (len(model.commanded), 2)
    assert set(model.seen_parameters(model.names)) <= set(layout.names)
    assert model.home_pose.shape == model.pose_scale.shape == (len(model.coordinates),)
    assert replace(model).names == model.names
