"""What a run says: how far it is (a bar on a terminal, lines in a pipe), tables as wide as there is room, its verdict.

Tasks that take long say at which stage they are: each writes it to a file of its own, which this process reads. Workers
that share no temporary folder with it say nothing.
"""

from __future__ import annotations

import json
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Literal

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeElapsedColumn
from rich.progress import Progress as Bar
from rich.table import Table
from rich.text import Text

from bayescal.files.plain_text import make_plain
from bayescal.inference.stages import Report, follow
from bayescal.report.blocks import Page, choose_first, count_folded
from bayescal.report.numbers import join_words

EVERY = 15.0  # seconds between two lines in a pipe
REDRAWN = 0.5  # seconds between two looks at what tasks are at, on a terminal
SHOWN = 3  # tasks whose stages are said

UNBOUNDED = 10_000  # letters
ANSWER = ".answer"  # ending of the file of a task's first answer
LOOKED = 0.5  # seconds between two looks for first answers, in a pipe


@dataclass(eq=False)
class TaskWatch:
    """What tasks of some names are at that are under way: a folder that each writes a file to, named by its place."""

    names: tuple[str, ...]
    _folder: TemporaryDirectory[str] = field(
        default_factory=lambda: TemporaryDirectory(prefix="bayescal-", ignore_cleanup_errors=True)
    )
    _answered: set[str] = field(default_factory=set)

    def mark[T](self, tasks: Mapping[str, T]) -> dict[str, tuple[str, T]]:
        """Return tasks that know where to say what they are at."""
        places = {name: str(Path(self._folder.name) / str(k)) for k, name in enumerate(self.names)}
        return {name: (places[name], task) for name, task in tasks.items()}

    def read(self) -> dict[str, Report]:
        """Return what tasks are at, by their names."""
        found = {}
        for path in self._list(""):
            with suppress(OSError, ValueError, TypeError):  # it has just ended, or is just being written
                found[self.names[int(path.name)]] = Report(**json.loads(path.read_text()))
        return found

    def read_answers(self) -> list[str]:
        """Return first answers that were not read before."""
        found = list[str]()
        for path in self._list(ANSWER):
            with suppress(OSError, ValueError):
                if path.stem not in self._answered and (said := path.read_text(encoding="utf-8")).endswith("\n"):
                    self._answered.add(path.stem)
                    found.append(f"first answer, {self.names[int(path.stem)]}: {said.strip()}")
        return found

    def _list(self, ending: str) -> list[Path]:
        there = [path for path in Path(self._folder.name).iterdir() if path.suffix == ending]
        return sorted(there, key=lambda path: path.stem.zfill(9))

    def close(self) -> None:
        """Remove the folder."""
        self._folder.cleanup()


def run_marked[S, T, R](both: tuple[Callable[[S, T], R], S], marked: tuple[str, T]) -> R:
    """Return what a function makes of a task that says meanwhile what it is at."""
    function, shared = both
    path, task = Path(marked[0]), marked[1]

    def tell(report: Report) -> None:
        with suppress(OSError):  # a worker elsewhere, or a run that is over
            path.write_text(json.dumps(asdict(report)))

    def answer(said: str) -> None:
        with suppress(OSError):
            path.with_suffix(ANSWER).write_text(f"{said}\n", encoding="utf-8")

    try:
        with follow(tell, answer):
            return function(shared, task)
    finally:
        path.unlink(missing_ok=True)


class Stage:
    """A stage of a run under way: how many of its tasks are done; of the quiet kind it says nothing."""

    def __init__(self, name: str, total: int, done: int, watch: TaskWatch | None = None) -> None:
        self.name, self.total, self.found, self.done = name, total, done, done
        self.began, self.watch = time.monotonic(), watch

    def read(self) -> dict[str, Report]:
        """Return what tasks under way are at."""
        return {} if self.watch is None else self.watch.read()

    def estimate(self, running: Mapping[str, Report]) -> tuple[float, float | None]:
        """Return how many tasks are done, parts of them too, and the seconds left; None where nothing tells."""
        parts = [one.spent / (one.spent + one.left) for one in running.values() if one.left is not None and one.spent]
        done, spent = min(self.total, self.done + sum(parts)), time.monotonic() - self.began
        fresh = done - self.found
        return done, spent / fresh * (self.total - done) if fresh > 0 and self.done < self.total else None

    def describe(self) -> str:
        """Return how far the stage is, in one line."""
        running = self.read()
        _, left = self.estimate(running)
        text = f"{self.name}: {self.done} of {self.total} done, {time.monotonic() - self.began:.0f} s"
        text += "" if left is None else f", about {left:.0f} s left"
        return "; ".join([text, *describe_tasks(running)])


def describe_tasks(running: Mapping[str, Report]) -> list[str]:
    """Return what tasks are at, some of them if they are many."""
    said = [
        f"{name}: {one.stage}" + ("" if one.share is None else f" {100.0 * one.share:.0f} %")
        for name, one in running.items()
    ]
    return said if len(said) <= SHOWN else [*said[:SHOWN], f"{len(said) - SHOWN} more"]


class PlainConsole(Console):
    """A console that prints texts as they are, whoever wrote them: no markup, and nothing that commands a terminal."""

    def __init__(self, **options: Any) -> None:
        super().__init__(highlight=False, markup=False, emoji=False, **options)

    def render_str(self, text: str, **options: Any) -> Text:
        """Return what is shown of a text that is printed, or stands in a table."""
        return super().render_str(make_plain(text, but="\n\t"), **options)


class Progress:
    """What a run says of its progress on standard error."""

    def __init__(self, quiet: bool = True) -> None:
        self.quiet = quiet
        self.console = PlainConsole(stderr=True)

    def watch(self, names: tuple[str, ...]) -> TaskWatch | None:
        """Return what follows tasks; None where nothing is to be said of them."""
        return None if self.quiet or not names else TaskWatch(names)

    def say(self, line: str) -> None:
        """Print a line, unless it is empty or nothing is to be said."""
        if line and not self.quiet:
            print(make_plain(line), file=self.console.file, flush=True)

    @contextmanager
    def follow(self, name: str, total: int, done: int, watch: TaskWatch | None = None) -> Iterator[Stage]:
        """Follow a stage of so many tasks, some of them done before."""
        stage = Stage(name, total, done, watch)
        if self.quiet:
            yield stage
        elif self.console.is_terminal:
            with self._draw(stage):
                yield stage
        else:
            said = time.monotonic()

            def look() -> None:
                nonlocal said
                self._say_answers(stage)
                if time.monotonic() - said >= EVERY:
                    said = time.monotonic()
                    self.say(stage.describe())

            with _repeat(look, min(LOOKED, EVERY)):
                yield stage
            self._say_answers(stage)
            self.say(stage.describe())

    def _say_answers(self, stage: Stage) -> None:
        for said in [] if stage.watch is None else stage.watch.read_answers():
            self.say(said)

    @contextmanager
    def _draw(self, stage: Stage) -> Iterator[None]:
        description = TextColumn("{task.description}", markup=False)
        columns = (description, BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
        with Bar(*columns, TextColumn("{task.fields[left]}"), console=self.console, transient=True) as bar:
            line = bar.add_task(make_plain(stage.name), total=stage.total, completed=stage.done, left="")

            def draw() -> None:
                running = stage.read()
                done, left = stage.estimate(running)
                text = "  ".join([stage.name, *describe_tasks(running)])
                said = "" if left is None else f"about {left:.0f} s left"
                bar.update(line, completed=done, description=make_plain(text), left=said)
                for answer in [] if stage.watch is None else stage.watch.read_answers():
                    bar.console.print(answer)

            with _repeat(draw, REDRAWN):
                yield


@contextmanager
def _repeat(call: Callable[[], None], every: float) -> Iterator[None]:
    """Call something again and again meanwhile."""
    ended = threading.Event()

    def loop() -> None:
        while not ended.wait(every):
            call()

    thread = threading.Thread(target=loop, daemon=True)
    thread.start()
    try:
        yield
    finally:
        ended.set()
        thread.join()


@dataclass(frozen=True)
class TerminalColumn:
    """A column of a table on a terminal; those of the largest rank are left out first, those of rank zero never."""

    title: str
    rank: int = 0
    justify: Literal["left", "right"] = "right"


def print_table(
    console: Console, columns: Sequence[TerminalColumn], rows: Sequence[Sequence[str]], width: int = 0
) -> None:
    """Print a table with the columns that have room, and say which have none; ``width`` in letters."""
    room, kept = width or console.width, list(range(len(columns)))

    def build() -> Table:
        table = Table()
        for k in kept:
            table.add_column(columns[k].title, justify=columns[k].justify, overflow="fold")
        for row in rows:
            table.add_row(*(row[k] for k in kept))
        return table

    unbounded = console.options.update(max_width=UNBOUNDED)
    while console.measure(build(), options=unbounded).maximum > room and any(columns[k].rank for k in kept):
        kept.remove(max(kept, key=lambda k: (columns[k].rank, k)))
    console.print(build(), width=room)
    left = [column.title for k, column in enumerate(columns) if k not in kept]
    if left:
        console.print(f"Hidden columns: {join_words(left)} (in the report)", width=room)


def print_text(console: Console, text: str) -> None:
    """Print a sentence, broken between words on a terminal and on one line in a file."""
    console.print(text, soft_wrap=not console.is_terminal)


def show_verdict(page: Page, console: Console) -> None:
    """Print a page's headline and what of its verdict is seen at first sight."""
    print_text(console, page.headline)
    seen, folded = choose_first(page)
    for one in seen:
        print_text(console, f"{one.lead}: {one.said}" if one.lead else one.said)
    if folded:
        print_text(console, count_folded(folded))
