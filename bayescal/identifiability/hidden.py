"""How much of a parameter an error hides that leaves no trace.

Rows y = X θ + V u + ε, white, with standard deviations of the priors of θ as units and functions V u of the pose of a
covariance f² E = V Vᵀ that the model does not have. Given the rows, whatever they are, what may be there of u has the
covariance A = (1 + Vᵀ (1 + X Xᵀ)⁻¹ V)⁻¹: all of what the geometry imitates, and as much of the rest as noise covers.
The estimate G y, G = Σ Xᵀ, that knows nothing of them is off by G V u, so that

    Cov(bias | unseen) = G V A Vᵀ Gᵀ = Σ(f) - Σ(0),

by how much the posterior covariance grows where the functions are allowed for. It is not f² G E Gᵀ, which counts errors
that residuals would have shown; without noise, a gain of prior variance a² and an error of variance f² that is exactly
like it give a² f² / (a² + f²). Where functions of sizes s are in the model already, Σ(√(s² + f²)) - Σ(s) is what is
hidden beside these.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np

from bayescal.density.posterior import Posterior
from bayescal.limits import LASTING, UNSEEN_UM
from bayescal.numerics.geometry import Array
from bayescal.numerics.units import MICROMETRE

DRAWS: Final = 20  # of the sizes of a posterior's errors


def choose_unseen(floors: Mapping[str, float], there: Sequence[str]) -> dict[str, float]:
    """Return root mean squares of unseen errors by term, mm: those stated, else `UNSEEN_UM` shared by what is there."""
    sorts = [name for name in LASTING if name in there]
    usual = dict.fromkeys(sorts, MICROMETRE * UNSEEN_UM / max(1, len(sorts)) ** 0.5)
    return {name: size for name, size in (floors or usual).items() if name in there}


def add(sizes: Mapping[str, float], unseen: Mapping[str, float], sign: float = 1.0) -> dict[str, float]:
    """Return √(s² ± f²) by term."""
    names = dict.fromkeys((*sizes, *unseen))
    square = {name: sizes.get(name, 0.0) ** 2 + sign * unseen.get(name, 0.0) ** 2 for name in names}
    return {name: float(np.sqrt(max(0.0, one))) for name, one in square.items()}


def hide(allowed: Array, ignored: Array) -> Array:
    """Return the bias of each parameter, root mean square (n,), from covariances (n, n) with and without the errors."""
    return np.asarray(np.sqrt(np.maximum(np.diagonal(allowed - ignored), 0.0)))


def hide_in_posterior(posterior: Posterior[Any, Any, Any], y: Array, unseen: Mapping[str, float]) -> Array:
    """Return how much errors hide of each of n parameters, in its unit, (n,), over draws (T, N) of a posterior.

    ``unseen``: root mean squares by term, mm, that errors of the posterior have at least, or would have besides.
    """
    theta, change = posterior.around(y.mean(axis=0))
    slope, natural = posterior.sampling.prior_slope(change), change[posterior.sampling.free]
    some = y[np.linspace(0, len(y) - 1, min(DRAWS, len(y))).astype(int)]
    found = []
    for errors in (posterior.errors.with_floors(unseen), posterior.errors.with_floors({})):
        information = [
            posterior.likelihood.inform(theta, change, errors, zeta) + slope.T @ slope for zeta in posterior.zeta(some)
        ]
        found.append(natural @ np.linalg.inv(information).mean(axis=0) @ natural.T)
    return hide(*found)
