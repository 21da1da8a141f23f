"""From the config to what is computed with: the study's variants, the workspace and the poses that may be measured."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from bayescal.data.actuators import read_moves
from bayescal.density.pose_likelihood import PoseLikelihood
from bayescal.errors import InputError
from bayescal.experiments.frame.load import load
from bayescal.experiments.frame.memory import check_arrays
from bayescal.experiments.next_pose.schema import NextConfig
from bayescal.experiments.shared.design import find_actuators, read_requirements, read_workspace
from bayescal.experiments.shared.measured import MeasuredVariant, Measuring
from bayescal.identifiability.design import Knowledge
from bayescal.identifiability.pose_volume import PoseVolume
from bayescal.identifiability.requirements import Requirement
from bayescal.identifiability.units import Units
from bayescal.numerics.geometry import DEGREES_OF_FREEDOM, Array
from bayescal.pose_selection import (
    ActuatorBox,
    Candidates,
    WorkspaceBox,
    candidates_at,
    candidates_at_actuators,
    factorial_candidates,
)

CANDIDATES = 31  # of the seeds
SEEN = 6
"""Arrays of all candidates by legs and parameters where they are placed and seen."""


@dataclass(frozen=True, eq=False)
class NextInputs:
    """What was measured so far, and what may come.

    Attributes
    ----------
    config : NextConfig
    origin : str
        Of the data, in words.
    variants : dict of str to MeasuredVariant
        Those that may be right, with the poses measured so far.
    requirements : list of Requirement
    workspace : ndarray, shape (W, N)
        Actuator positions of its poses, mm.
    candidates : ndarray, shape (C, N)
        Actuator positions of the poses that may be measured, mm.
    units : Units
    """

    config: NextConfig
    origin: str
    variants: dict[str, MeasuredVariant]
    requirements: list[Requirement]
    workspace: Array
    candidates: Array
    units: Units

    @property
    def home(self) -> Array:
        """Actuator positions at home, shape (N,), mm."""
        return next(iter(self.variants.values())).machine.mechanism.initial_actuator_positions


def read_next(config: NextConfig, folder: Path) -> NextInputs:
    """Return what was measured so far, read and checked.

    Raises
    ------
    InputError
        Where the file is no study's, a variant is not there, the workspace is out of reach or no candidate is left.
    """
    path = folder / config.study
    experiment, study = load(path)
    if not isinstance(experiment, Measuring):
        raise InputError(f"{path}: kind: found {study.kind!r}, expected 'study', whose poses were measured so far")
    known = experiment.list_variants(study)
    for name in config.variants:
        if name not in known:
            raise InputError(f"{path}: variant {name!r}: unknown here, expected one of {', '.join(known)}")
    chosen = {name: known[name] for name in config.variants or known}
    if config.aim == "variants" and len(chosen) < 2:
        raise InputError(f"{path}: found one variant with aim 'variants', expected two or more to be told apart")
    found = {name: experiment.measure(study, path, one, config.with_model_error) for name, one in chosen.items()}
    measured = {name: _take_first(one, config.first, path) for name, one in found.items()}
    first = next(iter(measured.values()))
    knowledge, volume = know(first, {}), read_workspace(config.workspace)
    candidates = read_candidates(config, folder, knowledge, volume).placed.actuators
    workspace = find_actuators(knowledge, volume, config.seed, candidates)
    units = Units(config.units.length, config.units.angle)
    requirements = read_requirements(config.requirements, units)
    origin = first.origin.partition(": study ")[0]
    return NextInputs(config, origin, measured, requirements, workspace, candidates, units)


def know(measured: MeasuredVariant, centre: dict[str, float]) -> Knowledge:
    """Return a measured machine with its tolerances, where its parameters are expected at values of their own."""
    posterior = measured.posterior
    names = posterior.names[: posterior.n_geometry]
    means = {name: measured.priors[name].mean for name in names}
    return Knowledge(
        measured.machine, {name: measured.priors[name].sd for name in names}, {**measured.fixed, **means, **centre}
    )


def take_poses(measured: MeasuredVariant, n: int) -> MeasuredVariant:
    """Return the variant after the first n of its poses."""
    some, variance = measured.poses.select(np.arange(n)), measured.actuator_variance
    variance = None if variance is None else variance[:n]
    likelihood = PoseLikelihood(measured.machine, some, measured.actuator_noise, variance)
    posterior = replace(measured.posterior, likelihood=likelihood)
    return replace(measured, poses=some, posterior=posterior, actuator_variance=variance)


def _take_first(measured: MeasuredVariant, n: int | None, path: Path) -> MeasuredVariant:
    there = measured.poses.n_poses
    if n is not None and n > there:
        raise InputError(f"first: found {n}, expected at most {there}, the calibration poses of {path}")
    return measured if n is None else take_poses(measured, n)


# --- candidates --------------------------------------------------------------------------------------------------


def estimate_candidates(n: int, n_legs: int, n_parameters: int, n_variants: int) -> list[tuple[float, ...]]:
    """Return the arrays of candidates; see `estimate_arrays`."""
    return [(SEEN, n, n_legs, n_parameters + n_legs), (4 * n_variants, n, DEGREES_OF_FREEDOM, n_parameters)]


def _check_candidates(n: int, knowledge: Knowledge) -> None:
    """Raise InputError where there is no memory to place so many candidates."""
    machine = knowledge.machine
    held = estimate_candidates(n, machine.mechanism.n_legs, machine.layout.size, 1)
    check_arrays({"candidates": n}, held, "fewer candidates")


def read_candidates(config: NextConfig, folder: Path, knowledge: Knowledge, volume: PoseVolume | None) -> Candidates:
    """Return the poses that may be measured."""
    section, mechanism = config.candidates, knowledge.machine.mechanism
    rng = np.random.default_rng([config.seed, CANDIDATES])
    if section.configurations is None:
        _check_candidates(section.count, knowledge)
    redundant, half = mechanism.n_legs != DEGREES_OF_FREEDOM, section.half
    if redundant and half is None:
        half = None if volume is None else volume.half
        if half is None or section.configurations is not None or section.range_mm is not None:
            raise InputError(
                f"candidates: found {mechanism.n_legs} legs, which do not close anywhere, expected position_mm and "
                "rotation_deg there, or [workspace] and neither configurations nor range_mm"
            )
    if half is not None:
        return factorial_candidates(WorkspaceBox(knowledge, half), section.count, rng)
    domain = ActuatorBox(knowledge)
    if section.configurations is not None:
        moves = read_moves(folder / section.configurations, section.unit_mm, mechanism.n_legs)
        _check_candidates(len(moves), knowledge)
        return candidates_at_actuators(domain, mechanism.initial_actuator_positions + moves)
    reach = mechanism.actuator_range if section.range_mm is None else section.range_mm
    if reach > mechanism.actuator_range:
        raise InputError(
            f"candidates.range_mm: found {reach:g}, expected at most the actuator range of "
            f"{mechanism.actuator_range:g} mm"
        )
    whole = factorial_candidates(domain, section.count, rng)
    return candidates_at(domain, whole.shares * reach / mechanism.actuator_range)
