"""Errors that are functions: a scale that is off, an encoder that sits askew, a drift.

Function k errs a channel by a random function of an input z that is known, the same every time,

    g_k(z) ~ GP(0, s_k² κ(z, z')),    g_k(0) = 0,

z being the channel's own reading, the machine's coordinates as read from some channels, or the order of the rows; κ as
in `bayescal.density.priors`. Readings count as their travel from home in units of their range. That z is taken
from readings with their error and noise instead of the true ones changes g by g' (g + ε), of relative size s over the
range: some 1e-4.

How large such functions are in directions that the geometry imitates cannot be learnt from those that it does not: the
scale s is a tolerance, switched on or off by the data.

Functions of one variable are told by their values at a few nodes: between Chebyshev's they are interpolated by
polynomials, exactly for linear and quadratic ones, to `EXACT` for smooth ones. For those of several the rows are the
nodes. What is random is then a handful of coefficients of each function, which all rows share.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Annotated, ClassVar, Literal, Self

import numpy as np
from numpy.polynomial.chebyshev import chebpts1, chebvander
from pydantic import Field, model_validator

from bayescal.config.sections import Names, Positive, Section
from bayescal.density.calibration.measurements import Measurements, RowPositions
from bayescal.density.calibration.terms import ErrorTerm, TermDerivatives, TermRows
from bayescal.density.priors import (
    BORDER,
    LENGTH,
    LENGTHY,
    SCALE,
    Kernel,
    KernelScalePrior,
    LogNormalPrior,
    Prior,
    build_kernel,
)
from bayescal.errors import InputError
from bayescal.numerics.geometry import Array
from bayescal.numerics.units import SCALES

EXACT = 1e-12  # of the kernel's largest value, what interpolation may leave out, and of its eigenvalues
MOST_NODES = 48
ENDS = 3.0  # sds of log L on either side of its median; shorter and longer ones are taken for the outermost
FEWEST = {"linear": 2, "quadratic": 3, "smooth": 4}
PROBES = 301
MARGIN = 1.05  # of the largest travel of all rows, up to where functions are told
SUFFIXED = {f"scale_{name}": found for name, found in SCALES.items()}

type Input = Literal["reading", "commands", "order"]


class FunctionConfig(Section):
    """Errors that are functions, each of a channel; their scale is what a channel errs by at the end of its range.

    What they are functions of counts as travel from home, in units of how far readings go from there over the
    workspace; the order of the rows from the first to the last.
    """

    channels: Annotated[Names, Field(min_length=1)] | None = None
    """Channels, kinds or groups of them that err so; the machine's own where nothing is said."""
    input: Input = "reading"
    """What they are functions of: each channel's own `reading` (its command, or what the fitted machine reads at the
    row's pose), where the machine stands by its own channels (`commands`), or the `order` of the rows.
    """
    input_channels: Annotated[Names, Field(min_length=1)] | None = None
    """Channels that say where the machine stands; those commanded, or all of its own, where nothing is said."""
    kernel: Literal["linear", "quadratic", "smooth"] = "smooth"
    """What sort of functions: `linear`, `quadratic` (linear and quadratic), or `smooth`."""
    scale: Positive | None = None
    """What a channel errs by at the end of its range, one standard deviation, where there is an error [unit of the
    channel].
    """
    scale_um: Positive | None = None
    """The same."""
    scale_mm: Positive | None = None
    """The same."""
    scale_arcsec: Positive | None = None
    """The same."""
    scale_deg: Positive | None = None
    """The same."""
    scale_rad: Positive | None = None
    """The same."""
    log_scale_sd: Positive = 0.05
    """Standard deviation of the logarithm of that scale [1]."""
    length_scale: Positive = 5.0
    """Over how far quadratic and smooth functions change [ranges]."""
    log_length_scale_sd: Positive | None = None
    """Standard deviation of the logarithm of that length, free about its median; it is known where nothing is said
    [1].
    """
    shared: bool = True
    """Whether all channels share a scale and a switch, or each has its own."""

    @model_validator(mode="after")
    def _check_scale(self) -> Self:
        given = [name for name in ("scale", *SUFFIXED) if getattr(self, name) is not None]
        if len(given) != 1:
            found = " and ".join(given) or "no scale"
            raise ValueError(f"found {found}, expected one of scale, {', '.join(SUFFIXED)}")
        return self

    def scale_in(self, name: str, unit: str) -> float:
        """Return the scale in a channel's unit; InputError where it is stated in one of another kind."""
        given = next(key for key in ("scale", *SUFFIXED) if getattr(self, key) is not None)
        inner, factor = SUFFIXED.get(given, (unit, 1.0))
        if inner != unit or (given == "scale" and unit in ("mm", "rad")):
            expected = [key for key, (one, _) in SUFFIXED.items() if one == unit] or ["scale"]
            raise InputError(f"found {given} for {name}, which reads in {unit}, expected {' or '.join(expected)}")
        return float(getattr(self, given)) * factor


@dataclass(frozen=True, eq=False)
class Travel:
    """What functions depend on."""

    # ``reading``: each function of its own channel's reading; ``commands``: all of some channels' readings;
    # ``order``: all of the rows' places in the tables
    of: Input
    channels: np.ndarray  # (D,): which readings; none for the order
    # (D,): what they read at home, and the unit of their travel; for the order its first place and its length
    home: Array
    range: Array  # (D,)
    positions: RowPositions | None = None  # of the D readings; what was read where there are none

    def of_rows(self, data: Measurements) -> Array:
        """Return z, (P, F, 1) by function where each has its own, (P, 1, D) where all have the same."""
        if self.of == "order":
            return np.asarray((data.order[:, None, None] - self.home) / self.range)
        values = data.values[:, self.channels]
        stood = values if self.positions is None else self.positions.at(data, values)
        own = (np.where(np.isfinite(values), stood, np.nan) - self.home) / self.range
        own = np.where(np.isfinite(own), own, 0.0)  # a reading that is not there has no error
        return np.asarray(own[..., None] if self.of == "reading" else own[:, None])


@dataclass(frozen=True, eq=False)
class FunctionErrors(ErrorTerm):
    """Functions of F channels, which share G scales and a length.

    Coordinates are those of the scales, each a switch and a magnitude in one, then the length's if that is free.
    """

    kernel: str  # ``linear``, ``quadratic`` or ``smooth``
    length: float  # in units of z; the median where it is free
    lengths: LogNormalPrior | None  # of a length that is free
    places: np.ndarray  # (F,): the channels that err
    travel: Travel
    reach: float  # largest |z| of all rows
    group: np.ndarray  # (F,): which scale each has
    scale: Array  # (G,): median of s where there is an error: what a channel with z = 1 errs by, one sd, in its unit
    spread: float  # standard deviation of log s
    labels: tuple[str, ...]  # length G: of the scales: a channel, a kind, or a section's name, and the unit
    scale_units: tuple[str, ...]  # length G
    length_name: str = LENGTH
    rows: Measurements | None = None  # all rows, which are the nodes of functions of several variables

    Config: ClassVar[type[Section]] = FunctionConfig

    @classmethod
    def build(cls, config: FunctionConfig, rows: TermRows) -> FunctionErrors:
        """Return the functions of a section.

        Raises
        ------
        InputError
            For an unknown channel, a scale in another kind of unit, functions that change too fast, and a row that
            lacks what they depend on.
        """
        places, channels = rows.select(config.channels), rows.model.channels
        scale = [config.scale_in(channels[k].name, channels[k].unit) for k in places]
        labels = (rows.name,) if config.shared else tuple(f"{rows.name}, {channels[k].name}" for k in places)
        travel = _build_travel(config, rows, places)
        z = travel.of_rows(rows.data)
        length_sd = config.log_length_scale_sd if config.kernel in LENGTHY else None
        return cls(
            kernel=config.kernel,
            length=config.length_scale,
            lengths=None if length_sd is None else LogNormalPrior(config.length_scale, length_sd),
            places=places,
            travel=travel,
            reach=MARGIN * max(1.0, float(np.abs(z).max())),
            group=np.zeros(len(places), dtype=int) if config.shared else np.arange(len(places)),
            scale=np.array(scale[: len(labels)]),
            spread=config.log_scale_sd,
            labels=labels,
            scale_units=tuple(channels[k].unit for k in places[: len(labels)]),
            length_name=f"{LENGTH}({rows.name})",
            rows=rows.data if z.shape[-1] > 1 else None,
        )

    def __post_init__(self) -> None:
        """Find the nodes: InputError for functions that need too many."""
        _ = self.nodes

    # --- what is unknown ---------------------------------------------------------------------------------------------

    @property
    def names(self) -> tuple[str, ...]:  # type: ignore[override]
        """Names of the scales, ``sigma_g(phi)``, and of a length that is free."""
        scales = tuple(f"{SCALE}({label})" for label in self.labels)
        return scales if self.lengths is None else (*scales, self.length_name)

    @property
    def units(self) -> tuple[str, ...]:  # type: ignore[override]
        """Units of all."""
        return self.scale_units if self.lengths is None else (*self.scale_units, "1")

    @property
    def priors(self) -> tuple[Prior, ...]:  # type: ignore[override]
        """Priors of all."""
        scales = tuple(KernelScalePrior(float(scale), self.spread) for scale in self.scale)
        return scales if self.lengths is None else (*scales, self.lengths)

    def scales(self, zeta: Array) -> Array:
        """Return the scales (..., G), in the channels' units."""
        return np.asarray(KernelScalePrior(1.0, self.spread).value(zeta[..., : len(self.scale)]) * self.scale)

    def _length(self, zeta: Array) -> Array:
        """Return the length (...,)."""
        if self.lengths is None:
            return np.full(zeta.shape[:-1], self.length)
        return self.lengths.value(zeta[..., -1])

    # --- coefficients ------------------------------------------------------------------------------------------------

    @cached_property
    def nodes(self) -> Array:
        """Where a function's values tell it all, shape (M, D)."""
        if self.rows is not None:
            return self.travel.of_rows(self.rows)[:, 0]
        shortest = self.length if self.lengths is None else self.lengths.median * np.exp(-ENDS * self.lengths.spread)
        kernel = build_kernel(self.kernel, float(shortest))
        probes = np.linspace(-self.reach, self.reach, PROBES)[:, None]
        exact = kernel(probes, probes)
        for count in range(FEWEST[self.kernel], MOST_NODES + 1):
            nodes = self.reach * chebpts1(count)
            between = self._interpolate(probes[:, 0], nodes)
            found = between @ kernel(nodes[:, None], nodes[:, None]) @ between.T
            if np.abs(found - exact).max() <= EXACT * np.abs(exact).max():
                return np.asarray(nodes[:, None])
        raise InputError(
            f"found {self.kernel} errors of length {shortest:.2g} ranges, expected longer for {MOST_NODES} nodes"
        )

    def _interpolate(self, travel: Array, nodes: Array) -> Array:
        """Return the weights (..., M) of values at nodes (M,) in those at travels (...)."""
        last = len(nodes) - 1
        weights = np.linalg.inv(chebvander(nodes / self.reach, last))
        return np.asarray(chebvander(travel / self.reach, last) @ weights)

    def _weights(self, data: Measurements) -> Array:
        """Return the weights (P, F or 1, M) of values at nodes in the errors of rows."""
        if self.rows is not None:
            return np.asarray(np.equal.outer(data.order, self.rows.order)[:, None].astype(np.float64))
        return self._interpolate(self.travel.of_rows(data)[..., 0], self.nodes[:, 0])

    def _kernel_at(self, lengths: Array) -> Kernel:
        """Return the kernel of lengths (B,), those beyond the ends taken for the outermost."""
        if self.lengths is not None:
            half = ENDS * self.lengths.spread
            lengths = np.clip(lengths, *(self.lengths.median * np.exp([-half, half])))
        return build_kernel(self.kernel, lengths[:, None, None])

    def root(self, lengths: Array) -> Array:
        """Return a square root of the covariance of values at the nodes in units of s², (B, M, R), of lengths (B,)."""
        covariance = self._kernel_at(lengths)(self.nodes, self.nodes).reshape(-1, len(self.nodes), len(self.nodes))
        values, vectors = np.linalg.eigh(covariance)
        kept = (values > EXACT * values[:, -1:]).any(axis=0)
        return np.asarray((vectors * np.sqrt(np.maximum(values, 0.0))[:, None, :])[..., kept])

    @cached_property
    def _known_root(self) -> Array:
        return self.root(np.array([self.length]))

    def _root_at(self, zeta: Array) -> Array:
        """Return the root (B or 1, M, R) of coordinates (B, n)."""
        return self._known_root if self.lengths is None else self.root(self._length(zeta))

    def columns(self, zeta: Array, data: Measurements) -> Array:
        """Return what coefficients do to each channel's readings, (B, P, K, F R)."""
        own = self._weights(data) @ self._root_at(zeta)[:, None]  # (B or 1, P, F or 1, R)
        return self._spread_out(own * self.scales(zeta)[:, None, self.group, None], data)

    def _spread_out(self, own: Array, data: Measurements) -> Array:
        """Return the columns (B, P, K, F R) of functions' own, (B, P, F, R)."""
        batch, n_poses, n, r = own.shape
        result = np.zeros((batch, n_poses, data.sd.shape[1], n, r))
        for k, place in enumerate(self.places):
            result[:, :, place, k] = own[:, :, k]
        return result.reshape(batch, n_poses, -1, n * r)

    def slopes(self, zeta: Array, data: Measurements) -> TermDerivatives:
        """Return Φ's by each scale, s dΦ/ds, and for a free length one that changes ΦΦᵀ as that does."""
        found, m = np.zeros((len(zeta), *self.columns(zeta[None], data).shape[1:])), len(self.scale)
        root, scales = self._root_at(zeta[None])[0], self.scales(zeta)[self.group]
        weights = self._weights(data)
        for k in range(m):
            mine = np.where((self.group == k) & (zeta[k] > BORDER), self.spread * scales, 0.0)
            found[k] = self._spread_out((weights @ root * mine[:, None])[None], data)[0]
        if self.lengths is not None:
            length = self._length(zeta[None])
            inside = abs(float(self.lengths.standardise(length)[0])) < ENDS
            by_length = self._kernel_at(length).slope(self.nodes, self.nodes)[0] * inside  # of their covariance
            turn = 0.5 * self.lengths.spread * by_length @ np.linalg.pinv(root).T
            found[m] = self._spread_out((weights @ turn * scales[:, None])[None], data)[0]
        return TermDerivatives(columns=found)


def _build_travel(config: FunctionConfig, rows: TermRows, places: np.ndarray) -> Travel:
    """Return what functions of channels depend on; InputError where a row lacks it, or it does not change."""
    if config.input == "order":
        return Travel("order", np.zeros(0, dtype=int), np.zeros(1), np.full(1, max(1.0, float(rows.data.order.max()))))
    inputs = places if config.input == "reading" else rows.select(config.input_channels)
    if config.input == "commands" and config.input_channels is None and rows.data.commanded is not None:
        inputs = np.flatnonzero(rows.data.commanded.any(axis=0))
    names = rows.model.names
    for k in inputs[~(rows.reach[inputs] > 0.0)][:1]:
        raise InputError(f"found {names[k]}, which is constant, expected channels that change")
    if config.input == "commands":
        for row, k in np.argwhere(~rows.data.present[:, inputs])[:1]:
            raise InputError(f"pose {rows.data.poses[row]!r}: found no reading of {names[inputs[k]]}, expected one")
    return Travel(config.input, inputs, rows.home[inputs], rows.reach[inputs], rows.positions.pick(inputs))
