"""Computing sessions: with and without drift, and with every part that may move held still by itself.

Scales by importance sampling, states in closed form, both compared with the exact density.
"""

from __future__ import annotations

import zlib
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import pandas as pd
from scipy.special import logsumexp

from bayescal.density.sessions import LinearSessions, SessionModel, find_state
from bayescal.experiments.frame.parallel import Run
from bayescal.experiments.frame.results import Results
from bayescal.experiments.sessions.inputs import PPM, UNITS, SessionsInputs, find_motions
from bayescal.experiments.shared.origin import name_origin
from bayescal.inference.scales import Scales, find_scales_mode, keep_by_weight, sample_scales
from bayescal.limits import PARETO_K_LIMIT
from bayescal.numerics.geometry import Array

ALL, NONE = "drift", "no drift"
STILL = "still: "
LOW, HIGH = 0.05, 0.95
SHIFT_ARCSEC = 20.0
ALIKE = 0.99  # share of effective draws from which on weights hardly differ
ROUNDS = 2  # of linearising at the state that the scales want
HALF_LOG_TWO_PI = 0.5 * np.log(2.0 * np.pi)

type Task = tuple[SessionModel, int, int]


def compute_sessions(inputs: SessionsInputs, run: Run) -> Results:
    """Return what sessions tell of drift, of legs, and of expansion."""
    model, config = inputs.model, inputs.config
    units = model.drift.units
    tasks: dict[str, tuple[str, ...]] = {ALL: units, NONE: ()}
    if len(units) > 1:  # a single one held still is no drift at all
        tasks |= {f"{STILL}{one}": tuple(other for other in units if other != one) for one in units}
    fits = run.map("sessions", _fit, (model, config.draws, config.seed), tasks, (SessionFit,))
    tables = tabulate(Found(inputs, fits[ALL]))
    # of each unit, at even prior odds, that it moves against that it does not, the others free to move
    still = [fits.get(f"{STILL}{one}", fits[NONE]) for one in units]
    tables["scales"]["log_odds_moved"] = [fits[ALL].log_evidence - one.log_evidence for one in still]
    rows = [(name, fit.log_evidence, fit.standard_error, *map(float, fit.quality)) for name, fit in fits.items()]
    columns = ["model", "log_evidence", "se", "efficiency", "pareto_k", "exact_efficiency", "exact_pareto_k"]
    tables["models"] = pd.DataFrame(rows, columns=columns)
    drift = fits[ALL].log_evidence - fits[NONE].log_evidence
    summary: dict[str, Any] = {
        "name": config.name,
        "title": config.title,
        "study": config.study,
        "variant": config.variant,
        "data_origin": name_origin(config.origin.model_dump()),
        "hierarchy": config.drift.hierarchy,
        "symbols": config.drift.symbols,
        "per_leg": config.drift.per_leg,
        "shift_um": config.shift_um,
        **({} if inputs.by_leg else {"shift_arcsec": config.shift_arcsec or SHIFT_ARCSEC}),
        "has_temperature": config.thermal is not None,
        "n_sessions": model.n_sessions,
        "n_poses": int(inputs.n_poses.sum()),
        "n_parameters": len(model.mean),
        "log_evidence_drift": drift,
        "log_evidence_drift_se": float(np.hypot(fits[ALL].standard_error, fits[NONE].standard_error)),
        "sound": {name: fit.is_sound for name, fit in fits.items()},
        **({"denied_slips": inputs.denied} if inputs.denied else {}),
    }
    return Results(summary, tables)


def _fit(shared: Task, units: tuple[str, ...]) -> SessionFit:
    model, n_draws, seed = shared
    rng = np.random.default_rng([seed, zlib.crc32("/".join(units).encode())])
    return fit_sessions(model.keep(units), n_draws, rng)


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

    @cached_property
    def expected(self) -> Array:
        """The same by the priors alone, shape (T, S, m)."""
        model, rng = self.inputs.model, np.random.default_rng(self.inputs.config.seed)
        z, zeta = (rng.standard_normal(one.shape) for one in (self.fit.z, self.fit.zeta))
        return model.mean + model.split(z, model.read_scales(zeta)[1])[0]

    @property
    def expansion(self) -> Array:
        """Coefficients α, shape (T, A), 1/K."""
        return self._states[1]

    def list_moves(self) -> list[tuple[dict[str, str], Array, Array]]:
        """Return which sessions are compared, and by how much parameters moved between them, shape (T, m).

        By the posterior and by the prior. Neighbours, then first and last; machines with the mean of all.
        """
        n, labels = self.inputs.model.n_sessions, self.inputs.labels
        x, before = self.parameters, self.expected
        if self.inputs.config.drift.hierarchy == "machines":
            off, apart = x - x.mean(axis=1, keepdims=True), before - before.mean(axis=1, keepdims=True)
            return [({"since": "mean", "session": labels[k]}, off[:, k], apart[:, k]) for k in range(n)]
        pairs = [(k - 1, k) for k in range(1, n)] + ([(0, n - 1)] if n > 2 else [])
        return [
            ({"since": labels[i], "session": labels[j]}, x[:, j] - x[:, i], before[:, j] - before[:, i])
            for i, j in pairs
        ]

    def compare(
        self, ends: dict[str, str], what: dict[str, Any], draws: Array, expected: Array, unit: str
    ) -> dict[str, Any]:
        """Return a row of what moved between two sessions by draws (T,), and how probably beyond the limit.

        ``learnt`` is the share of the prior's 90 % interval, by draws of it (T,), that the data take off.
        """
        config, (shown, size) = self.inputs.config, show_in(unit)
        limit = {"mm": config.shift_um, "rad": config.shift_arcsec or SHIFT_ARCSEC}.get(unit, np.inf)
        beyond = float(np.mean(np.abs(draws) > limit * size))
        shown_in = {} if self.inputs.by_leg else {"unit": shown}
        before, after = (float(np.ptp(np.quantile(one, [LOW, HIGH]))) for one in (expected, draws))
        learnt = 1.0 - after / before if before > 0.0 else 1.0
        return {**ends, **what, **shown_in, **_describe(draws, size), "beyond": beyond, "learnt": learnt}


def show_in(unit: str) -> tuple[str, float]:
    """Return the unit that a motion is shown in, and its size in the inner one."""
    return UNITS.get(unit, (unit, 1.0))


def tabulate(found: Found) -> dict[str, pd.DataFrame]:
    """Return all tables of sessions."""
    inputs = found.inputs
    days = [np.nan if one.day is None else one.day for one in inputs.config.sessions]
    measured = {"session": inputs.labels, "day": days, "n_poses": inputs.n_poses}
    own = inputs.first.posterior.errors
    sizes, shown = own.natural(inputs.model.read_scales(found.fit.zeta)[0]), [show_in(one) for one in own.units]
    errors = [
        {"error": name, "in": unit, **_describe(sizes[:, k], size)}
        for k, (name, (unit, size)) in enumerate(zip(own.names, shown, strict=True))
    ]
    motions, nothing, model = _tabulate_motions(found), pd.DataFrame(), inputs.model
    shifts = [
        found.compare(ends, {"parameter": model.names[k]}, moved[:, k], expected[:, k], model.units[k])
        for ends, moved, expected in found.list_moves()
        for k in model.drift.index
    ]
    return {
        "sessions": pd.DataFrame({**measured, "temperature_celsius": inputs.temperature}),
        "scales": _tabulate_scales(found),
        "legs": motions if inputs.by_leg else nothing,
        "channels": nothing if inputs.by_leg else motions,
        "shifts": pd.DataFrame(shifts),
        "parameters": _tabulate_parameters(found),
        "expansion": _tabulate_expansion(found),
        "model_error": pd.DataFrame(errors),
    }


def _describe(draws: Array, unit: float) -> dict[str, float]:
    """Return mean, standard deviation and 90 % interval of draws (T,), in a unit."""
    low, high = np.quantile(draws / unit, [LOW, HIGH])
    return {"mean": draws.mean() / unit, "sd": draws.std(ddof=1) / unit, "q05": low, "q95": high}


def _tabulate_scales(found: Found) -> pd.DataFrame:
    model, rows = found.inputs.model, []
    sigma = model.read_scales(found.fit.zeta)[1]
    for k, name in enumerate(model.drift.units):
        first = int(np.argmax(model.drift.unit == k))  # of what moves with this scale
        shown, size = show_in(model.units[model.drift.index[first]])
        row = {"unit": name, **_describe(sigma[:, k], size)}
        rows.append(row if found.inputs.by_leg else {**row, "in": shown})
    return pd.DataFrame(rows)


def _tabulate_motions(found: Found) -> pd.DataFrame:
    """Return what free parameters do to each leg, or to each channel, at home."""
    rows, model, x = [], found.inputs.model, found.parameters.mean(axis=(0, 1))
    start = model.start + (x - model.mean) @ model.moves
    names, units, slope = find_motions(found.inputs.first, start, model.moves)
    for ends, moved, expected in found.list_moves():
        by, before = moved @ slope.T, expected @ slope.T
        for k, (name, unit) in enumerate(zip(names, units, strict=True)):
            what = {"leg": k + 1} if found.inputs.by_leg else {"channel": name}
            rows.append(found.compare(ends, what, by[:, k], before[:, k], unit))
    return pd.DataFrame(rows)


def _tabulate_parameters(found: Found) -> pd.DataFrame:
    x, model = found.parameters, found.inputs.model
    rows = []
    for s, label in enumerate(found.inputs.labels):
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


@dataclass(frozen=True, eq=False)
class SessionFit:
    """What sessions say: evidence of the exact density, and draws of the posterior, scales and states.

    ``quality`` (4,): efficiency and Pareto k of the scales' weights, then of the weights from the linearised to the
    exact density.
    """

    log_evidence: float
    standard_error: float
    quality: Array
    zeta: Array  # (T, n_scales)
    z: Array  # (T, n)

    @property
    def is_sound(self) -> bool:
        """Whether no weights have too heavy a tail; of weights that are all alike the tail does not matter."""
        return all(share > ALIKE or k <= PARETO_K_LIMIT for share, k in self.quality.reshape(2, 2))


def fit_sessions(model: SessionModel, n_draws: int, rng: np.random.Generator) -> SessionFit:
    """Return evidence and draws of the joint posterior; n_draws of the scales, a third of them kept with a state each.

    Sessions are linearised at the most probable state at the most probable scales; NumericalError where none is found.
    """
    mode, state = np.zeros(model.n_scales), np.zeros(model.size)
    for _ in range(ROUNDS):
        linear, state = find_state(model, *model.read_scales(mode), state)
        mode = find_scales_mode(lambda scales, at=linear: compute_log_density(at, scales), mode)  # type: ignore[misc]
    kept = count_kept(n_draws)
    scales = sample_scales(lambda zeta: compute_log_density(linear, zeta), mode, n_draws, kept, rng)
    z, linearised = _draw_states(linear, scales, rng)
    log_weights = model.log_likelihood(z, scales.draws) - linearised
    both = np.concatenate([scales.draws, z], axis=1)
    exact = keep_by_weight(both, log_weights, kept, rng)
    correction = float(logsumexp(log_weights) - np.log(kept))
    spread = float(np.std(np.exp(log_weights - correction)) / np.sqrt(kept))
    n = model.n_scales
    return SessionFit(
        scales.log_evidence + correction,
        float(np.hypot(scales.standard_error, spread)),
        np.array([scales.efficiency, scales.pareto_k, exact.efficiency, exact.pareto_k]),
        exact.draws[:, :n],
        exact.draws[:, n:],
    )


def count_kept(n_draws: int) -> int:
    """Return how many draws of the scales are kept with a state."""
    return max(n_draws // 3, 100)


def compute_log_density(linear: LinearSessions, zeta: Array) -> Array:
    """Return the log-densities (B,) of scales ζ (B, n), prior included, the states integrated."""
    marginal = [linear.condition(*linear.model.read_scales(one)).log_marginal for one in zeta]
    return np.array(marginal) - 0.5 * np.sum(zeta**2, axis=1) - zeta.shape[1] * HALF_LOG_TWO_PI


def _draw_states(linear: LinearSessions, scales: Scales, rng: np.random.Generator) -> tuple[Array, Array]:
    """Return a state for each draw of the scales, shape (T, n), and its linearised log-likelihood, shape (T,)."""
    model, draws = linear.model, []
    values = np.empty(len(scales.draws))
    for k, zeta in enumerate(scales.draws):
        errors, sigma = model.read_scales(zeta)
        draws.append(linear.condition(errors, sigma).draw(rng.standard_normal(model.size)))
        values[k] = linear.log_likelihood(draws[-1], errors, sigma)
    return np.array(draws), values
