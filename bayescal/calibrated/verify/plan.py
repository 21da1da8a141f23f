"""The fewest poses that show whether a calibration still holds, chosen one by one and then exchanged; their tables."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import product
from pathlib import Path

import numpy as np
from scipy.special import ndtr, ndtri

from bayescal.calibrated.machine import CalibratedMachine
from bayescal.calibrated.predict import bound_workspace
from bayescal.calibrated.tables import name_column, read_commands, show_values
from bayescal.calibrated.verify.statistics import (
    PoseInformation,
    Reverification,
    ShiftTest,
    TestedParameters,
    build_test,
    keep_seen,
    look_again,
    predict_knowledge,
    say_shift,
    say_size,
)
from bayescal.data.instruments.read_poses import (
    DEVIATIONS,
    UNITS,
    PoseNoise,
    check_positive,
    name_covariances,
    read_noise,
)
from bayescal.density.calibration.measurements import Measurements
from bayescal.errors import InputError
from bayescal.files.csv_tables import format_table, read_table
from bayescal.machines.kinematics import solve_forward_kinematics, solve_inverse_kinematics
from bayescal.machines.readings import POSE, Given, Legs, Tracker
from bayescal.machines.readings.newton import share_contacts, touch
from bayescal.machines.readings.placed import READ_BY
from bayescal.numerics.geometry import DEGREES_OF_FREEDOM, Array, matrix_from_rotation_vector
from bayescal.numerics.units import ARCSECOND, MICROMETRE

LEVELS = (-1.0, 0.0, 1.0)
RANDOM = 729
"""Candidates of machines whose actuators cannot be combined at will."""
EXCHANGES = 3
HOPEFUL = 0.03  # below the power asked for, from which on a plan is simulated
PERCENT = 100.0


@dataclass(frozen=True, eq=False)
class VerificationGoal:
    """What a reverification has to do."""

    shift: Array  # (N,): of each parameter that may have shifted, in its unit
    power: float = 0.95  # with which it has to be found, whichever parameter it is
    false_alarm: float = 0.01  # of all sessions together
    sessions: int = 2  # within which it has to be found; each measures the same poses
    most: int = 40  # poses that a session may have
    in_sd: float | None = None  # the shift in standard deviations of each parameter, where it was stated so


@dataclass(frozen=True, eq=False)
class ReverificationPlan:
    """Poses of one session of a reverification."""

    suspects: TestedParameters  # N parameters, one of which may shift
    chosen: np.ndarray  # (P,): which of the candidates, the one that shows most first
    commands: Array  # (P, C): in the channels' units
    given: Given  # (P,)
    test: ShiftTest  # of all sessions
    power: Array  # (N,): with which the shift of each parameter is found
    demand: VerificationGoal

    @cached_property
    def power_by_session(self) -> Array:
        """With which probability the shift that is found worst is found by each session, shape (J,)."""
        looks = [replace(self.test, information=self.test.information[: k + 1]) for k in range(self.demand.sessions)]
        return np.array([one.find_power().min() for one in looks])


def list_candidates(calibrated: CalibratedMachine, share: float) -> tuple[Array, Given]:
    """Return commands (C, n) over a share of the range, and what is given: corners, middles of edges and faces, home.

    Of a machine on six legs those of its actuators. Redundant legs cannot be combined at will: theirs hold random poses
    about home. Any other machine's hold such poses of its workspace, and random ones where these are few; one without
    coordinates has the rows that calibrated it.
    """
    legs = calibrated.model.legs
    if legs is None:
        return _cover_workspace(calibrated, share)
    mechanism = legs.machine.mechanism
    reach = share * mechanism.actuator_range
    if mechanism.n_legs == DEGREES_OF_FREEDOM:
        moves = reach * np.array(list(product(LEVELS, repeat=mechanism.n_legs)))
        return _keep_reached(legs, calibrated.theta, mechanism.initial_actuator_positions + moves), {}
    return _place_near_home(legs, calibrated.theta, reach), {}


def _cover_workspace(calibrated: CalibratedMachine, share: float) -> tuple[Array, Given]:
    model, (low, high) = calibrated.model, bound_workspace(calibrated)
    middle, half = 0.5 * (low + high), 0.5 * share * (high - low)
    q, rng = len(low), np.random.default_rng(0)
    n = len(LEVELS) ** q
    moves = np.array(list(product(LEVELS, repeat=q))).reshape(n, q) if n <= RANDOM else np.zeros((1, q))
    moves = np.concatenate([moves, rng.uniform(-1.0, 1.0, (RANDOM - len(moves), q))])
    given = calibrated.typical(len(moves))
    if given and not q:  # nothing moves but by what is given: that of the rows that calibrated it
        given = {name: calibrated.given[name] for name in given}
        moves = np.zeros((len(next(iter(given.values()))), 0))
    commands = model.read(calibrated.theta, middle + half * moves, given)[:, calibrated.commanded]
    with np.errstate(invalid="ignore"):
        within = ((commands >= model.command_range[:, 0]) & (commands <= model.command_range[:, 1])).all(axis=1)
    _, found = model.locate(calibrated.theta, np.nan_to_num(commands), given, weights=calibrated.weights)
    if not (within & found).any():
        raise InputError(f"machine {calibrated.name!r}: found no workspace pose in reach, expected some")
    return commands[within & found], {name: value[within & found] for name, value in given.items()}


def lead_to_contacts(
    calibrated: CalibratedMachine, commands: Array, given: Given, planned: Measurements
) -> tuple[Array, Given, Measurements, tuple[str, ...]]:
    """Return candidates led to where instruments touch, a row of what is read at each, and the one that touches there.

    ``planned`` is a row that says which channels are read; where none of an instrument that touches, all stays as it
    is. Instruments take turns, and poses keep to the workspace. InputError where none of them touches.
    """
    model, theta, (low, high) = calibrated.model, calibrated.theta, bound_workspace(calibrated)
    asked = {name: bool(planned.present[0, model.instrument_places[name]].all()) for name in model.contacts}
    if not any(asked.values()):
        return commands, given, planned, ()
    start, _ = model.locate(theta, commands, given, weights=calibrated.weights)
    read = share_contacts(model, len(start))
    with np.errstate(all="ignore"):
        pose, found = touch(model, theta, start, read, np.zeros(read.shape), given)
        values = model.read(theta, pose, given)
        found &= ((pose >= low) & (pose <= high)).all(axis=1) & ~model.find_beyond(values).any(axis=1)
    names = [model.contacts[k % len(model.contacts)] for k in range(len(start))]
    found &= np.isfinite(values[:, calibrated.commanded]).all(axis=1) & [asked[name] for name in names]
    some = np.flatnonzero(found)
    if not len(some):
        raise InputError(f"machine {calibrated.name!r}: found no pose that touches {' or '.join(model.contacts)}")
    planned = replace(
        expect_readings(np.where(read & planned.present, planned.sd, np.nan)[some]),
        correlation=None if planned.correlation is None else np.repeat(planned.correlation, len(some), axis=0),
    )
    there = {name: value[some] for name, value in given.items()}
    return values[some][:, calibrated.commanded], there, planned, tuple(names[k] for k in some)


def _place_near_home(legs: Legs, theta: Array, reach: float) -> Array:
    """Return the actuator positions (C, N) of random poses at which the one that moves most moves by about a reach."""
    machine = legs.machine
    mechanism, own = machine.mechanism, theta[: machine.layout.size]
    start = mechanism.initial_actuator_positions
    home = solve_forward_kinematics(machine, own, start)
    here = machine.linearise(own, home.position, home.rotation, start)
    size = np.array([1.0] * 3 + [1.0 / np.linalg.norm(mechanism.platform_points, axis=1).max()] * 3)
    moves = np.random.default_rng(0).uniform(-1.0, 1.0, (RANDOM, DEGREES_OF_FREEDOM)) * size
    needed = np.abs(moves @ np.linalg.solve(here.actuators, here.pose).T).max(axis=1, keepdims=True)
    moves *= reach / needed
    rotation = matrix_from_rotation_vector(moves[:, 3:]) @ home.rotation
    found = solve_inverse_kinematics(machine, own, home.position + moves[:, :3], rotation, check=False)
    read = legs.read_actuators(theta, found.actuators)
    within = np.abs(read - start).max(axis=1) <= mechanism.actuator_range
    return _keep_reached(legs, theta, read[found.converged & within])


def _keep_reached(legs: Legs, theta: Array, actuators: Array) -> Array:
    return actuators[legs.solve(theta, actuators).converged]


def plan_reverification(
    calibrated: CalibratedMachine,
    suspects: TestedParameters,
    candidates: Array,
    given: Given,
    planned: Measurements,
    demand: VerificationGoal,
) -> ReverificationPlan:
    """Return the fewest poses out of candidates, commands (C, n) in the channels' units, that meet a demand.

    ``planned`` is a row that says which channels are read, and their noise; see `predict_knowledge`. InputError where
    no number of poses up to ``demand.most`` does.
    """
    whole = predict_knowledge(calibrated, suspects, candidates, given, planned)
    kept, (knowledge,) = keep_seen(suspects, [whole])
    demand = replace(demand, shift=demand.shift[whole.seen])
    choice = _Choice(knowledge.scale(demand.shift), demand)
    chosen: list[int] = []
    while len(chosen) < min(demand.most, len(candidates)):
        chosen.append(choice.find_best(chosen))
        if choice.seems_enough(chosen):
            exchanged = choice.exchange(chosen)
            test, power = choice.judge(exchanged)
            if power.min() >= demand.power:
                final, test, power = choice.shorten(exchanged, test, power)
                there = {name: value[final] for name, value in given.items()}
                return ReverificationPlan(kept, np.array(final), candidates[final], there, test, power, demand)
    worst = choice.judge(chosen)[1]
    least = int(np.argmin(worst))
    raise InputError(
        f"verify: found that {len(chosen)} poses detect a shift of {kept.names[least]} by "
        f"{say_size(float(demand.shift[least]), kept.units[least])} with {100.0 * worst[least]:.1f} "
        f"%, expected {100.0 * demand.power:g} %: larger shift, more sessions, less noise"
    )


@dataclass(frozen=True, eq=False)
class _Choice:
    """Candidates out of which poses are chosen, shifts in units of those to be found."""

    knowledge: PoseInformation
    demand: VerificationGoal

    def find_best(self, chosen: list[int]) -> int:
        """Return the candidate with which, beside those chosen, most is known of the shift that is known least."""
        knowledge = self.knowledge
        information = knowledge.add_each(knowledge.total(chosen), self.demand.sessions)
        rate = information.min(axis=1) + 1e-3 * information.mean(axis=1)  # ties to those that say more
        rate[chosen] = -np.inf
        return int(np.argmax(rate))

    def exchange(self, chosen: list[int]) -> list[int]:
        """Return poses, each exchanged for the best candidate beside the others, until none is better."""
        chosen = list(chosen)
        for _ in range(EXCHANGES):
            before = list(chosen)
            for k in range(len(chosen)):
                chosen[k] = self.find_best(chosen[:k] + chosen[k + 1 :])
            if chosen == before:
                break
        return chosen

    def seems_enough(self, chosen: list[int]) -> bool:
        """Return whether the worst parameter's own statistic might pass the lowest threshold that there can be."""
        demand, gram = self.demand, self.knowledge.total(chosen)
        _, information = self.knowledge.score(demand.sessions * gram)
        passed = ndtr(np.sqrt(np.diag(information).min()) + ndtri(demand.false_alarm / 2.0))
        return bool(passed > demand.power - HOPEFUL)

    def judge(self, chosen: list[int]) -> tuple[ShiftTest, Array]:
        """Return the test of some poses, and with which probability each shift is found."""
        gram = self.knowledge.total(chosen)
        test = build_test(look_again(self.knowledge, [gram], self.demand.sessions), self.demand.false_alarm)
        return test, test.find_power()

    def shorten(self, chosen: list[int], test: ShiftTest, power: Array) -> tuple[list[int], ShiftTest, Array]:
        """Return fewer poses where some exchange finds them, and the rest as it is then."""
        while len(chosen) > 1:
            fewer = self.exchange(chosen[:-1])
            there, found = self.judge(fewer)
            if found.min() < self.demand.power:
                break
            chosen, test, power = fewer, there, found
        return chosen, test, power


# --- measured poses ------------------------------------------------------------------------------------------------


def is_read_by_pose(calibrated: CalibratedMachine) -> bool:
    """Return whether an instrument measures the machine's pose, which its coordinates are, and nothing else."""
    model = calibrated.model
    places = [one.name for one in model.coordinates]
    own = [*model.commanded, *POSE]
    return model.reads_pose and not model.given and places == list(POSE) and list(model.names) == own


def list_trackers(calibrated: CalibratedMachine) -> list[str]:
    """Return the names of the instruments that measured the tool in frames of their own."""
    return [one.name for one in calibrated.model.beside if isinstance(one.machine, Tracker)]


def build_covariance(position_um: float, orientation_arcsec: float | None) -> Array:
    """Return the covariance of a measured pose (6, 6), mm and rad, of equal errors along all axes.

    NaN of rotations that are not measured.
    """
    rotation = np.nan if orientation_arcsec is None else ARCSECOND * orientation_arcsec
    sd = [MICROMETRE * position_um] * 3 + [rotation] * 3
    return np.diag(np.square(sd))


def read_mean_covariance(path: Path, in_part: bool = False) -> Array:
    """Return the mean covariance (6, 6) of the poses of a table, mm and rad, by covariances or by ``sd_`` columns.

    Of poses that may be measured in part, NaN where the table has no noise.
    """
    upper, lower = name_covariances(POSE)
    table = read_table(path, ("pose",), (*read_table(path, None).columns, *upper, *lower))
    if not any(name in table.columns for name in (*upper, *DEVIATIONS)):
        raise InputError(f"{path}: found no noise, expected cov_x_x ... cov_rz_rz or sd_x_um ... sd_rz_urad")
    stated = [
        not {f"cov_{name}_{name}", sd}.isdisjoint(table.columns) for name, sd in zip(POSE, DEVIATIONS, strict=True)
    ]
    measured = np.tile(np.array(stated) | (not in_part), (len(table.rows), 1))
    covariance = read_noise(table, PoseNoise(), measured)
    check_positive(table, covariance, measured)
    mean = (covariance * np.outer(UNITS, UNITS)).mean(axis=0)
    return np.where(np.outer(measured[0], measured[0]), mean, np.nan)


def expect_pose(calibrated: CalibratedMachine, covariance: Array) -> Measurements:
    """Return a row that says that a pose is measured, with a covariance (6, 6), mm and rad."""
    return place_poses(
        ("plan",), np.zeros((1, len(calibrated.commanded))), np.zeros((1, DEGREES_OF_FREEDOM)), covariance[None]
    )


def expect_tracked(calibrated: CalibratedMachine, tracker: str, covariance: Array) -> Measurements:
    """Return a row that says that an instrument measures the tool, with a covariance (n, n), mm and rad.

    That of a pose, n = 6, or of all its channels; NaN of those that are not read.
    """
    places, n = calibrated.model.instrument_places[tracker], len(calibrated.model.channels)
    sd = np.full(n, np.nan) if calibrated.noise is None else calibrated.noise.copy()
    seen = covariance[: len(places), : len(places)]  # the position alone, of a tool that does not say how it is turned
    sd[places], correlation = np.sqrt(np.diagonal(seen)), np.eye(n)
    known = seen / np.outer(sd[places], sd[places])
    correlation[np.ix_(places, places)] = np.where(np.isfinite(known), known, np.eye(len(places)))
    return replace(expect_readings(sd), correlation=correlation[None])


def place_poses(names: tuple[str, ...], actuators: Array, values: Array, covariance: Array) -> Measurements:
    """Return poses (P, 6), mm and rad, measured at positions (P, N) of the commanded channels, as readings.

    Values are NaN where not measured; the covariance (P, 6, 6) is that of what is measured.
    """
    n = actuators.shape[1]
    measured = np.isfinite(values)
    both = measured[:, :, None] & measured[:, None, :]
    covariance = np.where(both, covariance, np.eye(DEGREES_OF_FREEDOM))
    sd = np.sqrt(np.diagonal(covariance, axis1=1, axis2=2))
    correlation = np.tile(np.eye(n + DEGREES_OF_FREEDOM), (len(values), 1, 1))
    correlation[:, n:, n:] = covariance / (sd[:, :, None] * sd[:, None, :])
    every = np.concatenate([actuators, values], axis=1)
    return Measurements(names, every, np.concatenate([np.ones_like(actuators), sd], axis=1), {}, correlation)


# --- readings of any machine ---------------------------------------------------------------------------------------


def expect_readings(sd: Array) -> Measurements:
    """Return rows that say which channels are read, by their noise (K,) or (P, K); NaN for those that are not."""
    sd = np.atleast_2d(sd)
    names = tuple(f"plan {k}" for k in range(1, len(sd) + 1))
    return Measurements(names, np.where(np.isfinite(sd), 0.0, np.nan), np.nan_to_num(sd, nan=1.0))


def add_commands(path: Path, plan: Path | None, readings: Measurements, calibrated: CalibratedMachine) -> Measurements:
    """Return a session's readings with the commanded channels of a plan, by the poses' names.

    InputError where commands stand in both or in none, or a pose is not in the plan.
    """
    own, values, given = calibrated.commanded, readings.values.copy(), dict(readings.given)
    there = np.isfinite(values[:, own]).any()
    if plan is None:
        missing = [one.name for one in calibrated.command_channels]
        if missing and not there:
            raise InputError(f"{path}: found no {', '.join(missing)}, expected it, or --actuators PLAN.csv")
        return readings
    if there:
        raise InputError(f"{path}: found commanded channels also in {plan}, expected them once")
    names, commands, known = read_commands(plan, calibrated)
    for name in readings.poses:
        if name not in names:
            raise InputError(f"{path}: pose {name!r}: not in {plan}")
    rows = [names.index(name) for name in readings.poses]
    values[:, own] = commands[rows]
    given |= {name: value[rows] for name, value in known.items()}
    return Measurements(readings.poses, values, readings.sd, given, readings.correlation)


def check_noise(path: Path, readings: Measurements, calibrated: CalibratedMachine) -> None:
    """Raise InputError for a reading whose noise is not known; that of commanded channels is the machine's own."""
    channels, own = calibrated.model.channels, np.isin(np.arange(len(calibrated.model.channels)), calibrated.commanded)
    for k, channel in np.argwhere(readings.present & ~np.isfinite(readings.sd) & ~own)[:1]:
        one = channels[channel]
        raise InputError(
            f"{path}: pose {readings.poses[k]!r}: found no noise of {one.name}, expected column "
            f"{one.stem}_sd_{one.unit}, or --noise-from"
        )
    for name, value in readings.given.items():
        for k in np.flatnonzero(~np.isfinite(value))[:1]:
            raise InputError(f"{path}: pose {readings.poses[k]!r}: found no {name}, expected it")


# --- what is written -----------------------------------------------------------------------------------------------


def format_plan(
    calibrated: CalibratedMachine, plan: ReverificationPlan, title: str, how: str, touching: Sequence[str] = ()
) -> str:
    """Return a plan as CSV text: the poses of one session, the one that shows most first.

    ``how`` says what is measured at each; ``touching`` are the instruments that touch at the candidates out of which it
    is chosen, where any do.
    """
    channels = calibrated.command_channels
    back = "then: bayescal verify RESULTS --measured THAT.csv --actuators THIS.csv"
    comments = [*calibrated.source.describe(), title, f"{how};", back]
    beside = [(touching[k],) for k in plan.chosen] if touching else [()] * len(plan.chosen)
    columns = [
        "pose",
        "use",
        *([READ_BY] if touching else []),
        *plan.given,
        *(name_column(calibrated, one) for one in channels),
    ]
    known = list(zip(*plan.given.values(), strict=True)) or [()] * len(plan.commands)
    rows = [
        (f"R{k:02d}", "calibration", *by, *map(repr, map(float, own)), *(f"{x:.6f}" for x in one))
        for k, (by, own, one) in enumerate(
            zip(beside, known, show_values(calibrated, plan.commands, channels), strict=True), start=1
        )
    ]
    return format_table(comments, columns, rows)


def describe_plan(plan: ReverificationPlan) -> str:
    """Return in a sentence what a plan does."""
    demand, by_session = plan.demand, PERCENT * plan.power_by_session
    n, worst = len(plan.chosen), PERCENT * plan.power.min()
    sessions = "one session" if demand.sessions == 1 else f"{demand.sessions} sessions"
    first = "" if demand.sessions == 1 else f", {by_session[0]:.0f} % in the first"
    suspects, shift = plan.suspects, demand.shift
    which = f"any {suspects.kind}" if len(shift) > 1 else suspects.names[0]
    size = say_size(float(shift[0]), suspects.units[0])
    if demand.in_sd is not None:
        size = f"{demand.in_sd:g} of its standard deviations"
    return (
        f"{n} pose{'s' if n > 1 else ''}: shift of {which} by {size} detected with {worst:.1f} % in "
        f"{sessions}{first}; false alarms {PERCENT * demand.false_alarm:g} %"
    )


def describe_reverification(found: Reverification) -> list[str]:
    """Return in lines what a reverification says."""
    suspects, worst = found.suspects, found.worst
    largest = float(np.abs(found.statistic).max())
    alarms = f"{PERCENT * found.false_alarm:g} % false alarms"
    test = f"largest statistic {largest:.2f}, limit {found.threshold:.2f} for {alarms}"
    sizes = [say_shift(x, s, u) for x, s, u in zip(found.shift, found.sd, suspects.units, strict=True)]
    if found.holds:
        lines = [f"the calibration holds: {test}"]
    else:
        sure, moved = PERCENT * found.probability[worst], "moved" if suspects.kind != "parameter" else "shifted"
        which = f"that it is this {suspects.kind}"
        lines = [f"{suspects.names[worst]} {moved} by {sizes[worst]} ({sure:.1f} % {which}): {test}"]
    lines += [f"{name}: {size} if it alone moved" for name, size in zip(suspects.names, sizes, strict=True)]
    if found.is_odd:
        lines.append(
            f"inconsistent with the calibration and any single {suspects.kind} shift (p = {found.left_over:.1g})"
        )
    return lines
