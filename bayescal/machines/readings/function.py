"""A machine as one function: what its sensors read where it stands, given its parameters.

Everything else follows. Both Jacobians are taken by complex step, exact to rounding: ∂h/∂x = Im h(x + iε) / ε.
Parameters and coordinates that no sensor sees together are stepped together (Curtis, Powell and Reid 1974), so that a
machine of N legs costs as many evaluations as one of its legs has parameters. A class is checked when a machine is made
of it: its members, its values at home, its derivatives against differences.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar

import numpy as np

from bayescal.config.sections import Section
from bayescal.errors import InputError, say_twice, say_unknown
from bayescal.files.plain_text import add_article
from bayescal.machines.parameters import ParameterBlock, ParameterLayout
from bayescal.machines.readings.base import (
    EVERY,
    NO_CONDITIONS,
    Channel,
    Coordinate,
    Given,
    ReadingModel,
    Readings,
    draw_points,
    hand_on,
)
from bayescal.numerics.geometry import Array

MEMBERS = {"parameters": ParameterBlock, "coordinates": Coordinate, "channels": Channel}
POINTS = 5
DIFFERENCE = 1e-6  # of an entry's size
AGREEMENT = 1e-4  # of the largest slope of its channel; differences of this step keep six digits
CLOSED = 1e-9  # of the same, for derivatives in closed form against complex steps: rounding


def check_members(name: str, machine: ReadingMachine) -> None:
    """Raise InputError for a machine that lacks parameters, coordinates or channels, or has wrong ones."""
    where = f"machine {name!r}: class {type(machine).__name__}"
    for member, kind in MEMBERS.items():
        found = getattr(machine, member, None)
        if not isinstance(found, Sequence):
            raise InputError(f"{where}: found no {member}, expected a sequence of {kind.__name__}")
        for one in found:
            if not isinstance(one, kind):
                raise InputError(f"{where}: {member}: found {one!r}, expected {add_article(kind.__name__)}")
        names = [one.symbol if isinstance(one, ParameterBlock) else one.name for one in found]
        for one_name in names:
            if names.count(one_name) > 1:
                raise InputError(say_twice(f"{where}: {member}", one_name))
    if not machine.parameters or not machine.channels:
        raise InputError(f"{where}: expected at least one parameter and one channel")
    _check_rotations(f"{where}: channels", machine.channels)
    known = {name for one in machine.channels for name in (one.name, one.kind)}
    for name in machine.commanded:
        if name not in known:
            channels = [one.name for one in machine.channels]
            raise InputError(say_unknown(f"{where}: commanded", name, channels))


def check_tool(model: FunctionModel) -> None:
    """Raise InputError for a tool without names, or one that is not as many finite numbers at home as it has names."""
    machine = model.machine
    where = f"machine {model.name!r}: class {type(machine).__name__}: tool"
    if model.has_own_tool and not machine.tool_channels:
        raise InputError(f"{where}: found no tool_channels, expected a Channel for each number")
    for one in machine.tool_channels:
        if not isinstance(one, Channel):
            raise InputError(f"{where}_channels: found {one!r}, expected a Channel")
    _check_rotations(f"{where}_channels", machine.tool_channels)
    theta, pose, _ = draw_points(model, POINTS)
    expected = f"numbers {_describe_shapes(model, theta, pose, NO_CONDITIONS)}"
    found, _, _ = _call(where, expected, lambda: model.tool(theta, pose))
    if machine.tool_slopes(Parameters(model.layout, theta), pose, True) is not None:
        closed, stepped = model.tool(theta, pose)[1:], model.step_tool(theta, pose)[1:]
        for what, given, exact in zip(("v", "parameters"), closed, stepped, strict=True):
            size = float(np.max(np.abs(exact), initial=1.0, where=np.isfinite(exact)))
            if not np.allclose(given, exact, rtol=0.0, atol=CLOSED * size, equal_nan=True):
                raise InputError(f"{where}_slopes: found other derivatives by {what} than those of tool")
    names = [one.name for one in machine.tool_channels] or [one.name for one in model.coordinates]
    if found.shape[-1] != len(names):
        raise InputError(f"{where}: found {found.shape[-1]} numbers, expected {len(names)}: {', '.join(names)}")
    for k in np.flatnonzero(~np.isfinite(found[0])):
        raise InputError(f"{where}: {names[k]}: found {found[0, k]} at home, expected a finite number")
    where, expected = f"{where.removesuffix('tool')}rotation", f"rotations of v {pose.shape}"
    turned = _call(where, expected, lambda: np.asarray(model.rotation(pose)))
    square = turned.ndim > 1 and turned.shape[-1] == turned.shape[-2] <= len("xyz")
    if not square or turned.shape[:-2] not in ((), (1,), (POINTS,)):
        found_shape = f"found shape {turned.shape} for {POINTS} poses"
        raise InputError(f"{where}: {found_shape}, expected ({POINTS}, m, m), m up to three, of v {pose.shape}")


def _check_rotations(where: str, channels: Sequence[Channel]) -> None:
    names = [one.rotation for one in channels]
    for name in dict.fromkeys(filter(None, names)):
        places = [k for k, other in enumerate(names) if other == name]
        if places != list(range(places[0], places[0] + 3)):
            raise InputError(f"{where}: found {len(places)} of rotation {name!r}, expected three in a row")


def check_values(model: FunctionModel) -> None:
    """Raise InputError where the function fails, returns another shape than (..., K), or is not finite at home."""
    theta, pose, given = draw_points(model, POINTS)
    where, n = f"machine {model.name!r}: {type(model.machine).__name__}.read", len(model.channels)
    found = _read(model, where, theta, pose, given)
    if found.shape != (POINTS, n):
        raise InputError(
            f"{where}: found shape {found.shape} for {POINTS} poses, expected {(POINTS, n)} "
            f"{_describe_shapes(model, theta, pose, given)}"
        )
    for k in np.flatnonzero(~np.isfinite(found[0])):
        raise InputError(f"{where}: {model.channels[k].name}: found {found[0, k]} at home, expected a finite reading")
    many = theta[:, None], pose[None], {name: value[None] for name, value in given.items()}
    stacked = _read(model, where, *many)
    if stacked.shape != (POINTS, POINTS, n):
        raise InputError(
            f"{where}: found shape {stacked.shape} for {POINTS} machines and poses, expected "
            f"{(POINTS, POINTS, n)} {_describe_shapes(model, *many)}: any leading axes"
        )


def _describe_shapes(model: FunctionModel, theta: np.ndarray, pose: np.ndarray, given: Given) -> str:
    """Return the shapes of what a machine's functions are called with, by which a wrong axis is found, in words.

    Of the parameters those of a single value and of a block of several.
    """
    parameters = Parameters(model.layout, theta)
    first = {np.ndim(parameters[name]): name for name in reversed(model.layout.symbols)}
    shapes = [
        f"v {pose.shape}",
        *(f"parameters[{name!r}] {parameters[name].shape}" for _, name in sorted(first.items())),
    ]
    shapes += [f"given[{name!r}] {value.shape}" for name, value in list(given.items())[:1]]
    return f"of {', '.join(shapes)}"


def _call[Result](where: str, expected: str, function: Callable[[], Result]) -> Result:
    """Return what somebody else's code returns; InputError for whatever it raises."""
    try:
        with np.errstate(all="ignore"):
            return function()
    except Exception as error:
        text = " ".join(str(error).split())
        raise InputError(f"{where}: failed with {type(error).__name__}: {text}, expected {expected}") from error


def _read(model: FunctionModel, where: str, theta: np.ndarray, pose: np.ndarray, given: Given) -> Array:
    analytic = np.iscomplexobj(theta)
    shape = (*np.broadcast_shapes(theta.shape[:-1], pose.shape[:-1]), len(model.channels))
    hint = "; see bayescal.numerics.analytic" if analytic else ""
    expected = f"readings {shape} {_describe_shapes(model, theta, pose, given)}{hint}"
    return _call(where, expected, lambda: np.asarray(model.evaluate(theta, pose, given)))


def check_derivatives(model: FunctionModel) -> None:
    """Raise InputError where a derivative by complex step is not that of central differences."""
    theta, pose, given = draw_points(model, POINTS)
    where = f"machine {model.name!r}: {type(model.machine).__name__}.read"
    _read(model, f"{where}, with complex numbers", theta + 0j, pose + 0j, given)
    here = np.concatenate([theta, pose], axis=1)
    _, exact = model.differentiate(theta, pose, given, np.eye(here.shape[1]))
    size = DIFFERENCE * np.maximum(np.abs(here), 1.0)
    slope, wide = (_differ(model, where, here, times * size, given) for times in (1.0, 4.0))
    # what two steps disagree by is rounding, of the values or of something larger on the way to them; by channel, for
    # channels have units of their own
    steps = size.T[..., None]
    apart = np.abs(slope - wide) * steps
    rounding = np.max(apart, axis=(0, 1), initial=0.0, where=np.isfinite(apart))
    scale = np.max(np.abs(slope), axis=1, keepdims=True, initial=0.0, where=np.isfinite(slope))
    wrong = np.isfinite(slope) & (np.abs(slope - exact) > AGREEMENT * scale + 10.0 * rounding / steps)
    _check_closed(model, where, theta, pose, given, np.moveaxis(exact[model.layout.size :], 0, -1))
    for entry, point, k in np.argwhere(wrong)[:1]:
        names = (*model.layout.names, *(one.name for one in model.coordinates))
        raise InputError(
            f"{where}: {model.channels[k].name}: found ∂/∂{names[entry]} = "
            f"{exact[entry, point, k]:.6g} by complex step, {slope[entry, point, k]:.6g} by "
            "differences, expected an analytic function: abs, norm and arctan2 of "
            "bayescal.numerics.analytic"
        )


def _check_closed(model: FunctionModel, where: str, theta: Array, pose: Array, given: Given, exact: Array) -> None:
    """Raise InputError where derivatives in closed form are not those by complex step, (n, K, q)."""
    where = f"{where.removesuffix('read')}slopes"
    closed = _call(where, "K rows of q", lambda: model.closed_slopes(theta, pose, given))
    if closed is None:
        return
    scale = np.max(np.abs(exact), axis=(0, 2), keepdims=True, initial=0.0, where=np.isfinite(exact))
    wrong = np.isfinite(exact) & ~(np.abs(closed - exact) <= CLOSED * scale)
    for point, k, i in np.argwhere(wrong)[:1]:
        raise InputError(
            f"{where}: {model.channels[k].name}: found ∂/∂{model.coordinates[i].name} = "
            f"{closed[point, k, i]:.6g}, expected {exact[point, k, i]:.6g}, that of read"
        )


def _differ(model: FunctionModel, where: str, here: Array, size: Array, given: Given) -> Array:
    """Return derivatives (D + q, n, K) by each entry of (d, v) at points (n, D + q), by differences of such steps."""
    n, size = model.layout.size, size.T[..., None]
    step = size * np.eye(len(size))[:, None]
    above, below = (_read(model, where, at[..., :n], at[..., n:], given) for at in (here + step, here - step))
    return np.asarray((above - below) / (2.0 * size))


COMPLEX_STEP = 1e-30
AT_ONCE = 8192
"""Places at which a function is evaluated together: what it holds meanwhile stays in a processor's cache."""
LARGEST_STEP = 1e-10  # what no derivative makes of a step, but a function that leaves the reals does


class ReadingMachine(ABC):
    """What a machine of any kind has to say: its parameters, coordinates and sensors, and what these read.

    A subclass is named in a machine's file, ``kind = "own_machine.py:OwnMachine"``, whose other keys are checked by its
    ``Config`` and handed to its constructor.

    Attributes
    ----------
    Config : type of Section
        Its section of the machine's file; nothing by default.
    given : tuple of str
        Columns of the data that `read` needs beside coordinates: a temperature, a commanded value.
    commanded : sequence of str
        Channels, or kinds of them, that a controller can command; all that are not external where it is empty.
    member : str
        What one of many is called in texts: leg, line, joint, belt.
    tool_channels : sequence of Channel
        Names and units of what has to be accurate: what `tool` returns, or the coordinates themselves.

    Examples
    --------
    A carriage on a scale whose zero is not known; a laser reads its position for the calibration:

    >>> class Slide(bc.ReadingMachine):
    ...     parameters = [bc.ParameterBlock("zero", (0.0,), per_leg=False)]
    ...     coordinates = [bc.Coordinate("x", "mm", home=0.0, reach=50.0)]
    ...     channels = [bc.Channel("scale", "mm"), bc.Channel("laser", "mm", external=True)]
    ...
    ...     def read(self, parameters, v, given):
    ...         x = v[..., 0]
    ...         return np.stack(np.broadcast_arrays(x - parameters["zero"], x), axis=-1)
    >>> Slide().read({"zero": 0.5}, np.array([10.0]), {})
    array([ 9.5, 10. ])
    """

    Config: ClassVar[type[Section]] = Section
    given: tuple[str, ...] = ()
    commanded: Sequence[str] = ()
    member: str = "leg"
    tool_channels: Sequence[Channel] = ()
    parameters: Sequence[ParameterBlock]
    coordinates: Sequence[Coordinate]
    channels: Sequence[Channel]

    def __init__(self, config: Any = None) -> None:
        """Take the machine's section of its file."""
        self.config = config

    @abstractmethod
    def read(self, parameters: Parameters, v: np.ndarray, given: Given) -> np.ndarray:
        """Return the readings h(d, v), shape (..., K), in the units of the channels.

        It must take any leading axes, and complex numbers: it is differentiated by complex step. What NumPy has no
        complex form of stands in `bayescal.numerics.analytic`.

        Parameters
        ----------
        parameters : Parameters
            ``parameters["l"]`` is of shape (..., n) for a block of n values, of shape (...) for a single one.
        v : ndarray, shape (..., q)
            Where the machine stands.
        given : mapping of str to ndarray, shape (...)
        """

    def slopes(
        self, parameters: Parameters, v: np.ndarray, given: Given
    ) -> Sequence[Sequence[np.ndarray | float]] | None:
        """Return ∂h/∂v in closed form, for each channel q real values that broadcast to (...).

        None by default: complex steps do as well, a little slower. Checked against them when the machine is read.
        """
        del parameters, v, given
        return None

    def check_given(self, poses: Sequence[str], given: Given, free: Sequence[str]) -> None:
        """Raise InputError for data that cannot be; see `ReadingModel.check_given`. By default nothing is checked."""
        del poses, given, free

    @property
    def at_one_place(self) -> ReadingMachine:
        """The machine at one place of a row: itself, but for one that a row of the data has at two places."""
        return self

    def complete(self, values: Array) -> Array:
        """Return readings (P, K), NaN where nothing was read, with those that anyone may state; by default none."""
        return values

    def tool(self, parameters: Parameters, v: np.ndarray) -> np.ndarray:
        """Return what has to be accurate, (..., m), as `tool_channels` names it: the coordinates by default.

        It must take complex numbers, as `read` must.
        """
        del parameters
        return v

    def place_tool(self, parameters: Parameters, v: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
        """Return position (..., 3) and axes (..., 3, 3) of the tool in the base frame, as `tool` has them.

        None by default; what instruments are spared is a rotation vector on the way to its matrix.
        """
        del parameters, v
        return None

    def tool_slopes(
        self, parameters: Parameters, v: np.ndarray, with_parameters: bool
    ) -> tuple[Array, Mapping[str, Array]] | None:
        """Return derivatives of `tool` in closed form: ∂/∂v (..., m, q), and by symbol (..., m, n) or (..., m).

        None by default, where complex steps do; parameters that do not move the tool are left out, and all of them may
        be where they are not asked for. Checked against complex steps when the machine is read.
        """
        del parameters, v, with_parameters
        return None

    def outline(self, parameters: Parameters, v: np.ndarray) -> tuple[np.ndarray, Sequence[tuple[int, int]]] | None:
        """Return what `bayescal show` draws: points (..., P, 3) in mm, and which of them lines join, by their numbers.

        None by default: such a machine cannot be drawn.
        """
        del parameters, v
        return None

    def rotation(self, v: np.ndarray) -> np.ndarray | None:
        """Return how the tool is turned, (..., m, m) from its frame to the base's; None, as by default: it is not.

        It must take complex numbers. A rotation vector among the numbers of `tool` says the same.
        """
        del v
        return None


class Parameters(Mapping[str, np.ndarray]):
    """Parameter vectors by symbol: a block's values have shape (..., n), a single one's (...)."""

    def __init__(self, layout: ParameterLayout, theta: np.ndarray) -> None:
        """Look at parameter vectors (..., D)."""
        self._layout, self._theta = layout, theta

    def __getitem__(self, symbol: str) -> np.ndarray:
        """Return a symbol's values."""
        found = self._theta[..., self._layout.index[symbol]]
        return found if self._layout.block(symbol).per_leg else found[..., 0]

    def __iter__(self) -> Iterator[str]:
        """Iterate over the symbols."""
        return iter(self._layout.symbols)

    def __len__(self) -> int:
        """Return the number of symbols."""
        return len(self._layout.blocks)


@dataclass(frozen=True)
class _Steps:
    """Which entries of (d, v) are stepped together, and where what is seen belongs.

    ``places`` (C, D + q) holds one where an entry is stepped in a round; what sensor ``rows[n]`` sees of entry
    ``entries[n]`` stands in round ``rounds[n]``.
    """

    places: Array
    rounds: np.ndarray
    rows: np.ndarray
    entries: np.ndarray


def colour(pattern: np.ndarray) -> np.ndarray:
    """Return a colour for each column of a pattern (K, n), so that columns of one colour share no row; -1 for none.

    Greedy, the fullest columns first (Curtis, Powell and Reid 1974).
    """
    colours = np.full(pattern.shape[1], -1)
    taken: list[np.ndarray] = []
    for column in np.argsort(-pattern.sum(axis=0), kind="stable"):
        own = pattern[:, column]
        if not own.any():
            continue
        free = next((k for k, rows in enumerate(taken) if not (rows & own).any()), len(taken))
        if free == len(taken):
            taken.append(np.zeros(len(own), dtype=bool))
        taken[free] |= own
        colours[column] = free
    return colours


@dataclass(frozen=True, eq=False)
class FunctionModel(ReadingModel):
    """A machine of one function as a model of readings.

    InputError when made: for a missing or wrong member, a function that returns another shape, that is not finite at
    home, or that is not analytic.
    """

    name: str
    machine: ReadingMachine

    def __post_init__(self) -> None:
        """Check the machine: its members, its function's values and derivatives; picked sensors were, with it."""
        if self.channels is not EVERY:
            return
        check_members(self.name, self.machine)
        super().__post_init__()
        check_values(self)
        check_tool(self)
        check_derivatives(self)

    @cached_property
    def layout(self) -> ParameterLayout:
        """The machine's parameters."""
        return ParameterLayout(tuple(self.machine.parameters))

    @property
    def sensors(self) -> tuple[Channel, ...]:
        """The machine's sensors."""
        return tuple(self.machine.channels)

    @cached_property
    def coordinates(self) -> tuple[Coordinate, ...]:
        """The machine's coordinates."""
        return tuple(self.machine.coordinates)

    @property
    def given(self) -> tuple[str, ...]:
        """What has to be known of each row of the data."""
        return tuple(self.machine.given)

    of_function = hand_on("machine")
    actuated = hand_on("machine.commanded")
    member = hand_on("machine.member")
    check_given = hand_on("machine.check_given")

    @cached_property
    def pose_channels(self) -> tuple[Channel, ...]:
        """The coordinates; those of the tool where the machine says that they are the tool."""
        stated = tuple(self.machine.tool_channels)
        return stated if stated and not self.has_own_tool else super().pose_channels

    @cached_property
    def tool_channels(self) -> tuple[Channel, ...]:
        """What the machine says; its coordinates where it says nothing."""
        return tuple(self.machine.tool_channels) if self.has_own_tool else self.pose_channels

    @property
    def has_own_tool(self) -> bool:
        """Whether the tool is something else than the coordinates."""
        return type(self.machine).tool is not ReadingMachine.tool

    @property
    def states_tool(self) -> bool:
        """Whether the machine says what has to be accurate; where nothing moves nothing has to."""
        return bool(self.machine.tool_channels) or not self.coordinates

    @property
    def tells_rotation(self) -> bool:
        """Whether the machine says how its tool is turned."""
        return bool(self.tool_turned) or type(self.machine).rotation is not ReadingMachine.rotation

    def rotation(self, pose: Array) -> Array:
        """Return what the machine says; see `ReadingModel.rotation`."""
        turned = self.machine.rotation(pose)
        return super().rotation(pose) if turned is None else np.asarray(turned)

    # --- readings ------------------------------------------------------------------------------------------------

    def complete(self, values: Array) -> Array:
        """Return what the machine says; see `ReadingMachine.complete`."""
        if self.places is None:
            return self.machine.complete(values)
        every = np.full((len(values), len(self.sensors)), np.nan)
        every[:, self.places] = values
        return self.take(self.machine.complete(every))

    def evaluate(self, theta: np.ndarray, pose: np.ndarray, given: Given) -> np.ndarray:
        """Return the function's values, real or complex, for (..., D) and (..., q)."""
        found = np.asarray(self.machine.read(Parameters(self.layout, theta), pose, given))
        if not len(self.coordinates) and found.ndim:  # where nobody asks for the pose, not even for how many there are
            found = np.broadcast_to(found, (*np.broadcast_shapes(pose.shape[:-1], found.shape[:-1]), found.shape[-1]))
        return self.take(found)

    def read(self, theta: Array, pose: Array, given: Given = NO_CONDITIONS) -> Array:
        """Return the readings; see `ReadingModel.read`."""
        with np.errstate(all="ignore"):
            return np.asarray(self.evaluate(theta, pose, given), dtype=np.float64)

    def differentiate(self, theta: Array, pose: Array, given: Given, directions: Array) -> tuple[Array, Array]:
        """Return readings (..., K) and what they change along directions (C, D + q) of (d, v), (C, ..., K)."""
        at_once = max(1, AT_ONCE // max(1, math.prod(np.broadcast_shapes(theta.shape[:-1], pose.shape[:-1]))))
        values, moved = np.empty(0), list[Array]()
        for k in range(0, len(directions), at_once):
            part = self._step(lambda d, v: self.evaluate(d, v, given), theta, pose, directions[k : k + at_once])
            values = values if moved else part[0].real.copy()
            moved.append(part.imag.copy())
        turned = np.concatenate(moved)
        # where a real argument has no value, a complex one has: the root of a negative number is imaginary
        nowhere = (np.abs(turned) > LARGEST_STEP).any(axis=0)
        return np.where(nowhere, np.nan, values), np.where(nowhere, np.nan, turned / COMPLEX_STEP)

    def _step(
        self, function: Callable[[np.ndarray, np.ndarray], np.ndarray], theta: Array, pose: Array, directions: Array
    ) -> np.ndarray:
        """Return a function's values (C, ..., m) at complex steps along directions (C, D + q) of (d, v)."""
        n = self.layout.size
        rounds = (len(directions),) + (1,) * (max(theta.ndim, pose.ndim) - 1)
        along = 1j * COMPLEX_STEP * directions
        with np.errstate(all="ignore"):
            moved = theta + along[:, :n].reshape(*rounds, n), pose + along[:, n:].reshape(*rounds, -1)
            return np.asarray(function(*moved))

    def linearise(
        self, theta: Array, pose: Array, with_parameters: bool = True, given: Given = NO_CONDITIONS
    ) -> Readings:
        """Return the readings with their derivatives; see `ReadingModel.linearise`."""
        n, q, steps = self.layout.size, len(self.coordinates), self._steps[with_parameters]
        if not len(steps.places):
            values = self.read(theta, pose, given)
            return Readings(values, np.zeros((*values.shape, q)), np.zeros((*values.shape, n)))
        if not with_parameters and (closed := self.closed_slopes(theta, pose, given)) is not None:
            return Readings(self.read(theta, pose, given), closed)
        values, slopes = self.differentiate(theta, pose, given, steps.places)
        first = 0 if with_parameters else n
        every = np.zeros((*values.shape, n + q - first))
        every[..., steps.rows, steps.entries - first] = np.moveaxis(slopes, 0, -2)[..., steps.rounds, steps.rows]
        return Readings(values, every[..., n - first :], every[..., :n] if with_parameters else np.empty(0))

    def closed_slopes(self, theta: Array, pose: Array, given: Given) -> Array | None:
        """Return ∂h/∂v (..., K, q) where the machine has it in closed form."""
        with np.errstate(all="ignore"):
            rows = self.machine.slopes(Parameters(self.layout, theta), pose, given)
        if rows is None:
            return None
        rows = rows if self.places is None else [rows[k] for k in self.places]
        n, q = len(self.channels), len(self.coordinates)
        result = np.empty((*np.broadcast_shapes(theta.shape[:-1], pose.shape[:-1]), n, q))
        for k, row in zip(range(n), rows, strict=True):
            for i, one in zip(range(q), row, strict=True):
                result[..., k, i] = one
        return result

    @cached_property
    def pattern(self) -> np.ndarray:
        """Which sensors see which parameters and coordinates, (K, D + q): their derivative is not always zero."""
        theta, pose, given = draw_points(self)
        _, slopes = self.differentiate(theta, pose, given, np.eye(theta.shape[1] + pose.shape[1]))
        return np.asarray(((slopes != 0.0) | np.isnan(slopes)).any(axis=1).T)

    def _plan(self, some: np.ndarray) -> _Steps:
        pattern = self.pattern & some
        colours = colour(pattern)
        places = np.zeros((colours.max(initial=-1) + 1, len(some)))
        used = np.flatnonzero(pattern.any(axis=0))
        places[colours[used], used] = 1.0
        rows, entries = np.nonzero(pattern)
        return _Steps(places, colours[entries], rows, entries)

    @cached_property
    def _steps(self) -> tuple[_Steps, _Steps]:
        """Those of the coordinates alone, and of the parameters too."""
        of_pose = np.arange(self.pattern.shape[1]) >= self.layout.size
        return self._plan(of_pose), self._plan(np.ones_like(of_pose))

    # --- what has to be accurate -----------------------------------------------------------------------------------

    def tool(self, theta: Array, pose: Array, with_parameters: bool = True) -> tuple[Array, Array, Array]:
        """Return what has to be accurate and what moves it; see `ReadingModel.tool`."""
        closed = self.machine.tool_slopes(Parameters(self.layout, theta), pose, with_parameters)
        if closed is None:
            return self.step_tool(theta, pose, with_parameters)
        values = self.tool_values(theta, pose)
        by_pose, by = np.broadcast_to(closed[0], (*values.shape, len(self.coordinates))), closed[1]
        if not with_parameters:
            return values, by_pose, np.empty(0)
        by_parameters = np.zeros((*values.shape, self.layout.size))
        for symbol, slopes in by.items():
            places = self.layout.index[symbol]
            by_parameters[..., places] = slopes.reshape(*slopes.shape[: values.ndim], len(places))
        return values, by_pose, by_parameters

    def tool_frame(self, theta: Array, pose: Array) -> tuple[Array, Array] | None:
        """Return position and axes of the tool where the machine has them; see `ReadingMachine.place_tool`."""
        return self.machine.place_tool(Parameters(self.layout, theta), pose)

    def step_tool(self, theta: Array, pose: Array, with_parameters: bool = True) -> tuple[Array, Array, Array]:
        """Return the same by complex steps."""
        n, q = (self.layout.size if with_parameters else 0), len(self.coordinates)
        every = np.eye(self.layout.size + q)[-(n + q) :]
        found = self._step(lambda d, v: self.machine.tool(Parameters(self.layout, d), v), theta, pose, every)
        shape = np.broadcast_shapes(theta.shape[:-1], pose.shape[:-1])
        found = np.broadcast_to(found, (len(every), *shape, found.shape[-1]))
        slopes = np.moveaxis(found.imag / COMPLEX_STEP, 0, -1)
        return found[0].real, slopes[..., n:], slopes[..., :n] if with_parameters else np.empty(0)

    def tool_values(self, theta: Array, pose: Array) -> Array:
        """Return what has to be accurate; see `ReadingModel.tool_values`."""
        found = np.asarray(self.machine.tool(Parameters(self.layout, theta), pose), dtype=np.float64)
        return np.broadcast_to(found, (*np.broadcast_shapes(theta.shape[:-1], pose.shape[:-1]), found.shape[-1]))
