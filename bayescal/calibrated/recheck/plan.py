"""The fewest poses that show whether a calibration still holds, chosen one by one and then exchanged."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from itertools import product

import numpy as np
from scipy.stats import norm

from bayescal.calibrated.machine import CalibratedMachine
from bayescal.calibrated.predict import bound_workspace
from bayescal.calibrated.recheck.statistics import (
    Knowledge,
    ShiftTest,
    Suspects,
    build_test,
    keep_seen,
    look_again,
    predict_knowledge,
    say_size,
)
from bayescal.density.calibration.measurements import Measurements
from bayescal.errors import InputError
from bayescal.machines.kinematics import solve_forward_kinematics, solve_inverse_kinematics
from bayescal.machines.readings import Given, Legs
from bayescal.numerics.geometry import DEGREES_OF_FREEDOM, Array, matrix_from_rotation_vector

LEVELS = (-1.0, 0.0, 1.0)
RANDOM = 729
"""Candidates of machines whose actuators cannot be combined at will."""
EXCHANGES = 3
HOPEFUL = 0.03  # below the power asked for, from which on a plan is simulated


@dataclass(frozen=True, eq=False)
class Demand:
    """What a recheck has to do.

    Attributes
    ----------
    shift : ndarray, shape (N,)
        Of each parameter that may have shifted, in its unit.
    power : float
        With which it has to be found, whichever parameter it is.
    false_alarm : float
        Of all sessions together.
    sessions : int
        Within which it has to be found; each measures the same poses.
    most : int
        Poses that a session may have.
    in_sd : float or None
        The shift in standard deviations of each parameter, where it was stated so.
    """

    shift: Array
    power: float = 0.95
    false_alarm: float = 0.01
    sessions: int = 2
    most: int = 40
    in_sd: float | None = None


@dataclass(frozen=True, eq=False)
class RecheckPlan:
    """Poses of one session of a recheck.

    Attributes
    ----------
    suspects : Suspects
        N parameters, one of which may shift.
    chosen : ndarray of int, shape (P,)
        Which of the candidates, the one that shows most first.
    commands : ndarray, shape (P, C)
        In the channels' units.
    given : mapping of str to ndarray, shape (P,)
    test : ShiftTest
        Of all sessions.
    power : ndarray, shape (N,)
        With which the shift of each parameter is found.
    """

    suspects: Suspects
    chosen: np.ndarray
    commands: Array
    given: Given
    test: ShiftTest
    power: Array
    demand: Demand

    @cached_property
    def power_by_session(self) -> Array:
        """With which probability the shift that is found worst is found by each session, shape (J,)."""
        looks = [replace(self.test, information=self.test.information[: k + 1]) for k in range(self.demand.sessions)]
        return np.array([one.find_power().min() for one in looks])


def list_candidates(calibrated: CalibratedMachine, share: float) -> tuple[Array, Given]:
    """Return commands (C, n) over a share of the range, and what is given: corners, middles of edges and faces, home.

    Of a machine on six legs those of its actuators. Redundant legs cannot be combined at will: theirs hold random poses
    about home. Any other machine's hold such poses of its workspace, and random ones where these are few.
    """
    if not isinstance(calibrated.model, Legs):
        return _cover_workspace(calibrated, share)
    mechanism = calibrated.legs.mechanism
    reach = share * mechanism.actuator_range
    if mechanism.n_legs == DEGREES_OF_FREEDOM:
        moves = reach * np.array(list(product(LEVELS, repeat=mechanism.n_legs)))
        return _keep_reached(calibrated, mechanism.initial_actuator_positions + moves), {}
    return _place_near_home(calibrated, reach), {}


def _cover_workspace(calibrated: CalibratedMachine, share: float) -> tuple[Array, Given]:
    model, (low, high) = calibrated.model, bound_workspace(calibrated)
    middle, half = 0.5 * (low + high), 0.5 * share * (high - low)
    q, rng = len(low), np.random.default_rng(0)
    moves = np.array(list(product(LEVELS, repeat=q))).reshape(-1, q) if len(LEVELS) ** q <= RANDOM else np.zeros((1, q))
    moves = np.concatenate([moves, rng.uniform(-1.0, 1.0, (RANDOM - len(moves), q))])
    given = calibrated.typical(len(moves))
    commands = model.read(calibrated.theta, middle + half * moves, given)[:, calibrated.commanded]
    with np.errstate(invalid="ignore"):
        within = ((commands >= model.command_range[:, 0]) & (commands <= model.command_range[:, 1])).all(axis=1)
    _, found = model.locate(calibrated.theta, np.nan_to_num(commands), given, weights=calibrated.weights)
    if not (within & found).any():
        raise InputError(f"machine {calibrated.name!r}: found no pose of the workspace in reach, expected some")
    return commands[within & found], {name: value[within & found] for name, value in given.items()}


def _place_near_home(calibrated: CalibratedMachine, reach: float) -> Array:
    """Return the actuator positions (C, N) of random poses at which the one that moves most moves by about a reach."""
    machine, theta = calibrated.legs, calibrated.theta
    mechanism = machine.mechanism
    start = mechanism.initial_actuator_positions
    home = solve_forward_kinematics(machine, theta, start)
    here = machine.linearise(theta, home.position, home.rotation, start)
    size = np.array([1.0] * 3 + [1.0 / np.linalg.norm(mechanism.platform_points, axis=1).max()] * 3)
    moves = np.random.default_rng(0).uniform(-1.0, 1.0, (RANDOM, DEGREES_OF_FREEDOM)) * size
    needed = np.abs(moves @ np.linalg.solve(here.actuators, here.pose).T).max(axis=1, keepdims=True)
    moves *= reach / needed
    rotation = matrix_from_rotation_vector(moves[:, 3:]) @ home.rotation
    found = solve_inverse_kinematics(machine, theta, home.position + moves[:, :3], rotation, check=False)
    within = np.abs(found.actuators - start).max(axis=1) <= mechanism.actuator_range
    return _keep_reached(calibrated, found.actuators[found.converged & within])


def _keep_reached(calibrated: CalibratedMachine, actuators: Array) -> Array:
    found = solve_forward_kinematics(calibrated.legs, calibrated.theta, actuators, check=False)
    return actuators[found.converged]


def plan_recheck(
    calibrated: CalibratedMachine,
    suspects: Suspects,
    candidates: Array,
    given: Given,
    planned: Measurements,
    demand: Demand,
) -> RecheckPlan:
    """Return the fewest poses out of candidates, commands (C, n), that meet a demand.

    Parameters
    ----------
    candidates : ndarray, shape (C, n)
        Commands, in the channels' units.
    given : mapping of str to ndarray, shape (C,)
    planned : Measurements
        A row that says which channels are read, and their noise; see `predict_knowledge`.

    Raises
    ------
    InputError
        Where no number of poses up to ``demand.most`` does.
    """
    whole = predict_knowledge(calibrated, suspects, candidates, given, planned)
    kept, (knowledge,) = keep_seen(suspects, [whole])
    demand = replace(demand, shift=demand.shift[whole.seen])
    choice = _Choice(knowledge.scale(demand.shift), demand)
    chosen: list[int] = []
    while len(chosen) < min(demand.most, len(candidates)):
        chosen.append(choice.find_best(chosen))
        if choice.seems_enough(chosen):
            exchanged = choice.exchange(chosen)
            test, power = choice.judge(exchanged)
            if power.min() >= demand.power:
                final, test, power = choice.shorten(exchanged, test, power)
                there = {name: value[final] for name, value in given.items()}
                return RecheckPlan(kept, np.array(final), candidates[final], there, test, power, demand)
    worst = choice.judge(chosen)[1]
    least = int(np.argmin(worst))
    raise InputError(
        f"recheck: found that {len(chosen)} poses show a shift of {kept.names[least]} by "
        f"{say_size(float(demand.shift[least]), kept.units[least])} with {100.0 * worst[least]:.1f} % in "
        f"{demand.sessions} sessions, expected {100.0 * demand.power:g} %: a larger shift, more sessions or less noise"
    )


@dataclass(frozen=True, eq=False)
class _Choice:
    """Candidates out of which poses are chosen, shifts in units of those to be found."""

    knowledge: Knowledge
    demand: Demand

    def find_best(self, chosen: list[int]) -> int:
        """Return the candidate with which, beside those chosen, most is known of the shift that is known least."""
        knowledge = self.knowledge
        information = knowledge.add_each(knowledge.gram[chosen].sum(axis=0), self.demand.sessions)
        rate = information.min(axis=1) + 1e-3 * information.mean(axis=1)  # ties to those that say more
        rate[chosen] = -np.inf
        return int(np.argmax(rate))

    def exchange(self, chosen: list[int]) -> list[int]:
        """Return poses, each exchanged for the best candidate beside the others, until none is better."""
        chosen = list(chosen)
        for _ in range(EXCHANGES):
            before = list(chosen)
            for k in range(len(chosen)):
                chosen[k] = self.find_best(chosen[:k] + chosen[k + 1 :])
            if chosen == before:
                break
        return chosen

    def seems_enough(self, chosen: list[int]) -> bool:
        """Return whether the worst parameter's own statistic might pass the lowest threshold that there can be."""
        demand, gram = self.demand, self.knowledge.gram[chosen].sum(axis=0)
        _, information = self.knowledge.score(demand.sessions * gram)
        passed = norm.sf(norm.isf(demand.false_alarm / 2.0) - np.sqrt(np.diag(information).min()))
        return bool(passed > demand.power - HOPEFUL)

    def judge(self, chosen: list[int]) -> tuple[ShiftTest, Array]:
        """Return the test of some poses, and with which probability each shift is found."""
        gram = self.knowledge.gram[chosen].sum(axis=0)
        test = build_test(look_again(self.knowledge, [gram], self.demand.sessions), self.demand.false_alarm)
        return test, test.find_power()

    def shorten(self, chosen: list[int], test: ShiftTest, power: Array) -> tuple[list[int], ShiftTest, Array]:
        """Return fewer poses where some exchange finds them, and the rest as it is then."""
        while len(chosen) > 1:
            fewer = self.exchange(chosen[:-1])
            there, found = self.judge(fewer)
            if found.min() < self.demand.power:
                break
            chosen, test, power = fewer, there, found
        return chosen, test, power
