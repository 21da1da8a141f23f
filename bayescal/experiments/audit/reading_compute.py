"""What only readings of channels have: accuracy in use, poses to measure next, poses and sensors to choose."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pandas as pd

from bayescal.experiments.audit.reading_inputs import ReadingAudit
from bayescal.experiments.audit.selection import Selection, select_poses
from bayescal.experiments.audit.sensor_sets import build_sensor_sets, find_probability
from bayescal.experiments.audit.set_search import FoundSets, search_sets
from bayescal.experiments.audit.set_tables import find_shown, tabulate_sets
from bayescal.experiments.frame.parallel import Run
from bayescal.experiments.shared.readings.inputs import Variant
from bayescal.experiments.shared.readings.knowledge import Knowledge, assess
from bayescal.experiments.shared.readings.knowledge_tables import list_next, tabulate_accuracy
from bayescal.numerics.geometry import Array


@dataclass(frozen=True, eq=False)
class Prospect:
    """How accurate a variant is, and at which poses it is best measured."""

    knowledge: Knowledge
    selection: Selection | None


def compute_readings(inputs: ReadingAudit, run: Run) -> dict[str, pd.DataFrame]:
    """Return the tables of all variants' accuracy and poses, and of the sensors to choose from."""
    names = {name: name for name in inputs.variants}
    found = run.map("variants", _compute_variant, inputs, names, (Prospect, Knowledge, Selection))
    every = [(inputs.variants[name], one) for name, one in found.items()]
    first = next(iter(inputs.variants.values()))
    tables = {
        "accuracy": pd.concat(
            [tabulate_accuracy(variant, one.knowledge, inputs.config.units) for variant, one in every],
            ignore_index=True,
        ),
        "next": pd.DataFrame([row for variant, one in every for row in list_next(variant, one.knowledge)]),
        "selected": pd.DataFrame([row for one in every for row in _list_selected(*one)]),
        "pose_counts": pd.DataFrame([row for one in every for row in _list_counts(*one)]),
        "poses": pd.DataFrame(
            [{"pose": n, **_place(first, v)} for n, v in zip(first.data.poses, first.start, strict=True)]
        ),
    }
    if inputs.sensors is not None:
        tables |= tabulate_sets(inputs, run.once("sets of sensors", search_sensors, inputs, (FoundSets,)))
    return {name: table for name, table in tables.items() if not table.empty}


def _compute_variant(inputs: ReadingAudit, name: str) -> Prospect:
    plan = inputs.plans[name]
    expected, covariance = np.zeros(plan.posterior.n_parameters), plan.inform().covariance
    knowledge = assess(inputs.config, plan.variant, plan.posterior, expected, covariance)
    return Prospect(knowledge, select_poses(inputs.config, plan.variant, plan.posterior))


def search_sensors(inputs: ReadingAudit) -> FoundSets:
    """Return the sets of sensors that were judged."""
    assert inputs.sensors is not None
    asked, variant = inputs.config.sensor_choice, inputs.sensors
    assert asked is not None
    posterior, seed, n = variant.posterior(), inputs.config.seed, len(inputs.choices)
    sets = build_sensor_sets(variant, posterior, inputs.choices, asked.always, inputs.requirements, seed)
    found = search_sets(sets, min(asked.largest or n, n), asked.exhaustive)
    probability = found.probability.copy()
    for k in find_shown(inputs, found):
        probability[k] = find_probability(sets, found.sets[k], np.random.default_rng([seed, 3]))
    return replace(found, probability=probability)


def summarise_choices(inputs: ReadingAudit) -> dict[str, Any]:
    """Return what was to be chosen, for ``summary.json``."""
    config, asked = inputs.config, inputs.config.sensor_choice
    choice = None if asked is None else {"candidates": [one.name for one in inputs.choices], "always": asked.always}
    return {
        "candidates": None if config.selection is None else config.selection.candidates,
        "pose_selection": None if config.selection is None else config.selection.method,
        "sensor_choice": choice,
        "aligned": config.aligned,
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
