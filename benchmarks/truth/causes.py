"""Which single cause is named on machines that err by what no model states, and what it is as good as.

    python -m benchmarks.truth.causes ROW... --machine hexapod [--size 1] [--twins 5] [--seed 5]

Of every twin the log-evidence with each sort of functions alone, and with none, less that with all (nat), from the
study that `bayescal init` writes, about the machine that explains the readings best; and the one that a page names:
as good as all together to within a nat, and 3 nats better than any other alone.
"""

from __future__ import annotations

import argparse
import tempfile
from collections import Counter
from pathlib import Path

import numpy as np

from bayescal.experiments.runner.load import load, read_inputs
from bayescal.experiments.study.page.model_error import name_cause
from bayescal.inference.causes import weigh_causes
from bayescal.inference.mode import find_modes
from benchmarks.truth.errors import ROWS
from benchmarks.truth.machines import MACHINES
from benchmarks.truth.projects import write_project, write_tables
from benchmarks.truth.scores import draw_twin

NOTHING = "-"


def weigh_twin(name: str, row: str, size: float, seed: int, folder: Path) -> dict[str, float]:
    """Return the weights of a twin's causes, its study in a folder."""
    machine, twin = draw_twin(name, row, size, seed)
    write_tables(machine, twin.values, twin.held, folder)
    kind, config = load(folder / "study.toml")
    inputs = read_inputs(kind, config, folder)
    posterior = next(iter(inputs.variants.values())).posterior().with_pose_guesses()
    found = weigh_causes(posterior, find_modes(posterior)[0].y, np.random.default_rng(seed))
    return {name: one.log_odds for name, one in found.items()}


def main() -> None:
    """Weigh twins, and print how often what is named."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("rows", nargs="+", metavar="ROW", help=f"of {', '.join(ROWS)}")
    parser.add_argument("--machine", choices=list(MACHINES), default="hexapod")
    parser.add_argument("--size", type=float, default=1.0)
    parser.add_argument("--twins", type=int, default=5)
    parser.add_argument("--seed", type=int, default=5)
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "twin"
        write_project(arguments.machine, MACHINES[arguments.machine](), "init", path)
        for row in arguments.rows:
            named: Counter[str] = Counter()
            for k in range(arguments.twins):
                weights = weigh_twin(arguments.machine, row, arguments.size, 1000 * arguments.seed + k, path)
                named[name_cause(weights) or NOTHING] += 1
                print(f"{row} {k}: " + ", ".join(f"{name} {value:+.1f}" for name, value in weights.items()), flush=True)
            print(f"{arguments.machine} {row} ×{arguments.size:g}: {dict(named)}", flush=True)


if __name__ == "__main__":
    main()
