"""Damaged results given to the commands that read them: a line that names the file, or what whole results give."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest
from fuzz.hostile import change_file
from fuzz.judged import judge_call

SEED = 15
RESULTS = Path(__file__).parents[2] / "results"
KINDS = (
    "audit_m2_hexapod",
    "hangprinter",
    "hexapod_figure10",
    "hexapod_table4",
    "hexapod_table8",
    "m2_hexapod",
    "m2_hexapod_sensors",
    "pose_extraction",
    "pose_selection_figure14",
    "pose_selection_table1",
    "sliding_star",
    "sliding_star_calibrations",
    "telescope",
)
COMMANDS = ("report", "compare", "export", "predict", "report", "compare")
NOTE = "no draws of the posterior"  # what the committed results do not hold is said beside success
N_QUICK, N_SLOW, AT_A_TIME = 104, 1040, 26


@pytest.fixture(autouse=True)
def _without_pictures(monkeypatch):
    monkeypatch.setattr("bayescal.report.page.render_png", lambda draw: b"not drawn")


def damage(folder: Path, rng: np.random.Generator) -> str:
    """Change, empty or remove one of the files of a results directory, perhaps its tables above all."""
    files = [path for path in sorted(folder.rglob("*")) if path.suffix in (".csv", ".json", ".toml")]
    path = files[rng.integers(len(files))]
    way = rng.random()
    if way < 0.08:
        path.unlink()
        return f"{path.name} removed"
    if way < 0.16:
        path.write_bytes(b"" if way < 0.12 else path.read_bytes()[: path.stat().st_size // 2])
        return f"{path.name} emptied or cut"
    content, said = change_file(path, rng)
    path.write_bytes(content)
    return f"{path.name}: {said}"


def try_damaged(number: int, folder: Path) -> str:
    """Return what is at fault with a command on damaged results."""
    rng = np.random.default_rng([SEED, number])
    name, command = KINDS[number % len(KINDS)], COMMANDS[number // len(KINDS) % len(COMMANDS)]
    found = Path(shutil.copytree(RESULTS / name, folder / f"{number}"))
    said = damage(found, rng)
    more: list[object] = {
        "compare": [RESULTS / name],
        "export": ["--out", folder / "machines", "--force"],
        "predict": [RESULTS / name / "none.csv", "--out", folder / "predicted.csv"],
    }.get(command, [])
    outcome = judge_call([command, found, *more], folder)
    shutil.rmtree(found)
    shutil.rmtree(folder / "machines", ignore_errors=True)
    faults = "\n  ".join(fault for fault in outcome.faults if NOTE not in fault)
    return f"case {number}, {command} {name}: {said}\n  {faults}" if faults else ""


@pytest.mark.parametrize("first", range(0, N_QUICK, AT_A_TIME))
def test_damaged_results_end_in_no_traceback(first, tmp_path):
    found = [try_damaged(number, tmp_path) for number in range(first, first + AT_A_TIME)]
    assert "\n".join(filter(None, found)) == ""


@pytest.mark.slow
@pytest.mark.parametrize("first", range(N_QUICK, N_QUICK + N_SLOW, AT_A_TIME))
def test_many_damaged_results_end_in_no_traceback(first, tmp_path):
    found = [try_damaged(number, tmp_path) for number in range(first, first + AT_A_TIME)]
    assert "\n".join(filter(None, found)) == ""
