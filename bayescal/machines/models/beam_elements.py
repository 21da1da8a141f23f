"""Beam elements and the chain flexure, leg, flexure: RR-8096 section 5.

`compute_beam_stiffness` and `condense_chain` are the report's 12 x 12 matrices (eqs. 20 to 27). A straight chain of
round beams loaded only at its ends is also described by four numbers, `ChainStiffness`, which models use for whole
batches of machines: what the condensed matrix says of the joints' centres, in closed form.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from bayescal.machines.mechanism import BeamSection
from bayescal.numerics.geometry import Array, skew_matrix

SYMBOLS = ("k1_d", "k2_d", "k3_d", "k1_l", "k2_l", "k3_l", "l", "l_b")
COMPLEX_STEP = 1e-30


def compute_beam_stiffness(section: BeamSection, length: float) -> Array:
    """Return K_loc of eq. (21), shape (12, 12): loads (N, N mm) of both end nodes from their displacements (mm, rad).

    The beam lies along its local x axis; each node has (F_x, F_y, F_z, M_x, M_y, M_z).
    """
    k1, k2, k3 = section.k1, section.k2, section.k3
    shear, couple, near, far = 12 * k1 / length**3, 6 * k1 / length**2, 4 * k1 / length, 2 * k1 / length
    first = np.diag([k2 / length, shear, shear, k3 / length, near, near])
    first[1, 5] = first[5, 1] = couple
    first[2, 4] = first[4, 2] = -couple
    second = np.diag(np.diagonal(first))
    second[1, 5] = second[5, 1] = -couple
    second[2, 4] = second[4, 2] = couple
    between = np.diag([-k2 / length, -shear, -shear, -k3 / length, far, far])
    between[1, 5], between[5, 1] = couple, -couple
    between[2, 4], between[4, 2] = -couple, couple
    return np.block([[first, between], [between.T, second]])


def condense_chain(elements: Sequence[Array]) -> Array:
    """Return the stiffness of a chain of beams between its two end nodes, shape (12, 12) (eqs. 24 to 27)."""
    n_nodes = len(elements) + 1
    full = np.zeros((6 * n_nodes, 6 * n_nodes))
    for k, element in enumerate(elements):
        full[6 * k : 6 * k + 12, 6 * k : 6 * k + 12] += element
    known = np.r_[0:6, 6 * n_nodes - 6 : 6 * n_nodes]
    inner = np.arange(6, 6 * n_nodes - 6)
    coupling = full[np.ix_(inner, known)]
    return full[np.ix_(known, known)] - coupling.T @ np.linalg.solve(full[np.ix_(inner, inner)], coupling)


def shift_nodes(stiffness: Array, first: Array, second: Array) -> Array:
    """Return a stiffness (12, 12) seen at points that lie (3,) mm off its nodes, rigidly tied to them."""
    transport = np.eye(12)
    transport[:3, 3:6] = skew_matrix(first)  # node = point - offset: u_node = u_point - φ x offset
    transport[6:9, 9:12] = skew_matrix(second)
    return transport.T @ stiffness @ transport


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


def differentiate_chain(values: Sequence[Array]) -> dict[str, ChainStiffness]:
    """Return the derivatives of the chain's stiffness by each of `SYMBOLS`, by complex steps: exact to rounding."""
    steps = [COMPLEX_STEP * np.abs(value) for value in values]
    moved = []
    for k, (value, step) in enumerate(zip(values, steps, strict=True)):
        several = np.repeat(value[None].astype(complex), len(SYMBOLS), axis=0)
        several[k] += 1j * step
        moved.append(several)
    chain = compute_chain_stiffness(*moved)
    return {
        symbol: ChainStiffness(*(np.imag(part[k]) / steps[k] for part in vars(chain).values()))
        for k, symbol in enumerate(SYMBOLS)
    }
