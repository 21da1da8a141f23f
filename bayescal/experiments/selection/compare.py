"""Ways to choose poses set against each other, by pairs: the same candidates, the same machines, the same noise."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import pandas as pd

from bayescal.experiments.selection.tasks import DESIGN

CLEAR = 2.0
"""Standard errors beyond which a difference counts."""
RANDOM = "random"


@dataclass(frozen=True)
class Ratio:
    """One way's error by another's, the geometric mean over pairs.

    Attributes
    ----------
    value, error : float
        With its standard error; NaN of a single pair.
    n : int
        Pairs.
    """

    value: float
    error: float
    n: int

    @property
    def clear(self) -> bool:
        """Whether the ratio differs from one beyond its scatter."""
        return bool(abs(np.log(self.value)) * self.value > CLEAR * self.error)


def name_ways(table: pd.DataFrame) -> pd.Series:
    """Return what each row's way to choose is called: label, criterion, or both, whichever tells them apart.

    Labels go by themselves where each has one criterion, criteria where each has one label. Random sets know no
    criterion.
    """
    plain = (table["label"] == RANDOM) | (table["criterion"] == DESIGN)
    found = table.loc[~plain, ["label", "criterion"]].drop_duplicates()
    if len(found) == found["label"].nunique():
        return table["label"].astype(str)
    one_label = len(found) == found["criterion"].nunique()
    names = table["criterion"] if one_label else table["label"] + ", " + table["criterion"]
    return names.mask(plain, table["label"])


def pair_errors(errors: pd.DataFrame, one: str, other: str, n_poses: int, column: str) -> Ratio:
    """Return the errors of one way by those of another at a number of poses, repeat by repeat.

    Parameters
    ----------
    errors : pandas.DataFrame
        With the column ``name`` of `name_ways`.
    one, other : str
    n_poses : int
    column : str
    """
    rows = errors[errors["n_poses"] == n_poses]
    first, second = (rows[rows["name"] == name].set_index("repeat")[column] for name in (one, other))
    ratios = (first / second).dropna().to_numpy(dtype=np.float64)
    logs = np.log(ratios)
    if not len(logs):
        return Ratio(np.nan, np.nan, 0)
    value = float(np.exp(logs.mean()))
    error = float(value * logs.std(ddof=1) / np.sqrt(len(logs))) if len(logs) > 1 else np.nan
    return Ratio(value, error, len(logs))


def tabulate_pairs(errors: pd.DataFrame, reference: str, part: str) -> pd.DataFrame:
    """Return each way's errors by those of a reference, predicted and simulated, at each number of poses."""
    rows = []
    for n in sorted(set(errors["n_poses"])):
        for name in dict.fromkeys(errors.loc[errors["n_poses"] == n, "name"]):
            if name == reference:
                continue
            simulated = pair_errors(errors, name, reference, n, f"simulated_{part}")
            predicted = pair_errors(errors, name, reference, n, f"predicted_{part}")
            if simulated.n:
                rows.append(
                    {
                        "name": name,
                        "n_poses": n,
                        "predicted": predicted.value,
                        "simulated": simulated.value,
                        "simulated_se": simulated.error,
                        "n_pairs": simulated.n,
                        "clear": simulated.clear,
                    }
                )
    return pd.DataFrame(rows)


def rank_ways(errors: pd.DataFrame, n_poses: int, column: str) -> list[tuple[str, Ratio | None]]:
    """Return the ways from the best to the worst, each with its errors by those of the one before it."""
    rows = errors[errors["n_poses"] == n_poses]
    order = np.log(rows[column]).groupby(rows["name"], sort=False).mean().sort_values().index.tolist()
    result: list[tuple[str, Ratio | None]] = [(str(order[0]), None)]
    for better, worse in pairwise(order):
        result.append((str(worse), pair_errors(errors, worse, better, n_poses, column)))
    return result


def count_wins(selections: pd.DataFrame, one: str, other: str) -> tuple[int, int, int, float]:
    """Return how often one label's criterion is higher than another's, as high, of how many pairs, and the median gain.

    Pairs are of the same criterion, number of poses and repeat.
    """
    keys = ["criterion", "n_poses", "repeat"]
    first, second = (selections[selections["label"] == label].set_index(keys)["value"] for label in (one, other))
    gain = ((first - second) / second.abs()).dropna()
    return (
        int((gain > 1e-9).sum()),
        int((gain.abs() <= 1e-9).sum()),
        len(gain),
        float(gain.median()) if len(gain) else np.nan,
    )
