"""What a run costs by default, with τ alone and with none, machine by machine, and whether it converges.

    python -m benchmarks.truth.cost MACHINE... [--limit 300] [--seed 1] [--keep FOLDER]
                                  [--out benchmarks/truth/cost.csv]

Each is a whole `bayescal run` of a twin without errors, its page and start among it, with the effort of the package's
defaults and one worker; CPU seconds, since others compute on the same machine. A run is stopped at the limit. With
--keep projects and results stay in a folder, with `ended.txt` that says where a run was stopped.
"""

from __future__ import annotations

import argparse
import os
import resource
import subprocess
import sys
import tempfile
from pathlib import Path

import pandas as pd

from benchmarks.truth.machines import MACHINES
from benchmarks.truth.projects import write_project, write_tables
from benchmarks.truth.scores import draw_twin

TEN = ("cell", "mount", "scara", "rotary_delta", "probed_delta", "positioner", "planar_rrr", "arm_camera", "five_bar")
FIFTEEN = (*TEN, "axes", "hexapod", "delta", "arm", "cables", "cell6")
VARIANTS = ("init", "random", "none")
OUTCOMES = {0: "converged", 3: "not converged"}
RUN = (
    "import faulthandler, signal; faulthandler.register(signal.SIGXCPU, chain=True); import bayescal.cli as c; c.main()"
)
"""A run that says where it is when its time is over."""


def run(name: str, stated: str, seed: int, limit: int, folder: Path) -> tuple[float, str]:
    """Return CPU seconds of a run in a new folder, and how it ended."""
    machine, twin = draw_twin(name, "none", 0.0, seed)
    write_project(name, machine, stated, folder, effort="")
    write_tables(machine, twin.values, twin.held, folder)

    def stop() -> None:
        resource.setrlimit(resource.RLIMIT_CPU, (limit, limit + 5))

    words = ["run", "study.toml", "--workers", "1", "--out", "results"]
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    with (folder / "ended.txt").open("w") as said:
        done = subprocess.run(
            [sys.executable, "-c", RUN, *words],
            cwd=folder,
            stdout=said,
            stderr=said,
            preexec_fn=stop,  # no threads run in this process
            env={**os.environ, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"},
            check=False,
        )
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    seconds = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    ended = OUTCOMES.get(done.returncode, f"failed ({done.returncode})")
    return seconds, "unfinished" if seconds >= limit else ended


def main() -> None:
    """Run machines, print what they cost and write it into a table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument(
        "machines", nargs="*", metavar="MACHINE", help=f"of {', '.join(MACHINES)}; these: {', '.join(FIFTEEN)}"
    )
    parser.add_argument("--limit", type=int, default=300, help="CPU seconds at which a run is stopped")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--stated", nargs="+", choices=VARIANTS, default=list(VARIANTS))
    parser.add_argument("--keep", type=Path)
    parser.add_argument("--out", type=Path)
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as scratch:
        for name in arguments.machines or FIFTEEN:
            line: dict[str, object] = {"machine": name}
            for stated in arguments.stated:
                folder = (arguments.keep or Path(scratch)).resolve() / name / stated
                seconds, ended = run(name, stated, 1000 * arguments.seed, arguments.limit, folder)
                line |= {f"{stated}_cpu_s": round(seconds, 1), f"{stated}_ended": ended}
                print(f"{name}, {stated}: {seconds:.0f} s, {ended}", flush=True)
            if arguments.out is not None:
                write(arguments.out, line)


def write(path: Path, line: dict[str, object]) -> None:
    """Write one machine's line into a table, instead of its last one."""
    lines = pd.read_csv(path).to_dict("records") if path.exists() else []
    known = {one["machine"]: one for one in lines}
    known[line["machine"]] = known.get(line["machine"], {}) | line
    order = sorted(known, key=lambda name: FIFTEEN.index(name) if name in FIFTEEN else len(FIFTEEN))
    pd.DataFrame([known[name] for name in order]).to_csv(path, index=False)


if __name__ == "__main__":
    main()
