"""What the measured data say of a study's config: each kind of fault by itself, the gravest first."""

from __future__ import annotations

import numpy as np

from bayescal.errors import NumericalError
from bayescal.experiments.check.faults.derivatives import check_derivatives
from bayescal.experiments.check.faults.finding import Finding
from bayescal.experiments.check.faults.modes import check_modes
from bayescal.experiments.check.faults.noise import check_noise
from bayescal.experiments.check.faults.priors import check_priors
from bayescal.experiments.check.faults.slips import check_slips
from bayescal.experiments.check.ranks import draw_posterior
from bayescal.experiments.check.subject import Subject
from bayescal.inference.mode import find_modes
from bayescal.numerics.geometry import Array

SEARCH = "search"
GRAVEST = ("derivative", "unit", "legs")
"""Faults that leave nothing else to be said."""

type Look = tuple[list[Finding], Array]
"""Findings, and draws of the posterior of the measured data, natural units, (S, n); none after the gravest faults."""


def look_at_data(task: tuple[Subject, int, int]) -> Look:
    """Return what the measured data say of a variant, from draws so many and a seed."""
    subject, n_draws, seed = task
    draw_seed, mode_seed, derivative_seed = np.random.SeedSequence([seed, 1]).spawn(3)
    posterior = subject.posterior
    findings = [check_derivatives(subject, np.random.default_rng(derivative_seed)), check_slips(subject)]
    nothing = np.empty((0, posterior.n_parameters))
    if any(one.fault in GRAVEST for one in findings):
        return findings, nothing
    try:
        draws, found, _ = draw_posterior(posterior, n_draws, draw_seed)
        alone = find_modes(subject.posterior_of(subject.measured.poses, with_model_error=False))[0]
    except NumericalError as error:
        return [*findings, Finding("Search", SEARCH, "bad", f"the posterior is not found: {error}.")], nothing
    modes = check_modes(posterior, found.modes, np.random.default_rng(mode_seed))
    return [*findings, modes, check_noise(subject, alone), check_priors(subject, draws)], draws
