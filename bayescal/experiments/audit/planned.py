"""What an audit needs of a machine and a plan, whichever way poses are measured: rows, to first order."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple, Self

import numpy as np

from bayescal.errors import InputError
from bayescal.experiments.audit.schema import AuditConfig, WhatIfConfig
from bayescal.identifiability.calibration import Calibrations
from bayescal.identifiability.directions import Direction
from bayescal.identifiability.found_sizes import expect_sizes
from bayescal.identifiability.information import Information
from bayescal.identifiability.requirements import COMPONENTS, Forecast, Requirement
from bayescal.identifiability.ridges import Ridge
from bayescal.identifiability.structure import Structure
from bayescal.numerics.geometry import Array
from bayescal.numerics.units import MICROMETRE, Units


class FreeParameters(NamedTuple):
    """Names, inner units, standard deviations of the priors and nominal values of n parameters, (n,) each."""

    names: tuple[str, ...]
    units: tuple[str, ...]
    sd: Array
    nominal: Array


class Planned(ABC):
    """A machine, what is known of its n parameters, and a plan of measurement.

    Attributes
    ----------
    config : AuditConfig
    requirements : sequence of Requirement
    units : Units
        Those of tolerances, requirements and results.
    """

    config: AuditConfig
    requirements: Sequence[Requirement]
    units: Units

    # --- the parameters --------------------------------------------------------------------------------------------

    @property
    @abstractmethod
    def parameters(self) -> FreeParameters:
        """The free parameters."""

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

    @property
    def frames(self) -> frozenset[str]:
        """Symbols that rather define than describe a machine."""
        return frozenset()

    # --- the plan --------------------------------------------------------------------------------------------------

    @property
    @abstractmethod
    def n_poses(self) -> int:
        """Number of planned poses P."""

    @property
    @abstractmethod
    def is_beyond_range(self) -> bool:
        """Whether the actuators would have to reach further than they do."""

    @abstractmethod
    def inform(self) -> Information:
        """Return what the plan tells of the parameters; InputError for a pose that the machine cannot take."""

    @abstractmethod
    def find_structure(self, rng: np.random.Generator) -> Structure:
        """Return what no measurement of this kind sees, poses far beyond the plan's included."""

    @abstractmethod
    def forecast(self) -> Forecast:
        """Return how what has to be accurate errs over the workspace."""

    @abstractmethod
    def describe(self, directions: Sequence[Direction]) -> list[Ridge]:
        """Return the ridges among directions, in words."""

    @property
    @abstractmethod
    def tool_units(self) -> tuple[str, ...]:
        """Inner units of what has to be accurate."""

    @abstractmethod
    def name_workspace_pose(self, k: int) -> str:
        """Return where a pose of the forecast is."""

    @abstractmethod
    def describe_variant(self) -> dict[str, Any]:
        """Return what measures: ``title``, ``data`` and the number of equations."""

    def summarise_ridges(self, ridges: Sequence[Ridge]) -> dict[str, Any]:
        """Return what ``summary.json`` says of all ridges together; nothing here."""
        del ridges
        return {}

    @abstractmethod
    def summarise_plan(self) -> dict[str, Any]:
        """Return machine and plan for ``summary.json``."""

    # --- other plans, and checks -----------------------------------------------------------------------------------

    def list_changes(self) -> list[WhatIfConfig]:
        """Return the changes of this kind of plan that are evaluated where the config names none; none here."""
        return []

    @abstractmethod
    def change(self, change: WhatIfConfig) -> Self:
        """Return the same machine with a changed plan; InputError where there is none."""

    # --- errors that are functions of the pose -----------------------------------------------------------------------

    @property
    @abstractmethod
    def sizes(self) -> Mapping[str, float]:
        """Root mean squares over the planned poses of systematic errors by term as they are allowed for, mm."""

    @property
    @abstractmethod
    def function_scale(self) -> float:
        """Scale of the prior of each of these sizes, as a study has it, mm."""

    @property
    def floors(self) -> Mapping[str, float]:
        """What each term has at least, as stated, mm."""
        return self.config.model_error.lengths()

    def describe_errors(self) -> dict[str, dict[str, float]]:
        """Return for ``summary.json`` how large systematic errors are, and what is stated of unseen ones, µm."""
        found = {"systematic_um": self.sizes, "at_least_um": self.floors if self.sizes else {}}
        return {key: {name: size / MICROMETRE for name, size in one.items()} for key, one in found.items() if one}

    @abstractmethod
    def list_rows(self) -> tuple[Array, Array, np.ndarray]:
        """Return white rows (K, n), their columns of systematic errors (K, q), and of which term each is (q,)."""

    def settle(self, true: Mapping[str, float]) -> Self:
        """Return the same with the sizes that a study is expected to find of errors of these sizes, mm."""
        if not true:
            return self.bare()
        rows = self.resize(dict.fromkeys(true, 1.0)).list_rows()
        return self.resize(expect_sizes(*rows, true, self.floors, self.function_scale))

    @abstractmethod
    def resize(self, sizes: Mapping[str, float]) -> Self:
        """Return the same with systematic errors of other sizes, mm; without those that are not named."""

    def bare(self) -> Self:
        """Return the same without systematic errors."""
        return self.resize({})

    def propose(self) -> tuple[str, Self] | None:
        """Return a better plan with its name, if there is a way to find one; InputError where there is none."""
        return None

    @abstractmethod
    def simulate(self, n: int, rng: np.random.Generator, fitted: Sequence[int]) -> tuple[Calibrations, np.ndarray]:
        """Return n simulated calibrations of some parameters, and how many keep each requirement."""

    @abstractmethod
    def average(self, n: int, rng: np.random.Generator) -> Array:
        """Return the posterior covariance averaged over n machines of the priors, in units of the tolerances."""


def read_requirements(
    config: AuditConfig, units: Mapping[str, str], components: tuple[str, ...] = COMPONENTS
) -> tuple[Requirement, ...]:
    """Return the largest errors that are allowed, inner units.

    Parameters
    ----------
    config : AuditConfig
    units : mapping of str to str
        What may be required, with its inner unit.
    components : tuple of str
        What has to be accurate.
    """
    for name in config.requirements:
        if name not in units:
            raise InputError(f"requirements: found {name!r}, expected some of {', '.join(units)}")
    said = Units(config.units.length, config.units.angle)
    return tuple(
        Requirement(name, config.requirements[name] * said.factor(unit), components, config.required_of)
        for name, unit in units.items()
        if name in config.requirements
    )
