"""What experiments are estimated to hold at once against what they do hold, kind by kind, each in a process of its own.

    python benchmarks/memory.py [--kinds sessions check] [--sizes 1] [--write FILE]

Every kind has a mid-size and a large instance, made of the shipped experiments with more poses, sessions, sensors or
draws; data are simulated. The estimate is that by which a run is refused, Python and libraries among it; the peak is
the largest resident size until the page is written. ``beyond`` leaves out what the process has taken when everything
is imported, of the peak, and what the estimate says of that, of the estimate: this is what grows.
Studies, audits, selections and next poses stand in ``growth.py``.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path

for _variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ[_variable] = "1"

import numpy as np  # noqa: E402 - after the number of threads is set
import pandas as pd  # noqa: E402

EXPERIMENTS = Path(__file__).parents[1] / "experiments"
RUN = """
import resource, sys, time
from pathlib import Path
from bayescal import load_experiment
from bayescal.experiments.runner.load import find_kind, read_inputs
from bayescal.experiments.runner.memory import PROCESS
from bayescal.experiments.runner.run import run_experiment
import bayescal.report.page, arviz, matplotlib.pyplot
path, out = Path(sys.argv[1]), Path(sys.argv[2])
config = load_experiment(path)
experiment = find_kind(config.kind, path.parent, path.parent)
resident = lambda: resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
before, begun = resident(), time.process_time()
need = experiment.estimate_memory(read_inputs(experiment, config, path.parent))
print(need.sizes, before, need.sum_up(1) / 2**20, PROCESS / 2**20, sep="\\n", flush=True)
run_experiment(config, path.parent, out)
print(time.process_time() - begun, resident(), sep="\\n")
"""
EFFORT = "[sampler]\nensembles = 4\nwalkers = 64\nburn_in = 5\nsteps = 20\n[evidence]\ndraws = 1000\nmax_draws = 1000\n"


def simulate(path: Path, out: Path) -> None:
    """Run a simulation in a process of its own."""
    command = [sys.executable, "-m", "bayescal", "simulate", str(path), "--out", str(out)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


def copy(name: str, folder: Path, *changes: tuple[str, str], cut: str | None = None) -> Path:
    """Copy a shipped experiment's file with some of its text replaced, and from a line on left out."""
    text = (EXPERIMENTS / name).read_text()
    for old, new in changes:
        assert old in text, old
        text = text.replace(old, new)
    path = folder / Path(name).name
    path.write_text(text.partition(cut)[0] if cut else text)
    return path


def scatter(path: Path, out: Path, seed: int) -> None:
    """Copy a table with 10 µm of noise on its coordinates: no two sessions have the same readings."""
    table = pd.read_csv(path, comment="#")
    columns = [name for name in table if name.endswith("_mm")]
    table[columns] += np.random.default_rng(seed).normal(size=(len(table), len(columns))) * 0.01
    table.to_csv(out, index=False)


def write_calibration(folder: Path, n_poses: int, effort: str = EFFORT) -> Path:
    """Write the calibration of a hexapod under its weight, from so many poses."""
    copy("m2_hexapod_table/machine.toml", folder)
    simulate(copy("m2_hexapod_table/simulate.toml", folder, ("n_poses = 30", f"n_poses = {n_poses}")), folder / "data")
    path = copy("m2_hexapod_table/study.toml", folder, cut='[[variants]]\nname = "weight_temperature"')
    path.write_text(f"{path.read_text()}[validation]\ndraws = 100\n{effort}")
    return path


def write_sliding_platform(folder: Path, n_poses: int, effort: str = EFFORT) -> Path:
    """Write the calibration of a planar platform by its own readings at so many poses."""
    copy("sliding_star/machine.toml", folder)
    (folder / "data").mkdir()
    copy("sliding_star/data/true_parameters.csv", folder / "data")
    simulate(copy("sliding_star/simulate.toml", folder, ("n_poses = 60", f"n_poses = {n_poses}")), folder / "data")
    path = copy("sliding_star/study.toml", folder, cut='[[variants]]\nname = "s8_one_length"')
    path.write_text(path.read_text() + effort)
    return path


def write_sessions(folder: Path, n_sessions: int, n_poses: int, n_draws: int) -> Path:
    """Write so many sessions of one machine, each of so many poses."""
    for name in ("audit", "m2_hexapod"):
        shutil.copytree(EXPERIMENTS / name, folder / name)
    own = folder / "sessions"
    own.mkdir()
    shutil.copy(EXPERIMENTS / "m2_hexapod_sessions" / "held_back.csv", own)
    moved = np.random.default_rng(1).uniform(-8.0, 8.0, size=(n_poses, 6)).round(3).tolist()
    rows = [",".join(map(str, row)) for row in moved]
    (own / "configurations.csv").write_text("\n".join([",".join(f"drho_{k}" for k in range(1, 7)), *rows]) + "\n")
    simulate(copy("m2_hexapod_sessions/january.toml", own), own / "data")
    path = copy("m2_hexapod_sessions/sessions.toml", own, ("draws = 3000", f"draws = {n_draws}"), cut="[[sessions]]")
    for k in range(n_sessions):
        scatter(own / "data" / "targets.csv", own / "data" / f"targets_{k}.csv", k)
    sections = [
        f'[[sessions]]\nlabel = "S{k}"\ntime_days = {30.0 * k}\ntargets = "data/targets_{k}.csv"\n'
        f'actuators = "data/actuators.csv"\ntemperature_celsius = {2.0 + k % 20}\n'
        for k in range(n_sessions)
    ]
    path.write_text(path.read_text() + "\n".join(sections))
    return path


def write_check(folder: Path, n_poses: int, n_draws: int) -> Path:
    """Write the check of a study of so many poses."""
    from growth import SYMBOLS, write_study

    write_study(folder, 6, n_poses, SYMBOLS)
    path = folder / "selftest.toml"
    path.write_text(
        'kind = "selftest"\nname = "selftest"\ntitle = "Self-test"\nseed = 1\nstudy = "study.toml"\n'
        f"data_sets = 4\ndraws = {n_draws}\n"
    )
    return path


def write_sweep(folder: Path, n_poses: int) -> Path:
    """Write a sweep of four audits of so many poses."""
    from growth import write_audit

    write_audit(folder, n_poses)
    path = folder / "sweep.toml"
    path.write_text(
        'kind = "sweep"\nname = "sweep"\ntitle = "Sweep"\nseed = 1\nexperiment = "audit.toml"\n'
        '[[axes]]\nkey = "sensors.tracker.position_um"\nvalues = [5.0, 10.0, 20.0, 40.0]\n'
        '[[figures]]\nkey = "information.total_nats"\n'
    )
    return path


CASES: dict[str, tuple[Callable[..., Path], tuple[tuple[int, ...], ...]]] = {
    "calibration": (write_calibration, ((100,), (400,))),
    "sliding_platform": (write_sliding_platform, ((500,), (3000,))),
    "sessions": (write_sessions, ((6, 200, 3000), (24, 50, 3000), (6, 40, 60_000))),
    "selftest": (write_check, ((316, 4000), (1000, 4000), (40, 100_000))),
    "sweep": (write_sweep, ((300,), (3000,))),
}


def measure(kind: str, size: tuple[int, ...], limit: float) -> dict[str, float | str | list[int]]:
    """Return estimate and peak of one instance, MiB; what it said where it failed.

    Of one that takes longer than its limit the peak is that until then, and no seconds are told.
    """
    with tempfile.TemporaryDirectory() as name:
        path = CASES[kind][0](Path(name), *size)
        command = [sys.executable, "-c", RUN, str(path), str(Path(name) / "out")]
        with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
            so_far = None
            try:
                said, complaint = process.communicate(timeout=limit)
            except subprocess.TimeoutExpired:
                so_far = read_peak(process.pid)
                process.kill()
                said, complaint = process.communicate()
    if process.returncode and so_far is None:
        return {"kind": kind, "size": list(size), "failed": (complaint.splitlines() or [str(process.returncode)])[-1]}
    if not said:
        return {"kind": kind, "size": list(size), "failed": f"not read within {limit:.0f} s"}
    sizes, *figures = said.splitlines()
    before, estimate, imported = map(float, figures[:3])
    seconds, peak = map(float, figures[3:]) if so_far is None else (float("nan"), so_far)
    return {
        "kind": kind,
        "size": list(size),
        "sizes": sizes,
        "cpu_s": seconds,
        "peak_mib": peak,
        "estimate_mib": estimate,
        "peak_beyond_mib": peak - before,
        "estimate_beyond_mib": estimate - imported,
    }


def read_peak(pid: int) -> float:
    """Return the largest resident size of a process so far, MiB."""
    status = Path(f"/proc/{pid}/status").read_text()
    return float(next(line for line in status.splitlines() if line.startswith("VmHWM:")).split()[1]) / 1024.0


def main() -> None:
    """Measure, print a table, and keep it."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--kinds", nargs="+", choices=CASES, default=list(CASES))
    parser.add_argument("--sizes", type=int, nargs="+", help="which instances, from zero")
    parser.add_argument("--limit", type=float, default=600.0, help="seconds for one instance")
    parser.add_argument("--write", type=Path, help="JSON file for the figures; what stands there of others is kept")
    options = parser.parse_args()
    print(f"{'CPU s':>7}{'peak':>7}{'estimate':>10}{'beyond: peak':>14}{'estimate':>10}{'ratio':>7}  MiB, of")
    for kind in options.kinds:
        sizes = CASES[kind][1]
        for k in range(len(sizes)) if options.sizes is None else options.sizes:
            found = measure(kind, sizes[k], options.limit)
            if "failed" in found:
                print(f"{kind} {found['size']}: {found['failed']}", flush=True)
                continue
            ratio = found["estimate_beyond_mib"] / max(found["peak_beyond_mib"], 1.0)
            print(
                "{cpu_s:7.1f}{peak_mib:7.0f}{estimate_mib:10.0f}{peak_beyond_mib:14.0f}"
                "{estimate_beyond_mib:10.0f}{ratio:7.2f}  {kind}: {sizes}".format(**found, ratio=ratio),
                flush=True,
            )
            if options.write is not None:
                known = json.loads(options.write.read_text()) if options.write.exists() else {}
                name = f"{kind} {'x'.join(map(str, sizes[k]))}"
                options.write.write_text(json.dumps(known | {name: found}, indent=1) + "\n")


if __name__ == "__main__":
    main()
