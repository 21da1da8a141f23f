"""Effective draws per second of bayescal's sampler and of NumPyro's NUTS on a posterior with a structured model error.

    python benchmarks/sampling_structured.py [--warm-up 100] [--draws 500] [--cold]

The poses of a machine deformed by eq. 4's matrix, calibrated by the model without deformation and with errors linear in
the actuators' travel: 36 geometric parameters, τ of each leg and the kernel's scale, 40 poses. Both sides sample the
same density, with an error: bayescal from nothing, exploration and burn-in timed. NUTS is given all that it might have
to find: it starts at draws of bayescal's posterior, in coordinates whitened by their covariance, and compilation is not
timed; its warm-up sets the step size. With --cold it adapts a full mass matrix itself. Ratios of effective draws per
second are printed with everything counted, without NUTS' warm-up, and with nothing of NUTS but its gradients.
"""

# ruff: noqa: I001 - telescope_problem comes before NumPy and JAX: it sets the number of threads
from __future__ import annotations

import argparse
import time
from dataclasses import replace

from sampling import AGREEMENT, run_bayescal, run_nuts  # first: one core
from jax_density import build_structured_log_density
from telescope_problem import MODEL_ERROR_SCALE, Problem, simulate, write_results

import jax
import jax.numpy as jnp
import numpy as np

from bayescal.density.errors import KernelScale
from bayescal.density.model_error import LinearKernel
from bayescal.density.errors import ModelError
from bayescal.density.structured import StructuredLikelihood
from bayescal.density.legs import LegPosterior, build_leg_posterior
from bayescal.machines.deformations import NoDeformation
from bayescal.machines.kinematics import Machine
from bayescal.numerics.geometry import Array


def build_problem() -> tuple[Problem, LegPosterior]:
    """Return the problem seen by a model that leaves the deformation out, and its posterior."""
    problem = simulate()
    machine = Machine(problem.machine.mechanism, problem.machine.model, NoDeformation())
    problem = replace(problem, machine=machine)
    likelihood = StructuredLikelihood(problem.likelihood(), LinearKernel(), machine.mechanism.actuator_range)
    scale = KernelScale(0.02, 0.5)
    return problem, build_leg_posterior(likelihood, problem.priors(), ModelError(MODEL_ERROR_SCALE), terms=(scale,))


def standardise(posterior: LegPosterior, draws: Array) -> Array:
    """Return natural draws (..., n) as NUTS' coordinates."""
    coordinates, m, scale = posterior.sampling.coordinates, posterior.n_geometry, posterior.kernel_scale
    z = draws.copy()
    z[..., :m] = (draws[..., :m] - coordinates.start[coordinates.free]) / coordinates.scale
    for k, prior in enumerate(list(posterior.all_priors().values())[m:-1], start=m):
        z[..., k] = prior.standardise(draws[..., k])
    z[..., -1] = np.log(draws[..., -1] / scale.scale) / scale.spread
    return z


def compare(posterior: LegPosterior, density, z: Array) -> float:
    """Return by how much the densities differ at draws z (n, d) but for a constant; AssertionError where it is much."""
    coordinates, m = posterior.sampling.coordinates, posterior.n_geometry
    theta = np.tile(coordinates.start, (len(z), 1))
    theta[:, coordinates.free] += coordinates.scale * z[:, :m]
    y = np.concatenate([coordinates.y_from_theta(theta), z[:, m:]], axis=1)
    expected = posterior.log_density(y) - coordinates.log_volume(theta) - coordinates.log_ring_ratio(y[:, :m])
    difference = float(np.ptp(expected - np.array([density(jnp.asarray(one)) for one in z])))
    assert difference < AGREEMENT, f"log densities differ by {difference:.2g}"
    return difference


def whiten(draws: Array) -> tuple[Array, Array]:
    """Return mean and Cholesky factor of the covariance of draws (chains, n, d)."""
    flat = draws.reshape(-1, draws.shape[-1])
    return flat.mean(axis=0), np.linalg.cholesky(np.cov(flat, rowvar=False))


def time_gradient(density, points: Array) -> float:
    """Return the seconds of one gradient, compiled."""
    gradient = jax.jit(jax.value_and_grad(density)).lower(jnp.asarray(points[0])).compile()
    seconds = []
    for one in np.resize(points, (300, points.shape[-1])):
        begin = time.perf_counter()
        jax.block_until_ready(gradient(jnp.asarray(one)))
        seconds.append(time.perf_counter() - begin)
    return float(np.median(seconds))


def main() -> None:
    """Run both, print a table and write the results."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--warm-up", type=int, default=100, help="steps of each NUTS chain, a multiple of 25")
    parser.add_argument("--draws", type=int, default=500, help="draws of each NUTS chain, a multiple of 25")
    parser.add_argument("--cold", action="store_true", help="NUTS adapts a full mass matrix itself")
    arguments = parser.parse_args()
    problem, posterior = build_problem()
    ours, found, draws = run_bayescal(posterior)
    assert (draws[..., -1] > 0.0).all(), "bayescal's draws hold machines without a structured error"
    z = standardise(posterior, draws)
    plain = jax.jit(build_structured_log_density(problem, posterior))
    difference = compare(posterior, plain, z[:, :: z.shape[1] // 10].reshape(-1, z.shape[-1]))
    mean, factor = (np.zeros(z.shape[-1]), np.eye(z.shape[-1])) if arguments.cold else whiten(z)
    centre, root = jnp.asarray(mean), jnp.asarray(factor)
    density = jax.jit(lambda x: plain(centre + root @ x))
    x = np.linalg.solve(factor, (z - mean)[..., None])[..., 0]
    gradient = time_gradient(density, x[0, :20])
    print(f"one gradient {1e6 * gradient:.0f} µs", flush=True)
    starts = np.stack([chain[len(chain) // 2] for chain in x])
    theirs, x_nuts = run_nuts(density, starts, arguments.cold, arguments.warm_up, arguments.draws)
    both = [one.reshape(-1, z.shape[-1]) for one in (x_nuts, x)]
    shift = np.abs(both[0].mean(axis=0) - both[1].mean(axis=0)) / both[1].std(axis=0)
    # nothing but gradients: the least that any sampler of these draws needs
    least = theirs["n_draws"] * theirs["leapfrog_steps_per_draw"] * gradient
    figures = {
        "bayescal": ours | {"importance_efficiency": found.efficiency},
        "nuts": theirs
        | {
            "mass_matrix": "adapted" if arguments.cold else "the posterior's covariance, given",
            "warm_up": arguments.warm_up,
            "draws_asked_for": arguments.draws,
            "gradient_us": 1e6 * gradient,
            "ess_per_second_of_gradients": theirs["min_bulk_ess"] / least,
        },
        "largest_difference_of_log_densities": difference,
        "largest_shift_of_means_in_posterior_sd": float(shift.max()),
        "ratio_everything_counted": ours["ess_per_second"] / theirs["ess_per_second"],
        "ratio_nuts_warm_up_free": ours["ess_per_second"] / theirs["ess_per_second_after_warm_up"],
        "ratio_nuts_gradients_alone": ours["ess_per_second"] * least / theirs["min_bulk_ess"],
        "ratio_both_after_exploration": ours["ess_per_second_after_exploration"]
        / theirs["ess_per_second_after_warm_up"],
    }
    print(f"{'':10}{'min ESS':>9}{'max R-hat':>11}{'seconds':>9}{'ESS / s':>9}")
    for name, row in (("bayescal", ours), ("NUTS", theirs)):
        seconds, rate = row["seconds"], row["ess_per_second"]
        print(f"{name:10}{row['min_bulk_ess']:9.0f}{row['max_rhat']:11.4f}{seconds:9.1f}{rate:9.2f}")
    print({key: round(value, 2) for key, value in figures.items() if key.startswith("ratio")})
    print(write_results("sampling_structured", figures, ("numpy", "emcee", "arviz-stats", "jax", "numpyro")).name)


if __name__ == "__main__":
    main()
