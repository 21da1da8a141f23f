"""One variant's posterior: draws with diagnostics, evidence in two ways, and how well it explains the readings."""

from __future__ import annotations

import zlib
from dataclasses import dataclass

import numpy as np

from bayescal.density.prediction import compute_elpd
from bayescal.density.readings.posterior import SelfCalibrationPosterior
from bayescal.experiments.self_calibration.inputs import ReadingInputs, Variant
from bayescal.inference.bridge import BridgeEvidence, estimate_by_bridge
from bayescal.inference.diagnostics import Diagnostics
from bayescal.inference.exploration import explore
from bayescal.inference.importance import ImportanceEvidence, estimate_by_importance
from bayescal.inference.sampling import Sample, sample_posterior
from bayescal.limits import AGREEMENT, PARETO_K_LIMIT
from bayescal.numerics.geometry import Array

KEPT_DRAWS = 1000


@dataclass(frozen=True, eq=False)
class Fit:
    """What inference found for one variant.

    Attributes
    ----------
    names : tuple of str
        Of the n coordinates: free parameters, or symbols of those that deviate alike.
    natural : ndarray, shape (S, n)
        All draws, mm and rad.
    theta : ndarray, shape (T, D)
        Some of them, as machines.
    prior_sd : ndarray, shape (n,)
    diagnostics : Diagnostics
    importance : ImportanceEvidence
    bridge : BridgeEvidence
    modes_converged : bool
    elpd : float
        Of the readings kept for verification; NaN without any.
    square : ndarray, shape (P,)
        What the mode leaves of each calibration pose's readings, squared, in units of the noise.
    """

    names: tuple[str, ...]
    natural: Array
    theta: Array
    prior_sd: Array
    diagnostics: Diagnostics
    importance: ImportanceEvidence
    bridge: BridgeEvidence
    modes_converged: bool
    elpd: float
    square: Array

    @property
    def log_evidence(self) -> float:
        """By importance sampling, or by the bridge where the weights have too heavy a tail."""
        return self.importance.log_evidence if self.is_importance_trusted else self.bridge.log_evidence

    @property
    def log_evidence_se(self) -> float:
        """Its standard error."""
        return self.importance.standard_error if self.is_importance_trusted else self.bridge.standard_error

    @property
    def is_importance_trusted(self) -> bool:
        """Whether the weights' tail is light enough."""
        return self.importance.pareto_k <= PARETO_K_LIMIT

    def list_problems(self) -> list[str]:
        """Return what speaks against it in words; empty where it converged."""
        problems = self.diagnostics.list_problems()
        if not self.modes_converged:
            problems.append("the mode search did not converge")
        if not self.bridge.converged:
            problems.append("bridge sampling did not converge")
        gap = abs(self.importance.log_evidence - self.bridge.log_evidence)
        if not gap <= AGREEMENT:
            problems.append(f"the two log-evidences differ by {gap:.2f}, limit {AGREEMENT}")
        return problems


def fit_variant(inputs: ReadingInputs, variant: Variant) -> Fit:
    """Compute one variant; all numbers depend on the inputs, the config's seed and the variant's name alone."""
    posterior, config = inputs.posterior(variant), inputs.config
    seed = np.random.SeedSequence([config.seed, zlib.crc32(variant.name.encode())])
    explore_seed, importance_seed, ensemble_seed, bridge_seed = seed.spawn(4)
    found = explore(posterior, explore_seed, config.sampler.walkers)
    density, effort, sampler = found.straight.log_density, config.evidence, config.sampler
    importance = estimate_by_importance(
        density,
        found.proposal,
        np.random.default_rng(importance_seed),
        effort.draws,
        effort.target_error,
        effort.max_draws,
    )
    sample = sample_posterior(found, ensemble_seed, sampler.ensembles, sampler.walkers, sampler.burn_in, sampler.steps)
    bridge = estimate_by_bridge(
        density,
        sample.straight,
        sample.log_density,
        np.random.default_rng(bridge_seed),
        effort.draws,
        found.proposal,
    )
    converged = all(mode.converged for mode in found.modes)
    return _summarise(inputs, variant, posterior, sample, (importance, bridge), converged, found.modes[0].y)


def _summarise(
    inputs: ReadingInputs,
    variant: Variant,
    posterior: SelfCalibrationPosterior,
    sample: Sample,
    evidence: tuple[ImportanceEvidence, BridgeEvidence],
    converged: bool,
    mode: Array,
) -> Fit:
    n = posterior.n_parameters
    flat = sample.y.reshape(-1, n)
    chosen = np.linspace(0, len(flat) - 1, min(KEPT_DRAWS, len(flat))).astype(int)
    theta, elpd = posterior.theta(flat[chosen]), float("nan")
    if inputs.table.verification.any():
        elpd = compute_elpd(inputs.likelihood(variant, verification=True).pointwise(theta))
    _, error = posterior.likelihood.find_poses(posterior.theta(mode[None]))
    return Fit(
        posterior.names,
        sample.natural.reshape(-1, n),
        theta,
        posterior.scale,
        sample.diagnostics,
        *evidence,
        converged,
        elpd,
        np.einsum("pk,pk->p", error[0], error[0]),
    )
