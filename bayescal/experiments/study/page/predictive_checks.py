"""How the posteriors are checked: chains by their ranks, predictions by left-out poses, prior and data by weights."""

from __future__ import annotations

from functools import partial

import pandas as pd

from bayescal.experiments.study.page.figures.judgement import draw_pareto_k, draw_pits, draw_ranks, draw_replicates
from bayescal.experiments.study.page.results import SETTINGS, StudyResults
from bayescal.experiments.study.page.styles import assign_styles
from bayescal.experiments.study.page.variants import label_variant
from bayescal.limits import PARETO_K_LIMIT
from bayescal.report.blocks import Block, Cell, Column, Figure, Fold, Statement, Table, make_table
from bayescal.report.numbers import format_fixed, join_words
from bayescal.report.symbols import split_name

SENSITIVE = 0.05
"""Change of a posterior per doubling of a power, as a distance of distributions, from which on it counts."""
COMPONENT_PITS = ("x_pit", "y_pit", "z_pit", "rx_pit", "ry_pit", "rz_pit")


def fold_checks(results: StudyResults) -> list[Block]:
    """Return the checks of the best variant, and those of all, each behind a line."""
    best = label_variant(results, results.ranking[0])
    folds: list[Block] = [
        Fold(f"Poses left out: where they lie in the predictions of {best} (LOO-PIT)", (_illustrate_pits(results),)),
        Fold(
            f"Errors of poses and of their replicates, {best} (posterior predictive check)",
            (_illustrate_replicates(results),),
        ),
        Fold("Pareto k of every pose left out", (_illustrate_pareto_k(results),)),
        Fold(f"Chains of {best} (rank plot)", (_illustrate_ranks(results),)),
    ]
    table = tabulate_power_scaling(results)
    if table is not None:
        folds.append(Fold(f"What prior and measurements do to {best} (power scaling)", (table,)))
    return folds


def _illustrate_ranks(results: StudyResults) -> Figure:
    best, name = results.ranking[0], "ranks"
    caption = (
        "Each chain's share of the draws below a rank, less the expected share, a line for each parameter and chain. "
        "Band: 95 % of as many independent draws as the smallest bulk ESS says, one parameter at a time. A chain that "
        "leaves it together with others of its colour has not seen what the others have."
    )
    if best not in results.draws or results.replicates is None:
        return Figure(name, caption, None, _say_missing(results))
    n_draws = len(next(iter(results.draws[best].values())))
    effective = min(float(results.best["ess_bulk_min"]), float(n_draws))
    return Figure(name, caption, partial(draw_ranks, results.draws[best], results.replicates.n_chains, effective))


def _say_missing(results: StudyResults) -> str:
    return f"it needs the draws of {label_variant(results, results.ranking[0])}, whose file is not there"


def _illustrate_pits(results: StudyResults) -> Figure:
    caption = (
        "Share of the measured components (x, y, z and three angles of every calibration pose, each pose left out) "
        "below a quantile of their predictions, less the expected share, with model error and without. Band: 95 % of "
        "independent uniform numbers. An S that falls first and rises then means predictions too wide, the other way "
        "round too narrow, a hump to one side a bias."
    )
    table = results.left_out[results.left_out["use"] == "calibration"]
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
        "Errors of the calibration poses against the mean prediction, sorted, beside those that replicates of the "
        "measurement would have (band: 95 %; line: median), with model error. A posterior that has seen a "
        "pose fits it somewhat better than a replicate. Poses far left of the band: noise or model error too large; "
        "right of it: too small, at the upper end single poses that are blunders."
    )
    seen = results.replicates
    if seen is None:
        return Figure("replicates", caption, None, _say_missing(results))
    return Figure("replicates", caption, partial(draw_replicates, seen.misfit))


def _illustrate_pareto_k(results: StudyResults) -> Figure:
    caption = (
        "Pareto k of the weights that leave a calibration pose out, with model error. Above the line "
        f"({PARETO_K_LIMIT}) the weights fail; such a pose (open) was left out by a run of its own, unless more than "
        "ten poses of a posterior are as bad."
    )
    table = results.left_out
    chosen = table[(table["model_error"] == "free") & (table["use"] == "calibration")]
    draw = partial(draw_pareto_k, chosen, results.ranking, assign_styles(results))
    return Figure("pareto_k", caption, draw)


def tabulate_power_scaling(results: StudyResults) -> Table | None:
    """Return by symbol how much the best variant's posterior hangs on prior and measurements; None without any."""
    if results.power_scaling is None:
        return None
    own = results.power_scaling[results.power_scaling["variant"] == results.ranking[0]].copy()
    own["symbol"] = [split_name(name)[0] for name in own["parameter"]]
    own["legs"] = [split_name(name)[1] for name in own["parameter"]]
    columns = [
        Column("Parameter", kind="symbol"),
        Column("Prior", "smallest to largest", "Sensitivity to"),
        Column("measurements", "smallest to largest", "Sensitivity to"),
        Column("What it means", kind="text"),
    ]
    rows: list[list[str | Cell]] = [
        [str(symbol), _format_range(group["prior"]), _format_range(group["likelihood"]), _diagnose(group)]
        for symbol, group in own.groupby("symbol", sort=False)
    ]
    note = (
        "How far the distribution of a parameter moves when the prior, or the density of the measurements, is raised "
        f"to a power near one; it counts from {SENSITIVE} on. Sensitive to the prior alone: the measurements say "
        "little. Sensitive to both: they pull apart."
    )
    caption = "Sensitivity to prior and measurements by power scaling, over the entries of each symbol."
    return make_table(caption, columns, rows, [Statement(note)])


def _format_range(values: pd.Series) -> str:
    return " to ".join(dict.fromkeys(format_fixed(float(x), 3) for x in (values.min(), values.max())))


def _diagnose(group: pd.DataFrame) -> Cell:
    prior, data = group["prior"] >= SENSITIVE, group["likelihood"] >= SENSITIVE
    words = []
    for chosen, text in ((prior & data, "prior and measurements pull apart"), (prior & ~data, "the prior decides")):
        legs = [str(leg) for leg in group.loc[chosen, "legs"] if leg]
        if chosen.any():
            words.append(text + ("" if chosen.all() or not legs else f" in leg {join_words(legs)}"))
    return Cell("; ".join(words) or "the measurements decide", "warning" if (prior & data).any() else "plain")
