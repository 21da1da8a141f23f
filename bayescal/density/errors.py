"""What the legs of a machine err by beside their stated noise: terms as in `bayescal.density.calibration.terms`.

What is unknown of a term is its amplitudes, standard deviations in mm. A likelihood takes those of all terms one behind
the other: τ of each of the N legs; then, where the error has functions of the pose, the scale s of each sort.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Self

import numpy as np
from scipy.linalg import block_diag

from bayescal.density.calibration.terms import Errors, ErrorTerm
from bayescal.density.outliers import NORMAL, Outliers
from bayescal.density.priors import HalfCauchyPrior, HalfNormalPrior, Prior
from bayescal.numerics.geometry import Array

TAU, FUNCTION_SCALES = "tau", "functions"
OF_SORT = "sigma_"


@dataclass(frozen=True)
class Amplitudes(ErrorTerm):
    """A term of the legs' errors."""

    label: str
    names: tuple[str, ...]  # length n
    units: tuple[str, ...]  # length n
    priors: tuple[Prior, ...]  # length n
    # (n, K): which of the term's amplitudes each unknown is, ones and zeros; zeros alone where there is no such error
    shown: Array
    # length n: f of each unknown, in its unit; the amplitude of an unknown u is √(u² + f²)
    floors: tuple[float, ...]

    @classmethod
    def of_legs(cls, label: str, prior: Prior, n_legs: int, shared: bool, floor: float = 0.0) -> Amplitudes:
        """Return the amplitudes in mm of N legs, each with its own, or all alike."""
        names = (label,) if shared or n_legs == 1 else tuple(f"{label}[{leg}]" for leg in range(1, n_legs + 1))
        n, shown = len(names), np.ones((1, n_legs)) if shared else np.eye(n_legs)
        return cls(label, names, ("mm",) * n, (prior,) * n, shown, (floor,) * n)

    def floored(self, floors: Mapping[str, float]) -> Self:
        """Return the same with other floors of functions; see `ErrorTerm.floored`."""
        if self.label != FUNCTION_SCALES:
            return self
        return replace(self, floors=tuple(floors.get(name.removeprefix(OF_SORT), 0.0) for name in self.names))


@dataclass(frozen=True)
class ModelError:
    """The model error τ, drawn anew at every pose: half-normal with the given scale in mm, or none (scale None)."""

    scale: float | None
    shared: bool = False
    floor: float = 0.0  # mm; what is unknown adds to it in squares

    @property
    def prior(self) -> Prior:
        """Half-normal; of no width where there is none."""
        return HalfNormalPrior(self.scale or 0.0)

    def at_legs(self, n_legs: int) -> Amplitudes:
        """Return it as a term."""
        if self.scale is None:
            return Amplitudes(TAU, (), (), (), np.zeros((0, n_legs)), ())
        return Amplitudes.of_legs(TAU, self.prior, n_legs, self.shared, self.floor)


NO_MODEL_ERROR = ModelError(None)


@dataclass(frozen=True)
class FunctionScales:
    """The scales of errors that are functions of the pose, of several sorts at once, each alike for all legs."""

    sorts: tuple[str, ...]
    scale: float  # of their half-Cauchy densities, mm
    floors: Mapping[str, float] = field(default_factory=dict)  # by sort, mm; what is unknown adds to it in squares

    def at_legs(self, n_legs: int) -> Amplitudes:
        """Return them as a term."""
        del n_legs
        n = len(self.sorts)
        names = tuple(f"{OF_SORT}{name}" for name in self.sorts)
        floors = tuple(self.floors.get(name, 0.0) for name in self.sorts)
        return Amplitudes(FUNCTION_SCALES, names, ("mm",) * n, (HalfCauchyPrior(self.scale),) * n, np.eye(n), floors)


type LegTerm = ModelError | FunctionScales


@dataclass(frozen=True, eq=False)
class LegErrors(Errors):
    """All errors of the legs' density."""

    n_legs: int = 0  # N
    model_error: ModelError = NO_MODEL_ERROR  # that of the first term, τ, which stands there even if there is none

    @classmethod
    def of_legs(cls, n_legs: int, terms: Sequence[LegTerm], outliers: Outliers = NORMAL) -> LegErrors:
        """Return the errors of N legs with these terms, the model error first."""
        first = terms[0]
        assert isinstance(first, ModelError)
        return cls(tuple(term.at_legs(n_legs) for term in terms), outliers, n_legs, first)

    @cached_property
    def _shown(self) -> Array:
        """Which of all K amplitudes each unknown is, shape (k', K)."""
        return np.asarray(block_diag(*(term.shown for term in self._amplitudes)))

    @cached_property
    def _floors(self) -> Array:
        """The floors f of all K amplitudes, mm."""
        return np.concatenate([np.array(term.floors) @ term.shown for term in self._amplitudes])

    @property
    def _amplitudes(self) -> list[Amplitudes]:
        return [term for term in self.terms if isinstance(term, Amplitudes)]

    def place(self, label: str) -> slice:
        """Return where the coordinates of a term are, none where there is no such term."""
        pairs = zip(self.terms, self._slices, strict=True)
        return next((place for term, place in pairs if isinstance(term, Amplitudes) and term.label == label), slice(0))

    @property
    def n_amplitudes(self) -> int:
        """Number k' of coordinates that amplitudes have."""
        return len(self._shown)

    def _show(self, what: str, zeta: Array) -> Array:
        """Return something that priors know of their coordinates, (..., k')."""
        found = [getattr(term.priors[0], what)(own) for term, own in self.of(zeta) if term.priors]
        return np.concatenate(found, axis=-1) if found else np.zeros((*zeta.shape[:-1], 0))

    def amplitudes(self, zeta: Array) -> Array:
        """Return the amplitudes of all terms, (..., K), or (K,) for any ζ where none is free."""
        if not self.n_amplitudes:
            return np.zeros(self._shown.shape[1])
        return self._lift(self._show("value", zeta) @ self._shown)

    def amplitudes_of(self, natural: Array) -> Array:
        """Return the amplitudes of all terms, (..., K), of what is unknown in its own units, (..., k)."""
        found = [own for term, own in self.of(natural) if isinstance(term, Amplitudes)]
        return self._lift(np.concatenate(found, axis=-1) @ self._shown)

    def _lift(self, unknown: Array) -> Array:
        """Return the amplitudes √(u² + f²) of unknowns, (..., K)."""
        return np.hypot(unknown, self._floors) if self._floors.any() else np.asarray(unknown)

    def uniform(self, size: float) -> Array:
        """Return amplitudes (K,) that are alike for all legs, mm, with which a search for the mode begins."""
        return np.full(self._shown.shape[1], size)

    def tau(self, zeta: Array) -> Array:
        """Return the model error of each leg, mm: the first of the amplitudes."""
        return self.amplitudes(zeta)[..., : self.n_legs]

    def slopes_of_amplitudes(self, zeta: Array) -> Array:
        """Return the derivative of the amplitudes by their coordinates at ζ (k,), shape (k', K): u' u / √(u² + f²)."""
        return np.asarray(self._show("slope", zeta)[:, None] * self._shown * self._share(zeta)[0])

    def curvatures_of_amplitudes(self, zeta: Array) -> Array:
        """Return the second derivative, shape (k', K)."""
        share, left = self._share(zeta)
        slope, curvature = (self._show(what, zeta)[:, None] * self._shown for what in ("slope", "curvature"))
        return np.asarray(curvature * share + slope**2 * left)

    def _share(self, zeta: Array) -> tuple[Array, Array]:
        """Return first and second derivatives of the amplitudes by the unknowns at ζ (k,): u / a and f² / a³, (K,)."""
        unknown, floors = self._show("value", zeta) @ self._shown, self._floors
        there, amplitude = floors > 0.0, np.hypot(unknown, floors)
        lifted = np.where(there, amplitude, 1.0)
        return np.where(there, unknown / lifted, 1.0), np.where(there, floors**2 / lifted**3, 0.0)
