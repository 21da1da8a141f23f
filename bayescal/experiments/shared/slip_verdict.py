"""What a search for slips found: causes as they were weighed, the one that is named, and whether it is a slip."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from bayescal.experiments.shared.slip_causes import Cause
from bayescal.experiments.shared.slips import CHANNEL, FRAME, LEGS, POSES, ROWS, UNIT, FoundSlip

MIN_CAUSE_GAIN_NAT = 3.0
"""Nats by which a cause has to explain the readings better, all of its kind that were tried counted: 20 to 1."""
SURE_OF_SLIP = 10.0
"""The same of a slip beside a model error that could make up for it: one in a thousand tables has one, and 20 to 1."""
BEYOND = 10.0
"""Times what was allowed for of errors of readings, beyond which machines do not err and tables do."""
SLIPS = (UNIT, LEGS, ROWS, POSES, CHANNEL, FRAME)
"""Causes that are slips of the data: other kinds of experiments than checks name these alone."""
STATED = 1.5
"""Rms of the rows in noise and model errors as stated up to which nothing has slipped."""
MIN_MISFIT_RATIOS = {POSES: 1.5, ROWS: 1.5}
"""Factor by which the misfit has to fall for a slip to be named, 3 but for what is named here: angles read in another
way are off by little at tilts of some degrees, by two to five times what was stated, and a row is one of many."""
USUALLY_BETTER = 3.0


@dataclass(frozen=True, eq=False)
class ScoredCause:
    """A cause, by how many nats it explains the readings better, all that were tried counted, and its words."""

    cause: Cause
    gain: float
    text: str
    misfit: float
    factor: float  # on a noise or a tolerance
    cost: float  # nats, for all that were tried
    change: float  # rms of what it does to readings, in what was allowed for
    rms_without_model_error: float = np.inf  # of the residuals, in the noise


@dataclass(frozen=True)
class Rival:
    """A cause in words, and the log-density of the readings by it, all that were tried counted."""

    text: str
    value: float


@dataclass(frozen=True)
class NamedCause:
    """What is named first: the best cause and those alike, the gain, and the nats between them and the next one.

    ``misfit`` is the rms of the readings in their noise that the best one leaves, ``change`` the rms of what it does to
    them in what was allowed for; see `bayescal.experiments.shared.slip_search`.
    """

    fault: str
    faults: tuple[str, ...]
    text: str
    gain: float
    odds: float
    rival: str
    misfit: float
    change: float

    @property
    def is_plausible(self) -> bool:
        """Whether a slip is what explains the data, and no model error: by its odds, its size, and what it leaves."""
        sure = self.gain > SURE_OF_SLIP and self.odds > MIN_CAUSE_GAIN_NAT and self.fault != POSES
        return sure and self.change > BEYOND and self.misfit <= STATED


@dataclass(frozen=True, eq=False)
class Search:
    """What a search found: what is named first, all that was fitted, how many were tried, whether time ran out.

    ``misfit`` is the rms of the readings in noise and errors as stated that the best machine leaves of them as they
    are, infinite where no machine within the tolerances has any of them. Of slips planted in data that fit,
    ``unnoticed`` are those after which they fit all the same.
    """

    misfit: float
    first: NamedCause | None = None
    weighed: list[ScoredCause] = field(default_factory=list)
    tried: int = 0
    stopped: bool = False
    unnoticed: list[str] = field(default_factory=list)

    @property
    def slip(self) -> FoundSlip | None:
        """What is named first where it is a slip.

        Of data that are far from every machine within the tolerances, or one that is more probable than a model error
        as large as the data would need without it.
        """
        first = self.first
        if first is None or not set(first.faults) <= set(SLIPS):
            return None
        factor = self.misfit / max(first.misfit, 1.0)
        far = self.misfit > STATED and factor > MIN_MISFIT_RATIOS.get(first.fault, USUALLY_BETTER)
        if not far and not first.is_plausible:
            return None
        limited = np.isfinite(factor)
        return FoundSlip(first.fault, first.text, first.gain if limited else np.inf, factor if limited else None)
