"""From an experiment's config to what it computes with; machine, tolerances and sensors are read as an audit's are."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from bayescal.config.classes import choose, label_class, name_failures
from bayescal.data.actuators import read_moves
from bayescal.density.priors import NormalPrior
from bayescal.errors import InputError
from bayescal.experiments.selection.schema import (
    ActuatorTableConfig,
    OwnChoiceConfig,
    SelectionChoice,
    SelectionConfig,
)
from bayescal.experiments.shared.design import REQUIRED, build_sensor, known_symbols, read_machine, read_workspace
from bayescal.experiments.shared.readings.priors import choose_priors
from bayescal.experiments.shared.readings.schema import FreeConfig
from bayescal.identifiability.pose_volume import find_workspace_actuators
from bayescal.identifiability.requirements import Requirement, find_limits
from bayescal.numerics.geometry import Array
from bayescal.numerics.units import MICROMETRE, Units
from bayescal.pose_selection import (
    METHODS,
    ActuatorBox,
    Candidates,
    Criterion,
    Design,
    PoseDomain,
    SeenPoses,
    SelectionMethod,
    SelectionProblem,
    WorkspaceBox,
    compute_observability,
    even_candidates,
    factorial_candidates,
    identification_rows,
    random_candidates,
)
from bayescal.pose_selection.methods import RandomSets
from bayescal.pose_selection.observability import JacobianForm

CANDIDATES = 1  # streams of random numbers
SHARED = ("criteria", "n_poses", "repeats", "label", "method")
CRITERIA_FIELD = "selections.criteria"


@dataclass(frozen=True, eq=False)
class SelectionInputs:
    """An experiment on pose selection, read and checked."""

    config: SelectionConfig
    folder: Path  # where the config's file names start
    design: Design  # machine, tolerances, sensors and noise
    domain: PoseDomain  # where poses may be
    # (W, N): actuator positions of the workspace's poses, mm; those of home where there is none
    workspace_actuators: Array
    requirements: list[Requirement]
    measured: Array | None  # (M, N): actuator positions of poses that have been measured already, mm
    designs: dict[str, Array]  # by name, (n, N): actuator positions of sets of poses that somebody else has chosen, mm

    def candidates(self, repeat: int) -> Candidates:
        """Return the candidates of a repeat; without ``resample`` all have those of the first.

        The first even or factorial ones are the plain sequence, later ones are scrambled.
        """
        section = self.config.candidates
        place = repeat if section.resample else 0
        rng = np.random.default_rng([self.config.seed, CANDIDATES, place])
        if section.layout == "random":
            return random_candidates(self.domain, section.count, rng)
        scramble = rng if place else None
        if section.layout == "factorial":
            return factorial_candidates(self.domain, section.count, scramble)
        return even_candidates(self.domain, section.count, scramble, section.levels)

    def criterion(self, name: str) -> Criterion:
        """Return a criterion by what tables call it."""
        chosen = choose("CRITERIA", self.config.criteria[name], Criterion, CRITERIA_FIELD, self.folder)  # type: ignore[type-abstract]
        with name_failures(chosen.found, CRITERIA_FIELD):
            return chosen.make(self)

    def method(self, choice: SelectionChoice) -> SelectionMethod:
        """Return the method of a choice with its options."""
        if isinstance(choice, OwnChoiceConfig):
            return self._make_method(choice.method, "selections.method", choice.options)
        options = choice.model_dump(exclude=set(SHARED))
        if choice.method == "continuous":
            start = self._make_method(choice.start, "selections.start", None)
            options["start"] = RandomSets(1) if type(start) is RandomSets else start
        return METHODS[choice.method](**options)

    def _make_method(self, name: str, field: str, options: dict[str, Any] | None) -> SelectionMethod:
        chosen = choose("METHODS", name, SelectionMethod, field, self.folder, options)  # type: ignore[type-abstract]
        with name_failures(chosen.found, field):
            return chosen.make()

    @property
    def form(self) -> JacobianForm:
        """Which derivatives the indices are of."""
        return self.config.jacobian

    @cached_property
    def workspace(self) -> SeenPoses:
        """The poses that stand for the workspace, to first order."""
        return self.see(self.workspace_actuators)

    @cached_property
    def limits(self) -> Array:
        """What errors of a pose are measured by, shape (6,), mm and rad."""
        return find_limits(self.requirements, self.workspace.located.tool)

    def see(self, actuators: Array) -> SeenPoses:
        """Return the poses at actuator positions (n, N), mm, to first order."""
        return self.design.see(self.domain.at_actuators(actuators))

    def indices(self, actuators: Array) -> dict[str, float]:
        """Return the five observability indices of poses at actuator positions (n, N)."""
        rows = identification_rows(self.see(actuators), self.config.jacobian)
        return {name: float(value) for name, value in compute_observability(rows).items()}


def read_selection(config: SelectionConfig, folder: Path) -> SelectionInputs:
    """Return what an experiment computes with; InputError for anything at fault in the config or its files."""
    design = read_design(config, folder)
    domain, at = _domain(config, design), design.machine.mechanism.initial_actuator_positions[None]
    if (workspace := read_workspace(config.workspace)) is not None:
        at = find_workspace_actuators(design.machine, design.theta, workspace, workspace.n_poses, config.seed)
    measured = None if config.measured is None else _read_table(config.measured, folder, design)
    designs = {one.name: _read_table(one, folder, design) for one in config.designs}
    for name, actuators in designs.items():
        placed = domain.at_actuators(actuators)
        if not placed.found.all():
            raise InputError(
                f"designs: {name}: pose {int(np.argmin(placed.found)) + 1}: found no pose at these displacements"
            )
    return SelectionInputs(config, folder, design, domain, at, read_requirements(config), measured, designs)


def read_design(config: SelectionConfig, folder: Path) -> Design:
    """Return the machine as expected, and what measures it."""
    machine = read_machine(folder / config.machine, config.variant, config.deformation, folder)
    if machine.mechanism.actuator_gains is not None:
        raise InputError(
            f"{folder / config.machine}: legs.actuator_gain: expected none; divide the displacements by gains"
        )
    free, symbols = FreeConfig(free=config.variant.free), known_symbols(machine.mechanism)
    priors, fixed, _ = choose_priors(config, free, machine.layout, symbols)
    sensors = {name: build_sensor(name, section, folder) for name, section in config.sensors.items()}
    for name in config.variant.sensors:
        if name not in sensors:
            raise InputError(f"variant.sensors: found sensor {name!r}, expected one of {', '.join(sorted(sensors))}")
    return Design(
        machine,
        {name: NormalPrior(one.mean, one.sd) for name, one in priors.items()},
        fixed,
        tuple(sensors[name] for name in config.variant.sensors),
        MICROMETRE * config.noise.actuator_um,
        MICROMETRE * config.noise.model_error_um,
    )


def read_requirements(config: SelectionConfig) -> list[Requirement]:
    """Return the largest errors of a pose that are allowed, mm and rad."""
    units = Units(config.units.length, config.units.angle)
    return [
        Requirement(name, limit * units.factor("rad" if name.startswith("rotation") else "mm"))
        for name in REQUIRED
        if (limit := getattr(config.requirements, name)) is not None
    ]


def _domain(config: SelectionConfig, design: Design) -> PoseDomain:
    section = config.domain
    half = None
    if section.position_mm is not None and section.rotation_deg is not None:
        half = np.concatenate([section.position_mm, np.radians(section.rotation_deg)])
    if section.kind == "workspace":
        assert half is not None
        return WorkspaceBox(design, half)
    return ActuatorBox(design, half)


def _read_table(table: ActuatorTableConfig, folder: Path, design: Design) -> Array:
    mechanism = design.machine.mechanism
    moves = read_moves(folder / table.configurations, table.unit_mm, mechanism.n_legs)
    return np.asarray(mechanism.initial_actuator_positions + moves)


def check_problems(inputs: SelectionInputs) -> None:
    """Raise InputError where poses are too few or too many for the first repeat's candidates, or one is singular."""
    candidates = inputs.candidates(0)
    for choice in inputs.config.selections:
        inputs.method(choice)
        for criterion in map(label_class, choice.criteria):
            for n in {min(choice.n_poses), max(choice.n_poses)}:
                SelectionProblem(candidates, inputs.criterion(criterion), n, inputs.measured)
