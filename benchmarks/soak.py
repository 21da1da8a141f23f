"""Random studies, kills, full disks and runs that meet: whether anything is lost, or comes out different.

    python benchmarks/soak.py --minutes 60

Every round takes one of a few tiny experiments with a seed, runs it undisturbed once, and then again under a
disturbance drawn at random: killed (SIGKILL, SIGTERM, SIGINT) at random moments and taken up with --resume until it
ends; with a limit on how large files may be, as on a full disk, and taken up without; two runs at once on one results
directory. In the end the results must be those of the undisturbed run, byte for byte but for times, and nothing may be
left beside them. What runs is the command line, in processes forked from this one.
"""

from __future__ import annotations

import argparse
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
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT / "tests"))

from fuzz.subjects import write_subjects  # noqa: E402  # beside the tests

from bayescal import cli  # noqa: E402
from bayescal.experiments.frame.load import load  # noqa: E402
from bayescal.report import page  # noqa: E402
from bayescal.report.pictures import Picture  # noqa: E402

EXPERIMENTS = (
    "rr8096/figure5.toml",
    "yu2023/figure10.toml",
    "sika2008/calibrations.toml",
    "yu2023/table8.toml",
    "audit/m2_hexapod_tracker.toml",
    "own_machine/study.toml",
)
SIGNALS = (signal.SIGKILL, signal.SIGTERM, signal.SIGINT)
TIMED = re.compile(rb'^ *"(wall_)?(seconds|time|started|finished)[a-z_]*": .*$', re.MULTILINE)
CODES = {0, 2, 3, 130, -signal.SIGKILL, -signal.SIGTERM}  # the last before the program listens for it
WORKERS = "1"
KILLS = 6  # of one run, at most
PATIENCE = 600  # s
TRIES = 40


@dataclass
class Tally:
    """What was done and what went wrong."""

    done: Counter[str] = field(default_factory=Counter)
    faults: list[str] = field(default_factory=list)

    def blame(self, what: str) -> None:
        """Keep a fault, and say it."""
        self.faults.append(what)
        print(f"FAULT {what}", flush=True)


class Child:
    """The command line in a process of its own, forked from this one, which has imported everything once.

    Parameters
    ----------
    line : list of str
        Its arguments.
    largest : int, optional
        Limit on the size of its files, in bytes.
    """

    def __init__(self, line: list[str], largest: int | None = None) -> None:
        self.said = tempfile.TemporaryFile("w+")  # noqa: SIM115  # open as long as the child may speak
        self.code: int | None = None
        self.pid = os.fork()
        if self.pid == 0:
            self._run(line, largest)

    def _run(self, line: list[str], largest: int | None) -> None:
        """Be the child: never return."""
        code = 99
        try:
            os.dup2(self.said.fileno(), 2)
            os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
            signal.signal(signal.SIGINT, signal.default_int_handler)
            if largest is not None:
                signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
                resource.setrlimit(resource.RLIMIT_FSIZE, (largest, largest))
            sys.argv = ["bayescal", *line]
            cli.main()
        except SystemExit as error:
            code = error.code if isinstance(error.code, int) else 99
        except BaseException:  # what a user would see as a traceback
            traceback.print_exc()
        finally:
            sys.stderr.flush()
            os._exit(code)

    def wait(self, seconds: float) -> bool:
        """Wait until it has ended, or as long; return whether it has."""
        end = time.monotonic() + seconds
        while self.code is None:
            pid, status = os.waitpid(self.pid, os.WNOHANG)
            if pid:
                self.code = os.waitstatus_to_exitcode(status)
            elif time.monotonic() > end:
                return False
            else:
                time.sleep(0.005)
        return True

    def kill(self, number: int) -> None:
        """Send it a signal."""
        os.kill(self.pid, number)

    def read(self) -> str:
        """Return what it said on standard error."""
        self.said.seek(0)
        return self.said.read()


def start(config: Path, out: Path, seed: int, *more: str, largest: int | None = None) -> Child:
    """Start a run."""
    line = ["run", str(config), "--out", str(out), "--seed", str(seed), "--quiet", "--workers", WORKERS]
    return Child([*line, *more], largest)


def finish(child: Child, tally: Tally, what: str) -> int:
    """Wait for a run; return its code. More than one line of complaint, or another code than expected, is a fault."""
    if not child.wait(PATIENCE):
        child.kill(signal.SIGKILL)
        child.wait(PATIENCE)
        tally.blame(f"{what}: no end within {PATIENCE} s")
    said, code = child.read(), child.code
    assert code is not None
    if "Traceback" in said or cli.OWN_FAULT in said or said.count("\n") > 1 or code not in CODES:
        tally.blame(f"{what}: code {code}, {said[-400:]!r}")
    return code


def read(out: Path) -> dict[str, bytes]:
    """Return the files of a results directory, without times; pictures and binary files count by their names."""
    found = {}
    for path in sorted(out.rglob("*")):
        if path.is_file():
            plain = path.suffix in (".csv", ".json", ".toml")
            found[str(path.relative_to(out))] = TIMED.sub(b"", path.read_bytes()) if plain else b""
    return {name: content for name, content in found.items() if "timing" not in name}


def is_begun(out: Path) -> bool:
    """Whether there is a run to take up."""
    return (out.with_name(out.name + ".partial") / "identity.json").is_file()


def resume_or_start(config: Path, out: Path, seed: int) -> Child:
    """Take a run up, or start it."""
    return start(config, out, seed, *(["--resume"] if is_begun(out) else []))


def kill_again_and_again(
    config: Path, out: Path, seed: int, rng: np.random.Generator, tally: Tally, whole: float
) -> None:
    """Run and kill at random moments, and take up until it ends."""
    for attempt in range(TRIES):
        child = resume_or_start(config, out, seed) if attempt else start(config, out, seed)
        if attempt < KILLS and not child.wait(float(rng.uniform(0.0, 0.7 * whole))):
            child.kill(SIGNALS[rng.integers(len(SIGNALS))])
            tally.done["kills"] += 1
        if finish(child, tally, f"killed {config.name} {seed}") in (0, 3):
            return
    tally.blame(f"killed {config.name} {seed}: not finished after {TRIES} runs")


def fill_the_disk(config: Path, out: Path, seed: int, rng: np.random.Generator, tally: Tally, whole: float) -> None:
    """Run with a limit on the size of files, then without."""
    del whole
    child = start(config, out, seed, largest=int(10 ** rng.uniform(2.0, 5.0)))
    code = finish(child, tally, f"full disk {config.name} {seed}")
    tally.done["full disks"] += 1
    if code == 0:
        return
    if code == 3 and "expected room to write" not in child.read():
        tally.blame(f"full disk {config.name} {seed}: {child.read()!r}")
    if out.exists():
        tally.blame(f"full disk {config.name} {seed}: results are there with code {code}")
    finish(resume_or_start(config, out, seed), tally, f"after it {config.name} {seed}")


def meet(config: Path, out: Path, seed: int, rng: np.random.Generator, tally: Tally, whole: float) -> None:
    """Start a second run of another seed on the same directory: one of the two is refused, or comes later."""
    first = start(config, out, seed)
    first.wait(float(rng.uniform(0.0, whole)))
    second = start(config, out, seed + 1)
    codes = [finish(one, tally, f"together {config.name} {seed}") for one in (first, second)]
    tally.done["meetings"] += 1
    if 2 not in codes:
        tally.blame(f"together {config.name} {seed}: codes {codes}, expected one refused")
    if out.is_dir() and json.loads((out / "provenance.json").read_text())["seed"] != seed:
        shutil.rmtree(out)  # the second was first, and the first was refused
        finish(start(config, out, seed), tally, f"again {config.name} {seed}")


DISTURBANCES: tuple[Callable[[Path, Path, int, np.random.Generator, Tally, float], None], ...] = (
    kill_again_and_again,
    kill_again_and_again,
    fill_the_disk,
    meet,
)


def run_round(number: int, root: Path, folder: Path, tally: Tally) -> None:
    """Run one experiment undisturbed and disturbed, and compare."""
    rng = np.random.default_rng([14, number])
    config, seed = root / EXPERIMENTS[number % len(EXPERIMENTS)], int(rng.integers(1000))
    disturb = DISTURBANCES[rng.integers(len(DISTURBANCES))]
    quiet, out = folder / "undisturbed" / f"{number}", folder / "disturbed" / f"{number}"
    before = time.monotonic()
    finish(start(config, quiet, seed), tally, f"undisturbed {config.name} {seed}")
    disturb(config, out, seed, rng, tally, time.monotonic() - before)
    tally.done["rounds"] += 1
    what = f"{disturb.__name__} {config.parent.name}/{config.name} {seed}"
    if not out.is_dir():
        tally.blame(f"{what}: results lost")
    elif (there := read(out)) != (wanted := read(quiet)):
        names = [name for name in sorted(set(there) | set(wanted)) if there.get(name) != wanted.get(name)]
        tally.blame(f"{what}: differs in {', '.join(names[:5])}")
    left = [path.name for path in out.parent.iterdir() if path.name.startswith(f"{number}.")]
    if left:
        tally.blame(f"{what}: left {', '.join(left)}")
    for path in (quiet.parent, out.parent):  # what sweeps keep there, too
        shutil.rmtree(path, ignore_errors=True)
    print(f"{number}: {what}, {time.monotonic() - before:.0f} s", flush=True)


def main() -> None:
    """Run rounds until the time is over; exit code 1 where anything was lost or differs."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--minutes", type=float, default=60.0)
    parser.add_argument(
        "--first", type=int, default=0, help="number of the first round, which its random choices follow"
    )
    parser.add_argument("--pictures", action="store_true", help="draw the pages' pictures, which take most of the time")
    arguments = parser.parse_args()
    tally, number = Tally(), arguments.first
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        write_subjects(folder)
        if not arguments.pictures:
            page.render_picture = lambda draw, stacked=True: Picture(b"not drawn")
        for experiment in EXPERIMENTS:
            load(folder / "experiments" / experiment)  # imported before anything is forked
        end = time.monotonic() + 60.0 * arguments.minutes
        while time.monotonic() < end:
            run_round(number, folder / "experiments", folder, tally)
            number += 1
    done = ", ".join(f"{count} {what}" for what, count in sorted(tally.done.items()))
    print(f"{done}; {len(tally.faults)} faults; next round {number}")
    sys.exit(bool(tally.faults))


if __name__ == "__main__":
    main()
