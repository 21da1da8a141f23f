"""The schema of a sweep: an experiment, the keys that vary, and the figures of its summary that are kept."""

from __future__ import annotations

import math
from typing import Annotated, Any, Literal, Self

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
    """Dotted key of the experiment, or `machine.toml:legs.length_mm` of another of its files; several vary together."""
    label: str = ""
    """What the page calls it."""
    unit: str = ""
    """Its unit, for the page."""
    values: Annotated[list[Any], Field(min_length=1)] | None = None
    """Values that it takes."""
    factors: Annotated[list[Positive], Field(min_length=1)] | None = None
    """Factors on what the files say [1]."""
    range: Annotated[list[Number], Field(min_length=2, max_length=2)] | None = None
    """Smallest and largest value, with `count` [unit of the key]."""
    count: Annotated[int, Field(ge=2, le=MAX_MEMBERS)] | None = None
    """How many values there are in the range."""
    scale: Scale = "linear"
    """Whether they are spread on a `linear` or a `log` scale, and drawn so."""

    @model_validator(mode="after")
    def _check(self) -> Self:
        given = [name for name in ("values", "factors", "range") if getattr(self, name) is not None]
        if len(given) != 1:
            raise ValueError(f"found {' and '.join(given) or 'none'}, expected one of values, factors and range")
        if (self.count is None) != (self.range is None):
            raise ValueError("expected range with count, or neither")
        if self.range is not None and self.scale == "log" and min(self.range) <= 0.0:
            raise ValueError(f"found range {self.range} on a log scale, expected positive numbers")
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
    def title(self) -> str:
        """What the page calls it."""
        return self.label or self.name

    @property
    def settings(self) -> list[Any]:
        """What the axis takes, factors where it has these."""
        if self.range is not None and self.count is not None:
            import numpy as np

            space: Any = np.geomspace if self.scale == "log" else np.linspace
            return [float(f"{value:.6g}") for value in space(self.range[0], self.range[1], self.count)]
        return list(self.values if self.values is not None else self.factors or [])


class FigureConfig(Section):
    """A figure of the experiment's summary by its dotted key, and what is required of it."""

    key: str
    """Dotted key of `summary.json`."""
    label: str = ""
    """What the page calls it."""
    unit: str = ""
    """Its unit, for the page."""
    scale: Scale = "linear"
    """Scale on which it is drawn."""
    at_most: Number | None = None
    """Largest value that is allowed [unit of the figure]."""
    at_least: Number | None = None
    """Smallest value that is allowed [unit of the figure]."""

    @model_validator(mode="after")
    def _check(self) -> Self:
        if self.at_most is not None and self.at_least is not None:
            raise ValueError("expected at_most or at_least")
        return self

    @property
    def title(self) -> str:
        """What the page calls it."""
        return self.label or self.key

    @property
    def limit(self) -> float | None:
        """What is required of it, from either side."""
        return self.at_least if self.at_most is None else self.at_most

    @property
    def side(self) -> str:
        """From which side."""
        return "at least" if self.at_most is None else "at most"


class SweepConfig(ExperimentConfig):
    """A sweep: every combination of its axes, or their entries row by row."""

    kind: Literal["sweep"]
    """`"sweep"`."""
    experiment: InputFile
    """TOML file of the experiment that is varied."""
    overrides: dict[str, Any] = Field(default={})
    """Keys that are filled into the experiment for all members, as a config is that extends another."""
    mode: Literal["grid", "zip"] = "grid"
    """Every combination of the axes (`grid`), or their entries row by row (`zip`)."""
    axes: Annotated[list[AxisConfig], Field(min_length=1)]
    """Keys that vary."""
    figures: Annotated[list[FigureConfig], Field(min_length=1)]
    """Figures of the summary that are kept."""
    cache_dir: Annotated[str, Field(pattern=r"^(\.?[A-Za-z0-9_-][A-Za-z0-9_.-]*)?$")] = ".bayescal_members"
    """Folder beside the results directory that members are kept in for other sweeps; none where it is empty."""

    @model_validator(mode="after")
    def _check(self) -> Self:
        names = [axis.name for axis in self.axes] + [figure.key for figure in self.figures]
        for name in names:
            if names.count(name) > 1:
                raise ValueError(f"found {name!r} twice among axes and figures, expected it once")
        counts = [len(axis.settings) for axis in self.axes]
        if self.mode == "zip" and len(set(counts)) > 1:
            raise ValueError(f"found axes of {counts} entries, expected equal numbers")
        if self.mode == "grid" and (n := math.prod(counts)) > MAX_MEMBERS:
            raise ValueError(f"found {n} combinations, expected at most {MAX_MEMBERS}")
        return self
