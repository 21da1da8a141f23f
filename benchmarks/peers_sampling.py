"""Effective draws per second of the samplers of peers.py, each with bayescal timed beside it."""

# ruff: noqa: I001 - sampling sets one core and the number of threads
from __future__ import annotations

import time
from dataclasses import replace
from typing import Any

import sampling  # first
from jax_straight import build_straight
from peers_posteriors import PlainDensity
from telescope_problem import SEED, Problem

import emcee
import jax
import jax.numpy as jnp
import numpy as np

from bayescal.density.calibration.likelihood import CalibrationPosterior
from bayescal.inference.exploration import Exploration
from bayescal.inference.importance import estimate_by_importance
from bayescal.numerics.geometry import Array

SAME_PLACE = 1e-8  # prior standard deviations
PRICE = 0.02  # nats of standard error that evidences are timed to


def run_bayescal(posterior: CalibrationPosterior, n_steps: int) -> tuple[dict[str, Any], Exploration, Array]:
    """Return figures of draws and evidence, what was explored, and the draws in z (ensembles, draws, n)."""
    figures, found, draws = sampling.run_bayescal(posterior, n_steps)
    begun = time.process_time()
    evidence = estimate_by_importance(
        found.straight.log_density, found.proposal, np.random.default_rng(SEED), 4000, PRICE, 400_000
    )
    figures |= {
        "steps": n_steps,
        "importance_efficiency": found.efficiency,
        "log_evidence": evidence.log_evidence,
        "log_evidence_error": evidence.standard_error,
        "seconds_evidence": figures["seconds_exploration"] + time.process_time() - begun,
    }
    density = PlainDensity(posterior)
    z = density.standardise(draws)
    return figures | {"mode_shares": density.mode_shares(found.modes, z)}, found, z


def time_bayescal(posterior: CalibrationPosterior, n_steps: int, repeats: int) -> list[tuple[float, float]]:
    """Return the seconds of everything and of the exploration, once more each; the draws are the same."""
    return [sampling.draw_bayescal(posterior, n_steps)[0] for _ in range(repeats)]


def compare_rates(ours: dict[str, Any], theirs: dict[str, Any], beside: list[tuple[float, float]]) -> dict[str, Any]:
    """Return bayescal's effective draws per second over theirs, its time the median of those before and after.

    ``ratio``: everything counted on both sides. ``ratio_warm_up_free``: all of bayescal's time against theirs after
    their warm-up. ``ratio_both_prepared``: bayescal's exploration and burn-in are not counted either.
    ``ratio_exploration_counted``: as ``ratio``, with bayescal's exploration counted for both.
    """
    seconds, exploration = np.median(beside, axis=0)
    ess, kept = ours["min_bulk_ess"], ours["steps"] / (ours["steps"] + sampling.N_BURN_IN)
    later = theirs.get("ess_per_second_after_warm_up", theirs["ess_per_second"])
    return {
        "bayescal_seconds_beside": [one for one, _ in beside],
        "bayescal_ess_per_second": ess / seconds,
        "ratio": ess / seconds / theirs["ess_per_second"],
        "ratio_exploration_counted": ess / seconds / theirs["ess_per_second"] * (1.0 + exploration / theirs["seconds"]),
        "ratio_warm_up_free": ess / seconds / later,
        "ratio_both_prepared": ess / ((seconds - exploration) * kept) / later,
    }


def run_nuts(
    problem: Problem,
    posterior: CalibrationPosterior,
    found: Exploration,
    z: Array,
    warm_up: int,
    n_draws: int,
    regularise: bool,
    dense: bool,
    coordinates: str,
) -> dict[str, Any]:
    """Return the figures of NUTS with a full mass matrix, or a diagonal one.

    ``coordinates``: "z"; "whitened", those of the posterior's covariance; "straight", bayescal's, whitened too.
    """
    n = z.shape[-1]
    some, flat = z[:, :: z.shape[1] // 10].reshape(-1, n), z.reshape(-1, n)
    density, whole, comparison = sampling.build_density(problem, posterior, some)
    inside = z[:, z.shape[1] // 2]
    if coordinates == "straight":
        place, mean, factor = build_straight(problem, posterior, found)
        z_from, starts = jax.jit(jax.vmap(lambda eta: place(eta)[0])), _straight(posterior, found, inside, mean, factor)

        def carried(density):
            def log_density(eta: jax.Array) -> jax.Array:
                z, gain = place(eta)
                return density(z) + gain

            return log_density

        chosen = carried(density)
        comparison |= compare_straight(posterior, found, chosen, carried(whole), z_from, some, mean, factor)
    else:
        centre, factor = np.zeros(n), np.eye(n)
        if coordinates == "whitened":
            centre, factor = flat.mean(axis=0), np.linalg.cholesky(np.cov(flat, rowvar=False))
        starts = np.linalg.solve(factor, (inside - centre)[..., None])[..., 0]

        def moved(x: jax.Array) -> jax.Array:
            return density(jnp.asarray(centre) + jnp.asarray(factor) @ x)

        def z_from(x: Array) -> Array:
            return centre + x @ factor.T

        chosen = moved if coordinates == "whitened" else density
    figures, x = sampling.run_nuts(chosen, starts, dense, warm_up, n_draws, regularise)
    theirs = np.asarray(z_from(x.reshape(-1, n))).reshape(x.shape)
    figures |= sampling.measure(theirs)  # of the natural parameters, whatever the coordinates
    total, warm = figures["seconds"], figures["seconds_warm_up"]
    figures["ess_per_second"] = figures["min_bulk_ess"] / total
    figures["ess_per_second_after_warm_up"] = figures["min_bulk_ess"] / (total - warm)
    shift = np.abs(theirs.reshape(-1, n).mean(axis=0) - flat.mean(axis=0)) / flat.std(axis=0)
    more = {"largest_shift_of_means_in_sd": float(shift.max()), "warm_up": warm_up}
    more["mode_shares_by_chain"] = [PlainDensity(posterior).mode_shares(found.modes, chain) for chain in theirs]
    return figures | comparison | more


def _straight(posterior: CalibrationPosterior, found: Exploration, z: Array, mean: Array, factor: Array) -> Array:
    """Return whitened straight coordinates η (B, n) of z."""
    y = posterior.sampling.y_from_theta(PlainDensity(posterior).theta(z))
    return np.linalg.solve(factor, (found.straight.x_from_y(y) - mean).T).T


def compare_straight(
    posterior: CalibrationPosterior, found: Exploration, density, whole, z_from, z: Array, mean: Array, factor: Array
) -> dict[str, float]:
    """Return by how much JAX and bayescal differ in straight coordinates, at draws z (B, n); AssertionError if much.

    ``density`` and ``whole``: JAX's log-densities of η, fast and whole; ``z_from``: its way from η (B, n) to z.
    """
    eta = _straight(posterior, found, z, mean, factor)
    points, x = jnp.asarray(eta), mean + eta @ factor.T
    moved = float(np.abs(np.asarray(z_from(points)) - z).max())
    exact = replace(found.straight, posterior=replace(posterior, likelihood=posterior.likelihood.whole))
    expected, fast = exact.log_density(x), found.straight.log_density(x)
    ours, ours_whole = (np.asarray(jax.jit(jax.vmap(one))(points)) for one in (density, whole))
    figures = {
        "straight_coordinates_differ": moved,
        "straight_whole_difference": float(np.ptp(ours_whole - expected)),
        "straight_difference": float(np.ptp(ours - expected)),
        "straight_difference_of_fast_forms": float(np.ptp(ours - fast)),
        "straight_gradient_us": sampling.time_gradient(density, eta),
    }
    assert moved < SAME_PLACE, f"coordinates differ by {moved} prior standard deviations"
    assert figures["straight_whole_difference"] < sampling.AGREEMENT, f"log densities differ: {figures}"
    assert figures["straight_difference"] < sampling.FAST_AGREEMENT, f"log densities differ: {figures}"
    return figures


def run_stretch(density: PlainDensity, z: Array, seconds: float) -> dict[str, Any]:
    """Return the figures of the stretch move from draws of the posterior."""
    n = z.shape[-1]
    start = z.reshape(-1, n)[:: z.shape[0] * z.shape[1] // (4 * n)][: 4 * n]
    sampler = emcee.EnsembleSampler(len(start), n, density, vectorize=True)
    state, begun = emcee.State(start), time.process_time()
    while time.process_time() - begun < seconds:
        state = sampler.run_mcmc(state, 50, skip_initial_state_check=True)
    spent = time.process_time() - begun
    times = sampler.get_autocorr_time(quiet=True)  # of runs that are too short: too little
    ess = len(start) * sampler.iteration / times.max()
    return {"seconds": spent, "ess_at_most": float(ess), "ess_per_second": float(ess / spent)}
