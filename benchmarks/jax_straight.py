"""bayescal's straight coordinates written in JAX, for NUTS: from whitened x to standardised parameters z.

Three maps one after the other, as `bayescal.inference.reparameterisation` and `bayescal.machines.coordinates` have
them: x = mean + L η of the proposal's main component; skew and shear along traced ridges, to the sampling coordinates
y; from these to the parameters, attachment points and gains counted from what a direction does to them and lengths from
what closes the legs at a reference pose. Only skew and scales change volumes. What the posteriors of `peers.py` do not
have, model errors and loose directions among it, is refused.
"""

# ruff: noqa: I001 - telescope_problem comes before NumPy and JAX: it sets the number of threads
from __future__ import annotations

from collections.abc import Callable

from telescope_problem import Problem, standardise  # before JAX: sets one thread

import jax
import jax.numpy as jnp
import numpy as np

from jax_density import Places, take
from bayescal.density.calibration.likelihood import CalibrationPosterior
from bayescal.inference.exploration import Exploration
from bayescal.inference.quantile_transform import N_KNOTS, REACH, QuantileTransform
from bayescal.inference.reparameterisation import Ridges
from bayescal.machines.coordinates import ClosingCoordinates
from bayescal.machines.models.legs import chart_of

Map = Callable[[jax.Array], jax.Array]
SPACING = 2.0 * REACH / (N_KNOTS - 1)


def build_straight(
    problem: Problem, posterior: CalibrationPosterior, found: Exploration
) -> tuple[Callable[[jax.Array], tuple[jax.Array, jax.Array]], np.ndarray, np.ndarray]:
    """Return z and the log of the volume gained as functions of η, shape (n,), and the mean and factor of x."""
    straight, main = found.straight, int(np.argmax(found.proposal.weights))
    assert not straight.follows_errors, "errors are free"
    assert straight.loose is None, "directions are loose"
    mean, factor = found.proposal.means[main], found.proposal.factors[main]
    skew, shear = build_skew(straight.skew), build_shear(straight.ridges)
    z_from_y = build_parameters(problem, posterior)

    def place(eta: jax.Array) -> tuple[jax.Array, jax.Array]:
        w, gain = skew(jnp.asarray(mean) + jnp.asarray(factor) @ eta)
        return z_from_y(shear(w)), gain

    return place, mean, factor


def build_skew(skew: QuantileTransform | None) -> Callable[[jax.Array], tuple[jax.Array, jax.Array]]:
    """Return w and log |dw/dv| as functions of v, shape (n,); see `QuantileTransform.forward`."""
    if skew is None:
        return lambda v: (v, jnp.zeros(()))
    bases, origin, lean = skew.bases, jnp.asarray(skew.origin), jnp.asarray(skew.lean)
    values, slopes = jnp.asarray(skew.quantiles.values), SPACING * jnp.asarray(skew.quantiles.slopes)
    (at, unit), rows = (one[0] for one in skew.quantiles.inverse(skew.origin[None])), np.arange(len(bases))

    def forward(v: jax.Array) -> tuple[jax.Array, jax.Array]:
        place = (at + (v[bases] - origin) / unit + REACH) / SPACING
        k = jnp.clip(place, 0.0, N_KNOTS - 2.0).astype(int)
        low, start, end = values[rows, k], slopes[rows, k], slopes[rows, k + 1]
        rise = values[rows, k + 1] - low
        part = jnp.clip(place - k, 0.0, 1.0)
        both = part * (1.0 - part)
        below = rise + (start + end - 2.0 * rise) * both
        slope = rise**2 * (end * part**2 + 2.0 * rise * both + start * (1.0 - part) ** 2) / below**2
        to = low + rise * (rise * part**2 + start * both) / below + slope * (place - k - part)
        return v + (to - v[bases]) @ lean, jnp.sum(jnp.log(slope / SPACING / unit))

    return forward


def build_shear(ridges: Ridges | None) -> Map:
    """Return y as a function of w, shape (n,); see `Ridges.add_to`."""
    if ridges is None:
        return lambda w: w
    bases, centres, halves = ridges.bases, jnp.asarray(ridges.centres), jnp.asarray(ridges.halves)
    series, order = jnp.asarray(ridges.series), np.arange(ridges.series.shape[1])
    slopes = jnp.asarray(np.polynomial.chebyshev.chebder(ridges.series, axis=1))

    def add(w: jax.Array) -> jax.Array:
        place = (w[bases] - centres) / halves
        inside = jnp.clip(place, -1.0, 1.0)
        terms = [jnp.ones_like(inside), inside]
        for _ in order[2:]:
            terms.append(2.0 * inside * terms[-1] - terms[-2])
        sums = jnp.stack(terms, axis=-1)
        beyond = sums[:, : len(order) - 1] * (place - inside)[:, None]
        return w + jnp.einsum("rd,rdn->n", sums, series) + jnp.einsum("rd,rdn->n", beyond, slopes)

    return add


def build_parameters(problem: Problem, posterior: CalibrationPosterior) -> Map:
    """Return z as a function of sampling coordinates y, shape (n,); see `ClosingCoordinates.theta_from_y`."""
    known = posterior.sampling.coordinates
    assert isinstance(known, ClosingCoordinates)
    assert known._circles is None and not known.rings and not known.bounded.any()  # noqa: PT018 - one demand
    assert np.array_equal(chart_of(known.layout).axes, np.tile(np.eye(3), (6, 1, 1)))
    free, centre, scale = standardise(posterior)
    index = {symbol: np.asarray(positions) for symbol, positions in known.layout.index.items()}
    start, rho0 = jnp.asarray(known.start), jnp.asarray(known.start[index["rho0"]])
    joints, axis, leg = known._shears._joints
    gains, rising = known._shears._gains
    along = jnp.asarray(known.legs[rising, :2])
    lengths = index["l"][known._lengths]
    reference = Places.of(problem.machine, known.position, known.rotation, known.actuators)
    gap, slope = jnp.asarray(known._gap), jnp.asarray(known._slope)

    def place(y: jax.Array) -> jax.Array:
        theta = start.at[free].set(jnp.asarray(known._origin) + jnp.asarray(known.scale) * y)
        p = take(theta, index)
        direction = p["u"]
        theta = theta.at[joints].add(-rho0[leg] * direction[leg, axis])
        tilted = jnp.sum(along * direction[rising, :2], axis=-1)
        theta = theta.at[gains].add(direction[rising, 2] + tilted)
        held = theta.at[lengths].set(start[lengths])
        closure = held[index["l"]] - reference.reach(take(held, index)).length[0]
        theta = theta.at[lengths].add((closure[known._lengths] - gap) / -slope)
        return (theta[free] - centre) / scale

    return place
