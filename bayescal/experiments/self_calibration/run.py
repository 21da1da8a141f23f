"""Running a self-calibration: its posteriors, tables, figures and page, put in place as a whole."""

from __future__ import annotations

import zlib
from pathlib import Path

import joblib
import numpy as np

from bayescal.density.readings.calibrability import compute_calibrability
from bayescal.errors import NotConvergedError
from bayescal.experiments.frame.run import publish
from bayescal.experiments.frame.store import Store
from bayescal.experiments.self_calibration.blunders import check_readings
from bayescal.experiments.self_calibration.fit import fit_variant
from bayescal.experiments.self_calibration.identifiability import audit_variant
from bayescal.experiments.self_calibration.inputs import ReadingInputs, Variant, read_inputs
from bayescal.experiments.self_calibration.page.pages import build_page, list_variants
from bayescal.experiments.self_calibration.schema import SelfCalibrationConfig
from bayescal.experiments.self_calibration.tables import Outcome, summarise, tabulate
from bayescal.experiments.self_calibration.tool import assess_tool, predict_tool

DIGITS = 9


def run_self_calibration(config: SelfCalibrationConfig, folder: Path, out: Path, workers: int = 1) -> str:
    """Run an experiment, put its results in ``out`` and return them in a few lines.

    Parameters
    ----------
    config : SelfCalibrationConfig
    folder : Path
        Where the config's file names start.
    out : Path
        Directory for the results; all of them or nothing.
    workers : int
        Processes; the results do not depend on it.

    Raises
    ------
    InputError
        For anything at fault in the config or its files, or where ``out`` holds results of another config.
    NotConvergedError
        Where a posterior did not converge; the results are written all the same.
    """
    inputs = read_inputs(config, folder)
    check_readings(inputs, folder / config.data.readings)
    identity, store = inputs.identity(), Store(out)
    store.check_results(identity)
    outcomes = compute_outcomes(inputs, workers)
    tables = tabulate(inputs, outcomes)
    summary = summarise(inputs, outcomes, tables)
    page = build_page(tables, summary)
    said = publish(store, identity, tables, summary, page, DIGITS)
    text = "\n".join([said, *list_variants(tables)])
    if not summary["converged"]:
        raise NotConvergedError(
            f"{out}: not everything converged, see the report; the results are written all the same", text
        )
    return text


def compute_outcomes(inputs: ReadingInputs, workers: int = 1) -> dict[str, Outcome]:
    """Return what is found for each variant."""
    variants = list(inputs.variants.values())
    if workers == 1 or len(variants) == 1:
        found = [compute_outcome(inputs, variant) for variant in variants]
    else:
        parallel = joblib.Parallel(n_jobs=workers, inner_max_num_threads=1)
        found = list(parallel(joblib.delayed(compute_outcome)(inputs, variant) for variant in variants))
    return {variant.name: outcome for variant, outcome in zip(variants, found, strict=True)}


def compute_outcome(inputs: ReadingInputs, variant: Variant) -> Outcome:
    """Return everything about one variant; an audit where nothing is fixed that could be free."""
    fit = fit_variant(inputs, variant)
    held = inputs.table.verification
    rng = np.random.default_rng([inputs.config.seed, 3, zlib.crc32(variant.name.encode())])
    return Outcome(
        fit,
        predict_tool(inputs, variant, fit, rng) if held.any() else None,
        assess_tool(inputs, variant, fit),
        compute_calibrability(variant.sensors, variant.free, variant.pose[~held], variant.together),
        audit_variant(inputs, variant) if variant.config.is_plain else None,
    )
