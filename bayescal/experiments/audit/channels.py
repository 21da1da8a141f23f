"""Readings of a machine's channels as an audit takes them: rows with the poses eliminated, at the machine expected.

The readings are those of the machine as expected, without noise, which is given beside them. Priors count by their
standard deviations: to first order a uniform one is a normal one of the same mean and deviation. Poses are random ones
of the workspace or of the actuators, or those of a file.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from bayescal.calibrated.tables import list_columns, read_given, read_named, read_quantities
from bayescal.density.calibration.likelihood import CalibrationPosterior, JointFit
from bayescal.density.calibration.measurements import Measurements
from bayescal.density.calibration.model_error import FunctionsOfPose, IndependentErrors, ThinFunctionsOfPose
from bayescal.density.calibration.terms import Errors
from bayescal.density.priors import NormalPrior
from bayescal.density.sorts import DRIFT, rescale
from bayescal.errors import InputError, NumericalError, name_faults
from bayescal.experiments.audit.audit import check_changes
from bayescal.experiments.audit.planned import FreeParameters, Planned, read_requirements
from bayescal.experiments.audit.schema import AuditConfig, PosesConfig, VariantConfig, WhatIfConfig
from bayescal.experiments.audit.sensor_sets import SensorChoice, list_choices
from bayescal.experiments.shared.readings.errors import build_terms_of_model
from bayescal.experiments.shared.readings.inputs import Variant
from bayescal.experiments.shared.readings.instruments import read_instruments, read_model
from bayescal.experiments.shared.readings.knowledge import foresee, inform, look_around, name_data, name_place
from bayescal.experiments.shared.readings.noise import noise_of_channels
from bayescal.experiments.shared.readings.priors import choose_priors
from bayescal.experiments.shared.readings.schema import ChannelConfig, FreeConfig
from bayescal.experiments.shared.readings.workspace import (
    Workspace,
    build_workspace,
    check_given,
    check_told,
    draw_given,
    draw_standing,
)
from bayescal.experiments.shared.study_schema import VariantConfig as FittedConfig
from bayescal.identifiability.calibration import Calibrations
from bayescal.identifiability.design import draw_displacements
from bayescal.identifiability.directions import Direction
from bayescal.identifiability.information import Information, information_of_rows
from bayescal.identifiability.reading_rows import (
    View,
    name_tool,
    see,
    typical_covariance,
    typical_given,
)
from bayescal.identifiability.requirements import ErrorsInUse, Forecast, Requirement
from bayescal.identifiability.ridges import Ridge, describe_reading_ridges
from bayescal.identifiability.structure import EPSILON, OFF, TWIN_SHIFT, TWINS, Structure, find_structure
from bayescal.machines.readings import ReadingModel, place
from bayescal.numerics.geometry import Array
from bayescal.numerics.units import Units

WIDE_POSES = 40
NOTHING = -8.0  # a coordinate at which an error is as good as none
ROUNDS = 20  # of machines that are drawn again


@dataclass(frozen=True, eq=False)
class PlannedPoses:
    """Poses (P, q) by name, and what the machine has to know of each, (P,) by name."""

    names: tuple[str, ...]
    pose: Array
    given: dict[str, Array]


@dataclass(frozen=True, eq=False)
class ReadMachine:
    """A machine and its instruments, of which variants are made by choosing channels and poses."""

    config: AuditConfig
    folder: Path
    model: ReadingModel
    workspace: Workspace

    def plan(self, section: PosesConfig) -> PlannedPoses:
        """Return where it is planned to measure; InputError for a faulty file or missing bounds."""
        config, model = self.config, self.model
        if section.configurations is not None:
            raise InputError(
                "poses.configurations: found displacements of a mechanism's actuators, expected poses.file"
            )
        if section.file is not None:
            known = [*list_columns(model.coordinates), *model.given]
            expected = [*(f"{one.name}_{one.unit}" for one in model.coordinates), *model.given]
            table, names = read_named(self.folder / section.file, known, expected)
            return PlannedPoses(names, read_quantities(table, model.coordinates), read_given(table, model.given))
        assert section.count is not None
        check_given(config.given, model)
        rng, count = np.random.default_rng([config.seed, 8]), section.count
        given, layout = draw_given(config.given, count, rng), model.layout
        priors, fixed, _ = choose_priors(config, FreeConfig(), layout)
        expects = fixed | {name: one.mean for name, one in priors.items()}
        theta = np.array([expects.get(name, value) for name, value in zip(layout.names, layout.nominal, strict=True)])
        if section.plan == "workspace":
            pose, _ = draw_standing(model, self.workspace, theta, given, count, rng)
        else:
            pose = _draw_commands(model, theta, given, section, rng)
        return PlannedPoses(tuple(f"P{k:03d}" for k in range(1, count + 1)), pose, given)

    def build(self, section: VariantConfig, planned: PlannedPoses) -> Variant:
        """Return a variant at planned poses; InputError for one at which the machine as expected cannot be."""
        config, whole = self.config, self.model
        noise = noise_of_channels({k: v for k, v in config.sensors.items() if isinstance(v, ChannelConfig)}, whole)
        chosen = whole.select(section.sensors if section.sensors is not None else config.sensors)
        for k in chosen[~np.isfinite(noise[chosen])][:1]:
            raise InputError(f"sensors: found {whole.names[k]} without noise, expected an entry in [sensors]")
        model = whole.pick(chosen)
        priors, fixed, common = choose_priors(config, section, model.layout)
        shape = (len(planned.names), len(chosen))
        data = Measurements(planned.names, np.zeros(shape), np.tile(noise[chosen], (shape[0], 1)), planned.given)
        shared = section.model_dump(include=set(FreeConfig.model_fields) | {"name", "sensors"})
        variant = Variant(
            FittedConfig(**shared, title=section.label, noise="stated"),
            whole,
            model,
            {name: NormalPrior(one.mean, one.sd) for name, one in priors.items()},
            fixed,
            common,
            Errors(),
            data,
            np.zeros(len(planned.names), dtype=bool),
            planned.pose,
            self.workspace,
            config.aligned,
        )
        values = model.read(variant.posterior().sampling.start, planned.pose, planned.given)
        for k, channel in np.argwhere(~np.isfinite(values))[:1]:
            raise InputError(
                f"pose {planned.names[k]!r}: found no reading of {model.names[channel]}, expected a pose at which the "
                "machine as expected stands"
            )
        variant = replace(variant, data=replace(data, values=values))
        check_told(variant.posterior(), planned.pose, self.workspace)
        every = np.ones(len(planned.names), dtype=bool)
        error = config.model_error
        terms, missing = build_terms_of_model(
            error, model, variant.data, planned.pose, every, self.workspace, priors, few=True
        )
        return replace(variant, errors=Errors(terms), missing=missing)


def _draw_commands(
    model: ReadingModel, theta: Array, given: dict[str, Array], section: PosesConfig, rng: np.random.Generator
) -> Array:
    """Return the poses (P, q) of random actuator positions; InputError for one at which the machine cannot stand."""
    limits = model.command_range
    if not len(limits) or not np.isfinite(limits).all():
        raise InputError(f"poses.plan: found {section.plan!r}, but no range of the actuators, expected 'workspace'")
    assert section.count is not None
    half = 0.5 * (limits[:, 1] - limits[:, 0])
    half = half if section.range_mm is None else np.minimum(half, section.range_mm)
    moves = draw_displacements(section.plan, section.count, len(limits), 1.0, rng)
    pose, found = model.locate(theta, limits.mean(axis=1) + half * moves, given)
    for k in np.flatnonzero(~found)[:1]:
        raise InputError(f"poses: pose {k + 1}: found no pose at actuator positions drawn, expected a smaller range_mm")
    return pose


@dataclass(frozen=True, eq=False)
class ChannelPlan(Planned):
    """A variant of an audit: channels, free parameters and planned poses.

    Attributes
    ----------
    config : AuditConfig
    section : VariantConfig
    machine : str
        Its name.
    variant : Variant
        Its readings those of the machine as expected, without noise.
    requirements : tuple of Requirement
        Of the tool's numbers, inner units.
    units : Units
    maker : ReadMachine
    systematic : mapping of str to float
        Root mean squares of the variant's systematic errors, mm at the tool.
    """

    config: AuditConfig
    section: VariantConfig
    machine: str
    variant: Variant
    requirements: tuple[Requirement, ...]
    units: Units
    maker: ReadMachine
    systematic: Mapping[str, float]

    @property
    def sizes(self) -> Mapping[str, float]:
        """Root mean squares of systematic errors at the tool, mm."""
        return self.systematic

    @property
    def function_scale(self) -> float:
        """Scale of the prior of each of these sizes, mm."""
        return next((one.scale for one in list_functions(self.variant)), 0.0)

    @cached_property
    def posterior(self) -> CalibrationPosterior:
        """Its posterior about the machine expected."""
        return self.variant.posterior()

    @cached_property
    def expected(self) -> Array:
        """The machine and its errors as expected, in the posterior's coordinates."""
        tau = self.config.model_error.tau
        found = [np.zeros(self.posterior.n_geometry)]
        for term in self.variant.errors.terms:
            assert isinstance(term, FunctionsOfPose | IndependentErrors)
            size = self.sizes[term.sort] if isinstance(term, FunctionsOfPose) else tau
            beyond = np.array([np.sqrt(max(0.0, size**2 - term.floor**2))])
            found.append(np.maximum(term.priors[0].standardise(beyond), NOTHING))
        return np.concatenate(found)

    def resize(self, sizes: Mapping[str, float]) -> ChannelPlan:
        """Return the same with systematic errors of other sizes, mm."""
        terms = tuple(
            replace(term, floor=0.0) if isinstance(term, FunctionsOfPose) else term
            for term in self.variant.errors.terms
            if not isinstance(term, FunctionsOfPose) or sizes.get(term.sort, 0.0) > 0.0
        )
        variant = replace(self.variant, errors=Errors(terms))
        return replace(self, variant=variant, systematic={one.sort: sizes[one.sort] for one in list_functions(variant)})

    @cached_property
    def parameters(self) -> FreeParameters:
        """The free parameters, nominal as expected."""
        posterior, found = self.posterior, self.posterior.sampling
        nominal, n = np.asarray(found.start[found.free]), posterior.n_geometry
        return FreeParameters(tuple(found.names), tuple(posterior.units[:n]), posterior.prior_sd[:n], nominal)

    @property
    def n_poses(self) -> int:
        """Number of planned poses."""
        return self.variant.data.n_poses

    @property
    def is_beyond_range(self) -> bool:
        """Whether the actuators would have to reach further than they do."""
        model = self.variant.model
        limits, commanded = model.command_range, [model.names.index(name) for name in model.commanded]
        read = self.variant.data.values[:, commanded]
        return bool(np.any((read < limits[:, 0] - 1e-9) | (read > limits[:, 1] + 1e-9)))

    @property
    def tool_units(self) -> tuple[str, ...]:
        """Inner units of the tool's numbers."""
        return tuple(one.unit for one in self.variant.model.tool_channels)

    @cached_property
    def around(self) -> View:
        """Poses of the workspace seen by the machine's own sensors."""
        return look_around(self.variant, self.posterior, self.expected, np.random.default_rng([self.config.seed, 5]))

    def name_workspace_pose(self, k: int) -> str:
        """Return where a pose of the workspace is, coordinate by coordinate."""
        return name_place(self.variant, self.around.pose[k], self.config.units)

    def inform(self) -> Information:
        """Return what the plan tells of the parameters."""
        return inform(self.posterior, self.expected, see(self.posterior, self.expected))

    def list_rows(self) -> tuple[Array, Array, np.ndarray]:
        """Return white rows, their columns of systematic errors, and of which term each is."""
        bare, (_, errors, zeta) = self.bare(), self.posterior.at(self.expected[None])
        likelihood, rows = bare.posterior.likelihood, see(bare.posterior, bare.expected)
        white, stand = likelihood.explain(*bare.posterior.at(bare.expected[None]))
        columns = likelihood.columns(errors, zeta, white, stand.slope)[0]
        widths = [term.act(self.variant.data).shape[-1] for term in list_functions(self.variant)]
        sorts = np.repeat(np.arange(len(widths)), widths)
        return rows.reshape(-1, rows.shape[-1]), columns.reshape(-1, columns.shape[-1]), sorts

    def find_structure(self, rng: np.random.Generator) -> Structure:
        """Return what no readings of these channels see, anywhere in the workspace."""
        count = max(WIDE_POSES, 2 * len(self.names) // max(1, len(self.variant.model.channels)))
        try:
            wide = self.replan(self.maker.plan(PosesConfig(count=count)))
        except InputError:
            wide = self
        if self.config.poses.file is not None:
            wide = self  # what the machine has to know of each pose stands in the file
        posterior = replace(wide.variant, errors=Errors()).posterior()
        theta = posterior.sampling.start[posterior.sampling.free]

        def look(y: Array) -> list[Array]:
            shifts = TWIN_SHIFT * EPSILON * rng.uniform(-1.0, 1.0, (TWINS, len(y))) * np.abs(theta) / self.sd
            return [see(posterior, one).reshape(-1, len(y)) for one in (y, *(y + shifts))]

        first, *twins = look(np.zeros(len(self.names)))
        found = find_structure(first, twins)
        with np.errstate(all="ignore"):
            other, *others = look(OFF * rng.standard_normal(len(self.names)))
        if not all(np.isfinite(one).all() for one in (other, *others)):
            return found
        return replace(found, rank_elsewhere=find_structure(other, others).rank)

    def forecast(self) -> Forecast:
        """Return how the tool errs over the workspace, located by the machine's own sensors."""
        return foresee(self.variant, self.posterior, self.expected, self.around, self.see_errors(self.around.pose))

    def see_errors(self, pose: Array) -> ErrorsInUse:
        """Return what channels err by at W poses (W, q) of the machine in use.

        A drift is another one at another time, as large as it is on average; of smooth functions the planned poses do
        not tell all.
        """
        data, model, n, bare = self.variant.data, self.variant.model, len(pose), self.bare()
        variance = np.tile(np.diagonal(typical_covariance(bare.posterior, bare.expected)), (n, 1))
        if not self.sizes:
            return ErrorsInUse(variance, None)
        given = typical_given(data.given, n)
        read = model.read(self.posterior.theta(self.expected[None])[0], pose, given)
        names, sd = tuple(map(str, range(n))), np.ones(read.shape)
        later, columns = Measurements(names, read, sd, given, order=data.n_poses + np.arange(n)), list[Array]()
        for term in list_functions(self.variant):
            own, size = term.own, self.sizes[term.sort]
            place, lasts, rest = own.place_of(later), term.sort != DRIFT, np.ones(n)
            columns.append(size * term.act(later) * lasts)
            if lasts:
                few, whole = term.functions.variances(place), replace(term.functions, of_few=None).variances(place)
                rest = np.maximum(whole[0] - few[0], 0.0)
            variance[:, own.places] += size**2 * np.broadcast_to(rest, (len(own.places), n)).T / own.levers**2
        return ErrorsInUse(variance, np.concatenate(columns, axis=-1))

    def describe(self, directions: Sequence[Direction]) -> list[Ridge]:
        """Return the ridges among directions: how far the parameters move together, and what readings show of it."""
        described = describe_reading_ridges(
            directions,
            see(self.posterior, self.expected),
            self.names,
            self.parameters.units,
            self.sd,
            self.units,
            self.variant.model.member,
        )
        forecast, lengths, found = self.forecast(), np.array([unit == "mm" for unit in self.tool_units]), []
        for direction, step, move, sentence in described:
            effect = np.nan_to_num(np.abs(forecast.effect(move / self.sd)))
            moves = [float(np.linalg.norm(effect[:, part], axis=1).max(initial=0.0)) for part in (lengths, ~lengths)]
            loadings = {self.names[k]: float(move[k]) for k in np.flatnonzero(move)}
            found.append(Ridge(direction, step, 0.0, 0.0, moves[0], moves[1], loadings, sentence))
        return found

    def describe_variant(self) -> dict[str, Any]:
        """Return which channels it takes in."""
        model = self.variant.model
        return {
            "title": self.section.label,
            "data": name_data(self.variant),
            "n_equations": self.n_poses * (len(model.channels) - len(model.coordinates)),
        }

    def summarise_plan(self) -> dict[str, Any]:
        """Return machine and plan for ``summary.json``."""
        poses = self.config.poses
        said = {"workspace": "random ones of the workspace", "file": poses.file or ""}
        plan = {
            "n_poses": self.n_poses,
            "sensors": list(dict.fromkeys(one.kind for one in self.variant.model.channels)),
            "poses": said.get(poses.plan, f"{poses.plan} actuator positions"),
            **self.describe_errors(),
        }
        return {"machine": self.machine, "member": self.variant.model.member, "plan": plan}

    # --- other plans -----------------------------------------------------------------------------------------------

    def replan(self, poses: PlannedPoses, section: VariantConfig | None = None) -> ChannelPlan:
        """Return the same machine at other poses; InputError for one at which it cannot stand."""
        section = section or self.section
        variant = self.maker.build(section, poses)
        before, after = list_functions(self.variant), list_functions(variant)
        changed = replace(self, section=section, variant=variant)
        if before and after and len(before[0].own.places) == len(after[0].own.places):
            return changed.resize(rescale(self.sizes, before[0].own.place, after[0].own.place))
        return changed.settle(find_true_sizes(self.config, variant) if self.sizes else {})

    def change(self, change: WhatIfConfig) -> ChannelPlan:
        """Return the same machine with a changed plan."""
        config, data = change.poses or self.config.poses, self.variant.data
        count = max(1, round(change.poses_factor * self.n_poses))
        if config.file is None and (change.poses is not None or change.poses_factor != 1.0):
            same = change.poses is not None and change.poses_factor == 1.0
            poses = self.maker.plan(config if same else config.model_copy(update={"count": count}))
        else:
            again = np.arange(count) % self.n_poses
            given = {name: value[again] for name, value in data.given.items()}
            names = tuple(f"{data.poses[k]}_{n // self.n_poses + 1}" for n, k in enumerate(again))
            poses = PlannedPoses(names, self.variant.start[again], given)
        middle = self.variant.workspace.middle
        poses = replace(poses, pose=middle + change.workspace_factor * (poses.pose - middle))
        section = self.section
        if change.sensors is not None:
            section = section.model_copy(update={"sensors": list(change.sensors)})
        changed = self.replan(poses, section)
        factors = np.where(changed.variant.internal, change.actuator_noise_factor, change.noise_factor)
        noisy = replace(changed.variant.data, sd=changed.variant.data.sd * factors)
        changed = replace(changed, variant=replace(changed.variant, data=noisy))
        return changed if change.model_error else changed.bare()

    # --- checks ----------------------------------------------------------------------------------------------------

    def simulate(self, n: int, rng: np.random.Generator, fitted: Sequence[int]) -> tuple[Calibrations, np.ndarray]:
        """Return n simulated calibrations of some parameters, and how many keep each requirement.

        Machines of the priors are read at the planned poses with noise and fitted, machine and poses together. What
        the tool then errs by is taken to first order.
        """
        chosen, variant = np.array(fitted, dtype=int), self.variant
        assert not self.sizes  # the same readings would err alike
        part = self if len(chosen) == len(self.names) else replace(self, variant=self._hold_others(chosen))
        y, values, redrawn = self._draw(n, rng)
        found, claimed, converged = np.zeros((n, len(chosen))), np.ones((n, len(chosen))), np.zeros(n, dtype=bool)
        with np.errstate(all="ignore"):
            for k in range(n):
                data = replace(variant.data, values=values[k])
                posterior = replace(part.variant, data=data).posterior()
                fit = JointFit(posterior.likelihood, posterior.sampling, posterior.errors, np.empty(0))
                try:
                    found[k], _ = fit.run(np.zeros(len(chosen)), variant.start)
                    rows = see(posterior, found[k])
                except (NumericalError, np.linalg.LinAlgError):
                    continue
                if np.isfinite(rows).all():
                    covariance = information_of_rows(rows, np.ones(len(chosen))).covariance
                    claimed[k], converged[k] = np.sqrt(np.diagonal(covariance)), True
        errors = -y
        errors[:, chosen] += found
        simulated = Calibrations(
            tuple(self.names[k] for k in chosen), errors[converged][:, chosen], claimed[converged], converged, redrawn
        )
        return simulated, self._count_kept(errors[converged], rng)

    def _hold_others(self, chosen: np.ndarray) -> Variant:
        """Return the variant with all but some parameters held where they are expected."""
        variant, kept = self.variant, {self.names[k] for k in chosen}
        held = {name: prior for name, prior in variant.priors.items() if name not in kept}
        alike = {one: prior.mean for name, prior in held.items() for one in variant.common.get(name, (name,))}
        return replace(
            variant,
            priors={name: prior for name, prior in variant.priors.items() if name in kept},
            fixed={**variant.fixed, **alike},
            common={name: members for name, members in variant.common.items() if name in kept},
        )

    def _draw(self, n: int, rng: np.random.Generator) -> tuple[Array, Array, int]:
        """Return machines (n, m) of the priors, what they read (n, P, K), and how many were drawn anew."""
        data, model, sampling = self.variant.data, self.variant.model, self.posterior.sampling
        y, redrawn = rng.standard_normal((n, len(self.names))), 0
        values = np.empty((n, *data.values.shape))
        for k in range(n):
            for _ in range(ROUNDS):
                theta = sampling.theta_from_y(y[k][None])[0]
                values[k] = model.read(theta, self.variant.start, data.given)
                if np.isfinite(values[k]).all():
                    break
                y[k], redrawn = rng.standard_normal(len(self.names)), redrawn + 1
            else:
                raise InputError("tolerances: found machines that do not reach planned poses, expected smaller ones")
        return y, values + data.sd * rng.standard_normal(values.shape), redrawn

    def _count_kept(self, errors: Array, rng: np.random.Generator) -> np.ndarray:
        forecast = self.forecast()
        if not (np.isfinite(forecast.slope).all() and self.requirements):
            return np.zeros(len(self.requirements), dtype=int)
        located = self.around.located
        error = np.einsum("wti,bi->bwt", forecast.slope, errors)
        error += np.einsum("wtk,bwk->bwt", located, rng.standard_normal((*error.shape[:2], located.shape[-1])))
        return np.array([int(one.keeps(error).sum()) for one in self.requirements])

    def average(self, n: int, rng: np.random.Generator) -> Array:
        """Return the posterior covariance averaged over n machines of the priors, in units of the tolerances."""
        total, count = np.zeros((len(self.names),) * 2), 0
        for y in rng.standard_normal((n, len(self.names))):
            with np.errstate(all="ignore"):
                rows = see(self.posterior, at := np.concatenate([y, self.expected[len(y) :]]))
            if np.isfinite(rows).all():
                total, count = total + inform(self.posterior, at, rows).covariance, count + 1
        if not count:
            raise InputError("tolerances: found no machine that reaches the planned poses, expected smaller ones")
        return total / count


def list_functions(variant: Variant) -> list[ThinFunctionsOfPose]:
    """Return the terms of a variant that are functions of the pose."""
    return [one for one in variant.errors.terms if isinstance(one, ThinFunctionsOfPose)]


def find_true_sizes(config: AuditConfig, variant: Variant) -> dict[str, float]:
    """Return root mean squares of the functions of a variant as they are expected, mm at the tool."""
    there = [one.sort for one in list_functions(variant)]
    return config.model_error.sizes(there)


def _plan(
    config: AuditConfig,
    section: VariantConfig,
    machine: str,
    variant: Variant,
    requirements: tuple[Requirement, ...],
    units: Units,
    maker: ReadMachine,
) -> ChannelPlan:
    true = find_true_sizes(config, variant)
    return ChannelPlan(config, section, machine, variant, requirements, units, maker, true).settle(true)


# --- reading ---------------------------------------------------------------------------------------------------------


def read_channels(config: AuditConfig, folder: Path) -> tuple[dict[str, ChannelPlan], SensorChoice | None]:
    """Return the variants as they are planned, and the sensors to choose from, if any.

    Raises
    ------
    InputError
        Naming the file, the variant, the pose, the coordinate.
    """
    assert config.machine is not None
    assert isinstance(config.workspace, dict)
    machine, models = folder / config.machine, dict[tuple[str | None, str], ReadingModel]()
    for one in config.variants:
        with name_faults("" if one is config.variants[0] else f"variant {one.name!r}"):
            if (key := (one.model, one.deformation)) not in models:
                models[key] = place(read_model(config, one, machine, folder), read_instruments(config, folder))
    model = next(iter(models.values()))
    if config.aligned and not model.places_tool:
        raise InputError(
            f"aligned: machine {getattr(model, 'name', '')!r} does not say where its tool is; expected tool_channels "
            "of its class, up to three in mm"
        )
    workspace = build_workspace(model, config.workspace, config.units)
    maker = ReadMachine(config, folder, model, workspace)
    planned, (names, inner) = maker.plan(config.poses), name_tool(model)
    required = read_requirements(config, dict(zip(names, inner, strict=True)), names)
    units, name = Units(config.units.length, config.units.angle), getattr(model, "name", config.machine)
    plans = dict[str, ChannelPlan]()
    for one in config.variants:
        with name_faults(f"variant {one.name!r}"):
            own = replace(maker, model=models[one.model, one.deformation])
            plans[one.name] = _plan(config, one, name, own.build(one, planned), required, units, own)
            check_changes(plans[one.name])
    if (asked := config.sensor_choice) is None:
        return plans, None
    with name_faults("sensor_choice"):
        choices = list_choices(model, asked)
        sensors = [*asked.always, *(one for choice in choices for one in choice.channels)]
        what = asked.model_dump(include=set(FreeConfig.model_fields))
        section = VariantConfig(name="sensor_choice", sensors=sensors, **what)
        every = _plan(config, section, name, maker.build(section, planned), required, units, maker)
    seen = every.variant, every.expected, every.see_errors
    return plans, SensorChoice(asked, *seen, choices, required, units, config.seed)
