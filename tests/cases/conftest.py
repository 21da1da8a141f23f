"""Small inputs with known right answers: a folder each, copied before it is used."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

HERE = Path(__file__).parent


@pytest.fixture
def case(tmp_path) -> Callable[[str], Path]:
    """Copy a case's folder; return where it stands."""

    def copy(name: str) -> Path:
        return Path(shutil.copytree(HERE / name, tmp_path / name))

    return copy
