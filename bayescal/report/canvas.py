"""What figures are laid out and drawn on, as pixels and as SVG at once; every text is measured once."""

from __future__ import annotations

import io
from collections.abc import Callable, Mapping, Sequence
from functools import lru_cache
from typing import Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg, RendererAgg
from matplotlib.font_manager import FontProperties, findfont, get_font
from PIL import Image

from bayescal.report.svg import SvgRenderer

MOST_TEXTS, MOST_FONTS = 8192, 256
OPAQUE = (255, 255)  # lowest and highest opacity
COMPRESSION = 3  # of 9 for PNG; the usual 6 takes half as long again and saves a fiftieth
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
        """Return the figure as PNG, whose pixels have no opacity where all are opaque."""
        self.draw()  # type: ignore[no-untyped-call]  # of matplotlib
        buffer = io.BytesIO()
        image = Image.fromarray(np.asarray(self.get_renderer().buffer_rgba()))  # type: ignore[no-untyped-call]
        if image.getchannel("A").getextrema() == OPAQUE:
            image = image.convert("RGB")
        image.save(buffer, format="png", compress_level=COMPRESSION, dpi=(self.figure.dpi, self.figure.dpi))
        return buffer.getvalue()


def _do_both(first: Callable[..., None], second: Callable[..., None]) -> Callable[..., None]:
    def do(*arguments: object, **more: object) -> None:
        first(*arguments, **more)
        second(*arguments, **more)

    return do


class Renderer(RendererAgg):
    """A renderer that knows a text's size from any other one of its resolution: figures have the same numbers."""

    def get_text_width_height_descent(self, s: str, prop: FontProperties, ismath: object) -> tuple[float, float, float]:
        """Return width, height and descent of a line of text, pixels."""
        return _measure(s, prop.copy(), ismath, self.dpi)

    def _get_font_height_metrics(self, prop: FontProperties) -> tuple[float | None, float | None, float | None]:
        """Return ascent, descent and gap of a font's lines, pixels; matplotlib would read the font for each text."""
        return _measure_lines(prop.copy(), self.dpi)


@lru_cache(MOST_TEXTS)
def _measure(text: str, font: FontProperties, ismath: object, dpi: float) -> tuple[float, float, float]:
    ruler: Any = _make_ruler(dpi)
    width, height, descent = ruler.get_text_width_height_descent(text, font, ismath)
    return width, height, descent


@lru_cache(1)
def _make_ruler(dpi: float) -> RendererAgg:
    return RendererAgg(1, 1, dpi)  # type: ignore[no-untyped-call]  # of matplotlib


@lru_cache(MOST_FONTS)
def _measure_lines(prop: FontProperties, dpi: float) -> tuple[float | None, float | None, float | None]:
    """Return what `matplotlib.text.Text` finds of a font, in the same order of its tables; None of one without."""
    font: Any = get_font(findfont(prop))
    typographic, horizontal = font.get_sfnt_table("OS/2"), font.get_sfnt_table("hhea")
    if typographic is not None:
        lines = typographic["sTypoAscender"], -typographic["sTypoDescender"], typographic["sTypoLineGap"]
    elif horizontal is not None:
        lines = horizontal["ascent"], -horizontal["descent"], horizontal["lineGap"]
    else:
        return None, None, None
    scale = 1 / font.get_sfnt_table("head")["unitsPerEm"] * prop.get_size_in_points() * dpi / 72
    ascent, descent, gap = (scale * one for one in lines)
    return ascent, descent, gap
