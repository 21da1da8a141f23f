"""The maximum a posteriori point: least squares with exact Jacobians, then the model errors with it.

Two posts beside a line (`tests/cases/posts_on_either_side`) need mirrored coordinates and combined jumps: without
either a machine is lost, and nothing is reported (`benchmarks/ablation`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from scipy.linalg import cholesky, solve_triangular
from scipy.optimize import OptimizeResult, minimize

from bayescal.errors import NumericalError
from bayescal.inference.importance import difference_twice, evaluate_in_batches
from bayescal.inference.loose import find_information
from bayescal.inference.scales import find_scales_mode
from bayescal.inference.target import LogDensity
from bayescal.limits import FAR_AWAY
from bayescal.numerics.geometry import Array

GRADIENT_TOLERANCE = 1e-3  # per prior sd: a Newton step would gain below 1e-6
DECREMENT_TOLERANCE = 1e-4
TOP = 1e-6  # decrement where a climb ends
STALLED, NO_GAIN = 5e-5, 1e-6  # decrement where it ends if its last step gained no more nats: rounding is next
SAME = 0.03  # prior sds: two climbs that stop at a decrement of 1e-4 may end so far apart
HESSIAN_STEP = 0.1  # posterior sds
LEAST_CURVATURE = 0.3  # where that of Gauss and Newton is not one of a maximum; that of the prior is 1
PATIENCE, HOPELESS = 20, 40.0  # steps after which a climb this many nats below the best is given up
WORTH_KEEPING = 12.0  # a mode this many nats below the best holds no mass that matters
WORTH_COMBINING = 7.0  # a combination of jumps expected to hold less than e^-7 of the best is not climbed
MOST_COMBINATIONS = 63  # all of six jumps
N_SCATTERED = 3  # draws of the prior from which the search begins again
AWAY, FARTHEST = 50.0, 0.1  # steps along a coordinate: conditional posterior sds, and prior sds at most
LEAST = 2e-5  # prior sds: what is known better has a prior that says nothing, through which nobody looks
FARTHEST_IMAGE = 15.0  # prior sds: as far as it may be judged to be; where it is 6 away it is judged to be 15
MIRRORED = 1000  # number of the first jump along one coordinate, behind those that a posterior knows
LAST_STEPS = 4  # by differences
MOST_STEPS, HALVINGS = 30, 6  # of geometry at the errors that are most probable
SETTLED = 1e-2  # squared posterior sds that geometry there may still be off
KNOWN = 1.0  # square of the distance in posterior sds within which least squares have led back to a known mode
MAX_MODE_GAP_NAT = 1e3  # nats below the best where least squares found no machine that fits

type Climb = tuple[Array, float]


@dataclass(frozen=True)
class Mode:
    """A local maximum of the posterior density in sampling coordinates."""

    y: Array  # (n,): where it is
    log_density: float  # unnormalised log-density there
    covariance: Array  # (n, n): inverse of the negative Hessian
    converged: bool  # whether the gradient vanished there

    @property
    def log_evidence(self) -> float:
        """Laplace's approximation of the mass of this mode."""
        _, log_det = np.linalg.slogdet(self.covariance)
        return self.log_density + 0.5 * log_det + 0.5 * len(self.y) * np.log(2 * np.pi)


def find_modes(posterior: LogDensity, rng: np.random.Generator | None = None) -> list[Mode]:
    """Return the posterior's modes, best first: the one found from its own start, and those its jumps lead to.

    Each jump is tried, again from every better mode found, and then those combinations of jumps which the masses of
    their modes give a mass that matters. A mode that holds none is dropped. With random numbers jumps lead to
    places mirrored along single coordinates, too, and the search begins again from draws of the prior: where least
    squares lead back to known modes, neither costs a climb.
    """
    climber = NewtonSearch(posterior, looks_along=rng is not None)
    best, others = _follow_jumps(climber, _climb(posterior, posterior.least_squares_start()))
    first = _characterise(posterior, *best)
    if rng is not None and (found := _climb_scattered(climber, [best, *others], first, rng)):
        best, others = _follow_jumps(climber, max([best, *found], key=lambda climb: climb[1]), [best, *others, *found])
        first = _characterise(posterior, *best)
    return _characterise_all(climber, first, others)


def find_more_modes(posterior: LogDensity, n_known: int) -> list[Mode]:
    """Return what `find_modes` does where climbs end at more than so many places, else none."""
    climber = NewtonSearch(posterior)
    best, others = _follow_jumps(climber, _climb(posterior, posterior.least_squares_start()))
    if len(_list_worth(best[1], others)) < n_known:
        return []
    return _characterise_all(climber, _characterise(posterior, *best), others)


def _list_worth(best: float, others: Sequence[Climb]) -> list[Climb]:
    return [other for other in others if other[1] > best - 2 * WORTH_KEEPING]


def _characterise_all(climber: NewtonSearch, first: Mode, others: Sequence[Climb]) -> list[Mode]:
    """Return the best mode, those of the climbs that end elsewhere and hold mass, and combinations of their jumps."""
    modes = [_characterise(climber.posterior, *other) for other in _list_worth(first.log_density, others)]
    modes = [m for m in modes if m.converged and m.log_evidence > first.log_evidence - WORTH_KEEPING]
    return [first, *modes, *_combine(climber, first, modes)]


class NewtonSearch:
    """Climbs to modes of one posterior; a climb that comes again, from a jump that was followed, is not made again."""

    def __init__(self, posterior: LogDensity, *, looks_along: bool = False) -> None:
        self.posterior, self.looks_along = posterior, looks_along
        self.followed: dict[int, Climb | None] = {}  # where jumps from the best mode lead
        self._known: dict[tuple[bytes, float], Climb | None] = {}
        self._jumps: dict[bytes, list[tuple[int, Array]]] = {}

    def mode_candidates(self, y: Array) -> list[tuple[int, Array]]:
        """Return those of the posterior from a mode (n,), and those along single coordinates where they are wanted."""
        key = y.tobytes()
        if key not in self._jumps:
            along = _look_along(self.posterior, y) if self.looks_along else []
            self._jumps[key] = [*self.posterior.mode_candidates(y), *along]
        return self._jumps[key]

    def maximise(self, start: Array, floor: float = -np.inf) -> Climb | None:
        """Return where a climb ends; None where no machine is to start from, or the climb leaves all machines."""
        key = start.tobytes(), floor
        if key not in self._known:
            try:
                self._known[key] = _climb(self.posterior, start, floor)
            except NumericalError:
                self._known[key] = None
        return self._known[key]


def _look_along(posterior: LogDensity, y: Array) -> list[tuple[int, Array]]:
    """Return where least squares lead to from places mirrored along single coordinates of the geometry, from (n,).

    Where data do not see on which side of a line or a plane something is, readings change by a t + ½ c t² along its
    coordinate with c nearly parallel to a: they are the same again about t = -2 a·a / a·c. The log-density's changes at
    two distances to either side tell these products, whatever the readings are.
    """
    found, here = list[tuple[int, Array]](), float(posterior.log_density(y[None])[0])
    sd = 1.0 / np.sqrt(np.diag(find_information(posterior, y)))
    for k in np.flatnonzero((sd > LEAST) & (AWAY * sd < 1.0)):
        step = min(AWAY * sd[k], FARTHEST)
        points = np.tile(y, (4, 1))
        points[:, k] += step * np.array([1.0, -1.0, 2.0, -2.0])
        with np.errstate(all="ignore"):
            away = step * _find_mirrored(*(posterior.log_density(points) - here))
        start = y.copy()
        start[k] += away
        if not (abs(away) < FARTHEST_IMAGE and np.isfinite(posterior.log_density(start[None])[0])):
            continue
        start = posterior.refine_geometry(start)
        leads_back = np.allclose(start, y, rtol=0.0, atol=SAME)
        if not leads_back and posterior.log_density(start[None])[0] > here - MAX_MODE_GAP_NAT:
            found.append((MIRRORED + int(k), start))
    return found


def _find_mirrored(ahead: float, behind: float, far_ahead: float, far_behind: float) -> float:
    """Return how many steps away a place is mirrored by what is gained at 1, -1, 2 and -2."""
    # of -½ (a t + ½ c t²)² = -½ (a·a t² + a·c t³ + ¼ c·c t⁴), and a slope
    square = (far_ahead + far_behind - 16.0 * (ahead + behind)) / 12.0  # a·a
    product = (2.0 * (ahead - behind) - (far_ahead - far_behind)) / 6.0  # a·c
    return float(-2.0 * square / product) if product else np.inf


def _combine(climber: NewtonSearch, first: Mode, modes: list[Mode]) -> list[Mode]:
    """Return modes where several coordinates are those of other modes at once, as they differ from the first.

    Jumps of different coordinates hardly know of each other: their masses multiply.
    """
    posterior, singles = climber.posterior, _match_jumps(climber, first, modes)
    found: dict[tuple[int, ...], Mode] = {(jump,): mode for jump, mode in singles.items()}
    lost = {jump: first.log_evidence - mode.log_evidence for jump, mode in singles.items()}
    sets = [c for size in range(2, len(lost) + 1) for c in combinations(sorted(lost, key=lambda j: lost[j]), size)]
    sets = [c for c in sets if sum(lost[jump] for jump in c) < WORTH_COMBINING]
    known = [first, *modes]
    for chosen in sorted(sets, key=lambda c: sum(lost[jump] for jump in c))[:MOST_COMBINATIONS]:
        for last in chosen:  # from the others' mode on, whichever leads there
            parent = found.get(tuple(jump for jump in chosen if jump != last))
            start = None if parent is None else dict(climber.mode_candidates(parent.y)).get(last)
            end = None if start is None else climber.maximise(start, first.log_density - HOPELESS)
            if end is None or any(np.allclose(end[0], mode.y, rtol=0.0, atol=SAME) for mode in known):
                continue
            found[chosen] = _characterise(posterior, *end)
            known.append(found[chosen])
            break
    new = known[1 + len(modes) :]
    return [m for m in new if m.converged and m.log_evidence > first.log_evidence - WORTH_KEEPING]


def _match_jumps(climber: NewtonSearch, first: Mode, modes: list[Mode]) -> dict[int, Mode]:
    """Return of jumps from the first mode which of other modes they lead to; one alone has no other to combine with."""
    if len(modes) < 2:
        return {}
    matched: dict[int, Mode] = {}
    for jump, start in climber.mode_candidates(first.y):
        known = jump in climber.followed
        end = climber.followed[jump] if known else climber.maximise(start, first.log_density - HOPELESS)
        for mode in modes:
            if end is not None and np.allclose(mode.y, end[0], rtol=0.0, atol=SAME):
                matched[jump] = mode
    return matched


def _climb_scattered(climber: NewtonSearch, known: list[Climb], first: Mode, rng: np.random.Generator) -> list[Climb]:
    """Return where climbs from draws of the prior end that least squares do not lead to known modes.

    The draw's own model errors come first, large as they may be: a mode may need them to be in reach.
    """
    found: list[Climb] = []
    posterior = climber.posterior
    n, sd = posterior.n_geometry, np.sqrt(np.diag(first.covariance))
    for start in posterior.draw_prior(N_SCATTERED, rng):
        if not (np.isfinite(start).all() and np.isfinite(posterior.log_density(start[None])[0])):
            continue
        y = np.concatenate([posterior.refine_geometry(start)[:n], first.y[n:]])
        if not np.isfinite(posterior.log_density(y[None])[0]):
            continue  # a way that ends where the machine does not stand
        y = posterior.refine_geometry(y)
        if any(np.max(((y - mode[0]) / sd)[:n] ** 2, initial=0.0) < KNOWN for mode in (*known, *found)):
            continue
        if posterior.log_density(y[None])[0] < first.log_density - MAX_MODE_GAP_NAT:
            continue
        end = climber.maximise(y, first.log_density - HOPELESS)
        if end is None or any(np.allclose(end[0], mode[0], rtol=0.0, atol=SAME) for mode in (*known, *found)):
            continue
        found.append(end)
    return found


def _follow_jumps(climber: NewtonSearch, best: Climb, known: Sequence[Climb] = ()) -> tuple[Climb, list[Climb]]:
    """Return the best mode that jumps reach from one that was found, and the others known or seen on the way."""
    others = [climb for climb in known if climb is not best]
    came_from = -1
    while True:
        improved, climber.followed = False, {}
        for jump, start in climber.mode_candidates(best[0]):
            if jump == came_from:
                continue  # leads back
            other = climber.followed[jump] = climber.maximise(start, best[1] - HOPELESS)
            if other is None or any(np.allclose(other[0], known[0], rtol=0.0, atol=SAME) for known in (best, *others)):
                continue
            if other[1] > best[1]:
                best, other, improved, came_from = other, best, True, jump
            others.append(other)
        if not improved:
            return best, others


def revisit_modes(posterior: LogDensity, starts: Sequence[Array] | Array, known: Sequence[Mode] = ()) -> list[Mode]:
    """Return known modes and those that climbs from starts, each (n,), lead to, best first; those with mass alone.

    Raises
    ------
    NumericalError
        Where none is known and no start leads to one.
    """
    found = list(known)
    climber = NewtonSearch(posterior)
    for start in starts:
        end = climber.maximise(start)
        if end is None or any(np.allclose(end[0], mode.y, rtol=0.0, atol=SAME) for mode in found):
            continue
        found.append(_characterise(posterior, *end))
    if not found:
        raise NumericalError("mode search: no mode found")
    found.sort(key=lambda mode: -mode.log_evidence)
    return [
        m for m in found if m is found[0] or (m.converged and m.log_evidence > found[0].log_evidence - WORTH_KEEPING)
    ]


def find_mode(posterior: LogDensity, start: Array) -> Mode:
    """Climb to a mode from a start in sampling coordinates, shape (n,).

    Raises
    ------
    NumericalError
        Where the density is not finite at the start or the Hessian at the end is not that of a maximum.
    """
    return _characterise(posterior, *_climb(posterior, start))


def _climb(posterior: LogDensity, start: Array, floor: float = -np.inf) -> Climb:
    """Return a local maximum and its log-density: geometry by least squares, then everything by a trust region.

    A climb that is still below the floor after PATIENCE steps is given up where it is.
    """
    if not np.isfinite(posterior.log_density(start[None])[0]):
        raise NumericalError("mode search: the density is not finite at the start")
    if posterior.linear_geometry(start) is not None:
        return _climb_given_errors(posterior, start)
    y = posterior.refine_geometry(start)
    surface = _Surface(posterior)
    steps, last = 0, np.inf

    def give_up(intermediate_result: OptimizeResult) -> None:
        nonlocal steps, last
        value = float(intermediate_result.fun)
        gained, steps, last = last - value, steps + 1, value
        hopeless = steps >= PATIENCE and -value < floor
        if hopeless or surface.decrement(intermediate_result.x) < (STALLED if gained < NO_GAIN else TOP):
            raise StopIteration

    result = minimize(
        lambda x: min(-float(posterior.log_density(x[None])[0]), FAR_AWAY**2),
        y,
        jac=lambda x: -surface.at(x)[0],
        hess=lambda x: -surface.at(x)[1],
        method="trust-exact",
        callback=give_up,
        options={"gtol": GRADIENT_TOLERANCE, "maxiter": 200},
    )
    if not result.fun < FAR_AWAY**2:
        raise NumericalError("mode search: left the finite density")
    return result.x, float(-result.fun)


def _climb_given_errors(posterior: LogDensity, start: Array) -> Climb:
    """Return the geometry that is best at the errors that are most probable whatever the geometry, and the log-density.

    The joint mode of both is none of the errors' density. Geometry by Gauss and Newton's steps, halved where one leads
    down; errors by their density in closed form.
    """
    m, y = posterior.n_geometry, start.copy()
    for _ in range(MOST_STEPS):
        linear = posterior.linear_geometry(y)
        assert linear is not None
        y[m:] = find_scales_mode(linear.log_mass, y[m:])
        (mean,), (covariance,) = linear.given(y[None, m:])
        step, here = mean - y[:m], float(posterior.log_density(y[None])[0])
        for share in 0.5 ** np.arange(HALVINGS):
            there = np.append(y[:m] + share * step, y[m:])
            found = float(posterior.log_density(there[None])[0])
            if found > here - NO_GAIN:
                break
        else:
            break
        y = there
        if step @ np.linalg.solve(covariance, step) < DECREMENT_TOLERANCE:
            break
    return y, float(posterior.log_density(y[None])[0])


class _Surface:
    """Gradient and Hessian along a climb; those of the last two points are kept, as a step may be taken back."""

    def __init__(self, posterior: LogDensity) -> None:
        self._posterior = posterior
        self._known: dict[bytes, tuple[Array, Array]] = {}

    def at(self, x: Array) -> tuple[Array, Array]:
        """Return gradient (n,) and Hessian (n, n) at x, shape (n,)."""
        key = x.tobytes()
        if key not in self._known:
            while len(self._known) > 1:
                del self._known[next(iter(self._known))]
            gradient, hessian = self._posterior.newton(x)
            if not (np.isfinite(gradient).all() and np.isfinite(hessian).all()):
                raise NumericalError("mode search: zero gradient")
            self._known[key] = gradient, hessian
        return self._known[key]

    def decrement(self, x: Array) -> float:
        """Return twice what a Newton step from x, shape (n,), would gain; infinite where the density is not concave."""
        gradient, hessian = self.at(x)
        try:
            white = solve_triangular(cholesky(-hessian, lower=True), gradient, lower=True)
        except np.linalg.LinAlgError:
            return np.inf
        return float(white @ white)


def _characterise(posterior: LogDensity, y: Array, log_density: float) -> Mode:
    """Return the mode at y with its covariance; converged where a Newton step would gain next to nothing."""
    linear = posterior.linear_geometry(y)
    if linear is not None:
        m, covariance = posterior.n_geometry, np.eye(len(y))  # of errors their prior's: draws tell it better
        (mean,), (own,) = linear.given(y[None, m:])
        covariance[:m, :m], step = own, mean - y[:m]
        return Mode(y, log_density, covariance, bool(step @ np.linalg.solve(own, step) < SETTLED))
    gradient, curvature = posterior.gradient(y)
    factor, white = _factor_negative(posterior, y, curvature)
    converged = bool(np.sum((factor.T @ gradient) ** 2) < DECREMENT_TOLERANCE)
    mode = Mode(y, log_density, factor @ factor.T, converged)
    return mode if white @ white < DECREMENT_TOLERANCE else _settle(posterior, mode, factor, white)


def _settle(posterior: LogDensity, mode: Mode, factor: Array, slope: Array) -> Mode:
    """Return a mode after Newton's steps by differences: of a density that is solved they are the exacter slope.

    ``factor`` F (n, n), F Fᵀ the covariance, with the slope (n,) along its columns.
    """
    for _ in range(LAST_STEPS):
        y = mode.y + factor @ slope
        log_density = float(posterior.log_density(y[None])[0])
        if not log_density > mode.log_density + NO_GAIN:
            break
        mode, slope = Mode(y, log_density, mode.covariance, False), _difference_once(posterior, y, factor)
        if not np.isfinite(slope).all():
            break
        if slope @ slope < DECREMENT_TOLERANCE:
            return replace(mode, converged=True)
    return mode


def _difference_once(posterior: LogDensity, y: Array, factor: Array) -> Array:
    """Return the slope of the log-density at y (n,) along the columns of a factor (n, n), by differences."""
    steps = HESSIAN_STEP * factor.T
    ahead, behind = np.split(evaluate_in_batches(posterior.log_density, np.concatenate([y + steps, y - steps])), 2)
    return np.asarray((ahead - behind) / (2.0 * HESSIAN_STEP))


def _factor_negative(posterior: LogDensity, y: Array, curvature: Array) -> tuple[Array, Array]:
    """Return F, F Fᵀ the inverse of minus the Hessian, and the slope along its columns (n,), zero where it is unknown.

    F is that of Gauss and Newton's Hessian where the exact one is no maximum's.

    Raises
    ------
    NumericalError
        Where neither is.
    """
    found: tuple[Array, Array] | None
    try:
        factor = np.linalg.inv(np.linalg.cholesky(-curvature)).T
        found = factor, np.zeros(len(y))
    except np.linalg.LinAlgError:  # Gauss and Newton's may be none of a maximum where tails are heavy
        values, axes = np.linalg.eigh(-curvature)
        found = _differentiate(posterior, y, axes / np.sqrt(np.maximum(np.abs(values), LEAST_CURVATURE)))
    if found is None:
        raise NumericalError("mode search: Hessian not negative definite")
    return _differentiate(posterior, y, found[0]) or found


def _differentiate(posterior: LogDensity, y: Array, factor: Array) -> tuple[Array, Array] | None:
    """Return F with F Fᵀ the inverse of minus the Hessian and the slope along its columns, (n, n) and (n,).

    By differences along the columns of a factor (n, n); None at no maximum.
    """
    slope, hessian = difference_twice(posterior.log_density, y, factor, HESSIAN_STEP)
    try:
        inverse = np.linalg.inv(np.linalg.cholesky(-hessian))
    except np.linalg.LinAlgError:
        return None
    found = factor @ inverse.T
    return (found, inverse @ slope) if np.isfinite(found).all() else None
