"""Where results come from, as the last section of every page."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

from bayescal.report.blocks import Column, Fold, Preformatted, Section, Side, Table, make_pairs, make_table
from bayescal.report.numbers import NOTHING

RUN = {
    "kind": "Kind of experiment",
    "name": "Experiment",
    "config_sha256": "SHA-256 of config and inputs",
    "seed": "Seed",
    "python": "Python",
    "platform": "Platform",
}


def show_provenance(provenance: Mapping[str, Any]) -> Section:
    """Return the section that says what run, of which config and files, with which versions, made the results."""
    rows = [[title, str(provenance.get(key, NOTHING))] for key, title in RUN.items()]
    mappings = (
        _tabulate(provenance.get("versions"), "Versions.", "Package", "Version"),
        _tabulate(provenance.get("files"), "Input files.", "File", "SHA-256"),
        _tabulate(provenance.get("modules"), "Modules of others' classes.", "Module", "SHA-256"),
    )
    side = Side(tuple(table for table in mappings if table.rows))
    config = Preformatted(format_config(provenance.get("config", {})))
    return Section("Provenance", (make_pairs("Run.", rows), side, Fold("Config", (config,))), anchor="provenance")


def _tabulate(content: object, caption: str, key: str, value: str) -> Table:
    rows = [[str(k), str(v)] for k, v in content.items()] if isinstance(content, dict) else []
    return make_table(caption, [Column(key, kind="name"), Column(value, kind="name")], rows)


def format_config(value: object, indent: str = "") -> str:
    """Return JSON, indented; what holds no lists or objects stands on one line."""
    inner = f"{indent}  "
    if isinstance(value, dict) and any(isinstance(one, dict | list) for one in value.values()):
        lines = [f"{inner}{json.dumps(key)}: {format_config(one, inner)}" for key, one in value.items()]
        return "{\n" + ",\n".join(lines) + f"\n{indent}}}"
    if isinstance(value, list) and any(isinstance(one, dict | list) for one in value):
        lines = [f"{inner}{format_config(one, inner)}" for one in value]
        return "[\n" + ",\n".join(lines) + f"\n{indent}]"
    return json.dumps(value, ensure_ascii=False)
