"""What machines err by and no model states: of each actuator, at each row of a table.

Each shape is a function of (machine, poses (P, q), random generator) that draws coefficients and returns errors (P', N)
of any size as a function of poses (P', q) in measuring order. They are scaled so that their rms about each actuator's
mean, over the poses P, is what is asked for. Measured again, a machine errs by the same function; what hangs on time
and not on the pose is drawn independently at every call.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from benchmarks.truth.simulated import STEP, Array, Simulated, difference

type Error = Callable[[Array], Array]
type Shape = Callable[[Simulated, Array, np.random.Generator], Error]


def err_by_lead(machine: Simulated, v: Array, rng: np.random.Generator) -> Error:
    """Return each actuator's own scale times its travel."""
    scale = rng.standard_normal(machine.n_actuators)
    return lambda v: machine.travel(v) * scale


def err_across(machine: Simulated, v: Array, rng: np.random.Generator) -> Error:
    """Return a random matrix times the travels: every actuator moves every leg."""
    matrix = rng.standard_normal((machine.n_actuators,) * 2)
    return lambda v: machine.travel(v) @ matrix


def err_by_slopes(machine: Simulated, v: Array, rng: np.random.Generator) -> Error:
    """Return each actuator's own scale above home and another below it."""
    above, below = rng.standard_normal((2, machine.n_actuators))
    return lambda v: np.where((travel := machine.travel(v)) > 0.0, above, below) * travel


def err_in_joints(machine: Simulated, v: Array, rng: np.random.Generator) -> Error:
    """Return squares of the tilt, each actuator with its own coefficients."""
    weights = rng.standard_normal((3, machine.n_actuators))

    def error(v: Array) -> Array:
        tilt = machine.tilt(v)
        return np.stack([tilt[:, 0] ** 2, tilt[:, 1] ** 2, tilt[:, 0] * tilt[:, 1]], axis=-1) @ weights

    return error


def err_in_waves(machine: Simulated, v: Array, rng: np.random.Generator) -> Error:
    """Return a sinusoid of each actuator's travel, one or two whole travels long."""
    return _wave(machine, v, rng, 1.0, 2.0)


def err_periodically(machine: Simulated, v: Array, rng: np.random.Generator) -> Error:
    """Return a sinusoid of each actuator's travel, several periods in a travel."""
    return _wave(machine, v, rng, 0.12, 0.2)


def _wave(machine: Simulated, v: Array, rng: np.random.Generator, shortest: float, longest: float) -> Error:
    n = machine.n_actuators
    length = np.ptp(machine.travel(v), axis=0) * rng.uniform(shortest, longest, n)  # in whole travels
    phase, size = rng.random(n), rng.uniform(0.5, 1.5, n)
    return lambda v: np.sin(2.0 * np.pi * (machine.travel(v) / length + phase)) * size


def err_by_gravity(machine: Simulated, v: Array, rng: np.random.Generator) -> Error:
    """Return one function of the pose, linear and quadratic, in all actuators with the same sign."""
    linear, square = rng.standard_normal((2, machine.place(v).shape[1]))
    weights = rng.uniform(0.5, 1.5, machine.n_actuators)

    def error(v: Array) -> Array:
        place = machine.place(v)
        return (place @ linear + 0.5 * place**2 @ square)[:, None] * weights

    return error


def err_cubically(machine: Simulated, v: Array, rng: np.random.Generator) -> Error:
    """Return the cube of each actuator's travel."""
    scale = rng.standard_normal(machine.n_actuators)
    return lambda v: machine.travel(v) ** 3 * scale


def err_with_time(machine: Simulated, v: Array, rng: np.random.Generator) -> Error:
    """Return a ramp and a random walk over the session, each actuator with its own."""
    n = machine.n_actuators

    def error(v: Array) -> Array:
        ramp = np.linspace(0.0, 1.0, len(v))[:, None] * rng.standard_normal(n)
        return ramp + np.cumsum(rng.standard_normal((len(v), n)), axis=0) / np.sqrt(len(v))

    return error


def err_by_backlash(machine: Simulated, v: Array, rng: np.random.Generator) -> Error:
    """Return each actuator's own play, with the sign of its last move."""
    n = machine.n_actuators
    play = rng.uniform(0.5, 1.5, n)
    return lambda v: np.sign(np.diff(machine.travel(v), axis=0, prepend=np.zeros((1, n)))) * play


def err_after_homing(machine: Simulated, v: Array, rng: np.random.Generator) -> Error:
    """Return offsets that are others after a row somewhere in the middle: the machine was homed again."""

    def error(v: Array) -> Array:
        later = np.arange(len(v)) >= int(len(v) * rng.uniform(0.3, 0.7))
        return later[:, None] * rng.standard_normal(machine.n_actuators)

    return error


def err_in_one(machine: Simulated, v: Array, rng: np.random.Generator) -> Error:
    """Return a slope and a square of the travel of one actuator; the others have none."""
    one, square = rng.integers(machine.n_actuators), rng.standard_normal()

    def error(v: Array) -> Array:
        travel = machine.travel(v)
        return np.where(np.arange(machine.n_actuators) == one, travel + square * travel**2, 0.0)

    return error


def err_within_geometry(machine: Simulated, v: Array, rng: np.random.Generator) -> Error:
    """Return what other parameters within the tolerances make of lead, coupling and joints: nothing else shows it.

    It is about each actuator's mean: an offset of it is nothing that depends on the pose.
    """
    true, n = machine.nominal if machine.true is None else machine.true, machine.n_actuators
    parts = (scale(one(machine, v, rng)(v), 1e-3 * BASE_UM) for one in (err_by_lead, err_across, err_in_joints))

    def differ(v: Array) -> Array:
        return difference(lambda one: machine.read(one, v)[:, :n], true, STEP * machine.sd) * machine.sd

    drawn, by_theta = sum(parts) / machine.lever, differ(v)
    rows = (by_theta / machine.noise[:n, None]).reshape(-1, true.size)
    step = np.linalg.solve(rows.T @ rows + np.eye(true.size), rows.T @ (drawn / machine.noise[:n]).ravel())
    mean = (by_theta @ step).mean(axis=0)
    return lambda v: (differ(v) @ step - mean) * machine.lever


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


def plant(shape: Shape, rms: float, machine: Simulated, v: Array, rng: np.random.Generator) -> tuple[Array, Error]:
    """Return errors (P, N) of a size at poses (P, q), and what they are at others, mm at the tool."""
    error = shape(machine, v, rng)
    first = error(v)
    scaled = scale(first, rms)
    most = np.argmax(np.abs(first))
    factor = scaled.flat[most] / first.flat[most]
    return scaled, lambda v: factor * error(v)


def distort(
    machine: Simulated, row: str, size: float, exact: Array, v: Array, rng: np.random.Generator
) -> tuple[Array, Error]:
    """Return noise-free channels (P, m) with an error of ``size`` times the base amplitude; not of eq. 4.

    Beside these what actuators err by at other poses, in their own units.
    """
    found, rms = exact.copy(), 1e-3 * BASE_UM * size
    if row in SHAPES:
        errors, error = plant(SHAPES[row], rms, machine, v, rng)
        found[:, : machine.n_actuators] += errors / machine.lever
        return found, lambda v: error(v) / machine.lever
    if row == INSTRUMENT:  # its scale is wrong, and the wrong way round in half of the twins
        lengths = exact[:, machine.seen] - exact[:, machine.seen].mean(axis=0)
        found[:, machine.seen] += rng.choice([-1.0, 1.0]) * scale(lengths, rms)
    return found, lambda v: np.zeros((len(v), machine.n_actuators))
