"""The documented machine: calibrabilities, and many simulated calibrations with each set by both procedures.

And how the improvement from set to set depends on the noise of the angle sensors, which the paper does not state.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from itertools import pairwise

import numpy as np
import pandas as pd

from bayescal.experiments.runner.parallel import Run
from bayescal.numerics.geometry import Array
from sika2008.schema import NoiseSweepConfig
from sika2008.sensors import compute_calibrability, locate_tool
from sika2008.setup import CALIBRATIONS, SWEEP, ZEROS, Plan, Plans, Setup, build_plans
from sika2008.simulate import (
    BAYESIAN,
    PAPER,
    PROCEDURES,
    Calibrations,
    Measured,
    Simulated,
    Spread,
    measure,
    predict_covariance,
    predict_tool,
    simulate,
    state_spread,
    weigh,
)

QUANTILE, LEVEL = 1.6448536269514722, 0.9  # of the middle 90 % of a normal distribution
QUANTITIES = ("lengths", "guide_angles", "tool", "tool_in_use")
FIRST = 0  # which calibration is shown alone

type Found = dict[tuple[str, str], Simulated]


def run_documented(setup: Setup, run: Run) -> dict[str, pd.DataFrame]:
    """Return the tables of the documented machine."""
    plans, rng = setup.plans, setup.rng(CALIBRATIONS)
    measured = measure(plans, setup.pose, setup.targets, setup.config.calibrations, rng)
    found = simulate_all(setup, plans, measured, run)
    spread = {plan.name: state_spread(found[plan.name, BAYESIAN], setup.targets) for plan in plans.plans}
    return {
        "calibrability": list_calibrabilities(plans, setup.pose),
        "errors": list_errors(setup, found),
        "steps": list_steps(plans, found),
        "parameters": _list_parameters(found, spread),
        "coverage": _list_coverage(plans, found, spread),
        "path": _list_path(setup, measured, found),
        "uncalibrated": _list_uncalibrated(setup, measured),
    }


def simulate_all(setup: Setup, plans: Plans, measured: Measured, run: Run) -> Found:
    """Return the calibrations by set and procedure."""
    by_name = {plan.name: plan for plan in plans.plans}
    tasks = {f"{name} {procedure}": (name, procedure) for name in by_name for procedure in PROCEDURES}
    shared = (plans, measured, setup.pose, setup.targets)
    found = run.map("documented machine", _simulate_one, shared, tasks, (Calibrations,))
    return {
        (name, procedure): Simulated(by_name[name], procedure, *parts)
        for (name, procedure), parts in zip(tasks.values(), found.values(), strict=True)
    }


def _simulate_one(
    shared: tuple[Plans, Measured, Array, Array], task: tuple[str, str]
) -> tuple[Calibrations, Array, Array, Array]:
    plans, measured, pose, targets = shared
    plan = next(one for one in plans.plans if one.name == task[0])
    one = simulate(plans, plan, task[1], measured, pose, targets)
    return one.found, one.error, one.tool, one.noisy_tool


def list_calibrabilities(plans: Plans, pose: Array) -> pd.DataFrame:
    """Return C of each set in different units, and how many parameters it calibrates."""
    rows = [
        {"set": plan.name, "n_sensors": len(plan.sensors.names), "n_parameters": len(plan.parameters)}
        | asdict(compute_calibrability(plan.sensors, plan.free, pose))
        for plan in plans.plans
    ]
    return pd.DataFrame(rows)


def name_parts(plans: tuple[Plan, ...]) -> dict[str, set[str]]:
    """Return the lengths and the guide angles that several sets calibrate; zeros of angle sensors belong to neither."""
    common = set.intersection(*(set(plan.parameters) for plan in plans))
    unit = {name: unit for plan in plans for name, unit in zip(plan.parameters, plan.units, strict=True)}
    angles = {name for name in common if unit[name] == "rad" and name.partition("[")[0] not in ZEROS}
    return {"lengths": {name for name in common if unit[name] == "mm"}, "guide_angles": angles}


def squares_of(one: Simulated, quantity: str, parts: dict[str, set[str]]) -> Array:
    """Return a quantity's mean square error in each calibration, shape (C,), mm² or rad²."""
    if quantity in parts:
        return one.squares(parts[quantity])
    return one.tool_squares if quantity == "tool" else one.noisy_tool_squares


def list_errors(setup: Setup, found: Found) -> pd.DataFrame:
    """Return root mean square errors of sets and procedures, mm and rad; of the paper's also those predicted."""
    parts = name_parts(setup.plans.plans)
    rows = []
    for (name, procedure), one in found.items():
        row: dict[str, object] = {"set": name, "procedure": procedure}
        for quantity in QUANTITIES:
            rms = rms_of(squares_of(one, quantity, parts))
            row |= {quantity: rms.value, f"{quantity}_se": rms.error}
        if procedure == PAPER:
            covariance = predict_covariance(one.plan, setup.pose)
            where = [k for k, p in enumerate(one.plan.parameters) if p in parts["lengths"]]
            row["lengths_predicted"] = float(np.sqrt(np.mean(np.diagonal(covariance)[where])))
            row["tool_predicted"] = predict_tool(one.plan, covariance, setup.targets)
        row |= {"n_failed": int((~one.good).sum()), "most_iterations": int(one.found.n_iterations.max())}
        rows.append(row)
    return pd.DataFrame(rows)


def list_steps(plans: Plans, found: Found) -> pd.DataFrame:
    """Return by which factors errors fall from each set to the next, those of the same machines."""
    rows = []
    for before, after in pairwise(plans.plans):
        parts = name_parts((before, after))
        for procedure in PROCEDURES:
            for quantity in QUANTITIES:
                pair = (squares_of(found[plan.name, procedure], quantity, parts) for plan in (before, after))
                ratio = ratio_of(*pair)
                row = {"from": before.name, "to": after.name, "procedure": procedure, "quantity": quantity}
                rows.append(row | {"ratio": ratio.value, "standard_error": ratio.error})
    return pd.DataFrame(rows)


def _list_parameters(found: Found, spread: dict[str, Spread]) -> pd.DataFrame:
    """Return each parameter's errors: in the first calibration, root mean square, tolerance, stated and covered."""
    parts = []
    for (name, procedure), one in found.items():
        table = pd.DataFrame(
            {
                "set": name,
                "procedure": procedure,
                "parameter": one.plan.parameters,
                "unit": one.plan.units,
                "tolerance": one.plan.free.scale,
                "first_error": one.error[FIRST],
                "rms_error": np.sqrt(np.nanmean(one.error**2, axis=0)),
            }
        )
        table["rms_se"] = table["rms_error"] / np.sqrt(2.0 * one.good.sum())  # errors are near normal
        if procedure == BAYESIAN:
            stated = spread[name].parameters
            table["stated_sd"] = np.sqrt(np.nanmean(stated**2, axis=0))
            inside = np.abs(one.error[one.good]) < QUANTILE * stated[one.good]
            table["covered"] = inside.mean(axis=0)
        parts.append(table)
    return pd.concat(parts, ignore_index=True)


def _list_coverage(plans: Plans, found: Found, spread: dict[str, Spread]) -> pd.DataFrame:
    rows = []
    for plan in plans.plans:
        one, stated = found[plan.name, BAYESIAN], spread[plan.name]
        pairs = {
            "parameters": (one.error, stated.parameters),
            "tool": (one.tool, stated.tool),
            "tool_in_use": (one.noisy_tool, stated.noisy_tool),
        }
        for what, (error, sd) in pairs.items():
            found_cover = cover(error, sd, QUANTILE, LEVEL)
            rows.append(
                {
                    "set": plan.name,
                    "of": what,
                    "quantities": int(np.prod(error.shape[1:])),
                    "share": found_cover.share.value,
                    "standard_error": found_cover.share.error,
                    "lowest": found_cover.lowest,
                    "highest": found_cover.highest,
                    "binomial_error": found_cover.binomial_error,
                }
            )
    return pd.DataFrame(rows)


def _list_path(setup: Setup, measured: Measured, found: Found) -> pd.DataFrame:
    """Return the error of the tool's centre along the path: of the first calibration, and its root mean square."""
    sensors, path, parts = setup.plans.every.sensors, setup.path, []
    readings = sensors.read(measured.theta[:, None], path)
    truth, _, _ = sensors.model.tool(measured.theta[:, None], path)
    for (name, procedure), one in found.items():
        columns = setup.plans.columns(one.plan)
        located = locate_tool(weigh(one.plan, procedure), one.found.theta, readings[..., columns], path)
        error = (located.position - truth)[one.good & located.converged.all(axis=1)]
        first = located.position[FIRST] - truth[FIRST]
        table = pd.DataFrame({"set": name, "procedure": procedure, "pose": np.arange(1, len(path) + 1)})
        table["first_x_mm"], table["first_y_mm"] = first[:, 0], first[:, 1]
        squares = np.sum(error**2, axis=-1)
        table["rms_mm"] = np.sqrt(np.mean(squares, axis=0))
        table["rms_se_mm"] = np.std(squares, axis=0, ddof=1) / np.sqrt(len(squares)) / (2.0 * table["rms_mm"])
        parts.append(table)
    return pd.concat(parts, ignore_index=True)


def _list_uncalibrated(setup: Setup, measured: Measured) -> pd.DataFrame:
    """Return the tool's error of machines taken for nominal, read by the sensors of lengths that the first set has."""
    plan = setup.plans.plans[0]
    units = [setup.machine.channels[k].unit for k in plan.sensors.chosen]
    lengths = np.flatnonzero(np.array(units) == "mm")
    if len(lengths) < plan.sensors.n_coordinates:
        return pd.DataFrame()
    sensors, columns = plan.sensors.select(lengths), setup.plans.columns(plan)[lengths]
    nominal = np.tile(plan.free.centre, (len(measured.theta), 1))
    located = locate_tool(sensors, nominal, measured.at_targets[..., columns], setup.targets)
    truth, _, _ = sensors.model.tool(measured.theta[:, None], setup.targets)
    rms = rms_of(np.mean(np.sum((located.position - truth) ** 2, axis=-1), axis=-1))
    return pd.DataFrame([{"sensors": " ".join(sensors.names), "tool": rms.value, "tool_se": rms.error}])


# --- noise of the angle sensors --------------------------------------------------------------------------------------


def run_sweep(setup: Setup, config: NoiseSweepConfig, run: Run) -> dict[str, pd.DataFrame]:
    """Return errors and steps for each noise of the angle sensors."""
    tasks = {f"{noise:g} arcsec": noise for noise in config.angle_noise_arcsec}
    found = run.map("sweep of noise", _run_one, (setup, config), tasks)
    errors, steps = (pd.concat(tables, ignore_index=True) for tables in zip(*found.values(), strict=True))
    return {"sweep_errors": errors, "sweep_steps": steps}


def _run_one(shared: tuple[Setup, NoiseSweepConfig], noise: float) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Return errors and steps for one noise, arcsec; machines and random numbers are the same for all."""
    setup, config = shared
    sensors = {
        name: one if one.noise_arcsec is None else one.model_copy(update={"noise_arcsec": noise})
        for name, one in setup.config.sensors.items()
    }
    plans = build_plans(setup.machine, setup.config, sensors)
    measured = measure(plans, setup.pose, setup.targets, config.calibrations, setup.rng(SWEEP))
    found = {
        (plan.name, procedure): simulate(plans, plan, procedure, measured, setup.pose, setup.targets)
        for plan in plans.plans
        for procedure in PROCEDURES
    }
    tables = list_errors(setup, found), list_steps(plans, found)
    for table in tables:
        table.insert(0, "angle_noise_arcsec", noise)
    return tables


# --- root mean squares, ratios and shares, each with its standard error over calibrations ----------------------------


@dataclass(frozen=True)
class Estimate:
    """A number with its standard error over calibrations; NaN where there are none, and of one the error."""

    value: float
    error: float


NOTHING = Estimate(float("nan"), float("nan"))


def rms_of(squares: Array) -> Estimate:
    """Return the root mean square from the mean squares of single calibrations (C,), those without one left out."""
    kept = squares[np.isfinite(squares)]
    if not len(kept):
        return NOTHING
    value = float(np.sqrt(np.mean(kept)))
    return Estimate(value, _error_of_mean(kept) / (2.0 * value))


def ratio_of(before: Array, after: Array) -> Estimate:
    """Return how many times smaller the root mean square is after, from mean squares of the same machines (C,)."""
    kept = np.isfinite(before) & np.isfinite(after)
    if not kept.any():
        return NOTHING
    one, two = before[kept] / np.mean(before[kept]), after[kept] / np.mean(after[kept])
    value = float(np.sqrt(np.mean(before[kept]) / np.mean(after[kept])))
    return Estimate(value, 0.5 * value * _error_of_mean(one - two))


def _error_of_mean(values: Array) -> float:
    return float(np.std(values, ddof=1) / np.sqrt(len(values))) if len(values) > 1 else float("nan")


@dataclass(frozen=True)
class Coverage:
    """How often intervals hold the truth.

    Attributes
    ----------
    share : Estimate
        Over calibrations and quantities; the error counts a calibration once, whose quantities go together.
    lowest, highest : float
        Of single quantities over the calibrations.
    binomial_error : float
        Standard error of a single quantity's share.
    """

    share: Estimate
    lowest: float
    highest: float
    binomial_error: float


def cover(error: Array, spread: Array, quantile: float, level: float) -> Coverage:
    """Return how often errors (C, ...) lie within ``quantile`` stated standard deviations (C, ...).

    Calibrations with an error that is not finite are left out; ``level`` is the share that ought to lie within.
    """
    error, spread = error.reshape(len(error), -1), spread.reshape(len(error), -1)
    kept = np.isfinite(error).all(axis=1)
    inside = np.abs(error[kept]) < quantile * spread[kept]
    by_calibration, by_quantity = inside.mean(axis=1), inside.mean(axis=0)
    n = len(inside)
    share = Estimate(float(inside.mean()), _error_of_mean(by_calibration))
    binomial = float(np.sqrt(level * (1.0 - level) / n))
    return Coverage(share, float(by_quantity.min()), float(by_quantity.max()), binomial)
