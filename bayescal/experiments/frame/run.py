"""What all small experiments have in common: what determines their results, and how these are put in place."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any

import pandas as pd

from bayescal.config.load import dump_config
from bayescal.config.schema import Section
from bayescal.experiments.frame.store import PROVENANCE_FILE, Store
from bayescal.experiments.study.inputs import hash_identity
from bayescal.files.atomic import read_text
from bayescal.report.blocks import Page, Section

PAGE = "report.html"


def identify_experiment(config: Section, folder: Path, names: Iterable[str | None]) -> dict[str, Any]:
    """Return what determines an experiment's results: its config without the title, and the hashes of its files.

    Parameters
    ----------
    config : Section
    folder : Path
        Where file names start.
    names : iterable of str or None
        The files that the config names.
    """
    files = {}
    for name in sorted({name for name in names if name is not None}):
        read_text(folder / name, "a file of the experiment")
        files[name] = hashlib.sha256((folder / name).read_bytes()).hexdigest()
    return {"config": {k: v for k, v in dump_config(config).items() if k != "title"}, "files": files}


def publish(
    store: Store,
    identity: dict[str, Any],
    tables: Mapping[str, pd.DataFrame | None],
    summary: dict[str, Any],
    page: Page,
    digits: int = 6,
    more: Callable[[Path], None] | None = None,
) -> str:
    """Write tables, summary, page and provenance, put them in place as a whole and return them in a few lines.

    Parameters
    ----------
    store : Store
        The results directory, checked before the experiment ran.
    identity : dict
        See `identify_experiment`.
    tables : mapping of name to DataFrame
        Those that are not empty are written as CSV.
    summary : dict
        JSON-ready; its headline and verdict are the page's.
    page : Page
    digits : int
        Significant ones of the tables.
    more : callable, optional
        Writes further files into the directory it is given.
    """
    staged = store.stage()
    for name, table in tables.items():
        if table is not None and not table.empty:
            table.to_csv(staged / f"{name}.csv", index=False, float_format=f"%.{digits}g", lineterminator="\n")
    said = [{"lead": one.lead, "text": one.text, "level": one.level} for one in page.verdict]
    _write_json(staged / "summary.json", {**summary, "headline": page.headline, "verdict": said})
    _write_json(staged / PROVENANCE_FILE, {"config_sha256": hash_identity(identity), **identity})
    if more is not None:
        more(staged)
    write_experiment_page(page, staged)
    store.publish()
    return list_lines(page, store.out)


def list_lines(page: Page, out: Path) -> str:
    """Return the page's verdict as lines for the terminal, and where the page is."""
    said = [f"{one.lead}: {one.text}" if one.lead else one.text for one in page.verdict]
    return "\n".join([page.headline, *said, f"report: {out / PAGE}"])


def _write_json(path: Path, content: dict[str, Any]) -> None:
    path.write_text(json.dumps(content, indent=1, ensure_ascii=False, allow_nan=False) + "\n", encoding="utf-8")
