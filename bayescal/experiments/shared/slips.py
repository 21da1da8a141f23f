"""Slips of the data, each tried as if it were so: units, signs, exchanged columns, rows that are shifted.

A slip is looked for before anything is fitted closely: the data are weighed under the priors, to first order about the
nominal machine. Right data close to within the tolerances and what the first order leaves; slipped ones are off by as
much as the machine moves. What data are, and how they are weighed, is the machine's own; the search is one, and so is
the list of what may have happened to columns of numbers.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from itertools import combinations, permutations
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import AfterValidator
from scipy.spatial.transform import Rotation

from bayescal.config.sections import check_once
from bayescal.data.instruments.read_poses import FIXED, ROLL_PITCH_YAW, name_angles
from bayescal.data.measured_poses import MeasuredPoses
from bayescal.errors import BayescalError
from bayescal.numerics.geometry import Array, rotation_vector_from_matrix
from bayescal.report.blocks import Statement
from bayescal.report.numbers import format_significant, join_words

UNIT, LEGS, ROWS, POSES, CHANNEL = "unit", "legs", "rows", "poses", "channel"
CLEARLY = 20.0  # nats by which a slip has to explain the data better
BETTER = 3.0
"""Factor by which the misfit has to fall for a slip to be named."""
LARGEST = 1e5
"""Misfit in units of what was stated, beyond which it is the same how far data are off."""
OUTLYING = 10.0
"""Rms of a row in units of the median, beyond which the others are fitted without it."""
ALIKE, MANY = 1.2, 3
"""Factor within which slips explain readings alike, as in a mirrored machine, and how many of them are named."""
LENGTHS = {
    "1000 times too large (µm for mm)": 1e-3,
    "in metres, 1000 times too small": 1e3,
    "100 times too large": 1e-2,
    "100 times too small": 1e2,
    "10 times too large (cm for mm)": 0.1,
    "10 times too small (mm for cm)": 10.0,
    "in inches": 25.4,
    "in mm where inches are stated": 1.0 / 25.4,
    "of the other sign": -1.0,
}
ANGLES = {
    "in milliradians, 1000 times too large": 1e-3,
    "1000 times too small": 1e3,
    "in arcseconds": np.pi / 648000.0,
    "in degrees": np.pi / 180.0,
    "in radians where degrees are stated": 180.0 / np.pi,
    "of the other sign": -1.0,
}
GEARS = {"twice too large": 0.5, "half as large as they should be": 2.0}
"""What happens to a single sensor: another gear ratio, edges counted once or twice."""
REREAD = 1.5
"""Factor by which errors have to fall where what was measured is read in another way: at tilts of some degrees the legs
are then off by two to five times what was stated. Clean twins that err by 50 µm besides gain less than a nat by it."""
SUSPECT = 10.0
"""Legs' errors in units of what was stated, below which no slip of the actuators is tried."""
TURN = 2.0 * float(np.pi)

type DeniedSlips = Annotated[list[Literal["unit", "legs", "rows"]], AfterValidator(check_once)]


@dataclass(frozen=True)
class Weight:
    """How well data fit: their log-density, and how far they are off in units of what was stated."""

    log_density: float
    misfit: float


NOTHING = Weight(-np.inf, np.inf)


@dataclass(frozen=True, eq=False)
class Slip[D]:
    """Data as they would be without a slip.

    Attributes
    ----------
    text : str
        What the slip would be.
    chosen : ndarray of int, shape (Q,), or None
        Which of the rows they are; all of them without it.
    log_volume : float
        Of the data's change, for densities of changed data to be compared.
    least : float
        Factor by which the misfit has to fall.
    tried_from : float
        Smallest misfit of the data as they are from which it is tried.
    """

    fault: str
    text: str
    data: D
    chosen: np.ndarray | None = None
    log_volume: float = 0.0
    least: float = BETTER
    tried_from: float = 0.0


@dataclass(frozen=True)
class FoundSlip:
    """A slip that explains the data better than they are: by how many nats, and how much smaller the misfit.

    Attributes
    ----------
    factor : float or None
        None where no machine within the tolerances has the data as they are.
    """

    fault: str
    text: str
    gain: float
    factor: float | None

    def say(self) -> str:
        """Return it in words."""
        return f"the data {_say_factor(self.factor)} if corrected: {self.text}"

    def record(self) -> dict[str, str | float | None]:
        """Return it for a summary, where an infinite gain is none."""
        return {**asdict(self), "gain": self.gain if np.isfinite(self.gain) else None}


def _say_factor(factor: float | None) -> str:
    return "fit only" if factor is None else f"fit {format_significant(factor, 2)} times better"


def find_slip[D](
    weigh: Callable[[D, np.ndarray | None], Weight],
    data: D,
    slips: Iterable[Slip[D]],
    fits: float,
    denied: Collection[str] = (),
) -> FoundSlip | None:
    """Return the slip that explains the data best; None where they fit as they are, or none helps.

    Parameters
    ----------
    weigh : callable
        Returns how well data fit, some of their rows alone where these are given.
    data : D
        As they are.
    fits : float
        Misfit up to which nothing has slipped.
    denied : collection of str, optional
        Faults that are none, as somebody says who looked.
    """
    base = weigh(data, None)
    if base.misfit <= fits:
        return None
    found: list[tuple[float, float, FoundSlip]] = []
    for slip in slips:
        if slip.fault in denied or base.misfit < slip.tried_from:
            continue
        beside = base if slip.chosen is None else weigh(data, slip.chosen)
        mended = weigh(slip.data, slip.chosen)
        if not (np.isfinite(mended.misfit) and mended.misfit < LARGEST):
            continue
        gain = mended.log_density + slip.log_volume - beside.log_density
        factor = beside.misfit / max(mended.misfit, 1.0)
        if gain > CLEARLY and factor > slip.least:
            said = FoundSlip(slip.fault, slip.text, gain, factor if np.isfinite(factor) else None)
            found.append((mended.misfit, mended.log_density + slip.log_volume, said))
    if not found:
        return None
    misfit, _, best = max(found, key=lambda one: (one[2].gain, one[1]))
    others = [
        one.text
        for off, _, one in sorted(found, key=lambda one: one[0])
        if one is not best and off <= ALIKE * max(misfit, 1.0) and not best.gain - one.gain > CLEARLY
    ]
    text = f"{best.text}{''.join(f' (or: {one})' for one in others[: MANY - 1])}"
    return FoundSlip(best.fault, text, best.gain, best.factor)


# --- what may happen to columns of readings ----------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Columns:
    """Readings (P, K), NaN where nothing was read, and those compared on a circle by their places."""

    values: Array
    circular: tuple[int, ...] = ()


def list_reading_slips(
    names: Sequence[str],
    units: Sequence[str],
    values: Array,
    given: Sequence[str] = (),
    external: Sequence[bool] | np.ndarray | None = None,
) -> Iterator[Slip[Columns]]:
    """Yield what may have happened to readings (P, K), mm and rad, of sensors named ``kind[leg]``.

    What is ``given`` of each row besides are columns that all readings may be shifted against; channels of instruments
    beside the machine are ``external``.
    """
    kinds: dict[str, list[int]] = {}
    for k, name in enumerate(names):
        kinds.setdefault(name.partition("[")[0], []).append(k)
    yield from _scale_instruments(kinds, units, values, external)
    for kind in sorted(kinds):
        own = np.array(kinds[kind])
        yield from _scale(kind, own, units[own[0]], values)
        if len(own) > 2:
            yield Slip(LEGS, f"legs of {kind} seem to be numbered the other way round", _move(values, own, own[::-1]))
        for step in range(1, len(own) if len(own) > 2 else 1):
            text = f"legs of {kind} seem to be counted from leg {step + 1}"
            yield Slip(LEGS, text, _move(values, own, np.roll(own, -step)))
        yield from _shift(kind, own, values)
        if units[own[0]] == "rad":
            text = f"readings of {kind} seem to start anew after a full turn"
            yield Slip(UNIT, text, Columns(values, tuple(own)))
    for one, other in combinations(range(len(names)), 2):
        if units[one] == units[other]:
            text = f"readings of {names[one]} and {names[other]} seem to be exchanged"
            yield Slip(LEGS, text, _move(values, np.array([one, other]), np.array([other, one])))
    for k, name in enumerate(names):
        if "[" in name:
            yield from _scale(name, np.array([k]), units[k], values)
            yield from _shift(name, np.array([k]), values)
        yield from _scale(name, np.array([k]), "", values)
    if given:
        yield from _shift(f"all readings against {join_words(list(given))}", np.arange(values.shape[1]), values, True)


def _scale_instruments(
    kinds: Mapping[str, list[int]], units: Sequence[str], values: Array, external: Sequence[bool] | np.ndarray | None
) -> Iterator[Slip[Columns]]:
    """Yield kinds of one unit that belong together, as ``cam_x`` and ``cam_y`` do, or all of them, in another unit."""
    groups: dict[tuple[int, ...], list[str]] = {}
    for unit in dict.fromkeys(units):
        alike = [kind for kind, places in kinds.items() if units[places[0]] == unit]
        stems = dict.fromkeys(kind.rpartition("_")[0] for kind in alike if "_" in kind)
        beside = [] if external is None else [kind for kind in alike if external[kinds[kind][0]]]
        for some in [[kind for kind in alike if kind.rpartition("_")[0] == stem] for stem in stems] + [beside, alike]:
            if len(some) > 1:
                groups[tuple(k for kind in some for k in kinds[kind])] = some
    for places, some in groups.items():
        yield from _scale(join_words(some), np.array(places), units[places[0]], values)


def _move(values: Array, places: np.ndarray, source: np.ndarray) -> Columns:
    moved = values.copy()
    moved[:, places] = values[:, source]
    return Columns(moved)


def _scale(name: str, columns: np.ndarray, unit: str, values: Array) -> Iterator[Slip[Columns]]:
    """Yield columns as if they had another unit; of no unit as if they were of another gear."""
    count = int(np.isfinite(values[:, columns]).sum())
    for words, factor in {"mm": LENGTHS, "rad": ANGLES, "": GEARS}.get(unit, {"of the other sign": -1.0}).items():
        moved = values.copy()
        moved[:, columns] *= factor
        volume = count * float(np.log(abs(factor)))
        yield Slip(UNIT, f"readings of {name} seem to be {words}", Columns(moved), None, volume)


def _shift(name: str, columns: np.ndarray, values: Array, together: bool = False) -> Iterator[Slip[Columns]]:
    """Yield some columns as if they stood a row too early or too late; all of them only ``together``."""
    if len(values) < 3 or (len(columns) == values.shape[1] and not together):
        return
    for step, words in ((1, "earlier"), (-1, "later")):
        moved = values.copy()
        moved[:, columns] = np.roll(values[:, columns], step, axis=0)
        there = np.arange(len(values))[slice(1, None) if step > 0 else slice(None, -1)]
        text = f"rows of {name} seem to be shifted by one: they belong to the readings of the row {words}"
        yield Slip(ROWS, text, Columns(moved[there]), there)


def weigh_rows(judge: Callable[[], tuple[Array, int]]) -> Weight:
    """Return how well rows of readings fit, by the median of them: it does not hang on one that is an outlier.

    A pose that no reading states is found from all of them, so that readings are compared with each other: what no pose
    explains of a machine within the tolerances.

    Parameters
    ----------
    judge : callable
        Returns how far rows lie from what a machine within its tolerances reads, in units of their noise, (Q,), and how
        many readings more than unknowns of poses they have in all. What fails fits nothing.
    """
    try:
        with np.errstate(all="ignore"):
            off, spare = judge()
    except (BayescalError, np.linalg.LinAlgError):
        return NOTHING
    misfit = float(np.median(np.where(np.isfinite(off), off, np.inf)))
    return Weight(-spare * float(np.log(np.clip(misfit, 1.0, LARGEST))), misfit)


def fit_rows(rest: Array, moves: Array, n_spare: np.ndarray) -> Array:
    """Return the rms of white rows beside the machine that fits them best to first order, without outlying rows, (Q,).

    Parameters
    ----------
    rest : ndarray, shape (Q, K)
        What no pose explains of them.
    moves : ndarray, shape (Q, K, m)
        What the parameters explain, in their tolerances.
    n_spare : ndarray of int, shape (Q,)
        Readings more than unknowns of each pose.
    """
    off = np.sqrt(np.sum(rest**2, axis=1) / n_spare)
    for _ in range(2 if len(off) else 0):
        used = off <= OUTLYING * np.median(off)
        along = np.einsum("pin,pi->n", moves[used], rest[used])
        inner = np.eye(moves.shape[-1]) + np.einsum("pin,pim->nm", moves[used], moves[used])
        off = np.sqrt(np.sum((rest - moves @ np.linalg.solve(inner, along)) ** 2, axis=1) / n_spare)
    return np.asarray(off)


# --- what may happen to actuators and measured poses of a machine on legs ----------------------------------------


@dataclass(frozen=True, eq=False)
class LegData:
    """Actuator positions (P, N), mm, and the poses that were measured; None for points in place of poses."""

    actuators: Array
    poses: MeasuredPoses | None = None

    def pick(self, chosen: np.ndarray) -> LegData:
        """Return some of them."""
        return LegData(self.actuators[chosen], None if self.poses is None else self.poses.select(chosen))


def list_leg_slips(data: LegData, start: Array) -> Iterator[Slip[LegData]]:
    """Yield what may have happened to actuator positions, whose initial ones are ``start``, and to poses."""
    for fault, text, actuators, chosen in _list_actuators(data.actuators, start):
        poses = (data if chosen is None else data.pick(chosen)).poses
        yield Slip(fault, text, LegData(actuators, poses), chosen, tried_from=SUSPECT)
    if data.poses is not None:
        for text, poses in list_rereads(data.poses):
            yield Slip(POSES, text, LegData(data.actuators, poses), least=REREAD)


def _list_actuators(actuators: Array, start: Array) -> Iterator[tuple[str, str, Array, np.ndarray | None]]:
    """Yield what may have happened to actuator positions (P, N), mm: fault, words, positions, and which poses."""
    n_poses, n_legs = actuators.shape
    for words, factor in LENGTHS.items():
        yield UNIT, f"actuator displacements seem to be {words}", start + factor * (actuators - start), None
        if factor > 0.0:
            yield UNIT, f"actuator positions seem to be {words}", factor * actuators, None
    if start.any():
        yield UNIT, "displacements seem to stand in place of actuator positions", actuators + start, None
    for one, other in combinations(range(n_legs), 2):
        order = np.arange(n_legs)
        order[[one, other]] = other, one
        yield LEGS, f"legs {one + 1} and {other + 1} seem to be exchanged", actuators[:, order], None
    yield LEGS, "legs seem to be numbered the other way round", actuators[:, ::-1], None
    for step in range(1, n_legs):
        order = np.roll(np.arange(n_legs), -step)
        yield LEGS, f"legs seem to be counted from leg {step + 1}", actuators[:, order], None
    every = np.arange(n_poses)
    for step, words in ((1, "earlier"), (-1, "later")):
        if n_poses > 2:
            there = every[step:] if step > 0 else every[:step]
            text = f"rows seem to be shifted by one: readings belong to the actuator positions of the row {words}"
            yield ROWS, text, actuators[there - step], there


def list_rereads(poses: MeasuredPoses) -> Iterator[tuple[str, MeasuredPoses]]:
    """Yield what may have happened to poses, in words, and the poses without it; their covariances stay as they are.

    They are tried from a misfit on that one of them could mend: angles taken for rotation vectors are off by little
    where tilts are small.
    """
    position, rotation = poses.position, poses.rotation
    vectors = rotation_vector_from_matrix(rotation)
    for axes in permutations(FIXED):
        order = [FIXED.index(axis) for axis in axes]
        turned = Rotation.from_euler("".join(axes), vectors[:, order]).as_matrix()
        yield _describe_angles("".join(axes)), replace(poses, rotation=turned)
    back = np.swapaxes(rotation, 1, 2)
    yield (
        "rotations seem to be those of the base seen from the platform, the other way round",
        replace(poses, rotation=back),
    )
    yield (
        "poses seem to be those of the base in the platform's frame",
        replace(poses, position=-np.einsum("pij,pj->pi", back, position), rotation=back),
    )
    for k, axis in enumerate(FIXED):
        flipped = position * np.where(np.arange(3) == k, -1.0, 1.0)
        yield f"{axis}_mm seems to be of the other sign", replace(poses, position=flipped)
    for one, other in combinations(range(3), 2):
        exchanged = position.copy()
        exchanged[:, [one, other]] = position[:, [other, one]]
        text = f"{FIXED[one]}_mm and {FIXED[other]}_mm seem to be exchanged"
        yield text, replace(poses, position=exchanged)


def _describe_angles(axes: str) -> str:
    columns = ROLL_PITCH_YAW if axes == FIXED else name_angles(axes)
    return (
        "rx_deg, ry_deg and rz_deg seem to be no rotation vectors but angles about the fixed axes "
        f"{', '.join(axes)} one after the other: call them {', '.join(columns)}"
        + ("" if axes == FIXED else ", in that order of axes")
    )


# --- words -------------------------------------------------------------------------------------------------------


def tell_denial(field: str) -> str:
    """Return the end of a refusal: how to say that nothing has slipped."""
    return f"; if the data are right, name the kind of slip that it is not, unit, legs or rows, in {field}"


def state_denied(summary: Mapping[str, Any]) -> list[Statement]:
    """Say which slips would explain the data and were denied, from a summary's ``denied_slips``."""
    return [
        Statement(f"{text}. The config denies that; if it is so all the same, all else is wrong.", "warning", "Data")
        for text in summary.get("denied_slips", [])
    ]


def state_slip(summary: Mapping[str, Any]) -> list[Statement]:
    """Say what may have happened to data that no machine within the tolerances explains, from a summary's ``slip``."""
    slip = summary.get("slip")
    if not isinstance(slip, dict):
        return []
    text = (
        f"No machine within the tolerances comes near the data; they {_say_factor(slip['factor'])} if one thing is "
        f"corrected: {slip['text']}. All other results rest on data that seem to be wrong."
    )
    return [Statement(text, "bad", "Data")]
