"""What a calibration leaves known of errors that its model lacks: functions of the pose, together with the geometry.

A machine errs the same way when it is measured again. What readings say of its geometry later, and of shifts, rests on
what is known of its errors: at other poses these are columns Φ times coefficients c (`LowRankGPTerm`) whose
posterior, jointly with the parameters θ, is normal given the errors' sizes, to first order about the posterior mean,

    (Δθ, c) ~ N(μ, C),    C = mean of the covariances over draws of the sizes + covariance of the means.

Sizes that the data hardly determine are cut off so that they count by their 90 % intervals (`ErrorModel.limit`): their
mean squares would be those of a few draws.

Geometry imitates a part of the errors, so that both belong together: by itself neither is known as well. What drifts in
measuring order is another error the next time, as large as it was.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property
from pathlib import Path
from typing import Final

import numpy as np
from scipy.linalg import block_diag

from bayescal.density.calibration.likelihood import CalibrationPosterior
from bayescal.density.calibration.measurements import Measurements, RowPositions
from bayescal.density.calibration.model_error import (
    GPTerm,
    LowRankGPTerm,
    OwnChannelRows,
    RandomTerm,
)
from bayescal.density.linear_gaussian import condition, whiten
from bayescal.density.pose_kernels import DRIFT, OWN_COLUMNS, POSE_KERNELS, KernelInput, PoseFunctions
from bayescal.density.sessions import ReadingRows
from bayescal.files.netcdf import read_netcdf
from bayescal.machines.readings import ReadingModel
from bayescal.numerics.geometry import Array

SIZES: Final = 50  # draws of the errors' sizes
N_DRIFTS: Final = 8  # sizes of a drift that stand for all
SMOOTH: Final = "smooth"
LATER: Final = 10**9  # place in measuring order of rows that are none of the calibration's


@dataclass(frozen=True, eq=False)
class KnownFunctions:
    """Errors of a machine's N own channels, as its calibration leaves them."""

    names: tuple[str, ...]  # of the channels
    # (N,): as of `OwnChannelRows`
    home: Array
    range: Array
    levers: Array
    covered: np.ndarray  # (N, N): as of `OwnChannelRows`, ones and zeros
    # (P, N) and (P,): of the rows over which functions are normalised
    travel: Array
    time: Array
    sorts: tuple[str, ...]  # names of the C sorts
    square: Array  # (C,): posterior mean of each sort's variance, mm² at the tool
    # (J,): sizes of a drift, each as probable as any other, in units of the root of its mean variance; ones without
    # drifts
    drifts: Array
    # (N,): posterior mean of the variance of errors that are drawn independently at every pose, in the channels' units
    independent: Array
    mean: Array  # (A,): of the coefficients of all sorts but drifts, amplitudes included
    covariance: Array  # (n + A, n + A): of n numbers of the geometry and these coefficients

    # --- from a posterior --------------------------------------------------------------------------------------------

    @classmethod
    def find(cls, posterior: CalibrationPosterior, y: Array) -> KnownFunctions | None:
        """Return what a posterior and its draws (T, n) know, of its parameters in their units; None without functions.

        None, too, where there are other errors common to all rows.
        """
        terms = posterior.errors.terms_of(GPTerm)
        if not terms or len(terms) < len(posterior.errors.common):
            return None
        thin, first, n_channels = _thin(posterior), terms[0].own, len(posterior.likelihood.model.channels)
        place = first.at(np.flatnonzero(first.used))
        assert place.time is not None
        chosen = np.linspace(0, len(y) - 1, min(SIZES, len(y))).astype(int)
        zetas = thin.errors.limit(thin.zeta(y))[chosen]
        functions = thin.errors.parts_of(GPTerm, zetas)
        random = [one.variance(own, thin.likelihood.data) for one, own in thin.errors.parts_of(RandomTerm, zetas)]
        independent = np.sum([one.mean(axis=(0, 1)) for one in random], axis=0) if random else np.zeros(n_channels)
        mean, covariance = _integrate(thin, y.mean(axis=0), zetas)
        sizes = {one.sort: one.amplitude(own) for one, own in functions}
        drifts = np.ones(N_DRIFTS)
        if DRIFT in sizes:
            middle = np.quantile(sizes[DRIFT], (np.arange(N_DRIFTS) + 0.5) / N_DRIFTS)
            drifts = middle / max(float(np.sqrt(np.mean(sizes[DRIFT] ** 2))), np.finfo(float).tiny)
        return cls(
            first.names,
            first.home,
            first.range,
            first.levers,
            first.covered.astype(np.float64),
            place.travel,
            place.time,
            tuple(one.sort for one, _ in functions),
            np.array([np.mean(size**2) for size in sizes.values()]),
            drifts,
            independent[first.places],
            mean,
            covariance,
        )

    def changed(self, change: Array) -> KnownFunctions:
        """Return the same of other numbers of the geometry (n',) that change by (n', n) with these."""
        both = block_diag(change, np.eye(len(self.mean)))
        return replace(self, covariance=both @ self.covariance @ both.T)

    # --- at poses ----------------------------------------------------------------------------------------------------

    @cached_property
    def root(self) -> Array:
        """A matrix (n + A, r) whose product with its transpose is the covariance."""
        size = np.sqrt(np.maximum(np.diag(self.covariance), np.finfo(float).tiny))
        values, vectors = np.linalg.eigh(self.covariance / np.outer(size, size))
        there = values > 1e-12 * values[-1]
        return np.asarray(size[:, None] * vectors[:, there] * np.sqrt(values[there]))

    @cached_property
    def given_geometry(self) -> tuple[Array, Array]:
        """How coefficients follow the geometry on average, (A, n), and a root (A, r) of their covariance given it."""
        n, size = self.n_geometry, np.sqrt(np.maximum(np.diag(self.covariance), np.finfo(float).tiny))
        scaled = self.covariance / np.outer(size, size)
        along = scaled[n:, :n] @ np.linalg.pinv(scaled[:n, :n], rcond=1e-12, hermitian=True)
        values, vectors = np.linalg.eigh(scaled[n:, n:] - along @ scaled[:n, n:])
        root = size[n:, None] * vectors * np.sqrt(np.maximum(values, 0.0))
        return along * size[n:, None] / size[:n], root

    @property
    def n_geometry(self) -> int:
        """Number n."""
        return len(self.covariance) - len(self.mean)

    def _own(self, model: ReadingModel) -> OwnChannelRows:
        places = np.array([model.names.index(name) for name in self.names])
        n, channels, stood = (
            len(self.time),
            tuple(model.channels[k] for k in places),
            self.home + self.range * self.travel,
        )
        rows = RowPositions(channels, self.home, np.arange(n), stood, stood)
        return OwnChannelRows(places, self.range, self.levers, rows, n, np.ones(n, dtype=bool), self.covered > 0.5)

    def show(self, model: ReadingModel, data: Measurements, read: Array) -> tuple[Array, Array]:
        """Return what coefficients do to the own channels' errors at poses, (P, K, A), and the variance beside, (P, K).

        Where own channels were not read, ``read`` (P, K) says what the machine reads.
        """
        own = self._own(model)
        filled = np.where(data.present, data.values, read)
        later = replace(data, values=filled, order=LATER + np.arange(data.n_poses))
        terms = [LowRankGPTerm(name, own, 0.0, 0.0, len(model.channels)) for name in self.sorts]
        columns, left = [np.zeros((*data.sd.shape, 0))], np.zeros(data.sd.shape)
        place = own.place_of(later)
        for term, square in zip(terms, self.square, strict=True):
            if term.sort == DRIFT:
                continue
            columns.append(term.act(later))
            whole = replace(term.functions, of_few=None).variances(place)[0]
            rest = np.maximum(whole - term.functions.variances(place)[0], 0.0)
            left[:, own.places] += square * np.broadcast_to(rest, (len(own.places), len(left))).T / own.levers**2
        left[:, own.places] += self.independent
        return np.concatenate(columns, axis=-1), left

    def place(self, model: ReadingModel) -> Array:
        """Return which of all channels each own one is, ones and zeros (K, N)."""
        return np.eye(len(model.channels))[:, [model.names.index(name) for name in self.names]]

    @property
    def drift(self) -> Array:
        """Root mean square of what drifts, of each own channel in its unit, (N,)."""
        return np.asarray(np.sqrt(sum(self.square[[name == DRIFT for name in self.sorts]])) / self.levers)

    def follow(self, n: int) -> Array:
        """Return the covariance (n, n) of a drift of one unit, root mean square, over the rows of a session.

        The first row is one of n equal intervals after the start, which of few rows is much of the session.
        """
        time = (np.arange(n) + 1.0) / n
        functions = PoseFunctions((DRIFT,), KernelInput(self.travel, self.time))
        place = KernelInput(np.zeros((n, 0)), time)
        return np.asarray(POSE_KERNELS[DRIFT].between(place, place)[0] / functions.norms[0])

    # --- as arrays ---------------------------------------------------------------------------------------------------

    def list_arrays(self) -> dict[str, tuple[tuple[str, ...], Array, str, str]]:
        """Return all that are numbers by name, with names of their dimensions, unit and what they are."""
        both, unit = ("entry", "other_entry"), "channel's unit"
        return {
            "home": (("channel",), self.home, unit, "readings mid-workspace"),
            "range": (("channel",), self.range, unit, "range of readings"),
            "levers": (("channel",), self.levers, "mm", "tool motion per channel unit"),
            "covered": (
                ("channel", "other_channel"),
                self.covered,
                "1",
                "whether a linear error is free",
            ),
            "travel": (("row", "channel"), self.travel, "1", "scaled readings from home"),
            "time": (("row",), self.time, "1", "place in measuring order"),
            "square": (("sort",), self.square, "mm2", "variance at the tool"),
            "drifts": (("quantile",), self.drifts, "1", "drift sizes / rms"),
            "independent": (("channel",), self.independent, f"{unit} squared", "random error variance"),
            "mean": (("coefficient",), self.mean, "mm", "of coefficients of functions"),
            "covariance": (both, self.covariance, "1", "parameters, then coefficients"),
            "smooth": (("row", "column"), self._smooth(), "1", "smooth functions by row"),
        }

    @classmethod
    def of_arrays(cls, arrays: Mapping[str, object], names: Sequence[str], sorts: Sequence[str]) -> KnownFunctions:
        """Return them from their arrays; columns of smooth functions may be others of the same span elsewhere."""
        numbers = [one.name for one in fields(cls) if one.name not in ("names", "sorts")]
        own = {key: np.asarray(arrays[key], dtype=np.float64) for key in numbers}
        found = cls(names=tuple(names), sorts=tuple(sorts), **own)
        n, turn = found.n_geometry, [found._turn(name, np.asarray(arrays["smooth"])) for name in sorts if name != DRIFT]
        both = block_diag(np.eye(n), *turn)
        return replace(found, mean=both[n:, n:] @ found.mean, covariance=both @ found.covariance @ both.T)

    def _smooth(self) -> Array:
        """Return the columns of smooth functions at the rows, (P, A); none without such functions."""
        if SMOOTH not in self.sorts:
            return np.zeros((len(self.time), 0))
        place = KernelInput(self.travel, self.time)
        return PoseFunctions((SMOOTH,), place, place).list_bases(place)[0][0]

    def _turn(self, sort: str, smooth: Array) -> Array:
        """Return what takes coefficients of a sort with the columns that were kept to those with these."""
        n = len(self.names)
        if sort != SMOOTH:
            return np.eye(n * (n if sort == "linear" else OWN_COLUMNS))
        return np.asarray(np.kron(np.eye(n), np.linalg.lstsq(self._smooth(), smooth)[0]), dtype=np.float64)


def read_known(path: Path, group: str | None = None) -> tuple[KnownFunctions, list[str]]:
    """Return what a file, or a group of it, has of them, and names of the parameters beside.

    OSError, ValueError, KeyError as `read_netcdf`, and where one of the arrays is missing.
    """
    found = read_netcdf(path, group)
    channels, sorts, beside = ([str(one) for one in found[key].values] for key in ("channel", "sort", "parameter"))
    return KnownFunctions.of_arrays({str(key): one for key, one in found.items()}, channels, sorts), beside


def _thin(posterior: CalibrationPosterior) -> CalibrationPosterior:
    """Return a posterior whose functions are of few columns."""
    n = len(posterior.likelihood.model.channels)
    return replace(posterior, errors=posterior.errors.change(GPTerm, lambda one: one.thin(n)))


def _integrate(posterior: CalibrationPosterior, y: Array, zetas: Array) -> tuple[Array, Array]:
    """Return the mean of coefficients but drifts and their covariance with the geometry, about y, by sizes (T, k)."""
    m, (theta, change) = posterior.n_geometry, posterior.around(y)
    likelihood = posterior.likelihood
    split = likelihood.data.split()
    parts = [likelihood] if len(split) == 1 else [likelihood.pick(part) for part, _ in split]
    sizes, grams = np.zeros((len(zetas), 0)), list[Array]()
    for part in parts:  # what all rows see of all columns would take gigabytes
        rows = ReadingRows(replace(posterior, likelihood=part))
        with np.errstate(all="ignore"):
            linear = rows.linearise(theta)
        slope, shown, sizes = linear.slope @ change, -(linear.left @ rows.act), rows.size_coefficients(zetas)
        found = []
        for zeta, size in zip(zetas, sizes, strict=True):
            every = np.concatenate([slope, shown * size, linear.errors[..., None]], axis=-1)
            white = whiten(linear.covariance(zeta), every)[0].reshape(-1, every.shape[-1])
            found.append(white.T @ white)
        grams = [one + other for one, other in zip(grams, found, strict=True)] if grams else found
    prior = posterior.sampling.prior_slope(change)
    pull = prior.T @ posterior.sampling.prior_residual(y[:m], theta)
    sorts = [one.sort for one in posterior.errors.terms_of(GPTerm)]
    lasting = np.append(np.ones(m, dtype=bool), np.repeat([name != DRIFT for name in sorts], rows.widths))
    natural = change[posterior.sampling.free]
    means, covariances = [], []
    for size, gram in zip(sizes, grams, strict=True):
        precision = gram[:-1, :-1] + block_diag(prior.T @ prior, np.eye(len(size)))
        given = condition(precision, -(gram[:-1, -1:] + np.append(pull, np.zeros(len(size)))[:, None]), 0.0)
        to = block_diag(natural, np.diag(size))[:, lasting][lasting]
        means.append(to @ given.mean[lasting, 0])
        covariances.append(to @ given.covariance[np.ix_(lasting, lasting)] @ to.T)
    spread = np.mean(covariances, axis=0) + np.cov(np.array(means), rowvar=False, bias=True)
    return np.mean(means, axis=0)[m:], spread
