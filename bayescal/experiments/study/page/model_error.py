"""What a model leaves out beside the noise: what to do, how large it is, in which channel, along what.

From three tables of the results: `model_error` has the size of each term, `model_error_members` how much of it is in
which channel, `model_error_poses` the errors pose by pose; and where each leg has a τ of its own, its posterior.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from functools import partial
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from matplotlib.figure import Figure as Drawing
from matplotlib.lines import Line2D
from scipy.stats import chi2

from bayescal.experiments.frame.results import Row
from bayescal.experiments.shared.headline import say_odds
from bayescal.experiments.shared.hidden import show_hidden
from bayescal.experiments.study.page.parameters import draw_intervals, label_members
from bayescal.experiments.study.page.results import INDEPENDENT, TERMS, TOGETHER, VARIANT, StudyResults
from bayescal.experiments.study.page.styles import Styles, add_legend, assign_styles
from bayescal.limits import LASTING, UNSEEN_UM
from bayescal.numerics.heavy_tails import HARDLY
from bayescal.report.blocks import Block, Column, Figure, Fold, Section, Statement, Table, make_table
from bayescal.report.numbers import (
    MICROMETRES,
    NOTHING,
    count_decimals,
    format_fixed,
    format_plain,
    format_significant,
    join_words,
)
from bayescal.report.style import GREY, INK
from bayescal.report.symbols import MODEL_ERROR, quote

LEAD = "Model error"
TAU = (
    "τ is the standard deviation of what differs from pose to pose, beyond the stated noise. Where it is near zero the "
    "model suffices; where it is large the posterior widens all intervals instead of attributing the residuals to the "
    "geometry. What repeats with the pose goes into the geometry all the same."
)
CAPTION = "Model error τ: posterior mean and 90 % interval of each {member} and variant."


class Kind(NamedTuple):
    """What a term of the model error stands for: along what it changes, what usually causes it, what to do."""

    along: str
    causes: str
    advice: str


KINDS: dict[str, Kind] = {
    "independent": Kind(
        "different at every pose",
        "play, repeatability, a noise that is stated too small",
        "Measure one pose several times: what scatters there is noise or play",
    ),
    "linear": Kind(
        "linear in the positions of all actuators",
        "a coupling: one actuator moves what another one positions; a frame that yields",
        "Look for a coupling between actuators, or free parameters of one (of legs: a deformation with a free matrix)",
    ),
    "own": Kind(
        "a function of the own position",
        "a lead error, the scale of an encoder, an encoder or a screw that is eccentric",
        "Check lead, scale and eccentricity of the encoder of {member}, or {gain}",
    ),
    "smooth": Kind(
        "a smooth function of the positions",
        "bending, joints, guides that are not straight",
        "Compare a model with joints that err or parts that bend, and measure more poses",
    ),
    "drift": Kind(
        "with time, in measuring order",
        "temperature, settling",
        "Let the machine warm up and return to one pose now and then: what changes there is drift",
    ),
    "lead": Kind(
        "linear in the own position",
        "a lead error, the scale of an encoder",
        "Check lead and encoder scale of {member}, or {gain}",
    ),
    "joints": Kind(
        "quadratic in the pose, in each channel another",
        "joints whose axes do not meet, or that run out",
        "Look at the joints of {member}, or compare a model with joints that err",
    ),
    "gravity": Kind(
        "a function of the pose, alike in all channels",
        "weight that bends frame or guides, an instrument that is off by a scale",
        "Measure with another load: what changes bends under its weight",
    ),
}
DIRECTIONS = ("lead", "joints", "gravity")
"""Causes that have no term of their own and are tried by themselves."""
NESTED = {"own", "lead"}
"""A cause and a part of it: neither is a rival of the other."""
NO_TRACE = (0.10, 0.32, 0.46, 0.56)
"""Lower end of a 90 % interval over the median of the size of one to four terms together without any trace of them:
each is then about flat from zero to what the data allow, and several together are never near zero."""
BEYOND = 0.26
"""Share of the way from there to one, from which on the data show an error: of one term at a third of the median."""
UNDECIDED = (
    "Measure more poses, and some again at another time: what differs there is drift, what repeats goes with the pose"
)
CLEAR = 3.0
"""Nats by which one term alone has to be better than any other alone to be named, and all together than each alone."""
OUTSTANDING = 2.5  # times the median of the others, from which on one member is named
WHY = (
    "What a model leaves out is systematic: it repeats with the pose, and the geometry imitates a part of it. Without "
    "a model error the parameters take that up, and their intervals are too narrow. So each channel has the terms "
    "above beside its noise, each a random function whose size is found with the geometry. Of terms that imitate each "
    "other only the sum is well known. Errors are what the channel moves the tool by."
)
SIZES = (
    "Size: rms over the calibration poses, median and 90 % interval. An error is said to be seen where the lower end "
    "of the interval is at least a third of the median; of several terms together, which are never near zero, up to "
    "two thirds."
)
ALONE = (
    "Alone: log-evidence of this sort of systematic errors and no other, less that of all together. What stands “by "
    "itself” takes no part in these, and has the size that it would have without them. One cause is named "
    "where it explains the data as well as all together and 20 to 1 better than any other alone."
)
NO_FLOOR = (
    "An error that the parameters can imitate leaves no trace in any data. None is allowed for beyond what the terms "
    "above suggest: if one of some size cannot be excluded, state it (at_least_um in [model_error])."
)
FLOOR = (
    "An error that the parameters can imitate leaves no trace in any data: as stated (at_least_um), {} are allowed for "
    "even where none is seen."
)
MEMBERS = "Rms over the calibration poses of the posterior mean: what is known of the error's course."
POSES = (
    "{label}: systematic error of each channel at the poses in the order of the data, with 90 % intervals; full: "
    "calibration, open: verification."
)
MOST_PANELS, ABREAST = 12, 3


def bracket(words: Iterable[str]) -> str:
    """Return ``middle [low, high]``."""
    middle, low, high = words
    return f"{middle} [{low}, {high}]"


def show_model_error(study: StudyResults) -> Section | None:
    """Return what was found of the model error; None where no variant has terms."""
    described = _list_described(study)
    return Section(LEAD, tuple(_show_terms(study, described)), anchor="model-error") if described else None


# --- terms of the model error ----------------------------------------------------------------------------------------


def _list_described(study: StudyResults) -> list[str]:
    """Return the variants with a model error in terms, that to use first."""
    return [name for name in dict.fromkeys([study.chosen, *study.names]) if study.list_terms(name)]


def name_cause(alone: Mapping[str, float]) -> str:
    """Return which one alone is as good as all together, to a nat, and clearly better than any other; empty: none."""
    first = max(alone, key=lambda name: alone[name], default="")
    return first if first and alone[first] > -1.0 and measure_lead(alone, first) >= CLEAR else ""


def measure_lead(alone: Mapping[str, float], first: str) -> float:
    """Return by how many nats one cause alone explains more than any other that is not a part of it; 0 without any."""
    others = [one for name, one in alone.items() if name != first and {name, first} != NESTED]
    return alone[first] - max(others) if others else 0.0


class _Found(NamedTuple):
    """What was found of one variant's model error.

    Rows of its table by term; rms of each member's mean; evidence of each cause alone less that of all, nat, and
    rows of the sizes of those without a term; the least size of each term that is stated; of how many τ its random
    errors are; the unit of sizes; the parameter that is the gain of each channel.
    """

    label: str
    sizes: dict[str, Row]
    members: dict[str, float]
    alone: dict[str, float]
    directions: dict[str, Row]
    floors: dict[str, float]
    n_taus: int
    unit: str
    gains: Mapping[str, str] | None  # of each channel; None of results that do not say

    @property
    def functions(self) -> dict[str, Row]:
        """The terms of systematic errors, the largest first."""
        own = {name: row for name, row in self.sizes.items() if name not in (INDEPENDENT, TOGETHER)}
        return dict(sorted(own.items(), key=lambda item: -item[1]["median_um"]))

    @property
    def whole(self) -> Row | None:
        """The size of all systematic errors together; of the one cause that explains all, where it has no term."""
        return self.directions.get(self.cause) or self.sizes.get(TOGETHER) or next(iter(self.functions.values()), None)

    @property
    def cause(self) -> str:
        """What alone is as good as all together and better than any other alone; empty where nothing is."""
        first = name_cause(self.alone)
        return first if first in (*self.functions, *DIRECTIONS) else ""

    @property
    def rivals(self) -> list[str]:
        """What alone is about as good as all together, largest first, where nothing is to be named."""
        best = max(self.alone.values(), default=-math.inf)
        near = [name for name in (*self.functions, *DIRECTIONS) if self.alone.get(name, -math.inf) > best - CLEAR]
        if NESTED.issubset(near):
            near.remove(min(NESTED, key=lambda name: self.alone[name]))
        return near if best >= -CLEAR and not self.cause and len(near) > 1 else []

    @property
    def seen(self) -> list[str]:
        """The terms of which the data show an error."""
        seen = [name for name in self.functions if is_seen(self.beyond(name), NO_TRACE[0])]
        return [*seen, INDEPENDENT] if is_seen(self.beyond(INDEPENDENT), _measure_no_trace(self.n_taus)) else seen

    def beyond(self, name: str) -> Mapping[str, Any] | None:
        """Return the size of a term, or of all together, beyond what is stated; None where there is no such term."""
        size, floor = self.sizes.get(name), self.floors.get(name, 0.0)
        if size is None or not floor:
            return size
        return {key: math.sqrt(max(0.0, size[key] ** 2 - floor**2)) for key in ("median_um", "q05_um", "q95_um")}

    @property
    def is_seen_together(self) -> bool:
        """Whether the data show systematic errors, of whatever sort: by their size, or by evidence against none."""
        if self.alone.get("none", 0.0) < -CLEAR:
            return True
        name = TOGETHER if TOGETHER in self.sizes else next(iter(self.functions), "")
        return is_seen(self.beyond(name), NO_TRACE[min(max(len(self.functions), 1), len(NO_TRACE)) - 1])


def is_seen(size: Mapping[str, Any] | None, without: float) -> bool:
    """Whether the data show an error of that size: its lower end is not as near to zero as the prior has it.

    ``without`` is the lower end over the median where the data show none.
    """
    least = without + BEYOND * (1.0 - without)
    return size is not None and bool(size["q05_um"] >= least * size["median_um"] > 0.0)


def _measure_no_trace(n_taus: int) -> float:
    """Return the same share of the rms of so many τ, each with a half-normal prior, as `NO_TRACE` has it of terms."""
    low, middle = chi2.ppf([0.05, 0.5], max(n_taus, 1))
    return math.sqrt(low / middle)


def _find(study: StudyResults, name: str) -> _Found:
    poses = study.table("model_error_poses", name)
    calibration = poses[poses["use"] == "calibration"]
    square = (calibration["mean_um"] ** 2).groupby(calibration["member"], sort=False).mean()
    members = {str(member): math.sqrt(value) for member, value in square.items()}
    sizes = {row["term"]: row for row in study.rows("model_error", name)}
    alone = {row["term"]: row for row in study.rows("model_error_alone", name)}
    directions = {term: row for term, row in alone.items() if term in DIRECTIONS}
    floors = _list_floors(study, name)
    floors |= {TOGETHER: math.sqrt(sum(one**2 for term, one in floors.items() if term != INDEPENDENT))}
    odds = {term: float(row["log_odds"]) for term, row in alone.items()}
    rows = study.parameters
    n_taus = int(((rows["variant"] == name) & (rows["symbol"] == MODEL_ERROR)).sum())
    unit, gains = study.error_unit, study.summary.get("gains")
    return _Found(study.label(name), sizes, members, odds, directions, floors, n_taus, unit, gains)


def _list_floors(study: StudyResults, name: str) -> dict[str, float]:
    """Return the least size of each term of a variant that is stated, in the unit of errors."""
    stated, terms = study.config.get("model_error", {}).get("at_least_um", 0.0), study.list_terms(name)
    factor = study.error_factor
    if isinstance(stated, dict):
        return {term: factor * float(size) for term, size in stated.items() if size > 0.0 and term in terms}
    lasting = [term for term in LASTING if term in terms]
    return {term: factor * stated / math.sqrt(len(lasting)) for term in lasting if stated > 0.0}


def state_terms(study: StudyResults) -> list[Statement]:
    """Return in a sentence what the model of the variant to use leaves out, and what to do about it."""
    described = _list_described(study)
    if not described:
        return []
    found = _find(study, described[0])
    return [_advise(found), *_state_open_sizes(found)]


def _state_open_sizes(found: _Found) -> list[Statement]:
    """Say of which systematic errors the size is hardly determined, so that a few draws make its mean square."""
    tails = {name: float(row.get("tail", math.nan)) for name, row in found.functions.items()}
    open_ones = {name: tail for name, tail in tails.items() if tail > HARDLY}
    if not open_ones:
        return []
    what = join_words([KINDS[name].along for name in open_ones], "or")
    text = (
        f"These data hardly determine how large an error is that is {what}. Accuracies count the half-width of its "
        "90 % interval over 1.645: the standard deviation, which a few draws make, would be "
        f"{format_significant(max(open_ones.values()), 2)} times as large."
    )
    return [Statement(text, lead=LEAD)]


def _advise(found: _Found) -> Statement:
    """Say what to do, how large the systematic error is, in which channel and along what."""
    seen = [name for name in found.seen if name in found.functions]
    # terms that imitate each other: only their sum is known; and one cause alone may be seen where all together are not
    if not seen and (found.is_seen_together or found.cause):
        seen = list(found.functions)
    if not seen or found.whole is None:
        scatters = INDEPENDENT in found.seen
        first = f"{KINDS[INDEPENDENT].advice}. " if scatters else ""
        return Statement(f"{first}{_describe_absent(found)}", "plain" if scatters else "good", LEAD)
    main, outstanding = KINDS[found.cause or seen[0]], _name_outstanding(found)
    named = main.advice.format(member=outstanding or "every channel", gain=_name_gain(found, outstanding))
    advice = UNDECIDED if found.rivals else named
    members = "" if found.cause in found.directions and found.cause not in NESTED else f", {_describe_members(found)}"
    text = (
        f"{advice}. {found.label} leaves out a "
        f"systematic error of {_format_size(found.whole)} {found.unit} rms (90 % interval){members}; "
        f"{_describe_cause(found, main)}. The intervals allow for it. {_describe_independent(found)}"
    )
    return Statement(text.rstrip(), lead=LEAD)


def _describe_cause(found: _Found, main: Kind) -> str:
    """Say along what the largest part changes, and whether that alone explains all."""
    if found.cause:
        lead = measure_lead(found.alone, found.cause)
        return f"all of it may be {main.along} ({main.causes}), {say_odds(lead)} against any other single cause"
    if found.rivals:
        rivals = [KINDS[name].along for name in found.rivals]
        return f"whether it is {join_words(rivals, 'or')} the data do not say"
    text = f"the largest part is {main.along} ({main.causes})"
    several = found.alone and max(found.alone.values()) < -CLEAR
    return f"{text}, but no single cause explains all of it" if several else text


def _describe_absent(found: _Found) -> str:
    """Say that no systematic error is seen, and up to which size there may be one."""
    if found.whole is None:
        text = f"{found.label} has no term for systematic errors: its intervals do not allow for them."
    else:
        most, stated = (format_significant(one, 2) for one in (found.whole["q95_um"], found.floors[TOGETHER]))
        seen = f"is seen (95 % upper limit {most} {found.unit} rms over all channels)"
        if found.floors[TOGETHER]:
            seen = f"beyond the {stated} {found.unit} rms that are stated is seen; the intervals allow for these"
        text = f"{found.label}: no systematic error {seen}."
    return f"{text} {_describe_independent(found)}".rstrip()


def _describe_independent(found: _Found) -> str:
    """Say how large random errors from pose to pose are; nothing where there is no term for them."""
    size = found.sizes.get(INDEPENDENT)
    if size is None:
        return ""
    if INDEPENDENT in found.seen:
        return f"Random errors from pose to pose have τ = {_format_size(size)} {found.unit} beyond the noise."
    most = format_significant(size["q95_um"], 2)
    return f"No random error from pose to pose is seen beyond the noise (τ: 95 % upper limit {most} {found.unit})."


def _name_outstanding(found: _Found) -> str:
    """Return the channel that errs much more than the others; nothing where none does."""
    ranked = sorted(found.members, key=lambda name: -found.members[name])
    others = [found.members[name] for name in ranked[1:]]
    return ranked[0] if others and found.members[ranked[0]] > OUTSTANDING * float(np.median(others)) else ""


def _name_gain(found: _Found, outstanding: str) -> str:
    """Return how the gain of a channel, or those of all of them, are freed; the parameter has the name that it has."""
    if found.gains is None:
        return "free them as parameters"
    names = [found.gains.get(one, "") for one in ([outstanding] if outstanding else found.members)]
    if not all(names):
        return "give the machine's class a factor on what it reads as a parameter, and free that"
    symbols = list(dict.fromkeys(one if outstanding else one.partition("[")[0] for one in names))
    return f"free {join_words(symbols)} in [parameters]"


def _describe_members(found: _Found) -> str:
    """Return in which legs or channels an error is."""
    outstanding = _name_outstanding(found)
    others = [size for name, size in found.members.items() if name != outstanding]
    span = " to ".join(dict.fromkeys(format_significant(one, 2) for one in (min(others), max(others))))
    if outstanding:
        most = format_significant(found.members[outstanding], 2)
        return f"most of it in {outstanding} ({most} {found.unit} rms, the others {span} {found.unit})"
    return f"in all channels ({span} {found.unit} rms each)" if len(others) > 1 else f"in {next(iter(found.members))}"


def _format_size(size: Mapping[str, Any]) -> str:
    """Return the median of a size with its 90 % interval, to the second digit of the median."""
    places = count_decimals(float(size["median_um"]))
    return bracket(format_fixed(size[key], places) for key in ("median_um", "q05_um", "q95_um"))


def _show_terms(study: StudyResults, described: list[str]) -> list[Block]:
    """Return what to do, how sure that is and why, of the variant to use; of the others the sizes, folded."""
    name, *others = described
    found = _find(study, name)
    blocks: list[Block] = [_advise(found), _tabulate_terms(found)]
    rows = study.table("model_error_poses", name)
    if found.members:
        most = sorted(found.members, key=lambda member: -found.members[member])[:MOST_PANELS]
        chosen = [member for member in found.members if member in most]
        caption = POSES.format(label=found.label)
        if len(chosen) < len(found.members):
            caption += f" Shown are the {len(chosen)} that err most."
        place = rows.assign(place=rows.groupby("member").cumcount() + 1)
        panels = {member: place[place["member"] == member] for member in chosen}
        draw = partial(_draw_errors, panels, study.error_unit)
        blocks.append(Figure("model_error", caption, draw))
    if found.functions:
        blocks.append(WHY)
    if INDEPENDENT in found.sizes:
        blocks += [TAU, *_show_tau(study)]
    by_member = study.table("model_error_members", name)
    if len(by_member):
        blocks.append(_tabulate_members(found, by_member))
    blocks += _show_floor(study, name)
    if others:
        blocks.append(Fold("The model error of the other variants", (_tabulate_variants(study, described),)))
    return blocks


def _tabulate_terms(found: _Found) -> Table:
    """Return the size of each term, along what it changes and what usually causes it."""
    columns = [Column("Along what", kind="text"), Column("Size", f"{found.unit} rms", "median [5 %, 95 %]")]
    columns += [Column("Alone", "nat")] if found.alone else []
    columns += [Column("In the data", kind="text"), Column("Usual causes", kind="text")]
    rows = []
    for name, size in found.sizes.items():
        along, causes = (KINDS[name].along, KINDS[name].causes) if name in KINDS else ("systematic errors together", "")
        there = found.is_seen_together if name == TOGETHER else name in found.seen
        alone = [format_fixed(found.alone.get(name, math.nan), 1, sign=True)] if found.alone else []
        trace = "as stated" if found.floors.get(name) else "no trace"
        rows.append([along, _format_size(size), *alone, "seen" if there else trace, causes])
    for name, size in found.directions.items():
        along, trace = KINDS[name].along, "seen" if name == found.cause else ""
        alone = [format_fixed(found.alone[name], 1, sign=True)]
        rows.append([f"{along}, by itself", _format_size(size), *alone, trace, KINDS[name].causes])
    if "none" in found.alone:
        rows.append(["no systematic error", NOTHING, format_fixed(found.alone["none"], 1, sign=True), "", ""])
    notes = [Statement(SIZES), *([Statement(ALONE)] if found.alone else [])]
    return make_table(f"Model error of {found.label}.", columns, rows, notes)


def _show_floor(study: StudyResults, name: str) -> list[Block]:
    """Say what errors that leave no trace would hide, and which of them are allowed for."""
    stated, floors = study.config.get("model_error", {}).get("at_least_um", 0.0), _list_floors(study, name)
    unit = study.error_unit
    sizes = [f"{format_plain(size)} {unit} rms {KINDS[term].along}" for term, size in floors.items()]
    if floors and not isinstance(stated, dict):
        sizes = [f"{format_plain(study.error_factor * stated)} {unit} rms"]
    if not study.has("model_error_hidden"):
        return [Statement(FLOOR.format(join_words(sizes)) if sizes else NO_FLOOR)]
    size = join_words(sizes) if sizes else f"{format_plain(study.error_factor * UNSEEN_UM)} {unit} rms"
    return show_hidden(study.table("model_error_hidden", name), size, bool(sizes), study.shown_in)


def _tabulate_members(found: _Found, rows: pd.DataFrame) -> Table:
    """Return how much of each term is in which channel."""
    wide = rows.pivot(index="member", columns="term", values="rms_um")
    terms = [name for name in TERMS if name in wide.columns]
    columns = [Column("", kind="text"), *(Column(KINDS[name].along, found.unit) for name in terms)]
    columns.append(Column("all", found.unit))
    cells = [
        [member, *(format_significant(wide[name].get(member), 2) for name in terms), format_significant(size, 2)]
        for member, size in found.members.items()
    ]
    return make_table(f"In which channel. {MEMBERS}", columns, cells, style="wide")


def _tabulate_variants(study: StudyResults, names: list[str]) -> Table:
    """Return the sizes of the terms of every variant."""
    there = {row["term"] for name in names for row in study.rows("model_error", name)}
    terms = [term for term in (*TERMS, TOGETHER) if term in there]
    columns = [VARIANT, *(Column(term, f"{study.error_unit} rms", "median [5 %, 95 %]") for term in terms)]
    rows = []
    for name in names:
        sizes = {row["term"]: _format_size(row) for row in study.rows("model_error", name)}
        rows.append([study.label(name), *(sizes.get(term, NOTHING) for term in terms)])
    return make_table("Model error by variant.", columns, rows, style="wide")


def _draw_errors(panels: Mapping[str, pd.DataFrame], unit: str) -> Drawing:
    """Return a panel for each channel: errors with their 90 % intervals over the poses in order."""
    n_rows = math.ceil(len(panels) / ABREAST)
    figure = Drawing(figsize=(9.4, 0.4 + 1.9 * n_rows))
    grid = figure.subplots(n_rows, ABREAST, squeeze=False, sharey=True)
    for axes, (title, own) in zip(grid.ravel(), panels.items(), strict=False):
        for use, fill in (("calibration", INK), ("verification", "white")):
            part = own[own["use"] == use]
            around = [part["mean_um"] - part["low_um"], part["high_um"] - part["mean_um"]]
            axes.errorbar(
                part["place"],
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
        axes.set_title(quote(title))
        axes.set_xlabel("pose")
    for axes in grid[:, 0]:
        axes.set_ylabel(f"error ({unit})")
    for axes in grid.ravel()[len(panels) :]:
        axes.set_axis_off()
    return figure


# --- τ of each leg ---------------------------------------------------------------------------------------------------


def _show_tau(study: StudyResults) -> list[Block]:
    """Return τ leg by leg where each has its own."""
    rows = study.parameters[(study.parameters["symbol"] == MODEL_ERROR) & (study.parameters["leg"] > 0)]
    if rows.empty:
        return []
    seen = set(rows["variant"])
    styles = {name: style for name, style in assign_styles(study).items() if name in seen}
    draw = partial(
        _draw_tau,
        rows.assign(nominal=0.0),
        styles,
        study.tau_scale,
        study.member,
        (MICROMETRES * study.error_factor, study.error_unit),
    )
    table = _tabulate_tau(study, rows)
    return [
        Figure("tau", CAPTION.format(member=study.member), draw),
        Fold(f"τ of every {study.member}, variant by variant", (table,)),
    ]


def _tabulate_tau(study: StudyResults, rows: pd.DataFrame) -> Table:
    """Return τ of each leg with its 90 % interval."""
    legs = sorted(set(rows["leg"]))
    columns = [VARIANT, *(Column(f"{study.member} {leg}", study.error_unit, "τ, mean [5 %, 95 %]") for leg in legs)]
    cells = []
    for name in study.names:
        values = (
            MICROMETRES * study.error_factor * rows[rows["variant"] == name].set_index("leg")[["mean", "q05", "q95"]]
        )
        if values.empty:
            continue
        places = min(3, count_decimals(float((values["q95"] - values["q05"]).min())))
        found = {leg: bracket(format_fixed(x, places) for x in row) for leg, *row in values.itertuples()}
        cells.append([study.label(name), *(found.get(leg, NOTHING) for leg in legs)])
    return make_table(f"Model error τ of each {study.member}.", columns, cells)


def _draw_tau(
    rows: pd.DataFrame, styles: Styles, prior_scale: float | None, member: str, shown: tuple[float, str]
) -> Drawing:
    """Return the 90 % posterior intervals of the model error τ of each leg, a panel per deformation.

    ``shown`` are factor and name of the unit; the prior's scale is in it.
    """
    deformations = list(dict.fromkeys(style.deformation for style in styles.values()))
    figure = Drawing(figsize=(9.4, 2.5))
    grid = figure.subplots(1, len(deformations), sharey=True, squeeze=False)[0]
    scale: dict[str, Any] = {"color": GREY, "linestyle": "--", "linewidth": 1.0}
    for axes, deformation in zip(grid, deformations, strict=True):
        draw_intervals(axes, rows, {n: s for n, s in styles.items() if s.deformation == deformation}, shown[0])
        axes.set_title(deformation)
        label_members(axes, rows, member)
        if prior_scale is not None:
            axes.axhline(prior_scale, **scale)
    others = [Line2D([], [], label="scale of the half-normal prior", **scale)] if prior_scale is not None else []
    grid[0].set_ylim(bottom=0)
    grid[0].set_ylabel(f"Model error τ ({shown[1]})")
    add_legend(figure, styles, 1.6, *others, columnspacing=1.4)
    return figure
