"""Errors that are functions with a stated scale: of a leg's travel, of what a sensor reads, of the rows' order."""

from __future__ import annotations

import math
from functools import partial
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.figure import Figure as Drawing

from bayescal.experiments.frame.results import Row
from bayescal.experiments.shared.study_schema import stem_of
from bayescal.experiments.study.page.model_error import bracket, draw_errors
from bayescal.experiments.study.page.results import VARIANT, StudyResults
from bayescal.report.blocks import Block, Column, Figure, Fold, Level, Section, Statement, Table, make_table
from bayescal.report.numbers import NOTHING, format_fixed, format_significant, join_words
from bayescal.report.style import GREY, INK, LEG_COLOURS
from bayescal.report.symbols import quote, set_parameter, split_name

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
    scales = [bracket(format_fixed(scale[key], 1) for key in ends) for scale in one["scale"]]
    return [
        "; ".join(scales) or NOTHING,
        "; ".join(format_fixed(100.0 * scale["prior_sd_left"], 0) for scale in one["scale"]) or NOTHING,
        f"leg {surest['leg']}, actuator {surest['actuator']}: {_format_slope(surest)}",
        format_fixed(100.0 * one["linear_share"], 0),
        *(format_fixed(100.0 * shares[name], 0) if name in shares else NOTHING for name in known),
    ]


def _format_length(one: dict[str, Any]) -> str:
    """Return a free length with its interval in ranges of the actuators."""
    return bracket(format_significant(one["length"][key], 2) for key in ("median", "q05", "q95"))


def _format_slope(surest: dict[str, float]) -> str:
    return bracket(format_fixed(surest[key], 1, sign=True) for key in ("um", "q05_um", "q95_um"))


def _tabulate_sizes(study: StudyResults, found: dict[str, Any]) -> Table:
    """Return the size of every leg's error."""
    rows = [[study.label(name), *_format_sizes(one)] for name, one in found.items()]
    legs = [Column(f"leg {k}", "µm", "rms over the poses, mean [5 %, 95 %]") for k in range(1, len(rows[0]))]
    return make_table("Structured error of each leg over the calibration poses.", [VARIANT, *legs], rows, style="wide")


def _format_sizes(one: dict[str, Any]) -> list[str]:
    sizes = zip(*(one["rms_um"][key] for key in ("mean", "q05", "q95")), strict=True)
    return [bracket(format_fixed(x, 1) for x in row) for row in sizes]


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
    panels = {f"leg {leg}": rows[rows["leg"] == leg] for leg in sorted(set(rows["leg"]))}
    labels = {title: f"travel of actuator {int(own['actuator'].iloc[0])} (mm)" for title, own in panels.items()}
    return draw_errors(panels, "travel_mm", labels)


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
            bracket(format_significant(row[key], 2) for key in ("rms", "rms_low", "rms_high")),
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
