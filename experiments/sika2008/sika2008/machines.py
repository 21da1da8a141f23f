"""Many plausible machines instead of the documented one: which figures are the machine's and which the sensors'."""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from itertools import pairwise

import numpy as np
import pandas as pd

from bayescal.errors import InputError, NumericalError
from bayescal.experiments.runner.parallel import Run
from bayescal.machines.readings import FunctionModel
from bayescal.machines.readings.sliding_platform import SlidingPlatform
from bayescal.machines.schema import SlidingPlatformConfig
from bayescal.numerics.geometry import Array
from sika2008.documented import name_parts, rms_of, squares_of
from sika2008.schema import PlausibleMachinesConfig, PosesConfig
from sika2008.sensors import FreeParameters, compute_calibrability
from sika2008.setup import MACHINES, ZEROS, Plan, Plans, Setup, build_plans, draw_poses, platform_of
from sika2008.simulate import PAPER, Measured, measure, predict_covariance, predict_tool, simulate

GEOMETRY = (
    "guide_radius_mm",
    "guide_turn_deg",
    "leg_length_mm",
    "platform_radius_mm",
    "platform_turn_deg",
    "position_mm",
    "angle_deg",
)
MOST_DRAWS = 50  # for each machine wanted
UNITS = ("metres_radians", "millimetres_radians", "millimetres_degrees", "scaled")
PREDICTORS = (*UNITS, "scaled_alike", "tool_predicted")


@dataclass(frozen=True, eq=False)
class Candidate:
    """A machine drawn from the ranges, with what it is measured at.

    Attributes
    ----------
    geometry : dict of str to float
        By `GEOMETRY`.
    machine : FunctionModel
        Of a `SlidingPlatform`.
    plans : Plans
    pose, targets : ndarray, shapes (P, 3) and (V, 3)
    measured : Measured
    angle_tolerance : float
        Of guide angles, rad.
    """

    geometry: dict[str, float]
    machine: FunctionModel
    plans: Plans
    pose: Array
    targets: Array
    measured: Measured
    angle_tolerance: float


def run_machines(setup: Setup, config: PlausibleMachinesConfig, run: Run) -> tuple[pd.DataFrame, int]:
    """Return a row for each machine and set, and how many machines were drawn in all.

    Raises
    ------
    InputError
        Where too few of the machines reach their poses without crossed legs.
    """
    candidates: list[Candidate] = []
    n_drawn = 0
    while len(candidates) < config.count:
        if n_drawn == MOST_DRAWS * config.count:
            raise InputError(
                f"machines: found {len(candidates)} in {n_drawn} draws that reach their poses without crossed legs, "
                f"expected {config.count}"
            )
        one = draw_candidate(setup, config, setup.rng(MACHINES, n_drawn))
        candidates += [] if one is None else [one]
        n_drawn += 1
    tasks = {f"{k + 1}": one for k, one in enumerate(candidates)}
    judged = run.map("plausible machines", _judge, None, tasks)
    table = pd.DataFrame([{"machine": k + 1} | row for k, found in enumerate(judged.values()) for row in found])
    return table, n_drawn


def draw_candidate(setup: Setup, config: PlausibleMachinesConfig, rng: np.random.Generator) -> Candidate | None:
    """Return a machine, None where it, or one within its tolerances, cannot take its poses or legs cross there."""
    geometry = {name: float(rng.uniform(*getattr(config, name))) for name in GEOMETRY}
    workspace = {"position_mm": geometry["position_mm"], "angle_deg": geometry["angle_deg"]}
    try:
        machine = FunctionModel("drawn", SlidingPlatform(lay_out(geometry, platform_of(setup.machine).n_legs)))
        numbers = (setup.config.poses.n_poses, setup.config.verification_poses)
        pose, targets = (draw_poses(machine, PosesConfig(n_poses=n, **workspace), rng) for n in numbers)
        plans = build_plans(machine, setup.config, setup.config.sensors)
        measured = measure(plans, pose, targets, config.calibrations, rng)
    except InputError:
        return None
    return Candidate(
        geometry, machine, plans, pose, targets, measured, float(np.radians(setup.config.tolerances.angle_deg))
    )


def lay_out(geometry: dict[str, float], n_legs: int) -> SlidingPlatformConfig:
    """Return a machine with guides evenly about a circle, near its tangents, and a platform with joints on another."""
    legs = []
    for azimuth in 360.0 * np.arange(n_legs) / n_legs:
        guide, joint = np.radians(azimuth), np.radians(azimuth + geometry["platform_turn_deg"])
        turn = float(azimuth + 90.0 + geometry["guide_turn_deg"])
        legs.append(
            {
                "guide_point_mm": [float(geometry["guide_radius_mm"] * f(guide)) for f in (np.cos, np.sin)],
                "guide_angle_deg": turn - 360.0 if turn > 180.0 else turn,
                "length_mm": geometry["leg_length_mm"],
                "platform_point_mm": [float(geometry["platform_radius_mm"] * f(joint)) for f in (np.cos, np.sin)],
            }
        )
    content = {"kind": "sliding_platform", "name": "drawn", "legs": legs, "tool": {"point_mm": [0.0, 0.0]}}
    return SlidingPlatformConfig.model_validate(content | {"home": {"tool_mm": [0.0, 0.0], "angle_deg": 0.0}})


def _judge(_: None, one: Candidate) -> list[dict[str, object]]:
    return judge_candidate(one)


def judge_candidate(one: Candidate) -> list[dict[str, object]]:
    """Return of each set calibrabilities and errors by the paper's procedure, mm and rad."""
    parts, rows = name_parts(one.plans.plans), []
    for plan in one.plans.plans:
        row: dict[str, object] = {"set": plan.name, **one.geometry}
        row |= asdict(compute_calibrability(plan.sensors, plan.free, one.pose))
        alike = _count_zeros_alike(plan, one.angle_tolerance)
        row["scaled_alike"] = compute_calibrability(plan.sensors, alike, one.pose).scaled
        row["tool_predicted"] = predict_tool(plan, predict_covariance(plan, one.pose), one.targets)
        try:
            found = simulate(one.plans, plan, PAPER, one.measured, one.pose, one.targets)
        except NumericalError:
            row |= {"lengths": np.nan, "guide_angles": np.nan, "tool": np.nan, "n_failed": len(one.measured.theta)}
        else:
            row |= {q: rms_of(squares_of(found, q, parts)).value for q in (*parts, "tool")}
            row["n_failed"] = int((~found.good).sum())
        rows.append(row)
    return rows


def _count_zeros_alike(plan: Plan, tolerance: float) -> FreeParameters:
    """Return what a plan frees, zeros of angle sensors known a priori as well as guide angles are."""
    zero = np.array([name.partition("[")[0] in ZEROS for name in plan.parameters])
    return replace(plan.free, scale=np.where(zero, tolerance, plan.free.scale))


def list_machine_steps(table: pd.DataFrame, names: list[str]) -> pd.DataFrame:
    """Return by which factors C and errors fall from each set to the next, a row for each machine and step."""
    quantities = [*UNITS, "lengths", "guide_angles", "tool"]
    by_set = {name: rows.set_index("machine")[quantities] for name, rows in table.groupby("set")}
    parts = []
    for before, after in pairwise(names):
        ratio = (by_set[before] / by_set[after]).reset_index()
        ratio.insert(0, "from", before)
        ratio.insert(1, "to", after)
        parts.append(ratio)
    return pd.concat(parts, ignore_index=True) if parts else pd.DataFrame()


def list_correlations(table: pd.DataFrame, names: list[str]) -> pd.DataFrame:
    """Return how well C, and the error predicted to first order, tell the tool's and the parameters' error.

    Correlations of logarithms over the machines, of each set alone and of all sets together; the power with which
    errors rise, and the factor by which they scatter about it.
    """
    rows = []
    for name in (*names, "all"):
        ours = table if name == "all" else table[table["set"] == name]
        for predictor in PREDICTORS:
            for quantity in ("tool", "lengths"):
                x, y = (np.log(ours[column].to_numpy(dtype=float)) for column in (predictor, quantity))
                good = np.isfinite(x) & np.isfinite(y)
                r = float(np.corrcoef(x[good], y[good])[0, 1])
                power, level = np.polyfit(x[good], y[good], 1)
                scatter = float(np.exp(np.std(y[good] - power * x[good] - level, ddof=2)))
                row = {"set": name, "predictor": predictor, "of": quantity, "correlation": r}
                rows.append(row | {"power": float(power), "scatter": scatter, "n": int(good.sum())})
    return pd.DataFrame(rows)
