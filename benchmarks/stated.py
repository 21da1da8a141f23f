"""Whether noise and tolerances that are stated wrong are told: machines by what is stated, in simulated studies.

`python benchmarks/stated.py --seed 1 --studies 2 --out benchmarks/results/stated.csv`; `--machines` and `--changes` do
a part. Readings are those of a machine drawn from its tolerances, with noise as stated; then a tolerance, or the noise
of some channels, is stated so many times as large. Right is what names the kind and, where it is one of a letter, the
letter; where all is as stated, nothing but tolerances that are too wide may be said.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
import zlib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd

sys.path.insert(0, str(Path(__file__).parent / "slips"))
from machines import read_subject, write_project
from plants import clean

from bayescal.experiments.selftest.inputs import TestedVariant
from bayescal.experiments.shared.misstated import find_misstated
from bayescal.experiments.shared.readings.priors import widen
from bayescal.experiments.shared.slip_rows import VariantReadings

MACHINES = ("hexapod by poses", "linear delta", "serial arm", "cable robot")
CHANGES: dict[str, tuple[str, float]] = {
    "as stated": ("", 1.0),
    **{f"tolerances {x:g}": ("all", x) for x in (0.1, 10.0)},
    **{f"tolerance of a letter {x:g}": ("letter", x) for x in (0.1, 10.0)},
    **{f"own noise {x:g}": ("own", x) for x in (0.1, 10.0)},
    **{f"other noise {x:g}": ("other", x) for x in (0.1, 10.0)},
    **{f"all noise {x:g}": ("noise", x) for x in (0.1, 10.0)},
}
TIGHT, WIDE = ("tolerance",), ("wide tolerance",)
SMALL, LARGE = ("noise", "scatter"), ("noise",)
"""A noise that is stated too small: errors of the model from row to row make up for it, where both are said."""


def restate(subject: TestedVariant, change: str, rng: np.random.Generator) -> tuple[VariantReadings, str]:
    """Return readings with something stated so many times as large, and the letter that is meant, if any."""
    measured = subject.measured.retake(clean(subject, rng)[0])
    what, factor = CHANGES[change]
    posterior, likelihood = measured.posterior, measured.posterior.likelihood
    letters = list(dict.fromkeys(name.partition("[")[0] for name in posterior.priors))
    letter = str(rng.choice(letters)) if what == "letter" else ""
    chosen = {"own": measured.internal, "other": ~measured.internal}.get(what, np.full(len(measured.internal), True))
    noise = np.where(chosen, factor, 1.0) if what in ("own", "other", "noise") else 1.0
    priors = {
        name: widen(one, factor) if what == "all" or letter == name.partition("[")[0] else one
        for name, one in posterior.priors.items()
    }
    data = replace(likelihood.data, sd=likelihood.data.sd * noise)
    likelihood = replace(likelihood, data=data, expansion=None)
    return replace(measured, posterior=replace(posterior, likelihood=likelihood, priors=priors)).readings, letter


def judge(subject: TestedVariant, machine: str, change: str, k: int, seed: int) -> dict[str, object]:
    """Return what is said of one set of data, and whether it is right."""
    rng = np.random.default_rng([seed, zlib.crc32(f"{machine} {change}".encode()), k])
    readings, letter = restate(subject, change, rng)
    began = time.process_time()
    found = find_misstated([readings])
    what, factor = CHANGES[change]
    fault = "" if found is None else found.fault
    wanted = (TIGHT if factor < 1.0 else WIDE) if what in ("all", "letter") else SMALL if factor < 1.0 else LARGE
    right = fault in ("", *WIDE) if not what else fault in wanted and (not letter or letter in str(found))
    return {
        "machine": machine,
        "change": change,
        "study": k,
        "letter": letter,
        "right": right,
        "false": fault not in ("", *WIDE, *wanted),
        "said": "" if found is None else f"{fault}: {found.text}",
        "seconds": round(time.process_time() - began, 2),
    }


def main() -> None:
    """Print how often what is stated wrong is told."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--studies", type=int, default=2)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--machines", nargs="+", choices=MACHINES, default=list(MACHINES))
    parser.add_argument("--changes", nargs="+", default=list(CHANGES))
    parser.add_argument("--out", type=Path)
    asked, rows = parser.parse_args(), list[dict[str, object]]()
    with tempfile.TemporaryDirectory() as folder:
        for machine in asked.machines:
            subject = read_subject(write_project(machine, Path(folder) / machine.replace(" ", "_")))
            for change in asked.changes:
                rows += [judge(subject, machine, change, k, asked.seed) for k in range(asked.studies)]
                print(pd.DataFrame(rows[-asked.studies :]).to_string(header=False, index=False), flush=True)
                if asked.out:
                    pd.DataFrame(rows).to_csv(asked.out, index=False)
    table = pd.DataFrame(rows)
    for what in ("right", "false"):
        print(
            f"\n{what}\n{table.pivot_table(index='change', columns='machine', values=what, aggfunc='sum', sort=False)}"
        )


if __name__ == "__main__":
    main()
