"""What inference finds of one posterior, whatever its density, and how far that is to be trusted.

A fit is explored, sampled and integrated in two ways; corrected, where a finer density is at hand; then judged: by each
row left out, by the power of prior and data, by what noise and tolerances say, by what prior draws predict.
"""

from __future__ import annotations

import math
import time
import zlib
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, Self, cast

import numpy as np

from bayescal.config.classes import label_class
from bayescal.experiments.runner.losses import attempt
from bayescal.experiments.runner.results import Summary
from bayescal.experiments.shared.posterior_files import choose_draws
from bayescal.experiments.shared.search_memory import KEPT_READINGS
from bayescal.experiments.shared.soundness import ChiSquare, measure_pulls
from bayescal.files.netcdf import pack_netcdf
from bayescal.inference.bridge import BridgeEvidence, estimate_by_bridge
from bayescal.inference.chain_checks import (
    N_DRAWS,
    TailDraws,
    TailShare,
    compare_tail_mass,
    draw_tails,
    find_rare_ratio,
    widen_tails,
)
from bayescal.inference.correction import Correction, CostlyDensity, correct_draws, move_sample, sample_exactly
from bayescal.inference.diagnostics import (
    Diagnostics,
    list_check_problems,
    list_importance_problems,
    list_stand_problems,
    measure_longest_stand,
    measure_sensitivity,
)
from bayescal.inference.exploration import CORRECTABLE, FINE_ENOUGH, Exploration, integrate_posterior
from bayescal.inference.importance import WORTH_ANOTHER, ImportanceEvidence, resample
from bayescal.inference.leave_one_out import LeaveOneOut, leave_out, refit_doubtful
from bayescal.inference.other_priors import weigh_other_priors
from bayescal.inference.samplers import EvidenceCheck, SamplingTask, make_sampler
from bayescal.inference.sampling import Sample, draw_by_importance
from bayescal.inference.schema import EvidenceConfig, SamplerConfig, count_walkers
from bayescal.inference.solutions import Solutions, find_solutions
from bayescal.inference.stages import answer_first, expect, stage
from bayescal.inference.target import LogDensity, LogPosterior
from bayescal.limits import AGREEMENT, ESS_BULK_WANTED, MOVED_LIMIT, PARETO_K_LIMIT
from bayescal.numerics.geometry import Array

if TYPE_CHECKING:
    import xarray as xr

TREE = "tree"
EASY_EFFICIENCY, EASY_PARETO_K = 0.3, 0.5
"""Efficiency of importance sampling from which on, and Pareto k up to which, ensembles are short: the weights have a
variance, and most jumps of the proposal are accepted."""
NO_BRIDGE, NO_SQUARE = BridgeEvidence(math.nan, math.nan, False), ChiSquare(math.nan, math.nan)
"""Of what could not be computed."""
FIRST = 128  # draws of a first answer
TIMED = 16  # densities by which the time of a fit is estimated
SEARCHED, JUDGED = 1.8, 1.3
"""Time of a fit in that of its planned densities, search and correction among it, and in that of its rows' densities at
all draws that are kept, predictions among it: as measured."""

type Arrays = dict[str, Array]


class PosteriorProblem(ABC):
    """A posterior to be fitted, and what only its kind of measurement knows of it."""

    @property
    @abstractmethod
    def posterior(self) -> LogPosterior:
        """The posterior."""

    @abstractmethod
    def evaluate(self, posterior: LogPosterior, y: Array, seed: np.random.SeedSequence) -> Arrays:
        """Return what draws (E, S, n) in sampling coordinates say of the rows, by name.

        ``log_likelihood`` (E, S, P) of all rows, and whatever tables and files of the kind need.
        """

    @abstractmethod
    def replicate_prior(self, posterior: LogPosterior, seed: np.random.SeedSequence) -> Arrays:
        """Return draws of the prior, ``prior`` (T, n) in own units, and what they predict."""

    @abstractmethod
    def measure_misfit(self, posterior: LogPosterior, mode: Array) -> ChiSquare:
        """Return χ² of what is left of the rows at the mode (n,)."""

    @abstractmethod
    def find_costly(self, exploration: Exploration) -> CostlyDensity | None:
        """Return a density that leaves less out than the explored one; None where there is none."""

    def say_first(self, posterior: LogPosterior, y: Array) -> str:
        """Return in words what some draws (T, n) of a preliminary answer say; by default nothing."""
        del posterior, y
        return ""

    def vary_priors(self, posterior: LogPosterior) -> Mapping[float, LogPosterior]:
        """Return by factor the posterior with priors of other widths whose evidence is wanted, too; by default none."""
        del posterior
        return {}


@dataclass(frozen=True, eq=False)
class Moments:
    """Mean, standard deviation and the ends of the central 90 % of draws, in own units, (n,) each."""

    mean: Array
    sd: Array
    q05: Array
    q95: Array

    @classmethod
    def of(cls, draws: Array) -> Self:
        """Return those of draws (S, n)."""
        low, high = np.quantile(draws, (0.05, 0.95), axis=0)
        return cls(draws.mean(axis=0), draws.std(axis=0), low, high)


@dataclass(frozen=True, eq=False)
class Estimate:
    """What was found of a posterior of n coordinates."""

    y: Array  # with draws, (E, S, n): some draws of each ensemble, in sampling coordinates and in own units
    draws: Array
    log_density: Array  # (E, S): theirs, in the proposal's coordinates
    mean: Array  # with sd, q05 and q95, (n,): of all draws of the most probable solution, in own units
    sd: Array
    q05: Array
    q95: Array
    modes: Array  # (K, n): in sampling coordinates, those of the most probable solution first, the best of each first
    modes_converged: bool
    acceptance: Array  # (E,)
    diagnostics: Diagnostics
    importance: ImportanceEvidence
    explored: ImportanceEvidence  # the same before the correction
    bridge: BridgeEvidence
    # with n_steps: for how many of its steps the most patient walker stood still, harmless visits to tails left out
    longest_stand: int
    n_steps: int
    tails: TailShare | None  # what draws have of the mass where the proposal seldom leads; None of a preliminary answer
    check: EvidenceCheck | None  # where the config asks for it
    correction: Correction | None  # what led to a density that leaves less out: draws and evidences are its own
    solutions: Solutions  # which of the draws (E, S) belongs to which of M separate ones
    others: tuple[Moments, ...]  # of the draws of those but the first, as far as they are shown

    @property
    def kept(self) -> Array:
        """Some draws in sampling coordinates, chains laid end to end, shape (T, n)."""
        return self.y.reshape(-1, self.y.shape[-1])

    def kept_of(self, solution: int) -> Array:
        """Those of one solution; 0 is the most probable one."""
        return self.kept[self.solutions.label.ravel() == solution]

    @property
    def mode(self) -> Array:
        """The best mode of the most probable solution, shape (n,)."""
        return np.asarray(self.modes[0])

    def mode_of(self, solution: int) -> Array:
        """Return that of another one, or the middle of its draws where the search found no mode of its own."""
        mine = self.modes[self.solutions.of_modes == solution]
        return np.asarray(mine[0] if len(mine) else np.median(self.kept_of(solution), axis=0))

    @property
    def log_evidence(self) -> float:
        """By importance sampling, or by the bridge where the weights have too heavy a tail."""
        is_by_bridge = not (self.is_importance_trusted or self.is_preliminary)
        return self.bridge.log_evidence if is_by_bridge else self.importance.log_evidence

    @property
    def log_evidence_se(self) -> float:
        """Its standard error."""
        is_by_bridge = not (self.is_importance_trusted or self.is_preliminary)
        return self.bridge.standard_error if is_by_bridge else self.importance.standard_error

    @property
    def is_preliminary(self) -> bool:
        """Whether its draws are those of importance sampling, which no chain has checked."""
        return self.tails is None

    @property
    def is_importance_trusted(self) -> bool:
        """Whether the weights' tail is light enough."""
        return self.importance.pareto_k <= PARETO_K_LIMIT

    @property
    def gap(self) -> float:
        """How far the two log-evidences are apart."""
        return abs(self.importance.log_evidence - self.bridge.log_evidence)

    def list_problems(self) -> list[str]:
        """Return what speaks against it in words; empty where it converged."""
        problems = [] if self.modes_converged else ["the mode search did not converge"]
        if not self.is_preliminary:
            problems = self._list_chain_problems() + problems
        problems += list_importance_problems(
            self.importance.pareto_k, self.importance.efficiency * self.importance.n_draws
        )
        if self.check is not None:
            own, check = (self.log_evidence, self.log_evidence_se), self.check
            problems += list_check_problems(own, (check.log_evidence, check.standard_error), check.mixed)
        if self.correction is not None and not self.correction.is_trusted:
            share, pareto_k = 100 * self.correction.efficiency, self.correction.pareto_k
            problems.append(
                f"exact density: ESS {share:.0f} % (limit {100 * MOVED_LIMIT:.0f} %), Pareto k "
                f"{pareto_k:.2f} (limit {PARETO_K_LIMIT})"
            )
        return problems

    def _list_chain_problems(self) -> list[str]:
        problems = self.diagnostics.list_problems()
        if not self.bridge.converged:
            problems.append("bridge sampling did not converge")
        if not self.gap <= AGREEMENT:
            problems.append(f"log-evidences differ by {self.gap:.2f}, limit {AGREEMENT}")
        problems += list_stand_problems(self.longest_stand, self.n_steps)
        return problems + ([] if self.tails is None else self.tails.list_problems())

    def describe_evidence(self) -> Summary:
        """Return the evidence as columns of a table."""
        row = {
            "log_evidence": self.log_evidence,
            "log_evidence_se": self.log_evidence_se,
            "log_evidence_importance": self.importance.log_evidence,
            "log_evidence_importance_se": self.importance.standard_error,
            "log_evidence_bridge": self.bridge.log_evidence,
            "log_evidence_bridge_se": self.bridge.standard_error,
            "log_evidence_by": "importance" if self.is_importance_trusted or self.is_preliminary else "bridge",
        }
        if self.check is not None:
            row |= {
                "log_evidence_check": self.check.log_evidence,
                "log_evidence_check_se": self.check.standard_error,
            }
        return row | {"efficiency": self.importance.efficiency, "pareto_k": self.importance.pareto_k}

    def describe_chains(self) -> Summary:
        """Return how the chains went as columns of a table."""
        problems = self.list_problems()
        return {
            "rhat_max": float(self.diagnostics.rhat.max()),
            "ess_bulk_min": float(self.diagnostics.ess_bulk.min()),
            "ess_tail_min": float(self.diagnostics.ess_tail.min()),
            "converged": not problems,
            "problems": "; ".join(problems),
        }


@dataclass(frozen=True, eq=False)
class Fit(Estimate):
    """An estimate and what judges it."""

    names: tuple[str, ...]  # with units: of the n parameters
    units: tuple[str, ...]
    prior_sd: Array  # (n,)
    evaluated: Arrays  # of the rows given the draws, see `PosteriorProblem.evaluate` and `replicate_prior`
    left_out: LeaveOneOut  # each of the posterior's rows left out
    misfit: ChiSquare  # with pulls: what is left of the rows at the mode, and how far the posterior lies from nominal
    pulls: ChiSquare
    power_scaling: Array  # (n, 2): how much each parameter depends on prior and data
    widths: dict[float, ImportanceEvidence]  # by factor on the priors' widths, as far as draws of this one tell it
    wall_seconds: float

    def pack(self, tree: xr.DataTree, only_saved: tuple[str, ...]) -> Self:
        """Return it with its tree as a file's bytes instead of what nothing but that needs."""
        found = self.drop(only_saved)
        return replace(found, evaluated=found.evaluated | {TREE: np.frombuffer(pack_netcdf(tree), dtype=np.uint8)})

    def drop(self, only_saved: tuple[str, ...]) -> Self:
        """Return it without what nothing but its file needs."""
        evaluated = {name: value for name, value in self.evaluated.items() if name not in only_saved}
        return replace(self, evaluated=evaluated)


def time_fit(subject: PosteriorProblem, sampler: SamplerConfig, effort: EvidenceConfig) -> float:
    """Return about how many seconds of one core `fit_posterior` takes, within a factor of two, from some densities."""
    posterior = subject.posterior
    y = np.tile(posterior.least_squares_start(), (TIMED, 1))

    def time_call(call: Callable[[Array], Array], y: Array) -> float:
        call(y[:1])  # what is found once
        began = time.process_time()  # whatever else this machine is busy with
        call(y)
        return (time.process_time() - began) / len(y)

    with np.errstate(all="ignore"):
        density, by_row = time_call(posterior.log_density, y), time_call(posterior.pointwise, y[:1])
    walkers = count_walkers(posterior.n_parameters, sampler.walkers)
    kept = choose_draws(sampler.ensembles, walkers * sampler.plan(is_easy=True)[1], KEPT_READINGS)
    return SEARCHED * density * sum(_plan(sampler, effort).values()) + JUDGED * by_row * kept.size


def estimate_posterior(
    posterior: LogDensity, seed: int, name: str, sampler: SamplerConfig, effort: EvidenceConfig
) -> Estimate:
    """Return what inference finds of a posterior; its random numbers depend on the seed and the name alone."""
    return _estimate(posterior, seed, name, sampler, effort)[0]


def fit_posterior(
    subject: PosteriorProblem, seed: int, name: str, sampler: SamplerConfig, effort: EvidenceConfig
) -> Fit:
    """Return a posterior's fit; its random numbers depend on the seed and the name alone."""
    began = time.perf_counter()
    found, exploration = _estimate(subject.posterior, seed, name, sampler, effort, subject)
    *_, evaluate_seed, _, prior_seed, refit_seed = _spawn(seed, name)
    # the one that was explored: with a finer density where that makes a difference
    posterior = cast("LogPosterior", exploration.straight.posterior)
    evaluated = subject.evaluate(posterior, found.y, evaluate_seed)
    left_out = leave_out(found.draws, evaluated["log_likelihood"])
    # not so of a preliminary answer
    is_fit = (
        found.importance.efficiency >= WORTH_ANOTHER and not found.is_preliminary
    )  # draws that hardly count for it count less without a row
    refit = partial(refit_doubtful, left_out, posterior, exploration, sampler.walkers, refit_seed)
    scale_power = partial(_scale_power, posterior, found.draws, evaluated["log_likelihood"])
    weigh = partial(_weigh_widths, subject, exploration, found, _seed_for(seed, name, "prior widths"))
    of, prior = f"of {name!r}", partial(subject.replicate_prior, posterior, prior_seed)
    return Fit(
        **vars(found),
        names=posterior.names,
        units=posterior.units,
        prior_sd=np.array([prior.sd for prior in posterior.all_priors().values()]),
        evaluated=evaluated | attempt(f"prior draws {of}", prior, dict[str, Array]()),
        left_out=attempt(f"rows left out again {of}", refit, left_out) if is_fit else left_out,
        misfit=attempt(f"the misfit {of}", lambda: subject.measure_misfit(posterior, found.mode), NO_SQUARE),
        pulls=attempt(f"the distance from nominal {of}", lambda: measure_pulls(posterior, found.draws), NO_SQUARE),
        power_scaling=attempt(f"the power scaling {of}", scale_power, np.full((found.mean.size, 2), np.nan)),
        widths=attempt(f"other prior widths {of}", weigh, dict[float, ImportanceEvidence]()),
        wall_seconds=time.perf_counter() - began,
    )


def _spawn(seed: int, name: str) -> list[np.random.SeedSequence]:
    """Return the seeds of exploration, importance, ensembles, bridge, evaluation, correction, prior and refits."""
    return np.random.SeedSequence([seed, zlib.crc32(name.encode())]).spawn(8)


def _seed_for(seed: int, name: str, purpose: str) -> np.random.SeedSequence:
    """Return the seed of what examines a posterior from outside; its random numbers are its own."""
    return np.random.SeedSequence([seed, zlib.crc32(f"{name}-{purpose}".encode())])


def _plan(sampler: SamplerConfig, effort: EvidenceConfig) -> dict[str, int]:
    """Return how many densities stages are expected to compute."""
    effort = effort.follow(sampler.effort)
    if sampler.is_preliminary:
        return {"evidence": effort.draws}
    walks = sampler.ensembles * sampler.walkers * sum(sampler.plan(is_easy=True))
    return {"evidence": effort.draws, "tails": N_DRAWS, "sampling": walks, "bridge": effort.draws}


def _estimate(
    posterior: LogDensity,
    seed: int,
    name: str,
    sampler: SamplerConfig,
    effort: EvidenceConfig,
    subject: PosteriorProblem | None = None,
) -> tuple[Estimate, Exploration]:
    explore_seed, importance_seed, ensemble_seed, *_, correct_seed, _, _ = _spawn(seed, name)
    effort = effort.follow(sampler.effort)
    expect(_plan(sampler, effort))
    fine_enough = FINE_ENOUGH if subject is None else CORRECTABLE
    found, importance = integrate_posterior(
        posterior, explore_seed, importance_seed, sampler.walkers, effort, fine_enough
    )
    if subject is not None:
        answer_first(partial(_say_first, subject, found, importance, _seed_for(seed, name, "first")))
    if sampler.is_preliminary:
        n_proposed, n_drawn = effort.draws // 2, effort.draws // 8
        drawn = _Drawn(draw_by_importance(found, ensemble_seed, sampler.ensembles, n_proposed, n_drawn))
    else:
        found, importance, drawn = _draw_by_chains(found, importance, seed, name, sampler, effort)
    sample = drawn.sample
    costly, correction = None if subject is None else subject.find_costly(found), None
    if costly is not None:
        correction = correct_draws(costly, found, sample, correct_seed)
        if correction.is_trusted:
            sample = move_sample(sample, found, correction)
        elif not sampler.is_preliminary:
            seeds = correct_seed.spawn(sampler.ensembles)
            sample = sample_exactly(costly, found, sample, correction.move, seeds)
    moved, n = shift_evidence(importance, correction), posterior.n_parameters
    places = choose_draws(len(sample.log_density), sample.log_density[0].size, KEPT_READINGS)
    solutions = find_solutions(sample.y, found.modes, posterior.n_geometry)
    first = np.argsort(solutions.of_modes, kind="stable")
    moments, *others = (Moments.of(sample.natural[solutions.label == k]) for k in range(max(solutions.n_shown, 1)))
    estimate = Estimate(
        y=sample.y.reshape(-1, n)[places],
        draws=sample.natural.reshape(-1, n)[places],
        log_density=sample.log_density.reshape(-1)[places],
        **vars(moments),
        modes=np.stack([mode.y for mode in found.modes])[first],
        modes_converged=all(mode.converged for mode in found.modes),
        acceptance=sample.acceptance,
        diagnostics=sample.diagnostics,
        importance=moved,
        explored=importance,
        bridge=shift_evidence(drawn.bridge, correction),
        longest_stand=0 if drawn.far is None else _measure_stand(found, sample, drawn.far, moved.log_evidence),
        n_steps=sample.log_density.shape[2],
        tails=drawn.tails,
        check=None if drawn.check is None else shift_evidence(drawn.check, correction),
        correction=correction,
        solutions=replace(solutions, label=solutions.label.reshape(-1)[places], of_modes=solutions.of_modes[first]),
        others=tuple(others),
    )
    return estimate, found


def _say_first(
    subject: PosteriorProblem, found: Exploration, importance: ImportanceEvidence, seed: np.random.SeedSequence
) -> str:
    """Return a first answer in words: evidence, what some draws say, how many of the proposal's count; or nothing."""
    if importance.is_doubtful:
        return ""
    straight = found.straight
    drawn = resample(straight.log_density, found.proposal, np.random.default_rng(seed), 4 * FIRST, FIRST)
    more = subject.say_first(cast("LogPosterior", straight.posterior), straight.y_from_x(drawn.draws))
    evidence = f"log-evidence about {importance.log_evidence:.0f}"  # what the density leaves out is not known yet
    return "; ".join(filter(None, [more, evidence, f"ESS {100.0 * importance.efficiency:.0f} % (preliminary)"]))


@dataclass(frozen=True, eq=False)
class _Drawn:
    """Draws of an explored posterior, with what chains say of them where they are of chains."""

    sample: Sample
    bridge: BridgeEvidence = NO_BRIDGE
    far: TailDraws | None = None
    tails: TailShare | None = None
    check: EvidenceCheck | None = None


def _draw_by_chains(
    found: Exploration,
    importance: ImportanceEvidence,
    seed: int,
    name: str,
    sampler: SamplerConfig,
    effort: EvidenceConfig,
) -> tuple[Exploration, ImportanceEvidence, _Drawn]:
    """Return draws until the diagnostics pass, and the exploration with tails as heavy as the posterior's."""
    _, importance_seed, ensemble_seed, bridge_seed, *_ = _spawn(seed, name)
    far = draw_tails(found, _seed_for(seed, name, "tails"))
    found, importance = widen_tails(found, importance, far, importance_seed, effort)
    is_easy = min(found.efficiency, importance.efficiency) >= EASY_EFFICIENCY and importance.pareto_k <= EASY_PARETO_K
    is_enough = partial(_is_enough, found, importance, far)
    sampling = make_sampler(sampler.backend).sample(SamplingTask(found, ensemble_seed, sampler, is_easy, is_enough))
    sample, check = sampling.sample, sampling.evidence
    bridge = attempt(
        f"bridge sampling of {name!r}",
        lambda: estimate_by_bridge(
            found.straight.log_density,
            sample.straight,
            sample.log_density,
            np.random.default_rng(bridge_seed),
            effort.draws,
            found.proposal,
        ),
        NO_BRIDGE,
    )
    tails = compare_tail_mass(found, sample, far)
    if effort.cross_check is not None:
        task = SamplingTask(found, _seed_for(seed, name, "tempered"), sampler, is_easy)
        other = make_sampler(effort.cross_check, "evidence.cross_check")
        check = attempt(
            f"the evidence of {name!r} by {label_class(effort.cross_check)}", lambda: other.sample(task).evidence, None
        )
    return found, importance, _Drawn(sample, bridge, far, tails, check)


def _is_enough(found: Exploration, importance: ImportanceEvidence, far: TailDraws, sample: Sample) -> bool:
    """Whether no diagnostic asks for more steps of a sample, and means are as sure as is wanted."""
    if not sample.diagnostics.ess_bulk.min() >= ESS_BULK_WANTED:
        return False
    stand = _measure_stand(found, sample, far, importance.log_evidence)
    problems = sample.diagnostics.list_problems() + list_stand_problems(stand, sample.log_density.shape[2])
    return not problems and not compare_tail_mass(found, sample, far).list_problems()


def _measure_stand(found: Exploration, sample: Sample, far: TailDraws, log_evidence: float) -> int:
    proposed = found.proposal.log_density(sample.straight.reshape(-1, sample.straight.shape[-1]))
    ratio = sample.log_density - proposed.reshape(sample.log_density.shape) - log_evidence
    return measure_longest_stand(sample.log_density, ratio, find_rare_ratio(far, found))


def shift_evidence[T: (ImportanceEvidence, BridgeEvidence, EvidenceCheck)](
    found: T, correction: Correction | None
) -> T:
    """Return a log-evidence after the correction, its standard error that of both."""
    if correction is None:
        return found
    error = float(np.hypot(found.standard_error, correction.standard_error))
    return replace(found, log_evidence=found.log_evidence + correction.log_ratio, standard_error=error)


def _weigh_widths(
    subject: PosteriorProblem, exploration: Exploration, found: Estimate, seed: np.random.SeedSequence
) -> dict[float, ImportanceEvidence]:
    others = subject.vary_priors(cast("LogPosterior", exploration.straight.posterior))
    if not others or found.is_preliminary or found.explored.is_doubtful:
        return {}
    with stage("prior widths"):
        costly = subject.find_costly(exploration)
        return weigh_other_priors(exploration, found.explored, others, seed, costly, found.correction)


def _scale_power(posterior: LogPosterior, draws: Array, density: Array) -> Array:
    """Return how much each parameter depends on prior and data, shape (n, 2), from some draws and rows' densities."""
    chosen = choose_draws(*draws.shape[:2])
    some, density = (one.reshape(-1, one.shape[-1])[chosen] for one in (draws, density))
    priors = posterior.all_priors().values()
    log_prior = sum(prior.log_density(some[..., k]) for k, prior in enumerate(priors))
    return measure_sensitivity(some, np.asarray(log_prior), density.sum(axis=-1))
