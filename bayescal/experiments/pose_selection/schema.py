"""The schema of an experiment on pose selection: a machine as in an audit, where poses may be, how to choose them.

Tolerances and requirements are in the units of [units]; all other keys carry theirs.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Annotated, Any, Literal, Self

from pydantic import AfterValidator, Discriminator, Field, Tag, field_validator, model_validator

from bayescal.config.classes import ClassMark, OwnSection, label_class
from bayescal.config.load import OWN
from bayescal.config.sections import ExperimentConfig, InputFile, Name, Names, Positive, Section, check_once
from bayescal.density.schema import FixedConfig, PriorConfig
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

    within: Literal["workspace"]
    position_mm: Extent
    rotation_deg: Turns


class ActuatorDomainConfig(Section):
    """The actuators' range; with half widths about home the poses stay within these too."""

    within: Literal["actuators"]
    position_mm: Extent | None = None
    rotation_deg: Turns | None = None

    @model_validator(mode="after")
    def _check_both(self) -> Self:
        if (self.position_mm is None) != (self.rotation_deg is None):
            raise ValueError("expected both position_mm and rotation_deg, or none of them")
        return self


type DomainConfig = Annotated[WorkspaceDomainConfig | ActuatorDomainConfig, Field(discriminator="within")]


class CandidatesConfig(Section):
    """Poses to choose from: on an even grid, at random, or a full factorial, topped up.

    With ``redraw`` each repeat has its own.
    """

    spread: Literal["even", "random", "factorial"] = "random"
    count: Annotated[int, Field(ge=1, le=1_000_000)] = 2000
    levels: Annotated[int, Field(ge=2, le=1000)] = 11
    redraw: bool = False


class TableConfig(Section):
    """Actuator displacements from a CSV table, one row a pose."""

    configurations: InputFile
    unit_mm: Positive = 1.0


class DesignConfig(TableConfig):
    """Poses that somebody else has chosen, to be judged beside those found."""

    name: Name


# --- how they are chosen -----------------------------------------------------------------------------------------


class ChoiceConfig(Section):
    """A method with its options: every criterion with every number of poses, ``repeats`` times."""

    label: Name | None = None
    criteria: Annotated[list[CriterionName], Field(min_length=1), AfterValidator(check_once)]
    n_poses: Annotated[list[Count], Field(min_length=1), AfterValidator(check_once)]
    repeats: Annotated[int, Field(ge=1, le=10_000)] = 1


class RandomChoiceConfig(ChoiceConfig):
    """The best of random sets."""

    method: Literal["random"]
    n_sets: Count = 1


class DetmaxChoiceConfig(ChoiceConfig):
    """DETMAX."""

    method: Literal["detmax"]
    max_iterations: Count = 1000


class TabuChoiceConfig(ChoiceConfig):
    """Improved DETMAX with a tabu list."""

    method: Literal["tabu"]
    list_length: Annotated[int, Field(ge=0, le=100_000)] = 100
    iterations: Count = 219
    leave: bool = False


class ExchangeChoiceConfig(ChoiceConfig):
    """Eliminate and add."""

    method: Literal["exchange"]
    max_iterations: Count = 1000


class ContinuousChoiceConfig(ChoiceConfig):
    """All poses at once, from a random set or from what another method finds."""

    method: Literal["continuous"]
    start: Annotated[str, ClassMark("METHODS")] = "exchange"
    max_iterations: Count = 300

    @field_validator("start")
    @classmethod
    def _check_start(cls, start: str) -> str:
        if start == "continuous":
            raise ValueError("found 'continuous', expected a method that selects from the candidates")
        return start


class OwnChoiceConfig(ChoiceConfig, OwnSection):
    """A method of somebody else's class, with its options."""

    chooses = "method"
    method: Annotated[str, ClassMark("METHODS", beside=True)]


BUILT_IN = ("random", "detmax", "tabu", "exchange", "continuous")


def _tag_choice(section: Any) -> str:
    method = section.get("method") if isinstance(section, dict) else getattr(section, "method", None)
    return method if method in BUILT_IN else OWN


type SelectionChoice = Annotated[
    Annotated[RandomChoiceConfig, Tag("random")]
    | Annotated[DetmaxChoiceConfig, Tag("detmax")]
    | Annotated[TabuChoiceConfig, Tag("tabu")]
    | Annotated[ExchangeChoiceConfig, Tag("exchange")]
    | Annotated[ContinuousChoiceConfig, Tag("continuous")]
    | Annotated[OwnChoiceConfig, Tag(OWN)],
    Discriminator(_tag_choice),
]


# --- what comes of it --------------------------------------------------------------------------------------------


class CalibrationsConfig(Section):
    """Simulated calibrations with each set of poses: machines drawn within the tolerances, measured and identified.

    ``known``: the identification knows the tolerances; otherwise it is least squares, weighted by the noise.
    """

    machines: Annotated[int, Field(ge=2, le=10_000)] = 20
    known: bool = True


class PublishedConfig(Section):
    """What the source printed: a table of label, criterion, n_poses and value; and of random sets mean and maximum."""

    source: str
    table: InputFile | None = None
    random_mean: Positive | None = None
    random_max: Positive | None = None
    iterations: dict[str, Count] = Field(default={})


class SelectionConfig(ExperimentConfig):
    """An experiment on pose selection."""

    kind: Literal["pose_selection"]
    origin: str
    mechanism: InputFile
    variant: ModelConfig
    units: UnitsConfig = UnitsConfig()
    deformation: DeformationConfig = DeformationConfig()
    parameters: dict[str, PriorConfig]
    noise: ActuatorNoiseConfig
    sensors: dict[str, SensorConfig]
    measured_by: Annotated[Names, Field(min_length=1)]
    workspace: WorkspaceConfig | None = None
    requirements: RequirementsConfig = RequirementsConfig()
    domain: DomainConfig
    candidates: CandidatesConfig = CandidatesConfig()
    jacobian: Literal["pose", "angles", "closure"] = "pose"
    selections: Annotated[list[SelectionChoice], Field(min_length=1)]
    designs: list[DesignConfig] = Field(default=[])
    measured: TableConfig | None = None
    calibrations: CalibrationsConfig | None = None
    published: PublishedConfig | None = None

    @model_validator(mode="after")
    def _check_whole(self) -> Self:
        if all(isinstance(prior, FixedConfig) for prior in self.parameters.values()):
            raise ValueError("found no tolerance in [parameters], expected a normal or uniform prior of some")
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
            raise ValueError("found two designs of one name, expected a name for each")
        for choice in self.selections:
            label = label_of(choice)
            for key in (
                (label, criterion, n) for criterion in map(label_class, choice.criteria) for n in choice.n_poses
            ):
                if key in seen or label in seen:
                    raise ValueError(
                        f"found {label!r} twice for criterion {key[1]} and {key[2]} poses, expected a label for each"
                    )
                seen.add(key)
        list(self._named_criteria())
        labels = {label_of(choice) for choice in self.selections}
        for label in self.published.iterations if self.published is not None else ():
            if label not in labels:
                raise ValueError(f"published.iterations: found {label!r}, expected some of {', '.join(sorted(labels))}")
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
                raise ValueError(f"found two criteria of the name {label!r}, expected one")
            yield label, criterion


def label_of(choice: ChoiceConfig) -> str:
    """Return what a choice is called in tables and figures."""
    return choice.label or label_class(choice.method)  # type: ignore[attr-defined]  # of every kind of choice
