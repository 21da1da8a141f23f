"""Finding a proposal that is nearly the posterior: Laplace, then sharpened peaks, then pilot runs where needed.

Everything after this stage (ensembles, both evidences) is right in the limit of many draws whatever the proposal. With
a poor one that limit is far: the chains may look converged and shift the bridge, which only the importance sampler
then shows.

Posts on either side of a line need moments of their own for several modes: without them the evidence is 0.83 nats low,
unreported. Tails and bends that nothing declares need clusters of pilots' draws, an arm beside the default model error
the components with one error wider, for half the time (`benchmarks/ablation`). The Hangprinter's outliers of any size
(`robust`) need what follows where peaks are not enough: without pilots and adaptation 0.2 instead of 11 % of the draws
count, and it does not converge.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from bayescal.errors import NumericalError
from bayescal.inference.adaptation import adapt_proposal
from bayescal.inference.conditional import fit_conditional
from bayescal.inference.ensemble import run_ensemble
from bayescal.inference.importance import ImportanceEvidence, estimate_by_importance, resample
from bayescal.inference.loose import fit_loose_shear
from bayescal.inference.mode import Mode, find_modes, revisit_modes
from bayescal.inference.peaks import GaussianMode, bend_at, proposal_from_peaks, refine_peak
from bayescal.inference.proposal import MixtureProposal, fit_mixture, proposal_from_draws
from bayescal.inference.reparameterisation import Reparameterisation, straighten
from bayescal.inference.ridges import trace_ridges
from bayescal.inference.schema import EvidenceConfig, count_walkers
from bayescal.inference.stages import stage
from bayescal.inference.target import LogDensity
from bayescal.numerics.geometry import Array

DOF = 50.0
GOOD_ENOUGH = 0.5  # no sharper peak is tried
ACCEPTABLE = 0.2  # no mixture is fitted to weighted draws
MAX_ROUNDS = 2
REFINE_WITHIN_NAT = 6.0  # a mode this many nats below the best is left as it is: a quarter of a percent of the mass
MAX_REFINEMENT_LOSS_NAT = (
    3.0  # nats that a lesser mode's mass may lose when it is sharpened; beyond, the steps went astray
)
MIN_MEANINGFUL_EFFICIENCY = (
    0.02  # below it a trial's efficiency is mostly chance, and the later proposal is the better guess
)
TRIAL_DRAWS = 2000
FIRST_DRAWS, HOPELESS = 256, 0.05  # of a trial, and what they may show for it to end with them
FINE_DRAWS, FINE_ENOUGH = 64, 0.9  # draws, and what share of them has to count by the density that leaves nothing out
CORRECTABLE = 0.05  # the same where draws are moved and weighed by that density afterwards
WIDE_SHARE, WIDE = 0.15, 4.0
"""Share of a proposal by a conditional map in which one of the errors is as many times as wide, each in turn: an error
that another one makes up for has a shoulder, far out along its own coordinate alone."""
CONDITIONAL_DOF = 100.0  # of the same: geometry given the errors has next to no tails
OWN_SHARE, CLUSTER_DOF = 0.2, 6.0  # of the proposal so far beside clusters of a pilot's draws, and their tails
WORTH_PILOTS = 0.1  # efficiency below which chains run, whose few walkers take longer than all else
PILOT_STEPS = 100
PILOT_BURN_IN = 40
MAX_PILOTS, PATIENCE = 6, 1
"""Pilots at the most, and after how many in turn without a better proposal there is no other."""


@dataclass(frozen=True, eq=False)
class Exploration:
    """What exploring a posterior found.

    Attributes
    ----------
    straight : Straightening
        Coordinates in which the proposal lives.
    proposal : MixtureProposal
        Nearly the posterior.
    modes : list of Mode
        Best first.
    efficiency : float
        Importance sampling efficiency of the proposal, from a short trial.
    left_out : float
        By how much the posterior's finer density differs, nats: shift of the evidence and scatter over draws, rms; 0
        where it has none.
    """

    straight: Reparameterisation
    proposal: MixtureProposal
    modes: list[Mode]
    efficiency: float
    left_out: float = 0.0


def explore(
    posterior: LogDensity,
    seed: np.random.SeedSequence,
    n_walkers: int = 128,
    max_pilots: int = MAX_PILOTS,
    *,
    from_prior: bool = False,
    fine_enough: float = FINE_ENOUGH,
) -> Exploration:
    """Find the modes, straighten the coordinates and fit a proposal.

    Laplace's approximation first. Curved ridges are traced to their ends: how long they are no trial of a Gaussian
    shows. Where a trial shows that it is not good, what data hold follows what is loose; where it is not good enough,
    peaks refined over a posterior sd in coordinates bent to fit, twice; then pilot runs. Where what the density leaves
    out matters to draws of the posterior, all of it is done again with the posterior's finer density, unless a share
    ``fine_enough`` of them counts by that: less is enough where what was found is corrected. With ``from_prior`` the
    search for modes begins from draws of the prior, too.

    Raises
    ------
    NumericalError
        Where no mode is found or no proposal draw has a finite density.
    """
    with stage("mode search"):
        modes = find_modes(posterior, np.random.default_rng(seed.generate_state(4)) if from_prior else None)
    with stage("proposal"):
        found = _fit_proposal(modes, posterior, seed, n_walkers, max_pilots, GOOD_ENOUGH, trace=True)
        share, left_out = _look_finer(found, seed)
    if share < fine_enough:
        return explore(_refine(posterior), seed, n_walkers, max_pilots, from_prior=from_prior)
    return replace(found, left_out=left_out)


def explore_near(
    posterior: LogDensity,
    starts: Array,
    seed: np.random.SeedSequence,
    n_walkers: int = 128,
    known: Sequence[Mode] = (),
    *,
    enough: float = ACCEPTABLE,
    fine_enough: float = FINE_ENOUGH,
    max_pilots: int = MAX_PILOTS,
) -> Exploration:
    """Find a proposal that is good enough for an evidence alone, of a posterior close to one that was explored.

    Parameters
    ----------
    posterior : Target
    starts : ndarray, shape (M, n)
        Where its modes are about.
    seed : SeedSequence
    n_walkers : int
    known : sequence of Mode
        Modes that it has.
    enough : float
        Efficiency from which on a proposal is not sharpened.
    fine_enough, max_pilots
        See `explore`.

    Raises
    ------
    NumericalError
        As `explore`.
    """
    with stage("mode search"):
        modes = revisit_modes(posterior, starts, known)
    with stage("proposal"):
        found = _fit_proposal(modes, posterior, seed, n_walkers, max_pilots, enough)
        share, left_out = _look_finer(found, seed)
    if share < fine_enough:  # the modes move a little, and there are no others
        starts = np.stack([mode.y for mode in modes])
        return explore_near(_refine(posterior), starts, seed, n_walkers, enough=enough, max_pilots=max_pilots)
    return replace(found, left_out=left_out)


def _refine(posterior: LogDensity) -> LogDensity:
    """Return a posterior's finer density, which it has."""
    finer = posterior.exact()
    assert finer is not None
    return finer


def _fit_proposal(
    modes: list[Mode],
    posterior: LogDensity,
    seed: np.random.SeedSequence,
    n_walkers: int,
    max_pilots: int,
    enough: float,
    *,
    trace: bool = False,
) -> Exploration:
    """Straighten the coordinates around known modes and fit a proposal; it is sharpened until it is good enough.

    With ``trace`` ridges are traced however good it is, and what is loose is followed until it is good.
    """
    trial_seed, *pilot_seeds = seed.spawn(1 + MAX_PILOTS)
    trial_rng = np.random.default_rng(trial_seed)
    straight = straighten(posterior, modes[0])
    if straight.conditional is not None and (several := _propose_several(straight, modes, seed)) is not None:
        return several
    peaks = [_peak_in(straight, mode) for mode in modes]
    if straight.conditional is not None:  # nothing sharper is known than geometry given the errors in closed form
        peaks[0], enough = _peak_of_errors(straight), min(enough, ACCEPTABLE)
    best = _try_peaks(straight, peaks, modes, trial_rng)
    if best.efficiency < (GOOD_ENOUGH if trace else enough):
        best = _follow_loose(best, seed)
        straight = best.straight
    if best.efficiency < enough and (exact := straight.exactly()) is not None:
        found = _try_peaks(exact, [_peak_of_errors(exact), *peaks[1:]], modes, trial_rng)
        straight, best = (exact, found) if found.efficiency > best.efficiency else (straight, best)
    if posterior.curved_ridges() and (trace or best.efficiency < enough):
        straight, peaks, best = _follow_ridges(best, enough, trial_rng)
    for _ in range(MAX_ROUNDS):
        if best.efficiency >= enough:
            return best
        straight, peaks = _sharpen(straight, peaks[0], modes)
        found = _try_peaks(straight, peaks, modes, trial_rng)
        best = found if found.efficiency > best.efficiency else best
    if best.efficiency < ACCEPTABLE and max_pilots:
        best = _adapt(best, seed)
    straight, proposal = best.straight, best.proposal
    walkers, stale = count_walkers(posterior.n_parameters, n_walkers), 0
    for pilot_seed in pilot_seeds[:max_pilots]:
        if best.efficiency >= WORTH_PILOTS or stale >= PATIENCE:
            break
        pilot = run_ensemble(straight.log_density, proposal, pilot_seed, walkers, PILOT_BURN_IN, PILOT_STEPS)
        draws = straight.y_from_x(pilot.draws.reshape(-1, posterior.n_parameters))
        straight = straight.fitted_to(draws)
        proposal = _refit(straight, straight.x_from_y(draws), modes)
        efficiency = _try_out(straight, proposal, trial_rng)
        stale = 0 if efficiency > best.efficiency else stale + 1
        if efficiency > best.efficiency or best.efficiency < MIN_MEANINGFUL_EFFICIENCY:
            best = Exploration(straight, proposal, modes, efficiency)
    return best


def _adapt(found: Exploration, seed: np.random.SeedSequence) -> Exploration:
    """Return an exploration whose proposal is fitted to weighted draws, where a trial shows that it is better."""
    rng = np.random.default_rng(seed.generate_state(8))
    adapted = adapt_proposal(found.straight, found.proposal, rng, ACCEPTABLE)
    if adapted is None or adapted.efficiency <= found.efficiency:
        return found
    efficiency = _try_out(found.straight, adapted.proposal, rng)
    better = replace(found, proposal=adapted.proposal, efficiency=efficiency)
    return better if efficiency > found.efficiency else found


def _look_finer(found: Exploration, seed: np.random.SeedSequence) -> tuple[float, float]:
    """Return which share of the posterior's draws counts by a finer density, and by how much that differs."""
    finer = found.straight.posterior.exact()
    return (1.0, 0.0) if finer is None else _compare(found, finer, np.random.default_rng(seed.generate_state(5)))


def _compare(found: Exploration, finer: LogDensity, rng: np.random.Generator) -> tuple[float, float]:
    density, proposal = found.straight.log_density, found.proposal
    if found.efficiency < ACCEPTABLE:  # of so few draws hardly one would count
        try:
            x = resample(density, proposal, rng, TRIAL_DRAWS, FINE_DRAWS).draws
        except NumericalError:
            return 1.0, 0.0
        log_weights = np.zeros(len(x))
    else:
        x = proposal.draw(FINE_DRAWS, rng)
        log_weights = density(x) - proposal.log_density(x)
    y = found.straight.y_from_x(x)
    known = np.isfinite(log_weights)
    change = finer.log_density(y[known]) - found.straight.posterior.log_density(y[known])
    good = np.isfinite(change)
    if not good.any():
        return (0.0, np.inf) if known.any() else (1.0, 0.0)
    weights, ratio = np.exp(log_weights[known] - log_weights[known].max()), np.exp(change - change[good].max())
    mean, square = np.average(ratio, weights=weights), np.average(ratio**2, weights=weights)
    share = float(mean**2 / square)
    return share, float(np.hypot(np.log(mean) + change[good].max(), np.sqrt(1.0 / share - 1.0)))


def add_clusters(found: Exploration, seed: np.random.SeedSequence, n_walkers: int = 128) -> Exploration:
    """Return an exploration whose proposal has clusters of a pilot's draws beside its own components.

    For weights with a heavy tail: what no Gaussian describes in any of the coordinates, a bent ridge or a corner,
    several may.
    """
    pilot_seed, fit_seed = seed.spawn(2)
    rng, straight, own = np.random.default_rng(fit_seed), found.straight, found.proposal
    walkers = count_walkers(straight.posterior.n_parameters, n_walkers)
    pilot = run_ensemble(straight.log_density, own, pilot_seed, walkers, PILOT_BURN_IN, PILOT_STEPS)
    x = pilot.draws.reshape(-1, straight.posterior.n_parameters)
    walker = np.arange(len(x)) // PILOT_STEPS
    clusters = fit_mixture(x, np.full(len(x), 1.0 / len(x)), walker % 2 == 0, rng)
    proposal = MixtureProposal(
        np.concatenate([OWN_SHARE * own.weights, (1.0 - OWN_SHARE) * clusters.weights]),
        np.concatenate([own.means, clusters.means]),
        np.concatenate([own.factors, clusters.factors]),
        CLUSTER_DOF,
    )
    return Exploration(straight, proposal, found.modes, _try_out(straight, proposal, rng))


def weigh_proposal(found: Exploration, seed: np.random.SeedSequence, effort: EvidenceConfig) -> ImportanceEvidence:
    """Return the log-evidence by importance sampling from an exploration's proposal."""
    density, rng = found.straight.log_density, np.random.default_rng(seed)
    return estimate_by_importance(density, found.proposal, rng, effort.draws, effort.tolerance_nat, effort.max_draws)


def integrate_posterior(
    posterior: LogDensity,
    explore_seed: np.random.SeedSequence,
    importance_seed: np.random.SeedSequence,
    n_walkers: int,
    effort: EvidenceConfig,
    fine_enough: float = FINE_ENOUGH,
) -> tuple[Exploration, ImportanceEvidence]:
    """Return what a search from the beginning finds, and its log-evidence: by clusters where weights are unreliable.

    Raises
    ------
    NumericalError
        As `explore`.
    """
    found = explore(posterior, explore_seed, n_walkers, from_prior=True, fine_enough=fine_enough)
    importance = weigh_proposal(found, importance_seed, effort)
    if importance.is_doubtful:
        other = add_clusters(found, explore_seed, n_walkers)
        again = weigh_proposal(other, importance_seed, effort)
        if again.is_better_than(importance):
            return other, again
    return found, importance


def _propose_several(
    straight: Reparameterisation, modes: list[Mode], seed: np.random.SeedSequence
) -> Exploration | None:
    """Return a proposal with the moments of every mode that holds mass; None where one does, or it is not good enough.

    Geometry that is straight about one mode given the errors moves with their size at any other, by many times its own
    width: a peak there is no Gaussian in these coordinates, and the modes' shares would be anything.
    """
    worth = [mode for mode in modes if mode.log_evidence > modes[0].log_evidence - REFINE_WITHIN_NAT]
    if len(worth) < 2:
        return None
    posterior, m, nothing = straight.posterior, straight.posterior.n_geometry, np.empty(0)
    plain = Reparameterisation(posterior, modes[0].y, (), nothing, nothing, bend=straight.bend)
    assert plain.bend is not None
    peaks = []
    for mode in worth:
        conditional = fit_conditional(posterior, mode.y)
        if conditional is None:
            return None
        mean, own = conditional.exact.geometry.given(conditional.errors)
        x = np.concatenate([mean, plain.bend.inverse(conditional.errors)], axis=1)
        covariance = np.cov(x.T)
        covariance[:m, :m] += own.mean(axis=0)
        factor = np.linalg.cholesky(covariance)
        # modes know equally much of the errors: their masses compare as they do at the most probable ones
        log_density = mode.log_evidence - float(np.log(np.diag(factor)).sum())
        peaks.append(GaussianMode(x.mean(axis=0), factor, log_density))
    proposal = proposal_from_peaks(peaks, CLUSTER_DOF)
    efficiency = _try_out(plain, proposal, np.random.default_rng(seed.generate_state(7)))
    return Exploration(plain, proposal, modes, efficiency) if efficiency >= ACCEPTABLE else None


def _peak_in(straight: Reparameterisation, mode: Mode, *, follow: bool = True) -> GaussianMode:
    """Return a mode as a peak in straight coordinates; see `Reparameterisation.carry`."""
    centre = straight.x_from_y(mode.y[None])
    factor = np.linalg.cholesky(straight.carry(mode.y, mode.covariance, follow=follow))
    return GaussianMode(centre[0], factor, float(straight.log_density(centre)[0]))


def _peak_of_errors(straight: Reparameterisation) -> GaussianMode:
    """Return the main peak where geometry given the errors is standard normal: the errors' from their draws."""
    assert straight.conditional is not None
    assert straight.bend is not None
    n, m = straight.posterior.n_parameters, straight.posterior.n_geometry
    errors = straight.bend.inverse(straight.conditional.errors)
    centre, factor = np.zeros(n), np.eye(n)
    centre[m:], factor[m:, m:] = errors.mean(axis=0), np.linalg.cholesky(np.atleast_2d(np.cov(errors.T)))
    return GaussianMode(centre, factor, float(straight.log_density(centre[None])[0]))


def _try_peaks(
    straight: Reparameterisation, peaks: list[GaussianMode], modes: list[Mode], rng: np.random.Generator
) -> Exploration:
    proposal = (
        proposal_from_peaks(peaks, DOF) if straight.conditional is None else _propose_conditionally(straight, peaks)
    )
    return Exploration(straight, proposal, modes, _try_out(straight, proposal, rng))


def _propose_conditionally(straight: Reparameterisation, peaks: list[GaussianMode]) -> MixtureProposal:
    """Return the mixture over peaks, beside the main one the same with one error wider, for each of them."""
    found, main = proposal_from_peaks(peaks, CONDITIONAL_DOF), peaks[0]
    n, m = straight.posterior.n_parameters, straight.posterior.n_geometry
    covariance = np.tile(main.factor @ main.factor.T, (n - m, 1, 1))
    covariance[np.arange(n - m), np.arange(m, n), np.arange(m, n)] *= WIDE**2
    wide = np.full(n - m, WIDE_SHARE * found.weights[0] / (n - m))
    weights = np.append(found.weights, wide)
    weights[0] *= 1.0 - WIDE_SHARE
    means = np.concatenate([found.means, np.tile(main.centre, (n - m, 1))])
    factors = np.concatenate([found.factors, np.linalg.cholesky(covariance)])
    return MixtureProposal(weights, means, factors, CONDITIONAL_DOF)


def _sharpen(
    straight: Reparameterisation, main: GaussianMode, modes: list[Mode]
) -> tuple[Reparameterisation, list[GaussianMode]]:
    """Fit the coordinates to the main peak, then all peaks in them; a peak that climbs into another is dropped.

    Coordinates that are straight at the best mode may be anything at another: what cannot be refined there is two
    peaks, with and without how the geometry follows the model errors.
    """
    straight, main = bend_at(straight, main)
    main = refine_peak(straight.log_density, main)
    peaks = [main]
    for mode in modes[1:]:
        start = _peak_in(straight, mode, follow=False)
        worth = mode.log_evidence > modes[0].log_evidence - REFINE_WITHIN_NAT
        found = refine_peak(straight.log_density, start) if worth else start
        if found is start or found.log_evidence < start.log_evidence - MAX_REFINEMENT_LOSS_NAT:
            peaks += [start, _peak_in(straight, mode)]
        elif all(np.linalg.norm(np.linalg.solve(p.factor, found.centre - p.centre)) > 1.0 for p in peaks):
            peaks.append(found)
    return straight, peaks


def _follow_loose(found: Exploration, seed: np.random.SeedSequence) -> Exploration:
    """Return an exploration in which what data hold follows what they leave loose, where that is better.

    Its trial has random numbers of its own: where it is not, all goes on as without it.
    """
    straight, modes = found.straight, found.modes
    if straight.posterior.curved_ridges():
        return found
    shear = fit_loose_shear(straight.posterior, modes[0].y)
    if shear is None:
        return found
    straight = replace(straight, loose=shear)
    peaks = [_peak_in(straight, mode) for mode in modes]
    if straight.conditional is not None:
        peaks[0] = _peak_of_errors(straight)
    other = _try_peaks(straight, peaks, modes, np.random.default_rng(seed.generate_state(6)))
    return other if other.efficiency > found.efficiency else found


def _follow_ridges(
    found: Exploration, enough: float, rng: np.random.Generator
) -> tuple[Reparameterisation, list[GaussianMode], Exploration]:
    """Return coordinates in which curved ridges are straight as far as they go, the peaks there, and what is best.

    That is what they give where they are good enough: another's trial does not know of tails that it does not get to.
    """
    modes = found.modes
    straight = trace_ridges(found.straight, modes)
    peaks = [_peak_in(straight, mode) for mode in modes]
    if straight.ridges is None:
        return straight, peaks, found
    if straight.conditional is None:
        straight, peaks = _sharpen(straight, peaks[0], modes)
    else:
        peaks[0] = _peak_of_errors(straight)
    traced = _try_peaks(straight, peaks, modes, rng)
    return straight, peaks, traced if traced.efficiency >= min(enough, found.efficiency) else found


def _try_out(straight: Reparameterisation, proposal: MixtureProposal, rng: np.random.Generator) -> float:
    """Return the efficiency of a proposal; a few draws show one that is far from good."""
    efficiency = 0.0
    for n_draws in (FIRST_DRAWS, TRIAL_DRAWS):
        try:
            efficiency = estimate_by_importance(straight.log_density, proposal, rng, n_draws).efficiency
        except NumericalError:
            return 0.0
        if efficiency < HOPELESS:
            break
    return efficiency


def _refit(straight: Reparameterisation, draws: Array, modes: list[Mode]) -> MixtureProposal:
    """Return a mixture with the moments of the draws (B, n) around each mode.

    A mode with too few draws for a covariance, or whose walkers all stand still along some direction, keeps Laplace's
    approximation, with the weight its evidence gives it.
    """
    n = draws.shape[1]
    start = proposal_from_peaks([_peak_in(straight, mode) for mode in modes], DOF)
    if len(modes) == 1:
        return proposal_from_draws(draws, DOF) if _is_spread(draws) else start
    nearest = np.argmax(start.component_log_densities(draws), axis=0)
    means, factors, weights = start.means.copy(), start.factors.copy(), start.weights.copy()
    for k in range(len(modes)):
        own = draws[nearest == k]
        if len(own) > 20 * n and _is_spread(own):
            part = proposal_from_draws(own, DOF)
            means[k], factors[k] = part.means[0], part.factors[0]
            weights[k] = max(weights[k], len(own) / len(draws))
    return MixtureProposal(weights / weights.sum(), means, factors, DOF)


def _is_spread(draws: Array) -> bool:
    """Return whether draws (B, n) have a covariance that is definite."""
    try:
        np.linalg.cholesky(np.atleast_2d(np.cov(draws.T)))
    except np.linalg.LinAlgError:
        return False
    return True
