"""The page of a machine's file: its joints in space, its legs, what its symbols are."""

from __future__ import annotations

from collections.abc import Sequence
from functools import singledispatch
from itertools import product
from pathlib import Path

import numpy as np
import pandas as pd

from bayescal.config.load import read_toml
from bayescal.errors import InputError, name_faults
from bayescal.experiments.shared.joints import tabulate_joints
from bayescal.experiments.shared.machine_scene import build_line_scene, build_scene
from bayescal.machines.mechanism import Mechanism
from bayescal.machines.parameters import ParameterLayout
from bayescal.machines.read import load_mechanism, read_reading_model
from bayescal.machines.readings import Parameters, ReadingMachine
from bayescal.machines.readings.line_machine import AXES, LineMachine
from bayescal.machines.readings.sliding_platform import SlidingPlatform
from bayescal.machines.readings.strut_machine import N_STRUTS, StrutMachine
from bayescal.numerics.geometry import Array
from bayescal.report.blocks import Block, Column, Definitions, Page, PageSection, Table, make_table
from bayescal.report.numbers import format_plain
from bayescal.report.scene import Group, Scene, SceneLine, ScenePoint, Triple

NOWHERE: Triple = (0.0, 0.0, 0.0)
REACH = 0.35  # of the drawn arrow of gravity, in units of the largest distance of a joint
SYMBOLS = (
    ("a_x, a_y, a_z", "Strut joint, base frame."),
    ("b_x, b_y, b_z", "Strut joint, platform frame."),
    ("l", "Strut length at q = 0, unloaded, reference temperature."),
    ("c", "Strut compliance."),
    ("g_x, g_y, g_z", "Centre of gravity, platform frame."),
    ("e_s, e_b, e_p", "Thermal expansion: struts, base, platform."),
    ("sag", "Base motion with elevation (cosine)."),
    ("lift", "Same (1 − sine)."),
    ("drift", "Base motion per kelvin."),
)


def describe_machine(path: Path) -> Page:
    """Return the page of a machine's file.

    Raises
    ------
    InputError
        Where the file is no machine, or one whose joints its class does not tell.
    """
    if "kind" not in read_toml(path)[0]:
        return _describe_mechanism(load_mechanism(path))
    model = read_reading_model(path)
    if model.legs is not None:
        return _describe_mechanism(model.legs.machine.mechanism)
    machine = model.of_function
    with name_faults(f"{path}: kind"):
        if machine is None:
            raise InputError("found no function, expected legs, or a class with `outline`")
        return _describe(machine.at_one_place, getattr(model, "name", ""))


@singledispatch
def _describe(machine: ReadingMachine, name: str) -> Page:
    """Return the page of a machine of one function: its outline at home and at the ends of its coordinates."""
    layout = ParameterLayout(tuple(machine.parameters))
    names, places, pairs = _trace(machine, layout)
    stands = enumerate(places.swapaxes(0, 1), start=1)
    points = tuple(ScenePoint(f"point {k}", "base", tuple(map(_triple, one))) for k, one in stands)
    lines = tuple(SceneLine(pair, "leg") for pair in pairs)
    caption = "Points and lines of the machine's class."
    scene = Scene("machine", caption, f"{len(points)} points and {len(lines)} lines.", points, lines, names)
    columns = [Column("Parameter", kind="name"), Column("Nominal"), Column("Unit", kind="name")]
    values = zip(layout.names, layout.nominal.tolist(), layout.units, strict=True)
    rows = [[one, format_plain(x), unit] for one, x, unit in values]
    table = make_table("Nominal values.", columns, rows)
    shown = PageSection("The machine", (scene,), "machine"), PageSection("Parameters", (table,), "parameters")
    said = f"{len(rows)} parameters, {len(machine.coordinates)} coordinates."
    return Page("Machine", name, name, "", said, (), shown)


def _trace(machine: ReadingMachine, layout: ParameterLayout) -> tuple[tuple[str, ...], Array, list[tuple[int, int]]]:
    """Return names of poses, the outline's points there (n, P, 3), mm, and its lines; InputError without an outline."""
    home = np.array([one.home for one in machine.coordinates])
    far = np.diag([one.reach for one in machine.coordinates]).reshape(len(home), -1)
    poses = np.array([home, *(home + sign * one for one in far for sign in (-1.0, 1.0))])
    names = ["home", *(f"{one.name} {end}" for one in machine.coordinates for end in ("smallest", "largest"))]
    try:  # somebody else's code
        with np.errstate(all="ignore"):
            drawn = machine.outline(Parameters(layout, layout.nominal), poses)
        if drawn is None:
            raise InputError("found a class without drawing, expected legs, struts, lines or `outline`")
        points = np.asarray(drawn[0], dtype=np.float64)
        places = np.broadcast_to(points, (len(poses), points.shape[-2], len(AXES)))
        pairs = [(range(len(places[0]))[one], range(len(places[0]))[other]) for one, other in drawn[1]]
    except InputError:
        raise
    except Exception as error:
        said = " ".join(f"{type(error).__name__}: {error}".split())
        expected = "points (..., P, 3) and pairs of their numbers"
        raise InputError(f"outline: failed with {said}, expected {expected}") from error
    stands = np.isfinite(places).all(axis=(1, 2))
    if not stands.any():
        raise InputError("outline: found no finite points, expected some at home")
    return tuple(name for name, good in zip(names, stands, strict=True) if good), places[stands], pairs


def _make_page(
    name: str, headline: str, shown: tuple[Block, ...], table: Table, parts: str = "legs", symbols: tuple[str, ...] = ()
) -> Page:
    sections = (
        PageSection("The machine", shown, "machine"),
        PageSection(f"Joints and {parts}", (table,), "joints", "Joints"),
    )
    return Page("Machine", name, name, "", headline, (), sections, symbols=symbols)


def _tabulate(caption: str, columns: Sequence[Column], numbers: Array) -> Table:
    """Return a table of legs or what else a machine has several of, counted in its first column."""
    rows = [[str(k), *(format_plain(x) for x in row)] for k, row in enumerate(numbers.tolist(), start=1)]
    return make_table(caption, columns, rows)


def _list_joint_columns(first: str) -> list[Column]:
    group = ("a, base joint, mm", "b, platform joint, mm")
    return [Column(first), *(Column(axis, group=one) for one in group for axis in AXES)]


# --- machines on legs --------------------------------------------------------------------------------------------


def _describe_mechanism(mechanism: Mechanism) -> Page:
    drive = "struts change length" if mechanism.drive == "strut" else "actuators move base joints"
    travel = format_plain(mechanism.actuator_range)
    headline = f"{mechanism.n_legs} legs; {drive}, ±{travel} mm."
    n = mechanism.n_legs
    moves = np.vstack([np.ones((1, n)), -np.ones((1, n)), np.eye(n)])  # half-way to their ends, together and one by one
    names = ["all out", "all in", *(f"actuator {leg} out" for leg in range(1, n + 1))]
    actuators = mechanism.initial_actuator_positions + 0.5 * mechanism.actuator_range * moves
    scene = build_scene(tabulate_joints(mechanism, actuators, names))
    if scene is None:
        raise InputError(f"mechanism {mechanism.name!r}: found no home pose, expected legs that reach")
    columns, parts = _list_joint_columns("Leg"), [mechanism.base_points, mechanism.platform_points]
    if mechanism.drive == "base":
        columns += [Column(axis, group="u, direction") for axis in AXES]
        parts.append(mechanism.directions)
    columns += [Column("l", "mm", symbolic=True), Column("rho0", "mm", symbolic=True)]
    numbers = np.column_stack([*parts, mechanism.leg_lengths, mechanism.initial_actuator_positions])
    table = _tabulate("Nominal joints and legs.", columns, numbers)
    return _make_page(mechanism.name, headline, (scene,), table)


# --- other machines ----------------------------------------------------------------------------------------------


@_describe.register
def _describe_lines(machine: LineMachine, name: str) -> Page:
    blocks = {block.symbol: block.nominal for block in machine.parameters}
    flat = [0.0] * (len(AXES) - len(machine.axes))  # of a plane
    height = list(machine.away) or flat
    across = [blocks[f"A_{axis}"] for axis in machine.axes] + ([height] if flat else [])
    anchors = [(float(x), float(y), float(z)) for x, y, z in zip(*across, strict=True)]
    nothing = [NOWHERE] * len(anchors)
    places = {"origin": NOWHERE}
    for signs in product((-1.0, 1.0), repeat=len(machine.axes)):
        at = (c.home + sign * c.reach for c, sign in zip(machine.coordinates, signs, strict=True))
        x, y, z = (*at, *flat)
        places[f"corner {len(places)}"] = (x, y, z)
    columns = [Column("Line"), *(Column(axis, "mm", "A, anchor") for axis in AXES)]
    scene = build_line_scene(anchors, nothing, nothing, places)
    table = _tabulate("Anchors.", columns, np.array(anchors))
    return _make_page(name, f"A point on {len(anchors)} lines.", (scene,), table)


def _place(name: str, group: Group, places: Array) -> list[ScenePoint]:
    """Return points of a plane, shape (N, 2), mm."""
    return [ScenePoint(f"{name} {k}", group, ((x, y, 0.0),)) for k, (x, y) in enumerate(places.tolist(), start=1)]


@_describe.register
def _describe_sliding(machine: SlidingPlatform, name: str) -> Page:
    """Return the page of a planar machine: guides, carriages at home, platform."""
    x, y, angle = machine.home.tolist()
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    upper = np.array([x, y]) + machine.platform_points @ turn.T
    along = np.stack([np.cos(machine.guide_angles), np.sin(machine.guide_angles)], axis=1)
    across = np.stack([-along[:, 1], along[:, 0]], axis=1)
    offset = upper - machine.guide_points
    height = np.sum(offset * across, axis=1)
    reach = np.sqrt(machine.leg_lengths**2 - height**2) * np.where(machine.forward, 1.0, -1.0)
    carriage = machine.guide_points + (np.sum(offset * along, axis=1) - reach)[:, None] * along
    points = _place("P", "guide", machine.guide_points) + _place("carriage", "base", carriage)
    points += _place("B", "platform", upper)
    n = machine.n_legs
    lines = [SceneLine(tuple(range(2 * n, 3 * n)), "platform", closed=True)]
    lines += [SceneLine((n + k, 2 * n + k), "leg") for k in range(n)]
    lines += [SceneLine((k, n + k), "guide") for k in range(n)]
    caption = "Planar machine at home. P: carriage zero; s: travel; l: leg; B: platform joint."
    labels = (("P", (0,)), ("s", (0, n)), ("l", (n, 2 * n)), ("B", (2 * n,)))
    alt = f"Planar platform on {n} legs with carriages on guides."
    scene = Scene("machine", caption, alt, tuple(points), tuple(lines), labels=labels)
    columns = [Column("Leg"), Column("x_P", "mm", symbolic=True), Column("y_P", "mm", symbolic=True)]
    columns += [Column("beta", "deg", symbolic=True), Column("l", "mm", symbolic=True)]
    numbers = np.column_stack([machine.guide_points, np.degrees(machine.guide_angles), machine.leg_lengths])
    table = _tabulate("Nominal guides and legs.", columns, numbers)
    return _make_page(name, f"A planar platform on {n} sliding legs.", (scene,), table)


# --- struts that gravity bends and temperature stretches ---------------------------------------------------------


@_describe.register
def _describe_struts(machine: StrutMachine, name: str) -> Page:
    nominal = {block.symbol: np.array(block.nominal) for block in machine.parameters}
    base, platform = (np.stack([nominal[f"{s}_{axis}"] for axis in AXES], axis=1) for s in "ab")
    home = np.array([coordinate.home for coordinate in machine.coordinates[:3]])
    centre = home + np.array([nominal[f"g_{axis}"][0] for axis in AXES])
    scene = _draw_struts(machine, base, home + platform, centre)
    columns = [*_list_joint_columns("Strut"), Column("l", "mm", symbolic=True), Column("c", "nm/N", symbolic=True)]
    numbers = np.column_stack([base, platform, nominal["l"], nominal["c"]])
    table = _tabulate("Nominal joints and struts.", columns, numbers)
    headline = f"{N_STRUTS} struts under load and temperature."
    symbols = ("a_x", "a_y", "a_z", "b_x", "b_y", "b_z", "g_x", "g_y", "g_z", "e_s", "e_b", "e_p")
    return _make_page(name, headline, (scene, Definitions(SYMBOLS)), table, "struts", symbols)


def _draw_struts(machine: StrutMachine, base: Array, upper: Array, centre: Array) -> Scene:
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
        ScenePoint("zenith", "moved", (zenith,)),
        ScenePoint("horizon", "moved", (horizon,)),
    )
    lines = (*scene.lines, SceneLine((n, n + 1), "moved"), SceneLine((n, n + 2), "moved"))
    labels = (*scene.labels, ("g", (n,)), ("W, zenith", (n + 1,)), ("W, horizon", (n + 2,)))
    caption = scene.caption.replace("which ρ changes", "which q changes")
    caption += " Orange: centre of gravity g, weight W at zenith and horizon."
    alt = f"{scene.alt.rstrip('.')}, centre of gravity and weight."
    return Scene(scene.name, caption, alt, points, lines, scene.poses, labels, scene.magnified)


def _triple(point: Array) -> Triple:
    x, y, z = point.tolist()
    return x, y, z
