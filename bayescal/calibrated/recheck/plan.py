"""The fewest poses that tell whether a calibration still holds, chosen one by one and then exchanged."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from itertools import product

import numpy as np
from scipy.stats import norm

from bayescal.calibrated.machine import CalibratedMachine
from bayescal.calibrated.recheck.statistics import Knowledge, LegTest, build_test, look_again, predict_knowledge
from bayescal.errors import InputError
from bayescal.machines.kinematics import solve_forward_kinematics, solve_inverse_kinematics
from bayescal.numerics.geometry import DEGREES_OF_FREEDOM, Array, matrix_from_rotation_vector

LEVELS = (-1.0, 0.0, 1.0)
RANDOM = 729
"""Candidates of machines with redundant legs."""
EXCHANGES = 3
HOPEFUL = 0.03  # below the power asked for, from which on a plan is simulated


@dataclass(frozen=True)
class Demand:
    """What a recheck has to do.

    Attributes
    ----------
    shift : float
        Of a leg's length, mm.
    power : float
        With which it has to be found, whichever leg it is.
    false_alarm : float
        Of all sessions together.
    sessions : int
        Within which it has to be found; each measures the same poses.
    most : int
        Poses that a session may have.
    """

    shift: float
    power: float = 0.95
    false_alarm: float = 0.01
    sessions: int = 2
    most: int = 40


@dataclass(frozen=True, eq=False)
class RecheckPlan:
    """Poses of one session of a recheck.

    Attributes
    ----------
    chosen : ndarray of int, shape (P,)
        Which of the candidates, the most telling first.
    actuators : ndarray, shape (P, N)
        mm.
    test : LegTest
        Of all sessions.
    power : ndarray, shape (N,)
        With which the shift of each leg is found.
    demand : Demand
    """

    chosen: np.ndarray
    actuators: Array
    test: LegTest
    power: Array
    demand: Demand

    @cached_property
    def power_by_session(self) -> Array:
        """With which probability the shift of the leg that is found worst is found by each session, shape (J,)."""
        looks = [replace(self.test, information=self.test.information[: k + 1]) for k in range(self.demand.sessions)]
        return np.array([one.find_power(self.demand.shift).min() for one in looks])


def list_candidates(calibrated: CalibratedMachine, share: float) -> Array:
    """Return actuator positions (C, N), mm, over a share of the range: corners, middles of edges and faces, home.

    Those of redundant legs, which cannot be combined at will, hold random poses about home.
    """
    mechanism = calibrated.legs.mechanism
    reach = share * mechanism.actuator_range
    if mechanism.n_legs == DEGREES_OF_FREEDOM:
        moves = reach * np.array(list(product(LEVELS, repeat=mechanism.n_legs)))
        return _keep_reached(calibrated, mechanism.initial_actuator_positions + moves)
    return _place_near_home(calibrated, reach)


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


def plan_recheck(calibrated: CalibratedMachine, candidates: Array, covariance: Array, demand: Demand) -> RecheckPlan:
    """Return the fewest poses out of candidates (C, N), mm, that meet a demand; covariance (6, 6) of a measured pose.

    Raises
    ------
    InputError
        Where no number of poses up to ``demand.most`` does.
    """
    knowledge = predict_knowledge(calibrated, candidates, covariance)
    chosen: list[int] = []
    while len(chosen) < min(demand.most, len(candidates)):
        chosen.append(_find_best(knowledge, chosen, demand.sessions))
        if _seems_enough(knowledge, chosen, demand):
            plan = _state(knowledge, _exchange(knowledge, chosen, demand.sessions), candidates, demand)
            if plan.power.min() >= demand.power:
                return _shorten(knowledge, plan, candidates, demand)
    power = 100.0 * _state(knowledge, chosen, candidates, demand).power.min()
    raise InputError(
        f"recheck: found that {len(chosen)} poses tell a shift of {1e3 * demand.shift:g} µm with {power:.1f} % in "
        f"{demand.sessions} sessions, expected {100.0 * demand.power:g} %: a larger shift, more sessions or less noise"
    )


def _shorten(knowledge: Knowledge, plan: RecheckPlan, candidates: Array, demand: Demand) -> RecheckPlan:
    """Return a plan of fewer poses where some exchange finds one."""
    while len(plan.chosen) > 1:
        fewer = _exchange(knowledge, list(plan.chosen[:-1]), demand.sessions)
        shorter = _state(knowledge, fewer, candidates, demand)
        if shorter.power.min() < demand.power:
            break
        plan = shorter
    return plan


def _find_best(knowledge: Knowledge, chosen: list[int], sessions: int) -> int:
    """Return the candidate beside which, with those that are chosen, the leg that is told worst is told best."""
    information = knowledge.add_each(knowledge.gram[chosen].sum(axis=0), sessions)
    rate = information.min(axis=1) + 1e-3 * information.mean(axis=1)  # ties to those that tell more
    rate[chosen] = -np.inf
    return int(np.argmax(rate))


def _exchange(knowledge: Knowledge, chosen: list[int], sessions: int) -> list[int]:
    """Return poses, each exchanged for the best candidate beside the others, until none is better."""
    chosen = list(chosen)
    for _ in range(EXCHANGES):
        before = list(chosen)
        for k in range(len(chosen)):
            others = chosen[:k] + chosen[k + 1 :]
            chosen[k] = _find_best(knowledge, others, sessions)
        if chosen == before:
            break
    return chosen


def _seems_enough(knowledge: Knowledge, chosen: list[int], demand: Demand) -> bool:
    """Return whether the worst leg's own statistic might pass the lowest threshold that there can be."""
    _, information = knowledge.score(demand.sessions * knowledge.gram[chosen].sum(axis=0))
    passed = norm.sf(norm.isf(demand.false_alarm / 2.0) - demand.shift * np.sqrt(np.diag(information).min()))
    return bool(passed > demand.power - HOPEFUL)


def _state(knowledge: Knowledge, chosen: list[int], candidates: Array, demand: Demand) -> RecheckPlan:
    gram = knowledge.gram[chosen].sum(axis=0)
    test = build_test(look_again(knowledge, [gram], demand.sessions), demand.false_alarm)
    power = test.find_power(demand.shift)
    return RecheckPlan(np.array(chosen), candidates[chosen], test, power, demand)
