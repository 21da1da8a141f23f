"""An audit as read: the plans of its variants, sensors to choose from, or a machine that has been measured."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from bayescal.experiments.audit.channels import ChannelPlan, read_channels
from bayescal.experiments.audit.legs import LegPlan, draw_measured, read_legs, read_measured
from bayescal.experiments.audit.schema import AuditConfig
from bayescal.experiments.audit.sensor_sets import SensorChoice
from bayescal.experiments.frame.load import load_kind
from bayescal.experiments.frame.parallel import Run
from bayescal.experiments.shared.measured import MeasuredVariant


@dataclass(frozen=True, eq=False)
class AuditDesign:
    """A design as read.

    Attributes
    ----------
    config : AuditConfig
    folder : Path
        Where the config's file names start.
    legs : LegPlan or None
        A mechanism whose platform instruments see.
    measured : MeasuredVariant or None
        One that has been measured.
    channels : dict of name to ChannelPlan
        Variants whose readings of channels are audited.
    sensors : SensorChoice or None
        Sensors to choose from, if any.
    """

    config: AuditConfig
    folder: Path
    legs: LegPlan | None
    measured: MeasuredVariant | None
    channels: Mapping[str, ChannelPlan]
    sensors: SensorChoice | None


def load_audit(path: Path) -> AuditConfig:
    """Return the checked design of an audit; InputError for anything at fault, with file, line, found and expected."""
    config: AuditConfig = load_kind(path, "audit")
    return config


def read_design(config: AuditConfig, folder: Path) -> AuditDesign:
    """Return a design, read and checked; InputError for anything at fault in the design or its files."""
    if config.data is not None:
        return AuditDesign(config, folder, None, read_measured(config, folder), {}, None)
    if not config.sees_platform:
        return AuditDesign(config, folder, None, None, *read_channels(config, folder))
    return AuditDesign(config, folder, read_legs(config, folder), None, {}, None)


def read_inputs(config: AuditConfig, folder: Path) -> LegPlan:
    """Return what the audit of a platform computes with; of a measured machine its posterior is drawn."""
    return prepare_legs(read_design(config, folder), Run())


def prepare_legs(design: AuditDesign, run: Run) -> LegPlan:
    """Return what the audit of a platform computes with; what is known of a measured machine is drawn."""
    if design.legs is not None:
        return design.legs
    assert design.measured is not None
    return draw_measured(design.config, design.folder, design.measured, run)
