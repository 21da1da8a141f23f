"""A machine on legs by what it reads: encoders, inclinometers at the base joints, an instrument beside it.

The pose v is position and rotation vector of the platform frame in the base frame. What a machine reads there:

- ``rho[i]``: the position of actuator i, by inverse kinematics. With the closure f(pose, ρ; d) = 0 the derivatives are
  ∂ρ/∂v = -(∂f/∂ρ)⁻¹ ∂f/∂v and ∂ρ/∂d = -(∂f/∂ρ)⁻¹ ∂f/∂d, those of a hexapod's struts being its Jacobian's. With a
  ``gain`` γ of each actuator among the parameters (a lead error of its screw, a scale of its encoder) it reads
  s = ρ_0 + (ρ - ρ_0) / γ, ρ_0 its nominal initial position: there it changes nothing, so that l and ρ^0 hardly imitate
  it. It changes what is read and nothing of the closure: joints are deflected by the true travel.
- ``tilt_a[i]``, ``tilt_b[i]``: how far leg i is inclined at its base joint, about two axes fixed there: angles of its
  vector g from the nominal one at home, in the planes of e0 with e1 and with e2,

      atan2(g · e1, g · e0) - tilt_a0,   atan2(g · e2, g · e0) - tilt_b0,

  e0 along the nominal leg at home, e1 horizontal, e2 = e0 × e1. Where an inclinometer has its zero is a parameter;
  its axes are taken as mounted.
- ``x y z rx ry rz``: the pose, seen by an instrument beside the machine, for the calibration only.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from bayescal.machines.coordinates import ClosingCoordinates, Coordinates
from bayescal.machines.kinematics import (
    ForwardKinematics,
    Machine,
    check_home_pose,
    compute_home_legs,
    compute_leg_lines,
    solve_forward_kinematics,
    solve_inverse_kinematics,
)
from bayescal.machines.models.base import BoundClosure
from bayescal.machines.models.legs import LegVectors, compute_leg_vectors, scatter
from bayescal.machines.parameters import ParameterBlock, ParameterLayout
from bayescal.machines.readings.base import (
    NO_CONDITIONS,
    POSE,
    POSE_CHANNELS,
    BoundReadings,
    Channel,
    Coordinate,
    Given,
    ReadingModel,
    Readings,
)
from bayescal.machines.readings.newton import locate_pose
from bayescal.numerics.geometry import (
    Array,
    compute_left_jacobian,
    matrix_from_rotation_vector,
    rotation_vector_from_matrix,
    skew_matrix,
)

TILTS = ("tilt_a", "tilt_b")
GAIN = "gain"
TURN = 0.5 * np.pi  # rad, the largest half width of a workspace about an axis
UPRIGHT = 1.0 - 1e-9  # of a leg's direction along z, beyond which x is taken for horizontal


def list_leg_channels(n_legs: int, inclined: bool) -> tuple[Channel, ...]:
    """Return what N legs may read, whatever model they are seen by, and the pose as an instrument sees it."""
    kinds = (("rho", "mm"), *((kind, "rad") for kind in TILTS if inclined))
    internal = [Channel(f"{kind}[{leg}]", unit) for kind, unit in kinds for leg in range(1, n_legs + 1)]
    return (*internal, *POSE_CHANNELS)


@dataclass(frozen=True, eq=False)
class Legs(ReadingModel):
    """A machine of N legs with their encoders and inclinometers, and the pose as an instrument sees it."""

    machine: Machine  # mechanism, model and deformation
    # (3,): the tool's centre, platform frame, mm; known. None where the whole pose has to be accurate
    tool_point: Array | None = None
    name: str = ""  # that of the mechanism where it is left out
    # whether it could have inclinometers, whose zeros are parameters then: K = 3 N + 6 sensors instead of N + 6
    inclined: bool = False
    # whether gains of the actuators are parameters; always where the mechanism states them
    has_gains: bool = False
    known: Array | None = None  # (P, N): where encoders were read at poses asked of it; see `ReadingModel.near`

    actuated = ("rho",)  # the encoders
    offered = (GAIN,)
    shifting = ("l",)
    pose_channels = POSE_CHANNELS  # the rotation vector compared as a rotation

    def __post_init__(self) -> None:
        """Take over the mechanism's name."""
        super().__post_init__()
        object.__setattr__(self, "name", self.name or self.machine.mechanism.name)
        object.__setattr__(self, "has_gains", self.has_gains or self.machine.mechanism.actuator_gains is not None)

    def with_optional(self, names: Iterable[str]) -> Legs:
        """Return the same with gains of its actuators where they are named; see `ReadingModel.with_optional`."""
        own = self.has_gains or GAIN in self.machine.layout.symbols  # a custom model may have such a parameter
        return self if own or GAIN not in names else replace(self, has_gains=True)

    @property
    def optional(self) -> Mapping[str, str]:
        """The gains, which are those of encoders."""
        return {GAIN: "rho"} if self.has_gains else {}

    @property
    def legs(self) -> Legs:
        """Itself."""
        return self

    @property
    def n_legs(self) -> int:
        """Number of legs N."""
        return self.machine.mechanism.n_legs

    @cached_property
    def layout(self) -> ParameterLayout:
        """The machine's parameters, gains, then the zeros of inclinometers; nominally they read zero at home."""
        blocks = [ParameterBlock(f"{kind}0", (0.0,) * self.n_legs, "rad") for kind in (TILTS if self.inclined else ())]
        if self.has_gains:
            gains = self.machine.mechanism.actuator_gains
            nominal = (1.0,) * self.n_legs if gains is None else tuple(gains.tolist())
            blocks.insert(0, ParameterBlock(GAIN, nominal, "1", lower=0.0))
        return self.machine.layout.extend(tuple(blocks))

    @cached_property
    def sensors(self) -> tuple[Channel, ...]:
        """Encoders, inclinometers about e1 and e2, then the pose as an instrument sees it."""
        every, mechanism = list_leg_channels(self.n_legs, self.inclined), self.machine.mechanism
        start, reach = mechanism.initial_actuator_positions, mechanism.actuator_range
        ends = [(float(one) - reach, float(one) + reach) for one in start]
        own = zip(every, ends, strict=False)
        return (*(replace(one, ends=its) for one, its in own), *every[self.n_legs :])

    @cached_property
    def _tilts(self) -> tuple[str, ...]:
        """Kinds of inclinometers that it has."""
        return tuple(kind for kind in TILTS if any(one.kind == kind for one in self.channels))

    @property
    def computed(self) -> tuple[Channel, ...]:
        """All but inclinometers of a kind of which it has none."""
        return tuple(one for one in self.sensors if one.kind in self._tilts or one.kind not in TILTS)

    @property
    def command_range(self) -> Array:
        """How far the actuators go."""
        mechanism = self.machine.mechanism
        start, reach = mechanism.initial_actuator_positions, mechanism.actuator_range
        own = [one.name in self.commanded for one in self.sensors[: self.n_legs]]
        return np.stack([start - reach, start + reach], axis=1)[own]

    @property
    def travels(self) -> dict[str, float]:
        """How far the actuators go from home."""
        return dict.fromkeys(self.commanded, self.machine.mechanism.actuator_range)

    @cached_property
    def home_pose(self) -> Array:
        """The nominal pose at the initial actuator positions, shape (6,), mm and rad."""
        home = self.machine.nominal_home
        if not home.converged:
            home = check_home_pose(self.machine)  # says why there is none
        return np.concatenate([home.position, rotation_vector_from_matrix(home.rotation)])

    @cached_property
    def coordinates(self) -> tuple[Coordinate, ...]:
        """Position and rotation vector of the platform's frame, as far as the actuators take it to first order."""
        home, mechanism = self.home_pose, self.machine.mechanism
        rotation = matrix_from_rotation_vector(home[3:])
        here = self.machine.linearise(
            self.machine.layout.nominal, home[:3], rotation, mechanism.initial_actuator_positions
        )
        by_actuators = np.abs(np.linalg.pinv(here.pose) @ here.actuators)
        if mechanism.actuator_gains is not None:
            by_actuators = by_actuators * mechanism.actuator_gains
        reach = np.minimum(mechanism.actuator_range * by_actuators.sum(axis=-1), [np.inf] * 3 + [TURN] * 3)
        kinds = zip(POSE_CHANNELS, home, reach, strict=True)
        return tuple(Coordinate(one.name, one.unit, float(at), float(half)) for one, at, half in kinds)

    @property
    def tool_channels(self) -> tuple[Channel, ...]:
        """x, y and z of the tool's centre, or the pose."""
        return POSE_CHANNELS if self.tool_point is None else tuple(Channel(name, "mm") for name in POSE[:3])

    # --- readings ------------------------------------------------------------------------------------------------

    @cached_property
    def _axes(self) -> Array:
        """e0, e1 and e2 of each leg, shape (3, N, 3), base frame."""
        legs = compute_home_legs(self.machine)
        along = legs / np.linalg.norm(legs, axis=1, keepdims=True)
        level = np.cross([0.0, 0.0, 1.0], along)
        level[np.abs(along[:, 2]) > UPRIGHT] = [1.0, 0.0, 0.0]
        level /= np.linalg.norm(level, axis=1, keepdims=True)
        return np.stack([along, level, np.cross(along, level)])

    def _own(self, theta: Array) -> Array:
        """Return the machine's own parameters, without the zeros of inclinometers."""
        return theta[..., : self.machine.layout.size]

    def place_actuators(self, theta: Array, readings: Array) -> Array:
        """Return where actuators stand that read (..., N), mm, of machines (..., D)."""
        if not self.has_gains:
            return readings
        start = self.machine.mechanism.initial_actuator_positions
        return np.asarray(start + self.layout.take(theta, GAIN) * (readings - start))

    def read_actuators(self, theta: Array, positions: Array) -> Array:
        """Return what actuators read that stand at positions (..., N), mm."""
        if not self.has_gains:
            return positions
        start = self.machine.mechanism.initial_actuator_positions
        return np.asarray(start + (positions - start) / self.layout.take(theta, GAIN))

    def solve(self, theta: Array, readings: Array) -> ForwardKinematics:
        """Return the platform's poses where actuators read (..., N), mm; it says of which there is none."""
        standing = self.place_actuators(theta, readings)
        return solve_forward_kinematics(self.machine, self._own(theta), standing, check=False)

    def _hold(self, theta: Array, pose: Array) -> tuple[Array, Array, Array]:
        """Return position, rotation and where the actuators that hold it stand, NaN where there are none."""
        position, rotation = pose[..., :3], matrix_from_rotation_vector(np.nan_to_num(pose[..., 3:]))
        with np.errstate(all="ignore"):
            own, near = self._own(theta), None if self.known is None else self.place_actuators(theta, self.known)
            found = solve_inverse_kinematics(self.machine, own, position, rotation, check=False, near=near)
        return position, rotation, np.where(found.converged[..., None], found.actuators, np.nan)

    def _measure_tilt(self, kind: str, theta: Array, legs: LegVectors) -> tuple[Array, Array]:
        """Return what inclinometers read, shape (..., N), and its derivatives by the leg vectors, (..., N, 3)."""
        along, across = self._axes[0], self._axes[1 + TILTS.index(kind)]
        x, y = (np.einsum("...ik,ik->...i", legs.vector, axis) for axis in (along, across))
        covector = (x[..., None] * across - y[..., None] * along) / (x**2 + y**2)[..., None]
        return np.arctan2(y, x) - self.layout.take(theta, f"{kind}0"), covector

    def _join(self, pose: Array, actuators: Array, tilts: Sequence[tuple[Array, Array]]) -> Array:
        """Return the readings that are computed."""
        seen = np.broadcast_to(pose, (*actuators.shape[:-1], len(POSE)))
        return np.concatenate([actuators, *(values for values, _ in tilts), seen], axis=-1)

    def read(self, theta: Array, pose: Array, given: Given = NO_CONDITIONS) -> Array:
        """Return the readings; see `ReadingModel.read`."""
        del given
        position, rotation, actuators = self._hold(theta, pose)
        tilts = []
        if self._tilts:
            basis = self.machine.basis(actuators)
            legs = compute_leg_vectors(self.machine.layout, self._own(theta), position, rotation, basis)
            tilts = [self._measure_tilt(kind, theta, legs) for kind in self._tilts]
        return self.take(self._join(pose, self.read_actuators(theta, actuators), tilts))

    def linearise(
        self, theta: Array, pose: Array, with_parameters: bool = True, given: Given = NO_CONDITIONS
    ) -> Readings:
        """Return the readings with their derivatives; see `ReadingModel.linearise`."""
        del given
        machine, n, own = self.machine, self.n_legs, self._own(theta)
        position, rotation, actuators = self._hold(theta, pose)
        with np.errstate(all="ignore"):
            basis = machine.basis_at(own, actuators)
            closure = machine.model.prepare(machine.layout, own)(position, rotation, basis, with_parameters)
            legs = compute_leg_vectors(machine.layout, own, position, rotation, basis) if self._tilts else None
        tilts = [] if legs is None else [self._measure_tilt(kind, theta, legs) for kind in self._tilts]
        read = self.read_actuators(theta, actuators)
        values = self._join(pose, read, tilts)
        # by the pose's error in the base frame, then by its coordinates
        by_pose = np.zeros((*values.shape, len(POSE)))
        by_pose[..., :n, :] = -divide_closure(closure.actuators, closure.pose)
        by_parameters = np.zeros((*values.shape, self.layout.size)) if with_parameters else np.empty(0)
        if with_parameters:
            by_parameters[..., :n, : machine.layout.size] = -divide_closure(closure.actuators, closure.parameters)
        for k, (kind, (_, covector)) in enumerate(zip(self._tilts, tilts, strict=True), start=1):
            assert legs is not None
            rows, back = slice(k * n, (k + 1) * n), legs.pull_back(covector, with_parameters)
            by_pose[..., rows, :] = back.pose + back.actuators @ by_pose[..., :n, :]
            if with_parameters:
                by_parameters[..., rows, :] = back.actuators @ by_parameters[..., :n, :]
                by_parameters[..., rows, : machine.layout.size] += scatter(machine.layout, back.columns)
                by_parameters[..., rows, self.layout.index[f"{kind}0"]] -= np.eye(n)
        if self.has_gains:
            gain = self.layout.take(theta, GAIN)
            by_pose[..., :n, :] /= gain[..., None]
            if with_parameters:
                by_parameters[..., :n, :] /= gain[..., None]
                apart = (read - machine.mechanism.initial_actuator_positions) / gain
                by_parameters[..., :n, self.layout.index[GAIN]] = -np.eye(n) * apart[..., None]
        own_rows = by_pose[..., : -len(POSE), 3:]
        own_rows[...] = own_rows @ compute_left_jacobian(np.nan_to_num(pose[..., 3:]))
        by_pose[..., -len(POSE) :, :] = np.eye(len(POSE))
        return Readings(values, by_pose, by_parameters).pick(self.places)

    def error_gain(self, theta: Array, pose: Array, given: Given = NO_CONDITIONS) -> Array | None:
        """Return how the model error of each channel shows in all of them; see `ReadingModel.error_gain`.

        A leg's model error is an error of its own closure: unlike a displacement of its actuator it deflects no other
        leg's joint. With B = ∂f/∂ρ, and L the same where actuators deflect nothing but their own joints, it shows in
        the actuators as B⁻¹ L.
        """
        del given
        machine, n = self.machine, self.n_legs
        nominal = machine.basis(machine.mechanism.initial_actuator_positions).actuator_gain
        if not np.any(nominal * ~np.eye(n, dtype=bool)):  # no actuator deflects the joints of other legs
            return None
        own = self._own(theta)
        position, rotation, actuators = self._hold(theta, pose)
        basis = machine.basis_at(own, actuators)
        alone = replace(basis, actuator_gain=basis.actuator_gain * np.eye(n))
        closure = machine.model.prepare(machine.layout, own)
        whole, lone = (closure(position, rotation, one, with_parameters=False).actuators for one in (basis, alone))
        gain = np.zeros((*actuators.shape[:-1], len(self.computed), len(self.computed)))
        gain[...] = np.eye(len(self.computed))
        gain[..., :n, :n] = divide_closure(whole, lone)
        if self.has_gains:
            scale = self.layout.take(theta, GAIN)
            gain[..., :n, :n] *= scale[..., None, :] / scale[..., :, None]
        return np.swapaxes(self.take(np.swapaxes(self.take(gain), -1, -2)), -1, -2)

    def rotation(self, pose: Array) -> Array:
        """Return the platform's rotation; see `ReadingModel.rotation`."""
        return matrix_from_rotation_vector(pose[..., 3:])

    def tool_values(self, theta: Array, pose: Array) -> Array:
        """Return where the tool's centre p + R t is, or the pose; see `ReadingModel.tool_values`."""
        place = pose if self.tool_point is None else pose[..., :3] + self.rotation(pose) @ self.tool_point
        return np.broadcast_to(place, (*np.broadcast_shapes(theta.shape[:-1], pose.shape[:-1]), place.shape[-1]))

    def tool(self, theta: Array, pose: Array, with_parameters: bool = True) -> tuple[Array, Array, Array]:
        """Return the same with what moves it; see `ReadingModel.tool`. No parameter does."""
        place = self.tool_values(theta, pose)
        by_pose = np.zeros((*place.shape, len(POSE)))
        by_pose[...] = np.eye(place.shape[-1], len(POSE))
        if self.tool_point is not None:
            by_pose[..., 3:] = -skew_matrix(place - pose[..., :3]) @ compute_left_jacobian(pose[..., 3:])
        return place, by_pose, np.zeros((*place.shape, self.layout.size)) if with_parameters else np.empty(0)

    def near(self, values: Array) -> Legs:
        """Return the same legs with inverse kinematics that start where encoders were read."""
        names = [one.name for one in self.channels]
        known = np.full((len(values), self.n_legs), np.nan)
        for leg in range(self.n_legs):
            if (name := f"rho[{leg + 1}]") in names:
                known[:, leg] = values[:, names.index(name)]
        return replace(self, known=known)

    def bind(self, theta: Array, values: Array, pose: Array, given: Given = NO_CONDITIONS) -> BoundReadings | None:
        """Return the encoders' readings by the closure at these poses; see `ReadingModel.bind`.

        What they read is ρ - (∂f/∂ρ)⁻¹ f at the measured ρ, to first order, with the slope of one machine: no inverse
        kinematics for each. None beside inclinometers, and where an encoder was not read.
        """
        del given
        places = np.flatnonzero([one.kind == "rho" for one in self.channels])
        if self._tilts or len(places) < self.n_legs or not np.isfinite(values[:, places]).all():
            return None
        machine, own, actuators = self.machine, self._own(theta), self.place_actuators(theta, values[:, places])
        position, rotation = pose[:, :3], matrix_from_rotation_vector(pose[:, 3:])
        closure = machine.model.bind(machine.layout, position, rotation, machine.basis(actuators))
        at_own = machine.basis_at(own, actuators)
        here = machine.model.prepare(machine.layout, own)(position, rotation, at_own, False)
        closure.evaluate(np.asfortranarray(np.broadcast_to(own, (len(POSE), len(own)))))
        unit = np.ascontiguousarray(np.broadcast_to(np.eye(len(POSE))[:, None], (len(POSE), len(pose), len(POSE))))
        more = here.pose - closure.along(unit).transpose(1, 0, 2)
        inverse = divide_closure(here.actuators, np.broadcast_to(np.eye(actuators.shape[1]), here.actuators.shape))
        turns = compute_left_jacobian(pose[:, 3:])
        gains = self.layout.index[GAIN] if self.has_gains else None
        here_gain = None if gains is None else theta[gains]
        place = (position, rotation)
        return BoundLegs(places, len(own), machine, place, actuators, closure, inverse, more, turns, gains, here_gain)

    def straighten(self, known: Coordinates, hidden: bool) -> Coordinates:
        """Return coordinates that follow directions and joints; see `bayescal.machines.coordinates`.

        Where errors hide joints, lengths follow these so that the legs close at home.
        """
        machine, home = self.machine, self.home_pose
        straight = replace(known, legs=compute_leg_lines(machine), symbols=self.layout.symbols)
        if not hidden:
            return straight
        start, turn = machine.mechanism.initial_actuator_positions, matrix_from_rotation_vector(home[None, 3:])
        return ClosingCoordinates.around(straight, machine, home[None, :3], turn, start[None])

    # --- commands --------------------------------------------------------------------------------------------------

    def locate(
        self,
        theta: Array,
        commands: Array,
        given: Given = NO_CONDITIONS,
        start: Array | None = None,
        weights: Array | None = None,
    ) -> tuple[Array, np.ndarray]:
        """Return the poses of actuator positions by forward kinematics, which keeps to home's branch.

        Those of redundant legs, which may contradict each other, are then that of least squares in the actuators.
        """
        if len(self.commanded) < self.n_legs:
            return super().locate(theta, commands, given, start, weights)
        found = self.solve(theta, commands)
        good = found.converged
        turned = np.full((*good.shape, 3), np.nan)
        turned[good] = rotation_vector_from_matrix(found.rotation[good])
        pose = np.concatenate([np.where(good[..., None], found.position, np.nan), turned], axis=-1)
        if self.n_legs == len(POSE):
            return pose, good
        near = np.where(good[..., None], pose, self.home_pose)
        pose, arrived = locate_pose(self, theta, commands, given, near, weights)
        return np.where(good[..., None], pose, np.nan), good & arrived

    def respond(self, theta: Array, mean: Array, pose: Array, commands: Array, given: Given = NO_CONDITIONS) -> Array:
        """Return h - ρ as -(∂f/∂ρ)⁻¹ f, whose slope is the mean machine's: no inverse kinematics for each draw."""
        if len(self.commanded) < self.n_legs:
            return super().respond(theta, mean, pose, commands, given)
        machine = self.machine
        position, rotation = pose[:, :3], matrix_from_rotation_vector(np.nan_to_num(pose[:, 3:]))
        standing = self.place_actuators(mean, commands)
        with np.errstate(all="ignore"):  # poses that were not found
            basis = machine.basis(standing)
            closure = machine.model.bind(machine.layout, position, rotation, basis)
            residual = closure.evaluate(np.asfortranarray(self._own(theta))).transpose(1, 0, 2)
            own = self._own(mean)
            at_mean = machine.basis_at(own, standing)
            here = machine.model.prepare(machine.layout, own)(position, rotation, at_mean, False)
            moved = -divide_closure(here.actuators, residual)
        if not self.has_gains:
            return moved
        start = machine.mechanism.initial_actuator_positions
        travel = (standing - start)[..., None] + moved
        return np.asarray(travel / self.layout.take(theta, GAIN).T - (commands - start)[..., None])


@dataclass(frozen=True, eq=False)
class BoundLegs(BoundReadings):
    """Encoders of machines on legs at poses that stay, by a bound closure."""

    places: np.ndarray
    n_own: int
    machine: Machine
    place: tuple[Array, Array]  # (P, 3), (P, 3, 3): the poses
    actuators: Array  # (P, N)
    closure: BoundClosure
    inverse: Array  # (P, N, N): (∂f/∂ρ)⁻¹
    more: Array  # (P, N, 6): what the closure leaves out of ∂f/∂pose
    turns: Array  # (P, 3, 3): from a change of a rotation vector to a rotation in the base frame
    gains: np.ndarray | None  # (N,): where the actuators' gains stand among the parameters; None without
    here_gain: Array | None  # (N,): those of the machine whose slope it has

    def read(self, theta: Array) -> Array:
        """Return ρ - (∂f/∂ρ)⁻¹ f at the measured ρ, through the gains; see `BoundReadings.read`."""
        residual = self.closure.evaluate(np.asfortranarray(theta[:, : self.n_own]))
        standing = self.actuators[..., None] - self.inverse @ residual.transpose(1, 0, 2)
        if self.gains is not None:
            start = self.machine.mechanism.initial_actuator_positions[:, None]
            standing = start + (standing - start) / theta[:, self.gains].T
        return np.asarray(standing.transpose(1, 0, 2))

    def differentiate(self, theta: Array) -> tuple[Array, Array]:
        """Return those of the closure at the measured ρ; see `BoundReadings.differentiate`."""
        own, machine = theta[: self.n_own], self.machine
        here = machine.model.prepare(machine.layout, own)(*self.place, machine.basis_at(own, self.actuators))
        by_pose = -divide_closure(here.actuators, here.pose)
        by_pose[..., 3:] = by_pose[..., 3:] @ self.turns
        by_parameters = np.zeros((*by_pose.shape[:2], len(theta)))
        by_parameters[..., : self.n_own] = -divide_closure(here.actuators, here.parameters)
        if self.gains is not None:
            gain = theta[self.gains]
            read = self.read(theta[None])[..., 0].T - machine.mechanism.initial_actuator_positions
            by_pose, by_parameters = by_pose / gain[:, None], by_parameters / gain[:, None]
            by_parameters[..., self.gains] = -np.eye(len(gain)) * (read / gain)[..., None]
        return by_pose, by_parameters

    def follow(self, step: Array) -> Array:
        """Return -(∂f/∂ρ)⁻¹ ∂f/∂pose times the steps; see `BoundReadings.follow`."""
        moved = step.copy()
        moved[3:] = (self.turns @ step[3:].transpose(1, 0, 2)).transpose(1, 0, 2)
        change = self.closure.along(moved).transpose(1, 0, 2) + self.more @ moved.transpose(1, 0, 2)
        read = -(self.inverse @ change)
        read = read if self.here_gain is None else read / self.here_gain[:, None]
        return np.asarray(read.transpose(1, 0, 2))


def divide_closure(actuators: Array, rows: Array) -> Array:
    """Return (∂f/∂ρ)⁻¹ times rows (..., N, n) for ∂f/∂ρ (..., N, N); NaN where one is not finite."""
    n = actuators.shape[-1]
    diagonal = np.diagonal(actuators, axis1=-2, axis2=-1)
    if np.count_nonzero(actuators) == np.count_nonzero(diagonal):  # actuators that move no other leg
        return np.asarray(rows / diagonal[..., None])
    good = np.isfinite(actuators).all(axis=(-1, -2), keepdims=True)
    inverse = np.where(good, np.linalg.inv(np.where(good, actuators, np.eye(n))), np.nan)
    return np.asarray(inverse @ rows)
