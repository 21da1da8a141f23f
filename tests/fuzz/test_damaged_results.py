"""Damaged results given to the commands that read them: a line that names the file, or what whole results give."""

from __future__ import annotations

import shutil
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from fuzz.hostile import change_file
from fuzz.judged import judge_call
from fuzz.subjects import write_subjects

from bayescal.experiments.frame.load import load_experiment
from bayescal.experiments.frame.run import run_experiment
from bayescal.report.pictures import Picture

SEED = 15
RESULTS = Path(__file__).parents[2] / "results"
WHOLE = tuple(RESULTS / name for name in ("hangprinter", "hexapod_figure10", "pose_extraction", "telescope"))
"""Committed results with all that reports and comparisons need."""
MADE = (
    "audit/m2_hexapod.toml",
    "audit/m2_hexapod_tracker.toml",
    "yu2023/table4.toml",
    "yu2023/table8.toml",
    "own_machine/audit.toml",
    "pose_selection/yu2023_table1.toml",
    "sika2008/calibrations.toml",
    "sliding_star/sensors.toml",
    "sliding_star/short.toml",
    "telescope/short.toml",
)
"""Experiments of the other kinds, run for the slow tests."""
COMMANDS = ("report", "compare", "export", "predict", "report", "compare", "certificate", "recheck")
NOTE = "no draws of the posterior"  # what the committed results do not hold is said beside success
N_QUICK, N_SLOW, AT_A_TIME = 48, 1040, 24


@pytest.fixture(autouse=True)
def _without_pictures(monkeypatch):
    monkeypatch.setattr("bayescal.report.page.render_picture", lambda draw, stacked=True: Picture(b"not drawn"))


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


def try_damaged(number: int, whole: Sequence[Path], folder: Path) -> str:
    """Return what is at fault with a command on damaged results."""
    rng = np.random.default_rng([SEED, number])
    source, command = whole[number % len(whole)], COMMANDS[number // len(whole) % len(COMMANDS)]
    found = Path(shutil.copytree(source, folder / f"{number}"))
    said = damage(found, rng)
    more: list[object] = {
        "report": ["--trust-code"],
        "compare": [source, "--trust-code"],
        "export": ["--out", folder / "machines", "--force"],
        "certificate": ["--out", folder / "certificate.html", "--poses", 16],
        "recheck": ["--measured", source / "none.csv"],
        "predict": [source / "none.csv", "--out", folder / "predicted.csv"],
    }.get(command, [])
    outcome = judge_call([command, found, *more], folder)
    shutil.rmtree(found)
    shutil.rmtree(folder / "machines", ignore_errors=True)
    faults = "\n  ".join(fault for fault in outcome.faults if NOTE not in fault)
    return f"case {number}, {command} {source.name}: {said}\n  {faults}" if faults else ""


@pytest.mark.parametrize("first", range(0, N_QUICK, AT_A_TIME))
def test_damaged_results_end_in_no_traceback(first, tmp_path):
    found = [try_damaged(number, WHOLE, tmp_path) for number in range(first, first + AT_A_TIME)]
    assert "\n".join(filter(None, found)) == ""


@pytest.fixture(scope="module")
def made(tmp_path_factory) -> list[Path]:
    """Run an experiment of every other kind; return where the results of all kinds are."""
    folder = tmp_path_factory.mktemp("made")
    write_subjects(folder)
    found = list(WHOLE)
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr("bayescal.report.page.render_picture", lambda draw, stacked=True: Picture(b"not drawn"))
        for name in MADE:
            found.append(folder / "results" / name.replace("/", "-").removesuffix(".toml"))
            config = folder / "experiments" / name
            run_experiment(load_experiment(config), config.parent, found[-1])
    return found


@pytest.mark.slow
@pytest.mark.parametrize("first", range(N_QUICK, N_QUICK + N_SLOW, AT_A_TIME))
def test_many_damaged_results_end_in_no_traceback(first, made, tmp_path):
    found = [try_damaged(number, made, tmp_path) for number in range(first, first + AT_A_TIME)]
    assert "\n".join(filter(None, found)) == ""
