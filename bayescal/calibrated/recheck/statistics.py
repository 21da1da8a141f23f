"""What poses tell of a shift of a leg since a calibration: a linear model, its scores, and the test of all legs.

At a pose measured later the closure of the calibrated machine leaves y = -F_θ Δθ - F_l δ + e: what the calibration did
not know, Δθ ~ N(0, P), the shifts δ of the legs' lengths, and errors e of legs, actuators and instrument, with
covariance C. With Δθ integrated, the score b of δ at zero has mean K δ and covariance K. Each leg by itself has the
statistic t_k = b_k / √K_kk, standard normal while the calibration holds; the test takes the largest of all |t_k|. Over
several sessions pooled from the first, scores are sums of independent steps, as those of any likelihood are.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from bayescal.calibrated.machine import CalibratedMachine
from bayescal.errors import InputError
from bayescal.machines.kinematics import solve_forward_kinematics
from bayescal.numerics.geometry import Array, rotation_vector_from_matrix

SIMULATED = 100_000
"""Tests simulated for a threshold: a false alarm of 1 % is met to 0.03 %."""
LENGTH = "l"


@dataclass(frozen=True, eq=False)
class Knowledge:
    """What poses tell.

    Attributes
    ----------
    rows : ndarray, shape (P, N, q + N + 1)
        C^(-1/2) X of the columns X: Δθ in units of its posterior, δ in mm, and y.
    n_legs : int
    """

    rows: Array
    n_legs: int

    @cached_property
    def gram(self) -> Array:
        """XᵀC⁻¹X of each pose, shape (P, q + N + 1, q + N + 1)."""
        return np.swapaxes(self.rows, 1, 2) @ self.rows

    def add_each(self, gram: Array, repeats: int) -> Array:
        """Return the diagonal of K, shape (P, N), of each pose beside a sum of the poses' matrices, both so often.

        The pose is a low-rank change of what there is: K grows by RᵀB⁻¹R, with R what of its columns by δ the others
        do not explain, and B the covariance of its rows given those.
        """
        q = gram.shape[-1] - self.n_legs - 1
        gram, rows = repeats * gram, np.sqrt(repeats) * self.rows
        inverse = np.linalg.inv(gram[:q, :q] + np.eye(q))
        known, moved = rows[..., :q], rows[..., q:-1]
        gain = known @ inverse
        rest = moved - gain @ gram[:q, q:-1]
        spread = gain @ np.swapaxes(known, 1, 2) + np.eye(rows.shape[1])
        own = np.diagonal(self.score(gram)[1])
        return np.asarray(own + np.sum(rest * np.linalg.solve(spread, rest), axis=1))

    def score(self, gram: Array) -> tuple[Array, Array]:
        """Return b (..., N) and K (..., N, N) of sums of the poses' matrices."""
        q = gram.shape[-1] - self.n_legs - 1
        precision = gram[..., :q, :q] + np.eye(q)
        solved = np.linalg.solve(precision, gram[..., :q, q:])
        reduced = gram[..., q:, q:] - np.swapaxes(gram[..., :q, q:], -1, -2) @ solved
        return reduced[..., :-1, -1], reduced[..., :-1, :-1]

    def left_over(self, gram: Array) -> float:
        """Return yᵀV⁻¹y of a sum of the poses' matrices, V the covariance of y with Δθ in it."""
        q = gram.shape[-1] - self.n_legs - 1
        return float(gram[-1, -1] - gram[:q, -1] @ np.linalg.solve(gram[:q, :q] + np.eye(q), gram[:q, -1]))


def predict_knowledge(calibrated: CalibratedMachine, actuators: Array, covariance: Array) -> Knowledge:
    """Return what poses at actuator positions (P, N) will tell, measured with a covariance (6, 6), mm and rad.

    Raises
    ------
    InputError
        Where the machine has no pose at one of them.
    """
    found = solve_forward_kinematics(calibrated.legs, calibrated.theta, actuators, check=False)
    if not found.converged.all():
        raise InputError(f"pose {int(np.argmin(found.converged)) + 1}: found no pose of the machine, expected one")
    noise = np.broadcast_to(covariance, (len(actuators), 6, 6))
    return compute_knowledge(calibrated, found.position, found.rotation, actuators, noise)


def compute_knowledge(
    calibrated: CalibratedMachine, position: Array, rotation: Array, actuators: Array, covariance: Array
) -> Knowledge:
    """Return what measured poses (P, 3), (P, 3, 3) at actuator positions (P, N) tell; covariance (P, 6, 6), mm and rad.

    Raises
    ------
    InputError
        Where the calibrated machine has no covariance, or its legs have no length.
    """
    machine = calibrated.legs
    if calibrated.covariance is None:
        raise InputError("found no draws of the posterior, expected them: a recheck needs to know what is known")
    if LENGTH not in machine.layout.index:
        raise InputError("found legs without a length l, expected some: a recheck looks for shifts of lengths")
    here = machine.linearise(calibrated.theta, position, rotation, actuators)
    pose = np.concatenate([position, rotation_vector_from_matrix(rotation)], axis=1)
    errors = here.actuators @ calibrated.errors.covariance(pose, actuators) @ np.swapaxes(here.actuators, 1, 2)
    shift = -np.einsum("pij,pj->pi", here.actuators, calibrated.errors.mean(pose, actuators))
    spread = here.pose @ covariance @ np.swapaxes(here.pose, 1, 2) + errors
    root = _find_root(calibrated.covariance)
    columns = np.concatenate(
        [
            -here.parameters[..., calibrated.free] @ root,
            -here.parameters[..., machine.layout.index[LENGTH]],
            (here.residual - shift)[..., None],
        ],
        axis=-1,
    )
    white = np.linalg.inv(np.linalg.cholesky(spread)) @ columns
    return Knowledge(white, len(machine.layout.index[LENGTH]))


def _find_root(covariance: Array) -> Array:
    """Return a matrix whose product with its transpose is a covariance; directions that are known exactly are none."""
    values, vectors = np.linalg.eigh(covariance)
    there = values > 1e-14 * values.max(initial=0.0)
    return np.asarray(vectors[:, there] * np.sqrt(values[there]))


# --- the test ----------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class LegTest:
    """The test of the largest statistic of all legs at any of several looks.

    Attributes
    ----------
    threshold : float
        Of |t|.
    false_alarm : float
        With which the threshold is passed at any look while the calibration holds.
    information : ndarray, shape (J, N, N)
        K at each look.
    """

    threshold: float
    false_alarm: float
    information: Array

    def find_power(self, shift: float, n_simulated: int = SIMULATED // 2) -> Array:
        """Return with which probability a shift (mm) of each leg is found at any look, shape (N,)."""
        noise = _simulate(self.information, n_simulated)
        scale = np.sqrt(np.diagonal(self.information, axis1=1, axis2=2))[:, None]
        found = []
        for leg in range(self.information.shape[1]):
            moved = noise + shift * self.information[:, None, :, leg] / scale
            found.append(np.mean(np.abs(moved).max(axis=(0, 2)) > self.threshold))
        return np.array(found)


def build_test(information: Array, false_alarm: float) -> LegTest:
    """Return the test of information K (J, N, N) at J looks that gives false alarms so often, all looks together."""
    largest = np.abs(_simulate(information, SIMULATED)).max(axis=(0, 2))
    return LegTest(float(np.quantile(largest, 1.0 - false_alarm)), false_alarm, information)


def _simulate(information: Array, n: int) -> Array:
    """Return statistics t of a calibration that holds, shape (J, n, N); the same ones at every call."""
    rng = np.random.default_rng(0)
    score = np.zeros((n, information.shape[-1]))
    looks = []
    for now, before in zip(information, [np.zeros_like(information[0]), *information[:-1]], strict=True):
        values, vectors = np.linalg.eigh(now - before)
        root = vectors * np.sqrt(np.maximum(values, 0.0))
        score = score + rng.standard_normal(score.shape) @ root.T
        looks.append(score / np.sqrt(np.diag(now)))
    return np.stack(looks)


def look_again(knowledge: Knowledge, grams: Sequence[Array], n_looks: int) -> Array:
    """Return K at each of n looks, shape (J, N, N): sums of the sessions' matrices, the last session repeated."""
    there = [*grams, *[grams[-1]] * (n_looks - len(grams))]
    return knowledge.score(np.cumsum(there, axis=0))[1]
