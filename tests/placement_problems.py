"""Small problems of sensor placement that the tests share."""

from __future__ import annotations

from functools import cache

import studies

from bayescal.experiments.frame.load import load_experiment
from bayescal.experiments.sensor_placement.inputs import PlacementInputs, read_placement
from bayescal.experiments.sensor_placement.schema import PlacementConfig

FOLDER = studies.EXPERIMENTS / "sliding_star"
SHIPPED = ("sensors", "m2_hexapod_sensors")
TINY = {"workspace_poses": 8, "machines": 4, "simulated_sets": 3}


@cache
def shrink(name: str, **update: object) -> PlacementConfig:
    """Return a shipped config with few poses and little to choose from."""
    config = load_experiment(FOLDER / f"{name}.toml")
    assert isinstance(config, PlacementConfig)
    few = {"poses": config.poses.model_copy(update={"n_poses": 20})}
    if name == "m2_hexapod_sensors":
        tilt, tracker = config.sensors["tilt_a"], config.sensors["tracker_position"]
        names = ("tilt_a[1]", "tilt_b[1]", "tilt_a[4]", "tilt_b[4]")
        few["sensors"] = {
            "rho": config.sensors["rho"],
            **dict.fromkeys(names, tilt),
            "tracker_position": tracker,
        }
        few["named"] = {"encoders alone": ["rho"], "laser tracker": ["tracker_position"]}
    return config.model_copy(update={**few, **TINY, **update})


@cache
def read(name: str, **update: object) -> PlacementInputs:
    """Return what a shrunk config computes with."""
    return read_placement(shrink(name, **update), FOLDER)
