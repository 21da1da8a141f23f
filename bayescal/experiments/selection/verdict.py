"""What an experiment on pose selection found, in sentences computed from its tables.

Ways to choose poses are compared by pairs: the same candidates, the same machines, the same noise.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
import pandas as pd

from bayescal.experiments.runner.results import Results
from bayescal.experiments.selection.compute import DESIGN, RANDOM
from bayescal.experiments.selection.rows import CalibrationErrorSummaryRow, SelectionRow, SelectionSummaryRow
from bayescal.experiments.selection.schema import SelectionConfig
from bayescal.pose_selection import CRITERIA
from bayescal.report.blocks import KeyFigure, Level, Statement
from bayescal.report.numbers import (
    format_estimate,
    format_fixed,
    format_significant,
    format_span,
    join_words,
    name_some,
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
        return "simulated_over_limits" if self.config.requirements.is_any else "mean_position_um"

    @property
    def part(self) -> str:
        """What of a pose is compared, simulated and predicted."""
        return "over_limits" if self.config.requirements.is_any else "position_um"

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
    best = max(SelectionSummaryRow.read(tables["selection_summary"]), key=lambda row: row.best)
    return f"Best {best.criterion} of {best.n_poses} poses: {format_significant(best.best, 4)}."


def judge_methods(tables: Tables) -> list[Statement]:
    """Return how often each label finds more than the one before it."""
    rows = tables["selections"]
    rows = rows[~rows["method"].isin([DESIGN, RANDOM])]
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
            median = 100.0 * float(gains.median())
            words = f"{one} exceeds {other} in {more} of {n} pairs, equal in {same}; median gain"
            words += f" {format_fixed(median, 2)} %."
            level: Level = "good" if clear else "warning"
            statements.append(Statement(words, level, "Methods", value=median, limit=0.0, unit="%"))
    return statements


def judge_order(tables: Tables) -> list[Statement]:
    """Return the ways from the best to the worst, at each number of poses."""
    statements = []
    for n in tables.numbers:
        (first, _), (second, ratio) = rank_ways(tables.errors, n, tables.metric)[:2]
        assert ratio is not None
        text = f"{first} is best; error of {second} {_say(ratio)}-fold."
        level: Level = "good" if ratio.clear else "warning"
        statements.append(Statement(text, level, f"Best of {n} poses", value=ratio.value, limit=1.0))
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
        words = f"I-optimal / O1-optimal error: simulated {_say(simulated)}, predicted {_say(predicted)}."
        level: Level = "good" if simulated.clear and simulated.value < 1.0 else "warning"
        statements.append(Statement(words, level, f"I against O1 with {n} poses", value=simulated.value, limit=1.0))
    return statements


def judge_designs(tables: Tables) -> list[Statement]:
    """Return O1 and errors of others' sets of poses, and those of the ways tried here."""
    if tables["errors"].empty:
        return []
    statements = []
    selections = tables["selections"]
    for design in SelectionRow.read(tables.designs):
        own = selections[(selections["criterion"] == "O1") & (selections["n_poses"] == design.n_poses)]
        if own.empty:
            continue
        best, index = own.groupby("label", sort=False)["O1"].mean().max(), design.others["O1"]
        words = f"O1 index {format_significant(index, 4)}; best found here {format_significant(best, 4)}."
        level: Level = "good" if index >= 0.9 * float(own["O1"].max()) else "warning"
        lead = f"Design {design.label}"
        statements.append(Statement(words, level, lead, value=index, limit=float(best)))
        rows = CalibrationErrorSummaryRow.read(tables["error_summary"])
        row = next(one for one in rows if (one.name, one.n_poses) == (design.label, design.n_poses))
        mean, sd = row.mean_position_um, row.mean_position_um_sd
        words = f"Mean position error {format_estimate(mean, sd)} µm."
        statements.append(Statement(words, "plain", lead, value=mean, unit="µm"))
    return statements


def judge_prediction(tables: Tables) -> list[Statement]:
    """Return whether first-order predictions come true."""
    table, errors = tables["error_summary"], tables["errors"]
    if errors.empty:
        return []
    ratio = table[f"simulated_{tables.part}"] / table[f"predicted_{tables.part}"]
    off = table.loc[(ratio - 1.0).abs() > FIRST_ORDER, "n_poses"]
    few = table["n_poses"] <= (off.max() if len(off) else 0)
    found = list[Statement]()
    sides: tuple[tuple[pd.Series, Level, str], ...] = ((~few, "good", "or more"), (few, "warning", "or fewer"))
    for chosen, level, which in sides:
        if chosen.any():
            n = table.loc[chosen, "n_poses"]
            span, at = format_span(list(ratio[chosen]), 2), n.min() if level == "good" else n.max()
            text = f"Simulated errors / first-order prediction: {span} with {at} poses {which}."
            worst = float(ratio[chosen].iloc[int((ratio[chosen] - 1.0).abs().argmax())])
            found.append(Statement(text, level, "Prediction", value=worst, limit=1.0))
    failed = errors.groupby("name", sort=False)["n_failed"].sum()
    if failed.any():
        total = int(failed.sum() + errors["n_machines"].sum())
        parts = name_some([f"{name} ({count})" for name, count in failed.items() if count])
        text = f"{failed.sum()} of {total} fits failed (excluded): {parts}."
        found.append(Statement(text, "warning", "Prediction", value=int(failed.sum()), limit=0.0))
    return found


def list_key_figures(tables: Tables) -> list[KeyFigure]:
    """Return the best way to choose poses and its errors, or the best criterion of a selection, and what was tried."""
    selections, summary = tables["selections"], SelectionSummaryRow.read(tables["selection_summary"])
    best = max(summary, key=lambda row: row.best)
    found = [
        KeyFigure("Parameters", str(tables.results.summary["n_parameters"])),
        KeyFigure("Selections", str(len(selections))),
        KeyFigure(f"Best {best.criterion} of {best.n_poses} poses", format_significant(best.best, 4)),
    ]
    if tables.numbers:
        n = tables.numbers[-1]
        ranked = rank_ways(tables.errors, n, tables.metric)
        ratio = ranked[1][1]
        assert ratio is not None
        level: Level = "good" if ratio.clear else "warning"
        found.append(KeyFigure(f"Best of {n} poses", ranked[0][0], f"next: × {format_fixed(ratio.value, 3)}", level))
        rows = CalibrationErrorSummaryRow.read(tables["error_summary"])
        row = next(one for one in rows if (one.name, one.n_poses) == (ranked[0][0], n))
        error = format_estimate(row.mean_position_um, row.mean_position_um_sd)
        found.append(KeyFigure("its mean position error", error, "µm"))
    return found if len(found) > 3 else [*found, KeyFigure("Criteria", str(selections["criterion"].nunique()))]


JUDGEMENTS: tuple[Judgement, ...] = (judge_methods, judge_order, judge_criteria, judge_designs, judge_prediction)
"""All judgements of the verdict, in their order."""


def _recommend(tables: Tables) -> str:
    """Return which way is recommended, and by how much it is better than the next."""
    ranked = {n: rank_ways(tables.errors, n, tables.metric) for n in tables.numbers}
    if not ranked:
        return "One method was tried."
    firsts = [order[0][0] for order in ranked.values()]
    best = max(dict.fromkeys(firsts), key=firsts.count)
    ahead = {n: order[1][1] for n, order in ranked.items() if order[0][0] == best}
    clear = {n: ratio.value for n, ratio in ahead.items() if ratio is not None and ratio.clear}
    poses = f"{best}-optimal poses" if best in CRITERIA else f"poses by “{best}”"
    error = "pose error (rms, of the limits)"
    if not tables.config.requirements.is_any:
        error = "mean position error"
    words = f"Use {poses}: smallest {error} with {join_words([str(n) for n in ahead])} poses."
    if not clear:
        return f"{words} The next is within scatter."
    gains = format_span([100.0 * (value - 1.0) for value in clear.values()])
    which = "" if len(clear) == len(ahead) else f" with {join_words([str(n) for n in clear])} poses"
    return f"{words} Next: {gains} % larger error{which}."


def _say(ratio: Ratio) -> str:
    if not np.isfinite(ratio.error):
        return format_fixed(ratio.value, 3)
    return format_estimate(ratio.value, max(ratio.error, 1e-4), 3)
