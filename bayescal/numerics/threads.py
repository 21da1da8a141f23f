"""Batches in threads side by side, where a run has cores that no task of its own uses.

NumPy lets other threads go on while it works on long arrays. The numbers are those of one batch after the other: each
is computed alone, and their order is kept.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from contextvars import ContextVar, copy_context
from functools import cache

_threads: ContextVar[int] = ContextVar("threads", default=1)


@contextmanager
def use_threads(count: int) -> Iterator[None]:
    """Let that many threads work on what this one computes meanwhile."""
    before = _threads.set(max(1, count))
    try:
        yield
    finally:
        _threads.reset(before)


def map_in_threads[T, R](function: Callable[[T], R], parts: Sequence[T]) -> list[R]:
    """Return what a function makes of parts, in their order; it must not change what several of them share."""
    count = _threads.get()
    if count == 1 or len(parts) < 2:
        return [function(part) for part in parts]
    # each in a context of its own: that says what NumPy warns of, and that there are no threads in threads
    calls = [_start(count).submit(copy_context().run, _call_alone, function, part) for part in parts]
    return [call.result() for call in calls]


def _call_alone[T, R](function: Callable[[T], R], part: T) -> R:
    _threads.set(1)
    return function(part)


@cache
def _start(count: int) -> ThreadPoolExecutor:
    return ThreadPoolExecutor(count, thread_name_prefix="batch")
