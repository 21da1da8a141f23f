"""The benchmark posterior written in JAX, as one would for a gradient-based sampler: same data, same priors.

Standardised parameters z = (θ - mean) / sd have standard normal priors. With e what actuators err at a measured pose,
H = ∂ρ/∂v there and C the pose's covariance, the density of a pose given its actuators is N(e; 0, σ² 1 + H C Hᵀ) |H|.
"""

# ruff: noqa: I001 - telescope_problem comes before NumPy and JAX: it sets the number of threads
from __future__ import annotations

from collections.abc import Callable

from telescope_problem import ACTUATOR_NOISE, Problem, standardise  # before JAX: sets one thread

import jax
import jax.numpy as jnp
import numpy as np

from bayescal.density.calibration.likelihood import CalibrationPosterior

jax.config.update("jax_enable_x64", True)


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


def build_rows(problem: Problem, posterior: CalibrationPosterior) -> Callable[[jax.Array], tuple[jax.Array, jax.Array]]:
    """Return what actuators err, shape (P, 6), and ∂ρ by the pose's error, (P, 6, 6), as functions of z."""
    machine, poses = problem.machine, problem.poses
    layout, basis = machine.layout, machine.basis(poses.actuators)
    displacement, constant = jnp.asarray(basis.displacement), jnp.asarray(basis.constant)
    coupling = jnp.asarray(basis.actuator_gain * ~np.eye(6, dtype=bool))
    position, rotation = jnp.asarray(poses.position)[:, None], jnp.asarray(poses.rotation)
    free, centre, scale = standardise(posterior)
    start = jnp.asarray(posterior.sampling.start)
    index = {symbol: np.asarray(positions) for symbol, positions in layout.index.items()}

    def rows(z: jax.Array) -> tuple[jax.Array, jax.Array]:
        theta = start.at[free].set(centre + scale * z)
        p = {symbol: theta[positions] for symbol, positions in index.items()}
        base = jnp.stack([p["a_x"], p["a_y"], p["a_z"]], axis=-1)
        direction = jnp.stack([p["u_x"], p["u_y"], jnp.sqrt(1.0 - p["u_x"] ** 2 - p["u_y"] ** 2)], axis=-1)
        kappa = p.get("kappa", jnp.zeros(6))
        joint_z = p["b_z"] + constant + kappa * displacement
        joint = jnp.stack([jnp.broadcast_to(p[s], joint_z.shape) for s in ("b_x", "b_y")] + [joint_z], axis=-1)
        arm = jnp.einsum("pjk,pik->pij", rotation, joint)
        vector = position + arm - base - (p["rho0"] + displacement)[..., None] * direction
        length = jnp.sqrt(jnp.sum(vector**2, axis=-1))
        axis = vector / length[..., None]
        by_pose = -jnp.concatenate([axis, jnp.cross(arm, axis)], axis=-1)
        # an actuator moves its own lower joint, and through K all joints of the platform along its normal
        lifted = -jnp.einsum("pik,pk->pi", axis, rotation[:, :, 2])
        by_actuators = lifted[..., None] * (coupling + jnp.diag(kappa))
        by_actuators += jnp.einsum("pik,ik->pi", axis, direction)[..., None] * jnp.eye(6)
        both = jnp.concatenate([(p["l"] - length)[..., None], -by_pose], axis=-1)
        found = jnp.linalg.solve(by_actuators, both)
        return found[..., 0], found[..., 1:]

    return rows
