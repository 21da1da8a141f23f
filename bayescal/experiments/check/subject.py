"""What is checked: a variant of a machine that was measured, with other data of the same plan where simulated."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping, Sequence
from typing import Protocol

import numpy as np

from bayescal.density.priors import Prior
from bayescal.experiments.check.faults.finding import Finding
from bayescal.experiments.shared.slips import FoundSlip
from bayescal.inference.mode import Mode
from bayescal.inference.target import Target
from bayescal.numerics.geometry import Array

SLIPS = "Units and order"
TRIES = 100
NAMED = 3


class Checked(Target, Protocol):
    """A posterior whose parameters have names and priors."""

    @property
    def names(self) -> tuple[str, ...]:
        """Names of all parameters, those of the geometry first."""

    @property
    def priors(self) -> Mapping[str, Prior]:
        """Priors of the geometry's parameters by name."""


class Subject(ABC):
    """A variant as a check sees it, whatever its machine and its density."""

    @property
    @abstractmethod
    def posterior(self) -> Checked:
        """The posterior of the measured data."""

    @abstractmethod
    def list_arrays(self) -> list[Sequence[float]]:
        """Return the arrays of one data set's search; see `bayescal.experiments.frame.memory.estimate_arrays`."""

    # --- simulated data --------------------------------------------------------------------------------------------

    @abstractmethod
    def draw_case(self, rng: np.random.Generator) -> tuple[Array, Checked]:
        """Return a truth drawn from the priors, natural units, (n,), and the posterior of what is measured of it.

        Raises
        ------
        NumericalError
            Where hardly any draw of the priors is a machine that can take the poses.
        """

    @abstractmethod
    def repeat(self, natural: Array, y: Array, rng: np.random.Generator) -> Checked:
        """Return the posterior of the measured data and those simulated of a true machine together.

        The machine, with its errors, is given in natural units and in the posterior's coordinates, (n,) each.

        Raises
        ------
        NumericalError
            Where it cannot take the poses.
        """

    # --- measured data ---------------------------------------------------------------------------------------------

    @abstractmethod
    def check_derivatives(self, rng: np.random.Generator) -> Finding:
        """Return whether the model's derivatives are those of differences."""

    @abstractmethod
    def check_slips(self) -> Finding:
        """Return whether some slip explains the data better than they fit as they are."""

    @abstractmethod
    def check_noise(self, mode: Mode) -> Finding:
        """Return whether the noise is as stated; mode is the posterior's best."""

    @abstractmethod
    def list_starts(self, best: Array, rng: np.random.Generator) -> list[Array]:
        """Return coordinates (n,) from which a search may find other modes than the best, (n,)."""


def state_slips(found: FoundSlip | None, planted: tuple[int, list[str]]) -> Finding:
    """Return what the search for slips found, or which of those planted would pass unnoticed."""
    if found is not None:
        gain = f"better by {found.gain:.0f} nats" if np.isfinite(found.gain) else "they fit then"
        text = f"{found.text} ({gain}). Correct the table; all other findings rest on it."
        return Finding(SLIPS, found.fault, "bad", text)
    count, unnoticed = planted
    text = f"no other unit, sign or order of channels or rows explains the data better; of {count} planted slips "
    if not unnoticed:
        return Finding(SLIPS, "", "good", f"{text}none would pass unnoticed.")
    shown = [one.partition(":")[0] for one in unnoticed[:NAMED]]
    named = "; ".join(one.replace(" seem to be", "").replace(" seems to be", "") for one in shown)
    more = f"; {len(unnoticed) - NAMED} more" if len(unnoticed) > NAMED else ""
    return Finding(
        SLIPS, "", "good", f"{text}{len(unnoticed)} would pass unnoticed within the tolerances: {named}{more}."
    )


def list_names(names: Iterable[str]) -> str:
    """Return symbols of parameters, each once."""
    return ", ".join(dict.fromkeys(name.partition("[")[0] for name in names))
