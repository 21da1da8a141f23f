"""The schema of a self-test."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from bayescal.config.sections import Names
from bayescal.experiments.shared.derived import OfAnotherConfig


class SelftestConfig(OfAnotherConfig):
    """A self-test of a study's config."""

    kind: Literal["selftest"]
    """`"selftest"`."""
    variants: Names = Field(default=[])
    """Variants to test; the best by evidence where nothing is said."""
    data_sets: Annotated[int, Field(ge=4, le=10_000)] = 60
    """Data sets simulated of the priors, and as many of the posterior."""
    draws: Annotated[int, Field(ge=200, le=1_000_000)] = 4000
    """Draws of each data set's posterior."""
