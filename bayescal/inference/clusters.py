"""A mixture of Gaussians fitted to a cloud of draws, however many clusters, rings or ridges the cloud consists of."""

from __future__ import annotations

import numpy as np
from scipy.cluster.vq import kmeans2
from scipy.special import logsumexp

from bayescal.inference.proposal import MixtureProposal
from bayescal.numerics.geometry import Array

COMPONENTS = (1, 2, 4, 8, 16, 32)
DOF = 10.0  # heavier tails than a Gaussian's, since a cloud of draws tells little of its own tails
GAIN = 0.02  # nats per draw that more components have to gain on draws they have not seen
SWEEPS = 8
ENOUGH = 4  # effective draws per component and coordinate
FLOOR = 1e-3  # of the whole cloud's variance that each component keeps


def fit_mixture(draws: Array, weights: Array, seen: np.ndarray, rng: np.random.Generator) -> MixtureProposal:
    """Return the mixture that describes weighted draws best: as many components as those left out ask for.

    Parameters
    ----------
    draws : ndarray, shape (B, n)
    weights : ndarray, shape (B,)
        They add up to one.
    seen : ndarray of bool, shape (B,)
        Draws to be fitted to; how many components are worth it is judged by the others. Draws of one chain belong on
        one side, lest components settle on single draws.
    rng : Generator
        For where components start.
    """
    n = draws.shape[1]
    centre = weights @ draws
    covariance = (draws - centre).T @ ((draws - centre) * weights[:, None])
    factor = np.linalg.cholesky(covariance + 1e-12 * np.trace(covariance) / n * np.eye(n))
    white = np.linalg.solve(factor, (draws - centre).T).T
    best, score = MixtureProposal(np.ones(1), np.zeros((1, n)), np.eye(n)[None], DOF), -np.inf
    effective = weights[seen].sum() ** 2 / (weights[seen] ** 2).sum()
    for n_components in COMPONENTS:
        if n_components * ENOUGH * n > effective:
            break
        found = best if n_components == 1 else _fit(white[seen], weights[seen], n_components, rng)
        gained = float(weights[~seen] @ found.log_density(white[~seen]) / weights[~seen].sum())
        if gained < score + GAIN:
            break
        best, score = found, gained
    return MixtureProposal(best.weights, centre + best.means @ factor.T, factor @ best.factors, DOF)


def _fit(white: Array, weights: Array, n_components: int, rng: np.random.Generator) -> MixtureProposal:
    """Return a mixture of so many components fitted to whitened draws (B, n) by expectation and maximisation."""
    start = rng.choice(len(white), min(len(white), 1000), p=weights / weights.sum())
    centres, _ = kmeans2(white[start], n_components, minit="++", rng=rng)
    distance = ((white[:, None] - centres) ** 2).sum(axis=2)
    share = np.eye(n_components)[distance.argmin(axis=1)].T
    for _ in range(SWEEPS):
        terms = _maximise(white, share * weights).component_log_densities(white)
        share = np.exp(terms - logsumexp(terms, axis=0))
    return _maximise(white, share * weights)


def _maximise(white: Array, share: Array) -> MixtureProposal:
    """Return the mixture of draws (B, n) that belong to components by shares (M, B)."""
    counts = share.sum(axis=1) + 1e-9 * share.sum()
    means = (share @ white) / counts[:, None]
    second = np.einsum("mb,bi,bj->mij", share, white, white, optimize=True) / counts[:, None, None]
    covariance = second - means[:, :, None] * means[:, None, :] + FLOOR * np.eye(white.shape[1])
    return MixtureProposal(counts / counts.sum(), means, np.linalg.cholesky(covariance), DOF)
