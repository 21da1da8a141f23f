"""Files of a calibrated machine for the next tool, by the names of their formats."""

from __future__ import annotations

from collections.abc import Callable

from bayescal.calibrated.exported import list_machine_files
from bayescal.calibrated.formats.genhexkins import list_genhexkins_files
from bayescal.calibrated.formats.plain import list_csv_files, list_json_files
from bayescal.calibrated.formats.urdf import list_urdf_files
from bayescal.calibrated.machine import CalibratedMachine

FORMATS: dict[str, Callable[[CalibratedMachine], dict[str, bytes]]] = {
    "mechanism": list_machine_files,
    "csv": list_csv_files,
    "json": list_json_files,
    "urdf": list_urdf_files,
    "genhexkins": list_genhexkins_files,
}

__all__ = ["FORMATS"]
