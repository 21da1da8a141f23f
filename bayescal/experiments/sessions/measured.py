"""What sessions measured of one machine: poses of a machine on legs, or readings of any channels."""

from __future__ import annotations

import os
from abc import ABC, abstractmethod
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from bayescal.density.pose_likelihood import PoseLikelihood
from bayescal.density.priors import NormalPrior, Prior
from bayescal.density.sessions.rows import LegRows, ReadingRows, SessionRows
from bayescal.errors import InputError, name_faults
from bayescal.experiments.sessions.schema import SessionConfig, SessionsConfig
from bayescal.experiments.shared.leg_slips import find_slip_of_legs
from bayescal.experiments.shared.measured import MeasuredReadings, MeasuredVariant, Measuring, MeasuringReadings
from bayescal.experiments.shared.reading_slips import Suspicion
from bayescal.experiments.shared.slips import FoundSlip
from bayescal.machines.kinematics import solve_forward_kinematics
from bayescal.machines.parameters import ParameterLayout
from bayescal.numerics.geometry import Array

FILES = ("targets", "poses", "actuators", "reference")


class Design(NamedTuple):
    """Free parameters: see `bayescal.density.sessions.model.SessionModel`."""

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


class Session(ABC):
    """One session, seen through the variant."""

    by_leg: bool

    @property
    @abstractmethod
    def poses(self) -> tuple[str, ...]:
        """Names of the P poses that count."""

    @property
    @abstractmethod
    def values(self) -> Array:
        """What was measured, by which copies are known."""

    @property
    @abstractmethod
    def layout(self) -> ParameterLayout:
        """All parameters of the machine."""

    @property
    @abstractmethod
    def free(self) -> tuple[str, ...]:
        """Symbols that are free."""

    @property
    @abstractmethod
    def names(self) -> tuple[str, ...]:
        """Names of the m free parameters, in the order of θ."""

    @abstractmethod
    def rows(self, chosen: np.ndarray) -> SessionRows:
        """Return some of the poses, (Q,)."""

    @abstractmethod
    def find_slip(self, denied: Collection[str] = ()) -> FoundSlip | None:
        """Return what explains the data many times better than they are; None without any."""

    @abstractmethod
    def approach(self) -> Array:
        """Return the machine (D,) that explains the session best by itself."""

    @abstractmethod
    def move(self, theta: Array, model_moves: Array) -> Motions:
        """Return what free parameters, by moves (m, D), do to legs or channels at home of a machine (D,)."""

    @abstractmethod
    def _spread(self) -> tuple[Array, Array, Sequence[Prior]]:
        """Return θ with all at their priors' centres, the moves (m, D) and the priors."""

    def design(self, study: str) -> Design:
        """Return the free parameters; InputError for a prior that is not normal."""
        start, moves, priors = self._spread()
        for name, prior in zip(self.names, priors, strict=True):
            if not isinstance(prior, NormalPrior):
                raise InputError(
                    f"{study}: parameters: found a uniform prior of {name}, expected normal ones, since sessions are "
                    "joined in closed form"
                )
        mean, sd = (np.array([getattr(one, key) for one in priors]) for key in ("mean", "sd"))
        units = tuple(self.layout.units[int(np.argmax(move))] for move in moves)
        return Design(start, moves, self.names, units, mean, sd)


@dataclass(frozen=True, eq=False)
class LegSession(Session):
    """Poses of a machine on legs."""

    measured: MeasuredVariant
    by_leg = True

    @property
    def poses(self) -> tuple[str, ...]:
        """Names of the calibration poses."""
        return self.measured.poses.names

    @property
    def values(self) -> Array:
        """Positions."""
        return self.measured.poses.position

    @property
    def layout(self) -> ParameterLayout:
        """The legs' parameters."""
        return self.measured.machine.layout

    @property
    def free(self) -> tuple[str, ...]:
        """Of the variant."""
        return self.measured.free

    @property
    def names(self) -> tuple[str, ...]:
        """In the order of the coordinates."""
        return tuple(self.layout.names[k] for k in self.measured.posterior.sampling.free)

    def rows(self, chosen: np.ndarray) -> SessionRows:
        """Return closures of some poses."""
        one = self.measured
        variance = None if one.actuator_variance is None else one.actuator_variance[chosen]
        likelihood = PoseLikelihood(one.machine, one.poses.select(chosen), one.actuator_noise, variance)
        return LegRows(likelihood, one.posterior.errors.model_error)

    def find_slip(self, denied: Collection[str] = ()) -> FoundSlip | None:
        """Return a slip of actuators or poses."""
        return find_slip_of_legs([self.measured], denied)

    def approach(self) -> Array:
        """Return the least-squares machine."""
        posterior = self.measured.posterior
        return posterior.theta(posterior.approach()[None])[0]

    def _spread(self) -> tuple[Array, Array, Sequence[Prior]]:
        posterior = self.measured.posterior
        free = posterior.sampling.free
        priors = [posterior.priors[name] for name in self.names]
        start = posterior.sampling.start.copy()
        start[free] = [one.mean for one in priors]
        return start, np.eye(len(start))[free], priors

    def move(self, theta: Array, model_moves: Array) -> Motions:
        """Return what parameters do to each leg at home, in terms of its length l."""
        machine = self.measured.machine
        actuators = machine.mechanism.initial_actuator_positions
        home = solve_forward_kinematics(machine, theta, actuators)
        slope = machine.linearise(theta, home.position, home.rotation, actuators).parameters
        length = np.diagonal(slope[:, machine.layout.index["l"]])
        names = tuple(str(k + 1) for k in range(len(slope)))
        return Motions(names, ("mm",) * len(slope), (slope @ model_moves.T) / length[:, None])


@dataclass(frozen=True, eq=False)
class ReadingSession(Session):
    """Readings of any channels."""

    measured: MeasuredReadings
    by_leg = False

    @property
    def poses(self) -> tuple[str, ...]:
        """Names of the calibration rows."""
        return self.measured.posterior.likelihood.data.poses

    @property
    def values(self) -> Array:
        """The readings."""
        return self.measured.posterior.likelihood.data.values

    @property
    def layout(self) -> ParameterLayout:
        """The machine's parameters."""
        return self.measured.posterior.likelihood.model.layout

    @property
    def free(self) -> tuple[str, ...]:
        """Symbols of the free parameters."""
        return tuple(dict.fromkeys(name.partition("[")[0] for name in self.names))

    @property
    def names(self) -> tuple[str, ...]:
        """Of the posterior's geometry."""
        return self.measured.posterior.geometry_names

    @cached_property
    def _anchored(self) -> Any:
        return self.measured.posterior.anchored()

    def rows(self, chosen: np.ndarray) -> SessionRows:
        """Return what no pose explains of some rows."""
        return ReadingRows(replace(self._anchored, likelihood=self._anchored.likelihood.pick(chosen)))

    def find_slip(self, denied: Collection[str] = ()) -> FoundSlip | None:
        """Return a slip of readings."""
        return Suspicion(self.measured.posterior, self.measured.low, self.measured.high).find(denied)

    def approach(self) -> Array:
        """Return the least-squares machine."""
        return np.asarray(self._anchored.likelihood.anchor)

    def _spread(self) -> tuple[Array, Array, Sequence[Prior]]:
        posterior = self.measured.posterior
        moves = posterior.moves(np.zeros(posterior.n_parameters))
        priors = [posterior.priors[name] for name in self.names]
        return posterior.centre, np.where(moves != 0.0, 1.0, 0.0), priors

    def move(self, theta: Array, model_moves: Array) -> Motions:
        """Return what parameters do to the readings of the machine's own channels at home, its pose as it is."""
        model, own = self.measured.posterior.likelihood.model, np.flatnonzero(self.measured.internal)
        home = np.array([one.home for one in model.coordinates])
        data = self.measured.posterior.likelihood.data
        given = {name: np.array(np.median(value)) for name, value in data.given.items()}
        slope = model.linearise(theta, home, True, given).by_parameters[own] @ model_moves.T
        channels = [model.channels[k] for k in own]
        return Motions(tuple(one.name for one in channels), tuple(one.unit for one in channels), slope)


def measure_sessions(experiment: object, study: Any, path: Path, config: SessionsConfig, folder: Path) -> list[Session]:
    """Return what each session measured, in place of the data of a study or a calibration.

    Raises
    ------
    InputError
        Names the session.
    """
    found: list[Session] = []
    for session in config.sessions:
        with name_faults(f"session {session.label!r}"):
            if isinstance(experiment, MeasuringReadings):
                placed = _place_tables(study, session, folder, path)
                measured = experiment.measure_readings(placed, path.parent, [config.variant])[config.variant]
                found.append(_check(ReadingSession(measured), path))
            elif isinstance(experiment, Measuring):
                known = experiment.list_variants(study)
                if config.variant not in known:
                    raise InputError(
                        f"{path}: variant {config.variant!r}: unknown here, expected one of {', '.join(known)}"
                    )
                placed = _place_files(study, session, folder, path)
                found.append(LegSession(experiment.measure(placed, path, known[config.variant], True)))
            else:
                raise InputError(f"{path}: kind: found {study.kind!r}, expected 'study' or 'calibration'")
    return found


def _check(session: ReadingSession, path: Path) -> ReadingSession:
    """Return a session; InputError for a density that is not normal given its scales, row by row."""
    errors = session.measured.posterior.errors
    if errors.outliers.expected:
        raise InputError(f"{path}: found a robust variant, expected another: sessions are joined in closed form")
    if errors.has_columns:
        raise InputError(f"{path}: found errors common to all rows, expected a variant without: sessions have none")
    return session


def _place_tables(study: Any, session: SessionConfig, folder: Path, path: Path) -> Any:
    """Return a calibration with a session's tables in place of its own, in their order."""
    given = [key for key in FILES if getattr(session, key) is not None]
    if given:
        raise InputError(f"found {given[0]}, expected readings, as {path} is a calibration")
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
