"""The way in from Python: a machine, a table of readings, tolerances.

Everything here writes the files that the shell runs, and runs these: the same numbers come out of both.
"""

from __future__ import annotations

import ast
import inspect
import shutil
import tempfile
import weakref
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from functools import cached_property
from io import StringIO
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from bayescal.calibrated.exported import keep_machines
from bayescal.config.load import read_toml
from bayescal.config.local_imports import find_local_imports
from bayescal.config.sections import ExperimentConfig, Section
from bayescal.config.trust import vouch
from bayescal.errors import InputError, name_faults
from bayescal.experiments.frame.load import load
from bayescal.files.csv_tables import read_table
from bayescal.files.toml import write_toml
from bayescal.loaded import LoadedResults, StudyResult, Table, load_results, name_rows
from bayescal.machines.mechanism import Mechanism
from bayescal.machines.read import load_mechanism, read_reading_model
from bayescal.machines.readings import Channel, ReadingMachine, ReadingModel
from bayescal.machines.readings.legs import list_leg_channels
from bayescal.numerics.units import units_like

if TYPE_CHECKING:
    import pandas as pd  # tables need it, naming things does not

MACHINE, CONFIG, READINGS = "machine.toml", "study.toml", "readings.csv"
UNSTATED = {"status": "unstated", "text": "a table given in Python"}
EVERYTHING = {"everything": {"title": "Everything free"}}

type Widths = Mapping[str, float | Sequence[float] | Mapping[str, Any]]
"""By symbol: a standard deviation, one per leg, or a section as in a config."""
type AnyMachine = Path | str | ReadingMachine | type[ReadingMachine] | MachineFiles


# --- machines --------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False, repr=False)
class MachineFiles:
    """A machine with the files that it is read from, by their names in one folder; see `load_machine`.

    ``seen`` is what it reads; of a mechanism's file the legs alone, whose parameters depend on a variant's model.
    """

    files: dict[str, bytes]
    entry: str  # the machine's own file
    seen: ReadingModel | Mechanism

    @property
    def model(self) -> ReadingModel:
        """The machine by its channels; InputError for a mechanism's file, which has none by itself."""
        if isinstance(self.seen, Mechanism):
            raise InputError(
                f"{self.entry}: found a mechanism, whose parameters depend on a variant's model, expected kind = 'legs'"
            )
        return self.seen

    @property
    def channels(self) -> Sequence[Channel]:
        """Its channels; of a mechanism's file those of its legs, whatever model they are seen by."""
        seen = self.seen
        return list_leg_channels(seen.n_legs, inclined=True) if isinstance(seen, Mechanism) else seen.channels

    @property
    def name(self) -> str:
        """Its name."""
        return str(getattr(self.seen, "name", self.entry))

    @property
    def parameters(self) -> pd.DataFrame:
        """Nominal values of its parameters, with their units."""
        import pandas as pd

        layout = self.model.layout
        return pd.DataFrame({"parameter": layout.names, "nominal": layout.nominal, "unit": layout.units})

    def read(self, pose: Any, parameters: Any = None, **given: Any) -> pd.DataFrame:
        """Return what its channels read at poses (P, q), of the nominal machine or of parameters (D,).

        What a class's `given` names is stated by keywords, a number or one for each pose.
        """
        import pandas as pd

        pose = np.atleast_2d(np.asarray(pose, dtype=np.float64))
        theta = self.model.layout.nominal if parameters is None else np.asarray(parameters, dtype=np.float64)
        known = {name: np.broadcast_to(np.asarray(value, np.float64), len(pose)) for name, value in given.items()}
        columns = [f"{one.stem}_{one.unit}" for one in self.model.channels]
        return pd.DataFrame(self.model.read(theta, pose, known), columns=columns)

    def write(self, folder: Path) -> None:
        """Write the files to a folder."""
        for name, content in self.files.items():
            path = folder / name
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(content)

    def __repr__(self) -> str:
        if isinstance(self.seen, Mechanism):
            return f"mechanism {self.name!r}: {self.seen.n_legs} legs"
        model = self.seen
        tool = ", ".join(one.name for one in model.tool_channels) if model.states_tool else "not stated"
        return (
            f"machine {self.name!r}: {model.layout.size} parameters ({', '.join(model.layout.symbols)}), "
            f"channels {', '.join(model.names)}, coordinates {', '.join(one.name for one in model.coordinates)}, "
            f"tool {tool}"
        )


def load_machine(machine: AnyMachine) -> MachineFiles:
    """Return a machine: of its TOML file, or of a class of one's own, or an instance of it.

    Raises
    ------
    InputError
        For anything wrong with the file or the class, and for code that a file names and nobody has trusted (`trust`).

    Examples
    --------
    >>> import bayescal as bc
    >>> machine = bc.load_machine("examples/own_machine/machine.toml")
    >>> machine
    machine 'delta': 14 parameters (x, y, l, s0, t_x, t_y), channels s[1], s[2], s[3], cam_x, cam_y, height,
    coordinates x, y, z, tool x, y, z
    >>> machine.read([0.0, 0.0, 30.0]).round(3)
       s_1_mm  s_2_mm  s_3_mm  cam_x_mm  cam_y_mm  height_mm
    ...
    """
    if isinstance(machine, MachineFiles):
        return machine
    if isinstance(machine, str | Path):
        path = Path(machine)
        legs = isinstance(read_toml(path)[0].get("legs"), dict)
        seen = load_mechanism(path) if legs else read_reading_model(path)
        files, names = keep_machines([path])
        return MachineFiles(files, names[path], seen)
    found = machine if isinstance(machine, type) else type(machine)
    config = getattr(machine, "config", None)
    section = config.model_dump(exclude_none=True) if isinstance(config, Section) else {}
    with tempfile.TemporaryDirectory() as folder:
        module, files = _list_sources(found)
        content = {"kind": f"{module}:{found.__qualname__}", "name": found.__name__.lower(), "title": found.__name__}
        files[MACHINE] = write_toml(content | ({"machine": section} if section else {})).encode()
        vouch(files.values())  # whoever has the class has run its code
        MachineFiles(files, MACHINE, None).write(Path(folder))  # type: ignore[arg-type]  # only its files are written
        with _leave_out(Path(folder)):
            return MachineFiles(files, MACHINE, read_reading_model(Path(folder) / MACHINE))


def _list_sources(found: type) -> tuple[str, dict[str, bytes]]:
    """Return the name of the file that a class stands in, and that with the files it imports from beside itself."""
    try:
        path = Path(inspect.getsourcefile(found) or "")
    except (OSError, TypeError):
        path = Path()
    if not path.is_file():
        raise InputError(
            f"class {found.__name__}: found no file that defines it, expected one: write it to a file beside the "
            "notebook and import it from there"
        )
    name, content = path.name, path.read_bytes()
    if found.__module__ == "__main__":  # a script is not run again for the sake of a class
        name, content = f"{path.stem}.py", _extract(content.decode(), found.__name__).encode()
    return name, {name: content} | {one.name: one.read_bytes() for one in find_local_imports(path).values()}


def _extract(source: str, name: str) -> str:
    """Return the definition of a class with what it uses of its module, and all imports."""
    tree = ast.parse(source)
    defined: dict[str, ast.stmt] = {}
    for node in tree.body:
        if isinstance(node, ast.FunctionDef | ast.ClassDef):
            defined[node.name] = node
        targets = node.targets if isinstance(node, ast.Assign) else [getattr(node, "target", None)]
        for target in (one for whole in targets if whole is not None for one in ast.walk(whole)):
            if isinstance(target, ast.Name):
                defined[target.id] = node
    wanted, waiting = set(), [name]
    while waiting:
        one = waiting.pop()
        if one in defined and one not in wanted:
            wanted.add(one)
            waiting += [node.id for node in ast.walk(defined[one]) if isinstance(node, ast.Name)]
    kept = {id(defined[one]) for one in wanted}
    body = [n for n in tree.body if isinstance(n, ast.Import | ast.ImportFrom) or id(n) in kept]
    return "\n\n".join(ast.unparse(node) for node in body) + "\n"


# --- data ------------------------------------------------------------------------------------------------------------


class Data:
    """Readings of a machine.

    Parameters
    ----------
    table : DataFrame or mapping of its columns, or the CSV file of one
        A row a pose; columns by channel and unit such as ``s_1_mm``, what is given of each row, and optionally ``pose``
        (names; else the index) and ``use`` (``calibration`` or ``verification``). Empty cells were not read.
    noise : mapping
        By channel, or kind of channels: the standard deviation of a reading, in the unit of its column, one or one
        each; or a section as in a config, ``{"noise_um": 5.0, "group": "camera"}``.
    commanded, hold_back : sequence of str
        Channels that the machine was commanded by; poses that are kept for verification.
    origin : str or mapping
        Where they come from: a sentence, or a section [origin] as in a config.
    truth : DataFrame, optional
        The true parameters, of simulated readings.

    Examples
    --------
    >>> bc.Data(data.table, noise, hold_back=["C001", "C002"])
    data: 12 rows of s, cam_x, cam_y, height; a table given in Python
    """

    def __init__(
        self,
        table: Table,
        noise: Mapping[str, Any],
        commanded: Sequence[str] = (),
        hold_back: Sequence[str] = (),
        origin: str | Mapping[str, Any] = UNSTATED["text"],
        truth: pd.DataFrame | None = None,
    ) -> None:
        self.source = Path(table) if isinstance(table, str | Path) else name_rows(table)
        self.noise, self.commanded, self.hold_back, self.truth = noise, commanded, hold_back, truth
        self.origin = {**UNSTATED, "text": origin} if isinstance(origin, str) else _plain(origin)

    @cached_property
    def table(self) -> pd.DataFrame:
        """The readings, a row a pose."""
        import pandas as pd

        return pd.read_csv(self.source, comment="#") if isinstance(self.source, Path) else self.source

    def write(self, folder: Path, channels: Sequence[Channel]) -> dict[str, Any]:
        """Write the table into a folder; return the sections of a config that tell of it, for a machine's channels."""
        path = _put(self.source, folder / "data", READINGS)
        columns: Sequence[str] = ()
        with suppress(InputError):  # the reader of the config says it better
            columns = read_table(path, None).columns
        read = [name for name in self.noise if any(name in (one.name, one.kind) for one in channels)]
        told = {"channels": read, "commanded": self.commanded, "hold_back": self.hold_back}
        section = {"file": f"data/{path.name}", **{key: list(one) for key, one in told.items() if len(one)}}
        return {"origin": self.origin, "data": [section], "sensors": describe_noise(self.noise, channels, columns)}

    def __repr__(self) -> str:
        return f"data: {len(self.table)} rows of {', '.join(self.noise)}; {self.origin['text']}"


def describe_noise(
    noise: Mapping[str, Any], channels: Sequence[Channel], columns: Sequence[str]
) -> dict[str, dict[str, Any]]:
    """Return the sections [sensors] of noises by channel or kind, in the units of their columns where there are any.

    What is wrong with names, columns and numbers says who reads the config.
    """
    found: dict[str, dict[str, Any]] = {}
    for name, value in noise.items():
        channel = next((one for one in channels if name in (one.name, one.kind)), None)
        if isinstance(value, Mapping) or channel is None:
            found[name] = _plain(value) if isinstance(value, Mapping) else {"noise": _plain(value)}
            continue
        units = units_like(channel.unit)
        factor = next((units[unit] for unit in units if f"{channel.stem}_{unit}" in columns), 1.0)
        key = f"noise_{channel.unit}" if channel.unit in ("mm", "rad") else "noise"
        try:
            found[name] = {key: (factor * np.asarray(value, dtype=np.float64)).tolist()}
        except (TypeError, ValueError):
            found[name] = {key: value}
    return found


def _plain(value: Any, folder: Path = Path(), name: str = "") -> Any:
    """Return a value with Python's own numbers, lists and mappings; files and tables as names of their copies."""
    if isinstance(value, Mapping):
        return {str(key): _plain(one, folder, str(key)) for key, one in value.items() if one is not None}
    if isinstance(value, np.ndarray | np.generic):
        return _plain(value.tolist())
    if isinstance(value, Path) or hasattr(value, "to_csv"):
        return f"data/{_put(value, folder / 'data', f'{name}.csv').name}"
    return [_plain(one, folder, name) for one in value] if isinstance(value, list | tuple) else value


def _put(table: Path | pd.DataFrame, folder: Path, name: str) -> Path:
    """Write a table, or a copy of a file by its own name, into a folder beside what stands there; its path."""
    name = table.name if isinstance(table, Path) else name
    path = folder / name
    while path.exists():
        path = path.with_stem(f"{path.stem}_")
    folder.mkdir(parents=True, exist_ok=True)
    if not isinstance(table, Path):
        name_rows(table).to_csv(path, index=False)
    elif table.is_file():  # of one that is not there the reader says so
        shutil.copyfile(table, path)
    return path


def _describe_widths(tolerances: Widths) -> dict[str, dict[str, Any]]:
    return {
        name: _plain(value) if isinstance(value, Mapping) else {"prior": "normal", "sd": _plain(value)}
        for name, value in tolerances.items()
    }


def _describe_variants(variants: Mapping[str, Mapping[str, Any]]) -> list[dict[str, Any]]:
    return [{"name": key, "title": key, **_plain(one)} for key, one in variants.items()]


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
        Of dask, whose workers compute in place of processes: an address, a scheduler's JSON file, or ``local:N``.

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
    from bayescal.experiments.frame.run import run_experiment as run

    if isinstance(experiment, ExperimentConfig):
        config, path = experiment, Path(folder)
    else:
        config, path = load(Path(experiment))[1], Path(experiment)
        folder = path.parent
    where = Path("results") / config.name if out is None else Path(out)
    with name_faults(path):
        run(config, Path(folder), where, workers, resume, quiet, scheduler)
    return load_results(where, trust=True)


@dataclass(frozen=True, eq=False)
class _Project:
    """A folder with a config and its files, which is there for as long as what was made in it."""

    machine: MachineFiles

    @cached_property
    def folder(self) -> Path:
        """The folder; gone with this object."""
        found = tempfile.mkdtemp(prefix="bayescal-")
        weakref.finalize(self, shutil.rmtree, found, ignore_errors=True)
        return Path(found)

    def write(self, content: Mapping[str, Any], name: str = CONFIG) -> Path:
        """Write machine and config, without empty sections; return the config's file."""
        self.machine.write(self.folder)
        path = self.folder / name
        path.write_text(write_toml({key: one for key, one in content.items() if one != {}}), encoding="utf-8")
        return path

    def run(
        self, content: Mapping[str, Any], out: Path | str | None, workers: int, quiet: bool, name: str = CONFIG
    ) -> LoadedResults:
        """Run an experiment; its results."""
        path = self.write(content, name)
        with _leave_out(self.folder):
            where = self.folder / "results" / path.stem if out is None else out
            return replace(run_experiment(path, where, workers=workers, quiet=quiet), project=self)


@contextmanager
def _leave_out(folder: Path) -> Iterator[None]:
    """Leave a folder that nobody knows out of messages about what is in it."""
    try:
        yield
    except InputError as error:
        raise InputError(str(error).replace(f"{folder.resolve()}/", "").replace(f"{folder}/", "")) from None


def calibrate(
    machine: AnyMachine,
    data: Data | Mapping[str, Any],
    tolerances: Widths,
    *,
    variants: Mapping[str, Mapping[str, Any]] = EVERYTHING,
    seed: int = 1,
    name: str = "study",
    title: str | None = None,
    out: Path | str | None = None,
    workers: int = 1,
    quiet: bool = False,
    **sections: Any,
) -> StudyResult:
    """Return a machine calibrated from its readings: posteriors of all variants, ranked.

    Parameters
    ----------
    machine : Path, str, ReadingMachine or MachineFiles
        See `load_machine`.
    data : Data or mapping
        Readings; or the section [data] of a config with what an instrument measured of a mechanism's platform (targets,
        poses, points), files in it as Paths or DataFrames, and [origin] in ``origin``.
    tolerances : mapping
        By symbol: standard deviation about nominal, mm and degrees (or as ``units`` says), one or one per leg; or a
        section such as ``{"prior": "uniform", "half_width": 0.5}``. What has none is known.
    variants : mapping of str to mapping
        Models to compare by name, each with the keys of a config's [[variants]].
    seed : int
    name, title : str
        Of the study.
    out : Path or str, optional
        Folder for the results; by default they are gone with what is returned.
    workers : int
        Processes side by side; the numbers do not depend on it.
    quiet : bool
        Say nothing of the progress.
    **sections
        Further sections of a config of kind ``study``: ``errors``, ``unknown_noise``, ``model_error``,
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
    found = load_machine(machine)
    project = _Project(found)
    folder = project.folder
    content = {
        "kind": "study",
        "name": name,
        "title": title or f"{found.name}: calibration",
        "seed": seed,
        "machine": found.entry,
        "origin": UNSTATED,
        **(data.write(folder, found.channels) if isinstance(data, Data) else {"data": _plain(data, folder)}),
        "parameters": _describe_widths(tolerances),
        "variants": _describe_variants(variants),
        **_plain(sections, project.folder),
    }
    result = project.run(content, out, workers, quiet)
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
    **sections: Any,
) -> LoadedResults:
    """Return which pose to measure next, what it will bring, and whether to stop.

    Parameters
    ----------
    study : StudyResult
        Of `calibrate`.
    requirements : mapping of str to float, optional
        By the tool's numbers: the largest error allowed anywhere in the workspace.
    candidates : int
        How many random poses are tried.
    seed, out, quiet
        As for `calibrate`.
    **sections
        Further sections of a question: ``workspace``, ``aim`` ...

    Raises
    ------
    InputError
        Of results that were loaded: ``bayescal next`` takes their config.

    Examples
    --------
    >>> print(bc.next_pose(study, {"x": 0.04, "z": 0.04}, candidates=20, quiet=True).summary["headline"])
    Measure one more pose, candidate ...: after 12 poses the requirements hold...
    """
    if not isinstance(study.project, _Project):
        raise InputError(f"{study.folder}: found loaded results, expected those of calibrate; or bayescal next")
    content = {
        "name": "next",
        "title": f"{study.summary['title']}: the pose to measure next",
        "seed": seed,
        "study": CONFIG,
        "variants": [study.best.name],
        "requirements": _plain(requirements or {}),
        "candidates": {"count": candidates},
        **_plain(sections, study.project.folder),
    }
    return study.project.run(content, out, 1, quiet, "next.toml")


def simulate(
    machine: AnyMachine,
    noise: Mapping[str, Any],
    tolerances: Widths,
    n_poses: int = 25,
    *,
    seed: int = 1,
    **sections: Any,
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
        Further sections of a config of kind ``simulation``: ``workspace``, ``given`` ...

    Examples
    --------
    >>> data = bc.simulate(machine, noise, tolerances, n_poses=12)
    >>> data.table.shape, len(data.truth)
    ((12, 8), 9)
    """
    import pandas as pd

    from bayescal.experiments.frame.run import compute_experiment

    found = load_machine(machine)
    project = _Project(found)
    content = {
        "kind": "simulation",
        "name": "simulated",
        "title": f"{found.name}: simulated readings",
        "origin": {"status": "simulated", "text": "Simulated: one machine drawn within its tolerances, never measured"},
        "seed": seed,
        "machine": found.entry,
        "n_poses": n_poses,
        "sensors": describe_noise(noise, found.channels, []),
        "parameters": _describe_widths(tolerances),
        **_plain(sections, project.folder),
    }
    path = project.write(content)
    with _leave_out(project.folder), name_faults(path):
        simulated = compute_experiment(load(path)[1], project.folder)
    table = pd.read_csv(StringIO(str(simulated.files["readings.csv"])), comment="#")
    return Data(table, content["sensors"], origin=content["origin"], truth=simulated.tables["truth"])


def audit(
    machine: AnyMachine,
    noise: Mapping[str, Any],
    tolerances: Widths,
    poses: int = 40,
    *,
    requirements: Mapping[str, float] | None = None,
    variants: Mapping[str, Mapping[str, Any]] = EVERYTHING,
    seed: int = 1,
    out: Path | str | None = None,
    workers: int = 1,
    quiet: bool = False,
    **sections: Any,
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
    found = load_machine(machine)
    project = _Project(found)
    content = {
        "kind": "audit",
        "name": "audit",
        "title": f"{found.name}: audit",
        "seed": seed,
        "machine": found.entry,
        "sensors": describe_noise(noise, found.channels, []),
        "parameters": _describe_widths(tolerances),
        "poses": {"count": poses},
        "requirements": _plain(requirements or {}),
        "required_of": "rms",
        "variants": _describe_variants(variants),
        **_plain(sections, project.folder),
    }
    return project.run(content, out, workers, quiet)
