"""From an audit's design to what it computes with."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from bayescal.config.classes import label_class
from bayescal.data.actuators import read_moves
from bayescal.density.priors import build_kernel
from bayescal.errors import InputError
from bayescal.experiments.audit.from_study import Measured, draw_measured, read_measured, refuse_independent
from bayescal.experiments.audit.i_optimal import plan_i_optimal
from bayescal.experiments.audit.planned import Planned
from bayescal.experiments.audit.schema import AuditConfig, PosesConfig, StructuredErrorConfig, WhatIfConfig
from bayescal.experiments.frame.parallel import Run
from bayescal.experiments.shared.design import (
    REQUIRED,
    build_sensor,
    choose_sensors,
    find_actuators,
    plan_sensors,
    read_machine,
    read_tolerances,
    read_workspace,
)
from bayescal.experiments.shared.measured import MeasuredVariant
from bayescal.experiments.shared.readings.schema import ChannelConfig
from bayescal.experiments.shared.schema import FramesConfig, ModelConfig, WorkspaceConfig
from bayescal.identifiability.calibration import (
    SimulatedCalibrations,
    count_kept,
    expected_covariance,
    simulate_calibrations,
)
from bayescal.identifiability.design import (
    FunctionOfPose,
    Knowledge,
    Plan,
    PoseVolume,
    draw_displacements,
    find_workspace_actuators,
    predict_poses,
)
from bayescal.identifiability.directions import Direction
from bayescal.identifiability.information import Information
from bayescal.identifiability.profile import check_profiles
from bayescal.identifiability.requirements import Forecast, Requirement
from bayescal.identifiability.ridges import Ridge, describe_ridges
from bayescal.identifiability.sensitivity import compute_sensitivity, inform
from bayescal.identifiability.structure import Structure, find_structural_rank
from bayescal.machines.frames import FRAME_BLOCKS, FRAMES, frame_symbols
from bayescal.machines.kinematics import solve_forward_kinematics, solve_inverse_kinematics
from bayescal.machines.mechanism import Mechanism
from bayescal.machines.sensors import Sensor
from bayescal.numerics.geometry import DEGREES_OF_FREEDOM, Array
from bayescal.numerics.units import MICROMETRE, Units

SLACK = 1e-9


@dataclass(frozen=True, eq=False)
class AuditInputs(Planned):
    """A mechanism on legs whose platform instruments see, planned or measured.

    Attributes
    ----------
    config : AuditConfig
    folder : Path
        Where the config's file names start.
    knowledge : Knowledge
    plan : Plan
    sensors : dict of name to Sensor
        All that the config lists, those that it does not use too.
    workspace : PoseVolume or None
    workspace_actuators : ndarray, shape (W, N)
        Actuator positions of the workspace's poses; those of the plan where there is no workspace.
    requirements : list of Requirement
    units : Units
    measured : Measured or None
        Where the config has data.
    """

    config: AuditConfig
    folder: Path
    knowledge: Knowledge
    plan: Plan
    sensors: dict[str, Sensor]
    workspace: PoseVolume | None
    workspace_actuators: Array
    requirements: list[Requirement]
    units: Units
    measured: Measured | None = None

    def actuators(self, plan: PosesConfig, factor: float = 1.0, count: int | None = None) -> Array:
        """Return the actuator positions of another plan, shape (P, N), mm; its range may be widened by a factor."""
        return plan_actuators(self.config, self.folder, self.knowledge, self.workspace, plan, factor, count)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the free parameters."""
        return self.knowledge.names

    @property
    def parameter_units(self) -> tuple[str, ...]:
        """Their inner units."""
        return self.knowledge.units

    @property
    def sd(self) -> Array:
        """Standard deviations of their priors, shape (n,)."""
        return self.knowledge.sd

    @property
    def nominal(self) -> Array:
        """Their nominal values, shape (n,)."""
        return np.asarray(self.knowledge.layout.nominal[self.knowledge.free])

    @property
    def frames(self) -> frozenset[str]:
        """Symbols of the frames of instrument and tool."""
        return frozenset(block.symbol for block in FRAME_BLOCKS)

    @property
    def n_poses(self) -> int:
        """Number of planned poses."""
        return self.plan.n_poses

    @property
    def is_beyond_range(self) -> bool:
        """Whether the actuators would have to reach further than they do."""
        mechanism = self.knowledge.machine.mechanism
        moved = np.abs(self.plan.actuators - mechanism.initial_actuator_positions)
        return bool(np.any(moved > mechanism.actuator_range * (1.0 + SLACK)))

    def inform(self) -> Information:
        """Return what the plan tells of the parameters."""
        return inform(self.knowledge, self.plan)

    def find_structure(self, rng: np.random.Generator) -> Structure:
        """Return what no measurement with the plan's instruments sees."""
        return find_structural_rank(self.knowledge, self.plan, rng)

    def forecast(self) -> Forecast:
        """Return how the pose errs over the workspace."""
        sensitivity = compute_sensitivity(self.knowledge, self.workspace_actuators)
        return Forecast(sensitivity.slope * self.sd, sensitivity.pose_noise(self.plan))

    def describe(self, directions: Sequence[Direction]) -> list[Ridge]:
        """Return the ridges among directions, computed with the machine itself."""
        return describe_ridges(self.knowledge, self.plan, self.workspace_actuators, directions, self.units)

    @property
    def tool_units(self) -> tuple[str, ...]:
        """Units of a pose."""
        return ("mm",) * 3 + ("rad",) * 3

    def name_workspace_pose(self, k: int) -> str:
        """Return the actuators' displacements at a pose of the workspace."""
        moved = self.workspace_actuators[k] - self.knowledge.machine.mechanism.initial_actuator_positions
        return f"displacements {', '.join(f'{one:.3g}' for one in moved)} mm"

    def describe_variant(self) -> dict[str, Any]:
        """Return what sees the platform."""
        names = [] if self.measured is not None else list_measuring(self.config)
        words = ", ".join(name.replace("_", " ") for name in names)
        n_legs = self.knowledge.machine.mechanism.n_legs
        return {
            "title": self.config.variants[0].label,
            "data": f"{words or 'measured poses'}, {self.n_poses} poses",
            "n_equations": self.n_poses * n_legs,
        }

    def summarise_plan(self) -> dict[str, Any]:
        """Return machine and plan for ``summary.json``."""
        config, plan, machine = self.config, self.plan, self.knowledge.machine
        mechanism, function = machine.mechanism, self.plan.function
        moved = np.abs(plan.actuators - mechanism.initial_actuator_positions)
        found: dict[str, Any] = {
            "n_poses": plan.n_poses,
            "sensors": [] if config.data is not None else list_measuring(config),
            "actuator_noise_um": 1e3 * plan.actuator_noise,
            "model_error_um": 1e3 * plan.model_error,
            "largest_displacement_mm": float(moved.max()),
            "actuator_range_mm": mechanism.actuator_range,
        }
        if function is not None:
            size = float(np.sqrt(np.mean(np.square(function.scale))))
            found["structured_error"] = {"kernel": function.kernel.name, "scale_um": 1e3 * size}
        if self.measured is not None:
            found["n_held_back"] = self.measured.n_held_back
        if isinstance(config.workspace, WorkspaceConfig):
            found["workspace"] = config.workspace.model_dump(mode="json")
        return {
            "machine": mechanism.name,
            "model": label_class(config.variants[0].model or ""),
            "model_title": machine.model.title,
            "deformation": label_class(config.variants[0].deformation),
            "plan": found,
        }

    def list_changes(self) -> list[WhatIfConfig]:
        """Return poses at the ends of the range, over all of it, and each instrument that is listed and not used."""
        config, n, changes = self.config, self.n_poses, list[WhatIfConfig]()
        for plan, words in (("extremes", "at the ends of the range"), ("uniform", "spread evenly over the range")):
            if config.data is None and config.poses.plan != plan:
                poses = PosesConfig.model_validate({"plan": plan, "count": n})
                changes.append(WhatIfConfig(name=f"{n} poses {words}", poses=poses))
        if self.plan.function is not None:
            changes.append(WhatIfConfig(name="no error that is a function of the pose", structured_error=False))
        measuring = list_measuring(config)
        for name in config.sensors:
            if name not in measuring:
                words = name.replace("_", " ")
                changes.append(WhatIfConfig(name=f"{words} instead", sensors=[name]))
                changes.append(WhatIfConfig(name=f"{words} too", sensors=[*measuring, name]))
        return changes

    def change(self, change: WhatIfConfig) -> AuditInputs:
        """Return the same machine with a changed plan."""
        plan, mechanism = self.plan, self.knowledge.machine.mechanism
        count = max(1, round(change.poses_factor * plan.n_poses))
        config = change.poses or (None if self.measured is not None else self.config.poses)
        information = plan.pose_information
        if config is not None:
            same = change.poses is not None and change.poses_factor == 1.0
            actuators = self.actuators(config, change.workspace_factor, None if same else count)
        else:
            again = np.arange(count) % plan.n_poses
            start = mechanism.initial_actuator_positions
            actuators = start + change.workspace_factor * (plan.actuators[again] - start)
            information = None if information is None else information[again]
        sensors = plan.sensors
        if change.sensors is not None:
            sensors = choose_sensors(self.sensors, change.sensors, f"what_if {change.name!r}: sensors")
            information = None
        changed = replace(
            plan,
            actuators=actuators,
            sensors=sensors,
            pose_information=information,
            noise_factor=plan.noise_factor * change.noise_factor,
            actuator_noise=plan.actuator_noise * change.actuator_noise_factor,
            function=plan.function if change.structured_error else None,
        )
        return replace(self, plan=changed)

    def propose(self) -> tuple[str, AuditInputs]:
        """Return as many poses as planned, chosen I-optimally."""
        return f"{self.n_poses} poses chosen I-optimally", replace(self, plan=plan_i_optimal(self))

    def simulate(
        self, n: int, rng: np.random.Generator, fitted: Sequence[int]
    ) -> tuple[SimulatedCalibrations, np.ndarray]:
        """Return n simulated calibrations of some parameters, and how many keep each requirement."""
        simulated = simulate_calibrations(self.knowledge, self.plan, n, rng, fitted)
        return simulated, count_kept(simulated, self.plan, self.workspace_actuators, self.requirements, rng)

    def average(self, n: int, rng: np.random.Generator) -> Array:
        """Return the posterior covariance averaged over n machines of the priors, in units of the tolerances."""
        return expected_covariance(self.knowledge, self.plan, n, rng)


@dataclass(frozen=True, eq=False)
class AuditDesign:
    """A design as read: inputs of a machine that is planned, or a machine that has been measured.

    Attributes
    ----------
    config : AuditConfig
    folder : Path
    planned : AuditInputs or None
    measured : MeasuredVariant or None
        Where the design has data.
    """

    config: AuditConfig
    folder: Path
    planned: AuditInputs | None
    measured: MeasuredVariant | None


def read_design(config: AuditConfig, folder: Path) -> AuditDesign:
    """Return a design, read and checked.

    Raises
    ------
    InputError
        For anything at fault in the design or its files: unknown names, poses that the machine cannot take or the
        actuators cannot reach, sensors that are not there.
    """
    if config.data is not None:
        return AuditDesign(config, folder, None, read_measured(config, folder))
    if config.structured_error is not None:
        refuse_independent(config)
    units = Units(config.units.length, config.units.angle)
    sensors = _read_sensors(config, folder)
    knowledge, plan = _plan_measurements(config, folder, units, sensors)
    return AuditDesign(config, folder, _complete(config, folder, knowledge, plan, None), None)


def read_inputs(config: AuditConfig, folder: Path) -> AuditInputs:
    """Return what an audit computes with; for a machine that has been measured its posterior is drawn."""
    return prepare(read_design(config, folder), Run())


def prepare(design: AuditDesign, run: Run) -> AuditInputs:
    """Return what an audit computes with; what is known of a measured machine is drawn from its posterior."""
    if design.planned is not None:
        return design.planned
    assert design.measured is not None
    measured = draw_measured(design.config, design.measured, run)
    return _complete(design.config, design.folder, measured.knowledge, measured.plan, measured)


def _complete(
    config: AuditConfig, folder: Path, knowledge: Knowledge, plan: Plan, measured: Measured | None
) -> AuditInputs:
    units, workspace = Units(config.units.length, config.units.angle), read_volume(config)
    check_profiles(knowledge, config.profiles)
    predict_poses(knowledge.machine, knowledge.machine_centre, plan.actuators)
    at = find_actuators(knowledge, workspace, config.seed, plan.actuators)
    requirements = _read_requirements(config, units)
    sensors = _read_sensors(config, folder)
    return AuditInputs(config, folder, knowledge, plan, sensors, workspace, at, requirements, units, measured)


def _read_sensors(config: AuditConfig, folder: Path) -> dict[str, Sensor]:
    return {
        name: build_sensor(name, sensor, folder)
        for name, sensor in config.sensors.items()
        if not isinstance(sensor, ChannelConfig)
    }


def _read_requirements(config: AuditConfig, units: Units) -> list[Requirement]:
    """Return the largest errors of a pose that are allowed, mm and rad."""
    for name in config.requirements:
        if name not in REQUIRED:
            raise InputError(f"requirements: found {name!r}, expected some of {', '.join(REQUIRED)}")
    return [
        Requirement(
            name,
            config.requirements[name] * units.factor("rad" if name.startswith("rotation") else "mm"),
            of=config.required_of,
        )
        for name in REQUIRED
        if name in config.requirements
    ]


def list_measuring(config: AuditConfig) -> list[str]:
    """Return the instruments that see each planned pose."""
    chosen = config.variants[0].sensors
    return list(config.sensors) if chosen is None else chosen


def read_volume(config: AuditConfig) -> PoseVolume | None:
    """Return where accuracy counts; None where nothing is said."""
    return read_workspace(config.workspace if isinstance(config.workspace, WorkspaceConfig) else None)


def _plan_measurements(
    config: AuditConfig, folder: Path, units: Units, sensors: dict[str, Sensor]
) -> tuple[Knowledge, Plan]:
    """Return what is known of a machine that has not been measured, and how it is to be."""
    assert config.machine is not None
    assert config.noise is not None
    variant = config.variants[0]
    assert variant.model is not None
    model = ModelConfig(model=variant.model, deformation=variant.deformation)
    machine = read_machine(folder / config.machine, model, config.deformation, folder)
    priors, fixed = read_tolerances(machine, config.parameters, variant.free, units, Path(config.name))
    knowledge = Knowledge(machine, priors | _read_frames(config.frames, units), fixed)
    actuators = plan_actuators(config, folder, knowledge, read_volume(config), config.poses)
    _check_range(machine.mechanism, actuators)
    plan = plan_sensors(actuators, sensors, list_measuring(config), config.noise, "variants.sensors")
    return knowledge, replace(plan, function=_read_function(config.structured_error))


def _read_function(config: StructuredErrorConfig | None) -> FunctionOfPose | None:
    if config is None:
        return None
    return FunctionOfPose(build_kernel(config.kernel, config.length), MICROMETRE * config.scale_um)


def _read_frames(frames: FramesConfig, units: Units) -> dict[str, float]:
    """Return standard deviations of the frames that the calibration has to find, by parameter."""
    priors: dict[str, float] = {}
    for frame in FRAMES:
        section = getattr(frames, frame)
        if section is not None:
            moved, turned = frame_symbols(frame)
            priors |= dict.fromkeys(moved, section.position * units.factor("mm"))
            priors |= dict.fromkeys(turned, section.rotation * units.factor("rad"))
    return priors


# --- poses -------------------------------------------------------------------------------------------------------


def plan_actuators(
    config: AuditConfig,
    folder: Path,
    knowledge: Knowledge,
    workspace: PoseVolume | None,
    plan: PosesConfig,
    factor: float = 1.0,
    count: int | None = None,
) -> Array:
    """Return the actuator positions of a plan, shape (P, N), mm.

    Parameters
    ----------
    config, folder
        The design and where its files are.
    knowledge : Knowledge
    workspace : PoseVolume or None
    plan : PlanConfig
    factor : float
        On the displacements.
    count : int, optional
        Number of poses; a table's rows are taken round and round.
    """
    mechanism = knowledge.machine.mechanism
    start = mechanism.initial_actuator_positions
    rng = np.random.default_rng([config.seed, 1])
    if plan.file is not None:
        raise InputError("poses.file: found poses of a platform that instruments see, expected configurations")
    if plan.configurations is not None:
        moves = read_moves(folder / plan.configurations, plan.unit_mm, mechanism.n_legs)
        moves = moves if count is None else moves[np.arange(count) % len(moves)]
        return start + factor * moves
    n = plan.count if count is None else count
    assert n is not None
    if plan.plan != "workspace":
        half = mechanism.actuator_range if plan.range_mm is None else plan.range_mm
        drawn = start + factor * draw_displacements(plan.plan, n, mechanism.n_legs, half, rng)
        return close_legs(knowledge, drawn)
    if workspace is None:
        raise InputError("poses: found plan 'workspace' without [workspace], expected it")
    theta = knowledge.machine_centre
    found = find_workspace_actuators(knowledge.machine, theta, workspace, max(n, 12), config.seed)
    return start + factor * (rng.permutation(found)[:n] - start)


def close_legs(knowledge: Knowledge, actuators: Array) -> Array:
    """Return positions near the given ones (P, N) at which redundant legs close too; six legs always do.

    The poses are those of least squares; where there is none, or a leg cannot follow, the position stays as it was.
    """
    machine = knowledge.machine
    if machine.mechanism.n_legs == DEGREES_OF_FREEDOM:
        return actuators
    theta = knowledge.machine_centre
    found = solve_forward_kinematics(machine, theta, actuators, check=False)
    back = solve_inverse_kinematics(machine, theta, found.position, found.rotation, check=False)
    good = found.converged & back.converged
    return np.where(good[:, None], back.actuators, actuators)


def _check_range(mechanism: Mechanism, actuators: Array) -> None:
    moved = np.abs(actuators - mechanism.initial_actuator_positions)
    if np.any(moved > mechanism.actuator_range * (1.0 + SLACK)):
        pose, leg = np.unravel_index(int(np.argmax(moved)), moved.shape)
        raise InputError(
            f"poses: pose {pose + 1}, leg {leg + 1}: found a displacement of {moved[pose, leg]:g} mm, "
            f"expected at most the actuator range of {mechanism.actuator_range:g} mm"
        )
