"""Bad input to a study is one line and exit code 2, in `validate` as in `run`, and nothing is written."""

from __future__ import annotations

import re
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from calibrations import write_delta
from scipy.spatial.transform import Rotation
from studies import changed_table, edit

from bayescal.projects.start import start_project

HERE = Path(__file__).parent
VARIANTS, ONE_SD = "[[variants]]", re.compile(r"sd = [\d.]+")


def write_cell(folder: Path) -> Path:
    return shutil.copytree(HERE / "own_term_shrinks_gains", folder / "cell") / "study.toml"


def write_hexapod(folder: Path) -> Path:
    start_project(folder / "hexapod", "hexapod", "poses")
    return folder / "hexapod" / "study.toml"


def put(text: str) -> Callable[[Path], None]:
    """Return what puts a section before the variants."""
    return lambda study: edit(study, VARIANTS, f"{text}\n\n{VARIANTS}")


def head(text: str) -> Callable[[Path], None]:
    return lambda study: edit(study, "\nseed = 1", f"\nseed = 1\n{text}\n")


def gain(study: Path) -> None:
    edit(study, "[parameters]", '[parameters]\ngain = { prior = "normal", sd = 0.01 }')


def tolerate(text: str) -> Callable[[Path], None]:
    """Return what states a tolerance of the first parameter otherwise."""
    return lambda study: study.write_text(ONE_SD.sub(text, study.read_text(), count=1))


def tolerate_nothing(study: Path) -> None:
    study.write_text(ONE_SD.sub("sd = 0.0", study.read_text()))


def shorten_quaternions(study: Path) -> None:
    def write(rows):
        place = rows[0].index("rx_deg")
        found = [[*rows[0][:place], "qw", "qx", "qy", "qz", *rows[0][place + 3 :]]]
        for row in rows[1:]:
            x, y, z, w = (
                0.5 * Rotation.from_rotvec(np.radians([float(one) for one in row[place : place + 3]])).as_quat()
            )
            found.append([*row[:place], *map(str, (w, x, y, z)), *row[place + 3 :]])
        return found

    path = study.parent / "data" / "poses.csv"
    with changed_table(path, write):
        text = path.read_text()
    path.write_text(text)


def copy_column(study: Path) -> None:
    path = study.parent / "data" / "poses.csv"

    def write(rows):
        first, second = rows[0].index("x_mm"), rows[0].index("y_mm")
        return [rows[0], *([*row[:second], row[first], *row[second + 1 :]] for row in rows[1:])]

    with changed_table(path, write):
        text = path.read_text()
    path.write_text(text)


def frame(study: Path) -> None:
    """Say that the frame of the instrument has to be found."""
    text = study.read_text()
    assert "\n[sensors]\n" in text
    study.write_text(text.replace("[sensors]", "frames.base = { position = 2.0, rotation = 0.1 }\n\n[sensors]", 1))


FAULTS: dict[str, tuple[Callable[[Path], Path], Callable[[Path], None], str]] = {
    "frame: a tool without a place": (
        write_cell,
        head('accuracy_frame = "base"'),
        "accuracy_frame: found 'base' with tool",
    ),
    "frame: no marks": (
        write_hexapod,
        lambda study: [
            head('accuracy_frame = "base"')(study),
            frame(study),
        ],
        "accuracy_frame: found 'base', but base_",
    ),
    "frame: unknown": (write_cell, head('accuracy_frame = "marks"'), "accuracy_frame: found 'marks', expected"),
    "requirement: a cell's place": (write_cell, put("[requirements]\nposition = 1.0"), "found 'position', expected"),
    "requirement: a point's rotation": (
        write_delta,
        put("[requirements]\nrotation = 1.0"),
        "found 'rotation', expected",
    ),
    "requirement: a platform's force": (
        write_hexapod,
        put("[requirements]\nfx = 1.0"),
        "found 'fx', expected one of x",
    ),
    "requirement: nothing": (write_hexapod, put("[requirements]\nposition = 0.0"), "requirements.position: found 0.0"),
    "gain: a cell": (write_cell, gain, "parameters: found 'gain', expected one of k_x"),
    "gain: a function": (write_delta, gain, "parameters: found 'gain', expected one of x"),
    "gain: of seven": (
        write_hexapod,
        lambda study: edit(study, "[parameters]", f"[parameters]\ngain = {{ prior = 'normal', sd = {[0.01] * 7} }}"),
        "parameters.gain: found 7 values, expected 1 or 6",
    ),
    "quaternion": (write_hexapod, shorten_quaternions, "line 4: found a quaternion of length 0.5, expected 1"),
    "columns": (write_hexapod, copy_column, "columns y_mm and x_mm"),
    "tolerance: normal": (write_hexapod, tolerate("sd = 0.0"), "parameters.a_x.sd: found 0.0, expected"),
    "tolerance: below zero": (write_cell, tolerate("sd = -0.3"), "parameters.k_x.sd: found -0.3, expected"),
    "tolerance: each": (write_cell, tolerate("sd = [0.0, 0.0, 0.0]"), "parameters.k_x"),
    "tolerance: all": (write_cell, tolerate_nothing, "parameters.k_x.sd: found 0.0, expected"),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_it_is_one_line(fault, call, refuse, tmp_path):
    write, change, said = FAULTS[fault]
    study = write(tmp_path)
    change(study)
    complaint = refuse(re.escape(said), study.parent / "out", "run", study)
    code, _, everything = call("validate", study)  # which names every fault, a line each
    assert (code, everything.splitlines()[0]) == (2, complaint.strip())
