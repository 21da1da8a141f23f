"""Tasks on the workers of a dask scheduler, on this machine or many: the same numbers as in one process.

What all tasks of a stage need goes to the scheduler once, as bytes, and from worker to worker; each unpacks it once.
It is a task of dask itself, so that it is made again where all workers that had it are gone. Tasks of lost workers are
dask's to repeat; their numbers depend on nothing but what they are given.

What travels is pickled, as all that dask sends is: scheduler and workers run what they are sent, and this run takes
back what they answer, so that both have to be trusted. Nothing is unpickled from a file.
"""

from __future__ import annotations

import hashlib
import logging
import pickle
import re
import sys
import threading
import time
import uuid
import warnings
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import CancelledError
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING

import cloudpickle
from threadpoolctl import threadpool_limits

from bayescal.errors import InputError, NumericalError
from bayescal.experiments.runner.engine import Engine, Failure, run_guarded, run_quietly
from bayescal.experiments.runner.identity import list_versions
from bayescal.experiments.runner.interrupts import shield_children
from bayescal.experiments.runner.records import Record

if TYPE_CHECKING:
    from distributed import Client, Future

LOCAL = re.compile(r"local:([1-9]\d{0,3})")
LOOPBACK = "127.0.0.1"
TIMEOUT = 10.0  # seconds for a scheduler to answer
POLL = 0.03  # seconds between two looks for results
WORKER_TIMEOUT_S = 30.0  # seconds after which workers are looked for
KEPT = 2  # stages that a worker keeps unpacked: the next one begins while tasks of the last may be under way
PACKAGES = ("cloudpickle", "dask", "distributed", "pydantic")
"""What must be the same at both ends besides what numbers depend on."""
SPARING = {
    "distributed.worker.profile.enabled": False,
    "distributed.admin.tick.interval": "500ms",
    "distributed.admin.system-monitor.interval": "5s",
    "distributed.scheduler.active-memory-manager.start": False,
    "distributed.scheduler.work-stealing-interval": "1s",
}
"""What dask would otherwise spend on watching itself, a tenth of a core; nobody looks at workers of one run."""
WANT = "--dask-scheduler"
ANSWER, KILLED = "answer", "killed"

type Versions = dict[str, str]
type Parcel = tuple[str, Versions, bytes]
type Answer = tuple[str, float, list[Record | Failure]]
"""Of a batch: a word, the seconds of processor time that it took, and what became of each task."""

TARGET = 0.5  # seconds of processor time of a batch
AHEAD = 3  # batches per thread of a worker
PATIENCE = 1.0  # seconds between two looks at how many workers there are
NEWEST = 0.3  # weight of the last batch in what a task is expected to take

type Names = tuple[str, ...]


@dataclass(frozen=True, eq=False)
class Cluster(Engine):
    """The workers of a scheduler."""

    client: Client
    address: str  # as it was asked for
    own: bool  # whether scheduler and workers belong to this run

    def compute[S, T](
        self, function: Callable[[S, T], object], shared: S, tasks: Mapping[str, T]
    ) -> Iterator[tuple[str, Record | Failure]]:
        """Yield each task's name with its record or failure as they come; see `Engine.compute`.

        What is still under way when the caller wants no more is cancelled.
        """
        if not tasks:
            return
        from distributed import as_completed

        feed = Feed(self.client, _work, f"bayescal-{uuid.uuid4().hex}", self._send(function, shared), tasks)
        try:
            ended, seen = as_completed(feed.fill(), loop=self.client.loop), time.monotonic()
            while not feed.is_done:
                if not ended.has_ready():
                    time.sleep(POLL)
                    seen = self._look_for_workers(seen)
                else:
                    batch = list(ended.next_batch(block=False))
                    for future, answer in zip(batch, self._fetch(batch), strict=True):
                        yield from self._sort(feed, future.key, answer)
                ended.update(feed.fill())
        finally:
            with suppress(Exception):  # whatever came before matters more
                self.client.cancel([future for future, _ in feed.sent.values()])

    def _sort(self, feed: Feed, key: str, answer: Answer | Failure) -> Iterator[tuple[str, Record | Failure]]:
        """Yield what became of a batch's tasks; those of a batch that killed workers are tried one by one."""
        if len(answer) == 3:
            _, seconds, outcomes = answer
            yield from zip(feed.end(key, seconds), outcomes, strict=True)
            return
        names = feed.end(key)
        if len(names) > 1 and answer[1].startswith(KILLED):
            feed.alone.extend(names)
        else:
            yield from ((name, answer) for name in names)

    def _fetch(self, batch: list[Future]) -> list[Answer | Failure]:
        """Return the answers of batches that have ended."""
        try:
            return [pickle.loads(one) for one in self.client.gather(batch)]  # the usual case: one message for all
        except (Exception, CancelledError):  # one of them has none
            return [self._read(future) for future in batch]

    def _read(self, future: Future) -> Answer | Failure:
        """Return the answer of a batch that has ended, or why there is none."""
        from distributed import KilledWorker

        try:
            answer: Answer = pickle.loads(future.result())
        except (CancelledError, OSError) as error:
            raise NumericalError(f"the scheduler at {self.address} was lost; continue with --resume") from error
        except KilledWorker as error:
            said = f"{KILLED} {error.allowed_failures + 1} workers, perhaps for want of memory"
            return NumericalError, said
        except (ImportError, pickle.UnpicklingError) as error:
            return NumericalError, f"a worker lacks what it needs ({_one_line(error)})"
        return answer

    def _look_for_workers(self, seen: float) -> float:
        """Return when workers were seen last; NumericalError where this run's own are gone for good.

        A nanny does not start a worker again that ends while it is still starting it. Workers of another scheduler may
        come whenever a queue lets them.
        """
        now = time.monotonic()
        if not self.own or now - seen < WORKER_TIMEOUT_S or self.client.status != "running":
            return seen
        if not self.client.nthreads():
            raise NumericalError(f"all workers of {self.address} were killed (out of memory?); continue with --resume")
        return now

    def _send[S, T](self, function: Callable[[S, T], object], shared: S) -> object:
        """Send what all tasks of a stage need to every worker that is there; return what stands for it."""
        content = cloudpickle.dumps((function, shared))
        token = hashlib.sha256(content).hexdigest()
        with unwarned():
            sent = self.client.submit(_keep, (token, list_all_versions(), content), key=f"bayescal-shared-{token}")
        if self.client.nthreads():
            with suppress(Exception):  # it only saves time: workers fetch from each other what they miss
                sent.exception(timeout=TIMEOUT)
                self.client.replicate([sent])
        return sent


@contextmanager
def connect(address: str, quiet: bool = True) -> Iterator[Cluster]:
    """Hold a connection to a scheduler, or to one of this machine's own for ``local:N``.

    InputError where dask is not installed, no scheduler answers, or versions differ between it, its workers and here.
    """
    distributed = _import_distributed()
    local = LOCAL.fullmatch(address)
    if address.startswith("local") and not local:
        raise InputError(f"{WANT}: found {address!r}, expected local:N, such as local:4")
    with _serve(distributed, int(local[1])) if local else _answer(distributed, address) as client:
        _check_versions(client, address)
        if not quiet and not client.nthreads():
            print(f"waiting for workers of {address}", file=sys.stderr, flush=True)
        yield Cluster(client, address, local is not None)


def _import_distributed() -> ModuleType:
    try:
        import dask

        if "distributed" not in sys.modules:  # what goes wrong is said in one line, and not in its logs besides
            loggers = ("distributed", "distributed.client", "tornado", "tornado.application")
            given = dask.config.get("logging", {})
            dask.config.set({"logging": {**dict.fromkeys(loggers, "critical"), **given}})
        import distributed
    except ImportError as error:
        raise InputError(f"{WANT}: no dask.distributed ({_one_line(error)}): pip install 'bayescal[dask]'") from error
    return distributed


@contextmanager
def _serve(distributed: ModuleType, workers: int) -> Iterator[Client]:
    """Hold a scheduler and workers of this machine that nobody else can reach."""
    nowhere = f"{LOOPBACK}:0"
    import dask

    with dask.config.set(SPARING), shield_children(), unwarned():
        cluster = distributed.LocalCluster(
            n_workers=workers,
            threads_per_worker=1,
            host=LOOPBACK,
            dashboard_address=nowhere,
            worker_dashboard_address=nowhere,
            silence_logs=logging.CRITICAL,
            memory_limit=0,  # nobody looks ten times a second; what an experiment needs is estimated before
        )
    with cluster, distributed.Client(cluster, set_as_default=False) as client:
        yield client


@contextmanager
def _answer(distributed: ModuleType, address: str) -> Iterator[Client]:
    """Hold a connection to a scheduler that runs already."""
    where: dict[str, str] = {"address": address}
    if address.startswith("tls:") and distributed.Security().tls_client_cert is None:
        raise InputError(f"{WANT}: found no certificate for {address}, expected one in dask's configuration")
    if address.endswith(".json"):
        if not Path(address).is_file():
            raise InputError(f"{WANT}: found no file {address}, expected a scheduler's")
        where = {"scheduler_file": address}
    try:
        with unwarned():
            client = distributed.Client(**where, timeout=TIMEOUT, set_as_default=False)
    except (OSError, ValueError, TypeError, KeyError, ImportError, RuntimeError) as error:
        raise InputError(
            f"{WANT}: found no scheduler at {address} ({_one_line(error)}), expected one within {TIMEOUT:.0f} s"
        ) from error
    with client:
        yield client


def _check_versions(client: Client, address: str) -> None:
    """Raise InputError where scheduler or workers are of other versions."""
    here = list_all_versions()
    packages = client.get_versions()["scheduler"]["packages"]
    there = {name: packages.get(name) for name in ("dask", "distributed")}
    if differ := _compare(there, here):
        raise InputError(f"{WANT}: the scheduler at {address} has {differ}")
    for worker, found in client.run(list_all_versions, on_error="return").items():
        if not isinstance(found, dict):
            raise InputError(f"{WANT}: worker {worker} tells no versions ({_one_line(found)})")
        if differ := _compare(found, here):
            raise InputError(f"{WANT}: the worker at {worker} has {differ}")


def _compare(there: Mapping[str, str | None], here: Versions) -> str:
    """Return in words what differs; nothing where all is the same."""
    other = [name for name in there if there[name] != here[name]]
    found = ", ".join(f"{name} {there[name]}" for name in other)
    return f"{found}, expected {', '.join(f'{name} {here[name]}' for name in other)}" if other else ""


def list_all_versions() -> Versions:
    """Return the versions of all that numbers, or what is sent, depend on."""
    return list_versions(PACKAGES)


def _one_line(error: object) -> str:
    return " ".join(f"{type(error).__name__}: {error}".split())[:300]


# --- on a worker -------------------------------------------------------------------------------------------------

_ONE_AT_A_TIME = threading.Lock()
"""Of a worker with several threads: the limit on BLAS holds for a process, and scratch memory is one thread's."""
_limited = 0
"""How many modules were there when the threads of BLAS were limited."""
_unpacked: dict[str, tuple[Callable[[object, object], object], object]] = {}


def _keep(parcel: Parcel) -> Parcel:
    return parcel


def _work(batch: bytes, parcel: Parcel) -> bytes:
    """Return a batch's answer; bytes both ways, so that arrays lie in memory as in any other process."""
    with _ONE_AT_A_TIME:
        began = time.thread_time()  # of a busy machine, too: what a batch costs beside dask is meant
        if differ := _compare(list_all_versions(), parcel[1]):
            return pickle.dumps((NumericalError, f"a worker has {differ}"))
        try:
            token, _, content = parcel
            if token not in _unpacked:  # a stage's function and what its tasks share, once
                while len(_unpacked) >= KEPT:
                    del _unpacked[next(iter(_unpacked))]
                _unpacked[token] = pickle.loads(content)
            function, shared = _unpacked[token]
            mine = pickle.loads(batch)
        except (ImportError, AttributeError, pickle.UnpicklingError) as error:
            return pickle.dumps((NumericalError, f"a worker lacks what it needs ({_one_line(error)})"))
        outcomes = [_run_limited(function, shared, task) for task in mine]
        return pickle.dumps((ANSWER, time.thread_time() - began, outcomes), protocol=pickle.HIGHEST_PROTOCOL)


def _run_limited[S, T](function: Callable[[S, T], object], shared: S, task: T) -> Record | Failure:
    """Return a task's record or failure; to look for libraries to limit takes longer than to send a task."""
    global _limited
    if len(sys.modules) == _limited:  # libraries come with modules
        return run_quietly(function, shared, task)
    outcome = run_guarded(function, shared, task)
    threadpool_limits(1)  # for good, those that this task has brought among them
    _limited = len(sys.modules)
    return outcome


@dataclass(eq=False)
class Feed:
    """Tasks that wait, and batches under way; only so much is sent ahead that no worker waits.

    To send a task, to look after it and to fetch its result takes dask some 10 to 20 ms of processor time, whatever the
    task. A batch takes that once; it is as large as its tasks take `TARGET` seconds by those that have ended, so that
    progress comes back soon and a lost worker costs little.
    """

    client: Client
    work: Callable[[bytes, Parcel], bytes]  # takes the bytes of a batch's tasks, and the parcel
    prefix: str  # of the batches' keys
    parcel: Future  # of what all tasks need
    tasks: Mapping[str, object]
    waiting: deque[str] = field(init=False)
    alone: deque[str] = field(init=False, default_factory=deque)  # tasks of a lost batch, each for one of its own
    sent: dict[str, tuple[Future, Names]] = field(init=False, default_factory=dict)
    seconds: float | None = field(init=False, default=None)
    _n_sent: int = field(init=False, default=0)
    _n_threads: int = field(init=False, default=0)
    _looked: float = field(init=False, default=-PATIENCE)

    def __post_init__(self) -> None:
        """Let all tasks wait."""
        self.waiting = deque(self.tasks)

    @property
    def is_done(self) -> bool:
        """Whether nothing waits and nothing is under way."""
        return not (self.waiting or self.alone or self.sent)

    def fill(self) -> list[Future]:
        """Send batches as long as workers could run short of them; return their futures."""
        room = AHEAD * self._count_threads() - len(self.sent)
        batches = [self._take(room - k) for k in range(room) if self.waiting or self.alone]
        batches = [names for names in batches if names]
        if not batches:
            return []
        keys = [f"{self.prefix}-{self._n_sent + k}" for k in range(len(batches))]
        self._n_sent += len(batches)
        packed = [cloudpickle.dumps([self.tasks[name] for name in names]) for names in batches]
        with unwarned():
            futures: list[Future] = self.client.map(self.work, packed, key=keys, parcel=self.parcel, pure=False)
        self.sent.update({f.key: (f, names) for f, names in zip(futures, batches, strict=True)})
        return futures

    def end(self, key: str, seconds: float | None = None) -> Names:
        """Take a batch that has ended off; return its tasks' names. It tells what tasks take."""
        _, names = self.sent.pop(key)
        if seconds is not None:
            each = seconds / len(names)
            self.seconds = each if self.seconds is None else (1.0 - NEWEST) * self.seconds + NEWEST * each
        return names

    def _take(self, room: int) -> Names:
        if self.alone:
            return (self.alone.popleft(),)
        share = -(-len(self.waiting) // max(1, room))  # the last batches end together
        size = 1 if self.seconds is None else max(1, min(share, round(TARGET / max(self.seconds, 1e-6))))
        return tuple(self.waiting.popleft() for _ in range(min(size, len(self.waiting))))

    def _count_threads(self) -> int:
        now = time.monotonic()
        if now - self._looked >= PATIENCE:
            self._looked, self._n_threads = now, sum(self.client.nthreads().values())
        return max(1, self._n_threads)


@contextmanager
def unwarned() -> Iterator[None]:
    """Leave out what dask warns of and what is checked here, or meant: versions, ports, large inputs."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        yield
