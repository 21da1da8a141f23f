"""Drawing a figure as SVG of few bytes: what matplotlib draws on its canvas is written here at the same time.

Coordinates are points (72 an inch) from the upper left corner, to a tenth. Ids of a figure's own parts begin with
`OWN`, which its place in a page replaces; glyphs have the same ids in all figures: a page defines each of them once.
"""

from __future__ import annotations

import base64
import io
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from functools import cache, lru_cache
from inspect import signature
from typing import Any, NamedTuple

import numpy as np
from markupsafe import escape
from matplotlib.backend_bases import GraphicsContextBase, RendererBase
from matplotlib.colors import rgb2hex
from matplotlib.font_manager import FontProperties
from matplotlib.path import Path
from matplotlib.textpath import text_to_path as any_text_to_path
from matplotlib.transforms import Affine2D, Transform
from numpy.typing import ArrayLike
from PIL import Image

from bayescal.report.figure_text import TIP
from bayescal.report.pictures import OWN, POINTS

FONT_UNITS = 6400.0  # of a glyph's coordinates, for one em
COORDINATES, SHAPES = 1, 2  # decimals; the shape of a mark is drawn many times
FONTS = {"DejaVuSans": "G", "DejaVuSans-Oblique": "O", "DejaVuSans-Bold": "B"}  # how ids of their glyphs begin
text_to_path: Any = any_text_to_path  # whose types say less than it gives
FONT_UNIT = FONT_UNITS / text_to_path.FONT_SCALE
CAPS = {"projecting": "square", "butt": "butt", "round": "round"}
CONTROLS = {Path.CURVE3: 1, Path.CURVE4: 2}  # points of a curve before its end
OFF_HALVES = 1e-5  # of the last digit: a layout that differs by less is rounded alike
MOST_TEXTS, MOST_NUMBERS = 4096, 32768
_shapes: dict[str, tuple[np.ndarray, np.ndarray]] = {}
"""Vertices and codes of all glyphs that were written, by matplotlib's names of them."""


class Glyphs(NamedTuple):
    """A line of text: its glyphs as markup in units of the font, and the definitions that these refer to."""

    markup: str
    defined: tuple[tuple[str, str], ...]


class Writing(NamedTuple):
    """A text where it stands; the same text with the same looks may stand elsewhere in the figure."""

    looks: tuple[str, str, str]  # markup of its glyphs, scale, attributes
    x: str
    y: str
    angle: str


class Line(NamedTuple):
    """Paths that look the same."""

    data: list[str]
    looks: str

    def __str__(self) -> str:
        """Return the path's element."""
        return f'<path d="{"".join(self.data)}"{self.looks}/>'


class SvgRenderer(RendererBase):
    """Writes what is drawn with pixels of a resolution; ``tips`` has by a group's id what its marks stand for.

    Attributes
    ----------
    is_whole : bool
        Whether everything could be written; smoothly shaded triangles and filtered pixels cannot.
    glyphs : dict of str
        Definitions by their ids of the glyphs that texts refer to.
    """

    def __init__(self, width: float, height: float, dpi: float, tips: Mapping[str, Sequence[str]]) -> None:
        super().__init__()
        self.scale, self.dpi = POINTS / dpi, dpi
        self.width, self.height = width, height
        self.tips = tips
        self.is_whole = True
        self.glyphs: dict[str, str] = {}
        self._parts: list[str | Writing | Line] = []
        self._defined: dict[object, str] = {}  # ids of marks, clips and hatches
        self._definitions: list[str] = []
        self._groups: list[tuple[int, list[int], Sequence[str]]] = []  # open: begin, places of marks, tips
        self._line: Line | None = None  # the last path, where the next of the same looks may be part of it
        self._flipped = Affine2D().scale(self.scale, -self.scale).translate(0.0, height * self.scale)

    def write(self) -> str:
        """Return what stands inside the SVG."""
        writings = [one if isinstance(one, Writing) else None for one in self._parts]
        counts = Counter(one.looks for one in writings if one is not None)
        names: dict[tuple[str, str, str], str] = {}
        parts = list[str]()
        for part, one in zip(self._parts, writings, strict=True):
            if one is None:
                parts.append(str(part))
                continue
            glyphs, scale, attributes = one.looks
            if counts[one.looks] == 1:
                parts.append(
                    f'<g{attributes} transform="translate({one.x} {one.y}){one.angle}scale({scale})">{glyphs}</g>'
                )
                continue
            if one.looks not in names:
                names[one.looks] = f"{OWN}t{len(names)}"
                self._definitions.append(
                    f'<g id="{names[one.looks]}"{attributes} transform="scale({scale})">{glyphs}</g>'
                )
            at = f'transform="translate({one.x} {one.y}){one.angle}"' if one.angle else f'x="{one.x}" y="{one.y}"'
            parts.append(f'<use href="#{names[one.looks]}" {at}/>')
        definitions = f"<defs>{''.join(self._definitions)}</defs>" if self._definitions else ""
        return definitions + "".join(parts)

    # --- what matplotlib draws ---------------------------------------------------------------------------------------

    def open_group(self, s: str, gid: str | None = None) -> None:
        """Begin a group; only one with tips is written."""
        self._line = None
        self._groups.append((len(self._parts), [], self.tips.get(gid or "", ())))

    def close_group(self, s: str) -> None:
        """End a group: each of its marks gets its tip, or the whole group the only one."""
        self._line = None
        begin, marks, texts = self._groups.pop()
        if not texts:
            if self._groups:
                self._groups[-1][1].extend(marks)
            return
        titles = [f"<title>{escape(text)}</title>" for text in texts]
        head = f'<g class="{TIP.rstrip("-")}">'
        if len(texts) == 1 and len(marks) != 1:
            head += titles[0]
        elif len(marks) == len(texts):
            for place, title in zip(marks, titles, strict=True):
                self._parts[place] = f"{str(self._parts[place]).removesuffix('/>')}>{title}</use>"
        self._parts.insert(begin, head)
        self._parts.append("</g>")

    def draw_path(
        self,
        gc: GraphicsContextBase,
        path: Path,
        transform: Transform,
        rgbFace: Any = None,
    ) -> None:
        """Write a line or an area."""
        is_line = rgbFace is None and gc.get_hatch_path() is None
        clip = (0.0, 0.0, self.width * self.scale, self.height * self.scale) if is_line else None
        path = path.cleaned(
            transform + self._flipped,
            remove_nans=True,
            clip=clip,
            simplify=bool(path.should_simplify and is_line),
            curves=True,
            sketch=gc.get_sketch_params(),
        )
        self._put_path(gc, path, self._write_style(gc, rgbFace))

    def draw_markers(
        self,
        gc: GraphicsContextBase,
        marker_path: Path,
        marker_trans: Transform,
        path: Path,
        trans: Transform,
        rgbFace: Any = None,
    ) -> None:
        """Write a mark at each point of a path."""
        points = trans.transform(path.vertices)
        if path.codes is not None:  # a curve has its mark at its end
            whole = path.cleaned(trans, remove_nans=True, curves=True)
            ends = np.isin(np.asarray(whole.codes)[:-1], (Path.MOVETO, Path.LINETO))
            points = np.asarray(whole.vertices)[:-1][ends]
        shape = marker_path.cleaned(marker_trans + Affine2D().scale(self.scale, -self.scale), curves=True)
        points = points[np.isfinite(points).all(axis=-1)]
        self._put_marks(gc, points, [(shape, self._write_style(gc, rgbFace))] * len(points))

    def draw_path_collection(
        self,
        gc: GraphicsContextBase,
        master_transform: Transform,
        paths: Sequence[Path],
        all_transforms: Sequence[ArrayLike],
        offsets: ArrayLike | Sequence[ArrayLike],
        *others: object,
        **more: object,
    ) -> None:
        """Write marks at points, or lines and areas of the same kind."""
        helpers: Any = self  # of matplotlib, for those who draw collections
        if "hatchcolors" in signature(helpers._iter_collection).parameters:  # since 3.11
            more = {"hatchcolors": [], **more}
        shapes = [
            path.cleaned(transform + Affine2D().scale(self.scale, -self.scale), remove_nans=True, curves=True)
            for path, transform in helpers._iter_collection_raw_paths(master_transform, paths, all_transforms)
        ]
        points, marks = list[tuple[float, float]](), list[tuple[Path, str]]()
        for x, y, shape, own, face in helpers._iter_collection(gc, shapes, offsets, *others, **more):
            points.append((x, y))
            marks.append((shape, self._write_style(own, face)))
        if len(shapes) < len(points) or (self._groups and len(self._groups[-1][2]) > 1):
            self._put_marks(gc, np.array(points), marks)
            return
        for (x, y), (shape, style) in zip(points, marks, strict=True):
            at = (x * self.scale, (self.height - y) * self.scale)
            self._put_path(gc, Path(np.asarray(shape.vertices) + at, shape.codes), style)

    def draw_image(self, gc: GraphicsContextBase, x: float, y: float, im: ArrayLike, transform: object = None) -> None:
        """Write pixels, whose first row is the lowest."""
        pixels = np.asarray(im)
        height, width = (n * self.scale for n in pixels.shape[:2])
        if not height * width:
            return
        buffer = io.BytesIO()
        Image.fromarray(np.ascontiguousarray(pixels[::-1])).save(buffer, format="png")
        source = base64.b64encode(buffer.getvalue()).decode("ascii")
        at = f'x="{write_number(x * self.scale)}" y="{write_number((self.height - y) * self.scale - height)}"'
        size = f'width="{write_number(width)}" height="{write_number(height)}"'
        self._put(
            f'<image {at} {size} preserveAspectRatio="none" href="data:image/png;base64,{source}"/>', self._clip(gc)
        )

    def draw_gouraud_triangles(self, *arguments: object) -> None:
        """Leave out what SVG has nothing for."""
        self.is_whole = False

    def start_filter(self) -> None:
        """Leave out that pixels are filtered."""
        self.is_whole = False

    def draw_tex(self, *arguments: object, **more: object) -> None:
        """Leave out what TeX sets."""
        self.is_whole = False

    def draw_text(
        self,
        gc: GraphicsContextBase,
        x: float,
        y: float,
        s: str,
        prop: FontProperties,
        angle: float,
        ismath: object = False,
        mtext: object = None,
    ) -> None:
        """Write a line of text as glyphs."""
        glyphs = _set_text(s, prop.copy(), bool(ismath))
        if not glyphs.markup:
            return
        self.glyphs |= glyphs.defined
        opacity = gc.get_alpha() if gc.get_forced_alpha() else gc.get_rgb()[3]
        attributes = f' fill="{_write_colour(gc.get_rgb())}"{_write_share("opacity", opacity)}'
        size = f"{prop.get_size_in_points() / FONT_UNITS:.5g}".removeprefix("0")
        turned = f"rotate({-angle:g})" if angle else ""
        at = (write_number(x * self.scale), write_number(y * self.scale))
        self._put(Writing((glyphs.markup, size, attributes), *at, turned), self._clip(gc))

    def get_canvas_width_height(self) -> tuple[float, float]:
        """Return the figure's size, pixels."""
        return self.width, self.height

    def points_to_pixels(self, points: ArrayLike) -> ArrayLike:
        """Return pixels."""
        return np.asarray(points) / self.scale

    # --- how it is written -------------------------------------------------------------------------------------------

    def _put(self, part: str | Writing, clip: str = "") -> None:
        self._line = None
        self._parts.extend((f"<g{clip}>", part, "</g>") if clip else (part,))

    def _put_path(self, gc: GraphicsContextBase, path: Path, style: str) -> None:
        data = write_path(path)
        if not data or not style:
            return
        looks = f"{style}{self._clip(gc, path)}"
        if self._line is not None and self._line.looks == looks:
            self._line.data.append(data)
            return
        line = Line([data], looks)
        self._parts.append(line)
        self._line = None if "opacity" in style or "fill" in style else line

    def _put_marks(self, gc: GraphicsContextBase, points: np.ndarray, marks: Sequence[tuple[Path, str]]) -> None:
        """Write marks, shapes with styles, at points in pixels."""
        self._line = None
        if not len(points):
            return
        at = np.column_stack((points[:, 0], self.height - points[:, 1])) * self.scale
        names = dict[tuple[int, str], str]()
        for shape, style in marks:
            if (id(shape), style) not in names:
                names[id(shape), style] = self._define("m", "path", f' d="{write_path(shape, SHAPES)}"{style}/>')
        reach = max(
            float(np.abs(np.asarray(shape.vertices)).max()) for shape, _ in {id(one[0]): one for one in marks}.values()
        )
        clip = self._clip(gc, Path(at), reach)
        if clip:
            self._parts.append(f"<g{clip}>")
        for (x, y), (shape, style) in zip(at.tolist(), marks, strict=True):
            if self._groups:
                self._groups[-1][1].append(len(self._parts))
            place = f'x="{write_number(x)}" y="{write_number(y)}"'
            self._parts.append(f'<use href="#{names[id(shape), style]}" {place}/>')
        if clip:
            self._parts.append("</g>")

    def _define(self, kind: str, tag: str, rest: str) -> str:
        """Return the id of a definition, which is written where it is new."""
        key = (tag, rest)
        if key not in self._defined:
            self._defined[key] = f"{OWN}{kind}{len(self._defined)}"
            self._definitions.append(f'<{tag} id="{self._defined[key]}"{rest}')
        return self._defined[key]

    def _clip(self, gc: GraphicsContextBase, path: Path | None = None, reach: float = 0.0) -> str:
        """Return the attribute that clips, nothing where a path whose marks reach so far is inside anyway; points."""
        clipped: Any = gc.get_clip_path()  # a path, whatever its type says
        shape, transform = clipped
        if shape is not None:
            data = write_path(shape.cleaned(transform + self._flipped, curves=True))
            name = self._define("c", "clipPath", f'><path d="{data}"/></clipPath>')
            return f' clip-path="url(#{name})"'
        box = gc.get_clip_rectangle()
        if box is None:
            return ""
        x, y, width, height = box.bounds
        low = np.array([x, self.height - y - height]) * self.scale
        high = low + np.array([width, height]) * self.scale
        if path is not None:
            vertices = np.asarray(path.vertices)
            if path.codes is not None:
                vertices = vertices[np.asarray(path.codes) % Path.CLOSEPOLY > 0]
            if not len(vertices):
                return ""
            off = reach + gc.get_linewidth() / 2.0
            if (vertices.min(axis=0) - off >= low).all() and (vertices.max(axis=0) + off <= high).all():
                return ""
        numbers = [write_number(one) for one in (*low, *(high - low))]
        place = " ".join(f'{key}="{one}"' for key, one in zip(("x", "y", "width", "height"), numbers, strict=True))
        return f' clip-path="url(#{self._define("c", "clipPath", f"><rect {place}/></clipPath>")})"'

    def _write_style(self, gc: GraphicsContextBase, face: Any) -> str:
        """Return attributes of fill and stroke; nothing where there are neither."""
        forced = gc.get_forced_alpha()
        face = None if face is not None and len(face) == 4 and face[3] == 0 and not forced else face
        style = ""
        if gc.get_hatch() is not None:
            style += f' fill="url(#{self._hatch(gc, face)})"'
        elif face is not None:
            style += f' fill="{_write_colour(face)}"'
        if face is not None and len(face) == 4 and not forced:
            style += _write_share("fill-opacity", face[3])
        width, colour = gc.get_linewidth(), gc.get_rgb()
        if width and (forced or colour[3] > 0.0):
            style += f' stroke="{_write_colour(colour)}"'
            style += "" if width == 1.0 else f' stroke-width="{write_number(width, SHAPES)}"'
            style += "" if forced else _write_share("stroke-opacity", colour[3])
            offset, dashes = gc.get_dashes()
            if dashes is not None:
                style += f' stroke-dasharray="{" ".join(write_number(one, SHAPES) for one in np.asarray(dashes))}"'
                style += f' stroke-dashoffset="{write_number(offset, SHAPES)}"' if offset else ""
            if gc.get_joinstyle() != "round":
                style += f' stroke-linejoin="{gc.get_joinstyle()}"'
            if gc.get_capstyle() != "butt":
                style += f' stroke-linecap="{CAPS[gc.get_capstyle()]}"'
        return style + (_write_share("opacity", gc.get_alpha()) if forced and style else "")

    def _hatch(self, gc: GraphicsContextBase, face: Any) -> str:
        """Return the id of a pattern, as large as an inch."""
        across = Affine2D().scale(POINTS, -POINTS).translate(0.0, POINTS)
        data = write_path(gc.get_hatch_path().cleaned(across, curves=True))
        hatch_colour: Any = gc.get_hatch_color()
        colour, opacity = _write_colour(hatch_colour), _write_share("stroke-opacity", hatch_colour[3])
        ground = "" if face is None else f'<rect width="{POINTS:g}" height="{POINTS:g}" fill="{_write_colour(face)}"/>'
        line = f'stroke="{colour}" stroke-width="{write_number(gc.get_hatch_linewidth(), SHAPES)}"'
        drawn = f'{ground}<path d="{data}" fill="{colour}" {line}{opacity}/>'
        size = f'width="{POINTS:g}" height="{POINTS:g}" patternUnits="userSpaceOnUse"'
        return self._define("h", "pattern", f" {size}>{drawn}</pattern>")


@lru_cache(MOST_TEXTS)
def _set_text(text: str, font: FontProperties, is_mathematics: bool) -> Glyphs:
    """Return a line of text as glyphs."""
    if is_mathematics:
        glyphs, shapes, boxes = text_to_path.get_glyphs_mathtext(font, text, _shapes)
    else:
        glyphs, shapes, boxes = text_to_path.get_glyphs_with_font(text_to_path._get_font(font), text, _shapes)
    _shapes.update(shapes)  # no empty dictionary is filled by the former
    drawn, defined = list[str](), dict[str, str]()
    for name, x, y, size in glyphs:
        own, definition = _define_glyph(name)
        if not definition:
            continue  # a space
        defined[own] = definition
        across, up = round(x * FONT_UNIT), round(-y * FONT_UNIT)
        if size == 1.0:
            place = "".join(f' {key}="{one}"' for key, one in (("x", across), ("y", up)) if one)
        else:
            place = f' transform="translate({across} {up})scale({write_number(size, 3)})"'
        drawn.append(f'<use href="#{own}"{place}/>')
    for vertices, codes in boxes:
        path = Path(np.asarray(vertices) * (FONT_UNIT, -FONT_UNIT), codes)
        drawn.append(f'<path d="{write_path(path.cleaned(curves=True), 0)}"/>')
    return Glyphs("".join(drawn), tuple(defined.items()))


@cache
def _define_glyph(name: str) -> tuple[str, str]:
    """Return a glyph's id and its definition, which is empty where nothing is drawn."""
    family, _, number = name.rpartition("-")
    own = f"{FONTS.get(family, f'{family}-')}{number}".replace("%", "_")
    vertices, codes = _shapes[name]
    if not len(vertices):
        return own, ""
    path = Path(np.asarray(vertices) * (FONT_UNIT, -FONT_UNIT), codes)
    return own, f'<path id="{own}" d="{write_path(path.cleaned(curves=True), 0)}"/>'


def _write_colour(colour: Sequence[float]) -> str:
    text = _name_colour(float(colour[0]), float(colour[1]), float(colour[2]))
    return f"#{text[1]}{text[3]}{text[5]}" if text[1::2] == text[2::2] else text


@lru_cache(MOST_TEXTS)
def _name_colour(red: float, green: float, blue: float) -> str:
    return rgb2hex((red, green, blue))


def _write_share(key: str, share: float) -> str:
    return "" if share is None or share == 1.0 else f' {key}="{write_number(share, 3)}"'


def write_number(value: float, decimals: int = COORDINATES) -> str:
    """Return a number in as few characters as SVG takes."""
    return _write_units(round(float(value) * 10**decimals + OFF_HALVES), decimals)


@lru_cache(MOST_NUMBERS)
def _write_units(units: int, decimals: int) -> str:
    whole, rest = divmod(abs(units), 10**decimals)
    sign = "-" if units < 0 else ""
    behind = f"{rest:0{decimals}d}".rstrip("0") if rest else ""
    return f"{sign}{whole or '' if behind else whole}{'.' if behind else ''}{behind}"


def write_path(path: Path, decimals: int = COORDINATES) -> str:
    """Return a cleaned path's data: relative, rounded so that errors do not add up; nothing of one without a line."""
    vertices = np.rint(np.asarray(path.vertices) * 10.0**decimals + OFF_HALVES).astype(np.int64).tolist()
    steps: list[tuple[str, list[int]]] = []
    x = y = 0  # where the pen is
    start = waiting = [0, 0]  # of this part; where it begins, as long as nothing of it is drawn
    is_begun = is_dot = False
    controls: list[list[int]] = []  # points of a curve up to its end
    for code, point in zip(np.asarray(path.codes).tolist(), vertices, strict=True):
        if code in (Path.MOVETO, Path.STOP):
            if is_dot and not is_begun:  # a cap alone
                steps += [_move(waiting, x, y, steps), ("h", [0])]
                x, y = waiting
            waiting = start = point
            is_begun = is_dot = False
        elif code == Path.CLOSEPOLY:
            if is_begun:
                steps.append(("z", []))
                x, y = waiting = start
                is_begun = False
        elif code != Path.LINETO and len(controls) < CONTROLS[code]:
            controls.append(point)
        else:
            if not is_begun:
                if point == waiting and all(one == waiting for one in controls):
                    is_dot, controls = True, []
                    continue
                steps.append(_move(waiting, x, y, steps))
                x, y = waiting
                is_begun = True
            to_x, to_y = point
            across, down = to_x - x, to_y - y
            if controls:
                letter = "q" if len(controls) == 1 else "c"
                steps.append((letter, [one for at, on in (*controls, point) for one in (at - x, on - y)]))
                controls = []
            elif across and down:
                steps.append(("l", [across, down]))
            elif step := across or down:
                letter, (last, numbers) = "h" if across else "v", steps[-1]
                if last == letter and (numbers[0] > 0) == (step > 0):
                    numbers[0] += step
                else:
                    steps.append((letter, [step]))
            x, y = to_x, to_y
    return _join_steps(steps, decimals)


def _move(to: Sequence[int], x: int, y: int, before: Sequence[object]) -> tuple[str, list[int]]:
    return ("m", [to[0] - x, to[1] - y]) if before else ("M", list(to))


def _join_steps(steps: Iterable[tuple[str, list[int]]], decimals: int) -> str:
    """Return letters and numbers with what keeps them apart where it is needed."""
    parts, last, before = list[str](), "", ""
    for letter, numbers in steps:
        if letter != last or letter == "m":
            parts.append(letter)
            before = ""
        for number in numbers:
            text = _write_units(number, decimals)
            if before and text[0] != "-" and (text[0] != "." or "." not in before):
                parts.append(" ")
            parts.append(text)
            before = text
        last = letter
    return "".join(parts)
