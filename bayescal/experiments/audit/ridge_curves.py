"""What is drawn of each ridge: its parameter against the one that follows it most, with draws, prior and curve.

The curve is that of the law that explains the ridge, where one does: then the ridge's own slope and the law's agree in
the plane of both parameters, in units of their tolerances. The straight direction of the information is drawn too.

Other ridges blur the picture, since they move the same parameters. Every draw is therefore given twice: as it is, and
taken back along all other ridges. What is left then are its move along this one and what lies off all of them.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import pandas as pd

from bayescal.density.priors import UniformPrior
from bayescal.experiments.audit.audit import Audit
from bayescal.experiments.audit.inputs import AuditInputs
from bayescal.experiments.audit.posterior import LeftOut, PosteriorLevel, list_priors
from bayescal.identifiability.design import Knowledge
from bayescal.identifiability.directions import Direction
from bayescal.identifiability.information import Information
from bayescal.identifiability.ridges import Law, Leg, LevelLine, angle_between, find_legs, list_laws
from bayescal.identifiability.sensitivity import root_of
from bayescal.numerics.geometry import Array

MAX_DRAWS = 400
AGREES = 5.0  # degrees between a ridge and a law that explains it
WIDE = 3.0  # tolerances about the mean that a straight direction is drawn
SEED = 6


@dataclass(frozen=True, eq=False)
class RidgePlot:
    """A ridge in the plane of two parameters, in the design's units.

    Attributes
    ----------
    x, y, x_unit, y_unit : str
        Names of the ridge's parameter and of its partner.
    formula : str
        Of the curve.
    explanation : str or None
        What theory says of it, with its source; None where it says nothing.
    angle : float or None
        Between the ridge and what theory says, degrees.
    points : dict of source to ndarray, shape (S, 4)
        x and y, then both without the draw's moves along the other ridges; ``prior``, and ``posterior`` or, without
        draws, ``forecast``.
    curves : dict of source to ndarray, shape (K, 2)
        ``tangent``, and ``analytic`` where theory has one.
    """

    x: str
    y: str
    x_unit: str
    y_unit: str
    formula: str
    explanation: str | None
    angle: float | None
    points: dict[str, Array]
    curves: dict[str, Array]

    def summary(self) -> dict[str, Any]:
        """Return what ``summary.json`` says of the ridge beside its direction."""
        names = {"x": self.x, "y": self.y, "x_unit": self.x_unit, "y_unit": self.y_unit, "formula": self.formula}
        return {"plot": names, "explanation": self.explanation, "explanation_angle_deg": self.angle}


def plot_ridges(inputs: AuditInputs, audit: Audit, level: PosteriorLevel | LeftOut) -> dict[int, RidgePlot]:
    """Return what is drawn of each ridge, by its place among the directions."""
    directions = audit.analysis.directions
    ridges = {k: direction for k, direction in enumerate(directions) if direction.pivot is not None}
    if not ridges:
        return {}
    plotter = _Plotter(inputs, audit.analysis.information, list(ridges.values()), level)
    return {number: plotter.plot(k) for k, number in enumerate(ridges)}


def tabulate_plots(plots: dict[int, RidgePlot]) -> dict[str, pd.DataFrame]:
    """Return the tables ``ridge_draws`` and ``ridge_curves``; directions are counted from one."""
    draws, curves = [], []
    for number, plot in plots.items():
        for source, points in plot.points.items():
            table = pd.DataFrame(points, columns=["x", "y", "x_held", "y_held"])
            draws.append(table.assign(direction=number + 1, source=source))
        for source, line in plot.curves.items():
            curves.append(pd.DataFrame(line, columns=["x", "y"]).assign(direction=number + 1, source=source))
    if not plots:
        return {}
    first = ["direction", "source"]
    tables = {"ridge_draws": pd.concat(draws), "ridge_curves": pd.concat(curves)}
    return {name: t[first + [c for c in t.columns if c not in first]] for name, t in tables.items()}


@dataclass(frozen=True, eq=False)
class _Plotter:
    inputs: AuditInputs
    information: Information
    ridges: list[Direction]
    level: PosteriorLevel | LeftOut

    @property
    def knowledge(self) -> Knowledge:
        return self.inputs.knowledge

    @cached_property
    def legs(self) -> list[Leg]:
        return find_legs(self.knowledge)

    @cached_property
    def samples(self) -> dict[str, Array]:
        """Parameters in natural units, shape (S, n), by source."""
        rng = np.random.default_rng([self.inputs.config.seed, SEED])
        columns = [
            rng.uniform(prior.lower, prior.upper, MAX_DRAWS)
            if isinstance(prior, UniformPrior)
            else rng.normal(prior.mean, prior.sd, MAX_DRAWS)
            for prior in list_priors(self.inputs).values()
        ]
        before = np.stack(columns, axis=1)
        if isinstance(self.level, PosteriorLevel):
            return {"prior": before, "posterior": self.level.draws.thin(MAX_DRAWS)}
        spread = rng.standard_normal(before.shape) @ root_of(self.information.covariance)
        return {"prior": before, "forecast": self.mean + spread * self.knowledge.sd}

    @cached_property
    def mean(self) -> Array:
        """Parameters in the middle of the ridges, shape (n,)."""
        if isinstance(self.level, PosteriorLevel):
            return self.level.draws.mean
        return np.asarray(self.knowledge.centre[self.knowledge.free])

    @cached_property
    def moves(self) -> dict[str, Array]:
        """Draws' moves along each ridge by least squares, in units of the tolerances, shape (S, k, n)."""
        vectors = np.stack([ridge.vector for ridge in self.ridges])
        back = np.linalg.pinv(vectors)
        return {
            source: ((values - self.mean) / self.knowledge.sd @ back)[..., None] * vectors
            for source, values in self.samples.items()
        }

    def plot(self, k: int) -> RidgePlot:
        """Return what is drawn of the k-th ridge."""
        knowledge, direction = self.knowledge, self.ridges[k]
        x = direction.pivot
        assert x is not None
        y = self._find_partner(direction)
        pair = np.array([x, y])
        names = [knowledge.names[i] for i in pair]
        units = [knowledge.units[i] for i in pair]
        factors = np.array([self.inputs.units.factor(unit) for unit in units])
        scale = knowledge.sd[pair] / factors
        middle = self.mean[pair] / factors
        points = {}
        for source, values in self.samples.items():
            own = np.delete(self.moves[source], k, axis=1).sum(axis=1)[:, pair]
            raw = values[:, pair] / factors
            points[source] = np.concatenate([raw, raw - own * scale], axis=1)
        step = direction.vector[pair] / np.abs(direction.vector[pair]).max()
        curves = {"tangent": middle + np.array([[-WIDE], [WIDE]]) * step * scale}
        found = self._explain(direction, x, y)
        slope = step[1] * scale[1] / (step[0] * scale[0])
        formula = f"{names[1]} moves by {slope:.4g} times {names[0]}".replace("-", "\u2212")
        explanation, angle = None, None
        if found is not None:
            law, leg, angle, line = found
            formula, explanation = law.say(leg), f"{law.say(leg)} stays the same ({law.name})."
            if len(line) > 1:
                curves["analytic"] = middle + line * scale
        x_unit, y_unit = (self.inputs.units.name(unit) for unit in units)
        return RidgePlot(names[0], names[1], x_unit, y_unit, formula, explanation, angle, points, curves)

    def _find_partner(self, direction: Direction) -> int:
        """Return the parameter that follows most, or, where none does, that the posterior ties to it most."""
        others = np.abs(direction.vector).copy()
        if np.count_nonzero(others) == 1:
            others = np.abs(self.information.covariance[direction.pivot])
        others[direction.pivot] = -1.0
        return int(np.argmax(others))

    def _explain(self, direction: Direction, x: int, y: int) -> tuple[Law, Leg, float, Array] | None:
        """Return the law that a ridge follows, the leg, the angle between both, and the law's curve, (K, 2)."""
        knowledge = self.knowledge
        (a, leg_a), (b, leg_b) = (split_name(knowledge.names[i]) for i in (x, y))
        if leg_a is None or leg_a != leg_b or not direction.vector[y]:
            return None
        law = next((law for law in list_laws(knowledge.machine) if law.ties((a, b))), None)
        if law is None:
            return None
        own = direction.vector * knowledge.sd / direction.vector[x]
        moves = {symbol: float(own[i]) for symbol, i in self._free_of(leg_a).items()}
        tolerances = (float(knowledge.sd[x]), float(knowledge.sd[y]))
        leg = self.legs[leg_a]
        line = LevelLine(law, leg, self._values(leg_a, self.mean), moves, (a, b), tolerances)
        tangent = line.tangent({symbol: float(knowledge.sd[i]) for symbol, i in self._free_of(leg_a).items()})
        angle = 90.0 if tangent is None else angle_between(tangent, direction.vector[[x, y]])
        if not angle <= AGREES:
            return None
        return law, leg, angle, line.trace(self._find_level(law, leg_a))

    def _find_level(self, law: Law, leg: int) -> float:
        """Return the mean of an invariant over the draws, which is not that of the mean where a ridge bends."""
        draws = self.samples.get("posterior", self.mean[None])
        return float(np.mean([law.invariant(self.legs[leg], self._values(leg, values)) for values in draws]))

    def _free_of(self, leg: int) -> dict[str, int]:
        """Return the free parameters of a leg by symbol."""
        split = [split_name(name) for name in self.knowledge.names]
        return {symbol: i for i, (symbol, own) in enumerate(split) if own == leg}

    def _values(self, leg: int, values: Array) -> dict[str, float]:
        """Return all parameters of a leg by symbol, from those that are free (n,)."""
        knowledge = self.knowledge
        theta = knowledge.centre.copy()
        theta[knowledge.free] = values
        blocks = knowledge.machine.layout.blocks
        index = knowledge.layout.index
        return {block.symbol: float(theta[index[block.symbol][leg]]) for block in blocks if block.per_leg}


def split_name(name: str) -> tuple[str, int | None]:
    """Return a parameter's symbol and its leg, counted from zero; None where it belongs to no leg."""
    symbol, _, leg = name.partition("[")
    return symbol, int(leg[:-1]) - 1 if leg else None
