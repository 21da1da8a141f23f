"""What was found of errors that are functions: whether there are any, how large they are, and how they run.

Those of [error_terms] have tables of their own, in the channels' units; the terms of a model error have those that
pages of all machines read, in µm at the tool, or in multiples of the channels' noise where the tool has no lengths.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from bayescal.density.calibration.functions import FunctionErrors
from bayescal.density.calibration.likelihood import CalibrationPosterior
from bayescal.density.calibration.measurements import Measurements
from bayescal.density.calibration.model_error import OF_NOISE, GPTerm, RandomTerm
from bayescal.density.calibration.terms import CommonDraws, ErrorModel
from bayescal.density.low_rank import BUDGET
from bayescal.density.pose_kernels import OWN
from bayescal.density.priors import BORDER
from bayescal.density.schema import TERMS, ModelErrorConfig
from bayescal.experiments.runner.memory import MemoryEstimate, check_memory
from bayescal.experiments.shared.rows import (
    SYSTEMATIC_TOTAL,
    USES,
    ErrorCurveRow,
    ErrorFunctionRow,
    ModelErrorAloneRow,
    ModelErrorMemberRow,
    ModelErrorPoseRow,
    ModelErrorRow,
)
from bayescal.experiments.shared.unmodelled_bias import tabulate_hidden
from bayescal.identifiability.hidden import choose_unseen, hide_in_posterior
from bayescal.machines.readings import ReadingModel
from bayescal.numerics.geometry import Array
from bayescal.numerics.heavy_tails import measure_tail
from bayescal.numerics.units import ARCSECOND, MICROMETRE

if TYPE_CHECKING:
    import pandas as pd

CURVE = 25
CENTRED = 200
"""Rows, over which functions have a mean of zero."""
SHOWN = {"mm": (1.0 / MICROMETRE, "um"), "rad": (1.0 / ARCSECOND, "arcsec")}
INTERVAL = [0.05, 0.95]
REMEDY = "fewer poses, a longer length"


def has_lengths(model: ReadingModel) -> bool:
    """Whether errors of own channels have a size in mm at the tool, and not by the channels' noise alone."""
    return bool(model.tool_lengths) and bool(model.coordinates)


def choose_size_unit(model: ReadingModel) -> tuple[float, str]:
    """Return how many units of the sizes of model errors make a mm at the tool, and their name as tables have it."""
    return (1.0 / MICROMETRE, "um") if has_lengths(model) else (1.0 / OF_NOISE, "noise")


def check_functions(term: FunctionErrors, n_poses: int, n_channels: int) -> None:
    """Raise InputError where functions need more memory than there is."""
    n = len(term.places) * term.root(np.array([term.length])).shape[-1]
    held = 6.0 * BUDGET + n_poses * n_channels * n * (8.0 + 2.0 * len(term.names)) + 4.0 * n**2
    check_memory(
        MemoryEstimate(each=8.0 * held, sizes=f"{n_poses} poses with {n} coefficients of functions", remedy=REMEDY), 1
    )


def tabulate_functions(
    variant: str, posterior: CalibrationPosterior, y: Array, rng: np.random.Generator
) -> dict[str, pd.DataFrame]:
    """Return what draws (T, n) tell of functions, from errors common to all rows that are drawn; none without any.

    ``functions`` has of each how probable an error is, its scale, and its size over the calibration poses, µm and
    arcsec; ``function_curves`` its course over what it depends on, where that is one number.
    """
    import pandas as pd  # a third of a second, for those who have tables

    if not posterior.errors.terms_of(FunctionErrors):
        return {}
    draws, data = posterior.likelihood.draw_common(*posterior.at(y), rng), posterior.likelihood.data
    grid, rows, curves = _grid(data), list[ErrorFunctionRow](), list[pd.DataFrame]()
    terms = (zeta for _, zeta in posterior.errors.of(posterior.zeta(y)))
    by_term = zip(terms, draws.by_term(data), draws.by_term(grid), strict=True)
    for term, (zeta, errors, course) in posterior.errors.select_of(FunctionErrors, by_term):
        if errors is None or course is None:
            continue
        for k, group in zip(term.places, term.group, strict=True):
            factor, unit = SHOWN.get(term.scale_units[group], (1.0, term.scale_units[group]))
            size = factor * np.sqrt(np.mean(errors[:, data.present[:, k], k] ** 2, axis=1))
            low, high = np.quantile(size, INTERVAL)
            sensor, of = posterior.likelihood.model.names[k], term.travel.of
            scale = term.scales(zeta)[:, group]
            there = scale[scale > 0.0]
            rows.append(
                ErrorFunctionRow(
                    variant=variant,
                    sensor=sensor,
                    input=of,
                    unit=unit,
                    kernel=term.kernel,
                    probability_present=float((zeta[:, group] > BORDER).mean()),
                    scale_stated=factor * float(term.scale[group]),
                    scale=factor * float(np.median(there)) if len(there) > 1 else float("nan"),
                    log_scale_sd_ratio=float(np.log(there).std() / term.spread) if len(there) > 1 else float("nan"),
                    rms=float(size.mean()),
                    rms_low=float(low),
                    rms_high=float(high),
                )
            )
            if term.rows is None:
                low, high = np.quantile(course[..., k], INTERVAL, axis=0)
                curve = ErrorCurveRow.tabulate(
                    variant=variant,
                    sensor=sensor,
                    input=of,
                    unit=unit,
                    reading=grid.values[:, k] if of == "reading" else 1.0 + grid.order,
                    mean=factor * course[..., k].mean(axis=0),
                    low=factor * low,
                    high=factor * high,
                )
                curves.append(curve)
    found = {"functions": ErrorFunctionRow.collect(rows)}
    return found | ({"function_curves": pd.concat(curves, ignore_index=True)} if curves else {})


def _grid(data: Measurements) -> Measurements:
    """Return rows over what was read, evenly, and over the order of the rows."""
    low, high = (pick(np.where(data.present, data.values, np.nan), axis=0) for pick in (np.nanmin, np.nanmax))
    values, order = np.linspace(low, high, CURVE), np.linspace(data.order.min(), data.order.max(), CURVE).astype(int)
    return replace(
        data, poses=tuple(map(str, range(CURVE))), values=values, sd=np.ones_like(values), correlation=None, order=order
    )


# --- the terms of a model error ------------------------------------------------------------------------------------


def tabulate_model_error(
    variant: str,
    data: Measurements,
    held: np.ndarray,
    posterior: CalibrationPosterior,
    y: Array,
    draws: CommonDraws,
    error: ModelErrorConfig,
    rng: np.random.Generator,
) -> dict[str, pd.DataFrame]:
    """Return what each term of a model error contributes as tables by name, with its unit; none without terms.

    Sizes are in the unit of `choose_size_unit`.

    ``model_error`` has root mean squares over calibration rows and own channels, of each term and of all functions
    together, and by how much a function's standard deviation exceeds that of its interval (`measure_tail`);
    ``model_error_members`` those of each channel, of the posterior mean of each term; ``model_error_poses`` all
    functions together at every row; ``model_error_bias`` what errors that leave no trace hide of each parameter;
    ``model_error_alone`` how far one sort of functions explains all.

    Parameters
    ----------
    data : Measurements
        Of all M rows.
    held : ndarray of bool, shape (M,)
        Which of them are held back.
    posterior : CalibrationPosterior
        Of the others.
    y : ndarray, shape (T, n)
        Draws.
    draws : CommonDraws
        Of the errors common to all rows, one for each.
    error : ModelErrorConfig
        What is stated of it.
    rng : Generator
        For evidences.
    """
    from bayescal.inference.causes import weigh_causes  # with all of inference, for those who sample

    zeta = posterior.zeta(y)
    tau = [one.square(own) for one, own in posterior.errors.parts_of(RandomTerm, zeta)]
    factor, unit = choose_size_unit(posterior.likelihood.model)
    sizes: dict[str, Array] = {TERMS[0]: np.sqrt(np.mean(tau, axis=0))} if tau else {}
    centre = _find_centre(data, ~held, posterior.errors, draws)
    found = [_summarise(part, ~held[rows], posterior.errors, draws, centre) for rows, part in data.split()]
    names, functions = found[0].names, [name for name in found[0].square if name != SYSTEMATIC_TOTAL]
    for name in found[0].square:
        square, n_numbers = sum(one.square[name] for one in found), len(names) * int((~held).sum())
        sizes[name] = np.sqrt(square / n_numbers)
    quantiles = {name: factor * np.quantile(one, [0.5, *INTERVAL]) for name, one in sizes.items()}
    tails = {one.sort: measure_tail(one.amplitude(own)) for one, own in posterior.errors.parts_of(GPTerm, zeta)}
    middle, low, high = np.array(list(quantiles.values())).reshape(-1, 3).T
    tail = [tails.get(name, float("nan")) for name in quantiles]
    tables = {
        "model_error": ModelErrorRow.tabulate(
            variant=variant, term=list(quantiles), unit=unit, median=middle, q05=low, q95=high, tail=tail
        )
    }
    if functions:
        means = {name: np.concatenate([one.mean[name] for one in found]) for name in found[0].mean}
        mean, (low, high) = means[SYSTEMATIC_TOTAL], np.concatenate([one.interval for one in found], axis=1)
        by_member = {name: np.sqrt(np.mean(means[name][~held] ** 2, axis=0)) for name in functions}
        tables["model_error_members"] = ModelErrorMemberRow.tabulate(
            variant=variant,
            member=np.repeat(names, len(by_member)),
            term=list(by_member) * len(names),
            unit=unit,
            rms=factor * np.stack(list(by_member.values()), axis=1).ravel(),
        )
        tables["model_error_poses"] = ModelErrorPoseRow.tabulate(
            variant=variant,
            pose=np.repeat(data.poses, len(names)),
            use=np.repeat(np.where(held, *reversed(USES)), len(names)),
            member=np.tile(names, data.n_poses),
            unit=unit,
            mean=factor * mean.ravel(),
            low=factor * low.ravel(),
            high=factor * high.ravel(),
        )
        hidden, n = (hide_in_posterior(posterior, y, choose_unseen(error.lengths(), functions)), posterior.n_geometry)
        sd = posterior.natural(y)[:, :n].std(axis=0)
        known = posterior.sampling.names, posterior.units[:n]
        tables["model_error_bias"] = tabulate_hidden(variant, *known, hidden, sd)
        # by how many nats one cause alone, or none, explains the data better than all, and its size then
        alone = weigh_causes(posterior, y.mean(axis=0), rng)
        middle, low, high = factor * np.array([one[1:] for one in alone.values()]).reshape(-1, 3).T
        tables["model_error_alone"] = ModelErrorAloneRow.tabulate(
            variant=variant,
            term=list(alone),
            log_bayes_factor=[one.log_odds for one in alone.values()],
            unit=unit,
            median=middle,
            q05=low,
            q95=high,
        )
    return {name: one for name, one in tables.items() if len(one)}


@dataclass(frozen=True, eq=False)
class _Functions:
    """Functions of the pose of N own channels at P rows, mm at the tool, by sort and together."""

    names: list[str]  # of the channels
    square: dict[str, Array]  # (T,): of each draw, the sum over calibration rows and channels
    mean: dict[str, Array]  # (P, N)
    interval: Array  # (2, P, N): of all together


def _draw_functions(data: Measurements, errors: ErrorModel, draws: CommonDraws) -> tuple[list[str], dict[str, Array]]:
    """Return names of own channels, and draws (T, P, N) of each sort of functions at rows, mm at the tool."""
    names, functions = list[str](), dict[str, Array]()
    for term, found in errors.select_of(GPTerm, draws.by_term(data) or [None] * len(errors.terms)):
        if found is not None:
            names = list(term.own.names)
            functions[term.sort] = found[..., term.own.places] * term.own.levers
    return names, functions


def _find_centre(data: Measurements, used: np.ndarray, errors: ErrorModel, draws: CommonDraws) -> Array:
    """Return means (T, 1, N) of functions of the own position over calibration rows: a channel's zero may be as well.

    Of many rows some are enough.
    """
    rows = np.flatnonzero(used)
    rows = rows[np.linspace(0, len(rows) - 1, min(len(rows), CENTRED)).astype(int)]
    _, functions = _draw_functions(data.pick(rows), errors, draws)
    return functions[OWN].mean(axis=1, keepdims=True) if OWN in functions else np.zeros((1, 1, 1))


def _summarise(
    data: Measurements, used: np.ndarray, errors: ErrorModel, draws: CommonDraws, centre: Array
) -> _Functions:
    """Return what draws have of the functions at rows, of which some are for calibration; see `_find_centre`."""
    names, functions = _draw_functions(data, errors, draws)
    if OWN in functions:
        functions[OWN] = functions[OWN] - centre
    if functions:
        functions[SYSTEMATIC_TOTAL] = np.asarray(sum(functions.values()))
    square = {name: np.sum(one[:, used] ** 2, axis=(1, 2)) for name, one in functions.items()}
    interval = np.quantile(functions[SYSTEMATIC_TOTAL], INTERVAL, axis=0) if functions else np.zeros((2, 0, 0))
    return _Functions(names, square, {name: one.mean(axis=0) for name, one in functions.items()}, interval)
