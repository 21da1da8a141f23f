"""Small studies for the tests of checks: clean ones, and data or knowledge with a fault planted."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import studies

from bayescal.density.legs import build_leg_posterior
from bayescal.density.priors import NormalPrior
from bayescal.experiments.check.inputs import read_check
from bayescal.experiments.check.kind import configure_check
from bayescal.experiments.check.legs import LegSubject

VARIANT = "six_pus/matrix"


@cache
def tiny_subject() -> LegSubject:
    """Return the tiny study's second variant: l and κ of six legs, thirteen poses."""
    with TemporaryDirectory() as name:
        path = studies.write_tiny_study(Path(name))
        return read_check(configure_check(path, [VARIANT], None, None), path.parent).subjects[VARIANT]


def make_clean(seed: int, with_model_error: bool = False) -> LegSubject:
    """Return a study whose data are simulated as it states, of a machine of its priors; K known, no photogrammetry."""
    subject = tiny_subject()
    known = replace(subject.measured, described={}, actuator_variance=None, shared_errors=None)
    subject = LegSubject(known).with_poses(known.poses)
    _, poses = subject.simulate_from_prior(np.random.default_rng([seed, 8]), with_model_error)
    return subject.with_poses(poses)


def halve_noise(subject: LegSubject) -> LegSubject:
    """Return a study that states half the noise of poses and actuators."""
    poses = replace(subject.measured.poses, covariance=subject.measured.poses.covariance / 4.0)
    variance = subject.measured.actuator_variance
    quiet = replace(
        subject.measured,
        actuator_noise=subject.measured.actuator_noise / 2.0,
        actuator_variance=None if variance is None else variance / 4.0,
    )
    return LegSubject(quiet).with_poses(poses)


def change_actuators(subject: LegSubject, change) -> LegSubject:
    """Return a study whose actuator positions are changed by a function of (P, N)."""
    poses = subject.measured.poses
    return subject.with_poses(replace(poses, actuators=change(poses.actuators)))


def tighten(subject: LegSubject, symbol: str, factor: float) -> LegSubject:
    """Return a study with the tolerance of a symbol so many times too tight."""
    posterior = subject.posterior
    priors = {
        name: NormalPrior(prior.mean, prior.sd / factor) if name.startswith(f"{symbol}[") else prior
        for name, prior in posterior.priors.items()
    }
    tight = build_leg_posterior(posterior.likelihood, priors, posterior.errors.model_error, posterior.fixed)
    return LegSubject(replace(subject.measured, posterior=tight, priors=priors))
