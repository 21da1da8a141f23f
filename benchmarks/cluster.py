"""What the workers of a dask scheduler cost: efficiency in CPU seconds, and milliseconds per task beyond dask's own.

Efficiency is the CPU time of the tasks in one process over that of all processes (client, scheduler, workers) with so
many workers, from the first task to the last; starting them does not count. The same task takes more CPU seconds where
the machine's cores share caches and are all busy, which is nobody's cost: ``of the tasks`` is the share of all CPU
seconds that the tasks themselves took beside each other. Needs ``bayescal[dask]``.
"""

from __future__ import annotations

import argparse
import json
import time
from pathlib import Path

import numpy as np
import psutil

from bayescal.experiments.frame.engine import Engine, Processes, open_engine
from bayescal.experiments.frame.parallel import Run

PROBLEM = np.random.default_rng(1).normal(size=(40, 40))


def compute(shared: np.ndarray, task: tuple[int, int]) -> np.ndarray:
    """Return a number that takes so many small singular value decompositions, and the CPU seconds of this."""
    begin = time.thread_time()
    seed, repeats = task
    matrix = shared + np.random.default_rng(seed).normal(size=shared.shape)
    found = sum(np.linalg.svd(matrix + k, compute_uv=False)[0] for k in range(repeats))
    return np.array([found, time.thread_time() - begin])


def plain(seed: int) -> float:
    """Return a number at once."""
    return float(seed)


def do_nothing(shared: None, task: int) -> float:
    """Return a number at once, as a task of the frame."""
    return float(task)


def count_cpu() -> float:
    """Return the CPU seconds that this process and its children have used."""
    processes = [psutil.Process(), *psutil.Process().children(recursive=True)]
    return sum(sum(process.cpu_times()[:2]) for process in processes)


def measure(engine: Engine, tasks: dict[str, tuple[int, int]]) -> tuple[float, float, float, list[float]]:
    """Return CPU seconds, those of the tasks themselves, wall seconds, and results."""
    cpu, wall = count_cpu(), time.perf_counter()
    found = Run(engine).map("benchmark", compute, PROBLEM, tasks)
    used, took = count_cpu() - cpu, time.perf_counter() - wall
    return used, sum(float(one[1]) for one in found.values()), took, [float(one[0]) for one in found.values()]


def measure_overhead(n: int, rounds: int = 3) -> dict[str, float]:
    """Return the milliseconds per empty task through the frame and through dask alone, the best of some rounds."""
    with open_engine(scheduler="local:1") as engine:
        client, tasks = engine.client, {str(k): k for k in range(n)}
        Run(engine).map("warm", do_nothing, None, dict.fromkeys(("a", "b"), 0))
        frame, dask = [], []
        for _ in range(rounds):
            begin = time.perf_counter()
            Run(engine).map("empty", do_nothing, None, tasks)
            frame.append(1e3 * (time.perf_counter() - begin) / n)
            begin = time.perf_counter()
            client.gather(client.map(plain, range(n), pure=False))
            dask.append(1e3 * (time.perf_counter() - begin) / n)
    return {"frame_ms": min(frame), "dask_ms": min(dask), "beyond_ms": min(frame) - min(dask)}


def main() -> None:
    """Measure, print a table, and keep it."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--tasks", type=int, default=200)
    parser.add_argument("--repeats", type=int, default=400, help="decompositions per task; 400 take some 50 ms")
    parser.add_argument("--workers", type=int, nargs="+", default=[1, 2, 8])
    parser.add_argument("--write", type=Path, help="JSON file for the figures")
    options = parser.parse_args()
    tasks = {str(k): (k, options.repeats) for k in range(options.tasks)}
    cpu, _, wall, expected = measure(Processes(), tasks)
    print(f"one process: {cpu:.1f} s of CPU, {wall:.1f} s, {1e3 * cpu / len(tasks):.0f} ms per task")
    rows = []
    for n in options.workers:
        with open_engine(scheduler=f"local:{n}") as engine:
            warm = {str(k): (k, 1) for k in range(4 * n)}
            measure(engine, warm)  # imports
            used, own, took, found = measure(engine, tasks)
        assert found == expected
        rows.append({"workers": n, "cpu_s": used, "wall_s": took, "efficiency": cpu / used, "of_the_tasks": own / used})
        print(
            f"{n} workers: {used:.1f} s of CPU, {took:.1f} s, efficiency in CPU seconds {cpu / used:.2f}, "
            f"of the tasks {own / used:.2f}"
        )
    overhead = measure_overhead(500)
    print(
        "per empty task: {frame_ms:.2f} ms, dask alone {dask_ms:.2f} ms, beyond it {beyond_ms:.2f} ms".format(
            **overhead
        )
    )
    if options.write is not None:
        figures = {"n_tasks": len(tasks), "cpu_s": cpu, "workers": rows, "overhead": overhead}
        options.write.write_text(json.dumps(figures, indent=1) + "\n")


if __name__ == "__main__":
    main()
