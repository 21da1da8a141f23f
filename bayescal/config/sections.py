"""What every config is made of: checked sections, and numbers that are no slips.

Keys carry their units; lengths are in mm, noise in µm, angles in degrees.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field, FiniteFloat

LARGEST = 1e9  # beyond it, or as close to zero, a number is a slip and overflows when squared often enough
type Number = Annotated[FiniteFloat, Field(ge=-LARGEST, le=LARGEST)]
type Positive = Annotated[FiniteFloat, Field(gt=0, ge=1 / LARGEST, le=LARGEST)]
type NotNegative = Annotated[FiniteFloat, Field(ge=0, le=LARGEST)]
type PerLeg = Number | list[Number]
type PositivePerLeg = Positive | list[Positive]
type Vector = Annotated[list[Number], Field(min_length=3, max_length=3)]
type Name = Annotated[str, Field(pattern=r"^[A-Za-z0-9_-]+$")]


@dataclass(frozen=True)
class FileMark:
    """Marks a field that names an input file, whose content then belongs to the experiment's identity.

    Attributes
    ----------
    but : tuple of str
        Values that name no file.
    """

    but: tuple[str, ...] = ()


InputFile = Annotated[str, FileMark()]


class Section(BaseModel):
    """A table of a config: unknown keys and wrong types are errors; docstrings of its fields describe the keys."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, use_attribute_docstrings=True)


class ExperimentConfig(Section):
    """What the config of every experiment has."""

    kind: str
    """Kind of the experiment; `bayescal list kinds` shows all."""
    name: Name
    """Name of the results directory, and of the experiment in tables; letters, digits, `_` and `-`."""
    title: str
    """Headline of the page."""
    seed: Annotated[int, Field(ge=0)]
    """Seed of all random numbers: the same seed gives the same results."""
