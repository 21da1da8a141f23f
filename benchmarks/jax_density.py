"""The benchmark posterior written in JAX, as one would for a gradient-based sampler: same data, same priors.

Standardised parameters z = (θ - mean) / sd have standard normal priors. The likelihood has the same fixed covariances
as bayescal's; the pose error is found either by solving A(θ) e = f pose by pose or by bayescal's own iteration.
"""

# ruff: noqa: I001 - telescope_problem comes before NumPy and JAX: it sets the number of threads
from __future__ import annotations

from collections.abc import Callable

from telescope_problem import Problem  # before JAX: sets one thread

import jax
import jax.numpy as jnp
import numpy as np

from bayescal.density.pose_likelihood import REFINEMENTS
from bayescal.density.legs import LegPosterior

jax.config.update("jax_enable_x64", True)


def build_log_likelihood(
    problem: Problem, posterior: LegPosterior, exact_solve: bool
) -> Callable[[jax.Array], jax.Array]:
    """Return the log-likelihood as a function of z, shape (60,), up to an additive constant."""
    whitening = jnp.asarray(np.linalg.inv(np.linalg.cholesky(posterior.likelihood.legs_known)))
    errors = build_errors(problem, posterior, None if exact_solve else REFINEMENTS)

    def log_likelihood(z: jax.Array) -> jax.Array:
        white = jnp.einsum("pij,pj->pi", whitening, errors(z))
        return -0.5 * jnp.sum(white**2)

    return log_likelihood


def build_errors(
    problem: Problem, posterior: LegPosterior, refinements: int | None
) -> Callable[[jax.Array], jax.Array]:
    """Return the legs' errors, shape (P, 6), as a function of z, by so many iterations, or None by solving."""
    machine, poses = problem.machine, problem.poses
    layout, coordinates = machine.layout, posterior.sampling.coordinates
    likelihood = posterior.likelihood
    frozen = getattr(likelihood, "base", likelihood)  # the iteration leads to errors seen by this machine's poses
    nominal_pose, gain = jnp.asarray(frozen._pose_jacobian), jnp.asarray(frozen._gain)
    basis = machine.basis(poses.actuators)
    displacement, constant = jnp.asarray(basis.displacement), jnp.asarray(basis.constant)
    position, rotation = jnp.asarray(poses.position)[:, None], jnp.asarray(poses.rotation)
    start, scale, free = jnp.asarray(coordinates.start), jnp.asarray(coordinates.scale), coordinates.free
    index = {symbol: np.asarray(positions) for symbol, positions in layout.index.items()}

    def errors(z: jax.Array) -> jax.Array:
        theta = start.at[free].set(start[free] + scale * z)
        p = {symbol: theta[positions] for symbol, positions in index.items()}
        base = jnp.stack([p["a_x"], p["a_y"], p["a_z"]], axis=-1)
        direction = jnp.stack([p["u_x"], p["u_y"], jnp.sqrt(1.0 - p["u_x"] ** 2 - p["u_y"] ** 2)], axis=-1)
        joint_z = p["b_z"] + constant + p.get("kappa", 0.0) * displacement
        joint = jnp.stack([jnp.broadcast_to(p[s], joint_z.shape) for s in ("b_x", "b_y")] + [joint_z], axis=-1)
        arm = jnp.einsum("pjk,pik->pij", rotation, joint)
        vector = position + arm - base - (p["rho0"] + displacement)[..., None] * direction
        length = jnp.sqrt(jnp.sum(vector**2, axis=-1))
        axis = vector / length[..., None]
        slope = -jnp.concatenate([axis, jnp.cross(arm, axis)], axis=-1)
        closure = p["l"] - length
        if refinements is None:
            error = jnp.linalg.solve(slope, closure[..., None])
            seen = (nominal_pose @ error)[..., 0]
        else:
            seen = closure
            for _ in range(refinements):
                seen = closure + seen - jnp.einsum("pij,pj->pi", slope, jnp.einsum("pij,pj->pi", gain, seen))
        return seen

    return errors
