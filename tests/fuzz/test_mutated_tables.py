"""Mutated tables and machines given to commands that use a calibrated machine: one line, or what whole ones give."""

from __future__ import annotations

import os
import shutil
from pathlib import Path

import calibrated_machines as made_up
import numpy as np
import pytest
import telescope_machines as machines
from fuzz.hostile import change_file
from fuzz.judged import judge_call

from bayescal.calibrated.formats import export_machine
from bayescal.calibrated.predict import predict_poses
from bayescal.data.actuators import name_actuators
from bayescal.numerics.geometry import rotation_vector_from_matrix
from bayescal.report.pictures import Picture

SEED = 17
N_QUICK, N_SLOW, AT_A_TIME = 40, 400, 20
FOUND = (283,)  # of the slow ones, whose faults are mended: a covariance that is not symmetric
POSE = ("x_mm", "y_mm", "z_mm", "rx_deg", "ry_deg", "rz_deg")
NOISE = ("--position-um", "15", "--orientation-arcsec", "15")
WHOLE = ("recheck", "predict", "command", "certificate", "plan")


@pytest.fixture(scope="module")
def whole(tmp_path_factory) -> Path:
    """Return a folder with a machine, as `export` writes it, poses measured with it, and positions."""
    folder, rng = tmp_path_factory.mktemp("tables"), np.random.default_rng(2)
    calibrated = made_up.build_made_up(machines.build_machine("none"), rng, n_draws=60, scale=1e-3)
    export_machine(calibrated, folder / "machine", "mechanism")
    actuators = made_up.measurable_actuators(calibrated.legs, 6, rng)
    found = predict_poses(calibrated, actuators)
    poses = np.concatenate([found.position, np.degrees(rotation_vector_from_matrix(found.rotation))], axis=1)
    names = name_actuators(6)
    for name, columns, rows in (
        ("poses", POSE, poses),
        ("positions", names, actuators),
        ("measured", (*POSE, "use", *names), None),
    ):
        if rows is None:
            cells = [[*map(repr, pose), "calibration", *map(repr, rho)] for pose, rho in _pair(poses, actuators)]
        else:
            cells = [list(map(repr, row)) for row in rows.tolist()]
        lines = [",".join(["pose", *columns]), *(",".join([f"P{k}", *row]) for k, row in enumerate(cells))]
        (folder / f"{name}.csv").write_text("\n".join(lines) + "\n")
    return folder


def _pair(poses: np.ndarray, actuators: np.ndarray):
    return zip(poses.tolist(), actuators.tolist(), strict=True)


def list_call(command: str, folder: Path) -> list[object]:
    """Return a call of a command with whole files."""
    machine, out = folder / "machine", folder / "out"
    return {
        "recheck": ["recheck", machine, *NOISE, "--measured", folder / "measured.csv"],
        "plan": ["recheck", machine, *NOISE, "--shift-um", 5000, "--candidates", folder / "positions.csv"],
        "predict": ["predict", machine, folder / "positions.csv", "--out", out / "p.csv", "--draws", out / "d.csv"],
        "command": ["command", machine, folder / "poses.csv", "--out", out / "c.csv"],
        "certificate": ["certificate", machine, "--poses", 16, "--out", out / "c.html"],
    }[command]


def try_mutated(number: int, whole: Path, root: Path) -> str:
    """Return what is at fault with a command when one of its files is changed."""
    rng = np.random.default_rng([SEED, number])
    folder, command = Path(shutil.copytree(whole, root / f"{number}")), WHOLE[number % len(WHOLE)]
    (folder / "out").mkdir()
    call = list_call(command, folder)
    files = [path for path in call if isinstance(path, Path) and path.suffix == ".csv" and path.is_file()]
    files += sorted((folder / "machine").iterdir())[: 1 + (number % 2) * 9]
    path = files[rng.integers(len(files))]
    content, said = change_file(path, rng)
    path.write_bytes(content)
    outcome = judge_call(call, folder)
    shutil.rmtree(folder)
    faults = "\n  ".join(outcome.faults)
    if "DUMP" in os.environ:
        print(f"#{number} {command}: {path.name}: {said}\n    -> {outcome.code} {outcome.err.strip()[:300]}")
    return f"case {number}, {command}: {path.name}: {said}\n  {faults}" if faults else ""


@pytest.fixture(autouse=True)
def _without_pictures(monkeypatch):
    monkeypatch.setattr("bayescal.report.pictures.render_picture", lambda draw, stacked=True: Picture(b"not drawn"))


@pytest.mark.parametrize("command", WHOLE)
def test_whole_tables_are_taken(command, whole, tmp_path):
    folder = Path(shutil.copytree(whole, tmp_path / "whole"))
    outcome = judge_call(list_call(command, folder), folder)
    assert (outcome.code, outcome.faults) == (0, ())


@pytest.mark.parametrize("first", range(0, N_QUICK, AT_A_TIME))
def test_no_mutation_of_a_table_ends_in_a_traceback(first, whole, tmp_path):
    found = [try_mutated(number, whole, tmp_path) for number in range(first, first + AT_A_TIME)]
    assert "\n".join(filter(None, found)) == ""


@pytest.mark.parametrize("number", FOUND)
def test_what_many_mutations_have_found_is_mended(number, whole, tmp_path):
    assert try_mutated(number, whole, tmp_path) == ""


@pytest.mark.slow
@pytest.mark.parametrize("first", range(N_QUICK, N_QUICK + N_SLOW, AT_A_TIME))
def test_no_mutation_of_many_tables_ends_in_a_traceback(first, whole, tmp_path):
    found = [try_mutated(number, whole, tmp_path) for number in range(first, first + AT_A_TIME)]
    assert "\n".join(filter(None, found)) == ""
