"""Writing a study's report: figures as PNG files and one self-contained HTML page."""

from __future__ import annotations

from pathlib import Path

from bayescal.experiments.study.page.context import ReportContext, build_context
from bayescal.experiments.study.page.illustrations import list_illustrations
from bayescal.experiments.study.page.results import Results, read_results
from bayescal.report.blocks import FigureBlock
from bayescal.report.page import draw_figures, render_template, set_prose, write_page

PAGE = "report.html"


def write_report(folder: Path) -> Path:
    """Write ``figures/*.png`` and ``report.html`` into a results directory, from that directory alone.

    Parameters
    ----------
    folder : Path
        Results of a study. Without its posterior files the figures that need draws are left out.

    Returns
    -------
    Path
        The page; it holds its figures and its style and refers to no other file.

    Raises
    ------
    InputError
        Where a file is missing or not what a study writes; nothing is written then.
    """
    results = read_results(folder)
    figures = _draw_figures(results, folder / "figures")
    return write_page(folder / PAGE, render_page(build_context(results, figures)))


def _draw_figures(results: Results, folder: Path) -> dict[str, FigureBlock]:
    """Draw the figures; those of deformations that are gone are removed."""
    blocks = draw_figures(list_illustrations(results), folder)
    for path in folder.glob("errors_*.png"):
        if path.stem not in blocks:
            path.unlink()
    return blocks


def render_page(context: ReportContext) -> str:
    """Return the report as HTML; all text is escaped."""
    return render_template("template.html", set_prose, report=context)
