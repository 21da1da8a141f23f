"""Planar platforms on sliding legs that the tests share."""

from __future__ import annotations

import re
import shutil
from pathlib import Path

import numpy as np
import studies

from bayescal.machines.read import build_sliding_platform, read_sliding_platform
from bayescal.machines.readings import SlidingPlatform
from bayescal.machines.readings.schema import (
    PlanarPosesConfig,
    ReadingSensorConfig,
    ReadingTolerancesConfig,
    SlidingPlatformConfig,
)
from bayescal.reproductions.sika2008.reading_machine import build_sensors, draw_poses, free_parameters

STAR = studies.EXPERIMENTS / "sliding_star"
NOISE = {
    "s": ReadingSensorConfig(noise_um=1.0),
    "phi": ReadingSensorConfig(noise_arcsec=0.5),
    "psi": ReadingSensorConfig(noise_arcsec=0.5),
}
TOLERANCES = ReadingTolerancesConfig(length_mm=0.3, angle_deg=0.05, zero_deg=2.0)
SETS = {4: ["s"], 8: ["s", "phi"], 12: ["s", "phi", "psi"]}


def read_star() -> SlidingPlatform:
    """Return the shipped machine."""
    return read_sliding_platform(STAR / "machine.toml")


def make_content(n_legs: int, points: str = "along", turn_deg: float = 0.0) -> dict:
    """Return the content of a star with N legs, each along its guide or against it."""
    legs = []
    for leg in range(n_legs):
        azimuth = 2.0 * np.pi * leg / n_legs
        legs.append(
            {
                "guide_point_mm": [600.0 * float(np.cos(azimuth)), 600.0 * float(np.sin(azimuth))],
                "guide_angle_deg": float((np.degrees(azimuth) + 90.0 + turn_deg + 180.0) % 360.0 - 180.0),
                "length_mm": 800.0 + 10.0 * leg,
                "platform_point_mm": [100.0 * float(np.cos(azimuth)), 100.0 * float(np.sin(azimuth))],
                "points": points,
            }
        )
    home = {"tool_mm": [3.0, -2.0], "angle_deg": 4.0}
    return {"kind": "sliding_platform", "name": "star", "legs": legs, "tool": {"point_mm": [5.0, 7.0]}, "home": home}


def build(content: dict) -> SlidingPlatform:
    """Return the machine of a config's content."""
    return build_sliding_platform(SlidingPlatformConfig.model_validate(content))


def make_problem(n_sensors: int = 12, n_poses: int = 40, seed: int = 1, noise=NOISE):
    """Return sensors, free parameters and poses of the shipped machine."""
    model = read_star()
    sensors = build_sensors(model, noise, SETS[n_sensors])
    free = free_parameters(model, sensors.names, TOLERANCES)
    config = PlanarPosesConfig(n_poses=n_poses, position_mm=200.0, angle_deg=30.0)
    return sensors, free, draw_poses(model, config, np.random.default_rng(seed))


TINY = {
    "calibrations": "6",
    "verification_poses": "5",
    "n_poses": "20",
    "count": "3",
    "angle_noise_arcsec": "[0.5, 2.0]",
}


def copy_tiny(folder: Path) -> Path:
    """Copy the shipped experiments to a folder and give that of many calibrations little to do; return its config."""
    shutil.copytree(STAR, folder / "sliding_star")
    path = folder / "sliding_star" / "calibrations.toml"
    text = path.read_text()
    for key, value in TINY.items():
        text = re.sub(rf"^{key} = .*$", f"{key} = {value}", text, flags=re.MULTILINE)
    path.write_text(text)
    return path
