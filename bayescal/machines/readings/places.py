"""One machine at two places in a row of the data: what is known of the way from one to the other.

A distance measured on a printed part, a ball bar between two poses, heights probed in pairs: the row has the readings
of a machine (h, v, d) at two poses a and b, which share the parameters d, and the distance between both tools,

    s = (h(v_a, d), h(v_b, d), |t(v_b, d) - t(v_a, d)|).

A channel ``s[2]`` is ``s[2a]`` and ``s[2b]``, ``height`` is ``height[a]`` and ``height[b]``, so that ``s`` still names
all of them; a coordinate ``x`` is ``x_a`` and ``x_b``, a column ``force`` of the data ``force_a`` and ``force_b``. What
has to be accurate is the tool of place a. Model errors know nothing of what both places share.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from bayescal.errors import InputError
from bayescal.machines.readings.base import Channel, Coordinate, Given
from bayescal.machines.readings.function import Parameters, ReadingMachine
from bayescal.numerics.analytic import sqrt
from bayescal.numerics.geometry import Array

PLACES = ("a", "b")
DISTANCE = "distance"
APART = 0.2  # of the workspace's half width, by which place b is nominally off: at no distance it has no derivative


class TwoPlaces(ReadingMachine):
    """A machine of one function at two places; InputError where its tool has no lengths."""

    def __init__(self, machine: ReadingMachine) -> None:
        """Double coordinates, channels and what is given of the rows."""
        super().__init__(machine.config if hasattr(machine, "config") else None)
        self.machine, self.parameters, self.member = machine, machine.parameters, machine.member
        has_tool = type(machine).tool is not ReadingMachine.tool or machine.tool_channels
        tool = machine.tool_channels if has_tool else [Channel(one.name, one.unit) for one in machine.coordinates]
        self.tool_channels = tuple(tool)
        self.tool_lengths = [k for k, one in enumerate(self.tool_channels) if one.unit == "mm"]
        if not self.tool_lengths:
            raise InputError("places: found a tool without lengths, expected one in mm")
        for channel in machine.channels:
            if channel.name == DISTANCE:
                raise InputError(f"places: found channel {DISTANCE!r} of one place, expected another name")
        coordinates = [replace(one, name=f"{one.name}_{place}") for place in PLACES for one in machine.coordinates]
        q = len(machine.coordinates)
        self.coordinates = [*coordinates[:q], *(_move(one) for one in coordinates[q:])]
        doubled = [name_channel(one, place) for place in PLACES for one in machine.channels]
        self.channels = [*doubled, Channel(DISTANCE, "mm", external=True)]
        commanded = [one.name for one in machine.channels if {one.name, one.kind} & {*machine.commanded}]
        names = {one.name: [name_channel(one, place).name for place in PLACES] for one in machine.channels}
        self.commanded = [names[name][k] for k in range(len(PLACES)) for name in commanded]
        self.given = tuple(f"{name}_{place}" for place in PLACES for name in machine.given)

    @property
    def at_one_place(self) -> ReadingMachine:
        """The machine at place a."""
        return self.machine

    def _split(self, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        q = len(self.machine.coordinates)
        return v[..., :q], v[..., q:]

    def _take(self, given: Given, place: str) -> Given:
        return {name: given[f"{name}_{place}"] for name in self.machine.given}

    def read(self, parameters: Parameters, v: np.ndarray, given: Given) -> np.ndarray:
        """Return the readings at place a, those at place b, and the distance."""
        places = self._split(v)
        parts = [
            np.asarray(self.machine.read(parameters, one, self._take(given, place)))
            for one, place in zip(places, PLACES, strict=True)
        ]
        here, there = (np.asarray(self.machine.tool(parameters, one)) for one in places)
        square = sum((there[..., k] - here[..., k]) ** 2 for k in self.tool_lengths)
        parts.append(sqrt(square)[..., None])
        shape = np.broadcast_shapes(*(one.shape[:-1] for one in parts))
        return np.concatenate([np.broadcast_to(one, (*shape, one.shape[-1])) for one in parts], axis=-1)

    def tool(self, parameters: Parameters, v: np.ndarray) -> np.ndarray:
        """Return the tool at place a."""
        return self.machine.tool(parameters, self._split(v)[0])

    def rotation(self, v: np.ndarray) -> np.ndarray | None:
        """Return how the tool is turned at place a."""
        return self.machine.rotation(self._split(v)[0])

    def check_given(self, poses: Sequence[str], given: Given, free: Sequence[str]) -> None:
        """Raise InputError as the machine does, for either place."""
        for place in PLACES:
            self.machine.check_given(poses, self._take(given, place), free)

    def complete(self, values: Array) -> Array:
        """Return readings (P, K) whose rows of one place alone have commands at the other; see `ReadingMachine`.

        What nobody read tells nothing of the machine, but the other place has to be somewhere: where the farthest of
        all rows is, for at the same place the distance has no derivative.
        """
        k, filled = len(self.machine.channels), values.copy()
        own = np.flatnonzero([not one.external for one in self.machine.channels])
        parts = filled[:, :k], filled[:, k : 2 * k]
        known = np.concatenate([one[:, own] for one in parts])
        known = known[np.isfinite(known).all(axis=1)]
        alone = np.isnan(values[:, -1])
        for one, other in (parts, parts[::-1]):
            for row in np.flatnonzero(alone & np.isnan(other).all(axis=1) & (len(known) > 0)):
                here = np.nan_to_num(one[row, own])
                other[row, own] = known[np.linalg.norm(known - here, axis=1).argmax()]
        return filled


def name_channel(channel: Channel, place: str) -> Channel:
    """Return a channel as that of a place."""
    kind, _, number = channel.name.partition("[")
    rotation = f"{channel.rotation}_{place}" if channel.rotation else ""
    return replace(channel, name=f"{kind}[{number.rstrip(']')}{place}]", rotation=rotation)


def _move(one: Coordinate) -> Coordinate:
    """Return a coordinate whose home is off the middle of its workspace; one without width is moved by its unit."""
    return replace(one, home=one.home + APART * (one.reach or 1.0), reach=(1.0 - APART) * one.reach)
