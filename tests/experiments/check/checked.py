"""Small studies for the tests of checks: clean ones, and data or knowledge with a fault planted."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import studies

from bayescal.data.measured_poses import MeasuredPoses
from bayescal.density.legs import build_leg_posterior
from bayescal.density.priors import NormalPrior
from bayescal.experiments.check.inputs import Subject, read_check
from bayescal.experiments.check.kind import configure_check
from bayescal.experiments.shared.measured import MeasuredVariant, see_legs

VARIANT = "six_pus/matrix"


@cache
def tiny_subject() -> Subject:
    """Return the tiny study's second variant: l and κ of six legs, thirteen poses."""
    with TemporaryDirectory() as name:
        path = studies.write_tiny_study(Path(name))
        return read_check(configure_check(path, [VARIANT], None, None), path.parent).subjects[VARIANT]


def make_clean(seed: int, with_model_error: bool = False) -> Subject:
    """Return a study whose data are simulated as it states, of a machine of its priors; K known, no photogrammetry."""
    legs = tiny_subject().measured.legs
    known = replace(legs, described={}, actuator_variance=None, shared_errors=None)
    subject = with_poses(known, known.poses)
    exact = subject if with_model_error else with_poses(without_model_error(known), known.poses)
    _, values = exact.draw_truth(np.random.default_rng([seed, 8]))
    return Subject(subject.measured.retake(values))


def with_poses(legs: MeasuredVariant, poses: MeasuredPoses) -> Subject:
    """Return a study that has measured other poses."""
    return Subject(see_legs(legs.with_poses(poses)))


def without_model_error(legs: MeasuredVariant) -> MeasuredVariant:
    """Return a study whose legs have no model error."""
    posterior = legs.posterior
    return replace(legs, posterior=build_leg_posterior(posterior.likelihood, posterior.priors, fixed=posterior.fixed))


def halve_noise(subject: Subject) -> Subject:
    """Return a study that states half the noise of poses and actuators."""
    legs = subject.measured.legs
    poses, variance = replace(legs.poses, covariance=legs.poses.covariance / 4.0), legs.actuator_variance
    variance = None if variance is None else variance / 4.0
    return with_poses(replace(legs, actuator_noise=legs.actuator_noise / 2.0, actuator_variance=variance), poses)


def tighten(subject: Subject, symbol: str, factor: float) -> Subject:
    """Return a study with the tolerance of a symbol so many times too tight."""
    posterior = subject.posterior
    priors = {
        name: NormalPrior(prior.mean, prior.sd / factor) if name.startswith(f"{symbol}[") else prior
        for name, prior in posterior.priors.items()
    }
    tight = build_leg_posterior(posterior.likelihood, priors, posterior.errors.model_error, posterior.fixed)
    return Subject(see_legs(replace(subject.measured.legs, posterior=tight, priors=priors)))
