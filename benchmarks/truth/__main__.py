"""Tables of how often intervals hold the truth, on machines that err by what no model states.

    python -m benchmarks.truth ROW... --machine hexapod [--sizes 1] [--twins 40] [--seed 1] [--limit 0]
                                      [--default init|tau|floor|both] [--columns NAME]
                                      [--keep TWINS.csv] [--out benchmarks/truth/hexapod.csv]

Rows are named in `errors.py`; none are all that the machine can have, or those that it is judged by. With --out lines
are written into the table, in the columns `before` of τ alone, `after` of what `bayescal init` writes, or `floor` of
that with 10 µm stated; other lines and columns stay. `both` takes the same twins for the first two, and tells by the
median over these how many times the processor time of τ alone the default takes. With --keep a row of many twins can
be computed in several goes.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
import pandas as pd

from benchmarks.truth.errors import MATRIX, NONE, ROWS
from benchmarks.truth.machines import MACHINES
from benchmarks.truth.projects import DEFAULTS
from benchmarks.truth.scores import begin_arguments, judge_twins, summarise

KEYS = ["machine", "row", "size"]
PREFIX = {"tau": "before", "init": "after"}
"""Columns of defaults; those of others have their names."""


def main() -> None:
    """Judge rows, print them and write them into a table."""
    parser = begin_arguments(__doc__.splitlines()[0], 1)
    parser.add_argument("--default", choices=(*DEFAULTS, "both"), default="init")
    parser.add_argument("--limit", type=float, default=0.0, help="CPU seconds a twin, 0 for any number")
    parser.add_argument("--keep", type=Path, help="table of twins, which are taken from there the next time")
    parser.add_argument("--columns", help="what columns of the table begin with, if not as said above")
    arguments = parser.parse_args()
    if unknown := set(arguments.rows) - set(ROWS):
        parser.error(f"found rows {sorted(unknown)}, expected some of {', '.join(ROWS)}")
    name = arguments.machine
    rows = arguments.rows or MACHINES[name]().rows
    for row in rows or [one for one in ROWS if one != MATRIX or name.startswith("telescope")]:
        for size in [0.0] if row == NONE else arguments.sizes:
            for default, found in compare(arguments, row, size).items():
                said = ", ".join(f"{key} {value:g}" for key, value in found.items())
                print(f"{name} {row} ×{size:g}, {default}: {said}", flush=True)
                if arguments.out is not None:
                    prefix = arguments.columns or PREFIX.get(default, default)
                    write(arguments.out, (name, row, size), arguments.seed, prefix, found)


def compare(arguments: argparse.Namespace, row: str, size: float) -> dict[str, dict[str, float]]:
    """Return what was found of a row by each default that is asked for; of both on the same twins, one by one."""
    asked = ("tau", "init") if arguments.default == "both" else (arguments.default,)
    which = arguments.machine, row, size
    how = arguments.twins, arguments.seed, arguments.limit, arguments.keep
    twins = (judge_twins(*which, one, *how) for one in asked)
    scores = dict(zip(asked, zip(*zip(*twins, strict=True), strict=True), strict=True))
    found = {default: summarise(list(own)) for default, own in scores.items()}
    if len(asked) > 1:
        ratios = [new.seconds / old.seconds for old, new in zip(scores["tau"], scores["init"], strict=True)]
        found["init"]["cpu_ratio"] = round(float(np.nanmedian(ratios)), 2)
    return found


def write(path: Path, line: tuple[str, str, float], seed: int, prefix: str, found: dict[str, float]) -> None:
    """Write one line into a table, beside what stands there."""
    table = pd.read_csv(path).set_index(KEYS) if path.exists() else pd.DataFrame(columns=KEYS).set_index(KEYS)
    table.index = pd.MultiIndex.from_tuples(table.index.to_list(), names=KEYS)
    values = {f"{prefix}_{key}": value for key, value in {"seed": seed, **found}.items()}
    table = table.reindex(columns=[*table.columns, *(key for key in values if key not in table)])
    if line not in table.index:
        table.loc[line] = np.nan
    table = table.sort_index()
    table.loc[line, list(values)] = list(values.values())
    order = {name: k for k, name in enumerate((*MACHINES, *ROWS))}
    table = table.reset_index().sort_values(KEYS, key=lambda one: one if one.name == "size" else one.map(order))
    table.to_csv(path, index=False)


if __name__ == "__main__":
    main()
