"""Computing sessions: with and without drift, and with every part that may move held still by itself.

Scales by importance sampling, states in closed form, both compared with the exact density.
"""

from __future__ import annotations

import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TypedDict

import numpy as np
import pandas as pd
from scipy.special import logsumexp

from bayescal.density.sessions import LinearSessions, SessionModel, find_state
from bayescal.experiments.runner.parallel import Run
from bayescal.experiments.runner.results import Results, Summary
from bayescal.experiments.sessions.inputs import PPM, UNITS, SessionsInputs, count_kept, find_motions
from bayescal.experiments.sessions.rows import (
    ChannelMotionRow,
    DriftModelRow,
    DriftScaleRow,
    ExpansionRow,
    LegMotionRow,
    SessionErrorRow,
    SessionParameterRow,
    SessionRow,
    SessionShiftRow,
)
from bayescal.experiments.shared.origin import name_origin
from bayescal.inference.scales import Scales, find_scales_mode, keep_by_weight, sample_scales
from bayescal.limits import PARETO_K_LIMIT
from bayescal.numerics.geometry import Array

ALL, NONE = "drift", "no drift"
NO_MOTION_PREFIX = "still: "
LOW, HIGH = 0.05, 0.95
SHIFT_ARCSEC = 20.0
EVEN_WEIGHTS_EFFICIENCY = 0.99  # share of effective draws from which on weights hardly differ
ROUNDS = 2  # of linearising at the state that the scales want
HALF_LOG_TWO_PI = 0.5 * np.log(2.0 * np.pi)

type Task = tuple[SessionModel, int, int]


def compute_sessions(inputs: SessionsInputs, run: Run) -> Results:
    """Return what sessions tell of drift, of legs, and of expansion."""
    model, config = inputs.model, inputs.config
    units = model.drift.units
    tasks: dict[str, tuple[str, ...]] = {ALL: units, NONE: ()}
    if len(units) > 1:  # a single one held still is no drift at all
        tasks |= {f"{NO_MOTION_PREFIX}{one}": tuple(other for other in units if other != one) for one in units}
    fits = run.map("sessions", _fit, (model, config.draws, config.seed), tasks, (SessionFit,))
    # of each unit, at even prior odds, that it moves against that it does not, the others free to move
    still = [fits.get(f"{NO_MOTION_PREFIX}{one}", fits[NONE]) for one in units]
    moved = [fits[ALL].log_evidence - one.log_evidence for one in still]
    tables = tabulate(SessionsPosterior(inputs, fits[ALL]), moved)
    models = [
        DriftModelRow(
            model=name,
            log_evidence=fit.log_evidence,
            se=fit.standard_error,
            efficiency=float(fit.quality[0]),
            pareto_k=float(fit.quality[1]),
            exact_efficiency=float(fit.quality[2]),
            exact_pareto_k=float(fit.quality[3]),
        )
        for name, fit in fits.items()
    ]
    tables["models"] = DriftModelRow.collect(models)
    drift = fits[ALL].log_evidence - fits[NONE].log_evidence
    summary: Summary = {
        "name": config.name,
        "title": config.title,
        "study": config.study,
        "variant": inputs.first.name,
        "data_origin": name_origin(config.provenance.model_dump()),
        "drift_model": config.drift.model,
        "symbols": config.drift.symbols,
        "separate_by_leg": config.drift.separate_by_leg,
        "motion_limit_um": config.motion_limit_um,
        **({} if inputs.is_leg_mechanism else {"motion_limit_arcsec": config.motion_limit_arcsec or SHIFT_ARCSEC}),
        "has_temperature": config.thermal is not None,
        "n_sessions": model.n_sessions,
        "n_poses": int(inputs.n_poses.sum()),
        "n_parameters": len(model.mean),
        "log_evidence_drift": drift,
        "log_evidence_drift_se": float(np.hypot(fits[ALL].standard_error, fits[NONE].standard_error)),
        "reliable": {name: fit.is_reliable for name, fit in fits.items()},
        **({"ignored_data_errors": inputs.denied} if inputs.denied else {}),
    }
    return Results(summary, tables)


def _fit(shared: Task, units: tuple[str, ...]) -> SessionFit:
    model, n_draws, seed = shared
    rng = np.random.default_rng([seed, zlib.crc32("/".join(units).encode())])
    return fit_sessions(model.keep(units), n_draws, rng)


@dataclass(frozen=True, eq=False)
class SessionsPosterior:
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

    def list_moves(self) -> list[tuple[SessionPair, Array, Array]]:
        """Return which sessions are compared, and by how much parameters moved between them, shape (T, m).

        By the posterior and by the prior. Neighbours, then first and last; machines with the mean of all.
        """
        n, labels = self.inputs.model.n_sessions, self.inputs.labels
        x, before = self.parameters, self.expected
        if self.inputs.config.drift.model == "population":
            off, apart = x - x.mean(axis=1, keepdims=True), before - before.mean(axis=1, keepdims=True)
            return [({"since": "mean", "session": labels[k]}, off[:, k], apart[:, k]) for k in range(n)]
        pairs = [(k - 1, k) for k in range(1, n)] + ([(0, n - 1)] if n > 2 else [])
        return [
            ({"since": labels[i], "session": labels[j]}, x[:, j] - x[:, i], before[:, j] - before[:, i])
            for i, j in pairs
        ]

    def measure_shift(self, draws: Array, expected: Array, unit: str) -> ShiftColumns:
        """Return the columns of a shift between two sessions by draws (T,) of the posterior and of the prior."""
        config, (shown, size) = self.inputs.config, show_in(unit)
        limit = {"mm": config.motion_limit_um, "rad": config.motion_limit_arcsec or SHIFT_ARCSEC}.get(unit, np.inf)
        before, after = (float(np.ptp(np.quantile(one, [LOW, HIGH]))) for one in (expected, draws))
        return {
            **_describe(draws, size),
            "unit": None if self.inputs.is_leg_mechanism else shown,
            "p_exceeds_limit": float(np.mean(np.abs(draws) > limit * size)),
            "interval_reduction": 1.0 - after / before if before > 0.0 else 1.0,
        }


class SessionPair(TypedDict):
    """Columns that name the sessions compared."""

    since: str
    session: str


class DrawColumns(TypedDict):
    """Columns that describe draws."""

    mean: float
    sd: float
    q05: float
    q95: float


class ShiftColumns(DrawColumns):
    """Columns of a shift; see `SessionShiftRow`."""

    unit: str | None
    p_exceeds_limit: float
    interval_reduction: float


def show_in(unit: str) -> tuple[str, float]:
    """Return the unit that a motion is shown in, and its size in the inner one."""
    return UNITS.get(unit, (unit, 1.0))


def tabulate(found: SessionsPosterior, log_bayes_factors: Sequence[float]) -> dict[str, pd.DataFrame]:
    """Return all tables of sessions; the factors are those of `DriftScaleRow`, a drift scale each."""
    inputs, model = found.inputs, found.inputs.model
    own, x = inputs.first.posterior.errors, found.parameters
    sizes, sigma = own.natural(model.read_scales(found.fit.zeta)[0]), model.read_scales(found.fit.zeta)[1]
    legs, channels = _list_motions(found)
    sessions = SessionRow.tabulate(
        session=inputs.labels,
        time_days=[np.nan if one.time_days is None else one.time_days for one in inputs.config.sessions],
        n_poses=inputs.n_poses,
        temperature_celsius=inputs.temperature,
    )
    scales = list[DriftScaleRow]()
    for k, name in enumerate(model.drift.units):
        first = int(np.argmax(model.drift.unit == k))  # of what moves with this scale
        shown, size = show_in(model.units[model.drift.index[first]])
        unit = None if inputs.is_leg_mechanism else shown
        row = DriftScaleRow(
            parameter_group=name,
            unit=unit,
            log_bayes_factor_moved=log_bayes_factors[k],
            **_describe(sigma[:, k], size),
        )
        scales.append(row)
    shifts = [
        SessionShiftRow(
            parameter=model.names[k], **ends, **found.measure_shift(moved[:, k], expected[:, k], model.units[k])
        )
        for ends, moved, expected in found.list_moves()
        for k in model.drift.index
    ]
    parameters = [
        SessionParameterRow.tabulate(
            session=label,
            parameter=model.names,
            mean=x[:, s].mean(axis=0),
            sd=x[:, s].std(axis=0, ddof=1),
            prior_sd=model.sd,
        )
        for s, label in enumerate(inputs.labels)
    ]
    expansion = [
        ExpansionRow(
            body=one.name,
            prior_mean=one.mean / PPM,
            prior_sd=one.sd / PPM,
            **_describe(found.expansion[:, k], PPM),
        )
        for k, one in enumerate(model.expansions)
    ]
    errors = [
        SessionErrorRow(error=name, unit=unit, **_describe(sizes[:, k], size))
        for k, (name, (unit, size)) in enumerate(zip(own.names, map(show_in, own.units), strict=True))
    ]
    return {
        "sessions": sessions,
        "scales": DriftScaleRow.collect(scales),
        "legs": LegMotionRow.collect(legs),
        "channels": ChannelMotionRow.collect(channels),
        "shifts": SessionShiftRow.collect(shifts),
        "parameters": pd.concat(parameters, ignore_index=True),
        "expansion": ExpansionRow.collect(expansion),
        "model_error": SessionErrorRow.collect(errors),
    }


def _describe(draws: Array, unit: float) -> DrawColumns:
    """Return mean, standard deviation and 90 % interval of draws (T,), in a unit."""
    low, high = np.quantile(draws / unit, [LOW, HIGH])
    return {"mean": draws.mean() / unit, "sd": draws.std(ddof=1) / unit, "q05": float(low), "q95": float(high)}


def _list_motions(found: SessionsPosterior) -> tuple[list[LegMotionRow], list[ChannelMotionRow]]:
    """Return what free parameters do to each leg, or to each channel, at home; one of the lists is empty."""
    legs, channels = list[LegMotionRow](), list[ChannelMotionRow]()
    model, x = found.inputs.model, found.parameters.mean(axis=(0, 1))
    start = model.start + (x - model.mean) @ model.moves
    names, units, slope = find_motions(found.inputs.first, start, model.moves)
    for ends, moved, expected in found.list_moves():
        by, before = moved @ slope.T, expected @ slope.T
        for k, (name, unit) in enumerate(zip(names, units, strict=True)):
            shift = found.measure_shift(by[:, k], before[:, k], unit)
            if found.inputs.is_leg_mechanism:
                legs.append(LegMotionRow(leg=k + 1, **ends, **shift))
            else:
                channels.append(ChannelMotionRow(channel=name, **ends, **shift))
    return legs, channels


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
    def is_reliable(self) -> bool:
        """Whether no weights have too heavy a tail; of weights that are all equal the tail does not matter."""
        return all(share > EVEN_WEIGHTS_EFFICIENCY or k <= PARETO_K_LIMIT for share, k in self.quality.reshape(2, 2))


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
        draws.append(linear.condition(errors, sigma).draw(rng.standard_normal((model.size, 1)))[:, 0])
        values[k] = linear.log_likelihood(draws[-1], errors, sigma)
    return np.array(draws), values
