"""Whether a machine of one function is one: its members, its values at home, its derivatives against differences."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from bayescal.errors import InputError
from bayescal.files.plain_text import add_article
from bayescal.machines.parameters import ParameterBlock
from bayescal.machines.readings.base import Channel, Coordinate, Given
from bayescal.machines.readings.colours import draw_points
from bayescal.numerics.geometry import Array

if TYPE_CHECKING:
    from bayescal.machines.readings.function import FunctionModel, ReadingMachine

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
                raise InputError(f"{where}: {member}: found {one_name!r} twice, expected each name once")
    if not machine.parameters or not machine.channels:
        raise InputError(f"{where}: found no parameter or no channel, expected at least one of each")
    _check_rotations(f"{where}: channels", machine.channels)
    known = {name for one in machine.channels for name in (one.name, one.kind)}
    for name in machine.commanded:
        if name not in known:
            channels = ", ".join(one.name for one in machine.channels)
            raise InputError(f"{where}: commanded: found {name!r}, expected some of {channels}")


def check_tool(model: FunctionModel) -> None:
    """Raise InputError for a tool without names, or one that is not as many finite numbers at home as it has names."""
    machine = model.machine
    where = f"machine {model.name!r}: class {type(machine).__name__}: tool"
    if model.has_own_tool and not machine.tool_channels:
        raise InputError(
            f"{where}: found no tool_channels, expected names and units of what it returns, each a Channel"
        )
    for one in machine.tool_channels:
        if not isinstance(one, Channel):
            raise InputError(f"{where}_channels: found {one!r}, expected a Channel")
    _check_rotations(f"{where}_channels", machine.tool_channels)
    theta, pose, _ = draw_points(model, POINTS)
    found, _, _ = _call(where, "numbers", lambda: model.tool(theta, pose))
    names = [one.name for one in machine.tool_channels] or [one.name for one in model.coordinates]
    if found.shape[-1] != len(names):
        raise InputError(f"{where}: found {found.shape[-1]} numbers, expected {len(names)}: {', '.join(names)}")
    for k in np.flatnonzero(~np.isfinite(found[0])):
        raise InputError(f"{where}: {names[k]}: found {found[0, k]} at home, expected a finite number")


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
        raise InputError(f"{where}: found shape {found.shape} for {POINTS} poses, expected {(POINTS, n)}")
    for k in np.flatnonzero(~np.isfinite(found[0])):
        raise InputError(f"{where}: {model.channels[k].name}: found {found[0, k]} at home, expected a finite reading")
    stacked = _read(model, where, theta[:, None], pose[None], {name: value[None] for name, value in given.items()})
    if stacked.shape != (POINTS, POINTS, n):
        raise InputError(
            f"{where}: found shape {stacked.shape} for {POINTS} machines at {POINTS} poses, "
            f"expected {(POINTS, POINTS, n)}: it must take any leading axes"
        )


def _call[Found](where: str, expected: str, function: Callable[[], Found]) -> Found:
    """Return what somebody else's code returns; InputError for whatever it raises."""
    try:
        with np.errstate(all="ignore"):
            return function()
    except Exception as error:
        text = " ".join(str(error).split())
        raise InputError(f"{where}: failed with {type(error).__name__}: {text}, expected {expected}") from error


def _read(model: FunctionModel, where: str, theta: Any, pose: Any, given: Given) -> Array:
    analytic = np.iscomplexobj(theta)
    hint = "; bayescal.numerics.analytic has functions that take complex numbers" if analytic else ""
    return _call(where, f"readings{hint}", lambda: np.asarray(model.evaluate(theta, pose, given)))


def check_derivatives(model: FunctionModel) -> None:
    """Raise InputError where a derivative by complex step is not that of central differences."""
    theta, pose, given = draw_points(model, POINTS)
    where = f"machine {model.name!r}: {type(model.machine).__name__}.read"
    _read(model, f"{where}, with complex numbers", theta + 0j, pose + 0j, given)
    here = np.concatenate([theta, pose], axis=1)
    _, exact = model.differentiate(theta, pose, given, np.eye(here.shape[1]))
    size = DIFFERENCE * np.maximum(np.abs(here), 1.0)
    slope, wide = (
        np.array([_differ(model, where, here, k, times * size[:, k], given) for k in range(here.shape[1])])
        for times in (1.0, 4.0)
    )
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
            f"{where}: {model.channels[k].name}: found ∂/∂{names[entry]} = {exact[entry, point, k]:.6g} by "
            f"complex step and {slope[entry, point, k]:.6g} by differences, expected an analytic function; "
            "abs, norm and arctan2 of NumPy are none, those of bayescal.numerics.analytic are"
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


def _differ(model: FunctionModel, where: str, here: Array, entry: int, size: Array, given: Given) -> Array:
    """Return the derivatives by an entry of (d, v) at points (n, D + q), by central differences of steps (n,)."""
    n, step = model.layout.size, np.zeros_like(here)
    step[:, entry] = size
    above, below = (_read(model, where, at[:, :n], at[:, n:], given) for at in (here + step, here - step))
    return np.asarray((above - below) / (2.0 * size[:, None]))
