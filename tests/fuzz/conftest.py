"""Experiments of all kinds in a folder, for tests that change their files."""

from pathlib import Path

import pytest
from fuzz.subjects import write_subjects
from fuzz.suite import Ground


@pytest.fixture(scope="module")
def root(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("subjects")
    write_subjects(folder)
    return folder / "experiments"


@pytest.fixture(scope="module")
def ground(tmp_path_factory) -> Ground:
    made = Ground(tmp_path_factory.mktemp("ground"))
    assert made.root.is_dir()  # some of it is simulated, before a test changes how
    return made
