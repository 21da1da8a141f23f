"""A look at each file of a study by itself, so that all are told at once what is wrong with them.

Reading a study ends at the first fault, since what follows needs what came before. Here every file is read as far as
it depends on no other: a machine at fault says nothing against a table, nor a key of the config against a machine.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

from bayescal.config.load import read_toml
from bayescal.data.actuators import check_range, name_actuators, read_actuators
from bayescal.data.instruments.read_points import check_point_columns, read_probe, read_stations
from bayescal.data.instruments.read_poses import PoseNoise, check_pose_table
from bayescal.data.photogrammetry.survey import check_reference, check_target_columns
from bayescal.errors import InputError, name_faults
from bayescal.experiments.shared.look import look_at_machine
from bayescal.machines.mechanism import Mechanism


def list_file_faults(content: Mapping[str, Any], folder: Path) -> list[str]:
    """Return what is wrong with the files that a study's config names, a line each; the config may be at fault."""
    data = content.get("data")
    machine, faults = look_at_machine(content, folder)
    n_legs = _count_legs(content, folder) if machine is None else machine.n_legs
    for check in _list_checks(data if isinstance(data, dict) else {}, folder, n_legs, machine):
        faults += _catch(check)
    return faults


def _catch(check: Callable[[], object]) -> list[str]:
    """Return what a check finds, a line each."""
    try:
        check()
    except InputError as error:
        return list(error.lines)
    return []


def _count_legs(content: Mapping[str, Any], folder: Path) -> int | None:
    """Return how many legs a machine at fault has by the places of its base; None where these do not say."""
    try:
        base = read_toml(folder / str(content.get("machine")))[0].get("base")
    except InputError:
        return None
    places = (base.get("points_mm") or base.get("azimuth_deg")) if isinstance(base, dict) else None
    return len(places) if isinstance(places, list) else None


def _list_checks(
    data: Mapping[str, Any], folder: Path, n_legs: int | None, machine: Mechanism | None
) -> Iterator[Callable[[], object]]:
    """Yield a check of every table; without the number of legs of those that have no columns of legs."""
    tables = {key: folder / value for key, value in data.items() if isinstance(value, str)}
    if n_legs is not None:
        legs = n_legs
        if "actuators" in tables:
            yield lambda: _check_actuators(tables["actuators"], legs, machine)
        if "reference" in tables:
            yield lambda: check_reference(tables["reference"], legs)
        if data.get("measurement") == "poses" and "poses" in tables:
            own = name_actuators(legs)
            yield lambda: check_pose_table(tables["poses"], _read_noise(data), own)
    if data.get("measurement", "targets") == "targets" and "targets" in tables:
        yield lambda: check_target_columns(tables["targets"])
    if data.get("measurement") == "points" and "points" in tables:
        yield lambda: check_point_columns(tables["points"], "stations" in tables)
    if "probe" in tables:
        yield lambda: read_probe(tables["probe"])
    if "stations" in tables:
        yield lambda: read_stations(tables["stations"])


def _check_actuators(path: Path, n_legs: int, machine: Mechanism | None) -> None:
    """Raise InputError for a table of actuator positions that is none, or that its machine does not reach."""
    names, _, actuators = read_actuators(path, n_legs)
    if machine is not None:
        with name_faults(path):
            check_range(actuators, machine.initial_actuator_positions, machine.actuator_range, names)


def _read_noise(data: Mapping[str, Any]) -> PoseNoise:
    """Return a noise of poses where the config states any, whatever its size: the config itself answers for that."""
    stated = ("position_", "orientation_")
    return PoseNoise(*(1.0 if any(key.startswith(begin) for key in data) else None for begin in stated))
