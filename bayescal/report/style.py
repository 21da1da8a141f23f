"""How the report's figures look: one colour per deformation, one marker per model, one colour per leg."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import cycle
from typing import Any

from matplotlib.lines import Line2D

from bayescal.experiments.study.page.variants import label_model, label_variant, split_variant
from bayescal.report.symbols import quote

# Okabe and Ito's colours, told apart by colour-blind readers
DEFORMATION_COLOURS = {"none": "#D55E00", "linear": "#0072B2", "matrix": "#009E73"}
OTHER_COLOURS = ("#CC79A7", "#56B4E9", "#E69F00", "#555555")
LEG_COLOURS = ("#E69F00", "#56B4E9", "#009E73", "#CC79A7", "#0072B2", "#D55E00")
MARKERS = ("o", "s", "^", "D", "v", "P", "X", "*")
INK = "#222222"
GREY = "#8a8a8a"
PALE = "#d9d9d9"
RED = "#b00020"
FEW = 4  # variants to name one by one in a legend

RC: dict[str, Any] = {
    "font.size": 9.0,
    "axes.titlesize": 9.5,
    "axes.titlelocation": "left",
    "axes.labelsize": 9.0,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.edgecolor": INK,
    "axes.linewidth": 0.7,
    "axes.axisbelow": True,
    "axes.unicode_minus": True,
    "grid.color": "#e3e3e3",
    "grid.linewidth": 0.6,
    "xtick.labelsize": 8.5,
    "ytick.labelsize": 8.5,
    "legend.frameon": False,
    "legend.fontsize": 8.5,
    "figure.constrained_layout.use": True,
}


@dataclass(frozen=True)
class VariantStyle:
    """How a variant is drawn: colour by deformation, marker by model."""

    colour: str
    marker: str
    label: str
    model: str
    deformation: str


type Styles = Mapping[str, VariantStyle]


def assign_styles(variants: Sequence[str]) -> dict[str, VariantStyle]:
    """Return the style of each variant ``model/deformation``: of all of a study, that it be the same in all figures."""
    models = dict.fromkeys(split_variant(name)[0] for name in variants)
    deformations = dict.fromkeys(split_variant(name)[1] for name in variants)
    marker = dict(zip(models, cycle(MARKERS), strict=False))
    others = cycle(OTHER_COLOURS)
    colour = {name: DEFORMATION_COLOURS.get(name) or next(others) for name in deformations}
    return {
        name: VariantStyle(
            colour[deformation],
            marker[model],
            quote(label_variant(name)),
            quote(label_model(model)),
            quote(deformation),
        )
        for name, (model, deformation) in ((name, split_variant(name)) for name in variants)
    }


def list_keys(styles: Styles, linewidth: float = 0.0) -> list[Line2D]:
    """Return legend entries: a few variants one by one, many as colours of deformations and markers of models."""
    shape: dict[str, Any] = {"markersize": 5, "linewidth": linewidth, "linestyle": "-" if linewidth else "none"}
    if len(styles) <= FEW:
        return [Line2D([], [], color=s.colour, marker=s.marker, label=s.label, **shape) for s in styles.values()]
    colours = {s.deformation: s.colour for s in styles.values()}
    markers = {s.model: s.marker for s in styles.values()}
    return [
        *(Line2D([], [], color=c, label=name, linewidth=3.0) for name, c in colours.items()),
        *(Line2D([], [], color=INK, marker=m, label=name, **shape) for name, m in markers.items()),
    ]


def leg_colour(leg: int) -> str:
    """Return the colour of a leg, counted from one."""
    return LEG_COLOURS[(leg - 1) % len(LEG_COLOURS)]
