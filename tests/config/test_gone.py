"""Old kinds and keys are refused in one line that names what replaces them, and nothing is written."""

from pathlib import Path

import pytest

from bayescal.experiments import GONE, KINDS

STUDY = 'name = "old"\ntitle = "Old"\nseed = 1\n'
SELECTION = [("selection", "mechanism", "machine"), ("selection", "measured_by", "[variant] with sensors")]
KEYS = [("table", "calibration", "study"), ("simulation", "mechanism", "machine"), *SELECTION]


def run_text(text: str, folder: Path, call) -> str:
    """Return the one line that a config of this text is refused with."""
    path = folder / "old.toml"
    path.write_text(text)
    code, out, err = call("run", path, "--out", folder / "out")
    assert (code, out) == (2, "")
    assert [one.name for one in folder.iterdir()] == ["old.toml"]
    return err.splitlines()[0]


@pytest.mark.parametrize(("kind", "successor"), GONE.items())
def test_a_kind_that_is_gone_names_its_successor(kind, successor, tmp_path, call):
    words = repr(successor) if successor in KINDS else successor
    assert successor in KINDS or "bayescal " in successor
    line = run_text(f'kind = "{kind}"\n{STUDY}', tmp_path, call)
    assert line.endswith(f"old.toml: kind: found '{kind}', which is gone, expected {words}")


@pytest.mark.parametrize(("kind", "key", "successor"), KEYS)
def test_a_key_that_is_gone_names_its_successor(kind, key, successor, tmp_path, call):
    line = run_text(f'kind = "{kind}"\n{STUDY}{key} = "x"\n', tmp_path, call)
    assert line.endswith(f"old.toml, line 5: {key}: key is gone, expected {successor}")
