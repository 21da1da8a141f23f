"""What a calibration found, in sentences computed from its tables: what to do, how sure, why."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import pandas as pd

from bayescal.experiments.calibration.tables import choose_best
from bayescal.experiments.shared.chi_square import ChiSquare
from bayescal.experiments.shared.judgement_page import state_misfit, state_pulls
from bayescal.experiments.shared.slips import state_slip
from bayescal.numerics.units import ARCSECOND, MICROMETRE
from bayescal.report.blocks import Statement
from bayescal.report.numbers import (
    format_estimate,
    format_fixed,
    format_odds,
    format_percent,
    format_significant,
    join_words,
)

type Row = dict[str, Any]

NO_TOOL = (
    "The machine's class states no tool: its coordinates are reported instead. State tool_channels (names and units), "
    "and tool() where the tool is something else than the coordinates."
)

DECISIVE = 5.0  # nats
EQUAL = 1.0  # nats; less tells nothing
WEAK = 0.75  # contraction below which a tolerance is not even halved
COVERAGE, DOUBT = 0.90, 2.5  # what intervals should hold, and binomial deviations from it that are no chance
MANY = 8
FEW = 40  # held-back readings, from which little can be said of coverage
TELLING = 0.01  # of the mean squared error; what promises less is no advice
INNER = {"mm": "length", "rad": "angle"}
SHOWN = {"mm": (1.0, "mm"), "rad": (1e3, "mrad")}
"""Factor and unit in which values of a unit are shown where nothing else is said."""
ASKED = {
    "um": (1.0 / MICROMETRE, "µm"),
    "mm": (1.0, "mm"),
    "m": (1e-3, "m"),
    "arcsec": (1.0 / ARCSECOND, "arcsec"),
    "mrad": (1e3, "mrad"),
    "deg": (math.degrees(1.0), "°"),
    "rad": (1.0, "rad"),
}
"""The same of the units that a config may ask for, which inside are mm or rad."""
PLACES = {"mm": 0, "um": 0, "arcsec": 0, "deg": 1, "mrad": 1}
"""Decimals of coordinates that say where to measure."""

type Asked = Mapping[str, str] | None
"""The units of a config, ``length`` and ``angle``; None for `SHOWN`."""


def list_rows(table: pd.DataFrame) -> list[Row]:
    """Return the rows of a table by the names of its columns."""
    return [{str(key): value for key, value in row.items()} for row in table.to_dict("records")]


def shown_in(unit: str, asked: Asked = None) -> tuple[float, str]:
    """Return factor and name of the unit that values of an inner unit are shown in: that of the config if asked for."""
    if asked is not None and unit in INNER:
        return ASKED[asked[INNER[unit]]]
    return SHOWN.get(unit, (1.0, "" if unit == "1" else unit))


def state_headline(tables: dict[str, pd.DataFrame], summary: dict[str, Any]) -> str:
    """Return which variant to use and how well it knows the machine's tool, over the workspace and at its worst."""
    best = choose_best(summary)
    row = _row(tables["variants"], best)
    known = [one for one in list_rows(tables["accuracy"]) if one["variant"] == best and math.isfinite(one["after"])]
    words = f"Use “{row['title']}”" + (", with care (see the warnings)" if "slip" in summary else "")
    if not known:
        return f"{words}."
    accuracy = join_words([f"{one['coordinate']} {format_amount(one['after'], one['unit'])}" for one in known])
    what = "tool" if summary.get("states_tool", True) else "coordinates"
    said = f"{words}: standard uncertainty of the {what} {accuracy}, root mean square over the workspace"
    lengths = [one for one in known if one["unit"] == "mm"] or known[:1]
    worst = max(lengths, key=lambda one: one.get("worst", 0.0))
    if "worst" not in worst:
        return f"{said}."
    largest = format_amount(worst["worst"], worst["unit"])
    return f"{said}; largest {worst['coordinate']} {largest}, at {worst['worst_at']}."


def state_tool(summary: dict[str, Any]) -> list[Statement]:
    """Return that the machine's class says nothing of its tool, where it does not."""
    return [] if summary.get("states_tool", True) else [Statement(NO_TOOL, "warning", "Tool")]


def state_verdict(tables: dict[str, pd.DataFrame], summary: dict[str, Any]) -> list[Statement]:
    """Return what was found, the most important first."""
    best = choose_best(summary)
    found = [
        *state_slip(summary),
        *state_tool(summary),
        _state_ranking(tables, summary, best),
        *([Statement(summary["unused"], "warning", "Data")] if "unused" in summary else []),
        *_state_convergence(tables),
        *_state_data(tables, best),
        *_state_soundness(tables, best),
    ]
    found += [*_state_coverage(tables, best), *_state_ignorance(tables, best), *_state_doubt(tables, best)]
    return [*found, *_state_beside(tables, best), *state_next(tables, best)]


def _row(table: pd.DataFrame, variant: str) -> Row:
    return list_rows(table[table["variant"] == variant])[0]


def format_amount(value: float, unit: str, digits: int = 2, asked: Asked = None) -> str:
    """Return a value of an inner unit with the unit it is shown in."""
    factor, name = shown_in(unit, asked)
    return f"{format_significant(factor * value, digits)} {name}".rstrip().replace(" °", "°")


def format_place(column: str, value: float, asked: Asked = None) -> str:
    """Return a coordinate of a column such as ``x_mm`` in the unit that places are shown in."""
    unit = column.rpartition("_")[2]
    if asked is None or unit not in INNER:
        return format_fixed(value, 0 if unit == "mm" else 3)
    return format_fixed(shown_in(unit, asked)[0] * value, PLACES.get(asked[INNER[unit]], 3))


def name_unit(column: str, asked: Asked = None) -> str:
    """Return the unit of a column such as ``x_mm`` as places are shown."""
    unit = column.rpartition("_")[2]
    return unit if asked is None or unit not in INNER else shown_in(unit, asked)[1]


def _state_ranking(tables: dict[str, pd.DataFrame], summary: dict[str, Any], best: str) -> Statement:
    rows = {str(row["variant"]): row for row in list_rows(tables["variants"])}
    ranking = next(names for names in summary["rankings"] if best in names)
    others = [name for name in ranking if name != best]
    if not others:
        return Statement(
            "Only one variant takes in these readings; nothing says that another is not better.", "warning", "Model"
        )
    gap = rows[best]["log_evidence"] - rows[others[0]]["log_evidence"]
    odds = format_odds(max(gap, 0.0))
    words = f"“{rows[best]['title']}” explains the readings best, {odds} against “{rows[others[0]]['title']}”"
    if rows[best]["log_evidence_se"] > 1.0:
        return Statement(f"{words}; but the evidence is too uncertain to say.", "warning", "Model")
    if gap < EQUAL:
        return Statement(f"{words}: no difference that counts.", "plain", "Model")
    elpd = {name: rows[name]["elpd"] for name in ranking}
    known = [name for name in ranking if math.isfinite(elpd[name])]
    if known and max(known, key=lambda name: elpd[name]) != best:
        winner = max(known, key=lambda name: elpd[name])
        words += f"; held-back readings are predicted better by “{rows[winner]['title']}”"
        return Statement(f"{words}. Evidence and prediction disagree: look at both.", "warning", "Model")
    return Statement(f"{words}.", "good" if gap > DECISIVE else "plain", "Model")


def _state_convergence(tables: dict[str, pd.DataFrame]) -> list[Statement]:
    bad = [row for row in list_rows(tables["variants"]) if not row["converged"]]
    return [
        Statement(f"“{row['title']}” did not converge: {row['problems']}. Do not use its numbers.", "bad", "Sampling")
        for row in bad
    ]


def _state_data(tables: dict[str, pd.DataFrame], best: str) -> list[Statement]:
    row = _row(tables["variants"], best)
    found = []
    if row["n_equations"] < row["n_parameters"]:
        found.append(
            Statement(
                f"{row['n_equations']} equations for {row['n_parameters']} unknowns: what the readings do not tell "
                "rests on the tolerances stated beforehand.",
                "warning",
                "Data",
            )
        )
    mine = tables["parameters"][tables["parameters"]["variant"] == best]
    for one in list_rows(mine[mine["verdict"] == "noise"]):
        factor, unit = shown_in(one["unit"])
        what = str(one["parameter"]).replace("noise_factor(", "").replace("model_error(", "").rstrip(")")
        text = format_estimate(factor * one["mean"], factor * one["sd"])
        if str(one["parameter"]).startswith("noise_factor"):
            found.append(Statement(f"The noise of {what} is {text} times the stated one.", "plain", "Noise"))
        else:
            found.append(Statement(f"Besides its noise, {what} errs by {text} {unit}.", "plain", "Model error"))
    return found


def _state_soundness(tables: dict[str, pd.DataFrame], best: str) -> list[Statement]:
    """Say where residuals contradict the stated noise, or deviations the stated tolerances."""
    row = _row(tables["variants"], best)
    if "misfit_chi2" not in row:
        return []
    misfit, pulls = (ChiSquare(row[f"{one}_chi2"], row[f"{one}_dof"]) for one in ("misfit", "pulls"))
    label, too_small = f"“{row['title']}”", "the noise is stated too small, or every variant lacks something real."
    return [
        *([state_misfit(label, misfit, "", too_small)] if misfit.is_off else []),
        *([state_pulls(label, pulls)] if pulls.is_off else []),
    ]


def _state_coverage(tables: dict[str, pd.DataFrame], best: str) -> list[Statement]:
    if "predictions" not in tables:
        return []
    mine = tables["predictions"]
    mine = mine[(mine["variant"] == best) & ~mine["external"]]
    if mine.empty:
        return []
    share, n = float(mine["inside"].mean()), len(mine)
    words = (
        f"{int(mine['inside'].sum())} of {n} held-back readings of the machine's own sensors ({format_percent(share)})"
    )
    if abs(share - COVERAGE) <= DOUBT * math.sqrt(COVERAGE * (1.0 - COVERAGE) / n):
        sure = "as should be" if n >= FEW else "as should be, though they are few"
        return [Statement(f"{words} lie in their 90 % intervals, {sure}.", "good", "Prediction")]
    tendency = "too small" if share < COVERAGE else "too large"
    return [
        Statement(
            f"{words} lie in their 90 % intervals: the stated uncertainty is {tendency}.", "warning", "Prediction"
        )
    ]


def _state_ignorance(tables: dict[str, pd.DataFrame], best: str) -> list[Statement]:
    mine = tables["parameters"]
    mine = mine[(mine["variant"] == best) & (mine["verdict"] != "noise")]
    weak = [str(name) for name in mine[mine["contraction"] < WEAK]["parameter"]]
    if not weak:
        return [Statement("Every free parameter is known at least twice as well as before.", "good", "Parameters")]
    words = join_words(weak[:MANY] + ([f"{len(weak) - MANY} more"] if len(weak) > MANY else []))
    more = "these readings hardly tell it" if len(weak) == 1 else "these readings hardly tell them"
    return [Statement(f"{words}: not even twice as well known as before; {more}.", "warning", "Parameters")]


def _state_doubt(tables: dict[str, pd.DataFrame], best: str) -> list[Statement]:
    mine = tables["poses"]
    mine = mine[(mine["variant"] == best) & mine["doubtful"]]
    if mine.empty:
        return []
    names = [str(name) for name in mine.sort_values("trust")["pose"]]
    what = "Pose" if len(names) == 1 else "Poses"
    words = join_words(names[:MANY] + ([f"{len(names) - MANY} more"] if len(names) > MANY else []))
    return [
        Statement(f"{what} {words}: look at these readings again, they do not fit the others.", "warning", "Doubtful")
    ]


def _state_beside(tables: dict[str, pd.DataFrame], best: str) -> list[Statement]:
    if "beside" not in tables:
        return []
    found = []
    mine = tables["beside"][tables["beside"]["variant"] == best]
    for title, rows in mine.groupby("beside", sort=False):
        spread = (rows["sd"] ** 2 + rows["value_sd"].fillna(0.0) ** 2) ** 0.5
        z = (rows["value"] - rows["mean"]) / spread
        worst = list_rows(rows)[int(z.abs().to_numpy().argmax())]
        factor, unit = shown_in(str(worst["unit"]))
        found.append(
            Statement(
                f"{title}: {int((z.abs() <= 2.0).sum())} of {len(z)} values within two deviations; farthest "
                f"{worst['quantity']}, {format_fixed(factor * worst['value'], 2)} {unit} against "
                f"{format_estimate(factor * worst['mean'], factor * worst['sd'])} {unit}.",
                "plain",
                "Beside",
            )
        )
    return found


def state_next(tables: dict[str, pd.DataFrame], best: str, asked: Asked = None) -> list[Statement]:
    """Return where to measure next with each set of sensors, where that promises something."""
    if "next" not in tables:
        return []
    mine = tables["next"][tables["next"]["variant"] == best]
    found = []
    for sensors, rows in mine.groupby("sensors", sort=False):
        first = list_rows(rows)[0]
        if first["gain"] < TELLING:
            continue
        coordinates = [
            f"{name.rpartition('_')[0]} = {format_place(name, value, asked)} {name_unit(name, asked)}"
            for name, value in first.items()
            if name not in ("variant", "sensors", "gain")
        ]
        with_what = "with all sensors" if sensors == "all" else "with the machine's own sensors"
        found.append(
            Statement(
                f"Measure next, {with_what}, at {', '.join(coordinates)}: of all poses tried this one promises most, "
                f"{format_percent(1.0 - math.sqrt(max(0.0, 1.0 - first['gain'])), 1)} less error.",
                "plain",
                "Next",
            )
        )
    return found
