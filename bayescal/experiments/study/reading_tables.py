"""Results of a calibration as tables and as a summary of plain numbers."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from scipy.stats import chi2

from bayescal.experiments.shared.function_errors import tabulate_functions
from bayescal.experiments.shared.reading_fit import ReadingFit
from bayescal.experiments.shared.readings.inputs import ReadingInputs, Variant
from bayescal.experiments.shared.readings.knowledge import (
    Knowledge,
    list_next,
    list_ridges,
    name_data,
    plain,
    tabulate_accuracy,
)
from bayescal.experiments.shared.stacking import tabulate_comparison
from bayescal.experiments.shared.variant_tables import (
    NOISE,
    describe_fit,
    rank_variants,
    tabulate_left_out,
    tabulate_parameters,
)
from bayescal.experiments.study.validation import Held
from bayescal.numerics.geometry import Array

IMPROBABLE = 0.01  # probability under the stated noise below which a pose's residuals contradict it
DISTRUSTED = 0.5  # mean of a pose's precision below which a robust density takes it for an outlier


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
    every, units = [(inputs.variants[name], one) for name, one in found.items()], inputs.config.units
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
        "accuracy": pd.concat(
            [tabulate_accuracy(variant, one.knowledge, units) for variant, one in every], ignore_index=True
        ),
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
        "n_poses": len(left.square),
        "n_equations": int(left.freedom.sum()),
        **describe_fit(fit),
        "elpd": sum(held.elpd for held in one.held) if one.held else float("nan"),
        "misfit": float(np.sqrt(left.square.sum() / freedom)) if freedom > 0 else float("nan"),
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
    verdicts = [*one.knowledge.verdicts, *[NOISE] * posterior.errors.n_parameters]
    return tabulate_parameters(variant.name, fit, start, verdicts)


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
    used = variant.data.pick(~variant.verification)
    contradicting = (left.trust < DISTRUSTED) | ((not variant.config.outliers.expected) & (chance < IMPROBABLE))
    own = {"equations": left.freedom, "square": left.square, "chance": chance, "trust": left.trust}
    common = tabulate_left_out(variant.name, one.fit, used.poses, np.zeros(used.n_poses, dtype=bool))
    return common.assign(**coordinates, **own, contradicting=contradicting)


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
    config, rows = inputs.config, {str(row.pop("variant")): plain(row) for row in tables["variants"].to_dict("records")}
    held = max((one.verification for one in inputs.variants.values()), key=len)
    return {
        "experiment": config.name,
        "title": config.title,
        "seed": config.seed,
        "machine": inputs.machine,
        "origin": config.origin.model_dump(),
        "n_poses": {"calibration": int((~held).sum()), "verification": int(held.sum())},
        "member": next(iter(inputs.variants.values())).model.member,
        "machine_folder": inputs.machine_folder,
        "states_tool": all(one.model.states_tool for one in inputs.variants.values()),
        **({"unused": inputs.unused} if inputs.unused else {}),
        "converged": all(row["converged"] for row in rows.values()),
        "units": config.units.model_dump(),
        "variants": rows,
        "rankings": rank_variants(rows),
    }
