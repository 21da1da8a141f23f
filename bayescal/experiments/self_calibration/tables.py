"""Results of a self-calibration as tables and as a summary of plain numbers."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd

from bayescal.experiments.self_calibration.fit import VariantFit
from bayescal.experiments.self_calibration.identifiability import Identifiability
from bayescal.experiments.self_calibration.inputs import ReadingInputs, Variant
from bayescal.experiments.self_calibration.tool import ToolAccuracy, ToolPrediction, true_machine
from bayescal.experiments.shared.calibrability import Calibrability
from bayescal.experiments.shared.function_errors import tabulate_functions
from bayescal.experiments.shared.stacking import tabulate_comparison
from bayescal.numerics.geometry import Array

MICROMETRES = 1e3


@dataclass(frozen=True, eq=False)
class VariantFindings:
    """All that was found for one variant; a prediction only with verification poses, an audit where all is free."""

    fit: VariantFit
    prediction: ToolPrediction | None
    accuracy: ToolAccuracy
    calibrability: Calibrability
    audit: Identifiability | None


def tabulate(inputs: ReadingInputs, outcomes: Mapping[str, VariantFindings]) -> dict[str, pd.DataFrame]:
    """Return all tables by the names of their files."""
    every = [(inputs.variants[name], outcome) for name, outcome in outcomes.items()]
    audited = [(variant, outcome.audit) for variant, outcome in every if outcome.audit is not None]
    tables = {
        "variants": tabulate_comparison(
            pd.DataFrame([_describe_variant(inputs, *one) for one in every]),
            {variant.name: one.fit.left_out for variant, one in every},
            "sensors",
        ),
        "parameters": pd.concat([_list_parameters(inputs, *one) for one in every], ignore_index=True),
        "identifiability": pd.concat([_list_verdicts(*one) for one in audited] or [pd.DataFrame()], ignore_index=True),
        "ridges": pd.DataFrame(
            [
                {
                    "variant": variant.name,
                    "kind": ridge.direction.kind,
                    "parameter": audit.names[ridge.direction.pivot or 0],
                    "contraction": ridge.direction.contraction,
                    "sentence": ridge.sentence,
                }
                for variant, audit in audited
                for ridge in audit.ridges
            ],
            columns=["variant", "kind", "parameter", "contraction", "sentence"],
        ),
        "predictions": pd.concat(
            [_list_predictions(inputs, *one) for one in every] or [pd.DataFrame()], ignore_index=True
        ),
        "residuals": pd.concat([_list_residuals(inputs, *one) for one in every], ignore_index=True),
    }
    tables |= tabulate_functions([(variant.name, outcome.fit.functions) for variant, outcome in every])
    return {name: table for name, table in tables.items() if not table.empty or name == "ridges"}


def _describe_variant(inputs: ReadingInputs, variant: Variant, outcome: VariantFindings) -> dict[str, Any]:
    fit, accuracy, prediction = outcome.fit, outcome.accuracy, outcome.prediction
    row: dict[str, Any] = {
        "variant": variant.name,
        "title": variant.config.title,
        "sensors": " ".join(variant.sensors.names),
        "n_sensors": len(variant.sensors.chosen),
        "n_external": len(variant.sensors.chosen) - len(variant.internal.chosen),
        "plain": variant.config.is_plain,
        "n_parameters": len(fit.names),
        "n_equations": variant.sensors.redundancy * len(fit.square),
        **fit.describe_evidence(),
        "elpd": fit.elpd,
        "misfit": _misfit(variant, fit),
        "misfit_chi2": fit.misfit.value,
        "misfit_dof": fit.misfit.dof,
        "pulls_chi2": fit.pulls.value,
        "pulls_dof": fit.pulls.dof,
        **fit.describe_chains(),
        "calibrability": outcome.calibrability.metres_radians,
        "calibrability_scaled": outcome.calibrability.scaled,
        **{f"tool_{name}_um": MICROMETRES * value for name, value in vars(accuracy).items()},
    }
    if prediction is not None:
        known = inputs.truth is not None
        row["verification_sd_um"] = MICROMETRES * float(np.sqrt(np.mean(prediction.sd**2)))
        row["verification_error_um"] = MICROMETRES * float(np.sqrt(np.mean(prediction.error**2)))
        row["inside_90"] = float(prediction.inside.mean()) if known else float("nan")
    return row


def _misfit(variant: Variant, fit: VariantFit) -> float:
    """Return what is left of readings in units of the noise, rms over the degrees of freedom; NaN without any."""
    freedom = variant.sensors.redundancy * len(fit.square) - len(fit.names)
    return float(np.sqrt(fit.square.sum() / freedom)) if freedom > 0 else float("nan")


def _list_parameters(inputs: ReadingInputs, variant: Variant, outcome: VariantFindings) -> pd.DataFrame:
    fit, layout = outcome.fit, inputs.model.layout
    count = variant.together.shape[1]  # beside those of the sensors' functions
    names, prior_sd = fit.names[:count], fit.prior_sd[:count]
    first = [layout.names.index(variant.common.get(name, (name,))[0]) for name in names]
    true = true_machine(inputs, variant)
    table = pd.DataFrame(
        {
            "variant": variant.name,
            "parameter": names,
            "unit": [layout.units[k] for k in first],
            "nominal": layout.nominal[first],
            "prior_sd": prior_sd,
            "mean": fit.mean[:count],
            "sd": fit.sd[:count],
            "q05": fit.q05[:count],
            "q95": fit.q95[:count],
            "contraction": 1.0 - (fit.sd[:count] / prior_sd) ** 2,
            "prior_sensitivity": fit.power_scaling[:count, 0],
            "likelihood_sensitivity": fit.power_scaling[:count, 1],
            "rhat": fit.diagnostics.rhat[:count],
            "ess_bulk": fit.diagnostics.ess_bulk[:count],
            "ess_tail": fit.diagnostics.ess_tail[:count],
        }
    )
    if true is not None:
        table["true"] = true[first]
    return table


def _list_verdicts(variant: Variant, audit: Identifiability) -> pd.DataFrame:
    units, symbols = variant.sensors.model.layout.units, [name.partition("[")[0] for name in audit.names]
    free = np.isin(np.arange(len(audit.names)), audit.selection.free)
    extra = np.isin(np.arange(len(audit.names)), audit.selection.extra)
    return pd.DataFrame(
        {
            "variant": variant.name,
            "parameter": audit.names,
            "symbol": symbols,
            "unit": [units[k] for k in variant.free.places],
            "prior_sd": variant.free.scale,
            "predicted_sd": variant.free.scale * np.sqrt(np.diagonal(audit.information.covariance)),
            "contraction": audit.information.contraction,
            "verdict": audit.verdicts,
            "recommended": free,
            "possible": extra,
        }
    )


def _list_predictions(inputs: ReadingInputs, variant: Variant, outcome: VariantFindings) -> pd.DataFrame:
    found, held = outcome.prediction, inputs.table.verification
    if found is None:
        return pd.DataFrame()
    names = [name for name, one in zip(inputs.table.poses, held, strict=True) if one]
    table: dict[str, Any] = {"variant": variant.name, "pose": names}
    for k, axis in enumerate("xy"):
        columns = {"mm": found.mean, "low_mm": found.low, "high_mm": found.high, "true_mm": found.true}
        table |= {f"{axis}_{name}": values[:, k] for name, values in columns.items()}
    table |= {"sd_um": MICROMETRES * found.sd, "error_um": MICROMETRES * found.error}
    return pd.DataFrame(table)


def _list_residuals(inputs: ReadingInputs, variant: Variant, outcome: VariantFindings) -> pd.DataFrame:
    """Return the rms of each calibration pose's residuals, in units of the noise, by its degrees of freedom."""
    names = [name for name, held in zip(inputs.table.poses, inputs.table.verification, strict=True) if not held]
    rms = np.sqrt(outcome.fit.square / max(1, variant.sensors.redundancy))
    left_out = outcome.fit.left_out
    by_pose = {"elpd_loo": left_out.elpd, "pareto_k": left_out.pareto_k, "refitted": left_out.was_refitted}
    return pd.DataFrame({"variant": variant.name, "pose": names, "rms": rms, **by_pose})


def summarise(
    inputs: ReadingInputs, outcomes: Mapping[str, VariantFindings], tables: Mapping[str, pd.DataFrame]
) -> dict[str, Any]:
    """Return the results as JSON-ready numbers."""
    config, variants = inputs.config, tables["variants"]
    held = inputs.table.verification
    audits = {name: outcome.audit for name, outcome in outcomes.items() if outcome.audit is not None}
    return {
        "experiment": config.name,
        "title": config.title,
        "data_origin": config.origin,
        "seed": config.seed,
        "machine": inputs.model.name,
        "n_poses": {"calibration": int((~held).sum()), "verification": int(held.sum())},
        "truth_known": inputs.truth is not None,
        "converged": bool(variants["converged"].all()),
        "variants": {str(row.pop("variant")): _plain(row) for row in variants.to_dict("records")},
        "rankings": rank_models(inputs, variants),
        "audits": {name: _summarise_audit(audit) for name, audit in audits.items()},
    }


def _plain(row: dict[Any, Any]) -> dict[str, Any]:
    """Return a row without what is not a number."""
    return {str(k): None if isinstance(v, float) and not np.isfinite(v) else v for k, v in row.items()}


def rank_models(inputs: ReadingInputs, variants: pd.DataFrame) -> list[list[str]]:
    """Return variants of the same readings, the largest evidence first, where there are several."""
    groups: dict[tuple[str, ...], list[str]] = {}
    for name, variant in inputs.variants.items():
        groups.setdefault(variant.sensors.names, []).append(name)
    evidence = dict(zip(variants["variant"], variants["log_evidence"], strict=True))
    return [sorted(names, key=lambda name: -evidence[name]) for names in groups.values() if len(names) > 1]


def _summarise_audit(audit: Identifiability) -> dict[str, Any]:
    structure: Array = audit.structure.singular_values
    return {
        "seen": len(audit.seen),
        "rank": audit.structure.rank,
        "rank_gap": audit.structure.gap,
        "rank_clear": audit.structure.is_clear,
        "smallest_singular_value": float(structure[audit.structure.rank - 1]),
        "unseen": list(audit.unseen),
        "free": list(audit.names),
        "recommended": [audit.names[k] for k in audit.selection.free],
        "fixed": [audit.names[k] for k in audit.selection.fixed],
        "possible": [audit.names[k] for k in audit.selection.extra],
        "ridges": len(audit.ridges),
    }
