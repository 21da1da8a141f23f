"""What CONTRIBUTING.md shows is done, from an empty folder outside the package."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import pandas as pd
import pytest

PAGE = Path(__file__).parents[1] / "CONTRIBUTING.md"
BLOCK = re.compile(r"^```(\w+)(?: (\S+))?\n(.*?)^```$", flags=re.MULTILINE | re.DOTALL)
SECTIONS = {"machine", "instrument", "error term", "page block", "kind"}

pytestmark = pytest.mark.runs


def read_sections() -> dict[str, list[tuple[str, str, str]]]:
    """Return language, file name and text of each section's blocks."""
    found = {}
    for section in re.split(r"^### ", PAGE.read_text(encoding="utf-8"), flags=re.MULTILINE)[1:]:
        name = re.match(r"(?:A|An) ([a-z ]+):", section)
        assert name is not None
        found[name[1]] = BLOCK.findall(section)
    return found


def test_everything_shown_is_done(call, tmp_path, monkeypatch, no_pictures):
    monkeypatch.chdir(tmp_path)
    sections = read_sections()
    assert set(sections) == SECTIONS
    for name, blocks in sections.items():
        classes = [file for language, file, _ in blocks if language == "python"]
        assert len(classes) == 1, name
        for language, file, text in blocks:
            if language != "sh":
                (tmp_path / file).write_text(text, encoding="utf-8")
                continue
            for line in text.splitlines():
                command, *arguments = shlex.split(line)
                assert command == "bayescal"
                more = ["--workers", "2", "--quiet"] if arguments[0] == "run" else []
                code, _, complaint = call(*arguments, *more)
                assert code == 0 or "not everything converged" in complaint, (name, complaint)
    found = tmp_path / "results"
    parameters = pd.read_csv(next((found / "arm_by_laser").rglob("parameters.csv")))
    assert "laser_zero" not in set(parameters["parameter"])  # known where it has no tolerance
    assert "vibration" in (found / "arm_that_shakes" / "report.html").read_text()
    report = (found / "arm_with_lengths" / "report.html").read_text()
    assert "Lengths of the links" in report
    assert "Lengths of the links" not in (found / "arm" / "report.html").read_text()
    assert (found / "arm_with_lengths" / "code" / "lengths.py").is_file()
    assert "The largest standard deviation of an approach" in (found / "repeatability" / "report.html").read_text()
