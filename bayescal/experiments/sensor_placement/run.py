"""Running an experiment on sensor placement: every set judged, some simulated, results put in place as a whole."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import joblib
import numpy as np
import pandas as pd

from bayescal.errors import NumericalError
from bayescal.experiments.frame.run import identify_experiment, publish
from bayescal.experiments.frame.store import Store
from bayescal.experiments.sensor_placement import tables as made
from bayescal.experiments.sensor_placement.inputs import PlacementInputs, read_placement
from bayescal.experiments.sensor_placement.page.pages import build_page
from bayescal.experiments.sensor_placement.placement import Placement, build_placement, evaluate_sets
from bayescal.experiments.sensor_placement.schema import PlacementConfig
from bayescal.experiments.sensor_placement.simulate import Simulated, simulate_set


def run_sensor_placement(config: PlacementConfig, folder: Path, out: Path, workers: int = 1) -> str:
    """Run an experiment, put its results in ``out`` and return them in a few lines.

    Parameters
    ----------
    config : PlacementConfig
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
    NumericalError
        Where no set of the sensors is any good.
    """
    inputs = read_placement(config, folder)
    identity = identify(config, folder)
    store = Store(out)
    store.check_results(identity)
    tables = compute_tables(inputs, workers)
    summary = summarise(inputs, tables)
    return publish(store, identity, tables, summary, build_page(summary, tables))


def compute_tables(inputs: PlacementInputs, workers: int = 1) -> dict[str, pd.DataFrame]:
    """Return all tables of an experiment."""
    placement, sets = build_placement(inputs), inputs.enumerate_sets()
    began = time.perf_counter()
    found = evaluate_sets(placement, sets @ inputs.members, workers)
    seconds = time.perf_counter() - began
    table = made.tabulate_sets(inputs, sets, found)
    if not (table["reason"] == "").any():
        raise NumericalError(f"sensors: found no set of {len(sets)} that calibrates the tool's centre, expected some")
    front, named = made.find_front(table, "price"), made.pick_named(inputs, sets, table)
    enough = made.find_enough(front, inputs.config.within)
    places = made.pick_simulated(front, named, enough, inputs.config.simulated_sets)
    simulated = _simulate(inputs, placement, (sets @ inputs.members)[places], workers)
    return {
        "sets": table,
        "front": front,
        "front_by_number": made.find_front(table, "n_sensors"),
        "kinds": made.tabulate_kinds(table),
        "reasons": made.tabulate_reasons(table),
        "named": named,
        "simulated": made.tabulate_simulated(table, places, simulated),
        "timing": pd.DataFrame([{"n_sets": len(sets), "workers": workers, "seconds": seconds}]),
    }


def _simulate(inputs: PlacementInputs, placement: Placement, sets: np.ndarray, workers: int) -> list[Simulated]:
    if workers == 1 or len(sets) < 2:
        return [simulate_set(inputs, placement, chosen, k) for k, chosen in enumerate(sets)]
    parallel = joblib.Parallel(n_jobs=workers, inner_max_num_threads=1)
    return list(parallel(joblib.delayed(simulate_set)(inputs, placement, s, k) for k, s in enumerate(sets)))


def summarise(inputs: PlacementInputs, tables: dict[str, pd.DataFrame]) -> dict[str, Any]:
    """Return what the page and readers of ``summary.json`` need beside the tables."""
    config, table, front = inputs.config, tables["sets"], tables["front"]
    best, enough = front.iloc[-1], front.loc[[made.find_enough(front, config.within)]].iloc[0]
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


def identify(config: PlacementConfig, folder: Path) -> dict[str, Any]:
    """Return what determines the results."""
    return identify_experiment(config, folder, [config.machine.file])
