"""Results of finished runs for notebooks and scripts: tables as DataFrames, posteriors as DataTrees, plots as axes."""

from __future__ import annotations

import re
import shutil
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import cached_property
from html import escape
from io import StringIO
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from bayescal.config.load import describe_unknown
from bayescal.errors import InputError
from bayescal.files.manifest import overlooking
from bayescal.files.plain_text import make_plain

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr
    from matplotlib.axes import Axes

    from bayescal.calibrated.machine import CalibratedMachine
    from bayescal.experiments.frame.results import Results

RANKED = ("variant", "n_parameters", "log_evidence", "elpd_loo_difference", "misfit", "converged", "problems")
"""What is shown of variants that are compared."""
ROWS, COLUMNS = 12, 14
MARKS = {"good": "✓", "warning": "!", "bad": "✗"}
type Table = pd.DataFrame | Mapping[str, Any] | Path | str
"""A table, or the CSV file of one."""


@dataclass(frozen=True, eq=False)
class LoadedResults:
    """A results directory of any kind."""

    results: Results
    trust: bool = False  # whether the code of own classes that the results keep is run, trusted or not
    force: bool = False  # whether files are taken that are not as they were written
    project: Any = None  # what the files are kept by that the results were made of, if they are kept

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

    def page(self, path: Path | str) -> Path:
        """Write the report, one HTML file without anything beside it."""
        from bayescal.report.page import PAGE

        source, target = self.folder / PAGE, Path(path)
        if not source.is_file():
            raise InputError(f"{source}: no such file, expected the page; bayescal report writes it")
        if not target.parent.is_dir():
            raise InputError(f"{target}: found no folder {target.parent}, expected one")
        return Path(shutil.copyfile(source, target))

    def to_toml(self, folder: Path | str | None = None) -> str:
        """Return the config that gives these results; written with machine and readings to a folder if one is named.

        InputError for results that were loaded: their config stands where they were made.
        """
        if self.project is None:
            raise InputError(f"{self.folder}: found loaded results, expected those of calibrate, audit or simulate")
        if folder is not None:
            ignored = shutil.ignore_patterns("results", "__pycache__")
            shutil.copytree(self.project.folder, folder, ignore=ignored, dirs_exist_ok=True)
        return str((self.project.folder / "study.toml").read_text(encoding="utf-8"))

    def list_shown(self) -> dict[str, pd.DataFrame]:
        """Return the tables that are shown with headline and verdict, by their titles."""
        return dict([*self.tables.items()][:1])

    def __repr__(self) -> str:
        said = [str(self.summary.get("headline", ""))]
        said += [f"{one.get('lead', '')}. {one.get('text', '')}".strip(". ") for one in self.summary.get("verdict", [])]
        for title, table in self.list_shown().items():
            text = table.to_string(index=False, max_rows=ROWS, max_cols=8, float_format="{:.4g}".format)
            said.append(f"{title}:\n{text}")
        return make_plain("\n".join(one for one in said if one), but="\n")

    def _repr_html_(self) -> str:
        said = [f"<h3>{escape(str(self.summary.get('title', self.kind)))}</h3>"]
        if headline := self.summary.get("headline"):
            said.append(f"<p><strong>{escape(str(headline))}</strong></p>")
        verdict = [
            f"<li>{MARKS.get(str(one.get('level')), '')} <strong>{escape(str(one.get('lead', '')))}.</strong> "
            f"{escape(str(one.get('text', '')))}</li>"
            for one in self.summary.get("verdict", [])
        ]
        said += ["<ul>", *verdict, "</ul>"] if verdict else []
        for title, table in self.list_shown().items():
            text = table.to_html(
                index=False, max_rows=ROWS, max_cols=COLUMNS, float_format="{:.5g}".format, border=0, escape=True
            )
            said += [f"<h4>{escape(title)}</h4>", text]
        return "\n".join(said)


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

    def list_shown(self) -> dict[str, pd.DataFrame]:
        """Return parameters, and requirements where there are any."""
        found = {"parameters": self.parameters, "requirements": self.requirements}
        return {title: table for title, table in found.items() if not table.empty}

    def plot_contraction(self, axes: Axes | None = None) -> Axes:
        """Draw the contraction of every parameter, and return the axes."""
        from matplotlib.figure import Figure

        found = {name: one["contraction"] for name, one in self.summary["parameters"].items()}
        axes = axes or Figure(layout="constrained").subplots()
        axes.barh(list(found), list(found.values()))
        axes.invert_yaxis()
        axes.set_xlim(0.0, 1.0)
        axes.set_xlabel("contraction: 0 nothing is learnt, 1 everything")
        return axes


@dataclass(frozen=True, eq=False, repr=False)
class StudyResult(LoadedResults):
    """Results of a study: variants, their posteriors and predictions.

    Examples
    --------
    >>> isinstance(study, bc.StudyResult), study.variants, study.best
    (True, ['everything'], variant 'everything': log-evidence ..., 14 parameters)
    >>> study.best.predict({"s_1_mm": [250.0], "s_2_mm": [250.0], "s_3_mm": [250.0]}).columns[:4]
    Index(['pose', 'x_mm', 'y_mm', 'z_mm'], ...)
    """

    @property
    def ranking(self) -> pd.DataFrame:
        """The variants, the largest log-evidence first, indexed by their names.

        Evidences of different data do not compare: such variants follow those of the data that lead the report.
        """
        table = self.tables["variants"].set_index("variant")
        return table.loc[[name for group in self._rankings for name in group]]

    @property
    def _rankings(self) -> list[list[str]]:
        """Names of the variants, the best first, a list for each set of data, the largest set first."""
        rows = self.summary["variants"]
        return sorted(self.summary["rankings"], key=lambda names: (-rows[names[0]].get("n_equations", 0), -len(names)))

    def list_shown(self) -> dict[str, pd.DataFrame]:
        """Return the ranking of variants that are compared, and the accuracy of the best one's tool."""
        ranking, found = self.ranking.loc[self._rankings[0]].reset_index(), {}
        if len(ranking) > 1:
            found["variants"] = ranking[[name for name in RANKED if name in ranking]]
        if not (accuracy := self.results.table("accuracy")).empty:
            own = accuracy[accuracy["variant"] == self.best.name].drop(columns="variant")
            found[f"standard uncertainty of the tool, {self.best.name!r}"] = own
        return found

    @property
    def variants(self) -> list[str]:
        """Names of the variants, the best first."""
        return list(self.ranking.index)

    @property
    def best(self) -> VariantResult:
        """The variant of the largest log-evidence, of those that lead the report."""
        return self[self.variants[0]]

    def __getitem__(self, variant: str) -> VariantResult:
        """Return a variant by its name; InputError for an unknown one."""
        return VariantResult(self, self._check(variant))

    @property
    def parameters(self) -> pd.DataFrame:
        """Every parameter of every variant with its posterior."""
        return self.results.table("parameters")

    @property
    def predictions(self) -> pd.DataFrame:
        """What each variant predicts of poses, or of readings, beside what was measured."""
        table = self.results.table("predictions")
        return self.results.table("pose_errors") if table.empty else table  # of whole poses that an instrument measured

    def posterior(self, variant: str | None = None) -> xr.DataTree:
        """Return the posterior of a variant, the best by default, as ArviZ takes it.

        InputError for an unknown variant, and where the run has not kept the draws.
        """
        import xarray as xr

        name = self._check(variant)
        stems = {name.replace("/", "-").replace(" ", "_"), re.sub(r"[^\w.-]+", "_", name)}
        for stem in sorted(stems):
            path = self.folder / "posterior" / f"{stem}.nc"
            if path.is_file():
                return xr.open_datatree(path, engine="h5netcdf").load()
        raise InputError(f"{self.folder}: found no draws of {name!r} in posterior/, expected those that a run keeps")

    def plot_parameters(self, variant: str | None = None, axes: Axes | None = None) -> Axes:
        """Draw how far each parameter of a variant is from nominal, with its 90 % interval, and return the axes.

        In prior standard deviations: 0 is nominal, an interval as long as ±1.6 has learnt nothing.
        """
        from matplotlib.figure import Figure

        table = self.parameters[self.parameters["variant"] == self._check(variant)]
        table = table[table["mode"] == 1] if "mode" in table else table  # the most probable of several solutions
        table = table[np.isfinite(table["prior_sd"])]
        middle = (table["mean"] - table["nominal"]) / table["prior_sd"]
        ends = [((table[end] - table["mean"]) / table["prior_sd"]).abs() for end in ("q05", "q95")]
        axes = axes or Figure(layout="constrained").subplots()
        axes.errorbar(middle, table["parameter"], xerr=np.stack(ends), fmt="o", markersize=3.0)
        axes.axvline(0.0, color="0.6", linewidth=0.8)
        axes.invert_yaxis()
        axes.set_xlabel("deviation from nominal, prior standard deviations")
        return axes

    def _check(self, variant: str | None) -> str:
        if variant is None:
            return self.variants[0]
        if variant not in self.variants:
            raise InputError(f"{self.folder}: variant: {describe_unknown(self.variants, variant)}")
        return variant


@dataclass(frozen=True, eq=False)
class VariantResult:
    """One variant of a study: its posterior, and the machine as calibrated."""

    study: StudyResult
    name: str
    mode: int | None = None  # which of several solutions, from 1; see `take_mode`

    def take_mode(self, mode: int) -> VariantResult:
        """Return the same variant whose machine is one of several solutions; 1 is the most probable."""
        return replace(self, mode=mode)

    @property
    def posterior(self) -> xr.DataTree:
        """The posterior, as ArviZ takes it."""
        return self.study.posterior(self.name)

    @property
    def parameters(self) -> pd.DataFrame:
        """Every parameter with its posterior."""
        table = self.study.parameters
        return table[table["variant"] == self.name].drop(columns="variant").reset_index(drop=True)

    @cached_property
    def machine(self) -> CalibratedMachine:
        """The calibrated machine; InputError where its posterior did not converge, unless taken by force.

        Of several solutions one has to be taken first (`take_mode`).
        """
        from bayescal.experiments.shared.calibrating import load_calibrated

        study = self.study
        return load_calibrated(study.folder, self.name, trust=study.trust, force=study.force, mode=self.mode)

    def predict(self, commands: Table) -> pd.DataFrame:
        """Return where machine and tool are at commands, with standard deviations and covariances.

        Columns of the table are those of commanded channels, ``s_1_mm``, and of what is given of each row.
        """
        from bayescal.calibrated.predict import check_determined, predict_poses
        from bayescal.calibrated.tables import check_found, format_prediction, read_commands

        check_determined(self.machine)
        with _written(commands) as path:
            names, positions, given = read_commands(path, self.machine)
            found = predict_poses(self.machine, positions, given)
            check_found(path, names, found)
        return _read(format_prediction(self.machine, names, found, given))

    def command(self, poses: Table) -> pd.DataFrame:
        """Return the commands that hold poses, or the tool (columns ``tool_x_mm``), with their uncertainty."""
        from bayescal.calibrated.predict import command_poses
        from bayescal.calibrated.tables import check_reached, format_command, read_commanded

        with _written(poses) as path:
            wanted = read_commanded(path, self.machine)
            found = command_poses(self.machine, wanted.poses, wanted.given, wanted.coordinates)
            check_reached(wanted, found)
        return _read(format_command(self.machine, wanted.names, found, wanted.given))

    def tool_accuracy(self, coverage: float = 0.95, poses: int = 512) -> pd.DataFrame:
        """Return how well the tool's numbers are known over the workspace, rms over its poses, and at the worst.

        Standard uncertainty, and the expanded one of a coverage probability; in µm, µrad or the number's own unit. Base
        and tool are aligned over the workspace, and the expanded one without that stands beside, unless the study's
        `accuracy_frame` is the base.
        """
        import pandas as pd

        from bayescal.experiments.shared.certificate import Wishes, certify

        found = certify(self.machine, self.study.folder, Wishes(coverage, poses))
        stated = found.list_figures()
        expanded = stated["expanded_uncertainty"]
        return pd.DataFrame(
            {
                "unit": dict(zip(found.axis_names, found.units, strict=True)),
                "standard": stated["standard_uncertainty"]["combined"],
                "expanded": expanded["stated"],
                "largest": expanded["largest"],
                **({"unaligned": expanded["unaligned"]} if "unaligned" in expanded else {}),
            }
        )

    def export(self, folder: Path | str, name: str | None = None) -> list[Path]:
        """Write the machine as calibrated, with covariance and draws; see `export_machine`."""
        from bayescal.calibrated.formats import export_machine

        return export_machine(self.machine, Path(folder), name)

    def __repr__(self) -> str:
        row = self.study.ranking.loc[self.name]
        return f"variant {self.name!r}: log-evidence {row['log_evidence']:.2f}, {len(self.parameters)} parameters"


@contextmanager
def _written(table: Table) -> Iterator[Path]:
    """Let a table be a CSV file for as long as it is read, where it is none."""
    if isinstance(table, str | Path):
        yield Path(table)
        return
    found = name_rows(table)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "table.csv"
        found.to_csv(path, index=False)
        try:
            yield path
        except InputError as error:
            raise InputError(str(error).replace(str(path), "the table")) from error


def name_rows(table: pd.DataFrame | Mapping[str, Any]) -> pd.DataFrame:
    """Return a table whose first column names the poses: its own, else the index, else P1, P2 ..."""
    import pandas as pd

    alone = isinstance(table, Mapping) and all(np.ndim(one) == 0 for one in table.values())
    found = pd.DataFrame([table] if alone else table)
    if "pose" not in found.columns:
        plain = isinstance(found.index, pd.RangeIndex)
        names = [f"P{k}" for k in range(1, len(found) + 1)] if plain else [str(one) for one in found.index]
        found = found.reset_index(drop=True)
        found.insert(0, "pose", names)
    return found


def _read(text: str) -> pd.DataFrame:
    import pandas as pd

    return pd.read_csv(StringIO(text), comment="#")


CLASSES: dict[str, type[LoadedResults]] = {"study": StudyResult, "audit": Audit}


def load_results(folder: Path | str, trust: bool = False, force: bool = False) -> LoadedResults:
    """Return the results of a finished run: `StudyResult`, `Audit`, or `LoadedResults` of any other kind.

    With ``trust`` the code of a machine's own class that they keep is run where that is needed, though nobody has
    trusted it; with ``force`` posteriors are used that did not converge, and files that are not as they were written.

    Raises
    ------
    InputError
        Where the folder holds no results, or a file of them was edited, is missing or was added.

    Examples
    --------
    >>> bc.load_results(study.folder).ranking.index
    Index(['everything'], ...)
    """
    from bayescal.experiments.frame.results import read_results

    with overlooking(force):
        results = read_results(Path(folder))
    return CLASSES.get(str(results.provenance.get("kind")), LoadedResults)(results, trust, force)
