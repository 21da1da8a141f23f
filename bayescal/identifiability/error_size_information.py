"""How large a study will find systematic errors to be that are as large as somebody expects.

A study does not know the sizes s of its errors: their posterior is what visible errors and priors say, and where a plan
shows little it stays wide, so that intervals are wider than those of the true sizes. White rows y = X θ + Σ_t V_t u_t
+ ε with standard normal θ and u_t ~ N(0, s_t²) have, θ integrated out, with the true sizes s⁰ the covariance
B + V D⁰ Vᵀ, B = 1 + X Xᵀ, D⁰ being the diagonal of s⁰² by column. Errors show in as many directions as
M = Vᵀ B⁻¹ V = W Wᵀ has a rank; the log-density of the rows under sizes s is on average

    L(s) = -½ log |C(s)| - ½ tr C(s)⁻¹ C(s⁰) + const,    C(s) = 1 + Wᵀ D W = 1 + Σ_t s_t² W_tᵀ W_t,

and p(s) exp L(s) is what the posterior of the sizes is expected to be. Its mean stands for it: averaged over
its draws geometry has about the covariance that it has there.
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
RANK_TOLERANCE: Final = 1e-12  # of the largest eigenvalue of M: what rounding leaves of the others


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
    values, vectors = np.linalg.eigh(gram)
    visible = values >= RANK_TOLERANCE * values.max(initial=0.0)
    root = vectors[:, visible] * np.sqrt(values[visible])
    parts = np.array([root[sorts == t].T @ root[sorts == t] for t in range(len(names))])
    unit = np.eye(root.shape[1])
    expected = unit + np.tensordot(np.array(list(true.values())) ** 2, parts, 1)

    def find_squares(zeta: Array) -> Array:
        return np.asarray(prior.value(zeta) ** 2 + least**2)

    def weigh(zeta: Array) -> float:
        factor, _ = dpotrf(unit + np.tensordot(find_squares(zeta), parts, 1), lower=1)
        inverse, _ = dpotri(factor, lower=1)
        both = np.tril(inverse) * expected  # tr C⁻¹ C⁰, from one half
        spread = 2.0 * both.sum() - np.trace(both)
        return float(-np.log(np.diag(factor)).sum() - 0.5 * spread - 0.5 * zeta @ zeta)

    def log_density(zeta: Array) -> Array:
        return np.array([weigh(one) for one in zeta])

    start = np.maximum(prior.standardise(np.maximum(list(true.values()), 0.1 * scale)), -3.0)
    mode = find_scales_mode(log_density, start)
    draws = sample_scales(log_density, mode, DRAWS, DRAWS, np.random.default_rng(1)).draws
    return dict(zip(names, np.sqrt(find_squares(draws)).mean(axis=0).tolist(), strict=True))
