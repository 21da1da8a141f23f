"""Sums of squares against what chance gives: limits hang on the degrees of freedom, few of which scatter widely."""

from __future__ import annotations

import math
from dataclasses import dataclass

from scipy.special import chdtr, chdtrc

from bayescal.report.numbers import format_significant

RARE = 1e-3
"""Probability of a deviation as large by chance, from which on it is said."""
WORTH_SAYING = 1.1
"""Factor on noise or tolerance below which a deviation changes no interval that matters."""


@dataclass(frozen=True)
class ChiSquare:
    """A sum of squares that should be χ²-distributed."""

    value: float
    dof: float

    @property
    def factor(self) -> float:
        """How many times larger the deviations are than stated."""
        return math.sqrt(self.value / self.dof) if self.dof > 0 else math.nan

    @property
    def chance(self) -> float:
        """Probability of as large a deviation to either side."""
        if not self.dof > 0:
            return 1.0
        return float(2 * min(chdtrc(self.dof, self.value), chdtr(self.dof, self.value), 0.5))

    @property
    def is_off(self) -> bool:
        """Whether it lies far from its expectation, by chance and by size."""
        return self.chance < RARE and max(self.factor, 1 / self.factor) > WORTH_SAYING


def format_chance(chance: float) -> str:
    """Return a probability in words."""
    return "p < 0.0001" if chance < 1e-4 else f"p = {format_significant(chance, 1)}"
