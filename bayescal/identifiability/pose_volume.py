"""Poses about the home pose of a machine on legs that stand for its workspace, and moves from home in words."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import ndtri

from bayescal.errors import InputError
from bayescal.machines.kinematics import Machine, solve_forward_kinematics, solve_inverse_kinematics
from bayescal.numerics.geometry import Array, matrix_from_rotation_vector

AXES = ("x", "y", "z", "rotation x", "rotation y", "rotation z")
SLACK = 1e-9  # of the actuators' range


@dataclass(frozen=True, eq=False)
class PoseVolume:
    """Poses about the home pose."""

    half: Array  # (6,): half widths, mm and rad
    shape: str  # ``ellipsoid``, ``box`` or ``axes``
    n_poses: int  # that stand for it

    def sample(self, n: int, seed: int) -> Array:
        """Return pose displacements, shape (n', 6), mm and rad, the ends of the axes among them; n' is about n."""
        used = np.flatnonzero(self.half > 0)
        ends = np.concatenate([np.eye(6)[used], -np.eye(6)[used], np.zeros((1, 6))])
        inside = np.zeros((max(0, n - len(ends)), 6))
        if len(inside) and len(used):
            inside[:, used] = self._fill(len(inside), len(used), seed)
        return np.concatenate([ends, inside]) * self.half

    def _fill(self, n: int, k: int, seed: int) -> Array:
        """Return points that fill the unit box, ball or cross of k axes evenly, shape (n, k)."""
        from scipy.stats import qmc  # half a second to import

        unit = qmc.Halton(k + 1, rng=np.random.default_rng(seed)).random(n)
        cube = 2.0 * unit - 1.0
        if self.shape == "box":
            return np.asarray(cube[:, :k])
        if self.shape == "axes":
            which = (unit[:, k] * k).astype(int)
            return np.asarray(np.where(np.arange(k) == which[:, None], cube[:, :k], 0.0))
        normal, radius = ndtri(unit[:, :k]), unit[:, k] ** (1.0 / k)
        return np.asarray(normal / np.linalg.norm(normal, axis=1, keepdims=True) * radius[:, None])


def find_workspace_actuators(machine: Machine, theta: Array, workspace: PoseVolume, n: int, seed: int) -> Array:
    """Return the actuator positions of n poses of the workspace of a machine (D,), shape (n', N), mm.

    InputError names the first pose that the actuators cannot reach, the actuator and its displacement.
    """
    mechanism = machine.mechanism
    start = mechanism.initial_actuator_positions
    home = solve_forward_kinematics(machine, theta, start[None])
    moves = workspace.sample(n, seed)
    position = home.position[0] + moves[:, :3]
    rotation = matrix_from_rotation_vector(moves[:, 3:]) @ home.rotation[0]
    found = solve_inverse_kinematics(machine, theta, position, rotation, check=False)
    displacement = found.actuators - start
    far = np.where(found.converged[:, None], np.abs(displacement), np.inf)
    limit = mechanism.actuator_range * (1.0 + SLACK)
    if np.any(far > limit):
        pose, leg = np.unravel_index(int(np.argmax(far)), far.shape)
        needed = f"{far[pose, leg]:.3g} mm" if np.isfinite(far[pose, leg]) else "more than it can"
        raise InputError(
            f"workspace: out of reach at {describe_move(moves[pose], 3)}: leg {leg + 1} needs "
            f"{needed}, expected at most {mechanism.actuator_range:g} mm"
        )
    return found.actuators


def describe_move(move: Array, digits: int = 4) -> str:
    """Return a displacement (6,) from home, mm and rad, in words."""
    degrees = np.concatenate([move[:3], np.degrees(move[3:])])
    parts = [
        f"{axis} {value:.{digits}g} {'mm' if k < 3 else 'deg'}"
        for k, (axis, value) in enumerate(zip(AXES, degrees, strict=True))
        if abs(value) > 1e-9
    ]
    return ", ".join(parts) or "home"
