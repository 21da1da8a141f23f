"""The one reader of machine files: mechanisms on legs, platforms on sliding legs, machines of one function."""

from __future__ import annotations

import os
from collections.abc import Iterable
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import create_model

from bayescal.config.classes import ClassReference, choose, find_classes, find_files, name_failures
from bayescal.config.load import check_section, find_line, read_toml
from bayescal.config.registry import find_class, is_own, list_references, list_sources
from bayescal.config.sections import Section
from bayescal.errors import InputError, name_faults
from bayescal.files.csv_tables import read_matrix
from bayescal.machines.deformations import Deformation, NominalDeformation
from bayescal.machines.kinematics import Machine, check_drive, check_home_pose
from bayescal.machines.mechanism import BeamSection, ExternalLoad, Flexures, Mechanism, section_of_rod
from bayescal.machines.models import KinematicModel
from bayescal.machines.parameters import HomeStart
from bayescal.machines.readings import FunctionModel, Legs, ReadingMachine, ReadingModel
from bayescal.machines.readings.places import TwoPlaces
from bayescal.machines.schema import (
    BeamSectionConfig,
    HomeConfig,
    LegsMachineConfig,
    LoadConfig,
    MachineFileConfig,
    MechanismConfig,
    PointsConfig,
    TargetRingConfig,
)
from bayescal.numerics.geometry import Array

MPA_PER_GPA = 1e3
UPWARDS = [0.0, 0.0, 1.0]
RING_DECIMALS = 6
LEGS = "legs"
SHORTEST = 1e-6  # mm; what rounding leaves of no length is less


def load_mechanism(path: Path) -> Mechanism:
    """Return the mechanism that a TOML file describes, lengths in mm.

    InputError where the file is not a mechanism, or its lists do not have one entry per leg.
    """
    content, text = read_toml(path)
    if isinstance(content.get("kind"), str):
        raise InputError(
            f"{path}: kind: found {content['kind']!r}, expected a machine on legs; [[data]] calibrates others"
        )
    config = check_section(MechanismConfig, content, path, text)
    home, base = _home(config, path, text), points_of(config.base)
    legs = _legs(config, base, home, path)
    try:
        return Mechanism(
            name=config.name,
            base_points=base,
            platform_points=legs["platform"],
            directions=legs["legs.direction"],
            leg_lengths=legs["legs.length_mm"],
            initial_actuator_positions=legs["legs.initial_actuator_position_mm"],
            actuator_range=config.legs.actuator_range_mm,
            flexures=_flexures(config, legs),
            load=_load(config.load),
            drive=config.legs.actuated_joint,
            home_position=home.position,
            platform_below=home.below,
            actuator_gains=legs.get("legs.actuator_gain"),
        )
    except InputError as error:
        raise InputError(f"{path}: {error}") from error


def _legs(config: MechanismConfig, base: Array, home: HomeStart, path: Path) -> dict[str, Array]:
    """Return what there is of every leg, shapes (N, ...), by the names of the fields."""
    n_legs = len(base)
    given = 0.0 if config.legs.length_mm is None else config.legs.length_mm
    columns = {
        "platform": points_of(config.platform),
        "legs.length_mm": np.atleast_1d(np.array(given, dtype=np.float64)),
        "legs.direction": _directions(config, path),
        "legs.initial_actuator_position_mm": np.atleast_1d(np.array(config.legs.initial_actuator_position_mm)),
    }
    if config.legs.actuator_gain is not None:
        columns["legs.actuator_gain"] = np.atleast_1d(np.array(config.legs.actuator_gain, dtype=np.float64))
    if config.flexures is not None:
        columns["flexures.length_mm"] = np.atleast_1d(np.array(config.flexures.length_mm))
        columns["flexures.beta"] = np.atleast_1d(np.array(config.flexures.beta))
    for field, values in columns.items():
        if len(values) not in ((1, n_legs) if field != "platform" else (n_legs,)):
            raise InputError(f"{path}: {field}: found {len(values)} legs, expected {n_legs} as in base")
    if config.legs.length_mm is None:
        travel = columns["legs.initial_actuator_position_mm"][:, None] * columns["legs.direction"]
        lengths = np.linalg.norm(np.array(home.position) + columns["platform"] - (base + travel), axis=1)
        if np.any(lengths < SHORTEST):
            leg = int(np.argmin(lengths)) + 1
            raise InputError(f"{path}: home.position_mm: found leg {leg} of length zero, expected distinct joints")
        columns["legs.length_mm"] = lengths
    if config.flexures is not None:
        lengths, flexures = np.broadcast_arrays(columns["legs.length_mm"], columns["flexures.length_mm"])
        if np.any(flexures >= lengths):
            leg = int(np.argmax(flexures >= lengths))
            raise InputError(
                f"{path}: flexures.length_mm: found {flexures[leg]:g} mm, expected less than its leg, "
                f"{lengths[leg]:g} mm"
            )
    return {field: np.broadcast_to(v, (n_legs, *v.shape[1:])) for field, v in columns.items()}


def _directions(config: MechanismConfig, path: Path) -> Array:
    """Return unit vectors, shape (1 or N, 3); zeros for struts."""
    if config.legs.actuated_joint == "strut":
        return np.zeros((1, 3))
    given = UPWARDS if config.legs.direction is None else config.legs.direction
    directions = np.atleast_2d(np.array(given, dtype=np.float64))
    norms = np.linalg.norm(directions, axis=1, keepdims=True)
    if np.any(norms == 0):
        raise InputError(f"{path}: legs.direction: found zero, expected a direction")
    return directions / norms


def _home(config: MechanismConfig, path: Path, text: str) -> HomeStart:
    """Return where the machine stands at home: by its position, or by the legs' lengths."""
    line = find_line(text, ["legs"])
    field = f"{path}, line {line}: legs.length_mm" if line else f"{path}: legs.length_mm"
    home = config.home or HomeConfig(platform="above")
    if home.position_mm is None:
        if config.legs.length_mm is None:
            raise InputError(f"{field}: missing, expected it, or home.position_mm")
        if home.initial_guess_mm is not None:
            x, y, z = home.initial_guess_mm
            return HomeStart((x, y, z))
        return HomeStart(below=home.platform == "below")
    if config.legs.length_mm is not None:
        raise InputError(f"{field}: found lengths and [home], expected either")
    x, y, z = home.position_mm
    return HomeStart((x, y, z))


def _flexures(config: MechanismConfig, full: dict[str, Array]) -> Flexures | None:
    if config.flexures is None:
        return None
    sections = [_section(config.stiffness.flexure), _section(config.stiffness.leg)] if config.stiffness else []
    return Flexures(full["flexures.length_mm"], full["flexures.beta"], *sections)


def _section(config: BeamSectionConfig) -> BeamSection:
    if config.diameter_mm is None:
        return BeamSection(config.k1_n_mm2 or 0.0, config.k2_n or 0.0, config.k3_n_mm2 or 0.0)
    young, shear = config.young_modulus_gpa or 0.0, config.shear_modulus_gpa or 0.0
    return section_of_rod(config.diameter_mm, MPA_PER_GPA * young, MPA_PER_GPA * shear)


def _load(config: LoadConfig) -> ExternalLoad:
    fx, fy, fz = config.force_n
    mx, my, mz = config.moment_n_mm
    gx, gy, gz = (config.mass_kg * g for g in config.gravity_m_s2)
    cx, cy, cz = config.centre_of_mass_mm
    return ExternalLoad((fx, fy, fz), (mx, my, mz), (gx, gy, gz), (cx, cy, cz))


def points_of(config: PointsConfig | list[TargetRingConfig]) -> Array:
    """Return points of a body, shape (n, 3), mm, those of rings with the digits that are written of them."""
    if isinstance(config, list):
        turns = [np.radians(ring.azimuth_deg) + 2 * np.pi * np.arange(ring.count) / ring.count for ring in config]
        rings = [_on_circle(ring.radius_mm, turn, ring.height_mm) for ring, turn in zip(config, turns, strict=True)]
        return np.round(np.concatenate(rings), RING_DECIMALS)
    if config.points_mm is not None:
        return np.array(config.points_mm, dtype=np.float64)
    return _on_circle(config.radius_mm or 0.0, np.radians(config.azimuth_deg or []), config.height_mm)


def _on_circle(radius: float, azimuth: Array, height: float) -> Array:
    return np.stack([radius * np.cos(azimuth), radius * np.sin(azimuth), np.full_like(azimuth, height)], axis=1)


def build_named_machine(
    mechanism: Mechanism,
    file: Path,
    model: str,
    deformation: str,
    nominal: NominalDeformation,
    field: str,
    folder: Path,
) -> Machine:
    """Return a mechanism, read from a file, seen through a model and a deformation by their names in a config.

    ``field`` says where the names stand; names of files start at ``folder``. InputError for an unknown name, a
    mechanism that is not one for the model, and somebody else's class that fails.
    """
    chosen = choose_model(model, f"{field}.model", folder)
    kind: ClassReference[Deformation] = choose("DEFORMATIONS", deformation, Deformation, f"{field}.deformation", folder)  # type: ignore[type-abstract]
    with name_failures(kind.found, f"{field}.deformation"):
        seen = kind.make(nominal)
        seen.blocks(mechanism.n_legs)
    with name_failures(chosen.found, f"{field}.model"), name_faults(file):
        return build_chosen_machine(chosen, mechanism, seen)


def choose_model(model: str, field: str, folder: Path) -> ClassReference[KinematicModel]:
    """Return the kinematic model that a config names, with its options."""
    return choose("MODELS", model, KinematicModel, field, folder)  # type: ignore[type-abstract]


def build_chosen_machine(
    chosen: ClassReference[KinematicModel], mechanism: Mechanism, deformation: Deformation
) -> Machine:
    """Return a mechanism seen through a model with its options; InputError where it is not one for the model."""
    check_drive(chosen.found, mechanism)
    machine = Machine(mechanism, chosen.make(mechanism), deformation)
    if is_own(chosen.found):
        check_home_pose(machine)  # here, where a failure of somebody else's model becomes one line
    return machine


def read_reading_model(path: Path) -> ReadingModel:
    """Return the machine of a TOML file seen by its sensors, whatever its kind.

    Its ``kind`` is ``legs``, ``sliding_platform`` or a machine of one function: a built-in name, an installed
    package's, or ``file.py:Class`` beside the file. The class's own section is ``[machine]``, or all of the file where
    its ``Config`` is that of a whole one. InputError names file, line and key; or what is wrong with the class.
    """
    content, text = read_toml(path)
    kind = content.get("kind")
    if kind == LEGS:
        return read_legs(path)
    if not isinstance(kind, str):
        names = ", ".join(sorted([LEGS, *list_references("MACHINES")]))
        raise InputError(f"{path}: kind: found {kind!r}, expected one of {names}, or file.py:Class")
    found = _find(kind, path)
    config = _check_file(found, content, path, text)
    with name_faults(path):
        with name_failures(found, "kind"):
            machine = found(getattr(config, "machine", config))
        if config.places == 1:
            return FunctionModel(config.name, machine)
        FunctionModel(config.name, machine)  # checked by its own name before it is doubled
        return FunctionModel(config.name, TwoPlaces(machine))


def _check_file(found: type[ReadingMachine], content: dict[str, Any], path: Path, text: str) -> Any:
    """Return the checked content of the file of a machine of one function."""
    if issubclass(found.Config, MachineFileConfig):
        return check_section(found.Config, content, path, text)
    return check_section(_schema_with(found.Config), {"machine": {}, **content}, path, text)


@lru_cache(maxsize=64)
def _schema_with(section: type[Section]) -> type[MachineFileConfig]:
    """Return the schema of a machine's file with a section of its class's own."""
    return create_model("MachineFile", __base__=MachineFileConfig, machine=(section, ...))


def _find(kind: str, path: Path) -> type[ReadingMachine]:
    return find_class("MACHINES", kind, ReadingMachine, "kind", path, path.parent)  # type: ignore[type-abstract]


def find_machine_classes(path: Path) -> list[type]:
    """Return the classes that a machine's file names: that of a machine of one function, or those of legs."""
    content, text = read_toml(path)
    kind = content.get("kind")
    if kind == LEGS:
        return find_classes(check_section(LegsMachineConfig, content, path, text), path.parent)
    return [] if not isinstance(kind, str) else [_find(kind, path)]


def list_machine_sources(path: Path) -> list[str]:
    """Return the files that a machine's file names, those of its classes too, relative to it."""
    content, text = read_toml(path)
    kind = content.get("kind")
    if kind == LEGS:
        return find_files(check_section(LegsMachineConfig, content, path, text), path.parent)
    if not isinstance(kind, str):
        return []
    own = list_sources("MACHINES", kind, path.parent)
    return own if own else find_files(_check_file(_find(kind, path), content, path, text), path.parent)


def keep_machines(
    paths: Iterable[Path], others: Iterable[Path] = (), folder: Path | None = None
) -> tuple[dict[str, bytes], dict[Path, str]]:
    """Return the files that machines are read from, by names in one folder, and each machine's own name there.

    Other files are kept beside them, and where a ``folder`` is given it has a place there, too.
    """
    machines = {path: path.resolve() for path in paths}
    every = dict.fromkeys([*machines.values(), *(one.resolve() for one in others)])
    for path in machines:
        every |= dict.fromkeys((path.parent / one).resolve() for one in list_machine_sources(path))
    known = machines if folder is None else machines | {folder: folder.resolve()}
    folders = [*(one.parent for one in every), *(known[folder] for _ in [folder] if folder)]
    root = folders[0].with_segments(os.path.commonpath([str(one) for one in folders]))
    files = {one.relative_to(root).as_posix(): one.read_bytes() for one in every}
    return files, {path: one.relative_to(root).as_posix() for path, one in known.items()}


def read_legs(path: Path) -> Legs:
    """Return the mechanism on legs of a TOML file seen by its sensors; InputError names the file."""
    content, text = read_toml(path)
    config = check_section(LegsMachineConfig, content, path, text)
    file = path.parent / config.mechanism
    mechanism = load_mechanism(file)

    def read_nominal() -> Array:
        if config.matrix is None:
            raise InputError(f"{path}: found no matrix, expected a CSV file for deformation 'matrix'")
        return 1e-3 * read_matrix(path.parent / config.matrix, mechanism.n_legs)

    nominal = NominalDeformation(config.kappa, read_nominal)
    names = config.model, config.deformation
    with name_faults(path):
        machine = build_named_machine(mechanism, file, *names, nominal, "machine", path.parent)
    with name_faults(file):
        check_home_pose(machine)
    return Legs(machine, np.array(config.tool_mm), config.name, inclined=True)
