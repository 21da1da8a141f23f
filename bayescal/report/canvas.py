"""What figures are laid out and drawn on, as pixels and as SVG at once; every text is measured once."""

from __future__ import annotations

import io
from collections.abc import Callable, Mapping, Sequence
from functools import lru_cache
from typing import Any

from matplotlib.backends.backend_agg import FigureCanvasAgg, RendererAgg
from matplotlib.font_manager import FontProperties

from bayescal.report.svg import SvgRenderer

MOST_TEXTS = 8192
DRAWN = (
    *("draw_path", "draw_markers", "draw_path_collection", "draw_quad_mesh", "draw_gouraud_triangles"),
    *("draw_image", "draw_text", "draw_tex", "open_group", "close_group", "start_filter"),
)


class Canvas(FigureCanvasAgg):
    """A canvas whose renderer stays as long as the figure's size does; a bare figure makes one at every question."""

    def get_renderer(self) -> RendererAgg:
        """Return a renderer of the figure's size and resolution."""
        size = (*self.get_width_height(physical=True), self.figure.dpi)
        if self._lastKey != size:
            self.renderer, self._lastKey = Renderer(*size), size  # type: ignore[no-untyped-call]  # of matplotlib
        return self.renderer

    def draw_both(self, tips: Mapping[str, Sequence[str]]) -> tuple[bytes, SvgRenderer]:
        """Draw the figure once; return it as PNG and as SVG, with tips at the marks of groups."""
        renderer = self.get_renderer()
        svg = SvgRenderer(renderer.width, renderer.height, self.figure.dpi, tips)
        for name in DRAWN:
            setattr(renderer, name, _do_both(getattr(renderer, name), getattr(svg, name)))
        png = self.save()
        self._lastKey = None  # what is drawn next is drawn as pixels alone
        return png, svg

    def save(self) -> bytes:
        """Return the figure as PNG."""
        buffer = io.BytesIO()
        self.print_png(buffer, metadata={"Software": None})  # type: ignore[no-untyped-call]  # of matplotlib
        return buffer.getvalue()


def _do_both(first: Callable[..., None], second: Callable[..., None]) -> Callable[..., None]:
    def do(*arguments: Any, **more: Any) -> None:
        first(*arguments, **more)
        second(*arguments, **more)

    return do


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
