"""The schema of a sweep: an experiment, the keys that vary, and the figures of its summary that are kept."""

from __future__ import annotations

from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import Field, model_validator

from bayescal.config.sections import ExperimentConfig, InputFile, Number, Positive, Section

MAX_MEMBERS = 100_000
SEED = "seed"

type Scale = Literal["linear", "log"]


class AxisConfig(Section):
    """A key of the experiment, or of another of its files, and what it takes.

    ``key`` is dotted, as in ``sensors.tracker.position_um``, entries of lists by their numbers from zero;
    ``machine.toml:legs.length_mm`` is a key of another TOML file that the experiment reads. Several keys vary together.
    Factors multiply what the files say.
    """

    key: str | Annotated[list[str], Field(min_length=1)]
    label: str = ""
    unit: str = ""
    values: Annotated[list[Any], Field(min_length=1)] | None = None
    factors: Annotated[list[Positive], Field(min_length=1)] | None = None
    between: Annotated[list[Number], Field(min_length=2, max_length=2)] | None = None
    count: Annotated[int, Field(ge=2, le=MAX_MEMBERS)] | None = None
    scale: Scale = "linear"

    @model_validator(mode="after")
    def _check(self) -> Self:
        given = [name for name in ("values", "factors", "between") if getattr(self, name) is not None]
        if len(given) != 1:
            raise ValueError(f"found {' and '.join(given) or 'none'}, expected one of values, factors and between")
        if (self.count is None) != (self.between is None):
            raise ValueError("found one of between and count, expected both or none")
        if self.between is not None and self.scale == "log" and min(self.between) <= 0.0:
            raise ValueError(f"found between {self.between} on a log scale, expected positive numbers")
        return self

    @property
    def keys(self) -> list[str]:
        """The keys that vary together."""
        return [self.key] if isinstance(self.key, str) else self.key

    @property
    def name(self) -> str:
        """What tables call the axis."""
        return self.keys[0]

    @property
    def settings(self) -> list[Any]:
        """What the axis takes, factors where it has these."""
        if self.between is not None and self.count is not None:
            space: Any = np.geomspace if self.scale == "log" else np.linspace
            return [float(f"{value:.6g}") for value in space(self.between[0], self.between[1], self.count)]
        return list(self.values if self.values is not None else self.factors or [])


class FigureConfig(Section):
    """A figure of the experiment's summary by its dotted key, and what is required of it."""

    key: str
    label: str = ""
    unit: str = ""
    scale: Scale = "linear"
    at_most: Number | None = None
    at_least: Number | None = None

    @model_validator(mode="after")
    def _check(self) -> Self:
        if self.at_most is not None and self.at_least is not None:
            raise ValueError("found at_most and at_least, expected one of them")
        return self


class SweepConfig(ExperimentConfig):
    """A sweep: every combination of its axes, or their entries row by row (``combine = "list"``).

    ``set`` is filled into the experiment for all members, as a config is that extends another.
    ``cache`` is the folder, beside the results directory, that members are kept in for other sweeps; none where it is
    empty.
    """

    kind: Literal["sweep"]
    experiment: InputFile
    set: dict[str, Any] = Field(default={})
    combine: Literal["grid", "list"] = "grid"
    axes: Annotated[list[AxisConfig], Field(min_length=1)]
    figures: Annotated[list[FigureConfig], Field(min_length=1)]
    cache: Annotated[str, Field(pattern=r"^[A-Za-z0-9_.-]*$")] = ".bayescal_members"

    @model_validator(mode="after")
    def _check(self) -> Self:
        names = [axis.name for axis in self.axes] + [figure.key for figure in self.figures]
        for name in names:
            if names.count(name) > 1:
                raise ValueError(f"found {name!r} twice among the axes' first keys and the figures, expected it once")
        counts = [len(axis.settings) for axis in self.axes]
        if self.combine == "list" and len(set(counts)) > 1:
            raise ValueError(f"found axes of {counts} entries to combine row by row, expected as many of each")
        if self.combine == "grid" and (n := int(np.prod(counts, dtype=object))) > MAX_MEMBERS:
            raise ValueError(f"found {n} combinations, expected at most {MAX_MEMBERS}")
        return self
