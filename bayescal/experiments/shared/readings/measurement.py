"""Tables of an instrument that sees a machine's tool, as readings of channels: targets, poses or tracked points.

Where all frames are known poses are readings of the channels of a machine that has the pose among them, as one on legs.
Otherwise they are those of a `Tracker` beside the machine, whose frames are parameters.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from functools import partial
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

from bayescal.config.load import read_toml
from bayescal.data.actuators import (
    check_moves,
    check_range,
    check_travel,
    choose_columns,
    find_position,
    name_actuators,
    read_actuators,
)
from bayescal.data.instruments.read_points import (
    PointNoise,
    check_point_columns,
    read_points,
    read_probe,
    read_stations,
)
from bayescal.data.instruments.read_poses import PoseNoise, PoseRecords, check_pose_table, read_poses
from bayescal.data.instruments.readings import (
    StationObservation,
    TrackedPoints,
    TrackedReadings,
    check_places,
    turn_of,
)
from bayescal.data.measured_poses import MeasuredPoses, check_repeated
from bayescal.data.photogrammetry.poses import PoseExtraction, check_exchanged, check_pad_places, extract_poses
from bayescal.data.photogrammetry.survey import Survey, check_target_columns, read_reference, read_survey
from bayescal.density.schema import NormalConfig, PriorConfig
from bayescal.errors import InputError, name_faults
from bayescal.experiments.runner.results import Summary
from bayescal.experiments.shared.readings.data_schema import (
    PointDataConfig,
    PoseDataConfig,
    ReadingsTable,
    TargetDataConfig,
)
from bayescal.experiments.shared.readings.machine_kind import look_at_machine
from bayescal.experiments.shared.readings.reading_tables import PoseReadings
from bayescal.experiments.shared.readings.schema import ChannelConfig
from bayescal.experiments.shared.schema import UnitsConfig
from bayescal.experiments.shared.study_schema import StudyConfig
from bayescal.files.csv_tables import read_table
from bayescal.machines.mechanism import Mechanism
from bayescal.machines.readings import Channel, Instrument, ReadingModel, Tracker
from bayescal.machines.readings.base import POSE_CHANNELS
from bayescal.machines.readings.placed import locate_tool, rename_channel
from bayescal.machines.readings.tracker import frame_symbols, name_frames
from bayescal.numerics.geometry import Array
from bayescal.numerics.units import MICROMETRE, Units

type InstrumentTable = TargetDataConfig | PoseDataConfig | PointDataConfig


@dataclass(frozen=True, eq=False)
class TargetMeasurement:
    """Photogrammetry: targets on both bodies, the poses extracted from them, and when they were taken."""

    survey: Survey
    extraction: PoseExtraction
    noise: float
    """Standard deviation of a target's coordinate, mm."""


@dataclass(frozen=True, eq=False)
class Measured:
    """What a table of an instrument tells of a machine."""

    data: InstrumentTable
    folder: Path
    readings: PoseReadings  # of commanded channels, then of those of the instrument
    commands: tuple[Channel, ...]
    seen: tuple[Channel, ...]  # by their names on the machine with its instruments
    # poses of the tool as measured, all frames as they should be; NaN where a coordinate is not
    poses: MeasuredPoses
    described: Summary  # entries of the summary that say what was measured
    # an instrument whose frames have to be found, that sees points which tell no whole pose, or a pose of a machine
    # that has no such channels
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
        """The tracker, by what begins the names of its parameters and channels."""
        return {} if self.tracker is None else {self.data.name: self.tracker}

    def spread(self, model: ReadingModel) -> PoseReadings:
        """Return the readings of all channels (K) of the machine with its instruments; NaN where there are none."""
        names = [one.name for one in (*self.commands, *self.seen)]
        return self.readings.spread([model.names.index(one) for one in names], model)

    def state_noise(self) -> dict[str, ChannelConfig]:
        """Return the noise of its channels by kind: it stands row by row, here for who asks for one number."""
        found = dict[str, ChannelConfig]()
        for kind in dict.fromkeys(one.kind for one in self.seen):
            own = [k for k, one in enumerate(self.seen, start=len(self.commands)) if one.kind == kind]
            sd = self.readings.sd[:, own]
            if not np.isfinite(sd).any():  # of poses measured in part
                continue
            rms = float(np.sqrt(np.nanmean(sd**2)))
            length = next(one.unit for one in self.seen if one.kind == kind) == "mm"
            found[kind] = ChannelConfig(noise_mm=rms) if length else ChannelConfig(noise_rad=rms)
        return found

    def check(self, model: ReadingModel) -> None:
        """Raise InputError where the readings cannot be in the units that their table names."""
        whole = model.bare
        if self.tracked is None or not self.commands or whole.given:
            return
        expected, path = locate_tool(whole, self.tracked.actuators), self.folder / self.data.file
        self.tracked.check_units(expected, path)
        if self.data.kind == "points" and isinstance(self.tracked, TrackedPoints):
            stations = None if self.data.stations is None else self.folder / self.data.stations
            check_places(expected, self.tracked, read_stations(stations).position, path)


def settle(config: StudyConfig, measured: Sequence[Measured]) -> StudyConfig:
    """Return a config that states the noise and the frames, all of them free, of what tables measured."""
    parameters = {name: one for it in measured for name, one in it.parameters.items()}
    noise = {name: one for it in measured for name, one in it.state_noise().items() if name not in config.sensors}
    return _state(config, parameters, noise)


def expect_trackers(
    config: StudyConfig, machine: ReadingModel, folder: Callable[[], Path]
) -> tuple[StudyConfig, dict[str, Instrument]]:
    """Return a config that states the frames of instruments of tables, and these: of a machine without such channels.

    No measurement is read, their noise stays in the tables; ``folder`` returns where the files are that say which
    points a tracker sees from which stations.
    """
    found, known = dict[str, Instrument](), dict[str, PriorConfig]()
    for one in () if machine.reads_pose else config.data:
        if isinstance(one, TargetDataConfig):
            found[one.name] = Tracker(("",), [(0, None)])
        elif isinstance(one, PoseDataConfig):
            found[one.name] = Tracker(("",), [(0, None)], machine.tells_rotation)
            known |= _know_frames(one, 1, config.units)
        elif isinstance(one, PointDataConfig):
            _, probe = read_probe(folder() / one.probe)
            stations = read_stations(None if one.stations is None else folder() / one.stations).names
            found[one.name] = Tracker(stations, list(product(range(len(stations)), probe)), machine.tells_rotation)
            known |= _know_frames(one, len(stations), config.units)
    return _state(config, known, {}), found


def _state(
    config: StudyConfig, parameters: Mapping[str, PriorConfig], noise: Mapping[str, ChannelConfig]
) -> StudyConfig:
    """Return a config that states more parameters, free in all variants, and more noise."""
    variants = [
        one if one.free is None else one.model_copy(update={"free": [*one.free, *parameters]})
        for one in config.variants
    ]
    known, sensors = {**config.parameters, **parameters}, {**config.sensors, **noise}
    return config.model_copy(update={"parameters": known, "variants": variants, "sensors": sensors})


def leave_pose(machine: ReadingModel) -> ReadingModel:
    """Return a machine without the pose among its channels, which an instrument beside it sees."""
    kept = [k for k, one in enumerate(machine.channels) if one not in POSE_CHANNELS]
    return machine.pick(np.array(kept, dtype=int)) if machine.reads_pose else machine


def _gather(commanded: bool, taken: PoseRecords, blocks: Sequence[tuple[Array, Array]]) -> PoseReadings:
    """Return positions of actuators, whose noise a config states, and blocks of readings with their covariances."""
    actuators = taken.actuators
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
    asked = np.zeros((n_poses, n), dtype=bool)
    asked[:, : actuators.shape[1]] = commanded
    apart = not (np.abs(correlation) * ~np.eye(n, dtype=bool)).any()
    names = tuple(map(str, taken.names))
    return PoseReadings(names, taken.verification, values, sd, None if apart else correlation, asked)


def _know_frames(
    data: PoseDataConfig | PointDataConfig, n_stations: int, section: UnitsConfig
) -> dict[str, PriorConfig]:
    """Return what is known of the frames that have to be found, in a config's units."""
    units, found, frames = Units(section.length, section.angle), dict[str, PriorConfig](), data.frames
    for name in name_frames(n_stations):
        known = frames.tool if name == "tool" else frames.base
        if known is not None:
            moved, turned = frame_symbols(f"{data.name}_{name}" if data.name else name)
            found |= dict.fromkeys(moved, NormalConfig(prior="normal", sd=known.position / units.factor("mm")))
            angle = float(np.radians(known.rotation)) / units.factor("rad")
            found |= dict.fromkeys(turned, NormalConfig(prior="normal", sd=angle))
    return found


def measure_tables(config: StudyConfig, folder: Path, machine: ReadingModel) -> list[Measured]:
    """Return what instruments measured of a machine, table by table; tables of readings are not among them.

    Raises
    ------
    InputError
        For anything at fault in the tables.
    """
    tables = [one for one in config.data if not isinstance(one, ReadingsTable)]
    reader = InstrumentReader(folder, machine, config.units, len(tables) < len(config.data))
    return [reader.read(one) for one in tables]


@dataclass(frozen=True, eq=False)
class InstrumentReader:
    """Reads tables of instruments that see the tool of a machine."""

    folder: Path
    machine: ReadingModel
    units: UnitsConfig
    beside_readings: bool  # a table of readings may have the positions of the actuators
    each_point: bool = False  # points are readings of their own, though a station's tell a pose

    def read(self, data: InstrumentTable) -> Measured:
        """Return what a table measured; InputError for anything at fault in it or in those beside it."""
        found = self._read_targets(data) if data.kind == "targets" else self._read_tracked(data)
        if found.commands:
            poses = found.poses
            path = self.folder / (data.actuators or data.file)
            check_travel(poses.actuators, self.machine.command_range, found.commands, poses.names, path)
            with name_faults(path):
                check_moves(poses.actuators[~found.verification])
        return found

    # --- what is read --------------------------------------------------------------------------------------------

    def _read_tracked(self, data: PoseDataConfig | PointDataConfig) -> Measured:
        tracked, taken = self._read_poses(data) if data.kind == "poses" else self._read_points(data)
        with name_faults(self.folder / data.file):
            check_repeated(tracked.names, tracked.values, taken.verification)
        free = [name for name in ("base", "tool") if getattr(data.frames, name) is not None]
        described = {"instrument": {"instrument": data.kind, "free_frames": free, **tracked.describe()}}
        if not free and self.machine.reads_pose:
            if tracked.is_whole():
                return self._join(data, taken, tracked.poses, [_pose_block(tracked.poses)], described, tracked=tracked)
            if data.kind == "poses":  # in part, in the base frame
                blocks = [(one.values, one.covariance) for one in tracked.see()]
                return self._join(data, taken, tracked.poses, blocks, described, tracked=tracked)
        seen, n = tracked.see(self.each_point), 6
        if not self.machine.tells_rotation:
            self._check_unturned(data, seen)
            n = 3
        return self._join(
            data,
            taken,
            tracked.poses,
            [(one.values[:, :n], one.covariance[:, :n, :n]) for one in seen],
            described,
            tracker=Tracker(tracked.stations, [(one.station, one.point) for one in seen], n > 3),
            parameters=_know_frames(data, len(tracked.stations), self.units),
            tracked=tracked,
        )

    def _check_unturned(self, data: PoseDataConfig | PointDataConfig, seen: Sequence[StationObservation]) -> None:
        """Raise InputError for what a machine that does not say how its tool is turned cannot be compared with."""
        expected = "without a tool rotation, expected positions alone"
        points = any(one.point is not None and one.point.any() for one in seen)
        if points or any(one.point is None and np.isfinite(one.values[:, 3:]).any() for one in seen):
            found = "points beside the tool's centre" if points else "rotations"
            raise InputError(f"{self.folder / data.file}: found {found} for a machine {expected}")
        if data.frames.tool is not None:
            raise InputError(f"data.frames.tool: found it for a machine {expected}")

    def _read_poses(self, data: PoseDataConfig) -> tuple[TrackedReadings, PoseRecords]:
        path, actuators = self.folder / data.file, None if data.actuators is None else self.folder / data.actuators
        columns = choose_columns(self._commands, path if actuators is None else actuators)
        if self.beside_readings and actuators is None and not {*columns} & {*read_table(path, None).columns}:
            columns = {}
        return read_poses(path, actuators, PoseNoise(data.position_um, data.arcseconds), columns)

    def _read_points(self, data: PointDataConfig) -> tuple[TrackedReadings, PoseRecords]:
        folder, each = self.folder, data.point_um
        actuators, stations = folder / data.actuators, None if data.stations is None else folder / data.stations
        noise = PointNoise(
            () if each is None else tuple(each) if isinstance(each, list) else (each,) * 3,
            data.range_um,
            data.range_ppm,
            data.azimuth_arcsec or 0.0,
            data.elevation_arcsec or 0.0,
        )
        columns = choose_columns(self._commands, actuators)
        return read_points(folder / data.file, folder / data.probe, stations, actuators, noise, columns)

    def _read_targets(self, data: TargetDataConfig) -> Measured:
        path, actuators, reference = (self.folder / one for one in (data.file, data.actuators, data.reference))
        legs, columns = self.machine.legs, choose_columns(self._commands, actuators)
        survey = read_survey(path, actuators, reference, columns, 0 if legs is None else legs.n_legs)
        noise = data.target_noise_um * MICROMETRE
        if legs is not None:
            with name_faults(reference):
                check_pad_places(survey.platform, legs.machine.mechanism.platform_points)
        with name_faults(path):
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
        taken = PoseRecords(extraction.poses.names, survey.verification, extraction.poses.actuators)
        found, poses = TargetMeasurement(survey, extraction, noise), extraction.poses
        tracker = None if self.machine.reads_pose else Tracker(("",), [(0, None)])
        return self._join(data, taken, poses, [_pose_block(poses)], described, tracker=tracker, targets=found)

    # --- as readings ---------------------------------------------------------------------------------------------

    @property
    def _commands(self) -> tuple[Channel, ...]:
        """The channels by which the machine is commanded."""
        return tuple(self.machine.channels[k] for k in self.machine.select(self.machine.commanded))

    def _join(
        self,
        data: InstrumentTable,
        taken: PoseRecords,
        poses: MeasuredPoses,
        blocks: Sequence[tuple[Array, Array]],
        described: Summary,
        tracker: Tracker | None = None,
        **others: Any,
    ) -> Measured:
        """Return readings of the actuators and blocks of readings: of the machine's pose, or of a tracker."""
        commands, q = self._commands if taken.actuators.shape[1] else (), len(self.machine.coordinates)
        enough = len(commands) == q or (len(commands) > q and len({one.unit for one in commands}) == 1)
        name, channels = data.name, POSE_CHANNELS if tracker is None else tuple(tracker.channels)
        seen = channels if tracker is None else tuple(rename_channel(name, one) for one in channels)
        readings = _gather(enough, taken, blocks)
        return Measured(data, self.folder, readings, commands, seen, poses, described, tracker, **others)


def _pose_block(poses: MeasuredPoses) -> tuple[Array, Array]:
    """Return poses (P, 6) with their covariances, as readings."""
    return np.concatenate([poses.position, turn_of(poses.rotation)], axis=1), poses.covariance


# --- each file by itself: reading ends at the first fault, here every file is read as far as it depends on no other -


def list_file_faults(content: Mapping[str, Any], folder: Path) -> list[str]:
    """Return what is wrong with the files that tables of instruments name, a line each; the config may be at fault.

    A machine at fault has as many legs as there are places of its base, where these say it.
    """
    data = content.get("data")
    tables = [one for one in data if isinstance(one, dict)] if isinstance(data, list) else []
    tables = [one for one in tables if one.get("kind") in ("targets", "poses", "points")]
    if not tables:
        return []
    machine, faults = look_at_machine(content, folder)
    n_legs = None if machine is None else machine.n_legs
    if machine is None:
        with suppress(InputError):
            base = read_toml(folder / str(content.get("machine")))[0].get("base")
            places = (base.get("points_mm") or base.get("azimuth_deg")) if isinstance(base, dict) else None
            n_legs = len(places) if isinstance(places, list) else None
    for one in tables:
        for check in _list_checks(one, folder, n_legs, machine):
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
        if data["kind"] == "poses" and "file" in tables:
            stated = (any(key.startswith(begin) for key in data) for begin in ("position_", "orientation_"))
            noise = PoseNoise(*(1.0 if one else None for one in stated))  # whatever its size: the config answers for it
            yield lambda: check_pose_table(tables["file"], noise, name_actuators(legs))
    if data["kind"] == "targets" and "file" in tables:
        yield lambda: check_target_columns(tables["file"])
    if data["kind"] == "points" and "file" in tables:
        yield lambda: check_point_columns(tables["file"], "stations" in tables)
    if "probe" in tables:
        yield lambda: read_probe(tables["probe"])
    if "stations" in tables:
        yield lambda: read_stations(tables["stations"])


def _check_actuators(path: Path, n_legs: int, machine: Mechanism | None) -> None:
    """Raise InputError for a table of actuator positions that is none, or that its machine does not reach."""
    names, _, actuators = read_actuators(path, name_actuators(n_legs))
    if machine is not None:
        find = partial(find_position, path, [f"rho_{leg}" for leg in range(1, n_legs + 1)], "mm")
        check_range(actuators, machine.initial_actuator_positions, machine.actuator_range, names, find)
