"""The next pose of any machine that is read by channels: its pose unknown, candidates and workspace by coordinates."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from bayescal.density.calibration.likelihood import CalibrationPosterior
from bayescal.density.calibration.measurements import Comparison
from bayescal.errors import NumericalError
from bayescal.experiments.next_pose.state import Shown, State, Subject
from bayescal.experiments.shared.measured import MeasuredReadings
from bayescal.experiments.shared.search_memory import list_readings
from bayescal.identifiability.reading_rows import (
    View,
    differentiate_poses,
    linearise_near,
    typical_given,
    typical_noise,
)
from bayescal.identifiability.remaining import ToolRemaining, move_draws
from bayescal.identifiability.requirements import Requirement
from bayescal.inference.updating import Belief
from bayescal.machines.readings import Channel, Coordinate, Given
from bayescal.numerics.geometry import Array
from bayescal.pose_selection.next_pose import find_unmeasured
from bayescal.report.numbers import format_fixed

DRAWS, SEEN = 8, 6
"""Arrays of all draws, and of all candidates and poses of the workspace by channels and parameters."""
APART = 0.02  # of the workspace's half widths: closer to a measured pose, a candidate would be the same again
DECIMALS = {"mm": 3, "deg": 4}


@dataclass(frozen=True, eq=False)
class ReadingsSubject(Subject):
    """A variant of any machine.

    Attributes
    ----------
    measured : MeasuredReadings
    requirements : list of Requirement
    workspace, candidates : ndarray, shapes (W, q) and (C, q)
        Poses, mm and rad.
    candidate_given : mapping of str to ndarray, shape (C,)
        What the machine has to know of the candidates.
    """

    measured: MeasuredReadings
    requirements: list[Requirement]
    workspace: Array
    candidates: Array
    candidate_given: Given

    @cached_property
    def posterior(self) -> CalibrationPosterior:
        """Of the poses measured so far."""
        return self.measured.posterior.anchored()

    @property
    def n_poses(self) -> int:
        """How many these are."""
        return self.measured.posterior.likelihood.data.n_poses

    @property
    def n_workspace(self) -> int:
        """Number of poses that stand for the workspace."""
        return len(self.workspace)

    @cached_property
    def allowed(self) -> np.ndarray:
        """Which candidates have not been measured, shape (C,)."""
        return find_unmeasured(self.candidates, self.posterior.likelihood.start, APART * self.measured.half)

    def first(self, n: int) -> ReadingsSubject:
        """Return the same after the first n of its poses."""
        return replace(self, measured=self.measured.first(n))

    def know(self, belief: Belief, seed: int) -> ReadingsState:
        """Return what is known by a belief."""
        return ReadingsState(belief, seed, self)

    @property
    def workspace_given(self) -> Given:
        """What the machine has to know of the workspace's poses: the medians of those measured."""
        return typical_given(self.posterior.likelihood.data.given, len(self.workspace))

    def list_arrays(self, n_draws: int) -> list[Sequence[float]]:
        """Return what it holds; see `estimate_arrays`."""
        model, n = self.posterior.likelihood.model, self.posterior.n_parameters
        n_channels, q = len(model.channels), len(model.coordinates)
        width = n_channels * (model.layout.size + q + n_channels)
        return [
            *list_readings(self.n_poses, n_channels, n, q),
            (SEEN, len(self.candidates) + self.n_workspace, width),
            (DRAWS, n_draws, n + n_channels),
        ]

    def list_shown(self) -> list[Shown]:
        """Return the coordinates, and what the machine's own channels will read there."""
        model = self.posterior.likelihood.model
        own = [one for one, internal in zip(model.channels, self.measured.internal, strict=True) if internal]
        return [
            *(_show(one, f"{one.name}", "Pose") for one in model.coordinates),
            *(_show(one, _stem(one.name), "Own sensors, expected") for one in own),
        ]


@dataclass(frozen=True, eq=False)
class ReadingsState(State):
    """Any machine after the poses measured so far; its parameters in the posterior's coordinates."""

    machine: ReadingsSubject

    @property
    def subject(self) -> ReadingsSubject:
        """The variant."""
        return self.machine

    @property
    def _posterior(self) -> CalibrationPosterior:
        return self.machine.posterior

    @cached_property
    def theta(self) -> Array:
        """Draws of the true machine, shape (S, D)."""
        return self._posterior.theta(self.belief.draws)

    @cached_property
    def _y(self) -> Array:
        """The mean of the draws, shape (n,)."""
        return np.asarray(self.belief.draws.mean(axis=0))

    @cached_property
    def covariance(self) -> Array:
        """Of the parameters' coordinates, shape (m, m)."""
        m = self._posterior.n_geometry
        return self.belief.covariance[:m, :m]

    @cached_property
    def rows(self) -> Array:
        """What all channels say of the parameters at each candidate, its pose eliminated, shape (C, K, m)."""
        every = np.ones(len(self.machine.measured.internal), dtype=bool)
        there, seen = self._see(self.machine.candidates, every, self.machine.candidate_given)
        rows = np.zeros((len(self.machine.candidates), *seen.rows.shape[1:]))
        rows[there] = seen.rows
        return rows

    @cached_property
    def slope(self) -> Array:
        """Where the tool errs as its own channels locate it, by the parameters, shape (W, c, m)."""
        there, seen = self._see(self.machine.workspace, self.machine.measured.internal, self.machine.workspace_given)
        if len(there) < len(self.machine.workspace):
            raise NumericalError("workspace: found poses that the calibrated machine cannot take, expected none")
        return seen.tool

    def _see(self, pose: Array, some: np.ndarray, given: Given) -> tuple[np.ndarray, View]:
        """Return which poses the machine can take, and these as some channels see them."""
        slopes = differentiate_poses(self._posterior, self.machine.measured.half, self._y, pose, given)
        return slopes.places, slopes.seen_by(some)

    @cached_property
    def remaining(self) -> ToolRemaining:
        """Errors of the tool over the workspace."""
        own, subject = np.flatnonzero(self.machine.measured.internal), self.machine
        own = own[self._posterior.likelihood.data.present[:, own].any(axis=0)]
        model = self._posterior.likelihood.model.pick(own)
        sd = typical_noise(self._posterior, self.belief.draws)[:, own]
        return ToolRemaining(model, self.calibrated, subject.workspace, subject.workspace_given, sd, self.seed)

    @property
    def stays(self) -> str:
        """The noise of its own channels, in words."""
        return "the noise of the machine's own sensors stays"

    def move(self, covariance: Array) -> Array:
        """Return the draws (S, D) as they would be with another covariance of the parameters, (m, m)."""
        m, y = self._posterior.n_geometry, self.belief.draws.copy()
        y[:, :m] = self._y[:m] + move_draws(y[:, :m] - self._y[:m], self.covariance, covariance)
        return self._posterior.theta(y)

    def predict(self, reference: State) -> tuple[Array, Array]:
        """Return what readings at the candidates leave for this variant against another one, and its covariance.

        In the directions, K - q of the white readings, that no pose of the other one explains.
        """
        assert isinstance(reference, ReadingsState)
        subject, other = self.machine, reference.machine
        given, model = subject.candidate_given, self._posterior.likelihood.model
        there = linearise_near(other.posterior.likelihood.model, reference.calibrated, subject.candidates, given)
        here = linearise_near(model, self.calibrated, subject.candidates, given)
        variance, white = self.noise_variance, 1.0 / np.sqrt(reference.noise_variance)
        read = np.isfinite(variance)
        basis = np.linalg.qr(np.nan_to_num(white[read, None] * there.by_pose[:, read]), mode="complete").Q
        free = basis[..., there.by_pose.shape[-1] :] * white[read, None]  # (C, K, K - q)
        across = np.swapaxes(free, 1, 2)
        apart = Comparison(model.channels).subtract(here.values, there.values)[:, read]
        rows = across @ np.nan_to_num(here.by_parameters[:, read]) @ self._posterior.around(self._y)[1].T.T
        covariance = rows @ self.covariance @ np.swapaxes(rows, 1, 2) + across @ (variance[read, None] * free)
        return np.einsum("ckd,ck->cd", free, np.nan_to_num(apart)), covariance

    @cached_property
    def noise_variance(self) -> Array:
        """Mean square of the noise of each channel, (K,); NaN where it has none."""
        return np.asarray(np.mean(typical_noise(self._posterior, self.belief.draws) ** 2, axis=0))

    def list_poses(self, chosen: np.ndarray) -> dict[str, Array]:
        """Return the coordinates, and what the machine's own channels will read there."""
        subject, model = self.machine, self._posterior.likelihood.model
        pose = subject.candidates[chosen]
        given = {name: value[chosen] for name, value in subject.candidate_given.items()}
        read = model.read(self.calibrated, pose, given)[:, subject.measured.internal]
        both = np.concatenate([pose, read], axis=1)
        shown = subject.list_shown()
        return {one.column: np.degrees(both[:, k]) if one.unit == "deg" else both[:, k] for k, one in enumerate(shown)}

    def describe_pose(self, candidate: int) -> str:
        """Return the pose to go to."""
        columns = self.list_poses(np.array([candidate]))
        said = [
            f"{one.heading} = {format_fixed(float(columns[one.column][0]), one.decimals)} {one.unit}"
            for one in self.machine.list_shown()
            if one.group == "Pose"
        ]
        return f"Go to {', '.join(said)}."


def _show(one: Coordinate | Channel, stem: str, group: str) -> Shown:
    unit = "deg" if one.unit == "rad" else one.unit
    return Shown(f"{stem}_{unit}", one.name, unit, group, DECIMALS.get(unit, 4))


def _stem(name: str) -> str:
    return name.replace("[", "_").rstrip("]")
