"""How far a run is: a bar with the time left on a terminal, lines in a pipe, nothing where it is to be quiet."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeElapsedColumn, TimeRemainingColumn
from rich.progress import Progress as Bar

EVERY = 15.0  # seconds between two lines in a pipe


class Stage:
    """A stage of a run under way: how many of its tasks are done; of the quiet kind it says nothing."""

    def __init__(self, name: str, total: int, done: int) -> None:
        self.name, self.total, self.done = name, total, done
        self.found = done
        self.began = time.monotonic()

    def advance(self, what: str = "") -> None:
        """Count a task as done."""
        del what
        self.done += 1

    def describe(self) -> str:
        """Return how far the stage is, in one line."""
        spent = time.monotonic() - self.began
        text = f"{self.name}: {self.done} of {self.total} done, {spent:.0f} s"
        fresh = self.done - self.found
        if fresh > 0 and self.done < self.total:
            text += f", about {spent / fresh * (self.total - self.done):.0f} s left"
        return text


class Progress:
    """What a run says of its progress on standard error."""

    def __init__(self, quiet: bool = True) -> None:
        self.quiet = quiet
        self.console = Console(stderr=True)

    @contextmanager
    def follow(self, name: str, total: int, done: int) -> Iterator[Stage]:
        """Follow a stage of so many tasks, some of them done before."""
        stage = Stage(name, total, done)
        if self.quiet:
            yield stage
        elif self.console.is_terminal:
            with self._draw(stage):
                yield stage
        else:
            with self._print(stage):
                yield stage

    @contextmanager
    def _draw(self, stage: Stage) -> Iterator[None]:
        columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
        with Bar(*columns, TextColumn("left"), TimeRemainingColumn(), console=self.console, transient=True) as bar:
            line = bar.add_task(stage.name, total=stage.total, completed=stage.done)
            count = stage.advance

            def advance(what: str = "") -> None:
                count()
                bar.update(line, completed=stage.done, description=f"{stage.name} {what}".rstrip())

            stage.advance = advance  # type: ignore[method-assign]  # the bar follows the count
            yield

    @contextmanager
    def _print(self, stage: Stage) -> Iterator[None]:
        ended = threading.Event()

        def tell() -> None:
            while not ended.wait(EVERY):
                self._say(stage.describe())

        thread = threading.Thread(target=tell, daemon=True)
        thread.start()
        try:
            yield
        finally:
            ended.set()
            thread.join()
        self._say(stage.describe())

    def _say(self, line: str) -> None:
        print(line, file=self.console.file, flush=True)
