"""What measurements err by beside their stated noise: terms, each with coordinates of its own, and outliers.

A term has amplitudes, standard deviations in mm (a kernel's length in ranges of the actuators), and coordinates ζ of
them whose deviations are standard normal under the prior. A likelihood takes the amplitudes of all terms one behind the
other: τ of each of the N legs; then, where the error is also a function of the pose, its scale s of each leg; then the
function's length where that is free. What outliers do is taken after everything else: see `Outliers`.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np
from scipy.special import gammaln

from bayescal.density.model_error import LENGTH, SCALE, KernelScalePrior
from bayescal.density.priors import HalfNormalPrior, LogNormalPrior, Prior, SharePrior
from bayescal.density.protocols import ErrorCoordinates
from bayescal.numerics.geometry import Array

TAU, SHARE = "tau", "epsilon"
FREEDOM, WIDER = 1.0, 3.0  # ν and κ of an outlier


class LegTerm(ABC):
    """A term of the legs' errors: amplitudes of each leg, or of all alike where it is ``shared``."""

    label: str
    shared: bool

    @property
    @abstractmethod
    def prior(self) -> Prior:
        """Prior of each amplitude."""

    def n_parameters(self, n_legs: int) -> int:
        """Return the number of coordinates."""
        return 1 if self.shared else n_legs

    def names(self, n_legs: int) -> tuple[str, ...]:
        """Return the names of the amplitudes that are free."""
        count = self.n_parameters(n_legs)
        return (self.label,) if self.shared else tuple(f"{self.label}[{leg}]" for leg in range(1, count + 1))

    def at_legs(self, values: Array, n_legs: int) -> Array:
        """Return something of the coordinates (..., k) at all amplitudes of the term, (..., N)."""
        return np.broadcast_to(values, (*values.shape[:-1], n_legs))


@dataclass(frozen=True)
class ModelError(LegTerm):
    """The model error τ, drawn anew at every pose: half-normal with the given scale in mm, or none (scale None)."""

    scale: float | None
    shared: bool = False
    label = TAU

    @property
    def prior(self) -> Prior:
        """Half-normal; of no width where there is none."""
        return HalfNormalPrior(self.scale or 0.0)

    def n_parameters(self, n_legs: int) -> int:
        """Return the number of free model errors."""
        return 0 if self.scale is None else super().n_parameters(n_legs)

    def names(self, n_legs: int) -> tuple[str, ...]:
        """Return their names."""
        return (TAU,) if self.n_parameters(n_legs) == 1 else super().names(n_legs) if self.scale is not None else ()

    def at_legs(self, values: Array, n_legs: int) -> Array:
        """Return something of the coordinates at each leg: zeros without a model error."""
        return np.zeros((*values.shape[:-1], n_legs)) if self.scale is None else super().at_legs(values, n_legs)


NO_MODEL_ERROR = ModelError(None)


@dataclass(frozen=True)
class KernelScale(LegTerm):
    """The scale s of an error that is a function of the pose (`bayescal.density.model_error`), of each leg or of all.

    How large it is in directions that the geometry imitates cannot be learnt from those that it does not: the scale is
    a tolerance, stated by whoever knows the machine, within a factor exp(spread). Whether there is such an error at all
    is for the data to say.

    Attributes
    ----------
    scale : float
        Median of s where there is an error, mm.
    spread : float
        Standard deviation of log s.
    shared : bool
        One scale for all legs.
    """

    scale: float
    spread: float
    shared: bool = True
    label = SCALE

    @property
    def prior(self) -> Prior:
        """Zero with probability one half, else log-normal."""
        return KernelScalePrior(self.scale, self.spread)


@dataclass(frozen=True)
class KernelLength(LegTerm):
    """The length of a kernel, in ranges of the actuators: log-normal, one amplitude for all legs."""

    lengths: LogNormalPrior
    label = LENGTH
    shared = True

    @property
    def prior(self) -> Prior:
        """Log-normal."""
        return self.lengths

    def at_legs(self, values: Array, n_legs: int) -> Array:
        """Return the one value there is."""
        return values


@dataclass(frozen=True)
class Outliers:
    """Poses that may be outliers, with a probability that is inferred.

    A measured pose errs by e_n, of covariance C_n as everywhere, or it is an outlier: it was named wrongly, a target
    was covered, the machine had not settled. With the share ε of outliers

        p(e_n) = (1 - ε) N(e_n; 0, C_n) + ε t_ν(e_n; 0, κ² C_n),    ε ~ Beta(1, 1/m - 1),

    m the share that is expected, ν = 1 and κ = 3: so heavy a tail holds outliers of ten and of a thousand deviations
    alike (contaminated normal, Tukey 1960; the weights are those of Box and Tiao 1968). The probability that pose n is
    one, ε t_ν(e_n) / p(e_n), is averaged over the posterior. Outliers have nothing to do with the model error τ, which
    all poses have.

    Attributes
    ----------
    share : SharePrior
        Of ε, whose coordinate is standard normal under the prior.
    """

    share: SharePrior

    def shares(self, zeta: Array) -> Array:
        """Return ε of coordinates (...)."""
        return self.share.value(zeta)

    def add(self, square: Array, n_rows: np.ndarray, share: Array) -> Array:
        """Return log p(e_n) - log N(e_n; 0, C_n) from eᵀ C⁻¹ e (..., P) of poses with rows (P,) and ε (..., 1)."""
        return np.logaddexp(np.log1p(-share), np.log(share) + compare_outlier(square, n_rows))

    def probability(self, square: Array, n_rows: np.ndarray, share: Array) -> Array:
        """Return ε t / p; arguments as in `add`."""
        odds = np.log(share) - np.log1p(-share) + compare_outlier(square, n_rows)
        return np.asarray(1.0 / (1.0 + np.exp(-odds)))

    def weigh(self, square: Array, n_rows: np.ndarray, share: Array) -> tuple[Array, Array]:
        """Return how much each pose counts, -2 d log p / d square, and its probability of being an outlier."""
        outlier = self.probability(square, n_rows, share)
        tail = (FREEDOM + n_rows) / (FREEDOM * WIDER**2 + square)
        return (1.0 - outlier) + outlier * tail, outlier


def compare_outlier(square: Array, n_rows: np.ndarray | int) -> Array:
    """Return log t_ν(e; 0, κ² C) - log N(e; 0, C) from eᵀ C⁻¹ e of K rows, elementwise."""
    half, nu = 0.5 * np.asarray(n_rows), FREEDOM
    constant = gammaln(0.5 * nu + half) - gammaln(0.5 * nu) - half * np.log(0.5 * nu) - n_rows * np.log(WIDER)
    return np.asarray(constant + 0.5 * square - (0.5 * nu + half) * np.log1p(square / (nu * WIDER**2)))


@dataclass(frozen=True)
class LegErrors(ErrorCoordinates):
    """All errors of the legs' density: terms and outliers, in the order of their coordinates.

    Attributes
    ----------
    n_legs : int
        N.
    terms : sequence of LegTerm
        The model error τ first, even where there is none.
    outliers : Outliers or None
    """

    n_legs: int
    terms: Sequence[LegTerm]
    outliers: Outliers | None = None

    @cached_property
    def _places(self) -> list[slice]:
        """Where each term's coordinates are."""
        ends = np.cumsum([0, *(term.n_parameters(self.n_legs) for term in self.terms)])
        return [slice(int(a), int(b)) for a, b in pairwise(ends)]

    def place(self, label: str) -> slice:
        """Return where the coordinates of a term are, none where there is no such term."""
        found = [place for term, place in zip(self.terms, self._places, strict=True) if term.label == label]
        return found[0] if found else slice(0, 0)

    @property
    def n_amplitudes(self) -> int:
        """Number of coordinates that amplitudes have."""
        return int(self._places[-1].stop)

    @property
    def model_error(self) -> ModelError:
        """The model error τ, or none."""
        found = self.terms[0]
        assert isinstance(found, ModelError)
        return found

    @property
    def units(self) -> tuple[str, ...]:
        """Units of what is free."""
        return tuple("1" if name in (LENGTH, SHARE) else "mm" for name in self.names)

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Names of what is free."""
        names = tuple(name for term in self.terms for name in term.names(self.n_legs))
        return names if self.outliers is None else (*names, SHARE)

    @property
    def priors(self) -> tuple[Prior, ...]:
        """Priors of what is free, in order."""
        found = [term.prior for term in self.terms for _ in term.names(self.n_legs)]
        return tuple(found if self.outliers is None else [*found, self.outliers.share])

    def _each(self, zeta: Array) -> list[tuple[LegTerm, Array]]:
        return [(term, zeta[..., place]) for term, place in zip(self.terms, self._places, strict=True)]

    def amplitudes(self, zeta: Array) -> Array:
        """Return the amplitudes of all terms, (..., K), or (K,) for any ζ where none is free."""
        if not self.n_amplitudes:
            zeta = np.zeros(0)
        found = [term.at_legs(term.prior.value(own), self.n_legs) for term, own in self._each(zeta)]
        return np.concatenate(found, axis=-1)

    def uniform(self, size: float) -> Array:
        """Return amplitudes (K,) that are alike for all legs, mm, with which a search for the mode begins."""
        middle, every = np.zeros(1), np.full(self.n_legs, size)
        return np.concatenate([term.prior.value(middle) if term.label == LENGTH else every for term in self.terms])

    def tau(self, zeta: Array) -> Array:
        """Return the model error of each leg, mm: the first of the amplitudes."""
        return self.amplitudes(zeta)[..., : self.n_legs]

    def shares(self, zeta: Array) -> Array:
        """Return ε, (...)."""
        assert self.outliers is not None
        return self.outliers.shares(zeta[..., -1])

    def slopes(self, zeta: Array) -> Array:
        """Return the derivative of the amplitudes by their coordinates at ζ (k,), shape (k', K)."""
        return self._spread([term.prior.slope(own) for term, own in self._each(zeta)])

    def curvatures(self, zeta: Array) -> Array:
        """Return the second derivative, shape (k', K)."""
        return self._spread([term.prior.curvature(own) for term, own in self._each(zeta)])

    def _spread(self, values: list[Array]) -> Array:
        own = [
            np.diag(value) if len(value) and not term.shared else term.at_legs(value[:, None], self.n_legs)
            for term, value in zip(self.terms, values, strict=True)
        ]
        result = np.zeros((self.n_amplitudes, sum(one.shape[1] for one in own)))
        column = 0
        for one, place in zip(own, self._places, strict=True):
            result[place, column : column + one.shape[1]] = one
            column += one.shape[1]
        return result

    def mean_square_tau(self, natural: Array) -> float:
        """Return the mean of τ² over draws in natural units (..., k) and over legs, mm²; zero without model error."""
        tau = natural[..., self.place(TAU)]
        return float(np.mean(tau**2)) if tau.shape[-1] else 0.0
