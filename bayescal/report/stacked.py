"""Figures for a phone: the panels of a wide one below each other, its letters as large as they are."""

from __future__ import annotations

import re
import textwrap
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from bayescal.report.figure_text import list_names

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.axis import Axis
    from matplotlib.figure import Figure
    from matplotlib.legend import Legend
    from matplotlib.text import Text

NARROW = 3.6  # inches: on a screen of 390 pixels letters of 7 points have 9.5 pixels
NEEDS_STACKING = 3.9  # narrower figures are shown as they are
LEAST_HEIGHT, MOST_HEIGHT = 0.5, 3.2  # of a panel, inches
LEAST_SIZE = 7.0  # points of a letter
LETTER = 0.56  # width of a letter in units of its size, DejaVu Sans
AROUND, LEGEND_LINE = 0.9, 0.25  # inches for labels of a row of panels, and a line of a legend, to begin with
LINE = 1.3  # height of a line in units of a letter's size
NAME_SHARE = 0.42  # of the width, for names at the left


def needs_stacking(figure: Figure) -> bool:
    """Whether a figure is too wide for a phone."""
    return float(figure.get_figwidth()) > NEEDS_STACKING


def measure_panels(figure: Figure) -> tuple[np.ndarray, float]:
    """Return heights (P,) of the panels of a laid-out figure, and the width that each has for itself, inches."""
    panels = _list_panels(figure)
    tops = [round(axes.get_position().y1, 2) for axes in panels]
    abreast = max((tops.count(top) for top in tops), default=1)
    return np.array([_height_of(axes) for axes in panels]), float(figure.get_figwidth()) / abreast


def stack_panels(figure: Figure, wide_heights: np.ndarray, wide: float) -> None:
    """Give the panels of a figure places below each other, as wide as a phone; small ones stay side by side.

    What the panels shared is written at each that lost its neighbour; titles, names and legends are broken into lines.
    The figure is drawn, not laid out, and is left to be laid out; heights and width are what `measure_panels` returns.
    """
    panels = _list_panels(figure)
    if not panels:
        return
    for empty in set(figure.axes) - set(panels):
        empty.set_visible(False)
    n_columns = max(1, min(len(panels), int(NARROW / wide + 0.1)))
    n_rows = -(-len(panels) // n_columns)
    rows = [wide_heights[k * n_columns : (k + 1) * n_columns].max() for k in range(n_rows)]
    heights = np.clip(rows, LEAST_HEIGHT, MOST_HEIGHT)
    _write_what_was_shared(panels, n_columns)
    _break_lines(figure, panels, heights, n_columns)
    for k, axes in enumerate(panels):
        heights[k // n_columns] = max(heights[k // n_columns], _room_for_names(axes))
    grid = figure.add_gridspec(n_rows, n_columns, height_ratios=heights)
    for k, axes in enumerate(panels):
        axes.set_subplotspec(grid[divmod(k, n_columns)])
    lines = sum([_narrow_legend(figure, legend) for legend in list(figure.legends)])
    figure.set_size_inches(NARROW, float(heights.sum() + AROUND * n_rows + LEGEND_LINE * lines))
    figure.set_layout_engine("constrained")
    _lay_out(figure)
    _settle(figure, panels, float(heights.sum()))


def _lay_out(figure: Figure) -> None:
    engine = figure.get_layout_engine()
    assert engine is not None  # `stack_panels` gave it one
    engine.execute(figure)


def _list_panels(figure: Figure) -> list[Axes]:
    """Return the panels that show something; a grid's last places may be left empty."""
    return [axes for axes in figure.axes if axes.get_visible() and (axes.axison or axes.has_data() or axes.texts)]


def _height_of(axes: Axes) -> float:
    figure = axes.get_figure(root=True)
    assert figure is not None
    return float(axes.get_position().height * figure.get_figheight())


# --- what panels shared ------------------------------------------------------------------------------------------


def _write_what_was_shared(panels: list[Axes], n_columns: int) -> None:
    for k, axes in enumerate(panels):
        left = panels[k - 1] if k % n_columns else None
        below = panels[k + n_columns] if k + n_columns < len(panels) else None
        if left not in _siblings(axes, "y"):
            _write_axis(axes, "y", "labelleft")
        if below not in _siblings(axes, "x"):
            _write_axis(axes, "x", "labelbottom")
        elif n_columns == 1 or below is not None:
            axes.set_xlabel("")


def _siblings(axes: Axes, kind: str) -> list[Axes]:
    grouper = axes.get_shared_x_axes() if kind == "x" else axes.get_shared_y_axes()
    return [one for one in grouper.get_siblings(axes) if one is not axes]


def _write_axis(axes: Axes, kind: str, labels: str) -> None:
    """Write ticks and label of an axis where they were left to a neighbour."""
    siblings = _siblings(axes, kind)
    if not siblings or not axes.axison:
        return
    axis: Axis = getattr(axes, f"{kind}axis")
    axis.set_tick_params(which="both", **{labels: True})
    axis.offsetText.set_visible(True)
    if not axis.get_label_text():
        said = [getattr(one, f"{kind}axis").get_label_text() for one in siblings]
        axis.set_label_text(next(filter(None, said), ""))
    axis.label.set_visible(True)


# --- lines -------------------------------------------------------------------------------------------------------


def _break_lines(figure: Figure, panels: list[Axes], heights: np.ndarray, n_columns: int) -> None:
    width = NARROW / n_columns
    for k, axes in enumerate(panels):
        _wrap(axes.yaxis.label, float(heights[k // n_columns]) + 0.5)
        names = [name for _, name in list_names(axes.yaxis)]
        longest = NAME_SHARE * width * 72.0 / (LETTER * _tick_size(axes.yaxis))
        if any(len(name) > longest for name in names):
            ticks = axes.get_yticks()
            axes.set_yticks(ticks, [_fill(text.get_text(), longest) for text in axes.get_yticklabels()])
    for text in (figure._suptitle, figure._supxlabel):  # type: ignore[attr-defined]  # of matplotlib
        if text is not None:
            _wrap(text, 0.9 * NARROW)


def _room_for_names(axes: Axes) -> float:
    """Return the height, inches, at which names of several lines at the left do not meet."""
    lines = [name.count("\n") + 1 for name in (text.get_text() for text in axes.get_yticklabels())]
    return (
        len(lines) * max(lines, default=1) * LINE * _tick_size(axes.yaxis) / 72.0 if max(lines, default=1) > 1 else 0.0
    )


def _tick_size(axis: Axis) -> float:
    labels = axis.get_ticklabels()
    return float(labels[0].get_fontsize()) if labels else 8.0


def _wrap(text: Text, inches: float) -> bool:
    """Break a text into lines; return whether it was too long."""
    said = text.get_text()
    text.set_text(_fill(said, inches * 72.0 / (LETTER * float(text.get_fontsize()))))
    return text.get_text() != said


def _fill(text: str, letters: float) -> str:
    """Return text in lines; mathematics and what is broken already stay whole."""
    if "\n" in text or len(text) <= letters:
        return text
    kept = re.sub(r"\$[^$]*\$", lambda found: found[0].replace(" ", "\0"), text)
    return "\n".join(textwrap.wrap(kept, max(8, int(letters)), break_long_words=False)).replace("\0", " ")


# --- legends -----------------------------------------------------------------------------------------------------


def _narrow_legend(figure: Figure, legend: Legend) -> int:
    """Put a legend in the place of a figure's own, with as many columns as there is room for; return its lines."""
    names = [text.get_text() for text in legend.get_texts()]
    size = float(legend.get_texts()[0].get_fontsize()) if names else 8.0
    drawn: dict[str, Any] = {}
    for axes in figure.axes:
        drawn |= dict(zip(*axes.get_legend_handles_labels()[::-1], strict=True))
    handles: list[Any] = [drawn.get(name, handle) for name, handle in zip(names, legend.legend_handles, strict=True)]
    letters = NARROW * 72.0 / (LETTER * size)
    longest = max((len(name) for name in names), default=0) + 6
    title = legend.get_title().get_text()
    legend.remove()
    written = [_fill(name, letters - 8) for name in names]
    n_columns = max(1, min(len(names), int(letters / longest)))
    figure.legend(
        handles,
        written,
        loc="outside upper left",
        ncols=n_columns,
        title=_fill(title, letters),
        fontsize=max(size, LEAST_SIZE),
        alignment="left",
    )
    return 1 + -(-sum(text.count("\n") + 1 for text in written) // n_columns)


# --- what only shows when it is laid out -------------------------------------------------------------------------


def _settle(figure: Figure, panels: list[Axes], wanted: float) -> None:
    """Turn names that run into each other, put legends below their panels, and give panels the height they want."""
    changed = [_turn_names(axes) | _break_titles(axes) for axes in panels]
    below = sum(_lower_legend(axes) for axes in panels)
    figure.set_size_inches(NARROW, figure.get_figheight() + below)
    crowded = [text for axes in panels if _overlap(_extents(axes.texts)) for text in axes.texts]
    for text in crowded:
        text.set_visible(False)  # each value stands in a table, or under the pointer
    if any(changed) or below or crowded:
        _lay_out(figure)
    rows = {axes.get_subplotspec().rowspan.start: axes for axes in panels}  # type: ignore[union-attr]  # all have one
    figure.set_size_inches(NARROW, figure.get_figheight() + wanted - sum(map(_height_of, rows.values())))


def _turn_names(axes: Axes) -> bool:
    """Turn the names below a panel where they run into each other; return whether they did."""
    if not (axes.axison and _overlap(_extents(axes.get_xticklabels()))):
        return False
    axes.xaxis.set_tick_params(rotation=90)
    return True


def _break_titles(axes: Axes) -> bool:
    """Break what stands above and below a panel into lines, by the width that names at its left have left.

    Returns whether anything was too long.
    """
    box = axes.get_position()
    titles = (axes.title, axes._left_title, axes._right_title)  # type: ignore[attr-defined]  # of matplotlib
    broken = [_wrap(title, NARROW * (1.0 - box.x0)) for title in titles]
    return any([*broken, _wrap(axes.xaxis.label, NARROW * box.width)])


def _extents(texts: Sequence[Text]) -> np.ndarray:
    """Return where texts stand, (N, 4) left, bottom, right and top, pixels."""
    boxes = [text.get_window_extent().extents for text in texts if text.get_text() and text.get_visible()]
    return np.array(boxes, dtype=np.float64).reshape(-1, 4)


def _overlap(boxes: np.ndarray) -> bool:
    """Whether a text runs into another one."""
    low = np.maximum(boxes[:, None, :2], boxes[:, :2])
    high = np.minimum(boxes[:, None, 2:], boxes[:, 2:])
    return bool(np.triu((low < high).all(axis=-1), 1).any())


def _lower_legend(axes: Axes) -> float:
    """Put a legend below its panel where it would cover half of it, and return its height, inches."""
    legend, figure = axes.get_legend(), axes.get_figure(root=True)
    if legend is None or figure is None:
        return 0.0
    box, area = legend.get_window_extent(), axes.get_window_extent()
    if box.width < 0.45 * area.width and box.height < 0.45 * area.height:
        return 0.0
    if box.width > area.width:  # its columns cannot stay side by side
        return LEGEND_LINE * _narrow_legend(figure, legend)
    below = axes.xaxis.get_tightbbox()
    bottom = (below.y0 - area.y0) / area.height if below is not None else 0.0
    legend.set_loc("upper left")
    legend.set_bbox_to_anchor((0.0, bottom), transform=axes.transAxes)
    return float(box.height / figure.dpi) + LEGEND_LINE
