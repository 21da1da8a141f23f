"""One variant's posterior, estimated."""

from __future__ import annotations

import zlib
from dataclasses import dataclass

import numpy as np

from bayescal.experiments.calibration.inputs import CalibrationInputs, Variant
from bayescal.experiments.shared.estimate import Estimate, estimate_posterior
from bayescal.experiments.shared.function_errors import FoundFunctions, find_functions
from bayescal.experiments.shared.reading_trees import SavedDraws, save_draws
from bayescal.numerics.geometry import Array


@dataclass(frozen=True, eq=False)
class Fit(Estimate):
    """What inference found for one variant.

    Attributes
    ----------
    names, units : tuple of str
        Of the n coordinates.
    prior_sd : ndarray, shape (n,)
    saved : SavedDraws
        What the posterior's file holds.
    functions : FoundFunctions or None
        Errors that are functions.
    """

    names: tuple[str, ...]
    units: tuple[str, ...]
    prior_sd: Array
    saved: SavedDraws
    functions: FoundFunctions | None


def fit_variant(inputs: CalibrationInputs, variant: Variant) -> Fit:
    """Compute one variant; all numbers depend on the inputs, the config's seed and the variant's name alone."""
    posterior, config = variant.posterior().anchored(), inputs.config
    found = estimate_posterior(posterior, config.seed, variant.name, config.sampler, config.evidence)
    key = zlib.crc32(variant.name.encode())
    seed = [config.seed, 8, key]
    saved = save_draws(posterior, found.kept, len(found.natural), config.sampler.ensembles, seed)
    draws = posterior.draw_common(found.kept, np.random.default_rng([config.seed, 9, key]))
    return Fit(
        **vars(found),
        names=posterior.names,
        units=posterior.units,
        prior_sd=posterior.prior_sd,
        saved=saved,
        functions=find_functions(posterior, found.kept, draws),
    )
