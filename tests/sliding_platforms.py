"""Planar platforms on sliding legs that the tests share, and poses about their homes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import studies

from bayescal.machines.read import build_sliding_platform, read_sliding_platform
from bayescal.machines.readings import SlidingPlatform
from bayescal.machines.readings.schema import SlidingPlatformConfig
from bayescal.machines.readings.sliding_platform import matrix_of_angle

STAR = studies.EXPERIMENTS / "sliding_star"
SETS = {4: ("s",), 8: ("s", "phi"), 12: ("s", "phi", "psi")}


def sliding_star() -> SlidingPlatform:
    """Return the shipped machine of four legs."""
    return read_sliding_platform(STAR / "machine.toml")


def star_of(n_legs: int) -> SlidingPlatform:
    """Return the same with another number of legs, a turn's n-th apart."""
    around = 2 * np.pi * np.arange(n_legs) / n_legs
    ring = np.stack([np.cos(around), np.sin(around)], axis=1)
    first, second = 100.0 * ring[:2]
    along = (second - first) / np.linalg.norm(second - first)
    own = np.array([along, [-along[1], along[0]]])
    points = (100.0 * ring - first) @ own.T
    home = np.array([*first, np.arctan2(along[1], along[0])])
    ahead = np.full(n_legs, True)
    legs = np.full(n_legs, 800.0)
    return SlidingPlatform("star", 600.0 * ring, around + np.pi / 2, legs, points, -own @ first, home, ahead)


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


def poses_about_home(model: SlidingPlatform, displacement: np.ndarray) -> np.ndarray:
    """Return poses (P, 3) from displacements of the tool's centre and angle from home (P, 3), mm and rad."""
    angle = model.home[2] + displacement[:, 2]
    home = model.home[:2] + matrix_of_angle(model.home[2:])[0] @ model.tool_point
    origin = home + displacement[:, :2] - np.einsum("pij,j->pi", matrix_of_angle(angle), model.tool_point)
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

    def draw(self, model: SlidingPlatform, rng: np.random.Generator) -> np.ndarray:
        """Return poses (P, 3) that the machine reaches."""
        pose = poses_about_home(model, self.width * rng.uniform(-1.0, 1.0, (self.n_poses, 3)))
        model.check_poses(pose)
        return pose


WORKSPACE = Workspace()
