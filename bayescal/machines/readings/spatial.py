"""Any spatial machine on legs seen by its sensors: encoders, angles at the base joints, an instrument beside it.

The pose v is position and rotation vector of the platform frame in the base frame. What a machine reads there:

- ``rho[i]``: the position of actuator i, by inverse kinematics. With the closure f(pose, ρ; d) = 0 the derivatives are
  ∂ρ/∂v = -(∂f/∂ρ)⁻¹ ∂f/∂v and ∂ρ/∂d = -(∂f/∂ρ)⁻¹ ∂f/∂d, those of a hexapod's struts being its Jacobian's.
- ``tilt_a[i]``, ``tilt_b[i]``: how far leg i is inclined at its base joint, about two axes fixed there: angles of its
  vector g from the nominal one at home, in the planes of e0 with e1 and with e2,

      atan2(g · e1, g · e0) - tilt_a0,   atan2(g · e2, g · e0) - tilt_b0,

  e0 along the nominal leg at home, e1 horizontal, e2 = e0 × e1. Where an inclinometer has its zero is a parameter;
  its axes are taken as mounted.
- ``x y z rx ry rz``: the pose, seen by an instrument beside the machine, for the calibration only.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from bayescal.errors import InputError
from bayescal.machines.kinematics import Machine, check_home_pose, compute_home_legs, solve_inverse_kinematics
from bayescal.machines.models.legs import compute_leg_vectors, scatter
from bayescal.machines.parameters import ParameterBlock, ParameterLayout
from bayescal.machines.readings.base import NOTHING, Channel, Coordinate, Given, ReadingModel, Readings
from bayescal.numerics.geometry import (
    Array,
    compute_left_inverse_jacobian,
    matrix_from_rotation_vector,
    rotation_vector_from_matrix,
    skew_matrix,
)

TILTS = ("tilt_a", "tilt_b")
POSE = ("x", "y", "z", "rx", "ry", "rz")
TURN = 0.5 * np.pi  # rad, the largest half width of a workspace about an axis
UPRIGHT = 1.0 - 1e-9  # of a leg's direction along z, beyond which x is taken for horizontal


@dataclass(frozen=True, eq=False)
class SpatialMachine(ReadingModel):
    """A machine of legs with N encoders and 2 N inclinometers, and the pose as an instrument sees it: K = 3 N + 6.

    Attributes
    ----------
    machine : Machine
        Mechanism, model and deformation.
    tool_point : ndarray, shape (3,)
        The tool's centre, platform frame, mm; known.
    name : str
        That of the mechanism where it is left out.
    """

    machine: Machine
    tool_point: Array
    name: str = ""

    def __post_init__(self) -> None:
        """Take over the mechanism's name."""
        object.__setattr__(self, "name", self.name or self.machine.mechanism.name)

    @property
    def n_legs(self) -> int:
        """Number of legs N."""
        return self.machine.mechanism.n_legs

    @cached_property
    def home(self) -> Array:
        """The nominal home pose, shape (6,), mm and rad."""
        home = check_home_pose(self.machine)
        return np.concatenate([home.position, rotation_vector_from_matrix(home.rotation)])

    @cached_property
    def layout(self) -> ParameterLayout:
        """The machine's parameters, then the zeros of the inclinometers; nominally they read zero at home."""
        return self.machine.layout.extend(
            tuple(ParameterBlock(f"{kind}0", (0.0,) * self.n_legs, "rad") for kind in TILTS)
        )

    @cached_property
    def channels(self) -> tuple[Channel, ...]:
        """Encoders, inclinometers about e1 and e2, then the pose seen from beside the machine."""
        kinds = (("rho", "mm"), *((kind, "rad") for kind in TILTS))
        internal = [Channel(f"{kind}[{leg}]", unit) for kind, unit in kinds for leg in range(1, self.n_legs + 1)]
        seen = [Channel(name, "mm", external=True) for name in POSE[:3]]
        return (*internal, *seen, *(Channel(name, "rad", external=True, rotation="r") for name in POSE[3:]))

    @property
    def commanded(self) -> tuple[str, ...]:
        """The actuators."""
        return tuple(one.name for one in self.channels if one.kind == "rho")

    @property
    def tool_channels(self) -> tuple[Channel, ...]:
        """x, y and z of the tool's centre."""
        return tuple(Channel(name, "mm") for name in POSE[:3])

    @cached_property
    def coordinates(self) -> tuple[Coordinate, ...]:
        """Position and rotation vector of the platform's frame."""
        kinds = zip(POSE, self.pose_units, self.home, self._reach, strict=True)
        return tuple(Coordinate(name, unit, float(home), float(reach)) for name, unit, home, reach in kinds)

    @cached_property
    def _reach(self) -> Array:
        """How far the actuators' range takes the platform from home to first order, mm and rad, shape (6,)."""
        theta, home = self.layout.nominal[: self.machine.layout.size], self.home
        rotation = matrix_from_rotation_vector(home[3:])
        here = self.machine.linearise(theta, home[:3], rotation, self.machine.mechanism.initial_actuator_positions)
        by_actuators = np.abs(np.linalg.pinv(here.pose) @ here.actuators)
        reach = self.machine.mechanism.actuator_range * by_actuators.sum(axis=-1)
        return np.asarray(np.minimum(reach, [np.inf] * 3 + [TURN] * 3))

    @property
    def pose_units(self) -> tuple[str, ...]:
        """Three times mm, three times rad."""
        return ("mm",) * 3 + ("rad",) * 3

    def frame_parameters(self) -> tuple[str, ...]:
        """Return six coordinates each of joints 1, 2 and 3 of base and platform: a plane, a line in it, a point on it.

        They place a frame where their hold leaves no motion; those are chosen that the nominal points determine best.
        """
        points = {"a": self.machine.mechanism.base_points, "b": self.machine.mechanism.platform_points}
        return tuple(name for symbol, value in points.items() for name in _choose_frame(symbol, value[:3]))

    def seen_parameters(self, channels: Iterable[str]) -> tuple[str, ...]:
        """Return the parameters of the legs that carry a sensor and the zeros of inclinometers.

        An inclinometer does not see how long a strut is. Parameters that are no leg's own, or of a deformation, are
        seen by every sensor on a leg, and all of them where actuators deflect the joints of other legs.
        """
        channels = tuple(channels)
        if self._couples and any(name.partition("[")[0] not in POSE for name in channels):
            zeros = {name for kind in TILTS for name in self.layout.block(f"{kind}0").names}
            read = {name.replace("[", "0[") for name in channels if name.partition("[")[0] in TILTS}
            return tuple(name for name in self.layout.names if name not in zeros - read)
        seen: set[str] = set()
        blind = {"l"} if self.machine.mechanism.drive == "strut" else set()
        for name in channels:
            kind, _, leg = name.partition("[")
            if kind in POSE:
                continue
            own = [block for block in self.machine.layout.blocks if kind == "rho" or block.symbol not in blind]
            for block in own:
                seen |= {f"{block.symbol}[{leg}"} if self._is_own(block) else set(block.names)
            if kind in TILTS:
                seen.add(f"{kind}0[{leg}")
        return tuple(name for name in self.layout.names if name in seen)

    @property
    def _couples(self) -> bool:
        """Whether an actuator deflects the joints of other legs."""
        gain = self.machine.basis(self.machine.mechanism.initial_actuator_positions).actuator_gain
        return bool(np.any(gain * ~np.eye(self.n_legs, dtype=bool)))

    def _is_own(self, block: ParameterBlock) -> bool:
        shared = {b.symbol for b in self.machine.deformation.blocks(self.n_legs)}
        return block.per_leg and block.symbol not in shared

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

    def _stand(self, theta: Array, pose: Array) -> tuple[Array, Array, Array]:
        """Return position, rotation and the actuators that hold it, NaN where there are none."""
        position, rotation = pose[..., :3], matrix_from_rotation_vector(np.nan_to_num(pose[..., 3:]))
        own = theta[..., : self.machine.layout.size]
        found = solve_inverse_kinematics(self.machine, own, position, rotation, check=False)
        return position, rotation, np.where(found.converged[..., None], found.actuators, np.nan)

    def _projections(self, vector: Array) -> Array:
        """Return g · e0, g · e1 and g · e2 of leg vectors (..., N, 3), shape (3, ..., N)."""
        return np.einsum("...ik,eik->e...i", vector, self._axes)

    def _values(self, theta: Array, pose: Array, actuators: Array, vector: Array) -> Array:
        along, *aside = self._projections(vector)
        zeros = (self.layout.take(theta, f"{kind}0") for kind in TILTS)
        tilts = [np.arctan2(one, along) - zero for one, zero in zip(aside, zeros, strict=True)]
        seen = np.broadcast_to(pose, (*actuators.shape[:-1], len(POSE)))
        return np.concatenate([actuators, *tilts, seen], axis=-1)

    def read(self, theta: Array, pose: Array, given: Given = NOTHING) -> Array:
        """Return the readings; see `ReadingModel.read`."""
        del given
        position, rotation, actuators = self._stand(theta, pose)
        own = theta[..., : self.machine.layout.size]
        legs = compute_leg_vectors(self.machine.layout, own, position, rotation, self.machine.basis(actuators))
        return self._values(theta, pose, actuators, legs.vector)

    def linearise(self, theta: Array, pose: Array, with_parameters: bool = True, given: Given = NOTHING) -> Readings:
        """Return the readings with their derivatives; see `ReadingModel.linearise`."""
        del given
        machine, n, own = self.machine, self.n_legs, theta[..., : self.machine.layout.size]
        position, rotation, actuators = self._stand(theta, pose)
        basis = machine.basis_at(own, actuators)
        closure = machine.model.prepare(machine.layout, own)(position, rotation, basis, with_parameters)
        legs = compute_leg_vectors(machine.layout, own, position, rotation, basis)
        values = self._values(theta, pose, actuators, legs.vector)
        inverse = _invert(closure.actuators)
        # by the pose's error in the base frame, then by its coordinates
        by_pose = np.zeros((*values.shape, len(POSE)))
        by_pose[..., :n, :] = -inverse @ closure.pose
        by_parameters = np.zeros((*values.shape, self.layout.size)) if with_parameters else np.empty(0)
        if with_parameters:
            by_parameters[..., :n, : machine.layout.size] = -inverse @ closure.parameters
        for k, covector in enumerate(self._covectors(legs.vector)):
            rows = slice((k + 1) * n, (k + 2) * n)
            back = legs.pull_back(covector, with_parameters)
            by_pose[..., rows, :] = back.pose + back.actuators @ by_pose[..., :n, :]
            if with_parameters:
                by_parameters[..., rows, :] = back.actuators @ by_parameters[..., :n, :]
                by_parameters[..., rows, : machine.layout.size] += scatter(machine.layout, back.columns)
                by_parameters[..., rows, self.layout.index[f"{TILTS[k]}0"]] -= np.eye(n)
        by_pose[..., 3:] = by_pose[..., 3:] @ _turn_by_coordinates(pose)
        by_pose[..., 3 * n :, :] = np.eye(len(POSE))
        return Readings(values, by_pose, by_parameters)

    def error_gain(self, theta: Array, pose: Array, given: Given = NOTHING) -> Array | None:
        """Return how the model error of each channel shows in all of them; see `ReadingModel.error_gain`.

        A leg's model error is an error of its own closure: unlike a displacement of its actuator it deflects no other
        leg's joint. With B = ∂f/∂ρ, and L the same where actuators deflect nothing but their own joints, it shows in
        the actuators as B⁻¹ L.
        """
        del given
        if not self._couples:
            return None
        own = theta[..., : self.machine.layout.size]
        position, rotation, actuators = self._stand(theta, pose)
        basis = self.machine.basis_at(own, actuators)
        alone = basis.actuator_gain * np.eye(self.n_legs)
        closure = self.machine.model.prepare(self.machine.layout, own)
        whole, lone = (
            closure(position, rotation, one, with_parameters=False).actuators
            for one in (basis, replace(basis, actuator_gain=alone))
        )
        gain = np.zeros((*actuators.shape[:-1], len(self.channels), len(self.channels)))
        gain[...] = np.eye(len(self.channels))
        gain[..., : self.n_legs, : self.n_legs] = _invert(whole) @ lone
        return gain

    def _covectors(self, vector: Array) -> list[Array]:
        """Return the derivatives of both tilts by the leg vectors, each of shape (..., N, 3)."""
        along, *aside = self._projections(vector)
        return [
            (along[..., None] * self._axes[k] - one[..., None] * self._axes[0]) / (along**2 + one**2)[..., None]
            for k, one in enumerate(aside, start=1)
        ]

    def rotation(self, pose: Array) -> Array:
        """Return the platform's rotation; see `ReadingModel.rotation`."""
        return matrix_from_rotation_vector(pose[..., 3:])

    def tool(self, theta: Array, pose: Array) -> tuple[Array, Array, Array]:
        """Return where the tool's centre p + R t is; see `ReadingModel.tool`. No parameter moves it."""
        arm = self.rotation(pose) @ self.tool_point
        shape = np.broadcast_shapes(theta.shape[:-1], pose.shape[:-1])
        position = np.broadcast_to(pose[..., :3] + arm, (*shape, 3))
        by_pose = np.zeros((*shape, 3, len(POSE)))
        by_pose[..., :3] = np.eye(3)
        by_pose[..., 3:] = -skew_matrix(arm) @ _turn_by_coordinates(pose)
        return position, by_pose, np.zeros((*shape, 3, self.layout.size))

    # --- checks --------------------------------------------------------------------------------------------------

    def check_poses(self, pose: Array, name: Callable[[int], str] = lambda k: f"pose {k + 1}") -> None:
        """Raise InputError where an actuator of the nominal machine does not reach a pose, shape (P, 6)."""
        mechanism = self.machine.mechanism
        _, _, actuators = self._stand(self.layout.nominal, pose)
        travel = np.abs(actuators - mechanism.initial_actuator_positions)
        short = ~(travel <= mechanism.actuator_range)
        if short.any():
            k, leg = np.argwhere(short)[0]
            found = "no position" if np.isnan(travel[k, leg]) else f"{travel[k, leg]:.4g} mm"
            raise InputError(
                f"machine {self.name!r}: {name(int(k))}: actuator {leg + 1} cannot reach it, found {found} from its "
                f"initial position, expected at most {mechanism.actuator_range:g} mm"
            )


def _invert(matrix: Array) -> Array:
    """Return inverses, NaN where a matrix is not finite."""
    good = np.isfinite(matrix).all(axis=(-1, -2), keepdims=True)
    return np.where(good, np.linalg.inv(np.where(good, matrix, np.eye(matrix.shape[-1]))), np.nan)


def _turn_by_coordinates(pose: Array) -> Array:
    """Return the rotation in the base frame per change of the rotation vector, shape (..., 3, 3)."""
    return np.asarray(np.linalg.inv(compute_left_inverse_jacobian(np.nan_to_num(pose[..., 3:]))))


def _choose_frame(symbol: str, points: Array) -> tuple[str, ...]:
    """Return the six coordinates of three points (3, 3) that move most independently with their frame."""
    arms = points - points.mean(axis=0)
    size = float(np.linalg.norm(arms, axis=1).max())
    motion = np.concatenate([np.tile(np.eye(3), (3, 1)), -skew_matrix(arms / size).reshape(9, 3)], axis=1)
    chosen: list[int] = []
    for _ in range(motion.shape[1]):
        # pivoted elimination: the coordinate that moves most in what the chosen ones leave free
        length = np.linalg.norm(motion, axis=1)
        length[chosen] = 0.0
        best = int(np.argmax(np.round(length, 9)))
        along = motion[best] / np.linalg.norm(motion[best])
        motion = motion - np.outer(motion @ along, along)
        chosen.append(best)
    return tuple(f"{symbol}_{'xyz'[k % 3]}[{k // 3 + 1}]" for k in sorted(chosen))
