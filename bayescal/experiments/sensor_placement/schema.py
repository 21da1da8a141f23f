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
    always: bool = False


class PlacementPosesConfig(Section):
    """Poses spread evenly at random about home, within half widths.

    Of a planar platform the tool's centre and the angle; of a spatial machine position and rotation vector, three each.
    """

    n_poses: Annotated[int, Field(ge=1, le=10_000)] = 100
    position_mm: Positive | Extent
    angle_deg: Annotated[float, Field(gt=0.0, le=180.0)] | None = None
    rotation_deg: Turns | None = None

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
    model: Annotated[str, ClassMark("MODELS")] | None = None
    deformation: Annotated[str, ClassMark("DEFORMATIONS")] = "none"
    tool_mm: Vector | None = None

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
    machine: PlacementMachineConfig
    tolerances: ReadingTolerancesConfig
    poses: PlacementPosesConfig
    workspace_poses: Annotated[int, Field(ge=4, le=2000)] = 64
    sensors: Sensors
    prices: str = "assumed, in units of the dearest linear encoder"
    frames: Literal["aligned", "given", "instrument"] = "aligned"
    within: Annotated[float, Field(gt=0.0, le=1.0)] = 0.1
    named: dict[str, Annotated[Names, Field(min_length=1)]] = Field(default={})
    simulated_sets: Annotated[int, Field(ge=0, le=100)] = 12
    machines: Annotated[int, Field(ge=2, le=10_000)] = 100
