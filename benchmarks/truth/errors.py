"""What machines err by and no model states: of each actuator, at each row of a table.

Each is a function of (machine, poses (P, q), random generator) and returns errors (P, N) of any size; they are scaled
afterwards so that their rms about each actuator's mean is what is asked for. Rows are in measuring order.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from benchmarks.truth.machines import STEP, Array, Simulated, difference

type Shape = Callable[[Simulated, Array, np.random.Generator], Array]


def err_by_lead(machine: Simulated, v: Array, rng: np.random.Generator) -> Array:
    """Return each actuator's own scale times its travel."""
    travel = machine.travel(v)
    return travel * rng.standard_normal(travel.shape[1])


def err_across(machine: Simulated, v: Array, rng: np.random.Generator) -> Array:
    """Return a random matrix times the travels: every actuator moves every leg."""
    travel = machine.travel(v)
    return travel @ rng.standard_normal((travel.shape[1],) * 2)


def err_by_slopes(machine: Simulated, v: Array, rng: np.random.Generator) -> Array:
    """Return each actuator's own scale above home and another below it."""
    travel = machine.travel(v)
    above, below = rng.standard_normal((2, travel.shape[1]))
    return np.where(travel > 0.0, above, below) * travel


def err_in_joints(machine: Simulated, v: Array, rng: np.random.Generator) -> Array:
    """Return squares of the tilt, each actuator with its own coefficients."""
    tilt = machine.tilt(v)
    squares = np.stack([tilt[:, 0] ** 2, tilt[:, 1] ** 2, tilt[:, 0] * tilt[:, 1]], axis=-1)
    return squares @ rng.standard_normal((3, machine.n_actuators))


def err_in_waves(machine: Simulated, v: Array, rng: np.random.Generator) -> Array:
    """Return a sinusoid of each actuator's travel, one or two whole travels long."""
    return _wave(machine.travel(v), rng, 1.0, 2.0)


def err_periodically(machine: Simulated, v: Array, rng: np.random.Generator) -> Array:
    """Return a sinusoid of each actuator's travel, several periods in a travel."""
    return _wave(machine.travel(v), rng, 0.12, 0.2)


def _wave(travel: Array, rng: np.random.Generator, shortest: float, longest: float) -> Array:
    n = travel.shape[1]
    length = np.ptp(travel, axis=0) * rng.uniform(shortest, longest, n)  # in whole travels
    return np.sin(2.0 * np.pi * (travel / length + rng.random(n))) * rng.uniform(0.5, 1.5, n)


def err_by_gravity(machine: Simulated, v: Array, rng: np.random.Generator) -> Array:
    """Return one function of the pose, linear and quadratic, in all actuators with the same sign."""
    place = machine.place(v)
    linear, square = rng.standard_normal((2, place.shape[1]))
    sag = place @ linear + 0.5 * place**2 @ square
    return sag[:, None] * rng.uniform(0.5, 1.5, machine.n_actuators)


def err_cubically(machine: Simulated, v: Array, rng: np.random.Generator) -> Array:
    """Return the cube of each actuator's travel."""
    travel = machine.travel(v)
    return travel**3 * rng.standard_normal(travel.shape[1])


def err_with_time(machine: Simulated, v: Array, rng: np.random.Generator) -> Array:
    """Return a ramp and a random walk over the session, each actuator with its own."""
    n = machine.n_actuators
    ramp = np.linspace(0.0, 1.0, len(v))[:, None] * rng.standard_normal(n)
    return ramp + np.cumsum(rng.standard_normal((len(v), n)), axis=0) / np.sqrt(len(v))


def err_by_backlash(machine: Simulated, v: Array, rng: np.random.Generator) -> Array:
    """Return each actuator's own play, with the sign of its last move."""
    travel = machine.travel(v)
    moved = np.sign(np.diff(travel, axis=0, prepend=np.zeros((1, travel.shape[1]))))
    return moved * rng.uniform(0.5, 1.5, travel.shape[1])


def err_after_homing(machine: Simulated, v: Array, rng: np.random.Generator) -> Array:
    """Return offsets that are others after a row somewhere in the middle: the machine was homed again."""
    later = np.arange(len(v)) >= int(len(v) * rng.uniform(0.3, 0.7))
    return later[:, None] * rng.standard_normal(machine.n_actuators)


def err_in_one(machine: Simulated, v: Array, rng: np.random.Generator) -> Array:
    """Return a slope and a square of the travel of one actuator; the others have none."""
    travel, one = machine.travel(v), rng.integers(machine.n_actuators)
    found = np.zeros((len(v), machine.n_actuators))
    found[:, one] = travel[:, one] + rng.standard_normal() * travel[:, one] ** 2
    return found


def err_within_geometry(machine: Simulated, v: Array, rng: np.random.Generator) -> Array:
    """Return what other parameters within the tolerances make of lead, coupling and joints: nothing else shows it.

    It is about each actuator's mean: an offset of it is nothing that depends on the pose.
    """
    true, n = machine.nominal if machine.true is None else machine.true, machine.n_actuators
    rms = 1e-3 * BASE_UM
    drawn = sum(scale(one(machine, v, rng), rms) for one in (err_by_lead, err_across, err_in_joints)) / machine.lever
    by_theta = difference(lambda one: machine.read(one, v)[:, :n], true, STEP * machine.sd) * machine.sd
    rows = (by_theta / machine.noise[:n, None]).reshape(-1, true.size)
    step = np.linalg.solve(rows.T @ rows + np.eye(true.size), rows.T @ (drawn / machine.noise[:n]).ravel())
    found = by_theta @ step * machine.lever
    return np.asarray(found - found.mean(axis=0))


SHAPES: dict[str, Shape] = {
    "lead": err_by_lead,
    "cross": err_across,
    "slopes": err_by_slopes,
    "joint": err_in_joints,
    "wave": err_in_waves,
    "periodic": err_periodically,
    "gravity": err_by_gravity,
    "cubic": err_cubically,
    "thermal": err_with_time,
    "backlash": err_by_backlash,
    "homing": err_after_homing,
    "one": err_in_one,
    "absorbed": err_within_geometry,
}
NONE, INSTRUMENT, MATRIX = "none", "instrument", "matrix"
ROWS = (NONE, *SHAPES, INSTRUMENT, MATRIX)
BASE_UM = 15.0
"""What ×1 is: rms of an actuator's error about its mean, at the tool."""
# RR-8096 eq. 4, deflection of joint i per displacement of actuator j
COUPLING = 1e-3 * np.array(
    [
        *([16, 0, -8, 12, -2, -20], [0, 20, -17, -1, 13, -13], [-2, -15, 14, 2, -9, 9]),
        *([6, -12, 4, 14, -16, 2], [-12, 7, 0, -15, 14, 4], [-20, -1, 10, -10, 2, 19]),
    ]
)


def scale(errors: Array, rms: float) -> Array:
    """Return errors (P, N) whose rms about each column's mean, over all columns, is as asked for."""
    return errors * rms / np.sqrt(np.mean((errors - errors.mean(axis=0)) ** 2))


def distort(machine: Simulated, row: str, size: float, exact: Array, v: Array, rng: np.random.Generator) -> Array:
    """Return noise-free channels (P, m) with an error of ``size`` times the base amplitude; not of eq. 4."""
    found, rms = exact.copy(), 1e-3 * BASE_UM * size
    if row in SHAPES:
        found[:, : machine.n_actuators] += scale(SHAPES[row](machine, v, rng), rms) / machine.lever
    elif row == INSTRUMENT:  # its scale is wrong, and the wrong way round in half of the twins
        lengths = exact[:, machine.seen] - exact[:, machine.seen].mean(axis=0)
        found[:, machine.seen] += rng.choice([-1.0, 1.0]) * scale(lengths, rms)
    return found
