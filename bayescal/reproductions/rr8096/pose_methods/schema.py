"""The schema of the comparison of pose extraction methods."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import AfterValidator, Field

from bayescal.config.sections import ExperimentConfig, Positive, check_once


class PoseMethodsConfig(ExperimentConfig):
    """The simulation of RR-8096 figure 5: two ways to find a body's pose from its targets."""

    kind: Literal["pose_methods"]
    """`"pose_methods"`."""
    n_targets: Annotated[list[Annotated[int, Field(ge=3, le=1000)]], Field(min_length=1), AfterValidator(check_once)]
    """Numbers of targets."""
    repeats: Annotated[int, Field(ge=2, le=1_000_000)]
    """Draws of the noise for each."""
    length_mm: Positive
    """Length of the body that the targets sit on."""
    radius_mm: Positive
    """Its radius."""
    target_noise_um: Positive
    """Standard deviation of a target's coordinates."""
