"""What a study measured, whatever the instrument: its poses, their density under a machine, and what is said of it."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from bayescal.data.instruments.read_points import PointNoise, read_points, read_stations
from bayescal.data.instruments.read_poses import PoseNoise, Taken, read_poses
from bayescal.data.instruments.readings import PointReadings, PoseReadings, check_places, check_units
from bayescal.data.measured_poses import MeasuredPoses, check_repeated
from bayescal.data.photogrammetry.poses import PoseExtraction, check_exchanged, check_pad_places, extract_poses
from bayescal.data.photogrammetry.survey import Survey, read_survey
from bayescal.density.instruments import InstrumentLikelihood
from bayescal.density.legs import Likelihood
from bayescal.density.pose_likelihood import PoseLikelihood
from bayescal.density.priors import NormalPrior, Prior
from bayescal.errors import name_faults
from bayescal.experiments.shared.schema import FramesConfig
from bayescal.experiments.shared.study_schema import (
    InstrumentDataConfig,
    PointDataConfig,
    PoseDataConfig,
    StudyConfig,
    TargetDataConfig,
)
from bayescal.machines.frames import frame_symbols, name_frames
from bayescal.machines.kinematics import Machine
from bayescal.machines.mechanism import Mechanism
from bayescal.numerics.geometry import Array
from bayescal.numerics.units import MICROMETRE


class Measurement(ABC):
    """Measurements at P poses.

    Attributes
    ----------
    names : tuple of str
        Of the poses.
    verification : ndarray of bool, shape (P,)
        Which poses are kept for verification.
    poses : MeasuredPoses
        The poses as measured; NaN where a coordinate is not.
    """

    names: tuple[str, ...]
    verification: np.ndarray
    poses: MeasuredPoses

    @property
    def actuators(self) -> Array:
        """Actuator positions, shape (P, N), mm."""
        return self.poses.actuators

    def frame_priors(self, factor: float = 1.0) -> dict[str, Prior]:
        """Return the priors of the frames that the calibration has to find, wider by a factor; none by default."""
        del factor
        return {}

    @property
    @abstractmethod
    def has_poses(self) -> bool:
        """Whether every pose of the platform in the base frame is measured whole."""

    @abstractmethod
    def likelihood(
        self, machine: Machine, verification: bool, actuator_noise: float, variance: Array | None
    ) -> Likelihood:
        """Return the density of the measurements of one use; arguments as those of `PoseLikelihood`."""

    @abstractmethod
    def describe(self) -> dict[str, Any]:
        """Return entries of the summary that say what was measured."""


@dataclass(frozen=True, eq=False)
class TargetMeasurement(Measurement):
    """Photogrammetry: targets on both bodies, and the poses extracted from them."""

    survey: Survey
    extraction: PoseExtraction
    method: str

    def __post_init__(self) -> None:
        """Take over what all measurements have."""
        object.__setattr__(self, "names", self.survey.poses)
        object.__setattr__(self, "verification", self.survey.verification)
        object.__setattr__(self, "poses", self.extraction.poses)

    @property
    def has_poses(self) -> bool:
        """Always."""
        return True

    def likelihood(
        self, machine: Machine, verification: bool, actuator_noise: float, variance: Array | None
    ) -> PoseLikelihood:
        """Return the density of the extracted poses of one use."""
        return PoseLikelihood(machine, self.poses.select(self.verification == verification), actuator_noise, variance)

    def describe(self) -> dict[str, Any]:
        """Return how the poses were extracted."""
        return {
            "pose_extraction": {
                "method": self.method,
                "chi2_per_dof": self.extraction.chi2_per_dof,
                "dof": self.extraction.dof,
                "n_targets": self.extraction.n_targets,
                "rejected_targets": ["/".join(target) for target in self.extraction.rejected],
            }
        }


@dataclass(frozen=True, eq=False)
class InstrumentMeasurement(Measurement):
    """What an instrument read, its frames known or to be found."""

    kind: str
    instrument: PoseReadings | PointReadings
    verification: np.ndarray
    frames: FramesConfig

    def __post_init__(self) -> None:
        """Take over what all measurements have."""
        object.__setattr__(self, "names", self.instrument.names)
        object.__setattr__(self, "poses", self.instrument.poses)

    def frame_priors(self, factor: float = 1.0) -> dict[str, Prior]:
        """Return normal priors about zero, mm and rad, wider by a factor."""
        priors: dict[str, Prior] = {}
        for name in name_frames(self.instrument.n_stations):
            section = self.frames.tool if name == "tool" else self.frames.base
            if section is not None:
                moved, turned = frame_symbols(name)
                priors |= dict.fromkeys(moved, NormalPrior(0.0, factor * section.position))
                priors |= dict.fromkeys(turned, NormalPrior(0.0, factor * float(np.radians(section.rotation))))
        return priors

    @property
    def has_poses(self) -> bool:
        """Where all coordinates are measured and all frames known."""
        return self.instrument.is_whole() and not self.frame_priors()

    def likelihood(
        self, machine: Machine, verification: bool, actuator_noise: float, variance: Array | None
    ) -> Likelihood:
        """Return the density of the readings of one use; of whole poses in known frames as of any measured poses."""
        chosen = self.verification == verification
        if isinstance(self.instrument, PoseReadings) and self.has_poses:
            return PoseLikelihood(machine, self.poses.select(chosen), actuator_noise, variance)
        return InstrumentLikelihood(machine, self.instrument.select(chosen), actuator_noise, variance)

    def describe(self) -> dict[str, Any]:
        """Return what was read."""
        free = [name for name in ("base", "tool") if getattr(self.frames, name) is not None]
        return {"instrument": {"measurement": self.kind, "free_frames": free, **self.instrument.describe()}}


def name_data(data: InstrumentDataConfig, folder: Path) -> Path:
    """Return the file of the measurements."""
    if isinstance(data, TargetDataConfig):
        return folder / data.targets
    return folder / (data.poses if isinstance(data, PoseDataConfig) else data.points)


def name_actuator_table(data: InstrumentDataConfig, folder: Path) -> Path:
    """Return the file of the actuator positions: that of the measurements where they stand in it."""
    return name_data(data, folder) if data.actuators is None else folder / data.actuators


def read_measurement(config: StudyConfig, folder: Path, mechanism: Mechanism) -> Measurement:
    """Return what a study measured.

    Raises
    ------
    InputError
        For anything at fault in its tables.
    """
    data = config.measured
    if isinstance(data, TargetDataConfig):
        survey = read_survey(folder / data.targets, folder / data.actuators, folder / data.reference, mechanism.n_legs)
        with name_faults(folder / data.reference):
            check_pad_places(survey.platform, mechanism.platform_points)
        with name_faults(folder / data.targets):
            check_exchanged(survey, data.target_noise_um * MICROMETRE)
            check_repeated(survey.poses, survey.platform.measured, survey.verification)
            extraction = extract_poses(survey, data.target_noise_um * MICROMETRE, data.pose_method)
        return TargetMeasurement(survey, extraction, data.pose_method)
    actuators = None if data.actuators is None else folder / data.actuators
    instrument: PoseReadings | PointReadings
    if isinstance(data, PoseDataConfig):
        noise = PoseNoise(data.position_um, data.arcseconds)
        instrument, taken = read_poses(folder / data.poses, actuators, noise, mechanism.n_legs)
    else:
        instrument, taken = _read_points(data, folder, mechanism.n_legs)
    with name_faults(name_data(data, folder)):
        check_repeated(instrument.names, instrument.values, taken.verification)
    return InstrumentMeasurement(data.measurement, instrument, taken.verification, config.frames)


def _read_points(data: PointDataConfig, folder: Path, n_legs: int) -> tuple[PointReadings, Taken]:
    stations = None if data.stations is None else folder / data.stations
    each = data.point_um
    noise = PointNoise(
        () if each is None else tuple(each) if isinstance(each, list) else (each,) * 3,
        data.range_um,
        data.range_ppm,
        data.azimuth_arcsec or 0.0,
        data.elevation_arcsec or 0.0,
    )
    return read_points(folder / data.points, folder / data.probe, stations, folder / data.actuators, noise, n_legs)


def check_measurement(measured: Measurement, machine: Machine, data: InstrumentDataConfig, folder: Path) -> None:
    """Raise InputError where the readings of an instrument cannot be in the units that their table names."""
    if not isinstance(measured, InstrumentMeasurement):
        return
    check_units(machine, measured.instrument, name_data(data, folder))
    if isinstance(data, PointDataConfig) and isinstance(measured.instrument, PointReadings):
        places = read_stations(None if data.stations is None else folder / data.stations).position
        check_places(machine, measured.instrument, places, name_data(data, folder))
