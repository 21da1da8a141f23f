"""Settings of simulated self-calibrations that the tests share."""

from __future__ import annotations

import numpy as np
import papers  # noqa: F401  # imports the paper's modules
from sliding_platforms import SETS, sliding_star

from sika2008.schema import PosesConfig, SensorConfig, TolerancesConfig
from sika2008.setup import build_sensors, draw_poses, free_parameters

NOISE = {
    "s": SensorConfig(noise_um=1.0),
    "phi": SensorConfig(noise_arcsec=0.5),
    "psi": SensorConfig(noise_arcsec=0.5),
}
TOLERANCES = TolerancesConfig(length_mm=0.3, angle_deg=0.05, zero_deg=2.0)


def make_problem(n_sensors: int = 12, n_poses: int = 40, seed: int = 1, noise=NOISE):
    """Return sensors, free parameters and poses of the shipped machine."""
    model = sliding_star()
    sensors = build_sensors(model, noise, SETS[n_sensors])
    free = free_parameters(model, sensors.names, TOLERANCES)
    config = PosesConfig(n_poses=n_poses, position_mm=200.0, angle_deg=30.0)
    return sensors, free, draw_poses(model, config, np.random.default_rng(seed))
