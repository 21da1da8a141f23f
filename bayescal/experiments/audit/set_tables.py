"""Sets of sensors that were judged as tables: all of them, the best of each number, what no set of them tells."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import pandas as pd

from bayescal.experiments.audit.reading_inputs import ReadingAudit
from bayescal.experiments.audit.set_search import FoundSets, find_hopeless
from bayescal.experiments.shared.readings.inputs import Variant
from bayescal.identifiability.reading_rows import name_tool
from bayescal.numerics.units import Units

DIGITS = 9  # of a price, for sums of the same prices to be the same


def tabulate_sets(inputs: ReadingAudit, found: FoundSets) -> dict[str, pd.DataFrame]:
    """Return ``sensor_sets``, ``best_sets``, their ``front`` against the price, and what no set of them tells.

    That is ``best_set_parameters`` and ``hopeless_sets``; tables without rows are left out.
    """
    assert inputs.sensors is not None
    good = _list_best(found)
    tables = {
        "sensor_sets": (sets := pd.DataFrame([_describe(inputs, found, k) for k in range(len(found.sets))])),
        "front": find_front(sets),
        "best_sets": pd.DataFrame([_describe(inputs, found, k) | _count(found, number) for number, k in good]),
        "best_set_parameters": pd.DataFrame([row for one in good for row in _list_parameters(inputs, found, *one)]),
        "hopeless_sets": pd.DataFrame([_name_set(inputs, found, k) for k in find_hopeless(found)]),
    }
    return {name: table for name, table in tables.items() if not table.empty}


def find_shown(inputs: ReadingAudit, found: FoundSets) -> list[int]:
    """Return which sets stand out: the best of each number, and those that no other one beats at their price."""
    front = find_front(pd.DataFrame([_describe(inputs, found, k) for k in range(len(found.sets))]))
    return list(dict.fromkeys([place for _, place in _list_best(found)] + [int(k) for k in front.index]))


def _list_best(found: FoundSets) -> list[tuple[int, int]]:
    """Return each number of choices of which any set is good, with the place of the best one."""
    best = [(int(number), found.best_of(number)) for number in np.unique(found.sets.sum(axis=1))]
    return [(number, place) for number, place in best if place is not None]


def find_front(sets: pd.DataFrame) -> pd.DataFrame:
    """Return the sets that no other one beats at its price or below, the cheapest first; empty without prices."""
    if "price" not in sets:
        return pd.DataFrame()
    good = sets[sets["goal"].notna()].sort_values(["price", "goal", "n_sensors"], kind="stable")
    return good[good["goal"] < good["goal"].cummin().shift(fill_value=np.inf)]


def _name_set(inputs: ReadingAudit, found: FoundSets, place: int) -> dict[str, Any]:
    chosen = [choice for choice, one in zip(inputs.choices, found.sets[place], strict=True) if one]
    price = round(sum(one.price for one in chosen), DIGITS)
    return {
        "n_sensors": len(chosen),
        "sensors": ", ".join(one.name for one in chosen),
        **({} if np.isnan(inputs.choices[0].price) else {"price": price}),
        "n_readings": found.accuracy[place].n_readings,
        "reason": found.accuracy[place].reason,
    }


def _describe(inputs: ReadingAudit, found: FoundSets, place: int) -> dict[str, Any]:
    one, variant = found.accuracy[place], inputs.sensors
    assert variant is not None
    names = [f"{name}_{unit}" for name, unit in zip(*name_tool(variant.model), strict=True)]
    parts = {"error": one.error, "after": one.after, "noise": one.noise}
    per_pose = max(0, one.n_readings - len(variant.model.coordinates))
    return {
        **_name_set(inputs, found, place),
        "n_equations": variant.data.n_poses * per_pose,
        "goal": one.goal if np.isfinite(one.goal) else np.nan,
        **({"probability": found.probability[place]} if inputs.requirements else {}),
        "left": float(np.sqrt(np.mean(one.sd**2))),
        **{
            f"{part}_{name}": value for part, values in parts.items() for name, value in zip(names, values, strict=True)
        },
    }


def _count(found: FoundSets, number: int) -> dict[str, Any]:
    """Return how many sets of a number were judged, and how many of them are no good."""
    alike = [one for one, n in zip(found.accuracy, found.sets.sum(axis=1), strict=True) if n == number]
    return {"n_sets": len(alike), "n_hopeless": sum(one.reason != "" for one in alike)}


def _list_parameters(inputs: ReadingAudit, found: FoundSets, number: int, place: int) -> Iterator[dict[str, Any]]:
    variant: Variant | None = inputs.sensors
    assert variant is not None
    posterior, units = variant.posterior(), Units(inputs.config.units.length, inputs.config.units.angle)
    for name, unit, prior, share in zip(
        posterior.sampling.names, posterior.units, posterior.prior_sd, found.accuracy[place].sd, strict=True
    ):
        said = float(prior / units.factor(unit))
        yield {
            "n_sensors": number,
            "parameter": name,
            "unit": units.name(unit),
            "prior_sd": said,
            "sd": share * said,
        }
