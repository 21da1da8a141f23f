"""Separate solutions of one posterior: draws by the mode that they belong to, and how probable each mode is.

Two modes are two solutions where the geometry's density has a deep valley between them; modes that differ in errors
alone, or that a curved ridge joins, are one. Each solution is a machine of its own: a mean over several is none.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from bayescal.inference.diagnostics import judge_draws
from bayescal.inference.mode import Mode
from bayescal.numerics.geometry import Array

LEAST_PROBABILITY = 0.01  # of a solution that is more than mentioned
MOST_DRAWS = 20_000  # from which clusters are found; all are assigned to them
ROUNDS = 3  # of assigning draws to the nearest mean, in units of the spread within clusters
MIN_DISTANCE = 6.0  # of two clusters' means, in standard deviations within clusters
N_BINS = 30  # of the distance between two means along the direction that separates their clusters best
VALLEY = 0.05  # density between two clusters over the smaller one's peak from which on they are one


@dataclass(frozen=True, eq=False)
class Solutions:
    """The separate solutions of a posterior, the most probable first.

    Attributes
    ----------
    label : ndarray of int, shape (...)
        Of each draw, from 0.
    probability, standard_error : ndarray, shape (M,)
    of_modes : ndarray of int, shape (K,)
        To which each mode belongs that the search found.
    """

    label: np.ndarray
    probability: Array
    standard_error: Array
    of_modes: np.ndarray

    @property
    def n_shown(self) -> int:
        """How many are machines of their own, those of `LEAST_PROBABILITY` or more; the others are only mentioned."""
        return int((self.probability >= LEAST_PROBABILITY).sum())


def find_solutions(draws: Array, modes: Sequence[Mode], n_geometry: int) -> Solutions:
    """Return which solution each draw belongs to.

    Parameters
    ----------
    draws : ndarray, shape (E, W, S, n)
        Of ensembles, in sampling coordinates.
    modes : sequence of Mode
        That the search found, in the same coordinates.
    n_geometry : int
        How many of the first coordinates are the machine's.
    """
    shape = draws.shape[:-1]
    every = draws[..., :n_geometry].reshape(-1, n_geometry)
    single = Solutions(np.zeros(shape, dtype=int), np.ones(1), np.zeros(1), np.zeros(len(modes), dtype=int))
    if len(modes) == 1 or not n_geometry:
        return single
    tops = np.stack([mode.y[:n_geometry] for mode in modes])
    some = every[:: -(-len(every) // MOST_DRAWS)]
    scale = np.sqrt(np.mean([np.diagonal(mode.covariance)[:n_geometry] for mode in modes], axis=0))
    centres, whiten = _fit_clusters(some, tops, np.diag(1.0 / scale))
    group = _join(some @ whiten, centres @ whiten)
    label = group[_assign(every @ whiten, centres @ whiten)].reshape(shape)
    counts = np.bincount(label.ravel())
    order = np.argsort(-counts, kind="stable")
    place = np.argsort(order)
    label, of_modes = place[label], place[group[_assign(tops @ whiten, centres @ whiten)]]
    n = int((counts > 0).sum())
    if n < 2:
        return single
    probability = counts[order][:n] / label.size
    indicator = (label[..., None] == np.arange(n)).astype(np.float64)
    effective = np.maximum(judge_draws(indicator)[1], 1.0)
    effective[~np.isfinite(effective)] = 1.0
    return Solutions(label, probability, np.sqrt(probability * (1.0 - probability) / effective), of_modes)


def _assign(points: Array, centres: Array) -> np.ndarray:
    """Return the nearest of centres (M, m) of each point (S, m)."""
    square = (centres**2).sum(axis=1) - 2.0 * points @ centres.T
    return np.argmin(square, axis=1)


def _fit_clusters(draws: Array, centres: Array, whiten: Array) -> tuple[Array, Array]:
    """Return means (M, m) of clusters of draws (S, m), and what makes the spread within them the identity, (m, m).

    Clusters without draws are left out.
    """
    for _ in range(ROUNDS):
        nearest = _assign(draws @ whiten, centres @ whiten)
        counts = np.bincount(nearest, minlength=len(centres))
        kept = np.flatnonzero(counts > 0)
        means = np.stack([draws[nearest == k].mean(axis=0) for k in kept])
        within = np.concatenate([draws[nearest == k] - mean for k, mean in zip(kept, means, strict=True)])
        sd = within.std(axis=0)
        sd = np.where(sd > 0.0, sd, 1.0)
        values, vectors = np.linalg.eigh(np.atleast_2d(within.T @ within / len(within)) / np.outer(sd, sd))
        whiten = vectors / np.sqrt(np.maximum(values, 1e-9)) / sd[:, None]
        centres = means
    return centres, whiten


def _join(points: Array, centres: Array) -> np.ndarray:
    """Return to which group each cluster (M,) belongs: clusters without a valley between them are one."""
    group = np.arange(len(centres))
    nearest = _assign(points, centres)
    for one, other in combinations(range(len(centres)), 2):
        if group[one] != group[other] and not _is_apart(points, centres, nearest, one, other):
            group[group == group[other]] = group[one]
    return np.unique(group, return_inverse=True)[1]


def _is_apart(points: Array, centres: Array, nearest: np.ndarray, one: int, other: int) -> bool:
    """Whether two clusters are far apart, and the density along the line through their means has a valley."""
    across = centres[other] - centres[one]
    if np.linalg.norm(across) < MIN_DISTANCE:  # a few draws in a tail are no peak
        return False
    mine = points[np.isin(nearest, (one, other))]
    place = (mine - centres[one]) @ across / (across @ across)
    bins = np.histogram(place, np.linspace(-0.5, 1.5, 2 * N_BINS + 1))[0].astype(np.float64)
    half = N_BINS // 2
    first, between, last = bins[: 2 * half], bins[half : 3 * half], bins[2 * half :]
    return bool(between[1:-1].min() < VALLEY * min(first.max(), last.max()))
