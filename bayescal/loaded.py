"""Results of finished runs for notebooks and scripts: tables as DataFrames, posteriors as DataTrees, plots as axes."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd
import xarray as xr

from bayescal.config.load import describe_unknown
from bayescal.errors import InputError
from bayescal.experiments.frame.notebook import show_in_notebook
from bayescal.experiments.frame.results import Results, read_results

if TYPE_CHECKING:
    from matplotlib.axes import Axes

SHOWN: dict[str, tuple[str, ...]] = {
    "study": ("ranking",),
    "calibration": ("variants",),
    "audit": ("parameters", "requirements"),
}
WITHOUT = "-tau-zero"
"""What ends the name of a posterior's file without model error."""


@dataclass(frozen=True, eq=False)
class LoadedResults:
    """A results directory of any kind.

    Attributes
    ----------
    results : Results
        Summary, tables and provenance as they were written.
    """

    results: Results

    @property
    def folder(self) -> Path:
        """Where the results stand."""
        assert self.results.folder is not None
        return self.results.folder

    @property
    def kind(self) -> str:
        """Kind of the experiment."""
        return str(self.results.provenance.get("kind"))

    @property
    def summary(self) -> dict[str, Any]:
        """What ``summary.json`` holds."""
        return self.results.summary

    @property
    def tables(self) -> dict[str, pd.DataFrame]:
        """All tables by their names."""
        return self.results.tables

    def __repr__(self) -> str:
        headline = self.summary.get("headline", "")
        return f"{type(self).__name__}({str(self.folder)!r}, kind={self.kind!r}): {headline}"

    def _repr_html_(self) -> str:
        return show_in_notebook(self.summary, self.tables, SHOWN.get(self.kind, ()))


@dataclass(frozen=True, eq=False, repr=False)
class Audit(LoadedResults):
    """Results of an audit of a machine on legs."""

    @property
    def parameters(self) -> pd.DataFrame:
        """Every parameter with its tolerance and what the plan leaves of it."""
        return self.results.table("parameters")

    @property
    def requirements(self) -> pd.DataFrame:
        """Every requirement with what is predicted."""
        return self.results.table("requirements")

    def plot_contraction(self, axes: Axes | None = None) -> Axes:
        """Draw the contraction of every parameter, and return the axes."""
        found = {name: one["contraction"] for name, one in self.summary["parameters"].items()}
        axes = _make_axes(axes)
        axes.barh(list(found), list(found.values()))
        axes.invert_yaxis()
        axes.set_xlim(0.0, 1.0)
        axes.set_xlabel("contraction: 0 nothing is learnt, 1 everything")
        return axes


@dataclass(frozen=True, eq=False, repr=False)
class StudyResult(LoadedResults):
    """Results of a study or of a calibration: variants, their posteriors and predictions."""

    @property
    def ranking(self) -> pd.DataFrame:
        """The variants, the largest log-evidence first, indexed by their names."""
        table = self.tables["ranking"] if "ranking" in self.tables else self.tables["variants"]
        return table.sort_values("log_evidence", ascending=False, ignore_index=True).set_index("variant")

    @property
    def variants(self) -> list[str]:
        """Names of the variants, the best first."""
        return list(self.ranking.index)

    @property
    def best(self) -> str:
        """The variant of the largest log-evidence."""
        return self.variants[0]

    @property
    def parameters(self) -> pd.DataFrame:
        """Every parameter of every variant with its posterior."""
        return self.results.table("parameters")

    @property
    def predictions(self) -> pd.DataFrame:
        """What each variant predicts of poses, or of readings, beside what was measured."""
        return self.results.table("predictions")

    def posterior(self, variant: str | None = None, with_model_error: bool = True) -> xr.DataTree:
        """Return the posterior of a variant, the best by default, as ArviZ takes it.

        Raises
        ------
        InputError
            For an unknown variant, and where the run has not kept the draws.
        """
        name = self._check(variant)
        stems = {name.replace("/", "-").replace(" ", "_"), re.sub(r"[^\w.-]+", "_", name)}
        for stem in sorted(stems):
            path = self.folder / "posterior" / f"{stem}{'' if with_model_error else WITHOUT}.nc"
            if path.is_file():
                return xr.open_datatree(path, engine="h5netcdf").load()
        raise InputError(f"{self.folder}: found no draws of {name!r} in posterior/, expected those that a run keeps")

    def plot_parameters(self, variant: str | None = None, axes: Axes | None = None) -> Axes:
        """Draw how far each parameter of a variant is from nominal, with its 90 % interval, and return the axes.

        In prior standard deviations: 0 is nominal, an interval as long as ±1.6 has learnt nothing.
        """
        table = self.parameters[self.parameters["variant"] == self._check(variant)]
        if "model_error" in table:
            table = table[table["model_error"] == "free"]
        table = table[np.isfinite(table["prior_sd"])]
        middle = (table["mean"] - table["nominal"]) / table["prior_sd"]
        ends = [((table[end] - table["mean"]) / table["prior_sd"]).abs() for end in ("q05", "q95")]
        axes = _make_axes(axes)
        axes.errorbar(middle, table["parameter"], xerr=np.stack(ends), fmt="o", markersize=3.0)
        axes.axvline(0.0, color="0.6", linewidth=0.8)
        axes.invert_yaxis()
        axes.set_xlabel("deviation from nominal, prior standard deviations")
        return axes

    def _check(self, variant: str | None) -> str:
        if variant is None:
            return self.best
        if variant not in self.variants:
            raise InputError(f"{self.folder}: variant: {describe_unknown(self.variants, variant)}")
        return variant


CLASSES: dict[str, type[LoadedResults]] = {"study": StudyResult, "calibration": StudyResult, "audit": Audit}


def load_results(folder: Path | str) -> LoadedResults:
    """Return the results of a finished run: `StudyResult`, `Audit`, or `LoadedResults` of any other kind.

    Raises
    ------
    InputError
        Where the folder holds no results, or a table of them is missing.
    """
    results = read_results(Path(folder))
    return CLASSES.get(str(results.provenance.get("kind")), LoadedResults)(results)


def _make_axes(axes: Axes | None) -> Axes:
    """Return the axes given, or those of a new figure."""
    if axes is not None:
        return axes
    from matplotlib.figure import Figure

    return Figure(layout="constrained").subplots()
