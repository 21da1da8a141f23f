"""The page of a check, from its results alone."""

from __future__ import annotations

from functools import partial
from pathlib import Path

import numpy as np
import pandas as pd
from matplotlib import figure as mpl

from bayescal.experiments.runner.results import Results
from bayescal.experiments.selftest.rows import ROWS, RecoveryRow, SelftestCheckRow
from bayescal.experiments.shared.headline import write_headline
from bayescal.files.rows import check_tables
from bayescal.limits import FEWEST_SETS
from bayescal.report.blocks import (
    Absent,
    Block,
    Cell,
    Column,
    Figure,
    KeyFigure,
    Page,
    PageSection,
    Statement,
    Table,
    make_table,
)
from bayescal.report.numbers import format_fixed, format_percent, join_words, name_some
from bayescal.report.style import GREY, LEG_COLOURS, PALE, RED
from bayescal.report.symbols import name_parameter

NAMES = {
    "noise": "noise misstated",
    "model error": "model too simple",
    "unit": "wrong unit or sign",
    "legs": "legs or channels exchanged",
    "poses": "pose convention",
    "channel": "wrong channel",
    "frame": "other frame",
    "drift": "readings drift",
    "tolerance": "tolerance too tight",
    "rows": "row mismatch",
    "mode": "missed mode",
    "derivative": "wrong derivative",
    "prior": "tolerance too tight",
    "search": "posterior not found",
    "calibration": "low coverage",
}


def build_page(results: Results) -> Page:
    """Return what the page of a check says."""
    check_tables(ROWS, results.tables, results.folder or Path())
    summary, findings = results.summary, SelftestCheckRow.read(results.table("checks"))
    several = len(summary["variants"]) > 1
    findings.sort(key=lambda row: ("bad", "warning", "good").index(row.level))
    return Page(
        kind="Self-test",
        name=summary["name"],
        title=summary["title"],
        origin=summary["data_origin"],
        headline=state_headline(results),
        verdict=tuple(_state(row, several) for row in findings),
        sections=(*(_show_variant(results, name) for name in summary["variants"]),),
        key_figures=tuple(_list_key_figures(results, findings)),
        facts=(("Study", summary["study"]), ("Data sets", f"{summary['data_sets']} twice")),
    )


def state_headline(results: Results) -> str:
    """Return whether to rely on the study, which variants pass, and what is wrong with the others."""
    words, sound = [], True
    for name, one in results.summary["variants"].items():
        faults = [NAMES[fault] for fault in dict.fromkeys(one["faults"])]
        passes = one["passed"] and not faults
        sound &= passes
        words.append(f"{name} passes" if passes else f"{name}: {join_words(faults)}")
    few = min((_count_sets(results, name) or FEWEST_SETS for name in results.summary["variants"]), default=FEWEST_SETS)
    parts = ["The study is valid" if sound else "The study fails validation", name_some(words)]
    if few < FEWEST_SETS:
        parts.append(f"Use {FEWEST_SETS} data sets or more")
    return write_headline(parts)


def _list_key_figures(results: Results, checks: list[SelftestCheckRow]) -> list[KeyFigure]:
    """Return variants and checks that pass, and the coverage of simulated data."""
    variants = results.summary["variants"]
    failed = sum(not one["passed"] or bool(one["faults"]) for one in variants.values())
    passed = sum(row.level == "good" for row in checks)
    bad = sum(row.level == "bad" for row in checks)
    found = [
        KeyFigure("Variants passed", f"{len(variants) - failed} of {len(variants)}", "", "bad" if failed else "good"),
        KeyFigure("Checks passed", f"{passed} of {len(checks)}", "", "bad" if bad else "good"),
        KeyFigure("Data sets", str(results.summary["data_sets"]), "twice"),
    ]
    for whence in ("prior", "posterior"):
        rows = [row for row in RecoveryRow.read(results.table("parameters")) if row.simulated_from == whence]
        if rows:
            coverage = float(np.mean([row.coverage_90 for row in rows]))
            good = all(row.is_uniform for row in rows)
            name = f"Coverage of 90 % intervals, {whence}"
            found.append(KeyFigure(name, format_percent(coverage), "", "good" if good else "warning"))
    return found if len(found) > 3 else [*found, KeyFigure("Faults", str(bad), "", "bad" if bad else "good")]


def _count_sets(results: Results, name: str) -> int:
    """Return in how many data sets of a variant there are ranks, of the fewer of both sorts; zero without any."""
    ranks = results.table("ranks")
    mine = ranks[ranks["variant"] == name] if len(ranks) else ranks
    return 0 if mine.empty else int(mine["data_set"].str.partition(" ")[0].value_counts().min())


def _state(row: SelftestCheckRow, several: bool) -> Statement:
    said = f"{row.text[0].upper()}{row.text[1:]}" if row.text[0].isascii() else row.text  # χ² keeps its letter
    lead = f"{row.subject} ({row.variant})" if several else row.subject
    return Statement(said, row.level, lead, value=row.value, limit=row.limit, action=row.action)


def _show_variant(results: Results, name: str) -> PageSection:
    anchor = f"variant-{list(results.summary['variants']).index(name) + 1}"
    mine = [row for row in RecoveryRow.read(results.table("parameters")) if row.variant == name]
    if not mine:
        return PageSection(name, (Absent("Not simulated: data checks failed."),), anchor)
    judged = _count_sets(results, name) >= FEWEST_SETS
    blocks: list[Block] = [_plot(results, name, anchor), _tabulate(mine, judged)]
    return PageSection(name, tuple(blocks), anchor)


def _tabulate(parameters: list[RecoveryRow], judged: bool) -> Table:
    columns = [
        Column("Parameter", kind="text"),
        *(
            Column(*one, group)
            for group in ("Simulated from the priors", "Simulated from the posterior")
            for one in (("ranks", ""), ("90 % coverage", ""), ("error", "sd, rms"))
        ),
    ]
    rows: list[list[str | Cell]] = []
    for name in dict.fromkeys(one.parameter for one in parameters):
        row: list[str | Cell] = [name_parameter(name)]
        for one in (one for one in parameters if one.parameter == name):
            good = one.is_uniform
            badge = Cell("uniform" if good else "not uniform", "good" if good else "bad", badge=True)
            row.append(badge if judged else Cell("too few"))
            row += [format_percent(one.coverage_90), format_fixed(one.rms_z, 2)]
        rows.append(row)
    return make_table("Ranks, coverage, recovery by parameter.", columns, rows)


def _plot(results: Results, name: str, anchor: str) -> Figure:
    caption = "ECDF differences of ranks, 99 % band; red: outside."
    ranks, bands = results.table("ranks"), results.table("bands")
    mine, band = ranks[ranks["variant"] == name], bands[bands["variant"] == name]
    return Figure(f"ranks-{anchor}", caption, partial(draw_ranks, mine.dropna(axis=1, how="all"), band))


def draw_ranks(ranks: pd.DataFrame, bands: pd.DataFrame) -> mpl.Figure:
    """Return the distribution functions of ranks, less that of uniform ones, beside their band."""
    figure = mpl.Figure(figsize=(9.4, 3.2))
    whence = list(dict.fromkeys(bands["simulated_from"]))
    for axes, one in zip(figure.subplots(1, len(whence), sharey=True, squeeze=False)[0], whence, strict=True):
        band, mine = bands[bands["simulated_from"] == one], ranks[ranks["data_set"].str.startswith(f"{one} ")]
        at, low, high = (band[key].to_numpy(dtype=float) for key in ("rank", "low", "high"))
        axes.fill_between(at, low - at, high - at, color=PALE, linewidth=0.0)
        for name in mine.columns.drop(["variant", "data_set"]):
            values = np.sort(mine[name].to_numpy(dtype=float))
            share = np.searchsorted(values, at, side="right") / len(values)
            inside = bool(np.all((share >= low - 1e-12) & (share <= high + 1e-12)))
            axes.plot(
                at, share - at, color=LEG_COLOURS[4] if inside else RED, linewidth=0.7, alpha=0.6 if inside else 1.0
            )
        axes.axhline(0.0, color=GREY, linewidth=0.8)
        axes.set_title(f"Simulated from the {one}{'s' if one == 'prior' else ''}")
        axes.set_xlabel("Rank")
    figure.axes[0].set_ylabel("Share − uniform")
    return figure
