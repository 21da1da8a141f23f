"""Readers of files in a form of somebody's own: each makes a table of readings of a file."""

from __future__ import annotations

from abc import ABC, abstractmethod
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bayescal.config.sections import Section
from bayescal.errors import InputError
from bayescal.files.csv_tables import CsvTable
from bayescal.files.table_files import cells_from_frame

if TYPE_CHECKING:
    import pandas as pd


class TableReader(ABC):
    """Reads a file in a form of its own as a table of readings; a config names a subclass as a kind of ``[[data]]``.

    Parameters
    ----------
    config : Section
        Its options, which a ``Config`` of the class declares.

    Examples
    --------
    A logger that separates by semicolons and writes decimal commas:

    >>> import pandas as pd
    >>> class Logger(bc.TableReader):
    ...     def read(self, path):
    ...         return pd.read_csv(path, sep=";", decimal=",")
    """

    Config: type[Section] = Section

    def __init__(self, config: Any = None) -> None:
        """Keep the options."""
        self.config = config

    @abstractmethod
    def read(self, path: Path) -> pd.DataFrame:
        """Return the readings, a row a pose: ``pose``, ``use`` perhaps, and columns of channels with their units."""


def read_with(reader: TableReader, path: Path) -> CsvTable:
    """Return the table that a reader makes of a file; lines are counted as if it had been written, header first.

    InputError for what is no table.
    """
    table = reader.read(path)
    where = f"{path}: {type(reader).__name__}.read"
    if not hasattr(table, "itertuples"):
        raise InputError(f"{where}: found {type(table).__name__}, expected a DataFrame")
    if not len(table):
        raise InputError(f"{where}: found no rows, expected some")
    cells = cells_from_frame(table, path)
    return CsvTable(path, cells.header, cells.rows, cells.lines)
