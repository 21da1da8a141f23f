"""Slips of the data, each tried as if it were so: units, signs, exchanged legs, rows that are shifted.

A slip is looked for before anything is fitted closely: the density of all poses under the priors, to first order about
the nominal machine, with an error of the legs as large as suits each case best. Right data close to within the
tolerances and what the first order leaves; slipped ones are off by as much as the machine moves.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Iterator
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Protocol

import numpy as np

from bayescal.density.likelihood import Likelihood
from bayescal.errors import BayescalError
from bayescal.numerics.geometry import Array
from bayescal.report.numbers import format_significant

type LikelihoodOf = Callable[[Array, np.ndarray], Likelihood]
"""Returns the density of some of the poses (Q,) at other actuator positions (Q, N)."""

UNIT, LEGS, ROWS, POSES = "unit", "legs", "rows", "poses"
CLEARLY = 20.0  # nats by which a slip has to explain the data better
ERRORS = np.geomspace(1e-4, 1e2, 25)  # mm, of every leg
BETTER = 3.0
"""Factor by which the legs' errors have to fall for a slip to be named."""
REREAD = 1.5
"""The same factor where what was measured is read in another way: at tilts of some degrees the legs are then off by two
to five times what was stated. Clean twins that err by 50 µm besides gain less than a nat by it."""
SUSPECT = 10.0
"""Legs' errors in units of what was stated, below which no slip of the actuators is tried."""
SCALES = {
    "1000 times too large (µm for mm)": 1e-3,
    "in metres, 1000 times too small": 1e3,
    "100 times too large": 1e-2,
    "100 times too small": 1e2,
    "10 times too large (cm for mm)": 0.1,
    "10 times too small (mm for cm)": 10.0,
    "in inches": 25.4,
    "in mm where inches are stated": 1.0 / 25.4,
    "of the other sign": -1.0,
}


class Tolerances(Protocol):
    """What is free about which machine, and how far: as of `bayescal.machines.coordinates.Coordinates`.

    Attributes
    ----------
    start : ndarray, shape (D,)
    free : ndarray of int, shape (n,)
    scale : ndarray, shape (n,)
    """

    @property
    def start(self) -> Array: ...  # noqa: D102

    @property
    def free(self) -> np.ndarray: ...  # noqa: D102

    @property
    def scale(self) -> Array: ...  # noqa: D102


@dataclass(frozen=True, eq=False)
class Suspect:
    """Measured poses under one machine, for whose actuator positions slips are tried.

    Attributes
    ----------
    likelihood_of : LikelihoodOf
    tolerances : Tolerances
    actuators : ndarray, shape (P, N)
        As they stand, mm.
    rereads : tuple of (str, LikelihoodOf)
        What may have happened to what was measured, in words, and the density without it. They are tried from a misfit
        on that one of them could mend: angles taken for rotation vectors are off by little where tilts are small.
    """

    likelihood_of: LikelihoodOf
    tolerances: Tolerances
    actuators: Array
    rereads: tuple[tuple[str, LikelihoodOf], ...] = ()

    def weigh(self, actuators: Array, chosen: np.ndarray) -> Weight:
        """Return how well some poses (Q,) at actuator positions (Q, N) fit under the priors to first order."""
        try:
            with np.errstate(all="ignore"):
                return weigh_likelihood(self.likelihood_of(actuators, chosen), self.tolerances)
        except (BayescalError, np.linalg.LinAlgError):
            return NOTHING

    def weigh_all(self) -> Weight:
        """Return how well the poses fit as they stand."""
        return self.weigh(self.actuators, np.arange(len(self.actuators)))


@dataclass(frozen=True, eq=False)
class Moved:
    """Actuator positions as they would be without a slip.

    Attributes
    ----------
    fault : str
    text : str
        What the slip would be.
    actuators : ndarray, shape (Q, N)
        mm, of the poses chosen.
    chosen : ndarray of int, shape (Q,)
        Which of the measured poses they belong to.
    """

    fault: str
    text: str
    actuators: Array
    chosen: np.ndarray


@dataclass(frozen=True)
class Weight:
    """How well data fit: their log-density at the best error of the legs, and that error, mm."""

    log_density: float
    error: float


@dataclass(frozen=True)
class FoundSlip:
    """A slip that explains the data better than the data as they stand: by how many nats, and how much smaller errors.

    Attributes
    ----------
    fault, text : str
    gain : float
    factor : float
    """

    fault: str
    text: str
    gain: float
    factor: float

    def say(self) -> str:
        """Return it in words."""
        return f"the data fit {format_significant(self.factor, 2)} times better if one mends: {self.text}"


def list_moves(actuators: Array, start: Array) -> Iterator[Moved]:
    """Yield what may have happened to actuator positions (P, N), mm, of a machine whose initial ones are ``start``."""
    n_poses, n_legs = actuators.shape
    every = np.arange(n_poses)
    for words, factor in SCALES.items():
        yield Moved(UNIT, f"actuator displacements seem to be {words}", start + factor * (actuators - start), every)
        if factor > 0.0:
            yield Moved(UNIT, f"actuator positions seem to be {words}", factor * actuators, every)
    if start.any():
        yield Moved(UNIT, "displacements seem to stand in place of actuator positions", actuators + start, every)
    for one, other in combinations(range(n_legs), 2):
        order = np.arange(n_legs)
        order[[one, other]] = other, one
        yield Moved(LEGS, f"legs {one + 1} and {other + 1} seem to be exchanged", actuators[:, order], every)
    yield Moved(LEGS, "legs seem to be numbered the other way round", actuators[:, ::-1], every)
    for step in range(1, n_legs):
        order = np.roll(np.arange(n_legs), -step)
        yield Moved(LEGS, f"legs seem to be counted from leg {step + 1}", actuators[:, order], every)
    for step, words in ((1, "earlier"), (-1, "later")):
        if n_poses > 2:
            there = every[step:] if step > 0 else every[:step]
            text = f"rows seem to be shifted by one: readings belong to the actuator positions of the row {words}"
            yield Moved(ROWS, text, actuators[there - step], there)


def find_slip(
    suspects: Iterable[Suspect], start: Array, stated: float, denied: Collection[str] = ()
) -> FoundSlip | None:
    """Return the slip that explains the data best; None where some machine fits, or none helps.

    Parameters
    ----------
    suspects : iterable of Suspect
        The same poses under machines one of which may be right.
    start : ndarray, shape (N,)
        Initial positions, mm.
    stated : float
        Error of a leg that noise and model error let expect, mm.
    denied : collection of str, optional
        Faults that are none, as somebody says who looked.
    """
    weighed: list[tuple[Weight, Suspect]] = []
    for one in suspects:
        weighed.append((one.weigh_all(), one))
        if weighed[-1][0].error < REREAD * stated:
            return None
    base, best = max(weighed, key=lambda pair: pair[0].log_density)
    found: list[FoundSlip] = []

    def judge(fault: str, text: str, beside: Weight, mended: Weight, least: float) -> None:
        gain, factor = mended.log_density - beside.log_density, beside.error / max(mended.error, stated)
        if fault not in denied and gain > CLEARLY and factor > least:
            found.append(FoundSlip(fault, text, gain, factor))

    for moved in list_moves(best.actuators, start) if base.error >= SUSPECT * stated else ():
        whole = len(moved.chosen) == len(best.actuators)
        beside = base if whole else best.weigh(best.actuators[moved.chosen], moved.chosen)
        judge(moved.fault, moved.text, beside, best.weigh(moved.actuators, moved.chosen), BETTER)
    for text, other in best.rereads:
        judge(POSES, text, base, replace(best, likelihood_of=other).weigh_all(), REREAD)
    return max(found, key=lambda one: one.gain, default=None)


NOTHING = Weight(-np.inf, float(ERRORS[-1]))


def weigh_likelihood(likelihood: Likelihood, tolerances: Tolerances) -> Weight:
    """Return the log-density of the poses under the priors to first order, at the best error of the legs, and it.

    The covariance C + S Sᵀ, S the slope by the parameters in tolerances, by the determinant lemma.
    """
    errors, slope = likelihood.error_jacobian(tolerances.start)
    slope = slope[..., tolerances.free] * tolerances.scale
    if not (np.isfinite(errors).all() and np.isfinite(slope).all()):
        return NOTHING
    sizes = {
        float(size): _log_density(
            errors, slope, likelihood.error_covariance(np.full(likelihood.n_model_errors, float(size)))
        )
        for size in ERRORS
    }
    best = max(sizes, key=sizes.__getitem__)
    return Weight(sizes[best], best)


def _log_density(errors: Array, slope: Array, covariance: Array) -> float:
    factor = np.linalg.cholesky(covariance)
    white = np.linalg.solve(factor, errors[..., None])[..., 0]
    rows = np.linalg.solve(factor, slope)
    log_det = 2.0 * float(np.log(np.diagonal(factor, axis1=1, axis2=2)).sum())
    told = np.einsum("pik,pi->k", rows, white)
    inner = np.eye(slope.shape[-1]) + np.einsum("pik,pil->kl", rows, rows)
    _, more = np.linalg.slogdet(inner)
    square = float(np.sum(white**2) - told @ np.linalg.solve(inner, told))
    return -0.5 * (square + log_det + float(more))
