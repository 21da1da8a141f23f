"""The structured model error: how large it is, along which motion of which leg, and what explains it."""

from __future__ import annotations

from functools import partial
from typing import Any

from bayescal.experiments.study.page.figures.structured import draw_slopes, draw_structured
from bayescal.experiments.study.page.results import StudyResults
from bayescal.experiments.study.page.variants import VARIANT, label_variant, name_variants
from bayescal.report.blocks import Block, Column, Figure, Fold, Section, Statement, Table, make_table
from bayescal.report.numbers import NOTHING, format_fixed, format_significant

EXPLAINED = 0.9  # share from which a deformation is said to explain the error
STATED = 0.7  # share of its prior sd that is left of a scale which was stated rather than measured
LINEAR = 0.95  # share of the error from which its slopes are the whole picture
TEXT = (
    "What a model leaves out is the same function of the pose every time. Each leg has such a function of the "
    "actuators' travel, zero at home, with the kernel of its variant; whether there is one is for the data to say, the "
    "prior probability being one half. Its values are in terms of the actuator: a leg that errs by 5 µm ends where it "
    "would if its actuator stood 5 µm off. A geometry that is off imitates much of it: what the measurements do not "
    "tell of an error is as wide as its scale."
)
NOTE = (
    "Scale: what one actuator at the end of its range makes a leg err by, one standard deviation, where there is an "
    "error; left of prior: sd of its logarithm over that of its prior, near 100 % where the scale is what was stated. "
    "Surest slope: error of the leg with the actuator at the end of its range. Explained: of what is known of the "
    "linear part, by each deformation that the study knows."
)


def show_structured(study: StudyResults) -> Section | None:
    """Return what was found of the variants whose model error has a kernel; None where none has."""
    found = {name: study.fit(name, "free").get("structured_error") for name in study.ranking}
    with_kernel = {name: one for name, one in found.items() if one is not None}
    if not with_kernel or not study.has("structured"):
        return None
    there = {name: one for name, one in with_kernel.items() if is_there(one)}
    blocks: list[Block] = [TEXT, *_state_absent(study, with_kernel)]
    if there:
        name, one = next(iter(there.items()))
        blocks += [state_structured(study, name, one), *_illustrate(study, name, one)]
    blocks += [_tabulate(study, with_kernel), _tabulate_sizes(study, with_kernel)]
    rest = [figure for name, one in list(there.items())[1:] for figure in _illustrate(study, name, one)]
    if rest:
        blocks.append(Fold("The structured errors of the other variants", tuple(rest)))
    return Section("Structured model error", tuple(blocks), anchor="structured", short="Structured")


def is_there(one: dict[str, Any]) -> bool:
    """Whether a structured error is more probable than not, of any leg."""
    return bool(max(one["present"]) > 0.5)


def _state_absent(study: StudyResults, found: dict[str, Any]) -> list[Statement]:
    """Say which variants need no structured error."""
    names = [name for name, one in found.items() if not is_there(one)]
    if not names:
        return []
    most = max(max(found[name]["present"]) for name in names)
    words = f"at most {format_significant(100.0 * most, 2)} %" if most >= 5e-4 else "below 0.05 %"
    return [Statement(f"{name_variants(study, names)}: no structured error (probability of one {words}).")]


def _tabulate(study: StudyResults, found: dict[str, Any]) -> Table:
    """Return the errors' scales, surest slopes and what explains them."""
    known = list(dict.fromkeys(name for one in found.values() for name in one["explained"]))
    columns = [VARIANT, Column("Kernel", kind="text"), Column("Present", "%")]
    columns += [Column("Scale", "µm", "median [5 %, 95 %]"), Column("left of prior", "%")]
    columns += [Column("Surest slope", "µm", "mean [5 %, 95 %]"), Column("Linear in travel", "%")]
    columns += [Column(name, "%", "Explained by") for name in known]
    rows = []
    for name, one in found.items():
        told = _describe(one, known) if is_there(one) else [NOTHING] * (4 + len(known))
        kernel = one["kernel"] + _format_length(one)
        rows.append([label_variant(study, name), kernel, format_fixed(100.0 * max(one["present"]), 1), *told])
    return make_table("Structured errors.", columns, rows, [Statement(NOTE)], style="wide")


def _describe(one: dict[str, Any], known: list[str]) -> list[str]:
    surest, shares = one["surest"], one["explained"]
    where = f"leg {surest['leg']}, actuator {surest['actuator']}: "
    return [
        "; ".join(_format_scale(scale) for scale in one["scale"]) or NOTHING,
        "; ".join(format_fixed(100.0 * scale["prior_sd_left"], 0) for scale in one["scale"]) or NOTHING,
        where + _format_slope(surest),
        format_fixed(100.0 * one["linear_share"], 0),
        *(format_fixed(100.0 * shares[name], 0) if name in shares else NOTHING for name in known),
    ]


def _format_scale(scale: dict[str, float]) -> str:
    low, middle, high = (format_fixed(scale[key], 1) for key in ("q05_um", "median_um", "q95_um"))
    return f"{middle} [{low}, {high}]"


def _format_length(one: dict[str, Any]) -> str:
    """Return a free length with its interval in ranges of the actuators; nothing of one that is known."""
    if "length" not in one:
        return ""
    low, middle, high = (format_significant(one["length"][key], 2) for key in ("q05", "median", "q95"))
    return f": {middle} [{low}, {high}]"


def _format_slope(surest: dict[str, float]) -> str:
    mean, low, high = (format_fixed(surest[key], 1, sign=True) for key in ("um", "q05_um", "q95_um"))
    return f"{mean} [{low}, {high}]"


def _tabulate_sizes(study: StudyResults, found: dict[str, Any]) -> Table:
    """Return the size of every leg's error."""
    n_legs = len(next(iter(found.values()))["rms_um"]["mean"])
    legs = [Column(f"leg {leg}", "µm", "rms over the poses, mean [5 %, 95 %]") for leg in range(1, n_legs + 1)]
    rows = [[label_variant(study, name), *_sizes(one)] for name, one in found.items()]
    return make_table("Structured error of each leg over the calibration poses.", [VARIANT, *legs], rows, style="wide")


def _sizes(one: dict[str, Any]) -> list[str]:
    sizes = one["rms_um"]
    return [
        f"{format_fixed(mean, 1)} [{format_fixed(low, 1)}, {format_fixed(high, 1)}]"
        for mean, low, high in zip(sizes["mean"], sizes["q05"], sizes["q95"], strict=True)
    ]


def state_structured(study: StudyResults, name: str, one: dict[str, Any]) -> Statement:
    """Say how large a variant's structured error is, along which motion, and whether a deformation explains it."""
    sizes, surest = one["rms_um"]["mean"], one["surest"]
    leg = max(range(len(sizes)), key=lambda k: sizes[k])
    text = (
        f"{label_variant(study, name)}, the first in the ranking with such an error: present with probability "
        f"{format_significant(100.0 * max(one['present']), 3)} %, largest in leg {leg + 1}, {_sizes(one)[leg]} µm rms. "
        f"Its surest motion: actuator {surest['actuator']} at the end of its range moves leg {surest['leg']} by "
        f"{_format_slope(surest)} µm; {format_fixed(100.0 * one['linear_share'], 0)} % of the error is linear in the "
        "travel. "
    )
    return Statement(text + _say_explained(one["explained"]) + _say_length(one) + _say_scale(one["scale"]))


def _say_explained(shares: dict[str, float]) -> str:
    """Say what known deformations explain of the error."""
    if not shares:
        return ""
    words = [
        f"a {name} deformation explains {format_fixed(100.0 * share, 0)} % of it" for name, share in shares.items()
    ]
    best = max(shares, key=lambda name: shares[name])
    end = f": try {best}" if shares[best] >= EXPLAINED else ": no known deformation explains it"
    return f"Of what is known of its linear part, {' and '.join(words)}{end}. "


def _say_length(one: dict[str, Any]) -> str:
    """Say over how far an error changes whose length is free."""
    if "length" not in one:
        return ""
    left = format_fixed(100.0 * one["length"]["prior_sd_left"], 0)
    return (
        f"It changes over {_format_length(one)[2:]} ranges of the actuators; {left} % of the standard deviation that "
        "the length's logarithm has under its prior is left. "
    )


def _say_scale(scales: list[dict[str, float]]) -> str:
    """Say whether the scales are measured or stated."""
    if not scales:
        return ""
    left = max(scale["prior_sd_left"] for scale in scales)
    share = f"{format_fixed(100.0 * left, 0)} % of its prior's standard deviation is left"
    if left > STATED:
        return f"Its scale rests on the prior, not on the measurements: {share}; so do intervals that hang on it."
    return f"The measurements tell its scale: {share}."


def _illustrate(study: StudyResults, name: str, one: dict[str, Any]) -> list[Figure]:
    """Return the slopes and sizes of a variant's error, and its course where slopes are not the whole of it."""
    label, stem = label_variant(study, name), name.replace("/", "-").replace(" ", "_")
    caption = (
        f"{label}: error of each leg (row) with one actuator (column) at the end of its range, mean ± sd in µm, and "
        "the size of each leg's error over the calibration poses with its 90 % interval."
    )
    figures = [Figure(f"structured-{stem}", caption, partial(draw_slopes, one))]
    if one["linear_share"] < LINEAR and study.has("structured"):
        rows = study.table("structured")[study.table("structured")["variant"] == name]
        caption = (
            f"{label}: structured error of every leg at the poses against the travel of the actuator that tells most "
            "of it, with 90 % intervals; full: calibration, open: verification. What scatters about a line is the "
            "other actuators' part."
        )
        figures.append(Figure(f"structured-course-{stem}", caption, partial(draw_structured, rows)))
    return figures
