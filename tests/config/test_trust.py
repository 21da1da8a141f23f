"""Whose code is run: what was trusted, of a config's folder or below; and nothing of where a process happens to be."""

from __future__ import annotations

import os
import py_compile
import re
import subprocess
import sys
from contextlib import nullcontext
from importlib import import_module
from pathlib import Path

import calibrations
import pytest

import bayescal as bc
from bayescal.config.registry import load_class
from bayescal.config.trust import list_code
from bayescal.projects.start import start_project

pytestmark = pytest.mark.usefixtures("distrust")

TRAP = "from pathlib import Path\nPath({!r}).write_text('executed')\n"
TOY = 'kind = "{}"\nname = "x"\ntitle = "x"\nseed = 1\n'


@pytest.fixture
def mark(tmp_path) -> Path:
    """Return what is there once code has run that must not."""
    return tmp_path / "mark"


@pytest.fixture
def stranger(tmp_path, mark) -> Path:
    """Return a stranger's config, whose code leaves the mark where it is run."""
    config = calibrations.write_delta(tmp_path / "stranger")
    module = config.parent / "linear_delta.py"
    module.write_text(module.read_text().replace("import numpy", f"{TRAP.format(str(mark))}import numpy", 1))
    return config


COMMANDS = {
    "validate": ["validate", "{config}"],
    "show": ["show", "{machine}"],
    "run": ["run", "{config}", "--out", "{out}"],
    "selftest": ["selftest", "{config}", "--out", "{out}"],
    "next-pose": ["next-pose", "{config}", "--out", "{out}"],
}


@pytest.mark.parametrize("name", COMMANDS)
def test_a_strangers_code_is_refused_in_one_line(name, stranger, mark, call):
    places = {"config": stranger, "machine": stranger.with_name("machine.toml"), "out": mark.with_name("out")}
    code, out, err = call(*(one.format(**places) for one in COMMANDS[name]))
    assert (code, out, err.count("\n")) == (2, "", 1), err
    assert f"code (linear_delta.py in {stranger.parent}) that nobody has trusted" in err
    assert f"bayescal trust {stranger.parent}" in err
    assert not mark.exists()
    assert not places["out"].exists()


def test_trusted_code_runs_until_it_changes(stranger, mark, call):
    code, out, _ = call("trust", stranger.parent)
    assert (code, out) == (0, f"trusted: {stranger.parent.resolve() / 'linear_delta.py'}\n")
    assert not mark.exists()
    code, out, err = call("validate", stranger)
    assert code == 0
    assert re.fullmatch(rf"bayescal: running .*linear_delta\.py in {stranger.parent}\n", err)
    assert mark.exists()
    module = stranger.with_name("linear_delta.py")
    module.write_text(module.read_text() + "# another\n")
    code, _, err = call("validate", stranger)
    assert (code, err.count("\n")) == (2, 1)
    assert "changed since trusted" in err


def test_code_is_trusted_wherever_it_lies_and_forgotten(stranger, tmp_path, call):
    assert call("trust", stranger.parent)[0] == 0
    stranger.parent.rename(tmp_path / "moved")
    assert call("validate", tmp_path / "moved" / stranger.name)[0] == 0
    assert call("trust", "--forget", tmp_path / "moved")[1].startswith("forgotten: ")
    assert call("validate", tmp_path / "moved" / stranger.name)[0] == 2


@pytest.mark.parametrize("how", ["before", "after", "environment"])
def test_trust_for_one_call(how, stranger, mark, call, monkeypatch):
    if how == "environment":
        monkeypatch.setenv("BAYESCAL_TRUST", "1")
    options = {"before": ["--trust", "validate", stranger], "after": ["validate", stranger, "--trust"]}
    assert call(*options.get(how, ["validate", stranger]))[0] == 0
    assert mark.exists()
    monkeypatch.setenv("BAYESCAL_TRUST", "0")
    assert call("validate", stranger)[0] == 2


@pytest.mark.parametrize(("answer", "code"), [(True, 0), (False, 2)])
def test_whoever_sits_at_a_terminal_is_asked_once(answer, code, stranger, mark, call, monkeypatch):
    asked = []
    monkeypatch.setattr(sys.modules["bayescal.cli.app"], "is_interactive", lambda: True)
    monkeypatch.setattr("typer.confirm", lambda text, err: asked.append(text) or answer)
    assert call("validate", stranger)[0] == code
    assert len(asked) == 1
    assert f"(linear_delta.py in {stranger.parent})" in asked[0]
    assert mark.exists() == answer
    assert call("validate", stranger)[0] == code
    assert len(asked) == 1 if answer else 2


def test_quiet_says_nothing_of_it(stranger, call):
    assert call("trust", stranger.parent)[0] == 0
    table = stranger.parent / "data" / "readings.csv"
    table.write_text(table.read_text().replace("s_1_mm", "s_7_mm", 1))  # what is found once the machine was read
    for options, said in (((), True), (("--quiet",), False)):
        code, _, err = call("run", stranger, *options, "--out", stranger.parent / "out")
        assert (code, "running code" in err) == (2, said)


# --- which files -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("where", ["../up.py", "{folder}/up.py", "linked.py", "linked/up.py", "sub/../../up.py"])
def test_no_file_outside_of_the_configs_folder_is_run(where, tmp_path, mark, call):
    inside = tmp_path / "inside"
    (inside / "sub").mkdir(parents=True)
    (tmp_path / "up.py").write_text(TRAP.format(str(mark)))
    (inside / "linked.py").symlink_to(tmp_path / "up.py")
    (inside / "linked").symlink_to(tmp_path)
    (inside / "toy.toml").write_text(TOY.format(f"{where.format(folder=tmp_path)}:Toy"))
    code, out, err = call("validate", inside / "toy.toml", "--trust")
    assert (code, out, err.count("\n")) == (2, "", 1)
    assert str(inside) in err.partition("expected")[2]
    assert not mark.exists()
    assert list_code(inside) == []


@pytest.mark.parametrize("form", ["stale bytecode", "extension", "link"])
def test_only_the_text_that_was_trusted_is_run(form, tmp_path, mark, monkeypatch):
    """Not what lies beside a file as its bytecode or a library, nor an import that leads elsewhere."""
    own = "import helper\nfrom bayescal import ReadingMachine\nclass Own(ReadingMachine):\n    read = None\n"
    (tmp_path / "own.py").write_text(own)
    helper = tmp_path / "helper.py"
    helper.write_text("")
    if form == "stale bytecode":
        other = tmp_path / "other.py"
        other.write_text(TRAP.format(str(mark)))
        target = tmp_path / "__pycache__" / f"helper.{sys.implementation.cache_tag}.pyc"
        py_compile.compile(str(other), str(target), invalidation_mode=py_compile.PycInvalidationMode.UNCHECKED_HASH)
    elif form == "extension":
        (tmp_path / "helper.abi3.so").write_bytes(b"no library")  # which Python would load before the text
    else:
        helper.unlink()
        (tmp_path.parent / f"{tmp_path.name}_far.py").write_text(TRAP.format(str(mark)))
        helper.symlink_to(tmp_path.parent / f"{tmp_path.name}_far.py")
    monkeypatch.delitem(sys.modules, "helper", raising=False)
    (tmp_path / "machine.toml").write_text('kind = "own.py:Own"\n')
    assert bc.trust(tmp_path)[0].name == "own.py"
    with pytest.raises(bc.InputError, match=r"own.py:Own.* import fails") if form == "link" else nullcontext():
        load_class("MACHINES", "own.py:Own", tmp_path)
    assert not mark.exists()


@pytest.mark.parametrize("name", ["os:system", "antigravity:x", "stranger:Toy"])
def test_a_module_that_no_package_offers_is_not_imported(name, tmp_path, mark, call, monkeypatch):
    (tmp_path / "stranger.py").write_text(TRAP.format(str(mark)))
    (tmp_path / "toy.toml").write_text(TOY.format(name))
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend("")
    code, _, err = call("validate", "toy.toml", "--trust")
    assert (code, err.count("\n")) == (2, 1)
    assert f"found {name!r}, expected file.py:Class" in err
    assert not mark.exists()


def test_nothing_of_the_current_folder_is_imported(tmp_path):
    """Not by `python -m`, which puts it first, and not by what looks like an installed package there."""
    here = tmp_path / "here"
    about = here / "stranger-1.0.dist-info"
    about.mkdir(parents=True)
    (about / "METADATA").write_text("Metadata-Version: 2.1\nName: stranger\nVersion: 1.0\n")
    (about / "entry_points.txt").write_text("[bayescal.kinds]\nstrange = stranger:Toy\n")
    for shadow in ("csv.py", "typer.py", "numexpr.py", "stranger.py"):
        (here / shadow).write_text(TRAP.format(str(tmp_path / f"executed {shadow}")))
    (here / "toy.toml").write_text(TOY.format("strange"))
    environment = {**os.environ, "PYTHONPATH": f"{Path(bc.__file__).parents[1]}{os.pathsep}"}
    command = [sys.executable, "-m", "bayescal", "validate", "toy.toml", "--trust"]
    done = subprocess.run(command, cwd=here, env=environment, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr.count("\n")) == (2, 1), done.stderr
    assert "kind: found 'strange'," in done.stderr
    assert list(tmp_path.iterdir()) == [here]


@pytest.mark.runs
def test_worker_processes_import_nothing_of_the_current_folder(tmp_path, mark):
    here = Path(start_project(tmp_path / "here", "own", None)[0]).parent
    audit = here / "audit.toml"
    audit.write_text(audit.read_text() + calibrations.SHORT_SWEEP)
    for name in ("joblib.py", "numexpr.py", "csv.py"):
        (here / name).write_text(TRAP.format(str(mark)))
    environment = {**os.environ, "PYTHONPATH": str(Path(bc.__file__).parents[1])}
    script = Path(sys.executable).with_name("bayescal")
    command = [script, "audit", "audit.toml", "--workers", "2", "--quiet"]
    done = subprocess.run(command, cwd=here, env=environment, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")
    assert not mark.exists()


def test_what_is_trusted_is_what_configs_and_results_name(tmp_path):
    for name in ("own.py", "helper.py", "unused.py", "results/inputs/kind.py", "results/inputs/other.py"):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text("import helper\n" if name == "own.py" else "raise RuntimeError\n")
    (tmp_path / "study.toml").write_text('a = [{ class = "own.py:Own" }]\nb = "no_such.py:Own"\n')
    (tmp_path / "results" / "inputs" / "experiment.toml").write_text('kind = "kind.py:Kind"')
    (tmp_path / "broken.toml").write_text("=")
    assert {path.name for path in list_code(tmp_path)} == {"own.py", "helper.py", "kind.py"}


# --- a project's own, and Python -------------------------------------------------------------------------------------


def test_the_code_of_a_new_project_is_trusted(tmp_path, call):
    start_project(tmp_path / "mine", "own", None)
    assert call("validate", tmp_path / "mine" / "study.toml")[0] == 0


def test_python_runs_a_class_it_is_given_and_no_file_of_a_stranger(stranger, mark, monkeypatch):
    with pytest.raises(bc.InputError, match="bayescal trust"):
        bc.load_machine(stranger.with_name("machine.toml"))
    assert not mark.exists()
    monkeypatch.syspath_prepend(stranger.parent)
    monkeypatch.delitem(sys.modules, "linear_delta", raising=False)
    with pytest.raises(bc.InputError, match="column_radius_mm: missing"):  # asked of the class, whose code has run
        bc.load_machine(import_module("linear_delta").LinearDelta)


def test_python_trusts_a_folder(stranger):
    assert [path.name for path in bc.trust(stranger.parent)] == ["linear_delta.py"]
    assert bc.load_machine(stranger.with_name("machine.toml")).name == "delta"
