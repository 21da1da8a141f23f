"""The schema of an audit: a machine, its tolerances, planned measurements, what is required of it, what may change.

Keys that carry a unit are in it. Tolerances and requirements have no unit in their keys: they are in those of [units].
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Annotated, Final, Literal, Self

from pydantic import AfterValidator, Discriminator, Field, Tag, model_validator

from bayescal.config.classes import ClassMark
from bayescal.config.load import MEASURED, OWN
from bayescal.config.sections import (
    ExperimentConfig,
    Factor,
    InputFile,
    Name,
    Names,
    NotNegative,
    Positive,
    Section,
    check_once,
)
from bayescal.density.schema import ALONE, INDEPENDENT, ModelErrorConfig, PriorConfig, TermName
from bayescal.errors import say_reversed, say_twice
from bayescal.experiments.shared.readings.schema import ChannelConfig, FreeConfig, InstrumentConfig, NextReadingsConfig
from bayescal.experiments.shared.schema import (
    AccuracyFrame,
    AnyWorkspaceConfig,
    DeformationConfig,
    OwnSensorConfig,
    PoseSensorConfig,
    Range,
    TargetSensorConfig,
    UnitsConfig,
)
from bayescal.inference.schema import DrawsConfig
from bayescal.numerics.units import MICROMETRE

EXPECTED_UM: Final = 10.0

type Count = Annotated[int, Field(ge=1, le=10_000)]

# --- what measures, and where --------------------------------------------------------------------------------------


def _tag_sensor(section: object) -> str:
    if isinstance(section, ChannelConfig) or (isinstance(section, dict) and "kind" not in section):
        return f"{MEASURED}channel"
    kind = section.get("kind") if isinstance(section, dict) else getattr(section, "kind", None)
    return kind if kind in ("pose", "targets") else OWN


type ToolSensorConfig = PoseSensorConfig | TargetSensorConfig | OwnSensorConfig

type SensorConfig = Annotated[
    Annotated[PoseSensorConfig, Tag("pose")]
    | Annotated[TargetSensorConfig, Tag("targets")]
    | Annotated[OwnSensorConfig, Tag(OWN)]
    | Annotated[ChannelConfig, Tag(f"{MEASURED}channel")],
    Discriminator(_tag_sensor),
]


class PlannedPosesConfig(Section):
    """Where it is planned to measure: at random poses of the workspace, random actuator positions, or as a file says.

    A file of poses has ``pose``, the coordinates with their units such as ``x_mm``, what the machine has to know of
    each, and maybe ``instruments``: the names of those that read there, with spaces between, all where there is no such
    column. A file of configurations has displacements of the actuators. Random poses are led to sockets and planes.
    """

    sampling: Literal["workspace", "uniform", "extremes", "file"] = "workspace"
    """Random poses of the `workspace`; random actuator positions, `uniform` over their range or at its `extremes` and
    its middle; or those of a `file`.
    """
    count: Count | None = None
    """Number of random poses."""
    range_mm: Positive | None = Field(default=None, exclude_if=lambda value: value is None)
    """Largest displacement of an actuator to either side; the actuators' range where nothing is said."""
    file: InputFile | None = Field(default=None, exclude_if=lambda value: value is None)
    """CSV file of poses."""
    configurations: InputFile | None = Field(default=None, exclude_if=lambda value: value is None)
    """CSV file of actuator displacements from the middle of their range, a row a pose."""
    unit_mm: Positive = Field(default=1.0, exclude_if=lambda value: value == 1.0)
    """Unit of those in ``configurations`` that are lengths."""

    @model_validator(mode="before")
    @classmethod
    def _take_file(cls, value: object) -> object:
        return (
            {"sampling": "file", **value}
            if isinstance(value, dict) and {"file", "configurations"} & set(value)
            else value
        )

    @model_validator(mode="after")
    def _check_one(self) -> Self:
        files = (self.file is not None) + (self.configurations is not None)
        if self.sampling == "file" and (files != 1 or self.count is not None):
            raise ValueError("expected one of count, file and configurations")
        if self.sampling != "file" and (files or self.count is None):
            raise ValueError(f"expected count, no file, for sampling {self.sampling!r}")
        if self.unit_mm != 1.0 and self.configurations is None:
            raise ValueError("unit_mm: expected configurations with it")
        if self.range_mm is not None and self.sampling not in ("uniform", "extremes"):
            raise ValueError("range_mm: expected sampling 'uniform' or 'extremes' with it")
        return self


class AuditVariantConfig(FreeConfig):
    """A set of sensors and what is free with it; of a mechanism on legs its kinematic model, too."""

    name: Name = "all"
    """What tables call the variant."""
    title: str = ""
    """What the page calls it; its name where nothing is said."""
    sensors: Annotated[Names, Field(min_length=1)] | None = None
    """Sensors that measure each pose; all where nothing is said."""
    model: Annotated[str, ClassMark("MODELS")] | None = Field(default=None, exclude_if=lambda value: value is None)
    """Kinematic model of a mechanism on legs; `bayescal list models` shows all."""
    deformation: Annotated[str, ClassMark("DEFORMATIONS")] = Field(
        default="none", exclude_if=lambda value: value == "none"
    )
    """Deformation of a mechanism's platform; `bayescal list deformations` shows all."""

    @property
    def label(self) -> str:
        """What the page calls it."""
        return self.title or self.name


class AuditSelectionConfig(Section):
    """How many poses to choose out of how many random ones of the workspace."""

    count: Annotated[int, Field(ge=1, le=1000)]
    """Number of poses to choose."""
    candidates: Count = 300
    """Out of how many random ones of the workspace."""
    method: Literal["greedy", "exchange"] = "greedy"
    """Poses added one by one (`greedy`), and then exchanged for as long as that helps (`exchange`)."""

    @model_validator(mode="after")
    def _check_enough(self) -> Self:
        if self.candidates < self.count:
            raise ValueError(f"found {self.candidates} candidates, expected at least {self.count}")
        return self


class SensorChoiceConfig(FreeConfig):
    """Sensors to choose from, for the poses planned.

    A name among ``candidates`` is one sensor, a kind each of its sensors by itself, a list an instrument whose readings
    are there together. Those of ``required_sensors`` are in every set, ``max_sensors`` is how many candidates a set has
    at most. All sets are judged where these are no more than ``max_exhaustive_sets``; else sensors are added one by one
    and exchanged.
    """

    candidates: Annotated[
        list[str | Annotated[Names, Field(min_length=1)]], Field(min_length=1), AfterValidator(check_once)
    ]
    """Sensors to choose from; a list is one instrument of several readings."""
    required_sensors: Names = Field(default=[])
    """Sensors that are in every set."""
    max_sensors: Annotated[int, Field(ge=1, le=1000)] | None = None
    """How many candidates a set has at most."""
    max_exhaustive_sets: Annotated[int, Field(ge=0, le=100_000)] = 4096
    """Up to how many sets all are judged."""
    costs: dict[str, NotNegative] = Field(default={}, exclude_if=lambda value: not value)
    """By candidate or kind, an instrument's readings joined by ` + `: its cost [any currency]."""


class AuditDataConfig(Section):
    """A study whose measured poses are audited instead of a plan, with its priors and its posterior."""

    study: InputFile
    """TOML file of a study, whose measured poses are audited."""
    variant: str | None = None
    """One of its variants by name, where several have the audit's model and deformation."""
    with_model_error: bool = True
    """Whether the posterior has a model error."""


class ExpectedErrorConfig(ModelErrorConfig):
    """What the models leave out, as a study of the plan takes it, and how large it is expected to be.

    Nothing is measured yet, so that sizes cannot be found in data: those expected are stated, and the audit takes those
    that a study of the plan, with these terms and priors, would find then.
    """

    expected_um: NotNegative | dict[TermName, NotNegative] = Field(
        default=EXPECTED_UM, exclude_if=lambda value: value == EXPECTED_UM
    )
    """Root mean square, over the planned poses, that all terms but `random` have together, or that of each term by
    name. The page says what none and three times as much of them would do.
    """

    def sizes(self, there: Sequence[str]) -> dict[str, float]:
        """Return the root mean square that each term is expected to have, mm, of those that there can be."""
        expected = self.expected_um
        if not isinstance(expected, dict):
            functions: list[TermName] = [name for name in self.terms if name in there and name not in ALONE]
            expected = dict.fromkeys(functions, expected / max(1, len(functions)) ** 0.5)
        names = (name for name in self.terms if name in there)
        return {name: MICROMETRE * expected.get(name, 0.0) for name in names}

    @property
    def tau(self) -> float:
        """Standard deviation of errors that change from pose to pose, mm, with what it is at least."""
        return math.hypot(self.sizes(ALONE).get(INDEPENDENT, 0.0), self.lengths().get(INDEPENDENT, 0.0))

    @model_validator(mode="after")
    def _check_expected(self) -> Self:
        if isinstance(self.expected_um, dict) and (strange := set(self.expected_um) - set(self.terms)):
            raise ValueError(f"expected_um: found {sorted(strange)}, expected one of {self.terms}")
        self.check_floors(self.terms)
        return self


# --- what would help ------------------------------------------------------------------------------------------------


class ScenarioConfig(Section):
    """A change of the plan; what is not named stays."""

    name: str
    """What the page calls the change."""
    poses_factor: Annotated[Positive, Field(ge=1e-4, le=1e4)] = 1.0
    """Factor on the number of poses [1]."""
    workspace_factor: Factor = 1.0
    """Factor on the displacements [1]."""
    noise_factor: Factor = 1.0
    """Factor on the noise of the instruments [1]."""
    actuator_noise_factor: Factor = 1.0
    """Factor on the noise of the actuators, and of all sensors that the machine keeps [1]."""
    sensors: Annotated[Names, Field(min_length=1)] | None = None
    """Other sensors."""
    poses: PlannedPosesConfig | None = None
    """Another plan."""
    model_error: bool = Field(default=True, exclude_if=lambda value: value)
    """Whether legs or channels err by functions of the pose as they do in the plan."""


class AuditSweepConfig(Section):
    """Factors on the sensors' noise and on the actuators' range, and numbers of poses, one swept at a time."""

    noise: Annotated[list[Factor], AfterValidator(check_once)] = Field(default=[0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0])
    """Factors on the noise of the instruments [1]."""
    poses: Annotated[list[Count], AfterValidator(check_once)] = Field(default=[6, 8, 10, 15, 20, 30, 40, 60, 100, 200])
    """Numbers of poses."""
    workspace: Annotated[list[Factor], AfterValidator(check_once)] = Field(default=[0.25, 0.5, 1.0, 2.0, 4.0])
    """Factors on the displacements [1]."""


OF_PLANS = (
    "machine",
    "instruments",
    "sensors",
    "parameters",
    "conditions",
    "poses",
    "deformation",
    "selection",
    "sensor_selection",
)
"""What is said of a machine that is to be measured alone."""
ACTUATORS = "rho"
"""The sensors that are a mechanism's actuators."""
_ALONE = {"terms": ALONE}


class AuditConfig(ExperimentConfig):
    """What a calibration of any machine would determine, or has determined, and how accurate the machine then is.

    It takes readings of the machine's channels and of instruments beside it, with the noise of [sensors]. ``noise``
    with ``actuator_um``, as studies have it, is that of a mechanism's actuators, ``rho`` in [sensors].
    """

    kind: Literal["audit"]
    """`"audit"`."""
    machine: InputFile | None = None
    """The machine's TOML file; a mechanism's is one."""
    instruments: dict[Name, InstrumentConfig] = Field(default={}, exclude_if=lambda value: not value)
    """By name: instruments beside the machine."""
    sensors: dict[str, SensorConfig] = Field(default={})
    """Noise of each channel, or of all of a kind; or by name sensors that see poses, or a part of them, with their
    kind.
    """
    model_error: ExpectedErrorConfig = ExpectedErrorConfig()
    """What the models leave out, beside the noise: the terms of a study that is silent on it where nothing is said."""
    units: UnitsConfig = UnitsConfig()
    """Units of tolerances, requirements and results."""
    parameters: dict[str, PriorConfig] = Field(default={})
    """Tolerance of each symbol."""
    deformation: DeformationConfig = DeformationConfig()
    """Nominal deformation of a mechanism's platform."""
    data: AuditDataConfig | None = None
    """A study of measured poses instead of a plan."""
    posterior: DrawsConfig = DrawsConfig()
    """Effort of draws of the study's posterior, beside [data]."""
    workspace: AnyWorkspaceConfig = Field(default={})
    """Where accuracy counts: by coordinate its smallest and largest value, the machine's own where nothing is said; or
    half widths about the home pose of a machine whose coordinates are a pose's [unit of the coordinate].
    """
    conditions: dict[str, Range] = Field(default={}, exclude_if=lambda value: not value)
    """By column: smallest and largest value of what the machine has to know of a row [unit of the column]."""
    poses: PlannedPosesConfig = PlannedPosesConfig(count=40)
    """Where it is planned to measure."""
    requirements: dict[str, Positive] = Field(default={})
    """By coordinate of the tool: largest error [units]."""
    requirement_applies_to: Literal["all_poses", "rms"] = "all_poses"
    """Whether errors keep these limits at every pose of the workspace (`all_poses`), or their `rms` over it."""
    accuracy_frame: AccuracyFrame = Field(default="aligned", exclude_if=lambda value: value == "aligned")
    """Whether accuracy of variants, requirements and sets is what remains after a best fit of the frames of base and
    tool (`aligned`), or is relative to marks on the `base`.
    """
    variants: Annotated[list[AuditVariantConfig], Field(min_length=1)] = Field(default=[AuditVariantConfig()])
    """Sets of sensors to judge."""
    scenarios: list[ScenarioConfig] = Field(default=[])
    """Changes of the plan whose effect is shown."""
    sweep: AuditSweepConfig = AuditSweepConfig()
    """Factors and numbers of poses that the page's curves go over."""
    profiles: Names = Field(default=[])
    """Parameters whose profiles are drawn; a few that matter where nothing is said."""
    n_simulated_calibrations: Annotated[int, Field(ge=0, le=10_000)] = 0
    """How many calibrations are simulated to see whether the predicted deviations come true."""
    n_prior_draws: Annotated[int, Field(ge=0, le=10_000)] = 0
    """Over how many machines within the tolerances predictions are averaged."""
    next: NextReadingsConfig = NextReadingsConfig()
    """What to measure besides."""
    selection: AuditSelectionConfig | None = None
    """Poses to choose."""
    sensor_selection: SensorChoiceConfig | None = None
    """Sensors to choose."""

    def split_sensors(self) -> tuple[dict[str, ChannelConfig], dict[str, ToolSensorConfig]]:
        """Return the noise of channels, and the sensors that see poses, by name."""
        channels, others = dict[str, ChannelConfig](), dict[str, ToolSensorConfig]()
        for name, one in self.sensors.items():
            if isinstance(one, ChannelConfig):
                channels[name] = one
            else:
                others[name] = one
        return channels, others

    @model_validator(mode="before")
    @classmethod
    def _take_others(cls, content: object) -> object:
        """Sizes are those that a study found."""
        if not isinstance(content, dict) or content.get("data") is None:
            return content
        stated = content.get("model_error", _ALONE)
        if stated != _ALONE and stated != ExpectedErrorConfig(terms=ALONE).model_dump():
            raise ValueError(f"model_error: found it with [data], expected none, or terms = {ALONE}")
        return content | {"model_error": _ALONE}

    @model_validator(mode="before")
    @classmethod
    def _take_actuators(cls, content: object) -> object:
        """Noise of actuators, as studies of a mechanism state it, is that of its sensors, which all variants have."""
        if not isinstance(content, dict) or not isinstance(noise := content.get("noise"), dict):
            return content
        if "actuator_um" not in noise:
            raise ValueError("noise: expected actuator_um, or [sensors]")
        if strange := set(noise) - {"actuator_um"}:
            raise ValueError(f"noise: found {', '.join(sorted(strange))}, expected [model_error] with expected_um")
        sensors = {ACTUATORS: {"noise_um": noise["actuator_um"]}, **content.get("sensors", {})}
        changed = {key: value for key, value in content.items() if key != "noise"} | {"sensors": sensors}
        for key in ("variants", "scenarios"):
            if isinstance(content.get(key), list):
                changed[key] = [_add_actuators(one) for one in content[key]]
        return changed

    @model_validator(mode="after")
    def _check_names(self) -> Self:
        check_once([one.name for one in self.scenarios])
        names = [one.name for one in self.variants]
        for name in names:
            if names.count(name) > 1:
                raise ValueError(say_twice("variants", name))
        for name, (low, high) in self.workspace.items() if isinstance(self.workspace, dict) else ():
            if not low < high:
                raise ValueError(say_reversed(f"workspace.{name}", low, high))
        return self

    @model_validator(mode="after")
    def _check_parts(self) -> Self:
        if self.data is not None:
            for field in OF_PLANS:
                if self._states(field):
                    raise ValueError(f"found {field} with [data], expected none")
            self._check_data()
        else:
            for field in ("machine", "sensors", "parameters"):
                if not getattr(self, field):
                    raise ValueError(f"found no {field}, expected it, or [data]")
            if all(prior.prior == "fixed" for prior in self.parameters.values()):
                raise ValueError("found no tolerance, expected a normal or uniform prior")
            deforms = self._states("deformation") or any(one.deformation != "none" for one in self.variants)
            if deforms and all(one.model is None for one in self.variants):
                raise ValueError("deformation: expected a model in [[variants]] with it")
        if self.data is None and self._states("posterior"):
            raise ValueError("posterior: expected [data] with it")
        if self.conditions and self.poses.file is not None:
            raise ValueError("conditions: found with poses.file, expected either")
        for change in self.scenarios:
            if not change.model_error and self.data is None and self.model_error.terms in ([], ALONE):
                raise ValueError(f"scenario {change.name!r}: model_error: found none to leave out")
        return self

    def _states(self, name: str) -> bool:
        """Whether a section says something else than nothing."""
        return bool(getattr(self, name) != type(self).model_fields[name].get_default())

    def _check_data(self) -> None:
        if len(self.variants) > 1:
            raise ValueError("variants: found several with [data], expected one")
        for name in ("free", "fixed", "tied", "sensors"):
            if getattr(self.variants[0], name):
                raise ValueError(f"variants.{name}: found with [data], expected none")
        for change in self.scenarios:
            if change.sensors is not None:
                raise ValueError(f"scenario {change.name!r}: sensors: found with [data], expected none")


def _add_actuators(section: object) -> object:
    """Return a variant or a change whose sensors, where it states any, have the actuators among them."""
    if not isinstance(section, dict) or not isinstance(sensors := section.get("sensors"), list):
        return section
    return section if ACTUATORS in sensors else section | {"sensors": [ACTUATORS, *sensors]}
