"""The model error of any machine by tables of readings: what its own channels err by because the model is wrong.

Channel i of the machine's own, and not an instrument's, errs at rows p and q beside its stated noise, independently of
the others, by

    cov(g_ip, g_iq) = {τ_i² δ_pq + Σ_t s_t² k_t,i(p, q) / c_t} / λ_i²

with the sorts of functions k of `bayescal.density.functions`, of which c_t is the mean over the own channels and the
calibration rows. Travel z is where a channel stands beyond the middle of the workspace, in units of the whole range
over which it moves there: its command, or the reading that is expected at the row's pose (`RowPositions`). τ and s are
lengths at the tool: root mean squares in mm. A channel in another unit has a lever λ, by how many millimetres one unit
of it moves the tool; one that reads lengths has λ = 1. Linear functions that free parameters are, such as a lead error
of channels whose gains are free, are no second unknown (`OwnChannelRows.cover`). Waves and smooth functions keep the
linear part that their kernel has: how large it is follows from how far they bend.

Functions are columns that all rows share, Φ = s / λ · R with R Rᵀ = k / c over all rows, those that are held back too;
at other rows they are what their values at these rows say of them, k(·, rows) (Rᵀ)⁺. Of many rows they are made of few
columns, and what these leave out is independent from row to row.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import ClassVar, Self

import numpy as np

from bayescal.density.calibration.measurements import Measurements, RowPositions
from bayescal.density.calibration.terms import ErrorTerm, ModelErrorTerm, TermDerivatives
from bayescal.density.elimination import project_out
from bayescal.density.pose_kernels import (
    FEWEST_POSES,
    MOST_DRIFT,
    MOST_SMOOTH,
    OWN_COLUMNS,
    TAU,
    KernelInput,
    PoseFunctions,
)
from bayescal.density.priors import HalfCauchyPrior, Prior
from bayescal.machines.readings import Given, ReadingModel
from bayescal.numerics.geometry import Array
from bayescal.numerics.units import MICROMETRE

MIN_EIGENVALUE = 1e-9  # of a kernel's largest eigenvalue, below which directions are left out
BY_ROW = ("positioning", "smooth", "drift")  # sorts with as many coefficients as there are rows
MIN_TRAVEL_MM = 1e-6  # mm over its range, by which a channel moves the tool, below which it does not
MIN_LEVER_RATIO = 0.6
"""Share of the usual lever, by the channels' noise, that levers are not below, nor beyond its inverse. By how much each
joint errs is unknown: between errors of the same size at the tool and in the noise, intervals hold either."""
COVERED = 1e-6  # of a function, what parameters may leave of it for it to be no second unknown
COVERED_BY = "free parameters are the same functions"
OF_NOISE = 10.0 * MICROMETRE
"""What one standard deviation of the noise counts at the tool of a channel that does not move it, mm."""


@dataclass(frozen=True, eq=False)
class OwnChannelRows:
    """N channels of the machine's own that move, at the M rows of a study.

    They move over the workspace, or by what is given of the rows. Of a machine without coordinates whose channels all
    stand beside it, as the angle that a servo takes at a given pulse, it is these.
    """

    places: np.ndarray  # (N,): where they stand among all K channels
    range: Array  # (N,): how far readings go from end to end of the workspace
    levers: Array  # (N,): by how many mm one unit of each moves the tool
    rows: RowPositions  # of the N channels at the M rows
    n_places: int  # how many places in measuring order there are
    used: np.ndarray  # (M,): which rows are for calibration
    covered: np.ndarray  # (N, N): whether an error of channel i linear in the position of channel j is a parameter

    @classmethod
    def find(
        cls,
        model: ReadingModel,
        data: Measurements,
        pose: Array,
        used: np.ndarray,
        positions: RowPositions,
        reach: Array,
    ) -> OwnChannelRows:
        """Return the own channels of a machine.

        Parameters
        ----------
        model : ReadingModel
            The machine with the K channels that are read.
        data : Measurements
            Of all M rows.
        pose : ndarray, shape (M, q)
            Where the nominal machine explains the readings best.
        used : ndarray of bool, shape (M,)
            Which rows are for calibration.
        positions : RowPositions
            Where all K channels stand.
        reach : ndarray, shape (K,)
            How far readings of the nominal machine go from those in the middle of the workspace.
        """
        own = np.array([not one.external for one in model.channels])
        if not len(model.coordinates) and not own.any():  # no pose comes between: what is read is what the model says
            own[:] = True
        noise = np.array([_find_noise(data, k) for k in range(len(own))])
        places = np.flatnonzero(own & (reach > 0.0) & (noise > 0.0))  # what has no noise is a constraint
        return cls(
            places,
            np.array([model.travels.get(model.channels[k].name, 2.0 * reach[k]) for k in places]),
            _find_levers(model, data.pick(used), pose[used], places, reach[places], noise[places]),
            positions.pick(places),
            int(data.order.max()) + 1,
            used,
            np.zeros((len(places), len(places)), dtype=bool),
        )

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the N channels."""
        return tuple(one.name for one in self.rows.channels)

    @property
    def home(self) -> Array:
        """What the nominal machine reads in the middle of the workspace, (N,)."""
        return self.rows.home

    @cached_property
    def place(self) -> KernelInput:
        """Where functions are evaluated at all M rows."""
        return self._locate(self.rows.positions, self.rows.order)

    def _locate(self, positions: Array, order: np.ndarray) -> KernelInput:
        return KernelInput((positions - self.home) / self.range, order / self.n_places)

    def at(self, rows: np.ndarray) -> KernelInput:
        """Return the same of some of the rows."""
        assert self.place.time is not None
        return KernelInput(self.place.travel[rows], self.place.time[rows])

    def place_of(self, data: Measurements) -> KernelInput:
        """Return where functions are evaluated at P rows; see `RowPositions.at`."""
        return self._locate(self.rows.at(data, data.values[:, self.places]), data.order)

    def cover(self, model: ReadingModel, change: Array, theta: Array, pose: Array, given: Given) -> OwnChannelRows:
        """Return the same, with the linear errors that free parameters are, but for constants, everywhere.

        Such an error does to readings and tool what some change of the parameters does with other poses: neither these
        readings nor any others tell them apart, and the tool needs no more than one of them.

        Parameters
        ----------
        model : ReadingModel
            With K channels and q coordinates; its tool has m numbers.
        change : ndarray, shape (D, n)
            Derivative of the parameters by what is free.
        theta : ndarray, shape (D,)
            The machine as expected.
        pose : ndarray, shape (P, q)
            Poses of the workspace, many.
        given : mapping of str to ndarray, shape (P,)
        """
        n, n_channels = len(self.places), len(model.channels)
        at, gain = model.linearise(theta, pose, True, given), model.error_gain(theta, pose, given)
        _, tool_by_pose, tool_by_parameters = model.tool(theta, pose)
        by_pose = np.concatenate([at.by_pose, tool_by_pose], axis=1)  # (P, K + m, q)
        by_free = np.concatenate([at.by_parameters, tool_by_parameters], axis=1) @ change
        there = np.isfinite(by_pose).all(axis=(1, 2)) & np.isfinite(by_free).all(axis=(1, 2))
        spare = by_pose.shape[1] - by_pose.shape[2]
        if not n or spare < 1 or there.sum() * spare <= 2 * (by_free.shape[2] + n):
            return self
        shown = np.zeros((there.sum(), by_pose.shape[1], n))  # what an error of each own channel does
        shown[:, :n_channels] = np.eye(n_channels)[:, self.places] if gain is None else gain[there][..., self.places]
        size = np.linalg.norm(by_pose[there], axis=(0, 1))
        left = project_out(by_pose[there] / np.where(size > 0.0, size, 1.0))
        travel = (at.values[there][:, self.places] - self.home) / self.range  # (P, N)
        linear = shown[..., None] * travel[:, None, None]
        columns = (left @ linear.reshape(*shown.shape[:2], n**2)).reshape(-1, n**2)
        span = (left @ np.concatenate([by_free[there], shown], axis=-1)).reshape(len(columns), -1)
        span /= np.maximum(np.linalg.norm(span, axis=0), np.finfo(float).tiny)
        basis, sizes, _ = np.linalg.svd(span, full_matrices=False)
        basis = basis[:, sizes > MIN_EIGENVALUE * sizes[0]]
        rest = np.linalg.norm(columns - basis @ (basis.T @ columns), axis=0)
        size = np.linalg.norm(columns, axis=0)
        return replace(self, covered=((rest <= COVERED * size) & (size > 0.0)).reshape(n, n))

    def find_noise(self, data: Measurements) -> float:
        """Return the noise of a typical own channel at rows as stated, mm at the tool; zero where there is none."""
        found = [_find_noise(data, k) * lever for k, lever in zip(self.places, self.levers, strict=True)]
        return float(np.median(found)) if found else 0.0

    def is_covered(self, sort: str) -> bool:
        """Whether free parameters are all functions of a sort."""
        return sort == "linear" and bool(self.covered.all())

    def find_missing(self, terms: Sequence[str], costly: str = "") -> dict[str, str]:
        """Return which sorts of errors there cannot be, each with the reason.

        ``costly`` says why there are none with as many coefficients as rows; empty where there may be.
        """
        n, used = len(self.places), int(self.used.sum())
        found: dict[str, str] = {}
        for name in terms:
            if not n:
                found[name] = "no own channel moves"
            elif name == "random":
                continue
            elif used < FEWEST_POSES:
                found[name] = f"there are fewer than {FEWEST_POSES} rows"
            elif name != "drift" and not self.place.travel[self.used].any():
                found[name] = "no own channel moves"
            elif self.is_covered(name):
                found[name] = COVERED_BY
            elif costly and name in BY_ROW:
                found[name] = costly
        return found


def _find_noise(data: Measurements, channel: int) -> float:
    """Return the median of a channel's stated noise; zero where nothing was read."""
    there = data.sd[data.present[:, channel], channel]
    return float(np.median(there)) if len(there) else 0.0


def _find_levers(
    model: ReadingModel, data: Measurements, pose: Array, places: np.ndarray, reach: Array, noise: Array
) -> Array:
    """Return by how many mm one unit of own channels moves the tool, root mean square over poses (P, q), (N,).

    The tool moves by ∂tool/∂v (∂own/∂v)⁺, as located by the own channels, in units of their ranges. Where a channel
    does not move it, or there is none whose place is a length, `OF_NOISE` is one standard deviation of its noise.
    Levers, by the channels' noise, are within a factor of 1 / `MIN_LEVER_RATIO` of their median: errors of one size at
    the tool would be hundreds of times the noise of a wrist that turns a tool about its own axis, and too small for
    the shoulder, where joints err by the same angle.
    """
    units, levers = [model.channels[k].unit for k in places], np.zeros(len(places))
    if model.tool_lengths and len(model.coordinates) and len(places):
        theta, scale = model.layout.nominal, model.pose_scale
        by_pose = model.tool(theta, pose, False)[1][:, model.tool_lengths] * scale
        own = model.linearise(theta, pose, False, data.given).by_pose[:, places] * scale / reach[:, None]
        good = np.isfinite(by_pose).all(axis=(1, 2)) & np.isfinite(own).all(axis=(1, 2))
        if good.any():
            moves = by_pose[good] @ np.linalg.pinv(own[good])
            levers = np.sqrt((moves**2).sum(axis=1).mean(axis=0))
    moving = levers > MIN_TRAVEL_MM
    levers = np.where(moving, levers / reach, OF_NOISE / noise)
    if moving.any():
        usual = np.median((levers * noise)[moving]) / noise
        levers = np.where(moving, np.clip(levers, MIN_LEVER_RATIO * usual, usual / MIN_LEVER_RATIO), levers)
    return np.where([unit == "mm" for unit in units], 1.0, levers)


@dataclass(frozen=True, eq=False)
class RandomTerm(ModelErrorTerm):
    """τ, drawn independently at every row, half-normal, in mm at the tool: of one own channel, or of all."""

    @property
    def names(self) -> tuple[str, ...]:  # type: ignore[override]
        """``tau``, or ``tau[2]``."""
        return (self.label,)

    def square(self, zeta: Array) -> Array:
        """Return τ² + floor², mm² at the tool, (..., 1) to (...,)."""
        return np.asarray(self.priors[0].value(zeta[..., 0]) ** 2 + self.floor**2)


@dataclass(frozen=True, eq=False)
class GPTerm(ErrorTerm):
    """Errors of one sort of functions, of all N own channels, of one scale s in mm at the tool; see the module.

    ``floor``: what s is at least, mm; the error has the variance s² + floor².
    """

    of_model: ClassVar[bool] = True
    sort: str  # of `bayescal.density.pose_kernels.POSE_KERNELS`
    own: OwnChannelRows
    scale: float  # of the half-Cauchy prior of s, mm
    floor: float = 0.0

    @property
    def names(self) -> tuple[str, ...]:  # type: ignore[override]
        """``sigma_linear`` and the like."""
        return (f"sigma_{self.sort}",)

    @property
    def units(self) -> tuple[str, ...]:  # type: ignore[override]
        """Millimetres."""
        return ("mm",)

    @property
    def priors(self) -> tuple[Prior, ...]:  # type: ignore[override]
        """Half-Cauchy."""
        return (HalfCauchyPrior(self.scale),)

    @property
    def most_columns(self) -> int:
        """At most how many columns it has."""
        n, n_rows = len(self.own.places), len(self.own.used)
        return n * (n if self.sort == "linear" else n_rows)

    @cached_property
    def functions(self) -> PoseFunctions:
        """The kernel, normalised over the calibration rows."""
        return PoseFunctions((self.sort,), self.own.at(np.flatnonzero(self.own.used)), covered=self.own.covered)

    @cached_property
    def _roots(self) -> tuple[Array, Array]:
        """R of all M rows, (N or 1, M, R), and what takes kernels with these rows to it, (N or 1, M, R)."""
        (kernel,) = self.functions.between(self.own.place, self.own.place)
        values, vectors = np.linalg.eigh(kernel)
        there = values > MIN_EIGENVALUE * values[:, -1:].max()
        some = there.any(axis=0)
        size = np.where(there, np.sqrt(np.maximum(values, 0.0)), 0.0)[:, None, some]
        over = np.divide(1.0, size, out=np.zeros_like(size), where=size > 0.0)
        return vectors[..., some] * size, vectors[..., some] * over

    def thin(
        self, n_channels: int, own: OwnChannelRows | None = None, over: KernelInput | None = None
    ) -> LowRankGPTerm:
        """Return the same of few columns, of K channels, perhaps at other rows; see `LowRankGPTerm`."""
        return LowRankGPTerm(self.sort, own or self.own, self.scale, self.floor, n_channels, over)

    def with_floors(self, floors: Mapping[str, float]) -> Self:
        """Return the same with another floor; see `ErrorTerm.with_floors`."""
        return replace(self, floor=floors.get(self.sort, 0.0))

    def amplitude(self, zeta: Array) -> Array:
        """Return the root mean square of the error, floor included, mm at the tool, (..., 1) to (...,)."""
        return np.asarray(np.hypot(self.priors[0].value(zeta[..., 0]), self.floor))

    def _find_columns(self, data: Measurements) -> Array:
        """Return what functions of an amplitude of one are made of, (N or 1, P, R)."""
        rows, place = self.own.rows.find_rows(data), self.own.place_of(data)
        root, over = self._roots
        if (rows >= 0).all() and np.array_equal(place.travel, self.own.place.travel[rows]):
            return root[:, rows]
        return self.functions.between(place, self.own.place)[0] @ over

    def act(self, data: Measurements) -> Array:
        """Return the columns (P, K, N R) of an amplitude of one."""
        shown, n = self._find_columns(data), len(self.own.places)
        found = np.zeros((*data.sd.shape, n, shown.shape[-1]))
        for k, channel in enumerate(self.own.places):
            found[:, channel, k] = shown[k % len(shown)] / self.own.levers[k]
        return found.reshape(*data.sd.shape, -1)

    def columns(self, zeta: Array, data: Measurements) -> Array:
        """Return what coefficients do to each channel's readings, (B, P, K, N R)."""
        return self.amplitude(zeta)[:, None, None, None] * self.act(data)

    def slopes(self, zeta: Array, data: Measurements) -> TermDerivatives:
        """Return Φ's, with d√(s² + floor²) = s ds / √(s² + floor²)."""
        prior, amplitude = self.priors[0], self.amplitude(zeta)
        share = float(prior.value(zeta[0])) / float(amplitude) if amplitude > 0.0 else 1.0
        return TermDerivatives(columns=share * float(prior.slope(zeta[0])) * self.act(data)[None])


def count_columns(sort: str, n_own: int) -> int:
    """Return at most how many columns functions of a sort, or errors of single rows, have for so many own channels."""
    by_own = {"random": 0, "linear": n_own, "positioning": OWN_COLUMNS, "smooth": MOST_SMOOTH, "drift": MOST_DRIFT}
    return n_own * by_own[sort]


@dataclass(frozen=True, eq=False)
class LowRankGPTerm(GPTerm):
    """The same of few columns; what these leave out is independent from row to row.

    ``n_channels`` is K; ``over`` the rows that columns suit and that they are normalised over, the calibration rows by
    default.
    """

    n_channels: int = 0
    over: KernelInput | None = None

    @property
    def most_columns(self) -> int:
        """At most how many columns it has."""
        return count_columns(self.sort, len(self.own.places))

    @cached_property
    def functions(self) -> PoseFunctions:
        """The kernel of few columns that suit the calibration rows, normalised over these."""
        place = self.over or self.own.at(np.flatnonzero(self.own.used))
        return PoseFunctions((self.sort,), place, place, self.own.covered)

    @property
    def left(self) -> float:
        """Share of the variance that is independent from row to row."""
        return float(self.functions.left[0])

    def _find_columns(self, data: Measurements) -> Array:
        return self.functions.list_bases(self.own.place_of(data))[0]

    def find_basis(self, data: Measurements) -> Array:
        """Return what each own channel's function of an amplitude of one is made of at P rows, (N, P, A)."""
        found = self._find_columns(data)
        return np.broadcast_to(found, (len(self.own.places), *found.shape[1:]))

    def _spread(self, data: Measurements, square: Array) -> Array:
        found = np.zeros((*square.shape, 1, data.sd.shape[1]))
        found[..., self.own.places] = self.left * square[..., None, None] / self.own.levers**2
        return found

    @property
    def concerns(self) -> np.ndarray | None:
        """The own channels; none where nothing is left out."""
        return np.isin(np.arange(self.n_channels), self.own.places) & (self.left > 0.0)

    def variance(self, zeta: Array, data: Measurements) -> Array:
        """Return the variance that columns leave out, (B, 1, K)."""
        return self._spread(data, self.amplitude(zeta) ** 2)

    def slopes(self, zeta: Array, data: Measurements) -> TermDerivatives:
        """Return those of columns and of the variance, d (s² + floor²) = 2 s ds."""
        prior = self.priors[0]
        change = 2.0 * prior.value(zeta) * prior.slope(zeta)
        variance = np.broadcast_to(self._spread(data, change), (1, *data.sd.shape))
        return super().slopes(zeta, data)._replace(variance=variance)


def build_model_error(
    own: OwnChannelRows,
    n_channels: int,
    terms: Sequence[str],
    scales: tuple[float, float],
    floors: Mapping[str, float],
    each: bool,
    few: bool = False,
) -> tuple[ErrorTerm, ...]:
    """Return the terms of a model error.

    Parameters
    ----------
    own : OwnChannels
    n_channels : int
        Number K of all channels.
    terms : sequence of str
        Which there can be: `random` and sorts of functions.
    scales : (float, float)
        Of the half-normal prior of τ, and of the half-Cauchy priors, mm.
    floors : mapping of str to float
        Least root mean squares by term, mm.
    each : bool
        Whether each own channel has a τ of its own.
    few : bool
        Whether functions are made of few columns.
    """
    found: list[ErrorTerm] = []
    levers = np.ones(n_channels)
    levers[own.places] = own.levers
    if "random" in terms:
        every = np.isin(np.arange(n_channels), own.places)
        groups = {TAU: every}
        if each and len(own.places) > 1:
            groups = {f"{TAU}[{k}]": np.arange(n_channels) == place for k, place in enumerate(own.places, 1)}
        floor = floors.get("random", 0.0)
        found += [RandomTerm(name, one, scales[0], "mm", levers, floor) for name, one in groups.items()]
    sort = partial(LowRankGPTerm, n_channels=n_channels) if few else GPTerm
    found += [sort(name, own, scales[1], floors.get(name, 0.0)) for name in terms if name != "random"]
    return tuple(found)
