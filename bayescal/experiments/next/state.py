"""What is known of a machine after some poses, and what a further pose does: what the next pose is found from.

Candidates and workspace stand as coordinates of the pose or, where the machine is sent there by them, as commands: then
the pose is where the machine as known takes them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from bayescal.density.calibration.likelihood import CalibrationPosterior
from bayescal.density.calibration.measurements import Comparison
from bayescal.experiments.shared.measured import MeasuredReadings
from bayescal.experiments.shared.search_memory import list_readings
from bayescal.identifiability.reading_rows import (
    View,
    differentiate_poses,
    linearise_near,
    typical_covariance,
    typical_noise,
    whiten,
)
from bayescal.identifiability.requirements import Requirement, Standing, ToolRemaining, find_limits, move_draws
from bayescal.inference.updating import Belief, update
from bayescal.machines.readings import Channel, Coordinate, Given, ReadingModel
from bayescal.numerics.geometry import Array
from bayescal.pose_selection.next_pose import find_unmeasured
from bayescal.report.numbers import format_fixed

DRAWS, SEEN = 8, 6
"""Arrays of all draws, and of all candidates and poses of the workspace by channels and parameters."""
APART = 0.02  # of the half widths of workspace or commands: closer to a measured pose, it would be the same again
DECIMALS = {"mm": 3, "deg": 4}
EXPECTED = "Own sensors, expected"


@dataclass(frozen=True)
class Shown:
    """A column of the poses to come, as the page shows it.

    Attributes
    ----------
    column, heading, unit, group : str
    decimals : int
    """

    column: str
    heading: str
    unit: str
    group: str
    decimals: int


@dataclass(frozen=True, eq=False)
class Poses:
    """C poses of a machine.

    Attributes
    ----------
    values : ndarray, shape (C, q) or (C, N)
        Coordinates, or commands; mm and rad.
    given : mapping of str to ndarray, shape (C,)
        What the machine has to know of each.
    commanded : bool
        Whether they are commands.
    """

    values: Array
    given: Given
    commanded: bool = False

    def place(self, model: ReadingModel, theta: Array) -> Array:
        """Return coordinates (C, q) of a machine (D,); NaN where it has no such pose."""
        return model.locate(theta, self.values, self.given)[0] if self.commanded else self.values


@dataclass(frozen=True, eq=False)
class Subject:
    """One variant of a machine with the poses measured so far, and those that may be measured.

    Attributes
    ----------
    measured : MeasuredReadings
    requirements : list of Requirement
    workspace, candidates : Poses
    """

    measured: MeasuredReadings
    requirements: list[Requirement]
    workspace: Poses
    candidates: Poses

    @property
    def posterior(self) -> CalibrationPosterior:
        """Of the readings so far."""
        return self.measured.anchored

    @property
    def model(self) -> ReadingModel:
        """What the machine reads."""
        return self.measured.posterior.likelihood.model

    @property
    def n_poses(self) -> int:
        """How many poses have been measured."""
        return self.measured.posterior.likelihood.data.n_poses

    @property
    def n_workspace(self) -> int:
        """Number of poses that stand for the workspace."""
        return len(self.workspace.values)

    @cached_property
    def allowed(self) -> np.ndarray:
        """Which candidates have not been measured, shape (C,)."""
        reach, measured = self.measured.half, self.posterior.likelihood.start
        if self.candidates.commanded:
            reach = 0.5 * np.ptp(self.model.command_range, axis=1)
            measured = self.posterior.likelihood.data.values[:, self.model.select(self.model.commanded)]
        return find_unmeasured(self.candidates.values, measured, APART * reach)

    def first(self, n: int) -> Subject:
        """Return the same after the first n of its poses."""
        return replace(self, measured=self.measured.pick(np.arange(n)))

    def list_arrays(self, n_draws: int) -> list[Sequence[float]]:
        """Return what it holds of candidates, workspace and so many draws; see `estimate_arrays`."""
        n, n_channels = self.posterior.n_parameters, len(self.model.channels)
        width = n_channels * (self.model.layout.size + len(self.model.coordinates) + n_channels)
        return [
            *list_readings(self.n_poses, n_channels, n, len(self.model.coordinates)),
            (SEEN, len(self.candidates.values) + self.n_workspace, width),
            (DRAWS, n_draws, n + n_channels),
        ]

    def list_shown(self) -> list[Shown]:
        """Return what the page shows of the poses to come: how to go there, and what is expected there."""
        channels = [one for one, own in zip(self.model.channels, self.measured.internal, strict=True) if own]
        pose = [_show(one, one.name, "Platform, expected" if self._home else "Pose") for one in self.model.coordinates]
        own = [_show(one, one.name.replace("[", "_").rstrip("]"), EXPECTED) for one in channels]
        home = (one for one in channels if one.name in self._home)
        moves = [_show(one, f"displacement_{_place(one)}", "Displacement of actuator") for one in home]
        return [*(replace(one, heading=one.column.split("_")[1]) for one in moves), *pose, *own]

    @property
    def _home(self) -> dict[str, float]:
        """Positions at home of commands that candidates stand as, by their names."""
        middle = self.model.command_range.mean(axis=1).tolist()
        return dict(zip(self.model.commanded, middle, strict=True)) if self.candidates.commanded else {}


@dataclass(frozen=True, eq=False)
class State:
    """A variant after the poses measured so far; S draws, m parameters in the posterior's coordinates, C candidates.

    Attributes
    ----------
    belief : Belief
    seed : int
    subject : Subject
    """

    belief: Belief
    seed: int
    subject: Subject

    @property
    def _posterior(self) -> CalibrationPosterior:
        return self.subject.posterior

    @cached_property
    def _draws(self) -> Array:
        """Draws of the posterior of the readings, (S, n)."""
        return self.subject.measured.adopt(self.belief.draws)

    @cached_property
    def _y(self) -> Array:
        """Their mean, shape (n,)."""
        return np.asarray(self._draws.mean(axis=0))

    @cached_property
    def theta(self) -> Array:
        """Draws of the true machine, shape (S, D)."""
        return self._posterior.theta(self._draws)

    @cached_property
    def calibrated(self) -> Array:
        """The machine as calibrated, the posterior mean, shape (D,)."""
        return np.asarray(self.theta.mean(axis=0))

    @cached_property
    def covariance(self) -> Array:
        """Of the parameters' coordinates, shape (m, m)."""
        return self.subject.measured.adopt_covariance(self.belief.covariance, self._y)

    @cached_property
    def _candidates(self) -> Array:
        """Where the machine as calibrated is at the candidates, (C, q)."""
        return self.subject.candidates.place(self.subject.model, self.calibrated)

    @cached_property
    def _workspace(self) -> Array:
        """Where it is at the workspace's poses, (W, q)."""
        return self.subject.workspace.place(self.subject.model, self.calibrated)

    # --- what poses say ----------------------------------------------------------------------------------------------

    @cached_property
    def rows(self) -> Array:
        """What all channels say of the parameters at each candidate, its pose eliminated, shape (C, K, m)."""
        every = np.ones(len(self.subject.measured.internal), dtype=bool)
        there, seen = self._see(self._candidates, every, self.subject.candidates.given)
        rows = np.zeros((len(self._candidates), *seen.rows.shape[1:]))
        rows[there] = seen.rows
        return rows

    @cached_property
    def slope(self) -> Array:
        """Where the tool errs as its own channels locate it, by the parameters, shape (W, c, m)."""
        return self._see(self._workspace, self.subject.measured.internal, self.subject.workspace.given)[1].tool

    def _see(self, pose: Array, some: np.ndarray, given: Given) -> tuple[np.ndarray, View]:
        """Return which poses the machine can take, and these as some channels see them."""
        slopes = differentiate_poses(self._posterior, self.subject.measured.half, self._y, pose, given)
        return slopes.places, slopes.seen_by(some)

    @cached_property
    def weight(self) -> Array:
        """W (m, m): tr(W C) is the mean square of the workspace's errors in units of the limits (I-optimality)."""
        shares = self.slope / find_limits(self.subject.requirements, self.slope)[:, None]
        return np.asarray(np.einsum("wci,wcj->ij", shares, shares, optimize=True) / len(shares))

    def predict(self, reference: State) -> tuple[Array, Array]:
        """Return what readings at the candidates leave for this variant against another one, and its covariance.

        In the directions, K - q of the white readings, that no pose of the other one explains.
        """
        given, model, other = self.subject.candidates.given, self.subject.model, reference.subject.model
        pose, noise = reference._candidates, typical_covariance(self._posterior, self._y)
        there = linearise_near(other, reference.calibrated, pose, given)
        here = linearise_near(model, self.calibrated, pose, given)
        read = np.diagonal(noise) > 0.0
        white = whiten(typical_covariance(reference._posterior, reference._y), read)[read]
        basis = np.linalg.qr(np.nan_to_num(white @ np.nan_to_num(there.by_pose)), mode="complete").Q
        across = np.swapaxes(basis[..., there.by_pose.shape[-1] :], 1, 2) @ white  # (C, K - q, K)
        apart = np.nan_to_num(Comparison(model.channels).subtract(here.values, there.values))
        rows = across @ np.nan_to_num(here.by_parameters) @ self._posterior.around(self._y)[1].T.T
        covariance = rows @ self.covariance @ np.swapaxes(rows, 1, 2) + across @ noise @ np.swapaxes(across, 1, 2)
        return np.einsum("cdk,ck->cd", across, apart), covariance

    # --- requirements ------------------------------------------------------------------------------------------------

    @cached_property
    def remaining(self) -> ToolRemaining:
        """Errors of the tool over the workspace."""
        subject, own = self.subject, np.flatnonzero(self.subject.measured.internal)
        own = own[self._posterior.likelihood.data.present[:, own].any(axis=0)]
        sd = typical_noise(self._posterior, self._draws)[:, own]
        given = subject.workspace.given
        return ToolRemaining(subject.model, own, self.calibrated, self._workspace, given, sd, self.seed)

    @property
    def stays(self) -> str:
        """What errs where the geometry is known exactly, in words that end a sentence."""
        return "the noise of the machine's own sensors stays"

    @cached_property
    def standing(self) -> Standing:
        """How the requirements stand."""
        return self._judge(self.theta)

    @cached_property
    def at_best(self) -> Standing:
        """How they would stand were the geometry known exactly."""
        return self._judge(np.broadcast_to(self.calibrated, self.theta.shape))

    def after(self, covariance: Array) -> Standing:
        """Return how they are expected to stand with another covariance of the parameters, (m, m)."""
        m, y = self._posterior.n_geometry, self._draws.copy()
        y[:, :m] = self._y[:m] + move_draws(y[:, :m] - self._y[:m], self.covariance, covariance)
        return self._judge(self._posterior.theta(y))

    def _judge(self, theta: Array) -> Standing:
        return Standing(self.remaining.find_largest(self.subject.requirements, theta))

    # --- poses to come -----------------------------------------------------------------------------------------------

    def list_poses(self, chosen: np.ndarray) -> dict[str, Array]:
        """Return the columns of the table of poses to come, for some of the candidates."""
        subject, pose, candidates = self.subject, self._candidates[chosen], self.subject.candidates
        given = {name: value[chosen] for name, value in candidates.given.items()}
        read = subject.model.read(self.calibrated, pose, given)[:, subject.measured.internal]
        home = np.array(list(subject._home.values()))
        moves = candidates.values[chosen] - home if candidates.commanded else pose[:, :0]
        every = np.concatenate([moves, pose, read], axis=1)
        return {
            one.column: np.degrees(every[:, k]) if one.unit == "deg" else every[:, k]
            for k, one in enumerate(subject.list_shown())
        }

    def describe_pose(self, candidate: int) -> str:
        """Return in a sentence how to go to a candidate."""
        columns, shown = self.list_poses(np.array([candidate])), self.subject.list_shown()
        first = [(one, format_fixed(float(columns[one.column][0]), one.decimals)) for one in shown]
        first = [pair for pair in first if pair[0].group == shown[0].group]
        if self.subject.candidates.commanded:
            moves = ", ".join(value for _, value in first)
            return f"Displace the actuators from their initial positions by {moves} mm."
        return f"Go to {', '.join(f'{one.heading} = {value} {one.unit}' for one, value in first)}."


def find_state(subject: Subject, start: Array | None, n_draws: int, seed: int, *, anew: bool = True) -> State:
    """Return what is known after a variant's poses, updated from the mode before the last of them; see `update`."""
    return State(update(subject.measured.found, start, n_draws, seed, anew=anew), seed, subject)


def _show(one: Coordinate | Channel, stem: str, group: str) -> Shown:
    unit = "deg" if one.unit == "rad" else one.unit
    return Shown(f"{stem}_{unit}", one.name, unit, group, DECIMALS.get(unit, 4))


def _place(channel: Channel) -> str:
    return channel.name.partition("[")[2].rstrip("]")
