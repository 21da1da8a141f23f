"""Mutated configs and data files: one line and exit code 2, or a run that ends as runs end; never a traceback."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from fuzz.hostile import change_file
from fuzz.judged import judge_call
from fuzz.subjects import CHEAP, QUICK, Subject, read_subject, write_subjects

from bayescal.errors import NumericalError
from bayescal.experiments.frame import run as frame
from bayescal.report.pictures import Picture

SEED = 14
N_QUICK, N_SLOW, AT_A_TIME = 500, 5000, 50


@pytest.fixture(scope="module")
def root(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("fuzz")
    write_subjects(folder)
    return folder / "experiments"


@pytest.fixture(scope="module")
def subjects(root) -> dict[str, Subject]:
    return {name: read_subject(root / name) for name in QUICK}


@pytest.fixture
def cut(monkeypatch):
    """Let every run end where it would begin to compute."""

    def refuse(*_: object, **__: object) -> None:
        raise NumericalError("cut: what was read would be computed now")

    monkeypatch.setattr(frame, "Run", refuse)


def mutate(subject: Subject, number: int, out: Path) -> str:
    """Run a subject with one of its files changed, which is put right again; return what is at fault with that."""
    rng = np.random.default_rng([SEED, number])
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
    if "DUMP" in __import__("os").environ:
        print(
            f"#{number} {subject.config.name}: {path.name}: {said}\n    -> {outcome.code} {outcome.err.strip()[:300]}"
        )
    faults = "\n  ".join(outcome.faults)
    return f"case {number}, {subject.config}: {path.name}: {said}\n  {faults}" if faults else ""


def fuzz(subjects: dict[str, Subject], first: int, folder: Path) -> str:
    """Return what is at fault with some cases, the subjects in turn."""
    names, found = sorted(subjects), []
    for number in range(first, first + AT_A_TIME):
        out = folder / f"out{number}"
        out.mkdir()
        found.append(mutate(subjects[names[number % len(names)]], number, out))
    return "\n".join(filter(None, found))


@pytest.mark.parametrize("first", range(0, N_QUICK, AT_A_TIME))
@pytest.mark.usefixtures("cut")
def test_no_mutation_ends_in_a_traceback(subjects, first, tmp_path):
    assert fuzz(subjects, first, tmp_path) == ""


@pytest.mark.slow
@pytest.mark.parametrize("first", range(N_SLOW + N_QUICK, N_SLOW + N_QUICK + 200, AT_A_TIME))
def test_no_mutation_ends_in_a_traceback_when_computed(subjects, first, tmp_path, monkeypatch):
    monkeypatch.setattr("bayescal.report.page.render_picture", lambda draw, stacked=True: Picture(b"not drawn"))
    chosen = {name: one for name, one in subjects.items() if name in CHEAP}
    assert fuzz(chosen, first, tmp_path) == ""


@pytest.mark.slow
@pytest.mark.parametrize("first", range(N_QUICK, N_QUICK + N_SLOW, AT_A_TIME))
@pytest.mark.usefixtures("cut")
def test_no_mutation_of_many_ends_in_a_traceback(subjects, first, tmp_path):
    assert fuzz(subjects, first, tmp_path) == ""
