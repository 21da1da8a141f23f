"""What a study found, checked as far as its page leans on it."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

import pandas as pd

from bayescal.errors import InputError
from bayescal.experiments.frame.results import SUMMARY_FILE, Results
from bayescal.experiments.shared.joints import COLUMNS as JOINT_COLUMNS
from bayescal.experiments.study.page.posterior_files import Replicates, read_posteriors, read_replicates
from bayescal.experiments.study.page.publication import Publication, read_publication
from bayescal.report.reading import NUMBER, Kinds, check_keys
from bayescal.report.symbols import OF_KERNELS, split_name

if TYPE_CHECKING:
    from bayescal.numerics.geometry import Array

SETTINGS = {"free": "with model error", "zero": "without model error (τ = 0)"}
SHORT_SETTINGS = {"free": "free", "zero": "τ = 0"}
USES = ("calibration", "verification")
TEXT_COLUMNS = (
    *("variant", "model_error", "joint", "pose", "use", "parameter", "unit", "quantity"),
    *("claim", "section", "statement", "expected", "found", "verdict", "why"),
)
VERDICTS = ("holds", "does not hold", "not testable")
BASE, STRUT = "base", "strut"

SUMMARY_KEYS: dict[str, Kinds] = {
    "experiment": str,
    "title": str,
    "data_origin": str,
    "n_poses": dict,
    "variants": dict,
    "ranking": list,
}
OPTIONAL_KEYS: dict[str, Kinds] = {
    **dict.fromkeys(("models", "instrument", "own_names", "not_free", "stacked"), dict),
    "drive": str,
}
FIT_KEYS: dict[str, Kinds] = {
    **dict.fromkeys(("n_parameters", "log_evidence", "log_evidence_se", "elpd_loo", "elpd_loo_se"), NUMBER),
    **dict.fromkeys(("elpd_loo_n_bad_k", "elpd_loo_pareto_k_max", "rhat_max", "ess_bulk_min", "ess_tail_min"), NUMBER),
    **dict.fromkeys(("acceptance", "wall_seconds"), NUMBER),
    **dict.fromkeys(("log_evidence_methods", "log_evidence_method_se", "importance", "calibration"), dict),
    **dict.fromkeys(("parameters", "distance_from_nominal", "misfit", "pulls"), dict),
    "log_evidence_primary": str,
    "log_evidence_agrees": bool,
    "converged": bool,
    "problems": list,
}
NESTED_KEYS = {
    "log_evidence_methods": ("importance", "bridge"),
    "log_evidence_method_se": ("importance", "bridge"),
    "importance": ("efficiency", "pareto_k", "n_draws"),
    "distance_from_nominal": ("rms_mm", "rms_prior_sd"),
    "misfit": ("chi2", "dof"),
    "pulls": ("chi2", "dof"),
}
ERROR_KEYS: dict[str, Kinds] = {
    "position_error_mm": dict,
    "orientation_error_deg": dict,
    "interval_90_coverage": NUMBER,
    "bound_95_coverage": NUMBER,
}
PARAMETER_KEYS = ("nominal", "mean", "sd", "q05", "q95", "prior_sd")
TABLE_COLUMNS = {
    "predictions": (
        "variant",
        "model_error",
        "pose",
        "use",
        "position_error_mm",
        "position_bound_95_mm",
        "orientation_error_deg",
        "orientation_bound_95_deg",
    ),
    "left_out": (
        *("variant", "model_error", "pose", "use", "elpd", "pareto_k", "refitted"),
        *("x_pit", "y_pit", "z_pit", "rx_pit", "ry_pit", "rz_pit", "position_pit", "orientation_pit"),
    ),
    "power_scaling": ("variant", "parameter", "prior", "likelihood"),
    "blunders": ("variant", "model_error", "pose", "use", "probability"),
    "sensitivity": ("variant", "factor", "log_evidence", "log_evidence_se", "efficiency", "pareto_k"),
    "tau_scale": ("variant", "tau_scale_um", "log_evidence", "efficiency", "pareto_k"),
    "least_squares": (
        "variant",
        "parameter",
        "leg",
        "unit",
        "nominal",
        "offset",
        "published_offset",
        "difference",
        "leg_residual_rms_um",
        "converged",
    ),
    "ring": ("pose", "use", "leg", "actuator_displacement_mm", "deflection_um", "deflection_sd_um"),
    "deformation": ("quantity", "leg", "actuator", "mean_1e-3", "sd_1e-3"),
    "flexure": (
        "flexure_length_mm",
        "bending_deg",
        "across_um",
        "along_beam_um",
        "along_pivot_um",
        "along_circle_um",
        "circle_error_nm",
    ),
    "joints": JOINT_COLUMNS,
    "structured": ("variant", "pose", "use", "leg", "actuator", "travel_mm", "mean_um", "low_um", "high_um"),
    "claims": ("claim", "section", "statement", "expected", "found", "value", "unit", "verdict", "why"),
}
REQUIRED = ("predictions", "left_out", "sensitivity", "least_squares")
NEEDING_POSES = "least_squares"  # is not there where an instrument measures poses in part or in a frame of its own
FRAME = re.compile(r"(base[1-9]?|tool)_r?[xyz]")
TOGETHER = ("ring", "deformation")  # both are there, or neither


@dataclass(frozen=True, eq=False)
class StudyResults:
    """What a study left, as its page needs it.

    Attributes
    ----------
    summary, config : dict
        As JSON has them.
    predictions, left_out, sensitivity, least_squares : DataFrame
        Tables of the study; without rows the last where no least squares was done.
    power_scaling : DataFrame or None
        How much each parameter depends on the prior and on the measurements; None where no posterior has any.
    blunders : DataFrame or None
        How probable it is that each pose is one; None where none may be.
    tau_scale : DataFrame or None
        Log-evidences for other scales of the model error's prior; None where no variant has one.
    ring, deformation : DataFrame or None
        Deflections of the joints and what follows from them; None without targets on the pads.
    claims : DataFrame or None
        Statements of the publication, each with a verdict; None where the study tests none.
    flexure : DataFrame or None
        Displacement of a flexure joint; None where no model has flexures.
    joints : DataFrame or None
        Where the machine's joints stand, pose by pose; None in results of earlier versions.
    structured : DataFrame or None
        The structured model error at every pose; None where no variant has one.
    publication : Publication or None
        What the study repeats; None for anybody's machine.
    draws : dict
        For each variant whose posterior file is there, the draws (S,) of each parameter, model error free.
    replicates : Replicates or None
        Of the best variant; None where its posterior file is not there.
    """

    summary: dict[str, Any]
    config: dict[str, Any]
    predictions: pd.DataFrame
    left_out: pd.DataFrame
    sensitivity: pd.DataFrame
    least_squares: pd.DataFrame
    power_scaling: pd.DataFrame | None = None
    blunders: pd.DataFrame | None = None
    tau_scale: pd.DataFrame | None = None
    ring: pd.DataFrame | None = None
    deformation: pd.DataFrame | None = None
    claims: pd.DataFrame | None = None
    flexure: pd.DataFrame | None = None
    joints: pd.DataFrame | None = None
    structured: pd.DataFrame | None = None
    publication: Publication | None = None
    draws: dict[str, dict[str, Array]] = field(default_factory=dict)
    replicates: Replicates | None = None

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
        required = [name for name in REQUIRED if name != NEEDING_POSES or "instrument" not in summary]
        tables = _take_tables(results, folder / "tables", required)
        _check_tables(tables, summary["ranking"], folder / "tables")
        tables.setdefault(NEEDING_POSES, pd.DataFrame(columns=list(TABLE_COLUMNS[NEEDING_POSES])))
        publication = read_publication(summary, path)
        if "claims" in tables and publication is None:
            raise InputError(f"{path}: publication: found nothing, expected the one whose claims are tested")
        folder, ranking = results.folder or Path(), summary["ranking"]
        draws = {} if results.folder is None else read_posteriors(folder / "posterior", ranking)
        seen = None if results.folder is None else read_replicates(folder / "posterior", ranking[0])
        return cls(summary, results.config, **tables, publication=publication, draws=draws, replicates=seen)

    @cached_property
    def own_names(self) -> dict[str, tuple[str, str]]:
        """Model and deformation of the variants that have names of their own."""
        named = self.summary.get("own_names", {})
        return {name: (one["model"], one["deformation"]) for name, one in named.items()}

    @property
    def ranking(self) -> list[str]:
        """Names of the variants, the largest log-evidence first."""
        return list(self.summary["ranking"])

    @property
    def best(self) -> dict[str, Any]:
        """The best variant's fit, model error free."""
        return self.fit(self.ranking[0], "free")

    @property
    def has_struts(self) -> bool:
        """Whether the actuators change the lengths of struts; else they move the base points."""
        return bool(self.summary.get("drive", BASE) == STRUT)

    @property
    def n_verification(self) -> int:
        """How many poses were held back."""
        return int(self.summary["n_poses"]["verification"])

    def fit(self, variant: str, setting: str) -> dict[str, Any]:
        """Return the summary of one posterior."""
        free: dict[str, Any] = self.summary["variants"][variant]
        found: dict[str, Any] = free if setting == "free" else free["without_model_error"]
        return found

    def fits(self) -> Iterator[tuple[str, str, dict[str, Any]]]:
        """Yield variant, setting and fit of all posteriors, in the order of the ranking, first with model error."""
        for setting in SETTINGS:
            for variant in self.ranking:
                yield variant, setting, self.fit(variant, setting)

    @property
    def instrument(self) -> dict[str, Any] | None:
        """What instrument measured, and what it read; None for photogrammetry."""
        return self.summary.get("instrument")

    @property
    def parameters(self) -> pd.DataFrame:
        """One row per posterior and parameter of the machine; ``leg`` is zero where a parameter belongs to none."""
        return self._all_parameters[~self._of_frames & ~self._all_parameters["symbol"].isin(OF_KERNELS)]

    @property
    def frames(self) -> pd.DataFrame:
        """The same of the frames of instrument and tool that were found; no rows where they were known."""
        return self._all_parameters[self._of_frames]

    @property
    def _of_frames(self) -> pd.Series:
        return self._all_parameters["symbol"].map(lambda symbol: bool(FRAME.fullmatch(symbol)))

    @cached_property
    def _all_parameters(self) -> pd.DataFrame:
        rows = []
        for variant, setting, fit in self.fits():
            for name, values in fit["parameters"].items():
                symbol, leg = split_name(name)
                rows.append({"variant": variant, "model_error": setting, "symbol": symbol, "leg": leg, **values})
        return pd.DataFrame(rows)

    @cached_property
    def sensitivity_grid(self) -> pd.DataFrame:
        """Log-evidence with a row per factor on the priors and a column per variant, in the order of the ranking."""
        wide = self.sensitivity.pivot(index="factor", columns="variant", values="log_evidence")
        return wide.sort_index()[self.ranking]

    @property
    def legs(self) -> list[int]:
        """Numbers of the legs."""
        return sorted({*self.parameters["leg"], *self.least_squares["leg"]} - {0})


def _take_tables(results: Results, folder: Path, required: Iterable[str]) -> dict[str, pd.DataFrame]:
    """Return the tables that are there, by name; each has its columns, and those that are no texts hold numbers."""
    tables = {name: results.table(name) for name in TABLE_COLUMNS}
    there = {name: table for name, table in tables.items() if not table.empty}
    needed = (*required, *(TOGETHER if set(TOGETHER) & set(there) else ()))
    for name in needed:
        if name not in there:
            raise InputError(f"{folder / name}.csv: found no rows, expected a study's table")
    for name, table in there.items():
        for column in TABLE_COLUMNS[name]:
            if column not in table.columns:
                wanted = ", ".join(TABLE_COLUMNS[name])
                raise InputError(f"{folder / name}.csv: found no column {column!r}, expected {wanted}")
            if column not in TEXT_COLUMNS and not pd.api.types.is_numeric_dtype(table[column]):  # flags are numeric too
                raise InputError(f"{folder / name}.csv: column {column!r}: found text, expected numbers")
    return there


def _check_tables(tables: Mapping[str, pd.DataFrame], variants: list[str], folder: Path) -> None:
    for name in (one for one in REQUIRED if one in tables):
        missing = [variant for variant in variants if variant not in set(tables[name]["variant"])]
        if missing:
            raise InputError(f"{folder / name}.csv: found no row of {missing[0]!r}, expected all variants")
    _check_settings(tables["predictions"], variants, folder / "predictions.csv")
    _check_grid(tables["sensitivity"], folder / "sensitivity.csv")
    if "claims" in tables:
        _check_claims(tables["claims"], folder / "claims.csv")


def _check_settings(predictions: pd.DataFrame, variants: list[str], path: Path) -> None:
    found = set(zip(predictions["variant"], predictions["model_error"], predictions["use"], strict=True))
    for variant, setting, use in product(variants, SETTINGS, sorted(set(predictions["use"]))):
        if (variant, setting, use) not in found:
            raise InputError(f"{path}: found no row of {variant!r} with {setting!r} and {use!r}, expected some")


def _check_grid(sensitivity: pd.DataFrame, path: Path) -> None:
    counts = sensitivity.groupby(["variant", "factor"])["log_evidence"].count()
    expected = sensitivity["variant"].nunique() * sensitivity["factor"].nunique()
    if len(counts) != expected or (counts != 1).any():
        raise InputError(f"{path}: found {len(sensitivity)} rows, expected each variant once at each factor")


def _check_claims(claims: pd.DataFrame, path: Path) -> None:
    for row in claims.itertuples():
        if row.verdict not in VERDICTS:
            raise InputError(
                f"{path}: claim {row.claim}: verdict: found {row.verdict!r}, expected one of {', '.join(VERDICTS)}"
            )


def _check_summary(summary: dict[str, Any], path: Path) -> None:
    check_keys(summary, SUMMARY_KEYS, path, "")
    check_keys(summary["n_poses"], dict.fromkeys(USES, NUMBER), path, "n_poses.")
    if "instrument" not in summary:
        extraction: dict[str, Kinds] = {"method": str, "rejected_targets": list}
        check_keys(summary, {"pose_extraction": dict}, path, "")
        check_keys(summary["pose_extraction"], extraction, path, "pose_extraction.")
    check_keys(summary, {key: kind for key, kind in OPTIONAL_KEYS.items() if key in summary}, path, "")
    models = summary.get("models", {})
    check_keys(models, dict.fromkeys(models, str), path, "models.")
    for name, one in summary.get("own_names", {}).items():
        check_keys(summary["own_names"], {name: dict}, path, "own_names.")
        check_keys(one, {"model": str, "deformation": str}, path, f"own_names.{name}.")
    not_free = summary.get("not_free", {})
    check_keys(not_free, dict.fromkeys(not_free, list), path, "not_free.")
    if summary.get("drive", BASE) not in (BASE, STRUT):
        raise InputError(f"{path}: drive: found {summary['drive']!r}, expected {BASE} or {STRUT}")
    if not summary["variants"] or sorted(summary["ranking"]) != sorted(summary["variants"]):
        raise InputError(
            f"{path}: ranking: found {summary['ranking']}, expected each of {list(summary['variants'])} once"
        )
    uses = [use for use in USES if summary["n_poses"][use]]
    for name, fit in summary["variants"].items():
        check_keys(summary["variants"], {name: dict}, path, "variants.")
        _check_fit(fit, uses, path, f"variants.{name}.")
        check_keys(fit, {"without_model_error": dict}, path, f"variants.{name}.")
        _check_fit(fit["without_model_error"], uses, path, f"variants.{name}.without_model_error.")


def _check_fit(fit: dict[str, Any], uses: list[str], path: Path, where: str) -> None:
    check_keys(fit, FIT_KEYS, path, where)
    for key, inner in NESTED_KEYS.items():
        check_keys(fit[key], dict.fromkeys(inner, NUMBER), path, f"{where}{key}.")
    for name, values in fit["parameters"].items():
        check_keys(fit["parameters"], {name: dict}, path, f"{where}parameters.")
        check_keys(values, {**dict.fromkeys(PARAMETER_KEYS, NUMBER), "unit": str}, path, f"{where}parameters.{name}.")
    for use in uses:
        check_keys(fit, {use: dict}, path, where)
        check_keys(fit[use], ERROR_KEYS, path, f"{where}{use}.")
        for key in ("position_error_mm", "orientation_error_deg"):
            sizes = (*NUMBER, type(None))  # nothing where it was not measured
            check_keys(fit[use][key], dict.fromkeys(("mean", "max"), sizes), path, f"{where}{use}.{key}.")


def get_number(content: Mapping[str, Any], key: str) -> float:
    """Return a number that may be missing, NaN then."""
    value = content.get(key)
    return float(value) if isinstance(value, NUMBER) else math.nan
