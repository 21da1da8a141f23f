"""An audit as read: the plans of its variants and sensors to choose from, or a machine that has been measured."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from bayescal.errors import InputError, name_faults
from bayescal.experiments.audit.audit import check_changes
from bayescal.experiments.audit.machine import PlannedMachine
from bayescal.experiments.audit.measured import Draws, MeasuredMachine, centre, describe_found, read_measured
from bayescal.experiments.audit.planned import DesignVariant, PlannedPoses, find_true_sizes
from bayescal.experiments.audit.pose_sensors import ON_TOOL, find_channels, read_pose_sensors
from bayescal.experiments.audit.schema import AuditConfig, AuditVariantConfig
from bayescal.experiments.audit.sensor_sets import SensorChoice, list_choices
from bayescal.experiments.runner.load import load_kind
from bayescal.experiments.runner.parallel import Run
from bayescal.experiments.shared.design import known_symbols
from bayescal.experiments.shared.readings.inputs import Variant
from bayescal.experiments.shared.readings.instruments import read_instruments, read_model
from bayescal.experiments.shared.readings.knowledge import name_place
from bayescal.experiments.shared.readings.schema import FreeConfig
from bayescal.experiments.shared.readings.workspace import build_workspace
from bayescal.experiments.shared.requirements import read_requirements
from bayescal.identifiability.profile import check_profiles
from bayescal.identifiability.reading_rows import typical_given
from bayescal.identifiability.requirements import Requirement
from bayescal.machines.readings import PoseInstrument, ReadingModel, place
from bayescal.machines.readings.base import narrow_range
from bayescal.numerics.geometry import Array
from bayescal.numerics.units import Units


@dataclass(frozen=True, eq=False)
class AuditDesign:
    """A design as read."""

    config: AuditConfig
    plans: Mapping[str, DesignVariant]  # by name: of all variants; none of a machine that has been measured
    measured: MeasuredMachine | None = None  # one that has been, whose posterior is still to be drawn
    sensors: SensorChoice | None = None  # sensors to choose from, if any


def load_audit(path: Path) -> AuditConfig:
    """Return the checked design of an audit; InputError for anything at fault, with file, line, found and expected."""
    config: AuditConfig = load_kind(path, "audit")
    return config


def read_plans(config: AuditConfig, folder: Path) -> dict[str, DesignVariant]:
    """Return the plans of all variants; of a measured machine its posterior is drawn."""
    design = read_design(config, folder)
    return dict(design.plans) if design.measured is None else {config.variants[0].name: draw_plan(design, Run())[0]}


def read_design(config: AuditConfig, folder: Path) -> AuditDesign:
    """Return a design, read and checked; InputError names the file, the variant, the pose, the coordinate."""
    if config.data is not None:
        return AuditDesign(config, {}, read_measured(config, folder))
    assert config.machine is not None
    path, sensors = folder / config.machine, read_pose_sensors(config, folder)
    instruments = read_instruments(config.instruments, folder) | {name: PoseInstrument(ON_TOOL) for name in sensors}
    models, symbols = dict[tuple[str | None, str], ReadingModel](), set[str]()
    for one in config.variants:
        with name_faults("" if one is config.variants[0] else f"variant {one.name!r}"):
            if (key := (one.model, one.deformation)) not in models:
                whole = read_model(config, one, path, folder)
                symbols |= known_symbols(whole.legs.machine.mechanism) if whole.legs else set()
                models[key] = place(whole, instruments)
    symbols |= {symbol for model in models.values() for symbol in model.layout.symbols}
    model = next(iter(models.values()))
    workspace = build_workspace(model, config.workspace, config.units)
    makers = {
        key: PlannedMachine(config, folder, one, workspace, find_channels(sensors, one), symbols)
        for key, one in models.items()
    }
    maker = next(iter(makers.values()))
    required = read_requirements(config.requirements, model, config.units, config.requirement_applies_to)
    planned, plans = maker.plan(config.poses), dict[str, DesignVariant]()
    for one in config.variants:
        with name_faults(f"variant {one.name!r}" if len(config.variants) > 1 else ""):
            own = makers[one.model, one.deformation]
            plans[one.name] = build_plan(config, one, planned, required, own)
            check_changes(plans[one.name])
            if config.selection is not None and not plans[one.name].reads_anywhere:
                raise InputError("selection: found instruments at some poses alone, expected all at each")
    check_profiles(list(dict.fromkeys(name for one in plans.values() for name in one.names)), config.profiles)
    check_reach(next(iter(plans.values())))
    if (asked := config.sensor_selection) is None:
        return AuditDesign(config, plans)
    with name_faults("sensor_selection"):
        choices = list_choices(model, asked, maker.spread)
        listed = [name for one in asked.candidates for name in ([one] if isinstance(one, str) else one)]
        what = asked.model_dump(include=set(FreeConfig.model_fields))
        section = AuditVariantConfig(name="sensor_selection", sensors=[*asked.required_sensors, *listed], **what)
        every = build_plan(config, section, planned, required, maker)
    seen = every.variant, every.expected, every.see_errors
    choice = SensorChoice(
        asked, tuple(maker.spread(asked.required_sensors)), *seen, choices, required, every.units, config.seed
    )
    return AuditDesign(config, plans, None, choice)


def draw_plan(design: AuditDesign, run: Run) -> tuple[DesignVariant, Draws | None]:
    """Return a measured machine at its poses as its posterior has it, and the draws of this, if any are wanted."""
    assert design.measured is not None
    config, (machine, draws, zeta) = design.config, centre(design.measured, run)
    section, posterior = config.variants[0], machine.found.posterior
    units = Units(config.units.length, config.units.angle)
    tau, sizes, floors, others = describe_found(posterior.errors, zeta)
    variant = machine.build(section, poses := machine.own_poses)
    required = read_requirements(config.requirements, machine.model, config.units, config.requirement_applies_to)
    plan = DesignVariant(config, section, variant, poses, required, units, machine, tau, sizes, floors, others)
    check_profiles(plan.names, config.profiles)
    check_changes(plan)
    return plan.resize(sizes), draws


def build_plan(
    config: AuditConfig,
    section: AuditVariantConfig,
    planned: PlannedPoses,
    required: tuple[Requirement, ...],
    maker: PlannedMachine,
) -> DesignVariant:
    """Return a variant with the systematic errors that a study of it is expected to find."""
    variant = maker.build(section, planned)
    true, error = find_true_sizes(config, variant), config.model_error
    units = Units(config.units.length, config.units.angle)
    plan = DesignVariant(config, section, variant, planned, required, units, maker, error.tau, true, error.lengths())
    return plan.settle(true)


def check_reach(plan: DesignVariant) -> None:
    """Raise InputError for a planned pose, or one of the workspace as stated, that the actuators do not reach."""
    config, variant, workspace = plan.config, plan.variant, plan.variant.workspace
    if config.workspace or config.poses.sampling != "workspace":
        _check_reach(variant, variant.data.values, [f"poses: pose {name!r}" for name in variant.data.poses])
    if not config.workspace:
        return
    pose = np.concatenate([workspace.list_ends(), plan.around.pose])
    with np.errstate(all="ignore"):
        theta, given = plan.posterior.theta(plan.expected[None])[0], typical_given(variant.data.given, len(pose))
        read = variant.model.read(theta, pose, given)
    _check_reach(variant, read, [f"workspace: {name_place(variant, one, config.units)}" for one in pose])


def _check_reach(variant: Variant, read: Array, names: Sequence[str]) -> None:
    model, beyond = variant.model, variant.model.find_beyond(read)
    channels = [model.channels[k] for k in model.select(model.commanded)]
    for row, k in np.argwhere(beyond)[:1]:
        channel, (low, high) = channels[k], narrow_range(model.command_range, channels)[k]
        place = model.channels.index(channel)
        raise InputError(
            f"{names[row]}: found {channel.name} at {read[row, place]:.6g} {channel.unit}, expected {low:g} to {high:g}"
        )
