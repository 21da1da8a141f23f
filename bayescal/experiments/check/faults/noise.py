"""Noise that is not as stated: what the best machine leaves of the poses, set against noise and model errors."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from scipy.optimize import minimize
from scipy.stats import chi2

from bayescal.density.errors import ModelError
from bayescal.density.likelihood import Likelihood
from bayescal.density.pose_likelihood import PoseLikelihood
from bayescal.experiments.check.faults.finding import Finding
from bayescal.experiments.shared.chi_square import ChiSquare, format_chance
from bayescal.experiments.shared.soundness import find_misfit
from bayescal.inference.mode import Mode
from bayescal.numerics.geometry import Array

if TYPE_CHECKING:
    from bayescal.experiments.check.legs import LegSubject

CHECK, FAULT, ANOTHER = "Noise", "noise", "model error"
IMPROBABLE = 1e-4
UNUSUAL = 0.05  # of χ²: a probability below which it is said that there is little or much of it
FACTORS = (0.25, 0.35, 0.5, 0.7, 1.4, 2.0, 2.8, 4.0, 8.0)  # on the noise, that are tried
STARTS = (0.05, 1.0)  # of model errors, in their scale
LARGEST = 100.0
CLEARLY = 3.0  # nats by which model errors have to explain more than noise does


def check_noise(subject: LegSubject, mode: Mode) -> Finding:
    """Return whether the noise is as stated; mode is that of the posterior without model error.

    What the best machine leaves of the poses is explained once by the stated noise and model errors of their prior, and
    once by so many times the stated noise and such model errors. An error that all poses share, of a measured K, is
    fitted along: as noise of single poses it would count as often as there are poses, and χ² come out too low.
    """
    extraction = _check_extraction(subject)
    if extraction is not None:
        return extraction
    posterior, measured = subject.posterior_of(subject.measured.poses, with_model_error=False), subject.measured
    likelihood = PoseLikelihood(measured.machine, measured.poses, measured.actuator_noise)
    known = likelihood.error_covariance(np.zeros(likelihood.n_legs))
    misfit = find_misfit(posterior, mode.y, likelihood, measured.shared_errors)
    found = ChiSquare(misfit.chi_square.value, max(misfit.dof, 1.0))
    errors = (np.linalg.cholesky(known) @ misfit.left[..., None])[..., 0]
    errors *= np.sqrt(errors.size / found.dof)  # what was fitted away is missing in them
    error = subject.posterior.errors.model_error
    stated, tau = _fit(likelihood, errors, error, 1.0)
    best, factor = max((_fit(likelihood, errors, error, x)[0], x) for x in FACTORS)
    said = f"χ² of the poses is {found.value / found.dof:.2f} per degree of freedom ({found.dof:.0f}, "
    said += f"{format_chance(found.chance)}) without model error"
    if best - stated > 0.5 * float(chi2.isf(IMPROBABLE, 1)):
        text = f"{said}: the noise is about {factor:.2g} times what is stated. State both, of poses and actuators."
        text += " Perhaps the poses are averages of several measurements." if factor < 1.0 else ""
        return Finding(CHECK, FAULT, "bad", text)
    if not found.is_off:
        return Finding(CHECK, "", "good", f"{said}, {describe_chance(found)}.")
    if found.factor < 1.0:
        text = f"{said}: less than noise of the stated size gives. It is stated too large, or poses are averages."
        return Finding(CHECK, FAULT, "warning", f"{text} Intervals are wider than they need be.")
    alone, times = max((_log_density(errors, x**2 * known), x) for x in FACTORS)
    said += f": more than the stated noise. Model errors of {1e3 * tau:.2g} µm explain it"
    if alone > stated - CLEARLY:
        text = f"{said}, and so does {times:.2g} times the noise: make sure of the stated noise first."
        return Finding(CHECK, FAULT, "warning", text)
    text = f"{said}, more noise of the poses does not: look for a missing deformation, or for actuators that err more."
    return Finding(CHECK, ANOTHER, "warning", text)


def describe_chance(found: ChiSquare) -> str:
    """Return what is said of a sum of squares that is no fault."""
    if found.chance >= UNUSUAL:
        return "as noise of the stated size gives"
    few = "less" if found.factor < 1.0 else "more"
    return f"{few} than noise of the stated size mostly gives, but not beyond chance"


def _check_extraction(subject: LegSubject) -> Finding | None:
    """Return whether the targets scatter about rigid bodies by another noise than stated; None where they do not."""
    described = subject.measured.described.get("pose_extraction")
    if not isinstance(described, dict):
        return None
    found = ChiSquare(described["chi2_per_dof"] * described["dof"], described["dof"])
    if not found.is_off:
        return None
    text = (
        f"targets scatter about rigid bodies {found.factor:.2g} times as much as their stated noise (χ² per degree of "
        f"freedom {described['chi2_per_dof']:.2f}, {format_chance(found.chance)}), whatever the machine. State "
        f"target_noise_um {found.factor:.2g} times as large."
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
