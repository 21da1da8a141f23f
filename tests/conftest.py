"""Fixtures shared by the tests: a telescope's data set and a stream of random numbers per test."""

from __future__ import annotations

import sys

import numpy as np
import pytest
import telescope_machines as machines

from bayescal import cli


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


@pytest.fixture
def call(monkeypatch, capsys):
    """Return a function that calls the command line in this process: exit code, standard output, standard error."""

    def call_main(*arguments: object) -> tuple[int, str, str]:
        monkeypatch.setattr(sys, "argv", ["bayescal", *map(str, arguments)])
        capsys.readouterr()
        with pytest.raises(SystemExit) as exit_info:
            cli.main()
        return int(exit_info.value.code or 0), *capsys.readouterr()

    return call_main
