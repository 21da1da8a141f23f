"""What audits and checks take from a kind of experiment that has measured a machine, without knowing that kind."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from bayescal.density.calibration.likelihood import CalibrationPosterior
from bayescal.errors import InputError, say_unknown
from bayescal.experiments.runner.results import Summary
from bayescal.experiments.shared.slip_rows import VariantReadings
from bayescal.experiments.shared.study_schema import StudyConfig
from bayescal.numerics.geometry import Array


class MeasuringKind(ABC):
    """A kind of experiment that measures a machine."""

    @abstractmethod
    def measure(
        self, config: StudyConfig, path: Path, names: Sequence[str], with_model_error: bool
    ) -> dict[str, MeasuredReadings]:
        """Return variants of the config of a file by their names, which are all there."""


@dataclass(frozen=True, eq=False)
class MeasuredReadings:
    """A machine of K channels that has been measured, seen through one variant."""

    name: str
    origin: str  # of the data, in words
    posterior: CalibrationPosterior  # of the calibration poses
    low: Array  # with high, (q,): the workspace, mm and rad
    high: Array
    internal: np.ndarray  # (K,): which channels the machine keeps after its calibration
    n_held_back: int = 0  # how many poses were measured besides, kept for verification
    described: Summary = field(default_factory=dict)  # what was measured, in the study's own words
    aligned: bool = False  # whether its accuracy is what remains after base and tool are aligned
    denied: tuple[str, ...] = ()  # kinds of slips that its data are not, as the study's config says

    @property
    def half(self) -> Array:
        """Half widths of the workspace, shape (q,)."""
        return 0.5 * (self.high - self.low)

    @cached_property
    def with_pose_guesses(self) -> CalibrationPosterior:
        """The posterior of the readings that looks for poses near those of its least-squares solution."""
        return self.posterior.with_pose_guesses()

    @property
    def readings(self) -> VariantReadings:
        """The readings, of which causes of a misfit are weighed."""
        return VariantReadings(self.posterior, self.low, self.high, self.internal)

    def count_by_row(self) -> MeasuredReadings:
        """Return the variant with known errors that all rows have in common as noise of each row by itself.

        What K from targets lacks is another error in another measurement, or at poses that nobody measured.
        """
        errors, likelihood = self.posterior.errors, self.posterior.likelihood
        known, data = errors.known, likelihood.data
        if not known:
            return self
        square = sum((one.sign * np.sum(one.act(data) ** 2, axis=-1) for one in known), start=np.zeros_like(data.sd))
        noisy = replace(likelihood, data=replace(data, sd=np.sqrt(data.sd**2 + np.maximum(square, 0.0))))
        return replace(self, posterior=replace(self.posterior, likelihood=noisy, errors=errors.without(known)))

    def pick(self, rows: np.ndarray) -> MeasuredReadings:
        """Return the variant after some of its poses."""
        posterior = replace(self.posterior, likelihood=self.posterior.likelihood.pick(rows))
        return replace(self, posterior=posterior)

    def retake(self, values: Array) -> MeasuredReadings:
        """Return the variant as if its plan had other readings, (P, K), or twice as many, (2 P, K)."""
        n = self.posterior.likelihood.data.n_poses
        again = self.pick(np.tile(np.arange(n), len(values) // n))
        likelihood = again.posterior.likelihood
        names = tuple(f"{name}{' again' * (k >= n)}" for k, name in enumerate(likelihood.data.poses))
        data = replace(likelihood.data, poses=names, values=values)
        return replace(
            again, posterior=replace(again.posterior, likelihood=replace(likelihood, data=data, expansion=None))
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
    measuring = check_measures(experiment, config, path)
    known = [one.name for one in config.variants]
    for name in names:
        if name not in known:
            raise InputError(f"{path}: variant {name!r}: expected one of {', '.join(known)}")
    return measuring.measure(config, path, names or known, with_model_error)


def check_measures(experiment: object, config: Any, path: Path) -> MeasuringKind:
    """Return the kind of experiment of a file; InputError where it measures no machine."""
    if not isinstance(experiment, MeasuringKind):
        raise InputError(f"{path}: kind: found {config.kind!r}, expected 'study'")
    return experiment


def choose_variant(name: str | None, config: StudyConfig, path: Path) -> str:
    """Return which variant of a file's study a config of another kind is about: its only one where none is named."""
    known = [one.name for one in config.variants]
    if not name and len(known) == 1:
        return known[0]
    if name not in known:
        raise InputError(say_unknown(f"{path}: variant", name or "none", known))
    return name
