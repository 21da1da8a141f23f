"""Identification as the field does it: least squares of the closure residual, no prior, no noise model.

This is RR-8096 section 7 (eq. 30 with its identifiable parameters): the reference to which posteriors are compared.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares

from bayescal.coordinates import mirror_direction
from bayescal.geometry import Array
from bayescal.kinematics import Machine, compute_home_legs
from bayescal.measured_poses import MeasuredPoses

START_TILT = 0.05  # where u_x starts: at zero its column vanishes for a leg without slope


@dataclass(frozen=True, eq=False)
class LeastSquaresFit:
    """Identified parameters.

    Attributes
    ----------
    theta : ndarray, shape (D,)
        Parameter vector with the free parameters identified.
    residual_rms : ndarray, shape (N,)
        Closure residual of each leg, mm.
    converged : bool
    """

    theta: Array
    residual_rms: Array
    converged: bool


def identify(machine: Machine, poses: MeasuredPoses, symbols: tuple[str, ...]) -> LeastSquaresFit:
    """Minimise the sum of squared closure residuals over all legs' parameters of the given symbols.

    With u_x free each leg has two solutions of nearly the same actuator gain; both are tried and the better one kept.
    """
    layout = machine.layout
    free = np.concatenate([layout.index[symbol] for symbol in symbols])
    start = layout.nominal.copy()
    if "u_x" in symbols:
        start[layout.index["u_x"]] += START_TILT
    best = _solve(machine, poses, free, start)
    if "u_x" in symbols:
        legs = compute_home_legs(machine)
        slopes = legs[:, 0] / legs[:, 2]
        for leg in range(machine.mechanism.n_legs):
            other = _solve(machine, poses, free, mirror_direction(layout, best.theta, leg, slopes[leg], free))
            if np.sum(other.residual_rms**2) < np.sum(best.residual_rms**2):
                best = other
    return best


def _solve(machine: Machine, poses: MeasuredPoses, free: np.ndarray, start: Array) -> LeastSquaresFit:
    layout, basis = machine.layout, machine.basis(poses.actuators)

    def vector(x: Array) -> Array:
        theta = start.copy()
        theta[free] = x
        return theta

    def residual(x: Array) -> Array:
        value = machine.model.linearise(layout, vector(x), poses.position, poses.rotation, basis).residual.ravel()
        return np.where(np.isfinite(value), value, 1e6)

    def jacobian(x: Array) -> Array:
        full = machine.model.linearise(layout, vector(x), poses.position, poses.rotation, basis).parameters
        return full[..., free].reshape(-1, len(free))

    result = least_squares(residual, start[free], jacobian, method="lm", x_scale="jac", xtol=1e-13, ftol=1e-13)
    rms = np.sqrt(np.mean(result.fun.reshape(poses.n_poses, -1) ** 2, axis=0))
    return LeastSquaresFit(vector(result.x), rms, bool(result.success))
