"""Most probable machines of many sets of measured poses at once: batched Gauss-Newton steps, shortened where they fail.

Each of B machines has its own measured poses; what is minimised for each is the deviance

    Σ_p |R_p e_p|² + Σ_k ((θ_k - centre_k) / sd_k)²,    R_pᵀR_p = M (1 + C M)⁻¹,

with e the measured minus the predicted pose, M what the sensors tell of it and C what actuators and model make it err
by; as in the package's likelihood C is taken once, at the expected machine. Where legs are redundant the predicted pose
is the one that the closures, weighted by D⁻¹, agree on best, and what is left of them is added, fᵀD⁻¹f.
"""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np

from bayescal.identifiability.design import Knowledge, Plan
from bayescal.identifiability.sensitivity import compute_sensitivity
from bayescal.machines.frames import N_FRAME_PARAMETERS, measured_pose_slopes, move_frames
from bayescal.machines.models.base import Linearisation, newton_step
from bayescal.numerics.geometry import (
    DEGREES_OF_FREEDOM,
    Array,
    compute_left_inverse_jacobian,
    compute_pose_error,
    matrix_from_rotation_vector,
)

POSE_STEPS = 20
POSE_TOLERANCE = 1e-7  # of the last Newton step, mm and rad: what is left is its square
MAX_ITERATIONS = 100
TOLERANCE = 1e-6  # squared length of the last step in posterior standard deviations: what is left is less
SHORTER, LONGER = 0.4, 2.0  # next step, after one that failed and after one that did not
SHORTEST = 1e-8
LONG = 6  # iterations, after which second derivatives are looked for too
CHUNK = 1 << 20  # numbers in one array of derivatives, 8 MB; a few such arrays are held


@dataclass(frozen=True, eq=False)
class Measurements:
    """Measured poses of B machines.

    Attributes
    ----------
    position, rotation : ndarray, shapes (B, P, 3) and (B, P, 3, 3)
        In the instrument's frame, mm.
    actuators : ndarray, shape (B, P, N)
        Actuator positions as read, mm.
    """

    position: Array
    rotation: Array
    actuators: Array

    def take(self, places: np.ndarray) -> Measurements:
        """Return those of some machines."""
        return Measurements(self.position[places], self.rotation[places], self.actuators[places])


@dataclass(frozen=True, eq=False)
class Fits:
    """Most probable machines.

    Attributes
    ----------
    moves : ndarray, shape (B, n)
        Free parameters off the expected machine, in units of the tolerances.
    data_deviance, deviance : ndarray, shape (B,)
        Of the data alone, and with the priors of the parameters that were not held.
    information : ndarray, shape (B, n, n)
        Of the data there, in units of the tolerances.
    converged : ndarray of bool, shape (B,)
    n_iterations : ndarray of int, shape (B,)
    """

    moves: Array
    data_deviance: Array
    deviance: Array
    information: Array
    converged: np.ndarray
    n_iterations: np.ndarray


@dataclass(eq=False)
class _State:
    """Where B fits are.

    Attributes
    ----------
    moves : ndarray, shape (B, n)
    position, rotation : ndarray, shapes (B, P, 3) and (B, P, 3, 3)
        Predicted poses of the platform in the base frame.
    residual : ndarray, shape (B, m)
        r, in units of the noise.
    deviance : ndarray, shape (B,)
        rᵀr; infinite where there is no such machine.
    gradient, information : ndarray, shapes (B, n) and (B, n, n)
        Jᵀr and JᵀJ with the derivatives J of r.
    crossed : ndarray, shape (B, n)
        Jᵀ times the residuals before the last step.
    """

    moves: Array
    position: Array
    rotation: Array
    residual: Array
    deviance: Array
    gradient: Array
    information: Array
    crossed: Array

    def total(self, weight: Array) -> Array:
        """Return the deviance with that of the priors, shape (B,)."""
        result: Array = self.deviance + (weight * self.moves**2).sum(axis=1)
        return result

    def take(self, places: np.ndarray) -> _State:
        """Return the states of some machines."""
        return _State(*(getattr(self, item.name)[places] for item in fields(self)))

    def update(self, places: np.ndarray, other: _State, chosen: np.ndarray) -> None:
        """Take over the chosen ones of some machines' states."""
        for item in fields(self):
            getattr(self, item.name)[places[chosen]] = getattr(other, item.name)[chosen]


@dataclass(eq=False)
class _Curvature:
    """Second derivatives of the poses, which Gauss and Newton leave out, along the last step of those that overshot.

    They count where a parameter's first derivative vanishes, as that of u_x does where the actuator leans as its leg:
    steps then overshoot again and again. How the gradient changes along a step with the residuals as they were tells of
    these derivatives alone.

    Attributes
    ----------
    matrix : ndarray, shape (B, n, n)
        Added to the information; zero for those that never overshot.
    known : ndarray of bool, shape (B,)
        Which overshot, or take long.
    """

    matrix: Array
    known: np.ndarray

    def learn(self, places: np.ndarray, step: Array, before: _State, trial: _State) -> None:
        """Learn from steps of some machines: the update of Broyden, Fletcher, Goldfarb and Shanno."""
        change = trial.crossed - before.gradient
        useful = self.known[places] & np.isfinite(trial.deviance)
        places, step, change = places[useful], step[useful], change[useful]
        old = (self.matrix[places] @ step[..., None])[..., 0]
        was, along = np.einsum("bi,bi->b", step, old), np.einsum("bi,bi->b", step, change)
        old *= np.where(was > 0.0, was, np.inf)[:, None] ** -0.5
        change *= np.where(along > 0.0, along, np.inf)[:, None] ** -0.5
        self.matrix[places] += change[:, :, None] * change[:, None, :] - old[:, :, None] * old[:, None, :]


class Fitter:
    """Fits of machines that are known beforehand and measured to a plan.

    Parameters
    ----------
    knowledge : Knowledge
    plan : Plan

    Raises
    ------
    InputError
        Where the expected machine cannot take a planned pose, or legs are redundant and nothing errs.
    """

    def __init__(self, knowledge: Knowledge, plan: Plan) -> None:
        self.knowledge, self.plan = knowledge, plan
        self.expected = compute_sensitivity(knowledge, plan.actuators)
        self.seen = plan.information(self.expected.poses)
        self.redundant = plan.actuators.shape[-1] > DEGREES_OF_FREEDOM
        self._whiten, pose_noise = None, None
        if self.redundant:
            self._whiten = self.expected.whiten(plan)
            pose = self._whiten @ self.expected.by_pose
            pose_noise = np.linalg.inv(np.swapaxes(pose, -1, -2) @ pose)
        self._root = self.expected.root(plan, pose_noise)
        n_machine = knowledge.machine.layout.size
        self._of_machine = knowledge.free[knowledge.free < n_machine]
        self._of_frames = knowledge.free[knowledge.free >= n_machine] - n_machine

    def theta(self, moves: Array) -> Array:
        """Return machines and frames (B, D) for moves (B, n) in units of the tolerances."""
        theta = np.tile(self.knowledge.centre, (len(moves), 1))
        theta[:, self.knowledge.free] += moves * self.knowledge.sd
        return theta

    def fit(self, measured: Measurements, start: Array | None = None, prior_weight: Array | None = None) -> Fits:
        """Return the most probable machines.

        Parameters
        ----------
        measured : Measurements
        start : ndarray, shape (B, n), optional
            Moves in units of the tolerances; none by default.
        prior_weight : ndarray, shape (B, n), optional
            On the precision of the priors, one by default; parameters of weight zero are held at their start.
        """
        n_machines, n = len(measured.position), len(self.knowledge.sd)
        start = np.zeros((n_machines, n)) if start is None else start.copy()
        weight = np.ones((n_machines, n)) if prior_weight is None else prior_weight
        state = self._evaluate(measured, start)
        share, curvature = (
            np.ones(n_machines),
            _Curvature(np.zeros((n_machines, n, n)), np.zeros(n_machines, dtype=bool)),
        )
        converged, n_iterations = np.zeros(n_machines, dtype=bool), np.zeros(n_machines, dtype=int)
        active = np.flatnonzero(np.isfinite(state.deviance))
        while len(active) and n_iterations.max() < MAX_ITERATIONS:
            n_iterations[active] += 1
            here = state.take(active)
            whole, length = _find_step(here, weight[active], curvature.matrix[active])
            step = share[active, None] * whole
            moves = here.moves + step
            trial = self._evaluate(measured.take(active), moves, here)
            better = trial.total(weight[active]) <= here.total(weight[active])
            near = (length < TOLERANCE) & (share[active] > SHORTER**3)
            state.update(active, trial, better)
            curvature.known[active] |= ~better | (n_iterations[active] >= LONG)
            curvature.learn(active, step, here, trial)
            share[active] *= np.where(better, np.minimum(LONGER, 1.0 / share[active]), SHORTER)
            converged[active] = near
            active = active[~near & (share[active] > SHORTEST)]
        return Fits(state.moves, state.deviance, state.total(weight), state.information, converged, n_iterations)

    def _evaluate(self, measured: Measurements, moves: Array, before: _State | None = None) -> _State:
        """Return the states at moves (B, n), predicted poses sought from those before, or from the expected ones."""
        n_machines, n = moves.shape
        n_residuals = self.plan.n_poses * (DEGREES_OF_FREEDOM + self.redundant * self.plan.actuators.shape[-1])
        poses = self.expected.poses if before is None else before
        state = _State(
            moves,
            np.broadcast_to(poses.position, measured.position.shape).copy(),
            np.broadcast_to(poses.rotation, measured.rotation.shape).copy(),
            np.zeros((n_machines, n_residuals)) if before is None else before.residual.copy(),
            np.full(n_machines, np.inf),
            np.zeros((n_machines, n)),
            np.zeros((n_machines, n, n)),
            np.zeros((n_machines, n)),
        )
        per_machine = self.plan.actuators.size * self.knowledge.machine.layout.size
        size = max(1, CHUNK // per_machine)
        inside = np.flatnonzero(self.knowledge.layout.inside(self.theta(moves)))
        for k in range(0, len(inside), size):
            self._fill(state, measured, inside[k : k + size])
        return state

    def _fill(self, state: _State, measured: Measurements, places: np.ndarray) -> None:
        """Evaluate some machines of a state whose poses are close."""
        machine, data = self.knowledge.machine, measured.take(places)
        theta = self.theta(state.moves[places])
        machine_theta, frames = theta[:, :-N_FRAME_PARAMETERS], theta[:, -N_FRAME_PARAMETERS:]
        closure = machine.model.prepare(machine.layout, machine_theta[:, None])
        basis = machine.basis(data.actuators)
        position, rotation = state.position[places], state.rotation[places]
        for _ in range(POSE_STEPS):
            step = newton_step(self._weigh(closure(position, rotation, basis, with_parameters=False)))
            position = position + step[..., :3]
            rotation = matrix_from_rotation_vector(step[..., 3:]) @ rotation
            far = ~(np.abs(step).max(axis=(1, 2)) < POSE_TOLERANCE)
            if not far.any():
                break
        good = ~far
        if not good.any():
            return
        position, rotation = position[good], rotation[good]
        if not good.all():
            places, frames, data = places[good], frames[good], data.take(np.flatnonzero(good))
            closure = machine.model.prepare(machine.layout, machine_theta[good, None])
            basis = machine.basis(data.actuators)
        here = self._weigh(closure(position, rotation, basis))
        residual, slope = self._compare(here, position, rotation, frames, data)
        state.position[places], state.rotation[places] = position, rotation
        state.deviance[places] = np.einsum("bk,bk->b", residual, residual)
        transposed = np.swapaxes(slope, -1, -2).copy()  # a product with its own transposed view is slow
        state.gradient[places] = (transposed @ residual[..., None])[..., 0]
        state.crossed[places] = (transposed @ state.residual[places][..., None])[..., 0]
        state.residual[places] = residual
        state.information[places] = transposed @ slope

    def _weigh(self, here: Linearisation) -> Linearisation:
        """Return the closure in units of its noise where legs are redundant."""
        if self._whiten is None:
            return here
        residual = np.einsum("pij,bpj->bpi", self._whiten, here.residual)
        parameters = self._whiten @ here.parameters if here.parameters.size else here.parameters
        return Linearisation(residual, self._whiten @ here.pose, here.actuators, parameters)

    def _compare(
        self, here: Linearisation, position: Array, rotation: Array, frames: Array, data: Measurements
    ) -> tuple[Array, Array]:
        """Return residuals in units of the noise, shape (b, m), and derivatives by the moves, shape (b, m, n)."""
        by_parameters = here.parameters[..., self._of_machine]
        if self.redundant:
            transposed = np.swapaxes(here.pose, -1, -2)
            gain = np.linalg.solve(transposed @ here.pose, transposed)
        else:
            gain = np.linalg.inv(here.pose)
        if len(self._of_frames):
            by_pose, by_frames = measured_pose_slopes(frames, position, rotation)
            gain_seen = by_pose @ gain
            position, rotation = move_frames(frames, position, rotation)
        else:
            gain_seen = gain
        error = compute_pose_error(data.position, data.rotation, position, rotation)
        root = np.broadcast_to(self._root, (*error.shape[:-1], DEGREES_OF_FREEDOM, DEGREES_OF_FREEDOM)).copy()
        root[..., 3:] = root[..., 3:] @ np.swapaxes(compute_left_inverse_jacobian(error[..., 3:]), -1, -2)
        columns = (root @ gain_seen) @ by_parameters
        if len(self._of_frames):
            columns = np.concatenate([columns, -root @ by_frames[..., self._of_frames]], axis=-1)
        residual = np.einsum("pij,bpj->bpi", self._root, error)
        if self.redundant:  # what no pose explains: f less what it is along the columns of A
            loops = by_parameters - here.pose @ (gain @ by_parameters)
            loops = np.concatenate([loops, np.zeros((*loops.shape[:-1], len(self._of_frames)))], axis=-1)
            columns = np.concatenate([columns, loops], axis=-2)
            residual = np.concatenate([residual, here.residual], axis=-1)
        n_machines, n = len(error), columns.shape[-1]
        slope = columns.reshape(n_machines, -1, n) * self.knowledge.sd
        return residual.reshape(n_machines, -1), slope


def _find_step(state: _State, weight: Array, curvature: Array) -> tuple[Array, Array]:
    """Return steps (b, n) and their squared lengths in posterior standard deviations (b,)."""
    moving = weight > 0.0
    gradient = np.where(moving, state.gradient + weight * state.moves, 0.0)
    matrix = (state.information + curvature) * moving[:, :, None] * moving[:, None, :]
    diagonal = np.arange(weight.shape[1])
    matrix[:, diagonal, diagonal] += np.where(moving, weight, 1.0)
    step = -np.linalg.solve(matrix, gradient[..., None])[..., 0]
    return step, np.einsum("bi,bij,bj->b", step, matrix, step)
