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
from bayescal.experiments.audit.planned_poses import PlannedPoses, plan_poses
from bayescal.experiments.audit.sensor_sets import Choice, list_choices
from bayescal.experiments.shared.readings.inputs import Variant
from bayescal.experiments.shared.readings.instruments import read_machine
from bayescal.experiments.shared.readings.noise import noise_of_channels
from bayescal.experiments.shared.readings.priors import choose_priors
from bayescal.experiments.shared.readings.schema import (
    AuditVariantConfig,
    CalibrationAuditConfig,
    CalibrationVariantConfig,
    FreeConfig,
)
from bayescal.experiments.shared.readings.workspace import Workspace, build_workspace, check_told
from bayescal.identifiability.reading_rows import name_tool
from bayescal.identifiability.units import Units
from bayescal.machines.readings import ReadingModel
from bayescal.numerics.geometry import Array


@dataclass(frozen=True, eq=False)
class AuditInputs:
    """What is planned.

    Attributes
    ----------
    config : CalibrationAuditConfig
    machine : str
        Its name.
    variants : dict of name to Variant
        Their readings those of the machine as expected, without noise.
    limits : dict of coordinate to float
        Largest rms errors, in inner units.
    sensors : Variant or None
        With all sensors there are to choose from; None where none are to be chosen.
    choices : tuple of Choice
        Of these sensors.
    """

    config: CalibrationAuditConfig
    machine: str
    variants: dict[str, Variant]
    limits: dict[str, float]
    sensors: Variant | None = None
    choices: tuple[Choice, ...] = ()


def read_audit(config: CalibrationAuditConfig, folder: Path) -> AuditInputs:
    """Return the inputs of an audit; InputError names the file, the variant, the pose, the coordinate."""
    model = read_machine(config, folder)
    if config.aligned and not model.places_tool:
        raise InputError(
            f"aligned: machine {getattr(model, 'name', '')!r} does not say where its tool is; expected tool_channels "
            "of its class, up to three in mm"
        )
    noise = noise_of_channels(config.sensors, model)
    workspace = build_workspace(model, config.workspace, config.units)
    planned = plan_poses(config, folder, model, workspace)
    variants = {}
    for one in config.variants:
        with name_faults(f"variant {one.name!r}"):
            variants[one.name] = _build(config, one, model, planned, noise, workspace)
    limits = _read_limits(config, model)
    name, asked = getattr(model, "name", config.machine), config.sensor_choice
    if asked is None:
        return AuditInputs(config, name, variants, limits)
    with name_faults("sensor_choice"):
        choices = list_choices(model, asked)
        names = [*asked.always, *(one for choice in choices for one in choice.channels)]
        what = asked.model_dump(include=set(FreeConfig.model_fields))
        section = AuditVariantConfig(name="sensor_choice", title="", sensors=names, **what)
        sensors = _build(config, section, model, planned, noise, workspace)
    return AuditInputs(config, name, variants, limits, sensors, choices)


def _read_limits(config: CalibrationAuditConfig, model: ReadingModel) -> dict[str, float]:
    names, units = name_tool(model)
    section = Units(config.units.length, config.units.angle)
    for name in config.requirements:
        if name not in names:
            raise InputError(f"requirements: found {name!r}, expected some of {', '.join(names)}")
    return {
        name: section.factor(units[names.index(name)]) * config.requirements[name]
        for name in names
        if name in config.requirements
    }


def _build(
    config: CalibrationAuditConfig,
    section: AuditVariantConfig,
    whole: ReadingModel,
    planned: PlannedPoses,
    noise: Array,
    workspace: Workspace,
) -> Variant:
    chosen = whole.select(section.sensors if section.sensors is not None else config.sensors)
    for k in chosen[~np.isfinite(noise[chosen])][:1]:
        raise InputError(f"sensors: found {whole.names[k]} without noise, expected an entry in [sensors]")
    model = whole.pick(chosen)
    priors, fixed, common = choose_priors(config, section, model)
    shape = (len(planned.names), len(chosen))
    data = Measurements(planned.names, np.zeros(shape), np.tile(noise[chosen], (shape[0], 1)), planned.given)
    variant = Variant(
        CalibrationVariantConfig(**section.model_dump(), noise="stated"),
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
