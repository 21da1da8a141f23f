"""The selections of an experiment, side by side in processes; what comes out does not depend on how many."""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np

from bayescal.config.classes import label_class
from bayescal.experiments.frame.parallel import Run
from bayescal.experiments.selection.accuracy import Accuracy, judge_poses
from bayescal.experiments.selection.inputs import SelectionInputs, is_histogram
from bayescal.experiments.selection.schema import label_of
from bayescal.numerics.geometry import Array
from bayescal.pose_selection import Selection, SelectionProblem, select

SETS, MACHINES = 2, 3  # streams of random numbers
DESIGN = "given"


@dataclass(frozen=True)
class Task:
    """One selection to make; ``criterion`` is `DESIGN` for a set of poses that somebody else has chosen.

    ``choice`` counts the config's selections, None for such a set; ``is_histogram`` says whether it judges many random
    sets to see how they spread.
    """

    label: str
    criterion: str
    n_poses: int
    repeat: int
    choice: int | None
    is_histogram: bool = False


@dataclass(frozen=True, eq=False)
class JudgedPoses:
    """A set of poses and what it is worth.

    Attributes
    ----------
    task : Task
    selection : Selection or None
        None for a set that somebody else has chosen.
    actuators : ndarray, shape (n, N)
        mm.
    moves : ndarray, shape (n, 6)
        Displacements from home, mm and rad.
    indices : dict of name to float
        O1 to O5.
    accuracy : Accuracy or None
    seconds : float
        That the selection took.
    """

    task: Task
    selection: Selection | None
    actuators: Array
    moves: Array
    indices: dict[str, float]
    accuracy: Accuracy | None
    seconds: float


def list_tasks(inputs: SelectionInputs) -> list[Task]:
    """Return the selections of an experiment in the order of its config, then the designs of others.

    A design is repeated as often as a selection where calibrations are simulated, each time with other machines.
    """
    tasks = [
        Task(label_of(choice), criterion, n, repeat, place, is_histogram(choice))
        for place, choice in enumerate(inputs.config.selections)
        for criterion in map(label_class, choice.criteria)
        for n in choice.n_poses
        for repeat in range(choice.repeats)
    ]
    often = 1 if inputs.config.calibrations is None else max(choice.repeats for choice in inputs.config.selections)
    designs = [(name, len(poses), repeat) for name, poses in inputs.designs.items() for repeat in range(often)]
    return tasks + [Task(name, DESIGN, n, repeat, None) for name, n, repeat in designs]


def check_problems(inputs: SelectionInputs) -> None:
    """Raise InputError where poses are too few or too many for the first repeat's candidates, or one is singular."""
    candidates = inputs.candidates(0)
    for choice in inputs.config.selections:
        inputs.method(choice)
        for criterion in map(label_class, choice.criteria):
            for n in {min(choice.n_poses), max(choice.n_poses)}:
                SelectionProblem(candidates, inputs.criterion(criterion), n, inputs.measured)


def run_tasks(inputs: SelectionInputs, run: Run) -> list[JudgedPoses]:
    """Return the outcomes of all tasks, in their order."""
    check_problems(inputs)  # faults of the config show here, once, and not in the middle of a worker
    tasks = {f"{k} {task.label} {task.criterion} {task.n_poses}": task for k, task in enumerate(list_tasks(inputs))}
    longest = dict(sorted(tasks.items(), key=lambda pair: -pair[1].n_poses))
    found = run.map("selections", run_one, inputs, longest, (JudgedPoses,))
    return [found[name] for name in tasks]


def run_one(inputs: SelectionInputs, task: Task) -> JudgedPoses:
    """Return the outcome of a task: sets of the same repeat start alike, machines of the same repeat are the same."""
    began = time.perf_counter()
    selection = None
    if task.choice is None:
        actuators = inputs.designs[task.label]
        moves = inputs.domain.at_actuators(actuators).moves
    else:
        problem = SelectionProblem(
            inputs.candidates(task.repeat), inputs.criterion(task.criterion), task.n_poses, inputs.measured
        )
        rng = np.random.default_rng([inputs.config.seed, SETS, task.n_poses, task.repeat])
        selection = select(problem, inputs.method(inputs.config.selections[task.choice]), rng)
        actuators, moves = selection.actuators, selection.placed.moves
    seconds = time.perf_counter() - began
    whole = actuators if inputs.measured is None else np.concatenate([inputs.measured, actuators])
    accuracy = None
    if (wanted := inputs.config.calibrations) is not None:
        rng = np.random.default_rng([inputs.config.seed, MACHINES, task.repeat])
        accuracy = judge_poses(
            inputs.design, inputs.workspace, inputs.limits, whole, wanted.machines, rng, wanted.known
        )
    return JudgedPoses(task, selection, actuators, moves, inputs.indices(whole), accuracy, seconds)
