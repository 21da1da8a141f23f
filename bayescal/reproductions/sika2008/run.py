"""Running an experiment of simulated self-calibrations: tables, figures and page, put in place as a whole."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import joblib
import pandas as pd

from bayescal.experiments.frame.run import identify_experiment, publish
from bayescal.experiments.frame.store import Store
from bayescal.reproductions.sika2008.documented import run_documented
from bayescal.reproductions.sika2008.machines import list_correlations, list_machine_steps, run_machines
from bayescal.reproductions.sika2008.page.pages import build_page
from bayescal.reproductions.sika2008.published import (
    Published,
    judge_documented,
    read_published,
    summarise_machines,
)
from bayescal.reproductions.sika2008.schema import SelfCalibrationsConfig
from bayescal.reproductions.sika2008.setting import Setting, read_setting
from bayescal.reproductions.sika2008.simulate import PAPER
from bayescal.reproductions.sika2008.sweep import run_sweep

SUMMARISED = (
    "calibrability",
    "errors",
    "steps",
    "coverage",
    "uncalibrated",
    "judged",
    "machine_summary",
)

type Tables = dict[str, pd.DataFrame]


def run_self_calibrations(config: SelfCalibrationsConfig, folder: Path, out: Path, workers: int | None = None) -> str:
    """Run an experiment, put tables, figures and the page in ``out`` and return a summary of a few lines.

    Parameters
    ----------
    config : SelfCalibrationsConfig
    folder : Path
        Where the config's file names start.
    out : Path
        Results directory; all of them or nothing.
    workers : int, optional
        Processes; one per core by default. The results do not depend on it.
    """
    setting, published = read_setting(config, folder), read_published(config, folder)
    identity = identify(config, folder)
    store = Store(out)
    store.check_results(identity)
    tables, summary = compute(setting, published, workers or joblib.cpu_count())
    page = build_page(config.name, config.title, tables, summary)
    return publish(store, identity, tables, replace_nan(summary), page)


def compute(setting: Setting, published: Published, workers: int) -> tuple[Tables, dict[str, Any]]:
    """Return all tables of an experiment and its summary, which is JSON-ready but for NaN."""
    config = setting.config
    names = [plan.name for plan in setting.plans.plans]
    tables = run_documented(setting, workers)
    summary: dict[str, Any] = {"name": config.name, "sets": names} | _describe_inputs(setting)
    if config.published is not None:
        summary["source"] = config.published.source
        tables["judged"] = judge_documented(published, tables, PAPER)
    if config.noise_sweep is not None:
        tables |= run_sweep(setting, config.noise_sweep, workers)
    if config.machines is not None:
        machines, n_drawn = run_machines(setting, config.machines, workers)
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
    return tables, summary | {name: tables[name].to_dict("records") for name in SUMMARISED if name in tables}


def _describe_inputs(setting: Setting) -> dict[str, Any]:
    """Return what the page says of the experiment's inputs."""
    config = setting.config
    sensors = [
        {"sensor": name, "noise": one.noise_um or one.noise_arcsec, "unit": "µm" if one.noise_um else "arcsec"}
        for name, one in config.sensors.items()
    ]
    return {
        "machine": setting.machine.name,
        "n_legs": setting.machine.n_legs,
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


def identify(config: SelfCalibrationsConfig, folder: Path) -> dict[str, Any]:
    """Return what determines the results."""
    section = config.published
    published = [] if section is None else [section.calibrability, section.improvements]
    return identify_experiment(config, folder, [config.machine, *published])
