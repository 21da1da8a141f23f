"""From an experiment's config to what it computes with; machine, tolerances and sensors are read as an audit's are."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from bayescal.errors import InputError
from bayescal.experiments.audit.inputs import AuditInputs, read_inputs
from bayescal.experiments.audit.schema import ActuatorPlanConfig, AuditConfig
from bayescal.experiments.pose_selection.schema import (
    ActuatorDomainConfig,
    ContinuousChoiceConfig,
    RandomChoiceConfig,
    SelectionChoice,
    SelectionConfig,
    TableConfig,
    WorkspaceDomainConfig,
)
from bayescal.files.csv_tables import read_matrix
from bayescal.identifiability.requirement_limits import find_limits
from bayescal.identifiability.sensitivity import Sensitivity, compute_sensitivity
from bayescal.numerics.geometry import Array
from bayescal.pose_selection import (
    CRITERIA,
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
from bayescal.pose_selection.criteria import AOptimality, DOptimality, IOptimality
from bayescal.pose_selection.methods import RandomSets

CANDIDATES = 1  # streams of random numbers
SHARED = ("criteria", "n_poses", "repeats", "label", "method")
BAYESIAN = ("D", "A", "I")


@dataclass(frozen=True, eq=False)
class SelectionInputs:
    """An experiment on pose selection, read and checked.

    Attributes
    ----------
    config : SelectionConfig
    audit : AuditInputs
        Machine, tolerances, sensors, workspace and requirements; its plan's poses are only a placeholder.
    domain : PoseDomain
        Where poses may be.
    measured : ndarray, shape (M, N), or None
        Actuator positions of poses that have been measured already, mm.
    designs : dict of name to ndarray, shape (n, N)
        Actuator positions of sets of poses that somebody else has chosen, mm.
    """

    config: SelectionConfig
    audit: AuditInputs
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
        """Return a criterion by name."""
        if name == "I":
            knowledge = self.audit.knowledge
            return IOptimality(self.audit.plan, workspace=self.workspace, sd=knowledge.sd, limits=self.limits)
        if name in BAYESIAN:
            return {"D": DOptimality, "A": AOptimality}[name](self.audit.plan)
        return CRITERIA[name](form=self.config.jacobian)  # type: ignore[call-arg]  # all but the Bayesian ones

    @cached_property
    def workspace(self) -> Sensitivity:
        """Derivatives at the poses that stand for the workspace."""
        return compute_sensitivity(self.audit.knowledge, self.audit.workspace_actuators)

    @cached_property
    def limits(self) -> Array:
        """What errors of a pose are measured by, shape (6,), mm and rad."""
        return find_limits(self.audit.requirements, self.workspace, self.audit.knowledge.sd)

    def indices(self, actuators: Array) -> dict[str, float]:
        """Return the five observability indices of poses at actuator positions (n, N)."""
        sensitivity = compute_sensitivity(self.audit.knowledge, actuators)
        rows = identification_rows(sensitivity, self.config.jacobian)
        return {name: float(value) for name, value in compute_observability(rows).items()}


def read_selection(config: SelectionConfig, folder: Path) -> SelectionInputs:
    """Return what an experiment computes with; names of files are relative to ``folder``.

    Raises
    ------
    InputError
        For anything at fault in the config or its files.
    """
    audit = read_inputs(_as_audit(config), folder)
    domain = _domain(config, audit)
    measured = None if config.measured is None else _read_table(config.measured, folder, audit)
    designs = {design.name: _read_table(design, folder, audit) for design in config.designs}
    for name, actuators in designs.items():
        placed = domain.at_actuators(actuators)
        if not placed.found.all():
            raise InputError(
                f"designs: {name}: pose {int(np.argmin(placed.found)) + 1}: found none at these displacements, "
                "expected poses the machine can take"
            )
    return SelectionInputs(config, audit, domain, measured, designs)


def build_method(choice: SelectionChoice) -> SelectionMethod:
    """Return the method of a choice with its options."""
    options = choice.model_dump(exclude=set(SHARED))
    if isinstance(choice, ContinuousChoiceConfig):
        start = options.pop("start")
        options["start"] = RandomSets(1) if start == "random" else METHODS[start]()
    return METHODS[choice.method](**options)


def label_of(choice: SelectionChoice) -> str:
    """Return what a choice is called in tables and figures."""
    return choice.label or choice.method


def is_histogram(choice: SelectionChoice) -> bool:
    """Return whether a choice judges many random sets, to see how they spread."""
    return isinstance(choice, RandomChoiceConfig) and choice.n_sets > 1


def _as_audit(config: SelectionConfig) -> AuditConfig:
    """Return the design of an audit of the same machine, with next to no motion as its plan."""
    return AuditConfig(
        kind="audit",
        name=config.name,
        title=config.title,
        seed=config.seed,
        mechanism=config.mechanism,
        variant=config.variant,
        units=config.units,
        deformation=config.deformation,
        parameters=config.parameters,
        noise=config.noise,
        sensors=config.sensors,
        measured_by=config.measured_by,
        poses=ActuatorPlanConfig(plan="uniform", count=1, range_mm=1e-9),
        workspace=config.workspace,
        requirements=config.requirements,
    )


def _domain(config: SelectionConfig, audit: AuditInputs) -> PoseDomain:
    section = config.domain
    half = None
    if section.position_mm is not None and section.rotation_deg is not None:
        half = np.concatenate([section.position_mm, np.radians(section.rotation_deg)])
    if isinstance(section, WorkspaceDomainConfig):
        assert half is not None
        return WorkspaceBox(audit.knowledge, half)
    assert isinstance(section, ActuatorDomainConfig)
    return ActuatorBox(audit.knowledge, half)


def _read_table(table: TableConfig, folder: Path, audit: AuditInputs) -> Array:
    mechanism = audit.knowledge.machine.mechanism
    moves = table.unit_mm * read_matrix(folder / table.configurations, mechanism.n_legs)
    result: Array = mechanism.initial_actuator_positions + moves
    return result
