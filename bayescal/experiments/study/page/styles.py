"""How variants are drawn: of models of legs a colour per deformation and a marker per model, else each its own."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import cycle
from typing import Any

from matplotlib.artist import Artist
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from bayescal.experiments.study.page.results import StudyResults
from bayescal.report.style import INK, LEG_COLOURS, MARKERS, OTHER_COLOURS
from bayescal.report.symbols import quote

DEFORMATION_COLOURS = {"none": "#D55E00", "linear": "#0072B2", "matrix": "#009E73"}
MAX_NAMED_VARIANTS = 4  # variants to name one by one in a legend
LONG, FEW_COLUMNS = 20, 4  # letters of a variant's own name from which on a line of a legend holds so few


@dataclass(frozen=True)
class VariantStyle:
    """How a variant is drawn: colour by deformation, marker by ``model``, a model's title or a variant's own name.

    Where variants are no models of legs, each has a colour and a marker of its own, and no deformation.
    """

    colour: str
    marker: str
    label: str
    model: str
    deformation: str
    has_own_name: bool = False


type Styles = Mapping[str, VariantStyle]


def assign_styles(study: StudyResults) -> dict[str, VariantStyle]:
    """Return the style of each variant of a study, the same in all figures."""
    if "models" not in study.summary:
        labels = {name: quote(study.label(name)) for name in study.summary["variants"]}
        marks = zip(labels.items(), cycle(LEG_COLOURS), cycle(MARKERS), strict=False)
        return {name: VariantStyle(colour, marker, label, label, "", True) for (name, label), colour, marker in marks}
    pairs = {name: study.split(name) for name in study.summary["variants"]}
    own = study.own_names
    kinds = {name: name if name in own else study.label_model(model) for name, (model, _) in pairs.items()}
    models = [study.label_model(model) for model in study.models]
    marker = dict(zip(dict.fromkeys([*models, *kinds.values()]), cycle(MARKERS), strict=False))
    others = cycle(OTHER_COLOURS)
    colour = {name: DEFORMATION_COLOURS.get(name) or next(others) for name in study.deformations}
    return {
        name: VariantStyle(
            colour[deformation],
            marker[kinds[name]],
            quote(study.label(name)),
            quote(kinds[name]),
            quote(deformation),
            name in own,
        )
        for name, (_, deformation) in pairs.items()
    }


def add_legend(
    figure: Figure, styles: Styles, linewidth: float, *others: Artist, most: int = 8, **spacing: float
) -> None:
    """Write the legend of variants and what else is drawn above a figure, at most so many entries in a line."""
    columns = FEW_COLUMNS if any(len(style.model) > LONG for style in styles.values()) else most
    handles = [*list_keys(styles, linewidth), *others]
    figure.legend(handles=handles, loc="outside upper left", ncols=columns, borderaxespad=0.2, **spacing)


def list_keys(styles: Styles, linewidth: float = 0.0) -> list[Line2D]:
    """Return legend entries: a few variants one by one, many as colours of deformations and markers of models."""
    shape: dict[str, Any] = {"markersize": 5, "linewidth": linewidth, "linestyle": "-" if linewidth else "none"}
    if len(styles) <= MAX_NAMED_VARIANTS or not any(style.deformation for style in styles.values()):
        return [Line2D([], [], color=s.colour, marker=s.marker, label=s.label, **shape) for s in styles.values()]
    colours = {s.deformation: s.colour for s in styles.values()}
    markers = {s.model: s.marker for s in styles.values()}
    return [
        *(Line2D([], [], color=c, label=name, linewidth=3.0) for name, c in colours.items()),
        *(Line2D([], [], color=INK, marker=m, label=name, **shape) for name, m in markers.items()),
    ]
