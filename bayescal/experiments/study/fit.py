"""One variant's posterior from config to numbers: the unit of work that runs, is kept and is resumed as a whole."""

from __future__ import annotations

import time
import zlib
from dataclasses import dataclass, fields
from typing import cast

import numpy as np

from bayescal.density.legs import LegPosterior
from bayescal.density.prediction import Prediction
from bayescal.experiments.shared.misfit import measure_misfit
from bayescal.experiments.shared.trees import SAVED_DRAWS, choose_draws, limit_draws, spread
from bayescal.experiments.study.correct import (
    correct_draws,
    list_corrected,
    move_sample,
    sample_exactly,
)
from bayescal.experiments.study.inputs import StudyInputs
from bayescal.experiments.study.leave_one_out import LeftOut, leave_out, refit_doubtful
from bayescal.experiments.study.pointwise import SomeDraws, evaluate_poses
from bayescal.experiments.study.power_scaling import measure_sensitivity
from bayescal.experiments.study.replicates import replicate_prior
from bayescal.experiments.study.schema import stem_of
from bayescal.experiments.study.soundness import measure_pulls
from bayescal.experiments.study.structured import evaluate_structured
from bayescal.inference.bridge import estimate_by_bridge
from bayescal.inference.correction import Correction
from bayescal.inference.diagnostics import measure_longest_stand
from bayescal.inference.exploration import Exploration, count_walkers
from bayescal.inference.importance import ImportanceEvidence
from bayescal.inference.integration import Effort, integrate_posterior, widen_tails
from bayescal.inference.overdispersed import FarDraws, draw_far_out
from bayescal.inference.sampling import sample_posterior
from bayescal.inference.scouts import send_scouts
from bayescal.inference.tails import compare_tails
from bayescal.inference.tempered import estimate_by_tempering
from bayescal.limits import BLUNDER
from bayescal.numerics.geometry import Array

KEPT_DRAWS = 1920  # of each ensemble, for everything after the diagnostics
POSE_NUMBERS = 6

type Arrays = dict[str, Array]


@dataclass(frozen=True)
class Task:
    """A unit of work: a posterior of a variant."""

    variant: str
    with_model_error: bool

    @property
    def key(self) -> str:
        """A name that is also a file name."""
        return f"{stem_of(self.variant)}-tau-{'free' if self.with_model_error else 'zero'}"

    @property
    def stem(self) -> str:
        """Name of the posterior's file without its ending."""
        return stem_of(self.variant) + ("" if self.with_model_error else "-tau-zero")


def list_tasks(inputs: StudyInputs) -> list[Task]:
    """Return all tasks of a study, the long ones first."""
    names = [variant.name for variant in inputs.config.variants]
    return [Task(name, with_model_error) for with_model_error in (True, False) for name in names]


def run_task(inputs: StudyInputs, task: Task) -> Arrays:
    """Compute one task; all numbers depend on the inputs, the config's seed and the task's key alone."""
    began = time.perf_counter()
    variant = inputs.variant(task.variant)
    posterior = inputs.posterior(variant, task.with_model_error)
    seed = np.random.SeedSequence([inputs.config.seed, zlib.crc32(task.key.encode())])
    explore_seed, importance_seed, ensemble_seed, bridge_seed, predict_seed, correct_seed = seed.spawn(6)
    effort, walkers = inputs.config.evidence, inputs.config.sampler.walkers
    price = Effort(effort.draws, effort.target_error, effort.max_draws)
    exploration, importance = integrate_posterior(posterior, explore_seed, importance_seed, walkers, price)
    far = draw_far_out(exploration, _seed_for(inputs, task, "tails"))
    exploration, importance = widen_tails(exploration, importance, far, importance_seed, price)
    posterior = get_explored(exploration)
    arrays = {
        **list_importance(importance),
        "modes": np.stack([mode.y for mode in exploration.modes]),
        "modes_converged": np.array(all(mode.converged for mode in exploration.modes), dtype=float),
    }
    seeds = (ensemble_seed, bridge_seed, predict_seed, correct_seed)
    sampled, correction = _sample(inputs, task, posterior, exploration, far, *seeds)
    arrays |= sampled
    arrays |= _check(inputs, task, posterior, exploration, arrays, seed)
    arrays |= list_corrected(arrays, correction)
    arrays["wall_seconds"] = np.array(time.perf_counter() - began)
    return arrays


def list_importance(importance: ImportanceEvidence) -> Arrays:
    """Return an evidence by importance sampling and its quality, to be kept."""
    return {
        "importance": np.array([importance.log_evidence, importance.standard_error]),
        "importance_quality": np.array([importance.efficiency, importance.pareto_k, importance.n_draws]),
    }


def get_explored(exploration: Exploration) -> LegPosterior:
    """Return the posterior that was explored: one with a finer density where that makes a difference."""
    return cast(LegPosterior, exploration.straight.posterior)


def _sample(
    inputs: StudyInputs,
    task: Task,
    posterior: LegPosterior,
    exploration: Exploration,
    far: FarDraws,
    ensemble_seed: np.random.SeedSequence,
    bridge_seed: np.random.SeedSequence,
    predict_seed: np.random.SeedSequence,
    correct_seed: np.random.SeedSequence,
) -> tuple[Arrays, Correction | None]:
    """Return what draws tell, and the correction that moved them to the exact density where there is one."""
    sampler, straight = inputs.config.sampler, exploration.straight
    walkers = count_walkers(posterior.n_parameters, sampler.walkers)
    sample = sample_posterior(
        exploration, ensemble_seed, sampler.ensembles, sampler.walkers, sampler.burn_in, sampler.steps
    )
    bridge = estimate_by_bridge(
        straight.log_density,
        sample.straight,
        sample.log_density,
        np.random.default_rng(bridge_seed),
        inputs.config.evidence.draws,
        exploration.proposal,
    )
    scouts = send_scouts(exploration, sample, far, _seed_for(inputs, task, "scouts"))
    tails = compare_tails(exploration, sample, far)
    exact, correction = inputs.exact_density(inputs.variant(task.variant), posterior), None
    if exact is not None:
        correction = correct_draws(exact, exploration, sample, correct_seed)
        if correction.is_trusted:
            sample = move_sample(sample, exploration, correction)
        else:
            seeds = correct_seed.spawn(sampler.ensembles)
            sample = sample_exactly(exact, exploration, sample, correction.move, seeds)
    y, natural, density, diagnostics = sample.y, sample.natural, sample.log_density, sample.diagnostics
    # thin in time, the same steps of every walker, and keep the order walker by walker
    most = limit_draws(KEPT_DRAWS, sampler.ensembles * len(inputs.verification))
    keep = max(1, -(-sampler.steps * walkers // most))
    kept, own = (values[:, :, ::keep].reshape(sampler.ensembles, -1, posterior.n_parameters) for values in (y, natural))
    low, high = np.quantile(natural, (0.05, 0.95), axis=(0, 1, 2))
    arrays = {
        "bridge": np.array([bridge.log_evidence, bridge.standard_error]),
        "bridge_converged": np.array(bridge.converged, dtype=float),
        "acceptance": sample.acceptance,
        "longest_stand": np.array([measure_longest_stand(density), sampler.steps]),
        "scouts": np.array([scouts.n_apart, scouts.n_walkers, scouts.limit]),
        "tails": np.array([tails.expected, tails.found, tails.error]),
        "mean": natural.mean(axis=(0, 1, 2)),
        "sd": natural.std(axis=(0, 1, 2)),
        "q05": low,
        "q95": high,
        "rhat": diagnostics.rhat,
        "ess_bulk": diagnostics.ess_bulk,
        "ess_tail": diagnostics.ess_tail,
        "draws": own,
        "log_density": density[:, :, ::keep].reshape(sampler.ensembles, -1),
        **_evaluate(inputs, task, posterior, kept, predict_seed),
        **_check_evidence(inputs, task, posterior),
    }
    return arrays, correction


def _seed_for(inputs: StudyInputs, task: Task, purpose: str) -> np.random.SeedSequence:
    """Return the seed of what looks at a posterior from outside; its random numbers are its own."""
    return np.random.SeedSequence([inputs.config.seed, zlib.crc32(f"{task.key}-{purpose}".encode())])


def _check_evidence(inputs: StudyInputs, task: Task, posterior: LegPosterior) -> Arrays:
    """Return the evidence by tempering where the config asks for it."""
    if inputs.config.evidence.check is None:
        return {}
    found = estimate_by_tempering(posterior, _seed_for(inputs, task, "tempered"))
    return {"tempered": np.array([found.log_evidence, found.standard_error, float(found.mixed)])}


def _check(
    inputs: StudyInputs,
    task: Task,
    posterior: LegPosterior,
    exploration: Exploration,
    arrays: Arrays,
    seed: np.random.SeedSequence,
) -> Arrays:
    """Return what judges a posterior: each pose left out, what prior draws predict, what noise and tolerances say."""
    prior_seed, refit_seed = seed.spawn(2)
    left_out = leave_out(arrays["draws"], arrays["log_likelihood"][..., ~inputs.verification])
    left_out = refit_doubtful(left_out, posterior, exploration, inputs.config.sampler.walkers, refit_seed)
    return {
        "misfit_chi2": _measure_misfit(inputs, task, posterior, exploration.modes[0].y),
        "pulls_chi2": measure_pulls(posterior, arrays["draws"]),
        "power_scaling": _scale_power(inputs, posterior, arrays),
        **{f"left_out_{name}": value for name, value in vars(left_out).items()},
        **replicate_prior(posterior, prior_seed),
    }


def _measure_misfit(inputs: StudyInputs, task: Task, posterior: LegPosterior, mode: Array) -> Array:
    """Return χ² at a mode (n,) of the poses that are no blunders there, and its degrees of freedom."""
    clean = None
    if posterior.likelihood.structured is not None:
        return measure_misfit(posterior, mode, posterior.likelihood)
    if posterior.errors.outliers is not None:
        clean = (
            posterior.likelihood.outlier_probabilities(
                posterior.theta(mode[None]), posterior.errors, posterior.zeta(mode[None])
            )[0]
            < BLUNDER
        )
    return measure_misfit(posterior, mode, *inputs.without_shared_errors(task.variant), clean)


def _scale_power(inputs: StudyInputs, posterior: LegPosterior, arrays: Arrays) -> Array:
    """Return how much each parameter hangs on prior and measurements, shape (n, 2), from some of the draws."""
    chosen = choose_draws(*arrays["draws"].shape[:2])
    draws, density = (arrays[name].reshape(-1, arrays[name].shape[-1])[chosen] for name in ("draws", "log_likelihood"))
    priors = posterior.all_priors().values()
    log_prior = sum(prior.log_density(draws[..., k]) for k, prior in enumerate(priors))
    together = density[..., ~inputs.verification].sum(axis=-1)
    if "calibration_density" in arrays:  # poses that depend on each other: their densities do not add up
        together = arrays["calibration_density"][chosen]
    return measure_sensitivity(draws, np.asarray(log_prior), together)


def _evaluate(
    inputs: StudyInputs, task: Task, posterior: LegPosterior, kept: Array, seed: np.random.SeedSequence
) -> Arrays:
    """Return pointwise densities and predictions of all poses, in the survey's order, from draws (E, S, n).

    They are of the hot path, whose covariance is that of the nominal machine, pose by pose.
    """
    variant, flat = inputs.variant(task.variant), kept.reshape(-1, kept.shape[-1])
    theta, errors = posterior.theta(flat), posterior.errors.amplitudes(posterior.zeta(flat))
    chosen = spread(len(flat), limit_draws(SAVED_DRAWS, POSE_NUMBERS * len(inputs.verification)))
    every = SomeDraws(theta, errors)
    some = every.choose(chosen)
    pieces: dict[str, list[Array]] = {}
    together: Arrays = {}
    held = inputs.verification
    for use, rng_seed in zip((False, True), seed.spawn(2), strict=True):
        if not np.any(held == use):
            continue
        structured, rng = posterior.likelihood.structured, np.random.default_rng(rng_seed)
        likelihood = posterior.likelihood
        if use or structured is not None:  # otherwise that of the same poses is at hand
            likelihood = posterior.likelihood.like(inputs.likelihood(variant, use))
        found: Arrays
        if structured is not None and likelihood.of_poses is not None:
            found, more = evaluate_structured(structured, likelihood.of_poses, theta, errors, chosen, use, rng)
            together |= more
        else:
            found = evaluate_poses(posterior, likelihood, flat, every, some, rng)
        for name, value in found.items():
            pieces.setdefault(name, []).append(value)
    order = np.concatenate([np.flatnonzero(held == use) for use in (False, True)])
    back = np.argsort(order)
    arrays = {name: np.concatenate(parts)[back] for name, parts in pieces.items()}
    arrays["log_likelihood"] = arrays["log_likelihood"].T.reshape(*kept.shape[:2], -1)
    return arrays | together


def read_prediction(arrays: Arrays) -> Prediction:
    """Return the prediction at all poses that a task's arrays hold."""
    return Prediction(**{field.name: arrays[field.name] for field in fields(Prediction)})


def read_left_out(arrays: Arrays) -> LeftOut:
    """Return what leaving each calibration pose out found, that a task's arrays hold."""
    return LeftOut(**{field.name: arrays[f"left_out_{field.name}"] for field in fields(LeftOut)})
