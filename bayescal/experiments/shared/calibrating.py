"""What is taken from kinds of experiment that leave a calibrated machine, without knowing those kinds."""

from __future__ import annotations

from abc import ABC, abstractmethod
from pathlib import Path

from bayescal.calibrated.exported import CALIBRATED, read_exported
from bayescal.calibrated.machine import CalibratedMachine
from bayescal.errors import InputError
from bayescal.experiments.frame.load import find_kind
from bayescal.experiments.frame.results import PROVENANCE_FILE, SUMMARY_FILE, Results
from bayescal.files.atomic import read_json


class Calibrating(ABC):
    """A kind of experiment whose results hold a calibrated machine."""

    @abstractmethod
    def calibrate(
        self, results: Results, variant: str | None, experiment: Path | None, trust: bool
    ) -> CalibratedMachine:
        """Return the machine of a variant, of the best where none is named.

        Parameters
        ----------
        results : Results
        variant : str or None
        experiment : Path or None
            The config of the results, for those that do not hold the nominal machine.
        trust : bool
            Whether the code of classes of its own that the results keep may be run.

        Raises
        ------
        InputError
            Where there is no such variant, or something is missing.
        """


def load_calibrated(
    path: Path | str,
    variant: str | None = None,
    experiment: Path | str | None = None,
    force: bool = False,
    trust: bool = False,
) -> CalibratedMachine:
    """Return the calibrated machine of a results directory, or of one that `bayescal export` wrote.

    Parameters
    ----------
    path : Path or str
    variant : str, optional
        Of the results; the best by default.
    experiment : Path or str, optional
        The config of the results, for those that do not hold the nominal machine.
    force : bool
        Take a posterior that did not converge, too.
    trust : bool
        Run the code of classes that are the machine's own: results keep it, and loading a stranger's runs none unasked.

    Raises
    ------
    InputError
        For results without a machine or such a variant, for a posterior that did not converge, and for code that nobody
        has allowed to run.
    """
    path = Path(path)
    if (path / CALIBRATED).is_file():
        found = _check_exported(read_exported(path, trust), path, variant)
    else:
        found = _calibrate(path, variant, None if experiment is None else Path(experiment), trust)
    if found.source.problems and not force:
        problems = "; ".join(found.source.problems)
        raise InputError(
            f"{path}: variant {found.source.variant!r} did not converge ({problems}), expected one that did, or --force"
        )
    return found


def _calibrate(path: Path, variant: str | None, experiment: Path | None, trust: bool) -> CalibratedMachine:
    provenance = read_json(path / PROVENANCE_FILE)
    results = Results(read_json(path / SUMMARY_FILE), provenance=provenance, folder=path)
    name = provenance.get("kind")
    kind: object = None if not isinstance(name, str) or ":" in name else find_kind(name, path, None)
    if not isinstance(kind, Calibrating):
        raise InputError(
            f"{path}: found results of kind {name!r}, which hold no calibrated machine, expected those of a study or a "
            "calibration"
        )
    return kind.calibrate(results, variant, experiment, trust)


def _check_exported(found: CalibratedMachine, path: Path, variant: str | None) -> CalibratedMachine:
    if variant not in (None, found.source.variant):
        raise InputError(f"{path}: found an exported variant {found.source.variant!r}, expected {variant!r}")
    return found
