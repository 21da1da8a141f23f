"""Results of a calibration as tables and as a summary of plain numbers."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from scipy.stats import chi2

from bayescal.experiments.shared.function_errors import tabulate_functions
from bayescal.experiments.shared.headline import Candidate, choose_candidate
from bayescal.experiments.shared.reading_fit import ReadingFit
from bayescal.experiments.shared.readings.inputs import ReadingInputs, Variant
from bayescal.experiments.shared.readings.knowledge import Knowledge
from bayescal.experiments.shared.readings.knowledge_tables import (
    list_next,
    list_ridges,
    name_data,
    plain,
    tabulate_accuracy,
)
from bayescal.experiments.shared.stacking import tabulate_comparison
from bayescal.experiments.study.validation import Held
from bayescal.numerics.geometry import Array

DOUBTFUL = 0.01  # probability under the stated noise below which what a pose leaves is doubtful
DISTRUSTED = 0.5  # mean of a pose's precision below which a robust density doubts it


@dataclass(frozen=True, eq=False)
class Residuals:
    """What the best machine leaves of the readings at P poses.

    Attributes
    ----------
    pose : ndarray, shape (P, q)
    left, noise : ndarray, shape (P, K)
        Measured minus read, NaN where nothing was, and the noise at the best machine; in the channels' units.
    square : ndarray, shape (P,)
        r².
    trust : ndarray, shape (P,)
        Mean of the pose's precision; one but for robust densities.
    freedom : ndarray of int, shape (P,)
        Readings less coordinates.
    """

    pose: Array
    left: Array
    noise: Array
    square: Array
    trust: Array
    freedom: np.ndarray


@dataclass(frozen=True, eq=False)
class Findings:
    """All that was found for one variant."""

    fit: ReadingFit
    residuals: Residuals
    knowledge: Knowledge
    beside: list[Array]
    held: list[Held]


def tabulate(inputs: ReadingInputs, found: Mapping[str, Findings]) -> dict[str, pd.DataFrame]:
    """Return all tables by the names of their files."""
    every = [(inputs.variants[name], one) for name, one in found.items()]
    predictions = pd.DataFrame([row for one in every for row in _list_predictions(*one)])
    tables = {
        "variants": tabulate_comparison(
            pd.DataFrame([_describe(*one, predictions) for one in every]),
            {name: one.fit.left_out for name, one in found.items()},
            "data",
        ),
        "parameters": pd.concat([_list_parameters(*one) for one in every], ignore_index=True),
        "residuals": pd.DataFrame([row for one in every for row in _list_residuals(*one)]),
        "poses": pd.concat([_list_poses(*one) for one in every], ignore_index=True),
        "predictions": predictions,
        "accuracy": pd.concat([tabulate_accuracy(variant, one.knowledge) for variant, one in every], ignore_index=True),
        "ridges": pd.DataFrame([row for variant, one in every for row in list_ridges(variant, one.knowledge)]),
        "next": pd.DataFrame([row for variant, one in every for row in list_next(variant, one.knowledge)]),
        "beside": pd.DataFrame([row for one in every for row in _list_beside(inputs, *one)]),
    }
    tables |= tabulate_functions([(variant.name, one.fit.functions) for variant, one in every])
    return {name: table for name, table in tables.items() if not table.empty}


def _describe(variant: Variant, one: Findings, predictions: pd.DataFrame) -> dict[str, Any]:
    fit, left = one.fit, one.residuals
    freedom = int(left.freedom.sum()) - len(fit.names)
    row: dict[str, Any] = {
        "variant": variant.name,
        "title": variant.config.title,
        "data": name_data(variant),
        "robust": variant.config.outliers.expected,
        "n_parameters": len(fit.names),
        "n_poses": len(left.square),
        "n_equations": int(left.freedom.sum()),
        **fit.describe_evidence(),
        "elpd": sum(held.elpd for held in one.held) if one.held else float("nan"),
        "misfit": float(np.sqrt(left.square.sum() / freedom)) if freedom > 0 else float("nan"),
        "misfit_chi2": fit.misfit.value,
        "misfit_dof": fit.misfit.dof,
        "pulls_chi2": fit.pulls.value,
        "pulls_dof": fit.pulls.dof,
        **fit.describe_chains(),
    }
    if not predictions.empty:
        mine = predictions[(predictions["variant"] == variant.name) & ~predictions["external"]]
        row |= {"held_readings": len(mine), "inside_90": float(mine["inside"].mean()) if len(mine) else float("nan")}
    return row


def _list_parameters(variant: Variant, one: Findings) -> pd.DataFrame:
    fit, posterior = one.fit, variant.posterior()
    start = list(variant.model.layout.nominal[posterior.sampling.free])
    medians = posterior.errors.natural(np.zeros(posterior.errors.n_parameters))
    start += [float(x) if unit == "1" else 0.0 for unit, x in zip(posterior.errors.units, medians, strict=True)]
    verdicts = [*one.knowledge.verdicts, *["noise"] * posterior.errors.n_parameters]
    return pd.DataFrame(
        {
            "variant": variant.name,
            "parameter": fit.names,
            "unit": fit.units,
            "nominal": start,
            "prior_sd": fit.prior_sd,
            "mean": fit.mean,
            "sd": fit.sd,
            "q05": fit.q05,
            "q95": fit.q95,
            "contraction": 1.0 - (fit.sd / fit.prior_sd) ** 2,
            "prior_sensitivity": fit.power_scaling[:, 0],
            "likelihood_sensitivity": fit.power_scaling[:, 1],
            "verdict": verdicts,
            "rhat": fit.diagnostics.rhat,
            "ess_bulk": fit.diagnostics.ess_bulk,
            "ess_tail": fit.diagnostics.ess_tail,
        }
    )


def _list_residuals(variant: Variant, one: Findings) -> Iterator[dict[str, Any]]:
    poses = variant.data.pick(~variant.verification)
    for k, name in enumerate(poses.poses):
        for channel in np.flatnonzero(poses.present[k]):
            yield {
                "variant": variant.name,
                "pose": name,
                "channel": variant.model.channels[channel].name,
                "unit": variant.model.channels[channel].unit,
                "measured": poses.values[k, channel],
                "residual": one.residuals.left[k, channel],
                "noise": one.residuals.noise[k, channel],
            }


def _list_poses(variant: Variant, one: Findings) -> pd.DataFrame:
    left = one.residuals
    chance = chi2.sf(left.square, np.maximum(left.freedom, 1))
    coordinates = {f"{c.name}_{c.unit}": left.pose[:, k] for k, c in enumerate(variant.model.coordinates)}
    names = [name for name, held in zip(variant.data.poses, variant.verification, strict=True) if not held]
    return pd.DataFrame(
        {
            "variant": variant.name,
            "pose": names,
            **coordinates,
            "equations": left.freedom,
            "square": left.square,
            "chance": chance,
            "trust": left.trust,
            "elpd_loo": one.fit.left_out.elpd,
            "pareto_k": one.fit.left_out.pareto_k,
            "refitted": one.fit.left_out.was_refitted,
            "doubtful": (left.trust < DISTRUSTED) | ((not variant.config.outliers.expected) & (chance < DOUBTFUL)),
        }
    )


def _list_predictions(variant: Variant, one: Findings) -> Iterator[dict[str, Any]]:
    for held in one.held:
        found = held.predictions
        for k, (row, channel) in enumerate(zip(held.rows[found.pose], found.channel, strict=True)):
            yield {
                "variant": variant.name,
                "pose": variant.data.poses[row],
                "channel": variant.model.channels[channel].name,
                "external": variant.model.channels[channel].external,
                "unit": variant.model.channels[channel].unit,
                "measured": found.measured[k],
                "mean": found.mean[k],
                "sd": found.sd[k],
                "low": found.low[k],
                "high": found.high[k],
                "inside": bool(found.inside[k]),
            }


def _list_beside(inputs: ReadingInputs, variant: Variant, one: Findings) -> Iterator[dict[str, Any]]:
    for source, values in zip(inputs.beside, one.beside, strict=True):
        mean, sd = values.mean(axis=0), values.std(axis=0)
        for k, name in enumerate(source.quantities):
            if np.ptp(values[:, k]) == 0.0 and np.isnan(source.sd[k]):  # held fixed: there is nothing to compare
                continue
            yield {
                "variant": variant.name,
                "beside": source.title,
                "source": source.source,
                "quantity": name,
                "unit": source.units[k],
                "mean": mean[k],
                "sd": sd[k],
                "value": source.values[k],
                "value_sd": source.sd[k],
            }


def summarise(inputs: ReadingInputs, tables: Mapping[str, pd.DataFrame]) -> dict[str, Any]:
    """Return the results as JSON-ready numbers."""
    config, variants = inputs.config, tables["variants"]
    return {
        "experiment": config.name,
        "title": config.title,
        "seed": config.seed,
        "machine": inputs.machine,
        "origin": config.origin.model_dump(),
        "member": next(iter(inputs.variants.values())).model.member,
        "machine_folder": inputs.machine_folder,
        "states_tool": all(one.model.states_tool for one in inputs.variants.values()),
        **({"unused": inputs.unused} if inputs.unused else {}),
        "converged": bool(variants["converged"].all()),
        "units": config.units.model_dump(),
        "variants": {str(row.pop("variant")): plain(row) for row in variants.to_dict("records")},
        "rankings": rank_variants(variants),
    }


def list_candidates(summary: Mapping[str, Any]) -> list[Candidate]:
    """Return the variants of the most readings, of which one is to be used, the first of the experiment first."""
    rows = summary["variants"]
    ranking = max(summary["rankings"], key=lambda names: (rows[names[0]]["n_equations"], len(names)))
    return [
        Candidate(
            name,
            f"“{row['title']}”",
            float(row["log_evidence"]),
            float(row["log_evidence_se"]),
            bool(row["converged"]),
            (int(row["n_parameters"]),),
        )
        for name, row in rows.items()
        if name in ranking
    ]


def choose_best(summary: Mapping[str, Any]) -> str:
    """Return the variant to use."""
    return choose_candidate(list_candidates(summary)).name


def rank_variants(variants: pd.DataFrame) -> list[list[str]]:
    """Return the variants of the same readings, the largest evidence first."""
    groups = [some.sort_values("log_evidence", ascending=False) for _, some in variants.groupby("data", sort=False)]
    return [[str(name) for name in some["variant"]] for some in groups]
