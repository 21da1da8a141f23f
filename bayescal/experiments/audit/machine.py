"""A machine and its instruments as an audit is given them: where it is planned to measure, and what is read there."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from bayescal.calibrated.tables import list_columns, read_given, read_named, read_quantities
from bayescal.data.actuators import check_moves
from bayescal.density.calibration.measurements import Measurements, RowPositions
from bayescal.density.calibration.terms import ErrorModel
from bayescal.density.priors import NormalPrior, Prior
from bayescal.errors import InputError, name_faults
from bayescal.experiments.audit.planned import PlannedPoses, count_poses
from bayescal.experiments.audit.pose_sensors import PlannedPoseSensor
from bayescal.experiments.audit.schema import AuditConfig, AuditVariantConfig, PlannedPosesConfig
from bayescal.experiments.shared.readings.errors import build_terms_of_model, find_own_channels, measure_ranges
from bayescal.experiments.shared.readings.inputs import Variant
from bayescal.experiments.shared.readings.noise import noise_of_channels
from bayescal.experiments.shared.readings.priors import check_optional, choose_priors
from bayescal.experiments.shared.readings.schema import FreeConfig
from bayescal.experiments.shared.readings.workspace import (
    Workspace,
    check_given,
    check_told,
    draw_given,
    draw_standing,
    lead_to_contact,
)
from bayescal.experiments.shared.requirements import is_aligned
from bayescal.experiments.shared.study_schema import VariantConfig as FittedConfig
from bayescal.files.csv_tables import CsvTable, read_matrix
from bayescal.machines.readings import Given, ReadingModel
from bayescal.machines.readings.placed import READ_BY
from bayescal.numerics.geometry import Array

NEAR_MM = 10.0
"""How far a planned tool may be off what it is to touch."""


@dataclass(frozen=True, eq=False)
class PlannedMachine:
    """A machine and its instruments, of which variants are made by choosing channels and poses."""

    config: AuditConfig
    folder: Path  # where the config's file names start
    model: ReadingModel  # with all instruments
    workspace: Workspace
    sensors: Mapping[str, PlannedPoseSensor]  # by name: those whose noise follows from what they tell of a pose
    symbols: Collection[str]  # of parameters that other variants' machines have

    # --- poses -----------------------------------------------------------------------------------------------------

    def plan(self, section: PlannedPosesConfig, factor: float = 1.0) -> PlannedPoses:
        """Return where it is planned to measure, of a workspace so many times as wide.

        InputError for a faulty file, missing bounds and a pose at which the machine as expected cannot be.
        """
        config, model = self.config, self.model
        if section.file is not None:
            known = [*list_columns(model.coordinates), *model.given, READ_BY]
            expected = [*(f"{one.name}_{one.unit}" for one in model.coordinates), *model.given]
            table, names = read_named(self.folder / section.file, known, expected)
            pose, given = read_quantities(table, model.coordinates), read_given(table, model.given)
            return PlannedPoses(names, pose, given, read=_find_read(table, model))
        check_given(config.conditions, model)
        rng, layout = np.random.default_rng([config.seed, 8]), model.layout
        priors, fixed, _ = choose_priors(config, FreeConfig(), layout, self.symbols)
        expects = fixed | {name: one.mean for name, one in priors.items()}
        expected = [expects.get(name, value) for name, value in zip(layout.names, layout.nominal, strict=True)]
        theta = np.array(expected)
        if section.configurations is not None:
            path, commanded = self.folder / section.configurations, model.select(model.commanded)
            lengths = [model.channels[k].unit == "mm" for k in commanded]
            moves = read_matrix(path, len(lengths)) * np.where(lengths, section.unit_mm, 1.0)
            with name_faults(path):
                check_moves(moves)
            if np.isfinite(limits := model.command_range).all():  # displacements are from the middle of the range
                middle = limits.mean(axis=1)
            else:  # or, without any, from home
                home = model.read(theta, model.home_pose[None], {name: np.ones(1) for name in model.given})
                middle = home[0, commanded]
            return locate(model, theta, middle, moves, draw_given(config.conditions, len(moves), rng))
        assert section.count is not None
        given, workspace = draw_given(config.conditions, section.count, rng), self.workspace.widen(factor)
        return plan_random(model, theta, section, given, workspace, rng, config.seed)

    # --- variants ----------------------------------------------------------------------------------------------------

    def spread(self, names: Sequence[str]) -> list[str]:
        """Return channels and kinds of them, each sensor of poses by all of its channels."""
        own = {channel: one.name for one in self.sensors.values() for channel in (*one.channels, f"{one.name}_r")}
        for name in names:
            if name in own:
                raise InputError(f"sensor {name!r}: found part of {own[name]!r}, expected all")
        return [
            channel for name in names for channel in (self.sensors[name].channels if name in self.sensors else [name])
        ]

    def list_priors(self, section: AuditVariantConfig) -> Mapping[str, Prior]:
        """Return the priors of a variant's free parameters as they are stated, by name."""
        return choose_priors(self.config, section, self.model.layout, self.symbols)[0]

    def list_unused(self, used: Sequence[str]) -> dict[str, list[str]]:
        """Return instruments by name that are not among sensors used, with what [sensors] calls their channels."""
        found = dict[str, list[str]]()
        for name in (*self.config.instruments, *self.sensors):
            own = [one for one in self.config.sensors if one == name or one.startswith((f"{name}_", f"{name}["))]
            if own and not set(own) & set(used):
                found[name] = own
        return found

    def build(self, section: AuditVariantConfig, planned: PlannedPoses) -> Variant:
        """Return a variant at planned poses; InputError for one at which the machine as expected cannot be."""
        config, whole = self.config, self.model
        chosen = whole.select(self.spread(list(config.sensors) if section.sensors is None else section.sensors))
        model = whole.pick(chosen)
        priors, fixed, common = choose_priors(config, section, model.layout, self.symbols)
        check_optional(model, [one for name in priors for one in common.get(name, (name,))])
        shared = section.model_dump(include=set(FreeConfig.model_fields) | {"name", "sensors"})
        shape = (len(planned.names), len(chosen))
        variant = Variant(
            FittedConfig(**shared, title=section.label, noise_known=True),
            whole,
            model,
            {name: NormalPrior(one.mean, one.sd) for name, one in priors.items()},
            fixed,
            common,
            ErrorModel(),
            Measurements(planned.names, np.zeros(shape), np.ones(shape), planned.given),
            np.zeros(shape[0], dtype=bool),
            planned.pose,
            self.workspace,
            is_aligned(config.accuracy_frame, model, priors),
        )
        read = whole.read(variant.plain().sampling.start, planned.pose, planned.given)
        values = read[:, chosen]
        for k, channel in np.argwhere(~np.isfinite(values))[:1]:
            raise InputError(
                f"pose {planned.names[k]!r}: found no reading of {model.names[channel]}, expected a reachable pose"
            )
        if planned.read is not None:
            values = np.where(planned.read[:, chosen], values, np.nan)
        self._check_contact(model, planned.names, values)
        variant = replace(variant, data=self._add_noise(replace(variant.data, values=values), chosen, read))
        check_told(variant.plain(), planned.pose, self.workspace)
        home, reach = measure_ranges(model, variant.data, self.workspace)
        positions = RowPositions.find(model.channels, variant.data, values, home)
        used = ~variant.verification
        own = find_own_channels(variant.posterior(), variant.data, planned.pose, used, reach, positions, self.workspace)
        terms, missing = build_terms_of_model(config.model_error, model, variant.data, own, priors, few=True)
        return replace(variant, errors=ErrorModel(terms), missing=missing)

    def _check_contact(self, model: ReadingModel, names: Sequence[str], values: Array) -> None:
        """Raise InputError for readings (P, K) by contact of several instruments at once, or from far off."""
        touched = {one: np.isfinite(values[:, model.instrument_places[one]]).all(axis=1) for one in model.contacts}
        for row in np.flatnonzero(sum(touched.values(), np.zeros(len(names), dtype=int)) > 1)[:1]:
            both = " and ".join(one for one in touched if touched[one][row])
            raise InputError(
                f"poses: pose {names[row]!r}: found contact with {both}, expected one, named in column {READ_BY!r}"
            )
        for one, there in touched.items():
            off = np.linalg.norm(values[:, model.instrument_places[one]], axis=1)
            for row in np.flatnonzero(there & (off > NEAR_MM))[:1]:
                raise InputError(f"poses: pose {names[row]!r}: found it {off[row]:.4g} mm off {one}, expected contact")

    def _add_noise(self, data: Measurements, chosen: np.ndarray, read: Array) -> Measurements:
        """Return readings of the chosen channels with their noise, all channels reading (P, K)."""
        sections, _ = self.config.split_sensors()
        names = [self.model.names[k] for k in chosen]
        sd = np.tile(noise_of_channels(sections, self.model)[chosen], (data.n_poses, 1))
        correlation = np.tile(np.eye(len(names)), (data.n_poses, 1, 1))
        for one in self.sensors.values():
            if one.channels[0] not in names:
                continue
            places = np.array([names.index(name) for name in one.channels])
            tool = read[:, self.model.select([one.name, f"{one.name}_r"])]
            covariance = one.find_noise(tool, data.poses)
            sd[:, places] = np.sqrt(np.diagonal(covariance, axis1=1, axis2=2))
            correlation[:, places[:, None], places] = covariance / (sd[:, places, None] * sd[:, None, places])
        for k in np.flatnonzero(~np.isfinite(sd[0]))[:1]:
            raise InputError(f"sensors: found no noise of {names[k]}, expected it in [sensors]")
        alone = np.array_equal(correlation, np.broadcast_to(np.eye(len(names)), correlation.shape))
        return replace(data, sd=sd, correlation=None if alone else correlation)


def _find_read(table: CsvTable, model: ReadingModel) -> np.ndarray | None:
    """Return which channels are read at each pose, bool (P, K): of instruments those whose names stand in its cell.

    None without such a column, or instruments.
    """
    if READ_BY not in table.columns:
        return None
    known, column = model.instrument_places, table.columns.index(READ_BY)
    read = np.ones((len(table.rows), len(model.channels)), dtype=bool)
    for row, cells in enumerate(table.rows):
        named = cells[column].split()
        for name in named:
            if name not in known:
                expected = f"some of {', '.join(known)}, with spaces between" if known else "[instruments]"
                raise InputError(f"{table.where(row)}: {READ_BY}: found {name!r}, expected {expected}")
        for name, places in known.items():
            read[row, places] = name in named
    return read


# --- actuator positions ----------------------------------------------------------------------------------------------


def plan_random(
    model: ReadingModel,
    theta: Array,
    section: PlannedPosesConfig,
    given: Given,
    workspace: Workspace,
    rng: np.random.Generator,
    seed: int,
) -> PlannedPoses:
    """Return random poses of a workspace by a generator, or of random actuator positions of a machine (D,) by a seed.

    Instruments that read by contact do so at some each, to which the random ones are led. InputError where the
    actuators have no range, or there is a position at which the machine cannot stand.
    """
    assert section.count is not None
    if section.sampling == "workspace" or model.contacts:
        # of what goes beyond the ranges the audit says that it does
        pose, _ = draw_standing(model, workspace, theta, given, section.count, rng, in_range=False)
        found = PlannedPoses(count_poses(section.count), pose, dict(given))
        if not model.contacts:
            return found
        exact = np.zeros((section.count, len(model.channels)))
        pose, read = lead_to_contact(model, workspace, theta, given, pose, exact, rng)
        return replace(found, pose=pose, read=read)
    limits = model.command_range
    if not len(limits) or not np.isfinite(limits).all():
        raise InputError(f"poses.sampling: found {section.sampling!r} without an actuator range, expected 'workspace'")
    half = 0.5 * (limits[:, 1] - limits[:, 0]) if section.range_mm is None else section.range_mm
    rng = np.random.default_rng([seed, 1])
    shape = section.count, len(limits)
    shares = rng.integers(-1, 2, shape) if section.sampling == "extremes" else rng.uniform(-1.0, 1.0, shape)
    return locate(model, theta, limits.mean(axis=1), np.asarray(half * shares), given)


def locate(model: ReadingModel, theta: Array, middle: Array, moves: Array, given: Given) -> PlannedPoses:
    """Return the poses of a machine (D,) at displacements (P, C), of redundant actuators those of least squares."""
    pose, found = model.locate(theta, middle + moves, given)
    names = count_poses(len(moves))
    for k in np.flatnonzero(~found)[:1]:
        moved = ", ".join(f"{one:g}" for one in moves[k])
        raise InputError(f"poses: pose {names[k]!r}: found no pose at displacements {moved}")
    return PlannedPoses(names, pose, dict(given))
