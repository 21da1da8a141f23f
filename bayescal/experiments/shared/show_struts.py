"""The page of a machine on struts that gravity bends and temperature stretches: joints, centre of gravity, gravity."""

from __future__ import annotations

import numpy as np
import pandas as pd

from bayescal.experiments.shared.machine_scene import build_scene
from bayescal.machines.readings import POSE
from bayescal.machines.readings.strut_machine import N_STRUTS, StrutMachine
from bayescal.numerics.geometry import Array
from bayescal.report.blocks import Block, Column, Definitions, Page, Section, Table, make_table
from bayescal.report.numbers import format_plain
from bayescal.report.scene import Scene, SceneLine, ScenePoint, Triple

REACH = 0.35  # of the drawn arrow of gravity, in units of the largest distance of a joint
SYMBOLS = (
    ("a_x, a_y, a_z", "Joint of a strut at the base, base frame."),
    ("b_x, b_y, b_z", "Joint of a strut on the platform, platform frame."),
    ("l", "Length of a strut where its actuator q reads zero, without load, at the reference temperature."),
    ("c", "Compliance of a strut with its joints: how much longer it becomes under a pull of 1 N."),
    ("g_x, g_y, g_z", "Centre of gravity of what the struts carry, platform frame; the weight W acts there."),
    ("e_s, e_b, e_p", "Expansion of struts, base and platform by temperature."),
    ("sag", "Where the base goes between zenith and horizon, with the cosine of the elevation: shift and turn."),
    ("lift", "The same with one less the sine of the elevation."),
    ("drift", "Where the base goes by temperature: shift and turn for a kelvin."),
)


def describe_struts(name: str, machine: StrutMachine) -> Page:
    """Return the page of a machine on struts."""
    nominal = {block.symbol: np.array(block.nominal) for block in machine.parameters}
    base, platform = (np.stack([nominal[f"{s}_{axis}"] for axis in POSE[:3]], axis=1) for s in "ab")
    home = np.array([coordinate.home for coordinate in machine.coordinates[:3]])
    centre = home + np.array([nominal[f"g_{axis}"][0] for axis in POSE[:3]])
    scene = _draw(machine, base, home + platform, centre)
    shown: tuple[Block, ...] = (scene, Definitions(SYMBOLS))
    headline = f"{N_STRUTS} struts that change their lengths, bent by their load and stretched by temperature."
    sections = (
        Section("The machine", shown, "machine"),
        Section("Joints and struts", (_tabulate(base, platform, nominal),), "joints", "Joints"),
    )
    symbols = ("a_x", "a_y", "a_z", "b_x", "b_y", "b_z", "g_x", "g_y", "g_z", "e_s", "e_b", "e_p")
    return Page("Machine", name, name, "", headline, (), sections, symbols=symbols)


def _draw(machine: StrutMachine, base: Array, upper: Array, centre: Array) -> Scene:
    """Return joints and struts at home, the centre of gravity, and where gravity points at zenith and horizon."""
    rows = [
        {"pose": "home", "joint": joint, "leg": leg, "x_mm": x, "y_mm": y, "z_mm": z}
        for joint, points in (("base", base), ("platform", upper))
        for leg, (x, y, z) in enumerate(points.tolist(), start=1)
    ]
    scene = build_scene(pd.DataFrame(rows))
    assert scene is not None  # it has joints
    length = REACH * float(np.linalg.norm(np.concatenate([base, upper]) - centre, axis=1).max())
    zenith, horizon = (_triple(centre + length * one / np.linalg.norm(one)) for one in machine.down)
    n = len(scene.points)
    points = (
        *scene.points,
        ScenePoint("g, centre of gravity", "moved", (_triple(centre),)),
        ScenePoint("gravity at the zenith", "moved", (zenith,)),
        ScenePoint("gravity at the horizon", "moved", (horizon,)),
    )
    lines = (*scene.lines, SceneLine((n, n + 1), "moved"), SceneLine((n, n + 2), "moved"))
    labels = (*scene.labels, ("g", (n,)), ("W, zenith", (n + 1,)), ("W, horizon", (n + 2,)))
    caption = scene.caption.replace("which ρ changes", "which the actuator q changes")
    caption += " Orange: g, centre of gravity, and where the weight W points at the zenith and at the horizon."
    alt = f"{scene.alt.rstrip('.')}, the centre of gravity and the weight at zenith and horizon."
    return Scene(scene.name, caption, alt, points, lines, scene.poses, labels, scene.magnified)


def _triple(point: Array) -> Triple:
    x, y, z = point.tolist()
    return x, y, z


def _tabulate(base: Array, platform: Array, nominal: dict[str, Array]) -> Table:
    columns = [Column("Strut"), *(Column(axis, group="a, joint at the base, mm") for axis in POSE[:3])]
    columns += [Column(axis, group="b, joint on the platform, mm") for axis in POSE[:3]]
    columns += [Column("l", "mm", symbolic=True), Column("c", "nm/N", symbolic=True)]
    numbers = np.column_stack([base, platform, nominal["l"], nominal["c"]])
    rows = [[str(k), *(format_plain(x) for x in row)] for k, row in enumerate(numbers.tolist(), start=1)]
    return make_table("Joints and struts as designed; b in the platform's frame.", columns, rows)
