"""How large a study will find systematic errors to be that are as large as somebody expects.

A study does not know the sizes s of its errors: their posterior is what visible errors and priors say, and where a plan
shows little it stays wide, so that intervals are wider than those of the true sizes. White rows y = X θ + Σ_t V_t u_t
+ ε with standard normal θ and u_t ~ N(0, s_t²) have, θ integrated out, with the true sizes s⁰ the covariance
B + V D⁰ Vᵀ, B = 1 + X Xᵀ. The log-density of the rows under sizes s is then on average

    L(s) = -½ log |1 + R M R| + ½ tr (1 + R M R)⁻¹ R (M + M D⁰ M) R + const,    M = Vᵀ B⁻¹ V,

R being the diagonal of s by column and D⁰ that of s⁰², and p(s) exp L(s) is what the posterior of the sizes is
expected to be. Its mean stands for it: averaged over its draws geometry has about the covariance that it has there.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

import numpy as np
from scipy.linalg.lapack import dpotrf, dpotri

from bayescal.density.priors import HalfCauchyPrior
from bayescal.inference.scales import find_scales_mode, sample_scales
from bayescal.numerics.geometry import Array

DRAWS: Final = 150


def expect_sizes(
    rows: Array, columns: Array, sorts: np.ndarray, true: Mapping[str, float], floors: Mapping[str, float], scale: float
) -> dict[str, float]:
    """Return the means, over their expected posterior, of sizes by term, mm.

    Parameters
    ----------
    rows : ndarray, shape (K, n)
        X, in units of the tolerances and of the noise.
    columns : ndarray, shape (K, q)
        V, of sizes of 1 mm.
    sorts : ndarray of int, shape (q,)
        Which of the terms each column is of, in the order of ``true``.
    true, floors : mapping of str to float
        Sizes that errors have, and that a study takes them to have at least, mm.
    scale : float
        Of the half-Cauchy priors, mm.
    """
    names, prior = list(true), HalfCauchyPrior(scale)
    least = np.array([floors.get(name, 0.0) for name in names])
    seen = columns.T @ rows
    gram = columns.T @ columns - seen @ np.linalg.solve(np.eye(rows.shape[1]) + rows.T @ rows, seen.T)
    square = gram + (gram * (np.array(list(true.values())) ** 2)[sorts]) @ gram

    def find_squares(zeta: Array) -> Array:
        return np.asarray(prior.value(zeta) ** 2 + least**2)

    def weigh(zeta: Array) -> float:
        size = np.sqrt(find_squares(zeta))[sorts]
        factor, _ = dpotrf(np.eye(len(size)) + size[:, None] * gram * size, lower=1)
        inverse, _ = dpotri(factor, lower=1)
        both = np.tril(inverse) * (size[:, None] * square * size)  # tr (1 + R M R)⁻¹ ..., from one half
        explained = 2.0 * both.sum() - np.trace(both)
        return float(-np.log(np.diag(factor)).sum() + 0.5 * explained - 0.5 * zeta @ zeta)

    def log_density(zeta: Array) -> Array:
        return np.array([weigh(one) for one in zeta])

    start = np.maximum(prior.standardise(np.maximum(list(true.values()), 0.1 * scale)), -3.0)
    mode = find_scales_mode(log_density, start)
    draws = sample_scales(log_density, mode, DRAWS, DRAWS, np.random.default_rng(1)).draws
    return dict(zip(names, np.sqrt(find_squares(draws)).mean(axis=0).tolist(), strict=True))
