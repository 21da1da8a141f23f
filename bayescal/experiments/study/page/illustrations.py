"""The figures of a study's page: what each shows, in words, and which must be left out for want of data."""

from __future__ import annotations

import re
from functools import partial

import pandas as pd

from bayescal.experiments.study.page.checks import read_prior_scale
from bayescal.experiments.study.page.figures.deformation import draw_deflections
from bayescal.experiments.study.page.figures.errors import draw_bounds, draw_error_bars
from bayescal.experiments.study.page.figures.flexure import choose_flexure, draw_flexure
from bayescal.experiments.study.page.figures.joints import draw_joints, find_magnification, has_joints, locate_joints
from bayescal.experiments.study.page.figures.overview import draw_overview
from bayescal.experiments.study.page.figures.parameters import draw_model_error, draw_parameters
from bayescal.experiments.study.page.figures.sensitivity import draw_sensitivity
from bayescal.experiments.study.page.publication import cite_figure
from bayescal.experiments.study.page.results import StudyResults
from bayescal.experiments.study.page.styles import assign_styles
from bayescal.experiments.study.page.variants import (
    choose_model,
    find_variants,
    group_variants,
    label_model,
    list_deformations,
    list_models,
    read_evidence,
)
from bayescal.report.blocks import Figure
from bayescal.report.numbers import format_plain
from bayescal.report.symbols import MODEL_ERROR, describe_deformation

BARS = (
    "each bar is as high as the largest error, the line across it is the mean, both as numbers. Errors of the "
    "posterior mean prediction with model error"
)


def illustrate_ranking(results: StudyResults) -> Figure:
    """Return evidence and pose errors of all variants."""
    use = results.use
    groups = [sorted(group, key=results.ranking.index) for group in group_variants(results, results.ranking)]
    behind: dict[tuple[str, str], float] = {}
    for setting in results.settings:
        best = max(read_evidence(results, name, setting) for name in results.ranking)
        behind |= {(name, setting): best - read_evidence(results, name, setting) for name in results.ranking}
    bands = " A shared band joins variants that fit equally well." if len(groups) > 1 else ""
    caption = (
        "Left: how far each variant's log-evidence with model error lies below the best one, logarithmic beyond 1 nat. "
        f"Middle: errors of the posterior mean prediction on the {use} poses; full bar: mean, pale bar: "
        "largest, both as numbers. Right: log-evidence with the model error set to zero, below the best of those."
        f"{bands} Position error is the distance between measured and predicted origin of the platform, "
        "orientation error the angle between measured and predicted platform."
    )
    errors, scales = results.table("pose_errors"), results.error_scales
    draw = partial(draw_overview, groups, behind, errors, scales, use, assign_styles(results))
    return Figure("errors", caption, draw)


def illustrate_errors(results: StudyResults) -> list[Figure]:
    """Return the bars of every deformation, on common axes; of a single model all deformations together."""
    styles = assign_styles(results)
    bars = partial(draw_error_bars, results.table("pose_errors"), results.error_scales)
    if len(list_models(results)) == 1:
        name = "errors_all"
        caption = f"{BARS[0].upper()}{BARS[1:]}{cite_figure(results.publication, name)}."
        return [Figure(name, caption, partial(bars, list(styles), styles, ""))]
    shown = []
    for k, deformation in enumerate(list_deformations(results), start=1):
        name = f"errors_{deformation if re.fullmatch(r'\w+', deformation, re.ASCII) else k}"
        words = describe_deformation(deformation)
        title = f"{words[0].upper()}{words[1:]}"
        after = cite_figure(results.publication, name)
        variants = find_variants(results, deformation=deformation)
        draw = partial(bars, variants, styles, title)
        shown.append(Figure(name, f"{title}{after}: {BARS}; the axes are the same for all deformations.", draw))
    return shown


def illustrate_bounds(results: StudyResults) -> Figure:
    """Return every pose's error in units of its bound."""
    caption = (
        "Position error of every pose in units of the 95 % bound that the posterior predicts for it (open: "
        "verification). One pose in twenty is expected beyond 1; many more, in red, mean a posterior that claims too "
        "much. The bound is the median over the poses."
    )
    draw = partial(draw_bounds, results.table("pose_errors"), results.ranking, assign_styles(results))
    return Figure("bounds", caption, draw)


def illustrate_parameters(results: StudyResults) -> Figure:
    """Return the intervals of the parameters of one model."""
    model, styles = choose_model(results), assign_styles(results)
    several = len(list_models(results)) > 1
    which = f" of the {label_model(results, model)} model, the study's first among the best," if several else ""
    caption = (
        f"Parameters{which} as offsets from nominal, with model error: posterior mean and 90 % interval of each "
        "variant; the band is the prior's central 90 %. Where an interval is as wide as the band the measurements "
        f"determine nothing.{' The other models: tables below.' if several else ''}"
    )
    shown = {name: styles[name] for name in find_variants(results, model)}
    published = results.table("least_squares")
    draw = partial(draw_parameters, _choose_free(results), published, shown, results.units)
    return Figure("parameters", caption, draw)


def illustrate_joints(results: StudyResults) -> Figure:
    """Return the joints from above, of the chosen model large."""
    frame, name = _choose_free(results), "hardpoints"
    if not has_joints(frame):
        reason = "the joints' coordinates a_x, a_y, b_x, b_y are not all free parameters"
        return Figure(name, "The joints from above.", None, reason)
    joints = locate_joints(frame)
    first = choose_model(results)
    models = sorted(list_models(results), key=lambda model: model != first)
    several = " The first model is shown large; of the others base and platform share one plan." * (len(models) > 1)
    caption = (
        f"The joints from above{cite_figure(results.publication, name)}: black dots are nominal, markers the posterior "
        "means (circle: no deformation, cross: linear, triangle: matrix), bars their standard deviations; moves and "
        f"deviations are magnified {format_plain(find_magnification(joints))} times. Full outline: base points a; "
        f"dashed: platform points b. In mm: rms distance of the points from nominal.{several} A model that lacks "
        "something real pushes the joints away from nominal to make up for it."
    )
    variants = {label_model(results, model): find_variants(results, model) for model in models}
    return Figure(name, caption, partial(draw_joints, joints, variants, assign_styles(results)))


def illustrate_flexure(results: StudyResults, flexure: pd.DataFrame) -> Figure:
    """Return how the end of the longest flexure moves."""
    rows, name = choose_flexure(flexure), "flexure"
    caption = (
        f"Displacement of a flexure joint of {format_plain(rows['flexure_length_mm'].iloc[0])} mm, bent by "
        f"δ{cite_figure(results.publication, name)}. Left: the path of its end, shortening Δx against deflection Δy; "
        "the scales differ, or else the paths were one line. Right: how far the circle and the ideal pivot lie from "
        "the beam at the same Δy, logarithmic."
    )
    return Figure(name, caption, partial(draw_flexure, rows))


def illustrate_deflections(results: StudyResults) -> Figure:
    """Return the measured deflections of the joints against the travel of the actuators."""
    name = "deflections"
    caption = (
        "Deflection of each leg's platform joint out of the rigid platform against the displacement of the leg's "
        f"own actuator{cite_figure(results.publication, name)}; full: calibration, open: verification; line: linear "
        "fit κ. Error bars (1 sd) are often smaller than the dots. Scatter beyond them is what κ cannot describe: the "
        "matrix K lets the other actuators in."
    )
    if not results.has("ring"):
        return Figure(name, caption, None, "the survey has no targets at the joints")
    return Figure(name, caption, partial(draw_deflections, results.table("ring"), results.table("deformation")))


def illustrate_model_error(results: StudyResults) -> Figure:
    """Return the model error of each leg and variant."""
    caption = "Model error τ: posterior mean and 90 % interval of each leg and variant, a panel per deformation."
    frame = _choose_free(results)
    if not (frame["symbol"] == MODEL_ERROR).any():
        return Figure("model_error", caption, None, "no variant has a model error")
    draw = partial(draw_model_error, frame, assign_styles(results), read_prior_scale(results))
    return Figure("model_error", caption, draw)


def illustrate_sensitivity(results: StudyResults) -> Figure:
    """Return the evidence against the widths of the priors."""
    caption = (
        "Log-evidence with model error against a factor on the widths of all parameters' priors, which keep their "
        "ratios. Left: each variant below its own largest value; right: each variant below the best one at the same "
        "factor, logarithmic beyond 1 nat. Models are shifted a little at each factor, so that equal ones do not "
        "overlap. "
        "The ranking is stable where no lines cross on the right (ranks: table below)."
    )
    return Figure("sensitivity", caption, partial(draw_sensitivity, results.sensitivity_grid, assign_styles(results)))


def _choose_free(results: StudyResults) -> pd.DataFrame:
    """Return the parameters of the posteriors whose model error is free."""
    return results.parameters[results.parameters["model_error"] == "free"]
