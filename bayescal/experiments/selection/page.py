"""The page of an experiment on pose selection: a list of blocks, each of which shows something or nothing."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path

import matplotlib.figure as plt
import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.ticker import FuncFormatter, LogLocator, MaxNLocator, NullFormatter

from bayescal.experiments.runner.blocks import show_sections
from bayescal.experiments.selection.compute import DESIGN, RANDOM
from bayescal.experiments.selection.rows import (
    ROWS,
    CalibrationErrorSummaryRow,
    SelectionClassRow,
    SelectionRow,
    SelectionSummaryRow,
)
from bayescal.experiments.selection.schema import SelectionConfig
from bayescal.experiments.selection.verdict import (
    JUDGEMENTS,
    Judgement,
    Tables,
    list_key_figures,
    pair_errors,
    state_headline,
    state_verdict,
)
from bayescal.experiments.shared.origin import name_origin
from bayescal.files.rows import check_tables
from bayescal.pose_selection import CRITERIA, METHODS
from bayescal.pose_selection.observability import INDICES
from bayescal.report.blocks import Column, Figure, Page, PageSection, Statement, Table, make_section, make_table
from bayescal.report.numbers import (
    MINUS,
    NO_VALUE,
    format_estimate,
    format_fixed,
    format_plain,
    format_scientific,
    format_significant,
)
from bayescal.report.style import GREY, INK, LEG_COLOURS, MARKERS, PALE, RED

KIND = "Pose selection"
SMALL_DIFFERENCE = 1e-2
COLOURS = (LEG_COLOURS[4], LEG_COLOURS[5], LEG_COLOURS[2], LEG_COLOURS[3], LEG_COLOURS[0], LEG_COLOURS[1])

type PageBlock = Callable[[Tables], PageSection | None]
"""A part of the page; None where these results have nothing for it."""


def format_spread(mean: float, sd: float) -> str:
    """Return mean ± sd of a number of any size; the mean alone without an sd."""
    if not sd > 0:
        return format_value(mean)
    if mean == 0.0 or abs(mean) >= SMALL_DIFFERENCE:
        return format_estimate(mean, sd)
    power = -math.floor(math.log10(abs(mean)))
    return f"({format_estimate(mean * 10.0**power, sd * 10.0**power)})e{MINUS}{power}"


def format_value(value: float) -> str:
    """Return a number of any size to four digits."""
    if value == 0.0 or abs(value) >= SMALL_DIFFERENCE:
        return format_significant(value, 4)
    return format_scientific(value, 4)


def show_random_sets(tables: Tables, printed: Mapping[str, float | None] | None = None) -> PageSection | None:
    """Return how many random sets spread; ``printed`` is what a source has of their ``mean`` and ``largest``."""
    sets = tables["random_sets"]
    if sets.empty:
        return None
    criterion, n = str(sets["criterion"].iloc[0]), int(sets["n_poses"].iloc[0])
    groups = sets.groupby("repeat")["value"]
    columns = [
        Column("", kind="text"),
        *([] if printed is None else [Column("published")]),
        Column("first draw", group="found"),
        Column("mean ± sd over draws", group="found"),
    ]
    rows = [
        [
            what,
            *([] if printed is None else [NO_VALUE if (x := printed[what]) is None else format_value(x)]),
            format_value(values.iloc[0]),
            format_spread(values.mean(), values.std()),
        ]
        for what, values in (("mean", groups.mean()), ("largest", groups.max()))
    ]
    figure = Figure(
        "random_sets",
        f"{criterion} of random sets of {n} poses.",
        partial(draw_random_sets, sets, criterion, printed or {}),
    )
    return make_section("Random sets", (), (make_table(f"{criterion} of random sets.", columns, rows),), (figure,))


def draw_random_sets(sets: pd.DataFrame, criterion: str, printed: Mapping[str, float | None]) -> plt.Figure:
    """Return the histogram of a criterion over random sets of the first repeat, after figure 7.

    ``printed`` has ``mean`` and ``largest`` as published.
    """
    values = sets.loc[sets["repeat"] == sets["repeat"].min(), "value"].to_numpy()
    figure = plt.Figure(figsize=(7.2, 3.4), layout="constrained")
    axes = figure.subplots()
    axes.hist(values, bins=40, color=PALE, edgecolor=GREY, linewidth=0.5)
    for value, label, style in ((values.mean(), "mean", "-"), (values.max(), "largest", "--")):
        axes.axvline(value, color=INK, linewidth=1.3, linestyle=style, label=f"{label} found {format_fixed(value, 5)}")
    for label, style in (("mean", "-"), ("largest", "--")):
        if (published := printed.get(label)) is not None:
            name = f"{label} published {format_fixed(published, 5)}"
            axes.axvline(published, color=RED, linewidth=1.3, linestyle=style, label=name)
    axes.set(xlabel=criterion, ylabel=f"Sets of {len(values)}")
    axes.legend(loc="upper left")
    return figure


def show_accuracy(tables: Tables) -> PageSection | None:
    """Return predicted and simulated errors after calibrations with the poses, and ways against each other."""
    if tables["errors"].empty:
        return None
    wanted = tables.config.calibrations
    assert wanted is not None
    how = "with priors" if wanted.use_priors else "by weighted least squares"
    text = (f"{wanted.machines} simulated calibrations per set, {how}.",)
    summary = tables["error_summary"]
    own, designs = summary[summary["criterion"] != DESIGN], summary[summary["criterion"] == DESIGN]
    quantities = {"mean_position_um": "Mean position error, µm"}
    if tables.config.requirements.is_any:
        quantities["simulated_over_limits"] = "Pose error / limit"
    else:
        quantities["simulated_rotation_arcsec"] = "Rms rotation error, arcsec"
    figures = [
        Figure(
            "errors",
            "Simulated pose errors: mean, sd over repeats.",
            partial(draw_errors, own, designs, quantities),
        )
    ]
    observed = own.loc[(own["criterion"] == "O1") & (own["name"] != RANDOM), "name"]
    if own["criterion"].nunique() > 1 and not observed.empty:
        reference = str(observed.iloc[0])
        pairs = tabulate_pairs(tables.errors, reference, tables.part)
        caption = f"Pose errors / {reference}: geometric mean."
        figures.append(Figure("pairs", caption, partial(draw_paired, pairs[pairs["name"] != RANDOM], reference)))
    return make_section("Accuracy", text, (_tabulate_errors(summary),), figures, wide=True)


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


def _tabulate_errors(summary: pd.DataFrame) -> Table:
    columns = [Column("Method", kind="text"), Column("Poses")]
    for title, unit in (("Position, rms", "µm"), ("Rotation, rms", "arcsec"), ("rms / limit", "")):
        columns += [Column("predicted", unit, title), Column("simulated ± se", unit, title)]
    columns += [Column("simulated ± sd", "µm", "Position, mean"), Column("rms", "tolerances", "Parameters")]
    columns.append(Column("failed"))
    rows = []
    for row in CalibrationErrorSummaryRow.read(summary):
        cells = [row.name, str(row.n_poses)]
        for predicted, simulated, error in (
            (row.predicted_position_um, row.simulated_position_um, row.simulated_position_um_se),
            (row.predicted_rotation_arcsec, row.simulated_rotation_arcsec, row.simulated_rotation_arcsec_se),
            (row.predicted_over_limits, row.simulated_over_limits, row.simulated_over_limits_se),
        ):
            cells += [format_significant(predicted, 3), format_estimate(simulated, error)]
        cells.append(format_estimate(row.mean_position_um, row.mean_position_um_sd))
        rows.append([*cells, format_significant(row.parameters_rms, 3), str(row.n_failed)])
    return make_table("Pose errors, all repeats.", columns, rows)


def draw_errors(summary: pd.DataFrame, designs: pd.DataFrame, quantities: Mapping[str, str]) -> plt.Figure:
    """Return errors after calibration against the number of poses, one line per way to choose them.

    ``quantities`` are columns, a panel each, with what their axes say; with ``_sd`` they are standard deviations.
    Designs, sets of poses that somebody else has chosen, are single points.
    """
    names = list(dict.fromkeys(summary["name"]))
    figure = plt.Figure(figsize=(4.6 * len(quantities), 3.7), layout="constrained")
    panels = figure.subplots(1, len(quantities), squeeze=False)[0]
    for axes, (column, label) in zip(panels, quantities.items(), strict=True):
        for k, name in enumerate(names):
            rows = summary[summary["name"] == name]
            shift = 1.0 + 0.012 * (k - 0.5 * (len(names) - 1))
            _draw_bars(axes, rows, column, shift, COLOURS[k % len(COLOURS)], MARKERS[k % len(MARKERS)], name, "-")
        for k, (design, rows) in enumerate(designs.groupby("name", sort=False)):
            _draw_bars(axes, rows, column, 1.0, INK, MARKERS[-1 - k % len(MARKERS)], str(design), "none")
        axes.set(xscale="log", yscale="log", xlabel="Number of poses", ylabel=label)
        ticks = sorted(set(summary["n_poses"]))
        axes.set_xticks(ticks, [str(n) for n in ticks])
        axes.xaxis.set_minor_formatter(NullFormatter())
        axes.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: format_plain(value)))
        axes.yaxis.set_minor_formatter(NullFormatter())
        axes.grid(visible=True)
    panels[0].legend()
    return figure


def _draw_bars(
    axes: Axes, rows: pd.DataFrame, column: str, shift: float, colour: str, marker: str, name: str, line: str
) -> None:
    mean, bars = rows[column].to_numpy(dtype=float), np.nan_to_num(rows[f"{column}_sd"].to_numpy(dtype=float))
    axes.errorbar(
        rows["n_poses"] * shift,
        mean,
        yerr=np.stack([np.minimum(bars, 0.9 * mean), bars]),
        color=colour,
        marker=marker,
        markersize=4.5,
        linestyle=line,
        linewidth=1.0,
        capsize=2.0,
        label=name,
    )


def draw_paired(table: pd.DataFrame, reference: str) -> plt.Figure:
    """Return errors by those of a reference with the same machines, predicted and simulated, with standard errors."""
    numbers = sorted(set(table["n_poses"]))
    names = list(dict.fromkeys(table["name"]))
    figure = plt.Figure(figsize=(3.0 * len(numbers), 3.4), layout="constrained")
    panels = figure.subplots(1, len(numbers), sharey=True, squeeze=False)[0]
    for axes, n in zip(panels, numbers, strict=True):
        rows = table[table["n_poses"] == n].set_index("name").reindex(names)
        at = np.arange(len(names))
        axes.axhline(1.0, color=GREY, linewidth=1.0)
        axes.plot(at - 0.1, rows["predicted"], "s", color=COLOURS[1], markersize=5, label="predicted")
        axes.errorbar(
            at + 0.1,
            rows["simulated"],
            yerr=2.0 * rows["simulated_se"],
            color=INK,
            marker="o",
            markersize=4.5,
            linestyle="none",
            capsize=2.5,
            label="simulated ± 2 se",
        )
        axes.set_xticks(at, names, rotation=30, ha="right")
        axes.set_title(f"{n} poses")
        axes.grid(visible=True, axis="y")
        axes.yaxis.set_major_locator(MaxNLocator(6))
    panels[0].set_ylabel(f"Error by that of {reference}")
    panels[0].legend(loc="upper left")
    return figure


def show_designs(tables: Tables) -> PageSection | None:
    """Return the observability indices of sets of poses that somebody else has chosen."""
    given, selections = tables.designs, tables["selections"]
    if given.empty:
        return None
    columns = [Column("Poses by", kind="text"), Column("Poses"), *(Column(name) for name in INDICES)]
    rows = []
    for row in SelectionRow.read(given):
        rows.append([row.label, str(row.n_poses), *(format_value(row.others[name]) for name in INDICES)])
    found = selections[(selections["criterion"] != DESIGN) & selections["n_poses"].isin(given["n_poses"])]
    for (label, criterion, n), group in found.groupby(["label", "criterion", "n_poses"], sort=False):
        cells = [format_spread(group[name].mean(), group[name].std()) for name in INDICES]
        rows.append([f"{label}, {criterion}, mean ± sd", str(n), *cells])
    table = make_table("Observability indices.", columns, rows)
    return make_section("Given sets", (), (table,))


def show_chosen(tables: Tables) -> PageSection | None:
    """Return the criterion of every selection, and the time of one."""
    columns = [
        Column("Method", kind="text"),
        Column("Criterion", kind="text"),
        Column("Poses"),
        Column("best"),
        Column("mean ± sd"),
        Column("repeats"),
        Column("time", "s, mean", kind="seconds"),
    ]
    seconds = tables["timings"].groupby(["label", "criterion", "n_poses"])["seconds"].mean()
    rows = [
        [
            row.label,
            row.criterion,
            str(row.n_poses),
            format_value(row.best),
            format_spread(row.mean, row.sd),
            str(row.n_repeats),
            format_significant(float(seconds.loc[(row.label, row.criterion, row.n_poses)]), 2),
        ]
        for row in SelectionSummaryRow.read(tables["selection_summary"])
        if row.criterion != DESIGN
    ]
    note = Statement("Best sets: plans/; poses: poses.csv.")
    table = make_table("Selections: criterion, time.", columns, rows)
    return make_section("Selections", (), (table,), (), (note,))


def show_method(tables: Tables) -> PageSection | None:
    """Return the criteria and methods with their sources."""
    selections = tables["selections"]
    selections = selections[selections["criterion"] != DESIGN]
    criteria = [[name, *_describe_class(tables, "criterion", name)] for name in selections["criterion"].unique()]
    methods = [[*_describe_class(tables, "method", name)] for name in selections["method"].unique()]
    of = {
        "pose": "measured pose, mm and rad (rotation vector)",
        "angles": "measured pose, mm and rad (R = R_z R_y R_x)",
        "closure": "the closure, J_2",
    }[tables.config.jacobian]
    n_parameters = tables.results.summary["n_parameters"]
    text = (f"O1 to O5: derivatives of {of}, {n_parameters} parameters.",)
    tables_ = (
        make_table(
            "Criteria.",
            [Column("Criterion", kind="text"), Column("Meaning", kind="text"), Column("Source", kind="text")],
            criteria,
        ),
        make_table("Methods.", [Column("Method", kind="text"), Column("Source", kind="text")], methods),
    )
    return make_section("Method", text, tables_)


def _describe_class(tables: Tables, role: str, name: str) -> tuple[str, str]:
    """Return title and source of a criterion or a method; a user-defined one is in the tables."""
    built_in = (CRITERIA if role == "criterion" else METHODS).get(name)
    if built_in is not None:
        return built_in.title, built_in.source
    found = [row for row in SelectionClassRow.read(tables["classes"]) if (row.role, row.name) == (role, name)]
    return (found[0].title, found[0].source) if found else (name, "")


def _describe_candidates(config: SelectionConfig, n_measured: int | None) -> str:
    section = config.candidates
    how = {
        "random": "at random",
        "even": f"{section.levels} grid levels",
        "factorial": "on a full factorial",
    }
    where = "actuator range" if config.domain.kind == "actuators" else "the workspace"
    if config.domain.position_mm is not None and config.domain.rotation_deg is not None:
        position, rotation = (
            " × ".join(f"±{format_plain(x)}" for x in halves)
            for halves in (config.domain.position_mm, config.domain.rotation_deg)
        )
        where += f", {position} mm, {rotation} deg"
    again = "; redrawn each repeat" if section.resample else ""
    besides = "" if n_measured is None else f"; {n_measured} poses measured"
    return f"{section.count} {how[section.layout]} of {where}{again}{besides}"


BLOCKS: tuple[PageBlock, ...] = (show_random_sets, show_accuracy, show_designs, show_chosen, show_method)
"""All parts of the page, in their order."""


def build_page(
    tables: Tables,
    blocks: Sequence[PageBlock] = BLOCKS,
    judgements: Sequence[Judgement] = JUDGEMENTS,
    headline: Callable[[Tables], str] = state_headline,
) -> Page:
    """Return the page of an experiment's results: parts and judgements in their order, and a headline of them."""
    check_tables(ROWS, tables.results.tables, tables.results.folder or Path())
    config, summary = tables.config, tables.results.summary
    return Page(
        KIND,
        config.name,
        config.title,
        name_origin(config.provenance.model_dump()),
        headline(tables),
        tuple(state_verdict(tables, judgements)),
        show_sections(blocks, tables),
        (
            ("Machine", summary["machine"]),
            ("Candidates", _describe_candidates(config, summary["n_measured"])),
        ),
        key_figures=tuple(list_key_figures(tables)),
    )
