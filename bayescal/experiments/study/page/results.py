"""What a study found, of whatever machine, checked as far as its page depends on it."""

from __future__ import annotations

import io
import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, Self

import h5py
import numpy as np
import pandas as pd

from bayescal.errors import InputError
from bayescal.experiments.runner.results import NUMBER, PRELIMINARY, SUMMARY_FILE, Kinds, Results, Summary, check_keys
from bayescal.experiments.shared.headline import (
    Candidate,
    choose_best,
    group_candidates,
    label_title,
    list_candidates,
    read_rows,
)
from bayescal.experiments.shared.knowledge_page import is_aligned
from bayescal.experiments.shared.posterior_files import MODE, name_file
from bayescal.experiments.shared.rows import USES, ModelErrorRow
from bayescal.experiments.shared.study_schema import stem_of
from bayescal.experiments.study.rows import REQUIRED, ROWS, ParameterRow, RequirementResultRow, VariantRow
from bayescal.files.rows import TableRow, check_tables
from bayescal.report.blocks import Column
from bayescal.report.numbers import MICROMETRES, format_pair, name_some
from bayescal.report.symbols import (
    OF_FUNCTIONS,
    ChosenUnits,
    choose_error_unit,
    describe_deformation,
    name_parameter,
    scale_of,
    shown_in,
    split_name,
)

if TYPE_CHECKING:
    from bayescal.numerics.geometry import Array

VARIANT = Column("Variant", kind="name")
RANDOM_TERM = "random"
ALL = "all"
"""What requirements are called together."""
TERMS = (RANDOM_TERM, "linear", "positioning", "smooth", "drift")
"""Of a model error; all but the first are systematic, and together they have a size, too."""
SOLUTIONS = "solutions"
"""Rows of ``parameters`` of variants with several solutions, of all of these; ``parameters`` keeps the first."""
NOISE = "noise"
"""Verdict on parameters that are none of the machine's."""
MAX_SOLUTIONS = 8  # of a variant that are shown
FRAME = re.compile(r"(base[1-9]?|tool)_r?[xyz]")
PUBLICATION_KEYS: dict[str, Kinds] = {"source": str, "citation": str, "figures": dict, "notation": dict}

SUMMARY_KEYS: dict[str, Kinds] = {
    **dict.fromkeys(("experiment", "title"), str),
    **dict.fromkeys(("origin", "units", "n_poses", "variants"), dict),
    "rankings": list,
}
KINDS: dict[type, Kinds] = {str: str, bool: bool, float: NUMBER, int: NUMBER}
ROW_KEYS: dict[str, Kinds] = {
    one.name: KINDS[one.kind] for one in VariantRow.list_columns() if not one.is_optional and one.name != "variant"
}
"""Keys of a variant in the summary: the columns of its table."""

NAMES = {row.table: row.list_names() for row in ROWS}
"""Columns of a study's tables."""


class ErrorScale(NamedTuple):
    """How errors of poses are shown: in words, columns of them and of their bounds, factor and name of their unit."""

    what: str
    column: str
    bound: str
    factor: float
    unit: str

    def read(self, errors: Summary | None, which: str) -> float:
        """Return the ``mean`` or ``max`` of a use's errors in that unit; NaN without."""
        return self.factor * get_number(errors[self.column], which) if errors else math.nan

    def read_both(self, errors: Summary | None) -> tuple[float, float]:
        """Return the mean and the largest one."""
        return self.read(errors, "mean"), self.read(errors, "max")

    def format_both(self, errors: Summary | None) -> str:
        """Return both as a table shows them."""
        return format_pair(*self.read_both(errors), 2)

    @property
    def title(self) -> str:
        """What a heading says."""
        return f"{self.what.capitalize()} error"

    @property
    def label(self) -> str:
        """What an axis says."""
        return f"{self.title} ({self.unit})"


POSITION = ErrorScale("position", "position_error_mm", "position_bound_95_mm", MICROMETRES, "µm")


@dataclass(frozen=True, eq=False)
class StudyResults:
    """What a study left, as its page needs it."""

    summary: Summary  # with config: as JSON has them
    config: dict[str, Any]
    tables: Mapping[str, pd.DataFrame]  # those that have rows, by name
    # for each variant whose posterior file is there, the draws (S,) of each parameter
    draws: dict[str, dict[str, Array]] = field(default_factory=dict)
    n_chains: int = 1  # of the draws, in which they are laid end to end
    modes: dict[str, np.ndarray] = field(default_factory=dict)  # to which of several solutions they belong, from 1
    _tables: dict[tuple[str, str | None], pd.DataFrame] = field(default_factory=dict, init=False)
    _read: dict[tuple[type[TableRow], str | None], list[Any]] = field(default_factory=dict, init=False)

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
        check_keys(results.summary, SUMMARY_KEYS, folder / SUMMARY_FILE, "")
        summary = {**results.summary, "variants": read_rows(results.summary)}
        _check_summary(summary, folder / SUMMARY_FILE)
        tables = {name: table for name, table in results.tables.items() if not table.empty}
        _check_tables(tables, folder)
        if "claims" in tables and "publication" not in results.summary:
            wanted = "found nothing, expected the publication"
            raise InputError(f"{folder / SUMMARY_FILE}: publication: {wanted}")
        every = tables["parameters"]
        if "mode" in every:  # NaN of variants with a single solution
            tables |= {"parameters": every[~(every["mode"] > 1)], SOLUTIONS: every[every["mode"].notna()]}
        found = cls(summary, results.config, tables)
        if results.folder is None:
            return found
        read = {name: _read_draws(folder, name) for name in found.ranking}
        chains = {name: own for name, own in read.items() if own is not None}
        return replace(
            found,
            draws={name: {one: x.ravel() for one, x in own.items()} for name, own in chains.items()},
            n_chains=next((len(x) for own in chains.values() for x in own.values()), 1),
            modes={name: one for name in chains if (one := _read_modes(folder, name)) is not None},
        )

    def draws_of_machine(self, variant: str) -> dict[str, Array]:
        """Return the draws of each parameter, of the first solution where there are several."""
        draws = self.draws[variant]
        return {name: x[self.modes[variant] == 1] for name, x in draws.items()} if variant in self.modes else draws

    # --- tables --------------------------------------------------------------------------------------------------

    def has(self, name: str) -> bool:
        """Whether a table is there."""
        return name in self.tables

    def table(self, name: str, variant: str | None = None) -> pd.DataFrame:
        """Return a table, or a variant's rows of it; without rows where there is none."""
        key = (name, variant)
        if key not in self._tables:
            whole = self.tables[name] if name in self.tables else pd.DataFrame(columns=NAMES.get(name, ()))
            self._tables[key] = whole if variant is None else whole[whole["variant"] == variant]
        return self._tables[key]

    def rows[R: TableRow](self, row: type[R], variant: str | None = None) -> list[R]:
        """Return the rows of a table, or a variant's; those of its first solution where there are several."""
        key = (row, variant)
        if key not in self._read:
            self._read[key] = row.read(self.table(row.table, variant))
        return list(self._read[key])

    def list_solutions(self, variant: str) -> list[ParameterRow]:
        """Return the parameters of all solutions of a variant that has several."""
        return ParameterRow.read(self.table(SOLUTIONS, variant))

    # --- variants ------------------------------------------------------------------------------------------------

    @cached_property
    def own_names(self) -> dict[str, tuple[str, str]]:
        """Model and deformation of the variants that have names of their own."""
        named = self.summary.get("own_names", {})
        return {name: (one["model"], one["deformation"]) for name, one in named.items()}

    @property
    def is_preliminary(self) -> bool:
        """Whether no chain has checked the posteriors."""
        return bool(self.summary.get(PRELIMINARY))

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

    @cached_property
    def compared(self) -> list[str]:
        """Those of the ranking that converged, as only they are compared."""
        return [name for name in self.ranking if self.fit(name)["converged"]]

    @property
    def best_name(self) -> str:
        """The variant of the largest log-evidence, of those that converged where any did."""
        return self.ranking[0]

    @cached_property
    def chosen(self) -> str:
        """The variant to use."""
        return choose_best(self.summary)

    def fit(self, variant: str) -> Summary:
        """Return a variant's row of the summary."""
        found: Summary = self.summary["variants"][variant]
        return found

    @property
    def fits(self) -> dict[str, Summary]:
        """The rows of all variants, those of one set of data together, the best first."""
        return {name: self.fit(name) for name in self.names}

    def split(self, name: str) -> tuple[str, str]:
        """Return a variant's model and deformation; its name says them unless it has one of its own."""
        if name in self.own_names:
            return self.own_names[name]
        model, _, deformation = name.rpartition("/") if "models" in self.summary else ("", "", "")
        return model, deformation

    @property
    def models(self) -> list[str]:
        """The kinematic models in the order of the study."""
        return list(dict.fromkeys(self.split(name)[0] for name in self.summary["variants"]))

    @property
    def deformations(self) -> list[str]:
        """The deformations in the order of the study."""
        return list(dict.fromkeys(self.split(name)[1] for name in self.summary["variants"]))

    def find(self, model: str | None = None, deformation: str | None = None) -> list[str]:
        """Return the variants of a model, of a deformation or of both, in the order of the study."""
        pairs = {name: self.split(name) for name in self.summary["variants"]}
        return [name for name, own in pairs.items() if model in (None, own[0]) and deformation in (None, own[1])]

    def find_best(self, model: str, deformation: str) -> str | None:
        """Return the variant of a model and deformation with the largest log-evidence; None where none converged."""
        compared = [name for name in self.find(model, deformation) if self.fit(name)["converged"]]
        return max(compared, key=self.evidence, default=None)

    @property
    def free_sets(self) -> dict[tuple[str, str], list[str]]:
        """The variants of each model and deformation that has several, in the order of the study."""
        if "models" not in self.summary:
            return {}
        pairs = dict.fromkeys(self.split(name) for name in self.summary["variants"])
        return {pair: names for pair in pairs if len(names := self.find(*pair)) > 1}

    # --- what the page calls them ----------------------------------------------------------------------------------

    def label(self, name: str) -> str:
        """Return what the page calls a variant."""
        return label_title(str(self.fit(name)["title"]))

    def label_model(self, model: str) -> str:
        """Return a kinematic model's title; its name where the study gives none."""
        return str(self.summary.get("models", {}).get(model, model))

    def say_missing(self) -> str:
        """Return why a figure of the best variant's draws is left out where its posterior file is not there."""
        return f"no draws of {self.label(self.best_name)}"

    def name_variants(self, names: Sequence[str], between: str = "and") -> str:
        """Return variants as words; those of one deformation as its models, unless some have names of their own."""
        models, deformations = zip(*(self.split(name) for name in names), strict=True)
        own = any(name in self.own_names for name in names)
        if len(set(deformations)) == 1 and len(names) > 1 and all(models) and not own:
            words = [self.label_model(model) for model in models]
            return f"{name_some(words, between)} {describe_deformation(deformations[0])}"
        return name_some([self.label(name) for name in names], between)

    # --- what their evidence says ----------------------------------------------------------------------------------

    def evidence(self, name: str) -> float:
        """Return a variant's log-evidence, nats."""
        return float(self.fit(name)["log_evidence"])

    def list_terms(self, name: str) -> list[str]:
        """Return the terms of a variant's model error."""
        there = {row.term for row in self.rows(ModelErrorRow, name)}
        return [term for term in TERMS if term in there]

    def spread(self, names: Sequence[str]) -> float:
        """Return the largest difference of log-evidence among variants, nats."""
        values = [self.evidence(name) for name in names]
        return max(values) - min(values)

    def candidates(self) -> list[Candidate]:
        """Return the variants of the most data as the headline compares them, in the order of the study."""
        return list_candidates(self.summary)

    def distinguishes(self, one: str, other: str) -> bool:
        """Whether the evidence distinguishes two variants."""
        first, second = (candidate for candidate in self.candidates() if candidate.name in (one, other))
        return first.is_distinguishable(second)

    def group(self, names: Sequence[str]) -> list[list[str]]:
        """Return variants in groups by evidence, the best group first; within a group the simplest first."""
        groups = group_candidates([one for one in self.candidates() if one.name in names])
        return [[one.name for one in group] for group in groups]

    def find_leaders(self) -> list[str]:
        """Return the variants that fit as well as the best one, the simplest first; one alone where none converged."""
        return next(iter(self.group(self.ranking)), [self.best_name])

    @cached_property
    def sensitivity_grid(self) -> pd.DataFrame:
        """Log-evidence with a row per factor on the priors and a column per variant, in the order of the ranking."""
        wide = self.table("sensitivity").pivot(index="factor", columns="variant", values="log_evidence")
        return wide.sort_index()[self.ranking]

    # --- the machine and the data --------------------------------------------------------------------------------

    @property
    def publication(self) -> Summary | None:
        """What the study repeats: ``source``, ``citation``, and where ``figures`` and ``notation`` are in it."""
        return self.summary.get("publication")

    def cite(self, kind: str, name: str) -> str:
        """Return what a figure is after, or where a symbol is defined, in brackets behind a space; nothing else."""
        place = self.publication[kind].get(name) if self.publication else None
        after = "after " if kind == "figures" else ""
        return f" ({after}{self.summary['publication']['source']} {place})" if place else ""

    @property
    def units(self) -> ChosenUnits:
        """Units of lengths and angles on the page."""
        found: dict[str, str] = self.summary["units"]
        return found

    def shown_in(self, unit: str) -> tuple[float, str]:
        """Return factor and name of the unit that values of an inner unit are shown in."""
        return shown_in(unit, self.units)

    def scale_of(self, symbol: str, unit: str) -> tuple[float, str]:
        """Return the factor and the unit in which a parameter's offsets are shown."""
        return scale_of(symbol, unit, self.units)

    @cached_property
    def error_scales(self) -> tuple[ErrorScale, ...]:
        """The errors of poses that were measured, each with its unit on the page."""
        factor, unit = self.shown_in("rad")
        columns = "orientation_error_deg", "orientation_bound_95_deg"
        orientation = ErrorScale("orientation", *columns, math.radians(factor), unit)
        errors = self.table("pose_errors")
        return tuple(one for one in (POSITION, orientation) if errors[one.column].notna().any())

    @property
    def member(self) -> str:
        """What the index of a parameter counts: leg, strut, line."""
        return str(self.summary.get("member", "leg"))

    @cached_property
    def has_members(self) -> bool:
        """Whether most of what the variant to use found belongs to one leg, strut or line each, and not to a joint."""
        known = "models" in self.summary or self.has("joints") or self.member != "leg"
        rows = self.geometry[self.geometry["variant"] == self.chosen]
        return known and float((rows["leg"] > 0).mean()) > 0.5

    def name_parameter(self, name: str) -> str:
        """Return a parameter's name as sentences have it: in words where it is one of a leg, strut or line."""
        return name_parameter(name, self.member) if self.has_members else name

    @property
    def has_struts(self) -> bool:
        """Whether the actuators change the lengths of struts; else they move the base points."""
        return bool(self.summary.get("drive") == "strut")

    @property
    def n_verification(self) -> int:
        """How many poses were held back."""
        return int(self.summary["n_poses"]["verification"])

    def count_seen(self, variant: str, use: str) -> int:
        """Return how many poses of a variant an instrument saw, whole or in part."""
        rows = self.table("pose_errors", variant)
        return int((rows["use"].eq(use) & rows[[one.column for one in self.error_scales]].notna().any(axis=1)).sum())

    @property
    def use(self) -> str:
        """The poses by which errors are judged: those held back where there are any."""
        return "verification" if self.n_verification else "calibration"

    @property
    def instrument(self) -> Summary | None:
        """What an instrument read that sees a platform on legs; None for photogrammetry and tables of readings."""
        return self.summary.get("instrument")

    @property
    def required(self) -> dict[str, float]:
        """Probability of the variant to use to keep each requirement, and of ``""``: all; empty without any."""
        rows = self.rows(RequirementResultRow, self.chosen)
        return {"" if row.requirement == ALL else row.requirement: row.probability for row in rows}

    @property
    def aligned(self) -> bool:
        """Whether accuracy is what remains of errors once base and tool are aligned."""
        return is_aligned(self.table("accuracy"))

    @property
    def error_factor(self) -> float:
        """How many of the unit in which sizes of the model error are shown make a µm of the config."""
        return choose_error_unit(self.summary.get("model_error_in"))[0]

    @property
    def error_unit(self) -> str:
        """The unit in which sizes of the model error are shown: µm at the tool, or times the noise of the readings."""
        return choose_error_unit(self.summary.get("model_error_in"))[1]

    @property
    def tau_scale(self) -> float | None:
        """Scale of the prior of the variant to use's τ, in that unit; None where it has no τ."""
        own = self.table("tau_scale", self.chosen)["prior_scale"]
        return float(own.iloc[0]) if len(own) else None

    # --- parameters ----------------------------------------------------------------------------------------------

    @cached_property
    def parameters(self) -> pd.DataFrame:
        """One row per posterior and parameter of the machine; ``leg`` is zero where a parameter belongs to none."""
        return self.all_parameters[~self._of_frames & ~self.all_parameters["symbol"].isin(OF_FUNCTIONS)]

    @cached_property
    def geometry(self) -> pd.DataFrame:
        """The same of what was found of the machine itself, without noise and errors."""
        return self.parameters[self.parameters["verdict"] != NOISE]

    @property
    def frames(self) -> pd.DataFrame:
        """The same of the frames of instrument and tool that were found; no rows where they were known."""
        return self.all_parameters[self._of_frames]

    @cached_property
    def _of_frames(self) -> pd.Series:
        return self.all_parameters["symbol"].map(lambda symbol: bool(FRAME.fullmatch(symbol)))

    @cached_property
    def all_parameters(self) -> pd.DataFrame:
        """One row per posterior and parameter, with ``symbol`` and ``leg`` of its name."""
        table = self.tables["parameters"]
        split = [split_name(str(name)) for name in table["parameter"]]
        return table.assign(symbol=[symbol for symbol, _ in split], leg=[leg for _, leg in split])


def _find_posterior(folder: Path, variant: str) -> Path:
    own = folder / "posterior" / f"{stem_of(variant)}.nc"
    return own if own.is_file() else folder / name_file(variant)


def _read_modes(folder: Path, variant: str) -> np.ndarray | None:
    """Return to which solution each draw (S,) belongs, from 1; None where there is one."""
    with h5py.File(io.BytesIO(_find_posterior(folder, variant).read_bytes()), "r") as file:
        stats = file.get("sample_stats")
        return np.asarray(stats[MODE]).ravel() if stats is not None and MODE in stats else None


def _read_draws(folder: Path, variant: str) -> dict[str, Array] | None:
    """Return the draws (E, S) of each parameter by chains, from the posterior group of a variant's ArviZ file.

    None without the file. Letters that no file may have stand in its name as others.
    """
    path = _find_posterior(folder, variant)
    if not path.is_file():
        return None
    draws: dict[str, Array] = {}
    try:
        with h5py.File(io.BytesIO(path.read_bytes()), "r") as file:
            for symbol, values in file["posterior"].items():
                if values.ndim < 2 or symbol in OF_FUNCTIONS:
                    continue  # coordinates; scale and length of an error, not of the machine
                every, names = np.asarray(values, dtype=np.float64).reshape(*values.shape[:2], -1), [symbol]
                if values.ndim > 2:  # entries are called as the file calls them, else by numbers from one
                    labels = values.dims[2][0][()] if len(values.dims[2]) else range(1, values.shape[2] + 1)
                    names = [f"{symbol}[{one.decode() if isinstance(one, bytes) else one}]" for one in labels]
                draws |= {name: every[..., k] for k, name in enumerate(names)}
    except (OSError, KeyError) as error:
        raise InputError(f"{path}: not a posterior ({error})") from error
    return draws


def _check_tables(tables: Mapping[str, pd.DataFrame], results: Path) -> None:
    """Raise InputError where a table that every study has is not there, or one is not as its rows are declared."""
    folder = results / "tables" if (results / "tables").is_dir() else results
    for row in REQUIRED:
        if row.table not in tables:
            raise InputError(f"{folder / row.table}.csv: found no rows")
    check_tables(ROWS, tables, folder)


def _check_summary(summary: Summary, path: Path) -> None:
    check_keys(summary["n_poses"], dict.fromkeys(USES, NUMBER), path, "n_poses.")
    ranked = [name for names in summary["rankings"] for name in names]
    if not summary["variants"] or sorted(ranked) != sorted(summary["variants"]):
        raise InputError(
            f"{path}: rankings: found {summary['rankings']}, expected each of {list(summary['variants'])} once"
        )
    for name, row in summary["variants"].items():
        check_keys(summary["variants"], {name: dict}, path, "variants.")
        check_keys(row, ROW_KEYS, path, f"variants.{name}.")
    if "publication" in summary:
        check_keys(summary, {"publication": dict}, path, "")
        check_keys(summary["publication"], PUBLICATION_KEYS, path, "publication.")
        for key in ("figures", "notation"):
            places = summary["publication"][key]
            check_keys(places, dict.fromkeys(places, str), path, f"publication.{key}.")


def get_number(content: Mapping[str, object], key: str) -> float:
    """Return a number that may be missing, NaN then."""
    value = content.get(key)
    return float(value) if isinstance(value, NUMBER) else math.nan
