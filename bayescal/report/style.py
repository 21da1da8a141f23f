"""How figures look: fonts, lines, and colours that colour-blind readers tell apart."""

from __future__ import annotations

from typing import Any

# Okabe and Ito's colours, told apart by colour-blind readers
OTHER_COLOURS = ("#CC79A7", "#56B4E9", "#E69F00", "#555555")
LEG_COLOURS = ("#E69F00", "#56B4E9", "#009E73", "#CC79A7", "#0072B2", "#D55E00")
MARKERS = ("o", "s", "^", "D", "v", "P", "X", "*")
INK = "#222222"
GREY = "#8a8a8a"
PALE = "#d9d9d9"
RED = "#b00020"

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
    "svg.hashsalt": "bayescal",  # the same figure gives the same bytes
}


def leg_colour(leg: int) -> str:
    """Return the colour of a leg, counted from one."""
    return LEG_COLOURS[(leg - 1) % len(LEG_COLOURS)]
