"""How variants are drawn: one colour per deformation, one marker per model; one of its own for a name of its own."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import cycle
from typing import Any

from matplotlib.lines import Line2D

from bayescal.experiments.study.page.results import StudyResults
from bayescal.experiments.study.page.variants import (
    label_model,
    label_variant,
    list_deformations,
    list_models,
    split_variant,
)
from bayescal.report.style import INK, MARKERS, OTHER_COLOURS
from bayescal.report.symbols import quote

DEFORMATION_COLOURS = {"none": "#D55E00", "linear": "#0072B2", "matrix": "#009E73"}
FEW = 4  # variants to name one by one in a legend
LONG, FEW_COLUMNS = 20, 4  # letters of a variant's own name from which on a line of a legend holds so few


@dataclass(frozen=True)
class VariantStyle:
    """How a variant is drawn: colour by deformation, marker by ``model``, a model's title or a variant's own name."""

    colour: str
    marker: str
    label: str
    model: str
    deformation: str
    has_own_name: bool = False


type Styles = Mapping[str, VariantStyle]


def assign_styles(results: StudyResults) -> dict[str, VariantStyle]:
    """Return the style of each variant of a study, the same in all figures."""
    kinds = {name: _kind_of(results, name) for name in results.summary["variants"]}
    models = [label_model(results, model) for model in list_models(results)]
    marker = dict(zip(dict.fromkeys([*models, *kinds.values()]), cycle(MARKERS), strict=False))
    others = cycle(OTHER_COLOURS)
    colour = {name: DEFORMATION_COLOURS.get(name) or next(others) for name in list_deformations(results)}
    return {
        name: VariantStyle(
            colour[deformation],
            marker[kind],
            quote(label_variant(results, name)),
            quote(kind),
            quote(deformation),
            name in results.own_names,
        )
        for name, kind, deformation in ((n, kind, split_variant(results, n)[1]) for n, kind in kinds.items())
    }


def _kind_of(results: StudyResults, name: str) -> str:
    """Return the title of a variant's model, with whose variants it shares its marker; its own name if it has one."""
    return name if name in results.own_names else label_model(results, split_variant(results, name)[0])


def count_columns(styles: Styles, most: int) -> int:
    """Return how many entries of `list_keys` a line of a legend holds, at most so many."""
    return FEW_COLUMNS if any(len(style.model) > LONG for style in styles.values()) else most


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
