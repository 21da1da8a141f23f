"""The integrated error against the number of measured poses, selected and random (Yu, Wu and Wang 2023, figure 10)."""

from __future__ import annotations

import numpy as np
import pandas as pd

from bayescal.numerics.geometry import Array
from bayescal.reproductions.yu2023.accuracy import INDEX, METHODS, list_weightings, spread_selections
from bayescal.reproductions.yu2023.outcome import Outcome, describe
from bayescal.reproductions.yu2023.schema import NumberStudyConfig
from bayescal.reproductions.yu2023.setting import Setting, noise_scale, select_all

UNIT = "deg"


def run_numbers(setting: Setting, study: NumberStudyConfig, workers: int) -> Outcome:
    """Return mean and spread of dX_z (mm and deg) for each number of poses, with and without weights."""
    count = len(study.poses)
    seeds = np.random.SeedSequence(setting.config.seed).spawn(count * (study.selections + 1))
    choices = [(INDEX, n) for n in study.poses for _ in range(study.selections)]
    selected = select_all(setting, choices, seeds[count:], workers)
    truth = np.tile(setting.read_machine(study.parameter_errors), (study.repeats, 1))
    weightings = list_weightings(study.noise, setting.config.parameter_error_mm)
    rows: list[dict[str, object]] = []
    fewest: dict[tuple[str, str], Array] = {}
    for k, n in enumerate(study.poses):
        rng = np.random.default_rng(seeds[k])
        noise = noise_scale(study.noise) * rng.standard_normal((study.repeats, n, 6))
        ours = selected[k * study.selections : (k + 1) * study.selections]
        sets = (spread_selections(ours, study.repeats), setting.draw_random(n, study.repeats, rng))
        for method, poses in zip(METHODS, sets, strict=True):
            measured = setting.stand(truth, poses) + noise
            for name in ("unweighted", "weighted"):
                found = setting.calibrate(poses, measured, weightings[name])
                kept = found.converged
                values = setting.evaluate(truth[kept], found.theta[kept]).integrated(UNIT)
                row: dict[str, object] = {"poses": method, "weighting": name, "n_poses": n}
                row["failed"] = int((~kept).sum())
                few = fewest.setdefault((method, name), values)
                row["share_no_better"] = float(np.mean(values[:, None] >= few))  # of pairs with the fewest poses
                rows.append(row | describe(values))
    table = pd.DataFrame(rows)
    return Outcome({"figure10": table}, _summarise(table))


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
