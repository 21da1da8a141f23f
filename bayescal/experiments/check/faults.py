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
from bayescal.density.calibration.terms import Errors, ErrorTerm
from bayescal.density.low_rank import gather_columns
from bayescal.density.sessions import ReadingRows
from bayescal.errors import NumericalError
from bayescal.experiments.check.inputs import Subject, draw_posterior
from bayescal.experiments.shared.error_sizes import find_units
from bayescal.experiments.shared.measured import MeasuredReadings
from bayescal.experiments.shared.slip_search import PATIENCE, search_cause
from bayescal.experiments.shared.slip_verdict import Search
from bayescal.experiments.shared.soundness import ChiSquare, fit_rows, format_chance
from bayescal.inference.mode import Mode, find_mode
from bayescal.inference.target import Target
from bayescal.limits import INFORMED
from bayescal.numerics.geometry import Array
from bayescal.report.numbers import format_significant, join_words
from bayescal.report.symbols import write_unit

STEP = 1e-3  # prior sd, or of the half width of the workspace; halved, and both extrapolated
WRONG = 1e-3  # of the largest difference along a parameter; right ones agree to 1e-6
MACHINES = 3
MATTERS = 4.0  # nats that a missed mode's mass may lie below the best
APART = 5.0  # posterior sds from a known mode
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
    text: str  # in a sentence or two, with what to do


def check_derivatives(subject: Subject, rng: np.random.Generator) -> Finding:
    """Return whether readings' derivatives are those of differences, at machines of the priors."""
    worst: dict[str, float] = {}
    for _ in range(MACHINES):
        y, _ = subject.draw_truth(rng)
        for name, value in _compare(subject, y).items():
            worst[name] = max(worst.get(name, 0.0), value)
    wrong = {name: value for name, value in worst.items() if value > WRONG}
    if not wrong:
        most = max(worst.values(), default=0.0)
        text = f"the model's derivatives are those of differences, to {max(most, 1e-9):.0e} at worst."
        return Finding("Derivatives", "", "good", text)
    symbols = ", ".join(dict.fromkeys(name.partition("[")[0] for name in wrong))
    text = (
        f"the model's derivatives by {symbols} are wrong: off by up to {100 * max(wrong.values()):.3g} "
        "%. Correct what the machine's class returns for them; modes rest on it."
    )
    return Finding("Derivatives", "derivative", "bad", text)


def _compare(subject: Subject, y: Array) -> dict[str, float]:
    """Return how far the derivative by each coordinate of posterior and pose is off, in its largest difference."""
    posterior, half = subject.measured.anchored, subject.measured.half
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

        rough, fine = ((read(step) - read(-step)) / (2.0 * step) for step in (STEP, STEP / 2.0))
        expected = (4.0 * fine - rough) / 3.0
        slope = slope if k < m else slope * half[k - m]
        good = np.isfinite(expected) & np.isfinite(slope)
        size = np.max(np.abs(expected), axis=0, initial=0.0, where=good)
        seen = size > 1e-9 * np.max(np.abs(np.nan_to_num(here.values)), axis=0, initial=1e-12)
        off = np.max(np.abs(slope - expected), axis=0, initial=0.0, where=good)
        found[name] = float(np.max(off[seen] / size[seen], initial=0.0))
    return found


def check_modes(posterior: Target, known: list[Mode], starts: list[Array]) -> Finding:
    """Return whether searches from starts, (n,) each, find a mode with mass besides the known ones, the best first."""
    missed: list[Mode] = []
    for start in starts:
        try:
            found = find_mode(posterior, start)
        except (NumericalError, np.linalg.LinAlgError):
            continue
        matters = found.converged and found.log_evidence > known[0].log_evidence - MATTERS
        if matters and all(_measure_distance(found, one) >= APART for one in (*known, *missed)):
            missed.append(found)
    if not missed:
        return Finding(
            "Modes", "", "good", f"{len(starts)} searches from elsewhere found no mode but the {len(known)} known."
        )
    gain = max(one.log_evidence for one in missed) - known[0].log_evidence
    text = (
        f"{len(missed)} mode{'s' if len(missed) > 1 else ''} with mass that the search does not find, the best "
        f"{gain:+.1f} nats against the one it starts from. Intervals and evidence leave it out: narrow the priors, of "
        "directions above all, or free both components of a direction."
    )
    return Finding("Modes", "mode", "bad", text)


def list_starts(posterior: Target, best: Array, rng: np.random.Generator) -> list[Array]:
    """Return where jumps lead, one and two of them, and draws of the priors, coordinates (n,) each."""
    single = dict(posterior.jumps(best))
    pairs = [dict(posterior.jumps(single[one])).get(other) for one, other in list(combinations(single, 2))[:PAIRS]]
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
    said = f"χ² of the readings is {found.value / found.dof:.2f} per degree of freedom ({found.dof:.0f}, "
    said += f"{format_chance(found.chance)}) at the stated noise"
    if errors.outliers.expected:
        return Finding("Noise", "", "good", f"{said}; rows may be outliers, which count by how far off they are.")
    stated, zeta = left.explain(1.0)
    sizes, units = find_units(measured.posterior.likelihood.model, errors.names, errors.units)
    values = zip(errors.names, sizes * errors.natural(zeta), units, strict=True)
    free = [f"{name} {x:.3g} {write_unit(unit)}".rstrip() for name, x, unit in values]
    if any(type(one).factor is not ErrorTerm.factor for one in errors.terms):
        return Finding("Noise", "", "good", f"{said}; what is free of it is estimated, about {', '.join(free)}.")
    best, factor = max((left.explain(x)[0], x) for x in FACTORS)
    if best - stated > 0.5 * float(chi2.isf(IMPROBABLE_NOISE, 1)):
        text = f"{said}: about {factor:.2g} times the stated noise, most of it in {left.largest}. State the noise of it"
        text += (
            ". Perhaps the rows are averages of several measurements."
            if factor < 1.0
            else (", leave it free, or look for what the model misses.")
        )
        return Finding("Noise", "noise", "bad", text)
    if not found.is_off:
        few = "less" if found.factor < 1.0 else "more"
        how = f"{few} than noise of the stated size mostly gives, but not beyond chance"
        how = "as noise of the stated size gives" if found.chance >= UNUSUAL else how
        return Finding("Noise", "", "good", f"{said}, {how}.")
    if found.factor < 1.0:
        text = f"{said}: less than noise of the stated size gives. It is stated too large, or rows are averages."
        return Finding("Noise", "noise", "warning", f"{text} Intervals are wider than they need be.")
    said += ": more than the stated noise"
    if not free:
        return Finding(
            "Noise", "noise", "bad", f"{said}, most of it in {left.largest}. Look for what the model misses."
        )
    alone, times = max((left.explain(x, without=True)[0], x) for x in FACTORS)
    said += f". Errors that are free explain it ({', '.join(free)})"
    if alone > stated - CLEARLY:
        text = f"{said}, and so does {times:.2g} times the noise: make sure of the stated noise first."
        return Finding("Noise", "noise", "warning", text)
    text = (
        f"{said}, more noise of all channels does not: look for a missing deformation, or for channels that err more."
    )
    return Finding("Noise", "model error", "warning", text)


def _check_extraction(measured: MeasuredReadings) -> Finding | None:
    """Return whether the targets scatter about rigid bodies by another noise than stated; None where they do not."""
    described = measured.described.get("pose_extraction")
    if not isinstance(described, dict):
        return None
    found = ChiSquare(described["chi2_per_dof"] * described["dof"], described["dof"])
    if not found.is_off:
        return None
    text = (
        f"targets scatter about rigid bodies {found.factor:.2g} times as much as their stated noise (χ² per degree of "
        f"freedom {described['chi2_per_dof']:.2f}, {format_chance(found.chance)}), whatever the machine. State "
        f"target_noise_um {found.factor:.2g} times as large."
    )
    return Finding("Noise", "noise", "bad", text)


# --- what is left ------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Left:
    """What the best machine leaves of the readings at the stated noise.

    ``errors`` (P, R): free of the poses, as large as they would be had nothing been fitted; those of the machine as
    expected where some errors are common to all rows. ``covariance`` takes what is unknown of the errors, (n,), to
    (P, R, R); see `bayescal.density.sessions.LinearRows`. ``missing`` (P, R, R): the part of it that is no reading's;
    by the stated noise alone the whole is the identity. ``common`` takes the same to columns of errors common to all
    rows, (P, R, N), and of the machine; none where there are no such errors. ``largest``: kind of the channels that are
    left with most.
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


def _fit_known(measured: MeasuredReadings) -> Left:
    """Return what is left at the best machine by the stated noise; what all poses share is fitted along."""
    own = measured.posterior.errors
    alone, likelihood = Errors(tuple(own.known), own.outliers), measured.posterior.likelihood.plain
    known = replace(measured.posterior, likelihood=likelihood, errors=alone).anchored()
    y = known.approach()
    white, slope = known.likelihood.reduced_rows(*known.around(y), known.errors, known.zeta(y))
    m, n_spare = known.n_geometry, int(known.likelihood.n_spare.sum())
    held = np.concatenate([y[:m], np.zeros(slope.shape[-1] - m)])
    left, found = fit_rows(white, slope, held, np.eye(slope.shape[-1]), n_spare)
    found = ChiSquare(found.value, max(found.dof, 1.0))
    rows = ReadingRows(replace(known, errors=Errors(own.terms))).linearise(known.theta(y[None])[0])
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
    return Left(found, errors, rows.covariance, missing, common, own.n_parameters, max(rms, key=rms.__getitem__))


def _log_density(errors: Array, covariance: Array, common: Array) -> float:
    """Return that of rows (P, R), each with a covariance (P, R, R), and columns (P, R, N) of what is common to all."""
    root = np.linalg.cholesky(covariance)
    white = np.linalg.solve(
        root, np.concatenate([np.broadcast_to(common, (*errors.shape, common.shape[-1])), errors[..., None]], axis=-1)
    )
    flat, log_det = white.reshape(errors.size, -1), 2.0 * float(np.log(np.diagonal(root, axis1=1, axis2=2)).sum())
    columns, left = gather_columns(white[..., :-1]).reshape(errors.size, -1), flat[:, -1]
    inner = np.eye(columns.shape[1]) + columns.T @ columns
    along = columns.T @ left
    square = float(left @ left - along @ np.linalg.solve(inner, along))
    return -0.5 * (square + log_det + float(np.linalg.slogdet(inner)[1]))


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
        said = f"{np.sqrt(square / n):.2g} times as far from nominal as expected" if n else "not determined by the data"
        return Finding("Tolerances", "", "good", f"the machine is {said} (rms along {n} informed directions).")
    worst = min(groups, key=lambda name: chi2.sf(*found[name]) if found[name][1] else 1.0)
    named = [name for name in groups if name in off] or [worst]
    times = join_words([f"{name} {np.sqrt(found[name][0] / found[name][1]):.2g} times" for name in named])
    text = (
        f"the machine lies further from nominal than its tolerances allow: in {times} as far as expected. Widen these "
        "priors, or look for what bends the estimates."
    )
    return Finding("Tolerances", "prior", "bad", text)


def _measure(mean: Array, expected: Array, places: np.ndarray) -> tuple[float, int]:
    """Return the squared length of a part of the mean in what is expected of it, and in how many directions."""
    values, vectors = np.linalg.eigh(expected[np.ix_(places, places)])
    informed = values >= INFORMED
    along = mean[places] @ vectors[:, informed]
    return float(np.sum(along**2 / values[informed])), int(informed.sum())


def look_at_data(task: tuple[Subject, int, int]) -> Look:
    """Return what the measured data say of a variant, from draws so many and a seed."""
    subject, n_draws, seed = task
    draw_seed, mode_seed, derivative_seed = np.random.SeedSequence([seed, 1]).spawn(3)
    posterior = subject.posterior
    findings = [check_derivatives(subject, np.random.default_rng(derivative_seed))]
    findings.append(state_cause(search_cause(subject.measured.readings)))
    nothing = np.empty((0, posterior.n_parameters))
    if any(one.fault for one in findings):  # nothing else can be said then
        return findings, nothing, nothing
    try:
        draws, y, found, _ = draw_posterior(posterior, n_draws, draw_seed)
        noise = check_noise(subject.measured)
    except NumericalError as error:
        findings.append(Finding("Search", "search", "bad", f"the posterior is not found: {error}."))
        return findings, nothing, nothing
    starts = list_starts(posterior, found.modes[0].y, np.random.default_rng(mode_seed))
    modes = check_modes(posterior, found.modes, starts)
    return [*findings, modes, noise, check_priors(posterior, draws)], draws, y


def state_cause(search: Search) -> Finding:
    """Return what explains the data better than the study does: what to do first, how sure that is, and why."""
    first, check = search.first, "Likely cause"
    if first is not None:
        odds = "more than a million" if first.odds > MOST_ODDS else format_significant(float(np.exp(first.odds)), 2)
        text = (
            f"{first.text}. Odds against the next explanation ({first.rival}): {odds} to 1. The data are "
            f"explained better by {format_significant(first.gain, 2)} nats, {search.tried} causes tried; all other "
            "findings rest on it."
        )
        return Finding(check, first.fault, "bad", text)
    text = f"of {search.tried} causes tried none explains the data better than the study does"
    if search.stopped:
        text = f"no cause was found in {PATIENCE:.0f} s; {search.tried} were tried: units, signs, order, frames, noise"
        return Finding(check, "", "warning", f"{text}, rows, single channels, tolerances and drifts.")
    if not search.unnoticed:
        return Finding(check, "", "good", f"{text}; no planted slip of the table would pass unnoticed.")
    shown = [one.partition(":")[0] for one in search.unnoticed[:NAMED_SLIPS]]
    named = "; ".join(one.replace(" seem to be", "").replace(" seems to be", "") for one in shown)
    more = f"; {len(search.unnoticed) - NAMED_SLIPS} more" if len(search.unnoticed) > NAMED_SLIPS else ""
    text += f"; planted slips of the table that would pass unnoticed within the tolerances: {named}{more}"
    return Finding(check, "", "good", f"{text}.")
