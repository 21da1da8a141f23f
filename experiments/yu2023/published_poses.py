"""Pose selection against what its source printed: indices, iterations and random sets."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path

import matplotlib.figure as plt
import numpy as np
import pandas as pd
from pydantic import Field

from bayescal.config.classes import label_class
from bayescal.config.sections import InputFile, Positive, Section
from bayescal.errors import InputError
from bayescal.experiments.runner.parallel import Run
from bayescal.experiments.runner.results import Results
from bayescal.experiments.selection.compute import KEY
from bayescal.experiments.selection.inputs import SelectionInputs
from bayescal.experiments.selection.kind import Selection
from bayescal.experiments.selection.page import (
    BLOCKS,
    COLOURS,
    PageBlock,
    build_page,
    format_spread,
    format_value,
    show_random_sets,
)
from bayescal.experiments.selection.schema import Count, SelectionConfig, label_of
from bayescal.experiments.selection.verdict import JUDGEMENTS, Tables, judge_methods, state_headline
from bayescal.files.csv_tables import read_table
from bayescal.report.blocks import Cell, Column, Figure, Level, Page, PageSection, Statement, make_section, make_table
from bayescal.report.numbers import capitalise, format_fixed, format_percent
from bayescal.report.style import INK, RED
from detmax import Detmax, TabuDetmax

PRINTED = 5e-4  # of a value: half of a unit of the fourth digit is less
TITLES = {method.name: method.title for method in (Detmax, TabuDetmax)}


class PublishedConfig(Section):
    """What the source printed: a table of label, criterion, n_poses and value; and of random sets mean and maximum."""

    source: str
    """What the page calls the source."""
    table: InputFile | None = None
    """CSV file of printed values: label, criterion, n_poses, value."""
    random_mean: Positive | None = None
    """Printed mean of random sets [unit of the criterion]."""
    random_max: Positive | None = None
    """Printed maximum of random sets [unit of the criterion]."""
    iterations: dict[str, Count] = Field(default={})
    """Printed numbers of iterations by label."""


class PublishedPosesConfig(SelectionConfig):
    """An experiment on pose selection that somebody has published."""

    kind: str  # type: ignore[assignment]  # where that of the package has a name
    """The file and this kind."""
    published: PublishedConfig
    """Printed values to compare with."""


class PublishedPoses(Selection):
    """Which poses to measure, compared with what was published."""

    schema = PublishedPosesConfig

    def read(self, config: SelectionConfig, folder: Path) -> SelectionInputs:
        """Return what the experiment computes with; the published table is read too, to find its faults."""
        inputs = super().read(config, folder)
        labels = {label_of(choice) for choice in config.selections}
        for label in published_of(config).iterations:
            if label not in labels:
                raise InputError(f"published.iterations: found {label!r}, expected some of {', '.join(sorted(labels))}")
        published = read_published(config, folder)
        if published is not None:
            _check_selected(config, published)
        return inputs

    def compute(self, inputs: SelectionInputs, run: Run) -> Results:
        """Return the selections with a table of published values and those found."""
        results = super().compute(inputs, run)
        published = read_published(inputs.config, inputs.folder)
        if published is None:
            return results
        table = results.tables["selection_summary"].merge(published, on=KEY, how="inner")
        table["ratio"] = table["best"] / table["published"]
        table["ratio_of_mean"] = table["mean"] / table["published"]
        return replace(results, tables={**results.tables, "published": table})

    def page(self, results: Results) -> Page:
        """Return the page, what was published first."""
        config = self.config_of(results)
        section = published_of(config)
        printed = {"mean": section.random_mean, "largest": section.random_max}
        random_sets = partial(show_random_sets, printed=printed)
        blocks: tuple[PageBlock, ...] = (show_published, show_traces, random_sets, *BLOCKS[1:])
        judgements = (judge_published, judge_methods, judge_random, *JUDGEMENTS[1:])
        return build_page(Tables(config, results), blocks, judgements, state_published)


def published_of(config: SelectionConfig) -> PublishedConfig:
    """Return what the source of an experiment of this kind printed."""
    assert isinstance(config, PublishedPosesConfig)
    return config.published


def read_published(config: SelectionConfig, folder: Path) -> pd.DataFrame | None:
    """Return the published values of criteria; None where no table is given.

    Raises
    ------
    InputError
        Where the table has other columns than label, criterion, n_poses and value, a value of zero or a row twice.
    """
    if (file := published_of(config).table) is None:
        return None
    table = read_table(folder / file, [*KEY, "value"])
    labels, criteria, numbers = table.text("label"), table.text("criterion"), table.numbers(["n_poses", "value"])
    for row in np.flatnonzero(numbers[:, 1] == 0.0):
        raise InputError(f"{table.where(int(row))}: value: found 0, expected another, for it is divided by")
    counts = numbers[:, 0].astype(int)
    keys = list(zip(labels, criteria, counts, strict=True))
    table.check_unique([(label, criterion, str(n)) for label, criterion, n in keys], "/".join(KEY))
    return pd.DataFrame({"label": labels, "criterion": criteria, "n_poses": counts, "published": numbers[:, 1]})


def _check_selected(config: SelectionConfig, published: pd.DataFrame) -> None:
    """Raise InputError where nothing that is selected was published."""
    keys = set(zip(published["label"], published["criterion"], published["n_poses"], strict=True))
    selected = {
        (label_of(choice), label_class(criterion), n)
        for choice in config.selections
        for criterion in choice.criteria
        for n in choice.n_poses
    }
    if not selected & keys and not {design.name for design in config.designs} & set(published["label"]):
        raise InputError(
            "published.table: found nothing that [[selections]] has, expected its labels, criteria and n_poses"
        )


# --- verdict -----------------------------------------------------------------------------------------------------


def state_published(tables: Tables) -> str:
    """Return how many published indices are reached, where nothing says more."""
    table = tables["published"]
    if table.empty or not tables.errors.empty:
        return state_headline(tables)
    reached = int((table["ratio"] > 1.0 - PRINTED).sum())
    return f"{reached} of {len(table)} published indices are reached or exceeded."


def judge_published(tables: Tables) -> list[Statement]:
    """Return how many printed values are reached, by label."""
    table = tables["published"]
    statements = []
    for label, rows in table.groupby("label", sort=False) if len(table) else ():
        reached = rows["ratio"] > 1.0 - PRINTED
        n, text = int(reached.sum()), f"{int(reached.sum())} of {len(rows)} printed values are reached"
        short = rows[~reached].groupby("criterion", sort=False)["ratio"].min()
        if len(short):
            text += f"; {short.idxmin()} is short by up to {format_percent(1 - float(short.min()), 1)}"
        title = TITLES.get(str(label), str(label))
        statements.append(
            Statement(
                f"{text}.",
                "good" if reached.all() else "warning",
                f"Published table, {title}",
                value=n,
                limit=len(rows),
            )
        )
    return statements


def judge_random(tables: Tables) -> list[Statement]:
    """Return whether the printed mean and maximum of random sets are those found."""
    sets, section = tables["random_sets"], published_of(tables.config)
    if sets.empty:
        return []
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
        words = f"{capitalise(what)} of {len(sets) // len(values)} random sets: {format_fixed(first, 5)}, published "
        words += f"{format_fixed(published, 5)} ({format_fixed(100 * off, 1, sign=True)} %)."
        level: Level = "good" if inside else "warning"
        statements.append(Statement(words, level, "Random sets", value=first, limit=published))
    return statements


# --- page --------------------------------------------------------------------------------------------------------


def show_published(tables: Tables) -> PageSection | None:
    """Return published values and those found."""
    table = tables["published"]
    if table.empty:
        return None
    columns = [
        Column("Method", kind="text"),
        Column("Index", kind="text"),
        Column("Poses"),
        Column("printed", group="published"),
        Column("best", group="found"),
        Column("mean ± sd", group="found"),
        Column("repeats", group="found"),
        Column("best", "%", "found against published"),
        Column("mean", "%", "found against published"),
    ]
    rows: list[list[str | Cell]] = [
        [
            str(row["label"]),
            str(row["criterion"]),
            str(row["n_poses"]),
            format_value(row["published"]),
            format_value(row["best"]),
            format_spread(row["mean"], row["sd"]),
            str(row["n_repeats"]),
            Cell(
                format_fixed(100 * (row["ratio"] - 1), 1, sign=True),
                "good" if row["ratio"] > 1.0 - PRINTED else "warning",
            ),
            format_fixed(100 * (row["ratio_of_mean"] - 1), 1, sign=True),
        ]
        for _, row in table.iterrows()
    ]
    figure = Figure(
        "published",
        "Indices found, by those published: best of the repeats, and mean with standard deviation over repeats.",
        partial(draw_ratios, table),
    )
    caption = f"Indices published by {published_of(tables.config).source} and found here."
    return make_section("Published and found", (), (make_table(caption, columns, rows),), (figure,))


def show_traces(tables: Tables) -> PageSection | None:
    """Return the traces of the first number of poses, where there are methods that go on from set to set."""
    iterations, traces = published_of(tables.config).iterations, tables["traces"]
    if not iterations or traces.empty:
        return None
    criterion, n = str(traces["criterion"].iloc[0]), int(traces["n_poses"].iloc[0])
    rows = tables["selections"]
    rows = rows[(rows["criterion"] == criterion) & (rows["n_poses"] == n)]
    columns = [
        Column("Method", kind="text"),
        Column("iterations", group="published"),
        Column("iterations", group="found"),
        Column(f"{criterion}, first repeat", group="found"),
        Column(f"{criterion}, mean ± sd", group="found"),
    ]
    body = []
    for label, group in rows.groupby("label", sort=False):
        if label in iterations:
            steps, value = group["n_iterations"], group["value"]
            span = f"{steps.min()} to {steps.max()}" if steps.min() < steps.max() else str(steps.min())
            first, spread = format_value(value.iloc[0]), format_spread(value.mean(), value.std())
            body.append([str(label), str(iterations[str(label)]), span, first, spread])
    figure = Figure(
        "traces",
        f"{criterion} of {n} poses by iteration: the first repeat thick, the others, with other candidates and another "
        "start, thin.",
        partial(draw_traces, traces, criterion, n, iterations),
    )
    table = make_table(f"Iterations and {criterion} of {n} poses.", columns, body)
    return make_section("The way there", (), (table,), (figure,))


def draw_traces(traces: pd.DataFrame, criterion: str, n_poses: int, published: Mapping[str, int]) -> plt.Figure:
    """Return the criterion by iteration, one line per repeat, after Yu, Wu and Wang 2023, figure 6.

    Parameters
    ----------
    traces : pandas.DataFrame
        Columns ``label``, ``criterion``, ``n_poses``, ``repeat``, ``iteration`` and ``value``.
    criterion : str
    n_poses : int
    published : mapping of label to int
        How many iterations were printed.
    """
    rows = traces[(traces["criterion"] == criterion) & (traces["n_poses"] == n_poses)]
    figure = plt.Figure(figsize=(7.2, 3.6), layout="constrained")
    axes = figure.subplots()
    for k, (label, part) in enumerate(rows.groupby("label", sort=False)):
        colour = COLOURS[k % len(COLOURS)]
        for repeat, one in part.groupby("repeat"):
            first = repeat == part["repeat"].min()
            axes.plot(
                one["iteration"],
                one["value"],
                color=colour,
                linewidth=1.6 if first else 0.7,
                alpha=1.0 if first else 0.35,
                label=str(label) if first else None,
                zorder=4.0 - 0.1 * k,  # lines begin alike: that of the first label, the shorter one, stays visible
            )
        if label in published:
            name = f"{published[str(label)]} iterations printed ({label})"
            axes.axvline(published[str(label)], color=colour, linewidth=0.8, linestyle=":", label=name)
    axes.set(xlabel="Iteration", ylabel=f"{criterion} of {n_poses} poses")
    axes.grid(visible=True)
    axes.legend(loc="lower right")
    return figure


def draw_ratios(table: pd.DataFrame) -> plt.Figure:
    """Return values found by those published, best and mean with standard deviation over repeats.

    Parameters
    ----------
    table : pandas.DataFrame
        Columns ``label``, ``criterion``, ``n_poses``, ``published``, ``best``, ``mean`` and ``sd``.
    """
    labels = list(dict.fromkeys(table["label"]))
    figure = plt.Figure(figsize=(9.0, 3.2), layout="constrained")
    all_axes = figure.subplots(1, len(labels), sharey=True, squeeze=False)[0]
    for axes, label in zip(all_axes, labels, strict=True):
        rows = table[table["label"] == label]
        at = np.arange(len(rows))
        mean, sd = rows["mean"] / rows["published"], rows["sd"].fillna(0.0) / rows["published"]
        axes.axhline(1.0, color=RED, linewidth=1.0, label="published")
        axes.errorbar(
            at, mean, yerr=sd, color=INK, marker="o", markersize=4, linestyle="none", capsize=2, label="mean ± sd"
        )
        axes.plot(at, rows["best"] / rows["published"], "^", color=COLOURS[0], markersize=5, label="best")
        names = [f"{c} {n}" for c, n in zip(rows["criterion"], rows["n_poses"], strict=True)]
        axes.set_xticks(at, names, rotation=90)
        axes.set_title(label)
        axes.grid(visible=True, axis="y")
    all_axes[0].set_ylabel("Found / published")
    all_axes[-1].legend(loc="best")
    return figure
