"""Noise that is not as stated: what the best machine leaves of the poses, with no model error to hide it."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.optimize import minimize_scalar
from scipy.stats import chi2

from bayescal.density.likelihood import PoseLikelihood
from bayescal.experiments.check.faults.finding import Finding
from bayescal.experiments.check.subject import Subject
from bayescal.inference.mode import Mode
from bayescal.numerics.geometry import Array

CHECK, FAULT, ANOTHER = "Noise", "noise", "model error"
IMPROBABLE = 1e-4  # two-sided
EXTRACTION = (0.75, 1.35)  # of χ² by degree of freedom of the targets, beyond which their noise is another
LARGEST = np.log(1e3)
CLEARLY = 3.0  # nats by which one explanation has to be better than the other


def check_noise(subject: Subject, mode: Mode) -> Finding:
    """Return whether the noise is as stated; mode is that of the posterior without model error."""
    extraction = _check_extraction(subject)
    if extraction is not None:
        return extraction
    posterior = subject.posterior_of(subject.measured.poses, with_model_error=False)
    likelihood = posterior.likelihood
    assert isinstance(likelihood, PoseLikelihood)
    errors = likelihood.errors(posterior.theta(mode.y[None]))[0]
    data, prior = posterior.information(mode.y)
    fitted = float(np.trace(np.linalg.solve(data + prior, data)))
    square = _chi_square(errors, likelihood.error_covariance(np.zeros(likelihood.n_legs)))
    freedom = max(errors.size - fitted, 1.0)
    said = f"χ² of the poses is {square / freedom:.2f} per degree of freedom ({freedom:.0f})"
    if min(chi2.cdf(square, freedom), chi2.sf(square, freedom)) > IMPROBABLE / 2.0:
        return Finding(CHECK, "", "good", f"{said}, as it should be.")
    if square < freedom:
        text = f"{said}: the noise is stated {np.sqrt(freedom / square):.2g} times too large."
        return Finding(CHECK, FAULT, "bad", text)
    return _explain(likelihood, errors, freedom / errors.size, said)


def _check_extraction(subject: Subject) -> Finding | None:
    """Return whether the targets scatter about rigid bodies by another noise than stated; None where they do not."""
    found = subject.measured.described.get("pose_extraction")
    if not isinstance(found, dict) or EXTRACTION[0] < found["chi2_per_dof"] < EXTRACTION[1]:
        return None
    ratio = float(np.sqrt(found["chi2_per_dof"]))
    text = (
        f"targets scatter about rigid bodies {ratio:.2g} times as much as their stated noise (χ² per degree of freedom "
        f"{found['chi2_per_dof']:.2f}), whatever the machine. State target_noise_um {ratio:.2g} times as large."
    )
    return Finding(CHECK, FAULT, "bad", text)


def _chi_square(errors: Array, covariance: Array) -> float:
    return float(np.einsum("pi,pi->", errors, np.linalg.solve(covariance, errors[..., None])[..., 0]))


def _explain(likelihood: PoseLikelihood, errors: Array, share: float, said: str) -> Finding:
    """Say whether more noise of the measured poses, or an error of the legs, explains what is left better.

    ``share`` of the rows is free; the others were fitted away, and the errors are enlarged for it.
    """
    errors = errors / np.sqrt(share)
    legs = likelihood.n_legs
    known = likelihood.error_covariance(np.zeros(legs))
    by_noise, factor = _maximise(lambda x: _log_density(errors, np.exp(2.0 * x) * known), 0.0, LARGEST)
    by_legs, log_tau = _maximise(
        lambda x: _log_density(errors, likelihood.error_covariance(np.full(legs, np.exp(x)))), np.log(1e-5), np.log(1e2)
    )
    times, tau = float(np.exp(factor)), 1e3 * float(np.exp(log_tau))
    if by_legs > by_noise + CLEARLY:
        text = (
            f"{said}; an error of {tau:.2g} µm in every leg explains it better than more noise of the poses does. Free "
            "the model error, look for a missing deformation, or state more actuator_noise_um."
        )
        return Finding(CHECK, ANOTHER, "warning", text)
    text = f"{said}: the noise is {times:.2g} times what is stated. State the noise of poses and actuators as it is."
    return Finding(CHECK, FAULT, "bad", text)


def _maximise(function: Callable[[float], float], low: float, high: float) -> tuple[float, float]:
    """Return the largest value between two bounds, and where it is."""
    found = minimize_scalar(lambda x: -function(x), bounds=(low, high), method="bounded")
    return -float(found.fun), float(found.x)


def _log_density(errors: Array, covariance: Array) -> float:
    _, log_det = np.linalg.slogdet(covariance)
    return -0.5 * (_chi_square(errors, covariance) + float(np.sum(log_det)))
