"""Files of printers' firmware: what Klipper, Marlin and RepRapFirmware hold of deltas, cable robots and five-bars.

A firmware's parameters are fewer than a machine's, or others. Each file says, beside its numbers, how far the tool of
the calibrated machine is from nominal, rms over the workspace with the same commands, and how far from what the file
says: the difference is what the file carries.

With towers at directions α, arms l, radius r and the tool at height e where a carriage is at its endstop:

- Klipper has all of them; r is one for all towers.
- Marlin (M665, M666): e = H - M666 with M666 never positive, l = L + A, B or C, α = 210, 330 or 90 degrees + X, Y or Z.
- RepRapFirmware (M665, M666): e = H + M666, l = L of each tower, α as Marlin. Of a Hangprinter (M669, M666) anchors,
  radii of spools at the origin and build-up; lines that stretch it does not have here. Of a rotary delta
  (M669 K10, M666) all: radius R, upper arms U, lower ones L, heights H, directions as M665, zeros. Of a five-bar
  (M669 K9) all: motors X and Y, cranks P, couplers D, and B, where cranks point at their endstops.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import singledispatch

import numpy as np
from scipy.optimize import least_squares

from bayescal.calibrated.carried import BareMachine, take_machine
from bayescal.calibrated.machine import CalibratedMachine
from bayescal.errors import InputError
from bayescal.limits import FAR_AWAY
from bayescal.machines.readings.delta import TOWERS, DeltaMachine
from bayescal.machines.readings.five_bar import FiveBar
from bayescal.machines.readings.function import ReadingMachine
from bayescal.machines.readings.line_machine import LineMachine
from bayescal.machines.readings.rotary_delta import RotaryDelta
from bayescal.numerics.geometry import Array

KLIPPER, MARLIN, REPRAP = "klipper", "marlin", "reprapfirmware"
DIRECTIONS = np.array([210.0, 330.0, 90.0])
LINES = "ABCD"
MODES = {("right", "right"): 1, ("left", "right"): 2, ("left", "left"): 4}
"""RepRapFirmware's numbers of a five-bar's assembly by its elbows: an elbow to the left has the smaller x."""
DIGITS = 9  # behind the point, mm and degrees


type Printer = BareMachine[ReadingMachine]


# --- deltas ----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class _Towers:
    """A delta with one radius: mm, degrees, (3,) of each tower."""

    radius: float
    arms: Array
    endstops: Array
    angles: Array
    held: Array  # the same in the layout of its machine


def _read_towers(printer: Printer) -> _Towers:
    """Return a delta's towers; those of one radius that fit best where the calibrated ones have several."""
    held = printer.theta if len(printer.take("r")) == 1 else _fit_radius(printer)
    one = replace(printer, theta=held)
    towers = (one.take("l"), one.take("e"), np.degrees(one.take("angle")))
    return _Towers(float(one.take("r")[0]), *towers, held)


def _fit_radius(printer: Printer) -> Array:
    """Return parameters of one radius whose tool is nearest to the calibrated one at the same commands."""
    symbols = ("angle", "l", "e")

    def unpack(x: Array) -> Array:
        return printer.change(r=x[0], **dict(zip(symbols, x[1:].reshape(-1, TOWERS), strict=True)))

    start = np.concatenate([[printer.take("r").mean()], *(printer.take(symbol) for symbol in symbols)])
    return fit_delta(printer, unpack, start, np.array([1.0] + [0.01] * TOWERS + [1.0] * 2 * TOWERS))


def fit_delta(printer: Printer, unpack: Callable[[Array], Array], start: Array, scale: Array) -> Array:
    """Return the parameters (D,), out of some numbers x, whose tool is nearest to the calibrated one's.

    At the same commands, by Gauss and Newton's method.
    """
    model, (pose, commands, _) = printer.model, printer.sample()
    pose, commands = (one[np.isfinite(commands).all(axis=1)] for one in (pose, commands))
    by_command = np.linalg.inv(model.linearise(printer.theta, pose, False).by_pose[:, :TOWERS])

    def leave(x: Array) -> Array:
        apart = np.nan_to_num(model.read(unpack(x), pose)[:, :TOWERS] - commands, nan=FAR_AWAY)
        return (by_command @ apart[..., None]).ravel()

    return unpack(least_squares(leave, start, x_scale=scale).x)


def _take_delta(calibrated: CalibratedMachine, what: str) -> tuple[Printer, _Towers]:
    printer = take_machine(calibrated, what, {"delta": DeltaMachine})
    return printer, _read_towers(printer)


def write_numbers(values: Sequence[float] | Array) -> list[str]:
    """Return numbers to a picometre."""
    return [repr(round(float(one), DIGITS) + 0.0) for one in values]


def _list_words(letters: str, values: Sequence[float] | Array) -> str:
    return " ".join(f"{letter}{text}" for letter, text in zip(letters, write_numbers(values), strict=True))


def list_klipper_files(calibrated: CalibratedMachine) -> dict[str, bytes]:
    """Return ``printer.cfg``: the sections of a delta's geometry, for the file that has all others."""
    printer, towers = _take_delta(calibrated, KLIPPER)
    lines = [f"# {one}" for one in (*calibrated.source.describe(), printer.describe(towers.held))]
    lines += ["[printer]", "kinematics: delta", f"delta_radius: {write_numbers([towers.radius])[0]}"]
    rows = zip("abc", *(write_numbers(one) for one in (towers.arms, towers.angles, towers.endstops)), strict=True)
    for tower, arm, angle, endstop in rows:
        lines += ["", f"[stepper_{tower}]", f"arm_length: {arm}", f"angle: {angle}", f"position_endstop: {endstop}"]
    return {"printer.cfg": ("\n".join(lines) + "\n").encode()}


def list_marlin_files(calibrated: CalibratedMachine) -> dict[str, bytes]:
    """Return ``marlin.gcode``: M665 and M666 of a delta; M500 stores them."""
    printer, towers = _take_delta(calibrated, MARLIN)
    height, arm = float(towers.endstops.min()), float(towers.arms.mean())
    said = [*calibrated.source.describe(), printer.describe(towers.held)]
    if np.ptp(towers.arms) > 0.0:
        alike = printer.change(r=towers.radius, e=towers.endstops, l=arm)
        said.append(printer.describe(alike, "To a firmware that does not know A, B and C of M665 the file"))
    lines = [f"; {one}" for one in said]
    lines.append(f"M665 {_list_words('LRH', (arm, towers.radius, height))} {_list_turns(towers.angles)}")
    lines[-1] += f" {_list_words('ABC', towers.arms - arm)}"
    lines.append(f"M666 {_list_words('XYZ', height - towers.endstops)}")
    return {"marlin.gcode": ("\n".join([*lines, "M500 ; store"]) + "\n").encode()}


def _list_turns(angles: Array) -> str:
    """Return by what directions differ from those that firmwares take, degrees."""
    return _list_words("XYZ", (angles - DIRECTIONS + 180.0) % 360.0 - 180.0)


def list_reprapfirmware_files(calibrated: CalibratedMachine) -> dict[str, bytes]:
    """Return ``config.g``: M665 and M666 of a delta, M669 of a rotary one, a Hangprinter or a five-bar."""
    kinds: dict[str, type[ReadingMachine]] = {"delta": DeltaMachine, "rotary_delta": RotaryDelta}
    printer = take_machine(calibrated, REPRAP, kinds | {"line_machine": LineMachine, "five_bar": FiveBar})
    held, lines = _list_commands(printer.machine, printer)
    said = [f"; {one}" for one in (*calibrated.source.describe(), printer.describe(held))]
    return {"config.g": ("\n".join([*said, *lines]) + "\n").encode()}


@singledispatch
def _list_commands(machine: ReadingMachine, printer: Printer) -> tuple[Array, list[str]]:
    """Return the parameters that a printer's commands hold, and these, by its machine; by default those of a delta."""
    del machine
    towers = _read_towers(printer)
    height = float(towers.endstops.mean())
    return towers.held, [
        f"M665 L{':'.join(write_numbers(towers.arms))} {_list_words('RH', (towers.radius, height))} "
        f"{_list_turns(towers.angles)}",
        f"M666 {_list_words('XYZ', towers.endstops - height)} A0.0 B0.0",
    ]


# --- machines on lines -----------------------------------------------------------------------------------------------


@_list_commands.register
def _list_hangprinter(machine: LineMachine, printer: Printer) -> tuple[Array, list[str]]:
    """Return those of a Hangprinter."""
    if len(machine.parallel) != len(LINES):
        raise InputError(f"format {REPRAP}: found {len(machine.parallel)} lines, expected {len(LINES)}")
    anchors = np.stack([printer.take(f"A_{axis}") for axis in "xyz"], axis=-1)
    places = " ".join(f"{line}{':'.join(write_numbers(at))}" for line, at in zip(LINES, anchors, strict=True))
    parallel = ":".join(f"{int(one)}" for one in machine.parallel)
    radii = ":".join(write_numbers(printer.take("R")))
    return printer.change(c=0.0), [
        f"; Gear {machine.gear!r}: L and H of M666 stay.",
        f"M669 K6 {places}",
        f"M666 Q{write_numbers(printer.take('Q'))[0]} R{radii} U{parallel} O1:1:1:1",
    ]


# --- arms that turn --------------------------------------------------------------------------------------------------


def _list_arms(printer: Printer, words: Mapping[str, str]) -> str:
    """Return values of several arms, or of one for all, by the words and the symbols that have them."""
    return " ".join(f"{word}{':'.join(write_numbers(printer.take(symbol)))}" for word, symbol in words.items())


@_list_commands.register
def _list_rotary(machine: RotaryDelta, printer: Printer) -> tuple[Array, list[str]]:
    """Return those of a rotary delta; M666 is what the encoders' zeros add to the angle of the endstops."""
    del machine
    height = ":".join(write_numbers(np.repeat(printer.take("h"), TOWERS)))
    turns = _list_turns(np.degrees(printer.take("angle")))
    return printer.theta, [
        "; M666 for arms homed, with M666 of zero, to the larger angle of A.",
        f"M669 K10 {_list_arms(printer, {'R': 'r', 'U': 'L', 'L': 'l'})} H{height} {turns}",
        f"M666 {_list_words('XYZ', np.degrees(printer.take('o')))}",
    ]


@_list_commands.register
def _list_five_bar(machine: FiveBar, printer: Printer) -> tuple[Array, list[str]]:
    """Return that of a five-bar; InputError for elbows that the firmware has no mode for."""
    mode = MODES.get((machine.config.elbows[0], machine.config.elbows[1]))
    below = machine.coordinates[1].home - machine.coordinates[1].reach <= printer.take("y").max()
    if mode is None or below:
        found = "a workspace beside or below its motors" if below else "elbows to the right and to the left"
        raise InputError(f"format {REPRAP}: found {found}, expected the tool above, elbows outwards or to one side")
    ends = ":".join(write_numbers(np.degrees(printer.take("o"))))
    arms = _list_arms(printer, {"X": "x", "Y": "y", "P": "L", "D": "l"})  # behind D: the tool where couplers meet
    command = f"M669 K9 L{mode} {arms}:0.0:0.0 B{ends}"
    return printer.theta, ["; B is where cranks point when encoders read zero.", command]


FORMATS = {KLIPPER: list_klipper_files, MARLIN: list_marlin_files, REPRAP: list_reprapfirmware_files}
"""Files of a calibrated printer by the name of its firmware; InputError for a machine that it does not drive."""
