"""Results of an audit as tables and as a summary of plain numbers."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd

from bayescal.experiments.audit.outlook import Outlook
from bayescal.experiments.audit.reading_inputs import ReadingAudit
from bayescal.experiments.audit.selection import Selection
from bayescal.experiments.shared.readings.inputs import Variant
from bayescal.experiments.shared.readings.knowledge import Knowledge
from bayescal.experiments.shared.readings.knowledge_tables import (
    list_next,
    list_ridges,
    name_data,
    plain,
    tabulate_accuracy,
)
from bayescal.numerics.geometry import Array


@dataclass(frozen=True, eq=False)
class Prospect:
    """What the readings of a variant would tell.

    Attributes
    ----------
    sd : ndarray, shape (m,)
        What remains of each free parameter's deviation, in its inner unit.
    knowledge : Knowledge
    outlook : Outlook
    selection : Selection or None
    """

    sd: Array
    knowledge: Knowledge
    outlook: Outlook
    selection: Selection | None


def tabulate(inputs: ReadingAudit, found: Mapping[str, Prospect]) -> dict[str, pd.DataFrame]:
    """Return all tables by the names of their files."""
    every = [(inputs.variants[name], one) for name, one in found.items()]
    first = next(iter(inputs.variants.values()))
    tables = {
        "variants": pd.DataFrame([_describe(*one, inputs.limits) for one in every]),
        "parameters": pd.concat([_list_parameters(*one) for one in every], ignore_index=True),
        "accuracy": pd.concat(
            [tabulate_accuracy(variant, one.knowledge, inputs.config.units) for variant, one in every],
            ignore_index=True,
        ),
        "requirements": pd.DataFrame([row for one in every for row in _list_requirements(*one, inputs.limits)]),
        "ridges": pd.DataFrame([row for variant, one in every for row in list_ridges(variant, one.knowledge)]),
        "next": pd.DataFrame([row for variant, one in every for row in list_next(variant, one.knowledge)]),
        "selected": pd.DataFrame([row for one in every for row in _list_selected(*one)]),
        "pose_counts": pd.DataFrame([row for one in every for row in _list_counts(*one)]),
        "poses": pd.DataFrame(
            [{"pose": n, **_place(first, v)} for n, v in zip(first.data.poses, first.start, strict=True)]
        ),
    }
    return {name: table for name, table in tables.items() if not table.empty}


def _describe(variant: Variant, one: Prospect, limits: Mapping[str, float]) -> dict[str, Any]:
    known, n_free = one.knowledge, len(one.sd)
    required = list(_list_requirements(variant, one, limits))
    return {
        "variant": variant.name,
        "title": variant.config.title,
        "data": name_data(variant),
        "n_parameters": n_free,
        "n_poses": variant.data.n_poses,
        "n_equations": variant.data.n_poses * (len(variant.model.channels) - len(variant.model.coordinates)),
        "n_identifiable": known.verdicts.count("identifiable"),
        "left": float(np.sqrt(np.mean((known.after / known.before) ** 2))),
        "margin": min((row["margin"] for row in required), default=float("nan"), key=_worst),
        "met": all(row["met"] for row in required),
        "probability": one.outlook.together if required else float("nan"),
    }


def _worst(margin: float) -> float:
    """Return a margin for the comparison of several: one that is not known is the worst."""
    return margin if np.isfinite(margin) else -np.inf


def _list_parameters(variant: Variant, one: Prospect) -> pd.DataFrame:
    posterior = variant.posterior()
    return pd.DataFrame(
        {
            "variant": variant.name,
            "parameter": posterior.sampling.names,
            "unit": posterior.units,
            "expected": posterior.sampling.start[posterior.sampling.free],
            "prior_sd": posterior.prior_sd,
            "sd": one.sd,
            "contraction": 1.0 - (one.sd / posterior.prior_sd) ** 2,
            "verdict": one.knowledge.verdicts,
        }
    )


def _list_requirements(variant: Variant, one: Prospect, limits: Mapping[str, float]) -> Iterator[dict[str, Any]]:
    """Return what is required of each coordinate: parameters and noise of the machine's own sensors count together."""
    known = one.knowledge
    for k, name in enumerate(known.coordinates):
        if name in limits:
            error = float(np.hypot(known.after[k], known.noise[k]))
            yield {
                "variant": variant.name,
                "coordinate": name,
                "unit": known.units[k],
                "limit": limits[name],
                "before": float(np.hypot(known.before[k], known.noise[k])),
                "error": error,
                "noise": known.noise[k],
                "margin": 1.0 - error / limits[name],
                "met": error <= limits[name],
                "worst": one.outlook.worst[k],
                **{f"worst_at_{c}": v for c, v in _place(variant, one.outlook.worst_pose[k]).items()},
                "probability_before": one.outlook.before[k],
                "probability": one.outlook.probability[k],
                "probability_everywhere": one.outlook.everywhere[k],
            }


def _list_selected(variant: Variant, one: Prospect) -> Iterator[dict[str, Any]]:
    if one.selection is None:
        return
    names = [f"after_{n}_{u}" for n, u in zip(one.knowledge.coordinates, one.knowledge.units, strict=True)]
    for step, (pose, after) in enumerate(zip(one.selection.pose, one.selection.after, strict=True), start=1):
        yield {
            "variant": variant.name,
            "step": step,
            **_place(variant, pose),
            **dict(zip(names, after, strict=True)),
        }


def _list_counts(variant: Variant, one: Prospect) -> Iterator[dict[str, Any]]:
    """Return what every number of poses leaves of the error, chosen and at random, and what the last of them gained."""
    chosen = one.selection
    if chosen is None:
        return
    names = [f"{name}_{unit}" for name, unit in zip(one.knowledge.coordinates, one.knowledge.units, strict=True)]
    size = _measure([one.knowledge.before, *chosen.curve], variant)
    for k, (curve, random) in enumerate(zip(chosen.curve, chosen.random, strict=True)):
        yield {
            "variant": variant.name,
            "n_poses": k + 1,
            **{f"after_{name}": value for name, value in zip(names, curve, strict=True)},
            **{f"random_{name}": value for name, value in zip(names, random, strict=True)},
            "size": size[k + 1],
            "gain": 1.0 - size[k + 1] / size[k],
        }


def _measure(errors: Sequence[Array], variant: Variant) -> list[float]:
    """Return the size of errors (t,) of the tool, of its lengths only, as poses are chosen by it."""
    n_lengths = max(1, variant.model.pose_units.count("mm"))
    return [float(np.linalg.norm(one[:n_lengths])) for one in errors]


def _place(variant: Variant, pose: Array) -> dict[str, float]:
    return {f"{one.name}_{one.unit}": pose[k] for k, one in enumerate(variant.model.coordinates)}


def summarise(inputs: ReadingAudit, tables: Mapping[str, pd.DataFrame]) -> dict[str, Any]:
    """Return the results as JSON-ready numbers."""
    config, selection = inputs.config, inputs.config.selection
    return {
        "experiment": config.name,
        "title": config.title,
        "seed": config.seed,
        "machine": inputs.machine,
        "member": next(iter(inputs.variants.values())).model.member,
        "units": config.units.model_dump(),
        "n_poses": next(iter(inputs.variants.values())).data.n_poses,
        "poses": config.poses.file or "random ones of the workspace",
        "candidates": None if selection is None else selection.candidates,
        "selection": None if selection is None else selection.method,
        "sensor_choice": _summarise_choice(inputs),
        "requirements": dict(config.requirements),
        "aligned": config.aligned,
        "variants": {str(row.pop("variant")): plain(row) for row in tables["variants"].to_dict("records")},
    }


def _summarise_choice(inputs: ReadingAudit) -> dict[str, Any] | None:
    asked = inputs.config.sensor_choice
    if asked is None:
        return None
    return {"candidates": [one.name for one in inputs.choices], "always": asked.always}
