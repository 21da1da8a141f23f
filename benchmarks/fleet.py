"""A fleet: as many simulated machines of one class, calibrated by one sweep, by processes and by dask on one computer.

    python benchmarks/fleet.py [--machines 24] [--ways workers:1 workers:2 dask:1 dask:2] [--rounds 1] [--name fleet]

Each machine is a twin of `examples/own_machine`, drawn within its tolerances by the example's own simulation with a
seed of its own: nothing here was measured. The sweep's key is the table of readings (``data.0.file``), its experiment
the example's study at quick effort, with one variant and one width of the priors: cheap members show what distribution
costs. ``workers:N`` is `--workers N`, ``dask:N`` is `--dask-scheduler local:N`, a scheduler and N workers on 127.0.0.1.

Of each run: seconds by the clock from start to end; those from when the first member began to when the last ended;
processor seconds of all its processes together, of its members' own threads, and of the other threads of their
processes meanwhile, dask's among them. Where other processes run on the computer they take their share of the clock,
more from two workers than from one; Linux may even give two workers of one session the share of one. Hence besides how
much of their time the workers had a member under way (``busy``), from when the first began to when a worker had nothing
left to do: with a few machines one waits for the other at the end, with a thousand that is nothing. That, times what
members took in processor seconds with one worker over what they took with two, is the efficiency that the program
itself allows.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

for _variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ[_variable] = "1"
os.environ["BAYESCAL_TRUST"] = "1"

import numpy as np  # noqa: E402 - after the number of threads is set

EXAMPLE = Path(__file__).parents[1] / "examples" / "own_machine"
WAYS = ("workers:1", "workers:2", "dask:1", "dask:2")
OPTIONS = {"workers": "--workers={}", "dask": "--dask-scheduler=local:{}"}
LOG = "FLEET_LOG"
EFFORT = '\n[sampler]\neffort = "quick"\n\n[sensitivity]\nprior_width_factors = [1.0]\n'
SWEEP = """kind = "sweep"
name = "fleet"
title = "A fleet of simulated machines"
seed = 1
experiment = "study.toml"

[[axes]]
key = "data.0.file"
values = {files}

[[figures]]
key = "variants.all.log_evidence"
"""
RUN = """
import json, resource
from bayescal.experiments.sweep import compute
import fleet
compute.compute_member = fleet.compute_noted
from bayescal.cli import main
try:
    main()
finally:
    who = resource.getrusage(resource.RUSAGE_SELF), resource.getrusage(resource.RUSAGE_CHILDREN)
    print(json.dumps([one.ru_utime + one.ru_stime for one in who]))
"""


def compute_noted(shared, task):
    """Return a member's outcome; note when it began and ended, by a clock that all processes share, and its seconds."""
    from bayescal.experiments.sweep.inputs import compute_member

    began, spent, alone = time.monotonic(), time.process_time(), time.thread_time()
    outcome = compute_member(shared, task)
    spent, alone = time.process_time() - spent, time.thread_time() - alone
    with Path(os.environ[LOG]).open("a", encoding="utf-8") as log:
        log.write(f"{began} {time.monotonic()} {spent} {alone} {os.getpid()}\n")
    return outcome


def write_fleet(folder: Path, n_machines: int) -> Path:
    """Simulate machines and write the sweep over their tables; return its config."""
    from bayescal import load_experiment
    from bayescal.experiments.runner.run import run_experiment

    for name in ("machine.toml", "linear_delta.py"):
        shutil.copy(EXAMPLE / name, folder)
    simulation, files = (EXAMPLE / "simulate.toml").read_text(encoding="utf-8"), []
    for k in range(1, n_machines + 1):
        path = folder / f"simulate_{k}.toml"
        path.write_text(simulation.replace("seed = 3\n", f"seed = {1000 + k}\n"), encoding="utf-8")
        run_experiment(load_experiment(path), folder, folder / f"machine_{k}")
        files.append(f"machine_{k}/readings.csv")
    first, _, _ = (EXAMPLE / "study.toml").read_text(encoding="utf-8").partition('\n[[variants]]\nname = "one_rod"')
    (folder / "study.toml").write_text(first.replace("data/readings.csv", files[0]) + EFFORT, encoding="utf-8")
    path = folder / "sweep.toml"
    path.write_text(SWEEP.format(files=json.dumps(files)), encoding="utf-8")
    return path


def measure(path: Path, way: str) -> dict[str, float]:
    """Return the figures of one run of a sweep, whose members are computed anew."""
    name, _, count = way.partition(":")
    with tempfile.TemporaryDirectory() as folder:
        log = Path(folder) / "log"
        found = [str(Path(__file__).parent), os.environ.get("PYTHONPATH", "")]
        environment = os.environ | {LOG: str(log), "PYTHONPATH": os.pathsep.join(filter(None, found))}
        options = ["sweep", str(path), f"--out={folder}/results/out", OPTIONS[name].format(count)]
        begun = time.monotonic()
        done = subprocess.run(
            [sys.executable, "-c", RUN, *options], env=environment, capture_output=True, text=True, check=False
        )
        clock = time.monotonic() - begun
        assert done.returncode == 0, done.stderr[-1000:]
        began, ended, spent, alone, worker = np.loadtxt(log, ndmin=2).T
    first, last = began.min(), min(ended[worker == one].max() for one in set(worker))
    span = ended.max() - first
    under_way = np.minimum(ended, last) - np.minimum(began, last)
    return {
        "machines": len(began),
        "clock_s": clock,
        "members_clock_s": float(span),
        "cpu_s": sum(json.loads(done.stdout.splitlines()[-1])),
        "members_cpu_s": float(alone.sum()),
        "beside_members_cpu_s": float((spent - alone).sum()),
        "busy": float(under_way.sum() / (int(count) * (last - first))),
        "busy_to_the_end": float((ended - began).sum() / (int(count) * span)),
    }


def compare(runs: dict[str, dict[str, float]]) -> dict[str, float]:
    """Return efficiencies from one worker to two and what dask takes beyond processes, of one round's runs."""
    found = {}
    for name in OPTIONS:
        one, two = runs.get(f"{name}:1"), runs.get(f"{name}:2")
        if one and two:
            found[f"{name}_efficiency_clock"] = one["clock_s"] / two["clock_s"] / 2.0
            found[f"{name}_efficiency_members_clock"] = one["members_clock_s"] / two["members_clock_s"] / 2.0
            found[f"{name}_cpu_ratio"] = one["members_cpu_s"] / two["members_cpu_s"]
            found[f"{name}_efficiency_allowed"] = two["busy"] * found[f"{name}_cpu_ratio"]
    for count in (1, 2):
        processes, dask = runs.get(f"workers:{count}"), runs.get(f"dask:{count}")
        if processes and dask:
            found[f"dask_beyond_processes_{count}_cpu_s"] = dask["cpu_s"] - processes["cpu_s"]
    return found


def main() -> None:
    """Measure the ways in turn, print a table, write the results."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--machines", type=int, default=24)
    parser.add_argument("--ways", nargs="+", choices=WAYS, default=list(WAYS))
    parser.add_argument("--rounds", type=int, default=1)
    parser.add_argument("--name", default="fleet", help="of the results' file")
    options = parser.parse_args()
    rounds = []
    with tempfile.TemporaryDirectory() as folder:
        path = write_fleet(Path(folder), options.machines)
        print(f"{'':12}{'clock s':>9}{'members':>9}{'CPU s':>8}{'members':>9}{'busy':>7}")
        for _ in range(options.rounds):
            runs = {}
            for way in options.ways:
                runs[way] = found = measure(path, way)
                print(
                    f"{way:12}{found['clock_s']:9.1f}{found['members_clock_s']:9.1f}{found['cpu_s']:8.1f}"
                    f"{found['members_cpu_s']:9.1f}{found['busy']:7.3f}",
                    flush=True,
                )
            rounds.append({**runs, **compare(runs)})
            print(", ".join(f"{key} {value:.3f}" for key, value in compare(runs).items()), flush=True)
    from telescope_problem import write_results  # sets the number of threads, as this does

    load = os.getloadavg()[2] if hasattr(os, "getloadavg") else float("nan")
    packages = ("numpy", "scipy", *(("distributed",) if any(way.startswith("dask") for way in options.ways) else ()))
    print(write_results(options.name, {"rounds": rounds, "load_of_the_computer": load}, packages).name)


if __name__ == "__main__":
    main()
