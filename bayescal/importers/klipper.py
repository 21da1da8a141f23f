"""Klipper's ``printer.cfg`` of a linear delta: its geometry, and the heights and distances of its own calibration.

Klipper keeps them in the block after SAVE_CONFIG, section ``[delta_calibrate]``: ``heightN`` (also ``manual_heightN``)
or ``distanceN``, mm, and where the carriages were, in steps from their endstops (Delta_Calibrate in its documentation).
A step is rotation_distance / (full steps · microsteps · gear ratio). Those sections of the file that people edit hold
the nominal geometry; SAVE_CONFIG makes comments of what it replaces, which are nominal all the same.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from bayescal.errors import InputError
from bayescal.files.csv_tables import format_table
from bayescal.importers import Project, fill_template
from bayescal.importers.delta_files import ANGLES, LARGEST_MM, SMALLEST_MM, format_delta, parse_number

SAVED = "#*#"
TOWERS = ("stepper_a", "stepper_b", "stepper_c")
FULL_STEPS = 200.0
HEIGHT_UM = 28.0  # noise; how large it is in fact the data tell
SMALLEST_STEP = 1e-6  # mm
WEIGHT = 0.5  # of all heights against all distances in Klipper's own fit
SECTION, KEY = re.compile(r"\[\s*([^\]]+?)\s*\]"), re.compile(r"([A-Za-z_][\w]*)\s*[:=]\s*(.*)")
STEPPERS = re.compile(r"^\s*\[\s*stepper_[a-z0-9]+\s*\]", re.MULTILINE)
PRINTER = re.compile(r"^\s*\[\s*printer\s*\]", re.MULTILINE)


@dataclass(frozen=True)
class _Entry:
    text: str
    line: int
    how: str = ""  # "set aside" in a comment, or "saved" by the firmware


@dataclass
class _Settings:
    """Entries of a printer's file by section and key: as people wrote them, and as the firmware saved them."""

    path: Path
    written: dict[str, dict[str, _Entry]] = field(default_factory=dict)
    aside: dict[str, dict[str, _Entry]] = field(default_factory=dict)
    saved: dict[str, dict[str, _Entry]] = field(default_factory=dict)
    lines: dict[str, int] = field(default_factory=dict)  # of sections
    last: int = 1  # line of the file

    def fail(self, line: int, text: str) -> InputError:
        """Return the error of a line."""
        return InputError(f"{self.path}, line {line}: {text}")

    def find(self, section: str, key: str) -> _Entry | None:
        """Return an entry as people have it, or else what the firmware put aside, or saved."""
        for place in (self.written, self.aside, self.saved):
            if (found := place.get(section, {}).get(key)) is not None:
                return found
        return None

    def nominal(self, tower: str, key: str) -> _Entry | None:
        """Return a tower's entry, or else the first tower's, which is that of all: as people have it, or saved."""
        first = TOWERS[0]
        for places in ((self.written, self.aside), (self.saved,)):
            for one in (tower, first):
                for place in places:
                    if (found := place.get(one, {}).get(key)) is not None:
                        return found
        return None

    def number(self, section: str, key: str, fallback: float | None = None, least: float = -LARGEST_MM) -> float:
        """Return a number; InputError where there is none and nothing falls back, or it is smaller than it may be."""
        entry = self.find(section, key)
        if entry is None:
            if fallback is not None:
                return fallback
            line = self.lines.get(section)
            missing = f"found no {key} in [{section}]" if line else f"found no [{section}] with {key}"
            raise self.fail(line or self.last, f"{missing}, expected it")
        return self.parse(entry, key, least)

    def parse(self, entry: _Entry, key: str, least: float = -LARGEST_MM, most: float = LARGEST_MM) -> float:
        """Return an entry's number."""
        return parse_number(entry.text, key, (self.path, entry.line), least, most)

    def place(self, key: str) -> tuple[float, float, float]:
        """Return a stable position of [delta_calibrate], steps."""
        entry = self.find("delta_calibrate", key)
        if entry is None:
            raise self.fail(self.lines.get("delta_calibrate", self.last), f"found no {key}, expected three step counts")
        parts = entry.text.split(",")
        if len(parts) != len(TOWERS):
            raise self.fail(entry.line, f"{key}: found {entry.text!r}, expected three step counts")
        one, two, three = (self.parse(_Entry(part.strip(), entry.line), key) for part in parts)
        return one, two, three


def recognise(name: str, text: str) -> bool:
    """Return whether a file is a printer's configuration: it has [printer] and [stepper_...], whatever its name."""
    del name
    return bool(PRINTER.search(text) and STEPPERS.search(text))


def convert(path: Path, text: str, options: Mapping[str, str]) -> Project:
    """Return a delta with its calibration's readings as a project; InputError, with the line, for any other printer."""
    for key in options:
        raise InputError(f"--option {key}: found it, expected none for {path}")
    settings = _read(path, text)
    kinematics = settings.find("printer", "kinematics")
    if kinematics is None or kinematics.text != "delta":
        found = "no kinematics" if kinematics is None else repr(kinematics.text)
        line = settings.lines.get("printer", 1) if kinematics is None else kinematics.line
        raise settings.fail(line, f"kinematics: found {found}, expected delta")
    steps = np.array([_measure_step(settings, tower) for tower in TOWERS])
    heights = [*_list_heights(settings, "height"), *_list_heights(settings, "manual_height")]
    distances = list(_list_distances(settings))
    if not heights and not distances:
        line = settings.lines.get("delta_calibrate", settings.last)
        raise settings.fail(line, "found no heights of [delta_calibrate], expected those that SAVE_CONFIG keeps")
    machine, said = _describe_machine(settings, bool(distances))
    known = _list_saved(settings)
    files = {
        "machine.toml": machine.encode(),
        "data/readings.csv": _format_readings(path.name, steps, heights, distances).encode(),
        "study.toml": _format_study(len(heights), len(distances), bool(known)).encode(),
    }
    if known:
        rows = [[name, unit, repr(value)] for name, unit, value in known]
        comment = ["What Klipper's own fit found of the same data."]
        files["data/klipper.csv"] = format_table(comment, ["quantity", "unit", "value"], rows).encode()
    step = ", ".join(dict.fromkeys(f"{one:g}" for one in steps))
    lines = [f"readings: {len(heights)} heights, {len(distances)} distances; a step is {step} mm", *said]
    if known:
        lines.append("compared with: Klipper's own fit, in the block that it saved")
    return Project(files, tuple(lines))


# --- what the file says ----------------------------------------------------------------------------------------------


def _read(path: Path, text: str) -> _Settings:
    """Return the settings of a file; what is no setting is passed over."""
    settings, section, saved_section = _Settings(path), "", ""
    line = 1
    for line, raw in enumerate(text.split("\n"), start=1):
        is_saved = raw.startswith(SAVED)
        content = raw.removeprefix(SAVED).strip() if is_saved else raw.strip()
        if found := SECTION.match(content):
            name = found[1].lower()
            settings.lines.setdefault(name, line)
            if is_saved:
                saved_section = name
            else:
                section = name
            continue
        is_aside = not is_saved and content.startswith("#")
        content = re.split(r"\s[#;]|^;", content.removeprefix("#") if is_aside else content)[0].strip()
        if not (found := KEY.fullmatch(content)):
            continue
        place = settings.saved if is_saved else settings.aside if is_aside else settings.written
        how = "saved by the firmware" if is_saved else "set aside in a comment" if is_aside else ""
        entries = place.setdefault(saved_section if is_saved else section, {})
        entry = _Entry(found[2].strip(), line, how)
        if not is_aside:
            entries[found[1].lower()] = entry
        elif _is_number(entry.text):  # other comments are text
            entries.setdefault(found[1].lower(), entry)
    settings.last = line
    return settings


def _is_number(text: str) -> bool:
    try:
        return bool(np.isfinite(float(text)))
    except ValueError:
        return False


def _measure_step(settings: _Settings, tower: str) -> float:
    """Return the travel of one step, mm."""
    if (old := settings.find(tower, "step_distance")) is not None:
        return settings.parse(old, "step_distance", SMALLEST_STEP)
    turn = settings.number(tower, "rotation_distance", least=SMALLEST_MM)
    micro = settings.number(tower, "microsteps", least=1.0)
    steps = settings.number(tower, "full_steps_per_rotation", FULL_STEPS, least=1.0)
    gear = 1.0
    if (ratio := settings.find(tower, "gear_ratio")) is not None:
        for pair in ratio.text.split(","):
            parts = [
                settings.parse(_Entry(one.strip(), ratio.line), "gear_ratio", SMALLEST_MM) for one in pair.split(":")
            ]
            if len(parts) != 2:
                raise settings.fail(ratio.line, f"gear_ratio: found {ratio.text!r}, expected pairs such as 80:20")
            gear *= parts[0] / parts[1]
    step = turn / (steps * micro * gear)
    if not SMALLEST_STEP <= step <= LARGEST_MM:
        raise settings.fail(settings.lines[tower], f"found a step of {step:g} mm in [{tower}], expected another")
    return step


type _Place = tuple[float, float, float]


def _list_heights(settings: _Settings, name: str) -> Iterator[tuple[float, _Place]]:
    """Yield heights, mm, with the steps of the carriages."""
    k = 0
    while settings.find("delta_calibrate", f"{name}{k}") is not None:
        yield settings.number("delta_calibrate", f"{name}{k}"), settings.place(f"{name}{k}_pos")
        k += 1


def _list_distances(settings: _Settings) -> Iterator[tuple[float, _Place, _Place]]:
    """Yield distances, mm, with the steps of the carriages at both ends."""
    k = 0
    while settings.find("delta_calibrate", f"distance{k}") is not None:
        ends = settings.place(f"distance{k}_pos1"), settings.place(f"distance{k}_pos2")
        yield settings.number("delta_calibrate", f"distance{k}", least=0.0), *ends
        k += 1


def _describe_machine(settings: _Settings, paired: bool) -> tuple[str, list[str]]:
    """Return the machine's file, and in words where its numbers are from."""
    sources = [("delta_radius", "printer", settings.find("printer", "delta_radius"))]
    sources += [
        (key, tower, settings.nominal(tower, key)) for key in ("arm_length", "position_endstop") for tower in TOWERS
    ]
    numbers, said = list[float](), list[str]()
    for key, section, entry in sources:
        if entry is None:
            raise settings.fail(
                settings.lines.get(section, settings.last), f"found no {key} in [{section}], expected it"
            )
        numbers.append(settings.parse(entry, key, -LARGEST_MM if key == "position_endstop" else SMALLEST_MM))
        how = f", {entry.how}" if entry.how else ""
        said.append(f"nominal: {key} {numbers[-1]:g}, line {entry.line}{how}")
    radius, arms, endstops = numbers[0], numbers[1:4], numbers[4:]
    angles = [
        angle if (entry := settings.find(tower, "angle")) is None else settings.parse(entry, "angle", -360.0, 360.0)
        for tower, angle in zip(TOWERS, ANGLES, strict=True)
    ]
    for (_, _, entry), arm in zip(sources[1:4], arms, strict=True):
        if arm <= radius:
            assert entry is not None
            raise settings.fail(entry.line, f"arm_length: found {arm:g}, expected more than delta_radius, {radius:g}")
    bed = settings.number(
        "delta_calibrate", "radius", settings.number("printer", "print_radius", radius, SMALLEST_MM), SMALLEST_MM
    )
    return format_delta("Klipper's printer.cfg", radius, arms, endstops, angles, bed, paired), list(dict.fromkeys(said))


def _list_saved(settings: _Settings) -> list[tuple[str, str, float]]:
    """Return what the firmware's own fit saved, by parameter; the third angle is a convention."""
    keys = [("r", "mm", "printer", "delta_radius")]
    keys += [(f"angle[{k}]", "deg", TOWERS[k - 1], "angle") for k in (1, 2)]
    keys += [
        (f"{symbol}[{k}]", "mm", tower, key)
        for symbol, key in (("l", "arm_length"), ("e", "position_endstop"))
        for k, tower in enumerate(TOWERS, start=1)
    ]
    found = [(name, unit, settings.saved.get(section, {}).get(key), key) for name, unit, section, key in keys]
    return [(name, unit, settings.parse(entry, key)) for name, unit, entry, key in found if entry is not None]


# --- the project -----------------------------------------------------------------------------------------------------


def _format_readings(
    name: str,
    steps: np.ndarray,
    heights: Sequence[tuple[float, _Place]],
    distances: Sequence[tuple[float, _Place, _Place]],
) -> str:
    """Return the table of readings: how far carriages are below their endstops, heights and distances, mm."""

    def travel(place: _Place) -> list[str]:
        return [f"{one:.6f}" for one in steps * np.array(place)]

    shown = "".join(one for one in name if one.isprintable())
    comment = [f"Heights and distances that Klipper keeps in {shown}; s is the travel below the endstops."]
    if not distances:
        columns = ["pose", *(f"s_{k}_mm" for k in (1, 2, 3)), "height_mm"]
        return format_table(
            comment, columns, [[f"H{k}", *travel(place), repr(round(at, 6))] for k, (at, place) in enumerate(heights)]
        )
    columns = ["pose", *(f"s_{k}{place}_mm" for place in "ab" for k in (1, 2, 3)), "height_a_mm", "distance_mm"]
    rows = [[f"H{k}", *travel(place), "", "", "", repr(round(at, 6)), ""] for k, (at, place) in enumerate(heights)]
    rows += [
        [f"D{k}", *travel(one), *travel(other), "", repr(round(away, 6))]
        for k, (away, one, other) in enumerate(distances)
    ]
    return format_table(comment, columns, rows)


def _format_study(n_heights: int, n_distances: int, compared: bool) -> str:
    """Return the study: what is free, how good heights and distances are."""
    distance = "" if not n_distances else _weigh_distance(n_heights, n_distances)
    if n_distances:
        variants = """  { name = "arms_differ", title = "Each arm its length", fixed = ["angle[3]"] },
  { name = "arms_alike", title = "Arms of one length", fixed = ["angle[3]"], tied = ["l"] },
"""
    else:
        free = 'free = ["r", "e", "angle[1]", "angle[2]"], noise_known = true'
        variants = f"""  {{ name = "arms_known", title = "Arms as stated", {free} }},
"""
    beside = '\n[[reference_values]]\ntitle = "Klipper\'s fit"\nfile = "data/klipper.csv"\n' if compared else ""
    return fill_template("delta_study", variants=variants, height=HEIGHT_UM, distance=distance, reference=beside)


def _weigh_distance(n_heights: int, n_distances: int) -> str:
    """Return the line of the distances' noise, by which they weigh as much against heights as in Klipper's fit."""
    noise = HEIGHT_UM * (n_distances / (WEIGHT * max(1, n_heights))) ** 0.5
    return f'distance = {{ noise_um = {round(noise, 1)!r}, noise_group = "probe_and_calliper" }}\n'
