"""How far a fit is to be trusted, as tables and sentences of any kind's page: noise, tolerances, priors."""

from __future__ import annotations

from collections.abc import Mapping

import pandas as pd

from bayescal.experiments.shared.chi_square import ChiSquare, format_chance
from bayescal.limits import PARETO_K_LIMIT
from bayescal.report.blocks import Cell, Column, Level, Statement, Table, make_table
from bayescal.report.numbers import format_fixed, format_plain, format_significant, join_words
from bayescal.report.symbols import split_name

SERIOUS = 1.5
SENSITIVE = 0.05
"""Change of a posterior per doubling of a power, as a distance of distributions, from which on it counts."""


def rate(factor: float) -> Level:
    """Return how bad deviations are that many times as large as stated."""
    return "bad" if max(factor, 1 / factor) >= SERIOUS else "warning"


def state_misfit(label: str, found: ChiSquare, without: str, too_small: str) -> Statement:
    """Say that residuals are larger or smaller than the stated noise.

    Parameters
    ----------
    label : str
        Of the variant.
    found : ChiSquare
    without : str
        What of the errors does not count in it, said behind χ².
    too_small : str
        What it means where they are larger.
    """
    per_dof = format_significant(found.value / found.dof, 3)
    text = (
        f"{label} leaves residuals {format_significant(found.factor, 2)} times as large as the "
        f"stated noise (χ² per degree of freedom {per_dof}{without}, {format_fixed(found.dof, 0)} degrees, "
        f"{format_chance(found.chance)}): "
    )
    too_large = "the noise is stated too large, and all intervals are wider than they need be."
    return Statement(text + (too_large if found.factor < 1 else too_small), rate(found.factor), "Noise")


def state_pulls(label: str, found: ChiSquare, farthest: str = "", held: str = "") -> Statement:
    """Say that the machine lies farther from nominal than the tolerances let expect, or much closer."""
    where = (
        f"{label}: deviations from nominal are {format_significant(found.factor, 2)} times the stated tolerances "
        f"(rms over the {format_fixed(found.dof, 0)} directions that the data determine)"
    )
    if found.factor > 1:
        why = "the tolerances are stated too tight, a nominal value is wrong, or the model makes up for what it lacks"
    else:
        why = "the tolerances are wider than this machine needs"
    text = f"{where}{farthest} ({format_chance(found.chance)}): {why}."
    if found.factor <= 1:
        return Statement(text, "plain", "Tolerances")
    return Statement(f"{text}{held}", rate(found.factor), "Tolerances")


def format_factor(factor: float) -> str:
    """Return a factor on the widths of the priors: ``0.5 ×``."""
    return f"{format_plain(factor)} ×"


def tabulate_widths(sensitivity: pd.DataFrame, labels: Mapping[str, str], variant: Column, caption: str) -> Table:
    """Return the log-evidence and rank of every variant at every factor on the widths of the priors.

    Parameters
    ----------
    sensitivity : DataFrame
        A row per variant and factor.
    labels : mapping of str to str
        What to call each variant, in the order of the rows.
    variant : Column
        Of the labels.
    caption : str
    """
    wide = sensitivity.pivot(index="factor", columns="variant", values="log_evidence").sort_index()[list(labels)]
    ranks = wide.rank(axis=1, ascending=False, method="min")
    columns = [variant, *(Column(format_factor(one), "nat (rank)", "Widths of all priors") for one in wide.index)]
    doubtful = sensitivity.pivot(index="factor", columns="variant", values="pareto_k") > PARETO_K_LIMIT
    rows: list[list[str | Cell]] = []
    for name, label in labels.items():
        texts = [
            f"{format_fixed(x, 1)} ({format_fixed(rank, 0)})" for x, rank in zip(wide[name], ranks[name], strict=True)
        ]
        marks = doubtful.sort_index()[name]
        rows.append([label, *(Cell(t, "warning" if bad else "plain") for t, bad in zip(texts, marks, strict=True))])
    note = Statement(f"Marked where Pareto k exceeds {PARETO_K_LIMIT}.", "warning")
    return make_table(caption, columns, rows, [note] if doubtful.to_numpy().any() else [])


def tabulate_power_scaling(own: pd.DataFrame, index: str = "leg") -> Table:
    """Return by symbol how much a posterior depends on prior and measurements.

    Parameters
    ----------
    own : DataFrame
        ``parameter``, ``prior_sensitivity`` and ``likelihood_sensitivity`` of one variant.
    index : str
        What the entries of a symbol are of.
    """
    own = own.copy()
    own["symbol"] = [split_name(name)[0] for name in own["parameter"]]
    own["legs"] = [split_name(name)[1] for name in own["parameter"]]
    columns = [
        Column("Parameter", kind="symbol"),
        Column("Prior", "smallest to largest", "Sensitivity to"),
        Column("measurements", "smallest to largest", "Sensitivity to"),
        Column("What it means", kind="text"),
    ]
    sensitivities = ["prior_sensitivity", "likelihood_sensitivity"]
    rows: list[list[str | Cell]] = [
        [str(symbol), *(_format_range(group[one]) for one in sensitivities), _diagnose(group, index)]
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


def _diagnose(group: pd.DataFrame, index: str) -> Cell:
    prior, data = (group[f"{one}_sensitivity"] >= SENSITIVE for one in ("prior", "likelihood"))
    words = []
    for chosen, text in ((prior & data, "prior and measurements pull apart"), (prior & ~data, "the prior decides")):
        legs = [str(leg) for leg in group.loc[chosen, "legs"] if leg]
        if chosen.any():
            words.append(text + ("" if chosen.all() or not legs else f" in {index} {join_words(legs)}"))
    return Cell("; ".join(words) or "the measurements decide", "warning" if (prior & data).any() else "plain")
