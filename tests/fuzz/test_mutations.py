"""Mutated files given to the commands that read them: one line, or what whole files give; never a traceback.

Inputs are configs and their data, of which all is read and nothing computed; results are damaged directories; tables
are those, and the machine, of commands that use a calibrated machine.
"""

from __future__ import annotations

import shutil
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path

import calibrated_machines as made_up
import numpy as np
import pytest
import telescope_machines as machines
from fuzz.hostile import change_file
from fuzz.judged import Outcome, judge_call
from fuzz.subjects import QUICK, Subject, read_subject

from bayescal.calibrated.formats import export_machine
from bayescal.calibrated.predict import predict_poses
from bayescal.data.actuators import name_actuators
from bayescal.errors import NumericalError
from bayescal.experiments.frame import run as frame
from bayescal.experiments.frame.load import load_experiment
from bayescal.numerics.geometry import rotation_vector_from_matrix

pytestmark = pytest.mark.usefixtures("no_pictures")

SORTS = {"inputs": (500, 5000, 50), "results": (24, 1064, 24), "tables": (40, 400, 20)}
"""Of each sort: quick cases, slow ones after them, and how many make a test."""
COMPUTED = 200  # inputs after all others, of which what is cheap is computed
QUICK_CASES = [(sort, first) for sort, (n, _, step) in SORTS.items() for first in range(0, n, step)]
SLOW_CASES = [(sort, first) for sort, (n, more, step) in SORTS.items() for first in range(n, n + more, step)]

type Attempt = Callable[[int, Path], str]
"""Returns what is at fault with a case, by its number, in a folder of its own; nothing where all is well."""


def say_faults(number: int, case: str, outcome: Outcome, but: str | None = None) -> str:
    faults = "\n  ".join(fault for fault in outcome.faults if but is None or but not in fault)
    return f"case {number}, {case}\n  {faults}" if faults else ""


def try_all(attempt: Attempt, numbers: range, folder: Path) -> str:
    return "\n".join(filter(None, (attempt(number, folder) for number in numbers)))


@pytest.mark.parametrize(("sort", "first"), QUICK_CASES)
def test_no_mutation_ends_in_a_traceback(sort, first, request, tmp_path):
    attempt = request.getfixturevalue(f"try_{sort}")
    assert try_all(attempt, range(first, first + SORTS[sort][2]), tmp_path) == ""


@pytest.mark.slow
@pytest.mark.parametrize(("sort", "first"), SLOW_CASES)
def test_no_mutation_of_many_ends_in_a_traceback(sort, first, request, tmp_path):
    attempt = request.getfixturevalue("try_results_of_all_kinds" if sort == "results" else f"try_{sort}")
    assert try_all(attempt, range(first, first + SORTS[sort][2]), tmp_path) == ""


# --- inputs ----------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def subjects(root) -> dict[str, Subject]:
    return {name: read_subject(root / name) for name in QUICK}


@pytest.fixture
def try_inputs(subjects, monkeypatch) -> Attempt:
    """Let every run end where it would begin to compute."""

    def refuse(*_: object, **__: object) -> None:
        raise NumericalError("cut: what was read would be computed now")

    monkeypatch.setattr(frame, "Run", refuse)
    return partial(mutate_input, subjects)


def mutate_input(subjects: dict[str, Subject], number: int, folder: Path) -> str:
    """Run a subject, each in turn, with one of its files changed, which is put right again."""
    subject, out = subjects[sorted(subjects)[number % len(subjects)]], folder / f"out{number}"
    out.mkdir()
    rng = np.random.default_rng([14, number])
    weights = np.array([3.0, *[1.0] * (len(subject.files) - 1)])
    path = subject.files[rng.choice(len(subject.files), p=weights / weights.sum())]
    original = path.read_bytes()
    content, said = change_file(path, rng)
    command = "simulate" if subject.kind.endswith("simulation") else "run"
    more = [] if command == "simulate" else ["--quiet", "--workers", "1"]
    try:
        path.write_bytes(content)
        outcome = judge_call([command, subject.config, "--out", out / "results", *more], out, subject.config.parent)
    finally:
        path.write_bytes(original)
    return say_faults(number, f"{subject.config}: {path.name}: {said}", outcome)


@pytest.mark.slow
@pytest.mark.parametrize("k", range(0, COMPUTED, SORTS["inputs"][2]))
def test_no_mutation_ends_in_a_traceback_when_computed(subjects, k, tmp_path):
    first = sum(SORTS["inputs"][:2]) + k
    chosen = {name: one for name, one in subjects.items() if QUICK[name]}
    assert try_all(partial(mutate_input, chosen), range(first, first + SORTS["inputs"][2]), tmp_path) == ""


# --- results ---------------------------------------------------------------------------------------------------------

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


@pytest.fixture
def try_results() -> Attempt:
    return partial(try_damaged, WHOLE)


@pytest.fixture(scope="module")
def made(root) -> list[Path]:
    """Run an experiment of every other kind; return where the results of all kinds are."""
    found = list(WHOLE)
    for name in MADE:
        found.append(root.with_name("results") / name.replace("/", "-").removesuffix(".toml"))
        config = root / name
        frame.run_experiment(load_experiment(config), config.parent, found[-1])
    return found


@pytest.fixture
def try_results_of_all_kinds(made) -> Attempt:
    return partial(try_damaged, made)


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


def try_damaged(whole: Sequence[Path], number: int, folder: Path) -> str:
    """Call a command on damaged results."""
    rng = np.random.default_rng([15, number])
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
    return say_faults(number, f"{command} {source.name}: {said}", outcome, but=NOTE)


# --- tables of a calibrated machine ----------------------------------------------------------------------------------

POSE = ("x_mm", "y_mm", "z_mm", "rx_deg", "ry_deg", "rz_deg")
NOISE = ("--position-um", "15", "--orientation-arcsec", "15")
USES = ("recheck", "predict", "command", "certificate", "plan")
FOUND = (283,)  # of the slow ones, whose faults are mended: a covariance that is not symmetric


@pytest.fixture(scope="module")
def tables(tmp_path_factory) -> Path:
    """Return a folder with a machine, as `export` writes it, poses measured with it, and positions."""
    folder, rng = tmp_path_factory.mktemp("tables"), np.random.default_rng(2)
    calibrated = made_up.build_made_up(machines.build_machine("none"), rng, n_draws=60, scale=1e-3)
    export_machine(calibrated, folder / "machine", "mechanism")
    actuators = made_up.measurable_actuators(calibrated.legs, 6, rng)
    found = predict_poses(calibrated, actuators)
    poses = np.concatenate([found.position, np.degrees(rotation_vector_from_matrix(found.rotation))], axis=1)
    positions, poses = ([list(map(repr, row)) for row in one.tolist()] for one in (actuators, poses))
    measured = [[*pose, "calibration", *rho] for pose, rho in zip(poses, positions, strict=True)]
    names = name_actuators(6)
    for name, columns, rows in (
        ("poses", POSE, poses),
        ("positions", names, positions),
        ("measured", (*POSE, "use", *names), measured),
    ):
        lines = [",".join(["pose", *columns]), *(",".join([f"P{k}", *row]) for k, row in enumerate(rows))]
        (folder / f"{name}.csv").write_text("\n".join(lines) + "\n")
    return folder


@pytest.fixture
def try_tables(tables) -> Attempt:
    return partial(try_mutated, tables)


def list_call(use: str, folder: Path) -> list[object]:
    """Return a call with whole files."""
    machine, out = folder / "machine", folder / "out"
    return {
        "recheck": ["recheck", machine, *NOISE, "--measured", folder / "measured.csv"],
        "plan": ["recheck", machine, *NOISE, "--shift-um", 5000, "--candidates", folder / "positions.csv"],
        "predict": ["predict", machine, folder / "positions.csv", "--out", out / "p.csv", "--draws", out / "d.csv"],
        "command": ["command", machine, folder / "poses.csv", "--out", out / "c.csv"],
        "certificate": ["certificate", machine, "--poses", 16, "--out", out / "c.html"],
    }[use]


def try_mutated(tables: Path, number: int, root: Path) -> str:
    """Call a command with one of its files changed."""
    rng = np.random.default_rng([17, number])
    folder, use = Path(shutil.copytree(tables, root / f"{number}")), USES[number % len(USES)]
    (folder / "out").mkdir()
    call = list_call(use, folder)
    files = [path for path in call if isinstance(path, Path) and path.suffix == ".csv" and path.is_file()]
    files += sorted((folder / "machine").iterdir())[: 1 + (number % 2) * 9]
    path = files[rng.integers(len(files))]
    content, said = change_file(path, rng)
    path.write_bytes(content)
    outcome = judge_call(call, folder)
    shutil.rmtree(folder)
    return say_faults(number, f"{use}: {path.name}: {said}", outcome)


@pytest.mark.parametrize("use", USES)
def test_whole_tables_are_taken(use, tables, tmp_path):
    folder = Path(shutil.copytree(tables, tmp_path / "whole"))
    outcome = judge_call(list_call(use, folder), folder)
    assert (outcome.code, outcome.faults) == (0, ())


@pytest.mark.parametrize("number", FOUND)
def test_what_many_mutations_have_found_is_mended(number, try_tables, tmp_path):
    assert try_tables(number, tmp_path) == ""
