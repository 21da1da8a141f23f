"""What the measured data say of a config: each kind of fault by itself, the gravest first."""

from __future__ import annotations

import numpy as np

from bayescal.errors import NumericalError
from bayescal.experiments.check.faults.derivatives import check_derivatives
from bayescal.experiments.check.faults.finding import Finding
from bayescal.experiments.check.faults.modes import check_modes, list_starts
from bayescal.experiments.check.faults.noise import check_noise
from bayescal.experiments.check.faults.priors import check_priors
from bayescal.experiments.check.ranks import draw_posterior
from bayescal.experiments.check.subject import Subject, state_slips
from bayescal.experiments.shared.reading_slips import audit_slips
from bayescal.numerics.geometry import Array

SEARCH = "search"
GRAVEST = ("derivative", "unit", "legs", "channel")
"""Faults that leave nothing else to be said."""

type Look = tuple[list[Finding], Array, Array]
"""Findings, and draws of the posterior of the measured data, (S, n) in natural units and in coordinates; none after the
gravest faults."""


def look_at_data(task: tuple[Subject, int, int]) -> Look:
    """Return what the measured data say of a variant, from draws so many and a seed."""
    subject, n_draws, seed = task
    draw_seed, mode_seed, derivative_seed = np.random.SeedSequence([seed, 1]).spawn(3)
    posterior = subject.posterior
    slips = state_slips(*audit_slips(subject.measured))
    findings = [check_derivatives(subject, np.random.default_rng(derivative_seed)), slips]
    nothing = np.empty((0, posterior.n_parameters))
    if any(one.fault in GRAVEST for one in findings):
        return findings, nothing, nothing
    try:
        draws, y, found, _ = draw_posterior(posterior, n_draws, draw_seed)
        noise = check_noise(subject.measured)
    except NumericalError as error:
        return [*findings, Finding("Search", SEARCH, "bad", f"the posterior is not found: {error}.")], nothing, nothing
    starts = list_starts(posterior, found.modes[0].y, np.random.default_rng(mode_seed))
    modes = check_modes(posterior, found.modes, starts)
    return [*findings, modes, noise, check_priors(posterior, draws)], draws, y
