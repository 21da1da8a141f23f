"""What an experiment on pose selection found, in sentences computed from its tables.

Ways to choose poses are compared by pairs: the same candidates, the same machines, the same noise.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
import pandas as pd

from bayescal.experiments.frame.results import Results
from bayescal.experiments.selection.compute import DESIGN, RANDOM
from bayescal.experiments.selection.schema import SelectionConfig
from bayescal.pose_selection import CRITERIA
from bayescal.report.blocks import Level, Statement
from bayescal.report.numbers import (
    format_estimate,
    format_fixed,
    format_percent,
    format_significant,
    format_span,
    join_words,
)

FIRST_ORDER = 0.2
CLEAR = 2.0
"""Standard errors beyond which a difference counts."""


@dataclass(frozen=True, eq=False)
class Tables:
    """An experiment's config and results; ``["errors"]`` is a table, one without rows where there is none."""

    config: SelectionConfig
    results: Results

    def __getitem__(self, name: str) -> pd.DataFrame:
        return self.results.table(name)

    @property
    def designs(self) -> pd.DataFrame:
        """The selections that are sets of poses of others, each once."""
        table = self["selections"]
        return table[table["criterion"] == DESIGN].drop_duplicates("label")

    @property
    def errors(self) -> pd.DataFrame:
        """Errors after calibrations with poses that were chosen here; empty where none were simulated."""
        table = self["errors"]
        return table if table.empty else table[table["criterion"] != DESIGN]

    @property
    def metric(self) -> str:
        """Column of ``errors`` by which ways to choose are ranked."""
        return "simulated_share_of_limits" if self.config.requirements.is_any else "mean_position_um"

    @property
    def part(self) -> str:
        """What of a pose is compared, simulated and predicted."""
        return "share_of_limits" if self.config.requirements.is_any else "position_um"

    @property
    def numbers(self) -> list[int]:
        """Numbers of poses at which several ways were tried."""
        if self.errors.empty:
            return []
        groups = self.errors.groupby("n_poses")["name"].nunique()
        return [int(n) for n in groups.index[groups > 1]]


@dataclass(frozen=True)
class Ratio:
    """One way's error by another's, the geometric mean over pairs."""

    # with its standard error; NaN of a single pair
    value: float
    error: float
    n: int  # pairs

    @property
    def clear(self) -> bool:
        """Whether the ratio differs from one beyond its scatter."""
        return bool(abs(np.log(self.value)) * self.value > CLEAR * self.error)


def pair_errors(errors: pd.DataFrame, one: str, other: str, n_poses: int, column: str) -> Ratio:
    """Return the errors of one way, by `name_ways`, by those of another at a number of poses, repeat by repeat."""
    rows = errors[errors["n_poses"] == n_poses]
    first, second = (rows[rows["name"] == name].set_index("repeat")[column] for name in (one, other))
    ratios = (first / second).dropna().to_numpy(dtype=np.float64)
    logs = np.log(ratios)
    if not len(logs):
        return Ratio(np.nan, np.nan, 0)
    value = float(np.exp(logs.mean()))
    error = float(value * logs.std(ddof=1) / np.sqrt(len(logs))) if len(logs) > 1 else np.nan
    return Ratio(value, error, len(logs))


def rank_ways(errors: pd.DataFrame, n_poses: int, column: str) -> list[tuple[str, Ratio | None]]:
    """Return the ways from the best to the worst, each with its errors by those of the one before it."""
    rows = errors[errors["n_poses"] == n_poses]
    order = np.log(rows[column]).groupby(rows["name"], sort=False).mean().sort_values().index.tolist()
    result: list[tuple[str, Ratio | None]] = [(str(order[0]), None)]
    for better, worse in pairwise(order):
        result.append((str(worse), pair_errors(errors, worse, better, n_poses, column)))
    return result


type Judgement = Callable[[Tables], list[Statement]]
"""Statements of the verdict; none where the tables say nothing of it."""


def state_verdict(tables: Tables, judgements: Iterable[Judgement]) -> list[Statement]:
    """Return what was found."""
    return [replace(s, text=s.text[:1].upper() + s.text[1:]) for judge in judgements for s in judge(tables)]


def state_headline(tables: Tables) -> str:
    """Return the main result in one sentence."""
    if not tables["errors"].empty:
        return _recommend(tables)
    best = tables["selection_summary"].sort_values("best").iloc[-1]
    return f"Best {best['criterion']} of {best['n_poses']} poses: {format_significant(best['best'], 4)}."


def judge_methods(tables: Tables) -> list[Statement]:
    """Return how often each label finds more than the one before it."""
    rows = tables["selections"]
    rows = rows[rows["method"].isin(["detmax", "tabu", "exchange", "continuous"])]
    labels = list(dict.fromkeys(rows["label"]))
    statements = []
    for one, other in zip(labels[1:], labels[:-1], strict=True):
        first, second = (
            rows[rows["label"] == x].set_index(["criterion", "n_poses", "repeat"])["value"] for x in (one, other)
        )
        gains = ((first - second) / second.abs()).dropna()
        more, same, n = int((gains > 1e-9).sum()), int((gains.abs() <= 1e-9).sum()), len(gains)
        if n:
            clear = more + same == n or more >= 0.9 * n
            words = f"{one} finds more than {other} in {more} of {n} pairs of the same candidates and start"
            words += f", as much in {same}; half of the pairs gain above {format_percent(float(gains.median()), 2)}"
            statements.append(Statement(f"{words}.", "good" if clear else "warning", "Methods"))
    return statements


def judge_order(tables: Tables) -> list[Statement]:
    """Return the ways from the best to the worst, at each number of poses."""
    statements = []
    for n in tables.numbers:
        ranked = rank_ways(tables.errors, n, tables.metric)
        words, unclear = [ranked[0][0]], 0
        for name, ratio in ranked[1:]:
            assert ratio is not None
            unclear += not ratio.clear
            words.append(f"{name} ({_say(ratio)} times the one before{'' if ratio.clear else ', within the scatter'})")
        level: Level = "warning" if unclear else "good"
        statements.append(Statement(f"from best to worst: {', '.join(words)}.", level, f"Order with {n} poses"))
    return statements


def judge_criteria(tables: Tables) -> list[Statement]:
    """Return I against O1, where both were tried."""
    errors = tables.errors
    if errors.empty:
        return []
    names = {c: set(errors.loc[errors["criterion"] == c, "name"]) - {RANDOM} for c in ("I", "O1")}
    if not (names["I"] and names["O1"]):
        return []
    one, other = (sorted(names[c])[0] for c in ("I", "O1"))
    statements = []
    for n in tables.numbers:
        simulated, predicted = (
            pair_errors(errors, one, other, n, f"{what}_{tables.part}") for what in ("simulated", "predicted")
        )
        words = f"simulated error {_say(simulated)} times that of O1, predicted {_say(predicted)} times"
        words += "" if simulated.clear else "; the simulated difference is within the scatter"
        level: Level = "good" if simulated.clear and simulated.value < 1.0 else "warning"
        statements.append(Statement(f"{words}.", level, f"I against O1 with {n} poses"))
    return statements


def judge_designs(tables: Tables) -> list[Statement]:
    """Return O1 and errors of others' sets of poses, and those of the ways tried here."""
    if tables["errors"].empty:
        return []
    statements = []
    selections, summary = tables["selections"], tables["error_summary"].set_index("name")
    for _, design in tables.designs.iterrows():
        n = int(design["n_poses"])
        own = selections[(selections["criterion"] == "O1") & (selections["n_poses"] == n)]
        if own.empty:
            continue
        parts = [
            f"{format_significant(rows['O1'].mean(), 4)} of {label}" for label, rows in own.groupby("label", sort=False)
        ]
        words = f"its O1 is {format_significant(design['O1'], 4)}, beside {join_words(parts)}"
        rows = summary.loc[summary["n_poses"] == n, ["mean_position_um", "mean_position_um_sd"]].astype(float)
        errors = [f"{name} {format_estimate(*rows.loc[name])}" for name in [design["label"], *own["label"].unique()]]
        words += f"; position error in µm: {join_words(errors)}"
        best = float(own["O1"].max())
        level: Level = "good" if design["O1"] >= 0.9 * best else "warning"
        statements.append(Statement(f"{words}.", level, f"Design {design['label']}"))
    return statements


def judge_prediction(tables: Tables) -> list[Statement]:
    """Return whether first-order predictions come true."""
    table, errors = tables["error_summary"], tables["errors"]
    if errors.empty:
        return []
    ratio = table[f"simulated_{tables.part}"] / table[f"predicted_{tables.part}"]
    off = table.loc[(ratio - 1.0).abs() > FIRST_ORDER, "n_poses"]
    few = table["n_poses"] <= (off.max() if len(off) else 0)
    words = "simulated errors are "
    if not few.all():
        words += f"{format_span(list(ratio[~few]), 2)} times those predicted to first order"
        words += f" with {table.loc[~few, 'n_poses'].min()} poses or more" if few.any() else ""
    if few.any():
        words += f"{'' if few.all() else ', '}{format_span(list(ratio[few]), 2)} times"
        words += " those predicted to first order" if few.all() else " with fewer, where the first order does not hold"
    failed = errors.groupby("name", sort=False)["n_failed"].sum()
    if failed.any():
        total = int(failed.sum() + errors["n_machines"].sum())
        parts = join_words([f"{count} of {name}" for name, count in failed.items() if count])
        words += f"; {failed.sum()} of {total} machines could not be identified and count in nothing: {parts}"
    good = not few.any() and not failed.any()
    return [Statement(f"{words}.", "good" if good else "warning", "Prediction")]


JUDGEMENTS: tuple[Judgement, ...] = (judge_methods, judge_order, judge_criteria, judge_designs, judge_prediction)
"""All judgements of the verdict, in their order."""


def _recommend(tables: Tables) -> str:
    """Return which way is recommended, and with which numbers of poses it is the best beyond the scatter."""
    ranked = {n: rank_ways(tables.errors, n, tables.metric) for n in tables.numbers}
    if not ranked:
        return "One way to choose poses was tried."
    firsts = [order[0][0] for order in ranked.values()]
    best = max(dict.fromkeys(firsts), key=firsts.count)
    ahead = {n: order[1][1] for n, order in ranked.items() if order[0][0] == best}
    clear = {n: ratio.value for n, ratio in ahead.items() if ratio is not None and ratio.clear}
    poses = f"{best}-optimal poses" if best in CRITERIA else f"poses by “{best}”"
    error = "mean position error over the workspace"
    if tables.config.requirements.is_any:
        error = "root mean square pose error over the workspace, in units of the limits"
    words = f"Use {poses}, with the smallest {error}, with {join_words([str(n) for n in ahead])} poses"
    if not clear:
        return f"{words}, though within the scatter of the next."
    gains = [100.0 * (value - 1.0) for value in clear.values()]
    which = (
        "beyond the scatter"
        if len(clear) == len(ahead)
        else f"beyond the scatter with {join_words([str(n) for n in clear])}"
    )
    return f"{words}; {which}, the error of the next being {format_span(gains)} % larger."


def _say(ratio: Ratio) -> str:
    if not np.isfinite(ratio.error):
        return format_fixed(ratio.value, 3)
    return format_estimate(ratio.value, max(ratio.error, 1e-4), 3)
