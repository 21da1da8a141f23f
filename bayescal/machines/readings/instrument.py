"""An instrument beside a machine: channels and parameters that are functions of the tool's pose."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping, Sequence
from copy import copy
from dataclasses import replace
from typing import ClassVar, Literal, Self

import numpy as np

from bayescal.machines.parameters import ParameterBlock
from bayescal.machines.readings.base import (
    Given,
)
from bayescal.machines.readings.closed_forms import (
    list_turns,
)
from bayescal.machines.readings.function import Parameters, ReadingMachine
from bayescal.numerics.analytic import rotation_matrix
from bayescal.numerics.geometry import Array

UNSTATED = (float("nan"),) * 3


class Instrument(ReadingMachine):
    """What an instrument has to say: its parameters and channels, and what these read of the tool.

    A subclass is named in a config, ``[instruments.NAME]`` with ``kind = "own.py:Own"``, and made of its checked
    options. NAME goes before its symbols and channels: ``frame`` is ``NAME_frame``, ``[x]`` is ``NAME[x]``, ``r[x]`` is
    ``NAME_r[x]``, a channel without a name is ``NAME``.

    Examples
    --------
    A dial gauge that reads the tool's height above a plate:

    >>> class Gauge(bc.Instrument):
    ...     parameters = [bc.ParameterBlock("plate", (0.0,), per_leg=False)]
    ...     channels = [bc.Channel("", "mm")]
    ...
    ...     def see(self, parameters, position, rotation):
    ...         return (position[..., 2] - parameters["plate"])[..., None]
    >>> Gauge().read({"plate": 5.0}, np.array([0.0, 0.0, 30.0, 0.0, 0.0, 0.0]), {})
    array([25.])
    """

    touches: ClassVar[bool] = False
    """Whether it reads by contact, zeros alone, in rows of its own: simulated tools are led to where it does."""
    wide: ClassVar[Mapping[str, float]] = {"mm": 1e4, "rad": 1.0}
    """By unit: standard deviation of the prior of what nobody states, far beyond what data leave open."""

    @abstractmethod
    def see(self, parameters: Parameters, position: np.ndarray, rotation: np.ndarray) -> np.ndarray:
        """Return the readings, shape (..., K), in the units of the channels; it must take complex numbers.

        Parameters
        ----------
        parameters : Parameters
            By symbol as the class has them; see `ReadingMachine.read`.
        position, rotation : ndarray, shapes (..., 3) and (..., 3, 3)
            Of the tool in the base frame, mm.
        """

    def read(self, parameters: Parameters, v: np.ndarray, given: Given) -> np.ndarray:
        """Return the readings of the tool's position and rotation vector v (..., 6)."""
        del given
        return self.see(parameters, v[..., :3], rotation_matrix(v[..., 3:]))

    # --- values that nobody states -------------------------------------------------------------------------------

    @property
    def unstated(self) -> tuple[str, ...]:
        """Symbols of parameters that have no nominal values: NaN says that the data have to tell them."""
        blocks = getattr(self, "parameters", ())  # of a class that is still to be checked
        blocks = [one for one in blocks if isinstance(one, ParameterBlock)] if isinstance(blocks, Sequence) else []
        return tuple(one.symbol for one in blocks if not np.isfinite(one.nominal).all())

    def settle(self, values: Mapping[str, Array]) -> Self:
        """Return the same instrument with other nominal values (n,), by symbol."""
        settled = copy(self)
        settled.parameters = [
            replace(one, nominal=tuple(map(float, values[one.symbol]))) if one.symbol in values else one
            for one in self.parameters
        ]
        return settled

    def propose(
        self, stated: Mapping[str, Array], seen: Array, position: Array, rotation: Array
    ) -> Sequence[Mapping[str, Array]]:
        """Return initial values of parameters from which least squares find those that fit the readings best.

        By default those that are stated, and every rotation vector of three values turned by right angles.

        Parameters
        ----------
        stated : mapping of str to ndarray, shape (n,)
            Nominal values by symbol; zero where none are stated.
        seen : ndarray, shape (P, K)
            Readings; NaN where there is none.
        position, rotation : ndarray, shapes (P, 3) and (P, 3, 3)
            Of the tool in the base frame as the machine's own channels have it, mm.

        Returns
        -------
        sequence of mappings of str to ndarray
            Values of some symbols each; the others stay as stated.
        """
        del seen, position, rotation
        turned = [one.symbol for one in self.parameters if one.unit == "rad" and len(one.nominal) == 3]
        return [{}, *({symbol: turn} for symbol in turned for turn in list_turns(stated[symbol]))]

    def find_mirrored(self, seen: Array, position: Array, rotation: Array) -> bool:
        """Return whether the readings fit a left-handed frame alone; False where the instrument has no frame."""
        del seen, position, rotation
        return False

    def list_hidden(self, is_flat: bool) -> Mapping[str, str]:
        """Return symbols that no readings tell, with why, of a target that keeps to a plane or not; none by default."""
        del is_flat
        return {}


def state(value: float | list[float] | Literal["found"] | None, unstated: tuple[float, ...]) -> tuple[float, ...]:
    """Return stated values, or those that say that there are none."""
    if value is None or value == "found":
        return unstated
    return tuple(value) if isinstance(value, list) else (float(value),)


def list_points(symbol: str, value: list[float] | Literal["found"] | None) -> list[ParameterBlock]:
    """Return the block of a point (3,), NaN where a study finds it; none where nothing is said."""
    return [] if value is None else [ParameterBlock(symbol, state(value, UNSTATED), axes="xyz")]


def turn(rotation: np.ndarray, vector: np.ndarray) -> np.ndarray:
    """Return vectors (..., 3) turned by rotations (..., 3, 3)."""
    return (rotation @ vector[..., None])[..., 0]


def find_target(parameters: Mapping[str, np.ndarray], position: np.ndarray, rotation: np.ndarray) -> np.ndarray:
    """Return where the target is in the base frame, (..., 3)."""
    return position + turn(rotation, parameters["target"]) if "target" in parameters else position
