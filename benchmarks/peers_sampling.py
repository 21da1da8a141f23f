"""Effective draws per second of the samplers of peers.py, each with bayescal timed beside it."""

# ruff: noqa: I001 - sampling sets one core and the number of threads
from __future__ import annotations

import time
from typing import Any

import sampling  # first
from peers_posteriors import PlainDensity
from telescope_problem import SEED, Problem

import emcee
import jax
import jax.numpy as jnp
import numpy as np

from bayescal.density.calibration.likelihood import CalibrationPosterior
from bayescal.inference.importance import estimate_by_importance
from bayescal.inference.mode import Mode
from bayescal.numerics.geometry import Array

PRICE = 0.02  # nats of standard error that evidences are timed to


def run_bayescal(posterior: CalibrationPosterior, n_steps: int) -> tuple[dict[str, Any], list[Mode], Array]:
    """Return figures of draws and evidence, the modes found, and the draws in z (ensembles, draws, n)."""
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
    return figures | {"mode_shares": density.mode_shares(found.modes, z)}, found.modes, z


def time_bayescal(posterior: CalibrationPosterior, n_steps: int, repeats: int) -> list[tuple[float, float]]:
    """Return the seconds of everything and of the exploration, once more each; the draws are the same."""
    return [sampling.draw_bayescal(posterior, n_steps)[0] for _ in range(repeats)]


def compare_rates(ours: dict[str, Any], theirs: dict[str, Any], beside: list[tuple[float, float]]) -> dict[str, Any]:
    """Return bayescal's effective draws per second over theirs, its time the median of those before and after.

    ``ratio``: everything counted on both sides. ``ratio_warm_up_free``: all of bayescal's time against theirs after
    their warm-up. ``ratio_both_prepared``: bayescal's exploration and burn-in are not counted either.
    """
    seconds, exploration = np.median(beside, axis=0)
    ess, kept = ours["min_bulk_ess"], ours["steps"] / (ours["steps"] + sampling.N_BURN_IN)
    later = theirs.get("ess_per_second_after_warm_up", theirs["ess_per_second"])
    return {
        "bayescal_seconds_beside": [one for one, _ in beside],
        "bayescal_ess_per_second": ess / seconds,
        "ratio": ess / seconds / theirs["ess_per_second"],
        "ratio_warm_up_free": ess / seconds / later,
        "ratio_both_prepared": ess / ((seconds - exploration) * kept) / later,
    }


def run_nuts(
    problem: Problem,
    posterior: CalibrationPosterior,
    modes: list[Mode],
    z: Array,
    warm_up: int,
    n_draws: int,
    regularise: bool,
    whitened: bool,
) -> dict[str, Any]:
    """Return the figures of NUTS with a full mass matrix, in z or in coordinates of the posterior's covariance."""
    n = z.shape[-1]
    density, comparison = sampling.build_density(problem, posterior, z[:, :: z.shape[1] // 10].reshape(-1, n))
    flat = z.reshape(-1, n)
    centre, factor = np.zeros(n), np.eye(n)
    if whitened:
        centre, factor = flat.mean(axis=0), np.linalg.cholesky(np.cov(flat, rowvar=False))
    starts = np.linalg.solve(factor, (z[:, z.shape[1] // 2] - centre)[..., None])[..., 0]

    def moved(x: jax.Array) -> jax.Array:
        return density(jnp.asarray(centre) + jnp.asarray(factor) @ x)

    chosen = moved if whitened else density
    figures, x = sampling.run_nuts(chosen, starts, True, warm_up, n_draws, regularise)
    theirs = centre + x @ factor.T
    shift = np.abs(theirs.reshape(-1, n).mean(axis=0) - flat.mean(axis=0)) / flat.std(axis=0)
    more = {"largest_shift_of_means_in_sd": float(shift.max()), "warm_up": warm_up}
    more["mode_shares_by_chain"] = [PlainDensity(posterior).mode_shares(modes, chain) for chain in theirs]
    return figures | comparison | more


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
