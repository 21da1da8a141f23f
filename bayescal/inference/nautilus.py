"""Importance nested sampling by the library nautilus (Lange 2023): draws and evidence that owe this package nothing.

It starts from the prior alone, and knows neither modes nor proposals that were found here.
"""

from __future__ import annotations

from importlib.util import find_spec
from typing import Annotated, Any

import numpy as np
from pydantic import Field
from scipy.special import ndtri
from scipy.stats import norm

from bayescal.config.sections import Section
from bayescal.errors import InputError, NumericalError
from bayescal.inference.importance import evaluate_in_batches
from bayescal.inference.samplers import KEPT, EvidenceCheck, Sampler, SamplingResult, SamplingTask
from bayescal.numerics.geometry import Array

PRIOR_DRAWS = 4096
WIDER = 1.2
"""How much wider the reference is than the prior, whose tails it has to cover."""
NO_DENSITY = -1e100


class NautilusConfig(Section):
    """Options of nautilus."""

    runs: Annotated[int, Field(ge=4, le=64)] = 4
    """Independent runs, each of which is a chain."""
    live_points: Annotated[int, Field(ge=100, le=100_000)] = 1000
    """Live points of a run."""
    networks: Annotated[int, Field(ge=0, le=16)] = 4
    """Neural networks that learn each bound; 0 for ellipsoids alone."""
    effective_draws: Annotated[int, Field(ge=500, le=1_000_000)] = 4000
    """Effective number of draws at which a run ends."""


class NautilusSampler(Sampler):
    """Importance nested sampling from the prior by the library nautilus, an outside check of the evidence."""

    Config = NautilusConfig
    finds_evidence = True

    @classmethod
    def check_installed(cls) -> None:
        """Raise InputError where nautilus is not installed."""
        if find_spec("nautilus") is None:
            raise InputError("nautilus: not installed: pip install 'bayescal[nautilus]'")

    def sample(self, task: SamplingTask) -> SamplingResult:
        """Return draws of independent runs, and their evidence.

        The evidence is ∫ p(y) dy = ∫ [p(y) / r(y)] r(y) dy of the posterior's density p over a normal reference r, a
        little wider than the prior, from which nested sampling starts.
        """
        posterior, (prior_seed, *seeds) = task.posterior, task.seed.spawn(1 + self.config.runs)
        draws = posterior.draw_prior(PRIOR_DRAWS, np.random.default_rng(prior_seed))
        draws = draws[np.isfinite(draws).all(axis=1)]
        if len(draws) < 2:
            raise NumericalError("nautilus: too few prior draws have coordinates")
        centre, sd = draws.mean(axis=0), WIDER * draws.std(axis=0)

        def transform(unit: Array) -> Array:
            return np.asarray(centre + sd * ndtri(unit))

        def weigh(y: Array) -> Array:
            reference = norm.logpdf(y, centre, sd).sum(axis=-1)
            density = evaluate_in_batches(posterior.log_density, np.atleast_2d(y)) - reference
            return np.where(np.isfinite(density), density, NO_DENSITY)

        runs = [self._run(transform, weigh, posterior.n_parameters, seed) for seed in seeds]
        evidence = EvidenceCheck.of_runs([one.log_z for one in runs], [1.0 / np.sqrt(one.n_eff) for one in runs])
        rngs = [np.random.default_rng(seed.spawn(1)[0]) for seed in seeds]
        draws = np.stack([_resample(*pair) for pair in zip(runs, rngs, strict=True)])
        return SamplingResult(task.collect(draws), evidence)

    def _run(self, transform: Any, weigh: Any, n: int, seed: np.random.SeedSequence) -> Any:
        from nautilus import Sampler as NestedSampler  # an extra

        effort = self.config
        run = NestedSampler(
            *(transform, weigh),
            **{"n_dim": n, "n_live": effort.live_points, "n_networks": effort.networks},
            **{"vectorized": True, "pass_dict": False, "seed": int(seed.generate_state(1)[0])},
        )
        run.run(n_eff=effort.effective_draws, verbose=False)
        return run


def _resample(run: Any, rng: np.random.Generator) -> Array:
    """Return draws of a run of equal weights, shape (S, n), in no order."""
    points, log_weights, _ = run.posterior()
    chosen = rng.choice(len(points), KEPT, p=np.exp(log_weights - np.logaddexp.reduce(log_weights)))
    return np.asarray(points[chosen])
