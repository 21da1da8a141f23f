"""Reading configs: TOML to checked sections, every fault as one line with file, line, field, found and expected."""

from __future__ import annotations

import difflib
import re
import tomllib
from collections.abc import Iterable
from pathlib import Path
from typing import Any, get_args

import numpy as np
from pydantic import BaseModel, TypeAdapter, ValidationError

from bayescal.config.schema import (
    BeamSectionConfig,
    LoadConfig,
    MechanismConfig,
    PointsConfig,
    PoseMethodsConfig,
    Section,
    SimulationConfig,
    StudyConfig,
)
from bayescal.errors import InputError
from bayescal.experiments.pose_selection.schema import SelectionConfig
from bayescal.experiments.self_calibration.schema import ReadingSimulationConfig, SelfCalibrationConfig
from bayescal.experiments.sensor_placement.schema import PlacementConfig
from bayescal.files.atomic import read_text
from bayescal.machines.mechanism import BeamSection, ExternalLoad, Flexures, Mechanism, section_of_rod
from bayescal.numerics.geometry import Array
from bayescal.reproductions.sika2008.schema import SelfCalibrationsConfig
from bayescal.reproductions.yu2023.schema import HexapodCalibrationsConfig

MPA_PER_GPA = 1e3
UPWARDS = [0.0, 0.0, 1.0]
SHORTEST = 1e-6  # mm; what rounding leaves of no length is less

type Experiment = (
    StudyConfig
    | PoseMethodsConfig
    | SelectionConfig
    | HexapodCalibrationsConfig
    | SelfCalibrationConfig
    | SelfCalibrationsConfig
    | PlacementConfig
)

EXPERIMENTS: dict[str, type[Experiment]] = {
    "study": StudyConfig,
    "pose_methods": PoseMethodsConfig,
    "pose_selection": SelectionConfig,
    "hexapod_calibrations": HexapodCalibrationsConfig,
    "sensor_placement": PlacementConfig,
    "self_calibration": SelfCalibrationConfig,
    "self_calibrations": SelfCalibrationsConfig,
}

SIMULATIONS = ("simulation", "reading_simulation")
SIMULATIONS_SAID = " or ".join(map(repr, SIMULATIONS))


def load_experiment(path: Path) -> Experiment:
    """Return the checked config of an experiment; its ``kind`` says which schema holds."""
    content, text = read_toml(path)
    kind = content.get("kind")
    if not isinstance(kind, str) or kind not in EXPERIMENTS:
        hint = _suggest(str(kind), EXPERIMENTS)
        raise InputError(f"{path}: kind: found {kind!r}{hint}, expected {_one_of(EXPERIMENTS)}")
    return check_section(EXPERIMENTS[kind], content, path, text)


def load_simulation(path: Path) -> SimulationConfig:
    """Return the checked config of a simulation."""
    content, text = read_toml(path)
    kind = content.get("kind")
    if kind != "simulation":
        raise InputError(f"{path}: kind: found {kind!r}{_suggest(str(kind), SIMULATIONS)}, expected {SIMULATIONS_SAID}")
    return check_section(SimulationConfig, content, path, text)


def load_reading_simulation(path: Path) -> ReadingSimulationConfig | None:
    """Return the checked config of a simulation of readings; None where the file is of another kind."""
    content, text = read_toml(path)
    if content.get("kind") != "reading_simulation":
        return None
    return check_section(ReadingSimulationConfig, content, path, text)


def load_mechanism(path: Path) -> Mechanism:
    """Return the mechanism that a TOML file describes, lengths in mm.

    Raises
    ------
    InputError
        Where the file is not a mechanism, or its lists do not have one entry per leg.
    """
    content, text = read_toml(path)
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
            drive=config.legs.drive,
            home_position=home,
        )
    except InputError as error:
        raise InputError(f"{path}: {error}") from error


def _legs(
    config: MechanismConfig, base: Array, home: tuple[float, float, float] | None, path: Path
) -> dict[str, Array]:
    """Return what there is of every leg, shapes (N, ...), by the names of the fields."""
    n_legs = len(base)
    given = 0.0 if home is not None else config.legs.length_mm
    columns = {
        "platform": points_of(config.platform),
        "legs.length_mm": np.atleast_1d(np.array(given, dtype=np.float64)),
        "legs.direction": _directions(config, path),
        "legs.initial_actuator_position_mm": np.atleast_1d(np.array(config.legs.initial_actuator_position_mm)),
    }
    if config.flexures is not None:
        columns["flexures.length_mm"] = np.atleast_1d(np.array(config.flexures.length_mm))
        columns["flexures.beta"] = np.atleast_1d(np.array(config.flexures.beta))
    for field, values in columns.items():
        if len(values) not in ((1, n_legs) if field != "platform" else (n_legs,)):
            raise InputError(f"{path}: {field}: found {len(values)} legs, expected {n_legs} as in base")
    if home is not None:
        columns["legs.length_mm"] = _span(base, np.array(home) + columns["platform"], path)
    if config.flexures is not None:
        lengths, flexures = np.broadcast_arrays(columns["legs.length_mm"], columns["flexures.length_mm"])
        if np.any(flexures >= lengths):
            leg = int(np.argmax(flexures >= lengths))
            raise InputError(
                f"{path}: flexures.length_mm: found {flexures[leg]:g} mm on a leg of {lengths[leg]:g} mm, "
                "expected flexures shorter than their leg"
            )
    return {field: np.broadcast_to(v, (n_legs, *v.shape[1:])) for field, v in columns.items()}


def _directions(config: MechanismConfig, path: Path) -> Array:
    """Return unit vectors, shape (1 or N, 3); zeros for struts."""
    if config.legs.drive == "strut":
        return np.zeros((1, 3))
    given = UPWARDS if config.legs.direction is None else config.legs.direction
    directions = np.atleast_2d(np.array(given, dtype=np.float64))
    norms = np.linalg.norm(directions, axis=1, keepdims=True)
    if np.any(norms == 0):
        raise InputError(f"{path}: legs.direction: found a zero vector, expected a direction")
    return directions / norms


def _home(config: MechanismConfig, path: Path, text: str) -> tuple[float, float, float] | None:
    """Return the home position in mm, None where the legs' lengths are given instead."""
    line = _find_line(text, ["legs"])
    legs = f"{path}, line {line}: legs" if line else f"{path}: legs"
    if config.home is None:
        if config.legs.length_mm is None:
            instead = " or [home]" if config.legs.drive == "strut" else ""
            raise InputError(f"{legs}.length_mm: missing, expected a value{instead}")
        return None
    if config.legs.drive == "base":
        raise InputError(f"{legs}.drive: found 'base' with [home], expected 'strut', or no [home]")
    if config.legs.length_mm is not None:
        raise InputError(f"{legs}.length_mm: found lengths beside [home], expected one of them, since home has them")
    x, y, z = config.home.position_mm
    return x, y, z


def _span(lower: Array, upper: Array, path: Path) -> Array:
    """Return the distances between joints, shape (N,), mm."""
    lengths = np.linalg.norm(upper - lower, axis=1)
    if np.any(lengths < SHORTEST):
        leg = int(np.argmin(lengths)) + 1
        raise InputError(f"{path}: home.position_mm: found both joints of leg {leg} in one place, expected a length")
    return lengths


def _flexures(config: MechanismConfig, full: dict[str, Array]) -> Flexures | None:
    if config.flexures is None:
        return None
    length, beta = full["flexures.length_mm"], full["flexures.beta"]
    if config.stiffness is None:
        return Flexures(length, beta)
    return Flexures(length, beta, _section(config.stiffness.flexure), _section(config.stiffness.leg))


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


def points_of(config: PointsConfig) -> Array:
    """Return points, shape (n, 3), mm."""
    if config.points_mm is not None:
        return np.array(config.points_mm, dtype=np.float64)
    azimuth = np.radians(config.azimuth_deg or [])
    radius = config.radius_mm or 0.0
    height = np.full_like(azimuth, config.height_mm)
    return np.stack([radius * np.cos(azimuth), radius * np.sin(azimuth), height], axis=1)


def read_toml(path: Path) -> tuple[dict[str, Any], str]:
    """Return a TOML file's content and its text; InputError where it is none."""
    text = read_text(path, "a TOML config")
    try:
        return tomllib.loads(text), text
    except (ValueError, RecursionError) as error:  # also numbers of thousands of digits and brackets without end
        raise InputError(f"{path}: not valid TOML: {error}") from error


def check_section[S: Section](schema: type[S], content: dict[str, Any], path: Path, text: str) -> S:
    """Return content as a section; InputError with file, line, field, found and expected where it is none."""
    try:
        return schema.model_validate(content)
    except ValidationError as error:
        raise InputError(_describe(error, schema, path, text)) from error


def _describe(error: ValidationError, schema: type[Section], path: Path, text: str) -> str:
    """Return the first fault as one line.

    Unknown keys come first, since they explain the missing ones; then the deepest place, since a list that may also be
    a number is at fault in its entry; last, that something is no list, since most of these may be a number instead.
    """
    rank = {"extra_forbidden": -1, "list_type": 1}
    fault = min(error.errors(), key=lambda fault: (rank.get(fault["type"], 0), -len(_keys_of(fault["loc"]))))
    location = _keys_of(fault["loc"])
    field = ".".join(str(part) for part in location) or "the file"
    line = _find_line(text, location[:-1] if fault["type"] == "missing" else location)
    where = f"{path}, line {line}: {field}" if line else f"{path}: {field}"
    if fault["type"] == "extra_forbidden":
        known = _known_keys(schema, location[:-1])
        return f"{where}: unknown key{_suggest(str(location[-1]), known)}, expected {_one_of(known)}"
    message = fault["msg"].removeprefix("Value error, ")
    if fault["type"] == "missing":
        return f"{where}: missing, expected a value"
    if fault["type"] == "value_error":
        return f"{where}: {message}"
    if fault["type"] == "union_tag_not_found":
        return f"{where}: found no key {fault['ctx']['discriminator']}, expected a value"
    if fault["type"] == "union_tag_invalid":
        return f"{where}: found {fault['ctx']['tag']!r}, expected one of {fault['ctx']['expected_tags']}"
    if message.startswith("Input should be "):
        return f"{where}: found {_short(fault['input'])}, expected {message.removeprefix('Input should be ')}"
    return f"{where}: found {_short(fault['input'])}, expected: {message[0].lower()}{message[1:]}"


def _keys_of(location: tuple[int | str, ...]) -> list[int | str]:
    """Return a fault's location without the parts that name a branch of a union."""
    branches = {"normal", "uniform", "fixed", "float", "constrained-float", "observability", "accuracy", "numbers"}
    return [part for part in location if part not in branches and not str(part).startswith(("function-", "list["))]


def _short(value: object) -> str:
    text = repr(value)
    return text if len(text) < 60 else text[:57] + "..."


def _known_keys(schema: Any, location: list[Any]) -> list[str]:
    """Return the keys of the section at a location, looking through lists, unions and dictionaries."""
    found = [schema]
    for part in location:
        found = [inner for kind in found for inner in _step(kind, part)]
    keys = {key for kind in found for model in _models(kind) for key in model.model_fields}
    return sorted(keys)


def _step(kind: Any, part: Any) -> list[Any]:
    models = _models(kind)
    hits = [m.model_fields[part].annotation for m in models if part in m.model_fields]
    return hits or models


def _models(kind: Any) -> list[type[BaseModel]]:
    """Return all pydantic models inside a type."""
    kind = getattr(kind, "__value__", kind)
    if isinstance(kind, type) and issubclass(kind, BaseModel):
        return [kind]
    return [model for inner in get_args(kind) for model in _models(inner)]


def _find_line(text: str, location: list[Any]) -> int | None:
    """Return the line of the last named key of a location, searched table by table; None where it is not certain."""
    keys = [str(part) for part in location if isinstance(part, str)]
    for depth in range(len(keys), 0, -1):
        key = re.escape(keys[depth - 1])
        pattern = re.compile(rf"^\s*\[*\s*(?:[\w.]+\.)?{key}\s*(?:=|\]|\.)|[{{,]\s*{key}\s*=")
        hits = [number for number, row in enumerate(text.splitlines(), start=1) if pattern.search(row)]
        if len(hits) == 1:
            return hits[0]
    return None


def _suggest(name: str, known: Iterable[str]) -> str:
    close = difflib.get_close_matches(name, list(known), n=1)
    return f", did you mean {close[0]!r}?" if close else ""


def _one_of(names: Iterable[str]) -> str:
    return "one of " + ", ".join(sorted(names))


def look_up[T](registry: dict[str, T], name: str, what: str, where: Path) -> T:
    """Return the entry of a registry; InputError with the nearest name where there is none."""
    if name not in registry:
        raise InputError(f"{where}: {what}: found {name!r}{_suggest(name, registry)}, expected {_one_of(registry)}")
    return registry[name]


def dump_config(config: Section) -> dict[str, Any]:
    """Return a config as plain JSON-ready values."""
    return TypeAdapter(type(config)).dump_python(config, mode="json")
