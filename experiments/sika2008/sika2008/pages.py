"""The page of simulated self-calibrations: what was found beside what is published, in sentences and tables."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import partial
from itertools import pairwise
from typing import Any

import numpy as np
import pandas as pd

from bayescal.report.blocks import (
    Cell,
    Column,
    Figure,
    Level,
    Page,
    PageSection,
    Statement,
    Table,
    make_section,
    make_table,
)
from bayescal.report.numbers import (
    NO_VALUE,
    format_estimate,
    format_fixed,
    format_percent,
    format_plain,
    format_power,
    format_significant,
    join_words,
)
from sika2008 import figures
from sika2008.figures import BAYESIAN, PAPER, PROCEDURE_LABELS, Band, scale_of_quantity

KIND = "Simulated self-calibrations"
UNIT_COLUMNS = {
    "metres_radians": "m, rad",
    "millimetres_radians": "mm, rad",
    "millimetres_degrees": "mm, deg",
    "scaled": "noise, tolerances",
}
PREDICTOR_WORDS = {name: f"C ({unit})" for name, unit in UNIT_COLUMNS.items()}
PREDICTOR_WORDS |= {"scaled_alike": "the same, zeros as guide angles"}
SHOWN_PREDICTORS = ("metres_radians", "scaled", "tool_predicted")
COVERED = (0.85, 0.95)
COMMON = (0.05, 0.95)  # of the machines below, between which a figure is none of the rare ones
CLEAR = 0.02  # difference of correlations worth a word
WORDS = {
    "calibrability": "C",
    "lengths": "lengths",
    "guide_angles": "guide angles",
    "tool": "tool's centre",
    "tool_in_use": "tool's centre in use",
    "parameters": "parameters",
}

type Tables = dict[str, pd.DataFrame]
type Row = list[str | Cell]


def build_page(name: str, title: str, tables: Tables, summary: dict[str, Any]) -> Page:
    """Return the page of an experiment's tables."""
    sections = [
        _show_one(tables, summary),
        _show_calibrability(tables, summary),
        _show_errors(tables, summary),
        _show_coverage(tables),
        *_show_machines(tables, summary),
        *_show_sweep(tables, summary),
        _show_method(summary),
    ]
    source = f"; published figures from {summary['source']}" if "source" in summary else ""
    origin = f"Simulated; the machine's dimensions are assumed, since none are published{source}"
    verdict, headline = state_verdict(tables, summary), state_headline(tables, summary)
    return Page(KIND, name, title, origin, headline, verdict, tuple(sections), _list_facts(summary))


def _list_facts(summary: dict[str, Any]) -> tuple[tuple[str, str], ...]:
    noise = join_words([f"{one['sensor']} {format_plain(one['noise'])} {one['unit']}" for one in summary["sensors"]])
    known = summary["tolerances"]
    return (
        ("Machine", f"{summary['machine']}, {summary['n_legs']} legs"),
        (
            "Measured",
            f"{summary['n_poses']} poses within ±{format_plain(summary['position_mm'])} mm and "
            f"±{format_plain(summary['angle_deg'])} deg of home; noise {noise}",
        ),
        (
            "Known beforehand",
            f"lengths to {format_plain(known['length_mm'])} mm, guide angles to {format_plain(known['angle_deg'])} "
            f"deg, zeros of angle sensors to {format_plain(known['zero_deg'])} deg (1 sd)",
        ),
    )


# --- calibrability ---------------------------------------------------------------------------------------------------


def _show_calibrability(tables: Tables, summary: dict[str, Any]) -> PageSection:
    columns = [Column("Set", kind="text"), Column("Sensors"), Column("Parameters")]
    published = _published_values(tables, "calibrability")
    columns += [Column("C", "m, rad", "published")] if published else []
    columns += [Column("C", unit, "found") for unit in UNIT_COLUMNS.values()]
    rows: list[Row] = []
    table = tables["calibrability"]
    for _, one in table.iterrows():
        row: Row = [str(one["set"]), str(one["n_sensors"]), str(one["n_parameters"])]
        row += [format_printed(published.get(str(one["set"]), math.nan))] if published else []
        rows.append(row + [format_power(float(one[unit])) for unit in UNIT_COLUMNS])
    by_set = index_rows(table, ["set"])
    for before, after in list_steps(summary["sets"]):
        row = [f"{before} to {after}: factor of improvement", "", ""]
        row += [format_printed(published.get(f"{before} to {after}", math.nan))] if published else []
        rows.append(row + [format_power(by_set[before][u] / by_set[after][u]) for u in UNIT_COLUMNS])
    caption = "Calibrability C = cond(JᵀJ) of the documented machine, poses eliminated (eq. 6), in different units."
    return make_section("Calibrability", (), (make_table(caption, columns, rows),))


def _published_values(tables: Tables, quantity: str) -> dict[str, float]:
    """Return published values by set or step."""
    if "judged" not in tables:
        return {}
    rows = tables["judged"][tables["judged"]["quantity"] == quantity]
    return {str(of): float(value) for of, value in zip(rows["of"], rows["published"], strict=True)}


# --- errors ----------------------------------------------------------------------------------------------------------


def _show_one(tables: Tables, summary: dict[str, Any]) -> PageSection:
    names, n, path = summary["sets"], summary["calibrations"], summary["path"]
    first = Figure(
        "parameters",
        f"After figure 4: deviation of calibrated parameters from the real ones, the paper's procedure. Dots: one "
        f"calibration; squares: root mean square over {n}, with standard errors; grey: what was known a priori.",
        partial(figures.draw_parameters, tables["parameters"], names),
    )
    second = Figure(
        "path",
        "After figures 5 to 7: deviation of the computed tool's centre from the real one along a circle of "
        f"{format_plain(path['radius_mm'])} mm about home, the platform swinging by "
        f"±{format_plain(path['angle_deg'])} deg, readings without noise; the paper's procedure. Mind the scales.",
        partial(figures.draw_path, tables["path"], names),
    )
    return make_section("One calibration", (), (), (first, second))


def _show_errors(tables: Tables, summary: dict[str, Any]) -> PageSection:
    factors: dict[str, list[float]] = {}
    for quantity in ("lengths", "guide_angles", "tool"):
        printed = _published_values(tables, quantity)
        if len(printed) == len(summary["sets"]) - 1 > 0:
            factors[quantity] = list(printed.values())
    figure = Figure(
        "errors",
        f"Root mean square errors over {summary['calibrations']} calibrations of machines within the tolerances, with "
        "two standard errors; dotted, the published factors from the first set on.",
        partial(figures.draw_errors, tables["errors"], summary["sets"], factors),
    )
    text = (
        "Every set and both procedures calibrate the same machines from the same noise. As in the paper: least "
        "squares in metres and radians, all weighted alike, nothing known a priori (eqs. 3 to 5). Bayesian: "
        f"weighted by the noise, tolerances as priors. The tool's centre is judged at {summary['verification_poses']} "
        "other poses of the workspace, located from readings without noise, which is the calibration's part, and "
        "from readings with noise, as in use. Lengths and guide angles are those that all sets calibrate.",
    )
    shown = [_error_table(tables["errors"])]
    shown += [_step_table(tables["steps"])] if len(tables["steps"]) else []
    return make_section("Errors after calibration", text, tuple(shown), (figure,))


def _show(row: pd.Series[Any], quantity: str) -> str:
    scale = scale_of_quantity(quantity)
    return format_estimate(scale * float(row[quantity]), scale * float(row[f"{quantity}_se"]))


def _error_table(errors: pd.DataFrame) -> Table:
    columns = [Column("Set", kind="text"), Column("Procedure", kind="text"), Column("Lengths", "µm")]
    columns += [Column("Guide angles", "arcsec"), Column("calibration alone", "µm", "Tool's centre")]
    columns += [Column("in use", "µm", "Tool's centre"), Column("lengths", "µm", "Predicted to first order")]
    columns += [Column("tool", "µm", "Predicted to first order"), Column("Not converged")]
    rows: list[Row] = []
    for _, one in errors.iterrows():
        row: Row = [str(one["set"]), PROCEDURE_LABELS[str(one["procedure"])]]
        row += [_show(one, quantity) for quantity in figures.QUANTITY_LABELS]
        row += [format_fixed(1e3 * one[f"{quantity}_predicted"], 2) for quantity in ("lengths", "tool")]
        rows.append([*row, str(one["n_failed"])])
    return make_table("Root mean square errors; ± is the standard error over calibrations.", columns, rows)


def _step_table(steps: pd.DataFrame) -> Table:
    quantities = list(figures.QUANTITY_LABELS)
    columns = [Column("Step", kind="text"), Column("Procedure", kind="text")]
    columns += [Column(WORDS[quantity].capitalize()) for quantity in quantities]
    rows: list[Row] = []
    for (before, after, procedure), ours in steps.groupby(["from", "to", "procedure"], sort=False):
        one = index_rows(ours, ["quantity"])
        values = [format_estimate(one[q]["ratio"], one[q]["standard_error"]) for q in quantities]
        rows.append([f"{before} to {after}", PROCEDURE_LABELS[str(procedure)], *values])
    return make_table("By which factors root mean square errors fall from set to set.", columns, rows)


def _show_coverage(tables: Tables) -> PageSection:
    columns = [Column("Set", kind="text"), Column("Of", kind="text"), Column("Quantities"), Column("Covered", "%")]
    columns += [Column("lowest", "%", "Single quantities"), Column("highest", "%", "Single quantities")]
    columns += [Column("binomial se", "%", "Single quantities")]
    rows: list[Row] = []
    words = {"tool": "tool's centre, calibration alone", "tool_in_use": "tool's centre, in use"}
    for _, one in tables["coverage"].iterrows():
        level = "good" if COVERED[0] <= one["share"] <= COVERED[1] else "bad"
        share = format_estimate(100 * float(one["share"]), 100 * float(one["standard_error"]), 1)
        row: Row = [str(one["set"]), words.get(str(one["of"]), str(one["of"])), str(one["quantities"])]
        row.append(Cell(share, "good" if level == "good" else "bad"))
        row += [format_fixed(100 * float(one[name]), 1) for name in ("lowest", "highest", "binomial_error")]
        rows.append(row)
    text = (
        "Bayesian procedure: machines are drawn from the tolerances that it takes for priors; intervals are those of "
        "the normal distribution at the most probable machine, with the covariance there. The standard error counts "
        "each calibration once, since errors of one calibration go together.",
    )
    caption = "How often 90 % intervals hold the truth; between 85 and 95 % is required."
    return make_section("Coverage", text, (make_table(caption, columns, rows),))


# --- other machines, other noise -------------------------------------------------------------------------------------


def _show_machines(tables: Tables, summary: dict[str, Any]) -> list[PageSection]:
    if "machines" not in tables:
        return []
    ranges, counts = summary["ranges"], summary["machines"]
    span = {key: f"{format_plain(low)} to {format_plain(high)}" for key, (low, high) in _spans(ranges).items()}
    text = (
        f"{counts['drawn']} machines were drawn evenly: guides about a circle of radius {span['guide_radius_mm']} mm, "
        f"turned from its tangents by {span['guide_turn_deg']} deg; legs of {span['leg_length_mm']} mm; joints of the "
        f"platform on {span['platform_radius_mm']} mm, turned by {span['platform_turn_deg']} deg; poses within "
        f"{span['position_mm']} mm and {span['angle_deg']} deg. {counts['dropped']} were dropped, for a leg did not "
        f"reach or two legs crossed; {counts['kept']} remain. Each was calibrated {counts['calibrations']} times with "
        f"each set by the paper's procedure; {counts['failed']} of these calibrations did not converge and count in "
        "nothing.",
    )
    found = Figure(
        "machines",
        "C and factors of improvement over plausible machines. Dashed: published, in the colour of its set or step; "
        "triangles: the documented machine.",
        partial(
            figures.draw_machines,
            tables["machines"],
            tables["machine_steps"],
            tables["machine_summary"],
            _documented(tables, summary),
        ),
    )
    told = Figure(
        "predictors",
        "Tool's error of each machine, root mean square over its calibrations, by C in metres and radians, by C in "
        "units of noise and tolerances, and by the error predicted to first order.",
        partial(figures.draw_predictors, tables["machines"], summary["sets"], SHOWN_PREDICTORS),
    )
    many = make_section("Many plausible machines", text, (_machine_table(tables["machine_summary"]),), (found,))
    words = (
        "Correlations are of logarithms over the machines. The scatter is the factor by which the tool's error lies "
        "about the fitted power of the predictor; the few calibrations of each machine alone make about a factor of "
        f"{format_fixed(_sampling_scatter(counts['calibrations']), 2)}.",
    )
    return [many, make_section("What C tells", words, (_correlation_table(tables, summary),), (told,))]


def _spans(ranges: dict[str, Any]) -> dict[str, tuple[float, float]]:
    return {key: (value[0], value[1]) for key, value in ranges.items() if isinstance(value, list)}


def _sampling_scatter(n: int) -> float:
    """Return the factor by which a root mean square over n calibrations scatters where one direction decides it."""
    return math.exp(1.0 / math.sqrt(2.0 * n))


def _documented(tables: Tables, summary: dict[str, Any]) -> dict[str, dict[str, float]]:
    """Return the documented machine's figures by quantity and set or step."""
    values = dict(zip(tables["calibrability"]["set"], tables["calibrability"]["metres_radians"], strict=True))
    found: dict[str, dict[str, float]] = {"metres_radians": dict(values), "lengths": {}, "tool": {}}
    for before, after in list_steps(summary["sets"]):
        found["metres_radians"][f"{before} to {after}"] = values[before] / values[after]
    steps = tables["steps"]
    steps = steps[steps["procedure"] == PAPER] if len(steps) else steps
    for _, one in steps.iterrows():
        if one["quantity"] in found:
            found[str(one["quantity"])][f"{one['from']} to {one['to']}"] = float(one["ratio"])
    return found


def _machine_table(table: pd.DataFrame) -> Table:
    words = {"metres_radians": "C (m, rad)", "scaled": "C (noise, tolerances)"}
    units = {"lengths": ", µm", "guide_angles": ", arcsec", "tool": ", µm"}
    columns = [Column("Set or step", kind="text"), Column("", kind="text")]
    columns += [Column(f"{level} %", group="Machines below") for level in (5, 25, 50, 75, 95)]
    columns += [Column("Published"), Column("Machines below published"), Column("Count as published")]
    rows: list[Row] = []
    for _, one in table.iterrows():
        quantity, step = str(one["quantity"]), " to " in str(one["of"])
        scale = scale_of_quantity(quantity) if quantity in units and not step else 1.0
        word = words.get(quantity) or WORDS[quantity]
        row: Row = [str(one["of"]), f"factor of {word}" if step else f"{word}{units.get(quantity, '')}"]
        row += [format_power(scale * float(one[f"p{level:02d}"])) for level in (5, 25, 50, 75, 95)]
        row += [format_printed(float(one["published"]))]
        row += [format_percent(one["share_below"]), format_percent(one["share_within"])]
        rows.append(row)
    notes = (
        "C counts as published within a factor of √10, its improvement from a tenth of a large published one on, errors"
    )
    notes += " between 0.3 and 3 times a large published factor; small factors within 2."
    return make_table(f"Distributions over the machines. {notes}", columns, rows)


def _correlation_table(tables: Tables, summary: dict[str, Any]) -> Table:
    table = tables["correlations"]
    rows_of = index_rows(table[table["of"] == "tool"], ["set", "predictor"])
    columns = [Column("Predictor", kind="text")]
    groups: Sequence[str] = (*summary["sets"], "all")
    for name in groups:
        heading = "all sets" if name == "all" else name
        columns += [
            Column("correlation", group=heading),
            Column("power", group=heading),
            Column("scatter", group=heading),
        ]
    rows: list[Row] = []
    for predictor in dict.fromkeys(table["predictor"]):
        row: Row = [PREDICTOR_WORDS.get(str(predictor), "predicted to first order")]
        for name in groups:
            one = rows_of[name, predictor]
            row += [format_fixed(float(one[column]), 2) for column in ("correlation", "power", "scatter")]
        rows.append(row)
    return make_table("How well the tool's error follows from C, and from its prediction.", columns, rows)


def _show_sweep(tables: Tables, summary: dict[str, Any]) -> list[PageSection]:
    if "sweep_steps" not in tables or tables["sweep_steps"].empty:
        return []
    assumed = sorted({float(one["noise"]) for one in summary["sensors"] if one["unit"] == "arcsec"})
    figure = Figure(
        "sweep",
        "Factors by which errors fall from set to set, with two standard errors, against the noise of the angle "
        "sensors. Grey line: the noise assumed elsewhere on this page.",
        partial(figures.draw_sweep, tables["sweep_steps"], find_bands(tables, "tool"), assumed),
    )
    text = (
        "The paper states no noise. Sets with angle sensors are as good as these are; a set of carriages alone does "
        "not know of them. So the factor between the two is a choice of encoders as much as a property of the "
        "machine. All noise levels calibrate the same machines with the same random numbers, fewer than above.",
    )
    return [make_section("The angle sensors' noise", text, (), (figure,))]


def _show_method(summary: dict[str, Any]) -> PageSection:
    text = (
        "Symbols: s, position of a carriage on its guide; φ, angle of leg to carriage; ψ, angle of leg to platform; "
        "x_P and y_P, where a carriage reads zero; β, direction of a guide; l, length of a leg; ξ_B and η_B, its "
        "joint in the platform's frame; φ⁰ and ψ⁰, zeros of the angle sensors.",
        "What defines the two frames is given: x_P, y_P and β of leg 1 for the base; B of leg 1 and the direction to B "
        "of leg 2 for the platform. The spindle's place on the platform is given too, for no internal sensor sees it.",
        "Poses at the measurements are unknown. Each step of Gauss and Newton projects the residuals onto what is "
        "free of them: eq. 4 with the poses eliminated. Predictions to first order use the covariance of these "
        "projected rows.",
    )
    return make_section("How it was done", text)


# --- what was found, in sentences ------------------------------------------------------------------------------------


def format_printed(value: float) -> str:
    """Return a published number with the digits that were printed."""
    if not math.isfinite(value) or abs(value) < 1e3:
        return format_plain(value) if math.isfinite(value) else NO_VALUE
    return format_power(value, 1)


def index_rows(table: pd.DataFrame, keys: list[str]) -> dict[Any, dict[str, Any]]:
    """Return the rows of a table by the values of some columns."""
    rows = [{str(name): value for name, value in row.items()} for row in table.to_dict("records")]
    return {tuple(row[key] for key in keys) if len(keys) > 1 else row[keys[0]]: row for row in rows}


def list_steps(names: list[str]) -> list[tuple[str, str]]:
    """Return neighbours."""
    return list(pairwise(names))


def pick_step(steps: pd.DataFrame, pair: tuple[str, str], quantity: str, procedure: str = PAPER) -> dict[str, Any]:
    """Return a row of the table of steps."""
    return index_rows(steps, ["from", "to", "procedure", "quantity"])[*pair, procedure, quantity]


def find_bands(tables: Tables, quantity: str) -> dict[str, Band]:
    """Return published factors by step, and between which a found one counts as the same."""
    if "judged" not in tables:
        return {}
    rows = tables["judged"]
    rows = rows[(rows["quantity"] == quantity) & rows["of"].str.contains(" to ")]
    values = zip(rows["of"], rows["published"], rows["low"], rows["high"], strict=True)
    return {str(of): Band(float(value), float(low), float(high)) for of, value, low, high in values}


def state_headline(tables: Tables, summary: dict[str, Any]) -> str:
    """Return the main result in one sentence."""
    names, errors = summary["sets"], index_rows(tables["errors"], ["set", "procedure"])
    if len(names) < 2:
        rms = format_significant(1e3 * errors[names[0], PAPER]["tool"])
        return f"Calibrated with {names[0]} the tool's centre is known to {rms} µm."
    said, bands = [], find_bands(tables, "tool")
    for before, after in list_steps(names):
        one = pick_step(tables["steps"], (before, after), "tool")
        band = bands.get(f"{before} to {after}")
        printed = "" if band is None else f" (published {format_printed(band.value)})"
        ratio = format_significant(float(one["ratio"]), 2)
        said.append(f"{ratio} from {before} to {after}{printed}")
    judged = tables.get("judged", pd.DataFrame())
    holds = (
        "" if judged.empty else ": the published pattern" + (" holds" if judged["reached"].all() else " fails in part")
    )
    return f"The tool's error falls by a factor of {join_words(said)}{holds}."


def state_verdict(tables: Tables, summary: dict[str, Any]) -> tuple[Statement, ...]:
    """Return what was found, the published first."""
    statements = [*_judge_published(tables), _say_assumed(tables, summary)]
    statements += [_say_bayesian(tables, summary), _judge_coverage(tables), *_judge_failures(tables)]
    statements += [*_say_machines(tables, summary), _say_units(tables, summary), *_say_predictors(tables, summary)]
    return tuple(statements)


def _judge_published(tables: Tables) -> list[Statement]:
    """Compare with print: the sets themselves, then every step."""
    if "judged" not in tables:
        return []
    judged, statements = tables["judged"], []
    sets = judged[~judged["of"].str.contains(" to ")]
    if len(sets):
        n = int(sets["reached"].sum())
        text = f"Sensor sets: {n} of {len(sets)} published figures (C, number of parameters) reached."
        statements.append(Statement(text, _level(sets), "Calibrability", value=n, limit=len(sets)))
    for of, rows in judged[judged["of"].str.contains(" to ")].groupby("of", sort=False):
        tool = next((row for _, row in rows.iterrows() if row["quantity"] == "tool"), rows.iloc[0])
        n, value = int(rows["reached"].sum()), float(tool["found"])
        text = f"{n} of {len(rows)} factors reached; {WORDS[str(tool['quantity'])]} {format_power(value)}, published "
        text += f"{format_printed(tool['published'])}."
        lead, limit = str(of).capitalize(), float(tool["published"])
        statements.append(Statement(text, _level(rows), lead, value=value, limit=limit))
    return statements


def _level(rows: pd.DataFrame) -> Level:
    return "good" if rows["reached"].all() else "warning"


def _estimate(value: float, error: float) -> str:
    return format_estimate(value, error, 0 if error >= 1.0 else 2)


def _say_assumed(tables: Tables, summary: dict[str, Any]) -> Statement:
    """Return at which noise of the angle sensors the tool's published factor comes out, as none is published."""
    text = "Dimensions, poses, tolerances and noise are assumed"
    bands = {of: band for of, band in find_bands(tables, "tool").items() if band.value >= 10.0}
    if "sweep_steps" in tables:
        sweep = tables["sweep_steps"]
        for of, band in bands.items():
            rows = sweep[(sweep["from"] + " to " + sweep["to"] == of) & (sweep["procedure"] == PAPER)]
            rows = rows[rows["quantity"] == "tool"].sort_values("angle_noise_arcsec")
            ratio, arcsec = rows["ratio"].to_numpy(), rows["angle_noise_arcsec"].to_numpy()
            if ratio.min() < band.value < ratio.max():
                at = float(np.exp(np.interp(-math.log(band.value), -np.log(ratio), np.log(arcsec))))
                text += f"; the published factor comes out near {format_significant(at, 1)} arcsec angle noise"
                return Statement(f"{text}.", "warning", "Assumed", value=at, unit="arcsec")
    return Statement(f"{text}.", "warning", "Assumed")


def _say_bayesian(tables: Tables, summary: dict[str, Any]) -> Statement:
    """Return what weights and priors make of the tool's error with the first set."""
    errors, name = index_rows(tables["errors"], ["set", "procedure"]), summary["sets"][0]
    paper, ours = (1e3 * errors[name, procedure]["tool"] for procedure in (PAPER, BAYESIAN))
    text = f"Weights and priors reduce the tool's error with {name} from {format_significant(paper)} to "
    text += f"{format_significant(ours)} µm."
    return Statement(text, "plain", "Bayesian procedure", value=ours, limit=paper, unit="µm")


def _judge_coverage(tables: Tables) -> Statement:
    rows = tables["coverage"]
    inside = rows["share"].between(*COVERED).all()
    low, high = float(rows["share"].min()), float(rows["share"].max())
    text = f"90 % intervals hold {format_percent(low, 1)} to {format_percent(high, 1)} of the true values."
    return Statement(text, "good" if inside else "bad", "Coverage", value=low, limit=0.9)


def _judge_failures(tables: Tables) -> list[Statement]:
    rows = tables["errors"][tables["errors"]["n_failed"] > 0]
    if rows.empty:
        return []
    n = int(rows["n_failed"].sum())
    return [Statement(f"{n} calibrations did not converge (excluded).", "warning", "Failed", value=n, limit=0.0)]


def _say_machines(tables: Tables, summary: dict[str, Any]) -> list[Statement]:
    if "machine_summary" not in tables:
        return []
    counts, rows = summary["machines"], index_rows(tables["machine_summary"], ["of", "quantity"])
    text = f"{counts['kept']} of {counts['drawn']} machines drawn are feasible."
    statements = [Statement(text, "plain", "Other machines", value=counts["kept"], limit=counts["drawn"])]
    for before, after in list_steps(summary["sets"]):
        one = rows[f"{before} to {after}", "tool"]
        middle, low, high = (format_power(one[key]) for key in ("p50", "p05", "p95"))
        text = f"{before} to {after}: tool factor {middle} ({low} to {high})."
        statements.append(Statement(text, "plain", "Other machines", value=one["p50"], limit=one["published"]))
    printed = tables["machine_summary"]
    printed = printed[printed["of"].isin(summary["sets"]) & printed["published"].notna()]
    if len(printed):
        rare = not printed["share_below"].between(*COMMON).all()
        least = printed.sort_values("share_below").iloc[0]
        text = f"C below the published one: {format_percent(least['share_below'])} of the machines ({least['of']})."
        value = float(least["share_below"])
        statements.append(Statement(text, "warning" if rare else "plain", "C of other machines", value=value))
    return statements


def _say_units(tables: Tables, summary: dict[str, Any]) -> Statement:
    table = index_rows(tables["calibrability"], ["set"])
    text, value = "C depends on the units of length and angle", math.nan
    if len(table) > 1:
        before, after = list_steps(summary["sets"])[0]
        value, scaled = (table[before][unit] / table[after][unit] for unit in ("metres_radians", "scaled"))
        text += f": {before} to {after} {format_power(value)} (m, rad), {format_power(scaled)} (noise)"
    return Statement(f"{text}.", "warning", "Units", value=value)


def _say_predictors(tables: Tables, summary: dict[str, Any]) -> list[Statement]:
    if "correlations" not in tables:
        return []
    table = tables["correlations"]
    every = index_rows(table[table["of"] == "tool"], ["set", "predictor"])
    rows = {key: float(row["correlation"]) for key, row in every.items()}

    def find(predictor: str) -> float:
        return min(rows[name, predictor] for name in summary["sets"])

    text = (
        f"Least correlation of the tool's error: {format_fixed(find('metres_radians'), 2)} with C, "
        f"{format_fixed(find('scaled'), 2)} with scaled C, {format_fixed(find('tool_predicted'), 2)} predicted."
    )
    return [Statement(text, "plain", "What C tells", value=find("metres_radians"), limit=find("tool_predicted"))]
