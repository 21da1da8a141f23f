"""How often a search for slips is wrong: slips named on clean data, and planted ones found, on twins.

Every twin is a machine of the tolerances of a shipped study or calibration, measured at some of its poses or at random
ones with the stated noise, its legs or carriages erring besides by what no model states: a random matrix times the
travel, as eq. 4 of RR-8096, scaled to some micrometres rms. Clean ones count false alarms; slips are planted in others.

`python benchmarks/slips.py --machine m2_hexapod --twins 200 --out clean.csv`, then `--twins 50 --planted`
(`--first N` does them in parts); `--tabulate clean.csv slips.csv` prints shares of all parts.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
from scipy.spatial.transform import Rotation

from bayescal.data.measured_poses import MeasuredPoses
from bayescal.density.legs import build_leg_posterior
from bayescal.errors import BayescalError
from bayescal.experiments.check.inputs import Subject
from bayescal.experiments.frame.load import load
from bayescal.experiments.shared.leg_slips import find_leg_slip, state_error, suspect_poses
from bayescal.experiments.shared.measured import MeasuredVariant, measure_variants, see_legs
from bayescal.experiments.shared.reading_slips import find_calibration_slip
from bayescal.experiments.shared.readings.inputs import Variant, read_inputs
from bayescal.experiments.shared.readings.workspace import find_starts
from bayescal.numerics.geometry import Array

ROOT = Path(__file__).parents[1]
STUDIES = {
    "m2_hexapod": ("experiments/m2_hexapod/study.toml", "six_ups/none"),
    "telescope": ("experiments/telescope/study.toml", "six_pus/none"),
    "hexaglide": ("experiments/hexaglide/study.toml", "six_pus/none"),
}
DELTA = "examples/own_machine/study.toml"
ERRORS_UM = (0.0, 10.0, 50.0)
POSES = {"few": 5, "many": 20}
TRAVELS = {"small": 0.1, "all": 1.0}

type Plant = Callable[[Array, np.random.Generator], Array]


# --- slips of actuators and of carriages -----------------------------------------------------------------------------


def exchange(values: Array, rng: np.random.Generator) -> Array:
    """Return columns of which two are exchanged."""
    one, other = rng.choice(values.shape[1], 2, replace=False)
    moved = values.copy()
    moved[:, [one, other]] = values[:, [other, one]]
    return moved


def list_plants(start: Array) -> dict[str, tuple[str, Plant]]:
    """Return slips by name: the class in which the search counts them, and what they do to columns (P, N)."""

    def scale(factor: float) -> Plant:
        return lambda values, rng: start + factor * (values - start)

    plants: dict[str, tuple[str, Plant]] = {
        "metres": ("unit", scale(1e-3)),
        "µm": ("unit", scale(1e3)),
        "cm": ("unit", scale(0.1)),
        "inches": ("unit", scale(1.0 / 25.4)),
        "sign": ("unit", scale(-1.0)),
        "two legs exchanged": ("legs", exchange),
        "legs the other way round": ("legs", lambda values, rng: values[:, ::-1]),
        "legs counted from another": (
            "legs",
            lambda values, rng: np.roll(values, int(rng.integers(1, values.shape[1])), axis=1),
        ),
        "rows shifted": ("rows", lambda values, rng: np.roll(values, int(rng.choice([-1, 1])), axis=0)),
    }
    if start.any():
        plants["displacements for positions"] = ("unit", lambda values, rng: values - start)
    return plants


# --- slips of poses --------------------------------------------------------------------------------------------------


def _read_as_vector(poses: MeasuredPoses) -> MeasuredPoses:
    angles = Rotation.from_matrix(poses.rotation).as_euler("xyz")
    return replace(poses, rotation=Rotation.from_rotvec(angles).as_matrix())


def _turn_back(poses: MeasuredPoses) -> MeasuredPoses:
    return replace(poses, rotation=np.swapaxes(poses.rotation, 1, 2))


def _flip_z(poses: MeasuredPoses) -> MeasuredPoses:
    return replace(poses, position=poses.position * [1.0, 1.0, -1.0])


def _exchange_xy(poses: MeasuredPoses) -> MeasuredPoses:
    return replace(poses, position=poses.position[:, [1, 0, 2]])


POSE_PLANTS = {
    "angles read as vectors": _read_as_vector,
    "rotations the other way": _turn_back,
    "z of the other sign": _flip_z,
    "x and y exchanged": _exchange_xy,
}


# --- twins of poses --------------------------------------------------------------------------------------------------


def measure_twin(
    measured: MeasuredVariant, n: int, travel: float, error_um: float, rng: np.random.Generator
) -> MeasuredPoses:
    """Return poses of a machine of the priors, some of the plan's, their travel shortened, and errors of the legs."""
    start, n_poses = measured.machine.mechanism.initial_actuator_positions, measured.poses.n_poses
    some = measured.pick(np.sort(rng.choice(n_poses, min(n, n_poses), replace=False)))
    plan = replace(some.poses, actuators=start + travel * (some.poses.actuators - start))
    exact = build_leg_posterior(some.posterior.likelihood, some.posterior.priors, fixed=some.posterior.fixed)
    some = replace(some, posterior=exact).with_poses(plan)
    _, values = Subject(see_legs(some)).draw_truth(rng)
    poses = some.retake(plan.names, values).poses
    return replace(poses, actuators=poses.actuators + draw_error(plan.actuators - start, error_um, rng))


def draw_error(displacement: Array, size_um: float, rng: np.random.Generator) -> Array:
    """Return a random matrix times displacements (P, N), mm, of so many micrometres rms."""
    error = displacement @ rng.standard_normal((displacement.shape[1],) * 2)
    return 1e-3 * size_um * error / np.sqrt(np.mean(error**2))


def find_pose_slip(measured: MeasuredVariant, poses: MeasuredPoses) -> tuple[str, str] | None:
    """Return class and words of the slip that a study of these poses would name."""
    suspect = suspect_poses(measured.with_poses(poses), state_error(measured.with_poses(poses)), whole=True)
    found = find_leg_slip([suspect], measured.machine.mechanism.initial_actuator_positions)
    return None if found is None else (found.fault, found.text)


def try_poses(machine: str, twins: int, first: int, planted: bool) -> Iterator[dict[str, object]]:
    """Yield what is found of twins of a study."""
    path, name = ROOT / STUDIES[machine][0], STUDIES[machine][1]
    experiment, study = load(path)
    measured = measure_variants(experiment, study, path, [name])[name].legs
    assert measured is not None
    plants = list_plants(measured.machine.mechanism.initial_actuator_positions)
    for k in range(first, first + twins):
        labels, n, share, error, rng = draw_setting(machine, k)
        poses = measure_twin(measured, n, share, error, rng)
        if not planted:
            yield labels | judge("none", "", find_pose_slip(measured, poses))
            continue
        for slip, (fault, plant) in plants.items():
            moved = replace(poses, actuators=plant(poses.actuators, rng))
            yield labels | judge(slip, fault, find_pose_slip(measured, moved))
        for slip, mend in POSE_PLANTS.items():
            yield labels | judge(slip, "poses", find_pose_slip(measured, mend(poses)))


def draw_setting(machine: str, twin: int) -> tuple[dict[str, object], int, float, float, np.random.Generator]:
    """Return a twin's labels, its number of poses, share of the travel, unstated errors in µm, and generator."""
    rng = np.random.default_rng([2026, twin])
    few, travel, error = str(rng.choice(list(POSES))), str(rng.choice(list(TRAVELS))), float(rng.choice(ERRORS_UM))
    labels = {"machine": machine, "twin": twin, "poses": few, "travel": travel, "error_um": error}
    return labels, POSES[few], TRAVELS[travel], error, rng


def judge(slip: str, fault: str, found: tuple[str, str] | None) -> dict[str, object]:
    """Return a row: what was planted, whether something was named, and whether of the right class."""
    right = found is not None and fault in found[0].split()
    return {"slip": slip, "found": found is not None, "right": right, "said": "" if found is None else found[1]}


# --- twins of readings -----------------------------------------------------------------------------------------------


def read_twin(variant: Variant, n: int, travel: float, error_um: float, rng: np.random.Generator) -> Variant:
    """Return the variant with readings of a machine of its priors at random poses; carriages err besides."""
    model, data = variant.model, variant.data
    theta = model.layout.nominal.copy()
    for name, prior in variant.priors.items():
        theta[model.layout.names.index(name)] = rng.normal(prior.centre, prior.scale)
    workspace = variant.workspace
    pose = workspace.middle + travel * (workspace.draw(n, rng) - workspace.middle)
    exact = model.read(theta, pose, {})
    own = variant.internal
    exact[:, own] += draw_error(exact[:, own] - exact[:, own].mean(axis=0), error_um, rng)
    sd = np.broadcast_to(data.sd[0], exact.shape)
    names = tuple(f"C{k}" for k in range(n))
    return place(variant, replace(data, poses=names, values=exact + sd * rng.standard_normal(exact.shape), sd=sd))


def place(variant: Variant, data: object) -> Variant:
    """Return the variant with other data, its poses looked for."""
    n = len(data.values)  # type: ignore[attr-defined]
    still = np.zeros((n, len(variant.model.coordinates)))
    twin = replace(variant, data=data, verification=np.zeros(n, dtype=bool), start=still)
    return replace(twin, start=find_starts(twin.posterior(np.ones(n, dtype=bool)), variant.workspace, 1))


def try_readings(twins: int, first: int, planted: bool) -> Iterator[dict[str, object]]:
    """Yield what is found of twins of the linear delta."""
    path = ROOT / DELTA
    variant = read_inputs(load(path)[1], path.parent).variants["all"]
    own = np.flatnonzero(variant.internal)
    plants = list_plants(np.zeros(len(own)))
    for k in range(first, first + twins):
        labels, n, share, error, rng = draw_setting("delta", k)
        clean = read_twin(variant, n, share, error, rng)
        if not planted:
            yield labels | judge("none", "", _search(clean))
            continue
        for slip, (fault, plant) in plants.items():
            values = clean.data.values.copy()
            values[:, own] = plant(values[:, own], rng)
            yield labels | judge(slip, fault, _search_moved(clean, values))


def _search_moved(clean: Variant, values: Array) -> tuple[str, str] | None:
    try:
        return _search(place(clean, replace(clean.data, values=values)))
    except BayescalError as error:  # no pose at all: refused
        return ("refused", str(error))


def _search(variant: Variant) -> tuple[str, str] | None:
    found = find_calibration_slip([variant.suspicion()])
    return None if found is None else (found.fault, found.text)


# --- shares ----------------------------------------------------------------------------------------------------------


def tabulate(table: pd.DataFrame) -> None:
    """Print shares with their standard errors: false alarms by setting, slips found and named by kind."""
    clean, planted = table[table["slip"] == "none"], table[table["slip"] != "none"]
    groups = ((clean, ["machine"]), (clean, ["poses", "travel", "error_um"]), (planted, ["machine", "slip"]))
    for part, by in (*groups, (planted, ["poses", "travel", "error_um"])):
        for key, rows in part.groupby(by, sort=False):
            shares = [f"{what} {_share(rows[what])}" for what in ("found", "right")]
            print(f"{' '.join(map(str, key)):50} {len(rows):5d}  {', '.join(shares)}")
        print()


def _share(values: pd.Series) -> str:
    """Return a share in per cent with its standard error; of none or all, with what one more or less would be."""
    p, n = float(values.mean()), len(values)
    return f"{100 * p:.1f} ± {100 * np.sqrt(max(p * (1 - p), 1 / n) / n):.1f} %"


def main() -> None:
    """Try twins and print shares."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--machine", choices=[*STUDIES, "delta"], default="m2_hexapod")
    parser.add_argument("--twins", type=int, default=20)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--planted", action="store_true", help="plant each slip; clean data without it")
    parser.add_argument("--out", type=Path)
    parser.add_argument("--tabulate", type=Path, nargs="+")
    given = parser.parse_args()
    if given.tabulate:
        tabulate(pd.concat([pd.read_csv(path) for path in given.tabulate]))
        return
    if given.machine == "delta":
        rows = try_readings(given.twins, given.first, given.planted)
    else:
        rows = try_poses(given.machine, given.twins, given.first, given.planted)
    table = pd.DataFrame(rows)
    if given.out is not None:
        table.to_csv(given.out, index=False)
    tabulate(table)


if __name__ == "__main__":
    main()
