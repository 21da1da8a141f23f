"""From a config of sessions to their joint model."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import reduce
from pathlib import Path
from typing import Any

import numpy as np

from bayescal.density.calibration.model_error import GPTerm
from bayescal.density.pose_kernels import KernelInput
from bayescal.density.priors import NormalPrior
from bayescal.density.sessions import DriftModel, Part, ReadingRows, SessionModel, ThermalExpansion, walk_loadings
from bayescal.errors import InputError, name_faults, say_unknown
from bayescal.experiments.runner.load import load
from bayescal.experiments.sessions.schema import SessionConfig, SessionsConfig, ThermalConfig
from bayescal.experiments.shared.measured import MeasuredReadings, check_measures, choose_variant, measure_variants
from bayescal.experiments.shared.slip_search import find_slip
from bayescal.experiments.shared.slips import tell_denial
from bayescal.files.csv_tables import read_table
from bayescal.machines.kinematics import solve_forward_kinematics
from bayescal.machines.parameters import ParameterLayout
from bayescal.machines.readings import POSE
from bayescal.numerics.geometry import Array
from bayescal.numerics.units import ARCSECOND, MICROMETRE

PPM = 1e-6
DRIFT = "drift"
"""The sort of functions that is another one in every session: of the place in measuring order."""
MOST_UNITS = 24
"""Scales that evidence is integrated over."""
UNITS = {"mm": ("µm", MICROMETRE), "rad": ("arcsec", ARCSECOND)}
"""What motions are told in, by the unit of what moves."""
MAX_DRIFT_SCALES = 20.0
"""Prior scales of the drift, over the time that went by, that legs of one machine are never off."""
WARM = 0.1
"""Millimetres that a leg may be off besides, by temperature, noise and model error."""


@dataclass(frozen=True, eq=False)
class SessionsInputs:
    """S sessions, read."""

    config: SessionsConfig
    model: SessionModel
    first: MeasuredReadings  # of the first of them
    temperature: Array  # (S,), mean of each session's poses, °C; NaN where none is stated
    n_poses: np.ndarray  # (S,)
    denied: list[str]  # slips that sessions look like and the config denies, in words

    @property
    def labels(self) -> list[str]:
        """Of the sessions."""
        return [one.label for one in self.config.sessions]

    @property
    def is_leg_mechanism(self) -> bool:
        """Whether what moved is stated by leg."""
        return self.first.posterior.likelihood.model.legs is not None


def read_sessions(config: SessionsConfig, folder: Path) -> SessionsInputs:
    """Return sessions, read.

    InputError where the study or its variant is not there, a session's files are missing or of another machine, or
    temperatures are.
    """
    path = folder / config.study
    measured = measure_sessions(*load(path), path, config, folder)
    first = measured[0]
    denied = [_judge_slip(session, one) for session, one in zip(config.sessions, measured, strict=True)]
    _check_apart(config, measured)
    warmth = [_read_temperatures(one, it, folder) for one, it in zip(config.sessions, measured, strict=True)]
    parts = [part for k, it in enumerate(measured) for part in _split(config, k, it, warmth[k])]
    drift = _build_drift(config, first)
    expansions = _build_expansions(config.thermal, first.posterior.likelihood.model.layout)
    functions = first.posterior.errors.terms_of(GPTerm)
    lasting = tuple(config.drift.model == "random_walk" and one.sort != DRIFT for one in functions)
    model = SessionModel(tuple(parts), *describe_free(first, config.study), drift, expansions, lasting)
    if config.drift.model == "random_walk":
        check_same_machine(model, measured, [one.label for one in config.sessions])
    mean_temperature = np.array([np.nan if one is None else one.mean() for one in warmth])
    n_poses = np.array([one.posterior.likelihood.data.n_poses for one in measured])
    return SessionsInputs(config, model, first, mean_temperature, n_poses, [one for one in denied if one is not None])


def _judge_slip(session: SessionConfig, measured: MeasuredReadings) -> str | None:
    """Return the slip that a session looks like and the config denies; None where it looks like none.

    InputError where a slip explains a session many times better: joined to others it would pass for drift.
    """
    denied = {*session.ignored_data_errors, *measured.denied}
    slip = find_slip([measured.readings], denied)
    if slip is not None:
        raise InputError(
            f"session {session.label!r}: probable data error: "
            f"{slip.say()}{tell_denial('ignored_data_errors of the session')}"
        )
    slip = find_slip([measured.readings]) if denied else None
    return None if slip is None else f"Session {session.label!r}: {slip.say()}"


def _check_apart(config: SessionsConfig, measured: list[MeasuredReadings]) -> None:
    """Raise InputError where a session is another one once more."""
    values = [one.posterior.likelihood.data.values for one in measured]
    for k, one in enumerate(values):
        for earlier in range(k):
            if np.array_equal(one, values[earlier], equal_nan=True):
                raise InputError(
                    f"session {config.sessions[k].label!r}: found the readings of "
                    f"{config.sessions[earlier].label!r}, expected another measurement"
                )


def _read_temperatures(session: SessionConfig, measured: MeasuredReadings, folder: Path) -> Array | None:
    """Return the temperature at each calibration pose (P,), °C; None where none is stated."""
    poses = measured.posterior.likelihood.data.poses
    if session.temperature_celsius is not None:
        return np.full(len(poses), session.temperature_celsius)
    if session.temperatures is None:
        return None
    table = read_table(folder / session.temperatures, ("pose", "temperature_celsius"), ("use",))
    names = table.text("pose")
    table.check_unique([(name,) for name in names], "pose")
    for name in poses:
        if name not in names:
            raise InputError(f"{folder / session.temperatures}: pose {str(name)!r}: missing")
    return table.numbers(["temperature_celsius"])[[names.index(name) for name in poses], 0]


def _split(config: SessionsConfig, session: int, measured: MeasuredReadings, warmth: Array | None) -> list[Part]:
    """Return a session's poses, those of one temperature together."""
    if config.thermal is None or warmth is None:
        every = np.arange(measured.posterior.likelihood.data.n_poses)
        return [Part(pick_rows(measured, every), session)]
    return [
        Part(pick_rows(measured, np.flatnonzero(warmth == one)), session, float(one - config.thermal.reference_celsius))
        for one in np.unique(warmth)
    ]


def _build_drift(config: SessionsConfig, first: MeasuredReadings) -> DriftModel:
    drift, layout, names = config.drift, first.posterior.likelihood.model.layout, first.posterior.sampling.names
    free = dict.fromkeys(name.partition("[")[0] for name in names)
    index, units, scales = [], [], []
    for symbol in drift.symbols:
        if symbol not in free:
            raise InputError(say_unknown("drift.symbols", symbol, free))
        unit = layout.block(symbol).unit
        scale = {"mm": drift.scale_um, "rad": drift.scale_arcsec}.get(unit)
        if unit not in UNITS:
            raise InputError(f"drift.symbols: found {symbol!r} in {unit}, expected lengths or angles")
        if scale is None:
            key = "scale_um" if unit == "mm" else "scale_arcsec"
            raise InputError(f"drift: found {symbol!r} in {unit} without {key}, expected it, as {symbol!r} may move")
        for k, name in enumerate(names):
            if name.partition("[")[0] == symbol:
                index.append(k)
                units.append(name if drift.separate_by_leg else symbol)
                scales.append(scale * UNITS[unit][1])
    kept = list(dict.fromkeys(units))
    if len(kept) > MOST_UNITS:
        raise InputError(
            f"drift: found {len(kept)} scales, expected at most {MOST_UNITS}: fewer symbols, or separate_by_leg = false"
        )
    days = [one.time_days for one in config.sessions]
    walk = drift.model == "random_walk"
    loadings = walk_loadings(np.array(days, dtype=np.float64)) if walk else np.eye(len(days))
    unit_of = np.array([kept.index(one) for one in units])
    scale_of = np.array([scales[units.index(one)] for one in kept])
    return DriftModel(loadings, np.array(index), unit_of, tuple(kept), scale_of)


def _build_expansions(thermal: ThermalConfig | None, layout: ParameterLayout) -> tuple[ThermalExpansion, ...]:
    if thermal is None:
        return ()
    legs = {"struts": ("l",), "base": ("a_x", "a_y", "a_z"), "platform": ("b_x", "b_y", "b_z")}
    bodies = {name: (getattr(thermal, name), symbols) for name, symbols in legs.items()}
    bodies |= {name: (body, tuple(body.symbols)) for name, body in thermal.bodies.items()}
    found = []
    for name, (body, symbols) in bodies.items():
        if body is None:
            continue
        for symbol in symbols:
            if symbol not in layout.symbols or layout.block(symbol).unit != "mm":
                lengths = [block.symbol for block in layout.blocks if block.unit == "mm"]
                raise InputError(
                    f"thermal.{name}: found no length {symbol!r}, expected symbols of {', '.join(lengths)}"
                )
        index = np.concatenate([layout.index[symbol] for symbol in symbols])
        found.append(ThermalExpansion(name, index, PPM * body.ppm, PPM * body.sd_ppm))
    return tuple(found)


def pick_rows(measured: MeasuredReadings, chosen: np.ndarray) -> ReadingRows:
    """Return some of the poses of a session, (Q,)."""
    anchored = measured.with_pose_guesses
    return ReadingRows(replace(anchored, likelihood=anchored.likelihood.pick(chosen)))


def describe_free(
    measured: MeasuredReadings, study: str
) -> tuple[Array, Array, tuple[str, ...], tuple[str, ...], Array, Array]:
    """Return what `SessionModel` has of the free parameters; InputError for a prior that is not normal."""
    posterior = measured.posterior
    names, layout = posterior.sampling.names, posterior.likelihood.model.layout
    moves = posterior.sampling.moved
    priors = [posterior.priors[name] for name in names]
    for name, prior in zip(names, priors, strict=True):
        if not isinstance(prior, NormalPrior):
            raise InputError(f"{study}: parameters: found a uniform prior of {name}, expected normal ones")
    mean, sd = (np.array([getattr(one, key) for one in priors]) for key in ("mean", "sd"))
    units = tuple(layout.units[int(np.argmax(move))] for move in moves)
    return posterior.sampling.start, moves, names, units, mean, sd


def find_motions(measured: MeasuredReadings, theta: Array, moves: Array) -> tuple[list[str], list[str], Array]:
    """Return what free parameters, by moves (m, D), do at home of a machine (D,), its pose as it is.

    To the readings of the machine's own channels; to each leg in terms of its length l. Their names and units, N of
    each, and the slope (N, m).
    """
    model, data = measured.posterior.likelihood.model, measured.posterior.likelihood.data
    if model.legs is not None:
        machine = model.legs.machine
        actuators = machine.mechanism.initial_actuator_positions
        n_own = machine.layout.size  # all others, gains among them, do nothing at home
        theta, moves = theta[:n_own], moves[:, :n_own]
        home = solve_forward_kinematics(machine, theta, actuators)
        slope = machine.linearise(theta, home.position, home.rotation, actuators).parameters
        length = np.diagonal(slope[:, machine.layout.index["l"]])
        names = [str(k + 1) for k in range(len(slope))]
        return names, ["mm"] * len(slope), (slope @ moves.T) / length[:, None]
    own = np.flatnonzero(measured.internal)
    given = {name: np.array(np.median(value)) for name, value in data.given.items()}
    slope = model.linearise(theta, model.home_pose, True, given).by_parameters[own] @ moves.T
    channels = [model.channels[k] for k in own]
    return [one.name for one in channels], [one.unit for one in channels], slope


def measure_sessions(
    experiment: object, study: Any, path: Path, config: SessionsConfig, folder: Path
) -> list[MeasuredReadings]:
    """Return what each session measured, instead of the data of a study; InputError names the session."""
    check_measures(experiment, study, path)
    found, name = list[MeasuredReadings](), choose_variant(config.variant, study, path)
    for session in config.sessions:
        with name_faults(f"session {session.label!r}"):
            placed = _place_tables(study, session, folder, path) if hasattr(study, "data") else study
            measured = measure_variants(experiment, placed, path, [name])[name].count_by_row()
            errors = measured.posterior.errors
            if errors.outliers.expected:
                raise InputError(f"{path}: found a robust variant, expected another")
            if len(errors.terms_of(GPTerm)) < len(errors.common):
                raise InputError(f"{path}: found functions of [error_terms], expected none")
            if found and errors.names != found[0].posterior.errors.names:
                names, expected = (", ".join(one.names) for one in (errors, found[0].posterior.errors))
                raise InputError(f"found errors {names}, expected {expected}")
            found.append(measured)
    return _join_functions(found)


def _join_functions(measured: list[MeasuredReadings]) -> list[MeasuredReadings]:
    """Return sessions whose errors that are functions are of the same few columns in all, which suit all their rows."""
    every = [it.posterior.errors.terms_of(GPTerm) for it in measured]
    if not every[0]:
        return measured
    levers, n = every[0][0].own.levers, len(measured[0].internal)
    over = reduce(KernelInput.join, [some[0].own.at(np.flatnonzero(some[0].own.used)) for some in every])
    found = []
    for it in measured:
        errors = it.posterior.errors.change(GPTerm, lambda one: one.thin(n, replace(one.own, levers=levers), over))
        found.append(replace(it, posterior=replace(it.posterior, errors=errors)))
    return found


def _place_tables(study: Any, session: SessionConfig, folder: Path, path: Path) -> Any:
    """Return a study with a session's tables instead of its own, in their order."""
    if len(session.data) != len(study.data):
        raise InputError(f"data: found {len(session.data)} tables, expected {len(study.data)} as in {path}")
    tables = []
    for own, one in zip(study.data, session.data, strict=True):
        named = one.model_dump(exclude_none=True)
        for key in named:
            if key not in type(own).model_fields:
                raise InputError(f"data: found {key}, expected none for {own.kind} as in {path}")
        moved: dict[str, Any] = {
            key: os.path.relpath(str(folder / name), str(path.parent)) for key, name in named.items()
        }
        if "verification_poses" in type(own).model_fields:
            moved["verification_poses"] = []
        tables.append(own.model_copy(update=moved))
    return study.model_copy(update={"data": tables})


def check_same_machine(model: SessionModel, sessions: Sequence[MeasuredReadings], labels: Sequence[str]) -> None:
    """Raise InputError where the legs of a session are off those of the first by far more than they can have moved.

    In a walk; of machines without legs, or whose pose nobody measured, there is nothing to compare.
    """
    first = sessions[0].with_pose_guesses
    if first.likelihood.model.legs is None or not first.likelihood.model.reads_pose:
        return
    (theta,) = first.theta(first.least_squares_start()[None])  # the machine that explains the first best by itself
    off = np.stack([_find_offsets(one, theta) for one in sessions])
    elapsed = np.sqrt(np.sum(model.drift.loadings**2, axis=1))  # √month since the first
    limit = MAX_DRIFT_SCALES * float(model.drift.scale.max()) * np.maximum(elapsed, 1.0) + WARM
    beyond = np.flatnonzero(np.abs(off - off[0]).max(axis=1) > limit)
    if len(beyond):
        k = int(beyond[0])
        leg = int(np.argmax(np.abs(off[k] - off[0])))
        raise InputError(
            f"session {labels[k]!r}: found leg {leg + 1} off by {abs(off[k, leg] - off[0, leg]):.3g} "
            f"mm from session {labels[0]!r}, expected at most {limit[k]:.3g} mm; several machines: "
            'model = "population"'
        )


def _find_offsets(measured: MeasuredReadings, theta: Array) -> Array:
    """Return the mean error of each leg in a session for one machine θ (D,), shape (N,), mm."""
    likelihood = measured.posterior.likelihood
    model, own = likelihood.model, np.flatnonzero(measured.internal)
    read = model.read(theta, likelihood.data.values[:, model.select(POSE)], likelihood.data.given)
    return np.asarray(np.nanmean(likelihood.data.values[:, own] - read[:, own], axis=0))


def count_kept(n_draws: int) -> int:
    """Return how many draws of the scales are kept with a state."""
    return max(n_draws // 3, 100)
