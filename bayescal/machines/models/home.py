"""The home pose, where a machine stands with its actuators at ρ^0 (RR-8096 section 2.2), and turns since then.

Models that are referred to it (the Jacobian of the initial pose, flexures that are straight there) need it for every
parameter vector. It is that of perfect joints, by the 6-PUS closure r without deformation: the pose with G r = 0, where
G is the pseudo-inverse of the pose Jacobian at the nominal home. For six legs that is r = 0.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, lru_cache, partial

import numpy as np

from bayescal.errors import InputError, NumericalError
from bayescal.machines.deformations import DeformationBasis
from bayescal.machines.models.base import Closure, KinematicModel, Linearisation, newton_step
from bayescal.machines.models.legs import (
    LegVectors,
    add_columns,
    chart_of,
    compute_leg_vectors,
    cross_first_axis,
    scatter,
)
from bayescal.machines.models.six_pus import SixPus
from bayescal.machines.parameters import HomeStart, ParameterLayout
from bayescal.numerics.geometry import (
    DEGREES_OF_FREEDOM,
    Array,
    matrix_from_rotation_vector,
    rotation_vector_of_turn,
    skew_matrix,
)
from bayescal.numerics.scratch import Scratch

SMALLEST_VERSINE = 2.0**-53  # for which angle and sine are not yet zero


def compute_turn(rotation: Array, home: Array) -> Array:
    """Return φ = Log(R R^0ᵀ), shape (..., 3); zero where there is no home pose."""
    turned = rotation @ np.swapaxes(home, -1, -2)
    good = np.isfinite(turned).all(axis=(-1, -2), keepdims=True)
    return rotation_vector_of_turn(turned if good.all() else np.where(good, turned, np.eye(3)))


class BatchTurns:
    """Turns since home, φ = Log(R R^0ᵀ), of fixed poses and batches of home poses; below half a turn.

    Both the trace of R R^0ᵀ, 1 + 2 cos|φ|, and its skew part, of size sin|φ|, are linear in the entries of R^0.
    """

    def __init__(self, rotation: Array) -> None:
        self._half_trace = -0.5 * rotation.reshape(-1, 9)
        skew = np.zeros((3, len(rotation), 3, 3))
        for k, (m, n) in enumerate(((1, 2), (2, 0), (0, 1))):
            skew[k, :, m] += 0.5 * rotation[:, n]
            skew[k, :, n] -= 0.5 * rotation[:, m]
        self._skew = skew.reshape(3, -1, 9)
        self._scratch = Scratch()
        self._back: Array | None = None

    def evaluate(self, home_rotation: Array) -> Array:
        """Return φ, shape (3, P, B), for home rotations (3, 3, B); keeps ``stretch``, |φ| / sin|φ|, shape (P, B)."""
        shape, entries = (len(self._half_trace), home_rotation.shape[-1]), home_rotation.reshape(9, -1)
        versine, sine = (self._scratch.take(name, *shape) for name in ("versine", "sine"))
        angle, stretch = (self._scratch.take(name, *shape) for name in ("angle", "stretch"))
        np.matmul(self._half_trace, entries, out=versine)
        versine += 1.5
        np.maximum(versine, SMALLEST_VERSINE, out=versine)
        np.arccos(np.subtract(1.0, versine, out=angle), out=angle)
        np.subtract(2.0, versine, out=sine)
        sine *= versine
        np.divide(angle, np.sqrt(sine, out=sine), out=stretch)
        self._versine, self._angle, self.stretch, self._back = versine, angle, stretch, None
        self._turn = np.matmul(self._skew, entries, out=self._scratch.take("turn", 3, *shape))
        self._turn *= stretch
        return self._turn

    def turn_back(self, rotation_vector: Array) -> Array:
        """Return Jl⁻¹(φ) ω, how φ changes with small turns ω of the platform, shapes (3, P, B)."""
        if self._back is None:
            self._back = self._find_back()
        result = self._scratch.take("turned back", *rotation_vector.shape)
        return np.einsum("kmpb,mpb->kpb", self._back, rotation_vector, out=result)

    def _find_back(self) -> Array:
        """Return Jl⁻¹ = 1 - [φ]/2 + c (φ φᵀ - |φ|²), c = (1 - |φ| / 2 cot(|φ| / 2)) / |φ|², shape (3, 3, P, B)."""
        turn, take = self._turn, self._scratch.take
        back, diagonal = take("back", 3, *turn.shape), take("diagonal", *turn.shape[1:])
        square = np.multiply(self._angle, self._angle, out=take("square", *turn.shape[1:]))
        np.subtract(2.0, self._versine, out=diagonal)
        diagonal *= self.stretch
        diagonal *= 0.5  # |φ| / 2 cot(|φ| / 2)
        factor = np.divide(np.subtract(1.0, diagonal), square, out=square)
        scaled = np.multiply(turn, factor, out=take("scaled", *turn.shape))
        half = np.multiply(turn, 0.5, out=take("half", *turn.shape))
        for k, (m, n) in enumerate(((1, 2), (2, 0), (0, 1))):
            np.multiply(scaled[k], turn[k], out=back[k, k])
            back[k, k] += diagonal
            np.multiply(scaled[m], turn[n], out=back[m, n])
            np.subtract(back[m, n], half[k], out=back[n, m])
            back[m, n] += half[k]
        return back


MAX_STEPS = 30
STEP_TOLERANCE = 1e-11
CLOSED = 2e-14  # largest closure at a home pose by the machine's size: 1e-11 mm for half a metre
INNER_STEPS = 4  # each gains what the machine is like the nominal one, two digits or one
LARGEST_STEP = 100.0  # mm, rad
ONE = np.eye(DEGREES_OF_FREEDOM)[..., None]
SKEW = skew_matrix(np.eye(3)).reshape(3, 9).T  # w to the entries of its skew matrix


def guess_level_pose(lower: Array, platform_points: Array, leg_lengths: Array, start: HomeStart) -> tuple[Array, Array]:
    """Return a level pose from which Newton's method finds the home pose: the stated one, or one that the legs span.

    Lower joints (N, 3) in the base frame and joints on the platform (N, 3) in its own, leg lengths (N,), mm. InputError
    where the platform would have to stand beside its legs' reach, naming the leg that is furthest from it.
    """
    if start.position is not None:
        return np.array(start.position), np.eye(3)
    horizontal = (lower - platform_points)[:, :2]
    centre = horizontal.mean(axis=0)
    reach = leg_lengths**2 - np.sum((horizontal - centre) ** 2, axis=1)
    if np.any(reach <= 0):
        leg = int(np.argmin(reach))
        apart = float(np.linalg.norm(horizontal[leg] - centre))
        raise InputError(
            f"leg {leg + 1} of {leg_lengths[leg]:g} mm cannot span its joints, {apart:.4g} mm apart, "
            "expected longer legs or [home]"
        )
    heights = lower[:, 2] - np.sqrt(reach) if start.below else lower[:, 2] + np.sqrt(reach)
    height = np.mean(heights - platform_points[:, 2])
    return np.array([*centre, height]), np.eye(3)


@dataclass(frozen=True, eq=False)
class BatchHome:
    """Home poses of a batch of B machines, the batch last; NaN for a machine without one."""

    position: Array  # (3, B)
    rotation: Array  # (3, 3, B)
    direction: Array  # (3, N, B): u, R^0 b and g^0
    arm: Array  # (3, N, B)
    vector: Array  # (3, N, B)
    length: Array  # (N, B): |g^0|
    gain: Array  # (6, N): G


@dataclass(frozen=True, eq=False)
class HomeSolver:
    """Home pose of the nominal machine, from which those of others are found."""

    layout: ParameterLayout
    position: Array  # (3,): nominal home pose; NaN where there is none
    rotation: Array  # (3, 3)
    gain: Array  # (6, N): G: pose error (mm, rad) per mm of closure
    # (N, N): the part of a closure that a pose error explains; None for six legs, where that is all of it
    projection: Array | None
    slope: Array  # (6, D): derivative of the pose (position, rotation vector) by the parameters

    @cached_property
    def _points(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Where a, b and u's two components stand in a parameter vector, shapes (3, N), (3, N) and (2, N)."""
        names = (("a_x", "a_y", "a_z"), ("b_x", "b_y", "b_z"), chart_of(self.layout).symbols)
        a, b, u = (np.stack([self.layout.index[symbol] for symbol in group]) for group in names)
        return a, b, u

    @cached_property
    def _offset(self) -> Array:
        return (self.slope @ self.layout.nominal)[:, None]

    @cached_property
    def _tolerance(self) -> float:
        """Largest closure in mm; what the largest coordinate leaves to rounding is a hundredth of it."""
        lengths = [self.layout.take(self.layout.nominal, s) for s in ("a_x", "a_y", "a_z", "l", "rho0")]
        return CLOSED * float(np.abs(np.concatenate([self.position, *lengths])).max())

    @np.errstate(all="ignore")  # far out iterations diverge: NaN in the end
    def solve(self, theta: Array) -> BatchHome:
        """Return the home poses of parameter vectors (B, D) near the nominal machine, for hot loops.

        From the linear prediction about the nominal home, Newton steps until every machine closes; each solves its
        equations by iteration with the nominal Jacobian, which takes no factorisation per machine.
        """
        parameters, index = np.ascontiguousarray(theta.T), self.layout.index
        base, joint, u = (parameters[points] for points in self._points)
        leg_length, n_legs = parameters[index["l"]], joint.shape[1]
        direction = np.empty_like(joint)
        direction[:2] = u
        chart_of(self.layout).complete(direction)
        lower = base + parameters[index["rho0"]] * direction
        step = self.slope @ parameters - self._offset
        position = self.position[:, None] + step[:3]
        body = np.empty((3, 3 + n_legs, len(theta)))  # axes and joints of the platform, from its origin
        np.einsum("kmb,mj->kjb", turn_by(step[3:]), self.rotation, out=body[:, :3])
        np.einsum("kmb,mib->kib", body[:, :3], joint, out=body[:, 3:])
        slope = np.empty((6, *leg_length.shape))
        for _ in range(MAX_STEPS):
            vector = (position[:, None] - lower) + body[:, 3:]
            length = np.sqrt(np.einsum("kib,kib->ib", vector, vector))
            residual = leg_length - length
            seen = np.abs(residual if self.projection is None else self.projection @ residual).max(axis=0)
            moving = seen > self._tolerance  # not where it is NaN
            if not moving.any():
                break
            np.divide(vector, length, out=slope[:3])
            cross_first_axis(body[:, 3:], slope[:3], out=slope[3:])
            step = self._solve_step(slope, residual)
            step *= moving  # so that no machine's home depends on others
            position = position + step[:3]
            body = np.einsum("kmb,mib->kib", turn_by(step[3:]), body)
        rotation, arm = body[:, :3], body[:, 3:]
        lost = ~(seen <= self._tolerance)
        if lost.any():
            for part in (position, body, vector, length):
                part[..., lost] = np.nan
        return BatchHome(position, rotation, direction, arm, vector, length, self.gain)

    def _solve_step(self, slope: Array, residual: Array) -> Array:
        """Return the step s (6, B) with G (slope · s - residual) = 0, by iteration with the nominal inverse."""
        first = self.gain @ residual
        change = self.gain @ slope  # (6, 6, B), of which component m of the pose comes first
        np.subtract(ONE, change, out=change)
        step = first
        for _ in range(INNER_STEPS):
            step = np.einsum("mkb,mb->kb", change, step)
            step += first
        np.minimum(step, LARGEST_STEP, out=step)
        return np.maximum(step, -LARGEST_STEP, out=step)


def turn_by(rotation_vector: Array) -> Array:
    """Return rotations (3, 3, B) that are Exp(w) to second order in rotation vectors w, shape (3, B), by Cayley's map.

    As steps of an iteration they lead to the same end, without angles.
    """
    half = 0.5 * rotation_vector
    turn = (SKEW @ half).reshape(3, 3, -1)
    turn += half[:, None] * half
    square = np.einsum("kb,kb->b", half, half)
    diagonal = turn.reshape(9, -1)[::4]
    diagonal -= square
    turn *= 2.0 / (1.0 + square)
    diagonal += 1.0
    return turn


@lru_cache(maxsize=64)
def no_displacement(n_legs: int) -> DeformationBasis:
    """Return actuators at their initial positions, where no deformation acts."""
    return DeformationBasis(np.zeros(n_legs), np.zeros(n_legs), {}, np.zeros((n_legs, n_legs)))


@lru_cache(maxsize=64)
def home_solver(layout: ParameterLayout) -> HomeSolver:
    """Return the solver about the nominal machine's home pose, found by Newton's method."""
    theta, n_legs = layout.nominal, len(layout.index["l"])
    closure, basis = SixPus().prepare(layout, theta), no_displacement(n_legs)
    start = compute_leg_vectors(layout, theta, np.zeros(3), np.eye(3), basis)
    joint = layout.take_vector(theta, "b")
    position, rotation = guess_level_pose(joint - start.vector, joint, layout.take(theta, "l"), layout.home)
    step = np.full(6, np.nan)
    for _ in range(MAX_STEPS):
        step = newton_step(closure(position, rotation, basis, with_parameters=False))
        position = position + step[:3]
        rotation = matrix_from_rotation_vector(np.nan_to_num(step[3:])) @ rotation
        if not np.any(np.abs(step) > STEP_TOLERANCE):
            break
    if not np.abs(step).max() < STEP_TOLERANCE:
        position = np.full(3, np.nan)
    here = closure(position, rotation, basis)
    spread = np.where(np.isfinite(here.pose), -here.pose, np.eye(n_legs, 6))  # elongation per pose change
    try:
        gain = np.linalg.pinv(spread)
    except np.linalg.LinAlgError as error:
        raise NumericalError("home pose: singular pose Jacobian") from error
    projection = None if n_legs == DEGREES_OF_FREEDOM else spread @ gain
    return HomeSolver(layout, position, rotation, gain, projection, gain @ here.parameters)


# --- one machine or many, with derivatives ----------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Home:
    """Home poses of parameter vectors with their first derivatives; leading axes are those of the vectors."""

    position: Array  # (..., 3): p^0 in mm and R^0; NaN where there is none
    rotation: Array  # (..., 3, 3)
    legs: LegVectors  # leg vectors there
    gain: Array  # (6, N): G

    @cached_property
    def slope(self) -> Array:
        """Derivative of the pose (position, rotation vector) by the parameters, shape (..., 6, D)."""
        legs = self.legs
        columns = legs.columns(legs.axis, legs.axis)
        parameters = scatter(legs.layout, {"l": np.ones_like(legs.length)} | {s: -c for s, c in columns.items()})
        square = self.gain @ legs.pull_back_pose(legs.axis)
        square = np.where(np.isfinite(square).all(axis=(-1, -2), keepdims=True), square, np.eye(6))
        try:
            return np.linalg.solve(square, self.gain @ parameters)
        except np.linalg.LinAlgError as error:
            raise NumericalError("home pose: singular pose Jacobian") from error

    def pull_back(self, covector: Array, pose: Array | None, columns: dict[str, Array]) -> Array:
        """Return the parameter derivatives (..., N, D) of w_i · g_i, and of a covector (..., N, 6) on the pose.

        Those by the legs' own parameters that have nothing to do with the home pose, (..., N) each, are added.
        """
        legs = self.legs
        on_pose = legs.pull_back_pose(covector)
        on_pose = on_pose if pose is None else on_pose + pose
        own = legs.columns(covector, covector)
        own |= {symbol: own[symbol] + column if symbol in own else column for symbol, column in columns.items()}
        rows = on_pose @ self.slope
        return add_columns(legs.layout, rows, own)


def solve_home(layout: ParameterLayout, theta: Array) -> Home:
    """Return the home poses of parameter vectors (..., D), NaN where there is none."""
    leading = theta.shape[:-1]
    found = home_solver(layout).solve(theta.reshape(-1, layout.size))

    def batch_first(one: Array) -> Array:
        return np.ascontiguousarray(one.T).reshape(*leading, *one.shape[-2::-1])

    rotation = np.ascontiguousarray(found.rotation.transpose(2, 0, 1)).reshape(*leading, 3, 3)
    direction, arm, vector, length = (
        batch_first(one) for one in (found.direction, found.arm, found.vector, found.length)
    )
    axis, basis = vector / length[..., None], no_displacement(length.shape[-1])
    travel = layout.take(theta, "rho0")
    legs = LegVectors(layout, basis, rotation, direction, arm, vector, axis, travel, length)
    return Home(batch_first(found.position), rotation, legs, found.gain)


class HomeModel(KinematicModel):
    """A model whose closure is referred to the home poses of its machines: ``_close`` takes these after θ."""

    _close: Callable[..., Linearisation]

    def prepare(self, layout: ParameterLayout, theta: Array) -> Closure:
        """Return the closure, with the machines' home poses found."""
        return partial(self._close, layout, theta, solve_home(layout, theta))
