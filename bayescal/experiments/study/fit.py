"""One variant's posterior from config to numbers: the unit of work that runs, is kept and is resumed as a whole."""

from __future__ import annotations

import time
import zlib
from dataclasses import dataclass, fields

import numpy as np

from bayescal.density.likelihood import Likelihood
from bayescal.density.posterior import Posterior
from bayescal.density.prediction import Prediction, predict
from bayescal.density.structured_posterior import StructuredPosterior
from bayescal.experiments.study.inputs import StudyInputs
from bayescal.experiments.study.schema import StudyConfig, stem_of
from bayescal.experiments.study.structured import evaluate_structured
from bayescal.inference.bridge import estimate_by_bridge
from bayescal.inference.exploration import Exploration, count_walkers, explore
from bayescal.inference.importance import ImportanceEvidence, estimate_by_importance
from bayescal.inference.sampling import sample_posterior
from bayescal.numerics.geometry import Array

KEPT_DRAWS = 1920  # of each ensemble, for everything after the diagnostics
PREDICTIVE_DRAWS = 2000

type Arrays = dict[str, Array]


@dataclass(frozen=True)
class Task:
    """A unit of work: a posterior of a variant, or only its evidence with priors wider or narrower by a factor."""

    variant: str
    with_model_error: bool
    factor: float = 1.0

    @property
    def key(self) -> str:
        """A name that is also a file name."""
        setting = "free" if self.with_model_error else "zero"
        end = "" if self.is_fit else f"-factor-{self.factor!r}"
        return f"{stem_of(self.variant)}-tau-{setting}{end}"

    @property
    def is_fit(self) -> bool:
        """Whether the priors are the study's own, so that there is a posterior to be sampled."""
        return self.factor == 1.0


def list_tasks(inputs: StudyInputs) -> list[Task]:
    """Return all tasks of a study, the long ones first."""
    names = [variant.name for variant in inputs.config.variants]
    fits = [Task(name, with_model_error) for with_model_error in (True, False) for name in names]
    return fits + [task for task in list_sensitivity(inputs).values() if not task.is_fit]


def list_sensitivity(inputs: StudyInputs) -> dict[tuple[float, str], Task]:
    """Return the task that has the evidence of each factor on the priors and variant: at one the fit itself."""
    factors, variants = inputs.config.sensitivity.factor, inputs.config.variants
    return {(factor, v.name): Task(v.name, True, factor) for factor in factors for v in variants}


def run_task(inputs: StudyInputs, task: Task) -> Arrays:
    """Compute one task; all numbers depend on the inputs, the config's seed and the task's key alone."""
    began = time.perf_counter()
    variant = inputs.variant(task.variant)
    posterior = inputs.posterior(variant, task.with_model_error, task.factor)
    seed = np.random.SeedSequence([inputs.config.seed, zlib.crc32(task.key.encode())])
    explore_seed, importance_seed, ensemble_seed, bridge_seed, predict_seed = seed.spawn(5)
    exploration = explore(posterior, explore_seed, inputs.config.sampler.walkers)
    importance = _importance(inputs.config, exploration, importance_seed)
    arrays = {
        "importance": np.array([importance.log_evidence, importance.standard_error]),
        "importance_quality": np.array([importance.efficiency, importance.pareto_k, importance.n_draws]),
        "modes_converged": np.array(all(mode.converged for mode in exploration.modes), dtype=float),
    }
    if task.is_fit:
        arrays |= _sample(inputs, task, posterior, exploration, ensemble_seed, bridge_seed, predict_seed)
    arrays["wall_seconds"] = np.array(time.perf_counter() - began)
    return arrays


def _importance(config: StudyConfig, exploration: Exploration, seed: np.random.SeedSequence) -> ImportanceEvidence:
    effort = config.evidence
    return estimate_by_importance(
        exploration.straight.log_density,
        exploration.proposal,
        np.random.default_rng(seed),
        effort.draws,
        effort.target_error,
        effort.max_draws,
    )


def _sample(
    inputs: StudyInputs,
    task: Task,
    posterior: Posterior,
    exploration: Exploration,
    ensemble_seed: np.random.SeedSequence,
    bridge_seed: np.random.SeedSequence,
    predict_seed: np.random.SeedSequence,
) -> Arrays:
    sampler, straight = inputs.config.sampler, exploration.straight
    walkers = count_walkers(posterior.n_parameters, sampler.walkers)
    sample = sample_posterior(
        exploration, ensemble_seed, sampler.ensembles, sampler.walkers, sampler.burn_in, sampler.steps
    )
    y, natural, density, diagnostics = sample.y, sample.natural, sample.log_density, sample.diagnostics
    bridge = estimate_by_bridge(
        straight.log_density,
        sample.straight,
        density,
        np.random.default_rng(bridge_seed),
        inputs.config.evidence.draws,
        exploration.proposal,
    )
    # thin in time, the same steps of every walker, and keep the order walker by walker
    keep = max(1, -(-sampler.steps * walkers // KEPT_DRAWS))
    kept = y[:, :, ::keep].reshape(sampler.ensembles, -1, posterior.n_parameters)
    return {
        "bridge": np.array([bridge.log_evidence, bridge.standard_error]),
        "bridge_converged": np.array(bridge.converged, dtype=float),
        "acceptance": sample.acceptance,
        "mean": natural.mean(axis=(0, 1, 2)),
        "sd": natural.std(axis=(0, 1, 2)),
        "q05": np.quantile(natural, 0.05, axis=(0, 1, 2)),
        "q95": np.quantile(natural, 0.95, axis=(0, 1, 2)),
        "rhat": diagnostics.rhat,
        "ess_bulk": diagnostics.ess_bulk,
        "ess_tail": diagnostics.ess_tail,
        "draws": posterior.natural(kept),
        "log_density": density[:, :, ::keep].reshape(sampler.ensembles, -1),
        **_evaluate(inputs, task, posterior, kept, predict_seed),
    }


def _evaluate(
    inputs: StudyInputs, task: Task, posterior: Posterior, kept: Array, seed: np.random.SeedSequence
) -> Arrays:
    """Return pointwise densities and predictions of all poses, in the survey's order, from draws (E, S, n)."""
    variant, flat = inputs.variant(task.variant), kept.reshape(-1, kept.shape[-1])
    theta, errors = posterior.theta(flat), posterior.model_errors(flat)
    chosen = np.linspace(0, len(flat) - 1, min(PREDICTIVE_DRAWS, len(flat))).astype(int)
    pieces: dict[str, list[Array]] = {}
    together: Arrays = {}
    held = inputs.verification
    for use, rng_seed in zip((False, True), seed.spawn(2), strict=True):
        if not np.any(held == use):
            continue
        likelihood, rng = inputs.likelihood(variant, verification=use), np.random.default_rng(rng_seed)
        if isinstance(posterior, StructuredPosterior):
            found, more = evaluate_structured(posterior, likelihood, theta, errors, chosen, use, rng)
            together |= more
        else:
            pointwise = np.concatenate([_pointwise(likelihood, theta, errors, k) for k in range(0, len(flat), 256)])
            some = errors if errors.ndim == 1 else errors[chosen]
            prediction = predict(likelihood, theta[chosen], some, rng)
            found = {"log_likelihood": pointwise.T, **vars(prediction)}
        for name, value in found.items():
            pieces.setdefault(name, []).append(value)
    order = np.concatenate([np.flatnonzero(held == use) for use in (False, True)])
    back = np.argsort(order)
    arrays = {name: np.concatenate(parts)[back] for name, parts in pieces.items()}
    arrays["log_likelihood"] = arrays["log_likelihood"].T.reshape(*kept.shape[:2], -1)
    return arrays | together


def _pointwise(likelihood: Likelihood, theta: Array, tau: Array, start: int) -> Array:
    part = slice(start, start + 256)
    return likelihood.pointwise(theta[part], tau if tau.ndim == 1 else tau[part])


def read_prediction(arrays: Arrays) -> Prediction:
    """Return the prediction at all poses that a task's arrays hold."""
    return Prediction(**{field.name: arrays[field.name] for field in fields(Prediction)})
