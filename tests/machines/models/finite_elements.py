"""Beam elements written out from RR-8096's eqs. (20) to (27), 12 x 12, to hold the closed forms of chains against.

Static equilibrium by finite elements, written out from RR-8096's eqs. (22) to (29), to hold the models against.

Everything is computed from the 12 x 12 matrices, whose own tests hold them to the closed forms of
beams; the models use four numbers per chain instead.
"""

from collections.abc import Sequence

import numpy as np
import telescope_machines as machines

from bayescal.machines.kinematics import check_home_pose
from bayescal.machines.mechanism import BeamSection
from bayescal.numerics.geometry import Array, rotation_vector_from_matrix, skew_matrix


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


def node_stiffness(mechanism, leg):
    """Return K of one leg between its nodes a' and b' (eqs. 24 to 27), shape (12, 12), x along the leg."""
    flexures, l_b = mechanism.flexures, mechanism.flexures.lengths[leg]
    flexure = compute_beam_stiffness(flexures.section, l_b)
    return condense_chain(
        [flexure, compute_beam_stiffness(flexures.leg_section, mechanism.leg_lengths[leg] - l_b), flexure]
    )


def turn_to(stiffness, axis):
    """Return a stiffness (12, 12) whose x axis points along a unit vector (eq. 28)."""
    other = np.cross(axis, np.eye(3)[np.argmin(np.abs(axis))])
    other /= np.linalg.norm(other)
    frame = np.kron(np.eye(4), np.stack([axis, other, np.cross(axis, other)], axis=1))
    return frame @ stiffness @ frame.T


class FiniteElementMachine:
    """The nominal mechanism as six chains of beams; loads from displacements of nodes, one pose at a time."""

    def __init__(self, machine):
        self.machine, self.mechanism = machine, machine.mechanism
        self.home = check_home_pose(machines.build_machine("none", self.mechanism))
        start = self.home.position + self.mechanism.platform_points @ self.home.rotation.T - self.mechanism.home_joints
        self.start_axes = start / np.linalg.norm(start, axis=1, keepdims=True)

    def loads(self, position, rotation, rho):
        """Return points, F and M, shapes (2, 6, 3): what base and platform have to pull with at the joints' centres."""
        mechanism = self.mechanism
        deflection = self.machine.basis(rho).deflection(self.machine.layout, self.machine.layout.nominal)
        joints = mechanism.platform_points + deflection[:, None] * np.array([0.0, 0.0, 1.0])
        lower = mechanism.base_points + rho[:, None] * mechanism.directions
        upper = position + joints @ rotation.T
        phi = rotation_vector_from_matrix(rotation @ self.home.rotation.T)
        results = []
        for leg in range(6):
            axis, ends = self.displace(leg, upper[leg] - lower[leg], lower[leg], upper[leg], phi)
            half = 0.5 * mechanism.flexures.lengths[leg] * axis  # a' lies half a flexure before the centre, b' behind
            nodes = ends.copy()
            nodes[:3] += np.cross(ends[3:6], -half)
            nodes[6:9] += np.cross(ends[9:], half)
            load = turn_to(node_stiffness(mechanism, leg), axis) @ nodes
            force, moment = load.reshape(2, 2, 3).transpose(1, 0, 2)
            results.append((force, moment + np.cross([-half, half], force)))
        force, moment = (np.stack(part, axis=1) for part in zip(*results, strict=True))
        return np.stack([lower, upper]), force, moment

    def displace(self, leg, vector, lower, upper, phi):
        """Return the leg's axis and the displacements (12,) of both centres."""
        axis, length = vector / np.linalg.norm(vector), np.linalg.norm(vector)
        start = self.start_axes[leg]
        if self.machine.model.name == "stiffness_fixed":
            home = self.home.position + self.home.rotation @ self.mechanism.platform_points[leg]
            moved = lower - self.mechanism.home_joints[leg]
            return start, np.concatenate([moved, np.zeros(3), upper - home, phi])
        turn = np.cross(start, axis)
        stretch = (length - self.mechanism.leg_lengths[leg]) * axis
        return axis, np.concatenate([np.zeros(3), -turn, stretch, phi - turn])  # relative to the leg as it stands

    def stiffness(self):
        """Return the platform's stiffness matrix at home about its origin, shape (6, 6), N and N mm, mm and rad."""
        total = np.zeros((6, 6))
        for leg in range(6):
            arm = self.home.rotation @ self.mechanism.platform_points[leg]
            arm = arm + 0.5 * self.mechanism.flexures.lengths[leg] * self.start_axes[leg]
            transport = np.eye(6)
            transport[:3, 3:] = -skew_matrix(arm)
            held = turn_to(node_stiffness(self.mechanism, leg), self.start_axes[leg])[6:, 6:]
            total += transport.T @ held @ transport
        return total


def external_wrench(load, rotation):
    """Return force and moment about the platform's origin, N and N mm."""
    weight = np.array(load.weight)
    moment = np.array(load.moment) + np.cross(rotation @ np.array(load.centre_of_mass), weight)
    return np.array(load.force) + weight, moment
