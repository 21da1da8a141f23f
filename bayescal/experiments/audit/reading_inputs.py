"""From config and files to the readings that are planned; every fault shows before anything is computed.

The readings are those of the machine as expected, without noise; the noise stands beside them. Priors count by their
standard deviations: to first order a uniform one is a normal one of the same mean and deviation.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from bayescal.density.calibration.measurements import Measurements
from bayescal.density.calibration.terms import Errors
from bayescal.density.priors import NormalPrior
from bayescal.errors import InputError, name_faults
from bayescal.experiments.audit.changes import check_changes
from bayescal.experiments.audit.planned_poses import PlannedPoses, plan_poses
from bayescal.experiments.audit.reading_plan import ReadingPlan
from bayescal.experiments.audit.schema import AuditConfig, PosesConfig, VariantConfig
from bayescal.experiments.audit.sensor_sets import Choice, list_choices
from bayescal.experiments.shared.readings.inputs import Variant
from bayescal.experiments.shared.readings.instruments import read_instruments, read_model
from bayescal.experiments.shared.readings.noise import noise_of_channels
from bayescal.experiments.shared.readings.priors import choose_priors
from bayescal.experiments.shared.readings.schema import ChannelConfig, FreeConfig
from bayescal.experiments.shared.readings.workspace import Workspace, build_workspace, check_told
from bayescal.experiments.shared.study_schema import VariantConfig as FittedConfig
from bayescal.identifiability.reading_rows import name_tool
from bayescal.identifiability.requirements import Requirement
from bayescal.machines.readings import ReadingModel, place
from bayescal.numerics.geometry import Array
from bayescal.numerics.units import Units


@dataclass(frozen=True, eq=False)
class ReadingAudit:
    """What is planned.

    Attributes
    ----------
    config : AuditConfig
    machine : str
        Its name.
    variants : dict of name to Variant
        Their readings those of the machine as expected, without noise.
    requirements : tuple of Requirement
        Of the tool's numbers, inner units.
    plans : dict of name to ReadingPlan
        The variants as they are audited.
    sensors : Variant or None
        With all sensors there are to choose from; None where none are to be chosen.
    choices : tuple of Choice
        Of these sensors.
    """

    config: AuditConfig
    machine: str
    variants: dict[str, Variant]
    requirements: tuple[Requirement, ...]
    plans: dict[str, ReadingPlan]
    sensors: Variant | None = None
    choices: tuple[Choice, ...] = ()


@dataclass(frozen=True, eq=False)
class MachineMaker:
    """A machine whose variants are made by choosing channels and poses; see `Maker`."""

    config: AuditConfig
    folder: Path
    model: ReadingModel
    workspace: Workspace

    def build(self, section: VariantConfig, poses: PlannedPoses) -> Variant:
        """Return a variant at planned poses; InputError for one at which the machine cannot stand."""
        return _build(self.config, section, self.model, poses, self.workspace)

    def plan(self, section: PosesConfig) -> PlannedPoses:
        """Return planned poses."""
        config = self.config.model_copy(update={"poses": section})
        return plan_poses(config, self.folder, self.model, self.workspace)


def read_audit(config: AuditConfig, folder: Path) -> ReadingAudit:
    """Return the inputs of an audit; InputError names the file, the variant, the pose, the coordinate."""
    model = _read_model(config, config.variants[0], folder)
    if config.aligned and not model.places_tool:
        raise InputError(
            f"aligned: machine {getattr(model, 'name', '')!r} does not say where its tool is; expected tool_channels "
            "of its class, up to three in mm"
        )
    assert isinstance(config.workspace, dict)
    workspace = build_workspace(model, config.workspace, config.units)
    planned = plan_poses(config, folder, model, workspace)
    units = Units(config.units.length, config.units.angle)
    required = _read_requirements(config, model, units)
    name, asked, plans = getattr(model, "name", str(config.machine)), config.sensor_choice, {}
    for one in config.variants:
        with name_faults(f"variant {one.name!r}"):
            seen = model if one.model == config.variants[0].model else _read_model(config, one, folder)

            maker = MachineMaker(config, folder, seen, workspace)
            plans[one.name] = ReadingPlan(config, one, name, maker.build(one, planned), required, units, maker)
            check_changes(plans[one.name])
    variants = {key: one.variant for key, one in plans.items()}
    if asked is None:
        return ReadingAudit(config, name, variants, required, plans)
    with name_faults("sensor_choice"):
        choices = list_choices(model, asked)
        names = [*asked.always, *(one for choice in choices for one in choice.channels)]
        what = asked.model_dump(include=set(FreeConfig.model_fields))
        section = VariantConfig(name="sensor_choice", sensors=names, **what)
        sensors = _build(config, section, model, planned, workspace)
    return ReadingAudit(config, name, variants, required, plans, sensors, choices)


def _read_model(config: AuditConfig, section: VariantConfig, folder: Path) -> ReadingModel:
    """Return the machine of the config's file before its instruments."""
    assert config.machine is not None
    model = read_model(config, section, folder / config.machine, folder)
    return place(model, read_instruments(config, folder))


def _read_requirements(config: AuditConfig, model: ReadingModel, units: Units) -> tuple[Requirement, ...]:
    names, inner = name_tool(model)
    for name in config.requirements:
        if name not in names:
            raise InputError(f"requirements: found {name!r}, expected some of {', '.join(names)}")
    return tuple(
        Requirement(name, units.factor(unit) * config.requirements[name], names, config.required_of)
        for name, unit in zip(names, inner, strict=True)
        if name in config.requirements
    )


def _build(
    config: AuditConfig,
    section: VariantConfig,
    whole: ReadingModel,
    planned: PlannedPoses,
    workspace: Workspace,
) -> Variant:
    noise = noise_of_channels({k: v for k, v in config.sensors.items() if isinstance(v, ChannelConfig)}, whole)
    chosen = whole.select(section.sensors if section.sensors is not None else config.sensors)
    for k in chosen[~np.isfinite(noise[chosen])][:1]:
        raise InputError(f"sensors: found {whole.names[k]} without noise, expected an entry in [sensors]")
    model = whole.pick(chosen)
    priors, fixed, common = choose_priors(config, section, model.layout)
    shape = (len(planned.names), len(chosen))
    data = Measurements(planned.names, np.zeros(shape), np.tile(noise[chosen], (shape[0], 1)), planned.given)
    shared = section.model_dump(include=set(FreeConfig.model_fields) | {"name", "sensors"})
    variant = Variant(
        FittedConfig(**shared, title=section.label, noise="stated"),
        whole,
        model,
        {name: NormalPrior(one.mean, one.sd) for name, one in priors.items()},
        fixed,
        common,
        Errors(),
        data,
        np.zeros(len(planned.names), dtype=bool),
        planned.pose,
        workspace,
        config.aligned,
    )
    values = _read(model, variant.posterior().sampling.start, planned)
    variant = replace(variant, data=replace(data, values=values))
    check_told(variant.posterior(), planned.pose, workspace)
    return variant


def _read(model: ReadingModel, theta: Array, planned: PlannedPoses) -> Array:
    """Return the readings (P, K) of the machine as expected; InputError for a pose at which it cannot stand."""
    values = model.read(theta, planned.pose, planned.given)
    for k, channel in np.argwhere(~np.isfinite(values))[:1]:
        raise InputError(
            f"pose {planned.names[k]!r}: found no reading of {model.names[channel]}, expected a pose at which the "
            "machine as expected stands"
        )
    return values
