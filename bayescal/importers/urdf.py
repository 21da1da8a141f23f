"""An arm in a URDF file: the project is an audit of what a ball in a socket, or a tracker, would tell of it.

A URDF file holds a machine and no readings. With ``instrument = socket``, which holds where nothing is said, a ball at
the tip sits in a socket, at configurations that lead it there within the joints' limits, or with ``sockets = 2`` in
either of two whose distance is known, which gives the arm its scale; with ``tracker`` the tip is seen at configurations
all over these. A xacro file is expanded first; options that are none of these are its arguments.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Final

import numpy as np

from bayescal.config.load import FOLDER
from bayescal.errors import InputError
from bayescal.files.csv_tables import format_table
from bayescal.files.memory import MemoryPath
from bayescal.files.toml import write_toml
from bayescal.importers import Project, fill_template
from bayescal.importers.xacro_files import SUFFIX, expand, name_urdf
from bayescal.machines.chains import name_arm, read_urdf
from bayescal.machines.readings import place
from bayescal.machines.readings.arm import Arm, ArmConfig
from bayescal.machines.readings.function import FunctionModel
from bayescal.machines.readings.newton import share_contacts, touch
from bayescal.machines.readings.placed import READ_BY
from bayescal.machines.readings.sockets import SocketConfig, SocketInstrument
from bayescal.numerics.geometry import Array

SOCKET, TRACKER = "socket", "tracker"
OPTIONS: Final = ("base", "tip", "instrument", "sockets")
N_POSES, TRIES = 40, 2000
SAME = 3  # digits of rad or mm, to which configurations are the same
INNER = 0.95  # of the joints' ranges
APART = 0.4  # of how far out sockets stand, by which two are apart


REPEATS = "# how well the joints repeat"
NOWHERE = "[instruments]                            # the place of each is found\n"


def recognise(name: str, text: str) -> bool:
    """Return whether a file is URDF, or xacro, by its name or by its first element."""
    return name.lower().endswith((".urdf", ".xacro")) or "<robot" in text[:2000]


def convert(path: Path, text: str, options: Mapping[str, str]) -> Project:
    """Return an arm and an audit as a project; InputError, with the line, for a file without a chain of joints."""
    if path.suffix.lower() == SUFFIX:
        name = name_urdf(path)
        arguments = {key: value for key, value in options.items() if key not in OPTIONS}
        expanded = {name: expand(path, arguments)}
        kept = {key: value for key, value in options.items() if key in OPTIONS}
        return convert(MemoryPath(name, files=expanded), "", kept)
    for key in set(options) - {*OPTIONS}:
        raise InputError(f"--option {key}: found it, expected one of {', '.join(OPTIONS)}")
    instrument = options.get("instrument", SOCKET)
    if instrument not in (SOCKET, TRACKER):
        raise InputError(f"--option instrument: found {instrument!r}, expected {SOCKET} or {TRACKER}")
    n_sockets = options.get("sockets", "1")
    if n_sockets not in ("1", "2") or ("sockets" in options and instrument != SOCKET):
        raise InputError(f"--option sockets: found {n_sockets!r} with {instrument}, expected 1 or 2 with {SOCKET}")
    chain = read_urdf(path, options.get("base", ""), options.get("tip", ""))
    section = {key: options[key] for key in ("base", "tip") if key in options}
    config = ArmConfig.model_validate({"urdf": path.name, **section}, context={FOLDER: path.parent})
    name = name_arm(path)
    model, file = FunctionModel(name, Arm(config)), f"{name}.urdf"
    n, names = len(chain.joints), ", ".join(one.name for one in chain.joints)
    places, columns = _choose_places(model, int(n_sockets)), [f"{one.name}_{one.unit}" for one in model.coordinates]
    if instrument == TRACKER:
        cells = [[f"{x:.6f}" for x in row] for row in _spread(model, N_POSES)]
    else:
        rows, seated = _seat(model, places)
        cells = [[*(f"{x:.6f}" for x in row), socket] for row, socket in zip(rows, seated, strict=True)]
        columns.append(READ_BY)
    content = {"kind": "arm", "name": name, "title": name, "machine": {"urdf": file, **section}}
    said = ["Configurations of the arm to measure at, drawn at random within its joints' limits."]
    cells = [[f"P{k:03d}", *row] for k, row in enumerate(cells, start=1)]
    files = {
        file: path.read_bytes(),
        "machine.toml": write_toml(content).encode(),
        "configurations.csv": format_table(said, ["pose", *columns], cells).encode(),
        "audit.toml": _write_audit(name, instrument, [one.slides for one in chain.joints], places).encode(),
    }
    found = (
        f"{n} joints from base to tip: {names}",
        "no readings in such a file: audit.toml says what they would determine",
    )
    return Project(files, found, "bayescal audit audit.toml")


def _write_audit(name: str, instrument: str, slides: Sequence[bool], places: Mapping[str, Array]) -> str:
    n, known = len(slides), [f"{symbol}[1]" for symbol in ("x", "y", "rx", "ry", "offset")]
    known.append(f"offset[{n}]")
    tied, repeats, zeros = "", f"joint = {{ noise_deg = 0.02 }}             {REPEATS}\n", ""
    if any(slides):  # whose zero is z, and whose axis is a direction without a place
        slide = dict(enumerate(slides, start=1))
        known += [f"{one}[{k}]" for k in slide if slide[k] for one in "xy"]
        known += [f"z[{k}]" for k in slide if k == 1 or not slide[k]]
        kinds = {False: "noise_deg = 0.02", True: "noise_mm = 0.05"}
        repeats = "".join(f'"joint[{k}]" = {{ {kinds[slide[k]]} }}       {REPEATS}\n' for k in slide)
        zeros = 'z = { prior = "normal", sd = 1.0 }\n' if any(slides[1:]) else ""
        known = [one for one in known if zeros or not one.startswith("z")]
    fixed = ", ".join(f'"{one}"' for one in dict.fromkeys(known))
    filled = {"fixed": fixed, "name": name, "title": name, "repeats": repeats, "zeros": zeros}
    if instrument == TRACKER:
        section = '[instruments.tracker]\nkind = "point"\nframe_mm = [0.0, 0.0, 0.0]\nframe_deg = [0.0, 0.0, 0.0]\n'
        wide = 'tracker_frame = { prior = "normal", sd = 1000.0 }\ntracker_frame_r = { prior = "normal", sd = 30.0 }\n'
        noise, by = "tracker = { noise_mm = 0.02 }\n", "a tracker"
    else:
        section, wide, noise, by = NOWHERE, "", "", "a ball in a socket"
        for socket, there in places.items():
            where = ", ".join(f"{x:.1f}" for x in there)
            section += f'{socket} = {{ kind = "socket", place_mm = [{where}] }}\n'
            wide += f'{socket}_place = {{ prior = "normal", sd = 100.0 }}\n'
            noise += f"{socket} = {{ noise_mm = 0.05 }}\n"
        if len(places) > 1:
            both = ", ".join(f'"{socket}_place[y]"' for socket in places)
            by, tied = "a ball in two sockets", f", tied = [[{both}]]"
            apart = np.ptp(np.array([*places.values()])[:, 1])
            section += f"# they are {apart:.1f} mm apart along y, which is known: their y is off alike\n"
    filled |= {"instruments": section, "parameters": wide, "noise": noise}
    return fill_template("arm_audit", by=by, instrument=instrument, tied=tied, **filled)


def _spread(model: FunctionModel, count: int) -> Array:
    """Return configurations all over the joints' ranges, (P, n)."""
    rng = np.random.default_rng(1)
    shift = INNER * rng.uniform(-1.0, 1.0, (count, len(model.home_pose)))
    return np.asarray(model.home_pose + model.pose_scale * shift)


def _choose_places(model: FunctionModel, n_sockets: int) -> dict[str, Array]:
    """Return where sockets may stand, mm (3,) by name: in front, 0.6 as far out and 0.3 as far up as the tip often is.

    Two are apart along y.
    """
    tool = model.tool_values(model.layout.nominal, _spread(model, TRIES))[:, :3]
    reach = float(np.median(np.linalg.norm(tool, axis=1)))
    middle, aside = np.array([0.6 * reach, 0.0, 0.3 * reach]), np.array([0.0, 0.5 * APART * reach, 0.0])
    if n_sockets == 1:
        return {SOCKET: middle.round(1)}
    return {f"{SOCKET}_1": (middle - aside).round(1), f"{SOCKET}_2": (middle + aside).round(1)}


def _seat(model: FunctionModel, places: Mapping[str, Array]) -> tuple[Array, list[str]]:
    """Return configurations within the joints' limits that lead the tip to places (3,), (P, n), and to which each.

    InputError where hardly any do.
    """
    sockets = {name: SocketInstrument(SocketConfig(place_mm=where.tolist())) for name, where in places.items()}
    placed, start = place(model, sockets), _spread(model, TRIES)
    read = share_contacts(placed, TRIES)
    pose, found = touch(placed, placed.layout.nominal, start, read, np.zeros(read.shape), {})
    found &= (np.abs(pose - model.home_pose) <= model.pose_scale).all(axis=1)
    rows, seated, count = list[Array](), list[str](), N_POSES // len(places)
    for name, where in places.items():
        good = pose[found & read[:, placed.instrument_places[name][0]]]
        _, first = np.unique(good.round(SAME), axis=0, return_index=True)  # three joints reach it one way, or a few
        if len(first) < count:
            short = f"{name} at {where} mm: found {len(first)} configurations that reach it, expected {count}"
            raise InputError(f"{short}, or --option instrument={TRACKER}")
        rows.append(good[np.sort(first)[:count]])
        seated += [name] * count
    return np.concatenate(rows), seated
