"""Do the 90 % intervals of a look-up table hold what they promise? Twins of experiments/m2_hexapod_table say.

Each twin is a machine drawn within the tolerances, measured as the shipped one is (30 random poses between the zenith
and the horizon and over 30 K) and calibrated again; its table is compared with the twin's own.
The posterior is the Gaussian about its mode, whose efficiency as a proposal for the true one is printed beside.

    python benchmarks/lookup_table.py --twins 40 --out table_0.csv
    python benchmarks/lookup_table.py --twins 40 --first 40 --out table_1.csv
    python benchmarks/lookup_table.py --show table_0.csv table_1.csv
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd

from bayescal.experiments.runner.load import load
from bayescal.experiments.table.inputs import TableInputs, read_table, respond
from bayescal.experiments.table.schema import TableConfig
from bayescal.inference.mode import find_modes

SHIPPED = Path(__file__).parent.parent / "experiments" / "m2_hexapod_table"
DRAWS, CHECKED = 300, 60
AXES = {"elevation_deg": [0.0, 30.0, 60.0, 90.0], "temperature_c": [-5.0, 10.0, 25.0]}


def read_shipped() -> TableInputs:
    """Return the shipped table with few places."""
    table = load(SHIPPED / "table.toml")[1]
    assert isinstance(table, TableConfig)
    return read_table(table.model_copy(update={"axes": AXES}), SHIPPED)


def simulate_twin(shipped: TableInputs, rng: np.random.Generator) -> tuple[TableInputs, np.ndarray]:
    """Return the table of a machine drawn from the priors, read at poses of its own, and its parameters (D,)."""
    variant = shipped.variant
    posterior = variant.posterior()
    theta = posterior.theta(posterior.draw_prior(1, rng))[0]
    pose, n = variant.workspace.draw(variant.data.n_poses, rng), variant.data.n_poses
    given = {"elevation_deg": rng.uniform(0.0, 90.0, n), "temperature_c": rng.uniform(-5.0, 25.0, n)}
    values = variant.model.read(theta, pose, given) + variant.data.sd * rng.standard_normal(variant.data.sd.shape)
    # the poses that the instrument read are where those of the density are looked for
    data = replace(variant.data, values=values, given=given)
    twin = replace(variant, data=data, start=values[:, -len(variant.model.coordinates) :])
    return replace(shipped, study=replace(shipped.study, variants={variant.name: twin})), theta


def judge_twin(shipped: TableInputs, seed: int) -> dict[str, float]:
    """Return which part of a twin's corrections and offsets lies in its 90 % intervals, and how sound these are."""
    rng = np.random.default_rng([seed, 1])
    inputs, truth = simulate_twin(shipped, rng)
    posterior = inputs.variant.posterior().with_pose_guesses()
    mode = find_modes(posterior, np.random.default_rng(seed))[0].y
    factor = np.linalg.cholesky(np.linalg.inv(-posterior.gradient(mode)[1]))
    white = rng.standard_normal((DRAWS, len(mode)))
    draws = mode + white @ factor.T
    found, true = (respond(inputs, theta, inputs.cells) for theta in (posterior.theta(draws), truth[None]))
    moved = np.array([row != tuple(inputs.reference.values()) for row in map(tuple, inputs.cells)])
    weight = posterior.log_density(draws[:CHECKED]) + 0.5 * (white[:CHECKED] ** 2).sum(axis=1)
    weight = np.exp(weight - weight.max())
    return {
        "seed": seed,
        "corrections": _cover(found.correction[:, moved], true.correction[0, moved]),
        "offsets": _cover(found.offset[:, moved], true.offset[0, moved]),
        "rms_sd_um": 1e3 * float(np.sqrt(found.correction[:, moved].var(axis=0).mean())),
        "rms_error_um": 1e3 * float(np.sqrt(np.mean((found.correction.mean(axis=0) - true.correction[0])[moved] ** 2))),
        "efficiency": float(weight.sum() ** 2 / (weight**2).sum() / len(weight)),
    }


def _cover(drawn: np.ndarray, true: np.ndarray) -> float:
    low, high = np.quantile(drawn, [0.05, 0.95], axis=0)
    return float(np.mean((low <= true) & (true <= high)))


def show(table: pd.DataFrame) -> None:
    """Print coverage with its standard error, from the scatter between twins."""
    n = len(table)
    for name in ("corrections", "offsets"):
        mean, error = table[name].mean(), table[name].std(ddof=1) / np.sqrt(n)
        print(f"90 % intervals of {name} hold {100 * mean:.1f} ± {100 * error:.1f} % over {n} twins")
    size, error = (np.sqrt(np.mean(table[name] ** 2)) for name in ("rms_sd_um", "rms_error_um"))
    print(f"stated sd {size:.2f} µm, error {error:.2f} µm (rms)")
    print(
        f"efficiency of the Gaussian: median {table['efficiency'].median():.2f}, least {table['efficiency'].min():.2f}"
    )


def main() -> None:
    """Judge twins and print what their tables hold."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--twins", type=int, default=40)
    parser.add_argument("--first", type=int, default=0, help="seed of the first twin")
    parser.add_argument("--out", type=Path, help="CSV file of the twins")
    parser.add_argument("--show", type=Path, nargs="+", help="CSV files of twins to show together")
    given = parser.parse_args()
    if given.show:
        show(pd.concat([pd.read_csv(path) for path in given.show], ignore_index=True))
        return
    shipped = read_shipped()
    table = pd.DataFrame([judge_twin(shipped, seed) for seed in range(given.first, given.first + given.twins)])
    if given.out:
        table.to_csv(given.out, index=False)
    show(table)


if __name__ == "__main__":
    main()
