"""Files of a calibrated machine for the next tool, by the names of their formats."""

from __future__ import annotations

from collections.abc import Callable

from bayescal.calibrated.exported import list_mechanism_files
from bayescal.calibrated.formats.genhexkins import list_genhexkins_files
from bayescal.calibrated.formats.plain import (
    list_csv_files,
    list_json_files,
    list_parameter_files,
    list_toml_files,
)
from bayescal.calibrated.formats.urdf import list_urdf_files
from bayescal.calibrated.machine import CalibratedMachine
from bayescal.calibrated.settle import find_hindrance
from bayescal.machines.readings import Legs

MECHANISM, PARAMETERS = "mechanism", "parameters"
FORMATS: dict[str, Callable[[CalibratedMachine], dict[str, bytes]]] = {
    MECHANISM: list_mechanism_files,
    PARAMETERS: list_parameter_files,
    "toml": list_toml_files,
    "json": list_json_files,
    "csv": list_csv_files,
    "urdf": list_urdf_files,
    "genhexkins": list_genhexkins_files,
}


def choose_format(calibrated: CalibratedMachine) -> str:
    """Return the format that every command takes: a mechanism where drawings hold the machine, else its parameters."""
    legs = isinstance(calibrated.model, Legs) and not find_hindrance(calibrated.legs)
    return MECHANISM if legs else PARAMETERS


__all__ = ["FORMATS", "choose_format"]
