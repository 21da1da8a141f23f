"""The integrated error against the number of measured poses, selected and random (Yu, Wu and Wang 2023, figure 10)."""

from __future__ import annotations

import numpy as np
import pandas as pd

from bayescal.experiments.frame.parallel import Run
from bayescal.experiments.frame.results import Results
from bayescal.numerics.geometry import Array
from bayescal.reproductions.yu2023.accuracy import INDEX, METHODS, list_weightings, spread_selections
from bayescal.reproductions.yu2023.describe import describe
from bayescal.reproductions.yu2023.schema import NumberStudyConfig
from bayescal.reproductions.yu2023.setup import CommandedPoses, Setup, noise_scale, select_all

UNIT = "deg"


def run_numbers(setup: Setup, study: NumberStudyConfig, run: Run) -> Results:
    """Return mean and spread of dX_z (mm and deg) for each number of poses, with and without weights."""
    count = len(study.poses)
    seeds = np.random.SeedSequence(setup.config.seed).spawn(count * (study.selections + 1))
    choices = [(INDEX, n) for n in study.poses for _ in range(study.selections)]
    selected = select_all(setup, choices, seeds[count:], run, "selections")
    truth = np.tile(setup.read_machine(study.parameter_errors), (study.repeats, 1))
    tasks = {
        f"{n}": (n, seeds[k], selected[k * study.selections : (k + 1) * study.selections])
        for k, n in enumerate(study.poses)
    }
    found = run.map("calibrations", _calibrate_number, (setup, study, truth), tasks)
    rows: list[dict[str, object]] = []
    fewest: dict[tuple[str, str], Array] = {}
    for n, calibrated in zip(study.poses, found.values(), strict=True):
        for (method, name), (values, failed) in calibrated.items():
            row: dict[str, object] = {"poses": method, "weighting": name, "n_poses": n, "failed": failed}
            few = fewest.setdefault((method, name), values)
            row["share_no_better"] = float(np.mean(values[:, None] >= few))  # of pairs with the fewest poses
            rows.append(row | describe(values))
    table = pd.DataFrame(rows)
    return Results(_summarise(table), {"figure10": table})


def _calibrate_number(
    shared: tuple[Setup, NumberStudyConfig, Array],
    task: tuple[int, np.random.SeedSequence, list[CommandedPoses]],
) -> dict[tuple[str, str], tuple[Array, int]]:
    """Return dX_z of every calibration that converged and how many did not, by poses and weights."""
    (setup, study, truth), (n, seed, selected) = shared, task
    weightings = list_weightings(study.noise, setup.config.parameter_error_mm)
    rng = np.random.default_rng(seed)
    noise = noise_scale(study.noise) * rng.standard_normal((study.repeats, n, 6))
    sets = (spread_selections(selected, study.repeats), setup.draw_random(n, study.repeats, rng))
    calibrated = {}
    for method, poses in zip(METHODS, sets, strict=True):
        measured = setup.reach_poses(truth, poses) + noise
        for name in ("unweighted", "weighted"):
            found = setup.calibrate(poses, measured, weightings[name])
            kept = found.converged
            values = setup.evaluate(truth[kept], found.theta[kept]).integrated(UNIT)
            calibrated[method, name] = values, int((~kept).sum())
    return calibrated


def _summarise(table: pd.DataFrame) -> dict[str, object]:
    """Return the powers of n with which the error falls, and how many random poses do what the fewest selected do."""
    summary: dict[str, object] = {}
    for (method, weighting), rows in table.groupby(["poses", "weighting"], sort=False):
        slope = np.polyfit(np.log(rows["n_poses"]), np.log(rows["mean"]), 1)[0]
        summary[f"{method}_{weighting}_power"] = float(slope)
    plain = table[table["weighting"] == "unweighted"].set_index("poses")
    optimal, random = plain.loc["optimal"], plain.loc["random"]
    wanted = float(optimal["mean"].iloc[0])
    enough = random[random["mean"] <= wanted]["n_poses"]
    summary["fewest_selected"] = int(optimal["n_poses"].iloc[0])
    summary["random_poses_as_good"] = int(enough.iloc[0]) if len(enough) else None
    if len(enough):
        summary["random_ratio"] = float(
            random["mean"].loc[(random["n_poses"] == enough.iloc[0]).to_numpy()].iloc[0] / wanted
        )
    summary["most_random"] = int(random["n_poses"].iloc[-1])
    summary["most_random_ratio"] = float(random["mean"].iloc[-1] / wanted)
    return summary
