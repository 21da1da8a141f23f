"""Computing a calibration: every variant's posterior, and what it predicts of readings held back."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial

import numpy as np
import pandas as pd

from bayescal.density.calibration.likelihood import CalibrationPosterior
from bayescal.experiments.frame.parallel import Run
from bayescal.experiments.frame.results import Results, Writer
from bayescal.experiments.shared.estimate import TREE, Fit
from bayescal.experiments.shared.measured_slips import find_calibration_slip
from bayescal.experiments.shared.prior_widths import WidthTask, begin_widths, tabulate_widths, weigh_widths
from bayescal.experiments.shared.reading_fit import ReadingFit, ReadingSubject, fit_readings
from bayescal.experiments.shared.readings.inputs import ReadingInputs
from bayescal.experiments.shared.readings.knowledge import Knowledge, assess
from bayescal.experiments.shared.trees import name_file, write_packed
from bayescal.experiments.study.calibrated_readings import ERRORS, keep_machine, tabulate_errors
from bayescal.experiments.study.reading_tables import Findings, Residuals, summarise, tabulate
from bayescal.experiments.study.validation import Held, hold_back, list_folds
from bayescal.inference.importance import ImportanceEvidence
from bayescal.inference.stages import stage
from bayescal.numerics.geometry import Array


@dataclass(frozen=True, eq=False)
class _Fitted:
    """What one task of a variant finds; its verification where poses are kept for that."""

    fit: ReadingFit
    residuals: Residuals
    knowledge: Knowledge
    beside: list[Array]
    held: list[Held]
    errors: pd.DataFrame


def compute_calibration(inputs: ReadingInputs, run: Run) -> Results:
    """Return what is found for all variants."""
    names = {name: name for name in inputs.variants}
    fitted, factors = run.map("variants", _compute_variant, inputs, names, (_Fitted,)), inputs.config.sensitivity.factor
    fits = {name: one.fit for name, one in fitted.items()}
    await_widths = begin_widths(_weigh, inputs, fits, factors, run)
    folds = {
        f"{name} {fold + 1}": (name, fold)
        for name, variant in inputs.variants.items()
        if not variant.verification.any()
        for fold in range(len(list_folds(inputs, variant)))
    }
    held = run.map("held-back poses", _compute_fold, inputs, folds, (Held,)) if folds else {}
    found = {
        name: Findings(
            one.fit,
            one.residuals,
            one.knowledge,
            one.beside,
            [*one.held, *(held[task] for task, (owner, _) in folds.items() if owner == name)],
        )
        for name, one in fitted.items()
    }
    tables, widths = tabulate(inputs, found), await_widths()
    tables[ERRORS] = pd.concat([one.errors for one in fitted.values()], ignore_index=True)
    if widths:
        tables["sensitivity"] = tabulate_widths(fits, widths, factors)
    summary = summarise(inputs, tables)
    slip = find_calibration_slip(one.suspicion() for one in inputs.variants.values())
    summary |= {} if slip is None else {"slip": slip.record()}
    return Results(summary, tables, {**_list_files(fits), **keep_machine(inputs)})


def _list_files(fits: Mapping[str, Fit]) -> dict[str, Writer]:
    """Return what writes the variants' posteriors."""
    return {name_file(name): partial(write_packed, fit.evaluated[TREE]) for name, fit in fits.items()}


def _compute_variant(inputs: ReadingInputs, name: str) -> _Fitted:
    variant, config = inputs.variants[name], inputs.config
    posterior = variant.posterior().anchored()
    fit = fit_readings(posterior, config.seed, name, config.sampler, config.evidence)
    covariance = np.atleast_2d(np.cov(fit.kept[:, : posterior.n_geometry], rowvar=False))
    with stage("held-back poses"):
        held = [hold_back(inputs, variant, 0, fit.kept)] if variant.verification.any() else []
    with stage("accuracy"):
        return _Fitted(
            fit,
            _explain(posterior, fit),
            assess(config, variant, posterior, fit.kept.mean(axis=0), covariance),
            [one.evaluate(variant.whole, posterior.theta(fit.kept)) for one in inputs.beside],
            held,
            tabulate_errors(config, variant, fit.kept),
        )


def _weigh(inputs: ReadingInputs, task: WidthTask) -> ImportanceEvidence:
    variant, config = inputs.variants[task.variant], inputs.config
    subject = ReadingSubject(variant.posterior(factor=task.factor).anchored())
    return weigh_widths(subject, variant.posterior(), task, config.seed, config.sampler, config.evidence)


def _explain(posterior: CalibrationPosterior, fit: Fit) -> Residuals:
    """Return the residuals of the best machine at the calibration poses."""
    white, stand = posterior.likelihood.explain(*posterior.at(fit.mode[None]))
    own, tau = posterior.likelihood.noise(posterior.errors, posterior.zeta(fit.mode[None]))
    likelihood, tails = posterior.likelihood, posterior.errors.tails(posterior.zeta(fit.mode[None]))
    given = {key: value[None] for key, value in likelihood.data.given.items()}
    read = likelihood.model.read(posterior.theta(fit.mode[None])[:, None], stand.pose, given)
    residual = posterior.likelihood.residuals(*posterior.at(fit.mode[None]))
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


def _compute_fold(inputs: ReadingInputs, task: tuple[str, int]) -> Held:
    name, fold = task
    return hold_back(inputs, inputs.variants[name], fold)
