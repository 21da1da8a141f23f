"""The page of an experiment on sensor placement: which set to buy, and why not another one."""

from __future__ import annotations

from functools import partial
from typing import Any

import pandas as pd

from bayescal.experiments.sensor_placement.page import figures
from bayescal.experiments.sensor_placement.page.figures import write_sensors
from bayescal.experiments.sensor_placement.page.tables import list_sensors, tabulate_front, tabulate_kinds
from bayescal.report.blocks import Cell, Column, Figure, Level, Page, Section, Statement, make_section, make_table
from bayescal.report.numbers import (
    NOTHING,
    format_count,
    format_estimate,
    format_fixed,
    format_percent,
    format_plain,
    format_significant,
    format_span,
    join_words,
)

KIND = "Sensor placement"
ORIGIN = "Predicted to first order about the machine as designed, and simulated; nothing is measured."
KINDS_SHOWN = 3  # of each number of sensors
Z = 2.0
ROUNDED = 1e-5  # what the summary's six digits leave out
REASONS = {
    "pose": "the sensors in use do not determine the pose",
    "equations": "there are fewer equations than unknowns",
    "tolerances": "the calibration leaves the tool's centre to the tolerances",
}
SENSORS = {
    "s": "scales of the carriages ",
    "phi": "angles of the legs to their carriages ",
    "psi": "angles of the legs to the platform ",
    "rho": "encoders of the actuators ",
    "tilt_a": "inclinometers on the legs ",
    "tilt_b": "inclinometers on the legs, square to these ",
}
FRAMES = {
    "aligned": "Table and tool are set up once after the calibration: an error that one motion of the table and one "
    "offset of the tool would mend at all poses is not counted, so that no leg is privileged by carrying the frames.",
    "given": "The frames are those of the first legs, exact beforehand; a set without sensors there leaves the tool's "
    "centre to the tolerances in these frames.",
    "instrument": "The frames are those of the instrument beside the machine; a set without it leaves the tool's "
    "centre to the tolerances in these frames.",
}


def build_page(summary: dict[str, Any], tables: dict[str, pd.DataFrame]) -> Page:
    """Return the page of an experiment's tables."""
    sections = (
        _front_section(summary, tables),
        _number_section(tables),
        *_simulated_section(tables),
        _kinds_section(tables),
        _method_section(summary, tables),
    )
    return Page(
        KIND,
        summary["name"],
        summary["title"],
        ORIGIN,
        _state_headline(summary),
        tuple(_judge(summary, tables)),
        sections,
        _list_facts(summary),
    )


# --- verdict -----------------------------------------------------------------------------------------------------


def _um(value: float) -> str:
    return f"{format_significant(value)} µm"


def _capital(text: str) -> str:
    return text[:1].upper() + text[1:]


def _offer(row: dict[str, Any] | pd.Series) -> str:
    """Return number, pattern and price of a set."""
    price = format_plain(row["price"])
    return f"{row['n_sensors']} sensors at a price of {price} ({write_sensors(str(row['pattern']))})"


def _state_headline(summary: dict[str, Any]) -> str:
    best, enough = summary["best"], summary["enough"]
    words = f"Take {_offer(enough)}: they locate the tool's centre to {_um(enough['rms_um'])}"
    if enough["sensors"] == best["sensors"]:
        return f"{words}; no cheaper set comes within {format_percent(summary['within'])} of that."
    whole = "all" if best["n_sensors"] == summary["n_sensors"] else "the best set,"
    return (
        f"{words}, within {format_percent(summary['within'])} of the best: {whole} {best['n_sensors']} at a price of "
        f"{format_plain(best['price'])} reach {_um(best['rms_um'])}."
    )


def _judge(summary: dict[str, Any], tables: dict[str, pd.DataFrame]) -> list[Statement]:
    best, enough = summary["best"], summary["enough"]
    statements = [
        Statement(f"{_offer(enough)} reach {_split(enough)}; {_describe_alike(enough, tables)}.", "good", "Enough"),
        Statement(f"{_offer(best)} reach {_split(best)}.", "plain", "Most accurate"),
    ]
    statements += [_judge_named(name, row, summary, tables) for name, row in summary["named"].items()]
    statements.append(_judge_fewest(tables))
    statements.append(_count_bad(summary, tables))
    if not tables["simulated"].empty:
        statements.append(_judge_simulated(tables["simulated"]))
    words = f"{_capital(summary['prices'])}. The front against the number of sensors needs no prices."
    statements.append(Statement(words, "plain", "Prices"))
    return statements


def _split(row: dict[str, Any] | pd.Series) -> str:
    """Return the error with its parts."""
    return (
        f"{_um(row['rms_um'])} rms over the workspace ({_um(row['calibration_um'])} of the calibration, "
        f"{_um(row['noise_um'])} of the noise in use), {_um(row['largest_um'])} where it is largest"
    )


def _describe_alike(row: dict[str, Any], tables: dict[str, pd.DataFrame]) -> str:
    front = tables["front"]
    here = front[front["sensors"] == row["sensors"]].iloc[0]
    return f"{here['n_alike']} of the {here['n_of_pattern']} sets of this pattern are as good to 5 %"


def _judge_named(name: str, row: dict[str, Any], summary: dict[str, Any], tables: dict[str, pd.DataFrame]) -> Statement:
    """Return what a named set reaches and what does as well for less."""
    if row["reason"]:
        words = f"no good: {REASONS[row['reason']]}"
        words += f"; the tool's centre stays uncertain by {_um(row['rms_um'])}" if row["rms_um"] is not None else ""
        return Statement(f"{_capital(words)}.", "plain", _capital(name))
    front = tables["front"]
    as_good = front[front["rms_um"] <= (1.0 + ROUNDED) * row["rms_um"]].iloc[0]
    nearly = front[front["rms_um"] <= (1.0 + summary["within"]) * row["rms_um"]].iloc[0]
    words = f"{row['n_sensors']} sensors at a price of {format_plain(row['price'])} reach {_um(row['rms_um'])}"
    if row["left_to_tolerances"] > 0.5:
        share = format_percent(row["left_to_tolerances"])
        words += f", {share} of its variance from what the readings hardly tell"
    if as_good["price"] < row["price"]:
        words += f". {_offer(as_good)} are as good or better, with {_um(as_good['rms_um'])}"
    else:
        words += ". No cheaper set is as good"
    if nearly["price"] < min(row["price"], as_good["price"]):
        more = format_percent(nearly["rms_um"] / row["rms_um"] - 1.0)
        words += f". {_offer(nearly)} are {more} less accurate, with {_um(nearly['rms_um'])}"
    return Statement(f"{words}.", "plain", _capital(name))


def _judge_fewest(tables: dict[str, pd.DataFrame]) -> Statement:
    first = tables["front_by_number"].iloc[0]
    words = f"fewer than {first['n_sensors']} sensors calibrate nothing; the best {_offer(first)} reach "
    words += f"{_um(first['rms_um'])}, and would err by {_um(first['beforehand_um'])} uncalibrated"
    return Statement(f"{words}.", "plain", "Fewest")


def _count_bad(summary: dict[str, Any], tables: dict[str, pd.DataFrame]) -> Statement:
    counts = tables["sets"]["reason"].value_counts()
    parts = [f"{format_count(counts[reason])} where {words}" for reason, words in REASONS.items() if reason in counts]
    words = f"{format_count(summary['n_feasible'])} of {format_count(summary['n_sets'])} sets calibrate the machine"
    return Statement(f"{words}; no good are {join_words(parts)}." if parts else f"{words}.", "plain", "Sets")


def _judge_simulated(simulated: pd.DataFrame) -> Statement:
    z = (simulated["simulated_um"] - simulated["predicted_um"]).abs() / simulated["simulated_error_um"]
    inside, failed = int((z <= Z).sum()), int(simulated["n_failed"].sum())
    ratio = simulated["simulated_um"] / simulated["predicted_um"]
    total = int(simulated["n_machines"].sum()) + failed
    words = (
        f"{inside} of {len(z)} predicted errors are met within two standard errors by {format_count(total)} simulated "
        f"calibrations (simulated over predicted {format_span(list(ratio), 2)})"
    )
    words += f"; {failed} did not converge and count in nothing" if failed else ""
    level: Level = "good" if inside >= 0.8 * len(z) and not failed else "warning"
    return Statement(f"{words}.", level, "Predictions")


def _list_facts(summary: dict[str, Any]) -> tuple[tuple[str, str], ...]:
    tolerances = summary["tolerances"]
    sensors = []
    for name, s in summary["sensors"].items():
        noise, unit = (s["noise_um"], "µm") if s["noise_um"] is not None else (s["noise_arcsec"], "arcsec")
        held = ", always there" if s["always"] else ""
        outside = ", only during the calibration" if name in summary["external"] else ""
        what = f"{SENSORS.get(name, '')}{write_sensors(name)} {format_plain(noise)} {unit}"
        sensors.append(f"{what}, price {format_plain(s['price'])}{held}{outside}")
    return (
        ("Machine", str(summary["machine"]).replace("_", " ")),
        ("Sensors", "; ".join(sensors)),
        (
            "Tolerances",
            f"lengths {format_plain(tolerances['length_mm'])} mm, angles {format_plain(tolerances['angle_deg'])}°, "
            f"zeros of angle sensors {format_plain(tolerances['zero_deg'])}°",
        ),
        ("Plan", f"{summary['n_poses']} poses; accuracy over {summary['n_workspace']} poses of the same workspace"),
    )


# --- sections ----------------------------------------------------------------------------------------------------


def _front_section(summary: dict[str, Any], tables: dict[str, pd.DataFrame]) -> Section:
    always = " and ".join(dict.fromkeys(write_sensors(name.partition("[")[0]) for name in summary["always"]))
    text: tuple[str, ...] = (
        "A set stands on the front where none costs no more and is more accurate. Legs are interchangeable on a "
        "symmetric machine: a pattern says what stands together on a leg, and the last columns how many sets have it "
        "and how many of them are as good to 5 %.",
    )
    text += (f"Not listed, for they are in every set: {always}.",) if always else ()
    figure = Figure(
        "front",
        "Every set with its price; sets beyond thirty times the best error are not shown.",
        partial(figures.draw_front, tables["sets"], tables["front"], tables["named"], tables["simulated"]),
    )
    table = tabulate_front(tables["front"], summary["enough"]["sensors"], summary["within"])
    return make_section("Accuracy against price", text, (table,), (figure,), (), True)


def _number_section(tables: dict[str, pd.DataFrame]) -> Section:
    best = tables["sets"][tables["sets"]["reason"] == ""].sort_values("rms_um", kind="stable")
    best = best.drop_duplicates("n_sensors").set_index("n_sensors")
    columns = [
        Column("Sensors"),
        Column("feasible", group="sets"),
        Column("pose", group="no good"),
        Column("equations", group="no good"),
        Column("tolerances", group="no good"),
        Column("best rms", "µm"),
        Column("Pattern of the best", kind="text"),
    ]
    rows: list[list[str | Cell]] = []
    for _, row in tables["reasons"].iterrows():
        n = int(row["n_sensors"])
        counts = [format_count(row[name]) for name in ("feasible", *REASONS)]
        pattern = write_sensors(str(best.loc[n, "pattern"])) if n in best.index else NOTHING
        rows.append([str(n), *counts, format_significant(row["best_um"]), pattern])
    why = "; ".join(f"“{name}”: {words}" for name, words in REASONS.items())
    figure = Figure(
        "numbers",
        "Every set with its number of sensors; the front needs no prices.",
        partial(figures.draw_numbers, tables["sets"], tables["front_by_number"], tables["named"]),
    )
    caption = f"Sets by number of sensors. {why}."
    return make_section("Accuracy against the number of sensors", (), (make_table(caption, columns, rows),), (figure,))


def _simulated_section(tables: dict[str, pd.DataFrame]) -> list[Section]:
    table = tables["simulated"]
    if table.empty:
        return []
    columns = [
        Column("Sensors"),
        Column("Price"),
        Column("predicted", "µm", "rms error"),
        Column("simulated", "µm", "rms error"),
        Column("off by", "standard errors"),
        Column("calibrations"),
        Column("failed"),
        Column("Set", kind="text"),
    ]
    rows: list[list[str | Cell]] = []
    for _, row in table.iterrows():
        z = (row["simulated_um"] - row["predicted_um"]) / row["simulated_error_um"]
        rows.append(
            [
                str(row["n_sensors"]),
                format_plain(row["price"]),
                format_significant(row["predicted_um"]),
                format_estimate(row["simulated_um"], row["simulated_error_um"]),
                Cell(format_fixed(z, 1, sign=True), "plain" if abs(z) <= Z else "warning"),
                str(row["n_machines"]),
                str(row["n_failed"]),
                list_sensors(row["sensors"]),
            ]
        )
    text = (
        "For each set true machines were drawn within the tolerances, their readings simulated with noise, and each "
        "machine calibrated with the tolerances as priors; then its tool's centre was located from noisy readings.",
    )
    figure = Figure(
        "simulated",
        "Simulated over predicted errors; bars are two standard errors from the scatter over machines.",
        partial(figures.draw_simulated, table),
    )
    caption = "Predicted errors and those of simulated calibrations."
    return [make_section("Does it come true?", text, (make_table(caption, columns, rows),), (figure,))]


def _kinds_section(tables: dict[str, pd.DataFrame]) -> Section:
    kinds = tables["kinds"]
    shown = kinds[kinds["n_feasible"] > 0].groupby("n_sensors").head(KINDS_SHOWN)
    return make_section(
        "How many of each kind",
        (
            f"For each number of sensors the {KINDS_SHOWN} best mixtures of kinds; where they stand is another matter, "
            "as the span from best to worst shows. kinds.csv has all mixtures.",
        ),
        (tabulate_kinds(shown),),
    )


def _method_section(summary: dict[str, Any], tables: dict[str, pd.DataFrame]) -> Section:
    text = [
        FRAMES[summary["frames"]],
        f"Each set was judged to first order about the machine as designed: the poses eliminated from the whitened "
        f"readings, the tolerances of up to {summary['n_parameters']} parameters as priors, and the error of the "
        "tool's centre, as located by the internal sensors of the set, averaged over the workspace. It has a part that "
        "the calibration leaves and a part by the noise of the readings in use. A zero of an angle sensor is unknown "
        "only where the sensor is there.",
        "“Left to tolerances” is the share of the error's variance from combinations of parameters of which the "
        "readings tell less than the tolerances did; above 80 % a set counts as no good.",
    ]
    if any("tilt" in name for name in summary["sensors"]):
        text.append(
            "The axes of inclinometers are taken as mounted, only their zeros as unknown; joints have no play, and "
            "nothing drifts between poses."
        )
    timing = tables["timing"].iloc[0]
    columns = [Column("Sets judged"), Column("Time", "s", kind="seconds")]
    rows = [[format_count(int(timing["n_sets"])), format_fixed(float(timing["seconds"]), 1)]]
    return make_section("How it was computed", text, (make_table("Effort, all processes together.", columns, rows),))
