"""What a sweep of thousands of members costs beside its members: planning, keeping, taking up again, table, page.

    python benchmarks/sweep.py [--members 10000] [--write FILE]

The members are audits of Rubin's M2 hexapod (tracker's noise by number of poses); one is computed, and its summary
stands for all, so that what is timed is everything else. The sweep is run in part, then taken up again: members that
are kept are read and not computed. Memory is the largest resident size up to the end of each part.
"""

from __future__ import annotations

import argparse
import json
import resource
import shutil
import tempfile
import time
from pathlib import Path

import bayescal.experiments.sweep.compute as sweep
from bayescal import load_experiment
from bayescal.experiments.frame.run import run_experiment, write_report
from bayescal.experiments.sweep.inputs import read_sweep
from bayescal.experiments.sweep.members import Outcome, compute_member

AUDITS = Path(__file__).parents[1] / "experiments" / "audit"


def write_sweep(folder: Path, n_members: int) -> Path:
    """Write a sweep of so many members; return its config."""
    for name in ("m2_hexapod.toml", "m2_hexapod_mechanism.toml"):
        shutil.copy(AUDITS / name, folder)
    text = (AUDITS / "m2_hexapod_tracker.toml").read_text()
    n_poses = min(40, n_members)
    text = text.replace("factors = [1.0, 2.0, 5.0, 10.0]", f"between = [1.0, 50.0]\ncount = {n_members // n_poses}")
    text = text.replace("values = [12, 40]", f"values = {list(range(12, 12 + n_poses))}")
    path = folder / "sweep.toml"
    path.write_text(text)
    return path


def main() -> None:
    """Measure, print, and keep it."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--members", type=int, default=10_000)
    parser.add_argument("--write", type=Path, help="JSON file for the figures")
    options = parser.parse_args()
    seconds: dict[str, float] = {}
    peaks: dict[str, float] = {}

    def timed(name: str, begun: float) -> None:
        seconds[name] = time.process_time() - begun
        peaks[name] = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0
        print(f"{name:32}{seconds[name]:8.1f} s of CPU{peaks[name]:8.0f} MiB", flush=True)

    with tempfile.TemporaryDirectory() as name:
        path, out = write_sweep(Path(name), options.members), Path(name) / "out"
        config = load_experiment(path)
        begun = time.process_time()
        inputs = read_sweep(config, path.parent)
        timed("read", begun)
        begun = time.process_time()
        _, addresses, tasks, _ = sweep._plan(inputs)
        timed("plan", begun)
        begun = time.process_time()
        first = compute_member(inputs.base, next(iter(tasks.values())))
        assert first.has_summary, first.failure
        timed("one member", begun)
        left = [len(tasks) // 2]

        def stand_in(base: object, settings: object) -> Outcome:
            del base, settings
            if left[0] == 0:
                raise KeyboardInterrupt
            left[0] -= 1
            return first

        sweep.compute_member = stand_in
        begun = time.process_time()
        try:
            run_experiment(config, path.parent, out)
        except KeyboardInterrupt:
            timed("first half, then interrupted", begun)
        left[0] = -1
        begun = time.process_time()
        run_experiment(config, path.parent, out, resume=True)
        timed("taken up again, second half", begun)
        shutil.rmtree(out)
        left[0] = 0
        begun = time.process_time()
        run_experiment(config, path.parent, out)
        timed("all of them kept: a new run", begun)
        begun = time.process_time()
        write_report(out)
        timed("of that the page", begun)
        size = sum(file.stat().st_size for file in (out.parent / config.cache).rglob("*.npz"))
        print(f"{len(addresses)} members, {len(tasks)} different, {size / 2**20:.0f} MiB kept")
    if options.write is not None:
        figures = {"members": len(addresses), "cpu_s": seconds, "peak_mib": peaks, "kept_mib": size / 2**20}
        options.write.write_text(json.dumps(figures, indent=1) + "\n")


if __name__ == "__main__":
    main()
