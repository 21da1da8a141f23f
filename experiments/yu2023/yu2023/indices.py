"""Observability indices compared by the calibrations that their poses allow (Yu, Wu and Wang 2023, table 4, figure 5).

The paper draws one matrix of noise for each measurement condition and calibrates 100 machines with it. What is left of
the parameter errors after a calibration hardly depends on them, so that its means over 100 machines are those of one
draw of the noise. Here the same table is made, and beside it the distribution over draws of the noise, each with its
own machine, and over selections, which start from random sets. Machines and noise are the same for all indices and, as
the paper's workspace is not printed, for workspaces of other sizes.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd
from scipy.stats import t as student

from bayescal.errors import InputError
from bayescal.experiments.runner.parallel import Run
from bayescal.experiments.runner.results import Results
from bayescal.files.csv_tables import read_table
from bayescal.numerics.geometry import Array
from yu2023.least_squares import Weighting
from yu2023.repeats import describe, list_records
from yu2023.schema import ConditionConfig, IndexStudyConfig
from yu2023.setup import CommandedPoses, Setup, noise_scale, select_all

UNITS = ("rad", "deg")
UNIT = "deg"
PLAIN = Weighting(np.ones(6))
LEVEL = 0.95
type Published = dict[tuple[str, str], float]
type Selected = dict[tuple[str, str], list[CommandedPoses]]
type Seeds = Sequence[np.random.SeedSequence]


def run_indices(setup: Setup, study: IndexStudyConfig, run: Run) -> Results:
    """Return table 4 as the paper makes it, with the distribution over noise and selections."""
    pairs, n_draws = len(study.conditions) * len(study.indices), len(study.conditions) + 1
    counts = [study.selections, *[1] * len(study.workspace_scales)]
    seeds = np.random.SeedSequence(setup.config.seed).spawn(n_draws + pairs * sum(counts))
    starts = n_draws + pairs * np.cumsum([0, *counts])
    published = read_published(setup, study)
    scales, parts = [1.0, *study.workspace_scales], []
    for k, scale in enumerate(scales):
        scaled = setup if scale == 1.0 else setup.scale_workspace(scale)
        what = f"workspace {scale:g}"
        parts.append(_run(scaled, study, seeds[:n_draws], seeds[starts[k] : starts[k + 1]], run, what))
    tables = parts[0]
    tables["table4"] = _tabulate(tables, published)
    tables["best"] = _find_best(tables["noise_draws"], study.conditions)
    means = [_average(part["noise_draws"], scale, published) for part, scale in zip(parts, scales, strict=True)]
    tables["workspaces"] = pd.concat(means, ignore_index=True)
    summary = _summarise(tables, study.indices[0])
    chances = [_share_everywhere(part["noise_draws"], study.indices[0]) for part in parts]
    summary["workspaces"] = _compare_workspaces(tables["workspaces"], chances)
    return Results(summary, tables)


def _run(
    setup: Setup, study: IndexStudyConfig, draw_seeds: Seeds, selection_seeds: Seeds, run: Run, what: str
) -> dict[str, pd.DataFrame]:
    """Return the calibrations over noise draws, as many selections as there are seeds for, and over parameter sets.

    The latter, which are the paper's own comparison, have the first selections only.
    """
    n_selections = len(selection_seeds) // (len(study.conditions) * len(study.indices))
    choices = [(i, c.poses) for c in study.conditions for i in study.indices for _ in range(n_selections)]
    selected = iter(select_all(setup, choices, selection_seeds, run, f"{what}, selections"))
    poses: Selected = {
        (c.name, i): [next(selected) for _ in range(n_selections)] for c in study.conditions for i in study.indices
    }
    shared = (setup, study, draw_seeds[0], poses)
    tasks = {f"{c.name}": (c, seed) for c, seed in zip(study.conditions, draw_seeds[1:], strict=True)}
    found = list(run.map(f"{what}, calibrations", _calibrate_condition, shared, tasks).values())
    names = ("parameter_sets", "noise_draws", "selections")
    return {name: pd.concat([one[name] for one in found], ignore_index=True) for name in names}


def _calibrate_condition(
    shared: tuple[Setup, IndexStudyConfig, np.random.SeedSequence, Selected],
    task: tuple[ConditionConfig, np.random.SeedSequence],
) -> dict[str, pd.DataFrame]:
    """Return the calibrations under one condition, those over parameter sets with the first selections only."""
    (setup, study, machine_seed, selected), (condition, seed) = shared, task
    machines = setup.draw_machines(study.parameter_sets, np.random.default_rng(machine_seed))
    rng = np.random.default_rng(seed)
    own = setup.draw_machines(study.noise_draws, rng)
    noise = noise_scale(condition) * rng.standard_normal((study.noise_draws, condition.poses, 6))
    sets, draws, values = [], [], []
    for index in study.indices:
        for k, poses in enumerate(selected[condition.name, index]):
            label: dict[str, object] = {"condition": condition.name, "index": index, "selection": k + 1}
            values.append(label | {"value": poses.value})
            draws.append(_calibrate(setup, label, poses, own, noise))
            if k == 0:
                sets.append(_calibrate(setup, label, poses, machines, noise[:1]))
    frames = {"parameter_sets": pd.concat(sets), "noise_draws": pd.concat(draws), "selections": pd.DataFrame(values)}
    return {name: frame.reset_index(drop=True) for name, frame in frames.items()}


def _calibrate(
    setup: Setup, label: dict[str, object], poses: CommandedPoses, truth: Array, noise: Array
) -> pd.DataFrame:
    """Return the integrated errors of machines (B, D), one row each; NaN where a calibration did not converge."""
    found = setup.calibrate(poses, setup.reach_poses(truth, poses) + noise, PLAIN)
    error = setup.evaluate(truth, np.where(found.converged[:, None], found.theta, np.nan))
    columns = {"draw": np.arange(1, len(truth) + 1)} | {unit: error.integrated(unit) for unit in UNITS}
    return pd.DataFrame(label | columns | {"iterations": found.n_iterations})


def read_published(setup: Setup, study: IndexStudyConfig) -> Published:
    """Return the published figures by condition and index."""
    if study.published is None:
        return {}
    table = read_table(setup.folder / study.published, ("condition", *study.indices))
    values = table.positive(study.indices)
    names = table.text("condition")
    table.check_unique([(name,) for name in names], "condition")
    for condition in study.conditions:
        if condition.name not in names:
            raise InputError(f"{table.path}: found no row of condition {condition.name!r}, expected one of each")
    return {(c, i): float(values[r, k]) for r, c in enumerate(names) for k, i in enumerate(study.indices)}


def _tabulate(tables: dict[str, pd.DataFrame], published: Published) -> pd.DataFrame:
    """Return a row for each condition and index; the standard error is that over selections."""
    rows = []
    sets = tables["parameter_sets"].groupby(["condition", "index"], sort=False)
    for key, group in tables["noise_draws"].groupby(["condition", "index"], sort=False):
        condition, index = (str(part) for part in key)
        as_printed = sets.get_group(key)
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

    The interval of the ratio is Student's for the selections, which are few.
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
                ratio = float(means[index].mean() / means[first].mean())
                spread = float((means[index] / means[first]).std(ddof=1) / np.sqrt(len(means)))
                half = spread * float(student.ppf(0.5 + 0.5 * LEVEL, len(means) - 1))
                row: dict[str, object] = {"unit": unit, "condition": condition.name, "index": index}
                row["share_best"] = float(np.mean(winner == index))
                rows.append(row | {"ratio": ratio, "low": ratio - half, "high": ratio + half})
    return pd.DataFrame(rows)


def _argmin(errors: pd.DataFrame) -> np.ndarray:
    """Return the column with the least error, a calibration that failed counting as the worst, shape (rows,)."""
    return np.asarray(errors.fillna(np.inf).to_numpy().argmin(axis=1))


def _share_everywhere(draws: pd.DataFrame, first: str) -> float:
    """Return in which share of draws and selections the first index is best in all conditions."""
    wide = draws.pivot_table(index=["selection", "draw", "condition"], columns="index", values=UNIT, sort=False)
    is_best = pd.Series(_argmin(wide) == list(wide.columns).index(first), index=wide.index)
    return float(is_best.groupby(["selection", "draw"]).all().mean())


def _average(draws: pd.DataFrame, scale: float, published: Published) -> pd.DataFrame:
    """Return mean errors over all draws and selections, a row for each condition and index, for one workspace."""
    table = draws.groupby(["condition", "index"], sort=False)[list(UNITS)].mean().reset_index()
    table.insert(0, "scale", scale)
    if not published:
        return table
    return table.assign(published=[published[c, i] for c, i in zip(table["condition"], table["index"], strict=True)])


def _compare_workspaces(table: pd.DataFrame, chances: list[float]) -> list[dict[str, float]]:
    """Return how published errors compare with those found, geometric mean and scatter, for each workspace."""
    found = []
    for scale, chance in zip(table["scale"].unique(), chances, strict=True):
        rows = table[table["scale"] == scale]
        row = {"scale": float(scale), "share_first_best_everywhere": chance}
        for unit in UNITS if "published" in rows else ():
            ratio = np.log((rows["published"] / rows[unit]).to_numpy())
            row[f"published_by_found_{unit}"] = float(np.exp(ratio.mean()))
            row[f"published_by_found_{unit}_scatter"] = float(ratio.std(ddof=1))
        found.append(row)
    return found


def _summarise(tables: dict[str, pd.DataFrame], first: str) -> dict[str, object]:
    table, draws = tables["table4"], tables["noise_draws"]
    summary: dict[str, object] = {
        "first_index": first,
        "share_first_best_everywhere": _share_everywhere(draws, first),
        "spread_over_machines": float(table["spread_over_machines"].mean()),
        "spread_over_noise": float(table["spread_over_noise"].mean()),
        "failed": int(table["failed"].sum()),
        "calibrations": len(tables["parameter_sets"]) + len(draws),
        "table4": list_records(table),
        "best": list_records(tables["best"]),
    }
    if "published" in table:
        inside = (table["published"] >= table["low"]) & (table["published"] <= table["high"])
        summary["published_inside"] = int(inside.sum())
        summary["published"] = len(table)
    return summary
