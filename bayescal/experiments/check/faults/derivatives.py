"""Wrong derivatives: the model's own against differences of its errors, at machines of the priors."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from bayescal.density.legs import LegPosterior
from bayescal.experiments.check.faults.finding import Finding
from bayescal.numerics.geometry import Array

if TYPE_CHECKING:
    from bayescal.experiments.check.legs import LegSubject

CHECK, FAULT = "Derivatives", "derivative"
STEP = 1e-3  # prior sd; halved, and both extrapolated
WRONG = 1e-3  # of the largest difference along a parameter; right ones agree to 1e-6
SEEN = 1e-4  # of the noise: a prior sd of a parameter that moves less is not looked at
MACHINES = 3


def check_derivatives(subject: LegSubject, rng: np.random.Generator) -> Finding:
    """Return whether each parameter's derivative is that of the differences.

    At machines of the priors, each with data of its own: far from the data neither errors nor derivatives need be
    exact.
    """
    worst = dict[str, float]()
    for _ in range(MACHINES):
        truth, poses = subject.simulate_from_prior(rng, with_model_error=False)
        for name, value in _compare(subject.posterior_of(poses), subject.theta_of(truth)[0]).items():
            worst[name] = max(worst.get(name, 0.0), value)
    wrong = {name: value for name, value in worst.items() if value > WRONG}
    if not wrong:
        most = max(worst.values(), default=0.0)
        text = f"the model's derivatives are those of differences, to {max(most, 1e-9):.0e} at worst."
        return Finding(CHECK, "", "good", text)
    symbols = ", ".join(dict.fromkeys(name.partition("[")[0] for name in wrong))
    text = f"the model's derivatives by {symbols} are wrong: off by up to {100 * max(wrong.values()):.3g} %. Mend "
    return Finding(CHECK, FAULT, "bad", f"{text}what the model's class returns for them; modes and ridges rest on it.")


def _compare(posterior: LegPosterior, theta: Array) -> dict[str, float]:
    """Return how far each free parameter's derivative is off, as a share of the largest difference."""
    likelihood = posterior.likelihood
    free, scale = posterior.sampling.free, posterior.sampling.coordinates.scale
    _, slope = likelihood.error_jacobian(theta)
    rough, fine = (_differ(posterior, theta, step * scale) for step in (STEP, STEP / 2.0))
    expected = (4.0 * fine - rough) / 3.0
    noise = np.sqrt(np.diagonal(likelihood.error_covariance(np.zeros(likelihood.n_legs)), axis1=1, axis2=2))
    found = {}
    for k, place in enumerate(free):
        size = np.abs(expected[..., k]).max()
        seen = (np.abs(expected[..., k]) * scale[k] / noise).max()
        if np.isfinite(size) and seen > SEEN:
            found[posterior.names[k]] = float(np.abs(slope[..., place] - expected[..., k]).max() / size)
    return found


def _differ(posterior: LegPosterior, theta: Array, step: Array) -> Array:
    """Return central differences of the errors by the free parameters, shape (P, K, m)."""
    free, n = posterior.sampling.free, len(step)
    points = np.tile(theta, (2 * n, 1))
    points[np.arange(n), free] += step
    points[n + np.arange(n), free] -= step
    with np.errstate(all="ignore"):
        errors = posterior.likelihood.errors(points)
    return np.moveaxis((errors[:n] - errors[n:]) / (2.0 * step[:, None, None]), 0, -1)
