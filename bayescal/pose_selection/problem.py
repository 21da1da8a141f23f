"""What to select: how many poses, from which candidates, by which criterion, beside which poses measured already."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from bayescal.errors import InputError
from bayescal.numerics.geometry import Array
from bayescal.pose_selection.criteria import Criterion, Scorer
from bayescal.pose_selection.domain import Candidates


@dataclass(frozen=True, eq=False)
class SelectionProblem:
    """A choice of measurement poses."""

    candidates: Candidates
    criterion: Criterion
    n: int  # how many poses to select
    # (M, N): actuator positions, mm, of poses that have been measured already: their information stays
    measured: Array | None = None

    def __post_init__(self) -> None:
        """Check that the poses can determine the parameters, and that there are enough of them."""
        if self.n < self.least:
            raise InputError(
                f"poses: found {self.n}, expected at least {self.least} for {self.n_parameters} parameters"
                + (f" beside the {self.n_measured} measured" if self.n_measured else "")
            )
        if self.candidates.n_distinct < self.n:
            raise InputError(
                f"candidates: found {self.candidates.n_distinct} distinct of {len(self.candidates)} "
                f"poses, expected at least {self.n}"
            )
        bad = ~np.isfinite(self.blocks).all(axis=(1, 2))
        if bad.any():
            raise InputError(f"candidate {int(np.argmax(bad)) + 1}: found a Jacobian that is not finite")

    @property
    def n_parameters(self) -> int:
        """Number of parameters L, and of coefficients of errors that the criterion has beside them."""
        return int(self.blocks.shape[-1])

    @property
    def n_measured(self) -> int:
        """Number of poses measured already."""
        return 0 if self.measured is None else len(self.measured)

    @cached_property
    def least(self) -> int:
        """Least number of poses with which there can be as many rows as parameters."""
        rank = int(np.linalg.matrix_rank(self.base)) if len(self.base) else 0
        return max(1, -(-(self.n_parameters - rank) // self.blocks.shape[1]))

    @cached_property
    def blocks(self) -> Array:
        """Rows of each candidate, shape (C, k, L)."""
        parts = [self.criterion.rows(part) for part in self.candidates.see_in_parts()]
        return parts[0] if len(parts) == 1 else np.concatenate(parts)

    @cached_property
    def base(self) -> Array:
        """Rows of the prior and of the poses measured already, shape (b, L)."""
        prior = self.criterion.prior_rows(self.n_parameters)
        if self.measured is None:
            return prior
        good = np.isfinite(self.measured).all(axis=1)
        placed = self.candidates.domain.at_actuators(np.where(good[:, None], self.measured, 0.0))
        good &= placed.found
        if not good.all():
            raise InputError(f"measured pose {int(np.argmin(good)) + 1}: found actuator positions without a pose")
        rows = self.criterion.rows(self.candidates.domain.design.see(placed, "measured pose"))
        return np.concatenate([prior, rows.reshape(-1, self.n_parameters)])

    def scorer(self) -> Scorer:
        """Return a scorer for the candidates, its set empty."""
        return self.criterion.scorer(self.blocks, self.base, self.n_measured)

    def value_of(self, blocks: Array) -> float:
        """Return the criterion of a set with the rows (n, k, L), computed again."""
        rows = np.concatenate([self.base, blocks.reshape(-1, self.n_parameters)])
        return float(self.criterion.value(rows, self.n_measured + len(blocks)))

    def draw_set(self, rng: np.random.Generator) -> np.ndarray:
        """Return the numbers of a random set of n distinct candidates, shape (n,)."""
        return np.asarray(rng.permutation(np.flatnonzero(self.candidates.distinct))[: self.n])
