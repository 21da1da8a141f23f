"""The way in from Python: a machine, a table of readings, tolerances.

A call states the content of a config, as the shell reads it from TOML, and files in memory: the same config object is
checked and run, and the same numbers come out. Messages name the call's arguments.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from functools import cached_property
from io import StringIO
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from pydantic import ValidationError

from bayescal.config.load import FOLDER
from bayescal.config.sections import ExperimentConfig
from bayescal.errors import InputError, name_faults
from bayescal.experiments.runner.load import load
from bayescal.experiments.shared.readings.instruments import read_instruments
from bayescal.experiments.shared.readings.schema import InstrumentConfig
from bayescal.files.csv_tables import format_table, read_table
from bayescal.files.memory import MemoryPath
from bayescal.machine_files import AnyMachine, MachineFiles, load_machine
from bayescal.machines.readings import Channel
from bayescal.machines.readings.placed import rename_channel
from bayescal.numerics.units import units_like
from bayescal.results import LoadedResults, StudyResult, wrap_results
from bayescal.stated import StatedExperiment, Table, name_rows

if TYPE_CHECKING:
    import pandas as pd  # tables need it, naming things does not

READINGS = "data/readings.csv"
NEXT_POSE = "next_pose.toml"
UNSTATED = {"status": "unstated", "text": "a table given in Python"}
EVERYTHING = {"everything": {"title": "Everything free"}}

type Widths = Mapping[str, object]
"""By symbol: a standard deviation, one per leg, or a section as in a config."""
type Noise = Mapping[str, object]
"""By channel or kind of channels: a standard deviation, one each, or a section as in a config."""


# --- data ------------------------------------------------------------------------------------------------------------


class Data:
    """Readings of a machine.

    Parameters
    ----------
    table : DataFrame or mapping of its columns, or the file of one
        A row a pose; columns by channel and unit such as ``s_1_mm``, what is given of each row, and optionally ``pose``
        (names; else the index) and ``use`` (``calibration`` or ``verification``). Empty cells were not read.
    noise : mapping
        By channel, or kind of channels: the standard deviation of a reading, in the unit of its column, one or one
        each; or a section as in a config, ``{"noise_um": 5.0, "noise_group": "camera"}``.
    commanded_channels, verification_poses : sequence of str
        Channels that the machine was commanded by; poses that are kept for verification.
    provenance : str or mapping
        Where they come from: a sentence, or a section [provenance] as in a config.
    truth : DataFrame, optional
        The true parameters, of simulated readings.

    Examples
    --------
    >>> bc.Data(data.table, noise, verification_poses=["C001", "C002"])
    data: 12 rows of s, cam_x, cam_y, height; a table given in Python
    """

    def __init__(
        self,
        table: Table,
        noise: Noise,
        commanded_channels: Sequence[str] = (),
        verification_poses: Sequence[str] = (),
        provenance: str | Mapping[str, object] = UNSTATED["text"],
        truth: pd.DataFrame | None = None,
    ) -> None:
        self.source = Path(table) if isinstance(table, str | Path) else name_rows(table)
        self.noise, self.truth = noise, truth
        self.commanded_channels, self.verification_poses = commanded_channels, verification_poses
        self.provenance = {**UNSTATED, "text": provenance} if isinstance(provenance, str) else dict(provenance)

    @cached_property
    def table(self) -> pd.DataFrame:
        """The readings, a row a pose."""
        import pandas as pd

        if not isinstance(self.source, Path):
            return self.source
        read = read_table(self.source, None)
        return pd.read_csv(StringIO(format_table((), read.columns, read.rows)))

    def state(self, stated: StatedExperiment, channels: Sequence[Channel]) -> None:
        """Add the readings of a machine's channels to an experiment."""
        name = stated.add_table(self.source, READINGS, "data")
        columns: Sequence[str] = ()
        with suppress(InputError):  # the reader of the config says it better
            columns = list(self.table.columns)
        options = {
            "channels": [one for one in self.noise if any(one in (channel.name, channel.kind) for channel in channels)],
            "commanded_channels": self.commanded_channels,
            "verification_poses": self.verification_poses,
        }
        stated.labels["data.0"] = "data"
        stated.state(
            provenance=self.provenance,
            data=[{"file": name, **{key: list(one) for key, one in options.items() if len(one)}}],
            sensors=describe_noise(self.noise, channels, columns),
        )

    def __repr__(self) -> str:
        return f"data: {len(self.table)} rows of {', '.join(self.noise)}; {self.provenance['text']}"


def describe_noise(noise: Noise, channels: Sequence[Channel], columns: Sequence[str]) -> dict[str, dict[str, object]]:
    """Return the sections [sensors] of noises by channel or kind, in the units of their columns where there are any.

    What is wrong with names, columns and numbers says who reads the config.
    """
    found: dict[str, dict[str, object]] = {}
    for name, value in noise.items():
        channel = next((one for one in channels if name in (one.name, one.kind)), None)
        if isinstance(value, Mapping) or channel is None:
            found[name] = dict(value) if isinstance(value, Mapping) else {"noise": value}
            continue
        units = units_like(channel.unit)
        factor = next((units[unit] for unit in units if f"{channel.stem}_{unit}" in columns), 1.0)
        key = f"noise_{channel.unit}" if channel.unit in ("mm", "rad") else "noise"
        try:
            found[name] = {key: (factor * np.asarray(value, dtype=np.float64)).tolist()}
        except (TypeError, ValueError):
            found[name] = {key: value}
    return found


def _list_channels(machine: MachineFiles, instruments: object) -> list[Channel]:
    """Return the channels of a machine, and of instruments that a section [instruments] puts beside it.

    What is wrong with that section says who reads the config.
    """
    channels = list(machine.channels)
    if isinstance(instruments, Mapping):
        root = MemoryPath(files=machine.files)
        with suppress(InputError, ValidationError):
            known = {
                key: InstrumentConfig.model_validate(one, context={FOLDER: root}) for key, one in instruments.items()
            }
            found = read_instruments(known, root)
            channels += [rename_channel(name, seen) for name, one in found.items() for seen in one.channels]
    return channels


def _describe_widths(tolerances: Widths) -> dict[str, dict[str, object]]:
    return {
        name: dict(value) if isinstance(value, Mapping) else {"prior": "normal", "sd": value}
        for name, value in tolerances.items()
    }


# --- experiments -----------------------------------------------------------------------------------------------------


def run_experiment(
    experiment: Path | str | ExperimentConfig,
    out: Path | str | None = None,
    *,
    folder: Path | str = ".",
    workers: int = 1,
    resume: bool = False,
    quiet: bool = False,
    scheduler: str | None = None,
) -> LoadedResults:
    """Run an experiment of any kind as ``bayescal run`` does, and return its results.

    Parameters
    ----------
    experiment : Path, str or ExperimentConfig
        The config's file, or what `load_experiment` made of it, changed or not.
    out : Path or str, optional
        Folder for the results, replaced as a whole when everything is done; default ``results/NAME``.
    folder : Path or str
        Where the file names of a config start that was not read from a file here.
    workers : int
        Processes side by side; the numbers do not depend on it.
    resume : bool
        Take up an interrupted run of the same config.
    quiet : bool
        Say nothing of the progress.
    scheduler : str, optional
        Of dask, whose workers compute instead of processes: an address, a scheduler's JSON file, or ``local:N``.

    Raises
    ------
    InputError
        For anything at fault, with the line that the shell prints; nothing is written then.
    NumericalError
        Where a computation fails; the finished tasks are kept for ``resume``.

    Examples
    --------
    >>> bc.run_experiment(config, "out", folder="examples/own_machine", quiet=True).folder.name
    'out'
    """
    from bayescal.experiments.runner.run import run_experiment as run

    if isinstance(experiment, ExperimentConfig):
        config, file = experiment, ""
    else:
        config, file = load(Path(experiment))[1], str(experiment)
        folder = Path(experiment).parent
    where = Path("results") / config.name if out is None else Path(out)
    with name_faults(file):
        return wrap_results(run(config, Path(folder), where, workers, resume, quiet, scheduler).results, trust=True)


def _begin(kind: str, machine: AnyMachine, name: str, title: str, seed: int) -> tuple[StatedExperiment, MachineFiles]:
    """Return a stated of a kind of experiment with a machine's files, and the machine."""
    found = load_machine(machine)
    stated = StatedExperiment(files=dict(found.files))
    stated.state(kind=kind, name=name, title=f"{found.name}: {title}", seed=seed, machine=found.entry)
    return stated, found


def calibrate(
    machine: AnyMachine,
    data: Data | Mapping[str, object] | Sequence[Mapping[str, object]],
    tolerances: Widths,
    *,
    variants: Mapping[str, Mapping[str, object]] = EVERYTHING,
    seed: int = 1,
    name: str = "study",
    title: str | None = None,
    effort: str = "standard",
    out: Path | str | None = None,
    workers: int = 1,
    quiet: bool = False,
    **sections: object,
) -> StudyResult:
    """Return a machine calibrated from its readings: posteriors of all variants, ranked.

    Parameters
    ----------
    machine : Path, str, ReadingMachine or MachineFiles
        See `load_machine`.
    data : Data, mapping or sequence of mappings
        Readings; or one or several tables [[data]] of a config, such as targets, poses or points that an instrument
        measured, files in them as Paths or DataFrames. Their noise is in ``sensors``, their origin in ``provenance``.
    tolerances : mapping
        By symbol: standard deviation about nominal, mm and degrees (or as ``units`` says), one or one per leg; or a
        section such as ``{"prior": "uniform", "half_width": 0.5}``. What has none is known.
    variants : mapping of str to mapping
        Models to compare by name, each with the keys of a config's [[variants]].
    seed : int
    name, title : str
        Of the study.
    effort : str
        ``quick`` for a preliminary answer, ``standard`` or ``thorough``.
    out : Path or str, optional
        Folder for the results; by default they are gone with what is returned.
    workers : int
        Processes side by side; the numbers do not depend on it.
    quiet : bool
        Say nothing of the progress.
    **sections
        Further sections of a config of kind ``study``: ``error_terms``, ``noise_factor_log_sd``, ``model_error``,
        ``workspace``, ``validation``, ``sensitivity``, ``units``, ``sampler``, ``evidence`` ...; a file in them is a
        Path or a DataFrame.

    Raises
    ------
    InputError
        For anything at fault, with the line that the shell prints; nothing is written then.

    Examples
    --------
    >>> study = bc.calibrate(machine, data, tolerances, quiet=True)
    >>> print(study.summary["headline"])
    Use “Everything free”...
    >>> study.best.parameters[["parameter", "unit", "mean", "sd"]].head(2)
      parameter unit ...
    """
    stated, found = _begin("study", machine, name, "calibration", seed)
    stated.state(title=title or stated.content["title"], provenance=UNSTATED)
    if isinstance(data, Data):
        data.state(stated, _list_channels(found, sections.get("instruments")))
    elif isinstance(data, Mapping):
        stated.labels["data.0"] = "data"
        stated.state(data=[data])
    elif isinstance(data, Sequence) and all(isinstance(one, Mapping) for one in data):
        stated.state(data=list(data))
    else:  # nobody is held by annotations
        kind = type(data).__name__
        raise InputError(f"data: found a {kind}, expected Data(table, noise), which states the noise of its channels")
    _state_models(stated, tolerances, variants)
    stated.state(**sections)
    if effort != "standard":
        stated.content["sampler"] = {**stated.content.get("sampler", {}), "effort": effort}
    result = _run(stated, out, workers, quiet)
    assert isinstance(result, StudyResult)
    return result


def next_pose(
    study: StudyResult,
    requirements: Mapping[str, float] | None = None,
    candidates: int = 300,
    *,
    seed: int = 1,
    out: Path | str | None = None,
    quiet: bool = False,
    **sections: object,
) -> LoadedResults:
    """Return which pose to measure next, what it will bring, and whether to stop.

    Parameters
    ----------
    study : StudyResult
        Of `calibrate` or `load_results`.
    requirements : mapping of str to float, optional
        By the tool's numbers: the largest error allowed anywhere in the workspace.
    candidates : int
        How many random poses are tried.
    seed, out, quiet
        As for `calibrate`.
    **sections
        Further sections of a question: ``workspace``, ``goal`` ...

    Raises
    ------
    InputError
        Of results that keep no inputs, and for anything at fault.

    Examples
    --------
    >>> print(bc.next_pose(study, {"x": 0.04, "z": 0.04}, candidates=20, quiet=True).summary["headline"])
    Measure one more pose, candidate ... After 12 poses the probability that the requirements hold is ...
    """
    known = study.stated
    stated = StatedExperiment(files={**known.files, known.file: known.to_toml().encode()}, file=NEXT_POSE)
    stated.state(
        kind="next_pose",
        name="next_pose",
        title=f"{study.summary['title']}: the pose to measure next",
        seed=seed,
        study=known.file,
        variants=[study.best.name],
        requirements=requirements or {},
        candidates={"count": candidates},
        **sections,
    )
    return _run(stated, out, 1, quiet)


def simulate(
    machine: AnyMachine,
    noise: Noise,
    tolerances: Widths,
    n_poses: int = 25,
    *,
    seed: int = 1,
    **sections: object,
) -> Data:
    """Return readings of a machine drawn within its tolerances, with its true parameters; never measured.

    Parameters
    ----------
    machine, tolerances
        As for `calibrate`.
    noise : mapping
        By channel, in mm, rad or the channel's own unit; or a section as in a config.
    n_poses : int
        Poses of the workspace.
    seed : int
    **sections
        Further sections of a config of kind ``simulation``: ``workspace``, ``conditions`` ...

    Examples
    --------
    >>> data = bc.simulate(machine, noise, tolerances, n_poses=12)
    >>> data.table.shape, len(data.truth)
    ((12, 8), 9)
    """
    import pandas as pd

    from bayescal.experiments.runner.run import compute_experiment

    stated, found = _begin("simulation", machine, "simulated", "simulated readings", seed)
    source = {"status": "simulated", "text": "Simulated: one machine drawn within its tolerances, never measured"}
    sensors = describe_noise(noise, _list_channels(found, sections.get("instruments")), [])
    stated.state(
        provenance=source, n_poses=n_poses, sensors=sensors, parameters=_describe_widths(tolerances), **sections
    )
    with stated.named() as config:
        simulated = compute_experiment(config, stated.root)
    table = pd.read_csv(StringIO(str(simulated.files["readings.csv"])), comment="#")
    return Data(table, sensors, provenance=source, truth=simulated.tables["truth"])


def audit(
    machine: AnyMachine,
    noise: Noise,
    tolerances: Widths,
    poses: int = 40,
    *,
    requirements: Mapping[str, float] | None = None,
    variants: Mapping[str, Mapping[str, object]] = EVERYTHING,
    seed: int = 1,
    out: Path | str | None = None,
    workers: int = 1,
    quiet: bool = False,
    **sections: object,
) -> LoadedResults:
    """Return what planned readings would determine of a machine, before any are taken.

    Parameters
    ----------
    machine, noise, tolerances
        As for `simulate`.
    poses : int
        How many random poses of the workspace are planned.
    requirements : mapping of str to float, optional
        By the tool's numbers: the largest rms error over the workspace.
    variants : mapping
        Sets of sensors to judge, as in a config of kind ``audit``.
    seed, out, workers, quiet, **sections
        As for `calibrate`.

    Examples
    --------
    >>> noise = {"s": 0.005, "cam_x": 0.02, "cam_y": 0.02, "height": 0.01}  # mm, each of them
    >>> tolerances = {"x": 0.5, "y": 0.5, "l": 0.3}
    >>> plan = bc.audit(machine, noise, tolerances, poses=12, requirements={"x": 0.05}, quiet=True)
    >>> plan.folder.joinpath("report.html").is_file()
    True
    """
    stated, found = _begin("audit", machine, "audit", "audit", seed)
    _state_models(stated, tolerances, variants)
    stated.state(
        sensors=describe_noise(noise, _list_channels(found, sections.get("instruments")), []),
        poses={"count": poses},
        requirements=requirements or {},
        requirement_applies_to="rms",
        **sections,
    )
    return _run(stated, out, workers, quiet)


def _run(stated: StatedExperiment, out: Path | str | None, workers: int, quiet: bool) -> LoadedResults:
    """Return an experiment's results, in memory where no folder is named."""
    from bayescal.experiments.runner.run import run_experiment as run

    with stated.named() as config:
        place = None if out is None else Path(out)
        return wrap_results(run(config, stated.root, place, workers, quiet=quiet).results, trust=True, made_of=stated)


def _state_models(stated: StatedExperiment, tolerances: Widths, variants: Mapping[str, Mapping[str, object]]) -> None:
    """Add what is uncertain of a machine, and the models that are compared."""
    stated.labels.update({f"variants.{k}": f"variants.{name}" for k, name in enumerate(variants)})
    stated.labels.update({f"parameters.{name}.sd": f"tolerances.{name}" for name in tolerances})
    listed = [{"name": key, "title": key, **one} for key, one in variants.items()]
    stated.state(parameters=_describe_widths(tolerances), variants=listed)
