"""A variant of an audit: what its channels say at planned poses, to first order about the machine expected.

The readings are those of the machine as expected, without noise, which is given beside them; the poses are eliminated.
Priors count by their standard deviations: to first order a uniform one is a normal one of the same mean and deviation.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import NamedTuple, Protocol

import numpy as np

from bayescal.density.calibration.joint_fit import JointFit
from bayescal.density.calibration.likelihood import CalibrationPosterior
from bayescal.density.calibration.measurements import Comparison, Measurements
from bayescal.density.calibration.model_error import GPTerm, LowRankGPTerm, RandomTerm
from bayescal.density.calibration.terms import ErrorModel, ErrorTerm
from bayescal.density.pose_kernels import DRIFT, rescale
from bayescal.density.priors import Prior
from bayescal.errors import InputError, NumericalError
from bayescal.experiments.audit.schema import AuditConfig, AuditVariantConfig, PlannedPosesConfig, ScenarioConfig
from bayescal.experiments.shared.readings.inputs import Variant
from bayescal.experiments.shared.readings.knowledge import (
    inform,
    linearise_workspace,
    look,
    predict_tool_errors,
)
from bayescal.identifiability.calibration import Calibrations
from bayescal.identifiability.directions import Direction
from bayescal.identifiability.error_size_information import expect_sizes
from bayescal.identifiability.information import Information, information_of_rows, root_of
from bayescal.identifiability.reading_rows import LinearisedPoses, see, typical_covariance, typical_given
from bayescal.identifiability.requirements import ErrorsInUse, Requirement, WorkspaceErrorModel
from bayescal.identifiability.ridges import Ridge, describe_ridges
from bayescal.identifiability.structure import Structure, find_structural_rank
from bayescal.machines.readings import ReadingModel
from bayescal.numerics.geometry import Array
from bayescal.numerics.units import Units

WIDER = (64.0, 32.0, 16.0, 8.0, 4.0, 2.0, 1.0)
"""Times the workspace from which the structural rank is taken; the first that the machine can take."""
WIDE_POSES = 40
OFF_COORDINATE = -8.0  # a coordinate at which an error is as good as none
ROUNDS = 20  # of machines that are drawn again


class FreeParameters(NamedTuple):
    """Names, inner units, standard deviations of the priors and nominal values of n parameters, (n,) each."""

    names: tuple[str, ...]
    units: tuple[str, ...]
    sd: Array
    nominal: Array


@dataclass(frozen=True, eq=False)
class PlannedPoses:
    """Poses (P, q) by name, and what the machine has to know of each, (P,) by name.

    ``rows``: which of the poses that were measured these are, (P,), if they are some of them. ``read``: which channels
    of the machine with all instruments are read at each, bool (P, K); all where it is None.
    """

    names: tuple[str, ...]
    pose: Array
    given: dict[str, Array]
    rows: np.ndarray | None = None
    read: np.ndarray | None = None

    def repeat(self, names: Sequence[str], again: np.ndarray) -> PlannedPoses:
        """Return some of them (P',), some more than once, by other names."""
        rows, read = (None if one is None else one[again] for one in (self.rows, self.read))
        given = {name: value[again] for name, value in self.given.items()}
        return PlannedPoses(tuple(names), self.pose[again], given, rows, read)


def count_poses(n: int) -> tuple[str, ...]:
    """Return the names of n poses."""
    return tuple(f"P{k:03d}" for k in range(1, n + 1))


class VariantSource(Protocol):
    """What variants are made of: a machine that is to be measured, or has been."""

    @property
    def model(self) -> ReadingModel:
        """The machine with all instruments, or the channels that a study takes in."""

    def plan(self, section: PlannedPosesConfig, factor: float = 1.0) -> PlannedPoses:
        """Return where to measure, of a workspace so many times as wide; InputError where that cannot be."""

    def build(self, section: AuditVariantConfig, planned: PlannedPoses) -> Variant:
        """Return a variant at poses; InputError for one at which the machine cannot be."""

    def list_priors(self, section: AuditVariantConfig) -> Mapping[str, Prior]:
        """Return the priors of a variant's free parameters as they are stated, by name."""

    def list_unused(self, used: Sequence[str]) -> dict[str, list[str]]:
        """Return instruments by name that are not among sensors used, with what [sensors] calls their channels."""


@dataclass(frozen=True, eq=False)
class DesignVariant:
    """A variant of an audit: channels, free parameters and planned poses."""

    config: AuditConfig
    section: AuditVariantConfig
    variant: Variant  # its readings those of the machine as expected, without noise
    planned: PlannedPoses
    requirements: Sequence[Requirement]  # of the tool's numbers, inner units
    units: Units  # those of tolerances, requirements and results
    maker: VariantSource
    tau: float  # root mean square of errors that are independent from pose to pose, mm at the tool
    # by term: rms over the planned poses of systematic errors as they are allowed for, mm at the tool
    sizes: Mapping[str, float]
    floors: Mapping[str, float]  # what each of these is at least, as stated, mm
    zeta: Mapping[str, float] = field(default_factory=dict)  # standardised coordinates of errors by name

    # --- the parameters --------------------------------------------------------------------------------------------

    @cached_property
    def posterior(self) -> CalibrationPosterior:
        """Its posterior about the machine expected."""
        return self.variant.plain()

    @cached_property
    def expected(self) -> Array:
        """The machine and its errors as expected, in the posterior's coordinates."""
        errors, known = self.variant.errors, dict(self.zeta)
        sizes = list[tuple[ErrorTerm, float, float]]()
        sizes += [(one, one.floor, self.tau) for one in errors.terms_of(RandomTerm)]
        sizes += [(one, one.floor, self.sizes[one.sort]) for one in errors.terms_of(GPTerm)]
        for term, floor, size in sizes:
            beyond = np.sqrt(np.maximum(0.0, size**2 - floor**2))
            known[term.names[0]] = max(float(term.priors[0].standardise(beyond)), OFF_COORDINATE)
        return np.concatenate([np.zeros(self.posterior.n_geometry), [known[name] for name in errors.names]])

    @cached_property
    def parameters(self) -> FreeParameters:
        """The free parameters, nominal as expected."""
        posterior, found = self.posterior, self.posterior.sampling
        nominal, n = np.asarray(found.start[found.free]), posterior.n_geometry
        return FreeParameters(tuple(found.names), tuple(posterior.units[:n]), posterior.prior_sd[:n], nominal)

    @property
    def names(self) -> tuple[str, ...]:
        """Their names."""
        return self.parameters.names

    @property
    def sd(self) -> Array:
        """Standard deviations of their priors, shape (n,)."""
        return self.parameters.sd

    @property
    def symbols(self) -> tuple[str, ...]:
        """Their symbols."""
        return tuple(name.partition("[")[0] for name in self.names)

    @cached_property
    def frames(self) -> frozenset[str]:
        """Symbols that rather define than describe a machine: those of instruments."""
        return frozenset(self.variant.model.instrument_symbols)

    # --- the plan --------------------------------------------------------------------------------------------------

    @property
    def n_poses(self) -> int:
        """Number of planned poses."""
        return self.variant.data.n_poses

    @property
    def reads_anywhere(self) -> bool:
        """Whether all instruments read at any pose: none by contact, and none at some of the planned ones alone."""
        return self.planned.read is None and not self.variant.model.contacts

    @property
    def is_beyond_range(self) -> bool:
        """Whether the actuators would have to reach further than they do."""
        return bool(self.variant.model.find_beyond(self.variant.data.values).any())

    @cached_property
    def around(self) -> LinearisedPoses:
        """Poses of the workspace seen by the machine's own sensors."""
        return linearise_workspace(
            self.variant, self.posterior, self.expected, np.random.default_rng([self.config.seed, 5])
        )

    def inform(self) -> Information:
        """Return what the plan tells of the parameters."""
        return inform(self.posterior, self.expected, see(self.posterior, self.expected))

    def find_structure(self, rng: np.random.Generator) -> Structure:
        """Return what no readings of these channels see, poses far beyond the plan's included."""
        count = max(WIDE_POSES, 2 * len(self.names) // max(1, len(self.variant.model.channels)))
        with np.errstate(all="ignore"):
            wide = next(self._spread(PlannedPosesConfig(count=count)), self)
            found = find_structural_rank(replace(wide.variant, errors=ErrorModel()).plain(), rng)
        if self.variant.model.contacts:  # another machine at these poses does not touch
            return replace(found, rank_elsewhere=None)
        return found

    def _spread(self, section: PlannedPosesConfig) -> Iterator[DesignVariant]:
        """Yield the same at poses of wider workspaces than its own, as far as the machine can take them."""
        if self.variant.model.given and not self.config.conditions:
            return  # what the machine has to know of each pose stands in a file
        for factor in WIDER:
            try:
                yield self.replan(self.maker.plan(section, factor))
            except InputError:
                continue

    def forecast(self) -> WorkspaceErrorModel:
        """Return how the tool errs over the workspace, located by the machine's own sensors."""
        return self.predict_tool_errors(self.expected, self.around)

    def predict_tool_errors(self, machine: Array, around: LinearisedPoses) -> WorkspaceErrorModel:
        """Return how the tool of a machine, in the posterior's coordinates, errs at poses."""
        return predict_tool_errors(self.variant, self.posterior, machine, around, self.see_errors(around.pose))

    def describe(self, directions: Sequence[Direction]) -> list[Ridge]:
        """Return the ridges among directions: how far the parameters move together, and what readings show of it."""
        described = describe_ridges(
            directions,
            see(self.posterior, self.expected),
            self.names,
            self.parameters.units,
            self.sd,
            self.units,
            self.variant.model.member,
        )
        forecast, lengths, found = (
            self.forecast(),
            np.array([one.unit == "mm" for one in self.variant.model.tool_channels], dtype=bool),
            [],
        )
        for direction, move, sentence in described:
            effect = np.nan_to_num(np.abs(forecast.effect(move / self.sd)))
            moves = [float(np.linalg.norm(effect[:, part], axis=1).max(initial=0.0)) for part in (lengths, ~lengths)]
            loadings = {self.names[k]: float(move[k]) for k in np.flatnonzero(move)}
            found.append(Ridge(direction, moves[0], moves[1], loadings, sentence))
        return found

    # --- errors that are functions of the pose -----------------------------------------------------------------------

    def list_rows(self) -> tuple[Array, Array, np.ndarray]:
        """Return white rows (K, n), their columns of systematic errors (K, q), and of which term each is (q,)."""
        bare, (_, errors, zeta) = self.without_systematic_errors(), self.posterior.at(self.expected[None])
        likelihood, rows = bare.posterior.likelihood, see(bare.posterior, bare.expected)
        white, stand = likelihood.explain(*bare.posterior.at(bare.expected[None]))
        columns = likelihood.columns(errors, zeta, white, stand.slope)[0]
        widths = [term.act(self.variant.data).shape[-1] for term in self.variant.errors.terms_of(LowRankGPTerm)]
        sorts = np.repeat(np.arange(len(widths)), widths)
        return rows.reshape(-1, rows.shape[-1]), columns.reshape(-1, columns.shape[-1]), sorts

    def settle(self, true: Mapping[str, float]) -> DesignVariant:
        """Return the same with the sizes that a study is expected to find of errors of these sizes, mm."""
        if not true:
            return self.without_systematic_errors()
        rows = self.resize(dict.fromkeys(true, 1.0)).list_rows()
        scale = self.variant.errors.terms_of(LowRankGPTerm)[0].scale  # of the prior of each size, as a study has it, mm
        return self.resize(expect_sizes(*rows, true, self.floors, scale))

    def resize(self, sizes: Mapping[str, float]) -> DesignVariant:
        """Return the same with systematic errors of other sizes, mm; without those that are not named."""
        errors = self.variant.errors.with_floors({})
        errors = errors.without([one for one in errors.terms_of(GPTerm) if sizes.get(one.sort, 0.0) <= 0.0])
        kept = {one.sort: sizes[one.sort] for one in errors.terms_of(LowRankGPTerm)}
        return replace(self, variant=replace(self.variant, errors=errors), sizes=kept)

    def without_systematic_errors(self) -> DesignVariant:
        """Return the same without systematic errors."""
        return self.resize({})

    def see_errors(self, pose: Array) -> ErrorsInUse:
        """Return what channels err by at W poses (W, q) of the machine in use.

        A drift is another one at another time, as large as it is on average; of smooth functions the planned poses do
        not tell all.
        """
        data, model, n, bare = self.variant.data, self.variant.model, len(pose), self.without_systematic_errors()
        variance = np.tile(np.diagonal(typical_covariance(bare.posterior, bare.expected)), (n, 1))
        if not self.sizes:
            return ErrorsInUse(variance, None)
        given, theta = typical_given(data.given, n), self.posterior.theta(self.expected[None])[0]
        read = model.read(theta, pose, given)
        names, sd = tuple(map(str, range(n))), np.ones(read.shape)
        later, columns = Measurements(names, read, sd, given, order=data.n_poses + np.arange(n)), list[Array]()
        left = np.zeros_like(variance)
        for term in self.variant.errors.terms_of(LowRankGPTerm):
            own, size = term.own, self.sizes[term.sort]
            place, lasts, rest = own.place_of(later), term.sort != DRIFT, np.ones(n)
            columns.append(size * term.act(later) * lasts)
            if lasts:
                few, whole = term.functions.variances(place), replace(term.functions, of_few=None).variances(place)
                rest = np.maximum(whole[0] - few[0], 0.0)
            left[:, own.places] += size**2 * np.broadcast_to(rest, (len(own.places), n)).T / own.levers**2
        shown, gain = np.concatenate(columns, axis=-1), model.error_gain(theta, pose, given)
        if gain is not None:
            shown, left = gain @ shown, (gain**2 @ left[..., None])[..., 0]
        return ErrorsInUse(variance + left, shown)

    # --- other plans -----------------------------------------------------------------------------------------------

    def replan(self, poses: PlannedPoses, section: AuditVariantConfig | None = None) -> DesignVariant:
        """Return the same machine at other poses; InputError for one at which it cannot stand."""
        section = section or self.section
        variant = self.maker.build(section, poses)
        before, after = (one.errors.terms_of(LowRankGPTerm) for one in (self.variant, variant))
        changed = replace(self, section=section, variant=variant, planned=poses)
        if before and after and len(before[0].own.places) == len(after[0].own.places):
            return changed.resize(rescale(self.sizes, before[0].own.place, after[0].own.place))
        return changed.settle(find_true_sizes(self.config, variant) if self.sizes else {})

    def list_changes(self) -> list[ScenarioConfig]:
        """Return changes of this kind of plan that are evaluated where the config names none.

        Poses at the ends of the actuators' range and over all of it, no systematic errors, and each instrument that is
        listed and not taken in, where no other variant takes it in either.
        """
        config, n, changes = self.config, self.n_poses, list[ScenarioConfig]()
        limits = self.variant.model.command_range
        if len(limits) and np.isfinite(limits).all() and config.data is None and self.reads_anywhere:
            for plan, words in (
                ("extremes", "at the ends of the range"),
                ("uniform", "spread evenly over the range"),
            ):
                if config.poses.sampling != plan:
                    poses = PlannedPosesConfig.model_validate({"sampling": plan, "count": n})
                    changes.append(ScenarioConfig(name=f"{n} poses {words}", poses=poses))
        if self.sizes:
            changes.append(ScenarioConfig(name="no systematic error", model_error=False))
        used = list(config.sensors) if self.section.sensors is None else self.section.sensors
        beside = {part for one in self.variant.model.channels if one.external for part in (one.name, one.kind)}
        own = [name for name in used if name not in beside]
        for name, sensors in self.maker.list_unused(used).items() if len(config.variants) == 1 else ():
            words = name.replace("_", " ")
            changes.append(ScenarioConfig(name=f"{words} instead", sensors=[*own, *sensors]))
            changes.append(ScenarioConfig(name=f"{words} too", sensors=[*used, *sensors]))
        return changes

    def change(self, change: ScenarioConfig) -> DesignVariant:
        """Return the same machine with a changed plan; InputError where there is none."""
        config = change.poses or self.config.poses
        count = max(1, round(change.poses_factor * self.n_poses))
        random = config.file is None and config.configurations is None and (change.poses or self.config.data is None)
        if change.poses is not None or (random and change.poses_factor != 1.0):
            same = change.poses is not None and change.poses_factor == 1.0
            poses = self.maker.plan(config if same or not random else config.model_copy(update={"count": count}))
        else:
            again = np.arange(count) % self.n_poses
            names = [f"{self.planned.names[k]}_{n // self.n_poses + 1}" for n, k in enumerate(again)]
            poses = self.planned.repeat(names, again)
        if change.workspace_factor != 1.0:
            middle = self.variant.workspace.middle
            poses = replace(poses, pose=middle + change.workspace_factor * (poses.pose - middle))
        section = self.section
        if change.sensors is not None:
            section = section.model_copy(update={"sensors": list(change.sensors)})
        changed = self.replan(poses, section)
        factors = np.where(changed.variant.internal, change.actuator_noise_factor, change.noise_factor)
        noisy = replace(changed.variant.data, sd=changed.variant.data.sd * factors)
        changed = replace(changed, variant=replace(changed.variant, data=noisy))
        return changed if change.model_error else changed.without_systematic_errors()

    # --- checks ----------------------------------------------------------------------------------------------------

    def simulate(self, n: int, rng: np.random.Generator, fitted: Sequence[int]) -> tuple[Calibrations, np.ndarray]:
        """Return n simulated calibrations of some parameters, and how many keep each requirement.

        Machines of the priors are read at the planned poses with noise and fitted, machine and poses together.
        """
        chosen, variant = np.array(fitted, dtype=int), self.variant
        assert not self.sizes  # the same readings would err alike
        part = self if len(chosen) == len(self.names) else replace(self, variant=self._hold_others(chosen))
        y, values, redrawn = self._draw(n, rng)
        found, claimed, converged = np.zeros((n, len(chosen))), np.ones((n, len(chosen))), np.zeros(n, dtype=bool)
        zeta = self.expected[len(self.names) :]
        with np.errstate(all="ignore"):
            for k in range(n):
                data = replace(variant.data, values=values[k])
                posterior = replace(part.variant, data=data).plain()
                fit = JointFit(posterior.likelihood, posterior.sampling, posterior.errors, zeta)
                try:
                    found[k], _ = fit.run(np.zeros(len(chosen)), variant.start)
                    rows = see(posterior, np.concatenate([found[k], zeta]))
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
        return simulated, self._count_kept(y[converged], errors[converged], rng)

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
        """Return machines (n, m) of the priors, what they read (n, P, K), and how many were drawn again."""
        data, model, posterior = self.variant.data, self.variant.model, self.posterior
        y, redrawn = rng.standard_normal((n, len(self.names))), 0
        values = np.empty((n, *data.values.shape))
        for k in range(n):
            for _ in range(ROUNDS):
                theta = posterior.sampling.theta_from_y(y[k][None])[0]
                values[k] = model.read(theta, self.variant.start, data.given)
                if np.isfinite(values[k]).all() and model.layout.inside(theta):
                    break
                y[k], redrawn = rng.standard_normal(len(self.names)), redrawn + 1
            else:
                raise InputError("tolerances: planned poses out of reach, expected smaller ones")
        white, _ = posterior.likelihood.explain(*posterior.at(self.expected[None]))
        noise = white.repeat(n).colour(np.asarray(rng.standard_normal(values.shape)))
        values[:, ~data.present] = np.nan
        return y, Comparison(model.channels).add(values, noise), redrawn

    def _count_kept(self, y: Array, errors: Array, rng: np.random.Generator) -> np.ndarray:
        """Return how many machines y (n, m), fitted with errors (n, m), keep each requirement in use.

        Tolerances can be wide and errors long, along what the plan hardly tells. The slope halfway from the machine to
        its fit makes what the tool errs by exact to second order; that of the nominal machine would not.
        """
        kept = np.zeros(len(self.requirements), dtype=int)
        if not self.requirements:
            return kept
        for halfway, error in zip(y + 0.5 * errors, errors, strict=True):
            machine = np.concatenate([halfway, self.expected[len(halfway) :]])
            around = look(self.posterior, self.variant, machine, self.around.pose, self.variant.internal)
            forecast = self.predict_tool_errors(machine, around)
            if not (len(around.pose) and np.isfinite(forecast.slope).all() and np.isfinite(forecast.noise).all()):
                continue
            root = root_of(forecast.noise)
            noise = rng.standard_normal((len(root), 1, root.shape[1])) @ root
            kept += [bool(one.keeps(forecast.effect(error) + noise[:, 0])) for one in self.requirements]
        return kept

    def average(self, n: int, rng: np.random.Generator) -> Array:
        """Return the posterior covariance averaged over n machines of the priors, in units of the tolerances."""
        total, count = np.zeros((len(self.names),) * 2), 0
        for y in rng.standard_normal((n, len(self.names))):
            with np.errstate(all="ignore"):
                rows = see(self.posterior, at := np.concatenate([y, self.expected[len(y) :]]))
            if np.isfinite(rows).all():
                total, count = total + inform(self.posterior, at, rows).covariance, count + 1
        if not count:
            raise InputError("tolerances: planned poses always out of reach, expected smaller ones")
        return total / count


def find_true_sizes(config: AuditConfig, variant: Variant) -> dict[str, float]:
    """Return root mean squares of the functions of a variant as they are expected, mm at the tool."""
    there = [one.sort for one in variant.errors.terms_of(LowRankGPTerm)]
    return config.model_error.sizes(there)
