"""What figures are laid out and drawn on: every text is measured once, whatever figure it stands in."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

from matplotlib.backends.backend_agg import FigureCanvasAgg, RendererAgg
from matplotlib.font_manager import FontProperties

MOST_TEXTS = 8192


class Canvas(FigureCanvasAgg):
    """A canvas whose renderer stays as long as the figure's size does; a bare figure makes one at every question."""

    def get_renderer(self) -> RendererAgg:
        """Return a renderer of the figure's size and resolution."""
        size = (*self.get_width_height(physical=True), self.figure.dpi)
        if self._lastKey != size:
            self.renderer, self._lastKey = Renderer(*size), size  # type: ignore[no-untyped-call]  # of matplotlib
        return self.renderer


class Renderer(RendererAgg):
    """A renderer that knows a text's size from any other one of its resolution: figures have the same numbers."""

    def get_text_width_height_descent(self, s: str, prop: FontProperties, ismath: object) -> tuple[float, float, float]:
        """Return width, height and descent of a line of text, pixels."""
        return _measure(s, prop.copy(), ismath, self.dpi)


@lru_cache(MOST_TEXTS)
def _measure(text: str, font: FontProperties, ismath: object, dpi: float) -> tuple[float, float, float]:
    ruler: Any = _make_ruler(dpi)
    width, height, descent = ruler.get_text_width_height_descent(text, font, ismath)
    return width, height, descent


@lru_cache(1)
def _make_ruler(dpi: float) -> RendererAgg:
    return RendererAgg(1, 1, dpi)  # type: ignore[no-untyped-call]  # of matplotlib
