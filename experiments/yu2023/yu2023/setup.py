"""What the simulated calibrations of an experiment share: machine, workspace, candidates, and how all are drawn."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from bayescal.density.priors import NormalPrior
from bayescal.errors import InputError
from bayescal.experiments.runner.parallel import Run
from bayescal.files.csv_tables import read_by_leg
from bayescal.machines.deformations import NoDeformation
from bayescal.machines.kinematics import Machine, build_machine, check_home_pose
from bayescal.machines.models.six_ups import SixUps
from bayescal.machines.read import load_mechanism
from bayescal.numerics.geometry import Array
from bayescal.pose_selection import (
    CRITERIA,
    Candidates,
    Design,
    SelectionProblem,
    WorkspaceBox,
    even_candidates,
    select,
)
from detmax import TabuDetmax
from yu2023.least_squares import (
    Calibrations,
    PoseErrors,
    Weighting,
    calibrate,
    coordinates_from_pose,
    evaluate,
    move,
    pose_from_coordinates,
)
from yu2023.schema import HexapodCalibrationsConfig, PoseNoiseConfig

ERROR_SYMBOLS = {"dx_A": "b_x", "dy_A": "b_y", "dz_A": "b_z", "dx_B": "a_x", "dy_B": "a_y", "dz_B": "a_z", "dh": "l"}
"""Yu's names of a hardpoint's parameter errors: their points A are the platform's, their points B the base's."""


@dataclass(frozen=True, eq=False)
class CommandedPoses:
    """Poses to measure.

    Attributes
    ----------
    coordinates : ndarray, shape (..., P, 6)
        q, mm and rad.
    actuators : ndarray, shape (..., P, N)
        What the nominal machine needs for them, mm.
    value : float
        The index they were selected by; NaN for random ones.
    """

    coordinates: Array
    actuators: Array
    value: float = np.nan


@dataclass(frozen=True, eq=False)
class Setup:
    """Machine and workspace of an experiment.

    Attributes
    ----------
    config : HexapodCalibrationsConfig
    folder : Path
        Where the config's file names start.
    machine : Machine
    domain : WorkspaceBox
    """

    config: HexapodCalibrationsConfig
    folder: Path
    machine: Machine
    domain: WorkspaceBox

    @cached_property
    def candidates(self) -> Candidates:
        """Evenly distributed poses, the same for all selections."""
        return even_candidates(self.domain, self.config.selection.candidates)

    @cached_property
    def targets(self) -> Array:
        """Verification poses, shape (V, 6): a low-discrepancy sequence over the workspace."""
        placed = even_candidates(self.domain, self.config.verification_poses, levels=None).placed
        return coordinates_from_pose(placed.position, placed.rotation)

    def scale_workspace(self, scale: float) -> Setup:
        """Return the setup with a workspace, and so candidates and verification poses, of another size."""
        return replace(self, domain=replace(self.domain, half=scale * self.domain.half))

    def problem(self, index: str, n: int) -> SelectionProblem:
        """Return the choice of n candidates by an index of J_B in Yu's angles; InputError where these are too few."""
        criterion = CRITERIA[index](form="angles")  # type: ignore[call-arg]  # the config names observability indices
        return SelectionProblem(self.candidates, criterion, n)

    def select(self, index: str, n: int, rng: np.random.Generator) -> CommandedPoses:
        """Return n poses selected by the improved DETMAX."""
        found = select(self.problem(index, n), TabuDetmax(self.config.selection), rng)
        placed = found.placed
        return CommandedPoses(coordinates_from_pose(placed.position, placed.rotation), found.actuators, found.value)

    def draw_random(self, n: int, n_sets: int, rng: np.random.Generator) -> CommandedPoses:
        """Return random sets of n candidates, one for each of the machines."""
        problem = self.problem("O1", n)
        index = np.stack([problem.draw_set(rng) for _ in range(n_sets)])
        placed = self.candidates.placed
        coordinates = coordinates_from_pose(placed.position, placed.rotation)
        return CommandedPoses(coordinates[index], placed.actuators[index])

    def draw_machines(self, n: int, rng: np.random.Generator) -> Array:
        """Return parameters (n, D) with normal errors."""
        nominal = self.machine.layout.nominal
        return nominal + self.config.parameter_error_mm * rng.standard_normal((n, len(nominal)))

    def read_machine(self, table: str) -> Array:
        """Return the parameters (D,) that a table of errors, one row a hardpoint, makes of the nominal ones."""
        path, layout = self.folder / table, self.machine.layout
        values = read_by_leg(path, tuple(ERROR_SYMBOLS), self.machine.mechanism.n_legs)
        theta = layout.nominal.copy()
        for k, symbol in enumerate(ERROR_SYMBOLS.values()):
            theta[layout.index[symbol]] += values[:, k]
        return theta

    def reach_poses(self, truth: Array, poses: CommandedPoses) -> Array:
        """Return where machines (B, D) stand, shape (B, P, 6), when the poses are commanded.

        Raises
        ------
        InputError
            Where a machine does not reach a pose.
        """
        start = np.broadcast_to(poses.coordinates, (len(truth), *poses.coordinates.shape[-2:]))
        position, rotation, found = move(self.machine, truth, poses.actuators, *pose_from_coordinates(start))
        if not found.all():
            raise InputError(
                f"workspace: found machine {int(np.argmin(found)) + 1} of {len(found)} unable to take a pose, "
                "expected smaller parameter errors or a smaller workspace"
            )
        return coordinates_from_pose(position, rotation)

    def calibrate(self, poses: CommandedPoses, measured: Array, weighting: Weighting) -> Calibrations:
        """Return the machines (B) that measured poses (B, P, 6) tell of."""
        return calibrate(self.machine, poses.actuators, measured, weighting)

    def evaluate(self, truth: Array, found: Array) -> PoseErrors:
        """Return the errors of calibrated machines at the verification poses."""
        return evaluate(self.machine, truth, found, self.targets)


def read_setup(config: HexapodCalibrationsConfig, folder: Path) -> Setup:
    """Return the setup of an experiment; InputError where the machine is no hexapod of struts with a home pose."""
    mechanism = load_mechanism(folder / config.mechanism)
    if mechanism.n_legs != 6:
        raise InputError(f"{folder / config.mechanism}: found {mechanism.n_legs} legs, expected 6")
    machine = build_machine(SixUps, mechanism, NoDeformation())
    check_home_pose(machine)
    half = np.concatenate([config.workspace.position_mm, np.radians(config.workspace.rotation_deg)])
    nominal = zip(machine.layout.names, machine.layout.nominal.tolist(), strict=True)
    design = Design(machine, {name: NormalPrior(value, config.parameter_error_mm) for name, value in nominal})
    return Setup(config, folder, machine, WorkspaceBox(design, half))


def noise_scale(noise: PoseNoiseConfig) -> Array:
    """Return the standard deviations of a measured pose's coordinates, shape (6,), mm and rad."""
    return np.repeat([noise.position_mm, np.radians(noise.attitude_deg)], 3)


def select_all(
    setup: Setup, choices: Sequence[tuple[str, int]], seeds: Sequence[np.random.SeedSequence], run: Run, what: str
) -> list[CommandedPoses]:
    """Return the poses of choices (index, n), each with its own seed; ``what`` names the stage."""
    for index, n in dict.fromkeys(choices):
        setup.problem(index, n)
    pairs = zip(choices, seeds, strict=True)
    tasks = {f"{k} {index} {n}": (index, n, seed) for k, ((index, n), seed) in enumerate(pairs)}
    return list(run.map(what, _select, setup, tasks, (CommandedPoses,)).values())


def _select(setup: Setup, task: tuple[str, int, np.random.SeedSequence]) -> CommandedPoses:
    index, n, seed = task
    return setup.select(index, n, np.random.default_rng(seed))
