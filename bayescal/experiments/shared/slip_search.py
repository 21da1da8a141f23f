"""One search for what may have happened to readings, whatever the machine: causes compete by the same log-density.

All causes are weighed about the machine as expected first, with a factor on all noise for what the first order leaves;
the best of each kind are fitted, machine and cause together, and weighed again about their own fit, the sizes of the
model error integrated for each by itself: what they are without a cause is no part of it. Each kind of cause is as
probable as every other one a priori, so is each way to choose of it (single ones, groups, all), and each cause within.

A check names the best cause, whatever it is. Elsewhere the data as they are have to be far from every machine within
the tolerances, the cause has to be a slip, and to bring them several times nearer: tolerances, noise and drifts
compete, and what they explain as well is no slip.
"""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import combinations

import numpy as np

from bayescal.density.calibration.model_error import GPTerm
from bayescal.density.calibration.terms import NoiseFactor
from bayescal.errors import NumericalError
from bayescal.experiments.shared.slip_causes import (
    FACTORS,
    MODEL,
    NOISE,
    TOLERANCE,
    WIDE,
    Cause,
    list_effects,
    list_tables,
)
from bayescal.experiments.shared.slip_cells import CellSearch, weigh_cells
from bayescal.experiments.shared.slip_rows import (
    OUTLYING,
    ROW_PENALTY_NAT,
    STARTS,
    LinearisedTable,
    RowReadings,
    VariantReadings,
    leave_out_drift,
    leave_out_outliers,
)
from bayescal.experiments.shared.slip_sizes import integrate_sizes, profile
from bayescal.experiments.shared.slip_splice import weigh_spliced
from bayescal.experiments.shared.slip_verdict import (
    BEYOND,
    MIN_CAUSE_GAIN_NAT,
    SLIPS,
    STATED,
    SURE_OF_SLIP,
    NamedCause,
    Rival,
    ScoredCause,
    Search,
)
from bayescal.experiments.shared.slip_weigher import CauseLikelihood, leave_out, weigh_noises
from bayescal.experiments.shared.slips import CHANNEL, ROWS, FoundSlip
from bayescal.numerics.geometry import Array
from bayescal.report.numbers import join_words

SURE_OF_MODEL = 10.0
"""The same of errors of the machine, which a model error allows for."""
UNSEEN = 10.0
"""Nats by which a slip planted in data that fit lowers the log-density at most, where the data do not show it."""
RIVAL_WITHIN_NAT = 3.0
"""Nats below the best cause within which another is named with it."""
MOST_ALIKE = 4
"""Causes that are named together: a leg's length, its actuator's zero and heights of its joints do the same."""
SLOPS = np.array([1.0, 2.5, 10.0, 100.0, 1e3, 1e4])
"""Factors on all noise about the machine as expected, for what the first order leaves."""
FINAL, EACH = 8, 3  # causes that are fitted: of all, and of each kind
INTEGRATED = 6  # fitted causes, the best ones, whose errors' sizes are integrated
QUIET = -2.0  # coordinate of a model error's size at which it explains next to nothing
MOST_OF_IT = 0.8  # of what errors in proportion to all travels explain, that one channel's gain explains alone
FITS_WELL, HOPELESS = 1.2, 8.0  # rms of a cause that leaves little, and nats a row below it of what is not fitted then
TURNS = 3  # of a noise's factor and of errors' sizes, each with the other held
FITS, MOST_FITS = 3, 8  # steps of a fit, and at most where the log-density still rises
SETTLED = 1.0  # nats by which it rises less
BATCH_SIZE = 100  # tables that are looked at at once
MOST_ROWS = 10  # of which other tables are tried first
MOST_FAR = 6  # rows far off of which two may be exchanged
MISFIT = 1.4
"""Rms of the rows in their noise below which no other table is tried."""
UNFIT = -1e9  # log-density of readings that no machine has at all
FEWEST = 3  # causes that are fitted, however long it takes
PATIENCE = 25.0  # s of CPU time after which no more causes are tried


def search_cause(readings: VariantReadings, denied: Collection[str] = ()) -> Search:
    """Return what explains readings better than they are explained as they stand.

    What drifts in measuring order is none of the machine's errors here, but a cause among the others.
    """
    return SlipSearch(leave_out_outliers(leave_out_drift(readings)), denied).run()


def find_slip(variants: Iterable[VariantReadings], denied: Collection[str] = ()) -> FoundSlip | None:
    """Return the slip that explains readings many times better than they are; None where none does.

    Of variants of the same readings the one that comes nearest is asked. Where it fits in noise and errors as stated,
    single cells, channels and frames alone may have slipped, by so much that the model error took it up.

    Parameters
    ----------
    variants : iterable of Readings
        The same measurements, or such of the same kind, under models one of which may be right.
    denied : collection of str, optional
        Faults that are none, as somebody says who looked.
    """
    return find_suspects(variants, denied)[0]


def find_suspects(
    variants: Iterable[VariantReadings], denied: Collection[str] = ()
) -> tuple[FoundSlip | None, list[Rival]]:
    """Return the same, and causes that were weighed, sure or not, the most probable first; see `find_slip`."""
    rivals = list[Rival]()
    groups: dict[tuple[tuple[str, ...], tuple[str, ...]], list[VariantReadings]] = {}
    for one in variants:
        names = tuple(channel.name for channel in one.channels)
        groups.setdefault((names, one.posterior.likelihood.data.poses), []).append(one)
    for group in groups.values():
        nearest = _find_nearest(group, denied)
        if nearest is None:
            continue
        found = nearest.run(briefly=nearest.misfit <= STATED)
        rivals += nearest.list_rivals(found.weighed)
        if found.slip is not None:
            return found.slip, rivals
    return None, sorted(rivals, key=lambda one: -one.value)


def _find_nearest(variants: Iterable[VariantReadings], denied: Collection[str]) -> SlipSearch | None:
    """Return the search of the variant that comes nearest to its readings; the first one that fits."""
    nearest: SlipSearch | None = None
    for one in variants:
        search = SlipSearch(leave_out_outliers(one), denied)
        # to first order about the machine as expected is enough where that fits: steps from there make it no worse
        if search.readings.measure_misfit() <= STATED or search.misfit <= STATED:
            return search
        if nearest is None or search.misfit < nearest.misfit:
            nearest = search
    return nearest


@dataclass(frozen=True, eq=False)
class CauseFit:
    """A cause about its own fit: log-density, rms in noise and errors as stated, words, errors' coordinates (n,).

    The log-density is the largest over the errors, or integrated over them, their prior included; ``beside`` is what it
    has for rows that the cause's table lacks.
    """

    value: float
    misfit: float
    text: str
    zeta: Array
    weigher: CauseLikelihood
    beside: float


@dataclass(eq=False)
class SlipSearch:
    """A search of one variant's readings, without faults that are denied; what is asked again is kept."""

    readings: VariantReadings
    denied: Collection[str]
    began: float = field(default_factory=time.process_time)

    def __post_init__(self) -> None:
        self.posterior = self.readings.posterior
        self.as_is: CauseFit | None = None  # set by a run
        self.m, self.zeta = self.posterior.n_geometry, np.zeros(self.posterior.errors.n_parameters)
        n = len(self.readings.values)
        self.some = np.zeros(n, dtype=bool)
        self.some[np.unique(np.linspace(0, n - 1, min(MOST_ROWS, n)).astype(int))] = True

    @property
    def is_late(self) -> bool:
        """Whether no more causes are tried."""
        return time.process_time() - self.began > PATIENCE

    @cached_property
    def here(self) -> LinearisedTable | None:
        """The readings about the machine as expected; None where they leave nothing over for a comparison."""
        if not (self.posterior.likelihood.n_spare > 0).any():
            return None
        return self.readings.see(self.readings.table, self.readings.begin, None, STARTS)

    @cached_property
    def _first(self) -> LinearisedTable | None:
        """The same from these poses on: every cause's first step that leaves the table as it is.

        Other places of the workspace led to none that were better.
        """
        assert self.here is not None
        return self.readings.see(self.readings.table, self.readings.begin, self.here.pose, 1)

    @cached_property
    def base(self) -> CauseFit | None:
        """The readings as they are, about their own fit."""
        return None if self.here is None else self.fit(Cause("", ""), self.here)

    @property
    def misfit(self) -> float:
        """Rms of what the best machine leaves of the readings as they are; infinite where it has none of them."""
        if self.here is None or self.base is None or not self.here.stands.any():
            return np.inf
        return self.base.misfit

    @cached_property
    def rms_without_model_error(self) -> float:
        """Rms of what the best machine leaves of the readings without a model error; infinite where it has none."""
        return np.inf if self.base is None else self.measure_without_model_error(self.base)

    def measure_without_model_error(self, found: CauseFit) -> float:
        """Return the rms that a fit leaves of the readings without a model error."""
        return found.weigher.measure_misfit(self._silence(found.zeta))

    @property
    def fits(self) -> bool:
        """Whether the readings fit as they are."""
        return self.misfit < MISFIT and self.here is not None and not bool(self.here.lost.any())

    @cached_property
    def own(self) -> tuple[np.ndarray, str]:
        """The machine's own channels, by their places, and what they are called; none where there are no others."""
        places = np.flatnonzero(self.readings.internal)
        places = places if len(places) < len(self.readings.internal) else places[:0]
        return places, join_words(list(dict.fromkeys(self.readings.channels[k].kind for k in places)))

    def name_row(self, k: int) -> str:
        """Return what messages call a row."""
        return f"{k + 1} (pose {str(self.posterior.likelihood.data.poses[k])!r})"

    def run(self, with_tables: bool = True, briefly: bool = False) -> Search:
        """Return what explains the readings best; without tables, by what leaves them as they are.

        ``briefly`` readings that fit as they are are asked for what is sure alone, without tables.
        """
        here = self.here
        if here is None:
            return Search(np.inf)
        effects = list(list_effects(self.readings, here.pose))
        if briefly:
            effects = [one for one in effects if not one.noise]
        rough, tables = self._weigh_effects(effects) + self._weigh_cells(here), list[tuple[Cause, float]]()
        slips = [value for cause, value in rough if cause.fault in SLIPS]
        if briefly and max(slips, default=-np.inf) < SURE_OF_SLIP:
            return Search(self.misfit)
        if briefly:
            rough += self._weigh_effects([one for one in list_effects(self.readings, here.pose) if one.noise])
        elif with_tables:
            tables = self._weigh_tables(here)
            rough += [] if self.fits else tables
        chosen = self._choose([one for one in rough if one[0].fault not in self.denied])
        counts = Counter((one.fault, one.scope) for one, _ in rough)
        ways = Counter(fault for fault, _ in counts)

        def cost(cause: Cause) -> float:
            return float(np.log(ways[cause.fault] * counts[cause.fault, cause.scope] * cause.among))

        bound, fitted = -np.inf, list[tuple[Cause, CauseFit]]()
        for cause, promise in chosen:
            if self.is_late and len(fitted) >= FEWEST:
                break
            rival = cause.fault == NOISE or (
                cause.fault == TOLERANCE and not briefly and self.rms_without_model_error > STATED
            )
            least = -RIVAL_WITHIN_NAT if rival else SURE_OF_SLIP if briefly else 0.0
            if promise < bound or (self.fits and promise < least):
                continue
            found = self.fit(cause, here)
            if found is not None:
                fitted.append((cause, found))
                bound = max(bound, promise - HOPELESS * len(self.some)) if found.misfit < FITS_WELL else bound
        fitted.sort(key=lambda one: cost(one[0]) - one[1].value)
        best = [(cause, self.integrate(one)) for cause, one in fitted[:INTEGRATED]]
        self.as_is = self._integrate_base([one.zeta for _, one in best])
        value = UNFIT if self.as_is is None else self.as_is.value
        weighed = [
            ScoredCause(
                cause,
                one.value - value - cost(cause),
                one.text,
                one.misfit,
                one.weigher.size,
                cost(cause),
                self.measure(cause, one),
                self.measure_without_model_error(one),
            )
            for cause, one in best
        ]
        weighed.sort(key=lambda one: -one.gain)
        unnoticed = [cause.text for cause, value in tables if self.fits and value > -UNSEEN]
        return Search(self.misfit, self._name(weighed), weighed, len(effects) + len(tables), self.is_late, unnoticed)

    def list_rivals(self, weighed: Iterable[ScoredCause]) -> list[Rival]:
        """Return weighed causes with the log-densities of the readings by each; no tolerance that is too wide."""
        as_is = UNFIT if self.as_is is None else self.as_is.value
        return [Rival(one.text, as_is + one.gain) for one in weighed if one.cause.fault != WIDE]

    @cached_property
    def most(self) -> Array:
        """Coordinates of errors that functions do not exceed here, `BEYOND` times what was allowed for, (n,)."""
        found, names = np.full(len(self.zeta), np.inf), self.posterior.errors.names
        for one in self.posterior.errors.terms_of(GPTerm):
            found[names.index(one.names[0])] = one.priors[0].standardise(np.array(BEYOND * one.scale))
        return found

    @cached_property
    def allowed(self) -> Array:
        """What readings may be off by, noise and one scale of functions of the pose, (K,).

        Infinite where neither functions nor a factor on the noise could have taken an error of the data up.
        """
        channels, data = self.readings.channels, self.posterior.likelihood.data
        noise = np.nanmedian(np.where(data.present, data.sd, np.nan), axis=0)
        found = np.zeros(len(channels))
        for one in self.posterior.errors.terms_of(GPTerm):
            found = np.where([channel.unit == "mm" for channel in channels], one.scale, found)
            found[one.own.places] = one.scale / one.own.levers
        absorbs = bool(found.any()) or bool(self.posterior.errors.terms_of(NoiseFactor))
        return np.asarray(np.hypot(noise, found)) if absorbs else np.full(len(channels), np.inf)

    def measure(self, cause: Cause, fit: CauseFit) -> float:
        """Return the rms of what a cause does to readings: of rows in their noise, of others in what was allowed for.

        A channel's scale about its own zero moves its zero, too, which is none of it.
        """
        data, change = self.posterior.likelihood.data, np.zeros_like(self.readings.values)
        if cause.without:
            rows = np.isin(fit.weigher.seen.rows, cause.without)
            return float(np.sqrt(np.mean(fit.weigher.seen.whiten(self._silence(self.zeta)).rows[rows, :, -1] ** 2)))
        if cause.columns is not None:
            change = cause.columns @ fit.weigher.solve(fit.zeta)[1]
        elif cause.table is not None:
            change[cause.table.rows] = np.nan_to_num(cause.table.values - self.readings.values[cause.table.rows])
            change += self._find_change_by_given(cause.table)
        if cause.fault == CHANNEL and np.ptp(change, axis=0).any():
            change = change - change.mean(axis=0)
        allowed = data.sd if cause.fault == ROWS else self.allowed
        off = np.divide(change, allowed, out=np.zeros_like(change), where=data.present & (data.sd > 0.0))
        touched = np.abs(off).max(axis=0) > 0.0
        touched = np.abs(off) > 0.0 if cause.fault == ROWS else np.broadcast_to(touched, off.shape)
        return float(np.sqrt(np.mean(off[touched] ** 2))) if touched.any() else 0.0

    def _find_change_by_given(self, table: RowReadings) -> Array:
        """Return by how much the machine as expected reads otherwise with what a table has as given, (P, K)."""
        if not table.given:
            return np.zeros_like(self.readings.values)
        likelihood, given = self.posterior.likelihood, self.posterior.likelihood.data.given
        other = {name: value.copy() for name, value in given.items()}
        for name, value in table.given.items():
            other[name][table.rows] = value
        with np.errstate(all="ignore"):
            before, after = (
                likelihood.model.read(self.posterior.first_machine, likelihood.start, one) for one in (given, other)
            )
        return np.nan_to_num(after - before)

    def _name(self, weighed: list[ScoredCause]) -> NamedCause | None:
        weighed = [one for one in weighed if one.cause.fault != WIDE]
        if weighed and weighed[0].cause.fault == MODEL:
            # errors in proportion to all travels hold a gain of each channel: where one does nearly as much, it is that
            most = [one for one in weighed if one.cause.fault == CHANNEL and one.gain > MOST_OF_IT * weighed[0].gain]
            weighed = [one for one in weighed if not most or one.cause.fault != MODEL]
        if not weighed or weighed[0].gain <= (SURE_OF_MODEL if weighed[0].cause.fault == MODEL else MIN_CAUSE_GAIN_NAT):
            return None
        best = [one for one in weighed if one.gain > MIN_CAUSE_GAIN_NAT]
        alike = [one for one in weighed if one.gain > best[0].gain - RIVAL_WITHIN_NAT]
        others = [one for one in weighed if one not in alike]
        rival = max(others[0].gain, 0.0) if others else 0.0
        first, *also = dict.fromkeys(one.text for one in alike)
        text = first + "".join(f" (or: {one})" for one in also[: MOST_ALIKE - 1])
        faults = tuple(dict.fromkeys(one.cause.fault for one in alike[:MOST_ALIKE]))
        said = others[0].text if others and others[0].gain > 0.0 else "the data as they are"
        top = best[0]
        return NamedCause(top.cause.fault, faults, text, top.gain, alike[-1].gain - rival, said, top.misfit, top.change)

    # --- first round -------------------------------------------------------------------------------------------------

    def _choose(self, rough: list[tuple[Cause, float]]) -> list[tuple[Cause, float]]:
        """Return the best causes of all and of each kind, the best first."""
        rough.sort(key=lambda one: -one[1])
        chosen = [one for one in rough if one[0].among == 1][:FINAL]  # single cells take no other cause's place
        for kind in dict.fromkeys((one[0].fault, one[0].among > 1) for one in rough):
            chosen += [one for one in rough if (one[0].fault, one[0].among > 1) == kind][:EACH]
        return sorted({id(one[0]): one for one in chosen}.values(), key=lambda one: -one[1])

    def _weigh_effects(self, causes: list[Cause]) -> list[tuple[Cause, float]]:
        """Return causes that do not change the table with their log-densities less that of no cause.

        Where the readings fit as they are, about that fit; elsewhere about the machine as expected.
        """
        assert self.here is not None
        here, states, bases = self.here, [(self.zeta, slop) for slop in SLOPS], self._as_expected
        if self.fits and self.base is not None:
            here = self.base.weigher.seen
            states = [(zeta, 1.0) for zeta in (self.base.zeta, self._silence(self.base.zeta))]
            bases = self._weigh_states(here, np.stack([zeta for zeta, _ in states]), np.ones(len(states)))
        bases = bases - 0.5 * np.array([float(zeta @ zeta) for zeta, _ in states])
        widths = [0 if one.columns is None else one.columns.shape[-1] for one in causes]
        ends = np.cumsum([0, *widths])
        p, k = self.readings.values.shape
        every = np.concatenate([np.zeros((p, k, 0)), *(one.columns for one in causes if one.columns is not None)], -1)
        chosen = np.unique([0, max(int(bases.argmax()) - 1, 0), bases.argmax()])
        if here is not self.here:
            chosen = np.arange(len(states))
        states, bases = [states[k] for k in chosen], bases[chosen]
        whites = [here.whiten(zeta, slop, every) for zeta, slop in states]
        values = np.full((len(causes), len(chosen)), -np.inf)
        for i, cause in enumerate(causes):
            for j, ((zeta, _), white) in enumerate(zip(states, whites, strict=True)):
                if cause.columns is not None:
                    where = white.known + np.arange(ends[i], ends[i + 1])
                    values[i, j] = bases[j] + white.gain(where, most=cause.most)[0]
                elif cause.toleranced:
                    gain, _ = white.gain_by_factor(np.array(cause.toleranced), cause.factors)
                    values[i, j] = bases[j] + gain
                elif cause.without:
                    values[i, j] = leave_out(white, np.array(cause.without)) - 0.5 * float(zeta @ zeta)
                elif cause.noise and (not j or here is not self.here):
                    values[i, j] = float(weigh_noises(here, cause, zeta[None], FACTORS)[0][0]) - 0.5 * float(
                        zeta @ zeta
                    )
        gains = values.max(axis=1) - bases.max()
        return list(zip(causes, gains.tolist(), strict=True))

    def _silence(self, zeta: Array) -> Array:
        """Return coordinates (n,) of the errors with a model error that explains next to nothing."""
        owners = self.posterior.errors.owners
        of_model = np.array([one is not None and one.of_model for one in owners], dtype=bool)
        return np.where(of_model, np.minimum(zeta, QUIET), zeta)

    def _weigh_tables(self, here: LinearisedTable) -> list[tuple[Cause, float]]:
        """Return causes that change the table, by some of the rows, and by how much better these are."""
        causes = [Cause("", "", table=self.readings.table), *list_tables(self.readings)]
        tables = [one.table.pick(self.some) for one in causes if one.table is not None]
        seen: dict[int, LinearisedTable] = {}
        kinds = [(one.circular, one.vague, tuple(one.given)) for one in tables]
        for alike in dict.fromkeys(kinds):
            places = [k for k, one in enumerate(kinds) if one == alike]
            for start in range(0, len(places), BATCH_SIZE):  # looked at one below the other
                some = places[start : start + BATCH_SIZE]
                values, rows = (np.concatenate([getattr(tables[k], key) for k in some]) for key in ("values", "rows"))
                given = {name: np.concatenate([tables[k].given[name] for k in some]) for name in alike[2]}
                table, y = replace(tables[some[0]], values=values, rows=rows, given=given), self.readings.begin
                every = None if self.is_late else self.readings.see(table, y, here.pose, 2)
                if every is not None:
                    seen |= zip(some, every.split([tables[k] for k in some]), strict=True)
        share, missing_cost = len(self.some) / max(int(self.some.sum()), 1), self._row_cost
        values = np.full(len(causes), -np.inf)
        slops = SLOPS[:2] if self.fits else SLOPS
        for k, sight in seen.items():
            if sight.stands.any():
                missing = int(self.some.sum()) - len(sight.rows)
                values[k] = self._weigh_slops(sight, slops).max() - missing * missing_cost
        usual = values[0] if np.isfinite(values[0]) else UNFIT
        rough = [(one, share * float(value - usual)) for one, value in zip(causes, values, strict=True)]
        return [*rough[1:], *self._weigh_shifts(here), *self._weigh_exchanges(here)]

    def _weigh_shifts(self, here: LinearisedTable) -> list[tuple[Cause, float]]:
        """Return rows that are shifted by one against the machine's own channels from some place on."""
        values, (own, kinds), found = self.readings.values, self.own, list[tuple[Cause, float]]()
        n = len(values)
        if n < 4 or not len(own):
            return found
        usual, row_cost = float(self._as_expected.max()), self._row_cost
        for step in (1, -1):  # rows hold what belongs to the one before them, or after them
            chosen = np.arange(n - 1) if step > 0 else np.arange(1, n)
            moved = values.copy()
            moved[np.ix_(chosen, own)] = values[np.ix_(chosen + step, own)]
            seen = self.readings.see(RowReadings(moved[chosen], chosen), self.readings.begin, here.pose, 3)
            if seen is None:
                continue
            weighed = weigh_spliced(here, seen, self.zeta, SLOPS, chosen, step)
            best = set(1 + np.argsort(-weighed[1 : n - 1])[:FINAL])
            for k in range(1, n - 1):
                if k not in best:  # counted, but never fitted
                    found.append((Cause(ROWS, ""), -np.inf))
                    continue
                there = chosen >= k if step > 0 else chosen <= k
                table = values.copy()
                table[chosen[there]] = moved[chosen[there]]
                where = "from" if step > 0 else "up to"
                text = f"rows of {kinds} seem to be shifted by one {where} row {self.name_row(k)}"
                found.append(
                    (Cause(ROWS, text, RowReadings(table[chosen], chosen)), float(weighed[k]) - row_cost - usual)
                )
        return found

    def _weigh_exchanges(self, here: LinearisedTable) -> list[tuple[Cause, float]]:
        """Return two rows whose readings of the machine's own channels are exchanged, of the few that are far off."""
        values, (own, kinds), found = self.readings.values, self.own, list[tuple[Cause, float]]()
        off = self.readings.measure_rows()
        far = np.flatnonzero(off > OUTLYING * np.median(off))
        if not 2 <= len(far) <= MOST_FAR or not len(own):
            return found
        usual = float(self._as_expected.max())
        for pair in combinations(far.tolist(), 2):
            moved = values.copy()
            moved[np.ix_(pair, own)] = values[np.ix_(pair[::-1], own)]
            table = RowReadings(moved, np.arange(len(values)))
            seen = self.readings.see(table, self.readings.begin, here.pose, 2)
            if seen is None or not seen.stands.any():
                continue
            text = f"rows {' and '.join(map(self.name_row, pair))} seem to have each other's {kinds}"
            value = self._weigh_slops(seen, SLOPS).max()
            found.append((Cause(ROWS, text, table), float(value - usual)))
        return found

    def _weigh_cells(self, here: LinearisedTable) -> list[tuple[Cause, float]]:
        """Return single readings that are wrong, by the best of some sizes of errors, about the fit of all."""
        seen, usual = (here, UNFIT) if self.base is None else (self.base.weigher.seen, self.base.value)
        y = self.readings.begin if self.base is None else self.base.weigher.solve(self.base.zeta)[0]
        machine = self.posterior.around(np.append(y, np.zeros_like(self.zeta)))[0]
        zetas = [self.zeta] if self.base is None else [self.base.zeta, self.zeta, self._silence(self.zeta)]
        found, each = list[tuple[Cause, float]](), np.tile(np.eye(len(self.readings.channels)), (len(seen.rows), 1, 1))
        every = np.zeros((len(self.readings.values), *each.shape[1:]))
        every[seen.rows] = each
        for zeta in zetas if seen.stands.any() else ():
            white = seen.whiten(zeta, columns=every)
            as_is = white.weigh() - 0.5 * float(zeta @ zeta)
            rows, cells = weigh_cells(white, len(self.readings.channels))
            listed = CellSearch(self.readings, seen.rows[rows], cells, machine, seen.pose[rows]).list_causes()
            found += [(cause, as_is + gain - usual) for cause, gain in listed]
        best = dict[str, tuple[Cause, float]]()
        for cause, gain in sorted(found, key=lambda one: -one[1]):
            best.setdefault(cause.text, (cause, gain - float(np.log(cause.among))))
        return list(best.values())

    @cached_property
    def _row_cost(self) -> float:
        """What a row of a table counts that is not there, like one that may be anything, negative."""
        assert self.here is not None
        white = self.here.whiten(self.zeta)
        return white.rows.shape[1] * ROW_PENALTY_NAT - float(np.median(white.constant))

    @cached_property
    def _as_expected(self) -> Array:
        """Log-densities of the readings about the machine as expected, by each of `SLOPS`."""
        assert self.here is not None
        return self._weigh_slops(self.here, SLOPS)

    def _weigh_slops(self, seen: LinearisedTable, slops: Array) -> Array:
        """Return log-densities of a table by factors (S,) on all noise, (S,)."""
        return self._weigh_states(seen, np.tile(self.zeta, (len(slops), 1)), slops)

    def _weigh_states(self, seen: LinearisedTable, zeta: Array, slops: Array) -> Array:
        """Return log-densities of a table by errors ζ (S, n) and factors (S,) on all noise, (S,)."""
        if seen.lost.any():  # they cost as much as others of the same noise
            return np.array([seen.whiten(*one).weigh() for one in zip(zeta, slops.tolist(), strict=True)])
        factors = np.repeat(slops[:, None], len(self.readings.channels), axis=1)
        return seen.weigh(zeta, factors)

    # --- second round ------------------------------------------------------------------------------------------------

    def fit(self, cause: Cause, here: LinearisedTable) -> CauseFit | None:
        """Return a cause about its own fit."""
        table, columns = cause.table or self.readings.table, cause.columns
        y, zeta, start = self.readings.begin, self.zeta, here.pose
        starts = (zeta,) if not cause.fault or self.base is None else (self.base.zeta, zeta, self._silence(zeta))
        unknown = np.zeros(0 if columns is None else columns.shape[-1])
        weigher, last = None, -np.inf
        for step in range(MOST_FITS):
            if step or cause.table is not None or here is not self.here:
                seen = self._see(table, columns, unknown, y, start, 0 if step else 3)
            else:
                seen = self._first
            if seen is None or not seen.stands.any():
                break  # steps that lead away: as good as the last one
            start = here.pose.copy()
            start[table.rows] = np.where(np.isfinite(seen.pose), seen.pose, start[table.rows])
            weigher = CauseLikelihood(self, cause, seen)
            if step == 0:
                zeta = profile(weigher.weigh_each, starts, turns=not cause.fault)
            elif step == FITS - 1:
                zeta = profile(weigher.weigh_each, (zeta, self._silence(zeta)), levels=not cause.fault, turns=False)
                weigher.weigh(zeta)
                with weigher.held():
                    zeta = profile(weigher.weigh_each, (zeta,), levels=False)
            before, last = last, weigher.weigh(zeta)
            y, unknown = weigher.solve(zeta)
            if step >= FITS - 1 and last < before + SETTLED:
                break
        if weigher is None or not np.isfinite(last):
            return None
        beside = -(len(self.readings.values) - len(table.rows)) * self._row_cost
        return self._describe(weigher, zeta, last - 0.5 * float(zeta @ zeta), beside)

    def _see(
        self, table: RowReadings, columns: Array | None, unknown: Array, y: Array, start: Array, n_starts: int
    ) -> LinearisedTable | None:
        """Return a table's rows about a machine (m,) and unknowns (k,) of columns, as errors without these."""
        if columns is None:
            return self.readings.see(table, y, start, n_starts)
        effect = (columns @ unknown)[table.rows]
        values = self.posterior.likelihood.comparison.add(table.values, -effect)
        seen = self.readings.see(replace(table, values=values), y, start, n_starts)
        if seen is None:
            return None
        return replace(seen, errors=seen.errors + (seen.linear.left @ effect[..., None])[..., 0], sums={})

    def _describe(self, weigher: CauseLikelihood, zeta: Array, value: float, beside: float) -> CauseFit:
        """Return a cause's fit at the errors ζ for which it was weighed last, of that log-density of its rows."""
        cause, (y, unknown) = weigher.cause, weigher.solve(zeta)
        more = beside
        if cause.scaled is not None:
            n_read = np.count_nonzero(np.isfinite(self.readings.values[:, cause.scaled]))
            more += n_read * float(np.log(max(abs(1.0 - unknown[0]), 1e-300)))
        sizes = unknown if cause.columns is not None else np.array([weigher.size])
        if cause.blind is not None:
            theta = self.posterior.around(np.append(y, np.zeros_like(self.zeta)))[0]
            given = self.posterior.likelihood.data.given
            sizes = self.readings.model.read(theta, weigher.seen.pose, given)[:, cause.blind]
        text = cause.text if cause.say is None else cause.say(sizes)
        misfit = weigher.measure_misfit(np.zeros_like(zeta))
        return CauseFit(value + more, misfit, text, zeta, weigher, beside)

    def integrate(self, found: CauseFit) -> CauseFit:
        """Return a fit with the errors' sizes integrated; as it was where no optimum of theirs is found."""
        weigher, zeta = found.weigher, found.zeta
        weigher.weigh(zeta)
        for _ in range(TURNS):
            size = weigher.size
            try:
                with weigher.held():
                    value, zeta = integrate_sizes(weigher.weigh_each, zeta)
            except (NumericalError, np.linalg.LinAlgError):
                return found
            weigher.weigh(zeta)
            if not weigher.cause.noise or weigher.size == size:
                break
        return self._describe(found.weigher, zeta, value, found.beside)

    def _integrate_base(self, others: Sequence[Array]) -> CauseFit | None:
        """Return the readings as they are with the errors' sizes integrated, from the best of their own and others."""
        if self.base is None:
            return None
        base, weigh = self.base, self.base.weigher.weigh
        first = max((base.zeta, *others), key=lambda zeta: weigh(zeta) - 0.5 * float(zeta @ zeta))
        return self.integrate(replace(base, zeta=first))

    def fit_freely(self) -> CauseFit | None:
        """Return the readings as they are with errors of any size, as large ones, too, as no machine should have."""
        found = self.as_is or self.base
        return None if found is None else self.integrate(replace(found, weigher=replace(found.weigher, limited=False)))
