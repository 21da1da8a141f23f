"""The schema of an experiment on sensor placement. Keys carry their units; prices are whatever the config says."""

from __future__ import annotations

from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from bayescal.config.classes import ClassMark
from bayescal.config.sections import ExperimentConfig, InputFile, Names, Positive, Section, Vector
from bayescal.experiments.shared.schema import Extent, Turns
from bayescal.machines.readings.schema import ReadingSensorConfig, ReadingTolerancesConfig

type Sensors = Annotated[dict[str, PlacementSensorConfig], Field(min_length=1)]


class PlacementSensorConfig(ReadingSensorConfig):
    """A sensor, or one on every leg.

    ``reads`` makes one instrument of several readings, bought and priced together. What is ``always`` there is in
    every set.
    """

    reads: Annotated[Names, Field(min_length=1)] | None = None
    """Readings that are bought together as one instrument; what the sensor's name says where nothing is said."""
    always: bool = False
    """Whether it is in every set."""


class PlacementPosesConfig(Section):
    """Poses spread evenly at random about home, within half widths.

    Of a planar platform the tool's centre and the angle; of a spatial machine position and rotation vector, three each.
    """

    n_poses: Annotated[int, Field(ge=1, le=10_000)] = 100
    """Number of poses."""
    position_mm: Positive | Extent
    """Half width of the tool's centre (planar), or three of the position."""
    angle_deg: Annotated[float, Field(gt=0.0, le=180.0)] | None = None
    """Half width of a planar platform's angle."""
    rotation_deg: Turns | None = None
    """Half widths of the rotation vector."""

    @model_validator(mode="after")
    def _check_dimension(self) -> Self:
        planar = isinstance(self.position_mm, float) and self.angle_deg is not None and self.rotation_deg is None
        spatial = isinstance(self.position_mm, list) and self.rotation_deg is not None and self.angle_deg is None
        if not planar and not spatial:
            raise ValueError("expected position_mm with angle_deg, or three position_mm with three rotation_deg")
        return self


class PlacementMachineConfig(Section):
    """A machine's file: of a planar platform on sliding legs, or of a mechanism seen through a kinematic model."""

    file: InputFile
    """The machine's TOML file."""
    model: Annotated[str, ClassMark("MODELS")] | None = None
    """Kinematic model of a mechanism; none for a planar platform on sliding legs."""
    deformation: Annotated[str, ClassMark("DEFORMATIONS")] = "none"
    """Deformation of the platform."""
    tool_mm: Vector | None = None
    """The tool on the platform; the platform's origin where nothing is said."""

    @model_validator(mode="after")
    def _check_model(self) -> Self:
        if self.model is None and (self.deformation != "none" or self.tool_mm is not None):
            raise ValueError("found deformation or tool_mm without model, expected a model of a mechanism with them")
        return self


class PlacementConfig(ExperimentConfig):
    """Which sensors to buy: every set of those listed, calibrated with the same poses.

    ``frames``: what a machine's frames mean. ``aligned``: table and tool are set up once after the calibration, and
    what a motion of either would mend counts as no error; ``given``: those of the first legs, exact beforehand;
    ``instrument``: those of an instrument beside the machine.
    """

    kind: Literal["sensor_placement"]
    """`"sensor_placement"`."""
    machine: PlacementMachineConfig
    """The machine."""
    tolerances: ReadingTolerancesConfig
    """How far dimensions may be off."""
    poses: PlacementPosesConfig
    """Poses to calibrate with."""
    workspace_poses: Annotated[int, Field(ge=4, le=2000)] = 64
    """How many poses stand for the workspace."""
    sensors: Sensors
    """Sensors to choose from, with noise and price."""
    prices: str = "assumed, in units of the dearest linear encoder"
    """What the page says of the prices."""
    frames: Literal["aligned", "given", "instrument"] = "aligned"
    """What frames mean: `aligned` once after the calibration, `given` by the first legs, or those of an
    `instrument`.
    """
    within: Annotated[float, Field(gt=0.0, le=1.0)] = 0.1
    """How near to the most accurate set a cheaper one is good enough, as a share of its error [1]."""
    named: dict[str, Annotated[Names, Field(min_length=1)]] = Field(default={})
    """Sets that are judged by name."""
    simulated_sets: Annotated[int, Field(ge=0, le=100)] = 12
    """How many sets are tried by simulated calibrations."""
    machines: Annotated[int, Field(ge=2, le=10_000)] = 100
    """How many machines each is tried on."""
