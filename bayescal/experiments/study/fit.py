"""A posterior of machines on legs from config to numbers: what runs, is saved and is resumed as a whole."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import TYPE_CHECKING, cast

import numpy as np

from bayescal.calibrated.functions import KnownFunctions
from bayescal.density.exact import ExactDensity
from bayescal.density.functions import FunctionLikelihood
from bayescal.density.legs import LegPosterior, Likelihood
from bayescal.density.prediction import Prediction, replicate
from bayescal.experiments.shared.chi_square import ChiSquare
from bayescal.experiments.shared.estimate import Arrays, Fit, Subject, fit_posterior
from bayescal.experiments.shared.search_memory import POSE_NUMBERS, choose_kept
from bayescal.experiments.shared.soundness import find_misfit
from bayescal.experiments.shared.study_inputs import Task
from bayescal.experiments.shared.trees import (
    PRIOR_DRAWS,
    SAVED_DRAWS,
    Draws,
    Group,
    Readings,
    build_tree,
    choose_draws,
    group_functions,
    limit_draws,
    spread,
)
from bayescal.experiments.study.inputs import StudyInputs
from bayescal.experiments.study.model_error import evaluate_functions
from bayescal.identifiability.hidden import choose_unseen
from bayescal.inference.correction import CostlyDensity, pull_back
from bayescal.inference.exploration import Exploration
from bayescal.inference.target import Fittable
from bayescal.limits import OUTLIER
from bayescal.numerics.geometry import (
    Array,
    matrix_from_rotation_vector,
    rotation_vector_from_matrix,
    rotation_vector_of_turn,
)

if TYPE_CHECKING:
    import xarray as xr

ONLY_SAVED = ("prior", "prior_misfit")
"""Arrays of a posterior that nothing but its tree has."""
AT_ONCE = 2**16  # poses of draws whose rotation matrices are made together
TRIES = 4  # draws of the prior for each that is wanted: some are no machine
CHANNELS, UNITS = ("x", "y", "z", "rx", "ry", "rz"), ("mm",) * 3 + ("rad",) * 3
MEANING = "measured pose, base frame: position and rotation vector"


def run_task(inputs: StudyInputs, task: Task) -> Fit:
    """Compute one task."""
    config = inputs.config
    return fit_posterior(Legs(inputs, task), config.seed, inputs.name_task(task), config.sampler, config.evidence)


def pack(inputs: StudyInputs, task: Task, fit: Fit) -> Fit:
    """Return a fit with its tree's file in place of what only that has."""
    return replace(fit.pack(build_study_tree(inputs, task, fit), ONLY_SAVED), y=fit.y[:, :0])


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
        most = choose_kept(self.posterior.likelihood, shape[0], len(self.inputs.verification))
        keep = max(1, -(-shape[1] * shape[2] // most))
        return np.arange(np.prod(shape)).reshape(shape)[:, :, ::keep].reshape(shape[0], -1)

    def is_used(self, n_rows: int) -> np.ndarray:
        """Return which poses are for calibration."""
        del n_rows
        return ~self.inputs.verification

    def find_costly(self, exploration: Exploration) -> CostlyDensity | None:
        """Return the exact density of measured poses; None where these are not measured, or may be outliers."""
        posterior = cast("LegPosterior", exploration.straight.posterior)
        exact = self.inputs.exact_density(self.inputs.variant(self.task.variant), posterior)
        return None if exact is None else build_costly(exact, exploration)

    def replicate_prior(self, posterior: Fittable, seed: np.random.SeedSequence) -> Arrays:
        """Return draws of the prior and what they make of the calibration poses.

        That is ``prior_misfit`` (T, P, 6), measured minus replicated poses.
        """
        rng, own = np.random.default_rng(seed), cast("LegPosterior", posterior)
        likelihood = own.likelihood
        values, theta = _draw_prior(own, rng, limit_draws(PRIOR_DRAWS, POSE_NUMBERS * likelihood.n_poses))
        errors = own.errors.amplitudes_of(own.zeta(values))
        with np.errstate(all="ignore"):
            made = [replicate(part, theta, errors, rng).misfit for _, part in likelihood.parts()]
        return {"prior": values, "prior_misfit": np.concatenate([one.astype(np.float32) for one in made], axis=1)}

    def measure_misfit(self, posterior: Fittable, mode: Array) -> ChiSquare:
        """Return χ² at a mode (n,) of the poses that are no outliers there."""
        legs, clean = cast("LegPosterior", posterior), None
        likelihood, shared = self.inputs.without_shared_errors(self.task.variant)
        if isinstance(legs.likelihood, FunctionLikelihood):
            likelihood = self.inputs.give_functions(likelihood, self.inputs.variant(self.task.variant))
        if legs.errors.outliers.expected:
            at = legs.theta(mode[None]), legs.errors, legs.zeta(mode[None])
            clean = legs.likelihood.outlier_probabilities(*at)[0] < OUTLIER
        return find_misfit(legs, mode, likelihood, shared, clean).chi_square

    def evaluate(self, posterior: Fittable, y: Array, seed: np.random.SeedSequence) -> Arrays:
        """Return pointwise densities and predictions of all poses, in the survey's order, from draws (E, S, n).

        They are of the hot path, whose covariance is that of the nominal machine, pose by pose.
        """
        own, held, flat = cast("LegPosterior", posterior), self.inputs.verification, y.reshape(-1, y.shape[-1])
        chosen = spread(len(flat), limit_draws(SAVED_DRAWS, POSE_NUMBERS * len(held)))
        if isinstance(own.likelihood, FunctionLikelihood):
            others = self._predict_from(own.likelihood, verification=True) if held.any() else None
            error = self.inputs.model_error(self.inputs.variant(self.task.variant))
            unseen = choose_unseen(error.lengths(), own.likelihood.functions.sorts)
            return evaluate_functions(own, others, held, y, chosen, seed, unseen)
        pieces = dict[str, list[Array]]()
        for use, rng_seed in zip((False, True), seed.spawn(2), strict=True):
            if not np.any(held == use):
                continue
            likelihood = self._predict_from(own.likelihood, use) if use else own.likelihood
            found = _evaluate_poses(own, likelihood, flat, chosen, np.random.default_rng(rng_seed))
            for name, value in found.items():
                pieces.setdefault(name, []).append(value)
        back = np.argsort(np.concatenate([np.flatnonzero(held == use) for use in (False, True)]))
        arrays = {name: np.concatenate(parts)[back] for name, parts in pieces.items()}
        arrays["log_likelihood"] = arrays["log_likelihood"].T.reshape(*y.shape[:2], -1)
        return arrays

    def _predict_from(self, likelihood: Likelihood, verification: bool) -> Likelihood:
        """Return the density of the poses of one use that leaves out as much as another one does."""
        return likelihood.like(self.inputs.likelihood(self.inputs.variant(self.task.variant), verification))


def _evaluate_poses(
    posterior: LegPosterior, likelihood: Likelihood, y: Array, chosen: np.ndarray, rng: np.random.Generator
) -> Arrays:
    """Return densities of the poses from draws (S, n), ``log_likelihood`` (P, S), and what those chosen predict.

    These are the fields of a `Prediction`, ``misfit`` (P, T, 6) measured minus replicated poses and, where poses may be
    outliers, ``outlier_probability`` (P,).
    """
    theta, zeta, pieces = posterior.theta(y), posterior.zeta(y), dict[str, list[Array]]()
    errors, expected = posterior.errors.amplitudes(zeta), posterior.errors.outliers.expected
    for _, part in likelihood.parts():
        density = posterior.predict_density(part, y) if expected else part.pointwise(theta, errors)
        made = replicate(part, theta[chosen], errors if errors.ndim == 1 else errors[chosen], rng)
        misfit = made.misfit.astype(np.float32).swapaxes(0, 1)
        found = {"log_likelihood": density.T, **vars(made.summarise()), "misfit": misfit}
        if expected:
            found["outlier_probability"] = part.outlier_probabilities(theta, posterior.errors, zeta).mean(axis=0)
        for name, value in found.items():
            pieces.setdefault(name, []).append(value)
    return {name: values[0] if len(values) == 1 else np.concatenate(values) for name, values in pieces.items()}


def _draw_prior(posterior: LegPosterior, rng: np.random.Generator, n_wanted: int) -> tuple[Array, Array]:
    """Return draws of the prior that are machines, in own units (T, n) and as parameter vectors (T, D)."""
    values = np.stack([one.draw(TRIES * n_wanted, rng) for one in posterior.all_priors().values()], axis=-1)
    theta = np.broadcast_to(posterior.sampling.start, (len(values), len(posterior.sampling.start))).copy()
    theta[:, posterior.sampling.free] = values[:, : posterior.n_geometry]
    values, theta = (part[posterior.likelihood.layout.inside(theta)] for part in (values, theta))
    closes = np.ones(len(theta[: 2 * n_wanted]), dtype=bool)
    with np.errstate(all="ignore"):
        for _, part in posterior.likelihood.parts():
            closes &= np.isfinite(part.errors(theta[: 2 * n_wanted])).all(axis=(1, 2))
    good = np.flatnonzero(closes)[:n_wanted]
    return values[good], theta[good]


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


# --- the posterior as an ArviZ tree ------------------------------------------------------------------------------


def build_study_tree(inputs: StudyInputs, task: Task, fit: Fit) -> xr.DataTree:
    """Return one posterior with draws of its prior, what both predict, and the data."""
    priors, arrays = Legs(inputs, task).posterior.all_priors().values(), fit.evaluated
    (n_chains, n_draws), n_kept = fit.draws.shape[:2], arrays["misfit"].shape[1]
    chosen = choose_draws(n_chains, n_draws, n_kept)
    draws, log_density, log_likelihood = (
        _take(one, chosen) for one in (fit.draws, fit.log_density, arrays["log_likelihood"])
    )
    held, readings = inputs.verification, _read_poses(inputs)
    made = _replicate(readings, _take_replicates(arrays["misfit"], n_chains * n_draws, chosen))
    log_prior = np.stack([prior.log_density(draws[..., k]) for k, prior in enumerate(priors)], axis=-1)
    names = np.array(inputs.names)
    return build_tree(
        Draws(fit.names, fit.units, draws, log_density, log_prior, arrays["prior"]),
        Readings(
            [str(name) for name in names[~held]],
            CHANNELS,
            UNITS,
            readings[~held],
            made[..., ~held, :],
            _replicate(readings[~held], arrays["prior_misfit"]),
            log_likelihood[..., ~held],
            MEANING,
        ),
        _list_groups(inputs, readings, made, log_likelihood) | _group_functions(inputs, task, fit),
        variant=task.variant,
        model_error="free" if task.with_model_error else "zero",
        length_unit="mm",
    )


def _take(values: Array, chosen: Array) -> Array:
    """Return some draws of values (E, S, ...), by their places (E, S') in chains laid end to end."""
    return values.reshape(-1, *values.shape[2:])[chosen]


def _take_replicates(misfit: Array, n_draws: int, chosen: Array) -> Array:
    """Return the replicates (P, T, 6) of the chosen draws, shape (E, S', P, 6); they were made of the same draws."""
    made = np.searchsorted(spread(n_draws, misfit.shape[1]), chosen)
    return misfit.swapaxes(0, 1)[made]


def _read_poses(inputs: StudyInputs) -> Array:
    """Return the poses as measured, shape (P, 6); NaN where a coordinate is not."""
    poses = inputs.measured.poses
    known = np.isfinite(poses.rotation).all(axis=(1, 2))[:, None]
    turn = rotation_vector_from_matrix(np.where(known[..., None], poses.rotation, np.eye(3)))
    return np.concatenate([poses.position, np.where(known, turn, np.nan)], axis=-1)


def _replicate(measured: Array, misfit: Array) -> Array:
    """Return replicated poses (..., P, 6) from the measured ones (P, 6) and measured minus replicated (..., P, 6)."""
    rotation, flat = matrix_from_rotation_vector(np.nan_to_num(measured[:, 3:])), misfit.reshape(-1, *measured.shape)
    found, most = np.empty(flat.shape, dtype=np.float32), max(1, AT_ONCE // len(measured))
    for k in range(0, len(flat), most):
        some, made = flat[k : k + most], found[k : k + most]
        turn = rotation_vector_of_turn(matrix_from_rotation_vector(-np.nan_to_num(some[..., 3:])) @ rotation)
        made[..., :3] = measured[:, :3] - some[..., :3]
        made[..., 3:] = np.where(np.isfinite(measured[:, 3:] - some[..., 3:]), turn, np.nan)
    replicated: Array = found.reshape(misfit.shape)  # type: ignore[assignment]  # single precision
    return replicated


def _group_functions(inputs: StudyInputs, task: Task, fit: Fit) -> dict[str, Group]:
    """Return what is known of errors that are functions of the pose, where whole poses tell it."""
    variant = inputs.variant(task.variant)
    if not (task.with_model_error and inputs.list_sorts(variant) and inputs.measured.has_poses):
        return {}
    measured = inputs.measure([task.variant], inputs.folder, with_model_error=True)[task.variant]
    known = KnownFunctions.find(measured.posterior, measured.adopt(fit.kept))
    return group_functions(known, measured.posterior.sampling.names)


def _list_groups(inputs: StudyInputs, readings: Array, made: Array, log_likelihood: Array) -> dict[str, Group]:
    """Return what is known of the poses besides, and what is predicted of those for verification."""
    poses, held = inputs.measured.poses, inputs.verification
    names = [str(name) for name in inputs.names]
    constant = {
        "rotation": (("pose", "axis", "platform_axis"), poses.rotation, "1", "measured rotation matrix, base frame"),
        "covariance": (("pose", "component", "other_component"), poses.covariance, "mm, rad", "of the measured pose"),
        "actuators": (("pose", "leg"), poses.actuators, "mm", "actuator positions"),
    }
    groups = {"constant_data": Group(constant, {"pose": names, "axis": list("xyz"), "platform_axis": list("xyz")})}
    if held.any():
        own = {"row": [name for name, one in zip(names, held, strict=True) if one], "channel": list(CHANNELS)}
        both, unit, over = ("row", "channel"), "mm, rad", ("chain", "draw")
        predicted = {
            "readings": ((*over, *both), made[..., held, :], unit, "readings that would be measured"),
            "log_density": ((*over, "row"), log_likelihood[..., held], "nat", "log-density of each row"),
        }
        groups["predictions"] = Group(predicted, own)
        groups["predictions_constant_data"] = Group({"readings": (both, readings[held], unit, MEANING)}, own)
    return groups
