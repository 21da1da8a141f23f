"""The page of a machine's file: its joints in space, its legs, what its symbols are."""

from __future__ import annotations

from itertools import product
from pathlib import Path

import numpy as np

from bayescal.config.load import read_toml
from bayescal.errors import InputError
from bayescal.experiments.shared.joints import tabulate_joints
from bayescal.experiments.shared.machine_scene import build_line_scene, build_scene
from bayescal.experiments.shared.show_struts import describe_struts
from bayescal.machines.mechanism import Mechanism
from bayescal.machines.read import load_mechanism, read_reading_model
from bayescal.machines.readings import FunctionModel, Legs
from bayescal.machines.readings.line_machine import AXES, LineMachine
from bayescal.machines.readings.sliding_platform import SlidingPlatform
from bayescal.machines.readings.strut_machine import StrutMachine
from bayescal.numerics.geometry import Array
from bayescal.report.blocks import Block, Column, Page, Section, Table, make_table
from bayescal.report.numbers import format_plain
from bayescal.report.scene import Group, Scene, SceneLine, ScenePoint, Triple

KIND = "Machine"
NOWHERE: Triple = (0.0, 0.0, 0.0)


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
    if isinstance(model, Legs):
        return _describe_mechanism(model.machine.mechanism)
    if isinstance(model, FunctionModel) and isinstance(model.machine, SlidingPlatform):
        return _describe_sliding(model.machine)
    if isinstance(model, FunctionModel) and isinstance(model.machine, LineMachine):
        return _describe_lines(model.name, model.machine)
    if isinstance(model, FunctionModel) and isinstance(model.machine, StrutMachine):
        return describe_struts(model.name, model.machine)
    raise InputError(
        f"{path}: kind: found a machine of one function, which does not tell where its joints are, expected a "
        "mechanism on legs, struts, a sliding platform or a machine of lines"
    )


def _make_page(name: str, headline: str, scene: Scene, tables: tuple[Table, ...]) -> Page:
    blocks: tuple[Block, ...] = (scene,)
    sections = (Section("The machine", blocks, "machine"), Section("Joints and legs", tables, "joints", "Joints"))
    return Page(KIND, name, name, "", headline, (), sections)


# --- machines on legs --------------------------------------------------------------------------------------------


def _describe_mechanism(mechanism: Mechanism) -> Page:
    moves = "struts change their lengths" if mechanism.drive == "strut" else "actuators move the joints at the base"
    travel = format_plain(mechanism.actuator_range)
    headline = f"{mechanism.n_legs} legs; {moves}, by at most {travel} mm from the initial position."
    actuators, names = _choose_poses(mechanism)
    scene = build_scene(tabulate_joints(mechanism, actuators, names))
    if scene is None:
        raise InputError(f"mechanism {mechanism.name!r}: found no home pose, expected legs that reach the platform")
    return _make_page(mechanism.name, headline, scene, (_tabulate_legs(mechanism),))


def _choose_poses(mechanism: Mechanism) -> tuple[Array, list[str]]:
    """Return actuator positions half-way to their ends, together and one by one, shape (2 + N, N), mm."""
    start, reach = mechanism.initial_actuator_positions, mechanism.actuator_range
    n = mechanism.n_legs
    moves = np.vstack([np.ones((1, n)), -np.ones((1, n)), np.eye(n)])
    names = ["all out", "all in", *(f"actuator {leg} out" for leg in range(1, n + 1))]
    return start + 0.5 * reach * moves, names


def _tabulate_legs(mechanism: Mechanism) -> Table:
    group = {"a": "a, joint at the base, mm", "b": "b, joint on the platform, mm", "u": "u, direction"}
    columns = [Column("Leg"), *(Column(axis, group=group[s]) for s in ("a", "b") for axis in AXES)]
    parts = [mechanism.base_points, mechanism.platform_points]
    if mechanism.drive == "base":
        columns += [Column(axis, group=group["u"]) for axis in AXES]
        parts.append(mechanism.directions)
    columns += [Column("l", "mm", symbolic=True), Column("rho0", "mm", symbolic=True)]
    numbers = np.column_stack([*parts, mechanism.leg_lengths, mechanism.initial_actuator_positions])
    rows = [[str(leg), *(format_plain(x) for x in row)] for leg, row in enumerate(numbers.tolist(), start=1)]
    return make_table("Joints and legs as designed; b in the platform's frame.", columns, rows)


# --- other machines ----------------------------------------------------------------------------------------------


def _describe_lines(name: str, machine: LineMachine) -> Page:
    blocks = {block.symbol: block.nominal for block in machine.parameters}
    anchors = [(float(x), float(y), float(z)) for x, y, z in zip(*(blocks[f"A_{axis}"] for axis in AXES), strict=True)]
    nothing = [NOWHERE] * len(anchors)
    places = {"origin": NOWHERE}
    for signs in product((-1.0, 1.0), repeat=3):
        x, y, z = (c.home + sign * c.reach for c, sign in zip(machine.coordinates, signs, strict=True))
        places[f"corner {len(places)}"] = (x, y, z)
    rows = [[str(k), *(format_plain(x) for x in anchor)] for k, anchor in enumerate(anchors, start=1)]
    columns = [Column("Line"), *(Column(axis, "mm", "A, anchor") for axis in AXES)]
    scene = build_line_scene(anchors, nothing, nothing, places)
    return _make_page(name, f"A point on {len(anchors)} lines.", scene, (make_table("Anchors.", columns, rows),))


def _place(name: str, group: Group, places: Array) -> list[ScenePoint]:
    """Return points of a plane, shape (N, 2), mm."""
    return [ScenePoint(f"{name} {k}", group, ((x, y, 0.0),)) for k, (x, y) in enumerate(places.tolist(), start=1)]


def _describe_sliding(machine: SlidingPlatform) -> Page:
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
    caption = (
        "The machine at home, which moves in one plane. P: where a carriage reads zero; s: its way along the guide; "
        "l: leg; B: joint on the platform."
    )
    labels = (("P", (0,)), ("s", (0, n)), ("l", (n, 2 * n)), ("B", (2 * n,)))
    alt = f"Drawing of a planar platform on {n} legs whose carriages slide on guides."
    scene = Scene("machine", caption, alt, tuple(points), tuple(lines), labels=labels)
    columns = [Column("Leg"), Column("x_P", "mm", symbolic=True), Column("y_P", "mm", symbolic=True)]
    columns += [Column("beta", "deg", symbolic=True), Column("l", "mm", symbolic=True)]
    numbers = np.column_stack([machine.guide_points, np.degrees(machine.guide_angles), machine.leg_lengths])
    rows = [[str(leg), *(format_plain(one) for one in row)] for leg, row in enumerate(numbers.tolist(), start=1)]
    table = make_table("Guides and legs as designed.", columns, rows)
    return _make_page(machine.name, f"A planar platform on {n} sliding legs.", scene, (table,))
