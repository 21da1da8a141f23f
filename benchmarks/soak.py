"""Random studies, kills, full disks and runs that meet: whether anything is lost, or comes out different.

    python benchmarks/soak.py --minutes 60

Every round takes one of a few tiny experiments with a seed, runs it undisturbed once, and then again under a
disturbance drawn at random: killed (SIGKILL, SIGTERM, SIGINT) at random moments and taken up with --resume until it
ends; with a limit on how large files may be, as on a full disk, and taken up without; two runs at once on one results
directory. In the end the results must be those of the undisturbed run, byte for byte but for times, and nothing may be
left beside them. What runs is the command line, in processes of its own.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT / "tests"))

from fuzz.subjects import write_subjects  # noqa: E402  # beside the tests

EXPERIMENTS = (
    "pose_extraction/figure5.toml",
    "hexapod/figure10.toml",
    "sliding_star/calibrations.toml",
    "hexapod/table8.toml",
    "audit/m2_hexapod_tracker.toml",
    "own_machine/study.toml",
)
SIGNALS = (signal.SIGKILL, signal.SIGTERM, signal.SIGINT)
TIMED = re.compile(rb'^ *"(wall_)?(seconds|time|started|finished)[a-z_]*": .*$', re.MULTILINE)
CODES = {0, 3, 130, -signal.SIGKILL}
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


def command(config: Path, out: Path, seed: int, *more: str) -> list[str]:
    """Return the command line of a run."""
    line = [sys.executable, "-m", "bayescal.cli", "run", str(config), "--out", str(out), "--seed", str(seed)]
    return [*line, "--quiet", "--workers", "2", *more]


def start(line: list[str], largest: int | None = None) -> subprocess.Popen[str]:
    """Start a run, perhaps with a limit on the size of its files, in bytes."""

    def prepare() -> None:
        signal.signal(signal.SIGINT, signal.SIG_DFL)
        if largest is not None:
            signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
            resource.setrlimit(resource.RLIMIT_FSIZE, (largest, largest))

    environment = {**os.environ, "OMP_NUM_THREADS": "1", "MPLBACKEND": "agg"}
    return subprocess.Popen(
        line, env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, preexec_fn=prepare
    )


def finish(process: subprocess.Popen[str], tally: Tally, what: str) -> int:
    """Wait for a run; return its code. More than one line of complaint, or another code than expected, is a fault."""
    try:
        _, said = process.communicate(timeout=PATIENCE)
    except subprocess.TimeoutExpired:
        process.kill()
        tally.blame(f"{what}: no end within {PATIENCE} s")
        return process.wait()
    if "Traceback" in said or said.count("\n") > 1 or process.returncode not in CODES | {2}:
        tally.blame(f"{what}: code {process.returncode}, {said[-400:]!r}")
    return process.returncode


def read(out: Path) -> dict[str, bytes]:
    """Return the files of a results directory, without times; pictures and binary files count by their names."""
    found = {}
    for path in sorted(out.rglob("*")):
        if path.is_file():
            plain = path.suffix in (".csv", ".json", ".toml")
            found[str(path.relative_to(out))] = TIMED.sub(b"", path.read_bytes()) if plain else b""
    return {name: content for name, content in found.items() if "timing" not in name}


def kill_again_and_again(
    config: Path, out: Path, seed: int, rng: np.random.Generator, tally: Tally, whole: float
) -> None:
    """Run and kill at random moments, and take up until it ends."""
    for attempt in range(TRIES):
        resume = attempt > 0 and (out.with_name(out.name + ".partial") / "identity.json").is_file()
        process = start(command(config, out, seed, *(["--resume"] if resume else [])))
        last = attempt > 4 or rng.random() < 0.15
        if not last:
            try:
                process.wait(timeout=float(rng.uniform(0.1, 1.2 * whole)))
            except subprocess.TimeoutExpired:
                process.send_signal(SIGNALS[rng.integers(len(SIGNALS))])
                tally.done["kills"] += 1
        if finish(process, tally, f"killed {config.name} {seed}") in (0, 3):
            return
    tally.blame(f"killed {config.name} {seed}: not finished after {TRIES} runs")


def fill_the_disk(config: Path, out: Path, seed: int, rng: np.random.Generator, tally: Tally, whole: float) -> None:
    """Run with a limit on the size of files, then without."""
    del whole
    process = start(command(config, out, seed), int(10 ** rng.uniform(2.0, 5.0)))
    code = finish(process, tally, f"full disk {config.name} {seed}")
    tally.done["full disks"] += 1
    if code == 0:
        return
    if out.exists():
        tally.blame(f"full disk {config.name} {seed}: results are there with code {code}")
    resume = (out.with_name(out.name + ".partial") / "identity.json").is_file()
    finish(
        start(command(config, out, seed, *(["--resume"] if resume else []))), tally, f"after it {config.name} {seed}"
    )


def meet(config: Path, out: Path, seed: int, rng: np.random.Generator, tally: Tally, whole: float) -> None:
    """Start a second run of another seed on the same directory: one of the two is refused, or comes later."""
    first = start(command(config, out, seed))
    time.sleep(float(rng.uniform(0.0, whole)))
    second = start(command(config, out, seed + 1))
    codes = [finish(one, tally, f"together {config.name} {seed}") for one in (first, second)]
    tally.done["meetings"] += 1
    if 2 not in codes:
        tally.blame(f"together {config.name} {seed}: codes {codes}, expected one refused")
    if out.is_dir() and json.loads((out / "provenance.json").read_text())["seed"] != seed:
        shutil.rmtree(out)  # the second was first, and the first was refused
        finish(start(command(config, out, seed)), tally, f"again {config.name} {seed}")


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
    finish(start(command(config, quiet, seed)), tally, f"undisturbed {config.name} {seed}")
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
    arguments = parser.parse_args()
    end, tally, number = time.monotonic() + 60.0 * arguments.minutes, Tally(), arguments.first
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        write_subjects(folder)
        while time.monotonic() < end:
            run_round(number, folder / "experiments", folder, tally)
            number += 1
    done = ", ".join(f"{count} {what}" for what, count in sorted(tally.done.items()))
    print(f"{done}; {len(tally.faults)} faults; next round {number}")
    sys.exit(bool(tally.faults))


if __name__ == "__main__":
    main()
