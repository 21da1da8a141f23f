"""Effective draws per second of bayescal's sampler and of NumPyro's NUTS on a posterior with a structured model error.

    python benchmarks/sampling_structured.py [--warm-up 250] [--draws 250]

The poses of a machine deformed by eq. 4's matrix, calibrated by the model without deformation and with errors linear in
the actuators' travel: 54 geometric parameters, τ of each leg and the kernel's scale, 40 poses. Both sides sample the
same density, with an error: NUTS with a dense mass matrix, started at draws of bayescal's posterior, compilation not
timed; bayescal from nothing, exploration and burn-in timed. See `sampling.py`.
"""

# ruff: noqa: I001 - telescope_problem comes before NumPy and JAX: it sets the number of threads
from __future__ import annotations

import argparse
from dataclasses import replace

from sampling import AGREEMENT, run_bayescal, run_nuts  # first: one core
from jax_density import build_structured_log_density
from telescope_problem import MODEL_ERROR_SCALE, Problem, simulate, write_results

import jax
import jax.numpy as jnp
import numpy as np

from bayescal.density.model_error import KernelScale, LinearKernel
from bayescal.density.posterior import ModelError
from bayescal.density.structured import StructuredLikelihood
from bayescal.density.structured_posterior import StructuredPosterior
from bayescal.machines.deformations import NoDeformation
from bayescal.machines.kinematics import Machine
from bayescal.numerics.geometry import Array


def build_problem() -> tuple[Problem, StructuredPosterior]:
    """Return the problem seen by a model that leaves the deformation out, and its posterior."""
    problem = simulate()
    machine = Machine(problem.machine.mechanism, problem.machine.model, NoDeformation())
    problem = replace(problem, machine=machine)
    likelihood = StructuredLikelihood(problem.likelihood(), LinearKernel(), machine.mechanism.actuator_range)
    scale = KernelScale(0.02, 0.5)
    return problem, StructuredPosterior(likelihood, problem.priors(), ModelError(MODEL_ERROR_SCALE), kernel_scale=scale)


def standardise(posterior: StructuredPosterior, draws: Array) -> Array:
    """Return natural draws (..., n) as NUTS' coordinates."""
    coordinates, m, scale = posterior.coordinates, posterior.n_geometry, posterior.kernel_scale
    z = draws.copy()
    z[..., :m] = (draws[..., :m] - coordinates.start[coordinates.free]) / coordinates.scale
    for k, prior in enumerate(list(posterior.all_priors().values())[m:-1], start=m):
        z[..., k] = prior.standardise(draws[..., k])
    z[..., -1] = np.log(draws[..., -1] / scale.scale) / scale.spread
    return z


def compare(posterior: StructuredPosterior, density, z: Array) -> float:
    """Return by how much the densities differ at draws z (n, d) but for a constant; AssertionError where it is much."""
    coordinates, m = posterior.coordinates, posterior.n_geometry
    theta = np.tile(coordinates.start, (len(z), 1))
    theta[:, coordinates.free] += coordinates.scale * z[:, :m]
    y = np.concatenate([coordinates.y_from_theta(theta), z[:, m:]], axis=1)
    expected = posterior.log_density(y) - coordinates.log_volume(theta) - coordinates.log_ring_ratio(y[:, :m])
    difference = float(np.ptp(expected - np.array([density(jnp.asarray(one)) for one in z])))
    assert difference < AGREEMENT, f"log densities differ by {difference:.2g}"
    return difference


def main() -> None:
    """Run both, print a table and write the results."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--warm-up", type=int, default=250, help="steps of each NUTS chain, a multiple of 25")
    parser.add_argument("--draws", type=int, default=250, help="draws of each NUTS chain, a multiple of 25")
    arguments = parser.parse_args()
    problem, posterior = build_problem()
    ours, found, draws = run_bayescal(posterior)
    assert (draws[..., -1] > 0.0).all(), "bayescal's draws hold machines without a structured error"
    z = standardise(posterior, draws)
    density = jax.jit(build_structured_log_density(problem, posterior))
    difference = compare(posterior, density, z[:, :: z.shape[1] // 10].reshape(-1, z.shape[-1]))
    starts = np.stack([chain[len(chain) // 2] for chain in z])
    theirs, z_nuts = run_nuts(density, starts, True, arguments.warm_up, arguments.draws)
    both = [one.reshape(-1, z.shape[-1]) for one in (z_nuts, z)]
    shift = np.abs(both[0].mean(axis=0) - both[1].mean(axis=0)) / both[1].std(axis=0)
    figures = {
        "bayescal": ours | {"importance_efficiency": found.efficiency},
        "nuts": theirs | {"mass_matrix": "dense", "warm_up": arguments.warm_up, "draws_asked_for": arguments.draws},
        "largest_difference_of_log_densities": difference,
        "largest_shift_of_means_in_posterior_sd": float(shift.max()),
        "ratio_everything_counted": ours["ess_per_second"] / theirs["ess_per_second"],
        "ratio_nuts_warm_up_free": ours["ess_per_second"] / theirs["ess_per_second_after_warm_up"],
    }
    print(f"{'':10}{'min ESS':>9}{'max R-hat':>11}{'seconds':>9}{'ESS / s':>9}")
    for name, row in (("bayescal", ours), ("NUTS", theirs)):
        seconds, rate = row["seconds"], row["ess_per_second"]
        print(f"{name:10}{row['min_bulk_ess']:9.0f}{row['max_rhat']:11.4f}{seconds:9.1f}{rate:9.2f}")
    print(f"ratio {figures['ratio_everything_counted']:.0f}, {figures['ratio_nuts_warm_up_free']:.0f} without warm-up")
    print(write_results("sampling_structured", figures, ("numpy", "emcee", "arviz-stats", "jax", "numpyro")).name)


if __name__ == "__main__":
    main()
