"""What the draws of sessions say, as tables: motions of parameters and of legs, scales, expansion."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import pandas as pd

from bayescal.experiments.sessions.fit import SessionFit
from bayescal.experiments.sessions.inputs import PPM, SessionsInputs
from bayescal.machines.kinematics import solve_forward_kinematics
from bayescal.numerics.geometry import Array
from bayescal.numerics.units import MICROMETRE

LOW, HIGH = 0.05, 0.95


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
    def by_leg(self) -> Array:
        """What a free parameter does to each leg at home, in terms of its length l, shape (N, m)."""
        model = self.inputs.model
        machine = model.parts[0].likelihood.machine
        theta = model.start.copy()
        theta[model.free] = self.parameters.mean(axis=(0, 1))
        actuators = machine.mechanism.initial_actuator_positions
        home = solve_forward_kinematics(machine, theta, actuators)
        slope = machine.linearise(theta, home.position, home.rotation, actuators).parameters
        length = np.diagonal(slope[:, machine.layout.index["l"]])
        return np.asarray(slope[:, model.free] / length[:, None])


def tabulate(found: Found) -> dict[str, pd.DataFrame]:
    """Return all tables of sessions."""
    return {
        "sessions": _tabulate_sessions(found),
        "scales": _tabulate_scales(found),
        "legs": _tabulate_legs(found),
        "shifts": _tabulate_shifts(found),
        "parameters": _tabulate_parameters(found),
        "expansion": _tabulate_expansion(found),
        "model_error": _tabulate_model_error(found),
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
    return pd.DataFrame([{"unit": unit, **_describe(sigma[:, k], MICROMETRE)} for k, unit in enumerate(units)])


def _compare(found: Found, pair: tuple[int, int], what: dict[str, Any], draws: Array) -> dict[str, Any]:
    beyond = float(np.mean(np.abs(draws) > found.inputs.config.shift_um * MICROMETRE))
    ends = {"since": found.name(pair[0]), "session": found.name(pair[1])}
    return {**ends, **what, **_describe(draws, MICROMETRE), "beyond": beyond}


def _tabulate_legs(found: Found) -> pd.DataFrame:
    rows = []
    for pair in found.pairs:
        legs = found.move(pair) @ found.by_leg.T
        rows += [_compare(found, pair, {"leg": k + 1}, legs[:, k]) for k in range(legs.shape[1])]
    return pd.DataFrame(rows)


def _tabulate_shifts(found: Found) -> pd.DataFrame:
    model, rows = found.inputs.model, []
    for pair in found.pairs:
        moved = found.move(pair)
        rows += [_compare(found, pair, {"parameter": model.names[k]}, moved[:, k]) for k in model.drift.index]
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
