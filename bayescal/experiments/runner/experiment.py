"""What a kind of experiment is: a schema, and how its inputs become results and results a page.

Everything else is done once for all kinds by the frame: identity, resuming, workers, progress, interrupts, tables,
summary, provenance, and putting results in place as a whole.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar

from pydantic import ValidationError

from bayescal.config.classes import find_classes, find_files
from bayescal.config.registry import hash_modules
from bayescal.config.sections import ExperimentConfig
from bayescal.errors import InputError
from bayescal.experiments.runner.memory import MemoryEstimate
from bayescal.files.rows import TableRow
from bayescal.report.numbers import format_significant

if TYPE_CHECKING:
    import pandas as pd
    from rich.console import Console

    from bayescal.experiments.runner.parallel import Run
    from bayescal.experiments.runner.results import Results, Summary
    from bayescal.report.blocks import Page


class Experiment[C: ExperimentConfig, I](ABC):
    """A kind of experiment.

    Attributes
    ----------
    schema : type
        Of its config; ``kind``, ``name``, ``title`` and ``seed`` are those of every experiment.
    tables_in : str
        Folder of its tables within the results directory; the directory itself by default.
    rows : tuple of type
        Of its tables, by which these are checked on reading and described in the reference.
    digits : int
        Significant ones of its tables; zero for all.
    asked_again : bool
        Whether it is asked again as data grow: results of the same config may be replaced then.
    imports : tuple of str
        Modules that its tasks need, first the one that computes: workers import them while this process imports that.
    """

    schema: ClassVar[type[ExperimentConfig]]
    tables_in: ClassVar[str] = ""
    rows: ClassVar[tuple[type[TableRow], ...]] = ()
    digits: ClassVar[int] = 9
    asked_again: ClassVar[bool] = False
    imports: ClassVar[tuple[str, ...]] = ()

    def files(self, config: C, folder: Path) -> list[str]:
        """Return the input files that belong to the experiment's identity, relative to the config's folder.

        By default all that stand in its config as `bayescal.config.sections.InputFile`, and those of its classes.
        """
        return find_files(config, folder)

    def modules(self, config: C, folder: Path) -> dict[str, str]:
        """Return the SHA-256 of the installed modules that somebody else's classes of the config stand in, by name."""
        return hash_modules(find_classes(config, folder))

    def config_of(self, results: Results) -> C:
        """Return the config that results were made with; titles within its sections are left out."""
        content = {**results.config, "title": str(results.provenance.get("title", ""))}
        try:
            config: C = self.schema.model_validate(content)  # type: ignore[assignment]  # the kind's own schema
        except ValidationError as error:
            raise InputError(f"{results.folder}: provenance: found no valid config") from error
        return config

    @abstractmethod
    def read(self, config: C, folder: Path) -> I:
        """Return what the experiment computes with; InputError for every fault of the config or its files."""

    def list_file_faults(self, content: Mapping[str, object], folder: Path) -> list[str]:
        """Return what is wrong with each file by itself that a config names, whose content may itself be at fault.

        A line each, those that `read` tells among them; by default none is looked at.
        """
        del content, folder
        return []

    def estimate_memory(self, inputs: I) -> MemoryEstimate:
        """Return what computing with these inputs will hold at once; by default nothing is known."""
        del inputs
        return MemoryEstimate()

    def estimate_seconds(self, inputs: I) -> float | None:
        """Return about how long computing takes on one core, s; None, as by default, where nothing is known.

        It may take some per cent of that itself.
        """
        del inputs
        return None

    def outlook(self, inputs: I) -> list[str]:
        """Return what the inputs can determine, in lines; it takes a second or two. By default nothing is said."""
        del inputs
        return []

    def list_warnings(self, inputs: I, *, before_run: bool = False) -> list[str]:
        """Return what is probably wrong with inputs that nothing forbids to compute with, in words; it takes seconds.

        What a run finds by itself need not be looked for before one.
        """
        del inputs, before_run
        return []

    def suspect(self, inputs: I) -> list[str]:
        """Return what is wrong with data that can be computed with: results of these are not to be relied on.

        What is named here is among `list_failures` of the results.
        """
        del inputs
        return []

    @abstractmethod
    def compute(self, inputs: I, run: Run) -> Results:
        """Return the results; long work is handed to ``run`` in tasks, which keeps each as it ends.

        Numbers depend on the inputs alone, not on workers, nor on what was done before an interruption.
        """

    @abstractmethod
    def page(self, results: Results) -> Page:
        """Return the page, from results as they are read back from their directory."""

    def show(self, results: Results, page: Page, console: Console) -> None:
        """Print the results on the terminal: the page's verdict as it is seen there at first sight."""
        from bayescal.experiments.runner.terminal import show_verdict

        del results
        show_verdict(page, console)

    def list_failures(self, results: Results) -> list[str]:
        """Return what forbids to rely on the results, in words; the command line then ends with exit code 3."""
        del results
        return []

    def compare(self, results: Mapping[str, Results]) -> pd.DataFrame:
        """Return several results of this kind side by side, an entry of their summaries a row."""
        import pandas as pd

        columns = {name: _list_plain(one.summary) for name, one in results.items()}
        return pd.DataFrame(columns).rename_axis("entry").reset_index()

    def show_comparison(self, table: pd.DataFrame, console: Console) -> None:
        """Print what `compare` returns."""
        from rich.table import Column, Table

        shown = Table(*(Column(str(name), overflow="fold") for name in table.columns))
        for row in table.itertuples(index=False):
            shown.add_row(*map(str, row))
        console.print(shown)

    def check_comparable(self, data: Mapping[str, Mapping[str, object]]) -> None:
        """Raise InputError where results are not of the same data: what is given of each must be the same."""
        names = list(data)
        for name in names[1:]:
            for key, value in data[name].items():
                other = data[names[0]].get(key)
                if value != other:
                    raise InputError(
                        f"{name}: {key} differs from {names[0]} ({value} and {other}), expected the same data"
                    )


def _list_plain(summary: Summary, before: str = "") -> dict[str, str]:
    """Return the numbers and marks of a summary, those of its sections too, as texts; lists are left out."""
    found: dict[str, str] = {}
    for key, value in summary.items():
        if isinstance(value, dict):
            found |= _list_plain(value, f"{before}{key}.")
        elif isinstance(value, bool | int):
            found[f"{before}{key}"] = str(value)
        elif isinstance(value, float):
            found[f"{before}{key}"] = format_significant(value, 4)
    return found
