"""Star files of TPOINT: where stars stood on the sky, and what the encoders of a mount read there.

Lines below a caption: options, each after a colon, of which ``ALTAZ`` says that the mount turns in azimuth and
elevation; a record of the site, whose first three numbers are its latitude (degrees, minutes, seconds); then an
observation a line, azimuth and elevation on the sky, azimuth and elevation of the encoders, in degrees, or each in
degrees, minutes and seconds. Up to three auxiliary readings may follow, which are passed over. ``!`` begins a comment,
``END`` ends the file. Azimuths are from north through east, unless a comment says ``South = 0``, or the option
``azimuth_from`` does.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from bayescal.errors import InputError
from bayescal.files.csv_tables import format_table
from bayescal.files.plain_text import make_plain
from bayescal.importers import Project, fill_template
from bayescal.machines.readings.mount import ALTAZIMUTH, TERMS, correct_altazimuth
from bayescal.numerics.geometry import Array
from bayescal.numerics.units import ARCSECOND

AZIMUTH_FROM: Final = "azimuth_from"
STARTS: Final = ("north", "south")
SOUTH_IS_ZERO: Final = re.compile(r"\bsouth\s*=\s*0", re.IGNORECASE)
WITHOUT_EFFECT: Final = ("NODA", "ALLSKY", "ROTNL", "ROTNR", "ROTTEL")
"""Options that do not change what the columns mean."""
FEWEST: Final = 6
"""Stars of which eight terms can be said at all, two readings each."""
AUXILIARY: Final = 3
FARTHEST: Final = 10.0
"""Degrees by which a star may be off the others: more than any mount is wrong, less than any exchanged column."""
TURNS: Final = 720.0
"""Degrees that azimuths may count up to, by a mount that turns more than once."""
LONGEST_CAPTION: Final = 200
ALIGNED: Final = 0.99
"""Mean length of unit vectors from which on directions agree."""

type Fault = Callable[[int, str], InputError]
"""The error of a line, by its number, and what is wrong with it."""


@dataclass(frozen=True)
class _Line:
    """A line that counts: its number in the file and its text."""

    number: int
    text: str


def recognise(name: str, text: str) -> bool:
    """Return whether a text has a caption and then an option after a colon, or ends as star files do."""
    del name
    lines = [one.text for one in _list_lines(text)]
    options = [one[1:].strip().upper() for one in lines[1:] if one.startswith(":")]
    return any(one in ("ALTAZ", "EQUAT", "GIMBAL", *WITHOUT_EFFECT) for one in options)


def convert(path: Path, text: str, options: Mapping[str, str]) -> Project:
    """Return a star file as a mount, its stars and a study; InputError, with the line, for what is none."""
    for key in options:
        if key != AZIMUTH_FROM:
            raise InputError(f"--option: found {key!r}, expected {AZIMUTH_FROM}")
    start, found = _find_start(text, options), []
    if AZIMUTH_FROM not in options and start != STARTS[0]:
        found.append("azimuths are counted from south, as a comment of the file says")
    caption, latitude, stars = _read(path, text)
    found.insert(0, f"{len(stars)} stars of a mount of azimuth and elevation at latitude {latitude:.4f}°")
    scatter = _estimate_scatter(stars, start)
    file, caption = make_plain(path.name), make_plain(caption)
    where = f"the star file {file}, at latitude {latitude:.6f} degrees"
    files = {
        "machine.toml": _write_machine(stars, caption, where, start),
        "data/stars.csv": _write_stars(stars, caption, where, start),
        "study.toml": _write_study(stars, scatter, caption, file),
    }
    return Project({name: content.encode() for name, content in files.items()}, tuple(found))


def _find_start(text: str, options: Mapping[str, str]) -> str:
    """Return from where azimuths are counted."""
    start = options.get(AZIMUTH_FROM)
    if start is not None and start not in STARTS:
        raise InputError(f"--option: {AZIMUTH_FROM}: found {start!r}, expected {' or '.join(STARTS)}")
    comments = (line for line in text.splitlines() if line.lstrip().startswith("!"))
    return start or STARTS[any(SOUTH_IS_ZERO.search(one) for one in comments)]


# --- reading ---------------------------------------------------------------------------------------------------------


def _list_lines(text: str) -> list[_Line]:
    """Return the lines that count, up to the one that ends the file."""
    found = list[_Line]()
    for number, line in enumerate(text.splitlines(), start=1):
        own = line.partition("!")[0].strip()
        if own.upper() == "END" and found:
            break
        if own:
            found.append(_Line(number, own))
    return found


def _read(path: Path, text: str) -> tuple[str, float, Array]:
    """Return the caption, the latitude in degrees, and directions (P, 4) in degrees."""

    def fault(number: int, said: str) -> InputError:
        return InputError(f"{path}, line {number}: {make_plain(said)}")

    caption, *lines = _list_lines(text)
    named = [(one, one.text[1:].strip().upper()) for one in lines if one.text.startswith(":")]
    for one, option in named:
        if option not in ("ALTAZ", *WITHOUT_EFFECT):
            raise fault(one.number, f"found option {option[:40]!r}, expected ALTAZ: stars by azimuth and elevation")
    if all(option != "ALTAZ" for _, option in named):
        raise fault(named[0][0].number, "found no option ALTAZ, expected stars by azimuth and elevation")
    records = [one for one in lines if not one.text.startswith(":")]
    if not records:
        raise fault(caption.number, "found no record below the caption, expected the site's latitude and stars")
    site, *observed = records
    parts = _parse(site, fault)
    if len(parts) == 4 or len(parts) < 3:
        raise fault(
            site.number, f"found {len(parts)} numbers, expected the site's latitude as degrees, minutes, seconds"
        )
    latitude = _join(site, 0, parts, fault)
    if abs(latitude) > 90.0:
        raise fault(site.number, f"found latitude {latitude:g}, expected -90 to 90 degrees")
    if len(observed) < FEWEST:
        raise fault(site.number, f"found {len(observed)} stars below it, expected at least {FEWEST}")
    stars = np.array([_read_star(one, fault) for one in observed])
    _check(stars, [one.number for one in observed], fault)
    return caption.text[:LONGEST_CAPTION], latitude, stars


def _parse(line: _Line, fault: Fault) -> list[float]:
    """Return the numbers of a line."""
    found = []
    for cell in line.text.split():
        try:
            value = float(cell.replace("D", "E").replace("d", "e"))
        except ValueError:
            value = math.nan
        if not math.isfinite(value) or "_" in cell:
            raise fault(line.number, f"found {cell[:40]!r}, expected a number")
        found.append(value)
    return found


def _join(line: _Line, first: int, values: Sequence[float], fault: Fault) -> float:
    """Return three numbers of a line, degrees, minutes, seconds, in degrees; the sign, of -0 too, is of the whole."""
    degrees, minutes, seconds = values[first : first + 3]
    if not (0.0 <= minutes < 60.0 and 0.0 <= seconds < 60.0):
        raise fault(line.number, f"found {minutes:g} minutes, {seconds:g} seconds, expected 0 to below 60")
    return math.copysign(abs(degrees) + minutes / 60.0 + seconds / 3600.0, degrees)


def _read_star(line: _Line, fault: Fault) -> list[float]:
    """Return azimuth and elevation on the sky, azimuth and elevation of the encoders, degrees."""
    values = _parse(line, fault)
    if 4 <= len(values) <= 4 + AUXILIARY:
        return values[:4]
    if 12 <= len(values) <= 12 + AUXILIARY:
        return [_join(line, k, values, fault) for k in range(0, 12, 3)]
    raise fault(line.number, f"found {len(values)} numbers, expected 4 in degrees, or 12 in degrees, minutes, seconds")


def _check(stars: Array, lines: Sequence[int], fault: Fault) -> None:
    """Refuse stars below the horizon, in other units, counted the other way round, far off the others or twice."""
    sky, mount = stars[:, :2], stars[:, 2:]
    for k in np.flatnonzero((np.abs(stars[:, ::2]) > TURNS).any(axis=1))[:1]:
        raise fault(lines[k], f"found azimuths {stars[k, 0]:g} and {stars[k, 2]:g}, expected at most {TURNS:g} degrees")
    for k in np.flatnonzero(~((sky[:, 1] > 0.0) & (sky[:, 1] < 90.0)))[:1]:
        side = "below the horizon" if sky[k, 1] <= 0.0 else "beyond the zenith"
        raise fault(lines[k], f"found a star at elevation {sky[k, 1]:g}, {side}, expected 0 to 90 degrees")
    if np.abs(sky[:, 0]).max() <= 2.0 * np.pi and sky[:, 1].max() <= np.pi / 2.0:
        raise fault(lines[0], f"found azimuths up to {sky[:, 0].max():g}, expected degrees; radians perhaps")
    against, along = (np.exp(1j * np.radians(mount[:, 0] + sign * sky[:, 0])).mean() for sign in (1.0, -1.0))
    if abs(against) > ALIGNED > abs(along):
        raise fault(
            lines[0], "found azimuths of the mount that fall as those of the sky grow, expected both through east"
        )
    turned = np.degrees(np.angle(np.exp(1j * np.radians(mount[:, 0] - sky[:, 0])) / (along or 1.0)))
    middle = np.median(turned)
    off = np.stack([turned - middle, mount[:, 1] - sky[:, 1] - np.median(mount[:, 1] - sky[:, 1])], axis=1)
    off[:, 0] = (off[:, 0] + 180.0) % 360.0 - 180.0
    off[:, 0] *= np.cos(np.radians(sky[:, 1]))
    for k in np.flatnonzero((np.abs(off) > FARTHEST).any(axis=1))[:1]:
        worst = off[k, np.argmax(np.abs(off[k]))]
        raise fault(lines[k], f"found a mount {worst:.3g} degrees off the other stars, expected at most {FARTHEST:g}")
    first = dict[bytes, int]()
    for k, star in enumerate(stars):
        other = first.setdefault(star.tobytes(), lines[k])
        if other != lines[k]:
            raise fault(lines[k], f"found the star of line {other}, expected each once")


def _find_zeros(stars: Array) -> Array:
    """Return what encoders read beyond the sky on average, azimuth and elevation (2,), degrees."""
    turned = np.exp(1j * np.radians(stars[:, 2] - stars[:, 0])).mean()
    return np.array([np.degrees(np.angle(turned)), float(np.mean(stars[:, 3] - stars[:, 1]))])


def _estimate_scatter(stars: Array, start: str) -> Array:
    """Return what least squares of all terms leave in azimuth and elevation (2,), arcsec, to one digit."""
    sky = np.radians(stars[:, :2])
    azimuth, sign = (sky[:, 0], 1.0) if start == STARTS[0] else (np.pi - sky[:, 0], -1.0)
    units = dict(zip(TERMS[ALTAZIMUTH], np.eye(8)[:, :, None], strict=True))
    columns = np.stack(np.broadcast_arrays(*correct_altazimuth(units, azimuth, sky[:, 1])), axis=-1)  # (8, P, 2)
    zeros = _find_zeros(stars)
    off = stars[:, :2] - stars[:, 2:] + zeros
    off[:, 0] = sign * ((off[:, 0] + 180.0) % 360.0 - 180.0)
    rows = columns.reshape(8, -1).T
    left = np.radians(off).ravel() - rows @ np.linalg.lstsq(rows, np.radians(off).ravel())[0]
    spare = max(2 * len(stars) - 8, 1) / 2.0
    rms = np.sqrt((left.reshape(-1, 2) ** 2).sum(axis=0) / spare) / ARCSECOND
    return np.array([float(f"{max(one, 0.01):.0e}") for one in rms])


# --- writing ---------------------------------------------------------------------------------------------------------


def _write_stars(stars: Array, caption: str, where: str, start: str) -> str:
    comments = [
        f"{caption}: stars of {where}.",
        f"Azimuth (from {start} through east) and elevation on the sky beside those of the encoders, degrees.",
    ]
    columns = ["pose", "azimuth_deg", "elevation_deg", "encoder_1_deg", "encoder_2_deg"]
    rows = [[f"S{k:02d}", *map(repr, star.tolist())] for k, star in enumerate(stars, start=1)]
    return format_table(comments, columns, rows)


def _write_machine(stars: Array, caption: str, where: str, start: str) -> str:
    low = max(5.0 * math.floor(stars[:, 1].min() / 5.0), 1.0)
    high = min(5.0 * math.ceil(stars[:, 1].max() / 5.0), 89.0)
    return fill_template("mount", where=where, title=_quote(caption), start=start, low=low, high=high)


def _write_study(stars: Array, scatter: Array, caption: str, file: str) -> str:
    zeros = [max(3600.0, float(f"{7200.0 * abs(one):.0e}")) for one in _find_zeros(stars)]
    others = max(60.0, 30.0 * float(scatter.max()))
    priors = dict.fromkeys(TERMS[ALTAZIMUTH], others) | {"IA": zeros[0], "IE": zeros[1]}
    tolerances = "\n".join(f'{name} = {{ prior = "normal", sd = {float(sd)} }}' for name, sd in priors.items())
    flexure = [name for name in TERMS[ALTAZIMUTH] if name != "TX"]
    return fill_template(
        "mount_study",
        title=_quote(caption),
        source=_quote(file),
        first=scatter[0],
        second=scatter[1],
        tolerances=tolerances,
        flexure=json.dumps(flexure),
    )


def _quote(text: str) -> str:
    """Return a text as TOML has it."""
    return json.dumps(text, ensure_ascii=False)
