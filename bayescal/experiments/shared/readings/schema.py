"""Sections of experiments on readings of channels; units of tolerances and of the workspace stand in [units]."""

from __future__ import annotations

from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from bayescal.config.classes import ClassMark, OwnSection
from bayescal.config.sections import InputFile, Names, NotNegative, Positive, Section

NOISE_UNITS = {"noise_um": "um", "noise_mm": "mm", "noise_arcsec": "arcsec", "noise_deg": "deg", "noise_rad": "rad"}


class ProvenanceConfig(Section):
    """Where the data come from: measured ones name their source and its licence."""

    status: Literal["measured", "simulated", "reconstructed", "unstated"]
    """Whether the data are `measured`, `simulated` or `reconstructed`; `unstated` where nobody says it."""
    text: str
    """What they are, in a sentence."""
    source: str = ""
    """Where they can be found; needed of measured ones."""
    licence: str = ""
    """Their licence; needed of measured ones."""

    @model_validator(mode="after")
    def _check_source(self) -> Self:
        if self.status == "measured" and not (self.source and self.licence):
            raise ValueError("found measured data, expected source and licence")
        return self


class ChannelConfig(Section):
    """Noise of a channel or of all of a kind, one value or one each; zero for a constraint.

    ``noise_group`` is under what name it shares unknown noise with others; by default its kind's.
    """

    noise: NotNegative | list[NotNegative] | None = None
    """Standard deviation of a reading; zero for a constraint [unit of the channel]."""
    noise_um: NotNegative | list[NotNegative] | None = None
    """The same."""
    noise_mm: NotNegative | list[NotNegative] | None = None
    """The same."""
    noise_arcsec: NotNegative | list[NotNegative] | None = None
    """The same."""
    noise_deg: NotNegative | list[NotNegative] | None = None
    """The same."""
    noise_rad: NotNegative | list[NotNegative] | None = None
    """The same."""
    noise_group: str = ""
    """Under what name it shares unknown noise with others; its kind's where nothing is said."""

    @model_validator(mode="after")
    def _check_one(self) -> Self:
        given = [name for name in ("noise", *NOISE_UNITS) if getattr(self, name) is not None]
        if len(given) != 1:
            found = " and ".join(given) or "no noise"
            raise ValueError(f"found {found}, expected one of noise, {', '.join(NOISE_UNITS)}")
        return self


class ModelErrorScaleConfig(Section):
    """Scale of the half-normal prior of a model error τ, in the channels' unit: mm, rad or another."""

    scale: Positive
    """Scale of the half-normal prior of the model error [unit of the channel]."""


class ErrorTermConfig(OwnSection):
    """An error of one cause that variants may have: `function`, or a user-defined class with its options beside it."""

    kind: Annotated[str, ClassMark("ERRORS", beside=True), Field(validate_default=True)] = "function"
    """`"function"`, or a user-defined `file.py:Class`; its options stand beside it."""


class InstrumentConfig(OwnSection):
    """An instrument beside the machine: channels and parameters, after its name, that any machine has more."""

    kind: Annotated[str, ClassMark("INSTRUMENTS", beside=True)]
    """`"point"`, `"pose"`, `"camera"`, `"distance"`, `"socket"`, `"plane"`, or a user-defined `file.py:Class`; its
    options stand beside it.
    """


class FreeConfig(Section):
    """What is free: symbols or parameters with a prior, all of them or those in ``free``, but for those in ``fixed``.

    Those of an entry of ``tied`` deviate alike, a symbol or a list of parameters. Sensors inside a machine tell
    nothing of where its frames are: ``fixed`` are then the parameters that define these.
    """

    free: Annotated[Names, Field(min_length=1)] | None = None
    """Symbols or parameters that are free; all with a prior where nothing is said."""
    fixed: Names = Field(default=[], exclude_if=lambda value: not value)
    """Symbols or parameters of these that stay nominal all the same."""
    tied: list[str | Names] = Field(default=[])
    """Symbols, or lists of parameters, that deviate alike."""


class ValidationConfig(Section):
    """Prediction of held-back readings: the poses for verification, or each of several folds of poses in turn."""

    folds: Annotated[int, Field(ge=0, le=100)] = 0
    """Folds of poses, each of which is predicted from the others; 0 for poses marked `verification` alone."""
    draws: Annotated[int, Field(ge=100, le=100_000)] = 400
    """Posterior draws that predict."""


class ReferenceValuesConfig(Section):
    """Values from elsewhere, which stay out of the fit: a CSV with ``quantity``, ``unit``, ``value``.

    A quantity is a parameter, or a channel that is read at home; an optional column ``sd`` says how well it is known.
    """

    file: InputFile
    """CSV file: quantity, unit, value, and sd where it is known; or the true parameters that a simulation wrote."""
    title: str = Field(default_factory=lambda known: known.get("file", ""))
    """What the page calls the values; the file where nothing is said."""
    source: str = ""
    """Where they come from."""


class NextReadingsConfig(Section):
    """What to measure next: that many random poses of the workspace are tried."""

    candidates: Annotated[int, Field(ge=0, le=10_000)] = 300
    """How many random poses are tried; 0 for none."""
    n_listed: Annotated[int, Field(ge=1, le=50)] = 5
    """How many of them are listed."""
