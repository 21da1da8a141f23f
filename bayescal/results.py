"""Results of finished runs for notebooks and scripts: tables as DataFrames, posteriors as DataTrees, plots as axes."""

from __future__ import annotations

import base64
import io
import re
import warnings
from dataclasses import dataclass, replace
from functools import cached_property
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from bayescal.config.load import describe_unknown
from bayescal.errors import InputError
from bayescal.files.manifest import overlooking
from bayescal.files.memory import MemoryPath
from bayescal.files.plain_text import make_plain
from bayescal.report.findings import FindingRow
from bayescal.stated import StatedExperiment, Table, name_rows

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr
    from matplotlib.axes import Axes

    from bayescal.calibrated.machine import CalibratedMachine
    from bayescal.experiments.runner.results import Results

RANKED = ("variant", "n_parameters", "log_evidence", "elpd_loo_difference", "reduced_chi", "converged", "problems")
"""What is shown of variants that are compared."""
ROWS, COLUMNS = 12, 14
MARKS = {"good": "✓", "warning": "!", "bad": "✗"}
COLOURS = {"good": "#1a7f37", "warning": "#9a6700", "bad": "#cf222e"}
CARD = "border:1px solid #c8ccd0;border-radius:6px;padding:0.2em 1em 0.8em;overflow-x:auto"
"""Style of results in a notebook."""


@dataclass(frozen=True, eq=False)
class LoadedResults:
    """A results directory of any kind.

    Examples
    --------
    >>> isinstance(plan, bc.LoadedResults), plan.kind, plan.findings.columns[:3]
    (True, 'audit', Index(['subject', 'status', 'value'], ...))
    """

    first_figure: ClassVar[str] = ""  # what is shown of them in a notebook, by its file's stem

    results: Results
    trust: bool = False  # whether the code of own classes that the results keep is run, trusted or not
    allow_unconverged: bool = False  # whether a posterior is used that did not converge
    allow_changed_files: bool = False  # whether files are taken that are not as they were written
    made_of: StatedExperiment | None = None  # what a call stated; of loaded results it is what these keep

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

    @property
    def findings(self) -> pd.DataFrame:
        """What the experiment says: subject, status, value, limit, unit, text and action of each finding."""
        return self.results.table(FindingRow.table)

    def page(self, path: Path | str) -> Path:
        """Write the report, one HTML file without anything beside it."""
        from bayescal.report.page import PAGE

        source, target = self.folder / PAGE, Path(path)
        if not source.is_file():
            raise InputError(f"{source}: no such file, expected the page; bayescal report writes it")
        if not target.parent.is_dir():
            raise InputError(f"{target}: found no folder {target.parent}, expected one")
        target.write_bytes(source.read_bytes())
        return target

    @property
    def stated(self) -> StatedExperiment:
        """What the experiment was stated by; InputError for results that keep no inputs."""
        from bayescal.config.trust import vouch
        from bayescal.experiments.runner.kept_inputs import read_inputs

        if self.made_of is not None:
            return self.made_of
        content, name, files = read_inputs(self.results)
        if self.trust:
            vouch(text for file, text in files.items() if file.endswith(".py"))
        return StatedExperiment(content, dict(files), file=name)

    def to_toml(self, folder: Path | str | None = None) -> str:
        """Return the config that gives these results; written with machine and readings to a folder if one is named."""
        return self.stated.to_toml(folder)

    def list_shown(self) -> dict[str, pd.DataFrame]:
        """Return the tables that are shown with headline and findings, by their titles."""
        return dict([item for item in self.tables.items() if item[0] != FindingRow.table][:1])

    def __repr__(self) -> str:
        said = [str(self.summary.get("headline", ""))]
        said += [str(one) for one in FindingRow.read(self.findings)]
        for title, table in self.list_shown().items():
            text = table.to_string(index=False, max_rows=ROWS, max_cols=8, float_format="{:.4g}".format)
            said.append(f"{title}:\n{text}")
        return make_plain("\n".join(one for one in said if one), but="\n")

    def _repr_html_(self) -> str:
        said = [f"<h3>{escape(str(self.summary.get('title', self.kind)))}</h3>"]
        if headline := self.summary.get("headline"):
            said.append(f"<p><strong>{escape(str(headline))}</strong></p>")
        findings = [
            f"<li><span style='color:{COLOURS.get(one.status, 'inherit')}'>{MARKS.get(one.status, '')} "
            f"<strong>{escape(one.subject)}.</strong></span> {escape(f'{one.text} {one.action}'.strip())}</li>"
            for one in FindingRow.read(self.findings)
        ]
        said += ["<ul>", *findings, "</ul>"] if findings else []
        picture = None if self.results.folder is None else self.folder / "figures" / f"{self.first_figure}.png"
        if picture is not None and picture.is_file():
            content = base64.b64encode(picture.read_bytes()).decode()
            said.append(f"<img alt='{self.first_figure}' style='max-width:100%' src='data:image/png;base64,{content}'>")
        for title, table in self.list_shown().items():
            text = table.to_html(
                index=False, max_rows=ROWS, max_cols=COLUMNS, float_format="{:.5g}".format, border=0, escape=True
            )
            said += [f"<h4>{escape(title)}</h4>", f"<div style='white-space:nowrap'>{text}</div>"]  # rows of one line
        return f"<div style='{CARD}'>{'\n'.join(said)}</div>"


@dataclass(frozen=True, eq=False, repr=False)
class AuditResult(LoadedResults):
    """Results of an audit: what planned measurements would determine."""

    first_figure: ClassVar[str] = "contraction"

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

    first_figure: ClassVar[str] = "before_after"

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
                return xr.load_datatree(io.BytesIO(path.read_bytes()), engine="h5netcdf")
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
    """One variant of a study: its posterior, and the machine as calibrated.

    Examples
    --------
    >>> isinstance(study.best, bc.VariantResult), study.best.name
    (True, 'everything')
    """

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
        """The calibrated machine; InputError where its posterior did not converge, unless that is allowed.

        Of several solutions one has to be taken first (`take_mode`).
        """
        from bayescal.experiments.shared.calibrating import load_calibrated

        study = self.study
        return load_calibrated(
            study.folder,
            self.name,
            allow_unconverged=study.allow_unconverged,
            allow_changed_files=study.allow_changed_files,
            trust=study.trust,
            mode=self.mode,
        )

    def predict(self, commands: Table) -> pd.DataFrame:
        """Return where machine and tool are at commands, with standard deviations and covariances.

        Columns of the table are those of commanded channels, ``s_1_mm``, and of what is given of each row.
        """
        from bayescal.calibrated.one_place import take_one_place
        from bayescal.calibrated.predict import check_determined, predict_poses
        from bayescal.calibrated.tables import check_found, format_prediction, read_commands, say_contradictory

        machine = take_one_place(self.machine)
        check_determined(machine)
        path = _keep(commands)
        names, positions, given = read_commands(path, machine)
        found = predict_poses(machine, positions, given)
        check_found(path, names, found)
        if said := say_contradictory(path, names, found):
            warnings.warn(said, stacklevel=2)
        return _read(format_prediction(machine, names, found, given))

    def compensate(self, poses: Table) -> pd.DataFrame:
        """Return the commands that hold poses, or the tool (columns ``tool_x_mm``), with their uncertainty."""
        from bayescal.calibrated.one_place import take_one_place
        from bayescal.calibrated.predict import compensate_poses
        from bayescal.calibrated.tables import check_reached, format_command, read_commanded

        machine = take_one_place(self.machine)
        wanted = read_commanded(_keep(poses), machine)
        found = compensate_poses(machine, wanted.poses, wanted.given, wanted.coordinates)
        check_reached(wanted, found)
        return _read(format_command(machine, wanted.names, found, wanted.given))

    def tool_accuracy(self, coverage: float = 0.95, poses: int = 512) -> pd.DataFrame:
        """Return how well the tool's numbers are known over the workspace, rms over its poses, and at the worst.

        Standard uncertainty, and the expanded one of a coverage probability; in µm, µrad or the number's own unit. Base
        and tool are aligned over the workspace, and the expanded one without that stands beside, unless the study's
        `accuracy_frame` is the base.
        """
        import pandas as pd

        from bayescal.experiments.shared.certificate import CertificateOptions, certify

        found = certify(self.machine, self.study.folder, CertificateOptions(coverage, poses))
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


def _keep(table: Table) -> Path:
    """Return the CSV file of a table, one in memory where it is none."""
    if isinstance(table, str | Path):
        return Path(table)
    return MemoryPath("the table", files={"the table": name_rows(table).to_csv(index=False).encode()})


def _read(text: str) -> pd.DataFrame:
    import pandas as pd

    return pd.read_csv(io.StringIO(text), comment="#")


CLASSES: dict[str, type[LoadedResults]] = {"study": StudyResult, "audit": AuditResult}


def load_results(
    folder: Path | str, trust: bool = False, allow_unconverged: bool = False, allow_changed_files: bool = False
) -> LoadedResults:
    """Return the results of a finished run: `StudyResult`, `AuditResult`, or `LoadedResults` of any other kind.

    With ``trust`` the code of a machine's own class that they keep is run where that is needed, though nobody has
    trusted it; ``allow_unconverged`` uses posteriors that did not converge, ``allow_changed_files``
    files that changed, with a warning that lists them.

    Raises
    ------
    InputError
        Where the folder holds no results, or a file of them was edited, is missing or was added.

    Examples
    --------
    >>> bc.load_results(study.folder).ranking.index
    Index(['everything'], ...)
    """
    from bayescal.experiments.runner.results import read_results

    with overlooking(allow_changed_files):
        results = read_results(folder if isinstance(folder, Path) else Path(folder))
    return wrap_results(results, trust, allow_unconverged, allow_changed_files)


def wrap_results(
    results: Results,
    trust: bool = False,
    allow_unconverged: bool = False,
    allow_changed_files: bool = False,
    made_of: StatedExperiment | None = None,
) -> LoadedResults:
    """Return results by their kind: `StudyResult`, `AuditResult`, or `LoadedResults` of any other."""
    found = CLASSES.get(str(results.provenance.get("kind")), LoadedResults)
    return found(results, trust, allow_unconverged, allow_changed_files, made_of)
