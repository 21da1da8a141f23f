"""What draws of the posterior say of the ridges that the information foretells.

With data the draws are those of the study's posterior. Without data they are those of the posterior to expect: the
planned poses of the expected machine, measured without error but weighed as their noise deserves.

The information is that of a tangent; draws follow a ridge where it bends. Their covariance has the chord for a
direction, and its smaller axes hold the bend too. Tangent and chord agree where the tangent is taken in the middle of
the draws, at their mean, and the bend stays below what is informed: the angle between both spaces says whether it does.

Eigenvectors are only known as far as their eigenvalues differ: of two directions that contract alike, one just informed
and one just not, any mixture is as good. Spaces are therefore compared below the widest gap of the remaining variances
near the threshold. How far chance alone turns the draws' space there is seen from two halves of them.

Of each ridge its parameter is drawn against the one that follows it most, with draws, prior and curve. The curve is
that of the law that explains the ridge, where one does: then the ridge's own slope and the law's agree in the plane of
both parameters, in units of their tolerances. The straight direction of the information is drawn too. Other ridges
blur the picture, since they move the same parameters. Every draw is therefore given twice: as it is, and taken back
along all other ridges. The rest then is its move along this one and what lies off all of them.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import pandas as pd
from scipy.linalg import subspace_angles

from bayescal.data.measured_poses import MeasuredPoses
from bayescal.density.legs import LegPosterior, build_leg_posterior, check_machine
from bayescal.density.pose_likelihood import PoseLikelihood
from bayescal.density.priors import NormalPrior, Prior, UniformPrior
from bayescal.density.schema import UniformConfig
from bayescal.errors import InputError
from bayescal.experiments.audit.audit import Audit
from bayescal.experiments.audit.legs import SEED, LegPlan, draw
from bayescal.experiments.frame.parallel import Run
from bayescal.identifiability.design import Knowledge, predict_poses
from bayescal.identifiability.directions import Direction
from bayescal.identifiability.draws import Draws
from bayescal.identifiability.information import Information
from bayescal.identifiability.ridges import Law, Leg, LevelLine, angle_between, find_legs, list_laws
from bayescal.identifiability.sensitivity import compute_sensitivity, root_of
from bayescal.limits import INFORMED
from bayescal.machines.frames import N_FRAME_PARAMETERS
from bayescal.machines.kinematics import solve_forward_kinematics
from bayescal.numerics.geometry import Array, compute_pose_error
from bayescal.report.symbols import split_name

EXPECTED = "Expected: the planned poses of the expected machine, without error"
NEAR = 2.0  # a factor on the remaining variance within which a gap may stand in for the threshold
BLIND = 1e-12  # of the largest eigenvalue of a pose's information, below which it does not see all of the pose
PREDICTED = 300  # draws of which the workspace's poses are computed
NOISES = 10  # for each of them
MAX_DRAWS = 400
AGREES = 5.0  # degrees between a ridge and a law that explains it
WIDE = 3.0  # tolerances about the mean that a straight direction is drawn
SEED_OF_PLOTS = 6


@dataclass(frozen=True)
class SpaceAngle:
    """The largest principal angle between the weak directions of information and of draws.

    Attributes
    ----------
    degrees : float
    halves : float
        The same between two halves of the draws: what chance does to half as many.
    n_directions : int
        How many are compared.
    gap : float
        Ratio of the remaining variances on both sides of the cut, as the information has them.
    """

    degrees: float
    halves: float
    n_directions: int
    gap: float


@dataclass(frozen=True)
class Chance:
    """How probable it is that no pose of the workspace exceeds a limit.

    Attributes
    ----------
    probability : float
        With poses predicted by all draws together.
    of_mean_machine : float
        With poses predicted by the machine whose parameters are the posterior means. Where a ridge bends, that machine
        lies off it, and predicts worse than any draw.
    """

    probability: float
    of_mean_machine: float


@dataclass(frozen=True, eq=False)
class PosteriorLevel:
    """What draws say of n free parameters.

    Attributes
    ----------
    inputs : LegPlan
    origin : str
        Of the draws, in words.
    draws : Draws
    angle : SpaceAngle or None
        None where no direction is weak, or all are.
    chances : dict of requirement to Chance
    """

    inputs: LegPlan
    origin: str
    draws: Draws
    angle: SpaceAngle | None
    chances: dict[str, Chance]

    @cached_property
    def covariance(self) -> Array:
        """Covariance of the draws in units of the tolerances, shape (n, n)."""
        return _covariance(self.draws.values / self.inputs.knowledge.sd)

    def contraction_along(self, vector: Array) -> float:
        """Return the contraction of the draws along a unit direction (n,) in units of the tolerances."""
        return 1.0 - float(vector @ self.covariance @ vector)

    def summary(self) -> dict[str, Any]:
        """Return what ``summary.json`` says of this level, in the design's units."""
        inputs, draws = self.inputs, self.draws
        knowledge, values = inputs.knowledge, draws.values
        factors = np.array([inputs.units.factor(unit) for unit in knowledge.units])
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
                for name, m, s, c in zip(knowledge.names, mean, sd, contraction, strict=True)
            },
            "requirements": {
                name: {"probability": chance.probability, "probability_of_mean_machine": chance.of_mean_machine}
                for name, chance in self.chances.items()
            },
        }


@dataclass(frozen=True)
class LeftOut:
    """An audit without this level, and why."""

    reason: str

    def contraction_along(self, vector: Array) -> None:
        """Return None: nothing is known."""
        del vector


def audit_posterior(inputs: LegPlan, audit: Audit, run: Run) -> PosteriorLevel | LeftOut:
    """Return what draws of the posterior say, or why there are none."""
    if inputs.measured is not None:
        origin, draws = inputs.measured.origin, inputs.measured.draws
        if draws is None:
            return LeftOut("the design wants no draws: draws is 0 in [posterior]")
    else:
        n_draws = inputs.config.posterior.draws
        if not n_draws:
            return LeftOut("the design wants no draws: it has neither [data] nor draws in [posterior]")
        posterior = build_expected_posterior(inputs)
        if isinstance(posterior, LeftOut):
            return posterior
        task = (posterior, inputs.config.posterior, n_draws, inputs.config.seed)
        origin, draws = EXPECTED, run.once("posterior", draw, task, (Draws,))
    angle = compare_spaces(audit.analysis.information, draws.values / inputs.knowledge.sd)
    rng = np.random.default_rng([inputs.config.seed, SEED + 1])
    # draws of the geometry alone, whose errors functions take back in part
    chances = {} if inputs.sizes else judge_draws(inputs, draws, rng)
    return PosteriorLevel(inputs, origin, draws, angle, chances)


def build_expected_posterior(inputs: LegPlan) -> LegPosterior | LeftOut:
    """Return the posterior of noise-free planned poses of the expected machine, or why it cannot be had."""
    knowledge, plan = inputs.knowledge, inputs.plan
    machine = knowledge.machine
    theta = knowledge.machine_centre
    if np.any(knowledge.free >= machine.layout.size):
        return LeftOut("frames are free, and the likelihood is that of poses measured in the machine's own frames")
    if plan.systematic is not None:
        return LeftOut("legs err by functions of the pose, which the likelihood of planned poses does not have")
    found = predict_poses(machine, theta, plan.actuators)
    information = plan.information(found)
    blind = _find_blind_pose(information)
    if blind is not None:
        return LeftOut(f"the sensors see only a part of pose {blind + 1}, and the likelihood is that of whole poses")
    names = tuple(str(k + 1) for k in range(plan.n_poses))
    poses = MeasuredPoses(names, found.position, found.rotation, np.linalg.inv(information), plan.actuators)
    model_error = np.full(plan.actuators.shape, plan.model_error**2)
    likelihood = PoseLikelihood(machine, poses, plan.actuator_noise, model_error)
    posterior = build_leg_posterior(likelihood, list_priors(inputs), fixed=knowledge.fixed)
    check_machine(posterior)
    return posterior


def list_priors(inputs: LegPlan) -> dict[str, Prior]:
    """Return the priors of all free parameters, in order."""
    knowledge = inputs.knowledge
    if inputs.measured is not None:
        return {name: inputs.measured.posterior.priors[name] for name in knowledge.names}
    priors: dict[str, Prior] = {}
    centre, known = knowledge.centre[knowledge.free], inputs.config.parameters
    for name, symbol, mean, sd in zip(knowledge.names, knowledge.symbols, centre, knowledge.sd, strict=True):
        half = float(np.sqrt(3.0) * sd)
        uniform = isinstance(known.get(symbol), UniformConfig)  # a frame's parameter is none of these
        priors[name] = UniformPrior(mean - half, mean + half) if uniform else NormalPrior(mean, sd)
    return priors


def _find_blind_pose(information: Array) -> int | None:
    """Return the first pose of which a part is not seen, with mm and rad made comparable."""
    scale = np.sqrt(np.diagonal(information, axis1=-2, axis2=-1))
    unseen = (scale <= 0.0).any(axis=-1)
    scale = np.where(scale > 0.0, scale, 1.0)
    values = np.linalg.eigvalsh(information / scale[:, :, None] / scale[:, None, :])
    blind = unseen | (values[:, 0] < BLIND * values[:, -1])
    return int(np.argmax(blind)) if blind.any() else None


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
    threshold = 1.0 - INFORMED
    own = int(np.sum(variances > threshold))
    if own in (0, len(variances)):
        return None
    larger, smaller = variances[:-1], variances[1:]
    near = np.abs(np.log(larger * smaller) / 2.0 - np.log(threshold)) <= np.log(NEAR)
    near[own - 1] = True
    return 1 + int(np.argmax(np.where(near, larger / smaller, 0.0)))


def _covariance(draws: Array) -> Array:
    return np.atleast_2d(np.cov(draws, rowvar=False))


# --- requirements ------------------------------------------------------------------------------------------------


def judge_draws(inputs: LegPlan, draws: Draws, rng: np.random.Generator) -> dict[str, Chance]:
    """Return how requirements stand by the machine itself, not by its derivatives.

    Each draw is one possible true machine. Its poses are predicted by the mean of what all draws predict, or by the
    machine of mean parameters; actuators and model error are added as the plan has them. A draw that cannot take a pose
    exceeds every limit.
    """
    if not inputs.requirements:
        return {}
    knowledge, actuators = inputs.knowledge, inputs.workspace_actuators
    values = draws.thin(PREDICTED)
    theta = np.broadcast_to(knowledge.centre, (len(values) + 1, knowledge.layout.size)).copy()
    theta[:-1, knowledge.free], theta[-1, knowledge.free] = values, draws.mean
    machine_theta = theta[:, None, :-N_FRAME_PARAMETERS]
    found = solve_forward_kinematics(knowledge.machine, machine_theta, actuators, check=False)
    possible = found.converged[:-1].all(axis=1)
    if not (found.converged[-1].all() and possible.any()):
        raise InputError("workspace: found poses that the posterior's machines cannot take, expected none")
    position, rotation = found.position, found.rotation
    by_mean = compute_pose_error(position[:-1][possible], rotation[:-1][possible], position[-1:], rotation[-1:])
    errors = {"probability": by_mean - by_mean.mean(axis=0), "of_mean_machine": by_mean}
    noise = compute_sensitivity(knowledge, actuators, theta[-1]).pose_noise(inputs.plan)
    root = np.swapaxes(root_of(noise), -1, -2)
    good = {name: np.zeros(len(inputs.requirements)) for name in errors}
    for _ in range(NOISES):
        added = np.einsum("wij,swj->swi", root, rng.standard_normal(by_mean.shape))
        for name, error in errors.items():
            good[name] += [r.keeps(error + added).sum() for r in inputs.requirements]
    n = NOISES * len(values)
    return {
        r.name: Chance(**{name: float(count[k]) / n for name, count in good.items()})
        for k, r in enumerate(inputs.requirements)
    }


# --- ridges as draws show them ---------------------------------------------------------------------------------------


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


def plot_ridges(inputs: LegPlan, audit: Audit, level: PosteriorLevel | LeftOut) -> dict[int, RidgePlot]:
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
    inputs: LegPlan
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
        rng = np.random.default_rng([self.inputs.config.seed, SEED_OF_PLOTS])
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
        # the parameter that follows most, or, where none does, that the posterior ties to it most
        others = np.abs(direction.vector if np.count_nonzero(direction.vector) > 1 else self.information.covariance[x])
        y = int(np.argmax(np.where(np.arange(len(others)) == x, -1.0, others)))
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

    def _explain(self, direction: Direction, x: int, y: int) -> tuple[Law, Leg, float, Array] | None:
        """Return the law that a ridge follows, the leg, the angle between both, and the law's curve, (K, 2)."""
        knowledge = self.knowledge
        (a, number), (b, other) = (split_name(knowledge.names[i]) for i in (x, y))
        law = next((law for law in list_laws(knowledge.machine) if law.ties((a, b))), None)
        if law is None or not number or number != other or not direction.vector[y]:
            return None
        own, leg = direction.vector * knowledge.sd / direction.vector[x], self.legs[number - 1]
        split = {i: split_name(name) for i, name in enumerate(knowledge.names)}
        free = {symbol: i for i, (symbol, place) in split.items() if place == number}
        moves = {symbol: float(own[i]) for symbol, i in free.items()}
        tolerances = (float(knowledge.sd[x]), float(knowledge.sd[y]))
        line = LevelLine(law, leg, self._values(number, self.mean), moves, (a, b), tolerances)
        tangent = line.tangent({symbol: float(knowledge.sd[i]) for symbol, i in free.items()})
        angle = 90.0 if tangent is None else angle_between(tangent, direction.vector[[x, y]])
        if not angle <= AGREES:
            return None
        # the mean of the invariant over the draws is not that of the mean where a ridge bends
        draws = self.samples.get("posterior", self.mean[None])
        level = float(np.mean([law.invariant(leg, self._values(number, values)) for values in draws]))
        return law, leg, angle, line.trace(level)

    def _values(self, leg: int, values: Array) -> dict[str, float]:
        """Return all parameters of a leg, counted from one, by symbol, from those that are free (n,)."""
        knowledge = self.knowledge
        theta = knowledge.centre.copy()
        theta[knowledge.free] = values
        blocks = knowledge.machine.layout.blocks
        index = knowledge.layout.index
        return {block.symbol: float(theta[index[block.symbol][leg - 1]]) for block in blocks if block.per_leg}
