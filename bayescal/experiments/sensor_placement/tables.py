"""Sets of sensors as tables: all of them, the Pareto fronts, how many there are of each kind, named sets."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Sequence

import numpy as np
import pandas as pd

from bayescal.experiments.sensor_placement.inputs import Choice, PlacementInputs
from bayescal.experiments.sensor_placement.placement import Accuracy
from bayescal.experiments.sensor_placement.simulate import Simulated

MICROMETRES = 1e3
LENGTHS = ("rms", "largest", "calibration", "noise", "beforehand")
PRICE_DECIMALS = 6
ALIKE = 0.05
"""Sets of the same pattern with errors within this of each other count as equivalent."""


def describe_kinds(choices: Sequence[Choice]) -> str:
    """Return how many sensors of each kind there are, such as ``4 s + 2 psi``."""
    counts = Counter(choice.kind for choice in choices)
    single = {choice.kind for choice in choices if not choice.leg}
    return " + ".join(kind if kind in single else f"{n} {kind}" for kind, n in counts.items())


def describe_pattern(choices: Sequence[Choice]) -> str:
    """Return which kinds stand together on a leg, whichever leg it is: ``2 legs s+psi, 2 legs s``."""
    legs: dict[str, list[str]] = defaultdict(list)
    for choice in choices:
        if choice.leg:
            legs[choice.leg].append(choice.kind)
    counts = Counter("+".join(kinds) for kinds in legs.values())
    parts = [f"{n} {'leg' if n == 1 else 'legs'} {kinds}" for kinds, n in sorted(counts.items(), key=_by_richness)]
    return ", ".join([*parts, *(choice.name for choice in choices if not choice.leg)])


def _by_richness(item: tuple[str, int]) -> tuple[int, str]:
    return -len(item[0].split("+")), item[0]


def tabulate_sets(inputs: PlacementInputs, sets: np.ndarray, found: Sequence[Accuracy]) -> pd.DataFrame:
    """Return one row for each set (S, C), errors in µm."""
    rows = []
    for chosen, accuracy in zip(sets, found, strict=True):
        choices = [inputs.choices[k] for k in np.flatnonzero(chosen)]
        shown = [choice for choice in choices if not choice.always]
        row: dict[str, object] = {
            "n_sensors": len(choices),
            "price": round(sum(choice.price for choice in choices), PRICE_DECIMALS),
            "reason": accuracy.reason,
            **{f"{name}_um": MICROMETRES * getattr(accuracy, name) for name in LENGTHS},
            "left_to_tolerances": accuracy.left,
            "kinds": describe_kinds(shown),
            "pattern": describe_pattern(shown),
            "sensors": " ".join(choice.name for choice in shown),
        }
        rows.append(row)
    return pd.DataFrame(rows)


def find_front(table: pd.DataFrame, against: str) -> pd.DataFrame:
    """Return the feasible sets of which none costs no more and is more accurate, from cheap to dear.

    Parameters
    ----------
    table : DataFrame
        All sets.
    against : str
        ``price`` or ``n_sensors``.
    """
    good = table[table["reason"] == ""].sort_values([against, "rms_um"], kind="stable")
    before = good["rms_um"].cummin().shift(fill_value=np.inf)
    front = good[good["rms_um"] < before].copy()
    alike = [_count_alike(table, row) for _, row in front.iterrows()]
    front["n_of_pattern"] = [n for n, _ in alike]
    front["n_alike"] = [n for _, n in alike]
    return front


def _count_alike(table: pd.DataFrame, row: pd.Series) -> tuple[int, int]:
    """Return how many sets have the row's pattern, and how many of them its accuracy."""
    same = table[table["pattern"] == row["pattern"]]
    close = (same["reason"] == "") & (same["rms_um"] <= (1.0 + ALIKE) * row["rms_um"])
    return len(same), int(close.sum())


def tabulate_kinds(table: pd.DataFrame) -> pd.DataFrame:
    """Return, for each number of sensors of each kind, how many sets there are and the best and worst accuracy."""
    rows = []
    for kinds, group in table.groupby("kinds", sort=False):
        good = group[group["reason"] == ""].sort_values("rms_um", kind="stable")
        best = good.iloc[0] if len(good) else None
        rows.append(
            {
                "kinds": kinds,
                "n_sensors": group["n_sensors"].iloc[0],
                "price": group["price"].iloc[0],
                "n_sets": len(group),
                "n_feasible": len(good),
                "best_um": np.nan if best is None else best["rms_um"],
                "worst_um": good["rms_um"].max(),
                "best_pattern": "" if best is None else best["pattern"],
            }
        )
    return pd.DataFrame(rows).sort_values(["n_sensors", "best_um"], kind="stable")


def tabulate_reasons(table: pd.DataFrame) -> pd.DataFrame:
    """Return how many sets of each number of sensors there are, and why some are no good."""
    counts = pd.crosstab(table["n_sensors"], table["reason"])
    for reason in ("", "pose", "equations", "tolerances"):
        if reason not in counts:
            counts[reason] = 0
    counts = counts[["", "pose", "equations", "tolerances"]].rename(columns={"": "feasible"})
    best = table[table["reason"] == ""].groupby("n_sensors")["rms_um"].min()
    return counts.assign(best_um=best).reset_index()


def pick_named(inputs: PlacementInputs, sets: np.ndarray, table: pd.DataFrame) -> pd.DataFrame:
    """Return the rows of the sets that the config names."""
    places = {
        name: int(np.flatnonzero((sets == inputs.set_of(wanted)).all(axis=1))[0])
        for name, wanted in inputs.config.named.items()
    }
    named = table.loc[list(places.values())].copy()
    named.insert(0, "name", list(places))
    return named


def find_enough(front: pd.DataFrame, within: float) -> int:
    """Return the label of the front's first set within a share of its most accurate one."""
    return int(front.index[front["rms_um"] <= (1.0 + within) * front["rms_um"].min()][0])


def pick_simulated(front: pd.DataFrame, named: pd.DataFrame, enough: int, n: int) -> list[int]:
    """Return n sets to simulate: the cheap one that is enough, the named feasible ones, others all over the front."""
    wanted = [int(k) for k in dict.fromkeys([enough, *named.index[named["reason"] == ""]])][:n]
    others = [int(k) for k in front.index if k not in wanted]
    left = min(n - len(wanted), len(others))
    spread = np.linspace(0, len(others) - 1, left).round().astype(int).tolist()
    order = list(dict.fromkeys([*front.index, *wanted]))
    return sorted({*wanted, *(others[k] for k in spread)}, key=order.index)


def tabulate_simulated(table: pd.DataFrame, places: Sequence[int], found: Sequence[Simulated]) -> pd.DataFrame:
    """Return predicted and simulated errors side by side, µm."""
    rows = table.loc[list(places), ["n_sensors", "price", "rms_um", "pattern", "sensors"]].copy()
    rows = rows.rename(columns={"rms_um": "predicted_um"})
    rows["simulated_um"] = [MICROMETRES * one.rms for one in found]
    rows["simulated_error_um"] = [MICROMETRES * one.error for one in found]
    rows["n_machines"] = [one.n_machines for one in found]
    rows["n_failed"] = [one.n_failed for one in found]
    return rows
