"""What is taken from kinds of experiment that leave a calibrated machine, without knowing those kinds."""

from __future__ import annotations

from abc import ABC, abstractmethod
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar

from bayescal.config.sections import ExperimentConfig
from bayescal.config.trust import trusting
from bayescal.errors import InputError
from bayescal.experiments.runner.identity import identify
from bayescal.experiments.runner.load import find_kind, load
from bayescal.files.atomic import read_json
from bayescal.files.manifest import overlooking

if TYPE_CHECKING:
    from bayescal.calibrated.machine import CalibratedMachine
    from bayescal.experiments.runner.results import Results

KEPT = "machine"
"""Folder of the results that holds what the machine is read from."""


class CalibratingKind(ABC):
    """A kind of experiment whose results hold a calibrated machine.

    Attributes
    ----------
    tables_of_machine : tuple of str
        Tables of the results that it is made from.
    """

    tables_of_machine: ClassVar[tuple[str, ...]] = ()

    @abstractmethod
    def calibrate(
        self,
        results: Results,
        variant: str | None,
        experiment: Path | None,
        mode: int | None,
        with_instruments: bool = False,
    ) -> CalibratedMachine:
        """Return the machine of a variant, of the best where none is named.

        Parameters
        ----------
        results : Results
        variant : str or None
        experiment : Path or None
            The config of the results, for those that do not hold the nominal machine.
        mode : int or None
            Which of several solutions, from 1.
        with_instruments : bool
            Whether instruments beside the machine are there as the calibration left them, by their channels.

        Raises
        ------
        InputError
            Where there is no such variant or solution, where there are several and none is named, or something is
            missing.
        """


def load_calibrated(
    path: Path | str,
    variant: str | None = None,
    experiment: Path | str | None = None,
    allow_unconverged: bool = False,
    allow_changed_files: bool = False,
    trust: bool = False,
    mode: int | None = None,
    with_instruments: bool = False,
) -> CalibratedMachine:
    """Return the calibrated machine of a results directory, or of one that `bayescal export` wrote.

    Parameters
    ----------
    path : Path or str
    variant : str, optional
        Of the results; the best by default.
    experiment : Path or str, optional
        The config of the results, for those that do not hold the nominal machine.
    allow_unconverged : bool
        Use a posterior that did not converge.
    allow_changed_files : bool
        Use files that changed since they were written.
    trust : bool
        Run the code of classes that are the machine's own, which results keep, though nobody has trusted it.
    mode : int, optional
        Which of several solutions of a posterior, from 1, the most probable one; needed where there are several.
    with_instruments : bool
        Take the instruments beside the machine, too, for readings of theirs; an exported machine has none.

    Raises
    ------
    InputError
        For results without a machine or such a variant, for several solutions of which none is named, for a posterior
        that did not converge, and for code that nobody has trusted.

    Examples
    --------
    >>> calibrated = bc.load_calibrated(study.folder, trust=True)
    >>> calibrated.theta.shape, calibrated.covariance.shape
    ((14,), (9, 9))
    """
    from bayescal.calibrated.exported import CALIBRATED, read_exported

    path = path if isinstance(path, Path) else Path(path)
    with trusting(trust), overlooking(allow_changed_files):
        if (path / CALIBRATED).is_file():
            found = read_exported(path)
            if variant not in (None, found.source.variant):
                raise InputError(f"{path}: found an exported variant {found.source.variant!r}, expected {variant!r}")
            if mode is not None:
                raise InputError(f"{path}: --mode: found {mode}, expected none for an exported machine")
        else:
            place = None if experiment is None else Path(experiment)
            found = _calibrate(path, variant, place, mode, with_instruments)
    if found.source.problems and not allow_unconverged:
        problems = "; ".join(found.source.problems)
        raise InputError(
            f"{path}: variant {found.source.variant!r} did not converge ({problems}); "
            "--allow-unconverged, in Python allow_unconverged=True, uses it"
        )
    return found


def _calibrate(
    path: Path, variant: str | None, experiment: Path | None, mode: int | None, with_instruments: bool
) -> CalibratedMachine:
    from bayescal.experiments.runner.results import PROVENANCE_FILE, read_results

    name = read_json(path / PROVENANCE_FILE).get("kind")
    kind: object = None if not isinstance(name, str) or ":" in name else find_kind(name, path, None)
    if not isinstance(kind, CalibratingKind):
        raise InputError(f"{path}: found kind {name!r}, expected a study")
    return kind.calibrate(read_results(path, kind.tables_of_machine), variant, experiment, mode, with_instruments)


# --- for those kinds -----------------------------------------------------------------------------------------------


def load_same[C: ExperimentConfig](results: Results, path: Path, schema: type[C]) -> C:
    """Return the config of a file, which must be that of the results."""
    experiment, config = load(path)
    if not isinstance(config, schema):
        wanted = results.provenance.get("kind")
        raise InputError(f"{path}: kind: found {config.kind!r}, expected {wanted!r}")
    identity = identify(config, path.parent, experiment.files(config, path.parent))
    if any(results.provenance.get(key) != identity[key] for key in ("config", "files")):
        raise InputError(f"{path}: found another {config.kind} than {results.folder}, expected the same")
    return config
