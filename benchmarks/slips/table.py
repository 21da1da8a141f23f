"""How often a check names the right cause: machines by slips, each planted in so many simulated studies.

`python benchmarks/slips/table.py --studies 20 --out benchmarks/results/slips.csv`; `--machines`, `--slips` do a part.
A cause is named right where the first statement is of its class and names its channel, row or parameter.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
import zlib
from pathlib import Path

import numpy as np
import pandas as pd

sys.path.insert(0, str(Path(__file__).parent))
from plants import PLANTS

from bayescal.experiments.check.inputs import Subject
from bayescal.experiments.shared.slip_search import search_cause
from machines import MACHINES, read_subject, write_project

SEED = 2026


def judge(subject: Subject, machine: str, slip: str, k: int, verbose: bool) -> dict[str, object]:
    """Return what a check says first of one study."""
    rng = np.random.default_rng([SEED, zlib.crc32(f"{machine} {slip}".encode()), k])
    values, fault, words = PLANTS[slip](subject, rng)
    measured = subject.measured.retake(values)
    began = time.process_time()
    found = search_cause(measured).first
    seconds = time.process_time() - began
    text = "" if found is None else found.text
    named = (
        found is None if not fault else found is not None and fault in found.faults and any(w in text for w in words)
    )
    if verbose:
        print(f"  {k:2d} {'ok ' if named else 'NO '} {seconds:4.1f} s  [{fault}: {', '.join(words)}]  {text}")
    return {
        "machine": machine,
        "slip": slip,
        "study": k,
        "named": named,
        "accused": found is not None,
        "said": text,
        "seconds": seconds,
    }


def main() -> None:
    """Plant slips and print how many are named right."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--studies", type=int, default=20)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--machines", nargs="+", choices=MACHINES, default=list(MACHINES))
    parser.add_argument("--slips", nargs="+", choices=list(PLANTS), default=list(PLANTS))
    parser.add_argument("--out", type=Path)
    parser.add_argument("--verbose", action="store_true")
    given = parser.parse_args()
    rows = []
    for machine in given.machines:
        with tempfile.TemporaryDirectory() as folder:
            subject = read_subject(write_project(machine, Path(folder) / "project"))
        for slip in given.slips:
            some = [
                judge(subject, machine, slip, k, given.verbose) for k in range(given.first, given.first + given.studies)
            ]
            right, longest = sum(bool(one["named"]) for one in some), max(float(str(one["seconds"])) for one in some)
            print(f"{machine:20} {slip:10} {right:3d} of {len(some)}  longest {longest:.1f} s", flush=True)
            rows += some
            if given.out is not None:  # what is there after an interruption, too
                given.out.parent.mkdir(parents=True, exist_ok=True)
                pd.DataFrame(rows).to_csv(given.out, index=False)
    table = pd.DataFrame(rows)
    print(table.pivot_table(index="machine", columns="slip", values="named", aggfunc="sum", sort=False).astype(int))


if __name__ == "__main__":
    main()
