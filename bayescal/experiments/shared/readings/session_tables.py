"""Tables of a verification session, read as the study that calibrated the machine read its own."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from bayescal.calibrated.machine import CalibratedMachine
from bayescal.calibrated.verify.plan import (
    build_covariance,
    check_noise,
    expect_pose,
    expect_tracked,
    is_read_by_pose,
    list_trackers,
    read_mean_covariance,
)
from bayescal.data.measured_poses import MeasuredPoses
from bayescal.density.calibration.measurements import Measurements
from bayescal.errors import InputError
from bayescal.experiments.runner.kept_inputs import find_config
from bayescal.experiments.runner.results import PROVENANCE_FILE
from bayescal.experiments.shared.readings.data_schema import (
    READINGS,
    PointDataConfig,
    PoseDataConfig,
    TargetDataConfig,
)
from bayescal.experiments.shared.readings.measurement import InstrumentReader, InstrumentTable, Measured
from bayescal.experiments.shared.schema import UnitsConfig
from bayescal.files.atomic import read_json
from bayescal.files.csv_tables import read_table
from bayescal.numerics.geometry import Array
from bayescal.numerics.units import MICROMETRE
from bayescal.report.numbers import join_words

ONLY_IN = {"target": "targets", "point": "points"}
"""Columns that tables of a kind have alone; all others are of poses."""
TABLES: dict[str, type[TargetDataConfig | PoseDataConfig | PointDataConfig]] = {
    "targets": TargetDataConfig,
    "poses": PoseDataConfig,
    "points": PointDataConfig,
}
UNSTATED = {"point_um": None, "range_um": 0.0, "range_ppm": 0.0, "azimuth_arcsec": None, "elevation_arcsec": None}
"""Noise of points whose table states it."""
HOW = {
    "targets": "Measure the targets: pose, body, target, x_mm, y_mm, z_mm",
    "points": "Measure the points: pose, station, point, range_mm, azimuth_deg, elevation_deg or x_mm, y_mm, z_mm",
}


@dataclass(frozen=True, eq=False)
class SessionTables:
    """What sees a calibrated machine's tool in a session, and how its tables are read.

    Attributes
    ----------
    calibrated : CalibratedMachine
        With its instruments.
    instrument : str or None
        Name of the tracker beside the machine; None of a machine whose own channels are its pose.
    sections : mapping of str to InstrumentTable
        Tables of the study that this instrument measured, by their kinds.
    folder : Path or None
        Where the files are that these name; None where results keep none.
    noise : (float, float or None), optional
        Standard deviations of poses whose table states none, position (µm) and rotation (arcsec).
    """

    calibrated: CalibratedMachine
    instrument: str | None
    sections: Mapping[str, InstrumentTable] = field(default_factory=dict)
    folder: Path | None = None
    noise: tuple[float, float | None] | None = None

    def read(self, path: Path, actuators: Path | None) -> tuple[MeasuredPoses, Measurements]:
        """Return the poses and the readings of a session; actuator positions from its table or another.

        InputError for anything at fault in the tables.
        """
        measured = self._measure(self._name_table(path, actuators))
        found, own = measured.spread(self.calibrated.model), self.calibrated.noise
        sd = np.where(np.isfinite(found.sd), found.sd, np.nan if own is None else own)
        session = Measurements(found.poses, found.values, sd, found.given, found.correlation)
        check_noise(path, session, self.calibrated)
        return measured.poses, session

    def _name_table(self, path: Path, actuators: Path | None) -> InstrumentTable:
        """Return the section of a table as it would stand in a study."""
        kind = _find_kind(path)
        file, positions = str(path.absolute()), None if actuators is None else str(actuators.absolute())
        own = any(name.startswith(("cov_", "sd_")) for name in read_table(path, None).columns)
        if kind == "poses":
            position, rotation = (None, None) if own or self.noise is None else self.noise
            return PoseDataConfig.model_construct(
                kind="poses",
                name=self.instrument or "",
                file=file,
                actuators=positions,
                position_um=position,
                orientation_arcsec=rotation,
            )
        if kind not in self.sections:
            raise InputError(f"{path}: found {kind}, expected {self._say_kinds()} as in the calibration")
        if actuators is None:
            raise InputError(f"{path}: found no actuator positions, expected --actuators PLAN.csv")
        stated = UNSTATED if kind == "points" and own else {}
        return self.sections[kind].model_copy(update={"file": file, "actuators": positions, **stated})

    def _say_kinds(self) -> str:
        return "points" if "points" in self.sections else " or ".join(dict.fromkeys([*self.sections, "poses"]))

    def _measure(self, section: InstrumentTable) -> Measured:
        model = self.calibrated.model
        reader = InstrumentReader(self.folder or Path(), model.bare, UnitsConfig(), False, each_point=True)
        measured = reader.read(section)
        if not {one.name for one in measured.seen} <= {*model.names}:
            raise InputError(
                f"{section.file}: found {section.kind}, expected {self._say_kinds()} as in the calibration"
            )
        measured.check(model)
        return measured

    def instruct(self) -> str:
        """Return what is measured at each pose of a plan."""
        kind = next(iter(self.sections), "poses")
        if kind == "points" or (kind == "targets" and self.instrument is not None):
            return HOW[kind]
        whose = "platform pose, base" if self.instrument is None else "tool pose, instrument"
        return f"Measure the {whose} frame: pose, x_mm, y_mm, z_mm, rx_deg, ry_deg, rz_deg"

    def expect(self, noise_from: Path | None) -> Measurements:
        """Return a row that says how a pose will be measured.

        Its noise is that of a table of poses, or stated, or the mean of the calibration's own table. InputError where
        none is there.
        """
        if noise_from is not None and (kind := _find_kind(noise_from)) == "poses" and "points" not in self.sections:
            return self._expect_poses(noise_from)
        if noise_from is not None:  # at the poses of the calibration
            section = self.sections.get(kind)
            actuators = None if section is None else (self.folder or Path()) / str(section.actuators)
            return self._expect(self._find_mean_covariance(self._measure(self._name_table(noise_from, actuators))))
        if self.noise is not None and "points" in self.sections:
            return self._expect(np.diag(np.full(len(self._places), MICROMETRE * self.noise[0]) ** 2))
        if self.noise is not None:
            return self._expect(build_covariance(*self.noise))
        for kind, section in self.sections.items():
            if self.folder is not None and (own := self.folder / section.file).is_file():
                if kind == "poses":  # whose actuators may be in a table of readings
                    return self._expect_poses(own)
                return self._expect(self._find_mean_covariance(self._measure(section)))
        raise InputError("found no pose noise, expected --position-um, --orientation-arcsec, or --noise-from POSES.csv")

    def _expect_poses(self, table: Path) -> Measurements:
        return self._expect(read_mean_covariance(table, in_part=self.instrument is not None))

    def _expect(self, covariance: Array) -> Measurements:
        if self.instrument is None:
            return expect_pose(self.calibrated, covariance)
        return expect_tracked(self.calibrated, self.instrument, covariance)

    @property
    def _places(self) -> np.ndarray:
        """Where channels of what sees the tool stand among all."""
        model = self.calibrated.model
        if self.instrument is not None:
            return np.asarray(model.instrument_places[self.instrument])
        return np.flatnonzero(~np.isin(model.names, model.commanded))

    def _find_mean_covariance(self, measured: Measured) -> Array:
        """Return the mean covariance of what a table has of the tool, NaN of what it never has."""
        found, places = measured.spread(self.calibrated.model), self._places
        sd = found.sd[:, places]
        correlation = np.eye(len(places)) if found.correlation is None else found.correlation[:, places][:, :, places]
        each = correlation * sd[:, :, None] * sd[:, None, :]
        count = np.isfinite(each).sum(axis=0)
        return np.where(count > 0, np.nansum(each, axis=0) / np.maximum(count, 1), np.nan)


def _find_kind(path: Path) -> str:
    columns = read_table(path, None).columns
    return next((kind for name, kind in ONLY_IN.items() if name in columns), "poses")


def find_session_tables(
    results: Path,
    calibrated: CalibratedMachine,
    experiment: Path | None,
    name: str | None,
    noise: tuple[float, float | None] | None,
) -> SessionTables | None:
    """Return how sessions of a calibrated machine are read; None where its own channels alone are.

    Parameters
    ----------
    results : Path
        What the machine was loaded from.
    calibrated : CalibratedMachine
        With its instruments.
    experiment : Path or None
        The config of results that do not hold the machine.
    name : str or None
        The instrument, of several.
    noise : (float, float or None) or None
        Of position (µm) and rotation (arcsec), instead of the study's.
    """
    trackers = list_trackers(calibrated)
    if name is not None and name not in trackers:
        raise InputError(f"{results}: --instrument: found {name!r}, expected {' or '.join(trackers) or 'none'}")
    if name is None and len(trackers) > 1:
        raise InputError(f"{results}: found instruments {join_words(trackers)}, expected one: --instrument NAME")
    if not trackers and not is_read_by_pose(calibrated):
        return None
    instrument = None if not trackers else trackers[0] if name is None else name
    provenance = read_json(results / PROVENANCE_FILE) if (results / PROVENANCE_FILE).is_file() else {}
    sections = dict[str, InstrumentTable]()
    for content in provenance.get("config", {}).get("data", []):
        if (kind := content.get("kind", READINGS)) in TABLES and content.get("name", "") == (instrument or ""):
            section = TABLES[kind].model_validate(content)
            # without a tracker poses are in the base frame: a study that looked for the frames measured others
            if instrument is not None or section.kind == "targets" or not section.frames.is_free:
                sections.setdefault(kind, section)
    folder = None if experiment is None else experiment.absolute().parent
    if folder is None:
        with suppress(InputError):
            folder = find_config(results, provenance).parent
    poses = sections.get("poses")
    if noise is None and poses is not None and poses.kind == "poses" and poses.position_um is not None:
        noise = (poses.position_um, poses.arcseconds)
    return SessionTables(calibrated, instrument, sections, folder, noise)
