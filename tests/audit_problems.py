"""Machines with tolerances and plans of measurement, for the tests of the audit."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
import telescope_machines as machines

from bayescal.density.calibration.likelihood import CalibrationLikelihood, CalibrationPosterior
from bayescal.density.calibration.measurements import Measurements
from bayescal.density.calibration.terms import Errors
from bayescal.density.posterior import Posterior
from bayescal.density.priors import NormalPrior
from bayescal.experiments.audit.design import load_audit, read_plans
from bayescal.experiments.audit.planned import Planned, PlannedPoses
from bayescal.experiments.shared import design
from bayescal.experiments.shared.schema import ModelConfig
from bayescal.identifiability.design import Knowledge, Plan
from bayescal.identifiability.requirements import Forecast
from bayescal.identifiability.sensitivity import compute_sensitivity
from bayescal.machines.frames import FRAME_BLOCKS
from bayescal.machines.kinematics import Machine
from bayescal.machines.readings import Legs, PoseInstrument, place
from bayescal.machines.sensors import PoseSensor
from bayescal.numerics.geometry import matrix_from_rotation_vector

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


def build_wide_plan(machine: Machine, seed: int = 0, **changes) -> Plan:
    """Return poses a tenth of the legs' lengths apart, from which a structural rank is taken."""
    return build_plan(machine, half=0.1 * float(machine.mechanism.leg_lengths.min()), seed=seed, **changes)


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


# --- the same by channels ---------------------------------------------------------------------------------------------


FRAMES = ("frame", "frame_r", "target", "target_r")
NOWHERE = {"frame_mm": [0.0] * 3, "frame_deg": [0.0] * 3, "target_mm": [0.0] * 3}


def read_plan(knowledge: Knowledge, plan: Plan, frames: tuple[str, ...] = ()) -> CalibrationPosterior:
    """Return the posterior of a plan's poses, read without error: actuators, and what sensors see of the pose.

    Poses that the machine cannot take are left out.
    Frames of the instrument are free by their names, ``i_frame[1]`` and so on.
    """
    machine = knowledge.machine
    n = machine.mechanism.n_legs
    model = place(Legs(machine).pick(np.arange(n)), {"i": PoseInstrument(PoseInstrument.Config(**NOWHERE))})
    layout = model.layout
    priors = {name: NormalPrior(layout.nominal[layout.names.index(name)], sd) for name, sd in knowledge.priors.items()}
    for block in layout.blocks:
        if block.symbol.removeprefix("i_") in frames:
            priors |= {name: NormalPrior(0.0, FRAME_SD[block.unit]) for name in block.names}
    pose, found = model.locate(layout.nominal, plan.actuators)
    pose = pose[found]
    assert len(pose) >= 0.5 * plan.n_poses
    seen = plan.information(Poses(pose[:, :3], matrix_from_rotation_vector(pose[:, 3:])))
    there = np.concatenate([np.ones(n, dtype=bool), np.diagonal(seen[0]) > 0.0])
    covariance = np.linalg.inv(seen[:, there[n:]][:, :, there[n:]])
    sd = np.sqrt(np.diagonal(covariance, axis1=1, axis2=2))
    correlation = np.tile(np.eye(there.sum()), (len(pose), 1, 1))
    correlation[:, n:, n:] = covariance / (sd[:, :, None] * sd[:, None])
    own = np.full((len(pose), n), np.hypot(plan.actuator_noise, plan.model_error))
    model = model.pick(there)
    names, noise = tuple(map(str, range(len(pose)))), np.concatenate([own, plan.noise_factor * sd], axis=1)
    data = Measurements(names, model.read(layout.nominal, pose), noise, {}, correlation)
    return Posterior(CalibrationLikelihood(model, data, 1.0, pose), priors, Errors())


class Poses(NamedTuple):
    """Poses as sensors take them."""

    position: np.ndarray
    rotation: np.ndarray


def read_machine(name: str) -> Machine:
    """Return the machine of a shipped design, as its first variant sees it."""
    path = DESIGNS / f"{name}.toml"
    config = load_audit(path)
    variant = config.variants[0]
    model = ModelConfig(model=variant.model, deformation=variant.deformation)
    return design.read_machine(path.parent / config.machine, model, config.deformation, path.parent)


def read_shipped(name: str, **changes) -> Planned:
    """Return the only plan of a shipped design with some of its fields replaced."""
    path = DESIGNS / f"{name}.toml"
    (plan,) = read_plans(load_audit(path).model_copy(update=changes), path.parent).values()
    return plan


def describe_shipped(name: str) -> tuple[Knowledge, Plan]:
    """Return a shipped hexapod as those take it who know legs alone, with frames of instrument and tool."""
    plan, priors = read_shipped(name), {}
    for one, sd in zip(plan.names, plan.sd, strict=True):
        symbol, _, number = one.removeprefix("laser_tracker_").partition("[")
        frame, turned = {"frame": "base", "target": "tool"}.get(symbol.removesuffix("_r")), symbol.endswith("_r")
        axis = "xyz"[int(number[:-1]) - 1] if frame else ""
        priors[f"{frame}_{'r' * turned}{axis}" if frame else one] = float(sd)
    actuators = plan.variant.data.values[:, plan.variant.internal]
    return Knowledge(read_machine(name), priors), Plan(actuators, (TRACKER,), 1e-3)


def take_poses(plan: Planned) -> PlannedPoses:
    """Return where a plan measures."""
    data = plan.variant.data
    return PlannedPoses(data.poses, plan.variant.start, dict(data.given))
