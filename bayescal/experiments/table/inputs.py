"""What a table is computed with: a study's variant, the places of the table, the pose; how these respond."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import product
from pathlib import Path

import numpy as np

from bayescal.density.calibration.likelihood import CalibrationPosterior
from bayescal.density.calibration.measurements import Comparison
from bayescal.density.elimination import RANK
from bayescal.errors import InputError, name_faults, say_unknown
from bayescal.experiments.runner.load import load
from bayescal.experiments.shared.measured import choose_variant
from bayescal.experiments.shared.readings.inputs import ReadingInputs, Variant, read_inputs
from bayescal.experiments.shared.readings.knowledge import look
from bayescal.experiments.shared.slip_search import find_slip
from bayescal.experiments.shared.slips import FoundSlip
from bayescal.experiments.shared.study_schema import StudyConfig
from bayescal.experiments.table.schema import TableConfig
from bayescal.machines.readings import Given, ReadingModel
from bayescal.numerics.geometry import Array
from bayescal.numerics.units import Units
from bayescal.pose_selection.next_pose import add_poses, learn_in_turn

STEPS = 8  # of Newton's method; two do for displacements of micrometres
ARRIVED = 1e-10  # of the workspace's half widths
BATCH = 4096  # poses of machines at once
DEGREES = "_deg"
RANDOM_SETS = 20  # of as many measurements, to compare with


@dataclass(frozen=True, eq=False)
class TableInputs:
    """A look-up table, read."""

    config: TableConfig
    study: ReadingInputs  # with the one variant that the table is made of
    cells: Array  # (G, A), the places of the table, its axes in their order, the last one fastest
    reference: dict[str, float]  # of everything that the machine has to know of a pose
    pose: Array  # (q,), the commanded one, mm and rad

    @property
    def variant(self) -> Variant:
        """The variant that the table is made of."""
        return next(iter(self.study.variants.values()))

    @cached_property
    def slip(self) -> FoundSlip | None:
        """What may have happened to readings that no machine within its priors comes near, looked for once."""
        return find_slip([self.variant.list_readings()], self.study.config.ignored_data_errors)

    @cached_property
    def actuators(self) -> ReadingModel:
        """The machine with its own channels alone, n of them."""
        own = [one.name for one in self.variant.model.channels if not one.external]
        return self.variant.whole.pick(self.variant.whole.select(own))

    @property
    def zero(self) -> Given:
        """What the machine has to know at the reference."""
        return {name: np.array(value) for name, value in self.reference.items()}

    def given_at(self, cells: Array) -> Given:
        """Return what the machine has to know at places (..., A)."""
        axes = list(self.config.axes)
        shape = cells.shape[:-1]
        return {
            name: cells[..., axes.index(name)] if name in axes else np.full(shape, value)
            for name, value in self.reference.items()
        }


def read_table(config: TableConfig, folder: Path) -> TableInputs:
    """Return a table, read.

    InputError where the file is no study of readings, an axis is no column that its machine has to know or its values
    cannot be, a coordinate is unknown, or the actuators do not tell the pose.
    """
    path = folder / config.study
    study = _read_study(config, path)
    variant = next(iter(study.variants.values()))
    reference = _check_reference(config, variant)
    cells = np.array(list(product(*config.axes.values())))
    found = TableInputs(config, study, cells, reference, _place(config, study.config, variant))
    _check_places(found)
    _check_told(found)
    return found


def _read_study(config: TableConfig, path: Path) -> ReadingInputs:
    """Return the study with the table's variant alone; InputError for one without tables of readings."""
    _, found = load(path)
    if not isinstance(found, StudyConfig):
        raise InputError(f"{path}: kind: found {found.kind!r}, expected 'study'")
    return read_inputs(found, path.parent, [choose_variant(config.variant, found, path)])


def _check_reference(config: TableConfig, variant: Variant) -> dict[str, float]:
    """Return the reference, for what the machine has to know in the machine's order."""
    known = variant.whole.given
    if not known:
        found = ", ".join(config.axes)
        raise InputError(f"axes: found {found}, which no reading depends on: all places have one correction")
    for name in (*config.axes, *config.reference):
        if name not in known:
            raise InputError(say_unknown("axes", name, known))
    for name in known:
        if name not in config.reference:
            raise InputError(f"reference: found no {name}, expected it")
    return {name: float(config.reference[name]) for name in known}


def _place(config: TableConfig, study: StudyConfig, variant: Variant) -> Array:
    """Return the commanded pose, shape (q,)."""
    coordinates, units = variant.model.coordinates, Units(study.units.length, study.units.angle)
    names = [one.name for one in coordinates]
    for name in config.pose:
        if name not in names:
            raise InputError(say_unknown("pose", name, names))
    pose = variant.workspace.middle.copy()
    for k, one in enumerate(coordinates):
        if one.name in config.pose:
            pose[k] = units.factor(one.unit) * config.pose[one.name]
    return pose


def _check_places(found: TableInputs) -> None:
    """Raise InputError for a place that the machine says cannot be, or where it does not stand as expected."""
    zero = np.array([[found.reference[name] for name in found.config.axes]])
    for field, rows in (("axes", found.cells), ("reference", zero)):
        labels = [", ".join(f"{n} = {x:g}" for n, x in zip(found.config.axes, row, strict=True)) for row in rows]
        given = found.given_at(rows)
        with name_faults(field):
            found.variant.whole.check_given(labels, given, ())
        read = found.variant.model.read(found.variant.posterior().first_machine, found.pose, given)
        for k in np.flatnonzero(~np.isfinite(read).all(axis=-1))[:1]:
            raise InputError(f"{field}: found unreachable {labels[k]}, expected reachable poses")


def _check_told(found: TableInputs) -> None:
    """Raise InputError where the actuators alone do not hold the platform."""
    at = found.actuators.linearise(found.variant.posterior().first_machine, found.pose, False, found.zero)
    slope = at.by_pose * found.variant.workspace.half
    values = np.linalg.svd(slope, compute_uv=False) if len(slope) else np.zeros(1)
    if len(slope) < len(found.pose) or values[-1] <= RANK * values[0]:
        raise InputError(
            f"variant {found.variant.name!r}: found {len(slope)} own readings, expected enough for "
            f"{len(found.pose)} coordinates"
        )


@dataclass(frozen=True, eq=False)
class Responses:
    """Responses of T machines at G places.

    Where h are the readings of the actuators, v₀ the commanded pose and x₀ the reference, the correction at x is

        Δq(x) = h(v₀, x) - h(v₀, x₀),

    what the actuators have to add so that the platform stays where it was; without it the platform moves to the v with
    h(v, x) = h(v₀, x₀), by v - v₀.
    """

    correction: Array  # Δq, (T, G, n), in the actuators' units
    offset: Array  # v - v₀ where nothing is corrected, (T, G, q), mm and rad


def respond(inputs: TableInputs, theta: Array, cells: Array) -> Responses:
    """Return the responses of machines (T, D) at places (G, A); NaN where a machine does not stand."""
    size = max(1, BATCH // len(cells))
    parts = [_respond(inputs, theta[start : start + size], cells) for start in range(0, len(theta), size)]
    return Responses(*(np.concatenate(part) for part in zip(*parts, strict=True)))


def _respond(inputs: TableInputs, theta: Array, cells: Array) -> tuple[Array, Array]:
    """Return corrections and offsets; where the platform stands while actuators stay is found by Newton's method."""
    model, theta, half = inputs.actuators, theta[:, None], inputs.variant.workspace.half
    compare, given = Comparison(model.channels), {name: x[None] for name, x in inputs.given_at(cells).items()}
    held = model.read(theta, inputs.pose, inputs.zero)
    correction = compare.subtract(model.read(theta, inputs.pose, given), held)
    pose = np.broadcast_to(inputs.pose, (*correction.shape[:2], len(inputs.pose)))
    for _ in range(STEPS):
        here = model.linearise(theta, pose, False, given)
        left = compare.subtract(np.broadcast_to(held, here.values.shape), here.values)
        step = (np.linalg.pinv(np.nan_to_num(here.by_pose)) @ left[..., None])[..., 0]
        pose = pose + step
        if not np.any(np.abs(step) > ARRIVED * half):
            break
    return correction, pose - inputs.pose


def differentiate_correction(inputs: TableInputs, theta: Array, moves: Array) -> Array:
    """Return the derivatives of Δq at all places by coordinates that move one machine (D,) by (m, D), (G, n, m)."""
    model, cells = inputs.actuators, inputs.cells
    pose = np.broadcast_to(inputs.pose, (len(cells), len(inputs.pose)))
    here = model.linearise(theta, pose, True, inputs.given_at(cells)).by_parameters
    there = model.linearise(theta, inputs.pose, True, inputs.zero).by_parameters
    return np.asarray((here - there) @ moves.T)


def measure_elsewhere(inputs: TableInputs, theta: Array, poses: Array) -> Array:
    """Return by how much at most Δq of one machine (D,) differs at other poses (W, q) from that of the table, (n,)."""
    model = inputs.actuators
    compare, given = Comparison(model.channels), inputs.given_at(inputs.cells)

    def correct(pose: Array) -> Array:
        return compare.subtract(model.read(theta, pose, given), model.read(theta, pose, inputs.zero))

    found = np.abs(correct(poses[:, None]) - correct(inputs.pose[None, None]))
    return np.asarray(np.nanmax(found, axis=(0, 1)))


@dataclass(frozen=True, eq=False)
class Polynomial:
    """Terms of a table's corrections."""

    terms: tuple[str, ...]  # F of them, as formulas of the columns
    mean: Array  # coefficients, (F, n), in the actuators' units
    covariance: Array  # of the coefficients, (F n, F n), those of a term's actuators beside one another
    misfit: Array  # by how much at most the terms miss the table's mean, (n,)

    @property
    def sd(self) -> Array:
        """Standard deviations of the coefficients, shape (F, n)."""
        return np.sqrt(np.diagonal(self.covariance)).reshape(self.mean.shape)


def build_terms(axes: Sequence[str], reference: Mapping[str, float], cells: Array) -> dict[str, Array]:
    """Return the terms by their formulas, each at places (G, A) less its value at the reference, shape (G,)."""
    terms: dict[str, Array] = {}
    for k, name in enumerate(axes):
        at, zero = cells[:, k], reference[name]
        if not name.endswith(DEGREES):
            terms[f"{name} - {zero:g}"] = at - zero
            continue
        for word, function in (("sin", np.sin), ("cos", np.cos)):
            terms[f"{word}({name}) - {word}({zero:g} deg)"] = function(np.deg2rad(at)) - function(np.deg2rad(zero))
    return terms


def fit_polynomial(terms: Mapping[str, Array], correction: Array) -> Polynomial:
    """Return the terms' coefficients for corrections (T, G, n) of draws, by least squares for each of them."""
    basis = np.stack(list(terms.values()), axis=1)
    drawn = np.linalg.pinv(basis) @ correction
    mean = drawn.mean(axis=0)
    covariance = np.atleast_2d(np.cov(drawn.reshape(len(drawn), -1), rowvar=False))
    misfit = np.abs(correction.mean(axis=0) - basis @ mean).max(axis=0)
    return Polynomial(tuple(terms), mean, covariance, misfit)


def format_polynomial(found: Polynomial, actuators: Sequence[str], units: Sequence[str]) -> str:
    """Return a polynomial as JSON."""
    content = {
        "about": "correction = sum of coefficient times term; angles in degrees",
        "terms": list(found.terms),
        "actuators": list(actuators),
        "units": list(units),
        "coefficients": found.mean.tolist(),
        "covariance_order": [f"{term}; {name}" for term in found.terms for name in actuators],
        "covariance": found.covariance.tolist(),
        "largest_misfit": found.misfit.tolist(),
    }
    return json.dumps(content, indent=1, ensure_ascii=False, allow_nan=False) + "\n"


@dataclass(frozen=True, eq=False)
class Plan:
    """N measurements in the order in which they were chosen."""

    pose: Array  # (N, q)
    cell: Array  # (N, A)
    before: float  # standard deviation of a correction, rms over places and actuators, without any of them
    after: Array  # the same after each, (N,)
    worst: Array  # the largest standard deviation of any correction after each, (N,)
    random: Array  # as `after`, of as many candidates at random, rms over sets, (N,)
    prior: float  # as `before`, of the tolerances alone


def plan_measurements(inputs: TableInputs, posterior: CalibrationPosterior, y: Array, covariance: Array) -> Plan:
    """Return what to measure beside the data, or in their place, chosen one by one.

    To first order about the posterior's mode y (n,) the squared error of all corrections together is tr(J C Jᵀ), with J
    their derivative by the parameters' coordinates and C what remains unknown of these, (m, m) by the data; a
    measurement with the white rows R, its pose eliminated, leaves C - C Rᵀ (1 + R C Rᵀ)⁻¹ R C. Candidates are random
    poses at every place at which the machine as expected stands.
    """
    asked, rng, model = inputs.config.plan, np.random.default_rng([inputs.config.seed, 21]), inputs.variant.model
    slopes = differentiate_correction(inputs, posterior.theta(y[None])[0], posterior.around(y)[1].T)
    flat = slopes.reshape(-1, slopes.shape[-1])
    start = covariance if asked.include_existing_data else np.eye(len(covariance))
    cell = np.repeat(inputs.cells, asked.poses, axis=0)
    pose = inputs.variant.workspace.draw(len(cell), rng)
    read = model.read(inputs.variant.posterior().first_machine, pose, inputs.given_at(cell))
    stands = np.isfinite(read).all(axis=-1)
    pose, cell = pose[stands], cell[stands]
    every = np.ones(len(model.channels), dtype=bool)
    tried = look(posterior, inputs.variant, y, pose, every, inputs.given_at(cell))
    count = min(asked.measurements, len(pose))
    order, left = add_poses(tried.rows, flat.T @ flat, count, np.arange(len(pose)), start)
    sets = [rng.permutation(len(pose))[:count] for _ in range(RANDOM_SETS)]
    random = [[_rms(flat, one) for one in learn_in_turn(tried.rows, some, start)] for some in sets]
    return Plan(
        pose[order],
        cell[order],
        _rms(flat, start),
        np.array([_rms(flat, one) for one in left]),
        np.array([_deviations(flat, one).max() for one in left]),
        np.sqrt(np.mean(np.square(random), axis=0)),
        _rms(flat, np.eye(len(covariance))),
    )


def _deviations(slopes: Array, covariance: Array) -> Array:
    """Return the standard deviations of corrections with derivatives (S, m)."""
    return np.asarray(np.sqrt(np.einsum("si,ij,sj->s", slopes, covariance, slopes, optimize=True)))


def _rms(slopes: Array, covariance: Array) -> float:
    return float(np.sqrt(np.mean(_deviations(slopes, covariance) ** 2)))
