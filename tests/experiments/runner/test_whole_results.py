"""Results are whole or refused: what was edited, lost or added is named, and what is used all the same, too."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
import time
from pathlib import Path

import numpy as np
import pytest
from experiments.runner import toys
from studies import edit

import bayescal as bc
from bayescal.experiments.runner import run as frame
from bayescal.files.manifest import MANIFEST, check_whole, write_manifest

pytestmark = pytest.mark.usefixtures("voice")


@pytest.fixture(scope="module")
def made(tmp_path_factory) -> Path:
    """Return results of a kind in a file."""
    folder = tmp_path_factory.mktemp("toy")
    bc.run_experiment(toys.write_toy(folder), folder / "out", quiet=True)
    return folder / "out"


@pytest.fixture
def results(made, tmp_path) -> Path:
    """Return a copy of them."""
    return Path(shutil.copytree(made, tmp_path / "out"))


DAMAGES = {
    "summary.json edited": lambda folder: edit(folder / "summary.json", "total", "Total"),
    "provenance.json edited": lambda folder: edit(folder / "provenance.json", "seed", "Seed"),
    "squares.csv edited": lambda folder: edit(folder / "squares.csv", "1", "-1"),
    "squares.csv missing": lambda folder: (folder / "squares.csv").unlink(),
    "inputs/toy_kind.py edited": lambda folder: edit(folder / "inputs" / "toy_kind.py", "class", "class "),
    "posterior/all.nc added": lambda folder: add(folder / "posterior" / "all.nc"),
    "calibrated.toml added": lambda folder: add(folder / "notes" / ".." / "calibrated.toml"),
    f"no {MANIFEST}": lambda folder: (folder / MANIFEST).unlink(),
}


def add(path: Path) -> None:
    path.parent.mkdir(exist_ok=True)
    path.write_text("")


@pytest.mark.parametrize("named", DAMAGES)
@pytest.mark.parametrize("command", ["report", "compare"])
def test_what_is_not_as_it_was_written_is_named(command, named, results, call, made):
    DAMAGES[named](results)
    arguments = [command, results] if command == "report" else [command, made, results]
    page = (results / "report.html").read_bytes()
    code, out, err = call(*arguments)
    assert (code, out) == (2, "")
    assert f"bayescal: {results}: found {named}, expected unchanged files, or --allow-changed-files" in err
    assert (results / "report.html").read_bytes() == page
    with pytest.raises(bc.InputError, match=named):
        bc.load_results(results)


@pytest.mark.skipif(shutil.which("ssh-keygen") is None, reason="signs with OpenSSH")
def test_a_signature_of_the_manifest_covers_all_files(results, tmp_path):
    """It may stand beside it; a manifest that was sealed again is another one."""
    key, signers = tmp_path / "key", tmp_path / "signers"

    def call_openssh(*arguments, **more):
        return subprocess.run(["ssh-keygen", *map(str, arguments)], capture_output=True, check=False, **more).returncode

    assert call_openssh("-q", "-t", "ed25519", "-N", "", "-f", key) == 0
    signers.write_text(f"you@example.org {key.with_suffix('.pub').read_text()}")
    assert call_openssh("-Y", "sign", "-n", "bayescal", "-f", key, results / MANIFEST) == 0
    signature = results / f"{MANIFEST}.sig"
    check_whole(results, expected=True)
    bc.load_results(results)
    verify = ("-Y", "verify", "-n", "bayescal", "-f", signers, "-I", "you@example.org", "-s", signature)
    assert call_openssh(*verify, input=(results / MANIFEST).read_bytes()) == 0
    edit(results / "squares.csv", "1", "-1")
    write_manifest(results)
    check_whole(results, expected=True)
    assert call_openssh(*verify, input=(results / MANIFEST).read_bytes()) != 0


def test_nothing_else_may_stand_beside_a_manifest(results):
    for name in (f"{MANIFEST}.sig", f"{MANIFEST}.asc"):
        add(results / name)
    check_whole(results, expected=True)
    add(results / "notes" / f"{MANIFEST}.sig")
    with pytest.raises(bc.InputError, match=f"notes/{MANIFEST}.sig added"):
        check_whole(results, expected=True)


def test_changed_files_are_listed_where_they_are_allowed(results, call):
    add(results / "mine.txt")
    edit(results / "notes" / "plain.txt", "a", "b")
    code, _, err = call("report", results, "--allow-changed-files")
    assert code == 0
    assert re.search(rf"{results}: .*notes/plain\.txt edited, mine\.txt added: used", err)
    assert call("report", results)[0] == 2  # a page that was regenerated makes nothing else good
    with pytest.warns(UserWarning, match="mine.txt added: used"):
        bc.load_results(results, allow_changed_files=True)


def test_a_page_is_regenerated_whatever_became_of_it(results, call):
    before = (results / "report.html").read_bytes(), (results / MANIFEST).read_bytes()
    (results / "report.html").write_text("another")
    assert call("compare", results, results)[0] == 2
    assert call("report", results)[0] == 0
    assert ((results / "report.html").read_bytes(), (results / MANIFEST).read_bytes()) == before
    assert call("compare", results, results)[0] == 0


def test_results_of_earlier_versions_are_taken_and_said_to_be_so(results, call):
    (results / MANIFEST).unlink()
    provenance = json.loads((results / "provenance.json").read_text())
    del provenance["manifest"]
    (results / "provenance.json").write_text(json.dumps(provenance))
    code, _, err = call("compare", results, results)
    assert code == 0
    assert f"{results}: found no {MANIFEST}" in err
    assert call("update-manifest", results)[1] == f"wrote {results / MANIFEST}\n"
    assert "found no" not in call("compare", results, results)[2]
    edit(results / "squares.csv", "1", "2")
    assert call("compare", results, results)[0] == 2


def test_only_results_are_sealed(tmp_path, results, call):
    assert call("update-manifest", results, tmp_path)[0] == 2
    assert not (tmp_path / MANIFEST).exists()


def test_looking_costs_little(tmp_path):
    """Reading 40 MB again costs tens of milliseconds once, and nothing the next time."""
    for k in range(10):
        (tmp_path / f"{k}.nc").write_bytes(np.random.default_rng(k).bytes(4_000_000))
    write_manifest(tmp_path)
    began = time.process_time()
    check_whole(tmp_path, expected=True)
    assert time.process_time() - began < 0.02


def test_inputs_are_kept_as_they_were_read(tmp_path, monkeypatch):
    """A file that somebody changes while a run computes is none of the run's."""
    path, compute = toys.write_toy(tmp_path), frame._compute
    before = (tmp_path / "numbers.txt").read_bytes()

    def change(*arguments):
        (tmp_path / "numbers.txt").write_text("7\n")
        return compute(*arguments)

    monkeypatch.setattr(frame, "_compute", change)
    bc.run_experiment(path, tmp_path / "out", quiet=True)
    assert (tmp_path / "numbers.txt").read_bytes() != before
    assert (tmp_path / "out" / "inputs" / "numbers.txt").read_bytes() == before
