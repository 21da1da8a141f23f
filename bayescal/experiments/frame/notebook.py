"""How results show themselves in a notebook: headline, verdict and the first tables, as HTML without a style."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from html import escape
from typing import Any

import pandas as pd

ROWS, COLUMNS = 12, 14
MARKS = {"good": "✓", "warning": "!", "bad": "✗"}


def show_in_notebook(summary: Mapping[str, Any], tables: Mapping[str, pd.DataFrame], names: Sequence[str] = ()) -> str:
    """Return HTML of what results say.

    Parameters
    ----------
    summary : mapping
        ``title``, ``headline`` and ``verdict`` are shown where they are there.
    tables : mapping of name to DataFrame
    names : sequence of str
        Tables to show, those that are there; the first one where nothing is said.
    """
    parts = [f"<h3>{escape(str(summary.get('title', summary.get('experiment', 'Results'))))}</h3>"]
    if headline := summary.get("headline"):
        parts.append(f"<p><strong>{escape(str(headline))}</strong></p>")
    said = "".join(f"<li>{_show_statement(one)}</li>" for one in summary.get("verdict", []))
    parts.append(f"<ul>{said}</ul>" if said else "")
    for name in [one for one in names if one in tables] or list(tables)[:1]:
        if not tables[name].empty:
            parts.append(f"<h4>{escape(name)}</h4>{_show_table(tables[name])}")
    return "\n".join(part for part in parts if part)


def _show_statement(one: Mapping[str, Any]) -> str:
    mark = MARKS.get(str(one.get("level")), "")
    return f"{mark} <strong>{escape(str(one.get('lead', '')))}.</strong> {escape(str(one.get('text', '')))}".strip()


def _show_table(table: pd.DataFrame) -> str:
    text: str = table.to_html(index=False, max_rows=ROWS, max_cols=COLUMNS, float_format="{:.5g}".format, border=0)
    return text
