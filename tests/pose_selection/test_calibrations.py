"""Simulated calibrations with chosen poses: as accurate as predicted where all is linear, at the least squares."""

from __future__ import annotations

from dataclasses import replace

import audit_problems as problems
import numpy as np
import pytest
import telescope_machines as machines

from bayescal.density.priors import NormalPrior
from bayescal.errors import InputError
from bayescal.identifiability.information import information_of_rows
from bayescal.machines.sensors import PointSensor, PoseSensor
from bayescal.pose_selection import WorkspaceBox
from bayescal.pose_selection.calibrations import _LeastSquares, compute_workspace_errors, simulate_calibrations

SMALL = 0.01  # of the tolerances
REPORT = {"sensors": (PoseSensor(2e-3, 1.7e-5),), "actuator_noise": 1e-3, "model_error": 2e-3}


def see(n_legs=6, share=SMALL, deformation="linear", n=30, **changes):
    """Return poses of the telescope, or of a machine of redundant legs at positions at which it closes."""
    symbols = machines.FREE_SYMBOLS[deformation]
    if n_legs == 6:
        machine = machines.build_machine(deformation)
    else:
        machine = machines.build_machine(deformation, machines.build_random_mechanism(n_legs, 4))
        symbols = ("a_x", "a_y", "b_x", "b_y", "l", "kappa")
    design = replace(problems.build_knowledge(machine, symbols), **(REPORT | changes))
    design = problems.scale_tolerances(design, share)
    placed = WorkspaceBox(design, np.ones(6)).at_actuators(problems.build_plan(machine, n).actuators)
    return design.see(replace(placed, actuators=design.readings.read(design.theta, placed.pose)))


@pytest.mark.parametrize(
    ("n_legs", "changes"),
    [
        (6, {}),
        (7, {}),
        (6, {"actuator_noise": 0.0, "model_error": 0.0}),
        (6, {"sensors": (PoseSensor(2e-3, 1.7e-5, "xz"),)}),
        (6, {"sensors": (PointSensor(np.array([[100.0, 0.0, 0.0], [0.0, 100.0, 0.0]]), 2e-3),)}),  # a turn is not seen
    ],
)
def test_errors_are_as_predicted_where_all_is_linear(n_legs, changes):
    """A hundredth of the tolerances; four standard errors, and half the noise is found out."""
    seen = see(n_legs, **changes)
    found = simulate_calibrations(seen, 80, np.random.default_rng(2))
    assert len(found.truth) == 80
    for share, right in ((1.0, True), (0.5, False)):
        variances, axes = np.linalg.eigh(
            information_of_rows(seen.rows / share, np.ones(len(seen.design.sd))).covariance
        )
        lengths = ((found.errors @ axes) ** 2 / variances).mean(axis=1)
        off = abs(lengths.mean() - 1.0) / (lengths.std(ddof=1) / np.sqrt(len(lengths)))
        assert bool(off < 4.0) is right


@pytest.mark.parametrize("n_legs", [6, 7])
def test_derivatives_of_the_squares(n_legs):
    seen, rng = see(n_legs, share=1.0, n=6), np.random.default_rng(0)
    n_rows = 6 + (n_legs > 6) * n_legs
    pose, moved = seen.placed.pose, seen.placed.actuators + 1e-3 * rng.standard_normal(seen.placed.actuators.shape)
    squares = _LeastSquares(seen, pose, moved, rng.standard_normal((len(pose), n_rows)), 1.0)
    y = 0.1 * rng.standard_normal(len(seen.design.sd))
    _, rows = squares._find(y)
    slope = machines.stencil_derivative(lambda many: np.array([squares._find(one)[0] for one in many]), y, 1e-3 + 0 * y)
    used = slice(None) if n_legs == 6 else np.arange(len(rows)) % n_rows < 6  # of the others what no pose explains
    assert np.abs(slope[used] - rows[used]).max() < (1e-6 if n_legs == 6 else 3e-3) * np.abs(rows).max()


def test_least_squares_without_priors_do_not_know_the_tolerances():
    seen = see(share=1e-3)
    known, free = (simulate_calibrations(seen, 10, np.random.default_rng(1), weight) for weight in (1.0, 1e-8))
    np.testing.assert_array_equal(known.truth, free.truth)
    assert np.sqrt(np.mean(known.errors**2)) < 1.1
    assert np.sqrt(np.mean(free.errors**2)) > 10.0


def test_errors_over_a_workspace_are_those_of_both_machines():
    seen = see()
    found = simulate_calibrations(seen, 3, np.random.default_rng(0))
    errors = compute_workspace_errors(seen.design, found, seen.placed.actuators)
    expected = np.einsum("wij,bj->bwi", seen.located.tool, -found.errors)
    assert np.abs(errors - expected).max() < 1e-2 * np.abs(expected).max()


def test_draws_that_are_no_machine_are_drawn_anew():
    seen = see(share=1.0, deformation="none")
    wide = {name: replace(one, scale=0.6) if name == "u_x[1]" else one for name, one in seen.design.priors.items()}
    wide = replace(seen.design, priors=wide)
    found = simulate_calibrations(wide.see(seen.placed), 40, np.random.default_rng(3))
    assert wide.machine.layout.inside(wide.theta + found.truth @ wide.moves).all()
    drawn = np.random.default_rng(3).standard_normal(found.truth.shape)
    assert not wide.machine.layout.inside(wide.theta + drawn @ wide.moves).all()


def test_tolerances_without_machines_are_an_error():
    seen = see(share=1.0, deformation="none")
    wild = {n: NormalPrior(p.mean, 40.0) if n.startswith("u_x") else p for n, p in seen.design.priors.items()}
    with pytest.raises(InputError, match="tolerances: "):
        simulate_calibrations(replace(seen.design, priors=wild).see(seen.placed), 5, np.random.default_rng(0))
