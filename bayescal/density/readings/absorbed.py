"""Errors that are functions of the readings, integrated out of the density of readings with their poses eliminated.

With r̂ what the best poses leave of all readings, white, Π = 1 - H (HᵀH)⁻¹ Hᵀ pose by pose, and Φ what coefficients
u ~ N(0, 1) of the sensors' functions do to the readings, both the poses and u are linear, and

    ∫∫ N(r̂; Hv + Φu, 1) dv N(u; 0, 1) du = [that without functions] · |M|^(-1/2) exp(½ bᵀ M⁻¹ b),
    M = 1 + ΦᵀΠΦ,   b = Φᵀ r̂   (Πr̂ = r̂),

exact to the order to which poses are eliminated anyway. Its cost is that of M, whose size is the number of
coefficients, not of poses. Given the readings u is N(M⁻¹ b, M⁻¹), which predicts the functions at other readings.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from bayescal.density.readings.functions import SensorFunctions
from bayescal.density.readings.poses import SensorSet
from bayescal.numerics.geometry import Array


@dataclass(frozen=True, eq=False)
class Strength:
    """Scales and lengths of B machines' functions: ``scale`` (B, F), mm and rad, and ``length`` (B,)."""

    scale: Array
    length: Array

    def pick(self, some: slice) -> Strength:
        """Return those of some machines."""
        return Strength(self.scale[some], self.length[some])


@dataclass(frozen=True, eq=False)
class Absorbed:
    """Coefficients of B machines' functions, N = F R of each, given the readings.

    Attributes
    ----------
    root : ndarray, shape (B, F R', F R)
        What takes u to the coefficients of the columns.
    factor : ndarray, shape (B, N, N)
        Cholesky factor of M.
    mean : ndarray, shape (B, N)
        Of u.
    seen : ndarray, shape (B, F R', F R')
        ΦᵀΠΦ by columns.
    told : ndarray, shape (B, F R')
        Φᵀ r̂ by columns.
    """

    root: Array
    factor: Array
    mean: Array
    seen: Array
    told: Array

    @property
    def gain(self) -> Array:
        """Added log-density, shape (B,)."""
        return self.half_log_volume + 0.5 * np.einsum("bi,bi->b", self.told, self.coefficients)

    @property
    def half_log_volume(self) -> Array:
        """-½ log |M|, shape (B,)."""
        return -np.log(np.diagonal(self.factor, axis1=-2, axis2=-1)).sum(axis=-1)

    @cached_property
    def coefficients(self) -> Array:
        """Mean coefficients of the columns, (B, F R')."""
        return np.einsum("bij,bj->bi", self.root, self.mean)

    @cached_property
    def spread(self) -> Array:
        """Square root W of the coefficients' covariance, W Wᵀ, shape (B, F R', N)."""
        return np.swapaxes(np.linalg.solve(self.factor, np.swapaxes(self.root, -1, -2)), -1, -2)

    def draw(self, rng: np.random.Generator) -> Array:
        """Return coefficients of the columns, one draw for each machine, (B, F R')."""
        return self.coefficients + np.einsum("bij,bj->bi", self.spread, rng.standard_normal(self.mean.shape))

    @property
    def score(self) -> tuple[Array, Array]:
        """Columns' coefficients seen with the whole covariance: ΦᵀC⁻¹r̂ (B, F R') and ΦᵀC⁻¹Φ (B, F R', F R')."""
        across = self.seen @ self.spread
        return (
            self.told - np.einsum("bij,bj->bi", self.seen, self.coefficients),
            self.seen - across @ np.swapaxes(across, -1, -2),
        )


class Absorber:
    """What functions do to the readings of P poses, and what these tell of the functions.

    Parameters
    ----------
    functions : SensorFunctions
    sensors : SensorSet
    readings : ndarray, shape (P, K)
        mm and rad.
    """

    def __init__(self, functions: SensorFunctions, sensors: SensorSet, readings: Array) -> None:
        self.functions, self._n_sensors = functions, len(sensors.chosen)
        self.columns = functions.columns(readings) / sensors.noise[functions.places, None]  # (P, F, R'), white
        n_poses, n, r = self.columns.shape
        pairs = [(f, g) for f in range(n) for g in range(f + 1)]
        self._pairs = pairs
        self._products = np.array(
            [np.einsum("pr,pt->prt", self.columns[:, f], self.columns[:, g]).reshape(n_poses, r * r) for f, g in pairs]
        )

    def absorb(self, error: Array, slope: Array, strength: Strength) -> Absorbed:
        """Return the functions' coefficients of machines that leave white errors (B, P, K) with slopes (B, P, K, q)."""
        seen, told = self._see(slope), self._tell(error)
        root = self.root(strength)
        turned = np.swapaxes(root, -1, -2)
        inner = turned @ seen @ root
        inner[..., *np.diag_indices(inner.shape[-1])] += 1.0
        good = np.isfinite(inner).all(axis=(-1, -2))[:, None, None]  # a machine that cannot stand has no density anyway
        inner = np.where(good, inner, np.eye(inner.shape[-1]))
        factor = np.linalg.cholesky(inner)
        mean = np.linalg.solve(inner, np.einsum("bij,bj->bi", turned, told)[..., None])[..., 0]
        return Absorbed(root, factor, mean, seen, told)

    def _see(self, slope: Array) -> Array:
        """Return ΦᵀΠΦ by columns, shape (B, F R', F R')."""
        left = project(slope)[:, :, self.functions.places][..., self.functions.places]
        n, r = self.columns.shape[1:]
        seen = np.empty((len(slope), n, r, n, r))
        for (f, g), products in zip(self._pairs, self._products, strict=True):
            block = (left[:, :, f, g] @ products).reshape(-1, r, r)
            seen[:, f, :, g], seen[:, g, :, f] = block, np.swapaxes(block, -1, -2)
        return seen.reshape(len(slope), n * r, n * r)

    def _tell(self, error: Array) -> Array:
        own = error[..., self.functions.places]
        return np.einsum("pfr,bpf->bfr", self.columns, own, optimize=True).reshape(len(error), -1)

    def root(self, strength: Strength) -> Array:
        """Return what takes u to the coefficients of the columns, block by block."""
        n, r = self.columns.shape[1:]
        own = np.eye(r)[None] if self.functions.lengths is None else self.functions.root(strength.length)
        blocks = np.zeros((len(strength.scale), n, r, n, own.shape[-1]))
        for f in range(n):
            blocks[:, f, :, f] = strength.scale[:, f, None, None] * own
        return blocks.reshape(len(blocks), n * r, -1)

    def act(self, coefficients: Array) -> Array:
        """Return what coefficients (B, F R') add to white readings, (B, P, K)."""
        n, r = self.columns.shape[1:]
        found = np.zeros((len(coefficients), len(self.columns), self._n_sensors))
        found[..., self.functions.places] = np.einsum(
            "pfr,bfr->bpf", self.columns, coefficients.reshape(-1, n, r), optimize=True
        )
        return found

    def rows(self, slope: Array, root: Array) -> Array:
        """Return ΠΦ of each pose for roots (B, F R', N) and slopes (B, P, K, q), shape (B, P, K, N)."""
        n, r = self.columns.shape[1:]
        by_sensor = root.reshape(len(root), n, r, -1)
        left = project(slope)[..., self.functions.places]
        acted = np.einsum("pfr,bfrn->bpfn", self.columns, by_sensor, optimize=True)
        return np.asarray(left @ acted)


def project(slope: Array) -> Array:
    """Return Π = 1 - H (HᵀH)⁻¹ Hᵀ for white H (..., K, q); NaN where H is singular."""
    scale = np.linalg.norm(slope, axis=-2, keepdims=True)
    with np.errstate(all="ignore"):
        scaled = slope / scale
        normal = np.swapaxes(scaled, -1, -2) @ scaled
        good = np.isfinite(normal).all(axis=(-1, -2)) & (np.abs(np.linalg.det(normal)) > np.finfo(float).eps)
    inverse = np.linalg.inv(np.where(good[..., None, None], normal, np.eye(slope.shape[-1])))
    inverse = np.where(good[..., None, None], inverse, np.nan)
    return np.asarray(np.eye(slope.shape[-2]) - scaled @ inverse @ np.swapaxes(scaled, -1, -2))


def condition_each(error: Array, rows: Array, absorbed: Absorbed) -> tuple[Array, Array]:
    """Return each pose's part of the log-density given all other poses of the same readings, but for its own volume.

    With G = Uᵀ M⁻¹ U for a pose's U = (ΠΦ)ᵀ, the precision of its r̂ given the others is 1 - G, and it deviates from
    what they expect by (1 - G)⁻¹ (r̂ - Uᵀ M⁻¹ b).

    Parameters
    ----------
    error : ndarray, shape (B, P, K)
    rows : ndarray, shape (B, P, K, N)
        ΠΦ.
    absorbed : Absorbed

    Returns
    -------
    log_volume, square : ndarray, shape (B, P)
        ½ log |1 - G|, and the squared deviation in units of its covariance.
    """
    left = error - np.einsum("bpkn,bn->bpk", rows, absorbed.mean)
    precision = _identity_like(rows) - _through(rows, absorbed)
    solved = np.linalg.solve(precision, left[..., None])[..., 0]
    return 0.5 * np.linalg.slogdet(precision)[1], np.einsum("bpk,bpk->bp", left, solved)


def condition_others(error: Array, rows: Array, absorbed: Absorbed) -> tuple[Array, Array]:
    """Return the same of each of other poses given those that told ``absorbed``."""
    left = error - np.einsum("bpkn,bn->bpk", rows, absorbed.mean)
    covariance = _identity_like(rows) + _through(rows, absorbed)
    solved = np.linalg.solve(covariance, left[..., None])[..., 0]
    return -0.5 * np.linalg.slogdet(covariance)[1], np.einsum("bpk,bpk->bp", left, solved)


def _identity_like(rows: Array) -> Array:
    return np.broadcast_to(np.eye(rows.shape[2]), (*rows.shape[:2], rows.shape[2], rows.shape[2]))


def _through(rows: Array, absorbed: Absorbed) -> Array:
    """Return Uᵀ M⁻¹ U, shape (B, P, K, K)."""
    shape = rows.shape
    flat = np.swapaxes(rows.reshape(shape[0], -1, shape[-1]), -1, -2)
    white = np.swapaxes(np.linalg.solve(absorbed.factor, flat), -1, -2).reshape(shape)
    return np.asarray(white @ np.swapaxes(white, -1, -2))
