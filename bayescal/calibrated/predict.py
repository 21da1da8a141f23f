"""What a calibrated machine does: poses of commands, commands of poses, and how well both are known.

A machine θ that is told to read s stands where h_c(θ, v) = s + δ, δ its errors. Near the posterior mean θ̄ and the pose
v̄ that it has there, v = v̄ + H⁺ (δ - r(θ)), with H = ∂h_c/∂v, its inverse weighed by the commands' noise where there are
more of them than coordinates, and r(θ) = h_c(θ, v̄) - s; the tool t(θ, v) moves with both. Commands that hold a pose
are s = h_c(θ, v) - δ. Systematic errors that the calibration found are a part of δ, Φ c: their mean moves poses and
commands, and their coefficients c are known together with θ (`bayescal.calibrated.functions`).

Where draws of the posterior keep to the tangent, A (θ - θ̄) stands for r, A = ∂h_c/∂θ: the mean is that of the machine
θ̄, and the covariance follows from that of θ. Along a curved ridge they do not: some draws are put into h and t as they
are.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from scipy.special import chdtrc

from bayescal.calibrated.machine import MODEL, CalibratedMachine
from bayescal.density.calibration.measurements import Comparison, Measurements
from bayescal.errors import InputError
from bayescal.identifiability.information import root_of
from bayescal.machines.readings import Channel
from bayescal.machines.readings.base import NO_CONDITIONS, Given
from bayescal.machines.readings.newton import locate_pose, solve
from bayescal.numerics.geometry import Array, matrix_from_rotation_vector

SPREAD_DRAWS = 300
"""Draws that tell a covariance, its standard deviations to 4 %."""
SPREAD_POSES = 16  # at a time: scratch memory of these draws stays in the cache
COMPARED = 16  # poses of the workspace at which draws are compared with their tangent
CURVED = 0.1  # of a standard deviation that draws may be off the tangent, root mean square
STARTS, TRIED, BEYOND = 5000, 100, 16.0
"""Poses whose commands are compared, of which so many are tried, as far out as that many times the workspace."""
MOST_TRIED = 100  # rows of a part, the worst first: where more contradict, it is the commands
IMPROBABLE = 1e-6  # of commands that contradict one another more by chance
CHUNK = 1024
"""Poses at a time: what they take of the memory stays small."""


@dataclass(frozen=True, eq=False)
class PosePrediction:
    """Where a machine stands at P commands, and where its tool is.

    Attributes
    ----------
    channels : tuple of Channel
        The tool's m numbers.
    tool : ndarray, shape (P, m)
        Posterior mean; without draws that of the mean machine. NaN where there is no pose.
    pose : ndarray, shape (P, q)
        The coordinates, likewise.
    covariance, pose_covariance : ndarray, shapes (P, m, m) and (P, q, q), or None
        Of tool and coordinates: geometry, errors of the commanded channels, systematic ones among them. A rotation
        vector errs about the base axes. None where the posterior's covariance is not known.
    of_geometry : ndarray, shape (P, m, m), or None
        The part of the tool's covariance by the geometry and systematic errors that were found with it.
    found : ndarray of bool, shape (P,)
        Whether the machine has a pose there.
    misfit : ndarray, shape (P,), or None
        By how much the commands contradict one another: root mean square, in standard deviations of geometry and errors
        of the commands. About one where they are those of a pose; None where they are no more than the coordinates.
    contradictory : ndarray of bool, shape (P,)
        Whether they do so more than by chance: perhaps there is no such pose, or it is another one.
    """

    channels: tuple[Channel, ...]
    tool: Array
    pose: Array
    covariance: Array | None
    pose_covariance: Array | None
    of_geometry: Array | None
    found: np.ndarray
    misfit: Array | None
    contradictory: np.ndarray

    @property
    def sd(self) -> Array | None:
        """Standard deviations of the tool's numbers, shape (P, m)."""
        return None if self.covariance is None else np.sqrt(np.diagonal(self.covariance, axis1=1, axis2=2))

    @property
    def position(self) -> Array:
        """The tool's lengths, shape (P, d), mm."""
        return self.tool[:, [one.unit == "mm" for one in self.channels]]

    @property
    def rotation(self) -> Array:
        """The rotation matrix of the tool's rotation vector, shape (P, 3, 3); NaN where there is no pose."""
        vector = self.tool[:, [bool(one.rotation) for one in self.channels]]
        turned = matrix_from_rotation_vector(np.nan_to_num(vector))
        return np.where(self.found[:, None, None], turned, np.nan)


@dataclass(frozen=True, eq=False)
class PoseCommands:
    """Commands of P poses.

    Attributes
    ----------
    commands : ndarray, shape (P, C)
        Posterior mean in the channels' units; NaN where there are none. Without draws that of the mean machine.
    covariance : ndarray, shape (P, C, C), or None
        Of the commands that hold the pose: geometry, and errors of the commanded channels.
    faults : tuple of str, length P
        Why a pose is out of reach, in words; empty where it is not.
    """

    commands: Array
    covariance: Array | None
    faults: tuple[str, ...]

    @property
    def sd(self) -> Array | None:
        """Standard deviations of the commands, shape (P, C)."""
        return None if self.covariance is None else np.sqrt(np.diagonal(self.covariance, axis1=1, axis2=2))

    @property
    def reached(self) -> np.ndarray:
        """Which poses are within reach, shape (P,)."""
        return np.array([not fault for fault in self.faults], dtype=bool)


@dataclass(frozen=True, eq=False)
class LinearisedCommands:
    """The mean machine at P commands, to first order."""

    commands: Array  # (P, C)
    given: Given  # (P,)
    pose: Array  # (P, q)
    found: np.ndarray  # (P,)
    by_pose: Array  # (P, C, q): H
    by_parameters: Array  # (P, C, D): A
    outputs: Array  # (P, M): the tool's m numbers, then the coordinates where these are others
    # (P, M, q) and (P, M, D): of what the outputs err by, rotations about the base axes
    outputs_by_pose: Array
    outputs_by_parameters: Array
    gain: Array  # (P, M, C): what moves the outputs by errors of the commands; NaN where there is no pose

    @property
    def by_geometry(self) -> Array:
        """What moves the outputs by the parameters, shape (P, M, D)."""
        return self.outputs_by_parameters - self.gain @ self.by_parameters


def compare_outputs(calibrated: CalibratedMachine) -> Comparison:
    """Return how the tool and, where these are others, the coordinates are compared, M channels in a row."""
    tool, pose = calibrated.model.tool_channels, calibrated.model.pose_channels
    return Comparison(tool if is_pose(calibrated) else (*tool, *pose))


def is_pose(calibrated: CalibratedMachine) -> bool:
    """Whether the tool is the coordinates themselves."""
    return calibrated.model.tool_channels is calibrated.model.pose_channels


def check_determined(calibrated: CalibratedMachine) -> None:
    """Raise InputError where commands do not determine a pose: fewer of them than coordinates, or no coordinate."""
    model, n = calibrated.model, len(calibrated.commanded)
    q = len(model.coordinates)
    if not q:
        uses = "; bayescal compensate gives its readings" if n else ""
        raise InputError(f"machine {calibrated.name!r}: not meaningful: no pose coordinates{uses}")
    if n < q:
        stated = ", ".join(model.commanded) or "none"
        raise InputError(
            f"machine {calibrated.name!r}: not meaningful: {n} commanded channels ({stated}) do not determine its {q} "
            f"coordinates ({', '.join(one.name for one in model.coordinates)})"
        )


def place_machine(calibrated: CalibratedMachine, commands: Array, given: Given = NO_CONDITIONS) -> LinearisedCommands:
    """Return the mean machine at commands (P, C), to first order."""
    pose, found = calibrated.model.locate(calibrated.theta, commands, given, weights=calibrated.weights)
    at = linearise_place(calibrated, pose, found, commands, given)
    if len(calibrated.commanded) <= len(calibrated.model.coordinates):
        return at
    misfit = measure_misfit(calibrated, at, find_errors(calibrated, at))
    contradictory = np.flatnonzero(~found | find_contradictory(calibrated, misfit))
    if not len(contradictory):
        return at
    worst = contradictory[np.argsort(-np.nan_to_num(misfit[contradictory], nan=np.inf), kind="stable")][:MOST_TRIED]
    pose[worst], found[worst] = _try_others(calibrated, pose[worst], commands[worst], _pick(given, worst))
    return linearise_place(calibrated, pose, found, commands, given)


def _try_others(calibrated: CalibratedMachine, pose: Array, commands: Array, given: Given) -> tuple[Array, np.ndarray]:
    """Return the poses (P, q) of least squares of more commands than coordinates, and which are found.

    The way from home led to others, or to none: NaN. Of poses all over the workspace and beyond, those with the nearest
    commands are the starts.
    """
    model, theta, weights, q = calibrated.model, calibrated.theta, calibrated.weights, len(calibrated.model.coordinates)
    compare = Comparison(calibrated.command_channels)

    def read(pose: Array, rows: np.ndarray) -> Array:
        with np.errstate(all="ignore"):
            return np.asarray(model.read(theta, pose, _pick(given, rows))[:, calibrated.commanded])

    def measure(command: Array, read: Array) -> Array:
        with np.errstate(all="ignore"):
            left = np.sum((weights * compare.subtract(command, read)) ** 2, axis=1)
        return np.where(np.isfinite(left), left, np.inf)

    left = measure(commands, read(pose, np.arange(len(pose))))
    rng, (least, most) = np.random.default_rng(0), bound_workspace(calibrated)
    size = 0.5 * (most - least) * BEYOND ** rng.uniform(0.0, 1.0, (STARTS, q))
    starts = 0.5 * (least + most) + size * rng.uniform(-1.0, 1.0, (STARTS, q))
    there_read: Array | None = None
    for k in range(len(pose)):
        rows = np.full(STARTS, k)
        if there_read is None or given:  # the same in every row, unless its conditions are others
            there_read = read(starts, rows)
        near = np.argsort(measure(commands[k], there_read), kind="stable")[:TRIED]
        with np.errstate(all="ignore"):
            some, each = _pick(given, rows[:TRIED]), np.tile(commands[k], (TRIED, 1))
            other, there = locate_pose(model, theta, each, some, starts[near], weights)
        then = np.where(there, measure(commands[k], read(other, rows[:TRIED])), np.inf)
        if then.min() < left[k]:
            pose[k], left[k] = other[then.argmin()], then.min()
    return pose, np.isfinite(left)


def linearise_place(
    calibrated: CalibratedMachine, pose: Array, found: np.ndarray, commands: Array, given: Given
) -> LinearisedCommands:
    """Return the mean machine at poses (P, q) that are found, to first order."""
    model, theta, weights = calibrated.model, calibrated.theta, calibrated.weights
    here = model.linearise(theta, pose, True, given)
    by_pose, by_parameters = here.by_pose[:, calibrated.commanded], here.by_parameters[:, calibrated.commanded]
    with np.errstate(all="ignore"):
        outputs, direct, indirect = model.tool(theta, pose)
    if not is_pose(calibrated):
        n, q = pose.shape
        outputs = np.concatenate([outputs, pose], axis=1)
        direct = np.concatenate([direct, np.broadcast_to(np.eye(q), (n, q, q))], axis=1)
        indirect = np.concatenate([indirect, np.zeros((n, q, len(theta)))], axis=1)
    compared, nothing = compare_outputs(calibrated), np.zeros_like(outputs)
    direct, indirect = (compared.pull_back(nothing, outputs, one) for one in (direct, indirect))
    back = invert(weights[:, None] * by_pose, found, model.pose_scale) * weights
    return LinearisedCommands(
        commands, given, pose, found, by_pose, by_parameters, outputs, direct, indirect, direct @ back
    )


class ErrorsThere(NamedTuple):
    """What commanded channels err by at P poses: δ = mean + columns (c - c̄) + what is independent of all else."""

    mean: Array  # (P, C)
    parts: dict[str, Array]  # by source: covariances (P, C, C) of what is independent of all else
    columns: Array | None  # (P, C, A); None where no systematic errors were found

    @property
    def independent(self) -> Array:
        """Covariance of all that is independent, (P, C, C)."""
        return np.sum(list(self.parts.values()), axis=0)


def find_errors(calibrated: CalibratedMachine, at: LinearisedCommands) -> ErrorsThere:
    """Return what the commanded channels err by at some poses.

    A drift is another one at another time, as large as it was.
    """
    model, errors, known = calibrated.model, calibrated.errors, calibrated.functions
    if known is None or calibrated.covariance is None:
        parts = {name: one.covariance(at.pose, at.commands) for name, one in errors.split().items()}
        return ErrorsThere(np.zeros_like(at.commands), parts, None)
    own, n = calibrated.commanded, len(model.channels)
    values = np.full((len(at.commands), n), np.nan)
    values[:, own] = at.commands
    data = Measurements(tuple(map(str, range(len(values)))), values, np.ones_like(values), at.given)
    with np.errstate(all="ignore"):
        acted, beside = known.show(model, data, model.read(calibrated.theta, at.pose, at.given))
        gain = model.error_gain(calibrated.theta, at.pose, at.given)
    shown = (np.broadcast_to(np.eye(n), (len(values), n, n)) if gain is None else gain)[:, own]
    alone = np.concatenate([shown * np.sqrt(beside)[:, None], shown @ (known.place(model) * known.drift)], axis=-1)
    others = replace(errors, model_variance=np.zeros_like(errors.model_variance)).split()
    parts = {name: one.covariance(at.pose, at.commands) for name, one in others.items()}
    parts[MODEL] = alone @ np.swapaxes(alone, 1, 2)
    columns = -(shown @ acted)
    return ErrorsThere(columns @ known.mean, parts, columns)


# --- poses of commands ---------------------------------------------------------------------------------------------


def predict_poses(calibrated: CalibratedMachine, commands: Array, given: Given = NO_CONDITIONS) -> PosePrediction:
    """Return where a machine stands at commands s, shape (P, C), and its tool, with their covariance.

    Parameters
    ----------
    calibrated : CalibratedMachine
    commands : ndarray, shape (P, C)
        Of the commanded channels, in their units: actuator positions in mm for a machine on legs.
    given : mapping of str to ndarray, shape (P,)
        What the machine has to know of each pose besides.

    Raises
    ------
    InputError
        For another shape, something missing of what is given, and a machine whose commands do not tell its pose.

    Examples
    --------
    >>> import numpy as np
    >>> found = bc.predict_poses(calibrated, np.array([[250.0, 250.0, 250.0]]))
    >>> found.tool.shape, found.covariance.shape
    ((1, 3), (1, 3, 3))
    """
    check_determined(calibrated)
    check_shape(commands, [one.name for one in calibrated.command_channels], "commands")
    check_given(calibrated, given, len(commands))
    curved = find_curved(calibrated)
    parts = [_predict_some(calibrated, commands[part], _pick(given, part), curved) for part in split(len(commands))]
    channels, m = calibrated.model.tool_channels, len(calibrated.model.tool_channels)
    outputs, found, misfits, *spreads = zip(*parts, strict=True)
    every, there, part = np.concatenate(outputs), np.concatenate(found), slice(0 if is_pose(calibrated) else m, None)
    misfit, spare = np.concatenate(misfits), len(calibrated.commanded) > len(calibrated.model.coordinates)
    fits = (there, misfit if spare else None, find_contradictory(calibrated, misfit))
    if calibrated.covariance is None:
        return PosePrediction(channels, every[:, :m], every[:, part], None, None, None, *fits)
    whole, of_geometry = (np.concatenate(one) for one in spreads)
    return PosePrediction(
        channels, every[:, :m], every[:, part], whole[:, :m, :m], whole[:, part, part], of_geometry[:, :m, :m], *fits
    )


def _predict_some(
    calibrated: CalibratedMachine, commands: Array, given: Given, curved: Array | None
) -> tuple[Array, np.ndarray, Array, Array | None, Array | None]:
    """Return outputs (P, M), which are found, misfits (P,) and covariances (P, M, M), in whole and by the geometry."""
    at = place_machine(calibrated, commands, given)
    errors = find_errors(calibrated, at)
    moved = np.einsum("pij,pj->pi", at.gain, errors.mean)
    add, misfit = compare_outputs(calibrated).add, measure_misfit(calibrated, at, errors)
    if calibrated.covariance is None:
        return add(at.outputs, moved), at.found, misfit, None, None
    shift, factors = spread_outputs(calibrated, at, errors, curved)
    of_geometry = factors @ np.swapaxes(factors, 1, 2)
    others = at.gain @ errors.independent @ np.swapaxes(at.gain, 1, 2)
    return add(at.outputs, moved + shift), at.found, misfit, of_geometry + others, of_geometry


def find_contradictory(calibrated: CalibratedMachine, misfit: Array) -> np.ndarray:
    """Return which commands contradict one another more than by chance, (P,), by their `measure_misfit`."""
    spare = len(calibrated.commanded) - len(calibrated.model.coordinates)
    return np.asarray(chdtrc(max(spare, 1), spare * misfit**2) < IMPROBABLE)


def measure_misfit(calibrated: CalibratedMachine, at: LinearisedCommands, errors: ErrorsThere) -> Array:
    """Return by how much commands contradict one another, (P,), as `PosePrediction.misfit` says; zero where none can.

    What no pose moves, N^T (s + δ - h) with N^T H = 0, has the covariance N^T (Σ_δ + A Σ_θ A^T) N.
    """
    model, q = calibrated.model, len(calibrated.model.coordinates)
    if at.commands.shape[1] <= q:
        return np.zeros(len(at.commands))
    with np.errstate(all="ignore"):
        read = model.read(calibrated.theta, at.pose, at.given)[:, calibrated.commanded]
        left = Comparison(calibrated.command_channels).subtract(at.commands + errors.mean, read)
    good = at.found & np.isfinite(left).all(axis=1) & np.isfinite(at.by_pose).all(axis=(1, 2))
    covariance = errors.independent[good]
    if calibrated.covariance is not None:
        columns = None if errors.columns is None else -errors.columns[good]
        slope, _, beside = _join_errors(calibrated, at.by_parameters[good], columns)
        factors = np.concatenate([slope @ root_of(calibrated.covariance).T, beside], axis=-1)
        covariance = covariance + factors @ np.swapaxes(factors, 1, 2)
    spare = np.linalg.svd(at.by_pose[good] * model.pose_scale)[0][..., q:]
    seen = np.einsum("pij,pi->pj", spare, left[good])
    white = np.linalg.pinv(np.swapaxes(spare, 1, 2) @ covariance @ spare, hermitian=True)
    misfit = np.full(len(left), np.nan)
    misfit[good] = np.sqrt(np.einsum("pi,pij,pj->p", seen, white, seen) / seen.shape[1])
    return misfit


def spread_outputs(
    calibrated: CalibratedMachine, at: LinearisedCommands, errors: ErrorsThere, curved: Array | None
) -> tuple[Array, Array]:
    """Return how the posterior moves the outputs, in the mean (P, M), and factors (P, M, R) of their covariance.

    The covariance of two outputs at any poses is the sum of products of their factors. Systematic errors move them
    together with the geometry.
    """

    def respond(part: slice, theta: Array) -> Array:
        return respond_at(calibrated, at, part, theta)

    columns = None if errors.columns is None else at.gain @ errors.columns
    return _spread(calibrated, at.by_geometry, respond, curved, columns)


def respond_at(calibrated: CalibratedMachine, at: LinearisedCommands, part: slice, theta: Array) -> Array:
    """Return how machines θ, shape (S, D), as they are, move the outputs of some poses, shape (P, M, S)."""
    model, given = calibrated.model, _pick(at.given, part)
    read = model.respond(theta, calibrated.theta, at.pose[part], at.commands[part], given)
    moved = -(at.gain[part] @ read)
    m = len(model.tool_channels)
    if at.outputs_by_parameters[part].any():
        with np.errstate(all="ignore"):
            tool = model.tool_values(theta[:, None], at.pose[part])
        moved[:, :m] += np.moveaxis(calibrated.comparison.subtract(tool, at.outputs[part, :m]), 0, -1)
    return np.asarray(moved)


# --- commands of poses ---------------------------------------------------------------------------------------------


def compensate_poses(
    calibrated: CalibratedMachine, poses: Array, given: Given = NO_CONDITIONS, coordinates: bool = False
) -> PoseCommands:
    """Return the commands that hold poses, how well they are known, and which poses are out of reach.

    Parameters
    ----------
    calibrated : CalibratedMachine
    poses : ndarray, shape (P, m) or (P, q)
        The tool's numbers in the units of the model's `tool_channels` (of a machine on legs position in mm and rotation
        vector in rad, base frame), or the machine's coordinates.
    given : mapping of str to ndarray, shape (P,)
    coordinates : bool
        Whether they are the machine's coordinates.

    Raises
    ------
    InputError
        For another shape, and a tool that does not tell the machine's coordinates.

    Examples
    --------
    >>> bc.compensate_poses(calibrated, found.tool).commands.round(6)
    array([[250., 250., 250.]])
    """
    model = calibrated.model
    if not len(calibrated.commanded):
        raise InputError(
            f"machine {calibrated.name!r}: not meaningful: found external channels only, expected commanded ones"
        )
    coordinates = coordinates or is_pose(calibrated)
    wanted = model.pose_channels if coordinates else model.tool_channels
    check_shape(poses, [one.name for one in wanted], "poses")
    check_given(calibrated, given, len(poses))
    if not coordinates and len(wanted) < len(model.coordinates):
        raise InputError(
            f"machine {calibrated.name!r}: not meaningful: {len(wanted)} tool numbers for "
            f"{len(model.coordinates)} coordinates, expected "
            f"{', '.join(one.name for one in model.coordinates)}"
        )
    curved = find_curved(calibrated)
    parts = [
        _command_some(calibrated, poses[part], _pick(given, part), coordinates, curved) for part in split(len(poses))
    ]
    commands, spreads, faults = zip(*parts, strict=True)
    covariance = None if calibrated.covariance is None else np.concatenate(spreads)
    return PoseCommands(np.concatenate(commands), covariance, tuple(fault for some in faults for fault in some))


def _command_some(
    calibrated: CalibratedMachine, wanted: Array, given: Given, coordinates: bool, curved: Array | None
) -> tuple[Array, Array | None, tuple[str, ...]]:
    model, theta = calibrated.model, calibrated.theta
    pose, there = (wanted, np.ones(len(wanted), dtype=bool)) if coordinates else place_tool(calibrated, wanted)
    commands = model.read(theta, pose, given)[:, calibrated.commanded]
    faults = [
        fault if one else "unreachable"
        for fault, one in zip(model.find_faults(theta, pose, commands, given), there, strict=True)
    ]
    at = linearise_place(calibrated, pose, np.isfinite(commands).all(axis=1), commands, given)
    errors = find_errors(calibrated, at)
    if errors.columns is not None:  # they are functions of what is commanded in the end
        errors = find_errors(calibrated, replace(at, commands=commands - errors.mean))
    moved = commands - errors.mean
    if calibrated.covariance is None:
        return moved, None, tuple(faults)
    slope, to_tool = at.by_parameters, None
    if not coordinates:
        m = wanted.shape[1]
        to_tool = at.by_pose @ invert(at.outputs_by_pose[:, :m], at.found, model.pose_scale)
        slope = slope - to_tool @ at.outputs_by_parameters[:, :m]

    def respond(part: slice, draws: Array) -> Array:
        read = model.respond(draws, theta, pose[part], commands[part], _pick(given, part))
        if to_tool is None:
            return read
        with np.errstate(all="ignore"):
            apart = calibrated.comparison.subtract(model.tool_values(draws[:, None], pose[part]), wanted[part])
        return np.asarray(read - to_tool[part] @ np.moveaxis(apart, 0, -1))

    columns = None if errors.columns is None else -errors.columns
    shift, factors = _spread(calibrated, slope, respond, curved, columns)
    return moved + shift, factors @ np.swapaxes(factors, 1, 2) + errors.independent, tuple(faults)


def place_tool(calibrated: CalibratedMachine, wanted: Array) -> tuple[Array, np.ndarray]:
    """Return the mean machine's coordinates (P, q) at which its tool's numbers are as wanted (P, m), and where it is.

    Where they cannot be met all, as of a tool with more numbers than the machine has coordinates, it is not there.
    """
    model, theta, comparison = calibrated.model, calibrated.theta, calibrated.comparison
    start = np.tile(model.home_pose, (len(wanted), 1))
    first = comparison.subtract(wanted, model.tool_values(theta, start))

    def miss(pose: Array, rows: np.ndarray) -> tuple[Array, Array]:
        with np.errstate(all="ignore"):
            values, slope, _ = model.tool(theta, pose, False)
            error = comparison.subtract(wanted[rows], values)
            return error, comparison.pull_back(error, values, slope)

    pose, found = solve(miss, first, start, model.pose_scale, True)
    with np.errstate(all="ignore"):
        left = comparison.subtract(wanted, model.tool_values(theta, pose))
    return pose, found & (np.abs(left) <= MET * (1.0 + np.abs(wanted))).all(axis=1)


MET = 1e-7  # of a tool's number, or of its unit, within which it is as wanted

# --- how the posterior spreads -------------------------------------------------------------------------------------


@lru_cache(maxsize=4)
def find_curved(calibrated: CalibratedMachine) -> Array | None:
    """Return draws (S, D) where these leave the tangent at the mean somewhere in the workspace; None where they do not.

    They are compared at commands anywhere within their range, or in the workspace, the same ones at every call.
    """
    if calibrated.draws is None:
        return None
    theta, commands, given = calibrated.thin(SPREAD_DRAWS), *spread_commands(calibrated)
    if not len(commands) or len(calibrated.commanded) < len(calibrated.model.coordinates):
        return None
    at = place_machine(calibrated, commands, given)
    rows = np.flatnonzero(at.found)
    at = linearise_place(calibrated, at.pose[rows], at.found[rows], commands[rows], _pick(given, rows))
    moved = respond_at(calibrated, at, slice(None), theta)
    tangent = at.by_geometry @ (theta - calibrated.theta).T
    off = np.sqrt(np.mean((moved - tangent) ** 2, axis=-1))
    with np.errstate(invalid="ignore"):
        return theta if np.any(off > CURVED * moved.std(axis=-1)) else None


def spread_commands(calibrated: CalibratedMachine) -> tuple[Array, Given]:
    """Return some commands (P, C) all over their range, or the workspace, and what a pose has to know besides."""
    model, rng = calibrated.model, np.random.default_rng(0)
    low, high = model.command_range.T
    given = calibrated.typical(COMPARED) if calibrated.given or not model.given else None
    if given is None:
        return np.empty((0, len(low))), NO_CONDITIONS
    if np.isfinite([low, high]).all():
        return 0.5 * (low + high) + 0.5 * (high - low) * rng.uniform(-1.0, 1.0, (COMPARED, len(low))), given
    least, most = bound_workspace(calibrated)
    pose = rng.uniform(least, most, (COMPARED, len(model.coordinates)))
    commands = model.read(calibrated.theta, pose, given)[:, calibrated.commanded]
    there = np.isfinite(commands).all(axis=1)
    return commands[there], _pick(given, there)


def bound_workspace(calibrated: CalibratedMachine) -> Array:
    """Return the smallest and the largest value of each coordinate, shape (2, q): as stated, else the machine's own."""
    if calibrated.workspace is not None:
        return calibrated.workspace
    home, scale = calibrated.model.home_pose, calibrated.model.pose_scale
    return np.stack([home - scale, home + scale])


def _spread(
    calibrated: CalibratedMachine,
    slope: Array,
    respond: Callable[[slice, Array], Array],
    curved: Array | None,
    columns: Array | None,
) -> tuple[Array, Array]:
    """Return how a posterior moves what the mean machine does: its mean (P, M), factors (P, M, R) of its covariance.

    Parameters
    ----------
    slope : ndarray, shape (P, M, D)
        What moves by the parameters.
    respond : callable
        From some of the poses and machines (S, D) to what moves by these as they are, (P, M, S).
    curved : ndarray, shape (S, D), or None
        Draws, where the tangent does not do.
    columns : ndarray, shape (P, M, A), or None
        What moves by coefficients of systematic errors, which in part follow the parameters.
    """
    assert calibrated.covariance is not None
    slope, along, beside = _join_errors(calibrated, slope, columns)
    if curved is None:
        factors = slope @ root_of(calibrated.covariance).T
        return np.zeros(slope.shape[:2]), np.concatenate([factors, beside], axis=-1)
    apart_by = (curved - calibrated.theta)[:, calibrated.free].T
    mean, factors = np.empty(slope.shape[:2]), np.empty((*slope.shape[:2], len(curved)))
    for part in split(len(slope), SPREAD_POSES):
        moved = respond(part, curved) + along[part] @ apart_by
        mean[part] = moved.mean(axis=-1)
        factors[part] = (moved - mean[part, :, None]) / np.sqrt(len(curved) - 1)
    chance = (curved.mean(axis=0) - calibrated.theta)[calibrated.free]  # that these draws have another mean than all
    return mean - np.einsum("pik,k->pi", slope, chance), np.concatenate([factors, beside], axis=-1)


def _join_errors(calibrated: CalibratedMachine, slope: Array, columns: Array | None) -> tuple[Array, Array, Array]:
    """Return slopes by the uncertain parameters, the part of these by systematic errors, and factors of the rest.

    Systematic errors follow the geometry in part: slopes (P, M, n) include that part, which is (P, M, n), too. Their
    deviations from it have the covariance F F^T, by factors F (P, M, A).
    """
    slope, along = slope[..., calibrated.free], np.zeros((1, 1, len(calibrated.free)))
    beside = np.zeros((*slope.shape[:2], 0))
    if columns is not None and calibrated.functions is not None:
        follow, root = calibrated.functions.given_geometry
        along, beside = columns @ follow, columns @ root
        slope = slope + along
    return slope, np.broadcast_to(along, slope.shape), beside


def invert(slopes: Array, good: np.ndarray, scale: Array) -> Array:
    """Return pseudo-inverses of (P, N, m), shape (P, m, N), for a scale or none; NaN where there is nothing to invert.

    The scale (q,) of the coordinates is that of the columns or, of as many rows as there are, of these.
    """
    usable = good & np.isfinite(slopes).all(axis=(1, 2))
    with_scale = slopes * scale
    inverse = np.linalg.pinv(np.where(usable[:, None, None], with_scale, np.eye(*slopes.shape[1:])))
    return np.where(usable[:, None, None], scale[:, None] * inverse, np.nan)


def check_shape(values: Array, names: list[str], what: str) -> None:
    """Raise InputError for values that are not (P, n), P at least one."""
    if values.ndim != 2 or values.shape[1] != len(names):
        raise InputError(f"{what}: found shape {values.shape}, expected (poses, {len(names)}): {', '.join(names)}")
    if not len(values):
        raise InputError(f"{what}: found none, expected at least one")


def check_given(calibrated: CalibratedMachine, given: Given, n: int) -> None:
    """Raise InputError where what the machine has to know is not given at each of n poses."""
    for name in calibrated.model.given:
        if name not in given or np.shape(given[name]) != (n,):
            raise InputError(f"machine {calibrated.name!r}: found no {name} for {n} poses, expected it in given")


def split(n: int, size: int = CHUNK) -> Iterator[slice]:
    """Return slices of at most so many."""
    return (slice(k, k + size) for k in range(0, n, size))


def _pick(given: Given, part: slice | np.ndarray) -> Given:
    return {name: value[part] for name, value in given.items()}
