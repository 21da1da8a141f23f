"""Long work in tasks: side by side in processes, each kept as it ends, with the same numbers for any number of them."""

from __future__ import annotations

import re
import zlib
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import closing, nullcontext
from dataclasses import dataclass, field
from itertools import chain, islice
from typing import Any

from bayescal.errors import InputError, NumericalError
from bayescal.experiments.runner.engine import Engine, Processes
from bayescal.experiments.runner.losses import Loss, attempt, note
from bayescal.experiments.runner.records import decode, read_losses
from bayescal.experiments.runner.store import Store
from bayescal.experiments.runner.terminal import Progress, TaskWatch, run_marked

UNFIT = re.compile(r"[^A-Za-z0-9_.+-]+")
"""What no file name should hold."""
SAID = 12  # failures of a stage in its message


@dataclass(frozen=True)
class Failed:
    """What became of a task that failed: why, in words."""

    reason: str


@dataclass(frozen=True, eq=False)
class Run:
    """A run under way: the engine that computes its tasks, and the store that keeps finished ones, if one does."""

    engine: Engine = field(default_factory=Processes)
    store: Store | None = None
    progress: Progress = field(default_factory=Progress)
    losses: list[Loss] = field(default_factory=list)  # what its tasks could not compute

    def _note(self, losses: Iterable[Loss]) -> None:
        for one in losses:
            note(one)  # whoever runs this as a task of its own
            if one not in self.losses:
                self.losses.append(one)

    def map[S, T, R](
        self,
        stage: str,
        function: Callable[[S, T], R],
        shared: S,
        tasks: Mapping[str, T],
        returns: Iterable[type] = (),
        spare: bool = False,
    ) -> dict[str, R]:
        """Return what a function makes of every task, by the tasks' names and in their order.

        Parameters
        ----------
        stage : str
            What is done, in a word or two; tasks are kept under it and their names.
        function : callable
            Of a module, for it may run in another process: takes ``shared``, what all tasks need, and a task. Its
            numbers must depend on these alone.
        returns : iterable of type
            Dataclasses that the function's results are made of, beside what `records.encode` takes anyway.
        spare : bool
            Whether results can do without some of the tasks: one that fails is left out and noted as lost.

        Raises
        ------
        InputError
            Where a task finds the input at fault.
        NumericalError
            Where tasks fail, or all of those that can be spared; all others have been finished and are kept.
        """
        return self.begin(stage, function, shared, tasks, returns, spare)()

    def begin[S, T, R](
        self,
        stage: str,
        function: Callable[[S, T], R],
        shared: S,
        tasks: Mapping[str, T],
        returns: Iterable[type] = (),
        spare: bool = False,
    ) -> Callable[[], dict[str, R]]:
        """Begin what `map` does and return what waits for it: this process may do something else meanwhile.

        Workers compute at once; without any this process does when it waits. Finished tasks are kept from then on.
        Parameters are those of `map`.
        """
        names, classes = _name_files(stage, tasks), tuple(returns)
        kept = dict(self._read_kept(names, classes))
        missing = {name: task for name, task in tasks.items() if name not in kept}
        if spare:
            named = {name: (f"{stage} of {name!r}", task) for name, task in missing.items()}
            outcomes, watch = self._compute(_spare, (function, shared), named)
        else:
            outcomes, watch = self._compute(function, shared, missing)

        def wait() -> dict[str, R]:
            fresh = self._follow(stage, names, len(kept), outcomes, classes, watch)
            found = dict(chain(kept.items(), fresh))
            failures = {name: one.reason for name, one in found.items() if isinstance(one, Failed)}
            if failures:
                said = "; ".join(f"{name}: {fault}" for name, fault in islice(failures.items(), SAID))
                said += f"; and {len(failures) - SAID} more" if len(failures) > SAID else ""
                if self.store is not None:
                    said += f"; {len(found) - len(failures)} of {len(tasks)} tasks are kept in {self.store.partial}"
                raise NumericalError(said)
            if spare and tasks and all(one is None for one in found.values()):
                raise NumericalError("; ".join(one.say() for one in self.losses))
            return {name: found[name] for name in tasks if not (spare and found[name] is None)}

        return wait

    def stream[S, T, R](
        self,
        stage: str,
        function: Callable[[S, T], R],
        shared: S,
        tasks: Mapping[str, T],
        returns: Iterable[type] = (),
    ) -> Iterator[tuple[str, R | Failed]]:
        """Yield what tasks give, or why they failed: kept ones first, others as they end; none of it is held here.

        For stages of more results than there is memory for; faults of input are raised. Parameters are those of `map`.
        """
        names, classes, missing = _name_files(stage, tasks), tuple(returns), dict(tasks)
        for name, result in self._read_kept(names, classes):
            del missing[name]
            yield name, result
        outcomes, watch = self._compute(function, shared, missing)
        yield from self._follow(stage, names, len(tasks) - len(missing), outcomes, classes, watch)

    def _compute[S, T](
        self, function: Callable[[S, T], object], shared: S, tasks: Mapping[str, T]
    ) -> tuple[Iterable[Any], TaskWatch | None]:
        """Return what tasks end with, as they end, and what follows them meanwhile."""
        watch = self.progress.watch(tuple(tasks))
        if watch is None:
            return self.engine.compute(function, shared, tasks), None
        return self.engine.compute(run_marked, (function, shared), watch.mark(tasks)), watch

    def _read_kept(self, names: Mapping[str, str], classes: tuple[type, ...]) -> Iterator[tuple[str, Any]]:
        """Yield the results of tasks that were finished before."""
        for name, file in names.items():
            kept = None if self.store is None else self.store.load_task(file)
            if kept is not None:
                try:
                    result, losses = decode(kept, classes), read_losses(kept)
                except (ValueError, KeyError, TypeError):
                    continue  # of another version, or damaged: computed again
                self._note(losses)
                yield name, result

    def _follow(
        self,
        stage: str,
        names: Mapping[str, str],
        done: int,
        outcomes: Iterable[Any],
        classes: tuple[type, ...],
        watch: TaskWatch | None,
    ) -> Iterator[tuple[str, Any]]:
        """Yield what tasks end with, each kept before."""
        with (
            nullcontext() if watch is None else closing(watch),
            self.progress.follow(stage, len(names), done, watch) as progress,
        ):
            for name, outcome in outcomes:
                if isinstance(outcome, tuple):
                    kind, fault = outcome
                    if issubclass(kind, InputError):
                        raise kind(fault)
                    yield name, Failed(fault)
                    continue
                if self.store is not None:
                    self.store.save_task(names[name], outcome)
                result = decode(outcome, classes)
                self._note(read_losses(outcome))
                progress.done += 1
                yield name, result

    def once[S, R](self, stage: str, function: Callable[[S], R], shared: S, returns: Iterable[type] = ()) -> R:
        """Return what a function makes of its inputs, as one task."""
        return self.map(stage, _call, (function, shared), {"all": None}, returns)["all"]


def _name_files(stage: str, tasks: Iterable[str]) -> dict[str, str]:
    return {name: f"{_slug(stage)}-{_slug(name)}" for name in tasks}


def _spare[S, T, R](both: tuple[Callable[[S, T], R], S], named: tuple[str, T]) -> R | None:
    """Return what a function makes of a task; None where it fails, which is noted."""
    (function, shared), (name, task) = both, named
    return attempt(name, lambda: function(shared, task), None)


def _call[S, R](both: tuple[Callable[[S], R], S], _: None) -> R:
    function, shared = both
    return function(shared)


def _slug(name: str) -> str:
    """Return a name as a part of a file's name; what is left out comes back as a checksum."""
    plain = UNFIT.sub("-", name)[:80]
    return plain if plain == name else f"{plain}-{zlib.crc32(name.encode()):08x}"
