"""Noise that is not as stated: what the best machine leaves of the poses, set against noise and model errors."""

from __future__ import annotations

import numpy as np
from scipy.optimize import minimize
from scipy.stats import chi2

from bayescal.density.independent_error import ModelError
from bayescal.density.likelihood import Likelihood
from bayescal.experiments.check.faults.finding import Finding
from bayescal.experiments.check.subject import Subject
from bayescal.inference.mode import Mode
from bayescal.numerics.geometry import Array

CHECK, FAULT, ANOTHER = "Noise", "noise", "model error"
IMPROBABLE = 1e-4
EXTRACTION = (0.75, 1.35)  # of χ² by degree of freedom of the targets, beyond which their noise is another
FACTORS = (0.25, 0.35, 0.5, 0.7, 1.4, 2.0, 2.8, 4.0, 8.0)  # on the noise, that are tried
STARTS = (0.05, 1.0)  # of model errors, in their scale
LARGEST = 100.0
CLEARLY = 3.0  # nats by which model errors have to explain more than noise does


def check_noise(subject: Subject, mode: Mode) -> Finding:
    """Return whether the noise is as stated; mode is that of the posterior without model error.

    What the best machine leaves of the poses is explained once by the stated noise and model errors of their prior, and
    once by so many times the stated noise and such model errors.
    """
    extraction = _check_extraction(subject)
    if extraction is not None:
        return extraction
    posterior = subject.posterior_of(subject.measured.poses, with_model_error=False)
    likelihood = posterior.likelihood
    errors = likelihood.errors(posterior.theta(mode.y[None]))[0]
    data, prior = posterior.information(mode.y)
    fitted = float(np.trace(np.linalg.solve(data + prior, data)))
    freedom = max(errors.size - fitted, 1.0)
    square = _chi_square(errors, likelihood.error_covariance(np.zeros(likelihood.n_legs)))
    errors = errors * np.sqrt(errors.size / freedom)  # what was fitted away is missing in them
    error = subject.posterior.model_error
    stated, tau = _fit(likelihood, errors, error, 1.0)
    best, factor = max((_fit(likelihood, errors, error, x)[0], x) for x in FACTORS)
    said = f"χ² of the poses is {square / freedom:.2f} per degree of freedom ({freedom:.0f}) without model error"
    if best - stated > 0.5 * float(chi2.isf(IMPROBABLE, 1)):
        text = f"{said}: the noise is about {factor:.2g} times what is stated. State both, of poses and actuators."
        return Finding(CHECK, FAULT, "bad", text)
    if square < chi2.isf(IMPROBABLE, freedom):
        return Finding(CHECK, "", "good", f"{said}, as it should be.")
    known = likelihood.error_covariance(np.zeros(likelihood.n_legs))
    alone, times = max((_log_density(errors, x**2 * known), x) for x in FACTORS)
    said += f": more than the stated noise. Model errors of {1e3 * tau:.2g} µm explain it"
    if alone > stated - CLEARLY:
        text = f"{said}, and so does {times:.2g} times the noise: make sure of the stated noise first."
        return Finding(CHECK, FAULT, "warning", text)
    text = f"{said}, more noise of the poses does not: look for a missing deformation, or for actuators that err more."
    return Finding(CHECK, ANOTHER, "warning", text)


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


def _fit(likelihood: Likelihood, errors: Array, error: ModelError, factor: float) -> tuple[float, float]:
    """Return the log-density of errors (P, K) at the best model errors, with their prior, and their rms, mm.

    The known covariance is that of so many times the stated noise.
    """
    legs = likelihood.n_legs
    known = likelihood.error_covariance(np.zeros(legs))
    if error.scale is None:
        return _log_density(errors, factor**2 * known), 0.0
    scale = error.scale

    def cost(x: Array) -> float:
        covariance = factor**2 * known + likelihood.error_covariance(np.broadcast_to(scale * x, legs)) - known
        return 0.5 * float(x @ x) - _log_density(errors, covariance)

    n = error.n_parameters(legs)
    found = [minimize(cost, np.full(n, start), method="L-BFGS-B", bounds=[(0.0, LARGEST)] * n) for start in STARTS]
    best = min(found, key=lambda one: float(one.fun))
    return -float(best.fun), scale * float(np.sqrt(np.mean(best.x**2)))


def _log_density(errors: Array, covariance: Array) -> float:
    _, log_det = np.linalg.slogdet(covariance)
    return -0.5 * (_chi_square(errors, covariance) + float(np.sum(log_det)))
