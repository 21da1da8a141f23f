"""Structural identifiability: the rank of the identification Jacobian, decided by its spectrum against rounding.

A gauge freedom or a parameter that stands for another makes singular values that would be zero but for rounding. How
large rounding is here is measured, not assumed: the Jacobian is computed again at machines that differ in the last
digits, and by Weyl's inequality no singular value moves further than the norm of the difference. Values of that size
are zero as far as anyone can tell; the rank is counted at the largest gap of the spectrum beside them.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from bayescal.errors import InputError
from bayescal.identifiability.design import Knowledge, Plan
from bayescal.identifiability.sensitivity import compute_sensitivity
from bayescal.machines.kinematics import solve_forward_kinematics
from bayescal.numerics.geometry import Array

EPSILON = float(np.finfo(np.float64).eps)
TWINS = 3
TWIN_SHIFT = 4.0  # units in the last place
REACH = 100.0  # how far above the rounding seen a value may lie and still be rounding
CLEAR_GAP = 10.0  # a smaller ratio of neighbouring singular values leaves the rank open
WIDE = 0.1  # displacements of the wide workspace as a share of the legs' lengths
NARROW = 0.01  # of the shortest leg, that a workspace on long guides may be narrowed to
NARROWER = 0.5
MIN_WIDE_POSES = 40
OFF = 0.1  # tolerances, of the other machine
SAME_PLACE = 1e-8  # of the displacements


@dataclass(frozen=True, eq=False)
class Structure:
    """The spectrum of a noise-free identification Jacobian and what it says.

    Attributes
    ----------
    singular_values : ndarray, shape (n,)
        Largest first, columns scaled by the tolerances.
    rounding : float
        How far rounding moves them.
    rank : int
    gap : float
        Ratio of the last singular value that counts to the first that does not, or to the rounding if that is larger.
    null_space : ndarray, shape (n, n - rank)
        Orthonormal, in units of the tolerances.
    displacement : float
        Half width of the wide workspace, mm of actuator displacement.
    rank_elsewhere : int or None
        Of a machine a little off the expected one; a larger one says that the expected geometry is a special case.
    """

    singular_values: Array
    rounding: float
    rank: int
    gap: float
    null_space: Array
    displacement: float = 0.0
    rank_elsewhere: int | None = None

    @property
    def is_clear(self) -> bool:
        """Whether the gap decides."""
        return self.gap >= CLEAR_GAP


def find_structure(jacobian: Array, twins: list[Array], displacement: float = 0.0) -> Structure:
    """Return the rank of a Jacobian (m, n) with columns in units of the tolerances.

    Parameters
    ----------
    jacobian : ndarray, shape (m, n)
    twins : list of ndarray
        The same Jacobian computed from inputs that differ in the last digits.
    displacement : float
        Kept with the result.
    """
    m, n = jacobian.shape
    padded = np.concatenate([jacobian, np.zeros((max(0, n - m), n))])
    _, values, vectors = np.linalg.svd(padded, full_matrices=False)
    own = EPSILON * np.sqrt(max(m, n)) * values[0]
    rounding = max([own, *(float(np.linalg.norm(jacobian - twin, 2)) for twin in twins)])
    ends = np.append(values, own)  # beyond the last value lies nothing but rounding
    cuts = [k for k in range(1, n + 1) if ends[k] <= REACH * rounding]
    ratios = [ends[k - 1] / max(ends[k], rounding) for k in cuts]
    best = int(np.argmax(ratios))
    rank, gap = cuts[best], float(ratios[best])
    return Structure(values, rounding, rank, gap, vectors[rank:].T, displacement)


def find_structural_rank(knowledge: Knowledge, plan: Plan, rng: np.random.Generator) -> Structure:
    """Return the structure over a workspace far wider than the plan's, with the plan's sensors.

    Raises
    ------
    InputError
        Where the machine can take no wide poses at all.
    """
    found = _find_rank_at(knowledge, plan, knowledge.centre, rng)
    n_machine = knowledge.machine.layout.size
    other = knowledge.centre.copy()
    moved = knowledge.free[knowledge.free < n_machine]  # the frames stay
    other[moved] += OFF * knowledge.sd[knowledge.free < n_machine] * rng.standard_normal(len(moved))
    if not knowledge.machine.layout.inside(other[:n_machine]):
        return found
    try:
        return replace(found, rank_elsewhere=_find_rank_at(knowledge, plan, other, rng).rank)
    except InputError:
        return found


def _find_rank_at(knowledge: Knowledge, plan: Plan, theta: Array, rng: np.random.Generator) -> Structure:
    shifts = TWIN_SHIFT * EPSILON * rng.uniform(-1.0, 1.0, (TWINS, theta.size))
    twins = theta * (1.0 + np.concatenate([np.zeros((1, theta.size)), shifts]))
    actuators, displacement = _draw_wide(knowledge, twins, rng)
    rows = [compute_sensitivity(knowledge, actuators, twin).rows(plan) * knowledge.sd for twin in twins]
    first, *others = (one.reshape(-1, one.shape[-1]) for one in rows)
    return find_structure(first, others, displacement)


def _draw_wide(knowledge: Knowledge, twins: Array, rng: np.random.Generator) -> tuple[Array, float]:
    """Return actuator positions of a wide workspace that all twins can take, and its half width."""
    machine = knowledge.machine
    mechanism = machine.mechanism
    wanted = max(MIN_WIDE_POSES, 2 * len(knowledge.names) // 6)
    start = mechanism.initial_actuator_positions
    half = WIDE * float(mechanism.leg_lengths.min())
    theta = twins[:, None, : machine.layout.size]
    least = min(0.1 * mechanism.actuator_range, NARROW * float(mechanism.leg_lengths.min()))
    while half > least:
        actuators = start + half * rng.uniform(-1.0, 1.0, (2 * wanted, mechanism.n_legs))
        found = solve_forward_kinematics(machine, theta, actuators, check=False)
        apart = np.abs(found.position - found.position[:1]).max(axis=(0, -1))  # twins that went to different places
        good = found.converged.all(axis=0) & (apart < SAME_PLACE * half)
        if good.sum() >= wanted:
            return actuators[good][:wanted], half
        half *= NARROWER
    raise InputError(f"mechanism {mechanism.name!r}: found no poses away from home, expected a machine that moves")
