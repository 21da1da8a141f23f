"""Long work in tasks: side by side in processes, each kept as it ends, with the same numbers for any number of them."""

from __future__ import annotations

import os
import re
import zlib
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

import joblib
import numpy as np
from joblib.externals.loky.process_executor import TerminatedWorkerError
from threadpoolctl import threadpool_limits

from bayescal.errors import BayescalError, InputError, NumericalError
from bayescal.experiments.frame.interrupts import follow_parent, shield_children
from bayescal.experiments.frame.progress import Progress
from bayescal.experiments.frame.records import Record, decode, encode
from bayescal.experiments.frame.store import Store

UNFIT = re.compile(r"[^A-Za-z0-9_.+-]+")
"""What no file name should hold."""

type Failure = tuple[type[BayescalError], str]


@dataclass(frozen=True, eq=False)
class Run:
    """A run under way: where its tasks are computed and kept.

    Attributes
    ----------
    workers : int
        Processes side by side.
    store : Store or None
        Keeps finished tasks; None where nothing is kept.
    progress : Progress
    """

    workers: int = 1
    store: Store | None = None
    progress: Progress = field(default_factory=Progress)

    def map[S, T, R](
        self,
        stage: str,
        function: Callable[[S, T], R],
        shared: S,
        tasks: Mapping[str, T],
        returns: Iterable[Any] = (),
    ) -> dict[str, R]:
        """Return what a function makes of every task, by the tasks' names and in their order.

        Parameters
        ----------
        stage : str
            What is done, in a word or two; tasks are kept under it and their names.
        function : callable
            Of a module, for it may run in another process: takes ``shared`` and a task. Its numbers must depend on
            these alone.
        shared : object
            What all tasks need.
        tasks : mapping of str to object
        returns : iterable of type
            Dataclasses that the function's results are made of, beside what `records.encode` takes anyway.

        Raises
        ------
        InputError
            Where a task finds the input at fault.
        NumericalError
            Where tasks fail; all others have been finished and are kept.
        """
        names = {name: f"{_slug(stage)}-{_slug(name)}" for name in tasks}
        classes = tuple(returns)
        found: dict[str, R] = {}
        for name in tasks:
            kept = None if self.store is None else self.store.load_task(names[name])
            if kept is not None:
                try:
                    found[name] = decode(kept, classes)
                except (ValueError, KeyError, TypeError):
                    continue  # of another version, or damaged: computed anew
        missing = {name: task for name, task in tasks.items() if name not in found}
        failures: list[str] = []
        with self.progress.follow(stage, len(tasks), len(found)) as progress:
            for name, outcome in _compute(function, shared, missing, self.workers):
                if isinstance(outcome, tuple):
                    kind, fault = outcome
                    if issubclass(kind, InputError):
                        raise kind(fault)
                    failures.append(f"{name}: {fault}")
                    continue
                if self.store is not None:
                    self.store.save_task(names[name], outcome)
                found[name] = decode(outcome, classes)
                progress.advance(name)
        if failures:
            raise NumericalError("; ".join(failures) + self._say_kept(len(tasks) - len(failures), len(tasks)))
        return {name: found[name] for name in tasks}

    def once[S, R](self, stage: str, function: Callable[[S], R], shared: S, returns: Iterable[Any] = ()) -> R:
        """Return what a function makes of its inputs, as one task."""
        return self.map(stage, _call, (function, shared), {"all": None}, returns)["all"]

    def _say_kept(self, n: int, total: int) -> str:
        return "" if self.store is None else f"; {n} of {total} tasks are kept in {self.store.partial}"


def _call[S, R](both: tuple[Callable[[S], R], S], _: None) -> R:
    function, shared = both
    return function(shared)


def _slug(name: str) -> str:
    """Return a name as a part of a file's name; what is left out comes back as a checksum."""
    plain = UNFIT.sub("-", name)[:80]
    return plain if plain == name else f"{plain}-{zlib.crc32(name.encode()):08x}"


def _compute[S, T](
    function: Callable[[S, T], Any], shared: S, tasks: Mapping[str, T], workers: int
) -> Iterator[tuple[str, Record | Failure]]:
    if workers == 1 or len(tasks) < 2:
        for name, task in tasks.items():
            yield _run_guarded(function, shared, name, task)
        return
    parallel = joblib.Parallel(n_jobs=workers, return_as="generator_unordered", inner_max_num_threads=1)
    with shield_children():
        outcomes = parallel(
            joblib.delayed(_run_in_worker)(os.getpid(), function, shared, name, task) for name, task in tasks.items()
        )
    try:
        yield from outcomes
    except TerminatedWorkerError as error:
        raise NumericalError("a worker was killed, perhaps for want of memory; go on with --resume") from error


def _run_in_worker[S, T](
    parent: int, function: Callable[[S, T], Any], shared: S, name: str, task: T
) -> tuple[str, Record | Failure]:
    follow_parent(parent)
    return _run_guarded(function, shared, name, task)


def _run_guarded[S, T](function: Callable[[S, T], Any], shared: S, name: str, task: T) -> tuple[str, Record | Failure]:
    """Return a task's record, or in words why it failed; BLAS keeps to one thread."""
    try:
        # whatever is not finite is looked for where it matters; numpy's warnings would only litter the terminal
        with threadpool_limits(1), np.errstate(all="ignore"):
            return name, encode(function(shared, task))
    except InputError as error:
        return name, (InputError, str(error))
    except (NumericalError, ArithmeticError, ValueError) as error:  # SciPy and LAPACK raise the last two
        return name, (NumericalError, str(error))
