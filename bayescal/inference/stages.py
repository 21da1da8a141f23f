"""What a long computation is at, for whoever follows it: its stage by name, how much of that is done, the time left.

A stage counts the densities that it computes, of as many as are expected. Stages within a stage count for that one. A
first answer is said as soon as it is known.
Where nobody follows, all of this does nothing.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from dataclasses import dataclass, field

from bayescal.errors import NumericalError

EVERY = 0.5  # seconds between two reports at the least


@dataclass(frozen=True)
class Report:
    """What a computation is at."""

    stage: str
    share: float | None  # of the stage, done; None where it does not count
    # seconds since it began, and to its end as far as that is known
    spent: float
    left: float | None


@dataclass(eq=False)
class _Follower:
    tell: Callable[[Report], None]
    answer: Callable[[str], None]
    began: float = field(default_factory=lambda: time.monotonic())
    plan: dict[str, int] = field(default_factory=dict)
    stage: str = ""
    total: int = 0
    done: int = 0
    entered: float = 0.0
    counted: int = 0
    seconds: float = 0.0
    told: float = -EVERY

    def enter(self, stage: str, total: int) -> None:
        self.stage, self.total, self.done, self.entered = stage, total, 0, time.monotonic()
        self.plan.pop(stage, None)
        self.report()

    def leave(self) -> None:
        if self.total:
            self.counted, self.seconds = self.counted + self.done, self.seconds + time.monotonic() - self.entered
        self.stage = ""

    def report(self) -> None:
        now = time.monotonic()
        if now - self.told < EVERY:
            return
        self.told = now
        share = min(1.0, self.done / self.total) if self.total else None
        counted, seconds = (self.done, now - self.entered) if self.total and self.done else (self.counted, self.seconds)
        left = None
        if counted and seconds > 0.0:
            left = (max(0, self.total - self.done) + sum(self.plan.values())) * seconds / counted
        self.tell(Report(self.stage, share, now - self.began, left))


_follower: ContextVar[_Follower | None] = ContextVar("follower", default=None)


@contextmanager
def follow(tell: Callable[[Report], None], answer: Callable[[str], None] = lambda said: None) -> Iterator[None]:
    """Tell what is computed here is at, now and then, and a first answer once."""
    before = _follower.set(_Follower(tell, answer))
    try:
        yield
    finally:
        _follower.reset(before)


@contextmanager
def stage(name: str, total: int = 0) -> Iterator[None]:
    """Say that a stage is under way, and how many densities it is expected to compute; zero where that is not known."""
    follower = _follower.get()
    if follower is None or follower.stage:
        yield
        return
    follower.enter(name, total)
    try:
        yield
    finally:
        follower.leave()


def answer_first(say: Callable[[], str]) -> None:
    """Say a first answer, which is made only where somebody follows; one that fails numerically is not said."""
    follower = _follower.get()
    if follower is None:
        return
    with suppress(NumericalError, ArithmeticError, ValueError):  # SciPy and LAPACK raise the last two
        if said := say():
            follower.answer(said)


def expect(plan: Mapping[str, int]) -> None:
    """Say how many densities the stages to come are expected to compute."""
    follower = _follower.get()
    if follower is not None:
        follower.plan = dict(plan)


def count(n: int) -> None:
    """Count densities that were computed."""
    follower = _follower.get()
    if follower is not None and follower.stage:
        follower.done += n
        follower.report()
