"""Fixtures shared by the tests: a telescope's data set and a stream of random numbers per test."""

from __future__ import annotations

import atexit
import os
import re
import shutil
import sys
import tempfile
from pathlib import Path

import numpy as np
import pytest
import telescope_machines as machines
from efforts import searching_little
from matplotlib import rc_context, rcdefaults, rcParams
from studies import snapshot

from bayescal import cli
from bayescal.config import trust
from bayescal.experiments.runner import losses
from bayescal.files import manifest
from bayescal.report.pictures import Picture, render_picture
from bayescal.report.style import RC

os.environ["BAYESCAL_TRUST"] = "1"  # the code of this repository and of its tests, in processes of theirs too
losses.RAISE_OTHERS = True  # a programming error is no loss, in processes of this one at least
os.environ["XDG_CONFIG_HOME"] = tempfile.mkdtemp(prefix="bayescal-tests-")  # what a user has trusted is left alone
atexit.register(shutil.rmtree, os.environ["XDG_CONFIG_HOME"], ignore_errors=True)


@pytest.fixture(autouse=True)
def _say_nothing_of_code(request, monkeypatch):
    """Leave lines that name a file's code, or results of earlier versions, to the tests of these."""
    if not {"distrust", "voice"} & set(request.fixturenames):
        monkeypatch.setattr(sys.modules["bayescal.cli.app"], "_say", lambda line: None)


REFUSE = manifest._refuse


@pytest.fixture(autouse=True, scope="session")
def _take_doctored_results():
    """Take results whose files a test has changed on purpose, for instance to pass them off as converged."""
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(manifest, "_refuse", lambda folder, faults: None)
        yield


@pytest.fixture
def wary(monkeypatch):
    """Let results be whole or refused."""
    monkeypatch.setattr(manifest, "_refuse", REFUSE)


@pytest.fixture
def voice(wary):
    """Let results be whole or refused, and commands say what code they run and what is not known of results."""


@pytest.fixture
def distrust(monkeypatch, tmp_path_factory):
    """Run code only where somebody has trusted it, as a user's shell does."""
    monkeypatch.setattr(trust, "_trusted_here", set())  # what tests before have made in this process
    monkeypatch.setenv("BAYESCAL_TRUST", "")
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path_factory.mktemp("settings")))


@pytest.fixture
def rng() -> np.random.Generator:
    """Return the same stream of random numbers to every test."""
    return np.random.default_rng(8096)


@pytest.fixture(scope="session")
def twin():
    """Return the telescope's twin: 40 poses simulated from table 7 (a) with K, no model error."""
    machine = machines.build_machine("matrix")
    truth = machines.telescope_truth(machine)
    rng = np.random.default_rng(7)
    return machines.simulate_poses(machine, truth, machines.table_3_actuators(), np.zeros(6), rng)


pytest.register_assert_rewrite("browser")


@pytest.fixture
def call(monkeypatch, capsys):
    """Return a function that calls the command line in this process: exit code, standard output, standard error."""

    monkeypatch.setattr("bayescal.experiments.runner.engine.stop_workers", lambda: None)  # the next call takes them

    def call_main(*arguments: object) -> tuple[int, str, str]:
        monkeypatch.setattr(sys, "argv", ["bayescal", *map(str, arguments)])
        capsys.readouterr()
        with pytest.raises(SystemExit) as exit_info:
            cli.main()
        return int(exit_info.value.code or 0), *capsys.readouterr()

    return call_main


@pytest.fixture
def refuse(call):
    """Return a function that checks that a call is refused in one line that matches, and that nothing is written."""

    def check(said: str, out: Path, *arguments: object) -> str:
        before = snapshot(out.parent)
        code, printed, complaint = call(*arguments, "--out", out)
        assert (code, printed, complaint.count("\n")) == (2, "", 1), complaint
        assert re.search(said, complaint), complaint
        assert snapshot(out.parent) == before
        return complaint

    return check


@pytest.fixture
def refuse_here(call, tmp_path):
    """Return a function that checks a call's refusal (code 2, one line, nothing written here) and returns the line."""

    def check(*arguments: object) -> str:
        before = snapshot(tmp_path)
        code, printed, complaint = call(*arguments)
        assert (code, printed, complaint.count("\n")) == (2, "", 1), complaint
        assert complaint.startswith("bayescal: ")
        assert snapshot(tmp_path) == before
        return complaint

    return check


@pytest.fixture(autouse=True, scope="session")
def _render_seldom():
    """Let figures of pages be built, by this package's code, and not be rendered, which takes most of their time."""
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr("bayescal.report.page.render_picture", _build)
        yield


def _build(draw):
    with rc_context():
        rcdefaults()
        rcParams.update(RC)
        draw()
    return Picture(b"not drawn")


@pytest.fixture
def pictures(monkeypatch):
    """Let pages have their figures as they are: for tests of what is in them."""
    monkeypatch.setattr("bayescal.report.page.render_picture", render_picture)


@pytest.fixture
def no_pictures(monkeypatch):
    """Leave a page's pictures undrawn, which take most of its time; text and files' names are what they are."""
    for module in ("page", "pictures"):  # of reports, and of certificates
        monkeypatch.setattr(f"bayescal.report.{module}.render_picture", lambda draw: Picture(b"not drawn"))


@pytest.fixture
def search_little():
    """Let runs in this process sample from Laplace's approximation as it is: for tests of what a run writes."""
    with searching_little():
        yield
