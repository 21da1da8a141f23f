"""Tasks on their way to a scheduler's workers, short ones several at a time.

To send a task, to look after it and to fetch its result takes dask some 10 to 20 ms of processor time, whatever the
task. A batch takes that once; it is as large as its tasks take `TARGET` seconds of it by those that have ended, so that
progress comes back soon and a lost worker costs little. Only so much is sent ahead that no worker waits.
"""

from __future__ import annotations

import time
import warnings
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

import cloudpickle

TARGET = 0.5  # seconds of processor time of a batch
AHEAD = 3  # batches per thread of a worker
PATIENCE = 1.0  # seconds between two looks at how many workers there are
NEWEST = 0.3  # weight of the last batch in what a task is expected to take

type Names = tuple[str, ...]


@dataclass(eq=False)
class Feed:
    """Tasks that wait, and batches under way.

    Attributes
    ----------
    client : distributed.Client
    work : callable
        Takes the bytes of a batch's tasks and the parcel.
    prefix : str
        Of the batches' keys.
    parcel : distributed.Future
        What all tasks need.
    tasks : mapping of str to object
    """

    client: Any
    work: Callable[[bytes, Any], bytes]
    prefix: str
    parcel: Any
    tasks: Mapping[str, Any]
    waiting: deque[str] = field(init=False)
    alone: deque[str] = field(init=False, default_factory=deque)
    sent: dict[str, tuple[Any, Names]] = field(init=False, default_factory=dict)
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

    @property
    def under_way(self) -> list[Any]:
        """The futures of batches that have not ended."""
        return [future for future, _ in self.sent.values()]

    def fill(self) -> list[Any]:
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
            futures: list[Any] = self.client.map(self.work, packed, key=keys, parcel=self.parcel, pure=False)
        self.sent.update({f.key: (f, names) for f, names in zip(futures, batches, strict=True)})
        return futures

    def end(self, key: str, seconds: float | None = None) -> Names:
        """Take a batch that has ended off; return its tasks' names. It tells what tasks take."""
        _, names = self.sent.pop(key)
        if seconds is not None:
            each = seconds / len(names)
            self.seconds = each if self.seconds is None else (1.0 - NEWEST) * self.seconds + NEWEST * each
        return names

    def send_alone(self, names: Names) -> None:
        """Let tasks of a lost batch wait, each for one of its own."""
        self.alone.extend(names)

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
