"""One variant's posterior from config to numbers: the unit of work that runs, is kept and is resumed as a whole."""

from __future__ import annotations

from dataclasses import dataclass, fields
from functools import cached_property
from typing import cast

import numpy as np

from bayescal.density.exact import ExactDensity
from bayescal.density.legs import LegPosterior
from bayescal.density.prediction import Prediction
from bayescal.experiments.shared.chi_square import ChiSquare
from bayescal.experiments.shared.estimate import Arrays, Fit, Subject, fit_posterior
from bayescal.experiments.shared.soundness import find_misfit
from bayescal.experiments.shared.study_schema import stem_of
from bayescal.experiments.shared.trees import SAVED_DRAWS, limit_draws, spread
from bayescal.experiments.shared.variant_tables import FREE, ZERO
from bayescal.experiments.study.inputs import StudyInputs
from bayescal.experiments.study.pointwise import SomeDraws, evaluate_poses
from bayescal.experiments.study.replicates import replicate_prior
from bayescal.experiments.study.structured import evaluate_structured
from bayescal.inference.correction import CostlyDensity, pull_back
from bayescal.inference.exploration import Exploration
from bayescal.inference.target import Fittable
from bayescal.limits import BLUNDER
from bayescal.numerics.geometry import Array

KEPT_DRAWS = 1920  # of each ensemble, for everything after the diagnostics
POSE_NUMBERS = 6


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
    def setting(self) -> str:
        """The setting of the model error, as tables call it."""
        return FREE if self.with_model_error else ZERO

    @property
    def stem(self) -> str:
        """Name of the posterior's file without its ending."""
        return stem_of(self.variant) + ("" if self.with_model_error else "-tau-zero")


def list_tasks(inputs: StudyInputs) -> list[Task]:
    """Return all tasks of a study, the long ones first."""
    names = [variant.name for variant in inputs.config.variants]
    return [Task(name, with_model_error) for with_model_error in (True, False) for name in names]


def run_task(inputs: StudyInputs, task: Task) -> Fit:
    """Compute one task; all numbers depend on the inputs, the config's seed and the task's key alone."""
    config = inputs.config
    return fit_posterior(Legs(inputs, task), config.seed, task.key, config.sampler, config.evidence)


@dataclass(frozen=True, eq=False)
class Legs(Subject):
    """The posterior of a variant of machines on legs.

    Attributes
    ----------
    inputs : StudyInputs
    task : Task
    factor : float
        On the widths of the parameters' priors.
    """

    inputs: StudyInputs
    task: Task
    factor: float = 1.0

    @cached_property
    def posterior(self) -> LegPosterior:
        """The posterior."""
        variant = self.inputs.variant(self.task.variant)
        return self.inputs.posterior(variant, self.task.with_model_error, self.factor)

    def choose(self, shape: tuple[int, int, int]) -> np.ndarray:
        """Thin in time: the same steps of every walker, in order walker by walker."""
        most = limit_draws(KEPT_DRAWS, shape[0] * len(self.inputs.verification))
        keep = max(1, -(-shape[1] * shape[2] // most))
        return np.arange(np.prod(shape)).reshape(shape)[:, :, ::keep].reshape(shape[0], -1)

    def is_used(self, n_rows: int) -> np.ndarray:
        """Return which poses are for calibration."""
        del n_rows
        return ~self.inputs.verification

    def find_costly(self, exploration: Exploration) -> CostlyDensity | None:
        """Return the exact density of measured poses; None where these are not measured, or may be blunders."""
        posterior = cast("LegPosterior", exploration.straight.posterior)
        exact = self.inputs.exact_density(self.inputs.variant(self.task.variant), posterior)
        return None if exact is None else build_costly(exact, exploration)

    def replicate_prior(self, posterior: Fittable, seed: np.random.SeedSequence) -> Arrays:
        """Return draws of the prior and what they make of the calibration poses."""
        return replicate_prior(cast("LegPosterior", posterior), seed)

    def measure_misfit(self, posterior: Fittable, mode: Array) -> ChiSquare:
        """Return χ² at a mode (n,) of the poses that are no blunders there."""
        legs, clean = cast("LegPosterior", posterior), None
        if legs.likelihood.structured is not None:
            return find_misfit(legs, mode, legs.likelihood).chi_square
        if legs.errors.outliers.expected:
            at = legs.theta(mode[None]), legs.errors, legs.zeta(mode[None])
            clean = legs.likelihood.outlier_probabilities(*at)[0] < BLUNDER
        return find_misfit(legs, mode, *self.inputs.without_shared_errors(self.task.variant), clean).chi_square

    def evaluate(self, posterior: Fittable, y: Array, seed: np.random.SeedSequence) -> Arrays:
        """Return pointwise densities and predictions of all poses, in the survey's order, from draws (E, S, n).

        They are of the hot path, whose covariance is that of the nominal machine, pose by pose.
        """
        return _evaluate(self.inputs, self.task, cast("LegPosterior", posterior), y, seed)


def _evaluate(
    inputs: StudyInputs, task: Task, posterior: LegPosterior, kept: Array, seed: np.random.SeedSequence
) -> Arrays:
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


def build_costly(exact: ExactDensity, exploration: Exploration) -> CostlyDensity:
    """Return the exact density in straight coordinates, beside the one that was explored."""
    straight = exploration.straight
    posterior = cast("LegPosterior", straight.posterior)

    def excess(x: Array) -> Array:
        y = straight.y_from_x(x)
        theta, errors = posterior.theta(y), posterior.errors.amplitudes(posterior.zeta(y))
        with np.errstate(invalid="ignore"):
            found = exact(theta, errors) - posterior.likelihood(theta, errors)
        return np.where(np.isfinite(found), found, -np.inf)

    # what the exact density knows of the geometry more; of the model errors it is taken to know the same
    y = exploration.modes[0].y
    theta = posterior.theta(y[None])[0]
    change, amplitudes = posterior.sampling.jacobian(theta), posterior.errors.amplitudes(posterior.zeta(y))
    more = change.T @ exact.information(theta, amplitudes) @ change - posterior.information(y)[0]
    return CostlyDensity(straight.log_density, excess, pull_back(straight, y, more))


def read_prediction(fit: Fit) -> Prediction:
    """Return the prediction at all poses that a fit holds."""
    return Prediction(**{field.name: fit.evaluated[field.name] for field in fields(Prediction)})
