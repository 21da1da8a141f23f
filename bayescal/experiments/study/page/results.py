"""What a study found, of whatever machine, checked as far as its page depends on it."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, Self

import pandas as pd

from bayescal.errors import InputError
from bayescal.experiments.frame.results import SUMMARY_FILE, Results
from bayescal.experiments.shared.headline import Candidate, choose_best, list_candidates
from bayescal.experiments.study.page.posterior_files import Replicates, read_posteriors, read_replicates
from bayescal.experiments.study.page.publication import Publication, read_publication
from bayescal.report.numbers import MICROMETRES
from bayescal.report.reading import NUMBER, Kinds, Row, check_keys, list_rows
from bayescal.report.symbols import OF_KERNELS, Asked, scale_of, shown_in, split_name

if TYPE_CHECKING:
    from bayescal.numerics.geometry import Array

SETTINGS = {"free": "with model error", "zero": "without model error (τ = 0)"}
SHORT_SETTINGS = {"free": "free", "zero": "τ = 0"}
USES = ("calibration", "verification")
NOISE = "noise"
"""Verdict on parameters that are none of the machine's."""
FRAME = re.compile(r"(base[1-9]?|tool)_r?[xyz]")
STRUT = "strut"
VERDICTS = ("holds", "does not hold", "not testable")

SUMMARY_KEYS: dict[str, Kinds] = {
    **dict.fromkeys(("experiment", "title"), str),
    **dict.fromkeys(("origin", "units", "n_poses", "variants"), dict),
    "rankings": list,
}
ROW_KEYS: dict[str, Kinds] = {
    **dict.fromkeys(("title", "data", "problems", "log_evidence_by"), str),
    **dict.fromkeys(("n_parameters", "log_evidence", "log_evidence_se"), NUMBER),
    **dict.fromkeys(("log_evidence_importance", "log_evidence_bridge", "efficiency", "pareto_k"), NUMBER),
    **dict.fromkeys(("elpd_loo", "elpd_loo_se", "loo_unreliable", "loo_refitted", "loo_pareto_k_max"), NUMBER),
    **dict.fromkeys(("misfit_chi2", "misfit_dof", "pulls_chi2", "pulls_dof"), NUMBER),
    **dict.fromkeys(("rhat_max", "ess_bulk_min", "ess_tail_min"), NUMBER),
    "converged": bool,
}
COLUMNS: dict[str, dict[str, tuple[str, ...]]] = {
    "parameters": {
        "texts": ("variant", "model_error", "parameter", "unit", "verdict"),
        "numbers": ("nominal", "prior_sd", "mean", "sd", "q05", "q95", "contraction"),
    },
    "poses": {"texts": ("variant", "model_error", "pose", "use"), "numbers": ("elpd_loo", "pareto_k", "refitted")},
    "pose_errors": {
        "texts": ("variant", "model_error", "pose", "use"),
        "numbers": (
            *("position_error_mm", "position_bound_95_mm"),
            *("orientation_error_deg", "orientation_bound_95_deg"),
        ),
    },
    "predictions": {"texts": ("variant", "pose", "channel", "unit"), "numbers": ("measured", "mean", "sd", "inside")},
    "sensitivity": {"texts": ("variant",), "numbers": ("factor", "log_evidence", "pareto_k")},
    "tau_scale": {"texts": ("variant",), "numbers": ("tau_scale_um", "log_evidence", "pareto_k")},
    "least_squares": {
        "texts": ("variant", "parameter", "unit"),
        "numbers": ("leg", "offset", "published_offset", "difference", "leg_residual_rms_um", "converged"),
    },
    "ring": {
        "texts": ("pose", "use"),
        "numbers": ("leg", "actuator_displacement_mm", "deflection_um", "deflection_sd_um"),
    },
    "deformation": {"texts": ("quantity",), "numbers": ("leg", "actuator", "mean_1e-3", "sd_1e-3")},
    "flexure": {"texts": (), "numbers": ("flexure_length_mm", "bending_deg", "along_beam_um", "circle_error_nm")},
    "joints": {"texts": ("pose", "joint"), "numbers": ("leg", "x_mm", "y_mm", "z_mm")},
    "structured": {
        "texts": ("variant", "pose", "use"),
        "numbers": ("leg", "actuator", "travel_mm", "mean_um", "low_um", "high_um"),
    },
    "claims": {
        "texts": ("claim", "section", "statement", "expected", "found", "unit", "verdict", "why"),
        "numbers": ("value",),
    },
    "accuracy": {"texts": ("variant", "coordinate", "unit"), "numbers": ("before", "after", "noise")},
    "ridges": {"texts": ("variant", "parameter", "sentence"), "numbers": ("contraction",)},
    "next": {"texts": ("variant", "sensors"), "numbers": ("gain",)},
    "beside": {"texts": ("variant", "beside", "quantity", "unit"), "numbers": ("mean", "sd", "value", "value_sd")},
    "functions": {"texts": ("variant", "sensor", "of"), "numbers": ("present", "rms")},
    "function_curves": {"texts": ("variant", "sensor"), "numbers": ("reading", "mean", "low", "high")},
}
"""Columns of the tables that pages read; a table of another name belongs to whoever reads it."""
REQUIRED = ("parameters", "poses")


class ErrorScale(NamedTuple):
    """How errors of poses are shown: in words, their column, and factor and name of their unit."""

    what: str
    column: str
    factor: float
    unit: str

    def read(self, errors: Mapping[str, Any] | None, which: str) -> float:
        """Return the ``mean`` or ``max`` of a use's errors in that unit; NaN without."""
        return self.factor * get_number(errors[self.column], which) if errors else math.nan

    @property
    def label(self) -> str:
        """What an axis says."""
        return f"{self.what.capitalize()} error ({self.unit})"


@dataclass(frozen=True, eq=False)
class StudyResults:
    """What a study left, as its page needs it.

    Attributes
    ----------
    summary, config : dict
        As JSON has them.
    tables : mapping of str to DataFrame
        Those that have rows, by name.
    publication : Publication or None
        What the study repeats; None for anybody's machine.
    draws : dict
        For each variant whose posterior file is there, the draws (S,) of each parameter, with model error.
    replicates : Replicates or None
        Of the best variant; None where its posterior file is not there.
    n_chains : int
        Of the draws, in which they are laid end to end.
    """

    summary: dict[str, Any]
    config: dict[str, Any]
    tables: Mapping[str, pd.DataFrame]
    publication: Publication | None = None
    draws: dict[str, dict[str, Array]] = field(default_factory=dict)
    replicates: Replicates | None = None
    n_chains: int = 1

    @classmethod
    def of(cls, results: Results) -> Self:
        """Return what the page needs of results.

        Raises
        ------
        InputError
            Naming the file where something is missing or not what a study writes. The posteriors' files may be
            missing.
        """
        folder = results.folder or Path()
        summary, path = results.summary, folder / SUMMARY_FILE
        _check_summary(summary, path)
        tables = {name: table for name, table in results.tables.items() if not table.empty}
        _check_tables(tables, folder)
        publication = read_publication(summary, path)
        if "claims" in tables and publication is None:
            raise InputError(f"{path}: publication: found nothing, expected the one whose claims are tested")
        found = cls(summary, results.config, tables, publication)
        if results.folder is None:
            return found
        chains = read_posteriors(folder / "posterior", found.ranking)
        draws = {name: {one: x.ravel() for one, x in own.items()} for name, own in chains.items()}
        seen = read_replicates(folder / "posterior", found.best_name) if found.has("pose_errors") else None
        return cls(summary, results.config, tables, publication, draws, seen, _count_chains(chains))

    # --- tables --------------------------------------------------------------------------------------------------

    def has(self, name: str) -> bool:
        """Whether a table is there."""
        return name in self.tables

    def table(self, name: str, variant: str | None = None) -> pd.DataFrame:
        """Return a table, or a variant's rows of it; without rows where there is none."""
        columns = COLUMNS.get(name, {"texts": (), "numbers": ()})
        table = self.tables.get(name, pd.DataFrame(columns=[*columns["texts"], *columns["numbers"]]))
        return table if variant is None else table[table["variant"] == variant]

    def rows(self, name: str, variant: str | None = None) -> list[Row]:
        """Return the same row by row."""
        return list_rows(self.table(name, variant))

    # --- variants ------------------------------------------------------------------------------------------------

    @cached_property
    def own_names(self) -> dict[str, tuple[str, str]]:
        """Model and deformation of the variants that have names of their own."""
        named = self.summary.get("own_names", {})
        return {name: (one["model"], one["deformation"]) for name, one in named.items()}

    @cached_property
    def ranking(self) -> list[str]:
        """Names of the variants of the most data, the largest log-evidence first, what did not converge last."""
        names = {one.name for one in self.candidates()}
        return next(list(one) for one in self.summary["rankings"] if set(one) == names)

    @property
    def names(self) -> list[str]:
        """Names of all variants, those of one set of data together, the best first."""
        others = [name for ranking in self.summary["rankings"] for name in ranking if name not in self.ranking]
        return [*self.ranking, *others]

    def candidates(self, setting: str = "free") -> list[Candidate]:
        """Return the variants of the most data as the headline compares them, in the order of the study."""
        return list_candidates(self.summary, setting)

    @property
    def best_name(self) -> str:
        """The variant of the largest log-evidence."""
        return self.ranking[0]

    @property
    def best(self) -> dict[str, Any]:
        """Its row, with model error."""
        return self.fit(self.best_name, "free")

    @cached_property
    def chosen(self) -> str:
        """The variant to use."""
        return choose_best(self.summary)

    @property
    def settings(self) -> list[str]:
        """Settings of the model error that were computed."""
        return [one for one in SETTINGS if one == "free" or "without_model_error" in self.best]

    def fit(self, variant: str, setting: str = "free") -> dict[str, Any]:
        """Return a posterior's row of the summary."""
        free: dict[str, Any] = self.summary["variants"][variant]
        return free if setting == "free" else dict(free["without_model_error"])

    def fits(self) -> Iterator[tuple[str, str, dict[str, Any]]]:
        """Yield variant, setting and row of all posteriors, first with model error."""
        for setting in self.settings:
            for variant in self.names:
                yield variant, setting, self.fit(variant, setting)

    # --- the machine and the data --------------------------------------------------------------------------------

    @property
    def units(self) -> Asked:
        """Units of lengths and angles on the page."""
        found: dict[str, str] = self.summary["units"]
        return found

    def shown_in(self, unit: str) -> tuple[float, str]:
        """Return factor and name of the unit that values of an inner unit are shown in."""
        return shown_in(unit, self.units)

    def scale_of(self, symbol: str, unit: str) -> tuple[float, str]:
        """Return the factor and the unit in which a parameter's offsets are shown."""
        return scale_of(symbol, unit, self.units)

    @property
    def error_scales(self) -> tuple[ErrorScale, ...]:
        """The errors of poses that were measured, each with its unit on the page."""
        factor, unit = self.shown_in("rad")
        position = ErrorScale("position", "position_error_mm", MICROMETRES, "µm")
        scales = (position, ErrorScale("orientation", "orientation_error_deg", math.radians(factor), unit))
        errors = self.table("pose_errors")
        return tuple(one for one in scales if errors[one.column].notna().any())

    @property
    def has_struts(self) -> bool:
        """Whether the actuators change the lengths of struts; else they move the base points."""
        return bool(self.summary.get("drive") == STRUT)

    @property
    def n_verification(self) -> int:
        """How many poses were held back."""
        return int(self.summary["n_poses"]["verification"])

    @property
    def use(self) -> str:
        """The poses by which errors are judged: those held back where there are any."""
        return "verification" if self.n_verification else "calibration"

    @property
    def instrument(self) -> dict[str, Any] | None:
        """What instrument measured, and what it read; None for photogrammetry."""
        return self.summary.get("instrument")

    # --- parameters ----------------------------------------------------------------------------------------------

    @property
    def parameters(self) -> pd.DataFrame:
        """One row per posterior and parameter of the machine; ``leg`` is zero where a parameter belongs to none."""
        return self.all_parameters[~self._of_frames & ~self.all_parameters["symbol"].isin(OF_KERNELS)]

    @property
    def frames(self) -> pd.DataFrame:
        """The same of the frames of instrument and tool that were found; no rows where they were known."""
        return self.all_parameters[self._of_frames]

    @property
    def _of_frames(self) -> pd.Series:
        return self.all_parameters["symbol"].map(lambda symbol: bool(FRAME.fullmatch(symbol)))

    @cached_property
    def all_parameters(self) -> pd.DataFrame:
        """One row per posterior and parameter, with ``symbol`` and ``leg`` of its name."""
        table = self.tables["parameters"]
        split = [split_name(str(name)) for name in table["parameter"]]
        return table.assign(symbol=[symbol for symbol, _ in split], leg=[leg for _, leg in split])

    @cached_property
    def sensitivity_grid(self) -> pd.DataFrame:
        """Log-evidence with a row per factor on the priors and a column per variant, in the order of the ranking."""
        wide = self.table("sensitivity").pivot(index="factor", columns="variant", values="log_evidence")
        return wide.sort_index()[self.ranking]

    @property
    def legs(self) -> list[int]:
        """Numbers of the legs."""
        return sorted({*self.parameters["leg"], *self.table("least_squares")["leg"]} - {0})


def _count_chains(chains: Mapping[str, Mapping[str, Array]]) -> int:
    return next((len(x) for own in chains.values() for x in own.values()), 1)


def _check_tables(tables: Mapping[str, pd.DataFrame], results: Path) -> None:
    """Raise InputError where a table lacks a column or holds text in one of numbers."""
    folder = results / "tables" if (results / "tables").is_dir() else results
    for name in REQUIRED:
        if name not in tables:
            raise InputError(f"{folder / name}.csv: found no rows, expected a study's table")
    for name, columns in COLUMNS.items():
        if name not in tables:
            continue
        for column in (*columns["texts"], *columns["numbers"]):
            if column not in tables[name].columns:
                wanted = ", ".join((*columns["texts"], *columns["numbers"]))
                raise InputError(f"{folder / name}.csv: found no column {column!r}, expected {wanted}")
        for column in columns["numbers"]:
            if not pd.api.types.is_numeric_dtype(tables[name][column]):  # flags are numeric too
                raise InputError(f"{folder / name}.csv: column {column!r}: found text, expected numbers")
    for row in list_rows(tables["claims"]) if "claims" in tables else ():
        if row["verdict"] not in VERDICTS:
            wanted = f"found {row['verdict']!r}, expected one of {', '.join(VERDICTS)}"
            raise InputError(f"{folder / 'claims.csv'}: claim {row['claim']}: verdict: {wanted}")


def _check_summary(summary: dict[str, Any], path: Path) -> None:
    check_keys(summary, SUMMARY_KEYS, path, "")
    check_keys(summary["n_poses"], dict.fromkeys(USES, NUMBER), path, "n_poses.")
    ranked = [name for names in summary["rankings"] for name in names]
    if not summary["variants"] or sorted(ranked) != sorted(summary["variants"]):
        raise InputError(
            f"{path}: rankings: found {summary['rankings']}, expected each of {list(summary['variants'])} once"
        )
    for name, row in summary["variants"].items():
        check_keys(summary["variants"], {name: dict}, path, "variants.")
        check_keys(row, ROW_KEYS, path, f"variants.{name}.")
        if "without_model_error" in row:
            check_keys(row["without_model_error"], ROW_KEYS, path, f"variants.{name}.without_model_error.")


def get_number(content: Mapping[str, Any], key: str) -> float:
    """Return a number that may be missing, NaN then."""
    value = content.get(key)
    return float(value) if isinstance(value, NUMBER) else math.nan
