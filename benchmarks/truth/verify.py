"""How often `bayescal verify` is wrong on machines that err by what no model states.

    python -m benchmarks.truth.verify ROW... --machine hexapod [--size 1] [--twins 10] [--times 10] [--seed 1]
                                       [--keep FOLDER] [--out benchmarks/truth/verify.csv]

Each twin is calibrated by the study that `bayescal init` writes. Reverifications of two sessions follow, at the poses
that `bayescal verify` plans and at those of the calibration: of the machine as it was, and with one leg, carriage or
joint moved by a number of standard deviations to which the plan resolves its shift. Errors are the same function of
the pose as at the calibration; what hangs on time is another. Everything is judged twice more, by reverifications
that take the errors for random ones from pose to pose, as large as they are, and that ignore them. With --keep
calibrations stay in a folder and are taken from there the next time.
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pandas as pd

from bayescal.calibrated.machine import CalibratedMachine
from bayescal.calibrated.verify.plan import (
    ReverificationPlan,
    VerificationGoal,
    expect_pose,
    expect_readings,
    list_candidates,
    place_poses,
    plan_reverification,
)
from bayescal.calibrated.verify.statistics import (
    Reverification,
    TestedParameters,
    build_test,
    choose_suspects,
    judge_reverification,
    look_again,
    predict_knowledge,
)
from bayescal.density.calibration.measurements import Measurements
from bayescal.errors import InputError
from bayescal.experiments.shared.calibrating import load_calibrated
from benchmarks.truth.errors import NONE, SHAPES
from benchmarks.truth.machines import MACHINES, Platform
from benchmarks.truth.projects import compute, write_project, write_tables
from benchmarks.truth.scores import Twin, draw_twin
from benchmarks.truth.simulated import Array, Simulated

SUSPECT = {"delta": "s0", "arm": "o"}
"""Symbols whose entries may have moved; of platforms the legs' lengths."""
SESSIONS, FALSE_ALARM = 2, 0.01
DEMANDS = 0.02 * 2.0 ** np.arange(0.0, 6.0)
"""Shifts in mm at the tool, the smallest of which that a plan can find is asked for."""
RESOLVED = 5.0
"""Standard deviations by which one is moved."""
PLANS = "planned", "calibration"
KEYS = ["machine", "row", "size", "poses"]
SCORES = ("alarm", "odd", "found", "named", "random_alarm", "random_found", "ignored_alarm", "ignored_odd")


@dataclass(frozen=True, eq=False)
class Case:
    """A twin that was calibrated, what may have moved, and how it is read.

    ``expected`` says which channels are read and their noise; ``commands`` (P, N) those of its calibration.
    """

    machine: Simulated
    twin: Twin
    calibrated: CalibratedMachine
    suspects: TestedParameters
    expected: Measurements

    @property
    def commands(self) -> Array:
        """Commands of the calibration."""
        return self.twin.values[~self.twin.held, : self.machine.n_actuators]

    def plan(self) -> ReverificationPlan:
        """Return the plan for the smallest of several shifts that any poses show."""
        candidates, given = list_candidates(self.calibrated, 0.9)
        lever = np.broadcast_to(self.machine.lever, len(self.suspects.names))
        for shift in DEMANDS:
            demand = VerificationGoal(shift / lever, sessions=SESSIONS, false_alarm=FALSE_ALARM)
            try:
                return plan_reverification(self.calibrated, self.suspects, candidates, given, self.expected, demand)
            except InputError as error:
                last = error
        raise last

    def resolve(self, commands: Array) -> Array:
        """Return the standard deviation of each shift by all sessions at commands (P, N), (n,)."""
        knowledge = predict_knowledge(self.calibrated, self.suspects, commands, {}, self.expected)
        information = look_again(knowledge, [knowledge.total()], SESSIONS)
        return 1.0 / np.sqrt(np.diagonal(build_test(information, FALSE_ALARM).information[-1]))

    def measure(self, commands: Array, shift: float, place: int, rng: np.random.Generator) -> list[Measurements]:
        """Return sessions at commands (P, N) of the twin with one of what may have moved shifted."""
        theta = self.twin.theta.copy()
        symbol = SUSPECT.get(self.calibrated.name, "l")
        theta[self.machine.names.index(f"{symbol}[{place + 1}]")] += shift
        return [self._measure(theta, commands, rng) for _ in range(SESSIONS)]

    def _measure(self, theta: Array, commands: Array, rng: np.random.Generator) -> Measurements:
        machine, n = self.machine, self.machine.n_actuators
        noise = machine.add_noise(np.zeros((len(commands), len(machine.noise))), rng)
        error = self.twin.error(machine.solve(theta, commands))
        values = machine.read(theta, machine.solve(theta, commands - error - noise[:, :n])) + noise
        names = tuple(f"R{k + 1}" for k in range(len(commands)))
        if isinstance(machine, Platform):
            covariance = np.broadcast_to(np.diag(machine.noise[n:] ** 2), (len(commands), 6, 6))
            return place_poses(names, commands, values[:, n:], covariance)
        values[:, :n] = commands
        stands = np.isfinite(values).all(axis=1)  # a machine that has moved may not reach a corner
        names, values = tuple(np.array(names)[stands].tolist()), values[stands]
        return Measurements(names, values, np.tile(machine.noise, (len(values), 1)))

    def judge(self, sessions: list[Measurements], by: CalibratedMachine | None = None) -> Reverification:
        """Return what a reverification says of sessions, by the machine as it was calibrated or by less known of it."""
        return judge_reverification(by or self.calibrated, self.suspects, sessions, FALSE_ALARM, SESSIONS)

    @property
    def random(self) -> CalibratedMachine:
        """The machine with errors that are random from pose to pose."""
        return replace(self.calibrated, functions=None)

    @property
    def ignored(self) -> CalibratedMachine:
        """The machine with errors by noise alone."""
        errors = replace(self.calibrated.errors, model_variance=0.0 * self.calibrated.errors.model_variance)
        return replace(self.calibrated, functions=None, errors=errors)


def calibrate(name: str, row: str, size: float, seed: int, folder: Path) -> Case:
    """Return a twin as its default study in a folder leaves it; results that are there are taken."""
    machine, twin = draw_twin(name, row, size, seed)
    results = folder / f"{name}_{row}_{size:g}_{seed}"
    if not results.exists():
        with tempfile.TemporaryDirectory(dir=folder) as there:
            project = Path(there) / "twin"
            write_project(name, machine, "init", project)
            write_tables(machine, twin.values, twin.held, project)
            compute(project, seed, Path(there) / "results")
            (Path(there) / "results").rename(results)
    calibrated = load_calibrated(results, allow_unconverged=True, trust=True)
    suspects = choose_suspects(calibrated, [SUSPECT[name]] if name in SUSPECT else [])
    expected = expect_readings(machine.noise)
    if isinstance(machine, Platform):
        expected = expect_pose(calibrated, np.diag(machine.noise[machine.n_actuators :] ** 2))
    return Case(machine, twin, calibrated, suspects, expected)


def judge_twin(case: Case, times: int, seed: int) -> Iterator[dict[str, object]]:
    """Yield what reverifications of a twin say, each of the machine as it was and of one that has moved."""
    rng = np.random.default_rng([2026, seed])
    for name in PLANS:
        plan = case.plan() if name == "planned" else None
        commands = case.commands if plan is None else plan.commands
        sd = case.resolve(commands)
        for _ in range(times):
            place, sign = int(rng.integers(len(sd))), rng.choice([-1.0, 1.0])
            shift = sign * RESOLVED * sd[place]
            healthy = case.measure(commands, 0.0, place, rng)
            moved = case.measure(commands, shift, place, rng)
            well, found = case.judge(healthy), case.judge(moved)
            ignored = case.judge(healthy, case.ignored)
            yield {
                "poses": name,
                "twin": seed,
                "n_poses": len(commands),
                "resolved_um": 1e3 * float(np.mean(sd * case.machine.lever)),
                "alarm": not well.holds,
                "odd": well.is_odd,
                "found": not found.holds,
                "named": not found.holds and found.worst == place,
                "z": (found.shift[place] - shift) / found.sd[place],
                "random_alarm": not case.judge(healthy, case.random).holds,
                "random_found": not case.judge(moved, case.random).holds,
                "ignored_alarm": not ignored.holds,
                "ignored_odd": ignored.is_odd,
            }


def summarise(table: pd.DataFrame) -> dict[str, float]:
    """Return percentages of reverifications at the same poses, with standard errors from the scatter between twins."""
    by_twin = table.groupby("twin")
    found: dict[str, float] = {
        "twins": len(by_twin),
        "reverifications": len(table),
        "n_poses": round(float(by_twin["n_poses"].first().mean()), 1),
        "resolved_um": round(float(by_twin["resolved_um"].first().mean()), 1),
    }
    for name in SCORES:
        share = 100.0 * by_twin[name].mean()
        found |= {name: round(float(share.mean()), 1), f"{name}_se": round(float(share.sem()), 1)}
    return found | {"z_rms": round(float(np.sqrt(np.mean(table["z"] ** 2))), 2)}


def write(path: Path, keys: tuple[object, ...], found: dict[str, float]) -> None:
    """Write one line into a table, instead of one of the same machine, row, size and poses."""
    line = pd.DataFrame([dict(zip(KEYS, keys, strict=True)) | found])
    old = pd.read_csv(path) if path.exists() else line[:0]
    table = pd.concat([old, line]) if len(old) else line
    order = {name: k for k, name in enumerate((*MACHINES, NONE, *SHAPES, *PLANS))}
    table = table.drop_duplicates(KEYS, keep="last")
    table.sort_values(KEYS, key=lambda one: one.map(lambda x: order.get(x, x))).to_csv(path, index=False)


def main() -> None:
    """Judge rows, print them and write them into a table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("rows", nargs="+", metavar="ROW", choices=(NONE, *SHAPES))
    parser.add_argument("--machine", choices=list(MACHINES), default="hexapod")
    parser.add_argument("--size", type=float, default=1.0)
    parser.add_argument("--twins", type=int, default=10)
    parser.add_argument("--times", type=int, default=10, help="reverifications of each twin and plan")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--keep", type=Path, help="folder in which calibrations stay")
    parser.add_argument("--out", type=Path)
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as scratch:
        for row in arguments.rows:
            size, lines = 0.0 if row == NONE else arguments.size, []
            for k in range(arguments.twins):
                seed = 1000 * arguments.seed + k
                case = calibrate(arguments.machine, row, size, seed, arguments.keep or Path(scratch))
                lines += judge_twin(case, arguments.times, seed)
            for name, table in pd.DataFrame(lines).groupby("poses", sort=False):
                found = summarise(table)
                said = ", ".join(f"{key} {value:g}" for key, value in found.items())
                print(f"{arguments.machine} {row} ×{size:g}, {name}: {said}", flush=True)
                if arguments.out is not None:
                    write(arguments.out, (arguments.machine, row, size, name), found)


if __name__ == "__main__":
    main()
