"""What a calibration found, in sentences computed from its tables: what to do, how sure, why."""

from __future__ import annotations

import math
from typing import Any

import pandas as pd

from bayescal.experiments.calibration.tables import choose_best, list_candidates
from bayescal.experiments.shared.chi_square import ChiSquare
from bayescal.experiments.shared.headline import say_accuracy, say_choice, write_headline
from bayescal.experiments.shared.judgement_page import state_misfit, state_pulls
from bayescal.experiments.shared.knowledge_page import state_next
from bayescal.experiments.shared.slips import state_slip
from bayescal.report.blocks import Statement
from bayescal.report.numbers import (
    format_estimate,
    format_fixed,
    format_odds,
    format_percent,
    join_words,
)
from bayescal.report.reading import Row, list_rows
from bayescal.report.units import Asked, format_amount, shown_in

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


def state_headline(tables: dict[str, pd.DataFrame], summary: dict[str, Any]) -> str:
    """Return which variant to use and how accurate the machine's tool is, over the workspace and at its worst."""
    best, asked = choose_best(summary), summary["units"]
    choice = say_choice(list_candidates(summary), careful="slip" in summary)
    known = [one for one in list_rows(tables["accuracy"]) if one["variant"] == best and math.isfinite(one["after"])]
    if not known:
        return write_headline([choice])
    what = "tool" if summary.get("states_tool", True) else "coordinates"
    accuracy = say_accuracy({one["coordinate"]: format_amount(one["after"], one["unit"], 2, asked) for one in known})
    said = f"{choice}; {what} {accuracy}, rms over the workspace"
    lengths = [one for one in known if one["unit"] == "mm"] or known[:1]
    worst = max(lengths, key=lambda one: one.get("worst", 0.0))
    if "worst" not in worst:
        return write_headline([said])
    largest = format_amount(worst["worst"], worst["unit"], 2, asked)
    return write_headline([f"{said}; largest {worst['coordinate']} {largest}, at {worst['worst_at']}"])


def state_tool(summary: dict[str, Any]) -> list[Statement]:
    """Return that the machine's class says nothing of its tool, where it does not."""
    return [] if summary.get("states_tool", True) else [Statement(NO_TOOL, "warning", "Tool")]


def state_verdict(tables: dict[str, pd.DataFrame], summary: dict[str, Any]) -> list[Statement]:
    """Return what was found, the most important first."""
    best, asked = choose_best(summary), summary["units"]
    found = [
        *state_slip(summary),
        *state_tool(summary),
        _state_ranking(tables, summary, best),
        *([Statement(summary["unused"], "warning", "Data")] if "unused" in summary else []),
        *_state_convergence(tables),
        *_state_data(tables, best, asked),
        *_state_soundness(tables, best),
    ]
    found += [*_state_coverage(tables, best), *_state_ignorance(tables, best), *_state_doubt(tables, best)]
    return [*found, *_state_beside(tables, best, asked), *state_next(tables, best, asked)]


def _row(table: pd.DataFrame, variant: str) -> Row:
    return list_rows(table[table["variant"] == variant])[0]


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


def _state_data(tables: dict[str, pd.DataFrame], best: str, asked: Asked) -> list[Statement]:
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
        factor, unit = shown_in(one["unit"], asked)
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


def _state_beside(tables: dict[str, pd.DataFrame], best: str, asked: Asked) -> list[Statement]:
    if "beside" not in tables:
        return []
    found = []
    mine = tables["beside"][tables["beside"]["variant"] == best]
    for title, rows in mine.groupby("beside", sort=False):
        spread = (rows["sd"] ** 2 + rows["value_sd"].fillna(0.0) ** 2) ** 0.5
        z = (rows["value"] - rows["mean"]) / spread
        worst = list_rows(rows)[int(z.abs().to_numpy().argmax())]
        factor, unit = shown_in(str(worst["unit"]), asked)
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
