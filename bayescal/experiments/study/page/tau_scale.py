"""The scale of the model error's prior, and whether the order of the variants hangs on it."""

from __future__ import annotations

from itertools import combinations

import pandas as pd

from bayescal.experiments.study.page.checks import read_prior_scale
from bayescal.experiments.study.page.results import StudyResults
from bayescal.experiments.study.page.variants import VARIANT, label_variant
from bayescal.limits import PARETO_K_LIMIT
from bayescal.report.blocks import Block, Cell, Column, Statement, make_table
from bayescal.report.numbers import NOTHING, format_fixed

TIED = 1.0  # nats
LEAD = "scale of the model error's prior"


def show_tau_scale(results: StudyResults) -> list[Block]:
    """Return what to do about the scale of the model error's prior and how sure that is; nothing without its table."""
    own = read_prior_scale(results)
    if not results.has("tau_scale") or own is None or results.table("tau_scale")["tau_scale_um"].nunique() < 2:
        return []
    wide = results.table("tau_scale").pivot(index="tau_scale_um", columns="variant", values="log_evidence")
    wide = wide[results.ranking]
    if own not in wide.index:
        wide.loc[own] = [results.fit(name, "free")["log_evidence"] for name in results.ranking]
    wide = wide.sort_index()
    return [_state_order(results, wide, own), _tabulate(results, wide)]


def _state_order(results: StudyResults, wide: pd.DataFrame, own: float) -> Statement:
    """Say whether a variant that is ahead at the stated scale falls behind at another."""
    known, total = int(wide.notna().to_numpy().sum()), wide.size
    sure = (
        f" {known} of {total} evidences are reliable: the draws of the others weigh too unevenly (Pareto k above "
        f"{PARETO_K_LIMIT}), since a posterior with that scale lies elsewhere."
        if known < total
        else ""
    )
    scales = " to ".join(_format_scale(scale) for scale in (wide.index[0], wide.index[-1]))
    overtaken = _find_overtaken(wide, own)
    if overtaken is None:
        text = (
            f"Keep the scale of τ's prior, {_format_scale(own)} µm, and the order of the variants: from {scales} µm "
            f"none that is ahead by more than {format_fixed(TIED, 0)} nat falls behind by as much.{sure}"
        )
        return Statement(text, "plain" if sure else "good", LEAD)
    scale, ahead, behind = overtaken
    lead = wide[ahead] - wide[behind]
    text = (
        f"State the scale of τ's prior with the order of the variants: at {_format_scale(own)} µm "
        f"{label_variant(results, ahead)} is ahead of {label_variant(results, behind)} by "
        f"{format_fixed(lead[own], 1)} nat, at {_format_scale(scale)} µm behind by "
        f"{format_fixed(-lead[scale], 1)} nat.{sure}"
    )
    return Statement(text, "warning", LEAD)


def _find_overtaken(wide: pd.DataFrame, own: float) -> tuple[float, str, str] | None:
    """Return a scale, and which variant falls furthest behind which other there, against the stated scale."""
    found: list[tuple[float, float, str, str]] = []
    values = {str(name): dict(zip(wide.index.astype(float), wide[name], strict=True)) for name in wide.columns}
    for pair in combinations(values, 2):
        ahead, behind = sorted(pair, key=lambda name: -values[name][own])
        lead = {scale: values[ahead][scale] - values[behind][scale] for scale in values[ahead]}
        if lead[own] > TIED:
            found += [(-value, scale, ahead, behind) for scale, value in lead.items() if value < -TIED]
    return max(found)[1:] if found else None


def _tabulate(results: StudyResults, wide: pd.DataFrame) -> Block:
    """Return every variant's log-evidence and rank at every scale."""
    ranks = wide.rank(axis=1, ascending=False, method="min")
    columns = [
        VARIANT,
        *(Column(f"{_format_scale(s)} µm", "nat (rank)", "Scale of the model error's prior") for s in wide.index),
    ]
    rows: list[list[str | Cell]] = [
        [
            label_variant(results, name),
            *(_format(value, rank) for value, rank in zip(wide[name], ranks[name], strict=True)),
        ]
        for name in results.ranking
    ]
    caption = "Log-evidence for other scales of the model error's prior, by weighted draws of each posterior."
    return make_table(caption, columns, rows)


def _format_scale(scale: float) -> str:
    return f"{scale:g}"


def _format(value: float, rank: float) -> str:
    return NOTHING if pd.isna(value) else f"{format_fixed(value, 1)} ({format_fixed(rank, 0)})"
