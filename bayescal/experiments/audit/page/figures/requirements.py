"""Predicted errors of the pose against their limits."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, NullFormatter

from bayescal.experiments.audit.page.results import Requirement
from bayescal.experiments.audit.page.wording import format_share, name_requirement
from bayescal.report.numbers import format_plain
from bayescal.report.style import GREY, INK, PALE, RED
from bayescal.report.symbols import quote

BLUE = "#0072B2"


def draw_requirements(requirements: Sequence[Requirement], kept: Sequence[bool]) -> Figure:
    """Return the predicted standard deviation of each requirement in per cent of its limit, logarithmic.

    Parameters
    ----------
    requirements : sequence of Requirement
    kept : sequence of bool
        Which of them count as kept; the others are red.
    """
    figure = Figure(figsize=(9.4, 1.0 + 0.42 * len(requirements)))
    axes = figure.subplots()
    rows = np.arange(len(requirements))
    before, after, geometry = (
        100.0 * np.array([getattr(r, key) / r.limit for r in requirements])
        for key in ("prior_sd", "predicted_sd", "geometry_sd")
    )
    axes.hlines(rows, np.minimum(after, before), np.maximum(after, before), color=PALE, linewidth=5.0, zorder=1)
    shape: dict[str, Any] = {"linestyle": "none", "markersize": 6.5}
    axes.plot(before, rows, marker="o", markerfacecolor="white", color=GREY, label="before the calibration", **shape)
    axes.plot(geometry, rows, marker="|", color=INK, label="after it, from the geometry alone", **shape)
    for colour, label, which in ((BLUE, "after it, met", True), (RED, "after it, not reliably met", False)):
        chosen = np.array(kept) == which
        if chosen.any():
            axes.plot(after[chosen], rows[chosen], marker="o", color=colour, label=label, **shape)
    for row, value in zip(rows, after, strict=True):
        axes.annotate(
            format_share(value / 100.0), (value, row), (0, 6), textcoords="offset points", ha="center", fontsize=8
        )
    axes.set_xscale("log")
    positive = np.concatenate([before, after, geometry, [100.0]])
    positive = positive[positive > 0.0]
    axes.set_xlim(positive.min() / 2.0, positive.max() * 2.0)
    axes.axvline(100.0, color=INK, linewidth=1.2, label="the limit")
    axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{format_plain(value, separator=',')} %"))
    axes.xaxis.set_minor_formatter(NullFormatter())
    axes.set_yticks(rows, [quote(name_requirement(r.name)) for r in requirements])
    axes.set_ylim(len(requirements) - 0.5, -0.6)
    axes.set_xlabel("Predicted standard deviation in per cent of the limit")
    axes.grid(axis="x")
    figure.legend(loc="outside upper left", ncols=5, borderaxespad=0.2, fontsize=8)
    return figure
