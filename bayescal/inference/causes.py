"""Which single sort of functions explains what a model errs by: evidence of each alone, in closed form.

A usual cause makes one sort of errors: a screw errs linearly in its own position, a coupling in those of all, joints
and bending smoothly, heat in measuring order. So the posterior's evidence with functions of one sort only is compared
with that of all sorts together, errors drawn independently at every pose and factors on the noise being free in all.
Geometry is normal given the errors' sizes, to first order about a machine, and is integrated out with them; a sort
that is not there has a size of zero. All sizes have the priors of the posterior: one sort that suffices gains by the
room that the others would have had.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any, Final, NamedTuple

import numpy as np

from bayescal.density.components import LinearGeometry
from bayescal.density.directions import CAUSES
from bayescal.density.pose_kernels import OF_SORT
from bayescal.density.posterior import Posterior
from bayescal.density.priors import FUNCTIONS
from bayescal.inference.scales import LogDensity, find_scales_mode, sample_scales
from bayescal.numerics.geometry import Array

ABSENT: Final = -8.0  # coordinate of a size of practically zero: what lies below has a prior probability of 1e-15
BEGIN: Final = 0.5  # of the search for a size, where others are not there: data may want more than beside these
DRAWS: Final = 200
NONE: Final = "none"
QUANTILES: Final = (0.5, 0.05, 0.95)


class SingleCause(NamedTuple):
    """What there is of a single cause and no other: log-evidence less that of all sorts together, nat, and its size.

    The size's median and 90 % interval are mm, root mean square; NaN where nothing is there.
    """

    log_odds: float
    median: float
    low: float
    high: float


def weigh_causes(posterior: Posterior[Any, Any, Any], y: Array, rng: np.random.Generator) -> dict[str, SingleCause]:
    """Return what there is of one sort of functions alone; ``none`` of none at all.

    So, too, of the named causes of `bayescal.density.directions`, where the machine can have them.

    Parameters
    ----------
    posterior : Posterior
        With a model error whose functions are of one or more sorts; of others nothing is returned.
    y : ndarray, shape (n,)
        About which the geometry is linear.
    rng : Generator
    """
    names, zeta = posterior.errors.names, y[posterior.n_geometry :]
    functions = [k for k, name in enumerate(names) if name in FUNCTIONS]
    linear = posterior.linear_geometry(y) if functions else None
    if linear is None:
        return {}

    def weigh(kept: list[int], log_mass: LogDensity = linear.log_mass) -> tuple[float, Array]:
        absent = [k for k in functions if k not in kept]
        free = [k for k in range(len(names)) if k not in absent]
        known = 0.5 * ABSENT**2 * len(absent) - 0.5 * np.log(2.0 * np.pi) * len(free)

        def fill(values: Array) -> Array:
            full = np.full((*values.shape[:-1], len(names)), ABSENT)
            full[..., free] = values
            return full

        start = np.array([max(zeta[k], BEGIN) if absent and k in functions else zeta[k] for k in free])
        mode = find_scales_mode(lambda values: log_mass(fill(values)), start)
        found = sample_scales(lambda values: log_mass(fill(values)), mode, DRAWS, DRAWS, rng)
        sizes = linear.sizes(fill(found.draws))[:, kept]
        quantiles = np.quantile(sizes[:, 0], QUANTILES) if len(kept) == 1 else np.full(len(QUANTILES), np.nan)
        return known + found.log_evidence, quantiles

    together, _ = weigh(functions)
    kept = {NONE: [], **{names[k].removeprefix(OF_SORT): [k] for k in functions}}
    weighed = {name: weigh(some) for name, some in kept.items()}
    place = functions[0]  # a cause has the prior of a sort, and its coordinate
    for cause in CAUSES:
        log_mass = _tell(posterior.linear_geometry(y, cause), posterior.n_geometry, place)
        if log_mass is not None:
            weighed[cause] = weigh([place], log_mass)
    return {name: SingleCause(value - together, *size.tolist()) for name, (value, size) in weighed.items()}


def _tell(linear: LinearGeometry | None, m: int, place: int) -> LogDensity | None:
    """Return the density of ζ alone where a coordinate is the size s of a cause's coefficients, N(0, s²)."""
    if linear is None:
        return None
    n = len(linear.pull) - m

    def log_mass(zeta: Array) -> Array:
        size, without = linear.sizes(zeta)[:, place], zeta.copy()
        without[:, place] = ABSENT
        precision = np.tile(linear.precision, (len(zeta), 1, 1))
        precision[:, m:, m:] += np.eye(n) / size[:, None, None] ** 2
        there = replace(linear, precision=precision).solve(without).log_marginal - n * np.log(size)
        return np.asarray(there + 0.5 * (ABSENT**2 - zeta[:, place] ** 2))

    return log_mass
