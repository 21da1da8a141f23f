"""What sessions measured of one machine: poses of a machine on legs, or readings of any channels."""

from __future__ import annotations

import os
from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from bayescal.density.calibration.likelihood import CalibrationPosterior
from bayescal.density.priors import NormalPrior
from bayescal.density.sessions import ReadingRows
from bayescal.errors import InputError, name_faults
from bayescal.experiments.sessions.schema import SessionConfig, SessionsConfig
from bayescal.experiments.shared.measured import MeasuredReadings, measure_variants
from bayescal.experiments.shared.reading_slips import find_measured_slip
from bayescal.experiments.shared.slips import FoundSlip
from bayescal.machines.kinematics import Machine, solve_forward_kinematics
from bayescal.machines.parameters import ParameterLayout
from bayescal.numerics.geometry import Array

FILES = ("targets", "poses", "actuators", "reference")


class Design(NamedTuple):
    """Free parameters: see `bayescal.density.sessions.SessionModel`."""

    start: Array
    moves: Array
    names: tuple[str, ...]
    units: tuple[str, ...]
    mean: Array
    sd: Array


class Motions(NamedTuple):
    """What the free parameters do at home: names and units of legs or channels (N,), and the slope (N, m)."""

    names: tuple[str, ...]
    units: tuple[str, ...]
    slope: Array


@dataclass(frozen=True, eq=False)
class Session:
    """One session, seen through the variant."""

    measured: MeasuredReadings

    @property
    def by_leg(self) -> bool:
        """Whether what moved is stated by leg."""
        return self.measured.legs is not None

    @property
    def _posterior(self) -> CalibrationPosterior:
        return self.measured.posterior

    @property
    def poses(self) -> tuple[str, ...]:
        """Names of the P poses that count."""
        return self._posterior.likelihood.data.poses

    @property
    def values(self) -> Array:
        """The readings, by which copies are known."""
        return self._posterior.likelihood.data.values

    @property
    def layout(self) -> ParameterLayout:
        """All parameters of the machine."""
        return self._posterior.likelihood.model.layout

    @property
    def free(self) -> tuple[str, ...]:
        """Symbols that are free."""
        return tuple(dict.fromkeys(name.partition("[")[0] for name in self.names))

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the m free parameters, in the order of θ."""
        return self._posterior.sampling.names

    def rows(self, chosen: np.ndarray) -> ReadingRows:
        """Return some of the poses, (Q,)."""
        anchored = self.measured.anchored
        return ReadingRows(replace(anchored, likelihood=anchored.likelihood.pick(chosen)))

    def find_slip(self, denied: Collection[str] = ()) -> FoundSlip | None:
        """Return what explains the data many times better than they are; None without any."""
        return find_measured_slip([self.measured], denied)

    def design(self, study: str) -> Design:
        """Return the free parameters; InputError for a prior that is not normal."""
        posterior = self._posterior
        moves = np.where(posterior.around(np.zeros(posterior.n_parameters))[1].T != 0.0, 1.0, 0.0)
        priors = [posterior.priors[name] for name in self.names]
        for name, prior in zip(self.names, priors, strict=True):
            if not isinstance(prior, NormalPrior):
                raise InputError(
                    f"{study}: parameters: found a uniform prior of {name}, expected normal ones, since sessions are "
                    "joined in closed form"
                )
        mean, sd = (np.array([getattr(one, key) for one in priors]) for key in ("mean", "sd"))
        units = tuple(self.layout.units[int(np.argmax(move))] for move in moves)
        return Design(posterior.sampling.start, moves, self.names, units, mean, sd)

    def move(self, theta: Array, model_moves: Array) -> Motions:
        """Return what free parameters, by moves (m, D), do at home of a machine (D,), its pose as it is.

        To the readings of the machine's own channels; to each leg in terms of its length l.
        """
        model, data = self._posterior.likelihood.model, self._posterior.likelihood.data
        if self.measured.legs is not None:
            return _move_legs(self.measured.legs.machine, theta, model_moves)
        own = np.flatnonzero(self.measured.internal)
        home = np.array([one.home for one in model.coordinates])
        given = {name: np.array(np.median(value)) for name, value in data.given.items()}
        slope = model.linearise(theta, home, True, given).by_parameters[own] @ model_moves.T
        channels = [model.channels[k] for k in own]
        return Motions(tuple(one.name for one in channels), tuple(one.unit for one in channels), slope)


def _move_legs(machine: Machine, theta: Array, model_moves: Array) -> Motions:
    actuators = machine.mechanism.initial_actuator_positions
    home = solve_forward_kinematics(machine, theta, actuators)
    slope = machine.linearise(theta, home.position, home.rotation, actuators).parameters
    length = np.diagonal(slope[:, machine.layout.index["l"]])
    names = tuple(str(k + 1) for k in range(len(slope)))
    return Motions(names, ("mm",) * len(slope), (slope @ model_moves.T) / length[:, None])


def measure_sessions(experiment: object, study: Any, path: Path, config: SessionsConfig, folder: Path) -> list[Session]:
    """Return what each session measured, in place of the data of a study or a calibration.

    Raises
    ------
    InputError
        Names the session.
    """
    found: list[Session] = []
    place = _place_tables if getattr(study, "by_tables", False) else _place_files
    for session in config.sessions:
        with name_faults(f"session {session.label!r}"):
            placed = place(study, session, folder, path) if hasattr(study, "data") else study
            measured = measure_variants(experiment, placed, path, [config.variant])[config.variant]
            errors = measured.posterior.errors
            if errors.outliers.expected:
                raise InputError(
                    f"{path}: found a robust variant, expected another: sessions are joined in closed form"
                )
            if errors.has_columns:
                raise InputError(
                    f"{path}: found errors common to all rows, expected a variant without: sessions have none"
                )
            found.append(Session(measured))
    return found


def _place_tables(study: Any, session: SessionConfig, folder: Path, path: Path) -> Any:
    """Return a calibration with a session's tables in place of its own, in their order."""
    given = [key for key in FILES if getattr(session, key) is not None]
    if given:
        raise InputError(f"found {given[0]}, expected readings, as {path} has tables of them")
    if len(session.readings) != len(study.data):
        raise InputError(
            f"found {len(session.readings)} files of readings, expected {len(study.data)}: one a [[data]] of {path}"
        )
    tables = [
        one.model_copy(update={"file": os.path.relpath(folder / name, path.parent), "hold_back": []})
        for one, name in zip(study.data, session.readings, strict=True)
    ]
    return study.model_copy(update={"data": tables})


def _place_files(study: Any, session: SessionConfig, folder: Path, path: Path) -> Any:
    """Return the study with a session's files, whose names start at the study's folder then."""
    data = study.data
    named: Mapping[str, str] = {key: getattr(session, key) for key in FILES if getattr(session, key) is not None}
    if session.readings:
        raise InputError(f"found readings, expected {data.measurement}, as {path} is a study of legs")
    if data.measurement not in named:
        raise InputError(f"found no {data.measurement}, expected its file, as {path} is a study of {data.measurement}")
    for key in named:
        if key not in type(data).model_fields:
            raise InputError(f"found {key}, expected nothing of it, as {path} is a study of {data.measurement}")
    moved = {key: os.path.relpath(folder / name, path.parent) for key, name in named.items()}
    return study.model_copy(update={"data": data.model_copy(update=moved)})
