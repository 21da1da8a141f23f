"""What computes tasks: processes of this machine, or the workers of a scheduler; the numbers are the same."""

from __future__ import annotations

import multiprocessing
import os
import warnings
from abc import ABC, abstractmethod
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager, nullcontext, suppress
from dataclasses import dataclass
from importlib import import_module
from typing import Any

import joblib
import numpy as np
from joblib.externals.loky import get_reusable_executor
from joblib.externals.loky.process_executor import TerminatedWorkerError
from threadpoolctl import threadpool_limits

from bayescal.errors import BayescalError, InputError, NumericalError
from bayescal.experiments.runner.interrupts import follow_parent, shield_children
from bayescal.experiments.runner.losses import note_losses
from bayescal.experiments.runner.records import Record, encode, keep_losses
from bayescal.numerics.threads import use_threads

type Failure = tuple[type[BayescalError], str]


class Engine(ABC):
    """Computes tasks side by side."""

    @abstractmethod
    def compute[S, T](
        self, function: Callable[[S, T], object], shared: S, tasks: Mapping[str, T]
    ) -> Iterator[tuple[str, Record | Failure]]:
        """Yield each task's name with its record, or in words why it failed, as they end, in any order.

        Workers may begin before the first is asked for. The function takes what all tasks share, and a task.
        NumericalError where the engine itself fails; what was yielded before is good.
        """


@dataclass(frozen=True)
class Processes(Engine):
    """Processes of this machine; one of them, or a single task, is this process.

    Where there are fewer tasks than processes, each takes what it can in threads.
    """

    workers: int = 1

    def compute[S, T](
        self, function: Callable[[S, T], object], shared: S, tasks: Mapping[str, T]
    ) -> Iterator[tuple[str, Record | Failure]]:
        """Yield each task's name with its record or failure; see `Engine.compute`."""
        if self.workers == 1 or len(tasks) < 2:
            return ((name, run_guarded(function, shared, task, self.workers)) for name, task in tasks.items())
        threads = max(1, self.workers // len(tasks))
        calls = [(name, (run_guarded, function, shared, task, threads)) for name, task in tasks.items()]
        return _name_kill(_call_in_workers(self.workers, calls))


def open_engine(workers: int = 1, scheduler: str | None = None, quiet: bool = True) -> AbstractContextManager[Engine]:
    """Return what computes tasks, open as long as its context: processes, or the workers of a scheduler of dask.

    ``scheduler``: an address, the JSON file that a scheduler writes, or ``local:N``; ``quiet``: whether nothing is said
    of workers that are waited for. InputError where dask is not installed, none answers, or its versions differ.
    """
    if scheduler is None:
        return nullcontext(Processes(workers))
    from bayescal.experiments.runner.distributed import connect

    return connect(scheduler, quiet)


def _name_kill[R](outcomes: Iterator[R]) -> Iterator[R]:
    try:
        yield from outcomes
    except TerminatedWorkerError as error:
        said = "a worker was killed (out of memory?); continue with --resume"
        raise NumericalError(said) from error


@contextmanager
def start_ahead(workers: int, modules: Sequence[str]) -> Iterator[Callable[[], None]]:
    """Start the processes that tasks will be handed to, and yield what waits for them; nothing leaves them halfway.

    Starting them takes seconds, in which this process may do something else. They import modules; without any nothing
    is known of the tasks, and none is started, as for a single process.
    """
    if workers == 1 or not modules:
        yield lambda: None
        return
    started = _call_in_workers(workers, [(str(k), (import_all, modules)) for k in range(workers)])

    def exhaust() -> None:
        with suppress(TerminatedWorkerError):  # others are started
            for _ in started:
                pass

    try:
        yield exhaust
    finally:  # calls that are cancelled before they begin may leave an error in loky's thread
        exhaust()


def stop_workers() -> None:
    """End the processes that stand ready for more tasks, at once: a program that ends would wait for them."""
    if multiprocessing.active_children():  # without any, asking would make ready for some
        get_reusable_executor(reuse=True).shutdown(kill_workers=True)


def import_all(modules: Iterable[str]) -> None:
    """Import modules, as far as they can be."""
    for module in modules:
        with suppress(Exception):  # whoever needs it says so
            import_module(module)


def _call_in_workers(workers: int, calls: Sequence[tuple[str, tuple[object, ...]]]) -> Generator[tuple[str, Any]]:
    """Yield names and what their functions make of their arguments, as they end; no worker outlives this process."""
    parallel = joblib.Parallel(n_jobs=workers, return_as="generator_unordered", inner_max_num_threads=1)
    with shield_children():
        found = _close_quietly(
            parallel(joblib.delayed(_call_in_worker)(os.getpid(), name, *call) for name, call in calls)
        )
    next(found)
    return found


def _close_quietly(calls: Generator[object]) -> Generator[Any]:
    """Yield nothing, then what calls give; those that nobody wants any more are cancelled without a warning."""
    try:
        yield None
        for one in calls:  # noqa: UP028  # `yield from` would close them itself, with a warning
            yield one
    finally:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            calls.close()


def _call_in_worker[R](parent: int, name: str, function: Callable[..., R], *arguments: object) -> tuple[str, R]:
    follow_parent(parent)
    return name, function(*arguments)


def run_guarded[S, T](function: Callable[[S, T], object], shared: S, task: T, threads: int = 1) -> Record | Failure:
    """Return a task's record, or in words why it failed; BLAS keeps to one thread, batches take so many."""
    with threadpool_limits(1), use_threads(threads):
        return run_quietly(function, shared, task)


def run_quietly[S, T](function: Callable[[S, T], object], shared: S, task: T) -> Record | Failure:
    """Return a task's record, or in words why it failed, where BLAS keeps to one thread anyway."""
    try:
        # whatever is not finite is looked for where it matters; numpy's warnings would only litter the terminal
        with np.errstate(all="ignore"), note_losses() as losses:
            return keep_losses(encode(function(shared, task)), losses)
    except InputError as error:
        return InputError, str(error)
    except MemoryError as error:
        return NumericalError, f"too little memory ({error})" if str(error) else "too little memory"
    except (NumericalError, ArithmeticError, ValueError) as error:  # SciPy and LAPACK raise the last two
        return NumericalError, str(error)
