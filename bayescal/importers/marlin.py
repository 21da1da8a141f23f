"""A linear delta in commands M665 and M666, of Marlin (what M503 prints) or RepRapFirmware (``config.g``).

Both have the arms L, the radius R, the height H of the tool over the bed at home, and as X, Y and Z the directions of
the towers less 210, 330 and 90 degrees. They differ in the rest. Marlin's A, B and C are what each arm is longer than
L, and M666 is by how much a carriage goes on from its endstop, never up: e = H - M666. RepRapFirmware's L may be three
lengths, B is the radius of the bed, and M666 is how much higher an endstop is: e = H + M666.

Such a file holds a machine and no readings: the project is an audit of heights to probe.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from bayescal.errors import InputError
from bayescal.files.csv_tables import format_table
from bayescal.importers import Project, fill_template
from bayescal.importers.delta_files import ANGLES, LARGEST_MM, SMALLEST_MM, format_delta, parse_number

MARLIN, REPRAP = "marlin", "reprapfirmware"
NAMES = {MARLIN: "Marlin", REPRAP: "RepRapFirmware"}
OPTION = "firmware"
COMMAND = re.compile(r"^(?:[^;]*?[\s:>])?(M66[56])(?=[\s;]|$)([^;]*)")
WORD = re.compile(r"([A-Z])\s*([^\sA-Z]*)")
TURN = 360.0
BED = 0.9  # of the radius of the towers, where the file does not say how large the bed is
PROBED = (0.95, 0.9, 0.85, 0.7, 0.75, 0.8)  # of the bed's radius: on one circle radius and arms could not be told apart

SHAPE, ENDSTOPS = "M665", "M666"


@dataclass(frozen=True)
class _Commands:
    """What commands set: by their names and letters the text behind a letter, and the line."""

    path: Path
    words: dict[str, dict[str, tuple[str, int]]]
    lines: dict[str, int]  # of commands, their last ones

    def fail(self, text: str, letter: str = "") -> InputError:
        """Return the error of a letter of M665."""
        line = self.words[SHAPE][letter][1] if letter in self.words[SHAPE] else self.lines[SHAPE]
        return InputError(f"{self.path}, line {line}: {letter or SHAPE}: {text}")

    def text(self, letter: str) -> str:
        """Return what stands behind a letter of M665; nothing where it is not there."""
        return self.words[SHAPE].get(letter, ("", 0))[0]

    def take(self, letter: str, least: float, fallback: float | None = None, command: str = SHAPE) -> float:
        """Return a number; InputError where there is none and nothing falls back, or it is smaller than it may be."""
        if letter in self.words[command]:
            value, line = self.words[command][letter]
            return parse_number(value, letter, (self.path, line), least)
        if fallback is None:
            raise self.fail(f"found no {letter}, expected it")
        return fallback

    def take_three(self, letters: str, command: str = SHAPE) -> list[float]:
        """Return numbers of three letters, zero where they are not there."""
        return [self.take(letter, -LARGEST_MM, 0.0, command) for letter in letters]


def recognise(name: str, text: str) -> bool:
    """Return whether a text, whatever its file's name, sets a delta's geometry."""
    del name
    return any((found := COMMAND.match(line)) and found[1] == SHAPE for line in text.split("\n"))


def convert(path: Path, text: str, options: Mapping[str, str]) -> Project:
    """Return a delta and an audit of heights as a project; InputError, with the line, where something is missing."""
    for key in set(options) - {OPTION}:
        raise InputError(f"--option {key}: found it, expected {OPTION}")
    commands = _Commands(path, {SHAPE: {}, ENDSTOPS: {}}, {SHAPE: 1, ENDSTOPS: 1})
    for line, raw in enumerate(text.split("\n"), start=1):
        if match := COMMAND.match(raw):
            commands.lines[match[1]] = line
            commands.words[match[1]] |= {letter: (value, line) for letter, value in WORD.findall(match[2].upper())}
    firmware = _choose_firmware(commands, text, options.get(OPTION))
    radius, height = commands.take("R", SMALLEST_MM), commands.take("H", -LARGEST_MM)
    arms = _read_arms(commands, firmware)
    for arm in arms:
        if not radius < arm <= LARGEST_MM:
            raise commands.fail(f"found an arm of {arm:g}, expected more than R, {radius:g}", "L")
    sign = -1.0 if firmware == MARLIN else 1.0
    endstops = [height + sign * one for one in commands.take_three("XYZ", ENDSTOPS)]
    angles = [at + one for at, one in zip(ANGLES, commands.take_three("XYZ"), strict=True)]
    for letter, angle in zip("XYZ", angles, strict=True):
        if not abs(angle) <= TURN:
            raise commands.fail(f"found {commands.text(letter)!r}, expected a tower's turn in degrees", letter)
    bed = commands.take("B", SMALLEST_MM, BED * radius) if firmware == REPRAP else BED * radius
    bed = min(bed, 0.99 * (min(arms) - radius))
    said = [
        f"{NAMES[firmware]}, line {commands.lines[SHAPE]}: R {radius:g}, L {_join(arms)}, H {height:g}",
        f"endstops at {_join(endstops)} mm",
        "no readings in such a file: audit.toml says what heights of seven points would determine",
    ]
    if firmware == REPRAP and any(commands.take_three("AB", ENDSTOPS)):
        said.append("left out: tilt of the bed, A and B of M666")
    source = f"M665 and M666 of {NAMES[firmware]}"
    files = {
        "machine.toml": format_delta(source, radius, arms, endstops, angles, bed).encode(),
        "heights.csv": _format_heights(bed).encode(),
        "audit.toml": fill_template("delta_audit").encode(),
    }
    return Project(files, tuple(said), "bayescal audit audit.toml")


def _choose_firmware(commands: _Commands, text: str, stated: str | None) -> str:
    """Return whose commands they are; InputError where nothing says it."""
    if stated is not None:
        if stated not in NAMES:
            raise InputError(f"--option {OPTION}: found {stated!r}, expected {' or '.join(NAMES)}")
        return stated
    words = commands.words[SHAPE]
    if "S" in words or "echo:" in text:
        return MARLIN
    if ":" in commands.text("L") or "B" in words or commands.path.suffix == ".g":
        return REPRAP
    expected = " or ".join(f"--option {OPTION}={one}" for one in NAMES)
    raise commands.fail(f"found nothing that tells the firmware, expected {expected}")


def _read_arms(commands: _Commands, firmware: str) -> list[float]:
    """Return the arms' lengths, mm."""
    if firmware == MARLIN:
        own = {"A", "C"} & {*commands.words[SHAPE]}  # before there were these, B was a radius
        length = commands.take("L", SMALLEST_MM)
        return [length + one for one in (commands.take_three("ABC") if own else [0.0] * 3)]
    parts = commands.text("L").split(":")
    if len(parts) == 1:
        return [commands.take("L", SMALLEST_MM)] * 3
    if len(parts) != 3:
        raise commands.fail(f"found {len(parts)} lengths, expected 1 or 3", "L")
    line = commands.words[SHAPE]["L"][1]
    return [parse_number(one, "L", (commands.path, line), SMALLEST_MM) for one in parts]


def _join(values: Sequence[float]) -> str:
    return " ".join(f"{one:g}" for one in values)


def _format_heights(bed: float) -> str:
    """Return seven points of the bed, at several distances from the centre."""
    rows = [["H0", "0.0", "0.0", "0.0"]]
    for k, share in enumerate(PROBED):
        turn = np.radians(90.0 + 60.0 * k)
        rows.append(
            [f"H{k + 1}", *(repr(round(share * bed * float(f(turn)), 3) + 0.0) for f in (np.cos, np.sin)), "0.0"]
        )
    return format_table(["Points of the bed whose heights are probed."], ["pose", "x_mm", "y_mm", "z_mm"], rows)
