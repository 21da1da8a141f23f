"""How often a search for slips is right: machines by slips, each planted in so many simulated studies.

`python benchmarks/slips.py --seed 1 --studies 4 --out benchmarks/results/slips.csv`; `--machines`, `--slips` do a part,
`--tabulate FILE` prints the tables of one that was written. A check names a cause right where its first statement is
of the cause's class and names its channel, row or parameter; of clean studies where it names none, of machines that err
where it names none or the model. A study says nothing but slips of data far from every machine: right where it names
that slip, or none where none was planted.
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

sys.path.insert(0, str(Path(__file__).parent / "slips"))
from machines import MACHINES, read_subject, write_project
from plants import PLANTS

from bayescal.experiments.selftest.inputs import TestedVariant
from bayescal.experiments.shared.slip_causes import MODEL
from bayescal.experiments.shared.slip_search import search_cause

DATA = ("frame", "unit", "sign", "exchanged", "poses", "row", "sensor")
"""Plants that are slips of the data; of others a study has to say nothing."""
ERRING = "erring"
SIX = ("hexapod by poses", "m2 hexapod", "hexaglide", "linear delta", "serial arm", "cable robot")


def judge(subject: TestedVariant, machine: str, slip: str, k: int, seed: int) -> dict[str, object]:
    """Return what a check and a study say of one set of data, and whether it is right."""
    rng = np.random.default_rng([seed, zlib.crc32(f"{machine} {slip}".encode()), k])
    values, fault, words = PLANTS[slip](subject, rng)
    readings = subject.measured.retake(values).readings
    began = time.process_time()
    found = search_cause(readings)
    seconds = time.process_time() - began
    first, said = found.first, found.slip

    def is_right(faults: tuple[str, ...], text: str) -> bool:
        return bool(set(fault.split()) & set(faults)) and any(word in text for word in words)

    nothing = first is None or (slip == ERRING and first.fault == MODEL)
    return {
        "machine": machine,
        "slip": slip,
        "study": k,
        "check": nothing if not fault else first is not None and is_right(first.faults, first.text),
        "page": said is None
        if slip not in DATA
        else said is not None and first is not None and is_right(first.faults, said.text),
        "accused": said is not None,
        "misfit": round(found.misfit, 2),
        "said": "" if first is None else first.text,
        "seconds": round(seconds, 2),
    }


def tabulate(table: pd.DataFrame) -> None:
    """Print shares of what a check and a study's page say right, and how long a search took."""
    for what, words in (("check", "a check names first, per cent right"), ("page", "a study says, per cent right")):
        shares = 100.0 * table.pivot_table(index="machine", columns="slip", values=what, aggfunc="mean", sort=False)
        shares.loc["all"] = [100.0 * table.loc[table["slip"] == one, what].mean() for one in shares.columns]
        print(f"\n{words}\n{shares.round(0).to_string()}")
    none = table[~table["slip"].isin(DATA)]
    seconds = table.groupby("machine", sort=False)["seconds"].agg(["median", "max"])
    print(f"\nof {len(none)} sets of data without a slip a study accuses {int(none['accused'].sum())}")
    print(f"\ns of CPU time\n{seconds.to_string()}")


def main() -> None:
    """Plant slips and print how many are named right."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--studies", type=int, default=4)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--machines", nargs="+", choices=MACHINES, default=list(SIX))
    parser.add_argument("--slips", nargs="+", choices=list(PLANTS), default=list(PLANTS))
    parser.add_argument("--out", type=Path)
    parser.add_argument("--tabulate", type=Path)
    given = parser.parse_args()
    if given.tabulate is not None:
        tabulate(pd.read_csv(given.tabulate))
        return
    rows = []
    for machine in given.machines:
        with tempfile.TemporaryDirectory() as folder:
            subject = read_subject(write_project(machine, Path(folder) / "project"))
        for slip in given.slips:
            for k in range(given.first, given.first + given.studies):
                rows.append(judge(subject, machine, slip, k, given.seed))
                one = rows[-1]
                print(f"{machine:18} {slip:10} {k:3d} {one['check']!s:5} {one['page']!s:5} {one['said']}", flush=True)
            if given.out is not None:  # what is there after an interruption, too
                given.out.parent.mkdir(parents=True, exist_ok=True)
                pd.DataFrame(rows).to_csv(given.out, index=False)
    tabulate(pd.DataFrame(rows))


if __name__ == "__main__":
    main()
