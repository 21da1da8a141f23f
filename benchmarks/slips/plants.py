"""Slips as they happen to tables of readings (P, K), mm and rad, each planted in simulated ones.

A plant returns the readings with a slip, the fault that has to be named, and words of which one has to stand in the
sentence that names it: channels, a row, a parameter. Poses of points and targets are planted as poses.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from bayescal.experiments.selftest.inputs import TestedVariant
from bayescal.numerics.geometry import Array

SHIFT_MM, TURN_DEG = 1.0, 0.3  # of a frame
BEYOND = 2.0  # tolerances of the machine's places, where these are coarser: a frame within them is no slip
NOISE = 5.0
TOLERANCES = 8.0
DRIFT = 25.0  # in the stated noise, from the first to the last row
OFFSET = {"mm": 3.0, "rad": 0.02}  # or as many times the noise as LOUD says
LOUD = 100.0
SCALE = 0.02
NOTHING = -9.0  # coordinate of an error's size at which there is none

type Planted = tuple[Array, str, tuple[str, ...]]
"""Readings, fault, words."""


def simulate(subject: TestedVariant, rng: np.random.Generator, noise: Array | float = 1.0) -> Array:
    """Return readings of a machine of the priors whose noise is so many times the stated one."""
    posterior = subject.measured.posterior
    likelihood = posterior.likelihood
    loud = replace(likelihood, data=replace(likelihood.data, sd=likelihood.data.sd * noise), expansion=None)
    noisy = TestedVariant(replace(subject.measured, posterior=replace(posterior, likelihood=loud)))
    for _ in range(100):
        found = noisy.simulate(draw_machine(subject, rng), rng)
        if found is not None:
            return found
    raise RuntimeError("found no machine that takes the poses")


def draw_machine(subject: TestedVariant, rng: np.random.Generator) -> Array:
    """Return a machine of the priors (n,) whose model does not err."""
    y = subject.posterior.draw_prior(1, rng)[0]
    y[[name.startswith(("sigma_", "tau")) for name in subject.posterior.names]] = NOTHING
    return y


def _channels(subject: TestedVariant) -> tuple[list[str], list[str], np.ndarray]:
    model = subject.measured.posterior.likelihood.model
    return list(model.names), [one.unit for one in model.channels], subject.measured.internal


def frame(subject: TestedVariant, rng: np.random.Generator) -> Planted:
    """Plant an instrument in a frame that is off, or a probe on the tool."""
    values, (_, units, internal) = simulate(subject, rng), _channels(subject)
    places = [k for k in np.flatnonzero(~internal) if units[k] == "mm"]
    turned = [k for k in np.flatnonzero(~internal) if units[k] == "rad"]
    move, axis = rng.standard_normal(3), rng.standard_normal(3)
    posterior = subject.posterior
    lengths = np.array(posterior.units[: posterior.n_geometry]) == "mm"
    times = max(1.0, BEYOND * float(np.median(posterior.prior_sd[: posterior.n_geometry][lengths])) / SHIFT_MM)
    move *= times * SHIFT_MM / np.linalg.norm(move)
    turn = Rotation.from_rotvec(np.radians(times * TURN_DEG) * axis / np.linalg.norm(axis))
    position = values[:, places]
    moved = values.copy()
    if len(turned) == 3 and rng.random() < 0.5:  # the tool's
        now = Rotation.from_rotvec(values[:, turned])
        moved[:, places], moved[:, turned] = position + now.apply(move), (now * turn).as_rotvec()
    else:
        moved[:, places] = turn.apply(position) + move
        if len(turned) == 3:
            moved[:, turned] = (turn * Rotation.from_rotvec(values[:, turned])).as_rotvec()
    return moved, "frame", ("frame",)


LENGTHS = (1e-3, 1e3, 0.1, 10.0, 1.0 / 25.4)  # metres, µm, cm, mm for cm, inches
ANGLES = (float(np.degrees(1.0)), float(np.radians(1.0)), 1e3)


def unit(subject: TestedVariant, rng: np.random.Generator) -> Planted:
    """Plant columns in another unit, one of them alone, or displacements from home instead of positions."""
    values, (names, units, internal) = simulate(subject, rng), _channels(subject)
    groups = [
        np.flatnonzero([(one == other) and inside == own for other, inside in zip(units, internal, strict=True)])
        for one, own in dict.fromkeys(zip(units, internal.tolist(), strict=True))
    ]
    some, moved = groups[rng.integers(len(groups))], values.copy()
    home = subject.measured.readings.home[some]
    if internal[some[0]] and np.abs(home).max() > 0.0 and rng.random() < 1 / 3:
        moved[:, some] -= home
        return moved, "unit", tuple({names[k].partition("[")[0] for k in some})
    if rng.random() < 1 / 3:
        some = some[[rng.integers(len(some))]]
    factor = float(rng.choice(LENGTHS if units[some[0]] == "mm" else ANGLES))
    moved[:, some] *= factor
    return moved, "unit", tuple({names[k].partition("[")[0] for k in some})


def sign(subject: TestedVariant, rng: np.random.Generator) -> Planted:
    """Plant a channel of the other sign."""
    values, (names, _, _) = simulate(subject, rng), _channels(subject)
    k = rng.integers(len(names))
    moved = values.copy()
    moved[:, k] *= -1.0
    return moved, "unit channel", (names[k],)  # or -1 times what the others say


def exchanged(subject: TestedVariant, rng: np.random.Generator) -> Planted:
    """Plant two channels of one unit exchanged, or legs numbered the other way round or from another one."""
    values, (names, units, internal) = simulate(subject, rng), _channels(subject)
    moved, own = values.copy(), np.flatnonzero(internal)
    kind = rng.integers(3)
    if kind == 0 or len(own) < 3:
        pairs = [(a, b) for a in range(len(names)) for b in range(a)]
        pairs = [(a, b) for a, b in pairs if units[a] == units[b] and internal[a] == internal[b]]
        a, b = pairs[rng.integers(len(pairs))]
        moved[:, [a, b]] = values[:, [b, a]]
        return moved, "legs", (f"{names[b]} and {names[a]}",)
    if kind == 1:
        moved[:, own] = values[:, own[::-1]]
        return moved, "legs", ("the other way round", f"{names[own[0]]} and {names[own[-1]]}")
    moved[:, own] = np.roll(values[:, own], int(rng.integers(1, len(own))), axis=1)
    return moved, "legs", ("counted from leg",)


def poses(subject: TestedVariant, rng: np.random.Generator) -> Planted:
    """Plant poses that were read in another way: angles for vectors, the base seen from the platform, a mirror."""
    values, (names, units, internal) = simulate(subject, rng), _channels(subject)
    lengths = [k for k in np.flatnonzero(~internal) if units[k] == "mm"]
    turned = [k for k in np.flatnonzero(~internal) if units[k] == "rad"]
    moved, kind = values.copy(), rng.integers(4)
    if len(lengths) != 3 or len(turned) != 3:  # a position alone
        k = lengths[rng.integers(len(lengths))]
        moved[:, k] *= -1.0
        return moved, "unit", (names[k],)
    if kind == 0:
        moved[:, turned] = Rotation.from_rotvec(values[:, turned]).as_euler("xyz")
        return moved, "poses", ("no rotation vectors but angles",)
    if kind == 1:
        moved[:, turned] *= -1.0
        return moved, "poses unit", ("the other way round", "inverted")
    if kind == 2:
        back = Rotation.from_rotvec(-values[:, turned])
        moved[:, turned], moved[:, lengths] = -values[:, turned], -back.apply(values[:, lengths])
        return moved, "poses", ("those of the base in the platform's frame",)
    k = rng.integers(3)
    moved[:, lengths[k]] *= -1.0
    moved[:, [turned[one] for one in range(3) if one != k]] *= -1.0
    return moved, "poses", ("left-handed",)


def noise(subject: TestedVariant, rng: np.random.Generator) -> Planted:
    """Make the instrument, or all channels, five times as noisy as stated, or as quiet."""
    _, _, internal = _channels(subject)
    factor = NOISE if rng.random() < 0.5 else 1.0 / NOISE
    loud = np.where(~internal | (rng.random() < 0.5), factor, 1.0)
    return simulate(subject, rng, loud), "noise", ("noise",)


def row(subject: TestedVariant, rng: np.random.Generator) -> Planted:
    """Plant a row whose commands belong to another pose, rows shifted by one from some place on, or all of them."""
    values, (_, _, internal) = simulate(subject, rng), _channels(subject)
    n = len(values)
    moved, own = values.copy(), np.flatnonzero(internal)
    kind = rng.integers(3)
    if kind == 0:
        moved[:, own] = np.roll(values[:, own], int(rng.choice([-1, 1])), axis=0)
        return moved, "rows", ("shifted by one",)
    if kind == 1:
        k, other = rng.choice(n, 2, replace=False)
        moved[k, own] = values[other, own]
        return moved, "rows", (f"row {k + 1} ",)
    start = int(rng.integers(2, n - 3))
    moved[start:, own] = values[start - 1 : -1, own]
    return moved, "rows", ("shifted by one",)


def sensor(subject: TestedVariant, rng: np.random.Generator) -> Planted:
    """Plant a channel that is frozen, scaled or shifted."""
    values, (names, units, _) = simulate(subject, rng), _channels(subject)
    k, kind = rng.integers(len(names)), rng.integers(3)
    moved = values.copy()
    if kind == 0:
        moved[:, k] = values[0, k]
    elif kind == 1:
        moved[:, k] *= 1.0 + rng.choice([-1.0, 1.0]) * SCALE
    else:
        sd = float(subject.measured.posterior.likelihood.data.sd[0, k])
        moved[:, k] += rng.choice([-1.0, 1.0]) * max(OFFSET[units[k]], LOUD * sd)
    return moved, "channel", (names[k],)


def tolerance(subject: TestedVariant, rng: np.random.Generator) -> Planted:
    """Plant a parameter eight of its tolerances off, of machines that take the poses all the same."""
    posterior = subject.posterior
    for _ in range(100):
        y, k = draw_machine(subject, rng), int(rng.integers(posterior.n_geometry))
        own, prior = posterior.natural(y[None])[0], posterior.priors[posterior.names[k]]
        wanted = prior.mean + rng.choice([-1.0, 1.0]) * TOLERANCES * prior.sd
        values = subject.simulate(_solve(posterior, y, k, wanted - own[k]), rng)
        if values is not None:
            return values, "tolerance", (posterior.names[k],)
    raise RuntimeError("found no machine that takes the poses")


def _solve(posterior: object, y: Array, k: int, move: float) -> Array:
    """Return coordinates whose natural parameter k is moved, all others as they are."""
    theta = posterior.theta(y[None])[0]  # type: ignore[attr-defined]
    theta[posterior.sampling.layout.names.index(posterior.names[k])] += move  # type: ignore[attr-defined]
    return posterior.to_coordinates(theta[None], y[None, posterior.n_geometry :])[0]  # type: ignore[attr-defined]


def drift(subject: TestedVariant, rng: np.random.Generator) -> Planted:
    """Plant a channel that drifts while the rows are measured."""
    values, (names, _, _) = simulate(subject, rng), _channels(subject)
    k = rng.integers(len(names))
    sd = subject.measured.posterior.likelihood.data.sd[:, k]
    moved = values.copy()
    moved[:, k] += rng.choice([-1.0, 1.0]) * DRIFT * sd * np.linspace(0.0, 1.0, len(values))
    return moved, "drift", (names[k].partition("[")[0], "frame")


def erring(subject: TestedVariant, rng: np.random.Generator) -> Planted:
    """Plant nothing, but let the machine err by what no model states: 10 or 50 µm rms at the tool, with the travel.

    A random matrix times the travel of the machine's own channels, as eq. 4 of RR-8096 has K.
    """
    values, (_, units, internal) = simulate(subject, rng), _channels(subject)
    own = np.flatnonzero(internal)
    reach = np.ptp(values[:, [k for k in np.flatnonzero(~internal) if units[k] == "mm"]], axis=0).max()
    travel = (values[:, own] - values[:, own].mean(axis=0)) / np.ptp(values[:, own], axis=0)
    error = travel @ rng.standard_normal((len(own), len(own)))
    error *= 1e-3 * float(rng.choice([10.0, 50.0])) / reach / np.sqrt(np.mean(error**2, axis=0))
    moved = values.copy()
    moved[:, own] += error * np.ptp(values[:, own], axis=0)
    return moved, "", ()


def clean(subject: TestedVariant, rng: np.random.Generator) -> Planted:
    """Plant nothing."""
    return simulate(subject, rng), "", ()


PLANTS: dict[str, Callable[[TestedVariant, np.random.Generator], Planted]] = {
    one.__name__: one
    for one in (clean, erring, frame, unit, sign, exchanged, poses, row, sensor, noise, tolerance, drift)
}
