"""The density of what an instrument read, its frame and its tool's among the parameters.

Station s sees the platform's predicted pose T(θ, ρ) as T_base,s T T_tool, and its rows z (`bayescal.data.instruments`)
differ from what it should have read by

    z_n ~ N(0, R_n + W_n D_n W_nᵀ),   W_n = (∂z/∂T) G,

R_n the noise of the rows, D_n = diag(σ_ρ² + τ_i² + v_ni) in terms of the legs and G the pose per leg, as in
`bayescal.density.pose_likelihood`. W_n is taken once, at the nominal machine and frames, so that the covariance does
not depend on the parameters. Rows are only what was measured: axes or points that are missing are not there at all.

The predicted pose is exact. From the nominal machine's pose the bound closure leads to the pose of a machine within the
tolerances but for second orders, a micrometre or so; one Newton step of the whole closure there leaves 10 pm and
0.2 nrad. Redundant legs add their N - 6 conditions, the closure along what no pose moves.
"""

from __future__ import annotations

import numpy as np

from bayescal.data.instruments.readings import Instrument
from bayescal.data.measured_poses import MeasuredPoses
from bayescal.density.elimination import whiten_covariance
from bayescal.density.legs import Likelihood
from bayescal.density.pose_likelihood import PoseLikelihood
from bayescal.errors import InputError
from bayescal.machines.frames import frame_blocks, measured_pose_slopes, move_frames
from bayescal.machines.kinematics import Machine, solve_forward_kinematics
from bayescal.machines.models.base import Linearisation, newton_step
from bayescal.numerics.geometry import DEGREES_OF_FREEDOM, Array, matrix_from_rotation_vector


class InstrumentLikelihood(Likelihood):
    """Log-density of an instrument's readings for batches of machines with frames, and of model errors.

    Parameters
    ----------
    machine : Machine
        Mechanism, model and deformation.
    instrument : Instrument
        The data.
    actuator_noise : float
        σ_ρ, mm.
    actuator_variance : ndarray, shape (P, N), optional
        v_ni, known extra variance of each leg, mm².

    Raises
    ------
    InputError
        Where the nominal machine cannot take a pose that was measured.
    """

    def __init__(
        self, machine: Machine, instrument: Instrument, actuator_noise: float, actuator_variance: Array | None = None
    ) -> None:
        self.machine, self.instrument = machine, instrument
        self.layout = machine.layout.extend(frame_blocks(instrument.n_stations))
        self._legs = self._bind_legs(actuator_noise, actuator_variance)
        self.actuator_weight = self._legs.actuator_weight
        reference, nominal = self._legs.poses, machine.layout.nominal
        here = machine.linearise(nominal, reference.position, reference.rotation, reference.actuators)
        self._no_pose = _find_null(here.pose)
        zero = np.zeros(self.layout.size - machine.layout.size)
        by_platform, _ = self._slopes_of_rows(zero, reference.position, reference.rotation)
        self._seen_by_rows = by_platform @ np.linalg.pinv(here.pose)
        own = instrument.rows
        n_own, n_extra = own.covariance.shape[-1], self._no_pose.shape[-1]
        self._rows_from_legs = np.concatenate([self._seen_by_rows, np.swapaxes(self._no_pose, -1, -2)], axis=-2)
        self._noise = np.zeros((instrument.n_poses, n_own + n_extra, n_own + n_extra))
        self._noise[:, :n_own, :n_own] = own.covariance
        self._constant = own.log_constant - 0.5 * n_extra * np.log(2.0 * np.pi)

    def _bind_legs(self, actuator_noise: float, actuator_variance: Array | None) -> PoseLikelihood:
        """Return the likelihood of the nominal machine's own poses, which predicts those of others from there."""
        instrument, machine = self.instrument, self.machine
        found = solve_forward_kinematics(machine, machine.layout.nominal, instrument.actuators, check=False)
        if not found.converged.all():
            name = instrument.names[int(np.argmin(found.converged))]
            raise InputError(
                f"pose {name!r}: found actuator positions that the nominal machine cannot take, expected ones that it "
                "can: look at its row, at the order of the legs and at what positions are counted from"
            )
        exact = np.zeros((instrument.n_poses, DEGREES_OF_FREEDOM, DEGREES_OF_FREEDOM))
        poses = MeasuredPoses(instrument.names, found.position, found.rotation, exact, instrument.actuators)
        return PoseLikelihood(machine, poses, actuator_noise, actuator_variance)

    @property
    def n_poses(self) -> int:
        """Number of poses P."""
        return self.instrument.n_poses

    @property
    def pose_names(self) -> tuple[str, ...]:
        """Names of the poses."""
        return self.instrument.names

    @property
    def actuators(self) -> Array:
        """Actuator positions, shape (P, N), mm."""
        return self.instrument.actuators

    @property
    def rows_of_legs(self) -> Array:
        """W, what the legs' errors do to the rows, shape (P, K, N)."""
        return self._rows_from_legs

    @property
    def gain(self) -> Array:
        """The pose error as seen per error of the rows, shape (P, 6, K); zero where it is not measured."""
        found = np.zeros((self.n_poses, DEGREES_OF_FREEDOM, self._noise.shape[-1]))
        to_pose = self.instrument.rows.to_pose
        found[..., : to_pose.shape[-1]] = to_pose
        return found

    @property
    def log_constant(self) -> Array:
        """What the density of each pose has beside that of its rows, shape (P,)."""
        return np.asarray(self._constant)

    @property
    def n_rows(self) -> np.ndarray:
        """How many rows each pose has, shape (P,): what was read, and the conditions of redundant legs."""
        return np.asarray(self.instrument.rows.count + self._no_pose.shape[-1])

    # --- residuals -----------------------------------------------------------------------------------------------

    def errors(self, theta: Array) -> Array:
        """Return the rows, read minus predicted, then the legs' conditions, for vectors (B, D), shape (B, P, K)."""
        parts = [self._errors(theta[part]) for part in self._batches(len(theta))]
        return np.concatenate(parts) if parts else np.empty((0, self.n_poses, self._noise.shape[-1]))

    def _errors(self, theta: Array) -> Array:
        size = self.machine.layout.size
        position, rotation, left, good = self._predict(theta[:, :size])
        rows = self._read(theta[:, size:], position, rotation)
        rows = np.concatenate([rows, left], axis=-1)
        rows[~good] = np.nan
        return rows

    def _read(self, frames: Array, position: Array, rotation: Array) -> Array:
        """Return the instrument's rows for frames (B, 6 S + 6) and poses of the platform (B, P, ...)."""
        seen = move_frames(_pair_frames(frames), position[:, None], rotation[:, None])
        return self.instrument.residuals(*seen)

    def _predict(self, theta: Array) -> tuple[Array, Array, Array, np.ndarray]:
        """Return the predicted poses, the legs' conditions (B, P, N - 6) there and which poses there are (B, P)."""
        reference = self._legs.poses
        with np.errstate(all="ignore"):
            error = self._legs.pose_errors(theta)
            good = np.isfinite(error).all(axis=-1) & (np.abs(error).max(axis=-1) < _FAR)
            error = np.where(good[..., None], error, 0.0)
            position = reference.position - error[..., :3]
            rotation = matrix_from_rotation_vector(-error[..., 3:]) @ reference.rotation
            here = self._close(theta, position, rotation)
            step = newton_step(here)
            good &= np.isfinite(step).all(axis=-1)
            step = np.where(good[..., None], step, 0.0)
        left = here.residual + np.einsum("bpij,bpj->bpi", here.pose, step)
        left = np.einsum("pim,bpi->bpm", self._no_pose, left)
        return position + step[..., :3], matrix_from_rotation_vector(step[..., 3:]) @ rotation, left, good

    def _close(self, theta: Array, position: Array, rotation: Array) -> Linearisation:
        """Return the closure of machines (B, D) at poses (B, P, ...)."""
        actuators = np.broadcast_to(self.instrument.actuators, (*position.shape[:2], self.n_legs))
        closure = self.machine.model.prepare(self.machine.layout, theta[:, None])
        return closure(position, rotation, self.machine.basis(actuators), with_parameters=False)

    def error_jacobian(self, theta: Array) -> tuple[Array, Array]:
        """Return the rows (P, K) and their derivative (P, K, D) for one parameter vector (D,)."""
        size = self.machine.layout.size
        position, rotation, left, _ = self._predict(theta[None, :size])
        rows = np.concatenate([self._read(theta[None, size:], position, rotation), left], axis=-1)[0]
        here = self.machine.linearise(theta[:size], position[0], rotation[0], self.instrument.actuators)
        by_machine = -np.linalg.pinv(here.pose) @ here.parameters
        by_platform, by_frames = self._slopes_of_rows(theta[size:], position[0], rotation[0])
        conditions = np.swapaxes(self._no_pose, -1, -2) @ (here.parameters + here.pose @ by_machine)
        slope = np.zeros((*rows.shape, self.layout.size))
        slope[:, : by_platform.shape[1], :size] = by_platform @ by_machine
        slope[:, : by_platform.shape[1], size:] = by_frames
        slope[:, by_platform.shape[1] :, :size] = conditions
        return rows, slope

    def _slopes_of_rows(self, frames: Array, position: Array, rotation: Array) -> tuple[Array, Array]:
        """Return the rows' derivatives by the platform's pose (P, K, 6) and by the frames (P, K, 6 S + 6)."""
        pairs = _pair_frames(frames)
        shape = (len(pairs), *position.shape)
        position, rotation = np.broadcast_to(position, shape), np.broadcast_to(rotation, (*shape, 3))
        by_seen = self.instrument.slopes(*move_frames(pairs, position, rotation))
        by_pose, by_frames = measured_pose_slopes(pairs, position, rotation)
        bases = [one @ change[..., :6] for one, change in zip(by_seen, by_frames, strict=True)]
        tool = (by_seen @ by_frames[..., 6:]).sum(axis=0)
        return (by_seen @ by_pose).sum(axis=0), np.concatenate([*bases, tool], axis=-1)

    def pose_errors(self, theta: Array) -> Array:
        """Return measured minus predicted poses as the instrument sees them, shape (B, P, 6), mm and rad.

        NaN where a coordinate is not measured; where points do not tell the pose, the position is their mean residual.
        """
        rows = self.instrument.rows
        own = self.errors(theta)[..., : rows.covariance.shape[-1]]
        return np.where(rows.measured, np.einsum("pik,bpk->bpi", rows.to_pose, own), np.nan)

    # --- covariance ----------------------------------------------------------------------------------------------

    def error_covariance(self, model_error: Array) -> Array:
        """Return the covariance of the rows, shape (..., P, K, K), for model errors τ (..., N) in mm."""
        known = self._legs.legs_known
        added = self.actuator_weight * model_error[..., None, :] ** 2
        change = self._rows_from_legs
        legs = (change * added[..., None, :]) @ np.swapaxes(change, -1, -2)
        total = self._noise + change @ known @ np.swapaxes(change, -1, -2) + legs
        return 0.5 * (total + np.swapaxes(total, -1, -2))

    def on_legs(self, rows: Array) -> Array:
        """Return Wᵀ times something of the rows (P, K, ...); see `Likelihood.on_legs`."""
        return np.einsum("pki,pk...->pi...", self._rows_from_legs, rows)

    def pose_covariance(self, model_error: Array) -> Array:
        """Return the covariance of `pose_errors`, (..., P, 6, 6), for τ (..., N); unit where not measured."""
        rows = self.instrument.rows
        n_own = rows.covariance.shape[-1]
        covariance = self.error_covariance(model_error)[..., :n_own, :n_own]
        seen = rows.to_pose @ covariance @ np.swapaxes(rows.to_pose, -1, -2)
        return seen + np.eye(DEGREES_OF_FREEDOM) * ~rows.measured[:, None, :]

    # --- density -------------------------------------------------------------------------------------------------

    @np.errstate(all="ignore")  # far out numbers overflow: no density in the end
    def _evaluate(self, theta: Array, model_error: Array) -> tuple[Array, Array]:
        errors = self._errors(theta)
        whitening, log_det = whiten_covariance(self.error_covariance(model_error))
        good = np.isfinite(errors).all(axis=-1)
        white = (whitening @ np.where(good[..., None], errors, 0.0)[..., None])[..., 0]
        square = np.einsum("bpk,bpk->bp", white, white)
        density = self._constant + log_det - 0.5 * square
        return np.where(good & np.isfinite(density), density, -np.inf), np.where(good, square, np.inf)


_FAR = 1e4
"""Pose errors beyond it, mm or rad, are no machine's."""


def _pair_frames(frames: Array) -> Array:
    """Return each station's frame with that of the tool, shape (..., 6 S + 6) to (..., S, 12)."""
    blocks = frames.reshape(*frames.shape[:-1], -1, DEGREES_OF_FREEDOM)
    tool = np.broadcast_to(blocks[..., -1:, :], blocks[..., :-1, :].shape)
    return np.concatenate([blocks[..., :-1, :], tool], axis=-1)


def _find_null(pose: Array) -> Array:
    """Return the directions of closures that no pose moves, shape (P, N, N - 6), orthonormal, of (P, N, 6)."""
    return np.linalg.svd(pose)[0][..., DEGREES_OF_FREEDOM:]
