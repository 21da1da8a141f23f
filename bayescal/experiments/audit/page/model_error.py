"""What systematic errors do to an audit's predictions, on its page."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import pandas as pd

from bayescal.experiments.audit.page.results import AuditResults
from bayescal.experiments.audit.page.wording import format_probability, format_sd, name_requirement, name_unit
from bayescal.experiments.frame.results import list_rows
from bayescal.experiments.shared.hidden import show_hidden
from bayescal.limits import UNSEEN_UM
from bayescal.report.blocks import Block, Column, Section, Statement, Table, make_table
from bayescal.report.numbers import format_plain, format_significant, join_words
from bayescal.report.symbols import choose_error_unit

WHY = (
    "What a model leaves out repeats with the pose or follows the session, so that more poses do not average it out, "
    "and a study allows for it. How large it is shows in the data; before there are any it is stated (expected_um in "
    "[model_error]). A study does not know that size: where a plan shows little of an error, it allows for more than "
    "there is, and for some where there is none. Predicted here is what a study of this plan is expected to find, with "
    "the same terms and priors; geometry and errors together are normal given their sizes. Simulated calibrations, "
    "profiles and draws, where there are any, are of a machine without systematic errors: they check first order."
)
FOUND = "Sizes are those that the study found; none and three times as much are these scaled."


def state_model_error(audit: AuditResults) -> Iterator[Statement]:
    """Say which systematic errors are taken along, and what others would do."""
    if not (sizes := _read_sizes(audit)):
        return
    factor, unit = _show(audit)
    terms = join_words([f"{name} {format_significant(factor * size, 2)}" for name, size in sizes.items()])
    whole = format_significant(factor * sum(size**2 for size in sizes.values()) ** 0.5, 2)
    text = f"Systematic errors of {whole} {unit} rms are taken along as the study found them ({terms})."
    if not audit.is_measured:
        (true,) = audit.tables["error_sizes"].query("times == 1.0")["size_um"].unique()
        text = (
            f"The machine is assumed to err by {format_significant(factor * true, 2)} {unit} rms, systematically; a "
            f"study of this plan would allow for {whole} {unit} ({terms})."
        )
    rows = [row for row in list_rows(audit.tables["error_sizes"]) if row["what"] == "requirement"]
    if rows and all(str(row["probability"]) != "" for row in rows):
        frame = pd.DataFrame(rows)
        least = frame.loc[frame.groupby("times")["probability"].idxmin()]
        said = [
            f"{format_probability(row['probability'])} with {_name_size(row, factor, unit)} "
            f"({name_requirement(row['name'])})"
            for row in list_rows(least)
        ]
        text += f" Least probability to meet a requirement: {join_words(said)}."
    yield Statement(text, lead="Model error")


def show_model_error(audit: AuditResults) -> list[Section]:
    """Return what none and several times as large errors would do, and what unseen ones hide; none without any."""
    if not _read_sizes(audit):
        return []
    table, blocks = audit.tables["error_sizes"], list[Block]()
    blocks += [Statement(FOUND)] if audit.is_measured else []
    blocks.append(
        _tabulate(
            table, _show(audit), "parameter", "Standard deviation after the calibration, rms over legs or channels."
        )
    )
    if (table["what"] == "requirement").any():
        blocks.append(
            _tabulate(table, _show(audit), "requirement", "Requirements: predicted sd, and probability to meet them.")
        )
    blocks.append(WHY)
    allowed, size = _name_unseen(audit)
    blocks += show_hidden(audit.tables["model_error_hidden"], size, allowed, lambda unit: (1.0, name_unit(unit)))
    return [Section("Model error", tuple(blocks), "model-error")]


def _read_sizes(audit: AuditResults) -> dict[str, float]:
    return dict(audit.summary["plan"].get("systematic_um", {})) if "error_sizes" in audit.tables else {}


def _name_unseen(audit: AuditResults) -> tuple[bool, str]:
    """Return whether sizes of errors that leave no trace are stated, and in words how large they are taken to be."""
    floors = audit.summary["plan"].get("at_least_um", {})
    factor, unit = _show(audit)
    said = [f"{name} {format_significant(factor * size, 2)}" for name, size in floors.items()]
    return bool(floors), f"{join_words(said) if floors else format_plain(factor * UNSEEN_UM)} {unit} rms"


def _show(audit: AuditResults) -> tuple[float, str]:
    """Return factor and name of the unit of sizes."""
    return choose_error_unit(audit.summary["plan"].get("model_error_in"))


def _name_size(row: Mapping[str, Any], factor: float, unit: str) -> str:
    return f"{format_significant(factor * float(row['size_um']), 2)} {unit}" if row["size_um"] else "no error"


def _tabulate(table: pd.DataFrame, shown: tuple[float, str], what: str, caption: str) -> Table:
    """Return standard deviations, and probabilities of requirements, a row each, by the errors' size."""
    some, with_chance = table[table["what"] == what], what == "requirement"
    columns = [Column(what.capitalize(), kind="text")]
    cells: dict[str, list[str]] = {}
    for _, group in some.groupby("times", sort=False):
        for k, row in enumerate(list_rows(group)):
            name = name_requirement(row["name"]) if with_chance else str(row["name"])
            size = _name_size(row, *shown)
            amount = f"{format_sd(float(row['sd']))} {name_unit(row['unit'])}".rstrip()
            cells.setdefault(str(row["name"]), [name]).append(amount)
            columns += [Column("sd", group=size)] if k == 0 else []
            if with_chance:
                cells[str(row["name"])].append(format_probability(float(row["probability"])))
                columns += [Column("met", group=size)] if k == 0 else []
    return make_table(caption, columns, list(cells.values()))
