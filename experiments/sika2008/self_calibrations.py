"""Simulated self-calibrations as a kind of experiment: the documented machine, other noise, other machines."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

from bayescal.experiments.runner.experiment import Experiment
from bayescal.experiments.runner.memory import MemoryEstimate, estimate_arrays
from bayescal.experiments.runner.parallel import Run
from bayescal.experiments.runner.results import Results
from bayescal.report.blocks import Page
from sika2008.documented import run_documented, run_sweep
from sika2008.machines import list_correlations, list_machine_steps, run_machines
from sika2008.pages import build_page
from sika2008.published import Published, judge_documented, read_published, summarise_machines
from sika2008.schema import SelfCalibrationsConfig
from sika2008.setup import Setup, platform_of, read_setup
from sika2008.simulate import PAPER

READINGS, AT_ONCE = 8, 16
"""Arrays of all readings, and machines calibrated at a time."""
SUMMARISED = (
    "calibrability",
    "errors",
    "steps",
    "coverage",
    "uncalibrated",
    "judged",
    "machine_summary",
)


class SelfCalibrations(Experiment[SelfCalibrationsConfig, tuple[Setup, Published]]):
    """Self-calibrations of a documented machine and of plausible ones, simulated with sets of sensors."""

    schema = SelfCalibrationsConfig
    digits = 6

    def read(self, config: SelfCalibrationsConfig, folder: Path) -> tuple[Setup, Published]:
        """Return the machine with its sets of sensors, and what was printed."""
        return read_setup(config, folder), read_published(config, folder)

    def estimate_memory(self, inputs: tuple[Setup, Published]) -> MemoryEstimate:
        """Return what the readings of all machines take, and derivatives of those calibrated at a time."""
        setup, machines = inputs[0], inputs[0].config.calibrations
        sensors, n_poses = len(setup.plans.every.sensors.chosen), len(setup.pose) + len(setup.targets)
        return estimate_arrays(
            {"poses": len(setup.pose), "simulated machines": machines},
            [
                (READINGS, machines, n_poses, sensors),
                (READINGS, AT_ONCE, n_poses, sensors, len(setup.plans.every.free.places)),
            ],
            "fewer poses or machines",
        )

    def compute(self, inputs: tuple[Setup, Published], run: Run) -> Results:
        """Return calibrabilities and errors, beside what was printed."""
        return compute_self_calibrations(*inputs, run)

    def page(self, results: Results) -> Page:
        """Return the page."""
        config = self.config_of(results)
        return build_page(config.name, config.title, results.tables, results.summary)


def compute_self_calibrations(setup: Setup, published: Published, run: Run) -> Results:
    """Return all tables of an experiment and its summary."""
    config = setup.config
    names = [plan.name for plan in setup.plans.plans]
    tables = run_documented(setup, run)
    summary: dict[str, Any] = {"name": config.name, "sets": names} | _describe_inputs(setup)
    if config.published is not None:
        summary["source"] = config.published.source
        tables["judged"] = judge_documented(published, tables, PAPER)
    if config.noise_sweep is not None:
        tables |= run_sweep(setup, config.noise_sweep, run)
    if config.machines is not None:
        machines, n_drawn = run_machines(setup, config.machines, run)
        steps = list_machine_steps(machines, names)
        tables |= {"machines": machines, "machine_steps": steps}
        tables["machine_summary"] = summarise_machines(published, machines, steps)
        tables["correlations"] = list_correlations(machines, names)
        summary["machines"] = {
            "kept": config.machines.count,
            "drawn": n_drawn,
            "dropped": n_drawn - config.machines.count,
            "calibrations": config.machines.calibrations,
            "failed": int(machines["n_failed"].sum()),
        }
    records = {name: tables[name].to_dict("records") for name in SUMMARISED if name in tables}
    return Results(replace_nan(summary | records), tables)


def _describe_inputs(setup: Setup) -> dict[str, Any]:
    """Return what the page says of the experiment's inputs."""
    config = setup.config
    sensors = [
        {"sensor": name, "noise": one.noise_um or one.noise_arcsec, "unit": "µm" if one.noise_um else "arcsec"}
        for name, one in config.sensors.items()
    ]
    return {
        "machine": setup.machine.name,
        "n_legs": platform_of(setup.machine).n_legs,
        "calibrations": config.calibrations,
        "n_poses": config.poses.n_poses,
        "verification_poses": config.verification_poses,
        "position_mm": config.poses.position_mm,
        "angle_deg": config.poses.angle_deg,
        "path": config.path.model_dump(),
        "sensors": sensors,
        "tolerances": config.tolerances.model_dump(),
        "ranges": None if config.machines is None else config.machines.model_dump(),
    }


def replace_nan(value: Any) -> Any:
    """Return a JSON-ready value with None for every number that is not finite."""
    if isinstance(value, dict):
        return {key: replace_nan(one) for key, one in value.items()}
    if isinstance(value, list):
        return [replace_nan(one) for one in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
