"""Twins of the M2 hexapod calibrated pose by pose, beside the plan of 40 poses: how many are enough, is the stop true.

    python benchmarks/next_pose.py --first 0 --twins 25 --poses 24 --out a.npz [--model-error] [--range 10.5]
    python benchmarks/next_pose.py --summarise a*.npz [--name next_pose]

Each twin is a machine drawn from the tolerances of experiments/m2_hexapod/study.toml, with --model-error its model
errors too, drawn from the study's prior; otherwise there are none and the posterior knows. It is measured at the plan's
40 poses, and by itself at poses that are chosen one by one after what was measured before, out of 729 within the limits
of the hexapod's pose, or with --range out of a grid of displacements. Poses are those of forward kinematics, with the
noise that the shipped survey's poses have on average. After every pose the posterior is updated from the last mode, and
its mean machine is set against the true one over 200 poses of the workspace by forward kinematics of both. Required is
what 40 planned poses achieve with 95 %: the audit's limits times one factor, found for the expected machine. One stops
as soon as the requirements hold with 95 %; the stop was true where the true machine, with actuators' noise and model
errors drawn again, keeps the limits at every pose.
"""

from __future__ import annotations

import argparse
import json
import time
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from bayescal.data.actuators import read_moves
from bayescal.data.measured_poses import MeasuredPoses
from bayescal.density.calibration.terms import NO_ERRORS
from bayescal.experiments.next_pose.compute import State, find_state
from bayescal.experiments.next_pose.inputs import MeasuredVariant, read_next_pose
from bayescal.experiments.runner.load import load
from bayescal.experiments.shared.measured import MeasuredReadings
from bayescal.experiments.shared.pose_readings import build_pose_readings
from bayescal.identifiability.requirements import Requirement
from bayescal.machines.kinematics import ForwardKinematics, Machine, solve_forward_kinematics
from bayescal.machines.readings import Legs
from bayescal.numerics.geometry import Array, compute_pose_error, matrix_from_rotation_vector
from bayescal.pose_selection.next_pose import find_unmeasured, look_ahead

FOLDER = Path(__file__).parents[1] / "experiments" / "m2_hexapod"
STATED, DRAWS, SEED = 0.95, 1000, 5
RESULTS = Path(__file__).parent / "results"


@dataclass(frozen=True, eq=False)
class Problem:
    """What all twins share.

    Attributes
    ----------
    subject : Subject
        The shipped survey seen through the rigid variant.
    plan : ndarray, shape (40, 6)
        Actuator positions of the plan, mm.
    noise : ndarray, shape (6, 6)
        Covariance of a measured pose, mm and rad.
    """

    subject: MeasuredVariant
    plan: Array
    noise: Array

    @property
    def requirements(self) -> list[Requirement]:
        """What is required."""
        return self.subject.requirements

    @property
    def measured(self) -> MeasuredReadings:
        """The variant's readings."""
        return self.subject.measured

    @property
    def model(self) -> Legs:
        """The hexapod with its encoders, and its pose as it was seen."""
        model = self.measured.posterior.likelihood.model
        assert isinstance(model, Legs)
        return model

    @property
    def machine(self) -> Machine:
        """The hexapod."""
        return self.model.machine

    @property
    def actuator_noise(self) -> float:
        """Of all actuators, mm."""
        return float(self.measured.posterior.likelihood.data.sd[0, 0])

    @property
    def scale(self) -> float:
        """Of the prior of model errors, mm; zero without any."""
        return max((one.scale for one in self.measured.posterior.errors.terms), default=0.0)


def build_problem(model_error: bool, reach: float | None) -> Problem:
    """Return what all twins share; requirements are the audit's."""
    config = load(FOLDER / "next_pose.toml")[1].model_copy(update={"n_first_poses": None})
    if reach is not None:
        config = config.model_copy(
            update={"candidates": type(config.candidates)(range_mm=reach, count=config.candidates.count)}
        )
    subject = next(iter(read_next_pose(config, FOLDER).subjects.values()))
    if not model_error:
        posterior = replace(subject.measured.posterior, errors=NO_ERRORS)
        subject = replace(subject, measured=replace(subject.measured, posterior=posterior))
    data = subject.measured.posterior.likelihood.data
    correlation = np.eye(12)[None] if data.correlation is None else data.correlation
    covariance = (data.sd[:, :, None] * correlation * data.sd[:, None])[:, 6:, 6:].mean(axis=0)
    problem = Problem(subject, np.empty((0, 6)), covariance)
    home = problem.machine.mechanism.initial_actuator_positions
    return replace(problem, plan=home + read_moves(FOLDER / "calibration_configurations.csv", 1.0, len(home)))


@dataclass(frozen=True, eq=False)
class Twin:
    """A true machine (D,) with its model errors (6,), mm, and where it stands in the workspace."""

    problem: Problem
    theta: Array
    tau: Array
    rng: np.random.Generator

    def measure(self, actuators: Array) -> MeasuredPoses:
        """Return what is measured at actuator positions (P, 6)."""
        machine, noise = self.problem.machine, self.problem.noise
        found = solve_forward_kinematics(machine, self.theta, actuators)
        own = self.problem.actuator_noise * self.rng.standard_normal(actuators.shape)
        read = actuators - own - self.tau * self.rng.standard_normal(actuators.shape)
        error = self.rng.standard_normal(actuators.shape) @ np.linalg.cholesky(noise).T
        names = tuple(str(k) for k in range(len(actuators)))
        rotation = matrix_from_rotation_vector(error[:, 3:]) @ found.rotation
        covariance = np.broadcast_to(noise, (len(actuators), 6, 6))
        return MeasuredPoses(names, found.position + error[:, :3], rotation, covariance, read)

    def find_errors(self, calibrated: Array) -> Array:
        """Return the true error of a calibrated machine, by geometry alone, over the workspace, shape (W, 6)."""
        true, there = self.true_poses, self.problem.subject.workspace.values
        found = solve_forward_kinematics(self.problem.machine, calibrated, there, follow=False)
        return compute_pose_error(true.position, true.rotation, found.position, found.rotation)

    @cached_property
    def true_poses(self) -> ForwardKinematics:
        """Where the true machine stands."""
        machine, there = self.problem.machine, self.problem.subject.workspace.values
        return solve_forward_kinematics(machine, self.theta, there)

    def draw_rest(self) -> Array:
        """Return what actuators and model err by at the workspace, shape (W, 6)."""
        machine, there = self.problem.machine, self.problem.subject.workspace.values
        here = machine.linearise(self.theta, self.true_poses.position, self.true_poses.rotation, there)
        error = self.problem.actuator_noise * self.rng.standard_normal(there.shape)
        error += self.tau * self.rng.standard_normal(there.shape)
        return np.einsum("wij,wjk,wk->wi", np.linalg.inv(here.pose), here.actuators, error)


def join(one: MeasuredPoses | None, other: MeasuredPoses) -> MeasuredPoses:
    """Return two measurements as one."""
    if one is None:
        return other
    parts = (
        np.concatenate([getattr(poses, field) for poses in (one, other)])
        for field in ("position", "rotation", "covariance", "actuators")
    )
    return MeasuredPoses((*one.names, *other.names), *parts)


def find(problem: Problem, poses: MeasuredPoses, start: Array | None) -> State:
    """Return what is known after poses, updated from a mode."""
    old = problem.measured.posterior
    found = build_pose_readings(
        problem.model, poses, problem.actuator_noise, old.priors, old.errors, old.fixed
    ).posterior
    likelihood = replace(found.likelihood, straight=True)
    measured = replace(problem.measured, posterior=replace(found, likelihood=likelihood))
    return find_state(replace(problem.subject, measured=measured), start, DRAWS, SEED)


def tighten(problem: Problem) -> Problem:
    """Return the problem with requirements that the plan meets with the stated probability."""
    centre = problem.measured.posterior.sampling.start
    tau = np.full(6, 0.5 * problem.scale)
    state = find(problem, Twin(problem, centre, tau, np.random.default_rng(1)).measure(problem.plan), None)
    factor = float(np.quantile(state.standing.largest.max(axis=1), STATED))
    limits = [Requirement(one.name, one.limit * factor) for one in problem.requirements]
    return replace(problem, subject=replace(problem.subject, requirements=limits))


def draw_twin(problem: Problem, number: int) -> Twin:
    """Return a machine drawn from the tolerances."""
    rng, posterior = np.random.default_rng([SEED, number]), problem.measured.posterior
    theta, free = posterior.sampling.start.copy(), posterior.sampling.free
    theta[free] += [one.sd for one in posterior.sampling.priors] * rng.standard_normal(len(free))
    tau = np.abs(rng.normal(0.0, problem.scale, 6))
    return Twin(problem, theta, tau, rng)


def judge(problem: Problem, twin: Twin, state: State, rest: Array) -> list[float]:
    """Return the probability stated, the true rms and largest error by geometry, and the largest one with the rest.

    Errors are in shares of the limits.
    """
    errors = twin.find_errors(state.calibrated)
    shares = [one.take(errors) / one.limit for one in problem.requirements]
    whole = [one.take(errors + rest).max() / one.limit for one in problem.requirements]
    rms = float(np.sqrt(np.mean(np.square(shares))))
    return [state.standing.probability, rms, float(np.max(shares)), float(np.max(whole))]


def calibrate(problem: Problem, first: State, rows: Array, number: int, most: int) -> tuple[Array, Array, list[float]]:
    """Return how a twin stands after the plan (4,), after each of the chosen poses (most, 4), and seconds of steps."""
    twin = draw_twin(problem, number)
    planned = find(problem, twin.measure(problem.plan), None)
    rest = twin.draw_rest()
    by_plan = judge(problem, twin, planned, rest)
    chosen, seconds, poses, state = [], [], None, None
    covariance = np.eye(rows.shape[-1])
    for _ in range(most):
        began = time.perf_counter()
        measured = np.empty((0, 6)) if poses is None else poses.actuators
        allowed = find_unmeasured(problem.subject.candidates.values, measured, 0.28)
        step = next(look_ahead(first.weight, covariance, rows, allowed))
        seconds.append(time.perf_counter() - began)
        poses = join(poses, twin.measure(problem.subject.candidates.values[[step.candidate]]))
        began = time.perf_counter()
        state = find(problem, poses, None if state is None else state.belief.y)
        covariance = state.covariance
        _ = state.standing.probability
        seconds[-1] += time.perf_counter() - began
        chosen.append(judge(problem, twin, state, rest))
    return np.array(by_plan), np.array(chosen), seconds


def run(args: argparse.Namespace) -> None:
    """Calibrate some twins and keep how they stand."""
    problem = tighten(build_problem(args.model_error, args.range))
    print("limits:", ", ".join(f"{one.name} {one.limit:.4g}" for one in problem.requirements))
    nominal = draw_twin(problem, 10**6)
    first = find(problem, replace(nominal, tau=np.zeros(6)).measure(problem.subject.candidates.values[:1]), None)
    rows = first.rows
    plans, courses, times = [], [], []
    with np.errstate(all="ignore"):
        for number in range(args.first, args.first + args.twins):
            plan, course, seconds = calibrate(problem, first, rows, number, args.poses)
            plans.append(plan)
            courses.append(course)
            times.append(seconds)
            stop = int(np.argmax(course[:, 0] >= STATED)) + 1
            print(f"twin {number}: stop after {stop}, {sum(seconds):.1f} s", flush=True)
            np.savez(args.out, plan=np.array(plans), course=np.array(courses), seconds=np.array(times))


def summarise(args: argparse.Namespace) -> None:
    """Print and write what all twins say."""
    loaded = [np.load(path) for path in args.summarise]
    n_poses = min(one["course"].shape[1] for one in loaded)
    plan = np.concatenate([one["plan"] for one in loaded])
    course, seconds = (np.concatenate([one[key][:, :n_poses] for one in loaded]) for key in ("course", "seconds"))
    stopped = (course[:, :, 0] >= STATED).any(axis=1)
    at = np.argmax(course[:, :, 0] >= STATED, axis=1)
    true = course[np.arange(len(course)), at, 3] <= 1.0
    share, n = float(true[stopped].mean()), int(stopped.sum())
    rms, of_plan = np.sqrt(np.mean(course[:, :, 1] ** 2, axis=0)), float(np.sqrt(np.mean(plan[:, 1] ** 2)))
    large, large_of_plan = np.quantile(course[:, :, 2], 0.95, axis=0), float(np.quantile(plan[:, 2], 0.95))
    summary = {
        "twins": len(course),
        "rms_of_plan": of_plan,
        "poses_for_rms_of_plan": int(np.argmax(rms <= of_plan)) + 1,
        "largest_of_plan_95": large_of_plan,
        "poses_for_largest_of_plan_95": int(np.argmax(large <= large_of_plan)) + 1,
        "stopped": n,
        "poses_at_stop": {
            "median": float(np.median(at[stopped] + 1)),
            "least": int(at[stopped].min() + 1),
            "most": int(at[stopped].max() + 1),
        },
        "mean_stated_at_stop": float(course[np.arange(len(course)), at, 0][stopped].mean()),
        "stop_true": share,
        "stop_true_se": float(np.sqrt(share * (1.0 - share) / n)),
        "plan_true": float(np.mean(plan[:, 3] <= 1.0)),
        "plan_stated": float(np.mean(plan[:, 0])),
        "seconds_a_step_median": float(np.median(seconds)),
        "seconds_a_step_largest": float(np.max(seconds)),
        "rms_by_poses": np.round(rms, 4).tolist(),
    }
    text = json.dumps(summary, indent=1)
    print(text)
    if args.name:
        (RESULTS / f"{args.name}.json").write_text(text + "\n")


def main() -> None:
    """Run twins, or summarise them."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--twins", type=int, default=100)
    parser.add_argument("--poses", type=int, default=40)
    parser.add_argument("--out", type=Path, default=Path("next_pose.npz"))
    parser.add_argument("--model-error", action="store_true")
    parser.add_argument("--range", type=float)
    parser.add_argument("--summarise", type=Path, nargs="+")
    parser.add_argument("--name", default="")
    args = parser.parse_args()
    (summarise if args.summarise else run)(args)


if __name__ == "__main__":
    main()
