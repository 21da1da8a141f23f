"""A study's measured poses as an audit takes them: machine, priors, noise and posterior are the study's.

A machine that has been measured is known better than its drawings, and the ridges of its posterior bend. Derivatives
are therefore taken at the posterior mean: there the tangent of a bent ridge is, to second order, the chord through the
draws, while at the nominal machine it is turned away by the bend times the distance. Without draws the most probable
machine stands in for it. Tolerances stay those of the priors.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from bayescal.config.classes import label_class
from bayescal.density.calibration.measurements import Measurements, RowPositions
from bayescal.density.calibration.model_error import GPTerm, LowRankGPTerm, RandomTerm
from bayescal.density.calibration.terms import ErrorModel
from bayescal.density.priors import NormalPrior, Prior
from bayescal.density.sampling import place_free
from bayescal.errors import InputError
from bayescal.experiments.audit.machine import plan_random
from bayescal.experiments.audit.planned import PlannedPoses
from bayescal.experiments.audit.schema import AuditConfig, AuditVariantConfig, PlannedPosesConfig
from bayescal.experiments.runner.load import load
from bayescal.experiments.runner.parallel import Run
from bayescal.experiments.shared.measured import MeasuredReadings, measure_variants
from bayescal.experiments.shared.readings.inputs import Variant
from bayescal.experiments.shared.readings.workspace import Workspace, build_workspace, check_told
from bayescal.experiments.shared.requirements import is_aligned
from bayescal.experiments.shared.study_schema import VariantConfig as FittedConfig
from bayescal.experiments.shared.study_schema import name_variant
from bayescal.identifiability.reading_rows import typical_given
from bayescal.inference.diagnostics import Diagnostics
from bayescal.inference.exploration import explore
from bayescal.inference.mode import find_modes
from bayescal.inference.sampling import sample_posterior
from bayescal.inference.schema import DrawsConfig, count_walkers
from bayescal.inference.solutions import find_solutions
from bayescal.machines.readings import ReadingModel
from bayescal.numerics.geometry import Array

DRAWS_WITH_DATA = 100_000
"""So many that chance turns the ridges' directions by less than what is said of them; a few seconds."""
SEED = 4
LEAST_STEPS = 4  # R-hat splits an ensemble in time


@dataclass(frozen=True, eq=False)
class MeasuredMachine:
    """A machine that has been measured, of which variants are made at its own poses and at others."""

    config: AuditConfig
    found: MeasuredReadings  # a variant of the study
    workspace: Workspace
    # where free parameters are expected: their posterior means, or the mode; before these, where searches begin
    centre: Mapping[str, float]

    @property
    def model(self) -> ReadingModel:
        """The machine with the channels that the study takes in."""
        return self.found.posterior.likelihood.model

    @property
    def own_poses(self) -> PlannedPoses:
        """The poses that were measured, where the machine of least squares stands."""
        likelihood, data = self.found.with_pose_guesses.likelihood, self.found.posterior.likelihood.data
        return PlannedPoses(data.poses, likelihood.start, dict(data.given), np.arange(data.n_poses))

    @property
    def _centred(self) -> dict[str, Prior]:
        """The study's priors about where free parameters are expected."""
        priors = self.found.posterior.priors
        return {name: NormalPrior(self.centre[name], prior.sd) for name, prior in priors.items()}

    def list_priors(self, section: AuditVariantConfig) -> Mapping[str, Prior]:
        """Return the study's priors."""
        del section
        return self.found.posterior.priors

    def list_unused(self, used: Sequence[str]) -> dict[str, list[str]]:
        """Return no instruments: what has been measured was measured."""
        del used
        return {}

    def plan(self, section: PlannedPosesConfig, factor: float = 1.0) -> PlannedPoses:
        """Return random poses of a workspace so many times as wide, or of the actuators; InputError for a file."""
        if section.count is None:
            raise InputError("poses: found a file with [data], expected a count")
        posterior, seed = self.found.posterior, self.config.seed
        given, theta = typical_given(posterior.likelihood.data.given, section.count), posterior.first_machine
        if self.model.contacts:  # what touches at one machine is off at another
            theta = place_free(self.model.layout, self._centred, posterior.fixed, posterior.common)[1]
        workspace, rng = self.workspace.widen(factor), np.random.default_rng([seed, 8])
        return plan_random(self.model, theta, section, given, workspace, rng, seed)

    def build(self, section: AuditVariantConfig, planned: PlannedPoses) -> Variant:
        """Return the variant at poses, of others than those measured seen as well as these on average."""
        if section.sensors is not None:
            raise InputError("sensors: found them with [data], expected none")
        posterior, model = self.found.posterior, self.model
        data = posterior.likelihood.data
        if planned.rows is not None:
            some = data.pick(planned.rows)
            sd, correlation = some.sd, some.correlation
        else:
            sd = np.tile(np.median(data.sd, axis=0), (len(planned.names), 1))
            mean = None if data.correlation is None else data.correlation.mean(axis=0)
            correlation = None if mean is None else np.tile(mean, (len(sd), 1, 1))
        priors = self._centred
        nothing = Measurements(planned.names, np.zeros_like(sd), sd, planned.given, correlation)
        variant = Variant(
            FittedConfig(name=section.name, title=section.label, noise_known=True),
            model,
            model,
            priors,
            posterior.fixed,
            posterior.common,
            ErrorModel(),
            nothing,
            np.zeros(len(planned.names), dtype=bool),
            planned.pose,
            self.workspace,
            is_aligned(self.config.accuracy_frame, model, priors),
        )
        values = model.read(variant.plain().sampling.start, planned.pose, planned.given)
        if not np.isfinite(values).all():
            raise InputError("poses: found one out of reach, expected reachable poses")
        if planned.rows is not None:  # what was not read, is not
            values = np.where(data.present[planned.rows], values, np.nan)
        if planned.read is not None:
            values = np.where(planned.read, values, np.nan)
        variant = replace(variant, data=replace(nothing, values=values))
        check_told(variant.plain(), planned.pose, self.workspace)
        moved = posterior.errors.change(GPTerm, lambda one: _move(one, model, variant.data, planned.pose))
        return replace(variant, errors=ErrorModel(moved.terms))


def _move(term: GPTerm, model: ReadingModel, data: Measurements, pose: Array) -> LowRankGPTerm:
    """Return a study's functions of the pose at other rows, made of few columns there."""
    read, places = model.read(model.layout.nominal, pose, data.given), term.own.places
    home = np.full(len(model.channels), np.nan)
    home[places] = term.own.home
    rows = RowPositions.find(model.channels, data, read, home).pick(places)
    own = replace(term.own, rows=rows, n_places=data.n_poses, used=np.ones(data.n_poses, dtype=bool))
    return term.thin(len(model.channels), own)


def read_measured(config: AuditConfig, folder: Path) -> MeasuredMachine:
    """Return what a design's study says of its machine.

    InputError where there is no such study, or it has no variant of the design's model, deformation and name, or
    several.
    """
    assert config.data is not None
    where, section, named = folder / config.data.study, config.variants[0], config.data.variant
    experiment, study = load(where)
    variants, model = getattr(study, "variants", ()), section.model
    names = [one.name for one in variants]
    if model is not None and names:
        wanted = name_variant(label_class(model), label_class(section.deformation))
        seen = {one.name: name_variant(*one.seen) for one in variants if one.model is not None}
        names = [name for name in names if seen.get(name) == wanted]
        if not names:
            known = ", ".join(dict.fromkeys(seen.values())) or "no model"
            raise InputError(f"{where}: variants: found no {wanted}, expected one of {known}")
    chosen = [name for name in names if named in (None, name)] if named is None or named in names else []
    if names and not chosen:
        raise InputError(f"{where}: variants: found no {named!r}, expected {', '.join(map(repr, names))}")
    if len(chosen) > 1:
        listed = ", ".join(map(repr, names))
        raise InputError(f"{where}: variants: found {listed}, expected data.variant")
    (found,) = measure_variants(experiment, study, where, chosen, config.data.with_model_error).values()
    found = found.count_by_row()
    posterior = found.posterior
    if posterior.errors.outliers.expected:
        raise InputError(f"{where}: found outlier_fraction, expected none in an audit")
    model_of, scale = posterior.likelihood.model, posterior.likelihood.model.pose_scale
    workspace = (
        build_workspace(model_of, config.workspace, config.units)
        if config.workspace
        else Workspace(found.low, found.high, scale)
    )
    return MeasuredMachine(config, found, workspace, _name(found, found.with_pose_guesses.begin))


@dataclass(frozen=True, eq=False)
class Draws:
    """S draws of m free parameters, and of k errors that go with them."""

    values: Array  # (S, m): the parameters in natural units
    zeta: Array  # (S, k): coordinates of the errors
    diagnostics: Diagnostics
    problems: list[str]  # what speaks against convergence, in words

    @cached_property
    def mean(self) -> Array:
        """Posterior mean of the parameters, shape (m,)."""
        return np.asarray(self.values.mean(axis=0))

    def thin(self, n: int) -> Array:
        """Return the parameters of at most n draws, evenly taken, shape (n', m)."""
        return self.values[np.linspace(0, len(self.values) - 1, min(n, len(self.values))).astype(int)]


def draw(task: tuple[MeasuredReadings, DrawsConfig, int, int]) -> Draws:
    """Return draws of what was found of a machine, at least so many: explored first, as a study does it."""
    found, config, wanted, seed = task
    target = found.with_pose_guesses
    explore_seed, ensemble_seed = np.random.SeedSequence([seed, SEED]).spawn(2)
    exploration = explore(target, explore_seed, config.walkers, from_prior=True)
    walkers = count_walkers(target.n_parameters, config.walkers)
    steps = max(LEAST_STEPS, -(-wanted // (config.ensembles * walkers)))
    drawn = sample_posterior(exploration, ensemble_seed, config.ensembles, config.walkers, config.burn_in, steps)
    problems = drawn.diagnostics.list_problems()
    if not all(mode.converged for mode in exploration.modes):
        problems.append("the mode search did not converge")
    label = find_solutions(drawn.y, exploration.modes, target.n_geometry).label
    y = drawn.y[label == 0]  # of the most probable solution: a mean over several is no machine
    return Draws(*_take(found, y), drawn.diagnostics, problems)


def _take(found: MeasuredReadings, y: Array) -> tuple[Array, Array]:
    """Return parameters (S, m), in the order of the readings' posterior, and errors (S, k) of draws (S, n)."""
    target, names = found.with_pose_guesses, found.posterior.sampling.names
    places = [target.names.index(name) for name in names]
    return target.natural(y)[:, places], found.posterior.zeta(y)


def _name(found: MeasuredReadings, y: Array) -> dict[str, float]:
    """Return the free parameters at coordinates (n,), by name."""
    values, _ = _take(found, y[None])
    return dict(zip(found.posterior.sampling.names, values[0].tolist(), strict=True))


def centre(measured: MeasuredMachine, run: Run) -> tuple[MeasuredMachine, Draws | None, Array]:
    """Return a measured machine about its posterior, the draws of this, and coordinates of its errors (S, k).

    About its mode, without draws, where the design wants none.
    """
    config, found = measured.config, measured.found
    wanted = DRAWS_WITH_DATA if config.posterior.draws is None else config.posterior.draws
    if wanted:
        draws = run.once("posterior", draw, (found, config.posterior, wanted, config.seed), (Draws,))
        where = dict(zip(found.posterior.sampling.names, draws.mean.tolist(), strict=True))
        return replace(measured, centre=where), draws, draws.zeta
    mode = find_modes(found.with_pose_guesses)[0].y
    return replace(measured, centre=_name(found, mode)), None, found.posterior.zeta(mode[None])


def describe_found(
    errors: ErrorModel, zeta: Array
) -> tuple[float, dict[str, float], dict[str, float], dict[str, float]]:
    """Return root mean squares over draws (S, k) of errors: τ and sizes by sort, mm, then floors, and means.

    The latter are of all coordinates, by name.
    """
    limited = errors.limit(zeta)
    square = [float(np.mean(one.square(own))) for one, own in errors.parts_of(RandomTerm, limited)]
    functions = errors.parts_of(GPTerm, limited)
    sizes = {one.sort: float(np.sqrt(np.mean(one.amplitude(own) ** 2))) for one, own in functions}
    floors = {one.sort: one.floor for one, _ in functions if one.floor > 0.0}
    means = dict(zip(errors.names, limited.mean(axis=0).tolist(), strict=True))
    return float(np.sqrt(np.mean(square))) if square else 0.0, sizes, floors, means
