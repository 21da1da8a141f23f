"""Calibrated machines for the tests: posteriors made up as normal draws, and what a study leaves."""

from __future__ import annotations

import numpy as np
import telescope_machines as machines

from bayescal.calibrated.machine import CalibratedMachine, LegErrors, Source, build_calibrated
from bayescal.machines.kinematics import Machine
from bayescal.machines.readings import Legs

SOURCE = Source("made_up", "any/none", "Made up for the tests, never measured")


def build_leg_errors(
    machine: Machine | Legs,
    theta: np.ndarray,
    actuator_noise: float,
    model_variance: np.ndarray,
    matrix_covariance: np.ndarray | None = None,
) -> LegErrors:
    """Return the errors of a machine on legs by σ_ρ in mm and the posterior means of τ_i² in mm², shape (N,)."""
    legs = machine if isinstance(machine, Legs) else Legs(machine)
    return LegErrors(actuator_noise**2 * np.eye(legs.n_legs), model_variance, legs, theta, matrix_covariance)


def draw_machines(machine: Machine | Legs, n_draws: int, rng: np.random.Generator, scale: float = 1e-3) -> np.ndarray:
    """Return parameter vectors (S, D) correlated along ridges, off nominal and spread by a share of `spread_of`."""
    layout = machine.layout
    spread = machines.spread_of(layout)
    mean = layout.nominal + 0.3 * spread * rng.uniform(-1, 1, layout.size)
    mixing = rng.normal(size=(layout.size, layout.size)) / np.sqrt(layout.size)
    return mean + scale * spread * (rng.normal(size=(n_draws, layout.size)) @ mixing)


def build_made_up(
    machine: Machine | Legs, rng: np.random.Generator, n_draws: int = 400, scale: float = 1e-3, **changes: object
) -> CalibratedMachine:
    """Return a machine calibrated by made-up draws."""
    draws = draw_machines(machine, n_draws, rng, scale)
    legs = machine if isinstance(machine, Legs) else Legs(machine)
    fields = {
        "errors": build_leg_errors(legs, legs.layout.nominal, 1e-3, np.full(legs.n_legs, 4e-6)),
        "source": SOURCE,
    }
    return build_calibrated(legs, draws.mean(axis=0), draws, **(fields | changes))


def measurable_actuators(machine: Machine, n: int, rng: np.random.Generator) -> np.ndarray:
    """Return actuator positions (n, N) within the range, mm."""
    mechanism = machine.mechanism
    return mechanism.initial_actuator_positions + mechanism.actuator_range * rng.uniform(-1, 1, (n, mechanism.n_legs))
