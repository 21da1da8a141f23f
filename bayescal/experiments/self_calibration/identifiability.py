"""What the sensors of a variant can tell of the machine at the poses measured, with the functions of an audit.

Poses eliminated, readings see the parameters by (1 - HH⁺)A, H and A in units of the noise. What defines the frames is
never seen from inside: the structural rank is that of all parameters, these included, so that the number of directions
that no reading sees must be that of the frames' definitions; the rest is that of the free parameters.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bayescal.experiments.self_calibration.inputs import ReadingInputs, Variant
from bayescal.experiments.shared.reading_machine import tolerance_of
from bayescal.experiments.shared.sensor_sets import SensorSet, find_poses
from bayescal.identifiability.directions import Direction, find_directions
from bayescal.identifiability.information import Information, information_of_rows
from bayescal.identifiability.ridges import ARCSECONDS, MICROMETRES, describe_move, round_below, round_up
from bayescal.identifiability.selection import Selection, select_parameters
from bayescal.identifiability.structure import EPSILON, TWIN_SHIFT, TWINS, Structure, find_structure
from bayescal.identifiability.structured_noise import marginalise
from bayescal.identifiability.units import Units
from bayescal.identifiability.verdicts import Verdict, judge_parameters
from bayescal.numerics.geometry import Array

UNITS = Units("mm", "deg")


@dataclass(frozen=True, eq=False)
class Ridge:
    """A direction that contracts too little, with a sentence."""

    direction: Direction
    sentence: str


@dataclass(frozen=True, eq=False)
class Identifiability:
    """What a variant's sensors can tell.

    Attributes
    ----------
    seen : tuple of str
        All parameters that the sensors depend on, those of the frames included.
    structure : Structure
        Of these.
    unseen : tuple of str
        Parameters that the directions which no reading sees are named after.
    names : tuple of str
        Free parameters, n.
    information : Information
        On these.
    selection : Selection
    verdicts : tuple of str
        Of each.
    ridges : tuple of Ridge
    """

    seen: tuple[str, ...]
    structure: Structure
    unseen: tuple[str, ...]
    names: tuple[str, ...]
    information: Information
    selection: Selection
    verdicts: tuple[Verdict, ...]
    ridges: tuple[Ridge, ...]


def compute_rows(sensors: SensorSet, theta: Array, pose: Array) -> Array:
    """Return (1 - HH⁺)A, how readings of eliminated poses see the parameters, (P, K, D) in units of the noise."""
    here = sensors.linearise(theta, pose)
    return np.asarray(here.by_parameters - here.by_pose @ (np.linalg.pinv(here.by_pose) @ here.by_parameters))


def audit_variant(inputs: ReadingInputs, variant: Variant) -> Identifiability:
    """Return what the sensors of a variant tell of its free parameters at the calibration poses."""
    free, sensors = variant.free, variant.sensors
    seen, structure, unseen = _find_structure(inputs, variant)
    pose = variant.pose[~inputs.table.verification]
    rows = compute_rows(sensors, free.centre, pose)[..., free.places]
    information = _inform(inputs, variant, pose, rows)
    names = variant.free_names
    selection = select_parameters(information, tuple(name.partition("[")[0] for name in names))
    nothing = np.empty((len(names), 0))
    directions = find_directions(information, nothing, selection.fixed)
    verdicts = judge_parameters(information, nothing)
    ridges = tuple(_describe(variant, d, pose) for d in directions if d.pivot is not None)
    return Identifiability(seen, structure, unseen, names, information, selection, verdicts, ridges)


def _inform(inputs: ReadingInputs, variant: Variant, pose: Array, rows: Array) -> Information:
    """Return what rows (P, K, n) tell of the free parameters, beside functions of the sensors of their stated scale."""
    if variant.functions is None:
        return information_of_rows(rows, variant.free.scale)
    posterior = inputs.posterior(variant)
    y = np.zeros((1, posterior.n_parameters))
    white = posterior.likelihood.whiten(*posterior.likelihood.noise(posterior.errors, posterior.zeta(y)))
    slope = variant.sensors.linearise(variant.free.centre, pose, with_parameters=False).by_pose
    others = posterior.likelihood.columns(posterior.errors, posterior.zeta(y), white, slope[None])[0]
    return marginalise(rows.reshape(-1, rows.shape[-1]) * variant.free.scale, others.reshape(-1, others.shape[-1]))


def _find_structure(inputs: ReadingInputs, variant: Variant) -> tuple[tuple[str, ...], Structure, tuple[str, ...]]:
    """Return the parameters that the sensors see, their rank over the workspace, and what is never seen, by name."""
    model, sensors = inputs.model, variant.sensors
    layout = model.layout
    seen = model.seen_parameters(sensors.names)
    places = [layout.names.index(name) for name in seen]
    scale = np.array([tolerance_of(layout.names[k], layout.units[k], inputs.config.tolerances) for k in places])
    rng = np.random.default_rng([inputs.config.seed, 2])
    shifts = TWIN_SHIFT * EPSILON * rng.uniform(-1.0, 1.0, (TWINS, layout.size))
    twins = layout.nominal * (1.0 + np.concatenate([np.zeros((1, layout.size)), shifts]))
    first, *others = (
        (compute_rows(sensors, theta, inputs.workspace)[..., places] * scale).reshape(-1, len(places))
        for theta in twins
    )
    structure = find_structure(first, others)
    given = set(model.frame_parameters()) - set(variant.free_names)
    frames = tuple(k for k, name in enumerate(seen) if name in given)
    directions = find_directions(information_of_rows(first, np.ones(len(seen))), structure.null_space, (), frames)
    unseen = sorted(d.pivot for d in directions if d.kind == "structural" and d.pivot is not None)
    return seen, structure, tuple(seen[k] for k in unseen)


def _describe(variant: Variant, direction: Direction, pose: Array) -> Ridge:
    """Return a ridge with what a round step along it leaves of the readings once every pose has followed."""
    sensors, free, pivot = variant.sensors, variant.free, direction.pivot
    assert pivot is not None
    layout, vector = sensors.model.layout, direction.vector
    kinds = [layout.units[k] for k in free.places]
    factor = UNITS.factor(kinds[pivot])
    largest = free.scale[pivot] * min(1.0, abs(vector[pivot]) / np.abs(vector).max())
    move = vector * free.scale * (factor * round_below(largest / factor) / (vector[pivot] * free.scale[pivot]))
    theta = free.centre.copy()
    theta[free.places] += move
    fit = find_poses(sensors, theta, sensors.read(free.centre, pose), pose, check=False)
    changes = []
    for unit, size, name in (("mm", MICROMETRES, "µm"), ("rad", ARCSECONDS, "arcsec")):
        some = [k for k, place in enumerate(sensors.chosen) if sensors.model.channels[place].unit == unit]
        if some:
            left = size * np.abs(fit.error[:, some] * sensors.noise[some]).max()
            changes.append(f"{round_up(float(left))} {name}")
    text = describe_move(variant.free_names, kinds, direction, move, UNITS)
    return Ridge(direction, f"{text} changes no reading by more than {' and '.join(changes)}.")
