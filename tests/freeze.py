"""What small experiments of every kind compute: recorded from code that is trusted, compared after code has moved.

    PYTHONPATH=tests python -m freeze record FOLDER      # in a checkout of the trusted commit
    PYTHONPATH=tests python -m freeze compare FOLDER     # in the checkout that moved, same machine and versions

Numbers are compared, and not names: each numeric column of each CSV file, and the numbers of ``summary.json``, have to
be found in the results of the same experiment, whatever files, columns and keys are called and in whatever order they
stand. Seeds are fixed, so that renaming and moving code changes no digit that counts (`CLOSE`). Beside these stand the
processor time of each experiment, whose sum should not grow.
"""

from __future__ import annotations

import json
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import calibrations
import lookup_tables
import numpy as np
import pandas as pd
import pytest
import session_studies
import studies
import sweeps
from experiments.runner import test_kind_contract as kinds

from bayescal.experiments.runner.load import load
from bayescal.experiments.runner.run import run_experiment
from bayescal.report.pictures import Picture

CLOSE = 1e-9  # of a column's largest number
TIMES = ("timing", "timings")  # tables that have seconds
EXPERIMENTS: dict[str, Callable[[Path], Path]] = {
    "telescope": studies.write_tiny_study,
    "delta": calibrations.write_delta,
    "sensors": kinds.take_tiny("sliding_star/sensors"),
    "audit": kinds.write_audit,
    "next": kinds.write_next,
    "selection": kinds.write_selection,
    "sessions": session_studies.write_sessions,
    "simulation": kinds.take_tiny("telescope/simulate"),
    "sweep": sweeps.write_apart,
    "table": lookup_tables.write_rail,
    "check": kinds.write_check,
}


def list_numbers(found: object) -> Iterator[float]:
    """Return the numbers of what a JSON file has, in its order, seconds left out."""
    if isinstance(found, dict):
        for key, value in found.items():
            if "seconds" not in key:
                yield from list_numbers(value)
    elif isinstance(found, list):
        for value in found:
            yield from list_numbers(value)
    elif isinstance(found, int | float) and not isinstance(found, bool):
        yield float(found)


def collect(out: Path) -> dict[str, list[float]]:
    """Return numeric columns of all tables of results by file and column, and the numbers of the summary."""
    found = {}
    for path in sorted(out.rglob("*.csv")):
        if path.stem in TIMES:
            continue
        table = pd.read_csv(path, comment="#")
        for name in table.columns:
            column = pd.to_numeric(table[name], errors="coerce").astype(float)
            if column.notna().any() and "seconds" not in name:
                found[f"{path.relative_to(out)}: {name}"] = column.tolist()
    for path in sorted(out.rglob("summary.json")):
        for k, value in enumerate(list_numbers(json.loads(path.read_text()))):
            found[f"{path.relative_to(out)}: {k}"] = [value]
    return found


def run(name: str) -> tuple[dict[str, list[float]], float]:
    """Return the numbers of an experiment, and the CPU seconds of its run without pictures."""
    with tempfile.TemporaryDirectory() as folder, pytest.MonkeyPatch.context() as patched:
        patched.setattr("bayescal.report.page.render_picture", lambda draw: Picture(b"not drawn"))
        path, before = EXPERIMENTS[name](Path(folder)), time.process_time()
        run_experiment(load(path)[1], path.parent, Path(folder) / "out")
        return collect(Path(folder) / "out"), time.process_time() - before


def find_lost(old: dict[str, list[float]], new: dict[str, list[float]]) -> list[str]:
    """Return the columns of old results that no column of the new ones equals."""
    columns = [np.array(one) for one in new.values()]

    def is_kept(wanted: np.ndarray) -> bool:
        size = np.nanmax(np.abs(wanted), initial=0.0)
        absolute = CLOSE * (size if np.isfinite(size) else 1.0)
        return any(
            one.shape == wanted.shape and np.allclose(one, wanted, rtol=CLOSE, atol=absolute, equal_nan=True)
            for one in columns
        )

    return [name for name, column in old.items() if not is_kept(np.array(column))]


def main() -> None:
    """Record the numbers of all experiments in a folder, or compare them with what stands there."""
    if len(sys.argv) < 3 or sys.argv[1] not in ("record", "compare"):
        raise SystemExit(f"expected record or compare, a folder and any of {', '.join(EXPERIMENTS)}")
    folder, lost, seconds = Path(sys.argv[2]), 0, []
    folder.mkdir(parents=True, exist_ok=True)
    for name in sys.argv[3:] or EXPERIMENTS:
        found, took = run(name)
        file = folder / f"{name}.json"
        if sys.argv[1] == "record":
            file.write_text(json.dumps({"seconds": took, "numbers": found}))
            print(f"{name}: {len(found)} columns, {took:.1f} CPU s", flush=True)
            continue
        known = json.loads(file.read_text())
        missing = find_lost(known["numbers"], found)
        lost, seconds = lost + len(missing), [*seconds, (known["seconds"], took)]
        print(f"{name}: {len(missing)} of {len(known['numbers'])} columns lost", *missing[:8], sep="\n  ", flush=True)
    if seconds:
        before, after = np.sum(seconds, axis=0)
        print(f"CPU seconds {before:.0f} -> {after:.0f}")
    sys.exit(1 if lost else 0)


if __name__ == "__main__":
    main()
