"""What was printed, beside what is found: of each set its parameters and C, from set to set the improvements."""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path

import numpy as np
import pandas as pd

from bayescal.errors import InputError
from bayescal.files.csv_tables import CsvTable, read_table
from sika2008.schema import SelfCalibrationsConfig

SET_COLUMNS = ("set", "n_parameters", "calibrability")
STEP_COLUMNS = ("from", "to", "calibrability", "parameters", "tool")
SAME_ORDER = 10.0**0.5  # either way
LARGE = 10.0  # a published factor from which on it is an order of magnitude, below it is "negligible"
LEAST_OF_CALIBRABILITY = 0.1  # of a large published factor
ERROR_BAND = (0.3, 3.0)  # of a large published factor: 1/30 to 1/300 where 1/100 was printed
NEGLIGIBLE = 2.0  # a factor, either way


@dataclass(frozen=True)
class Published:
    """What was printed; empty without any.

    Attributes
    ----------
    sets : dict of set to (number of parameters, C)
    steps : dict of (from, to) to dict of quantity to factor
    """

    sets: dict[str, tuple[int, float]] = field(default_factory=dict)
    steps: dict[tuple[str, str], dict[str, float]] = field(default_factory=dict)


def read_published(config: SelfCalibrationsConfig, folder: Path) -> Published:
    """Return what was printed; InputError for a set or a step that the config does not have."""
    section = config.published
    if section is None:
        return Published()
    names = [one.name for one in config.sets]
    table = read_table(folder / section.calibrability, SET_COLUMNS)
    _check_names(table, "set", names)
    values = table.positive(SET_COLUMNS[1:])
    sets = {name: (int(n), float(c)) for name, (n, c) in zip(table.text("set"), values, strict=True)}
    table = read_table(folder / section.improvements, STEP_COLUMNS)
    _check_names(table, "from", names)
    _check_names(table, "to", names)
    pairs, possible = list(zip(table.text("from"), table.text("to"), strict=True)), list(pairwise(names))
    for row, pair in enumerate(pairs):
        if pair not in possible:
            raise InputError(f"{table.where(row)}: found {pair[0]!r} to {pair[1]!r}, expected neighbours in [[sets]]")
    factors = table.positive(STEP_COLUMNS[2:])
    steps = {
        pair: dict(zip(STEP_COLUMNS[2:], row.tolist(), strict=True)) for pair, row in zip(pairs, factors, strict=True)
    }
    return Published(sets, steps)


def _check_names(table: CsvTable, column: str, names: list[str]) -> None:
    for row, name in enumerate(table.text(column)):
        if name not in names:
            raise InputError(f"{table.where(row)}: {column}: found {name!r}, expected one of {', '.join(names)}")


def band_of(quantity: str, printed: float) -> tuple[float, float]:
    """Return between which factors an improvement counts as the published one."""
    if printed < LARGE:
        return printed / NEGLIGIBLE, printed * NEGLIGIBLE
    if quantity == "calibrability":
        return LEAST_OF_CALIBRABILITY * printed, float("inf")
    return ERROR_BAND[0] * printed, ERROR_BAND[1] * printed


def judge_documented(published: Published, tables: dict[str, pd.DataFrame], procedure: str) -> pd.DataFrame:
    """Return what was printed beside what is found on the documented machine, and whether it is reached."""
    rows: list[dict[str, object]] = []
    values = dict(zip(tables["calibrability"]["set"], tables["calibrability"]["metres_radians"], strict=True))
    counts = dict(zip(tables["calibrability"]["set"], tables["calibrability"]["n_parameters"], strict=True))
    for name, (n, value) in published.sets.items():
        rows.append(_judge(name, "n_parameters", n, float(counts[name]), np.nan, (n, n)))
        band = (value / SAME_ORDER, value * SAME_ORDER)
        rows.append(_judge(name, "calibrability", value, float(values[name]), np.nan, band))
    found = group_steps(tables["steps"])
    for (before, after), factors in published.steps.items():
        what, printed = f"{before} to {after}", factors["calibrability"]
        ratio = float(values[before] / values[after])
        rows.append(_judge(what, "calibrability", printed, ratio, np.nan, band_of("calibrability", printed)))
        ours = found[before, after, procedure]
        for quantity, printed in name_factors(factors).items():
            one, band = ours[quantity], band_of(quantity, printed)
            rows.append(_judge(what, quantity, printed, one["ratio"], one["standard_error"], band))
    return pd.DataFrame(rows)


def group_steps(steps: pd.DataFrame) -> dict[tuple[str, str, str], dict[str, dict[str, float]]]:
    """Return the rows of a table of steps by (from, to, procedure) and quantity."""
    found: dict[tuple[str, str, str], dict[str, dict[str, float]]] = {}
    for row in steps.to_dict("records"):
        place = found.setdefault((str(row["from"]), str(row["to"]), str(row["procedure"])), {})
        place[str(row["quantity"])] = {name: float(row[name]) for name in ("ratio", "standard_error")}
    return found


def name_factors(factors: dict[str, float]) -> dict[str, float]:
    """Return the printed factors of errors by our quantities: lengths and angles both belong to the parameters."""
    parameters = {"lengths": factors["parameters"], "guide_angles": factors["parameters"]}
    return parameters | {"tool": factors["tool"]}


def _judge(
    of: str, quantity: str, printed: float, found: float, error: float, band: tuple[float, float]
) -> dict[str, object]:
    low, high = band
    reached = low <= found <= high
    row: dict[str, object] = {"of": of, "quantity": quantity, "published": printed, "found": found}
    return row | {"standard_error": error, "low": low, "high": high, "reached": reached}


def summarise_machines(published: Published, machines: pd.DataFrame, steps: pd.DataFrame) -> pd.DataFrame:
    """Return quantiles over machines, and where the published figures lie in them."""
    rows = []
    for name, ours in machines.groupby("set", sort=False):
        printed = published.sets.get(str(name))
        for quantity in ("metres_radians", "scaled", "lengths", "guide_angles", "tool"):
            value = printed[1] if printed is not None and quantity == "metres_radians" else None
            band = None if value is None else (value / SAME_ORDER, value * SAME_ORDER)
            rows.append(_describe(str(name), quantity, ours[quantity], value, band))
    for (before, after), ours in steps.groupby(["from", "to"], sort=False) if len(steps) else []:
        factors = published.steps.get((str(before), str(after)))
        wanted = {} if factors is None else {"metres_radians": factors["calibrability"]} | name_factors(factors)
        for quantity in ("metres_radians", "scaled", "lengths", "guide_angles", "tool"):
            value = wanted.get(quantity)
            name = "calibrability" if quantity == "metres_radians" else quantity
            band = None if value is None else band_of(name, value)
            rows.append(_describe(f"{before} to {after}", quantity, ours[quantity], value, band))
    return pd.DataFrame(rows)


def _describe(
    of: str, quantity: str, values: pd.Series[float], published: float | None, band: tuple[float, float] | None
) -> dict[str, object]:
    kept = values.to_numpy(dtype=float)
    kept = kept[np.isfinite(kept)]
    row: dict[str, object] = {"of": of, "quantity": quantity, "n": len(kept)}
    levels = (5, 25, 50, 75, 95)
    quantiles = np.percentile(kept, levels) if len(kept) else np.full(len(levels), np.nan)
    row |= {f"p{level:02d}": float(q) for level, q in zip(levels, quantiles, strict=True)}
    if published is None or band is None:
        return row | {"published": np.nan, "share_below": np.nan, "share_within": np.nan}
    within = (kept >= band[0]) & (kept <= band[1])
    row |= {"published": published, "share_below": float(np.mean(kept < published))}
    return row | {"share_within": float(np.mean(within))}
