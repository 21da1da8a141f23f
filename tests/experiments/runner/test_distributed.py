"""The workers of a dask scheduler: the bytes of one process, whatever happens to the workers."""

from __future__ import annotations

import json
import os
import pickle
import signal
import subprocess
import sys
import time
from pathlib import Path

import cloudpickle
import lives
import pytest
import test_kind_contract as contract
import test_toy_kind as toy_runs
import toys

from bayescal.errors import InputError, NumericalError
from bayescal.experiments.runner import distributed as engine
from bayescal.experiments.runner.engine import open_engine
from bayescal.experiments.runner.parallel import Run

distributed = pytest.importorskip("distributed")
psutil = pytest.importorskip("psutil")

PATH = os.pathsep.join([str(Path(__file__).parent), *filter(None, [os.environ.get("PYTHONPATH")])])  # for `lives`
ENVIRONMENT = {**os.environ, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "PYTHONPATH": PATH}
ENVIRONMENT["DASK_DISTRIBUTED__SCHEDULER__ALLOWED_FAILURES"] = "1"
STARTED = 60.0  # seconds


class Processes:
    """A scheduler and workers as processes of their own, on 127.0.0.1."""

    def __init__(self, folder: Path, workers: int) -> None:
        self.file, self.folder = folder / "scheduler.json", folder
        self.started: list[subprocess.Popen] = []
        self._start("scheduler", "--port", "0", "--dashboard-address", "127.0.0.1:0", "--scheduler-file", self.file)
        self.address = json.loads(self._await_file())["address"]
        for _ in range(workers):
            self.add_worker()
        self.client = distributed.Client(self.address, set_as_default=False)
        self.client.wait_for_workers(workers, timeout=STARTED)

    def _start(self, *what: object) -> subprocess.Popen:
        command = [sys.executable, "-m", "distributed.cli.dask_" + str(what[0]), *map(str, what[1:])]
        with (self.folder / "dask.log").open("ab") as log:
            process = subprocess.Popen(
                [*command, "--host", "127.0.0.1"], cwd=self.folder, env=ENVIRONMENT, stdout=log, stderr=log
            )
        self.started.append(process)
        return process

    def add_worker(self) -> subprocess.Popen:
        """Start a worker that nobody starts again when it is killed."""
        options = ("--nthreads", 1, "--no-nanny", "--no-dashboard", "--local-directory", self.folder)
        return self._start("worker", self.address, *options)

    def _await_file(self) -> str:
        until = time.monotonic() + STARTED
        while not (self.file.is_file() and self.file.read_text()):
            assert time.monotonic() < until, (self.folder / "dask.log").read_text()
            time.sleep(0.05)
        return self.file.read_text()

    def count_tasks(self) -> int:
        return self.client.run_on_scheduler(lambda dask_scheduler: len(dask_scheduler.tasks))

    def end(self) -> None:
        self.client.close()
        for process in reversed(self.started):
            process.kill()
            process.wait()


@pytest.fixture
def dask(tmp_path):
    """Return a scheduler with two workers."""
    folder = tmp_path / "dask"
    folder.mkdir()
    found = Processes(folder, 2)
    yield found
    found.end()


def kill(process: subprocess.Popen) -> None:
    process.send_signal(signal.SIGKILL)
    process.wait()


# --- the same bytes ----------------------------------------------------------------------------------------------


def test_killed_and_late_workers_lose_nothing(call, dask, tmp_path):
    """An own kind in a file beside its config, which no worker can import; one worker is killed, another one comes."""
    path = toys.write_toy(tmp_path, "count = 12\npause = 0.3\n")
    run = toy_runs.start(path, "--out", tmp_path / "out", "--dask-scheduler", dask.file, "--quiet")
    toy_runs.wait_for_tasks(tmp_path / "out", 2)
    kill(dask.started[1])
    dask.add_worker()
    said, complaint = run.communicate(timeout=60)
    assert (run.returncode, said, complaint) == (0, "", "")
    assert call("run", path, "--out", tmp_path / "whole", "--workers", 1, "--quiet") == (0, "", "")
    assert toy_runs.read_all(tmp_path / "out") == toy_runs.read_all(tmp_path / "whole")


def test_workers_share_the_tasks_and_progress_is_said(call, dask, tmp_path):
    with open_engine(scheduler=dask.address) as cluster:
        found = Run(cluster).map("pids", lives.say_pid, None, {str(k): k for k in range(20)})
    assert set(found.values()) == {process.pid for process in dask.started[1:]}
    path = toys.write_toy(tmp_path)
    code, said, complaint = call("run", path, "--out", tmp_path / "out", "--dask-scheduler", dask.address)
    assert code == 0, complaint
    assert "Squares add" in said
    assert complaint.splitlines()[-1].startswith("squares: 4 of 4 done")


@pytest.mark.slow
@pytest.mark.parametrize("kind", sorted(contract.MAKE))
def test_every_kind_gives_the_bytes_of_one_process(kind, dask, tmp_path, no_pictures):
    """A worker is killed as soon as tasks are under way; kinds without tasks have nothing to lose."""
    path = contract.MAKE[kind](tmp_path)
    contract.run(path, tmp_path / "one")
    run = toy_runs.start(path, "--out", tmp_path / "other", "--dask-scheduler", dask.address, "--quiet")
    until = time.monotonic() + STARTED
    while run.poll() is None and not any(dask.client.processing().values()) and time.monotonic() < until:
        time.sleep(0.01)
    kill(dask.started[1])
    _, complaint = run.communicate(timeout=300)
    assert run.returncode in (0, 3), complaint  # so few draws need not converge
    one, other = contract.read_all(tmp_path / "one"), contract.read_all(tmp_path / "other")
    assert contract.leave_out_pictures(one) == contract.leave_out_pictures(other)


# --- what goes wrong ---------------------------------------------------------------------------------------------


def test_a_task_that_kills_workers_is_given_up_and_the_others_are_done(dask, tmp_path):
    """The scheduler allows a task to meet the end of one worker; three more are there afterwards."""
    with open_engine(scheduler=dask.address) as cluster:
        with pytest.raises(NumericalError, match=r"^bad: killed 2 workers") as caught:
            Run(cluster).map("lives", lives.end_life, tmp_path / "first", {"bad": "always"})
        assert "\n" not in str(caught.value)
        assert [process.wait() for process in dask.started[1:]] == [-signal.SIGKILL] * 2
        for _ in range(2):
            dask.add_worker()
        tasks = {name: name for name in ("once", "plain", "other")}
        found = Run(cluster).map("lives", lives.end_life, tmp_path / "second", tasks)
    assert list(found.values()) == ["once done", "plain done", "other done"]
    assert sorted(process.poll() is None for process in dask.started[3:]) == [False, True]


def test_own_workers_that_are_gone_are_one_line(monkeypatch, tmp_path):
    monkeypatch.setattr(engine, "WORKER_TIMEOUT_S", 0.5)
    with open_engine(scheduler="local:1") as cluster:
        cluster.client.retire_workers(list(cluster.client.nthreads()))
        with pytest.raises(NumericalError, match=r"^all workers of local:1"):
            Run(cluster).map("lives", lives.end_life, tmp_path, {"plain": "plain"})


def start_long(folder, scheduler, n_tasks=1):
    """Return a run of many tasks under way, some of which have ended."""
    path, out = toys.write_toy(folder, "count = 40\npause = 0.3\n"), folder / "out"
    run = toy_runs.start(path, "--out", out, "--dask-scheduler", scheduler, "--quiet")
    toy_runs.wait_for_tasks(out, n_tasks)
    return run


def interrupt(run):
    """Interrupt a run, which says so in one line; return that."""
    os.killpg(run.pid, signal.SIGINT)
    said, complaint = run.communicate(timeout=20)
    assert (run.returncode, said, complaint.count("\n")) == (130, "", 1)
    return complaint


def wait_until(happens):
    """Wait some seconds for something."""
    until = time.monotonic() + 10.0
    while not happens() and time.monotonic() < until:
        time.sleep(0.1)


def test_an_interrupt_cancels_what_is_under_way(dask, tmp_path):
    run = start_long(tmp_path, dask.address)
    complaint = interrupt(run)
    assert "continue with --resume" in complaint
    wait_until(lambda: not dask.count_tasks())
    assert dask.count_tasks() == 0
    assert all(process.poll() is None for process in dask.started)


def test_an_interrupt_of_own_workers_leaves_no_process(tmp_path):
    run = start_long(tmp_path, "local:2")
    listening = [one for pid in toy_runs.list_group(run.pid) for one in psutil.Process(pid).net_connections("tcp")]
    assert {one.laddr.ip for one in listening if one.status == psutil.CONN_LISTEN} == {"127.0.0.1"}
    interrupt(run)
    wait_until(lambda: not toy_runs.list_group(run.pid))
    assert toy_runs.list_group(run.pid) == []


def test_a_scheduler_that_goes_away_is_one_line_and_what_is_done_is_kept(call, dask, tmp_path):
    run = start_long(tmp_path, dask.address, 2)
    kill(dask.started[0])
    said, complaint = run.communicate(timeout=90)
    assert (run.returncode, said, complaint.count("\n")) == (3, "", 1), complaint
    assert "was lost" in complaint
    assert len(list((tmp_path / "out.partial").glob("*.npz"))) >= 2


def test_other_versions_are_refused(dask, monkeypatch):
    versions = {**engine.list_all_versions(), "numpy": "1.0"}
    monkeypatch.setattr(engine, "list_versions", lambda more: versions)
    said = pytest.raises(InputError, match=r"tcp://\S+ .*numpy \S+, .*numpy 1\.0$")
    with said, open_engine(scheduler=dask.address):
        pass


@pytest.mark.parametrize(
    ("versions", "content", "message"),
    [
        ({"numpy": "1.0"}, cloudpickle.dumps((lives.say_pid, None)), "a worker has numpy"),
        ({}, b"cno_such_module\nfunction\n.", "a worker lacks what it needs (ModuleNotFoundError: "),
        ({}, b"nonsense", "a worker lacks what it needs (UnpicklingError: "),
    ],
)
def test_a_worker_that_comes_late_says_what_it_lacks(versions, content, message):
    parcel = (message, {**engine.list_all_versions(), **versions}, content)
    kind, said = pickle.loads(engine._work(cloudpickle.dumps([1]), parcel))
    assert kind is NumericalError
    assert said.startswith(message)


@pytest.mark.parametrize(
    ("address", "message"),
    [
        ("local:0", "expected local:N"),
        ("local", "expected local:N"),
        ("nowhere.json", "found no file nowhere.json"),
        ("tcp://127.0.0.1:1", "found no scheduler at tcp://127.0.0.1:1"),
        ("tls://127.0.0.1:1", "found no certificate for tls://127.0.0.1:1"),
        ("nonsense://here", "found no scheduler at nonsense://here"),
    ],
)
def test_addresses_without_scheduler_are_one_line(call, tmp_path, monkeypatch, address, message):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(engine, "TIMEOUT", 1.0)
    path = toys.write_toy(tmp_path)
    code, said, complaint = call("run", path, "--out", tmp_path / "out", "--dask-scheduler", address)
    assert (code, said, complaint.count("\n")) == (2, "", 1)
    assert message in complaint
    assert not list(tmp_path.glob("out*"))
