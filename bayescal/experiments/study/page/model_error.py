"""What a model leaves out beside the noise: what to do, how large it is, in which channel, along what.

From three tables of the results: `model_error` has the size of each term, `model_error_members` how much of it is in
which channel, `model_error_poses` the errors pose by pose; and where each leg has a τ of its own, its posterior.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from matplotlib.figure import Figure as Drawing
from matplotlib.lines import Line2D
from scipy.stats import chi2

from bayescal.experiments.shared.rows import SYSTEMATIC_TOTAL, ModelErrorAloneRow, ModelErrorRow
from bayescal.experiments.shared.unmodelled_bias import show_hidden
from bayescal.experiments.study.page.parameters import draw_intervals, label_members
from bayescal.experiments.study.page.results import RANDOM_TERM, TERMS, VARIANT, StudyResults
from bayescal.experiments.study.page.styles import Styles, add_legend, assign_styles
from bayescal.limits import LASTING, UNSEEN_UM
from bayescal.numerics.heavy_tails import HARDLY
from bayescal.report.blocks import Block, Column, Figure, Fold, PageSection, Statement, Table, make_table
from bayescal.report.numbers import (
    NO_VALUE,
    count_decimals,
    format_fixed,
    format_plain,
    format_significant,
    join_words,
)
from bayescal.report.style import GREY, INK
from bayescal.report.symbols import MODEL_ERROR, quote, scale_of

LEAD = "Model error"
TAU = "τ: random error from pose to pose; intervals include it."
CAPTION = "Model error τ: posterior mean, 90 % interval."


class TermMeaning(NamedTuple):
    """What a term of the model error stands for: along what it changes, what usually causes it, what to do."""

    along: str
    causes: str
    advice: str


KINDS: dict[str, TermMeaning] = {
    "random": TermMeaning(
        "random",
        "play, repeatability, understated noise",
        "Measure one pose repeatedly: scatter is noise or play",
    ),
    "linear": TermMeaning(
        "linear in all actuators",
        "coupled actuators, a yielding frame",
        "Look for coupled actuators, or free a deformation",
    ),
    "positioning": TermMeaning(
        "by own position",
        "lead error, encoder scale, eccentric encoder or screw",
        "Check lead and encoder of {member}, or {gain}",
    ),
    "smooth": TermMeaning(
        "smooth in position",
        "bending, joints, guides not straight",
        "Compare joint errors or bending parts",
    ),
    "drift": TermMeaning(
        "with time",
        "temperature, settling",
        "Warm up; measure one pose repeatedly",
    ),
    "lead": TermMeaning(
        "linear in own position",
        "lead error, encoder scale",
        "Check lead and encoder scale of {member}, or {gain}",
    ),
    "joints": TermMeaning(
        "quadratic in the pose",
        "axes that do not meet, runout",
        "Check joints of {member}, or add joint errors",
    ),
    "gravity": TermMeaning(
        "by pose, in all channels",
        "bending by weight, instrument scale",
        "Measure with another load",
    ),
}
DIRECTIONS = ("lead", "joints", "gravity")
"""Causes that have no term of their own and are tried by themselves."""
NESTED = {"positioning", "lead"}
"""A cause and a part of it: neither is a rival of the other."""
NO_TRACE = (0.10, 0.32, 0.46, 0.56)
"""Lower end of a 90 % interval over the median of the size of one to four terms together without any trace of them:
each is then about flat from zero to what the data allow, and several together are never near zero."""
BEYOND = 0.26
"""Share of the way from there to one, from which on the data show an error: of one term at a third of the median."""
UNDECIDED = "Measure more poses, some again later"
CLEAR = 3.0
"""Nats by which one term alone has to be better than any other alone to be named, and all together than each alone."""
OUTSTANDING = 2.5  # times the median of the others, from which on one member is named
SIZES = "Size: rms over calibration poses, as tool displacement."
ALONE = "Alone: log Bayes factor against all together."
MEMBERS = "Posterior mean, rms."
POSES = "{label}: systematic errors, 90 % intervals. Open: verification."
MOST_PANELS, ABREAST = 12, 3


def bracket(words: Iterable[str]) -> str:
    """Return ``middle [low, high]``."""
    middle, low, high = words
    return f"{middle} [{low}, {high}]"


def show_model_error(study: StudyResults) -> PageSection | None:
    """Return what was found of the model error; None where no variant has terms."""
    described = _list_described(study)
    return PageSection(LEAD, tuple(_show_terms(study, described)), anchor="model-error") if described else None


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
    sizes: dict[str, ModelErrorRow]
    members: dict[str, float]
    alone: dict[str, float]
    directions: dict[str, ModelErrorAloneRow]
    floors: dict[str, float]
    n_taus: int
    unit: str
    gains: Mapping[str, str] | None  # of each channel; None of results that do not say

    @property
    def functions(self) -> dict[str, ModelErrorRow]:
        """The terms of systematic errors, the largest first."""
        own = {name: row for name, row in self.sizes.items() if name not in (RANDOM_TERM, SYSTEMATIC_TOTAL)}
        return dict(sorted(own.items(), key=lambda item: -item[1].median))

    @property
    def whole(self) -> ModelErrorRow | ModelErrorAloneRow | None:
        """The size of all systematic errors together; of the one cause that explains all, where it has no term."""
        return (
            self.directions.get(self.cause)
            or self.sizes.get(SYSTEMATIC_TOTAL)
            or next(iter(self.functions.values()), None)
        )

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
        return [*seen, RANDOM_TERM] if is_seen(self.beyond(RANDOM_TERM), _measure_no_trace(self.n_taus)) else seen

    def beyond(self, name: str) -> ModelErrorRow | None:
        """Return the size of a term, or of all together, beyond what is stated; None where there is no such term."""
        size, floor = self.sizes.get(name), self.floors.get(name, 0.0)
        if size is None or not floor:
            return size
        median, q05, q95 = (math.sqrt(max(0.0, one**2 - floor**2)) for one in (size.median, size.q05, size.q95))
        return replace(size, median=median, q05=q05, q95=q95)

    @property
    def is_seen_together(self) -> bool:
        """Whether the data show systematic errors, of whatever sort: by their size, or by evidence against none."""
        if self.alone.get("none", 0.0) < -CLEAR:
            return True
        name = SYSTEMATIC_TOTAL if SYSTEMATIC_TOTAL in self.sizes else next(iter(self.functions), "")
        return is_seen(self.beyond(name), NO_TRACE[min(max(len(self.functions), 1), len(NO_TRACE)) - 1])


def is_seen(size: ModelErrorRow | None, without: float) -> bool:
    """Whether the data show an error of that size: its lower end is not as near to zero as the prior has it.

    ``without`` is the lower end over the median where the data show none.
    """
    least = without + BEYOND * (1.0 - without)
    return size is not None and size.q05 >= least * size.median > 0.0


def _measure_no_trace(n_taus: int) -> float:
    """Return the same share of the rms of so many τ, each with a half-normal prior, as `NO_TRACE` has it of terms."""
    low, middle = chi2.ppf([0.05, 0.5], max(n_taus, 1))
    return math.sqrt(low / middle)


def _find(study: StudyResults, name: str) -> _Found:
    poses = study.table("model_error_poses", name)
    calibration = poses[poses["use"] == "calibration"]
    square = (calibration["mean"] ** 2).groupby(calibration["member"], sort=False).mean()
    members = {str(member): math.sqrt(value) for member, value in square.items()}
    sizes: dict[str, ModelErrorRow] = {row.term: row for row in study.rows(ModelErrorRow, name)}
    alone = {row.term: row for row in study.rows(ModelErrorAloneRow, name)}
    directions = {term: row for term, row in alone.items() if term in DIRECTIONS}
    floors = _list_floors(study, name)
    floors |= {SYSTEMATIC_TOTAL: math.sqrt(sum(one**2 for term, one in floors.items() if term != RANDOM_TERM))}
    odds = {term: row.log_bayes_factor for term, row in alone.items()}
    rows = study.parameters
    n_taus = int(((rows["variant"] == name) & (rows["symbol"] == MODEL_ERROR)).sum())
    unit, gains = study.error_unit, study.summary.get("gains")
    return _Found(study.label(name), sizes, members, odds, directions, floors, n_taus, unit, gains)


def _list_floors(study: StudyResults, name: str) -> dict[str, float]:
    """Return the least size of each term of a variant that is stated, in the unit of errors."""
    stated, terms = study.config.get("model_error", {}).get("floor_um", 0.0), study.list_terms(name)
    factor = study.error_factor
    if isinstance(stated, dict):
        return {term: factor * float(size) for term, size in stated.items() if size > 0.0 and term in terms}
    lasting = [term for term in LASTING if term in terms]
    return {term: factor * stated / math.sqrt(len(lasting)) for term in lasting if stated > 0.0}


def state_terms(study: StudyResults) -> list[Statement]:
    """Return the model errors of the variant to use that the data show, how large they are, and what to do."""
    described = _list_described(study)
    return _state_found(_find(study, described[0])) if described else []


def _state_found(found: _Found) -> list[Statement]:
    """Return systematic errors, random ones, and those whose size is hardly determined."""
    seen = [name for name in found.seen if name in found.functions]
    # terms that imitate each other: only their sum is known; and one cause alone may be seen where all together are not
    if not seen and (found.is_seen_together or found.cause):
        seen = list(found.functions)
    said = [_state_seen(found, seen) if seen and found.whole is not None else _state_absent(found)]
    said += _state_random(found)
    open_ones = {name: row.tail for name, row in found.functions.items() if row.tail > HARDLY}
    if open_ones:
        what = join_words([KINDS[name].along for name in open_ones], "or")
        text = f"Error {what}: size not determined."
        said.append(Statement(text, lead=LEAD, value=max(open_ones.values()), limit=HARDLY))
    return said


def _state_seen(found: _Found, seen: list[str]) -> Statement:
    """Return how large the systematic error is, in which channel and along what, and what to do."""
    assert found.whole is not None
    main, outstanding = KINDS[found.cause or seen[0]], _name_outstanding(found)
    action = main.advice.format(member=outstanding or "every channel", gain=_name_gain(found, outstanding))
    along = f"{'all' if found.cause else 'mostly'} {main.along}"
    if found.rivals:
        action, along = UNDECIDED, " or ".join(KINDS[name].along for name in found.rivals[:2])
    where = f" of {outstanding}" if outstanding else ""
    text = f"Model error{where}: {format_significant(found.whole.median, 2)} {found.unit} rms, {along}."
    value, limit = found.whole.median, found.floors[SYSTEMATIC_TOTAL] or math.nan
    return Statement(text, "plain", LEAD, value=value, limit=limit, unit=found.unit, action=f"{action}.")


def _state_absent(found: _Found) -> Statement:
    """Return up to which size there may be a systematic error that is not seen."""
    if found.whole is None:
        text = f"{found.label}: intervals exclude systematic errors."
        return Statement(text, "plain", LEAD)
    most, stated = found.whole.q95, found.floors[SYSTEMATIC_TOTAL]
    beyond = f" beyond {format_significant(stated, 2)} {found.unit}" if stated else ""
    text = f"No systematic error seen{beyond} (95 % limit {format_significant(most, 2)} {found.unit} rms)."
    return Statement(text, "good", LEAD, value=most, unit=found.unit)


def _state_random(found: _Found) -> list[Statement]:
    """Return how large random errors from pose to pose are; nothing where there is no term for them."""
    size = found.sizes.get(RANDOM_TERM)
    if size is None:
        return []
    if RANDOM_TERM in found.seen:
        text = f"Random error τ: {_format_size(size)} {found.unit}."
        action = f"{KINDS[RANDOM_TERM].advice}."
        return [Statement(text, "plain", LEAD, value=size.median, unit=found.unit, action=action)]
    most = format_significant(size.q95, 2)
    text = f"No random error seen (95 % limit of τ: {most} {found.unit})."
    return [Statement(text, "good", LEAD, value=size.q95, unit=found.unit)]


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
        return "free a gain in the machine class"
    symbols = list(dict.fromkeys(one if outstanding else one.partition("[")[0] for one in names))
    return f"free {join_words(symbols)} in [parameters]"


def _format_size(size: ModelErrorRow | ModelErrorAloneRow) -> str:
    """Return the median of a size with its 90 % interval, to the second digit of the median."""
    places = count_decimals(size.median)
    return bracket(format_fixed(one, places) for one in (size.median, size.q05, size.q95))


def _show_terms(study: StudyResults, described: list[str]) -> list[Block]:
    """Return what to do, how sure that is and why, of the variant to use; of the others the sizes, folded."""
    name, *others = described
    found = _find(study, name)
    blocks: list[Block] = [_tabulate_terms(found)]
    rows = study.table("model_error_poses", name)
    if found.members:
        most = sorted(found.members, key=lambda member: -found.members[member])[:MOST_PANELS]
        chosen = [member for member in found.members if member in most]
        caption = POSES.format(label=found.label)
        if len(chosen) < len(found.members):
            caption += f" The {len(chosen)} largest."
        place = rows.assign(place=rows.groupby("member").cumcount() + 1)
        panels = {member: place[place["member"] == member] for member in chosen}
        draw = partial(_draw_errors, panels, study.error_unit)
        blocks.append(Figure("model_error", caption, draw))
    if RANDOM_TERM in found.sizes:
        blocks += [TAU, *_show_tau(study)]
    by_member = study.table("model_error_members", name)
    if len(by_member):
        blocks.append(_tabulate_members(found, by_member))
    blocks += _show_floor(study, name)
    if others:
        blocks.append(Fold("Model error, other variants", (_tabulate_variants(study, described),)))
    return blocks


def _tabulate_terms(found: _Found) -> Table:
    """Return the size of each term, along what it changes and what usually causes it."""
    columns = [Column("Along what", kind="text"), Column("Size", f"{found.unit} rms", "median [5 %, 95 %]")]
    columns += [Column("Alone", "nat")] if found.alone else []
    columns += [Column("In the data", kind="text"), Column("Usual causes", kind="text")]
    rows = []
    for name, size in found.sizes.items():
        along, causes = (KINDS[name].along, KINDS[name].causes) if name in KINDS else ("systematic errors", "")
        there = found.is_seen_together if name == SYSTEMATIC_TOTAL else name in found.seen
        alone = [format_fixed(found.alone.get(name, math.nan), 1, sign=True)] if found.alone else []
        trace = "as stated" if found.floors.get(name) else "no trace"
        rows.append([along, _format_size(size), *alone, "seen" if there else trace, causes])
    for name, direction in found.directions.items():
        along, trace = KINDS[name].along, "seen" if name == found.cause else ""
        alone = [format_fixed(found.alone[name], 1, sign=True)]
        rows.append([f"{along}, by itself", _format_size(direction), *alone, trace, KINDS[name].causes])
    if "none" in found.alone:
        rows.append(["none", NO_VALUE, format_fixed(found.alone["none"], 1, sign=True), "", ""])
    notes = [Statement(SIZES), *([Statement(ALONE)] if found.alone else [])]
    return make_table(f"Model error of {found.label}.", columns, rows, notes)


def _show_floor(study: StudyResults, name: str) -> list[Block]:
    """Say what errors that leave no trace would hide, and which of them are allowed for."""
    stated, floors = study.config.get("model_error", {}).get("floor_um", 0.0), _list_floors(study, name)
    unit = study.error_unit
    sizes = [f"{format_plain(size)} {unit} rms {KINDS[term].along}" for term, size in floors.items()]
    if floors and not isinstance(stated, dict):
        sizes = [f"{format_plain(study.error_factor * stated)} {unit} rms"]
    if not study.has("model_error_bias"):
        return [Statement(f"Stated as floor_um: {join_words(sizes)}.")] if sizes else []
    size = join_words(sizes) if sizes else f"{format_plain(study.error_factor * UNSEEN_UM)} {unit} rms"
    return show_hidden(study.table("model_error_bias", name), size, bool(sizes), study.shown_in)


def _tabulate_members(found: _Found, rows: pd.DataFrame) -> Table:
    """Return how much of each term is in which channel."""
    wide = rows.pivot(index="member", columns="term", values="rms")
    terms = [name for name in TERMS if name in wide.columns]
    columns = [Column("", kind="text"), *(Column(KINDS[name].along, found.unit) for name in terms)]
    columns.append(Column("all", found.unit))
    cells = [
        [member, *(format_significant(wide[name].get(member), 2) for name in terms), format_significant(size, 2)]
        for member, size in found.members.items()
    ]
    return make_table(f"By channel. {MEMBERS}", columns, cells, style="wide")


def _tabulate_variants(study: StudyResults, names: list[str]) -> Table:
    """Return the sizes of the terms of every variant."""
    there = {row.term for name in names for row in study.rows(ModelErrorRow, name)}
    terms = [term for term in (*TERMS, SYSTEMATIC_TOTAL) if term in there]
    columns = [VARIANT, *(Column(term, f"{study.error_unit} rms", "median [5 %, 95 %]") for term in terms)]
    rows = []
    for name in names:
        sizes = {row.term: _format_size(row) for row in study.rows(ModelErrorRow, name)}
        rows.append([study.label(name), *(sizes.get(term, NO_VALUE) for term in terms)])
    return make_table("By variant.", columns, rows, style="wide")


def _draw_errors(panels: Mapping[str, pd.DataFrame], unit: str) -> Drawing:
    """Return a panel for each channel: errors with their 90 % intervals over the poses in order."""
    n_rows = math.ceil(len(panels) / ABREAST)
    figure = Drawing(figsize=(9.4, 0.4 + 1.9 * n_rows))
    grid = figure.subplots(n_rows, ABREAST, squeeze=False, sharey=True)
    for axes, (title, own) in zip(grid.ravel(), panels.items(), strict=False):
        for use, fill in (("calibration", INK), ("verification", "white")):
            part = own[own["use"] == use]
            around = [part["mean"] - part["low"], part["high"] - part["mean"]]
            axes.errorbar(
                part["place"],
                part["mean"],
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
        scale_of(MODEL_ERROR, str(rows["unit"].iloc[0])),
    )
    table = _tabulate_tau(study, rows)
    return [
        Figure("tau", CAPTION.format(member=study.member), draw),
        Fold("τ by variant", (table,)),
    ]


def _tabulate_tau(study: StudyResults, rows: pd.DataFrame) -> Table:
    """Return τ of each leg with its 90 % interval."""
    legs, (factor, unit) = sorted(set(rows["leg"])), scale_of(MODEL_ERROR, str(rows["unit"].iloc[0]))
    columns = [VARIANT, *(Column(f"{study.member} {leg}", unit, "τ, mean [5 %, 95 %]") for leg in legs)]
    cells = []
    for name in study.names:
        values = factor * rows[rows["variant"] == name].set_index("leg")[["mean", "q05", "q95"]]
        if values.empty:
            continue
        places = min(3, count_decimals(float((values["q95"] - values["q05"]).min())))
        found = {leg: bracket(format_fixed(x, places) for x in row) for leg, *row in values.itertuples()}
        cells.append([study.label(name), *(found.get(leg, NO_VALUE) for leg in legs)])
    return make_table(f"τ by {study.member}.", columns, cells)


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
    others = [Line2D([], [], label="prior scale", **scale)] if prior_scale is not None else []
    grid[0].set_ylim(bottom=0)
    grid[0].set_ylabel(f"Model error τ ({shown[1]})")
    add_legend(figure, styles, 1.6, *others, columnspacing=1.4)
    return figure
