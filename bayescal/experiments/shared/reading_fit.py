"""Fits of machines known by their readings, the poses unknown, and their posteriors as ArviZ trees."""

from __future__ import annotations

import zlib
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, cast

import numpy as np

from bayescal.density.calibration.likelihood import CalibrationPosterior
from bayescal.density.calibration.prediction import replicate_readings
from bayescal.experiments.shared.chi_square import ChiSquare
from bayescal.experiments.shared.estimate import Arrays, Fit, Subject, fit_posterior
from bayescal.experiments.shared.function_errors import FoundFunctions, find_functions
from bayescal.experiments.shared.soundness import fit_rows
from bayescal.experiments.shared.trees import Draws, Readings, build_tree, limit_draws
from bayescal.inference.schema import EvidenceConfig, SamplerConfig
from bayescal.inference.target import Fittable
from bayescal.numerics.geometry import Array

if TYPE_CHECKING:
    import xarray as xr

PRIOR_DRAWS = 300
ONLY_SAVED = ("log_likelihood", "replicated", "prior", "prior_replicated")


@dataclass(frozen=True, eq=False)
class ReadingFit(Fit):
    """A fit of readings.

    Attributes
    ----------
    functions : FoundFunctions or None
        Errors that are functions.
    common : tuple of pairs of ndarray
        Draws of errors common to all rows, as `CommonDraws.parts`.
    """

    functions: FoundFunctions | None
    common: tuple[tuple[Array, Array], ...]


def fit_readings(
    posterior: CalibrationPosterior, seed: int, name: str, sampler: SamplerConfig, effort: EvidenceConfig
) -> ReadingFit:
    """Return a posterior's fit and its tree's file; its random numbers depend on the seed and the name alone."""
    subject = ReadingSubject(posterior)
    fit = fit_posterior(subject, seed, name, sampler, effort)
    common = posterior.likelihood.draw_common(
        *posterior.at(fit.kept), np.random.default_rng([seed, 9, zlib.crc32(name.encode())])
    )
    functions = find_functions(posterior, fit.kept, common)
    packed = fit.pack(subject.build_tree(fit, name), ONLY_SAVED)
    return ReadingFit(**vars(packed), functions=functions, common=common.parts)


@dataclass(frozen=True, eq=False)
class ReadingSubject(Subject):
    """A posterior of readings.

    Attributes
    ----------
    density : CalibrationPosterior
    """

    density: CalibrationPosterior

    @property
    def posterior(self) -> CalibrationPosterior:
        """The posterior."""
        return self.density

    def evaluate(self, posterior: Fittable, y: Array, seed: np.random.SeedSequence) -> Arrays:
        """Return the rows' log-densities (E, S, P), and the readings that some draws predict, (E, S', P, K)."""
        flat, own = y.reshape(-1, y.shape[-1]), cast("CalibrationPosterior", posterior)
        density = own.pointwise(flat)
        some = self._thin(y)
        made = replicate_readings(own, some.reshape(-1, y.shape[-1]), np.random.default_rng(seed))
        replicated = made.reshape(*some.shape[:2], *made.shape[1:]).astype(np.float32)
        found: dict[str, Any] = {"log_likelihood": density.reshape(*y.shape[:2], -1), "replicated": replicated}
        return found

    def _thin(self, values: Array) -> Array:
        """Return what is of the draws that predict, from something of all, (E, S, ...)."""
        n_draws = values.shape[0] * values.shape[1]
        return values[:, :: -(-n_draws // limit_draws(n_draws, self.posterior.likelihood.data.values.size))]

    def replicate_prior(self, posterior: Fittable, seed: np.random.SeedSequence) -> Arrays:
        """Return draws of the prior that are machines, (T, n), and their readings at the expected poses (T, P, K)."""
        own, rng = cast("CalibrationPosterior", posterior), np.random.default_rng(seed)
        y = own.draw_prior(limit_draws(PRIOR_DRAWS, own.likelihood.data.values.size), rng)
        with np.errstate(all="ignore"):
            made = replicate_readings(own, y, rng, own.likelihood.start)
        there = np.isfinite(made).all(axis=(1, 2), where=own.likelihood.data.present)
        return {"prior": own.natural(y[there]), "prior_replicated": made[there].astype(np.float32)}

    def measure_misfit(self, posterior: Fittable, mode: Array) -> ChiSquare:
        """Return χ² of what no pose explains at the mode (n,)."""
        own = cast("CalibrationPosterior", posterior)
        white, slope = own.likelihood.reduced_rows(*own.around(mode), own.errors, own.zeta(mode))
        n = slope.shape[-1]  # the geometry, then coefficients of errors common to all rows, whose prior is N(0, 1)
        held = np.concatenate([mode[: own.n_geometry], np.zeros(n - own.n_geometry)])
        return fit_rows(white, slope, held, np.eye(n), int(own.likelihood.n_spare.sum())).chi_square

    def build_tree(self, fit: Fit, variant: str) -> xr.DataTree:
        """Return the fit with draws of its prior, what both predict, and the data."""
        likelihood, arrays = self.posterior.likelihood, fit.evaluated
        priors, channels = self.posterior.all_priors().values(), likelihood.model.channels
        draws, density, rows = (self._thin(one) for one in (fit.draws, fit.log_density, arrays["log_likelihood"]))
        readings = Readings(
            likelihood.data.poses,
            [one.name for one in channels],
            [one.unit for one in channels],
            likelihood.data.values,
            arrays["replicated"],
            arrays["prior_replicated"],
            rows,
            "readings as measured",
        )
        log_prior = np.stack([prior.log_density(draws[..., k]) for k, prior in enumerate(priors)], axis=-1)
        return build_tree(
            Draws(fit.names, fit.units, draws, density, log_prior, arrays["prior"]), readings, variant=variant
        )
