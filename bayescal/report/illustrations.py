"""Which figures the report has, what each shows, and which must be left out for want of data."""

from __future__ import annotations

import io
from collections.abc import Callable
from dataclasses import dataclass

import pandas as pd
from matplotlib import rc_context
from matplotlib.figure import Figure

from bayescal.report.figures.deformation import draw_deflections
from bayescal.report.figures.errors import draw_bounds, draw_error_bars
from bayescal.report.figures.evidence import draw_sensitivity
from bayescal.report.figures.parameters import (
    draw_hardpoints,
    draw_model_error,
    draw_parameters,
    find_magnification,
    has_hardpoints,
)
from bayescal.report.figures.ridges import draw_ridges
from bayescal.report.figures.style import RC
from bayescal.report.parameter_tables import choose_leg, rank_pairs
from bayescal.report.results import MODEL_ERROR, Results, split_name
from bayescal.report.sections import read_prior_scale

DPI = 120


@dataclass(frozen=True)
class Illustration:
    """A figure to draw, or the reason why it cannot be drawn."""

    name: str
    caption: str
    draw: Callable[[], Figure] | None
    reason: str = ""


def list_illustrations(results: Results) -> list[Illustration]:
    """Return the report's figures in their order."""
    frame = results.parameters[results.parameters["model_error"] == "free"]
    return [
        *_list_errors(results),
        *_list_parameters(results, frame),
        _list_ridges(results, frame),
        _list_deflections(results),
        _list_model_error(results, frame),
        _list_sensitivity(results),
    ]


def render_png(draw: Callable[[], Figure]) -> bytes:
    """Return a figure as PNG; the same figure gives the same bytes."""
    buffer = io.BytesIO()
    with rc_context(RC):  # type: ignore[arg-type]  # its keys are a literal type of three hundred names
        draw().savefig(buffer, format="png", dpi=DPI, metadata={"Software": None})
    return buffer.getvalue()


def _list_errors(results: Results) -> list[Illustration]:
    names = results.ranking
    bars = (
        "Pose errors of the posterior mean prediction. Pale bar: largest error; full bar: mean; both as numbers at "
        "its end. Diamond: mean with the model error set to zero. Position error is the distance between measured "
        "and predicted platform centre, orientation error the angle between measured and predicted platform."
    )
    bounds = (
        "Position error of every pose (dots; open: verification) and the 95 % bound the posterior predicts for it "
        "(bars). Crosses lie above their bound: one in twenty is expected, many more mean a posterior that claims "
        "too much."
    )
    return [
        Illustration("errors", bars, lambda: draw_error_bars(results.predictions, names)),
        Illustration("bounds", bounds, lambda: draw_bounds(results.predictions, names)),
    ]


def _list_parameters(results: Results, frame: pd.DataFrame) -> list[Illustration]:
    names = results.ranking
    intervals = (
        "Parameters as offsets from nominal, with model error: posterior mean and 90 % interval of each variant; "
        "the band is the prior's central 90 %. An interval as wide as the band has learnt nothing from the "
        "measurements."
    )
    shown = Illustration("parameters", intervals, lambda: draw_parameters(frame, results.least_squares, names))
    if not has_hardpoints(frame):
        reason = "the joints' coordinates a_x, a_y, b_x, b_y are not all free parameters"
        return [shown, Illustration("hardpoints", "The joints from above.", None, reason)]
    view = (
        "The joints from above, after RR-8096 figure 18: open circles are nominal, markers the posterior means with "
        f"their standard deviations, both moves and deviations magnified {find_magnification(frame):g} times. "
        "Numbers are legs. A model that lacks something real pushes the joints away from nominal to make up for it."
    )
    return [shown, Illustration("hardpoints", view, lambda: draw_hardpoints(frame, names))]


def _list_ridges(results: Results, frame: pd.DataFrame) -> Illustration:
    best = results.ranking[0]
    if best not in results.draws:
        return Illustration(
            "ridges", "Correlations within a leg.", None, f"it needs the draws of {best}, whose file is not there"
        )
    draws = results.draws[best]
    leg, pairs = choose_leg(rank_pairs(draws))
    if not pairs:
        return Illustration("ridges", "Correlations within a leg.", None, "no leg has two parameters")
    table = pd.DataFrame({split_name(n)[0]: x for n, x in draws.items() if split_name(n)[1] == leg})
    one = frame[(frame["variant"] == best) & (frame["leg"] == leg)].set_index("symbol")
    nominal = one["nominal"].where(one.index != MODEL_ERROR, 0.0)
    caption = (
        f"{best}, leg {leg} (the one with the most correlated pair): correlation of its parameters, and the draws of "
        "its most correlated pairs as offsets from nominal. A thin slanting cloud is a ridge: the measurements fix "
        "only what lies across it."
    )
    return Illustration("ridges", caption, lambda: draw_ridges(table, nominal, one["unit"], pairs))


def _list_deflections(results: Results) -> Illustration:
    caption = (
        "Deflection of each leg's platform joint out of the rigid platform against the displacement of the leg's "
        "own actuator, after RR-8096 figure 7; full: calibration, open: verification; line: linear fit κ. Error "
        "bars (1 sd) are often smaller than the dots. Scatter beyond them is what κ cannot describe: the matrix K "
        "lets the other actuators in."
    )
    ring, deformation = results.ring, results.deformation
    if ring is None or deformation is None:
        return Illustration("deflections", caption, None, "the survey has no targets at the joints")
    return Illustration("deflections", caption, lambda: draw_deflections(ring, deformation))


def _list_model_error(results: Results, frame: pd.DataFrame) -> Illustration:
    caption = "Model error τ: posterior mean and 90 % interval of each leg and variant."
    if not (frame["symbol"] == MODEL_ERROR).any():
        return Illustration("model_error", caption, None, "no variant has a model error")
    return Illustration(
        "model_error", caption, lambda: draw_model_error(frame, results.ranking, read_prior_scale(results))
    )


def _list_sensitivity(results: Results) -> Illustration:
    caption = (
        "Log-evidence with model error against the prior tolerance of the lengths. Left: each variant below its own "
        "largest value; right: each variant below the best one at the same tolerance, logarithmic beyond 1 nat. The "
        "ranking is stable where no lines cross on the right (ranks: table below)."
    )
    return Illustration("sensitivity", caption, lambda: draw_sensitivity(results.sensitivity_grid))
