"""Posteriors of machines known by their readings alone, as ArviZ trees.

Nobody knows the poses, so that a reading by itself predicts nothing; what machines and noise predict is how far the
readings of a pose contradict each other. The number of a pose is how far they do so at the machine as expected: in the
readings' own space, without what any pose would explain there.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

import numpy as np

from bayescal.density.calibration.whitening import WhiteResiduals
from bayescal.experiments.shared.trees import Draws, Replicated, build_tree
from bayescal.numerics.geometry import Array

if TYPE_CHECKING:
    import xarray as xr

NAME, UNIT = "readings", "1"
MEANING = (
    "how far a pose's readings contradict each other at the machine as expected, in standard deviations of the noise"
)
N_PRIOR = 300
BATCH = 100


class ReadingPosterior(Protocol):
    """A posterior in coordinates that are independent under the prior."""

    @property
    def n_parameters(self) -> int:
        """Number n of coordinates."""

    def natural(self, y: Array) -> Array:
        """Return the parameters in their own units, each a function of its own coordinate, (..., n) to (..., n)."""

    def draw_prior(self, n_draws: int, rng: np.random.Generator) -> Array:
        """Return draws of the prior in the coordinates, shape (n_draws, n)."""

    def log_coordinates(self, y: Array) -> Array:
        """Return the log-prior of each coordinate, (..., n)."""

    def log_parameters(self, y: Array) -> Array:
        """Return the log-prior of each parameter in its own unit, (..., n)."""

    def pointwise(self, y: Array) -> Array:
        """Return the log-likelihood of each pose's readings, (B, n) to (B, P)."""

    def residuals(self, y: Array) -> WhiteResiduals:
        """Return the residuals of the best poses at coordinates (B, n)."""


@dataclass(frozen=True, eq=False)
class SavedDraws:
    """Draws of a posterior and of its prior, with what they predict, as `Draws` and `Replicated` have them."""

    posterior: Array
    log_density: Array
    log_prior: Array
    prior: Array
    log_likelihood: Array
    observed: Array
    replicated: Array
    prior_replicated: Array


def save_draws(
    posterior: ReadingPosterior, kept: Array, n_total: int, n_chains: int, seed: Sequence[int]
) -> SavedDraws:
    """Return everything a posterior's tree needs.

    Parameters
    ----------
    posterior : ReadingPosterior
    kept : ndarray, shape (T, n)
        Coordinates, evenly spread over all draws with chains laid end to end.
    n_total, n_chains : int
        How many draws there are of all chains, and how many chains.
    seed : sequence of int
    """
    rng = np.random.default_rng(list(seed))
    chains = _split_chains(kept, n_total, n_chains)
    flat = chains.reshape(-1, kept.shape[-1])
    expected = posterior.residuals(np.zeros((1, posterior.n_parameters)))
    prior = posterior.draw_prior(N_PRIOR, rng)
    with np.errstate(all="ignore"):
        predicted = _replicate(posterior, expected, prior, rng)
    stands = np.isfinite(predicted).all(axis=1)
    density = posterior.pointwise(flat)
    shape = chains.shape[:2]
    log_prior = posterior.log_coordinates(flat)
    return SavedDraws(
        posterior=posterior.natural(chains),
        log_density=(density.sum(axis=1) + log_prior.sum(axis=1)).reshape(shape),
        log_prior=posterior.log_parameters(flat).reshape(chains.shape),
        prior=posterior.natural(prior[stands]),
        log_likelihood=density.reshape(*shape, -1),
        observed=expected.measure(expected.error[0]),
        replicated=_replicate(posterior, expected, flat, rng).reshape(*shape, -1).astype(np.float32),
        prior_replicated=predicted[stands].astype(np.float32),
    )


def _split_chains(kept: Array, n_total: int, n_chains: int) -> Array:
    """Return draws by chains, shape (E, S, n), as many of each."""
    chain = np.linspace(0, n_total - 1, len(kept)).astype(int) * n_chains // n_total
    shortest = min(int(np.sum(chain == k)) for k in range(n_chains))
    return np.stack([kept[chain == k][:shortest] for k in range(n_chains)])


def _replicate(posterior: ReadingPosterior, expected: WhiteResiduals, y: Array, rng: np.random.Generator) -> Array:
    """Return the numbers of the poses (B, P) had draws (B, n) been the truth and the readings been taken again."""
    found = []
    for start in range(0, len(y), BATCH):
        there = posterior.residuals(y[start : start + BATCH])
        white = there.draw_noise(rng) - there.error
        moved = expected.remove_poses(expected.whiten(there.colour(white)))
        found.append(expected.measure(expected.error + moved))
    return np.concatenate(found)


def build_reading_tree(
    saved: SavedDraws, names: Sequence[str], units: Sequence[str], poses: Sequence[str], variant: str
) -> xr.DataTree:
    """Return a variant's posterior with draws of its prior, what both predict, and the data."""
    draws = Draws(names, units, saved.posterior, saved.log_density, saved.log_prior, saved.prior)
    numbers = saved.observed, saved.replicated, saved.prior_replicated, saved.log_likelihood
    return build_tree(draws, Replicated(NAME, UNIT, MEANING, *numbers), poses, {}, variant=variant)
