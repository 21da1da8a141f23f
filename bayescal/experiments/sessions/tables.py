"""What the draws of sessions say, as tables: motions of parameters and of legs, scales, expansion."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import pandas as pd

from bayescal.experiments.sessions.fit import SessionFit
from bayescal.experiments.sessions.inputs import PPM, UNITS, SessionsInputs
from bayescal.experiments.sessions.measured import Motions
from bayescal.numerics.geometry import Array
from bayescal.numerics.units import MICROMETRE

LOW, HIGH = 0.05, 0.95
SHIFT_ARCSEC = 20.0


@dataclass(frozen=True, eq=False)
class Found:
    """Sessions and the draws of their posterior."""

    inputs: SessionsInputs
    fit: SessionFit

    @cached_property
    def _states(self) -> tuple[Array, Array]:
        model = self.inputs.model
        return model.split(self.fit.z, model.read_scales(self.fit.zeta)[1])

    @property
    def parameters(self) -> Array:
        """Free parameters of every session, shape (T, S, m)."""
        return self.inputs.model.mean + self._states[0]

    @property
    def expansion(self) -> Array:
        """Coefficients α, shape (T, A), 1/K."""
        return self._states[1]

    @property
    def labels(self) -> list[str]:
        """Of the sessions."""
        return [one.label for one in self.inputs.config.sessions]

    @property
    def pairs(self) -> list[tuple[int, int]]:
        """Which sessions are set against each other: neighbours, then first and last; machines against their mean."""
        n = self.inputs.model.n_sessions
        if self.inputs.config.drift.hierarchy == "machines":
            return [(-1, k) for k in range(n)]
        return [(k - 1, k) for k in range(1, n)] + ([(0, n - 1)] if n > 2 else [])

    def name(self, session: int) -> str:
        """Return a session's label; that of the mean of all machines for -1."""
        return "mean" if session < 0 else self.labels[session]

    def move(self, pair: tuple[int, int]) -> Array:
        """Return by how much parameters moved between two sessions, shape (T, m)."""
        x = self.parameters
        before = x.mean(axis=1) if pair[0] < 0 else x[:, pair[0]]
        return np.asarray(x[:, pair[1]] - before)

    @cached_property
    def motions(self) -> Motions:
        """What a free parameter does to each leg, or to each channel, at home."""
        model, x = self.inputs.model, self.parameters.mean(axis=(0, 1))
        return self.inputs.first.move(model.start + (x - model.mean) @ model.moves, model.moves)


def tabulate(found: Found) -> dict[str, pd.DataFrame]:
    """Return all tables of sessions."""
    return {
        "sessions": _tabulate_sessions(found),
        "scales": _tabulate_scales(found),
        "legs": _tabulate_legs(found) if found.inputs.first.by_leg else pd.DataFrame(),
        "channels": pd.DataFrame() if found.inputs.first.by_leg else _tabulate_channels(found),
        "shifts": _tabulate_shifts(found),
        "parameters": _tabulate_parameters(found),
        "expansion": _tabulate_expansion(found),
        "model_error": _tabulate_model_error(found) if found.inputs.first.by_leg else pd.DataFrame(),
    }


def _describe(draws: Array, unit: float) -> dict[str, float]:
    """Return mean, standard deviation and 90 % interval of draws (T,), in a unit."""
    low, high = np.quantile(draws / unit, [LOW, HIGH])
    return {"mean": draws.mean() / unit, "sd": draws.std(ddof=1) / unit, "q05": low, "q95": high}


def _tabulate_sessions(found: Found) -> pd.DataFrame:
    inputs = found.inputs
    days = [np.nan if one.day is None else one.day for one in inputs.config.sessions]
    return pd.DataFrame(
        {"session": found.labels, "day": days, "n_poses": inputs.n_poses, "temperature_celsius": inputs.temperature}
    )


def _tabulate_scales(found: Found) -> pd.DataFrame:
    sigma = found.inputs.model.read_scales(found.fit.zeta)[1]
    units = found.inputs.model.drift.units
    kinds = [found.inputs.model.units[found.inputs.model.drift.index[unit]] for unit in _first_of(found)]
    rows = [(unit, *_tell_in(kind)) for unit, kind in zip(units, kinds, strict=True)]
    told = [{"unit": unit, **_describe(sigma[:, k], size)} for k, (unit, _, size) in enumerate(rows)]
    if not found.inputs.first.by_leg:
        told = [{**one, "in": word} for one, (_, word, _) in zip(told, rows, strict=True)]
    return pd.DataFrame(told)


def _first_of(found: Found) -> list[int]:
    """Return the first of what moves with each scale, by its place in the drift."""
    unit = found.inputs.model.drift.unit
    return [int(np.argmax(unit == k)) for k in range(len(found.inputs.model.drift.units))]


def _tell_in(unit: str) -> tuple[str, float]:
    """Return the unit that a motion is told in, and its size in the inner one."""
    return UNITS.get(unit, (unit, 1.0))


def _compare(found: Found, pair: tuple[int, int], what: dict[str, Any], draws: Array, unit: str) -> dict[str, Any]:
    config, (_, size) = found.inputs.config, _tell_in(unit)
    limit = {"mm": config.shift_um, "rad": config.shift_arcsec or SHIFT_ARCSEC}.get(unit, np.inf)
    ends = {"since": found.name(pair[0]), "session": found.name(pair[1])}
    return {**ends, **what, **_describe(draws, size), "beyond": float(np.mean(np.abs(draws) > limit * size))}


def _tabulate_legs(found: Found) -> pd.DataFrame:
    rows = []
    for pair in found.pairs:
        legs = found.move(pair) @ found.motions.slope.T
        rows += [_compare(found, pair, {"leg": k + 1}, legs[:, k], "mm") for k in range(legs.shape[1])]
    return pd.DataFrame(rows)


def _tabulate_channels(found: Found) -> pd.DataFrame:
    rows, motions = [], found.motions
    for pair in found.pairs:
        moved = found.move(pair) @ motions.slope.T
        for k, (name, unit) in enumerate(zip(motions.names, motions.units, strict=True)):
            what = {"channel": name, "unit": _tell_in(unit)[0]}
            rows.append(_compare(found, pair, what, moved[:, k], unit))
    return pd.DataFrame(rows)


def _tabulate_shifts(found: Found) -> pd.DataFrame:
    model, rows = found.inputs.model, []
    for pair in found.pairs:
        moved = found.move(pair)
        for k in model.drift.index:
            what = {"parameter": model.names[k]}
            if not found.inputs.first.by_leg:
                what["unit"] = _tell_in(model.units[k])[0]
            rows.append(_compare(found, pair, what, moved[:, k], model.units[k]))
    return pd.DataFrame(rows)


def _tabulate_parameters(found: Found) -> pd.DataFrame:
    x, model = found.parameters, found.inputs.model
    rows = []
    for s, label in enumerate(found.labels):
        for k, name in enumerate(model.names):
            one = {"mean": x[:, s, k].mean(), "sd": x[:, s, k].std(ddof=1)}
            rows.append({"session": label, "parameter": name, **one, "prior_sd": model.sd[k]})
    return pd.DataFrame(rows)


def _tabulate_expansion(found: Found) -> pd.DataFrame:
    rows = []
    for k, one in enumerate(found.inputs.model.expansions):
        prior = {"prior_mean": one.mean / PPM, "prior_sd": one.sd / PPM}
        rows.append({"body": one.name, **prior, **_describe(found.expansion[:, k], PPM)})
    return pd.DataFrame(rows, columns=["body", "prior_mean", "prior_sd", "mean", "sd", "q05", "q95"])


def _tabulate_model_error(found: Found) -> pd.DataFrame:
    tau = found.inputs.model.read_scales(found.fit.zeta)[0]
    return pd.DataFrame([{"leg": k + 1, **_describe(tau[:, k], MICROMETRE)} for k in range(tau.shape[1])])
