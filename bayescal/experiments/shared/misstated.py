"""What is stated of noise, tolerances and model error that the readings contradict, where no slip explains them."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from bayescal.density.calibration.model_error import OF_NOISE, RandomTerm
from bayescal.density.calibration.terms import ErrorTerm
from bayescal.experiments.shared.function_errors import has_lengths
from bayescal.experiments.shared.slip_causes import NOISE, SCATTER, TOLERANCE, WIDE
from bayescal.experiments.shared.slip_rows import (
    VariantReadings,
    leave_out_drift,
    leave_out_outliers,
)
from bayescal.experiments.shared.slip_search import (
    RIVAL_WITHIN_NAT,
    CauseFit,
    SlipSearch,
)
from bayescal.experiments.shared.slip_sizes import integrate_sizes, profile
from bayescal.experiments.shared.slip_verdict import MIN_CAUSE_GAIN_NAT, STATED, Rival, ScoredCause
from bayescal.experiments.shared.slips import EITHER, LARGE, MisstatedInput
from bayescal.experiments.shared.soundness import ChiSquare
from bayescal.identifiability.requirements import Requirement
from bayescal.numerics.geometry import Array
from bayescal.report.numbers import format_odds, format_significant
from bayescal.report.symbols import format_amount

SURE_OF_SCATTER = 5.0
"""Nats by which rows have to be explained worse without independent errors of each: one in a thousand by chance."""
ABSENT = -6.0  # coordinate of a size that is not there
MAX_SIZE_RATIO = 5.0
"""Size of a model error in the median of its prior from which on it is far beyond what was allowed for."""
SURE_OF_SIZE = 10.0
"""Nats by which readings have to be explained worse by errors as large as was allowed for."""
UNLIMITED_SEARCH_FRACTION = 0.8  # of these limits, from which on sizes are looked for without any limit
AT_ONCE = 40  # rows over which errors at the tool are averaged


def find_misstated(
    variants: Iterable[VariantReadings], required: Sequence[Requirement] = (), rivals: Sequence[Rival] = ()
) -> MisstatedInput | None:
    """Return what noise or tolerance is stated wrong by the readings that nothing else explains as well; None if none.

    Of several variants the one that explains its readings best is asked. What a check names competes, but for tables
    read otherwise, which `find_slip` looks for. Where readings scatter from row to row by more than their noise as
    stated, and another noise explains that as well as a model error does, both are said: data cannot tell them apart;
    so of tolerances that are far too tight, where wider ones leave nothing for a model error to explain.
    Where none of these is named, and the readings need errors far beyond what was allowed for, that is said, with the
    most probable single cause beside. That tolerances are too wide is said where nothing else is.

    Parameters
    ----------
    variants : iterable of Readings
        The same measurements under several models.
    required : sequence of Requirement, optional
        What is required of the tool, which errors of the model should not exceed.
    rivals : sequence of Rival, optional
        Causes that were weighed elsewhere, as by `find_suspects`.
    """
    given = list(variants)
    searches = [SlipSearch(leave_out_outliers(leave_out_drift(one)), ()) for one in given]
    k = int(np.argmax([-np.inf if one.base is None else one.base.value for one in searches]))
    asked, whole = searches[k], given[k]
    found = asked.run(with_tables=False)
    stated = found.first is not None and found.first.fault in (NOISE, TOLERANCE)
    if found.first is not None and stated:
        best = next(one for one in found.weighed if one.cause.fault == found.first.fault)
        return MisstatedInput(found.first.fault, found.first.text, best.factor, best.gain)
    large = _find_large(asked, whole, required, [*asked.list_rivals(found.weighed), *rivals])
    if large is not None or found.first is not None:
        return large
    either = _find_scatter(asked, found.weighed) or _find_taken_up(asked, found.weighed)
    if either is not None:
        return either
    wide = [one for one in found.weighed if one.cause.fault == WIDE and one.gain > MIN_CAUSE_GAIN_NAT]
    return MisstatedInput(WIDE, wide[0].text, wide[0].factor, wide[0].gain) if wide else None


def _find_scatter(search: SlipSearch, weighed: list[ScoredCause]) -> MisstatedInput | None:
    """Return the noises that explain a scatter of the rows as well as errors of the model; None if there is none.

    There is one where rows are explained far worse without errors that are drawn independently at each.
    """
    noises = [one for one in weighed if one.cause.fault == NOISE and one.factor > 1.0]
    noises = [one for one in noises if one.gain + one.cost > -RIVAL_WITHIN_NAT]
    base = search.as_is
    random = search.posterior.errors.terms_of(RandomTerm)
    drawn = np.array([one in random for one in search.posterior.errors.owners], dtype=bool)
    if not noises or base is None or not drawn.any():
        return None
    weigh = base.weigher.weigh_each
    start = np.where(drawn, 0.0, base.zeta)
    loss = base.value - integrate_sizes(lambda zeta: weigh(np.where(drawn, ABSENT, zeta)), start)[0]
    if loss <= SURE_OF_SCATTER:
        return None
    said = " (or: ".join(one.text for one in noises[:2])
    text = f"rows scatter by more than the noise, as tau shows; also, {said}"
    return MisstatedInput(SCATTER, f"{text}{')' * (len(noises) > 1)}", noises[0].factor, loss)


def _find_taken_up(search: SlipSearch, weighed: list[ScoredCause]) -> MisstatedInput | None:
    """Return the tolerances that explain as well what errors of the model take up; None if there are none.

    Wider ones have to leave nothing for a model error to explain.
    """
    base, errors = search.as_is, search.posterior.errors
    tight = [one for one in weighed if one.cause.fault == TOLERANCE and one.gain > -RIVAL_WITHIN_NAT]
    tight = [one for one in tight if one.factor >= MAX_SIZE_RATIO and one.rms_without_model_error <= STATED]
    if not tight or base is None or search.rms_without_model_error <= STATED:
        return None
    owners = zip(errors.owners, errors.units, strict=True)
    kinds = [(one is not None and one.of_model and _adds(one), unit) for one, unit in owners]
    mine = np.array([kind[0] for kind in kinds], dtype=bool)
    if not mine.any():  # no error of the model is there that could take up anything
        return None
    sizes, weigh = errors.natural(base.zeta), base.weigher.weigh_each
    first = int(np.where(mine, sizes, 0.0).argmax())
    size = _say_size(search.readings, float(np.linalg.norm(sizes[mine])), *kinds[first])
    loss = base.value - integrate_sizes(lambda zeta: weigh(np.where(mine, ABSENT, zeta)), base.zeta)[0]
    text = f"{tight[0].text} (or a model error of {size})"
    return MisstatedInput(EITHER, text, tight[0].factor, loss)


# --- errors far beyond what was allowed for --------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class _Excess:
    """A model error that is larger than was allowed for, or required.

    ``factor`` times as large, in words, and the largest coordinates of all errors (n,) with which it is not; ``sure``
    nats by which the readings have to be explained worse by these.
    """

    factor: float
    said: str
    most: Array
    sure: float


def _find_large(
    asked: SlipSearch, whole: VariantReadings, required: Sequence[Requirement], rivals: Sequence[Rival]
) -> MisstatedInput | None:
    """Return that readings need errors far beyond what was allowed for, or required; None where they do not.

    Parameters
    ----------
    asked : SlipSearch
        Of the readings without errors that drift, run already.
    whole : Readings
        With all their errors, which say what was allowed for.
    required : sequence of Requirement
    rivals : sequence of Rival
        Causes, of which the most probable one is said.
    """
    if asked.as_is is None:
        return None
    if (
        not _list_excesses(asked, asked.as_is, required, UNLIMITED_SEARCH_FRACTION)
        and _measure_misfit(asked.as_is).factor <= STATED
    ):
        return None
    search = asked
    if len(whole.posterior.errors.terms) > len(asked.posterior.errors.terms):
        search = SlipSearch(leave_out_outliers(whole), ())
    fit = search.fit_freely()
    if fit is None:
        return None
    for one in _list_excesses(search, fit, required):
        loss = _measure_loss(fit, one.most)
        if loss > one.sure:
            less = f"{format_significant(loss, 2)} nat less without"
            return MisstatedInput(LARGE, f"{one.said} ({less}){_say_rival(fit, rivals)}", one.factor, loss)
    misfit = _measure_misfit(fit)
    if misfit.factor <= STATED or not misfit.is_off:
        return None
    text = (
        f"residuals are {format_significant(misfit.factor, 2)} times the stated "
        f"noise{(' and model error' if search.posterior.errors.terms else '')}"
    )
    gain = 0.5 * misfit.dof * (misfit.factor**2 - 1.0 - 2.0 * float(np.log(misfit.factor)))
    return MisstatedInput(LARGE, f"{text}{_say_rival(fit, rivals)}", misfit.factor, gain)


def _say_rival(fit: CauseFit, rivals: Sequence[Rival]) -> str:
    """Return which single cause explains readings instead of a model error of any size, with its odds."""
    best = max(rivals, key=lambda one: one.value, default=None)
    if best is None or best.value - fit.value < -RIVAL_WITHIN_NAT:
        return "; no single cause explains as much"
    gain = best.value - fit.value
    odds = format_odds(gain) if gain > 0.0 else f"1 to {format_odds(-gain).removesuffix(' to 1')}"
    return f"; single cause, odds of {odds}: {best.text}"


def _measure_misfit(fit: CauseFit) -> ChiSquare:
    """Return the sum of squares of what noise as stated and errors as fitted leave."""
    factor, seen = fit.weigher.measure_misfit(fit.zeta), fit.weigher.seen
    n_spare = int(seen.n_spare.sum())
    return ChiSquare(factor**2 * n_spare, n_spare)


def _measure_loss(fit: CauseFit, most: Array) -> float:
    """Return by how many nats readings are explained worse by errors of coordinates that are at most so large."""
    weigher = fit.weigher
    found = profile(lambda zeta: weigher.weigh_each(np.minimum(zeta, most)), [np.minimum(fit.zeta, most)], levels=False)
    return weigher.weigh(fit.zeta) - weigher.weigh(np.minimum(found, most))


def _list_excesses(
    search: SlipSearch, fit: CauseFit, required: Sequence[Requirement], share: float = 1.0
) -> list[_Excess]:
    """Return by what a fitted model error exceeds `MAX_SIZE_RATIO` times its prior, and requirements, or a share."""
    errors = search.posterior.errors
    owners = zip(errors.owners, errors.units, strict=True)
    whose = [None if one is None or not _adds(one) else (one.of_model, unit) for one, unit in owners]
    return [*_exceed_allowed(search, fit, whose, share), *_exceed_required(search, fit, whose, required, share)]


type _Kind = tuple[bool, str] | None  # of an error that adds to readings: whether it is of the model, and its unit


def _exceed_allowed(search: SlipSearch, fit: CauseFit, whose: list[_Kind], share: float) -> Iterator[_Excess]:
    errors = search.posterior.errors
    sizes, middle = errors.natural(fit.zeta), errors.natural(np.zeros_like(fit.zeta))
    for kind in dict.fromkeys(one for one in whose if one is not None):
        mine = np.array([one == kind for one in whose])
        size, allowed = float(np.linalg.norm(sizes[mine])), float(middle[mine][sizes[mine].argmax()])
        if size <= share * MAX_SIZE_RATIO * allowed:
            continue
        amounts = [_say_size(search.readings, one, *kind) for one in (size, allowed)]
        text = f"the readings need errors of {amounts[0]}, beyond the {amounts[1].split(' at ')[0]} allowed"
        most = np.where(mine, np.minimum(fit.zeta, 0.0), fit.zeta)
        yield _Excess(size / allowed, text, most, SURE_OF_SIZE)


def _exceed_required(
    search: SlipSearch, fit: CauseFit, whose: list[_Kind], required: Sequence[Requirement], share: float
) -> Iterator[_Excess]:
    errors, at_tool = search.posterior.errors, _measure_at_tool(search, fit) if required else None
    for one in required if at_tool is not None else ():
        size = float(np.linalg.norm(at_tool[one.where])) if at_tool is not None else 0.0
        if size <= share * one.limit:
            continue
        unit = search.readings.model.tool_channels[one.where][0].unit
        amounts = [format_amount(x, unit) for x in (size, one.limit)]
        text = f"the readings need errors of {amounts[0]} at the tool, beyond the {amounts[1]} required of {one.name}"
        most, smaller = fit.zeta.copy(), errors.natural(fit.zeta) * one.limit / size
        for k, (prior, kind) in enumerate(zip(errors.priors, whose, strict=True)):
            if kind is not None and kind[0] and smaller[k] > 0.0:
                most[k] = prior.standardise(smaller[k])
        yield _Excess(size / one.limit, text, most, MIN_CAUSE_GAIN_NAT)


def _adds(term: ErrorTerm) -> bool:
    """Whether an error adds to readings, and is no factor on their noise."""
    return type(term).factor is ErrorTerm.factor


def _say_size(readings: VariantReadings, size: float, of_model: bool, unit: str) -> str:
    """Return the size of errors in words: of a model error at the tool, or in the noise where that has no lengths."""
    if not of_model:
        return format_amount(size, unit)
    if has_lengths(readings.model):
        return f"{format_amount(size, unit)} at the tool"
    return f"{format_significant(size / OF_NOISE, 2)} times the noise"


def _measure_at_tool(search: SlipSearch, fit: CauseFit) -> Array | None:
    """Return the rms of what fitted errors of own channels do to the tool's numbers, (m,); None where they move none.

    Each channel by itself moves the machine to where its own channels read so.
    """
    readings, model = search.readings, search.readings.model
    own = np.flatnonzero(readings.internal)
    some = np.unique(np.linspace(0, len(fit.weigher.seen.rows) - 1, AT_ONCE).astype(int))
    rows, pose = fit.weigher.seen.rows[some], fit.weigher.seen.pose[some]
    data = readings.posterior.likelihood.data.pick(rows)
    square = np.zeros(data.sd.shape)
    for term, zeta in readings.posterior.errors.of(fit.zeta[None]):
        if not term.of_model:
            continue
        if (variance := term.variance(zeta, data)) is not None:
            square = square + variance[0]
        if (columns := term.columns(zeta, data)) is not None:
            square = square + (columns[0] ** 2).sum(axis=-1)
    y, _ = fit.weigher.solve(fit.zeta)
    theta = readings.posterior.theta(np.append(y, np.zeros_like(fit.zeta))[None])[0]
    with np.errstate(all="ignore"):
        by_pose = model.tool(theta, pose, False)[1] * model.pose_scale
        moved = model.linearise(theta, pose, False, data.given).by_pose[:, own] * model.pose_scale
    good = np.isfinite(by_pose).all(axis=(1, 2)) & np.isfinite(moved).all(axis=(1, 2))
    if not good.any() or not len(own) or not by_pose.shape[2]:
        return None
    size = np.sqrt((moved[good] ** 2).mean(axis=(0, 2)))  # channels of several units
    size = np.where(size > 0.0, size, 1.0)
    moves = by_pose[good] @ np.linalg.pinv(moved[good] / size[:, None]) / size
    return np.asarray(np.sqrt((moves**2 @ square[good][:, own, None]).mean(axis=(0, 2))))
