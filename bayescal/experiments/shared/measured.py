"""What audits and checks take from a kind of experiment that has measured a machine, without knowing that kind."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from bayescal.data.measured_poses import MeasuredPoses
from bayescal.density.calibration.likelihood import CalibrationPosterior
from bayescal.density.calibration.measurements import Comparison
from bayescal.density.calibration.model_error import OwnChannels, build_model_error
from bayescal.density.calibration.terms import Errors, ErrorTerm
from bayescal.density.errors import FUNCTION_SCALES, TAU, Amplitudes
from bayescal.density.functions import FunctionLikelihood
from bayescal.density.legs import LegPosterior
from bayescal.density.pose_likelihood import PoseLikelihood
from bayescal.density.priors import HalfCauchyPrior, Prior
from bayescal.errors import InputError
from bayescal.experiments.shared.leg_readings import place_legs
from bayescal.experiments.shared.slip_rows import Readings
from bayescal.experiments.shared.study_schema import StudyConfig
from bayescal.inference.target import Target
from bayescal.machines.kinematics import Machine
from bayescal.machines.readings import Legs
from bayescal.numerics.geometry import Array, matrix_from_rotation_vector


@dataclass(frozen=True, eq=False)
class MeasuredVariant:
    """A machine that has been measured, seen through one variant.

    Attributes
    ----------
    name : str
    origin : str
        Of the data, in words.
    machine : Machine
    priors : mapping of parameter to Prior
    fixed : mapping of parameter to float
        Values of fixed ones that are not nominal.
    posterior : LegPosterior
    poses : MeasuredPoses
        The calibration poses.
    actuator_noise : float
        Standard deviation, mm.
    actuator_variance : ndarray, shape (P, N), or None
        What the measured part of a deformation leaves, mm²; None where nothing of a deformation was measured.
    shared_errors : ndarray, shape (P, N, M), or None
        What M unknowns of it, standard normal, add to the legs' errors at all poses: ``actuator_variance`` as they are.
    described : mapping
        What was measured, in the study's own words.
    n_held_back : int
        How many poses were measured besides, kept for verification.
    """

    name: str
    origin: str
    machine: Machine
    priors: Mapping[str, Prior]
    fixed: Mapping[str, float]
    posterior: LegPosterior
    poses: MeasuredPoses
    actuator_noise: float
    actuator_variance: Array | None = None
    shared_errors: Array | None = None
    described: Mapping[str, Any] = field(default_factory=dict)
    n_held_back: int = 0

    def pick(self, rows: np.ndarray) -> MeasuredVariant:
        """Return the variant after some of its poses."""
        variance, shared = (None if one is None else one[rows] for one in (self.actuator_variance, self.shared_errors))
        return replace(self, actuator_variance=variance, shared_errors=shared).with_poses(self.poses.select(rows))

    def retake(self, names: tuple[str, ...], values: Array) -> MeasuredVariant:
        """Return the variant as if actuators and poses had read otherwise, (P, N + 6), mm and rad."""
        n = self.machine.mechanism.n_legs
        rotation = matrix_from_rotation_vector(values[:, n + 3 :])
        poses = replace(
            self.poses, names=names, position=values[:, n : n + 3], rotation=rotation, actuators=values[:, :n]
        )
        return self.with_poses(poses, np.arange(len(values)))

    def with_poses(self, poses: MeasuredPoses, rows: np.ndarray | None = None) -> MeasuredVariant:
        """Return the variant as if other poses had been measured; ``rows`` of its own once more, if they are that."""
        likelihood = PoseLikelihood(self.machine, poses, self.actuator_noise, self.actuator_variance)
        dependent = self.posterior.likelihood.of_errors_at(likelihood, rows)
        return replace(self, poses=poses, posterior=replace(self.posterior, likelihood=dependent))


class Measuring(ABC):
    """A kind of experiment that measures a machine."""

    @abstractmethod
    def measure(
        self, config: StudyConfig, path: Path, names: Sequence[str], with_model_error: bool
    ) -> dict[str, MeasuredReadings]:
        """Return variants of the config of a file by their names, which are all there."""


class Found(Target, Protocol):
    """A posterior whose parameters have names and priors."""

    @property
    def names(self) -> tuple[str, ...]:
        """Names of all parameters, those of the geometry first."""

    @property
    def priors(self) -> Mapping[str, Prior]:
        """Priors of the geometry's parameters by name."""


@dataclass(frozen=True, eq=False)
class MeasuredReadings:
    """A machine of K channels that has been measured, seen through one variant.

    Attributes
    ----------
    name : str
    origin : str
        Of the data, in words.
    posterior : CalibrationPosterior
        Of the calibration poses.
    low, high : ndarray, shape (q,)
        The workspace, mm and rad.
    internal : ndarray of bool, shape (K,)
        Which channels the machine keeps after its calibration.
    legs : MeasuredVariant or None
        The same measurements as poses of a machine on legs; its posterior is the one that is found.
    n_held_back : int
        How many poses were measured besides, kept for verification.
    """

    name: str
    origin: str
    posterior: CalibrationPosterior
    low: Array
    high: Array
    internal: np.ndarray
    legs: MeasuredVariant | None = None
    n_held_back: int = 0

    @property
    def half(self) -> Array:
        """Half widths of the workspace, shape (q,)."""
        return 0.5 * (self.high - self.low)

    @cached_property
    def anchored(self) -> CalibrationPosterior:
        """The posterior of the readings that looks for poses near those of its least-squares solution."""
        return self.posterior.anchored()

    @property
    def readings(self) -> Readings:
        """The readings, of which causes of a misfit are weighed."""
        return Readings(self.posterior, self.low, self.high, self.internal)

    @property
    def found(self) -> Found:
        """The posterior that is found, of legs that of the study."""
        return self.anchored if self.legs is None else self.legs.posterior

    def adopt(self, y: Array) -> Array:
        """Return coordinates (S, n) of the posterior that is found as those of the readings' one."""
        if self.legs is None:
            return y
        own = self.legs.posterior
        places = [own.errors.place(label) for label in (TAU, FUNCTION_SCALES)]
        zeta = [own.zeta(y)[..., place] for place in places]
        return self.posterior.adopt(own.theta(y), np.concatenate(zeta, axis=-1))

    def adopt_covariance(self, covariance: Array, y: Array) -> Array:
        """Return a covariance (n, n) of coordinates that are found as the geometry's, (m, m), of the readings' at y."""
        m = self.posterior.n_geometry
        if self.legs is None:
            return covariance[:m, :m]
        own, speed = self.legs.posterior.sampling, self.posterior.around(y)[1].T.sum(axis=1)
        change = own.jacobian(self.posterior.theta(y[None])[0])[own.free] / speed[:, None]
        return np.asarray(change @ covariance[:m, :m] @ change.T)

    def pick(self, rows: np.ndarray) -> MeasuredReadings:
        """Return the variant after some of its poses."""
        posterior = replace(self.posterior, likelihood=self.posterior.likelihood.pick(rows))
        return replace(self, posterior=posterior, legs=None if self.legs is None else self.legs.pick(rows))

    def retake(self, values: Array) -> MeasuredReadings:
        """Return the variant as if its plan had other readings, (P, K), or twice as many, (2 P, K)."""
        n = self.posterior.likelihood.data.n_poses
        again = self.pick(np.tile(np.arange(n), len(values) // n))
        likelihood = again.posterior.likelihood
        names = tuple(f"{name}{' again' * (k >= n)}" for k, name in enumerate(likelihood.data.poses))
        data = replace(likelihood.data, poses=names, values=values)
        posterior = replace(again.posterior, likelihood=replace(likelihood, data=data, expansion=None))
        return replace(
            again, posterior=posterior, legs=None if again.legs is None else again.legs.retake(names, values)
        )


def measure_variants(
    experiment: object, config: Any, path: Path, names: Sequence[str], with_model_error: bool = True
) -> dict[str, MeasuredReadings]:
    """Return what an experiment in a file has measured, by its variants' names, all where none is named.

    Raises
    ------
    InputError
        Where it measures no machine, or has no such variant.
    """
    if not isinstance(experiment, Measuring):
        raise InputError(f"{path}: kind: found {config.kind!r}, expected 'study', with measured data")
    known = [one.name for one in config.variants]
    for name in names:
        if name not in known:
            raise InputError(f"{path}: variant {name!r}: unknown here, expected one of {', '.join(known)}")
    return experiment.measure(config, path, names or known, with_model_error)


def _see_errors(measured: MeasuredVariant, model: Legs) -> tuple[ErrorTerm, ...]:
    """Return what legs err by, each and as functions of the pose, as errors of the readings of their actuators."""
    errors, likelihood = measured.posterior.errors, measured.posterior.likelihood
    error, actuators = errors.model_error, measured.poses.actuators
    terms = [] if error.scale is None else ["independent"]
    floors, scale, few = {"independent": error.floor}, 0.0, False
    order, n_places = np.arange(len(actuators)), len(actuators)
    if isinstance(likelihood, FunctionLikelihood):
        terms += likelihood.functions.sorts
        scales = next(one for one in errors.terms if isinstance(one, Amplitudes) and one.label == FUNCTION_SCALES)
        floors |= dict(zip(likelihood.functions.sorts, scales.floors, strict=True))
        prior, few = scales.priors[0], likelihood.functions.of_few is not None
        assert isinstance(prior, HalfCauchyPrior)
        scale = prior.scale
        if likelihood.place.time is not None:
            order, n_places = np.rint(likelihood.n_places * likelihood.place.time).astype(int), likelihood.n_places
    mechanism, n = model.machine.mechanism, model.n_legs
    own = OwnChannels(
        Comparison(model.channels[:n]),
        np.arange(n),
        mechanism.initial_actuator_positions,
        np.full(n, mechanism.actuator_range),
        np.ones(n),
        order,
        n_places,
        actuators,
        actuators,
        np.ones(len(actuators), dtype=bool),
    )
    return build_model_error(
        own, len(model.channels), terms, (error.scale or 0.0, scale), floors, each=not error.shared, few=few
    )


def see_legs(measured: MeasuredVariant) -> MeasuredReadings:
    """Return poses measured of a machine on legs as readings of its actuators and of its pose."""
    own, model = measured.posterior, Legs(measured.machine)
    left = 0.0 if measured.actuator_variance is None else measured.actuator_variance
    noise = np.sqrt(measured.actuator_noise**2 + left)
    errors = Errors(_see_errors(measured, model))
    found = place_legs(model, measured.poses, noise, own.priors, errors, own.fixed)
    return MeasuredReadings(
        measured.name,
        measured.origin,
        found.posterior,
        found.low,
        found.high,
        found.internal,
        measured,
        measured.n_held_back,
    )
