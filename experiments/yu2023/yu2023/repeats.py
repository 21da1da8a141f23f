"""Selected poses against random ones, and least squares with and without weights (Yu, Wu and Wang 2023, section 5).

Every repeat has its own measurement noise, the same for both sets of poses and for all weightings, and its own random
set; the machine is the same in all. The published figures come from one repeat.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd

from bayescal.errors import InputError, NumericalError
from bayescal.experiments.runner.parallel import Run
from bayescal.experiments.runner.results import Results
from bayescal.files.csv_tables import read_by_leg, read_table
from bayescal.numerics.geometry import Array
from yu2023.least_squares import Calibrations, PoseErrors, Weighting
from yu2023.schema import AccuracyStudyConfig, NumberStudyConfig, PoseNoiseConfig
from yu2023.setup import ERROR_SYMBOLS, CommandedPoses, Setup, noise_scale, select_all

INDEX = "O1"
FIGURES = ("position_max_mm", "position_mean_mm", "attitude_max_deg", "attitude_mean_deg")
METHODS = ("optimal", "random")
PERCENTILES = (2.5, 50.0, 97.5)
UNIT = "deg"
SHOWN_LEG = 0


def list_weightings(noise: PoseNoiseConfig, parameter_error: float) -> dict[str, Weighting]:
    """Return the paper's weighting, that by the noise, and that with the prior beside it."""
    scale = noise_scale(noise)
    return {
        "unweighted": Weighting(np.ones(6)),
        "weighted": Weighting(scale),
        "bayesian": Weighting(scale, parameter_error),
    }


def spread_selections(selected: list[CommandedPoses], repeats: int) -> CommandedPoses:
    """Return one selection for each repeat, taken in turn."""
    turn = np.arange(repeats) % len(selected)
    coordinates = np.stack([poses.coordinates for poses in selected])[turn]
    return CommandedPoses(coordinates, np.stack([poses.actuators for poses in selected])[turn])


def run_accuracy(setup: Setup, study: AccuracyStudyConfig, run: Run) -> Results:
    """Return the distribution of table 8's figures, of the parameters and of what weights gain."""
    seeds = np.random.SeedSequence(setup.config.seed).spawn(study.selections + 1)
    rng = np.random.default_rng(seeds[-1])
    truth = np.tile(setup.read_machine(study.parameter_errors), (study.repeats, 1))
    selected = select_all(setup, [(INDEX, study.poses)] * study.selections, seeds[:-1], run, "selections")
    sets = {
        "optimal": spread_selections(selected, study.repeats),
        "random": setup.draw_random(study.poses, study.repeats, rng),
    }
    noise = noise_scale(study.noise) * rng.standard_normal((study.repeats, study.poses, 6))
    weightings = list_weightings(study.noise, setup.config.parameter_error_mm)
    tasks = {f"{method} {name}": (method, name) for method in METHODS for name in weightings}
    shared = (setup, study, truth, sets, noise)
    calibrated = run.map("calibrations", _calibrate, shared, tasks, (Calibrations, PoseErrors))
    found = {tasks[name]: one for name, (one, _) in calibrated.items()}
    errors = {tasks[name]: one for name, (_, one) in calibrated.items()}
    repeats = _list_repeats(truth, found, errors)
    published = read_figures(setup, study.published)
    table = _describe_figures(repeats, published)
    parameters = _list_parameters(setup, study, truth[0], found["optimal", "unweighted"])
    tables = {
        "repeats": repeats,
        "table8": table,
        "ratios": _list_ratios(repeats),
        "reductions": _list_reductions(repeats, published),
        "parameters": parameters,
        "convergence": _list_convergence(setup, truth[0], found["optimal", "unweighted"]),
        "verification": _list_verification(errors),
    }
    values = [poses.value for poses in selected]
    return Results(_summarise(tables, values) | _judge_published(repeats, published), tables)


def _calibrate(
    shared: tuple[Setup, AccuracyStudyConfig, Array, dict[str, CommandedPoses], Array], task: tuple[str, str]
) -> tuple[Calibrations, PoseErrors]:
    """Return all repeats' calibrations with one set of poses and one weighting, and their errors."""
    (setup, study, truth, sets, noise), (method, name) = shared, task
    weighting = list_weightings(study.noise, setup.config.parameter_error_mm)[name]
    found = setup.calibrate(sets[method], setup.reach_poses(truth, sets[method]) + noise, weighting)
    return found, setup.evaluate(truth, found.theta)


def _list_repeats(
    truth: Array, found: dict[tuple[str, str], Calibrations], errors: dict[tuple[str, str], PoseErrors]
) -> pd.DataFrame:
    parts = []
    for (method, weighting), calibrations in found.items():
        if not calibrations.converged.all():
            count = int((~calibrations.converged).sum())
            raise NumericalError(f"{method} poses, {weighting}: {count} of {len(truth)} calibrations did not converge")
        error = errors[method, weighting]
        parts.append(
            pd.DataFrame(
                {
                    "poses": method,
                    "weighting": weighting,
                    "repeat": np.arange(1, len(truth) + 1),
                    **error.figures,
                    "integrated_deg": error.integrated("deg"),
                    "parameter_rms_mm": np.sqrt(np.mean((calibrations.theta - truth) ** 2, axis=1)),
                    "iterations": calibrations.n_iterations,
                }
            )
        )
    return pd.concat(parts, ignore_index=True)


def read_figures(setup: Setup, name: str | None) -> dict[tuple[str, str], float]:
    """Return the published figures by method and figure."""
    if name is None:
        return {}
    path = setup.folder / name
    table = read_table(path, ("method", *FIGURES))
    values = table.positive(FIGURES)
    methods = table.text("method")
    if sorted(methods) != sorted(METHODS):
        raise InputError(f"{path}: method: found {', '.join(methods)}, expected {' and '.join(METHODS)}")
    return {(m, f): float(values[k, j]) for k, m in enumerate(methods) for j, f in enumerate(FIGURES)}


def _describe_figures(repeats: pd.DataFrame, published: dict[tuple[str, str], float]) -> pd.DataFrame:
    rows = []
    for key, group in repeats.groupby(["poses", "weighting"], sort=False):
        method, weighting = (str(part) for part in key)
        for figure in FIGURES:
            printed = published.get((method, figure)) if weighting == "unweighted" else None
            label = {"poses": method, "weighting": weighting, "figure": figure}
            rows.append(label | describe(group[figure].to_numpy(), printed))
    return pd.DataFrame(rows)


def _list_ratios(repeats: pd.DataFrame) -> pd.DataFrame:
    """Return how many times smaller the mean errors are with weights, on the same data.

    The ratio of the means over all repeats, its standard error, and the range of the ratios of single repeats.
    """
    rows = []
    for method in METHODS:
        ours = repeats[repeats["poses"] == method].set_index("repeat")
        plain = ours[ours["weighting"] == "unweighted"]
        for weighting in ("weighted", "bayesian"):
            other = ours[ours["weighting"] == weighting]
            for figure in ("position_mean_mm", "attitude_mean_deg", "parameter_rms_mm"):
                one, two = plain[figure].to_numpy(), other[figure].to_numpy()
                ratio = float(one.mean() / two.mean())
                spread = np.std(one / one.mean() - two / two.mean(), ddof=1)
                row = {"poses": method, "weighting": weighting, "figure": figure, "ratio": ratio}
                row["standard_error"] = float(ratio * spread / np.sqrt(len(one)))
                row["low"], row["high"] = (float(x) for x in np.percentile(one / two, (2.5, 97.5)))
                row["share_better"] = float(np.mean(two < one))
                rows.append(row)
    return pd.DataFrame(rows)


def _pick(repeats: pd.DataFrame, method: str, figure: str) -> Array:
    """Return a figure of the paper's least squares in every repeat, shape (repeats,)."""
    rows = (repeats["poses"] == method) & (repeats["weighting"] == "unweighted")
    return repeats.loc[rows, figure].to_numpy()


def _list_reductions(repeats: pd.DataFrame, published: dict[tuple[str, str], float]) -> pd.DataFrame:
    """Return by what share selected poses reduce the paper's figures, repeat by repeat, all without weights."""
    rows = []
    for figure in FIGURES:
        optimal, random = (_pick(repeats, method, figure) for method in METHODS)
        printed = 1.0 - published["optimal", figure] / published["random", figure] if published else None
        rows.append({"figure": figure} | describe(1.0 - optimal / random, printed))
    return pd.DataFrame(rows)


def _judge_published(repeats: pd.DataFrame, published: dict[tuple[str, str], float]) -> dict[str, object]:
    """Return how many published figures lie inside the repeats, and how often a repeat has as many outside."""
    if not published:
        return {}
    found = np.stack([_pick(repeats, *key) for key in published], axis=-1)
    printed = np.array(list(published.values()))
    low, high = np.percentile(found, (PERCENTILES[0], PERCENTILES[-1]), axis=0)
    outside = int(((printed < low) | (printed > high)).sum())
    own = ((found < low) | (found > high)).sum(axis=1)
    return {
        "published": len(printed),
        "published_in_range": int(((printed >= found.min(axis=0)) & (printed <= found.max(axis=0))).sum()),
        "published_in_middle": len(printed) - outside,
        "share_with_as_many_outside": float(np.mean(own >= outside)),
    }


def _list_parameters(setup: Setup, study: AccuracyStudyConfig, truth: Array, found: Calibrations) -> pd.DataFrame:
    """Return preset, published and identified parameter errors, those identified in the first repeat."""
    layout = setup.machine.layout
    errors = found.theta - layout.nominal
    table = pd.DataFrame(
        {
            "parameter": layout.names,
            "preset_mm": truth - layout.nominal,
            "identified_mm": errors[0],
            "sd_over_repeats_mm": errors.std(axis=0, ddof=1),
        }
    )
    published = read_parameters(setup, study.published_parameters)
    return table if published is None else table.assign(published_mm=published)


def read_parameters(setup: Setup, name: str | None) -> Array | None:
    """Return the parameter errors that were published (D,), mm, NaN of those that were not; None without a table."""
    if name is None:
        return None
    layout, columns = setup.machine.layout, tuple(ERROR_SYMBOLS)[:-1]  # the printed table has no dh
    values = read_by_leg(setup.folder / name, columns, setup.machine.mechanism.n_legs)
    published = np.full(layout.size, np.nan)
    for k, column in enumerate(columns):
        published[layout.index[ERROR_SYMBOLS[column]]] = values[:, k]
    return published


def _list_convergence(setup: Setup, truth: Array, found: Calibrations) -> pd.DataFrame:
    """Return the remaining errors of the first hardpoint's parameters after each iteration of the first repeat."""
    layout = setup.machine.layout
    names = [name for name in layout.names if name.endswith(f"[{SHOWN_LEG + 1}]")]
    places = [layout.names.index(name) for name in names]
    rows = [
        {"iteration": k, "parameter": name, "error_mm": theta[0, place] - truth[place]}
        for k, theta in enumerate(found.trace)
        for name, place in zip(names, places, strict=True)
    ]
    return pd.DataFrame(rows)


def _list_verification(errors: dict[tuple[str, str], PoseErrors]) -> pd.DataFrame:
    """Return the errors at every verification pose, those of the first repeat."""
    parts = [
        pd.DataFrame(
            {
                "poses": method,
                "weighting": weighting,
                "pose": np.arange(1, error.position.shape[1] + 1),
                "position_mm": error.position[0],
                "attitude_deg": np.degrees(error.attitude[0]),
            }
        )
        for (method, weighting), error in errors.items()
    ]
    return pd.concat(parts, ignore_index=True)


def _summarise(tables: dict[str, pd.DataFrame], values: list[float]) -> dict[str, object]:
    repeats, parameters, convergence = tables["repeats"], tables["parameters"], tables["convergence"]
    ours = repeats[(repeats["poses"] == "optimal") & (repeats["weighting"] == "unweighted")]
    summary: dict[str, object] = {
        "O1": values,
        "parameter_rms_mm": describe(ours["parameter_rms_mm"].to_numpy()),
        "iterations": int(ours["iterations"].max()),
        "largest_change_mm": _largest_changes(convergence),
        "table8": list_records(tables["table8"]),
        "ratios": list_records(tables["ratios"]),
    }
    if "published_mm" in parameters:
        off = (parameters["published_mm"] - parameters["preset_mm"]).dropna()
        summary["published_parameter_rms_mm"] = float(np.sqrt(np.mean(off**2)))
        scaled = off / parameters["sd_over_repeats_mm"].loc[off.index]
        summary["published_parameter_rms_sd"] = float(np.sqrt(np.mean(scaled**2)))
    return summary


def _largest_changes(convergence: pd.DataFrame) -> list[float]:
    """Return the largest change of a shown parameter in each iteration, mm."""
    table = convergence.pivot_table(index="iteration", columns="parameter", values="error_mm").to_numpy()
    return [float(x) for x in np.abs(np.diff(table, axis=0)).max(axis=1)]


def list_records(table: pd.DataFrame) -> list[dict[str, Any]]:
    """Return the rows of a table without what is not known, which JSON has no number for."""
    return [{str(k): v for k, v in row.items() if not pd.isna(v)} for row in table.to_dict("records")]


def describe(values: Array, published: float | None = None) -> dict[str, float]:
    """Return mean, standard error and percentiles of values; of a published one, what share lies below it."""
    low, middle, high = np.percentile(values, PERCENTILES)
    found = {
        "mean": float(np.mean(values)),
        "standard_error": float(np.std(values, ddof=1) / np.sqrt(len(values))),
        "low": float(low),
        "median": float(middle),
        "high": float(high),
    }
    if published is None or np.isnan(published):
        return found
    return found | {"published": published, "share_below": float(np.mean(values < published))}


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
    return Results(_summarise_numbers(table), {"figure10": table})


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


def _summarise_numbers(table: pd.DataFrame) -> dict[str, object]:
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
