"""Putting the files of a calibrated machine into a directory, all of them or none."""

from __future__ import annotations

from pathlib import Path

from bayescal.calibrated.exported import list_posterior_files
from bayescal.calibrated.formats import FORMATS, choose_format
from bayescal.calibrated.machine import CalibratedMachine
from bayescal.config.load import look_up
from bayescal.files.atomic import make_directory, write_atomically


def export_machine(calibrated: CalibratedMachine, folder: Path, name: str | None = None) -> list[Path]:
    """Write a calibrated machine in a format, parameters with covariance and draws beside it; return what was written.

    Parameters
    ----------
    calibrated : CalibratedMachine
    folder : Path
        Made where it is not there; files of the same names are replaced.
    name : str, optional
        One of `FORMATS`: mechanism, parameters, toml, json, csv, urdf, genhexkins; by default that which
        `load_calibrated` takes again.

    Raises
    ------
    InputError
        For an unknown format or one that cannot have the machine; nothing is written then.

    Examples
    --------
    >>> from pathlib import Path
    >>> sorted(path.name for path in bc.export_machine(calibrated, Path("machines/delta"), "csv"))
    [...'covariance.csv'...]
    """
    files = look_up(FORMATS, name or choose_format(calibrated), "--format", Path())(calibrated) | list_posterior_files(
        calibrated
    )
    make_directory(folder)
    for one, content in files.items():
        (folder / one).parent.mkdir(parents=True, exist_ok=True)
        write_atomically(folder / one, content)
    return [folder / one for one in files]
