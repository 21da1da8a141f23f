"""What audits and checks take from a kind of experiment that has measured a machine, without knowing that kind."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from bayescal.data.measured_poses import MeasuredPoses
from bayescal.density.calibration.likelihood import CalibrationPosterior
from bayescal.density.legs import LegPosterior
from bayescal.density.priors import Prior
from bayescal.machines.kinematics import Machine
from bayescal.numerics.geometry import Array


@dataclass(frozen=True, eq=False)
class MeasuredVariant:
    """A machine that has been measured, seen through one variant.

    Attributes
    ----------
    name : str
    origin : str
        Of the data, in words.
    mechanism : Path
        Its file.
    free : tuple of str
        Symbols of the free parameters.
    machine : Machine
    priors : mapping of parameter to Prior
    fixed : mapping of parameter to float
        Values of fixed ones that are not nominal.
    posterior : LegPosterior
    poses : MeasuredPoses
        The calibration poses.
    actuator_noise : float
        Standard deviation, mm.
    left_variance : float
        What the measured part of a deformation leaves, mean over legs and poses, mm².
    actuator_variance : ndarray, shape (P, N), or None
        The same leg by leg and pose by pose; None where nothing of a deformation was measured.
    shared_errors : ndarray, shape (P, N, M), or None
        What M unknowns of it, standard normal, add to the legs' errors at all poses: ``actuator_variance`` as they are.
    described : mapping
        What was measured, in the study's own words.
    n_held_back : int
        How many poses were measured besides, kept for verification.
    """

    name: str
    origin: str
    mechanism: Path
    free: tuple[str, ...]
    machine: Machine
    priors: Mapping[str, Prior]
    fixed: Mapping[str, float]
    posterior: LegPosterior
    poses: MeasuredPoses
    actuator_noise: float
    left_variance: float
    actuator_variance: Array | None = None
    shared_errors: Array | None = None
    described: Mapping[str, Any] = field(default_factory=dict)
    n_held_back: int = 0


@dataclass(frozen=True)
class VariantChoice:
    """Which variant of an experiment is wanted: the only one of a model and deformation, or one of these by its name.

    Attributes
    ----------
    model, deformation : str
    name : str or None
    """

    model: str
    deformation: str
    name: str | None = None


class Measuring(ABC):
    """A kind of experiment whose measurements an audit may take in place of a plan."""

    @abstractmethod
    def measure(self, config: Any, path: Path, choice: VariantChoice, with_model_error: bool) -> MeasuredVariant:
        """Return a variant of the experiment in a file; InputError where there is none such, or more than one."""

    @abstractmethod
    def list_variants(self, config: Any) -> dict[str, VariantChoice]:
        """Return the experiment's variants by their names."""


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
    """

    name: str
    origin: str
    posterior: CalibrationPosterior
    low: Array
    high: Array
    internal: np.ndarray

    @property
    def half(self) -> Array:
        """Half widths of the workspace, shape (q,)."""
        return 0.5 * (self.high - self.low)

    def first(self, n: int) -> MeasuredReadings:
        """Return the variant after the first n of its poses."""
        return replace(self, posterior=replace(self.posterior, likelihood=self.posterior.likelihood.pick(np.arange(n))))


class MeasuringReadings(ABC):
    """A kind of experiment that calibrates a machine of any channels."""

    @abstractmethod
    def measure_readings(self, config: Any, folder: Path, names: Sequence[str]) -> dict[str, MeasuredReadings]:
        """Return variants of the experiment by their names, all where none is named; InputError for an unknown one."""
