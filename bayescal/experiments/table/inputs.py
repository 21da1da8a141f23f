"""From a table's config to what it is computed with: a study's variant, the places of the table, the pose."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import product
from pathlib import Path

import numpy as np

from bayescal.density.elimination import RANK
from bayescal.errors import InputError, name_faults
from bayescal.experiments.frame.load import load
from bayescal.experiments.shared.readings.inputs import ReadingInputs, Variant, read_inputs
from bayescal.experiments.shared.study_schema import StudyConfig
from bayescal.experiments.table.schema import TableConfig
from bayescal.machines.readings import Given, ReadingModel
from bayescal.numerics.geometry import Array
from bayescal.numerics.units import Units


@dataclass(frozen=True, eq=False)
class TableInputs:
    """A look-up table, read.

    Attributes
    ----------
    config : TableConfig
    study : ReadingInputs
        With the one variant that the table is made of.
    cells : ndarray, shape (G, A)
        The places of the table, its axes in their order, the last one fastest.
    reference : dict of str to float
        Of everything that the machine has to know of a pose.
    pose : ndarray, shape (q,)
        The commanded one, mm and rad.
    """

    config: TableConfig
    study: ReadingInputs
    cells: Array
    reference: dict[str, float]
    pose: Array

    @property
    def variant(self) -> Variant:
        """The variant that the table is made of."""
        return next(iter(self.study.variants.values()))

    @cached_property
    def actuators(self) -> ReadingModel:
        """The machine with its own channels alone, n of them."""
        own = [one.name for one in self.variant.model.channels if not one.external]
        return self.variant.whole.pick(self.variant.whole.select(own))

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

    Raises
    ------
    InputError
        Where the file is no study of readings, an axis is no column that its machine has to know or its values cannot
        be, a coordinate is unknown, or the actuators do not tell the pose.
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
        raise InputError(f"{path}: kind: found {found.kind!r}, expected 'study', of which a table is made")
    if not found.by_tables:
        raise InputError(
            f"{path}: data: found an instrument's poses of legs, which depend on nothing but the pose: all places have "
            "one correction, expected tables of readings"
        )
    names = [one.name for one in found.variants]
    name = config.variant or (names[0] if len(names) == 1 else "")
    if name not in names:
        raise InputError(f"{path}: variant: found {name or 'none'!r}, expected one of {', '.join(names)}")
    chosen = [one for one in found.variants if one.name == name]
    return read_inputs(found.model_copy(update={"variants": chosen}), path.parent)


def _check_reference(config: TableConfig, variant: Variant) -> dict[str, float]:
    """Return the reference, for what the machine has to know in the machine's order."""
    known = variant.whole.given
    if not known:
        raise InputError(
            f"axes: found {', '.join(config.axes)}, but what this machine reads depends on its pose alone: all places "
            "have one correction, expected a machine that names what is given"
        )
    for name in (*config.axes, *config.reference):
        if name not in known:
            raise InputError(f"axes: found {name!r}, expected some of {', '.join(known)}")
    for name in known:
        if name not in config.reference:
            raise InputError(f"reference: found no {name}, expected it, for the machine has to know it")
    return {name: float(config.reference[name]) for name in known}


def _place(config: TableConfig, study: StudyConfig, variant: Variant) -> Array:
    """Return the commanded pose, shape (q,)."""
    coordinates, units = variant.model.coordinates, Units(study.units.length, study.units.angle)
    names = [one.name for one in coordinates]
    for name in config.pose:
        if name not in names:
            raise InputError(f"pose: found {name!r}, expected some of {', '.join(names)}")
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
        read = found.variant.model.read(found.variant.posterior().sampling.start, found.pose, given)
        for k in np.flatnonzero(~np.isfinite(read).all(axis=-1))[:1]:
            raise InputError(f"{field}: found {labels[k]}, where the machine does not stand, expected where it does")


def _check_told(found: TableInputs) -> None:
    """Raise InputError where the actuators alone do not hold the platform."""
    given = {name: np.array(value) for name, value in found.reference.items()}
    at = found.actuators.linearise(found.variant.posterior().sampling.start, found.pose, False, given)
    slope = at.by_pose * found.variant.workspace.half
    values = np.linalg.svd(slope, compute_uv=False) if len(slope) else np.zeros(1)
    if len(slope) < len(found.pose) or values[-1] <= RANK * values[0]:
        raise InputError(
            f"variant {found.variant.name!r}: found {len(slope)} readings of the machine's own, which do not tell all "
            f"{len(found.pose)} coordinates, expected actuators that hold the platform"
        )
