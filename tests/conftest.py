"""Fixtures shared by the tests: a telescope's data set and a stream of random numbers per test."""

from __future__ import annotations

import machines
import numpy as np
import pytest


@pytest.fixture
def rng() -> np.random.Generator:
    """Return the same stream of random numbers to every test."""
    return np.random.default_rng(8096)


@pytest.fixture(scope="session")
def twin():
    """Return the telescope's twin: 40 poses simulated from table 7 (a) with K, no model error."""
    machine = machines.build_machine("matrix")
    truth = machines.telescope_truth(machine)
    rng = np.random.default_rng(7)
    return machines.simulate_poses(machine, truth, machines.table_3_actuators(), np.zeros(6), rng)
