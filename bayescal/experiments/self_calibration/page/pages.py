"""The page of a machine calibrated from its own readings: what was found, sensors, models, parameters, tool."""

from __future__ import annotations

import math
from typing import Any

import pandas as pd

from bayescal.experiments.self_calibration.page import figures
from bayescal.experiments.self_calibration.page.verdict import (
    Row,
    explains,
    list_rows,
    state_headline,
    state_verdict,
    write_names,
)
from bayescal.experiments.shared.diagnostics_table import tabulate_diagnostics
from bayescal.experiments.shared.function_page import judge_functions, show_functions
from bayescal.experiments.shared.guide_symbols import tabulate_symbols
from bayescal.report.blocks import Cell, Column, Figure, Level, Page, Section, make_section, make_table
from bayescal.report.numbers import (
    NOTHING,
    count_decimals,
    format_estimate,
    format_fixed,
    format_pair,
    format_scientific,
    format_significant,
)
from bayescal.report.symbols import split_name

KIND = "Self-calibration"
SHOWN = {"mm": (1.0, "mm"), "rad": (1e3, "mrad")}
"""Factor and unit in which parameters of a unit are shown."""
VERDICT_LEVELS: dict[str, Level] = {"identifiable": "good", "weak": "warning", "not": "bad"}
TOOL = "tool's centre over the workspace, µm rms"
NOMINAL_TOOL = (
    "What internal sensors see never depends on where the tool sits on the platform: without an instrument beside the "
    "machine, errors are those of the platform's point at which the tool is taken to be. The tool's own place comes "
    "on top, with its tolerance. Before a calibration more sensors may locate it worse: angle sensors come with zeros "
    "that are not known."
)


def build_page(tables: dict[str, pd.DataFrame], summary: dict[str, Any]) -> Page:
    """Return the page of an experiment's tables."""
    sections = [
        _show_sensors(tables),
        *_show_models(tables, summary),
        *_show_identifiability(tables),
        _show_parameters(tables),
        *_show_predictions(tables),
        *show_functions(tables),
        _show_method(tables),
    ]
    count = summary["n_poses"]
    *verdict, converged = state_verdict(tables, summary)
    facts = (
        ("Machine", str(summary["machine"])),
        ("Poses", f"{count['calibration']} for calibration, {count['verification']} for verification"),
    )
    return Page(
        KIND,
        summary["experiment"],
        summary["title"],
        summary["data_origin"],
        state_headline(tables, summary),
        (*verdict, *judge_functions(tables), converged),
        tuple(sections),
        facts,
    )


def list_variants(tables: dict[str, pd.DataFrame]) -> list[str]:
    """Return what the terminal says of each variant, a line each."""
    width = max(len(str(name)) for name in tables["variants"]["variant"])
    lines = [f"{'variant':{width}}  free  log-evidence      C  tool before/after µm  true µm  converged"]
    for row in list_rows(tables["variants"]):
        true = format_significant(row["tool_calibrated_error_um"])
        tool = format_pair(row["tool_before_um"], row["tool_after_um"])
        evidence, condition = format_fixed(row["log_evidence"], 2), format_scientific(row["calibrability"])
        lines.append(
            f"{row['variant']:{width}}  {row['n_parameters']:4d}  {evidence:>12}  "
            f"{condition:>5}  {tool:>20}  {true:>7}  {'yes' if row['converged'] else 'NO'}"
        )
    return lines


def list_plain(tables: dict[str, pd.DataFrame]) -> dict[str, str]:
    """Return names and titles of the variants in which nothing is fixed that could be free."""
    rows = tables["variants"]
    rows = rows[rows["plain"]]
    return dict(zip(rows["variant"].astype(str), rows["title"].astype(str), strict=True))


def _show_sensors(tables: dict[str, pd.DataFrame]) -> Section:
    variants = tables["variants"]
    known = bool(variants["tool_calibrated_error_um"].notna().any())
    plain = variants[variants["plain"]] if variants["plain"].any() else variants
    columns = [Column("Sensors", kind="text"), Column("Readings per pose"), Column("Free"), Column("Equations")]
    columns += [Column("m, rad", group="calibrability C"), Column("tolerances", group="calibrability C")]
    columns += [Column("before", group=TOOL), Column("after", group=TOOL)]
    columns += [Column("true, nominal", group=TOOL), Column("true, after", group=TOOL)] if known else []
    rows: list[list[str | Cell]] = []
    for row in list_rows(plain):
        line: list[str | Cell] = [str(row["title"])]
        line += [str(row[name]) for name in ("n_sensors", "n_parameters", "n_equations")]
        line += [format_scientific(row["calibrability"]), format_scientific(row["calibrability_scaled"])]
        names = ["tool_before_um", "tool_after_um"]
        names += ["tool_nominal_error_um", "tool_calibrated_error_um"] if known else []
        rows.append([*line, *(format_significant(row[name]) for name in names)])
    caption = (
        "Sets of sensors; C is the condition of JᵀJ, poses eliminated. Tool errors before and after are predicted."
    )
    diamonds = " Diamonds: what the machine of the posterior mean truly errs by." if known else ""
    figure = Figure(
        "tool",
        "Error of the tool's centre over the workspace, by what is unknown of the parameters: tolerances, then the "
        f"posterior.{diamonds}",
        lambda: figures.draw_tool(variants),
    )
    return make_section("What the sensors are worth", (NOMINAL_TOOL,), (make_table(caption, columns, rows),), (figure,))


def _show_models(tables: dict[str, pd.DataFrame], summary: dict[str, Any]) -> list[Section]:
    found = []
    variants = {row["variant"]: row for row in list_rows(tables["variants"])}
    columns = [Column("Model", kind="text"), Column("Free"), Column("Log-evidence"), Column("Difference", "nat")]
    columns += [Column("elpd, verification"), Column("Misfit", "of the noise")]
    columns += [Column("predicted", group=TOOL), Column("true", group=TOOL)]
    for names in summary["rankings"]:
        best = variants[names[0]]
        rows: list[list[str | Cell]] = [_show_model(variants[name], best["log_evidence"]) for name in names]
        caption = f"Models of the same readings of {best['n_sensors']} sensors, largest evidence first."
        found.append(make_table(caption, columns, rows))
    text = (
        "Evidence weighs how well a model explains the readings against how much it would have allowed for; elpd is "
        "the expected log predictive density of the readings kept for verification. Misfit is what the mode leaves of "
        "the readings, rms over the degrees of freedom: 1 where the noise is all.",
    )
    return [make_section("Models ranked by evidence", text, tuple(found))] if found else []


def _show_model(row: Row, best: float) -> list[str | Cell]:
    good = explains(row)
    return [
        str(row["title"]),
        str(row["n_parameters"]),
        format_estimate(row["log_evidence"], row["log_evidence_se"], 2),
        format_fixed(row["log_evidence"] - best, 1),
        format_fixed(row["elpd"], 1),
        Cell(format_significant(row["misfit"]), "plain" if good else "bad"),
        format_significant(row["tool_after_um"]),
        Cell(format_significant(row["tool_calibrated_error_um"]), "plain" if good else "bad"),
    ]


def _show_identifiability(tables: dict[str, pd.DataFrame]) -> list[Section]:
    if "identifiability" not in tables:
        return []
    table, titles = tables["identifiability"], list_plain(tables)
    columns = [Column("Symbol", kind="symbol"), Column("Unit", kind="text"), Column("Tolerance")]
    columns += [
        Column(title, group="sd that remains, largest of all legs (contraction, least)") for title in titles.values()
    ]
    rows: list[list[str | Cell]] = []
    for symbol, ours in table.groupby("symbol", sort=False):
        first = ours.iloc[0]
        factor, unit = SHOWN[str(first["unit"])]
        line: list[str | Cell] = [str(symbol), unit, format_significant(factor * float(first["prior_sd"]), 2)]
        rows.append([*line, *(_show_symbol(ours[ours["variant"] == name], factor) for name in titles)])
    caption = "What the poses and sensors tell of each symbol, by the audit."
    text = (
        "In units of the tolerances, the poses eliminated; contraction is the share of the variance beforehand that "
        "is gone. Green: identifiable, the tolerance at least halved on every leg. A dash: these sensors do not see "
        "it, or it defines a frame.",
    )
    ridges = [
        f"{titles[r['variant']]}, contraction {format_fixed(r['contraction'], 2)}: {write_names(r['sentence'])}"
        for r in list_rows(tables["ridges"])
    ]
    told = ("Ridges, along which too little is learnt:", *ridges) if ridges else ("No ridge is left with any of them.",)
    return [make_section("Which parameters are identifiable", text + told, (make_table(caption, columns, rows),))]


def _show_symbol(rows: pd.DataFrame, factor: float) -> Cell:
    if rows.empty:
        return Cell(NOTHING)
    order = list(VERDICT_LEVELS)
    worst = max((str(v) for v in rows["verdict"]), key=order.index)
    least = float(rows["contraction"].min())
    share = format_fixed(math.floor(100.0 * least) / 100.0, 2) if least < 0.99 else ">0.99"
    return Cell(f"{format_significant(factor * rows['predicted_sd'].max(), 2)} ({share})", VERDICT_LEVELS[worst])


def _show_parameters(tables: dict[str, pd.DataFrame]) -> Section:
    parameters, titles = tables["parameters"], list_plain(tables)
    titles = titles or dict(zip(tables["variants"]["variant"], tables["variants"]["title"], strict=True))
    known = "true" in parameters
    some = parameters[parameters["variant"].isin(list(titles))]
    columns = [Column("Parameter", kind="text"), Column("Unit", kind="text"), Column("Tolerance")]
    columns += [Column("True")] if known else []
    columns += [Column(title, group="deviation from nominal, mean ± sd") for title in titles.values()]
    rows: list[list[str | Cell]] = []
    for name in figures.order_parameters(some):
        ours = {row["variant"]: row for row in list_rows(some[some["parameter"] == name])}
        first = next(iter(ours.values()))
        factor, unit = SHOWN[first["unit"]]
        line: list[str | Cell] = [write_names(name), unit, format_significant(factor * first["prior_sd"], 2)]
        if known:
            places = count_decimals(factor * min(row["sd"] for row in ours.values()))
            line.append(format_fixed(factor * (first["true"] - first["nominal"]), places))
        rows.append([*line, *(_show_deviation(ours.get(variant), factor) for variant in titles)])
    ground = " Below: how far the truth is from the mean, in standard deviations; grey holds 90 %." if known else ""
    figure = Figure(
        "parameters",
        f"What remains of each parameter's tolerance.{ground}",
        lambda: figures.draw_parameters(parameters, titles),
    )
    table = make_table("Parameters, posterior beside the truth." if known else "Parameters.", columns, rows)
    symbols = tabulate_symbols(split_name(str(name))[0] for name in parameters["parameter"])
    return make_section("Parameters", (), (table, *symbols), (figure,), wide=True)


def _show_deviation(row: Row | None, factor: float) -> str:
    return NOTHING if row is None else format_estimate(factor * (row["mean"] - row["nominal"]), factor * row["sd"])


def _show_predictions(tables: dict[str, pd.DataFrame]) -> list[Section]:
    if "predictions" not in tables:
        return []
    variants, predictions = tables["variants"], tables["predictions"]
    known = predictions["x_true_mm"].notna().all()
    titles = list_plain(tables) or dict(zip(variants["variant"], variants["title"], strict=True))
    columns = [Column("Variant", kind="text"), Column("predicted", "µm rms")]
    columns += [Column("true error", "µm rms"), Column("True coordinates in their 90 % intervals")] if known else []
    rows: list[list[str | Cell]] = []
    for row in list_rows(variants):
        line: list[str | Cell] = [str(row["title"]), format_significant(row["verification_sd_um"])]
        if known:
            count = 2 * int((predictions["variant"] == row["variant"]).sum())
            inside = f"{round(count * row['inside_90'])} of {count}"
            line += [
                format_significant(row["verification_error_um"]),
                Cell(inside, "plain" if explains(row) else "bad"),
            ]
        rows.append(line)
    text = (
        "From the machine's own sensors at each pose and draws of its parameters, the noise of the readings included. "
        "All poses of a variant share the errors of its parameters: its intervals hold the truth or miss it together.",
    )
    figure = Figure(
        "predictions",
        "The tool's centre at the verification poses: mean and 90 % interval. Scales differ.",
        lambda: figures.draw_predictions(predictions, titles),
    )
    table = make_table("The tool's centre at the verification poses.", columns, rows)
    return [make_section("Prediction of the tool's centre", text, (table,), (figure,))]


def _show_method(tables: dict[str, pd.DataFrame]) -> Section:
    text = (
        "Each pose may lie anywhere in the workspace alike and is integrated out, to first order about the one that "
        "explains its readings best; what is left of the readings in the space that no pose reaches is the likelihood. "
        "Parameters have their tolerances as normal priors, and what defines the frames of base and platform is given.",
    )
    table = tabulate_diagnostics("Two estimates of the log-evidence, and the chains.", list_rows(tables["variants"]))
    return make_section("Method and diagnostics", text, (table,))
