"""Drawings of machines that can be turned, from tables of their joints."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import pandas as pd

from bayescal.report.numbers import format_plain
from bayescal.report.scene import Group, Scene, SceneLine, ScenePoint, Triple, choose_magnification

type Joint = tuple[str, int]
"""``base`` or ``platform``, and the number of the leg."""

SYMBOLS = {"base": "a", "platform": "b"}
AXES = ("x", "y", "z")
ORIGIN: Triple = (0.0, 0.0, 0.0)
CAPTION = "Joints. Leg 1: a, base joint; b, platform joint (blue); l, leg length{}."
DRIVES = {
    True: "; u, actuator direction; ρ, its travel",
    False: ", which ρ changes",
}
FOUND = " Orange: deviations from nominal, {}-fold (b: platform frame); bars: sd."
KNOWN = " Orange bars: posterior sd, {}-fold."


def build_scene(
    joints: pd.DataFrame, offsets: Mapping[Joint, Triple] | None = None, spreads: Mapping[Joint, Triple] | None = None
) -> Scene | None:
    """Return the drawing of a machine on legs; None without its joints.

    Parameters
    ----------
    joints : DataFrame
        From `joints.tabulate_joints`.
    offsets, spreads : mapping of joint to triple, optional
        How far joints were found from nominal and how well that is known, mm.
    """
    if joints.empty:
        return None
    offsets, spreads = offsets or {}, spreads or {}
    poses = list(dict.fromkeys(joints["pose"]))
    legs = sorted({int(leg) for leg in joints["leg"]})
    places: dict[tuple[str, str, int], Triple] = {
        (str(row["pose"]), str(row["joint"]), int(row["leg"])): (row["x_mm"], row["y_mm"], row["z_mm"])
        for row in joints.to_dict("records")
    }
    points: list[ScenePoint] = []
    for joint in SYMBOLS:
        for leg in legs:
            at = tuple(places[pose, joint, leg] for pose in poses)
            words = f"{SYMBOLS[joint]} of leg {leg}"
            group: Group = "base" if joint == "base" else "platform"
            points.append(
                ScenePoint(words, group, at, offsets.get((joint, leg), ORIGIN), spreads.get((joint, leg), ORIGIN))
            )
    n = len(legs)
    lines = [SceneLine(_order(points[k : k + n], k), points[k].group, closed=True) for k in (0, n)]
    lines += [SceneLine((k, n + k), "leg") for k in range(n)]
    has_guides = (poses[0], "from", legs[0]) in places
    for leg in legs if has_guides else ():
        for end in ("from", "to"):
            points.append(ScenePoint(f"end of guide {leg}", "guide", (places[poses[0], end, leg],)))
        lines.append(SceneLine((len(points) - 2, len(points) - 1), "guide"))
    labels = [("a", (0,)), ("b", (n,)), ("l", (0, n))]
    if has_guides:
        labels.append(("u, ρ", (2 * n + 1,)))
    magnified = choose_magnification(points)
    told = FOUND if any(any(one) for one in offsets.values()) else KNOWN
    caption = CAPTION.format(DRIVES[has_guides]) + (told.format(format_plain(magnified)) if magnified else "")
    poses_said = f"; {len(poses) - 1} poses can be chosen" if len(poses) > 1 else ""
    alt = f"Machine with {n} legs between base and platform joints{poses_said}."
    return Scene("machine", caption, alt, tuple(points), tuple(lines), tuple(poses), tuple(labels), magnified)


def _order(points: Sequence[ScenePoint], first: int) -> tuple[int, ...]:
    """Return the points' numbers around their middle, seen from above, so that the outline does not cross itself."""
    x, y = (sum(p.at[0][axis] for p in points) / len(points) for axis in (0, 1))
    around = sorted(range(len(points)), key=lambda k: math.atan2(points[k].at[0][1] - y, points[k].at[0][0] - x))
    return tuple(first + k for k in around)


def read_joint_columns(parameters: pd.DataFrame, column: str) -> dict[Joint, Triple]:
    """Return a column of the joints' parameters, coordinate by coordinate; zero where one is not among them.

    Parameters
    ----------
    parameters : DataFrame
        One row per parameter with columns symbol (``a_x`` to ``b_z``), leg and the wanted one, mm.
    """
    values = {(str(row["symbol"]), int(row["leg"])): float(row[column]) for row in parameters.to_dict("records")}
    found: dict[Joint, Triple] = {}
    for joint, symbol in SYMBOLS.items():
        for leg in sorted({leg for _, leg in values if leg}):
            x, y, z = (values.get((f"{symbol}_{axis}", leg), 0.0) for axis in AXES)
            found[joint, leg] = (x, y, z)
    return found


def build_line_scene(
    anchors: Sequence[Triple], offsets: Sequence[Triple], spreads: Sequence[Triple], places: Mapping[str, Triple]
) -> Scene:
    """Return the drawing of a point on lines: anchors with how far they were found from nominal, and its places.

    Parameters
    ----------
    anchors, offsets, spreads : sequences of triples
        Line by line, mm.
    places : mapping of str to triple
        Where the point stands, by the names of the poses, mm.
    """
    points = [
        ScenePoint(f"A of line {k}", "base", (at,), offset, spread)
        for k, (at, offset, spread) in enumerate(zip(anchors, offsets, spreads, strict=True), start=1)
    ]
    points.append(ScenePoint("point", "platform", tuple(places.values())))
    last = len(points) - 1
    lines = tuple(SceneLine((k, last), "leg") for k in range(last))
    magnified = choose_magnification(points)
    caption = "A point on lines from anchors A."
    if magnified:
        caption += FOUND.format(format_plain(magnified)).replace(" (b: platform frame)", "")
    alt = f"A point on {last} lines."
    return Scene(
        "machine", caption, alt, tuple(points), lines, tuple(places), (("A", (0,)), ("l", (0, last))), magnified
    )
