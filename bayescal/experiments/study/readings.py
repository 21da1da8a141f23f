"""A posterior of tables of readings, the poses unknown, from config to numbers, and what its study says of all."""

from __future__ import annotations

import zlib
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, Any, cast

import numpy as np
import pandas as pd
from scipy.special import chdtrc

from bayescal.calibrated.functions import KnownFunctions
from bayescal.calibrated.in_use import MachineInUse
from bayescal.density.calibration.likelihood import CalibrationPosterior
from bayescal.density.calibration.prediction import (
    ReadingPredictions,
    predict_poses,
    predict_readings_by,
    replicate_readings,
)
from bayescal.density.prediction import Prediction, compute_elpd
from bayescal.experiments.runner.losses import attempt
from bayescal.experiments.runner.parallel import Run
from bayescal.experiments.runner.results import Summary
from bayescal.experiments.shared.error_sizes import find_units
from bayescal.experiments.shared.estimate import Arrays, Fit, PosteriorProblem, fit_posterior
from bayescal.experiments.shared.function_errors import has_lengths, tabulate_functions, tabulate_model_error
from bayescal.experiments.shared.headline import say_accuracy
from bayescal.experiments.shared.posterior_files import (
    MODE,
    ReadingLayout,
    Variables,
    limit_draws,
    make_dataset,
    name_functions,
    split_parameters,
    spread,
)
from bayescal.experiments.shared.readings.inputs import ReadingInputs, Variant
from bayescal.experiments.shared.readings.knowledge import (
    IdentifiabilityResult,
    Learnt,
    compute_tool_uncertainty,
    forecast_accuracy,
    learn_posterior,
    name_data,
    plain,
)
from bayescal.experiments.shared.readings.priors import widen
from bayescal.experiments.shared.readings.reference_values import ReferenceValues
from bayescal.experiments.shared.search_memory import PRIOR_READINGS
from bayescal.experiments.shared.soundness import ChiSquare, fit_rows
from bayescal.experiments.study.before_after import tabulate_before_after, tabulate_requirements
from bayescal.experiments.study.calibrated import ERRORS, tabulate_errors
from bayescal.experiments.study.inputs import StudyInputs
from bayescal.experiments.study.rows import (
    NotPredictedRow,
    PoseRow,
    PredictionRow,
    ReferenceRow,
    ResidualRow,
    ToolPredictionRow,
    VariantRow,
)
from bayescal.experiments.study.tables import (
    describe_errors,
    describe_legs,
    describe_solutions,
    find_seen,
    join_tables,
    list_seen,
    tabulate_comparison,
    tabulate_legs,
    tabulate_parameters,
    tabulate_pose_errors,
    tabulate_tau_scale,
    title_variant,
)
from bayescal.inference.correction import CostlyDensity, pull_back
from bayescal.inference.exploration import Exploration, explore
from bayescal.inference.importance import resample
from bayescal.inference.stages import stage
from bayescal.inference.target import LogPosterior
from bayescal.machines.readings.gains import find_gains
from bayescal.numerics.geometry import Array
from bayescal.report.symbols import format_amount

if TYPE_CHECKING:
    import xarray as xr

ONLY_SAVED = ("log_likelihood", "replicated", "prior", "prior_replicated")
POSE_DRAWS = 200  # of the posterior, that predict poses
ERROR_DRAWS = 200  # of the posterior, from which errors common to all rows are drawn for tables
PROPOSED = 8  # draws of the proposal for each that is used
IMPROBABLE = 0.01  # probability by the noise, of all poses together, below which a pose's residuals contradict it
MAX_FROZEN_ERROR_NAT = 0.03  # nats, rms, that a frozen density may leave out of posterior and evidence
OUTLIER_WEIGHT = 0.5  # mean of a pose's precision below which a robust density takes it for an outlier


@dataclass(frozen=True, eq=False)
class Residuals:
    """What the best machine leaves of the readings at P poses."""

    pose: Array  # (P, q)
    # with noise, (P, K): measured minus read, NaN where nothing was, and the noise at the best machine; in the
    # channels' units
    left: Array
    noise: Array
    square: Array  # (P,): r²
    trust: Array  # (P,): mean of the pose's precision; one but for robust densities
    freedom: np.ndarray  # (P,): readings less coordinates

    @property
    def chance(self) -> Array:
        """With which probability the noise alone makes r² as large, shape (P,)."""
        return np.asarray(chdtrc(np.maximum(self.freedom, 1), self.square))

    def find_contradicting(self, robust: bool) -> np.ndarray:
        """Return which poses the others contradict, shape (P,); in 99 of 100 clean studies none.

        Where single poses may be wrong, these have to be distrusted, too.
        """
        improbable = self.chance < IMPROBABLE / len(self.square)  # each pose is a test of its own
        return improbable & (self.trust < OUTLIER_WEIGHT) if robust else improbable


@dataclass(frozen=True, eq=False)
class FoldPrediction:
    """What one fold tells."""

    rows: np.ndarray  # (V,): the held-back poses, of the variant's
    elpd: float  # log predictive density of all their readings together
    efficiency: float  # with pareto_k: of the posterior's draws
    pareto_k: float
    predictions: ReadingPredictions  # its poses count within ``rows``
    tool: ReadingPredictions  # the same of what an instrument reads of the tool, from the machine's own readings alone


@dataclass(frozen=True, eq=False)
class ReadingFit(Fit):
    """A fit of readings, and all that is said of its variant."""

    tables: dict[str, pd.DataFrame]  # its rows of the study's tables, by name; none where it has none
    held: list[FoldPrediction]  # the prediction of poses kept for verification
    # errors of all poses that an instrument saw, by the machine's own channels; None where none saw any
    poses: Prediction | None = None


def fit_variant(inputs: ReadingInputs, name: str) -> ReadingFit:
    """Return all that is found of a variant; its random numbers depend on the config's seed and the name alone."""
    variant, config = inputs.variants[name], inputs.config
    factors = [one for one in config.sensitivity.prior_width_factors if one != 1.0]
    describe = partial(_describe_accuracy, inputs, variant)
    subject = ReadingSubject(variant.posterior().with_pose_guesses(), factors, describe)
    posterior = subject.posterior
    fit = fit_posterior(subject, config.seed, name, config.sampler, config.evidence)
    y = fit.kept_of(0)  # a mean over several solutions is no machine
    some = y[spread(len(y), ERROR_DRAWS)]
    rng, own = (np.random.default_rng([config.seed, k, zlib.crc32(name.encode())]) for k in (9, 10))
    of, none, no_tables = f"of {name!r}", pd.DataFrame(), dict[str, pd.DataFrame]()
    machine = MachineInUse.find(posterior, y)
    each = [fit.kept_of(k + 1) for k in range(len(fit.others))]
    find, unknown = partial(KnownFunctions.find, posterior), list[KnownFunctions | None]([None] * len(each))
    known = [
        machine.known,
        *attempt(f"other solutions {of}", lambda: [find(one) for one in each], unknown),
    ]
    tables = attempt(f"functions {of}", lambda: tabulate_functions(name, posterior, y, rng), no_tables)
    more = partial(_tabulate_errors, inputs, variant, posterior, some, rng, own)
    tables = tables | attempt(f"errors {of}", more, no_tables)
    pack = partial(_pack, subject, fit, name, known)
    packed = attempt(f"the posterior's file {of}", pack, fit.drop(ONLY_SAVED))
    with stage("held-back poses"):
        hold = partial(split_verification, inputs, (name, 0), (posterior, fit.kept))
        is_held = variant.verification.any()
        held = attempt(f"the held-back poses {of}", lambda: [hold()] if is_held else [], list[FoldPrediction]())
    with stage("accuracy"):
        learnt = partial(learn_posterior, variant, machine)
        know = partial(_assess, inputs, variant, posterior, y, learnt)
        knowledge = attempt(f"what the data tell {of}", know, None)
        poses = attempt(f"the errors of poses {of}", lambda: _predict_poses(variant, posterior, y, own), None)
        beside = partial(_tabulate_beside, inputs.beside, variant, posterior.theta(y))
        mean = dict(zip(fit.names, fit.mean, strict=True))
        compare = partial(tabulate_before_after, variant, poses, mean, own)
        require = partial(tabulate_requirements, config, variant, machine, y, config.seed)
        verdicts = ("",) * posterior.n_geometry if knowledge is None else knowledge.verdicts
        tables |= {
            "parameters": tabulate_parameters(variant, fit, verdicts),
            "before_after": attempt(f"before and after {of}", compare, none),
            "requirements": attempt(f"the requirements {of}", require, none),
            **_tabulate_residuals(variant, _explain(posterior, fit), fit),
            **({} if knowledge is None else knowledge.tabulate()),
            "reference_values": attempt(f"values from elsewhere {of}", beside, none),
            "pose_errors": none if poses is None else tabulate_pose_errors(variant, poses),
        }
    tables = {key: table for key, table in tables.items() if not table.empty}
    return ReadingFit(**vars(packed), tables=tables, held=held, poses=poses)


def _describe_accuracy(inputs: ReadingInputs, variant: Variant, posterior: CalibrationPosterior, y: Array) -> str:
    """Return in words how accurate the tool is by draws (T, n)."""
    with np.errstate(all="ignore"):
        found = forecast_accuracy(variant, posterior, MachineInUse.find(posterior, y), inputs.config.seed)
    shown = inputs.config.units.model_dump()
    amounts = {name: format_amount(sd, unit, 2, shown) for name, unit, sd in found if np.isfinite(sd)}
    return f"tool {say_accuracy(amounts)}" if amounts else ""


def _tabulate_errors(
    inputs: ReadingInputs,
    variant: Variant,
    posterior: CalibrationPosterior,
    some: Array,
    rng: np.random.Generator,
    own: np.random.Generator,
) -> dict[str, pd.DataFrame]:
    """Return the tables of what draws (T, n) have of errors common to all rows, and of the model error."""
    config, name = inputs.config, variant.name
    with np.errstate(all="ignore"):
        drawn = posterior.likelihood.draw_common(*posterior.at(some), rng)
    terms = config.leg_error.of(variant.config.model_error)
    found = {ERRORS: tabulate_errors(config, variant, posterior, some, drawn)}
    return found | tabulate_model_error(name, variant.data, variant.verification, posterior, some, drawn, terms, own)


def _pack(subject: ReadingSubject, fit: Fit, name: str, known: Sequence[KnownFunctions | None]) -> Fit:
    return fit.pack(subject.build_tree(fit, name, known), ONLY_SAVED)


def _assess(
    inputs: ReadingInputs,
    variant: Variant,
    posterior: CalibrationPosterior,
    y: Array,
    learn: Callable[[], Learnt],
) -> IdentifiabilityResult:
    return compute_tool_uncertainty(inputs.config, variant, posterior, y.mean(axis=0), learn())


def _predict_poses(
    variant: Variant, posterior: CalibrationPosterior, y: Array, rng: np.random.Generator
) -> Prediction | None:
    """Return how far poses that an instrument saw lie from where the machine's own channels have them."""
    seen, internal = find_seen(variant.model), variant.internal
    told = (variant.data.present[:, internal].sum(axis=1) >= len(variant.model.coordinates)).all()
    if all(one is None for one in seen[:3]) or not told or not len(variant.model.coordinates):
        return None
    every, some = np.ones(variant.data.n_poses, dtype=bool), y[spread(len(y), POSE_DRAWS)]
    with np.errstate(all="ignore"):
        found = predict_poses(posterior, variant.likelihood(every), some, rng, internal, seen, y)
        for other in list_seen(variant.model)[1:]:  # another target, or instrument, saw poses that the first did not
            unseen = np.isnan(found.error).all(axis=1)
            if (unseen & variant.data.present[:, [k for k in other if k is not None]].any(axis=1)).any():
                more = predict_poses(posterior, variant.likelihood(every), some, rng, internal, other, y)
                found = found.fill(more, unseen)
    return found if np.isfinite(found.error).any() else None


@dataclass(frozen=True, eq=False)
class ReadingSubject(PosteriorProblem):
    """A posterior of readings."""

    density: CalibrationPosterior
    factors: Sequence[float] = ()  # on the widths of all priors, whose evidences are wanted, too
    describe: Callable[[CalibrationPosterior, Array], str] = lambda posterior, y: ""  # of a preliminary answer's draws

    @property
    def posterior(self) -> CalibrationPosterior:
        """The posterior."""
        return self.density

    def evaluate(self, posterior: LogPosterior, y: Array, seed: np.random.SeedSequence) -> Arrays:
        """Return the rows' log-densities (E, S, P), and the readings that some draws predict, (E, S', P, K)."""
        flat, own = y.reshape(-1, y.shape[-1]), cast("CalibrationPosterior", posterior)
        density = own.pointwise(flat)
        some = self._thin(y)
        made = replicate_readings(own, some.reshape(-1, y.shape[-1]), np.random.default_rng(seed))
        replicated = made.reshape(*some.shape[:2], *made.shape[1:]).astype(np.float32)
        found: dict[str, Any] = {"log_likelihood": density.reshape(*y.shape[:2], -1), "replicated": replicated}
        return found

    def _thin(self, values: Array) -> Array:
        """Return what is of the draws that predict, from something of all, (E, S, ...)."""
        n_draws = values.shape[0] * values.shape[1]
        return values[:, :: -(-n_draws // limit_draws(n_draws, self.posterior.likelihood.data.values.size))]

    def replicate_prior(self, posterior: LogPosterior, seed: np.random.SeedSequence) -> Arrays:
        """Return draws of the prior that are machines, (T, n), and their readings at the expected poses (T, P, K)."""
        own, rng = cast("CalibrationPosterior", posterior), np.random.default_rng(seed)
        y = own.draw_prior(limit_draws(PRIOR_READINGS, own.likelihood.data.values.size), rng)
        with np.errstate(all="ignore"):
            made = replicate_readings(own, y, rng, own.likelihood.start)
        there = np.isfinite(made).all(axis=(1, 2), where=own.likelihood.data.present)
        return {"prior": own.natural(y[there]), "prior_replicated": made[there].astype(np.float32)}

    def find_costly(self, exploration: Exploration) -> CostlyDensity | None:
        """Return the density that leaves nothing out, where a fast form of it was explored that differs."""
        explored = cast("CalibrationPosterior", exploration.straight.posterior)
        if explored.likelihood.frozen is not None:
            return weigh_beside(explored, exploration) if exploration.left_out > MAX_FROZEN_ERROR_NAT else None
        return None if explored.likelihood.lone is None else weigh_beside(explored, exploration)

    def say_first(self, posterior: LogPosterior, y: Array) -> str:
        """Return the tool's accuracy as a preliminary answer has it."""
        return self.describe(cast("CalibrationPosterior", posterior), y)

    def vary_priors(self, posterior: LogPosterior) -> Mapping[float, LogPosterior]:
        """Return the posterior with priors wider or narrower by each factor."""
        own = cast("CalibrationPosterior", posterior)
        return {k: replace(own, priors={name: widen(one, k) for name, one in own.priors.items()}) for k in self.factors}

    def measure_misfit(self, posterior: LogPosterior, mode: Array) -> ChiSquare:
        """Return χ² of what no pose explains at the mode (n,)."""
        own = cast("CalibrationPosterior", posterior)
        m, (theta, change) = own.n_geometry, own.around(mode)
        white, slope = own.likelihood.reduced_rows(theta, change, own.errors, own.zeta(mode))
        n = slope.shape[-1]  # the geometry, then coefficients of errors common to all rows, whose prior is N(0, 1)
        prior, prior_slope = np.zeros(n), np.eye(n)
        prior[:m], prior_slope[:m, :m] = own.sampling.prior_residual(mode[:m], theta), own.sampling.prior_slope(change)
        return fit_rows(white, slope, prior, prior_slope, int(own.likelihood.n_spare.sum()))[1]

    def build_tree(self, fit: Fit, variant: str, functions: Sequence[KnownFunctions | None]) -> xr.DataTree:
        """Return the fit with draws of its prior, what both predict, the data, and what is known of functions.

        The latter of each solution; to which of several a draw belongs is a variable of its own, from 1.
        """
        import xarray as xr

        likelihood, arrays = self.posterior.likelihood, fit.evaluated
        channels = likelihood.model.channels
        factor, units = find_units(likelihood.model, fit.names, fit.units)
        draws, density, rows = (self._thin(one) for one in (fit.draws, fit.log_density, arrays["log_likelihood"]))
        priors, data = self.posterior.all_priors().values(), likelihood.data
        log_prior = np.stack([prior.log_density(draws[..., k]) for k, prior in enumerate(priors)], axis=-1)
        log_prior -= np.log(factor)
        stats: Variables = {"lp": ((), density, "nat", "log-density, proposal coordinates")}
        if len(fit.solutions.probability) > 1:
            label = 1 + self._thin(fit.solutions.label)
            stats = {**stats, MODE: ((), label, "1", "solution of a draw, from 1")}
        readings = ReadingLayout(
            tuple(data.poses), tuple(one.name for one in channels), tuple(one.unit for one in channels), data.present
        )
        found = {
            "posterior": split_parameters(fit.names, factor * draws, units),
            "sample_stats": make_dataset(stats, drawn=True),
            "log_prior": split_parameters(fit.names, log_prior, ["nat"] * len(fit.names)),
            "prior": split_parameters(fit.names, factor * arrays["prior"][None], units),
            **readings.arrange(data.values, arrays["replicated"], arrays["prior_replicated"][None], rows),
        }
        for k, known in enumerate(functions, start=1):
            if known is not None:
                names = {"channel": list(known.names), "sort": list(known.sorts)}
                names["parameter"] = list(self.posterior.sampling.names)
                found[name_functions(k)] = make_dataset(known.list_arrays(), names)
        tree = xr.DataTree.from_dict(found)
        tree.attrs = {"variant": variant}
        return tree


def weigh_beside(explored: CalibrationPosterior, exploration: Exploration) -> CostlyDensity:
    """Return the density of a posterior that leaves nothing out, beside the fast form that was explored."""
    straight, whole = exploration.straight, explored.likelihood.whole

    def excess(x: Array) -> Array:
        at = explored.at(straight.y_from_x(x))
        with np.errstate(invalid="ignore"):
            found = whole.density(*at) - explored.likelihood.density(*at)
        return np.where(np.isfinite(found), found, -np.inf)

    if explored.likelihood.frozen is not None:  # which tells of the geometry what the whole does
        return CostlyDensity(straight.log_density, excess, np.zeros((explored.n_parameters,) * 2))
    # what the whole density knows of the geometry more; of the errors it is taken to know the same
    y = exploration.modes[0].y
    (theta, change), zeta = explored.around(y), explored.zeta(y)
    lone = explored.likelihood.lone
    assert lone is not None
    more = whole.inform(theta, change, explored.errors, zeta)
    more = more - lone.inform(explored.likelihood, theta, change, explored.errors, zeta)
    return CostlyDensity(straight.log_density, excess, pull_back(straight, y, more))


def _explain(posterior: CalibrationPosterior, fit: Fit) -> Residuals:
    """Return the residuals of the best machine at the calibration poses."""
    likelihood, mode = posterior.likelihood, fit.mode[None]
    zeta, (white, stand) = posterior.zeta(mode), likelihood.explain(*posterior.at(mode))
    (own, tau), tails = likelihood.noise(posterior.errors, zeta), posterior.errors.tails(zeta)
    given = {key: value[None] for key, value in likelihood.data.given.items()}
    read = likelihood.model.read(posterior.theta(mode)[:, None], stand.pose, given)
    residual = likelihood.residuals(*posterior.at(mode))
    common = white.colour(stand.error - residual)  # what errors common to all rows explain beyond the pose
    left = (likelihood.comparison.subtract(likelihood.data.values, read) - common)[0]
    square = np.einsum("pk,pk->p", residual[0], residual[0])
    return Residuals(
        stand.pose[0],
        np.where(likelihood.data.present, left, np.nan),
        np.sqrt(own[0] ** 2 + tau[0] ** 2) * np.ones_like(left),
        square,
        tails.trust(square[None], likelihood.n_spare)[0],
        likelihood.n_readings - stand.pose.shape[-1],
    )


def list_folds(inputs: ReadingInputs, variant: Variant) -> list[np.ndarray]:
    """Return which poses are held back together, masks (P,): those for verification, or random folds of all."""
    n, folds = variant.data.n_poses, inputs.config.validation.folds
    if variant.verification.any():
        return [variant.verification]
    order = np.random.default_rng([inputs.config.seed, 6]).permutation(n)
    return [np.isin(np.arange(n), order[k::folds]) for k in range(min(folds, n))]


def split_verification(
    inputs: ReadingInputs, task: tuple[str, int], known: tuple[CalibrationPosterior, Array] | None = None
) -> FoldPrediction:
    """Return how the held-back poses of a variant's fold are predicted from the others.

    Where these are the poses for verification, ``known`` is the posterior that was fitted already, with draws (T, n).
    """
    variant, fold = inputs.variants[task[0]], task[1]
    held = list_folds(inputs, variant)[fold]
    effort = inputs.config.validation.draws
    seeds = np.random.SeedSequence([inputs.config.seed, 7, fold, zlib.crc32(variant.name.encode())])
    first, second = seeds.spawn(2)
    rng = np.random.default_rng(second)
    efficiency, pareto_k = 1.0, float("nan")
    if known is None:
        posterior = variant.posterior(~held).with_pose_guesses()
        found = explore(posterior, first, inputs.config.sampler.walkers, max_pilots=0)  # draws are weighed anyway
        drawn = resample(found.straight.log_density, found.proposal, rng, PROPOSED * effort, effort)
        y, efficiency, pareto_k = found.straight.y_from_x(drawn.draws), drawn.efficiency, drawn.pareto_k
    else:
        posterior, every = known
        y = every[np.linspace(0, len(every) - 1, min(effort, len(every))).astype(int)]
    likelihood = variant.likelihood(held)
    with np.errstate(all="ignore"):
        elpd = compute_elpd(posterior.predict_density(likelihood, y))
        predictions, tool = predict_readings_by(posterior, likelihood, y, rng, [None, variant.internal])
    return FoldPrediction(np.flatnonzero(held), elpd, efficiency, pareto_k, predictions, tool)


def describe_readings(
    inputs: StudyInputs, found: Mapping[str, ReadingFit], run: Run
) -> tuple[dict[str, Summary], dict[str, pd.DataFrame], Summary]:
    """Return each variant's entry of the summary, the tables of all, and further entries of the summary.

    Folds are predicted in tasks.
    """
    folds = {
        f"{name} {fold + 1}": (name, fold)
        for name, variant in inputs.variants.items()
        if not variant.verification.any()
        for fold in range(len(list_folds(inputs, variant)))
    }
    predicted = (
        run.map("held-back poses", split_verification, inputs, folds, (FoldPrediction,), spare=True) if folds else {}
    )
    every: list[tuple[Variant, ReadingFit, list[FoldPrediction]]] = []
    for name, fit in found.items():
        own = [predicted[task] for task, (owner, _) in folds.items() if owner == name and task in predicted]
        every.append((inputs.variants[name], fit, [*fit.held, *own]))
    rows = pd.DataFrame([_describe(*one) for one in every])
    compared = tabulate_comparison(rows, {name: fit.left_out for name, fit in found.items()})
    variants = VariantRow.tabulate(**{str(name): compared[name] for name in compared})
    names = dict.fromkeys(name for fit in found.values() for name in fit.tables)
    tables = {
        "variants": variants,
        **{name: join_tables(fit.tables[name] for fit in found.values() if name in fit.tables) for name in names},
        "predictions": join_tables(tabulate_predictions(variant, held) for variant, _, held in every),
        "not_predicted": join_tables(tabulate_lost(variant, held) for variant, _, held in every),
        "tool_predictions": join_tables(
            tabulate_predictions(variant, held, of_tool=True) for variant, _, held in every
        ),
        "tau_scale": attempt(
            "other scales of the model error", lambda: tabulate_tau_scale(inputs, found), pd.DataFrame()
        ),
        **attempt("joints and flexures", lambda: tabulate_legs(inputs), dict[str, pd.DataFrame]()),
    }
    known = {str(row.pop("variant")): plain(row) for row in variants.to_dict("records")}
    for row in tables["requirements"].to_dict("records") if "requirements" in tables else ():
        one = plain(row)
        known[str(row["variant"])].setdefault("requirements", {})[str(one["requirement"])] = one["probability"]
    for variant, fit, _ in every:
        known[variant.name] |= {"calibration": None, "verification": None}
        if fit.poses is not None:
            known[variant.name] |= describe_errors(variant, fit.poses)[1]
        known[variant.name] |= describe_solutions(variant.model, fit)
    gains = attempt("gains of channels", lambda: find_gains(next(iter(inputs.variants.values())).whole), None)
    summary = {
        **describe_legs(inputs),
        "member": next(iter(inputs.variants.values())).model.member,
        "states_tool": all(one.model.states_tool for one in inputs.variants.values()),
        "gains": gains,
        **({"column_units": dict(inputs.units)} if inputs.units else {}),
        **({"found": inputs.found} if inputs.found else {}),
        **({} if all(has_lengths(one.model) for one in inputs.variants.values()) else {"model_error_in": "noise"}),
        **({"region": "measured"} if any(one.measured for one in inputs.variants.values()) else {}),
        **({"unused": inputs.unused} if inputs.unused else {}),
        **({"missing_terms": inputs.missing} if inputs.missing else {}),
    }
    return known, {name: table for name, table in tables.items() if not table.empty}, summary


def _describe(variant: Variant, fit: ReadingFit, held: list[FoldPrediction]) -> Summary:
    """Return a variant's row of the table of variants."""
    poses, predictions = fit.tables["poses"], tabulate_predictions(variant, held)
    n_equations = int(poses["n_dof"].sum())
    freedom = n_equations - len(fit.names)
    row: Summary = {
        "variant": variant.name,
        "title": title_variant(variant.config, variant.whole),
        "data_set": name_data(variant),
        "has_outliers": variant.config.outliers.expected,
        "n_poses": len(poses),
        "n_equations": n_equations,
        "n_parameters": len(fit.names),
        **fit.describe_evidence(),
        "misfit_chi2": fit.misfit.value,
        "misfit_dof": fit.misfit.dof,
        "prior_chi2": fit.pulls.value,
        "prior_dof": fit.pulls.dof,
        **fit.describe_chains(),
        "elpd": sum(one.elpd for one in held) if held else float("nan"),
        "reduced_chi": float(np.sqrt(poses["chi2"].to_numpy().sum() / freedom)) if freedom > 0 else float("nan"),
    }
    if fit.poses is not None:
        row |= describe_errors(variant, fit.poses)[0]
    row["distance_from_nominal_mm"] = _measure_distance(variant, fit)
    row["distance_from_nominal_prior_sd"] = fit.pulls.factor
    if fit.correction is not None:
        row |= {
            "linearisation_log_shift": fit.correction.log_ratio,
            "linearisation_log_shift_se": fit.correction.standard_error,
            "linearisation_efficiency": float(fit.correction.efficiency),
            "linearisation_pareto_k": float(fit.correction.pareto_k),
        }
    if not predictions.empty:
        own = predictions[~predictions["external"]]
        row |= {
            "n_verification_readings": len(own),
            "coverage_90": float(own["in_interval_90"].mean()) if len(own) else float("nan"),
        }
    return row


def _measure_distance(variant: Variant, fit: ReadingFit) -> float:
    """Return how far the lengths of the machine moved from nominal, rms, mm."""
    layout = variant.model.layout
    own = [(k, name) for k, name in enumerate(fit.names) if name in layout.names and fit.units[k] == "mm"]
    moved = [fit.mean[k] - layout.nominal[layout.names.index(name)] for k, name in own]
    return float(np.sqrt(np.mean(np.square(moved)))) if moved else 0.0


def _tabulate_residuals(variant: Variant, left: Residuals, fit: Fit) -> dict[str, pd.DataFrame]:
    """Return the residuals of each reading that the posterior has seen, and of each pose."""
    data = variant.data.pick(~variant.verification)
    rows, places = np.nonzero(data.present)
    channels = [variant.model.channels[k] for k in places]
    residuals = ResidualRow.tabulate(
        variant=variant.name,
        pose=[data.poses[k] for k in rows],
        channel=[one.name for one in channels],
        unit=[one.unit for one in channels],
        measured=data.values[rows, places],
        residual=left.left[rows, places],
        noise=left.noise[rows, places],
    )
    poses = PoseRow.tabulate(
        {f"{one.name}_{one.unit}": left.pose[:, k] for k, one in enumerate(variant.model.coordinates)},
        variant=variant.name,
        pose=list(data.poses),
        elpd_loo=fit.left_out.elpd,
        pareto_k=fit.left_out.pareto_k,
        loo_refitted=fit.left_out.was_refitted.astype(bool),
        n_dof=left.freedom,
        chi2=left.square,
        p_value=left.chance,
        robust_weight=left.trust,
        is_outlier=left.find_contradicting(variant.config.outliers.expected),
    )
    return {"residuals": residuals, "poses": poses}


def tabulate_lost(variant: Variant, held: list[FoldPrediction]) -> pd.DataFrame:
    """Return the held-back readings that have no prediction, with the reason."""
    channels = variant.model.channels
    return NotPredictedRow.collect(
        NotPredictedRow(
            variant=variant.name,
            pose=variant.data.poses[one.rows[pose]],
            channel=channels[k].name,
            external=channels[k].external,
            reason=reason,
        )
        for one in held
        for pose, k, reason in one.predictions.lost
    )


def tabulate_predictions(variant: Variant, held: list[FoldPrediction], of_tool: bool = False) -> pd.DataFrame:
    """Return each held-back reading with its prediction; ``of_tool`` by the machine's own readings alone."""
    tables = []
    for one in held:
        found = one.tool if of_tool else one.predictions
        channels = [variant.model.channels[k] for k in found.channel]
        table = (ToolPredictionRow if of_tool else PredictionRow).tabulate(
            variant=variant.name,
            pose=[variant.data.poses[k] for k in one.rows[found.pose]],
            channel=[channel.name for channel in channels],
            external=[channel.external for channel in channels],
            unit=[channel.unit for channel in channels],
            measured=found.measured,
            mean=found.mean,
            sd=found.sd,
            low=found.low,
            high=found.high,
            in_interval_90=found.inside,
        )
        tables.append(table)
    return join_tables(tables)


def _tabulate_beside(sources: Iterable[ReferenceValues], variant: Variant, theta: Array) -> pd.DataFrame:
    """Return what machines (T, D) make of values from elsewhere, but of what is held fixed without a deviation."""
    tables = []
    for source in sources:
        values = source.evaluate(variant.whole, theta)
        table = ReferenceRow.tabulate(
            variant=variant.name,
            reference=source.title,
            source=source.source,
            quantity=source.quantities,
            unit=source.units,
            mean=values.mean(axis=0),
            sd=values.std(axis=0),
            value=source.values,
            value_sd=source.sd,
        )
        is_fixed = (np.ptp(values, axis=0) == 0.0) & np.isnan(source.sd)
        tables.append(table[~is_fixed])
    return join_tables(tables)
