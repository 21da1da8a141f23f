"""The density of the measured poses, given a machine: every model and deformation is a density of the same data.

The measured pose differs from the pose the machine predicts for its actuator positions by e_n ~ N(0, C_n) with

    C_n = Σ_n + J_n diag(σ_ρ² + τ_i² + v_ni) J_nᵀ,

Σ_n the covariance of the measured pose, J_n the pose per actuator position, σ_ρ the actuator noise, τ_i the model
error of leg i and v_ni what is known to be uncertain in the deformation. J_n is taken once, at the nominal machine, so
that C_n does not depend on the geometry and the density is normalised as it stands.

e_n is the forward-kinematic error, found without forward kinematics: the closure residual f at the measured pose
vanishes at the predicted one, A(θ) e = f, and A changes so little that with G the inverse of the nominal A the
iteration e ← G (f - (A(θ) - A⁰) e) gains two digits a step. Carried along is r = A⁰ e, the same error seen by the
legs, in which the model error is diagonal; with more than six legs r has N entries and holds the closure of the
redundant legs too.
"""

from __future__ import annotations

from copy import copy
from functools import cached_property
from typing import Self

import numpy as np

from bayescal.data.measured_poses import MeasuredPoses
from bayescal.density.legs import POSES, Likelihood, batches
from bayescal.density.low_rank import FEWEST_LEGS, factor_by_columns, find_low_rank
from bayescal.errors import InputError
from bayescal.machines.kinematics import Machine, solve_forward_kinematics
from bayescal.machines.models.home import BatchHome
from bayescal.numerics.geometry import DEGREES_OF_FREEDOM, Array, matrix_from_rotation_vector
from bayescal.numerics.scratch import Scratch

REFINEMENTS = 2
ROUNDING = 1e-10
FEWEST = 8  # poses at a time, however many legs
OF_POSES = ("_gain", "_known", "_constant", "_to_error", "_pose_jacobian", "actuator_weight")
"""What a density of poses has of each pose."""


class PoseLikelihood(Likelihood):
    """Log-density of measured poses for batches of machines and of model errors; its rows are the legs' errors.

    Parameters
    ----------
    machine : Machine
        Mechanism, model and deformation.
    poses : MeasuredPoses
        The data.
    actuator_noise : float
        σ_ρ, mm.
    actuator_variance : ndarray, shape (P, N), optional
        v_ni, known extra variance of each leg, mm².
    """

    def __init__(
        self, machine: Machine, poses: MeasuredPoses, actuator_noise: float, actuator_variance: Array | None = None
    ) -> None:
        self.machine, self.poses = machine, poses
        self.layout = layout = machine.layout
        self._basis = machine.basis(poses.actuators)
        self._bound = machine.model.bind(layout, poses.position, poses.rotation, self._basis)
        self._closing = self._find_closing_poses()
        nominal = machine.model.prepare(layout, layout.nominal)(*self._closing, self._basis, with_parameters=False)
        pose, actuators = nominal.pose, nominal.actuators
        self._pose_jacobian = pose
        try:
            self._gain = np.linalg.pinv(pose)
        except np.linalg.LinAlgError as error:
            raise InputError("likelihood: singular pose Jacobian at a measured pose") from error
        noise = actuators @ np.swapaxes(actuators, -1, -2) * actuator_noise**2
        measured = pose @ poses.covariance @ np.swapaxes(pose, -1, -2)
        self.actuator_weight = np.diagonal(actuators, axis1=-2, axis2=-1) ** 2
        known = measured + noise
        if actuator_variance is not None:
            known = known + np.eye(pose.shape[-2]) * (self.actuator_weight * actuator_variance)[:, None, :]
        self._known = 0.5 * (known + np.swapaxes(known, -1, -2))
        _, log_volume = np.linalg.slogdet(np.swapaxes(pose, -1, -2) @ pose)
        self._constant = 0.5 * log_volume - 0.5 * pose.shape[-2] * np.log(2 * np.pi)
        self._to_error, self._seen = self._find_projection()
        self._low_rank = find_low_rank(pose, poses.covariance, self._known)
        self._scratch = Scratch()
        self._refinements = REFINEMENTS
        self._solves = False
        self._whitening: tuple[Array, Array, Array] | None = None
        self._last: tuple[Array, Array, BatchHome | None] | None = None

    @property
    def n_poses(self) -> int:
        """Number of poses P."""
        return self.poses.n_poses

    @property
    def pose_names(self) -> tuple[str, ...]:
        """Names of the poses."""
        return self.poses.names

    @property
    def actuators(self) -> Array:
        """Actuator positions, shape (P, N), mm."""
        return self.poses.actuators

    @property
    def rows_of_legs(self) -> Array:
        """W, what the legs' errors do to the rows, shape (P, N, N): they are the rows."""
        return np.broadcast_to(np.eye(self.n_legs), (self.n_poses, self.n_legs, self.n_legs))

    def _batches(self, size: int) -> list[slice]:
        return batches(size)  # it takes some poses at a time

    def refined(self) -> Self:
        """Return the same density with two more digits of the pose errors, for machines far from nominal."""
        other = self._copy()
        other._scratch, other._refinements = Scratch(), self._refinements + 1
        return other

    def _copy(self) -> Self:
        """Return the same density, without what it has kept of its own results."""
        other = copy(self)
        other.__dict__.pop("_parts", None)
        other._last = None
        return other

    @property
    def of_poses(self) -> PoseLikelihood:
        """Itself."""
        return self

    @property
    def closing_poses(self) -> MeasuredPoses | None:
        """The poses, where a deformation leaves the joints hardly known."""
        return self.poses if self.machine.deformation.hides_joints else None

    def parts(self) -> list[tuple[slice, Likelihood]]:
        """Return at most `POSES` poses at a time, each with their density; they share the memory that they work in."""
        return list(self._parts)

    @cached_property
    def _parts(self) -> list[tuple[slice, Self]]:
        size = max(FEWEST, POSES * DEGREES_OF_FREEDOM // self.n_legs)
        if self.n_poses <= size:
            return [(slice(None), self)]
        scratch, of_closure = Scratch(), Scratch()
        slices = [slice(k, k + size) for k in range(0, self.n_poses, size)]
        return [(part, self._take(part, scratch, of_closure)) for part in slices]

    def _take(self, part: slice, scratch: Scratch, of_closure: Scratch) -> Self:
        """Return the density of some of the poses."""
        other, poses, machine = self._copy(), self.poses.select(np.arange(self.n_poses)[part]), self.machine
        other.poses, other._basis = poses, machine.basis(poses.actuators)
        other._bound = machine.model.bind(self.layout, poses.position, poses.rotation, other._basis)
        other._bound.share(of_closure)
        other._scratch, other._whitening = scratch, None
        other._low_rank = None if self._low_rank is None else self._low_rank.select(part)
        other._seen = None if self._seen is None else self._seen[part]
        for name in OF_POSES:
            setattr(other, name, getattr(self, name)[part])
        return other

    @property
    def is_solved(self) -> bool:
        """Whether the pose errors are solved for, not refined step by step."""
        return self._solves

    def finer(self) -> Self | None:
        """Return the same density with A(θ) e = f solved: slower, and right however much A(θ) differs from A⁰.

        Steps of refinement gain little, or lead away, where the stiffness of legs is hardly known, for instance.
        """
        if self._solves:
            return None
        other = self._copy()
        other._scratch, other._solves = Scratch(), True
        return other

    # --- residuals -----------------------------------------------------------------------------------------------

    def _find_leg_errors(self, theta: Array) -> Array:
        closure = self._bound.evaluate(np.asfortranarray(theta))  # the batch contiguous
        n_legs, n_poses, n_batch = closure.shape
        result = self._scratch.take("leg errors", n_legs, n_poses, n_batch)
        if self._solves:
            result[:] = self._solve(closure)
            return result
        both = self._scratch.take("error", self._to_error.shape[1], n_poses, n_batch)
        seen = closure
        for _ in range(self._refinements):
            np.matmul(self._to_error, seen.transpose(1, 0, 2), out=both.transpose(1, 0, 2))
            error, seen = both[:6], both[6:] if len(both) > 6 else seen
            if self._seen is not None:
                seen = np.matmul(self._seen, error.transpose(1, 0, 2)).transpose(1, 0, 2)
            seen = np.subtract(seen, self._bound.along(error), out=result)  # (A⁰ - A(θ)) e
            seen += closure
        return seen

    def _find_at(self, theta: Array) -> tuple[Array, BatchHome | None]:
        """Return r, shape (N, P, 1), and the home pose found on the way, at one vector (D,); kept for the next call.

        A climb asks for the density where it then asks for its slope.
        """
        if self._last is None or not np.array_equal(self._last[0], theta):
            self._last = theta.copy(), self._find_leg_errors(theta[None]).copy(), self._bound.home
        return self._last[1:]

    def _solve(self, closure: Array) -> Array:
        """Return r (N, P, B) of closures f (N, P, B): the fixed point of the refinements, (1 + (A(θ) - A⁰) G) r = f."""
        n_legs, n_poses, n_batch = closure.shape
        unit = np.zeros((DEGREES_OF_FREEDOM, *closure.shape[1:]))
        seen = np.empty((n_poses, n_batch, n_legs, DEGREES_OF_FREEDOM))
        right = closure.transpose(1, 2, 0)[..., None].copy()
        for k in range(DEGREES_OF_FREEDOM):
            unit[:] = 0.0
            unit[k] = 1.0
            seen[..., k] = self._bound.along(unit).transpose(1, 2, 0)
        left = seen @ self._gain[:, None]
        nominal = self._to_error[:, DEGREES_OF_FREEDOM:]  # A⁰ G; left out where it is 1
        nominal = nominal if self._seen is None else self._seen @ self._gain
        left += (np.eye(n_legs) - nominal)[:, None] if nominal.size else 0.0
        left[~np.isfinite(left).all(axis=(-1, -2))] = np.nan
        try:
            return np.linalg.solve(left, right)[..., 0].transpose(2, 0, 1)
        except np.linalg.LinAlgError:  # of so many machines one has no pose derivative at all
            return np.full(closure.shape, np.nan)

    def _find_closing_poses(self) -> tuple[Array, Array]:
        """Return the poses (P, 3), (P, 3, 3) that the nominal machine predicts; the measured ones where there is none.

        Elsewhere it would not close, and have derivatives that machines close to the measured poses have not.
        """
        poses = self.poses
        found = solve_forward_kinematics(self.machine, self.machine.layout.nominal, poses.actuators, check=False)
        position = np.where(found.converged[:, None], found.position, poses.position)
        return position, np.where(found.converged[:, None, None], found.rotation, poses.rotation)

    def _find_projection(self) -> tuple[Array, Array | None]:
        """Return G and, below, the A⁰ G that the bound closure sees, shape (P, 6 + N, N); G alone if that is one.

        With many legs the A⁰ that it sees, shape (P, N, 6), comes by itself: A⁰ G has only six columns' worth.

        What the bound closure leaves out of A(θ) is added as it is for the nominal machine.
        """
        machine, poses, nominal = self.machine, self.poses, self.machine.layout.nominal
        _, n_legs, _ = self._pose_jacobian.shape
        bound = machine.model.bind(machine.layout, *self._closing, self._basis)
        bound.evaluate(np.broadcast_to(nominal, (6, len(nominal))))
        unit = np.ascontiguousarray(np.broadcast_to(np.eye(6)[:, None], (6, poses.n_poses, 6)))
        by_pose = bound.along(unit).transpose(1, 0, 2)
        if n_legs >= FEWEST_LEGS:
            return self._gain, by_pose.copy()
        seen = by_pose @ self._gain
        if np.abs(seen - np.eye(n_legs)).max() < ROUNDING:
            return self._gain, None
        return np.concatenate([self._gain, seen], axis=1), None

    def on_legs(self, rows: Array) -> Array:
        """Return the rows as they are: they are the legs'."""
        return rows

    def errors(self, theta: Array) -> Array:
        """Return r = A⁰ e, the pose errors seen by the legs in mm, for (B, D) parameter vectors, shape (B, P, N)."""
        result = np.empty((len(theta), self.poses.n_poses, self.n_legs))
        if len(theta) == 1:
            for poses, some in self._parts:
                result[0, poses] = some._find_at(theta[0])[0][..., 0].T
            return result
        for part in batches(len(theta)):
            for poses, some in self._parts:
                result[part, poses] = some._find_leg_errors(theta[part]).transpose(2, 1, 0)
        return result

    def pose_errors(self, theta: Array) -> Array:
        """Return e, measured minus predicted pose (mm, rad; base frame), for (B, D) vectors, shape (B, P, 6)."""
        return np.einsum("pij,bpj->bpi", self._gain, self.errors(theta))

    def error_jacobian(self, theta: Array) -> tuple[Array, Array]:
        """Return r, shape (P, N), and its exact derivative, shape (P, N, D), for one parameter vector (D,).

        The derivative is that of the implicit function: the closure is differentiated at the predicted pose.
        """
        found = [part._find_at(theta) for _, part in self._parts]
        seen, home = np.concatenate([errors[..., 0] for errors, _ in found], axis=1).T.copy(), found[0][1]
        error = (self._gain @ seen[..., None])[..., 0]
        position = self.poses.position - error[:, :3]
        rotation = matrix_from_rotation_vector(-error[:, 3:]) @ self.poses.rotation
        layout = self.machine.layout
        here = self.machine.model.prepare_known(layout, theta, home)(position, rotation, self._basis)
        pose_change = np.linalg.solve(self._gain @ here.pose, self._gain)  # per closure
        moved = np.eye(self.n_legs) + (self._pose_jacobian - here.pose) @ pose_change
        return seen, moved @ here.parameters

    # --- covariance ----------------------------------------------------------------------------------------------

    @property
    def gain(self) -> Array:
        """The pose per error of the legs, shape (P, 6, N)."""
        return self._gain

    @property
    def log_constant(self) -> Array:
        """What the density of each pose has beside that of r, shape (P,): log-volume of A⁰ and powers of 2 π."""
        return self._constant

    @property
    def legs_known(self) -> Array:
        """Covariance of r but for the model error, shape (P, N, N), mm²."""
        return self._known

    def error_covariance(self, model_error: Array) -> Array:
        """Return the covariance of r in mm², shape (P, N, N), for model errors τ in mm, shape (N,)."""
        return self._known + np.eye(self.n_legs) * (self.actuator_weight * model_error**2)[:, None, :]

    def pose_covariance(self, model_error: Array) -> Array:
        """Return C_n, the covariance of e (mm, rad), shape (..., P, 6, 6), for model errors (..., N) in mm."""
        added = self.actuator_weight * model_error[..., None, :] ** 2
        covariance = self._known + np.eye(self.n_legs) * added[..., None, :]
        return self._gain @ covariance @ np.swapaxes(self._gain, -1, -2)

    # --- density -------------------------------------------------------------------------------------------------

    def _evaluate(self, theta: Array, model_error: Array) -> tuple[Array, Array]:
        if len(self._parts) == 1:
            return self._evaluate_at_once(theta, model_error)
        density, square = np.empty((2, len(theta), self.n_poses))
        for poses, part in self._parts:
            density[:, poses], square[:, poses] = part._evaluate_at_once(theta, model_error)
        return density, square

    @np.errstate(all="ignore")  # far out numbers overflow: no density in the end
    def _evaluate_at_once(self, theta: Array, model_error: Array) -> tuple[Array, Array]:
        errors = self._find_leg_errors(theta) if len(theta) != 1 else self._find_at(theta[0])[0]
        if model_error.ndim == 1:
            density, square = self._density_fixed(errors, model_error)
        else:
            density, square = self._density_varying(errors, model_error)
        density += self._constant[:, None]
        density[~np.isfinite(density)] = -np.inf
        return density.T, square.T

    def _whiten(self, model_error: Array) -> tuple[Array, Array]:
        """Return the inverse Cholesky factors (P, N, N) and half log-determinants (P,) at τ; kept for the next call."""
        if self._whitening is None or not np.array_equal(self._whitening[0], model_error):
            factor = np.linalg.cholesky(self.error_covariance(model_error))
            half_log_det = np.log(np.diagonal(factor, axis1=-2, axis2=-1)).sum(axis=-1)
            self._whitening = (model_error.copy(), np.linalg.inv(factor), half_log_det)
        return self._whitening[1:]

    def _density_fixed(self, errors: Array, model_error: Array) -> tuple[Array, Array]:
        whitening, half_log_det = self._whiten(model_error)
        n_legs, n_poses, n_batch = errors.shape
        white = self._scratch.take("white", n_poses, n_legs, n_batch)
        np.matmul(whitening, errors.transpose(1, 0, 2), out=white)
        square = np.einsum("pib,pib->pb", white, white)
        return -0.5 * square - half_log_det[:, None], square

    def _density_varying(self, errors: Array, model_error: Array) -> tuple[Array, Array]:
        variance = model_error.T**2

        def add(leg: int) -> Array:
            return np.asarray(self.actuator_weight[:, leg, None] * variance[leg])

        if self._low_rank is not None:
            return self._low_rank.evaluate(add, errors, self._scratch)
        return factor_by_columns(self._known, add, errors, self._scratch)
