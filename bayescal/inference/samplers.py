"""What draws a posterior: a sampler is a class by name, the package's own or another library's.

The default walks by emcee's moves. Others are handed the same posterior and give draws of independent runs, which the
same diagnostics judge; one that finds an evidence of its own checks those of importance and bridge sampling.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, ClassVar

import numpy as np
from pydantic import Field
from scipy.special import logsumexp

from bayescal.config.classes import choose, name_failures
from bayescal.config.sections import Section
from bayescal.errors import NumericalError
from bayescal.inference.exploration import Exploration
from bayescal.inference.sampling import Sample, continue_sample, sample_posterior
from bayescal.inference.schema import SamplerConfig, count_walkers
from bayescal.inference.target import LogDensity
from bayescal.inference.tempered import CHAINS, RUNS, estimate_by_tempering
from bayescal.numerics.geometry import Array

KEPT = 4000
"""Draws of a run that are kept at the most."""


@dataclass(frozen=True, eq=False)
class EvidenceCheck:
    """Log-evidence by a sampler, its standard error, and whether its runs agree."""

    log_evidence: float
    standard_error: float
    mixed: bool

    @classmethod
    def of_runs(cls, log_evidence: Sequence[float], stated: Sequence[float]) -> EvidenceCheck:
        """Return the mean over R independent runs, from each run's log-evidence and stated standard error, nats.

        The standard error is the larger of the runs' scatter and of what they state. They agree where their scatter is
        within four of the stated standard errors.
        """
        each, errors = np.asarray(log_evidence), np.asarray(stated)
        mean = float(logsumexp(each) - np.log(len(each)))
        scatter = float(np.std(np.exp(each - mean), ddof=1)) if len(each) > 1 else 0.0
        own = float(np.sqrt(np.mean(errors**2)))
        return cls(mean, max(scatter, own) / np.sqrt(len(each)), bool(scatter <= 4.0 * own))


@dataclass(frozen=True, eq=False)
class SamplingResult:
    """What a sampler found: draws, and the evidence where it finds one."""

    sample: Sample
    evidence: EvidenceCheck | None = None


@dataclass(frozen=True, eq=False)
class SamplingTask:
    """A posterior to be sampled.

    Attributes
    ----------
    exploration : Exploration
        Its modes, coordinates in which it is nearly normal, and a proposal there.
    seed : SeedSequence
    effort : SamplerConfig
        Ensembles, walkers and steps that the config asks for.
    is_easy : bool
        Whether the proposal is nearly the posterior.
    is_enough : callable
        Whether a sample is one that needs no more steps.
    """

    exploration: Exploration
    seed: np.random.SeedSequence
    effort: SamplerConfig
    is_easy: bool = True
    is_enough: Callable[[Sample], bool] = lambda sample: True

    @property
    def posterior(self) -> LogDensity:
        """The posterior in sampling coordinates y of n entries: `log_density`, `log_prior`, `draw_prior`."""
        return self.exploration.straight.posterior

    def draw_starts(self, n_draws: int, rng: np.random.Generator) -> Array:
        """Return draws of the proposal, shape (n_draws, n), in sampling coordinates."""
        return self.exploration.straight.y_from_x(self.exploration.proposal.draw(n_draws, rng))

    def collect(self, draws: Array) -> Sample:
        """Return draws (R, S, n) of R independent runs, in no order, in sampling coordinates, as diagnostics have them.

        Each run is laid out as walkers, as few as an ensemble has at the least. NumericalError where a draw has no
        density.
        """
        straight, (n_runs, n_draws, n) = self.exploration.straight, draws.shape
        n_walkers = count_walkers(n, 0)
        shape = (n_runs, n_walkers, n_draws // n_walkers)
        x = straight.x_from_y(draws[:, : n_walkers * shape[2]].reshape(-1, n))
        log_density = straight.log_density(x)
        if not np.isfinite(log_density).all():
            raise NumericalError(f"sampling: {np.sum(~np.isfinite(log_density))} draws have no density")
        return Sample(straight, x.reshape(*shape, n), log_density.reshape(shape), np.ones(n_runs))


class Sampler(ABC):
    """A way to draw a posterior.

    Attributes
    ----------
    Config : type of Section
        Its options; none by default.
    finds_evidence : bool
        Whether it finds the evidence, too, and may check the others.
    """

    Config: ClassVar[type[Section]] = Section
    finds_evidence: ClassVar[bool] = False

    def __init__(self, config: Any) -> None:
        self.config = config

    @classmethod
    def check_installed(cls) -> None:
        """Raise InputError where the sampler's library is not installed; by default it needs none."""
        return

    @abstractmethod
    def sample(self, task: SamplingTask) -> SamplingResult:
        """Return draws of a posterior, with its evidence where the sampler finds one; NumericalError where it fails."""


def make_sampler(name: str, field: str = "sampler.backend") -> Sampler:
    """Return the sampler that a config names in a field; InputError where there is none."""
    chosen = choose("SAMPLERS", name, Sampler, field, Path())  # type: ignore[type-abstract]  # only subclasses are found
    with name_failures(chosen.found, field):
        return chosen.found(chosen.options)


# --- the package's own -----------------------------------------------------------------------------------------------


class EmceeSampler(Sampler):
    """Ensembles that mix jumps of the proposal with emcee's differential evolution; each ensemble is a chain."""

    def sample(self, task: SamplingTask) -> SamplingResult:
        """Return as many steps as are stated; where none are, as many as the diagnostics ask for."""
        effort, found = task.effort, task.exploration
        sample = sample_posterior(found, task.seed, effort.ensembles, effort.walkers, *effort.plan(task.is_easy))
        while effort.steps is None and 2 * sample.log_density.shape[2] <= effort.most_steps:
            if task.is_enough(sample):
                break
            sample = continue_sample(found, sample, task.seed)  # which spawns other seeds each time
        return SamplingResult(sample)


class TemperingConfig(Section):
    """Effort of sequential Monte Carlo."""

    runs: Annotated[int, Field(ge=4, le=64)] = RUNS
    """Independent runs, each of which is a chain."""
    chains: Annotated[int, Field(ge=64, le=65_536)] = CHAINS
    """Chains of a run at each temperature."""


class TemperingSampler(Sampler):
    """Sequential Monte Carlo from the prior to the posterior, which owes nothing to the search for modes."""

    Config = TemperingConfig
    finds_evidence = True

    def sample(self, task: SamplingTask) -> SamplingResult:
        """Return draws of independent runs, and their evidence."""
        found = estimate_by_tempering(task.posterior, task.seed, self.config.chains, self.config.runs)
        runs = np.split(found.y, np.cumsum(found.n_draws)[:-1])
        kept = min(KEPT, *found.n_draws)
        rng = np.random.default_rng(task.seed.spawn(1)[0])
        draws = np.stack([run[rng.permutation(len(run))[:kept]] for run in runs])
        return SamplingResult(task.collect(draws), EvidenceCheck(found.log_evidence, found.standard_error, found.mixed))
