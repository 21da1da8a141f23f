"""Machines with tolerances and plans of measurement, for the tests of the audit."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import telescope_machines as machines

from bayescal.density.calibration.likelihood import CalibrationLikelihood, CalibrationPosterior
from bayescal.density.calibration.measurements import Measurements
from bayescal.density.calibration.terms import ErrorModel
from bayescal.density.posterior import Posterior
from bayescal.density.priors import NormalPrior
from bayescal.experiments.audit.design import load_audit, read_plans
from bayescal.experiments.audit.planned import DesignVariant, PlannedPoses
from bayescal.experiments.audit.schema import AuditSweepConfig
from bayescal.experiments.shared import design
from bayescal.experiments.shared.schema import ModelConfig
from bayescal.identifiability.requirements import WorkspaceErrorModel
from bayescal.machines.kinematics import Machine
from bayescal.machines.readings import Legs, PoseInstrument, place
from bayescal.machines.sensors import PoseSensor, Sensor
from bayescal.numerics.geometry import matrix_from_rotation_vector
from bayescal.pose_selection import Design, SeenPoses, WorkspaceBox

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
SHORT_SWEEP = AuditSweepConfig(noise=[0.5, 2.0], poses=[10, 60], workspace=[0.5, 2.0])
"""Below and above what is planned; every point is a plan of its own, which takes time."""
TRACKER = PoseSensor(0.01, np.radians(2.0 / 3600.0))


@dataclass(frozen=True, eq=False)
class Plan:
    """Actuator positions (P, N), mm, and what measures the poses there."""

    actuators: np.ndarray
    sensors: tuple[Sensor, ...]
    actuator_noise: float
    model_error: float = 0.0

    @property
    def n_poses(self) -> int:
        """Number of poses."""
        return len(self.actuators)


def build_priors(machine: Machine, symbols: tuple[str, ...] | None = None) -> dict:
    """Return priors of some symbols, of all by default."""
    priors = {}
    for block in machine.layout.blocks:
        if symbols is None or block.symbol in symbols:
            usual = SD.get(block.symbol, LENGTH_SD)
            for name, value in zip(block.names, block.nominal, strict=True):
                sd = usual if block.unit in ("mm", "1") else STIFFNESS_SHARE * abs(value)
                priors[name] = NormalPrior(value, sd)
    return priors


def build_knowledge(machine: Machine, symbols: tuple[str, ...] | None = None) -> Design:
    """Return a machine with tolerances, which nothing measures."""
    return Design(machine, build_priors(machine, symbols))


def list_symbols(knowledge: Design) -> list[str]:
    """Return the symbols of the free parameters."""
    return [name.partition("[")[0] for name in knowledge.names]


def list_units(knowledge: Design) -> tuple[str, ...]:
    """Return the units of the free parameters."""
    return tuple(knowledge.machine.layout.units[k] for k in knowledge.free)


def build_plan(machine: Machine, n_poses: int = 40, half: float = 1.3, seed: int = 0, **changes) -> Plan:
    """Return random displacements seen by a laser tracker."""
    mechanism = machine.mechanism
    moves = half * np.random.default_rng(seed).uniform(-1, 1, (n_poses, mechanism.n_legs))
    fields = {"sensors": (TRACKER,), "actuator_noise": 1e-3}
    return Plan(mechanism.initial_actuator_positions + moves, **(fields | changes))


def build_wide_plan(machine: Machine, seed: int = 0, **changes) -> Plan:
    """Return poses a tenth of the legs' lengths apart, from which a structural rank is taken."""
    return build_plan(machine, half=0.1 * float(machine.mechanism.leg_lengths.min()), seed=seed, **changes)


def build_telescope_problem(deformation: str = "none", model: str = "six_pus", **changes) -> tuple[Design, Plan]:
    """Return the telescope with everything free, at the configurations of table 3."""
    machine = machines.build_machine(deformation, model=model)
    actuators = machine.mechanism.initial_actuator_positions + machines.ACTUATOR_RANGE * machines.TABLE_3
    fields = {"sensors": (PoseSensor(2e-3, 1.7e-5),), "actuator_noise": 1e-3}
    return build_knowledge(machine), Plan(actuators, **(fields | changes))


def scale_tolerances(knowledge: Design, share: float) -> Design:
    """Return a machine known better, or worse."""
    priors = {name: NormalPrior(one.mean, share * one.sd) for name, one in knowledge.priors.items()}
    return replace(knowledge, priors=priors)


def see_plan(knowledge: Design, plan: Plan) -> SeenPoses:
    """Return a plan's poses to first order."""
    measured = (plan.sensors, plan.actuator_noise, plan.model_error)
    design = Design(knowledge.machine, knowledge.priors, knowledge.fixed, *measured)
    return design.see(WorkspaceBox(design, np.ones(6)).at_actuators(plan.actuators))


def foretell(knowledge: Design, actuators: np.ndarray, plan: Plan) -> WorkspaceErrorModel:
    """Return how poses err at actuator positions (W, N)."""
    located = see_plan(knowledge, replace(plan, actuators=actuators)).located
    return WorkspaceErrorModel(located.tool, located.located @ np.swapaxes(located.located, -1, -2))


def compute_rows(knowledge: Design, plan: Plan) -> np.ndarray:
    """Return the identification Jacobian in units of noise and tolerances, shape (rows, n)."""
    rows = see_plan(knowledge, plan).rows
    return rows.reshape(-1, rows.shape[-1])


# --- the same by channels ---------------------------------------------------------------------------------------------


FRAMES = ("frame", "frame_r", "target", "target_r")
NOWHERE = {"frame_mm": [0.0] * 3, "frame_deg": [0.0] * 3, "target_mm": [0.0] * 3}


def read_plan(knowledge: Design, plan: Plan, frames: tuple[str, ...] = ()) -> CalibrationPosterior:
    """Return the posterior of a plan's poses, read without error: actuators, and what sensors see of the pose.

    Poses that the machine cannot take are left out.
    Frames of the instrument are free by their names, ``i_frame[x]`` and so on.
    """
    machine = knowledge.machine
    n = machine.mechanism.n_legs
    model = place(Legs(machine).pick(np.arange(n)), {"i": PoseInstrument(PoseInstrument.Config(**NOWHERE))})
    layout = model.layout
    priors = dict(knowledge.priors)
    for block in layout.blocks:
        if block.symbol.removeprefix("i_") in frames:
            priors |= {name: NormalPrior(0.0, FRAME_SD[block.unit]) for name in block.names}
    pose, found = model.locate(layout.nominal, plan.actuators)
    pose = pose[found]
    assert len(pose) >= 0.5 * plan.n_poses
    seen = sum(one.information(pose[:, :3], matrix_from_rotation_vector(pose[:, 3:])) for one in plan.sensors)
    there = np.concatenate([np.ones(n, dtype=bool), np.diagonal(seen[0]) > 0.0])
    covariance = np.linalg.inv(seen[:, there[n:]][:, :, there[n:]])
    sd = np.sqrt(np.diagonal(covariance, axis1=1, axis2=2))
    correlation = np.tile(np.eye(there.sum()), (len(pose), 1, 1))
    correlation[:, n:, n:] = covariance / (sd[:, :, None] * sd[:, None])
    own = np.full((len(pose), n), np.hypot(plan.actuator_noise, plan.model_error))
    model = model.pick(there)
    names, noise = tuple(map(str, range(len(pose)))), np.concatenate([own, sd], axis=1)
    data = Measurements(names, model.read(layout.nominal, pose), noise, {}, correlation)
    return Posterior(CalibrationLikelihood(model, data, 1.0, pose).plain, priors, ErrorModel())


def read_machine(name: str) -> Machine:
    """Return the machine of a shipped design, as its first variant sees it."""
    path = DESIGNS / f"{name}.toml"
    config = load_audit(path)
    variant = config.variants[0]
    model = ModelConfig(model=variant.model, deformation=variant.deformation)
    return design.read_machine(path.parent / config.machine, model, config.deformation, path.parent)


def read_shipped(name: str, **changes) -> DesignVariant:
    """Return the only plan of a shipped design with some of its fields replaced."""
    path = DESIGNS / f"{name}.toml"
    (plan,) = read_plans(load_audit(path).model_copy(update=changes), path.parent).values()
    return plan


def take_poses(plan: DesignVariant) -> PlannedPoses:
    """Return where a plan measures."""
    data = plan.variant.data
    return PlannedPoses(data.poses, plan.variant.start, dict(data.given))
