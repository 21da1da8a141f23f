"""The structured model error: how large it is, along which motion of which leg, and what explains it."""

from __future__ import annotations

from functools import partial
from typing import Any

from bayescal.experiments.study.page.figures.structured import draw_structured
from bayescal.experiments.study.page.results import StudyResults
from bayescal.experiments.study.page.variants import VARIANT, label_variant
from bayescal.report.blocks import Block, Column, Figure, Section, Statement, make_table
from bayescal.report.numbers import format_fixed, format_significant

EXPLAINED = 0.9  # share from which a deformation is said to explain the error
TEXT = (
    "What a model leaves out is the same function of the pose every time. Each leg has such a function of the "
    "actuators' travel, zero at home, with the stated kernel and scale; the data say whether there is one, the prior "
    "probability being one half. Its values are in terms of the actuator: a leg that errs by 5 µm ends where it would "
    "if its actuator stood 5 µm off."
)


def show_structured(study: StudyResults) -> Section | None:
    """Return what was found of the variants whose model error has a kernel; None where none has."""
    found = {name: study.fit(name, "free").get("structured_error") for name in study.ranking}
    there = {name: one for name, one in found.items() if one is not None}
    if not there or study.structured is None:
        return None
    first = next(iter(there))
    legs = range(1, len(there[first]["rms_um"]["mean"]) + 1)
    columns = [VARIANT, Column("Kernel", kind="text"), Column("Present", "%")]
    columns += [Column(f"leg {leg}", "µm", "rms over the poses, mean [5 %, 95 %]") for leg in legs]
    rows = [
        [label_variant(study, name), one["kernel"], _format_presence(one), *_sizes(one)] for name, one in there.items()
    ]
    blocks: list[Block] = [TEXT, *(state_structured(study, name, one) for name, one in there.items())]
    blocks += [illustrate_structured(study, name) for name, one in there.items() if max(one["present"]) > 0.5]
    blocks.append(make_table("Structured error of each leg over the calibration poses.", columns, rows))
    return Section("Structured model error", tuple(blocks), anchor="structured", short="Structured")


def _format_presence(one: dict[str, Any]) -> str:
    return format_fixed(100.0 * max(one["present"]), 1)


def _sizes(one: dict[str, Any]) -> list[str]:
    sizes = one["rms_um"]
    return [
        f"{format_fixed(mean, 1)} [{format_fixed(low, 1)}, {format_fixed(high, 1)}]"
        for mean, low, high in zip(sizes["mean"], sizes["q05"], sizes["q95"], strict=True)
    ]


def state_structured(study: StudyResults, name: str, one: dict[str, Any]) -> Statement:
    """Say how large a variant's structured error is, along which motion, and whether a deformation explains it."""
    label, present = label_variant(study, name), max(one["present"])
    if present <= 0.5:
        return Statement(
            f"{label}: no structured error (probability of one {format_significant(100.0 * present, 2)} %)."
        )
    sizes, largest = one["rms_um"], one["largest"]
    leg = max(range(len(sizes["mean"])), key=lambda k: sizes["mean"][k])
    text = (
        f"{label}: a structured error with probability {format_significant(100.0 * present, 3)} %, largest in leg "
        f"{leg + 1}: {_sizes(one)[leg]} µm rms. Its steepest part: actuator {largest['actuator']} at the end of its "
        f"range moves leg {largest['leg']} by {format_fixed(largest['um'], 1, sign=True)} µm; "
        f"{format_fixed(100.0 * one['linear_share'], 0)} % of the error is linear in the travel. "
    )
    return Statement(text + _say_explained(one["explained"]))


def _say_explained(shares: dict[str, float]) -> str:
    """Say what known deformations explain of the error."""
    if not shares:
        return ""
    words = [
        f"a {name} deformation explains {format_fixed(100.0 * share, 0)} % of it" for name, share in shares.items()
    ]
    best = max(shares, key=lambda name: shares[name])
    end = f": try {best}" if shares[best] >= EXPLAINED else ": no known deformation explains it"
    return f"Of what is known of its linear part, {' and '.join(words)}{end}."


def illustrate_structured(study: StudyResults, name: str) -> Figure:
    """Return the error of every leg along the actuator that tells most of it."""
    assert study.structured is not None
    rows = study.structured[study.structured["variant"] == name]
    caption = (
        f"{label_variant(study, name)}: structured error of every leg at the poses against the travel of the actuator "
        "that tells most of it, with 90 % intervals; full: calibration, open: verification. What scatters about a line "
        "is the other actuators' part."
    )
    return Figure(f"structured-{name.replace('/', '-').replace(' ', '_')}", caption, partial(draw_structured, rows))
