"""What an experiment on pose selection found, in sentences computed from its tables."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Self

import numpy as np
import pandas as pd

from bayescal.experiments.frame.results import Results
from bayescal.experiments.selection.compare import Ratio, count_wins, pair_errors, rank_ways
from bayescal.experiments.selection.schema import PublishedConfig, SelectionConfig
from bayescal.experiments.selection.tables import NEAR
from bayescal.experiments.selection.tasks import DESIGN
from bayescal.pose_selection import CRITERIA, METHODS
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
PRINTED = 5e-4  # of a value: half of a unit of the fourth digit is less


@dataclass(frozen=True, eq=False)
class Tables:
    """An experiment's config and tables; ``errors`` has the column ``name``; those that say nothing are empty."""

    config: SelectionConfig
    selections: pd.DataFrame
    summary: pd.DataFrame
    published: pd.DataFrame
    random_sets: pd.DataFrame
    traces: pd.DataFrame
    errors: pd.DataFrame
    error_summary: pd.DataFrame
    timings: pd.DataFrame
    classes: pd.DataFrame

    @classmethod
    def of(cls, config: SelectionConfig, results: Results) -> Self:
        """Return the tables of an experiment's results."""
        names = (
            "selection_summary",
            "published",
            "random_sets",
            "traces",
            "errors",
            "error_summary",
            "timings",
            "classes",
        )
        return cls(config, results.table("selections"), *(results.table(name) for name in names))

    def list_used(self, what: str) -> list[str]:
        """Return the criteria or the methods of the selections, in their order."""
        return [str(name) for name in dict.fromkeys(self.selections[what]) if name != DESIGN]

    def describe(self, what: str, name: str) -> tuple[str, str]:
        """Return title and source of a criterion or a method; one of somebody else's stands in the tables."""
        built_in = (CRITERIA if what == "criterion" else METHODS).get(name)
        if built_in is not None:
            return built_in.title, built_in.source
        rows = [] if self.classes.empty else self.classes[["what", "name", "title", "source"]].to_numpy().tolist()
        told = [(str(title), str(source)) for sort, known, title, source in rows if (sort, known) == (what, name)]
        return told[0] if told else (name, "")

    @property
    def metric(self) -> str:
        """Column of ``errors`` by which ways to choose are ranked."""
        required = self.config.requirements.is_any
        return "simulated_share_of_limits" if required else "mean_position_um"

    @property
    def metric_words(self) -> str:
        """The same in words."""
        if self.metric == "mean_position_um":
            return "mean position error over the workspace"
        return "root mean square pose error over the workspace, in units of the limits"

    @property
    def numbers(self) -> list[int]:
        """Numbers of poses at which several ways were tried."""
        table = self.errors[self.errors["criterion"] != DESIGN]
        return [int(n) for n in sorted(set(table["n_poses"])) if table.loc[table["n_poses"] == n, "name"].nunique() > 1]


def state_verdict(tables: Tables) -> list[Statement]:
    """Return what was found, the published first."""
    statements: list[Statement] = []
    if not tables.published.empty:
        statements += _judge_published(tables.published)
    statements += _judge_methods(tables)
    statements += _judge_boundary(tables)
    section = tables.config.published
    if section is not None and not tables.random_sets.empty:
        statements += _judge_random(tables.random_sets, section)
    if not tables.errors.empty:
        statements += _rank(tables)
        statements += _judge_criteria(tables)
        statements += _judge_designs(tables)
        statements += _judge_prediction(tables)
    return [replace(s, text=s.text[:1].upper() + s.text[1:]) for s in statements]


def state_headline(tables: Tables) -> str:
    """Return the main result in one sentence."""
    if not tables.errors.empty:
        return _recommend(tables)
    if not tables.published.empty:
        reached = int((tables.published["ratio"] > 1.0 - PRINTED).sum())
        return f"{reached} of {len(tables.published)} published indices are reached or exceeded."
    best = tables.summary.sort_values("best").iloc[-1]
    return f"Best {best['criterion']} of {best['n_poses']} poses: {format_significant(best['best'], 4)}."


# --- published ---------------------------------------------------------------------------------------------------


def _judge_published(table: pd.DataFrame) -> list[Statement]:
    statements = []
    for label, rows in table.groupby("label", sort=False):
        reached = rows["ratio"] > 1.0 - PRINTED
        on_average = rows["ratio_of_mean"] > 1.0 - PRINTED
        words = (
            f"{int(reached.sum())} of {len(rows)} printed values are reached by the best of the repeats, "
            f"{int(on_average.sum())} by their mean"
        )
        short = rows[~reached].groupby("criterion", sort=False)["ratio"].min()
        if len(short):
            by = [f"{name} by up to {format_percent(1 - ratio, 1)}" for name, ratio in short.items()]
            words += f"; short are {join_words(by)}"
        level: Level = "good" if reached.all() else "warning"
        title = METHODS[str(label)].title if label in METHODS else str(label)
        statements.append(Statement(f"{words}.", level, f"Published table, {title}"))
    return statements


def _judge_random(sets: pd.DataFrame, section: PublishedConfig) -> list[Statement]:
    groups = sets.groupby("repeat")["value"]
    statements = []
    for what, values, published in (
        ("mean", groups.mean(), section.random_mean),
        ("largest", groups.max(), section.random_max),
    ):
        if published is None:
            continue
        first, off = float(values.iloc[0]), float(values.iloc[0]) / published - 1.0
        inside = bool(values.min() <= published <= values.max())
        words = f"The {what} of {len(sets) // len(values)} random sets is {format_fixed(first, 5)}, published "
        words += f"{format_fixed(published, 5)} "
        words += f"({format_fixed(100 * off, 1, sign=True)} %)"
        if len(values) > 1:
            words += f"; over {len(values)} draws of candidates and sets {format_estimate(values.mean(), values.std())}"
            words += ", the published one within their span" if inside else ", the published one outside their span"
        statements.append(Statement(f"{words}.", "good" if inside else "warning", "Random sets"))
    return statements


def _judge_methods(tables: Tables) -> list[Statement]:
    """Return how often each label finds more than the one before it."""
    rows = tables.selections[tables.selections["method"].isin(["detmax", "tabu", "exchange", "continuous"])]
    labels = list(dict.fromkeys(rows["label"]))
    statements = []
    for one, other in zip(labels[1:], labels[:-1], strict=True):
        more, same, n, gain = count_wins(rows, one, other)
        if n:
            clear = more + same == n or more >= 0.9 * n
            words = f"{one} finds more than {other} in {more} of {n} pairs of the same candidates and start"
            words += f", as much in {same}; half of the pairs gain above {format_percent(gain, 2)}"
            statements.append(Statement(f"{words}.", "good" if clear else "warning", "Methods"))
    return statements


def _judge_boundary(tables: Tables) -> list[Statement]:
    """Return how many of the chosen poses lie at the boundary, where published optima do."""
    if tables.config.published is None or tables.errors.empty:
        return []
    shares = tables.selections.groupby("label", sort=False)["at_boundary"].mean().dropna()
    words = join_words([f"{format_percent(share)} of {label}" for label, share in shares.items()])
    text = f"of the poses chosen, {words} lie within {format_percent(1 - NEAR)} of the limit of a coordinate."
    return [Statement(text, "plain", "Boundary")]


# --- after calibration -------------------------------------------------------------------------------------------


def _own(tables: Tables) -> pd.DataFrame:
    return tables.errors[tables.errors["criterion"] != DESIGN]


def _rank(tables: Tables) -> list[Statement]:
    statements = []
    for n in tables.numbers:
        ranked = rank_ways(_own(tables), n, tables.metric)
        words, unclear = [ranked[0][0]], 0
        for name, ratio in ranked[1:]:
            assert ratio is not None
            unclear += not ratio.clear
            words.append(f"{name} ({_say(ratio)} times the one before{'' if ratio.clear else ', within the scatter'})")
        level: Level = "warning" if unclear else "good"
        statements.append(Statement(f"from best to worst: {', '.join(words)}.", level, f"Order with {n} poses"))
    return statements


def _judge_criteria(tables: Tables) -> list[Statement]:
    """Return I against O1, where both were tried."""
    errors = _own(tables)
    names = {c: set(errors.loc[errors["criterion"] == c, "name"]) - {"random"} for c in ("I", "O1")}
    if not (names["I"] and names["O1"]):
        return []
    one, other = (sorted(names[c])[0] for c in ("I", "O1"))
    statements = []
    for n in tables.numbers:
        simulated, predicted = _against(tables, one, other, n)
        words = f"simulated error {_say(simulated)} times that of O1, predicted {_say(predicted)} times"
        words += "" if simulated.clear else "; the simulated difference is within the scatter"
        level: Level = "good" if simulated.clear and simulated.value < 1.0 else "warning"
        statements.append(Statement(f"{words}.", level, f"I against O1 with {n} poses"))
    return statements


def _against(tables: Tables, one: str, other: str, n: int) -> tuple[Ratio, Ratio]:
    errors = _own(tables)
    part = "share_of_limits" if tables.metric == "simulated_share_of_limits" else "position_um"
    simulated = pair_errors(errors, one, other, n, f"simulated_{part}")
    return simulated, pair_errors(errors, one, other, n, f"predicted_{part}")


def _judge_designs(tables: Tables) -> list[Statement]:
    statements = []
    given = tables.selections[tables.selections["criterion"] == DESIGN].drop_duplicates("label")
    for _, design in given.iterrows():
        n = int(design["n_poses"])
        own = tables.selections[(tables.selections["criterion"] == "O1") & (tables.selections["n_poses"] == n)]
        if own.empty:
            continue
        parts = [
            f"{format_significant(rows['O1'].mean(), 4)} of {label}" for label, rows in own.groupby("label", sort=False)
        ]
        words = f"its O1 is {format_significant(design['O1'], 4)}, beside {join_words(parts)}"
        rows = tables.error_summary.set_index("name")
        rows = rows[rows["n_poses"] == n]
        errors = [f"{name} {_position(rows.loc[name])}" for name in [design["label"], *own["label"].unique()]]
        words += f"; position error in µm: {join_words(errors)}"
        best = float(own["O1"].max())
        level: Level = "good" if design["O1"] >= 0.9 * best else "warning"
        statements.append(Statement(f"{words}.", level, f"Design {design['label']}"))
    return statements


def _position(row: pd.Series) -> str:
    return format_estimate(float(row["mean_position_um"]), float(row["mean_position_um_sd"]))


def _judge_prediction(tables: Tables) -> list[Statement]:
    """Return whether first-order predictions come true."""
    part = tables.metric if tables.metric.startswith("simulated") else "simulated_position_um"
    table = tables.error_summary
    ratio = table[part] / table[part.replace("simulated", "predicted")]
    off = table.loc[(ratio - 1.0).abs() > FIRST_ORDER, "n_poses"]
    few = table["n_poses"] <= (off.max() if len(off) else 0)
    words = "simulated errors are "
    if not few.all():
        words += f"{format_span(list(ratio[~few]), 2)} times those predicted to first order"
        words += f" with {table.loc[~few, 'n_poses'].min()} poses or more" if few.any() else ""
    if few.any():
        words += f"{'' if few.all() else ', '}{format_span(list(ratio[few]), 2)} times"
        words += " those predicted to first order" if few.all() else " with fewer, where the first order does not hold"
    failed = tables.errors.groupby("name", sort=False)["n_failed"].sum()
    if failed.any():
        total = int(failed.sum() + tables.errors["n_machines"].sum())
        parts = join_words([f"{count} of {name}" for name, count in failed.items() if count])
        words += f"; {failed.sum()} of {total} calibrations did not converge and count in nothing: {parts}"
    good = not few.any() and not failed.any()
    return [Statement(f"{words}.", "good" if good else "warning", "Prediction")]


def _recommend(tables: Tables) -> str:
    """Return which way is recommended, and with which numbers of poses it is the best beyond the scatter."""
    ranked = {n: rank_ways(_own(tables), n, tables.metric) for n in tables.numbers}
    if not ranked:
        return "One way to choose poses was tried."
    firsts = [order[0][0] for order in ranked.values()]
    best = max(dict.fromkeys(firsts), key=firsts.count)
    ahead = {n: order[1][1] for n, order in ranked.items() if order[0][0] == best}
    clear = {n: ratio.value for n, ratio in ahead.items() if ratio is not None and ratio.clear}
    words = f"Use {_name_poses(best)}, with the smallest {tables.metric_words}, with {_list(ahead)} poses"
    if not clear:
        return f"{words}, though within the scatter of the next."
    gains = [100.0 * (value - 1.0) for value in clear.values()]
    which = "beyond the scatter" if len(clear) == len(ahead) else f"beyond the scatter with {_list(clear)}"
    return f"{words}; {which}, the error of the next being {format_span(gains)} % larger."


def _list(numbers: Iterable[int]) -> str:
    return join_words([str(n) for n in numbers])


def _name_poses(way: str) -> str:
    return f"{way}-optimal poses" if way in CRITERIA else f"poses by “{way}”"


def _say(ratio: Ratio) -> str:
    if not np.isfinite(ratio.error):
        return format_fixed(ratio.value, 3)
    return format_estimate(ratio.value, max(ratio.error, 1e-4), 3)
