"""Frames of instruments from the data: where the machine's own channels have the tool, and what was read of it there.

A frame that nobody states is found by least squares at the machine as expected, and its prior is so wide about what was
found that its width does not matter: the data are not used twice, and all variants have the same centre. Of one that is
stated the prior holds; where the stated one is so far off that least squares would not find the way, they begin at what
was found. Far beyond its tolerance it is refused: no machine would explain the readings.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from bayescal.density.calibration.likelihood import CalibrationLikelihood, CalibrationPosterior
from bayescal.density.calibration.measurements import Comparison, Measurements
from bayescal.density.calibration.terms import ErrorModel
from bayescal.density.elimination import invert
from bayescal.density.posterior import Posterior
from bayescal.density.priors import Prior
from bayescal.density.sampling import place_free
from bayescal.density.schema import NormalConfig, PriorConfig
from bayescal.errors import InputError, name_faults
from bayescal.experiments.shared.readings.priors import choose_priors
from bayescal.experiments.shared.readings.reading_tables import PoseReadings
from bayescal.experiments.shared.readings.workspace import build_workspace, search_starts
from bayescal.experiments.shared.study_schema import StudyConfig
from bayescal.limits import FAR_AWAY
from bayescal.machines.readings import FunctionModel, Instrument, InstrumentedMachine, ReadingModel
from bayescal.machines.readings.placed import place_instruments
from bayescal.numerics.geometry import Array, matrix_from_rotation_vector
from bayescal.numerics.units import Units
from bayescal.report.numbers import format_significant, join_words

SCALE = {"mm": 100.0, "rad": 0.3}
"""What steps of least squares are small against."""
MOST_ROWS = 120  # of the data from which frames are found
POLISHED = 4  # proposals that are fitted
MOST_STEPS = 200  # of such a fit
OUTLYING = 3.0  # times the usual residual, from which on least squares take less account of it
FITS = 5.0  # rms of readings over what tolerances and noise explain, up to which a frame is said to fit
TRAVEL = 0.02  # of how far the tool moves, that a frame has to miss readings by to be said not to fit
A_STEP = 2.0  # times the rms of the found frame: least squares find the way from a stated one whose first step ends so
ANYWHERE, ASIDE, FLAT = 40, np.array([40.0, 50.0, 60.0]), 1e-9
"""Poses of the workspace, a point fixed to the tool, and of how far it goes, by which it is off a plane."""
CONTRADICTED = 10.0  # standard deviations by which a stated frame is refused
TURN = 2.0 * np.pi
DETERMINED = 1e-9  # of the largest singular value of the slopes by the pose


@dataclass(frozen=True, eq=False)
class FoundFrames:
    """Instruments with values for all that nobody stated, and where searches begin.

    ``wide`` are the symbols whose priors are wide about what was found; ``begin`` holds parameters of stated ones that
    are better begun elsewhere, by name; ``told`` says both in words.
    """

    instruments: Mapping[str, Instrument]
    wide: Mapping[str, tuple[float, str]] = field(default_factory=dict)  # standard deviation and its unit by symbol
    begin: Mapping[str, float] = field(default_factory=dict)
    told: str = ""

    def free(self, config: StudyConfig) -> StudyConfig:
        """Return a config in which whatever was found is free in every variant, under a wide prior."""
        if not self.wide:
            return config
        return config.model_copy(
            update={
                "parameters": dict(config.parameters) | _widen(self.wide, config),
                "variants": [
                    one if one.free is None else one.model_copy(update={"free": [*one.free, *self.wide]})
                    for one in config.variants
                ],
            }
        )


def _widen(wide: Mapping[str, tuple[float, str]], config: StudyConfig) -> dict[str, PriorConfig]:
    units = Units(config.units.length, config.units.angle)
    return {symbol: NormalConfig(prior="normal", sd=sd / units.factor(unit)) for symbol, (sd, unit) in wide.items()}


def find_frames(
    config: StudyConfig,
    machine: ReadingModel,
    instruments: Mapping[str, Instrument],
    readings: PoseReadings,
    deviations: Array,
    symbols: Collection[str],
) -> FoundFrames:
    """Return instruments whose frames were found where the machine's own channels have the tool.

    Parameters
    ----------
    machine : ReadingModel
        Without instruments.
    readings, deviations : PoseReadings and ndarray, shape (P, K)
        By channels of the machine and then of the instruments, with their noise.
    symbols : collection of str
        Of parameters that other machines have.

    Raises
    ------
    InputError
        Where a frame that nobody states cannot be found, and where a stated one contradicts the readings.
    """
    if not instruments:
        return FoundFrames(instruments)
    unstated, wide = {name: one.unstated for name, one in instruments.items()}, list_unstated(instruments)
    zero = {name: settle_unstated(one) for name, one in instruments.items()}
    placed = place_instruments(machine, zero)
    for symbol in wide:
        if symbol in config.parameters and config.parameters[symbol].prior == "fixed":
            raise InputError(f"parameters.{symbol}: found fixed, expected its value in [instruments]")
    found = FoundFrames(instruments, wide)
    search = _Search.prepare(found.free(config), placed, readings, deviations, symbols)
    if search is None:
        for symbol in wide:
            raise InputError(f"instruments: {symbol}: expected its value: own channels do not locate the tool")
        return found
    values, begin, told = dict[str, Instrument](), dict[str, float](), list[str]()
    for k, (name, one) in enumerate(zip(instruments, placed.instruments, strict=True)):
        fit = search.fit(k, zero[name], unstated[name])
        if fit is None:
            values[name] = zero[name]
            continue
        block_of = {symbol: fit.values[places] for symbol, places in one.layout.index.items()}
        values[name] = zero[name].settle({symbol: block_of[symbol] for symbol in unstated[name]})
        told += [fit.tell(name, unstated[name])] if unstated[name] else []
        if fit.is_far:
            names = placed.layout.names[search.start_of(k) : search.start_of(k) + one.layout.size]
            begin |= {own: float(v) for own, v, free in zip(names, fit.values, fit.free, strict=True) if free}
    return FoundFrames(values, wide, begin, "; ".join(told))


def list_unstated(instruments: Mapping[str, Instrument]) -> dict[str, tuple[float, str]]:
    """Return the standard deviations of priors of what nobody states, and their units, by symbol."""
    return {
        f"{name}_{block.symbol}" if name else block.symbol: (one.wide.get(block.unit, 1.0), block.unit)
        for name, one in instruments.items()
        for block in (one.parameters if one.unstated else ())
        if block.symbol in one.unstated
    }


def settle_unstated(instrument: Instrument) -> Instrument:
    """Return an instrument with zero where nobody states a value."""
    unstated = [one for one in instrument.parameters if one.symbol in instrument.unstated]
    return instrument.settle({one.symbol: np.nan_to_num(one.nominal) for one in unstated}) if unstated else instrument


@dataclass(frozen=True, eq=False)
class _InstrumentFit:
    """What was found of one instrument with D' parameters: values, which are free, and how well they fit.

    ``rms`` and ``before`` are in mm, or rad of an instrument that reads angles alone, of the readings at the found and
    at the stated values.
    """

    model: FunctionModel
    values: Array  # (D',)
    free: np.ndarray  # (D',)
    is_far: bool

    def tell(self, name: str, unstated: Collection[str]) -> str:
        """Return what was found of what nobody states, as a config would say it."""
        said = [
            f"{_key(symbol, self.model)} = {_format(self.values[self.model.layout.index[symbol]], self.model, symbol)}"
            for symbol in unstated
        ]
        return f"instruments.{name}: estimated with a wide prior: {', '.join(said)}"


def _key(symbol: str, model: FunctionModel) -> str:
    """Return the key of a built-in instrument's section that states a symbol; of a user-defined class the symbol."""
    unit = model.layout.block(symbol).unit
    known = getattr(type(model.machine), "Config", None)
    key = f"{symbol.removesuffix('_r')}_{'deg' if unit == 'rad' else unit}"
    return key if known is not None and key in known.model_fields else symbol


def _format(values: Array, model: FunctionModel, symbol: str) -> str:
    degrees = model.layout.block(symbol).unit == "rad" and _key(symbol, model) != symbol
    shown = [f"{x:.4g}" if abs(x) < 1.0 else f"{x:.1f}" for x in (np.degrees(values) if degrees else values)]
    return f"[{', '.join(shown)}]" if model.layout.block(symbol).per_leg else shown[0]


@dataclass(frozen=True, eq=False)
class _Search:
    """Where the tool is by the machine's own channels, and what instruments read of it."""

    placed: InstrumentedMachine
    theta: Array  # (D,): all as expected
    sd: Array  # (D,): prior standard deviations; zero of what is not free
    tool: Array  # (R, 6): position and rotation vector
    seen: Array  # (R, K): of the instruments
    noise: Array  # (R, K)
    spread: tuple[float, float]  # by how much tolerances move and turn the tool, mm and rad

    @classmethod
    def prepare(
        cls,
        config: StudyConfig,
        placed: InstrumentedMachine,
        readings: PoseReadings,
        deviations: Array,
        symbols: Collection[str],
    ) -> _Search | None:
        """Return where the tool is; None where the machine's own channels do not tell it in at least three rows."""
        machine, n = placed.whole, len(placed.whole.channels)
        section = config.variants[0].model_copy(update={"free": None, "fixed": [], "tied": []})
        priors, fixed, _ = choose_priors(config, section, placed.layout, {*symbols, *placed.layout.symbols})
        names, theta, moved = place_free(placed.layout, priors, fixed, {})
        sd = np.array([priors[name].sd for name in names]) @ moved if names else np.zeros(len(theta))
        stated = np.isfinite(deviations[:, :n]).any(axis=0) & np.isfinite(readings.values[:, :n]).any(axis=0)
        own = machine.pick(np.flatnonzero(stated))
        values = np.where(np.isfinite(deviations[:, :n]), readings.values[:, :n], np.nan)[:, stated]
        known = np.isfinite(values).sum(axis=1) >= len(own.coordinates)
        known &= np.isfinite(readings.values[:, n:]).any(axis=1) & ~readings.verification
        for name in own.given:
            known &= np.isfinite(readings.given[name]) if name in readings.given else False
        rows = np.flatnonzero(known)
        if len(rows) < 3 or not len(own.channels):
            return None
        rows = rows[np.unique(np.linspace(0, len(rows) - 1, min(MOST_ROWS, len(rows))).astype(int))]
        data = Measurements(
            tuple(np.array(readings.poses, dtype=object)[rows]),
            values[rows],
            deviations[rows][:, :n][:, stated],
            {name: readings.given[name][rows] for name in own.given},
        )
        located = _locate(config, own, priors, fixed, data)
        there = np.isfinite(located.pose).all(axis=1)
        if there.sum() < 3:
            return None
        d = machine.layout.size
        tool = placed._place_tool(machine.tool_values(theta[:d], located.pose), located.pose)
        spread = _spread(placed, theta, sd[:d], located)
        seen = readings.values[rows][:, n:]
        return cls(placed, theta, sd, tool[there], seen[there], deviations[rows][:, n:][there], spread)

    def start_of(self, k: int) -> int:
        """Return where the parameters of an instrument begin."""
        return self.placed.whole.layout.size + sum(one.layout.size for one in self.placed.instruments[:k])

    def fit(self, k: int, instrument: Instrument, unstated: Collection[str]) -> _InstrumentFit | None:
        """Return what is found of the k-th instrument; None where nothing is free, or nothing was read."""
        model = self.placed.instruments[k]
        first = sum(len(one.channels) for one in self.placed.instruments[:k])
        seen, noise = (one[:, first : first + len(model.channels)] for one in (self.seen, self.noise))
        rows = np.isfinite(seen).any(axis=1)
        own = slice(self.start_of(k), self.start_of(k) + model.layout.size)
        sd = self.sd[own].copy()
        if not (sd > 0.0).any() or rows.sum() < 3:
            for symbol in unstated:
                raise InputError(f"instruments.{model.name}: found too few rows for {symbol}, expected its value")
            return None
        lost = np.concatenate([model.layout.index[one] for one in unstated] or [np.empty(0, dtype=int)])
        is_lost = np.isin(np.arange(len(sd)), lost)
        problem = _Problem(instrument, model, self.theta[own], sd, is_lost, self.tool[rows], seen[rows])
        for symbol, why in instrument.list_hidden(self.is_flat).items():
            if symbol in unstated:
                raise InputError(f"instruments.{model.name}: {_key(symbol, model)}: missing, expected its value: {why}")
        return replace(problem, scale=self._scale(model, noise[rows])).solve()

    @cached_property
    def is_flat(self) -> bool:
        """Whether the tool, and whatever is fixed to it, keeps to a plane wherever the machine goes."""
        whole = self.placed.whole
        shift = np.random.default_rng(0).uniform(-1.0, 1.0, (ANYWHERE, len(whole.home_pose)))
        tool = self.placed.place_tool(self.theta, whole.home_pose + whole.pose_scale * shift)
        point = tool[:, :3] + (_turn(tool[:, 3:]) @ ASIDE)
        point = point[np.isfinite(point).all(axis=1)]
        spread = np.linalg.svd(point - point.mean(axis=0), compute_uv=False)
        return bool(len(point) > len(spread) and spread[-1] <= FLAT * spread[0])

    def _scale(self, model: FunctionModel, noise: Array) -> Array:
        """Return how far readings may lie from what is expected by noise and tolerances, (K,)."""
        length, angle = self.spread
        by_unit = {"mm": length, "rad": angle}
        spread = np.array([by_unit.get(one.unit, 0.0) for one in model.channels])
        known = np.where(np.isfinite(noise), noise, 0.0)
        found = np.sqrt(np.mean(known**2, axis=0) + spread**2)
        return np.where(found > 0.0, found, 1.0)


@dataclass(frozen=True, eq=False)
class _Located:
    pose: Array  # (R, q); NaN where it is not determined
    given: Mapping[str, Array]
    slopes: tuple[Array, Array]  # of the own channels by the pose, (R, K, q), and by the parameters, (R, K, D)


def _locate(
    config: StudyConfig,
    own: ReadingModel,
    priors: Mapping[str, Prior],
    fixed: Mapping[str, float],
    data: Measurements,
) -> _Located:
    """Return where the machine as expected stands by its own channels."""
    names, workspace = set(own.layout.names), build_workspace(own, config.workspace, config.units)
    likelihood = CalibrationLikelihood(
        own, data, workspace.volume, np.zeros((data.n_poses, len(own.coordinates))), straight=False
    )
    posterior: CalibrationPosterior = Posterior(
        likelihood,
        {name: one for name, one in priors.items() if name in names},
        ErrorModel(),
        {name: value for name, value in fixed.items() if name in names},
    )
    pose = search_starts(posterior, workspace, config.seed)
    white = likelihood.whiten(likelihood.sd[None], np.zeros((1, 1, len(own.channels))))
    with np.errstate(all="ignore"):
        at = likelihood.stand(posterior.sampling.start[None], white, pose)
        _, slope, by_parameters = likelihood.linearise(posterior.sampling.start[None], at.pose, white, True)
    pose = at.pose[0].copy()
    good = np.isfinite(at.error[0]).all(axis=1) & np.isfinite(slope[0]).all(axis=(1, 2))
    if pose.shape[1]:
        values = np.linalg.svd(np.nan_to_num(slope[0] * workspace.half), compute_uv=False)
        good &= values[:, pose.shape[1] - 1] > DETERMINED * values[:, 0]
    pose[~good] = np.nan
    return _Located(pose, data.given, (slope[0], by_parameters[0]))


def _spread(placed: InstrumentedMachine, theta: Array, sd: Array, located: _Located) -> tuple[float, float]:
    """Return by how much tolerances (D,) move and turn the tool where the own channels read what they read, rms."""
    there = np.isfinite(located.pose).all(axis=1)
    pose, (slope, by_parameters) = located.pose[there], (one[there] for one in located.slopes)
    with np.errstate(all="ignore"):
        _, by_pose, direct = placed.linearise_tool(theta[: len(sd)], pose)
        moves = direct - by_pose @ invert(slope, 0.0) @ by_parameters
    variance = np.nansum((moves * sd) ** 2, axis=-1)
    return float(np.sqrt(np.nanmean(variance[:, :3]))), float(np.sqrt(np.nanmean(variance[:, 3:])))


@dataclass(frozen=True, eq=False)
class _Problem:
    """Least squares of one instrument's D' parameters at tools (R, 6) that are known."""

    instrument: Instrument
    model: FunctionModel  # of the instrument
    stated: Array  # (D',)
    sd: Array  # (D',): of the prior; zero of what is not free
    lost: np.ndarray  # (D',): which nobody states
    tool: Array
    seen: Array  # (R, K)
    scale: Array = field(default_factory=lambda: np.ones(1))  # (K,)

    @property
    def free(self) -> np.ndarray:
        return self.sd > 0.0

    @cached_property
    def _steps(self) -> Array:
        return np.array([SCALE.get(unit, 1.0) for unit in self.model.layout.units])[self.free]

    def _whole(self, x: Array) -> Array:
        values = self.stated.copy()
        values[self.free] = x
        return values

    def miss(self, x: Array) -> Array:
        """Return readings less what is expected of free values (F,), over what they may be off by, (R, K)."""
        read = self.model.read(self._whole(x), self.tool)
        error = Comparison(self.model.channels).subtract(self.seen, read) / self.scale
        return np.where(np.isfinite(self.seen), np.nan_to_num(error, nan=FAR_AWAY, posinf=FAR_AWAY), 0.0)

    def slope(self, x: Array) -> Array:
        """Return its derivative, (R, K, F)."""
        here, comparison = self.model.linearise(self._whole(x), self.tool), Comparison(self.model.channels)
        error = comparison.subtract(self.seen, here.values)
        slopes = comparison.pull_back(error, here.values, here.by_parameters[..., self.free])
        slopes = np.where(np.isfinite(error)[..., None], slopes, 0.0)
        return np.asarray(-np.nan_to_num(slopes) / self.scale[:, None])

    def rms(self, x: Array) -> float:
        """Return the median over rows of their rms."""
        there = np.maximum(np.isfinite(self.seen).sum(axis=1), 1)
        return float(np.median(np.sqrt((self.miss(x) ** 2).sum(axis=1) / there)))

    def solve(self) -> _InstrumentFit:
        """Return the best of all proposals, fitted; InputError where it fits badly, or contradicts what is stated."""
        start = self.stated[self.free]
        found = self._shorten(self._search(start))
        fits, name = self.rms(found), f"instruments.{self.model.name}"
        self._check_hand(name, fits)
        # as many sd as the readings of one row are off by when all deviate alike, as tolerances make them
        share = 1.0 / (np.sqrt(len(self.tool)) * max(fits, 1.0))
        known = ~self.lost[self.free]
        if fits > FITS and (self.lost.any() or self.rms(start) > A_STEP * fits) and self._is_lost(found):
            raise InputError(
                f"{name}: readings lie {self._say(found)} from the machine's own, with the best "
                "frame: check units, signs, order of channels and rows"
            )
        if known.any() and fits <= FITS:
            self._check_stated(name, start, found, share, known)
        step = np.linalg.lstsq(self.slope(start).reshape(-1, len(start)), -self.miss(start).ravel(), rcond=1e-9)[0]
        is_far = bool(known.any() and self.rms(start + step) > A_STEP * max(fits, 1.0))
        return _InstrumentFit(self.model, self._whole(found), self.free, is_far)

    def _search(self, start: Array) -> Array:
        """Return the values (F,) of the best fit from all proposals."""
        layout, position, rotation = self.model.layout, self.tool[:, :3], self.tool[:, 3:]
        by_symbol = {symbol: self.stated[places] for symbol, places in layout.index.items()}
        with np.errstate(all="ignore"):
            turned = _turn(rotation)
            with name_faults(f"instruments.{self.model.name}"):
                proposed = self.instrument.propose(by_symbol, self.seen, position, turned)
        starts = []
        for one in proposed:
            values = self.stated.copy()
            for symbol, own in one.items():
                values[layout.index[symbol]] = own
            starts.append(values[self.free] if np.isfinite(values).all() else start)
        best = sorted(starts, key=self.rms)[:POLISHED]
        return min((self._polish(one) for one in best), key=self.rms)

    def _shorten(self, x: Array) -> Array:
        """Return values (F,) whose angles and rotation vectors are the shortest that say the same.

        Of what is stated they are those nearest to it. Three angles are a rotation vector where every reading says so.
        """
        whole, expected = self._whole(x), self.miss(x)
        near = np.where(self.lost, 0.0, self.stated)
        for places in self.model.layout.index.values():
            if self.model.layout.units[places[0]] != "rad" or not self.free[places].all():
                continue
            vector, size = whole[places], float(np.linalg.norm(whole[places]))
            turns = vector[:, None] - TURN * np.round((vector - near[places]) / TURN)[:, None]
            if len(places) == 3 and size > 0.0:  # a turn more or less about the same axis
                turns = np.hstack([vector[:, None] * (1.0 + TURN / size * np.arange(-2, 3)), turns])
            for one in sorted(turns.T, key=lambda way: float(np.linalg.norm(way - near[places]))):
                other = whole.copy()
                other[places] = one
                if np.allclose(self.miss(other[self.free]), expected, rtol=1e-6, atol=1e-6 * (1.0 + self.rms(x))):
                    whole = other
                    break
        return np.asarray(whole[self.free])

    def _polish(self, start: Array) -> Array:
        """Return the best fit from a start (F,), at which of what nobody states stays what no reading tells.

        Tolerances, which are in the scale, err alike in all rows, so that the wide prior counts in each.
        """
        from scipy.optimize import least_squares  # a tenth of a second to import, for those with instruments

        n, x = len(start), start
        pull = np.where(self.lost, np.sqrt(len(self.tool)) / np.where(self.free, self.sd, 1.0), 0.0)[self.free]
        for _ in range(2):  # with the size of residuals from which on a row is taken for an outlier
            found = least_squares(
                lambda x: np.append(self.miss(x), pull * (x - start)),
                x,
                lambda x: np.concatenate([self.slope(x).reshape(-1, n), np.diag(pull)]),
                x_scale="jac",
                loss="soft_l1",
                f_scale=OUTLYING * max(self.rms(x), 1e-6),
                max_nfev=MOST_STEPS,
            )
            x = found.x
        return np.asarray(x)

    def _is_lost(self, found: Array) -> bool:
        """Whether readings lie far from a fit by how far the tool moves."""
        read = self.model.read(self._whole(found), self.tool) / self.scale
        travel = np.nan_to_num(read - np.nanmean(read, axis=0))
        return bool(
            np.median(np.linalg.norm(self.miss(found), axis=1)) > TRAVEL * np.median(np.linalg.norm(travel, axis=1))
        )

    def _check_hand(self, name: str, fits: float) -> None:
        if fits > FITS and self.instrument.find_mirrored(self.seen, self.tool[:, :3], _turn(self.tool[:, 3:])):
            raise InputError(f"{name}: readings are left-handed: check signs and order of x, y, z")

    def _check_stated(self, name: str, start: Array, found: Array, share: float, known: np.ndarray) -> None:
        """Raise InputError where stated values contradict what was found by many of their tolerances."""
        from scipy.optimize import least_squares

        sd, n = self.sd[self.free], len(start)

        def miss(x: Array) -> Array:
            return np.concatenate([share * self.miss(x).ravel(), ((x - start) / sd)[known]])

        def slope(x: Array) -> Array:
            return np.concatenate([share * self.slope(x).reshape(-1, n), (np.eye(n) / sd[:, None])[known]])

        costs = [2.0 * least_squares(miss, one, slope, x_scale=self._steps, max_nfev=40).cost for one in (start, found)]
        least = float(np.sum((share * self.miss(found)) ** 2))
        off = float(np.sqrt(max(min(costs) - least, 0.0)))
        if off <= CONTRADICTED:
            return
        names = [symbol for symbol, places in self.model.layout.index.items() if self.free[places].any()]
        said = [f"{_key(one, self.model)} = {self._say_values(one, found)}" for one in names]
        keys = join_words([_key(one, self.model) for one in names])
        raise InputError(
            f"{name}: readings lie {self._say(start)} off at the stated {keys}, {self._say(found)} at "
            f"{', '.join(said)} ({format_significant(off, 2)} tolerances away): state those, or none"
        )

    def _say_values(self, symbol: str, x: Array) -> str:
        return _format(self._whole(x)[self.model.layout.index[symbol]], self.model, symbol)

    def _say(self, x: Array) -> str:
        """Return how far readings are off, rms over rows' median, in words."""
        error = self.miss(x) * self.scale
        units = [one.unit for one in self.model.channels]
        unit = "mm" if "mm" in units else units[0]
        some = [k for k, one in enumerate(units) if one == unit]
        size = float(np.median(np.sqrt(np.mean(error[:, some] ** 2, axis=1))))
        return f"{format_significant(size, 2)} {unit}"


def _turn(vector: Array) -> Array:
    return matrix_from_rotation_vector(np.nan_to_num(vector))
