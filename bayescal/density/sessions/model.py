"""What sessions share and what moves between them, as a state z that is standard normal under the prior.

Free parameters of session s are x_s = x_0 + Σ_k B_sk diag(σ) w_k, where x_0 has the priors of a study, w_k are standard
normal, σ are drift scales, and B says how sessions hang together: steps of a random walk, √Δt_k for all sessions after
it, or a deviation of each machine of a design by itself. Lengths at a temperature T are L (1 + α (T - T_0)); the
coefficients α are part of the state.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from bayescal.density.priors import HalfNormalPrior
from bayescal.density.sessions.rows import ReadingRows
from bayescal.numerics.geometry import Array


@dataclass(frozen=True, eq=False)
class Part:
    """Rows of one session at one temperature.

    Attributes
    ----------
    rows : ReadingRows
    session : int
        Counted from zero.
    warmth : float
        T - T_0, K.
    """

    rows: ReadingRows
    session: int
    warmth: float = 0.0


@dataclass(frozen=True, eq=False)
class Expansion:
    """Lengths that grow with the temperature by a common coefficient α, normal under the prior.

    Attributes
    ----------
    name : str
        Of the body.
    index : ndarray of int
        Where they stand in θ.
    mean, sd : float
        Of α, 1/K.
    """

    name: str
    index: np.ndarray
    mean: float
    sd: float


@dataclass(frozen=True, eq=False)
class Drift:
    """Which parameters may move between sessions, and how.

    Attributes
    ----------
    loadings : ndarray, shape (S, K)
        B; of a random walk in √month.
    index : ndarray of int, shape (d,)
        The parameters, by their places among the free ones.
    unit : ndarray of int, shape (d,)
        Which of the U scales each has.
    units : tuple of str, length U
        Their names.
    scale : ndarray, shape (U,)
        Of the half-normal prior of each scale σ, mm or rad, of a random walk per √month.
    """

    loadings: Array
    index: np.ndarray
    unit: np.ndarray
    units: tuple[str, ...]
    scale: Array

    def keep(self, units: Sequence[str]) -> Drift:
        """Return the same where some units alone may move."""
        chosen = [k for k, name in enumerate(self.units) if name in units]
        place = {old: new for new, old in enumerate(chosen)}
        there = np.isin(self.unit, chosen)
        unit = np.array([place[int(k)] for k in self.unit[there]], dtype=int)
        return replace(
            self,
            index=self.index[there],
            unit=unit,
            units=tuple(self.units[k] for k in chosen),
            scale=self.scale[chosen],
        )


def walk_loadings(days: Array) -> Array:
    """Return B of a random walk over sessions at days (S,), shape (S, S - 1)."""
    steps = np.sqrt(np.diff(days) / DAYS_IN_MONTH)
    return np.tril(np.ones((len(days), len(days) - 1)), k=-1) * steps


DAYS_IN_MONTH = 365.25 / 12


@dataclass(frozen=True, eq=False)
class SessionModel:
    """Sessions of one machine, or of machines of one design.

    Attributes
    ----------
    parts : tuple of Part
        Of all sessions, in their order.
    start : ndarray, shape (D,)
        θ with all free parameters at their priors' means.
    moves : ndarray, shape (m, D)
        Which parameters go with each free one, ones and zeros.
    names, units : tuple of str, length m
        Of the free parameters.
    mean, sd : ndarray, shape (m,)
        Of their normal priors.
    drift : Drift
    expansions : tuple of Expansion, length A
    """

    parts: tuple[Part, ...]
    start: Array
    moves: Array
    names: tuple[str, ...]
    units: tuple[str, ...]
    mean: Array
    sd: Array
    drift: Drift
    expansions: tuple[Expansion, ...]

    @property
    def n_sessions(self) -> int:
        """Number of sessions S."""
        return len(self.drift.loadings)

    @property
    def n_steps(self) -> int:
        """Number of steps or deviations K."""
        return self.drift.loadings.shape[1]

    @property
    def size(self) -> int:
        """Length of the state z: m parameters, A coefficients, d times K steps."""
        return len(self.mean) + len(self.expansions) + self.n_steps * len(self.drift.index)

    @property
    def n_errors(self) -> int:
        """How many numbers are unknown of the errors, the same in all sessions."""
        return self.parts[0].rows.n_errors

    @property
    def n_scales(self) -> int:
        """Number of what is unknown of the errors and of drift scales together."""
        return self.n_errors + len(self.drift.units)

    def keep(self, units: Sequence[str]) -> SessionModel:
        """Return the same sessions where some units alone may move."""
        return replace(self, drift=self.drift.keep(units))

    def read_scales(self, zeta: Array) -> tuple[Array, Array]:
        """Return what is unknown of the errors and drift scales σ (..., U), of standard normal coordinates (..., n)."""
        n = self.n_errors
        return zeta[..., :n], HalfNormalPrior(1.0).value(zeta[..., n:]) * self.drift.scale

    def split(self, z: Array, scales: Array) -> tuple[Array, Array]:
        """Return deviations of x_s from the priors' means (..., S, m), mm, and α (..., A), of states (..., n).

        Drift scales σ have shape (..., U).
        """
        m, a = len(self.mean), len(self.expansions)
        common = self.sd * z[..., :m]
        steps = z[..., m + a :].reshape(*z.shape[:-1], self.n_steps, len(self.drift.index))
        moved = np.einsum("sk,...kd->...sd", self.drift.loadings, steps) * scales[..., None, self.drift.unit]
        x = np.repeat(common[..., None, :], self.n_sessions, axis=-2)
        x[..., self.drift.index] += moved
        means = np.array([one.mean for one in self.expansions])
        sds = np.array([one.sd for one in self.expansions])
        return x, means + sds * z[..., m : m + a]

    def theta(self, part: Part, x: Array, alpha: Array) -> Array:
        """Return θ (..., D) of a part's machine at its temperature; x (..., S, m), α (..., A) as `split` returns."""
        theta = self.start + x[..., part.session, :] @ self.moves
        for k, one in enumerate(self.expansions):
            theta[..., one.index] *= 1.0 + alpha[..., k, None] * part.warmth
        return theta

    def slopes(self, part: Part, x: Array, alpha: Array) -> tuple[Array, Array]:
        """Return dθ/dx (D, m) and dθ/dα (D, A) of a part's machine at one x (S, m) and α (A,)."""
        cold = self.theta(Part(part.rows, part.session), x, alpha)
        factor = np.ones(len(cold))
        by_alpha = np.zeros((len(cold), len(self.expansions)))
        for k, one in enumerate(self.expansions):
            factor[one.index] = 1.0 + alpha[k] * part.warmth
            by_alpha[one.index, k] = cold[one.index] * part.warmth
        return (self.moves * factor).T, by_alpha

    def log_likelihood(self, z: Array, zeta: Array) -> Array:
        """Return the log-likelihood as it is, shape (B,), of states (B, n) at scales ζ (B, n_scales)."""
        errors, scales = self.read_scales(zeta)
        x, alpha = self.split(z, scales)
        return np.sum([one.rows.evaluate(self.theta(one, x, alpha), errors) for one in self.parts], axis=0)
