"""Noise that is not as stated: what the best machine leaves of the readings, set against noise and model errors."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import minimize
from scipy.stats import chi2

from bayescal.density.calibration.likelihood import CalibrationPosterior
from bayescal.density.calibration.measurements import Measurements
from bayescal.density.calibration.terms import Errors, ErrorTerm
from bayescal.density.sessions import ReadingRows
from bayescal.experiments.check.faults.finding import Finding
from bayescal.experiments.shared.chi_square import ChiSquare, format_chance
from bayescal.experiments.shared.measured import MeasuredReadings, MeasuredVariant, see_legs
from bayescal.experiments.shared.soundness import fit_rows
from bayescal.numerics.geometry import Array

CHECK, FAULT, ANOTHER = "Noise", "noise", "model error"
IMPROBABLE = 1e-4
UNUSUAL = 0.05  # of χ²: a probability below which it is said that there is little or much of it
FACTORS = (0.25, 0.35, 0.5, 0.7, 1.4, 2.0, 2.8, 4.0, 8.0)  # on the noise, that are tried
STARTS = (-1.6, 0.5)  # of what is unknown of the errors, in its coordinates
FAR = 8.0
CLEARLY = 3.0  # nats by which model errors have to explain more than noise does


def check_noise(measured: MeasuredReadings) -> Finding:
    """Return whether the noise is as stated.

    What the best machine leaves of the readings is explained once by the stated noise and model errors of their prior,
    and once by so many times the stated noise and such model errors. An error that all poses share, of a measured K, is
    fitted along: as noise of single poses it would count as often as there are poses, and χ² come out too low.
    """
    extraction = None if measured.legs is None else _check_extraction(measured.legs)
    if extraction is not None:
        return extraction
    left = _fit_known(measured)
    found, errors = left.found, measured.posterior.errors
    said = f"χ² of the readings is {found.value / found.dof:.2f} per degree of freedom ({found.dof:.0f}, "
    said += f"{format_chance(found.chance)}) at the stated noise"
    if errors.outliers.expected:
        return Finding(CHECK, "", "good", f"{said}; rows may be outliers, which count by how far off they are.")
    stated, zeta = left.explain(1.0)
    values = zip(errors.names, errors.natural(zeta), errors.units, strict=True)
    free = [f"{name} {x:.3g}{'' if unit == '1' else f' {unit}'}" for name, x, unit in values]
    if any(type(one).factor is not ErrorTerm.factor for one in errors.terms):
        return Finding(CHECK, "", "good", f"{said}; what is free of it is estimated, about {', '.join(free)}.")
    best, factor = max((left.explain(x)[0], x) for x in FACTORS)
    if best - stated > 0.5 * float(chi2.isf(IMPROBABLE, 1)):
        text = f"{said}: about {factor:.2g} times the stated noise, most of it in {left.largest}. State the noise of it"
        text += (
            ". Perhaps the rows are averages of several measurements."
            if factor < 1.0
            else (", leave it free, or look for what the model misses.")
        )
        return Finding(CHECK, FAULT, "bad", text)
    if not found.is_off:
        return Finding(CHECK, "", "good", f"{said}, {describe_chance(found)}.")
    if found.factor < 1.0:
        text = f"{said}: less than noise of the stated size gives. It is stated too large, or rows are averages."
        return Finding(CHECK, FAULT, "warning", f"{text} Intervals are wider than they need be.")
    said += ": more than the stated noise"
    if not free:
        return Finding(CHECK, FAULT, "bad", f"{said}, most of it in {left.largest}. Look for what the model misses.")
    alone, times = max((left.explain(x, without=True)[0], x) for x in FACTORS)
    said += f". Errors that are free explain it ({', '.join(free)})"
    if alone > stated - CLEARLY:
        text = f"{said}, and so does {times:.2g} times the noise: make sure of the stated noise first."
        return Finding(CHECK, FAULT, "warning", text)
    text = (
        f"{said}, more noise of all channels does not: look for a missing deformation, or for channels that err more."
    )
    return Finding(CHECK, ANOTHER, "warning", text)


def describe_chance(found: ChiSquare) -> str:
    """Return what is said of a sum of squares that is no fault."""
    if found.chance >= UNUSUAL:
        return "as noise of the stated size gives"
    few = "less" if found.factor < 1.0 else "more"
    return f"{few} than noise of the stated size mostly gives, but not beyond chance"


def _check_extraction(legs: MeasuredVariant) -> Finding | None:
    """Return whether the targets scatter about rigid bodies by another noise than stated; None where they do not."""
    described = legs.described.get("pose_extraction")
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


# --- what is left ------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class SharedErrors(ErrorTerm):
    """Errors that all poses share: what M unknowns, standard normal, add to the readings, (P, K, M)."""

    each: Array
    names = units = ()
    priors = ()

    def columns(self, zeta: Array, data: Measurements) -> Array:
        """Return them."""
        del zeta, data
        return self.each[None]


@dataclass(frozen=True, eq=False)
class Left:
    """What the best machine leaves of the readings at the stated noise.

    Attributes
    ----------
    found : ChiSquare
    errors : ndarray, shape (P, R)
        Free of the poses, as large as they would be had nothing been fitted.
    covariance : callable
        Takes what is unknown of the errors, (n,), to (P, R, R); see `bayescal.density.sessions.LinearRows`.
    missing : ndarray, shape (P, R, R)
        The part of it that is no reading's; by the stated noise alone the whole is the identity.
    n_errors : int
    largest : str
        Kind of the channels that are left with most.
    """

    found: ChiSquare
    errors: Array
    covariance: Callable[[Array], Array]
    missing: Array
    n_errors: int
    largest: str

    def explain(self, factor: float, without: bool = False) -> tuple[float, Array]:
        """Return the log-density at so many times the noise and the best errors, with their prior, and these, (n,)."""
        stated = np.eye(self.errors.shape[1])
        known = factor**2 * (stated - self.missing) + self.missing
        if without or not self.n_errors:
            return _log_density(self.errors, known), np.zeros(self.n_errors)

        def cost(zeta: Array) -> float:
            return 0.5 * float(zeta @ zeta) - _log_density(self.errors, known + self.covariance(zeta) - stated)

        bounds = [(-FAR, FAR)] * self.n_errors
        found = [minimize(cost, np.full(self.n_errors, x), method="L-BFGS-B", bounds=bounds) for x in STARTS]
        best = min(found, key=lambda one: float(one.fun))
        return -float(best.fun), np.asarray(best.x)


def _fit_known(measured: MeasuredReadings) -> Left:
    """Return what is left at the best machine by the stated noise; what all poses share is fitted along."""
    legs, terms = measured.legs, tuple[ErrorTerm, ...]()
    if legs is not None and legs.shared_errors is not None:
        measured = see_legs(replace(legs, actuator_variance=None))
        terms = (_share(legs, len(measured.internal)),)
    own = measured.posterior.errors
    known = replace(measured.posterior, errors=Errors(terms, own.outliers)).anchored()
    y = known.approach()
    white, slope = known.likelihood.reduced_rows(*known.around(y), known.errors, known.zeta(y))
    m, n_spare = known.n_geometry, int(known.likelihood.n_spare.sum())
    held = np.concatenate([y[:m], np.zeros(slope.shape[-1] - m)])
    misfit = fit_rows(white, slope, held, np.eye(slope.shape[-1]), n_spare)
    found = ChiSquare(misfit.chi_square.value, max(misfit.dof, 1.0))
    rows = ReadingRows(replace(known, errors=Errors(own.terms))).linearise(known.theta(y[None])[0])
    across = np.swapaxes(rows.basis, 1, 2)
    errors = (across @ misfit.left[..., None])[..., 0] * np.sqrt(n_spare / found.dof)  # what was fitted is missing
    missing = across @ (~known.likelihood.data.present[..., None] * rows.basis)
    return Left(found, errors, rows.covariance, missing, own.n_parameters, _name_largest(known, misfit.left))


def _share(legs: MeasuredVariant, n_channels: int) -> SharedErrors:
    """Return what moves all legs' closures as errors of the actuators."""
    shared, poses, machine = legs.shared_errors, legs.poses, legs.machine
    assert shared is not None
    here = machine.linearise(legs.posterior.sampling.start, poses.position, poses.rotation, poses.actuators)
    each = np.zeros((poses.n_poses, n_channels, shared.shape[-1]))
    each[:, : shared.shape[1]] = np.linalg.solve(here.actuators, shared)
    return SharedErrors(each)


def _name_largest(posterior: CalibrationPosterior, white: Array) -> str:
    """Return the kind of channels with the largest white residuals, (P, K), rms."""
    kinds = np.array([one.kind for one in posterior.likelihood.model.channels])
    present = posterior.likelihood.data.present
    rms = {
        kind: float(np.sqrt(np.mean(white[:, kinds == kind][present[:, kinds == kind]] ** 2)))
        for kind in dict.fromkeys(kinds.tolist())
        if present[:, kinds == kind].any()
    }
    return max(rms, key=rms.__getitem__)


def _log_density(errors: Array, covariance: Array) -> float:
    square = np.einsum("pi,pi->", errors, np.linalg.solve(covariance, errors[..., None])[..., 0])
    return -0.5 * float(square + np.sum(np.linalg.slogdet(covariance)[1]))
