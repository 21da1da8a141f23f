"""Identification as the field does it: least squares of the model's own objective, no prior, no noise model.

This is RR-8096 section 7 with the objectives of its table 2, eqs. (30) to (33), and its identifiable parameters: the
reference to which posteriors are compared.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares

from bayescal.data.measured_poses import MeasuredPoses
from bayescal.machines.coordinates import line_slope, mirror_direction
from bayescal.machines.kinematics import Machine, compute_home_legs
from bayescal.machines.models import Linearisation, SixPus
from bayescal.machines.parameters import ParameterLayout
from bayescal.numerics.geometry import Array

START_TILT = 0.1  # how far a component of u starts at least from its leg's slope, at which its column vanishes
TOLERANCE = 1e-12
NULL = 1e-10  # singular value, as a share of the largest, below which a direction changes nothing
MAX_EVALUATIONS = 1000
BETTER = 1e-6  # share by which the objective has to fall for another solution to be taken
FAR = 1e6  # residual where there is no machine


@dataclass(frozen=True, eq=False)
class LeastSquaresFit:
    """Identified parameters."""

    theta: Array  # (D,): parameter vector with the free parameters identified
    residual_rms: Array  # (N,): closure residual of each leg, mm
    objective: float  # sum of the squared objective, in its own units (mm², or N² and N² m² together)
    n_identified: int  # number of free directions that the poses hold; the others stay nominal
    converged: bool


def list_identified(machine: Machine, symbols: Sequence[str]) -> list[str]:
    """Return those of the symbols that least squares identifies: all but what describes the flexures themselves.

    Poses hold neither (RR-8096 sections 7.1.3 and 7.1.4), and an objective in newtons is least for no stiffness at all.
    """
    flexure = {block.symbol for block in machine.model.blocks(machine.mechanism)}
    flexure -= {block.symbol for block in SixPus().blocks(machine.mechanism)}
    return [symbol for symbol in symbols if symbol not in flexure]


def identify(
    machine: Machine,
    poses: MeasuredPoses,
    symbols: tuple[str, ...],
    start: Array | None = None,
    objective: Array | None = None,
) -> LeastSquaresFit:
    """Minimise the sum of squared W f over all legs' parameters of the given symbols.

    With a component of u free each leg has two solutions of nearly the same actuator gain. Which one is nearer is
    decided leg by leg on the closure f itself, where a leg's residual is its own; an objective that mixes the legs then
    starts from there.

    Parameters
    ----------
    machine : Machine
    poses : MeasuredPoses
    symbols : tuple of str
        What is free.
    start : ndarray, shape (D,), optional
        Parameter vector to start from, nominal without it; u is moved off the direction of its leg.
    objective : ndarray, shape (N, N), optional
        W; without it the model's own (`KinematicModel.objective`).
    """
    layout = machine.layout
    weight = machine.model.objective(machine.mechanism) if objective is None else objective
    free = np.concatenate([layout.index[symbol] for symbol in list_identified(machine, symbols)])
    start = layout.nominal.copy() if start is None else start.copy()
    identity = np.eye(machine.mechanism.n_legs)
    component = next((k for k, symbol in enumerate(layout.direction_symbols) if symbol in symbols), None)
    if component is None:
        best = minimise(machine, poses, free, start, identity)
    else:
        best = _try_both_directions(machine, poses, free, start, component)
    return best if np.array_equal(weight, identity) else minimise(machine, poses, free, best.theta, weight)


def _try_both_directions(
    machine: Machine, poses: MeasuredPoses, free: np.ndarray, start: Array, component: int
) -> LeastSquaresFit:
    layout, identity, legs = machine.layout, np.eye(machine.mechanism.n_legs), compute_home_legs(machine)
    turned = layout.index[layout.direction_symbols[component]]
    slopes = np.array([line_slope(layout, k, component, leg) for k, leg in enumerate(legs)])
    start[turned] = _leave(start[turned], slopes)
    best, improved = minimise(machine, poses, free, start, identity), True
    while improved:
        improved = False
        for leg, line in enumerate(legs):
            mirrored = mirror_direction(layout, best.theta, leg, component, line, free)
            if mirrored is None:
                continue
            other = minimise(machine, poses, free, mirrored, identity)
            if other.objective < (1.0 - BETTER) * best.objective:
                best, improved = other, True
    return best


def _leave(direction: Array, slope: Array) -> Array:
    """Return components moved away from the legs' slopes to a distance of `START_TILT` where they are closer."""
    off = direction - slope
    return np.where(np.abs(off) < START_TILT, slope + np.where(off < 0, -START_TILT, START_TILT), direction)


def minimise(
    machine: Machine,
    poses: MeasuredPoses,
    free: np.ndarray,
    start: Array,
    weight: Array,
    tolerance: float = TOLERANCE,
) -> LeastSquaresFit:
    """Minimise |W f|² from one start along the directions that the poses' noise does not drown there.

    The report leaves such parameters out by hand (sections 6.3.1 and 7.1); here their combinations stay as they are.

    Parameters
    ----------
    machine : Machine
    poses : MeasuredPoses
    free : ndarray of int
        Positions of the free parameters in θ.
    start : ndarray, shape (D,)
    weight : ndarray, shape (N, N)
        W.
    tolerance : float
        Share by which parameters or objective change in the last step.
    """
    problem = _Problem(machine, poses, free, start, weight)
    with np.errstate(all="ignore"):  # a trial step may leave the machines; its residual says so
        result = least_squares(
            problem.residual,
            np.zeros(problem.directions.shape[1]),
            problem.jacobian,
            method="lm",
            x_scale="jac",
            xtol=tolerance,
            ftol=tolerance,
            max_nfev=MAX_EVALUATIONS,
        )
    rms = np.sqrt(np.mean(problem.linearise(result.x).residual ** 2, axis=0))
    return LeastSquaresFit(
        theta=problem.theta(result.x),
        residual_rms=rms,
        objective=float(2.0 * result.cost),
        n_identified=problem.directions.shape[1],
        converged=bool(result.success),
    )


class _Problem:
    """W f and its Jacobian as functions of steps q along the identified directions.

    Residual and Jacobian are asked for one after the other at the same point, so the last linearisation is kept.
    """

    def __init__(self, machine: Machine, poses: MeasuredPoses, free: np.ndarray, start: Array, weight: Array) -> None:
        self._machine, self._poses, self._basis = machine, poses, machine.basis(poses.actuators)
        self._free, self._start, self._weight = free, start, weight
        self._last: tuple[Array, Linearisation] | None = None
        self.directions = np.eye(len(free))
        here = self.linearise(np.zeros(len(free)))
        self.directions = _find_directions(here, free, poses, _spread(machine.layout)[free])

    def theta(self, q: Array) -> Array:
        """Return the parameter vector (D,)."""
        theta = self._start.copy()
        theta[self._free] += self.directions @ q
        return theta

    def linearise(self, q: Array) -> Linearisation:
        """Return the closure at all poses."""
        if self._last is None or not np.array_equal(self._last[0], q):
            layout, poses = self._machine.layout, self._poses
            here = self._machine.model.linearise(layout, self.theta(q), poses.position, poses.rotation, self._basis)
            self._last = (q.copy(), here)
        return self._last[1]

    def residual(self, q: Array) -> Array:
        """Return W f, shape (P N,)."""
        value = (self.linearise(q).residual @ self._weight.T).ravel()
        return np.where(np.isfinite(value), value, FAR * np.abs(self._weight).max())

    def jacobian(self, q: Array) -> Array:
        """Return its derivative by q, shape (P N, k)."""
        columns = self._weight @ self.linearise(q).parameters[..., self._free]
        return columns.reshape(-1, len(self._free)) @ self.directions


def _find_directions(here: Linearisation, free: np.ndarray, poses: MeasuredPoses, scale: Array) -> Array:
    """Return the directions (n, k) a unit of which, 1 mm or 0.01, moves the residuals by more than their noise."""
    noise = np.einsum("pik,pkm,pim->pi", here.pose, poses.covariance, here.pose)
    jacobian = here.parameters[..., free].reshape(-1, len(free)) * scale
    _, singular, rows = np.linalg.svd(jacobian, full_matrices=False)
    kept = singular > max(float(np.sqrt(noise.mean())), NULL * float(singular[0]))
    return (rows[kept] * scale).T


def _spread(layout: ParameterLayout) -> Array:
    """Return changes (D,) that count alike."""
    return np.where(np.array(layout.units) == "mm", 1.0, 0.01)
