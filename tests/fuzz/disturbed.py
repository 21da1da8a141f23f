"""Runs of every kind that are killed, meet each other, or find the disk full, in processes forked from this one.

Each run happens once undisturbed, which counts its writes. Then it is killed before a write of its tasks, of its
results, or of its end, and taken up; it has no room, by a limit on how large files may be and by a small file system;
or a second run of another seed meets it. In the end the results must be those of the undisturbed run, byte for byte but
for times, and nothing may be left beside them. What stands in the results directory meanwhile is whole.
"""

from __future__ import annotations

import ctypes
import json
import os
import re
import resource
import shutil
import signal
import sys
import tempfile
import time
import traceback
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from bayescal import cli
from bayescal.errors import InputError
from bayescal.experiments.runner.results import PROVENANCE_FILE, check_results
from bayescal.files.manifest import MANIFEST, add_others

SIGNALS = (signal.SIGKILL, signal.SIGTERM, signal.SIGINT)
TIMED = re.compile(rb'^ *"(wall_)?(seconds|time|started|finished)[a-z_]*": .*$', re.MULTILINE)
CODES = {0, 2, 3, 130, -signal.SIGKILL, -signal.SIGTERM}  # the last before the program listens for it
WRITES = {"os.rename", "os.remove", "os.mkdir", "os.rmdir", "shutil.rmtree", "os.truncate"}
"""Events of Python beside `open` that change what is on a disk."""
PATIENCE = 600  # s
TRIES = 5
MINE = "notes of somebody's own.txt"


def die_with_parent() -> None:
    """Be killed when the process that forked this one ends: pipes of its pool are open here, too, and hide its end."""
    with suppress(AttributeError):  # a system that has no such call
        ctypes.CDLL(None).prctl(1, signal.SIGKILL)  # PR_SET_PDEATHSIG


class Child:
    """The command line in a process of its own, forked from this one, which has imported everything once.

    Parameters
    ----------
    line : list of str
        Its arguments.
    prepare : callable
        Called in the process before anything else.

    Attributes
    ----------
    code : int or None
        Its exit code; None as long as it runs.
    text : str
        What it said on standard error, once it has ended.
    """

    def __init__(self, line: list[str], prepare: Callable[[], None] = lambda: None) -> None:
        self.code: int | None = None
        self.text = ""
        self.said = tempfile.TemporaryFile("w+")  # noqa: SIM115  # open as long as the child may speak
        self.pid = os.fork()
        if self.pid == 0:
            self._run(line, prepare)

    def _run(self, line: list[str], prepare: Callable[[], None]) -> None:
        """Be the child: never return."""
        code = 99
        try:
            die_with_parent()
            os.dup2(self.said.fileno(), 2)
            os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
            signal.signal(signal.SIGINT, signal.default_int_handler)
            signal.signal(signal.SIGALRM, signal.SIG_DFL)
            sys.stderr = os.fdopen(2, "w")
            prepare()
            sys.argv = ["bayescal", *line]
            cli.main()
        except SystemExit as error:
            code = error.code if isinstance(error.code, int) else 99
        except BaseException:  # what a user would see as a traceback
            traceback.print_exc()
        finally:
            sys.stderr.flush()
            os._exit(code)

    def wait(self, seconds: float, stopped: bool = False) -> bool:
        """Wait until it has ended, or as long, or until it has stopped itself; return whether it has ended."""
        end = time.monotonic() + seconds
        while self.code is None:
            pid, status = os.waitpid(self.pid, os.WNOHANG | (os.WUNTRACED if stopped else 0))
            if pid and os.WIFSTOPPED(status):
                return False
            if pid:
                self.code = os.waitstatus_to_exitcode(status)
                self.said.seek(0)
                self.text = self.said.read()
                self.said.close()
            elif time.monotonic() > end:
                return False
            else:
                time.sleep(0.005)
        return True


def watch_writes(folder: Path, act: Callable[[int], None]) -> None:
    """Call a function with the number of each write below a folder, counted from one, before it happens."""
    count, below = 0, os.fspath(folder)

    def hear(event: str, arguments: tuple[object, ...]) -> None:
        nonlocal count
        if event == "open":
            path, mode, flags = arguments
            writes = mode is None or (isinstance(mode, str) and bool(set(mode) & set("wxa+")))
            writes = writes and isinstance(flags, int) and bool(flags & (os.O_WRONLY | os.O_RDWR))
        else:
            path, writes = (arguments or (None,))[0], event in WRITES
        if writes and isinstance(path, str | os.PathLike) and os.fspath(path).startswith(below):
            count += 1
            act(count)

    sys.addaudithook(hear)


@dataclass(frozen=True)
class Stage:
    """An experiment and an empty folder, in which its results are to be.

    Attributes
    ----------
    config : Path
    seed : int
    folder : Path
    """

    config: Path
    seed: int
    folder: Path

    @property
    def out(self) -> Path:
        """The results directory."""
        return self.folder / "results" / "out"

    @property
    def name(self) -> str:
        """What it is, in words."""
        return f"{self.config.parent.name}/{self.config.name} {self.seed}"

    def start(self, *more: str, seed: int | None = None, prepare: Callable[[], None] = lambda: None) -> Child:
        """Start a run."""
        seed = self.seed if seed is None else seed
        line = ["run", str(self.config), "--out", str(self.out), "--seed", str(seed), "--quiet", "--workers", "1"]
        return Child([*line, *more], prepare)

    def take_up(self) -> Child:
        """Take a run up, or start it where there is none."""
        begun = (self.out.with_name("out.partial") / "identity.json").is_file()
        return self.start(*(["--resume"] if begun else []))

    def find_faults(self, child: Child, *expected: int) -> list[str]:
        """Wait for a run; return what is at fault with how it ended, and with the results that stand there."""
        if not child.wait(PATIENCE):
            os.kill(child.pid, signal.SIGKILL)
            child.wait(PATIENCE)
            return [f"no end within {PATIENCE} s"]
        said, code = child.text, child.code
        assert code is not None
        faults = []
        if "Traceback" in said or cli.OWN_FAULT in said or said.count("\n") > 1 or code not in (expected or CODES):
            faults.append(f"code {code}, {said[-600:]!r}")
        if (self.out / PROVENANCE_FILE).is_file():
            try:
                check_results(self.out)
            except InputError as error:
                faults.append(f"results are there and not whole: {error}")
        elif self.out.exists():
            faults.append("half of the results are there")
        return faults

    def finish(self) -> list[str]:
        """Take a run up until it ends; return what is at fault."""
        for _ in range(TRIES):
            child = self.take_up()
            faults = self.find_faults(child)
            if faults or child.code in (0, 3):
                return faults
        return [f"not finished after {TRIES} runs"]


@dataclass(frozen=True)
class Undisturbed:
    """What a run left that nobody disturbed: its files, its seconds, and what its writes were for, one by one."""

    files: dict[str, bytes]
    seconds: float
    phases: tuple[str, ...]

    def choose(self, phase: str, rng: np.random.Generator) -> int:
        """Return the number of a write of a phase, counted from one."""
        return int(rng.choice(np.flatnonzero(np.array(self.phases) == phase))) + 1


PHASES = ("running", "writing", "ending")


def run_undisturbed(stage: Stage) -> tuple[Undisturbed, list[str]]:
    """Run an experiment; return what it left, and faults."""
    log = stage.folder / "writes.txt"
    partial, done = stage.out.with_name("out.partial"), stage.out.with_name("out.partial") / "results" / MANIFEST

    def prepare() -> None:
        file = os.open(log, os.O_WRONLY | os.O_CREAT | os.O_APPEND)

        def note(_: int) -> None:
            phase = "writing" if (partial / "results").exists() else "running"
            os.write(file, f"{'ending' if done.exists() or stage.out.exists() else phase}\n".encode())

        watch_writes(stage.folder / "results", note)

    begun = time.monotonic()
    faults = stage.find_faults(stage.start(prepare=prepare), 0, 3)
    seconds, phases = time.monotonic() - begun, tuple(log.read_text().split())
    files = read(stage.out)
    faults += [f"no writes while {phase}" for phase in PHASES if phase not in phases]
    return Undisturbed(files, seconds, phases), faults


def read(out: Path) -> dict[str, bytes]:
    """Return the files of a results directory, without times; binary files and the manifest count by their names."""
    found = {}
    for path in sorted(out.rglob("*")):
        if path.is_file() and path.name not in (MANIFEST, MINE):
            plain = path.suffix in (".csv", ".json", ".toml")
            found[str(path.relative_to(out))] = TIMED.sub(b"", path.read_bytes()) if plain else b""
    return {name: content for name, content in found.items() if "timing" not in name}


def kill(stage: Stage, quiet: Undisturbed, rng: np.random.Generator, phase: str, again: bool) -> list[str]:
    """Kill a run before one of its writes, and take it up until it ends; ``again``: where results stand already."""
    if again:
        faults = stage.find_faults(stage.start(), 0, 3)
        (stage.out / MINE).write_text("mine")
        add_others(stage.out, [MINE])
        if faults:
            return faults
    number, which = SIGNALS[rng.integers(len(SIGNALS))], quiet.choose(phase, rng)

    def prepare() -> None:
        watch_writes(stage.folder / "results", lambda n: os.kill(os.getpid(), number) if n == which else None)

    faults = stage.find_faults(stage.start(prepare=prepare)) or stage.finish()
    if again and not faults and not (stage.out / MINE).is_file():
        faults.append("a file of somebody's own is lost")
    return faults


def limit_files(stage: Stage, quiet: Undisturbed, rng: np.random.Generator) -> list[str]:
    """Run with a limit on the size of files, then without."""
    largest = int(10 ** rng.uniform(2.0, 0.3 + np.log10(max(map(len, quiet.files.values()), default=100) + 100)))

    def prepare() -> None:
        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
        resource.setrlimit(resource.RLIMIT_FSIZE, (largest, largest))

    return _end_without_room(stage, stage.start(prepare=prepare))


def _end_without_room(stage: Stage, child: Child, make_room: Callable[[], None] = lambda: None) -> list[str]:
    faults = stage.find_faults(child)
    if child.code == 3 and not stage.out.exists() and "expected room to write" not in child.text:
        faults.append(f"{child.text!r}")
    if stage.out.exists() and child.code not in (0, 3):
        faults.append(f"results are there with code {child.code}")
    make_room()
    return faults or ([] if stage.out.exists() else stage.finish())


def fill_disk(stage: Stage, quiet: Undisturbed, rng: np.random.Generator) -> list[str]:
    """Run on a file system that has room for part of what is written, then on one that has enough.

    It is mounted in a name space of a process of its own, and gone with it: what is found is sent back.
    """
    whole = sum(map(len, quiet.files.values())) + 4096 * len(quiet.phases)
    room = max(65536 * 2, int(whole * rng.uniform(0.1, 0.8)))
    reading, writing = os.pipe()
    pid = os.fork()
    if pid == 0:
        found = ["the process that mounts a file system failed"]
        try:
            die_with_parent()
            mount_small(stage.out.parent, room)
            found = _end_without_room(stage, stage.start(), lambda: mount_small(stage.out.parent, 2**30, again=True))
            found += compare(stage, quiet)
        except OSError as error:
            found = [f"{NOT_POSSIBLE}: {error}"]
        except BaseException:
            found = [traceback.format_exc(limit=-3)]
        finally:
            os.write(writing, json.dumps(found).encode()[:60_000])
            os._exit(0)
    os.close(writing)
    with os.fdopen(reading) as pipe:
        faults: list[str] = json.loads(pipe.read())
    os.waitpid(pid, 0)
    return faults


NOT_POSSIBLE = "no file system can be mounted here"


def mount_small(folder: Path, size: int, again: bool = False) -> None:
    """Mount a file system of so many bytes for this process and those that it starts; OSError where nobody may."""
    libc, remount, private = ctypes.CDLL(None, use_errno=True), 32, 0x44000  # MS_REMOUNT; MS_REC | MS_PRIVATE
    folder.mkdir(parents=True, exist_ok=True)
    if not again:
        user, group = os.getuid(), os.getgid()
        os.unshare(os.CLONE_NEWUSER | os.CLONE_NEWNS)
        Path("/proc/self/setgroups").write_text("deny")
        Path("/proc/self/uid_map").write_text(f"{user} {user} 1")
        Path("/proc/self/gid_map").write_text(f"{group} {group} 1")
        if libc.mount(None, b"/", None, private, None):
            raise OSError(ctypes.get_errno(), "mount")
    options = f"size={size}".encode()
    if libc.mount(b"tmpfs", os.fsencode(folder), b"tmpfs", remount if again else 0, options):
        raise OSError(ctypes.get_errno(), "mount")


def meet(stage: Stage, quiet: Undisturbed, rng: np.random.Generator) -> list[str]:
    """Let a second run of another seed begin and end while the first stops before one of its writes; one is refused."""
    which = quiet.choose(PHASES[rng.integers(len(PHASES))], rng)

    def prepare() -> None:
        stop = signal.SIGSTOP
        watch_writes(stage.folder / "results", lambda n: os.kill(os.getpid(), stop) if n == which else None)

    first = stage.start(prepare=prepare)
    first.wait(PATIENCE, stopped=True)
    second = stage.start(seed=stage.seed + 1)
    faults = stage.find_faults(second)
    os.kill(first.pid, signal.SIGCONT)
    faults += stage.find_faults(first)
    refused = [one.text for one in (first, second) if one.code == 2]
    if len(refused) != 1 or not any(why in refused[0] for why in ("another run", "of another config")):
        faults.append(f"codes {first.code} and {second.code}, expected one refused: {refused}")
    if stage.out.is_dir() and json.loads((stage.out / PROVENANCE_FILE).read_text())["seed"] != stage.seed:
        shutil.rmtree(stage.out)  # the second was first, and the first was refused
        faults += stage.find_faults(stage.start(), 0, 3)
    return faults


def compare(stage: Stage, quiet: Undisturbed) -> list[str]:
    """Return how results differ from those of the undisturbed run, and what is left beside them."""
    if not stage.out.is_dir():
        return ["results lost"]
    there, faults = read(stage.out), []
    if there != quiet.files:
        names = [name for name in sorted({*there, *quiet.files}) if there.get(name) != quiet.files.get(name)]
        faults.append(f"differs in {', '.join(names[:5])}")
    left = [path.name for path in stage.out.parent.iterdir() if path.name.startswith("out.")]
    return [*faults, *([f"left {', '.join(left)}"] if left else [])]


DISTURBANCES: dict[str, Callable[[Stage, Undisturbed, np.random.Generator], list[str]]] = {
    **{
        f"killed while {phase}{', over older results' if again else ''}": (
            lambda stage, quiet, rng, phase=phase, again=again: kill(stage, quiet, rng, phase, again)
        )
        for phase in PHASES
        for again in (False, True)
        if phase == "ending" or not again
    },
    "no room by ulimit": limit_files,
    "no room by a quota": fill_disk,
    "two runs on one --out": meet,
}


def disturb(stage: Stage, quiet: Undisturbed, how: str, rng: np.random.Generator) -> list[str]:
    """Disturb a run, let it end, and return what is at fault with it and with its results."""
    faults = DISTURBANCES[how](stage, quiet, rng)
    if not faults and how != "no room by a quota":  # compared where it was mounted
        faults = compare(stage, quiet)
    return faults
