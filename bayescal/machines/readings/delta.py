"""A linear delta: carriages on three vertical towers, arms to a tool that does not turn, as in 3D printers.

Tower i stands at r_i (cos α_i, sin α_i), the joints' offset of tool and carriage already off its radius r_i, its
carriage carries an arm of length l_i. The nozzle is at height e_i over the bed's centre where carriage i is at its
endstop, which is thus at height E_i = e_i + sqrt(l_i² - r_i²). At the point p = (x, y, z) carriage i is

    s_i = E_i - z - sqrt(l_i² - (x - r_i cos α_i)² - (y - r_i sin α_i)²)

below its endstop: steps from the endstop times the travel of one step. These are the parameters of Klipper's
``delta_radius``, ``angle``, ``arm_length`` and ``position_endstop`` [Klipper, Delta kinematics].

What heights of a flat bed hardly tell apart: radius and arms, for a larger radius with longer arms bends the bed alike;
angles and the arms' differences. Distances between points separate the latter; radius and arms stay a ridge. The
directions of x and y are a convention: one angle stays as stated.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Self

import numpy as np
from pydantic import Field, model_validator

from bayescal.config.sections import Length, Number, Positive, Section
from bayescal.machines.parameters import ParameterBlock
from bayescal.machines.readings.base import Channel, Coordinate, Given
from bayescal.machines.readings.function import Parameters, ReadingMachine
from bayescal.numerics.analytic import sqrt

TOWERS = 3
ARMS = [*((0, k) for k in (1, 2, 3)), *((k, k + TOWERS) for k in (1, 2, 3))]
"""Lines of an outline: from the tool to three joints, and on to what these stand on."""
type EachTower[T] = T | Annotated[list[T], Field(min_length=TOWERS, max_length=TOWERS)]


class RoundWorkspace(Section):
    """Where the tool of a delta has to be accurate."""

    workspace_radius_mm: Positive
    """Radius of the disc where accuracy counts; its largest square is the workspace in x and y."""
    workspace_height_mm: Positive
    """Height over the bed up to which accuracy counts."""


class ToolOverBed(ReadingMachine):
    """A tool that does not turn, whose height over a flat bed a probe reads; its coordinates are x, y and z, mm."""

    tool_channels = tuple(Channel(axis, "mm") for axis in "xyz")

    def __init__(self, config: RoundWorkspace, actuator: str, unit: str) -> None:
        """Lay out coordinates, and channels of three actuators and the probe."""
        super().__init__(config)
        half, height = float(config.workspace_radius_mm / np.sqrt(2.0)), 0.5 * config.workspace_height_mm
        self.coordinates = [
            *(Coordinate(axis, "mm", 0.0, half) for axis in "xy"),
            Coordinate("z", "mm", height, height),
        ]
        channels = [Channel(f"{actuator}[{k}]", unit) for k in range(1, TOWERS + 1)]
        self.channels = [*channels, Channel("height", "mm", external=True)]


class DeltaMachineConfig(RoundWorkspace):
    """A linear delta, as its firmware has it; lengths are one for all towers or one each."""

    radius_mm: EachTower[Length]
    """From the centre to the towers, less what carriage and tool take of it; one each are parameters of their own."""
    arm_mm: EachTower[Length]
    """Lengths of the arms from joint to joint."""
    endstop_mm: EachTower[Number]
    """Height of the tool over the bed's centre where a carriage is at its endstop."""
    angle_deg: Annotated[list[Number], Field(min_length=TOWERS, max_length=TOWERS)] = Field(
        default=[210.0, 330.0, 90.0]
    )
    """Directions of the towers from the centre, counted from x to y."""

    @model_validator(mode="after")
    def _check_arms(self) -> Self:
        arms, radii = spread_over_towers(self.arm_mm), spread_over_towers(self.radius_mm)
        for k, (long, wide) in enumerate(zip(arms, radii, strict=True), start=1):
            if long <= wide:
                raise ValueError(f"arm_mm: found {long:g} of tower {k}, expected more than its radius, {wide:g}")
        return self


class DeltaMachine(ToolOverBed):
    """Carriages below their endstops, and the height that a probe on the tool reads of the bed.

    Parameters: ``r`` (one, or of each tower), ``l`` and ``e``, mm; ``angle``, rad. Coordinates: x, y, z of the
    tool, mm. Channels: ``s``, of each tower, and ``height``, mm.
    """

    Config = DeltaMachineConfig
    member = "tower"

    def __init__(self, config: DeltaMachineConfig) -> None:
        """Lay out parameters, coordinates and channels."""
        super().__init__(config, "s", "mm")
        radius, arm, endstop = (spread_over_towers(one) for one in (config.radius_mm, config.arm_mm, config.endstop_mm))
        self.has_radii = isinstance(config.radius_mm, list)
        self.parameters = [
            ParameterBlock("r", radius if self.has_radii else radius[:1], per_leg=self.has_radii, lower=0.0),
            ParameterBlock("angle", tuple(np.radians(config.angle_deg).tolist()), "rad"),
            ParameterBlock("l", arm, lower=0.0),
            ParameterBlock("e", endstop),
        ]

    def read(self, parameters: Parameters, v: np.ndarray, given: Given) -> np.ndarray:
        """Return how far carriages are below their endstops, and the height."""
        del given
        z = v[..., 2]
        carriages = []
        for k, (radius, arm, (x, y)) in enumerate(self._list_arms(parameters, v)):
            top = parameters["e"][..., k] + sqrt(arm * arm - radius * radius)
            carriages.append(top - z - sqrt(arm * arm - x * x - y * y))
        return np.stack(np.broadcast_arrays(*carriages, z), axis=-1)

    def slopes(self, parameters: Parameters, v: np.ndarray, given: Given) -> Sequence[Sequence[np.ndarray | float]]:
        """Return ∂h/∂v in closed form: with h² = l² - X² - Y² those of a carriage are X/h, Y/h and -1."""
        del given
        rows: list[Sequence[np.ndarray | float]] = []
        for _, arm, (x, y) in self._list_arms(parameters, v):
            rise = sqrt(arm * arm - x * x - y * y)
            rows.append([x / rise, y / rise, -1.0])
        return [*rows, [0.0, 0.0, 1.0]]

    def outline(self, parameters: Parameters, v: np.ndarray) -> tuple[np.ndarray, Sequence[tuple[int, int]]]:
        """Return the tool, the carriages, and the towers' feet at the height of the bed."""
        x, y, z = v[..., 0], v[..., 1], v[..., 2]
        carriages, feet = [], []
        for _, arm, (over_x, over_y) in self._list_arms(parameters, v):
            rise = sqrt(arm * arm - over_x * over_x - over_y * over_y)
            carriages.append([x - over_x, y - over_y, z + rise])
            feet.append([x - over_x, y - over_y, 0.0 * z])
        return stack_points([[x, y, z], *carriages, *feet]), ARMS

    def _list_arms(
        self, parameters: Parameters, v: np.ndarray
    ) -> list[tuple[np.ndarray, np.ndarray, tuple[np.ndarray, np.ndarray]]]:
        """Return radius, arm and the way (X, Y) from tower to tool across it, of each tower, arrays (...)."""
        found = []
        for k in range(TOWERS):
            radius = parameters["r"][..., k] if self.has_radii else parameters["r"]
            angle = parameters["angle"][..., k]
            across = v[..., 0] - radius * np.cos(angle), v[..., 1] - radius * np.sin(angle)
            found.append((radius, parameters["l"][..., k], across))
        return found


def stack_points(points: Sequence[Sequence[np.ndarray]]) -> np.ndarray:
    """Return P points (..., P, 3) of their coordinates."""
    axes = [np.stack(np.broadcast_arrays(*(point[k] for point in points)), axis=-1) for k in range(3)]
    return np.stack(np.broadcast_arrays(*axes), axis=-1)


def spread_over_towers(value: float | list[float]) -> tuple[float, ...]:
    """Return a value of each tower."""
    return tuple(value) if isinstance(value, list) else (value,) * TOWERS
