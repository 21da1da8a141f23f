"""What an instrument measured of a platform on legs, as readings of channels: targets, poses or tracked points."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
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
from bayescal.data.instruments.read_poses import PoseNoise, PoseRecords, check_pose_table, read_poses
from bayescal.data.instruments.readings import TrackedPoints, TrackedReadings, turn_of
from bayescal.data.measured_poses import MeasuredPoses, check_repeated
from bayescal.data.photogrammetry.poses import PoseExtraction, check_exchanged, check_pad_places, extract_poses
from bayescal.data.photogrammetry.survey import Survey, check_target_columns, read_reference, read_survey
from bayescal.density.schema import NormalConfig, PriorConfig
from bayescal.errors import InputError, name_faults
from bayescal.experiments.shared.readings.machine_kind import look_at_machine
from bayescal.experiments.shared.readings.reading_tables import PoseReadings
from bayescal.experiments.shared.readings.schema import ChannelConfig
from bayescal.experiments.shared.schema import FramesConfig, UnitsConfig
from bayescal.experiments.shared.study_schema import (
    InstrumentDataConfig,
    PointDataConfig,
    PoseDataConfig,
    StudyConfig,
    TargetDataConfig,
)
from bayescal.machines.mechanism import Mechanism
from bayescal.machines.readings import Instrument, Tracker
from bayescal.machines.readings.base import POSE_CHANNELS
from bayescal.machines.readings.tracker import frame_symbols, name_frames
from bayescal.numerics.geometry import Array
from bayescal.numerics.units import MICROMETRE, Units


@dataclass(frozen=True, eq=False)
class Measured:
    """What an instrument measured of a platform on legs, as readings of the legs' channels and of its own."""

    readings: PoseReadings  # of actuators, then of poses; of a tracker's channels instead of these where there is one
    # poses of the platform as measured, all frames as they should be; NaN where a coordinate is not
    poses: MeasuredPoses
    described: dict[str, Any]  # entries of the summary that say what was measured
    # an instrument whose frames have to be found, or that sees points which tell no whole pose
    tracker: Tracker | None = None
    # what is known of its frames, in the units of a config
    parameters: dict[str, PriorConfig] = field(default_factory=dict)
    tracked: TrackedReadings | None = None  # what it tracked, but for targets
    targets: TargetMeasurement | None = None  # the photogrammetry

    @property
    def verification(self) -> np.ndarray:
        """Which poses are kept for verification, shape (P,)."""
        return self.readings.verification

    @property
    def instruments(self) -> dict[str, Instrument]:
        """The tracker, whose parameters have names of their own."""
        return {} if self.tracker is None else {"": self.tracker}

    def translate(self, config: StudyConfig) -> StudyConfig:
        """Return a config of tables of readings that says the same of noise, frames and variants."""
        variants = [
            one if one.free is None else one.model_copy(update={"free": [*one.free, *self.parameters]})
            for one in config.variants
        ]
        known, stated = dict(config.parameters) | self.parameters, state_noise(config)
        channels = POSE_CHANNELS if self.tracker is None else tuple(self.tracker.channels)
        places = range(self.poses.actuators.shape[1], self.readings.values.shape[1])
        sensors = dict(stated.sensors)
        for kind in dict.fromkeys(one.kind for one in channels):  # stated row by row, here for who asks for one number
            own = [k for k, one in zip(places, channels, strict=True) if one.kind == kind]
            sd = self.readings.sd[:, own]
            if not np.isfinite(sd).any():  # of poses measured in part
                continue
            rms = float(np.sqrt(np.nanmean(sd**2)))
            length = next(one.unit for one in channels if one.kind == kind) == "mm"
            sensors[kind] = ChannelConfig(noise_mm=rms) if length else ChannelConfig(noise_rad=rms)
        return stated.model_copy(update={"parameters": known, "variants": variants, "sensors": sensors})


def state_noise(config: StudyConfig) -> StudyConfig:
    """Return a config that states the noise of the actuators by channel; one of tables of readings as it is."""
    if config.by_tables:
        return config
    return config.model_copy(update={"sensors": {"rho": ChannelConfig(noise_um=config.measured.actuator_noise_um)}})


@dataclass(frozen=True, eq=False)
class TargetMeasurement:
    """Photogrammetry: targets on both bodies, the poses extracted from them, and when they were taken."""

    survey: Survey
    extraction: PoseExtraction
    noise: float
    """Standard deviation of a target's coordinate, mm."""


def _read_whole(poses: MeasuredPoses, verification: np.ndarray) -> PoseReadings:
    """Return actuators and poses, in known frames, as readings of legs' channels."""
    values = np.concatenate([poses.position, turn_of(poses.rotation)], axis=1)
    return _gather(poses.names, verification, poses.actuators, [(values, poses.covariance)])


def _gather(
    names: Sequence[str], verification: np.ndarray, actuators: Array, blocks: Sequence[tuple[Array, Array]]
) -> PoseReadings:
    """Return commanded actuators (P, N), whose noise a config states, and blocks of readings with their covariances."""
    values = np.concatenate([actuators, *(own for own, _ in blocks)], axis=1)
    n_poses, n = values.shape
    sd, correlation = np.full((n_poses, n), np.nan), np.tile(np.eye(n), (n_poses, 1, 1))
    start = actuators.shape[1]
    for own, covariance in blocks:
        end, there = start + own.shape[1], np.isfinite(own)
        known = np.where(there[:, :, None] & there[:, None, :], covariance, np.eye(own.shape[1]))
        size = np.sqrt(np.diagonal(known, axis1=-2, axis2=-1))
        sd[:, start:end] = np.where(there, size, np.nan)
        correlation[:, start:end, start:end] = known / (size[:, :, None] * size[:, None, :])
        start = end
    commanded = np.zeros((n_poses, n), dtype=bool)
    commanded[:, : actuators.shape[1]] = True
    apart = not (np.abs(correlation) * ~np.eye(n, dtype=bool)).any()
    return PoseReadings(tuple(map(str, names)), verification, values, sd, None if apart else correlation, commanded)


def _know_frames(n_stations: int, frames: FramesConfig, section: UnitsConfig) -> dict[str, PriorConfig]:
    """Return what is known of the frames that have to be found, in a config's units."""
    units, found = Units(section.length, section.angle), dict[str, PriorConfig]()
    for name in name_frames(n_stations):
        known = frames.tool if name == "tool" else frames.base
        if known is not None:
            moved, turned = frame_symbols(name)
            found |= dict.fromkeys(moved, NormalConfig(prior="normal", sd=known.position / units.factor("mm")))
            angle = float(np.radians(known.rotation)) / units.factor("rad")
            found |= dict.fromkeys(turned, NormalConfig(prior="normal", sd=angle))
    return found


def name_data(data: InstrumentDataConfig, folder: Path) -> Path:
    """Return the file of the measurements."""
    if isinstance(data, TargetDataConfig):
        return folder / data.targets
    return folder / (data.poses if isinstance(data, PoseDataConfig) else data.points)


def read_measurement(config: StudyConfig, folder: Path, mechanism: Mechanism) -> Measured:
    """Return what a study measured.

    Raises
    ------
    InputError
        For anything at fault in its tables.
    """
    data = config.measured
    if isinstance(data, TargetDataConfig):
        return _read_targets(data, folder, mechanism)
    actuators = None if data.actuators is None else folder / data.actuators
    tracked: TrackedReadings
    if isinstance(data, PoseDataConfig):
        noise = PoseNoise(data.position_um, data.arcseconds)
        tracked, taken = read_poses(folder / data.poses, actuators, noise, mechanism.n_legs)
    else:
        tracked, taken = _read_points(data, folder, mechanism.n_legs)
    with name_faults(name_data(data, folder)):
        check_repeated(tracked.names, tracked.values, taken.verification)
    free = [name for name in ("base", "tool") if getattr(config.frames, name) is not None]
    described = {"instrument": {"instrument": data.instrument, "free_frames": free, **tracked.describe()}}
    if not free and tracked.is_whole():
        return Measured(_read_whole(tracked.poses, taken.verification), tracked.poses, described, tracked=tracked)
    seen = tracked.see()
    readings = _gather(
        tracked.names, taken.verification, tracked.actuators, [(one.values, one.covariance) for one in seen]
    )
    if not free and isinstance(data, PoseDataConfig):  # in part, in the base frame
        return Measured(readings, tracked.poses, described, tracked=tracked)
    tracker = Tracker(tracked.stations, [(one.station, one.point) for one in seen])
    known = _know_frames(len(tracked.stations), config.frames, config.units)
    return Measured(readings, tracked.poses, described, tracker, known, tracked)


def _read_targets(data: TargetDataConfig, folder: Path, mechanism: Mechanism) -> Measured:
    survey = read_survey(folder / data.targets, folder / data.actuators, folder / data.reference, mechanism.n_legs)
    noise = data.target_noise_um * MICROMETRE
    with name_faults(folder / data.reference):
        check_pad_places(survey.platform, mechanism.platform_points)
    with name_faults(folder / data.targets):
        check_exchanged(survey, noise)
        check_repeated(survey.poses, survey.platform.measured, survey.verification)
        extraction = extract_poses(survey, noise, data.pose_estimator)
    described = {
        "pose_extraction": {
            "method": data.pose_estimator,
            "chi2_per_dof": extraction.chi2_per_dof,
            "dof": extraction.dof,
            "n_targets": extraction.n_targets,
            "rejected_targets": ["/".join(target) for target in extraction.rejected],
        }
    }
    targets = TargetMeasurement(survey, extraction, noise)
    readings = _read_whole(extraction.poses, survey.verification)
    return Measured(readings, extraction.poses, described, targets=targets)


def _read_points(data: PointDataConfig, folder: Path, n_legs: int) -> tuple[TrackedPoints, PoseRecords]:
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


# --- each file by itself: reading ends at the first fault, here every file is read as far as it depends on no other -


def list_file_faults(content: Mapping[str, Any], folder: Path) -> list[str]:
    """Return what is wrong with the files that a study's config names, a line each; the config may be at fault.

    A machine at fault has as many legs as there are places of its base, where these say it.
    """
    data = content.get("data")
    machine, faults = look_at_machine(content, folder)
    n_legs = None if machine is None else machine.n_legs
    if machine is None:
        with suppress(InputError):
            base = read_toml(folder / str(content.get("machine")))[0].get("base")
            places = (base.get("points_mm") or base.get("azimuth_deg")) if isinstance(base, dict) else None
            n_legs = len(places) if isinstance(places, list) else None
    for check in _list_checks(data if isinstance(data, dict) else {}, folder, n_legs, machine):
        try:
            check()
        except InputError as error:
            faults += error.lines
    return faults


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
            yield lambda: read_reference(tables["reference"], legs)
        if data.get("instrument") == "poses" and "poses" in tables:
            stated = (any(key.startswith(begin) for key in data) for begin in ("position_", "orientation_"))
            noise = PoseNoise(*(1.0 if one else None for one in stated))  # whatever its size: the config answers for it
            yield lambda: check_pose_table(tables["poses"], noise, name_actuators(legs))
    if data.get("instrument", "targets") == "targets" and "targets" in tables:
        yield lambda: check_target_columns(tables["targets"])
    if data.get("instrument") == "points" and "points" in tables:
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
