"""Structural identifiability: the rank of the identification Jacobian, decided by its spectrum against rounding.

A gauge freedom or a parameter that stands for another makes singular values that would be zero but for rounding. How
large rounding is here is measured, not assumed: the Jacobian is computed again at machines that differ in the last
digits, and by Weyl's inequality no singular value moves further than the norm of the difference. Values of that size
are zero as far as anyone can tell; the rank is counted at the largest gap of the spectrum beside them.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from bayescal.density.calibration.likelihood import CalibrationPosterior
from bayescal.identifiability.reading_rows import see
from bayescal.numerics.geometry import Array

EPSILON = float(np.finfo(np.float64).eps)
TWINS = 3
TWIN_SHIFT = 4.0  # units in the last place
REACH = 100.0  # how far above the rounding seen a value may lie and still be rounding
CLEAR_GAP = 10.0  # a smaller ratio of neighbouring singular values leaves the rank open
OFF = 0.1  # tolerances, of the other machine


@dataclass(frozen=True, eq=False)
class Structure:
    """The spectrum of a noise-free identification Jacobian and what it says."""

    singular_values: Array  # (n,): largest first, columns scaled by the tolerances
    rounding: float  # how far rounding moves them
    rank: int
    # ratio of the last singular value that counts to the first that does not, or to a larger rounding
    gap: float
    null_space: Array  # (n, n - rank): orthonormal, in units of the tolerances
    # of a machine a little off the expected one; a larger one says that the expected geometry is a special case
    rank_elsewhere: int | None = None

    @property
    def is_clear(self) -> bool:
        """Whether the gap decides."""
        return self.gap >= CLEAR_GAP


def find_structure(jacobian: Array, twins: list[Array]) -> Structure:
    """Return the rank of a Jacobian (m, n) with columns in units of the tolerances.

    Its twins are computed from inputs that differ in the last digits.
    """
    m, n = jacobian.shape
    padded = np.concatenate([jacobian, np.zeros((max(0, n - m), n))])
    _, values, vectors = np.linalg.svd(padded, full_matrices=False)
    own = EPSILON * np.sqrt(max(m, n)) * values[0]
    rounding = max([own, *(float(np.linalg.norm(jacobian - twin, 2)) for twin in twins)])
    ends = np.append(values, own)  # beyond the last value lies nothing but rounding
    cuts = [k for k in range(1, n + 1) if ends[k] <= REACH * rounding]
    ratios = [ends[k - 1] / max(ends[k], rounding) for k in cuts]
    best = int(np.argmax(ratios))
    rank, gap = cuts[best], float(ratios[best])
    return Structure(values, rounding, rank, gap, vectors[rank:].T)


def find_structural_rank(posterior: CalibrationPosterior, rng: np.random.Generator) -> Structure:
    """Return the structure of what channels see at the poses of a posterior's data, better far apart.

    The posterior has no errors, and the readings of the machine as expected.
    """
    n, sampling = posterior.n_geometry, posterior.sampling
    theta = sampling.start[sampling.free]

    def look(y: Array) -> list[Array]:
        shifts = TWIN_SHIFT * EPSILON * rng.uniform(-1.0, 1.0, (TWINS, n)) * np.abs(theta) / posterior.prior_sd[:n]
        return [see(posterior, one).reshape(-1, n) for one in (y, *(y + shifts))]

    first, *twins = look(np.zeros(n))
    found = find_structure(first, twins)
    other, *others = look(OFF * rng.standard_normal(n))
    if not all(np.isfinite(one).all() for one in (other, *others)):
        return found
    return replace(found, rank_elsewhere=find_structure(other, others).rank)
