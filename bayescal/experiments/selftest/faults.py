"""What the measured data say of a config: each kind of fault by itself, the gravest first."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Literal

import numpy as np
from scipy.optimize import minimize
from scipy.stats import chi2

from bayescal.density.calibration.likelihood import CalibrationPosterior
from bayescal.density.calibration.terms import ErrorModel, ErrorTerm
from bayescal.density.linear_gaussian import condition_white, whiten
from bayescal.density.low_rank import gather_columns
from bayescal.density.sessions import ReadingRows
from bayescal.errors import NumericalError
from bayescal.experiments.selftest.inputs import TestedVariant, draw_posterior
from bayescal.experiments.shared.error_sizes import find_units
from bayescal.experiments.shared.measured import MeasuredReadings
from bayescal.experiments.shared.slip_search import PATIENCE, search_cause
from bayescal.experiments.shared.slip_verdict import MIN_CAUSE_GAIN_NAT, Search
from bayescal.experiments.shared.slips import split_advice
from bayescal.experiments.shared.soundness import ChiSquare, fit_rows, format_chance
from bayescal.inference.mode import Mode, find_mode
from bayescal.inference.target import LogDensity
from bayescal.limits import IDENTIFIABLE_CONTRACTION
from bayescal.numerics.geometry import Array
from bayescal.report.numbers import format_significant, name_some
from bayescal.report.symbols import write_unit

GRADIENT_STEP = 1e-3  # prior sd, or of the half width of the workspace; halved, and both extrapolated
MAX_GRADIENT_ERROR = 1e-3  # of the largest difference along a parameter; right ones agree to 1e-6
MACHINES = 3
MISSED_MODE_GAP_NAT = 4.0  # nats that a missed mode's mass may lie below the best
MODE_DISTANCE_SDS = 5.0  # posterior sds from a known mode
DRAWN_STARTS = 4
PAIRS = 15
IMPROBABLE_NOISE = 1e-4
UNUSUAL = 0.05  # of χ²: a probability below which it is said that there is little or much of it
FACTORS = (0.25, 0.35, 0.5, 0.7, 1.4, 2.0, 2.8, 4.0, 8.0)  # on the noise, that are tried
ERROR_STARTS = (-1.6, 0.5)  # of what is unknown of the errors, in its coordinates
MOST_ERROR = 8.0
CLEARLY = 3.0  # nats by which model errors have to explain more than noise does
IMPROBABLE_PRIOR = 1e-3  # of all groups together
NAMED_SLIPS = 3
MOST_ODDS = 13.8  # nats
type Level = Literal["good", "warning", "bad"]
type Look = tuple[list[Finding], Array, Array]
"""Findings, and draws of the posterior of the measured data, (S, n) in natural units and in coordinates; none after a
cause that has to be corrected first."""


@dataclass(frozen=True)
class Finding:
    """What one check found."""

    check: str  # what was looked at, in a word or two
    fault: str  # its name; empty where there is none
    level: Level
    text: str  # in a sentence
    action: str = ""  # what to do
    value: float = np.nan  # the figure that it rests on, and what that is compared with
    limit: float = np.nan


def check_derivatives(subject: TestedVariant, rng: np.random.Generator) -> Finding:
    """Return whether readings' derivatives are those of differences, at machines of the priors."""
    worst: dict[str, float] = {}
    for _ in range(MACHINES):
        y, _ = subject.draw_truth(rng)
        for name, value in _compare(subject, y).items():
            worst[name] = max(worst.get(name, 0.0), value)
    wrong = {name: value for name, value in worst.items() if value > MAX_GRADIENT_ERROR}
    most = max(worst.values(), default=0.0)
    if not wrong:
        text = f"derivatives agree with differences to {max(most, 1e-09):.0e}."
        return Finding("Derivatives", "", "good", text, value=most, limit=MAX_GRADIENT_ERROR)
    symbols = name_some(list(dict.fromkeys(name.partition("[")[0] for name in wrong)))
    text = f"derivatives by {symbols} are off by up to {100 * most:.3g} %."
    action = "Correct the machine's class."
    return Finding("Derivatives", "derivative", "bad", text, action, most, MAX_GRADIENT_ERROR)


def _compare(subject: TestedVariant, y: Array) -> dict[str, float]:
    """Return how far the derivative by each coordinate of posterior and pose is off, in its largest difference."""
    posterior, half = subject.measured.with_pose_guesses, subject.measured.half
    likelihood, m = posterior.likelihood, posterior.n_geometry
    model, given, pose = likelihood.model, likelihood.data.given, likelihood.start
    theta = posterior.theta(y[None])[0]
    here = model.linearise(theta, pose, True, given)
    known = [here.by_parameters @ move for move in posterior.around(y)[1].T] + list(np.moveaxis(here.by_pose, -1, 0))
    names = [*posterior.sampling.names, *(one.name for one in model.coordinates)]
    found = {}
    for k, (name, slope) in enumerate(zip(names, known, strict=True)):

        def read(size: float, k: int = k) -> Array:
            at, where = y.copy(), pose.copy()
            if k < m:
                at[k] += size
            else:
                where[:, k - m] += size * half[k - m]
            return np.asarray(model.read(posterior.theta(at[None])[0], where, given))

        rough, fine = ((read(step) - read(-step)) / (2.0 * step) for step in (GRADIENT_STEP, GRADIENT_STEP / 2.0))
        expected = (4.0 * fine - rough) / 3.0
        slope = slope if k < m else slope * half[k - m]
        good = np.isfinite(expected) & np.isfinite(slope)
        size = np.max(np.abs(expected), axis=0, initial=0.0, where=good)
        seen = size > 1e-9 * np.max(np.abs(np.nan_to_num(here.values)), axis=0, initial=1e-12)
        off = np.max(np.abs(slope - expected), axis=0, initial=0.0, where=good)
        found[name] = float(np.max(off[seen] / size[seen], initial=0.0))
    return found


def check_modes(posterior: LogDensity, known: list[Mode], starts: list[Array]) -> Finding:
    """Return whether searches from starts, (n,) each, find a mode with mass besides the known ones, the best first."""
    missed: list[Mode] = []
    for start in starts:
        try:
            found = find_mode(posterior, start)
        except (NumericalError, np.linalg.LinAlgError):
            continue
        matters = found.converged and found.log_evidence > known[0].log_evidence - MISSED_MODE_GAP_NAT
        if matters and all(_measure_distance(found, one) >= MODE_DISTANCE_SDS for one in (*known, *missed)):
            missed.append(found)
    if not missed:
        text = f"no further modes found from {len(starts)} starts ({len(known)} known)."
        return Finding("Modes", "", "good", text, value=0.0, limit=0.0)
    gain = max(one.log_evidence for one in missed) - known[0].log_evidence
    text = f"missed modes: {len(missed)} (best log-evidence difference {gain:+.1f} nat)."
    action = "Narrow priors, or free both direction components."
    return Finding("Modes", "mode", "bad", text, action, len(missed), 0.0)


def list_starts(posterior: LogDensity, best: Array, rng: np.random.Generator) -> list[Array]:
    """Return where jumps lead, one and two of them, and draws of the priors, coordinates (n,) each."""
    single = dict(posterior.mode_candidates(best))
    pairs = [
        dict(posterior.mode_candidates(single[one])).get(other) for one, other in list(combinations(single, 2))[:PAIRS]
    ]
    drawn = rng.standard_normal((DRAWN_STARTS, posterior.n_parameters))
    return [*single.values(), *(one for one in pairs if one is not None), *drawn]


def _measure_distance(one: Mode, other: Mode) -> float:
    """Return how far apart two modes are, in the posterior sds of the one of which it is less."""
    step = one.y - other.y
    return float(np.sqrt(min(float(step @ np.linalg.solve(mode.covariance, step)) for mode in (one, other))))


def check_noise(measured: MeasuredReadings) -> Finding:
    """Return whether the noise is as stated.

    What the best machine leaves of the readings is explained once by the stated noise and model errors of their prior,
    and once by so many times the stated noise and such model errors. An error that all poses share, of a measured K, is
    fitted along: as noise of single poses it would count as often as there are poses, and χ² come out too low.
    """
    extraction = _check_extraction(measured)
    if extraction is not None:
        return extraction
    left = _fit_known(measured)
    found, errors = left.found, measured.posterior.errors
    factor, check = found.factor, "Noise"
    said = f"χ² / dof {found.value / found.dof:.2f} ({format_chance(found.chance)})"
    if errors.outliers.expected:
        return Finding(check, "", "good", f"{said}; outlier model active.", "", factor, 1.0)
    stated, zeta = left.explain(1.0)
    sizes, units = find_units(measured.posterior.likelihood.model, errors.names, errors.units)
    values = zip(errors.names, sizes * errors.natural(zeta), units, strict=True)
    free = name_some([f"{name} {x:.3g} {write_unit(unit)}".rstrip() for name, x, unit in values])
    if any(type(one).factor is not ErrorTerm.factor for one in errors.terms):
        return Finding(check, "", "good", f"{said}; free noise and errors: {free}.", "", factor, 1.0)
    best, times = max((left.explain(x)[0], x) for x in FACTORS)
    if best - stated > 0.5 * float(chi2.isf(IMPROBABLE_NOISE, 1)):
        text = f"{said}: about {times:.2g} times the noise, most in {left.largest}."
        action = "State the noise of the averages." if times < 1.0 else "State it larger, free it, or extend the model."
        return Finding(check, "noise", "bad", text, action, times, 1.0)
    if not found.is_off:
        how = "as stated" if found.chance >= UNUSUAL else "within chance"
        return Finding(check, "", "good", f"{said}, {how}.", "", factor, 1.0)
    if found.factor < 1.0:
        action = "State smaller noise, unless rows are averages."
        return Finding(check, "noise", "warning", f"{said}: too small.", action, factor, 1.0)
    if not free:
        action = "Extend the model."
        return Finding(check, "noise", "bad", f"{said}: too large, most in {left.largest}.", action, factor, 1.0)
    alone, times = max((left.explain(x, without=True)[0], x) for x in FACTORS)
    if alone > stated - CLEARLY:
        text = f"{said}: explained by {free} or {times:.2g} times the noise."
        return Finding(check, "noise", "warning", text, "Check the noise first.", times, 1.0)
    action = "Look for a deformation or larger channel errors."
    return Finding(check, "model error", "warning", f"{said}: explained by free errors ({free}).", action, factor, 1.0)


def _check_extraction(measured: MeasuredReadings) -> Finding | None:
    """Return whether the targets scatter about rigid bodies by another noise than stated; None where they do not."""
    described = measured.described.get("pose_extraction")
    if not isinstance(described, dict):
        return None
    found = ChiSquare(described["chi2_per_dof"] * described["dof"], described["dof"])
    if not found.is_off:
        return None
    text = f"target scatter / target noise: {found.factor:.2g}."
    action = f"Multiply target_noise_um by {found.factor:.2g}."
    return Finding("Noise", "noise", "bad", text, action, found.factor, 1.0)


# --- what is left ------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class NoiseResiduals:
    """What the best machine leaves of the readings at the stated noise.

    ``errors`` (P, R): free of the poses, as large as they would be had nothing been fitted; those of the machine as
    expected where some errors are common to all rows. ``covariance`` takes what is unknown of the errors, (n,), to
    (P, R, R); see `bayescal.density.sessions.LinearisedRows`. ``missing`` (P, R, R): the part of it that is no
    reading's; by the stated noise alone the whole is the identity. ``common`` takes the same to columns of errors
    common to all rows, (P, R, N), and of the machine; none where there are no such errors. ``largest``:
    kind of the channels with the largest residuals.
    """

    found: ChiSquare
    errors: Array
    covariance: Callable[[Array], Array]
    missing: Array
    common: Callable[[Array], Array]
    n_errors: int
    largest: str

    def explain(self, factor: float, without: bool = False) -> tuple[float, Array]:
        """Return the log-density at so many times the noise and the best errors, with their prior, and these, (n,)."""
        stated = np.eye(self.errors.shape[1])
        known = factor**2 * (stated - self.missing) + self.missing
        if without or not self.n_errors:
            none = np.full(self.n_errors, -MOST_ERROR)
            return _log_density(self.errors, known, self.common(none)), np.zeros(self.n_errors)

        def cost(zeta: Array) -> float:
            covariance = known + self.covariance(zeta) - stated
            return 0.5 * float(zeta @ zeta) - _log_density(self.errors, covariance, self.common(zeta))

        bounds = [(-MOST_ERROR, MOST_ERROR)] * self.n_errors
        found = [minimize(cost, np.full(self.n_errors, x), method="L-BFGS-B", bounds=bounds) for x in ERROR_STARTS]
        best = min(found, key=lambda one: float(one.fun))
        return -float(best.fun), np.asarray(best.x)


def _fit_known(measured: MeasuredReadings) -> NoiseResiduals:
    """Return what is left at the best machine by the stated noise; what all poses share is fitted along."""
    own = measured.posterior.errors
    alone, likelihood = ErrorModel(tuple(own.known), own.outliers), measured.posterior.likelihood.plain
    known = replace(measured.posterior, likelihood=likelihood, errors=alone).with_pose_guesses()
    y = known.least_squares_start()
    white, slope = known.likelihood.reduced_rows(*known.around(y), known.errors, known.zeta(y))
    m, n_spare = known.n_geometry, int(known.likelihood.n_spare.sum())
    held = np.concatenate([y[:m], np.zeros(slope.shape[-1] - m)])
    left, found = fit_rows(white, slope, held, np.eye(slope.shape[-1]), n_spare)
    found = ChiSquare(found.value, max(found.dof, 1.0))
    rows = ReadingRows(replace(known, errors=ErrorModel(own.terms))).linearise(known.theta(y[None])[0])
    across = np.swapaxes(rows.basis, 1, 2)
    missing = across @ (~known.likelihood.data.present[..., None] * rows.basis)
    errors = (across @ left[..., None])[..., 0] * np.sqrt(n_spare / found.dof)
    machine = np.zeros((*errors.shape, 0))
    if own.has_columns:  # the machine is as unknown as it was: it imitates a part of them
        machine = rows.slope @ known.around(y)[1]
        errors = rows.errors - machine @ y[:m]

    def common(zeta: Array) -> Array:
        return np.concatenate([machine, rows.common(zeta)], axis=-1) if own.has_columns else machine

    present, kinds = known.likelihood.data.present, np.array([one.kind for one in known.likelihood.model.channels])
    rms = {
        kind: float(np.sqrt(np.mean(left[:, kinds == kind][present[:, kinds == kind]] ** 2)))
        for kind in dict.fromkeys(kinds.tolist())
        if present[:, kinds == kind].any()
    }
    return NoiseResiduals(
        found, errors, rows.covariance, missing, common, own.n_parameters, max(rms, key=rms.__getitem__)
    )


def _log_density(errors: Array, covariance: Array, common: Array) -> float:
    """Return that of rows (P, R), each with a covariance (P, R, R), and columns (P, R, N) of what is common to all."""
    columns = np.broadcast_to(common, (*errors.shape, common.shape[-1]))
    white, volume = whiten(covariance, np.concatenate([columns, errors[..., None]], axis=-1))
    columns = gather_columns(white[..., :-1]).reshape(errors.size, -1)
    return float(condition_white(columns, white[..., -1].reshape(-1, 1), -volume.sum()).log_marginal)


def check_priors(posterior: CalibrationPosterior, draws: Array) -> Finding:
    """Return whether the machine lies within its tolerances; draws of the posterior in natural units, (S, n).

    In units of the tolerances a posterior mean has the prior covariance 1 - C, with C that of the posterior. Along the
    directions that the data inform, its squared length is χ²; a tolerance stated three times too small makes it nine
    times as large.
    """
    names = posterior.names[: posterior.n_geometry]
    priors = [posterior.priors[name] for name in names]
    values = (draws[:, : len(names)] - [p.mean for p in priors]) / [p.sd for p in priors]
    mean, expected = values.mean(axis=0), np.eye(len(names)) - np.atleast_2d(np.cov(values, rowvar=False))
    symbols = np.array([name.partition("[")[0] for name in names])
    groups = {symbol: np.flatnonzero(symbols == symbol) for symbol in dict.fromkeys(symbols.tolist())}
    found = {"all together": _measure(mean, expected, np.arange(len(names)))}
    found |= {symbol: _measure(mean, expected, places) for symbol, places in groups.items()}
    level = IMPROBABLE_PRIOR / len(found)
    off = {name: one for name, one in found.items() if one[1] and chi2.sf(*one) < level}
    if not off:
        square, n = found["all together"]
        if not n:
            return Finding("Tolerances", "", "good", "not determined.")
        ratio = float(np.sqrt(square / n))
        text = f"deviations / tolerances: {ratio:.2g} (rms of {n} directions)."
        return Finding("Tolerances", "", "good", text, value=ratio, limit=1.0)
    worst = min(groups, key=lambda name: chi2.sf(*found[name]) if found[name][1] else 1.0)
    ratios = {
        name: float(np.sqrt(found[name][0] / found[name][1]))
        for name in [name for name in groups if name in off] or [worst]
    }
    named = name_some([f"{name} {ratio:.2g}" for name, ratio in ratios.items()])
    text = f"prior–data conflict; deviations / tolerances: {named}."
    action = "Widen priors or check the model."
    return Finding("Tolerances", "prior", "bad", text, action, max(ratios.values()), 1.0)


def _measure(mean: Array, expected: Array, places: np.ndarray) -> tuple[float, int]:
    """Return the squared length of a part of the mean in what is expected of it, and in how many directions."""
    values, vectors = np.linalg.eigh(expected[np.ix_(places, places)])
    informed = values >= IDENTIFIABLE_CONTRACTION
    along = mean[places] @ vectors[:, informed]
    return float(np.sum(along**2 / values[informed])), int(informed.sum())


def look_at_data(task: tuple[TestedVariant, int, int]) -> Look:
    """Return what the measured data say of a variant, from draws so many and a seed."""
    subject, n_draws, seed = task
    draw_seed, mode_seed, derivative_seed = np.random.SeedSequence([seed, 1]).spawn(3)
    posterior = subject.posterior
    findings = [check_derivatives(subject, np.random.default_rng(derivative_seed))]
    findings += state_cause(search_cause(subject.measured.readings))
    nothing = np.empty((0, posterior.n_parameters))
    if any(one.fault for one in findings):  # nothing else can be said then
        return findings, nothing, nothing
    try:
        draws, y, found, _ = draw_posterior(posterior, n_draws, draw_seed)
        noise = check_noise(subject.measured)
    except NumericalError as error:
        findings.append(Finding("Search", "search", "bad", f"posterior not found: {error}."))
        return findings, nothing, nothing
    starts = list_starts(posterior, found.modes[0].y, np.random.default_rng(mode_seed))
    modes = check_modes(posterior, found.modes, starts)
    return [*findings, modes, noise, check_priors(posterior, draws)], draws, y


def state_cause(search: Search) -> list[Finding]:
    """Return what explains the data better than the study does: what to do first, how sure that is, and why."""
    first, check = search.first, "Likely cause"
    if first is not None:
        text, advice = split_advice(first.text)
        odds = "10⁶" if first.odds > MOST_ODDS else format_significant(float(np.exp(first.odds)), 2)
        text = f"{text[:-1]} (odds {odds} : 1)."
        return [Finding(check, first.fault, "bad", text, advice, first.gain, MIN_CAUSE_GAIN_NAT)]
    if search.stopped:
        text = f"stopped after {PATIENCE:.0f} s; {search.tried} hypotheses tested."
        return [Finding(check, "", "warning", text, value=search.tried)]
    found = [Finding(check, "", "good", f"no data error found ({search.tried} hypotheses tested).", value=search.tried)]
    return found + [
        Finding("Undetectable error", "", "good", f"{one.partition(':')[0]}.") for one in search.unnoticed[:NAMED_SLIPS]
    ]
