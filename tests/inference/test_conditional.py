"""Geometry that is normal given the errors, functions of the pose among them: how good its proposal is."""

import numpy as np
import pytest
import telescope_machines as machines

from bayescal.density.calibration.terms import Errors
from bayescal.density.priors import NormalPrior
from bayescal.density.sorts import SORTS
from bayescal.inference.exploration import explore

N_POSES = 12


@pytest.fixture(scope="module")
def posterior():
    """Return a telescope whose joints, lengths and four sorts of functions are unknown."""
    machine = machines.build_machine("none")
    theta, rng = machines.telescope_truth(machine), np.random.default_rng(1)
    actuators = machines.table_3_actuators()[:N_POSES]
    found = machines.simulate_poses(machine, theta, actuators, np.full(6, 5e-3), rng)
    priors = {
        name: NormalPrior(value, 0.3)
        for name, value in zip(machine.layout.names, machine.layout.nominal, strict=True)
        if name.startswith(("b_x", "b_y", "l"))
    }
    functions = machines.let_functions_err(machine, found, tuple(SORTS))
    return machines.measure(
        machine, found, priors, Errors((*machines.let_err(shared=True).terms, *functions))
    ).anchored()


def test_proposal_needs_no_sharpening(posterior):
    found = explore(posterior, np.random.SeedSequence(4))
    assert found.straight.conditional is not None
    assert found.efficiency > 0.2  # 0.4; with fixed axes 0.08
