"""What systematic errors do to an audit's predictions, on its page."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

from bayescal.experiments.audit.page.results import AuditResults
from bayescal.experiments.audit.page.wording import format_probability, format_sd, name_requirement, name_unit
from bayescal.experiments.audit.rows import SystematicSizeRow
from bayescal.experiments.shared.headline import LIKELY
from bayescal.experiments.shared.unmodelled_bias import show_hidden
from bayescal.limits import UNSEEN_UM
from bayescal.report.blocks import Block, Column, PageSection, Statement, Table, make_table
from bayescal.report.numbers import format_plain, format_significant, join_words
from bayescal.report.symbols import choose_error_unit

FOUND = "Sizes: as found, none, threefold."


def state_model_error(audit: AuditResults) -> Iterator[Statement]:
    """Return how large systematic errors are taken to be, and what larger ones would do to the requirements."""
    if not (sizes := _read_sizes(audit)):
        return
    unit = _name_unit(audit)
    whole = sum(size**2 for size in sizes.values()) ** 0.5
    text = f"Systematic errors found: {format_significant(whole, 2)} {unit} rms."
    if not audit.is_measured:
        (true,) = audit.tables["error_sizes"].query("size_factor == 1.0")["size"].unique()
        text = f"Assumed systematic error {format_significant(true, 2)} {unit} rms; allowed for: "
        text += f"{format_significant(whole, 2)} {unit}."
    yield Statement(text, lead="Model error", value=whole, unit=unit)
    rows = [row for row in _read_rows(audit) if row.quantity == "requirement"]
    if rows and not any(math.isnan(row.probability) for row in rows):
        most = max(row.size_factor for row in rows)
        row = min((one for one in rows if one.size_factor == most), key=lambda one: one.probability)
        text = f"With {_name_size(row, unit)}, {name_requirement(row.name)}: P = {format_probability(row.probability)}."
        yield Statement(text, lead="Model error", value=row.probability, limit=LIKELY)


def show_model_error(audit: AuditResults) -> list[PageSection]:
    """Return what none and several times as large errors would do, and what unseen ones hide; none without any."""
    if not _read_sizes(audit):
        return []
    rows, unit, blocks = _read_rows(audit), _name_unit(audit), list[Block]()
    blocks += [Statement(FOUND)] if audit.is_measured else []
    caption = "Posterior sd, rms over members."
    blocks.append(_tabulate([row for row in rows if row.quantity == "parameter"], unit, "Parameter", caption))
    if required := [row for row in rows if row.quantity == "requirement"]:
        caption = "Requirements: predicted sd, probability."
        blocks.append(_tabulate(required, unit, "Requirement", caption))
    allowed, size = _name_unseen(audit)
    blocks += show_hidden(audit.tables["model_error_bias"], size, allowed, lambda unit: (1.0, name_unit(unit)))
    return [PageSection("Model error", tuple(blocks), "model-error")]


def _read_sizes(audit: AuditResults) -> dict[str, float]:
    return dict(audit.summary["plan"].get("systematic", {})) if "error_sizes" in audit.tables else {}


def _name_unseen(audit: AuditResults) -> tuple[bool, str]:
    """Return whether sizes of errors that leave no trace are stated, and in words how large they are taken to be."""
    floors, factor = audit.summary["plan"].get("floor", {}), choose_error_unit(_find_unit(audit))[0]
    said = [f"{name} {format_significant(size, 2)}" for name, size in floors.items()]
    return bool(floors), f"{join_words(said) if floors else format_plain(factor * UNSEEN_UM)} {_name_unit(audit)} rms"


def _find_unit(audit: AuditResults) -> str:
    """Return the unit of sizes, as results have it."""
    return str(audit.summary["plan"]["model_error_unit"])


def _name_unit(audit: AuditResults) -> str:
    """Return the unit of sizes, as pages write it."""
    return choose_error_unit(_find_unit(audit))[1]


def _read_rows(audit: AuditResults) -> list[SystematicSizeRow]:
    return SystematicSizeRow.read(audit.tables["error_sizes"])


def _name_size(row: SystematicSizeRow, unit: str) -> str:
    return f"{format_significant(row.size, 2)} {unit}" if row.size else "no error"


def _tabulate(rows: Sequence[SystematicSizeRow], unit: str, title: str, caption: str) -> Table:
    """Return standard deviations, and probabilities of requirements, a row each, by the errors' size."""
    columns, cells = [Column(title, kind="text")], dict[str, list[str]]()
    required, sizes = rows[0].quantity == "requirement", {row.size_factor: _name_size(row, unit) for row in rows}
    for size in sizes.values():  # of none expected all are zero
        columns += [Column(one, group=size) for one in (("sd", "met") if required else ("sd",))]
    for row in rows:
        mine = cells.setdefault(row.name, [name_requirement(row.name) if required else row.name])
        mine.append(f"{format_sd(row.sd)} {name_unit(row.unit)}".rstrip())
        mine += [format_probability(row.probability)] if required else []
    return make_table(caption, columns, list(cells.values()))
