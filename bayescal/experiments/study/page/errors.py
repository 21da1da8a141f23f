"""Errors of measured poses, and how often intervals and bounds hold them."""

from __future__ import annotations

from bayescal.experiments.study.page.checks import is_too_narrow
from bayescal.experiments.study.page.illustrations import illustrate_bounds, illustrate_errors
from bayescal.experiments.study.page.results import SHORT_SETTINGS, USES, StudyResults
from bayescal.experiments.study.page.variants import VARIANT, label_variant
from bayescal.report.blocks import Block, Cell, Column, Fold, Section, Statement, Table, make_table
from bayescal.report.numbers import NOTHING, format_percent


def show_errors(study: StudyResults) -> Section | None:
    """Return errors of poses, and how often bounds and intervals hold them; None where no poses were measured."""
    if not study.has("pose_errors"):
        return None
    title = "Coverage: how many measurements lie inside their intervals, variant by variant"
    blocks: list[Block] = [*illustrate_errors(study), illustrate_bounds(study)]
    blocks.append(Fold(title, (tabulate_coverage(study),)))
    return Section("Pose errors", tuple(blocks), anchor="errors", short="Errors")


def tabulate_coverage(results: StudyResults) -> Table:
    """Return how often intervals and bounds hold the measurements, for every posterior."""
    uses = USES if results.n_verification else USES[:1]
    kinds = ("90 % intervals, all components", "95 % bound, position", "95 % bound, orientation")
    columns = [VARIANT, Column("Model error", kind="text"), *(Column(use, "%", kind) for kind in kinds for use in uses)]
    rows = []
    for name, setting, fit in results.fits():
        frame = results.table("pose_errors", name)
        frame = frame[frame["model_error"] == setting]
        cells: list[str | Cell] = [label_variant(results, name), SHORT_SETTINGS[setting]]
        for use in uses:
            share, n = fit[use]["interval_90_coverage"], results.summary["n_poses"][use]
            cells.append(Cell(format_percent(share).rstrip(" %"), "warning" if is_too_narrow(share, n) else "plain"))
        for kind, unit in (("position", "mm"), ("orientation", "deg")):
            for use in uses:
                poses = frame[frame["use"] == use]
                inside = poses[f"{kind}_error_{unit}"] <= poses[f"{kind}_bound_95_{unit}"]
                cells.append(format_percent(float(inside.mean())).rstrip(" %") if len(poses) else NOTHING)
        rows.append(cells)
    note = "Marked where the coverage lies two standard errors or more below 90 %, a pose counted as one trial."
    caption = "Share of the measurements inside their predictive intervals and bounds; nominal 90 % and 95 %."
    return make_table(caption, columns, rows, [Statement(note)])
