"""Sessions of a small telescope's twin on disk: its legs' lengths, three sessions, one leg that moves."""

from __future__ import annotations

import shutil
from functools import cache
from pathlib import Path

import numpy as np
import studies

MOVED_UM = (0.0, 10.0, 60.0)
LEG = 2
WARM = (15.0, 20.0, 25.0)
PPM = 12.0
OFFSETS = np.array([0.37, -0.45, 1.02, 0.25, 0.43, 0.58])

STUDY = f"""
kind = "study"
name = "lengths"
title = "Lengths alone"
seed = 11
{studies.DATA.replace("data/", "data/1/")}
kappa = 0.0
matrix = "deformation_matrix.csv"

[parameters]
l = {{ prior = "normal", sd = 2.0 }}

[model_error]
terms = ["random"]
random_scale_um = 10.0
separate_by_leg = false

[[variants]]
model = "six_pus"
deformation = "none"
free = ["l"]
"""

SESSIONS = """
kind = "sessions"
name = "sessions"
title = "Sessions"
seed = 3
study = "study.toml"
variant = "six_pus/none"
provenance = { status = "simulated", text = "for the tests" }
draws = 500

[drift]
symbols = ["l"]
scale_um = 20.0
separate_by_leg = false
"""

THERMAL = """
[thermal]
reference_celsius = 20.0
struts = { ppm = 10.0, sd_ppm = 5.0 }
"""


def write_sessions(folder: Path, thermal: bool = True) -> Path:
    """Write a small study and three sessions to a folder, and return the sessions' config."""
    studies.write_texts(folder, _make_texts())
    text = SESSIONS + (THERMAL if thermal else "")
    for k, warm in enumerate(WARM, start=1):
        text += f'[[sessions]]\nlabel = "S{k}"\ntime_days = {30.0 * k}\n'
        text += f'data = [{{ file = "data/{k}/targets.csv", actuators = "data/{k}/actuators.csv" }}]\n'
        text += f"temperature_celsius = {warm}\n" if thermal else ""
    (folder / "sessions.toml").write_text(text)
    return folder / "sessions.toml"


def write_other_machine(folder: Path) -> None:
    """Put another machine's measurement instead of the second session's."""
    data = _simulate(OFFSETS[::-1] - 1.0, 9)
    studies.write_texts(folder, {f"data/2/{name}": text for name, text in data.items()})


@cache
def _make_texts() -> dict[str, str]:
    texts = studies.tiny_texts() | {"study.toml": STUDY}
    for k, (moved, warm) in enumerate(zip(MOVED_UM, WARM, strict=True), start=1):
        length = _find_lengths() + OFFSETS + 1e-3 * moved * (np.arange(6) == LEG - 1)
        offsets = length * (1.0 + 1e-6 * PPM * (warm - 20.0)) - _find_lengths()
        texts |= {f"data/{k}/{name}": text for name, text in _simulate(offsets, k).items()}
    return texts


@cache
def _find_lengths() -> np.ndarray:
    from bayescal.machines.read import load_mechanism

    return load_mechanism(studies.TELESCOPE / "mechanism.toml").leg_lengths


def _simulate(offsets: np.ndarray, seed: int) -> dict[str, str]:
    import tempfile

    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        studies.write_texts(folder, studies.tiny_texts())
        path = folder / "simulate.toml"
        text = path.read_text().split("[truth]")[0] + "[truth.offsets]\nl = "
        text += str([float(x) for x in offsets]) + "\n\n[poses]" + path.read_text().split("[poses]")[1]
        path.write_text(text)
        files = studies.simulate(path, seed=seed).files
        return {name: files[name] for name in studies.SURVEY}


def copy_sessions(source: Path, folder: Path) -> Path:
    """Copy a written folder, and return the sessions' config there."""
    shutil.copytree(source.parent, folder, dirs_exist_ok=True)
    return folder / source.name
