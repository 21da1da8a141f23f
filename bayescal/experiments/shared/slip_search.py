"""One search for what may have happened to readings, whatever the machine: causes compete by the same log-density.

All causes are weighed about the machine as expected first, with a factor on all noise for what the first order leaves;
the best of each kind are fitted, machine and cause together, and weighed again about their own fit. Each kind of cause
is as probable as every other one a priori, and so is each cause within its kind.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Collection, Iterator
from dataclasses import dataclass, field, replace

import numpy as np

from bayescal.data.measured_poses import MeasuredPoses
from bayescal.experiments.shared.measured import MeasuredReadings
from bayescal.experiments.shared.slip_rows import STARTS, Readings, Sight, Table, White, profile
from bayescal.experiments.shared.slips import (
    ANGLES,
    CHANNEL,
    LENGTHS,
    POSES,
    ROWS,
    UNIT,
    Columns,
    list_reading_slips,
    list_rereads,
)
from bayescal.machines.readings.placed import Placed
from bayescal.numerics.geometry import (
    Array,
    compute_left_jacobian,
    matrix_from_rotation_vector,
    rotation_vector_from_matrix,
    skew_matrix,
)
from bayescal.report.numbers import format_significant, join_words

FRAME, NOISE, TOLERANCE, DRIFT = "frame", "noise", "tolerance", "drift"
SURE = 10.0
"""Nats by which a cause has to explain the readings better, all that were tried counted."""
ALIKE = 3.0
"""Nats below the best cause within which another is named with it."""
SLOPS = np.array([1.0, 1.5, 2.5, 5.0, 10.0, 30.0, 100.0, 1e3, 1e4])
"""Factors on all noise about the machine as expected, for what the first order leaves."""
FACTORS = np.array([0.05, 0.1, 0.15, 0.2, 0.3, 0.5, 2.0, 3.0, 4.0, 5.0, 7.0, 10.0, 20.0, 50.0, 100.0, 1e3, 1e4])
BESIDE = 2  # how many factors on either side of the best one are tried as errors change
USUAL_FACTOR = 1.5  # sd of the logarithm of a factor on the noise
FINAL, EACH = 8, 3  # causes that are fitted: of all, and of each kind
FITS_WELL, HOPELESS = 1.2, 300.0  # rms of a cause that leaves little, and nats below it of what is not fitted then
FITS = 3  # steps of a fit
TOGETHER = 100  # tables that are looked at at once
MOST_ROWS = 10  # of which other tables are tried first
MISFIT = 1.4
"""Rms of the rows in their noise below which no other table is tried."""
UNFIT = -1e9  # log-density of readings that no machine has at all
PATIENCE = 60.0  # s of CPU time after which no more causes are tried


@dataclass(frozen=True, eq=False)
class Cause:
    """What may have happened: readings as they would be without it, columns, a noise, rows that do not count.

    Attributes
    ----------
    say : callable
        From the sizes of its columns' unknowns (k,) to words.
    """

    fault: str
    text: str
    table: Table | None = None
    columns: Array | None = None  # (P, K, k)
    wider: tuple[int, ...] = ()  # parameters whose tolerance is too tight, by their places
    noise: tuple[int, ...] = ()  # channels whose noise is another one
    without: tuple[int, ...] = ()  # rows
    say: Callable[[Array], str] | None = None


@dataclass(frozen=True, eq=False)
class Weighed:
    """A cause, by how many nats it explains the readings better, all that were tried counted, and its words."""

    cause: Cause
    gain: float
    text: str
    misfit: float


@dataclass(frozen=True)
class Named:
    """What is named first: the best cause and those alike, the gain, and the nats between them and the next one."""

    fault: str
    faults: tuple[str, ...]
    text: str
    gain: float
    odds: float
    rival: str
    misfit: float


@dataclass(frozen=True, eq=False)
class Search:
    """What a search found: what is named first, all that was fitted, how many were tried, whether time ran out.

    Of slips planted in data that fit, ``unnoticed`` are those after which they fit all the same.
    """

    first: Named | None
    weighed: list[Weighed] = field(default_factory=list)
    tried: int = 0
    stopped: bool = False
    unnoticed: list[str] = field(default_factory=list)


def search_cause(measured: MeasuredReadings, denied: Collection[str] = ()) -> Search:
    """Return what explains readings better than they are explained as they stand."""
    return _Search(Readings(measured.posterior, measured.low, measured.high), measured.internal, denied).run()


@dataclass(eq=False)
class _Search:
    readings: Readings
    internal: np.ndarray
    denied: Collection[str]
    began: float = field(default_factory=time.process_time)

    def __post_init__(self) -> None:
        self.posterior = self.readings.posterior
        self.model = self.posterior.likelihood.model
        self.m, self.n_errors = self.posterior.n_geometry, self.posterior.errors.n_parameters
        self.zeta = np.zeros(self.n_errors)
        n = len(self.readings.values)
        self.some = np.zeros(n, dtype=bool)
        self.some[np.unique(np.linspace(0, n - 1, min(MOST_ROWS, n)).astype(int))] = True

    @property
    def is_late(self) -> bool:
        return time.process_time() - self.began > PATIENCE

    def run(self) -> Search:
        here = self.readings.see(self.readings.table, np.zeros(self.m), None, STARTS)
        if here is None:
            return Search(None)
        base = self.fit(Cause("", ""), here)
        causes = [*self._list_effects(here)]
        rough = self._weigh_effects(here, causes)
        fits = base is not None and base[1] < MISFIT and bool(here.stands.all())
        tables = self._weigh_tables(here)
        if not fits:
            rough += tables
        chosen = self._choose([one for one in rough if one[0].fault not in self.denied])
        counts = {fault: sum(one[0].fault == fault for one in rough) for fault in {one[0].fault for one in rough}}
        weighed = []
        as_is = UNFIT if base is None or not np.isfinite(base[0]) else base[0]
        bound = -np.inf
        for cause, promise in chosen:
            if self.is_late:
                break
            if promise < bound:
                continue
            found = self.fit(cause, here)
            if found is not None and np.isfinite(found[0]):
                value, misfit, text = found
                weighed.append(Weighed(cause, value - as_is - float(np.log(counts[cause.fault])), text, misfit))
                bound = max(bound, promise - HOPELESS) if misfit < FITS_WELL else bound
        weighed.sort(key=lambda one: -one.gain)
        unnoticed = [cause.text for cause, value in tables if fits and value > -SURE]
        return Search(self._name(weighed), weighed, len(causes) + len(tables), self.is_late, unnoticed)

    def _name(self, weighed: list[Weighed]) -> Named | None:
        best = [one for one in weighed if one.gain > SURE]
        if not best:
            return None
        alike = [one for one in best if one.gain > best[0].gain - ALIKE]
        others = [one for one in weighed if one not in alike]
        rival = max(others[0].gain, 0.0) if others else 0.0
        text = best[0].text + "".join(f" (or: {one.text})" for one in alike[1:3])
        faults = tuple(dict.fromkeys(one.cause.fault for one in alike[:3]))
        said = others[0].text if others and others[0].gain > 0.0 else "the data as they are"
        return Named(best[0].cause.fault, faults, text, best[0].gain, alike[-1].gain - rival, said, best[0].misfit)

    # --- first round -------------------------------------------------------------------------------------------------

    def _choose(self, rough: list[tuple[Cause, float]]) -> list[tuple[Cause, float]]:
        """Return the best causes of all and of each kind, the best first."""
        rough.sort(key=lambda one: -one[1])
        chosen = rough[:FINAL]
        for fault in dict.fromkeys(one[0].fault for one in rough):
            chosen += [one for one in rough if one[0].fault == fault][:EACH]
        return sorted({id(one[0]): one for one in chosen}.values(), key=lambda one: -one[1])

    def _weigh_effects(self, here: Sight, causes: list[Cause]) -> list[tuple[Cause, float]]:
        """Return causes that do not change the table with their log-densities less that of no cause."""
        widths = [0 if one.columns is None else one.columns.shape[-1] for one in causes]
        ends = np.cumsum([0, *widths])
        p, k = self.readings.values.shape
        every = np.concatenate([np.zeros((p, k, 0)), *(one.columns for one in causes if one.columns is not None)], -1)
        bases = np.array([here.whiten(self.zeta, slop).weigh() for slop in SLOPS])
        slops = np.unique([0, max(int(bases.argmax()) - 1, 0), bases.argmax()])
        whites, bases = [here.whiten(self.zeta, slop, every) for slop in SLOPS[slops]], bases[slops]
        values = np.full((len(causes), len(slops)), -np.inf)
        for i, cause in enumerate(causes):
            for j, white in enumerate(whites):
                if cause.columns is not None:
                    where = white.known + np.arange(ends[i], ends[i + 1])
                    values[i, j] = bases[j] + white.gain(where)[0]
                elif cause.wider:
                    values[i, j] = bases[j] + white.gain(np.array(cause.wider), wider=True)[0]
                elif cause.without:
                    values[i, j] = self._leave_out(white, np.array(cause.without))
            if cause.noise:
                values[i, 0] = self._try_noise(here, cause, self.zeta)[0]
        gains = values.max(axis=1) - bases.max()
        return list(zip(causes, gains.tolist(), strict=True))

    def _leave_out(self, white: White, rows: np.ndarray) -> float:
        """Return the log-density where some rows may be anything."""
        kept = np.ones(len(white.rows), dtype=bool)
        kept[rows] = False
        n = white.rows.shape[1]
        size = np.sqrt(np.mean(white.rows[rows, :, -1] ** 2, axis=1))
        broad = white.constant[rows] - n * (np.log(np.maximum(size, 1.0)) + 0.5)
        return white.weigh(white.by_row[kept].sum(axis=0), float(white.constant[kept].sum() + broad.sum()))

    def _try_noise(self, here: Sight, cause: Cause, zeta: Array, sizes: Array = FACTORS) -> tuple[float, float]:
        """Return the log-density by the best of some factors on some channels' noise, and that.

        The prior of a factor is log-normal.
        """
        found = []
        for size in sizes:
            factor = np.ones(len(self.model.channels))
            factor[list(cause.noise)] = size
            more = -0.5 * (np.log(size) / USUAL_FACTOR) ** 2
            found.append((here.whiten(zeta, factor).weigh() + float(more - np.log(len(FACTORS))), float(size)))
        return max(found)

    def _weigh_tables(self, here: Sight) -> list[tuple[Cause, float]]:
        """Return causes that change the table, by some of the rows, and by how much better these are."""
        causes = [Cause("", "", table=self.readings.table), *self._list_tables()]
        tables = [one.table.pick(self.some) for one in causes if one.table is not None]
        seen: list[Sight | None] = [None] * len(causes)
        for circular in dict.fromkeys(one.circular for one in tables):
            places = [k for k, one in enumerate(tables) if one.circular == circular]
            for start in range(0, len(places), TOGETHER):
                if not self.is_late:
                    some = places[start : start + TOGETHER]
                    for k, one in zip(some, self._see_together([tables[k] for k in some], here), strict=True):
                        seen[k] = one
        share = len(self.some) / max(int(self.some.sum()), 1)
        values = np.full(len(causes), -np.inf)
        for slop in SLOPS:
            for k, one in enumerate(seen):
                if one is not None and one.stands.any():
                    missing = int(self.some.sum()) - len(one.rows)
                    values[k] = max(values[k], one.whiten(self.zeta, slop).weigh() - missing * self._row_cost(here))
        usual = values[0] if np.isfinite(values[0]) else UNFIT
        rough = [(one, share * float(value - usual)) for one, value in zip(causes, values, strict=True)]
        return [*rough[1:], *self._weigh_shifts(here)]

    def _see_together(self, tables: list[Table], here: Sight) -> list[Sight | None]:
        """Return what is seen of tables that are looked at one below the other."""
        values, rows = (np.concatenate([getattr(one, key) for one in tables]) for key in ("values", "rows"))
        every = self.readings.see(Table(values, rows, tables[0].circular), np.zeros(self.m), here.pose, 2)
        return [None] * len(tables) if every is None else list(every.split(tables))

    def _weigh_shifts(self, here: Sight) -> list[tuple[Cause, float]]:
        """Return rows that are shifted by one against the machine's own channels from some place on."""
        values, own = self.readings.values, np.flatnonzero(self.internal)
        n, found = len(values), list[tuple[Cause, float]]()
        kinds = join_words(list(dict.fromkeys(self.model.channels[k].kind for k in own)))
        if n < 4 or not len(own) or len(own) == values.shape[1]:
            return found
        usual = max(here.whiten(self.zeta, slop).weigh() for slop in SLOPS)
        for step in (1, -1):  # rows hold what belongs to the one before them, or after them
            chosen = np.arange(n - 1) if step > 0 else np.arange(1, n)
            moved = values.copy()
            moved[np.ix_(chosen, own)] = values[np.ix_(chosen + step, own)]
            seen = self.readings.see(Table(moved[chosen], chosen), np.zeros(self.m), here.pose, 3)
            if seen is None:
                continue
            mine, common = here.share(seen, self.zeta)
            both = [
                (here.whiten(self.zeta, slop, common=mine), seen.whiten(self.zeta, slop, common=common))
                for slop in SLOPS
            ]
            for k in range(1, n - 1):
                there = chosen >= k if step > 0 else chosen <= k
                value = max(self._splice(base, white, chosen[~there], there) for base, white in both)
                table = values.copy()
                table[chosen[there]] = moved[chosen[there]]
                where = "from" if step > 0 else "up to"
                text = f"rows of {kinds} seem to be shifted by one {where} row {k + 1}: correct the table"
                cause = Cause(ROWS, text, Table(table[chosen], chosen))
                found.append((cause, value - self._row_cost(here) - usual))
        return found

    def _splice(self, base: White, white: White, kept: np.ndarray, there: np.ndarray) -> float:
        """Return the log-density of some rows of one table with some of another."""
        gram = base.by_row[kept].sum(axis=0) + white.by_row[there].sum(axis=0)
        return base.weigh(gram, float(base.constant[kept].sum() + white.constant[there].sum()))

    def _row_cost(self, here: Sight) -> float:
        """Return what a row of a table counts that is not there, like one that may be anything, negative."""
        white = here.whiten(self.zeta)
        return -float(np.median(white.constant)) + white.rows.shape[1] * float(np.log(1e3))

    # --- second round ------------------------------------------------------------------------------------------------

    def fit(self, cause: Cause, here: Sight) -> tuple[float, float, str] | None:
        """Return a cause's log-density about its own fit, the rms that it leaves, and its words."""
        table = cause.table or self.readings.table
        y, unknown, zeta, start = np.zeros(self.m), np.zeros(0), self.zeta, here.pose
        size, value, misfit = 0.0, -np.inf, np.inf
        columns = cause.columns
        unknown = np.zeros(0 if columns is None else columns.shape[-1])
        for step in range(FITS):
            values = table.values if columns is None else self._take_away(table, columns @ unknown)
            seen = self.readings.see(replace(table, values=values), y, start, 0 if step else 3)
            if seen is None or not seen.stands.any():
                break  # steps that lead away: as good as the last one
            if columns is not None:
                moved = seen.linear.left @ (columns @ unknown)[table.rows][..., None]
                seen = replace(seen, errors=seen.errors + moved[..., 0])
            start = here.pose.copy()
            start[table.rows] = np.where(np.isfinite(seen.pose), seen.pose, start[table.rows])
            weigh = self._weigher(cause, seen, columns)
            if step in (0, FITS - 1):
                zeta, _ = profile(lambda z: weigh(z)[0], self.n_errors)  # noqa: B023
            value, y, unknown, size, misfit = weigh(zeta)
            value -= 0.5 * float(zeta @ zeta)
        if not np.isfinite(value):
            return None
        missing = len(self.readings.values) - len(table.rows)
        value -= missing * self._row_cost(here)
        text = cause.text if cause.say is None else cause.say(unknown if len(unknown) else np.array([size]))
        return value, misfit, text

    def _weigher(
        self, cause: Cause, seen: Sight, columns: Array | None
    ) -> Callable[[Array], tuple[float, Array, Array, float, float]]:
        """Return what takes ζ to log-density, white rows, machine, unknowns and size of a cause."""

        def weigh(zeta: Array) -> tuple[float, Array, Array, float, float]:
            which, size, nothing = np.empty(0, dtype=int), 0.0, np.zeros(0)
            if cause.noise:
                value, size = self._try_noise(seen, cause, zeta, near[-1])
                place = int(np.searchsorted(FACTORS, size))
                near.append(FACTORS[max(place - BESIDE, 0) : place + BESIDE + 1])
                factor = np.ones(len(self.model.channels))
                factor[list(cause.noise)] = size
                return value, *self._solve(seen.whiten(zeta, factor), which, nothing), size, 1.0
            white = seen.whiten(zeta, 1.0, columns)
            if cause.without:
                rows = np.flatnonzero(np.isin(seen.rows, cause.without))
                value = self._leave_out(white, rows)
                kept = np.setdiff1d(np.arange(len(seen.rows)), rows)
                white = White(white.rows[kept], white.constant[kept], white.known, white.log_volume)
            else:
                value = white.weigh()
            scale = nothing
            if cause.wider or columns is not None:
                which = np.array(cause.wider) if cause.wider else white.known + np.arange(widths)
                gain, size = white.gain(which, wider=bool(cause.wider))
                value += gain
                scale = np.full(len(which), np.sqrt(size**2 - 1.0)) if cause.wider else white.reduced[2][which] * size
            y, unknown = self._solve(white, which, scale)
            return value, y, unknown, size, white.misfit(y, which, unknown)

        widths, near = 0 if columns is None else columns.shape[-1], [FACTORS]
        return weigh

    def _solve(self, white: White, which: np.ndarray, scale: Array) -> tuple[Array, Array]:
        """Return machine (m,) and unknowns (k,) of columns with these standard deviations."""
        flat = white.rows.reshape(-1, white.rows.shape[-1])
        both = np.concatenate([flat[:, : white.known], flat[:, which] * scale], axis=1)
        found = np.linalg.solve(np.eye(both.shape[1]) + both.T @ both, both.T @ flat[:, -1])
        y, unknown = found[: self.m].copy(), found[white.known :] * scale
        inside = which < self.m  # of a tolerance
        y[which[inside]] += unknown[inside]
        return y, unknown[~inside]

    def _take_away(self, table: Table, effect: Array) -> Array:
        """Return a table's readings less an effect (P, K)."""
        comparison = self.posterior.likelihood.comparison
        return np.asarray(comparison.add(table.values, -effect[table.rows]))

    # --- causes ------------------------------------------------------------------------------------------------------

    def _list_effects(self, here: Sight) -> Iterator[Cause]:
        yield from self._list_frames(here)
        yield from self._list_noises()
        yield from self._list_channels()
        yield from self._list_tolerances()
        names = self.posterior.likelihood.data.poses
        if not self.posterior.errors.outliers.expected:
            for k, name in enumerate(names):
                text = (
                    f"row {k + 1} (pose {name!r}) does not belong to the others: look at its readings, or leave it out"
                )
                yield Cause(ROWS, text, without=(k,))

    def _groups(self) -> dict[str, list[int]]:
        """Return channels that may have something in common: kinds, instruments, one unit of an instrument."""
        found: dict[str, list[int]] = {}
        for k, one in enumerate(self.model.channels):
            found.setdefault(one.kind, []).append(k)
        for external in (False, True):
            own = [k for k, one in enumerate(self.model.channels) if one.external == external]
            for unit in dict.fromkeys(self.model.channels[k].unit for k in own):
                alike = [k for k in own if self.model.channels[k].unit == unit]
                found[join_words(list(dict.fromkeys(self.model.channels[k].kind for k in alike)))] = alike
            found[join_words(list(dict.fromkeys(self.model.channels[k].kind for k in own)))] = own
        found["all channels"] = list(range(len(self.model.channels)))
        return {name: places for name, places in found.items() if places}

    def _list_noises(self) -> Iterator[Cause]:
        singles = {one.name: [k] for k, one in enumerate(self.model.channels)}
        for name, places in (self._groups() | singles).items():

            def say(size: Array, name: str = name) -> str:
                return (
                    f"the noise of {name} is about {format_significant(float(size[0]), 2)} times the stated one: state "
                    "it so" + (", or leave it free" if size[0] > 1.0 else "; perhaps rows are averages")
                )

            yield Cause(NOISE, f"the noise of {name} is another one", noise=tuple(places), say=say)

    def _list_tolerances(self) -> Iterator[Cause]:
        names, units = self.posterior.sampling.names, self.posterior.sampling.units
        symbols: dict[str, list[int]] = {}
        for k, name in enumerate(names):
            symbols.setdefault(name.partition("[")[0], []).append(k)
        single = {name: (k,) for k, name in enumerate(names)}
        for name, places in (single | {one: tuple(of) for one, of in symbols.items() if len(of) > 1}).items():
            which = name if len(places) == 1 else f"all {name}"

            def say(size: Array, which: str = which) -> str:
                return f"the tolerance of {which} is about {size[0]:.0f} times too tight: widen its prior"

            yield Cause(TOLERANCE, f"the tolerance of {which} is too tight", wider=places, say=say)
        del units

    def _list_channels(self) -> Iterator[Cause]:
        values = self.readings.values
        time_ = self._measure_time()
        for k, one in enumerate(self.model.channels):
            column = np.zeros((*values.shape, 1))

            def with_column(shape: Array, k: int = k, column: Array = column) -> Array:
                made = column.copy()
                made[:, k, 0] = shape
                return made

            def zero(size: Array, one: object = one) -> str:
                return (
                    f"readings of {one.name} have another zero, {_in_unit(size[0], one.unit)} off in all rows: correct "  # type: ignore[attr-defined]
                    "them"
                )

            def scale(size: Array, one: object = one) -> str:
                factor = 1.0 / (1.0 - size[0]) if size[0] != 1.0 else np.inf
                return f"readings of {one.name} are {factor:.4g} times what they should be: correct them"  # type: ignore[attr-defined]

            def drift(size: Array, one: object = one) -> str:
                return (
                    f"readings of {one.name} drift by {_in_unit(size[0], one.unit)} from the first row to the "  # type: ignore[attr-defined]
                    "last: correct them, or give the error a function of time"
                )

            finite = np.isfinite(values[:, k])
            if finite.sum() < 3:
                continue
            spread = np.ptp(values[finite, k])
            yield Cause(CHANNEL, "", columns=with_column(np.ones(len(values))), say=zero)
            yield Cause(CHANNEL, "", columns=with_column(np.where(finite, values[:, k], 0.0)), say=scale)
            mean = np.where(finite, values[:, k] - np.mean(values[finite, k]), 0.0)
            if abs(np.mean(values[finite, k])) > 0.1 * spread:
                yield Cause(CHANNEL, "", columns=with_column(mean), say=scale)
            both = np.concatenate([with_column(time_), with_column(np.ones(len(values)))], axis=-1)
            yield Cause(DRIFT, "", columns=both, say=drift)  # whatever it was when the first row was measured

    def _measure_time(self) -> Array:
        """Return when rows were measured, from 0 to 1 by their order, (P,)."""
        order = self.posterior.likelihood.data.order
        return np.asarray((order - order.min()) / max(float(np.ptp(order)), 1.0))

    def _list_frames(self, here: Sight) -> Iterator[Cause]:
        frames = self._find_frames(here)
        time_ = self._measure_time()
        for name, columns in frames.items():

            def say(size: Array, name: str = name) -> str:
                said = [f"{format_significant(float(np.linalg.norm(size[:3])), 2)} mm"]
                if len(size) > 3:
                    said.append(f"{np.degrees(np.linalg.norm(size[3:])):.2g}°")
                return (
                    f"the poses look given in a {name} frame that is {' and '.join(said)} off: free [frames] {name}, "
                    "or give it"
                )

            def drift(size: Array, name: str = name) -> str:
                return (
                    f"the {name} frame drifts by {1e3 * float(np.linalg.norm(size[:3])):.2g} µm while rows are measured"
                )

            yield Cause(FRAME, "", columns=columns, say=say)
            yield Cause(DRIFT, "", columns=columns * time_[:, None, None], say=drift)

    def _find_frames(self, here: Sight) -> dict[str, Array]:
        """Return what motions of base and tool, 3 in mm and 3 in rad, do to what instruments read, (P, K, 6)."""
        likelihood, whole = self.posterior.likelihood, self.model
        external = ~self.internal
        bare = whole if isinstance(whole, Placed) else Placed(whole, ())
        if not external.any() or not whole.places_tool:
            return {}
        pose, theta = here.pose, self.posterior.sampling.start
        own = theta[: bare.whole.layout.size]
        with np.errstate(all="ignore"):
            tool, by_pose, _ = bare._linearise_tool(own, pose)
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

    def _list_tables(self) -> Iterator[Cause]:
        """Yield what may have happened to columns of numbers."""
        values, every = self.readings.values, np.arange(len(self.readings.values))
        units = [one.unit for one in self.model.channels]
        for slip in list_reading_slips(self.model.names, units, values, self.model.given, ~self.internal):
            chosen = every if slip.chosen is None else slip.chosen
            data: Columns = slip.data
            table = Table(data.values if len(data.values) == len(chosen) else data.values[chosen], chosen)
            yield Cause(slip.fault, slip.text, replace(table, circular=data.circular, log_volume=slip.log_volume))
        yield from self._list_frozen()
        yield from self._list_displacements()
        yield from self._list_rereads()

    def _list_frozen(self) -> Iterator[Cause]:
        """Yield readings without a channel that does not move: it lies about one number by its noise."""
        values, sd = self.readings.values, self.posterior.likelihood.data.sd
        for k, one in enumerate(self.model.channels):
            there = np.isfinite(values[:, k])
            if there.sum() < 3 or np.ptp(values[there, k]) > 2.0 * float(np.median(sd[there, k])):
                continue
            blind = values.copy()
            blind[:, k] = np.nan
            volume = -float(np.sum(np.log(sd[there, k]) + 0.5 * np.log(2.0 * np.pi) + 0.5))
            reads = _in_unit(float(values[there, k][0]), one.unit)
            text = f"{one.name} does not move: it reads {reads} in all rows; look at its sensor, or leave it out"
            yield Cause(CHANNEL, text, Table(blind, np.arange(len(values)), log_volume=volume))

    def _list_displacements(self) -> Iterator[Cause]:
        """Yield readings of the machine's own channels in other units as they are counted from home, or not counted."""
        values, every = self.readings.values, np.arange(len(self.readings.values))
        given = {name: value[:1] for name, value in self.posterior.likelihood.data.given.items()}
        home = self.model.read(self.posterior.sampling.start[None], self.model.home_pose[None], given)[0]
        channels = self.model.channels
        for kind in dict.fromkeys(one.kind for one in channels if not one.external):
            own = [k for k, one in enumerate(channels) if one.kind == kind]
            if not np.isfinite(home[own]).all() or not np.abs(home[own]).max() > 0.0:
                continue
            count = int(np.isfinite(values[:, own]).sum())
            for words, factor in {"mm": LENGTHS, "rad": ANGLES}.get(channels[own[0]].unit, {}).items():
                moved = values.copy()
                moved[:, own] = home[own] + factor * (values[:, own] - home[own])
                text, volume = f"displacements of {kind} from home seem to be {words}", count * np.log(abs(factor))
                yield Cause(UNIT, text, Table(moved, every, log_volume=float(volume)))
            moved = values.copy()
            moved[:, own] += home[own]
            yield Cause(UNIT, f"displacements seem to stand in place of positions of {kind}", Table(moved, every))

    def _list_rereads(self) -> Iterator[Cause]:
        """Yield poses that an instrument hands out, read in other ways: angles, frames seen from the other side."""
        values, external = self.readings.values, np.flatnonzero(~self.internal)
        lengths = [k for k in external if self.model.channels[k].unit == "mm"]
        turned = [k for k in external if self.model.channels[k].rotation]
        if len(lengths) != 3 or len(turned) != 3:
            return
        rotation = matrix_from_rotation_vector(values[:, turned])
        nothing = np.zeros((len(values), 6))
        names = self.posterior.likelihood.data.poses
        poses = MeasuredPoses(names, values[:, lengths], rotation, np.zeros((len(values), 6, 6)), nothing)
        for text, other in list_rereads(poses):
            moved = values.copy()
            moved[:, lengths], moved[:, turned] = other.position, rotation_vector_from_matrix(other.rotation)
            yield Cause(POSES, text, Table(moved, np.arange(len(values))))
        for words, factor in ANGLES.items():
            moved = values.copy()
            moved[:, turned] *= factor
            text = f"rotations of the poses seem to be {'inverted' if factor < 0.0 else words}"
            table = Table(moved, np.arange(len(values)), log_volume=3 * len(values) * float(np.log(abs(factor))))
            yield Cause(UNIT, text, table)


def _in_unit(value: float, unit: str) -> str:
    return f"{np.degrees(value):.3g}°" if unit == "rad" else f"{value:.3g} {unit}"


__all__ = ["CHANNEL", "DRIFT", "FRAME", "NOISE", "ROWS", "TOLERANCE", "UNIT", "Search", "search_cause"]
