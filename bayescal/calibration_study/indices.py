"""Observability indices compared by the calibrations that their poses allow (Yu, Wu and Wang 2023, table 4, figure 5).

The paper draws one matrix of noise for each measurement condition and calibrates 100 machines with it. What is left of
the parameter errors after a calibration hardly depends on them, so that its means over 100 machines are those of one
draw of the noise. Here the same table is made, and beside it the distribution over draws of the noise, each with its
own machine, and over selections, which start from random sets. Machines and noise are the same for all indices.
"""

from __future__ import annotations

import numpy as np
import pandas as pd

from bayescal.calibration_study.least_squares import Weighting
from bayescal.calibration_study.outcome import Outcome, describe
from bayescal.calibration_study.setting import CommandedPoses, Setting, noise_scale, select_all
from bayescal.config.calibration_schema import ConditionConfig, IndexStudyConfig
from bayescal.geometry import Array
from bayescal.tables import read_table

UNITS = ("rad", "deg")
UNIT = "deg"
PLAIN = Weighting(np.ones(6))


def run_indices(setting: Setting, study: IndexStudyConfig, workers: int) -> Outcome:
    """Return table 4 as the paper makes it, with the distribution over noise and selections."""
    conditions, indices = study.conditions, study.indices
    choices = [(i, c.poses) for c in conditions for i in indices for _ in range(study.selections)]
    seeds = np.random.SeedSequence(setting.config.seed).spawn(len(choices) + len(conditions) + 1)
    selected = iter(select_all(setting, choices, seeds[len(conditions) + 1 :], workers))
    machines = setting.draw_machines(study.parameter_sets, np.random.default_rng(seeds[0]))
    sets, draws, values = [], [], []
    for condition, seed in zip(conditions, seeds[1 : len(conditions) + 1], strict=True):
        rng = np.random.default_rng(seed)
        own = setting.draw_machines(study.noise_draws, rng)
        noise = noise_scale(condition) * rng.standard_normal((study.noise_draws, condition.poses, 6))
        for index in indices:
            for k in range(study.selections):
                poses = next(selected)
                label: dict[str, object] = {"condition": condition.name, "index": index, "selection": k + 1}
                values.append(label | {"value": poses.value})
                draws.append(_calibrate(setting, label, poses, own, noise))
                sets.append(_calibrate(setting, label, poses, machines, noise[:1]))
    tables = {"parameter_sets": pd.concat(sets), "noise_draws": pd.concat(draws), "selections": pd.DataFrame(values)}
    published = _read_published(setting, study)
    tables["table4"] = _tabulate(tables, published)
    tables["best"] = _find_best(tables["noise_draws"], conditions)
    return Outcome(tables, _summarise(tables, indices[0]))


def _calibrate(
    setting: Setting, label: dict[str, object], poses: CommandedPoses, truth: Array, noise: Array
) -> pd.DataFrame:
    """Return the integrated errors of machines (B, D), one row each; NaN where a calibration did not converge."""
    found = setting.calibrate(poses, setting.stand(truth, poses) + noise, PLAIN)
    error = setting.evaluate(truth, np.where(found.converged[:, None], found.theta, np.nan))
    columns = {"draw": np.arange(1, len(truth) + 1)} | {unit: error.integrated(unit) for unit in UNITS}
    return pd.DataFrame(label | columns | {"iterations": found.n_iterations})


def _read_published(setting: Setting, study: IndexStudyConfig) -> dict[tuple[str, str], float]:
    if study.published is None:
        return {}
    table = read_table(setting.folder / study.published, ("condition", *study.indices))
    values = table.numbers(study.indices)
    names = table.text("condition")
    return {(c, i): float(values[r, k]) for r, c in enumerate(names) for k, i in enumerate(study.indices)}


def _tabulate(tables: dict[str, pd.DataFrame], published: dict[tuple[str, str], float]) -> pd.DataFrame:
    """Return a row for each condition and index; the standard error is that over selections."""
    rows = []
    sets = tables["parameter_sets"].groupby(["condition", "index"], sort=False)
    for key, group in tables["noise_draws"].groupby(["condition", "index"], sort=False):
        condition, index = (str(part) for part in key)
        one = sets.get_group(key)
        as_printed = one[one["selection"] == 1]
        row: dict[str, object] = {"condition": condition, "index": index, "failed": int(group[UNIT].isna().sum())}
        row |= {f"as_printed_{unit}": float(as_printed[unit].mean()) for unit in UNITS}
        row["spread_over_machines"] = float(as_printed[UNIT].std() / as_printed[UNIT].mean())
        row["spread_over_noise"] = float(group[UNIT].std() / group[UNIT].mean())
        row |= describe(group[UNIT].dropna().to_numpy(), published.get((condition, index)))
        by_selection = group.groupby("selection")[UNIT].mean()
        row["standard_error"] = float(by_selection.std(ddof=1) / np.sqrt(len(by_selection)))
        row["mean_rad"] = float(group["rad"].mean())
        rows.append(row)
    return pd.DataFrame(rows)


def _find_best(draws: pd.DataFrame, conditions: list[ConditionConfig]) -> pd.DataFrame:
    """Return for each unit, condition and index how often it is best, and its mean error by that of the first index.

    The standard error of the ratio is that over pairs of selections.
    """
    rows = []
    for unit in UNITS:
        wide = draws.pivot_table(index=["condition", "selection", "draw"], columns="index", values=unit, sort=False)
        first = wide.columns[0]
        for condition in conditions:
            ours = pd.DataFrame(wide.loc[condition.name])
            winner = ours.columns.to_numpy()[_argmin(ours)]
            means = ours.groupby("selection").mean()
            for index in wide.columns:
                ratio = means[index] / means[first]
                rows.append(
                    {
                        "unit": unit,
                        "condition": condition.name,
                        "index": index,
                        "share_best": float(np.mean(winner == index)),
                        "ratio": float(means[index].mean() / means[first].mean()),
                        "standard_error": float(ratio.std(ddof=1) / np.sqrt(len(ratio))),
                    }
                )
    return pd.DataFrame(rows)


def _argmin(errors: pd.DataFrame) -> np.ndarray:
    """Return the column with the least error, a calibration that failed counting as the worst, shape (rows,)."""
    return np.asarray(errors.fillna(np.inf).to_numpy().argmin(axis=1))


def _summarise(tables: dict[str, pd.DataFrame], first: str) -> dict[str, object]:
    table = tables["table4"]
    draws = tables["noise_draws"]
    wide = draws.pivot_table(index=["selection", "draw", "condition"], columns="index", values=UNIT, sort=False)
    is_best = pd.Series(_argmin(wide) == list(wide.columns).index(first), index=wide.index)
    winners = is_best.groupby(["selection", "draw"]).all()
    summary: dict[str, object] = {
        "first_index": first,
        "share_first_best_everywhere": float(winners.mean()),
        "spread_over_machines": float(table["spread_over_machines"].mean()),
        "spread_over_noise": float(table["spread_over_noise"].mean()),
        "failed": int(table["failed"].sum()),
        "calibrations": len(tables["parameter_sets"]) + len(draws),
        "table4": table.to_dict("records"),
        "best": tables["best"].to_dict("records"),
    }
    if "published" in table:
        for unit, column in (("deg", "mean"), ("rad", "mean_rad")):
            ratio = np.log((table["published"] / table[column]).to_numpy())
            summary[f"published_by_found_{unit}"] = float(np.exp(ratio.mean()))
            summary[f"published_by_found_{unit}_scatter"] = float(ratio.std(ddof=1))
    return summary
