"""Beam elements written out from RR-8096's eqs. (20) to (27), 12 x 12, to hold the closed forms of chains against."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from bayescal.machines.mechanism import BeamSection
from bayescal.numerics.geometry import Array, skew_matrix


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
