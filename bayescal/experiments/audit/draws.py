"""What draws of the posterior say of the ridges that the information foretells.

The draws are those of a study's posterior; of poses that are only planned there are none.

The information is that of a tangent; draws follow a ridge where it bends. Their covariance has the chord for a
direction, and its smaller axes hold the bend too. Tangent and chord agree where the tangent is taken in the middle of
the draws, at their mean, and the bend stays below what is informed: the angle between both spaces says whether it does.

Eigenvectors are only known as far as their eigenvalues differ: of two directions that contract alike, one just informed
and one just not, any mixture is as good. Spaces are therefore compared below the widest gap of the remaining variances
near the threshold. How far chance alone turns the draws' space there is seen from two halves of them.

Of each ridge its parameter is drawn against the one that follows it most, with draws, prior, the straight direction of
the information and, of parameters that were profiled, the path of the profile, which bends with the ridge. Other ridges
blur the picture, since they move the same parameters. Every draw is therefore given twice: as it is, and taken back
along all other ridges. The rest then is its move along this one and what lies off all of them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import pandas as pd
from scipy.linalg import subspace_angles

from bayescal.errors import InputError
from bayescal.experiments.audit.audit import AuditOutcome
from bayescal.experiments.audit.measured import SEED, Draws, MeasuredMachine
from bayescal.experiments.audit.planned import DesignVariant
from bayescal.experiments.audit.rows import RidgeCurveRow, RidgeDrawRow
from bayescal.experiments.runner.results import Summary
from bayescal.identifiability.information import Information, root_of
from bayescal.identifiability.profile import Profile
from bayescal.identifiability.reading_rows import typical_given
from bayescal.identifiability.requirements import ToolRemaining
from bayescal.limits import IDENTIFIABLE_CONTRACTION
from bayescal.numerics.geometry import Array

GAP_FACTOR = 2.0  # a factor on the remaining variance within which a gap may stand in for the threshold
PREDICTED = 300  # draws of which the workspace's poses are computed
NOISES = 10  # for each of them
MAX_DRAWS = 400
WIDE = 3.0  # tolerances about the mean that a straight direction is drawn
SEED_OF_PLOTS = 6


@dataclass(frozen=True)
class SpaceAngle:
    """The largest principal angle between the weak directions of information and of draws."""

    degrees: float
    halves: float  # the same between two halves of the draws: what chance does to half as many
    n_directions: int  # how many are compared
    gap: float  # ratio of the remaining variances on both sides of the cut, as the information has them


@dataclass(frozen=True, eq=False)
class PosteriorLevel:
    """What draws say of n free parameters."""

    inputs: DesignVariant
    origin: str  # of the draws, in words
    draws: Draws
    angle: SpaceAngle | None  # None where no direction is weak, or all are
    # by requirement, that no pose of the workspace exceeds its limit: ``probability`` with poses predicted by all draws
    # together, ``probability_of_mean_machine`` by the machine of the posterior means, which lies off a ridge that bends
    chances: dict[str, dict[str, float]]

    @cached_property
    def covariance(self) -> Array:
        """Covariance of the draws in units of the tolerances, shape (n, n)."""
        return _covariance(self.draws.values / self.inputs.sd)

    def contraction_along(self, vector: Array) -> float:
        """Return the contraction of the draws along a unit direction (n,) in units of the tolerances."""
        return 1.0 - float(vector @ self.covariance @ vector)

    def summary(self) -> Summary:
        """Return what ``summary.json`` says of this level, in the design's units."""
        inputs, draws = self.inputs, self.draws
        values, factors = draws.values, np.array([inputs.units.factor(unit) for unit in inputs.parameters.units])
        mean, sd = values.mean(axis=0) / factors, values.std(axis=0) / factors
        contraction = 1.0 - np.diagonal(self.covariance)
        angle = self.angle
        return {
            "left_out": None,
            "origin": self.origin,
            "n_draws": len(values),
            "converged": not draws.problems,
            "problems": list(draws.problems),
            "rhat_max": float(draws.diagnostics.rhat.max()),
            "ess_bulk_min": float(draws.diagnostics.ess_bulk.min()),
            "principal_angle_deg": None if angle is None else angle.degrees,
            "principal_angle_of_halves_deg": None if angle is None else angle.halves,
            "n_directions_compared": None if angle is None else angle.n_directions,
            "gap": None if angle is None else angle.gap,
            "parameters": {
                name: {"mean": float(m), "sd": float(s), "contraction": float(c)}
                for name, m, s, c in zip(inputs.names, mean, sd, contraction, strict=True)
            },
            "requirements": self.chances,
        }


def audit_posterior(inputs: DesignVariant, draws: Draws | None, audit: AuditOutcome) -> PosteriorLevel | str:
    """Return what draws of measured data's posterior say, or why there are none."""
    if not isinstance(inputs.maker, MeasuredMachine):
        return "nothing measured: use [data]"
    if draws is None:
        return "draws is 0 in [posterior]"
    angle = compare_spaces(audit.analysis.information, draws.values / inputs.sd)
    rng = np.random.default_rng([inputs.config.seed, SEED + 1])
    # draws of the geometry alone, whose errors functions take back in part
    chances = {} if inputs.sizes else judge_draws(inputs, draws, rng)
    return PosteriorLevel(inputs, inputs.maker.found.origin, draws, angle, chances)


# --- directions --------------------------------------------------------------------------------------------------


def compare_spaces(information: Information, draws: Array) -> SpaceAngle | None:
    """Return the angle between the weak spaces of information and of draws (S, n), both in units of the tolerances."""
    variances, vectors = np.linalg.eigh(information.covariance)
    cut = _find_cut(variances[::-1])
    if cut is None:
        return None
    weak = vectors[:, ::-1][:, :cut]
    middle = len(draws) // 2
    # the axes of largest variance of all draws and of both halves, shape (n, cut) each
    every, *halves = (np.linalg.eigh(_covariance(one))[1][:, -cut:] for one in (draws, draws[:middle], draws[middle:]))
    degrees, chance = (float(np.degrees(subspace_angles(*pair)[0])) for pair in ((weak, every), halves))
    return SpaceAngle(degrees, chance, cut, float(variances[::-1][cut - 1] / variances[::-1][cut]))


def _find_cut(variances: Array) -> int | None:
    """Return how many directions lie above the widest gap near the threshold; variances (n,), the largest first."""
    threshold = 1.0 - IDENTIFIABLE_CONTRACTION
    own = int(np.sum(variances > threshold))
    if own in (0, len(variances)):
        return None
    larger, smaller = variances[:-1], variances[1:]
    near = np.abs(np.log(larger * smaller) / 2.0 - np.log(threshold)) <= np.log(GAP_FACTOR)
    near[own - 1] = True
    return 1 + int(np.argmax(np.where(near, larger / smaller, 0.0)))


def _covariance(draws: Array) -> Array:
    return np.atleast_2d(np.cov(draws, rowvar=False))


# --- requirements ------------------------------------------------------------------------------------------------


def judge_draws(inputs: DesignVariant, draws: Draws, rng: np.random.Generator) -> dict[str, dict[str, float]]:
    """Return how requirements stand by the machine itself, not by its derivatives.

    Each draw is one possible true machine. Where its tool is, is predicted by the mean of what all draws predict, or by
    the machine of mean parameters; noise of the machine in use is added. A draw that cannot take a pose exceeds every
    limit.
    """
    forecast = inputs.forecast()
    if not inputs.requirements or not np.isfinite(forecast.slope).all():
        return {}
    variant, sampling, pose = inputs.variant, inputs.posterior.sampling, inputs.around.pose
    values = draws.thin(PREDICTED)
    moves = (np.concatenate([values, draws.mean[None]]) - sampling.start[sampling.free]) @ sampling.moved
    *true, mean = sampling.start + moves
    own = np.flatnonzero(variant.internal)
    sd = np.sqrt(inputs.see_errors(pose).variance.mean(axis=0))[own]
    given = typical_given(variant.data.given, len(pose))
    remaining = ToolRemaining(
        variant.model, own, mean, pose, given, np.tile(sd, (len(true), 1)), 0, aligned=variant.aligned
    )
    by_mean = remaining.follow(np.array(true)).transpose(2, 0, 1)
    possible = np.isfinite(by_mean).all(axis=(1, 2))
    if not possible.any():
        raise InputError("workspace: found poses that posterior draws cannot take")
    by_mean = by_mean[possible]
    errors = {"probability": by_mean - by_mean.mean(axis=0), "probability_of_mean_machine": by_mean}
    root = np.swapaxes(root_of(forecast.noise), -1, -2)
    good = {name: np.zeros(len(inputs.requirements)) for name in errors}
    for _ in range(NOISES):
        added = np.einsum("wij,swj->swi", root, rng.standard_normal(by_mean.shape))
        for name, error in errors.items():
            good[name] += [r.keeps(error + added).sum() for r in inputs.requirements]
    n = NOISES * len(values)
    return {
        r.name: {name: float(count[k]) / n for name, count in good.items()} for k, r in enumerate(inputs.requirements)
    }


# --- ridges as draws show them ---------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class RidgePlot:
    """A ridge in the plane of two parameters, in the design's units."""

    # names of the ridge's parameter and of its partner
    x: str
    y: str
    x_unit: str
    y_unit: str
    formula: str  # of the straight direction
    # by source, (S, 4): x and y, then both without the draw's moves along the other ridges; ``prior``, and
    # ``posterior`` or, without draws, ``forecast``
    points: dict[str, Array]
    curves: dict[str, Array]  # by source, (K, 2): ``tangent``, and ``profile`` where there is one


def plot_ridges(
    inputs: DesignVariant, audit: AuditOutcome, level: PosteriorLevel | str, profiles: Sequence[Profile] = ()
) -> dict[int, RidgePlot]:
    """Return what is drawn of each ridge, by its place among the directions."""
    ridges = {k: one for k, one in enumerate(audit.analysis.directions) if one.pivot is not None}
    if not ridges:
        return {}
    covariance, paths = audit.analysis.information.covariance, {one.name: one.path for one in profiles}
    mean = inputs.parameters.nominal if isinstance(level, str) else level.draws.mean
    samples = _draw_samples(inputs, covariance, level)
    vectors = np.stack([ridge.vector for ridge in ridges.values()])
    back = np.linalg.pinv(vectors)
    # draws' moves along each ridge by least squares, in units of the tolerances, (S, k, n)
    moves = {source: ((values - mean) / inputs.sd @ back)[..., None] * vectors for source, values in samples.items()}
    plots = {}
    for place, (number, direction) in enumerate(ridges.items()):
        x = direction.pivot
        assert x is not None
        # the parameter that follows most, or, where none does, that the posterior ties to it most
        others = np.abs(direction.vector if np.count_nonzero(direction.vector) > 1 else covariance[x])
        pair = np.array([x, int(np.argmax(np.where(np.arange(len(others)) == x, -1.0, others)))])
        names, units = ([some[i] for i in pair] for some in (inputs.names, inputs.parameters.units))
        factors = np.array([inputs.units.factor(unit) for unit in units])
        scale, points = inputs.sd[pair] / factors, {}
        for source, values in samples.items():
            own = np.delete(moves[source], place, axis=1).sum(axis=1)[:, pair]
            raw = values[:, pair] / factors
            points[source] = np.concatenate([raw, raw - own * scale], axis=1)
        step = direction.vector[pair] / np.abs(direction.vector[pair]).max()
        curves = {"tangent": mean[pair] / factors + np.array([[-WIDE], [WIDE]]) * step * scale}
        if names[0] in paths:
            path = paths[names[0]][:, pair] / factors
            curves["profile"] = path[np.isfinite(path).all(axis=1)]
        slope = step[1] * scale[1] / (step[0] * scale[0])
        formula = f"{names[1]} moves by {slope:.4g} times {names[0]}".replace("-", "\u2212")
        x_unit, y_unit = (inputs.units.name(unit) for unit in units)
        plots[number] = RidgePlot(names[0], names[1], x_unit, y_unit, formula, points, curves)
    return plots


def _draw_samples(inputs: DesignVariant, covariance: Array, level: PosteriorLevel | str) -> dict[str, Array]:
    """Return parameters in natural units, (S, n), by source: of the prior, and of the posterior or its forecast."""
    rng, priors = np.random.default_rng([inputs.config.seed, SEED_OF_PLOTS]), inputs.maker.list_priors(inputs.section)
    before = np.stack([priors[name].draw(MAX_DRAWS, rng) for name in inputs.names], axis=1)
    if not isinstance(level, str):
        return {"prior": before, "posterior": level.draws.thin(MAX_DRAWS)}
    spread = rng.standard_normal(before.shape) @ root_of(covariance)
    return {"prior": before, "forecast": inputs.parameters.nominal + spread * inputs.sd}


def tabulate_plots(plots: dict[int, RidgePlot]) -> dict[str, pd.DataFrame]:
    """Return the tables ``ridge_draws`` and ``ridge_curves``; directions are counted from one."""
    draws = [
        RidgeDrawRow.tabulate(
            direction=k + 1, source=source, **dict(zip(("x", "y", "x_held", "y_held"), xy.T, strict=True))
        )
        for k, plot in plots.items()
        for source, xy in plot.points.items()
    ]
    curves = [
        RidgeCurveRow.tabulate(direction=k + 1, source=source, x=line[:, 0], y=line[:, 1])
        for k, plot in plots.items()
        for source, line in plot.curves.items()
    ]
    return {"ridge_draws": pd.concat(draws), "ridge_curves": pd.concat(curves)} if plots else {}
