"""The density of legs whose errors are functions of the pose, several at once, whatever instrument measured.

Leg i errs at poses p and q, beside the stated noise and independently of the other legs, by

    cov(g_ip, g_iq) = √(w_ip w_iq) { τ_i² δ_pq + Σ_t s_t² k_t,i(p, q) / c_t }

with sorts t of functions of the pose (`bayescal.density.sorts`): linear in the travel, linear in the leg's own, smooth,
or of the place in measuring order. c_t is the mean of k_t over legs and calibration poses, so that each scale s_t is a
root mean square in mm. There are several sorts because a scale is learnt from what of an error is visible: a smooth
kernel alone expects curvature, sees none, shrinks, and hides errors that are linear, which the geometry imitates
(Brynjarsdottir and O'Hagan 2014).

A pose's rows r ~ N(0, C⁰ + H (…) Hᵀ), H = W √w, are turned once to rows e that are white but for model errors, of
which the first N' see the legs: H becomes R there and zero below. Then all rows together have the covariance

    S = 1 + Σ_i τ_i² (R_i R_iᵀ at each pose) + Σ_t s_t² E_t,    E_t = Σ_i R_ip R_iqᵀ k_t,i(p, q) / c_t,

a sum of fixed matrices (variance components: Patterson and Thompson 1971), whose Cholesky factor is the density's cost.
With more than `MOST_ROWS` rows of all poses together E_t is taken to be of few columns (`LowRankComponents`).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from copy import copy
from dataclasses import replace

import numpy as np

from bayescal.data.measured_poses import MeasuredPoses
from bayescal.density.components import MOST_ROWS, Components, LinearRows, White, batches, factorise
from bayescal.density.directions import list_directions
from bayescal.density.elimination import whiten_covariance
from bayescal.density.errors import LegErrors
from bayescal.density.few_columns import LowRankComponents, list_gram_arrays
from bayescal.density.instruments import InstrumentLikelihood
from bayescal.density.legs import Likelihood, turn_to_coordinates
from bayescal.density.pose_likelihood import PoseLikelihood
from bayescal.density.sampling import LegSampling
from bayescal.density.sorts import (
    FEWEST_POSES,
    MOST_CHOSEN,
    MOST_DRIFT,
    MOST_SMOOTH,
    SORTS,
    Place,
    PoseFunctions,
)
from bayescal.errors import InputError
from bayescal.machines.kinematics import solve_forward_kinematics
from bayescal.numerics.geometry import Array, rotation_vector_from_matrix

ANGLES = np.arange(6) >= 3
"""Which numbers of a pose are angles."""
AT_ONCE, FEWEST = 2**16, 16
"""Poses of vectors that are taken together, and vectors however many poses there are."""
COVARIANCES = 3.0
"""Of all rows, for each amplitude: itself, products with an inverse."""

type LegRows = PoseLikelihood | InstrumentLikelihood
"""Densities of poses that are independent of each other."""


class FunctionLikelihood(Likelihood):
    """Log-density of poses with errors that are functions of the pose; see the module.

    Amplitudes are vectors of N + C entries, mm: τ of each leg, then s of each sort.

    Parameters
    ----------
    base : PoseLikelihood or InstrumentLikelihood
        Density of the calibration poses without such errors.
    sorts : sequence of str
        Of `bayescal.density.sorts.SORTS`.
    travel : float
        Range of the actuators, mm.
    order : mapping of str to float
        From names of poses to their places in measuring order, 0 to 1; empty where there is none.
    functions : PoseFunctions, optional
        Those of other poses, over which they are normalised; by default over these.
    """

    def __init__(
        self,
        base: LegRows,
        sorts: Sequence[str],
        travel: float,
        order: Mapping[str, float],
        functions: PoseFunctions | None = None,
    ) -> None:
        if functions is None and base.n_poses < FEWEST_POSES:
            raise InputError(f"model_error: found {base.n_poses} calibration poses, expected {FEWEST_POSES} or more")
        # where the geometry is hardly known the mode's gradient needs more digits
        self.base: LegRows = base.refined() if isinstance(base, PoseLikelihood) else base
        self.machine, self.layout, self.actuator_weight = base.machine, base.layout, base.actuator_weight
        self._travel, self._order = travel, order
        self.place = self.place_of(base)
        self._turn, self._seen = _turn_rows(base)
        self.functions = functions or PoseFunctions(tuple(sorts), self.place)
        # where held-back poses are many, so are the rows that are predicted together
        if max(base.n_poses, len(order)) * self._seen.shape[1] > MOST_ROWS and self.functions.of_few is None:
            self.functions = replace(self.functions, of_few=self.place)
        self.components = self._find_components()
        self._constant = base.log_constant + np.linalg.slogdet(self._turn)[1]

    def place_of(self, poses: LegRows) -> Place:
        """Return where poses are."""
        home = self.machine.mechanism.initial_actuator_positions
        time = np.array([self._order[name] for name in poses.pose_names]) if self._order else None
        return Place((poses.actuators - home) / self._travel, time)

    def _find_components(self) -> Components | LowRankComponents:
        """Return what the model errors of each leg, then the sorts of functions, add to the white rows."""
        n_poses, n, n_legs = self._seen.shape
        known = np.broadcast_to(np.eye(n), (n_poses, n, n))
        blocks = np.einsum("pai,pbi->ipab", self._seen, self._seen)
        if self.functions.of_few is not None:
            return LowRankComponents(
                known, blocks, self._seen, *self.functions.join_bases(self.place), self.functions.left
            )
        parts = np.empty((len(self.functions.sorts), n_poses * n, n_poses * n))
        for k, kernel in enumerate(self.functions.between(self.place, self.place)):
            whole = _for_legs(kernel, n_legs)
            parts[k] = np.einsum("pai,ipq,qbi->paqb", self._seen, whole, self._seen, optimize=True).reshape(
                parts.shape[1:]
            )
        return Components(known, blocks, parts)

    # --- what it is ----------------------------------------------------------------------------------------------

    @property
    def of_poses(self) -> PoseLikelihood | None:
        """The density without such errors, where whole poses were measured."""
        return self.base.of_poses

    @property
    def closing_poses(self) -> MeasuredPoses | None:
        """Those of the poses: joints are hardly known where errors may be functions of the pose."""
        return None if self.base.of_poses is None else self.base.of_poses.poses

    @property
    def n_places(self) -> int:
        """How many places in measuring order there are; as many as poses where there is no order."""
        return len(self._order) or self.n_poses

    def of_errors_at(self, poses: PoseLikelihood, rows: np.ndarray | None = None) -> FunctionLikelihood:
        """Return the density of other poses with such errors; in their own order where any is not known here.

        Where they are poses of these measured again, ``rows`` says which, and they have the places of these in order.
        """
        names, order = poses.pose_names, self._order
        if rows is not None and self.place.time is not None:
            order = dict(zip(names, self.place.time[rows].tolist(), strict=True))
        elif order and not set(names) <= set(order):
            order = {name: k / len(names) for k, name in enumerate(names)}
        return FunctionLikelihood(poses, self.functions.sorts, self._travel, order, self.functions)

    @property
    def n_poses(self) -> int:
        """Number of poses P."""
        return self.base.n_poses

    @property
    def n_rows(self) -> np.ndarray:
        """How many rows each pose has, shape (P,)."""
        return self.base.n_rows

    @property
    def n_model_errors(self) -> int:
        """N + C."""
        return self.n_legs + len(self.functions.sorts)

    def finer(self) -> FunctionLikelihood | None:
        """Return the same density of a base that leaves nothing out; None where there is none."""
        found = self.base.finer()
        if not isinstance(found, PoseLikelihood):
            return None
        other = copy(self)
        other.base = found
        return other

    @property
    def is_solved(self) -> bool:
        """Whether its base leaves nothing out."""
        return self.base.is_solved

    def errors(self, theta: Array) -> Array:
        """Return the rows of the base, (B, D) to (B, P, K)."""
        return self.base.errors(theta)

    def error_jacobian(self, theta: Array) -> tuple[Array, Array]:
        """Return those rows (P, K) and their derivative (P, K, D) for one parameter vector (D,)."""
        return self.base.error_jacobian(theta)

    def on_legs(self, rows: Array) -> Array:
        """Return Wᵀ times something of the rows."""
        return self.base.on_legs(rows)

    def pose_errors(self, theta: Array) -> Array:
        """Return measured minus predicted pose (mm, rad), shape (B, P, 6)."""
        return self.base.pose_errors(theta)

    def pose_covariance(self, model_error: Array) -> Array:
        """Return the covariance of a pose but for the functions, (..., P, 6, 6), for amplitudes (..., N + C)."""
        return self.base.pose_covariance(self.of_single_poses(model_error))

    def of_single_poses(self, model_error: Array) -> Array:
        """Return errors of single poses, (..., N + C) to (..., N): τ, and what functions of few columns leave out."""
        left = model_error[..., self.n_legs :] ** 2 @ self.functions.left
        return np.sqrt(model_error[..., : self.n_legs] ** 2 + left[..., None])

    def error_covariance(self, model_error: Array) -> Array:
        """Return the covariance of each pose's rows by itself, shape (P, K, K), for amplitudes (N + C,)."""
        own = self.functions.variances(self.place)
        square = sum(s**2 * one for s, one in zip(model_error[self.n_legs :], own, strict=True))  # (N or 1, P)
        shown = self.base.rows_of_legs * np.sqrt(self.actuator_weight * np.asarray(square).T)[:, None, :]
        return self.base.error_covariance(self.of_single_poses(model_error)) + shown @ np.swapaxes(shown, -1, -2)

    # --- covariance of all rows ----------------------------------------------------------------------------------

    def _split(self, rows: Array) -> tuple[Array, Array]:
        """Return white rows that see the legs (..., M) and others (..., P, K - N'), of rows (..., P, K)."""
        n_seen = self._seen.shape[1]
        white = (self._turn @ rows[..., None])[..., 0]
        return white[..., :n_seen].reshape(*rows.shape[:-2], -1), white[..., n_seen:]

    def _split_slopes(self, slope: Array) -> tuple[Array, Array]:
        """Return the same of derivatives (P, K, m): (M, m) and (P (K - N'), m)."""
        white, n_seen, m = self._turn @ slope, self._seen.shape[1], slope.shape[-1]
        return white[:, :n_seen].reshape(-1, m), white[:, n_seen:].reshape(-1, m)

    def whiten(self, model_error: Array) -> Callable[[Array], Array]:
        """Return what makes rows (P, K, n) of all poses together white, (P, K, n)."""
        factor, n_seen = self.components.factorise(model_error**2), self._seen.shape[1]

        def apply(rows: Array) -> Array:
            white = self._turn @ rows
            seen = factor.rows(white[:, :n_seen].reshape(-1, rows.shape[-1]))
            return np.concatenate([seen.reshape(-1, n_seen, rows.shape[-1]), white[:, n_seen:]], axis=1)

        return apply

    def batches(self, size: int, n_others: int = 0) -> list[slice]:
        """Return which of so many vectors are taken together, where rows of so many other poses are predicted, too."""
        return batches(size, max(self.components.size, n_others * self._turn.shape[-1]))

    def _batches(self, size: int) -> list[slice]:
        return self.batches(size)

    # --- density -------------------------------------------------------------------------------------------------

    @np.errstate(all="ignore")  # far out numbers overflow: no density in the end
    def __call__(self, theta: Array, model_error: Array) -> Array:
        """Return the log-likelihood, shape (B,), for vectors (B, D) and amplitudes (B, N + C) or (N + C,)."""
        model_error = np.broadcast_to(model_error, (len(theta), model_error.shape[-1]))
        density = np.empty(len(theta))
        most = max(FEWEST, AT_ONCE // self.n_poses)
        for part in (slice(k, k + most) for k in range(0, len(theta), most)):
            rows = self.base.errors(theta[part])
            good = np.isfinite(rows).all(axis=(1, 2))
            seen, unseen = self._split(np.where(good[:, None, None], rows, 0.0))
            density[part] = self._constant.sum() - 0.5 * np.einsum("bpk,bpk->b", unseen, unseen)
            density[part] += self.components.weigh(model_error[part] ** 2, seen)
            density[part][~good] = -np.inf
        return np.where(np.isfinite(density), density, -np.inf)

    @np.errstate(all="ignore")
    def _evaluate(self, theta: Array, model_error: Array) -> tuple[Array, Array]:
        """Return log p(r_n | all other poses, θ, amplitudes) of each pose and its squared deviation, shapes (B, P)."""
        model_error = np.broadcast_to(model_error, (len(theta), model_error.shape[-1]))
        rows = self.base.errors(theta)
        good = np.isfinite(rows).all(axis=(1, 2))
        seen, unseen = self._split(np.where(good[:, None, None], rows, 0.0))
        density, square = self.components.weigh_each(model_error**2, seen)
        rest = np.einsum("bpk,bpk->bp", unseen, unseen)
        density, square = density + self._constant - 0.5 * rest, square + rest
        return np.where(good[:, None], density, -np.inf), np.where(good[:, None], square, np.inf)

    # --- derivatives ---------------------------------------------------------------------------------------------

    def inform(self, theta: Array, change: Array, errors: LegErrors, zeta: Array) -> Array:
        """Return the information of the data on the geometry, shape (m, m)."""
        white = self.components.factorise(errors.amplitudes(zeta) ** 2)
        seen, unseen = self._split_slopes(turn_to_coordinates(self.error_jacobian(theta)[1], change))
        rows = white.rows(seen)
        return np.asarray(rows.T @ rows + unseen.T @ unseen)

    def inform_row(self, theta: Array, change: Array, errors: LegErrors, zeta: Array, row: int) -> Array:
        """Return what one pose tells of the geometry beyond all others, shape (m, m)."""
        white, n_seen = self.components.factorise(errors.amplitudes(zeta) ** 2), self._seen.shape[1]
        slope = turn_to_coordinates(self.error_jacobian(theta)[1], change)
        seen, _ = self._split_slopes(slope)
        mine, unseen = slice(row * n_seen, (row + 1) * n_seen), (self._turn[row] @ slope[row])[n_seen:]
        solved, own = white.solve(seen)[mine], white.solve(np.eye(len(seen))[:, mine])[mine]
        return np.asarray(solved.T @ np.linalg.solve(own, solved) + unseen.T @ unseen)

    def differentiate(
        self, theta: Array, change: Array, errors: LegErrors, zeta: Array, newton: bool
    ) -> tuple[Array, Array]:
        """Return gradient and Hessian of the log-likelihood; see `Elimination.differentiate`.

        With α = S⁻¹ e, J = ∂e/∂y and ∂S/∂a = 2 a E of an amplitude a:

            ∂/∂y = -Jᵀ α,   ∂/∂a = a (αᵀ E α - tr S⁻¹ E),   ∂²/∂y ∂a = 2 a Jᵀ S⁻¹ E α,
            ∂²/∂a ∂b = 2 a b tr (S⁻¹ E_a S⁻¹ E_b) - 4 a b αᵀ E_a S⁻¹ E_b α + δ_ab (αᵀ E α - tr S⁻¹ E),

        of whose expectation Gauss and Newton's Hessian has -2 a b tr (S⁻¹ E_a S⁻¹ E_b).
        """
        amplitudes, m = errors.amplitudes(zeta), change.shape[1]
        white, (rows, slope) = self.components.factorise(amplitudes**2), self.error_jacobian(theta)
        seen, unseen = self._split(rows)
        by_seen, by_unseen = self._split_slopes(turn_to_coordinates(slope, change))
        alpha, solved = white.solve(seen), white.solve(by_seen)
        n = m + errors.n_amplitudes
        gradient, hessian = np.zeros(m + len(zeta)), np.zeros((m + len(zeta), m + len(zeta)))
        gradient[:m] = -by_seen.T @ alpha - by_unseen.T @ unseen.ravel()
        hessian[:m, :m] = -by_seen.T @ solved - by_unseen.T @ by_unseen
        if n == m:
            return gradient, hessian
        slopes, inside = errors.slopes_of_amplitudes(zeta), slice(m, n)
        pulled = self.components.act(alpha)  # E α (K, M)
        traces, both = self.components.traces(amplitudes**2)
        surplus = pulled @ alpha - traces
        scaled = np.outer(amplitudes, amplitudes)
        gradient[inside] = slopes @ (amplitudes * surplus)
        if not newton:
            hessian[inside, inside] = -2.0 * slopes @ (scaled * both) @ slopes.T
            return gradient, hessian
        across = 2.0 * (solved.T @ pulled.T) * amplitudes
        own = scaled * (2.0 * both - 4.0 * pulled @ white.solve(pulled.T)) + np.diag(surplus)
        hessian[:m, inside] = across @ slopes.T
        hessian[inside, :m] = hessian[:m, inside].T
        hessian[inside, inside] = slopes @ own @ slopes.T
        hessian[inside, inside] += np.diag(errors.curvatures_of_amplitudes(zeta) @ (amplitudes * surplus))
        return gradient, hessian

    # --- straightening, search for the mode ----------------------------------------------------------------------

    def groups(self, sampling: LegSampling, errors: LegErrors) -> list[np.ndarray]:
        """Return all coordinates as one group: functions tie the legs together."""
        del errors
        return [np.arange(sampling.size)]

    def funnel_errors(self, errors: LegErrors, zeta: Array) -> Array:
        """Return the amplitudes, shape (B, N + C)."""
        return np.broadcast_to(errors.amplitudes(zeta), (len(zeta), self.n_model_errors))

    def funnel(self, sampling: LegSampling, errors: LegErrors, y: Array) -> None:
        """Return None: how the geometry depends on the errors is known in closed form, see `linear_rows`."""

    def linear_rows(self, sampling: LegSampling, errors: LegErrors, y: Array, cause: str = "") -> LinearRows | None:
        """Return the rows as a linear model of the geometry about y, shape (n,); see `Elimination.linear_rows`."""
        theta, change = self._around(sampling, y)
        rows, slope = self.error_jacobian(theta)
        seen, unseen = self._split(rows)
        by_seen, by_unseen = self._split_slopes(turn_to_coordinates(slope, change))
        if cause:
            columns = list_directions(cause, self._place_poses(), ANGLES, self.n_legs)
            if columns is None:
                return None
            by_seen = np.concatenate([by_seen, (self._seen @ columns).reshape(len(by_seen), -1)], axis=1)
            by_unseen = np.pad(by_unseen, ((0, 0), (0, columns.shape[-1])))
        square = self.components.square(np.column_stack([by_seen, seen]))
        pull = -by_unseen.T @ unseen.ravel()
        return LinearRows(by_unseen.T @ by_unseen, pull, lambda zeta: square(errors.amplitudes(zeta) ** 2))

    def _place_poses(self) -> Array:
        """Return the nominal machine's poses from home, mm and rad, shape (P, 6); NaN where it has none."""
        machine, home = self.machine, self.machine.mechanism.initial_actuator_positions
        actuators = np.concatenate([home[None], self.base.actuators])
        found = solve_forward_kinematics(machine, machine.layout.nominal, actuators, check=False)
        turned = found.rotation[0].T @ found.rotation[1:]
        place = np.concatenate([found.position[1:] - found.position[0], rotation_vector_from_matrix(turned)], axis=1)
        return np.where(found.converged.all(), place, np.nan)

    def _around(self, sampling: LegSampling, y: Array) -> tuple[Array, Array]:
        theta = sampling.theta_from_y(y[None, : sampling.size])[0]
        return theta, sampling.jacobian(theta)

    def _fit(self, sampling: LegSampling, errors: LegErrors, start: Array, amplitudes: Array) -> Array:
        """Return y with the geometry of least squares, white rows and priors together, at amplitudes (N + C,)."""
        found, m, factor = start.copy(), sampling.size, self.components.factorise(amplitudes**2)

        def whiten(rows: Array) -> Array:
            seen, unseen = self._split_slopes(rows)
            return np.concatenate([factor.rows(seen), unseen])

        found[:m] = self.fit_geometry(sampling, start[:m], whiten)
        return found

    # --- prediction ----------------------------------------------------------------------------------------------

    def _list_parts(self, poses: LegRows) -> tuple[Array, Array]:
        """Return covariances by each sort of size 1: of rows of Q other poses with e, and of them between each other.

        Shapes (C, Q K, M) and (C, Q K, Q K).
        """
        place, shown = self.place_of(poses), poses.rows_of_legs * np.sqrt(poses.actuator_weight)[:, None, :]
        size = shown.shape[0] * shown.shape[1]

        def show(other: Place, seen: Array) -> Array:
            kernels = (_for_legs(one, self.n_legs) for one in self.functions.between(place, other))
            found = [np.einsum("qki,iqp,pai->qkpa", shown, one, seen, optimize=True) for one in kernels]
            return np.stack(found).reshape(len(found), size, -1)

        return show(self.place, self._seen), show(place, shown)

    def leave_out(self, theta: Array, model_error: Array) -> tuple[Array, Array]:
        """Return each pose's rows as read minus expected from all other poses, (B, P, K), and their covariance.

        The covariance, shape (B, P, K, K), is that of reading them; vectors are (B, D) and amplitudes (B, N + C).
        """
        seen, unseen = self._split(self.base.errors(theta))
        deviation, precision = self.components.leave_out(model_error**2, seen)
        n_seen, k = self._seen.shape[1], self._turn.shape[-1]
        white = np.broadcast_to(np.eye(k), (*deviation.shape[:2], k, k)).copy()
        white[..., :n_seen, :n_seen] = np.linalg.inv(precision)
        back = np.linalg.inv(self._turn)
        rows = (back @ np.concatenate([deviation, unseen], axis=-1)[..., None])[..., 0]
        return rows, back @ white @ np.swapaxes(back, -1, -2)

    def predict(self, poses: LegRows, theta: Array, model_error: Array) -> tuple[Array, Array, Array]:
        """Return what is expected of rows of Q other poses given the calibration poses.

        Rows as read minus expected, (B, Q, K), the covariance of each pose's, (B, Q, K, K), and the log-density of all
        of them together but for 2 π, (B,); vectors are (B, D) and amplitudes (B, N + C).
        """
        known, _ = self._split(self.base.errors(theta))
        rows = poses.errors(theta)
        if isinstance(self.components, Components):
            parts = self._list_parts(poses)
            found = [self._condition(poses, parts, *one) for one in zip(rows, known, model_error, strict=True)]
        else:
            found = [self._condition_columns(poses, *one) for one in zip(rows, known, model_error, strict=True)]
        deviation, own, together = zip(*found, strict=True)
        return np.stack(deviation), np.stack(own), np.array(together)

    def _condition(
        self, poses: LegRows, parts: tuple[Array, Array], rows: Array, known: Array, amplitudes: Array
    ) -> tuple[Array, Array, float]:
        """Return the same for rows (Q, K), seen rows (M,) of the calibration poses and amplitudes (N + C,)."""
        white, variances, (q, k) = self.components.factorise(amplitudes**2), amplitudes[self.n_legs :] ** 2, rows.shape
        across, total = (np.tensordot(variances, one, axes=1) for one in parts)
        np.einsum("qkql->qkl", total.reshape(q, k, q, k))[:] += poses.error_covariance(amplitudes[: self.n_legs])
        seen = white.rows(across.T)
        total -= seen.T @ seen
        deviation = rows - (seen.T @ white.rows(known)).reshape(rows.shape)
        own = np.einsum("qkql->qkl", total.reshape(q, k, q, k)).copy()
        held = White(factorise(total))
        square = held.rows(deviation.ravel())
        return deviation, own, -0.5 * float(square @ square) - held.half_log_det

    def _condition_columns(
        self, poses: LegRows, rows: Array, known: Array, amplitudes: Array
    ) -> tuple[Array, Array, float]:
        """Return the same where functions are made of few columns: given their coefficients poses are independent."""
        assert isinstance(self.components, LowRankComponents)
        white, basis = self.components.factorise(amplitudes**2), self.functions.join_bases(self.place_of(poses))[0]
        shown = poses.rows_of_legs * np.sqrt(poses.actuator_weight)[:, None, :]
        expected, spread = white.predict(known, shown, basis)
        deviation, noise = rows - expected, poses.error_covariance(self.of_single_poses(amplitudes))
        others = LowRankComponents(
            noise, np.zeros((0, *noise.shape)), shown, basis, self.components.sorts, self.functions.left
        )
        return deviation, noise + spread, others.weigh_given(white.root, deviation.ravel())

    # --- the functions -------------------------------------------------------------------------------------------

    def factor_functions(self, model_error: Array) -> Array:
        """Return F_i with F_i F_iᵀ the covariance of leg i's functions over the poses, mm along the actuators.

        Shape (B, N, P, R), of amplitudes (B, N + C).
        """
        if isinstance(self.components, LowRankComponents):
            scales = model_error[:, self.n_legs + self.components.sorts]
            return self.components.basis * scales[:, None, None]
        kernels = [_for_legs(one, self.n_legs) for one in self.functions.between(self.place, self.place)]
        return _root(np.einsum("bt,tipq->bipq", model_error[:, self.n_legs :] ** 2, np.stack(kernels)))

    def draw_prior(self, place: Place, model_error: Array, rng: np.random.Generator) -> Array:
        """Return draws of the functions before any data, one of each of amplitudes (B, N + C), at Q poses.

        Shape (B, C, Q, N), mm along the actuators.
        """
        return np.stack(list(self.draw_sorts(place, model_error, rng)), axis=1)

    def draw_sorts(self, place: Place, model_error: Array, rng: np.random.Generator) -> Iterator[Array]:
        """Yield the same sort by sort, (B, Q, N) each."""
        scales, few = model_error[:, self.n_legs :], self.functions.of_few is not None
        found = self.functions.list_bases(place) if few else self.functions.between(place, place)
        for k, one in enumerate(found):
            root = _for_legs(one if few else _root(one), self.n_legs)
            normal = rng.standard_normal((len(scales), self.n_legs, root.shape[-1]))
            yield scales[:, k, None, None] * np.einsum("iqa,bia->bqi", root, normal, optimize=few)

    def draw(
        self, others: LegRows | None, theta: Array, model_error: Array, rng: np.random.Generator
    ) -> tuple[Array, Array]:
        """Return means and draws of the functions given the errors at the calibration poses, (B, C, P + Q, N) each.

        They are at the calibration poses and at Q others behind them, mm along the actuators. A draw of the prior, with
        all errors, moves by what the data make of how they differ from it (conditioning by kriging: Journel and
        Huijbregts 1978).
        """
        own, n, n_poses = self.place, self.n_legs, self.n_poses
        place = own if others is None else own.join(self.place_of(others))
        read, _ = self._split(self.base.errors(theta))
        if isinstance(self.components, LowRankComponents):
            return self._draw_columns(self.components, place, read, model_error, rng)
        drawn = self.draw_prior(place, model_error, rng)
        alone = model_error[:, None, :n] * rng.standard_normal((len(theta), n_poses, n))
        made = np.einsum("pai,bpi->bpa", self._seen, drawn[:, :, :n_poses].sum(axis=1) + alone)
        made = made.reshape(read.shape) + rng.standard_normal(read.shape)
        mean, kernels = np.empty_like(drawn), self.functions.between(place, own)
        for k, amplitudes in enumerate(model_error):
            solved = self.components.factorise(amplitudes**2).solve(np.stack([read[k], read[k] - made[k]], axis=1))
            by_legs = np.einsum("pai,paz->zpi", self._seen, solved.reshape(n_poses, -1, 2))
            for c, kernel in enumerate(kernels):
                moves = np.einsum("iqp,zpi->zqi", _for_legs(kernel, n), by_legs, optimize=True)
                mean[k, c] = amplitudes[n + c] ** 2 * moves[0]
                drawn[k, c] += amplitudes[n + c] ** 2 * moves[1]
        return mean, drawn

    def _draw_columns(
        self, components: LowRankComponents, place: Place, read: Array, model_error: Array, rng: np.random.Generator
    ) -> tuple[Array, Array]:
        """Return means and draws of the functions at poses by their coefficients given seen rows (B, M)."""
        basis, sorts = self.functions.join_bases(place)
        n, n_places, size = basis.shape
        mean = np.empty((len(read), len(self.functions.sorts), n_places, n))
        drawn = np.empty_like(mean)
        for k, amplitudes in enumerate(model_error):
            white = components.factorise(amplitudes**2)
            expected = white.expect(read[k, :, None])[:, 0]
            coefficients = np.stack([expected, expected + white.root @ rng.standard_normal(len(expected))], axis=1)
            by_function = coefficients.reshape(n, size, 2)
            for sort in range(len(self.functions.sorts)):
                values = basis[..., sorts == sort] @ by_function[:, sorts == sort]
                mean[k, sort], drawn[k, sort] = values.transpose(2, 1, 0)
        return mean, drawn


def list_arrays(n_poses: int, n_legs: int) -> list[tuple[float, ...]]:
    """Return what a density holds of poses with as many rows as legs: how many arrays alike, then their shape."""
    m = n_poses * n_legs
    if m <= MOST_ROWS:
        return [(COVARIANCES * (n_legs + len(SORTS)), m, m)]
    a = n_legs + 1 + MOST_SMOOTH + MOST_DRIFT
    columns = [(1.0, m, a), (2.0, n_poses, MOST_CHOSEN), (4.0, m, n_legs)]
    return [*columns, *list_gram_arrays(m, n_legs * a)]


def _root(kernel: Array) -> Array:
    """Return F with F Fᵀ a matrix without negative eigenvalues, (..., Q, Q)."""
    values, vectors = np.linalg.eigh(kernel)
    return np.asarray(vectors * np.sqrt(np.maximum(values, 0.0))[..., None, :])


def _for_legs(kernel: Array, n_legs: int) -> Array:
    """Return kernels (N or 1, ...) of each leg, (N, ...)."""
    return np.broadcast_to(kernel, (n_legs, *kernel.shape[1:]))


def _turn_rows(base: LegRows) -> tuple[Array, Array]:
    """Return Z (P, K, K), which makes rows white but for model errors, and R (P, N', N), what N' see of legs."""
    white, _ = whiten_covariance(base.error_covariance(np.zeros(base.n_legs)))
    shown = white @ (base.rows_of_legs * np.sqrt(base.actuator_weight)[:, None, :])
    axes, _ = np.linalg.qr(shown, mode="complete")
    turn = np.swapaxes(axes, -1, -2)
    return turn @ white, (turn @ shown)[:, : min(shown.shape[1:])]
