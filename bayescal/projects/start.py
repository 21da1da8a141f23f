"""`bayescal init`: a folder with a machine, its measurements and configs, to be changed until they are one's own."""

from __future__ import annotations

import shutil
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from jinja2 import Environment, FileSystemLoader, StrictUndefined

from bayescal.config.load import look_up
from bayescal.config.trust import list_code, remember, vouch
from bayescal.errors import InputError
from bayescal.experiments.runner.load import load
from bayescal.experiments.runner.run import compute_experiment
from bayescal.files.atomic import make_directory, write_atomically
from bayescal.importers import Project, import_file

TEMPLATES = Path(__file__).parent / "templates"
OWN = "own"
INSTRUMENTS = {
    "targets": "photogrammetry of targets",
    "poses": "measured poses",
    "points": "tracked points on the platform",
}
LEFT_OUT = {"probe.csv": ("targets", "poses"), "audit_measured.toml": ("points",)}
"""Instruments of whose projects a file is none; audits take whole poses that were measured, no points."""
MEANINGS = {
    **{"a_x": "base joints", "a_y": "the same", "a_z": "the same", "b_x": "platform joints"},
    **{"b_y": "the same", "b_z": "the same", "l": "leg lengths"},
    **{"u_x": "actuator directions", "u_y": "the same"},
}
JOINTS = ("a_x", "a_y", "a_z", "b_x", "b_y", "b_z")
ON_RAILS = MEANINGS | {"a_z": "the same; along the rail: carriage zero"}


@dataclass(frozen=True)
class ExampleHexapod:
    """A made-up machine on six legs: dimensions in mm and degrees as TOML has them, tolerances by symbol.

    All that its model has is free, but for what no measurement could tell from the rest, of which ``left_out`` speaks.
    """

    title: str
    model: str
    base_radius: float
    platform_radius: float
    home: list[float]
    initial: float
    range: float
    tolerances: Mapping[str, float]
    left_out: str
    meanings: Mapping[str, str] = field(default_factory=lambda: MEANINGS)
    base_azimuth: tuple[float, ...] = (350.0, 10.0, 110.0, 130.0, 230.0, 250.0)
    platform_azimuth: tuple[float, ...] = (310.0, 50.0, 70.0, 170.0, 190.0, 290.0)


MACHINES: dict[str, ExampleHexapod | None] = {
    "hexapod": ExampleHexapod(
        *("A made-up hexapod", "six_ups", 300.0, 180.0, [0.0, 0.0, 380.0], 450.0, 40.0),
        tolerances=dict.fromkeys(JOINTS, 0.2) | {"l": 0.5},
        left_out="an actuator's zero is not free: l has its effect",
    ),
    "carriages": ExampleHexapod(
        *("A made-up machine on six carriages", "six_pus", 250.0, 120.0, [0.0, 0.0, 400.0], 0.0, 40.0),
        tolerances=dict.fromkeys(JOINTS, 0.2) | {"l": 0.5, "u_x": 0.001, "u_y": 0.001},
        left_out="rho0 stays as drawn: no measurement distinguishes it from a along its rail",
        meanings=ON_RAILS,
    ),
    OWN: None,
}
"""Machines to begin with; none of the first ones is one function, a user-defined class.

Those on legs are simulated at the same poses, tables in `templates/legs`: points of a scrambled Halton sequence, which
fill six tenths of the actuators' range. Drawing them takes scipy.stats, a third of `init`'s time.
"""


def start_project(folder: Path, machine: str, instrument: str | None) -> list[Path]:
    """Write a project with simulated measurements into a new or an empty folder, and return its files.

    The machine is one of `MACHINES`, the instrument one of `INSTRUMENTS`, None for a machine of one function, which
    brings its sensors. InputError for another one, and for a folder that holds something; nothing is written then.
    """
    kind = look_up(MACHINES, machine, "--machine")
    if kind is None and instrument is not None:
        raise InputError(f"init: --instrument: found {instrument!r}, expected none with machine {machine!r}")
    if kind is not None:
        look_up(INSTRUMENTS, instrument or "none", "--instrument")
    _check_empty(folder)
    partial = folder.absolute().with_name(f"{folder.absolute().name}.partial")
    make_directory(partial)
    try:
        _write_files(partial, kind, machine, instrument)
        vouch(path.read_bytes() for path in list_code(partial))
        make_directory(partial / "data")
        for name, text in compute_experiment(load(partial / "simulate.toml")[1], partial).files.items():
            write_atomically(partial / "data" / name, str(text).encode())
        make_directory(folder)
        for path in partial.iterdir():
            path.replace(folder / path.name)
    finally:
        shutil.rmtree(partial, ignore_errors=True)
    with suppress(OSError):  # where nothing can be kept, its code is asked for as any other
        remember(list_code(folder))
    return sorted(path for path in folder.rglob("*") if path.is_file())


def start_from(folder: Path, path: Path, options: Mapping[str, str]) -> tuple[list[Path], Project]:
    """Write a project made of another program's file into a new or an empty folder; return its files and what is said.

    InputError for a file of no known format or without what a project needs, and for a folder that holds something;
    nothing is written then.
    """
    _check_empty(folder)
    project = import_file(path, options)
    for name, content in project.files.items():
        make_directory((folder / name).parent)
        write_atomically(folder / name, content)
    return [folder / name for name in sorted(project.files)], project


def _check_empty(folder: Path) -> None:
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise InputError(f"{folder}: expected a new or empty folder")


def _write_files(folder: Path, kind: ExampleHexapod | None, machine: str, instrument: str | None) -> None:
    source = TEMPLATES / (OWN if kind is None else "legs")
    files = {path.name: path for path in sorted(source.iterdir()) if path.is_file()}
    if kind is None:
        for name, path in files.items():
            write_atomically(folder / name, path.read_bytes())
        return
    loader = Environment(loader=FileSystemLoader(source), undefined=StrictUndefined, keep_trailing_newline=True)
    rng, n_legs = np.random.default_rng(1), len(kind.base_azimuth)
    offsets = {symbol: (sd * rng.standard_normal(n_legs)).round(5).tolist() for symbol, sd in kind.tolerances.items()}
    known = {
        **vars(kind),
        **{"base_azimuth": list(kind.base_azimuth), "platform_azimuth": list(kind.platform_azimuth)},
        **{"name": machine, "machine": machine, "instrument": instrument, "by": INSTRUMENTS[str(instrument)]},
        **{"offsets": offsets, "free": str(list(kind.tolerances)).replace("'", '"')},
    }
    for name in files:
        if instrument not in LEFT_OUT.get(name, ()):
            write_atomically(folder / name, loader.get_template(name).render(known).encode())
