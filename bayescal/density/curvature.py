"""The exact curvature of a log-likelihood by the model errors, for climbs.

Fisher's information has geometry and model errors independent of each other and takes squared errors by their
expectation. A climb of a model that does not fit is far from both, and takes tens of steps where Newton's take ten.
"""

from __future__ import annotations

import numpy as np

from bayescal.density.likelihood import Likelihood
from bayescal.density.local import Local
from bayescal.numerics.geometry import Array


def differentiate_model_errors(
    likelihood: Likelihood, local: Local, model_errors: Array, moves: Array, bends: Array
) -> tuple[Array, Array]:
    """Return second derivatives of the log-likelihood, by geometry and model errors (m, k), and by these alone (k, k).

    With C = C₀ + W diag(w τ²) Wᵀ, g = Wᵀ C⁻¹ e and Q = Wᵀ C⁻¹ W of a pose, ∂C/∂τ_i = 2 w_i τ_i W_i W_iᵀ gives

        ∂²/∂y ∂τ_i = 2 w_i τ_i g_i (W_iᵀ C⁻¹ ∂e/∂y),
        ∂²/∂τ_i ∂τ_j = 2 w_i τ_i w_j τ_j (Q_ij² - 2 g_i Q_ij g_j) + δ_ij w_i (g_i² - Q_ii).

    Parameters
    ----------
    likelihood : Likelihood
    local : Local
        Around the point.
    model_errors : ndarray, shape (K,)
        τ, mm.
    moves, bends : ndarray, shape (k, K)
        First and second derivatives of τ by its k coordinates; no two coordinates move the same one.
    """
    told = likelihood.on_legs(np.einsum("pij,pj->pi", local.precision, local.errors))
    steered = likelihood.on_legs(local.precision @ local.slope)
    seen = np.swapaxes(likelihood.on_legs(np.swapaxes(likelihood.on_legs(local.precision), 1, 2)), 1, 2)
    weight = likelihood.actuator_weight
    scaled, surplus = weight * model_errors, told**2 - np.diagonal(seen, axis1=1, axis2=2)
    across = 2.0 * np.einsum("pi,pim->mi", scaled * told, steered)
    pulled = scaled * told
    own = 2.0 * np.einsum("pi,pij,pj->ij", scaled, seen**2, scaled)
    own -= 4.0 * np.einsum("pi,pij,pj->ij", pulled, seen, pulled)
    own += np.diag(np.sum(weight * surplus, axis=0))
    by_errors = np.sum(scaled * surplus, axis=0)
    return across @ moves.T, moves @ own @ moves.T + np.diag(bends @ by_errors)
