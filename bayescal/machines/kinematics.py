"""Forward and inverse kinematics of any model by Newton's method, batched, and the assembly branch that they keep to.

Lengths of legs and actuator positions fix a pose up to the branch. Two signs cannot change on the way from home unless
the machine passes a singular pose: that of u · g, on which side of its foot a carriage stands, and for six legs that of
the determinant of their lines, of unit directions and moments. They are those of perfect legs without deformation.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from bayescal.errors import InputError, NumericalError
from bayescal.machines.deformations import Deformation, DeformationBasis
from bayescal.machines.mechanism import Drive, Mechanism
from bayescal.machines.models import MODELS
from bayescal.machines.models.base import Closure, KinematicModel, Linearisation, newton_step
from bayescal.machines.models.home import guess_level_pose
from bayescal.machines.models.leg_distance import PerfectLegs
from bayescal.machines.models.legs import actuator_directions, dot
from bayescal.machines.models.six_pus import SixPus
from bayescal.machines.models.six_ups import SixUps
from bayescal.machines.parameters import HomeStart, ParameterLayout
from bayescal.numerics.geometry import (
    DEGREES_OF_FREEDOM,
    Array,
    matrix_from_rotation_vector,
    rotation_vector_from_matrix,
)

LEAST_SIDE = 1e-9  # of a leg's direction along its actuator, below which it is on no side
LEAST_TURN = 1e-9  # determinant, moments in units of the platform's size, of which nothing can be said


@dataclass(frozen=True, eq=False)
class Branch:
    """Signs at home."""

    drive: Drive
    sides: Array  # (N,): of u · g; zero where it says nothing, as for struts
    turn: float  # of the determinant of the legs' lines; zero where it says nothing

    def holds(
        self, layout: ParameterLayout, theta: Array, position: Array, rotation: Array, actuators: Array
    ) -> np.ndarray:
        """Return whether poses (..., 3), (..., 3, 3) of machines (..., D) are on the branch; those unknown are."""
        side, turn = compute_signs(self.drive, layout, theta, position, rotation, actuators)
        with np.errstate(invalid="ignore"):
            lost: np.ndarray = (side * self.sides < 0.0).any(axis=-1) | (turn * self.turn < 0.0)
        return ~lost


def compute_signs(
    drive: Drive, layout: ParameterLayout, theta: Array, position: Array, rotation: Array, actuators: Array
) -> tuple[Array, Array]:
    """Return the signs of u · g, shape (..., N), and of the determinant of the legs' lines, shape (...); zero for none.

    Of machines (..., D) at poses (..., 3), (..., 3, 3) and actuator positions (..., N), mm, base frame.
    """
    arm = layout.take_vector(theta, "b") @ np.swapaxes(rotation, -1, -2)
    leg = position[..., None, :] + arm - layout.take_vector(theta, "a")
    side = np.zeros(leg.shape[:-1])
    if drive == "base":
        u = actuator_directions(layout, theta)
        leg = leg - actuators[..., None] * u
        side = _sign(dot(u, leg) / np.linalg.norm(leg, axis=-1), LEAST_SIDE)
    if leg.shape[-2] != DEGREES_OF_FREEDOM:
        return side, np.zeros(leg.shape[:-2])
    size = np.linalg.norm(arm, axis=-1).max(axis=-1)[..., None, None]
    line = leg / np.linalg.norm(leg, axis=-1, keepdims=True)
    with np.errstate(invalid="ignore"):
        turn = np.linalg.det(np.concatenate([line, np.cross(arm / size, line)], axis=-1))
    return side, _sign(turn, LEAST_TURN)


def _sign(value: Array, least: float) -> Array:
    with np.errstate(invalid="ignore"):
        return np.where(np.abs(value) > least, np.sign(value), 0.0)


STEP_TOLERANCE = 1e-10
MOST_STEPS = 30  # of Newton's method
LARGEST_STEP = 20.0  # mm, of actuators
FAST = 0.01  # of the last step, up to which the next one takes slopes as they were
START_WITHIN_MM = 5.0  # mm, within which a reading of an actuator is where to look for it
SINGULAR_CONDITION = 1e8
LEVEL = 1e-3  # of a leg's direction along z, below which it is level
ACROSS = 1e-3  # of a leg's direction along its actuator, below which the actuator does not move it
TILTED = 1.0  # deg, of the platform at home, which legs of rounded lengths may leave
METRE = 1e3
PERFECT = (SixPus, SixUps)  # models whose actuator positions have a closed form; those derived from them may have none
APPROACHES = 12  # of actuator positions and the deflections that they cause, before Newton's method takes over
DRIVEN: dict[Drive, str] = {"base": "actuators at the base", "strut": "struts"}


@dataclass(frozen=True, eq=False)
class Machine:
    """A mechanism seen through a kinematic model and a deformation, with the layout of their parameters."""

    mechanism: Mechanism
    model: KinematicModel
    deformation: Deformation

    def __post_init__(self) -> None:
        """Check that the model takes the mechanism's drive."""
        check_drive(type(self.model), self.mechanism)

    @cached_property
    def layout(self) -> ParameterLayout:
        """Layout of the model's and the deformation's parameters."""
        mechanism = self.mechanism
        return mechanism.lay_out(self.model.blocks(mechanism) + self.deformation.blocks(mechanism.n_legs))

    @cached_property
    def is_rigid(self) -> bool:
        """Whether no actuator deflects a joint, whatever the parameters."""
        unit = self.deformation.basis(np.eye(self.mechanism.n_legs))
        return not unit.coefficients and not unit.constant.any()

    @cached_property
    def sides(self) -> Array:
        """On which side of its leg's foot each actuator stands at home, shape (N,): the sign of u · g, zero for struts.

        Of the two positions from which a leg of given length reaches a point it has the one on the side of home.
        """
        legs = span_home_legs(self.mechanism, self.nominal_home)
        return np.asarray(np.sign(np.sum(self.mechanism.directions * legs, axis=1)))

    @cached_property
    def nominal_home(self) -> ForwardKinematics:
        """The nominal machine's pose at the initial actuator positions, as Newton's method leaves it."""
        start = self.mechanism.initial_actuator_positions
        return solve_forward_kinematics(self, self.layout.nominal, start, check=False, follow=False)

    @cached_property
    def branch(self) -> Branch | None:
        """The assembly branch of home, by perfect legs; None for a model without joints a and b."""
        layout, theta, start = self.layout, self.layout.nominal, self.mechanism.initial_actuator_positions
        if not {"a_x", "b_x"} <= set(layout.symbols):
            return None
        home = self.nominal_home
        signs = compute_signs(self.mechanism.drive, layout, theta, home.position, home.rotation, start)
        sides, turn = (np.nan_to_num(sign) for sign in signs)
        return Branch(self.mechanism.drive, sides, float(turn))

    def holds_branch(self, theta: Array, position: Array, rotation: Array, actuators: Array) -> np.ndarray:
        """Return whether poses are on the assembly branch of home, shape (...)."""
        shape = np.broadcast_shapes(theta.shape[:-1], position.shape[:-1])
        if self.branch is None:
            return np.ones(shape, dtype=bool)
        return np.broadcast_to(self.branch.holds(self.layout, theta, position, rotation, actuators), shape)

    def basis(self, actuators: Array) -> DeformationBasis:
        """Return displacements from the nominal initial positions with their deflections, positions (..., N) in mm."""
        return self.deformation.basis(actuators - self.mechanism.initial_actuator_positions)

    def basis_at(self, theta: Array, actuators: Array) -> DeformationBasis:
        """Return the same with the actuators' gain of the machines (..., D) themselves, not of the nominal one."""
        return replace(self.basis(actuators), actuator_gain=self.actuator_gain(theta))

    def actuator_gain(self, theta: Array) -> Array:
        """Return by how much each actuator deflects the joints of machines (..., D), shape (..., N, N), mm per mm."""
        n_legs = self.mechanism.n_legs
        unit = self.deformation.basis(np.eye(n_legs)).deflection(self.layout, theta[..., None, :])
        return np.swapaxes(np.broadcast_to(unit, (*theta.shape[:-1], n_legs, n_legs)), -1, -2)

    def linearise(self, theta: Array, position: Array, rotation: Array, actuators: Array) -> Linearisation:
        """Return the closure and its derivatives at poses (..., 3), (..., 3, 3) and actuator positions (..., N)."""
        return self.model.linearise(self.layout, theta, position, rotation, self.basis(actuators))


def check_drive(model: type[KinematicModel], mechanism: Mechanism) -> None:
    """Raise InputError where a model does not take the drive of a mechanism."""
    if model.drive != mechanism.drive:
        fitting = sorted(name for name, other in MODELS.items() if other.drive == mechanism.drive)
        raise InputError(
            f"model {model.name!r}: found {DRIVEN[mechanism.drive]} in mechanism {mechanism.name!r}, "
            f"expected {'one of ' if len(fitting) > 1 else ''}{', '.join(fitting)}"
        )


def build_machine(model: type[KinematicModel], mechanism: Mechanism, deformation: Deformation) -> Machine:
    """Return a mechanism seen through a model; InputError where the mechanism is not one for the model."""
    check_drive(model, mechanism)
    return Machine(mechanism, model.from_mechanism(mechanism), deformation)


@dataclass(frozen=True)
class ForwardKinematics:
    """Poses found by Newton's method, with how it ended."""

    position: Array
    rotation: Array
    converged: np.ndarray
    n_iterations: int


def guess_home_pose(mechanism: Mechanism) -> tuple[Array, Array]:
    """Return a level pose from which Newton's method finds the home pose, as stated or as the legs span."""
    start = HomeStart(mechanism.home_position, mechanism.platform_below)
    try:
        return guess_level_pose(mechanism.home_joints, mechanism.platform_points, mechanism.leg_lengths, start)
    except InputError as error:
        raise InputError(f"mechanism {mechanism.name!r}: {error}") from error


def solve_forward_kinematics(
    machine: Machine, theta: Array, actuators: Array, check: bool = True, follow: bool = True
) -> ForwardKinematics:
    """Find the poses in which the closure vanishes.

    Far from home they are found along the straight path of the actuators from there, since the legs of long guides have
    other poses, too. A pose on another assembly branch than home's counts as not converged: one whose signs are others,
    and one to which neither straight way leads, of the actuators or of the platform. NumericalError where Newton's
    method does not converge, or on another branch, naming the first such pose.

    Parameters
    ----------
    machine : Machine
        Mechanism, model and deformation.
    theta : ndarray, shape (D,) or (..., D)
        Parameter vectors, broadcast against the leading axes of ``actuators``.
    actuators : ndarray, shape (..., N)
        Actuator positions ρ, mm.
    check : bool
        Raise where a pose is not found; otherwise the result's ``converged`` says so.
    follow : bool
        Go along the path and keep to the branch; otherwise Newton's method starts at home however far that is, and
        whatever closes is taken.

    Returns
    -------
    ForwardKinematics
        Positions (..., 3) in mm and rotations (..., 3, 3) in the base frame. For more than six legs the step is the
        least-squares one.
    """
    position, rotation = guess_home_pose(machine.mechanism)
    shape = np.broadcast_shapes(theta.shape[:-1], actuators.shape[:-1])
    position = np.broadcast_to(position, (*shape, 3))
    rotation = np.broadcast_to(rotation, (*shape, 3, 3))
    actuators = np.broadcast_to(actuators, (*shape, actuators.shape[-1]))
    basis = machine.basis(actuators)
    closure = machine.model.prepare(machine.layout, theta)
    kept = np.ones(shape, dtype=bool)
    if follow:
        position, rotation, kept = follow_path(machine, theta, position, rotation, actuators)
    converged = np.zeros(shape, dtype=bool)
    iteration = 0
    while iteration < MOST_STEPS and not converged.all():
        position, rotation, step = step_pose(closure, position, rotation, basis)
        converged = np.max(np.abs(step), axis=-1, initial=0.0) < STEP_TOLERANCE
        iteration += 1
    if follow:
        on_branch = np.array(machine.holds_branch(theta, position, rotation, actuators))
        strayed = on_branch & ~kept & np.isfinite(position).all(axis=-1)  # whose path left it: a straight way decides
        if strayed.any():
            some = np.broadcast_to(theta, (*shape, theta.shape[-1]))[strayed]
            on_branch[strayed] = comes_straight(machine, some, position[strayed], rotation[strayed])
        kept = on_branch
    if check and not (converged & kept).all():
        index = int(np.argmin((converged & kept).ravel()))
        fault = f"not found in {MOST_STEPS} Newton steps, expected one nearer home"
        if converged.ravel()[index]:
            fault = "only on another assembly branch"
        raise NumericalError(f"forward kinematics: pose {index + 1} of {converged.size} {fault}")
    converged = np.asarray(converged & kept)
    return ForwardKinematics(position, rotation, converged, iteration)


@dataclass(frozen=True)
class InverseKinematics:
    """Actuator positions that hold poses, with whether there are any."""

    actuators: Array
    converged: np.ndarray


def solve_inverse_kinematics(
    machine: Machine,
    theta: Array,
    position: Array,
    rotation: Array,
    check: bool = True,
    near: Array | None = None,
) -> InverseKinematics:
    """Find the actuator positions that hold given poses, the deformation that they cause included.

    Those of perfect legs are in closed form; for others Newton's method starts there. Of the two positions in which a
    leg reaches its joint, the one is found on that side of the foot on which the actuator stands at home.
    NumericalError where there are none, naming the first such pose and the leg that is furthest from it.

    Parameters
    ----------
    machine : Machine
        Mechanism, model and deformation.
    theta : ndarray, shape (D,) or (..., D)
        Parameter vectors, broadcast against the leading axes of the poses.
    position, rotation : ndarray, shapes (..., 3) and (..., 3, 3)
        Poses of the platform frame in the base frame, mm.
    check : bool
        Raise where no actuator positions are found; otherwise the result's ``converged`` says so.
    near : ndarray, shape (..., N), optional
        Where Newton's method starts instead of perfect legs, such as where the actuators were read; NaN where unknown.
    """
    layout, n_legs = machine.layout, machine.mechanism.n_legs
    shape = (*np.broadcast_shapes(theta.shape[:-1], position.shape[:-1]), n_legs)
    actuators, settled = _place_actuators(machine, theta, position, rotation)
    gap, converged = actuators, np.isfinite(actuators).all(axis=-1)
    if not settled:
        initial = machine.mechanism.initial_actuator_positions
        if near is not None:  # on the side of the foot on which perfect legs stand
            actuators = np.where(np.abs(near - actuators) < START_WITHIN_MM, near, actuators)
        actuators = np.broadcast_to(np.where(np.isfinite(actuators), actuators, initial), shape)
        closure, gain = machine.model.prepare(layout, theta), machine.actuator_gain(theta)
        before: Array | None = None
        jacobian: Array | None = None
        for _ in range(MOST_STEPS):
            basis = replace(machine.basis(actuators), actuator_gain=gain)
            alone = None if jacobian is None else machine.model.close(closure, position, rotation, basis)
            if jacobian is None or alone is None:
                here = closure(position, rotation, basis, with_parameters=False)
                gap, jacobian = here.residual, here.actuators
            else:
                gap = alone
            step = _actuator_step(gap, jacobian)
            actuators, size = actuators + step, np.abs(step).max(axis=-1)
            # steps shrink at least as fast as the last two did: by how much the next one would move
            left = size if before is None else np.minimum(size, size**2 / np.maximum(before, STEP_TOLERANCE))
            if not np.any(left >= STEP_TOLERANCE):
                break
            if before is not None and np.any(size > FAST * before):
                jacobian = None  # where slopes stay as they were steps hardly shrink
            before = size
        converged = left < STEP_TOLERANCE
    if check and not converged.all():
        index = int(np.argmin(converged.ravel()))
        far = np.nan_to_num(np.abs(np.broadcast_to(gap, shape).reshape(-1, n_legs)[index]), nan=np.inf)
        leg = int(np.argmax(far))
        lengths = np.broadcast_to(layout.take(theta, "l"), shape).reshape(-1, n_legs)
        raise NumericalError(
            f"inverse kinematics: leg {leg + 1} cannot reach pose {index + 1} of {converged.size}, "
            f"l[{leg + 1}] is {lengths[index, leg]:g} mm"
        )
    return InverseKinematics(actuators, converged)


def _place_actuators(machine: Machine, theta: Array, position: Array, rotation: Array) -> tuple[Array, bool]:
    """Return where actuators of perfect legs stand, shape (..., N), and whether these are the machine's own.

    Where its actuators deflect joints these are followed by turns; NaN where a leg does not reach.
    """
    layout, initial = machine.layout, machine.mechanism.initial_actuator_positions
    if not {"a_x", "b_x", "l"} <= set(layout.symbols):
        return initial, False
    legs = PerfectLegs(layout, theta, position, rotation, machine.sides)
    actuators = initial + legs.displace()
    if type(machine.model) not in PERFECT or machine.is_rigid:
        return actuators, type(machine.model) in PERFECT
    for _ in range(APPROACHES):
        before, basis = actuators, machine.basis(actuators)
        actuators = initial + legs.displace(basis.deflection(layout, theta))
        if not np.any(np.abs(actuators - before) >= STEP_TOLERANCE):
            return actuators, True
    return actuators, False


def _actuator_step(gap: Array, jacobian: Array) -> Array:
    """Return the Newton step (..., N) by f and its derivative by the actuators, bounded.

    NaN for a pose with a leg that has none, as across its guide.
    """
    good, identity = np.isfinite(gap).all(axis=-1), np.eye(gap.shape[-1])
    by_actuators, residual = np.where(good[..., None, None], jacobian, identity), gap[..., None]
    try:
        step = -np.linalg.solve(by_actuators, residual)[..., 0]
    except np.linalg.LinAlgError:
        good &= np.linalg.det(by_actuators) != 0.0
        step = -np.linalg.solve(np.where(good[..., None, None], by_actuators, identity), residual)[..., 0]
    return np.where(good[..., None], np.clip(step, -LARGEST_STEP, LARGEST_STEP), np.nan)


def check_home_pose(machine: Machine) -> ForwardKinematics:
    """Return the nominal home pose; InputError where it does not exist, is singular or tilted.

    The condition number is taken with lengths scaled by the platform's size, so that it does not depend on units.
    """
    mechanism = machine.mechanism
    theta, actuators = machine.layout.nominal, mechanism.initial_actuator_positions
    try:
        home = solve_forward_kinematics(machine, theta, actuators)
    except NumericalError as error:
        raise InputError(
            f"mechanism {mechanism.name!r}: found no home pose, expected legs that close{_name_widest_gap(mechanism)}; "
            f"{error}"
        ) from error
    jacobian = machine.linearise(theta, home.position, home.rotation, actuators).pose
    size = float(np.linalg.norm(mechanism.platform_points, axis=1).max())
    condition = float(np.linalg.cond(jacobian / np.array([1, 1, 1, size, size, size])))
    if not condition < SINGULAR_CONDITION:
        raise InputError(
            f"mechanism {mechanism.name!r}: singular at home, condition {condition:.1e}, expected "
            f"below {SINGULAR_CONDITION:.0e}"
        )
    tilt = float(np.degrees(np.arccos(np.clip(home.rotation[2, 2], -1.0, 1.0))))
    if tilt > TILTED:  # home is level by definition
        raise InputError(
            f"mechanism {mechanism.name!r}: found a home tilt of {tilt:.3g} deg, expected {TILTED:g} "
            "at most: other lengths, or home.position_mm"
        )
    _check_strokes(mechanism, home)
    return home


def _name_widest_gap(mechanism: Mechanism) -> str:
    """Return which leg is furthest from its length where the search for the home pose begins, for messages."""
    position, _ = guess_home_pose(mechanism)
    spans = np.linalg.norm(position + mechanism.platform_points - mechanism.home_joints, axis=1)
    leg = int(np.argmax(np.abs(spans - mechanism.leg_lengths)))
    x, y, z = position
    return (
        f" (leg {leg + 1} of {mechanism.leg_lengths[leg]:g} mm: joints {spans[leg]:.4g} mm apart at "
        f"{x:.4g}, {y:.4g}, {z:.4g} mm)"
    )


def _check_strokes(mechanism: Mechanism, home: ForwardKinematics) -> None:
    """Raise InputError for a strut that could shrink to nothing, or a leg across its actuator, which cannot move it."""
    if mechanism.drive == "strut":
        leg = int(np.argmin(mechanism.leg_lengths))
        length, stroke = float(mechanism.leg_lengths[leg]), mechanism.actuator_range
        if stroke >= length:  # lengths were written in another unit than mm
            metres = "; joints in metres?" if stroke < METRE * length else ""
            raise InputError(
                f"mechanism {mechanism.name!r}: found an actuator range of {stroke:g} mm, expected "
                f"less than strut {leg + 1}, {length:.4g} mm{metres}"
            )
        return
    legs = span_home_legs(mechanism, home)
    along = np.abs(np.sum(mechanism.directions * legs, axis=1)) / np.linalg.norm(legs, axis=1)
    if not along.min() >= ACROSS:
        leg = int(np.argmin(along))
        raise InputError(
            f"mechanism {mechanism.name!r}: leg {leg + 1} stands across its actuator (cosine "
            f"{along[leg]:.1e}), expected at least {ACROSS:g}"
        )


def compute_home_legs(machine: Machine) -> Array:
    """Return the nominal vectors from lower to upper joint at the home pose, shape (N, 3), base frame, mm."""
    return span_home_legs(machine.mechanism, check_home_pose(machine))


def span_home_legs(mechanism: Mechanism, home: ForwardKinematics) -> Array:
    """Return the same of a home pose that is known."""
    return home.position + mechanism.platform_points @ home.rotation.T - mechanism.home_joints


def compute_leg_lines(machine: Machine) -> Array:
    """Return the lines of the nominal legs at the home pose, z / z_z, shape (N, 3).

    They tell how an actuator's direction acts along its leg. Of a level leg, whose z_z is next to nothing, the line is
    its unit direction without that.
    """
    legs = compute_home_legs(machine)
    level = np.abs(legs[:, 2:]) < LEVEL * np.linalg.norm(legs, axis=1, keepdims=True)
    flat = legs * [1.0, 1.0, 0.0]
    size = np.where(level, np.linalg.norm(flat, axis=1, keepdims=True), legs[:, 2:])
    return np.asarray(np.where(level, flat, legs) / size)


STRIDE = 0.25  # of the shortest leg, that actuators move from one pose of a path to the next one
STEPS_ON_THE_WAY = 4  # of Newton's method at each pose of a path
SETTLED = 1e-3  # mm and rad, of the last of them, above which there is no pose on the path
FINER = 8  # times as many poses on a path that was lost
LOOKS = 32  # at poses of a straight way of the platform


def step_pose(
    closure: Closure, position: Array, rotation: Array, basis: DeformationBasis
) -> tuple[Array, Array, Array]:
    """Return the poses after a Newton step, and the step."""
    step = newton_step(closure(position, rotation, basis, with_parameters=False))
    return position + step[..., :3], matrix_from_rotation_vector(step[..., 3:]) @ rotation, step


def follow_path(
    machine: Machine, theta: Array, position: Array, rotation: Array, actuators: Array
) -> tuple[Array, Array, np.ndarray]:
    """Return poses of perfect joints near those of actuators (..., N), from home poses, and whether the path led there.

    Machines whose actuators travel little by design have theirs near enough to home: these poses are returned. Where a
    path leaves the branch of home, a finer one is tried.
    """
    mechanism, shape = machine.mechanism, position.shape[:-1]
    n_strides = int(np.ceil(mechanism.actuator_range / (STRIDE * mechanism.leg_lengths.min())))
    if mechanism.drive == "strut" or n_strides < 2:
        return position, rotation, np.ones(shape, dtype=bool)
    reached, turned, kept = _walk(machine, theta, position, rotation, actuators, n_strides)
    if kept.all():
        return reached, turned, kept
    reached, turned, kept = (np.array(one) for one in (reached, turned, kept))
    lost = ~kept
    some = np.broadcast_to(theta, (*shape, theta.shape[-1]))[lost]
    found = _walk(machine, some, position[lost], rotation[lost], actuators[lost], FINER * n_strides)
    reached[lost], turned[lost], kept[lost] = found
    return reached, turned, kept


def _walk(
    machine: Machine, theta: Array, position: Array, rotation: Array, actuators: Array, n_strides: int
) -> tuple[Array, Array, np.ndarray]:
    """Return poses along the straight path of the actuators, and whether all on the way settled on home's branch."""
    closure, start = SixPus().prepare(machine.layout, theta), machine.mechanism.initial_actuator_positions
    kept = np.ones(position.shape[:-1], dtype=bool)
    for share in np.arange(1, n_strides + 1) / n_strides:
        here = start + share * (actuators - start)
        basis = machine.basis(here)
        for _ in range(STEPS_ON_THE_WAY):
            position, rotation, step = step_pose(closure, position, rotation, basis)
        kept = kept & (np.abs(step) < SETTLED).all(axis=-1) & machine.holds_branch(theta, position, rotation, here)
    return position, rotation, kept


def comes_straight(machine: Machine, theta: Array, position: Array, rotation: Array) -> np.ndarray:
    """Return whether the straight ways of the platform from home to poses (L, 3), (L, 3, 3) keep to home's branch.

    Carriages of perfect legs follow on the side of home; theta is of shape (L, D).
    """
    home, share = machine.nominal_home, (np.arange(1, LOOKS + 1) / LOOKS)[:, None]
    turn = rotation_vector_from_matrix(rotation @ home.rotation.T)
    between = home.position + share * (position - home.position)[:, None]
    turned = matrix_from_rotation_vector(share * turn[:, None]) @ home.rotation
    one = theta[:, None]
    legs = PerfectLegs(machine.layout, one, between, turned, machine.sides)
    actuators = machine.mechanism.initial_actuator_positions + legs.displace()
    kept = np.isfinite(actuators).all(axis=-1) & machine.holds_branch(one, between, turned, actuators)
    return np.asarray(kept.all(axis=1))
