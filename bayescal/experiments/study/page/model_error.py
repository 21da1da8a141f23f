"""Errors beyond the noise: the model error τ of each leg, and errors that are functions, of legs and of sensors."""

from __future__ import annotations

import math
from collections.abc import Iterable
from functools import partial
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.figure import Figure as Drawing
from matplotlib.lines import Line2D

from bayescal.experiments.frame.results import Row
from bayescal.experiments.shared.study_schema import stem_of
from bayescal.experiments.study.page.parameters import draw_intervals, label_legs
from bayescal.experiments.study.page.results import VARIANT, StudyResults
from bayescal.experiments.study.page.styles import Styles, add_legend, assign_styles
from bayescal.report.blocks import Block, Column, Figure, Fold, Level, Section, Statement, Table, make_table
from bayescal.report.numbers import (
    MICROMETRES,
    NOTHING,
    count_decimals,
    format_fixed,
    format_significant,
    format_span,
    join_words,
)
from bayescal.report.style import GREY, INK, LEG_COLOURS
from bayescal.report.symbols import MODEL_ERROR, quote, set_parameter, split_name

TEXT = (
    "τ is the standard deviation of the model error along a leg, beyond the noise of {} and actuators. Where it is "
    "near zero the model suffices; where it is large the posterior widens all intervals instead of attributing "
    "the residuals to the geometry."
)
GAIN = "Benefit of τ: log-evidence with model error less that without; negative where the model suffices."
CAPTION = "Model error τ: posterior mean and 90 % interval of each leg and variant, a panel per deformation."
EXPLAINED = 0.9  # share from which a deformation is said to explain the error
STATED = 0.7  # share of its prior sd that is left of a scale which was stated rather than measured
LINEAR = 0.95  # share of the error from which its slopes are the whole picture
STRUCTURED = (
    "What a model leaves out is the same function of the pose every time. Each leg has such a function of the "
    "actuators' travel, zero at home, with the kernel of its variant; whether there is one is for the data to say, the "
    "prior probability being one half. Its values are in terms of the actuator: a leg that errs by 5 µm ends where it "
    "would if its actuator stood 5 µm off. A geometry that is off imitates much of it: what the measurements do not "
    "tell of an error is as wide as its scale."
)
SLOPES = (
    "Scale: what one actuator at the end of its range makes a leg err by, one standard deviation, where there is an "
    "error; left of prior: sd of its logarithm over that of its prior, near 100 % where the scale is what was stated. "
    "Surest slope: error of the leg with the actuator at the end of its range. Explained: of what is known of the "
    "linear part, by each deformation that the study knows."
)
PALE = 0.55  # share of the colours' range up to which dark numbers are read
SHARE, CERTAIN = 0.5, 0.9995
UNITS = {"um": "µm"}
INPUTS = {"reading": "what they read", "commands": "where the machine is", "order": "the order of the rows"}
FUNCTIONS = (
    "A scale that is off, an encoder that sits askew or a drift is the same function every time: of the sensor's own "
    "reading, of where the machine is, or of the order of the rows. Whether there is such an error is for the "
    "readings to say, its prior probability being one half. A geometry that is off imitates much of it, and the part "
    "of an error that the readings do not determine is as wide as its scale: the intervals hold it."
)
SCALES = (
    "Scale: what a sensor errs by at the end of its range, one standard deviation, where there is an error; left of "
    "prior: sd of its logarithm over that of its prior, near 100 % where the scale is what was stated."
)


def _bracket(words: Iterable[str]) -> str:
    """Return ``middle [low, high]``."""
    middle, low, high = words
    return f"{middle} [{low}, {high}]"


# --- the model error of each leg -------------------------------------------------------------------------------------


def show_model_error(study: StudyResults) -> Section | None:
    """Return the model error of each leg; None where no variant was computed without any."""
    if "zero" not in study.settings:
        return None
    blocks: list[Block] = [TEXT.format("targets" if study.instrument is None else "the instrument")]
    rows = study.free[study.free["symbol"] == MODEL_ERROR]
    if rows.empty:
        blocks.append(Figure("model_error", CAPTION, None, "no variant has a model error"))
    else:
        blocks += [_state_group(study, rows, group) for group in study.group(study.ranking)]
        draw = partial(_draw_model_error, rows.assign(nominal=0.0), assign_styles(study), study.tau_scale)
        blocks.append(Figure("model_error", CAPTION, draw))
        blocks.append(Fold("τ of every leg, variant by variant", (_tabulate_legs(study, rows),)))
    return Section("Model error", tuple(blocks), anchor="model-error")


def _tabulate_legs(study: StudyResults, free: pd.DataFrame) -> Table:
    """Return τ of each leg with its 90 % interval and what it adds to the evidence."""
    legs = sorted(set(free["leg"]))
    columns = [VARIANT, *(Column(f"leg {leg}" if leg else "all legs", "µm", "τ, mean [5 %, 95 %]") for leg in legs)]
    columns.append(Column("Benefit of τ", "nat"))
    rows = []
    for name in study.ranking:
        values = MICROMETRES * free[free["variant"] == name].set_index("leg")[["mean", "q05", "q95"]]
        places = min(3, count_decimals(float((values["q95"] - values["q05"]).min()))) if len(values) else 0
        found = {leg: _bracket(format_fixed(x, places) for x in row) for leg, *row in values.itertuples()}
        cells = [found.get(leg, NOTHING) for leg in legs]
        rows.append([study.label(name), *cells, format_fixed(study.gain(name), 1, sign=True)])
    return make_table("Model error of each leg.", columns, rows, [Statement(GAIN)])


def _state_group(study: StudyResults, rows: pd.DataFrame, names: list[str]) -> Statement:
    """Say how large τ is in variants that are alike, and whether the measurements call for it."""
    values = MICROMETRES * rows[rows["variant"].isin(names)]["mean"]
    span = " to ".join(dict.fromkeys(format_significant(float(x), 2) for x in (values.min(), values.max())))
    gains = [study.gain(name) for name in names]
    call, level = "needed in some", "higher or lower"
    if min(gains) > 0:
        call, level = "needed", "higher"
    elif max(gains) <= 0:
        call, level = "not needed", "lower"
    structured = any("structured_error" in study.fit(name) for name in names)
    nothing = "neither τ nor a structured error" if structured else "τ = 0"
    change = f"log-evidence {format_span([abs(x) for x in gains])} nat {level} than with {nothing}"
    return Statement(f"{study.name_variants(names)}: τ is {span} µm; it is {call} ({change}).")


def _draw_model_error(rows: pd.DataFrame, styles: Styles, prior_scale_um: float | None) -> Drawing:
    """Return the 90 % posterior intervals of the model error τ of each leg, µm: a panel per deformation."""
    deformations = list(dict.fromkeys(style.deformation for style in styles.values()))
    figure = Drawing(figsize=(9.4, 2.5))
    grid = figure.subplots(1, len(deformations), sharey=True, squeeze=False)[0]
    scale: dict[str, Any] = {"color": GREY, "linestyle": "--", "linewidth": 1.0}
    for axes, deformation in zip(grid, deformations, strict=True):
        draw_intervals(axes, rows, {n: s for n, s in styles.items() if s.deformation == deformation}, MICROMETRES)
        axes.set_title(deformation)
        label_legs(axes, rows)
        if prior_scale_um is not None:
            axes.axhline(prior_scale_um, **scale)
    others = [Line2D([], [], label="scale of the half-normal prior", **scale)] if prior_scale_um is not None else []
    grid[0].set_ylim(bottom=0)
    grid[0].set_ylabel("Model error τ (µm)")
    add_legend(figure, styles, 1.6, *others, columnspacing=1.4)
    return figure


# --- errors of legs that are functions of the pose -------------------------------------------------------------------


def show_structured(study: StudyResults) -> Section | None:
    """Return what was found of the variants whose model error has a kernel; None where none has."""
    found = {name: study.fit(name).get("structured_error") for name in study.ranking}
    with_kernel = {name: one for name, one in found.items() if one is not None}
    if not with_kernel or not study.has("structured"):
        return None
    there = {name: one for name, one in with_kernel.items() if max(one["present"]) > SHARE}
    blocks: list[Block] = [STRUCTURED]
    absent = [name for name in with_kernel if name not in there]
    if absent:
        most = max(max(with_kernel[name]["present"]) for name in absent)
        words = f"at most {format_significant(100.0 * most, 2)} %" if most >= 5e-4 else "below 0.05 %"
        text = f"{study.name_variants(absent)}: no structured error (probability of one {words})."
        blocks.append(Statement(text))
    figures = {name: _illustrate_structured(study, name, one) for name, one in there.items()}
    for name, one in list(there.items())[:1]:
        blocks += [_state_structured(study, name, one), *figures.pop(name)]
    blocks += [_tabulate_structured(study, with_kernel, there), _tabulate_sizes(study, with_kernel)]
    rest = [figure for several in figures.values() for figure in several]
    if rest:
        blocks.append(Fold("The structured errors of the other variants", tuple(rest)))
    return Section("Structured model error", tuple(blocks), anchor="structured", short="Structured")


def _tabulate_structured(study: StudyResults, found: dict[str, Any], there: dict[str, Any]) -> Table:
    """Return the errors' scales, surest slopes and what explains them."""
    known = list(dict.fromkeys(name for one in found.values() for name in one["explained"]))
    columns = [VARIANT, Column("Kernel", kind="text"), Column("Present", "%")]
    columns += [Column("Scale", "µm", "median [5 %, 95 %]"), Column("left of prior", "%")]
    columns += [Column("Surest slope", "µm", "mean [5 %, 95 %]"), Column("Linear in travel", "%")]
    columns += [Column(name, "%", "Explained by") for name in known]
    rows = []
    for name, one in found.items():
        length = f": {_format_length(one)}" if "length" in one else ""
        row = [study.label(name), f"{one['kernel']}{length}", format_fixed(100.0 * max(one["present"]), 1)]
        described = _describe_structured(one, known) if name in there else [NOTHING] * (4 + len(known))
        rows.append([*row, *described])
    return make_table("Structured errors.", columns, rows, [Statement(SLOPES)], style="wide")


def _describe_structured(one: dict[str, Any], known: list[str]) -> list[str]:
    surest, shares = one["surest"], one["explained"]
    ends = ("median_um", "q05_um", "q95_um")
    scales = [_bracket(format_fixed(scale[key], 1) for key in ends) for scale in one["scale"]]
    return [
        "; ".join(scales) or NOTHING,
        "; ".join(format_fixed(100.0 * scale["prior_sd_left"], 0) for scale in one["scale"]) or NOTHING,
        f"leg {surest['leg']}, actuator {surest['actuator']}: {_format_slope(surest)}",
        format_fixed(100.0 * one["linear_share"], 0),
        *(format_fixed(100.0 * shares[name], 0) if name in shares else NOTHING for name in known),
    ]


def _format_length(one: dict[str, Any]) -> str:
    """Return a free length with its interval in ranges of the actuators."""
    return _bracket(format_significant(one["length"][key], 2) for key in ("median", "q05", "q95"))


def _format_slope(surest: dict[str, float]) -> str:
    return _bracket(format_fixed(surest[key], 1, sign=True) for key in ("um", "q05_um", "q95_um"))


def _tabulate_sizes(study: StudyResults, found: dict[str, Any]) -> Table:
    """Return the size of every leg's error."""
    rows = [[study.label(name), *_format_sizes(one)] for name, one in found.items()]
    legs = [Column(f"leg {k}", "µm", "rms over the poses, mean [5 %, 95 %]") for k in range(1, len(rows[0]))]
    return make_table("Structured error of each leg over the calibration poses.", [VARIANT, *legs], rows, style="wide")


def _format_sizes(one: dict[str, Any]) -> list[str]:
    sizes = zip(*(one["rms_um"][key] for key in ("mean", "q05", "q95")), strict=True)
    return [_bracket(format_fixed(x, 1) for x in row) for row in sizes]


def _state_structured(study: StudyResults, name: str, one: dict[str, Any]) -> Statement:
    """Say how large a variant's structured error is, along which motion, and whether a deformation explains it."""
    sizes, surest = one["rms_um"]["mean"], one["surest"]
    leg = max(range(len(sizes)), key=lambda k: sizes[k])
    text = (
        f"{study.label(name)}, the first in the ranking with such an error: present with probability "
        f"{format_significant(100.0 * max(one['present']), 3)} %, largest in leg {leg + 1}, {_format_sizes(one)[leg]} "
        f"µm rms. Its surest motion: actuator {surest['actuator']} at the end of its range moves leg {surest['leg']} "
        f"by {_format_slope(surest)} µm; {format_fixed(100.0 * one['linear_share'], 0)} % of the error is linear in "
        "the travel. "
    )
    shares: dict[str, float] = one["explained"]
    if shares:
        words = [f"a {key} deformation explains {format_fixed(100.0 * x, 0)} % of it" for key, x in shares.items()]
        best = max(shares, key=lambda key: shares[key])
        end = f"try {best}" if shares[best] >= EXPLAINED else "no known deformation explains it"
        text += f"Of what is known of its linear part, {' and '.join(words)}: {end}. "
    if "length" in one:
        left = format_fixed(100.0 * one["length"]["prior_sd_left"], 0)
        text += (
            f"It changes over {_format_length(one)} ranges of the actuators; {left} % of the standard deviation that "
            "the length's logarithm has under its prior is left. "
        )
    if one["scale"]:
        most = max(scale["prior_sd_left"] for scale in one["scale"])
        share = f"{format_fixed(100.0 * most, 0)} % of its prior's standard deviation is left"
        text += (
            f"Its scale rests on the prior, not on the measurements: {share}; so do intervals that hang on it."
            if most > STATED
            else f"The measurements tell its scale: {share}."
        )
    return Statement(text)


def _illustrate_structured(study: StudyResults, name: str, one: dict[str, Any]) -> list[Figure]:
    """Return the slopes and sizes of a variant's error, and its course where slopes are not the whole of it."""
    label, stem = study.label(name), stem_of(name)
    caption = (
        f"{label}: error of each leg (row) with one actuator (column) at the end of its range, mean ± sd in µm, and "
        "the size of each leg's error over the calibration poses with its 90 % interval."
    )
    figures = [Figure(f"structured-{stem}", caption, partial(_draw_slopes, one))]
    if one["linear_share"] < LINEAR:
        caption = (
            f"{label}: structured error of every leg at the poses against the travel of the actuator that tells most "
            "of it, with 90 % intervals; full: calibration, open: verification. What scatters about a line is the "
            "other actuators' part."
        )
        draw = partial(_draw_course, study.table("structured", name))
        figures.append(Figure(f"structured-course-{stem}", caption, draw))
    return figures


def _draw_slopes(one: dict[str, Any]) -> Drawing:
    """Return the matrix of slopes, leg by actuator, and the size of each leg's error."""
    slopes, sd = np.array(one["slope_um"]), np.array(one["slope_sd_um"])
    n_legs = len(slopes)
    figure = Drawing(figsize=(9.4, 0.9 + 0.36 * n_legs))
    left, right = figure.subplots(1, 2, gridspec_kw={"width_ratios": (2.2, 1.0)})
    top = float(np.abs(slopes).max()) or 1.0
    left.imshow(slopes, cmap="RdBu_r", vmin=-top, vmax=top, aspect="auto")
    for i, j in np.ndindex(*slopes.shape):
        text = f"{format_fixed(float(slopes[i, j]), 0, sign=True)} ± {format_fixed(float(sd[i, j]), 0)}"
        colour = INK if abs(slopes[i, j]) < PALE * top else "white"
        left.text(j, i, text, ha="center", va="center", fontsize=8, color=colour)
    left.set_xticks(range(n_legs), [f"actuator {k + 1}" for k in range(n_legs)])
    left.set_yticks(range(n_legs), [f"leg {k + 1}" for k in range(n_legs)])
    left.tick_params(length=0)
    left.spines[:].set_visible(False)
    left.set_title("Error with the actuator at the end of its range (µm)")
    mean, low, high = (np.array(one["rms_um"][key]) for key in ("mean", "q05", "q95"))
    right.errorbar(mean, range(n_legs), xerr=[mean - low, high - mean], fmt="o", color=INK, markersize=4)
    right.set_ylim(n_legs - 0.5, -0.5)
    right.set_yticks(range(n_legs), [f"leg {k + 1}" for k in range(n_legs)])
    right.set_xlim(left=0.0)
    right.grid(axis="x")
    right.set_title("Size over the poses (µm, rms)")
    return figure


def _draw_course(rows: pd.DataFrame) -> Drawing:
    """Return a panel per leg: error in µm with its 90 % interval against the travel of one actuator."""
    legs = sorted(set(rows["leg"]))
    n_rows = math.ceil(len(legs) / 3)
    figure = Drawing(figsize=(9.4, 0.4 + 1.9 * n_rows))
    grid = figure.subplots(n_rows, 3, squeeze=False, sharey=True)
    for axes, leg in zip(grid.ravel(), legs, strict=False):
        own = rows[rows["leg"] == leg]
        for use, fill in (("calibration", INK), ("verification", "white")):
            part = own[own["use"] == use]
            around = [part["mean_um"] - part["low_um"], part["high_um"] - part["mean_um"]]
            axes.errorbar(
                part["travel_mm"],
                part["mean_um"],
                [one.clip(lower=0.0) for one in around],
                fmt="o",
                color=INK,
                ecolor=GREY,
                markersize=3.5,
                markerfacecolor=fill,
                linewidth=0.8,
            )
        axes.axhline(0.0, color=GREY, linewidth=0.8)
        axes.set_title(f"leg {leg}")
        axes.set_xlabel(f"travel of actuator {int(own['actuator'].iloc[0])} (mm)")
    for axes in grid[:, 0]:
        axes.set_ylabel("error (µm)")
    for axes in grid.ravel()[len(legs) :]:
        axes.set_axis_off()
    return figure


# --- errors of sensors that are functions ----------------------------------------------------------------------------


def _title_functions(study: StudyResults) -> dict[str, str]:
    """Return titles of the variants whose sensors may have such errors, by name."""
    rows = study.table("variants")
    own = rows[rows["variant"].isin(study.table("functions")["variant"])]
    return dict(zip(own["variant"].astype(str), own["title"].astype(str), strict=True))


def state_functions(study: StudyResults) -> list[Statement]:
    """Return in a sentence for each variant which sensors err by how much."""
    found = _title_functions(study) if study.has("functions") else {}
    return [_judge_functions(title, study.rows("functions", name)) for name, title in found.items()]


def _judge_functions(title: str, rows: list[Row]) -> Statement:
    kinds: dict[tuple[str, str], list[Row]] = {}
    for row in rows:
        kinds.setdefault((split_name(str(row["sensor"]))[0], INPUTS[row["of"]]), []).append(row)
    parts = []
    level: Level = "good"
    for (kind, of), own in kinds.items():
        largest = max(own, key=lambda row: row["rms"])
        present = max(row["present"] for row in own)
        percent = "above 99.9 %" if present > CERTAIN else f"{format_fixed(100.0 * present, 1)} %"
        if present > SHARE:
            level = "warning"
            size = f"{format_significant(largest['rms'], 2)} {_name_unit(largest)} rms"
            text = f"err by functions of {of} (probability {percent}), {largest['sensor']} most, {size}"
        else:
            text = f"need none of {of} (probability {percent})"
        parts.append(f"sensors {kind} {text}")
    return Statement(f"“{title}”: {join_words(parts)}.", level, "Sensors' errors")


def _name_unit(row: Row) -> str:
    return UNITS.get(str(row["unit"]), str(row["unit"]))


def show_functions(study: StudyResults) -> Section | None:
    """Return whether sensors err by functions, how large these are and of what; None where no variant has any."""
    if not study.has("functions"):
        return None
    titles = _title_functions(study)
    columns = [Column("Variant", kind="text"), Column("Kernel", kind="text"), Column("Sensor", kind="text")]
    columns += [Column("Function of", kind="text")]
    columns += [Column("Unit", kind="text"), Column("Present", "%"), Column("Scale stated"), Column("Scale found")]
    columns += [Column("left of prior", "%"), Column("Size", "rms over the poses, mean [5 %, 95 %]")]
    rows = [
        [
            titles[str(row["variant"])],
            str(row["kernel"]),
            str(row["sensor"]),
            INPUTS[row["of"]].replace("they read", "it reads"),
            _name_unit(row),
            format_fixed(100.0 * row["present"], 1),
            format_significant(row["scale_stated"]),
            format_significant(row["scale"], 2),
            format_significant(100.0 * row["left"], 2),
            _bracket(format_significant(row[key], 2) for key in ("rms", "rms_low", "rms_high")),
        ]
        for row in study.rows("functions")
    ]
    table = make_table("Sensors' errors that are functions.", columns, rows, [Statement(SCALES)], style="wide")
    blocks: list[Block] = [FUNCTIONS, table]
    for name, title in titles.items():
        own = study.table("function_curves", name)
        caption = f"{title}: errors over what they depend on, mean and 90 % interval."
        blocks += [] if own.empty else [Figure(f"functions_{stem_of(name)}", caption, partial(_draw_functions, own))]
    return Section("Errors that are functions", tuple(blocks))


def _draw_functions(curves: pd.DataFrame) -> Drawing:
    """Return a panel for each kind of sensor and input: errors with their 90 % intervals over what they depend on."""
    kinds: dict[tuple[str, str], list[str]] = {}
    for sensor, of in dict.fromkeys(zip(curves["sensor"].astype(str), curves["of"].astype(str), strict=True)):
        kinds.setdefault((split_name(sensor)[0], of), []).append(sensor)
    n_rows = math.ceil(len(kinds) / 2)
    figure = Drawing(figsize=(9.4, 0.4 + 2.8 * n_rows))
    grid = figure.subplots(n_rows, 2, squeeze=False).ravel()
    for axes, ((kind, of), sensors) in zip(grid, kinds.items(), strict=False):
        for k, sensor in enumerate(sensors):
            own, colour = curves[(curves["sensor"] == sensor) & (curves["of"] == of)], LEG_COLOURS[k % len(LEG_COLOURS)]
            axes.fill_between(own["reading"], own["low"], own["high"], color=colour, alpha=0.2, linewidth=0.0)
            axes.plot(own["reading"], own["mean"], color=colour, label=set_parameter(sensor))
        unit = str(curves[curves["sensor"] == sensors[0]]["unit"].iloc[0])
        axes.axhline(0.0, color=GREY, linewidth=0.8)
        inner = {"um": "mm", "arcsec": "rad"}.get(unit, unit)
        axes.set_xlabel(f"reading of {quote(kind)} ({inner})" if of == "reading" else "row")
        axes.set_ylabel(f"error of {quote(kind)} ({UNITS.get(unit, unit)})")
        axes.legend(ncols=2)
    for axes in grid[len(kinds) :]:
        axes.set_axis_off()
    return figure
