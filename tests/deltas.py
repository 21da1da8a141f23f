"""Deltas and a five-bar as firmwares see them: machines whose arms differ, and where three carriages lead."""

from __future__ import annotations

import numpy as np

from bayescal.machines.readings.delta import DeltaMachine, DeltaMachineConfig
from bayescal.machines.readings.five_bar import FiveBar, FiveBarConfig
from bayescal.machines.readings.rotary_delta import RotaryDelta, RotaryDeltaConfig


def build_delta() -> DeltaMachine:
    """Return a linear delta whose towers, arms and endstops differ."""
    own = {"radius_mm": [118.0, 121.0, 120.5], "arm_mm": [280.0, 281.0, 279.0], "endstop_mm": [300.0, 301.5, 299.0]}
    space = {"workspace_radius_mm": 90.0, "workspace_height_mm": 150.0}
    return DeltaMachine(DeltaMachineConfig(**own, angle_deg=[211.0, 329.0, 90.0], **space))


def build_rotary_delta() -> RotaryDelta:
    """Return a rotary delta whose arms differ."""
    own = {"radius_mm": 80.0, "height_mm": 380.0, "upper_arm_mm": [170.0, 171.0, 169.0], "lower_arm_mm": 320.0}
    space = {"workspace_radius_mm": 120.0, "workspace_height_mm": 80.0}
    return RotaryDelta(RotaryDeltaConfig(**own, angle_deg=[31.0, 149.0, 270.0], **space))


def build_five_bar(**more: object) -> FiveBar:
    """Return a five-bar whose arms differ, its elbows outwards."""
    own = {"motors_mm": [[-50.0, 2.0], [50.0, 0.0]], "crank_mm": [180.0, 182.0], "coupler_mm": [240.0, 239.0]}
    space = {"zero_deg": [160.0, 20.0], "workspace_mm": [[-90.0, 90.0], [180.0, 320.0]]}
    return FiveBar(FiveBarConfig(**own | space | more))


def trilaterate(centre: np.ndarray, arm: np.ndarray) -> np.ndarray:
    """Return the lower point at distances arm (3,) from centres (3, 3), as firmwares compute where carriages lead."""
    first, second, third = centre
    along = (second - first) / np.linalg.norm(second - first)
    aside = third - first - along * (along @ (third - first))
    width, start = np.linalg.norm(aside), along @ (third - first)
    aside, long = aside / width, np.linalg.norm(second - first)
    x = (arm[0] ** 2 - arm[1] ** 2 + long**2) / (2.0 * long)
    y = (arm[0] ** 2 - arm[2] ** 2 + start**2 + width**2 - 2.0 * start * x) / (2.0 * width)
    up = np.cross(along, aside)
    return first + x * along + y * aside - np.sign(up[2]) * up * np.sqrt(arm[0] ** 2 - x**2 - y**2)
