"""Errors of readings as a composition of terms, each a cause with unknowns of its own.

A row's readings err by noise of covariance f_i C_ij f_j + δ_ij v_i and by what is linear in coefficients that all rows
share,

    s_n = h(θ, v_n) + Φ_n(ζ) u + ε_n,    u ~ N(0, 1),

with C the stated covariance. A term with coordinates ζ supplies one of three: a factor f on the stated deviations, a
variance v added to them, or columns Φ. All terms hold together, and with outliers, which are of a row as a whole.

A user-defined term is a class: names, units and priors of its coordinates, and `ErrorTerm.variance` or
`ErrorTerm.columns`. In a config it stands as ``[error_terms.NAME]`` with ``kind = "own_term.py:OwnTerm"`` and the
keys of its ``Config``.
"""

from __future__ import annotations

from abc import ABC
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from typing import Any, ClassVar, NamedTuple, Self

import numpy as np

from bayescal.config.sections import Section
from bayescal.density.calibration.measurements import Measurements, RowPositions
from bayescal.density.outliers import NORMAL, Outliers
from bayescal.density.priors import HalfNormalPrior, LogNormalPrior, Prior
from bayescal.errors import BayescalError, InputError
from bayescal.machines.readings import ReadingModel
from bayescal.numerics.geometry import Array
from bayescal.numerics.heavy_tails import find_most

TERM_STEP = 1e-5  # of a coordinate, for slopes of a term that states none


class TermDerivatives(NamedTuple):
    """Derivatives by the n coordinates of a term: of log f (n, P, K), of v (n, P, K), of Φ (n, P, K, N)."""

    log_factor: Array | None = None
    variance: Array | None = None
    columns: Array | None = None


@dataclass(frozen=True, eq=False)
class TermRows:
    """What a term of a config is made for.

    Attributes
    ----------
    name : str
        Of its section.
    model : ReadingModel
        The machine with the K channels that are read.
    data : Measurements
        All rows, those that are held back too.
    groups : tuple of str
        Of the channels, empty for those without noise.
    reach : ndarray, shape (K,)
        How far readings go from those at home over the workspace, in the channels' units.
    home : ndarray, shape (K,)
        What the machine as expected reads at home.
    positions : RowPositions
        Where the channels stand at all rows: what errors that depend on the position are functions of.
    """

    name: str
    model: ReadingModel
    data: Measurements
    groups: tuple[str, ...]
    reach: Array
    home: Array
    positions: RowPositions

    def select(self, names: Sequence[str] | None) -> np.ndarray:
        """Return the places of channels, kinds or groups of them, the machine's own channels for None.

        Raises
        ------
        InputError
            For a name that no channel has, or where there is none left.
        """
        channels = self.model.channels
        if names is None:
            return np.flatnonzero([not one.external for one in channels])
        known = [(one.name, one.kind, group) for one, group in zip(channels, self.groups, strict=True)]
        for name in names:
            if not any(name in some for some in known):
                all_names = ", ".join(dict.fromkeys(filter(None, (n for some in known for n in some[1:]))))
                raise InputError(f"found channel {name!r}, expected one of {all_names}")
        return np.flatnonzero([any(name in some for name in names) for some in known])


class ErrorTerm(ABC):
    """A cause of errors with n coordinates of its own, standard normal under the prior about their places.

    Attributes
    ----------
    Config : type of Section
        Its section of a config; nothing by default.
    names, units : tuple of str, length n
        Of what is unknown of it.
    priors : tuple of Prior, length n
        Of the same, in these units.

    Examples
    --------
    Vibration, a noise beside the stated one that all channels have:

    >>> from bayescal.density.priors import HalfNormalPrior
    >>> class Vibration(bc.ErrorTerm):
    ...     names, units, priors = ("vibration",), ("mm",), (HalfNormalPrior(0.01),)
    ...
    ...     def variance(self, zeta, data):
    ...         return np.broadcast_to(self.natural(zeta)[:, :, None] ** 2, (len(zeta), *data.sd.shape))
    >>> Vibration().natural(np.array([0.0])).round(4)
    array([0.0067])
    """

    Config: ClassVar[type[Section]] = Section
    sign: ClassVar[float] = 1.0
    """Of what its columns add to the covariance of all rows."""
    of_model: ClassVar[bool] = False
    """Whether its columns are errors of the machine's model, and show in the readings as its `error_gain` says."""
    is_known: ClassVar[bool] = False
    """Whether nothing of its columns is unknown but their coefficients."""
    names: tuple[str, ...]
    units: tuple[str, ...]
    priors: tuple[Prior, ...]

    @classmethod
    def build(cls, config: Any, rows: TermRows) -> Self:
        """Return the term of a checked section; by default the class is called with both."""
        return cls(config, rows)  # type: ignore[call-arg]  # a user-defined class has that constructor, or its own build

    @property
    def concerns(self) -> np.ndarray | None:
        """Which channels' noise it changes, by a factor or a variance, shape (K,), bool; None for all."""
        return None

    def natural(self, zeta: Array) -> Array:
        """Return what is unknown in its own units, (..., n)."""
        return np.stack([prior.value(zeta[..., k]) for k, prior in enumerate(self.priors)], axis=-1)

    def with_floors(self, floors: Mapping[str, float]) -> Self:
        """Return the same term with the floors of sorts of functions of the pose, mm, that are named, and no others."""
        del floors
        return self

    # --- what it does: one of three ----------------------------------------------------------------------------------

    def factor(self, zeta: Array) -> Array | None:
        """Return the factor f on stated deviations, (B, n) to (B, K); by default there is none."""
        del zeta
        return None

    def variance(self, zeta: Array, data: Measurements) -> Array | None:
        """Return the variance v beside the stated noise, (B, n) to (B, P, K); by default there is none."""
        del zeta, data
        return None

    def columns(self, zeta: Array, data: Measurements) -> Array | None:
        """Return Φ, what coefficients do to readings, (B, n) to (B, P, K, N) or (1, P, K, N); by default nothing."""
        del zeta, data
        return None

    def act(self, data: Measurements) -> Array | None:
        """Return Φ of an amplitude of one, (P, K, N), where Φ is that times an amplitude; by default it is not."""
        del data
        return None

    def amplitude(self, zeta: Array) -> Array:
        """Return that amplitude, (..., n) to (...,)."""
        return np.zeros(zeta.shape[:-1])

    def slopes(self, zeta: Array, data: Measurements) -> TermDerivatives:
        """Return the derivatives at ζ, shape (n,); by central differences where a term states none."""
        moved = zeta + TERM_STEP * np.concatenate([np.eye(len(zeta)), -np.eye(len(zeta))])
        factor, variance, columns = self.factor(moved), self.variance(moved, data), self.columns(moved, data)
        return TermDerivatives(
            None if factor is None else np.broadcast_to(_differ(np.log(factor))[:, None], (len(zeta), *data.sd.shape)),
            None if variance is None else np.broadcast_to(_differ(variance), (len(zeta), *data.sd.shape)),
            None if columns is None or len(columns) == 1 else _differ(columns),
        )


def _differ(values: Array) -> Array:
    plus, minus = np.split(values, 2)
    return np.asarray((plus - minus) / (2.0 * TERM_STEP))


@dataclass(frozen=True, eq=False)
class GroupTerm(ErrorTerm):
    """A term with one unknown, which changes the noise of a group of channels."""

    label: str  # of the group
    channels: np.ndarray  # (K,)
    scale: float  # of its prior
    unit: str = "1"
    what: ClassVar[str]

    @property
    def concerns(self) -> np.ndarray:
        """Its channels."""
        return self.channels

    @property
    def names(self) -> tuple[str, ...]:  # type: ignore[override]
        """``model_error(motor)`` and the like."""
        return (f"{self.what}({self.label})",)

    @property
    def units(self) -> tuple[str, ...]:  # type: ignore[override]
        """The one unit."""
        return (self.unit,)


class NoiseFactor(GroupTerm):
    """An unknown factor on the stated noise, log-normal about one; ``scale`` is the sd of its logarithm."""

    what = "noise_factor"

    @property
    def priors(self) -> tuple[Prior, ...]:  # type: ignore[override]
        """Log-normal."""
        return (LogNormalPrior(1.0, self.scale),)

    def factor(self, zeta: Array) -> Array:
        """Return it for its channels, one for the others."""
        return np.where(self.channels, self.priors[0].value(zeta), 1.0)

    def slopes(self, zeta: Array, data: Measurements) -> TermDerivatives:
        """Return that of its logarithm."""
        del zeta
        return TermDerivatives(
            log_factor=np.broadcast_to(np.where(self.channels, self.scale, 0.0), (1, *data.sd.shape))
        )


@dataclass(frozen=True, eq=False)
class ModelErrorTerm(GroupTerm):
    """An error τ that the stated noise lacks, drawn independently at every row, half normal; of variance τ² + floor².

    ``levers`` (K,): by how many units of τ one unit of each channel counts; one where τ is in the channels' unit.
    """

    levers: Array | float = 1.0
    floor: float = 0.0
    what = "model_error"

    @property
    def priors(self) -> tuple[Prior, ...]:  # type: ignore[override]
        """Half normal."""
        return (HalfNormalPrior(self.scale),)

    def variance(self, zeta: Array, data: Measurements) -> Array:
        """Return τ² + floor² for its channels, zero for the others."""
        del data
        square = self.priors[0].value(zeta) ** 2 + self.floor**2
        return np.where(self.channels, square / np.square(self.levers), 0.0)[:, None]

    def slopes(self, zeta: Array, data: Measurements) -> TermDerivatives:
        """Return 2 τ dτ/dζ."""
        prior = self.priors[0]
        slope = np.where(self.channels, 2.0 * prior.value(zeta) * prior.slope(zeta) / np.square(self.levers), 0.0)
        return TermDerivatives(variance=np.broadcast_to(slope, (1, *data.sd.shape)))


@dataclass(frozen=True, eq=False)
class CorrelatedNoise(ErrorTerm):
    """Errors that all rows have in common and that are known but for their coefficients, standard normal ones.

    Noise that is correlated with them takes a second such term, whose columns are taken away from the covariance: with
    k ~ N(0, 1) in columns A and cov(noise, k) = G, the covariance is (A + G)(A + G)ᵀ - G Gᵀ beside that of the noise.

    ``design`` (M, K, N): columns at all rows that were read, held-back ones too.
    """

    is_known: ClassVar[bool] = True
    design: Array
    sign: float = 1.0  # type: ignore[misc]  # of its own
    names: tuple[str, ...] = ()
    units: tuple[str, ...] = ()
    priors: tuple[Prior, ...] = ()

    def columns(self, zeta: Array, data: Measurements) -> Array:
        """Return those of the rows, (1, P, K, N)."""
        del zeta
        return self.design[data.order][None]

    def act(self, data: Measurements) -> Array:
        """Return the same."""
        return np.asarray(self.design[data.order])

    def amplitude(self, zeta: Array) -> Array:
        """Return one."""
        return np.ones(zeta.shape[:-1])


@dataclass(frozen=True, eq=False)
class ErrorModel:
    """All terms together, and what rows are like that are wrong as a whole.

    Coordinates ζ of what is unknown are the terms' in their order, then the outliers': as their priors say, standard
    normal about their places.
    """

    terms: tuple[ErrorTerm, ...] = ()
    outliers: Outliers = NORMAL

    # --- coordinates -------------------------------------------------------------------------------------------------

    @cached_property
    def _slices(self) -> list[slice]:
        ends = np.cumsum([0, *(len(term.names) for term in self.terms)])
        return [slice(int(a), int(b)) for a, b in pairwise(ends)]

    @cached_property
    def _parts(self) -> tuple[ErrorTerm | Outliers, ...]:
        return (*self.terms, self.outliers)

    @cached_property
    def owners(self) -> tuple[ErrorTerm | None, ...]:
        """The term of each of the k unknowns; None for those of the outliers."""
        own = [one for one in self.terms for _ in one.names]
        return (*own, *(None for _ in self.outliers.names))

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Names of the k unknowns."""
        return tuple(name for part in self._parts for name in part.names)

    @cached_property
    def units(self) -> tuple[str, ...]:
        """Units of the same."""
        return tuple(unit for part in self._parts for unit in part.units)

    @cached_property
    def priors(self) -> tuple[Prior, ...]:
        """Priors of the same, in these units."""
        return tuple(prior for part in self._parts for prior in part.priors)

    @property
    def n_parameters(self) -> int:
        """Number k of coordinates."""
        return len(self.names)

    @cached_property
    def switches(self) -> dict[int, float]:
        """Coordinates with a second place, at which there is no such error, each with that place."""
        return {k: prior.off for k, prior in enumerate(self.priors) if prior.off is not None}

    def with_floors(self, floors: Mapping[str, float]) -> Self:
        """Return the same with floors of functions of the pose by sort, mm, instead of those that they have."""
        return replace(self, terms=tuple(term.with_floors(floors) for term in self.terms))

    @property
    def log_mass(self) -> float:
        """What the log-prior has beside the normal density of the deviations: half for each place of a switch."""
        return -len(self.switches) * float(np.log(2.0))

    def natural(self, zeta: Array) -> Array:
        """Return what is unknown in its own units, (..., k)."""
        found = [prior.value(zeta[..., k]) for k, prior in enumerate(self.priors)]
        return np.stack(found, axis=-1) if found else np.zeros(zeta.shape)

    def deviations(self, zeta: Array) -> Array:
        """Return coordinates less their places, standard normal under the prior, (..., k)."""
        found = zeta.copy()
        for k, place in self.switches.items():
            found[..., k] -= np.where(zeta[..., k] > 0.5 * place, 0.0, place)
        return found

    def draw(self, standard: Array, rng: np.random.Generator) -> Array:
        """Return coordinates of the prior from standard normal numbers (S, k), half of the switches off."""
        found, places = standard.copy(), list(self.switches)
        off = rng.random((len(found), len(places))) < 0.5 if places else np.zeros((len(found), 0), dtype=bool)
        found[:, places] += np.where(off, list(self.switches.values()), 0.0)
        return found

    def mode_candidates(self, zeta: Array) -> list[tuple[int, Array]]:
        """Return each error switched on or off, seen from ζ (k,), with the number of its coordinate."""
        found = []
        for k, place in self.switches.items():
            image = zeta.copy()
            image[k] = place if zeta[k] > 0.5 * place else 0.0
            found.append((k, image))
        return found

    def of(self, zeta: Array) -> Sequence[tuple[ErrorTerm, Array]]:
        """Return each term with its coordinates (..., n_t) of all of them (..., n)."""
        return [(term, zeta[..., part]) for term, part in zip(self.terms, self._slices, strict=True)]

    def tails(self, zeta: Array) -> Outliers:
        """Return the density of white residuals at coordinates (B, k)."""
        return self.outliers.at(zeta[:, len(self.names) - len(self.outliers.names) :])

    # --- terms of a class --------------------------------------------------------------------------------------------

    def terms_of[T: ErrorTerm](self, kind: type[T]) -> list[T]:
        """Return the terms of a class."""
        return [one for one in self.terms if isinstance(one, kind)]

    def parts_of[T: ErrorTerm](self, kind: type[T], zeta: Array) -> list[tuple[T, Array]]:
        """Return the same with their coordinates, as `of` does."""
        return self.select_of(kind, (own for _, own in self.of(zeta)))

    def select_of[T: ErrorTerm, X](self, kind: type[T], each: Iterable[X]) -> list[tuple[T, X]]:
        """Return the terms of a class, each with its own of what is listed term by term."""
        return [(one, own) for one, own in zip(self.terms, each, strict=True) if isinstance(one, kind)]

    def change[T: ErrorTerm](self, kind: type[T], to: Callable[[T], ErrorTerm]) -> Self:
        """Return the same with other terms in the places of those of a class."""
        return replace(self, terms=tuple(to(one) if isinstance(one, kind) else one for one in self.terms))

    def without(self, terms: Iterable[ErrorTerm]) -> Self:
        """Return the same without some terms, which are compared by identity: user-defined ones may hold arrays."""
        left_out = {id(one) for one in terms}
        return replace(self, terms=tuple(one for one in self.terms if id(one) not in left_out))

    # --- sizes over draws --------------------------------------------------------------------------------------------

    def limit(self, zeta: Array) -> Array:
        """Return draws (T, k) for mean squares: sizes of errors that data hardly determine are cut off.

        See `bayescal.numerics.heavy_tails`: their root mean square is then that of a normal error with their 90 %
        interval, and no longer that of a few draws. Factors on the noise, and what may be negative, are no sizes.
        """
        found = zeta.copy()
        adding = [type(term).factor is ErrorTerm.factor for term in self.terms for _ in term.names]
        for k in np.flatnonzero(adding):
            sizes = self.priors[k].value(zeta[:, k])
            if (sizes >= 0.0).all() and np.isfinite(most := find_most(sizes)):
                found[:, k] = np.minimum(zeta[:, k], self.priors[k].standardise(np.array(most)))
        return found

    # --- what they do ------------------------------------------------------------------------------------------------

    def noise(self, zeta: Array, data: Measurements, sd: Array) -> tuple[Array, Array]:
        """Return f σ and the root of all variances beside, (B, P, K) and (B, 1 or P, K), at (B, n) and σ (P, K)."""
        own, beside = np.broadcast_to(sd, (len(zeta), *sd.shape)), np.zeros((len(zeta), 1, sd.shape[1]))
        for term, part in self.of(zeta):
            factor, variance = term.factor(part), term.variance(part, data)
            own = own if factor is None else factor[:, None] * own
            beside = beside if variance is None else beside + variance
        return own, np.sqrt(beside)

    @cached_property
    def has_columns(self) -> bool:
        """Whether some errors are common to all rows."""
        return bool(self.common)

    @cached_property
    def common(self) -> list[ErrorTerm]:
        """The terms with columns, errors common to all rows."""
        return [term for term in self.terms if type(term).columns is not ErrorTerm.columns]

    def list_acts(self, data: Measurements, gain: Array | None = None) -> list[Array]:
        """Return `ErrorTerm.act` of the terms with columns, (P, K, N) each; none where one has no single amplitude."""
        acts = [_show(term, term.act(data), gain) for term in self.common]
        found = [one for one in acts if one is not None]
        return found if len(found) == len(acts) else []

    def amplitudes(self, zeta: Array) -> Array:
        """Return the amplitudes of the same terms, (B, k) to (B, C)."""
        return np.stack([term.amplitude(own) for term, own in self.of(zeta) if term in self.common], axis=-1)

    def weights(self, zeta: Array) -> Array:
        """Return by how much the squares of these terms' columns count in the covariance of all rows, (B, C)."""
        return np.asarray(self.amplitudes(zeta) ** 2 * [term.sign for term in self.common])

    def signs(self, data: Measurements) -> Array | None:
        """Return the sign of each of N columns, (N,); None where all of them add to the covariance."""
        if all(term.sign > 0.0 for term in self.common):
            return None
        zeta = np.zeros((1, self.n_parameters))
        widths = [(t.sign, c.shape[-1]) for t, part in self.of(zeta) if (c := t.columns(part, data)) is not None]
        return np.concatenate([np.full(width, sign) for sign, width in widths])

    @cached_property
    def known(self) -> list[CorrelatedNoise]:
        """The terms with columns of which nothing is unknown but their coefficients."""
        return self.terms_of(CorrelatedNoise)

    @property
    def is_common_known(self) -> bool:
        """Whether what rows have in common is known but for its coefficients, and there is any."""
        return self.has_columns and len(self.known) == len(self.common)

    @cached_property
    def noisy(self) -> list[ErrorTerm]:
        """The terms that change the noise of single rows."""
        factor, variance = ErrorTerm.factor, ErrorTerm.variance
        return [one for one in self.terms if type(one).factor is not factor or type(one).variance is not variance]

    @property
    def has_factors(self) -> bool:
        """Whether a stated noise is known but for a factor."""
        return any(one.factor(np.zeros((1, len(one.names)))) is not None for one in self.noisy)

    def groups(self, n_channels: int) -> Array:
        """Return which of K channels have the same unknowns of their noise, or none, ones and zeros (N, K)."""
        every = np.ones(n_channels, dtype=bool)
        both = [every if term.concerns is None else term.concerns for term in self.noisy]
        keys = [tuple(j for j, mine in enumerate(both) if mine[k]) for k in range(n_channels)]
        return np.array([[key == kind for key in keys] for kind in sorted(set(keys))], dtype=np.float64)

    def is_known(self, n_channels: int) -> np.ndarray:
        """Return of which of K channels nothing of the noise is unknown, shape (K,)."""
        concerned = [np.ones(n_channels, bool) if one.concerns is None else one.concerns for one in self.noisy]
        return ~np.any(concerned, axis=0)

    def columns(self, zeta: Array, data: Measurements, gain: Array | None = None) -> Array:
        """Return Φ of all terms side by side, (B, P, K, N), where model errors show by a gain (P, K, K), or as is."""
        found = [_show(term, term.columns(part, data), gain) for term, part in self.of(zeta)]
        shape = (len(zeta), *data.sd.shape)
        wide = [np.broadcast_to(one, (*shape, one.shape[-1])) for one in found if one is not None]
        return np.concatenate([np.zeros((*shape, 0)), *wide], axis=-1)

    def act(
        self, zeta: Array, data: Measurements, coefficients: Array, gain: Array | None = None
    ) -> list[Array | None]:
        """Return what coefficients (B, N) make of each term, (B, P, K); None of one without columns. See `columns`."""
        found: list[Array | None] = []
        start = 0
        for term, part in self.of(zeta):
            alike = _show(term, term.act(data), gain)
            own = _show(term, term.columns(part, data), gain) if alike is None else alike
            if own is None:
                found.append(None)
                continue
            some = coefficients[:, start : start + own.shape[-1]]
            if alike is None:
                found.append(np.asarray((own @ some[:, None, :, None])[..., 0]))
            else:
                found.append(term.amplitude(part)[:, None, None] * np.tensordot(some, alike, axes=(1, 2)))
            start += own.shape[-1]
        return found

    def draw_prior(self, zeta: Array, data: Measurements, rng: np.random.Generator) -> CommonDraws:
        """Return draws of the errors common to all rows before anything is read, one for each of (B, n)."""
        n = self.columns(zeta[:1], data).shape[-1]
        return CommonDraws(self, ((zeta, rng.standard_normal((len(zeta), n))),))

    def slopes(self, zeta: Array, data: Measurements) -> list[TermDerivatives]:
        """Return the derivatives at ζ, shape (n,), of each coordinate, without its axis."""
        found = []
        for term, part in self.of(zeta):
            own = term.slopes(part, data)
            found += [TermDerivatives(*(None if one is None else one[k] for one in own)) for k in range(len(part))]
        return found + [TermDerivatives()] * len(self.outliers.names)

    def column_slopes(self, zeta: Array, data: Measurements, gain: Array | None = None) -> Array:
        """Return the derivatives of Φ by all coordinates at ζ, shape (n,), (n, P, K, N); see `columns`."""
        widths = [
            0 if (own := term.columns(part[None], data)) is None else own.shape[-1] for term, part in self.of(zeta)
        ]
        result = np.zeros((len(zeta), *data.sd.shape, sum(widths)))
        start = 0
        for (term, part), where, width in zip(self.of(zeta), self._slices, widths, strict=True):
            own = _show(term, term.slopes(part, data).columns, gain) if width else None
            if own is not None:
                result[where, ..., start : start + width] = own
            start += width
        return result

    def covariance_slopes(
        self, zeta: Array, data: Measurements, sd: Array, correlation: Array, gain: Array | None = None
    ) -> Array:
        """Return the derivatives of the noise's covariance by the coordinates at ζ, shape (n,), (n, P, K, K).

        Parameters
        ----------
        zeta : ndarray, shape (n,)
        data : Measurements
        sd : ndarray, shape (P, K)
        correlation : ndarray, shape (P, K, K) or (1, K, K)
        gain : ndarray, shape (P, K, K), optional
            How model errors show in the readings; each in its own where it is None.
        """
        own = self.noise(zeta[None], data, sd)[0][0]
        stated = own[:, :, None] * correlation * own[:, None, :]
        result = np.zeros((len(zeta), *stated.shape))
        for k, one in enumerate(self.slopes(zeta, data)):
            if one.log_factor is not None:
                result[k] = stated * (one.log_factor[:, :, None] + one.log_factor[:, None, :])
            if one.variance is not None:
                shown = np.eye(sd.shape[1])[None] if gain is None else gain
                result[k] += (shown * one.variance[:, None, :]) @ np.swapaxes(shown, -1, -2)
        return result


NO_ERRORS = ErrorModel()


def _show(term: ErrorTerm, columns: Array | None, gain: Array | None) -> Array | None:
    """Return how columns (..., P, K, N) of a term show in the readings."""
    return columns if columns is None or gain is None or not term.of_model else gain @ columns


def check_term(term: ErrorTerm, data: Measurements) -> None:
    """Raise InputError where what a term of somebody else's class supplies does not fit together."""
    n, (n_poses, n_channels) = len(term.names), data.sd.shape
    for what, found in (("units", term.units), ("priors", term.priors)):
        if len(found) != n:
            raise InputError(f"found {len(found)} {what} for {n} names, expected one each")
    zeta = np.zeros((2, n))
    try:
        factor, variance, columns = term.factor(zeta), term.variance(zeta, data), term.columns(zeta, data)
    except BayescalError:
        raise
    except Exception as error:
        text = " ".join(str(error).split())
        raise InputError(f"found a term that fails with {type(error).__name__}: {text}") from error
    leading: dict[str, list[tuple[int, ...]]] = {
        "factor": [(2, n_channels)],
        "variance": [(2, n_poses, n_channels), (2, 1, n_channels)],
        "columns": [(2, n_poses, n_channels), (1, n_poses, n_channels)],
    }
    supplied = [pair for pair in zip(leading, (factor, variance, columns), strict=True) if pair[1] is not None]
    if len(supplied) != 1:
        raise InputError("expected factor, variance or columns")
    for what, one in supplied:
        assert one is not None
        expected = leading[what]
        if one.shape[: len(expected[0])] not in expected or one.ndim != len(expected[0]) + (what == "columns"):
            raise InputError(f"found {what} of shape {one.shape} for two machines, expected {expected[0]}")
        if not np.isfinite(one).all() or (what != "columns" and (one < 0.0).any()):
            raise InputError(f"found {what} that is not finite, or negative")


@dataclass(frozen=True, eq=False)
class CommonDraws:
    """Draws of the coefficients of errors common to all rows."""

    errors: ErrorModel
    # of some of the T draws each, (B, n) and (B, N): with a free length coefficients belong together with the others
    # that they were drawn with
    parts: tuple[tuple[Array, Array], ...]

    def by_term(self, data: Measurements, gain: Array | None = None) -> list[Array | None]:
        """Return what each term is at rows like these, (T, P, K), or does to readings by a gain (P, K, K).

        None of one without columns.
        """
        found = [self.errors.act(zeta, data, coefficients, gain) for zeta, coefficients in self.parts]
        return [None if one[0] is None else np.concatenate(one) for one in zip(*found, strict=True)]

    def at(self, data: Measurements, gain: Array | None = None) -> Array:
        """Return the same of all terms together."""
        return np.asarray(sum(one for one in self.by_term(data, gain) if one is not None))
