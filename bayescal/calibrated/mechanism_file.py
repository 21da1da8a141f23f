"""Mechanisms as TOML files that `bayescal.machines.read` takes, every number to its last digit."""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence

import numpy as np

from bayescal.machines.mechanism import BeamSection, ExternalLoad, Flexures, Mechanism
from bayescal.numerics.geometry import Array

STANDARD_GRAVITY = 9.80665  # m/s²


def format_mechanism(mechanism: Mechanism, comments: Sequence[str] = ()) -> str:
    """Return the text of a mechanism's file, comment lines above."""
    lines = [f"# {comment}" for comment in comments]
    lines += [f"name = {format_value(mechanism.name)}"]
    lines += ["", "[base]", f"points_mm = {_format_rows(mechanism.base_points)}"]
    lines += ["", "[platform]", f"points_mm = {_format_rows(mechanism.platform_points)}"]
    lines += ["", *_format_home(mechanism), "", *_format_legs(mechanism)]
    if mechanism.flexures is not None:
        lines += _format_flexures(mechanism.flexures)
    if mechanism.load != ExternalLoad():
        lines += _format_load(mechanism.load)
    return "\n".join(lines) + "\n"


def _format_home(mechanism: Mechanism) -> list[str]:
    if mechanism.home_position is not None:
        return ["[home]", f"near_mm = {format_value(mechanism.home_position)}"]
    return ["[home]", f'platform = "{"below" if mechanism.platform_below else "above"}"']


def _format_legs(mechanism: Mechanism) -> list[str]:
    lines = ["[legs]", f'drive = "{mechanism.drive}"', f"length_mm = {format_value(mechanism.leg_lengths)}"]
    if mechanism.drive == "base":
        lines.append(f"direction = {_format_rows(mechanism.directions)}")
    lines.append(f"initial_actuator_position_mm = {format_value(mechanism.initial_actuator_positions)}")
    return [*lines, f"actuator_range_mm = {format_value(mechanism.actuator_range)}"]


def _format_flexures(flexures: Flexures) -> list[str]:
    lines = ["", "[flexures]", f"length_mm = {format_value(flexures.lengths)}", f"beta = {format_value(flexures.beta)}"]
    if flexures.section is None or flexures.leg_section is None:
        return lines
    sections = {"flexure": flexures.section, "leg": flexures.leg_section}
    return [*lines, "", "[stiffness]", *(f"{key} = {_format_section(one)}" for key, one in sections.items())]


def _format_section(section: BeamSection) -> str:
    k1, k2, k3 = (format_value(k) for k in (section.k1, section.k2, section.k3))
    return f"{{ k1_n_mm2 = {k1}, k2_n = {k2}, k3_n_mm2 = {k3} }}"


def _format_load(load: ExternalLoad) -> list[str]:
    lines = ["", "[load]", f"force_n = {format_value(load.force)}", f"moment_n_mm = {format_value(load.moment)}"]
    mass = float(np.linalg.norm(load.weight)) / STANDARD_GRAVITY
    if mass > 0.0:
        lines.append(f"mass_kg = {format_value(mass)}")
        lines.append(f"gravity_m_s2 = {format_value([w / mass for w in load.weight])}")
    return [*lines, f"centre_of_mass_mm = {format_value(load.centre_of_mass)}"]


def _format_rows(rows: Array) -> str:
    return "[\n" + "".join(f"    {format_value(row)},\n" for row in rows) + "]"


def format_value(value: object) -> str:
    """Return a text, a flag, a number or a list of these as TOML has it; numbers as Python repeats them."""
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=False)
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, Iterable):
        return f"[{', '.join(format_value(one) for one in value)}]"
    return repr(float(value))  # type: ignore[arg-type]  # a number by now
