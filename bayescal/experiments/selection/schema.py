"""The schema of an experiment on pose selection: a machine as in an audit, where poses may be, how to choose them.

Tolerances and requirements are in the units of [units]; all other keys carry theirs.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Annotated, Literal, Self

from pydantic import AfterValidator, Discriminator, Field, Tag, field_validator, model_validator

from bayescal.config.classes import ClassMark, OwnSection, label_class
from bayescal.config.load import OWN
from bayescal.config.sections import ExperimentConfig, InputFile, Name, Names, Positive, Section, check_once
from bayescal.density.schema import PriorConfig
from bayescal.experiments.shared.readings.schema import ProvenanceConfig
from bayescal.experiments.shared.schema import (
    ActuatorNoiseConfig,
    DeformationConfig,
    Extent,
    ModelConfig,
    RequirementsConfig,
    SensorConfig,
    Turns,
    UnitsConfig,
    WorkspaceConfig,
)

type Count = Annotated[int, Field(ge=1, le=100_000)]
type CriterionName = Annotated[str, ClassMark("CRITERIA")]


# --- where poses may be ------------------------------------------------------------------------------------------


class WorkspaceDomainConfig(Section):
    """A box of displacements and rotation vectors about home; the actuators' range is kept."""

    kind: Literal["workspace"]
    """`"workspace"`."""
    position_mm: Extent
    """Half widths of displacements about home."""
    rotation_deg: Turns
    """Half widths of rotation vectors about home."""


class ActuatorDomainConfig(Section):
    """The actuators' range; with half widths about home the poses stay within these too."""

    kind: Literal["actuators"]
    """`"actuators"`."""
    position_mm: Extent | None = None
    """Half widths of displacements about home that are kept too."""
    rotation_deg: Turns | None = None
    """Half widths of rotation vectors about home that are kept too."""

    @model_validator(mode="after")
    def _check_both(self) -> Self:
        if (self.position_mm is None) != (self.rotation_deg is None):
            raise ValueError("expected position_mm with rotation_deg, or neither")
        return self


type DomainConfig = Annotated[WorkspaceDomainConfig | ActuatorDomainConfig, Field(discriminator="kind")]


class CandidatesConfig(Section):
    """Poses to choose from: on an even grid, at random, or a full factorial, topped up."""

    layout: Literal["even", "random", "factorial"] = "random"
    """How candidates lie: on an `even` grid, at `random`, or `factorial`."""
    count: Annotated[int, Field(ge=1, le=1_000_000)] = 2000
    """Number of candidates."""
    levels: Annotated[int, Field(ge=2, le=1000)] = 11
    """Levels of each actuator of a full factorial."""
    resample: bool = False
    """Whether each repeat has candidates of its own."""


class ActuatorTableConfig(Section):
    """Actuator displacements from a CSV table, one row a pose."""

    configurations: InputFile
    """CSV file of actuator displacements, a row a pose."""
    unit_mm: Positive = 1.0
    """Unit of its numbers."""


class DesignConfig(ActuatorTableConfig):
    """Poses that somebody else has chosen, to be judged beside those found."""

    name: Name
    """What tables call the poses."""


# --- how they are chosen -----------------------------------------------------------------------------------------


class ChoiceConfig(Section):
    """A method with its options: every criterion with every number of poses, ``repeats`` times."""

    label: Name | None = None
    """What tables call the choice; the method's name where nothing is said."""
    criteria: Annotated[list[CriterionName], Field(min_length=1), AfterValidator(check_once)]
    """Criteria to select by; `bayescal list criteria` shows all."""
    n_poses: Annotated[list[Count], Field(min_length=1), AfterValidator(check_once)]
    """Numbers of poses to select."""
    repeats: Annotated[int, Field(ge=1, le=10_000)] = 1
    """How often each is repeated with other random numbers."""

    @property
    def is_best_of_many(self) -> bool:
        """Whether it is the best of many random sets."""
        return False


class RandomChoiceConfig(ChoiceConfig):
    """The best of random sets."""

    method: Literal["random"]
    """`"random"`."""
    n_sets: Count = 1
    """Number of random sets, the best of which is taken."""

    @property
    def is_best_of_many(self) -> bool:
        """Whether there are several."""
        return self.n_sets > 1


class ExchangeChoiceConfig(ChoiceConfig):
    """Eliminate and add."""

    method: Literal["exchange"]
    """`"exchange"`."""
    max_iterations: Count = 1000
    """Iterations at which it ends at the latest."""


class ContinuousChoiceConfig(ChoiceConfig):
    """All poses at once, from a random set or from what another method finds."""

    method: Literal["continuous"]
    """`"continuous"`."""
    start: Annotated[str, ClassMark("METHODS")] = "exchange"
    """Method whose poses it starts from."""
    max_iterations: Count = 300
    """Iterations at which it ends at the latest."""

    @field_validator("start")
    @classmethod
    def _check_start(cls, start: str) -> str:
        if start == "continuous":
            raise ValueError("found 'continuous', expected a selection method")
        return start


class OwnChoiceConfig(ChoiceConfig, OwnSection):
    """A method of somebody else's class, with its options."""

    chooses = "method"
    method: Annotated[str, ClassMark("METHODS", beside=True)]
    """Class of the method, `file.py:Class`; its options stand beside it."""


BUILT_IN = ("random", "exchange", "continuous")


def _tag_choice(section: object) -> str:
    method = section.get("method") if isinstance(section, dict) else getattr(section, "method", None)
    return method if method in BUILT_IN else OWN


type SelectionChoice = Annotated[
    Annotated[RandomChoiceConfig, Tag("random")]
    | Annotated[ExchangeChoiceConfig, Tag("exchange")]
    | Annotated[ContinuousChoiceConfig, Tag("continuous")]
    | Annotated[OwnChoiceConfig, Tag(OWN)],
    Discriminator(_tag_choice),
]


# --- what comes of it --------------------------------------------------------------------------------------------


class CalibrationsConfig(Section):
    """Simulated calibrations with each set of poses: machines drawn within the tolerances, measured and identified."""

    machines: Annotated[int, Field(ge=2, le=10_000)] = 20
    """Number of machines drawn within the tolerances."""
    use_priors: bool = True
    """Whether the identification uses the tolerances as priors; else it is least squares, weighted by the noise."""


class MeasuredModelConfig(ModelConfig):
    """A kinematic model with a deformation, and what measures it."""

    sensors: Annotated[Names, Field(min_length=1)]
    """Sensors that measure each pose."""


class SelectionConfig(ExperimentConfig):
    """An experiment on pose selection."""

    kind: Literal["selection"]
    """`"selection"`."""
    provenance: ProvenanceConfig
    """Where machine and numbers come from."""
    machine: InputFile
    """The mechanism's TOML file."""
    variant: MeasuredModelConfig
    """Model, deformation, free parameters and sensors."""
    units: UnitsConfig = UnitsConfig()
    """Units of tolerances, requirements and results."""
    deformation: DeformationConfig = DeformationConfig()
    """Nominal deformation of the platform."""
    parameters: dict[str, PriorConfig]
    """Tolerance of each symbol."""
    noise: ActuatorNoiseConfig
    """Noise of the actuators and model error."""
    sensors: dict[str, SensorConfig]
    """Instruments by name."""
    workspace: WorkspaceConfig | None = None
    """Where accuracy counts."""
    requirements: RequirementsConfig = RequirementsConfig()
    """What is required there."""
    domain: DomainConfig
    """Where poses may be."""
    candidates: CandidatesConfig = CandidatesConfig()
    """Poses to choose from."""
    jacobian: Literal["pose", "angles", "closure"] = "pose"
    """What the indices judge: the `pose`, position and `angles`, or the `closure` of the legs."""
    selections: Annotated[list[SelectionChoice], Field(min_length=1)]
    """Methods, with criteria and numbers of poses."""
    designs: list[DesignConfig] = Field(default=[])
    """Sets of poses that somebody else has chosen."""
    measured: ActuatorTableConfig | None = None
    """Poses that are measured already and count."""
    calibrations: CalibrationsConfig | None = None
    """Simulated calibrations with the poses found."""

    @model_validator(mode="after")
    def _check_whole(self) -> Self:
        if all(prior.prior == "fixed" for prior in self.parameters.values()):
            raise ValueError("found no tolerance, expected [parameters] with a normal or uniform prior")
        if self.workspace is None:
            for what, needed in (
                ("[calibrations]", self.calibrations is not None),
                ("[requirements]", self.requirements.is_any),
                ("criterion 'I'", any("I" in choice.criteria for choice in self.selections)),
            ):
                if needed:
                    raise ValueError(f"found {what} without [workspace], expected both")
        seen: set[object] = {design.name for design in self.designs}
        if len(seen) < len(self.designs):
            raise ValueError("found two designs of one name, expected unique names")
        for choice in self.selections:
            label = label_of(choice)
            for key in (
                (label, criterion, n) for criterion in map(label_class, choice.criteria) for n in choice.n_poses
            ):
                if key in seen or label in seen:
                    raise ValueError(
                        f"found {label!r} twice for criterion {key[1]}, {key[2]} poses, expected unique labels"
                    )
                seen.add(key)
        list(self._named_criteria())
        return self

    @property
    def criteria(self) -> dict[str, str]:
        """The criteria of all selections, as the config names them, by what tables call them."""
        return dict(self._named_criteria())

    def _named_criteria(self) -> Iterator[tuple[str, str]]:
        """Yield criteria with their labels; ValueError where a label stands for two of them."""
        found: dict[str, tuple[str, object]] = {}
        for criterion in (one for choice in self.selections for one in choice.criteria):
            label, what = label_class(criterion), (str(criterion), getattr(criterion, "options", None) or {})
            if found.setdefault(label, what) != what:
                raise ValueError(f"found two criteria named {label!r}")
            yield label, criterion


def label_of(choice: ChoiceConfig) -> str:
    """Return what a choice is called in tables and figures."""
    return choice.label or label_class(choice.method)  # type: ignore[attr-defined]  # of every kind of choice
