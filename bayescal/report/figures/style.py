"""How the report's figures look: one colour per deformation, one marker per model, one colour per leg."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import cycle
from typing import Any

# Okabe and Ito's colours, told apart by colour-blind readers
DEFORMATION_COLOURS = {"none": "#D55E00", "linear": "#0072B2", "matrix": "#009E73"}
OTHER_COLOURS = ("#CC79A7", "#56B4E9", "#E69F00", "#555555")
LEG_COLOURS = ("#E69F00", "#56B4E9", "#009E73", "#CC79A7", "#0072B2", "#D55E00")
MARKERS = ("o", "s", "^", "D", "v", "P", "X", "*")
INK = "#222222"
GREY = "#8a8a8a"
PALE = "#d9d9d9"

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

GREEK = {"alpha": "α", "beta": "β", "kappa": "κ", "rho": "ρ", "tau": "τ"}


@dataclass(frozen=True)
class VariantStyle:
    """How a variant is drawn."""

    colour: str
    marker: str
    label: str


def assign_styles(variants: Sequence[str]) -> dict[str, VariantStyle]:
    """Return the style of each variant ``model/deformation``: colour by deformation, marker by model."""
    models = dict.fromkeys(split_variant(name)[0] for name in variants)
    deformations = dict.fromkeys(split_variant(name)[1] for name in variants)
    marker = dict(zip(models, cycle(MARKERS), strict=False))
    others = cycle(OTHER_COLOURS)
    colour = {name: DEFORMATION_COLOURS.get(name) or next(others) for name in deformations}
    return {
        name: VariantStyle(colour[split_variant(name)[1]], marker[split_variant(name)[0]], quote(name))
        for name in variants
    }


def split_variant(name: str) -> tuple[str, str]:
    """Return model and deformation of a variant's name."""
    model, _, deformation = name.rpartition("/")
    return model, deformation


def leg_colour(leg: int) -> str:
    """Return the colour of a leg, counted from one."""
    return LEG_COLOURS[(leg - 1) % len(LEG_COLOURS)]


def quote(text: str) -> str:
    """Return text that matplotlib sets as it stands."""
    return text.replace("\\", "").replace("$", r"\$")


def split_symbol(symbol: str) -> tuple[str, str, str]:
    """Return head, subscript and superscript of a parameter's symbol: ``rho0`` is ρ with superscript 0."""
    found = re.fullmatch(r"([A-Za-z]+)(0?)(?:_([A-Za-z0-9]+))?", symbol)
    if not found:
        return symbol, "", ""
    return GREEK.get(found[1], found[1]), found[3] or "", found[2]


def set_symbol(symbol: str, before: str = "") -> str:
    """Return a symbol as mathematical text, ``before`` put in front of it."""
    head, below, above = split_symbol(symbol)
    if not re.fullmatch(r"\w+", head):
        return f"{before}{quote(symbol)}"
    lower = f"_{{{below}}}" if below else ""
    upper = f"^{{{above}}}" if above else ""
    return f"${before}{head}{lower}{upper}$"
