"""Computing a check: what the data say, then simulated data sets in tasks."""

from __future__ import annotations

import time
import zlib
from dataclasses import dataclass
from functools import cache

import numpy as np
import pandas as pd
from scipy.stats import binom, norm, t

from bayescal.errors import NumericalError
from bayescal.experiments.runner.parallel import Run
from bayescal.experiments.runner.results import Results
from bayescal.experiments.selftest.faults import Finding, look_at_data
from bayescal.experiments.selftest.inputs import SelftestInputs, TestedVariant, draw_posterior
from bayescal.experiments.selftest.rows import DataSetTimeRow, RankBandRow, RankRow, RecoveryRow, SelftestCheckRow
from bayescal.inference.exploration import explore
from bayescal.inference.importance import estimate_by_importance
from bayescal.limits import COVERAGE, FEWEST_SETS
from bayescal.numerics.geometry import Array
from bayescal.report.numbers import name_some

DRAWS = 2000  # for the evidence by which the best variant is found
PRIOR, POSTERIOR = "prior", "posterior"
POINTS = 40
SIMULATED = 20_000
FALSE_ALARMS = 0.01  # of all parameters together
OFF = 3.5  # standard errors of a coverage, where many data sets tell these; more of fewer, as of Student's t
OFF_SHARE = 0.02

type Arrays = dict[str, Array]
type Shared = tuple[TestedVariant, Array, Array, int, int]
"""Subject, draws of its posterior (S, n), natural and in coordinates, draws to be made of each data set's, seed."""


def compute_selftest(inputs: SelftestInputs, run: Run) -> Results:
    """Return what is found of the variants that are checked."""
    tables: dict[str, list[pd.DataFrame]] = {"checks": [], "parameters": [], "ranks": [], "bands": [], "timings": []}
    variants = {}
    for name in _choose(inputs, run):
        findings, own = _check_variant(inputs, name, run)
        passed = not any(one.level == "bad" for one in findings)
        variants[name] = {"passed": passed, "faults": [one.fault for one in findings if one.fault]}
        own["checks"] = SelftestCheckRow.collect(
            SelftestCheckRow(
                variant=name,
                subject=one.check,
                fault=one.fault,
                level=one.level,
                value=one.value,
                limit=one.limit,
                text=one.text,
                action=one.action,
            )
            for one in findings
        )
        for key, table in own.items():
            tables[key].append(table)
    summary = {
        "name": inputs.config.name,
        "title": inputs.config.title,
        "study": inputs.config.study,
        "data_origin": inputs.origin,
        "data_sets": inputs.config.data_sets,
        "passed": all(one["passed"] for one in variants.values()),
        "variants": variants,
    }
    return Results(summary, {key: pd.concat(parts, ignore_index=True) for key, parts in tables.items() if parts})


# --- which variant -----------------------------------------------------------------------------------------------


def _choose(inputs: SelftestInputs, run: Run) -> list[str]:
    """Return the variants that the config names; the best by evidence where it names none."""
    names = list(inputs.subjects)
    if inputs.config.variants or len(names) == 1:
        return names
    found = run.map("variants", _weigh, inputs, {name: name for name in names})
    return [max(names, key=lambda name: float(found[name]["log_evidence"]))]


def _weigh(inputs: SelftestInputs, name: str) -> Arrays:
    """Return the log-evidence of a variant, near enough to tell the best; minus infinity where none is found."""
    explore_seed, draw_seed = np.random.SeedSequence([inputs.config.seed, 2]).spawn(2)
    try:
        found = explore(inputs.subjects[name].posterior, explore_seed, max_pilots=0)
        straight, rng = found.straight, np.random.default_rng(draw_seed)
        value = estimate_by_importance(straight.log_density, found.proposal, rng, DRAWS).log_evidence
    except NumericalError:
        value = -np.inf
    return {"log_evidence": np.array(value)}


# --- one variant -------------------------------------------------------------------------------------------------


def _check_variant(inputs: SelftestInputs, name: str, run: Run) -> tuple[list[Finding], dict[str, pd.DataFrame]]:
    config, subject = inputs.config, inputs.subjects[name]
    task = (subject, config.draws, config.seed)
    findings, draws, coordinates = run.once(f"data of {name}", look_at_data, task, (Finding,))
    if not len(draws):
        return findings, {}
    tasks = {f"{whence} {k}": f"{whence} {k}" for k in range(config.data_sets) for whence in (PRIOR, POSTERIOR)}
    shared = (subject, np.asarray(draws), np.asarray(coordinates), config.draws, config.seed)
    found = run.map(f"simulated {name}", rank_truth, shared, tasks)
    own = [_judge(name, subject, whence, found, config.data_sets) for whence in (PRIOR, POSTERIOR)]
    tables = {key: pd.concat([one[key] for _, one in own], ignore_index=True) for key in own[0][1]}
    seconds = [float(one["wall_seconds"]) for one in found.values()]
    tables["timings"] = DataSetTimeRow.tabulate(variant=name, data_set=list(found), wall_seconds=seconds)
    return [*findings, *(finding for finding, _ in own)], tables


def _judge(
    variant: str, subject: TestedVariant, whence: str, found: dict[str, Arrays], n: int
) -> tuple[Finding, dict[str, pd.DataFrame]]:
    """Return what the data sets from the priors, or from the posterior, say, and their tables."""
    names = subject.posterior.names
    good = {key: one for key, one in found.items() if key.startswith(f"{whence} ") and "rank" in one}
    rank, z, quality = (
        np.stack([one[key] for one in good.values()]) if good else np.empty((0, width))
        for key, width in (("rank", len(names)), ("z", len(names)), ("quality", 2))
    )
    finding = judge_ranks(whence, names, rank, z, quality, n)
    if not good:
        return finding, {"parameters": pd.DataFrame(), "ranks": pd.DataFrame(), "bands": pd.DataFrame()}
    band = find_band(len(rank), FALSE_ALARMS / len(names))
    uneven = find_uneven(names, rank)
    return finding, {
        "parameters": RecoveryRow.tabulate(
            variant=variant,
            simulated_from=whence,
            parameter=names,
            is_uniform=[name not in uneven for name in names],
            coverage_90=_find_held(rank).mean(axis=0),
            rms_z=np.sqrt(np.mean(z**2, axis=0)),
        ),
        "ranks": RankRow.tabulate(dict(zip(names, rank.T, strict=True)), variant=variant, data_set=list(good)),
        "bands": RankBandRow.tabulate(
            variant=variant, simulated_from=whence, rank=band.at, low=band.low, high=band.high
        ),
    }


def rank_truth(shared: Shared, name: str) -> Arrays:
    """Return the ranks of a data set's truth, shape (n,), in shares; its name says whence and which.

    Of truths drawn from the priors (Talts et al. 2018) the rank is uniform if everything between priors and intervals
    is right. Of truths drawn from the posterior of the measured data, with measured and simulated data fitted together
    (Säilynoja et al. 2025), it is uniform where it matters: near the machine that was measured. Without ranks where no
    posterior is found.
    """
    began = time.perf_counter()
    try:
        found = _rank(shared, name)
    except (NumericalError, np.linalg.LinAlgError):
        found = {}
    return {**found, "wall_seconds": np.array(time.perf_counter() - began)}


def _rank(shared: Shared, name: str) -> Arrays:
    subject, draws, coordinates, n_draws, seed = shared
    whence, _, number = name.partition(" ")
    simulate_seed, draw_seed, tie_seed = np.random.SeedSequence([seed, zlib.crc32(name.encode())]).spawn(3)
    rng = np.random.default_rng(simulate_seed)
    if whence == PRIOR:
        truth, posterior = subject.draw_case(rng)
    else:
        k = int(number) % len(draws)
        truth, posterior = draws[k], subject.repeat(coordinates[k], rng)
    found, _, _, quality = draw_posterior(posterior, n_draws, draw_seed)
    among = np.random.default_rng(tie_seed).random(len(truth))  # of equal draws, as sizes that are zero have them
    below, equal = np.sum(found < truth, axis=0), np.sum(found == truth, axis=0)
    return {
        "rank": (below + among * (equal + 1.0)) / (len(found) + 1.0),
        "z": (found.mean(axis=0) - truth) / found.std(axis=0),
        "quality": quality,
    }


@dataclass(frozen=True, eq=False)
class UniformBand:
    """Limits of the distribution function of n uniform numbers, (K,) each."""

    at: Array
    low: Array
    high: Array

    def holds(self, ranks: Array) -> bool:
        """Whether the distribution of ranks (n,) lies within everywhere."""
        share = distribute(ranks, self.at)
        return bool(np.all((share >= self.low - 1e-12) & (share <= self.high + 1e-12)))


def distribute(ranks: Array, at: Array) -> Array:
    """Return the share of ranks (n,) at or below each point (K,)."""
    return np.asarray(np.searchsorted(np.sort(ranks), at, side="right") / len(ranks))


@cache
def find_band(n: int, false_alarms: float) -> UniformBand:
    """Return the band that n uniform numbers leave with a probability of ``false_alarms``, all of it at once.

    By simulation after Säilynoja, Bürkner and Vehtari (2022): the pointwise level is the one at which so many sets of
    uniform numbers as asked for stay within the pointwise binomial limits at every point.
    """
    at = np.arange(1, POINTS) / POINTS
    rng = np.random.default_rng(0)
    cells = rng.multinomial(n, np.full(POINTS, 1.0 / POINTS), SIMULATED)
    counts = np.cumsum(cells, axis=1)[:, :-1]
    tails = np.minimum(binom.cdf(counts, n, at), binom.sf(counts - 1, n, at))
    level = float(np.quantile(2.0 * tails.min(axis=1), false_alarms))
    return UniformBand(at, binom.ppf(level / 2.0, n, at) / n, binom.isf(level / 2.0, n, at) / n)


def judge_ranks(whence: str, names: tuple[str, ...], rank: Array, z: Array, quality: Array, n: int) -> Finding:
    """Return whether ranks (D, n) in shares of D out of so many data sets are uniform; z and quality likewise."""
    check = f"Simulated from the {whence}"
    if len(rank) < n / 2:
        text = f"{len(rank)} of {n} data sets have a posterior."
        return Finding(check, "calibration", "bad", text, value=len(rank), limit=n / 2)
    held, error = measure_coverage(rank)
    rms = float(np.sqrt(np.mean(z**2)))
    said = f"coverage of 90 % intervals {100 * held:.1f} ± {100 * error:.1f} %, error {rms:.2f} sd"
    said += f" ({len(rank)} of {n} data sets)" if len(rank) < n else f" ({n} data sets)"
    if len(rank) < FEWEST_SETS:
        action = f"Use at least {FEWEST_SETS} (--data-sets)."
        return Finding(check, "", "warning", f"{said}: too few.", action, held, COVERAGE)
    uneven = find_uneven(names, rank)
    chance = np.sqrt(COVERAGE * (1.0 - COVERAGE) / rank.size)  # few data sets may all be held
    limit = float(t.isf(norm.sf(OFF), len(rank) - 1))
    off = abs(held - COVERAGE) > max(limit * max(error, chance), OFF_SHARE)
    if not off and not uneven:
        return Finding(check, "", "good", f"all ranks are uniform; {said}.", "", held, COVERAGE)
    how = ("too narrow" if held < COVERAGE else "too wide") if off else "biased"
    which = f", ranks of {name_some(uneven)} not uniform" if uneven else ""
    return Finding(check, "calibration", "bad", f"intervals {how}{which}; {said}.", "", held, COVERAGE)


def find_uneven(names: tuple[str, ...], rank: Array) -> list[str]:
    """Return the parameters whose ranks, columns of (D, n), leave the band of uniform ones."""
    band = find_band(len(rank), FALSE_ALARMS / len(names))
    return [name for k, name in enumerate(names) if not band.holds(rank[:, k])]


def measure_coverage(rank: Array) -> tuple[float, float]:
    """Return the share of ranks (D, n) within the middle 90 %, and its standard error over data sets."""
    held = _find_held(rank).mean(axis=1)
    return float(held.mean()), float(held.std(ddof=1) / np.sqrt(len(held)))


def _find_held(rank: Array) -> np.ndarray:
    tail = 0.5 * (1.0 - COVERAGE)
    return np.asarray((rank > tail) & (rank < 1.0 - tail))
