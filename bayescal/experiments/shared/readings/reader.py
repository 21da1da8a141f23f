"""Tables of ``[[data]]`` by a reader of somebody else's class."""

from __future__ import annotations

from pathlib import Path

from bayescal.config.classes import choose, name_failures
from bayescal.data.reader import TableReader, read_with
from bayescal.experiments.shared.readings.data_schema import OwnDataConfig
from bayescal.files.csv_tables import CsvTable


def read_own_table(section: OwnDataConfig, path: Path, folder: Path) -> CsvTable:
    """Return the table that the reader of a section makes of a file; InputError where it fails."""
    choice = choose("READERS", section.kind, TableReader, "data.kind", folder, section.options)  # type: ignore[type-abstract]
    with name_failures(choice.found, "data.kind"):
        return read_with(choice.found(choice.options), path)
