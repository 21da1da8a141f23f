"""What may have happened to readings, whatever the machine: what is done to their columns, and what else adds to them.

Some causes change the table of readings: units, signs, order of channels and of rows, angles read in another way.
Others leave it as it is and add columns of unknown sizes (frames, zeros, scales, drifts), widen a tolerance, change a
noise, or say that a row does not belong.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import combinations, permutations

import numpy as np
from scipy.spatial.transform import Rotation

from bayescal.data.instruments.read_poses import FIXED, ROLL_PITCH_YAW, name_angles
from bayescal.experiments.shared.slip_given import list_exchanged, list_rescaled
from bayescal.experiments.shared.slip_rows import NARROWER, WIDE_PRIOR_SD, WIDER, RowReadings, VariantReadings
from bayescal.experiments.shared.slips import CHANNEL, FRAME, LEGS, POSES, ROWS, UNIT
from bayescal.machines.readings import Channel
from bayescal.machines.readings.gains import find_gains
from bayescal.machines.readings.placed import InstrumentedMachine
from bayescal.numerics.geometry import (
    Array,
    compute_left_jacobian,
    matrix_from_rotation_vector,
    rotation_vector_from_matrix,
    skew_matrix,
)
from bayescal.report.numbers import format_significant, join_words

NOISE, TOLERANCE, DRIFT, MODEL = "noise", "tolerance", "drift", "model error"
SCATTER = "scatter"
"""A noise stated too small, or errors of the model from row to row: the data cannot tell."""
WIDE = "wide tolerance"
"""No fault: intervals are wider than they need be."""
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
GEARS = {"twice too large": 0.5, "half as large": 2.0}
"""What happens to a single sensor: another gear ratio, edges counted once or twice."""
FACTORS: tuple[float, ...] = (
    0.05,
    0.1,
    0.15,
    0.2,
    0.3,
    0.5,
    2.0,
    3.0,
    4.0,
    5.0,
    7.0,
    10.0,
    20.0,
    50.0,
    100.0,
    1e3,
    1e4,
)
"""On a noise."""
SHIFTED = 10.0  # a shift of readings in units of its scatter, from which on it is one for all
COUPLED = 0.1  # of the travel, by which channels err at most
MOST_PAIRS = 200  # of channels that are tried exchanged: of many, those of one kind alone
STEADY = 2.0  # noises within which all readings of a channel that does not move lie


@dataclass(frozen=True, eq=False)
class Cause:
    """What may have happened: readings as they would be without it, columns, a noise, rows that do not count."""

    fault: str
    text: str
    table: RowReadings | None = None
    columns: Array | None = None  # (P, K, k)
    most: float = np.inf  # standard deviation of the columns' unknowns
    scaled: int | None = (
        None  # channel whose readings r are (1 - u) r but for the columns' unknown u: a change of density
    )
    toleranced: tuple[int, ...] = ()  # parameters whose tolerance is another one, by their places
    factors: tuple[float, ...] = ()  # on that tolerance
    noise: tuple[int, ...] = ()  # channels whose noise is another one, by one of the factors
    blind: int | None = None  # channel that may read anything
    without: tuple[int, ...] = ()  # rows
    among: int = 1  # it is the best of so many that were tried together, and counts as one of them
    # from the sizes of its columns' unknowns (k,), or from its factor (1,), to words; of a channel that may read
    # anything from what the others say that it reads, (P,)
    say: Callable[[Array], str] | None = None
    # of several ways to choose causes of a kind (one parameter, all of one letter, ...): each is as probable
    scope: str = ""


def list_tables(readings: VariantReadings) -> Iterator[Cause]:
    """Yield what may have happened to columns of numbers."""
    yield from _list_columns(readings)
    yield from (Cause(UNIT, text, table) for text, table in list_rescaled(readings))
    yield from (Cause(LEGS, text, table) for text, table in list_exchanged(readings))
    yield from _list_blind(readings)
    yield from _list_displacements(readings)
    yield from _list_rereads(readings)


def list_effects(readings: VariantReadings, pose: Array) -> Iterator[Cause]:
    """Yield what leaves the table as it is; poses (P, q) are those that explain the readings."""
    yield from _list_frames(readings, pose)
    yield from _list_noises(readings.channels)
    yield from _list_channels(readings)
    yield from _list_tolerances(readings)
    yield from _list_couplings(readings)
    if not readings.posterior.errors.outliers.expected:
        for k, name in enumerate(readings.posterior.likelihood.data.poses):
            row = f"row {k + 1} (pose {str(name)!r})"
            text = f"{row} does not belong to the others: check or leave it out"
            yield Cause(ROWS, text, without=(k,))


# --- columns of readings ---------------------------------------------------------------------------------------------


def _list_columns(readings: VariantReadings) -> Iterator[Cause]:
    """Yield columns in other units, of the other sign, exchanged, numbered otherwise, shifted by a row."""
    channels, values = readings.channels, readings.values
    names = [one.name for one in channels]
    kinds: dict[str, list[int]] = {}
    for k, name in enumerate(names):
        kinds.setdefault(name.partition("[")[0], []).append(k)
    yield from _scale_instruments(kinds, channels, values)
    for kind in sorted(kinds):
        own = np.array(kinds[kind])
        unit = channels[own[0]].unit
        yield from _scale(kind, own, unit, values)
        if len(own) > 2:
            yield _move(f"legs of {kind} seem to be numbered the other way round", values, own, own[::-1])
        for step in range(1, len(own) if len(own) > 2 else 1):
            yield _move(f"legs of {kind} seem to be counted from leg {step + 1}", values, own, np.roll(own, -step))
        yield from _shift(kind, own, values)
        if unit == "rad":
            text = f"readings of {kind} seem to restart after a full turn"
            yield Cause(UNIT, text, RowReadings(values, np.arange(len(values)), tuple(own)))
    pairs = [(a, b) for a, b in combinations(range(len(names)), 2) if channels[a].unit == channels[b].unit]
    if len(pairs) > MOST_PAIRS:
        pairs = [(a, b) for a, b in pairs if channels[a].kind == channels[b].kind]
    for one, other in pairs:
        text = f"readings of {names[one]} and {names[other]} seem to be exchanged"
        yield _move(text, values, np.array([one, other]), np.array([other, one]))
    for k, name in enumerate(names):
        if "[" in name:
            yield from _scale(name, np.array([k]), channels[k].unit, values)
            yield from _shift(name, np.array([k]), values)
        yield from _scale(name, np.array([k]), "", values)
    if given := readings.model.given:
        yield from _shift(f"all readings against {join_words(list(given))}", np.arange(values.shape[1]), values, True)


def _scale_instruments(kinds: Mapping[str, list[int]], channels: Sequence[Channel], values: Array) -> Iterator[Cause]:
    """Yield kinds of one unit that belong together, as ``cam_x`` and ``cam_y`` do, or all of them, in another unit."""
    groups: dict[tuple[int, ...], list[str]] = {}
    first = {kind: channels[places[0]] for kind, places in kinds.items()}
    for unit in dict.fromkeys(one.unit for one in channels):
        alike = [kind for kind in kinds if first[kind].unit == unit]
        stems = dict.fromkeys(kind.rpartition("_")[0] for kind in alike if "_" in kind)
        outside = [kind for kind in alike if first[kind].external]
        for some in [[kind for kind in alike if kind.rpartition("_")[0] == stem] for stem in stems] + [outside, alike]:
            if len(some) > 1:
                groups[tuple(k for kind in some for k in kinds[kind])] = some
    for places, some in groups.items():
        yield from _scale(join_words(some), np.array(places), channels[places[0]].unit, values)


def _move(text: str, values: Array, places: np.ndarray, source: np.ndarray) -> Cause:
    moved = values.copy()
    moved[:, places] = values[:, source]
    return Cause(LEGS, text, RowReadings(moved, np.arange(len(values))))


def _scale(name: str, columns: np.ndarray, unit: str, values: Array) -> Iterator[Cause]:
    """Yield columns as if they had another unit; of no unit as if they were of another gear."""
    for words, factor in {"mm": LENGTHS, "rad": ANGLES, "": GEARS}.get(unit, {"of the other sign": -1.0}).items():
        yield _scale_about(f"readings of {name} seem to be {words}", values, columns, factor, 0.0)


def _scale_about(
    text: str, values: Array, columns: Sequence[int] | np.ndarray, factor: float, zero: Array | float
) -> Cause:
    moved = values.copy()
    moved[:, columns] = zero + factor * (values[:, columns] - zero)
    volume = int(np.isfinite(values[:, columns]).sum()) * float(np.log(abs(factor)))
    return Cause(UNIT, text, RowReadings(moved, np.arange(len(values)), log_volume=volume))


def _shift(name: str, columns: np.ndarray, values: Array, together: bool = False) -> Iterator[Cause]:
    """Yield some columns as if they stood a row too early or too late; all of them only ``together``."""
    if len(values) < 3 or (len(columns) == values.shape[1] and not together):
        return
    for step, words in ((1, "later"), (-1, "earlier")):
        moved = values.copy()
        moved[:, columns] = np.roll(values[:, columns], step, axis=0)
        there = np.arange(len(values))[slice(1, None) if step > 0 else slice(None, -1)]
        text = f"rows of {name} seem shifted by one, readings of the row {words}"
        yield Cause(ROWS, text, RowReadings(moved[there], there))


def _list_blind(readings: VariantReadings) -> Iterator[Cause]:
    """Yield readings of which one channel has nothing to do with the pose: normal about its mean, as wide as it is."""
    values, sd, channels = readings.values, readings.posterior.likelihood.data.sd, readings.channels
    n_spare = int(np.median(readings.posterior.likelihood.n_spare))
    for k, one in enumerate(channels):
        there = np.isfinite(values[:, k])
        if there.sum() < 3:
            continue
        steady = bool(np.ptp(values[there, k]) <= STEADY * float(np.median(sd[there, k])))
        # of a rotation vector, which is compared as a whole, a component or, where turns are large, all of them
        whole = tuple(j for j, other in enumerate(channels) if one.rotation and other.rotation == one.rotation)
        for alike in dict.fromkeys(((k,), whole or (k,))):
            seen = np.isfinite(values[:, alike])
            noise = np.nanmedian(sd[:, alike], axis=0)
            if n_spare <= len(alike) or not noise.all():  # the others have to contradict it, and it has to have noise
                continue
            width = np.maximum(np.nanstd(values[:, alike], axis=0) / noise, 1.0)
            volume = float(np.sum(seen * (np.log(WIDE_PRIOR_SD / width) - 0.5)))
            table = RowReadings(values, np.arange(len(values)), vague=alike, log_volume=volume)
            yield Cause(CHANNEL, "", table, blind=k, say=partial(_say_blind, readings, one, values[:, k], steady))


def _say_blind(readings: VariantReadings, channel: Channel, measured: Array, steady: bool, expected: Array) -> str:
    """Return what a channel reads that the others contradict: always the same, all shifted alike, or anything."""
    good = np.isfinite(measured) & np.isfinite(expected)
    said, unit = (
        f"readings of {channel.name} contradict the other channels, which agree",
        channel.unit,
    )
    if not good.any():
        return said
    measured, expected = measured[good], expected[good]
    if steady:
        return (
            f"{channel.name} does not move: it reads {format_in_unit(measured[0], unit)}, expected "
            f"{format_in_unit(expected.min(), unit)} to {format_in_unit(expected.max(), unit)}"
        )
    off = measured - expected
    middle = float(np.median(off))
    if abs(middle) > SHIFTED * float(np.median(np.abs(off - middle))):
        return _say_zero(channel, np.array([middle]))
    apart, moved = measured - measured.mean(), expected - expected.mean()
    slope = float(moved @ apart) / max(float(moved @ moved), 1e-300)
    left = float(np.median(np.abs(apart - slope * moved)))
    if np.ptp(off) > SHIFTED * left and abs(slope) > 0.01:
        return _say_scale(readings, channel, np.array([1.0 - 1.0 / slope]))
    return said


def _list_displacements(readings: VariantReadings) -> Iterator[Cause]:
    """Yield readings of the machine's own channels in other units as they are counted from home, or not counted."""
    values, channels, home = readings.values, readings.channels, readings.home
    for kind in dict.fromkeys(one.kind for one in channels if not one.external):
        own = [k for k, one in enumerate(channels) if one.kind == kind]
        if not np.isfinite(home[own]).all() or not np.abs(home[own]).max() > 0.0:
            continue
        for words, factor in {"mm": LENGTHS, "rad": ANGLES}.get(channels[own[0]].unit, {}).items():
            text = f"displacements of {kind} from home seem to be {words}"
            yield _scale_about(text, values, own, factor, home[own])
        moved = values.copy()
        moved[:, own] += home[own]
        text = f"displacements seem to be given instead of positions of {kind}"
        yield Cause(UNIT, text, RowReadings(moved, np.arange(len(values))))


def _list_rereads(readings: VariantReadings) -> Iterator[Cause]:
    """Yield poses that an instrument hands out, read in other ways: angles, frames seen from the other side."""
    values, every = readings.values, np.arange(len(readings.values))
    external = [(k, one) for k, one in enumerate(readings.channels) if one.external]
    lengths, turned = ([k for k, one in external if one.unit == "mm"], [k for k, one in external if one.rotation])
    whole = np.isfinite(values[:, lengths + turned]).all(axis=1)
    if len(lengths) != 3 or len(turned) != 3 or not whole.any():
        return
    seen = values[whole]
    for text, position, rotation in list_rereads(seen[:, lengths], matrix_from_rotation_vector(seen[:, turned])):
        moved = values.copy()
        moved[np.ix_(whole, lengths)], moved[np.ix_(whole, turned)] = position, rotation_vector_from_matrix(rotation)
        yield Cause(POSES, text, RowReadings(moved, every))
    for words, factor in ANGLES.items():
        text = f"rotations seem to be {('inverted' if factor < 0.0 else words)}"
        yield _scale_about(text, values, turned, factor, 0.0)


def list_rereads(position: Array, rotation: Array) -> Iterator[tuple[str, Array, Array]]:
    """Yield what may have happened to poses (P, 3) and (P, 3, 3), in words, and the poses without it."""
    vectors = rotation_vector_from_matrix(rotation)
    for axes in permutations(FIXED):
        order = [FIXED.index(axis) for axis in axes]
        yield (
            _describe_angles("".join(axes)),
            position,
            Rotation.from_euler("".join(axes), vectors[:, order]).as_matrix(),
        )
    back = np.swapaxes(rotation, 1, 2)
    yield "rotations seem to be those of the base in the platform", position, back
    seen = -np.einsum("pij,pj->pi", back, position)
    yield "poses seem to be those of the base in the platform", seen, back
    for k, axis in enumerate(FIXED):
        mirror = np.where(np.arange(3) == k, -1.0, 1.0)
        text = f"poses seem left-handed, {axis} of the other sign"
        yield text, position * mirror, mirror[:, None] * rotation * mirror


def _describe_angles(axes: str) -> str:
    columns = ROLL_PITCH_YAW if axes == FIXED else name_angles(axes)
    return (
        f"rx_deg, ry_deg and rz_deg seem to be angles about the fixed axes {', '.join(axes)}: call "
        f"them {', '.join(columns)}" + ("" if axes == FIXED else ", in that order")
    )


# --- noises, tolerances, single channels -----------------------------------------------------------------------------


def _group(channels: Sequence[Channel]) -> dict[str, tuple[int, ...]]:
    """Return channels that may have something in common: kinds, instruments, one unit of an instrument."""
    found: dict[str, list[int]] = {}
    for k, one in enumerate(channels):
        found.setdefault(one.kind, []).append(k)
    for external in (False, True):
        own = [k for k, one in enumerate(channels) if one.external == external]
        for unit in dict.fromkeys(channels[k].unit for k in own):
            alike = [k for k in own if channels[k].unit == unit]
            found[join_words(list(dict.fromkeys(channels[k].kind for k in alike)))] = alike
        found[join_words(list(dict.fromkeys(channels[k].kind for k in own)))] = own
    found["all channels"] = list(range(len(channels)))
    return {name: tuple(places) for name, places in found.items() if places}


def _list_noises(channels: Sequence[Channel]) -> Iterator[Cause]:
    groups = _group(channels)
    for k, one in enumerate(channels):
        groups.setdefault(one.name, (k,))
    for name, places in groups.items():
        scope = "one" if len(places) == 1 else "all" if len(places) == len(channels) else "some"
        yield Cause(NOISE, "", noise=places, say=partial(_say_noise, name), scope=scope)


def _say_noise(name: str, size: Array) -> str:
    advice = ", or leave it free" if size[0] > 1.0 else "; perhaps rows are averages"
    times = format_significant(float(size[0]), 2)
    return f"the noise of {name} is about {times} times the stated one: state it so{advice}"


def _list_tolerances(readings: VariantReadings) -> Iterator[Cause]:
    """Yield tolerances of single parameters, of those of one letter, of letters of one body, and of all.

    Too wide are those of the machine alone: nobody states where an instrument stands better than it is known.
    """
    sampling, model = readings.posterior.sampling, readings.model
    names, n_own = sampling.names, model.bare.layout.size
    of_machine = np.asarray(sampling.free) < n_own
    symbols: dict[str, list[int]] = {}
    for k, name in enumerate(names):
        symbols.setdefault(name.partition("[")[0], []).append(k)
    bodies: dict[str, list[str]] = {}
    for symbol in symbols:
        bodies.setdefault(symbol.partition("_")[0], []).append(symbol)
    groups: dict[tuple[int, ...], tuple[str, str]] = {(k,): ("one", name) for k, name in enumerate(names)}
    for symbol, own in symbols.items():
        groups.setdefault(tuple(own), ("letter", f"all {symbol}"))
    for body in bodies.values():
        for n, scope in ((2, "two letters"), (len(body), "body")):
            for some in combinations(body, n):
                every = tuple(k for one in some for k in symbols[one])
                groups.setdefault(every, (scope, f"all {join_words(list(some))}"))
    groups.setdefault(tuple(range(len(names))), ("all", "all parameters"))
    for places, (scope, which) in groups.items():
        say = partial(_say_tolerance, which)
        yield Cause(TOLERANCE, "", toleranced=places, factors=WIDER, say=say, scope=scope)
        narrowed = tuple(k for k in places if of_machine[k])
        if len(narrowed) > 1 and (
            len(narrowed) == len(places) or scope == "all"
        ):  # a single one is as drawn now and then
            yield Cause(WIDE, "", toleranced=narrowed, factors=NARROWER, say=say, scope=scope)


def _say_tolerance(which: str, size: Array) -> str:
    times = format_significant(float(max(size[0], 1.0 / size[0])), 2)
    if size[0] < 1.0:
        return f"the tolerance of {which} is about {times} times too wide: state narrower ones"
    return f"the tolerance of {which} is about {times} times too tight: state wider ones"


def _list_couplings(readings: VariantReadings) -> Iterator[Cause]:
    """Yield errors of the machine's own channels in proportion to the travel of all of them, as eq. 4 of RR-8096."""
    own = [k for k in np.flatnonzero(readings.internal) if np.isfinite(readings.values[:, k]).all()]
    if len(own) < 2:
        return
    values = readings.values[:, own]
    travel = values - values.mean(axis=0)
    columns = np.zeros((*readings.values.shape, len(own), len(own)))
    for unit in dict.fromkeys(readings.channels[k].unit for k in own):
        alike = [i for i, k in enumerate(own) if readings.channels[k].unit == unit]
        for i in alike:
            columns[:, own[i], i, alike] = travel[:, alike]
    names = join_words(list(dict.fromkeys(readings.channels[k].kind for k in own)))
    text = f"{names} err in proportion to travel: add a deformation, or use all [model_error] terms"
    yield Cause(MODEL, text, columns=columns.reshape(*readings.values.shape, -1), most=COUPLED)


def _list_channels(readings: VariantReadings) -> Iterator[Cause]:
    """Yield another zero of single channels, another scale, about their own zero or about their mean, and drifts."""
    values, ones = readings.values, np.ones(len(readings.values))
    yield from _list_common_zeros(readings)
    for k, one in enumerate(readings.channels):
        finite = np.isfinite(values[:, k])
        if finite.sum() < 3:
            continue

        def show(*shapes: Array, k: int = k) -> Array:
            columns = np.zeros((*values.shape, len(shapes)))
            columns[:, k] = np.stack(shapes, axis=-1)
            return columns

        mean, spread = np.mean(values[finite, k]), np.ptp(values[finite, k])
        scaled = partial(_say_scale, readings, one)
        yield Cause(CHANNEL, "", columns=show(ones), say=partial(_say_zero, one))
        yield Cause(CHANNEL, "", columns=show(np.where(finite, values[:, k], 0.0)), say=scaled, scaled=k)
        if abs(mean) > 0.1 * spread:
            yield Cause(CHANNEL, "", columns=show(np.where(finite, values[:, k] - mean, 0.0)), say=scaled, scaled=k)
        # whatever it was when the first row was measured
        yield Cause(DRIFT, "", columns=show(readings.time, ones), say=partial(_say_drift, one))


def _list_common_zeros(readings: VariantReadings) -> Iterator[Cause]:
    """Yield one other zero of all of the machine's own channels of a kind, as of legs homed somewhere else."""
    kinds = np.array([one.kind if one.name != one.kind and not one.external else "" for one in readings.channels])
    for kind in dict.fromkeys(kinds):
        own = kinds == kind
        if kind and own.sum() > 1:
            columns = np.broadcast_to(own[:, None], (*readings.values.shape, 1)).astype(float)
            every = Channel(f"all {kind}", readings.channels[int(np.argmax(own))].unit)
            yield Cause(CHANNEL, "", columns=columns, say=partial(_say_zero, every), scope="kind")


def _say_zero(channel: Channel, size: Array) -> str:
    amount = format_in_unit(size[0], channel.unit, "+")
    return f"readings of {channel.name} seem to have another zero, {amount} off in all rows"


def _say_scale(readings: VariantReadings, channel: Channel, size: Array) -> str:
    factor = 1.0 / (1.0 - size[0]) if size[0] != 1.0 else np.inf
    gain = find_gains(readings.model).get(channel.name)
    free = readings.posterior.sampling.names
    advice = ""
    if gain is not None:
        advice = f": widen the prior of {gain}" if gain in free else f": correct them, or free {gain} in [parameters]"
    return f"readings of {channel.name} seem to be {factor:.4g} times the expected ones{advice}"


def _say_drift(channel: Channel, size: Array) -> str:
    return (
        f"readings of {channel.name} drift by {format_in_unit(size[0], channel.unit)}: correct them, "
        "or keep drift in [model_error]"
    )


def format_in_unit(value: float, unit: str, sign: str = "") -> str:
    """Return a value of a channel with its unit; angles in degrees."""
    return f"{np.degrees(value):{sign}.3g}°" if unit == "rad" else f"{value:{sign}.3g} {unit}"


# --- frames ----------------------------------------------------------------------------------------------------------


def _list_frames(readings: VariantReadings, pose: Array) -> Iterator[Cause]:
    for name, columns in _find_frames(readings, pose).items():
        yield Cause(FRAME, "", columns=columns, say=partial(_say_frame, name))
        drifting = columns * readings.time[:, None, None]
        yield Cause(DRIFT, "", columns=drifting, say=partial(_say_moving_frame, name))


def _say_frame(name: str, size: Array) -> str:
    said = [f"{format_significant(float(np.linalg.norm(size[:3])), 2)} mm"]
    if len(size) > 3:
        said.append(f"{np.degrees(np.linalg.norm(size[3:])):.2g}°")
    return (
        f"the poses seem to be in a {name} frame {' and '.join(said)} off: free frames.{name} of its table, or give it"
    )


def _say_moving_frame(name: str, size: Array) -> str:
    return f"the {name} frame drifts by {1000.0 * float(np.linalg.norm(size[:3])):.2g} µm"


def _find_frames(readings: VariantReadings, pose: Array) -> dict[str, Array]:
    """Return what motions of base and tool, 3 in mm and 3 in rad, do to what instruments read, (P, K, 6)."""
    likelihood, whole = readings.posterior.likelihood, readings.model
    external = ~readings.internal
    bare = InstrumentedMachine(whole.bare, ())
    if not external.any() or not whole.places_tool:
        return {}
    theta = readings.posterior.theta(readings.posterior.begin)
    own = theta[: bare.whole.layout.size]
    with np.errstate(all="ignore"):
        tool, by_pose, _ = bare.linearise_tool(own, pose, False)
        read = whole.linearise(theta, pose, False, likelihood.data.given)
    seen = likelihood.comparison.pull_back(np.zeros_like(read.values), read.values, read.by_pose)
    seen = np.where(external[:, None], seen, 0.0)
    by_pose = np.nan_to_num(by_pose)
    by_pose[:, 3:] = compute_left_jacobian(np.nan_to_num(tool[:, 3:])) @ by_pose[:, 3:]
    rows = np.flatnonzero(np.abs(by_pose).max(axis=(0, 2)) > 0.0)
    back = np.nan_to_num(seen) @ np.linalg.pinv(by_pose[:, rows])
    full = np.zeros((len(pose), len(whole.channels), 6))
    full[..., rows] = back
    motion = np.tile(np.eye(6), (len(pose), 1, 1))
    motion[:, :3, 3:] = -skew_matrix(np.nan_to_num(tool[:, :3]))
    found = {"base": full @ motion}
    if {3, 4, 5} <= set(rows.tolist()):
        turn = bare.rotation_in_space(pose)
        motion = np.zeros((len(pose), 6, 6))
        motion[:, :3, :3] = motion[:, 3:, 3:] = turn
        found["tool"] = full @ motion
    return found
