"""The benchmark posterior written in JAX, as one would for a gradient-based sampler: same data, same priors.

Standardised parameters z = (θ - mean) / sd have standard normal priors. The likelihood has the same fixed covariances
as bayescal's; the pose error is found either by solving A(θ) e = f pose by pose or by bayescal's own iteration.
"""

# ruff: noqa: I001 - telescope_problem comes before NumPy and JAX: it sets the number of threads
from __future__ import annotations

from collections.abc import Callable

from telescope_problem import ACTUATOR_NOISE, Problem  # before JAX: sets one thread

import jax
import jax.numpy as jnp
import numpy as np

from bayescal.density.likelihood import REFINEMENTS
from bayescal.density.posterior import Posterior

jax.config.update("jax_enable_x64", True)


def build_log_likelihood(problem: Problem, posterior: Posterior, exact_solve: bool) -> Callable[[jax.Array], jax.Array]:
    """Return the log-likelihood as a function of z, shape (60,), up to an additive constant."""
    machine, poses = problem.machine, problem.poses
    layout, coordinates = machine.layout, posterior.coordinates
    nominal = machine.linearise(layout.nominal, poses.position, poses.rotation, poses.actuators)
    noise = nominal.actuators @ np.swapaxes(nominal.actuators, 1, 2) * ACTUATOR_NOISE**2
    covariance = nominal.pose @ poses.covariance @ np.swapaxes(nominal.pose, 1, 2) + noise
    whitening = jnp.asarray(np.linalg.inv(np.linalg.cholesky(covariance)))
    nominal_pose, gain = jnp.asarray(nominal.pose), jnp.asarray(np.linalg.inv(nominal.pose))
    basis = machine.basis(poses.actuators)
    displacement, constant = jnp.asarray(basis.displacement), jnp.asarray(basis.constant)
    position, rotation = jnp.asarray(poses.position)[:, None], jnp.asarray(poses.rotation)
    start, scale, free = jnp.asarray(coordinates.start), jnp.asarray(coordinates.scale), coordinates.free
    index = {symbol: np.asarray(positions) for symbol, positions in layout.index.items()}

    def log_likelihood(z: jax.Array) -> jax.Array:
        theta = start.at[free].set(start[free] + scale * z)
        p = {symbol: theta[positions] for symbol, positions in index.items()}
        base = jnp.stack([p["a_x"], p["a_y"], p["a_z"]], axis=-1)
        direction = jnp.stack([p["u_x"], p["u_y"], jnp.sqrt(1.0 - p["u_x"] ** 2 - p["u_y"] ** 2)], axis=-1)
        joint_z = p["b_z"] + constant + p["kappa"] * displacement
        joint = jnp.stack([jnp.broadcast_to(p[s], joint_z.shape) for s in ("b_x", "b_y")] + [joint_z], axis=-1)
        arm = jnp.einsum("pjk,pik->pij", rotation, joint)
        vector = position + arm - base - (p["rho0"] + displacement)[..., None] * direction
        length = jnp.sqrt(jnp.sum(vector**2, axis=-1))
        axis = vector / length[..., None]
        slope = -jnp.concatenate([axis, jnp.cross(arm, axis)], axis=-1)
        closure = p["l"] - length
        if exact_solve:
            error = jnp.linalg.solve(slope, closure[..., None])
            seen = (nominal_pose @ error)[..., 0]
        else:
            seen = closure
            for _ in range(REFINEMENTS):
                seen = closure + seen - jnp.einsum("pij,pj->pi", slope, jnp.einsum("pij,pj->pi", gain, seen))
        white = jnp.einsum("pij,pj->pi", whitening, seen)
        return -0.5 * jnp.sum(white**2)

    return log_likelihood
