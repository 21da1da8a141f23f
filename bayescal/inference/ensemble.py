"""Posterior draws by ensembles that mix jumps of a global proposal with differential evolution, as emcee mixes moves.

An ensemble's walkers depend on each other, so a walker is not a chain: the chains of every diagnostic are the
ensembles. The draws of an ensemble are ordered walker by walker, in time within a walker, so that autocorrelation seen
along the chain is that of the walkers.

Ensembles walk abreast: what all of them propose is evaluated at once, since a density of few vectors takes hardly less
time than one of many. Each has random numbers of its own, and its draws are those that emcee finds alone from these.
"""

from __future__ import annotations

from collections.abc import Callable, Generator, Sequence
from dataclasses import dataclass

import numpy as np

from bayescal.errors import NumericalError
from bayescal.inference.importance import LogDensity, evaluate_in_batches
from bayescal.inference.proposal import MixtureProposal
from bayescal.numerics.geometry import Array

type Draw = Callable[[int, np.random.Generator], Array]

JUMP_SHARE = 0.7  # of moves
TRIES = 50  # at placing the walkers


@dataclass(frozen=True, eq=False)
class Ensemble:
    """Draws of one ensemble."""

    draws: Array  # (walkers, steps, n): in sampling coordinates, after burn-in
    log_density: Array  # (walkers, steps)
    acceptance: float  # share of accepted moves


def run_ensemble(
    log_density: LogDensity,
    proposal: MixtureProposal,
    seed: np.random.SeedSequence,
    n_walkers: int,
    n_burn_in: int,
    n_steps: int,
    starts: Draw | None = None,
) -> Ensemble:
    """Run one ensemble that starts at draws of the proposal, or at those of ``starts``.

    Raises
    ------
    NumericalError
        Where walkers cannot be placed or the density is NaN.
    """
    own = () if starts is None else (starts,)
    return run_ensembles(log_density, proposal, [seed], n_walkers, n_burn_in, n_steps, own)[0]


def run_ensembles(
    log_density: LogDensity,
    proposal: MixtureProposal,
    seeds: Sequence[np.random.SeedSequence],
    n_walkers: int,
    n_burn_in: int,
    n_steps: int,
    starts: Sequence[Draw] = (),
    jump_share: float = JUMP_SHARE,
) -> list[Ensemble]:
    """Run an ensemble from each seed, abreast; that share of moves are jumps, the others differential evolution.

    They start at draws of the proposal, or each at those of its own ``starts``.
    """
    draws = starts or [proposal.draw] * len(seeds)
    pairs = zip(draws, seeds, strict=True)
    walks = [_Walkers(proposal, draw, jump_share, seed).walk(n_walkers, n_burn_in, n_steps) for draw, seed in pairs]
    found: dict[int, Ensemble] = {}
    asked = {k: next(walk) for k, walk in enumerate(walks)}
    while asked:
        densities = evaluate_in_batches(log_density, np.concatenate(list(asked.values())))
        ends = np.cumsum([len(points) for points in asked.values()])
        for k, own in zip(list(asked), np.split(densities, ends[:-1]), strict=True):
            try:
                asked[k] = walks[k].send(own)
            except StopIteration as stop:
                found[k] = stop.value
                del asked[k]
    return [found[k] for k in range(len(walks))]


type Walk[Result] = Generator[Array, Array, Result]
"""Yields points (B, n), is sent their log-densities (B,), and returns what it found."""


class _Walkers:
    """The walkers of one ensemble; its random numbers are drawn in the order in which emcee draws them."""

    def __init__(self, proposal: MixtureProposal, draw: Draw, jump_share: float, seed: np.random.SeedSequence) -> None:
        from emcee.moves import DEMove  # a second to import, for those who sample

        seed_start, seed_moves = seed.spawn(2)
        self._proposal, self._draw, self._shares = proposal, draw, [jump_share, 1.0 - jump_share]
        self._start_rng = np.random.default_rng(seed_start)
        self._random = np.random.RandomState(seed_moves.generate_state(8))
        self._evolution = DEMove()
        self._proposed: Array | None = None  # log-densities of the proposal where the walkers stand, while known

    def walk(self, n_walkers: int, n_burn_in: int, n_steps: int) -> Walk[Ensemble]:
        """Place the walkers, burn in and keep what follows."""
        self._points, self._density = yield from self._place(n_walkers)
        self._check_spread()
        for _ in range(n_burn_in):
            yield from self._move()
        self._check_spread()
        draws, density = np.empty((n_walkers, n_steps, self._points.shape[1])), np.empty((n_walkers, n_steps))
        n_accepted = 0
        for step in range(n_steps):
            n_accepted += yield from self._move()
            draws[:, step], density[:, step] = self._points, self._density
        return Ensemble(draws, density, n_accepted / (n_walkers * n_steps))

    def _place(self, n: int) -> Walk[tuple[Array, Array]]:
        """Return n draws with finite density, shape (n, n_parameters), and their densities."""
        points: list[Array] = []
        densities: list[Array] = []
        for _ in range(TRIES):
            draws = self._draw(n, self._start_rng)
            density = yield draws
            good = np.isfinite(density)
            points.extend(draws[good])
            densities.extend(density[good])
            if len(points) >= n:
                return np.stack(points[:n]), np.stack(densities[:n])
        raise NumericalError(f"sampling: {len(points)} of {n} walkers have a finite start")

    def _check_spread(self) -> None:
        """Raise NumericalError where the walkers lie in a plane, which differential evolution does not leave."""
        from emcee.ensemble import walkers_independent

        n_walkers, n = self._points.shape
        if n_walkers < 2 * n or not walkers_independent(self._points):
            raise NumericalError(f"sampling: {n_walkers} walkers do not span {n} coordinates")

    def _move(self) -> Walk[int]:
        """Move all walkers once, and return how many moved."""
        if self._random.choice(2, p=self._shares) == 0:
            return (yield from self._jump())
        return (yield from self._evolve())

    def _jump(self) -> Walk[int]:
        own = np.random.default_rng(self._random.randint(2**32, size=4, dtype=np.uint64))
        drawn = self._proposal.draw(len(self._points), own)
        density = yield drawn
        before = self._proposal.log_density(self._points) if self._proposed is None else self._proposed
        after = self._proposal.log_density(drawn)
        gain = density - self._density + (before - after)
        accepted = self._accept(np.arange(len(drawn)), drawn, density, gain)
        self._proposed = np.where(accepted, after, before)
        return int(accepted.sum())

    def _evolve(self) -> Walk[int]:
        """Move either half of the walkers by the other half."""
        half = np.arange(len(self._points)) % 2
        self._random.shuffle(half)
        self._evolution.setup(self._points)
        n_accepted = 0
        for k in (0, 1):
            own = np.flatnonzero(half == k)
            drawn, factors = self._evolution.get_proposal(self._points[own], [self._points[half != k]], self._random)
            density = yield drawn
            n_accepted += int(self._accept(own, drawn, density, density - self._density[own] + factors).sum())
        self._proposed = None
        return n_accepted

    def _accept(self, own: np.ndarray, drawn: Array, density: Array, gain: Array) -> np.ndarray:
        """Take some walkers, by their places, to what was drawn for them where that is accepted; return which were."""
        if not np.all(density < np.inf):
            raise NumericalError("sampling: log-density not finite")
        accepted = np.log(self._random.rand(len(own))) < gain
        moved = own[accepted]
        self._points[moved], self._density[moved] = drawn[accepted], density[accepted]
        return np.asarray(accepted)
