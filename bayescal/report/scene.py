"""A machine in space: points, lines and poses that a page lets one turn; a still picture where nothing runs."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import ClassVar, Literal

from markupsafe import Markup

from bayescal.report.numbers import format_plain

type Triple = tuple[float, float, float]
type Group = Literal["base", "platform", "leg", "guide", "moved"]

AZIMUTH, ELEVATION = -55.0, 22.0  # degrees, at the beginning
HALF_WIDTH, HALF_HEIGHT, MARGIN = 320.0, 230.0, 34.0
RADIUS = 3.4
DIGITS = 7


@dataclass(frozen=True)
class ScenePoint:
    """A point of a machine."""

    name: str  # in words, such as ``b of leg 2``
    group: Group
    at: tuple[Triple, ...]  # where it stands, mm: once, or once for each pose of the scene
    offset: Triple = (0.0, 0.0, 0.0)  # how far it was found from there, mm; zeros for nothing
    spread: Triple = (0.0, 0.0, 0.0)  # standard deviations of its coordinates, mm; zeros for nothing


@dataclass(frozen=True)
class SceneLine:
    """A line through points, by their numbers; closed ones are areas."""

    points: tuple[int, ...]
    group: Group
    closed: bool = False


@dataclass(frozen=True, eq=False)
class Scene:
    """A machine that can be turned."""

    block: ClassVar = "scene"
    name: str
    caption: str
    alt: str  # what is seen
    points: tuple[ScenePoint, ...]
    lines: tuple[SceneLine, ...]
    poses: tuple[str, ...] = ("home",)  # names of the poses, the one shown at first before all others
    labels: tuple[tuple[str, tuple[int, ...]], ...] = ()  # symbols, each in the middle of points
    # how many times offsets and standard deviations are drawn too large at first; zero where there are none
    magnified: float = 0.0

    @property
    def data(self) -> str:
        """What the script turns, as JSON."""
        points = [
            {"name": p.name, "group": p.group, "at": [_round(x) for x in p.at]}
            | ({"offset": _round(p.offset)} if any(p.offset) else {})
            | ({"spread": _round(p.spread)} if any(p.spread) else {})
            for p in self.points
        ]
        lines = [{"points": one.points, "group": one.group, "closed": one.closed} for one in self.lines]
        content = {"points": points, "lines": lines, "poses": self.poses, "labels": self.labels}
        view = {"azimuth": AZIMUTH, "elevation": ELEVATION, "magnified": self.magnified}
        return json.dumps(content | view, ensure_ascii=False, separators=(",", ":"))

    @property
    def still(self) -> Markup:
        """The picture at the beginning, as the inside of an SVG."""
        return Markup("").join(_draw(self))


def choose_magnification(points: Sequence[ScenePoint]) -> float:
    """Return a round factor by which the largest offset or standard deviation becomes an eighth of the machine."""
    largest = max((math.dist((0, 0, 0), one) for p in points for one in (p.offset, p.spread)), default=0.0)
    if largest == 0.0:
        return 0.0
    size = max(math.dist(_middle([p.at[0] for p in points]), p.at[0]) for p in points)
    power = math.floor(math.log10(size / 4 / largest))
    return float(10.0**power * max(k for k in (1, 2, 5) if k * 10.0**power <= size / 4 / largest))


# --- the still picture -------------------------------------------------------------------------------------------


def _draw(scene: Scene) -> Iterator[Markup]:
    project = _Projection([x for p in scene.points for x in p.at])
    places = [project(p.at[0]) for p in scene.points]
    moved = [project(_move(p, scene.magnified)) for p in scene.points]
    for line in scene.lines:
        path = "M" + "L".join(f"{x:.1f} {y:.1f}" for x, y in (places[k] for k in line.points))
        yield Markup('<path class="{}" d="{}"/>').format(line.group, path + ("Z" if line.closed else ""))
    for point, (x, y), (u, v) in zip(scene.points, places, moved, strict=True):
        if any(point.offset):
            yield Markup('<path class="moved" d="M{} {}L{} {}"/>').format(*(f"{one:.1f}" for one in (x, y, u, v)))
        circle = '<circle class="{} tip" cx="{}" cy="{}" r="{}"><title>{}</title></circle>'
        yield Markup(circle).format(point.group, f"{x:.1f}", f"{y:.1f}", RADIUS, describe_point(point))
    for text, members in scene.labels:
        x, y = (sum(places[k][axis] for k in members) / len(members) for axis in (0, 1))
        yield Markup('<text x="{}" y="{}">{}</text>').format(f"{x + 7:.1f}", f"{y - 7:.1f}", text)


def describe_point(point: ScenePoint) -> str:
    """Return where a point stands, in words."""
    text = f"{point.name}: {_list(point.at[0])} mm"
    if any(point.offset):
        text += f"; found {_list(point.offset)} mm from there"
    return text + (f"; known to {_list(point.spread)} mm" if any(point.spread) else "")


def _list(triple: Triple) -> str:
    return ", ".join(format_plain(x, 4) for x in triple)


def _move(point: ScenePoint, times: float) -> Triple:
    x, y, z = (at + times * by for at, by in zip(point.at[0], point.offset, strict=True))
    return x, y, z


def _middle(points: Sequence[Triple]) -> Triple:
    x, y, z = ((min(axis) + max(axis)) / 2 for axis in zip(*points, strict=True))
    return x, y, z


class _Projection:
    """Projects points of the base frame, mm, to the picture, as the script does."""

    def __init__(self, points: Sequence[Triple]) -> None:
        self.middle = _middle(points)
        size = max(math.dist(self.middle, one) for one in points) or 1.0
        self.scale = (HALF_HEIGHT - MARGIN) / size

    def __call__(self, point: Triple) -> tuple[float, float]:
        x, y, z = (self.scale * (one - by) for one, by in zip(point, self.middle, strict=True))
        a, e = math.radians(AZIMUTH), math.radians(ELEVATION)
        across, away = x * math.cos(a) - y * math.sin(a), x * math.sin(a) + y * math.cos(a)
        return across, -(z * math.cos(e) + away * math.sin(e))


def _round(triple: Triple) -> list[float]:
    return [float(f"{x:.{DIGITS}g}") for x in triple]
