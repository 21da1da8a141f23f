"""Machines drawn from a posterior in use: where they have their tools, by the same draws with base and tool aligned."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from bayescal.calibrated.machine import CalibratedMachine
from bayescal.calibrated.predict import (
    CHUNK,
    SPREAD_POSES,
    LinearisedCommands,
    check_determined,
    check_given,
    find_errors,
    place_machine,
    respond_at,
    split,
)
from bayescal.errors import InputError
from bayescal.identifiability.alignment import Alignment, find_alignment
from bayescal.machines.readings.base import NO_CONDITIONS, Given
from bayescal.numerics.geometry import Array


def draw_poses(
    calibrated: CalibratedMachine, commands: Array, n_draws: int, rng: np.random.Generator, given: Given = NO_CONDITIONS
) -> Array:
    """Return where draws of the posterior have their tools, each with errors of its own.

    InputError where there are no draws.

    Parameters
    ----------
    calibrated : CalibratedMachine
        With draws.
    commands : ndarray, shape (P, C)
    n_draws : int
        At most so many S.
    rng : Generator
        For the errors of the commands.
    given : mapping of str to ndarray, shape (P,)

    Returns
    -------
    ndarray, shape (S, P, m)
        NaN where a draw's machine has no pose.
    """
    return place_drawn(calibrated, draw_machines(calibrated, n_draws, rng), commands, rng, given)


class DrawnMachines(NamedTuple):
    """Machines of a posterior: parameters (S, D), and what coefficients of systematic errors differ by, (S, A)."""

    theta: Array
    coefficients: Array | None


def draw_machines(calibrated: CalibratedMachine, n_draws: int, rng: np.random.Generator) -> DrawnMachines:
    """Return at most so many machines of the posterior; InputError where there are no draws."""
    if calibrated.draws is None:
        raise InputError(f"experiment {calibrated.source.experiment}: found no posterior draws")
    theta, known = calibrated.thin(n_draws), calibrated.functions
    if known is None:
        return DrawnMachines(theta, None)
    along, left = known.given_geometry
    apart = (theta - calibrated.theta)[:, calibrated.free] @ along.T
    return DrawnMachines(theta, apart + rng.standard_normal((len(theta), left.shape[1])) @ left.T)


def place_drawn(
    calibrated: CalibratedMachine,
    drawn: DrawnMachines,
    commands: Array,
    rng: np.random.Generator,
    given: Given = NO_CONDITIONS,
) -> Array:
    """Return where drawn machines have their tools at commands (P, C), each with other noise, (S, P, m)."""
    model, m, theta = calibrated.model, len(calibrated.model.tool_channels), drawn.theta
    check_determined(calibrated)
    check_given(calibrated, given, len(commands))
    at = place_machine(calibrated, commands, given)
    errors = _draw_errors(calibrated, at, drawn, rng)[..., :m]
    tools = []
    for part in split(len(theta), max(1, CHUNK // len(commands))):
        rows = {name: value[None] for name, value in given.items()}
        pose, _ = model.locate(theta[part, None], commands, rows, np.where(at.found[:, None], at.pose, 0.0)[None])
        with np.errstate(all="ignore"):
            tools.append(calibrated.comparison.add(model.tool_values(theta[part, None], pose), errors[part]))
    return np.concatenate(tools)


def _draw_errors(
    calibrated: CalibratedMachine, at: LinearisedCommands, drawn: DrawnMachines, rng: np.random.Generator
) -> Array:
    """Return what errors of the commands move the outputs by, shape (S, P, M)."""
    errors, n = find_errors(calibrated, at), len(drawn.theta)
    values, vectors = np.linalg.eigh(np.nan_to_num(errors.independent))
    root = at.gain @ vectors * np.sqrt(np.maximum(values, 0.0))[:, None, :]
    shift = np.einsum("pij,pj->pi", at.gain, errors.mean)
    moved = shift + np.einsum("pij,spj->spi", root, rng.standard_normal((n, *at.commands.shape)))
    if errors.columns is None or drawn.coefficients is None:
        return np.asarray(moved)
    return np.asarray(moved + np.einsum("pij,sj->spi", at.gain @ errors.columns, drawn.coefficients))


# --- base and tool aligned -----------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class AlignedMachine:
    """The mean machine at the P poses over which base and tool are aligned, all of them found."""

    calibrated: CalibratedMachine
    at: LinearisedCommands
    alignment: Alignment

    def fit(self, drawn: DrawnMachines) -> Array:
        """Return how much of each motion drawn machines have over the poses, (F, S)."""
        calibrated, m = self.calibrated, len(self.calibrated.model.tool_channels)
        columns = find_errors(calibrated, self.at).columns
        found = np.zeros((len(self.alignment.fits), len(drawn.theta)))
        for part in split(len(self.at.pose), SPREAD_POSES):
            moved = respond_at(calibrated, self.at, part, drawn.theta)[:, :m]
            if columns is not None and drawn.coefficients is not None:
                moved = moved + self.at.gain[part, :m] @ columns[part] @ drawn.coefficients.T
            rows = slice(part.start * m, part.stop * m)
            found += self.alignment.fits[:, rows] @ moved.reshape(-1, moved.shape[-1])
        return found

    def move(self, tool: Array, pose: Array, fitted: Array) -> Array:
        """Return what motions (F, S) do to tools (P, m) at poses (P, q), (S, P, m)."""
        return np.asarray(np.moveaxis(self.alignment.at(tool, pose) @ fitted, -1, 0))


def align_over(calibrated: CalibratedMachine, commands: Array, given: Given = NO_CONDITIONS) -> AlignedMachine | None:
    """Return base and tool aligned over the poses of commands (P, C); None of a machine that places no tool."""
    if not calibrated.model.places_tool:
        return None
    at = place_machine(calibrated, commands, given)
    tool = at.outputs[:, : len(calibrated.model.tool_channels)]
    return AlignedMachine(calibrated, at, find_alignment(calibrated.model, tool, at.pose))
