"""Which figures the report has, what each shows, and which must be left out for want of data."""

from __future__ import annotations

import re
from functools import partial

import pandas as pd

from bayescal.experiments.study.page.figures.deformation import draw_deflections
from bayescal.experiments.study.page.figures.errors import draw_bounds, draw_error_bars
from bayescal.experiments.study.page.figures.flexure import choose_flexure, draw_flexure
from bayescal.experiments.study.page.figures.joints import draw_joints, find_magnification, has_joints, locate_joints
from bayescal.experiments.study.page.figures.overview import draw_overview
from bayescal.experiments.study.page.figures.parameters import draw_model_error, draw_parameters
from bayescal.experiments.study.page.figures.ridges import draw_ridges
from bayescal.experiments.study.page.figures.sensitivity import draw_sensitivity
from bayescal.experiments.study.page.parameter_tables import choose_leg, rank_pairs
from bayescal.experiments.study.page.results import SETTINGS, Results
from bayescal.experiments.study.page.sections import read_prior_scale
from bayescal.experiments.study.page.styles import Styles, assign_styles
from bayescal.experiments.study.page.variants import (
    choose_model,
    describe_deformation,
    find_variants,
    group_variants,
    is_on_struts,
    label_model,
    label_variant,
    list_deformations,
    list_models,
    read_evidence,
)
from bayescal.report.page import Illustration
from bayescal.report.symbols import MODEL_ERROR, split_name

BARS = (
    "each bar is as high as the largest error, the line across it is the mean, both as numbers. Errors of the "
    "posterior mean prediction with model error"
)
REPORT_FIGURES = {"none": 15, "linear": 16, "matrix": 17}  # of RR-8096, by deformation


def list_illustrations(results: Results) -> list[Illustration]:
    """Return the report's figures in their order."""
    frame = results.parameters[results.parameters["model_error"] == "free"]
    styles = assign_styles(list(results.summary["variants"]))
    return [
        _show_overview(results, styles),
        *_list_errors(results, styles),
        _show_bounds(results, styles),
        _show_parameters(results, frame, styles),
        _show_joints(results, frame, styles),
        _show_flexure(results),
        _show_ridges(results, frame),
        _show_deflections(results),
        _show_model_error(results, frame, styles),
        Illustration(
            "sensitivity",
            "Log-evidence with model error against the prior tolerance of the lengths, one for all parameters in mm. "
            "Left: each variant below its own largest value; right: each variant below the best one at the same "
            "tolerance, logarithmic beyond 1 nat. Models stand a little side by side at each tolerance, so that equal "
            "ones are seen. The ranking is stable where no lines cross on the right (ranks: table below).",
            lambda: draw_sensitivity(results.sensitivity_grid, styles),
        ),
    ]


def _show_overview(results: Results, styles: Styles) -> Illustration:
    use = "verification" if results.n_verification else "calibration"
    groups = [sorted(group, key=results.ranking.index) for group in group_variants(results, results.ranking)]
    behind: dict[tuple[str, str], float] = {}
    for setting in SETTINGS:
        best = max(read_evidence(results, name, setting) for name in results.ranking)
        behind |= {(name, setting): best - read_evidence(results, name, setting) for name in results.ranking}
    bands = " A shared band joins variants that the evidence does not tell apart." if len(groups) > 1 else ""
    caption = (
        "Left: how far each variant's log-evidence with model error lies below the best one, logarithmic beyond 1 nat. "
        f"Middle and right: errors of the posterior mean prediction on the {use} poses; full bar: mean, pale bar: "
        "largest, both as numbers. Diamonds: the same with the model error set to zero (left: below the best of those; "
        f"else: mean).{bands} Position error is the distance between measured and predicted origin of the platform, "
        "orientation error the angle between measured and predicted platform."
    )
    draw = partial(draw_overview, groups, behind, results.predictions, use, styles)
    return Illustration("errors", caption, draw)


def _list_errors(results: Results, styles: Styles) -> list[Illustration]:
    """Return the bars of every deformation, on common axes; of a single model all deformations together."""
    on_struts = is_on_struts(results)  # RR-8096's telescope is not
    if len(list_models(results)) == 1:
        names = list(styles)
        draw = partial(draw_error_bars, results.predictions, names, styles, "")
        caption = f"{BARS[0].upper()}{BARS[1:]}." if on_struts else f"After RR-8096 figures 15 to 17: {BARS}."
        return [Illustration("errors_all", caption, draw, section="errors")]
    shown = []
    for k, deformation in enumerate(list_deformations(results), start=1):
        known = deformation in REPORT_FIGURES and not on_struts
        after = f" (after RR-8096 figure {REPORT_FIGURES[deformation]})" if known else ""
        words = describe_deformation(deformation)
        title = f"{words[0].upper()}{words[1:]}"
        name = deformation if re.fullmatch(r"\w+", deformation, re.ASCII) else str(k)
        names = find_variants(results, deformation=deformation)
        draw = partial(draw_error_bars, results.predictions, names, styles, title)
        caption = f"{title}{after}: {BARS}; the axes are the same for all deformations."
        shown.append(Illustration(f"errors_{name}", caption, draw, section="errors"))
    return shown


def _show_bounds(results: Results, styles: Styles) -> Illustration:
    caption = (
        "Position error of every pose in units of the 95 % bound that the posterior predicts for it (open: "
        "verification). One pose in twenty is expected beyond 1; many more, in red, mean a posterior that claims too "
        "much. The bound is the median over the poses."
    )
    return Illustration("bounds", caption, partial(draw_bounds, results.predictions, results.ranking, styles))


def _show_parameters(results: Results, frame: pd.DataFrame, styles: Styles) -> Illustration:
    model = choose_model(results)
    names = find_variants(results, model)
    several = len(list_models(results)) > 1
    which = f" the {label_model(model)} model, the study's first among the best," if several else ""
    caption = (
        f"Parameters of{which} as offsets from nominal, with model error: posterior mean and 90 % interval of each "
        "variant; the band is the prior's central 90 %. An interval as wide as the band has learnt nothing from the "
        f"measurements.{' The other models: tables below.' if several else ''}"
    ).replace("Parameters of as", "Parameters as")
    shown = {name: styles[name] for name in names}
    return Illustration("parameters", caption, partial(draw_parameters, frame, results.least_squares, shown))


def _show_joints(results: Results, frame: pd.DataFrame, styles: Styles) -> Illustration:
    if not has_joints(frame):
        reason = "the joints' coordinates a_x, a_y, b_x, b_y are not all free parameters"
        return Illustration("hardpoints", "The joints from above.", None, reason)
    joints = locate_joints(frame)
    first = choose_model(results)
    models = sorted(list_models(results), key=lambda model: model != first)
    after = "" if is_on_struts(results) else ", after RR-8096 figure 18"
    several = " The first model is shown large; of the others base and platform stand in one plan." * (len(models) > 1)
    caption = (
        f"The joints from above{after}: black dots are nominal, markers the posterior means (circle: "
        "no deformation, cross: linear, triangle: matrix), bars their standard deviations; moves and deviations are "
        f"magnified {find_magnification(joints):g} times. Full outline: base points a; dashed: platform points b. "
        f"In mm: rms distance of the points from nominal.{several} A model that lacks something real pushes the joints "
        "away from nominal to make up for it."
    )
    variants = {label_model(model): find_variants(results, model) for model in models}
    return Illustration("hardpoints", caption, partial(draw_joints, joints, variants, styles))


def _show_flexure(results: Results) -> Illustration:
    if results.flexure is None:
        return Illustration("flexure", "Displacement of a flexure joint.", None, "no model has flexure joints")
    rows = choose_flexure(results.flexure)
    caption = (
        f"Displacement of a flexure joint of {rows['flexure_length_mm'].iloc[0]:g} mm, bent by δ (after RR-8096 figure "
        "9). Left: the path of its end, shortening Δx against deflection Δy; the scales differ, or else the paths were "
        "one line. Right: how far the circle of eq. (13) and the ideal pivot lie from the beam at the same Δy, "
        "logarithmic."
    )
    return Illustration("flexure", caption, partial(draw_flexure, rows))


def _show_ridges(results: Results, frame: pd.DataFrame) -> Illustration:
    best = results.ranking[0]
    if best not in results.draws:
        reason = f"it needs the draws of {label_variant(best)}, whose file is not there"
        return Illustration("ridges", "Correlations within a leg.", None, reason)
    draws = results.draws[best]
    leg, pairs = choose_leg(rank_pairs(draws))
    if not pairs:
        return Illustration("ridges", "Correlations within a leg.", None, "no leg has two parameters")
    table = pd.DataFrame({split_name(n)[0]: x for n, x in draws.items() if split_name(n)[1] == leg})
    if len(table.columns.drop(MODEL_ERROR, errors="ignore")) < 2:
        return Illustration("ridges", "Correlations within a leg.", None, "each leg has one parameter of its geometry")
    one = frame[(frame["variant"] == best) & (frame["leg"] == leg)].set_index("symbol")
    nominal = one["nominal"].where(one.index != MODEL_ERROR, 0.0)
    caption = (
        f"{label_variant(best)}, leg {leg} (the one with the most correlated pair): correlation of its parameters "
        "(red +1, blue −1), and the draws of its most correlated pairs as offsets from nominal. A thin slanting cloud "
        "is a ridge: the measurements fix only what lies across it."
    )
    return Illustration("ridges", caption, partial(draw_ridges, table, nominal, one["unit"], pairs))


def _show_deflections(results: Results) -> Illustration:
    after = "" if is_on_struts(results) else ", after RR-8096 figure 7"
    caption = (
        "Deflection of each leg's platform joint out of the rigid platform against the displacement of the leg's "
        f"own actuator{after}; full: calibration, open: verification; line: linear fit κ. Error "
        "bars (1 sd) are often smaller than the dots. Scatter beyond them is what κ cannot describe: the matrix K "
        "lets the other actuators in."
    )
    ring, deformation = results.ring, results.deformation
    if ring is None or deformation is None:
        return Illustration("deflections", caption, None, "the survey has no targets at the joints")
    return Illustration("deflections", caption, partial(draw_deflections, ring, deformation))


def _show_model_error(results: Results, frame: pd.DataFrame, styles: Styles) -> Illustration:
    caption = "Model error τ: posterior mean and 90 % interval of each leg and variant, a panel per deformation."
    if not (frame["symbol"] == MODEL_ERROR).any():
        return Illustration("model_error", caption, None, "no variant has a model error")
    return Illustration("model_error", caption, partial(draw_model_error, frame, styles, read_prior_scale(results)))
