"""From an experiment's config to what it computes with; machine, tolerances and sensors are read as an audit's are."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from bayescal.config.classes import choose, name_failures
from bayescal.data.actuators import read_moves
from bayescal.errors import InputError
from bayescal.experiments.selection.schema import (
    ActuatorDomainConfig,
    ContinuousChoiceConfig,
    OwnChoiceConfig,
    SelectionChoice,
    SelectionConfig,
    TableConfig,
    WorkspaceDomainConfig,
)
from bayescal.experiments.shared.design import (
    Design,
    build_sensor,
    find_actuators,
    plan_sensors,
    read_machine,
    read_requirements,
    read_tolerances,
    read_workspace,
)
from bayescal.identifiability.design import Knowledge, Plan
from bayescal.identifiability.requirements import find_limits
from bayescal.identifiability.sensitivity import Sensitivity, compute_sensitivity
from bayescal.numerics.geometry import Array
from bayescal.numerics.units import Units
from bayescal.pose_selection import (
    METHODS,
    ActuatorBox,
    Candidates,
    Criterion,
    PoseDomain,
    SelectionMethod,
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
    """An experiment on pose selection, read and checked.

    Attributes
    ----------
    config : SelectionConfig
    folder : Path
        Where the config's file names start.
    design : Design
        Machine, tolerances, sensors, workspace and requirements; the poses are still to be chosen.
    domain : PoseDomain
        Where poses may be.
    measured : ndarray, shape (M, N), or None
        Actuator positions of poses that have been measured already, mm.
    designs : dict of name to ndarray, shape (n, N)
        Actuator positions of sets of poses that somebody else has chosen, mm.
    """

    config: SelectionConfig
    folder: Path
    design: Design
    domain: PoseDomain
    measured: Array | None
    designs: dict[str, Array]

    def candidates(self, repeat: int) -> Candidates:
        """Return the candidates of a repeat; without ``redraw`` all have those of the first.

        The first even or factorial ones are the plain sequence, later ones are scrambled.
        """
        section = self.config.candidates
        place = repeat if section.redraw else 0
        rng = np.random.default_rng([self.config.seed, CANDIDATES, place])
        if section.spread == "random":
            return random_candidates(self.domain, section.count, rng)
        scramble = rng if place else None
        if section.spread == "factorial":
            return factorial_candidates(self.domain, section.count, scramble)
        return even_candidates(self.domain, section.count, scramble, section.levels)

    def criterion(self, name: str) -> Criterion:
        """Return a criterion by what tables call it."""
        chosen = choose("CRITERIA", self.config.criteria[name], Criterion, CRITERIA_FIELD, self.folder)  # type: ignore[type-abstract]
        with name_failures(chosen.found, CRITERIA_FIELD, self.folder):
            return chosen.found.from_config(chosen.options, self)

    def method(self, choice: SelectionChoice) -> SelectionMethod:
        """Return the method of a choice with its options."""
        if isinstance(choice, OwnChoiceConfig):
            return self._make_method(choice.method, "selections.method", choice.options)
        options = choice.model_dump(exclude=set(SHARED))
        if isinstance(choice, ContinuousChoiceConfig):
            start = self._make_method(choice.start, "selections.start", None)
            options["start"] = RandomSets(1) if type(start) is RandomSets else start
        return METHODS[choice.method](**options)

    def _make_method(self, name: str, field: str, options: dict[str, Any] | None) -> SelectionMethod:
        chosen = choose("METHODS", name, SelectionMethod, field, self.folder, options)  # type: ignore[type-abstract]
        with name_failures(chosen.found, field, self.folder):
            return chosen.found.from_config(chosen.options)

    @property
    def knowledge(self) -> Knowledge:
        """The machine and its tolerances."""
        return self.design.knowledge

    @property
    def plan(self) -> Plan:
        """Sensors and noise."""
        return self.design.plan

    @property
    def form(self) -> JacobianForm:
        """Which derivatives the indices are of."""
        return self.config.jacobian

    @cached_property
    def workspace(self) -> Sensitivity:
        """Derivatives at the poses that stand for the workspace."""
        return compute_sensitivity(self.design.knowledge, self.design.workspace_actuators)

    @cached_property
    def limits(self) -> Array:
        """What errors of a pose are measured by, shape (6,), mm and rad."""
        return find_limits(self.design.requirements, self.workspace.slope * self.design.knowledge.sd)

    def indices(self, actuators: Array) -> dict[str, float]:
        """Return the five observability indices of poses at actuator positions (n, N)."""
        sensitivity = compute_sensitivity(self.design.knowledge, actuators)
        rows = identification_rows(sensitivity, self.config.jacobian)
        return {name: float(value) for name, value in compute_observability(rows).items()}


def read_selection(config: SelectionConfig, folder: Path) -> SelectionInputs:
    """Return what an experiment computes with; names of files are relative to ``folder``.

    Raises
    ------
    InputError
        For anything at fault in the config or its files.
    """
    design = read_design(config, folder)
    domain = _domain(config, design.knowledge)
    measured = None if config.measured is None else _read_table(config.measured, folder, design)
    designs = {one.name: _read_table(one, folder, design) for one in config.designs}
    for name, actuators in designs.items():
        placed = domain.at_actuators(actuators)
        if not placed.found.all():
            raise InputError(
                f"designs: {name}: pose {int(np.argmin(placed.found)) + 1}: found none at these displacements, "
                "expected poses the machine can take"
            )
    return SelectionInputs(config, folder, design, domain, measured, designs)


def read_design(config: SelectionConfig, folder: Path) -> Design:
    """Return the machine, what measures it and what is required, with a plan that has no poses yet."""
    units = Units(config.units.length, config.units.angle)
    machine = read_machine(folder / config.machine, config.variant, config.deformation, folder)
    tolerances = read_tolerances(machine, config.parameters, config.variant.free, units, Path(config.name))
    knowledge, workspace = Knowledge(machine, *tolerances), read_workspace(config.workspace)
    sensors = {name: build_sensor(name, sensor, folder) for name, sensor in config.sensors.items()}
    start = machine.mechanism.initial_actuator_positions[None]
    plan = plan_sensors(start[:0], sensors, config.variant.sensors, config.noise, "variant.sensors")
    at = find_actuators(knowledge, workspace, config.seed, start)
    return Design(knowledge, plan, workspace, at, read_requirements(config.requirements, units))


def _domain(config: SelectionConfig, knowledge: Knowledge) -> PoseDomain:
    section = config.domain
    half = None
    if section.position_mm is not None and section.rotation_deg is not None:
        half = np.concatenate([section.position_mm, np.radians(section.rotation_deg)])
    if isinstance(section, WorkspaceDomainConfig):
        assert half is not None
        return WorkspaceBox(knowledge, half)
    assert isinstance(section, ActuatorDomainConfig)
    return ActuatorBox(knowledge, half)


def _read_table(table: TableConfig, folder: Path, design: Design) -> Array:
    mechanism = design.knowledge.machine.mechanism
    moves = read_moves(folder / table.configurations, table.unit_mm, mechanism.n_legs)
    result: Array = mechanism.initial_actuator_positions + moves
    return result
