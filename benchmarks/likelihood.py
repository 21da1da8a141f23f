"""Time of the batched NumPy likelihood against a compiled loop of the same formula, one core.

    python benchmarks/likelihood.py [--repeats 200]

128 machines, 60 free parameters, 40 poses; without model error (one covariance for all) and with free model errors per
leg (a 6 x 6 Cholesky factor per machine and pose). Both sides get what depends only on the data ready-made. The two
results are compared before anything is timed.
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import dataclass

from telescope_problem import Problem, simulate, time_interleaved, write_results  # before NumPy: sets one thread

import numba
import numpy as np

from bayescal.geometry import Array
from bayescal.likelihood import REFINEMENTS

N_MACHINES = 128
AGREEMENT = 1e-9
POSTERIOR_SPREAD = 1e-3  # machines within a thousandth of a prior sd of the truth: the likelihood is alive there
TAU_SPREAD = 5e-3  # mm


@dataclass(frozen=True)
class LoopData:
    """What the compiled loop reads, all C-contiguous; shapes over poses P and legs N = 6."""

    position: Array  # (P, 3)
    rotation: Array  # (P, 3, 3)
    displacement: Array  # (P, N)
    constant: Array  # (P, N), the part of the deflection that no parameter moves
    gain: Array  # (P, 6, N)
    known: Array  # (P, N, N)
    weight: Array  # (P, N)
    log_constant: Array  # (P,)

    @classmethod
    def of(cls, problem: Problem) -> LoopData:
        """Return the loop's view of a problem; reads the likelihood's precomputed arrays."""
        likelihood, poses = problem.likelihood(), problem.poses
        basis = problem.machine.basis(poses.actuators)
        arrays = (poses.position, poses.rotation, basis.displacement, basis.constant, likelihood._gain)
        arrays += (likelihood._known, likelihood.actuator_weight, likelihood._constant)
        return cls(*(np.ascontiguousarray(array) for array in arrays))


def _leg_errors(theta, rho0, p, position, rotation, displacement, constant, gain, work, errors):
    """Fill ``errors`` (N,) with r = A⁰ e of one machine (N, 10: a, b, u_x, u_y, l, kappa; plus u_z) in pose p."""
    r00, r01, r02 = rotation[p, 0, 0], rotation[p, 0, 1], rotation[p, 0, 2]
    r10, r11, r12 = rotation[p, 1, 0], rotation[p, 1, 1], rotation[p, 1, 2]
    r20, r21, r22 = rotation[p, 2, 0], rotation[p, 2, 1], rotation[p, 2, 2]
    px, py, pz = position[p, 0], position[p, 1], position[p, 2]
    for i in range(6):
        move = displacement[p, i]
        travel = rho0[i] + move
        bx, by = theta[i, 3], theta[i, 4]
        bz = theta[i, 5] + constant[p, i] + theta[i, 9] * move
        mx = r00 * bx + r01 * by + r02 * bz
        my = r10 * bx + r11 * by + r12 * bz
        mz = r20 * bx + r21 * by + r22 * bz
        gx = px + mx - theta[i, 0] - travel * theta[i, 6]
        gy = py + my - theta[i, 1] - travel * theta[i, 7]
        gz = pz + mz - theta[i, 2] - travel * theta[i, 10]
        length = np.sqrt(gx * gx + gy * gy + gz * gz)
        inverse = -1.0 / length
        work[i, 0] = gx * inverse
        work[i, 1] = gy * inverse
        work[i, 2] = gz * inverse
        work[i, 3] = (my * gz - mz * gy) * inverse
        work[i, 4] = (mz * gx - mx * gz) * inverse
        work[i, 5] = (mx * gy - my * gx) * inverse
        work[i, 6] = theta[i, 8] - length
        errors[i] = work[i, 6]
    for _ in range(REFINEMENTS):
        e0 = e1 = e2 = e3 = e4 = e5 = 0.0
        for i in range(6):
            seen = errors[i]
            e0 += gain[p, i, 0] * seen  # gain comes transposed: (P, N, 6)
            e1 += gain[p, i, 1] * seen
            e2 += gain[p, i, 2] * seen
            e3 += gain[p, i, 3] * seen
            e4 += gain[p, i, 4] * seen
            e5 += gain[p, i, 5] * seen
        for i in range(6):
            along = work[i, 0] * e0 + work[i, 1] * e1 + work[i, 2] * e2
            along += work[i, 3] * e3 + work[i, 4] * e4 + work[i, 5] * e5
            errors[i] += work[i, 6] - along


def _fixed(leg_errors):
    def loop(theta, rho0, position, rotation, displacement, constant, gain, whitening, log_constant, result):
        work, errors = np.empty((6, 7)), np.empty(6)
        for b in range(theta.shape[0]):
            total = 0.0
            for p in range(position.shape[0]):
                leg_errors(theta[b], rho0, p, position, rotation, displacement, constant, gain, work, errors)
                square = 0.0
                for i in range(6):
                    white = 0.0
                    for j in range(i + 1):
                        white += whitening[p, i, j] * errors[j]
                    square += white * white
                total += log_constant[p] - 0.5 * square
            result[b] = total

    return loop


def _varying(leg_errors):
    def loop(theta, tau, rho0, position, rotation, displacement, constant, gain, known, weight, log_constant, result):
        work, errors, factor, white = np.empty((6, 7)), np.empty(6), np.empty((6, 6)), np.empty(6)
        for b in range(theta.shape[0]):
            total = 0.0
            for p in range(position.shape[0]):
                leg_errors(theta[b], rho0, p, position, rotation, displacement, constant, gain, work, errors)
                square, determinant = 0.0, 1.0
                for j in range(6):
                    pivot = known[p, j, j] + weight[p, j] * tau[b, j] * tau[b, j]
                    remainder = errors[j]
                    for k in range(j):
                        pivot -= factor[j, k] * factor[j, k]
                        remainder -= factor[j, k] * white[k]
                    inverse = 1.0 / np.sqrt(pivot)
                    white[j] = remainder * inverse
                    square += white[j] * white[j]
                    determinant *= inverse
                    for i in range(j + 1, 6):
                        column = known[p, i, j]
                        for k in range(j):
                            column -= factor[i, k] * factor[j, k]
                        factor[i, j] = column * inverse
                total += log_constant[p] + np.log(determinant) - 0.5 * square
            result[b] = total

    return loop


def compile_loops(fastmath: bool):
    """Return the two compiled loops: fixed covariance, varying covariance."""
    compiled = numba.njit(fastmath=fastmath, error_model="numpy", inline="never")
    leg_errors = compiled(_leg_errors)
    return compiled(_fixed(leg_errors)), compiled(_varying(leg_errors))


def _per_leg(problem: Problem, theta: Array) -> Array:
    """Return parameters by leg, shape (B, N, 11): a, b, u_x, u_y, l, kappa, u_z."""
    layout = problem.machine.layout
    symbols = ("a_x", "a_y", "a_z", "b_x", "b_y", "b_z", "u_x", "u_y", "l", "kappa")
    columns = [layout.take(theta, symbol) for symbol in symbols]
    columns.append(np.sqrt(1.0 - columns[6] ** 2 - columns[7] ** 2))
    return np.ascontiguousarray(np.stack(columns, axis=-1))
