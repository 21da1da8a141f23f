"""Small studies for the tests of checks: clean ones, and data or knowledge with a fault planted."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import studies

from bayescal.density.calibration.likelihood import CalibrationPosterior
from bayescal.density.calibration.terms import CorrelatedNoise, ErrorModel
from bayescal.density.priors import NormalPrior
from bayescal.experiments.selftest.inputs import TestedVariant, read_selftest
from bayescal.experiments.selftest.kind import configure_selftest
from bayescal.experiments.shared.readings.errors import drop_model_error

VARIANT = "six_pus/matrix"


@cache
def tiny_subject() -> TestedVariant:
    """Return the tiny study's second variant: l and κ of six legs, thirteen poses."""
    with TemporaryDirectory() as name:
        path = studies.write_tiny_study(Path(name))
        return read_selftest(configure_selftest(path, [VARIANT], None, None), path.parent).subjects[VARIANT]


def make_clean(seed: int, with_model_error: bool = False) -> TestedVariant:
    """Return a study whose data are simulated as it states, of a machine of its priors; K known, no photogrammetry."""
    own = replace(drop_known(tiny_subject()).measured, described={})
    exact = own if with_model_error else replace(own, posterior=drop_model_error(own.posterior))
    _, values = TestedVariant(exact).draw_truth(np.random.default_rng([seed, 8]))
    return TestedVariant(own.retake(values))


def drop_known(subject: TestedVariant) -> TestedVariant:
    """Return a study that knows K without error."""
    terms = tuple(one for one in subject.measured.posterior.errors.terms if not isinstance(one, CorrelatedNoise))
    return with_posterior(subject, errors=ErrorModel(terms))


def with_posterior(subject: TestedVariant, **changes: object) -> TestedVariant:
    """Return a study of which the posterior has something else."""
    measured = subject.measured
    return TestedVariant(replace(measured, posterior=replace(measured.posterior, **changes)))


def with_data(subject: TestedVariant, **changes: object) -> TestedVariant:
    """Return a study with other data of the same poses."""
    likelihood = subject.measured.posterior.likelihood
    return with_posterior(subject, likelihood=replace(likelihood, data=replace(likelihood.data, **changes)))


def scale_noise(subject: TestedVariant, factor: float) -> TestedVariant:
    """Return a study that states so many times the noise of all channels."""
    return with_data(subject, sd=factor * subject.measured.posterior.likelihood.data.sd)


def tighten(posterior: CalibrationPosterior, factor: float, symbol: str = "") -> CalibrationPosterior:
    """Return a posterior with the tolerance of a symbol, or of all, so many times too tight."""
    priors = {
        name: NormalPrior(prior.mean, prior.sd / factor) if name.startswith(symbol) else prior
        for name, prior in posterior.priors.items()
    }
    return replace(posterior, priors=priors)
