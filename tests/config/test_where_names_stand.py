"""Faults of classes that a config names say field and file, but never a folder, which is ``.`` at the root."""

from __future__ import annotations

from pathlib import Path

import pytest

import bayescal as bc
from bayescal.config.classes import choose, name_failures
from bayescal.config.load import look_up
from bayescal.density.calibration.terms import ErrorTerm
from bayescal.errors import InputError
from bayescal.experiments.runner.blocks import find_blocks
from bayescal.experiments.runner.load import find_kind

OWN_MACHINE = Path(__file__).parents[2] / "examples" / "own_machine"


class Fails(ErrorTerm):
    """A term whose class cannot be made."""


def fail() -> None:
    with name_failures(Fails, "errors.mine"):
        raise ValueError("broken")


@pytest.mark.parametrize(
    ("field", "ask"),
    [
        ("page_sections", lambda folder: find_blocks(["none"], None, folder)),
        ("page_sections", lambda folder: find_blocks(["none.py:Block"], None, folder)),
        ("kind", lambda folder: find_kind("none", None, folder)),
        ("errors.mine.kind", lambda folder: choose("ERRORS", "none", ErrorTerm, "errors.mine.kind", folder)),
        (
            "errors.mine.kind",
            lambda folder: choose("ERRORS", "function", ErrorTerm, "errors.mine.kind", folder, {"a": 1}),
        ),
        ("errors.mine", lambda _: fail()),
        ("truth.offsets", lambda _: look_up({"l": 1}, "k", "truth.offsets")),
    ],
)
@pytest.mark.parametrize("folder", [Path(), Path("some/where")], ids=str)
def test_faults_begin_with_their_field(field, ask, folder):
    with pytest.raises(InputError) as caught:
        ask(folder)
    assert str(caught.value).startswith(f"{field}: ") or str(caught.value).startswith(f"{field}: a: ")
    assert f"{folder}: " not in str(caught.value)


def test_a_config_in_memory_has_no_folder_in_its_faults(tmp_path, monkeypatch):
    monkeypatch.chdir(OWN_MACHINE)
    config = bc.load_experiment("audit.toml").model_copy(update={"page_sections": ["none"]})
    with pytest.raises(InputError, match=r"^page_sections: "):
        bc.run_experiment(config, tmp_path / "out", quiet=True)
