"""What an instrument sees of a platform on legs: a twin of a machine whose true parameters and frames are known."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from bayescal.data.instruments.read_points import (
    POLAR,
    PointNoise,
    Stations,
    convert_polar,
    read_probe,
    read_stations,
    spread_polar,
)
from bayescal.data.instruments.read_poses import VALUES
from bayescal.errors import InputError
from bayescal.experiments.simulation.schema import (
    FrameTruthConfig,
    PlatformInstrumentConfig,
    PointInstrumentConfig,
    PoseInstrumentConfig,
    SimulationConfig,
)
from bayescal.experiments.simulation.twin import (
    Twin,
    build_twin,
    format_actuators,
    format_survey,
    format_truth,
    move,
    name_poses,
    stack_poses,
    survey_twin,
)
from bayescal.files.csv_tables import format_table
from bayescal.machines.frames import frame_blocks, move_frames
from bayescal.machines.parameters import ParameterLayout
from bayescal.numerics.geometry import (
    DEGREES_OF_FREEDOM,
    Array,
    matrix_from_rotation_vector,
    rotation_vector_from_matrix,
)
from bayescal.numerics.units import ARCSECOND, MICROMETRE, MICRORADIAN

type Poses = tuple[Array, Array]


@dataclass(frozen=True, eq=False)
class InstrumentPlan:
    """A twin, and the folder where its config's file names start."""

    twin: Twin
    folder: Path

    @property
    def config(self) -> SimulationConfig:
        """The twin's."""
        return self.twin.config

    @cached_property
    def layout(self) -> ParameterLayout:
        """The true parameters', those of the instrument's frames among them."""
        if self.config.instrument is None:
            return self.twin.machine.layout
        return self.twin.machine.layout.extend(frame_blocks(count_stations(self.config.instrument, self.folder)))

    @cached_property
    def theta(self) -> Array:
        """The true parameters, shape (D,)."""
        found = self.config.instrument
        if found is None:
            return self.twin.theta
        return np.concatenate([self.twin.theta, true_frames(found, count_stations(found, self.folder))])

    @property
    def n_held_back(self) -> int:
        """How many poses are held back."""
        return len(self.twin.verification)

    @property
    def n_poses(self) -> int:
        """Number of poses, those held back among them."""
        return len(self.twin.calibration) + self.n_held_back

    @property
    def width(self) -> int:
        """How many coordinates of targets or of the platform, and actuators, are seen at each."""
        targets, n_legs = self.config.targets, self.twin.mechanism.n_legs
        if targets is None:
            return n_legs + DEGREES_OF_FREEDOM
        n_targets = sum(ring.count for ring in (*targets.base, *targets.platform)) + n_legs * targets.per_pad
        return n_legs + 3 * n_targets

    def simulate(self, rng: np.random.Generator) -> tuple[dict[str, str], Array]:
        """Return the texts of all files by their names, and the true parameters (D,)."""
        twin, instrument = self.twin, self.config.instrument
        if instrument is None:
            survey, poses = survey_twin(twin, rng)
            files = format_survey(survey, self.config.origin.text)
        else:
            files, poses = simulate_readings(twin, instrument, self.folder, rng)
        return files | format_truth(twin, name_poses(twin)[0], poses), self.theta


def plan_instrument(config: SimulationConfig, folder: Path) -> InstrumentPlan:
    """Return what is simulated; InputError for every fault of the config or its files."""
    plan = InstrumentPlan(build_twin(config, folder), folder)
    assert plan.theta.shape == (plan.layout.size,)
    return plan


def true_frames(config: PlatformInstrumentConfig, n_stations: int) -> Array:
    """Return the true frames as parameters, each station's and the tool's, shape (6 S + 6,), mm and rad."""
    bases = config.frames.base or [FrameTruthConfig()] * n_stations
    if len(bases) != n_stations:
        raise InputError(f"instrument.frames.base: found {len(bases)} frames, expected {n_stations}, one per station")
    return np.concatenate([[*one.position_mm, *np.radians(one.rotation_deg)] for one in (*bases, config.frames.tool)])


def count_stations(config: PlatformInstrumentConfig, folder: Path) -> int:
    """Return how many stations an instrument has."""
    if isinstance(config, PoseInstrumentConfig) or config.stations is None:
        return 1
    return len(read_stations(folder / config.stations).names)


def simulate_readings(
    twin: Twin, config: PlatformInstrumentConfig, folder: Path, rng: np.random.Generator
) -> tuple[dict[str, str], Array]:
    """Return the texts of the tables that an instrument leaves of a twin, by their names, and the true poses (P, 6)."""
    commanded, _, found = move(twin, rng, twin.theta)
    frames = true_frames(config, count_stations(config, folder)).reshape(-1, 6)
    pairs = np.concatenate([frames[:-1], np.broadcast_to(frames[-1:], frames[:-1].shape)], axis=1)
    seen = move_frames(pairs, found.position[None], found.rotation[None])
    names, held = name_poses(twin)
    origin = twin.config.origin.text
    files = {"actuators.csv": format_actuators(names, held, commanded, origin)}
    if isinstance(config, PoseInstrumentConfig):
        files["poses.csv"] = _format_poses(names, (seen[0][0], seen[1][0]), config, origin, rng)
    else:
        files["points.csv"] = _format_points(names, seen, config, folder, origin, rng)
    return files, stack_poses(found)


def _format_poses(
    names: tuple[str, ...], seen: Poses, config: PoseInstrumentConfig, origin: str, rng: np.random.Generator
) -> str:
    n = len(names)
    position = seen[0] + rng.normal(0.0, config.position_um * MICROMETRE, (n, 3))
    columns, values = list(VALUES[:3]), position
    deviations = {f"sd_{axis}_um": config.position_um for axis in "xyz"}
    if config.arcseconds is not None:
        sd = config.arcseconds * ARCSECOND
        turned = matrix_from_rotation_vector(rng.normal(0.0, sd, (n, 3))) @ seen[1]
        columns += VALUES[3:]
        values = np.concatenate([position, np.degrees(rotation_vector_from_matrix(turned))], axis=1)
        deviations |= {f"sd_r{axis}_urad": round(sd / MICRORADIAN, 6) for axis in "xyz"}
    comments = [origin, "Pose of the probe in the instrument's frame: position in mm, rotation vector in degrees."]
    rows = [(name, *(f"{x:.8f}" for x in one), *deviations.values()) for name, one in zip(names, values, strict=True)]
    return format_table(comments, ["pose", *columns, *deviations], rows)


def _format_points(
    names: tuple[str, ...],
    seen: Poses,
    config: PointInstrumentConfig,
    folder: Path,
    origin: str,
    rng: np.random.Generator,
) -> str:
    points, probe = read_probe(folder / config.probe)
    stations = read_stations(None if config.stations is None else folder / config.stations)
    places = seen[0][:, :, None] + np.einsum("spij,qj->spqi", seen[1], probe)
    reading = _aim(places, stations)
    noise = PointNoise((), config.range_um, config.range_ppm, config.azimuth_arcsec, config.elevation_arcsec)
    reading = reading + spread_polar(noise, reading[..., 0]) * rng.standard_normal(reading.shape)
    there = rng.random(reading.shape[:-1]) >= config.missed
    there[0, :, 0] |= ~there.any(axis=(0, 2))  # a pose without any point would be none
    rows = [
        (name, station, point, f"{r:.6f}", f"{np.degrees(azimuth):.9f}", f"{np.degrees(elevation):.9f}")
        for p, name in enumerate(names)
        for s, station in enumerate(stations.names)
        for q, point in enumerate(points)
        if there[s, p, q]
        for r, azimuth, elevation in [reading[s, p, q]]
    ]
    comments = [origin, "Points on the platform as stations see them: range in mm, azimuth and elevation in degrees."]
    return format_table(comments, ["pose", "station", "point", *POLAR], rows)


def _aim(places: Array, stations: Stations) -> Array:
    """Return range (mm), azimuth and elevation (rad) of places (S, P, Q, 3), base frame, in each station's frame."""
    offset = places - stations.position[:, None, None]
    x, y, z = np.moveaxis(np.einsum("sji,spqj->spqi", stations.rotation, offset), -1, 0)
    reading = np.stack([np.sqrt(x**2 + y**2 + z**2), np.arctan2(y, x), np.arctan2(z, np.hypot(x, y))], axis=-1)
    assert np.allclose(convert_polar(reading)[0], np.stack([x, y, z], axis=-1))
    return reading
