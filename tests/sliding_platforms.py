"""Planar platforms on sliding legs that the tests share, and poses about their homes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import studies

from bayescal.machines.read import read_reading_model
from bayescal.machines.readings import FunctionModel
from bayescal.machines.readings.sliding_platform import SlidingPlatform, matrix_of_angle
from bayescal.machines.schema import SlidingPlatformConfig

STAR = studies.EXPERIMENTS / "sliding_star"
SETS = {4: ("s",), 8: ("s", "phi"), 12: ("s", "phi", "psi")}


def sliding_star() -> FunctionModel:
    """Return the shipped machine of four legs."""
    model = read_reading_model(STAR / "machine.toml")
    assert isinstance(model, FunctionModel)
    return model


def star_of(n_legs: int) -> FunctionModel:
    """Return the same with another number of legs, a turn's n-th apart."""
    content = make_content(n_legs)
    for leg in content["legs"]:
        leg |= {"length_mm": 800.0}
    return build(content | {"tool": {"point_mm": [0.0, 0.0]}, "home": {"tool_mm": [0.0, 0.0], "angle_deg": 0.0}})


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
                "direction": points,
            }
        )
    home = {"tool_mm": [3.0, -2.0], "angle_deg": 4.0}
    return {"kind": "sliding_platform", "name": "star", "legs": legs, "tool": {"point_mm": [5.0, 7.0]}, "home": home}


def build(content: dict) -> FunctionModel:
    """Return the machine of a config's content."""
    return FunctionModel("star", SlidingPlatform(SlidingPlatformConfig.model_validate(content)))


def poses_about_home(model: FunctionModel, displacement: np.ndarray) -> np.ndarray:
    """Return poses (P, 3) from displacements of the tool's centre and angle from home (P, 3), mm and rad."""
    home, tool = model.home_pose, model.machine.tool_point
    angle = home[2] + displacement[:, 2]
    centre = home[:2] + matrix_of_angle(home[2:])[0] @ tool
    origin = centre + displacement[:, :2] - np.einsum("pij,j->pi", matrix_of_angle(angle), tool)
    return np.column_stack([origin, angle])


@dataclass(frozen=True)
class Workspace:
    """Half widths about home of the tool's centre and of the platform's angle, and how many poses lie between."""

    n_poses: int = 12
    position_mm: float = 200.0
    angle_deg: float = 30.0

    @property
    def width(self) -> np.ndarray:
        """Half widths of x, y and the angle, mm and rad."""
        return np.array([self.position_mm, self.position_mm, np.radians(self.angle_deg)])

    @property
    def volume(self) -> float:
        """Volume that poses may lie in, mm² rad."""
        return float(np.prod(2 * self.width))

    def draw(self, model: FunctionModel, rng: np.random.Generator) -> np.ndarray:
        """Return poses (P, 3) that the machine reaches."""
        pose = poses_about_home(model, self.width * rng.uniform(-1.0, 1.0, (self.n_poses, 3)))
        model.machine.check_poses(pose)
        return pose


WORKSPACE = Workspace()
