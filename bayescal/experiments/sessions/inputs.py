"""From a config of sessions to their joint model."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from bayescal.density.sessions import Drift, Expansion, Part, SessionModel, walk_loadings
from bayescal.errors import InputError
from bayescal.experiments.frame.load import load
from bayescal.experiments.sessions.measured import Session, measure_sessions
from bayescal.experiments.sessions.same_machine import check_same_machine
from bayescal.experiments.sessions.schema import SessionConfig, SessionsConfig, ThermalConfig
from bayescal.experiments.shared.slips import tell_denial
from bayescal.files.csv_tables import read_table
from bayescal.machines.parameters import ParameterLayout
from bayescal.numerics.geometry import Array
from bayescal.numerics.units import ARCSECOND, MICROMETRE

PPM = 1e-6
MOST_UNITS = 24
"""Scales that evidence is integrated over."""
UNITS = {"mm": ("µm", MICROMETRE), "rad": ("arcsec", ARCSECOND)}
"""What motions are told in, by the unit of what moves."""


@dataclass(frozen=True, eq=False)
class SessionsInputs:
    """Sessions, read.

    Attributes
    ----------
    config : SessionsConfig
    model : SessionModel
    first : Session
        The first of them.
    temperature : ndarray, shape (S,)
        Mean of each session's poses, °C; NaN where none is stated.
    n_poses : ndarray of int, shape (S,)
    denied : list of str
        Slips that sessions look like and the config denies, in words.
    """

    config: SessionsConfig
    model: SessionModel
    first: Session
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
    path = folder / config.study
    measured = measure_sessions(*load(path), path, config, folder)
    first = measured[0]
    denied = [_judge_slip(session, one) for session, one in zip(config.sessions, measured, strict=True)]
    _check_apart(config, measured)
    warmth = [_read_temperatures(one, it, folder) for one, it in zip(config.sessions, measured, strict=True)]
    parts = [part for k, it in enumerate(measured) for part in _split(config, k, it, warmth[k])]
    design = first.design(config.study)
    model = SessionModel(
        tuple(parts),
        design.start,
        design.moves,
        design.names,
        design.units,
        design.mean,
        design.sd,
        _build_drift(config, first),
        _build_expansions(config.thermal, first.layout),
    )
    legs = [one.measured.legs for one in measured if one.measured.legs is not None]
    if config.drift.hierarchy == "walk" and legs:
        check_same_machine(model, legs, [one.label for one in config.sessions])
    mean_temperature = np.array([np.nan if one is None else one.mean() for one in warmth])
    n_poses = np.array([len(one.poses) for one in measured])
    return SessionsInputs(config, model, first, mean_temperature, n_poses, [one for one in denied if one is not None])


def _judge_slip(session: SessionConfig, measured: Session) -> str | None:
    """Return the slip that a session looks like and the config denies; None where it looks like none.

    Raises
    ------
    InputError
        Where a slip explains a session many times better: joined to others it would pass for drift.
    """
    slip = measured.find_slip(session.denied_slips)
    if slip is not None:
        raise InputError(
            f"session {session.label!r}: found data that no machine within the tolerances comes near, expected this "
            f"machine's; {slip.say()}{tell_denial('denied_slips of the session')}"
        )
    slip = measured.find_slip() if session.denied_slips else None
    return None if slip is None else f"Session {session.label!r}: {slip.say()}"


def _check_apart(config: SessionsConfig, measured: list[Session]) -> None:
    """Raise InputError where a session is another one once more."""
    for k, one in enumerate(measured):
        for earlier in range(k):
            if np.array_equal(one.values, measured[earlier].values, equal_nan=True):
                raise InputError(
                    f"session {config.sessions[k].label!r}: found the readings of session "
                    f"{config.sessions[earlier].label!r} to the last digit, expected another measurement"
                )


def _read_temperatures(session: SessionConfig, measured: Session, folder: Path) -> Array | None:
    """Return the temperature at each calibration pose (P,), °C; None where none is stated."""
    if session.temperature_celsius is not None:
        return np.full(len(measured.poses), session.temperature_celsius)
    if session.temperatures is None:
        return None
    table = read_table(folder / session.temperatures, ("pose", "temperature_celsius"), ("use",))
    names = table.text("pose")
    table.check_unique([(name,) for name in names], "pose")
    for name in measured.poses:
        if name not in names:
            raise InputError(f"{folder / session.temperatures}: found no row of pose {str(name)!r}, expected one")
    return table.numbers(["temperature_celsius"])[[names.index(name) for name in measured.poses], 0]


def _split(config: SessionsConfig, session: int, measured: Session, warmth: Array | None) -> list[Part]:
    """Return a session's poses, those of one temperature together."""
    if config.thermal is None or warmth is None:
        return [Part(measured.rows(np.arange(len(measured.poses))), session)]
    return [
        Part(measured.rows(np.flatnonzero(warmth == one)), session, float(one - config.thermal.reference_celsius))
        for one in np.unique(warmth)
    ]


def _build_drift(config: SessionsConfig, first: Session) -> Drift:
    drift, layout, names = config.drift, first.layout, first.names
    index, units, scales = [], [], []
    for symbol in drift.symbols:
        if symbol not in first.free:
            raise InputError(f"drift.symbols: found {symbol!r}, expected one of {', '.join(first.free)}")
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
                units.append(name if drift.per_leg else symbol)
                scales.append(scale * UNITS[unit][1])
    kept = list(dict.fromkeys(units))
    if len(kept) > MOST_UNITS:
        raise InputError(
            f"drift: found {len(kept)} scales, expected at most {MOST_UNITS}: fewer symbols, or per_leg = false"
        )
    days = [one.day for one in config.sessions]
    walk = drift.hierarchy == "walk"
    loadings = walk_loadings(np.array(days, dtype=np.float64)) if walk else np.eye(len(days))
    unit_of = np.array([kept.index(one) for one in units])
    scale_of = np.array([scales[units.index(one)] for one in kept])
    return Drift(loadings, np.array(index), unit_of, tuple(kept), scale_of)


def _build_expansions(thermal: ThermalConfig | None, layout: ParameterLayout) -> tuple[Expansion, ...]:
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
                    f"thermal.{name}: found no length {symbol!r}, expected bodies.{name} with symbols of "
                    f"{', '.join(lengths)}"
                )
        index = np.concatenate([layout.index[symbol] for symbol in symbols])
        found.append(Expansion(name, index, PPM * body.ppm, PPM * body.sd_ppm))
    return tuple(found)
