"""Effective draws per second of bayescal's sampler and of emcee's default stretch move, for each kinematic model.

    python benchmarks/stretch.py [--models six_pus jacobian beam stiffness] [--deformation matrix] [--seconds 60]

The telescope study's own data with every parameter free (experiments/telescope/ridges.toml), the model error of each
leg too. The stretch move works on the same density in plain coordinates: the parameters themselves and the logarithms
of the model errors. It starts at draws of bayescal's posterior, so that it needs no burn-in, and only its sampling is
timed; bayescal's time is everything: exploration, burn-in and four ensembles. One core.

bayescal's figure is its smallest bulk effective sample size over the natural parameters, chains are ensembles. For the
stretch move that figure would count its starting draws, which are independent, over and over. Its effective draws
follow from the autocorrelation of its walkers about the known mean and variance, summed to half the run without a tail:
the time is at least so long, the effective draws are at most so many, and the ratio is at least the one printed.
"""

# ruff: noqa: I001 - telescope_problem comes before NumPy: it sets the number of threads
from __future__ import annotations

import argparse
import time

from telescope_problem import TELESCOPE, write_results

import emcee
import numpy as np
from scipy.special import ndtri
from scipy.stats import halfnorm

from bayescal import load_experiment, load_inputs
from bayescal.numerics.geometry import Array
from bayescal.inference.diagnostics import diagnose
from bayescal.inference.exploration import explore
from bayescal.inference.sampling import sample_posterior
from bayescal.density.legs import LegPosterior

N_ENSEMBLES, N_WALKERS, N_BURN_IN, N_STEPS = 4, 128, 20, 40  # the study's
SEED = 20261121
AGREEMENT = 1e-6
CHUNK = 50


class PlainDensity:
    """The same posterior over the parameters in units of their prior sds and the logarithms of τ in mm."""

    def __init__(self, posterior: LegPosterior) -> None:
        self._posterior, self._n = posterior, posterior.n_geometry
        priors = list(posterior.all_priors().values())[: self._n]
        self._centre, self._sd = (np.array([getattr(p, name) for p in priors]) for name in ("mean", "sd"))
        self._scale = posterior.errors.model_error.scale

    def from_natural(self, natural: Array) -> Array:
        """Return plain coordinates of natural parameters (B, n)."""
        geometry = (natural[:, : self._n] - self._centre) / self._sd
        return np.concatenate([geometry, np.log(natural[:, self._n :])], axis=1)

    def to_natural(self, plain: Array) -> Array:
        """Return natural parameters of plain coordinates (B, n)."""
        geometry = self._centre + self._sd * plain[:, : self._n]
        return np.concatenate([geometry, np.exp(plain[:, self._n :])], axis=1)

    def __call__(self, plain: Array) -> Array:
        """Return the log-density (B,), up to a constant; through the sampling coordinates and their volume."""
        posterior, natural = self._posterior, self.to_natural(plain)
        tau = natural[:, self._n :]
        theta = np.broadcast_to(posterior.sampling.start, (len(plain), len(posterior.sampling.start))).copy()
        theta[:, posterior.sampling.free] = natural[:, : self._n]
        total = posterior.likelihood(theta, tau) + halfnorm.logpdf(tau, scale=self._scale).sum(axis=1)
        total += plain[:, self._n :].sum(axis=1)
        normal = ~posterior.sampling.coordinates.bounded
        total -= 0.5 * np.sum(plain[:, : self._n][:, normal] ** 2, axis=1)
        low, high = posterior.sampling.coordinates.lower, posterior.sampling.coordinates.upper
        inside = np.all((natural[:, : self._n] > low) & (natural[:, : self._n] < high), axis=1)
        good = inside & posterior.sampling.layout.inside(theta) & np.isfinite(total)
        return np.where(good, total, -np.inf)


def measure(natural: Array, seconds: float) -> dict[str, float]:
    """Return the worst effective sample size and R-hat of draws (ensembles, walkers, steps, n), and the rate."""
    found = diagnose(natural)
    ess = float(found.ess_bulk.min())
    return {
        "min_bulk_ess": ess,
        "max_rhat": float(found.rhat.max()),
        "seconds": seconds,
        "ess_per_second": ess / seconds,
    }


def run_bayescal(posterior: LegPosterior) -> tuple[dict[str, float], Array]:
    """Return the figures of bayescal's sampler and its natural draws (ensembles, walkers, steps, n)."""
    start = time.perf_counter()
    found = explore(posterior, np.random.SeedSequence(SEED), N_WALKERS)
    seed = np.random.SeedSequence(SEED + 1)
    natural = sample_posterior(found, seed, N_ENSEMBLES, N_WALKERS, N_BURN_IN, N_STEPS).natural
    return measure(natural, time.perf_counter() - start), natural


def run_stretch(density: PlainDensity, starts: Array, mean: Array, sd: Array, seconds: float) -> dict[str, float]:
    """Return the figures of the stretch move on starts (ensembles, walkers, n), about so many seconds in all.

    ``mean`` and ``sd``, shape (n,), are those of the natural parameters under the posterior.
    """
    chains, spent = [], 0.0
    n_steps = None
    for k, start in enumerate(starts):
        sampler = emcee.EnsembleSampler(start.shape[0], start.shape[1], density, vectorize=True)
        state = emcee.State(start, random_state=np.random.RandomState(SEED + k).get_state())
        began = time.perf_counter()
        while True:
            state = sampler.run_mcmc(state, CHUNK, skip_initial_state_check=True)
            done = len(sampler.get_chain())
            if done == n_steps or (n_steps is None and time.perf_counter() - began > seconds / len(starts)):
                break
        n_steps = n_steps or done
        spent += time.perf_counter() - began
        chains.append(np.swapaxes(sampler.get_chain(), 0, 1))
    plain = np.stack(chains)
    natural = density.to_natural(plain.reshape(-1, plain.shape[-1])).reshape(plain.shape)
    times = sum_autocorrelation((natural.reshape(-1, *natural.shape[2:]) - mean) / sd)
    ess = natural.shape[0] * natural.shape[1] * natural.shape[2] / times.max()
    return {
        "ess_at_most": float(ess),
        "seconds": spent,
        "ess_per_second": float(ess / spent),
        "n_steps": float(plain.shape[2]),
        "autocorrelation_time_at_least": float(times.max()),
    }


def sum_autocorrelation(z: Array) -> Array:
    """Return 1 + 2 Σ ρ(t) up to half the run, shape (n,), of standardised chains (walkers, steps, n)."""
    n_steps = z.shape[1]
    size = 2 * n_steps
    power = np.zeros((size // 2 + 1, z.shape[2]))
    for walker in z:
        power += np.abs(np.fft.rfft(walker, size, axis=0)) ** 2
    correlation = np.fft.irfft(power, size, axis=0)[: n_steps // 2] / len(z)
    correlation /= (n_steps - np.arange(n_steps // 2))[:, None]
    return 1.0 + 2.0 * correlation[1:].sum(axis=0)


def check_same_density(posterior: LegPosterior, density: PlainDensity) -> None:
    """Compare differences of both densities near the mode, with the volumes of the coordinates taken out."""
    rng = np.random.default_rng(SEED)
    y = 0.05 * rng.standard_normal((20, posterior.n_parameters))
    y[:, posterior.n_geometry :] += ndtri(0.6)
    natural = posterior.natural(y)
    volume = posterior.sampling.coordinates.log_volume(posterior.theta(y))
    bounded = posterior.sampling.coordinates.bounded
    volume = volume - 0.5 * np.sum(y[:, : posterior.n_geometry][:, bounded] ** 2, axis=1)
    zeta, tau = y[:, posterior.n_geometry :], natural[:, posterior.n_geometry :]
    volume = volume + np.log(posterior.errors.model_error.prior.slope(zeta)).sum(axis=1)
    plain = density(density.from_natural(natural)) - np.log(tau).sum(axis=1)
    difference = posterior.log_density(y) - volume - plain
    if np.ptp(difference) > AGREEMENT * np.abs(plain).max():
        raise SystemExit(f"the two densities differ by {np.ptp(difference):.2e}")


def main() -> None:
    """Time both samplers on each model and write the figures."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--models", nargs="+", default=["six_pus", "jacobian", "beam", "stiffness"])
    parser.add_argument("--deformation", default="matrix")
    parser.add_argument("--seconds", type=float, default=60.0)
    arguments = parser.parse_args()
    path = TELESCOPE / "ridges.toml"
    inputs = load_inputs(load_experiment(path), path.parent)
    figures: dict[str, object] = {"deformation": arguments.deformation}
    print(f"{'model':12}{'n':>4}{'ESS/s':>10}{'stretch':>10}{'ratio':>8}   stretch move's autocorrelation time")
    with np.errstate(all="ignore"):
        for model in arguments.models:
            name = f"{model}/{arguments.deformation}"
            posterior = inputs.posterior(inputs.variant(name), with_model_error=True)
            density = PlainDensity(posterior)
            check_same_density(posterior, density)
            own, natural = run_bayescal(posterior)
            starts = np.stack([density.from_natural(chain[:, -1]) for chain in natural])
            flat = natural.reshape(-1, natural.shape[-1])
            other = run_stretch(density, starts, flat.mean(axis=0), flat.std(axis=0), arguments.seconds)
            ratio = own["ess_per_second"] / other["ess_per_second"]
            figures[name] = {"n_parameters": posterior.n_parameters, "bayescal": own, "stretch": other, "ratio": ratio}
            print(
                f"{model:12}{posterior.n_parameters:4d}{own['ess_per_second']:10.1f}{other['ess_per_second']:10.3f}"
                f"{ratio:8.0f}   at least {other['autocorrelation_time_at_least']:.0f} of {other['n_steps']:.0f} steps"
            )
    print(f"written: {write_results('stretch', figures, ('emcee', 'numpy', 'arviz'))}")


if __name__ == "__main__":
    main()
