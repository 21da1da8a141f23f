"""Evidence by the nested samplers of peers.py, and fits by SciPy from draws of the prior; seconds of processor time.

Where a nested sampler is cut before its end what it has so far is no evidence, and none is given: only how far its
log-likelihood has come.
"""

# ruff: noqa: I001 - jax_density sets one thread
from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

from jax_density import build_log_likelihood  # first
from peers_posteriors import NO_MACHINE, PlainDensity
from telescope_problem import SEED, Problem

import jax
import numpy as np
from scipy.optimize import least_squares
from scipy.special import ndtri

from bayescal.numerics.geometry import Array

REACHED = 0.5  # nats below the best log-density that anybody found
MOST_STARTS = 50


def run_nautilus(density: PlainDensity, seconds: float, n_live: int) -> dict[str, Any]:
    """Return nautilus' evidence, its likelihoods in batches."""
    from nautilus import Sampler

    n, density.n_calls, begun = density.n, 0, time.process_time()
    sampler = Sampler(ndtri, density.log_likelihood, n_dim=n, n_live=n_live, vectorized=True, pass_dict=False, seed=1)
    finished = bool(sampler.run(timeout=seconds, verbose=False, discard_exploration=True))
    found = {"seconds": time.process_time() - begun, "finished": finished, "calls": density.n_calls, "live": n_live}
    if not finished:
        return found | {"highest_log_likelihood": float(max(np.max(shell) for shell in sampler.log_l if len(shell)))}
    return found | {"log_evidence": float(sampler.log_z), "log_evidence_error": float(sampler.n_eff**-0.5)}


def run_dynesty(one_likelihood: Callable[[Array], float], n: int, seconds: float, n_live: int) -> dict[str, Any]:
    """Return dynesty's evidence with its settings for as many dimensions."""
    import dynesty

    begun, finished, highest, calls = time.process_time(), True, -np.inf, 0
    sampler = dynesty.NestedSampler(one_likelihood, ndtri, n, nlive=n_live, rstate=np.random.default_rng(1))
    for step in sampler.sample(dlogz=0.1):
        highest, calls = float(step.loglstar), calls + int(step.nc)
        if time.process_time() - begun > seconds:
            finished = False
            break
    found = {"seconds": time.process_time() - begun, "finished": finished, "calls": calls, "live": n_live}
    if not finished:
        return found | {"highest_log_likelihood": highest}
    list(sampler.add_live_points())
    results = sampler.results
    return found | {"log_evidence": float(results.logz[-1]), "log_evidence_error": float(results.logzerr[-1])}


def compile_likelihood(problem: Problem, density: PlainDensity, z: Array) -> Callable[[Array], float]:
    """Return the log-likelihood of one z by JAX, which takes one vector in less time than bayescal; normalised at z."""
    compiled = jax.jit(build_log_likelihood(problem, density.posterior))
    offset = float(density.log_likelihood(z[None])[0]) - float(compiled(z))

    def log_likelihood(one: Array) -> float:
        value = float(compiled(one))
        return value + offset if np.isfinite(value) else NO_MACHINE

    return log_likelihood


def run_least_squares(density: PlainDensity, best: float, seconds: float) -> dict[str, Any]:
    """Return how many fits from draws of the prior, with exact derivatives, reach the best log-density, and a price."""
    rng, begun, values = np.random.default_rng(SEED), time.process_time(), []
    while time.process_time() - begun < seconds and len(values) < MOST_STARTS:
        try:
            found = least_squares(density.residuals, rng.standard_normal(density.n), density.jacobian, x_scale="jac")
            values.append(float(density(found.x[None])[0]))
        except (ValueError, np.linalg.LinAlgError):
            values.append(-np.inf)
    spent, best = time.process_time() - begun, max(best, *values)
    reached = int(np.sum(np.array(values) > best - REACHED))
    return {"starts": len(values), "reached": reached, "seconds_each": spent / len(values), "best": best}
