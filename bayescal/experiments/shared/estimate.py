"""What inference finds of one posterior, whatever its density: draws with diagnostics, evidence in two ways."""

from __future__ import annotations

import zlib
from dataclasses import dataclass
from typing import Any

import numpy as np

from bayescal.inference.bridge import BridgeEvidence, estimate_by_bridge
from bayescal.inference.diagnostics import (
    Diagnostics,
    list_check_problems,
    list_importance_problems,
    list_scout_problems,
    list_stand_problems,
    list_tail_problems,
    measure_longest_stand,
)
from bayescal.inference.importance import ImportanceEvidence
from bayescal.inference.integration import Effort, integrate_posterior, widen_tails
from bayescal.inference.overdispersed import N_DRAWS, draw_far_out
from bayescal.inference.sampling import sample_posterior
from bayescal.inference.schema import EvidenceConfig, SamplerConfig
from bayescal.inference.scouts import Scouts, send_scouts
from bayescal.inference.stages import expect
from bayescal.inference.tails import Tails, compare_tails
from bayescal.inference.target import Target
from bayescal.inference.tempered import TemperedEvidence, estimate_by_tempering
from bayescal.limits import AGREEMENT, PARETO_K_LIMIT
from bayescal.numerics.geometry import Array

KEPT_DRAWS = 1000


@dataclass(frozen=True, eq=False)
class Estimate:
    """What was found of a posterior of n coordinates.

    Attributes
    ----------
    natural : ndarray, shape (S, n)
        All draws, in their own units.
    kept : ndarray, shape (T, n)
        Some of them, in sampling coordinates.
    mode : ndarray, shape (n,)
        The best mode, in sampling coordinates.
    diagnostics : Diagnostics
    importance : ImportanceEvidence
    bridge : BridgeEvidence
    modes_converged : bool
    longest_stand, n_steps : int
        For how many of its steps the most patient walker stood still.
    scouts : Scouts
        Where walkers that started far out ended.
    tails : Tails
        What the draws have of the mass where the proposal seldom leads.
    check : TemperedEvidence or None
        Where the config asks for it.
    """

    natural: Array
    kept: Array
    mode: Array
    diagnostics: Diagnostics
    importance: ImportanceEvidence
    bridge: BridgeEvidence
    modes_converged: bool
    longest_stand: int
    n_steps: int
    scouts: Scouts
    tails: Tails
    check: TemperedEvidence | None

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
        problems += list_importance_problems(
            self.importance.pareto_k, self.importance.efficiency * self.importance.n_draws
        )
        problems += list_stand_problems(self.longest_stand, self.n_steps)
        problems += list_scout_problems(**vars(self.scouts))
        problems += list_tail_problems(**vars(self.tails))
        if self.check is not None:
            own, check = (self.log_evidence, self.log_evidence_se), self.check
            problems += list_check_problems(own, (check.log_evidence, check.standard_error), check.mixed)
        return problems

    def describe_evidence(self) -> dict[str, Any]:
        """Return the evidence as columns of a table."""
        return {
            "log_evidence": self.log_evidence,
            "log_evidence_se": self.log_evidence_se,
            "log_evidence_importance": self.importance.log_evidence,
            "log_evidence_bridge": self.bridge.log_evidence,
            **({} if self.check is None else {"log_evidence_tempered": self.check.log_evidence}),
            "efficiency": self.importance.efficiency,
            "pareto_k": self.importance.pareto_k,
        }

    def describe_chains(self) -> dict[str, Any]:
        """Return how the chains went as columns of a table."""
        problems = self.list_problems()
        return {
            "rhat_max": float(self.diagnostics.rhat.max()),
            "ess_bulk_min": float(self.diagnostics.ess_bulk.min()),
            "ess_tail_min": float(self.diagnostics.ess_tail.min()),
            "converged": not problems,
            "problems": "; ".join(problems),
        }


def estimate_posterior(
    posterior: Target, seed: int, name: str, sampler: SamplerConfig, effort: EvidenceConfig
) -> Estimate:
    """Return what inference finds of a posterior; its random numbers depend on the seed and the name alone."""
    explore_seed, importance_seed, ensemble_seed, bridge_seed = np.random.SeedSequence(
        [seed, zlib.crc32(name.encode())]
    ).spawn(4)
    price = Effort(effort.draws, effort.target_error, effort.max_draws)
    walks = sampler.ensembles * sampler.walkers * (sampler.burn_in + sampler.steps)
    expect({"evidence": effort.draws, "tails": N_DRAWS, "sampling": walks, "bridge": effort.draws})
    found, importance = integrate_posterior(posterior, explore_seed, importance_seed, sampler.walkers, price)
    far = draw_far_out(found, np.random.SeedSequence([seed, zlib.crc32(f"{name}-tails".encode())]))
    found, importance = widen_tails(found, importance, far, importance_seed, price)
    density = found.straight.log_density
    sample = sample_posterior(found, ensemble_seed, sampler.ensembles, sampler.walkers, sampler.burn_in, sampler.steps)
    bridge = estimate_by_bridge(
        density,
        sample.straight,
        sample.log_density,
        np.random.default_rng(bridge_seed),
        effort.draws,
        found.proposal,
    )
    flat = sample.y.reshape(-1, posterior.n_parameters)
    chosen = np.linspace(0, len(flat) - 1, min(KEPT_DRAWS, len(flat))).astype(int)
    return Estimate(
        sample.natural.reshape(flat.shape),
        flat[chosen],
        found.modes[0].y,
        sample.diagnostics,
        importance,
        bridge,
        all(mode.converged for mode in found.modes),
        measure_longest_stand(sample.log_density),
        sampler.steps,
        send_scouts(found, sample, far, np.random.SeedSequence([seed, zlib.crc32(f"{name}-scouts".encode())])),
        compare_tails(found, sample, far),
        _check(posterior, seed, name, effort),
    )


def _check(posterior: Target, seed: int, name: str, effort: EvidenceConfig) -> TemperedEvidence | None:
    """Return the evidence by tempering where it is asked for."""
    if effort.check is None:
        return None
    return estimate_by_tempering(posterior, np.random.SeedSequence([seed, zlib.crc32(f"{name}-tempered".encode())]))
