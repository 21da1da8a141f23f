"""What figures say in words: a text for those who do not see them, and the value under the pointer."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Sequence
from typing import TYPE_CHECKING

import numpy as np

from bayescal.report.numbers import format_plain, join_words
from bayescal.report.symbols import LONGEST_TEXT, cut

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.axis import Axis
    from matplotlib.container import BarContainer
    from matplotlib.figure import Figure

MOST_POINTS = 400  # of one artist; more would be a cloud, and half the page
MOST_NAMES = 14  # of an axis that names what it shows
LONGEST_TITLE = 48
CAPS = ("|", "_", "None", "none", "", " ", None)  # ends of error bars are no points
NUMBER = r"[−+-]?[\d.,]*"
TIP = "tip-"


def write_plain(text: str) -> str:
    """Return a label of a figure without the marks of mathematical text: ``$a_{x}$`` becomes ``a_x``."""
    plain = re.sub(r"[${}\\]|\^(?=\{)|\\mathregular", "", text[: 2 * LONGEST_TEXT]).replace("\u2009", " ")
    return cut(" ".join(plain.split()), LONGEST_TEXT)


# --- in words ----------------------------------------------------------------------------------------------------


def describe_figure(figure: Figure) -> str:
    """Return what is seen: the panels with their axes, what they name, and what is drawn in them."""
    panels = [axes for axes in figure.axes if axes.get_visible() and axes.axison]
    words = [text for axes in panels if (text := _describe_axes(axes))]
    if not words:
        return "Drawing without axes."
    each = list(dict.fromkeys(words))
    return f"{len(panels)} panels. {' '.join(each)}" if len(panels) > 1 else each[0]


def _describe_axes(axes: Axes) -> str:
    title = write_plain(axes.get_title("left") or axes.get_title())
    spans = [_describe_axis(axis, kind) for axis, kind in ((axes.xaxis, "across"), (axes.yaxis, "upwards"))]
    series = [write_plain(str(name)) for name in axes.get_legend_handles_labels()[1]]
    shown = f"shown: {_list_some(list(dict.fromkeys(series)))}" if series else ""
    parts = [part for part in (*spans, shown) if part]
    text = ": ".join(one for one in (title, "; ".join(parts)) if one)
    return f"{text}." if text else ""


def _describe_axis(axis: Axis, kind: str) -> str:
    label, names = write_plain(axis.get_label_text()), list_names(axis)
    if names:
        listed = [name for _, name in names if name]
        return f"{kind} {f'{label}, ' if label else ''}{_list_some(listed)}" if listed else ""
    low, high = sorted(float(x) for x in axis.get_view_interval())
    return f"{kind} {label} from {format_plain(low, 2)} to {format_plain(high, 2)}" if label else ""


def _list_some(names: Sequence[str]) -> str:
    more = len(names) - MOST_NAMES
    return join_words([*names[:MOST_NAMES], f"{more} more"] if more > 0 else names)


def list_names(axis: Axis) -> list[tuple[float, str]]:
    """Return the ticks of an axis that names what it shows; nothing of an axis of numbers."""
    from matplotlib.ticker import FixedLocator, LogFormatter, ScalarFormatter

    formatter, locator = axis.get_major_formatter(), axis.get_major_locator()
    if not isinstance(locator, FixedLocator) or isinstance(formatter, ScalarFormatter | LogFormatter):
        return []
    ticks = [float(x) for x in axis.get_majorticklocs()]
    names = [write_plain(str(name)) for name in formatter.format_ticks(ticks)]
    return [] if all(re.fullmatch(NUMBER, name) for name in names) else list(zip(ticks, names, strict=True))


# --- under the pointer -------------------------------------------------------------------------------------------


def mark_points(figure: Figure) -> dict[str, list[str]]:
    """Mark what has values by an id of its group in the SVG, and return the values in words, point by point."""
    tips: dict[str, list[str]] = {}
    for axes in figure.axes:
        describe = _make_describer(axes)
        for artist, points, series in _list_points(axes):
            if 0 < len(points) <= MOST_POINTS:
                name = f"{TIP}{len(tips)}"
                artist.set_gid(name)
                tips[name] = [describe(x, y, series) for x, y in points]
    return tips


def _list_points(axes: Axes) -> Iterator[tuple[Artist, Sequence[tuple[float, float]], str]]:
    """Yield what is drawn with its finite points, in data's units, and its name in the legend."""
    from matplotlib.collections import PathCollection
    from matplotlib.container import BarContainer

    for line in axes.get_lines():
        if line.get_marker() not in CAPS and line.get_transform().contains_branch(axes.transData):
            yield line, _keep_finite(np.asarray(line.get_xydata(), dtype=np.float64)), _name_of(line)
    for collection in axes.collections:
        if isinstance(collection, PathCollection):
            yield collection, _keep_finite(np.asarray(collection.get_offsets(), dtype=np.float64)), _name_of(collection)
    for container in axes.containers:
        if isinstance(container, BarContainer):
            lies = container.orientation == "horizontal"
            for patch in container.patches:
                x, y, width, height = patch.get_x(), patch.get_y(), patch.get_width(), patch.get_height()
                end = (x + width, y + height / 2) if lies else (x + width / 2, y + height)
                yield patch, [end], _name_of(container)


def _keep_finite(points: np.ndarray) -> list[tuple[float, float]]:
    return [(float(x), float(y)) for x, y in points if np.isfinite(x) and np.isfinite(y)]


def _name_of(artist: Artist | BarContainer) -> str:
    label = str(artist.get_label() or "")
    return "" if label.startswith("_") else write_plain(label)


def _make_describer(axes: Axes) -> Callable[[float, float, str], str]:
    """Return what says in words where a point of a series stands."""
    title = write_plain(axes.get_title("left") or axes.get_title())
    first = title if len(title) < LONGEST_TITLE else ""
    (label_x, names_x), (label_y, names_y) = (
        (write_plain(axis.get_label_text()), list_names(axis)) for axis in (axes.xaxis, axes.yaxis)
    )

    def describe(x: float, y: float, series: str) -> str:
        parts = [first, series, _describe_value(y, label_y, names_y), _describe_value(x, label_x, names_x)]
        return "; ".join(part for part in parts if part)

    return describe


def _describe_value(value: float, label: str, names: Sequence[tuple[float, str]]) -> str:
    if names:
        distance, name = min((abs(x - value), name) for x, name in names)
        return name if distance < 0.5 else ""
    return f"{label} {format_plain(value, 4)}" if label else format_plain(value, 4)
