"""Readings of a machine's channels as an audit takes them: rows with the poses eliminated, at the machine expected."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Protocol

import numpy as np

from bayescal.density.calibration.likelihood import CalibrationPosterior, JointFit
from bayescal.errors import InputError, NumericalError
from bayescal.experiments.audit.planned import Planned
from bayescal.experiments.audit.planned_poses import PlannedPoses
from bayescal.experiments.audit.schema import AuditConfig, PosesConfig, VariantConfig, WhatIfConfig
from bayescal.experiments.shared.readings.inputs import Variant
from bayescal.experiments.shared.readings.knowledge import look_around
from bayescal.experiments.shared.readings.knowledge_tables import name_data, name_place
from bayescal.identifiability.calibration import Calibrations
from bayescal.identifiability.directions import Direction
from bayescal.identifiability.information import Information, information_of_rows
from bayescal.identifiability.reading_rows import View, see
from bayescal.identifiability.requirements import Forecast, Requirement
from bayescal.identifiability.ridges import Ridge, describe_reading_ridges
from bayescal.identifiability.structure import EPSILON, OFF, TWIN_SHIFT, TWINS, Structure, find_structure
from bayescal.numerics.geometry import Array
from bayescal.numerics.units import Units

WIDE_POSES = 40
ROUNDS = 20  # of machines that are drawn anew


class Maker(Protocol):
    """What makes variants of one machine."""

    def build(self, section: VariantConfig, poses: PlannedPoses) -> Variant:
        """Return a variant at planned poses; InputError for one at which the machine cannot stand."""

    def plan(self, section: PosesConfig) -> PlannedPoses:
        """Return planned poses."""


@dataclass(frozen=True, eq=False)
class ReadingPlan(Planned):
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
    maker : Maker
    """

    config: AuditConfig
    section: VariantConfig
    machine: str
    variant: Variant
    requirements: tuple[Requirement, ...]
    units: Units
    maker: Maker

    @cached_property
    def posterior(self) -> CalibrationPosterior:
        """Its posterior about the machine expected."""
        return self.variant.posterior()

    @property
    def _expected(self) -> Array:
        return np.zeros(self.posterior.n_parameters)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the free parameters."""
        return tuple(self.posterior.sampling.names)

    @property
    def parameter_units(self) -> tuple[str, ...]:
        """Their inner units."""
        return tuple(self.posterior.units)

    @property
    def sd(self) -> Array:
        """Standard deviations of their priors, shape (n,)."""
        return self.posterior.prior_sd

    @property
    def nominal(self) -> Array:
        """Their values as expected, shape (n,)."""
        sampling = self.posterior.sampling
        return np.asarray(sampling.start[sampling.free])

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
        return look_around(self.variant, self.posterior, self._expected, np.random.default_rng([self.config.seed, 5]))

    def name_workspace_pose(self, k: int) -> str:
        """Return where a pose of the workspace is, coordinate by coordinate."""
        return name_place(self.variant, self.around.pose[k], self.config.units)

    def inform(self) -> Information:
        """Return what the plan tells of the parameters."""
        return information_of_rows(see(self.posterior, self._expected), np.ones(self.posterior.n_geometry))

    def find_structure(self, rng: np.random.Generator) -> Structure:
        """Return what no readings of these channels see, anywhere in the workspace."""
        count = max(WIDE_POSES, 2 * len(self.names) // max(1, len(self.variant.model.channels)))
        try:
            wide = self.replan(self.maker.plan(PosesConfig(count=count)))
        except InputError:
            wide = self
        if self.config.poses.file is not None:
            wide = self  # what the machine has to know of each pose stands in the file
        sampling = wide.posterior.sampling
        theta = sampling.start[sampling.free]

        def look(y: Array) -> list[Array]:
            shifts = TWIN_SHIFT * EPSILON * rng.uniform(-1.0, 1.0, (TWINS, len(y))) * np.abs(theta) / self.sd
            return [see(wide.posterior, one).reshape(-1, len(y)) for one in (y, *(y + shifts))]

        first, *twins = look(self._expected)
        found = find_structure(first, twins)
        with np.errstate(all="ignore"):
            other, *others = look(OFF * rng.standard_normal(len(self.names)))
        if not all(np.isfinite(one).all() for one in (other, *others)):
            return found
        return replace(found, rank_elsewhere=find_structure(other, others).rank)

    def forecast(self) -> Forecast:
        """Return how the tool errs over the workspace, located by the machine's own sensors."""
        at = self.around
        noise = at.located @ np.swapaxes(at.located, -1, -2)
        return Forecast(at.tool, np.where(np.isfinite(at.noise)[..., None], noise, np.nan))

    def describe(self, directions: Sequence[Direction]) -> list[Ridge]:
        """Return the ridges among directions: how far the parameters move together, and what readings show of it."""
        described = describe_reading_ridges(
            directions,
            see(self.posterior, self._expected),
            self.names,
            self.parameter_units,
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
        }
        return {"machine": self.machine, "member": self.variant.model.member, "plan": plan}

    # --- other plans -----------------------------------------------------------------------------------------------

    def replan(self, poses: PlannedPoses, section: VariantConfig | None = None) -> ReadingPlan:
        """Return the same machine at other poses; InputError for one at which it cannot stand."""
        section = section or self.section
        return replace(self, section=section, variant=self.maker.build(section, poses))

    def list_changes(self) -> list[WhatIfConfig]:
        """Return nothing: variants say which sensors may take part."""
        return []

    def change(self, change: WhatIfConfig) -> ReadingPlan:
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
        return replace(changed, variant=replace(changed.variant, data=noisy))

    def propose(self) -> None:
        """Return nothing: [selection] chooses poses."""
        return

    # --- checks ----------------------------------------------------------------------------------------------------

    def simulate(self, n: int, rng: np.random.Generator, fitted: Sequence[int]) -> tuple[Calibrations, np.ndarray]:
        """Return n simulated calibrations of some parameters, and how many keep each requirement.

        Machines of the priors are read at the planned poses with noise and fitted, machine and poses together. What
        the tool then errs by is taken to first order.
        """
        chosen, variant = np.array(fitted, dtype=int), self.variant
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
                rows = see(self.posterior, y)
            if np.isfinite(rows).all():
                total, count = total + information_of_rows(rows, np.ones(len(y))).covariance, count + 1
        if not count:
            raise InputError("tolerances: found no machine that reaches the planned poses, expected smaller ones")
        return total / count
