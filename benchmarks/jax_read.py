"""Whether a machine's own function would pay if JAX traced and differentiated it: two machines, three runs.

    python benchmarks/jax_read.py [--machines own_machine three_rps_free three_rps_solved] [--name jax_read]

The function of `examples/own_machine/linear_delta.py` (14 parameters) and both of `three_rps/parallel_3rps.py` (42), as
they stand, and with `jax.numpy` in the place of NumPy: the same source. First a whole study of each runs, and what the
package asks of the function is counted: values alone or with derivatives along so many directions (columns that share
no channel go together), for a batch of so many machines and poses; with the processor seconds of each, and of the whole
run. Then each batch that takes a hundredth of the seconds in ``read`` or more is timed in NumPy's complex steps, as the
package takes them, and by JAX: compiled values, or values with tangents along the same directions (`jax.jvp`, mapped
over them), arrays to and from NumPy included. JAX compiles once a shape; that time stands apart.

What is best for JAX, ``run_with_jax_s``: the run without its seconds in ``read``, with JAX's where JAX is faster than
NumPy by shape, compilation of that shape included. ``run_without_compiling_s`` is the same if it were for nothing, and
``run_without_read_s`` if ``read`` took no time at all.
"""

# ruff: noqa: I001 - telescope_problem comes before NumPy and JAX: it sets the number of threads
from __future__ import annotations

import argparse
import json
import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections import defaultdict
from pathlib import Path
from types import ModuleType
from typing import Any

os.environ["XLA_FLAGS"] = "--xla_cpu_multi_thread_eigen=false"
os.environ["BAYESCAL_TRUST"] = "1"

from telescope_problem import write_results  # first: sets one thread

import numpy as np

from bayescal import load_experiment
from bayescal.experiments.runner.run import run_experiment
from bayescal.machines.readings.function import FunctionModel, Parameters

BENCHMARKS = Path(__file__).parent
STUDIES = {
    "own_machine": (BENCHMARKS.parent / "examples" / "own_machine", "study.toml", "linear_delta.py"),
    "three_rps_free": (BENCHMARKS / "three_rps", "study_free.toml", "parallel_3rps.py"),
    "three_rps_solved": (BENCHMARKS / "three_rps", "study_solved.toml", "parallel_3rps.py"),
}
ANALYTIC = "from bayescal.numerics.analytic import atan2, norm"
WORTH = 0.01  # of the seconds in `read`, from which on a shape is timed
AGREEMENT = 1e-9  # of values and derivatives, relative to the largest of their channel
REPEAT_S = 0.4  # at least, for the least of the times of one batch
TINY = '\n[sampler]\neffort = "quick"\n'

type Shape = tuple[int, tuple[int, ...], tuple[int, ...]]
"""Directions, 0 for values alone; shapes of θ and v without their last axis."""


def watch(path: Path, out: Path) -> tuple[float, dict[Shape, list[float]], FunctionModel]:
    """Run a study; return its processor seconds, seconds and number of calls by shape, and the machine."""
    seen: dict[Shape, list[float]] = defaultdict(lambda: [0.0, 0])
    models: dict[int, tuple[float, FunctionModel]] = {}  # whole ones, and with the channels that are read
    before = {name: getattr(FunctionModel, name) for name in ("read", "differentiate")}
    inside = False

    def note(name: str):
        def noted(self, theta, pose, *more):
            nonlocal inside
            if inside:
                return before[name](self, theta, pose, *more)
            n = len(more[1]) if name == "differentiate" else 0
            inside, begun = True, time.process_time()
            try:
                return before[name](self, theta, pose, *more)
            finally:
                inside = False
                entry = seen[n, theta.shape[:-1], pose.shape[:-1]]
                spent = time.process_time() - begun
                entry[0] += spent
                entry[1] += 1
                models[id(self)] = models.get(id(self), (0.0,))[0] + spent, self

        return noted

    for name in before:
        setattr(FunctionModel, name, note(name))
    begun = time.process_time()
    try:
        run_experiment(load_experiment(path), path.parent, out)
    finally:
        for name, function in before.items():
            setattr(FunctionModel, name, function)
    most = max(models.values(), key=lambda one: one[0])[1]
    return time.process_time() - begun, dict(seen), most


def trace(model: FunctionModel, source: Path):
    """Return JAX's functions: values of (θ, v), and values with tangents along directions (C, D + q)."""
    import jax
    import jax.numpy as jnp

    jax.config.update("jax_enable_x64", True)
    text = source.read_text(encoding="utf-8").replace("import numpy as np\n", "import jax.numpy as np\n")
    text = text.replace(ANALYTIC, "atan2 = np.arctan2\nnorm = lambda vector: np.sqrt((vector * vector).sum(axis=-1))")
    module = ModuleType("traced")
    exec(compile(text, str(source), "exec"), module.__dict__)
    kind = getattr(module, type(model.machine).__name__)
    machine = kind.__new__(kind)
    machine.__dict__.update(model.machine.__dict__)
    n, places = model.layout.size, model.places

    def values(theta, pose):
        found = machine.read(Parameters(model.layout, theta), pose, {})
        return found if places is None else found[..., np.asarray(places)]

    def slopes(theta, pose, directions):
        def along(one):
            step = jnp.broadcast_to(one[:n], theta.shape), jnp.broadcast_to(one[n:], pose.shape)
            return jax.jvp(values, (theta, pose), step)

        found, tangents = jax.vmap(along, out_axes=(None, 0))(directions)
        return found, tangents

    return jax.jit(values), jax.jit(slopes)


def time_least(function) -> float:
    """Return the least processor seconds of a call."""
    least, begun = np.inf, time.process_time()
    while time.process_time() - begun < REPEAT_S:
        before = time.process_time()
        n = 0
        while n == 0 or time.process_time() - before < REPEAT_S / 10.0:
            function()
            n += 1
        least = min(least, (time.process_time() - before) / n)
    return float(least)


def compare(model: FunctionModel, traced, shape: Shape) -> dict[str, float]:
    """Return seconds of one batch by complex steps and by JAX, of its compilation, and the largest difference."""
    n, of_theta, of_pose = shape
    rng = np.random.default_rng(0)
    size, q = model.layout.size, len(model.coordinates)
    theta = model.layout.nominal + 1e-4 * rng.standard_normal((*of_theta, size))
    home = np.array([one.home for one in model.coordinates])
    half = np.array([one.reach for one in model.coordinates])
    pose = home + 0.5 * half * rng.uniform(-1.0, 1.0, (*of_pose, q))
    directions = np.eye(size + q)[:n] if n != len(model._steps[1].places) else model._steps[1].places
    if n == len(model._steps[0].places):
        directions = model._steps[0].places
    values, slopes = traced
    function, arguments = (slopes, (theta, pose, directions)) if n else (values, (theta, pose))
    begun = time.process_time()
    compiled = function.lower(*arguments).compile()
    compiling = time.process_time() - begun

    def by_jax():
        found = compiled(*arguments)
        return [np.asarray(one) for one in found] if n else [np.asarray(found)]

    def by_steps():
        return list(model.differentiate(theta, pose, {}, directions)) if n else [model.read(theta, pose)]

    difference = 0.0
    for ours, theirs in zip(by_steps(), by_jax(), strict=True):
        theirs = np.broadcast_to(theirs, ours.shape)
        scale = np.abs(ours).max(axis=tuple(range(ours.ndim - 1))) + 1e-300
        difference = max(difference, float((np.abs(ours - theirs) / scale).max()))
    assert difference < AGREEMENT, f"{shape}: differ by {difference}"
    return {
        "numpy_s": time_least(by_steps),
        "jax_s": time_least(by_jax),
        "compile_s": compiling,
        "largest_difference": difference,
    }


def measure(name: str, tiny: bool) -> dict[str, Any]:
    """Return what a run asks of its function, what JAX makes of it, and what a whole run could gain."""
    folder, study, source = STUDIES[name]
    with tempfile.TemporaryDirectory() as temporary:
        here = Path(temporary) / "machine"
        shutil.copytree(folder, here, ignore=shutil.ignore_patterns("__pycache__"))
        if not (here / "data" / "readings.csv").exists():
            run_experiment(load_experiment(here / "simulate.toml"), here, here / "data")
        if tiny:
            text = (here / study).read_text(encoding="utf-8").partition("\n[sampler]")[0]
            (here / study).write_text(text + TINY, encoding="utf-8")
        total, seen, model = watch(here / study, here / "out")
        traced = trace(model, here / source)
        reading = sum(seconds for seconds, _ in seen.values())
        rows, with_jax, free, compiling = [], total - reading, total - reading, 0.0
        for shape, (seconds, calls) in sorted(seen.items(), key=lambda one: -one[1][0]):
            if seconds < WORTH * reading:
                with_jax, free = with_jax + seconds, free + seconds
                continue
            row = compare(model, traced, shape)
            share = min(1.0, row["jax_s"] / row["numpy_s"])
            compiling += row["compile_s"]
            with_jax += min(seconds, seconds * share + row["compile_s"])
            free += seconds * share
            rows.append(
                {"directions": shape[0], "theta": shape[1], "pose": shape[2], "calls": calls, "s": seconds} | row
            )
            print(name, json.dumps(rows[-1]), flush=True)
    return {
        "run_s": total,
        "read_s": reading,
        "read_share": reading / total,
        "shapes": len(seen),
        "shapes_timed": len(rows),
        "compile_all_timed_s": compiling,
        "run_with_jax_s": with_jax,
        "run_without_compiling_s": free,
        "run_without_read_s": total - reading,
        "rows": rows,
    }


def time_import(module: str) -> float:
    """Return the processor seconds that a module's import takes in a process of its own, the least of three."""
    code = f"import numpy, scipy, time; t = time.process_time(); import {module}; print(time.process_time() - t)"
    return min(float(subprocess.check_output([sys.executable, "-c", code], text=True)) for _ in range(3))


def main() -> None:
    """Run all, print what was found, write the results."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--machines", nargs="+", choices=STUDIES, default=list(STUDIES))
    parser.add_argument("--tiny", action="store_true", help="quick studies")
    parser.add_argument("--name", default="jax_read", help="of the results' file")
    options = parser.parse_args()
    found: dict[str, Any] = {"import_jax_s": time_import("jax.numpy")}
    print(f"import of jax.numpy after NumPy and SciPy: {found['import_jax_s']:.2f} s")
    for name in options.machines:
        found[name] = measure(name, options.tiny)
        print(name, json.dumps({key: one for key, one in found[name].items() if key != "rows"}), flush=True)
    print(write_results(options.name, found, ("numpy", "scipy", "jax")).name)


if __name__ == "__main__":
    main()
