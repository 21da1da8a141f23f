"""From a config of sessions to their joint model."""

from __future__ import annotations

import os
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from bayescal.data.measured_poses import MeasuredPoses
from bayescal.density.pose_likelihood import PoseLikelihood
from bayescal.density.priors import NormalPrior
from bayescal.density.sessions.model import Drift, Expansion, Part, SessionModel, walk_loadings
from bayescal.errors import InputError, name_faults
from bayescal.experiments.frame.load import load
from bayescal.experiments.sessions.same_machine import check_same_machine
from bayescal.experiments.sessions.schema import SessionConfig, SessionsConfig, ThermalConfig
from bayescal.experiments.shared.denied_slips import tell_denial
from bayescal.experiments.shared.measured import MeasuredVariant, Measuring
from bayescal.experiments.shared.measured_slips import find_measured_slip
from bayescal.files.csv_tables import read_table
from bayescal.machines.parameters import ParameterLayout
from bayescal.numerics.geometry import Array
from bayescal.numerics.units import MICROMETRE

FILES = ("targets", "poses", "actuators", "reference")
PPM = 1e-6
MOST_UNITS = 24
"""Scales that evidence is integrated over."""


@dataclass(frozen=True, eq=False)
class SessionsInputs:
    """Sessions, read.

    Attributes
    ----------
    config : SessionsConfig
    model : SessionModel
    temperature : ndarray, shape (S,)
        Mean of each session's poses, °C; NaN where none is stated.
    n_poses : ndarray of int, shape (S,)
    denied : list of str
        Slips that sessions look like and the config denies, in words.
    """

    config: SessionsConfig
    model: SessionModel
    temperature: Array
    n_poses: np.ndarray
    denied: list[str]


def read_sessions(config: SessionsConfig, folder: Path) -> SessionsInputs:
    """Return sessions, read.

    Raises
    ------
    InputError
        Where the study or its variant is not there, a session's files are missing or of another machine, or
        temperatures are.
    """
    measured = [_measure(config, one, folder) for one in config.sessions]
    first = measured[0]
    denied = [_judge_slip(session, one) for session, one in zip(config.sessions, measured, strict=True)]
    _check_apart(config, [one.poses for one in measured])
    warmth = [_read_temperatures(one, it.poses, folder) for one, it in zip(config.sessions, measured, strict=True)]
    parts = [part for k, it in enumerate(measured) for part in _split(config, k, it, warmth[k])]
    mean, sd = _list_priors(config, first)
    coordinates = first.posterior.sampling.coordinates
    model = SessionModel(
        tuple(parts),
        coordinates.start,
        coordinates.free,
        mean,
        sd,
        _build_drift(config, first),
        _build_expansions(config.thermal, first.machine.layout),
        first.posterior.errors.model_error,
    )
    if config.drift.hierarchy == "walk":
        check_same_machine(model, first.posterior, [one.label for one in config.sessions])
    mean_temperature = np.array([np.nan if one is None else one.mean() for one in warmth])
    n_poses = np.array([one.poses.n_poses for one in measured])
    return SessionsInputs(config, model, mean_temperature, n_poses, [one for one in denied if one is not None])


def _measure(config: SessionsConfig, session: SessionConfig, folder: Path) -> MeasuredVariant:
    """Return the study's variant with what one session measured in place of the study's data."""
    path = folder / config.study
    experiment, study = load(path)
    if not isinstance(experiment, Measuring):
        raise InputError(f"{path}: kind: found {study.kind!r}, expected 'study', whose machine sessions measure again")
    known = experiment.list_variants(study)
    if config.variant not in known:
        raise InputError(f"{path}: variant {config.variant!r}: unknown here, expected one of {', '.join(known)}")
    with name_faults(f"session {session.label!r}"):
        placed = _place(study, session, folder, path)
        return experiment.measure(placed, path, known[config.variant], True)


def _place(study: Any, session: SessionConfig, folder: Path, path: Path) -> Any:
    """Return the study with a session's files, whose names start at the study's folder then."""
    data = study.data
    named = {key: getattr(session, key) for key in FILES if getattr(session, key) is not None}
    if data.measurement not in named:
        raise InputError(f"found no {data.measurement}, expected its file, as {path} is a study of {data.measurement}")
    for key in named:
        if key not in type(data).model_fields:
            raise InputError(f"found {key}, expected nothing of it, as {path} is a study of {data.measurement}")
    moved = {key: os.path.relpath(folder / name, path.parent) for key, name in named.items()}
    return study.model_copy(update={"data": data.model_copy(update=moved)})


def _judge_slip(session: SessionConfig, measured: MeasuredVariant) -> str | None:
    """Return the slip that a session looks like and the config denies; None where it looks like none.

    Raises
    ------
    InputError
        Where a slip explains a session many times better: joined to others it would pass for drift.
    """
    slip = find_measured_slip([measured], session.denied_slips)
    if slip is not None:
        raise InputError(
            f"session {session.label!r}: found poses that no machine within the tolerances comes near, expected this "
            f"machine's; {slip.say()}{tell_denial('denied_slips of the session')}"
        )
    slip = find_measured_slip([measured]) if session.denied_slips else None
    return None if slip is None else f"Session {session.label!r}: {slip.say()}"


def _check_apart(config: SessionsConfig, poses: list[MeasuredPoses]) -> None:
    """Raise InputError where a session is another one once more."""
    for k, one in enumerate(poses):
        for earlier in range(k):
            if np.array_equal(one.position, poses[earlier].position):
                raise InputError(
                    f"session {config.sessions[k].label!r}: found the readings of session "
                    f"{config.sessions[earlier].label!r} to the last digit, expected another measurement"
                )


def _read_temperatures(session: SessionConfig, poses: MeasuredPoses, folder: Path) -> Array | None:
    """Return the temperature at each calibration pose (P,), °C; None where none is stated."""
    if session.temperature_celsius is not None:
        return np.full(poses.n_poses, session.temperature_celsius)
    if session.temperatures is None:
        return None
    table = read_table(folder / session.temperatures, ("pose", "temperature_celsius"), ("use",))
    names = table.text("pose")
    table.check_unique([(name,) for name in names], "pose")
    for name in poses.names:
        if name not in names:
            raise InputError(f"{folder / session.temperatures}: found no row of pose {str(name)!r}, expected one")
    return table.numbers(["temperature_celsius"])[[names.index(name) for name in poses.names], 0]


def _split(config: SessionsConfig, session: int, measured: MeasuredVariant, warmth: Array | None) -> list[Part]:
    """Return a session's poses, those of one temperature together."""
    poses, variance = measured.poses, measured.actuator_variance
    if config.thermal is None or warmth is None:
        likelihood = PoseLikelihood(measured.machine, poses, measured.actuator_noise, variance)
        return [Part(likelihood, session)]
    parts = []
    for temperature in np.unique(warmth):
        chosen = np.flatnonzero(warmth == temperature)
        some = None if variance is None else variance[chosen]
        likelihood = PoseLikelihood(measured.machine, poses.select(chosen), measured.actuator_noise, some)
        parts.append(Part(likelihood, session, float(temperature - config.thermal.reference_celsius)))
    return parts


def _list_priors(config: SessionsConfig, measured: MeasuredVariant) -> tuple[Array, Array]:
    """Return means and standard deviations of the free parameters' priors, in their order in θ."""
    posterior, layout = measured.posterior, measured.machine.layout
    priors = [posterior.priors[layout.names[k]] for k in posterior.sampling.free]
    for prior, k in zip(priors, posterior.sampling.free, strict=True):
        if not isinstance(prior, NormalPrior):
            raise InputError(
                f"{config.study}: parameters: found a uniform prior of {layout.names[k]}, expected normal ones, since "
                "sessions are joined in closed form"
            )
    return np.array([one.mean for one in priors]), np.array([one.sd for one in priors])


def _build_drift(config: SessionsConfig, measured: MeasuredVariant) -> Drift:
    drift, layout = config.drift, measured.machine.layout
    free = measured.posterior.sampling.free
    index, units = [], []
    for symbol in drift.symbols:
        if symbol not in measured.free:
            raise InputError(f"drift.symbols: found {symbol!r}, expected one of {', '.join(measured.free)}")
        block = layout.block(symbol)
        if block.unit != "mm":
            raise InputError(f"drift.symbols: found {symbol!r} in {block.unit}, expected lengths, as scale_um is one")
        for name, place in zip(block.names, layout.index[symbol], strict=True):
            index.append(int(np.searchsorted(free, place)))
            units.append(name if drift.per_leg else symbol)
    names = tuple(dict.fromkeys(units))
    if len(names) > MOST_UNITS:
        raise InputError(
            f"drift: found {len(names)} scales, expected at most {MOST_UNITS}: fewer symbols, or per_leg = false"
        )
    days = [one.day for one in config.sessions]
    walk = drift.hierarchy == "walk"
    loadings = walk_loadings(np.array(days, dtype=np.float64)) if walk else np.eye(len(days))
    unit = np.array([names.index(one) for one in units])
    return Drift(loadings, np.array(index), unit, names, drift.scale_um * MICROMETRE)


def _build_expansions(thermal: ThermalConfig | None, layout: ParameterLayout) -> tuple[Expansion, ...]:
    if thermal is None:
        return ()
    found = []
    for name, symbols in (("struts", ("l",)), ("base", ("a_x", "a_y", "a_z")), ("platform", ("b_x", "b_y", "b_z"))):
        body = getattr(thermal, name)
        if body is not None:
            index = np.concatenate([layout.index[symbol] for symbol in symbols])
            found.append(Expansion(name, index, PPM * body.ppm, PPM * body.sd_ppm))
    return tuple(found)


def without_expansion(model: SessionModel) -> SessionModel:
    """Return the same sessions as if the temperature did nothing."""
    return replace(model, expansions=())
