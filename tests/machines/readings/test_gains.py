"""Which parameter pages advise to free where a channel has a wrong scale."""

from __future__ import annotations

import machine_registry
import numpy as np
import pytest

from bayescal.machines.readings import place
from bayescal.machines.readings.gains import find_gains


@pytest.mark.parametrize("name", [*machine_registry.LEGS])
def test_of_legs_they_are_the_gains_of_the_actuators(name):
    legs = machine_registry.build_legs(name)
    expected = {f"rho[{leg}]": f"gain[{leg}]" for leg in range(1, 7)}
    assert find_gains(legs) == expected
    assert find_gains(place(legs, machine_registry.build_instruments(True))) == expected


def test_of_a_custom_machine_they_have_the_names_that_its_class_gave_them():
    assert find_gains(machine_registry.MACHINES["three_rps"]()) == {f"l[{k}]": f"gain[{k}]" for k in (1, 2, 3)}


def test_zeros_and_lengths_are_no_gains():
    assert find_gains(machine_registry.MACHINES["arm"]()) == {}
    assert find_gains(machine_registry.MACHINES["three slides"]()) == {}


def test_a_gain_moves_its_channel_in_proportion_to_the_travel():
    legs = machine_registry.build_legs("coupled").with_optional(["gain"])
    theta, pose = legs.layout.nominal.copy(), legs.home_pose + 1e-2 * np.arange(1.0, 7.0) * [1, 1, 1, 0.01, 0.01, 0.01]
    before = legs.read(theta, pose)
    theta[legs.layout.names.index(find_gains(legs)["rho[2]"])] = 1.25
    after = legs.read(theta, pose)
    start = legs.machine.mechanism.initial_actuator_positions[1]
    assert after[1] - start == pytest.approx((before[1] - start) / 1.25, rel=1e-9)
    np.testing.assert_array_equal(np.delete(after, 1), np.delete(before, 1))
