"""Machines with tolerances and plans of measurement, for the tests of the audit."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import telescope_machines as machines

from bayescal.identifiability.design import Knowledge, Plan
from bayescal.identifiability.requirements import Forecast
from bayescal.identifiability.sensitivity import compute_sensitivity
from bayescal.machines.frames import FRAME_BLOCKS
from bayescal.machines.kinematics import Machine
from bayescal.machines.sensors import PoseSensor

DESIGNS = Path(__file__).parent.parent / "experiments" / "audit"
TELESCOPE_VARIANTS = tuple(
    f"telescope_{model}_{deformation}"
    for model in ("six_pus", "jacobian", "beam", "stiffness")
    for deformation in ("none", "linear", "matrix")
)
SHIPPED = (*TELESCOPE_VARIANTS, "camera_hexapod", "camera_hexapod_frames", "m2_hexapod")
SD = {"u_x": 0.05, "u_y": 0.05, "kappa": 0.01, "beta": 0.1, "rho0": 0.5}
LENGTH_SD = 2.0
STIFFNESS_SHARE = 0.3
FRAME_SD = {"mm": 2.0, "rad": 2e-3}
TRACKER = PoseSensor(0.01, np.radians(2.0 / 3600.0))


def build_priors(machine: Machine, symbols: tuple[str, ...] | None = None, frames: tuple[str, ...] = ()) -> dict:
    """Return tolerances of some symbols, of all by default, and of frames' symbols."""
    priors = {}
    for block in machine.layout.blocks:
        if symbols is None or block.symbol in symbols:
            usual = SD.get(block.symbol, LENGTH_SD)
            for name, value in zip(block.names, block.nominal, strict=True):
                priors[name] = usual if block.unit in ("mm", "1") else STIFFNESS_SHARE * abs(value)
    return priors | {block.symbol: FRAME_SD[block.unit] for block in FRAME_BLOCKS if block.symbol in frames}


def build_knowledge(
    machine: Machine, symbols: tuple[str, ...] | None = None, frames: tuple[str, ...] = ()
) -> Knowledge:
    """Return a machine with tolerances."""
    return Knowledge(machine, build_priors(machine, symbols, frames))


def build_plan(machine: Machine, n_poses: int = 40, half: float = 1.3, seed: int = 0, **changes) -> Plan:
    """Return random displacements seen by a laser tracker."""
    mechanism = machine.mechanism
    moves = half * np.random.default_rng(seed).uniform(-1, 1, (n_poses, mechanism.n_legs))
    fields = {"sensors": (TRACKER,), "actuator_noise": 1e-3}
    return Plan(mechanism.initial_actuator_positions + moves, **(fields | changes))


def build_telescope_problem(deformation: str = "none", model: str = "six_pus", **changes) -> tuple[Knowledge, Plan]:
    """Return the telescope with everything free, at the configurations of table 3."""
    machine = machines.build_machine(deformation, model=model)
    actuators = machine.mechanism.initial_actuator_positions + machines.ACTUATOR_RANGE * machines.TABLE_3
    fields = {"sensors": (PoseSensor(2e-3, 1.7e-5),), "actuator_noise": 1e-3}
    return build_knowledge(machine), Plan(actuators, **(fields | changes))


def scale_tolerances(knowledge: Knowledge, share: float) -> Knowledge:
    """Return a machine known better, or worse."""
    return replace(knowledge, priors={name: share * sd for name, sd in knowledge.priors.items()})


def foretell(knowledge: Knowledge, actuators: np.ndarray, plan: Plan) -> Forecast:
    """Return how poses err at actuator positions (W, N)."""
    sensitivity = compute_sensitivity(knowledge, actuators)
    return Forecast(sensitivity.slope * knowledge.sd, sensitivity.pose_noise(plan))


def compute_rows(knowledge: Knowledge, plan: Plan) -> np.ndarray:
    """Return the identification Jacobian in units of noise and tolerances, shape (rows, n)."""
    rows = compute_sensitivity(knowledge, plan.actuators).rows(plan)
    return rows.reshape(-1, rows.shape[-1]) * knowledge.sd
