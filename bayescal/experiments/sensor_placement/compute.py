"""Computing a sensor placement: every set judged, some simulated."""

from __future__ import annotations

import time
from typing import Any

import numpy as np
import pandas as pd

from bayescal.errors import NumericalError
from bayescal.experiments.frame.parallel import Run
from bayescal.experiments.frame.results import Results
from bayescal.experiments.sensor_placement import tables as tabulate
from bayescal.experiments.sensor_placement.inputs import PlacementInputs
from bayescal.experiments.sensor_placement.placement import Accuracy, Placement, build_placement, evaluate_sets
from bayescal.experiments.sensor_placement.simulate import Simulated, simulate_set

CHUNK = 512  # sets that are judged as one task


def compute_placement(inputs: PlacementInputs, run: Run) -> Results:
    """Return how good every set is, what to buy, and whether it comes true.

    Raises
    ------
    NumericalError
        Where no set of the sensors is any good.
    """
    tables = compute_tables(inputs, run)
    return Results(summarise(inputs, tables), tables)


def compute_tables(inputs: PlacementInputs, run: Run) -> dict[str, pd.DataFrame]:
    """Return all tables of an experiment."""
    placement, sets = build_placement(inputs), inputs.enumerate_sets()
    found, seconds = _evaluate(placement, sets @ inputs.members, run)
    table = tabulate.tabulate_sets(inputs, sets, found)
    if not (table["reason"] == "").any():
        raise NumericalError(f"sensors: found no set of {len(sets)} that calibrates the tool's centre, expected some")
    front, named = tabulate.find_front(table, "price"), tabulate.pick_named(inputs, sets, table)
    enough = tabulate.find_enough(front, inputs.config.within)
    places = tabulate.pick_simulated(front, named, enough, inputs.config.simulated_sets)
    simulated = _simulate(inputs, placement, (sets @ inputs.members)[places], run)
    return {
        "sets": table,
        "front": front,
        "front_by_number": tabulate.find_front(table, "n_sensors"),
        "kinds": tabulate.tabulate_kinds(table),
        "reasons": tabulate.tabulate_reasons(table),
        "named": named,
        "simulated": tabulate.tabulate_simulated(table, places, simulated),
        "timing": pd.DataFrame([{"n_sets": len(sets), "seconds": seconds}]),
    }


def _evaluate(placement: Placement, sets: np.ndarray, run: Run) -> tuple[list[Accuracy], float]:
    """Return how good sets of sensors (S, K) are, and what that took, all chunks together, s."""
    tasks = {f"{start}": sets[start : start + CHUNK] for start in range(0, len(sets), CHUNK)}
    found = run.map("sets of sensors", _evaluate_chunk, placement, tasks, (Accuracy,))
    return [one for chunk, _ in found.values() for one in chunk], sum(seconds for _, seconds in found.values())


def _evaluate_chunk(placement: Placement, sets: np.ndarray) -> tuple[list[Accuracy], float]:
    began = time.perf_counter()
    return evaluate_sets(placement, sets), time.perf_counter() - began


def _simulate(inputs: PlacementInputs, placement: Placement, sets: np.ndarray, run: Run) -> list[Simulated]:
    tasks = {f"{k}": (k, chosen) for k, chosen in enumerate(sets)}
    return list(run.map("simulated calibrations", _simulate_one, (inputs, placement), tasks, (Simulated,)).values())


def _simulate_one(shared: tuple[PlacementInputs, Placement], task: tuple[int, np.ndarray]) -> Simulated:
    k, chosen = task
    return simulate_set(*shared, chosen, k)


def summarise(inputs: PlacementInputs, tables: dict[str, pd.DataFrame]) -> dict[str, Any]:
    """Return what the page and readers of ``summary.json`` need beside the tables."""
    config, table, front = inputs.config, tables["sets"], tables["front"]
    best, enough = front.iloc[-1], front.loc[[tabulate.find_enough(front, config.within)]].iloc[0]
    return {
        "name": config.name,
        "title": config.title,
        "machine": inputs.model.name,
        "seed": config.seed,
        "frames": config.frames,
        "n_poses": config.poses.n_poses,
        "n_workspace": config.workspace_poses,
        "dimension": len(inputs.model.pose_units),
        "tolerances": config.tolerances.model_dump(),
        "prices": config.prices,
        "within": config.within,
        "n_sensors": len(inputs.choices),
        "n_sets": len(table),
        "n_feasible": int((table["reason"] == "").sum()),
        "n_parameters": len(inputs.free),
        "always": [choice.name for choice in inputs.choices if choice.always],
        "external": [choice.name for choice in inputs.choices if _is_external(inputs, choice.channels)],
        "sensors": _describe_sensors(inputs),
        "best": _row(best),
        "enough": _row(enough),
        "named": {str(row["name"]): _row(row) for _, row in tables["named"].iterrows()},
    }


def _is_external(inputs: PlacementInputs, channels: np.ndarray) -> bool:
    return any(inputs.model.channels[k].external for k in channels)


def _describe_sensors(inputs: PlacementInputs) -> dict[str, dict[str, Any]]:
    """Return what each entry of the config is."""
    return {
        name: {"noise_um": s.noise_um, "noise_arcsec": s.noise_arcsec, "price": s.price, "always": s.always}
        for name, s in inputs.config.sensors.items()
    }


def _row(row: pd.Series) -> dict[str, Any]:
    """Return a set's row as JSON has it, errors to six digits."""
    values = {name: row[name] for name in ("n_sensors", "price", "reason", "pattern", "sensors")}
    values |= {name: row[name] for name in row.index if name.endswith("_um") or name == "left_to_tolerances"}
    return {name: _plain(value) for name, value in values.items()}


def _plain(value: Any) -> Any:
    if isinstance(value, str):
        return value
    if isinstance(value, (int, np.integer)):
        return int(value)
    return None if np.isnan(value) else float(f"{value:.6g}")
