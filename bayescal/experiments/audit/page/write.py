"""Writing an audit's report: figures as PNG files and one self-contained HTML page."""

from __future__ import annotations

from pathlib import Path

from bayescal.experiments.audit.page.context import AuditContext, build_context
from bayescal.experiments.audit.page.illustrations import list_illustrations
from bayescal.experiments.audit.page.results import AuditResults, read_audit
from bayescal.experiments.audit.page.wording import make_prose
from bayescal.report.page import draw_figures, render_template, write_page

PAGE = "audit.html"


def write_audit_report(folder: Path) -> Path:
    """Write ``figures/*.png`` and ``audit.html`` into an audit's directory, from that directory alone.

    Parameters
    ----------
    folder : Path
        What `bayescal audit` left. Without the tables of profiles, draws or sweeps these parts are left out.

    Returns
    -------
    Path
        The page; it holds its figures and its style and refers to no other file.

    Raises
    ------
    InputError
        Where a file is missing or not what an audit writes; nothing is written then.
    """
    results = read_audit(folder)
    figures = draw_figures(list_illustrations(results), folder / "figures")
    return write_page(folder / PAGE, render_page(build_context(results, figures), results))


def render_page(context: AuditContext, results: AuditResults) -> str:
    """Return the report as HTML; all text is escaped."""
    return render_template("audit.html", make_prose(results.symbols), ("report.css", "audit.css"), report=context)
