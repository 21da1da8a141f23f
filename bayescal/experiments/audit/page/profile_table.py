"""The profile likelihoods as a table: how far each reaches, and what moves along it."""

from __future__ import annotations

from bayescal.experiments.audit.page.figures.profiles import span_profile
from bayescal.experiments.audit.page.results import AuditResults
from bayescal.experiments.audit.page.wording import format_fixed_span, format_sd, name_unit
from bayescal.report.blocks import Column, Statement, Table, make_table
from bayescal.report.numbers import NOTHING, join_words
from bayescal.report.symbols import split_name

FOLLOWERS = 3  # named along a profile


def tabulate_profiles(results: AuditResults) -> Table | None:
    """Return the 95 % intervals of the profiles and what moves along them; None without any."""
    profiles = results.tables.get("profiles")
    if profiles is None:
        return None
    columns = [
        Column("Symbol", kind="symbol"),
        Column("Leg"),
        Column("Unit", kind="text"),
        Column("measurements alone", "", "95 % interval, from expected"),
        Column("with the tolerances", "", "95 % interval, from expected"),
        Column("Moves along", kind="text"),
    ]
    rows = []
    for name, one in profiles.groupby("parameter", sort=False):
        symbol, leg = split_name(str(name))
        centre = float(one.sort_values("deviance_total")["value"].iloc[0])
        spans = [span_profile(one, key) for key in ("deviance_data", "deviance_total")]
        unit = name_unit(str(one["unit"].iloc[0]))
        intervals = [format_fixed_span(low - centre, high - centre) for low, high in spans]
        rows.append([symbol, str(leg) if leg else NOTHING, unit, *intervals, _name_followers(results, str(name))])
    notes = [Statement("“open”: the deviance stays below 3.84 as far as it was computed.")]
    return make_table("Profile likelihoods.", columns, rows, notes)


def _name_followers(results: AuditResults, name: str) -> str:
    """Return the parameters that move most along a profile, in units of their tolerances."""
    paths = results.tables.get("profile_paths")
    if paths is None:
        return NOTHING
    rows = paths[(paths["parameter"] == name) & paths["other"].isin(list(results.parameters.index))]
    if rows.empty:
        return NOTHING
    reach = rows.groupby("other")["other_value"].agg(lambda v: float(v.max() - v.min()))
    share = (reach / results.parameters["prior_sd"].reindex(reach.index)).sort_values(ascending=False)
    named = share[share > 0.1].head(FOLLOWERS)
    words = [
        f"{other} by {format_sd(float(reach[other]))} {_unit_of(results, str(other))}".strip() for other in named.index
    ]
    return join_words(words) if words else "nothing by a tenth of its tolerance"


def _unit_of(results: AuditResults, name: str) -> str:
    return name_unit(str(results.parameters.loc[name, "unit"]))
