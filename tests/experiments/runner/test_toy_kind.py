"""A kind from a folder outside the package through run, resume, report, workers, progress and compare."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
import toys
from studies import edit

from bayescal.experiments.runner import losses
from bayescal.experiments.runner import run as frame

pytestmark = pytest.mark.runs

SLOW = "count = 6\npause = 0.3\n"


def start(path: Path, *options: object) -> subprocess.Popen:
    """Start a run in a process and a group of its own, as a shell does."""
    command = [sys.executable, "-m", "bayescal", "run", str(path), *map(str, options)]
    return subprocess.Popen(
        command,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
        cwd=path.parent,
        preexec_fn=heed_interrupts,
    )


def heed_interrupts() -> None:
    """Take interrupts as a shell's foreground does, wherever the tests themselves were started."""
    signal.signal(signal.SIGINT, signal.default_int_handler)


def wait_for_tasks(out: Path, n: int = 1, limit: float = 60.0) -> None:
    """Wait until so many tasks are kept."""
    until = time.monotonic() + limit
    while len(list(out.with_name(f"{out.name}.partial").glob("squares-*.npz"))) < n:
        assert time.monotonic() < until, "no task was kept in time"
        time.sleep(0.02)


def list_group(leader: int) -> list[int]:
    """Return the processes of a session that are still there and no zombies."""
    found = []
    for entry in Path("/proc").iterdir():
        if entry.name.isdigit():
            try:
                state, _, _, session = (entry / "stat").read_text().rpartition(")")[2].split()[:4]
            except (OSError, ValueError):
                continue
            if int(session) == leader and state != "Z":
                found.append(int(entry.name))
    return found


def read_all(out: Path) -> dict[str, bytes]:
    return {str(p.relative_to(out)): p.read_bytes() for p in sorted(out.rglob("*")) if p.is_file()}


def test_run_report_workers_and_compare(call, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    path = toys.write_toy(tmp_path)
    for workers in (1, 2):
        code, said, complaint = call("run", path, "--out", tmp_path / f"out{workers}", "--workers", workers)
        assert code == 0, complaint
        assert "Squares add" in said
        assert re.search(r"squares: 4 of 4\b", complaint)
    one, two = (read_all(tmp_path / f"out{n}") for n in (1, 2))
    assert one == two
    assert {"summary.json", "provenance.json", "report.html", "squares.csv", "notes/plain.txt"} <= set(one)
    assert one["inputs/toy_kind.py"] == toys.KIND.encode()
    provenance = json.loads(one["provenance.json"])
    assert set(provenance["files"]) == {"numbers.txt", "toy_kind.py"}
    (tmp_path / "out1" / "report.html").unlink()
    (tmp_path / "toy_kind.py").unlink()
    assert call("report", tmp_path / "out1", "--trust-code")[0] == 0
    assert read_all(tmp_path / "out1") == one
    code, said, _ = call("compare", tmp_path / "out1", tmp_path / "out2", "--trust-code")
    assert code == 0
    assert "total" in said


def test_code_of_results_is_run_where_somebody_trusts_it(call, tmp_path, distrust):
    path, out = toys.write_toy(tmp_path), tmp_path / "out"
    assert call("run", path, "--out", out, "--workers", 1, "--quiet", "--trust")[0] == 0
    for options, spoil, message in (
        ((), "", f"kind: found 'toy_kind.py:Toy': code (toy_kind.py in {out}/inputs) that nobody has trusted"),
        (("--trust-code",), "# another", "toy_kind.py: differs"),
    ):
        (out / "inputs" / "toy_kind.py").write_text(toys.KIND + spoil)
        code, _, complaint = call("report", out, *options)
        assert (code, complaint.count("\n")) == (2, 1)
        assert message in complaint


BLOCKS = """
from bayescal.experiments.runner.blocks import PageBlock
from bayescal.report.blocks import make_section


class Total(PageBlock):
    def show(self, results):
        return make_section("In full", (f"It is {results.summary['total']!r}.",))


class Nothing(PageBlock):
    def show(self, results):
        return None


class Broken(PageBlock):
    def show(self, results):
        return results.summary["no such"]
"""


def test_blocks_of_a_file_are_on_the_page(call, tmp_path, request, monkeypatch):
    """What fails says so there; all is regenerated from results, whose code runs where somebody trusts it."""
    monkeypatch.setattr(losses, "RAISE_OTHERS", False)
    names = [f"blocks.py:{name}" for name in ("Total", "Nothing", "Broken")]
    path, out = toys.write_toy(tmp_path, f"page_sections = {json.dumps(names)}\n"), tmp_path / "out"
    (tmp_path / "blocks.py").write_text(BLOCKS)
    code, _, complaint = call("run", path, "--out", out, "--workers", 1, "--quiet")
    assert code == 3
    assert "'Broken'" in complaint
    assert "KeyError: 'no such' (blocks.py," in complaint
    whole = read_all(out)
    page = whole["report.html"].decode()
    total = json.loads(whole["summary.json"])["total"]
    assert f"It is {total!r}." in page
    assert "KeyError: 'no such' (blocks.py," in page.replace("&#39;", "'")
    assert ["'Broken'" in one["what"] for one in json.loads(whole["summary.json"])["lost"]] == [True]
    assert "Nothing" not in page.partition("blocks.py")[0]
    assert whole["inputs/blocks.py"] == BLOCKS.encode()
    assert "blocks.py" in json.loads(whole["provenance.json"])["files"]
    (tmp_path / "blocks.py").unlink()
    request.getfixturevalue("distrust")
    code, _, complaint = call("report", out)
    assert (code, complaint.count("\n")) == (2, 1)
    assert call("report", out, "--trust-code")[0] == 0
    assert read_all(out) == whole


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"kind": "toy_kind.py:Nothing"}, "expected a subclass of Experiment"),
        ({"kind": "nowhere.py:Toy"}, "nowhere.py: no such"),
        ({"kind": "no.such.module:Toy"}, "found 'no.such.module:Toy', expected file.py:Class"),
        ({"kind": "stduy"}, "did you mean 'study'?"),
        ({"numbers": "missing.txt"}, "missing.txt"),
        ({"count": 0}, "count: found 0"),
        ({"page_sections": ["nowhere.py:Total"]}, "page_sections: found 'nowhere.py:Total'"),
        (
            {"page_sections": ["toy_kind.py:Toy"]},
            "page_sections: found 'toy_kind.py:Toy', expected a subclass of PageBlock",
        ),
    ],
)
def test_faults_are_one_line_and_leave_nothing(refuse, tmp_path, change, message):
    path = toys.write_toy(tmp_path)
    lines = [line for line in path.read_text().splitlines() if line.partition(" ")[0] not in change]
    path.write_text("\n".join([*lines, *(f"{key} = {json.dumps(value)}" for key, value in change.items())]))
    refuse(re.escape(message), tmp_path / "sub" / "out", "run", path)
    assert not (tmp_path / "sub").exists()


def test_an_installed_package_offers_its_kind_by_name(tmp_path):
    """what the documentation says of entry points: a package on the path, its kind named by the config alone."""
    site, path = tmp_path / "site", toys.write_toy(tmp_path)
    (site / "toys-1.0.dist-info").mkdir(parents=True)
    (site / "toys-1.0.dist-info" / "METADATA").write_text("Metadata-Version: 2.1\nName: toys\nVersion: 1.0\n")
    (site / "toys-1.0.dist-info" / "entry_points.txt").write_text("[bayescal.kinds]\ntoy = toy_kind:Toy\n")
    (tmp_path / "toy_kind.py").rename(site / "toy_kind.py")
    path.write_text(path.read_text().replace("toy_kind.py:Toy", "toy"))
    environment = {**os.environ, "PYTHONPATH": str(site)}
    for command in (["run", path, "--out", tmp_path / "out", "--workers", 2, "--quiet"], ["report", tmp_path / "out"]):
        called = [sys.executable, "-m", "bayescal", *map(str, command)]
        done = subprocess.run(called, env=environment, capture_output=True, text=True, check=False)
        assert (done.returncode, done.stderr) == (0, "")
    assert (tmp_path / "out" / "report.html").is_file()


def test_a_module_that_raises_is_one_line(refuse, tmp_path):
    path = toys.write_toy(tmp_path)
    (tmp_path / "toy_kind.py").write_text("raise RuntimeError('broken\\nin two lines')")
    refuse(re.escape("import fails (RuntimeError: broken in two lines)"), tmp_path / "out", "run", path)


def test_a_title_changes_no_result_and_an_input_file_does(call, refuse, tmp_path):
    path, out = toys.write_toy(tmp_path), tmp_path / "out"
    assert call("run", path, "--out", out, "--workers", 1, "--quiet") == (0, "", "")
    edit(path, 'title = "A toy"', 'title = "Another title"')
    assert call("run", path, "--out", out, "--quiet")[0] == 0
    edit(tmp_path / "numbers.txt", "2.0", "3.0")
    refuse("holds results of another config", out, "run", path)


@pytest.mark.parametrize("workers", [1, 2])
def test_killed_and_resumed_is_uninterrupted(call, tmp_path, workers):
    """Under another title at that: it changes no number."""
    path, out, whole = toys.write_toy(tmp_path, SLOW), tmp_path / "out", tmp_path / "whole"
    process = start(path, "--out", out, "--workers", workers, "--quiet")
    wait_for_tasks(out, 2)
    os.kill(process.pid, signal.SIGKILL)
    process.communicate()
    kept = {p.name for p in out.with_name("out.partial").glob("*.npz")}
    assert 2 <= len(kept) < 6
    assert not out.exists()
    path.write_text(path.read_text().replace('title = "A toy"', 'title = "Another title"'))
    assert call("run", path, "--out", out, "--workers", 3 - workers, "--resume", "--quiet") == (0, "", "")
    assert call("run", path, "--out", whole, "--workers", 1, "--quiet") == (0, "", "")
    assert read_all(out) == read_all(whole)
    assert not list(tmp_path.glob("out.*"))


@pytest.mark.parametrize("workers", [1, 2])
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_interrupts_are_one_line_and_leave_no_process(tmp_path, workers, number):
    path, out = toys.write_toy(tmp_path, SLOW), tmp_path / "out"
    process = start(path, "--out", out, "--workers", workers, "--quiet")
    wait_for_tasks(out)
    os.killpg(process.pid, number) if number == signal.SIGINT else os.kill(process.pid, number)
    said, complaint = process.communicate(timeout=20)
    assert (process.returncode, said, complaint.count("\n")) == (130, "", 1)
    assert "continue with --resume" in complaint
    until = time.monotonic() + 10.0
    while list_group(process.pid) and time.monotonic() < until:
        time.sleep(0.1)
    assert list_group(process.pid) == []
    assert not out.exists()
    assert [path.name for path in tmp_path.glob("out*")] == ["out.partial"]


def test_a_second_run_on_the_same_results_is_refused(call, tmp_path):
    path, out = toys.write_toy(tmp_path, SLOW), tmp_path / "out"
    process = start(path, "--out", out, "--workers", 1, "--quiet")
    wait_for_tasks(out)
    code, _, complaint = call("run", path, "--out", out)
    assert (code, complaint.count("\n")) == (2, 1)
    assert f"another run (process {process.pid})" in complaint
    os.kill(process.pid, signal.SIGKILL)
    process.communicate()
    assert call("run", path, "--out", out, "--resume", "--quiet")[0] == 0  # the lock died with its process


def test_a_failure_on_the_way_leaves_the_old_results(call, tmp_path, monkeypatch):
    path, out = toys.write_toy(tmp_path), tmp_path / "out"
    assert call("run", path, "--out", out, "--workers", 1, "--quiet")[0] == 0
    before = read_all(out)

    def fail(page, folder, *more):
        raise OSError(28, "No space left on device", str(folder))

    monkeypatch.setattr(frame, "write_page", fail)
    code, said, complaint = call("run", path, "--out", out, "--workers", 1, "--quiet")
    assert (code, said, complaint.count("\n")) == (3, "", 1)
    assert re.search("No space left .*expected room", complaint)
    assert read_all(out) == before
