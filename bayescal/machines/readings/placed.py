"""A machine seen by instruments beside it: more channels, and the parameters of their frames.

An instrument reads a function g(e, t) of its parameters e and of the tool's pose t, position and rotation vector in the
base frame. Whatever the machine, t is a function of its coordinates and parameters, so that the machine placed before
its instruments reads

    s = (h(v, d), g(e, t(v, d))),   ∂g/∂v = ∂g/∂t ∂t/∂v,   ∂g/∂d = ∂g/∂t ∂t/∂d.

The tool's position is what the machine's tool has in mm, up to three numbers along x, y and z. How it is turned is the
rotation vector among the tool's numbers, or else `ReadingModel.rotation`.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from bayescal.errors import InputError, name_faults, say_twice
from bayescal.machines.parameters import ParameterLayout
from bayescal.machines.readings.base import (
    NO_CONDITIONS,
    POSE,
    BoundReadings,
    Channel,
    Coordinate,
    Given,
    ReadingModel,
    Readings,
    hand_on,
)
from bayescal.machines.readings.function import COMPLEX_STEP, FunctionModel, Parameters
from bayescal.machines.readings.instrument import Instrument
from bayescal.numerics.analytic import rotation_vector
from bayescal.numerics.geometry import Array

READ_BY = "instruments"
"""Column of a file of planned poses that names the instruments which read in a row."""
NEARBY = (100.0,) * 3 + (0.5,) * 3  # mm and rad about the tool at home, within which an instrument is checked
ASIDE = 0.01  # of them, by which that begins beside home: a distance has no slope where an anchor is that nobody states


@dataclass(frozen=True, eq=False)
class InstrumentedMachine(ReadingModel):
    """A machine with instruments beside it; made by `place`."""

    whole: ReadingModel
    # their coordinates are the tool's pose. Any of their channels may be left out, none of their parameters.
    instruments: tuple[FunctionModel, ...]

    @property
    def name(self) -> str:
        """The machine's."""
        return str(getattr(self.whole, "name", ""))

    @cached_property
    def layout(self) -> ParameterLayout:
        """The machine's parameters, then those of each instrument."""
        every = [(one.name, block) for one in self.instruments for block in one.layout.blocks]
        return self.whole.layout.extend(tuple(replace(b, symbol=_join(name, b.symbol)) for name, b in every))

    @property
    def instrument_symbols(self) -> tuple[str, ...]:
        """Those of all instruments."""
        return self.layout.symbols[len(self.whole.layout.symbols) :]

    @cached_property
    def instrument_places(self) -> Mapping[str, np.ndarray]:
        """Where channels of each instrument stand among all, by its name."""
        ends = np.cumsum([len(one.channels) for one in (self.whole, *self.instruments)])
        parts = np.split(np.arange(ends[-1]), ends[:-1])[1:]
        return {one.name: places for one, places in zip(self.instruments, parts, strict=True)}

    @property
    def contacts(self) -> tuple[str, ...]:
        """Names of the instruments that read by contact, of which channels are there."""
        touching = [one.name for one in self.instruments if getattr(one.machine, "touches", False)]
        return tuple(name for name in touching if len(self.instrument_places[name]))

    @cached_property
    def sensors(self) -> tuple[Channel, ...]:
        """The machine's channels, then those of each instrument."""
        return (
            *self.whole.channels,
            *(rename_channel(one.name, seen) for one in self.instruments for seen in one.channels),
        )

    def pick(self, channels: np.ndarray) -> InstrumentedMachine:
        """Return the same machine with some of its channels, in their order; a part computes no more than its own."""
        chosen, parts, start = np.arange(len(self.channels))[channels], [], 0
        for part in (self.whole, *self.instruments):
            end = start + len(part.channels)
            parts.append(part.pick(chosen[(chosen >= start) & (chosen < end)] - start))
            start = end
        return InstrumentedMachine(parts[0], tuple(parts[1:]))  # type: ignore[arg-type]

    def seen_parameters(self, channels: Iterable[str]) -> tuple[str, ...]:
        """Return what the machine says; all where an instrument is read, which sees the tool."""
        names = [self.names[k] for k in self.select(channels)]
        return self.whole.seen_parameters(names) if {*names} <= {*self.whole.names} else self.layout.names

    def near(self, values: Array) -> InstrumentedMachine:
        """Return the same with its machine near its readings; see `ReadingModel.near`."""
        return replace(self, whole=self.whole.near(values[:, : len(self.whole.channels)]))

    def complete(self, values: Array) -> Array:
        """Return readings with those of the machine that anyone may state; see `ReadingModel.complete`."""
        n = len(self.whole.channels)
        return np.concatenate([self.whole.complete(values[:, :n]), values[:, n:]], axis=1)

    def bind(self, theta: Array, values: Array, pose: Array, given: Given = NO_CONDITIONS) -> BoundReadings | None:
        """Return the readings bound to poses; see `ReadingModel.bind`.

        Where parameters of the machine do not move its tool, instruments see it where it is.
        """
        own, n = self._split(theta)[0], len(self.whole.channels)
        bound = self.whole.bind(own, values[:, :n], pose, given)
        tool = self.whole.tool(own, pose)
        if bound is not None and (not bound.is_own or tool[2].any()):
            return super().bind(theta, values, pose, given)
        if bound is None:
            return None
        places = np.concatenate([bound.places, np.arange(n, len(self.channels))])
        slope = self.linearise(theta, pose, False, given).by_pose[:, n:]
        return _BoundPlaced(places, self, bound, self._place_tool(tool[0], pose), slope)

    # --- what the machine says -----------------------------------------------------------------------------------

    beside = hand_on("instruments")
    legs = hand_on("whole.legs")
    # no instrument moves the tool, is commanded or has coordinates
    bare = hand_on("whole")
    coordinates = hand_on("whole.coordinates")
    given = hand_on("whole.given")
    commanded = hand_on("whole.commanded")
    command_range = hand_on("whole.command_range")
    travels = hand_on("whole.travels")
    member = hand_on("whole.member")
    shifting = hand_on("whole.shifting")
    pose_channels = hand_on("whole.pose_channels")
    tool_channels = hand_on("whole.tool_channels")
    states_tool = hand_on("whole.states_tool")
    tells_rotation = hand_on("whole.tells_rotation")
    check_given = hand_on("whole.check_given")
    optional = hand_on("whole.optional")
    straighten = hand_on("whole.straighten")
    rotation = hand_on("whole.rotation")

    def _split(self, theta: Array) -> list[Array]:
        """Return the machine's parameters and those of each instrument."""
        sizes = [part.layout.size for part in (self.whole, *self.instruments)]
        return np.split(theta, np.cumsum(sizes)[:-1], axis=-1)

    # --- the tool's pose ---------------------------------------------------------------------------------------------

    def place_tool(self, theta: Array, pose: Array) -> Array:
        """Return position and rotation vector (..., 6) of the tool at poses (..., q); an unknown rotation is zero."""
        return self._place_tool(self.whole.tool_values(self._split(theta)[0], pose), pose)

    def _place_tool(self, numbers: Array, pose: Array) -> Array:
        """Return position and rotation vector (..., 6) from the tool's numbers (..., m) at poses (..., q)."""
        found = np.zeros((*numbers.shape[:-1], len(POSE)))
        found[..., : len(self.tool_lengths)] = numbers[..., self.tool_lengths]
        if self.tool_turned:
            found[..., 3:] = numbers[..., self.tool_turned]
        elif self.tells_rotation:
            found[..., 3:] = rotation_vector(self.rotation_in_space(pose))
        return np.where(np.isfinite(pose).all(axis=-1, keepdims=True), found, np.nan)

    def linearise_tool(self, theta: Array, pose: Array, with_parameters: bool = True) -> tuple[Array, Array, Array]:
        """Return position and rotation vector (..., 6) with their derivatives, by the pose and by the parameters."""
        numbers, *slopes = self.whole.tool(theta, pose, with_parameters)
        tool, places = self._place_tool(numbers, pose), self.tool_lengths + self.tool_turned
        rows = [*range(len(self.tool_lengths)), *range(3, 3 + len(self.tool_turned))]
        if not with_parameters:
            slopes.pop()
        by_pose, *more = (np.zeros((*tool.shape, one.shape[-1])) for one in slopes)
        for every, one in zip((by_pose, *more), slopes, strict=True):
            every[..., rows, :] = one[..., places, :]
        if self.tells_rotation and not self.tool_turned:
            turned = rotation_vector(
                self.rotation_in_space(pose[..., None, :] + 1j * COMPLEX_STEP * np.eye(pose.shape[-1]))
            )
            by_pose[..., 3:, :] = np.swapaxes(turned.imag, -1, -2) / COMPLEX_STEP
        return tool, by_pose, more[0] if more else np.empty(0)

    def _names_of_instrument(self, name: str) -> set[str]:
        return {f"{name}_{own}" for one in self.instruments if one.name == name for own in one.names} & set(self.names)

    # --- readings ----------------------------------------------------------------------------------------------------

    def locate(
        self,
        theta: Array,
        commands: Array,
        given: Given = NO_CONDITIONS,
        start: Array | None = None,
        weights: Array | None = None,
    ) -> tuple[Array, np.ndarray]:
        """Return where the machine comes to, which no instrument moves; see `ReadingModel.locate`."""
        return self.whole.locate(self._split(theta)[0], commands, given, start, weights)

    def read(self, theta: Array, pose: Array, given: Given = NO_CONDITIONS) -> Array:
        """Return the readings; see `ReadingModel.read`."""
        own, *others = self._split(theta)
        parts = [self.whole.read(own, pose, given)]
        if len(self.channels) > len(self.whole.channels):
            parts += self._see(own, others, pose)
        shape = np.broadcast_shapes(theta.shape[:-1], pose.shape[:-1])
        return np.concatenate([np.broadcast_to(one, (*shape, one.shape[-1])) for one in parts], axis=-1)

    def _see(self, own: Array, others: Sequence[Array], pose: Array) -> list[Array]:
        """Return what each instrument reads of machines (..., D) whose tools are at poses (..., q)."""
        placed = self.whole.tool_frame(own, pose)
        pairs = zip(self.instruments, others, strict=True)
        if placed is None or any(type(one.machine).read is not Instrument.read for one in self.instruments):
            tool = self._place_tool(self.whole.tool_values(own, pose), pose)
            return [one.read(some, tool) for one, some in pairs]
        return [one.take(one.machine.see(Parameters(one.layout, some), *placed)) for one, some in pairs]  # type: ignore[attr-defined]

    def linearise(
        self, theta: Array, pose: Array, with_parameters: bool = True, given: Given = NO_CONDITIONS
    ) -> Readings:
        """Return the readings with their derivatives; see `ReadingModel.linearise`."""
        own, *others = self._split(theta)
        shape = (*np.broadcast_shapes(theta.shape[:-1], pose.shape[:-1]), len(self.channels))
        row, column = len(self.whole.channels), self.whole.layout.size
        values, by_pose = np.empty(shape), np.empty((*shape, pose.shape[-1]))
        by_parameters = np.zeros((*shape, theta.shape[-1])) if with_parameters else np.empty(0)
        here = self.whole.linearise(own, pose, with_parameters, given)
        values[..., :row], by_pose[..., :row, :] = here.values, here.by_pose
        if with_parameters:
            by_parameters[..., :row, :column] = here.by_parameters
        if row == len(self.channels):
            return Readings(values, by_pose, by_parameters)
        tool, tool_by_pose, tool_by_parameters = self.linearise_tool(own, pose, with_parameters)
        for one, some in zip(self.instruments, others, strict=True):
            seen, rows = one.linearise(some, tool, with_parameters), slice(row, row + len(one.channels))
            values[..., rows], by_pose[..., rows, :] = seen.values, seen.by_pose @ tool_by_pose
            if with_parameters:
                by_parameters[..., rows, : own.shape[-1]] = seen.by_pose @ tool_by_parameters
                by_parameters[..., rows, column : column + some.shape[-1]] = seen.by_parameters
            row, column = rows.stop, column + some.shape[-1]
        return Readings(values, by_pose, by_parameters)

    def error_gain(self, theta: Array, pose: Array, given: Given = NO_CONDITIONS) -> Array | None:
        """Return the machine's; an instrument's model error shows in its own channel alone."""
        own = self.whole.error_gain(self._split(theta)[0], pose, given)
        if own is None:
            return None
        result = np.zeros((*own.shape[:-2], len(self.channels), len(self.channels))) + np.eye(len(self.channels))
        result[..., : own.shape[-1], : own.shape[-1]] = own
        return result

    def tool(self, theta: Array, pose: Array, with_parameters: bool = True) -> tuple[Array, Array, Array]:
        """Return the machine's tool, which no instrument moves."""
        own, *others = self._split(theta)
        position, by_pose, by_parameters = self.whole.tool(own, pose, with_parameters)
        if not with_parameters:
            return position, by_pose, by_parameters
        nothing = np.zeros((*by_parameters.shape[:-1], sum(one.shape[-1] for one in others)))
        return position, by_pose, np.concatenate([by_parameters, nothing], axis=-1)


@dataclass(frozen=True, eq=False)
class _BoundPlaced(BoundReadings):
    """A bound machine and its instruments, which see the tool (P, 6) where the poses are."""

    places: np.ndarray
    placed: InstrumentedMachine
    bound: BoundReadings
    tool: Array
    slope: Array  # (P, C, q): by the pose, of one machine

    def read(self, theta: Array) -> Array:
        """Return those of the machine, then those of the instruments; see `BoundReadings.read`."""
        parts, shape = self.placed._split(theta[:, None]), (len(theta), len(self.tool))
        seen = [one.read(some, self.tool) for one, some in zip(self.placed.instruments, parts[1:], strict=True)]
        read = np.concatenate([np.broadcast_to(one, (*shape, one.shape[-1])) for one in seen], axis=-1)
        return np.concatenate([self.bound.read(theta), read.transpose(2, 1, 0)])

    def differentiate(self, theta: Array) -> tuple[Array, Array]:
        """Return both parts'; see `BoundReadings.differentiate`."""
        own, *others = self.placed._split(theta)
        by_pose, by_own = self.bound.differentiate(own)
        by_parameters = np.zeros((len(self.tool), len(by_own[0]) + self.slope.shape[1], len(theta)))
        row, column = by_own.shape[1:]
        by_parameters[:, :row, :column] = by_own
        for one, some in zip(self.placed.instruments, others, strict=True):
            seen, n = one.linearise(some, self.tool), len(one.channels)
            by_parameters[:, row : row + n, column : column + len(some)] = seen.by_parameters
            row, column = row + n, column + len(some)
        return np.concatenate([by_pose, self.slope], axis=1), by_parameters

    def follow(self, step: Array) -> Array:
        """Return both parts' changes; see `BoundReadings.follow`."""
        change = (self.slope @ step.transpose(1, 0, 2)).transpose(1, 0, 2)
        return np.concatenate([self.bound.follow(step), change])


def locate_tool(machine: ReadingModel, commands: Array) -> Array:
    """Return position and rotation vector (P, 6) of the nominal machine's tool at commands (P, C), base frame.

    NaN where it cannot stand; a rotation that the machine does not tell is zero.
    """
    theta = machine.layout.nominal
    pose, _ = machine.locate(theta, commands)
    return InstrumentedMachine(machine, ()).place_tool(theta, pose)


def rename_channel(name: str, channel: Channel) -> Channel:
    """Return a channel of an instrument as the machine before it has it."""
    own = channel.name
    return replace(
        channel,
        name=_join(name, own) if own and not own.startswith("[") else f"{name}{own}",
        external=True,
        rotation=_join(name, channel.rotation) if channel.rotation else "",
    )


def _join(name: str, own: str) -> str:
    """Return a name after that of its instrument; as it is where that has none."""
    return f"{name}_{own}" if name else own


def place(machine: ReadingModel, instruments: Mapping[str, Instrument]) -> ReadingModel:
    """Return a machine with instruments beside it, by their names.

    InputError for an instrument that is none: without channels, failing, not analytic; for a machine that does not say
    where its tool is, or how it is turned where that is seen; for a name that the machine has already.
    """
    return place_instruments(machine, instruments) if instruments else machine


def place_instruments(machine: ReadingModel, instruments: Mapping[str, Instrument]) -> InstrumentedMachine:
    """Return a machine with instruments beside it, maybe none; see `place`."""
    title = getattr(machine, "name", "")
    bare = InstrumentedMachine(machine, ())
    placed = []
    for name, one in instruments.items():
        with name_faults(f"instruments.{name}"):
            for symbol in one.unstated:
                raise InputError(f"{symbol}: expected a value: only a study estimates it")
            if not machine.places_tool:
                raise InputError(f"machine {title!r}: expected tool_channels of its class, up to three in mm")
            home = bare.place_tool(machine.layout.nominal, machine.home_pose)
            one.coordinates = [
                Coordinate(axis, "mm" if k < 3 else "rad", float(home[k]) + ASIDE * NEARBY[k], NEARBY[k])
                for k, axis in enumerate(POSE)
            ]
            model = FunctionModel(name, one)
            if model.pattern[:, model.layout.size + 3 :].any() and not bare.tells_rotation:
                raise InputError(
                    f"machine {title!r}: expected a rotation vector in tool_channels, or an "
                    "instrument of the tool's centre"
                )
            placed.append(model)
    found = InstrumentedMachine(machine, tuple(placed))
    for names in (found.layout.symbols, tuple(one.stem for one in found.channels)):  # by which columns name channels
        for name in names:
            if names.count(name) > 1:
                raise InputError(say_twice("instruments", name))
    return found
