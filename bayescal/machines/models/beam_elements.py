"""The chain flexure, leg, flexure as beams: RR-8096 section 5.

A straight chain of round beams loaded only at its ends is described by four numbers, `ChainStiffness`, for whole
batches of machines: what the condensed 12 x 12 matrix (eqs. 20 to 27) says of the joints' centres, in closed form.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from bayescal.numerics.geometry import Array

SYMBOLS = ("k1_d", "k2_d", "k3_d", "k1_l", "k2_l", "k3_l", "l", "l_b")
COMPLEX_STEP = 1e-30


@dataclass(frozen=True, eq=False)
class ChainStiffness:
    """A chain of round beams between the centres of its two flexures, l apart.

    Attributes
    ----------
    axial, torsional : ndarray
        Force per elongation, N/mm; moment per twist, N mm.
    near, far : ndarray
        Bending: moment at a centre per rotation there and at the other one, relative to the chord, N mm.
    """

    axial: Array
    torsional: Array
    near: Array
    far: Array

    def times(self, factor: Array) -> ChainStiffness:
        """Return the chain with all stiffness multiplied."""
        return ChainStiffness(*(part * factor for part in vars(self).values()))


@dataclass(frozen=True)
class AxialReference:
    """A chain's axial compliance, by which that of others is measured.

    Attributes
    ----------
    flexures, leg : float
        Length of both flexures together and of the leg between them, mm.
    k2_d, k2_l : float
        Their axial stiffness, N.
    """

    flexures: float
    leg: float
    k2_d: float
    k2_l: float

    def scale(self, k2_d: Array, k2_l: Array) -> Array:
        """Return s, the reference's axial stiffness over that of a chain as long with other k2."""
        compliance = self.flexures / self.k2_d + self.leg / self.k2_l
        return (self.flexures / k2_d + self.leg / k2_l) / compliance

    def slopes(self, k2_d: Array, k2_l: Array) -> dict[str, Array]:
        """Return d log s by symbol."""
        compliance = self.flexures / k2_d + self.leg / k2_l
        return {"k2_d": -self.flexures / k2_d**2 / compliance, "k2_l": -self.leg / k2_l**2 / compliance}


def compute_chain_stiffness(
    k1_d: Array, k2_d: Array, k3_d: Array, k1_l: Array, k2_l: Array, k3_l: Array, length: Array, l_b: Array
) -> ChainStiffness:
    """Return the condensed chain: flexures of length l_b with centres ``length`` apart, a leg between.

    Axially and in torsion the beams' compliances add. In bending the rotations at the centres follow from the
    moment, which is linear along the chain, by integrals of its shape functions over both flexures and the leg.
    """
    half, rest = 0.5 * l_b, length - l_b
    share = half / length
    overhang = 2 / 3 * half * share * share
    near_leg = rest / 3 * (1.0 - share * (1.0 - share))
    direct = (l_b + 2 * overhang) / k1_d + near_leg / k1_l
    cross = 2 * overhang / k1_d - (0.5 * rest - near_leg) / k1_l
    determinant = (direct - cross) * (direct + cross)
    return ChainStiffness(
        axial=1.0 / (2 * l_b / k2_d + rest / k2_l),
        torsional=1.0 / (2 * l_b / k3_d + rest / k3_l),
        near=direct / determinant,
        far=-cross / determinant,
    )


def differentiate_chain(values: Sequence[Array]) -> Array:
    """Return the derivatives of axial, torsional, near and far stiffness by each of `SYMBOLS`, shape (8, 4, ...).

    By complex steps: exact to rounding.
    """
    known = np.stack(np.broadcast_arrays(*values))
    steps = COMPLEX_STEP * np.abs(known)
    moved = np.repeat(known[:, None].astype(complex), len(SYMBOLS), axis=1)  # what, by what
    np.einsum("kk...->k...", moved).imag += steps
    chain = compute_chain_stiffness(*moved)
    return np.asarray(np.imag(np.stack(list(vars(chain).values()), axis=1)) / steps[:, None])
