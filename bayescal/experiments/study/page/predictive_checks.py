"""How the posteriors are checked: chains by their ranks, predictions by left-out poses, prior and data by weights."""

from __future__ import annotations

from functools import partial

import pandas as pd

from bayescal.experiments.shared.judgement_page import tabulate_power_scaling
from bayescal.experiments.study.page.figures.judgement import draw_pareto_k, draw_pits, draw_ranks, draw_replicates
from bayescal.experiments.study.page.results import SETTINGS, StudyResults
from bayescal.experiments.study.page.styles import assign_styles
from bayescal.experiments.study.page.variants import label_variant
from bayescal.limits import PARETO_K_LIMIT
from bayescal.report.blocks import Block, Figure, Fold

COMPONENT_PITS = ("x_pit", "y_pit", "z_pit", "rx_pit", "ry_pit", "rz_pit")


def fold_checks(results: StudyResults) -> list[Block]:
    """Return the checks of the best variant, and those of all, each behind a line."""
    best = label_variant(results, results.best_name)
    folds: list[Block] = []
    if "x_pit" in results.table("poses"):
        title = f"Poses left out: where they lie in the predictions of {best} (LOO-PIT)"
        folds.append(Fold(title, (_illustrate_pits(results),)))
        title = f"Errors of poses and of their replicates, {best} (posterior predictive check)"
        folds.append(Fold(title, (_illustrate_replicates(results),)))
    folds.append(Fold("Pareto k of every pose left out", (_illustrate_pareto_k(results),)))
    folds.append(Fold(f"Chains of {best} (rank plot)", (_illustrate_ranks(results),)))
    own = results.table("parameters", results.best_name)
    own = own[(own["model_error"] == "free") & own["prior_sensitivity"].notna()]
    if len(own):
        folds.append(Fold(f"Sensitivity of {best} to prior and data (power scaling)", (tabulate_power_scaling(own),)))
    return folds


def _illustrate_ranks(results: StudyResults) -> Figure:
    best, name = results.ranking[0], "ranks"
    caption = (
        "Each chain's share of the draws below a rank, less the expected share, a line for each parameter and chain. "
        "Band: 95 % of as many independent draws as the smallest bulk ESS says, one parameter at a time. A chain that "
        "leaves it together with others of its colour has not seen what the others have."
    )
    if best not in results.draws:
        return Figure(name, caption, None, _say_missing(results))
    n_draws = len(next(iter(results.draws[best].values())))
    effective = min(float(results.best["ess_bulk_min"]), float(n_draws))
    return Figure(name, caption, partial(draw_ranks, results.draws[best], results.n_chains, effective))


def _say_missing(results: StudyResults) -> str:
    return f"it needs the draws of {label_variant(results, results.ranking[0])}, whose file is not there"


def _illustrate_pits(results: StudyResults) -> Figure:
    caption = (
        "Share of the measured components (x, y, z and three angles of every calibration pose, each pose left out) "
        "below a quantile of their predictions, less the expected share, with model error and without. Band: 95 % of "
        "independent uniform numbers. An S that falls first and rises then means predictions too wide, the other way "
        "round too narrow, a hump to one side a bias."
    )
    table = results.table("poses")[results.table("poses")["use"] == "calibration"]
    pits = {}
    for setting, words in SETTINGS.items():
        chosen = table[(table["variant"] == results.ranking[0]) & (table["model_error"] == setting)]
        values = chosen[list(COMPONENT_PITS)].to_numpy(dtype=float).ravel()
        pits[words[0].upper() + words[1:]] = values[pd.notna(values)]
    if not all(len(values) > 2 for values in pits.values()):
        return Figure("loo_pit", caption, None, "no component of a pose is measured")
    return Figure("loo_pit", caption, partial(draw_pits, pits))


def _illustrate_replicates(results: StudyResults) -> Figure:
    caption = (
        "Errors of the calibration poses against the mean prediction, sorted, with those that replicates of the "
        "measurement would have (band: 95 %; line: median), with model error. A posterior that has seen a "
        "pose fits it somewhat better than a replicate. Poses far left of the band: noise or model error too large; "
        "right of it: too small, at the upper end single poses that are blunders."
    )
    seen = results.replicates
    if seen is None:
        return Figure("replicates", caption, None, _say_missing(results))
    return Figure("replicates", caption, partial(draw_replicates, seen.misfit, results.units))


def _illustrate_pareto_k(results: StudyResults) -> Figure:
    caption = (
        "Pareto k of the weights that leave a calibration pose out, with model error. Above the line "
        f"({PARETO_K_LIMIT}) the weights fail; such a pose (open) was left out by a run of its own, unless more than "
        "ten poses of a posterior are as bad."
    )
    table = results.table("poses")
    chosen = table[(table["model_error"] == "free") & (table["use"] == "calibration")]
    draw = partial(draw_pareto_k, chosen, results.ranking, assign_styles(results))
    return Figure("pareto_k", caption, draw)
