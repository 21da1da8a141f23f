"""The benchmark posterior written in JAX, as one would for a gradient-based sampler: same data, same priors.

Standardised parameters z = (θ - mean) / sd have standard normal priors. With e what actuators err at a measured pose,
H = ∂ρ/∂v there and C the pose's covariance, the density of a pose given its actuators is N(e; 0, σ² 1 + H C Hᵀ) |H|.
"""

# ruff: noqa: I001 - telescope_problem comes before NumPy and JAX: it sets the number of threads
from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

from telescope_problem import ACTUATOR_NOISE, Problem, standardise  # before JAX: sets one thread

import jax
import jax.numpy as jnp
import numpy as np

from bayescal.density.calibration.likelihood import CalibrationPosterior
from bayescal.machines.kinematics import Machine
from bayescal.numerics.geometry import Array

jax.config.update("jax_enable_x64", True)

STEPS = 3  # of a pose's error with the slopes of another machine, each of which leaves a thousandth of it


def build_log_likelihood(problem: Problem, posterior: CalibrationPosterior) -> Callable[[jax.Array], jax.Array]:
    """Return the log-likelihood as a function of z, shape (n,), up to an additive constant."""
    find = build_rows(problem, posterior)
    covariance = jnp.asarray(problem.poses.covariance)

    def log_likelihood(z: jax.Array) -> jax.Array:
        error, slope = find(z)
        spread = ACTUATOR_NOISE**2 * jnp.eye(6) + slope @ covariance @ jnp.swapaxes(slope, -1, -2)
        factor = jnp.linalg.cholesky(spread)
        white = jax.scipy.linalg.solve_triangular(factor, error[..., None], lower=True)
        log_det = jnp.sum(jnp.log(jnp.diagonal(factor, axis1=-2, axis2=-1)))
        return -0.5 * jnp.sum(white**2) - log_det + jnp.sum(jnp.linalg.slogdet(slope)[1])

    return log_likelihood


def build_fast_log_likelihood(
    problem: Problem, posterior: CalibrationPosterior, anchor: Array
) -> Callable[[jax.Array], jax.Array]:
    """Return the log-likelihood of z up to a constant, cheaply: the pose's error x has a covariance as at z = anchor.

    Per pose the density is N(x; 0, C + σ² (HᵀH)⁻¹), x what the pose is off from where the machine stands; the machines
    of a posterior are so much alike that the covariance hardly moves. x follows by steps with the anchor's slopes.
    """
    machine, poses = problem.machine, problem.poses
    places = Places.of(machine, poses.position, poses.rotation, poses.actuators)
    find = _build_parameters(problem, posterior)
    slope = build_rows(problem, posterior)(jnp.asarray(anchor))[1]
    spread = poses.covariance + ACTUATOR_NOISE**2 * jnp.linalg.inv(jnp.swapaxes(slope, -1, -2) @ slope)
    whitening = jnp.linalg.inv(jnp.linalg.cholesky(spread))
    p = find(jnp.asarray(anchor))
    gain = jnp.linalg.inv(_differentiate(places.reach(p)))

    def log_likelihood(z: jax.Array) -> jax.Array:
        p = find(z)
        reach = places.reach(p)
        closure, by_pose = p["l"] - reach.length, _differentiate(reach)
        error = jnp.zeros(closure.shape)
        for _ in range(STEPS):
            error -= jnp.einsum("pij,pj->pi", gain, closure + jnp.einsum("pij,pj->pi", by_pose, error))
        return -0.5 * jnp.sum(jnp.einsum("pij,pj->pi", whitening, error) ** 2)

    return log_likelihood


class Reach(NamedTuple):
    """Legs' vectors from lower to upper joint in P poses, of N legs."""

    vector: jax.Array  # (P, N, 3), mm
    arm: jax.Array  # (P, N, 3), mm: from the platform's origin to the upper joint
    length: jax.Array  # (P, N), mm


class Places(NamedTuple):
    """Poses and what actuators do there."""

    position: jax.Array  # (P, 1, 3), mm
    rotation: jax.Array  # (P, 3, 3)
    displacement: jax.Array  # (P, N), mm
    constant: jax.Array  # (P, N), mm: of the upper joints along the platform's normal, by what is not free

    @classmethod
    def of(cls, machine: Machine, position: Array, rotation: Array, actuators: Array) -> Places:
        """Return poses (P, 3) and (P, 3, 3) with a machine's actuators (P, N)."""
        basis = machine.basis(actuators)
        return cls(*map(jnp.asarray, (position[:, None], rotation, basis.displacement, basis.constant)))

    def reach(self, p: dict[str, jax.Array]) -> Reach:
        """Return the legs of parameters by symbol, as `take` gives them."""
        joint_z = p["b_z"] + self.constant + p["kappa"] * self.displacement
        joint = jnp.stack([jnp.broadcast_to(p[s], joint_z.shape) for s in ("b_x", "b_y")] + [joint_z], axis=-1)
        arm = jnp.einsum("pjk,pik->pij", self.rotation, joint)
        base = jnp.stack([p["a_x"], p["a_y"], p["a_z"]], axis=-1)
        vector = self.position + arm - base - (p["rho0"] + self.displacement)[..., None] * p["u"]
        return Reach(vector, arm, jnp.sqrt(jnp.sum(vector**2, axis=-1)))


def take(theta: jax.Array, index: dict[str, np.ndarray]) -> dict[str, jax.Array]:
    """Return a machine's parameters by symbol, with the legs' actuator directions u (N, 3)."""
    p = {"kappa": jnp.zeros(6)} | {symbol: theta[positions] for symbol, positions in index.items()}
    third = jnp.sqrt(1.0 - p["u_x"] ** 2 - p["u_y"] ** 2)
    return p | {"u": jnp.stack([p["u_x"], p["u_y"], third], axis=-1)}


def _differentiate(reach: Reach) -> jax.Array:
    """Return the closure's derivative by the pose's error, (P, N, 6)."""
    axis = reach.vector / reach.length[..., None]
    return -jnp.concatenate([axis, jnp.cross(reach.arm, axis)], axis=-1)


def _build_parameters(problem: Problem, posterior: CalibrationPosterior) -> Callable[[jax.Array], dict]:
    """Return a machine's parameters by symbol as a function of z."""
    free, centre, scale = standardise(posterior)
    start = jnp.asarray(posterior.sampling.start)
    index = {symbol: np.asarray(positions) for symbol, positions in problem.machine.layout.index.items()}
    return lambda z: take(start.at[free].set(centre + scale * z), index)


def build_rows(problem: Problem, posterior: CalibrationPosterior) -> Callable[[jax.Array], tuple[jax.Array, jax.Array]]:
    """Return what actuators err, shape (P, 6), and ∂ρ by the pose's error, (P, 6, 6), as functions of z."""
    machine, poses = problem.machine, problem.poses
    coupling = jnp.asarray(machine.basis(poses.actuators).actuator_gain * ~np.eye(6, dtype=bool))
    places = Places.of(machine, poses.position, poses.rotation, poses.actuators)
    normal = places.rotation[:, :, 2]
    find = _build_parameters(problem, posterior)

    def rows(z: jax.Array) -> tuple[jax.Array, jax.Array]:
        p = find(z)
        reach = places.reach(p)
        axis, by_pose = reach.vector / reach.length[..., None], _differentiate(reach)
        # an actuator moves its own lower joint, and through K all joints of the platform along its normal
        lifted = -jnp.einsum("pik,pk->pi", axis, normal)
        by_actuators = lifted[..., None] * (coupling + jnp.diag(p["kappa"]))
        by_actuators += jnp.einsum("pik,ik->pi", axis, p["u"])[..., None] * jnp.eye(6)
        both = jnp.concatenate([(p["l"] - reach.length)[..., None], -by_pose], axis=-1)
        found = jnp.linalg.solve(by_actuators, both)
        return found[..., 0], found[..., 1:]

    return rows
