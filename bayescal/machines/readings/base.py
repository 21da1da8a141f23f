"""What a machine's sensors read: each reading as a function of the pose and of the machine's parameters.

With internal sensors nobody measures the pose. What a model of the readings supplies is s = h(v, d): the readings s
that a machine of parameters d gives where it stands at v. The loop constraints f(d, s, v) = 0 of Šika et al. (2008,
eq. 1) are s - h(v, d) = 0, one per sensor. An instrument beside the machine that measures the pose v itself, or a part
of it, is one more reading, so that calibration with and without such an instrument is the same thing (eq. 2).
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from operator import attrgetter
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, ClassVar, Self

import numpy as np

from bayescal.errors import InputError
from bayescal.machines.coordinates import Coordinates
from bayescal.machines.parameters import ParameterLayout
from bayescal.machines.readings.newton import locate_pose
from bayescal.numerics.geometry import Array

if TYPE_CHECKING:
    from bayescal.machines.readings.function import FunctionModel, ReadingMachine
    from bayescal.machines.readings.legs import Legs

POINTS = 12
SPREAD = 0.3  # of the workspace's half widths
AWAY = 1e-3  # of a parameter's size, or of one unit where it is zero


def draw_points(model: ReadingModel, n: int = POINTS) -> tuple[Array, Array, Given]:
    """Return parameters (n, D) about nominal, poses (n, q) about home and given values (n,), always the same."""
    rng = np.random.default_rng(1974)
    nominal = model.layout.nominal
    theta = nominal + AWAY * np.maximum(np.abs(nominal), 1.0) * rng.uniform(-1.0, 1.0, (n, len(nominal)))
    home = model.home_pose
    pose = home + SPREAD * model.pose_scale * rng.uniform(-1.0, 1.0, (n, len(home)))
    pose[0], theta[0] = home, nominal
    return theta, pose, {name: rng.uniform(0.5, 1.5, n) for name in model.given}


type Given = Mapping[str, Array]
"""What is known of each row of the data, by name, shaped as the poses' leading axes: a temperature, a command."""
NO_CONDITIONS: Given = MappingProxyType({})
SAME = 1e-6  # of the workspace's half width, within which two poses are one
SLACK = 1e-6  # mm or rad beyond a channel's range, which digits of a table leave


@dataclass(frozen=True)
class Coordinate:
    """One of the q numbers that say where a machine stands.

    Attributes
    ----------
    name : str
        For example ``x``.
    unit : str
        ``mm``, ``rad``, or another one that its readings have.
    home : float
        Where the workspace has its middle.
    reach : float
        Half the workspace's width: it holds what is between home - reach and home + reach. Zero where a config has to
        say it.

    Examples
    --------
    >>> bc.Coordinate("x", "mm", home=10.0, reach=50.0)
    Coordinate(name='x', unit='mm', home=10.0, reach=50.0)
    """

    name: str
    unit: str
    home: float = 0.0
    reach: float = 1.0

    @property
    def stem(self) -> str:
        """Its name, as columns have it."""
        return self.name


@dataclass(frozen=True)
class Channel:
    """One sensor.

    Attributes
    ----------
    name : str
        For example ``s[2]``: what it reads, on which leg.
    unit : str
        ``mm`` or ``rad``, or another one, which then is that of its noise and of its column too.
    external : bool
        Whether it stands beside the machine, for the calibration only.
    period : float or None
        Of a reading on a circle, such as 2π: two readings are compared the short way round.
    rotation : str
        Name of the rotation vector of which this is a component, where the readings are one: three channels in a row
        that have the same are compared as the rotation from one to the other.
    ends : tuple of float
        Smallest and largest reading that there can be, such as the limits of a joint; data beyond are refused, but for
        a margin of the machine's own channels, whose zeros are not known.

    Examples
    --------
    >>> channel = bc.Channel("motor[2]", "rad")
    >>> channel.kind, channel.stem
    ('motor', 'motor_2')
    """

    name: str
    unit: str
    external: bool = False
    period: float | None = None
    rotation: str = ""
    ends: tuple[float, float] = (-np.inf, np.inf)

    def __post_init__(self) -> None:
        """Take a number that is one or zero as the flag that it means; InputError for what means none."""
        if self.external not in (True, False):
            raise InputError(f"channel {self.name!r}: external: found {self.external!r}, expected True or False")
        object.__setattr__(self, "external", bool(self.external))

    @property
    def kind(self) -> str:
        """Its name without the number of its leg."""
        return self.name.partition("[")[0]

    @property
    def stem(self) -> str:
        """Its name as columns have it: ``motor[2]`` is ``motor_2``."""
        return self.name.replace("[", "_").rstrip("]")


def narrow_range(limits: Array, channels: Sequence[Channel]) -> Array:
    """Return limits (N, 2) of channels, no wider than the ends of their readings."""
    ends = np.array([one.ends for one in channels]).reshape(-1, 2)
    return np.stack([np.maximum(limits[:, 0], ends[:, 0]), np.minimum(limits[:, 1], ends[:, 1])], axis=1)


POSE = ("x", "y", "z", "rx", "ry", "rz")
POSE_CHANNELS = tuple(
    Channel(name, "mm" if k < 3 else "rad", external=True, rotation="" if k < 3 else "r") for k, name in enumerate(POSE)
)
"""Position and rotation vector of a platform, seen from beside the machine."""

EVERY = (Channel("every", ""),)
"""Instead of a model's channels: all sensors that its machine could have."""


@dataclass(frozen=True)
class Readings:
    """Readings and their derivatives; leading axes are those of machines and poses."""

    values: Array  # (..., K): h, mm and rad; NaN where the machine cannot stand
    by_pose: Array  # (..., K, q): H = ∂h/∂v
    # (..., K, D): A = ∂h/∂d; empty where it was not asked for
    by_parameters: Array = field(default_factory=lambda: np.empty(0))

    def pick(self, places: np.ndarray | None) -> Readings:
        """Return those of some sensors, of all where it is None."""
        if places is None:
            return self
        more = self.by_parameters[..., places, :] if self.by_parameters.ndim > 1 else self.by_parameters
        return Readings(self.values[..., places], self.by_pose[..., places, :], more)


def hand_on(name: str) -> Any:
    """Return a property that is what a part of an object says: `whole.given` is ``given`` of ``whole``."""
    return property(attrgetter(name))


class BoundReadings(ABC):
    """Readings of C channels of many machines at poses that stay, and how they follow where these are moved.

    Arrays run over (channel, pose, machine), the machine last: there every operation is a long contiguous loop. What a
    method returns is scratch, valid until the method is called again.
    """

    places: np.ndarray  # (C,): the channels; what others read at a pose is the same for all machines
    is_own: ClassVar[bool] = True  # whether they are bound in a form of the machine's own, not by its `read`

    @abstractmethod
    def read(self, theta: Array) -> Array:
        """Return what the channels read, (C, P, B), of machines (B, D)."""

    @abstractmethod
    def differentiate(self, theta: Array) -> tuple[Array, Array]:
        """Return derivatives of the readings of one machine (D,) by pose, (P, C, q), and by parameters, (P, C, D)."""

    @abstractmethod
    def follow(self, step: Array) -> Array:
        """Return by how much readings of the same machines change, (C, P, B), as poses move by steps (q, P, B)."""


@dataclass(frozen=True, eq=False)
class BoundModel(BoundReadings):
    """Readings of a model as its `ReadingModel.read` has them, at poses that stay and again where these are moved."""

    is_own: ClassVar[bool] = False

    places: np.ndarray
    model: ReadingModel
    pose: Array  # (P, q)
    given: Given
    last: list[tuple[Array, Array]] = field(default_factory=list)  # machines (B, D) and what they read, (B, P, C)

    def read(self, theta: Array) -> Array:
        """Return what the channels read, (C, P, B); see `BoundReadings.read`."""
        read = self._read(theta, self.pose)
        self.last[:] = [(theta, read)]
        return read.transpose(2, 1, 0)

    def differentiate(self, theta: Array) -> tuple[Array, Array]:
        """Return the model's derivatives; see `BoundReadings.differentiate`."""
        here = self.model.linearise(theta, self.pose, True, self.given)
        return here.by_pose, here.by_parameters

    def follow(self, step: Array) -> Array:
        """Return what the machines that were read last read more at poses moved by steps (q, P, B), (C, P, B)."""
        ((theta, read),) = self.last
        return (self._read(theta, self.pose + step.transpose(2, 1, 0)) - read).transpose(2, 1, 0)

    def _read(self, theta: Array, pose: Array) -> Array:
        return self.model.read(theta[:, None], pose, {name: value[None] for name, value in self.given.items()})


@dataclass(frozen=True, eq=False)
class ReadingModel(ABC):
    """A machine seen by its sensors: K readings of a pose with q coordinates, D parameters."""

    # the sensors that it has, by default all that it could have
    channels: tuple[Channel, ...] = field(default=EVERY, kw_only=True)

    actuated: ClassVar[Sequence[str]] = ()
    """Sensors, or kinds of them, that a controller can command; none for all that are the machine's own."""
    offered: ClassVar[Sequence[str]] = ()
    """Symbols of its optional parameters, which it has where they are named; see `with_optional`."""
    shifting: ClassVar[Sequence[str]] = ()
    """Symbols of the parameters that shift where something slips, one of each member, such as the lengths of legs."""
    member: ClassVar[str] = "leg"
    """What one of many is called: that ``l[2]`` is of leg, line, joint or belt 2."""

    def __post_init__(self) -> None:
        """Take all sensors where none are said."""
        if self.channels is EVERY:
            object.__setattr__(self, "channels", self.sensors)

    @property
    @abstractmethod
    def layout(self) -> ParameterLayout:
        """Layout of the parameters."""

    @property
    @abstractmethod
    def sensors(self) -> tuple[Channel, ...]:
        """All sensors that the machine could have."""

    @property
    def computed(self) -> tuple[Channel, ...]:
        """The sensors whose readings are computed together, among them those of the channels: by default all."""
        return self.sensors

    @cached_property
    def places(self) -> np.ndarray | None:
        """Where the channels stand among those that are computed; None where they are all of them."""
        names = [one.name for one in self.computed]
        found = [names.index(one.name) for one in self.channels]
        return None if found == list(range(len(names))) else np.array(found, dtype=int)

    def take(self, values: Array) -> Array:
        """Return the channels' of all values that are computed, along the last axis."""
        return values if self.places is None else values[..., self.places]

    @property
    @abstractmethod
    def coordinates(self) -> tuple[Coordinate, ...]:
        """The pose's q coordinates."""

    @property
    def legs(self) -> Legs | None:
        """The mechanism on legs that it is, or that instruments stand beside; None of any other machine."""
        return None

    @property
    def reads_pose(self) -> bool:
        """Whether position and rotation vector of its tool in the base frame are among its channels."""
        return {*POSE_CHANNELS} <= {*self.channels}

    @property
    def pose_units(self) -> tuple[str, ...]:
        """Units of the pose's q coordinates."""
        return tuple(one.unit for one in self.coordinates)

    @property
    def given(self) -> tuple[str, ...]:
        """Names of what has to be known of each row of the data beside its readings."""
        return ()

    @property
    def commanded(self) -> tuple[str, ...]:
        """Names of the channels that a controller can command."""
        asked = set(self.actuated)
        return tuple(one.name for one in self.channels if ({one.name, one.kind} & asked if asked else not one.external))

    @property
    def command_range(self) -> Array:
        """Smallest and largest value of each of them, shape (C, 2); infinite where the machine says nothing."""
        return np.tile([-np.inf, np.inf], (len(self.commanded), 1))

    @property
    def travels(self) -> Mapping[str, float]:
        """By channel, in what its travel is counted, such as the largest from home; of others their whole range."""
        return {}

    def find_beyond(self, values: Array) -> np.ndarray:
        """Return which readings (..., K) of commanded channels lie beyond their range, shape (..., C)."""
        places = self.select(self.commanded)
        read, limits = values[..., places], narrow_range(self.command_range, [self.channels[k] for k in places])
        return np.asarray((read < limits[:, 0] - SLACK) | (read > limits[:, 1] + SLACK))

    def with_optional(self, names: Iterable[str]) -> ReadingModel:
        """Return the same machine with those of its optional parameters that are named; it has none by default.

        Parameters that few ask for are in no layout but of those who name them, in a config for instance.
        """
        del names
        return self

    def near(self, values: Array) -> ReadingModel:
        """Return the same machine that looks for its readings near measured ones (P, K) of P poses; by default itself.

        Poses asked of it have an axis of P, or of one, behind all others but that of the coordinates.
        """
        del values
        return self

    def bind(self, theta: Array, values: Array, pose: Array, given: Given = NO_CONDITIONS) -> BoundReadings | None:
        """Return readings near measured ones (P, K) bound to poses (P, q), by default those of `read`; None for none.

        ``theta`` (D,) is a machine much like those that will be asked for.
        """
        del theta
        return BoundModel(np.arange(len(self.channels)), self.near(values), pose, given)

    def straighten(self, known: Coordinates, hidden: bool) -> Coordinates | None:
        """Return coordinates of the free parameters in which ridges of posteriors are straight, from those as they are.

        ``hidden``: whether errors that are functions of the pose hide parameters. None, as by default, where they are
        straight as they stand.
        """
        del known, hidden
        return None

    @property
    def optional(self) -> Mapping[str, str]:
        """Which of the offered parameters it has, each with the kind of the channels that they are of."""
        return {}

    @property
    def instrument_symbols(self) -> tuple[str, ...]:
        """Symbols of parameters that are those of instruments beside the machine."""
        return ()

    @property
    def instrument_places(self) -> Mapping[str, np.ndarray]:
        """Where channels of each instrument stand among all, by its name."""
        return {}

    @property
    def contacts(self) -> tuple[str, ...]:
        """Names of the instruments that read by contact, of which channels are there."""
        return ()

    @property
    def beside(self) -> Sequence[FunctionModel]:
        """The instruments beside the machine."""
        return ()

    @property
    def bare(self) -> ReadingModel:
        """The machine without instruments beside it."""
        return self

    @property
    def of_function(self) -> ReadingMachine | None:
        """The machine whose function gives the readings; None where they are not those of one function."""
        return None

    @property
    def home_pose(self) -> Array:
        """The middle of the workspace, shape (q,)."""
        return np.array([one.home for one in self.coordinates], dtype=np.float64)

    @property
    def pose_channels(self) -> tuple[Channel, ...]:
        """The coordinates as what two poses are compared by: a rotation vector as a rotation."""
        return tuple(Channel(one.name, one.unit) for one in self.coordinates)

    @property
    def tool_channels(self) -> tuple[Channel, ...]:
        """Names and units of what has to be accurate, the m numbers of `tool`: the coordinates by default."""
        return self.pose_channels

    @property
    def states_tool(self) -> bool:
        """Whether the machine says what has to be accurate; otherwise its coordinates stand in for it."""
        return True

    @property
    def places_tool(self) -> bool:
        """Whether the machine says where its tool is: up to three of its numbers are lengths, along x, y and z."""
        return self.states_tool and 0 < len(self.tool_lengths) <= 3

    @cached_property
    def tool_lengths(self) -> list[int]:
        """Which of the tool's numbers are x, y and z."""
        return [k for k, one in enumerate(self.tool_channels) if one.unit == "mm"]

    @cached_property
    def tool_turned(self) -> list[int]:
        """Which of the tool's numbers are its rotation vector; none where it has none."""
        return [k for k, one in enumerate(self.tool_channels) if one.rotation][:3]

    @property
    def tells_rotation(self) -> bool:
        """Whether the machine says how its tool is turned."""
        return bool(self.tool_turned) or type(self).rotation is not ReadingModel.rotation

    def check_given(self, poses: Sequence[str], given: Given, free: Sequence[str]) -> None:
        """Raise InputError where what `given` names cannot be so, or does not tell free parameters; by default nowhere.

        Parameters
        ----------
        poses : sequence of str
            Their names, P of them.
        given : mapping of str to ndarray, shape (P,)
        free : sequence of str
            Names of the free parameters.
        """
        del poses, given, free

    def complete(self, values: Array) -> Array:
        """Return readings (P, K), NaN where nothing was read, with those that anyone may state; by default none."""
        return values

    def seen_parameters(self, channels: Iterable[str]) -> tuple[str, ...]:
        """Return the names of the parameters that some sensors were found to depend on, in the layout's order."""
        seen = self._seen[self.select(channels)].any(axis=0)
        return tuple(name for name, one in zip(self.layout.names, seen, strict=True) if one)

    @cached_property
    def _seen(self) -> np.ndarray:
        """Which sensors depend on which parameters, shape (K, D): their derivative is not always zero about home."""
        theta, pose, given = draw_points(self)
        slopes = self.linearise(theta, pose, True, given).by_parameters
        return np.asarray(((slopes != 0.0) | np.isnan(slopes)).any(axis=0))

    @abstractmethod
    def read(self, theta: Array, pose: Array, given: Given = NO_CONDITIONS) -> Array:
        """Return the readings h.

        Parameters
        ----------
        theta : ndarray, shape (..., D)
            Parameters, broadcast against the leading axes of the poses.
        pose : ndarray, shape (..., q)
            Poses v.
        given : mapping of str to ndarray, shape (...)
            What `given` names.

        Returns
        -------
        ndarray, shape (..., K)
            mm and rad; NaN where the machine cannot stand.
        """

    @abstractmethod
    def linearise(
        self, theta: Array, pose: Array, with_parameters: bool = True, given: Given = NO_CONDITIONS
    ) -> Readings:
        """Return the readings with their derivatives; arguments as in `read`."""

    def error_gain(self, theta: Array, pose: Array, given: Given = NO_CONDITIONS) -> Array | None:
        """Return how the model error of each channel shows in all of them, (..., K, K), arguments as in `read`.

        None, as by default, where each shows in its own channel alone.
        """
        del theta, pose, given
        return None

    @abstractmethod
    def tool(self, theta: Array, pose: Array, with_parameters: bool = True) -> tuple[Array, Array, Array]:
        """Return what has to be accurate, where the tool's centre is for example, and what moves it.

        Returns
        -------
        position : ndarray, shape (..., m)
            In the units of `tool_channels`.
        by_pose : ndarray, shape (..., m, q)
        by_parameters : ndarray, shape (..., m, D)
            Empty where it is not asked for.
        """

    def tool_values(self, theta: Array, pose: Array) -> Array:
        """Return the tool's m numbers alone; see `tool`."""
        return self.tool(theta, pose, False)[0]

    def tool_frame(self, theta: Array, pose: Array) -> tuple[Array, Array] | None:
        """Return position (..., 3), mm, and axes (..., 3, 3) of the tool in the base frame; None where they take more.

        By default they do: `tool_values` and `rotation_in_space` have them.
        """
        del theta, pose
        return None

    # --- commands --------------------------------------------------------------------------------------------------

    def locate(
        self,
        theta: Array,
        commands: Array,
        given: Given = NO_CONDITIONS,
        start: Array | None = None,
        weights: Array | None = None,
    ) -> tuple[Array, np.ndarray]:
        """Return where machines stand whose commanded channels read what they are told to.

        Parameters
        ----------
        theta : ndarray, shape (..., D)
        commands : ndarray, shape (..., C)
            Values of `commanded`, in the channels' units; broadcast against the parameters.
        given : mapping of str to ndarray, shape (...)
        start : ndarray, shape (..., q), optional
            Poses nearby; by default the way from home is followed.
        weights : ndarray, shape (C,), optional
            One over the noise of each command, where there are more of them than coordinates; alike by default.

        Returns
        -------
        pose : ndarray, shape (..., q)
            Where more channels than coordinates are commanded that of least squares.
        found : ndarray of bool, shape (...)
        """
        return locate_pose(self, theta, commands, given, start, weights)

    def respond(self, theta: Array, mean: Array, pose: Array, commands: Array, given: Given = NO_CONDITIONS) -> Array:
        """Return what machines (S, D) near another (D,) read more than commanded (P, C) at poses (P, q), (P, C, S)."""
        del mean
        places = self.select(self.commanded)
        read = self.read(theta[:, None], pose, {name: value[None] for name, value in given.items()})[..., places]
        return np.moveaxis(read - commands, 0, -1)

    def find_faults(self, theta: Array, pose: Array, commands: Array, given: Given = NO_CONDITIONS) -> tuple[str, ...]:
        """Return why a machine (D,) does not come to poses (P, q) by the commands (P, C) that hold them; else nothing.

        A channel has no value there, or one beyond its range, or the way from home leads to another pose.
        """
        near = np.ones(len(pose), dtype=bool)
        if len(self.commanded) >= len(self.coordinates) > 0:
            back, found = self.locate(theta, np.nan_to_num(commands), given)
            near = found & (np.abs(back - pose) <= SAME * self.pose_scale).all(axis=-1)
        return tuple(self._find_fault(one, bool(there)) for one, there in zip(commands, near, strict=True))

    def _find_fault(self, commands: Array, returned: bool) -> str:
        channels = [self.channels[k] for k in self.select(self.commanded)]
        ends = narrow_range(self.command_range, channels)
        for channel, value, (low, high) in zip(channels, commands, ends, strict=True):
            if not np.isfinite(value):
                return f"{channel.name} is unreachable there"
            if not low - SLACK <= value <= high + SLACK:
                return f"{channel.name} would be {value:.6g} {channel.unit}, its range is {low:g} to {high:g}"
        return "" if returned else "only on another assembly branch, or singular"

    @property
    def pose_scale(self) -> Array:
        """What a step of each coordinate is small against, shape (q,): half the workspace, or one unit."""
        return np.array([one.reach if one.reach > 0.0 else 1.0 for one in self.coordinates])

    def rotation(self, pose: Array) -> Array:
        """Return how the platform is turned at poses (..., q), from its frame to the base's, shape (..., m, m).

        By default it is not: a point, or a machine whose coordinates do not say.
        """
        m = min(max(1, self.pose_units.count("mm")), 3)
        return np.broadcast_to(np.eye(m), (*pose.shape[:-1], m, m))

    def rotation_in_space(self, pose: Array) -> Array:
        """Return the same for a platform in a plane or on a line, too, shape (..., 3, 3)."""
        found = self.rotation(np.nan_to_num(pose))
        result = np.zeros((*found.shape[:-2], 3, 3), dtype=found.dtype) + np.eye(3)
        result[..., : found.shape[-1], : found.shape[-1]] = found
        return result

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Names of all sensors."""
        return tuple(channel.name for channel in self.channels)

    def select(self, names: Iterable[str]) -> np.ndarray:
        """Return where sensors stand among all, in the machine's order; a kind such as ``s`` stands for all its legs.

        So does the name of an instrument for its channels.

        InputError for a name that is no sensor's, with those there are.
        """
        wanted: set[str] = set()
        for name in names:
            found = {other for other in self.names if name in (other, other.partition("[")[0])}
            found = found or self._names_of_instrument(name)
            if not found:
                raise InputError(f"sensor {name!r}: expected one of {', '.join(self.names)}")
            wanted |= found
        return np.array([k for k, name in enumerate(self.names) if name in wanted], dtype=int)

    def _names_of_instrument(self, name: str) -> set[str]:
        """Return the sensors of an instrument; none without instruments."""
        del name
        return set()

    def pick(self, channels: np.ndarray) -> Self:
        """Return the same machine with some of its sensors, by their places."""
        return replace(self, channels=tuple(self.channels[k] for k in np.arange(len(self.channels))[channels]))
