"""The beam theory-based model: flexures whose centre of motion shifts as they bend (RR-8096 section 4.3).

Closure of leg i (eq. 32): f = l - l_b + Δl_A + Δl_B - |g|, where the displacements of eqs. (16) and (17) are
Δl = l_b / 2 · (-h c + sqrt(1 + 2 h + h² c²)) with h = 1 - 2 β and c the cosine between the leg and where it stood at
the home pose, seen from the base (A) or from the platform (B). Both are l_b / 2 for a straight flexure, so that the
model is the 6-PUS at home. Eq. (17) takes R z^0 as the direction carried by the platform; for a home pose that is not
level that is R R^0ᵀ z^0.

How the end of a bent flexure moves (figure 9): a beam of length l_b bent to a circular arc moves its end by Δy across
and by Δx along its axis (eqs. 11 and 12). An ideal pivot at half its length and the circle of eq. (13) are the two ways
to stand in for it.
"""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from bayescal.errors import InputError
from bayescal.machines.deformations import DeformationBasis
from bayescal.machines.mechanism import Flexures, Mechanism
from bayescal.machines.models.base import BoundClosure, Linearisation
from bayescal.machines.models.home import Home, HomeModel, home_solver
from bayescal.machines.models.legs import compute_leg_vectors, cross, dot
from bayescal.machines.models.six_pus import SixPus, SixPusClosure
from bayescal.machines.parameters import ParameterBlock, ParameterLayout
from bayescal.numerics.geometry import Array

SERIES_BELOW = 0.05  # rad; the closed form of eq. (12) cancels, the series is exact to 1e-13 of its value there
CIRCLE = 0.75  # radius of eq. (13) as a share of l_b
PIVOT = 0.5


def compute_beam_shift(angle: Array, length: float) -> tuple[Array, Array]:
    """Return Δx and Δy of eq. (12), mm, for bending angles δ in radians and a length l_b in mm, shapes of the angles.

    Below 0.05 rad Δx is summed as a series in δ², l_b (δ²/6 - δ⁴/40 + δ⁶/112 - 5 δ⁸/1152 + …).
    """
    square = angle * angle
    series = square * (1 / 6 - square * (1 / 40 - square * (1 / 112 - square * (5 / 1152 - square * 7 / 2816))))
    safe = np.maximum(np.abs(angle), SERIES_BELOW)
    closed = (safe * np.sqrt(1 + safe * safe) + np.arcsinh(safe)) / (2 * safe) - 1
    return length * np.where(np.abs(angle) < SERIES_BELOW, series, closed), 0.5 * length * angle


def compute_circle_shift(across: Array, radius: float) -> Array:
    """Return Δx of a point that moved by Δy on a circle about (radius, 0), mm."""
    square = across * across
    return square / (radius + np.sqrt(radius * radius - square))


def compute_shift(cosine: Array, flexure_length: Array, beta: Array) -> Array:
    """Return Δl of eqs. (16) and (17) in mm, all arguments broadcast."""
    h = 1.0 - 2.0 * beta
    return 0.5 * flexure_length * (np.sqrt(1.0 + 2.0 * h + (h * cosine) ** 2) - h * cosine)


def _differentiate_shift(cosine: Array, flexure_length: Array, beta: Array) -> tuple[Array, Array, Array]:
    """Return the derivatives of Δl by c, l_b and β."""
    h = 1.0 - 2.0 * beta
    root = np.sqrt(1.0 + 2.0 * h + (h * cosine) ** 2)
    half = 0.5 * flexure_length
    by_h = half * ((1.0 + h * cosine**2) / root - cosine)
    return half * h * (h * cosine / root - 1.0), 0.5 * (root - h * cosine), -2.0 * by_h


def require_flexures(mechanism: Mechanism, model: str) -> Flexures:
    """Return the mechanism's flexures; InputError where it has none."""
    if mechanism.flexures is None:
        raise InputError(f"mechanism {mechanism.name!r}: found no [flexures], expected them for {model}")
    return mechanism.flexures


class Beam(HomeModel):
    """P-U-S legs whose joints are flexures that bend as beams."""

    name: ClassVar[str] = "beam"
    title: ClassVar[str] = "beam"

    def blocks(self, mechanism: Mechanism) -> tuple[ParameterBlock, ...]:
        """Return the parameters of the 6-PUS, then l_b and β of each leg."""
        flexures = require_flexures(mechanism, self.name)
        return (
            *SixPus().blocks(mechanism),
            ParameterBlock("l_b", tuple(flexures.lengths.tolist()), lower=0.0),
            ParameterBlock("beta", tuple(flexures.beta.tolist()), "1", lower=0.0, upper=0.5),
        )

    def _close(
        self,
        layout: ParameterLayout,
        theta: Array,
        home: Home,
        position: Array,
        rotation: Array,
        basis: DeformationBasis,
        with_parameters: bool = True,
    ) -> Linearisation:
        """Return eq. (32) and its exact derivatives; see `Closure` for shapes and frames."""
        legs = compute_leg_vectors(layout, theta, position, rotation, basis)
        flexure_length, beta = layout.take(theta, "l_b"), layout.take(theta, "beta")
        carried = rotation @ np.swapaxes(home.rotation, -1, -2)
        start_a = np.broadcast_to(home.legs.axis, legs.axis.shape)
        start_b = start_a @ np.swapaxes(carried, -1, -2)
        cosine_a, cosine_b = dot(legs.axis, start_a), dot(legs.axis, start_b)
        shift_a, shift_b = (compute_shift(c, flexure_length, beta) for c in (cosine_a, cosine_b))
        slope_a, a_by_length, a_by_beta = _differentiate_shift(cosine_a, flexure_length, beta)
        slope_b, b_by_length, b_by_beta = _differentiate_shift(cosine_b, flexure_length, beta)
        residual = layout.take(theta, "l") - flexure_length + shift_a + shift_b - legs.length
        # through the leg's direction
        toward = slope_a[..., None] * start_a + slope_b[..., None] * start_b
        across = toward - dot(toward, legs.axis)[..., None] * legs.axis
        back = legs.pull_back(across / legs.length[..., None] - legs.axis, with_parameters)
        pose = back.pose
        pose[..., 3:] += slope_b[..., None] * cross(start_b, legs.axis)
        if not with_parameters:
            return Linearisation(residual, pose, back.actuators)
        # through the home pose
        seen = legs.axis @ carried  # the leg as the platform carried z^0 sees it
        toward = slope_a[..., None] * legs.axis + slope_b[..., None] * seen
        across = toward - dot(toward, start_a)[..., None] * start_a
        home_turn = np.concatenate([np.zeros_like(toward), -slope_b[..., None] * cross(start_a, seen)], axis=-1)
        columns = back.columns | {
            "l": np.ones_like(legs.length),
            "l_b": a_by_length + b_by_length - 1.0,
            "beta": a_by_beta + b_by_beta,
        }
        parameters = home.pull_back(across / home.legs.length[..., None], home_turn, columns)
        return Linearisation(residual, pose, back.actuators, parameters)

    def bind(self, layout: ParameterLayout, position: Array, rotation: Array, basis: DeformationBasis) -> BoundClosure:
        """Return the 6-PUS closure with the shifts added."""
        return BeamClosure(layout, position, rotation, basis)


class BeamClosure(SixPusClosure):
    """The 6-PUS closure plus Δl_A + Δl_B - l_b; its pose derivative leaves out the shifts', a part in 10⁴."""

    def __init__(self, layout: ParameterLayout, position: Array, rotation: Array, basis: DeformationBasis) -> None:
        super().__init__(layout, position, rotation, basis)
        self._homes = home_solver(layout)
        self._rotation = np.ascontiguousarray(rotation.transpose(1, 0, 2))[:, None]  # component, leg, pose, entry

    def evaluate(self, theta: Array) -> Array:
        """Return f, shape (N, P, B)."""
        home = self._homes.solve(theta)
        parameters, index = np.ascontiguousarray(theta.T), self._layout.index
        length, flexure_length, beta = (parameters[index[symbol]] for symbol in ("l", "l_b", "beta"))
        carried = self._measure(theta)  # the lever arms, not needed any more
        vector, cosine = self._slope[:3], self._take("cosine")
        h = 1.0 - 2.0 * beta
        start = home.vector * (-h / home.length)  # -h z^0, as the slope holds -g
        own = np.einsum("mkb,mib->ikb", home.rotation, start)  # in the platform's frame
        result = np.subtract((length - flexure_length)[:, None], self._length, out=self._take("closure"))
        np.einsum("kipb,kib->ipb", vector, start, out=cosine)
        self._add_shift(result, cosine, h, flexure_length)
        np.matmul(self._rotation, own, out=carried)
        np.einsum("kipb,kipb->ipb", vector, carried, out=cosine)
        self._add_shift(result, cosine, h, flexure_length)
        return result

    def _add_shift(self, result: Array, cosine: Array, h: Array, flexure_length: Array) -> None:
        """Add a flexure's Δl; ``cosine`` holds h c |g| and is overwritten."""
        cosine /= self._length
        shift = np.multiply(cosine, cosine, out=self._take("work"))
        shift += (1.0 + 2.0 * h)[:, None]
        np.sqrt(shift, out=shift)
        shift -= cosine
        shift *= (0.5 * flexure_length)[:, None]
        result += shift
