"""What a study measured, whatever the instrument: its poses, their density under a machine, and what is said of it."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from bayescal.config.load import read_toml
from bayescal.data.actuators import check_range, name_actuators, read_actuators
from bayescal.data.instruments.read_points import (
    PointNoise,
    check_point_columns,
    read_points,
    read_probe,
    read_stations,
)
from bayescal.data.instruments.read_poses import PoseNoise, Taken, check_pose_table, read_poses
from bayescal.data.instruments.readings import PointReadings, PoseReadings, check_places, check_units
from bayescal.data.measured_poses import MeasuredPoses, check_repeated
from bayescal.data.photogrammetry.poses import PoseExtraction, check_exchanged, check_pad_places, extract_poses
from bayescal.data.photogrammetry.survey import Survey, check_reference, check_target_columns, read_survey
from bayescal.density.instruments import InstrumentLikelihood
from bayescal.density.legs import Likelihood
from bayescal.density.pose_likelihood import PoseLikelihood
from bayescal.density.priors import NormalPrior, Prior
from bayescal.errors import InputError, name_faults
from bayescal.experiments.shared.look import look_at_machine
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


# --- each file by itself: reading ends at the first fault, here every file is read as far as it depends on no other -


def list_file_faults(content: Mapping[str, Any], folder: Path) -> list[str]:
    """Return what is wrong with the files that a study's config names, a line each; the config may be at fault."""
    data = content.get("data")
    machine, faults = look_at_machine(content, folder)
    n_legs = _count_legs(content, folder) if machine is None else machine.n_legs
    for check in _list_checks(data if isinstance(data, dict) else {}, folder, n_legs, machine):
        faults += _catch(check)
    return faults


def _catch(check: Callable[[], object]) -> list[str]:
    """Return what a check finds, a line each."""
    try:
        check()
    except InputError as error:
        return list(error.lines)
    return []


def _count_legs(content: Mapping[str, Any], folder: Path) -> int | None:
    """Return how many legs a machine at fault has by the places of its base; None where these do not say."""
    try:
        base = read_toml(folder / str(content.get("machine")))[0].get("base")
    except InputError:
        return None
    places = (base.get("points_mm") or base.get("azimuth_deg")) if isinstance(base, dict) else None
    return len(places) if isinstance(places, list) else None


def _list_checks(
    data: Mapping[str, Any], folder: Path, n_legs: int | None, machine: Mechanism | None
) -> Iterator[Callable[[], object]]:
    """Yield a check of every table; without the number of legs of those that have no columns of legs."""
    tables = {key: folder / value for key, value in data.items() if isinstance(value, str)}
    if n_legs is not None:
        legs = n_legs
        if "actuators" in tables:
            yield lambda: _check_actuators(tables["actuators"], legs, machine)
        if "reference" in tables:
            yield lambda: check_reference(tables["reference"], legs)
        if data.get("measurement") == "poses" and "poses" in tables:
            own = name_actuators(legs)
            yield lambda: check_pose_table(tables["poses"], _read_noise(data), own)
    if data.get("measurement", "targets") == "targets" and "targets" in tables:
        yield lambda: check_target_columns(tables["targets"])
    if data.get("measurement") == "points" and "points" in tables:
        yield lambda: check_point_columns(tables["points"], "stations" in tables)
    if "probe" in tables:
        yield lambda: read_probe(tables["probe"])
    if "stations" in tables:
        yield lambda: read_stations(tables["stations"])


def _check_actuators(path: Path, n_legs: int, machine: Mechanism | None) -> None:
    """Raise InputError for a table of actuator positions that is none, or that its machine does not reach."""
    names, _, actuators = read_actuators(path, n_legs)
    if machine is not None:
        with name_faults(path):
            check_range(actuators, machine.initial_actuator_positions, machine.actuator_range, names)


def _read_noise(data: Mapping[str, Any]) -> PoseNoise:
    """Return a noise of poses where the config states any, whatever its size: the config itself answers for that."""
    stated = ("position_", "orientation_")
    return PoseNoise(*(1.0 if any(key.startswith(begin) for key in data) else None for begin in stated))
