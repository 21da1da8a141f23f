"""Effective draws per second of bayescal's sampler and of NumPyro's NUTS on the same posterior, one core each.

    python benchmarks/sampling.py [--dense-mass] [--warm-up 500] [--draws 500] [--name sampling]

60 free parameters, 40 poses, no model error. bayescal: exploration, burn-in and four ensembles, all of it timed. NUTS:
standardised parameters, default settings (diagonal mass matrix; a full one on demand), four chains one after the other,
compilation not timed, started at draws of bayescal's posterior, which spares it the search for the mode. Both are
measured by the smallest bulk effective sample size over the same 60 natural parameters. Seconds are processor time,
which other processes on the machine disturb less than they do the clock.
"""

# ruff: noqa: I001 - telescope_problem comes before NumPy and JAX: it sets the number of threads
from __future__ import annotations

import argparse
import os
import time

os.environ["XLA_FLAGS"] = "--xla_cpu_multi_thread_eigen=false"
if hasattr(os, "sched_setaffinity"):
    os.sched_setaffinity(
        0, {max(os.sched_getaffinity(0))}
    )  # one core for both sides, whatever their thread pools think

from jax_density import build_fast_log_likelihood, build_log_likelihood  # first: sets one thread and 64-bit JAX
from telescope_problem import SEED, Problem, simulate, standardise, write_results

import jax
import jax.numpy as jnp
import numpy as np
from arviz_stats.base import array_stats
from numpyro.infer import NUTS

from bayescal.numerics.geometry import Array
from bayescal.inference.exploration import Exploration, explore
from bayescal.inference.sampling import sample_posterior
from bayescal.density.calibration.likelihood import CalibrationPosterior

N_CHAINS = 4
N_WALKERS, N_BURN_IN, N_STEPS = 128, 40, 120  # the package's defaults
CHUNK = 25  # NUTS steps per call
TIME_LIMIT = 420.0  # s for all chains; draws are cut where it does not suffice
AGREEMENT = 0.01  # nats
FAST_AGREEMENT = 0.5  # nats, of the fast form: bayescal's own is off by 0.2
SEED_EXPLORE, SEED_ENSEMBLES, SEED_NUTS = SEED + 1, SEED + 2, SEED + 3


def measure(draws: Array) -> dict[str, float]:
    """Return the worst bulk effective sample size and R-hat of draws (chains, draws, 60)."""
    columns = [draws[..., k] for k in range(draws.shape[-1])]
    return {
        "min_bulk_ess": float(min(array_stats.ess(column, method="bulk") for column in columns)),
        "max_rhat": float(max(array_stats.rhat(column) for column in columns)),
        "n_draws": int(draws.shape[0] * draws.shape[1]),
    }


def run_bayescal(
    posterior: CalibrationPosterior, n_steps: int = N_STEPS
) -> tuple[dict[str, float], Exploration, Array]:
    """Return the figures of bayescal's sampler, its exploration and its draws (ensembles, walkers · steps, 60)."""
    timing, found, draws, acceptance = draw_bayescal(posterior, n_steps)
    seconds, exploration = timing
    figures = measure(draws) | {"seconds": seconds, "seconds_exploration": exploration, "acceptance": acceptance}
    ess, ensembles = figures["min_bulk_ess"], seconds - exploration
    figures["ess_per_second"] = ess / seconds
    figures["ess_per_second_after_exploration"] = ess / ensembles
    figures["ess_per_second_after_burn_in"] = ess / (ensembles * n_steps / (N_BURN_IN + n_steps))
    return figures, found, draws


def draw_bayescal(
    posterior: CalibrationPosterior, n_steps: int = N_STEPS
) -> tuple[tuple[float, float], Exploration, Array, float]:
    """Return the seconds of everything and of the exploration, the exploration, the draws and the acceptance."""
    start = time.process_time()
    found = explore(posterior, np.random.SeedSequence(SEED_EXPLORE), N_WALKERS)
    explored = time.process_time()
    sample = sample_posterior(found, np.random.SeedSequence(SEED_ENSEMBLES), N_CHAINS, N_WALKERS, N_BURN_IN, n_steps)
    seconds = time.process_time() - start
    draws = sample.natural.reshape(N_CHAINS, -1, posterior.n_parameters)
    return (seconds, explored - start), found, draws, float(sample.acceptance.mean())


def run_nuts(
    log_density, starts: Array, dense_mass: bool, n_warm_up: int, n_draws: int, regularise: bool = True
) -> tuple[dict[str, float], Array]:
    """Return the figures of NUTS and its draws (chains, draws, 60) in z; chain after chain, in compiled blocks.

    ``regularise`` is NumPyro's default: it adds 1e-3 · 5 / (n + 5) to the variances of a window of n draws.
    """
    kernel = NUTS(potential_fn=lambda z: -log_density(z), dense_mass=dense_mass, regularize_mass_matrix=regularise)
    keys = jax.random.split(jax.random.PRNGKey(SEED_NUTS), N_CHAINS)

    def advance(state):
        def step(state, _):
            state = kernel.sample(state, (), {})
            return state, (state.z, state.num_steps, state.diverging)

        return jax.lax.scan(step, state, None, length=CHUNK)

    states = [kernel.init(k, n_warm_up, jnp.asarray(z), (), {}) for k, z in zip(keys, starts, strict=True)]
    compiled = jax.jit(advance).lower(states[0]).compile()
    chains, blocks_seconds, leapfrogs, divergences, warm_up = [], [], 0, 0, 0.0
    for state in states:
        start = time.process_time()
        for _ in range(n_warm_up // CHUNK):
            state, _ = jax.block_until_ready(compiled(state))
        now = time.process_time()
        warm_up += now - start
        blocks, seconds = [], []
        while len(blocks) < n_draws // CHUNK and now - start < TIME_LIMIT / N_CHAINS:
            state, (z, n_steps, diverging) = jax.block_until_ready(compiled(state))
            before, now = now, time.process_time()
            blocks.append(np.asarray(z))
            seconds.append(now - before)
            leapfrogs, divergences = leapfrogs + int(n_steps.sum()), divergences + int(diverging.sum())
        chains.append(np.concatenate(blocks))
        blocks_seconds.append(seconds)
    length = min(len(chain) for chain in chains)
    draws = np.stack([chain[:length] for chain in chains])
    # where the time limit cut a chain the others' surplus is dropped, draws and time
    total = warm_up + sum(sum(seconds[: length // CHUNK]) for seconds in blocks_seconds)
    figures = measure(draws) | {"seconds": total, "seconds_warm_up": warm_up, "divergences": divergences}
    figures["leapfrog_steps_per_draw"] = leapfrogs / sum(len(chain) for chain in chains)
    figures["ess_per_second"] = figures["min_bulk_ess"] / total
    figures["ess_per_second_after_warm_up"] = figures["min_bulk_ess"] / (total - warm_up)
    return figures, draws


def build_density(problem: Problem, posterior: CalibrationPosterior, z: Array):
    """Return JAX's log-density in a fast form, as bayescal samples by one, the whole one, and figures of both.

    Both are compared with bayescal's density at z, shape (n, 60), in no fast form; AssertionError where they differ by
    more than a constant. Times of one gradient are in µs, the call among them.
    """
    free, centre, scale = standardise(posterior)
    theta = np.tile(posterior.sampling.start, (len(z), 1))
    theta[:, free] = centre + scale * z
    zeta = np.zeros((len(z), 0))
    fast, whole = (
        one.density(theta, posterior.errors, zeta) for one in (posterior.likelihood, posterior.likelihood.whole)
    )

    def add_prior(likelihood):
        return lambda x: likelihood(x) - 0.5 * jnp.sum(x**2)

    densities = {
        "": add_prior(build_fast_log_likelihood(problem, posterior, z.mean(axis=0))),
        "whole_": add_prior(build_log_likelihood(problem, posterior)),
    }
    figures = {"fast_form_leaves_out": float(np.ptp(fast - whole))}
    expected, points = whole - 0.5 * np.sum(z**2, axis=1), jnp.asarray(z)
    for name, density in densities.items():
        figures[f"{name}largest_difference"] = float(np.ptp(expected - np.asarray(jax.jit(jax.vmap(density))(points))))
        figures[f"{name}gradient_us"] = time_gradient(density, z)
    assert figures["whole_largest_difference"] < AGREEMENT, f"log densities differ: {figures}"
    assert figures["largest_difference"] < FAST_AGREEMENT, f"log densities differ: {figures}"
    return (*densities.values(), figures)


def time_gradient(density, z: Array) -> float:
    """Return the median time of value and gradient at draws (n, 60), µs."""
    gradient = jax.jit(jax.value_and_grad(density)).lower(jnp.asarray(z[0])).compile()
    seconds = []
    for k in range(500):
        begin = time.perf_counter()
        jax.block_until_ready(gradient(jnp.asarray(z[k % len(z)])))
        seconds.append(time.perf_counter() - begin)
    return 1e6 * float(np.median(seconds))


def main() -> None:
    """Run both, print a table and write the results."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--dense-mass", action="store_true", help="NUTS adapts a full mass matrix")
    parser.add_argument("--warm-up", type=int, default=500, help="steps of each NUTS chain, a multiple of 25")
    parser.add_argument("--draws", type=int, default=500, help="draws of each NUTS chain, a multiple of 25")
    parser.add_argument("--name", default="sampling", help="name of the results' file")
    arguments = parser.parse_args()
    problem = simulate()
    posterior = problem.posterior()
    ours, found, draws = run_bayescal(posterior)
    _, centre, scale = standardise(posterior)
    z = (draws - centre) / scale
    starts = np.stack([chain[len(chain) // 2] for chain in z])
    density, _, comparison = build_density(problem, posterior, z[:, :: z.shape[1] // 10].reshape(-1, z.shape[-1]))
    theirs, z_nuts = run_nuts(density, starts, arguments.dense_mass, arguments.warm_up, arguments.draws)
    spread = z.reshape(-1, z.shape[-1]).std(axis=0)
    shift = np.abs(z_nuts.reshape(-1, z.shape[-1]).mean(axis=0) - z.reshape(-1, z.shape[-1]).mean(axis=0)) / spread
    figures = {
        "bayescal": ours | {"importance_efficiency": found.efficiency},
        "nuts": theirs
        | {
            "mass_matrix": "dense" if arguments.dense_mass else "diagonal",
            "warm_up": arguments.warm_up,
            "draws_asked_for": arguments.draws,
            "starts": "draws of bayescal's posterior",
        },
        "density": comparison,
        "largest_shift_of_means_in_posterior_sd": float(shift.max()),
        "ratio_everything_counted": ours["ess_per_second"] / theirs["ess_per_second"],
        "ratio_nuts_warm_up_free": ours["ess_per_second"] / theirs["ess_per_second_after_warm_up"],
    }
    print(f"{'':10}{'min ESS':>9}{'max R-hat':>11}{'seconds':>9}{'ESS / s':>9}")
    for name, row in (("bayescal", ours), ("NUTS", theirs)):
        print(
            f"{name:10}{row['min_bulk_ess']:9.0f}{row['max_rhat']:11.4f}{row['seconds']:9.1f}{row['ess_per_second']:9.2f}"
        )
    print(
        f"ratio {figures['ratio_everything_counted']:.0f}, {figures['ratio_nuts_warm_up_free']:.0f} after NUTS' warm-up"
    )
    print(write_results(arguments.name, figures, ("numpy", "emcee", "arviz-stats", "jax", "numpyro")).name)


if __name__ == "__main__":
    main()
