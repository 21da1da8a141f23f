"""One variant's posterior: draws with diagnostics, evidence in two ways, what it leaves of the readings."""

from __future__ import annotations

import zlib
from dataclasses import dataclass

import numpy as np

from bayescal.density.calibration.posterior import CalibrationPosterior
from bayescal.experiments.calibration.inputs import CalibrationInputs, Variant
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
    names, units : tuple of str
        Of the n coordinates.
    natural : ndarray, shape (S, n)
        All draws, in their own units.
    kept : ndarray, shape (T, n)
        Some of them, in sampling coordinates.
    prior_sd : ndarray, shape (n,)
    diagnostics : Diagnostics
    importance : ImportanceEvidence
    bridge : BridgeEvidence
    modes_converged : bool
    mode : ndarray, shape (n,)
        In sampling coordinates.
    """

    names: tuple[str, ...]
    units: tuple[str, ...]
    natural: Array
    kept: Array
    prior_sd: Array
    diagnostics: Diagnostics
    importance: ImportanceEvidence
    bridge: BridgeEvidence
    modes_converged: bool
    mode: Array

    @property
    def is_importance_trusted(self) -> bool:
        """Whether the weights' tail is light enough."""
        return self.importance.pareto_k <= PARETO_K_LIMIT

    @property
    def log_evidence(self) -> float:
        """By importance sampling, or by the bridge where the weights have too heavy a tail."""
        return self.importance.log_evidence if self.is_importance_trusted else self.bridge.log_evidence

    @property
    def log_evidence_se(self) -> float:
        """Its standard error."""
        return self.importance.standard_error if self.is_importance_trusted else self.bridge.standard_error

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


def fit_variant(inputs: CalibrationInputs, variant: Variant) -> Fit:
    """Compute one variant; all numbers depend on the inputs, the config's seed and the variant's name alone."""
    posterior, config = variant.posterior().anchored(), inputs.config
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
    return _collect(posterior, sample, importance, bridge, converged, found.modes[0].y)


def _collect(
    posterior: CalibrationPosterior,
    sample: Sample,
    importance: ImportanceEvidence,
    bridge: BridgeEvidence,
    converged: bool,
    mode: Array,
) -> Fit:
    flat = sample.y.reshape(-1, posterior.n_parameters)
    chosen = np.linspace(0, len(flat) - 1, min(KEPT_DRAWS, len(flat))).astype(int)
    return Fit(
        posterior.names,
        posterior.units,
        sample.natural.reshape(flat.shape),
        flat[chosen],
        posterior.prior_sd,
        sample.diagnostics,
        importance,
        bridge,
        converged,
        mode,
    )
