"""How the improvement from set to set depends on the noise of the angle sensors, which the paper does not state."""

from __future__ import annotations

import pandas as pd

from bayescal.experiments.frame.parallel import Run
from bayescal.reproductions.sika2008.documented import list_errors, list_steps, simulate_all
from bayescal.reproductions.sika2008.schema import NoiseSweepConfig
from bayescal.reproductions.sika2008.setup import SWEEP, Setup, build_plans
from bayescal.reproductions.sika2008.simulate import measure


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
    found = simulate_all(setup, plans, measured, Run())
    tables = list_errors(setup, found), list_steps(plans, found)
    for table in tables:
        table.insert(0, "angle_noise_arcsec", noise)
    return tables
