"""Computing a self-calibration: everything about each of its variants."""

from __future__ import annotations

import zlib
from functools import partial

import numpy as np

from bayescal.experiments.frame.parallel import Run
from bayescal.experiments.frame.results import Results
from bayescal.experiments.self_calibration.blunders import list_denied
from bayescal.experiments.self_calibration.fit import fit_variant
from bayescal.experiments.self_calibration.identifiability import audit_variant
from bayescal.experiments.self_calibration.inputs import ReadingInputs
from bayescal.experiments.self_calibration.tables import VariantFindings, summarise, tabulate
from bayescal.experiments.self_calibration.tool import assess_tool, predict_tool
from bayescal.experiments.shared.calibrability import compute_calibrability
from bayescal.experiments.shared.estimate import TREE
from bayescal.experiments.shared.trees import name_file, write_packed


def compute_self_calibration(inputs: ReadingInputs, run: Run) -> Results:
    """Return the posteriors of all variants, what they say of the tool, and what the sensors can tell."""
    found = compute_variants(inputs, run)
    tables = tabulate(inputs, found)
    summary, denied = summarise(inputs, found, tables), list_denied(inputs)
    summary |= {"denied_slips": denied} if denied else {}
    files = {name_file(name): partial(write_packed, one.fit.evaluated[TREE]) for name, one in found.items()}
    return Results(summary, tables, files)


def compute_variants(inputs: ReadingInputs, run: Run) -> dict[str, VariantFindings]:
    """Return what is found for each variant."""
    names = {name: name for name in inputs.variants}
    return run.map("variants", compute_variant, inputs, names, (VariantFindings,))


def compute_variant(inputs: ReadingInputs, name: str) -> VariantFindings:
    """Return everything about one variant; an audit where nothing is fixed that could be free."""
    variant = inputs.variants[name]
    fit = fit_variant(inputs, variant)
    held = inputs.table.verification
    rng = np.random.default_rng([inputs.config.seed, 3, zlib.crc32(name.encode())])
    return VariantFindings(
        fit,
        predict_tool(inputs, variant, fit, rng) if held.any() else None,
        assess_tool(inputs, variant, fit),
        compute_calibrability(variant.sensors, variant.free, variant.pose[~held], variant.together),
        audit_variant(inputs, variant) if variant.config.is_plain else None,
    )
