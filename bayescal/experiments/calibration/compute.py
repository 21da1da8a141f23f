"""Computing a calibration: every variant's posterior, and what it predicts of readings held back."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from functools import partial

import numpy as np
import pandas as pd

from bayescal.experiments.calibration.calibrated import ERRORS, keep_machine, tabulate_errors
from bayescal.experiments.calibration.fit import Fit, fit_variant
from bayescal.experiments.calibration.inputs import CalibrationInputs
from bayescal.experiments.calibration.knowledge import Knowledge, assess
from bayescal.experiments.calibration.tables import Findings, Residuals, summarise, tabulate
from bayescal.experiments.calibration.validation import Held, hold_back, list_folds
from bayescal.experiments.frame.parallel import Run
from bayescal.experiments.frame.results import Results, Writer
from bayescal.experiments.shared.reading_slips import find_calibration_slip
from bayescal.experiments.shared.reading_trees import build_reading_tree
from bayescal.experiments.shared.trees import name_file, write_tree
from bayescal.numerics.geometry import Array


@dataclass(frozen=True, eq=False)
class _Fitted:
    """What one task of a variant finds; its verification where poses are kept for that."""

    fit: Fit
    residuals: Residuals
    knowledge: Knowledge
    beside: list[Array]
    held: list[Held]
    errors: pd.DataFrame


def compute_calibration(inputs: CalibrationInputs, run: Run) -> Results:
    """Return what is found for all variants."""
    names = {name: name for name in inputs.variants}
    fitted = run.map("variants", _compute_variant, inputs, names, (_Fitted,))
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
    tables = tabulate(inputs, found)
    tables[ERRORS] = pd.concat([one.errors for one in fitted.values()], ignore_index=True)
    summary = summarise(inputs, tables)
    slip = find_calibration_slip(one.suspicion() for one in inputs.variants.values())
    summary |= {} if slip is None else {"slip": asdict(slip)}
    return Results(summary, tables, {**_list_files(inputs, found), **keep_machine(inputs)})


def _list_files(inputs: CalibrationInputs, found: dict[str, Findings]) -> dict[str, Writer]:
    """Return what writes the variants' posteriors."""
    files = {}
    for name, one in found.items():
        variant, fit = inputs.variants[name], one.fit
        poses = [pose for pose, held in zip(variant.data.poses, variant.verification, strict=True) if not held]
        files[name_file(name)] = write_tree(partial(build_reading_tree, fit.saved, fit.names, fit.units, poses, name))
    return files


def _compute_variant(inputs: CalibrationInputs, name: str) -> _Fitted:
    variant = inputs.variants[name]
    fit = fit_variant(inputs, variant)
    posterior = variant.posterior()
    covariance = np.atleast_2d(np.cov(fit.kept[:, : posterior.n_geometry], rowvar=False))
    held = [hold_back(inputs, variant, 0, fit.kept)] if variant.verification.any() else []
    return _Fitted(
        fit,
        _explain(inputs, name, fit),
        assess(inputs.config, variant, posterior.anchored(), fit.kept.mean(axis=0), covariance),
        [one.evaluate(variant.whole, posterior.theta(fit.kept)) for one in inputs.beside],
        held,
        tabulate_errors(inputs.config, variant, fit.kept),
    )


def _explain(inputs: CalibrationInputs, name: str, fit: Fit) -> Residuals:
    """Return what the best machine leaves of the readings at the calibration poses."""
    variant = inputs.variants[name]
    posterior = variant.posterior().anchored()
    white, stand = posterior.stand(fit.mode[None])
    own, tau = posterior.deviations(fit.mode[None])
    likelihood, outliers = posterior.likelihood, posterior.errors.outliers
    given = {key: value[None] for key, value in likelihood.data.given.items()}
    read = likelihood.model.read(posterior.theta(fit.mode[None])[:, None], stand.pose, given)
    residual = posterior.residuals(fit.mode[None])
    common = white.colour(stand.error - residual.error)  # what errors common to all rows explain beyond the pose
    left = (likelihood.comparison.subtract(likelihood.data.values, read) - common)[0]
    square = np.einsum("pk,pk->p", residual.error[0], residual.error[0])
    return Residuals(
        stand.pose[0],
        np.where(likelihood.data.present, left, np.nan),
        np.sqrt(own[0] ** 2 + tau[0] ** 2) * np.ones_like(left),
        square,
        outliers.trust(square, likelihood.n_spare),
        likelihood.n_readings - stand.pose.shape[-1],
    )


def _compute_fold(inputs: CalibrationInputs, task: tuple[str, int]) -> Held:
    name, fold = task
    return hold_back(inputs, inputs.variants[name], fold)
