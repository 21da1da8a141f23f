"""The likelihood as compiled loops, the opponents of the NumPy one; shapes over machines B, poses P and six legs.

Two ways to write it. The plain loop goes machine by machine and pose by pose with scalar locals. The blocked loop runs
every statement over a block of machines that lie side by side in memory, which the compiler turns into vector
instructions. Neither allocates inside. Parameters come as θ itself, shape (B, 66): a, b, u_x, u_y, l, ρ^0, κ, each
for six legs.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numba
import numpy as np

from bayescal.density.pose_likelihood import REFINEMENTS
from bayescal.numerics.geometry import Array

LANES = 32


@dataclass(frozen=True)
class LoopData:
    """What depends only on the data, ready-made for the loops, all C-contiguous."""

    position: Array  # (P, 3)
    rotation: Array  # (P, 3, 3)
    displacement: Array  # (P, 6)
    constant: Array  # (P, 6), the part of the deflection that no parameter moves
    gain: Array  # (P, 6, 6)
    known: Array  # (P, 6, 6), covariance without model error
    weight: Array  # (P, 6)
    log_constant: Array  # (P,)


def _gather(theta, row):
    """Copy one machine's parameters θ (66,) to row (6, 11): by leg b, κ, l, joint c = a + ρ^0 u, u."""
    for i in range(6):
        ux, uy, rho0 = theta[36 + i], theta[42 + i], theta[54 + i]
        uz = np.sqrt(1.0 - ux * ux - uy * uy)
        row[i, 0], row[i, 1], row[i, 2] = theta[18 + i], theta[24 + i], theta[30 + i]
        row[i, 3], row[i, 4] = theta[60 + i], theta[48 + i]
        row[i, 5], row[i, 6], row[i, 7] = theta[i] + rho0 * ux, theta[6 + i] + rho0 * uy, theta[12 + i] + rho0 * uz
        row[i, 8], row[i, 9], row[i, 10] = ux, uy, uz


def _close(rotation, position, move, constant, bx, by, bz, kappa, length, cx, cy, cz, ux, uy, uz):
    """Return f of one leg in one pose and its six pose derivatives."""
    bz += constant + kappa * move
    mx = rotation[0, 0] * bx + rotation[0, 1] * by + rotation[0, 2] * bz
    my = rotation[1, 0] * bx + rotation[1, 1] * by + rotation[1, 2] * bz
    mz = rotation[2, 0] * bx + rotation[2, 1] * by + rotation[2, 2] * bz
    gx = position[0] + mx - cx - move * ux
    gy = position[1] + my - cy - move * uy
    gz = position[2] + mz - cz - move * uz
    found = np.sqrt(gx * gx + gy * gy + gz * gz)
    inverse = -1.0 / found
    moment = (my * gz - mz * gy) * inverse, (mz * gx - mx * gz) * inverse, (mx * gy - my * gx) * inverse
    return length - found, gx * inverse, gy * inverse, gz * inverse, moment[0], moment[1], moment[2]


def _plain(fastmath: bool) -> tuple[Callable, Callable]:
    """Return the plain loops: one covariance for all machines, one per machine."""
    compiled = numba.njit(fastmath=fastmath, error_model="numpy")
    gather, close = compiled(_gather), compiled(_close)

    @compiled
    def leg_errors(th, p, position, rotation, displacement, constant, gain, slope, closure, seen):
        for i in range(6):
            f, s0, s1, s2, s3, s4, s5 = close(
                rotation[p], position[p], displacement[p, i], constant[p, i], th[i, 0], th[i, 1], th[i, 2], th[i, 3],
                th[i, 4], th[i, 5], th[i, 6], th[i, 7], th[i, 8], th[i, 9], th[i, 10],
            )  # fmt: skip
            closure[i], seen[i] = f, f
            slope[i, 0], slope[i, 1], slope[i, 2], slope[i, 3], slope[i, 4], slope[i, 5] = s0, s1, s2, s3, s4, s5
        for _ in range(REFINEMENTS):
            s0, s1, s2, s3, s4, s5 = seen[0], seen[1], seen[2], seen[3], seen[4], seen[5]
            g = gain[p]
            e0 = g[0, 0] * s0 + g[0, 1] * s1 + g[0, 2] * s2 + g[0, 3] * s3 + g[0, 4] * s4 + g[0, 5] * s5
            e1 = g[1, 0] * s0 + g[1, 1] * s1 + g[1, 2] * s2 + g[1, 3] * s3 + g[1, 4] * s4 + g[1, 5] * s5
            e2 = g[2, 0] * s0 + g[2, 1] * s1 + g[2, 2] * s2 + g[2, 3] * s3 + g[2, 4] * s4 + g[2, 5] * s5
            e3 = g[3, 0] * s0 + g[3, 1] * s1 + g[3, 2] * s2 + g[3, 3] * s3 + g[3, 4] * s4 + g[3, 5] * s5
            e4 = g[4, 0] * s0 + g[4, 1] * s1 + g[4, 2] * s2 + g[4, 3] * s3 + g[4, 4] * s4 + g[4, 5] * s5
            e5 = g[5, 0] * s0 + g[5, 1] * s1 + g[5, 2] * s2 + g[5, 3] * s3 + g[5, 4] * s4 + g[5, 5] * s5
            for i in range(6):
                along = slope[i, 0] * e0 + slope[i, 1] * e1 + slope[i, 2] * e2
                along += slope[i, 3] * e3 + slope[i, 4] * e4 + slope[i, 5] * e5
                seen[i] += closure[i] - along

    @compiled
    def fixed(theta, position, rotation, displacement, constant, gain, whitening, log_constant, result):
        th, slope, closure, seen = np.empty((6, 11)), np.empty((6, 6)), np.empty(6), np.empty(6)
        for b in range(len(theta)):
            gather(theta[b], th)
            total = 0.0
            for p in range(len(position)):
                leg_errors(th, p, position, rotation, displacement, constant, gain, slope, closure, seen)
                square = 0.0
                for i in range(6):
                    white = 0.0
                    for j in range(i + 1):
                        white += whitening[p, i, j] * seen[j]
                    square += white * white
                total += log_constant[p] - 0.5 * square
            result[b] = total

    @compiled
    def varying(theta, tau, position, rotation, displacement, constant, gain, known, weight, log_constant, result):
        th, slope, closure, seen = np.empty((6, 11)), np.empty((6, 6)), np.empty(6), np.empty(6)
        factor = np.empty((7, 6))  # the last row is the whitened error
        for b in range(len(theta)):
            gather(theta[b], th)
            total = 0.0
            for p in range(len(position)):
                leg_errors(th, p, position, rotation, displacement, constant, gain, slope, closure, seen)
                square, determinant = 0.0, 1.0
                for j in range(6):
                    pivot = known[p, j, j] + weight[p, j] * tau[b, j] * tau[b, j]
                    for k in range(j):
                        pivot -= factor[j, k] * factor[j, k]
                    inverse = 1.0 / np.sqrt(pivot)
                    determinant *= inverse
                    for i in range(j + 1, 7):
                        column = known[p, i, j] if i < 6 else seen[j]
                        for k in range(j):
                            column -= factor[i, k] * factor[j, k]
                        factor[i, j] = column * inverse
                    square += factor[6, j] * factor[6, j]
                total += log_constant[p] + np.log(determinant) - 0.5 * square
            result[b] = total

    return fixed, varying


def _blocked(fastmath: bool) -> tuple[Callable, Callable]:
    """Return the blocked loops: one covariance for all machines, one per machine; B a multiple of ``LANES``."""
    compiled = numba.njit(fastmath=fastmath, error_model="numpy")
    gather, close = compiled(_gather), compiled(_close)

    @compiled
    def leg_errors(th, p, position, rotation, displacement, constant, gain, slope, closure, e, seen):
        for i in range(6):
            for v in range(LANES):
                f, s0, s1, s2, s3, s4, s5 = close(
                    rotation[p], position[p], displacement[p, i], constant[p, i], th[i, 0, v], th[i, 1, v],
                    th[i, 2, v], th[i, 3, v], th[i, 4, v], th[i, 5, v], th[i, 6, v], th[i, 7, v], th[i, 8, v],
                    th[i, 9, v], th[i, 10, v],
                )  # fmt: skip
                closure[i, v], seen[i, v] = f, f
                slope[i, 0, v], slope[i, 1, v], slope[i, 2, v] = s0, s1, s2
                slope[i, 3, v], slope[i, 4, v], slope[i, 5, v] = s3, s4, s5
        for _ in range(REFINEMENTS):
            for k in range(6):
                g0, g1, g2 = gain[p, k, 0], gain[p, k, 1], gain[p, k, 2]
                g3, g4, g5 = gain[p, k, 3], gain[p, k, 4], gain[p, k, 5]
                for v in range(LANES):
                    left = g0 * seen[0, v] + g1 * seen[1, v] + g2 * seen[2, v]
                    e[k, v] = left + g3 * seen[3, v] + g4 * seen[4, v] + g5 * seen[5, v]
            for i in range(6):
                for v in range(LANES):
                    along = slope[i, 0, v] * e[0, v] + slope[i, 1, v] * e[1, v] + slope[i, 2, v] * e[2, v]
                    along += slope[i, 3, v] * e[3, v] + slope[i, 4, v] * e[4, v] + slope[i, 5, v] * e[5, v]
                    seen[i, v] += closure[i, v] - along

    @compiled
    def fixed(theta, position, rotation, displacement, constant, gain, whitening, log_constant, result):
        th, slope, closure = np.empty((6, 11, LANES)), np.empty((6, 6, LANES)), np.empty((6, LANES))
        e, seen, white = np.empty((6, LANES)), np.empty((6, LANES)), np.empty(LANES)
        for start in range(0, len(theta), LANES):
            for v in range(LANES):
                gather(theta[start + v], th[:, :, v])
            result[start : start + LANES] = 0.0
            for p in range(len(position)):
                leg_errors(th, p, position, rotation, displacement, constant, gain, slope, closure, e, seen)
                for i in range(6):
                    white[:] = 0.0
                    for j in range(i + 1):
                        w = whitening[p, i, j]
                        for v in range(LANES):
                            white[v] += w * seen[j, v]
                    for v in range(LANES):
                        result[start + v] -= 0.5 * white[v] * white[v]
                for v in range(LANES):
                    result[start + v] += log_constant[p]

    @compiled
    def varying(theta, tau, position, rotation, displacement, constant, gain, known, weight, log_constant, result):
        th, slope, closure = np.empty((6, 11, LANES)), np.empty((6, 6, LANES)), np.empty((6, LANES))
        e, seen, factor, determinant = (
            np.empty((6, LANES)),
            np.empty((6, LANES)),
            np.empty((7, 6, LANES)),
            np.empty(LANES),
        )
        inverse, variance = np.empty(LANES), np.empty((6, LANES))
        for start in range(0, len(theta), LANES):
            for v in range(LANES):
                gather(theta[start + v], th[:, :, v])
            result[start : start + LANES] = 0.0
            for v in range(LANES):
                for i in range(6):
                    variance[i, v] = tau[start + v, i] ** 2
            for p in range(len(position)):
                leg_errors(th, p, position, rotation, displacement, constant, gain, slope, closure, e, seen)
                determinant[:] = 1.0
                for j in range(6):
                    for v in range(LANES):
                        inverse[v] = known[p, j, j] + weight[p, j] * variance[j, v]
                    for k in range(j):
                        for v in range(LANES):
                            inverse[v] -= factor[j, k, v] * factor[j, k, v]
                    for v in range(LANES):
                        inverse[v] = 1.0 / np.sqrt(inverse[v])
                        determinant[v] *= inverse[v]
                    for i in range(j + 1, 7):
                        for v in range(LANES):
                            factor[i, j, v] = known[p, i, j] if i < 6 else seen[j, v]
                        for k in range(j):
                            for v in range(LANES):
                                factor[i, j, v] -= factor[i, k, v] * factor[j, k, v]
                        for v in range(LANES):
                            factor[i, j, v] *= inverse[v]
                    for v in range(LANES):
                        result[start + v] -= 0.5 * factor[6, j, v] * factor[6, j, v]
                for v in range(LANES):
                    result[start + v] += log_constant[p] + np.log(determinant[v])

    return fixed, varying


STYLES = {"plain": _plain, "blocked": _blocked}
